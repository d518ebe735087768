"""Starting points of a search: batched least squares, the Freudenstein equation, growth of six-bars."""
