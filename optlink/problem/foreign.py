"""Share links of PMKS+, read as problem files: the pins are where the drawing has them, which gives assembly and start."""

from __future__ import annotations

import math
import re
import string
from dataclasses import dataclass, field
from typing import Any, NoReturn

from optlink.errors import InputError

DIGITS = string.digits + string.ascii_uppercase + string.ascii_lowercase + "_-"
"""Digits of the numbers of a link."""
UNITS = ("in", "cm", "m")
"""Units of length by their number in a link."""
MOST = 200
"""Joints and links, at most."""


@dataclass
class Drawing:
    """A linkage as it is drawn: joints with their places, links by their joints, sliders; lengths in `unit`.

    `lines`: directions [rad] of the lines on which joints slide; `crank`: the driven link, which begins at its pivot.
    """

    unit: str
    places: dict[str, tuple[float, float]]
    ground: set[str]
    links: dict[str, tuple[str, ...]]
    lines: dict[str, float] = field(default_factory=dict)
    crank: str = ""
    speed: float = 1.0

    def tables(self, title: str) -> dict[str, Any]:
        """Return the problem file of the linkage as nested tables, with the place of each joint as its assembly mode."""

        def length(value: float) -> str:
            return f"{value:.15g} {self.unit}"

        links: dict[str, Any] = {}
        for name, joints in self.links.items():
            first, second, *others = joints
            (x, y), (to_x, to_y) = self.places[first], self.places[second]
            size = math.hypot(to_x - x, to_y - y)
            c, s = (to_x - x) / size, (to_y - y) / size
            links[name] = {"joints": [first, second], "length": length(size)}
            away = {other: (self.places[other][0] - x, self.places[other][1] - y) for other in others}
            if away:
                links[name]["points"] = {one: [length(a * c + b * s), length(b * c - a * s)] for one, (a, b) in away.items()}
        guides = {}
        for joint, direction in self.lines.items():
            links[f"slider_{joint}"] = {"joints": [joint]}
            through = [length(part) for part in self.places[joint]]
            line = {"on": "frame", "through": through, "direction": f"{math.degrees(direction):.15g} deg"}
            guides[f"guide_{joint}"] = {"slider": f"slider_{joint}", **line}
        pivot, pin = (self.places[joint] for joint in self.links[self.crank][:2])
        start = math.degrees(math.atan2(pin[1] - pivot[1], pin[0] - pivot[0]))
        mechanism: dict[str, Any] = {"type": "dyads"}
        mechanism["ground"] = {joint: [length(part) for part in self.places[joint]] for joint in sorted(self.ground)}
        mechanism["links"] = links
        if guides:
            mechanism["guides"] = guides
        if places := {joint: self.places[joint] for joint in self._inner()}:
            mechanism["assembly"] = {joint: f"near [{length(x)}, {length(y)}]" for joint, (x, y) in places.items()}
        drive = {"body": self.crank, "start": f"{start:.15g} deg", "speed": f"{self.speed:.15g} rad/s"}
        return {"format": 1, "title": title, "mechanism": mechanism, "drive": drive}

    def _inner(self) -> list[str]:
        """Return the pins between two bodies that are placed together, each being joined to bodies placed before."""
        bodies = {name: set(joints) for name, joints in self.links.items() if name != self.crank}
        bodies |= {f"slider_{joint}": {joint} for joint in self.lines}
        placed, inner = {*self.ground, *self.links[self.crank]}, list[str]()

        def group() -> tuple[str, str, str] | None:
            near = [name for name, joints in bodies.items() if joints & placed or name not in self.links]
            pairs = ((one, other) for number, one in enumerate(near) for other in near[:number])
            return next(((*pair, joint) for pair in pairs for joint in bodies[pair[0]] & bodies[pair[1]] - placed), None)

        while found := group():
            inner.append(found[2])
            placed |= bodies.pop(found[0]) | bodies.pop(found[1])
        return inner


def problem_text(link: str) -> str:
    """Return the problem file of a share link of PMKS+.

    Parameters
    ----------
    link : str
        As PMKS+ copies it; the part behind the question mark suffices.

    Raises
    ------
    InputError
        If the link is damaged, or its linkage is none that optlink reads.
    """
    import tomli_w

    from optlink.problem.file import read

    drawing = _pmks(link.strip().partition("?")[2] or link.strip())
    tables = drawing.tables("Linkage from PMKS+")
    text = re.sub(r",?\n +|,\n(?=\])", lambda gap: ", " if gap[0][0] == "," and gap[0][-1] == " " else "", tomli_w.dumps(tables))
    read(text, "pmks", "PMKS+ link")
    return text


def _refuse(message: str, value: str, remedy: str = "Copy the link again from Share in PMKS+") -> NoReturn:
    raise InputError(message, remedy, "PMKS+ link", value=value[:60])


