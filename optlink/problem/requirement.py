"""Requirements of a design problem: one class per kind, with its keys, its checks, its targets and the deviation from them."""

import functools
import itertools
import math
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Protocol, Self

import numpy as np
from pydantic import AliasChoices, BeforeValidator, Discriminator, Field, Tag, model_validator

from optlink.io import Registry
from optlink.linkage.dyad_types import RRR, Transmitting, transmitting
from optlink.linkage.fourbar import DeadCentre
from optlink.linkage.inner_four_bar import InnerFourBar, inner_four_bars
from optlink.linkage.mechanism import FRAME, Mechanism, Pose
from optlink.linkage.vector2d import TURN, Array, Value, Vector, angle, angle_from, dot, minus, turn, unit
from optlink.problem.base_model import Name, Section, in_folder
from optlink.problem.cycle.quantities import guide_of
from optlink.problem.cycle.terms import Limit, Term, check_term, output_of
from optlink.problem.interval import SIDES, Interval, RatioOfStrokes, read_figure, read_interval
from optlink.problem.limits import Bound, Limits
from optlink.problem.machine.model import MAX_SHIFT
from optlink.problem.mechanism import moving_points
from optlink.problem.quantity import (
    Angle,
    FixedAngle,
    FixedLength,
    Number,
    Quantity,
    Unusable,
    below,
    check_keys,
    check_name,
    check_pair,
    nearest,
    read_fixed,
    read_quantity,
    where,
)
from optlink.problem.robust import Robustness
from optlink.problem.targets.expression import Expression, parse
from optlink.problem.targets.function import Function
from optlink.problem.targets.law import (
    SLIDE,
    Law,
    SlideExpression,
    Table,
    begins_at_psi0,
    check_rotation,
    is_periodic,
    read_output_law,
    rotation,
)
from optlink.problem.targets.target_points import COINCIDENT, TargetPoints, closed

START, MARK, ZERO = "start", "mark", "zero"
"""Names of quantities that a requirement adds to those of dyads; a law of a four-bar section adds phi0 and psi0."""

DEAD_CENTRES = ("outer dead centre", "inner dead centre")
POSITIONS = 60  # default number of design positions of an expression or a function
FINE = 721  # positions at which a law is checked and its travel computed
GRID = 36  # crank angles at which the transmission of a mechanism other than a four-bar is evaluated
ABSURD = 1e3  # rad; a larger output angle indicates an input error or a pole
TRIAL_STARTS = ((0.3, 0.5), (0.9, 1.2), (1.7, 2.1))
"""Starts [rad], crank and output, at which a law is checked where the start is not known yet."""

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
        ...


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
        """Return the targets as arrays."""
        raise NotImplementedError

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


REQUIREMENTS: Registry[type[Requirement]] = Registry()
"""Classes of requirements by their kind."""


def names_of(stated: Sequence[tuple[str | None, str]]) -> list[str]:
    """Return the names of several requirements, each stated by its name and kind: its kind, numbered from the second one on."""
    kinds = [kind for _, kind in stated]
    counts = [kinds[: k + 1].count(kind) for k, kind in enumerate(kinds)]
    return [name or f"{kind}{count if count > 1 else ''}" for (name, kind), count in zip(stated, counts, strict=True)]


# --- the output follows a law -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LawOf:
    """Names and defaults of a law, by the way in which the linkage is written.

    `start`, `base`: names of the crank angle and of the output at the start; `key`: that of the start in the file; `output`,
    `dead_centre`: defaults; `tied`: whether the output at the start is by default the actual one; `free`: half range of a free
    start angle [rad]; `positions`: least and largest number.
    """

    start: str
    base: str
    key: str
    output: str | None
    dead_centre: str | None
    tied: bool
    free: float
    positions: tuple[int, int]


OF_FOUR_BAR = LawOf("phi0", "psi0", "from", "rocker", DEAD_CENTRES[0], True, TURN, (1, 10_000))
OF_DYADS = LawOf(START, ZERO, "start", None, None, False, math.pi, (2, 400))


def _read_start(raw: object) -> str | Quantity:
    if isinstance(raw, str) and not any(character.isdigit() for character in raw):
        if raw not in DEAD_CENTRES:
            raise Unusable("unknown start", nearest(raw, DEAD_CENTRES) + ', or an angle such as "60 deg"')
        return raw
    return read_quantity(raw, "angle")


TIED = "output at the start"


def _read_base(raw: object, kind: str) -> str | Quantity:
    return TIED if raw == TIED else read_quantity(raw, kind)


