"""Share links of PMKS+ that optlink writes: read again, the linkage moves as before; and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import optlink
from optlink.presentation.export.pmks import share_link
from optlink.problem.foreign import problem_text
from tests.cli.test_cli import run

ROOT = Path(__file__).parents[2]
ROUNDED = 5e-6
"""Largest error of a coordinate [m]: half of a thousandth of a centimetre."""


def deviation(first: optlink.Problem, second: optlink.Problem) -> float:
    """Return the largest distance of equally named points over a turn from the start [m]."""
    models, places = [first.model, second.model], []
    names = models[0].linkage.owners.keys() & models[1].linkage.owners.keys()
    for model in models:
        poses = [
            model.linkage.at(model.machine().sizes, model.driving.first + turned) for turned in np.linspace(0.0, math.tau, 37)
        ]
        places.append(np.array([[[float(part) for part in pose.point(name)] for name in sorted(names)] for pose in poses]))
    return float(np.max(np.hypot(*np.moveaxis(places[0] - places[1], -1, 0))))


@pytest.mark.parametrize("name", ["crank-rocker", "slider-crank", "six-bar", "watt-i", "stephenson-iii"])
@pytest.mark.parametrize("sense", [1, -1])
def test_a_link_read_again_gives_the_same_motion(name, sense, tmp_path):
    loaded = optlink.load(name, {"drive.speed": f"{sense * 12.345} rpm"})
    cycle = optlink.analyze(loaded)
    (tmp_path / "link.txt").write_text(share_link(cycle, float(cycle.positions[0])))
    (tmp_path / "again.toml").write_text(problem_text(str(tmp_path / "link.txt")))
    again = optlink.load(tmp_path / "again.toml")
    assert again.model.driving.pace == pytest.approx(sense * 12.345 * math.tau / 60.0, rel=1e-12)
    moving = {point for point, owners in cycle.machine.mechanism.owners.items() if owners != ("frame",)}
    assert moving == set(again.model.linkage.owners)
    assert 0.0 < deviation(loaded, again) < 10.0 * ROUNDED


def test_export_writes_a_link_that_new_reads(tmp_path):
    link, again = tmp_path / "link.txt", tmp_path / "again.toml"
    done = run("export", "six-bar", "-o", str(link), "--content", "pmks")
    assert done.exit_code == 0, done.stderr
    assert link.read_text().startswith("https://app.pmksplus.com/?2O.")
    done = run("new", "--from", str(link), "--out", str(again))
    assert done.exit_code == 0, done.stderr
    assert deviation(optlink.load("six-bar"), optlink.load(again)) < 10.0 * ROUNDED


REFUSED = {
    "whitworth": "mechanism.guides.G: PMKS+ has no counterpart for the guide G on the moving body arm. "
    "Export a machine with guides on the frame",
    "lift": "drive: PMKS+ has no counterpart for a drive other than a crank at constant speed. "
    'Drive a body pinned to the frame: speed = "60 rpm"',
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_pmks_cannot_have_is_refused_by_name(name):
    cycle = optlink.analyze(optlink.load(ROOT / "templates/lift.toml") if name == "lift" else name)
    with pytest.raises(optlink.InputError) as error:
        share_link(cycle, float(cycle.positions[0]))
    assert str(error.value).endswith(f": {REFUSED[name]}")


def test_further_points_of_a_slider_are_refused(tmp_path):
    text = (ROOT / "problems/slider-crank.toml").read_text()
    assert 'slider = { joints = ["E"] }' in text
    (tmp_path / "ram.toml").write_text(
        text.replace('slider = { joints = ["E"] }', 'slider = { joints = ["E"], points = { P = ["10 mm", "0 mm"] } }')
    )
    cycle = optlink.analyze(tmp_path / "ram.toml")
    with pytest.raises(optlink.InputError, match="PMKS\\+ has no counterpart for further points of the slider slider"):
        share_link(cycle, float(cycle.positions[0]))
