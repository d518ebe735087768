"""Compiled engine of machines with joint clearance: equations as machine code, and an explicit integrator of order 8 (numba)."""
