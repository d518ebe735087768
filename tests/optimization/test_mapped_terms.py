"""Programmes of vectors of positions against the same programmes of scalars."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import optlink
from optlink.optimization.courses import TermCourse
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import build
from optlink.problem.design import DesignProblem
from optlink.solvers.exchange import PER_ROW, _with_moving_peaks
from tests.tiers import mostly_slow

MACHINES = {
    "peaks": {},
    "integral": {"objective": {"quantity": "torque", "measure": "rms"}, "limits.guide": None},
    "no reversals": {"objective": {"quantity": "torque", "measure": "rms"}, "limits": {}, "loads": {}},
}


def same_derivatives(nlp: NLP) -> None:
    plain = replace(nlp, mapped=None, cache={})
    random = np.random.default_rng(0)
    x, p = nlp.x_start + 0.01 * random.standard_normal(len(nlp.x_start)), nlp.p.copy()
    p[0], multipliers = 1.7, random.standard_normal(len(nlp.rows))
    one, other = nlp.at(x, p), plain.at(x, p)
    pairs = [(getattr(one, name), getattr(other, name)) for name in ("f", "gradient", "g", "jacobian")]
    for values, expected in [*pairs, (nlp.hessian(x, p, multipliers), plain.hessian(x, p, multipliers))]:
        np.testing.assert_allclose(values, expected, rtol=0.0, atol=1e-12 * np.max(np.abs(expected), initial=1e-300))


@pytest.mark.slow
@pytest.mark.parametrize("machine", MACHINES)
def test_derivatives_are_those_of_the_whole_expression(machine: str) -> None:
    task = optlink.load("shaper-design").override(MACHINES[machine]).spec
    nlp = build(task, terms=TermCourse(task, None, count=16))
    assert (machine == "no reversals") == (not nlp.terms.events)
    same_derivatives(nlp)
    copy = pickle.loads(pickle.dumps(nlp))
    assert copy.mapped is not None
    same_derivatives(copy)
    if machine == "peaks":
        same_derivatives(_with_moving_peaks(copy, [4, 2]))


@pytest.mark.parametrize(
    "name", mostly_slow(["crank-rocker", "function-exp", "crank-rocker-robust"], "crank-rocker", "function-exp")
)
def test_a_law_by_vectors_is_that_by_scalars(name: str) -> None:
    nlp = build(optlink.load(name).spec)
    nlp.set_exchange_points(np.linspace(0.1, 0.9, nlp.exchange_count))
    same_derivatives(nlp)
    copy = pickle.loads(pickle.dumps(nlp))
    assert copy.mapped is not None
    same_derivatives(copy)


def test_a_point_without_a_value_has_none_by_vectors_either() -> None:
    nlp = build(optlink.load("crank-rocker").spec)
    x = np.array([0.3, 0.3])  # too short to close the loop
    one, other = nlp.at(x, nlp.p), replace(nlp, mapped=None, cache={}).at(x, nlp.p)
    assert not one.finite
    np.testing.assert_array_equal(np.isfinite(one.f), np.isfinite(other.f))
    np.testing.assert_allclose(one.g, other.g, rtol=1e-14)


PATHS = {
    "untimed": ("path-vline6", {}),
    "untimed, root mean square": ("path-vline6", {"requirement.measure": "rms"}),
    "prescribed angles": ("path-arc5", {}),
    "from a free start angle": ("path-closed18", {}),
    "from a fixed start angle": ("path-conveyor", {"requirement.start": "20 deg"}),
    "from a free start angle, tolerances": ("path-conveyor", {}),
    "largest deviation": ("path-ellipse10", {"requirement.measure": "max"}),
    "poses": ("motion-3-poses", {}),
    "limits over the revolution": ("path-slider-egg", {}),
    "limits over the span": ("path-scott-russell", {}),
    "limits over revolution and span": ("path-stephenson-dwell", {"limits.transmission_over": "span"}),
    "law of several dyads": ("law-six-bar", {"requirement.measure": "max"}),
    "worst transmission": ("path-watt-leg", {"requirement": {"kind": "transmission"}}),
}


@pytest.mark.parametrize(
    "kind",
    mostly_slow(
        PATHS,
        "untimed, root mean square",
        "prescribed angles",
        "from a free start angle, tolerances",
        "largest deviation",
        "poses",
    ),
)
def test_a_path_by_vectors_is_that_by_scalars(kind: str) -> None:
    name, changes = PATHS[kind]
    task = optlink.load(name, changes).variants()[0].model
    assert isinstance(task, DesignProblem)
    nlp = build(task)
    same_derivatives(nlp)
    same_derivatives(pickle.loads(pickle.dumps(nlp)))
    same_derivatives(build(task, -1, movable=True))
    if nlp.exchange_count:
        moving = _with_moving_peaks(nlp, list(range(nlp.exchange_rows[1])) * PER_ROW)
        moving.x_start[len(nlp.x_start) :] += 0.013
        assert moving.mapped is not None
        same_derivatives(moving)
