"""Requirement and limits of a path, motion, function or transmission problem, with the checks of their consistency."""

import itertools
import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, ValidationInfo, ValidatorFunctionWrapHandler, field_validator

from optlink.linkage.dyad_types import transmitting
from optlink.linkage.mechanism import Mechanism
from optlink.problem.base_model import Section, in_folder
from optlink.problem.interval import CoordinateInterval
from optlink.problem.limits import Limits, check_limits, four_bar_limits
from optlink.problem.mechanism import DyadsSection, FourBarSection, moving_points
from optlink.problem.quantity import Angle, Coordinate, FixedAngle, FixedLength, Unusable, check_name, nearest
from optlink.problem.targets.law import SLIDE, check_rotation, read_output_law
from optlink.problem.targets.points import read_points
from optlink.problem.targets.target_points import COINCIDENT, TargetPoints

MechanismSection = FourBarSection | DyadsSection

SLIDES = 'law = { function = "sqrt(x)", x = [0.1, 1], input = "90 deg", output = "40 mm" }'


def _read_timing(raw: object) -> object:
    check_name(raw, ("free", "from start", "given"), "not a kind of timing")
    return raw


class PathRequirement(Section):
    """Requirement of the design.

    A point passes the listed points in order (path), a body takes the listed poses (motion), the output is a function of the
    crank angle (function), or the worst cosine of the transmission angles is minimised (transmission).
    """

    kind: Literal["path", "motion", "function", "transmission"] = "function"
    """Kind of requirement."""
    point: str = "P"
    """The moving point that takes the positions; its body takes the angles."""
    points: Annotated[Any, in_folder(read_points)] = None
    """Points or poses: a list, a CSV file, a drawing or expressions; for a function the number of positions (60)."""
    law: Annotated[Any, in_folder(read_output_law)] = None
    """Law of the output: a function y(x), with x proportional to the crank angle; an expression in phi, phi0, psi0, for a slide
    `{ slide = "s0 + 40*(1 - cos(phi))", unit = "mm" }`; or a table of phi and psi, or phi and s, or a CSV file."""
    span: FixedAngle | None = None
    """Crank rotation over which an expression applies, negative clockwise; a table or function defines it itself."""
    output: str | None = None
    """Output of a law or function: a guide (its slide) or a body (its angle)."""
    zero: Coordinate | None = None
    """Slide at the start of a law (s0), or at the least y of a function, fixed or free; default: free."""
    psi0: Angle | None = None
    """Angle of the output body at the start of a law, or at the least y of a function, fixed or free; default: free."""
    timing: Annotated[Literal["free", "from start", "given"] | None, BeforeValidator(_read_timing)] = None
    """Crank angles at the points: `given`: prescribed; `from start`: prescribed except for a common offset; `free`: optimised, in
    the order of the points. Default: `given` if the points have crank angles, else `free`."""
    start: Angle | None = None
    """Common offset of the crank angles, fixed or free; default: any angle."""
    rotation: Literal["either", "counter-clockwise", "clockwise"] = "either"
    """Sense of crank rotation with free timing."""
    closed: bool | None = None
    """Whether the last point leads back to the first one within the revolution; default: determined from the points."""
    mark: Angle | None = None
    """Angle from the direction of the body to that of the poses, fixed or free; default: free."""
    angle_length: FixedLength | None = None
    """Length that is equivalent to an angle error of one radian; default: the size of the curve."""
    measure: Literal["sum of squares", "rms", "max"] | None = None
    """Measure that combines all deviations into the objective; default: the sum of squares, for a transmission the largest."""

    @field_validator("points", mode="wrap")
    @classmethod
    def _points(cls, raw: object, read: ValidatorFunctionWrapHandler, info: ValidationInfo) -> TargetPoints | int | None:
        kind = info.data.get("kind")
        if kind not in ("function", "transmission"):
            return read(raw)  # type: ignore[no-any-return]
        if raw is None:
            return None
        if kind == "transmission":
            raise Unusable("a transmission requirement has no points", "Leave points out")
        if isinstance(raw, bool) or not isinstance(raw, int) or not 2 <= raw <= 400:
            raise Unusable("not a number of positions", "Give a whole number from 2 to 400, or leave it out")
        return raw


