"""Solvers: back ends, multistart, exchange methods, infeasibility analysis, and solutions with their optimality conditions."""
