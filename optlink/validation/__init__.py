"""Independent validation of designs by the kinematics core, by other formulas than the optimiser's."""

from optlink.validation.check import Check, Validation
from optlink.validation.design import validate, validate_batch

__all__ = ["Check", "Validation", "validate", "validate_batch"]
