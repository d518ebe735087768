"""GenerationProblem: a linkage whose point shall pass points, whose body shall take poses, whose output shall be a function of
the crank angle, or which shall transmit force as well as it can.

Its unknowns are the free sizes of the mechanism and, where the file leaves them open, the crank angles at the points.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, ValidationInfo, field_validator

from optlink.design.function import Function, read_function
from optlink.design.limits import Limits, check_ranges
from optlink.design.linkages import FourBarSection
from optlink.design.machines import Problem
from optlink.design.points import Wanted, closed, read_points
from optlink.design.quantity import (
    Angle,
    Coordinate,
    CoordinateInterval,
    FixedLength,
    Quantity,
    Unusable,
    nearest,
)
from optlink.design.section import Section
from optlink.linkage.elementwise import Value, angle_from, dot, minus, turn, unit
from optlink.linkage.groups import RRR
from optlink.linkage.mechanism import FRAME, Mechanism, Pose

Array = NDArray[np.float64]
TURN = 2.0 * math.pi
START, MARK, ZERO = "start", "mark", "zero"
"""Names of the quantities that a task adds to those of the mechanism."""

KINDS = ("path", "motion", "function", "transmission")
POSITIONS = 60  # of a function, where the file does not say how many
GRID = 36  # crank angles at which the transmission of a mechanism that is no four-bar is followed

STEP = 1e-4  # rad, least crank rotation from a point to the next
MAX_SHIFT = 1e6  # sizes of the curve that it may lie away from the origin


def _read_crank(raw: object) -> object:
    if isinstance(raw, str) and raw in ("free", "from start", "given"):
        return raw
    raise Unusable("not a kind of timing", nearest(str(raw), ("free", "from start", "given")), "", raw)


class Task(Section):
    """What the linkage must do.

    Its point passes the points (path) or its body takes the poses (motion) in the order listed; its output is a function of the
    crank angle (function); or the worst cosine of its transmission angles is as small as can be (transmission).
    """

    kind: Literal["path", "motion", "function", "transmission"] = "function"
    point: str = "P"
    points: Any = None
    law: Any = None
    output: str | None = None
    zero: Coordinate | None = None
    timing: Annotated[Literal["free", "from start", "given"] | None, BeforeValidator(_read_crank)] = None
    start: Angle | None = None
    rotation: Literal["either", "counter-clockwise", "clockwise"] = "either"
    closed: bool | None = None
    mark: Angle | None = None
    angle_length: FixedLength | None = None
    measure: Literal["sum of squares", "rms", "max"] | None = None

    @field_validator("points", mode="before")
    @classmethod
    def _points(cls, raw: object, info: ValidationInfo) -> Wanted | int | None:
        kind = info.data.get("kind")
        if kind in ("function", "transmission"):
            if raw is not None and (
                kind == "transmission" or isinstance(raw, bool) or not isinstance(raw, int) or not 2 <= raw <= 400
            ):
                remedy = "Leave points out" if kind == "transmission" else "Give a whole number from 2 to 400, or leave it out"
                raise Unusable(f"no points belong to a {kind}" if kind == "transmission" else "no number of positions", remedy)
            return raw
        return read_points(raw, (info.context or {}).get("folder", Path()))

    @field_validator("law", mode="before")
    @classmethod
    def _law(cls, raw: object) -> Function | None:
        if raw is None or isinstance(raw, Function):
            return raw
        if not isinstance(raw, dict):
            raise Unusable("the output of this mechanism follows a function y(x)", f"Write {SLIDES}")
        try:
            return read_function(raw, "coordinate")
        except Unusable as error:
            if error.key != "output":
                raise
        return read_function(raw, "angle")


SLIDES = 'law = { function = "sqrt(x)", x = [0.1, 1], input = "90 deg", output = "40 mm" }'


class RegionSection(Section):
    """A rectangle of the plane: ranges of x and y."""

    x: CoordinateInterval | None = None
    y: CoordinateInterval | None = None


class GenerationLimits(Limits):
    """What must hold beside the points."""

    pivots: RegionSection | None = None


@dataclass(frozen=True, eq=False)
class Data:
    """What is wanted at each point, as arrays.

    `columns` (points, k): x, y [m] and, of poses, cosine and sine of the angle; `roots` (points,) of the weights;
    `offsets` (points,) [rad]: crank angles as given, or None where they are free; `tolerances` (points,) [m], infinite where
    there is none.
    """

    columns: Array
    roots: Array
    offsets: Array | None
    tolerances: Array


class GenerationProblem(Problem):
    """A problem file that states points or poses: what `solve` takes. Change it with `optlink.load(..., overrides)`."""

    requirement: Task
    limits: GenerationLimits = GenerationLimits()

    @cached_property
    def quantities(self) -> dict[str, Quantity]:
        """Every quantity that can be fixed or free, by name: those of the mechanism, and what the task adds."""
        found, task = dict(self.mechanism.quantities), self.requirement
        anywhere = Quantity(0.0, "angle", "deg", -math.pi, math.pi)
        if self.timing == "from start":
            found[START] = task.start or anywhere
        if task.kind == "motion":
            found[MARK] = task.mark or anywhere
        if task.kind == "function" and self.slides:
            far = 10.0 * max([abs(task.law.output), *(q.value for q in found.values() if q.kind == "length")])
            found[ZERO] = task.zero or Quantity(0.0, "coordinate", "mm", -far, far)
        elif task.kind == "function":
            found[ZERO] = anywhere
        return found

    @property
    def slides(self) -> bool:
        """Whether the output of a function is a slider, not the angle of a body."""
        return isinstance(self.requirement.law, Function) and self.requirement.law.kind == "coordinate"

    @property
    def measure(self) -> str:
        """How deviations become one figure."""
        return self.requirement.measure or ("max" if self.requirement.kind == "transmission" else "sum of squares")

    @property
    def unit(self) -> str:
        """SI unit of a deviation: empty for cosines."""
        if self.requirement.kind == "transmission":
            return ""
        return "rad" if self.requirement.kind == "function" and not self.slides else "m"

    @property
    def width(self) -> int:
        """Components of the deviation at one position."""
        if self.requirement.kind == "transmission":
            return len([group for group in self.linkage.groups if isinstance(group, RRR)])
        return {"path": 2, "motion": 3, "function": 1}[self.requirement.kind]

    @property
    def whole(self) -> float:
        """What a deviation is measured by in the programme: the size of the curve, 1 for angles and cosines."""
        return self.size if self.unit == "m" else 1.0

    @property
    def wanted(self) -> Wanted:
        """The points as they were read; none of a function or transmission."""
        points = self.requirement.points
        return points if isinstance(points, Wanted) else Wanted(points=())

    @property
    def timing(self) -> str:
        """ "given": crank angles belong to the points; "from start": up to a common start; "free": in order."""
        if self.requirement.kind == "function":
            return "from start"
        if self.requirement.kind == "transmission":
            return "given"
        return self.requirement.timing or ("free" if self.wanted.crank is None else "given")

    @cached_property
    def closed(self) -> bool:
        """Whether the points go once round a closed curve: the last step leads back to the first point."""
        if self.requirement.closed is not None:
            return self.requirement.closed
        return len(self.wanted.points) > 3 and closed(self.wanted)

    @property
    def meets_again(self) -> bool:
        """Whether the last point is the first again: only then may it be met at the first crank angle again."""
        columns = self.data.columns
        return bool(np.max(np.abs(columns[0, :2] - columns[-1, :2])) <= 1e-9 * self.size)

    @property
    def side(self) -> int:
        """Assembly mode of a four-bar: +1 left, -1 right of B -> D."""
        assert isinstance(self.mechanism, FourBarSection)
        return self.mechanism.side

    @cached_property
    def data(self) -> Data:
        """What is wanted, as arrays."""
        wanted, task = self.wanted, self.requirement
        if task.kind == "function":
            offsets = task.law.input * np.linspace(0.0, 1.0, (task.points or POSITIONS) + 1)
            return _plain(np.asarray(task.law.rise(offsets), dtype=float)[:, None], offsets)
        if task.kind == "transmission":
            exact = isinstance(self.mechanism, FourBarSection)
            offsets = np.array([0.0, math.pi]) if exact else np.linspace(0.0, TURN, GRID, endpoint=False)
            return _plain(np.zeros((len(offsets), 1)), offsets)
        columns = np.array(wanted.points, dtype=float)
        if task.kind == "motion":
            assert wanted.angles is not None
            columns = np.column_stack([columns, *unit(np.array(wanted.angles))])
        count = len(columns)
        roots = np.ones(count) if wanted.weights is None else np.sqrt(np.array(wanted.weights))
        tolerances = np.full(count, np.inf) if wanted.tolerances is None else np.array(wanted.tolerances)
        offsets = None if self.timing == "free" or wanted.crank is None else np.array(wanted.crank)
        return Data(columns, roots, offsets, tolerances)

    @property
    def pointed(self) -> bool:
        """Whether points in the plane are wanted."""
        return self.requirement.kind in ("path", "motion")

    @cached_property
    def centre(self) -> tuple[float, float]:
        """Mean of the points [m]; the origin where there are none."""
        if not self.pointed:
            return 0.0, 0.0
        x, y = np.mean(self.data.columns[:, :2], axis=0)
        return float(x), float(y)

    @cached_property
    def size(self) -> float:
        """How large the curve is [m]: root mean square of the points' distances from their centre; else the stroke, or a link."""
        if self.pointed:
            spread = self.data.columns[:, :2] - np.array(self.centre)
            size = float(np.sqrt(np.mean(np.sum(spread * spread, axis=1))))
            if size > 0.0:
                return size
        if self.slides:
            return float(abs(self.requirement.law.output))
        quantities = [q for q in self.mechanism.quantities.values() if q.kind == "length"]
        fixed = [q.value for q in quantities if not q.free]
        return max(fixed or [q.value for q in quantities])

    @cached_property
    def radian(self) -> float:
        """Length [m] that one radian of a pose counts as."""
        given = self.requirement.angle_length
        return self.size if given is None else given.value

    @property
    def body(self) -> str:
        """The body that carries the point."""
        owners = [body for body in self.linkage.owners.get(self.requirement.point, ()) if body != FRAME]
        return owners[-1] if owners else ""

    def deviation(self, pose: Pose, values: Mapping[str, Value], wanted: tuple[Value, ...]) -> list[Value]:
        """Generated minus wanted at one position, elementwise; `wanted` is a row of `Data.columns`.

        Of a path x and y [m]; of a pose also the angle times `radian`; of a function the slide [m] or angle [rad]; for the
        transmission the cosine of the angle at each joint of two links.
        """
        kind = self.requirement.kind
        if kind == "transmission":
            return [joint_cosine(pose, group) for group in self.linkage.groups if isinstance(group, RRR)]
        if kind == "function":
            if self.slides:
                guide = next(guide for guide in self.linkage.guides if guide.name == self.requirement.output)
                return [pose.slide(guide) - values[ZERO] - wanted[0]]
            return [angle_from(unit(values[ZERO] + wanted[0]), pose.direction(str(self.requirement.output)))]
        x, y = pose.point(self.requirement.point)
        found = [x - wanted[0], y - wanted[1]]
        if kind == "motion":
            turned = turn(pose.direction(self.body), unit(values[MARK]))
            found.append(self.radian * angle_from((wanted[2], wanted[3]), turned))
        return found

    @property
    def transmission_over(self) -> str:
        """Where the transmission limits hold: "revolution" or "span"."""
        return self.limits.transmission_over or ("span" if self.limits.crank == "span" else "revolution")

    def crank_angles(self, values: Mapping[str, float], angles: Array | None) -> Array:
        """Crank angle [rad] at each point: as found (`angles`) where they are free."""
        offsets = self.data.offsets
        if offsets is None:
            assert angles is not None
            return angles
        return offsets + (values[START] if self.timing == "from start" else 0.0)


