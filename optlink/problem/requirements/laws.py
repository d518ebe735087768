"""Requirements of a law: an output follows it while the crank rotates through a span."""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AliasChoices, BeforeValidator, Field

from optlink.linkage.fourbar import DeadCentre, InnerFourBar, inner_four_bars
from optlink.linkage.mechanism import Pose
from optlink.linkage.vector2d import TURN, Value, all_finite, angle, angle_from, unit
from optlink.problem.base_model import in_folder
from optlink.problem.mechanism import moving_points, sizes_of
from optlink.problem.quantity import FixedAngle, Quantity, Unusable, nearest, read_quantity
from optlink.problem.requirements.base import (
    DEFAULT_KIND,
    START,
    ZERO,
    Designed,
    Measure,
    Requirement,
    StartPosition,
    TargetArrays,
    at_positions,
)
from optlink.problem.targets.expression import Expression
from optlink.problem.targets.law import (
    SLIDE,
    Function,
    Law,
    SlideExpression,
    Table,
    begins_at_psi0,
    check_rotation,
    is_periodic,
    read_output_law,
    rotation,
)

DEAD_CENTRES = ("outer dead centre", "inner dead centre")
POSITIONS = 60  # default number of design positions of an expression or a function
FINE = 721  # positions at which a law is checked and its travel computed
ABSURD = 1e3  # rad; a larger output angle indicates an input error or a pole
TRIAL_STARTS = ((0.3, 0.5), (0.9, 1.2), (1.7, 2.1))
"""Starts [rad], crank and output, at which a law is checked where the start is not known yet."""


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
        turning = problem.mechanism.by_lengths and problem.linkage.limits is None
        return OF_FOUR_BAR if turning and not self.slides(problem) else OF_DYADS

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
        of = OF_FOUR_BAR if problem.mechanism.by_lengths and not self.slides(problem) else OF_DYADS
        return self.output or of.output or ""

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
        if isinstance(self.start, Quantity):
            quantities[of.start] = self.start
        elif self.of_frame:
            quantities[of.start] = Quantity(self.law.phi[0], "angle", "deg")
        elif self.dead_centre(problem) is None or isinstance(self.law, Function):
            quantities[of.start] = self.any_start(problem, of.free)
        if isinstance(self.base, Quantity):
            quantities[of.base] = self.base
        elif self.based and self.slides(problem) and not self.tied(problem):
            lengths = [one.value for one in problem.mechanism.quantities.values() if one.kind == "length"]
            far = 10.0 * max([self.travel(problem), *lengths])
            quantities[of.base] = Quantity(0.0, "coordinate", "mm", -far, far)
        elif self.based and not self.tied(problem):
            quantities[of.base] = Quantity(0.0, "angle", "deg", -of.free, of.free)
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

    def rotations(self, problem: Designed) -> tuple[float, float]:
        """Return the least and largest crank rotation [rad] from the start."""
        return min(self.rotation, 0.0), max(self.rotation, 0.0)

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
        return float(problem.four_bar.lengths(sizes_of(problem.mechanism.quantities))[3]) or None

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
    spacing: Literal["even", "chebyshev"] = "even"
    """Spacing of the positions: even, with one more at the start; or `chebyshev`, that of the zeros of a Chebyshev polynomial,
    all of them within the range: the error between 3 to 5 precision points is nearly the least."""
    measure: Measure = "sum of squares"
    """Measure that combines all errors into the objective; `max` is the largest error."""
    exact: bool = False
    """Whether only designs that meet three to five positions exactly are wanted, without a search: all, or the best."""

    def law_of(self, problem: Designed) -> Law:
        """Return the law at its design positions, see `LawRequirement.law_of`; those of Chebyshev lie within the range."""
        if self.spacing == "even":
            return super().law_of(problem)
        count = self.points or (len(self.law.phi) if isinstance(self.law, Table) else POSITIONS)
        first = self.law.phi[0] if isinstance(self.law, Table) and self.law.from_start else 0.0
        shares = 0.5 - 0.5 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
        return Law(self.law, first + (self.rotation - first) * shares)

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
        outputs = [guide.name for guide in linkage.guides] if slides else [b for b in linkage.bodies if b != linkage.crank.body]
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
        if not starts or not all_finite(starts):
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
