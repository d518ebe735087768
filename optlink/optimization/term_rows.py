"""Rows of quantities of the machine: their limits, and their largest values, which lie below a level."""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import casadi

from optlink.optimization.constraints import PLAIN, ConstraintRow, Scale, SquareRootScale
from optlink.problem.cycle.terms import Goal
from optlink.problem.design import EPIGRAPH
from optlink.problem.limits import Bound
from optlink.units import KINDS, factor


@dataclass(frozen=True)
class ScaledLimit:
    """A limit in units of `size` [SI]: its bounds and the scale of its rows."""

    bound: Bound
    size: float
    below: float
    above: float
    scale: Scale

    def row(self, figure: Any) -> ConstraintRow:
        """Return the row of a term with a single value [SI]."""
        return ConstraintRow(self.bound.key, self.bound.term.words, figure / self.size, self.below, self.above, self.scale)

    def rows_at(self, parts: Sequence[Any]) -> Iterator[ConstraintRow]:
        """Yield the rows of a term at one position from its components there [SI]."""
        term = self.bound.term
        if len(parts) > 1 and not term.nature.general:
            square, scale = sum(part * part for part in parts), SquareRootScale(self.scale.unit, self.scale.factor)
            yield ConstraintRow(self.bound.key, term.words, square / self.size**2, -math.inf, self.above**2, scale)
            return
        for part, sign in itertools.product(parts, (1.0, -1.0) if term.how == "peak" else (1.0,)):
            yield self.row(sign * part)


def scaled_limit(bound: Bound, length: float) -> ScaledLimit:
    """Return a limit in units of its larger bound, else of a length [m] or 1."""
    interval = bound.interval
    kind = interval.kind or ""
    ends = [abs(x) for x in (interval.low, interval.high) if x is not None]
    size = max(ends) or (length if kind in ("length", "coordinate") else 1.0)
    scale = Scale(interval.unit, size / factor(interval.unit or KINDS[kind].display, kind)) if kind else Scale("", size)
    below = -math.inf if interval.low is None else interval.low / size
    above = math.inf if interval.high is None else interval.high / size
    return ScaledLimit(bound, size, below, above, scale)


SIGNS = {"peak": (1.0, -1.0), "largest": (1.0,), "least": (-1.0,)}
"""Signs of the values whose largest is an extreme."""


def rows_below_level(goal: Goal, size: float, level: Any, parts: Sequence[Any]) -> Iterator[ConstraintRow]:
    """Yield the rows that keep the values at one position, in units of `size` [SI], below a level."""
    label = f"{goal.words} at another crank angle"
    if len(parts) > 1 and not goal.nature.general:
        square = level * level - sum(part * part for part in parts) / size**2
        yield ConstraintRow(EPIGRAPH, label, square, 0.0, math.inf, PLAIN)
        return
    for part, sign in itertools.product(parts, SIGNS[goal.how]):
        yield ConstraintRow(EPIGRAPH, label, level - sign * part / size, 0.0, math.inf, PLAIN)


def heights_at(goal: Goal, size: float, parts: Sequence[Any]) -> list[Any]:
    """Return the values at one position whose largest is the level of a term, in units of `size` [SI]."""
    if goal.nature.general:
        return [casadi.fabs(part) / size for part in parts]
    if len(parts) > 1:
        return [casadi.sqrt(sum(part * part for part in parts)) / size]
    return [(casadi.fabs(parts[0]) if goal.how == "peak" else SIGNS[goal.how][0] * parts[0]) / size]
