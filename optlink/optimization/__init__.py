"""Objective and constraint terms, and the scaled nonlinear programmes assembled from them."""
