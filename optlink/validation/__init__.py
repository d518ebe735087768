"""Is it true? Designs are proven by the kinematics core, by other routes than the optimiser's formulas."""

from optlink.validation.check import Check, Validation
from optlink.validation.law import validate

__all__ = ["Check", "Validation", "validate"]
