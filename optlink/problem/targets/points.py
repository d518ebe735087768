"""Target points of a path, or poses of a body: a list, a CSV file, a drawing (SVG), or expressions in t."""

from __future__ import annotations

import cmath
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array, all_finite
from optlink.problem.quantity import LONGEST, SHORTEST, Unusable, below, check_keys, check_pair, is_number, read_scalar
from optlink.problem.targets.expression import Expression, LawError, parse
from optlink.problem.targets.target_points import (
    COINCIDENT,
    HEAVIEST,
    PointRows,
    TargetPoints,
    check_and_reduce,
    check_apart,
    metres,
    pairs,
    read_count,
    read_csv_rows,
    read_file,
    read_rows,
    shortened,
)
from optlink.units import show

# Curves sampled evenly by arc length, and curves defined by expressions in t.

FINE = 100_000  # chords that approximate a curve; for a full circle the length error is 2e-10


@dataclass(frozen=True)
class CurvePiece:
    """A piece of a curve: `at` returns its points (n, 2) [m] at u (n,) from 0 to 1; `chords` chords approximate it."""

    at: Callable[[Array], Array]
    chords: int


def resample(pieces: Sequence[CurvePiece], count: int) -> tuple[Array, bool, float]:
    """Return points (count, 2) [m] exactly on a curve, evenly by arc length, whether it is closed, and its length [m].

    The first point of a closed curve is not repeated.

    Raises
    ------
    Unusable
        when the curve is too large or has no length.
    """
    traced = [piece.at(np.linspace(0.0, 1.0, piece.chords + 1)) for piece in pieces]
    chords = np.concatenate([np.hypot(*np.diff(points, axis=0).T) for points in traced])
    starts = np.concatenate([[0], np.cumsum([piece.chords for piece in pieces])])
    here = np.concatenate([[0.0], np.cumsum(chords)])
    low = np.min([points.min(axis=0) for points in traced], axis=0)
    high = np.max([points.max(axis=0) for points in traced], axis=0)
    size = float(np.hypot(*(high - low)))
    if not max(np.max(np.abs(low)), np.max(np.abs(high))) <= LONGEST:  # NaN too
        raise Unusable("the curve is too large for a linkage", "Check its numbers and its unit")
    if size < SHORTEST:
        raise Unusable("the curve has no length", "Check its numbers and its unit")
    loop = bool(np.hypot(*(traced[-1][-1] - traced[0][0])) <= COINCIDENT * size)
    targets = np.linspace(0.0, here[-1], count, endpoint=not loop)
    index = np.clip(np.searchsorted(here, targets, side="right") - 1, 0, len(chords) - 1)
    fraction = (targets - here[index]) / np.where(chords[index] > 0.0, chords[index], 1.0)
    piece = np.clip(np.searchsorted(starts, index, side="right") - 1, 0, len(pieces) - 1)
    u = np.clip([(i - starts[p] + f) / pieces[p].chords for i, f, p in zip(index, fraction, piece, strict=True)], 0.0, 1.0)
    return np.concatenate([pieces[p].at(at[None]) for p, at in zip(piece, u, strict=True)]), loop, float(here[-1])


def sampled_targets(points: Array, unit: str, loop: bool, note: str) -> TargetPoints:
    """Return points (n, 2) [m] sampled from a curve as targets; `loop`: the curve is closed."""
    check_apart(PointRows(dict(zip("xy", points.T, strict=True)), unit, key="points"))
    return TargetPoints(pairs(points), unit=unit, note=f"{note}; it is closed" if loop else note, loop=loop, sampled=True)


