"""How designs for points and poses are found: many starts that advance together, none of them believed."""
