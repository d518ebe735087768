"""Assembly modes that a problem leaves open: every kind of design problem searches them all and names the best one."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from tests.tiers import mostly_slow

FOUR_BAR = {
    "type": "four-bar",
    "frame": "100 mm",
    "crank": "30 mm",
    "coupler": {"bounds": ["60 mm", "140 mm"]},
    "rocker": {"bounds": ["60 mm", "140 mm"]},
}
LAWS = {
    "rising": {"kind": "function", "law": "psi0 + 0.3*(phi - phi0)", "span": "80 deg", "from": "60 deg"},
    "falling": {"kind": "function", "law": "psi0 - 0.3*(phi - phi0)", "span": "80 deg", "from": "60 deg"},
    "dwell": {"kind": "function", "law": {"phi": ["0 deg", "10 deg"], "psi": ["0 deg", "0 deg"]}},
    "two rows": {"kind": "function", "law": {"phi": ["0 deg", "70 deg"], "psi": ["0 deg", "-25 deg"]}},
}


def modes(mechanism: dict[str, object], rest: dict[str, object], joint: str = "") -> dict[str, optlink.ProblemFile]:
    """The problem with either mode, and with each of both."""
    names = ("either", "forward", "backward") if joint else ("either", "left", "right")
    raw = {name: {**mechanism, "assembly": {joint: name} if joint else name} for name in names}
    return {name: optlink.read({"title": "Modes", "mechanism": raw[name], **rest}) for name in names}


@pytest.mark.parametrize("name", mostly_slow(LAWS, "rising"))
def test_a_law_takes_the_better_mode(name: str) -> None:
    either, *others = (optlink.solve(file) for file in modes(FOUR_BAR, {"requirement": LAWS[name]}).values())
    best = min(others, key=lambda result: result.objective)
    assert either.valid
    assert either.objective == pytest.approx(best.objective, rel=1e-9, abs=1e-18)
    assert either.assembly == best.assembly or others[0].objective == pytest.approx(others[1].objective, rel=1e-9)
    assert {optimum.assembly for optimum in either.optima} == {"left", "right"}


def slider_crank(**sections: object) -> dict[str, optlink.ProblemFile]:
    """An offset slider-crank, whose slide runs to one side of the crank or to the other."""
    mechanism = {
        "type": "dyads",
        "ground": {"A": ["0 mm", "0 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": {"bounds": ["20 mm", "60 mm"]}},
            "rod": {"joints": ["B", "C"], "length": {"bounds": ["100 mm", "200 mm"]}},
            "ram": {"joints": ["C"]},
        },
        "guides": {"G": {"slider": "ram", "through": "A", "direction": "0 deg", "offset": "20 mm"}},
    }
    return modes(mechanism, sections, "C")


@pytest.mark.slow
def test_a_law_of_dyads_takes_the_better_mode() -> None:
    law = {"slide": "s0 + 30*sin(phi)", "unit": "mm"}
    files = slider_crank(requirement={"kind": "function", "output": "G", "law": law, "span": "120 deg", "start": "30 deg"})
    either, *others = (optlink.solve(file, starts=60) for file in files.values())
    best = min(others, key=lambda result: result.best.objective)
    assert either.best.objective <= best.best.objective * (1.0 + 1e-6)
    assert either.best.assembly == best.best.assembly


@pytest.mark.slow
def test_a_stroke_names_the_mode_that_it_takes() -> None:
    """The end of the forward stroke is nearer in one mode: only there is the limit met."""
    end = {"quantity": "end", "of": "ram", "stroke": "forward", "max": "-50 mm"}
    files = slider_crank(requirement={"kind": "stroke", "output": "ram", "stroke": "80 mm"}, limits={"reach": end})
    either, forward, backward = (optlink.solve(file, starts=4) for file in files.values())
    assert not forward.valid
    assert backward.valid
    assert either.valid
    assert either.objective == pytest.approx(backward.objective, rel=1e-9)
    assert either.notes[0] == "assembly mode: C backward, the best of those left open"
    assert either.definite.raw["mechanism"]["assembly"] == {"C": "backward"}
    assert optlink.validate(files["either"], either.design).objective == pytest.approx(backward.objective, rel=1e-9)


@pytest.mark.slow
def test_a_cycle_takes_the_better_mode() -> None:
    """Until now the first mode was taken without a word."""
    goal = {"quantity": "end", "of": "ram", "stroke": "forward"}
    values = {name: optlink.solve(file, starts=2) for name, file in slider_crank(objective=goal).items()}
    assert values["forward"].objective > 0.0 > values["backward"].objective
    assert values["either"].objective == pytest.approx(values["backward"].objective, rel=1e-9)
    assert "C backward" in values["either"].notes[0]


@pytest.mark.slow
def test_a_saved_result_of_either_mode_is_that_of_its_problem(tmp_path) -> None:
    given = ["stroke-crank-rocker", "--set", "mechanism.assembly=either"]
    run = CliRunner().invoke(app, ["solve", *given, "--starts", "2", "--out", str(tmp_path / "run")])
    assert run.exit_code == 0
    assert "assembly mode: " in run.stdout
    again = CliRunner().invoke(app, ["validate", *given, "--design", str(tmp_path / "run" / "result.json")])
    assert (again.exit_code, again.stderr) == (0, "")
    swept = CliRunner().invoke(app, ["study", "sweep", *given, "--vary", "mechanism.frame=95..100 mm:2", "--json"])
    assert swept.exit_code == 0