def _plain(columns: Array, offsets: Array) -> Data:
    """Positions of equal weight without tolerances."""
    return Data(columns, np.ones(len(columns)), offsets, np.full(len(columns), np.inf))


def joint_cosine(pose: Pose, group: RRR) -> Value:
    """Cosine of the angle between the two links of a group."""
    joint = pose.point(group.joint)
    one, other = (minus(pose.point(pin), joint) for pin in group.pins)
    return dot(one, other) / np.sqrt(dot(one, one) * dot(other, other))


def cross_check_generation(problem: GenerationProblem) -> None:
    """Find what no single key shows.

    Raises
    ------
    Unusable
        with the full key that is to blame.
    """
    task, mechanism = problem.requirement, problem.linkage
    for key, kinds in BELONGS.items():
        if getattr(task, key) is not None and task.kind not in kinds:
            raise Unusable(f"a {task.kind} has no {key}", f'Leave it out, or write kind = "{kinds[0]}"', f"requirement.{key}")
    if task.kind == "function":
        _check_output(problem, mechanism)
    elif task.kind == "transmission":
        if problem.width == 0:
            raise Unusable(
                "no group of this mechanism has a transmission angle", "Take another requirement", "requirement.kind", task.kind
            )
        if problem.limits.crank == "span":
            raise Unusable(
                "the transmission is that of a whole revolution", 'Write crank = "full rotation"', "limits.crank", "span"
            )
    else:
        _check_points(problem, mechanism)
    _check_limits(problem, mechanism)


