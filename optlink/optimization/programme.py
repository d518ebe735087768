"""build(problem, direction) -> NLP: the scaled nonlinear programme of a law, path, motion or transmission problem.

Its variables are the design variables, without prescribed timing the crank angle of every point, and the largest deviation where
this is minimised. Deviations and limits are traced once, at one crank angle, and apply at the positions of the requirement, at
fixed crank angles and at exchange points, which move to where a limit or the largest deviation is exceeded.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi
import numpy as np

from optlink.linkage.vector2d import TURN, Array, Value, unit
from optlink.optimization.constraints import (
    DEGREES,
    PLAIN,
    ConstraintRow,
    Scale,
    SquareRootScale,
    position_rows,
    rows as limit_rows,
)
from optlink.optimization.mapped_terms import MappedTerms
from optlink.optimization.nlp import NLP, Variable, boxed, scaled_variable
from optlink.optimization.objectives import error_measures
from optlink.optimization.output_derivatives import ErrorResiduals, traced_residuals
from optlink.problem.function import EPIGRAPH
from optlink.problem.limits import Reach
from optlink.problem.path import STEP, PathProblem
from optlink.problem.robust import EXPECTED, SMOOTHED
from optlink.symbolic import symbols_in_numpy

GRID = 36  # crank angles at which the assembly of a mechanism other than a four-bar is checked
EXCHANGE_POINTS = 24  # further ones, moved by the exchange method to where a limit is exceeded
LEVEL_POINTS = 12  # the same for a largest error alone; twice as many with scatter, which makes it flatter
BETWEEN = 3  # positions between two points if full crank rotation is not required
EXACT = 1e-10  # share of the size of the curve: residual that counts as zero
SPAN = "requirement.span"
"""Name of the parameter that is the crank rotation of a law."""
TARGET = "target "
"""Beginning of the names of the parameters that are components of the targets."""


def angle_name(index: int) -> str:
    """Return the name of the variable that is the crank angle of a point; points count from 1."""
    return f"crank angle of point {index + 1}"


def path_variable(problem: PathProblem, name: str) -> Variable:
    """Return the scaling of a quantity: lengths by the size of the problem, coordinates on the frame from the curve's centre."""
    axis = name.rpartition(".")[2] if problem.quantities[name].kind == "coordinate" else ""
    origin = problem.centre["xy".index(axis)] if axis in ("x", "y") else 0.0
    return scaled_variable(problem, name, problem.size, periodic=problem.is_periodic(name), origin=origin)


def has_position_limits(problem: PathProblem) -> bool:
    """Return whether limits at single crank angles (`position_rows`) apply; for a four-bar the extremes are known instead."""
    return not problem.four_bar


def has_levels(problem: PathProblem) -> bool:
    """Return whether the objective is the largest value over a range: the error of a law that is a formula over its span, or the
    cosine of the transmission angles over the revolution, whose extremes are known for a four-bar."""
    return problem.everywhere and not (problem.requirement.kind == "transmission" and problem.four_bar)


def build(problem: PathProblem, direction: int = 1, *, movable: bool = False) -> NLP:
    """Build the nonlinear programme of a problem with definite assembly modes.

    `direction` is the sense of crank rotation from point to point without prescribed timing: +1 counter-clockwise, -1 clockwise.
    `movable`: points and poses, and the crank rotation of an expression, are parameters. The exchange points of the NLP are
    shares of the motion over which limits and the largest error apply, see `required_motion` and `level_motion`.
    """
    return _Builder(problem, direction, movable).nlp()


