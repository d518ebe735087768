"""Branch and bound over boxes of designs: lower bounds of the objective that hold over all designs."""
