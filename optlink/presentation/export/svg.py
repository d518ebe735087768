"""SVG drawing of a mechanism to scale, in millimetres, for reports and export, and the data by which a page moves it.

The y axis of SVG points down, and angles turn with it.
"""

import itertools
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.presentation.chart_spec import GROUND
from optlink.presentation.scene import LETTER, WHITE, Scene, Shape, Text
from optlink.presentation.shapes import zigzag

POINT = 1.0 / 8.0  # size of a typographic point, as a share of the size of a ground pivot, as in the other figures
FLIP = np.array([1.0, -1.0])
DIGITS = np.array([*"0123456789abcdefghijklmnopqrstuvwxyz"])  # of the place of a name at each position
GROUPS = {"regions": "region", "traces": "trace", "ground": ""}
"""Layers of what stands still, and what the name of one of their shapes is called."""
ROUND = 'stroke-linecap="round" stroke-linejoin="round"'


def svg(
    scene: Scene,
    title: str,
    k: int = 0,
    *,
    true_size: bool = False,
    traces: bool = True,
    names: bool = True,
    box: tuple[float, float, float, float] | None = None,
    dimensions: Sequence[Shape | Text] = (),
) -> str:
    """Draw position `k` of a scene, to fill its place in a page or, in true size, as a file. The title is its accessible name.

    Without names the page cannot move it. `box` is another extent: lower left corner, width, height.
    """
    pen = _Pen(scene, moves=names)
    left, low, *sides = box or scene.box
    x, y, width, height = map(pen.number, (left, -low - sides[1], *sides))
    size = f' xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm"' if true_size else ""
    lines = [f'<svg{size} viewBox="{x} {y} {width} {height}" role="img" aria-label="{escape(title)}">']
    lines.append(f"<title>{escape(title)}</title>")
    font = f'font-family="sans-serif" font-size="{pen.number(LETTER * scene.size)}"'
    labels = [Text(region.name, region.label, region.colour, LETTER * scene.size) for region in scene.outlines]
    for layer, shapes in itertools.groupby(scene.fixed_shapes(traces=traces), key=lambda shape: shape.layer):
        lines.append(f'<g data-layer="{layer}" {font if layer == "regions" else ROUND}>')
        lines += [pen.shape(shape, GROUPS[layer]) for shape in shapes]
        lines += [pen.text(label) for label in labels if layer == "regions" and np.all(np.isfinite(label.at))]
        lines.append("</g>")
    lines.append(f'<g data-layer="bodies" {ROUND}>')
    moving = itertools.groupby(scene.moving_shapes, key=lambda shape: (shape.layer, shape.of, shape.name))
    lines += [pen.moved(of, name, [*shapes], k) for (_, of, name), shapes in moving]
    lines.append("</g>")
    if names:
        lines += [f'<g data-layer="names" {font}>', *(pen.name(name, k) for name in scene.names), "</g>"]
    if dimensions:
        font = f'font-family="sans-serif" font-size="{next(one.font for one in dimensions if isinstance(one, Text)):.4g}"'
        drawn = [pen.shape(one) if isinstance(one, Shape) else pen.text(one) for one in dimensions]
        lines.append(f'<g data-layer="dimensions" {font}>{"".join(drawn)}</g>')
    return "\n".join([*filter(None, lines), "</svg>\n"])


