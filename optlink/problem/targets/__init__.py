"""Targets of a design: motion laws, functions, points and poses, and their input formats."""
