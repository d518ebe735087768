"""Wanted points of a path: every way to state them gives the right points, and whatever is wrong is named with key and row."""

from __future__ import annotations

import cmath
import itertools
import math
import os
import random
import string

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import optlink
from optlink.problem.quantity import Unusable
from optlink.problem.targets.points import read_points
from optlink.problem.targets.target_points import DEFAULT_POINTS, MAX_POINTS, TargetPoints, closed

CIRCLE = {"x": "20*cos(t)", "y": "20*sin(t)", "unit": "mm", "t": [0, "2*pi"], "points": 40}


def mm(expected: TargetPoints) -> np.ndarray:
    return 1e3 * np.array(expected.points)


def refused(raw, folder, key, words):
    with pytest.raises(Unusable) as caught:
        read_points(raw, folder)
    error = caught.value
    assert words in error.message, error.message
    assert error.key == key
    assert error.remedy
    assert len(str(error)) < 700
    assert "\n" not in str(error)
    return error


def svg(folder, body, root='viewBox="0 0 80 60"', name="drawing.svg", **more):
    text = f'<svg xmlns="http://www.w3.org/2000/svg" {root}>{body}</svg>'
    (folder / name).write_text(text)
    return {"svg": name, **more}


# ---- lists


def test_list_of_points(tmp_path):
    expected = read_points([["20 mm", "25 mm"], ["2.5 cm", "-1e-2 m"], ["1 in", "0 mm"]], tmp_path)
    np.testing.assert_allclose(mm(expected), [[20, 25], [25, -10], [25.4, 0]], rtol=1e-14)
    assert expected == TargetPoints(expected.points)
    assert not closed(expected)
    assert read_points([["1 in", "0 in"]], tmp_path).unit == "in"
    assert read_points([["1 in", "0 in"]], tmp_path).points == ((0.0254, 0.0),)


POSES = [("0 mm", "0 mm", "0 deg"), ("60 mm", "50 mm", "40 deg"), ("90 mm", "140 mm", "90 deg"), ("0 mm", "0 mm", "360 deg")]


@pytest.mark.parametrize("changes", [{"closed": True}, {"crank": [0, 60, 120, 180]}, {"angle": "1 deg"}])
def test_a_pose_may_occur_again_if_it_is_timed_or_closes_the_motion(changes):
    rows = [{"x": x, "y": y, "angle": angle} for x, y, angle in POSES]
    if "crank" in changes:
        rows = [{**row, "crank": f"{crank} deg"} for row, crank in zip(rows, changes["crank"], strict=True)]
    rows[-1]["angle"] = changes.get("angle", rows[-1]["angle"])
    keys = {"requirement.points": rows} | ({"requirement.closed": True} if "closed" in changes else {})
    assert len(optlink.load("motion-3-poses", keys).model.target_points.points) >= 3


def test_rows_as_tables_and_lists_mixed(tmp_path):
    raw = [
        {"x": "20 mm", "y": "25 mm", "crank": "30 deg", "angle": "10 deg", "weight": 2.0, "tolerance": "0.1 mm"},
        {"x": "21 mm", "y": "25 mm", "crank": "1 rad", "angle": "0 deg"},
    ]
    expected = read_points(raw, tmp_path)
    np.testing.assert_allclose(expected.crank, [math.pi / 6, 1.0])
    np.testing.assert_allclose(expected.angles, [math.pi / 18, 0.0])
    assert expected.weights == (2.0, 1.0)
    assert expected.tolerances == (pytest.approx(1e-4), math.inf)
    among = read_points([{"x": "1 mm", "y": "2 mm", "angle": "90 deg"}, ["3 mm", "4 mm"]], tmp_path)
    assert among.angles == (pytest.approx(math.pi / 2), pytest.approx(math.nan, nan_ok=True))
    assert among.posed.tolist() == [True, False]
    (tmp_path / "among.csv").write_text("x_mm,y_mm,angle_deg\n1,2,90\n3,4,\n", "utf-8")
    assert read_points({"csv": "among.csv"}, tmp_path).posed.tolist() == [True, False]
    twice = [{"x": "1 mm", "y": "2 mm", "angle": "90 deg"}, ["1 mm", "2 mm"], ["3 mm", "4 mm"]]
    refused(twice, tmp_path, "[1]", "points 1 and 2 coincide")
    mixed = read_points([["1 mm", "2 mm"], {"x": "3 mm", "y": "4 mm"}, {"x": "5 mm", "y": "6 mm", "weight": 3}], tmp_path)
    np.testing.assert_allclose(mm(mixed), [[1, 2], [3, 4], [5, 6]])
    assert (mixed.crank, mixed.angles, mixed.weights, mixed.tolerances) == (None, None, (1.0, 1.0, 3.0), None)


