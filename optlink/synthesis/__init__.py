"""Starting points of a search: batched least squares, the Freudenstein equation, growth of six-bars."""

from optlink.namespace import namespace

__all__, __getattr__, __dir__ = namespace(__name__, __file__)
