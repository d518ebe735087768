"""Linkages of other programs, read as problem files: joints stay where they are drawn, which gives assembly and start."""

import cmath
import itertools
import math
import os
import re
import string
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn, TypeVar
from urllib.parse import unquote
from xml.etree import ElementTree

from pydantic import BaseModel, ValidationError

from optlink.errors import InputError, shown
from optlink.io import keeping
from optlink.problem.base_model import RESERVED

DIGITS = string.digits + string.ascii_uppercase + string.ascii_lowercase + "_-"
"""Digits of the numbers of a share link of PMKS+."""
UNITS = ("in", "cm", "m")
"""Units of length by their number in a share link."""
MOST = 200
"""Joints and links, at most."""
LARGEST = 1_000_000
"""Size of a file [bytes], at most."""
RPM = math.tau / 60.0
SLOT = "a slot in a moving link is not supported", "Draw it with pins and sliders on the frame"


def _refuse(message: str, remedy: str = "", key: str | None = None) -> NoReturn:
    raise InputError(message, remedy, key=key)


def _real(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) < 1e12:
        _refuse(f"{shown(text)} is not a number of such a drawing")
    return value


@dataclass
class Drawing:
    """A linkage as it is drawn, by the names that its program gives the joints; lengths in `unit`.

    `links`: the joints of each; `lines`: directions [rad] of the lines on the frame on which joints slide; `slots`: the same by
    two joints on the line; `drives`: driven pivots and their speeds [rad/s]; `labels`: what the user calls the joints.
    """

    unit: str
    places: dict[str, complex] = field(default_factory=dict)
    ground: set[str] = field(default_factory=set)
    links: list[list[str]] = field(default_factory=list)
    lines: dict[str, float] = field(default_factory=dict)
    slots: dict[str, tuple[str, str]] = field(default_factory=dict)
    drives: list[tuple[str, float]] = field(default_factory=list)
    labels: dict[str, str] = field(default_factory=dict)

    def tables(self, title: str) -> dict[str, Any]:
        """Return the problem file of the linkage as nested tables, with the place of each joint as its assembly mode."""

        def lengths(place: complex) -> list[str]:
            return [f"{value:.15g} {self.unit}" for value in (place.real, place.imag)]

        bodies, crank, speed = self._bodies()
        named, places = self._named(), self.places
        links: dict[str, Any] = {}
        for name, (first, second, *others) in bodies.items():
            way = places[second] - places[first]
            links[name] = {"joints": [named[first], named[second]], "length": lengths(abs(way) + 0j)[0]}
            if others:
                turned = abs(way) / way
                links[name]["points"] = {named[one]: lengths((places[one] - places[first]) * turned) for one in others}
        guides = {}
        for joint, direction in self.lines.items():
            slider = f"slider_{named[joint]}"
            links[slider] = {"joints": [named[joint]]}
            line = {"on": "frame", "through": lengths(places[joint]), "direction": f"{math.degrees(direction):.15g} deg"}
            guides[f"guide_{named[joint]}"] = {"slider": slider, **line}
        mechanism: dict[str, Any] = {"type": "dyads"}
        mechanism["ground"] = {named[joint]: lengths(places[joint]) for joint in places if joint in self.ground}
        mechanism["links"] = links
        if guides:
            mechanism["guides"] = guides
        if inner := [*self._inner(bodies, crank)]:
            mechanism["assembly"] = {named[joint]: f"near [{', '.join(lengths(places[joint]))}]" for joint in inner}
        pivot, pin = (places[joint] for joint in bodies[crank][:2])
        start = f"{math.degrees(cmath.phase(pin - pivot)):.15g} deg"
        drive = {"body": crank, "start": start, "speed": f"{speed:.15g} rad/s"}
        return {"format": 1, "title": title, "mechanism": mechanism, "drive": drive}

    def _named(self) -> dict[str, str]:
        """Return a name for each joint: its label where that can be a name."""
        named: dict[str, str] = {}
        for joint in self.places:
            label = re.sub(r"\W+", "_", self.labels.get(joint, joint), flags=re.ASCII)[:30]
            if not label[:1].isalpha() or label in RESERVED or re.match("link_|slider_|guide_", label):
                label = f"P_{label}"
            tries = itertools.chain([label], (f"{label}_{number}" for number in itertools.count(2)))
            named[joint] = next(name for name in tries if name not in named.values())
        return named

    def _bodies(self) -> tuple[dict[str, list[str]], str, float]:
        """Return the links by name, each with its pivot first, the driven one and its speed; links that cannot move are frame."""
        if len(self.places) > MOST or len(self.links) > MOST:
            _refuse(f"the linkage has more than {MOST} joints or links", "Give a smaller one")
        rigid = [self.ground, *({*link} for link in self.links if len({*link}) > 1)]
        while one := _one_body(rigid):
            for number in one[:0:-1]:
                rigid[one[0]] |= rigid.pop(number)
        for joint, ends in self.slots.items():
            if not self.ground.issuperset(ends):
                _refuse(*SLOT, self.labels.get(joint, joint))
            self.lines[joint] = cmath.phase(self.places[ends[1]] - self.places[ends[0]])
        used = set().union(*rigid[1:])
        self.ground &= used
        self.places = keeping(self.places, *used)
        self.lines = keeping(self.lines, *(used - self.ground))
        if len(self.drives) != 1 or self.drives[0][0] not in self.ground or not self.drives[0][1]:
            message = f"the linkage has {len(self.drives)} inputs, and one driven pin on the ground is supported"
            _refuse(message, "Give one pin on the ground the input, with a speed")
        pivot, speed = self.drives[0]
        bodies = {}
        for number, body in enumerate(rigid[1:], 1):
            joints = sorted(body, key=[*self.places].index)
            joints.sort(key=lambda one: (one != pivot, one not in self.ground))
            others = [one for one in joints[1:] if self.places[one] != self.places[joints[0]]]
            if not others:
                _refuse("two joints of a link lie at one place", "Draw them apart", joints[0])
            bodies[f"link_{number}"] = [joints[0], others[0], *(one for one in joints[1:] if one != others[0])]
        cranks = [name for name, joints in bodies.items() if pivot in joints]
        if len(cranks) != 1:
            _refuse(f"{len(cranks)} links turn about the input {self.labels.get(pivot, pivot)}", "Let one link turn about it")
        return bodies, cranks[0], speed

    def _inner(self, links: dict[str, list[str]], crank: str) -> Iterator[str]:
        """Yield the pins between two bodies that are placed together, each being joined to bodies placed before."""
        bodies = {name: {*joints} for name, joints in links.items() if name != crank}
        bodies |= {f"slider_{joint}": {joint} for joint in self.lines}
        placed = {*self.ground, *links[crank]}

        def group() -> tuple[str, str, str] | None:
            near = [name for name, joints in bodies.items() if joints & placed or name not in links]
            pairs = ((one, other) for number, one in enumerate(near) for other in near[:number])
            return next(((*pair, joint) for pair in pairs for joint in bodies[pair[0]] & bodies[pair[1]] - placed), None)

        while found := group():
            yield found[2]
            placed |= bodies.pop(found[0]) | bodies.pop(found[1])


