"""Consistency checks of a path synthesis problem: task, points, output and limits."""

from __future__ import annotations

import itertools
import math

import numpy as np

from optlink.linkage.dyad_types import transmitting
from optlink.linkage.mechanism import FRAME, Mechanism
from optlink.problem.limits import LIMITS, check_limits
from optlink.problem.mechanism import FourBarSection, check_one_mode
from optlink.problem.path import FINE, SLIDES, PathProblem
from optlink.problem.quantity import Unusable, nearest
from optlink.problem.targets.law import SLIDE, Table, check_rotation
from optlink.problem.targets.target_points import COINCIDENT, TargetPoints

MAX_SHIFT = 1e6  # largest distance of the curve from the origin, in multiples of its size

BELONGS = {
    "law": ("function",),
    "span": ("function",),
    "output": ("function",),
    "zero": ("function",),
    "psi0": ("function",),
    "mark": ("motion",),
    "angle_length": ("motion",),
    "start": ("path", "motion", "function"),
    "timing": ("path", "motion"),
    "closed": ("path", "motion"),
}
"""What only some kinds of task have."""


def four_bar_limits() -> tuple[str, ...]:
    """Return the keys of limits that only a four-bar has."""
    return ("length_margin", "transmission_cosine", *(term.name for term in LIMITS.values() if term.four_bar))


def check_path(problem: PathProblem) -> None:
    """Check that the requirement and the limits of a path synthesis problem are consistent.

    Raises
    ------
    Unusable
        with the full key of the cause.
    """
    check_one_mode(problem.mechanism)
    task, mechanism = problem.requirement, problem.linkage
    for key, kinds in BELONGS.items():
        if getattr(task, key) is not None and task.kind not in kinds:
            raise Unusable(f"a {task.kind} has no {key}", f'Leave it out, or write kind = "{kinds[0]}"', f"requirement.{key}")
    if task.kind == "function":
        _check_output(problem, mechanism)
    elif task.kind == "transmission":
        if problem.width == 0:
            raise Unusable(
                "no dyad of this mechanism has a transmission angle", "Take another requirement", "requirement.kind", task.kind
            )
        if problem.limits.crank == "span":
            raise Unusable(
                "the transmission angle is optimised over a whole revolution",
                'Write crank = "full rotation"',
                "limits.crank",
                "span",
            )
    else:
        _check_points(problem, mechanism)
    _check_limits(problem, mechanism)


def inapplicable_keys(section: str, kind: str, *, four_bar: bool) -> set[str]:
    """Return the keys of a section that are not valid for a kind of task.

    Parameters
    ----------
    section : str
        "requirement" or "limits".
    kind : str
        Kind of the task.
    four_bar : bool
        Whether the mechanism is a four-bar.
    """
    if section == "requirement":
        return {key for key, kinds in BELONGS.items() if kind not in kinds}
    return set() if section != "limits" or four_bar else set(four_bar_limits())


def _check_output(problem: PathProblem, mechanism: Mechanism) -> None:
    task = problem.requirement
    if task.law is None:
        remedy = f'Write law = "psi0 + 0.5*(phi - phi0)", {SLIDE} or {SLIDES}'
        raise Unusable("the law of the output is missing", remedy, "requirement.law")
    guides, bodies = [guide.name for guide in mechanism.guides], [link.body for link in mechanism.links[1:]]
    outputs = guides if problem.slides else bodies
    what = "guide" if problem.slides else "body that turns"
    if task.output not in outputs:
        remedy = f"Write output = one of: {', '.join(outputs)}" if task.output is None else nearest(task.output, outputs)
        raise Unusable(f"the output is the name of a {what}", remedy, "requirement.output", task.output)
    if task.zero is not None and not problem.slides:
        raise Unusable(
            "this key applies to a slider only", "Write psi0 for the angle of a body", "requirement.zero", str(task.zero)
        )
    if task.psi0 is not None and problem.slides:
        raise Unusable("this key applies to a rotating body only", "Write zero for a slide", "requirement.psi0", str(task.psi0))
    for key in ("zero", "psi0"):
        if getattr(task, key) is not None and not problem.based:
            remedy = f"Leave it out, or add {'s0' if key == 'zero' else 'psi0'} to the law"
            raise Unusable("the law does not depend on it", remedy, f"requirement.{key}", str(getattr(task, key)))
    check_rotation(task.law, task.span, "start", task.start)
    _check_values(problem)