def test_listed_points_stay_as_they_are_when_they_close(tmp_path):
    square = [["0 mm", "0 mm"], ["1 mm", "0 mm"], ["1 mm", "1 mm"], ["0 mm", "0 mm"]]
    expected = read_points(square, tmp_path)
    assert len(expected.points) == 4
    assert closed(expected)
    assert not expected.loop
    assert not closed(read_points(square[:3], tmp_path))
    assert not closed(read_points(square[:1], tmp_path))


def test_dwells_and_turns_in_place(tmp_path):
    dwell = [{"x": "1 mm", "y": "0 mm", "crank": f"{10 * k} deg"} for k in range(3)]
    assert read_points([*dwell, {"x": "2 mm", "y": "0 mm", "crank": "90 deg"}], tmp_path).crank is not None
    turn = [{"x": "1 mm", "y": "0 mm", "angle": f"{10 * k} deg"} for k in range(3)]
    assert len(read_points(turn, tmp_path).points) == 3
    refused([*turn, turn[-1]], tmp_path, "[3]", "points 3 and 4 coincide")
    refused(dwell, tmp_path, "", "all points coincide")


def test_long_list_is_reduced(tmp_path):
    line = [[f"{k**2 / 1000!r} mm", "5 mm"] for k in range(1001)]
    expected = read_points(line, tmp_path)
    assert expected.note == "1,001 points were reduced to 400, evenly by arc length"
    np.testing.assert_allclose(mm(expected)[:, 0], np.linspace(0, 1000, MAX_POINTS), atol=1e-9)
    cranks = [{"x": f"{k} mm", "y": "5 mm", "crank": f"{k * 0.36!r} deg", "tolerance": f"{k + 1} mm"} for k in range(1001)]
    expected = read_points(cranks, tmp_path)
    assert expected.note == "1,001 points were reduced to 400, evenly by rows"
    picked = mm(expected)[:, 0]
    np.testing.assert_allclose(picked, np.round(picked), atol=1e-9)
    np.testing.assert_allclose(np.degrees(expected.crank), 0.36 * picked)
    np.testing.assert_allclose(1e3 * np.array(expected.tolerances), picked + 1)
    assert picked[[0, -1]].tolist() == pytest.approx([0, 1000])
    assert set(np.diff(np.round(picked))) <= {2, 3}


P = {"x": "20 mm", "y": "25 mm"}


def cranked(*degrees):
    return [{"x": f"{k} mm", "y": "0 mm", "crank": f"{angle} deg"} for k, angle in enumerate(degrees)]


def test_crank_angles_rise_or_fall_within_a_turn(tmp_path):
    for good in [(0, 10, 360), (0, -10, -360), (350, 370, 710), (5,)]:
        assert np.degrees(read_points(cranked(*good), tmp_path).crank) == pytest.approx(good)


# ---- CSV


def test_csv_in_any_order_with_gaps(tmp_path):
    (tmp_path / "c.csv").write_text(
        "\ufefftolerance_mm, y_mm ,x_m,crank_deg,weight,angle_rad,\n\n0.1,25,0.020,30,,0.5,\n,26,0.021,40,2.5,0.6\n", "utf-8"
    )
    expected = read_points({"csv": "c.csv"}, tmp_path)
    np.testing.assert_allclose(mm(expected), [[20, 25], [21, 26]])
    np.testing.assert_allclose(np.degrees(expected.crank), [30, 40])
    assert expected.angles == (0.5, 0.6)
    assert expected.weights == (1.0, 2.5)
    assert expected.tolerances == (pytest.approx(1e-4), math.inf)
    assert expected.unit == "m"
    assert expected.note == ""


@pytest.mark.parametrize(
    "content",
    [
        "x_mm\ty_mm\n1\t-2\n3\t4\n".encode("utf-16"),  # the "Unicode text" of Excel
        "# Länge in mm\nx_mm,y_mm\n1,-2\n3,4\n".encode("latin-1"),
        "x_mm,y_mm\n1,\u22122\n3,4\n".encode(),
        b'"x_mm", "y_mm"\n"1", "-2"\n"3", "4"\n',
        b'% from a drawing: "A, \r\nx_mm,y_mm\r\n1,-2\r\n  # the last one\r\n3,4',
    ],
    ids=["UTF-16", "Latin-1", "minus sign", "blanks before quotes", "comments"],
)
def test_csv_in_other_spellings_is_the_same(tmp_path, content):
    (tmp_path / "c.csv").write_bytes(content)
    np.testing.assert_allclose(mm(read_points({"csv": "c.csv"}, tmp_path)), [[1, -2], [3, 4]])