def _one_body(bodies: list[set[str]]) -> list[int]:
    """Return the numbers of bodies that are one: two that share two joints, or three of which each two share another one."""
    for (i, one), (j, other) in itertools.combinations(enumerate(bodies), 2):
        if len(one & other) > 1:
            return [i, j]
        for k in range(j + 1, len(bodies)) if one & other else ():
            if (third := bodies[k]) & one and third & other and len(one & other | one & third | other & third) > 2:
                return [i, j, k]
    return []


# --- PMKS+: https://github.com/PMKS-Web/PMKSWeb, StringTranscoder, and UrlProcessorService of 2022 for the older links


def _number(text: str) -> float:
    """Return a number of a link: thousandths, with a 0 before them if it is negative."""
    digits = text[1:] if text.startswith("0") else text
    if not text or len(digits) > 10 or any(digit not in DIGITS for digit in digits):
        _refuse(f"{shown(text)} is not a number of a PMKS+ link")
    value = 0
    for digit in digits:
        value = 64 * value + DIGITS.index(digit)
    return (-value if digits is not text else value) / 1000.0


def digits(value: float) -> str:
    """Return the nearest integer as the digits of a link."""
    rest, text = abs(round(value)), ""
    while rest or not text:
        rest, digit = divmod(rest, 64)
        text = DIGITS[digit] + text
    return "0" + text if round(value) < 0 else text


