"""What a linkage is and how it moves: elementwise formulas on floats, batches, symbols and jets. Imports numpy alone."""
