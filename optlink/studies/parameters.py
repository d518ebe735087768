"""Parameters of an optimum: fixed quantities, and all bounds and limits, in display units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from optlink.optimization.constraints import Scale, SIScale
from optlink.optimization.nlp import NLP
from optlink.problem.document import Number
from optlink.problem.limits import MARGIN_KEYS
from optlink.units import in_si

ROUNDING = 1e-14  # of a scaled quantity: smaller values count as zero
SHARE = 0.01
"""Step of a length or a plain number by which effects are compared, as a share of its value; that of an angle is 1 deg."""


ANGULAR = {"deg": 1.0, "rad": math.radians(1.0)}
"""A degree in the units of angles."""


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    `value` in `unit`; `constant`: its index among the fixed quantities of the programme, else -1; `entries`:
    indices in x, then in the rows, whose lower or `upper` bound it is (both for a prescribed value: `equal`).
    """

    key: str
    name: str
    value: Number
    unit: str
    scale: Annotated[Scale, Field(exclude=True)] = field(default=Scale(""), compare=False)  # of the programme
    constant: int = -1
    entries: tuple[int, ...] = ()
    upper: bool = False
    equal: bool = False
    in_file: bool = True  # whether the problem file contains this number, so that it can be changed there

    @property
    def kind(self) -> str:
        """Kind of the parameter, in words."""
        return "limit" if self.entries else "fixed quantity"

    @property
    def positive(self) -> bool:
        """Whether it is a mass, a force, a tolerance or another positive number that cannot or should not change its sign."""
        outside = self.constant < 0 and not self.entries
        return self.value > 0.0 and ((outside and self.unit not in ANGULAR) or self.key.startswith("tolerances."))

    @property
    def step(self) -> float:
        """Reference change for the comparison of effects: 1 deg of an angle, else 1 % of the value (0.01 of a zero)."""
        return ANGULAR.get(self.unit) or SHARE * (self.value or 1.0)

    @property
    def in_si(self) -> Parameter:
        """The same parameter in SI."""
        size, unit = in_si(self.unit)
        return replace(self, value=self.value * size, unit=unit, scale=SIScale.of(self.scale))

    def rate(self) -> float:
        """Return the change of the scaled number of the programme per unit of the parameter."""
        return 1.0 / self.scale.slope(self.scale.to_internal(self.value))

    def shifted(self, change: float) -> float:
        """Return the value after a first-order change [unit] of the number of the programme; infinite if it has no such value."""
        internal = self.scale.to_internal(self.value) + self.rate() * change
        value = float(self.scale.to_display(internal))
        exists = math.isclose(self.scale.to_internal(value), internal, rel_tol=1e-9, abs_tol=1e-9)
        return value if exists else math.copysign(math.inf, change)

    def place(self, nlp: NLP, value: float) -> None:
        """Set another value of the parameter in the programme."""
        internal = self.scale.to_internal(value)
        if self.constant >= 0:
            nlp.p[1 + self.constant] = internal
        for entry in self.entries:
            nlp.limit(entry, internal if self.equal or not self.upper else None, internal if self.equal or self.upper else None)


def displayed(nlp: NLP, x: Sequence[float] | NDArray[np.float64]) -> dict[str, float]:
    """Return the design variables (no auxiliary variables) in display units."""
    return {v.name: v.scale.to_display(float(value)) for v, value in design_variables(nlp, x)}


def design_variables(nlp: NLP, x: Sequence[float] | NDArray[np.float64]) -> list[tuple[Any, float]]:
    """Return the design variables (no auxiliary variables) of a programme with their scaled values."""
    return [(v, float(value)) for v, value in zip(nlp.variables, x, strict=False) if v.name not in nlp.helpers]


QUANTITIES = ("mechanism.", "requirement.from", "requirement.psi0", "requirement.start", "requirement.mark", "requirement.zero")
"""Beginnings of the keys of quantities; rows with such a key are the bounds of linked ones."""
GENERAL = ("limits.transmission_angle", "limits.pressure_angle")
"""Keys of limits with one value for several joints, whose rows are labelled "... at JOINT"."""


def parameters(nlp: NLP) -> list[Parameter]:
    """Return all fixed quantities, then all finite bounds of design variables and limits.

    Rows that share a limit and a label are one limit, with one bound; so are those of one value for several joints.
    """
    result = [
        Parameter(c.key or c.name, c.name, _displayed(float(nlp.p[1 + i]), c.scale), c.scale.unit, c.scale, constant=i)
        for i, c in enumerate(nlp.constants)
    ]
    n = len(nlp.variables)
    entries = [(v.key or v.name, v.name, i, v.scale) for i, v in enumerate(nlp.variables) if v.name not in nlp.helpers]
    entries += [(row.limit, row.label, n + j, row.scale) for j, row in enumerate(nlp.rows) if row.limit not in nlp.helpers]
    limits: dict[tuple[str, str, str, float], Parameter] = {}
    for key, name, entry, scale in entries:
        low, high = float(nlp.lower[entry]), float(nlp.upper[entry])
        for upper, bound in ((False, low), (True, high)):
            if not math.isfinite(bound) or (upper and low == high) or (scale.cosine and abs(bound) >= 1.0):
                continue
            side = "" if low == high else "max" if upper != scale.cosine else "min"
            what, _, joint = name.partition(" at ") if key in GENERAL else (name, "", "")
            mark = (key, what, side, bound)
            if mark in limits:
                limit = limits[mark]
                label = limit.name if joint in limit.name.split(" at ")[-1].split(", ") or not joint else f"{limit.name}, {joint}"
                limits[mark] = replace(limit, name=label, entries=(*limit.entries, entry))
                continue
            own = entry < n or key.startswith(QUANTITIES)
            whole = key in ("limits.crank", *MARGIN_KEYS) or key.endswith(".clearance")  # of one value, not of a range
            prescribed = own or key.endswith(".value") or (key.startswith("limits.") and not whole)
            bounds = f"{name}, {'largest' if side == 'max' else 'smallest'} allowed" if own else name
            limit_key = f"{key}.{side}" if side and prescribed else key
            limits[mark] = Parameter(
                limit_key, bounds, _displayed(bound, scale), scale.unit, scale, -1, (entry,), upper, not side, prescribed
            )
    return result + list(limits.values())


def _displayed(internal: float, scale: Scale) -> float:
    """Return a number of the programme in display units, without rounding errors of scaling."""
    value, size = scale.to_display(internal), abs(scale.to_display(1.0) - scale.to_display(0.0))
    digits = 12 if scale.cosine else 14  # that of 1 deg has 12: 0.9999999999999 deg was shown
    return 0.0 if abs(value) <= ROUNDING * size else float(f"{value:.{digits}g}")
