"""Result of the search of a linkage for any requirement or objective: designs with their validation, as data and JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from optlink.errors import InputError, Status
from optlink.io import Summary, finite, keeping, without
from optlink.linkage.dyads import transmitting
from optlink.linkage.extrema import extremes
from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.mechanism import Pose
from optlink.linkage.motion import sweep
from optlink.linkage.roberts import Cognate, CouplerLinkage, cognates
from optlink.linkage.stroke import SEAM, reachable
from optlink.linkage.vector2d import TURN, Array, all_finite, max_magnitude, wrapped
from optlink.optimization.output_errors import error_function
from optlink.problem.design import DesignProblem
from optlink.problem.document import Column, Document, Number, Source, adapter, entries
from optlink.problem.file import ProblemFile, fixed_design, started
from optlink.problem.targets.law import Table
from optlink.problem.terms import BACK, Term
from optlink.solvers.solution import LimitState, Relaxation, Solution
from optlink.synthesis.freudenstein import FirstStep
from optlink.tasks.machine import turning_machine
from optlink.tasks.results.certificate import Certificate, message, verdict_words
from optlink.tasks.results.common import (
    FOUND,
    INCOMPLETE,
    ROUNDED,
    SEARCHED,
    Evidence,
    Optimum,
    RejectedDesign,
    of_solution,
    verified,
)
from optlink.tasks.results.conflict import refutation
from optlink.tasks.results.exact import ExactSolutions, document
from optlink.tasks.results.fit import FINE, Fit, WayBack, fit, transmission_fit, way_back
from optlink.tasks.results.rounding import Rounding
from optlink.tasks.results.strokes import stroke_document
from optlink.units import DISPLAYED, KINDS, factor, percent
from optlink.validation import validate
from optlink.validation.check import Check, Validation
from optlink.validation.design import MeasuredDeviations, deviations
from optlink.validation.motion import transmission_angles
from optlink.validation.timing import excursions

if TYPE_CHECKING:
    from optlink.dynamics.machine import Machine
    from optlink.tasks.analyze import Analysis
    from optlink.validation.cycle import Cycle

ALONG = 2001  # positions along the span at which alternations are counted
NO_SEARCH = "none"  # back end of designs that were given, or follow from equations
DISTINCT = 1e-2  # least relative difference of two distinct designs
NO_ANGLE = 1e-9  # rad; rounding errors of an angle that is zero, or -180 deg
EXTREME_SHARE = 0.99  # fraction of the largest error that counts as an extreme value
WIDER = 1.0 + 5e-4  # ratio of the largest errors over the range and at the positions up to which the two are equal to four digits


@dataclass(frozen=True)
class TermFigure:
    """A quantity of the machine in its display unit, of the initial design and of the result; `limit` in words."""

    name: str
    words: str
    initial: Number
    result: Number
    limit: str
    unit: str


@dataclass(frozen=True, eq=False, repr=False)
class LinkageDesign(Summary):
    """One design with its validation.

    `problem` has definite assembly modes; `values` are all quantities [m, rad], `crank_angles` (points,) [rad] those of
    the points; `objective` the minimised value in its SI unit, negative for a maximised quantity.
    """

    shown: ClassVar[Mapping[str, Source]] = {
        **{name: name for name in ("valid", "status", "assembly")},
        "design": "displayed",
        "objective": "_stated_objective",
        "fit": "fit",
        "least_transmission_deg": lambda design: math.degrees(design.least_transmission),
        "strokes": "strokes",
        "figures?": lambda design: design.figures or None,
        "points": "points",
        "limits": "displayed_limits",
        "validation": "validation.checks",
        "cognates": lambda design: [_cognate_document(cognate) for cognate in design.cognates],
        **{f"{name}?": of_solution(name) for name in ("kkt", "violation", "curvature", "iterations")},
    }

    _alone: ClassVar[bool] = False  # whether it is one of `parts`

    problem: ProblemFile
    values: dict[str, Number]
    crank_angles: Column
    objective: Number
    status: Status
    validation: Validation
    solution: Solution | None = None

    @property
    def whole(self) -> DesignProblem:
        """The model of the problem."""
        return self.problem.spec

    @cached_property
    def task(self) -> DesignProblem:
        """The model of the problem with its first requirement of targets alone, if it has any."""
        return next(iter(self.whole.parts), self.whole)

    @cached_property
    def parts(self) -> tuple[LinkageDesign, ...]:
        """The design as one for each requirement alone, with the crank angles of its positions."""
        parts = []
        for task, angles in self.whole.of_parts(self.crank_angles):
            assert angles is not None
            part = replace(self, crank_angles=angles)
            vars(part).update(task=task, _alone=True)
            parts.append(part)
        return tuple(parts)

    @cached_property
    def own(self) -> dict[str, float]:
        """The quantities [m, rad] that belong to the first requirement, by their short names."""
        return self.task.own(self.values)

    @cached_property
    def _own_angles(self) -> Array:
        """The crank angles [rad] of its positions."""
        assert self.whole.parts
        return self.crank_angles[: len(self.task.data.columns)]

    @property
    def design(self) -> dict[str, float]:
        """All quantities [m, rad], as in other results."""
        return self.values

    @property
    def displayed(self) -> dict[str, float]:
        """All quantities of the problem in display units, which end the keys."""
        return self.whole.displayed(self.values)

    @property
    def valid(self) -> bool:
        """Whether the design is validated, and optimal if it was searched."""
        return verified(self.status, self.validation)

    @cached_property
    def measured(self) -> MeasuredDeviations:
        """Generated points and their deviations from the targets."""
        return deviations(self.task, self.own, self._own_angles)

    @cached_property
    def fit(self) -> Fit | None:
        """Error relative to the size of the task, or least transmission angle; None if neither is defined."""
        graded = self.task.requirement.kind == "transmission"
        if self.whole.of_cycle and self.whole.single:
            graded = self.whole.goals[0].quantity in ("transmission angle", "pressure angle")
        elif [goal.words for goal in self.whole.goals] == ["peak pressure angle"] and not self._alone:
            graded = all(part.requirement.limited for part in self.whole.parts)
        if graded:
            quantities = self.task.mechanism.quantities
            return transmission_fit(self._optimised_transmission, quantities, self.values, self.solution, self.task)
        if self.whole.composed:
            return None
        return fit(self.problem, self.values, self.crank_angles, self.measured, self.between, self.solution)

    @property
    def _optimised_transmission(self) -> float:
        """Least distance [rad] of the transmission angle from 0 and 180 deg that was optimised, of one dyad or of all."""
        if self.whole.parts:
            return self.least_transmission
        goal = self.whole.goals[0]
        angle = math.nan if self.cycle is None else self.cycle.figure(goal)
        angle = 0.5 * math.pi - angle if goal.quantity == "pressure angle" else angle
        return min(angle, math.pi - angle)

    # --- the machine over its cycle

    @cached_property
    def cycle(self) -> Cycle | None:
        """The machine in motion, with the measured quantities; None if it cannot be built."""
        return self._in_motion(self.values)

    @cached_property
    def first_cycle(self) -> Cycle | None:
        """The machine of the initial design of the file, if only quantities of the machine count."""
        return self._in_motion(self.whole.design({})) if self.whole.of_cycle else None

    def _in_motion(self, values: Mapping[str, float]) -> Cycle | None:
        from optlink.validation.cycle import cycle_of

        return cycle_of(self.whole, values)

    @cached_property
    def initial(self) -> Validation | None:
        """Checks and objective of the initial design of the file; None beside targets."""
        return validate(self.whole, self.whole.design({}), cycle=self.first_cycle) if self.whole.of_cycle else None

    @cached_property
    def figures(self) -> tuple[TermFigure, ...]:
        """Quantities of the machine in the objective, then those in the limits."""
        rows, whole = [], self.whole
        for k, goal in enumerate(whole.goals):
            name = "objective" if whole.single else f"objective {k + 1}"
            rows.append(self._figure(name, goal, f"{goal.sense}d"))
        for item in whole.bounds:
            rows.append(self._figure(item.name, item.term, str(item.interval), item.interval.unit))
        return tuple(rows)

    def _figure(self, name: str, term: Term, limit: str, unit: str = "") -> TermFigure:
        kind = self.whole.kind(term)
        unit = unit or (KINDS[kind].display if kind else "")
        size = 1.0 / factor(unit, kind) if kind else 1.0
        values = [math.nan if cycle is None else cycle.figure(term) for cycle in (self.first_cycle, self.cycle)]
        initial, result = (0.0 if kind == "angle" and abs(value) <= NO_ANGLE else size * value for value in values)
        back = self.cycle is not None and self.cycle.on_way_back(term)
        return TermFigure(name, term.words + back * BACK, initial, result, limit, unit)

    @property
    def comparison(self) -> str:
        """Comparison of the objective with that of the initial design, in words; empty without an optimum, and beside targets."""
        first, required = self.initial, self.whole.required
        if first is None or self.status not in (Status.OPTIMAL, Status.ROUNDED):
            return ""
        initial, optimal, unit, name = first.objective, self.objective, "", "objective"
        if self.whole.single:
            name = self.whole.goals[0].words
            initial, optimal, unit = self.figures[0].initial, self.figures[0].result, self.figures[0].unit
        if not math.isfinite(initial) and not required:
            what, moves = ("drive", "move through its range") if self.whole.linkage.limits else ("crank", "turn fully")
            return f"the {what} of the initial design does not {moves}"
        text, before = (f"{value:.5g} {unit}".rstrip() for value in (optimal, initial))
        if required and not first.valid:  # the middle of the bounds is not an initial design
            return f"{name} {text}"
        if not first.valid:
            return f"{name} {text} (the initial design, {before}, does not meet the limits)"
        change = percent(optimal / initial - 1.0, signed=True) if initial else ""
        return f"{name} {text}, initial design {before}" + (f" ({change})" if change else "")

    @cached_property
    def analysis(self) -> Analysis | None:
        """Cycle of the machine; None if its crank cannot turn fully, or move through its range."""
        return self._analysed(self.values)

    @cached_property
    def initial_analysis(self) -> Analysis | None:
        """Cycle of the machine of the initial design; None beside targets, or if it cannot make it."""
        return self._analysed(self.whole.design({})) if self.whole.of_cycle else None

    def _analysed(self, values: Mapping[str, float]) -> Analysis | None:
        from optlink.tasks.analyze import analyze

        try:
            analysis = analyze(fixed_design(self.problem, values))
        except InputError:
            return None
        return analysis if analysis.ranges.complete else None

    # --- the targets

    @cached_property
    def between(self) -> Array | None:
        """Excursion [m] of the traced curve between each point and the next; None for other tasks than paths."""
        return None if not self.whole.parts else excursions(self.task, self.own, self._own_angles)

    @cached_property
    def way_back(self) -> WayBack | None:
        """The rest of the curve beyond an open path; None for other tasks."""
        return way_back(self.task, self.own, self._own_angles) if self.whole.parts else None

    @property
    def follows_law(self) -> bool:
        """Whether an output is prescribed as a function of the crank angle."""
        return hasattr(self.task.requirement, "law")

    def errors(self, offsets: ArrayLike | None = None) -> Array:
        """Return generated minus prescribed output (n,) [rad or m] of a law at crank rotations from the start.

        Parameters
        ----------
        offsets : array (n,) [rad], optional
            Default: the design positions.
        """
        task, law = self.task, self.task.law
        at = law.offsets if offsets is None else np.asarray(offsets, dtype=float)
        begin, base = self.own[task.start_name], self.own.get(task.base_name, 0.0)
        motion, output = sweep(task.linkage, self.values, begin + at), task.output
        actual = motion.coordinate(output).value if task.slides else motion.body_angle(output).value
        error = np.asarray(actual, dtype=float) - law.curve(at, begin, base)
        return error if task.slides else wrapped(error)

    @cached_property
    def largest_between(self) -> float | None:
        """Largest error [rad or m] of a law over its range, or excursion [m] of a curve between two points.

        None without either, if it is the same as at the positions to four digits, and of a table that is met row by row.
        """
        if self.between is not None:
            return float(np.nanmax(self.between, initial=0.0))
        rule = self.task.requirement
        if not self.follows_law or self.task.everywhere:
            return None
        if isinstance(rule.law, Table) and getattr(rule, "spacing", "even") == "even":  # a key of some kinds
            return None
        whole = self.task.span * np.linspace(0.0, 1.0, FINE)
        at_positions, over_range = (max_magnitude(self.errors(at)) for at in (None, whole))
        return over_range if math.isfinite(over_range) and over_range > at_positions * WIDER else None

    @property
    def alternations(self) -> int:
        """Number of successive alternations of the error of a law (including tolerances) between its extreme values.

        A minimax optimum of k design variables has k + 1 of them if no limit is active.
        """
        begin, end = self.task.law.offsets[[0, -1]]
        error = error_function(self.task)(self.own, np.linspace(begin, end, ALONG))
        peaks = error[np.abs(error) >= EXTREME_SHARE * np.max(np.abs(error))]
        return 1 + int(np.sum(np.diff(np.sign(peaks)) != 0.0)) if len(peaks) else 0

    @property
    def tolerances(self) -> dict[str, float] | None:
        """Tolerances [SI] of a robust design by the name of the dimension; None for others."""
        return None if self.task.robust is None else {d.name: d.tolerance for d in self.task.deviations}

    @property
    def measure(self) -> str:
        """Name of the measure of the deviations, including the effect of tolerances if considered."""
        robust = self.task.robust
        return self.task.measure if robust is None else str(robust.named(self.task.measure))

    @property
    def exact(self) -> bool:
        """Whether it satisfies all targets that are minimised within the rounding of their decimals, and nothing else is."""
        if self.whole.composed and not self._alone:
            return not self.whole.goals and all(part.exact for part in self.parts if part.task.tolerance is None)
        return self.error <= self.level

    @property
    def error(self) -> float:
        """The objective as a deviation [m, rad or 1]: the root of a sum of squares; what is maximised as its inverse."""
        if self.perfect:
            return 0.0
        if self.whole.composed and not self._alone:
            return self.objective if self.objective >= 0.0 else -1.0 / self.objective
        value = float(self.measured.objective) if self._alone else self.objective
        return math.sqrt(max(value, 0.0)) if self.task.measure == "sum of squares" else value

    @property
    def perfect(self) -> bool:
        """Whether a pressure angle is all that is minimised, and zero but for rounding, as that of every swinging guide."""
        task = self.whole
        minimised = task.single and task.goals[0].quantity == "pressure angle" and not self._alone
        return minimised and abs(self.objective) <= NO_ANGLE and all(part.tolerance is not None for part in task.parts)

    @property
    def level(self) -> float:
        """Largest error of an exact design [m, rad or 1]."""
        count = len(self.task.data.columns) if self.task.measure == "sum of squares" else 1
        return ROUNDED * math.sqrt(count) * self.task.whole

    def alike(self, other: LinkageDesign) -> bool:
        """Return whether two designs are practically the same."""
        if self.assembly != other.assembly:
            return False
        gaps = []
        for name, quantity in self.whole.quantities.items():
            gap = abs(self.values[name] - other.values[name])
            if quantity.kind == "angle":
                gaps.append(abs(math.remainder(gap, TURN)))
            else:
                gaps.append(gap / max(self.task.size if quantity.in_metres else 0.0, abs(self.values[name])))
        return max(gaps, default=0.0) <= DISTINCT

    @property
    def crank_turns(self) -> bool:
        """Whether the crank turns fully."""
        return self.task.limits.crank != "span" and self.task.linkage.limits is None

    @property
    def rotation(self) -> tuple[float, float]:
        """Crank angle [rad] at which the requirement begins, and the rotation from there to its end, negative clockwise."""
        if not self.whole.parts:
            begin, (low, high) = self.whole.start(self.values), self.whole.linkage.extent
            return begin, math.copysign(high - low, self.whole.sense)
        if self.follows_law:
            return self.own[self.task.start_name], self.task.span
        begin, end = float(self.crank_angles[0]), float(self.crank_angles[-1])
        return begin, end - begin

    @cached_property
    def swing(self) -> tuple[float, float] | None:
        """Ends [rad] of the range in which a crank that need not turn moves; None if it turns, or cannot move so far."""
        if self.crank_turns or not self.whole.parts or self.task.linkage.limits is not None:
            return None
        ends = [end for begin, turned in (part.rotation for part in self.parts) for end in (begin, begin + turned)]
        low, high = min(ends), max(ends)
        if not 0.0 < high - low < TURN:
            return None
        ranges = reachable(self.task.linkage, self.values)
        held = (low, high) if ranges.full else ranges.holding(low)
        return (low, high) if held is not None and high <= held[1] + SEAM else None

    @cached_property
    def turning(self) -> Machine | None:
        """The machine if its crank turns fully, else None."""
        return turning_machine(self.problem, self.values) if self.swing is None else None

    @property
    def strokes(self) -> dict[str, Any]:
        """Strokes of every output, as JSON; empty if the crank does not turn fully."""
        return {} if self.turning is None else stroke_document(self.turning, self.rotation[1])

    @property
    def least_transmission(self) -> float:
        """Least distance of the transmission angle from 0 and 180 deg over the required motion [rad]; NaN if there is none."""
        low, high = self.transmission_range
        return min(low, math.pi - high)

    @cached_property
    def transmission_range(self) -> tuple[float, float]:
        """Smallest and largest transmission angle over the required motion [rad], of all dyads; NaN if there is none."""
        begin, end = self.task.linkage.extent
        if self.whole.parts and not self.crank_turns:
            begin, end = float(np.min(self.crank_angles)), float(np.max(self.crank_angles))
        groups = transmitting(self.task.linkage)

        def cosines(angles: Array) -> Array:  # smooth, unlike the angles, which have corners at 0 and pi
            gamma = transmission_angles(sweep(self.task.linkage, self.values, angles), self.task.linkage)
            return np.cos(gamma).T

        grid = np.linspace(begin, end, 721)
        if not groups or not all_finite(cosines(grid)):
            return math.nan, math.nan
        ends = np.arccos(np.clip(extremes(cosines, grid, periodic=self.crank_turns)[1], -1.0, 1.0))
        return float(np.min(ends)), float(np.max(ends))

    @cached_property
    def cognates(self) -> tuple[Cognate, ...]:
        """The other four-bars with the same coupler curve, fully turning cranks first; none for other mechanisms."""
        linkage, loop = self.coupler_linkage, self.task.four_bar
        if linkage is None or loop is None or self.whole.composed:  # they keep the curve alone
            return ()
        first = float(self.crank_angles[0] - loop.turned(self.values))  # from the frame
        try:
            others = [c for c in cognates(linkage, at=first) if c is not None]
        except InputError:  # a miss that cannot be assembled at its first point
            return ()
        return tuple(sorted(others, key=lambda c: not (c.crank_turns and c.keeps_side)))

    @property
    def coupler_linkage(self) -> CouplerLinkage | None:
        """The four-bar with its coupler point as plain numbers."""
        linkage, loop, values = self.task.linkage, self.task.four_bar, self.values
        mark = None if loop is None else linkage.marks.get((loop.coupler.body, self.task.point))
        if loop is None or mark is None:
            return None
        sizes = dict(zip(LENGTHS, map(float, loop.lengths(values)), strict=True))
        along, across = values[str(mark.along)], values[str(mark.across)]
        if loop.coupler.start != loop.pin:
            along, across = sizes["coupler"] - along, -across
        x, y = map(float, Pose(linkage, values).fixed(loop.pivots[0]))
        direction = float(loop.turned(values)) + (values[linkage.datum] if isinstance(linkage.datum, str) else linkage.datum)
        return CouplerLinkage(**sizes, along=along, across=across, x=x, y=y, direction=direction, side=loop.side)

    @property
    def machine(self) -> ProblemFile:
        """The linkage as a problem with every size fixed; its crank starts and turns as the requirement needs."""
        fixed = fixed_design(self.problem, self.values)
        return started(fixed, *self.rotation, self.swing) if self.whole.parts else fixed

    @property
    def as_problem(self) -> ProblemFile:
        """The problem with every size and angle fixed, which `optlink.validate` checks; its crank starts as required."""
        fixed = fixed_design(self.problem, self.values, checked=True)
        return started(fixed, *self.rotation) if self.whole.parts else fixed

    @property
    def assembly(self) -> object:
        """Assembly modes, in the words of the problem file."""
        return self.problem.raw["mechanism"].get("assembly", "left")

    @property
    def limits(self) -> tuple[LimitState, ...]:
        """All bounds and limits in SI."""
        return self.solution.limits if self.solution is not None else ()

    @property
    def displayed_limits(self) -> tuple[LimitState, ...]:
        """All bounds and limits in display units."""
        return self.solution.displayed_limits if self.solution is not None else ()

    @property
    def points(self) -> dict[str, Array]:
        """Crank angles, generated points and their deviations, in the unit that ends the key."""
        if not self.whole.parts:
            return {}
        measured, task = self.measured, self.task
        size, unit = DISPLAYED[task.unit]
        points: dict[str, Array] = {"crank_deg": np.degrees(self.crank_angles)}
        if task.pointed:
            points["x_mm"], points["y_mm"] = (measured.generated * 1e3).T
        elif task.requirement.kind == "transmission":
            points["transmission_deg"] = np.degrees(measured.generated)
        else:
            points[f"output_{unit}"] = measured.generated[:, 0] * size
        points[f"distance_{unit}".rstrip("_")] = measured.distances * size
        if self.between is not None:
            missing = np.full(len(measured.distances) - len(self.between), np.nan)
            points["between_mm"] = 1e3 * np.append(self.between, missing)
        if measured.turned is not None:
            points["turned_deg"] = np.where(task.target_points.posed, np.degrees(measured.turned), np.nan)
        return points

    @property
    def _stated_objective(self) -> dict[str, Any]:
        """Objective [SI], the deviations in the unit that ends the key, and what tolerances add."""
        if not self.whole.parts:
            return {"value": self.objective, "unit": self.whole.objective_unit}
        measured, task = self.measured, self.task
        size, unit = DISPLAYED[task.unit]
        objective = {
            "value": self.objective,
            "unit": self.whole.objective_unit,
            "measure": task.measure,
            f"rms_{unit}".rstrip("_"): size * math.sqrt(float(np.mean(measured.distances**2))),
            f"largest_{unit}".rstrip("_"): size * float(np.max(measured.distances)),
        }
        if self.largest_between is not None:
            objective[f"largest_between_{unit}"] = size * self.largest_between
        if measured.turned is not None:
            objective["largest_turned_deg"] = math.degrees(max_magnitude(measured.turned))
        further = {
            "alternations": self.alternations if self.follows_law and task.measure == "max" else None,
            "robust": getattr(self.task.robust, "text", None),
            "tolerances_SI": self.tolerances,
        }
        return objective | {key: value for key, value in further.items() if value is not None}

    def to_dict(self) -> dict[str, Any]:
        """Return the design as a JSON document: SI, or the unit that ends the key."""
        return finite(dict(entries(self)))  # type: ignore[no-any-return]


def _cognate_document(cognate: Cognate) -> dict[str, Any]:
    """Return another four-bar with the same coupler curve: SI, or the unit that ends the key."""
    linkage = cognate.linkage
    places = ("frame", "crank", "coupler", "rocker", "along", "across")
    return {
        **{f"{name}_mm": 1e3 * getattr(linkage, name) for name in places},
        "A.x_mm": 1e3 * linkage.x,
        "A.y_mm": 1e3 * linkage.y,
        "direction_deg": math.degrees(linkage.direction),
        "side": linkage.side,
        "inversion": cognate.inversion.value,
        **{name: getattr(cognate, name) for name in ("crank_turns", "keeps_side", "turns_as")},
    }


def _optimum_document(result: SynthesisResult, optimum: Optimum) -> dict[str, Any]:
    """Return an optimum as part of the document, its design in display units."""
    parts = {key: value for key, value in vars(optimum).items() if value != ""}
    return parts | {"design": result.definite.model.displayed(optimum.design)}


def of_best(name: str) -> Source:
    """Return the source of an entry of the best design, None without one."""
    return lambda result: None if result.best is None else attrgetter(name)(result.best)


@dataclass(frozen=True, eq=False, repr=False)
class SynthesisResult(Document):
    """Result of the search of a linkage: validated designs, best first; or the nearest invalid one and the reason.

    `evidence`: None without random starts. `first_step`: the best convex first design of a function. `optima`: the optima at
    which the local searches of a law ended, best first. `exact_solutions`: all linkages that meet five targets, usable or not.
    """

    kind = "design"
    shown: ClassVar[Mapping[str, Source]] = {
        **without(SEARCHED, "notes"),
        "starts_that_reached_the_best": "hits",
        **{f"{key}?": of_best(key) for key in ("assembly", "strokes", "fit")},
        "initial?": lambda result: (
            result.best and (given := result.best.initial) and {"objective": given.objective, "feasible": given.valid}
        ),
        "figures?": lambda result: result.figures or None,
        "design?": of_best("displayed"),
        "objective?": of_best("_stated_objective"),
        "limits": lambda result: result.best.displayed_limits if result.best else (),
        "validation": "validation.checks",
        "designs": "designs",
        "first_step?": lambda result: result.first_step and vars(result.first_step) | {"gap": result.first_step.gap},
        **FOUND,
        "optima?": lambda result: [_optimum_document(result, optimum) for optimum in result.optima] or None,
        "exact_solutions?": lambda result: (
            result.exact_solutions and document(result.exact_solutions, result.definite.model.displayed)
        ),
        "nearest_miss": lambda result: None if result.designs else result.nearest,
    }

    problem: ProblemFile
    designs: tuple[LinkageDesign, ...]
    nearest: LinkageDesign | None
    backend: str
    seconds: dict[str, float]
    seed: int | None = None
    starts: int = 0
    evidence: Evidence | None = None
    interrupted: bool = False
    notes: tuple[str, ...] = field(default=())
    conflict: tuple[Relaxation, ...] = ()
    together: tuple[Relaxation, ...] = ()
    certificate: Certificate | None = None
    backends: dict[str, Solution] = field(default_factory=dict)
    rejected: RejectedDesign | None = None
    optima: tuple[Optimum, ...] = ()
    first_step: FirstStep | None = None
    rounding: Rounding | None = None
    exact_solutions: ExactSolutions | None = None

    @classmethod
    def _restored(cls, problem: ProblemFile, values: Mapping[str, Any]) -> Self:
        """Return the result for the fields in a document; the solutions of the back ends are those of its best design."""
        result = super()._restored(problem, {**values, "backends": {}})
        context = {"problem": problem, "present": result.definite}
        return replace(result, backends=adapter(dict[str, Solution]).validate_python(values["backends"], context=context))

    @property
    def hits(self) -> int:
        """Number of starts that reached the best design."""
        return 0 if self.evidence is None else self.evidence.hits

    @property
    def incomplete(self) -> bool:
        """Whether a note states that the search may have missed the best design."""
        return any(note.startswith(INCOMPLETE) for note in self.notes)

    @cached_property
    def refuted(self) -> str:
        """Which limits exclude each other, in a sentence; empty if no limits conflict."""
        return refutation(self.conflict)

    @property
    def message(self) -> str:
        """Description of how the search ended."""
        if self.rounding is not None:
            shown = self.problem.model.shown_objective(self.rounding.objective)
            optimum = f"{shown.value:.4g} {shown.unit}".rstrip()
            return self.rounding.ended(self.objective if self.designs else math.nan, optimum)
        if self.exact_solutions is not None and self.backend == NO_SEARCH:
            return self.exact_solutions.sentence
        return message(self.status, self.certificate, self.refuted, none_better=self.none_better)

    @property
    def valid(self) -> bool:
        """Whether there is a validated design."""
        return bool(self.designs)

    @property
    def none_better(self) -> bool:
        """Whether the error that is minimised is zero to rounding, so that no design can be better."""
        fit = self.fit if self.valid and not self.problem.spec.composed else None
        return fit is not None and fit.grade == "exact"

    @property
    def best(self) -> LinkageDesign | None:
        """The best validated design; else the nearest invalid one; None if no linkage reaches the points."""
        return self.designs[0] if self.designs else self.nearest

    @property
    def machine(self) -> ProblemFile | None:
        """The best linkage with all dimensions fixed; its crank starts and turns as the requirement needs; or None."""
        return None if self.best is None else self.best.machine

    @property
    def fit(self) -> Fit | None:
        """Error of the best design relative to the size of the task; None if there is none to measure."""
        return None if self.best is None else self.best.fit

    @property
    def figures(self) -> tuple[TermFigure, ...]:
        """Quantities of the machine of the best design in objective and limits; see `LinkageDesign.figures`."""
        return () if self.best is None else self.best.figures

    @property
    def assembly(self) -> Any:
        """Assembly modes of the best design, in the words of the problem file; None without a design."""
        return None if self.best is None else self.best.assembly

    def error(self, offsets: ArrayLike | None = None) -> Array:
        """Return generated minus prescribed output of the best design of a law; see `LinkageDesign.errors`.

        Raises
        ------
        InputError
            If there is no design, or no law.
        """
        if self.best is None or not self.best.follows_law:
            message = "only a design for a law has an error at any crank rotation"
            raise InputError(message, "Use result.best.measured, the deviations from the targets", self.problem.file)
        return self.best.errors(offsets)

    @property
    def definite(self) -> ProblemFile:
        """The problem with the assembly modes of the best design."""
        return self.problem if self.best is None else self.best.problem

    @property
    def design(self) -> dict[str, float]:
        """Quantities of the best design [m, rad]; empty if there is none."""
        return {} if self.best is None else self.best.values

    @property
    def sizes(self) -> dict[str, float]:
        """Dimensions of the best linkage [SI]; empty if there is none."""
        return keeping(self.design, *self.problem.model.mechanism.quantities)

    def displayed(self, design: Mapping[str, float]) -> dict[str, float]:
        """Return the quantities [SI] of a solution in display units, which end the keys."""
        model = self.definite.model
        return model.displayed(model.design({name: design[name] for name in model.free}))

    @property
    def solution(self) -> Solution | None:
        """Solver solution of the best design."""
        return None if self.best is None else self.best.solution

    @property
    def limits(self) -> tuple[LimitState, ...]:
        """All bounds and limits of the best design, in SI; none without a search."""
        return () if self.best is None else self.best.limits

    @property
    def validation(self) -> Validation:
        """Checks of the best design."""
        return Validation((), math.nan) if self.best is None else self.best.validation

    @property
    def status(self) -> Status:
        """Status of the search."""
        if self.best is not None:
            return self.best.status
        return Status.NOT_SEARCHED if self.exact_solutions is not None and self.exact_solutions.special else Status.INFEASIBLE

    def _verdict(self) -> tuple[str, ...]:
        return verdict_words(self.status, self.valid, self.certificate, none_better=self.none_better)

    @property
    def objective(self) -> float:
        """Objective of the best design [SI]; NaN if there is none."""
        return math.nan if self.best is None else self.best.objective

    def with_checks(self, checks: Sequence[Check]) -> Self:
        """Return the result with further checks of its designs, in order; designs that fail one are no longer valid."""
        shown = self.designs or (() if self.nearest is None else (self.nearest,))
        flagged = [replace(design, validation=design.validation.with_checks(checks)) for design in shown]
        good = tuple(design for design in flagged if design.valid)
        nearest = next((design for design in flagged if not design.valid), self.nearest)
        return replace(self, designs=good, nearest=None if good else nearest)


def of_designs(
    problem: ProblemFile,
    designs: Sequence[LinkageDesign],
    count: int,
    backend: str = NO_SEARCH,
    seconds: dict[str, float] | None = None,
) -> SynthesisResult:
    """Return the result of the best `count` distinct valid designs, or of the nearest one; of two alike the first is kept.

    Without valid designs the nearest is the one that is feasible, then the one with the least objective.
    """
    distinct: list[LinkageDesign] = []
    for design in sorted((one for one in designs if one.valid), key=lambda one: one.objective):
        if not any(design.alike(other) for other in distinct):
            distinct.append(design)
    unusable = (Status.INFEASIBLE, Status.NON_FINITE)
    order = sorted(designs, key=lambda one: (one.status in unusable, one.objective if math.isfinite(one.objective) else math.inf))
    return SynthesisResult(problem, tuple(distinct[:count]), None if distinct else order[0], backend, seconds or {})
