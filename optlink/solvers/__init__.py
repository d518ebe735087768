"""Solvers: back ends, multistart, exchange methods, infeasibility analysis, and the Solution that proves itself."""
