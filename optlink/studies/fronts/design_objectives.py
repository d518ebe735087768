"""Objectives of a design: deviations from targets, limits, dimensions and quantities of the machine; those of a machine alone."""

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from optlink.errors import InputError, given_as
from optlink.io import without
from optlink.optimization.courses import extent_of, has_position_limits
from optlink.optimization.terms import position_rows, rows as limit_rows
from optlink.problem.design import DesignProblem
from optlink.problem.file import SIDES, ProblemFile
from optlink.problem.limits import Reach
from optlink.problem.quantity import Interval, StrokeRatio, file_key, nearest, range_example
from optlink.problem.terms import QUANTITIES, Limit, Term, read_words
from optlink.studies.grid import Axis, Raw, column_name, exact_text, read_axis
from optlink.studies.target_programme import limit_key
from optlink.units import DISPLAYED, KINDS, factor, in_si
from optlink.validation.cycle import Cycle
from optlink.validation.design import validate_batch
from optlink.validation.timing import passing

# One objective of a Pareto front.

OPTION = "--objectives"


@dataclass(frozen=True)
class ParetoObjective:
    """One objective of a Pareto front: its text, `text`, its `name`, and the `unit` in which it is shown.

    `sense`: 1 to minimise, -1 to maximise; `key`: the limit that constrains it in the problem file, with its side, empty for an
    objective that can only be minimised itself; `term`: of a machine, as in the file; `span`: the requested range, if any;
    `of`: name of a dimension; `part`: number of the requirement whose deviation it is.
    """

    text: str
    name: str
    unit: str
    sense: int
    key: str = ""
    term: tuple[tuple[str, Any], ...] = ()
    span: str = ""
    of: str = ""
    part: int = -1

    @property
    def direct(self) -> bool:
        """Whether it can be minimised itself, not only constrained."""
        return self.part >= 0 or bool(self.term) or not self.key

    @property
    def si_per_unit(self) -> float:
        """Its unit [SI]."""
        return in_si(self.unit)[0]

    @property
    def column(self) -> str:
        """Name of its column in the table [SI]."""
        return column_name(self.name, self.unit).replace(" ", "_")

    @property
    def best(self) -> str:
        """Name of its end of the front."""
        if self.name.startswith(("largest", "least", "smallest")):
            return f"best {self.name}"
        return f"{'least' if self.sense > 0 else 'largest'} {self.name}"

    @property
    def way(self) -> str:
        """Whether it is minimised or maximised, in a word."""
        return "minimise" if self.sense > 0 else "maximise"

    @property
    def side(self) -> str:
        """Side of the limit that constrains it."""
        return "max" if self.sense > 0 else "min"

    @property
    def cycle_term(self) -> Term:
        """Term of a machine."""
        return Term.model_validate(dict(self.term))

    def worsened(self, value: float, by: float) -> float:
        """Return a value that is worse by an amount.

        Parameters
        ----------
        value, by : float
            In the unit of the objective.
        """
        return value + self.sense * by


def range_values(objective: ParetoObjective, count: int) -> Axis:
    """Return the values of the requested range of an objective."""
    stated = any(mark in objective.span for mark in (":", "step", ","))
    return read_axis(objective.key, objective.span + ("" if stated else f":{count}"))


ERROR, SUM = "error", "objective"
VARIABLE_LIMITS = (
    "transmission_angle",
    "pressure_angle",
    "transmission_cosine",
    "swing_angle",
    "time_ratio",
    "frame_length",
    "link_ratio",
)
SEVERAL = (
    "transmission_angle",
    "pressure_angle",
    "transmission_cosine",
    "link_ratio",
)  # limits with a largest and a smallest value
SIDE_DISTANCE = 1e-3  # relative distance between the sides of a limit with one side at its tightest
FAR = {"m": 100.0, "rad": 3.0, "": 0.9999}  # of the scale of a deviation: a tolerance that hardly limits it
POSITIONS = 14_401  # crank angles at which extreme transmission angles are measured


