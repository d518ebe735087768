"""Views of parts on paper [mm]: lines, texts and dimensions, drawn alike in every kind of file."""

import math
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol, Self

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.presentation.export.dxf import Vertex, rounded
from optlink.presentation.parts.model import number
from optlink.presentation.parts.solids import polygon
from optlink.presentation.placement import arrange, beside, short_name
from optlink.presentation.shapes import left_of

TEXT, SMALL = 3.5, 2.5  # heights of letters
ARROW = 3.0
GAP = 1.0  # of a text to its line, of an extension line to its hole
FIRST = 9.0  # distance of the first dimension line from the outline
LETTER, WIDE_LETTER = 0.9, 1.6  # widths of letters in heights
SAME = 1e-6  # distance of coincident lines
REACHES = np.array([0.8, 2.5, 5.0, 8.0])  # distances of a name from its circle
Style = Literal["outline", "thin", "centre", "solid"]


class Pen(Protocol):
    """Draws into a file."""

    def line(self, one: "Line") -> None:
        """Draw a line."""

    def words(self, one: "Words") -> None:
        """Draw a text."""

    def measure(self, one: "Measure") -> None:
        """Draw a dimension."""


@dataclass(frozen=True, eq=False)
class Line:
    """Straight edges and arcs; a circle is two arcs."""

    vertices: tuple[Vertex, ...]
    style: Style = "thin"
    closed: bool = False

    @property
    def corners(self) -> Array:
        """Its polygon (n, 2)."""
        return polygon(self.vertices)

    @property
    def traces(self) -> tuple[Array, ...]:
        """Its line (n, 2)."""
        return (np.concatenate([self.corners, self.corners[: int(self.closed)]]),)

    def draw(self, pen: Pen) -> None:
        """Draw it by a pen."""
        pen.line(self)

    def moved(self, shift: Array) -> Self:
        """Return it shifted by a vector (2,)."""
        return replace(self, vertices=tuple((x + float(shift[0]), y + float(shift[1]), bulge) for x, y, bulge in self.vertices))


@dataclass(frozen=True, eq=False)
class Words:
    """A text of one line, turned by an angle [deg] about the middle of its height at its left or right end or its centre."""

    text: str
    at: Array
    height: float = TEXT
    angle: float = 0.0
    align: Literal["left", "center", "right"] = "center"

    @property
    def corners(self) -> Array:
        """The rectangle (4, 2) that it may occupy."""
        wide, half = width(self.text, self.height), 0.5 * self.height
        low = {"left": 0.0, "center": -0.5, "right": -1.0}[self.align] * wide
        high = low + wide
        c, s = math.cos(math.radians(self.angle)), math.sin(math.radians(self.angle))
        return np.asarray(
            self.at + np.array([[low, -half], [high, -half], [high, half], [low, half]]) @ np.array([[c, s], [-s, c]])
        )

    @property
    def traces(self) -> tuple[Array, ...]:
        """A line (n, 2) across its letters."""
        return (self.corners[[0, 1, 2, 3, 0, 2, 1, 3]],)

    def draw(self, pen: Pen) -> None:
        """Draw it by a pen."""
        pen.words(self)

    def moved(self, shift: Array) -> Self:
        """Return it shifted by a vector (2,)."""
        return replace(self, at=self.at + shift)


