"""The short text that `solve` prints: what it has, what it leaves to --details, and failed checks, which it always shows.

`tests/test_smoke.py` checks its length over everything that ships.
"""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.presentation.registry import table_of
from optlink.presentation.table_spec import Paragraph, table
from optlink.presentation.views import search_tables
from tests.presentation.test_function_tables import words

PUBLISHED = ("--design", "coupler=412.26 mm", "--design", "rocker=232.2417 mm")


def run(*arguments: str):
    return CliRunner().invoke(app, list(arguments), env={"COLUMNS": "80"})


@pytest.mark.slow
def test_solve_prints_the_verdict_the_design_its_limits_and_the_proof():
    text = run("solve", "crank-rocker").stdout
    assert text.count("\n") <= search_tables.LINES
    for line in (
        "optimal, valid, fair fit: rms error is 3 % of the output range",
        "objective: sum of squares 0.00759237 rad^2 (error: rms 0.9115, largest 2.29 \ndeg); least transmission angle 45.00 deg",
        "globally optimal within the bounds: no design is better by more than 0.0001 %",
        "coupler   412.865  mm   free, 100 ... 900",
        "largest transmission angle  <= 135 deg  0.0001465 rad^2 per deg (1.93 %)",
        "Validation: 19 of 19 checks passed; --details shows the rest",
    ):
        assert line in text
    for detail in ("KKT residual", "Working and return strokes", "lower bound", "iterations"):
        assert detail not in text
        assert detail in run("solve", "crank-rocker", "--details").stdout


@pytest.mark.slow
def test_details_are_the_whole_summary_and_the_json_does_not_depend_on_them():
    result = optlink.solve(optlink.load("crank-rocker"))
    full = words(table_of("design")(result))
    done = CliRunner().invoke(app, ["solve", "crank-rocker", "--details"], env={"COLUMNS": "300"})
    plain = [" ".join(word for word in text.split() if word[0] not in "─[") for text in (full, done.stdout)]
    assert len(plain[0]) > 2000
    assert plain[0].partition(" time ")[0] == plain[1].partition(" time ")[0]
    short, long = (json.loads(run("solve", "crank-rocker", "--json", *option).stdout) for option in ((), ("--details",)))
    assert {**short, "seconds": {}, "crc32": ""} == {**long, "seconds": {}, "crc32": ""}
    assert len(short["validation"]) == 19


@pytest.mark.parametrize("command", ["solve", "validate"])
def test_failed_checks_are_always_shown(command):
    done = run(command, "crank-rocker", *PUBLISHED)
    assert done.exit_code == 1
    assert "FAIL   largest transmission angle" in done.stdout
    assert "Validation: 15 of 16 checks passed" in done.stdout
    assert done.stdout.count("FAIL") == 1
    assert ("4 dimensions within bounds" in done.stdout) == (command == "validate")


def test_all_conflicting_limits_are_shown():
    changes = {"mechanism.crank": "950 mm"}
    result = optlink.solve(optlink.load("crank-rocker", changes))
    assert len(result.conflict) + len(result.together) > search_tables.MAX_LIMITS
    shown = words(table_of("design")(result).short)
    for limit in (*result.conflict, *result.together):
        assert limit.name in shown
    assert "FAIL" not in shown  # failed checks follow from the conflict
    assert words(table_of("design")(result)).count("FAIL") == sum(not check.passed for check in result.validation.checks)


def test_only_the_first_reason_of_a_poor_fit_and_the_first_limits_are_shown():
    shown = words(Paragraph(*search_tables.verdict_lines(["poor fit", "Cause 0.", "Cause 1.", "Cause 2."])))
    assert shown == "poor fit Cause 0. 2 more: --details"
    assert search_tables.verdict_lines(["poor fit", "Cause 0."]) == ["poor fit", "Cause 0."]

    limits = table("Limits", "<<", [(f"limit {k}", "<= 1") for k in range(9)])
    shown = words(search_tables.first_rows(limits))
    assert "limit 2" in shown
    assert "limit 3" not in shown
    assert "and 6 more: --details" in shown
    few = replace(limits, rows=limits.rows[: search_tables.MAX_LIMITS])
    assert search_tables.first_rows(few) is few


def test_a_design_with_many_dimensions_is_written_as_text():
    rows = [(f"link{k}", f"{k}.5", "mm", "free") for k in range(12)]
    shown = search_tables.dimensions(table("Design", "<><<", rows))
    assert isinstance(shown, Paragraph)
    assert "link0 0.5 mm, link1 1.5 mm" in words(shown)
    few = table("Design", "<><<", rows[:8])
    assert search_tables.dimensions(few) is few


@pytest.mark.slow
@pytest.mark.parametrize("name", ["path-arc5", "law-slider-crank", "transmission-optimal"])
def test_a_path_problem_says_how_sure_its_optimum_is(name: str) -> None:
    text = run("solve", name, "--starts", "60").stdout
    assert text.count("\n") <= search_tables.LINES
    proven = "globally optimal within the bounds" in text
    assert name == "transmission-optimal" or not proven
    assert proven != ("starts reached the best value; chance that a better optimum" in text)