def check_digit(text: str) -> str:
    """Return the check sum of a link, which ends it: its length."""
    return DIGITS[len(text) % 62]


def _pmks(text: str) -> Drawing:
    """Read a link: settings, joints, links and forces."""
    query = text.partition("?")[2] or text
    if not query or query[-1] not in DIGITS[:62]:
        _refuse("not a link of PMKS+")
    if check_digit(query[:-1]) != query[-1]:
        _refuse("the link is damaged or not one of PMKS+: its length does not fit its check sum")
    head, parts = query[:-1].split(".")[:4], query[:-1].split(".")[4:]
    if len(head) < 4 or parts.count("") < 2 or head[3][:1] not in {"0", "1", "2"} or head[0][-1:] not in {*DIGITS}:
        _refuse("the link is damaged: its settings, joints or links cannot be read")
    joints, parts = parts[: parts.index("")], parts[parts.index("") + 1 :]
    links = parts[: parts.index("")] if "" in parts else parts
    drawing, slides = Drawing(UNITS[int(head[3][0])]), dict[str, float]()
    turned = -1.0 if DIGITS.index(head[0][-1]) & 1 else 1.0
    for joint in joints:
        flags, fields = joint[:1], joint[1:].split(",")
        if len(fields) < 5 or flags not in DIGITS:
            _refuse("a joint of the link cannot be read", key=joint)
        name, bits = fields[0], DIGITS.index(flags)
        if not name or name in drawing.places:
            _refuse("a joint of the link has no name of its own", key=joint)
        drawing.places[name], drawing.labels[name] = complex(_number(fields[2]), _number(fields[3])), fields[1] or name
        if any(fields[5:8]):
            _refuse(*SLOT, joint)
        if bits & 8:
            _refuse("a welded joint is not supported", "Draw the welded links as one", joint)
        if bits & 1:
            slides[name] = _number(fields[4])
        elif bits & 4:
            drawing.ground.add(name)
        if bits & 2:
            own = _number(fields[8]) if len(fields) > 8 else 0.0
            drawing.drives.append((name, RPM * (own or turned * 1000.0 * _number(head[2].split(",")[0]))))
    for link in links:
        fields = link[2:].split(",")
        if link[:1] not in set("YAMGNamg01234567") or link[1:2] not in set("RP") or "" not in fields[7:]:
            _refuse("a link of the linkage cannot be read", key=link)
        _join(drawing, link[1], fields[7 : fields.index("", 7)], slides, link)
    return drawing


def _join(drawing: Drawing, kind: str, members: list[str], slides: dict[str, float], link: str) -> None:
    """Add a link (R) or a block (P), which joins a pin and a slide."""
    if len({*members}) < max(len(members), 2) or not drawing.places.keys() >= {*members}:
        _refuse("a link has no two joints of the linkage", key=link)
    pin, *rails = sorted(members, key=lambda one: one in slides)
    if kind == "R":
        drawing.links.append(members)
    elif len(rails) != 1 or rails[0] not in slides or pin in slides:
        _refuse("a block joins a pin and a slide", key=link)
    else:
        drawing.lines[pin] = slides[rails[0]]
        return
    if any(one in slides for one in members):
        _refuse("a link that cannot turn about its slide is not supported", "Join it to the slide by a pin", link)