@pytest.mark.parametrize("sign", [";", "\t"])
def test_csv_with_other_delimiters_is_the_same(tmp_path, sign):
    (tmp_path / "c.csv").write_text(f"x_mm{sign}y_mm\r\n1{sign}2\r\n3{sign}4\r\n")
    np.testing.assert_allclose(mm(read_points({"csv": "c.csv"}, tmp_path)), [[1, 2], [3, 4]])


@pytest.mark.slow
def test_csv_of_a_hundred_thousand_rows(tmp_path):
    t = np.linspace(0.0, 2.0 * np.pi, 100_000) ** 2 / (2.0 * np.pi)  # unevenly spaced on purpose
    np.savetxt(
        tmp_path / "curve.csv", np.stack([50 + 30 * np.cos(t), 30 * np.sin(t)], 1), "%.10f", ",", header="x_mm,y_mm", comments=""
    )
    expected = read_points({"csv": "curve.csv", "points": 200}, tmp_path)
    assert expected.note == "100,000 points of curve.csv were reduced to 200, evenly by arc length"
    assert expected.loop
    assert closed(expected)
    angle = 2.0 * np.pi * np.arange(200) / 200
    np.testing.assert_allclose(mm(expected), np.stack([50 + 30 * np.cos(angle), 30 * np.sin(angle)], 1), atol=1e-6)
    assert len(read_points({"csv": "curve.csv"}, tmp_path).points) == MAX_POINTS


def test_fewer_rows_than_requested_are_all_kept(tmp_path):
    (tmp_path / "c.csv").write_text("x_mm,y_mm\n1,2\n3,4\n")
    expected = read_points({"csv": "c.csv", "points": 60}, tmp_path)
    assert len(expected.points) == 2
    assert expected.note == "c.csv has 2 points, fewer than the requested 60; all of them are used"


def test_repeated_rows_do_no_harm_where_the_curve_is_reduced(tmp_path):
    (tmp_path / "c.csv").write_text("x_mm,y_mm\n" + "".join(f"{k // 3},0\n" for k in range(3000)))
    expected = read_points({"csv": "c.csv", "points": 10}, tmp_path)
    np.testing.assert_allclose(mm(expected)[:, 0], np.linspace(0, 999, 10))


def test_a_missing_number_has_no_value(tmp_path):
    """Not "nothing", as if the file were called so."""
    (tmp_path / "c.csv").write_text("x_mm,y_mm\n1,2\n3\n")
    assert refused({"csv": "c.csv"}, tmp_path, "csv", "row 3 of c.csv").value is None


def test_the_separator_line_of_a_spreadsheet_is_no_row(tmp_path):
    (tmp_path / "c.csv").write_bytes(b"\xef\xbb\xbfsep=;\r\nx_mm;y_mm\r\n1;2\r\n3;4.5\r\n")
    np.testing.assert_allclose(mm(read_points({"csv": "c.csv"}, tmp_path)), [[1, 2], [3, 4.5]])


@pytest.mark.parametrize("form", ["csv", "svg"])
def test_files_that_are_not_tables(tmp_path, form):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for name, words in {
        "nothing.csv": "no such file",
        "folder": "it is a folder",
        "pipe": "not a regular file",
        "/dev/zero": "not a regular file",
        "a\0b": "expected the name of a file",
        "": "expected the name of a file",
        "x" * 5000: "cannot read the file",
        "nothing\nhere": "no such file",
    }.items():
        refused({form: name}, tmp_path, form, words)
    refused({form: 3}, tmp_path, form, "expected the name of a file")
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(50_000_001)
    refused({form: "huge"}, tmp_path, form, "larger than 50 MB")


def test_too_many_rows(tmp_path, monkeypatch):
    monkeypatch.setattr("optlink.problem.targets.target_points.MOST_POINTS", 5)
    monkeypatch.setattr("optlink.problem.targets.points.MAX_ELEMENTS", 5)
    (tmp_path / "c.csv").write_text("x_mm,y_mm\n" + "".join(f"{k},0\n" for k in range(6)))
    refused({"csv": "c.csv"}, tmp_path, "csv", "more than 5 rows")
    refused([[f"{k} mm", "0 mm"] for k in range(6)], tmp_path, "", "6 points, more than 5")
    refused(svg(tmp_path, "<g/>" * 6), tmp_path, "svg", "more than 5 elements")


# ---- expressions


