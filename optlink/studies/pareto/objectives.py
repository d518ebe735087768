"""Objectives of a Pareto front: reading, the limit that constrains each, and their values for a design.

A machine optimised over its cycle has terms ("peak torque", "guide force in F", "stroke of ram"), dimensions ("crank.length"),
its limits by name, and the `objective` of the file. A design for targets has `error`, the measure of their deviations
(`walk.error` of the requirement `walk` of several), any movable side of a limit or of a design variable:
`limits.transmission_angle.max`, `mechanism.coupler.max`, and terms of its machine ("total length", "peak torque").
"""

from dataclasses import replace

from optlink.errors import InputError
from optlink.problem.file import ProblemFile
from optlink.studies.pareto.design_objectives import ERROR, OPTION, ParetoObjective, range_values
from optlink.studies.pareto.epsilon_ranges import RANGES
from optlink.units import UnitProblem, factor

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


def _ranged(problem: ProblemFile, part: str, number: int) -> ParetoObjective:
    name, equals, span = (piece.strip() for piece in part.partition("="))
    if equals and not span:
        raise InputError("the range is empty", "Write NAME=LOW..HIGH UNIT", problem.file, OPTION, part)
    objective = RANGES[problem.task].objective(problem, name, number)
    if span and not objective.key:
        raise InputError(f"{name} has no range: it is minimised", "Leave the range out", problem.file, OPTION, part)
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
