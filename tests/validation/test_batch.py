"""Many designs validated at once: the verdicts and figures of each are those of its own validation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from optlink.problem.design import DesignProblem
from optlink.studies.optimum_parameters import copy_model
from optlink.validation import validate, validate_batch
from optlink.validation.check import Validation
from tests.validation.test_validation import BEST, OPTIMUM, SHIPPED, defects, failed, problem

COUNT = 150


def random_designs(rule: DesignProblem, count: int, seed: int) -> list[dict[str, float]]:
    """Designs about the optimum and far from it, some with a wrong angle or length, some with a value missing."""
    rng = np.random.default_rng(seed)
    result = []
    for k in range(count):
        spread = (1e-7, 1e-3, 0.3)[k % 3]
        design = rule.design({name: value * (1.0 + spread * rng.uniform(-1.0, 1.0)) for name, value in OPTIMUM.items()})
        if k % 10 == 1:
            design[("phi0", "psi0", "crank", "frame")[k // 10 % 4]] += rng.choice([1e-6, 1e-3, 1.0])
        if k % 25 == 2:
            design[("coupler", "phi0", "psi0", "rocker")[k // 25 % 4]] = math.nan
        result.append(design)
    return result


def columns(designs: list[dict[str, float]]) -> dict[str, np.ndarray]:
    return {name: np.array([design[name] for design in designs]) for name in designs[0]}


def assert_same(one: Validation, other: Validation) -> None:
    """The same checks with the same verdicts, texts and figures, to the last digit."""
    assert repr(one) == repr(other)


@pytest.mark.slow
@pytest.mark.parametrize(
    "rule",
    [
        SHIPPED,
        pytest.param(
            problem(None, None, {"swing_angle": ["40 deg", "60 deg"], "time_ratio": [1.0, 1.2], "link_ratio": [0.2, 0.9]}),
            marks=pytest.mark.slow,
        ),
        problem({"assembly": "right"}, {"from": "40 deg", "span": "-70 deg", "measure": "max"}, {"crank": "span"}),
        pytest.param(
            problem(None, {"from": "inner dead centre", "measure": "rms"}, {"transmission_over": "span", "pressure_angle": None}),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["shipped", "strokes", "span", "inner"],
)
def test_a_batch_validates_each_design_as_a_single_one(rule):
    designs = random_designs(rule, COUNT if rule is SHIPPED else 60, 5)
    claimed = np.array([validate(rule, design).objective for design in designs]) * np.tile(
        [1.0, 1.0, 1.0 + 2e-6], len(designs) // 3
    )
    batch = validate_batch(rule, columns(designs), objective=claimed)
    single = [validate(rule, design, objective=objective) for design, objective in zip(designs, claimed, strict=True)]
    for k, one in enumerate(single):
        assert_same(batch.of(k), one)
        assert batch.valid[k] == one.valid
    if rule is SHIPPED:
        assert 20 < np.count_nonzero(batch.valid) < COUNT - 20
        part = validate_batch(rule, columns(designs[7:40]), objective=claimed[7:40])
        for k in range(33):
            assert_same(part.of(k), single[7 + k])


@pytest.mark.parametrize("name", [name for name, defect in defects().items() if defect.mechanism is None])
def test_a_planted_defect_is_detected_among_valid_designs(name):
    defect = defects()[name]
    right = validate(defect.rule, defect.design)
    designs = [defect.design] * 5
    objectives = np.full(5, right.objective if defect.objective is None else defect.objective)
    batch = validate_batch(defect.rule, columns(designs), objective=None if defect.objective is None else objectives)
    assert defect.must <= failed(batch.of(3)) <= defect.must | defect.may
    assert not np.any(batch.valid)


def test_one_wrong_design_does_not_disturb_its_neighbours():
    claimed = validate(SHIPPED, BEST).objective
    designs = columns([BEST] * 64)
    designs["coupler"][17] *= 1.0 - 1e-4  # its transmission angle exceeds the limit by 0.03 deg
    designs["psi0"][30] = math.nan
    objectives = np.full(64, claimed)
    objectives[45] *= 1.0 + 1e-5
    batch = validate_batch(SHIPPED, designs, objective=objectives)
    assert np.flatnonzero(~batch.valid).tolist() == [17, 30, 45]
    assert "largest" in failed(batch.of(17))
    assert failed(batch.of(30)) == {"psi0", "finite", "objective"}
    assert failed(batch.of(45)) == {"objective"}


@pytest.mark.parametrize("hair", [1e-9, -1e-9])
def test_limits_and_bounds_may_differ_between_designs(hair):
    """A limit 1e-9 deg beyond its tolerance of 1e-6 deg fails, one within it passes; likewise the bound of a length."""
    largest = next(check.value for check in validate(SHIPPED, BEST).checks if check.name.startswith("largest"))
    highs = np.radians(np.array([135.0, largest - 1e-6 + hair, 136.0]))
    limits = SHIPPED.limits
    mechanism = SHIPPED.mechanism
    bounds = np.array([0.9, 0.9, BEST["coupler"] - 1e-8 * BEST["frame"] + 1e-6 * hair])
    rule = copy_model(
        SHIPPED,
        limits=copy_model(limits, transmission_angle=replace(limits.transmission_angle, high=highs)),
        mechanism=copy_model(mechanism, coupler=replace(mechanism.coupler, high=bounds)),
    )
    batch = validate_batch(rule, columns([BEST] * 3))
    assert [failed(batch.of(k)) for k in range(3)] == [
        set(),
        set() if hair > 0 else {"largest"},
        set() if hair > 0 else {"bounds"},
    ]
    for k in range(3):
        own = problem(None, None, {"transmission_angle": ["45 deg", f"{float(np.degrees(highs[k]))!r} deg"]})
        own = copy_model(own, mechanism=copy_model(own.mechanism, coupler=replace(own.mechanism.coupler, high=bounds[k])))
        assert [check.passed for check in batch.of(k).checks] == [check.passed for check in validate(own, BEST).checks]
