"""build(problem, direction) -> NLP: the scaled nonlinear programme of a design problem with targets.

Its variables are the design variables, without prescribed timing the crank angle of every point, and the largest value of every
term that is minimised at its peak. Deviations, limits and quantities of the machine are traced once, at one crank angle, and
apply at the positions of the requirement, at fixed crank angles and at exchange points, which move to where a limit or a largest
value is exceeded.
"""

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import casadi
import numpy as np

from optlink.linkage.stroke import LEAST_DIFFERENCE
from optlink.linkage.vector2d import TURN, Array, unit, whole_turns
from optlink.optimization.courses import (
    EVENT,
    ErrorCourse,
    LimitCourse,
    TermCourse,
    course_again,
    exchange_count,
    extent_of,
    heights_at,
    limit_courses,
    rows_below_level,
)
from optlink.optimization.mapped_terms import MappedTerms
from optlink.optimization.nlp import NLP, Variable, boxed
from optlink.optimization.output_derivatives import traced_residuals
from optlink.optimization.parameters import SPAN, constant_values, path_variable, reused, target_constants
from optlink.optimization.terms import (
    DEGREES,
    PLAIN,
    ConstraintRow,
    Figure,
    Scale,
    SquareRootScale,
    error_measures,
    link_rows,
    millimetres,
    rows as limit_rows,
    transmission,
)
from optlink.problem.design import EPIGRAPH, STEP, DesignProblem
from optlink.problem.limits import Reach
from optlink.problem.terms import Term
from optlink.problem.tolerances import EXPECTED, SMOOTHED
from optlink.symbolic import symbols_in_numpy
from optlink.units import DISPLAYED

EXACT = 1e-10  # share of the size of the curve: residual that counts as zero
SMOOTHED_BY = "smoothing"
ROOM = 1.01  # factor on the least difference of slow and quick stroke that a programme enforces
FINE = 73  # positions through which the angle of a body that swings is followed
ASIDE = 1e-9  # share of a stroke: distance from its ends at which accelerations count that jump there by a law
EVENT_SEPARATION = 1e-3  # rad, least crank rotation between two events
RowsAt = Callable[[Any], list[ConstraintRow]]
"""Makes the rows of a course at a crank angle."""


def angle_name(index: int, suffix: str = "") -> str:
    """Return the name of the variable that is the crank angle of a point; points count from 1."""
    return f"crank angle of point {index + 1}{suffix}"


def build(problem: DesignProblem, direction: int = 1, *, movable: bool = False, terms: TermCourse | None = None) -> NLP:
    """Build the nonlinear programme of a problem with definite assembly modes.

    `direction` is the sense of crank rotation from point to point without prescribed timing: +1 counter-clockwise, -1 clockwise.
    `movable`: points and poses, and the crank rotation of an expression, are parameters. The exchange points of the NLP are
    shares of the motion over which limits and largest values apply, see `courses`. `terms`: the quantities of the machine, with
    the order of the ends of strokes for which the programme is valid; by default that of the design in the file.
    """
    if terms is None and (problem.goals or problem.bounds):
        terms = TermCourse(problem, None)
    if terms is None and not movable:
        return reused(problem, direction, lambda: _Builder(problem, direction, False, None).nlp())
    return _Builder(problem, direction, movable, terms).nlp()


def build_again(problem: DesignProblem, recipe: Mapping[str, Any]) -> NLP:
    """Return the programme of a problem that `build` has built from the parts in its `recipe`."""
    return build(problem, recipe["direction"], terms=course_again(problem, recipe))