def expression_curve(raw: Mapping[str, Any]) -> TargetPoints:
    """Return points of a curve whose coordinates are expressions in t.

    Raises
    ------
    Unusable
        If a key is missing or invalid, or an expression is not finite or too large in the range of t.
    """
    for key, example in (("x", '"20*cos(t)"'), ("y", '"10*sin(t)"'), ("t", '[0, "2*pi"]'), ("unit", '"mm"')):
        if key not in raw:
            remedy = f'Add {key} = {example}; listed points are written [["20 mm", "25 mm"], ...]'
            raise Unusable(f"expressions of points need {key}", remedy, key)
    unit, size, count = raw["unit"], metres(raw), read_count(raw)
    spacing = raw.get("spacing", "t")
    if spacing not in ("t", "arc length"):
        raise Unusable("unknown spacing of the points", 'Write "t" or "arc length"', "spacing", spacing)
    x, y = (_expression(raw[key], ("t",), key) for key in ("x", "y"))
    bounds = raw["t"]
    check_pair(bounds, "t needs two values, first and last", 'Write t = [0, "2*pi"]', "t")
    begin, end = (_bound(bound, f"t[{number}]") for number, bound in enumerate(bounds))
    if begin == end:
        raise Unusable("t starts where it ends", 'Write t = [0, "2*pi"], for example', "t[1]", bounds[1])
    fine = np.linspace(begin, end, FINE + 1)
    for key, law in (("x", x), ("y", y)):
        worry = law.hazards({"t": fine})
        if not worry and np.max(np.abs(np.asarray(law({"t": fine}), dtype=float))) * size > LONGEST:
            worry = f"exceeds {LONGEST / 1e3:g} km"
        if worry:
            message = f"{key} {worry} between t = {begin:.6g} and t = {end:.6g}"
            raise Unusable(message, "Choose another range of t", key, shortened(raw[key]))

    def at(u: Array) -> Array:
        variables = {"t": begin + (end - begin) * u}
        return np.stack([np.broadcast_to(np.asarray(law(variables), dtype=float), u.shape) for law in (x, y)], axis=1) * size

    points, loop, length = resample([CurvePiece(at, FINE)], count)
    if spacing == "t":
        points = at(np.linspace(0.0, 1.0, count, endpoint=not loop))
    note = f"the target is a curve {show(length, 'length', unit)} long, sampled at {count} points evenly by {spacing}"
    return sampled_targets(points, unit, loop, note)


def _expression(raw: object, names: Iterable[str], key: str) -> Expression:
    if not isinstance(raw, str):
        raise Unusable("an expression is text", f'Write {key} = "20*cos(t)", for example', key, raw)
    with below(key, shortened(raw)):
        return parse(raw, names)


def _bound(raw: object, key: str) -> float:
    remedy = 'Write a plain number or a constant expression, for example 0 or "2*pi"'
    value: Any = raw
    if isinstance(raw, str):
        try:
            value = parse(raw, ())({})
        except LawError as error:
            raise Unusable(error.message, remedy, key, shortened(raw)) from None
    elif not is_number(raw):
        raise Unusable("expected a bound of t", remedy, key, raw)
    if not abs(value) <= HEAVIEST:  # NaN too
        raise Unusable("the bound of t is not finite, or too large", remedy, key, shortened(raw))
    return float(value)


# A shape of a drawing (an SVG file) in its position there, sampled evenly by arc length.

Drawn = NDArray[np.complex128]

MAX_ELEMENTS = 1_000_000
MAX_SEGMENTS = 100_000  # largest number per path

_SVG = "http://www.w3.org/2000/svg"
_SHAPES = ("path", "line", "polyline", "polygon", "rect", "circle", "ellipse")
_PLAIN = ("g", "a", "switch")  # permitted parents of a shape; defs, symbols, nested drawings and the like place it elsewhere
_MOVING = ("animate", "animateTransform", "animateMotion", "set")
_PROPERTY = re.compile(r"transform(?:-origin)?|translate|rotate|scale|offset-path|zoom|d|c[xy]|r[xy]?", re.IGNORECASE)
PIXELS = 96  # an inch, of CSS
_PIXEL = 25.4 / PIXELS  # mm
_MILLIMETRES = {"px": _PIXEL, "mm": 1.0, "cm": 10.0, "in": 25.4, "pt": 25.4 / 72.0, "pc": 25.4 / 6.0, "q": 0.25}
_FLATTEN = "Flatten it (Inkscape: Path > Object to Path, ungroup, save as Plain SVG)"

