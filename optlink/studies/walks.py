"""Where the limits of a front walk: from where the other objectives are best to the best of the one that is held."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from optlink.design.files import ProblemFile
from optlink.errors import Fault, InputError, Status
from optlink.machine_design import MachineDesign, design_machine
from optlink.studies.aims import OPTION, Aim, bare, cycle_figures, law_figure, tightest, walked
from optlink.studies.axes import Axis, Grid, read_axis
from optlink.studies.keys import Raw, changed, text
from optlink.studies.machines import restarted
from optlink.studies.reoptimise import buildable
from optlink.workflow import solve

NEAR = 1e-4  # of its extent by which an objective is let go at its own end, where nothing else could move
NONE = 1e-6  # relative; an objective that moves less has no trade-off


def walks(problem: ProblemFile, aims: tuple[Aim, ...], first: int, count: int, backend: str) -> tuple[ProblemFile, Grid]:
    """The problem in which objective number `first` is minimised, and the values of the limits that hold the others.

    Raises
    ------
    InputError
        ranges without sense; an end that cannot be found.
    """
    return (_of_machine if problem.machined else _of_law)(problem, aims, first, count, backend)


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


def _no_end(problem: ProblemFile, aim: Aim, why: str) -> InputError:
    remedy = f'Say where to walk: "{aim.said}=LOW..HIGH{" " + aim.unit if aim.unit else ""}"'
    return InputError(Fault(f"the end with the {aim.best} cannot be found: {why}", remedy, problem.file, OPTION, aim.said))


def _of_law(problem: ProblemFile, aims: tuple[Aim, ...], first: int, count: int, backend: str) -> tuple[ProblemFile, Grid]:
    """From where the error alone decides to the tightest limit that a linkage meets."""
    held = [aim for k, aim in enumerate(aims) if k != first]
    base, fixed = bare(problem, held), {}
    for aim in held:
        if aim.span:
            with _blamed(problem, aim):
                fixed[aim.key] = _stated(aim, count, partial(_moved, base, aim.key))
    found = dict(fixed)
    for aim in held:
        if aim.key not in fixed and not buildable(base, (aim.key,)):
            raise _no_end(problem, aim, "a function has many optima, its ends are not searched")
    if len(fixed) < len(held):
        found |= _law_walks(
            problem, changed(base, {key: axis.raw(0) for key, axis in fixed.items()}), aims[first], held, fixed, count, backend
        )
    return base, Grid(tuple(found[aim.key] for aim in held))


def _moved(base: ProblemFile, key: str, value: Raw) -> ProblemFile:
    return changed(base, {key: value})


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
) -> dict[str, Axis]:
    """Ranges of the limits that no range was asked for; `free` is the problem with nothing of what is held but the loosest."""
    unbound = [aim for aim in held if aim.key not in fixed]
    best = solve(free, backend)
    if not best.valid:
        raise _no_end(problem, minimised, best.status.text)
    tight = {aim.key: _tight(problem, changed(free, {aim.key: tightest(free, aim)}), aim, backend) for aim in unbound}
    corners = {aim.key: text(aim.loose(tight[aim.key], NEAR * abs(tight[aim.key])), aim.unit) for aim in unbound}
    corners |= {key: axis.raw(len(axis.values) - 1) for key, axis in fixed.items()}
    others = [(key, solve(changed(free, {key: value}), backend)) for key, value in corners.items() if len(held) > 1]
    found = {}
    for aim in unbound:
        stated = changed(free, {aim.key: tightest(free, aim)}).spec
        designs = [best.design, *(result.design for key, result in others if key != aim.key and result.valid)]
        worst = aim.sense * max(aim.sense * law_figure(stated, aim, design) for design in designs)
        found[aim.key] = _axis(aim, tight[aim.key], worst, count)
    return found


def _tight(problem: ProblemFile, tight: ProblemFile, aim: Aim, backend: str) -> float:
    """The tightest value of a limit with which there is a design: the least relaxation of one that there is none with."""
    found = solve(tight, backend)
    if found.solution is not None and found.solution.usable:  # there is one, at the edge of what can be stated
        return law_figure(tight.spec, aim, found.design)
    sense = "<=" if aim.sense > 0 else ">="
    for item in found.conflict:
        if item.key == aim.key.rpartition(".")[0] and item.sense == sense and math.isfinite(item.relaxed):
            return item.relaxed
    raise _no_end(problem, aim, found.status.text)


def _of_machine(problem: ProblemFile, aims: tuple[Aim, ...], first: int, count: int, backend: str) -> tuple[ProblemFile, Grid]:
    """From where the other objectives are best to where the one that is held is."""
    held, fixed = [k for k in range(len(aims)) if k != first], {}
    for k in held:
        if aims[k].span:
            with _blamed(problem, aims[k]):
                fixed[k] = _stated(aims[k], count, partial(_held, problem, aims, first, k))
    axes = dict(fixed)
    begin: dict[str, float] = {}
    if len(fixed) < len(held):
        found, begin = _machine_walks(problem, aims, first, {k: axis.raw(0) for k, axis in fixed.items()}, count, backend)
        axes |= found
    base = walked(problem, aims, {first: 1.0}, {k: axes[k].raw(0) for k in held})
    return restarted(base, begin) if begin else base, Grid(tuple(axes[k] for k in held))


def _machine_walks(
    problem: ProblemFile, aims: tuple[Aim, ...], first: int, bounds: Mapping[int, Raw], count: int, backend: str
) -> tuple[dict[int, Axis], dict[str, float]]:
    """Ranges of the limits, from the designs that are best in one objective, and among those in the others; and sizes to begin
    from, which meet all limits but those.
    """
    asked_for = [k for k in range(len(aims)) if k not in bounds]

    def figures(k: int, task: ProblemFile, near: MachineDesign | None = None) -> tuple[MachineDesign, tuple[float, ...]]:
        found = design_machine(restarted(task, near.values), backend, starts=1) if near is not None else None
        if found is None or found.status is not Status.OPTIMAL:
            found = design_machine(task, backend)
        measured = cycle_figures(problem, aims, found.values)
        if found.status is not Status.OPTIMAL or not np.all(np.isfinite(measured)):
            raise _no_end(problem, aims[k], found.status.text)
        return found, measured  # proven or not: it only says where to walk

    alone = {first: figures(first, walked(problem, aims, {first: 1.0}, bounds))}
    for k in asked_for:
        if k != first:  # from a machine that meets all limits
            alone[k] = figures(k, walked(problem, aims, {k: 1.0}, bounds), alone[first][0])
    best = {k: alone[k][1][k] for k in asked_for}
    width = {k: max(abs(table[k] - best[k]) for _, table in alone.values()) or abs(best[k]) for k in asked_for}
    corner = {}
    for k in asked_for:
        rest = {j: width[j] for j in asked_for if j != k}
        if not aims[k].key:  # a sum cannot be held
            corner[k] = alone[k][1]
            continue
        limit = text(aims[k].loose(best[k], NEAR * width[k]), aims[k].unit)
        corner[k] = figures(k, walked(problem, aims, rest, {**bounds, k: limit}), alone[k][0])[1]
    found = {}
    for k in asked_for:
        if k != first:
            sense = aims[k].sense
            worst = sense * max(sense * corner[j][k] for j in asked_for if j != k)
            found[k] = _axis(aims[k], best[k], worst, count)
    return found, alone[first][0].values