class _Builder:
    """The expressions of a programme, in the order in which they are made."""

    def __init__(self, problem: DesignProblem, direction: int, movable: bool, terms: TermCourse | None) -> None:
        self.problem, self.direction, self.movable, self.terms = problem, direction, movable, terms
        self.recipe = {"direction": direction} | ({} if terms is None else terms.recipe)
        free, first, robust = problem.free, next(iter(problem.parts), None), problem.robust
        self.size = problem.size if problem.parts else problem.longest
        fixed = [path_variable(problem, name) for name in problem.fixed]
        self.fixed = tuple(v.name for v in fixed)
        self.variables = [path_variable(problem, name) for name in free]
        timed = [part for part in problem.parts if part.data.offsets is None]
        angles = [angle_name(i, part.suffix) for part in timed for i in range(len(part.data.columns))]
        self.variables += [Variable(name, 1.0, DEGREES) for name in angles]
        self.first_event = len(self.variables)
        self.variables += () if terms is None else terms.events
        self.first_level = len(self.variables)
        for part in filter(_levelled, problem.parts):
            scale = DEGREES if part.unit == "rad" else Scale(part.unit, part.whole)
            self.variables.append(Variable(f"{EPIGRAPH}{part.suffix}", part.whole, scale))
        self.variables += () if self.terms is None else self.terms.levels
        events = {v.name for v in self.variables[self.first_event : self.first_level]}
        self.states = frozenset({EVENT, *events} if events else ())
        self.helpers = frozenset({EPIGRAPH, *angles, *self.states, *(v.name for v in self.variables[self.first_level :])})
        self.moving = target_constants(first) if first and movable and first.pointed and robust is None else []
        self.spanned = first is not None and movable and first.movable_span
        counted = [Variable(name, self.size, millimetres(self.size)) for name in problem.counted]
        self.constants = [*fixed, *counted, *([Variable(SPAN, 1.0, DEGREES)] if self.spanned else []), *self.moving]
        self.smoothing = 1 + len(self.constants) if robust is not None and robust.text != EXPECTED else 0
        self.many = exchange_count(problem, 1 if terms is None else terms.strokes)
        self.exchanged_from = 1 + len(self.constants) + (self.smoothing > 0)
        self.x = casadi.SX.sym("x", len(self.variables))
        self.p = casadi.SX.sym("p", self.exchanged_from + self.many)
        given = {v.name: v.value(self.p[1 + i]) for i, v in enumerate(self.constants)}
        values: dict[str, Any] = {v.name: v.value(self.x[i]) for i, v in enumerate(self.variables[: len(free)])}
        values |= {name: given[name] for name in self.fixed}
        self.tolerances = {v.name: given[v.name] for v in counted}
        self.targets, self.span = [given[v.name] for v in self.moving], given.get(SPAN)
        self.rows: list[ConstraintRow] = []
        self.traced: list[_Positions] = []
        with symbols_in_numpy():
            self.values: dict[str, Any] = problem.complete(values)
            smoothing = [self.p[self.smoothing]] if self.smoothing else []
            self.known = casadi.vertcat(*self.values.values(), *self.tolerances.values(), *smoothing)
            self.blocks: list[_Targets] = []
            at, level = len(free), self.first_level
            for part in problem.parts:
                count = len(part.data.columns) if part.data.offsets is None else 0
                largest = self.x[level] if _levelled(part) else None
                self.blocks.append(_Targets(self, part, [self.x[at + i] for i in range(count)], largest))
                at, level = at + count, level + _levelled(part)
            self.machine = None if terms is None else _Machine(self, terms)
            self._limit()
            self._objective()

    def inputs(self) -> tuple[Any, Any, dict[str, Any]]:
        """Return symbols of what is known at one position: all inputs, the crank angle, and everything else by its name."""
        names = [*self.values, *self.tolerances, *([SMOOTHED_BY] if self.smoothing else [])]
        inputs = casadi.SX.sym("inputs", len(names) + 1)
        return inputs, inputs[-1], {name: inputs[i] for i, name in enumerate(names)}

    def positions(self, function: Any) -> "_Positions":
        """Return the positions of a further traced function."""
        self.traced.append(_Positions(function))
        return self.traced[-1]

    # --- limits ------------------------------------------------------------------------------------------------------------

    def _limit(self) -> None:
        """Add the rows of all limits: of the dimensions, at fixed positions, at exchange points, of the order of the points."""
        problem = self.problem
        if self.blocks:
            first, *others = (Reach(*block.reach, block.direction) for block in self.blocks)
            self.rows += limit_rows(problem, self.values, first, self.size)
            for reach in others:
                self.rows += [row for row in transmission(problem, self.values, reach, self.size) if row.over_span]
        else:
            self.rows += link_rows(problem, self.values, self.size)
        courses: list[tuple[tuple[Any, Any], RowsAt]] = []  # begin and rotation of the motion
        for course in limit_courses(problem) if self.blocks else ():
            angles = next((block.angles for block in self.blocks if block.part is course.part), None)
            rows_at = self._limit_course(course, angles)
            self.rows += [row for angle in course.fixed_positions(angles) for row in rows_at(angle)]
            courses.append((course.motion(angles), rows_at))
        if self.machine is not None:
            self.rows += self.machine.rows()
            courses += self.machine.courses()
        for block in self.blocks:
            if block.course is not None:
                courses.append((block.course.motion(self.span), block.rows_at))
        self.first = len(self.rows)
        for k in range(self.many):
            for (begin, whole), rows_at in courses:
                self.rows += rows_at(begin + whole * self.p[self.exchanged_from + k])
        self.each = (len(self.rows) - self.first) // max(1, self.many)
        for block in self.blocks:
            self.rows += block.order()

    def _limit_course(self, course: LimitCourse, angles: Any) -> RowsAt:
        """Trace the limits of a course at one crank angle; return a function that makes their rows at others."""
        inputs, place, known = self.inputs()
        part = course.part
        start = part.own(known).get(part.start_name) if part is not None and part.timing == "from start" else None
        placed = course.rows(self.problem.linkage.at(known, place if start is None else place + start))
        values = casadi.vertcat(*[row.value for row in placed])
        at = self.positions(casadi.Function("limits", [inputs, casadi.SX.sym("none", 0)], [values]))

        whole = part is None and self.problem.linkage.limits is None

        def rows_at(angle: Any) -> list[ConstraintRow]:
            z = at.at(angle)
            return [replace(row, value=z[k], place=angle, periodic=whole) for k, row in enumerate(placed)]

        return rows_at

    # --- objective ---------------------------------------------------------------------------------------------------------

    def _objective(self) -> None:
        """Define the objective: the measure of one requirement, or the weighted sum of several terms [SI]."""
        problem, block = self.problem, next(iter(self.blocks), None)
        for one in self.blocks:
            one.reduce()
        heights = [(casadi.vertcat(*one.heights), one.part.whole * one.part.worth) for one in self.blocks if _levelled(one.part)]
        if block is not None and self.terms is None and len(self.blocks) == 1 and block.part.tolerance is None:
            whole, levelled = block.part.whole, _levelled(block.part)
            self.measure, self.residual, self.exact = block.measure, block.residual, EXACT * whole
            self.factor = whole if levelled else whole**2
            self.f = self.x[-1] if levelled else block.value / self.factor
            self.heights = [(heights[0][0], whole)] if levelled else []
            return
        total = casadi.SX(0.0)
        for one in self.blocks:
            if one.part.tolerance is None:
                total += one.part.worth * one.value
        levels = iter(() if self.machine is None else self.machine.levelled)
        if self.machine is not None:
            for goal, worth in zip(self.machine.terms.goals, self.machine.terms.worths, strict=True):
                if goal.extreme:
                    level, size, values = next(levels)
                    heights.append((casadi.vertcat(*values), worth * size))
                    total += worth * size * level
                else:
                    total += worth * (-1.0 if goal.sense == "maximise" else 1.0) * self.machine.figure(goal)
        self.f = self.residual = total
        self.measure, self.factor, self.exact, self.heights = Figure("figure", problem.objective_unit), 1.0, 0.0, heights

    def nlp(self) -> NLP:
        """Return the programme."""
        problem, free = self.problem, self.problem.free
        g = casadi.vertcat(*[row.value for row in self.rows]) if self.rows else casadi.SX(0, 1)
        at, places, senses, z = zip(*(each.terms for each in self.traced if each.places), strict=True)
        mapped = MappedTerms(self.x, self.p, at, self.known, len(free), places, senses, z, self.f / self.p[0], g)
        levels = [height for height, _ in self.heights]
        f, g, residual, *levels = mapped.expanded([mapped.f, g, self.residual, *levels])
        box = [boxed(problem.quantities[v.name], v) for v in self.variables[: len(free)]]
        if self.terms is not None and (self.terms.events or not self.blocks):  # the design that has these events
            given = {k: v.scaled(self.terms.near[v.name]) for k, v in enumerate(self.variables) if v.name in self.terms.near}
            box = [(low, high, given.get(k, start)) for k, (low, high, start) in enumerate(box)]
        (low, whole), limits = extent_of(problem), problem.linkage.limits
        reached = limits or (-2.0 * problem.linkage.cycle, 2.0 * problem.linkage.cycle)
        for block in self.blocks:
            step = block.direction * whole / block.count
            first = 0.0 if limits is None else (low if step > 0.0 else low + whole) + 0.5 * step
            box += [(*reached, first + step * i) for i in range(block.count if block.free_timing else 0)]
        box += [] if self.terms is None else [(*reached, angle) for angle in self.terms.structure.angles]
        signed = [] if self.terms is None else [goal.how != "peak" for goal in self.terms.extremes]
        box += [(0.0, math.inf, 1.0)] * (len(self.variables) - len(box) - len(signed))
        box += [(-math.inf if free_sign else 0.0, math.inf, 1.0) for free_sign in signed]
        x_low, x_high, x_start = np.array(box).reshape(-1, 3).T.copy()
        between = (np.arange(self.many) + 0.5) / max(1, self.many)  # initially half-way between two positions of a grid
        smoothing = [SMOOTHED] if self.smoothing else []
        return NLP(
            variables=tuple(self.variables),
            fixed=self.fixed,
            rows=tuple(replace(row, value=g[k], place=None) for k, row in enumerate(self.rows)),
            measure=self.measure,
            x_start=x_start,
            x_low=x_low,
            x_high=x_high,
            p=np.array([1.0, *constant_values(problem, self.constants), *smoothing, *between], dtype=float),
            x_symbol=self.x,
            p_symbol=self.p,
            f_expression=f,
            g_expression=g,
            residual_expression=residual,
            exact=self.exact,
            factor=self.factor,
            helpers=self.helpers,
            states=self.states,
            terms=self.terms,
            first_event=self.first_event,
            place_expression=casadi.vertcat(*(0.0 if row.place is None else row.place for row in self.rows)),
            exchange_rows=(self.first, self.each),
            constants=tuple(self.constants),
            smoothing=self.smoothing,
            level_symbols=tuple(levels),
            first_level=self.first_level,
            level_slopes=tuple(slope for _, slope in self.heights),
            mapped=mapped,
            recipe=self.recipe,
            cycle=not self.blocks,
            **(self.blocks[0].one_position() if self.blocks else {}),
        )


