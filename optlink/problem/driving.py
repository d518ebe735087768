"""How the drive of a file moves its linkage: drives and limits of the mechanism, and the rate of its cycle variable."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from optlink.linkage.elements import FRAME, Drive
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.stroke import reachable
from optlink.problem.machine.bodies import SLOWNESS, STATIC, DriveSection
from optlink.problem.mechanism import DyadsSection, FourBarSection
from optlink.problem.quantity import Unusable, check_name

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

    def place(self, position: float) -> float:
        """Return the slide or length [m] of a drive along a line at a value of the cycle variable [rad]."""
        assert self.ends is not None
        return self.ends[0] + (self.ends[1] - self.ends[0]) * position / HALF

    def text(self, position: float) -> str:
        """Return a crank angle, or a value of the cycle variable [rad], as a designer calls it: "crank angle 30 deg"."""
        return f"{self.coordinate} {self.shown(position):.6g} {self.unit}"

    def shown(self, position: float) -> float:
        """Return a crank angle, or the slide or length at a value of the cycle variable [rad], in `unit`."""
        return math.degrees(position) if self.ends is None else 1e3 * self.place(position)

    @property
    def unit(self) -> str:
        """Display unit of the positions of the drive."""
        return "deg" if self.ends is None else "mm"

    @property
    def coordinate(self) -> str:
        """What the positions of the drive are: crank angles, the slide of a body, the length of a cylinder."""
        if self.ends is None:
            return "cycle angle" if self.mechanism.drives else "crank angle"
        drive = self.mechanism.drives[0]
        return f"{'length' if drive.size else 'slide'} of {drive.body}"

    @property
    def reach(self) -> str:
        """The range of the drive in words: "crank angle 0 ... 90 deg"; empty for a crank that turns."""
        if self.mechanism.limits is None:
            return ""
        low, high = (f"{self.shown(end):.6g}" for end in self.mechanism.limits)
        return f"{self.coordinate} {low} ... {high} {self.unit}"


def driven(section: FourBarSection | DyadsSection, name: str, drive: DriveSection, sizes: Mapping[str, float]) -> Driving:
    """Return the mechanism of a section as its drive moves it; `sizes` [m, rad] are those of the file.

    Raises
    ------
    Unusable
        with the full key of the cause.
    """
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
    pace = drive.speed.value
    if drive.range is None:
        return Driving(mechanism, pace, drive.start.value)
    low, high = (end.value for end in drive.range)
    first = _start(drive, low, high)
    return Driving(replace(mechanism, limits=(low, high)), pace, first)


def _start(drive: DriveSection, low: float, high: float) -> float:
    """Return the position at which the motion through a range begins; by default the end from which the drive moves."""
    if "start" not in drive.model_fields_set:
        return low if drive.speed.value > 0.0 else high
    start, slack = drive.start.value, 1e-9 * (high - low)
    if not low - slack <= start <= high + slack:
        assert drive.range is not None
        raise Unusable(
            "the drive starts outside its range",
            f"Start from {drive.range[0]} to {drive.range[1]}",
            "drive.start",
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
        message, remedy = "the linkage has no guide and no cylinder", "Add one under [mechanism.guides] or [mechanism.cylinders]"
        raise Unusable(message, remedy, "drive.body", drive.body)
    element = linear_drive(section, INPUT, drive, "drive", sizes)
    if element.end is None:
        element = _reaching(section, name, drive, element, sizes)
    ends = [sizes[end] if isinstance(end, str) else float(end or 0.0) for end in (element.begin, element.end)]
    mechanism = replace(section.linkage(name, "", (element,)), limits=(0.0, HALF))
    speed = drive.speed.value if "speed" in drive.model_fields_set else USUAL
    if drive.speed.kind not in ("velocity", STATIC) and "speed" in drive.model_fields_set:
        raise Unusable("the drive moves along a line", 'Give a speed such as "100 mm/s"', "drive.speed", str(drive.speed))
    pace = SLOWNESS if drive.speed.kind == STATIC else speed * HALF / (ends[1] - ends[0])
    first = 0.0 if pace > 0.0 else HALF
    if "start" in drive.model_fields_set:
        first = HALF * (drive.start.value - ends[0]) / (ends[1] - ends[0])
        if not -1e-9 <= first <= HALF + 1e-9:
            low, high = (f"{1e3 * end:.6g} mm" for end in ends)
            raise Unusable("the drive starts outside its range", f"Start from {low} to {high}", "drive.start", str(drive.start))
    return Driving(mechanism, pace, first, (ends[0], ends[1]))


def linear_drive(section: DyadsSection, name: str, drive: DriveSection, key: str, sizes: Mapping[str, float]) -> Drive:
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
        ends = stated or (f"{cylinder}.closed", f"{cylinder}.open")
        for stroke, of in zip(stated or (), ("closed", "open"), strict=False):
            low, high = sizes[f"{cylinder}.closed"], sizes[f"{cylinder}.open"]
            if not low * (1.0 - 1e-9) <= stroke <= high * (1.0 + 1e-9):
                message = f"the cylinder has lengths from {1e3 * low:.6g} to {1e3 * high:.6g} mm"
                raise Unusable(message, f"Change range, or {of} of the cylinder", f"{key}.range", f"{1e3 * stroke:.6g} mm")
        return Drive(name, "length", cylinder, ends[0], ends[1], size=f"{cylinder}.length", rod=f"{cylinder}.rod")
    guide = _guide(section, drive, key)
    begin, end = stated or (0.0, None)
    return Drive(name, "slide", section.guides[guide].slider, begin, end, against=section.guides[guide].on)


def _guide(section: DyadsSection, drive: DriveSection, key: str) -> str:
    """Return the name of the guide along which a drive acts: the stated one, or that of the driven body."""
    if drive.slide is not None:
        check_name(drive.slide, section.guides, "no such guide", f"{key}.slide")
        name = drive.slide
    else:
        names = [name for name, guide in section.guides.items() if guide.slider == drive.body]
        if len(names) != 1:
            sliders = {guide.slider: None for guide in section.guides.values()}
            message = "no guide carries the driven body" if not names else "the driven body slides in several guides"
            raise Unusable(
                message,
                f"Add slide = one of: {', '.join(section.guides) or 'no guide'} (sliders: {', '.join(sliders)})",
                f"{key}.body",
                drive.body,
            )
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
