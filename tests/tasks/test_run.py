"""One `solve` and one `validate` for every kind of design problem."""

from __future__ import annotations

import pytest

import optlink
from optlink.errors import InputError, Status
from tests.solved import loaded, solution
from tests.tiers import mostly_slow

QUESTIONS = {name: loaded(name) for name in optlink.shipped()}
SOLVED = {name: problem for name, problem in QUESTIONS.items() if problem.task != "analysis"}
LONG = {"function-exp", "function-log10", "path-stephenson-dwell", "path-watt-leg", "press-toggle", "crank-rocker-robust"}


MEMBERS = {name for name in vars(optlink.DesignResult) if not name.startswith("_")}


@pytest.mark.parametrize("name", mostly_slow(["crank-rocker", "path-arc5", "stroke-crank-rocker"], "crank-rocker"))
def test_the_results_of_all_kinds_have_the_same_members(name: str) -> None:
    result = solution(name)
    assert {"valid", "limits", "with_checks"} <= MEMBERS <= set(dir(result))
    assert len(result.limits) > 3
    assert result.limits == result.solution.limits


def test_balancing_is_solved_and_has_no_starting_points() -> None:
    result = solution("balance-four-bar")
    assert result.valid
    assert result.status is Status.OPTIMAL
    assert result.message.startswith("globally optimal")
    assert result.objective == optlink.balance(SOLVED["balance-four-bar"]).objective
    assert {name.partition(".")[0] for name in result.design} <= set(SOLVED["balance-four-bar"].model.linkage.bodies)
    with pytest.raises(InputError, match="convex programme"):
        optlink.solve(SOLVED["balance-four-bar"], starts=3)
    with pytest.raises(InputError, match="optlink balance"):
        optlink.validate(SOLVED["balance-four-bar"], {})


@pytest.mark.parametrize(
    ("name", "design", "message"),
    [
        ("crank-rocker", {"coupler": 0.4, "rocker": 0.3, "phi": 1.0}, '"phi": unknown quantity.*"phi0"'),
        ("crank-rocker", {"coupler": 0.4}, "the design lacks rocker"),
        ("path-arc5", {}, "the design lacks crank, coupler"),
        ("path-arc5", {"phi0": 1.0}, '"phi0": unknown quantity'),
        ("shaper-design", {"C.y": -0.2}, "the design lacks C.x"),
        ("shaper-design", [0.1, 0.2], "not a mapping of names to values.*result.design"),
    ],
)
def test_a_design_with_unknown_or_missing_names_is_refused(name: str, design: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        optlink.validate(SOLVED[name], design)  # type: ignore[arg-type]


def test_another_value_of_a_fixed_dimension_is_a_failed_check() -> None:
    file = SOLVED["shaper-design"]
    initial = {name: quantity.value for name, quantity in file.model.quantities.items()}
    failed = [
        {check.name for check in optlink.validate(file, design).validation.checks if not check.passed}
        for design in (initial, initial | {"A.x": 0.01})
    ]
    assert "all other dimensions as given" not in failed[0]
    assert "A.x within its bounds" in failed[1]


@pytest.mark.parametrize(
    "use",
    [
        optlink.solve,
        optlink.analyze,
        optlink.simulate,
        optlink.balance,
        optlink.control.simulate_clearance,
        lambda problem: optlink.validate(problem, {}),
        lambda problem: optlink.analyze_batch(problem, {"crank": [1.0]}),
    ],
)
def test_the_name_of_no_problem_is_refused_by_every_function(use) -> None:
    with pytest.raises(InputError, match=r'^problem = "six-ber": no such problem\. Did you mean "six-bar"'):
        use("six-ber")


@pytest.mark.parametrize("use", [optlink.analyze, optlink.simulate])
def test_a_machine_refuses_unknown_names_of_a_design(use) -> None:
    with pytest.raises(InputError, match=r'"crank": unknown quantity of the design\. Did you mean "crank\.length"'):
        use(QUESTIONS["six-bar"], design={"crank": 0.1})


@pytest.mark.slow
def test_progress_is_a_share_that_rises_to_one() -> None:
    for name, options in {
        "crank-rocker": {"starts": 4, "backend": "both"},
        "path-arc5": {"starts": 60},
        "shaper-design": {"starts": 2},
    }.items():
        seen: list[float] = []
        optlink.solve(SOLVED[name], progress=seen.append, **options)
        assert seen == sorted(seen), name
        assert 0.0 < seen[0] <= seen[-1] == pytest.approx(1.0), name


@pytest.mark.slow
def test_results_have_a_one_line_summary() -> None:
    """Whatever a result holds, a prompt shows its problem, status and objective."""
    results = [solution(name) for name in ("crank-rocker", "path-arc5", "shaper-design", "balance-four-bar")]
    results += [optlink.analyze(QUESTIONS["shaper"]), QUESTIONS["shaper"], results[0].solution, results[1].best]
    results += [
        results[0].validation,
        optlink.simulate(QUESTIONS["slider-crank"], rows=10),
        results[4].machine,
        results[4].machine.mechanism,
    ]
    results += [results[4].machine.moving([0.0, 1.0]).motion]
    for result in results:
        assert len(repr(result)) < 120
        assert "\n" not in repr(result)
    assert (
        repr(results[0])
        == "<SynthesisResult 'crank-rocker': optimal, valid, objective 0.00759237, globally optimal within 0.0001 %>"
    )
    for result in results[1], optlink.validate("crank-rocker", {"coupler": 0.4, "rocker": 0.23}):
        words = repr(result).partition(": ")[2].split(", ")[:2]
        assert any(line.startswith(", ".join(words)) for line in str(result).splitlines()), words
