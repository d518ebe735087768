"""Where the limits of a front walk: from where the other objectives are best to the best of the one that is held."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from optlink.design.files import ProblemFile
from optlink.errors import Fault, InputError, Status
from optlink.machine_design import design_machine
from optlink.studies.aims import OPTION, Aim, bare, cycle_figures, law_figure, tightest, walked
from optlink.studies.axes import Axis, Grid, read_axis
from optlink.studies.keys import Raw, text
from optlink.studies.machines import restarted
from optlink.studies.reoptimise import buildable
from optlink.workflow import solve

Once = Callable[[str, Callable[[], Mapping[str, Any]]], Mapping[str, Any]]
"""(name, search) -> what the search finds, fit for JSON, done now or before"""

NEAR = 1e-4  # of its extent by which an objective is let go at its own end, where nothing else could move
NONE = 1e-6  # relative; an objective that moves less has no trade-off


class NoEnd(InputError):
    """An end of the front that cannot be found."""


def stated(problem: ProblemFile, aims: tuple[Aim, ...], first: int, count: int) -> dict[int, Axis]:
    """Values of the limits that are to walk along a range that was asked for, by the number of the objective.

    Raises
    ------
    InputError
        ranges without sense; an objective that has to have one.
    """
    held = [k for k in range(len(aims)) if k != first]
    base = problem if problem.machined else bare(problem, [aims[k] for k in held])
    found = {}
    for k in held:
        aim = aims[k]
        if aim.span:
            held_at = partial(_held, problem, aims, first, k) if problem.machined else partial(_moved, base, aim.key)
            with _blamed(problem, aim):
                found[k] = _stated(aim, count, held_at)
    for k in held:
        if k not in found and not problem.machined and not buildable(base, (aims[k].key,)):
            raise _no_end(problem, aims[k], "a function has many optima, its ends are not searched")
    return found


def searches(aims: tuple[Aim, ...], first: int, fixed: Mapping[int, Axis], *, machined: bool) -> int:
    """How many searches it takes to find where limits without a range walk."""
    open_ends = len(aims) - 1 - len(fixed)
    if not open_ends:
        return 0
    if not machined:
        return 1 + open_ends + (len(aims) - 1 if len(aims) > 2 else 0)
    return 1 + 2 * open_ends + bool(aims[first].key)


def walks(
    problem: ProblemFile,
    aims: tuple[Aim, ...],
    first: int,
    fixed: Mapping[int, Axis],
    count: int,
    backend: str,
    once: Once,
) -> tuple[ProblemFile, Grid, tuple[Mapping[str, float], ...]]:
    """The problem in which objective number `first` is minimised, the values of the limits that hold the others, and machines at
    the ends (sizes [SI]), if those were searched.

    Parameters
    ----------
    fixed : mapping of the number of an objective to the walk that was asked for
        See `stated`.
    once : function of a name and a search
        Gives what the search finds, fit for JSON, and need not do it again.

    Raises
    ------
    NoEnd
    """
    return (_of_machine if problem.machined else _of_law)(problem, aims, first, fixed, count, backend, once)


def _axis(aim: Aim, tight: float, loose: float, count: int) -> Axis:
    """Values of a limit from the loose end of the front to the tight one, both in short figures and inside it."""
    width = abs(loose - tight)
    if not width > NONE * max(abs(tight), abs(loose)):
        return Axis(aim.key, aim.unit, (aim.loose(tight, NONE * abs(tight)),))
    step = 10.0 ** math.floor(math.log10(NEAR * width))
    tight = aim.sense * math.ceil(aim.sense * aim.loose(tight, NEAR * width) / step) * step
    loose = aim.sense * math.floor(aim.sense * loose / step) * step
    return Axis(aim.key, aim.unit, tuple(float(f"{value:.12g}") for value in np.linspace(loose, tight, count)))


def _stated(aim: Aim, count: int, made: Callable[[Raw], ProblemFile]) -> Axis:
    """The range that was asked for, from its loose end; `made` gives the problem with a value of the limit."""
    axis = read_axis(f"{aim.key}={aim.span}" if ":" in aim.span or "step" in aim.span else f"{aim.key}={aim.span}:{count}")
    for at in (0, len(axis.values) - 1):
        made(axis.raw(at))
    return replace(axis, values=tuple(sorted(axis.values, reverse=aim.sense > 0)))


@contextlib.contextmanager
def _blamed(problem: ProblemFile, aim: Aim) -> Iterator[None]:
    """Say of whatever is wrong that the objective is to blame."""
    said = f"{aim.said}={aim.span}" if aim.span else aim.said
    try:
        yield
    except InputError as error:
        fault = error.faults[0]
        raise InputError(Fault(fault.message, fault.remedy, problem.file, OPTION, said)) from None


def _no_end(problem: ProblemFile, aim: Aim, why: str) -> NoEnd:
    remedy = f'Say where to walk: "{aim.said}=LOW..HIGH{" " + aim.unit if aim.unit else ""}"'
    return NoEnd(Fault(f"the end with the {aim.best} cannot be found: {why}", remedy, problem.file, OPTION, aim.said))


def _of_law(
    problem: ProblemFile,
    aims: tuple[Aim, ...],
    first: int,
    fixed: Mapping[int, Axis],
    count: int,
    backend: str,
    once: Once,
) -> tuple[ProblemFile, Grid, tuple[Mapping[str, float], ...]]:
    """From where the error alone decides to the tightest limit that a linkage meets."""
    held = [aim for k, aim in enumerate(aims) if k != first]
    base, found = bare(problem, held), {aims[k].key: axis for k, axis in fixed.items()}
    if len(found) < len(held):
        free = base.override({key: axis.raw(0) for key, axis in found.items()})
        found |= _law_walks(problem, free, aims[first], held, dict(found), count, backend, once)
    return base, Grid(tuple(found[aim.key] for aim in held)), ()


def _moved(base: ProblemFile, key: str, value: Raw) -> ProblemFile:
    return base.override({key: value})


def _held(problem: ProblemFile, aims: Sequence[Aim], first: int, number: int, value: Raw) -> ProblemFile:
    return walked(problem, aims, {first: 1.0}, {number: value})


def _law_walks(
    problem: ProblemFile,
    free: ProblemFile,
    minimised: Aim,
    held: Sequence[Aim],
    fixed: Mapping[str, Axis],
    count: int,
    backend: str,
    once: Once,
) -> dict[str, Axis]:
    """Ranges of the limits that no range was asked for; `free` is the problem with nothing of what is held but the loosest."""

    def optimum(task: ProblemFile, blamed: Aim | None = None) -> dict[str, Any]:
        found = solve(task, backend)
        if blamed is not None and not found.valid:
            raise _no_end(problem, blamed, found.status.text)
        return {"design": dict(found.design) if found.valid else None}

    unbound = [aim for aim in held if aim.key not in fixed]
    best = once(minimised.best, lambda: optimum(free, minimised))
    tight = {aim.key: once(aim.best, partial(_tight, problem, free, aim, backend))["limit"] for aim in unbound}
    corners = {aim.key: text(aim.loose(tight[aim.key], NEAR * abs(tight[aim.key])), aim.unit) for aim in unbound}
    corners |= {key: axis.raw(len(axis.values) - 1) for key, axis in fixed.items()}
    others = {}
    if len(held) > 1:
        for aim in held:
            task = free.override({aim.key: corners[aim.key]})
            others[aim.key] = once(f"{minimised.best}, {aim.best}", partial(optimum, task))
    found = {}
    for aim in unbound:
        limited = free.override({aim.key: tightest(free, aim)}).spec
        designs = [best["design"], *(other["design"] for key, other in others.items() if key != aim.key and other["design"])]
        worst = aim.sense * max(aim.sense * law_figure(limited, aim, design) for design in designs)
        found[aim.key] = _axis(aim, tight[aim.key], worst, count)
    return found


def _tight(problem: ProblemFile, free: ProblemFile, aim: Aim, backend: str) -> dict[str, float]:
    """The tightest value of a limit with which there is a design: the least relaxation of one that there is none with."""
    tight = free.override({aim.key: tightest(free, aim)})
    found = solve(tight, backend)
    if found.solution is not None and found.solution.usable:  # there is one, at the edge of what can be stated
        return {"limit": law_figure(tight.spec, aim, found.design)}
    sense = "<=" if aim.sense > 0 else ">="
    for item in found.conflict:
        if item.key == aim.key.rpartition(".")[0] and item.sense == sense and math.isfinite(item.relaxed):
            return {"limit": item.relaxed}
    raise _no_end(problem, aim, found.status.text)


def _of_machine(
    problem: ProblemFile,
    aims: tuple[Aim, ...],
    first: int,
    fixed: Mapping[int, Axis],
    count: int,
    backend: str,
    once: Once,
) -> tuple[ProblemFile, Grid, tuple[Mapping[str, float], ...]]:
    """From where the other objectives are best to where the one that is held is."""
    held = [k for k in range(len(aims)) if k != first]
    axes = dict(fixed)
    anchors: tuple[Mapping[str, float], ...] = ()
    if len(fixed) < len(held):
        found, anchors = _machine_walks(problem, aims, first, {k: axis.raw(0) for k, axis in fixed.items()}, count, backend, once)
        axes |= found
    base = walked(problem, aims, {first: 1.0}, {k: axes[k].raw(0) for k in held})
    return restarted(base, anchors[0]) if anchors else base, Grid(tuple(axes[k] for k in held)), anchors


def _machine_walks(
    problem: ProblemFile,
    aims: tuple[Aim, ...],
    first: int,
    bounds: Mapping[int, Raw],
    count: int,
    backend: str,
    once: Once,
) -> tuple[dict[int, Axis], tuple[Mapping[str, float], ...]]:
    """Ranges of the limits, from the designs that are best in one objective, and among those in the others; and these designs."""
    asked_for = [k for k in range(len(aims)) if k not in bounds]

    def searched(k: int, task: ProblemFile, near: Mapping[str, float] | None) -> dict[str, Any]:
        found = design_machine(restarted(task, near), backend, starts=1) if near is not None else None
        if found is None or found.status is not Status.OPTIMAL:
            found = design_machine(task, backend)
        measured = cycle_figures(problem, aims, found.values)
        if found.status not in (Status.OPTIMAL, Status.STALLED) or not np.all(np.isfinite(measured)):
            raise _no_end(problem, aims[k], found.status.text)
        return {"sizes": dict(found.values), "figures": list(measured)}  # proven or not: it only says where to walk

    alone = {first: once(aims[first].best, partial(searched, first, walked(problem, aims, {first: 1.0}, bounds), None))}
    begin = alone[first]["sizes"]
    for k in asked_for:
        if k != first:  # from a machine that meets all limits
            alone[k] = once(aims[k].best, partial(searched, k, walked(problem, aims, {k: 1.0}, bounds), begin))
    best = {k: alone[k]["figures"][k] for k in asked_for}
    width = {k: max(abs(end["figures"][k] - best[k]) for end in alone.values()) or abs(best[k]) for k in asked_for}
    corner = {}
    for k in asked_for:
        rest = {j: width[j] for j in asked_for if j != k}
        if not aims[k].key:  # a sum cannot be held
            corner[k] = alone[k]
            continue
        limit = text(aims[k].loose(best[k], NEAR * width[k]), aims[k].unit)
        task = walked(problem, aims, rest, {**bounds, k: limit})
        corner[k] = once(f"{aims[k].best}, then the others", partial(searched, k, task, alone[k]["sizes"]))
    found = {}
    for k in asked_for:
        if k != first:
            sense = aims[k].sense
            worst = sense * max(sense * corner[j]["figures"][k] for j in asked_for if j != k)
            found[k] = _axis(aims[k], best[k], worst, count)
    return found, tuple(corner[k]["sizes"] for k in sorted(corner, key=lambda k: k != first))
