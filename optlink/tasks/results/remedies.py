"""What would improve a poor fit, measured on the design: another start of a law, the other assembly mode, a fixed dimension."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optlink.linkage.motion import sweep
from optlink.linkage.vector2d import TURN, Array
from optlink.problem.quantity import Quantity
from optlink.problem.targets.function import Function
from optlink.problem.targets.law import Table
from optlink.solvers.function_exchange import error_at
from optlink.solvers.solution import Solution
from optlink.units import show

if TYPE_CHECKING:
    from optlink.problem.file import ProblemFile
    from optlink.problem.function import DesignProblem
    from optlink.problem.machine.model import Problem

BETTER = 0.9  # fraction of the error below which another start or mode counts as a reason
STARTS = 72  # start angles of a law that are tried
STEP = 1e-6  # scaled, of a fixed dimension
OTHER_MODE = {"left": "right", "right": "left"}
FREE_START = 'free the start: requirement.from = { bounds = ["0 deg", "360 deg"] }'
MAX_NAMED = 4  # fixed dimensions that are named
NO_EFFECT = 1e-6  # relative change of the objective by one unit of a dimension that counts as none


@dataclass(frozen=True)
class PoorFitReason:
    """A measured reason for a poor fit, and its remedy."""

    reason: str
    remedy: str


def start_reasons(task: DesignProblem, values: Mapping[str, float], error: float) -> Iterator[PoorFitReason]:
    """Yield the start of a law as a reason if it is the default, or if the same linkage is better from another crank angle.

    Parameters
    ----------
    task : DesignProblem
    values : mapping of str to float [m, rad]
        Quantities of the design.
    error : float [rad]
        Root mean square error of the design.
    """
    requirement, law = task.requirement, task.requirement.law
    own = isinstance(law, Function) or (isinstance(law, Table) and not law.from_start)
    if own or (isinstance(requirement.start, Quantity) and requirement.start.free):
        return
    start = requirement.start if isinstance(requirement.start, str) else _degrees(requirement.start.value)
    default = "start" not in requirement.model_fields_set
    reason = f"the law starts at the {start}, the default of requirement.from" if default else f"the law starts at {start}"
    angles = np.linspace(0.0, TURN, STARTS, endpoint=False)
    errors = np.sqrt(np.mean(_errors(task, values, angles) ** 2, axis=1))
    best = int(np.argmin(np.where(np.isfinite(errors), errors, np.inf)))
    gain = math.isfinite(errors[best]) and errors[best] < BETTER * error
    if gain:
        reason += f"; from {_degrees(angles[best])} the same linkage has an rms error of {_degrees(errors[best])}"
        reason += f" instead of {_degrees(error)}"
    if gain or default:
        yield PoorFitReason(reason, FREE_START)


def _errors(task: DesignProblem, values: Mapping[str, float], starts: Array) -> Array:
    """Return the error (starts, positions) [rad] of a linkage whose law starts at each of these crank angles."""
    offsets, sizes = task.law.offsets, task.sizes(values)

    def rocker(angles: Array) -> Array:
        flat = sweep(task.linkage, sizes, angles.ravel()).body_angle("rocker").value
        return np.asarray(flat, dtype=float).reshape(angles.shape)

    begin = starts[:, None]
    psi0 = rocker(begin) if task.tied else np.full_like(begin, values["psi0"])
    targets = task.law.curve(offsets, begin, psi0)
    return np.remainder(targets - rocker(begin + offsets) + math.pi, TURN) - math.pi


def mode_reasons(problem: ProblemFile, values: Mapping[str, float], error: float) -> Iterator[PoorFitReason]:
    """Yield the assembly mode of a four-bar as a reason if the same lengths follow the law better in the other mode.

    Parameters
    ----------
    problem : ProblemFile
        Of a law.
    values : mapping of str to float [m, rad]
        Quantities of the design.
    error : float [rad]
        Root mean square error of the design.
    """
    spec = problem.spec
    other = OTHER_MODE[spec.mechanism.assembly]
    task = problem.override({"mechanism.assembly": other}).spec
    mirrored = task.design({name: values[name] for name in task.quantities})
    errors = error_at(task, mirrored, task.law.offsets)
    rms = math.sqrt(float(np.mean(errors**2)))
    if rms < BETTER * error:
        gain = f"with C to the {other} the same lengths have an rms error of {_degrees(rms)} instead of {_degrees(error)}"
        yield PoorFitReason(f"C lies to the {spec.mechanism.assembly} of B -> D; {gain}", 'write mechanism.assembly = "either"')


def fixed_reasons(
    quantities: Mapping[str, Quantity],
    values: Mapping[str, float],
    solution: Solution | None = None,
    task: Problem | None = None,
) -> Iterator[PoorFitReason]:
    """Yield the fixed dimensions as a reason; of an optimum, the one with the largest effect comes first.

    Parameters
    ----------
    quantities : mapping of str to Quantity
        Dimensions.
    values : mapping of str to float [m, rad]
        Quantities of the design.
    solution : Solution, optional
        The optimum, with its multipliers.
    task : Problem, optional
        Its model.
    """
    effects = {} if solution is None or task is None else fixed_effects(solution, task)
    fixed = [name for name, quantity in quantities.items() if not quantity.free]
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

    Parameters
    ----------
    solution : Solution
    task : Problem
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


def _degrees(value: float) -> str:
    return f"{math.degrees(value):.4g} deg"
