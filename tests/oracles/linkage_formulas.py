"""Deviations and limits of the problem of a certificate over a box of designs, from the numbers in the certificate (SI).

Limits that cannot be evaluated are left out, and limits at every crank angle are applied at some of them only. This relaxation
can only decrease a lower bound of the objective, so no wrong certificate passes. The rows have the order of the multipliers of a
certificate: crank condition, dead centres, transmission angle, further limits, pivots, limits at single crank angles,
tolerances of points; for each the lower side first.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flint import arb

from tests.oracles.ball import (
    FUNCTIONS,
    NAN,
    Ball,
    Vector,
    absolute,
    angle_between,
    angle_of,
    ball,
    constant,
    cross,
    dot,
    maximum,
    minus,
    plus,
    power,
    sqrt,
    times,
    turned,
    turned_back,
    undefined,
    unit,
)

GRID = 36  # crank angles of a revolution at which limits of single positions apply
COSINE_ROUNDING = 1e-12  # cosines that differ by rounding alone
FIXED_LIMIT_TOLERANCE = 1e-9  # violation of a limit that no design variable changes
FRAME = "frame"
LENGTHS = ("crank", "coupler", "rocker", "frame")
OUTER = "outer dead centre"

Numbers = Mapping[str, Any]
Values = Mapping[str, Ball]
Limit = tuple[str, Ball, float, float]
"""Key of the limit, value [m, rad or -], bounds."""


class Unknown(Exception):
    """A law, a dyad or a name that this program does not know."""


# --- laws ----------------------------------------------------------------------------------------------------------------------

_TOKEN = re.compile(r"\s*((?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[A-Za-z_]\w*|\*\*|[-+*/^()])", re.ASCII)


class Expression:
    """The expression of a law: numbers, names, pi, + - * / ^ (or **), brackets, functions; -x^2 is -(x^2), 2^3^2 is 2^9."""

    def __init__(self, text: str, names: Values) -> None:
        self._tokens = _TOKEN.findall(text)
        if "".join(self._tokens) != re.sub(r"\s", "", text):
            raise Unknown(f"the law {text!r}")
        self._names, self._at = names, 0
        self.value = self._sum()
        if self._at < len(self._tokens):
            raise Unknown(f"the law {text!r}")

    def _next(self, *tokens: str) -> str:
        """Return the next token, if it is one of these, and go on; else an empty string."""
        token = self._tokens[self._at] if self._at < len(self._tokens) else ""
        self._at += token in tokens
        return token if token in tokens else ""

    def _sum(self) -> Ball:
        result = self._product()
        while sign := self._next("+", "-"):
            term = self._product()
            result = result + term if sign == "+" else result - term
        return result

    def _product(self) -> Ball:
        result = self._signed()
        while sign := self._next("*", "/"):
            factor = self._signed()
            result = result * factor if sign == "*" else result / factor
        return result

    def _signed(self) -> Ball:
        if sign := self._next("-", "+"):
            value = self._signed()
            return -value if sign == "-" else value
        base = self._atom()
        return power(base, self._signed()) if self._next("^", "**") else base

    def _atom(self) -> Ball:
        if self._next("("):
            value = self._sum()
            if not self._next(")"):
                raise Unknown("a law with an open bracket")
            return value
        token = self._tokens[self._at] if self._at < len(self._tokens) else ""
        self._at += 1
        if token[:1].isdigit() or token[:1] == ".":
            return constant(float(token))
        if token in FUNCTIONS and self._next("("):
            self._at -= 1
            return FUNCTIONS[token](self._atom())
        if token == "pi":
            return constant(math.pi)
        if token not in self._names:
            raise Unknown(f"the name {token!r} of a law")
        return self._names[token]


def linked(steps: Sequence[tuple[str, Any]], values: Values) -> Ball:
    """Return the value of a linked quantity from its operations on a stack."""
    stack: list[Ball] = []
    for kind, what in steps:
        if kind == "number":
            stack.append(constant(float(what)))
        elif kind == "name":
            stack.append(values[what])
        elif kind == "negate":
            stack.append(-stack.pop())
        elif kind == "function":
            if what not in FUNCTIONS:
                raise Unknown(f"the function {what!r} of a link")
            stack.append(FUNCTIONS[what](stack.pop()))
        else:
            right, left = stack.pop(), stack.pop()
            if what == "^":
                stack.append(power(left, right))
            else:
                stack.append({"+": left + right, "-": left - right, "*": left * right}[what] if what != "/" else left / right)
    return stack.pop()


def target(law: Numbers, position: int, offset: Ball, phi0: Ball, psi0: Ball) -> Ball:
    """Return the prescribed output [rad or m] at a crank rotation from the start.

    Parameters
    ----------
    law : mapping
        Of the numbers.
    position : int
        Row of a table.
    offset, phi0 : Ball [rad]
        Crank rotation from the start, crank angle at the start.
    psi0 : Ball [rad or m]
        Output at the start.
    """
    if law["kind"] == "table":
        tabulated = constant(law["tabulated"][position])
        return tabulated + psi0 if law["from_start"] else tabulated
    if law["kind"] == "function":
        x = law["low"] + constant(law["high"] - law["low"]) / law["input"] * offset
        share = (Expression(law["text"], {"x": x}).value - law["least"]) / (constant(law["largest"]) - law["least"])
        return psi0 + share * law["output"]
    size = constant(law["unit"])
    start = psi0 / size
    return Expression(law["text"], {"phi": phi0 + offset, "phi0": phi0, "psi0": start, "s0": start}).value * size


# --- positions of a linkage ----------------------------------------------------------------------------------------------------


class Pose:
    """Positions of the points and bodies of a linkage, dyad by dyad, from the unit vector of its crank."""

    def __init__(self, linkage: Numbers, sides: Mapping[str, int], values: Values, crank: Vector) -> None:
        self.linkage, self.sides, self.values = linkage, sides, values
        self.axes: dict[str, Vector] = {FRAME: unit(constant(0.0))}
        self.points: dict[str, Vector] = {}
        self.margins: dict[str, Ball] = {}
        self.bodies = {body["name"]: body for body in bodies(linkage)}
        for name in linkage["ground"]:
            self.points[name] = self.local(FRAME, name)
        if linkage["datum"] != 0.0:
            crank = turned(crank, unit(self.size(linkage["datum"])))
        self._place(linkage["crank"], crank, linkage["crank"]["start"])
        for dyad in linkage["dyads"]:
            self.margins[joint_of(dyad)] = _DYADS[dyad["kind"]](self, dyad)

    def size(self, size: Any) -> Ball:
        """Return a number, or the quantity that has this name."""
        return self.values[size] if isinstance(size, str) else constant(size)

    def local(self, body: str, point: str) -> Vector:
        """Return the coordinates of a point in the axes of a body [m]."""
        zero = constant(0.0)
        if body == FRAME:
            place = self.linkage["ground"][point]
            if isinstance(place, list):
                return self.size(place[0]), self.size(place[1])
            arm = times(self.size(place["length"]), unit(self.size(place["direction"])))
            return plus(self.local(FRAME, place["from"]), arm)
        if point == self.bodies[body]["start"]:
            return zero, zero
        if point == self.bodies[body]["end"]:
            return self.size(self.bodies[body]["length"]), zero
        mark = self.bodies[body]["points"][point]
        return self.size(mark[0]), self.size(mark[1])

    def point(self, name: str) -> Vector:
        """Return the position of a point [m]."""
        if name not in self.points:
            body = next(
                body
                for key, body in self.bodies.items()
                if key in self.axes and body["start"] in self.points and name in (body["start"], body["end"], *body["points"])
            )
            self.points[name] = plus(self.points[body["start"]], turned(self.local(body["name"], name), self.axes[body["name"]]))
        return self.points[name]

    def _place(self, body: Numbers, axis: Vector, point: str) -> None:
        """Place a body by the unit vector of its x axis and one of its points whose position is known."""
        self.axes[body["name"]] = axis
        if body["start"] not in self.points:
            self.points[body["start"]] = minus(self.point(point), turned(self.local(body["name"], point), axis))
        if body["end"]:
            self.point(body["end"])

    def _fit(self, body: Numbers, p: str, q: str) -> None:
        """Place a body by two of its points whose positions are known."""
        between, (start, end) = minus(self.point(q), self.point(p)), (body["start"], body["end"])
        if {p, q} == {start, end}:
            axis = minus(self.point(end), self.point(start))
            length = self.size(body["length"])
            self._place(body, (axis[0] / length, axis[1] / length), start)
            return
        lever = minus(self.local(body["name"], q), self.local(body["name"], p))
        x, y = turned_back(between, lever)
        square = dot(lever, lever)
        self._place(body, (x / square, y / square), p)

    def distance(self, body: Numbers, p: str, q: str) -> Ball:
        """Return the distance of two points of a body [m]."""
        if {p, q} == {body["start"], body["end"]}:
            return self.size(body["length"])
        between = minus(self.local(body["name"], q), self.local(body["name"], p))
        return sqrt(dot(between, between))

    # --- guides ----------------------------------------------------------------------------------------------------

    def _local_line(self, guide: Numbers, body: str) -> tuple[Vector, Vector]:
        """Return a point [m] and the unit vector of a guide's line in the axes of one of its bodies."""
        if body == guide["slider"]:
            return self.local(body, guide["at"]), unit(-self.size(guide["tilt"]))
        through = guide["through"]
        point = self.local(body, through) if isinstance(through, str) else (self.size(through[0]), self.size(through[1]))
        axis, offset = unit(self.size(guide["direction"])), self.size(guide["offset"])
        return (point[0] - offset * axis[1], point[1] + offset * axis[0]), axis

    def _line(self, guide: Numbers, body: str) -> tuple[Vector, Vector]:
        """Return a point [m] and the unit vector of a guide's line from the position of one of its bodies."""
        point, axis = self._local_line(guide, body)
        if body == FRAME:
            return point, axis
        return plus(self.points[self.bodies[body]["start"]], turned(point, self.axes[body])), turned(axis, self.axes[body])

    def _across(self, guide: Numbers, body: Numbers, point: str) -> Ball:
        """Return the distance of a point of a body to the left of a guide's line [m]."""
        begin, axis = self._local_line(guide, body["name"])
        return cross(axis, minus(self.local(body["name"], point), begin))

    def slide(self, guide: Numbers) -> Ball:
        """Return the displacement of a slider along its line [m]."""
        begin, axis = self._line(guide, guide["on"])
        return dot(minus(self.point(guide["at"]), begin), axis)

    def _guided(self, dyad: Numbers, number: int) -> tuple[Numbers, str]:
        """Return the guide of a joint of a dyad, and the body of it that is placed before."""
        guide, body = self.linkage["guides"][dyad["outer"][number]], dyad["bodies"][number]["name"]
        return guide, guide["on"] if body == guide["slider"] else guide["slider"]

    # --- dyads: add both bodies, and return the assembly margin ---------------------------------------------------------

    def _triangle(self, dyad: Numbers) -> tuple[Vector, Vector, Ball, Ball]:
        p, q = dyad["outer"]
        first, second = dyad["bodies"]
        lengths = self.distance(first, p, dyad["inner"]), self.distance(second, q, dyad["inner"])
        return self.point(p), minus(self.point(q), self.point(p)), *lengths

    def rrr(self, dyad: Numbers) -> Ball:
        """Two links pinned to known points and to each other: intersection of two circles."""
        (p, q), (first, second) = dyad["outer"], dyad["bodies"]
        begin, (x, y), a, b = self._triangle(dyad)
        inverse = 1.0 / (x * x + y * y)
        foot = 0.5 + 0.5 * (a * a - b * b) * inverse
        margin = a * a * inverse - foot * foot
        height = self.sides[dyad["inner"]] * sqrt(margin)
        self.points[dyad["inner"]] = begin[0] + foot * x - height * y, begin[1] + foot * y + height * x
        self._fit(first, p, dyad["inner"])
        self._fit(second, q, dyad["inner"])
        return margin

    def _height(self, dyad: Numbers) -> tuple[Vector, Vector, Ball, Ball]:
        """Return the line, the offset of the slider's joint, and the distance of the pin to the left of the joint's path."""
        guide, other = self._guided(dyad, 1)
        begin, axis = self._line(guide, other)
        offset = self._across(guide, dyad["bodies"][1], dyad["inner"])
        return begin, axis, offset, cross(axis, minus(self.point(dyad["outer"][0]), begin)) - offset

    def rrp(self, dyad: Numbers) -> Ball:
        """A link pinned to a known point and to a slider on a known line: intersection of a circle and a line."""
        (pin, _), (link, slider) = dyad["outer"], dyad["bodies"]
        begin, axis, offset, height = self._height(dyad)
        length = self.distance(link, pin, dyad["inner"])
        ratio = height / length
        margin = 1.0 - ratio * ratio
        along = dot(axis, minus(self.point(pin), begin)) + self.sides[dyad["inner"]] * (length * sqrt(margin))
        normal = -axis[1], axis[0]
        self.points[dyad["inner"]] = plus(begin, plus(times(along, axis), times(offset, normal)))
        self._fit(link, pin, dyad["inner"])
        self._place(slider, turned_back(axis, self._local_line(self._guided(dyad, 1)[0], slider["name"])[1]), dyad["inner"])
        return margin

    def _pins(self, dyad: Numbers) -> tuple[Vector, Ball]:
        """Return the vector from the pin of the second body to that of the first, and its distance across the line."""
        guide, (first, second) = self.linkage["guides"][dyad["inner"]], dyad["bodies"]
        q, p = dyad["outer"]
        return minus(self.point(q), self.point(p)), self._across(guide, first, q) - self._across(guide, second, p)

    def rpr(self, dyad: Numbers) -> Ball:
        """A slider and the body of its line, each pinned to a known point: a right triangle."""
        (x, y), offset = self._pins(dyad)
        inverse = 1.0 / sqrt(x * x + y * y)
        c, s, across = x * inverse, y * inverse, offset * inverse
        margin = 1.0 - across * across
        axis = turned((c, s), (self.sides[dyad["inner"]] * sqrt(margin), -across))
        guide = self.linkage["guides"][dyad["inner"]]
        for body, pin in zip(dyad["bodies"], dyad["outer"], strict=True):
            self._place(body, turned_back(axis, self._local_line(guide, body["name"])[1]), pin)
        return margin

    def rpp(self, dyad: Numbers) -> Ball:
        """A slider pinned to a known point, on a yoke that slides on a known line: intersection of two lines."""
        (slider, yoke), pin = dyad["bodies"], dyad["outer"][0]
        rail, other = self._guided(dyad, 1)
        inner = self.linkage["guides"][dyad["inner"]]
        begin, line = self._line(rail, other)
        (on_yoke, own_line), (through, inner_line) = (self._local_line(guide, yoke["name"]) for guide in (rail, inner))
        axis = turned_back(line, own_line)
        slot, zero = turned(inner_line, axis), minus(begin, turned(on_yoke, axis))
        sine = cross(slot, line)
        away = minus(self.point(pin), plus(zero, turned(through, axis)))
        shift = (cross(slot, away) - self._across(inner, slider, pin)) / sine
        self.points[yoke["start"]] = plus(zero, times(shift, line))
        self._place(yoke, axis, yoke["start"])
        self._place(slider, turned_back(slot, self._local_line(inner, slider["name"])[1]), pin)
        return sine * sine

    def _lines(self, dyad: Numbers) -> list[tuple[Vector, Vector]]:
        return [self._line(*self._guided(dyad, k)) for k in (0, 1)]

    def prp(self, dyad: Numbers) -> Ball:
        """Two sliders on known lines, pinned to each other: intersection of two lines."""
        (g, w), (h, u) = self._lines(dyad)
        guides = [self._guided(dyad, k)[0] for k in (0, 1)]
        first, second = (self._across(guide, body, dyad["inner"]) for guide, body in zip(guides, dyad["bodies"], strict=True))
        begin = plus(g, times(first, (-w[1], w[0])))
        along = (second - cross(u, minus(begin, h))) / cross(u, w)
        self.points[dyad["inner"]] = plus(begin, times(along, w))
        for guide, body, line in zip(guides, dyad["bodies"], (w, u), strict=True):
            self._place(body, turned_back(line, self._local_line(guide, body["name"])[1]), dyad["inner"])
        sine = cross(w, u)
        return sine * sine

    def cosine(self, dyad: Numbers) -> Ball:
        """Return the cosine of the transmission angle of a dyad."""
        kind = dyad["kind"]
        if kind == "RRR":
            _, between, a, b = self._triangle(dyad)
            return (a * a + b * b - dot(between, between)) / (2.0 * (a * b))
        if kind == "RRP":
            return -self._height(dyad)[3] / self.distance(dyad["bodies"][0], dyad["outer"][0], dyad["inner"])
        if kind == "RPR":
            between, offset = self._pins(dyad)
            return offset / sqrt(dot(between, between))
        if kind == "RPP":
            rail, other = self._guided(dyad, 1)
            return dot(
                self._line(rail, other)[1], self._line(self.linkage["guides"][dyad["inner"]], dyad["bodies"][1]["name"])[1]
            )
        first, second = self._lines(dyad)
        return dot(first[1], second[1])

    def alignment(self, dyad: Numbers) -> Ball:
        """Return the squared sine of the angle of a dyad from the position in which it locks."""
        if dyad["kind"] == "RRR":
            _, between, a, b = self._triangle(dyad)
            square, short, long = dot(between, between), a - b, a + b
            return (square - short * short) * (long * long - square) / (4.0 * a * a * b * b)
        if dyad["kind"] == "RPR":
            between, offset = self._pins(dyad)
            crank = self.size(self.linkage["crank"]["length"])
            return (dot(between, between) - offset * offset) / (crank * crank)
        return self.margins[joint_of(dyad)]