def design_objective(problem: ProblemFile, name: str, number: int) -> ParetoObjective:
    """Return the objective of a name: a deviation, a side of a limit, a design variable, or a quantity of the machine."""
    task = problem.spec
    errors = {f"{part.prefix}{ERROR}": k for k, part in enumerate(task.parts) if part.requirement.stated(part)[1] is None}
    if name in errors:
        part = task.parts[errors[name]]
        return ParetoObjective(name, name, error_display(part)[1], 1, limit_key(part), part=errors[name])
    if name == SUM and problem.raw.get("objective") is not None:
        return ParetoObjective(name, "sum of the objective", task.objective_display[1], 1)
    if (named := _named(problem, name)) is not None:
        return named
    keys = [key for key in VARIABLE_LIMITS if f"limits.{key}" not in task.inapplicable]
    limits = [f"limits.{key}.{side}" for key in keys for side in SIDES if (key, side) != ("pressure_angle", "min")]
    places = {key: file_key(problem.raw["mechanism"], key) for key in task.mechanism.quantities}
    above, _, side = name.rpartition(".")
    key = above.removeprefix("mechanism.").removeprefix("limits.")
    if f"limits.{key}.{side}" in limits:
        shown = {"transmission_angle": "deg", "pressure_angle": "deg", "swing_angle": "deg", "frame_length": "mm"}.get(key, "")
        words = key.replace("_", " ")
        if key in SEVERAL:
            words = f"{'largest' if side == 'max' else 'smallest'} {words}"
        return ParetoObjective(name, words, shown, 1 if side == "max" else -1, f"limits.{key}.{side}")
    stated, side = (above, side) if side in SIDES else (name, "max")
    of = next((key for key, place in places.items() if stated in (key, place, f"mechanism.{key}")), None)
    if of is None:
        if (term := read_words(name)) is not None:
            return _termed(problem, term, number, name)
        known = [*errors, *limits, *(f"{place}.max" for place in places.values()), *QUANTITIES]
        raise InputError("unknown objective", nearest(name, known), problem.file, OPTION, name)
    quantity = task.quantities[of]
    if quantity.equals is not None and quantity.low is None:
        remedy = f"Give it bounds beside the link, for example: bounds = {range_example(quantity.kind)}"
        raise InputError(f"{of} follows from other quantities and has no bounds", remedy, problem.file, OPTION, name)
    if quantity.fixed:
        remedy = f"Free it, for example: --set {places[of]}={range_example(quantity.kind)}"
        raise InputError(f"{of} is fixed at {quantity}, so it is not a design variable", remedy, problem.file, OPTION, name)
    return ParetoObjective(name, of, quantity.display[1], 1 if side == "max" else -1, f"{places[of]}.{side}", of=of)


def error_display(part: DesignProblem) -> tuple[float, str]:
    """Return the factor from SI to the displayed measure of a requirement, and the unit of that; squares of angles are in SI."""
    scale, shown = DISPLAYED[part.unit]
    if part.tolerance is not None:
        return scale * part.requirement.stated(part)[0], shown
    if part.measure != "sum of squares":
        return scale, shown
    return (1.0, "rad^2") if part.unit == "rad" else (scale**2, f"{shown}^2" if shown else "")


def limited_objective(problem: ProblemFile, objective: ParetoObjective) -> ParetoObjective:
    """Return an objective as it is constrained: a sum of squares by its root mean square."""
    if objective.part < 0:
        return objective
    part = problem.spec.parts[objective.part]
    key, what = part.requirement.limited_by
    name = f"{part.prefix}{what}" if key != "tolerance" else objective.name
    name = f"rms {name}" if part.measure == "sum of squares" else name
    return replace(objective, name=name, unit=DISPLAYED[part.unit][1])


