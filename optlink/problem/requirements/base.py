"""Requirements of design problems: what every kind has. Its class holds its keys, checks, targets and the deviation from them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Protocol

import numpy as np

from optlink.linkage.fourbar import InnerFourBar
from optlink.linkage.mechanism import Mechanism, Pose
from optlink.linkage.vector2d import Array, Value, Vector
from optlink.problem.base_model import Name, Section
from optlink.problem.limits import Bound, Limits
from optlink.problem.quantity import Number, Quantity, Unusable, below, read_figure, where
from optlink.problem.targets.law import Law
from optlink.problem.targets.target_points import TargetPoints
from optlink.problem.tolerances import Robustness

START, MARK, ZERO = "start", "mark", "zero"
"""Names of quantities that a requirement adds to those of dyads; a law of a four-bar section adds phi0 and psi0."""
SAME_ANGLE = 1e-9
"""Difference of crank angles [rad] that is rounding."""
Measure = Literal["sum of squares", "rms", "max"]


@dataclass(frozen=True, eq=False)
class TargetArrays:
    """Targets at each position, as arrays.

    `columns` (positions, k): x, y [m] and, for poses, cosine and sine of the angle; for a law crank rotation [rad] and tabulated
    output [rad or m]; `roots` (positions,): square roots of the weights; `offsets` (positions,) [rad]: prescribed crank angles,
    or None; `tolerances` (positions,) [m], infinite where there is none.
    """

    columns: Array
    roots: Array
    offsets: Array | None
    tolerances: Array


def pose_angles(targets: Array) -> Array:
    """Return the angles [rad] of poses as rows of `TargetArrays.columns` (..., 4), NaN where none is given."""
    cosine, sine = targets[..., 2], targets[..., 3]
    return np.where((cosine == 0.0) & (sine == 0.0), np.nan, np.arctan2(sine, cosine))


@dataclass(frozen=True)
class StartPosition:
    """Start of a law: crank direction, crank angle [rad] and prescribed output [rad or m] there."""

    crank: Vector
    phi0: Value
    psi0: Value


class Designed(Protocol):
    """What a requirement needs to know of its design problem."""

    mechanism: Any
    linkage: Mechanism
    limits: Limits
    tolerances: Mapping[str, Any]
    four_bar: InnerFourBar | None
    frame_angle: float | None
    quantities: dict[str, Quantity]
    law: Law
    size: float

    def complete(self, values: Mapping[str, Value]) -> dict[str, Value]:
        """Return every quantity [SI], with those that follow from others."""


class Requirement(Section):
    """What the design must do; base of all kinds, whose methods take the design problem."""

    if TYPE_CHECKING:
        kind: str  # a key of each kind

    name: Name | None = None
    """Name of the requirement, which its quantities begin with if there are several; default: its kind."""
    tolerance: Any = None
    """Largest value of the measure, in its unit: the requirement is then a limit, and something else is optimised."""
    weight: Annotated[Number, where(lambda w: w > 0.0, "a weight is positive", "Give one above zero")] | None = None
    """Weight in an objective of several terms."""
    scale: Any = None
    """Divisor in an objective of several terms, in the unit of the measure; default: the size of the curve or 1 rad."""
    robust: Robustness = None
    """Effect of `[tolerances]` on the objective: `"3 sigma"` or `"worst case"` with the measure `max`, `"expected value"` with
    the sum of squares or rms; default: none."""

    limited_by: ClassVar[tuple[str, str]] = "tolerance", "deviation"
    """Key whose value makes the requirement a limit, and what it limits."""

    centred: ClassVar[bool] = False
    """Whether a free base of the output is the middle of what it limits, so that a design shows it there."""

    targeted: ClassVar[bool] = True
    """Whether it has targets, from which designs deviate at positions; else it has `bounds` alone, or nothing."""

    pointed: ClassVar[bool] = False
    """Whether points in the plane are prescribed."""

    separate: ClassVar[bool] = False
    """Whether each component of a deviation is judged by itself, not the length of their vector."""

    law_given: ClassVar[bool] = False
    """Whether an output follows a law."""

    secondary: ClassVar[bool] = False
    """Whether the other requirements of a problem come first: results are shown by theirs."""

    def slides(self, problem: Designed) -> bool:
        """Return whether the output of a law is a coordinate, of a slider or a point, not the angle of a body."""
        return False

    def ranged(self, problem: Designed) -> bool:
        """Return whether its largest deviation counts over a range of crank angles, not at positions."""
        return False

    @property
    def family(self) -> str:
        """The kind that measures and shows its designs: this one, or the one that it specialises."""
        return self.kind

    @property
    def timed(self) -> str:
        """Timing: "given" for prescribed crank angles, "from start" for angles relative to a common start, "free" for any."""
        return "given"

    @property
    def is_closed(self) -> bool:
        """Whether the positions form a closed curve."""
        return False

    @property
    def by_angle(self) -> bool:
        """Whether the objective is the cosine of an angle, by which it is shown."""
        return False

    @property
    def targets(self) -> TargetPoints:
        """The target points; none for a law or transmission."""
        return TargetPoints(points=())

    @property
    def limited(self) -> bool:
        """Whether the requirement is a limit; else it is minimised."""
        return getattr(self, self.limited_by[0]) is not None

    @property
    def reduction(self) -> str:
        """Measure that reduces the deviations; a limit applies to the largest one unless the file states another."""
        limited = self.limited and "measure" not in self.model_fields_set
        return "max" if limited else str(getattr(self, "measure", "max"))

    def stated(self, problem: Designed) -> tuple[float, float | None]:
        """Return factor and offset from a deviation [SI] to what the file limits; None for deviations of either sign."""
        return 1.0, None

    def interval(self, problem: Designed) -> tuple[float, float] | None:
        """Return the least and the largest deviation, or measure of them, [SI] of a limit; None if it is minimised."""
        key, raw = self.limited_by[0], getattr(self, self.limited_by[0])
        if raw is None:
            return None
        if self.reduction == "sum of squares":
            message = f"a {key} limits the largest deviation or the rms"
            raise Unusable(message, 'Write measure = "max"', "requirement.measure")
        with below("requirement"):
            value = read_figure(raw, {"m": "length", "rad": "angle"}.get(self.unit(problem), ""), key)[0]
        if value <= 0.0:
            raise Unusable(f"a {key} must be positive", "Give one above zero", f"requirement.{key}", raw)
        most = value / self.stated(problem)[0]
        return -most, most

    def bounds(self, problem: Designed) -> Iterator[Bound]:
        """Yield limits of quantities of the machine over its cycle that the requirement states."""
        yield from ()

    def task(self, problem: Designed) -> str:
        """Return the name of the search: "function" for laws of the rocker of a four-bar, "cycle" without targets, or "path"."""
        return "path" if self.targeted else "cycle"

    def names(self, problem: Designed) -> tuple[str, str]:
        """Return the names of the quantities at the common start: crank angle and output."""
        return START, ZERO

    def key_of(self, problem: Designed, name: str) -> str:
        """Return the key under which the requirement states one of its quantities."""
        return name

    def dead_centre(self, problem: Designed) -> str | None:
        """Return the dead centre at which the requirement starts; None if it starts at a crank angle."""
        return None

    def check(self, problem: Designed) -> None:
        """Check that the requirement fits the mechanism and its limits, which have been checked by themselves.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """

    def rotations(self, problem: Designed) -> tuple[float, float]:
        """Return the least and largest crank rotation [rad] from the start, else crank angle, of what is prescribed."""
        offsets = self.data(problem).offsets
        assert offsets is not None
        return float(np.min(offsets)), float(np.max(offsets))

    def any_start(self, problem: Designed, half: float) -> Quantity:
        """Return a free start angle, by `half` [rad] to either side, or by which the drive keeps to its range."""
        if problem.linkage.limits is None:
            return Quantity(0.0, "angle", "deg", -half, half)
        low, high = (limit - turned for limit, turned in zip(problem.linkage.limits, self.rotations(problem), strict=True))
        if high - low <= SAME_ANGLE:
            return Quantity(0.5 * (low + high), "angle", "deg")
        return Quantity(0.5 * (low + high), "angle", "deg", low, high)

    def check_reached(self, problem: Designed) -> None:
        """Refuse what is prescribed at positions that lie outside the range of the drive.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        if problem.linkage.limits is None or not self.targeted or self.data(problem).offsets is None:
            return
        name = self.names(problem)[0]
        starts = problem.quantities[name].bounds if name in problem.quantities else (0.0, 0.0)
        least, largest = (start + turned for start, turned in zip(starts, self.rotations(problem), strict=True))
        low, high = problem.linkage.limits
        if least < low - SAME_ANGLE or largest > high + SAME_ANGLE:
            asked, given = (" to ".join(f"{math.degrees(end):.6g}" for end in ends) for ends in ((least, largest), (low, high)))
            message = f"it asks for positions from {asked} deg, and the drive moves from {given} deg"
            remedy = (
                "Change them or drive.range; a slide or cylinder is at 0 deg where its range begins, at 180 deg where it ends"
            )
            raise Unusable(message, remedy, "requirement")

    def quantities(self, problem: Designed) -> dict[str, Quantity]:
        """Return the quantities that the requirement adds to those of the mechanism."""
        return {}

    def derived(self, problem: Designed, values: Mapping[str, Value]) -> dict[str, Value]:
        """Return the values [SI] that follow from those of all quantities; elementwise."""
        return {}

    def is_periodic(self, problem: Designed, name: str) -> bool:
        """Return whether values of an angle a revolution apart are one design."""
        return True

    def sense(self, problem: Designed) -> int:
        """Return the sense of crank rotation that is required: +1 counter-clockwise, -1 clockwise, 0 for that of the drive."""
        return 0

    def size(self, problem: Designed) -> float | None:
        """Return the size [m] of what is prescribed, else None."""
        return None

    def radian(self, problem: Designed) -> float:
        """Return the length [m] equivalent to one radian of a pose."""
        return problem.size

    def unit(self, problem: Designed) -> str:
        """Return the SI unit of a deviation: empty for cosines."""
        return "m"

    def width(self, problem: Designed) -> int:
        """Return the number of components of the deviation at one position."""
        raise NotImplementedError

    def data(self, problem: Designed) -> TargetArrays:
        """Return the targets as arrays; none by default."""
        return at_positions(np.zeros((0, 1)), np.zeros(0))

    def deviation(self, problem: Designed, pose: Pose, values: Mapping[str, Value], target: tuple[Value, ...]) -> list[Value]:
        """Return actual minus prescribed output at one position, elementwise; `target` is a row of `TargetArrays.columns`."""
        raise NotImplementedError

    def inapplicable(self, problem: Designed) -> set[str]:
        """Return the keys of the requirement and its limits, "requirement.zero", that do not apply to this mechanism."""
        return set()

    def effective(self, problem: Designed) -> dict[str, str]:
        """Return the effective values of optional keys, for display."""
        return {}

    def loaded(self, problem: Designed) -> str:
        """Return the output that shows to which side a joint clearance lies: a body (its angle), or "P.x" of a point."""
        return "rocker" if problem.mechanism.by_lengths else ""


class NoRequirement(Requirement):
    """Requirement of a problem whose objective and limits say everything."""

    kind: ClassVar[str] = ""  # type: ignore[misc]
    targeted: ClassVar[bool] = False


def names_of(stated: Sequence[tuple[str | None, str]]) -> list[str]:
    """Return the names of several requirements, each stated by its name and kind: its kind, numbered from the second one on."""
    kinds = [kind for _, kind in stated]
    counts = [kinds[: k + 1].count(kind) for k, kind in enumerate(kinds)]
    return [name or f"{kind}{count if count > 1 else ''}" for (name, kind), count in zip(stated, counts, strict=True)]


def at_positions(columns: Array, offsets: Array) -> TargetArrays:
    """Return positions of equal weight without tolerances."""
    return TargetArrays(columns, np.ones(len(columns)), offsets, np.full(len(columns), np.inf))


DEFAULT_KIND = "function"
