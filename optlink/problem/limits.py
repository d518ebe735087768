"""Limits of design problems, and their crank range: one `LimitTerm` per key of `[limits]` on the dimensions.

An entry contains the formula of the optimiser (`values`, elementwise on floats, arrays and symbols) and, written separately, the
measurement of the validator in motion (`measure`).
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Protocol, Self

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Discriminator, ModelWrapValidatorHandler, Tag, TypeAdapter, model_validator
from pydantic.fields import FieldInfo

from optlink.io import Entry, keeping, without
from optlink.linkage.dyads import transmitting
from optlink.linkage.fourbar import LENGTHS, InnerFourBar, swing, time_ratio
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.motion import Motion
from optlink.linkage.singular import LEAST_ALIGNMENT, LEAST_LENGTH_MARGIN, SMALLEST_ALIGNMENT, SMALLEST_LENGTH_MARGIN
from optlink.linkage.vector2d import Value, Vector
from optlink.problem.base_model import Name, Section
from optlink.problem.mechanism import moving_points
from optlink.problem.quantity import (
    SIDES,
    AngleInterval,
    AnglesOfJoints,
    CoordinateInterval,
    FixedAngle,
    FixedLength,
    Interval,
    JointRanges,
    LargestAnglesOfJoints,
    LengthInterval,
    Number,
    NumberInterval,
    Quantity,
    RatioOfStrokes,
    Unusable,
    below,
    check_pair,
    nearest,
    read_fixed,
    read_positive,
    where,
)
from optlink.problem.terms import Limit

# Regions of the plane that a point must stay in or out of: `[limits] hood = { region = "box", of = "P", x = [...], ... }`.

SHARE = 0.02  # of the larger half width of a box: default clearance outside it
ROUNDING = 1e-12  # share of the size of a problem that is added to a distance, which is then smooth where it vanishes
SHAPES = {
    "box": (("x", "y"), 'x = ["0 mm", "40 mm"], y = ["10 mm", "30 mm"]'),
    "circle": (("centre", "radius"), 'centre = ["40 mm", "20 mm"], radius = "15 mm"'),
    "half-plane": (("through", "direction"), 'through = ["0 mm", "20 mm"], direction = "0 deg"'),
}
"""Keys of each shape, and an example."""


def _read_place(raw: object) -> tuple[Quantity, Quantity]:
    x, y = check_pair(raw, "a place is a list of two coordinates", 'Write ["100 mm", "0 mm"]')
    return read_fixed(x, "coordinate"), read_fixed(y, "coordinate")


class RegionLimit(Section):
    """A region that a point must stay in or out of: a box, a circle or a half-plane."""

    region: Literal["box", "circle", "half-plane"]
    """Shape of the region."""
    of: str
    """The point."""
    side: Literal["outside", "inside"] = "outside"
    """Whether the point stays outside or inside."""
    x: CoordinateInterval | None = None
    """Range of x of a box; default: any."""
    y: CoordinateInterval | None = None
    """Range of y of a box; default: any."""
    centre: Annotated[Any, BeforeValidator(_read_place)] = None
    """Centre of a circle."""
    radius: FixedLength | None = None
    """Radius of a circle."""
    through: Annotated[Any, BeforeValidator(_read_place)] = None
    """A point on the edge of a half-plane."""
    direction: FixedAngle | None = None
    """Direction of the edge of a half-plane, which lies to its left."""
    clearance: Annotated[Quantity | None, BeforeValidator(lambda raw: read_positive(raw, "coordinate"))] = None
    """Least distance from the edge of the region; default: 2 % of the larger half width outside a box, else zero."""
    over: Literal["revolution", "span"] | None = None
    """Crank range over which the limit applies; default: the required rotation."""

    def check(self, linkage: Mechanism, crank: str) -> None:
        """Check that the region has the keys of its shape, and that the point moves.

        Raises
        ------
        Unusable
            with the key below the limit.
        """
        keys, example = SHAPES[self.region]
        stated = self.model_fields_set
        for shape, (others, _) in SHAPES.items():
            if wrong := next((key for key in others if key in stated and key not in keys), None):
                raise Unusable(f"a {self.region} has no {wrong}", f'Leave it out, or write region = "{shape}"', wrong)
        missing = [key for key in keys if getattr(self, key) is None]
        if missing and (self.region != "box" or len(missing) == len(keys)):
            raise Unusable(f"the {self.region} is not complete", f"Add for example {example}", missing[0])
        if self.region == "box" and self.side == "outside":
            for axis in ("x", "y"):
                if (one := getattr(self, axis)) is not None and one.low == one.high:
                    raise Unusable("the box has no breadth", 'Give a range such as ["0 mm", "40 mm"]', axis, str(one))
        if self.of not in (moving := moving_points(linkage)):
            raise Unusable("no moving body has such a point", nearest(self.of, moving), "of", self.of)
        if self.over == "revolution" and crank == "span":
            message = "a crank that need not turn fully has no whole revolution"
            raise Unusable(message, 'Write over = "span", or crank = "full rotation"', "over", self.over)
        if self.side == "inside" and not self.margin < self._half_width:
            message = "the clearance leaves nothing of the region"
            raise Unusable(message, "Give a smaller one, or a larger region", "clearance", str(self.clearance))

    @property
    def box(self) -> tuple[tuple[float, float], ...]:
        """Ranges [m] of x and y of a box, infinite where they are open."""
        return tuple((-math.inf, math.inf) if one is None else one.bounds for one in (self.x, self.y))

    @property
    def _half_width(self) -> float:
        """Least half width [m] of a box, or the radius of a circle."""
        if self.region == "half-plane":
            return math.inf
        return self.radius.value if self.radius is not None else min(0.5 * (high - low) for low, high in self.box)

    @property
    def margin(self) -> float:
        """Least distance [m] from the edge of the region."""
        if self.clearance is not None:
            return self.clearance.value
        halves = [0.5 * (high - low) for low, high in self.box if math.isfinite(high - low)]
        return SHARE * max(halves, default=0.0) if (self.region, self.side) == ("box", "outside") else 0.0

    def label(self, name: str) -> str:
        """Return the name of the limit in tables and checks."""
        return f"{self.of} {self.side} {name}"

    def distances(self, point: Vector, size: float) -> list[Value]:
        """Return distances [m] of a point from the edge, all of them positive on its side; elementwise, smooth beyond the edge.

        `size` [m] is that of the problem. Outside a box the distance is that from its nearest point, which is smooth where the
        largest excess over a side is not; inside it is the negative distance from the nearest side.
        """
        x, y = point
        if self.region == "circle":
            assert self.radius is not None
            u, v = x - self.centre[0].value, y - self.centre[1].value
            away = np.sqrt(u * u + v * v + (ROUNDING * size) ** 2) - self.radius.value
            return [away if self.side == "outside" else -away]
        if self.region == "half-plane":
            assert self.direction is not None
            c, s = math.cos(self.direction.value), math.sin(self.direction.value)
            left = c * (y - self.through[1].value) - s * (x - self.through[0].value)
            return [-left if self.side == "outside" else left]
        bounded = [(value, ends) for value, ends in zip(point, self.box, strict=True) if any(map(math.isfinite, ends))]
        if self.side == "inside":
            sides = [(value - low, high - value, low, high) for value, (low, high) in bounded]
            return [each for one in sides for each, end in zip(one[:2], one[2:], strict=True) if math.isfinite(end)]
        excess = [self._beyond(value, *ends) for value, ends in bounded]
        square = sum(np.maximum(each, 0.0) ** 2 for each in excess)
        inside = excess[0] if len(excess) == 1 else np.maximum(*excess)
        return [np.sqrt(square + (ROUNDING * size) ** 2) + np.minimum(inside, 0.0)]

    @staticmethod
    def _beyond(value: Value, low: float, high: float) -> Value:
        """Return by how much a coordinate lies beyond a range, negative within."""
        if math.isinf(low) or math.isinf(high):
            return low - value if math.isinf(high) else value - high
        return np.abs(value - 0.5 * (low + high)) - 0.5 * (high - low)

    def measured(self, places: Any) -> Any:
        """Return the distances [m] of places (..., 2) from the edge, one array for each straight side of the allowed region.

        They are measured separately from `distances`: from the nearest point of the region, or between it and each side.
        """
        x, y = np.moveaxis(np.asarray(places, dtype=float), -1, 0)
        if self.region == "circle":
            assert self.radius is not None
            away = np.hypot(x - self.centre[0].value, y - self.centre[1].value) - self.radius.value
        elif self.region == "half-plane":
            assert self.direction is not None
            normal = self.direction.value + 0.5 * math.pi
            away = -((x - self.through[0].value) * math.cos(normal) + (y - self.through[1].value) * math.sin(normal))
        else:
            (left, right), (bottom, top) = self.box
            ends = {left: x - left, right: right - x}, {bottom: y - bottom, top: top - y}
            sides = np.stack([away for pair in ends for end, away in pair.items() if math.isfinite(end)])
            if self.side == "inside":
                return sides
            depth = np.min(sides, axis=0)
            away = np.where(depth > 0.0, -depth, np.hypot(x - np.clip(x, left, right), y - np.clip(y, bottom, top)))
        return (away if self.side == "outside" else -away)[None]


MARGINS: dict[str, str | float] = {"alignment": f"{np.degrees(LEAST_ALIGNMENT):g} deg", "length_margin": LEAST_LENGTH_MARGIN}
"""Limits that every design problem has, as the file would state their defaults."""
MARGIN_KEYS = frozenset(f"limits.{key}" for key in MARGINS)
MOST_ALIGNMENT, MOST_LENGTH_MARGIN = np.radians(45.0), 0.1


_LEAST_ALIGNMENT = where(
    lambda angle: SMALLEST_ALIGNMENT * (1.0 - 1e-9) <= angle <= MOST_ALIGNMENT,
    "the least angle from alignment must lie between 0.1 and 45 deg",
    'Write "1 deg", the default, or leave it out',
)
_LENGTH_MARGIN = where(
    lambda share: SMALLEST_LENGTH_MARGIN <= share <= MOST_LENGTH_MARGIN,
    "the length margin, a share of the longest link, lies between 1e-5 and 0.1",
    "Write 1e-4, the default, or leave it out",
)


@dataclass(frozen=True)
class Bound:
    """A limit with its name for display, its bounds [SI], and its key in the problem file."""

    name: str
    term: Limit
    interval: Interval
    key: str


@dataclass(frozen=True)
class TransmissionLimit:
    """Range of the transmission angle at a joint [rad], None for an open side; `key` states it in the file."""

    key: str
    low: float | None
    high: float | None

    @property
    def pressure(self) -> bool:
        """Whether the file states the largest pressure angle, which lies on both sides of 90 deg."""
        return self.key.startswith("limits.pressure_angle")


COUPLER_JOINT = "C"
"""Joint of coupler and rocker of a four-bar."""


class RegionSection(Section):
    """A rectangle of the plane: ranges of x and y."""

    x: CoordinateInterval | None = None
    """Range of x; default: unlimited."""
    y: CoordinateInterval | None = None
    """Range of y; default: unlimited."""


OF_QUANTITY, OF_REGION = "limit of a quantity", "limit of a region"
"""Tags of the limits under names of the user's choice."""


