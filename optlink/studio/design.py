"""The design on the page: the optimum that follows a drag, or the validated result of the ordinary tasks."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from optlink.dynamics.columns import MotionColumns, efforts
from optlink.dynamics.machine import Machine
from optlink.errors import Fault, InputError, OptlinkError, Status
from optlink.io import finite
from optlink.linkage.dyads import transmitting
from optlink.linkage.vector2d import Array
from optlink.optimization.courses import TermCourse
from optlink.optimization.cycle_signals import TracedCycle
from optlink.optimization.nlp import NLP
from optlink.optimization.output_errors import error_at
from optlink.optimization.programme import solved_values
from optlink.presentation.chart_spec import max_abs
from optlink.presentation.format import price_step, shown, single_units
from optlink.presentation.style import scale
from optlink.presentation.views import balance, conclusions
from optlink.problem.design import DesignProblem
from optlink.problem.file import WORDS as PROSE, ProblemFile
from optlink.problem.limits import MARGINS, Limits
from optlink.problem.machine.model import ShownObjective
from optlink.problem.mechanism import sizes_of
from optlink.problem.quantity import Quantity, quantity_key
from optlink.problem.targets.law import Function
from optlink.solvers import multistart
from optlink.solvers.contract import CLOSE, MINIMAX
from optlink.solvers.exchange import largest_excess, place_at_peaks, solve_semi_infinite
from optlink.solvers.solution import LimitState, Solution, stationarity
from optlink.studies.batch_optima import follow_optimum
from optlink.studies.reoptimise_task import with_starting_values
from optlink.studies.target_programme import TargetProgramme
from optlink.studio.picture import Picture
from optlink.tasks.analyze import Analysis
from optlink.tasks.machine import machine_of
from optlink.tasks.results.balance import Balance
from optlink.units import DISPLAYED
from optlink.validation.check import Check
from optlink.validation.design import deviations
from optlink.validation.motion import transmission_angles
from optlink.validation.timing import in_first_cycle

# Continuation of an optimum while the problem changes: programmes that are traced once and whose parameters move.
#
# A follower serves all problems of the same structure: what varies are parameters and bounds of its programme. Where the
# structure changes, a new one is built.

BACKEND = "ipopt"
EXACTLY = 1e-9  # scaled units: distance at which a row counts as active in the optimality conditions
PEAK_TOLERANCE = 1e-4  # share of its level by which a peak may exceed the values at the fixed positions while a hand moves


class Follower(Protocol):
    """Follows the optimum of problems with one structure."""

    def follow(self, problem: ProblemFile, near: Solution | None) -> Solution | None:
        """Return the optimum, usable or not, of a problem with definite assembly modes near the last one; None if it has none."""


class TargetsFollower:
    """Follower of laws, paths, motions and transmission of any linkage; its programme has the targets as parameters.

    `direction` is the sense of crank rotation from point to point, +1 or -1.
    """

    def __init__(self, problem: ProblemFile, direction: int) -> None:
        self.direction = direction
        self._build(problem.spec)

    def _build(self, task: DesignProblem) -> None:
        """Build the programme of a problem; it serves all problems with the same limits."""
        self.programme = TargetProgramme(task, self.direction, BACKEND, movable=True)

    def follow(self, problem: ProblemFile, near: Solution | None) -> Solution:
        """Return the optimum of a problem near the last one."""
        task = problem.spec
        if not self.programme.bind(task):
            self._build(task)
        nlp = self.programme.nlp
        x = start_of(nlp, near)
        if near is not None and near.nlp is nlp and not nlp.exchange_count:
            solution = follow_optimum(nlp, near)
            if solution is not None:
                return solution
        backend = MINIMAX if task.measure == "max" and not (task.law_given or task.composed) else BACKEND
        if nlp.exchange_count:
            start = multistart.solution_at(nlp, x, "the last optimum")
            return solve_semi_infinite(task, start, backend, near=start.usable)
        return multistart.solve_from(nlp, x, backend)


def start_of(nlp: NLP, near: Solution | None) -> Array:
    """Return the last optimum as a starting point of a programme with other variables or scaling; without one, its own start."""
    x = nlp.x_start.copy()
    if near is not None and near.nlp is nlp:
        x = near.x
    elif near is not None:
        values = {v.name: v.origin + v.size * float(value) for v, value in zip(near.nlp.variables, near.x, strict=True)}
        for i, variable in enumerate(nlp.variables):
            if variable.name in values:
                x[i] = variable.scaled(values[variable.name])
    return nlp.lifted(np.clip(x, nlp.x_low, nlp.x_high))


class CycleFollower:
    """Follower of designs for quantities of the cycle; limits, bounds and fixed sizes are parameters of its programme.

    Newton's method runs at fixed positions of the peaks, which hardly move. `values` [SI] are the last optimum, whose order of
    events is that of the programme.
    """

    def __init__(self, problem: ProblemFile, values: Mapping[str, float]) -> None:
        task = problem.spec
        start = {name: values[name] for name in task.free}
        begun = with_starting_values(problem, start).spec
        trace = TracedCycle(begun, slow=begun.slow_assumed)
        structure = trace.structure(start)
        self.task, self._near = task, None
        if structure is not None:
            self.programme = TargetProgramme(begun, 1, BACKEND, terms=TermCourse(begun, start, trace, structure.definite))
            self._near = self._first(values)
        self.follow(problem, None)  # the first search takes longer: it compiles

    def _first(self, values: Mapping[str, float]) -> Solution:
        nlp = self.programme.nlp
        x = nlp.x_of({name: values[name] for name in self.task.free})
        place_at_peaks(self.task, nlp, x)
        solution = multistart.solution_at(nlp, nlp.lifted(x), "the last optimum")
        return _with_active_rows(
            solution if solution.usable and solution.kkt <= PEAK_TOLERANCE else multistart.solve_from(nlp, x, BACKEND)
        )

    def follow(self, problem: ProblemFile, near: Solution | None) -> Solution | None:
        """Return the optimum of a problem near the last one, which the follower keeps; None if its events have another order."""
        last, task = self._near, problem.spec
        if last is None or not self.programme.bind(task):
            return None
        nlp = self.programme.nlp
        nlp.set_exchange_points(last.p[len(last.p) - nlp.exchange_count :])
        solution = follow_optimum(nlp, last) if last.usable else None
        if solution is None or largest_excess(task, nlp, solution.x) > PEAK_TOLERANCE:
            x = nlp.lifted(np.clip(last.x if solution is None else solution.x, nlp.x_low, nlp.x_high))
            place_at_peaks(task, nlp, x)
            solution = multistart.solve_from(nlp, x, BACKEND)
        if solution.usable:
            if nlp.terms.event_angles(nlp.given | solution.design) is None:
                return None
            self._near = _with_active_rows(solution)
        self.task = task
        return solution

    def refined(self, solution: Solution) -> Solution:
        """Return an optimum that satisfies its limits at every crank angle, from one at fixed positions of the peaks."""
        solution.nlp.p[:] = solution.p
        exchanged = solve_semi_infinite(self.task, solution, CLOSE, near=True)
        if exchanged.usable:
            self._near = _with_active_rows(exchanged)
        return exchanged


def _with_active_rows(solution: Solution) -> Solution:
    """Return an optimum whose optimality conditions use exactly active rows only: rows beside a peak would count twice."""
    if not solution.usable:
        return solution
    return replace(solution, conditions=stationarity(solution.nlp, solution.x, solution.nlp.at(solution.x, solution.p), EXACTLY))


# Properties of each kind of problem in the studio: one entry of `KINDS` per kind.

CURVE_POSITIONS = 60  # positions of the error curve
STRUCTURAL_LIMITS = ("crank", "transmission_over", *MARGINS)  # limits that change the structure of a programme


class ErrorCurve(NamedTuple):
    """Error of a design over the crank angle [rad], in a display unit."""

    title: str
    crank_angles: Array
    label: str
    unit: str
    values: Array


class Kind:
    """A machine without requirement, which is analysed; base class of the other kinds."""

    slow_programme = False
    """Whether the programme of a follower takes seconds to build."""

    def name(self, model: Any) -> str:
        """Return the name of the kind for the page."""
        return "analysis"

    def result(self, problem: ProblemFile, progress: Callable[[float], None] | None) -> Any:
        """Return the result that the command line finds: the same search, the same validation."""
        from optlink.tasks.analyze import analyze

        return analyze(problem)

    def values(self, model: Any, solution: Solution) -> tuple[dict[str, float], Array | None]:
        """Return all quantities [SI] of a local optimum, and the crank angles of the target points if it determines them."""
        return model.design({name: solution.design[name] for name in model.free}), None

    def objective(self, model: Any, value: float) -> ShownObjective:
        """Return an objective [SI] as it is shown, with its name; no name if there is none."""
        return ShownObjective(value, 1.0, "", "")

    def error_curves(self, model: Any, values: Mapping[str, float], start: float, angles: Array | None) -> Iterator[ErrorCurve]:
        """Yield the error of a design [SI] from its first crank angle [rad] on, if the kind has one.

        `angles` (points,) [rad] are those of the target points, where the values do not determine them.
        """
        yield from ()

    def follower(self, problem: ProblemFile, values: Mapping[str, float], direction: int) -> Follower | None:
        """Return a follower from the last design [SI] and its sense of crank rotation; None if a drag does not optimise."""
        return None

    def fixed_parts(self, model: Any, requirement: Mapping[str, Any]) -> list[Any]:
        """Return the parts of the requirement section that a programme does not have as parameters."""
        return []


class _Balancing(Kind):
    """A machine that is balanced."""

    def result(self, problem: ProblemFile, progress: Callable[[float], None] | None) -> Any:
        from optlink.tasks.balance import balance

        return balance(problem)


class _Searched(Kind):
    """A problem whose design variables are searched; a design without any is validated."""

    def result(self, problem: ProblemFile, progress: Callable[[float], None] | None) -> Any:
        from optlink.tasks.run import solve, validate

        return solve(problem, progress=progress) if problem.model.free else validate(problem, {})


class _Synthesis(_Searched):
    """A requirement on the motion of a linkage."""

    def name(self, model: Any) -> str:
        kind = str(model.requirement.kind)
        return "law" if model.law_given and not isinstance(model.requirement.law, Function) else kind

    def values(self, model: Any, solution: Solution) -> tuple[dict[str, float], Array | None]:
        values, angles = solved_values(model, solution.design, solution.x)
        return values, in_first_cycle(model, angles)

    def objective(self, model: Any, value: float) -> ShownObjective:
        shown = model.shown_objective(value)
        if model.by_angle or model.composed:
            return shown  # type: ignore[no-any-return]
        what = "error" if model.law_given else "deviation"
        words = {"max": f"largest {what}", "rms": f"root mean square {what}"}.get(model.measure, f"sum of squared {what}s")
        words += " of the cosines" * (model.requirement.kind == "transmission")
        return shown._replace(unit=shown.unit.replace("^2", "²"), name=words)  # type: ignore[no-any-return]

    def error_curves(self, model: Any, values: Mapping[str, float], start: float, angles: Array | None) -> Iterator[ErrorCurve]:
        part = model.parts[0]
        factor, unit = DISPLAYED[part.unit]
        if part.law_given:
            offsets = part.span * np.linspace(0.0, 1.0, CURVE_POSITIONS + 1)
            with np.errstate(all="ignore"):
                error = -factor * error_at(part, part.own(values), offsets)
            yield ErrorCurve("Output error", start + offsets, "generated minus target", unit, error)
        elif part.requirement.kind != "transmission" and angles is not None:
            own = angles[: len(part.data.columns)]
            distances = deviations(part, part.own(values), own).distances
            yield ErrorCurve("Deviation at the points", own, "deviation", unit, factor * distances)

    def follower(self, problem: ProblemFile, values: Mapping[str, float], direction: int) -> Follower | None:
        return TargetsFollower(problem, direction)

    def fixed_parts(self, model: Any, requirement: Mapping[str, Any]) -> list[Any]:
        task, data = model.requirement, model.data
        if model.composed or not model.law_given:
            places = data.columns.shape if model.pointed and not model.composed else data.columns.tolist()
            timing = None if data.offsets is None else data.offsets.tolist()
            rest = {key: value for key, value in requirement.items() if key != "points"}
            return [rest, places, timing, data.roots.tolist(), data.tolerances.tolist()]
        moving = {"span": model.movable_span, "zero": isinstance(task.zero, Quantity)}
        moving |= {**dict.fromkeys(("from", "start"), isinstance(task.start, Quantity)), "psi0": isinstance(task.psi0, Quantity)}
        return [{key: value for key, value in requirement.items() if not moving.get(key)}, model.sense]


class _CycleOptimisation(_Searched):
    slow_programme = True

    def name(self, model: Any) -> str:
        return "machine"

    def objective(self, model: Any, value: float) -> ShownObjective:
        shown = model.shown_objective(value)
        return shown._replace(name=model.goals[0].words) if model.single else shown  # type: ignore[no-any-return]

    def follower(self, problem: ProblemFile, values: Mapping[str, float], direction: int) -> Follower | None:
        return CycleFollower(problem, values)

    def fixed_parts(self, model: Any, requirement: Mapping[str, Any]) -> list[Any]:
        return [_without_numbers(requirement)]


KINDS: dict[str, Kind] = {"function": _Synthesis(), "path": _Synthesis(), "cycle": _CycleOptimisation(), "balance": _Balancing()}
"""Kinds by the name of the task; all others are analysed."""


def kind_of(problem: ProblemFile) -> Kind:
    """Return the kind of a problem."""
    return KINDS.get(problem.task) or Kind()


def structure(problem: ProblemFile) -> Any:
    """Return the data that determine the structure of a programme; equal for problems that can share one."""
    model, raw = problem.model, problem.raw
    limits = {
        key: repr(value) if key in STRUCTURAL_LIMITS else _without_numbers(value)
        for key, value in (raw.get("limits") or {}).items()
    }
    parts: list[Any] = [
        problem.task,
        tuple(model.quantities),
        tuple(model.free),
        {name: model.quantities[name].equals for name in model.links},
        limits,
        raw["mechanism"].get("assembly"),
    ]
    parts += [{key: value for key, value in raw.items() if key not in ("mechanism", "limits", "requirement", *PROSE)}]
    parts += kind_of(problem).fixed_parts(model, dict(raw.get("requirement") or {}))
    return tuple(map(repr, parts))


def _without_numbers(value: Any) -> Any:
    """Return a value of the file without its numbers."""
    if isinstance(value, Mapping):
        return {key: _without_numbers(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_numbers(item) for item in value]
    return type(value).__name__


UNVERIFIED = "not verified"
ANALYSED_TEXT = "Only the machine is analysed; `optlink solve` checks the requirements of the file."
MOVING_TEXT = "Optimised from the last design; it is verified when the handle is released."
MACHINE_TEXT = "The motion of the machine with these dimensions."
LIMITED_TEXT = f"{MACHINE_TEXT} It cannot be assembled at every position of its drive."
NOT_VALIDATED_TEXT = "No validated design."
SOUND_TEXT = "There are no design variables to check: the analysis over the cycle found no singular position."
BALANCED_TEXT = "The measures of the balanced machine were computed again, and agree."
UNASSEMBLED_TEXT = "With these dimensions it cannot be assembled at any position of its drive. The last linkage stays drawn."


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


def same_parts(problem: ProblemFile, other: ProblemFile) -> bool:
    """Return whether two problems have dimensions and assembly modes of the same names: a design of one fits the other."""

    def parts(one: ProblemFile) -> Any:
        modes = one.raw["mechanism"].get("assembly")
        return set(one.model.quantities), set(modes) if isinstance(modes, Mapping) else None

    return bool(parts(problem) == parts(other))


def carried_design(problem: ProblemFile, last: Design) -> Design:
    """Return the last design in a changed problem, without optimisation: fixed sizes have their new values."""
    values = problem.model.design({name: last.values[name] for name in problem.model.free if name in last.values})
    words = MOVING_TEXT if problem.model.free else MACHINE_TEXT
    return Design(problem, values, UNVERIFIED, crank_angles=last.crank_angles, conclusion=words)


def moved_machine(design: Design, full: bool | None) -> Design:
    """Return a machine that is not analysed yet, with a status from whether it assembles at every position; None: at none."""
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
        words = text or conclusions.none_usable(result)
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
        status, conclusion = "verified" if result.valid else "not valid", conclusions.analysis(result)
        unchecked = SOUND_TEXT if result.valid else NOT_VALIDATED_TEXT
        if result.valid and result.problem.task != "analysis":  # a kind of another package, whose validation did not run
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
    why = fault_text(error.faults[0]) if isinstance(error, InputError) else str(error)
    return {**NO_RESULT, "status": status, "conclusion": why, "conflicts": (why,)}


def fault_text(fault: Fault) -> str:
    """Return the sentence of a fault, without its place in the file."""
    return f"{fault.message[:1].upper()}{fault.message[1:]}. {fault.remedy.rstrip('.')}."


# The state of the page: a design with its picture, handles, figures, checks and charts, as plain data.

AT_BOUND = 1e-6  # share of the range of a variable
DIGITS = 6


def targets(problem: ProblemFile, design: Design) -> dict[str, Any]:
    """Return the target points, poses or curve [mm, deg], with the deviations of a design."""
    if not problem.model.parts or not (model := problem.spec).pointed:
        return {"points": [], "poses": [], "curve": []}
    targets = model.target_points
    places = 1e3 * np.asarray(targets.points)
    deviation = np.full(len(places), np.nan)
    if design.crank_angles is not None and len(design.crank_angles) == len(places):
        deviation = 1e3 * deviations(model, design.values, design.crank_angles).distances
    points = [{"at": place, "deviation": d} for place, d in zip(_rounded(places), finite(_rounded(deviation)), strict=True)]
    poses = []
    if targets.angles is not None:
        both = zip(points, targets.angles, strict=True)
        poses = [{"at": p["at"], "angle": math.degrees(a)} for p, a in both if not math.isnan(a)]
    curve = [*_rounded(places), *_rounded(places[:1])] if model.closed else _rounded(places)
    return {"points": points, "poses": poses, "curve": curve}


def variables(problem: ProblemFile, design: Design, lockable: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the design variables, and the sizes that are fixed or were locked on the page, in display units."""
    rows = []
    for name, quantity in problem.model.quantities.items():
        if quantity.fixed and name not in lockable:
            continue
        size, unit = quantity.si_per_unit, quantity.display[1]
        low, high = (bound / size for bound in quantity.bounds)
        value = design.values.get(name, quantity.value) / size
        near = AT_BOUND * (high - low)
        rows.append(
            {
                "name": name,
                "value": value,
                "unit": unit,
                "lower": low if quantity.low is not None else None,
                "upper": high if quantity.low is not None else None,
                "locked": not quantity.free,
                "at_bound": quantity.low is not None and (value <= low + near or value >= high - near),
                "key": quantity_key(problem.model, name),
            }
            | ({} if quantity.equals is None else {"equals": quantity.equals})
        )
    return finite(rows)  # type: ignore[no-any-return]


