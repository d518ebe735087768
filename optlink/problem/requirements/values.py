"""Requirements of values: an output dwells, has a place, goes to and fro; the transmission angle is the best one."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import BeforeValidator, model_validator

from optlink.linkage.dyads import RRR, Transmitting, transmitting
from optlink.linkage.mechanism import Pose
from optlink.linkage.vector2d import TURN, Value, angle_from, dot, minus, unit
from optlink.problem.limits import Bound
from optlink.problem.mechanism import moving_points
from optlink.problem.quantity import (
    SIDES,
    Angle,
    FixedAngle,
    Interval,
    Quantity,
    RatioOfStrokes,
    Unusable,
    check_keys,
    check_pair,
    nearest,
    read_fixed,
    read_interval,
    read_quantity,
)
from optlink.problem.requirements.base import START, ZERO, Designed, Measure, Requirement, TargetArrays, at_positions
from optlink.problem.requirements.laws import OF_DYADS, OF_FOUR_BAR, LawOf, LawRequirement
from optlink.problem.targets.expression import Expression, parse
from optlink.problem.targets.law import check_rotation
from optlink.problem.terms import Limit, Term, check_term, guide_of, output_of

GRID = 36  # crank angles of a revolution at which assembly and transmission of a mechanism other than a four-bar are evaluated


def check_output(problem: Designed, output: str) -> None:
    """Refuse the name of an output that the linkage does not have.

    Raises
    ------
    Unusable
        with the full key.
    """
    linkage = problem.linkage
    named = [body for body in linkage.bodies if body != linkage.crank.body] + [guide.name for guide in linkage.guides]
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


def _stated_output(self: Any, problem: Designed) -> str:
    """Return the name of the output; default: the rocker of a four-bar."""
    return self.output or (OF_FOUR_BAR.output if problem.mechanism.by_lengths else None) or ""


# --- the output dwells -----------------------------------------------------------------------------------------------------


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
    centred: ClassVar[bool] = True

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

    output_of: ClassVar = _stated_output

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


# --- the output has a place ------------------------------------------------------------------------------------------------


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

    output_of: ClassVar = _stated_output

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


# --- the output goes to and fro --------------------------------------------------------------------------------------------


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

    output_of: ClassVar = _stated_output

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


# --- the best transmission -------------------------------------------------------------------------------------------------


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
        turns = problem.linkage.limits is None
        offsets = (
            np.linspace(*problem.linkage.extent, GRID, endpoint=not turns) if along is None else along + np.array([0.0, math.pi])
        )
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


def transmission_cosine(pose: Pose, group: Transmitting) -> Value:
    """Return the cosine of the transmission angle of a group; not a number for two links that cannot close."""
    if not isinstance(group, RRR):
        return group.cosine(pose)
    joint = pose.point(group.joint)
    one, other = (minus(pose.point(pin), joint) for pin in group.outer)
    return dot(one, other) / np.sqrt(dot(one, one) * dot(other, other))