def _old_pmks(text: str) -> Drawing:
    """Read a link of the years up to 2022: rows of fields."""
    query = dict(part.partition("=")[::2] for part in unquote(text.partition("?")[2] or text).split("&"))
    speed, clockwise, _, unit, *_ = [*query.get("s", "10,false,false,cm").split(","), "", "", "", ""]
    if unit not in ("in", "cm", "m"):
        _refuse(f"{shown(unit)} is not a unit of PMKS+", key="s")
    drawing, slides = Drawing(unit), set[str]()
    for row in filter(None, query.get("j", "").split("\n")):
        name, x, y, _, kind, ground, angle, *last = [*row.split(","), *[""] * 7][: max(len(row.split(",")), 7)]
        if not name or name in drawing.places or kind not in ("R", "P"):
            _refuse("a joint of the link cannot be read", key=row)
        drawing.places[name] = complex(_real(x), _real(y))
        if kind == "P" and (ground != "t" or angle not in ("0", "Null")):
            _refuse("only level slides on the ground are supported in an old link", "Draw it in the present PMKS+", row)
        if kind == "P":
            slides.add(name)
        elif ground == "t":
            drawing.ground.add(name)
        if "t" in last[:2]:  # friction stands before the input, or nothing
            drawing.drives.append((name, RPM * (-1.0 if clockwise == "true" else 1.0) * _real(speed)))
    for row in filter(None, query.get("l", "").split("\n")):
        fields = [*row.split(","), *[""] * 7]
        typed = fields[1] in ("R", "P")
        members = fields[5 + typed].split("|")
        if typed and fields[1] == "P":
            _join(drawing, "P", members, dict.fromkeys(slides, 0.0), row)
        else:
            _join(drawing, "R", members, {}, row)
            drawing.lines |= dict.fromkeys(slides.intersection(members), 0.0)
    return drawing


def _first_pmks(text: str) -> Drawing:
    _refuse("links of the first PMKS are not supported", "Draw the linkage in PMKS+, and give its share link")


# --- Linkage by David Rector: the class CLinkageDoc writes and reads its files

NOT_READ = {
    "actuator": ("an actuator", "Drive the linkage by a crank"),
    "gear": ("a gear or chain", "Take it out"),
    "slideradius": ("a curved slot", "Draw a straight one on the frame"),
    "limitangle": ("an input that swings", "Let it turn fully"),
    **dict.fromkeys(("fasten", "fastenlink", "fastenconnector"), ("a fastened element", "Join its links into one")),
}
OFF = {"false", "0", "0.000000"}