class LawRequirement(Requirement):
    """An output follows a law while the crank rotates through a span; base of the kinds with one."""

    if TYPE_CHECKING:  # keys of each kind, or properties of it

        @property
        def law(self) -> Any:
            """The law as the file states it."""

        @property
        def output(self) -> str | None:
            """Output as the file states it."""

        @property
        def start(self) -> str | Quantity | None:
            """Start of the span as the file states it."""

        @property
        def span(self) -> Quantity | None:
            """Crank rotation as the file states it."""

        @property
        def base(self) -> str | Quantity | None:
            """Output at the start of the law as the file states it."""

        @property
        def points(self) -> int | None:
            """Number of positions as the file states it."""

    law_given: ClassVar[bool] = True

    @property
    def family(self) -> str:
        """The kind that measures and shows its designs."""
        return DEFAULT_KIND

    @property
    def timed(self) -> str:
        """Timing: relative to a common start."""
        return "from start"

    @property
    def based(self) -> bool:
        """Whether the law is relative to the output at the start (psi0, s0), not to the frame."""
        return self.law.from_start if isinstance(self.law, Table) else "psi0" in self.law.names

    @property
    def of_frame(self) -> bool:
        """Whether a table defines the start, as it is measured from the frame."""
        return isinstance(self.law, Table) and not self.law.from_start

    @property
    def rotation(self) -> float:
        """Crank rotation [rad] of the law, negative clockwise."""
        return rotation(self.law, self.span)

    def by_rocker(self, problem: Designed) -> bool:
        """Return whether the output is the angle of the rocker of a four-bar, whose place does not matter."""
        loop = problem.four_bar
        if loop is None or self.slides(problem) or problem.frame_angle is None:
            return False
        return self.output_of(problem) == loop.rocker.body and loop.rocker.start == loop.ground_pin

    def of(self, problem: Designed) -> LawOf:
        """Return names and defaults for the way in which the linkage is written."""
        return OF_FOUR_BAR if problem.mechanism.by_lengths and not self.slides(problem) else OF_DYADS

    def task(self, problem: Designed) -> str:
        """Return the name of the search."""
        return "function" if self.by_rocker(problem) else "path"

    def names(self, problem: Designed) -> tuple[str, str]:
        """Return the names of the quantities at the common start: crank angle and output."""
        return self.of(problem).start, self.of(problem).base

    def key_of(self, problem: Designed, name: str) -> str:
        """Return the key of the start angle, or of the output there."""
        of = self.of(problem)
        return of.key if name == of.start else "zero" if self.slides(problem) else "psi0"

    def output_of(self, problem: Designed) -> str:
        """Return the name of the output."""
        return self.output or self.of(problem).output or ""

    def dead_centre(self, problem: Designed) -> str | None:
        """Return the dead centre at which the law starts; None if it starts at a crank angle."""
        if self.start is None and not self.of_frame and not isinstance(self.law, Function):
            return self.of(problem).dead_centre
        return self.start if isinstance(self.start, str) else None

    def tied(self, problem: Designed) -> bool:
        """Return whether the prescribed output at the start is the actual one."""
        if self.base is not None or isinstance(self.law, Function):
            return self.base == TIED
        return self.of(problem).tied or (self.based and self.dead_centre(problem) is not None)

    def loop(self, problem: Designed) -> InnerFourBar | None:
        """Return the four-bar whose rocker is the output; None if there is none."""
        loops = (loop for loop in inner_four_bars(problem.linkage) if loop.plain)
        return next((loop for loop in loops if loop.rocker.body == self.output_of(problem)), None)

    def _limit(self, problem: Designed, values: Mapping[str, Value], *, outer: bool) -> DeadCentre:
        """Return the limit position of the output at which the law starts."""
        loop = self.loop(problem)
        assert loop is not None
        return loop.dead_centre(values, outer=outer)

    def actual(self, problem: Designed, pose: Pose) -> Value:
        """Return the output in a pose: a coordinate [m] or the angle [rad] of a body."""
        output = self.output_of(problem)
        return pose.coordinate(output) if self.slides(problem) else angle(pose.direction(output))

    def quantities(self, problem: Designed) -> dict[str, Quantity]:
        """Return the start angle of the crank and the output there, where they are not derived."""
        of, quantities = self.of(problem), {}
        anywhere = Quantity(0.0, "angle", "deg", -of.free, of.free)
        if isinstance(self.start, Quantity):
            quantities[of.start] = self.start
        elif self.of_frame:
            quantities[of.start] = Quantity(self.law.phi[0], "angle", "deg")
        elif self.dead_centre(problem) is None or isinstance(self.law, Function):
            quantities[of.start] = anywhere
        if isinstance(self.base, Quantity):
            quantities[of.base] = self.base
        elif self.based and self.slides(problem) and not self.tied(problem):
            lengths = [one.value for one in problem.mechanism.quantities.values() if one.kind == "length"]
            far = 10.0 * max([self.travel(problem), *lengths])
            quantities[of.base] = Quantity(0.0, "coordinate", "mm", -far, far)
        elif self.based and not self.tied(problem):
            quantities[of.base] = anywhere
        return quantities

    def start_position(self, problem: Designed, values: Mapping[str, Value]) -> StartPosition:
        """Return the start of the law for given quantities; elementwise, NaN where it does not exist."""
        of, loop = self.of(problem), self.loop(problem)
        if of.start in problem.quantities:
            crank, phi0, rocker = unit(values[of.start]), values[of.start], None
        elif isinstance(self.start, Quantity):  # stated otherwise than by its value
            crank, phi0, rocker = unit(self.start.value), self.start.value, None
        else:
            limit = self._limit(problem, values, outer=self.dead_centre(problem) == DEAD_CENTRES[0])
            crank, phi0, rocker = limit.crank, limit.phi, limit.rocker
        if not self.tied(problem):
            return StartPosition(crank, phi0, values.get(of.base, 0.0))
        if rocker is not None and loop is not None and loop.rocker.start == loop.ground_pin:  # not directed from C to D
            return StartPosition(crank, phi0, angle(rocker))
        return StartPosition(crank, phi0, self.actual(problem, problem.linkage.pose(values, crank)))

    def loaded(self, problem: Designed) -> str:
        """Return the output, see `Requirement.loaded`."""
        return self.output_of(problem)

    def derived(self, problem: Designed, values: Mapping[str, Value]) -> dict[str, Value]:
        """Return the start angle of the crank at a dead centre, and the output there if it is the actual one."""
        of, start = self.of(problem), None
        if of.start not in problem.quantities or self.tied(problem):
            start = self.start_position(problem, values)
        derived = {} if start is None else {of.start: start.phi0}
        return {**derived, of.base: start.psi0} if start is not None and self.tied(problem) else derived

    def is_periodic(self, problem: Designed, name: str) -> bool:
        """Return whether values of an angle a revolution apart are one design; not those that the law contains as such."""
        names = dict(zip(self.names(problem), ("phi0", "psi0"), strict=True))
        return name not in names or is_periodic(self.law, names[name])

    def sense(self, problem: Designed) -> int:
        """Return the sense of crank rotation of a law of a four-bar: that of its span."""
        return (1 if self.rotation > 0.0 else -1) if self.by_rocker(problem) else 0

    def law_of(self, problem: Designed) -> Law:
        """Return the law at its design positions.

        If psi0 is the actual output at the start and the law prescribes just this there, the error is zero by definition, and
        the start position is left out. For a robust design it is kept, as the built linkage deviates there too.
        """
        source, points = self.law, self.points
        begin = int(self.tied(problem) and self.robust is None and begins_at_psi0(source))
        first = source.phi[0] if isinstance(source, Table) and source.from_start else 0.0
        if isinstance(source, Table) and points is None:
            return Law(source, source.offsets[begin:])
        count = points or POSITIONS
        return Law(source, first + (self.rotation - first) * (np.arange(begin, count + 1) / count))

    def travel(self, problem: Designed) -> float:
        """Return the prescribed travel of the output [rad or m], with the crank at its start angle."""
        begin = self.start.value if isinstance(self.start, Quantity) else 0.0
        offsets = np.linspace(problem.law.offsets[0], problem.law.offsets[-1], FINE)
        return float(np.ptp(problem.law.curve(offsets, begin, 0.0)))

    def prescribed(self, problem: Designed, values: Mapping[str, Value], offset: Value, tabulated: Value) -> Value:
        """Return the prescribed output [rad or m] at a crank rotation from the start; elementwise."""
        of = self.of(problem)
        return problem.law.target(offset, tabulated, values[of.start], values.get(of.base, 0.0))

    def size(self, problem: Designed) -> float | None:
        """Return the travel [m] of a slider or a point, else the frame of a four-bar."""
        if self.slides(problem) and (travel := self.travel(problem)) > 0.0:
            return travel
        if problem.four_bar is None:
            return None
        dimensions = {name: quantity.value for name, quantity in problem.mechanism.quantities.items()}
        return float(problem.four_bar.lengths(dimensions)[3]) or None

    def unit(self, problem: Designed) -> str:
        """Return the SI unit of a deviation."""
        return "m" if self.slides(problem) else "rad"

    def width(self, problem: Designed) -> int:
        """Return the number of components of the deviation at one position."""
        return 1

    def data(self, problem: Designed) -> TargetArrays:
        """Return crank rotation and tabulated output of every position."""
        law = problem.law
        return at_positions(np.column_stack([law.offsets, law.tabulated]), law.offsets)

    def deviation(self, problem: Designed, pose: Pose, values: Mapping[str, Value], target: tuple[Value, ...]) -> list[Value]:
        """Return actual minus prescribed coordinate [m] or angle [rad]."""
        prescribed = self.prescribed(problem, values, *target)
        if self.slides(problem):
            return [self.actual(problem, pose) - prescribed]
        return [angle_from(unit(prescribed), pose.direction(self.output_of(problem)))]


