"""Random problems of all kinds: verdicts, figures and limits by formulas of the tests, and no design worse than a known one."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

import optlink
from tests.oracles.judge import RandomProblem, faults_of
from tests.oracles.random_problems import KINDS, random_problem
from tests.tiers import mostly_slow

SAMPLE = range(0, 2 * 7 * len(KINDS), 7)  # every kind twice: their number and 7 have no divisor in common
Solved = tuple[RandomProblem, Any]


@pytest.mark.parametrize("number", mostly_slow(SAMPLE, 28))
def test_no_fault_is_found(number: int) -> None:
    problem = random_problem(number)
    result = optlink.solve(optlink.read(problem.raw), certify=False)
    assert faults_of(problem, result) == []


@pytest.mark.slow
def test_the_sample_has_all_kinds() -> None:
    assert sorted(number % len(KINDS) for number in SAMPLE) == sorted([*range(len(KINDS))] * 2)
    possible = [
        random_problem(number).possible for number in SAMPLE if KINDS[number % len(KINDS)].__name__ in ("stroke", "transmission")
    ]
    assert set(possible) == {True, False}


@pytest.mark.slow
def test_a_law_of_a_four_bar_is_that_of_its_dyads() -> None:
    one, other = random_problem(0), random_problem(1)
    assert one.raw["requirement"]["law"] == other.raw["requirement"]["law"]
    assert one.planted == other.planted
    found = [optlink.solve(optlink.read(each.raw), starts=20, certify=False) for each in (one, other)]
    assert found[0].objective == pytest.approx(found[1].objective, rel=1e-9)


def changed(result: Any, **changes: Any) -> Any:
    """A result as its judge sees it, with other values."""
    shown = {name: getattr(result, name) for name in ("valid", "status", "design", "objective", "definite")}
    return SimpleNamespace(
        **shown | {"best": SimpleNamespace(crank_angles=getattr(getattr(result, "best", None), "crank_angles", None))} | changes
    )


@pytest.fixture(
    scope="module", params=mostly_slow([5, 6, 8, 9, 10], 5, 9), ids=lambda number: KINDS[number % len(KINDS)].__name__
)
def solved(request: pytest.FixtureRequest) -> Solved:
    problem = random_problem(request.param)
    result = optlink.solve(optlink.read(problem.raw), certify=False)
    assert faults_of(problem, changed(result)) == []
    return problem, result


DEFECTS: dict[str, tuple[Callable[[Any], Any], str]] = {
    "a better objective": (lambda result: changed(result, objective=0.99 * result.objective - 1e-3), "is reported"),
    "another size": (lambda result: changed(result, design=longer(result.design)), ""),
    "a wrong verdict": (lambda result: changed(result, valid=False), "although there is one"),
}


def longer(design: Any) -> dict[str, float]:
    """A design with a crank that is longer by a thousandth."""
    return {name: value * (1.001 if name.startswith("crank") else 1.0) for name, value in dict(design).items()}


@pytest.mark.parametrize("name", DEFECTS)
def test_a_planted_defect_is_found(solved: Solved, name: str) -> None:
    problem, result = solved
    plant, words = DEFECTS[name]
    found = faults_of(problem, plant(result))
    assert any(words in fault for fault in found), found
    assert found


def test_a_design_of_an_impossible_problem_is_a_fault(solved: Solved) -> None:
    problem, result = solved
    assert faults_of(dataclasses.replace(problem, possible=False), changed(result)) == ["a valid design of an impossible problem"]


def test_a_design_worse_than_the_known_one_is_a_fault(solved: Solved) -> None:
    problem, result = solved
    better = dataclasses.replace(problem, planted=0.9 * result.objective * problem.unit - 10.0 * problem.least)
    assert any("is worse than" in fault for fault in faults_of(better, changed(result)))