def objective(problem: ProblemFile, value: float) -> dict[str, Any] | None:
    """Return an objective [SI] with its label, in a display unit; None if the problem has none."""
    shown = kind_of(problem).objective(problem.model, value)
    return {"label": shown.name, "value": finite(shown.value), "unit": shown.unit} if shown.name else None


def active(design: Design) -> list[dict[str, Any]]:
    """Return the active limits of a design with their shadow prices, in display units."""
    base, factor, unit, _ = kind_of(design.problem).objective(design.problem.model, design.objective)
    rows = []
    for limit in design.limits:
        if limit.active:
            row = {"limit": f"{limit.name} {limit.sense}", "value": limit.bound, "unit": limit.unit}
            size, step = price_step(limit.unit, limit.bound, abs(limit.multiplier * factor / base) if base else 0.0)
            price = {"price": limit.multiplier * factor * size, "price_unit": f"{unit or '1'} per {step}"}
            joint = {"joint_price": limit.joint_gain * factor * size} if limit.depends_on else {}
            rows.append(row | price | joint)
    return finite(rows)  # type: ignore[no-any-return]


def checks(design: Design) -> list[dict[str, Any]] | None:
    """Return the checks of the validator; None if it has not seen the design."""
    if design.checks is None:
        return None
    rows = [{"name": c.name, "ok": c.passed, "measured": c.value, "limit": c.limit, "unit": c.unit} for c in design.checks]
    return finite(rows)  # type: ignore[no-any-return]


