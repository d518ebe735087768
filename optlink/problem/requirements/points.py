"""Requirements of points and poses: a point passes them in order, a body takes them."""

import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator

from optlink.linkage.mechanism import FRAME, Mechanism, Pose
from optlink.linkage.vector2d import Array, Value, angle_from, dot, turn, unit
from optlink.problem.base_model import in_folder
from optlink.problem.machine.model import MAX_SHIFT
from optlink.problem.mechanism import moving_points
from optlink.problem.quantity import Angle, FixedLength, Quantity, Unusable, check_name, nearest
from optlink.problem.requirements.base import MARK, START, Designed, Measure, Requirement, TargetArrays
from optlink.problem.targets.target_points import COINCIDENT, TargetPoints, closed


def _read_timing(raw: object) -> object:
    check_name(raw, ("free", "from start", "given"), "not a kind of timing")
    return raw


def _read_points(raw: object, folder: Path) -> TargetPoints:
    """Read points; the readers of drawings and curves are loaded for a file that has points only."""
    from optlink.problem.targets.points import read_points

    return read_points(raw, folder)


class PathRequirement(Requirement):
    """A point passes the listed points in order."""

    kind: Literal["path"]
    """Kind of requirement."""
    point: str = "P"
    """The moving point that takes the positions; its body takes the angles."""
    points: Annotated[Any, in_folder(_read_points)] = None
    """Points or poses: a list, a CSV file, a drawing or expressions."""
    timing: Annotated[Literal["free", "from start", "given"] | None, BeforeValidator(_read_timing)] = None
    """Crank angles at the points: `given`: prescribed; `from start`: prescribed except for a common offset; `free`: optimised, in
    the order of the points. Default: `given` if the points have crank angles, else `free`."""
    start: Angle | None = None
    """Common offset of the crank angles, fixed or free; default: any angle."""
    rotation: Literal["either", "counter-clockwise", "clockwise"] = "either"
    """Sense of crank rotation with free timing."""
    closed: bool | None = None
    """Whether the last point leads back to the first one within the revolution; default: determined from the points."""
    measure: Measure = "sum of squares"
    """Measure that combines all deviations into the objective; `max` is the largest one."""
    exact: bool = False
    """Whether only designs that meet the points or poses exactly are wanted: all of them, without a search."""

    pointed: ClassVar[bool] = True

    @property
    def targets(self) -> TargetPoints:
        """The target points."""
        return self.points if isinstance(self.points, TargetPoints) else TargetPoints(points=())

    @property
    def timed(self) -> str:
        """Timing: "given" for prescribed crank angles, "from start" for angles relative to a common start, "free" for any."""
        return self.timing or ("free" if self.targets.crank is None else "given")

    @property
    def is_closed(self) -> bool:
        """Whether the points form a closed curve: the last step leads back to the first point."""
        if self.closed is not None:
            return self.closed
        return len(self.targets.points) > 3 and closed(self.targets)

    def quantities(self, problem: Designed) -> dict[str, Quantity]:
        """Return the common start angle of the crank, where the timing has one."""
        return {START: self.start or self.any_start(problem, math.pi)} if self.timed == "from start" else {}

    def loaded(self, problem: Designed) -> str:
        """Return a coordinate of the point, see `Requirement.loaded`."""
        return f"{self.point}.x"

    @property
    def centre(self) -> tuple[float, float]:
        """Mean of the points [m]."""
        x, y = np.mean(np.array(self.targets.points, dtype=float), axis=0)
        return float(x), float(y)

    def size(self, problem: Designed) -> float | None:
        """Return the root mean square distance [m] of the points from their centre."""
        spread = np.array(self.targets.points, dtype=float) - np.array(self.centre)
        return float(np.sqrt(np.mean(np.sum(spread * spread, axis=1)))) or None

    def width(self, problem: Designed) -> int:
        """Return the number of components of the deviation at one position."""
        return 2

    def columns(self) -> Array:
        """Return x, y [m] of every position, (positions, 2)."""
        return np.array(self.targets.points, dtype=float)

    def data(self, problem: Designed) -> TargetArrays:
        """Return the targets as arrays."""
        target, columns = self.targets, self.columns()
        count = len(columns)
        roots = np.ones(count) if target.weights is None else np.sqrt(np.array(target.weights))
        tolerances = np.full(count, np.inf) if target.tolerances is None else np.array(target.tolerances)
        prescribed = None if self.timed == "free" or target.crank is None else np.array(target.crank)
        return TargetArrays(columns, roots, prescribed, tolerances)

    def deviation(self, problem: Designed, pose: Pose, values: Mapping[str, Value], target: tuple[Value, ...]) -> list[Value]:
        """Return actual minus prescribed x and y [m]."""
        x, y = pose.point(self.point)
        return [x - target[0], y - target[1]]

    def check(self, problem: Designed) -> None:
        """Check that points or poses, their timing and the body that takes them fit each other.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        points, moving = self.targets, moving_points(problem.linkage)
        if self.point not in moving:
            remedy = nearest(self.point, moving)
            if problem.mechanism.by_lengths and not problem.mechanism.points:
                remedy = f'Give the coupler a point: mechanism.points = {{ {self.point} = ["60 mm", "20 mm"] }}. {remedy}'
            raise Unusable("no moving body has such a point", remedy, "requirement.point", self.point)
        self._check_angles(points)
        count = len(points.points)
        if not count:
            example = 'points = [["20 mm", "5 mm"], ["25 mm", "8 mm"]], { csv = "curve.csv" } or { svg = "drawing.svg" }'
            raise Unusable("the points are missing", f"Write {example}", "requirement.points")
        least = 3 if self.closed else 2
        if count < least:
            message = f"{count} point{'s are' if count > 1 else ' is'} no {'closed curve' if self.closed else self.kind}"
            raise Unusable(message, f"Give at least {least}", "requirement.points")
        self._check_distinct(points)
        self._check_timing(points)
        if self.closed and problem.linkage.limits is not None:
            message = "the drive has a range, so the last point does not lead back to the first"
            raise Unusable(message, "Leave it out", "requirement.closed", True)
        shift = max(map(abs, self.centre))
        if shift > MAX_SHIFT * problem.size:
            message = (
                f"the points lie {shift / problem.size:.1e} times their own size away from the origin, "
                "so double precision does not resolve their shape"
            )
            raise Unusable(message, "Check the units, or move the origin near the points", "requirement.points")

    def _check_timing(self, points: TargetPoints) -> None:
        timing = self.timed
        if timing != "free" and points.crank is None:
            remedy = 'Write points = [{ x = "20 mm", y = "5 mm", crank = "30 deg" }, ...], or timing = "free"'
            message = "the timing is prescribed, but the points have no crank angles"
            raise Unusable(message, remedy, "requirement.timing", self.timing)
        if timing != "free" and points.crank is not None:
            _check_whole_revolution(points, points.crank)
        if self.start is not None and timing != "from start":
            message = "this key applies to points that are timed from a start only"
            raise Unusable(message, 'Write timing = "from start", or leave start out', "requirement.start", str(self.start))
        if self.rotation != "either" and timing != "free":
            message = "the crank angles of the points already state the direction of the crank"
            raise Unusable(message, 'Leave rotation out, or write timing = "free"', "requirement.rotation", self.rotation)

    def _check_angles(self, points: TargetPoints) -> None:
        """Refuse the angles of poses."""
        if points.angles is not None:
            raise Unusable("a path has no angles", 'Leave them out, or write kind = "motion"', "requirement.points")

    def _check_distinct(self, points: TargetPoints) -> None:
        """Accept a point that occurs twice: a curve may cross itself."""

    def effective(self, problem: Designed) -> dict[str, str]:
        """Return the effective values of optional keys, for display."""
        values = {"timing": self.timed, "closed": str(self.is_closed).lower()}
        return values | {key: str(problem.quantities[key]) for key in (START, MARK) if key in problem.quantities}


class MotionRequirement(PathRequirement):
    """A body takes the listed poses in order."""

    kind: Literal["motion"]  # type: ignore[assignment]
    """Kind of requirement."""
    mark: Angle | None = None
    """Angle from the direction of the body to that of the poses, fixed or free; default: free."""
    angle_length: FixedLength | None = None
    """Length that is equivalent to an angle error of one radian; default: the size of the curve."""

    def quantities(self, problem: Designed) -> dict[str, Quantity]:
        """Return the common start angle of the crank, where the timing has one, and the mark of the body."""
        return {**super().quantities(problem), MARK: self.mark or Quantity(0.0, "angle", "deg", -math.pi, math.pi)}

    def radian(self, problem: Designed) -> float:
        """Return the length [m] equivalent to one radian of a pose."""
        return problem.size if self.angle_length is None else self.angle_length.value

    def width(self, problem: Designed) -> int:
        """Return the number of components of the deviation at one position."""
        return 3

    def columns(self) -> Array:
        """Return x, y [m], cosine and sine of every pose, (positions, 4); both are 0 where no angle is given."""
        assert self.targets.angles is not None
        return np.column_stack([super().columns(), *np.nan_to_num(unit(np.array(self.targets.angles)))])

    def deviation(self, problem: Designed, pose: Pose, values: Mapping[str, Value], target: tuple[Value, ...]) -> list[Value]:
        """Return actual minus prescribed x and y, and the angle times `radian` [m]."""
        turned = turn(pose.direction(carrier(problem.linkage, self.point)), unit(values[MARK]))
        wanted = target[2], target[3]
        if not self.targets.posed.all():  # the direction of the body itself where no angle is given
            free = 1.0 - dot(wanted, wanted)
            wanted = wanted[0] + free * turned[0], wanted[1] + free * turned[1]
        return [*super().deviation(problem, pose, values, target), self.radian(problem) * angle_from(wanted, turned)]

    def _check_angles(self, points: TargetPoints) -> None:
        """Refuse points of which none has an angle."""
        if not points.posed.any():
            remedy = 'Write points = [{ x = "20 mm", y = "5 mm", angle = "30 deg" }, ...]'
            raise Unusable("a pose is a point and an angle, and the angles are missing", remedy, "requirement.points")

    def _check_distinct(self, points: TargetPoints) -> None:
        """Refuse a pose that occurs twice with free timing, unless it closes the motion: no revolution meets it twice."""
        if self.timed != "free":
            return
        poses, count, loop = np.array(points.points), len(points.points), bool(self.closed or points.loop)
        for j, i in itertools.combinations(range(count), 2):
            if loop and (j, i) == (0, count - 1):
                continue
            assert points.angles is not None
            turned = math.remainder(points.angles[i] - points.angles[j], math.tau)
            if np.linalg.norm(poses[i] - poses[j]) <= COINCIDENT * points.size and abs(turned) <= COINCIDENT:
                message = f"poses {j + 1} and {i + 1} are the same, but one revolution passes a pose only once"
                raise Unusable(message, "Remove one of them, or prescribe crank angles for a dwell", "requirement.points")

    def effective(self, problem: Designed) -> dict[str, str]:
        """Return the effective values of optional keys, for display."""
        return {**super().effective(problem), "angle_length": f"{1e3 * self.radian(problem):.6g} mm"}


def _check_whole_revolution(points: TargetPoints, crank: tuple[float, ...]) -> None:
    """Refuse a last point one revolution after the first, but elsewhere: the linkage is in the same position there."""
    away = math.dist(points.points[0], points.points[-1])
    if abs(crank[-1] - crank[0]) > math.tau * (1.0 - 1e-9) and away > COINCIDENT * points.size:
        message = f"point {len(crank)}, at {math.degrees(crank[-1]):.6g} deg, lies one revolution after point 1, but elsewhere"
        raise Unusable(message, "Give both the same position, or leave one of them out", "requirement.points")


def carrier(linkage: Mechanism, point: str) -> str:
    """Return the body that carries a moving point."""
    owners = [body for body in linkage.owners.get(point, ()) if body != FRAME]
    return owners[-1] if owners else ""
