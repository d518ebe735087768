"""Kinematics of planar linkages: elementwise formulas on floats, arrays, symbols and jets. Imports numpy alone."""
