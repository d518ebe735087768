"""Parametric studies: sensitivities, sweeps, tolerances, Pareto fronts."""

from optlink.namespace import namespace

__all__, __getattr__, __dir__ = namespace(__name__, __file__)
