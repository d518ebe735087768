"""Options of the proof of a global optimum: useless and impossible ones are refused in one sentence."""

import pytest
from typer.testing import CliRunner

from optlink.cli.app import app
from optlink.tasks.results.certificate import share_text

REFUSED = {
    "a law without a proof": (
        ("crank-rocker", "--no-certify", "--gap", "0.1"),
        'crank-rocker.toml: --gap = "0.1": the option applies to a certificate of the global optimum only. Leave it out',
    ),
    "a path without a proof": (
        ("path-bean", "--time-limit", "2 s"),
        "the option applies to a certificate of the global optimum only. Add --certify, or leave it out",
    ),
    "processes without a proof": (
        ("balance-six-bar", "--workers", "2"),
        "only multistart searches and certificates use several processes. Leave it out",
    ),
    "an unknown engine": (("crank-rocker", "--engine", "cluster"), '--engine = "cluster": unknown engine'),
    "a machine": (
        ("shaper-design", "--gap", "0.1"),
        "the option applies to a certificate of the global optimum only. Leave it out",
    ),
    "a machine to certify": (("shaper-design", "--certify"), "no certificate of the global optimum for this kind of problem"),
    "free crank angles": (
        ("path-closed18-untimed", "--certify"),
        "--certify: no certificate of the global optimum: the crank angles at the points are unknowns too.",
    ),
    "a given design": (
        ("crank-rocker", "--design", "coupler=412 mm", "--design", "rocker=232 mm", "--certify"),
        "--certify: a given design is validated, not optimised. Leave it out",
    ),
    "a large gap": (("crank-rocker", "--gap", "2"), '--gap = "2": out of range. Give a share from 1e-12 to less than 1'),
    "no gap": (("crank-rocker", "--gap", "nan"), '--gap: "nan" is not a number'),
    "an unknown unit": (("crank-rocker", "--time-limit", "5 furlongs"), 'the unit "furlongs" is unknown. Use a unit of time'),
    "no time": (("crank-rocker", "--time-limit", "-1 s"), '--time-limit = "-1 s": out of range. Give a time above zero'),
}


@pytest.mark.parametrize("case", REFUSED)
def test_options_without_effect_or_sense_are_refused_in_a_sentence(case):
    arguments, words = REFUSED[case]
    done = CliRunner().invoke(app, ["solve", *arguments])
    assert done.exit_code == 2, done.output
    assert done.output.startswith("Error: ")
    assert done.output.count("\n") == 1
    assert words in done.output


def test_a_gap_that_is_no_number_is_refused():
    done = CliRunner().invoke(app, ["solve", "crank-rocker", "--gap", "abc"])
    assert done.exit_code == 2
    assert '"abc" is not a number' in done.output


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (1.0, "100 %"),
        (0.3, "30 %"),
        (0.305, "31 %"),
        (0.04321, "4.4 %"),
        (1e-6, "0.0001 %"),
        (9.99e-5, "0.01 %"),
        (2e-12, "0.0000000002 %"),
        (0.0, "rounding errors"),
    ],
)
def test_shares_are_rounded_up_with_all_their_zeros(share, words):
    assert share_text(share) == words
