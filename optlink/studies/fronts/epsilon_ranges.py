"""Objectives of a Pareto front as they are written, and the ranges of their limits.

A range lies between the best of the other objectives and the best of the constrained one.

A machine optimised over its cycle has terms ("peak torque", "guide force in F", "stroke of ram"), dimensions ("crank.length"),
its limits by name, and the `objective` of the file. A design for targets has `error`, the measure of their deviations
(`walk.error` of the requirement `walk` of several), any movable side of a limit or of a design variable:
`limits.transmission_angle.max`, `mechanism.coupler.max`, and terms of its machine ("total length", "peak torque").
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from optlink.errors import InputError, Status, given_as
from optlink.linkage.vector2d import Array, all_finite
from optlink.optimization.programme import angle_name, build
from optlink.problem.file import ProblemFile
from optlink.problem.rounding import NO_GRID
from optlink.solvers.exchange import place_at_peaks
from optlink.solvers.infeasibility import tightest
from optlink.studies.fronts.design_objectives import (
    ERROR,
    OPTION,
    ParetoObjective,
    cycle_figures,
    cycle_objective,
    design_figures,
    design_objective,
    design_problem,
    epsilon_problem,
    error_display,
    limit_in_file,
    limited_objective,
    range_values,
    tightest_bound,
    without_varied_limits,
)
from optlink.studies.grid import Axis, Grid, Raw, axis_of, exact_text
from optlink.studies.reoptimise_task import near_design, with_starting_values
from optlink.tasks import design as targets
from optlink.tasks.certify import automatic
from optlink.tasks.protocol import completed
from optlink.tasks.run import solve
from optlink.units import UnitProblem, factor

Once = Callable[[str, Callable[[], Mapping[str, Any]]], Mapping[str, Any]]
"""(name, search) -> what the search finds, fit for JSON, done now or before"""

END_RELAXATION = 1e-4  # relative relaxation of an objective at its own end, where the others could not change otherwise
MIN_RANGE = 1e-6  # relative; an objective that varies less has no trade-off
RELAXATIONS = (END_RELAXATION, 1e-3, 1e-2, 0.1)
"""Shares of the extent of a front: a tight end is relaxed by the first with which a design is valid."""
ROUNDING = 1e-6  # share of the last digit of a limit that is rounding


class NoExtreme(InputError):
    """An end of the front that cannot be found."""


@dataclass(frozen=True)
class EpsilonRanges(ABC):
    """Ranges of the epsilon constraints of a front; each kind of problem with objectives has its class in `RANGES`.

    `first`: index of the minimised objective; `count`: values of every limit without a requested range.
    """

    problem: ProblemFile
    objectives: tuple[ParetoObjective, ...]
    first: int
    count: int
    backend: str

    @staticmethod
    @abstractmethod
    def objective(problem: ProblemFile, name: str, number: int) -> ParetoObjective:
        """Return the objective of a name, the `number`-th of the front."""

    @staticmethod
    def limited(problem: ProblemFile, objective: ParetoObjective) -> ParetoObjective:
        """Return an objective as it is constrained."""
        return objective

    @cached_property
    def constrained(self) -> tuple[int, ...]:
        """Indices of the constrained objectives."""
        return tuple(k for k in range(len(self.objectives)) if k != self.first)

    @cached_property
    def fixed(self) -> dict[int, Axis]:
        """Values of the limits with a requested range, by the index of the objective."""
        values = {}
        for k in self.constrained:
            objective = self.objectives[k]
            if objective.span:
                with self._blamed(objective):
                    values[k] = _requested(objective, self.count, partial(self._with, k))
        return values

    @cached_property
    def open(self) -> tuple[int, ...]:
        """Indices of the objectives whose ranges have to be searched."""
        return tuple(k for k in self.constrained if k not in self.fixed)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of every limit."""
        return tuple(len(self.fixed[k].values) if k in self.fixed else self.count for k in self.constrained)

    @property
    @abstractmethod
    def searches(self) -> int:
        """Number of searches for the ranges that were not requested."""

    def search(self, once: Once) -> tuple[ProblemFile, Grid, tuple[Mapping[str, float], ...]]:
        """Return the problem with one minimised objective, the grid of the limits of the others, and the machines at the ends.

        The machines (dimensions [SI]) are empty if no ends were searched.
        """
        ranges, anchors = self._ends(once) if self.open else ({}, ())
        axes = {**self.fixed, **ranges}
        return self._base(axes, anchors), Grid(tuple(axes[k] for k in self.constrained)), anchors

    @abstractmethod
    def figures(self, problem: ProblemFile, values: Mapping[str, float], error: float) -> tuple[float, ...]:
        """Return the objectives of a point of the front in their units."""

    @abstractmethod
    def reference(self, base: ProblemFile, once: Once) -> tuple[str, tuple[float, ...] | None]:
        """Return the reference of the front: its name, and its objectives if it has any."""

    @abstractmethod
    def _ends(self, once: Once) -> tuple[dict[int, Axis], tuple[Mapping[str, float], ...]]:
        """Return the ranges of the limits that were not requested, and the machines at the ends."""

    @abstractmethod
    def _base(self, axes: Mapping[int, Axis], anchors: tuple[Mapping[str, float], ...]) -> ProblemFile:
        """Return the problem of the grid."""

    @abstractmethod
    def _with(self, number: int, value: Raw) -> ProblemFile:
        """Return the problem with a value of the limit that constrains an objective."""

    def _blamed(self, objective: ParetoObjective) -> AbstractContextManager[None]:
        """Attribute errors to the objective."""
        text = f"{objective.text}={objective.span}" if objective.span else objective.text
        return given_as(self.problem.file, OPTION, text)

    def _no_end(self, objective: ParetoObjective, why: str) -> NoExtreme:
        remedy = f'Give a range: "{objective.text}=LOW..HIGH{" " + objective.unit if objective.unit else ""}"'
        return NoExtreme(
            f"the end with the {objective.best} cannot be found: {why}", remedy, self.problem.file, OPTION, objective.text
        )


