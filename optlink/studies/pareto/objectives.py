"""Objectives of a Pareto front: reading, the limit that constrains each, and their values for a design.

A machine optimised over its cycle has terms ("peak torque", "guide force in F", "stroke of ram"), dimensions ("crank.length"),
its limits by name, and the `objective` of the file. A four-bar for a law has `error`, its measure, and
any movable side of a limit or of a design variable: `limits.transmission_angle.max`, `mechanism.coupler.max`.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, get_args

from optlink.errors import Fault, InputError
from optlink.optimization.constraints import rows as limit_rows
from optlink.optimization.objectives import MEASURES
from optlink.problem.cycle import CycleProblem
from optlink.problem.cycle_terms import Limit, Measure, Term, What
from optlink.problem.file import SIDES, ProblemFile, read
from optlink.problem.function import DesignProblem
from optlink.problem.path import PathProblem
from optlink.problem.quantity import Interval, StrokeRatio, nearest
from optlink.studies.grid import Axis, column, read_axis
from optlink.studies.toml_keys import Raw, exact_text, value_at
from optlink.units import KINDS, UnitProblem, factor
from optlink.validation.cycle import Cycle

OPTION = "--objectives"
ERROR, OWN = "error", "objective"
MOVABLE = ("transmission_angle", "transmission_cosine", "swing_angle", "time_ratio", "frame_length", "link_ratio")
SEVERAL = ("transmission_angle", "transmission_cosine", "link_ratio")  # limits with a largest and a smallest value
GENERATED = {
    "path": "points of a path are",
    "motion": "poses of a body are",
    "function": "values of a function are",
    "transmission": "a swing and a good transmission are",
}
ROOM = 1e-3  # relative distance between the sides of a limit with one side at its tightest
EXAMPLES = (
    'For example --objectives "peak torque, guide force in F" of a machine, "error, limits.transmission_angle.max" of a law'
)

_NAME = r"[A-Za-z][\w.\-]*"
_TERM = re.compile(
    rf"(?:(?P<sense>minimise|maximise)\s+)?(?:(?P<measure>{'|'.join(get_args(Measure))})\s+)?(?:(?P<static>static)\s+)?"
    rf"(?P<quantity>{'|'.join(sorted(get_args(What), key=len, reverse=True))})(?:\s+per\s+revolution)?"
    r"(?:\s+(?:of|in)\s+the\s+(?P<stroke>forward|backward)\s+stroke)?"
    rf"(?:\s+(?:of|at|in)\s+(?P<of>{_NAME}))?(?:\s+on\s+(?P<on>{_NAME}))?(?:\s+along\s+(?P<direction>\S.*))?",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class ParetoObjective:
    """One objective of a Pareto front: its text, `said`, and its `name`.

    `sense`: 1 to minimise, -1 to maximise; `key`: the limit that constrains it in the problem file, with its side, empty for an
    objective that can only be minimised itself; `term`: of a machine, as in the file; `span`: the requested range, if any.
    """

    said: str
    name: str
    unit: str
    sense: int
    key: str = ""
    term: tuple[tuple[str, Any], ...] = ()
    span: str = ""

    @property
    def column(self) -> str:
        """Name of its column in the table."""
        return column(self.name, self.unit).replace(" ", "_")

    @property
    def best(self) -> str:
        """Name of its end of the front."""
        if self.name.startswith(("largest", "least", "smallest")):
            return f"best {self.name}"
        return f"{'least' if self.sense > 0 else 'largest'} {self.name}"

    @property
    def side(self) -> str:
        """Side of the limit that constrains it."""
        return "max" if self.sense > 0 else "min"

    @property
    def made(self) -> Term:
        """Term of a machine."""
        return Term.model_validate(dict(self.term))

    def loose(self, value: float, by: float) -> float:
        """Return a value that is worse by an amount.

        Parameters
        ----------
        value, by : float [unit of the objective]
        """
        return value + self.sense * by


def read_objectives(problem: ProblemFile, objectives: str) -> tuple[ParetoObjective, ...]:
    """Read two or three objectives, separated by commas; `NAME=LOW..HIGH UNIT` restricts an objective to a range.

    Parameters
    ----------
    problem : ProblemFile
    objectives : str
        For example "peak torque, guide force in F".

    Raises
    ------
    InputError
        For unknown objectives, fewer than two or more than three, or objectives without a trade-off.
    """
    parts = [part.strip() for part in objectives.split(",")]
    if not all(parts):
        raise InputError(Fault("an objective is empty", EXAMPLES, problem.file, OPTION, objectives))
    if not 2 <= len(parts) <= 3:
        what = "one objective has no trade-off" if len(parts) == 1 else f"{len(parts)} objectives are more than a front shows"
        raise InputError(Fault(what, f"Give two or three. {EXAMPLES}", problem.file, OPTION, objectives))
    if problem.task == "path" or not (problem.task == "cycle" or isinstance(problem.model, DesignProblem)):
        raise _no_front(problem)
    if not problem.model.free:
        raise InputError(Fault("no design variables: every dimension is fixed", "Free a size", problem.file, "mechanism"))
    reader = _of_machine if problem.task == "cycle" else _of_law
    aims = tuple(_ranged(problem, reader, part, k + 1) for k, part in enumerate(parts))
    for k, aim in enumerate(aims):
        if any(aim.name == other.name for other in aims[:k]):
            raise InputError(Fault("the same objective twice", "Give each once", problem.file, OPTION, aim.said))
    if problem.task != "cycle" and all(aim.key for aim in aims):
        remedy = f'One of them is what is minimised: write "{ERROR}, {aims[0].said}"'
        raise InputError(Fault("limits alone are no trade-off", remedy, problem.file, OPTION, objectives))
    return aims


def _no_front(problem: ProblemFile) -> InputError:
    """Return the error that a problem has no Pareto front, with an alternative."""
    whose = "Fronts are those of machines with an [objective] over their cycle, and of four-bars for a law"
    if isinstance(problem.model, PathProblem):
        instead = f"what a limit costs here: optlink study sweep {problem.name} --vary KEY=LOW..HIGH:N"
        wanted = GENERATED[problem.model.requirement.kind]
        return InputError(Fault(f"{wanted} wanted here", f"{whose}; {instead}", problem.file))
    if getattr(problem.model, "balance", None) is not None:
        instead = f"that of two measures of balancing: optlink balance {problem.name} --trade force,torque"
        return InputError(Fault("nothing is to be designed here", f"{whose}; {instead}", problem.file))
    return InputError(Fault("nothing is to be designed here", f"{whose}; add an [objective] and free sizes", problem.file))


def _ranged(problem: ProblemFile, reader: Any, part: str, number: int) -> ParetoObjective:
    name, equals, span = (piece.strip() for piece in part.partition("="))
    if equals and not span:
        raise InputError(Fault("the range is empty", "Write NAME=LOW..HIGH UNIT", problem.file, OPTION, part))
    aim: ParetoObjective = reader(problem, name, number)
    if span and not aim.key:
        raise InputError(
            Fault(f"{name} has no range: it is what is minimised", "Leave the range out", problem.file, OPTION, part)
        )
    aim = replace(aim, span=span)
    if aim.key.startswith("mechanism."):
        _check_bounds(problem, aim)
    return aim


def range_values(aim: ParetoObjective, count: int) -> Axis:
    """Return the values of the requested range of an objective.

    Parameters
    ----------
    aim : ParetoObjective
        With a `span`.
    count : int
        Number of values, unless the range states it.

    Raises
    ------
    InputError
        If the range is not valid.
    """
    return read_axis(f"{aim.key}={aim.span}" if ":" in aim.span or "step" in aim.span else f"{aim.key}={aim.span}:{count}")


def _check_bounds(problem: ProblemFile, aim: ParetoObjective) -> None:
    """Check that the bounds of a dimension leave room beside every value of the requested range."""
    name = aim.key.removeprefix("mechanism.").rpartition(".")[0]
    quantity = problem.spec.quantities[name]
    try:
        values = [value * factor(axis.unit, quantity.kind) for axis in [range_values(aim, 2)] for value in axis.values]
    except (InputError, UnitProblem):  # no valid range: reported when it is used
        return
    low, high = quantity.bounds
    if (aim.sense > 0 and min(values) <= low) or (aim.sense < 0 and max(values) >= high):
        ends = " to ".join(f"{bound / factor(aim.unit, quantity.kind):g}" for bound in (low, high))
        message = f"the range leaves the bounds of {name}, {ends} {aim.unit}"
        raise InputError(
            Fault(message, "Stay between them, or change the bounds", problem.file, OPTION, f"{aim.said}={aim.span}")
        )


# --- four-bars for a law -----------------------------------------------------------------------------------------------


def _of_law(problem: ProblemFile, name: str, number: int) -> ParetoObjective:
    task = problem.spec
    if name == ERROR:
        return ParetoObjective(name, ERROR, MEASURES[task.requirement.measure].unit, 1)
    limits = [f"limits.{key}.{side}" for key in MOVABLE for side in SIDES]
    sizes = [f"mechanism.{key}" for key in task.mechanism.quantities]
    above, _, side = name.rpartition(".")
    key = above.removeprefix("mechanism.").removeprefix("limits.")
    if side in SIDES and key in MOVABLE:
        unit = {"transmission_angle": "deg", "swing_angle": "deg", "frame_length": "mm"}.get(key, "")
        words = key.replace("_", " ")
        if key in SEVERAL:
            words = f"{'largest' if side == 'max' else 'smallest'} {words}"
        return ParetoObjective(name, words, unit, 1 if side == "max" else -1, f"limits.{key}.{side}")
    if side not in SIDES:
        key, side = name.removeprefix("mechanism."), "max"
    if key not in task.mechanism.quantities:
        raise InputError(
            Fault("unknown objective", nearest(name, [ERROR, *limits, *(f"{s}.max" for s in sizes)]), problem.file, OPTION, name)
        )
    quantity = task.quantities[key]
    if not quantity.free:
        remedy = f"""Free it: --set mechanism.{key}='{{ bounds = ["...", "..."] }}'"""
        raise InputError(Fault(f"{key} is fixed at {quantity}, it cannot move", remedy, problem.file, OPTION, name))
    unit = KINDS[quantity.kind].display
    return ParetoObjective(name, key, unit, 1 if side == "max" else -1, f"mechanism.{key}.{side}")


def limit_in_file(problem: ProblemFile, key: str) -> Raw | None:
    """Return the value in the file at one side of a limit, or None.

    Parameters
    ----------
    problem : ProblemFile
    key : str
        Key of the limit, including its side.
    """
    above, _, side = key.rpartition(".")
    whole = value_at(problem, above)
    if isinstance(whole, Mapping):
        whole = whole.get("bounds", whole) if key.startswith("mechanism.") else whole
    if isinstance(whole, list):
        return whole[SIDES.index(side)]  # type: ignore[no-any-return]
    return whole.get(side, whole.get("exactly")) if isinstance(whole, Mapping) else whole  # type: ignore[no-any-return]


def tightest_bound(problem: ProblemFile, aim: ParetoObjective) -> Raw:
    """Return the tightest bound that can be stated, whether or not a linkage satisfies it.

    Parameters
    ----------
    problem : ProblemFile
        With a law.
    aim : ParetoObjective
        With a `key`.
    """
    above = aim.key.rpartition(".")[0]
    name = above.rpartition(".")[2]
    other: float | None = None
    if aim.key.startswith("mechanism."):
        quantity = problem.spec.quantities[name]
        low, high = (bound / factor(aim.unit, quantity.kind) for bound in quantity.bounds)
        return exact_text(low + 1e-6 * (high - low) if aim.sense > 0 else high - 1e-6 * (high - low), aim.unit)
    held: Interval | None = getattr(problem.spec.limits, name)
    if held is not None:
        other = held.low if aim.sense > 0 else held.high
    if other is not None:
        assert held is not None
        own = other / factor(aim.unit, held.kind) if held.kind else other
        return exact_text(aim.loose(own, ROOM * abs(own)), aim.unit)  # equal sides would prescribe one value at all positions
    small, large = {"deg": (1.0, 179.0), "mm": (1e-3, 1e8)}.get(aim.unit, (1e-3, 1e3))
    if isinstance(held, StrokeRatio):
        small, large = (1.0 if held.stroke in (None, "slow") else small), (1.0 if held.stroke == "quick" else large)
    elif name == "time_ratio":
        small = 1.0
    if name == "transmission_cosine":
        small, large = -0.999, 0.999
    return exact_text(small if aim.sense > 0 else large, aim.unit)


def law_figure(task: DesignProblem, aim: ParetoObjective, design: Mapping[str, float]) -> float:
    """Return the value that a limit constrains, in the unit of the objective.

    Parameters
    ----------
    task : DesignProblem
        States that side of the limit.
    aim : ParetoObjective
        With a `key`.
    design : mapping of str to float [SI]
    """
    above, _, side = aim.key.rpartition(".")
    name = above.removeprefix("mechanism.")
    if above.startswith("mechanism."):
        return design[name] / factor(aim.unit, task.quantities[name].kind)
    values = task.design(design)
    keys = {above} | ({"limits.alignment"} if name.startswith("transmission") else set())  # which may be tighter
    rows = [row for row in limit_rows(task, values, task.reach(values), values["frame"]) if row.limit in keys]
    held = [row for row in rows if math.isfinite(row.high if (side == "max") != row.scale.cosine else row.low)]
    figures = [row.scale.to_display(float(row.value)) for row in held]
    return max(figures) if side == "max" else min(figures)


# --- machines ----------------------------------------------------------------------------------------------------------


def _model(problem: ProblemFile) -> CycleProblem:
    assert isinstance(problem.model, CycleProblem)
    return problem.model


def _of_machine(problem: ProblemFile, name: str, number: int) -> ParetoObjective:
    task = _model(problem)
    if name == OWN:
        if not task.single:
            return ParetoObjective(name, "sum of the objective", "", 1)
        own = {key: value for key, value in problem.raw["objective"].items() if key != "sense"}
        return _termed(problem, own, -1 if task.goals[0].sense == "maximise" else 1, number, name)
    limited = task.limits.named.get(name.removeprefix("limits."))
    if limited is not None:
        sense = -1 if limited.max is None and limited.exactly is None else 1
        if limited.exactly is not None or (limited.min is not None and limited.max is not None):
            remedy = f'Say which way: "minimise {limited.words}" or "maximise {limited.words}"'
            raise InputError(Fault("the limit holds the term from both sides", remedy, problem.file, OPTION, name))
        raw = {key: value for key, value in problem.raw["limits"][name.removeprefix("limits.")].items() if key not in SIDES}
        return _termed(problem, raw, sense, number, name)
    if name in task.quantities:
        return _termed(problem, {"quantity": "length", "of": name}, 1, number, name)
    match = _TERM.fullmatch(name)
    if match is None:
        known = [*get_args(What), *(f"limits.{key}" for key in task.limits.named), *task.free, OWN]
        raise InputError(Fault("unknown objective", nearest(name, known), problem.file, OPTION, name))
    raw = {key: value for key, value in match.groupdict().items() if value is not None}
    for key in ("quantity", "measure", "stroke"):
        if key in raw:
            raw[key] = raw[key].lower()
    if "static" in raw:
        raw["static"] = True
    stated = raw.pop("sense", "").lower()
    sense = -1 if stated == "maximise" or (not stated and raw.get("measure") == "least") else 1
    return _termed(problem, raw, sense, number, name)


def _termed(problem: ProblemFile, raw: dict[str, Any], sense: int, number: int, name: str) -> ParetoObjective:
    """Return the objective of a term, after validation by the model."""
    stated = {**raw, "sense": "maximise" if sense < 0 else "minimise"}
    document = {key: value for key, value in problem.raw.items() if key != "expected"}
    try:
        found = read({**document, "objective": stated}, problem.name, problem.file, problem.folder)
    except InputError as error:
        fault = error.faults[0]
        raise InputError(Fault(fault.message, fault.remedy, problem.file, OPTION, name)) from None
    goal = _model(found).goals[0]
    kind = _model(found).kind(goal)
    unit = KINDS[kind].display if kind else ""
    side = "min" if sense < 0 else "max"
    return ParetoObjective(name, goal.words, unit, sense, f"limits.front_{number}.{side}", tuple(raw.items()))


def epsilon_problem(
    problem: ProblemFile, aims: Sequence[ParetoObjective], goals: Mapping[int, float], bounds: Mapping[int, Raw]
) -> ProblemFile:
    """Return the problem of a machine with other objectives and bounds.

    A limit of the file on the same side of the term of an objective is removed; all others remain.

    Parameters
    ----------
    problem : ProblemFile
    aims : sequence of ParetoObjective
    goals : mapping of int to float
        Minimised objectives: index, and the reference value in the unit of the objective.
    bounds : mapping of int to value with unit
        Constrained objectives: index, and bound.
    """
    raw = {key: copy.deepcopy(value) for key, value in problem.raw.items() if key != "expected"}
    given = _model(problem)
    way = {name for name, limit in given.limits.named.items() if any(_gives_way(limit, aim) for aim in aims)}
    limits = {name: value for name, value in raw.get("limits", {}).items() if name not in way}
    for name in way:
        rest = _rest(problem, name, aims)
        if rest is not None:
            limits[name] = rest
    for k, value in bounds.items():
        limits[aims[k].key.split(".")[1]] = {**dict(aims[k].term), aims[k].side: value}
    raw["limits"] = limits
    terms = [term for k, one in goals.items() for term in _goals(problem, aims[k], one)]
    single = [k for k in goals if len(goals) == 1 and aims[k].key]
    raw["objective"] = {key: v for key, v in terms[0].items() if key != "scale"} if single else {"terms": terms}
    return read(raw, problem.name, problem.file, problem.folder)


def _goals(problem: ProblemFile, aim: ParetoObjective, one: float) -> list[dict[str, Any]]:
    """Return the terms of an objective, with the reference value `one` [its unit]."""
    if aim.key:
        sense = "maximise" if aim.sense < 0 else "minimise"
        return [{**dict(aim.term), "sense": sense, "scale": exact_text(one, aim.unit)}]
    return [{**term, "weight": term.get("weight", 1.0) / one} for term in problem.raw["objective"]["terms"]]


def _same(one: Term, other: Term) -> bool:
    keys = ("quantity", "of", "on", "how", "static", "stroke")
    ways = [None if term.direction is None else term.direction.value for term in (one, other)]
    return ways[0] == ways[1] and all(getattr(one, key) == getattr(other, key) for key in keys)


def _gives_way(limit: Limit, aim: ParetoObjective) -> bool:
    """Return whether a limit constrains the term of an objective on the side that is varied."""
    if not aim.key:
        return False
    return _same(limit, aim.made) and (limit.exactly is not None or getattr(limit, aim.side) is not None)


def _rest(problem: ProblemFile, name: str, aims: Sequence[ParetoObjective]) -> dict[str, Any] | None:
    """Return the other side of a limit that is removed, or None."""
    limit, raw = _model(problem).limits.named[name], dict(problem.raw["limits"][name])
    raw.pop("exactly", None)
    for aim in aims:
        if _gives_way(limit, aim):
            raw.pop(aim.side, None)
    return raw if any(side in raw for side in SIDES) else None


def cycle_figures(problem: ProblemFile, aims: Sequence[ParetoObjective], values: Mapping[str, float]) -> tuple[float, ...]:
    """Return the values of all objectives of a machine by ordinary inverse dynamics; NaN if the crank cannot turn fully.

    Parameters
    ----------
    problem : ProblemFile
    aims : sequence of ParetoObjective
    values : mapping of str to float [SI]
        Dimensions; those not named have their value in the file.

    Returns
    -------
    tuple of float, each in the unit of its objective
    """
    task = _model(problem)
    cycle = Cycle(task, values)
    found = []
    for aim in aims:
        if not aim.key:
            found.append(cycle.objective() if cycle.full else math.nan)
            continue
        kind = task.kind(aim.made)
        found.append(cycle.figure(aim.made) / (factor(aim.unit, kind) if kind else 1.0))
    return tuple(found)


def without_varied_limits(problem: ProblemFile, aims: Sequence[ParetoObjective]) -> ProblemFile:
    """Return the problem of a law without the limits that its objectives vary.

    Bounds of a dimension remain; its search starts from their middle.

    Parameters
    ----------
    problem : ProblemFile
    aims : sequence of ParetoObjective
        Objectives with a `key`.
    """
    for aim in aims:
        above, _, side = aim.key.rpartition(".")
        whole = value_at(problem, above)
        if above.startswith("mechanism."):
            problem = problem.override({above: {"bounds": whole["bounds"]}})
        elif whole is not None:
            pair = whole if isinstance(whole, list) else [whole, whole]
            sides = dict(whole) if isinstance(whole, Mapping) else dict(zip(SIDES, pair, strict=True))
            sides |= dict.fromkeys(SIDES, sides.pop("exactly")) if "exactly" in sides else {}
            sides.pop(side, None)
            if list(sides) == ["stroke"]:  # a limit that every linkage satisfies keeps the stroke
                other = "max" if side == "min" else "min"
                extreme = {"min": 1.0 if sides["stroke"] == "slow" else 1e-6, "max": 1.0 if sides["stroke"] == "quick" else 1e6}
                sides[other] = extreme[other]
            problem = problem.override({above: sides or None})
    return problem