class _Builder:
    """The expressions of a programme, in the order in which they are made."""

    def __init__(self, problem: PathProblem, direction: int, movable: bool) -> None:
        self.problem, self.size, self.share, data = problem, problem.size, problem.whole, problem.data
        self.recipe = {"builder": "path", "direction": direction}
        self.free_timing, self.count = data.offsets is None, len(data.columns)
        self.single = problem.requirement.kind == "transmission"  # every dyad has a transmission angle of its own
        robust = problem.robust
        width = 1 if self.single else problem.width
        if robust is not None and robust.text == EXPECTED:
            width = 1 + len(problem.deviations)
        self.measure = error_measures(problem.unit, width)[problem.measure]
        self.minimax, self.signed = self.measure.name == "max", problem.width == 1 and not self.single
        free = problem.free
        fixed = [path_variable(problem, name) for name in problem.quantities if name not in free]
        self.fixed = tuple(v.name for v in fixed)
        self.variables = [path_variable(problem, name) for name in free]
        self.variables += [Variable(angle_name(i), 1.0, DEGREES) for i in range(self.count if self.free_timing else 0)]
        if self.minimax:
            scale = DEGREES if problem.unit == "rad" else Scale(problem.unit, self.share)
            self.variables.append(Variable(EPIGRAPH, self.share, scale))
        self.moving = target_constants(problem) if movable and problem.pointed else []
        self.spanned = movable and problem.movable_span
        counted = [Variable(name, self.size, Scale("mm", 1e3 * self.size)) for name in problem.counted]
        span = [Variable(SPAN, 1.0, DEGREES)] if self.spanned else []
        self.constants = [*fixed, *counted, *span, *self.moving]
        self.smoothing = 1 + len(self.constants) if robust is not None and robust.text != EXPECTED else 0
        levels = has_levels(problem)
        self.many = EXCHANGE_POINTS if has_position_limits(problem) or (levels and robust) else LEVEL_POINTS * levels
        self.exchanged_from = 1 + len(self.constants) + (self.smoothing > 0)
        self.x = casadi.SX.sym("x", len(self.variables))
        self.p = casadi.SX.sym("p", self.exchanged_from + self.many)
        given = {v.name: v.value(self.p[1 + i]) for i, v in enumerate(self.constants)}
        values = {v.name: v.value(self.x[i]) for i, v in enumerate(self.variables[: len(free)])}
        self.values: dict[str, Any] = values | {name: given[name] for name in self.fixed}
        self.tolerances = {v.name: given[v.name] for v in counted}
        self.targets = [given[v.name] for v in self.moving]
        self.span = given.get(SPAN)
        self.rows: list[ConstraintRow] = []
        with symbols_in_numpy():
            self.values = problem.complete(self.values)
            self._trace()
            self._time(direction)
            self._limit()
            self._measure()

    # --- one position ------------------------------------------------------------------------------------------------------

    def _trace(self) -> None:
        """Trace the residual and the limits at one crank angle.

        Both are functions of what is known and a crank angle, and of the factor of the start angle that is added; the residual
        also of the target.
        """
        problem, names = self.problem, list(self.values)
        extra = [*self.tolerances, *([SMOOTHED_BY] if self.smoothing else [])]
        inputs = casadi.SX.sym("inputs", len(names) + len(extra) + 1)
        senses = casadi.SX.sym("senses", 1 + problem.data.columns.shape[1])
        known = {name: inputs[i] for i, name in enumerate([*names, *extra])}
        quantities = {name: known[name] for name in names}
        start = quantities.get(problem.start_name)
        angle = inputs[-1] + (senses[0] * start if start is not None else 0.0)
        target = tuple(casadi.vertsplit(senses[1:]))
        if problem.law_given:
            target = (inputs[-1], *target[1:])  # the crank rotation itself, which may be an unknown
        if problem.robust is None:
            parts = problem.deviation(problem.linkage.pose(quantities, unit(angle)), quantities, target)
        else:
            parts = traced_residuals(problem, known, angle, target, known.get(SMOOTHED_BY, 0.0))
        self.placed: list[ConstraintRow] = []
        if has_position_limits(problem):
            self.placed = position_rows(problem, problem.linkage.pose(quantities, unit(angle)))
        residual = casadi.Function("residual", [inputs, senses], [casadi.vertcat(*parts)])
        limits = casadi.Function("limits", [inputs, senses[0]], [casadi.vertcat(*[row.value for row in self.placed])])
        smoothing = [self.p[self.smoothing]] if self.smoothing else []
        self.known = casadi.vertcat(*self.values.values(), *self.tolerances.values(), *smoothing)
        self.watched, self.limited = _Positions(residual), _Positions(limits)

    # --- positions ---------------------------------------------------------------------------------------------------------

    def _time(self, direction: int) -> None:
        """Define the crank angles of the positions, from the start if there is one, and the errors there."""
        problem, data = self.problem, self.problem.data
        self.origin = 0.0 if self.free_timing or problem.timing != "from start" else 1.0  # factor of the start angle
        if self.free_timing:
            first = len(problem.free)
            self.angles: list[Any] = [self.x[first + i] for i in range(self.count)]
        else:
            assert data.offsets is not None
            self.angles = data.offsets.tolist()
            direction = 1 if self.angles[-1] >= self.angles[0] else -1
            if self.spanned:
                self.angles = [self.span * (offset / problem.span) for offset in self.angles]
        self.direction = direction
        columns: Any = data.columns.tolist()
        stretch: Any = 1.0
        if self.moving:
            width = data.columns.shape[1]
            columns = [self.targets[width * k : width * (k + 1)] for k in range(self.count)]
            stretch = casadi.vertcat(1.0, 1.0, self.targets[-1] / problem.radian) if problem.width == 3 else 1.0
        errors = [self.watched.at(angle, self.origin, *row) for angle, row in zip(self.angles, columns, strict=True)]
        self.errors = [error * root * stretch for error, root in zip(errors, data.roots.tolist(), strict=True)]

    def _limit(self) -> None:
        """Add the rows of all limits: of the dimensions, at fixed positions, at exchange points, of the order of the points."""
        problem, angles = self.problem, self.angles
        span = self.direction * TURN if problem.closed and self.free_timing else angles[-1] - angles[0]
        begin = angles[0] + self.values[problem.start_name] if self.origin else angles[0]
        if problem.law_given:
            begin, span = self.values[problem.start_name], self.span if self.spanned else problem.span
        self.rows += limit_rows(problem, self.values, Reach(begin, span, self.direction), self.size)
        kinds = sorted({row.over_span for row in self.placed})
        for over_span in kinds:
            for angle in _fixed_positions(problem, angles, over_span):
                self.rows += self._limits_at(angle, over_span).values()
        self.first, self.further = len(self.rows), list[Any]()
        motion = level_motion(problem, self.span)
        for k in range(self.many):
            share, exchanged = self.p[self.exchanged_from + k], dict[int, ConstraintRow]()
            for over_span in kinds:
                begin, whole = required_motion(problem, angles, over_span=over_span)
                exchanged |= self._limits_at(begin + whole * share, over_span)
            self.rows += [exchanged[j] for j in range(len(self.placed))]
            if motion is not None:
                empty = [0.0] * problem.data.columns.shape[1]
                self.further.append(self.watched.at(motion[0] + motion[1] * share, self.origin, *empty))
                self.rows += self._below_largest(self.further[-1], "at its peak" if self.signed else "at another crank angle")
        if self.free_timing:
            steps = [(b - a) * self.direction for a, b in itertools.pairwise(angles)]
            self.rows += [
                ConstraintRow("requirement.points", f"order of points {i + 1} and {i + 2}", step, STEP, math.inf, DEGREES)
                for i, step in enumerate(steps)
            ]
            passed = (angles[-1] - angles[0]) * self.direction
            most = TURN - (0.0 if problem.meets_again else STEP)
            label = "points within one revolution"
            self.rows.append(ConstraintRow("requirement.points", label, passed, -math.inf, most, DEGREES))

    def _limits_at(self, angle: Any, over_span: bool) -> dict[int, ConstraintRow]:
        """Return the rows of the limits at a crank angle, by their numbers, which apply over the span or elsewhere."""
        along = along_points(self.problem, over_span=over_span)
        rows, options = self.limited.at(angle, self.origin if along else 0.0), {"place": angle, "periodic": not along}
        return {k: replace(row, value=rows[k], **options) for k, row in enumerate(self.placed) if row.over_span == over_span}

    # --- objective ---------------------------------------------------------------------------------------------------------

    def _below_largest(self, error: Any, where: str) -> Iterator[ConstraintRow]:
        """Yield the rows that keep an error, or each of several transmission cosines, below the largest one.

        They are scaled by the objective: otherwise all rows of a small error would count as active. One component has a row for
        either sign: its square would be stationary where it vanishes.
        """
        largest, parts = self.x[-1], casadi.vertsplit(error)
        if self.signed:
            upper, lower = largest - parts[0] / self.share, largest + parts[-1] / self.share
            for sign, height in (("positive", upper), ("negative", lower)):
                yield ConstraintRow(EPIGRAPH, f"{sign} error {where}", height / self.p[0], 0.0, math.inf, PLAIN)
            return
        for square in [part * part for part in parts] if self.single else [casadi.sumsqr(error)]:
            height = (largest * largest - square / self.share**2) / (self.p[0] * self.p[0])
            yield ConstraintRow(EPIGRAPH, f"deviation {where}", height, 0.0, math.inf, PLAIN)

    def _measure(self) -> None:
        """Add the rows of tolerances and of the largest deviation, and define the objective."""
        problem, data = self.problem, self.problem.data
        for i, (error, tolerance) in enumerate(zip(self.errors, data.tolerances.tolist(), strict=True)):
            if math.isfinite(tolerance):
                square = casadi.sumsqr(error[:2]) / (data.roots[i] * self.size) ** 2
                label, scale = f"distance from point {i + 1}", SquareRootScale("mm", 1e3 * self.size)
                most = (tolerance / self.size) ** 2
                self.rows.append(ConstraintRow("requirement.points", label, square, -math.inf, most, scale))
            if self.minimax:
                self.rows += self._below_largest(error, f"at point {i + 1}")
        self.residual = casadi.vertcat(*self.errors, *self.further)
        mean = self.count if self.measure.name == "rms" else 1
        self.f = self.x[-1] if self.minimax else casadi.sumsqr(self.residual) / (self.share**2 * mean)

    def nlp(self) -> NLP:
        """Return the programme."""
        problem, free = self.problem, self.problem.free
        g = casadi.vertcat(*[row.value for row in self.rows]) if self.rows else casadi.SX(0, 1)
        used = [each for each in (self.watched, self.limited) if each.places]
        at, places, senses, z = zip(*(each.terms for each in used), strict=True)
        mapped = MappedTerms(self.x, self.p, at, self.known, len(free), places, senses, z, self.f / self.p[0], g)
        f, g, residual = mapped.expanded([mapped.f, g, self.residual])
        between = (np.arange(self.many) + 0.5) / max(1, self.many)  # initially half-way between two positions of a grid
        box = [boxed(problem.quantities[v.name], v) for v in self.variables[: len(free)]]
        if self.free_timing:
            step = self.direction * TURN / self.count
            box += [(-4.0 * math.pi, 4.0 * math.pi, step * i) for i in range(self.count)]
        if self.minimax:
            box.append((0.0, math.inf, 1.0))
        x_low, x_high, x_start = np.array(box).reshape(-1, 3).T.copy()
        helpers = {EPIGRAPH, *(angle_name(i) for i in range(self.count if self.free_timing else 0))}
        position = casadi.SX.sym("position", 2)  # crank rotation from the start, tabulated output
        one = [casadi.vertcat(self.known, position[0]), casadi.vertcat(1.0, position)] if problem.law_given else None
        levels = self.watched.function.numel_out(0) if not self.signed else 2
        return NLP(
            variables=tuple(self.variables),
            fixed=self.fixed,
            rows=tuple(replace(row, value=g[k], place=None) for k, row in enumerate(self.rows)),
            measure=self.measure,
            x_start=x_start,
            x_low=x_low,
            x_high=x_high,
            p=np.array(
                [1.0, *constant_values(problem, self.constants), *([SMOOTHED] if self.smoothing else []), *between], dtype=float
            ),
            x_symbol=self.x,
            p_symbol=self.p,
            f_expression=f,
            g_expression=g,
            residual_expression=residual,
            exact=EXACT * self.share,
            factor=self.share if self.minimax else self.share**2,
            helpers=frozenset(helpers),
            place_expression=casadi.vertcat(*(0.0 if row.place is None else row.place for row in self.rows)),
            exchange_rows=(self.first, len(self.placed) + (levels if self.further else 0)),
            constants=tuple(self.constants),
            smoothing=self.smoothing,
            position_symbol=position,
            position_expression=None if one is None else self.watched.function(*one),
            mapped=mapped,
            recipe=self.recipe,
        )


