"""Adding to optlink from another package: each entry is one of these classes, and `register` adds it."""

from optlink.namespace import namespace

__all__, __getattr__, __dir__ = namespace(__name__, __file__)