def test_expression_evenly_in_t(tmp_path):
    raw = {"x": "20*cos(t)", "y": "10*sin(t)", "unit": "mm", "t": [0, "2*pi"], "points": 40}
    expected = read_points(raw, tmp_path)
    t = 2.0 * np.pi * np.arange(40) / 40
    np.testing.assert_allclose(mm(expected), np.stack([20 * np.cos(t), 10 * np.sin(t)], 1), atol=1e-12)
    assert expected.loop
    assert closed(expected)
    assert "40 points evenly by t; it is closed" in expected.note
    half = read_points({**raw, "t": ["pi", 0], "unit": "in"}, tmp_path)
    t = np.linspace(np.pi, 0.0, 40)
    np.testing.assert_allclose(mm(half), 25.4 * np.stack([20 * np.cos(t), 10 * np.sin(t)], 1), atol=1e-12)
    assert not closed(half)
    assert half.unit == "in"
    constant = read_points({"x": "5", "y": "t", "unit": "mm", "t": [0, 1]}, tmp_path)
    np.testing.assert_allclose(mm(constant)[:, 0], 5.0)
    assert len(constant.points) == DEFAULT_POINTS


def test_expression_evenly_by_arc_length(tmp_path):
    """The arc between any two neighbours, by adaptive quadrature of the speed: all equal, and equal to the stated length."""
    raw = {"x": "20*cos(t)", "y": "5*sin(t)", "unit": "mm", "t": [0, "2*pi"], "points": 12, "spacing": "arc length"}
    points = mm(read_points(raw, tmp_path))
    t = np.append(np.unwrap(np.arctan2(points[:, 1] / 5, points[:, 0] / 20)), 2 * np.pi)

    def speed(t):
        return math.hypot(20 * math.sin(t), 5 * math.cos(t))

    arcs = [quad(speed, a, b, epsabs=1e-12)[0] for a, b in itertools.pairwise(t)]
    np.testing.assert_allclose(arcs, quad(speed, 0, 2 * np.pi, epsabs=1e-12, limit=200)[0] / 12, rtol=1e-7)


# ---- SVG: the oracle walks the path by de Casteljau and tries both centres of an arc; it shares nothing with the reader


def casteljau(points, u):
    points = list(points)
    while len(points) > 1:
        points = [(1 - u) * a + u * b for a, b in itertools.pairwise(points)]
    return points[0]


def arc_oracle(start, end, rx, ry, degrees, large, sweep):
    """The ellipse is made a unit circle; of its two centres and two ways round, that which has the wanted flags."""
    turn = cmath.exp(1j * math.radians(degrees))

    def to_circle(z):
        w = z / turn
        return complex(w.real / rx, w.imag / ry)

    a, b = to_circle(start), to_circle(end)
    half = abs(b - a) / 2
    grow = max(1.0, half)  # radii that do not reach are scaled up
    for side in (1, -1):
        centre = (a + b) / 2 + side * 1j * (b - a) / abs(b - a) * math.sqrt(max(grow**2 - half**2, 0.0))
        begin = cmath.phase(a - centre)
        for way in (1, -1):
            extent = way * ((way * (cmath.phase(b - centre) - begin)) % (2 * math.pi))
            if (way == 1) == bool(sweep) and ((abs(extent) > math.pi) == bool(large) or half >= grow):

                def at(u, centre=centre, begin=begin, extent=extent):
                    w = centre + grow * np.exp(1j * (begin + extent * u))
                    return turn * (w.real * rx + 1j * w.imag * ry)

                return at
    raise AssertionError


def lined(a, b):
    return lambda u: a + u * (b - a)


def curved(*points):
    return lambda u: casteljau(points, u)


# absolute coordinates throughout, worked out by hand from the relative ones
EVERY = (
    "M10,10 L 30 10 l5 5 H 50 h-5 V30 v 5 C 50 40 60 40 60 30 c 0-5 5-10,10-10 S 80 30 80 40 s -5 10 -10 10 "
    "Q 60 60 50 50 q-5-5-10 0 T 30 50 t-5,5 A 8 5 30 0 1 15 45 a6 9 -20 10-5-5 Z"
)
PIECES = [
    lined(10 + 10j, 30 + 10j),
    lined(30 + 10j, 35 + 15j),
    lined(35 + 15j, 50 + 15j),
    lined(50 + 15j, 45 + 15j),
    lined(45 + 15j, 45 + 30j),
    lined(45 + 30j, 45 + 35j),
    curved(45 + 35j, 50 + 40j, 60 + 40j, 60 + 30j),
    curved(60 + 30j, 60 + 25j, 65 + 20j, 70 + 20j),
    curved(70 + 20j, 75 + 20j, 80 + 30j, 80 + 40j),
    curved(80 + 40j, 80 + 50j, 75 + 50j, 70 + 50j),
    curved(70 + 50j, 60 + 60j, 50 + 50j),
    curved(50 + 50j, 45 + 45j, 40 + 50j),
    curved(40 + 50j, 35 + 55j, 30 + 50j),
    curved(30 + 50j, 25 + 45j, 25 + 55j),
    arc_oracle(25 + 55j, 15 + 45j, 8, 5, 30, 0, 1),
    arc_oracle(15 + 45j, 10 + 40j, 6, 9, -20, 1, 0),
    lined(10 + 40j, 10 + 10j),
]