def _linkage(text: str) -> Drawing:
    """Read a `.linkage2` file: 96 units are an inch, y points up, a positive speed turns clockwise."""
    if "<!DOCTYPE" in text:
        _refuse("the file has a document type, and those of Linkage have none")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        _refuse(f"the file is damaged: {error}")
    if root.tag != "linkage2":
        _refuse(f"not a file of Linkage: it begins with <{root.tag[:40]}>")
    program = root.find("program")
    settings = {} if program is None else program.attrib
    if _real(settings.get("scalefactor") or "1") not in (0.0, 1.0):
        _refuse("a drawing scale other than 1 is not supported", "Set the scale of the drawing to 1", "program.scalefactor")
    drawing = Drawing("in" if settings.get("units", "").lower() == "inches" else "mm")
    unit = (1.0 if drawing.unit == "in" else 25.4) / 96.0
    parts = [
        part
        for part in root
        if part.get("measurementelement") != "true" and (_real(part.get("layer") or "0") or 16.0) >= 16.0  # 1 is decoration
    ]
    for part in parts:
        marks = {**part.attrib, **{inner.tag: "fastened" for inner in part}}
        for attribute, (what, remedy) in NOT_READ.items():
            if (value := marks.get(attribute)) and (value not in OFF or attribute.startswith("fasten")):
                _refuse(f"{what} is not supported", remedy, f"{part.tag} {part.get('id')}")
    sliders = list[ElementTree.Element]()
    for part in parts:
        if part.tag == "connector":
            name = part.get("id", "")
            drawing.places[name] = unit * complex(_real(part.get("x", "0")), _real(part.get("y", "0")))
            drawing.labels[name] = part.get("name") or f"P{name}"
            if part.get("slider") == "true":
                sliders.append(part)
            elif part.get("anchor") == "true":
                drawing.ground.add(name)
            if part.get("input") == "true":
                drawing.drives.append((name, -RPM * _real(part.get("rpm") or "0")))
        elif part.tag in ("Link", "element"):
            members = (connector.get("id", "") for connector in part.findall("connector"))
            drawing.links.append([name for name in members if name in drawing.places])
    for part in sliders:
        ends = [limit.get("id", "") for limit in part.findall("slidelimit")]
        if len({*ends}) != 2 or not drawing.places.keys() >= {*ends}:
            _refuse("a slider without two ends of its line is not supported", "Give it a line", f"connector {part.get('id')}")
        if part.get("anchor") == "true":
            _refuse(*SLOT, f"connector {part.get('id')}")
        drawing.slots[part.get("id", "")] = ends[0], ends[1]
    return drawing


# --- pylinkage: linkage/serialization.py (joints with parents) and mechanism/serialization.py (joints and links)


class _Table(BaseModel, allow_inf_nan=False):
    """A table of a file of pylinkage."""


class _Parent(_Table):
    ref: str = ""  # of a fixed point that stands here with its place, none
    x: float = 0.0
    y: float = 0.0


class _Dependent(_Table):
    type: str
    name: str
    x: float | None = None
    y: float | None = None
    joint0: _Parent | None = None
    joint1: _Parent | None = None
    joint2: _Parent | None = None
    distance: float | None = None
    angle: float | None = None
    distance0: float | None = None
    distance1: float | None = None
    revolute_radius: float | None = None


class _Linkage(_Table):
    joints: list[_Dependent]


class _Joint(_Table):
    id: str
    type: str = "revolute"
    position: tuple[float, float] | None = None
    name: str | None = None
    axis: tuple[float, float] = (1.0, 0.0)
    ref_joint1_id: str = ""
    ref_joint2_id: str = ""
    distance: float = 0.0
    angle: float = 0.0


class _Link(_Table):
    id: str = ""
    type: str = "link"
    joints: list[str]
    motor_joint: str | None = None
    angular_velocity: float = 0.0


class _Mechanism(_Table):
    joints: list[_Joint]
    links: list[_Link]


Model = TypeVar("Model", bound=_Table)


def _parsed(model: type[Model], text: str) -> Model:
    try:
        return model.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        _refuse(f"not a file of pylinkage: {first['msg']}", key=".".join(map(str, first["loc"])) or None)


