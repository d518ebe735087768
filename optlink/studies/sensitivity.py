"""Parametric sensitivities: derivatives of an optimum by all its parameters, and their range of validity.

The method is described in `optlink.studies.optimum_parameters`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from pydantic import AfterValidator

from optlink.errors import InputError, Status
from optlink.problem.arguments import typed
from optlink.problem.document import Document, Number, Source
from optlink.problem.file import AnyProblem, ProblemFile, problem_of
from optlink.problem.rounding import NO_GRID
from optlink.solvers.solution import Solution
from optlink.studies.optimum_parameters import (
    CycleParameters,
    KKTSystem,
    OptimumParameters,
    Parameter,
    TargetParameters,
    ValidityEnd,
    design_variables,
    displayed,
)
from optlink.tasks.protocol import completed
from optlink.tasks.run import solve
from optlink.units import in_si

MIN_OBJECTIVE_REFERENCE = 1e-2  # least reference of relative differences: of the objective, per parameter change of its own value
MIN_DESIGN_REFERENCE = 1e-3  # the same for the design
NEGLIGIBLE = 1e-10  # of the objective, or of a scaled design variable: smaller changes by one step of a parameter count as zero


@dataclass(frozen=True)
class DifferenceCheck:
    """Derivatives by central differences of `step` [unit of the parameter] between re-optimised designs."""

    step: Number
    objective: Number
    design: dict[str, Number]
    gap: Number  # largest difference from the exact derivatives, relative to the largest of the kind

    def in_si(self, size: float, sizes: Mapping[str, float]) -> DifferenceCheck:
        """Return the derivatives in SI.

        Parameters
        ----------
        size : float
            One unit of the parameter [SI].
        sizes : mapping of str to float
            One unit of each design variable [SI].
        """
        design = {name: rate * sizes[name] / size for name, rate in self.design.items()}
        return DifferenceCheck(self.step * size, self.objective / size, design, self.gap)


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivity of an optimum to one parameter.

    `objective`: change of the objective [SI] per `parameter.unit`; `design`: change of each design variable [its unit in
    `Sensitivities.units`] per `parameter.unit`; `below`, `above`: range of validity.
    """

    shown: ClassVar[Mapping[str, Source]] = {
        **{name: f"parameter.{name}" for name in ("key", "name", "kind", "value", "unit", "step")},
        "effect_of_step": "effect",
        "objective_per_unit": "objective",
        "design_per_unit": "design",
        "valid_from": "below.value",
        "valid_from_because": "below.event",
        "valid_to": "above.value",
        "valid_to_because": "above.event",
        "searched_again?": "check",
    }

    parameter: Parameter
    objective: Number
    design: dict[str, Number]
    below: Annotated[ValidityEnd, AfterValidator(lambda end: end if math.isfinite(end.value) else replace(end, value=-math.inf))]
    above: Annotated[ValidityEnd, AfterValidator(lambda end: end if math.isfinite(end.value) else replace(end, value=math.inf))]
    check: DifferenceCheck | None = None

    @property
    def effect(self) -> float:
        """Change of the objective [SI] by one `parameter.step`."""
        return self.objective * self.parameter.step

    @property
    def moves(self) -> bool:
        """Whether the parameter has any effect."""
        return self.objective != 0.0 or any(self.design.values())

    def in_si(self, sizes: Mapping[str, float]) -> Sensitivity:
        """Return the sensitivity in SI."""
        parameter, size = self.parameter.in_si, in_si(self.parameter.unit)[0]
        below, above = (replace(end, value=end.value * size) for end in (self.below, self.above))
        design = {name: rate * sizes[name] / size for name, rate in self.design.items()}
        check = None if self.check is None else self.check.in_si(size, sizes)
        return Sensitivity(parameter, self.objective / size, design, below, above, check)


@dataclass(frozen=True)
class Derivatives:
    """Derivatives of an optimum in one system of units: `rows` by decreasing effect; `values` and `units` of the variables."""

    rows: tuple[Sensitivity, ...]
    values: dict[str, Number]
    units: dict[str, str]

    def __getitem__(self, key: str) -> Sensitivity:
        return next(row for row in self.rows if key in (row.parameter.key, row.parameter.name))

    @property
    def moving(self) -> tuple[Sensitivity, ...]:
        """Sensitivities to parameters with an effect."""
        return tuple(row for row in self.rows if row.moves)

    @property
    def in_si(self) -> Derivatives:
        """The same in SI."""
        si = {name: in_si(unit) for name, unit in self.units.items()}
        sizes = {name: size for name, (size, _) in si.items()}
        values = {name: value * sizes[name] for name, value in self.values.items()}
        return Derivatives(tuple(row.in_si(sizes) for row in self.rows), values, {name: unit for name, (_, unit) in si.items()})


