"""Objectives of a Pareto front: reading, the limit that constrains each, and their values for a design.

A machine optimised over its cycle has terms ("peak torque", "guide force in F", "stroke of ram"), dimensions ("crank.length"),
its limits by name, and the `objective` of the file. A four-bar for a law has `error`, its measure, and
any movable side of a limit or of a design variable: `limits.transmission_angle.max`, `mechanism.coupler.max`.
"""

from dataclasses import replace
from pathlib import Path

from optlink.errors import InputError
from optlink.problem.file import ProblemFile
from optlink.studies.pareto.epsilon_ranges import RANGES
from optlink.studies.pareto.law_objectives import ERROR
from optlink.studies.pareto.objective import OPTION, ParetoObjective, range_values
from optlink.units import UnitProblem, factor

PRESCRIBED = {
    "path": "points of a path are",
    "motion": "poses of a body are",
    "function": "values of a function are",
    "transmission": "a swing and a good transmission are",
}
EXAMPLES = (
    'For example --objectives "peak torque, guide force in F" of a machine, "error, limits.transmission_angle.max" of a law'
)


def read_objectives(problem: ProblemFile, objectives: str) -> tuple[ParetoObjective, ...]:
    """Read two or three objectives, separated by commas; `NAME=LOW..HIGH UNIT` restricts an objective to a range."""
    if not objectives.strip():
        raise InputError("two or three objectives are missing", EXAMPLES, problem.file, OPTION)
    parts = [part.strip() for part in objectives.split(",")]
    if not all(parts):
        raise InputError("an objective is empty", EXAMPLES, problem.file, OPTION, objectives)
    if not 2 <= len(parts) <= 3:
        what = "one objective has no trade-off" if len(parts) == 1 else f"{len(parts)} objectives are too many for a front"
        raise InputError(what, f"Give two or three. {EXAMPLES}", problem.file, OPTION, objectives)
    if problem.task not in RANGES:
        raise _no_front(problem)
    if not problem.model.free:
        raise InputError("no design variables: every dimension is fixed", "Free a dimension", problem.file, "mechanism")
    parsed = tuple(_ranged(problem, part, k + 1) for k, part in enumerate(parts))
    for k, objective in enumerate(parsed):
        if any(objective.name == previous.name for previous in parsed[:k]):
            raise InputError("the same objective twice", "Give each once", problem.file, OPTION, objective.text)
    if problem.task != "cycle" and all(objective.key for objective in parsed):
        remedy = f'One objective must be minimised directly: write "{ERROR}, {parsed[0].text}"'
        raise InputError("two limits alone do not define a trade-off", remedy, problem.file, OPTION, objectives)
    return parsed


def _no_front(problem: ProblemFile) -> InputError:
    """Return the error that a problem has no Pareto front, with an alternative."""
    whose = "Fronts are those of machines with an [objective] over their cycle, and of four-bars for a law"
    kind = getattr(getattr(problem.model, "requirement", None), "kind", None)
    if kind in PRESCRIBED:
        label = problem.file if Path(problem.file).is_file() else problem.name  # of a shipped one the name
        instead = f"to see how a limit changes the optimum: `optlink study sweep {label} --vary KEY=LOW..HIGH:N`"
        return InputError(f"{PRESCRIBED[kind]} prescribed here", f"{whose}; {instead}", problem.file)
    if getattr(problem.model, "balance", None) is not None:
        instead = f"that of two measures of balancing: `optlink balance {problem.name} --trade force,torque`"
        return InputError("a balancing problem has no such objectives", f"{whose}; {instead}", problem.file)
    return InputError("the problem has no [objective]", f"{whose}; add an [objective] and design variables", problem.file)


def _ranged(problem: ProblemFile, part: str, number: int) -> ParetoObjective:
    name, equals, span = (piece.strip() for piece in part.partition("="))
    if equals and not span:
        raise InputError("the range is empty", "Write NAME=LOW..HIGH UNIT", problem.file, OPTION, part)
    objective = RANGES[problem.task].objective(problem, name, number)
    if span and not objective.key:
        raise InputError(f"{name} has no range: it is minimised", "Leave the range out", problem.file, OPTION, part)
    objective = replace(objective, span=span)
    if objective.key.startswith("mechanism."):
        _check_bounds(problem, objective)
    return objective


def _check_bounds(problem: ProblemFile, objective: ParetoObjective) -> None:
    """Check that the requested range lies within the bounds of a dimension."""
    name = objective.key.removeprefix("mechanism.").rpartition(".")[0]
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