class _DesignRanges(EpsilonRanges):
    """Ranges of a design for targets: from the optimum of the minimised objective alone to the tightest feasible limit."""

    objective, limited = staticmethod(design_objective), staticmethod(limited_objective)

    @cached_property
    def bare(self) -> ProblemFile:
        """Problem without the limits of the constrained objectives."""
        return without_varied_limits(self.problem, [self.objectives[k] for k in self.constrained])

    @property
    def searches(self) -> int:
        """Number of searches for the ranges that were not requested."""
        return (1 + len(self.open) + (len(self.constrained) if len(self.constrained) > 1 else 0)) if self.open else 0

    def figures(self, problem: ProblemFile, values: Mapping[str, float], error: float) -> tuple[float, ...]:
        minimised, model = self.objectives[self.first], problem.spec
        if minimised.key and (minimised.part < 0 or model.by_angle):
            return design_figures(problem, self.objectives, values)
        figures = list(design_figures(problem, [self.objectives[k] for k in self.constrained], values))
        if minimised.key:  # that of the optimiser, with its digits
            part = model.parts[minimised.part]
            figures.insert(self.first, error * error_display(part)[0] / part.worth)
        else:
            figures.insert(self.first, error * model.objective_display[0])
        return tuple(figures)

    def reference(self, base: ProblemFile, once: Once) -> tuple[str, tuple[float, ...] | None]:
        words, limited = "limits of the file", [self.objectives[k] for k in self.constrained]
        if any(one.part >= 0 or one.term or limit_in_file(self.problem, one.key) is None for one in limited):
            return words, None

        def searched() -> dict[str, Any]:
            result = self._optimum(self._bounded(self.problem, {}))
            return {"design": dict(result.design), "error": result.objective} if result.valid else {}

        best = once(words, searched)
        if not best:
            return words, None
        tight = self._bounded(base, {k: tightest_bound(base, self.objectives[k]) for k in self.constrained})
        return words, self.figures(tight, best["design"], best["error"])

    def _optimum(self, problem: ProblemFile) -> Any:
        """Return the optimum that `optlink.solve` finds, certified if there are few design variables."""
        return completed(solve(problem, self.backend, rounding=NO_GRID))

    def _bounded(self, problem: ProblemFile, bounds: Mapping[int, Raw], minimised: int | None = None) -> ProblemFile:
        return design_problem(problem, self.objectives, self.first if minimised is None else minimised, bounds)

    def _with(self, number: int, value: Raw) -> ProblemFile:
        return self._bounded(self.bare, {number: value})

    def _base(self, axes: Mapping[int, Axis], anchors: tuple[Mapping[str, float], ...]) -> ProblemFile:
        return self._bounded(self.bare, {k: axis.raw(0) for k, axis in axes.items() if self.objectives[k].direct})

    def _ends(self, once: Once) -> tuple[dict[int, Axis], tuple[Mapping[str, float], ...]]:
        objectives, fixed, unbound = self.objectives, self.fixed, self.open
        loose = {k: axis.raw(0) for k, axis in fixed.items()}  # the loosest limits only

        def optimum(task: ProblemFile, blamed: ParetoObjective | None = None) -> dict[str, Any]:
            result = self._optimum(task)
            if blamed is not None and not result.valid:
                raise self._no_end(blamed, result.status.text)
            return _found(result) if result.valid else {"design": None}

        minimised = objectives[self.first]
        best = once(minimised.best, lambda: optimum(self._bounded(self.bare, loose), minimised))
        ends = {k: once(objectives[k].best, partial(self._tight, loose, k, best)) for k in unbound}
        tight = {k: end["limit"] for k, end in ends.items()}
        corners = {
            k: exact_text(objectives[k].worsened(tight[k], END_RELAXATION * abs(tight[k])), objectives[k].unit) for k in unbound
        }
        corners |= {k: axis.raw(len(axis.values) - 1) for k, axis in fixed.items()}
        others = {}
        if len(self.constrained) > 1:
            for k in self.constrained:
                task = self._bounded(self.bare, {**loose, k: corners[k]})
                others[k] = once(f"{minimised.best}, {objectives[k].best}", partial(optimum, task))
        ranges = {}
        for k in unbound:
            sense = objectives[k].sense
            limited = self._bounded(self.bare, {**loose, k: self._limit_of(k, tight[k])})
            designs = [best["design"], *(other["design"] for j, other in others.items() if j != k and other["design"])]
            worst = sense * max(sense * design_figures(limited, (objectives[k],), design)[0] for design in designs)
            ranges[k] = _axis(objectives[k], tight[k], worst, self.count)
        known = [best["design"], *(other["design"] for other in others.values()), *(end["design"] for end in ends.values())]
        return ranges, tuple(design for design in known if design)

    def _limit_of(self, k: int, value: float) -> Raw:
        """Return a limit of an objective with which its figure is that of the front: the tightest one, or a value."""
        if self.objectives[k].direct:
            return exact_text(value, self.objectives[k].unit)
        return tightest_bound(self.bare, self.objectives[k])

    def _tight(self, loose: Mapping[int, Raw], k: int, best: Mapping[str, Any]) -> dict[str, Any]:
        """Return the tightest feasible value of a limit: the best of its objective, or the least relaxation of an infeasible one.

        `best` meets the others. A search of the tightest bound that can be stated is only made where it can prove that no design
        meets it, or if no relaxation is found.
        """
        objective = self.objectives[k]
        if objective.direct:
            result = self._optimum(self._bounded(self.bare, loose, k))
            if not result.valid:
                raise self._no_end(objective, result.status.text)
            file = self._bounded(self.bare, {**loose, k: exact_text(1.0, objective.unit)})
            return {"limit": design_figures(file, (objective,), result.design)[0], "design": dict(result.design)}
        tight = self._bounded(self.bare, {**loose, k: tightest_bound(self.bare, objective)})
        result = self._optimum(tight) if automatic(tight) else None
        near = self._relaxed(tight, objective, best) if result is None or not _usable(result) else None
        if near is None:
            result = result or self._optimum(tight)
            if not _usable(result):
                raise self._no_end(objective, result.status.text)
            near = dict(result.design)
        return self._reached(loose, k, tight, near, best["design"])

    def _relaxed(self, tight: ProblemFile, objective: ParetoObjective, best: Mapping[str, Any]) -> dict[str, float] | None:
        """Return the design [SI] that meets a limit most nearly, also between the programme's positions; None without one."""
        definite = tight.override({"mechanism.assembly": best["assembly"]}).spec
        nlp, side = build(definite, best["direction"]), "<=" if objective.sense > 0 else ">="

        def follow(x: Array) -> Array:
            place_at_peaks(definite, nlp, nlp.lifted(x))
            return nlp.p

        start = nlp.x_of({**best["design"], **best["angles"]}, bounded=False)
        x = tightest(nlp, objective.key.rpartition(".")[0], side, start, follow if nlp.exchange_count else None)
        if x is None:
            return None
        design = nlp.design(x)
        return {name: design[name] for name in definite.free}

    def _reached(
        self, loose: Mapping[int, Raw], k: int, tight: ProblemFile, near: Mapping[str, float], best: Mapping[str, float]
    ) -> dict[str, Any]:
        """Return the tightest limit that a valid design meets, and this design: the optimum near one that nearly meets it."""
        objective = self.objectives[k]
        limit, worst = (design_figures(tight, (objective,), design)[0] for design in (near, best))
        if not objective.sense * (worst - limit) > MIN_RANGE * max(abs(limit), abs(worst)):
            return {"limit": worst, "design": best}
        for share in RELAXATIONS:
            bound = objective.worsened(limit, share * abs(worst - limit))
            file = self._bounded(self.bare, {**loose, k: exact_text(bound, objective.unit)})
            result = near_design(file, near, self.backend)
            if result.valid:
                return {"limit": limit if share == RELAXATIONS[0] else bound, "design": dict(result.design)}
        return {"limit": limit, "design": None}


