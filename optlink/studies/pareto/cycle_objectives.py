"""Objectives of a machine optimised over its cycle: terms, dimensions, limits by name, and the `objective` of the file."""

import copy
import math
from collections.abc import Mapping, Sequence
from typing import Any

from optlink.errors import InputError
from optlink.problem.cycle.quantities import QUANTITIES
from optlink.problem.cycle.terms import Limit, Term, read_words
from optlink.problem.file import SIDES, ProblemFile
from optlink.problem.quantity import nearest
from optlink.studies.pareto.objective import OPTION, ParetoObjective
from optlink.studies.toml_keys import Raw, exact_text
from optlink.units import KINDS, factor
from optlink.validation.cycle import Cycle

FILE_OBJECTIVE = "objective"


def cycle_objective(problem: ProblemFile, name: str, number: int) -> ParetoObjective:
    """Return the objective of a name."""
    task = problem.spec
    if name == FILE_OBJECTIVE:
        if not task.single:
            return ParetoObjective(name, "sum of the objective", "", 1)
        raw_objective = problem.raw.get("objective", {"quantity": task.goals[0].quantity})
        raw = {key: value for key, value in raw_objective.items() if key != "sense"}
        return _termed(problem, raw, -1 if task.goals[0].sense == "maximise" else 1, number, name)
    limited = task.limits.named.get(name.removeprefix("limits."))
    if limited is not None:
        sense = -1 if limited.max is None and limited.exactly is None else 1
        if limited.exactly is not None or (limited.min is not None and limited.max is not None):
            remedy = f'State the direction: "minimise {limited.words}" or "maximise {limited.words}"'
            raise InputError("the limit bounds the term on both sides", remedy, problem.file, OPTION, name)
        raw = {key: value for key, value in problem.raw["limits"][name.removeprefix("limits.")].items() if key not in SIDES}
        return _termed(problem, raw, sense, number, name)
    if name in task.quantities:
        return _termed(problem, {"quantity": "length", "of": name}, 1, number, name)
    keys = read_words(name)
    if keys is None:
        names = [*QUANTITIES, *(f"limits.{key}" for key in task.limits.named), *task.free, FILE_OBJECTIVE]
        raise InputError("unknown objective", nearest(name, names), problem.file, OPTION, name)
    way = keys.pop("sense", "maximise" if keys.get("measure") == "least" else "minimise")
    return _termed(problem, keys, -1 if way == "maximise" else 1, number, name)


def _termed(problem: ProblemFile, raw: dict[str, Any], sense: int, number: int, name: str) -> ParetoObjective:
    """Return the objective of a term, after validation by the model."""
    raw_objective = {**raw, "sense": "maximise" if sense < 0 else "minimise"}
    document = {key: value for key, value in problem.raw.items() if key != "expected"}
    try:
        read_problem = problem.with_tables({**document, "objective": raw_objective})
    except InputError as error:
        fault = error.faults[0]
        raise InputError(fault.message, fault.remedy, problem.file, OPTION, name) from None
    goal = read_problem.spec.goals[0]
    kind = read_problem.spec.kind(goal)
    unit = KINDS[kind].display if kind else ""
    side = "min" if sense < 0 else "max"
    return ParetoObjective(name, goal.words, unit, sense, f"limits.front_{number}.{side}", tuple(raw.items()))


def epsilon_problem(
    problem: ProblemFile, objectives: Sequence[ParetoObjective], goals: Mapping[int, float], bounds: Mapping[int, Raw]
) -> ProblemFile:
    """Return the problem of a machine with other objectives and bounds.

    A limit of the file on the same side of the term of an objective is removed; all others remain.

    `goals`: reference values of the minimised objectives in their units, by index; `bounds` of the constrained ones.
    """
    raw = {key: copy.deepcopy(value) for key, value in problem.raw.items() if key != "expected"}
    task = problem.spec
    removed = {
        name for name, limit in task.limits.named.items() if any(_is_replaced(limit, objective) for objective in objectives)
    }
    limits = {name: value for name, value in raw.get("limits", {}).items() if name not in removed}
    for name in removed:
        rest = _remaining_side(problem, name, objectives)
        if rest is not None:
            limits[name] = rest
    for k, value in bounds.items():
        limits[objectives[k].key.split(".")[1]] = {**dict(objectives[k].term), objectives[k].side: value}
    raw["limits"] = limits
    terms = [term for k, reference in goals.items() for term in _objective_terms(problem, objectives[k], reference)]
    single = [k for k in goals if len(goals) == 1 and objectives[k].key]
    raw["objective"] = {key: v for key, v in terms[0].items() if key != "scale"} if single else {"terms": terms}
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
    if not objective.key:
        return False
    return _same_quantity(limit, objective.cycle_term) and (
        limit.exactly is not None or getattr(limit, objective.side) is not None
    )


def _remaining_side(problem: ProblemFile, name: str, objectives: Sequence[ParetoObjective]) -> dict[str, Any] | None:
    """Return the other side of a limit that is removed, or None."""
    limit, raw = problem.spec.limits.named[name], dict(problem.raw["limits"][name])
    raw.pop("exactly", None)
    for objective in objectives:
        if _is_replaced(limit, objective):
            raw.pop(objective.side, None)
    return raw if any(side in raw for side in SIDES) else None


def cycle_figures(problem: ProblemFile, objectives: Sequence[ParetoObjective], values: Mapping[str, float]) -> tuple[float, ...]:
    """Return the values of all objectives of a machine by ordinary inverse dynamics; NaN if the crank cannot turn fully.

    `values` [SI] replace dimensions of the file.
    """
    task = problem.spec
    cycle = Cycle(task, values)
    figures = []
    for objective in objectives:
        if not objective.key:
            figures.append(cycle.objective() if cycle.full else math.nan)
            continue
        kind = task.kind(objective.cycle_term)
        figures.append(cycle.figure(objective.cycle_term) / (factor(objective.unit, kind) if kind else 1.0))
    return tuple(figures)
