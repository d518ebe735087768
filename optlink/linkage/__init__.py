"""Kinematics of planar linkages.

The formulas are elementwise and accept floats, arrays, casadi symbols and jets; the package imports numpy alone.
"""
