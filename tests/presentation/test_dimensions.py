"""Texts of the dimensioned drawing lie clear of the links."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator

import numpy as np
import pytest

import optlink
from optlink.presentation.export.dimensions import dimensioned
from optlink.presentation.scene import scene
from optlink.problem.templates import template
from tests.tiers import mostly_slow

LINKAGES = {
    "narrow swing": {"crank": "46.3 mm", "coupler": "282.5 mm", "rocker": "150 mm", "frame": "240 mm"},
    "wide swing": {"crank": "37.5 mm", "coupler": "200 mm", "rocker": "60 mm", "frame": "220 mm"},
}


@pytest.mark.parametrize("name", LINKAGES)
def test_the_text_of_a_swing_is_clear_of_the_rocker(name: str) -> None:
    cycle = optlink.analyze(optlink.read({"mechanism": {"type": "four-bar", **LINKAGES[name]}}))
    drawing = dimensioned(cycle, name)
    angle = float(re.findall(r"drawn at a crank angle of (−?[\d.]+)°", drawing.words)[0].replace("−", "-"))
    swing = re.findall(r"rocker swings ([\d.]+°)", drawing.words)[0]
    size = float(re.findall(r'font-size="([\d.]+)"', drawing.svg)[0])
    x, y = map(float, re.findall(rf'<text x="(\S+)" y="(\S+)"[^>]*>{re.escape(swing)}</text>', drawing.svg)[0])
    drawn = scene(cycle, at=np.radians(angle))
    rocker = np.linspace(drawn.points["D"][0], drawn.points["C"][0], 400)
    covered = (np.abs(rocker[:, 0] - x) < 0.31 * size * len(swing)) & (np.abs(-rocker[:, 1] - y) < 0.4 * size)
    assert not np.any(covered)


def test_the_text_of_a_full_turn_is_clear_of_its_arc() -> None:
    cycle = optlink.analyze(optlink.load("six-bar"))
    drawing = dimensioned(cycle, "six-bar")
    size = float(re.findall(r'font-size="([\d.]+)"', drawing.svg)[-1])
    [(x, y)] = set(re.findall(r'<text x="(\S+)" y="(\S+)"[^>]*>360°</text>', drawing.svg))  # of the text and of its rim
    arcs = [
        np.array(re.findall(r"[-\d.e]+", path), dtype=float).reshape(-1, 2)
        for path in re.findall(r'<path d="(M[^"Z]+)"', drawing.svg)
    ]
    arc = max(arcs, key=len)  # of 300 degrees, in steps of 4
    assert len(arc) > 60
    away = np.abs(arc - [float(x), float(y) - 0.35 * size])
    assert not np.any((away[:, 0] < 0.5 * 0.62 * size * 4) & (away[:, 1] < 0.35 * size))


WALKER = {
    "arm.length": 136.4, "coupler.length": 103.6, "rocker.length": 107.0, "leg.length": 138.4,
    "coupler.points.E": [187.5, -45.0], "leg.points.P": [212.2, 261.2],
}  # fmt: skip


def walker() -> optlink.ProblemFile:
    """A walking leg of two dyads, whose short links lie close together."""
    raw = tomllib.loads(template("walker").text)
    for key, value in WALKER.items():
        place = raw["mechanism"]["links"]
        *path, last = key.split(".")
        for name in path:
            place = place[name]
        place[last] = [f"{x} mm" for x in value] if isinstance(value, list) else f"{value} mm"
    return optlink.read({"mechanism": raw["mechanism"]})


def four_bar(**sizes: str) -> optlink.ProblemFile:
    return optlink.read({"mechanism": {"type": "four-bar", **sizes}})


def offset_slider_crank() -> optlink.ProblemFile:
    lengths = {"mechanism.links.crank.length": "59.76 mm", "mechanism.links.rod.length": "93.64 mm"}
    return optlink.load("stroke-slider-crank", {**lengths, "mechanism.guides.G.offset": "6.455 mm"})


def test_the_offset_of_a_guide_is_dimensioned() -> None:
    """Without it a slider-crank cannot be built from its drawing."""
    drawing = dimensioned(optlink.analyze(offset_slider_crank()), "offset")
    assert "guide of slider at 0°, 6.455 from A" in drawing.words
    assert "6.455" in [text for text, _ in texts(drawing.svg)]
    central = dimensioned(optlink.analyze(optlink.load("slider-crank")), "central")
    assert "guide of slider at 0°, through A" in central.words
    assert "0" not in [text for text, _ in texts(central.svg)]
    swinging = dimensioned(optlink.analyze(optlink.load("oscillating-cylinder")), "on a body")
    assert "guide of piston 15 from D" in swinging.words
    assert "15" in [text for text, _ in texts(swinging.svg)]


DRAWN = {
    "offset": offset_slider_crank,
    "walker": walker,
    "wiper": lambda: four_bar(frame="250 mm", crank="21.21 mm", coupler="249.1 mm", rocker="30 mm", assembly="right"),
    **{
        name: (lambda name=name: optlink.load(name))
        for name in ("slotted-quick-return", "watt-i", "whitworth", "toggle-press", "shaper-design", "oscillating-cylinder")
    },
}


def texts(svg: str) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the dimensions and names with points inside their letters."""
    size = float(re.findall(r'data-layer="dimensions" font-family="sans-serif" font-size="([\d.]+)"', svg)[0])
    for x, y, rest, text in re.findall(r'<text x="(\S+)" y="(\S+)"([^>]*)>([^<]*)</text>', svg.partition('"dimensions"')[2]):
        if "aria-hidden" in rest:
            continue  # the white rim below the text
        turn = np.radians(float((re.findall(r"rotate\((\S+)", rest) or ["0"])[0]))
        u, v = np.meshgrid(np.linspace(-0.29, 0.29, 40) * size * len(text), np.linspace(-0.35, 0.35, 15) * size)
        turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        yield text, np.stack([u, v], axis=-1).reshape(-1, 2) @ turned + [float(x), float(y) - 0.35 * size]


@pytest.mark.parametrize("name", mostly_slow(DRAWN, "whitworth", "offset", "watt-i"))
def test_texts_are_clear_of_each_other_and_in_the_drawing(name: str) -> None:
    drawing = dimensioned(optlink.analyze(DRAWN[name]()), name)
    left, top, wide, high = map(float, re.findall(r'viewBox="(\S+) (\S+) (\S+) (\S+)"', drawing.svg)[0])
    computed = list(texts(drawing.svg))
    assert len(computed) >= 7
    for k, (text, place) in enumerate(computed):
        assert np.all((place > [left, top]) & (place < [left + wide, top + high])), text
        for other, beside in computed[:k]:
            assert not covers(place, beside), (text, other)


def covers(place: np.ndarray, other: np.ndarray) -> bool:
    """Return whether the boxes of two texts have a point in common."""
    corners = other[[0, 39, -40]]
    axes = corners[1:] - corners[0]
    shares = (place - corners[0]) @ axes.T / np.sum(axes**2, axis=1)
    return bool(np.any(np.all((shares >= 0.0) & (shares <= 1.0), axis=1)))