class RegionSection(Section):
    """A rectangle of the plane: ranges of x and y."""

    x: CoordinateInterval | None = None
    """Range of x; default: unlimited."""
    y: CoordinateInterval | None = None
    """Range of y; default: unlimited."""


class PathLimits(Limits):
    """Limits of a path synthesis problem."""

    pivots: RegionSection | None = None
    """Rectangle that contains every point of the frame."""


# --- checks -----------------------------------------------------------------------------------------------------------------

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


def check_keys(task: PathRequirement) -> None:
    """Refuse keys that the kind of requirement does not have, and a function without its law.

    Raises
    ------
    Unusable
        with the full key.
    """
    for key, kinds in BELONGS.items():
        if getattr(task, key) is not None and task.kind not in kinds:
            raise Unusable(f"a {task.kind} has no {key}", f'Leave it out, or write kind = "{kinds[0]}"', f"requirement.{key}")
    if task.kind == "function" and task.law is None:
        remedy = f'Write law = "psi0 + 0.5*(phi - phi0)", {SLIDE} or {SLIDES}'
        raise Unusable("the law of the output is missing", remedy, "requirement.law")


def inapplicable_keys(section: str, kind: str, *, four_bar: bool) -> set[str]:
    """Return the keys of the section "requirement" or "limits" that are not valid for a kind of task."""
    if section == "requirement":
        return {key for key, kinds in BELONGS.items() if kind not in kinds}
    return set() if section != "limits" or four_bar else set(four_bar_limits())


def check_output(task: PathRequirement, linkage: Mechanism, *, slides: bool, based: bool) -> None:
    """Check that the output of a law exists and that its keys apply to it.

    `slides`: the output is a slider, not the angle of a body; `based`: the law is relative to the output at the start.

    Raises
    ------
    Unusable
        with the full key of the cause.
    """
    outputs = [guide.name for guide in linkage.guides] if slides else [link.body for link in linkage.links[1:]]
    if task.output not in outputs:
        remedy = f"Write output = one of: {', '.join(outputs)}" if task.output is None else nearest(task.output, outputs)
        what = "guide" if slides else "body that turns"
        raise Unusable(f"the output is the name of a {what}", remedy, "requirement.output", task.output)
    if task.zero is not None and not slides:
        message = "this key applies to a slider only"
        raise Unusable(message, "Write psi0 for the angle of a body", "requirement.zero", str(task.zero))
    if task.psi0 is not None and slides:
        raise Unusable("this key applies to a rotating body only", "Write zero for a slide", "requirement.psi0", str(task.psi0))
    for key in ("zero", "psi0"):
        if (value := getattr(task, key)) is not None and not based:
            remedy = f"Leave it out, or add {'s0' if key == 'zero' else 'psi0'} to the law"
            raise Unusable("the law does not depend on it", remedy, f"requirement.{key}", str(value))
    check_rotation(task.law, task.span, "start", task.start)


