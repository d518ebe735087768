"""The elastic programme of infeasibility analysis: every limit of an NLP, or both sides of a range, relaxed by a slack."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi
import numpy as np

from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.vector2d import Array
from optlink.optimization.constraints import DEGREES, PLAIN, ConstraintRow, Scale
from optlink.optimization.nlp import NLP, Variable
from optlink.problem.design import EPIGRAPH
from optlink.solvers.solution import Relaxation

FEASIBLE_SLACK = 1e-6  # total slack, in scaled units, below which a set of limits counts as feasible
FREE = 1e3  # upper bound of a slack, in scaled units


@dataclass(frozen=True)
class LimitSide:
    """One side of one limit: the rows (and bounds) that share it."""

    key: str
    name: str
    upper: bool
    rows: tuple[int, ...]
    variables: tuple[int, ...]
    bound: float
    scale: Scale
    equation: bool = False

    @property
    def sense(self) -> str:
        """Sense in display units: "<=", ">=" or "="."""
        return "=" if self.equation else "<=" if self.upper != self.scale.cosine else ">="

    def displaced(self, amount: float) -> float:
        """Return the bound moved outward by an amount, in display units; an angle between 0 and 180 deg for a cosine."""
        moved = self.scale.to_display(self.bound) + (amount if self.upper != self.scale.cosine else -amount)
        return min(max(moved, 0.0), 180.0) if self.scale.cosine else moved

    def relaxation(self, slack: float, approximate: bool = False, both_sides: bool = False) -> Relaxation:
        """Return the side relaxed by a slack, infinite if no slack suffices, in display units; for the flags see `Relaxation`."""
        bound = self.scale.to_display(self.bound)
        relaxed = self.scale.to_display(self.bound + (slack if self.upper else -slack)) if math.isfinite(slack) else math.nan
        amount = abs(relaxed - bound)
        return Relaxation(self.name, self.key, self.sense, bound, relaxed, amount, self.scale.unit, approximate, both_sides)


@dataclass(frozen=True)
class Limit:
    """A limit that is relaxed as one: one side, or both sides of a range."""

    sides: tuple[LimitSide, ...]

    def shares(self, amount: float) -> Array:
        """Return the slack of each side relative to the first one if all sides are relaxed by an amount [display unit]."""
        slacks = [abs(side.scale.to_internal(side.displaced(amount)) - side.bound) for side in self.sides]
        shares = np.array([slack / slacks[0] if slacks[0] else 1.0 for slack in slacks])
        return np.asarray(np.clip(shares, 0.1, 10.0))  # a root has no slope at zero

    def relaxations(self, slacks: Array, nlp: NLP, x: Array, p: Array, approximate: bool) -> list[Relaxation]:
        """Return the relaxation of each side that a design x needs, from the slack of each; infinite slacks do not suffice."""
        slacks_by_side = list(zip(self.sides, slacks.tolist(), strict=True))
        if len(slacks_by_side) > 1 and np.all(np.isfinite(slacks)):
            g = nlp.values(x, p)[1]
            over = [max((g[j] - side.bound) * (1.0 if side.upper else -1.0) for j in side.rows) for side in self.sides]
            needed = [pair for pair, excess in zip(slacks_by_side, over, strict=True) if excess > FEASIBLE_SLACK]
            slacks_by_side = needed or slacks_by_side
        return [side.relaxation(slack, approximate, len(slacks_by_side) > 1) for side, slack in slacks_by_side]


def limit_sides(nlp: NLP) -> list[LimitSide]:
    """Return every side of every limit that can conflict; rows of one limit and one side are combined.

    Bounds of variables without influence on any limit are left out, as are bounds of an angle over a full revolution.
    """
    sides: dict[tuple[str, str, bool], list[int]] = {}
    for j, row in enumerate(nlp.rows):
        if row.limit == EPIGRAPH or row.limit in nlp.states:
            continue
        for upper, bound in ((False, row.low), (True, row.high)):
            if math.isfinite(bound):
                sides.setdefault((row.limit, row.label, upper), []).append(j)
    result = []
    for (key, name, upper), rows in sides.items():
        row = nlp.rows[rows[0]]
        bound, equation = row.high if upper else row.low, row.low == row.high
        result.append(LimitSide(key, name, upper, tuple(rows), (), bound, row.scale, equation))
    indices = [j for j, row in enumerate(nlp.rows) if row.limit != EPIGRAPH]
    used = casadi.which_depends(nlp.g_expression[indices], nlp.x_symbol, 1, False) if indices else [False] * len(nlp.variables)
    for i, variable in enumerate(nlp.variables):
        around = variable.scale is DEGREES and nlp.x_high[i] - nlp.x_low[i] >= 2.0 * math.pi
        if variable.name in nlp.helpers or variable.name in nlp.states or around or not used[i]:
            continue
        for upper, bound in ((False, nlp.x_low[i]), (True, nlp.x_high[i])):
            result.append(LimitSide(variable.key or variable.name, variable.name, upper, (), (i,), float(bound), variable.scale))
    return result


def limits_of(sides: Sequence[LimitSide]) -> list[Limit]:
    """Combine the two sides of each range that several values must keep; every other side is a limit of its own.

    The sides belong together if they have the same name, or if they are the only ones of their key. A single value is never
    beyond both sides of its range, and an equation has a slack for each side.
    """
    result: list[Limit] = []
    paired: set[int] = set()
    for i, side in enumerate(sides):
        same_key = [k for k, other in enumerate(sides) if other.key == side.key and other.rows]
        same_key = [k for k in same_key if sides[k].name == side.name] if len(same_key) > 2 else same_key
        if i in paired:
            continue
        values = {row for k in same_key for row in sides[k].rows}
        two_sided = sorted(sides[k].upper for k in same_key) == [False, True]
        if side.rows and not side.equation and len(values) > 1 and two_sided:
            paired.update(same_key)
            # in display units the lower side comes first
            result.append(Limit(tuple(sorted((sides[k] for k in same_key), key=lambda one: one.upper != one.scale.cosine))))
        else:
            result.append(Limit((side,)))
    return result


def elastic_programme(nlp: NLP, limits: Sequence[Limit]) -> NLP:
    """Return the elastic programme: minimise weights . s over x and slacks s >= 0, each of the k limits relaxed by its s.

    Its parameters are the weights (k,) and the shares of every side in the slack of its limit, followed by those of the NLP.
    """
    sides = [(i, side) for i, limit in enumerate(limits) for side in limit.sides]
    shares = casadi.SX.sym("shares", len(sides))
    n, k = len(nlp.variables), len(limits)
    x, s = casadi.SX.sym("x", n), casadi.SX.sym("s", k)
    g = casadi.substitute(nlp.g_expression, nlp.x_symbol, x)
    weights = casadi.SX.sym("weights", k)
    # a target value stays one equation with slack to either side: two inequalities would have no interior
    exact = {j: g[j] for _, side in sides for j in side.rows if side.equation}
    for i, side in sides:
        for j in exact.keys() & set(side.rows):
            exact[j] = exact[j] + (-s[i] if side.upper else s[i])
    rows = [replace(nlp.rows[j], value=value) for j, value in exact.items()]
    for m, (i, side) in enumerate(sides):
        give = -shares[m] * s[i] if side.upper else shares[m] * s[i]
        low, high = (-math.inf, side.bound) if side.upper else (side.bound, math.inf)
        rows += [ConstraintRow(side.key, side.name, g[j] + give, low, high, side.scale) for j in side.rows if j not in exact]
        rows += [ConstraintRow(side.key, side.name, x[j] + give, low, high, side.scale) for j in side.variables]
    rows += [replace(row, value=g[j]) for j, row in enumerate(nlp.rows) if row.limit in nlp.states]
    bounded = np.array([v.name not in nlp.helpers for v in nlp.variables])
    giving = {i for _, side in sides for i in side.variables}
    fixed_variables = np.array([v.name in nlp.states or (bounded[i] and i not in giving) for i, v in enumerate(nlp.variables)])
    length = np.array([v.name in LENGTHS or v.name.endswith(".length") for v in nlp.variables])
    room = np.where(bounded, np.maximum(nlp.x_high - nlp.x_low, 1.0), 1.0)
    lowest = np.where(length, 1e-3 * nlp.x_low, nlp.x_low - room)  # a length may shrink towards zero, not below
    # helpers keep their bounds, except the largest error, which has no upper bound
    lowest = np.where(fixed_variables, nlp.x_low, np.where(bounded, lowest, np.where(np.isfinite(nlp.x_low), nlp.x_low, 0.0)))
    highest = np.where(
        fixed_variables, nlp.x_high, np.where(bounded, nlp.x_high + room, np.where(np.isfinite(nlp.x_high), nlp.x_high, 1.0))
    )
    return NLP(
        variables=(*nlp.variables, *(Variable(f"slack {i}", 1.0, PLAIN) for i in range(k))),
        fixed=(),
        rows=tuple(rows),
        measure=nlp.measure,
        x_start=np.concatenate([nlp.x_start, np.zeros(k)]),
        x_low=np.concatenate([lowest, np.zeros(k)]),
        x_high=np.concatenate([highest, np.full(k, FREE)]),
        p=np.concatenate([np.ones(k + len(sides)), nlp.p]),
        x_symbol=casadi.vertcat(x, s),
        p_symbol=casadi.vertcat(weights, shares, nlp.p_symbol),
        f_expression=casadi.dot(weights, s),
        g_expression=casadi.vertcat(*[row.value for row in rows]),
        residual_expression=casadi.SX(1, 1),
    )