def measured(pieces, n=20_000):
    """Arc length to each of many points of the pieces, and the points."""
    z = np.concatenate([piece(np.linspace(0, 1, n)) for piece in pieces])
    return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(z)))]), z


def test_every_command_of_a_path(tmp_path):
    reference = read_points(svg(tmp_path, f'<path id="c" d="{EVERY}"/>', path="c", points=97), tmp_path)
    assert reference.loop
    points = mm(reference) @ [1, -1j]  # back to y down
    here, z = measured(PIECES)
    at = here[-1] * np.arange(97) / 97
    expected = np.interp(at, here, z.real) + 1j * np.interp(at, here, z.imag)
    np.testing.assert_allclose(points, expected, atol=2e-5)


@pytest.mark.parametrize("large", [0, 1])
@pytest.mark.parametrize("sweep", [0, 1])
@pytest.mark.parametrize("radii", ["15 8", "3 2", "12 30"])
def test_arcs_of_every_flag(tmp_path, large, sweep, radii):
    rx, ry = map(float, radii.split())
    reference = read_points(svg(tmp_path, f'<path d="M2 3A{radii} 40 {large}{sweep}20 9"/>', points=21), tmp_path)
    here, z = measured([arc_oracle(2 + 3j, 20 + 9j, rx, ry, 40, large, sweep)])
    at = np.linspace(0, here[-1], 21)
    expected = np.interp(at, here, z.real) + 1j * np.interp(at, here, z.imag)
    np.testing.assert_allclose(mm(reference) @ [1, -1j], expected, atol=1e-5)


def test_even_spacing_of_a_bezier_by_quadrature(tmp_path):
    """Parameters of the points found by root search; the arcs between them by adaptive quadrature of the derivative."""
    control = np.array([0 + 0j, 10 + 60j, 70 + 50j, 80 + 0j])
    expected = read_points(svg(tmp_path, '<path d="M0 0C10 60 70 50 80 0"/>', points=9), tmp_path)
    x = mm(expected)[:, 0]
    u = [brentq(lambda u, x=x: casteljau(control, u).real - x, 0, 1, xtol=1e-15) for x in np.clip(x, 0, 80)]
    steps = 3 * np.diff(control)
    arcs = [quad(lambda u: abs(casteljau(steps, u)), a, b, epsabs=1e-12)[0] for a, b in itertools.pairwise(u)]
    np.testing.assert_allclose(arcs, np.mean(arcs), rtol=2e-6)
    np.testing.assert_allclose(mm(expected)[:, 1], [-casteljau(control, u).imag for u in u], atol=1e-9)


def test_cusp_and_needle_do_not_upset_the_spacing(tmp_path):
    reference = read_points(svg(tmp_path, '<path d="M0 0C20 20 0 20 20 0"/>', points=30), tmp_path)
    here, z = measured([curved(0j, 20 + 20j, 20j, 20 + 0j)], 200_000)
    at = np.linspace(0, here[-1], 30)
    expected = np.interp(at, here, z.real) + 1j * np.interp(at, here, z.imag)
    np.testing.assert_allclose(mm(reference) @ [1, -1j], expected, atol=1e-4)
    needle = svg(tmp_path, '<path d="M0 0 L10 0 Z"/>', points=7)
    refused(needle, tmp_path, "points", "points 4 and 5 coincide")


def test_y_points_up(tmp_path):
    expected = read_points(svg(tmp_path, '<path d="M10 20 L 40 50"/>', points=2), tmp_path)
    np.testing.assert_allclose(mm(expected), [[10, -20], [40, -50]])
    assert not closed(expected)
    assert "one user unit is 1 mm, not stated in the file" in expected.note