class _Pen:
    """Writes the shapes of a scene."""

    def __init__(self, scene: Scene, *, moves: bool) -> None:
        self.scene, self.moves, self.points, self.decimals = scene, moves, scene.points, scene.decimals

    def number(self, value: float) -> str:
        return f"{float(value):z.{self.decimals}f}".rstrip("0").rstrip(".") or "0"

    def wide(self, points: float) -> str:
        """Format a line width given in typographic points."""
        return f"{points * POINT * self.scene.size:.4g}"

    def place(self, at: Array, form: str = "translate({} {})") -> str:
        return form.format(*map(self.number, at * FLIP))

    def path(self, line: Array) -> str:
        """Return the path data of a line (n, 2), with gaps at NaN."""
        known = np.all(np.isfinite(line), axis=1)
        pens = np.where(known & ~np.concatenate([[False], known[:-1]]), "M", "L")[known]
        numbers = (map(self.number, values) for values in (line[known] * FLIP).T)
        return " ".join(f"{pen}{x} {y}" for pen, x, y in zip(pens, *numbers, strict=True))

    def data(self, key: str, name: str) -> str:
        return f' data-{key}="{escape(name)}"' if key and (self.moves or key in GROUPS.values()) else ""

    def shape(self, shape: Shape, key: str = "", *, inner: str = "", place: str = "") -> str:
        """Write one shape, with the name by which the page finds it, and where it is."""
        look = f'fill="{shape.fill or "none"}"'
        look += f' fill-opacity="{shape.face}"' if shape.face < 1.0 and shape.fill else ""
        look += f' stroke="{shape.colour}" stroke-width="{self.wide(shape.width)}"' if shape.width else ""
        look += f' stroke-opacity="{shape.opacity}"' if shape.opacity < 1.0 else ""
        look += f' stroke-dasharray="{" ".join(map(self.wide, shape.dashes))}"' if shape.dashed else ""
        begin = f"{self.data(key, shape.name)}{place}"
        if shape.radius:
            middle = "" if place else self.place(shape.line[0], ' cx="{}" cy="{}"')
            return f'<circle{begin}{middle} r="{self.wide(shape.radius)}" {look}>{inner}</circle>'
        closed = "Z" if shape.fill else ""
        return f'<path{begin} d="{self.path(shape.line)}{closed}" {look}>{inner}</path>'

    def moved(self, of: str, name: str, shapes: list[Shape], k: int) -> str:
        """Write shapes that move together, at position `k`; nothing where their place is not known."""
        tooltip = f"<title>{escape(name)}</title>"
        if of == "spring":
            (spring,) = shapes
            drawn = Shape(spring.layer, name, self.scene.located(spring, self.scene.shown)[k], spring.colour, spring.width)
            return self.shape(drawn, of, inner=tooltip)
        pose = self.scene.poses(name)[k] if of == "body" else np.append(self.points[name][k], 0.0)
        if not np.all(np.isfinite(pose)):
            return ""
        if of == "point":
            return "".join(self.shape(one, of, inner=tooltip, place=f' transform="{self.place(pose[:2])}"') for one in shapes)
        turned = f' transform="{self.place(pose[:2])} rotate({round(-pose[2], 5) + 0.0:g})"'
        return f"<g{self.data(of, name)}{turned}>{tooltip}{''.join(map(self.shape, shapes))}</g>"

    def rimmed(self, place: str, text: str, colour: str, tooltip: str = "") -> str:
        """Write a centred text over its own white rim, as two texts: not every program draws the rim of a letter below it."""
        begin, letters = f'<text {place} text-anchor="middle"', escape(text)
        rim = f'fill="none" stroke="{WHITE}" stroke-width="{self.wide(2.2)}" stroke-linejoin="round" aria-hidden="true"'
        return f'{begin} {rim}>{letters}</text>{begin} fill="{colour}">{tooltip}{letters}</text>'

    def text(self, text: Text) -> str:
        """Write a text about its middle, turned by its angle [deg]."""
        middle = self.place(text.at, "{} {}")
        turned = f' transform="rotate({-text.angle:.4g} {middle})"' if text.angle else ""
        place = self.place(text.at - np.array([0.0, 0.35 * text.font]), 'x="{}" y="{}"')
        return self.rimmed(f"{place}{turned}", text.text, text.colour)

    def name(self, name: str, k: int) -> str:
        """Write the name of a point, beside it."""
        at = self.points[name][k]
        if not np.all(np.isfinite(at)):
            return ""
        (places, chosen), caption = self.scene.places_of_names[name], self.scene.captions[name]
        beside = self.place(places[chosen[k]])
        drop, tooltip = self.number(0.35 * LETTER * self.scene.size), f"<title>{escape(name)}</title>"
        text = self.rimmed(f'y="{drop}"', caption, GROUND, tooltip if caption != name else "")
        inner = f'<g{self.data("name", name)} transform="{beside}">{text}</g>'
        return f'<g{self.data("point", name)} transform="{self.place(at)}">{inner}</g>'


def motion_data(scene: Scene) -> dict[str, Any]:
    """Return the data by which the script of a page moves the drawing of a scene."""

    def columns(table: Array, names: str, decimals: int = scene.decimals) -> dict[str, list[float]]:
        return {name: np.round(values, decimals).tolist() for name, values in zip(names, table.T, strict=True)}

    bodies = {name: scene.poses(name) * [1.0, -1.0, -1.0] for name in scene.parts}
    ends = {spring: scene.ends(scene.shown, spring) * FLIP for spring in scene.springs}
    names = {name: scene.places_of_names[name] for name in scene.moving}
    return {
        "angles_deg": np.round(scene.crank_angles, 9).tolist(),
        "closed": scene.closed,
        "bodies": {name: columns(poses[:, :2], "xy") | columns(poses[:, 2:], "a", 5) for name, poses in bodies.items()},
        "points": {name: columns(scene.points[name] * FLIP, "xy") for name in scene.moving},
        "names": {
            name: columns(places * FLIP, "xy") | {"side": "".join(DIGITS[chosen])} for name, (places, chosen) in names.items()
        },
        "springs": {name: columns(both.reshape(len(both), 4), "xyuv") for name, both in ends.items()},
        "zigzag": zigzag(scene.size),
        "size": scene.size,
    }
