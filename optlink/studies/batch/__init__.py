"""Many neighbouring optima at once."""