def _usable(result: Any) -> bool:
    """Return whether a search found a design that meets all limits."""
    return result.solution is not None and bool(result.solution.usable)


def _found(result: Any) -> dict[str, Any]:
    """Return a design, fit for JSON: values [SI], assembly modes, and the crank angles and their sense where they are free."""
    best = result.best
    free = best.whole.data.offsets is None and not best.whole.composed
    angles = {angle_name(k): float(angle) for k, angle in enumerate(best.crank_angles)} if free else {}
    ends = best.crank_angles[[0, -1]] if free else np.zeros(2)
    direction = -1 if ends[1] < ends[0] else 1
    assembly = best.problem.at("mechanism.assembly")
    return {"design": dict(best.values), "assembly": assembly, "direction": direction, "angles": angles}


class _CycleRanges(EpsilonRanges):
    """Ranges of a machine: from the best of the other objectives to the best of the constrained one."""

    objective = staticmethod(cycle_objective)

    @property
    def searches(self) -> int:
        """Number of searches for the ranges that were not requested."""
        return 1 + 2 * len(self.open) + bool(self.objectives[self.first].key) if self.open else 0

    def figures(self, problem: ProblemFile, values: Mapping[str, float], error: float) -> tuple[float, ...]:
        return cycle_figures(problem, self.objectives, values)

    def reference(self, base: ProblemFile, once: Once) -> tuple[str, tuple[float, ...] | None]:
        figures = cycle_figures(self.problem, self.objectives, {})
        return "initial machine", figures if all_finite(figures) else None

    def _with(self, number: int, value: Raw) -> ProblemFile:
        return epsilon_problem(self.problem, self.objectives, {self.first: 1.0}, {number: value})

    def _base(self, axes: Mapping[int, Axis], anchors: tuple[Mapping[str, float], ...]) -> ProblemFile:
        bounds = {k: axes[k].raw(0) for k in self.constrained}
        base = epsilon_problem(self.problem, self.objectives, {self.first: 1.0}, bounds)
        return with_starting_values(base, anchors[0]) if anchors else base

    def _ends(self, once: Once) -> tuple[dict[int, Axis], tuple[Mapping[str, float], ...]]:
        problem, objectives, first = self.problem, self.objectives, self.first
        bounds = {k: axis.raw(0) for k, axis in self.fixed.items()}
        asked_for = [k for k in range(len(objectives)) if k not in bounds]

        def searched(k: int, task: ProblemFile, start: Mapping[str, float], starts: int | None = None) -> dict[str, Any]:
            result = completed(targets.solve(with_starting_values(task, start), self.backend, starts=starts))
            if start and result.status is not Status.OPTIMAL:
                result = completed(targets.solve(task, self.backend))
            measured = cycle_figures(problem, objectives, result.design)
            if result.status not in (Status.OPTIMAL, Status.STALLED) or not all_finite(measured):
                raise self._no_end(objectives[k], result.status.text)
            return {"sizes": dict(result.design), "figures": list(measured)}  # validated or not: it only defines the range

        single_optima = {
            first: once(
                objectives[first].best, partial(searched, first, epsilon_problem(problem, objectives, {first: 1.0}, bounds), {})
            )
        }
        begin = single_optima[first]["sizes"]
        for k in asked_for:
            if k != first:  # from a machine that satisfies all limits
                single_optima[k] = once(
                    objectives[k].best, partial(searched, k, epsilon_problem(problem, objectives, {k: 1.0}, bounds), begin)
                )
        best = {k: single_optima[k]["figures"][k] for k in asked_for}
        width = {k: max(abs(end["figures"][k] - best[k]) for end in single_optima.values()) or abs(best[k]) for k in asked_for}
        corner = {}
        for k in asked_for:
            rest = {j: width[j] for j in asked_for if j != k}
            if not objectives[k].key:  # a sum cannot be constrained
                corner[k] = single_optima[k]
                continue
            limit = exact_text(objectives[k].worsened(best[k], END_RELAXATION * width[k]), objectives[k].unit)
            task = epsilon_problem(problem, objectives, rest, {**bounds, k: limit})
            corner[k] = once(f"{objectives[k].best}, then the others", partial(searched, k, task, single_optima[k]["sizes"], 1))
        ranges = {}
        for k in asked_for:
            if k != first:
                sense = objectives[k].sense
                worst = sense * max(sense * corner[j]["figures"][k] for j in asked_for if j != k)
                ranges[k] = _axis(objectives[k], best[k], worst, self.count)
        return ranges, tuple(corner[k]["sizes"] for k in sorted(corner, key=lambda k: k != first))