SHAPES = {
    "line": ('<line x1="1" y1="2" x2="4" y2="6"/>', 2, [1 + 2j, 4 + 6j]),
    "polyline": ('<polyline points="0,0 10,0 10,10"/>', 3, [0, 10, 10 + 10j]),
    "polygon": ('<polygon points="0 0 10 0 10 10 0 10"/>', 4, [0, 10, 10 + 10j, 10j]),
    "rect": ('<rect x="1" y="2" width="10" height="10"/>', 4, [1 + 2j, 11 + 2j, 11 + 12j, 1 + 12j]),
    "circle": ('<circle cx="5" cy="6" r="10"/>', 4, [15 + 6j, 5 + 16j, -5 + 6j, 5 - 4j]),
    "ellipse": ('<ellipse cx="5" cy="6" rx="10px" ry="3"/>', 4, [15 + 6j, 5 + 9j, -5 + 6j, 5 + 3j]),
    "flat arc": ('<path d="M0 0 A 0 5 0 0 1 10 0"/>', 3, [0, 5, 10]),
    "arc to itself": ('<path d="M0 0 A 5 5 0 0 1 0 0 L 10 0"/>', 2, [0, 10]),
    "goes on after Z": ('<path d="M0 0 L 10 0 10 10 0 10 z l -10 0"/>', 6, [0, 10, 10 + 10j, 10j, 0, -10]),
    "needless moves": ('<path d="M 5 5 m 1 1 M 0 0 L 4 0 M 4 0 L 8 0 M 9 9"/>', 3, [0, 4, 8]),
    "half turn twice": ('<path d="M0 0 a 5 5 0 0 1 10 0 a 5 5 0 0 1 -10 0"/>', 4, [0, 5 - 5j, 10, 5 + 5j]),
    "exponents": ('<path d="M1e1-.5L2E+1-.5"/>', 2, [10 - 0.5j, 20 - 0.5j]),
}


@pytest.mark.parametrize("name", SHAPES)
def test_other_shapes_and_corners_of_the_grammar(tmp_path, name):
    body, count, expected = SHAPES[name]
    reference = read_points(svg(tmp_path, body, points=count), tmp_path)
    np.testing.assert_allclose(mm(reference) @ [1, -1j], expected, atol=1e-6)


TRANSFORMS = {
    "translate(3)": lambda z: z + 3,
    "translate(3,-4)": lambda z: z + 3 - 4j,
    "scale(2)": lambda z: 2 * z,
    "scale(2 -3)": lambda z: complex(2 * z.real, -3 * z.imag),
    "rotate(30)": lambda z: z * cmath.exp(1j * math.pi / 6),
    "rotate(30, 5 6)": lambda z: (z - 5 - 6j) * cmath.exp(1j * math.pi / 6) + 5 + 6j,
    "skewX(30)": lambda z: z + z.imag * math.tan(math.pi / 6),
    "skewY(30)": lambda z: z + 1j * z.real * math.tan(math.pi / 6),
    "matrix(1 2 3 4 5 6)": lambda z: complex(z.real + 3 * z.imag + 5, 2 * z.real + 4 * z.imag + 6),
    "translate(3) , scale(2)": lambda z: 2 * z + 3,
    "": lambda z: z,
}


@pytest.mark.parametrize("text", TRANSFORMS)
def test_transforms_are_honoured(tmp_path, text):
    body = f'<g transform="rotate(90)"><a><path transform="{text}" d="M1 2 L 7 4"/></a></g>'
    points = mm(read_points(svg(tmp_path, body, points=2), tmp_path)) @ [1, -1j]
    np.testing.assert_allclose(points, [1j * TRANSFORMS[text](1 + 2j), 1j * TRANSFORMS[text](7 + 4j)], atol=1e-9)


def test_arc_length_is_that_of_the_transformed_curve(tmp_path):
    body = '<circle r="5" transform="scale(4, 1)"/>'
    expected = read_points(svg(tmp_path, body, points=12), tmp_path)
    drawn = read_points(
        {"x": "20*cos(t)", "y": "-5*sin(t)", "unit": "mm", "t": [0, "2*pi"], "points": 12, "spacing": "arc length"}, tmp_path
    )
    np.testing.assert_allclose(mm(expected), mm(drawn), atol=1e-4)


SCALES = {
    "none": ("", {}, 1.0, "mm"),
    "viewBox alone": ('viewBox="0 0 800 600"', {}, 1.0, "mm"),
    "plain width": ('width="800" viewBox="0 0 80 60"', {}, 254 / 96, "mm"),
    "pixels": ('width="800px" viewBox="0 0 80 60"', {}, 254 / 96, "mm"),
    "pixels and a unit": ('width="800px" viewBox="0 0 80 60"', {"unit": "2 mm"}, 2.0, "mm"),
    "plain, no viewBox": ('width="800" height="600"', {}, 25.4 / 96, "mm"),
    "per cent": ('width="100%" height="100%" viewBox="0 0 80 60"', {}, 1.0, "mm"),
    "true": ('width="80mm" height="60mm" viewBox="0 0 800 600"', {}, 0.1, "mm"),
    "inch": ('width="8in" viewBox="0,0,8,6"', {}, 25.4, "mm"),
    "height alone": ('height="6cm" viewBox="-10 -10 800 600"', {}, 0.1, "mm"),
    "meets": ('width="80mm" height="120mm" viewBox="0 0 800 600"', {}, 0.1, "mm"),
    "slices": ('width="80mm" height="120mm" viewBox="0 0 800 600" preserveAspectRatio="xMidYMid slice"', {}, 0.2, "mm"),
    "no viewBox": ('width="80mm"', {}, 25.4 / 96, "mm"),
    "stated": ("", {"unit": "in"}, 25.4, "in"),
    "stated beats true": ('width="80mm" height="60mm" viewBox="0 0 800 600"', {"unit": "mm"}, 1.0, "mm"),
    "stated beats broken": ('width="80mm" viewBox="broken"', {"unit": "cm"}, 10.0, "cm"),
}