BELONGS = {
    "law": ("function",),
    "output": ("function",),
    "zero": ("function",),
    "mark": ("motion",),
    "angle_length": ("motion",),
    "start": ("path", "motion", "function"),
    "timing": ("path", "motion"),
    "closed": ("path", "motion"),
}
"""What only some kinds of task have."""


def _check_output(problem: GenerationProblem, mechanism: Mechanism) -> None:
    task = problem.requirement
    if task.law is None:
        raise Unusable("the function is missing", f"Write {SLIDES}", "requirement.law")
    guides, bodies = [guide.name for guide in mechanism.guides], [link.body for link in mechanism.links[1:]]
    known = guides if problem.slides else bodies
    what = "guide" if problem.slides else "body that turns"
    if task.output not in known:
        remedy = f"Write output = one of: {', '.join(known)}" if task.output is None else nearest(task.output, known)
        raise Unusable(f"the output is the name of a {what}", remedy, "requirement.output", task.output)
    if task.zero is not None and not problem.slides:
        raise Unusable("only a slider has it", "Leave it out", "requirement.zero", str(task.zero))


def _check_points(problem: GenerationProblem, mechanism: Mechanism) -> None:
    task, wanted = problem.requirement, problem.wanted
    named = [name for name, bodies in mechanism.owners.items() if FRAME not in bodies]
    if task.point not in named:
        remedy = nearest(task.point, named)
        if isinstance(problem.mechanism, FourBarSection) and not problem.mechanism.points:
            remedy = f'Give the coupler a point: mechanism.points = {{ {task.point} = ["60 mm", "20 mm"] }}. {remedy}'
        raise Unusable("no moving body has such a point", remedy, "requirement.point", task.point)
    count = len(wanted.points)
    if task.kind == "motion" and wanted.angles is None:
        raise Unusable(
            "a pose is a point and an angle, and the angles are missing",
            'Write points = [{ x = "20 mm", y = "5 mm", angle = "30 deg" }, ...]',
            "requirement.points",
        )
    if task.kind == "path" and wanted.angles is not None:
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
            f"{count} point{'s' * (count > 1)}",
        )
    if task.timing in ("given", "from start") and wanted.crank is None:
        raise Unusable(
            "the timing is wanted, and the points have no crank angles",
            'Write points = [{ x = "20 mm", y = "5 mm", crank = "30 deg" }, ...], or timing = "free"',
            "requirement.timing",
            task.timing,
        )
    if task.start is not None and problem.timing != "from start":
        raise Unusable(
            "only points that are timed from a start have one",
            'Write timing = "from start", or leave start out',
            "requirement.start",
            str(task.start),
        )
    if task.rotation != "either" and problem.timing != "free":
        raise Unusable(
            "the crank angles of the points say which way the crank turns",
            'Leave rotation out, or write timing = "free"',
            "requirement.rotation",
            task.rotation,
        )
    if max(map(abs, problem.centre)) > MAX_SHIFT * problem.size:
        raise Unusable(
            f"the points lie {max(map(abs, problem.centre)) / problem.size:.1e} times their own size away from the origin, "
            "where no digits are left for their shape",
            "Check the units, or move the origin near the points",
            "requirement.points",
        )


