"""Screens of any width: no line is too long, no word and no figure is cut; plain text where a terminal wants it."""

from __future__ import annotations

import io
from functools import cache

import pytest

import optlink
from optlink.presentation import terminal
from optlink.presentation.registry import table_of
from optlink.presentation.table_spec import Summary, TableSpec, table
from optlink.presentation.views import problem_tables
from optlink.problem.file import load
from optlink.studies import pareto
from optlink.units import percent
from tests.solved import solution


def printed(shown: Summary | TableSpec, width: int, monkeypatch) -> str:
    monkeypatch.setenv("COLUMNS", str(width))
    console = terminal.console()
    with console.capture() as caught:
        console.print(terminal.rendered(shown))
    return caught.get()


@cache
def screen(name: str) -> Summary | TableSpec:
    kind, _, problem = name.partition(" ")
    if kind == "show":
        return problem_tables.problem(load(problem))
    if kind == "analyze":
        return table_of("analysis")(optlink.analyze(load(problem)))
    result = solution(problem)
    return table_of(result.kind)(result)


SCREENS = ("show shaper-design", "analyze six-bar", "solve crank-rocker")
LONG = ("solve motion-3-poses", "solve shaper-design", "solve balance-four-bar", "solve function-sin")


def lost(wide: str, narrow: str) -> set[str]:
    """Words of a wide screen that a narrow one does not show; heads of columns may be left out where their cells are empty."""
    heads = {"use", "name", "body", "kind", "parameter"}
    return {word for word in wide.split() if word not in narrow and not set(word) <= set("─")} - heads


@pytest.mark.parametrize("name", [*SCREENS, *(pytest.param(name, marks=pytest.mark.slow) for name in LONG)])
def test_tables_keep_every_word_at_any_width(name, monkeypatch):
    wide = printed(screen(name), 200, monkeypatch)
    for width in (120, 80, 60, 40):
        shown = printed(screen(name), width, monkeypatch)
        assert max(map(len, shown.split("\n"))) <= width
        assert "…" not in shown
        assert lost(wide, shown) == set(), width


def test_a_cut_word_is_detected():
    assert lost("peak torque 1015.4", "peak torq\nue 10…") == {"torque", "1015.4"}


def test_a_row_that_does_not_fit_is_written_as_lines(monkeypatch):
    rows = [("ok", "least transmission angle", "45.0", "deg", ">= 40"), ("", "none", "", "", "")]
    spec = table("Checks", ["", "check", ">value", "", "limit"], rows, notes=["a note"])
    assert "value" in printed(spec, 60, monkeypatch).split("\n")[2]
    lines = [line.rstrip() for line in printed(spec, 30, monkeypatch).split("\n")]
    assert lines == [
        "Checks",
        "ok  least transmission",
        "    angle",
        "    value 45.0 deg; limit >=",
        "    40",
        "none",
        "a note",
        "",
    ]


@pytest.mark.parametrize("variable", ["NO_COLOR", "TERM"])
def test_plain_text_on_request(variable, monkeypatch):
    """Neither colours nor other codes; the width is that of COLUMNS."""
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal
    monkeypatch.setenv("TERM", "xterm")
    assert "\x1b[" in printed(screen("show shaper-design"), 80, monkeypatch)
    monkeypatch.setenv(variable, "dumb")
    shown = printed(screen("show shaper-design"), 60, monkeypatch)
    assert "\x1b[" not in shown
    assert max(map(len, shown.split("\n"))) <= 60


def test_text_for_a_file_is_plain(monkeypatch):
    monkeypatch.setattr("sys.stdout", io.StringIO())
    terminal.show(table("Title", ["name", ">value"], [("a", "1")]))
    import sys

    assert "\x1b" not in sys.stdout.getvalue()


def test_row_units_follow_the_name_if_the_last_column_has_a_unit(monkeypatch):
    rows = [("slider: velocity", "-2.325257", "80.2205", "2.571953", "345.4036", "m/s")]
    spec = table("Extremes", ["", ">least", ">at [deg]", ">largest", ">at [deg]", ""], rows)
    lines = [line.strip() for line in printed(spec, 45, monkeypatch).splitlines()]
    assert "slider: velocity [m/s]" in lines
    assert "345.4036 m/s" not in " ".join(lines)
    narrow = table(
        "Strokes", ["", ">from", ">span", "", ">ratio"], [("slider slides", "417.2626464", "373.9044949", "mm", "1.10924")]
    )
    assert "span 373.9044949 mm; ratio 1.10924" in " ".join(printed(narrow, 34, monkeypatch).split())


def test_a_figure_and_its_percent_sign_stay_on_one_line(monkeypatch):
    spec = table(
        "Change", ["quantity", ">change", "limit"], [("peak torque of the drive", "-20.93 %", "at most 30 N*m over the cycle")]
    )
    shown = printed(spec, 29, monkeypatch)
    assert "-20.93 %" in shown
    assert max(map(len, shown.split("\n"))) <= 29


@pytest.mark.parametrize("width", [80, 20])
def test_torques_have_one_unit(width, monkeypatch):
    spec = table("Torques", ["quantity", ">largest\n[N m]", ""], [("peak torque of the drive", "30.25", "N*m")])
    shown = printed(spec, width, monkeypatch)
    assert shown.count("N·m") == 2
    assert "N m" not in shown
    assert "N*m" not in shown


@pytest.mark.slow
def test_changes_along_a_front_are_named_on_a_narrow_terminal(monkeypatch):
    front = pareto(optlink.load("crank-rocker"), "error, limits.transmission_angle.max", points=3)
    shown = " ".join(printed(table_of("pareto")(front), 60, monkeypatch).split())
    value, change = front.points[0].values[0], percent(front.points[0].values[0] / front.reference[0] - 1.0, 2, signed=True)
    assert f"error [rad^2] {value:.6g}; change {change};" in shown