def _check_values(problem: PathProblem) -> None:
    """Check that an expression has a finite value over the span and moves the output."""
    task = problem.requirement
    if isinstance(task.law, Table):
        return
    starts = [0.3, 0.9, 1.7] if task.start is None else [task.start.value, *task.start.bounds]
    offsets = problem.rotation_of_law * np.linspace(0.0, 1.0, FINE)
    hazards = [task.law.hazards({"phi": begin + offsets, "phi0": begin, "psi0": 0.0}) for begin in starts]
    if all(hazards):
        remedy = "Change the law, the span or the start"
        raise Unusable(f"the law {hazards[0]} on the span", remedy, "requirement.law", task.law.text)
    if not problem.travel > 1e-9:
        raise Unusable("the law does not move the output", "Change the law", "requirement.law", task.law.text)


def _check_points(problem: PathProblem, mechanism: Mechanism) -> None:
    task, points = problem.requirement, problem.target_points
    moving_points = [name for name, bodies in mechanism.owners.items() if FRAME not in bodies]
    if task.point not in moving_points:
        remedy = nearest(task.point, moving_points)
        if isinstance(problem.mechanism, FourBarSection) and not problem.mechanism.points:
            remedy = f'Give the coupler a point: mechanism.points = {{ {task.point} = ["60 mm", "20 mm"] }}. {remedy}'
        raise Unusable("no moving body has such a point", remedy, "requirement.point", task.point)
    count = len(points.points)
    if task.kind == "motion" and points.angles is None:
        raise Unusable(
            "a pose is a point and an angle, and the angles are missing",
            'Write points = [{ x = "20 mm", y = "5 mm", angle = "30 deg" }, ...]',
            "requirement.points",
        )
    if task.kind == "path" and points.angles is not None:
        raise Unusable("a path has no angles", 'Leave them out, or write kind = "motion"', "requirement.points")
    if not count:
        example = 'points = [["20 mm", "5 mm"], ["25 mm", "8 mm"]], { csv = "curve.csv" } or { svg = "drawing.svg" }'
        raise Unusable("the points are missing", f"Write {example}", "requirement.points")
    least = 3 if task.closed else 2
    if count < least:
        raise Unusable(
            f"{count} point{'s are' if count > 1 else ' is'} no {'closed curve' if task.closed else task.kind}",
            f"Give at least {least}",
            "requirement.points",
        )
    if task.kind == "motion" and problem.timing == "free":
        _check_distinct_poses(points, closed=bool(task.closed or points.loop))
    if task.timing in ("given", "from start") and points.crank is None:
        raise Unusable(
            "the timing is prescribed, but the points have no crank angles",
            'Write points = [{ x = "20 mm", y = "5 mm", crank = "30 deg" }, ...], or timing = "free"',
            "requirement.timing",
            task.timing,
        )
    if task.start is not None and problem.timing != "from start":
        raise Unusable(
            "this key applies to points that are timed from a start only",
            'Write timing = "from start", or leave start out',
            "requirement.start",
            str(task.start),
        )
    if task.rotation != "either" and problem.timing != "free":
        raise Unusable(
            "the crank angles of the points already state the direction of the crank",
            'Leave rotation out, or write timing = "free"',
            "requirement.rotation",
            task.rotation,
        )
    if max(map(abs, problem.centre)) > MAX_SHIFT * problem.size:
        raise Unusable(
            f"the points lie {max(map(abs, problem.centre)) / problem.size:.1e} times their own size away from the origin, "
            "so double precision does not resolve their shape",
            "Check the units, or move the origin near the points",
            "requirement.points",
        )


def _check_distinct_poses(points: TargetPoints, *, closed: bool) -> None:
    """Refuse a pose that occurs twice, unless it closes the motion: no revolution of a crank meets it twice."""
    poses = [np.array([x, y]) for x, y in points.points]
    pairs = set(itertools.combinations(range(len(poses)), 2)) - ({(0, len(poses) - 1)} if closed else set())
    for j, i in sorted(pairs):
        assert points.angles is not None
        turn = math.remainder(points.angles[i] - points.angles[j], math.tau)
        if np.linalg.norm(poses[i] - poses[j]) <= COINCIDENT * points.size and abs(turn) <= COINCIDENT:
            message = f"poses {j + 1} and {i + 1} are the same, but one revolution passes a pose only once"
            raise Unusable(message, "Remove one of them, or prescribe crank angles for a dwell", "requirement.points")


def _check_limits(problem: PathProblem, mechanism: Mechanism) -> None:
    limits, four_bar = problem.limits, isinstance(problem.mechanism, FourBarSection)
    for key in four_bar_limits():
        if key in limits.model_fields_set and not four_bar:
            raise Unusable(
                "this limit applies to a four-bar only", "Leave it out, and bound the lengths themselves", f"limits.{key}"
            )
    if limits.crank == "double-crank" and not four_bar:
        raise Unusable("only a four-bar can be a double-crank", 'Write crank = "full rotation"', "limits.crank", limits.crank)
    check_limits(limits, [group.joint for group in transmitting(mechanism)])
