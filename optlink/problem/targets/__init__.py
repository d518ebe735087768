"""Targets of a design: motion laws, functions, points and poses, and the ways to state them."""