def _levelled(part: DesignProblem) -> bool:
    """Return whether the largest deviation of a requirement is minimised."""
    return part.tolerance is None and part.measure == "max"


class _Targets:
    """The targets of one requirement: positions, the errors there, and what becomes of them.

    `angles`: unknown crank angles of its points, if they are; `level`: the largest deviation, if it is minimised.
    """

    def __init__(self, of: _Builder, part: DesignProblem, angles: list[Any], level: Any) -> None:
        self.of, self.part, self.level = of, part, level
        self.count, self.free_timing = len(part.data.columns), part.data.offsets is None
        robust, single = part.robust, part.width == 1 or part.separate
        expected = robust is not None and robust.text == EXPECTED
        banded = robust is not None and not expected
        self.pairs = banded and single  # residuals are the ends of error bands
        self.scattered = banded and not single  # the last residual is the scatter of the vector of the others
        self.signed = self.pairs or (part.width == 1 and not part.separate)
        self.drawn = robust is not None and bool(np.any(np.isfinite(part.data.tolerances)))  # deviations of points follow
        width = 1 if part.separate or banded else part.width
        self.measure = error_measures(part.unit, width * (1 + len(part.deviations)) if expected else width)[part.measure]
        self.course = ErrorCourse(part) if part.everywhere else None
        self.own = part.own(of.values)
        self.heights: list[Any] = []
        self.further: list[Any] = []
        self._trace()
        self._time(angles)

    def _trace(self) -> None:
        """Trace the residual at a crank angle; the further inputs are the factor of the start angle, and the target."""
        part = self.part
        inputs, place, known = self.of.inputs()
        known = part.own(known)
        senses = casadi.SX.sym("senses", 1 + part.data.columns.shape[1])
        start = known.get(part.start_name)
        angle = place + (senses[0] * start if start is not None else 0.0)
        target = tuple(casadi.vertsplit(senses[1:]))
        if part.law_given:
            target = (place, *target[1:])  # the crank rotation itself, which may be an unknown
        if part.robust is None:
            parts = part.deviation(part.linkage.at(known, angle), known, target)
        else:
            parts = traced_residuals(part, known, angle, target, known.get(SMOOTHED_BY, 0.0) * part.whole)
            parts += part.deviation(part.linkage.at(known, angle), known, target)[:2] if self.drawn else []
        self.watched = self.of.positions(casadi.Function("residual", [inputs, senses], [casadi.vertcat(*parts)]))

    def one_position(self) -> dict[str, Any]:
        """Return symbols of a position of a law, its crank rotation and tabulated output, and the residual there."""
        if not self.part.law_given:
            return {}
        position = casadi.SX.sym("position", 2)
        inputs = casadi.vertcat(self.of.known, position[0]), casadi.vertcat(1.0, position)
        return {"position_symbol": position, "position_expression": self.watched.function(*inputs)}

    def _time(self, angles: list[Any]) -> None:
        """Define the crank angles of the positions, from the start if there is one, and the errors there."""
        part, data, of = self.part, self.part.data, self.of
        self.origin = 0.0 if self.free_timing or part.timing != "from start" else 1.0  # factor of the start angle
        self.direction, self.angles = of.direction, angles
        if data.offsets is not None:
            self.angles = data.offsets.tolist()
            self.direction = 1 if self.angles[-1] >= self.angles[0] else -1
            if of.spanned:
                self.angles = [of.span * (offset / part.span) for offset in self.angles]
        columns: Any = data.columns.tolist()
        stretch: Any = 1.0
        if of.moving:
            width = data.columns.shape[1]
            columns = [of.targets[width * k : width * (k + 1)] for k in range(self.count)]
            stretch = casadi.vertcat(1.0, 1.0, of.targets[-1] / part.radian) if part.width == 3 else 1.0
        errors = [self.watched.at(angle, self.origin, *row) for angle, row in zip(self.angles, columns, strict=True)]
        if part.pointed:  # deviations of the points as drawn, for their tolerances
            self.places = [error[-2:] if self.drawn else error[:2] for error in errors]
        errors = [error[:-2] if self.drawn else error for error in errors]
        self.errors = [error * root * stretch for error, root in zip(errors, data.roots.tolist(), strict=True)]

    @property
    def reach(self) -> tuple[Any, Any]:
        """Crank angle [rad] at which the requirement begins, and its rotation."""
        if self.part.law_given:
            return self.own[self.part.start_name], self.of.span if self.of.spanned else self.part.span
        begin = self.angles[0] + self.own[self.part.start_name] if self.origin else self.angles[0]
        whole = self.part.closed and self.free_timing
        return begin, self.direction * TURN if whole else self.angles[-1] - self.angles[0]

    def order(self) -> Iterator[ConstraintRow]:
        """Yield the rows that keep points without prescribed timing in order, within one revolution."""
        if not self.free_timing:
            return
        key, suffix = f"{self.part.key}.points", self.part.suffix
        for i, (a, b) in enumerate(itertools.pairwise(self.angles)):
            label = f"order of points {i + 1} and {i + 2}{suffix}"
            yield ConstraintRow(key, label, (b - a) * self.direction, STEP, math.inf, DEGREES)
        if self.part.linkage.limits is not None:
            return
        passed, most = (self.angles[-1] - self.angles[0]) * self.direction, TURN - (0.0 if self.part.meets_again else STEP)
        yield ConstraintRow(key, f"points within one revolution{suffix}", passed, -math.inf, most, DEGREES)

    def rows_at(self, angle: Any) -> list[ConstraintRow]:
        """Return the rows of the largest error, or of its limit, at a further crank angle."""
        self.further.append(self.watched.at(angle, self.origin, *[0.0] * self.part.data.columns.shape[1]))
        return list(self._below(self.further[-1], "at its peak" if self.signed else "at another position"))

    def _below(self, error: Any, where: str) -> Iterator[ConstraintRow]:
        """Yield the rows that keep an error, or each of several transmission cosines, below the largest one or the tolerance.

        One component has a row for either sign: its square would be stationary where it vanishes. Alone, the largest one scales
        its rows: otherwise all rows of a small error would count as active.
        """
        parts, whole, most = casadi.vertsplit(error), self.part.whole, self.part.tolerance
        squares = [part * part / whole**2 for part in parts] if self.part.separate else [casadi.sumsqr(error) / whole**2]
        if most is None:
            scale = self.of.p[0] if len(self.of.variables) == self.of.first_level + 1 else 1.0
            if self.signed:
                self.heights += [casadi.fabs(part) / whole for part in parts]
                for high, low in zip(parts[::2], parts[1::2], strict=True) if self.pairs else [(parts[0], parts[0])]:
                    upper, lower = self.level - high / whole, self.level + low / whole
                    yield ConstraintRow(EPIGRAPH, f"positive error {where}", upper / scale, 0.0, math.inf, PLAIN)
                    yield ConstraintRow(EPIGRAPH, f"negative error {where}", lower / scale, 0.0, math.inf, PLAIN)
                return
            if self.scattered:  # a cone: the length of the vector is at most the largest one less its scatter
                room, square = self.level - parts[-1] / whole, casadi.sumsqr(error[:-1]) / whole**2
                self.heights.append(casadi.sqrt(square) + parts[-1] / whole)
                yield ConstraintRow(EPIGRAPH, f"scatter {where}", room / scale, 0.0, math.inf, PLAIN)
                yield ConstraintRow(EPIGRAPH, f"deviation {where}", (room * room - square) / scale**2, 0.0, math.inf, PLAIN)
                return
            for square in squares:
                self.heights.append(casadi.sqrt(square))
                height = (self.level * self.level - square) / (scale * scale)
                yield ConstraintRow(EPIGRAPH, f"deviation {where}", height, 0.0, math.inf, PLAIN)
            return
        assert self.part.interval is not None
        low, high = (bound / whole for bound in self.part.interval)
        (key, label), (factor, unit_of) = self.part.requirement.limited_by, DISPLAYED[self.part.unit]
        key, label, bound = f"{self.part.key}.{key}", f"{label}{self.part.suffix}", high
        stated, offset = self.part.requirement.stated(self.part)
        if offset is not None:
            scale_of = Scale(unit_of, factor * whole * stated, offset=factor * offset)
            yield ConstraintRow(key, label, parts[0] / whole, low, high, scale_of)
            return
        if self.signed:
            for value in (parts[0], -parts[-1]):
                yield ConstraintRow(key, label, value / whole, -math.inf, bound, Scale(unit_of, factor * whole * stated))
            return
        for square in squares:
            yield ConstraintRow(key, label, square, -math.inf, bound**2, SquareRootScale(unit_of, factor * whole))

    def reduce(self) -> None:
        """Reduce the deviations: rows of the tolerances, and of the largest one or the limited measure; `value` [SI]."""
        data, part, of = self.part.data, self.part, self.of
        for i, (error, tolerance) in enumerate(zip(self.errors, data.tolerances.tolist(), strict=True)):
            if math.isfinite(tolerance):
                square = casadi.sumsqr(self.places[i]) / part.size**2
                label, scale = f"distance from point {i + 1}{part.suffix}", SquareRootScale("mm", 1e3 * part.size)
                most = (tolerance / part.size) ** 2
                of.rows.append(ConstraintRow(f"{part.key}.points", label, square, -math.inf, most, scale))
            if part.measure == "max":
                place = f"{math.degrees(part.law.offsets[i]):.4g} deg from the start" if part.law_given else f"at point {i + 1}"
                of.rows += self._below(error, place)
        errors = [*self.errors, *self.further]
        if self.scattered:  # of a vector with scatter its largest length
            errors = [casadi.norm_2(error[:-1]) + error[-1] for error in errors]
        self.residual = casadi.vertcat(*errors)
        if part.measure == "max":
            self.value = 0.0 if self.level is None else part.whole * self.level
            return
        self.value = casadi.sumsqr(self.residual) / (self.count if part.measure == "rms" else 1)
        if part.measure == "rms" and not (of.terms is None and len(of.problem.parts) == 1 and part.tolerance is None):
            if part.tolerance is not None:
                factor, unit_of = DISPLAYED[part.unit]
                scale, most = SquareRootScale(unit_of, factor * part.whole), (part.tolerance / part.whole) ** 2
                row = self.value / part.whole**2
                of.rows.append(ConstraintRow(f"{part.key}.tolerance", f"rms{part.suffix}", row, -math.inf, most, scale))
            self.value = casadi.sqrt(self.value)