@dataclass(frozen=True, repr=False, eq=False)
class Sensitivities(Document):
    """All sensitivities of an optimum, in SI; `displayed`: the same in display units, for tables and documents."""

    kind = "sensitivity"
    shown: ClassVar[Mapping[str, Source]] = {
        "objective": lambda result: {"value": result.solution.objective, "unit": result.unit},
        "design": "displayed.values",
        "design_units": "displayed.units",
        "largest_gap": "gap",
        "parameters": "displayed.rows",
    }

    problem: ProblemFile
    solution: Solution
    unit: str
    displayed: Derivatives
    notes: tuple[str, ...]

    @cached_property
    def in_si(self) -> Derivatives:
        """The sensitivities in SI."""
        return self.displayed.in_si

    @property
    def rows(self) -> tuple[Sensitivity, ...]:
        """Sensitivities to all parameters by decreasing effect [SI]."""
        return self.in_si.rows

    @property
    def units(self) -> Mapping[str, str]:
        """SI units of the design variables."""
        return self.in_si.units

    @property
    def values(self) -> Mapping[str, float]:
        """Design variables of the optimum [SI]."""
        return self.in_si.values

    @property
    def moving(self) -> tuple[Sensitivity, ...]:
        """Sensitivities to parameters with an effect [SI]."""
        return self.in_si.moving

    def __getitem__(self, key: str) -> Sensitivity:
        return self.in_si[key]

    @property
    def gap(self) -> float | None:
        """Largest difference from the derivatives of re-optimised designs; None without this check."""
        gaps = [row.check.gap for row in self.rows if row.check is not None]
        return max(gaps) if gaps else None

    @property
    def status(self) -> str:
        """Status of the optimum."""
        return self.solution.status.value

    @property
    def valid(self) -> bool:
        """Whether they are those of an optimum, and agree with re-optimised designs if these were asked for."""
        return self.solution.status is Status.OPTIMAL and (self.gap or 0.0) <= DERIVATIVE_TOLERANCE


DERIVATIVE_TOLERANCE = 1e-5  # relative tolerance between exact derivatives and those from solving again
PARAMETERS: dict[str, type[OptimumParameters]] = {
    "function": TargetParameters,
    "path": TargetParameters,
    "cycle": CycleParameters,
}
"""Parameters of an optimum by the kind of problem; of all others, those of the programme."""