# --- charts -----------------------------------------------------------------------------------------------------------------


def charts(design: Design, picture: Picture, problem: ProblemFile) -> list[dict[str, Any]]:
    """Return the curves of a design over the positions of its drive, with the limits of the present problem."""
    kind, model = kind_of(design.problem), design.problem.model
    curves = kind.error_curves(model, design.values, design.start, design.crank_angles)
    specs = [_chart(curve.title, picture.axis(curve.crank_angles), [curve[2:]]) for curve in curves]
    specs += _transmission(picture, problem)
    if model.loads or model.bodies:
        specs += _forces(design, picture)
    elif design.problem.task == "cycle" or not model.free:
        specs += _motion(picture)
    return specs


def _chart(
    title: str, x: Mapping[str, Any], series: Sequence[tuple[str, str, Array]], limits: Sequence[tuple[str, float]] = ()
) -> dict[str, Any]:
    curves = [{"label": label, "unit": unit, "values": finite(_rounded(values))} for label, unit, values in series]
    return {"title": title, "x": x, "series": curves, "limits": [{"label": n, "value": v} for n, v in limits]}


def _transmission(picture: Picture, problem: ProblemFile) -> Iterator[dict[str, Any]]:
    groups = transmitting(picture.mechanism)
    if not groups:
        return
    with np.errstate(all="ignore"):
        angles = np.degrees(transmission_angles(picture.motion, picture.mechanism))
    limits = []
    allowed = getattr(problem.model, "limits", None)
    if isinstance(allowed, Limits):
        limit = allowed.transmission_at(groups[0].joint)
        for word, bound in () if limit is None else (("least", limit.low), ("largest", limit.high)):
            if bound is not None:
                limits.append((word, math.degrees(bound)))
    series = [(f"at {group.joint}", "deg", angles[:, k]) for k, group in enumerate(groups)]
    yield _chart("Transmission angle", picture.axis(picture.angles), series, limits)


