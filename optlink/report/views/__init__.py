"""Views: what is shown of each kind of result."""
