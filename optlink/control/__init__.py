"""Joint clearance, and the control that compensates for it."""

from optlink.namespace import namespace

__all__, __getattr__, __dir__ = namespace(__name__, __file__)