@pytest.mark.parametrize("name", SCALES)
def test_scale_of_a_drawing(tmp_path, name):
    root, more, scale, unit = SCALES[name]
    expected = read_points(svg(tmp_path, '<path d="M10 20 L 40 50"/>', root, points=2, **more), tmp_path)
    np.testing.assert_allclose(mm(expected), scale * np.array([[10, -20], [40, -50]]), rtol=1e-12)
    assert expected.unit == unit
    assert f"one user unit is {scale:.6g} mm" in expected.note
    assert ("though the file states 0.1 mm" in expected.note) == (name == "stated beats true")
    at_72 = 'at 96 px an inch; at 72 px, as in Illustrator, add unit = "3.52778 mm"'
    assert (at_72 in expected.note) == (name in ("plain width", "pixels"))


def test_paths_by_id_and_number(tmp_path):
    body = (
        '<defs><path id="d" d="M0 0L1 1"/></defs><rect id="page" width="9" height="9"/>'
        '<path id="a" d="M1 0L2 2"/><g><path id="7" d="M2 0L2 2"/><path d="M3 0L2 2"/></g>'
    )

    def first(**more):
        return mm(read_points(svg(tmp_path, body, points=2, **more), tmp_path))[0, 0]

    assert [first(path=path) for path in (1, 2, 3, "a", "7", "3", "page")] == pytest.approx([1, 2, 3, 1, 2, 3, 0])
    assert len(read_points(svg(tmp_path, '<text>M</text><circle id="c" r="3"/>'), tmp_path).points) == DEFAULT_POINTS


LINE = '<path id="p" d="M0 0 L9 9"/>'


LAUGHS = (
    '<!DOCTYPE svg [<!ENTITY a "ha">'
    + "".join(f'<!ENTITY {chr(98 + k)} "{f"&{chr(97 + k)};" * 10}">' for k in range(20))
    + ']><svg xmlns="http://www.w3.org/2000/svg"><path d="&u;"/></svg>'
)
OUTER = '<!DOCTYPE svg PUBLIC "-//W3C//DTD SVG 1.1//EN" "http://www.w3.org/Graphics/SVG/1.1/DTD/svg11.dtd">'
HOSTILE = {
    "billion laughs": (LAUGHS.encode(), "declares entities"),
    "in UTF-16": (LAUGHS.encode("utf-16"), "declares entities"),
    "a file inside": (b'<!DOCTYPE svg [<!ENTITY a SYSTEM "file:///etc/passwd">]><svg><path d="&a;"/></svg>', "declares entities"),
    "unknown entity": (f'{OUTER}<svg><path d="M0 0 &a; L9 9"/></svg>'.encode(), "uses entities"),
    "undeclared entity": (b'<svg><path d="M0 0 &a; L9 9"/></svg>', "not an SVG file"),
    "binary": (bytes(range(256)) * 100, "not an SVG file"),
    "empty": (b"", "not an SVG file"),
    "text": (b"M 0 0 L 9 9", "not an SVG file"),
    "cut": (b'<svg><path d="M0 0 L9', "not an SVG file"),
    "another language": (b"<html><path d='M0 0 L9 9'/></html>", "begins with <html>"),
    "another namespace": (b"<svg xmlns='urn:x'><path d='M0 0 L9 9'/></svg>", "not an SVG file"),
    "unknown encoding": (b"<?xml version='1.0' encoding='klingon'?><svg/>", "not an SVG file"),
    "deep": (b"<svg>" + b"<g>" * 100_000 + LINE.encode() + b"</g>" * 100_000 + b"</svg>", None),
    "paths in paths": (b"<svg>" + b'<path d="M0 0L9 9">' * 50_000 + b"</path>" * 50_000 + b"</svg>", None),
    "long word": (b"<svg><style>" + b"a" * 1_000_000 + b"</style>" + LINE.encode() + b"</svg>", None),
    "long data": (b'<svg><path id="p" d="M' + b" 1" * 1_000_001 + b'"/></svg>', "cannot be read"),
    "long digits": (b'<svg><path id="p" d="M0 0 L' + b"1" * 1_000_000 + b'x"/></svg>', "cannot be read"),
    "many commands": (b'<svg><path id="p" d="M0 0' + b"h1v1" * 60_000 + b'"/></svg>', "more than 100,000 segments"),
}


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n == "deep" else n for n in HOSTILE])
def test_hostile_drawings_terminate(tmp_path, name):
    """What takes quadratic time would hang here: a hundred thousand of everything."""
    content, words = HOSTILE[name]
    (tmp_path / "h.svg").write_bytes(content)
    if words is None:
        assert len(read_points({"svg": "h.svg", "path": 1}, tmp_path).points) == DEFAULT_POINTS
    else:
        with pytest.raises(Unusable, match=words) as caught:
            read_points({"svg": "h.svg"}, tmp_path)
        assert caught.value.key in ("svg", "path")
        assert len(str(caught.value)) < 700


