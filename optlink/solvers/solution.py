"""Solutions with their optimality conditions: multipliers, stationarity and violation are recomputed from the NLP.

The solver's own flag and message are recorded but not relied on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import numpy as np
from pydantic import ConfigDict, Field, PlainSerializer, PlainValidator, ValidationInfo, WithJsonSchema

from optlink.errors import Status
from optlink.io import Summary
from optlink.linkage.vector2d import Array, all_finite, max_magnitude
from optlink.optimization.multipliers import ACTIVE, LEAST_PRICE, SAME_SUM, MultiplierSet, active_sides
from optlink.optimization.terms import Scale, SIScale
from optlink.problem.document import Column, Never, Number
from optlink.units import in_si

if TYPE_CHECKING:
    from optlink.optimization.nlp import NLP, NLPValues
    from optlink.problem.file import ProblemFile


FEASIBLE = 1e-8  # largest violation, in scaled units, that counts as satisfied
EXACTLY_MET = 1e-10  # violation, or total slack of an elastic programme, in scaled units, up to which limits are met exactly
STATIONARY = 1e-6  # largest KKT residual, for an objective scaled to 1 at the start, that counts as optimal
NEXT_TO = 1e-9  # scaled units
STEEPEST = 1e-3
SAME_OBJECTIVE = 1e-6  # relative difference up to which two objectives are the same
GAINED = 1e-3  # objective, 1 at the start: gain by limits exceeded within `FEASIBLE` that no optimum has


@dataclass(frozen=True)
class Attempt:
    """Result of a back end: its last x, its iteration count and message. `path` (k, n) are the iterates if recorded."""

    x: Array
    iterations: int
    message: str
    path: Array | None = None


class Backend(Protocol):
    """Interface of a solver: minimise an NLP from a start and return an Attempt. It must not raise for a hard problem.

    The programme `nlp` has the bounds `x_low` and `x_high` of x and `low` and `high` of its `rows`, arrays; `values(x, p)`, the
    objective and the rows; `at(x, p)` with the `gradient` of the objective and the `jacobian` of the rows besides; and
    `hessian(x, p, multipliers)` of the Lagrangian.
    """

    def __call__(self, nlp: NLP, x: Array, p: Array, *, track: bool = False, tight: bool = False) -> Attempt:
        """Minimise from x with parameters p; `track` records the iterates, `tight` requests the tightest tolerances."""


@dataclass(frozen=True)
class LimitState:
    """State of one limit at a design, `value`, `bound` and `slack` in `unit`.

    `multiplier`: change of the optimal objective per unit by which the bound of this limit alone is raised (zero if inactive);
    infinite if an equality cannot be raised alone. `slack`: distance to the bound, negative where it is violated. `depends_on`:
    names of other active limits that hold the optimum where it is if this one alone is relaxed; `joint_gain`: decrease of the
    objective if it and each of those are relaxed by one unit.
    """

    key: str
    name: str
    value: Number
    bound: Number
    sense: str  # "<=", ">=" or "="
    unit: str
    active: bool
    multiplier: Number
    slack: Number
    depends_on: tuple[str, ...] = ()
    joint_gain: Number = 0.0

    @property
    def effect(self) -> float:
        """Size of the change of the objective by one unit of this limit, with those on which it depends."""
        return max(abs(self.multiplier), self.joint_gain)


@dataclass(frozen=True)
class Relaxation:
    """A relaxed limit: from `bound` to `relaxed`, which differs by `amount`, all in its display `unit`; `in_si`: the same in SI.

    NaN if relaxing this limit alone does not make the problem feasible. The amount is the least found by local searches, not
    proven to be the least; `approximate`: a limit may still be exceeded between the positions of the NLP; `both_sides`: the
    relaxations of the two sides of a range, which follow one another, belong together.
    """

    name: str
    key: str
    sense: str  # "<=", ">=" or "="
    bound: Number
    relaxed: Number
    amount: Number
    unit: str
    approximate: bool = False
    both_sides: bool = False

    @property
    def in_si(self) -> Relaxation:
        """The same relaxation in SI."""
        size, unit = in_si(self.unit)
        return replace(self, bound=self.bound * size, relaxed=self.relaxed * size, amount=self.amount * size, unit=unit)


@dataclass(frozen=True)
class Stationarity:
    """First-order optimality conditions at x: `multipliers` of bounds (n) then rows, `active` indices of these, KKT residual."""

    multipliers: Column
    active: list[int]
    kkt: Never


def _read_recipe(recipe: Any, info: ValidationInfo) -> Callable[[], NLP]:
    """Return what builds the programme of a stored solution again, for the problem that was read before it."""
    return partial(_built_again, (info.context or {})["present"], recipe)


def _built_again(problem: ProblemFile, recipe: Mapping[str, Any]) -> NLP:
    from optlink.optimization.programme import build_again

    return build_again(problem.spec, recipe)


Source = Annotated[
    Any,
    PlainValidator(_read_recipe),
    PlainSerializer(lambda source: dict((source() if callable(source) else source).recipe)),
    WithJsonSchema({"type": "object"}),
]
"""An NLP, or a function that builds it; in a document what it is built from."""


@dataclass(frozen=True, eq=False, repr=False)
class Solution(Summary):
    """A point of the NLP with its optimality conditions. `x` is scaled, `design` and `objective` are in SI units.

    `source`: the NLP, or a function that builds it when it is needed, for a stored solution; `price` converts multipliers (of
    bounds, then rows) from the scaled objective to that of `objective`.
    """

    __pydantic_config__ = ConfigDict(arbitrary_types_allowed=True)

    source: Source
    x: Column
    g: Column
    price: Number
    design: dict[str, Number]
    objective: Number
    status: Status
    violation: Never
    kkt: Never
    p: Column
    conditions: Stationarity
    iterations: int
    message: str
    path: Annotated[Array | None, Field(exclude=True)] = None

    @cached_property
    def nlp(self) -> NLP:
        """The programme."""
        if not callable(self.source):
            return self.source  # type: ignore[no-any-return]
        nlp: NLP = self.source()
        nlp.p[1:] = self.p[1:]
        return nlp

    @property
    def parts(self) -> dict[str, Any]:
        """All fields but the programme, for another process."""
        return {item.name: getattr(self, item.name) for item in fields(self) if item.name != "source"}

    @cached_property
    def curvature(self) -> float:
        """Least eigenvalue of the reduced Hessian of the Lagrangian; see `curvature`."""
        point = self.nlp.at(self.x, self.p)
        return curvature(self.nlp, self.x, self.p, point, self.conditions) if point.finite else math.nan

    @cached_property
    def _least_multiplier(self) -> float:
        """Multipliers up to this size are rounding errors of zero."""
        return LEAST_PRICE * abs(self.nlp.values(self.x, self.p)[0])

    @cached_property
    def active(self) -> list[int]:
        """Bounds (0 ... n - 1) and rows (from n) at their limit whose multiplier is not zero, and equalities."""
        multipliers, equal = self.conditions.multipliers, self.nlp.lower == self.nlp.upper
        return [i for i in self.conditions.active if equal[i] or abs(multipliers[i]) > self._least_multiplier]

    @cached_property
    def limits(self) -> tuple[LimitState, ...]:
        """State of every bound and limit, in SI."""
        return self._limits(SIScale.of)

    @cached_property
    def displayed_limits(self) -> tuple[LimitState, ...]:
        """State of every bound and limit, in display units: for tables and documents."""
        return self._limits(lambda scale: scale)

    def _limits(self, scaled: Callable[[Scale], Scale]) -> tuple[LimitState, ...]:
        residuals = np.abs(self.nlp.residuals(self.x))
        met = bool(np.max(residuals, initial=0.0) <= self.nlp.exact)  # no improvement is possible
        multipliers = self.conditions.multipliers
        significant = np.where(met | (np.abs(multipliers) <= self._least_multiplier), 0.0, multipliers)
        point = self.nlp.at(self.x, self.p)
        known = point.finite and bool(np.any(significant))
        all_multipliers = MultiplierSet.of(self.nlp, self.x, point, significant) if known else MultiplierSet.unique(significant)
        return tuple(_limit_states(self.nlp, self.x, self.g, all_multipliers, self.price, scaled))

    @property
    def usable(self) -> bool:
        """Whether the solution is feasible and finite."""
        return self.status in (Status.OPTIMAL, Status.STALLED)


def violation(nlp: NLP, x: Array, g: Array) -> float:
    """Return the largest violation of a row or bound, in scaled units; infinite if a row is not finite.

    Parameters
    ----------
    x : array (n,)
        Scaled point.
    g : array (m,)
        Rows at x.
    """
    values = np.concatenate([x, g])
    return float(np.max(np.maximum(nlp.lower - values, values - nlp.upper), initial=0.0)) if all_finite(g) else math.inf


def verified_solution(
    nlp: NLP, attempt: Attempt, p: Array, point: NLPValues | None = None, conditions: Stationarity | None = None
) -> Solution:
    """Turn an attempt into a Solution by recomputing everything from the NLP at its x.

    Parameters
    ----------
    p : array (parameters,)
        Parameters of the NLP.
    point : NLPValues, optional
        The NLP at x, if it was evaluated before.
    conditions : Stationarity, optional
        The conditions at x, if they were computed before.
    """
    x = attempt.x
    point = point or nlp.at(x, p)
    finite = point.finite
    residuals = nlp.residuals(x)
    worst = violation(nlp, x, point.g)
    if conditions is None:
        conditions = Stationarity(np.zeros(len(x) + len(point.g)), [], math.inf)
        if finite:
            conditions = stationarity(nlp, x, point)
    if not finite and not math.isfinite(point.f):
        status = Status.NON_FINITE
    elif worst > FEASIBLE:
        status = Status.INFEASIBLE
    elif not finite:
        status = Status.NON_FINITE
    else:
        status = Status.OPTIMAL if _optimal(nlp, x, p, point, conditions, residuals) else Status.STALLED
    price = p[0] * nlp.factor * nlp.measure.slope(residuals) if all_finite(residuals) else 0.0
    return Solution(
        source=nlp,
        x=x,
        g=point.g,
        price=price,
        design=nlp.design(x),
        objective=nlp.measure.of(residuals),
        status=status,
        violation=worst,
        kkt=conditions.kkt,
        p=p,
        conditions=conditions,
        iterations=attempt.iterations,
        message=attempt.message,
        path=attempt.path,
    )


def stationarity(nlp: NLP, x: Array, point: NLPValues, within: float = ACTIVE) -> Stationarity:
    """Return multipliers of the active bounds and rows by least squares, and the remaining KKT residual.

    A multiplier is positive at an upper bound and negative at a lower bound; multipliers of the wrong sign are dropped, worst
    first, and the rest solved again (an active-set nonnegative least-squares method). Those of an angle free over a full turn are
    none, nor is that of the largest error of a minimax problem: its rows keep it above zero, near which a good design has it.

    Parameters
    ----------
    x : array (n,)
        Scaled point.
    point : NLPValues
        The NLP at x.
    within : float
        Distance at which a limit counts as active, scaled.
    """
    jacobian = np.concatenate([np.eye(len(x)), point.jacobian])
    sign, equal = active_sides(nlp, x, point, within)
    active = np.flatnonzero((sign != 0.0) | equal).tolist()
    estimate: Array = np.zeros(0)
    while active:
        estimate = np.asarray(np.linalg.lstsq(jacobian[active].T, -point.gradient, rcond=1e-12)[0], dtype=float)
        wrong = [(-estimate[k] * sign[i], k) for k, i in enumerate(active) if not equal[i]]
        worst, k = max(wrong, default=(0.0, 0))
        if worst <= 0.0:
            break
        del active[k]
    multipliers = np.zeros(len(jacobian))
    if active:
        multipliers[active] = estimate
    kkt = max_magnitude(point.gradient + jacobian.T @ multipliers)
    return Stationarity(multipliers, active, kkt)


def tangent_space(point: NLPValues, active: Sequence[int]) -> Array:
    """Return an orthonormal basis (n, k) of the directions that keep active limits, to first order.

    Parameters
    ----------
    point : NLPValues
        The NLP at a point.
    active : sequence of int
        Indices of the active bounds and rows.
    """
    unit = np.eye(len(point.gradient))
    if not len(active):
        return unit
    _, singular, rows = np.linalg.svd(np.vstack([unit, point.jacobian])[active])
    rank = int(np.sum(singular > 1e-9 * max(singular[0], 1.0)))
    return rows[rank:].T


def curvature(nlp: NLP, x: Array, p: Array, point: NLPValues, conditions: Stationarity) -> float:
    """Return the least eigenvalue of the reduced Hessian of the Lagrangian; a positive one proves a strict local optimum.

    The Hessian is reduced to the null space of the active limits. NaN if this space is empty (a vertex, which needs no
    curvature).

    Parameters
    ----------
    x : array (n,)
        Scaled point.
    p : array (parameters,)
        Parameters of the NLP.
    point : NLPValues
        The NLP at x.
    conditions : Stationarity
        Active limits and multipliers at x.
    """
    basis = tangent_space(point, conditions.active)
    if basis.shape[1] == 0:
        return math.nan
    hessian = basis.T @ nlp.hessian(x, p, conditions.multipliers[len(x) :]) @ basis
    return float(np.linalg.eigvalsh(hessian)[0]) if all_finite(hessian) else math.nan


def _optimal(nlp: NLP, x: Array, p: Array, point: NLPValues, conditions: Stationarity, residuals: Array) -> bool:
    """Return whether no small change of the design measurably improves the objective.

    One of three criteria holds: the KKT residual vanishes; the residuals vanish to rounding; or the objective is so strongly
    curved that the stationary point is less than `NEXT_TO` away although the KKT residual is not tiny. Where limits that no
    design meets are exceeded within the tolerance, their multipliers are so large that this decides the objective: no optimum.
    """
    if max_magnitude(residuals) <= nlp.exact:
        return True
    values, low, high = np.append(x, point.g), np.append(nlp.x_low, nlp.low), np.append(nlp.x_high, nlp.high)
    if float(np.abs(conditions.multipliers) @ np.maximum(np.maximum(low - values, values - high), 0.0)) > GAINED:
        return False
    if conditions.kkt <= STATIONARY:
        return True
    return conditions.kkt <= STEEPEST and conditions.kkt <= NEXT_TO * curvature(nlp, x, p, point, conditions)


def _limit_states(
    nlp: NLP, x: Array, g: Array, multiplier_set: MultiplierSet, price: float, scaled: Callable[[Scale], Scale]
) -> list[LimitState]:
    """Return every finite bound of the design variables and every limit, in the units of its `scaled` scale.

    Rows that share a limit and a label are one limit: the tightest of them is shown, with the sum of their multipliers.
    """
    n = len(x)
    around = nlp.around
    entries = [
        (v.key or v.name, v.name, i, x[i], nlp.x_low[i], nlp.x_high[i], scaled(v.scale), not around[i])
        for i, v in enumerate(nlp.variables)
        if v.name not in nlp.helpers
    ]
    entries += [
        (row.limit, row.label, n + j, g[j], nlp.low[j], nlp.high[j], scaled(row.scale), True)
        for j, row in enumerate(nlp.rows)
        if row.limit not in nlp.helpers
    ]
    states: dict[tuple[str, str, str], LimitState] = {}
    relaxed: dict[tuple[str, str, str], Array] = {}
    for key, name, entry, value, low, high, scale, limits in entries:
        sides = ["="] if low == high else [side for side, bound in ((">=", low), ("<=", high)) if math.isfinite(bound)]
        for side in sides:
            bound = low if side == ">=" else high
            if scale.cosine and abs(bound) >= 1.0:
                continue
            state = _limit_state(
                key, name, float(value), float(bound), side, scale, float(multiplier_set.multipliers[entry]), price
            )
            state = state if limits else replace(state, active=False)
            other = states.get((key, name, side))
            if other is not None:
                tightest = min(other, state, key=lambda s: s.slack)
                state = replace(tightest, multiplier=other.multiplier + state.multiplier)
            states[key, name, side] = state
            if multiplier_set.directions.size and state.active:
                slope = price / scale.slope(bound)
                weights = relaxed.setdefault((key, name, side), np.zeros(len(multiplier_set.multipliers)))
                weights[entry] = slope if side == "=" else abs(slope) * multiplier_set.sign[entry]
    return _alone(states, relaxed, multiplier_set) if relaxed else list(states.values())


Labels = tuple[str, str, str]


def _alone(states: dict[Labels, LimitState], relaxed: dict[Labels, Array], multiplier_set: MultiplierSet) -> list[LimitState]:
    """Give limits whose multipliers are not unique the effect of relaxing one of them alone, and of all that depend on it.

    `relaxed`: weights of the multipliers in the effect of relaxing each active limit by one unit (of raising an equality).
    """
    gains = {at: multiplier_set.least(weights)[0] for at, weights in relaxed.items() if multiplier_set.changes(weights)}
    most = {at: -multiplier_set.least(-relaxed[at])[0] for at in gains}
    several = {at: gain for at, gain in gains.items() if not math.isclose(most[at], gain, rel_tol=LEAST_PRICE)}
    for at, gain in several.items():
        state = states[at]
        states[at] = replace(state, multiplier=0.0 + (gain if state.sense == ">=" else -gain))
    shares = multiplier_set.directions @ np.linalg.pinv(multiplier_set.directions)
    inequalities = [at for at in several if at[2] != "="]
    for at in inequalities:
        reach = np.max(np.abs(shares[relaxed[at] != 0.0]), axis=0)
        others = [other for other in inequalities if other != at and np.any(reach[relaxed[other] != 0.0] > SAME_SUM)]
        joint = multiplier_set.least(np.sum([relaxed[limit] for limit in (at, *others)], axis=0))[0]
        if joint - sum(several[limit] for limit in (at, *others)) > LEAST_PRICE * joint:
            names = tuple(states[other].name for other in others)
            states[at] = replace(states[at], depends_on=names, joint_gain=joint)
    return list(states.values())


def _limit_state(
    key: str, name: str, value: float, bound: float, side: str, scale: Scale, multiplier: float, price: float
) -> LimitState:
    active = abs(value - bound) <= ACTIVE
    mine = side == "=" or (multiplier > 0.0) == (side == "<=")
    displayed_sense = {"<=": ">=", ">=": "<=", "=": "="}[side] if scale.cosine else side
    at, limit = scale.to_display(value), scale.to_display(bound)
    slack = {"<=": limit - at, ">=": at - limit, "=": -abs(at - limit)}[displayed_sense]
    worth = float(-multiplier * price / scale.slope(bound)) if active and mine and multiplier else 0.0
    return LimitState(key, name, at, limit, displayed_sense, scale.unit, active, worth, slack)