def _named(problem: ProblemFile, name: str) -> ParetoObjective | None:
    """Return the objective that is the term of a limit of the file under a name of the user's choice; None for another name."""
    task = problem.spec
    above, _, side = name.removeprefix("limits.").rpartition(".")
    key = above if side in SIDES else name.removeprefix("limits.")
    bound = next((bound for bound in task.bounds if bound.key == f"limits.{key}"), None)
    if bound is None:
        return None
    raw = problem.raw["limits"][key]
    stated = [one for one in SIDES if one in raw]
    if side not in SIDES and len(stated) != 1:
        remedy = f'State the side: "limits.{key}.max" or "limits.{key}.min"'
        raise InputError("the limit bounds the term on both sides", remedy, problem.file, OPTION, name)
    side = side if side in SIDES else stated[0]
    kind = task.kind(bound.term)
    term = tuple((part, value) for part, value in raw.items() if part not in (*SIDES, "exactly"))
    shown = KINDS[kind].display if kind else ""
    return ParetoObjective(name, bound.term.words, shown, 1 if side == "max" else -1, f"limits.{key}.{side}", term)


def _termed(problem: ProblemFile, keys: dict[str, Any], number: int, name: str) -> ParetoObjective:
    """Return the objective that is a quantity of the machine, after validation by the model."""
    way = keys.pop("sense", "maximise" if keys.get("measure") == "least" else "minimise")
    sense = -1 if way == "maximise" else 1
    side = "min" if sense < 0 else "max"
    asked = ParetoObjective(name, name, "", sense, f"limits.front_{number}.{side}", tuple(keys.items()))
    with given_as(problem.file, OPTION, name):
        read = design_problem(problem, [asked], 0, {})
    goal = read.spec.goals[0]
    kind = read.spec.kind(goal)
    return ParetoObjective(name, goal.words, KINDS[kind].display if kind else "", sense, asked.key, asked.term)


def design_problem(
    problem: ProblemFile, objectives: Sequence[ParetoObjective], minimised: int, bounds: Mapping[int, Raw]
) -> ProblemFile:
    """Return the problem with one of its objectives minimised and bounds of others, in their units, by number.

    The deviation of a requirement that is minimised in the file, but here neither minimised nor bounded, is hardly limited.
    """
    own, parts = objectives[minimised].part, problem.spec.parts
    alone = own < 0 or (
        "objective" not in problem.raw and all((k == own) == (part.tolerance is None) for k, part in enumerate(parts))
    )
    if alone and not objectives[minimised].term and not any(objectives[k].term or objectives[k].part >= 0 for k in bounds):
        return problem.override({objectives[k].key: value for k, value in bounds.items()})
    raw = {key: copy.deepcopy(value) for key, value in problem.raw.items() if key != "expected"}
    stated = {objectives[k].part: value for k, value in bounds.items() if objectives[k].part >= 0}
    for k, part in enumerate(parts):
        table = raw["requirements"][int(part.key.rpartition(".")[2])] if part.prefix else raw["requirement"]
        summed = not (own >= 0 or objectives[minimised].term)  # the objective of the file remains
        for key in () if summed and k not in stated else ("weight", "scale"):
            table.pop(key, None)
        if k == own and part.requirement.limited:  # minimised, though the file limits it
            table.pop(part.requirement.limited_by[0])
            table |= {"measure": part.measure} if "measure" in type(part.requirement).model_fields else {}
        if k not in stated and (k == own or part.tolerance is not None or summed):
            continue
        shown, name = DISPLAYED[part.unit]
        if "measure" in type(part.requirement).model_fields:
            table["measure"] = "rms" if part.measure == "sum of squares" else part.measure
        far = FAR[part.unit] * part.whole * shown * part.requirement.stated(part)[0]
        table[part.requirement.limited_by[0]] = stated.get(k, exact_text(far, name))
    limits = dict(raw.get("limits", {}))
    for k, value in bounds.items():
        if objectives[k].term:
            name = objectives[k].key.split(".")[1]
            limits[name] = {**limits.get(name, {}), **dict(objectives[k].term), objectives[k].side: value}
    if limits:
        raw["limits"] = limits
    if own >= 0:
        raw.pop("objective", None)
    if objectives[minimised].term:
        raw["objective"] = {**dict(objectives[minimised].term), "sense": objectives[minimised].way}
    file = problem.with_tables(raw)
    others = [k for k in bounds if not objectives[k].term and objectives[k].part < 0]
    return file.override({objectives[k].key: bounds[k] for k in others}) if others else file