def _check_limits(problem: GenerationProblem, mechanism: Mechanism) -> None:
    limits, four_bar = problem.limits, isinstance(problem.mechanism, FourBarSection)
    for key in ("frame_length", "link_ratio", "swing_angle", "time_ratio", "transmission_cosine"):
        if getattr(limits, key) is not None and not four_bar:
            raise Unusable("only a four-bar has it", "Leave it out, and bound the lengths themselves", f"limits.{key}")
    if limits.crank == "double-crank" and not four_bar:
        raise Unusable("only a four-bar can be one", 'Write crank = "full rotation"', "limits.crank", limits.crank)
    if limits.crank == "span" and limits.transmission_over == "revolution":
        raise Unusable(
            "a crank that need not turn fully has no whole revolution",
            'Write transmission_over = "span", or crank = "full rotation"',
            "limits.transmission_over",
            "revolution",
        )
    if limits.transmission_angle is not None and not any(group.kind == "RRR" for group in mechanism.groups):
        raise Unusable("no group of this mechanism has a transmission angle", "Leave it out", "limits.transmission_angle")
    check_ranges(limits)
    if limits.crank != "full rotation":
        for key in ("swing_angle", "time_ratio"):
            if getattr(limits, key) is not None:
                raise Unusable(
                    "only a crank-rocker has it", 'Set limits.crank = "full rotation", or leave the limit out', f"limits.{key}"
                )