def _number(text: str) -> float:
    """Return a number of a link: thousandths, with a 0 before them if it is negative."""
    digits = text[1:] if text.startswith("0") else text
    if not text or len(digits) > 10 or any(digit not in DIGITS for digit in digits):
        _refuse("not a number of a PMKS+ link", text)
    value = 0
    for digit in digits:
        value = 64 * value + DIGITS.index(digit)
    return (-value if digits is not text else value) / 1000.0


def _flags(text: str) -> int:
    return sum(64**place * DIGITS.index(digit) for place, digit in enumerate(reversed(text)))


def _pmks(query: str) -> Drawing:
    """Return the drawing of the text of a link: settings, joints, links and forces, with the length of the text as check sum."""
    if not query or (string.digits + string.ascii_letters)[:62].find(query[-1]) < 0:
        _refuse("not a link of PMKS+", query)
    sums = string.digits + string.ascii_uppercase + string.ascii_lowercase
    if sums[(len(query) - 1) % 62] != query[-1]:
        _refuse("the link is damaged or not one of the present PMKS+: its length does not fit its check sum", query)
    head, parts = query[:-1].split(".")[:4], query[:-1].split(".")[4:]
    if len(head) < 4 or parts.count("") < 2 or len(head[3]) < 1 or head[3][0] not in "012":
        _refuse("the link is damaged: its settings, joints or links are missing", query)
    if not head[0] or any(digit not in DIGITS for digit in head[0]):
        _refuse("the link is damaged: its settings cannot be read", head[0])
    joints, parts = parts[: parts.index("")], parts[parts.index("") + 1 :]
    links = parts[: parts.index("")] if "" in parts else parts
    if len(joints) > MOST or len(links) > MOST:
        _refuse(f"the link has more than {MOST} joints or links", query)
    drawing = Drawing(UNITS[int(head[3][0])], {}, set(), {})
    drives, slides = list[tuple[str, float]](), dict[str, float]()
    turned = -1.0 if _flags(head[0]) & 1 else 1.0
    for joint in joints:
        flags, fields = joint[:1], joint[1:].split(",")
        if len(fields) < 5 or flags not in DIGITS:
            _refuse("a joint of the link cannot be read", joint)
        name, bits = fields[0], DIGITS.index(flags)
        if not (name.isascii() and name.isidentifier()) or name in drawing.places:
            _refuse("a joint of the link has no name of its own", joint)
        drawing.places[name] = _number(fields[2]), _number(fields[3])
        if any(fields[5:8]) or bits & 8:
            _refuse(
                "a slot in a moving link or a welded joint is not supported", joint, "Draw it with pins and sliders on the frame"
            )
        if bits & 1:
            slides[name] = _number(fields[4])
        elif bits & 4:
            drawing.ground.add(name)
        if bits & 2:
            own = _number(fields[8]) if len(fields) > 8 else 0.0
            rpm = own or turned * 1000.0 * _number(head[2].split(",")[0])
            drives.append((name, rpm * math.tau / 60.0))
    for link in links:
        fields = link[2:].split(",")
        if link[:1] not in set("YAMGNamg01234567") or link[1:2] not in set("RP") or "" not in fields[7:]:
            _refuse("a link of the linkage cannot be read", link)
        members = fields[7 : fields.index("", 7)]
        if len(members) < 2 or len(set(members)) < len(members) or not drawing.places.keys() >= set(members):
            _refuse("a link has no two joints of the linkage", link)
        if link[1] == "P":
            pin, *rail = sorted(members, key=lambda one: one in slides)
            if len(rail) != 1 or rail[0] not in slides or pin in slides:
                _refuse("a block joins a pin and a slide", link)
            drawing.lines[pin] = slides[rail[0]]
            continue
        members.sort(key=lambda one: one not in drawing.ground)
        if any(one in slides for one in members) or drawing.places[members[0]] == drawing.places[members[1]]:
            _refuse("two joints of a link lie at one place", link)
        drawing.links[f"link_{len(drawing.links) + 1}"] = tuple(members)
    _driven(drawing, drives, query)
    drawing.places = {name: place for name, place in drawing.places.items() if name not in slides}
    return drawing


def _driven(drawing: Drawing, drives: list[tuple[str, float]], query: str) -> None:
    """Find the driven link, which begins at the driven joint."""
    if len(drives) != 1 or drives[0][0] not in drawing.ground or not drives[0][1]:
        remedy = "Give one pin on the ground the input, with a speed"
        _refuse(f"the linkage has {len(drives)} inputs, and one driven pin on the ground is supported", query, remedy)
    pivot, drawing.speed = drives[0]
    cranks = [name for name, joints in drawing.links.items() if pivot in joints]
    if len(cranks) != 1:
        _refuse(f"{len(cranks)} links turn about the input {pivot}", query, "Let one link turn about it")
    drawing.crank = cranks[0]
    joints = drawing.links[drawing.crank]
    drawing.links[drawing.crank] = (pivot, *(one for one in joints if one != pivot))