class FunctionRequirement(LawRequirement):
    """The output follows a law or a function while the crank rotates through the span."""

    kind: Literal["function"] = "function"
    """Kind of requirement."""
    law: Annotated[Any, in_folder(read_output_law)]
    """Output over crank angle: an expression in phi, phi0, psi0, for a slide `{ slide = "s0 + 40*(1 - cos(phi))", unit = "mm" }`;
    a table of phi and psi, or phi and s, or a CSV file; or a function y(x), with x proportional to the crank angle."""
    output: str | None = None
    """Output of the law: a guide (its slide), a coordinate of a point, `"P.y"`, or a body (its angle); default: the rocker of a
    four-bar."""
    start: Annotated[Any, BeforeValidator(_read_start), Field(validation_alias=AliasChoices("start", "from"))] = None
    """Start of the span, also written `from`: a dead centre of the rocker of a four-bar, or the crank angle, fixed or free;
    default: the outer dead centre of a four-bar (for a function: any angle), any angle of dyads."""
    psi0: Annotated[Any, BeforeValidator(functools.partial(_read_base, kind="angle"))] = None
    """Angle of the output body at the start of a law, or at the least y of a function: fixed, free, or that which the linkage
    has there, `output at the start`; default: that for a law of a four-bar and for a start at a dead centre, else free."""
    zero: Annotated[Any, BeforeValidator(functools.partial(_read_base, kind="coordinate"))] = None
    """Slide at the start of a law (s0), or at the least y of a function: fixed, free, or `output at the start`; default: free."""
    span: FixedAngle | None = None
    """Crank rotation over which an expression applies, negative clockwise; a table or function defines it itself."""
    points: Annotated[int, Field(strict=True, ge=1, le=OF_FOUR_BAR.positions[1])] | None = None
    """Number of evenly spaced positions after the start; default: the rows of a table, else 60."""
    measure: Measure = "sum of squares"
    """Measure that combines all errors into the objective; `max` is the largest error."""

    def ranged(self, problem: Designed) -> bool:
        """Return whether its largest error counts over the whole span: that of a formula."""
        return not isinstance(self.law, Table)

    @property
    def base(self) -> str | Quantity | None:
        """Output at the start of the law as the file states it."""
        base: str | Quantity | None = self.psi0 if self.zero is None else self.zero
        return base

    def slides(self, problem: Designed) -> bool:
        """Return whether the output is a coordinate, of a slider or a point, not the angle of a body."""
        return getattr(self.law, "kind", "angle") == "coordinate"

    def check(self, problem: Designed) -> None:
        """Check output, start and law.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        law, of = self.law, self.of(problem)
        by_rocker = of is OF_FOUR_BAR
        if by_rocker and problem.mechanism.placed:
            message = "a motion law does not depend on the position of the linkage"
            raise Unusable(message, "Leave pivot and direction out", "mechanism.pivot")
        self._check_output(problem)
        check_rotation(law, self.span, of.key, self.start)
        if isinstance(law, Function) and isinstance(self.start, str):
            raise Unusable(
                "the start of a function must be a crank angle, fixed or free",
                f'Write {of.key} = {{ start = "50 deg", bounds = ["0 deg", "180 deg"] }}, or leave it out: '
                "then it is a design variable",
                f"requirement.{of.key}",
                self.start,
            )
        if self.of_frame and self.psi0 is not None:
            message = "a table measured from the frame has no psi0"
            raise Unusable(message, "Leave psi0 out", "requirement.psi0", str(self.psi0))
        least, most = of.positions
        if self.points is not None and not least <= self.points <= most:
            remedy = f"Give a whole number from {least} to {most}, or leave it out"
            raise Unusable("not a number of positions", remedy, "requirement.points", self.points)
        turns = problem.quantities.get(of.start)
        if (
            by_rocker
            and turns is not None
            and max(map(abs, filter(math.isfinite, turns.bounds)), default=0.0) > TURN * (1.0 + 1e-9)
        ):
            message = "the start angle lies beyond one revolution"
            raise Unusable(message, "Give it within -360 deg ... 360 deg", f"requirement.{of.key}", str(turns))
        if by_rocker and problem.limits.pivots is not None:
            message = "a motion law does not depend on the position of the linkage"
            raise Unusable(message, "Leave pivots out", "limits.pivots")
        if problem.limits.crank == "double-crank" and of.start not in problem.quantities:
            remedy = f'Start at an angle: {of.key} = "60 deg"'
            raise Unusable("a double-crank has no dead centres", remedy, f"requirement.{of.key}", self.dead_centre(problem))
        self._check_values(problem)

    def _check_output(self, problem: Designed) -> None:
        """Check that the output exists and that its keys apply to it."""
        linkage, output, of = problem.linkage, self.output_of(problem), self.of(problem)
        slides = self.slides(problem)
        if slides and not linkage.guides and not output:
            remedy = 'Write output = "P.y" for a coordinate of a point, or an angle: law = "psi0 + 0.5*(phi - phi0)"'
            of_function = isinstance(self.law, Function)
            place = ("requirement.law.output", f"{1e3 * self.law.output:g} mm") if of_function else ("requirement.law", None)
            raise Unusable("this linkage has no guide whose slide could follow a law", remedy, *place)
        places = [f"{point}.{axis}" for point in moving_points(linkage) for axis in "xy"]
        outputs = [guide.name for guide in linkage.guides] if slides else [link.body for link in linkage.links[1:]]
        if not slides and output in places:
            message = "a coordinate of a point follows a law with a unit of length"
            raise Unusable(message, f"Write {SLIDE}, or name a body that turns", "requirement.output", output)
        if of.output in outputs and output in outputs and output != of.output:
            message = f"a law of a four-bar by its lengths is one of its {of.output}"
            raise Unusable(message, "Leave output out, or write the linkage as dyads", "requirement.output", output)
        if output not in (*outputs, *(places if slides else ())):
            named = [*outputs, *(places if slides and "." in output else ())]
            example = ' or a coordinate such as "P.y"' if slides else ""
            remedy = nearest(output, named) if output and named else f"Write output = one of: {', '.join(outputs)}{example}"
            what = "guide, or a coordinate of a moving point" if slides else "body that turns"
            raise Unusable(f"the output is the name of a {what}", remedy, "requirement.output", self.output)
        if self.zero is not None and not slides:
            message = "this key applies to a slider or a point only"
            raise Unusable(message, "Write psi0 for the angle of a body", "requirement.zero", str(self.zero))
        if self.psi0 is not None and slides:
            message = "this key applies to a rotating body only"
            raise Unusable(message, "Write zero for a slide or a coordinate", "requirement.psi0", str(self.psi0))
        for key in ("zero", "psi0"):
            if (value := getattr(self, key)) is not None and not self.based and not of.tied:
                remedy = f"Leave it out, or add {'s0' if key == 'zero' else 'psi0'} to the law"
                raise Unusable("the law does not depend on it", remedy, f"requirement.{key}", str(value))
        if self.base == TIED and isinstance(self.law, Function):
            message = "psi0 of a function is the output at its least y, not at the start"
            raise Unusable(message, "Give a value or a range, or leave it out: then it is free", "requirement.psi0", TIED)
        if of is OF_FOUR_BAR:
            return
        if isinstance(self.start, str) and self.loop(problem) is None:
            message = f"{output} is not the rocker of a four-bar with the crank, so its dead centres are not known"
            raise Unusable(message, 'Write start = "60 deg", or leave it out', "requirement.start", self.start)

    def _check_values(self, problem: Designed) -> None:
        """Check that an expression has plausible values over the span for some start, and moves the output."""
        law, (start, base) = self.law, self.names(problem)
        if isinstance(law, Table):
            return
        values = problem.complete({})
        stated = (self.start.value, *filter(math.isfinite, self.start.bounds)) if isinstance(self.start, Quantity) else ()
        begins = stated or ((values[start],) if start not in problem.quantities else ())
        starts = [(float(begin), float(values.get(base, 0.0))) for begin in begins]
        if not starts or not np.all(np.isfinite(starts)):
            starts = [(begin, 0.0 if self.slides(problem) else turned) for begin, turned in TRIAL_STARTS]
        defects = [self._defect(problem, law, begin, turned) for begin, turned in starts]
        if all(defects):
            span, begin = (f"{np.degrees(turned):.6g} deg" for turned in (self.rotation, starts[0][0]))
            message = f"the law {defects[0]} on the span, {span} from {begin} on"
            raise Unusable(message, "Change the law, the span or the start", "requirement.law", law.text)
        if self.of(problem) is not OF_FOUR_BAR and not self.travel(problem) > 1e-9:
            raise Unusable("the law does not move the output", "Change the law", "requirement.law", law.text)

    def _defect(self, problem: Designed, law: Expression | SlideExpression | Function, phi0: float, psi0: float) -> str | None:
        """Return the defect of a law along the span, or None; poles of even order are found near the largest value."""
        low, high = 0.0, 1.0
        for _ in range(5):
            share = np.linspace(low, high, FINE)
            values = {"phi": phi0 + self.rotation * share, "phi0": phi0, "psi0": psi0}
            if worry := law.hazards(values):
                return worry
            size = np.abs(np.asarray(law(values), dtype=float) + 0.0 * share)
            peak, step = float(share[int(np.argmax(size))]), (high - low) / (FINE - 1.0)
            if np.max(size) > ABSURD and not self.slides(problem):
                return f"exceeds {ABSURD:g} rad"
            low, high = max(0.0, peak - 2.0 * step), min(1.0, peak + 2.0 * step)
        return None

    def inapplicable(self, problem: Designed) -> set[str]:
        """Return the keys of the other kind of output, and those of the other way to write a linkage."""
        other = "requirement.psi0" if self.slides(problem) else "requirement.zero"
        return {other, "requirement.output", "limits.pivots"} if self.of(problem) is OF_FOUR_BAR else {other}

    def effective(self, problem: Designed) -> dict[str, str]:
        """Return the effective values of optional keys, for display."""
        rows = f"its {len(self.law.phi)} rows" if isinstance(self.law, Table) else str(POSITIONS)
        values = {"span": f"{math.degrees(self.rotation):g} deg", "points": rows}
        names = dict(zip(self.names(problem), ("start", "zero" if self.slides(problem) else "psi0"), strict=True))
        values |= {key: str(problem.quantities[name]) for name, key in names.items() if name in problem.quantities}
        return values | ({"start": dead} if (dead := self.dead_centre(problem)) and "start" not in values else {})


def check_output(problem: Designed, output: str) -> None:
    """Refuse the name of an output that the linkage does not have.

    Raises
    ------
    Unusable
        with the full key.
    """
    linkage = problem.linkage
    named = [link.body for link in linkage.links[1:]] + [guide.name for guide in linkage.guides]
    places = [f"{point}.{axis}" for point in moving_points(linkage) for axis in "xy"]
    if output not in (*named, *places):
        remedy = nearest(output, places if "." in output else named) if output else f'Write output = "{named[-1]}"'
        message = "the output is the name of a body that turns, of a guide, or a coordinate of a moving point"
        raise Unusable(message, remedy, "requirement.output", output or None)


def check_kind(value: Quantity | Interval | None, key: str, *, slides: bool) -> None:
    """Refuse an angle of a coordinate, and a length of an angle.

    Raises
    ------
    Unusable
        with the full key.
    """
    if value is not None and value.kind != ("coordinate" if slides else "angle"):
        message = "the output is a coordinate, and this is an angle" if slides else "the output is an angle, and this is a length"
        raise Unusable(message, f'Write {key} = "{"12 mm" if slides else "30 deg"}"', f"requirement.{key}", str(value))


def check_no_targets(requirement: Requirement) -> None:
    """Refuse the keys of targets where a requirement is a limit by its nature.

    Raises
    ------
    Unusable
        with the full key.
    """
    for key in ("tolerance", "weight", "scale"):
        if (stated := getattr(requirement, key)) is not None:
            remedy = f'Leave it out; a range is {requirement.limited_by[0]} = ["50 deg", "60 deg"]'
            raise Unusable(f"a {requirement.kind} is a limit without {key}", remedy, f"requirement.{key}", stated)


# --- the output dwells ------------------------------------------------------------------------------------------------------


def _read_over(raw: object) -> tuple[Quantity | None, Quantity]:
    """Read a crank range: the angles of its ends, or its length alone. Return its start, None for any, and its rotation."""
    if isinstance(raw, dict) and set(raw) == {"bounds"}:  # "100..160 deg"
        raw = raw["bounds"]
    if not isinstance(raw, list):
        return None, read_fixed(raw, "angle")
    ends = check_pair(raw, "a crank range is two angles, or its length alone", 'Write ["100 deg", "160 deg"] or "60 deg"')
    begin, end = (read_fixed(one, "angle") for one in ends)
    return begin, replace(end, value=end.value - begin.value)


def _read_output(raw: object) -> Quantity:
    """Read an angle or a coordinate, fixed or free; which of them the output has is checked later."""
    if isinstance(raw, dict) and "equals" in raw:
        raise Unusable("this value cannot be linked to others", 'Give one value, or { bounds = ["30 deg", "40 deg"] }')
    value: Quantity = _of_either_kind(read_quantity, raw)
    return value


def _of_either_kind(read: Callable[[object, str], Any], raw: object) -> Any:
    """Read an angle or a coordinate; the error of something else is that of an angle."""
    try:
        return read(raw, "angle")
    except Unusable as error:
        try:
            return read(raw, "coordinate")
        except Unusable:
            raise error from None


class DwellRequirement(LawRequirement):
    """The output stays within a band while the crank rotates through a range."""

    kind: Literal["dwell"]
    """Kind of requirement."""
    output: str | None = None
    """What dwells: a body (its angle), a guide (its slide) or a coordinate of a point, `"P.y"`; default: the rocker of a
    four-bar."""
    over: Annotated[Any, BeforeValidator(_read_over)]
    """Crank range: the angles of its ends, `["100 deg", "160 deg"]`, the second one smaller for a clockwise crank; or its length
    alone, `"60 deg"`, for a range that begins at `start`."""
    start: Angle | None = None
    """Crank angle at which a range begins that is given by its length, fixed or free; default: any angle."""
    band: Any = None
    """Largest breadth of the band in which the output stays: an angle or a length. The requirement is then a limit; without it,
    half the breadth is minimised."""
    value: Annotated[Any, BeforeValidator(_read_output)] = None
    """Middle of the band, fixed or within bounds; default: any."""

    limited_by: ClassVar[tuple[str, str]] = "band", "breadth"

    @property
    def law(self) -> Expression:
        """The output at the start of the law, whatever the crank angle: the middle of the band."""
        return parse("psi0", ("psi0",))

    @property
    def span(self) -> Quantity:
        """Length of the crank range."""
        span: Quantity = self.over[1]
        return span

    @property
    def base(self) -> Quantity | None:
        """Middle of the band as the file states it."""
        value: Quantity | None = self.value
        return value

    @property
    def points(self) -> None:
        """The default number of positions."""

    @model_validator(mode="after")
    def _begins(self) -> Self:
        if self.start is None:
            vars(self)["start"] = self.over[0]
        return self

    def stated(self, problem: Designed) -> tuple[float, None]:
        """Return factor and offset from a deviation from the middle to the breadth of the band."""
        return 2.0, None

    def ranged(self, problem: Designed) -> bool:
        """Return that the band holds over the whole range."""
        return True

    def of(self, problem: Designed) -> LawOf:
        """Return names and defaults, however the linkage is written."""
        return OF_DYADS

    def by_rocker(self, problem: Designed) -> bool:
        """Return that a dwell is searched like a path."""
        return False

    def key_of(self, problem: Designed, name: str) -> str:
        """Return the key of the start angle, or of the middle of the band."""
        return "start" if name == START else "value"

    def output_of(self, problem: Designed) -> str:
        """Return the name of the output."""
        return self.output or (OF_FOUR_BAR.output if problem.mechanism.by_lengths else None) or ""

    def slides(self, problem: Designed) -> bool:
        """Return whether the output is a coordinate, not the angle of a body."""
        return self.output_of(problem) not in problem.linkage.bodies

    def quantities(self, problem: Designed) -> dict[str, Quantity]:
        """Return the start of a range that is given by its length, and the middle of the band."""
        quantities = super().quantities(problem)
        return quantities if self.over[0] is None else {ZERO: quantities[ZERO]}

    def check(self, problem: Designed) -> None:
        """Check output, range and band.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        if self.tolerance is not None:
            raise Unusable("a dwell has no tolerance", 'Write band = "0.5 deg"', "requirement.tolerance", self.tolerance)
        check_output(problem, self.output_of(problem))
        if self.over[0] is not None and "start" in self.model_fields_set:
            remedy = f'Leave it out, or write over = "{math.degrees(self.rotation):g} deg"'
            raise Unusable("the crank range already states its start", remedy, "requirement.start", str(self.start))
        check_rotation(self.law, self.span, "over", None, "over")
        check_kind(self.value, "value", slides=self.slides(problem))