@dataclass(frozen=True, eq=False)
class Measure:
    """A dimension between two points (2, 2), along x or, if upright, along y; its line is at `line` of the other axis.

    `factor`: millimetres on paper for one of the part; `tolerance` is added to the text, which of a short one lies beyond the
    first end or, if `turned`, the second.
    """

    ends: Array
    line: float
    upright: bool
    factor: float
    tolerance: str = ""
    turned: bool = False

    @property
    def text(self) -> str:
        """The true measure."""
        begin, end = self.ends[:, int(self.upright)]
        return number(abs(end - begin) / self.factor) + self.tolerance

    @property
    def tight(self) -> bool:
        """Whether text and arrows have no room between the ends."""
        begin, end = self.ends[:, int(self.upright)]
        return bool(abs(end - begin) < width(self.text) + 2.0 * ARROW)

    @property
    def words(self) -> Words:
        """Its text: above the middle of its line, or beyond an end of a short one."""
        near, far = self.ends[::-1, int(self.upright)] if self.turned else self.ends[:, int(self.upright)]
        middle = near - math.copysign(0.5 * width(self.text) + 2.5 * ARROW, far - near) if self.tight else 0.5 * (near + far)
        beside = 0.5 * TEXT + GAP
        at = [self.line - beside, middle] if self.upright else [middle, self.line + beside]
        return Words(self.text, np.array(at), angle=90.0 * self.upright)

    @property
    def pieces(self) -> tuple[Line | Words, ...]:
        """What is drawn of it."""
        feet = self.ends.copy()
        feet[:, 1 - int(self.upright)] = self.line
        along = (feet[1] - feet[0]) / max(float(np.linalg.norm(feet[1] - feet[0])), SAME)
        beyond = np.sign(feet - self.ends) * GAP
        outward = -1.0 if self.tight else 1.0
        line = feet + outward * 2.0 * ARROW * np.array([along, -along]) if self.tight else feet
        tips = (arrow(feet[0], outward * along), arrow(feet[1], -outward * along))
        extensions = (segment(end, foot + more) for end, foot, more in zip(self.ends, feet, beyond, strict=True))
        return segment(*line), *tips, *extensions, self.words

    @property
    def corners(self) -> Array:
        """Corners (n, 2) of what is drawn."""
        return np.concatenate([piece.corners for piece in self.pieces])

    @property
    def traces(self) -> tuple[Array, ...]:
        """Lines (n, 2) of what is drawn."""
        return tuple(trace for piece in self.pieces for trace in piece.traces)

    def draw(self, pen: Pen) -> None:
        """Draw it by a pen."""
        pen.measure(self)

    def moved(self, shift: Array) -> Self:
        """Return it shifted by a vector (2,)."""
        return replace(self, ends=self.ends + shift, line=self.line + float(shift[1 - int(self.upright)]))


Item = Line | Words | Measure


def width(text: str, height: float = TEXT) -> float:
    """Return the width that a text needs."""
    return height * sum(WIDE_LETTER if unicodedata.east_asian_width(letter) in "WF" else LETTER for letter in text)


def scale_text(factor: float) -> str:
    """Format a scale: millimetres on paper for one of the part."""
    return f"{factor:g}:1" if factor >= 1.0 else f"1:{1.0 / factor:g}"


def segment(*points: Array) -> Line:
    """Return a thin line through points (2,)."""
    return Line(tuple((float(x), float(y), 0.0) for x, y in points))


def arrow(tip: Array, way: Array) -> Line:
    """Return a filled arrow head; `way` is the unit vector from its tip along its line."""
    side = left_of(way) * ARROW / 6.0
    return replace(segment(tip, tip + ARROW * way + side, tip + ARROW * way - side), style="solid", closed=True)


def circle(at: Array, radius: float, style: Style = "thin") -> Line:
    """Return a circle."""
    return Line(rounded(at[None], radius), style, closed=True)


def box(items: Iterable[Item]) -> Array:
    """Return the lower left and upper right corner (2, 2) of what is drawn."""
    corners = np.concatenate([item.corners for item in items])
    return np.array([corners.min(axis=0), corners.max(axis=0)])


def letters(points: Sequence[tuple[str, Array, float]], items: Iterable[Item]) -> list[Words]:
    """Return names beside circles of centres (2,) and radii, clear of what is drawn."""
    names = [short_name(name) for name, *_ in points]
    drawing = [(trace[None], 1.0) for item in items for trace in item.traces]
    texts = []
    for name, (_, at, radius) in zip(names, points, strict=True):
        half = 0.5 * np.array([width(name, SMALL), SMALL])
        others = [other[None] for _, other, _ in points if other is not at]
        texts.append(beside(at[None], half, radius + REACHES, 0.5, others, (0.1, 0.1)))
    places = [text.at[0] + text.middles[choice[0]] for text, choice in zip(texts, arrange(texts, drawing, SMALL), strict=True)]
    return [Words(name, place, SMALL) for name, place in zip(names, places, strict=True)]
