"""Tolerance analysis: worst case, statistical scatter, yield, tolerance allocation, robust designs."""