# --- the output has a place ----------------------------------------------------------------------------------------------


def _read_place(raw: object) -> Interval:
    """Read one value, or a range, of an angle or a coordinate; which of them the output has is checked later."""
    whole = raw["bounds"] if isinstance(raw, dict) and set(raw) == {"bounds"} else raw  # "50..60 deg"
    place: Interval = _of_either_kind(read_interval, whole)
    return place


class PositionRequirement(Requirement):
    """The output has a value, or lies in a range, at a crank angle."""

    kind: Literal["position"]
    """Kind of requirement."""
    output: str | None = None
    """What has the value: a body (its angle), a guide (its slide) or a coordinate of a point, `"P.x"`; default: the rocker of a
    four-bar."""
    at: FixedAngle
    """Crank angle."""
    value: Annotated[Any, BeforeValidator(_read_place)]
    """Value of the output, or its range: an angle or a coordinate; of a coordinate either side may be open."""

    limited_by: ClassVar[tuple[str, str]] = "value", "output"
    secondary: ClassVar[bool] = True

    def output_of(self, problem: Designed) -> str:
        """Return the name of the output."""
        return self.output or (OF_FOUR_BAR.output if problem.mechanism.by_lengths else None) or ""

    def slides(self, problem: Designed) -> bool:
        """Return whether the output is a coordinate, not the angle of a body."""
        return self.output_of(problem) not in problem.linkage.bodies

    @property
    def middle(self) -> float:
        """Middle of the range [m or rad], or its only end."""
        ends = [end for end in (self.value.low, self.value.high) if end is not None]
        return float(sum(ends) / len(ends))

    def stated(self, problem: Designed) -> tuple[float, float]:
        """Return factor and offset from a deviation from the middle to the output."""
        return 1.0, self.middle

    def interval(self, problem: Designed) -> tuple[float, float]:
        """Return the ends of the range, from its middle."""
        low, high = self.value.bounds
        return low - self.middle, high - self.middle

    def unit(self, problem: Designed) -> str:
        """Return the SI unit of a deviation."""
        return "m" if self.slides(problem) else "rad"

    def width(self, problem: Designed) -> int:
        """Return the number of components of the deviation at one position."""
        return 1

    def data(self, problem: Designed) -> TargetArrays:
        """Return the position."""
        return at_positions(np.array([[self.middle]]), np.array([self.at.value]))

    def deviation(self, problem: Designed, pose: Pose, values: Mapping[str, Value], target: tuple[Value, ...]) -> list[Value]:
        """Return the output minus the middle of its range, of an angle within half a turn."""
        output = self.output_of(problem)
        if self.slides(problem):
            return [pose.coordinate(output) - self.middle]
        return [angle_from(unit(self.middle), pose.direction(output))]

    def check(self, problem: Designed) -> None:
        """Check output and range.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        check_no_targets(self)
        check_output(problem, self.output_of(problem))
        slides = self.slides(problem)
        check_kind(self.value, "value", slides=slides)
        low, high = self.value.bounds
        if not slides and not high - low < TURN:
            message = "an angle lies between two values less than a revolution apart"
            raise Unusable(message, 'Write value = ["50 deg", "60 deg"]', "requirement.value", str(self.value))


# --- the output goes to and fro ------------------------------------------------------------------------------------------


class StrokeRequirement(Requirement):
    """An output goes to and fro once per revolution of the crank."""

    kind: Literal["stroke"]
    """Kind of requirement."""
    output: str | None = None
    """Output: a slider or guide (its stroke is a length), a body that swings (an angle), or a point along `direction`; default:
    the rocker of a four-bar."""
    stroke: Any = None
    """Stroke of the output: a length or an angle, a range `[low, high]`, or a table of `min`, `max` or `exactly`."""
    time_ratio: RatioOfStrokes | None = None
    """Duration of the slow stroke divided by that of the quick one at constant crank speed; with `stroke`, that of the stroke
    `"forward"`, `"backward"`, `"slow"` or `"quick"`."""
    direction: FixedAngle | None = None
    """Direction of the stroke of a point, from +x."""

    limited_by: ClassVar[tuple[str, str]] = "stroke", "stroke"
    targeted: ClassVar[bool] = False

    @property
    def limited(self) -> bool:
        """Whether the requirement is a limit: always."""
        return True

    def output_of(self, problem: Designed) -> str:
        """Return the name of the output."""
        return self.output or (OF_FOUR_BAR.output if problem.mechanism.by_lengths else None) or ""

    def bounds(self, problem: Designed) -> Iterator[Bound]:
        """Yield the limits of the stroke and of the time ratio."""
        raw = {"of": self.output_of(problem), "direction": self.direction}
        try:
            term = Limit.model_validate({"quantity": "stroke", **raw, **_sides(self.stroke)})
            check_term(term, problem.linkage, problem.quantities)
            yield Bound("stroke", term, term.interval(problem.linkage, problem.quantities), "requirement.stroke")
        except Unusable as error:  # a plain value has no sides in the file
            side = error.key if isinstance(self.stroke, dict) else ""
            error.key = f"requirement.stroke.{side}".rstrip(".")
            raise
        if (ratio := self.time_ratio) is not None:
            sides = {side: value for side, value in (("min", ratio.low), ("max", ratio.high)) if value is not None}
            term = Limit.model_validate({"quantity": "time ratio", **raw, "stroke": ratio.stroke, **sides})
            yield Bound("time_ratio", term, Interval(ratio.low, ratio.high, None, ""), "requirement.time_ratio")

    def check(self, problem: Designed) -> None:
        """Check that the output exists and can go to and fro.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        check_no_targets(self)
        mechanism = problem.linkage
        guides, bodies = (guide.name for guide in mechanism.guides), (link.body for link in mechanism.links[1:])
        name, names = self.output_of(problem), [*guides, *bodies, *moving_points(mechanism)]
        if name not in names and guide_of(name, mechanism) is None:
            remedy = nearest(name, names) if name else f"Write output = one of: {', '.join(names)}"
            message = "the output is the name of a slider, a body that swings, or a point"
            raise Unusable(message, remedy, "requirement.output", name or None)
        try:
            output_of(Term(quantity="stroke", of=name, direction=self.direction), mechanism)
        except Unusable as error:
            error.key = f"requirement.{error.key.replace('of', 'output')}"
            raise