class _Machine:
    """The quantities of the machine: ends of strokes, positions along each stroke, and the rows and figures of the terms."""

    def __init__(self, of: _Builder, terms: TermCourse) -> None:
        self.of, self.terms, self.trace, self.structure = of, terms, terms.trace, terms.structure
        self.events = [of.x[of.first_event + k] for k in range(len(terms.events))]
        self.levels = [of.x[len(of.variables) - len(terms.levels) + k] for k in range(len(terms.levels))]
        self.heights: list[list[Any]] = [[] for _ in self.levels]
        self.known = casadi.vertcat(*[of.values[name] for name in self.trace.names])
        edges = self.trace.edges(self.events[: terms.cuts])
        self.strokes = []  # begin, rotation and senses of motion
        for begin, end in itertools.pairwise(edges):
            span = end - begin
            self.strokes.append((begin, span, self.trace.sensed(casadi.vertcat(self.known, begin + 0.5 * span))))
        inputs, place, known = of.inputs()
        senses = casadi.SX.sym("senses", self.trace.at.size1_in(1))
        signals = self.trace.at(casadi.vertcat(*[known[name] for name in self.trace.names], place), senses)
        self.at = of.positions(casadi.Function("terms", [inputs, senses], [signals]))
        self.nodes = [
            (j, weight * span, self.at.at(begin + share * span, senses))
            for j, (begin, span, senses) in enumerate(self.strokes)
            for share, weight in zip(*terms.nodes, strict=True)
        ]
        self.there = [self.trace.at_event(casadi.vertcat(self.known, phi)) for phi in self.events]

    # --- rows

    def rows(self) -> Iterator[ConstraintRow]:
        """Yield the rows of the events, of the figures, and of the terms at the fixed positions of every stroke."""
        yield from self._at_events()
        yield from self._slow()
        for limit in self.terms.fixed_limits:
            yield limit.row(self.figure(limit.bound.term))
        for *_, signals in self.nodes:
            yield from self._rows_of(signals)
        for begin, span, senses in self.strokes if self.terms.ended else ():  # forces are often largest where they jump
            for share in (ASIDE, 1.0 - ASIDE) if self.trace.divided_by_laws else (0.0, 1.0):
                yield from self._rows_of(self.at.at(begin + share * span, senses))

    def courses(self) -> Iterator[tuple[tuple[Any, Any], RowsAt]]:
        """Yield begin and rotation of every stroke, and a function that makes the rows of the terms there."""
        for begin, span, senses in self.strokes:
            yield (begin, span), functools.partial(self._rows_at, senses)

    def _rows_at(self, senses: Any, angle: Any) -> list[ConstraintRow]:
        return list(self._rows_of(self.at.at(angle, senses)))

    def _rows_of(self, signals: Any) -> Iterator[ConstraintRow]:
        """Yield the rows of limits and largest values at one position."""
        for limit in self.terms.limits:
            yield from limit.rows_at(self.terms.parts(limit.bound.term, signals))
        for k, (goal, size) in enumerate(zip(self.terms.extremes, self.terms.sizes, strict=True)):
            parts = self.terms.parts(goal, signals)
            yield from rows_below_level(goal, size, self.levels[k], parts)
            self.heights[k] += heights_at(goal, size, parts)
        yield from self.terms.alignment_rows(signals)

    @property
    def levelled(self) -> Iterator[tuple[Any, float, list[Any]]]:
        """Largest value of every term that is minimised at its peak, its unit [SI], and the values whose largest it is."""
        return zip(self.levels, self.terms.sizes, self.heights, strict=True)

    def _at_events(self) -> Iterator[ConstraintRow]:
        """Yield the equations of the events, whose functions vanish there, and their order."""
        speed, size = abs(self.trace.speed), self.of.size
        for k, (which, there) in enumerate(zip(self.structure.which, self.there, strict=True)):
            event = self.trace.events[which]
            label = f"{EVENT} {k + 1}: {' '.join(event.key)}"
            yield ConstraintRow(EVENT, label, there[which] / event.unit(size, speed), 0.0, 0.0, PLAIN)
        cuts = self.terms.cuts
        angles = [*self.structure.angles[:cuts], self.structure.angles[0] + self.trace.high] if cuts > 1 else []
        if self.trace.limited:
            angles = self.trace.edges(self.structure.angles[:cuts]) if cuts else []
        for k, ((_, span, _), (begin, end)) in enumerate(zip(self.strokes, itertools.pairwise(angles), strict=False)):
            if end - begin > EVENT_SEPARATION:  # otherwise both always coincide in this machine
                yield ConstraintRow(EVENT, f"order of {EVENT} {k + 1}", span, EVENT_SEPARATION, math.inf, DEGREES)

    def _slow(self) -> Iterator[ConstraintRow]:
        """Yield rows that keep the slow stroke slower: of loads by a least difference, of time ratios that are not limited so."""
        for name, which in self.trace.paced_loads.items() if self.events else ():
            label = f"slow minus quick stroke of {name}"
            least = ROOM * LEAST_DIFFERENCE
            yield ConstraintRow(f"loads.{name}.stroke", label, self._slower(which), least, math.inf, DEGREES)
        implied = set()  # terms whose limit makes the slow stroke the longer one
        for bound in self.of.problem.bounds:
            if (bound.interval.high if bound.term.stroke == "quick" else bound.interval.low) is not None:
                implied.add(id(bound.term))
        for term in self.trace.terms:
            if term.by_pace and id(term) not in implied:
                label = f"slow minus quick stroke of {term.of}"
                yield ConstraintRow(EVENT, label, self._slower(self.trace.event_of(term)), 0.0, math.inf, DEGREES)

    # --- strokes

    def _forward_slow(self, which: int) -> bool:
        """Return whether the forward stroke of a motion counts as the slow one."""
        return self.structure.slow[self.trace.paced.index(which)] is not False

    def _slower(self, which: int) -> Any:
        """Return the crank rotation [rad] by which the slow stroke is longer than the quick one."""
        slow = self._forward_slow(which)
        return self._duration(which, slow) - self._duration(which, not slow)

    def _reversals(self, which: int) -> list[int]:
        """Return the indices of the events at which an output reverses."""
        return [k for k, event in enumerate(self.structure.which) if event == which]

    def _forward(self, which: int) -> list[bool]:
        """Return for every stroke whether an output, whose reversals separate strokes, moves forward."""
        indices = [k for k in self._reversals(which) if k < self.terms.cuts]
        if not indices:
            return [True] * len(self.strokes)
        state, intervals = not self.structure.rising[indices[0]], []
        for k in range(self.terms.cuts):
            state = self.structure.rising[k] if k in indices else state
            intervals.append(state)
        return intervals * self.trace.repeats

    def _duration(self, which: int, forward: bool) -> Any:
        """Return the crank rotation [rad] during which an output, which reverses at an event, moves forward or backward."""
        indices = self._reversals(which)
        total, angles = casadi.SX(0.0), [*(self.events[k] for k in indices), self.events[indices[0]] + self.trace.high]
        for k, (begin, end) in zip(indices, itertools.pairwise(angles), strict=True):
            if self.structure.rising[k] is forward:
                total += end - begin
        return total

    # --- figures

    def figure(self, term: Term) -> Any:
        """Return the expression of a term with a single value [SI]."""
        if term.how in ("rms", "mean"):
            total = casadi.SX(0.0)
            for _, weight, signals in self.nodes:
                parts = self.terms.parts(term, signals)
                total += weight * (sum(part * part for part in parts) if term.how == "rms" else parts[0])
            mean = total / self.terms.whole
            return casadi.sqrt(mean) if term.how == "rms" else mean
        if term.quantity == "length":
            return self.of.values[str(term.of)]
        if term.quantity == "total length":
            total, loop = sum(self.of.values[name] for name in self.of.problem.lengths), self.of.problem.placed_frame
            return total if loop is None else total + np.abs(loop.frame(self.of.values)[0])
        if term.quantity == "work":
            return self._work(term)
        return self._ratio(term) if term.quantity == "time ratio" else self._stroke(term)

    def _work(self, term: Term) -> Any:
        """Return the work of the drive per revolution, or in the strokes in which a slider moves one way, mean over a cycle."""
        last = sum(self.trace.widths) - 1
        way = [True] * len(self.strokes)
        if term.stroke is not None:
            way = [forward is (term.stroke == "forward") for forward in self._forward(self.trace.event_of(term))]
        total = casadi.SX(0.0)
        for stroke, weight, signals in self.nodes:
            if way[stroke]:
                total += weight * self.trace.direction * signals[last]
        return total if self.trace.limited else total / round(self.terms.whole / TURN)

    def _stroke(self, term: Term) -> Any:
        """Return the distance between the outermost dead centres of an output, or for the term "end" one of these positions.

        Which dead centres are outermost is decided by their positions at the design that determines the order of events.
        """
        before = itertools.takewhile(lambda other: other is not term, self.trace.ended)
        width, *widths = (2 if self.of.problem.kind(each) == "angle" else 1 for each in (term, *before))
        place = len(self.trace.events) + sum(widths)
        ends, inputs = self._reversals(self.trace.event_of(term)), self.trace.inputs(self.terms.near)
        there, angles = {k: self.there[k] for k in ends}, {k: self.structure.angles[k] for k in ends}
        if self.trace.limited:
            for k, at in ((-1, self.trace.low), (len(self.events), self.trace.high)):
                there[k], angles[k] = self.trace.at_event(casadi.vertcat(self.known, at)), at
            ends = sorted(there)
        numbers = np.array([np.ravel(self.trace.at_event([*inputs, angles[k]])) for k in ends])
        positions = numbers[:, place]
        if width == 2:  # the direction of a body, followed through the motion between these positions
            count = FINE * whole_turns(self.trace.high - self.trace.low)
            fine = np.unique(np.concatenate([np.linspace(self.trace.low, self.trace.high, count), [angles[k] for k in ends]]))
            axes = np.array([np.ravel(self.trace.at_event([*inputs, at]))[place : place + 2] for at in fine])
            positions = np.interp([angles[k] for k in ends], fine, np.unwrap(np.arctan2(axes[:, 1], axes[:, 0])))
        low, high = ends[int(np.argmin(positions))], ends[int(np.argmax(positions))]
        if width == 1:
            if term.quantity == "end":
                return there[high if term.stroke == "forward" else low][place]
            return there[high][place] - there[low][place]
        (a, b), (c, d) = ((there[k][place], there[k][place + 1]) for k in (low, high))
        swing = float(np.ptp(positions)) if self.trace.limited else 0.0  # which may be more than half a turn
        sine, cosine, (near_cosine, near_sine) = a * d - b * c, a * c + b * d, unit(swing)
        return swing + casadi.atan2(sine * near_cosine - cosine * near_sine, cosine * near_cosine + sine * near_sine)

    def _ratio(self, term: Term) -> Any:
        """Return the ratio of the durations of two strokes; which one is slow is fixed in a programme."""
        which = self.trace.event_of(term)
        forward = self._forward_slow(which) is (term.stroke != "quick") if term.by_pace else term.stroke == "forward"
        return self._duration(which, forward) / self._duration(which, not forward)


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
        angles, senses, z = zip(*self.places, strict=True)
        return self.function, casadi.SX(casadi.horzcat(*angles)), casadi.SX(casadi.horzcat(*senses)), casadi.horzcat(*z)


# --- solved programmes --------------------------------------------------------------------------------------------------------


def solved_values(task: DesignProblem, design: Mapping[str, float], x: Array) -> tuple[dict[str, float], Array]:
    """Return all quantities [m, rad] of a solved programme, and its crank angles (points,) [rad]; `design` has the free ones."""
    values = {name: float(value) for name, value in task.complete({name: design[name] for name in task.free}).items()}
    free = len(task.free)
    if not task.parts:
        return values, np.zeros(0)
    count = sum(len(part.data.columns) for part in task.parts if part.data.offsets is None)
    return values, task.crank_angles(values, x[free : free + count] if count else None)