SMOOTHED_BY = "smoothing"


class _Positions:
    """Positions of a traced function, and symbols for its values there."""

    def __init__(self, function: Any) -> None:
        self.function = function
        self.places: list[tuple[Any, Any, Any]] = []  # crank angle, other inputs, symbols

    def at(self, angle: Any, *senses: Any) -> Any:
        """Return symbols for the values at a further position."""
        self.places.append((angle, casadi.vertcat(*senses), casadi.SX.sym("z", self.function.numel_out(0))))
        return self.places[-1][-1]

    @property
    def terms(self) -> tuple[Any, ...]:
        """The function, its crank angles, other inputs and symbols; see `MappedTerms`."""
        return self.function, *(casadi.SX(casadi.horzcat(*each)) for each in zip(*self.places, strict=True))


# --- parameters --------------------------------------------------------------------------------------------------------------


def target_constants(problem: PathProblem) -> list[Variable]:
    """Return the components of the targets as parameters: each row of `data.columns`, and the length of a radian of poses."""
    size = problem.size
    constants = []
    for k in range(len(problem.data.columns)):
        for axis, origin in zip("xy", problem.centre, strict=True):
            constants.append(Variable(f"{TARGET}{k}.{axis}", size, Scale("mm", 1e3 * size, offset=1e3 * origin), origin))
        if problem.requirement.kind == "motion":
            constants += [Variable(f"{TARGET}{k}.{part}", 1.0, PLAIN) for part in ("cosine", "sine")]
    if problem.requirement.kind == "motion":
        constants.append(Variable(f"{TARGET}radian", size, Scale("mm", 1e3 * size)))
    return constants


