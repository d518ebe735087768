"""Labelled sketches of the four-bar, of every dyad and of the six-bar.

Bodies, guides and ground have the shapes and colours of the drawings that optlink makes of results.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Arc
from numpy.typing import NDArray

import optlink
from optlink.linkage.motion import Motion, sweep
from optlink.presentation.drawing import Sketch
from optlink.presentation.labels import Label, place_labels
from optlink.presentation.style import GROUND, HALO, MUTED, apply_style

Array = NDArray[np.float64]
FOLDER = "images/sketches"
FONT = 13.0
SYMBOL = 0.065  # height of a ground pivot, as a share of the extent of a dyad
SWING = 14.0  # range of the motion on both sides of a pose [deg]: the length of slots and rails

FOUR_BAR: dict[str, Any] = {"type": "four-bar", "crank": "100 mm", "coupler": "260 mm", "rocker": "190 mm", "frame": "280 mm"}
GROUND_A = {"A": ["0 mm", "0 mm"]}
CRANK: dict[str, Any] = {"joints": ["A", "B"], "length": "100 mm"}

DYADS: dict[str, dict[str, Any]] = {
    "RRR": {**FOUR_BAR, "assembly": "left"},
    "RRP": {
        "ground": GROUND_A,
        "links": {"crank": CRANK, "rod": {"joints": ["B", "C"], "length": "190 mm"}, "slider": {"joints": ["C"]}},
        "guides": {"G": {"slider": "slider", "on": "frame", "through": ["0 mm", "-30 mm"], "direction": "0 deg"}},
        "assembly": {"C": "forward"},
    },
    "RPR": {
        "ground": {**GROUND_A, "C": ["150 mm", "-70 mm"]},
        "links": {"crank": CRANK, "block": {"joints": ["B"]}, "lever": {"joints": ["C", "T"], "length": "240 mm"}},
        "guides": {"G": {"slider": "block", "on": "lever", "through": "C"}},
        "assembly": {"G": "forward"},
    },
    "RPP": {
        "ground": GROUND_A,
        "links": {"crank": CRANK, "block": {"joints": ["B"]}, "yoke": {"joints": ["Y"], "points": {"K": ["70 mm", "0 mm"]}}},
        "guides": {
            "G": {"slider": "block", "on": "yoke", "through": "Y", "direction": "90 deg"},
            "F": {"slider": "yoke", "on": "frame", "through": ["0 mm", "0 mm"], "direction": "0 deg"},
        },
    },
    "PRP": {
        "ground": GROUND_A,
        "links": {
            "crank": {"joints": ["A", "T"], "length": "290 mm"},
            "die": {"joints": ["D"]},
            "ram": {"joints": ["D"], "points": {"K": ["90 mm", "0 mm"]}},
        },
        "guides": {
            "H": {"slider": "die", "on": "crank", "through": "A"},
            "F": {"slider": "ram", "on": "frame", "through": ["0 mm", "190 mm"], "direction": "0 deg"},
        },
    },
}
"""A mechanism for each dyad: the crank and the dyad."""

ANGLES = {"RRR": 65.0, "RRP": 62.0, "RPR": 70.0, "RPP": 52.0, "PRP": 58.0}
"""Crank angles of the sketches [deg]."""


def problem_of(mechanism: dict[str, Any], angle: float) -> optlink.ProblemFile:
    """Return a mechanism as a problem.

    Parameters
    ----------
    mechanism : dict
        As in a problem file.
    angle : float [deg]
        Crank angle at which its motion starts.
    """
    return optlink.read({"title": "Sketch", "mechanism": mechanism, "drive": {"start": f"{angle} deg"}})


def _posed(mechanism: dict[str, Any], angle: float, share: float) -> tuple[Sketch, Motion]:
    """Return the sketch of a mechanism that moves about a crank angle [deg], with symbols of a size, and its pose there."""
    machine = optlink.analyze(problem_of(mechanism, angle), points=4).machine
    near = np.radians(np.linspace(angle - SWING, angle + SWING, 41))
    sketch = Sketch(sweep(machine.mechanism, machine.sizes, near), share=share)
    return sketch, sweep(machine.mechanism, machine.sizes, [math.radians(angle)])


def _letter(axes: Axes, at: Array, text: str, colour: str = GROUND, *, italic: bool = True) -> None:
    letter = axes.text(*_xy(at), text, ha="center", va="center", color=colour, fontsize=FONT, zorder=9)
    letter.set(fontstyle="italic" if italic else "normal", path_effects=HALO)


def _xy(at: Array) -> tuple[float, float]:
    return float(at[0]), float(at[1])


def _arrow(axes: Axes, begin: Array, end: Array, **style: float) -> None:
    axes.annotate("", _xy(end), _xy(begin), arrowprops={"arrowstyle": "-|>", "color": GROUND, **style})


def _arc(axes: Axes, at: Array, radius: float, begin: float, end: float, text: str, reach: float = 1.3) -> None:
    """Draw an angle from one direction to another [deg], with an arrowhead and its symbol; clockwise where the second is less."""
    low, high = sorted((begin, end))
    axes.add_patch(Arc(_xy(at), 2.0 * radius, 2.0 * radius, theta1=low, theta2=high, color=GROUND, linewidth=1.1, zorder=5))
    back = math.copysign(math.degrees(0.12), end - begin)
    tip, before = (at + radius * _way(way) for way in (end, end - back))
    _arrow(axes, before, tip, linewidth=0.0, mutation_scale=9.0)
    _letter(axes, at + reach * radius * _way(0.5 * (begin + end)), text)


def _way(degrees: float) -> Array:
    return np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])


def _bearing(of: Array, to: Array) -> float:
    return math.degrees(math.atan2(*(to - of)[::-1])) % 360.0


def _joints(sketch: Sketch, motion: Motion) -> dict[str, Array]:
    return {name: sketch.position(motion, name)[0] for name in sketch.names}


def _beside(axes: Axes, ends: tuple[Array, Array], off: float, text: str, colour: str = GROUND) -> None:
    """Write a symbol `off` mm to the left of a line, near its middle."""
    p, q = ends
    along = (q - p) / np.linalg.norm(q - p)
    _letter(axes, 0.55 * p + 0.45 * q + off * np.array([-along[1], along[0]]), text, colour)


def _lengths(axes: Axes, sketch: Sketch, at: dict[str, Array]) -> None:
    for body, (p, q), text, off in (
        ("crank", "AB", "l₁", 15.0),
        ("coupler", "BC", "l₂", 15.0),
        ("rocker", "DC", "l₃", -15.0),
        ("", "AD", "l₄", -15.0),
    ):
        _beside(axes, (at[p], at[q]), off, text, sketch.colours.get(body, GROUND))


def _dashed(axes: Axes, start: Array, end: Array) -> None:
    axes.add_line(Line2D(*np.array([start, end]).T, color=MUTED, linewidth=1.1, linestyle=(0, (5, 3)), zorder=1))


def four_bar() -> Figure:
    """Draw the four-bar with its lengths, crank angle, output angle and transmission angle."""
    sketch, motion = _posed(DYADS["RRR"], ANGLES["RRR"], 0.04)
    at = _joints(sketch, motion)
    sketch.widen(np.array([at["A"] - [60.0, 45.0], at["D"] + [105.0, 0.0], at["C"] + [0.0, 25.0]]))
    drawn, axes = sketch.bare_figure(6.4, 4.0, traces=False)
    _dashed(axes, at["A"], at["D"] + [95.0, 0.0])
    sketch.pose(axes, motion)
    _lengths(axes, sketch, at)
    _arc(axes, at["A"], 42.0, 0.0, _bearing(at["A"], at["B"]), "φ")
    _arc(axes, at["D"], 42.0, 0.0, _bearing(at["D"], at["C"]), "ψ")
    _arc(axes, at["C"], 46.0, _bearing(at["C"], at["B"]), _bearing(at["C"], at["D"]), "γ", 1.28)
    for name, off in (("A", (-17.0, 5.0)), ("B", (-11.0, 11.0)), ("C", (6.0, 16.0)), ("D", (19.0, -9.0))):
        _letter(axes, at[name] + off, name, italic=False)
    for way, text in (((1.0, 0.0), "x"), ((0.0, 1.0), "y")):
        origin, tip = at["A"] - [52.0, 30.0], at["A"] - [52.0, 30.0] + 32.0 * np.array(way)
        _arrow(axes, origin, tip, linewidth=1.1, shrinkA=0, shrinkB=0)
        _letter(axes, tip + 9.0 * np.array(way), text)
    return drawn


def rocker_angle(phi: float) -> Figure:
    """Draw the two triangles at the line from B to D of a four-bar, from which its output angle follows.

    Parameters
    ----------
    phi : float [deg]
        Crank angle; beyond 180 deg B lies below the frame line.
    """
    sketch, motion = _posed(DYADS["RRR"], phi, 0.04)
    at = _joints(sketch, motion)
    sketch.widen(np.array([[-70.0, -115.0], at["D"] + [85.0, 0.0], [0.0, 205.0]]))
    drawn, axes = sketch.bare_figure(4.4, 3.3, traces=False)
    _dashed(axes, at["A"], at["D"] + [85.0, 0.0])
    _dashed(axes, at["B"], at["D"])
    sketch.pose(axes, motion)
    _lengths(axes, sketch, at)
    _beside(axes, (at["B"], at["D"]), 14.0, "ρ", MUTED)
    db, dc = _bearing(at["D"], at["B"]), _bearing(at["D"], at["C"])
    _arc(axes, at["A"], 34.0, 0.0, phi, "φ", 1.45)
    _arc(axes, at["D"], 34.0, 0.0, dc, "ψ", 1.4)
    _arc(axes, at["D"], 56.0, dc, db, "α", 1.27)
    _arc(axes, at["D"], 105.0, min(db, 180.0), max(db, 180.0), "β", 1.15)
    for name, off in (("A", (-19.0, 3.0)), ("B", (-14.0, 8.0)), ("C", (0.0, 18.0)), ("D", (22.0, -12.0))):
        _letter(axes, at[name] + off, name, italic=False)
    return drawn


def six_bar() -> Figure:
    """Draw the six-bar with its lengths, angles, slide and load at the start of its motion."""
    problem = optlink.load("six-bar")
    sketch, motion = _posed(problem.raw["mechanism"], float(problem.raw["drive"]["start"].partition(" ")[0]), 0.03)
    at = _joints(sketch, motion)
    sketch.widen(np.array([[-150.0, -330.0], at["E"] + [480.0, 0.0], at["C"] + [0.0, 130.0]]))
    drawn, axes = sketch.bare_figure(7.4, 3.2, traces=False)
    _dashed(axes, at["A"], at["E"] + [230.0, 0.0])
    sketch.pose(axes, motion)
    for body, (p, q), text, off in (
        ("crank", "AB", "r1", 90.0),
        ("link2", "BC", "r2", 90.0),
        ("link3", "DC", "r3", -90.0),
        ("link5", "CE", "r5", 90.0),
    ):
        _beside(axes, (at[p], at[q]), off, text, sketch.colours[body])
    for name, radius, text, turns in (
        ("AB", 190.0, "θ1", 0.0),
        ("BC", 330.0, "θ2", 0.0),
        ("DC", 190.0, "θ3", 0.0),
        ("CE", 240.0, "θ5", 360.0),
    ):
        corner = at[name[0]]
        _dashed(axes, corner, corner + (radius + 90.0) * _way(0.0))
        _arc(axes, corner, radius, 0.0, _bearing(corner, at[name[1]]) - turns, text, 1.35)
    for (start, end), text in ((("A", "D"), "r4"), (("D", "E"), "s")):
        low = np.array([0.0, -230.0])
        for tip, tail in ((start, end), (end, start)):
            _arrow(axes, at[tail] + low, at[tip] + low, linewidth=1.0, shrinkA=0, shrinkB=0)
        _letter(axes, 0.5 * (at[start] + at[end]) + low - [0.0, 75.0], text)
    _arrow(axes, at["E"] + [110.0, 0.0], at["E"] + [370.0, 0.0], linewidth=1.8, shrinkA=0, shrinkB=0)
    _letter(axes, at["E"] + [290.0, 80.0], "F6")
    for name, beside in (
        ("A", (-95.0, 0.0)),
        ("B", (-60.0, 70.0)),
        ("C", (0.0, 95.0)),
        ("D", (-95.0, 10.0)),
        ("E", (0.0, 120.0)),
    ):
        _letter(axes, at[name] + beside, name, italic=False)
    return drawn


PINS = ("A", "B", "C", "D")
OTHER: dict[str, dict[str, Any]] = {
    "RRR": {"assembly": "right"},
    "RRP": {"assembly": {"C": "backward"}},
    "RPR": {"assembly": {"G": "backward"}},
}
"""The other assembly mode of the dyads that have two."""


def dyad(kind: str) -> Figure:
    """Draw a crank and a dyad, in pale lines its other assembly mode.

    Parameters
    ----------
    kind : str
        RRR, RRP, RPR, RPP or PRP.
    """
    sketch, motion = _posed(DYADS[kind], ANGLES[kind], SYMBOL)
    sketch.colours[sketch.mechanism.crank.body] = MUTED
    ghost = None
    if kind in OTHER:
        other = {**DYADS[kind], **OTHER[kind]}
        share = SYMBOL * sketch.size / _posed(other, ANGLES[kind], SYMBOL)[0].size  # symbols of the same size
        ghost = _posed(other, ANGLES[kind], share)
        sketch.low, sketch.high = np.minimum(sketch.low, ghost[0].low), np.maximum(sketch.high, ghost[0].high)
    drawn, axes = sketch.bare_figure(3.6, 2.7, traces=False)
    if ghost:
        ghost[0].colours = sketch.colours
        for artist in ghost[0].pose(axes, ghost[1]):
            artist.set(alpha=0.22, zorder=1.5)
    sketch.pose(axes, motion)
    place_labels(
        drawn, [Label(axes, _xy(at), name, GROUND, 11.0, 7.0) for name, at in _joints(sketch, motion).items() if name in PINS]
    )
    return drawn


SKETCHES: dict[str, Callable[[], Figure]] = {
    "four-bar": four_bar,
    "rocker-angle-above": partial(rocker_angle, 80.0),
    "rocker-angle-below": partial(rocker_angle, 285.0),
    "six-bar": six_bar,
    **{kind.lower(): partial(dyad, kind) for kind in DYADS},
}
"""Sketches by the name of their file."""


def svg(name: str) -> bytes:
    """Return a sketch as SVG, the same bytes at each build.

    Parameters
    ----------
    name : str
        Key of `SKETCHES`.
    """
    with apply_style(), mpl.rc_context({"svg.hashsalt": name}), io.BytesIO() as stream:
        SKETCHES[name]().savefig(stream, format="svg", metadata={"Date": None})
        return stream.getvalue()