def _sides(raw: object) -> dict[str, object]:
    """Return a stroke as the bounds of a limit."""
    if raw is None:
        raise Unusable("the stroke is missing", 'Write stroke = "60 deg", or "100 mm" for a slider')
    if isinstance(raw, dict):
        check_keys(raw, SIDES)
        return raw
    if isinstance(raw, list):
        check_pair(raw, "a range is a list of two values, lower and upper", 'Write ["55 deg", "60 deg"]')
        return {"exactly": raw[0]} if raw[0] == raw[1] else dict(zip(SIDES, raw, strict=False))
    return {"exactly": raw}


# --- a point or a body takes positions --------------------------------------------------------------------------------------


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
        anywhere = Quantity(0.0, "angle", "deg", -math.pi, math.pi)
        return {START: self.start or anywhere} if self.timed == "from start" else {}

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
        """Return x, y [m], cosine and sine of every pose, (positions, 4)."""
        assert self.targets.angles is not None
        return np.column_stack([super().columns(), *unit(np.array(self.targets.angles))])

    def deviation(self, problem: Designed, pose: Pose, values: Mapping[str, Value], target: tuple[Value, ...]) -> list[Value]:
        """Return actual minus prescribed x and y, and the angle times `radian` [m]."""
        turned = turn(pose.direction(carrier(problem.linkage, self.point)), unit(values[MARK]))
        return [
            *super().deviation(problem, pose, values, target),
            self.radian(problem) * angle_from((target[2], target[3]), turned),
        ]

    def _check_angles(self, points: TargetPoints) -> None:
        """Refuse points without angles."""
        if points.angles is None:
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