def design_figures(problem: ProblemFile, objectives: Sequence[ParetoObjective], values: Mapping[str, float]) -> tuple[float, ...]:
    """Return the values of objectives for a design [SI] in their units, in the assembly mode with the least deviations."""

    def measured(file: ProblemFile) -> list[float]:
        task, errors = file.spec, []
        for part in task.parts:
            own = part.own(task.design(values))
            errors.append(float(validate_batch(part, own, passing(part, own)).of().objective))
        return errors

    files, errors = problem.variants(), list[float]()
    if len(files) > 1 or any(objective.part >= 0 for objective in objectives):
        file, errors = min(((file, measured(file)) for file in files), key=lambda pair: sum(pair[1]))
    else:
        (file,) = files
    return tuple(_figure(file.spec, objective, file.spec.design(values), errors) for objective in objectives)


def _figure(task: DesignProblem, objective: ParetoObjective, design: Mapping[str, float], errors: Sequence[float]) -> float:
    """Return the value of an objective in its unit."""
    if objective.part >= 0:
        part = task.parts[objective.part]
        return error_display(part)[0] * errors[objective.part]
    if objective.term:
        kind = task.kind(objective.cycle_term)
        figure = Cycle(task, {name: design[name] for name in task.mechanism.quantities}).figure(objective.cycle_term)
        return figure / (factor(objective.unit, kind) if kind else 1.0)
    if not objective.key:
        return math.nan
    return limited_figure(task, objective, design)


def limit_in_file(problem: ProblemFile, key: str) -> Raw | None:
    """Return the value in the file at one side of a limit, or None."""
    above, _, side = key.rpartition(".")
    entry = problem.at(above)
    if isinstance(entry, Mapping):
        entry = entry.get("bounds", entry) if key.startswith("mechanism.") else entry
    if isinstance(entry, list):
        return entry[SIDES.index(side)]  # type: ignore[no-any-return]
    return entry.get(side, entry.get("exactly")) if isinstance(entry, Mapping) else entry  # type: ignore[no-any-return]


def tightest_bound(problem: ProblemFile, objective: ParetoObjective) -> Raw:
    """Return the tightest bound that can be stated, whether or not a linkage satisfies it."""
    above = objective.key.rpartition(".")[0]
    name = above.rpartition(".")[2]
    opposite: float | None = None
    if objective.of:
        quantity = problem.spec.quantities[objective.of]
        low, high = (bound / factor(objective.unit, quantity.kind) for bound in quantity.bounds)
        return exact_text(low + 1e-6 * (high - low) if objective.sense > 0 else high - 1e-6 * (high - low), objective.unit)
    limited: Interval | None = getattr(problem.spec.limits, name)
    if limited is not None:
        opposite = limited.low if objective.sense > 0 else limited.high
    if opposite is not None:
        assert limited is not None
        other_bound = opposite / factor(objective.unit, limited.kind) if limited.kind else opposite
        return exact_text(
            objective.worsened(other_bound, SIDE_DISTANCE * abs(other_bound)), objective.unit
        )  # equal sides would prescribe one value at all positions
    small, large = {"deg": (1.0, 179.0), "mm": (1e-3, 1e8)}.get(objective.unit, (1e-3, 1e3))
    if isinstance(limited, StrokeRatio):
        small, large = (1.0 if limited.stroke in (None, "slow") else small), (1.0 if limited.stroke == "quick" else large)
    elif name == "time_ratio":
        small = 1.0
    if name == "transmission_cosine":
        small, large = -0.999, 0.999
    return exact_text(small if objective.sense > 0 else large, objective.unit)


