"""SVG drawing of a mechanism to scale, in millimetres, for reports and export."""

import math
from collections.abc import Iterator
from html import escape

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.report.names import LETTER
from optlink.report.scene import Body, Scene
from optlink.report.shapes import Part, zigzag
from optlink.report.style import GROUND, LIMIT, MUTED, short_name

POINT = 1.0 / 8.0  # size of a typographic point, as a share of the size of a ground pivot, as in the other figures
LAYERS = ("slot", "plate", "bar", "block", "crank")
"""What lies on what."""


def svg(scene: Scene, title: str, motion: Scene | None = None, k: int = 0, *, traces: bool = True, names: bool = True) -> str:
    """Draw position `k` of a scene, to fill its place in a page.

    With the whole `motion`, of which the scene is one position, the drawing becomes a file in true size. The title is its
    accessible name.
    """
    x, y, width, height = (_number(value, scene) for value in scene.box)
    true_size = f' xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm"' if motion is not None else ""
    lines = [f'<svg{true_size} viewBox="{x} {y} {width} {height}" role="img" aria-label="{escape(title)}">']
    lines.append(f"<title>{escape(title)}</title>")
    lines.append('<g data-layer="ground" stroke-linecap="round" stroke-linejoin="round">')
    lines += _ground(scene)
    lines.append("</g>")
    if scene.regions:
        lines.append(
            f'<g data-layer="regions" fill="none" font-family="sans-serif" font-size="{_number(LETTER * scene.size, scene)}">'
        )
        lines += _regions(scene)
        lines.append("</g>")
    if traces:
        lines.append('<g data-layer="traces" fill="none" stroke-linejoin="round">')
        lines += _traces(motion or scene)
        lines.append("</g>")
    lines.append('<g data-layer="bodies" stroke-linecap="round" stroke-linejoin="round">')
    for layer in LAYERS:
        if layer == "bar":
            lines += _springs(scene, k)
        for body in scene.bodies:
            lines += _body(scene, body, layer, k)
    lines.append("</g>")
    lines.append('<g data-layer="joints">')
    lines += _joints(scene, k)
    lines.append("</g>")
    if names:
        lines.append(f'<g data-layer="names" font-family="sans-serif" font-size="{_number(LETTER * scene.size, scene)}">')
        lines += _names(scene, k)
        lines.append("</g>")
    lines.append("</svg>")
    return "\n".join(lines) + "\n"


def _number(value: float, scene: Scene) -> str:
    return f"{float(value):z.{scene.decimals}f}".rstrip("0").rstrip(".") or "0"


def _wide(points: float, scene: Scene) -> str:
    """Format a line width given in typographic points."""
    return f"{points * POINT * scene.size:.4g}"


def _path(line: Array, scene: Scene, *, closed: bool = False) -> str:
    """Return the path data of a line (n, 2), with gaps at NaN."""
    commands, pen = [], "M"
    for x, y in line:
        if math.isfinite(x) and math.isfinite(y):
            commands.append(f"{pen}{_number(x, scene)} {_number(y, scene)}")
            pen = "L"
        else:
            pen = "M"
    return " ".join(commands) + ("Z" if closed else "")


def _ground(scene: Scene) -> Iterator[str]:
    for line, width, filled in scene.ground:
        fill = "#ffffff" if filled else "none"
        yield f'<path d="{_path(line, scene)}" fill="{fill}" stroke="{GROUND}" stroke-width="{_wide(width, scene)}"/>'


def _regions(scene: Scene) -> Iterator[str]:
    """Yield the lines and the name of every region; red if the design violates it."""
    for region in scene.regions:
        colour = LIMIT if region.violated else GROUND
        for line, width, dashed in region.lines:
            dashes = f' stroke-dasharray="{_wide(4.0, scene)} {_wide(3.0, scene)}"' * dashed
            look = f'stroke="{colour}" stroke-width="{_wide(width, scene)}"{dashes}'
            yield f'<path data-region="{escape(region.name)}" d="{_path(line, scene)}" {look}/>'
        x, y = region.label
        if math.isfinite(x) and math.isfinite(y):
            place = f'x="{_number(x, scene)}" y="{_number(y + 0.35 * LETTER * scene.size, scene)}"'
            yield rimmed(place, region.name, colour, _wide(2.2, scene))


def _traces(scene: Scene) -> Iterator[str]:
    colours = {body.name: body.colour for body in scene.bodies}
    for name in scene.moving:
        free = name in scene.free
        look = f'stroke="{colours[scene.owner[name]]}" stroke-width="{_wide(1.3 if free else 0.9, scene)}"'
        opacity = 0.75 if free else 0.45
        yield f'<path data-trace="{escape(name)}" d="{_path(scene.points[name], scene)}" {look} stroke-opacity="{opacity}"/>'


def placed(pose: Array, scene: Scene) -> str:
    """Return the SVG transformation that places a body: x, y [mm] and angle [deg]."""
    x, y, angle = (float(value) for value in pose)
    return f"translate({_number(x, scene)} {_number(y, scene)}) rotate({round(angle, 5) + 0.0:g})"