@typed
def sensitivities(
    problem: AnyProblem,
    backend: str = "ipopt",
    starts: int | None = None,
    seed: int = 0,
    *,
    check: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Sensitivities:
    """Optimise a problem and compute the sensitivities of the optimum to all fixed parameters and limits.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        From `optlink.load`, the name of a shipped problem, or a file, with a requirement or an objective.
    backend, starts, seed
        As in `optlink.solve`.
    check : bool
        Whether to verify each parameter with an effect by re-optimisation on both sides.
    progress : function of the completed fraction of the check, optional

    Returns
    -------
    Sensitivities
        Derivatives of the objective and of the design variables, sorted by effect, each with its range of validity.

    Raises
    ------
    InputError
        If no optimum is found, or under the conditions of `optlink.solve`.

    Examples
    --------
    >>> from optlink.studies import sensitivities
    >>> row = sensitivities(optlink.load("crank-rocker")).moving[0]
    >>> row.parameter.name, float(f"{row.objective:.4g}"), row.parameter.unit  # of the objective [rad^2] per unit
    ('largest transmission angle', -0.008392, 'rad')
    """
    problem = problem_of(problem)
    if problem.task == "balance":
        remedy = "`optlink balance` lists the shadow prices of its limits"
        raise InputError("a balancing problem has no sensitivities to parameters", remedy, problem.file, "balance")
    result = completed(solve(problem, backend, starts, seed, rounding=NO_GRID))
    solution, file = result.solution, result.definite
    if solution is None or solution.status is not Status.OPTIMAL:
        how = "infeasible" if solution is None else solution.status.value
        raise InputError(f"there is no optimum to analyse: {how}", "`optlink solve` gives the reason", problem.file)
    return of_solution(file, solution, backend, check=check, progress=progress)


def of_solution(
    problem: ProblemFile,
    solution: Solution,
    backend: str = "ipopt",
    *,
    check: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Sensitivities:
    """Return the sensitivities of a known optimum to all parameters."""
    kind, nlp = PARAMETERS.get(problem.task, OptimumParameters), solution.nlp
    solution = kind.refined(solution)
    system = KKTSystem(solution)
    optimum_parameters = kind(problem, system)
    factors = {v.name: v.scale.slope(x) for v, x in design_variables(nlp, solution.x)}
    residuals = np.abs(nlp.residuals(solution.x))
    exact = solution.objective == 0.0 or float(np.max(residuals, initial=0.0)) <= nlp.exact
    notes, rows = [*optimum_parameters.notes], []
    if exact:
        notes.insert(0, "the requirement is met exactly, so all shadow prices are zero")
    dependent: list[str] = []
    for parameter in optimum_parameters.parameters:
        try:
            push = optimum_parameters.push(parameter)
        except InputError as error:  # at the end of the valid range of input values
            notes.append(f"{parameter.name} is left out, as it cannot be changed in both directions: {error.faults[0].message}")
            continue
        side = system.beside(push)
        if side is None:
            notes.append(
                f"{parameter.name} is left out, as it cannot be raised: limits that depend on it would contradict each other"
            )
            continue
        if side is not system:
            dependent.append(parameter.name)
            push = kind(problem, side).push(parameter)
        response = side.response(push)
        below, above = side.ends(parameter, push, response)
        if parameter.positive and below.value < 0.0:
            below = ValidityEnd(-math.inf, "nothing")
        objective, moved = response.objective, response.moved
        if exact or abs(objective * parameter.step) <= NEGLIGIBLE * abs(solution.objective):
            objective = 0.0
        moved = np.where(np.abs(moved * parameter.step) <= NEGLIGIBLE, 0.0, moved)
        design = {v.name: float(change * factors[v.name]) for v, change in design_variables(nlp, moved)}
        rows.append(Sensitivity(parameter, objective, design, below, above))
    if dependent:
        notes.insert(0, f"active limits depend on one another: derivatives are of an increase of {'; '.join(dependent)}")
    elif system.several:
        notes.insert(0, "several designs are equally good, or limits depend on one another: the smallest change is shown")
    rows.sort(key=lambda row: -float(f"{abs(row.effect):.6g}"))  # equal effects in the order of the parameters
    if check:
        moving = [row for row in rows if row.moves]
        for checked, row in enumerate(moving):
            result = _searched_again(optimum_parameters, solution, row, backend, degenerate=system.several)
            rows[rows.index(row)] = replace(row, check=result)
            if progress is not None:
                progress((checked + 1) / len(moving))
        missing = [row.parameter.name for row in rows if row.moves and row.check is None]
        if missing:
            notes.append(f"not compared, as the range ends at the value or no optimum was found beside it: {', '.join(missing)}")
        if system.several:
            notes.append("a new search may end at another of the designs: only objectives are compared")
    return Sensitivities(
        problem=problem,
        solution=solution,
        unit=nlp.measure.unit.replace("**", "^"),
        displayed=Derivatives(
            tuple(rows),
            displayed(nlp, solution.x),
            {v.name: v.scale.unit for v, _ in design_variables(nlp, solution.x)},
        ),
        notes=tuple(notes),
    )


def _searched_again(
    optimum_parameters: OptimumParameters, solution: Solution, row: Sensitivity, backend: str, *, degenerate: bool
) -> DifferenceCheck | None:
    """Return central differences between optima on either side, or None.

    None if the range of validity is too small, or an optimum is missing.

    `degenerate`: several designs are equally good, so that only the objective can be compared.
    """
    parameter = row.parameter
    size = abs(parameter.value) or 1.0
    room = min(parameter.value - row.below.value, row.above.value - parameter.value)
    step = min(optimum_parameters.share * size, optimum_parameters.most * room)
    if step <= 1e-9 * size:
        return None
    sides = (parameter.value - step, parameter.value + step)
    lower, upper = (optimum_parameters.optimum_at(solution, parameter, value, backend) for value in sides)
    if lower is None or upper is None:
        return None
    (low, below), (high, above) = lower, upper
    objective = (high - low) / (2.0 * step)
    design = {name: (above[name] - below[name]) / (2.0 * step) for name in row.design}
    small = MIN_OBJECTIVE_REFERENCE * abs(solution.objective) / size
    gaps = [abs(objective - row.objective) / max(abs(objective), abs(row.objective), small, 1e-300)]
    slight = MIN_DESIGN_REFERENCE * max(abs(v.scale.to_display(x)) for v, x in design_variables(solution.nlp, solution.x)) / size
    largest = max(*(abs(d) for d in (*design.values(), *row.design.values())), slight, 1e-300)
    gaps += [abs(design[name] - row.design[name]) / largest for name in design if not degenerate]
    return DifferenceCheck(step, objective, design, max(gaps))
