"""Programmes that are built once: with other numbers they are those of problems that are built anew."""

from __future__ import annotations

import copy
import re
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.optimization import parameters, programme
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import build
from optlink.problem.design import DesignProblem
from tests.tiers import mostly_slow

NUMBER = re.compile(r"[-+]?[0-9.]+(?=( [^ ]+)?$)")
NUMBERS = "p", "x_start", "x_low", "x_high", "lower", "upper"
FIELDS = "variables", "exact", "factor", "measure", "helpers", "states", "constants", "level_slopes", "exchange_rows", "recipe"


@pytest.fixture(autouse=True)
def _nothing_kept() -> None:
    parameters.forget()


def leaves(raw: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the places of the numbers of a file."""
    items = raw.items() if isinstance(raw, dict) else enumerate(raw) if isinstance(raw, list) else ()
    for key, value in items:
        yield from leaves(value, (*at, key))
    if (isinstance(raw, str) and NUMBER.match(raw)) or (isinstance(raw, int | float) and not isinstance(raw, bool)):
        yield at


def changed(raw: Any) -> Any:
    """Return a slightly larger number."""
    if isinstance(raw, str):
        return NUMBER.sub(lambda found: f"{float(found[0]) * 1.013 or 0.7:.12g}", raw)
    return raw + 1 if isinstance(raw, int) else raw * 1.013 or 0.01


def with_one_changed(problem: optlink.ProblemFile, at: tuple[Any, ...]) -> optlink.ProblemFile:
    """Return a problem with another number at a place of the file."""
    length = next((k for k, name in enumerate(at) if isinstance(name, int)), len(at))
    whole = raw = copy.deepcopy(problem.raw)
    for key in at[:-1]:
        raw = raw[key]
    raw[at[-1]] = changed(raw[at[-1]])
    for key in at[:length]:
        whole = whole[key]
    return problem.override({".".join(at[:length]): whole})


def fresh(problem: DesignProblem) -> NLP:
    """Return the programme of a problem, built anew."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(programme, "reused", lambda problem, direction, make: make())
        return build(problem)


def differences(one: NLP, other: NLP) -> list[str]:
    """Return what differs between two programmes: fields, numbers, rows, values at a point."""

    def rows(nlp: NLP) -> list[tuple[Any, ...]]:
        return [(row.limit, row.label, row.low, row.high, row.scale, row.over_span, row.periodic) for row in nlp.rows]

    found = [name for name in FIELDS if getattr(one, name) != getattr(other, name)]
    found += [name for name in NUMBERS if not np.array_equal(getattr(one, name), getattr(other, name))]
    found += ["rows"] if rows(one) != rows(other) else []
    x = np.clip(one.x_start + 0.01 * np.random.default_rng(0).standard_normal(len(one.x_start)), one.x_low, one.x_high)
    for name in ("values", "residuals"):
        values, others = (np.hstack(getattr(nlp, name)(x, nlp.p)) for nlp in (one, other))
        found += [] if np.array_equal(values, others, equal_nan=True) else [name]
    return found


@pytest.mark.parametrize(
    "name",
    mostly_slow(["crank-rocker", "crank-rocker-robust", "law-six-bar", "motion-3-poses-region", "poses-and-law"], "crank-rocker"),
)
def test_no_changed_number_of_a_file_meets_formulas_with_another_one(name, monkeypatch):
    monkeypatch.setattr(parameters, "MOST_KEPT", 1000)
    problem = optlink.load(name).override({"limits.alignment": "2 deg"}).variants()[0]
    base, used, wrong = build(problem.spec), [], {}
    for at in leaves({key: problem.raw[key] for key in problem.raw.keys() - {"expected"}}):
        try:
            other = with_one_changed(problem, at).spec
        except InputError:
            continue
        nlp = build(other)
        if nlp.x_symbol is base.x_symbol:
            used.append(".".join(map(str, at)))
            wrong[used[-1]] = differences(nlp, fresh(other))
    assert not any(wrong.values()), wrong
    assert sum("mechanism." in key for key in used) >= 5, used


LIMIT, BOUNDS, CRANK = "limits.transmission_angle", "mechanism.coupler.bounds", "mechanism.crank"


def test_a_solution_with_other_numbers_is_the_same_to_the_last_digit(crank_rocker):
    changes = [{LIMIT: ["40 deg", "140 deg"]}, {BOUNDS: ["100 mm", "400 mm"]}, {CRANK: "90 mm"}, {LIMIT: ["45 deg", "150 deg"]}]
    again = [optlink.solve(crank_rocker.override(change), certify=False) for change in changes]
    assert len({id(result.solution.nlp.x_symbol) for result in again}) == 1
    for change, one in zip(changes, again, strict=True):
        parameters.forget()
        other = optlink.solve(crank_rocker.override(change), certify=False)
        assert (one.design, one.objective, one.limits) == (other.design, other.objective, other.limits)
    assert len({result.objective for result in again}) == 4


def test_what_is_kept_does_not_change_with_its_use(crank_rocker):
    used = build(crank_rocker.spec)
    used.limit(0, 0.5, 0.6)
    used.limit(len(used.variables), 0.1, None)
    used.p[1:] *= 1.1
    used.at(used.x_start, used.p)
    nlp = build(crank_rocker.spec)
    assert nlp._all is used._all
    assert not differences(nlp, fresh(crank_rocker.spec))


def test_a_limit_that_another_one_replaces_has_other_rows(crank_rocker):
    build(crank_rocker.spec)
    loose = crank_rocker.override({LIMIT: ["0.5 deg", "179.5 deg"]})  # that of the alignment, 1 deg, is tighter
    nlp = build(loose.spec)
    assert {row.limit for row in nlp.rows} == {"limits.alignment", "limits.crank", "limits.length_margin"}


def test_every_thread_has_its_own_programmes(crank_rocker):
    found = [build(crank_rocker.spec)]
    thread = threading.Thread(target=lambda: found.append(build(crank_rocker.spec)))
    thread.start()
    thread.join()
    assert found[0].x_symbol is not found[1].x_symbol


def test_few_programmes_are_kept(crank_rocker, monkeypatch):
    monkeypatch.setattr(parameters, "MOST_KEPT", 2)
    frames = [crank_rocker.override({"mechanism.frame": f"{length} mm"}).spec for length in (480, 490, 500)]
    first = [build(frame).x_symbol for frame in frames]
    assert [build(frame).x_symbol is one for frame, one in zip(reversed(frames), reversed(first), strict=True)] == [
        True,
        True,
        False,
    ]