def _named_kind(raw: object) -> str:
    return OF_REGION if isinstance(raw, RegionLimit) or (isinstance(raw, Mapping) and "region" in raw) else OF_QUANTITY


NamedLimit = Annotated[Annotated[Limit, Tag(OF_QUANTITY)] | Annotated[RegionLimit, Tag(OF_REGION)], Discriminator(_named_kind)]


class Limits(Section):
    """Limits of a design problem; further ones, of quantities of the machine and of regions, have names of the user's choice.

    Least distances from positions where a mechanism locks or its assembly modes meet: see `optlink.linkage.singular`.
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[Name, NamedLimit]
    alignment: Annotated[FixedAngle, _LEAST_ALIGNMENT] = Quantity(LEAST_ALIGNMENT, "angle", "deg")
    """Least angle of the two links of a joint from alignment (0 and 180 deg) over the required motion; for a link and a slider,
    from the normal of the slider's line. A tighter transmission limit takes precedence."""
    length_margin: Annotated[Number, _LENGTH_MARGIN] = LEAST_LENGTH_MARGIN
    """Least difference of lengths of a four-bar that must not be equal (Grashof's sums; crank and coupler at an inner dead
    centre), relative to the longest link."""
    crank: Literal["full rotation", "double-crank", "span"] = "full rotation"
    """Crank rotation: full (of a four-bar that is a crank-rocker), that of a double-crank, or over the required span alone."""
    transmission_angle: AnglesOfJoints | None = None
    """Range of the transmission angle of every dyad; of a four-bar, between coupler and rocker. A table states the ranges of
    single dyads by their joints, `{ C = ["45 deg", "135 deg"] }`; `min` and `max` in it apply to the others."""
    pressure_angle: LargestAnglesOfJoints | None = None
    """Largest pressure angle, the difference of the transmission angle from 90 deg. A table states those of single dyads by their
    joints, `{ E = "35 deg" }`. A dyad that one of the two keys names is exempt from the general value of the other."""
    transmission_cosine: NumberInterval | None = None
    """Range of the cosine of the transmission angle; four-bar only."""
    transmission_over: Literal["revolution", "span"] | None = None
    """Crank range over which the transmission angle is limited; default: the required rotation."""
    swing_angle: AngleInterval | None = None
    """Swing of the rocker between its dead centres; crank-rocker only."""
    time_ratio: RatioOfStrokes | None = None
    """Duration of the slow stroke of the rocker divided by that of the other one; with `stroke`, that of the stroke `"forward"`
    (counter-clockwise), `"backward"`, `"slow"` or `"quick"`; crank-rocker only."""
    frame_length: LengthInterval | None = None
    """Length of the frame; four-bar only."""
    link_ratio: NumberInterval | None = None
    """Length of each moving link divided by that of the frame; four-bar only."""
    pivots: RegionSection | None = None
    """Rectangle that contains every point of the frame; not for a law of a four-bar, which has no position."""

    @model_validator(mode="wrap")
    @classmethod
    def _with_names(cls, raw: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Read a table with a quantity as a limit of it, also where its name is that of a key of this section."""
        if not isinstance(raw, Mapping):
            return handler(raw)
        own = {name for name in set(raw) & set(cls.model_fields) if isinstance(raw[name], Mapping) and "quantity" in raw[name]}
        limits = handler(without(raw, *own))
        if own:
            named = TypeAdapter(dict[Name, Limit]).validate_python(keeping(raw, *own))
            every = {**named, **limits._extra}
            limits.__pydantic_extra__ = {name: every[name] for name in raw if name in every}
        return limits

    @property
    def named(self) -> dict[str, Limit]:
        """The limits of quantities of the machine by their names."""
        return {name: limit for name, limit in self._extra.items() if isinstance(limit, Limit)}

    @property
    def regions(self) -> dict[str, RegionLimit]:
        """The regions that points stay in or out of, by their names."""
        return {name: limit for name, limit in self._extra.items() if isinstance(limit, RegionLimit)}

    @property
    def _extra(self) -> dict[str, Limit | RegionLimit]:
        extra = self.__pydantic_extra__
        return dict(extra) if isinstance(extra, dict) else {}  # a copy with other numbers may have none

    @property
    def transmission_range(self) -> str:
        """Crank range over which the transmission angle is limited: "revolution" or "span"."""
        return self.transmission_over or ("span" if self.crank == "span" else "revolution")

    def transmission_at(self, joint: str = COUPLER_JOINT) -> TransmissionLimit | None:
        """Return the limit of the transmission angle at a joint, see `transmission_limit`."""
        general = []
        if (cosine := self.transmission_cosine) is not None:
            angles = (None if end is None else math.acos(end) for end in (cosine.high, cosine.low))
            general.append(TransmissionLimit("limits.transmission_cosine", *angles))
        return transmission_limit(self.transmission_angle, self.pressure_angle, joint, general)

    def transmission_bounds(self, joints: Sequence[str]) -> Iterator[Bound]:
        """Yield the limits of the transmission angle of the dyads with these joints."""
        for joint in joints:
            limit = self.transmission_at(joint)
            if limit is None:
                continue
            if limit.pressure and limit.high is not None:
                most = limit.high - 0.5 * math.pi
                term = Limit(quantity="pressure angle", of=joint, max=_degrees(most))
                yield Bound(f"pressure_angle.{joint}", term, Interval(None, most, "angle", "deg"), limit.key)
                continue
            transmission: dict[str, Any] = {"quantity": "transmission angle", "of": joint}
            if limit.low is not None:
                term = Limit(**transmission, measure="least", min=_degrees(limit.low))
                yield Bound(f"transmission_angle.{joint}.min", term, Interval(limit.low, None, "angle", "deg"), limit.key)
            if limit.high is not None:
                term = Limit(**transmission, measure="largest", max=_degrees(limit.high))
                yield Bound(f"transmission_angle.{joint}.max", term, Interval(None, limit.high, "angle", "deg"), limit.key)


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.12g} deg"


def transmission_limit(
    angle: JointRanges | None, pressure: JointRanges | None, joint: str, further: Sequence[TransmissionLimit] = ()
) -> TransmissionLimit | None:
    """Return the limit of the transmission angle at a joint, that with its name before a general one; None if there is none.

    `angle` and `pressure` are those of the keys `transmission_angle` and `pressure_angle` [rad], `further` other general limits.

    Raises
    ------
    Unusable
        with the key, if there are two.
    """
    result: list[TransmissionLimit] = []
    general: list[TransmissionLimit] = []
    if angle is not None:
        key = "limits.transmission_angle"
        general += [TransmissionLimit(key, angle.low, angle.high)] if angle.plain else []
        result += [TransmissionLimit(f"{key}.{name}", one.low, one.high) for name, one in angle.own if name == joint]
    general += further
    if pressure is not None:
        key, right = "limits.pressure_angle", 0.5 * math.pi
        general += [TransmissionLimit(key, right - pressure.bounds[1], right + pressure.bounds[1])] if pressure.plain else []
        bounds = ((name, one.bounds[1]) for name, one in pressure.own if name == joint)
        result += [TransmissionLimit(f"{key}.{name}", right - most, right + most) for name, most in bounds]
    limits = result or general
    if len(limits) > 1:
        keys = [limit.key.removeprefix("limits.") for limit in limits]
        at = f" at {joint}" if result else ""
        raise Unusable(f"the transmission angle{at} is limited twice", f"Keep {' or '.join(keys)}", limits[-1].key)
    return limits[0] if limits else None


TRANSMISSION_RANGES = (
    ("transmission_angle", (0.0, math.pi), 'Give a range such as ["45 deg", "135 deg"]'),
    ("pressure_angle", (math.radians(0.1), 0.5 * math.pi), 'Give one such as "45 deg"'),
)
"""Ranges that the limits of the transmission angle can have [rad], with remedies."""


def _check_range(name: str, whole: Interval, possible: tuple[float, float], remedy: str) -> None:
    own = whole.own if isinstance(whole, JointRanges) else ()
    for key, interval in ((name, whole), *((f"{name}.{joint}", one) for joint, one in own)):
        for bound in (interval.low, interval.high):
            if bound is not None and not possible[0] <= bound <= possible[1]:
                low, high = map(interval.to_display, possible)
                can = f"from {low} to {high}" if math.isfinite(possible[1]) else f"at least {low}"
                message = f"{interval.to_display(bound)} is out of range; possible values: {can}"
                raise Unusable(message, remedy, f"limits.{key}", str(interval).removeprefix("exactly "))


def check_transmission(angle: JointRanges | None, pressure: JointRanges | None, joints: Sequence[str]) -> None:
    """Refuse limits of the transmission angle that are impossible, contradictory or of a joint that has none.

    `joints` are those of the dyads that have a transmission angle.

    Raises
    ------
    Unusable
        with the full key.
    """
    for whole, (name, possible, remedy) in zip((angle, pressure), TRANSMISSION_RANGES, strict=True):
        if whole is None:
            continue
        _check_range(name, whole, possible, remedy)
        if not joints:
            raise Unusable("no dyad of this mechanism has a transmission angle", "Leave it out", f"limits.{name}")
        for joint, _ in whole.own:
            if joint not in joints:
                remedy = nearest(joint, [*joints, *SIDES[:2]])
                raise Unusable("no dyad has its transmission angle there", remedy, f"limits.{name}.{joint}")
    for joint in joints:
        transmission_limit(angle, pressure, joint)


def check_limits(limits: Limits, linkage: Mechanism, *, four_bar: bool) -> None:
    """Refuse limits that the linkage cannot have, that are physically impossible, or contradict the crank or each other.

    Raises
    ------
    Unusable
        with the full key of the limit.
    """
    joints = [group.joint for group in transmitting(linkage)]
    for key in () if four_bar else four_bar_limits():
        if key in limits.model_fields_set:
            remedy = "Leave it out, and bound the lengths themselves"
            raise Unusable("this limit applies to a four-bar only", remedy, f"limits.{key}")
    for name, region in limits.regions.items():
        with below(f"limits.{name}"):
            region.check(linkage, limits.crank)
    if limits.crank == "double-crank" and not four_bar:
        raise Unusable("only a four-bar can be a double-crank", 'Write crank = "full rotation"', "limits.crank", limits.crank)
    if limits.transmission_cosine is not None:
        remedy = "Give a range such as [-0.7071, 0.7071]"
        _check_range("transmission_cosine", limits.transmission_cosine, (-1.0, 1.0), remedy)
    for term, interval in limits_in_file(limits):
        _check_range(term.name, interval, term.possible, f"Give a range such as {term.example}")
    check_transmission(limits.transmission_angle, limits.pressure_angle, joints)
    for joint in joints:
        limits.transmission_at(joint)
    for term, _ in limits_in_file(limits) if limits.crank != "full rotation" else ():
        if term.crank_rocker:
            remedy = 'Set limits.crank = "full rotation", or leave the limit out'
            raise Unusable("this limit applies to a crank-rocker only", remedy, term.key)
    if limits.crank == "span" and limits.transmission_over == "revolution":
        message = "a crank that need not turn fully has no whole revolution"
        remedy = 'Write transmission_over = "span", or crank = "full rotation"'
        raise Unusable(message, remedy, "limits.transmission_over", "revolution")


@dataclass(frozen=True)
class Reach:
    """Crank range of a requirement."""

    start: Value
    """Crank angle at which it begins [rad]."""
    span: Value
    """Crank rotation from there [rad], negative clockwise."""
    sense: Value
    """Sign of the span."""


# --- registered limits ---------------------------------------------------------------------------------------------------


class Moved(Protocol):
    """A design in motion, as a validator measures it."""

    mechanism: Mechanism
    """The mechanism."""
    design: dict[str, float]
    """Sizes by name [m, rad]."""
    lengths: tuple[float, float, float, float]
    """Lengths [m] of crank, coupler, rocker and frame of a four-bar."""

    @property
    def required(self) -> Motion:
        """The motion over which the mechanism must be assembled."""

    def strokes(self) -> tuple[float, float, float]:
        """Return the swing angle of the rocker and the crank rotation of its forward and backward strokes [rad], or NaN."""


@dataclass(frozen=True)
class LimitTerm(Entry):
    """A limit of a design problem: a key of `[limits]`.

    Parameters
    ----------
    name : str
        The key.
    form : AngleInterval, LengthInterval or NumberInterval
        Type of its value, which says its unit: `AngleInterval`, `LengthInterval`, `NumberInterval`.
    values : function of (problem, sizes [m, rad], reach, interval)
        Yields the label and the value [rad, m or -] of each row, elementwise. The problem is a `DesignProblem`; the interval, an
        `Interval`, is that of the file.
    measure : function of (moved, interval)
        Yields the name and the value [rad, m or -] of each check; `moved` is the design in motion.
    about : str
        Description for the reference of problem files.
    possible : (float, float) [rad, m or -]
        Range outside which no limit makes sense, with an `example` for the error message.
    four_bar : bool
        Whether only a four-bar has it.
    crank_rocker : bool
        Whether only a crank-rocker has it.
    """

    name: str
    form: Any
    values: Callable[[Any, Mapping[str, Value], Reach, Any], Iterable[tuple[str, Value]]]
    measure: Callable[[Moved, Any], Iterable[tuple[str, float]]]
    about: str = ""
    possible: tuple[float, float] = (-math.inf, math.inf)
    example: str = ""
    four_bar: bool = True
    crank_rocker: bool = False

    @property
    def key(self) -> str:
        """Key in the problem file."""
        return f"limits.{self.name}"

    def fault(self) -> tuple[str, str] | None:
        """Refuse a key that `[limits]` has."""
        return (f"{self.key} is a key of problem files", "Choose another name") if self.name in Limits.model_fields else None

    def entered(self) -> None:
        """Add the key to the models of problem files."""
        Limits.model_fields[self.name] = FieldInfo(annotation=self.form | None, default=None, description=self.about)
        for model in MODELS:
            model.model_rebuild(force=True)


LIMITS: dict[str, LimitTerm] = LimitTerm.registry
MODELS: list[type[Section]] = [Limits]
"""Models whose schema contains the limits, the inner ones first."""


def limits_in_file(limits: Limits) -> Iterator[tuple[LimitTerm, Interval]]:
    """Yield the registered limits that a file states, with their bounds."""
    for term in LIMITS.values():
        interval = getattr(limits, term.name, None)
        if interval is not None:
            yield term, interval


def four_bar_limits() -> tuple[str, ...]:
    """Return the keys of limits that only a four-bar has."""
    return ("length_margin", "transmission_cosine", *(term.name for term in LIMITS.values() if term.four_bar))


def stroke_ratio(forward: float, backward: float, stroke: str | None) -> float:
    """Return the time ratio of strokes of these crank rotations [rad] at constant speed; NaN if one of them takes no time.

    `stroke` is the one in the numerator, None the slow one.
    """
    if not min(forward, backward) > 0.0:
        return math.nan
    if stroke in ("forward", "backward"):
        return forward / backward if stroke == "forward" else backward / forward
    quick, slow = sorted((forward, backward))
    return quick / slow if stroke == "quick" else slow / quick


def _swing(loop: InnerFourBar, sizes: Mapping[str, Value]) -> Value:
    return swing(*loop.lengths(sizes), loop.side)


def _time_ratio(loop: InnerFourBar, sizes: Mapping[str, Value], limit: RatioOfStrokes, sense: Value) -> Value:
    """Return the time ratio; where both strokes are to be equal, that of the forward stroke, which has no kink there."""
    return time_ratio(*loop.lengths(sizes), loop.side, "forward" if _equal_strokes(limit) else limit.stroke, sense)


def _equal_strokes(limit: RatioOfStrokes) -> bool:
    """Return whether a limit prescribes a time ratio of 1; its sides may be arrays (designs,)."""
    return all(side is not None and bool(np.all(np.asarray(side) == 1.0)) for side in (limit.low, limit.high))


def _ratios(lengths: Sequence[Value]) -> list[tuple[str, Value]]:
    """Return the lengths of crank, coupler and rocker over that of the frame, with their names."""
    return [(f"{name} / frame", length / lengths[3]) for name, length in zip(LENGTHS[:3], lengths[:3], strict=True)]


def _ratio_label(limit: Any) -> str:
    strokes = limit.strokes if limit.stroke else "equal strokes" if _equal_strokes(limit) else ""
    return f"time ratio, {strokes}".removesuffix(", ")


_BUILT_IN = (  # their keys, with their descriptions, are those of `Limits`
    LimitTerm(
        "swing_angle",
        AngleInterval,
        lambda problem, sizes, reach, _: [("swing angle of the rocker", _swing(problem.four_bar, sizes))],
        lambda moved, _: [("swing angle", moved.strokes()[0])],
        possible=(0.0, math.pi),
        example='["30 deg", "60 deg"]',
        crank_rocker=True,
    ),
    LimitTerm(
        "time_ratio",
        RatioOfStrokes,
        lambda problem, sizes, reach, limit: [(_ratio_label(limit), _time_ratio(problem.four_bar, sizes, limit, reach.sense))],
        lambda moved, limit: [(_ratio_label(limit), stroke_ratio(*moved.strokes()[1:], limit.stroke))],
        crank_rocker=True,
    ),
    LimitTerm(
        "frame_length",
        LengthInterval,
        lambda problem, sizes, reach, _: [("frame length", problem.four_bar.lengths(sizes)[3])],
        lambda moved, _: [("frame length", moved.lengths[3])],
    ),
    LimitTerm(
        "link_ratio",
        NumberInterval,
        lambda problem, sizes, reach, _: _ratios(problem.four_bar.lengths(sizes)),
        lambda moved, _: _ratios(moved.lengths),
        possible=(0.0, math.inf),
        example="[0.2, 5.0]",
    ),
)
LIMITS |= {term.name: term for term in _BUILT_IN}