_DYADS = {"RRR": Pose.rrr, "RRP": Pose.rrp, "RPR": Pose.rpr, "RPP": Pose.rpp, "PRP": Pose.prp}


def bodies(linkage: Numbers) -> list[Numbers]:
    """Return the moving bodies of a linkage, the crank first."""
    return [linkage["crank"], *(body for dyad in linkage["dyads"] for body in dyad["bodies"])]


def joint_of(dyad: Numbers) -> str:
    """Return the name of the joint between the two bodies of a dyad."""
    return str(dyad["inner"])


# --- the problem ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Deviation:
    """One component of the deviation at a position: a lower bound of its size over the box; itself, where it is smooth."""

    least: Any
    model: Ball | None


class Problem:
    """The problem of a certificate with one assembly mode, over boxes of its design variables."""

    def __init__(self, numbers: Numbers, mode: Numbers) -> None:
        self.numbers, self.sides = numbers, mode["sides"]
        self.names = [name for name, quantity in numbers["quantities"].items() if quantity["free"]]
        self.low = [float(numbers["quantities"][name]["low"]) for name in self.names]
        self.high = [float(numbers["quantities"][name]["high"]) for name in self.names]
        self.linkage, self.limits, self.kind = numbers["linkage"], numbers["limits"], numbers["kind"]
        self.measure, self.offsets = numbers["measure"], numbers["offsets"]
        self.four_bar = self.linkage["four_bar"]
        self.of_law = self.kind == "law"
        self.start_names: tuple[str, str] = tuple(numbers.get("names", ("phi0", "psi0")))

    @property
    def side(self) -> int:
        """Assembly mode of a four-bar: +1 if C lies to the left of B -> D."""
        (dyad,), side = self.linkage["dyads"], int(next(iter(self.sides.values())))
        return side if dyad["outer"][0] == self.linkage["crank"]["end"] else -side

    def _lengths(self, values: Values) -> dict[str, Ball]:
        """Return the lengths of a four-bar, that of the frame between its pivots if they are given by coordinates."""
        (dyad,), pin = self.linkage["dyads"], self.linkage["crank"]["end"]
        coupler, rocker = sorted(dyad["bodies"], key=lambda body: pin not in (body["start"], body["end"]))
        named = {"crank": self.linkage["crank"], "coupler": coupler, "rocker": rocker}
        return {**{name: values[body["length"]] for name, body in named.items()}, "frame": self._frame(values)[0]}

    def _frame(self, values: Values) -> tuple[Ball, Vector | None]:
        """Return the length of the frame, and its direction where crank angles count from; None if it is the same."""
        crank, (dyad,) = self.linkage["crank"], self.linkage["dyads"]
        pin = next(joint for joint in dyad["outer"] if joint != crank["end"])
        one, other = self.linkage["ground"][crank["start"]], self.linkage["ground"][pin]
        if isinstance(other, dict):
            return values[other["length"]], None
        (ax, ay), (dx, dy) = (
            [values[size] if isinstance(size, str) else constant(size) for size in place] for place in (one, other)
        )
        across, along = dy - ay, dx - ax
        if across.slope is None and across.value == 0 and along.range > 0:
            return along, None
        length = sqrt(along * along + across * across)
        return length, (along / length, across / length)

    def values(self, centre: Sequence[float], scale: Sequence[Any] | None, *, over: bool = True) -> dict[str, Ball]:
        """Return every quantity over a box with half widths `scale`, or those of a single design without derivatives."""
        values = {name: constant(quantity["value"]) for name, quantity in self.numbers["quantities"].items()}
        for k, name in enumerate(self.names):
            one = constant(centre[k])
            values[name] = one if scale is None else Ball.variable(k, len(self.names), centre[k], scale[k], over=over)
        for link in self.numbers.get("links", ()):
            values[link["name"]] = linked(link["steps"], values)
        return values

    # --- deviations ------------------------------------------------------------------------------------------------

    def starts(self, values: Values) -> list[tuple[Vector, Ball, Ball]]:
        """Return crank direction, crank angle and output at the start: several, if an angle passes half a turn in the box.

        The angles of the start position lie within -pi ... pi; those of the balls are continuous, and may lie beyond.
        """
        if not self.of_law:
            start = values.get("start", constant(0.0))
            return [(unit(start), start, values.get("zero", constant(0.0)))]
        begin, base = self.start_names
        if begin in values:
            crank, phis = unit(values[begin]), [values[begin]]
            rocker = None if base in values else self._pose(values, crank).axes[self.numbers["output"]]
        else:
            crank, rocker = self._dead_centre(values, outer=self.numbers["start"] == OUTER)
            phis = _principal(angle_of(crank))
        psis = [values[base]] if base in values else _principal(angle_of(rocker)) if rocker else []
        return [(crank, phi, psi) for phi in phis for psi in psis]

    def _pose(self, values: Values, crank: Vector) -> Pose:
        return Pose(self.linkage, self.sides, values, crank)

    def _dead_centre(self, values: Values, *, outer: bool) -> tuple[Vector, Vector]:
        """Return the directions of crank and rocker in a dead centre: law of cosines in the triangle A-C-D."""
        crank, coupler, rocker, frame = (self._lengths(values)[name] for name in LENGTHS)
        reach = coupler + crank if outer else coupler - crank
        cosine = (reach * reach - rocker * rocker + frame * frame) / (2.0 * (reach * frame))
        sine = self.side * sqrt(1.0 - cosine * cosine)
        direction = ((reach * cosine - frame) / rocker, reach * sine / rocker)
        axes = ((cosine, sine) if outer else (-cosine, -sine)), direction
        along = self._frame(values)[1]
        return axes if along is None else (turned(axes[0], along), turned(axes[1], along))

    def deviation(self, position: int, values: Values, start: tuple[Vector, Ball, Ball]) -> list[Deviation]:
        """Return the components of the weighted deviation at a position, from one of `starts`."""
        numbers, (crank, phi0, psi0) = self.numbers, start
        offset = constant(self.offsets[position])
        if self.kind == "transmission":
            return [_plain(self._cosine(values, constant(math.cos(self.offsets[position] - self.offsets[0]))))]
        pose = self._pose(values, turned(crank, unit(offset)) if self.of_law else unit(phi0 + offset))
        if self.kind in ("law", "function"):
            wanted = target(numbers["law"], position, offset, phi0, psi0)
            if numbers["slides"]:
                return [_plain(pose.slide(self.linkage["guides"][numbers["output"]]) - wanted)]
            return [_turned(angle_between(unit(wanted), pose.axes[numbers["output"]]))]
        row, weight = numbers["targets"][position], numbers["roots"][position]
        x, y = pose.point(numbers["point"])
        components = [_plain(x - row[0]), _plain(y - row[1])]
        if self.kind == "motion":
            body = turned(pose.axes[numbers["body"]], unit(values["mark"]))
            components.append(_scaled(_turned(angle_between((ball(row[2]), ball(row[3])), body)), numbers["radian"]))
        return [_scaled(component, weight) for component in components]

    def deviations(self, values: Values, start: tuple[Vector, Ball, Ball]) -> list[list[Deviation]]:
        """Return the components of the weighted deviation at every position."""
        return [self.deviation(k, values, start) for k in range(len(self.offsets))]

    # --- limits ----------------------------------------------------------------------------------------------------

    def slacks(self, values: Values, *, fixed: bool = False) -> list[tuple[str, Ball]]:
        """Return the key of the limit and the slack, not negative for a feasible design, of every side of every row.

        With `fixed`, all rows that do not depend on the design are included, not only those that every design misses.
        """
        slacks = []
        for key, value, low, high in self._rows(values):
            for slack in ([value - low] if math.isfinite(low) else []) + ([high - value] if math.isfinite(high) else []):
                if slack.slope is not None or fixed or bool(slack.centre < -FIXED_LIMIT_TOLERANCE):
                    slacks.append((key, slack))
        return slacks

    def _rows(self, values: Values) -> Iterator[Limit]:
        begin = self.starts(values)[0][1]
        if self.four_bar:
            yield from self._crank(values)
            yield from self._start_at_dead_centre(values)
            yield from self._transmission(values, begin)
        yield from self._further(values)
        yield from self._pivots(values)
        for link in self.numbers.get("links", ()):
            low, high = link["low"], link["high"]
            yield link["key"], values[link["name"]], -math.inf if low is None else low, math.inf if high is None else high
        if not self.of_law and not self.four_bar:
            yield from self._single_positions(values, begin)
        yield from self._tolerances(values)

    def _crank(self, values: Values) -> Iterator[Limit]:
        """Yield Grashof's conditions with the driven link (crank-rocker) or the frame (double-crank) as the shortest."""
        if self.limits["crank"] == "span":
            return
        shortest, fourth = ("crank", "frame") if self.limits["crank"] == "full rotation" else ("frame", "crank")
        others, margin, values = ("coupler", "rocker", fourth), self.limits["length_margin"], self._lengths(values)
        for name in others:
            yield "limits.crank", values[name] - values[shortest], 0.0, math.inf
        for longest in (fourth, "coupler", "rocker"):
            one, other = (values[name] for name in others if name != longest)
            slack = one + other - values[shortest] - values[longest] - margin * values[longest]
            yield "limits.length_margin", slack, 0.0, math.inf

    def _start_at_dead_centre(self, values: Values) -> Iterator[Limit]:
        """Yield the conditions for the dead centre at which a law starts, if the crank need not turn fully."""
        if self.limits["crank"] != "span" or not self.of_law or self.start_names[0] in values:
            return
        crank, coupler, rocker, frame = (self._lengths(values)[name] for name in LENGTHS)
        line = coupler + crank if self.numbers["start"] == OUTER else absolute(coupler - crank)  # A-C
        for longest in (crank, coupler, rocker, frame):
            for slack in (rocker + frame - line, line - rocker + frame, line - frame + rocker):  # triangle A-C-D
                yield "limits.length_margin", slack - self.limits["length_margin"] * longest, 0.0, math.inf

    def _cosine(self, values: Values, cosine: Ball) -> Ball:
        """Return the cosine of the angle B-C-D for that of the crank angle: law of cosines in A-B-D and B-C-D."""
        crank, coupler, rocker, frame = (self._lengths(values)[name] for name in LENGTHS)
        diagonal = crank * crank + frame * frame - 2.0 * crank * frame * cosine
        return (coupler * coupler + rocker * rocker - diagonal) / (2.0 * coupler * rocker)

    @property
    def _required(self) -> str:
        return "span" if self.limits["crank"] == "span" else "revolution"

    def _cosine_limits(self, joint: str) -> Iterator[tuple[str, float, float, str]]:
        """Yield key, bounds of the cosine of the transmission angle and their crank range, those of the alignment last."""
        most, prescribed = math.cos(self.limits["alignment"]), self.limits["transmission"].get(joint)
        low, high = -math.inf, math.inf
        if prescribed is not None:
            low = low if prescribed["high"] is None else math.cos(prescribed["high"])
            high = high if prescribed["low"] is None else math.cos(prescribed["low"])
            low, high = low if low >= -most - COSINE_ROUNDING else -math.inf, high if high <= most + COSINE_ROUNDING else math.inf
            if math.isfinite(low) or math.isfinite(high):
                yield prescribed["key"], low, high, self.limits["over"]
        replaced = self.limits["over"] == self._required  # by a limit of the problem that is as tight
        floor = -math.inf if replaced and abs(low + most) <= COSINE_ROUNDING else -most
        ceiling = math.inf if replaced and abs(high - most) <= COSINE_ROUNDING else most
        if math.isfinite(floor) or math.isfinite(ceiling):
            yield "limits.alignment", floor, ceiling, self._required

    def _transmission(self, values: Values, begin: Ball) -> Iterator[Limit]:
        """Yield the limits of the transmission angle at its extremes, with the crank in line with the frame or at an end."""
        along = self._frame(values)[1]
        begin = begin if along is None else begin - angle_of(along)
        for key, low, high, over in self._cosine_limits(joint_of(self.linkage["dyads"][0])):
            if over == "revolution" and not key.startswith("limits.pressure_angle"):
                yield key, self._cosine(values, constant(1.0)), -math.inf, high
                yield key, self._cosine(values, constant(-1.0)), low, math.inf
                continue
            cosines = [constant(1.0), constant(-1.0)]
            if over == "span":
                begin = begin if self.of_law else begin + self.offsets[0]
                span = self.numbers["span"] if self.of_law else self.offsets[-1] - self.offsets[0]
                first, last = (begin, begin + span) if span >= 0.0 else (begin + span, begin)
                inner = (-maximum(-maximum(constant(k * math.pi), first), -last) for k in range(-4, 5))
                cosines = [unit(angle)[0] for angle in (first, last, *inner)]
            for cosine in cosines:
                yield _cosine_row(key, self._cosine(values, cosine), low, high)

    def _further(self, values: Values) -> Iterator[Limit]:
        """Yield the limits of single quantities; one that this program does not know is left out."""
        for limit in self.limits["further"]:
            bounds = (-math.inf if limit["low"] is None else limit["low"]), (math.inf if limit["high"] is None else limit["high"])
            for value in self._limited(limit, values):
                yield f"limits.{limit['name']}", value, *bounds

    def _limited(self, limit: Numbers, values: Values) -> Iterator[Ball]:
        name = limit["name"]
        if name == "frame_length":
            yield self._lengths(values)["frame"]
        elif name == "link_ratio":
            lengths = self._lengths(values)
            yield from (lengths[link] / lengths["frame"] for link in LENGTHS[:3])
        elif name in ("swing_angle", "time_ratio"):
            (outer, first), (inner, second) = (self._dead_centre(values, outer=outer) for outer in (True, False))
            if name == "swing_angle":
                yield self.side * angle_between(first, second, principal=True)
                return
            sense = 1 if (self.numbers["span"] if self.of_law else self.offsets[-1] - self.offsets[0]) >= 0.0 else -1
            theta = self.side * sense * angle_between(outer, (-inner[0], -inner[1]), principal=True)
            theta = theta if limit["stroke"] in ("forward", "backward") else absolute(theta)
            theta = -theta if limit["stroke"] in ("backward", "quick") else theta
            yield (math.pi + theta) / (math.pi - theta)

    def _pivots(self, values: Values) -> Iterator[Limit]:
        region = self.limits["pivots"]
        if region is None:
            return
        pose = self._pose(values, unit(constant(0.0)))
        for name in self.linkage["ground"]:
            for axis, coordinate in zip("xy", pose.points[name], strict=True):
                low, high = region[axis]
                bounds = (-math.inf if low is None else low), (math.inf if high is None else high)
                yield "limits.pivots", coordinate, *bounds

    def _single_positions(self, values: Values, begin: Ball) -> Iterator[Limit]:
        """Yield the limits of single crank angles: over the span at the positions of the target, else over a revolution."""
        over_span = [self._pose(values, unit(begin + offset)) for offset in self.offsets]
        whole = over_span
        if self._required == "revolution":
            whole = [self._pose(values, unit(constant(math.tau * k / GRID))) for k in range(GRID)]
        for dyad in self.linkage["dyads"]:
            aligned = dyad["kind"] != "RRR"
            for key, low, high, over in self._cosine_limits(joint_of(dyad)):
                aligned |= key == "limits.alignment"
                if key != "limits.alignment":
                    poses = over_span if over != self._required else whole
                    rows = [_cosine_row(key, pose.cosine(dyad), low, high) for pose in poses]
                    yield from ((key, value, low, math.inf) for key, value, low, _ in rows if math.isfinite(low))
                    yield from ((key, value, -math.inf, high) for key, value, _, high in rows if math.isfinite(high))
            if aligned:
                least = math.sin(self.limits["alignment"]) ** 2
                yield from (("limits.alignment", pose.alignment(dyad), least, math.inf) for pose in whole)

    def _tolerances(self, values: Values) -> Iterator[Limit]:
        if self.kind not in ("path", "motion") or all(tolerance is None for tolerance in self.numbers["tolerances"]):
            return
        start = self.starts(values)[0]
        for k, (tolerance, root) in enumerate(zip(self.numbers["tolerances"], self.numbers["roots"], strict=True)):
            if tolerance is not None:
                x, y = (deviation.model for deviation in self.deviation(k, values, start)[:2])
                distance = undefined(NAN, NAN, *values.values()) if x is None or y is None else x * x + y * y
                most = tolerance * root
                yield "requirement.points", -distance, -most * most, math.inf


