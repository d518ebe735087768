"""Pareto fronts by the epsilon-constraint method."""