RANGES: dict[str, type[EpsilonRanges]] = {"function": _DesignRanges, "path": _DesignRanges, "cycle": _CycleRanges}
"""Objectives and ranges by the kind of problem."""


def _axis(objective: ParetoObjective, tight: float, relaxed_end: float, count: int) -> Axis:
    """Return the values of a limit from the relaxed end of the front to the tight one, each rounded to meet its design."""
    width = abs(relaxed_end - tight)
    if not width > MIN_RANGE * max(abs(tight), abs(relaxed_end)):
        return Axis(objective.key, objective.unit, (objective.worsened(tight, END_RELAXATION * abs(tight)),))
    step = 10.0 ** math.floor(math.log10(END_RELAXATION * width))
    tight = objective.sense * math.ceil(objective.sense * objective.worsened(tight, END_RELAXATION * width) / step) * step
    relaxed_end = objective.sense * math.ceil(objective.sense * relaxed_end / step - ROUNDING) * step
    return Axis(objective.key, objective.unit, tuple(float(f"{value:.12g}") for value in np.linspace(relaxed_end, tight, count)))


def _requested(objective: ParetoObjective, count: int, problem_with: Callable[[Raw], ProblemFile]) -> Axis:
    """Return the requested range from its relaxed end; `problem_with` gives the problem with a value of the limit."""
    axis = range_values(objective, count)
    for at in (0, len(axis.values) - 1):
        problem_with(axis.raw(at))
    return replace(axis, values=tuple(sorted(axis.values, reverse=objective.sense > 0)))