def test_doctype_that_only_points_elsewhere_is_usual(tmp_path):
    text = f'<?xml version="1.0" encoding="UTF-8" standalone="no"?>{OUTER}<svg xmlns="http://www.w3.org/2000/svg">{LINE}</svg>'
    for encoding in ("utf-8", "utf-8-sig"):
        (tmp_path / "a.svg").write_text(text, encoding)
        assert len(read_points({"svg": "a.svg"}, tmp_path).points) == DEFAULT_POINTS


# ---- whatever comes


JUNK = [
    *(
        None,
        True,
        -1,
        0,
        1e308,
        math.nan,
        math.inf,
        10**400,
        "",
        " ",
        "1 mm",
        "-5 mm",
        "1e300 km",
        "5 deg",
        "\0",
        "t",
        "((",
        "1/t",
    ),
    *("9" * 400, "2*pi", [], {}, [[]], ["1 mm"], ["1 mm", "2 mm"], [0, 1], {"csv": ".."}, {"x": "1 mm"}, "arc length", "c.csv"),
]


@pytest.mark.slow
def test_thousand_mutated_statements_never_break_the_reader(tmp_path):
    (tmp_path / "c.csv").write_text("x_mm,y_mm,crank_deg\n0,0,0\n1,1,10\n2,0,20\n")
    whole = [
        lambda: [dict(P, crank="1 deg"), {"x": "1 mm", "y": "2 mm", "crank": "2 deg", "weight": 2.0, "tolerance": "1 mm"}],
        lambda: [["1 mm", "2 mm"], ["3 mm", "4 mm"], ["5 mm", "2 mm"]],
        lambda: {"csv": "c.csv", "points": 2},
        lambda: svg(tmp_path, LINE, path="p", unit="mm", points=5),
        lambda: {"x": "20*cos(t)", "y": "t", "unit": "mm", "t": [0, 1], "points": 5, "spacing": "t"},
    ]
    rng, good = random.Random(5), 0
    for k in range(1000):
        raw = whole[k % len(whole)]()
        node = raw
        while isinstance(node, list | dict):
            keys = list(node) if isinstance(node, dict) else list(range(len(node)))
            if not keys:
                break
            key = rng.choice(keys)
            if isinstance(node[key], list | dict) and rng.random() < 0.7:
                node = node[key]
                continue
            if isinstance(node, dict) and rng.random() < 0.2:
                del node[key]
            elif isinstance(node[key], str) and node[key] and rng.random() < 0.5:
                text = list(node[key])
                text[rng.randrange(len(text))] = rng.choice(string.printable)
                node[key] = "".join(text)
            else:
                node[key] = rng.choice(JUNK)
            break
        try:
            expected = read_points(raw, tmp_path)
        except Unusable as error:
            assert error.remedy
            continue
        good += 1
        assert np.all(np.isfinite(expected.points))
        assert 1 <= len(expected.points) <= MAX_POINTS
        for column in (expected.crank, expected.angles, expected.weights, expected.tolerances):
            assert column is None or len(column) == len(expected.points)
    assert 100 < good < 900


def test_mutated_drawings_never_break_the_reader(tmp_path):
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="80mm" viewBox="0 0 80 60"><g transform="rotate(30, 5 6)">'
        f'<path d="{EVERY}" style="fill:none"/></g></svg>'
    ).encode()
    rng = random.Random(3)
    for _ in range(200):
        data = bytearray(text)
        for _ in range(rng.randint(1, 3)):
            at = rng.randrange(len(data))
            if rng.random() < 0.6:
                data[at] = rng.randrange(32, 127)
            else:
                del data[at : at + rng.randint(1, 20)]
        (tmp_path / "m.svg").write_bytes(bytes(data))
        try:
            expected = read_points({"svg": "m.svg", "points": 3}, tmp_path)
        except Unusable as error:
            assert error.remedy
            continue
        assert np.all(np.isfinite(expected.points))
