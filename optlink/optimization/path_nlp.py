"""build_path_nlp(problem, direction) -> NLP: path and motion synthesis as one scaled nonlinear programme.

Its variables are the design variables and, without prescribed timing, the crank angle of every point.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
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
from optlink.problem.design import EPIGRAPH, STEP, DesignProblem
from optlink.problem.limits import Reach
from optlink.problem.mechanism import FourBarSection
from optlink.problem.requirement import START
from optlink.symbolic import symbols_in_numpy

GRID = 36  # crank angles at which the assembly of a mechanism other than a four-bar is checked
EXCHANGE_POINTS = 24  # further ones, moved by the exchange method to where a limit is exceeded
BETWEEN = 3  # positions between two points if full crank rotation is not required
EXACT = 1e-10  # share of the size of the curve: residual that counts as zero


def angle_name(index: int) -> str:
    """Return the name of the variable that is the crank angle of a point; points count from 1."""
    return f"crank angle of point {index + 1}"


def path_variable(problem: DesignProblem, name: str) -> Variable:
    """Return the scaling of a quantity: lengths by the size of the curve, coordinates on the frame from its centre."""
    axis = name.rpartition(".")[2] if problem.quantities[name].kind == "coordinate" else ""
    origin = problem.centre["xy".index(axis)] if axis in ("x", "y") else 0.0
    return scaled_variable(problem, name, problem.size, periodic=problem.is_periodic(name), origin=origin)


def has_position_limits(problem: DesignProblem) -> bool:
    """Return whether limits at single crank angles (`position_rows`) apply; for a four-bar the extremes are known instead."""
    return not isinstance(problem.mechanism, FourBarSection)


def has_sampled_objective(problem: DesignProblem) -> bool:
    """Return whether the objective is the largest value over the revolution: the worst transmission of linkages but four-bars."""
    return problem.requirement.kind == "transmission" and problem.measure == "max" and has_position_limits(problem)


def build_path_nlp(problem: DesignProblem, direction: int = 1, *, movable: bool = False) -> NLP:
    """Build the nonlinear programme of a path or motion synthesis problem with definite assembly modes.

    `direction` is the sense of crank rotation from point to point without prescribed timing: +1 counter-clockwise, -1 clockwise.
    `movable`: points and poses are parameters, see `target_constants`. The exchange points of the NLP are shares of the motion
    over which position limits apply, see `required_motion`.
    """
    size, share, free, data = problem.size, problem.whole, problem.free, problem.data
    fixed = tuple(name for name in problem.quantities if name not in free)
    free_timing = data.offsets is None
    single = problem.requirement.kind == "transmission"  # every dyad has a transmission angle of its own
    count, measure = len(data.columns), error_measures(problem.unit, 1 if single else problem.width)[problem.measure]
    minimax = measure.name == "max"
    variables = [path_variable(problem, name) for name in free]
    if free_timing:
        variables += [Variable(angle_name(i), 1.0, DEGREES) for i in range(count)]
    if minimax:
        variables.append(Variable(EPIGRAPH, share, Scale(problem.unit, share)))
    constants = [path_variable(problem, name) for name in fixed]
    moving = target_constants(problem) if movable and problem.pointed else []

    x = casadi.SX.sym("x", len(variables))
    many = EXCHANGE_POINTS if has_position_limits(problem) else 0
    exchanged_from = 1 + len(fixed) + len(moving)
    p = casadi.SX.sym("p", exchanged_from + many)
    values: dict[str, Any] = {v.name: v.value(x[i]) for i, v in enumerate(variables[: len(free)])}
    values |= {v.name: v.value(p[1 + i]) for i, v in enumerate(constants)}
    columns: Any = data.columns
    stretch: Any = 1.0
    if moving:
        parts = [v.value(p[1 + len(fixed) + i]) for i, v in enumerate(moving)]
        width = data.columns.shape[1]
        columns = [parts[width * k : width * (k + 1)] for k in range(count)]
        stretch = casadi.vertcat(1.0, 1.0, parts[-1] / problem.radian) if problem.requirement.kind == "motion" else 1.0
    # factor of the start angle in the crank angles of the points
    origin = 0.0 if free_timing or problem.timing != "from start" else 1.0
    if free_timing:
        angles: list[Any] = [x[len(free) + i] for i in range(count)]
    else:
        assert data.offsets is not None
        angles = data.offsets.tolist()
        direction = 1 if angles[-1] >= angles[0] else -1
    with symbols_in_numpy():
        quantities = casadi.vertcat(*(values[name] for name in problem.quantities))
        residual, (limit, placed) = _traced(problem)
        watched = _Positions(residual)
        errors = [watched.at(angle, origin, *row) for angle, row in zip(angles, columns, strict=True)]
        errors = [error * root * stretch for error, root in zip(errors, data.roots, strict=True)]
        span = direction * TURN if problem.closed and free_timing else angles[-1] - angles[0]
        begin = angles[0] + values[START] if origin else angles[0]
        rows = limit_rows(problem, values, Reach(begin, span, direction), size)
        limited = _Positions(limit)
        kinds = sorted({row.over_span for row in placed})

        def limits_at(angle: Any, over_span: bool) -> dict[int, ConstraintRow]:
            along = along_points(problem, over_span=over_span)
            rows, options = limited.at(angle, origin if along else 0.0), {"place": angle, "periodic": not along}
            return {k: replace(row, value=rows[k], **options) for k, row in enumerate(placed) if row.over_span == over_span}

        def below_largest(error: Any, label: str) -> list[ConstraintRow]:
            """Return the rows that keep an error, or each of several transmission cosines, below the largest one."""
            squares = [part * part for part in casadi.vertsplit(error)] if single else [casadi.sumsqr(error)]
            heights = [(x[-1] * x[-1] - square / share**2) / (p[0] * p[0]) for square in squares]
            return [ConstraintRow(EPIGRAPH, label, height, 0.0, math.inf, PLAIN) for height in heights]

        for over_span in kinds:
            for angle in _fixed_positions(problem, angles, over_span):
                rows += limits_at(angle, over_span).values()
        first, further = len(rows), list[Any]()
        for k in range(many):
            exchanged: dict[int, ConstraintRow] = {}
            for over_span in kinds:
                begin, whole = required_motion(problem, angles, over_span=over_span)
                exchanged |= limits_at(begin + whole * p[exchanged_from + k], over_span)
            rows += [exchanged[j] for j in range(len(placed))]
            if has_sampled_objective(problem):
                further.append(watched.at(TURN * p[exchanged_from + k], 0.0, 0.0))
                rows += below_largest(further[-1], "transmission angle at another crank angle")
        if free_timing:
            steps = [(b - a) * direction for a, b in itertools.pairwise(angles)]
            rows += [
                ConstraintRow("requirement.points", f"order of points {i + 1} and {i + 2}", step, STEP, math.inf, DEGREES)
                for i, step in enumerate(steps)
            ]
            passed = (angles[-1] - angles[0]) * direction
            most = TURN - (0.0 if problem.meets_again else STEP)
            rows.append(ConstraintRow("requirement.points", "points within one revolution", passed, -math.inf, most, DEGREES))
        for i, (error, tolerance) in enumerate(zip(errors, data.tolerances, strict=True)):
            if math.isfinite(tolerance):
                square = casadi.sumsqr(error[:2]) / (data.roots[i] * size) ** 2
                label, scale = f"distance from point {i + 1}", SquareRootScale("mm", 1e3 * size)
                rows.append(ConstraintRow("requirement.points", label, square, -math.inf, (tolerance / size) ** 2, scale))
            if minimax:
                rows += below_largest(error, f"deviation at point {i + 1}")
        vector = casadi.vertcat(*errors, *further)
        f = x[-1] if minimax else casadi.sumsqr(vector) / (share**2 * (count if measure.name == "rms" else 1))
        g = casadi.vertcat(*[row.value for row in rows]) if rows else casadi.SX(0, 1)
        at, places, senses, z = zip(*(each.terms for each in (watched, limited) if each.places), strict=True)
        mapped = MappedTerms(x, p, at, quantities, len(free), places, senses, z, f / p[0], g)
        f, g, vector = mapped.expanded([mapped.f, g, vector])

    between = (np.arange(EXCHANGE_POINTS) + 0.5) / EXCHANGE_POINTS  # initially half-way between two positions of the grid
    box = [boxed(problem.quantities[v.name], v) for v in variables[: len(free)]]
    if free_timing:
        box += [(-4.0 * math.pi, 4.0 * math.pi, direction * TURN / count * i) for i in range(count)]
    if minimax:
        box.append((0.0, math.inf, 1.0))
    x_low, x_high, x_start = np.array(box).reshape(-1, 3).T.copy()
    helpers = {EPIGRAPH, *(angle_name(i) for i in range(count if free_timing else 0))}
    return NLP(
        variables=tuple(variables),
        fixed=fixed,
        rows=tuple(replace(row, value=g[k], place=None) for k, row in enumerate(rows)),
        measure=measure,
        x_start=x_start,
        x_low=x_low,
        x_high=x_high,
        p=np.array([1.0, *constant_values(problem, [*constants, *moving]), *between[:many]]),
        x_symbol=x,
        p_symbol=p,
        f_expression=f,
        g_expression=g,
        residual_expression=vector,
        exact=EXACT * share,
        factor=share if minimax else share**2,
        helpers=frozenset(helpers),
        place_expression=casadi.vertcat(*(0.0 if row.place is None else row.place for row in rows)),
        exchange_rows=(first, len(placed) + residual.numel_out(0) * has_sampled_objective(problem)),
        constants=(*constants, *moving),
        mapped=mapped,
        recipe={"builder": "path", "direction": direction},
    )


TARGET = "target "
"""Beginning of the names of the parameters that are components of the targets."""


def target_constants(problem: DesignProblem) -> list[Variable]:
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


def constant_values(problem: DesignProblem, constants: Sequence[Variable]) -> list[float]:
    """Return the scaled values of `NLP.constants`: fixed quantities, then components of the targets."""
    quantities, numbers = problem.quantities, [*problem.data.columns.ravel().tolist(), problem.radian]
    first = next((i for i, v in enumerate(constants) if v.name.startswith(TARGET)), len(constants))
    values = [v.scaled(quantities[v.name].value) for v in constants[:first]]
    return [*values, *(v.scaled(value) for v, value in zip(constants[first:], numbers, strict=False))]


def solved_values(task: DesignProblem, design: Mapping[str, float], x: Array) -> tuple[dict[str, float], Array]:
    """Return all quantities [m, rad] of a solved programme, and its crank angles (points,) [rad]; `design` has the free ones."""
    values = {name: quantity.value for name, quantity in task.quantities.items()}
    values |= {name: design[name] for name in task.free}
    free = len(task.free)
    free_angles = x[free : free + len(task.data.columns)] if task.data.offsets is None else None
    return values, task.crank_angles(values, free_angles)


def required_motion(problem: DesignProblem, angles: Any, *, over_span: bool = False) -> tuple[Any, Any]:
    """Return the crank angle [rad] at which the motion with position limits begins, and its rotation; see `along_points`."""
    along = along_points(problem, over_span=over_span)
    return (angles[0], angles[-1] - angles[0]) if along else (0.0, TURN)


def along_points(problem: DesignProblem, *, over_span: bool) -> bool:
    """Return whether limits apply from the first point to the last instead of over the whole revolution.

    `over_span`: they apply there even if the crank must turn fully.
    """
    return over_span or problem.limits.crank == "span"


def _fixed_positions(problem: DesignProblem, angles: list[Any], over_span: bool) -> list[Any]:
    """Return the crank angles [rad] at which position limits always apply."""
    if not along_points(problem, over_span=over_span):
        return list(np.linspace(0.0, TURN, GRID, endpoint=False))
    between = [a + (b - a) * (k / (BETWEEN + 1)) for a, b in itertools.pairwise(angles) for k in range(BETWEEN + 1)]
    return [*between, angles[-1]]


def limit_excesses(problem: DesignProblem, values: Mapping[str, Value], angles: Any, shares: Array) -> Array:
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


def _traced(problem: DesignProblem) -> tuple[Any, tuple[Any, list[ConstraintRow]]]:
    """Trace the residual and the limits at one crank angle.

    Both are functions of the quantities and a crank angle, and of the factor of the start angle that is added; the residual also
    of the target.
    """
    names, width = list(problem.quantities), problem.data.columns.shape[1]
    inputs, senses = casadi.SX.sym("inputs", len(names) + 1), casadi.SX.sym("senses", 1 + width)
    quantities = {name: inputs[i] for i, name in enumerate(names)}
    angle = inputs[len(names)] + (senses[0] * quantities[START] if START in quantities else 0.0)
    pose = problem.linkage.pose(quantities, unit(angle))
    target = tuple(senses[1 + k] for k in range(width))
    residual = casadi.Function("residual", [inputs, senses], [casadi.vertcat(*problem.deviation(pose, quantities, target))])
    rows = position_rows(problem, pose) if has_position_limits(problem) else []
    limits = casadi.Function("limits", [inputs, senses[0]], [casadi.vertcat(*[row.value for row in rows])])
    return residual, (limits, rows)


class _Positions:
    """Positions of a function from `_traced`, and symbols for its values there."""

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


def objective_excess(problem: DesignProblem, values: Mapping[str, Value], largest: float, shares: Array) -> Array:
    """Return the excesses (dyads, n) of the transmission cosines over the objective along the revolution; -inf if undefined."""
    with np.errstate(all="ignore"):
        cosines = problem.deviation(problem.linkage.pose(values, unit(TURN * shares)), values, ())
        sizes = np.array([np.abs(cosine) + 0.0 * shares for cosine in cosines])
    return np.where(np.isfinite(sizes), sizes - largest, -np.inf)
