"""Requirements of design problems, a class per kind."""
