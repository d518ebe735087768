"""Objective and constraint terms, and the scaled nonlinear programmes that they form."""
