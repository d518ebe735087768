"""Kinematics of planar linkages.

The formulas are elementwise and accept floats, arrays, casadi symbols and jets; the package imports numpy alone.
"""

from optlink.namespace import namespace

__all__, __getattr__, __dir__ = namespace(__name__, __file__)