# The objectives of a front as they are written.

EXAMPLES = (
    'For example --objectives "peak torque, guide force in F" of a machine, "error, limits.transmission_angle.max" of a law'
)


def assigned(problem: ProblemFile, objectives: str) -> dict[str, str | None]:
    """Return ranges by objective, None without one, from a text `NAME, NAME=LOW..HIGH UNIT`, as on the command line."""
    ranges: dict[str, str | None] = {}
    for part in objectives.split(",") if objectives.strip() else ():
        name, equals, span = (piece.strip() for piece in part.partition("="))
        if not name:
            raise InputError("an objective is empty", EXAMPLES, problem.file, OPTION, objectives)
        if equals and not span:
            raise InputError("the range is empty", "Write NAME=LOW..HIGH UNIT", problem.file, OPTION, part.strip())
        if name in ranges:
            raise InputError("the same objective twice", "Give each once", problem.file, OPTION, name)
        ranges[name] = span or None
    return ranges


def read_objectives(problem: ProblemFile, objectives: str | Mapping[str, ArrayLike | None]) -> tuple[ParetoObjective, ...]:
    """Read two or three objectives, each with the values of its limit or None; as a text, see `assigned`."""
    parts = objectives if isinstance(objectives, Mapping) else assigned(problem, objectives)
    if not parts:
        raise InputError("two or three objectives are missing", EXAMPLES, problem.file, OPTION)
    if not 2 <= len(parts) <= 3:
        what = "one objective has no trade-off" if len(parts) == 1 else f"{len(parts)} objectives are too many for a front"
        raise InputError(what, f"Give two or three. {EXAMPLES}", problem.file, OPTION, objectives)
    if problem.task not in RANGES:
        raise _no_front(problem)
    if not problem.model.free:
        raise InputError("no design variables: every dimension is fixed", "Free a dimension", problem.file, "mechanism")
    parsed = tuple(_ranged(problem, name, values, k + 1) for k, (name, values) in enumerate(parts.items()))
    for k, objective in enumerate(parsed):
        if any(objective.name == previous.name for previous in parsed[:k]):
            raise InputError("the same objective twice", "Give each once", problem.file, OPTION, objective.text)
    if problem.task != "cycle" and not any(objective.direct for objective in parsed):
        remedy = f'One objective must be minimised directly: write "{ERROR}, {parsed[0].text}"'
        raise InputError("two limits alone do not define a trade-off", remedy, problem.file, OPTION, objectives)
    return parsed