def check_points(
    task: PathRequirement, points: TargetPoints, timing: str, mechanism: MechanismSection, linkage: Mechanism
) -> None:
    """Check that points or poses, their timing and the body that takes them fit each other.

    Raises
    ------
    Unusable
        with the full key of the cause.
    """
    moving = moving_points(linkage)
    if task.point not in moving:
        remedy = nearest(task.point, moving)
        if isinstance(mechanism, FourBarSection) and not mechanism.points:
            remedy = f'Give the coupler a point: mechanism.points = {{ {task.point} = ["60 mm", "20 mm"] }}. {remedy}'
        raise Unusable("no moving body has such a point", remedy, "requirement.point", task.point)
    count = len(points.points)
    if task.kind == "motion" and points.angles is None:
        remedy = 'Write points = [{ x = "20 mm", y = "5 mm", angle = "30 deg" }, ...]'
        raise Unusable("a pose is a point and an angle, and the angles are missing", remedy, "requirement.points")
    if task.kind == "path" and points.angles is not None:
        raise Unusable("a path has no angles", 'Leave them out, or write kind = "motion"', "requirement.points")
    if not count:
        example = 'points = [["20 mm", "5 mm"], ["25 mm", "8 mm"]], { csv = "curve.csv" } or { svg = "drawing.svg" }'
        raise Unusable("the points are missing", f"Write {example}", "requirement.points")
    least = 3 if task.closed else 2
    if count < least:
        message = f"{count} point{'s are' if count > 1 else ' is'} no {'closed curve' if task.closed else task.kind}"
        raise Unusable(message, f"Give at least {least}", "requirement.points")
    if task.kind == "motion" and timing == "free":
        _check_distinct_poses(points, closed=bool(task.closed or points.loop))
    if task.timing in ("given", "from start") and points.crank is None:
        remedy = 'Write points = [{ x = "20 mm", y = "5 mm", crank = "30 deg" }, ...], or timing = "free"'
        raise Unusable("the timing is prescribed, but the points have no crank angles", remedy, "requirement.timing", task.timing)
    if timing != "free" and points.crank is not None:
        _check_whole_revolution(points, points.crank)
    if task.start is not None and timing != "from start":
        message = "this key applies to points that are timed from a start only"
        raise Unusable(message, 'Write timing = "from start", or leave start out', "requirement.start", str(task.start))
    if task.rotation != "either" and timing != "free":
        message = "the crank angles of the points already state the direction of the crank"
        raise Unusable(message, 'Leave rotation out, or write timing = "free"', "requirement.rotation", task.rotation)


def _check_whole_revolution(points: TargetPoints, crank: tuple[float, ...]) -> None:
    """Refuse a last point one revolution after the first, but elsewhere: the linkage is in the same position there."""
    away = math.dist(points.points[0], points.points[-1])
    if abs(crank[-1] - crank[0]) > math.tau * (1.0 - 1e-9) and away > COINCIDENT * points.size:
        message = f"point {len(crank)}, at {math.degrees(crank[-1]):.6g} deg, lies one revolution after point 1, but elsewhere"
        raise Unusable(message, "Give both the same position, or leave one of them out", "requirement.points")


def _check_distinct_poses(points: TargetPoints, *, closed: bool) -> None:
    """Refuse a pose that occurs twice, unless it closes the motion: no revolution of a crank meets it twice."""
    poses, count = np.array(points.points), len(points.points)
    for j, i in itertools.combinations(range(count), 2):
        if closed and (j, i) == (0, count - 1):
            continue
        assert points.angles is not None
        turn = math.remainder(points.angles[i] - points.angles[j], math.tau)
        if np.linalg.norm(poses[i] - poses[j]) <= COINCIDENT * points.size and abs(turn) <= COINCIDENT:
            message = f"poses {j + 1} and {i + 1} are the same, but one revolution passes a pose only once"
            raise Unusable(message, "Remove one of them, or prescribe crank angles for a dwell", "requirement.points")


def check_path_limits(limits: PathLimits, mechanism: MechanismSection, linkage: Mechanism) -> None:
    """Refuse limits that the mechanism cannot have.

    Raises
    ------
    Unusable
        with the full key of the limit.
    """
    if not isinstance(mechanism, FourBarSection):
        for key in four_bar_limits():
            if key in limits.model_fields_set:
                remedy = "Leave it out, and bound the lengths themselves"
                raise Unusable("this limit applies to a four-bar only", remedy, f"limits.{key}")
        if limits.crank == "double-crank":
            raise Unusable("only a four-bar can be a double-crank", 'Write crank = "full rotation"', "limits.crank", limits.crank)
    check_limits(limits, [group.joint for group in transmitting(linkage)])