def limited_figure(task: DesignProblem, objective: ParetoObjective, design: Mapping[str, float]) -> float:
    """Return the value that a limit constrains, in the unit of the objective; `design` has all quantities [SI]."""
    above, _, side = objective.key.rpartition(".")
    if objective.of:
        return design[objective.of] / factor(objective.unit, task.quantities[objective.of].kind)
    keys = {above} | ({"limits.alignment"} if above.startswith("limits.transmission") else set())  # which may be tighter
    begin, span = extent_of(task)
    if not has_position_limits(task) or task.limits.transmission_range == "span":
        angles = passing(task, design)
        begin, span = float(angles[0]), float(angles[-1] - angles[0])
    if has_position_limits(task):
        rows = position_rows(task, task.linkage.at(design, begin + span * np.linspace(0.0, 1.0, POSITIONS)))
    else:
        reach = task.reach(design) if task.law_given else Reach(begin, span, 1.0 if span >= 0.0 else -1.0)
        rows = limit_rows(task, design, reach, task.size)
    limited = [row for row in rows if row.limit in keys]
    if any(row.limit == above for row in limited):
        limited = [row for row in limited if row.limit == above or not has_position_limits(task)]
    limited = [row for row in limited if math.isfinite(row.high if (side == "max") != row.scale.cosine else row.low)]
    upper = (side == "max") != any(row.scale.cosine for row in limited)  # of the values of the rows
    extremes = [float(np.max(row.value) if upper else np.min(row.value)) for row in limited]
    figures = [row.scale.to_display(extreme) for row, extreme in zip(limited, extremes, strict=True)]
    return max(figures) if side == "max" else min(figures)


def without_varied_limits(problem: ProblemFile, objectives: Sequence[ParetoObjective]) -> ProblemFile:
    """Return the problem without the limits that its objectives vary.

    Bounds of a dimension remain; its search starts from their middle.
    """
    for objective in objectives:
        above, _, side = objective.key.rpartition(".")
        entry = problem.at(above)
        if objective.term and entry is not None:
            rest = without(entry, side, "exactly")
            problem = problem.override({above: rest if any(key in SIDES for key in rest) else None})
        if objective.term or objective.part >= 0:
            continue
        if above.startswith("mechanism."):
            problem = problem.override({above: without(entry, "start")})
        elif above == "limits.pressure_angle":
            problem = problem.override({above: None})
        elif entry is not None:
            pair = entry if isinstance(entry, list) else [entry, entry]
            sides = dict(entry) if isinstance(entry, Mapping) else dict(zip(SIDES, pair, strict=True))
            sides |= dict.fromkeys(SIDES, sides.pop("exactly")) if "exactly" in sides else {}
            sides.pop(side, None)
            if list(sides) == ["stroke"]:  # a limit that every linkage satisfies keeps the stroke
                opposite = "max" if side == "min" else "min"
                extreme = {"min": 1.0 if sides["stroke"] == "slow" else 1e-6, "max": 1.0 if sides["stroke"] == "quick" else 1e6}
                sides[opposite] = extreme[opposite]
            problem = problem.override({above: sides or None})
    return problem


# --- machines -----------------------------------------------------------------------------------------------------------------