def constant_values(problem: PathProblem, constants: Sequence[Variable]) -> list[Any]:
    """Return the scaled values of `NLP.constants`: fixed quantities, tolerances, the span of a law, components of the targets.

    They are arrays where the numbers of the problem are.
    """
    named: dict[str, Any] = {name: quantity.value for name, quantity in problem.quantities.items()} | problem.counted
    if any(v.name == SPAN for v in constants):
        named[SPAN] = problem.span
    if moving := [v.name for v in constants if v.name.startswith(TARGET)]:
        named |= zip(moving, [*problem.data.columns.ravel().tolist(), problem.radian], strict=False)
    return [v.scaled(named[v.name]) for v in constants]


# --- positions of limits and levels ---------------------------------------------------------------------------------------


def solved_values(task: PathProblem, design: Mapping[str, float], x: Array) -> tuple[dict[str, float], Array]:
    """Return all quantities [m, rad] of a solved programme, and its crank angles (points,) [rad]; `design` has the free ones."""
    values = {name: quantity.value for name, quantity in task.quantities.items()}
    values = task.complete(values | {name: design[name] for name in task.free})
    free = len(task.free)
    free_angles = x[free : free + len(task.data.columns)] if task.data.offsets is None else None
    return values, task.crank_angles(values, free_angles)


