"""Optimal balancing as a cone programme with a dual certificate."""