# --- the best transmission --------------------------------------------------------------------------------------------------


class TransmissionRequirement(Requirement):
    """The worst cosine of the transmission angles over a revolution is minimised."""

    kind: Literal["transmission"]
    """Kind of requirement."""
    measure: Measure = "max"
    """Measure that combines the cosines of all positions into the objective; `max` is the largest one."""

    @property
    def by_angle(self) -> bool:
        """Whether the objective is the cosine of one angle."""
        return self.measure == "max"

    separate: ClassVar[bool] = True

    def ranged(self, problem: Designed) -> bool:
        """Return whether the largest cosine counts over the revolution: for a four-bar its extremes, as drawn, are known."""
        return problem.frame_angle is None or self.robust is not None

    def unit(self, problem: Designed) -> str:
        """Return the SI unit of a deviation: none."""
        return ""

    def width(self, problem: Designed) -> int:
        """Return the number of components of the deviation at one position: one for each dyad with a transmission angle."""
        return len(transmitting(problem.linkage))

    def data(self, problem: Designed) -> TargetArrays:
        """Return the crank angles: of a four-bar those of the extreme transmission angles, as drawn."""
        along = problem.frame_angle if self.robust is None or self.measure != "max" else None
        offsets = np.linspace(0.0, TURN, GRID, endpoint=False) if along is None else along + np.array([0.0, math.pi])
        return at_positions(np.zeros((len(offsets), 1)), offsets)

    def deviation(self, problem: Designed, pose: Pose, values: Mapping[str, Value], target: tuple[Value, ...]) -> list[Value]:
        """Return the cosine of the transmission angle of each dyad."""
        return [transmission_cosine(pose, group) for group in transmitting(problem.linkage)]

    def check(self, problem: Designed) -> None:
        """Check that a dyad has a transmission angle over a whole revolution.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        if self.width(problem) == 0:
            message = "no dyad of this mechanism has a transmission angle"
            raise Unusable(message, "Take another requirement", "requirement.kind", self.kind)
        if problem.limits.crank == "span":
            message = "the transmission angle is optimised over a whole revolution"
            raise Unusable(message, 'Write crank = "full rotation"', "limits.crank", "span")


def at_positions(columns: Array, offsets: Array) -> TargetArrays:
    """Return positions of equal weight without tolerances."""
    return TargetArrays(columns, np.ones(len(columns)), offsets, np.full(len(columns), np.inf))


def transmission_cosine(pose: Pose, group: Transmitting) -> Value:
    """Return the cosine of the transmission angle of a group; not a number for two links that cannot close."""
    if not isinstance(group, RRR):
        return group.cosine(pose)
    joint = pose.point(group.joint)
    one, other = (minus(pose.point(pin), joint) for pin in group.outer)
    return dot(one, other) / np.sqrt(dot(one, one) * dot(other, other))


# --- the kinds --------------------------------------------------------------------------------------------------------------

DEFAULT_KIND = "function"
_KINDS = (
    FunctionRequirement,
    PathRequirement,
    MotionRequirement,
    TransmissionRequirement,
    DwellRequirement,
    PositionRequirement,
    StrokeRequirement,
)
for _kind in _KINDS:
    REQUIREMENTS.add(_kind.__annotations__["kind"].__args__[0], _kind)


def _kind_of(raw: object) -> str:
    return str(raw.get("kind", DEFAULT_KIND)) if isinstance(raw, Mapping) else getattr(raw, "kind", DEFAULT_KIND)


if TYPE_CHECKING:
    AnyRequirement = Any  # one of the registered classes
else:
    _tagged = [Annotated[requirement, Tag(kind)] for kind, requirement in REQUIREMENTS.items()]
    AnyRequirement = Annotated[functools.reduce(operator.or_, _tagged), Discriminator(_kind_of)]


def lacks(kind: str, key: str) -> tuple[str, str] | None:
    """Return message and remedy for a key that a kind of requirement does not have, but others have; None for any other key."""
    others = [other for other, requirement in REQUIREMENTS.items() if key in requirement.model_fields]
    return (f"a {kind} has no {key}", f'Leave it out, or write kind = "{others[0]}"') if others else None
