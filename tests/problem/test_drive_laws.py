"""Laws of drives and cams as they stand in a problem file, and every sentence about a faulty one."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import casadi
import numpy as np
import pytest

from optlink.linkage.jet import Jet
from optlink.linkage.laws import SEGMENTS, MotionLaw
from optlink.problem.machine.drives import CamLaw, read_cam_law, read_drive_law
from optlink.problem.quantity import Unusable
from optlink.problem.targets.expression import parse, period_of, revolutions_of
from optlink.symbolic import symbols_in_numpy

DEG = math.radians(1.0)
HERE = Path(__file__).parent


def drive(raw: object, kind: str = "angle", **given: Any) -> MotionLaw:
    return read_drive_law(raw, given.pop("folder", HERE), kind, **given)


def sentence(function: Any, *arguments: Any, **given: Any) -> tuple[str, str, str, object]:
    with pytest.raises(Unusable) as caught:
        function(*arguments, **given)
    return caught.value.message, caught.value.remedy, caught.value.key, caught.value.value


# --- segments --------------------------------------------------------------------------------------------------------

LEVER = [
    {"time": "0.4 s", "to": "60 deg", "law": "modified sine"},
    {"time": "200 ms"},
    {"time": "0.6 s", "to": "15 deg", "law": "trapezoidal"},
]


def test_a_lever_goes_and_comes_back() -> None:
    law = drive(LEVER)
    assert law(np.array([0.0, 0.2, 0.4, 0.5, 0.9, 1.2, 1.4])) / DEG == pytest.approx([15.0, 37.5, 60.0, 60.0, 37.5, 15.0, 37.5])
    assert (law.repeats, law.advance, law.period) == (True, 0.0, pytest.approx(1.2))
    assert law.extremes(1).largest == pytest.approx(4.0 * math.pi / (4.0 + math.pi) * 45.0 * DEG / 0.4)
    assert law.jump(1)[0] == 0.0
    assert law.jump(2) == (pytest.approx(4.5 * 45.0 * DEG / 0.6**2), pytest.approx(0.6))


def test_a_motion_without_a_law_is_a_polynomial_of_fifth_degree() -> None:
    law = drive([{"time": "2 s", "to": "90 deg"}, {"time": "1 s", "to": "0 deg", "law": "harmonic"}])
    t = np.linspace(0.0, 2.0, 11)
    assert law(t) == pytest.approx(90.0 * DEG * SEGMENTS["3-4-5"](t / 2.0))


@pytest.mark.parametrize(
    ("ends", "start", "first", "advance", "repeats"),
    [
        (["360 deg"], None, 0.0, 360.0, True),
        (["-720 deg"], None, 0.0, -720.0, True),
        (["1080 deg"], None, 0.0, 1080.0, True),
        (["100 deg", "375 deg"], None, 15.0, 360.0, True),
        (["100 deg", "-15 deg"], None, -15.0, 0.0, True),
        (["100 deg", "375 deg"], 15.0, 15.0, 360.0, True),
        (["100 deg"], 15.0, 15.0, 85.0, False),
        (["60 deg", "15 deg"], 15.0, 15.0, 0.0, True),
    ],
)
def test_where_an_angle_begins_and_whether_it_repeats(
    ends: list[str], start: float | None, first: float, advance: float, *, repeats: bool
) -> None:
    law = drive([{"time": "1 s", "to": end} for end in ends], start=start if start is None else start * DEG)
    assert law(0.0) / DEG == pytest.approx(first, abs=1e-12)
    assert law.advance / DEG == pytest.approx(advance, abs=1e-12)
    assert law.repeats is repeats
    assert law(law.period * (1.0 + 1e-13)) / DEG == pytest.approx(first + advance, abs=1e-6)
    assert law.jump(0)[0] == 0.0


def test_a_cylinder_extends_once_or_comes_back() -> None:
    once = drive([{"time": "2 s", "to": "1400 mm"}], "length", start=0.9)
    assert once(np.array([-1.0, 0.0, 1.0, 2.0, 7.0])) == pytest.approx([0.9, 0.9, 1.15, 1.4, 1.4])
    assert not once.repeats
    back = drive([{"time": "2 s", "to": "1400 mm"}, {"time": "1 s", "to": "0.9 m", "law": "cycloidal"}], "length")
    assert back(np.array([0.0, 2.0, 2.5, 3.0, 5.0])) == pytest.approx([0.9, 1.4, 1.15, 0.9, 1.4])
    assert back.repeats
    slide = drive([{"time": "1 s", "to": "-20 mm"}, {"time": "1 s", "to": "20 mm"}], "coordinate")
    assert slide.extremes()[::2] == pytest.approx((-0.02, 0.02))


LIST = 'Write [{ time = "0.4 s", to = "45 deg", law = "3-4-5" }, ...]'
SEGMENT = 'Write { time = "0.4 s", to = "45 deg" }'
WHAT = "the law of a drive is a list of motions, an expression of the time t or a CSV file"


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        (7, (WHAT, LIST, "", 7)),
        ("modified sine", (WHAT, LIST, "", "modified sine")),
        ({"unit": "deg"}, (WHAT, LIST, "", {"unit": "deg"})),
        ({"csv": "a.csv", "expression": "t"}, ("the law is given twice", "Give expression or csv, not both", "csv", "a.csv")),
        ([], ("the law has no motion", 'Write [{ time = "0.4 s", to = "45 deg" }, ...]', "", [])),
        ([{"time": "1 s"}], ("the law has no motion", 'Write [{ time = "0.4 s", to = "45 deg" }, ...]', "", [{"time": "1 s"}])),
        (["60 deg"], ("expected a segment of the law", SEGMENT, "[0]", "60 deg")),
        ([{"to": "60 deg"}], ("the segment has no duration", 'Add time = "0.4 s"', "[0].time", None)),
        (
            [*LEVER, {"time": "0 s", "to": "9 deg"}],
            ("no motion has such a duration", "Give from 1e-06 to 1e+06 s, and check its unit", "[3].time", "0 s"),
        ),
        (
            [{"time": "1 s", "law": "harmonic"}],
            ("the motion has no end", 'Add to = "45 deg", or leave law out for a dwell', "[0].law", "harmonic"),
        ),
        (
            [{"time": "1 s", "to": "4 deg", "law": "dwell"}],
            ("a dwell has no motion", "Leave to out, or name another law", "[0].law", "dwell"),
        ),
        (
            [{"time": "1 s", "to": "15 deg"}],
            (
                "the law never moves: it stays at 15 deg",
                "End a motion at another value, or give start where the law begins",
                "",
                None,
            ),
        ),
    ],
)
def test_faulty_segments(raw: object, said: tuple[str, str, str, object]) -> None:
    assert sentence(drive, raw) == said


def test_faulty_names_and_units_of_segments() -> None:
    message, remedy, key, value = sentence(drive, [{"time": "1 s", "to": "4 deg", "law": "modified sinus"}])
    assert (message, key, value) == ("no such law of motion", "[0].law", "modified sinus")
    assert remedy.startswith('Did you mean "modified sine"?')
    assert sentence(drive, [{"time": "1 s", "to": "4 deg", "law": 5}])[2:] == ("[0].law", 5)
    message, remedy, key, value = sentence(drive, [LEVER[0], {"time": "1 s", "til": "4 deg"}])
    assert (message, key) == ("unknown key", "[1].til")
    assert sentence(drive, [{"time": "1 s", "to": "4 mm"}])[2:] == ("[0].to", "4 mm")
    assert sentence(drive, [{"time": "1 mm", "to": "4 deg"}])[2:] == ("[0].time", "1 mm")
    assert sentence(drive, [{"time": "1 s", "to": "-4 mm"}], "length")[::2] == ("a length must be positive", "[0].to")


# --- expressions -----------------------------------------------------------------------------------------------------


def test_an_expression_of_the_time() -> None:
    t = np.linspace(-1.3, 2.7, 41)
    for law in (drive("45*sin(2*pi*t)", unit="deg"), drive({"expression": "45*sin(2*pi*t)", "unit": "deg"})):
        assert (law.period, law.repeats, law.advance) == (1.0, True, 0.0)
        w, size = 2.0 * math.pi, 45.0 * DEG
        wave = [np.sin, np.cos, lambda x: -np.sin(x), lambda x: -np.cos(x), np.sin]
        for order in range(5):
            assert law.derivative(t, order) == pytest.approx(size * w**order * wave[order](w * t), rel=1e-9, abs=1e-11 * w**order)
            step = np.imag(law.derivative(t + 1e-30j, order)) / 1e-30 if order < 4 else 0.0
            assert order == 4 or step == pytest.approx(law.derivative(t, order + 1), rel=1e-9, abs=1e-8)
        extremes = law.extremes(2)
        assert extremes == pytest.approx((-size * w * w, 0.25, size * w * w, 0.75), rel=1e-12)
        assert [law.jump(order)[0] for order in range(4)] == [0.0] * 4


def test_jets_symbols_and_scaling_of_an_expression() -> None:
    law = drive({"expression": "20 + 10*sin(2*pi*t)^3 + exp(cos(4*pi*t))", "unit": "mm"}, "length")
    t = np.linspace(0.03, 2.2, 9)
    jet = law(Jet(t, 1.5, -2.0))
    assert jet.rate == pytest.approx(1.5 * law.derivative(t, 1))
    assert jet.acceleration == pytest.approx(-2.0 * law.derivative(t, 1) + 2.25 * law.derivative(t, 2))
    x, factor = casadi.SX.sym("x"), casadi.SX.sym("factor")
    with symbols_in_numpy():
        scaled = law.scaled(factor, 1.0)
        results = [scaled(x), *(scaled.derivative(x, order) for order in (1, 2, 3)), casadi.gradient(scaled(x), x)]
    function = casadi.Function("f", [x, factor], [casadi.vertcat(*results)])
    for row, order in zip(np.array(function.map(9)(t, 3.0)), (0, 1, 2, 3, 1), strict=True):
        assert row == pytest.approx((order == 0) + 3.0 * law.derivative(t, order), rel=1e-10, abs=1e-12)
    assert law.scaled(2.0, 5.0)(t) == pytest.approx(5.0 + 2.0 * law(t))
    assert law.scaled(2.0, 5.0).scaled(-1.0, 1.0)(t) == pytest.approx(-4.0 - 2.0 * law(t))


@pytest.mark.parametrize(
    ("text", "period", "advance"),
    [
        ("360*t", 1.0, 360.0),
        ("-90*t", 4.0, -360.0),
        ("360*t + 10*sin(6*pi*t)", 1.0, 360.0),
        ("120*t + 10*sin(2*pi*t)", 3.0, 360.0),
        ("sin(t) + cos(1.5*t)", 4.0 * math.pi, 0.0),
        ("10*sin(2*pi*t + 0.3*sin(4*pi*t))", 1.0, 0.0),
        ("abs(sin(pi*t))", 2.0, 0.0),
        ("5*tan(0.2*cos(t))", 2.0 * math.pi, 0.0),
    ],
)
def test_periods_of_expressions(text: str, period: float, advance: float) -> None:
    law = drive(text, unit="deg")
    assert law.period == pytest.approx(period, rel=1e-14)
    assert law.advance / DEG == pytest.approx(advance, abs=1e-12)
    t = np.linspace(0.0, period, 7)
    assert law(t + 2.0 * period) == pytest.approx(law(t) + 2.0 * advance * DEG, abs=1e-12)
    assert law.jump(0)[0] == 0.0


def test_period_of_an_expression_is_none_if_it_has_none() -> None:
    for text in ("t^2", "exp(-t)*sin(t)", "cos(t)*cos(1.04*t)", "sin(t) + sin(pi*t)", "sin(t^2)", "sin(1e-200*t) + sin(1e200*t)"):
        assert period_of(parse(text, ("t",)), "t") is None
    assert period_of(parse("3*t + 2", ("t",)), "t") == (0.0, 3.0)
    assert period_of(parse("3", ("t",)), "t") == (0.0, 0.0)
    assert revolutions_of(parse("sin(1e308*phi)", ("phi",))) is None


def test_a_given_period_or_duration() -> None:
    law = drive({"expression": "30*t^2*(1 - t)^2", "unit": "deg", "period": "1 s"})
    assert (law.repeats, law.advance, law.period) == (True, 0.0, 1.0)
    assert law(1.3) == pytest.approx(30.0 * DEG * 0.3**2 * 0.7**2)
    assert (law.jump(1)[0], law.jump(2)[0]) == (0.0, 0.0)
    assert law.jump(3)[0] == pytest.approx(720.0 * DEG)
    turn = drive({"expression": "360*t + 90*t*(1 - t)", "unit": "deg", "period": "1 s"})
    assert turn(2.5) == pytest.approx(2.5 * 2.0 * math.pi + 22.5 * DEG)
    assert turn.jump(1)[0] == pytest.approx(180.0 * DEG)
    once = drive({"expression": "8*t^3", "unit": "mm", "duration": "500 ms"}, "coordinate")
    assert once(np.array([-1.0, 0.25, 0.5, 9.0])) == pytest.approx([0.0, 0.125e-3, 1e-3, 1e-3])
    assert (once.repeats, once.advance) == (False, pytest.approx(1e-3))
    assert once.jump(1) == (pytest.approx(6e-3), 0.5)


def test_corners_of_an_expression_are_knots() -> None:
    law = drive({"expression": "30 + 20*abs(cos(pi*t))", "unit": "mm"}, "length")
    assert law.knots == pytest.approx((0.0, 0.5, 1.5, 2.0))
    assert law.jump(1)[0] == pytest.approx(0.04 * math.pi)
    assert (law.extremes().least, law.extremes().largest) == pytest.approx((0.03, 0.05))
    law = drive({"expression": "30 + 20*abs(sin(pi*t))", "unit": "mm"}, "length")  # with a corner at its ends
    assert law.knots == pytest.approx((0.0, 1.0, 2.0))
    assert law.jump(1) == (pytest.approx(0.04 * math.pi), 0.0)
    assert law.jump(2)[0] == 0.0
    smooth = drive({"expression": "30 + 20*abs(2 + cos(pi*t))", "unit": "mm"}, "length")
    assert smooth.knots == pytest.approx((0.0, 2.0))


ALONE = 'Write duration = "2 s" for a motion that ends there, or its period'


@pytest.mark.parametrize(
    ("raw", "kind", "said"),
    [
        (
            "45*sin(t)",
            "angle",
            ("an expression gives a plain number", 'Write { expression = "45*sin(t)", unit = "deg" }', "", "45*sin(t)"),
        ),
        ({"expression": "9*sin(t)"}, "length", ("an expression gives a plain number", 'Add its unit: unit = "mm"', "unit", None)),
        (
            {"expression": 4, "unit": "deg"},
            "angle",
            ("an expression is text", 'Write expression = "45*sin(2*pi*t)"', "expression", 4),
        ),
        (
            {"expression": "t/(2 - 2)", "unit": "deg"},
            "angle",
            (
                "it has no finite value",
                "Correct the division by zero, or the root or logarithm of a constant",
                "expression",
                "t/(2 - 2)",
            ),
        ),
        (
            {"expression": "sin(t)", "unit": "deg", "period": "1 s", "duration": "2 s"},
            "angle",
            ("a law has a period or a duration", "Give period for a motion that repeats, else duration", "duration", "2 s"),
        ),
        (
            {"expression": "3 + 4", "unit": "deg"},
            "angle",
            ("the law never moves", "Write an expression of the time t", "expression", "3 + 4"),
        ),
        (
            {"expression": "t - t", "unit": "deg", "period": "1 s"},
            "angle",
            (
                "the law never moves: it stays at 0 deg",
                "End a motion at another value, or give start where the law begins",
                "",
                None,
            ),
        ),
        (
            {"expression": "t^2", "unit": "deg"},
            "angle",
            ("the law has no period that its form shows", ALONE, "expression", "t^2"),
        ),
        ({"expression": "9*t", "unit": "mm"}, "length", ("the law grows without end", ALONE, "expression", "9*t")),
        (
            {"expression": "100*t + sin(2*pi*t)/pi + sqrt(2)*t", "unit": "deg"},
            "angle",
            (
                "the law turns by 101.414 deg in its period of 1 s, and so never returns",
                ALONE,
                "expression",
                "100*t + sin(2*pi*t)/pi + sqrt(2)*t",
            ),
        ),
        (
            {"expression": "sin(1e9*t)", "unit": "deg"},
            "angle",
            (
                "no motion takes 6.28319e-09 s",
                "Give from 1e-06 to 1e+06 s; in the expression t is in seconds",
                "expression",
                "sin(1e9*t)",
            ),
        ),
        (
            {"expression": "t^2", "unit": "deg", "duration": "0 s"},
            "angle",
            ("no motion takes 0 s", "Give from 1e-06 to 1e+06 s; in the expression t is in seconds", "duration", "0 s"),
        ),
        (
            {"expression": "5/cos(2*pi*t)", "unit": "deg"},
            "angle",
            ("the law divides by zero between 0 and 1 s", "Change the law", "expression", "5/cos(2*pi*t)"),
        ),
        (
            {"expression": "sqrt(t)", "unit": "deg", "duration": "2 s"},
            "angle",
            (
                "the velocity or the acceleration is not finite everywhere between 0 and 2 s",
                "Change the law: a root, for example, begins with infinite speed",
                "expression",
                "sqrt(t)",
            ),
        ),
        (
            {"expression": "20 + t^2", "unit": "mm", "period": "1 s"},
            "length",
            (
                "the law does not repeat after 1 s: it ends 1 mm from where it begins",
                'Correct the period, or write duration = "1 s" for a single motion',
                "period",
                "1 s",
            ),
        ),
        (
            {"expression": "5*sin(2*pi*t)", "unit": "mm"},
            "length",
            ("a length is positive, but the law leads to -5 mm at 0.75 s", "Change the law", "", None),
        ),
        (
            {"expression": "1e9*sin(2*pi*t)", "unit": "deg"},
            "angle",
            ("the law leads to 1e+09 deg at 0.25 s, which is too far", "Check its unit", "", None),
        ),
    ],
)
def test_faulty_expressions(raw: object, kind: str, said: tuple[str, str, str, object]) -> None:
    assert sentence(drive, raw, kind) == said


def test_faulty_text_and_unit_of_an_expression() -> None:
    message, _, key, value = sentence(drive, {"expression": "45*sin(phi)", "unit": "deg"})
    assert message == '"phi" is unknown (column 8)'
    assert (key, value) == ("expression", "45*sin(phi)")
    assert sentence(drive, "45*sin(phi)", unit="deg")[2:] == ("", "45*sin(phi)")
    assert sentence(drive, "servo.csv", unit="deg")[1] == 'Write law = { csv = "servo.csv" }'
    assert sentence(drive, {"expression": "45*sin(t)", "unit": "mm"})[2:] == ("unit", "mm")
    huge = {"expression": "1.7e308*(2*t - 1)", "unit": "rad", "period": "1 s"}
    assert sentence(drive, "1e306*t + sin(0.1*t)", unit="rad")[0].startswith("the law turns by ")
    assert sentence(drive, huge)[0].startswith("the law leads to ")
    assert sentence(drive, {"expression": "t", "unit": "deg", "repeat": True})[::2] == ("unknown key", "repeat")
    said = sentence(drive, "t^2", unit="rad")
    assert said[1] == 'Write { expression = "t^2", unit = "rad", duration = "2 s" } for a motion that ends there, or its period'


# --- samples ---------------------------------------------------------------------------------------------------------


def written(folder: Path, titles: str, rows: np.ndarray) -> dict[str, Any]:
    lines = [titles, *(",".join(repr(float(value)) for value in row) for row in rows)]
    (folder / "servo.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return {"csv": "servo.csv"}


def test_samples_of_a_closed_motion(tmp_path: Path) -> None:
    t = np.linspace(0.0, 2.0, 101)
    raw = written(tmp_path, "time_s,angle_deg", np.stack([t, 30.0 + 20.0 * np.sin(math.pi * t)], axis=1))
    law = drive(raw, folder=tmp_path)
    at = np.linspace(-1.0, 3.3, 57)
    assert law(at) / DEG == pytest.approx(30.0 + 20.0 * np.sin(math.pi * at), abs=1e-5)
    assert law.derivative(at, 1) / DEG == pytest.approx(20.0 * math.pi * np.cos(math.pi * at), abs=1e-3)
    assert (law.repeats, law.advance) == (True, 0.0)
    assert [law.jump(order)[0] for order in range(3)] == [0.0] * 3


def test_samples_of_a_crank_that_turns_on_and_of_a_cylinder(tmp_path: Path) -> None:
    t = np.linspace(0.0, 1.0, 61)
    raw = written(tmp_path, "time_ms,angle_rad", np.stack([1e3 * t, 2.0 * math.pi * t + 0.1 * np.sin(2.0 * math.pi * t)], axis=1))
    law = drive(raw, folder=tmp_path)
    assert (law.repeats, law.advance) == (True, 2.0 * math.pi)
    assert law(4.25) == pytest.approx(8.5 * math.pi + 0.1, abs=1e-5)
    raw = written(tmp_path, "time_s,length_mm", np.stack([t, 900.0 + 500.0 * t**3], axis=1))
    law = drive(raw, "length", folder=tmp_path)
    assert (law.repeats, law.advance) == (False, pytest.approx(0.5))
    assert law(np.array([0.35, 1.0, 2.0])) == pytest.approx([0.9 + 0.5 * 0.35**3, 1.4, 1.4], abs=1e-12)
    raw = written(tmp_path, "time_s,slide_mm", np.stack([t, 50.0 * np.cos(2.0 * math.pi * t)], axis=1))
    assert drive(raw, "coordinate", folder=tmp_path).repeats


def test_faulty_samples(tmp_path: Path) -> None:
    raw = written(tmp_path, "time_s,length_mm", np.array([[0.0, 3.0], [1.0, 4.0]]))
    message, remedy, key, _ = sentence(drive, raw, folder=tmp_path)
    assert message == "servo.csv has no column angle_deg or angle_rad"
    assert remedy == "Name the columns in the first row, one of them angle_deg"
    assert key == "csv"
    raw = written(tmp_path, "time_s,angle_deg", np.array([[0.0, 3.0], [2.0, 4.0], [1.0, 5.0]]))
    assert (
        sentence(drive, raw, folder=tmp_path)[0] == "row 4 of servo.csv has time_s = 1 after 2, which must rise from row to row"
    )
    raw = written(tmp_path, "time_s,angle_deg", np.array([[0.0, 3.0], [2.0, 3.0], [3.0, 3.0]]))
    assert sentence(drive, raw, folder=tmp_path)[0] == "the law never moves: it stays at 3 deg"
    raw = written(tmp_path, "time_s,length_mm", np.array([[0.0, 3.0], [2.0, -3.0], [3.0, 3.0]]))
    assert sentence(drive, raw, "length", folder=tmp_path)[0].startswith("a length is positive, but the law leads to -3")
    assert sentence(drive, {"csv": "none.csv"}, folder=tmp_path)[0] == "cannot read the file: no such file"
    assert sentence(drive, {"csv": "servo.csv", "unit": "mm"}, folder=tmp_path)[::2] == ("unknown key", "unit")


# --- cams ------------------------------------------------------------------------------------------------------------

VALVE = [
    {"to": "120 deg", "rise": "20 mm", "law": "modified sine"},
    {"to": "180 deg"},
    {"to": "300 deg", "fall": "20 mm"},
    {"to": "360 deg"},
]


def test_the_law_of_a_cam() -> None:
    cam = read_cam_law(VALVE)
    law = cam.law()
    phi = np.radians([0.0, 60.0, 120.0, 150.0, 240.0, 300.0, 330.0, 420.0, -60.0])
    assert law(phi) == pytest.approx(np.array([0.0, 10.0, 20.0, 20.0, 10.0, 0.0, 0.0, 10.0, 0.0]) * 1e-3, abs=1e-15)
    assert (law.begin, law.end, law.advance, law.repeats) == (0.0, 2.0 * math.pi, 0.0, True)
    assert [law.jump(order)[0] for order in range(3)] == [0.0] * 3
    assert law.extremes(2).largest == pytest.approx(0.02 * 10.0 / math.sqrt(3.0) / math.radians(120.0) ** 2)
    assert [segment.law for segment in cam.segments] == ["modified sine", "dwell", "3-4-5", "dwell"]
    swing = read_cam_law([{"to": "90 deg", "rise": "5 deg"}, {"to": "360 deg", "fall": "5 deg"}], "angle")
    assert swing.law()(math.pi / 2.0) == pytest.approx(5.0 * DEG)


def test_the_ways_of_a_cam_may_be_symbols() -> None:
    cam = read_cam_law([*VALVE[:1], {"to": "180 deg", "rise": "5 mm"}, {"to": "360 deg", "fall": "25 mm"}])
    assert [way.value for way in cam.ways] == pytest.approx([0.02, 0.005, 0.025])
    first, second, phi = (casadi.SX.sym(name) for name in ("first", "second", "phi"))
    with symbols_in_numpy():
        value = cam.law([first, second, first + second])(phi)
    function = casadi.Function("f", [phi, first, second], [value, casadi.gradient(value, first)])
    at = np.linspace(0.1, 12.0, 21)
    found, slope = (np.array(row).ravel() for row in function.map(len(at))(at, 0.02, 0.005))
    assert found == pytest.approx(cam.law()(at), abs=1e-16)
    assert slope == pytest.approx(cam.law([1.0, 0.0, 1.0])(at), abs=1e-13)


def cams(*segments: object) -> CamLaw:
    return read_cam_law(list(segments))


CAM = 'Write [{ to = "120 deg", rise = "100 mm" }, { to = "180 deg" }, { to = "360 deg", fall = "100 mm" }]'


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        ("45*sin(t)", ("the law of a cam is a list of its segments", CAM, "", "45*sin(t)")),
        ([], ("the law of a cam is a list of its segments", CAM, "", [])),
        ([VALVE[0], 3], ("expected a segment of the law", 'Write { to = "120 deg", rise = "100 mm" }', "[1]", 3)),
        ([{"rise": "3 mm"}], ("the segment has no end", 'Add the cam angle where it ends: to = "120 deg"', "[0].to", None)),
        (
            [VALVE[0], {"to": "100 deg"}],
            (
                "the cam angles must rise, and this one follows 120 deg",
                "Sort the segments; to is the cam angle at the end of a segment",
                "[1].to",
                "100 deg",
            ),
        ),
        (
            [{"to": "90 deg", "rise": "2 mm", "fall": "3 mm"}],
            ("a segment rises or falls", "Give rise or fall, or two segments", "[0].fall", "3 mm"),
        ),
        (
            [{"to": "90 deg", "law": "harmonic"}],
            ("the motion has no end", 'Add rise = "100 mm", or leave law out for a dwell', "[0].law", "harmonic"),
        ),
        (
            [{"to": "90 deg", "rise": "2 mm", "law": "dwell"}],
            ("a dwell has no motion", "Leave rise out, or name another law", "[0].law", "dwell"),
        ),
        (
            VALVE[:3],
            (
                "the law ends at a cam angle of 300 deg, not after one revolution",
                'End its last segment at to = "360 deg"',
                "[2].to",
                "300 deg",
            ),
        ),
        ([{"to": "360 deg"}], ("the law never moves", CAM, "", [{"to": "360 deg"}])),
        (
            [VALVE[0], {"to": "360 deg", "fall": "19 mm"}],
            (
                "the follower does not return: it rises by 20 mm and falls by 19 mm",
                "Make the sums of the rises and of the falls equal",
                "",
                [VALVE[0], {"to": "360 deg", "fall": "19 mm"}],
            ),
        ),
    ],
)
def test_faulty_cams(raw: object, said: tuple[str, str, str, object]) -> None:
    assert sentence(read_cam_law, raw) == said


def test_faulty_ways_and_names_of_a_cam() -> None:
    assert sentence(cams, {"to": "90 deg", "rise": "-2 mm"})[::2] == ("a length must be positive", "[0].rise")
    assert sentence(cams, {"to": "90 deg", "rise": "2 deg"})[2:] == ("[0].rise", "2 deg")
    assert sentence(read_cam_law, [{"to": "90 deg", "fall": "-2 deg"}], "angle") == (
        "a rise or a fall is positive",
        "Write a fall in place of a negative rise; leave both out for a dwell",
        "[0].fall",
        "-2 deg",
    )
    assert sentence(cams, {"to": "90 deg", "rise": "2 mm", "law": "sine"})[::2] == ("no such law of motion", "[0].law")
    assert sentence(cams, {"to": "90 deg", "rice": "2 mm"})[::2] == ("unknown key", "[0].rice")