def _no_front(problem: ProblemFile) -> InputError:
    """Return the error that a problem has no Pareto front, with an alternative."""
    whose = "Fronts are those of designs for a requirement, and of machines with an [objective] over their cycle"
    if getattr(problem.model, "balance", None) is not None:
        instead = f"that of two measures of balancing: `optlink balance {problem.name} --trade force,torque`"
        return InputError("a balancing problem has no such objectives", f"{whose}; {instead}", problem.file)
    return InputError("the problem has no [objective]", f"{whose}; add an [objective] and design variables", problem.file)


def _ranged(problem: ProblemFile, name: str, values: ArrayLike | None, number: int) -> ParetoObjective:
    objective = RANGES[problem.task].objective(problem, name, number)
    if values is None:
        return objective
    if not objective.key:
        raise InputError(f"{name} has no range: it is minimised", "Leave the range out", problem.file, OPTION, name)
    span = str(values)
    if not isinstance(values, str):
        axis = axis_of(problem, name, values, objective.unit, OPTION)
        span = ", ".join(f"{value!r} {axis.unit}".rstrip() for value in axis.values)
    objective = replace(objective, span=span)
    if objective.of:
        _check_bounds(problem, objective)
    return objective


def _check_bounds(problem: ProblemFile, objective: ParetoObjective) -> None:
    """Check that the requested range lies within the bounds of a dimension."""
    name = objective.of
    quantity = problem.spec.quantities[name]
    try:
        values = [value * factor(axis.unit, quantity.kind) for axis in [range_values(objective, 2)] for value in axis.values]
    except (InputError, UnitProblem):  # no valid range: reported when it is used
        return
    low, high = quantity.bounds
    if (objective.sense > 0 and min(values) <= low) or (objective.sense < 0 and max(values) >= high):
        ends = " to ".join(f"{bound / factor(objective.unit, quantity.kind):g}" for bound in (low, high))
        message = f"the range exceeds the bounds of {name}, {ends} {objective.unit}"
        raise InputError(
            message, "Stay between them, or change the bounds", problem.file, OPTION, f"{objective.text}={objective.span}"
        )
