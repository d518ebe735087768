"""General tolerances of lengths, and the limits of a design that sizes within given tolerances could violate.

As in the worst case of a tolerance analysis, the effects of single deviations are added up. Limits are measured by the
validator, at both ends of the tolerance of each size: the least or largest value over a motion has kinks.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.tasks.results.design import LinkageDesign
from optlink.validation import validate
from optlink.validation.check import Requirement, requirements

GENERAL = "ISO 2768-m"
LEAST = 0.5  # mm; shorter lengths have no general tolerance, nor have those above the last one
TOLERANCES = {6.0: 0.1, 30.0: 0.2, 120.0: 0.3, 400.0: 0.5, 1000.0: 0.8, 2000.0: 1.2, 4000.0: 2.0}
"""Permitted deviation [mm] of lengths up to the key (ISO 2768-1:1989, table 1, class m)."""


@dataclass(frozen=True)
class Violation:
    """A limit that could be violated: by how much, in the unit of the limit, and the size that changes it most."""

    limit: Requirement
    by: float
    size: str

    def __str__(self) -> str:
        return f"{self.limit.name} by {self.by:.2g} {self.limit.unit}".rstrip() + f", mainly due to {self.size}"


def general_tolerance(length: float) -> float:
    """Return the general tolerance of a length [mm]; zero where the standard has none."""
    return next((by for most, by in TOLERANCES.items() if LEAST <= length <= most), 0.0)


def violations(design: LinkageDesign, tolerances: Mapping[str, float]) -> list[Violation]:
    """Return the limits that a design could violate with sizes within tolerances [m], to first order in the worst case."""
    if not tolerances:
        return []
    nominal = _measured(design, {})
    worst = {name: np.zeros((len(tolerances), 2)) for name in nominal}  # of each size: how far down and up it moves the limit
    for k, (size, by) in enumerate(tolerances.items()):
        for sign in (-1.0, 1.0):
            for name, moved in _measured(design, {size: design.values[size] + sign * by}).items():
                if name in nominal and np.isfinite(change := moved.value - nominal[name].value):
                    worst[name][k] = np.maximum(worst[name][k], [-change, change])
    found = [(limit, _beyond(limit, worst[name])) for name, limit in nominal.items()]
    names = [*tolerances]
    return [Violation(limit, by, names[k]) for limit, (by, k) in found if by > 0.0]


def _beyond(limit: Requirement, moved: Array) -> tuple[float, int]:
    """Return how far changes (sizes, 2) bring a limit beyond one of its bounds, and the number of the size with the largest."""
    room = np.array([limit.value - limit.low, limit.high - limit.value])
    total = moved.sum(axis=0)
    beyond = np.where(total > 0.0, total - room, -np.inf)
    side = int(np.argmax(beyond))
    return float(beyond[side]), int(np.argmax(moved[:, side]))


def _measured(design: LinkageDesign, changed: Mapping[str, float]) -> dict[str, Requirement]:
    """Return the limits of a design with some other sizes [m], as measured, by name."""
    task = design.whole
    values = task.derive({**design.values, **changed})
    timed = all(part.data.offsets is not None for part in task.parts)
    checks = validate(task, values, None if timed else design.crank_angles).checks
    return {one.name: one for one in requirements(checks)}
