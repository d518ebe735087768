"""Tasks: one module per kind of question, from a problem to a result."""