def _cosine_row(key: str, cosine: Ball, low: float, high: float) -> Limit:
    """Return the row of a limit of the transmission angle, or of the pressure angle, which lies on both sides of 90 deg."""
    if key.startswith("limits.pressure_angle"):
        return key, cosine * cosine, -math.inf, high * high
    return key, cosine, low, high


def _principal(angle: Ball) -> list[Ball]:
    """Return the angles within -pi ... pi that a continuous one, which may lie beyond, can stand for over the box."""
    turn, angles = 2 * arb.pi(), [angle]
    if not angle.range < arb.pi():
        angles.append(angle - turn)
    if not angle.range > -arb.pi():
        angles.append(angle + turn)
    return angles


def _plain(model: Ball) -> Deviation:
    inside = model.range
    least = inside.lower().max(-inside.upper()).max(arb(0)) if inside.is_finite() else arb(0)
    return Deviation(least, model if model.known else None)


def _turned(model: Ball) -> Deviation:
    """Return a deviation in angle: the difference from the nearest full turn."""
    plain = _plain(model)
    if plain.model is None or (model.range < arb.pi() and model.range > -arb.pi()):
        return plain
    farthest = model.range.abs_upper()
    return Deviation(plain.least.min((2 * arb.pi() - farthest).max(arb(0))), None)


def _scaled(one: Deviation, factor: float) -> Deviation:
    return Deviation(one.least * arb(factor), None if one.model is None else one.model * factor)
