"""Every shipped problem loads, round-trips, cites its source and reaches what it expects."""

from __future__ import annotations

import tomllib

import pytest

import optlink
from optlink.design.files import dump, problems_folder

NAMES = sorted(optlink.shipped())


def test_problems_are_found():
    assert "crank-rocker" in NAMES
    assert problems_folder().is_dir()


@pytest.mark.parametrize("name", NAMES)
def test_round_trip(name, tmp_path):
    problem = optlink.load(name)
    copy = tmp_path / "copy.toml"
    copy.write_text(dump(problem), encoding="utf-8")
    again = optlink.load(copy)
    assert again.spec == problem.spec
    assert again.hash == problem.hash
    assert tomllib.loads(dump(again)) == dict(problem.raw)


@pytest.mark.parametrize("name", NAMES)
def test_source_is_cited(name):
    problem = optlink.load(name).spec
    assert len(problem.source) > 20
    assert problem.expected is not None
    assert len(problem.expected.source) > 20


@pytest.mark.parametrize("name", NAMES)
def test_expected_is_reached(name):
    problem = optlink.load(name)
    expected = problem.spec.expected
    result = optlink.solve(problem, "both")
    assert result.valid
    checked = 0
    for quantity in ("crank", "coupler", "rocker", "frame"):
        wanted = getattr(expected, quantity)
        if wanted is not None:
            assert result.design[quantity] == pytest.approx(wanted.value, abs=expected.length_tolerance.value)
            checked += 1
    if expected.objective is not None:
        assert result.objective == pytest.approx(expected.objective, abs=expected.objective_tolerance)
        checked += 1
    assert checked > 0


def test_hash_changes_with_the_problem_and_not_with_its_words(crank_rocker):
    assert crank_rocker.override({"title": "Another title"}).hash == crank_rocker.hash
    assert crank_rocker.override({"mechanism.frame": "501 mm"}).hash != crank_rocker.hash
    assert crank_rocker.override({"requirement.points": 31}).hash != crank_rocker.hash


def test_none_takes_a_key_away(crank_rocker):
    without = crank_rocker.override({"limits.transmission_angle": None})
    assert without.spec.limits.transmission_angle is None
    assert "transmission_angle" not in tomllib.loads(dump(without))["limits"]


def test_expected_goes_when_the_problem_changes(crank_rocker):
    assert crank_rocker.spec.expected is not None
    assert crank_rocker.override({"mechanism.frame": "501 mm"}).spec.expected is None
    assert crank_rocker.override({"title": "Another title"}).spec.expected is not None
