"""PathProblem: path, motion and function synthesis of any linkage, or optimal force transmission.

Its unknowns are the design variables of the mechanism and, without prescribed timing, the crank angles at the points.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from pydantic.fields import FieldInfo

from optlink.linkage.dyad_types import RRR, Transmitting, transmitting
from optlink.linkage.mechanism import FRAME, Pose
from optlink.linkage.vector2d import TURN, Array, Value, angle_from, dot, minus, turn, unit
from optlink.problem.function import DesignProblem
from optlink.problem.limits import LIMITS, Limits, LimitTerm
from optlink.problem.machine.model import MAX_SHIFT, Problem, ShownObjective
from optlink.problem.mechanism import FourBarSection, check_one_mode
from optlink.problem.path_requirement import (
    PathLimits,
    PathRequirement,
    check_keys,
    check_output,
    check_path_limits,
    check_points,
)
from optlink.problem.quantity import Quantity, Unusable
from optlink.problem.targets.law import Law, Table, is_periodic, rotation
from optlink.problem.targets.target_points import TargetPoints, closed
from optlink.units import DISPLAYED

START, MARK, ZERO = "start", "mark", "zero"
"""Names of the quantities that a task adds to those of the mechanism."""

POSITIONS = 60  # default number of positions of an expression or a function
FINE = 721  # positions at which the travel of a law is computed
GRID = 36  # crank angles at which the transmission of a mechanism other than a four-bar is evaluated

STEP = 1e-4  # rad, least crank rotation from a point to the next


@dataclass(frozen=True, eq=False)
class TargetArrays:
    """Targets at each point, as arrays.

    `columns` (points, k): x, y [m] and, for poses, cosine and sine of the angle; `roots` (points,): square roots of the weights;
    `offsets` (points,) [rad]: prescribed crank angles, or None; `tolerances` (points,) [m], infinite where there is none.
    """

    columns: Array
    roots: Array
    offsets: Array | None
    tolerances: Array


class PathProblem(Problem):
    """A path, motion, function or transmission problem: input of `solve`. Change it with `optlink.load(..., overrides)`."""

    requirement: PathRequirement
    """Points, poses, a function, or the best transmission."""
    limits: PathLimits = PathLimits()
    """Limits of the design."""

    task: ClassVar[str] = "path"
    start_name: ClassVar[str] = START
    base_name: ClassVar[str] = ZERO
    movable_span: ClassVar[bool] = False
    robust: ClassVar[None] = None
    counted: ClassVar[dict[str, float]] = {}

    suffix: ClassVar[str] = ""
    key: ClassVar[str] = "requirement"
    tolerance: ClassVar[None] = None
    worth: ClassVar[float] = 1.0
    goals: ClassVar[tuple[Any, ...]] = ()
    bounds: ClassVar[tuple[Any, ...]] = ()

    @property
    def parts(self) -> tuple[Any, ...]:
        return (self,)

    @property
    def law_given(self) -> bool:
        return self.requirement.kind == "function"

    @property
    def four_bar(self) -> bool:
        return isinstance(self.mechanism, FourBarSection)

    @property
    def span(self) -> float:
        return self.rotation_of_law

    @property
    def everywhere(self) -> bool:
        """Whether the largest deviation is taken over a range, not only at positions: of a law unless it is a table; of cosines."""
        if self.measure != "max":
            return False
        return self.requirement.kind == "transmission" or (self.law_given and not isinstance(self.requirement.law, Table))

    def complete(self, values: Mapping[str, Value]) -> dict[str, Value]:
        return {**{name: q.value for name, q in self.quantities.items()}, **values}

    def check(self) -> None:
        """Check that the sections are consistent.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        check_one_mode(self.mechanism)
        task, limits = self.requirement, self.limits
        check_keys(task)
        if task.kind == "function":
            check_output(task, self.linkage, slides=self.slides, based=self.based)
            self._check_values()
        elif task.kind == "transmission":
            if self.width == 0:
                message = "no dyad of this mechanism has a transmission angle"
                raise Unusable(message, "Take another requirement", "requirement.kind", task.kind)
            if limits.crank == "span":
                message = "the transmission angle is optimised over a whole revolution"
                raise Unusable(message, 'Write crank = "full rotation"', "limits.crank", "span")
        else:
            check_points(task, self.target_points, self.timing, self.mechanism, self.linkage)
            shift = max(map(abs, self.centre))
            if shift > MAX_SHIFT * self.size:
                message = (
                    f"the points lie {shift / self.size:.1e} times their own size away from the origin, "
                    "so double precision does not resolve their shape"
                )
                raise Unusable(message, "Check the units, or move the origin near the points", "requirement.points")
        check_path_limits(limits, self.mechanism, self.linkage)
        super().check()

    def _check_values(self) -> None:
        """Check that an expression has a finite value over the span and moves the output."""
        law, start = self.requirement.law, self.requirement.start
        if isinstance(law, Table):
            return
        starts = [0.3, 0.9, 1.7] if start is None else [start.value, *start.bounds]
        offsets = self.rotation_of_law * np.linspace(0.0, 1.0, FINE)
        hazards = [law.hazards({"phi": begin + offsets, "phi0": begin, "psi0": 0.0}) for begin in starts]
        if all(hazards):
            remedy = "Change the law, the span or the start"
            raise Unusable(f"the law {hazards[0]} on the span", remedy, "requirement.law", law.text)
        if not self.travel > 1e-9:
            raise Unusable("the law does not move the output", "Change the law", "requirement.law", law.text)

    @cached_property
    def quantities(self) -> dict[str, Quantity]:
        """Fixed quantities and design variables by name: those of the mechanism and those of the task."""
        quantities, task = dict(self.mechanism.quantities), self.requirement
        anywhere = Quantity(0.0, "angle", "deg", -math.pi, math.pi)
        if task.kind == "function" and isinstance(task.law, Table) and not task.law.from_start:
            quantities[START] = Quantity(task.law.phi[0], "angle", "deg")
        elif self.timing == "from start":
            quantities[START] = task.start or anywhere
        if task.kind == "motion":
            quantities[MARK] = task.mark or anywhere
        if task.kind == "function" and self.based and self.slides:
            far = 10.0 * max([self.travel, *(q.value for q in quantities.values() if q.kind == "length")])
            quantities[ZERO] = task.zero or Quantity(0.0, "coordinate", "mm", -far, far)
        elif task.kind == "function" and self.based:
            quantities[ZERO] = task.psi0 or anywhere
        return quantities

    def is_periodic(self, name: str) -> bool:
        """Return whether values of an angle that are a revolution apart are one design; not those that a law contains as such."""
        if self.quantities[name].kind != "angle":
            return False
        prescribed = self.requirement.kind == "function" and name in (START, ZERO)
        return not prescribed or is_periodic(self.requirement.law, "phi0" if name == START else "psi0")

    @property
    def based(self) -> bool:
        """Whether the law is relative to the output at the start (psi0, s0), not to the frame."""
        source = self.requirement.law
        return source.from_start if isinstance(source, Table) else "psi0" in source.names

    @cached_property
    def law(self) -> Law:
        """The law of the output at its design positions."""
        source, count = self.requirement.law, self.requirement.points
        if isinstance(source, Table) and count is None:
            return Law(source, source.offsets)
        first = source.phi[0] if isinstance(source, Table) and source.from_start else 0.0
        return Law(source, first + (self.rotation_of_law - first) * np.linspace(0.0, 1.0, (count or POSITIONS) + 1))

    @property
    def rotation_of_law(self) -> float:
        """Crank rotation [rad] of the law, negative clockwise."""
        return rotation(self.requirement.law, self.requirement.span)

    @cached_property
    def travel(self) -> float:
        """Prescribed travel of the output [rad or m], with the crank at its start angle."""
        begin = self.requirement.start.value if self.requirement.start is not None else 0.0
        offsets = np.linspace(self.law.offsets[0], self.law.offsets[-1], FINE)
        return float(np.ptp(self.law.curve(offsets, begin, 0.0)))

    def prescribed(self, values: Mapping[str, Value], offset: Value, tabulated: Value) -> Value:
        """Return the prescribed output [rad or m] at a crank rotation from the start; elementwise.

        `values`: every quantity [m, rad]; `tabulated`: `Law.tabulated` at that `offset`.
        """
        return self.law.target(offset, tabulated, values[START], values.get(ZERO, 0.0))

    def prescribed_outputs(self, values: Mapping[str, float]) -> Array:
        """Return the prescribed output [rad or m] at every position, (positions,)."""
        law = self.law
        return np.asarray(self.prescribed(values, law.offsets, law.tabulated) + 0.0 * law.offsets, dtype=float)

    @property
    def slides(self) -> bool:
        """Whether the output of a law is a slider, not the angle of a body."""
        return getattr(self.requirement.law, "kind", "angle") == "coordinate"

    @property
    def measure(self) -> str:
        """Measure that reduces the deviations to one value."""
        return self.requirement.measure or ("max" if self.requirement.kind == "transmission" else "sum of squares")

    @property
    def unit(self) -> str:
        """SI unit of a deviation: empty for cosines."""
        if self.requirement.kind == "transmission":
            return ""
        return "rad" if self.requirement.kind == "function" and not self.slides else "m"

    @property
    def width(self) -> int:
        """Number of components of the deviation at one position."""
        if self.requirement.kind == "transmission":
            return len(transmitting(self.linkage))
        return {"path": 2, "motion": 3, "function": 1}[self.requirement.kind]

    @property
    def objective_unit(self) -> str:
        """SI unit of the objective."""
        return f"{self.unit}^2" if self.measure == "sum of squares" and self.unit else self.unit

    @property
    def objective_display(self) -> tuple[float, str]:
        """Factor from SI to the displayed value of the objective, and the unit of that."""
        factor, unit = DISPLAYED[self.unit]
        return (factor**2, f"{unit}^2" if unit else unit) if self.measure == "sum of squares" else (factor, unit)

    @property
    def by_angle(self) -> bool:
        """Whether the objective is shown as an angle: the largest cosine of a transmission angle, by its distance from 90 deg."""
        return self.requirement.kind == "transmission" and self.measure == "max"

    def shown_objective(self, objective: float) -> ShownObjective:
        """Return an objective, and how changes of it are shown; see `Problem.shown_objective`."""
        if not self.by_angle or not abs(objective) < 1.0:
            return super().shown_objective(objective)
        slope = 1.0 / math.sqrt(1.0 - objective * objective)
        return ShownObjective(math.degrees(math.asin(objective)), math.degrees(slope), "deg", "transmission angle from 90 deg")

    @property
    def whole(self) -> float:
        """Scale of a deviation in the NLP: the size of the curve, 1 for angles and cosines."""
        return self.size if self.unit == "m" else 1.0

    @property
    def target_points(self) -> TargetPoints:
        """The target points; none for a function or transmission."""
        points = self.requirement.points
        return points if isinstance(points, TargetPoints) else TargetPoints(points=())

    @property
    def timing(self) -> str:
        """Timing: "given" for prescribed crank angles, "from start" for angles relative to a common start, "free" for any."""
        if self.requirement.kind == "function":
            return "from start"
        if self.requirement.kind == "transmission":
            return "given"
        return self.requirement.timing or ("free" if self.target_points.crank is None else "given")

    @cached_property
    def closed(self) -> bool:
        """Whether the points form a closed curve: the last step leads back to the first point."""
        if self.requirement.closed is not None:
            return self.requirement.closed
        return len(self.target_points.points) > 3 and closed(self.target_points)

    @property
    def meets_again(self) -> bool:
        """Whether the last point coincides with the first: only then may the crank angles coincide."""
        columns = self.data.columns
        return bool(np.max(np.abs(columns[0, :2] - columns[-1, :2])) <= 1e-9 * self.size)

    @property
    def side(self) -> int:
        """Assembly mode of a four-bar: +1 left, -1 right of B -> D."""
        assert isinstance(self.mechanism, FourBarSection)
        return self.mechanism.side

    @cached_property
    def data(self) -> TargetArrays:
        """The targets as arrays."""
        target, task = self.target_points, self.requirement
        if task.kind == "function":
            return _plain(np.column_stack([self.law.offsets, self.law.tabulated]), self.law.offsets)
        if task.kind == "transmission":
            exact = isinstance(self.mechanism, FourBarSection)
            offsets = np.array([0.0, math.pi]) if exact else np.linspace(0.0, TURN, GRID, endpoint=False)
            return _plain(np.zeros((len(offsets), 1)), offsets)
        columns = np.array(target.points, dtype=float)
        if task.kind == "motion":
            assert target.angles is not None
            columns = np.column_stack([columns, *unit(np.array(target.angles))])
        count = len(columns)
        roots = np.ones(count) if target.weights is None else np.sqrt(np.array(target.weights))
        tolerances = np.full(count, np.inf) if target.tolerances is None else np.array(target.tolerances)
        prescribed = None if self.timing == "free" or target.crank is None else np.array(target.crank)
        return TargetArrays(columns, roots, prescribed, tolerances)

    @property
    def pointed(self) -> bool:
        """Whether points in the plane are prescribed."""
        return self.requirement.kind in ("path", "motion")

    @cached_property
    def centre(self) -> tuple[float, float]:
        """Mean of the points [m]; the origin if there are none."""
        if not self.pointed:
            return 0.0, 0.0
        x, y = np.mean(self.data.columns[:, :2], axis=0)
        return float(x), float(y)

    @cached_property
    def size(self) -> float:
        """Size [m] of the curve, the root mean square distance of its points from their centre; else the travel; else a link."""
        if self.pointed:
            spread = self.data.columns[:, :2] - np.array(self.centre)
            size = float(np.sqrt(np.mean(np.sum(spread * spread, axis=1))))
            if size > 0.0:
                return size
        if self.slides and self.travel > 0.0:
            return self.travel
        quantities = [q for q in self.mechanism.quantities.values() if q.kind == "length"]
        fixed = [q.value for q in quantities if not q.free]
        return max(fixed or [q.value for q in quantities])

    @cached_property
    def radian(self) -> float:
        """Length [m] equivalent to one radian of a pose."""
        length = self.requirement.angle_length
        return self.size if length is None else length.value

    @property
    def body(self) -> str:
        """The body that carries the point."""
        owners = [body for body in self.linkage.owners.get(self.requirement.point, ()) if body != FRAME]
        return owners[-1] if owners else ""

    def deviation(self, pose: Pose, values: Mapping[str, Value], target: tuple[Value, ...]) -> list[Value]:
        """Return actual minus prescribed output at one position, elementwise.

        For a path, x and y [m]; for a pose also the angle times `radian`; for a function the slide [m] or angle [rad]; for
        transmission the cosine of the angle of each dyad. `target` is a row of `TargetArrays.columns`.
        """
        kind = self.requirement.kind
        if kind == "transmission":
            return [transmission_cosine(pose, group) for group in transmitting(self.linkage)]
        if kind == "function":
            if self.slides:
                guide = next(guide for guide in self.linkage.guides if guide.name == self.requirement.output)
                return [pose.slide(guide) - self.prescribed(values, *target)]
            return [angle_from(unit(self.prescribed(values, *target)), pose.direction(str(self.requirement.output)))]
        x, y = pose.point(self.requirement.point)
        components = [x - target[0], y - target[1]]
        if kind == "motion":
            turned = turn(pose.direction(self.body), unit(values[MARK]))
            components.append(self.radian * angle_from((target[2], target[3]), turned))
        return components

    def start(self, values: Mapping[str, float]) -> float:
        """Return the crank angle [rad] at which the requirement begins, where the problem has one; else that of the drive."""
        return float(values[START]) if START in values else super().start(values)

    def crank_angles(self, values: Mapping[str, float], angles: Array | None) -> Array:
        """Return the crank angle [rad] at each point; where the timing is free those of the design, `angles`."""
        offsets = self.data.offsets
        if offsets is None:
            assert angles is not None
            return angles
        return offsets + (values[START] if self.timing == "from start" else 0.0)


def _plain(columns: Array, offsets: Array) -> TargetArrays:
    """Return positions of equal weight without tolerances."""
    return TargetArrays(columns, np.ones(len(columns)), offsets, np.full(len(columns), np.inf))


def transmission_cosine(pose: Pose, group: Transmitting) -> Value:
    """Return the cosine of the transmission angle of a group; not a number for two links that cannot close."""
    if not isinstance(group, RRR):
        return group.cosine(pose)
    joint = pose.point(group.joint)
    one, other = (minus(pose.point(pin), joint) for pin in group.outer)
    return dot(one, other) / np.sqrt(dot(one, one) * dot(other, other))


def add_limit(term: LimitTerm) -> None:
    """Register a limit of function and path synthesis from outside the package.

    Raises
    ------
    ValueError
        if the key is already taken.
    """
    if term.name in PathLimits.model_fields:
        raise ValueError(f"{term.key} is already registered")
    LIMITS.add(term.name, term)
    for section in (Limits, PathLimits):
        section.model_fields[term.name] = FieldInfo(annotation=term.form | None, default=None, description=term.about)
    for model in (Limits, PathLimits, DesignProblem, PathProblem):
        model.model_rebuild(force=True)
