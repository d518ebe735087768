"""GenerationProblem: a linkage whose point shall pass given points, or whose body shall take given poses.

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

from optlink.design.limits import Limits, check_ranges
from optlink.design.linkages import FourBarSection
from optlink.design.machines import Problem
from optlink.design.points import Wanted, closed, read_points
from optlink.design.quantity import (
    Angle,
    CoordinateInterval,
    FixedLength,
    Quantity,
    Unusable,
    nearest,
)
from optlink.design.section import Section
from optlink.linkage.elementwise import Value, angle_from, unit
from optlink.linkage.mechanism import FRAME, Mechanism, Pose

Array = NDArray[np.float64]
TURN = 2.0 * math.pi
START, MARK = "start", "mark"
"""Names of the quantities that a task adds to those of the mechanism."""

STEP = 1e-4  # rad, least crank rotation from a point to the next
MAX_SHIFT = 1e6  # sizes of the curve that it may lie away from the origin


def _read_crank(raw: object) -> object:
    if isinstance(raw, str) and raw in ("free", "from start", "given"):
        return raw
    raise Unusable("not a kind of timing", nearest(str(raw), ("free", "from start", "given")), "", raw)


class Task(Section):
    """What the linkage must do: its point passes the points (path), its body takes the poses (motion), in the order listed."""

    kind: Literal["path", "motion"]
    point: str = "P"
    points: Any
    timing: Annotated[Literal["free", "from start", "given"] | None, BeforeValidator(_read_crank)] = None
    start: Angle | None = None
    rotation: Literal["either", "counter-clockwise", "clockwise"] = "either"
    closed: bool | None = None
    mark: Angle | None = None
    angle_length: FixedLength | None = None
    measure: Literal["sum of squares", "rms", "max"] = "sum of squares"

    @field_validator("points", mode="before")
    @classmethod
    def _points(cls, raw: object, info: ValidationInfo) -> Wanted:
        return read_points(raw, (info.context or {}).get("folder", Path()))


class RegionSection(Section):
    """A rectangle of the plane: ranges of x and y."""

    x: CoordinateInterval | None = None
    y: CoordinateInterval | None = None


class GenerationLimits(Limits):
    """What must hold beside the points."""

    pivots: RegionSection | None = None


@dataclass(frozen=True)
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
        """Every quantity that can be fixed or free, by name: those of the mechanism, the start of the crank, the mark."""
        found = dict(self.mechanism.quantities)
        if self.timing == "from start":
            found[START] = self.requirement.start or Quantity(0.0, "angle", "deg", -math.pi, math.pi)
        if self.requirement.kind == "motion":
            found[MARK] = self.requirement.mark or Quantity(0.0, "angle", "deg", -math.pi, math.pi)
        return found

    @property
    def wanted(self) -> Wanted:
        """The points as they were read."""
        return self.requirement.points  # type: ignore[no-any-return]

    @property
    def timing(self) -> str:
        """ "given": crank angles belong to the points; "from start": up to a common start; "free": in order."""
        return self.requirement.timing or ("free" if self.wanted.crank is None else "given")

    @cached_property
    def closed(self) -> bool:
        """Whether the points go once round a closed curve: the last step leads back to the first point."""
        if self.requirement.closed is not None:
            return self.requirement.closed
        return len(self.wanted.points) > 3 and closed(self.wanted)

    @property
    def side(self) -> int:
        """Assembly mode of a four-bar: +1 left, -1 right of B -> D."""
        assert isinstance(self.mechanism, FourBarSection)
        return self.mechanism.side

    @cached_property
    def data(self) -> Data:
        """What is wanted, as arrays."""
        wanted = self.wanted
        columns = np.array(wanted.points, dtype=float)
        if self.requirement.kind == "motion":
            assert wanted.angles is not None
            columns = np.column_stack([columns, *unit(np.array(wanted.angles))])
        count = len(columns)
        roots = np.ones(count) if wanted.weights is None else np.sqrt(np.array(wanted.weights))
        tolerances = np.full(count, np.inf) if wanted.tolerances is None else np.array(wanted.tolerances)
        offsets = None if self.timing == "free" or wanted.crank is None else np.array(wanted.crank)
        return Data(columns, roots, offsets, tolerances)

    @cached_property
    def centre(self) -> tuple[float, float]:
        """Mean of the points [m]."""
        x, y = np.mean(self.data.columns[:, :2], axis=0)
        return float(x), float(y)

    @cached_property
    def size(self) -> float:
        """How large the curve is [m]: root mean square of the points' distances from their centre; if zero, the longest link."""
        spread = self.data.columns[:, :2] - np.array(self.centre)
        size = float(np.sqrt(np.mean(np.sum(spread * spread, axis=1))))
        if size > 0.0:
            return size
        lengths = [q.value for q in self.mechanism.quantities.values() if q.kind == "length"]
        return max(lengths)

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
        """Generated minus wanted [m] at one position, elementwise: x, y and, of a pose, the angle times `radian`.

        `wanted` is a row of `Data.columns`.
        """
        x, y = pose.point(self.requirement.point)
        found = [x - wanted[0], y - wanted[1]]
        if self.requirement.kind == "motion":
            c, s = pose.direction(self.body)
            mark = unit(values[MARK])
            turned = (c * mark[0] - s * mark[1], s * mark[0] + c * mark[1])
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


def cross_check_generation(problem: GenerationProblem) -> None:
    """Find what no single key shows.

    Raises
    ------
    Unusable
        with the full key that is to blame.
    """
    task, wanted = problem.requirement, problem.wanted
    mechanism = problem.linkage
    named = [name for name, bodies in mechanism.owners.items() if set(bodies) != {FRAME}]
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
    if task.kind == "path" and (task.mark is not None or task.angle_length is not None):
        key = "mark" if task.mark is not None else "angle_length"
        raise Unusable("only a motion has it", 'Leave it out, or write kind = "motion"', f"requirement.{key}")
    least = 2
    if count < least:
        raise Unusable(
            f"{count} point is no {task.kind}",
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
    _check_limits(problem, mechanism)


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
