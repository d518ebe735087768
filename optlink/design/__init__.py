"""What is wanted: the problem file, its target laws, and the terms of the nonlinear programme."""
