"""The design on the page: the optimum that follows a drag, or the validated result of the ordinary tasks."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from optlink.dynamics.machine import Machine
from optlink.errors import InputError, OptlinkError, Status
from optlink.linkage.vector2d import Array
from optlink.problem.file import ProblemFile
from optlink.problem.mechanism import sizes_of
from optlink.report.format import shown, single_units
from optlink.report.views import balance, conclusions
from optlink.solvers.solution import LimitState, Solution
from optlink.studio.kinds import kind_of
from optlink.tasks.analyze import Analysis
from optlink.tasks.machine import machine_of
from optlink.tasks.results.balance import Balance
from optlink.validation.check import Check

UNVERIFIED = "not verified"
ANALYSED_TEXT = "Only the machine is analysed; `optlink solve` checks the requirements of the file."
MOVING_TEXT = "Optimised from the last design; it is verified when the handle is released."
MACHINE_TEXT = "The motion of the machine with these dimensions."
LIMITED_TEXT = f"{MACHINE_TEXT} The crank cannot turn fully."
NOT_VALIDATED_TEXT = "No validated design."
SOUND_TEXT = "There are no design variables to check: the analysis over the cycle found no singular position."
BALANCED_TEXT = "The measures of the balanced machine were computed again, and agree."
UNASSEMBLED_TEXT = "With these dimensions the linkage cannot be assembled at any crank angle. The last one stays drawn."


@dataclass(frozen=True)
class Design:
    """A design of a problem.

    `problem` has definite assembly modes; `values` are all quantities [SI]; `crank_angles` (points,) [rad] those of the target
    points, None where they follow from the values. `status` is that of the page. `checks` are those of the ordinary validator,
    None if it has not seen the design; `unchecked` is what the page says in their place. `result` is the ordinary result, None
    while a hand moves.
    """

    problem: ProblemFile
    values: Mapping[str, float]
    status: str = UNVERIFIED
    objective: float = math.nan
    solution: Solution | None = None
    crank_angles: Array | None = None
    checks: tuple[Check, ...] | None = None
    conclusion: str = MOVING_TEXT
    conflicts: tuple[str, ...] = ()
    limits: tuple[LimitState, ...] = ()
    result: Any = None
    unchecked: str = NOT_VALIDATED_TEXT

    @property
    def machine(self) -> Machine:
        """The machine with these values."""
        quantities = self.problem.model.mechanism.quantities
        return machine_of(self.problem, {name: self.values[name] for name in quantities})

    @property
    def start(self) -> float:
        """Crank angle [rad] of the first position that is drawn."""
        if self.crank_angles is not None and len(self.crank_angles):
            return float(self.crank_angles[0])
        return self.problem.model.start(self.values)

    @property
    def speed(self) -> float:
        """Crank speed [rad/s]; without a drive only its sign counts."""
        if self.crank_angles is not None and len(self.crank_angles) > 1:
            return math.copysign(1.0, float(self.crank_angles[-1] - self.crank_angles[0]))
        return self.problem.model.sense


NO_RESULT = {"objective": math.nan, "limits": (), "checks": None, "result": None, "unchecked": NOT_VALIDATED_TEXT}
"""What a design loses when its problem is replaced by one that has no design."""


def started(problem: ProblemFile) -> Design:
    """Return the design of the starting values of a problem."""
    return Design(problem, problem.model.design({}))


def from_solution(problem: ProblemFile, solution: Solution) -> Design:
    """Return the design of a local optimum, not yet validated."""
    values, angles = kind_of(problem).values(problem.model, solution)
    return Design(problem, values, UNVERIFIED, solution.objective, solution, angles, limits=solution.displayed_limits)


def in_modes(problem: ProblemFile, design: Design) -> ProblemFile:
    """Return a problem with the assembly modes of a design."""
    modes = design.problem.raw["mechanism"].get("assembly")
    if modes is None or problem.raw["mechanism"].get("assembly") == modes:
        return problem
    return problem.override({"mechanism.assembly": modes})


def carried_design(problem: ProblemFile, last: Design) -> Design:
    """Return the last design in a changed problem, without optimisation: fixed sizes have their new values."""
    values = problem.model.design({name: last.values[name] for name in problem.model.free if name in last.values})
    words = MOVING_TEXT if problem.model.free else MACHINE_TEXT
    return Design(problem, values, UNVERIFIED, crank_angles=last.crank_angles, conclusion=words)


def moved_machine(design: Design, full: bool | None) -> Design:
    """Return a machine that is not analysed yet, with a status from whether it assembles at every crank angle; None: at none."""
    if design.status != UNVERIFIED or full:
        return design
    if full is None:
        return replace(design, status="infeasible", conclusion=UNASSEMBLED_TEXT, conflicts=(UNASSEMBLED_TEXT,))
    return replace(design, conclusion=LIMITED_TEXT)


@single_units()
def design_of(result: Any) -> Design:
    """Return the design of an ordinary result, with the verdict of its validation."""
    if isinstance(result, Analysis | Balance):
        return _machine(result)
    best, text = result.best, shown(result.refuted)
    if best is None:
        words = text or "No design was found."
        values = result.problem.model.design({})
        return Design(result.problem, values, "infeasible", conclusion=words, conflicts=(words,), result=result)
    infeasible = bool(text) or result.status is Status.INFEASIBLE
    status = "verified" if result.valid else "infeasible" if infeasible else "not valid"
    limits = () if best.solution is None else best.solution.displayed_limits
    return Design(
        best.problem,
        best.problem.model.design(best.design),
        "failed" if result.status is Status.NON_FINITE else status,
        result.objective,
        best.solution,
        getattr(best, "crank_angles", None),
        best.validation.checks,
        conclusions.design(result, limits),
        (text,) if text else (),
        limits,
        result,
    )


def _machine(result: Analysis | Balance) -> Design:
    """Return the machine of an analysis or of a balance, with its verdict."""
    if isinstance(result, Analysis):
        status, conclusion = "verified" if result.sound else "not valid", conclusions.analysis(result)
        unchecked = SOUND_TEXT if result.sound else NOT_VALIDATED_TEXT
        if result.sound and result.problem.task != "analysis":  # a kind of another package, whose validation did not run
            status, conclusion = UNVERIFIED, f"{ANALYSED_TEXT} {conclusion}"
    else:
        status = "verified" if result.valid else "infeasible" if result.conflict else "not valid"
        conclusion, unchecked = balance.conclusion(result), BALANCED_TEXT if result.valid else NOT_VALIDATED_TEXT
    values = sizes_of(result.problem.model.mechanism.quantities)
    return Design(result.problem, values, status, conclusion=conclusion, result=result, unchecked=unchecked)


def solved_design(problem: ProblemFile, progress: Callable[[float], None] | None = None) -> Design:
    """Return the design that the command line finds for a problem: the same search, the same validation."""
    return design_of(kind_of(problem).result(problem, progress))


def validated_design(design: Design) -> Design:
    """Return a local optimum with the verdict of the ordinary validator."""
    from optlink.tasks.run import validate

    model = design.problem.model
    result = design_of(validate(design.problem, {name: design.values[name] for name in model.free}))
    return replace(result, solution=design.solution, limits=design.limits, objective=design.objective)


def verdict(design: Design) -> dict[str, Any]:
    """Return the verdict of an infeasible design, for the last feasible one that stays drawn without its objective and prices."""
    return {**NO_RESULT, "status": design.status, "conclusion": design.conclusion, "conflicts": design.conflicts}


def failure(error: OptlinkError, status: str = "failed") -> dict[str, Any]:
    """Return the verdict of a problem that cannot be stated or solved."""
    why = fault_text(error)
    return {**NO_RESULT, "status": status, "conclusion": why, "conflicts": (why,)}


def fault_text(error: OptlinkError) -> str:
    """Return the fault of a value set on the page, without its place in the file."""
    if not isinstance(error, InputError):
        return str(error)
    fault = error.faults[0]
    return f"{fault.message[:1].upper()}{fault.message[1:]}. {fault.remedy.rstrip('.')}."
