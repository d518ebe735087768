"""Result of optimising cycle quantities: dimensions with their validation, figures before and after, as data and JSON."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from optlink.dynamics.machine import Machine
from optlink.errors import InputError, Status
from optlink.problem.cycle.terms import Term
from optlink.problem.design import DesignProblem
from optlink.problem.document import Number, Source
from optlink.problem.file import ProblemFile
from optlink.problem.fixed_design import fixed_design
from optlink.problem.quantity import Unusable
from optlink.tasks.analyze import Analysis, analyze
from optlink.tasks.results.common import SingleResult
from optlink.tasks.results.fit import Fit, transmission_fit
from optlink.tasks.results.strokes import stroke_document
from optlink.units import KINDS, factor, percent
from optlink.validation import Validation, validate
from optlink.validation.cycle import Cycle


@dataclass(frozen=True)
class CycleFigure:
    """A figure in its display unit, of the initial design and of the result."""

    name: str
    words: str
    initial: Number
    result: Number
    limit: str
    unit: str


@dataclass(frozen=True, eq=False, repr=False)
class CycleResult(SingleResult):
    """A machine with its validation, or the reason why there is none.

    `design`: design variables [SI]; `objective`: minimised value [SI], negative for a maximised term.
    """

    kind = "cycle"
    shown: ClassVar[Mapping[str, Source]] = {
        **{key: source for key, source in SingleResult.shown.items() if key != "notes"},
        "free": "free",
        "objective": lambda result: {"value": result.objective, "unit": result.unit},
        "initial": lambda result: {"objective": result.initial.objective, "feasible": result.initial.valid},
        "figures": "figures",
    }

    notes: tuple[str, ...] = ()

    @property
    def values(self) -> dict[str, float]:
        """Design variables [SI]."""
        return self.design

    @property
    def task(self) -> DesignProblem:
        """The model of the problem."""
        return self.problem.spec

    @property
    def unit(self) -> str:
        """Unit of the objective, SI."""
        return self.task.objective_unit

    @cached_property
    def machine(self) -> ProblemFile:
        """The problem with all design variables fixed at the result, as used by `analyze` and `simulate`."""
        return fixed_design(self.problem, self.complete(self.design))

    @cached_property
    def initial_analysis(self) -> Analysis | None:
        """Cycle of the initial machine of the file; None if its crank cannot turn fully."""
        return self._analysed(self.complete({}))

    @cached_property
    def analysis(self) -> Analysis | None:
        """Cycle of the resulting machine; None if its crank cannot turn fully."""
        return self._analysed(self.complete(self.design))

    def _analysed(self, values: Mapping[str, float]) -> Analysis | None:
        try:
            analysis = analyze(fixed_design(self.problem, values))
        except InputError:
            return None
        return analysis if analysis.full else None

    @cached_property
    def measured(self) -> Cycle | None:
        """This design in motion; None if it cannot be built."""
        return analysis_of(self.task, self.design)

    @cached_property
    def _measured_initial(self) -> Cycle | None:
        return analysis_of(self.task, self.complete({}))

    @cached_property
    def built(self) -> Machine | None:
        """Machine of this design; None if its crank cannot turn fully."""
        cycle = self.measured
        return cycle.machine if cycle is not None and cycle.full else None

    @cached_property
    def initial(self) -> Validation:
        """Checks and objective of the initial design of the file."""
        return validate(self.task, self.complete({}), cycle=self._measured_initial)

    @property
    def comparison(self) -> str:
        """Comparison of the objective with that of the initial design, in words; empty without a search result."""
        if self.solution is None or self.status is not Status.OPTIMAL or not self.figures:
            return ""
        goal, first = self.figures[0], self.initial
        initial, optimal, unit = (
            (goal.initial, goal.result, goal.unit) if self.task.single else (first.objective, self.objective, "")
        )
        if not math.isfinite(initial) and not self.task.required:
            return "the crank of the initial design does not turn fully"
        if self.task.required and not first.valid:  # the middle of the bounds is not an initial design
            return f"objective {optimal:.5g} {unit}".rstrip()
        text, initial_text = (f"{value:.5g} {unit}".rstrip() for value in (optimal, initial))
        change = percent(optimal / initial - 1.0, signed=True) if initial else ""
        if not first.valid:
            return f"objective {text} ({change}; the initial design, {initial_text}, does not meet the limits)".replace(
                "(; ", "("
            )
        return f"objective {text}, initial design {initial_text}" + (f" ({change})" if change else "")

    @cached_property
    def fit(self) -> Fit | None:
        """Grade of a machine whose transmission angle is optimised; None for objectives without a target."""
        goal = self.task.goals[0]
        if not self.task.single or goal.quantity not in ("transmission angle", "pressure angle"):
            return None
        cycle = self.measured
        angle = math.nan if cycle is None else cycle.figure(goal)
        angle = 0.5 * math.pi - angle if goal.quantity == "pressure angle" else angle
        limits = () if self.solution is None else self.solution.displayed_limits
        least, values = min(angle, math.pi - angle), self.complete(self.design)
        return transmission_fit(least, self.task.mechanism.quantities, values, limits, self.solution, self.task)

    @cached_property
    def figures(self) -> tuple[CycleFigure, ...]:
        """Terms of the objective, then the limits, of the initial machine and of the result."""
        start, end = self._measured_initial, self.measured
        rows = []
        for k, goal in enumerate(self.task.goals):
            name = "objective" if self.task.single else f"objective {k + 1}"
            rows.append(self._figure(name, goal, start, end, f"{goal.sense}d"))
        for item in self.task.bounds:
            rows.append(self._figure(item.name, item.term, start, end, str(item.interval), item.interval.unit))
        return tuple(rows)

    def _figure(
        self, name: str, term: Term, initial: Cycle | None, final: Cycle | None, limit: str, unit: str = ""
    ) -> CycleFigure:
        kind = self.task.kind(term)
        unit = unit or (KINDS[kind].display if kind else "")
        size = 1.0 / factor(unit, kind) if kind else 1.0
        values = [math.nan if cycle is None else cycle.figure(term) * size for cycle in (initial, final)]
        return CycleFigure(name, term.words, values[0], values[1], limit, unit)

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the design variables."""
        return tuple(self.task.free)

    @property
    def strokes(self) -> dict[str, Any]:
        """Strokes of every output, as JSON; empty if the crank cannot turn fully."""
        return {} if self.built is None else stroke_document(self.built, self.task.drive.speed.value)


def analysis_of(task: DesignProblem, values: Mapping[str, float]) -> Cycle | None:
    """Return a design [SI] in motion, with the values of the file where it has none; None if it cannot be built."""
    try:
        return Cycle(task, values)
    except Unusable:
        return None