def _body(scene: Scene, body: Body, layer: str, k: int) -> Iterator[str]:
    """Yield the parts of a body in a layer, in its own axes."""
    crank = body is scene.bodies[0]
    shown = [part for part in body.parts if ("crank" if crank and part.kind == "bar" else part.kind) == layer]
    centroid = layer == LAYERS[-1] and body.centroid is not None
    if not (shown or centroid) or not np.all(np.isfinite(body.poses[k])):
        return
    yield f'<g data-body="{escape(body.name)}" transform="{placed(body.poses[k], scene)}"><title>{escape(body.name)}</title>'
    for part in shown:
        yield _part(part, body.colour, scene, crank=crank)
    if centroid and body.centroid is not None:
        yield _centroid(body.centroid, body.colour, scene)
    yield "</g>"


def _part(part: Part, colour: str, scene: Scene, *, crank: bool) -> str:
    if part.kind == "bar":
        look = f'fill="none" stroke="{colour}" stroke-width="{_wide(4.2 if crank else 3.4, scene)}"'
        return f'<path d="{_path(part.outline, scene)}" {look}/>'
    opacity, width = {"plate": (0.22, 2.2), "slot": (0.13, 1.1), "block": (0.35, 1.5)}[part.kind]
    look = f'fill="{colour}" fill-opacity="{opacity}" stroke="{colour}" stroke-width="{_wide(width, scene)}"'
    return f'<path d="{_path(part.outline, scene, closed=True)}" {look}/>'


def _centroid(at: Array, colour: str, scene: Scene) -> str:
    """Return a ring with a cross."""
    x, y, r = float(at[0]), float(at[1]), 0.35 * scene.size
    cross = _path(np.array([[x - r, y], [x + r, y], [np.nan, np.nan], [x, y - r], [x, y + r]]), scene)
    look = f'stroke="{colour}" stroke-width="{_wide(0.9, scene)}"'
    ring = f'<circle cx="{_number(x, scene)}" cy="{_number(y, scene)}" r="{_number(r, scene)}" fill="#ffffff" {look}/>'
    return f'{ring}<path d="{cross}" {look}/>'


def _springs(scene: Scene, k: int) -> Iterator[str]:
    for name, ends in scene.springs.items():
        p, q = ends[k]
        along = q - p
        left = np.array([along[1], -along[0]]) / max(float(np.linalg.norm(along)), 1e-30)
        line = np.array([p + share * along + side * left for share, side in zigzag(scene.size)])
        look = f'fill="none" stroke="{MUTED}" stroke-width="{_wide(1.2, scene)}"'
        yield f'<path data-spring="{escape(name)}" d="{_path(line, scene)}" {look}><title>{escape(name)}</title></path>'


def _joints(scene: Scene, k: int) -> Iterator[str]:
    colours = {body.name: body.colour for body in scene.bodies}
    for name in (*scene.free, *scene.pins):
        x, y = scene.points[name][k]
        if not (math.isfinite(x) and math.isfinite(y)):
            continue
        place = f'data-point="{escape(name)}" transform="translate({_number(x, scene)} {_number(y, scene)})"'
        if name in scene.pins:
            look = f'r="{_wide(2.75, scene)}" fill="#ffffff" stroke="{GROUND}" stroke-width="{_wide(1.0, scene)}"'
        else:
            look = f'r="{_wide(2.1, scene)}" fill="{colours[scene.owner[name]]}"'
        yield f"<circle {place} {look}><title>{escape(name)}</title></circle>"


def _names(scene: Scene, k: int) -> Iterator[str]:
    """Yield the names of the points, beside them."""
    rim, drop = _wide(2.2, scene), 0.35 * LETTER * scene.size
    for name, places in scene.points.items():
        x, y = places[k]
        if math.isfinite(x) and math.isfinite(y):
            place = f'data-point="{escape(name)}" transform="translate({_number(x, scene)} {_number(y, scene)})"'
            right, down = scene.names[name].at(k)
            at = f'data-name="{escape(name)}" transform="translate({_number(right, scene)} {_number(down, scene)})"'
            tooltip = "" if short_name(name) == name else f"<title>{escape(name)}</title>"
            text = rimmed(f'y="{_number(drop, scene)}"', short_name(name), GROUND, rim, tooltip)
            yield f"<g {place}><g {at}>{text}</g></g>"


def rimmed(place: str, text: str, colour: str, rim: str, tooltip: str = "") -> str:
    """Return a centred text over its own white rim, as two texts: not every program draws the rim of a letter below it."""
    begin, letters = f'<text {place} text-anchor="middle"', escape(text)
    white = f'fill="none" stroke="#ffffff" stroke-width="{rim}" stroke-linejoin="round" aria-hidden="true"'
    return f'{begin} {white}>{letters}</text>{begin} fill="{colour}">{tooltip}{letters}</text>'