def _motion(picture: Picture) -> Iterator[dict[str, Any]]:
    mechanism, motion = picture.mechanism, picture.motion
    for guide in mechanism.guides:
        if guide.on == "frame":
            slide = np.asarray(motion.slide(guide.name).value)
            yield _chart(f"Slide of {guide.slider}", picture.axis(picture.angles), [(guide.slider, "mm", 1e3 * slide)])
            return
    driven = {drive.body for drive in mechanism.drives}
    body = next((link.body for link in reversed(mechanism.links) if link.body not in driven), mechanism.crank.body)
    yield _chart(
        f"Angle of {body}", picture.axis(picture.angles), [(body, "deg", np.degrees(np.asarray(motion.body_angle(body).value)))]
    )


def _forces(design: Design, picture: Picture) -> Iterator[dict[str, Any]]:
    """Yield the torques and forces of the drives and the joint reactions."""
    yield from _motion(picture)
    x = picture.axis(picture.angles)
    moving = picture.machine.moving(picture.angles, design.speed)
    with np.errstate(all="ignore"):
        record = MotionColumns(moving)
        exerted = [(effort, np.asarray(record[effort.column], dtype=float)) for effort in efforts(picture.mechanism)]
        pins = {
            name.partition(".")[0]: np.hypot(record[name], record[name.replace(".fx_N", ".fy_N")])
            for name in record.columns
            if name.endswith(".fx_N") and name.replace(".fx_N", ".fy_N") in record.columns
        }
    for effort, values in exerted:
        size = scale(max_abs(values), effort.unit)
        words = f"{effort.words[:1].upper()}{effort.words[1:]}"
        yield _chart(words, x, [(effort.quantity, size.unit, values * size.factor)])
    if pins:
        most = scale(max(float(np.nanmax(force, initial=0.0)) for force in pins.values()), "N")
        yield _chart("Joint reactions", x, [(pin, most.unit, force * most.factor) for pin, force in pins.items()])


def _rounded(values: Array) -> Any:
    """Return numbers as lists, with as many digits as a drawing can show."""
    largest = max_abs(values)
    return np.round(values, max(0, DIGITS - 1 - math.floor(math.log10(largest))) if largest > 0.0 else 0).tolist()
