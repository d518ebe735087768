"""Quantities of a machine cycle, and objective and limits in them."""
