"""Figures and files of disc cams, against the envelope of the positions of their followers."""

from __future__ import annotations

import csv
import math
import re
from pathlib import Path

import ezdxf
import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.linkage.elements import disc_cams
from optlink.linkage.motion import sweep

CAM = """
title = "Cam"
[mechanism.ground]
A = ["20 mm", "10 mm"]
[mechanism.links]
cam = { joints = ["A"] }
valve = { joints = ["R"] }
[mechanism.guides]
stem = { slider = "valve", through = "A", direction = "90 deg", offset = "-4 mm" }
[mechanism.cams.lobe]
cam = "cam"
follower = "valve"
base_radius = "30 mm"
roller = "10 mm"
law = [{ to = "50 deg", rise = "12 mm" }, { to = "150 deg" }, { to = "260 deg", fall = "12 mm" }, { to = "360 deg" }]
[drive]
body = "cam"
"""
ROLLER = 0.01


@pytest.fixture
def cam(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cam.toml").write_text(CAM, encoding="utf-8")
    return "cam.toml"


def run(*words):
    done = CliRunner().invoke(app, list(words))
    assert done.exit_code == 0, done.output
    return done.stdout


def centres(file, count=7200, **sizes):
    """Roller centre in the axes of the cam [m], complex, and the cam angles [rad]: the slide turned back."""
    model = optlink.load(file, {f"mechanism.cams.lobe.{name}": size for name, size in sizes.items()}).model
    angles = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
    slide = sweep(model.linkage, model.sizes({}), angles).coordinate("stem").value
    return (0.004 + 1j * slide) * np.exp(-1j * angles), angles


def curvature(points):
    """Signed curvature [1/m] of a closed curve through points, by differences of fourth order."""
    further, ahead, behind, before = (np.roll(points, -k) for k in (2, 1, -1, -2))
    first = (8.0 * (ahead - behind) - (further - before)) / 12.0
    second = (16.0 * (ahead + behind) - (further + before) - 30.0 * points) / 12.0
    return np.imag(np.conj(first) * second) / np.abs(first) ** 3


def test_figures_are_those_of_the_envelope(cam):
    model = optlink.load(cam).model
    (disc,) = disc_cams(sweep(model.linkage, model.sizes({}), [0.0]).pose).values()
    figures = disc.figures
    at, angles = centres(cam)
    assert figures.lift == pytest.approx(0.012)
    assert np.min(np.abs(at)) - ROLLER == pytest.approx(0.03, abs=1e-6)
    sharpest = np.max(-curvature(at))  # the pitch curve runs clockwise
    assert figures.radius[0] == pytest.approx(1.0 / sharpest - ROLLER, rel=1e-3)
    assert abs(curvature(at)[np.argmin(np.abs(angles - figures.radius[1]))]) == pytest.approx(sharpest, rel=1e-3)
    tangent = (np.roll(at, -1) - np.roll(at, 1)) * np.exp(1j * angles)  # in the fixed axes, where the follower moves along +y
    pressure = np.abs(np.angle(1j * tangent / np.abs(tangent) / 1j))
    pressure = np.minimum(pressure, math.pi - pressure)
    assert figures.pressure_angle[0] == pytest.approx(np.max(pressure), rel=1e-4)
    assert angles[np.argmax(pressure)] == pytest.approx(figures.pressure_angle[1], abs=0.01)
    assert math.isnan(figures.undercut)


def test_files_hold_the_closed_profile_and_the_pitch_curve(cam):
    at, _ = centres(cam)
    run("export", cam, "-o", "cam.dxf")
    lines = ezdxf.readfile("cam.dxf").blocks["LINK cam"].query("LWPOLYLINE")
    profile, pitch = sorted(lines, key=lambda line: line.dxf.layer == "MARKS")
    assert profile.closed
    assert pitch.closed
    assert (profile.dxf.layer, pitch.dxf.layer) == ("LINK cam", "MARKS")
    corners = 1e-3 * np.array(profile.get_points("xy")) @ [1.0, 1j]
    nearest = np.min(np.abs(corners[:, None] - at), axis=1)
    np.testing.assert_allclose(nearest, ROLLER, atol=2e-6)  # the roller touches the profile everywhere and cuts it nowhere
    assert np.ptp(np.unwrap(np.angle(corners))) > 6.1  # all round
    corners = 1e-3 * np.array(pitch.get_points("xy")) @ [1.0, 1j]
    assert np.max(np.min(np.abs(corners[:, None] - at), axis=1)) < 3e-5
    run("export", cam, "-o", "cam.csv", "--points", "90")
    with Path("cam.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    points = np.array([float(row["lobe.profile_x_m"]) + 1j * float(row["lobe.profile_y_m"]) for row in rows])
    np.testing.assert_allclose(np.min(np.abs(points[:, None] - at), axis=1), ROLLER, atol=1e-7)
    assert abs(points[0] - points[-1]) < 1e-12
    run("export", cam, "-o", "cam.svg")
    drawn = re.findall(r'<path d="M([^"]*)"', Path("cam.svg").read_text(encoding="utf-8"))
    curves = [
        np.array(re.findall(r"-?[\d.]+", path), dtype=float).reshape(-1, 2) @ [1e-3, -1e-3j]
        for path in drawn
        if path.count("L") > 121
    ]
    distances = [np.min(np.abs(curve[:, None] - at), axis=1) for curve in curves]
    assert sorted(round(float(np.median(distance)), 3) for distance in distances) == [0.0, ROLLER]
    assert all(abs(curve[0] - curve[-1]) < 1e-3 for curve in curves)


@pytest.mark.parametrize(("base", "roller", "undercut"), [(30, 10, False), (20, 20, True)])
def test_the_analysis_tells_whether_a_cam_is_undercut(cam, base, roller, undercut):
    sizes = {"base_radius": f"{base} mm", "roller": f"{roller} mm"}
    changes = [word for name, size in sizes.items() for word in ("--set", f"mechanism.cams.lobe.{name}={size}")]
    text = run("analyze", cam, *changes)
    line = next(line for line in text.splitlines() if line.startswith("undercut"))
    at, angles = centres(cam, **sizes)
    radii = 1.0 / np.maximum(-curvature(at), 1e-9)
    assert bool(np.min(radii) < 1e-3 * roller) is undercut
    assert ("yes" in line) is undercut
    if undercut:
        place = math.radians(float(line.split("cam angle")[1].split()[0]))
        assert radii[np.argmin(np.abs(angles - place))] < 1e-3 * roller