def cycle_objective(problem: ProblemFile, name: str, number: int) -> ParetoObjective:
    """Return the objective of a name: a term of the machine, a dimension, a limit by its name, the `objective` of the file."""
    task = problem.spec
    if name == SUM:
        if not task.single:
            return ParetoObjective(name, "sum of the objective", "", 1)
        raw_objective = problem.raw.get("objective", {"quantity": task.goals[0].quantity})
        return _termed(problem, {**raw_objective, "sense": task.goals[0].sense}, number, name)
    limited = task.limits.named.get(name.removeprefix("limits."))
    if limited is not None:
        if limited.exactly is not None or (limited.min is not None and limited.max is not None):
            remedy = f'State the direction: "minimise {limited.words}" or "maximise {limited.words}"'
            raise InputError("the limit bounds the term on both sides", remedy, problem.file, OPTION, name)
        raw = without(problem.raw["limits"][name.removeprefix("limits.")], *SIDES)
        way = "maximise" if limited.max is None and limited.exactly is None else "minimise"
        return _termed(problem, {**raw, "sense": way}, number, name)
    if name in task.quantities:
        return _termed(problem, {"quantity": "length", "of": name}, number, name)
    keys = read_words(name)
    if keys is None:
        names = [*QUANTITIES, *(f"limits.{key}" for key in task.limits.named), *task.free, SUM]
        raise InputError("unknown objective", nearest(name, names), problem.file, OPTION, name)
    return _termed(problem, keys, number, name)


def epsilon_problem(
    problem: ProblemFile, objectives: Sequence[ParetoObjective], goals: Mapping[int, float], bounds: Mapping[int, Raw]
) -> ProblemFile:
    """Return the problem of a machine with other objectives and bounds.

    A limit of the file on the same side of the term of an objective is removed; all others remain.

    `goals`: reference values of the minimised objectives in their units, by index; `bounds` of the constrained ones.
    """
    raw = {key: copy.deepcopy(value) for key, value in problem.raw.items() if key != "expected"}
    task = problem.spec
    limits = raw.get("limits", {})
    for name, limit in task.limits.named.items():
        if replaced := {objective.side for objective in objectives if _is_replaced(limit, objective)}:
            rest = without(limits.pop(name), *(replaced | {"exactly"}))
            limits |= {name: rest} if rest.keys() & SIDES else {}
    for k, value in bounds.items():
        limits[objectives[k].key.split(".")[1]] = {**dict(objectives[k].term), objectives[k].side: value}
    raw["limits"] = limits
    terms = [term for k, reference in goals.items() for term in _objective_terms(problem, objectives[k], reference)]
    single = [k for k in goals if len(goals) == 1 and objectives[k].key]
    raw["objective"] = without(terms[0], "scale") if single else {"terms": terms}
    return problem.with_tables(raw)


def _objective_terms(problem: ProblemFile, objective: ParetoObjective, reference: float) -> list[dict[str, Any]]:
    """Return the terms of an objective, with the reference value `reference` [its unit]."""
    if objective.key:
        sense = "maximise" if objective.sense < 0 else "minimise"
        return [{**dict(objective.term), "sense": sense, "scale": exact_text(reference, objective.unit)}]
    return [{**term, "weight": term.get("weight", 1.0) / reference} for term in problem.raw["objective"]["terms"]]


def _same_quantity(first: Term, second: Term) -> bool:
    keys = ("quantity", "of", "on", "how", "static", "stroke", "about")
    directions = [None if term.direction is None else term.direction.value for term in (first, second)]
    return directions[0] == directions[1] and all(getattr(first, key) == getattr(second, key) for key in keys)


def _is_replaced(limit: Limit, objective: ParetoObjective) -> bool:
    """Return whether a limit constrains the term of an objective on the side that is varied."""
    stated = limit.exactly is not None or getattr(limit, objective.side) is not None
    return bool(objective.key) and stated and _same_quantity(limit, objective.cycle_term)


def cycle_figures(problem: ProblemFile, objectives: Sequence[ParetoObjective], values: Mapping[str, float]) -> tuple[float, ...]:
    """Return the values of all objectives of a machine by ordinary inverse dynamics; NaN if the crank cannot turn fully.

    `values` [SI] replace dimensions of the file.
    """
    task = problem.spec
    cycle = Cycle(task, values)
    figures = []
    for objective in objectives:
        if not objective.key:
            figures.append(cycle.objective() if cycle.complete else math.nan)
            continue
        kind = task.kind(objective.cycle_term)
        figures.append(cycle.figure(objective.cycle_term) / (factor(objective.unit, kind) if kind else 1.0))
    return tuple(figures)
