"""What would improve a poor fit, measured on the design: another start of a law, the other assembly mode, a fixed dimension."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optlink.errors import InputError
from optlink.linkage.motion import sweep
from optlink.linkage.vector2d import TURN, Array
from optlink.problem.quantity import Quantity
from optlink.problem.targets.function import Function
from optlink.problem.targets.law import Table
from optlink.solvers.solution import Solution
from optlink.units import show

if TYPE_CHECKING:
    from optlink.problem.design import DesignProblem
    from optlink.problem.file import ProblemFile
    from optlink.problem.machine.model import Problem

BETTER = 0.9  # fraction of the error below which another start or mode counts as a reason
STARTS = 72  # start angles of a law that are tried
STEP = 1e-6  # scaled, of a fixed dimension
POSITIONS = 721  # positions along a curve
MOST_VARIANTS = 32  # combinations of assembly modes that are tried
FREE_START = '{ bounds = ["0 deg", "360 deg"] }'
MAX_NAMED = 4  # fixed dimensions that are named
NO_EFFECT = 1e-6  # relative change of the objective by one unit of a dimension that counts as none


@dataclass(frozen=True)
class PoorFitReason:
    """A measured reason for a poor fit, and its remedy."""

    reason: str
    remedy: str


def start_reasons(task: DesignProblem, values: Mapping[str, float], error: float) -> Iterator[PoorFitReason]:
    """Yield the start of a law as a reason if it is the default, or if the same linkage is better from another crank angle.

    `error` is the root mean square error of the design, in the unit of the output.
    """
    requirement, law, quantity = task.requirement, task.requirement.law, task.quantities.get(task.start_name)
    own = isinstance(law, Function) or (isinstance(law, Table) and not law.from_start)
    if own or (quantity is not None and quantity.free):
        return
    start = task.dead_centre if quantity is None else in_degrees(quantity.value)
    default, key = "start" not in requirement.model_fields_set, requirement.of(task).key
    reason = f"the law starts at the {start}, the default of requirement.{key}" if default else f"the law starts at {start}"
    angles = np.linspace(0.0, TURN, STARTS, endpoint=False)
    errors = _errors(task, values, angles)
    best = int(np.argmin(np.where(np.isfinite(errors), errors, np.inf)))
    gain = math.isfinite(errors[best]) and errors[best] < BETTER * error
    if gain:
        reason += f"; from {in_degrees(angles[best])} the same linkage has an rms error of {_shown(errors[best], task.unit)}"
        reason += f" instead of {_shown(error, task.unit)}"
    if gain or default:
        yield PoorFitReason(reason, f"free the start: requirement.{key} = {FREE_START}")


def _errors(task: DesignProblem, values: Mapping[str, float], starts: Array) -> Array:
    """Return the root mean square error (starts,) of a linkage whose law starts at each of these crank angles [rad].

    The output at the start is the actual one where it is tied to it, and the best one where it is free.
    """
    law, begin = task.law, starts[:, None]

    def output(angles: Array) -> Array:
        motion = sweep(task.linkage, values, angles.ravel())
        actual = motion.coordinate(task.output).value if task.slides else motion.body_angle(task.output).value
        return np.asarray(actual, dtype=float).reshape(angles.shape)

    base = output(begin) if task.tied else np.full_like(begin, values.get(task.base_name, 0.0))
    error = output(begin + law.offsets) - law.curve(law.offsets, begin, base)
    free = task.base_name in task.free
    if task.slides:
        return np.asarray(np.std(error, axis=1) if free else np.sqrt(np.mean(error**2, axis=1)))
    middle = np.angle(np.mean(np.exp(1j * error), axis=1, keepdims=True)) if free else 0.0
    error = np.remainder(error - middle + math.pi, TURN) - math.pi
    return np.asarray(np.sqrt(np.mean(error**2, axis=1)))


def mode_reasons(
    problem: ProblemFile, values: Mapping[str, float], crank_angles: Array, error: float, unit: str
) -> Iterator[PoorFitReason]:
    """Yield the assembly modes of a linkage as a reason if the same sizes are better for a path or a law in other modes.

    The crank angle at which the task begins and the output there follow where they are free. `error` is the root mean square
    error of the design, in `unit` (m or rad).
    """

    def measured(variant: ProblemFile) -> float:
        task = variant.spec
        if task.pointed and task.data.offsets is None:
            return rms(curve_distances(task, values, crank_angles))
        full = task.design({name: values[name] for name in task.quantities})
        any_start = task.start_name in task.free
        begins = np.linspace(0.0, TURN, STARTS, endpoint=False) if any_start else np.array([full.get(task.start_name, 0.0)])
        if not task.pointed:
            errors = _errors(task, full, begins)
        else:
            errors = np.array([_distance(task, {**full, task.start_name: float(begin)}) for begin in begins])
        return min(filter(math.isfinite, errors.tolist()), default=math.inf)

    if problem.spec.requirement.kind in ("path", "function"):  # of poses the body would have to be placed again
        yield from _mode_reasons(problem, error, unit, measured)


def _distance(task: DesignProblem, values: Mapping[str, float]) -> float:
    """Return the root mean square distance of a design from points with prescribed crank angles."""
    from optlink.validation.design import deviations

    return rms(deviations(task, values, task.crank_angles(values, None)).distances)


def curve_distances(task: DesignProblem, values: Mapping[str, float], crank_angles: Array) -> Array:
    """Return the distance [m] of every point of a path from the curve of a linkage, at any crank angle.

    The curve of a crank that need not turn fully is that between the first and last of `crank_angles` [rad].
    """
    begin = float(crank_angles[0])
    end = begin + TURN if task.limits.crank != "span" else float(crank_angles[-1])
    curve = sweep(task.linkage, values, np.linspace(begin, end, POSITIONS)).position(task.point)
    gaps = [np.hypot(*(curve - place).T) for place in task.data.columns[:, :2]]
    return np.array([np.min(gap) if np.all(np.isfinite(gap)) else math.inf for gap in gaps])


def _mode_reasons(
    problem: ProblemFile, error: float, unit: str, measured: Callable[[ProblemFile], float]
) -> Iterator[PoorFitReason]:
    """Yield the assembly modes as a reason if the error `measured` is clearly less in other modes."""
    section, linkage = problem.model.mechanism, problem.model.linkage
    variants = section.with_open_modes(linkage).variants(linkage)
    best, changed = error, dict[str, tuple[str, str]]()
    for change in itertools.islice(variants, MOST_VARIANTS):
        try:
            variant = problem.override({**problem.located, **change})
        except InputError:  # a mode that the problem does not permit
            continue
        other_error = measured(variant)
        if other_error < min(best, BETTER * error):
            pairs = zip(linkage.groups, variant.model.linkage.groups, strict=True)
            best, changed = other_error, {one.joint: _mode(change, one.joint) for one, other in pairs if one != other}
    if not changed:
        return
    modes = " and ".join(f"{joint} {mode}" for joint, (_, mode) in changed.items())
    reason = f"with {modes} the same sizes have an rms error of {_shown(best, unit)} instead of {_shown(error, unit)}"
    yield PoorFitReason(reason, "write " + " and ".join(f'{key} = "either"' for key, _ in changed.values()))


def _mode(change: Mapping[str, str], joint: str) -> tuple[str, str]:
    """Return the key of the assembly mode of a joint in a change of the file, and its value in words; a four-bar has one mode."""
    ((key, mode),) = change.items() if "mechanism.assembly" in change else [(f"mechanism.assembly.{joint}", "")]
    return key, f"to the {mode}" if mode else change[key]


def rms(values: Array) -> float:
    """Return the root mean square of numbers, also complex ones."""
    return math.sqrt(float(np.mean(np.abs(values) ** 2)))


def _shown(value: float, unit: str) -> str:
    return in_degrees(value) if unit == "rad" else f"{1e3 * value:.4g} mm"


def fixed_reasons(
    quantities: Mapping[str, Quantity],
    values: Mapping[str, float],
    solution: Solution | None = None,
    task: Problem | None = None,
) -> Iterator[PoorFitReason]:
    """Yield the fixed dimensions as a reason; of an optimum (`solution`), the one with the largest effect comes first."""
    effects = {} if solution is None or task is None else fixed_effects(solution, task)
    fixed = [name for name, quantity in quantities.items() if quantity.fixed]
    fixed.sort(key=lambda name: -abs(effects.get(name, 0.0)))
    if not fixed:
        return
    shown = ", ".join(
        f"{name} = {show(values.get(name, quantities[name].value), quantities[name].kind)}" for name in fixed[:MAX_NAMED]
    )
    more = f" and {len(fixed) - MAX_NAMED} more" if len(fixed) > MAX_NAMED else ""
    effect = effects.get(fixed[0], 0.0)
    if abs(effect) <= NO_EFFECT:
        yield PoorFitReason(f"fixed dimensions: {shown}{more}", "free those that need not be fixed, by bounds")
        return
    unit = quantities[fixed[0]].display[1]
    step = f"1 {unit} {'less' if effect > 0.0 else 'more'} improves the objective by {100.0 * abs(effect):.3g} %"
    which = (
        f"of the fixed dimensions ({shown}{more}), {fixed[0]} has the largest effect" if len(fixed) > 1 else f"{shown} is fixed"
    )
    yield PoorFitReason(f"{which}: {step}", f"free {fixed[0]} by bounds")


def fixed_effects(solution: Solution, task: Problem) -> dict[str, float]:
    """Return the relative change of the shown optimal objective per display unit of each fixed dimension, to first order.

    It is the partial derivative of the Lagrangian (the envelope theorem), by central differences.
    """
    shown = task.shown_objective(solution.objective)
    size = shown.factor * solution.objective / shown.value if shown.value else 1.0
    nlp, x = solution.nlp, solution.x
    multipliers = solution.conditions.multipliers[len(x) :]
    priced = multipliers != 0.0
    here = abs(nlp.values(x, solution.p)[0])
    effects = {}
    for k, constant in enumerate(nlp.constants):
        sides = []
        for way in (1.0, -1.0):
            p = solution.p.copy()
            p[1 + k] += way * STEP
            f, g = nlp.values(x, p)
            sides.append(f + float(multipliers[priced] @ g[priced]))
        slope = size * (sides[0] - sides[1]) / (2.0 * STEP * here) if here > 0.0 else 0.0
        effects[constant.name] = slope / constant.scale.slope(0.0) if math.isfinite(slope) else 0.0
    return effects


def in_degrees(value: float) -> str:
    """Format an angle [rad]."""
    return f"{math.degrees(value):.4g} deg"