def required_motion(problem: PathProblem, angles: Any, *, over_span: bool = False) -> tuple[Any, Any]:
    """Return the crank angle [rad] at which the motion with position limits begins, and its rotation; see `along_points`."""
    along = along_points(problem, over_span=over_span)
    return (angles[0], angles[-1] - angles[0]) if along else (0.0, TURN)


def level_motion(problem: PathProblem, span: Any = None) -> tuple[float, Any] | None:
    """Return begin and rotation [rad] of the range over which the largest error counts, from the start; None for positions."""
    if not has_levels(problem):
        return None
    return (0.0, problem.span if span is None else span) if problem.law_given else (0.0, TURN)


def along_points(problem: PathProblem, *, over_span: bool) -> bool:
    """Return whether limits apply from the first point to the last instead of over the whole revolution.

    `over_span`: they apply there even if the crank must turn fully.
    """
    return over_span or problem.limits.crank == "span"


def _fixed_positions(problem: PathProblem, angles: list[Any], over_span: bool) -> list[Any]:
    """Return the crank angles [rad] at which position limits always apply."""
    if not along_points(problem, over_span=over_span):
        return list(np.linspace(0.0, TURN, GRID, endpoint=False))
    between = [a + (b - a) * (k / (BETWEEN + 1)) for a, b in itertools.pairwise(angles) for k in range(BETWEEN + 1)]
    return [*between, angles[-1]]


def limit_excesses(problem: PathProblem, values: Mapping[str, Value], angles: Any, shares: Array) -> Array:
    """Return the excess (rows, n) or (rows, designs, n) over every position limit, in the units of the rows.

    It is negative if satisfied, -inf if undefined; positions without assembly exceed the row of the assembly margin. `values` [m,
    rad] and the crank angles [rad] of the points are numbers or arrays (designs, 1); `shares` (n,) are positions as shares of the
    motion over which each limit applies, see `required_motion`.
    """

    def rows_over(over_span: bool) -> list[ConstraintRow]:
        begin, whole = required_motion(problem, angles, over_span=over_span)
        return position_rows(problem, problem.linkage.pose(values, unit(begin + whole * shares)))

    with np.errstate(all="ignore"):
        rows = rows_over(False)
        if any(row.over_span for row in rows):
            rows = [span_row if row.over_span else row for row, span_row in zip(rows, rows_over(True), strict=True)]
        over = [np.maximum(row.low - row.value, row.value - row.high) for row in rows]
        excesses = np.array(np.broadcast_arrays(*over, angles[0] + shares)[:-1])
    return np.where(np.isfinite(excesses), excesses, -np.inf)


def level_excesses(
    problem: PathProblem, errors: ErrorResiduals | None, values: Mapping[str, Value], largest: float, shares: Array
) -> Array:
    """Return the excesses (rows, n) of the errors over the largest one along the range where it counts; -inf if undefined.

    A row for either sign of the error of a law, one for the transmission cosine of each dyad.
    """
    motion = level_motion(problem)
    assert motion is not None
    offsets = motion[0] + motion[1] * shares
    with np.errstate(all="ignore"):
        if errors is not None:
            lower, upper = errors.band(values, offsets)
            sizes = np.array([-lower + 0.0 * shares, upper + 0.0 * shares])
        else:
            cosines = problem.deviation(problem.linkage.pose(values, unit(offsets)), values, ())
            sizes = np.array([np.abs(cosine) + 0.0 * shares for cosine in cosines])
    return np.where(np.isfinite(sizes), sizes - largest, -np.inf)