def _pylinkage(text: str) -> Drawing:
    """Read joints with parents: the place of each, corrected to the distances from its parents.

    A length has no unit there and is read as metres, a step as a second.
    """
    drawing = Drawing("m")
    pending = {joint.name: joint for joint in _parsed(_Linkage, text).joints}
    kinds = {"Static": 0, "Crank": 1, "Fixed": 2, "Revolute": 2, "Linear": 3}
    parents: dict[str, list[str]] = {}
    for name, joint in pending.items():
        given = [joint.joint0, joint.joint1, joint.joint2][: kinds.get(joint.type, 0)]
        if joint.type not in kinds or None in given:
            _refuse(f"{joint.type} is not supported, or a parent of it is missing", "Build it of the joints of pylinkage", name)
        parents[name] = []
        for parent in filter(None, given):
            inner = parent.ref or f"{parent.x:g}_{parent.y:g}"
            parents[name].append(inner)
            if not parent.ref:
                drawing.places[inner] = complex(parent.x, parent.y)
                drawing.ground.add(inner)
    while ready := [name for name in pending if drawing.places.keys() >= {*parents[name]}]:
        for name in ready:
            joint, known = pending.pop(name), [drawing.places[parent] for parent in parents[name]]
            drawing.places[name] = _placed(joint, known)
            if joint.type == "Static":
                drawing.ground.add(name)
            elif joint.type == "Linear":
                drawing.slots[name] = parents[name][1], parents[name][2]
                drawing.links.append([parents[name][0], name])
            elif joint.type == "Revolute":
                drawing.links += [[parent, name] for parent in parents[name]]
            else:
                drawing.links.append([*parents[name], name])
            if joint.type == "Crank":
                drawing.drives.append((parents[name][0], joint.angle or 0.0))
    if pending:
        _refuse("joints have no parents in the file", "Save the linkage again", ", ".join(pending)[:60])
    return drawing


def _placed(joint: _Dependent, known: list[complex]) -> complex:
    """Return the place of a joint that its distances give, near the one that is stated."""
    place = complex(joint.x or 0.0, joint.y or 0.0)
    places = [place]
    try:
        if joint.type == "Crank" and joint.distance is not None:
            places = [known[0] + joint.distance * (place - known[0]) / abs(place - known[0])]
        elif joint.type == "Fixed" and joint.distance is not None and joint.angle is not None:
            places = [known[0] + cmath.rect(joint.distance, joint.angle + cmath.phase(known[1] - known[0]))]
        elif joint.type == "Revolute" and joint.distance0 is not None and joint.distance1 is not None:
            way, apart = (known[1] - known[0]) / abs(known[1] - known[0]), abs(known[1] - known[0])
            along = (joint.distance0**2 - joint.distance1**2 + apart**2) / (2.0 * apart)
            across = math.sqrt(joint.distance0**2 - along**2)
            places = [known[0] + way * complex(along, side * across) for side in (1, -1)]
        elif joint.type == "Linear" and joint.revolute_radius is not None:
            way = (known[2] - known[1]) / abs(known[2] - known[1])
            foot = (known[0] - known[1]) / way
            half = math.sqrt(joint.revolute_radius**2 - foot.imag**2)
            places = [known[1] + way * (foot.real + side * half) for side in (1, -1)]
    except (ArithmeticError, ValueError):
        _refuse("the distances of this joint do not reach its place", "Correct them", joint.name)
    return min(places, key=lambda one: abs(one - place))


def _pylinkage_mechanism(text: str) -> Drawing:
    """Read joints with places and links; a length is read as metres, a step as a second."""
    mechanism, drawing = _parsed(_Mechanism, text), Drawing("m")
    trackers = []
    for joint in mechanism.joints:
        drawing.labels[joint.id] = joint.name or joint.id
        if joint.type == "tracker" and joint.ref_joint1_id:
            trackers.append(joint)
            continue
        if joint.position is None:
            _refuse("the joint has no place", "Save the mechanism after building it", joint.id)
        drawing.places[joint.id] = complex(*joint.position)
        if joint.type in ("ground", "tracker"):
            drawing.ground.add(joint.id)
        elif joint.type == "prismatic":
            drawing.lines[joint.id] = cmath.phase(complex(*joint.axis))
        elif joint.type != "revolute":
            _refuse(f"a joint of the type {joint.type} is not supported", "Use revolute and prismatic joints", joint.id)
    for joint in trackers:
        of = [joint.ref_joint1_id, joint.ref_joint2_id]
        if not drawing.places.keys() >= {*of}:
            _refuse("a tracker follows no two joints", "Give it two", joint.id)
        first, second = (drawing.places[one] for one in of)
        drawing.places[joint.id] = first + cmath.rect(joint.distance, joint.angle + cmath.phase(second - first))
        drawing.links.append([*of, joint.id])
    for link in mechanism.links:
        members = [name for name in link.joints if name in drawing.places]
        if link.type == "ground":
            drawing.ground |= {*members}
            continue
        drawing.links.append(members)
        if link.type == "driver":
            drawing.drives.append((link.motor_joint or "", link.angular_velocity))
        elif link.type != "link":
            _refuse(f"a link of the type {link.type} is not supported", "Let the driver turn fully", link.id)
    return drawing


