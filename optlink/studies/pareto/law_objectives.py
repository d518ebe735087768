"""Objectives of a four-bar for a law: `error`, and any movable side of a limit or of a design variable."""

import math
from collections.abc import Mapping, Sequence

from optlink.errors import InputError
from optlink.optimization.constraints import rows as limit_rows
from optlink.problem.design import DesignProblem
from optlink.problem.file import SIDES, ProblemFile
from optlink.problem.interval import Interval, StrokeRatio
from optlink.problem.quantity import nearest, range_example
from optlink.studies.pareto.objective import OPTION, ParetoObjective
from optlink.studies.toml_keys import Raw, exact_text
from optlink.units import factor

ERROR = "error"
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


def law_objective(problem: ProblemFile, name: str, number: int) -> ParetoObjective:
    """Return the objective of a name: "error", a side of a limit, or a design variable."""
    task = problem.spec
    if name == ERROR:
        return ParetoObjective(name, ERROR, task.objective_unit, 1)
    limits = [f"limits.{key}.{side}" for key in VARIABLE_LIMITS for side in SIDES if (key, side) != ("pressure_angle", "min")]
    sizes = [f"mechanism.{key}" for key in task.mechanism.quantities]
    above, _, side = name.rpartition(".")
    key = above.removeprefix("mechanism.").removeprefix("limits.")
    if f"limits.{key}.{side}" in limits:
        unit = {"transmission_angle": "deg", "pressure_angle": "deg", "swing_angle": "deg", "frame_length": "mm"}.get(key, "")
        words = key.replace("_", " ")
        if key in SEVERAL:
            words = f"{'largest' if side == 'max' else 'smallest'} {words}"
        return ParetoObjective(name, words, unit, 1 if side == "max" else -1, f"limits.{key}.{side}")
    if side not in SIDES:
        key, side = name.removeprefix("mechanism."), "max"
    if key not in task.mechanism.quantities:
        raise InputError(
            "unknown objective", nearest(name, [ERROR, *limits, *(f"{s}.max" for s in sizes)]), problem.file, OPTION, name
        )
    quantity = task.quantities[key]
    if quantity.equals is not None and quantity.low is None:
        remedy = f"Give it bounds beside the link, for example: bounds = {range_example(quantity.kind)}"
        raise InputError(f"{key} follows from other quantities and has no bounds", remedy, problem.file, OPTION, name)
    if quantity.fixed:
        remedy = f"Free it, for example: --set mechanism.{key}={range_example(quantity.kind)}"
        raise InputError(f"{key} is fixed at {quantity}, so it is not a design variable", remedy, problem.file, OPTION, name)
    return ParetoObjective(name, key, quantity.display[1], 1 if side == "max" else -1, f"mechanism.{key}.{side}")


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
    if objective.key.startswith("mechanism."):
        quantity = problem.spec.quantities[name]
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


def law_figure(task: DesignProblem, objective: ParetoObjective, design: Mapping[str, float]) -> float:
    """Return the value that a limit constrains, in the unit of the objective."""
    above, _, side = objective.key.rpartition(".")
    name = above.removeprefix("mechanism.")
    if above.startswith("mechanism."):
        return design[name] / factor(objective.unit, task.quantities[name].kind)
    values = task.design(design)
    keys = {above} | ({"limits.alignment"} if name.startswith("transmission") else set())  # which may be tighter
    rows = [row for row in limit_rows(task, values, task.reach(values), values["frame"]) if row.limit in keys]
    limited = [row for row in rows if math.isfinite(row.high if (side == "max") != row.scale.cosine else row.low)]
    figures = [row.scale.to_display(float(row.value)) for row in limited]
    return max(figures) if side == "max" else min(figures)


def without_varied_limits(problem: ProblemFile, objectives: Sequence[ParetoObjective]) -> ProblemFile:
    """Return the problem of a law without the limits that its objectives vary.

    Bounds of a dimension remain; its search starts from their middle.
    """
    for objective in objectives:
        above, _, side = objective.key.rpartition(".")
        entry = problem.at(above)
        if above.startswith("mechanism."):
            problem = problem.override({above: {key: value for key, value in entry.items() if key != "start"}})
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