_N = r"(?>[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)"
_S = r"(?>[ \t\r\n]*)"
_C = rf"(?>{_S},?{_S})"
# svg.path drops what it cannot read at the end of a command, so the whole text is first matched against the grammar; nothing
# in it is tried twice (atomic groups), so its time is linear
_GRAMMAR = re.compile(
    rf"{_S}(?=[Mm])(?>(?:(?:[MmLlTt]{_S}(?>(?:{_N}{_C}){{2}})++|[HhVv]{_S}(?:{_N}{_C})++|[Cc]{_S}(?>(?:{_N}{_C}){{6}})++"
    rf"|[SsQq]{_S}(?>(?:{_N}{_C}){{4}})++|[Aa]{_S}(?>(?:(?!-){_N}{_C}){{2}}{_N}{_C}[01]{_C}[01]{_C}(?:{_N}{_C}){{2}})++|[Zz]{_S})"
    rf"(?=[A-Za-z]|\Z))*+)"
)
_FUNCTION = re.compile(rf"{_C}(matrix|translate|scale|rotate|skewX|skewY){_S}\(([^()]*)\){_C}")


@dataclass
class _Element:
    """An element of a drawing. `drawn`: rendered in place, not through a copy; `moved`: by an animation."""

    tag: str
    attributes: Mapping[str, str]
    parent: _Element | None
    drawn: bool
    moved: bool = False

    @property
    def id(self) -> str:
        return self.attributes.get("id", "")

    @property
    def label(self) -> str:
        """Name that the user of Inkscape gave it."""
        return self.attributes.get("http://www.inkscape.org/namespaces/inkscape label", "")

    @property
    def listed(self) -> str:
        """Name in a list, with its label and its layer."""
        layer = next((element.label for element in self.chain()[-2::-1] if element.label), "")
        words = [f'"{shortened(self.label)}"' * bool(self.label), f'in the layer "{shortened(layer)}"' * bool(layer)]
        return " ".join(filter(None, (str(self), *words)))

    def __str__(self) -> str:
        return f'<{self.tag} id="{shortened(self.id)}">' if self.id else f"<{self.tag}>"

    def chain(self) -> list[_Element]:
        """Return the elements from the root to this one."""
        elements = [self]
        while (parent := elements[-1].parent) is not None:
            elements.append(parent)
        return elements[::-1]


