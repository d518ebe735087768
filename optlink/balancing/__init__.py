"""Optimal balancing as a second-order cone programme with a dual certificate."""