# --- the formats


@dataclass(frozen=True)
class Reader:
    """A format: the pattern by which it is recognised, the program that writes it, and how to read it."""

    pattern: str
    program: str
    read: Callable[[str], Drawing]
    remedy: str = "Copy the link again from Share in PMKS+"


READERS = (
    Reader(r"\s*<", "Linkage", _linkage, "Save the file again in Linkage"),
    Reader(r'(?s)\s*\{.*"links"\s*:', "pylinkage", _pylinkage_mechanism, "Save the mechanism again with pylinkage"),
    Reader(r"\s*\{", "pylinkage", _pylinkage, "Save the linkage again with pylinkage"),
    Reader(r"(?s).*[?&]mech=", "PMKS", _first_pmks),
    Reader(r"(?s)(.*[?&])?j=", "PMKS+", _old_pmks),
    Reader("", "PMKS+", _pmks),
)
"""Formats that are read; the first that is recognised counts."""
SOUGHT = 2000  # characters of a file in which the element of a drawing begins
READABLE = "Give a path in an SVG file (.svg), a file of Linkage (.linkage2) or pylinkage (.json), or a share link of PMKS+"


def problem_text(source: str) -> str:
    """Return the problem file of a linkage of another program.

    Parameters
    ----------
    source : str
        Name of a file of Linkage (`.linkage2`) or pylinkage (JSON), or a share link of PMKS+, of which the part behind the
        question mark suffices; a file may contain the link.

    Raises
    ------
    InputError
        If it is damaged, or its linkage is none that optlink reads.
    """
    import tomli_w

    from optlink.problem.file import read

    text, where = _content(source)
    reader = next(reader for reader in READERS if re.match(reader.pattern, text))
    drawn = re.match(r"(?s)(<\?.*?\?>|<!--.*?-->|<!DOCTYPE.*?>|\s)*<(\w+:)?svg\b", text[:SOUGHT])
    if where and (drawn or (not reader.pattern and not re.fullmatch(r"[!-~]+", text))):
        message = "a drawing whose name does not end with .svg" if drawn else "neither a drawing nor a linkage of another program"
        raise InputError(message, "Rename it to end with .svg" if drawn else READABLE, where)
    where = where or f"{reader.program} link"
    try:
        tables = reader.read(text).tables(f"Linkage from {reader.program}")
        dumped = tomli_w.dumps(tables)
        text = re.sub(r",?\n +|,\n(?=\])", lambda gap: ", " if gap[0][0] == "," and gap[0][-1] == " " else "", dumped)
        read(text, "drawing", where)
    except InputError as error:
        fault = error.faults[0]
        raise InputError(replace(fault, file=where, remedy=fault.remedy or reader.remedy)) from None
    return text


def _content(source: str) -> tuple[str, str]:
    """Return the text of a source, and the name of its file."""
    if not os.path.isfile(source):
        if re.search(r"^[^?=]*\.[A-Za-z]+2?$", source):
            raise InputError("no such file", "Check the path", source)
        return source.strip(), ""
    if os.path.getsize(source) > LARGEST:
        raise InputError(f"the file has more than {LARGEST} bytes", "Give a file of Linkage or pylinkage", source)
    try:
        return Path(source).read_text(encoding="utf-8-sig", errors="replace").strip(), source
    except OSError as error:
        raise InputError(f"the file cannot be read: {error.strerror}", "Check its permissions", source) from None
