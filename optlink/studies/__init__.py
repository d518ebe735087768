"""Parametric studies: sensitivities, sweeps, tolerances, Pareto fronts."""