def _elements(data: bytes, name: str) -> tuple[_Element, list[_Element], str]:
    """Return root, shapes and style sheets of a drawing.

    The file is read by expat rather than into a tree: a file that declares entities is refused before they can expand, and
    elements other than shapes take no memory. A DOCTYPE that only refers to another file is accepted but never followed.
    """
    parser = expat.ParserCreate(namespace_separator=" ")
    open_now: list[_Element] = []
    roots: list[_Element] = []
    shapes: list[_Element] = []
    sheets: list[str] = []
    count, declared = 0, False

    def start(spelled: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MAX_ELEMENTS:
            raise Unusable(f"{name} has more than {MAX_ELEMENTS:,} elements", "Save the curve alone", "svg", name)
        space, _, tag = spelled.rpartition(" ")
        above = open_now[-1] if open_now else None
        drawn = above is None or above.parent is None or (above.drawn and above.tag in _PLAIN)
        element = _Element(tag if space in ("", _SVG) else "", attributes, above, drawn)
        if not open_now:
            roots.append(element)
        elif element.tag in _MOVING:
            open_now[-1].moved = True
        elif element.tag in _SHAPES:
            shapes.append(element)
        open_now.append(element)

    def text(words: str) -> None:
        if open_now[-1].tag == "style":
            sheets.append(words)

    def doctype(_name: str, _system: str | None, _public: str | None, internal: bool) -> None:
        nonlocal declared
        declared = True
        if internal:
            raise Unusable(f"{name} declares entities of its own", "Save it without (Inkscape: Plain SVG)", "svg", name)

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: open_now.pop()
    parser.CharacterDataHandler = text
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(data, True)
    except Unusable:
        raise
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise Unusable(f"{name} is not an SVG file: {error}", "Save the drawing as SVG", "svg", name) from None
    # with a DOCTYPE, expat silently skips unknown entities, and part of a path could be lost
    if declared and re.search(rb"&(?!#|amp;|lt;|gt;|quot;|apos;)", data.replace(b"\0", b"")):
        raise Unusable(f"{name} uses entities", "Save it without (Inkscape: Plain SVG)", "svg", name)
    if roots[0].tag != "svg":
        raise Unusable(
            f"{name} is not an SVG file: it begins with <{shortened(roots[0].tag)}>", "Save the drawing as SVG", "svg", name
        )
    return roots[0], shapes, "".join(sheets)


def _chosen(shapes: Sequence[_Element], raw: Mapping[str, Any], name: str) -> _Element:
    """Return the shape with the id or label `path`, or the path of that number (another shape if there are no paths)."""
    requested = raw.get("path", 1)
    if isinstance(requested, bool) or not isinstance(requested, int | str):
        raise Unusable("expected an id or a number", 'Write path = "curve", or path = 1', "path", requested)
    if isinstance(requested, str) and requested:
        matches = [shape for shape in shapes if shape.id == requested] or [one for one in shapes if one.label == requested]
        if len(matches) > 1:
            raise Unusable(
                f"{name} has {len(matches)} shapes of that name", "Give each its own, or name it by number", "path", requested
            )
        if matches:
            return matches[0]
    drawn = [shape for shape in shapes if shape.drawn]
    numbered = [shape for shape in drawn if shape.tag == "path"] or drawn
    if not numbered:
        raise Unusable(f"{name} contains no path", "Save a drawing with a path; text and pictures are not paths", "svg", name)
    listing = ", ".join(f"{number} {shape.listed}" for number, shape in enumerate(numbered[:8], start=1))
    remedy = f"It has, by number: {listing}{', ...' if len(numbered) > 8 else ''}"
    if "path" not in raw and len(numbered) != 1:
        raise Unusable(f"{name} has {len(numbered)} paths; name one of them", remedy, "path")
    number = int(requested) if re.fullmatch("[0-9]{1,7}", str(requested)) else 0
    if not 1 <= number <= len(numbered):
        raise Unusable(f"{name} has no such path", remedy, "path", shortened(requested))
    return numbered[number - 1]


def _placed(shape: _Element, sheets: str, name: str) -> Array:
    """Return the matrix (3, 3) from the shape's own coordinates to those of the drawing.

    Other means of moving the shape are refused, as a wrong position would not be noticed.
    """
    matrix = np.eye(3)
    chain = shape.chain()
    for element in chain:
        if element is not chain[0] and element is not shape and element.tag not in _PLAIN:
            raise Unusable(f"{shape} of {name} lies in {element}, which places it elsewhere", _FLATTEN, "path", shape.id)
        style = [part.partition(":")[0].strip() for part in element.attributes.get("style", "").split(";")]
        if element.moved or any(map(_PROPERTY.fullmatch, style)) or "transform-origin" in element.attributes:
            why = "an animation" if element.moved else "a style"
            raise Unusable(f"{element} of {name} is moved by {why}, which is not supported", _FLATTEN, "path", shape.id)
        matrix = matrix @ _transform(element, name)
    if any(map(_PROPERTY.fullmatch, re.findall(r"(?<![-\w])([-\w]++)\s*+:", sheets))):
        raise Unusable(f"{name} has a style sheet that may move shapes, which is not supported", _FLATTEN, "svg", name)
    return matrix


def _transform(element: _Element, name: str) -> Array:
    text = element.attributes.get("transform", "").strip()
    matrix, end = np.eye(3), 0
    while end < len(text):
        match = _FUNCTION.match(text, end)
        step = match and _step(*match.groups())
        if match is None or step is None:
            raise Unusable(f"the transform of {element} of {name} cannot be read", _FLATTEN, "path", shortened(text[end:]))
        matrix, end = matrix @ step, match.end()
    return matrix


def _step(function: str, text: str) -> Array | None:
    """Return the matrix (3, 3) of one function of a transform, or None."""
    if not re.fullmatch(rf"{_S}(?:{_N}{_C})*+", text):
        return None
    values = [float(number) for number in re.findall(_N, text)]
    a, b, c, d, e, f = 1.0, 0.0, 0.0, 1.0, 0.0, 0.0
    match function, values:
        case "matrix", [a, b, c, d, e, f]:
            pass
        case "translate", [e]:
            pass
        case "translate", [e, f]:
            pass
        case "scale", [a]:
            d = a
        case "scale", [a, d]:
            pass
        case "rotate", [turn, *centre] if len(centre) in (0, 2):
            a, b = math.cos(math.radians(turn)), math.sin(math.radians(turn))
            c, d = -b, a
            x, y = centre or (0.0, 0.0)
            e, f = x - a * x - c * y, y - b * x - d * y
        case "skewX", [turn]:
            c = math.tan(math.radians(turn))
        case "skewY", [turn]:
            b = math.tan(math.radians(turn))
        case _:
            return None
    matrix = np.array([[a, c, e], [b, d, f], [0.0, 0.0, 1.0]])
    return matrix if all_finite(matrix) else None


def _scale(root: _Element, name: str, forgive: bool) -> tuple[float | None, bool]:
    """Return the length of one user unit [mm] defined by the drawing, and whether by a size in pixels.

    The length is None if undefined, or if ambiguous with `forgive`.
    """
    sides, units = [], set()
    for side in ("width", "height"):
        match = re.fullmatch(rf"({_N})\s*([a-zA-Z]*)", root.attributes.get(side, "").strip())
        unit = _MILLIMETRES.get(match[2].lower() or "px") if match else None
        sides.append(float(match[1]) * unit if match and unit else None)
        units |= {match[2].lower() or "px"} if match and unit else set()
    pixels = units == {"px"}
    if sides == [None, None]:
        return None, False
    if "viewBox" not in root.attributes:
        return _PIXEL, pixels
    box, add = root.attributes["viewBox"], 'Correct it, or state the length of a user unit: unit = "mm"'
    values = [float(number) for number in re.findall(_N, box)] if re.fullmatch(rf"{_S}(?:{_N}{_C}){{4}}", box) else []
    scales = [side / whole for side, whole in zip(sides, values[2:], strict=False) if side is not None and whole > 0.0]
    clear = bool(values and scales) and all(math.isfinite(scale) and scale > 0.0 for scale in scales)
    aspect = root.attributes.get("preserveAspectRatio", "")
    stretched = clear and "none" in aspect and max(scales) > min(scales) * (1.0 + 1e-6)
    if forgive and (stretched or not clear):
        return None, False
    if not clear:
        raise Unusable(f"the viewBox of {name} cannot be read", add, "svg", shortened(box))
    if stretched:
        raise Unusable(f"{name} is stretched: its width and height do not match its viewBox", add, "svg", shortened(box))
    return max(scales) if "slice" in aspect else min(scales), pixels


def _user_unit(raw: Mapping[str, Any]) -> tuple[float, str]:
    """Return the stated length of one user unit [mm], and the unit in which the path is shown.

    It is a unit, of SVG or another one, or a length, which scales the drawing.
    """
    stated = raw["unit"]
    if stated in ("pt", "px", "pc"):
        return _MILLIMETRES[stated], "mm"
    if isinstance(stated, str) and re.match(r"[\d.]", stated):
        value, unit = read_scalar(stated, "length", "unit")
        return 1e3 * value, unit
    return 1e3 * metres(raw), stated


def svg_points(raw: Mapping[str, Any], folder: Path) -> TargetPoints:
    """Return points of a shape of an SVG file, from a table with svg, and optionally path, unit and points.

    Raises
    ------
    Unusable
    """
    count = read_count(raw)
    millimetres_per_unit, unit = _user_unit(raw) if "unit" in raw else (None, "mm")
    name, data = read_file(raw, "svg", folder)
    root, shapes, sheets = _elements(data, name)
    shape = _chosen(shapes, raw, name)
    file_scale, pixels = _scale(root, name, millimetres_per_unit is not None)
    scale = millimetres_per_unit or file_scale or 1.0
    matrix = np.diag([1e-3 * scale, -1e-3 * scale, 1.0]) @ _placed(shape, sheets, name)
    try:
        with np.errstate(all="ignore"):
            curves = _curves(shape, name)
            fine = min(max(FINE // max(len(curves), 1), 16), 2048)
            pieces = [CurvePiece(_onto(curve, matrix), 1 if straight else fine) for curve, straight in curves]
            points, loop, length = resample(pieces, count)
    except Unusable as error:
        key = error.key or "path"
        raise Unusable(f"{shape} of {name}: {error.message}", error.remedy, key, error.value) from None
    known = 'not stated in the file: add unit = "pt", "px" or "in" if it is another'
    if file_scale:
        known = f'at {PIXELS} px an inch; at 72 px, as in Illustrator, add unit = "{scale * PIXELS / 72.0:.6g} mm"'
        known = known if pixels else "as stated in the file"
    origin = "as stated" if millimetres_per_unit else known
    if file_scale and not math.isclose(scale, file_scale, rel_tol=1e-6):
        origin = f"as stated, though the file states {file_scale:.6g} mm"
    note = f"{shape} of {name}, {show(length, 'length', unit)} long, sampled at {count} points evenly by arc length"
    return sampled_targets(points, unit, loop, f"{note}; one user unit is {scale:.6g} mm, {origin}")


_Curve = Callable[[Array], Drawn]  # x + iy in user units at u from 0 to 1


def _onto(curve: _Curve, matrix: Array) -> Callable[[Array], Array]:
    def at(u: Array) -> Array:
        z = curve(u)[:, None]
        return matrix[:2, 0] * z.real + matrix[:2, 1] * z.imag + matrix[:2, 2]

    return at


def _curves(shape: _Element, name: str) -> list[tuple[_Curve, bool]]:
    """Return the consecutive curves of a shape, each with whether it is straight."""

    def size(key: str) -> float:
        text = shape.attributes.get(key, "0").strip()
        if not re.fullmatch(rf"{_N}(?:px)?", text):
            raise Unusable(f"its {key} is not a plain number", _FLATTEN, "", shortened(text))
        return float(text.removesuffix("px"))

    if shape.tag in ("circle", "ellipse"):
        radii = (size("r"), size("r")) if shape.tag == "circle" else (size("rx"), size("ry"))
        return [(_ellipse(complex(size("cx"), size("cy")), radii, 1.0 + 0.0j, 0.0, 2.0 * math.pi), False)]
    if shape.tag == "rect":
        if "rx" in shape.attributes or "ry" in shape.attributes:
            raise Unusable("a rectangle with rounded corners is not supported", _FLATTEN)
        return _path(f"M {size('x')!r} {size('y')!r} h {size('width')!r} v {size('height')!r} h {-size('width')!r} z")
    if shape.tag == "line":
        return _path(f"M {size('x1')!r} {size('y1')!r} L {size('x2')!r} {size('y2')!r}")
    if shape.tag in ("polyline", "polygon"):
        return _path(f"M {shape.attributes.get('points', '')} {'Z' if shape.tag == 'polygon' else ''}")
    return _path(shape.attributes.get("d", ""))


def _path(text: str) -> list[tuple[_Curve, bool]]:
    from svg.path import Arc, Close, Line, Move, parse_path

    broken = "The data is that of the SVG standard: M 0 0 L 10 5 C ..."
    match = _GRAMMAR.match(text)
    end = match.end() if match else 0
    if not text.strip():
        raise Unusable("there is no path data", broken)
    if end < len(text):
        raise Unusable(f"its data cannot be read from character {end + 1} on", broken, "", shortened(text[end:]))
    try:
        segments = list(parse_path(text))
    except (ValueError, ArithmeticError) as error:
        raise Unusable(f"its data cannot be read: {shortened(error)}", broken) from None
    if len(segments) > MAX_SEGMENTS:
        raise Unusable(f"it has more than {MAX_SEGMENTS:,} segments", "Simplify it (Inkscape: Path > Simplify)")
    curves: list[tuple[_Curve, bool]] = []
    here: complex | None = None
    for segment in segments:
        if isinstance(segment, Move) or (isinstance(segment, Line | Close) and segment.start == segment.end):
            continue
        if here is not None and segment.start != here:
            raise Unusable("it has more than one part", "Break it apart (Inkscape: Path > Break Apart) and name one part")
        here = segment.end
        if not cmath.isfinite(here):
            raise Unusable("it is too large", broken)
        if isinstance(segment, Arc):
            curve = _arc(segment)
            if curve is not None:
                curves.append(curve)
        else:
            curves.append((segment.point, isinstance(segment, Line | Close)))  # type: ignore[arg-type]  # takes arrays too
    if not curves:
        raise Unusable("it has no length", broken)
    return curves


def _ellipse(centre: complex, radii: tuple[float, float], turn: complex, begin: float, sweep: float) -> _Curve:
    def at(u: Array) -> Drawn:
        angle = begin + sweep * u
        return centre + turn * (radii[0] * np.cos(angle) + 1j * radii[1] * np.sin(angle))

    return at


def _arc(segment: Any) -> tuple[_Curve, bool] | None:
    """Return an elliptical arc; a straight line if a radius is zero, None if it ends at its start, as in the SVG standard."""
    start, end = segment.start, segment.end
    if start == end:
        return None
    if 0.0 in (segment.radius.real, segment.radius.imag):
        return (lambda u: start + (end - start) * u), True
    radii = (segment.radius.real * segment.radius_scale, segment.radius.imag * segment.radius_scale)
    turn = cmath.rect(1.0, math.radians(segment.rotation))

    def angle(point: complex) -> float:
        # svg.path takes an arc cosine, which loses half the digits of a half turn
        w = (point - segment.center) / turn
        return math.atan2(w.imag / radii[1], w.real / radii[0])

    begin = angle(start)
    sweep = (angle(end) - begin) % (2.0 * math.pi)
    return _ellipse(segment.center, radii, turn, begin, sweep if segment.sweep else sweep - 2.0 * math.pi), False


_FORMS = (
    'Write [["20 mm", "25 mm"], ...], { csv = "curve.csv" }, { svg = "drawing.svg" } '
    'or { x = "20*cos(t)", y = "10*sin(t)", unit = "mm", t = [0, "2*pi"] }'
)


POINT_KEYS = {
    "csv": ("csv", "points"),
    "svg": ("svg", "path", "unit", "points"),
    "x": ("x", "y", "unit", "t", "points", "spacing"),
}


def read_points(raw: object, folder: Path) -> TargetPoints:
    """Read points or poses from a problem file: a list, a CSV file, a shape of an SVG file, or expressions in t.

    Up to `MAX_POINTS` listed points are kept unchanged; more are reduced evenly by arc length or, if further columns are defined,
    evenly by rows. A closed curve that is sampled or reduced by arc length does not repeat its first point at the end. The y axis
    of SVG points down, that of optlink up, so y changes its sign; the origin remains that of the drawing.

    Raises
    ------
    Unusable
        with the key below the present one.
    """
    if isinstance(raw, list | tuple):
        return check_and_reduce(read_rows(raw), None)
    if not isinstance(raw, dict):
        raise Unusable("points are a list or a table", _FORMS)
    forms = [form for form, keys in (("csv", ("csv",)), ("svg", ("svg",)), ("x", ("x", "y"))) if any(key in raw for key in keys)]
    if not forms:
        check_keys(raw, sorted({name for form in POINT_KEYS.values() for name in form}))
        raise Unusable("the points are missing", _FORMS)
    if len(forms) > 1:
        raise Unusable(f"the points are given twice, by {' and by '.join(forms)}", "Keep one of them", forms[1], raw[forms[1]])
    check_keys(raw, POINT_KEYS[forms[0]])
    if forms == ["csv"]:
        count = read_count(raw) if "points" in raw else None
        return check_and_reduce(read_csv_rows(raw, folder), count)
    return svg_points(raw, folder) if forms == ["svg"] else expression_curve(raw)
