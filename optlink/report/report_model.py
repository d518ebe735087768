"""What a report or a drawing is about: a problem with its answer, and the machine that came out, over its cycle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from optlink.errors import InputError
from optlink.linkage.stroke import TURN
from optlink.problem.file import ProblemFile
from optlink.problem.fixed_design import settled
from optlink.solvers.solution import LimitState
from optlink.tasks.analyze import Analysis, analyze
from optlink.tasks.balance_result import Balance
from optlink.tasks.cycle_result import MachineDesign
from optlink.tasks.function import Result
from optlink.tasks.path_result import Generation
from optlink.tasks.run import solve, validate

if TYPE_CHECKING:
    from optlink.studies.sensitivity import Sensitivities

Outcome = Result | Generation | MachineDesign | Analysis


@dataclass(frozen=True, eq=False)
class Subject:
    """A problem with its answer.

    `cycle`: the machine found (or given) over its whole motion, from where its task begins; None where it cannot be assembled
    there, and `unmoved` says why. `limits`: those with their prices that a result file recorded, which only the
    search can compute. `notes`: what a reader should know of where the answer comes from. `answers`: how the optimum answers to
    what is given, where that is what was asked.
    """

    problem: ProblemFile
    outcome: Outcome
    cycle: Analysis | None
    unmoved: str = ""
    limits: tuple[LimitState, ...] = ()
    notes: tuple[str, ...] = ()
    answers: Sensitivities | None = None

    @property
    def valid(self) -> bool:
        """Whether the design is proven; of a mere analysis, whether all positions have finite reactions."""
        return self.outcome.sound if isinstance(self.outcome, Analysis) else self.outcome.valid

    @property
    def objective(self) -> float:
        """What was minimised [SI]; NaN of an analysis."""
        return math.nan if isinstance(self.outcome, Analysis) else self.outcome.objective

    @property
    def forces(self) -> bool:
        """Whether the machine has masses or loads, so that there are forces."""
        return self.cycle is not None and bool(self.cycle.machine.inertias or self.cycle.machine.loads)


def answered(
    problem: ProblemFile,
    backend: str = "ipopt",
    starts: int | None = None,
    seed: int = 0,
    given: Mapping[str, float] | None = None,
) -> Outcome:
    """Answer a problem: search where something is wanted and no design is `given`, else check the design, else analyse.

    Raises
    ------
    InputError
        as `solve`, `validate` and `analyze` do.
    """
    if problem.task in ("analysis", "balance"):
        return analyze(problem, design=given)
    found = solve(problem, backend, starts, seed) if given is None else validate(problem, given)
    assert not isinstance(found, Balance)
    return found


def subject_of(
    problem: ProblemFile, outcome: Outcome, limits: tuple[LimitState, ...] = (), notes: tuple[str, ...] = ()
) -> Subject:
    """The subject of an answered problem."""
    if isinstance(outcome, Analysis):
        return Subject(problem, outcome, outcome, limits=limits, notes=notes)
    try:
        machine = machine_found(outcome)
        cycle = None if machine is None else analyze(machine)
    except InputError as error:
        return Subject(problem, outcome, None, error.faults[0].message, limits, notes)
    return Subject(problem, outcome, cycle, "" if cycle else "no linkage was found", limits, notes)


def machine_found(outcome: Result | Generation | MachineDesign) -> ProblemFile | None:
    """The machine of an answer with every size fixed, its crank where the task begins and turning as the task wants.

    None where a search found none.

    Raises
    ------
    InputError
        when its sizes are none of a linkage.
    """
    if isinstance(outcome, MachineDesign):
        return outcome.machine
    if isinstance(outcome, Result):
        return _begun(settled(outcome.problem, outcome.design), outcome.design["phi0"], outcome.problem.spec.span)
    design = outcome.best
    if design is None:
        return None
    begin, end = float(design.crank_angles[0]), float(design.crank_angles[-1])
    return _begun(settled(design.problem, design.values), begin, end - begin)


def _begun(machine: ProblemFile, begin: float, way: float) -> ProblemFile:
    """The machine with its crank at `begin` [rad]."""
    if not math.isfinite(begin):
        return machine
    speed = math.copysign(machine.model.drive.speed.value, way) if way else machine.model.drive.speed.value
    return machine.override({"drive.start": f"{math.remainder(begin, TURN)!r} rad", "drive.speed": f"{speed!r} rad/s"})
