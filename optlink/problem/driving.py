"""How the drive of a file moves its linkage: drives and limits of the mechanism, and the rate of its cycle variable."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TypeVar

import numpy as np

from optlink.linkage.bodies import FRAME
from optlink.linkage.elements import Drive
from optlink.linkage.laws import Law, MotionLaw, Piece
from optlink.linkage.mechanism import Mechanism, Size
from optlink.linkage.stroke import reachable
from optlink.linkage.trains import Single, Train
from optlink.linkage.vector2d import TURN, Array
from optlink.problem.elements import geared
from optlink.problem.machine.bodies import SLOWNESS, STATIC, DriveMotion, DriveSection
from optlink.problem.mechanism import DyadsSection, FourBarSection
from optlink.problem.quantity import Unusable, check_name
from optlink.units import show

Position = TypeVar("Position", float, Array)
HALF = math.pi
"""Cycle variable [rad] from one end of the stroke of a slide or cylinder to the other."""


@dataclass(frozen=True)
class Driving:
    """A mechanism as it is driven: with the rate [rad/s] of the crank angle, or of the cycle variable, and its first value [rad].

    A crank at constant speed is its own cycle variable. Of a slide or cylinder it goes from 0 to pi while the drive moves through
    its range, of laws by a revolution in the time after which they repeat.
    """

    mechanism: Mechanism
    pace: float
    first: float
    ends: tuple[float, float] | None = None
    """Slides or lengths [m] of a single drive along a line at the ends of its stroke."""

    def of(self, sizes: Mapping[str, float]) -> Driving:
        """Return it for other dimensions [m, rad]: those of a cylinder can be the ends of the stroke."""
        return self if self.ends is None else replace(self, ends=_stroke_ends(self.mechanism.drives[0], sizes))

    def place(self, position: Position) -> Position:
        """Return the slide or length [m] of a drive along a line at a value of the cycle variable [rad]."""
        assert self.ends is not None
        return self.ends[0] + (self.ends[1] - self.ends[0]) * position / HALF

    @property
    def lever(self) -> float:
        """Way of a drive along a line per change of the cycle variable [m/rad]; 1 for a crank."""
        return 1.0 if self.ends is None else (self.ends[1] - self.ends[0]) / HALF

    def text(self, position: float) -> str:
        """Return a crank angle, or a value of the cycle variable [rad], as a designer calls it: "crank angle 30 deg"."""
        return f"{self.coordinate} {self.shown(position):.6g} {self.unit}"

    def texts(self, positions: Array) -> str:
        """Return several positions as `text` does one, the first six of them."""
        places = ", ".join(f"{place:.6g}" for place in np.asarray(self.shown(positions))[:6].tolist())
        return f"{self.coordinate} {places}{' ...' if len(positions) > 6 else ''} {self.unit}"

    def shown(self, position: Position) -> Position:
        """Return a crank angle, or the slide or length at a value of the cycle variable [rad], in `unit`."""
        return math.degrees(1.0) * position if self.ends is None else 1e3 * self.place(position)

    def at(self, shown: Position) -> Position:
        """Return the crank angle, or the value of the cycle variable [rad], at a position in `unit`."""
        if self.ends is None:
            return math.radians(1.0) * shown
        return HALF * (1e-3 * shown - self.ends[0]) / (self.ends[1] - self.ends[0])

    @property
    def whole(self) -> str:
        """What counts of the motion: a revolution, a cycle of laws, a range, a stroke, or the motion of a law that ends."""
        if self.mechanism.limits is None:
            return "per cycle" if self.mechanism.drives else "per revolution"
        return "over the motion" if not self.mechanism.returns else "over the range" if self.ends is None else "over the stroke"

    @property
    def unit(self) -> str:
        """Display unit of the positions of the drive."""
        return "deg" if self.ends is None else "mm"

    @property
    def noun(self) -> str:
        """What the positions of the drive are in short: angles of a crank or a lever, cycle angles of laws, slides, lengths."""
        if self.ends is None:
            return "cycle angle" if self.mechanism.drives else "crank angle" if self.mechanism.limits is None else "angle"
        return "length" if self.mechanism.drives[0].size else "slide"

    @property
    def coordinate(self) -> str:
        """What the positions of the drive are: crank angles, the angle of a lever, a slide, the length of a cylinder."""
        if self.ends is None:
            return f"angle of {self.mechanism.crank.body}" if self.noun == "angle" else self.noun
        return f"{self.noun} of {self.mechanism.drives[0].body}"

    @property
    def datum(self) -> str:
        """The line from which a crank angle is measured, in words; empty for other drives."""
        if self.ends is not None or self.mechanism.drives:
            return ""
        return "the x axis" if self.mechanism.datum == 0.0 else "A → D"

    @property
    def column(self) -> str:
        """Name of a column of positions of the drive: "crank_angle_deg", "length_mm"."""
        return "crank_angle_deg" if self.noun == "angle" else f"{self.noun.replace(' ', '_')}_{self.unit}"

    @property
    def reach(self) -> str:
        """The range of the drive in words: "crank angle 0 ... 90 deg"; empty for a crank that turns."""
        if self.mechanism.limits is None:
            return ""
        low, high = (f"{self.shown(end):.6g}" for end in self.mechanism.limits)
        return f"{self.coordinate} {low} ... {high} {self.unit}"


def driven(
    section: FourBarSection | DyadsSection,
    name: str,
    drive: DriveSection,
    drives: Mapping[str, DriveMotion],
    sizes: Mapping[str, float],
) -> Driving:
    """Return the mechanism of a section as its drive, or several `drives`, move it; `sizes` [m, rad] are those of the file.

    Raises
    ------
    Unusable
        with the full key of the cause.
    """
    if drives:
        return _several(section, name, drives, sizes)
    if drive.law is not None and (drive.slide or drive.cylinder):
        return _several(section, name, {INPUT: drive}, sizes)
    if drive.linear:
        return _along(section, name, drive, sizes)
    if drive.against != FRAME:
        raise Unusable(
            "a single drive acts from the frame",
            "Leave it out, or state all drives under [drives]",
            "drive.against",
            drive.against,
        )
    mechanism = section.linkage(name, drive.body)
    if drive.law is not None or drive.acceleration is not None:
        crank = mechanism.crank
        law = law_of(drive, "drive", "angle") if drive.acceleration is None else _accelerated(drive)
        pace, limits = _timed({INPUT: law})
        element = Drive(INPUT, "angle", crank.body, mechanism.datum, None, law, 1.0 / pace)
        trains = (Train((Single(crank, crank.start),), (element,)), *mechanism.trains)
        mechanism = replace(mechanism, trains=trains, drives=(element,), limits=limits)
        return Driving(geared(mechanism, sizes), pace, 0.0)
    mechanism = geared(mechanism, sizes)
    pace = drive.speed.value
    if drive.range is None:
        return Driving(mechanism, pace, drive.start.value)
    low, high = (end.value for end in drive.range)
    first = _start(drive, low, high)
    return Driving(replace(mechanism, limits=(low, high)), pace, first)


def _start(drive: DriveMotion, low: float, high: float, key: str = "drive") -> float:
    """Return the position at which the motion through a range begins; by default the end from which the drive moves."""
    if "start" not in drive.model_fields_set:
        return low if drive.speed.value > 0.0 else high
    start, slack = drive.start.value, 1e-9 * (high - low)
    if not low - slack <= start <= high + slack:
        assert drive.range is not None
        raise Unusable(
            "the drive starts outside its range",
            f"Start from {drive.range[0]} to {drive.range[1]}",
            f"{key}.start",
            str(drive.start),
        )
    return start


# --- slides and cylinders -----------------------------------------------------------------------------------------------------

INPUT = "input"
"""Name of the drive of a machine with one drive."""
USUAL = 0.1
"""Speed of a slide or cylinder without a stated one [m/s]."""
ASIDE = 1e-3
"""Share of the range of a slide that is left out at either end if the file states none: speeds are infinite where it ends."""


def _along(section: FourBarSection | DyadsSection, name: str, drive: DriveSection, sizes: Mapping[str, float]) -> Driving:
    """Return the mechanism that a slide or a cylinder drives through its range."""
    if not isinstance(section, DyadsSection) or not (section.guides or section.cylinders):
        key, stated = drive.stated_linear
        message, remedy = "the linkage has no guide and no cylinder that a drive could move", "Give angles and angular velocities"
        raise Unusable(message, remedy, f"drive.{key}", stated)
    element = linear_drive(section, INPUT, drive, "drive", sizes)
    if element.end is None:
        element = _reaching(section, name, drive, element, sizes)
    ends = _stroke_ends(element, sizes)
    mechanism = geared(replace(section.linkage(name, "", (element,)), limits=(0.0, HALF)), sizes)
    speed = drive.speed.value if "speed" in drive.model_fields_set else USUAL
    if drive.speed.kind not in ("velocity", STATIC) and "speed" in drive.model_fields_set:
        raise Unusable("the drive moves along a line", 'Give a speed such as "100 mm/s"', "drive.speed", str(drive.speed))
    pace = SLOWNESS if drive.speed.kind == STATIC else speed * HALF / (ends[1] - ends[0])
    first = 0.0 if pace >= 0.0 else HALF
    for key, of in (("start", drive.start), *(("range", end) for end in drive.range or ())):
        if key in drive.model_fields_set and of.kind != "coordinate":
            raise Unusable("the drive moves along a line", 'Give positions such as "250 mm"', f"drive.{key}", str(of))
    if "start" in drive.model_fields_set:
        first = HALF * (drive.start.value - ends[0]) / (ends[1] - ends[0])
        if not -1e-9 <= first <= HALF + 1e-9:
            low, high = (f"{1e3 * end:.6g} mm" for end in ends)
            raise Unusable("the drive starts outside its range", f"Start from {low} to {high}", "drive.start", str(drive.start))
    return Driving(mechanism, pace, first, ends)


def _stroke_ends(element: Drive, sizes: Mapping[str, float]) -> tuple[float, float]:
    """Return the slides or lengths [m] at the ends of the stroke of a drive."""
    begin, end = (sizes[end] if isinstance(end, str) else float(end or 0.0) for end in (element.begin, element.end))
    return begin, end


def linear_drive(section: DyadsSection, name: str, drive: DriveMotion, key: str, sizes: Mapping[str, float]) -> Drive:
    """Return the drive of a slide or cylinder; without an end if the file states no range of a slide.

    Raises
    ------
    Unusable
        with the full key of the cause.
    """
    stated = None if drive.range is None else (drive.range[0].value, drive.range[1].value)
    if drive.cylinder is not None or drive.body in section.cylinders:
        cylinder = str(drive.cylinder or drive.body)
        check_name(cylinder, section.cylinders, "no such cylinder", f"{key}.cylinder")
        stroke = f"{cylinder}.closed", f"{cylinder}.open"
        ends = stated or stroke
        for length, of in zip(stated or (), ("closed", "open"), strict=False):
            low, high = sizes[f"{cylinder}.closed"], sizes[f"{cylinder}.open"]
            if not low * (1.0 - 1e-9) <= length <= high * (1.0 + 1e-9):
                message = f"the cylinder has lengths from {1e3 * low:.6g} to {1e3 * high:.6g} mm"
                raise Unusable(message, f"Change range, or {of} of the cylinder", f"{key}.range", f"{1e3 * length:.6g} mm")
        return Drive(name, "length", cylinder, ends[0], ends[1], size=f"{cylinder}.length", rod=f"{cylinder}.rod", stroke=stroke)
    guide = _guide(section, drive, key)
    begin, end = stated or (0.0, None)
    return Drive(name, "slide", section.guides[guide].slider, begin, end, against=section.guides[guide].on)


def _guide(section: DyadsSection, drive: DriveMotion, key: str) -> str:
    """Return the name of the guide along which a drive acts: the stated one, or that of the driven body."""
    if drive.slide is not None:
        check_name(drive.slide, section.guides, "no such guide", f"{key}.slide")
        name = drive.slide
    else:
        names = [name for name, guide in section.guides.items() if guide.slider == drive.body]
        if len(names) != 1:
            stated, value = drive.stated_linear
            message = (
                f"the drive moves along a line, and {drive.body or 'its body'} slides in {'several' if names else 'no'} guide"
            )
            remedy = f"Give an angle or angular velocity, or slide = one of: {', '.join(section.guides)}"
            raise Unusable(f"{message}{'s' * bool(names)}", remedy, f"{key}.{stated}", value)
        name = names[0]
    guide = section.guides[name]
    if guide.on != FRAME and drive.against == FRAME:
        pins = [section.links[body].joints[0] for body in (guide.on, guide.slider) if section.links[body].joints]
        message = f"{guide.slider} slides on {guide.on}, which moves: barrel and rod of a cylinder are one element"
        ends = ", ".join(f'"{pin}"' for pin in pins)
        remedy = (
            f"Write [mechanism.cylinders] {name} = {{ joints = [{ends}], closed = ..., open = ... }} instead of the two bodies "
            f'and their guide, and drive.cylinder = "{name}"'
        )
        raise Unusable(message, remedy, f"{key}.slide", name)
    return name


def _reaching(section: DyadsSection, name: str, drive: DriveSection, element: Drive, sizes: Mapping[str, float]) -> Drive:
    """Return the drive of a slide with the range in which the linkage can be assembled, as the file states none."""
    far = sum(abs(size) for size in sizes.values()) or 1.0
    wide = replace(element, begin=-far, end=far)
    ranges = reachable(replace(section.linkage(name, "", (wide,)), limits=(0.0, HALF)), sizes).ranges
    places = [tuple(far * (2.0 * end / HALF - 1.0) for end in ends) for ends in ranges]
    if "start" in drive.model_fields_set:
        places = [ends for ends in places if ends[0] <= drive.start.value <= ends[1]]
    text = " or ".join(f"{1e3 * low:.6g} ... {1e3 * high:.6g} mm" for low, high in places)
    if len(places) != 1:
        message = f"the slide can move in several ranges: {text}" if places else "the linkage cannot be assembled there"
        raise Unusable(message, 'State one of them: range = ["0 mm", "250 mm"], or a start within it', "drive.range")
    ((low, high),) = places
    edge = ASIDE * (high - low)
    return replace(element, begin=low + edge, end=high - edge)


def check_design_drive(section: FourBarSection | DyadsSection, drive: DriveSection) -> None:
    """Refuse a drive of a design problem whose range or speed would differ from design to design.

    Raises
    ------
    Unusable
        with the full key of the cause.
    """
    if not drive.linear or drive.range is not None or not isinstance(section, DyadsSection):
        return
    cylinder = section.cylinders.get(str(drive.cylinder or drive.body))
    if cylinder is None:
        message = "the slide moves as far as the linkage lets it, which the design variables change"
        raise Unusable(message, 'State the range that is needed: range = ["0 mm", "250 mm"]', "drive.range")
    if drive.speed.kind != STATIC and not (cylinder.closed.fixed and cylinder.open.fixed):
        message = "the stroke of the cylinder is a design variable, and with it the time of the motion"
        raise Unusable(message, 'Write speed = "static", or fix closed and open', "drive.speed", str(drive.speed))


def check_same_drive(drive: DriveSection, mechanism: Mechanism, before: Mapping[str, float], sizes: Mapping[str, object]) -> None:
    """Refuse dimensions with which a slide or cylinder moves through another range, or at another speed, than the file states.

    `before` are the dimensions of the file.

    Raises
    ------
    Unusable
        with the full key of the cause.
    """
    (element,) = mechanism.drives
    changed = {name for name, size in sizes.items() if name in before and np.any(np.asarray(size) != before[name])}
    if changed.intersection(map(str, element.sizes)) and drive.speed.kind != STATIC:
        message = "the stroke of the cylinder differs from that of the file, and with it the time of the motion"
        raise Unusable(message, 'Write speed = "static", or change closed and open in the file', "drive.speed", str(drive.speed))
    if changed and not element.size and drive.range is None:
        message = "the slide moves as far as the linkage lets it, which other dimensions change"
        raise Unusable(message, 'State the range that is needed: range = ["0 mm", "250 mm"]', "drive.range")


# --- laws, and several drives -------------------------------------------------------------------------------------------------

MOST_CYCLES = 1000
"""Periods of a drive in the common period of several drives, at most."""
SAME_PERIOD = 1e-9
"""Share of a period, or of a range, that is rounding."""


def law_of(drive: DriveMotion, key: str, kind: str) -> MotionLaw | None:
    """Return the law of a drive over the time [s]; None without one.

    Raises
    ------
    Unusable
        with the full key of the cause.
    """
    if drive.law is None:
        return None
    law: MotionLaw = drive.law
    if drive.range is not None:
        low, high = (end.value for end in drive.range)
        least, _, largest, _ = law.extremes()
        slack = SAME_PERIOD * (high - low)
        if least < low - slack or largest > high + slack:
            message = f"the law moves from {show(least, kind)} to {show(largest, kind)}, beyond the range"
            raise Unusable(message, "Change the law or the range", f"{key}.range", f"{drive.range[0]} ... {drive.range[1]}")
    return law


def _accelerated(drive: DriveSection) -> Law:
    """Return the law of a crank with constant acceleration, for one revolution or to the end of its range."""
    assert drive.acceleration is not None
    start, speed, rate = drive.start.value, drive.speed.value, drive.acceleration.value
    way = TURN if drive.range is None else drive.range[1].value - start if speed > 0.0 else start - drive.range[0].value
    if drive.law is not None or way <= 0.0:
        key = "law" if drive.law is not None else "start"
        raise Unusable("the crank has an acceleration, so it moves from its start at its speed", "Change it", f"drive.{key}")
    square = speed * speed + 2.0 * math.copysign(rate, rate * speed) * way
    if not square > 0.0:
        angle = math.degrees(0.5 * speed * speed / abs(rate))
        remedy = f"Give a higher speed, or a range that ends before: at most {angle:.6g} deg from the start"
        raise Unusable(f"the crank comes to rest after {angle:.6g} deg", remedy, "drive.acceleration", str(drive.acceleration))
    time = 2.0 * way / (abs(speed) + math.sqrt(square))
    piece = Piece((start, speed * time, 0.5 * rate * time * time))
    return Law((0.0, time), math.copysign(way, speed), repeats=False, pieces=(piece,))


def end_with_speed(laws: Iterable[MotionLaw]) -> float | None:
    """Return the time [s] at which the first of some laws ends with a speed; None if all of them repeat or come to rest."""
    return min((law.period for law in laws if not law.repeats and law.derivative(law.end, 1) != 0.0), default=None)


def _timed(
    laws: Mapping[str, MotionLaw | None], turns: Mapping[str, float] | None = None
) -> tuple[float, tuple[float, float] | None]:
    """Return the rate of the cycle variable [rad/s], and its limits [rad] if the motion does not repeat.

    `turns`: periods [s] of the drives at constant speed. A law that ends with a speed does not say how its drive moves on: the
    motion of all drives ends with the first such law.
    """
    once = [law for law in laws.values() if law is not None and not law.repeats]
    if once:
        return TURN / (end_with_speed(once) or max(law.period for law in once)), (0.0, TURN)
    periods = {name: law.period for name, law in laws.items() if law is not None} | dict(turns or {})
    if not periods:
        return 1.0, None
    first, one = next(iter(periods.items()))
    shares = {name: Fraction(period / one).limit_denominator(MOST_CYCLES) for name, period in periods.items()}
    numerators, denominators = zip(*(share.as_integer_ratio() for share in shares.values()), strict=True)
    whole = Fraction(math.lcm(*numerators), math.gcd(*denominators))
    for name, share in shares.items():
        if abs(share * one - periods[name]) > SAME_PERIOD * periods[name] or whole / share > MOST_CYCLES:
            other = first if name != first else next(of for of in shares if of != first)
            message = f"its period of {periods[name]:.6g} s and that of {other}, {periods[other]:.6g} s, have no common multiple"
            remedy = "Change one of the periods or speeds so that their ratio is one of small whole numbers"
            raise Unusable(message, remedy, f"drives.{name}")
    return TURN / (one * float(whole)), None


def _several(
    section: FourBarSection | DyadsSection, name: str, drives: Mapping[str, DriveMotion], sizes: Mapping[str, float]
) -> Driving:
    """Return the mechanism that several drives move, each by its law, at constant speed, or held where it starts."""
    if not isinstance(section, DyadsSection):
        raise Unusable("a four-bar by its lengths has one drive", "Give its links under [mechanism.links]", "drives")
    laws, turns, elements = {}, {}, {}
    for of, drive in drives.items():
        key = "drive" if of == INPUT else f"drives.{of}"
        moving = "speed" in drive.model_fields_set
        if moving and drive.law is not None:
            raise Unusable("the drive has a law and a speed", "Give one of the two", f"{key}.speed", str(drive.speed))
        if drive.linear:
            element = linear_drive(section, of, drive, key, sizes)
            if moving:
                remedy = 'Give a law: law = [{ time = "2 s", to = "1400 mm" }, { time = "2 s", to = "1000 mm" }]'
                raise Unusable("a constant speed along a line has no cycle", remedy, f"{key}.speed", str(drive.speed))
            begin = drive.start.value if "start" in drive.model_fields_set else element.begin
            laws[of] = law_of(drive, key, "length" if element.size else "coordinate")
            if element.size:
                _check_stroke(element, laws[of], begin, sizes, key)
            elements[of] = replace(element, begin=0.0 if laws[of] is not None else begin, end=None, rate=0.0)
        else:
            body = drive.body
            if body is None:
                raise Unusable("the drive moves nothing", "Give body, slide or cylinder", key)
            check_name(body, section.links, "no such body", f"{key}.body")
            check_name(
                drive.against, [FRAME, *(link for link in section.links if link != body)], "no such body", f"{key}.against"
            )
            laws[of] = law_of(drive, key, "angle")
            rate = drive.speed.value if moving else 0.0
            if rate:
                turns[of] = TURN / abs(rate)
            begin = 0.0 if laws[of] is not None else drive.start.value
            if drive.effort is not None and drive.range is not None:
                begin = _start(drive, drive.range[0].value, drive.range[1].value, key)
            elements[of] = Drive(of, "angle", body, begin, None, None, rate, against=drive.against)
    pace, limits = _timed(laws, turns)
    timed = []
    for of, element in elements.items():
        rate = element.rate if laws[of] is None else 1.0
        timed.append(replace(element, law=laws[of], rate=rate / pace))
    mechanism = replace(section.linkage(name, "", timed), limits=limits)
    acting = {element.name for train in mechanism.trains for element in train.elements}
    for of, element in elements.items():
        if not element.size and of not in acting:
            message = f"another drive or coupling moves {element.body} already"
            raise Unusable(message, "Remove one of them", f"drives.{of}", element.body)
    return Driving(geared(mechanism, sizes), pace, 0.0)


def _check_stroke(element: Drive, law: MotionLaw | None, begin: Size, sizes: Mapping[str, float], key: str) -> None:
    """Refuse a law or a length beyond the stroke of a cylinder."""
    low, high = (sizes[f"{element.body}.{end}"] for end in ("closed", "open"))
    least = largest = sizes[begin] if isinstance(begin, str) else begin
    if law is not None:
        least, _, largest, _ = law.extremes()
    slack = 1e-9 * high
    if least < low - slack or largest > high + slack:
        stroke, cylinder = (f"{show(one, 'length')} to {show(other, 'length')}" for one, other in ((least, largest), (low, high)))
        message = f"the drive moves from {stroke}, and the cylinder from {cylinder}"
        raise Unusable(message, "Change the law, or closed and open", f"{key}.{'start' if law is None else 'law'}")
