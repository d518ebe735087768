"""Texts of the dimensioned drawing lie clear of the links."""

from __future__ import annotations

import re

import numpy as np
import pytest

import optlink
from optlink.report.export.dimensions import dimensioned
from optlink.report.scene import scene

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
    covered = (np.abs(rocker[:, 0] - x) < 0.31 * size * len(swing)) & (np.abs(rocker[:, 1] - y) < 0.4 * size)
    assert not np.any(covered)


def test_the_text_of_a_full_turn_is_clear_of_its_arc() -> None:
    cycle = optlink.analyze(optlink.load("six-bar"))
    drawing = dimensioned(cycle, "six-bar")
    size = float(re.findall(r'font-size="([\d.]+)"', drawing.svg)[-1])
    (place,) = re.findall(r'<text x="(\S+)" y="(\S+)"[^>]*>360°</text>', drawing.svg)
    arcs = [
        np.array(re.findall(r"[-\d.e]+", path), dtype=float).reshape(-1, 2)
        for path in re.findall(r'<path d="(M[^"Z]+)"', drawing.svg)
    ]
    arc = max(arcs, key=len)  # of 300 degrees, in steps of 4
    assert len(arc) > 60
    away = np.abs(arc - np.array(place, dtype=float))
    assert not np.any((away[:, 0] < 0.5 * 0.62 * size * 4) & (away[:, 1] < 0.35 * size))
