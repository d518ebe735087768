"""Random function problems: the default answer against a separate oracle, and more starts against fewer."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import optlink
from tests.function_oracle import Function, largest, oracle
from tests.solved import once

KNOWN = Path(__file__).parents[1] / "data" / "function_optima.json"  # found by `oracle` with 40 starts, seed 0
FUNCTIONS = {
    "1/x": (lambda x: 1.0 / x, (1.0, 2.0)),
    "x^2": (lambda x: x**2, (0.0, 1.0)),
    "exp(x)": (np.exp, (0.0, 1.0)),
    "tan(x)": (np.tan, (0.0, 0.7)),
    "sqrt(x)": (np.sqrt, (1.0, 3.0)),
    "sin(x)": (np.sin, (0.0, 1.5)),
    "log(x)": (np.log, (1.0, 3.0)),
    "x^1.5": (lambda x: x**1.5, (0.0, 1.0)),
    "cosh(x)": (np.cosh, (0.0, 1.2)),
}
SIDES = {"left": (1,), "right": (-1,), "either": (1, -1)}
CHOSEN = (2, 3, 6, 7, 10, 11, 12, 13, 14, 18, 19)
"""Of the 20 recorded problems: each function, left, right and either, rockers that turn with the crank and against it, an optimum
that one start in ten reaches (2), an error of a hundred-thousandth of a radian (6)."""


@dataclass(frozen=True)
class Case:
    """A problem file, and the same for the oracle."""

    raw: dict[str, object]
    task: Function


def case(number: int) -> Case:
    """Function, ranges, limits and assembly modes at random."""
    rng = np.random.default_rng(1000 + number)
    text = list(FUNCTIONS)[rng.integers(len(FUNCTIONS))]
    y, (low, high) = FUNCTIONS[text]
    turned, swung = int(rng.integers(45, 120)), int(rng.choice([-1, 1]) * rng.integers(35, 100))
    gamma, ratio = int(rng.integers(22, 42)), float(rng.choice([0.05, 0.1, 0.2]))
    assembly = list(SIDES)[rng.integers(3)]
    sizes = {name: {"bounds": ["1 mm", "5000 mm"]} for name in ("crank", "coupler", "rocker")}
    raw = {
        "title": f"{text}, {turned} deg to {swung} deg",
        "mechanism": {"type": "four-bar", "frame": "100 mm", **sizes, "assembly": assembly},
        "requirement": {
            "kind": "function",
            "law": {"function": text, "x": [low, high], "input": f"{turned} deg", "output": f"{swung} deg"},
            "measure": "max",
        },
        "limits": {
            "crank": "span",
            "transmission_angle": [f"{gamma} deg", f"{180 - gamma} deg"],
            "link_ratio": [ratio, 1.0 / ratio],
        },
    }
    angles = math.radians(gamma), math.radians(180 - gamma)
    task = Function(
        lambda t: y(low + (high - low) * t),
        math.radians(turned),
        math.radians(swung),
        angles,
        (ratio, 1.0 / ratio),
        SIDES[assembly],
    )
    return Case(raw, task)


def known() -> list[float]:
    """Largest errors [rad] of the oracle."""
    return [float(value) for value in json.loads(KNOWN.read_text(encoding="utf-8"))]


@cache
def default_answer(number: int) -> optlink.SynthesisResult:
    """The answer with default options, computed once for all tests of a run."""
    computed: optlink.SynthesisResult = once(f"function problem {number}", lambda: optlink.solve(optlink.read(case(number).raw)))
    return computed


def measured(result: optlink.SynthesisResult, task: Function) -> tuple[float, float]:
    """Largest error and missed limit of an answer, by the oracle's formulas."""
    sizes = [math.log(result.design[name] / result.design["frame"]) for name in ("crank", "coupler", "rocker")]
    x = np.array([*sizes, result.design["phi0"], result.design["psi0"]])
    return largest(x, {"left": 1, "right": -1}[result.assembly], task)


@pytest.mark.slow
@pytest.mark.parametrize("number", CHOSEN)
def test_the_default_result_is_as_good_as_the_oracle_and_claims_nothing_it_refutes(number: int) -> None:
    problem = case(number)
    result = default_answer(number)
    error, missed = measured(result, problem.task)
    assert result.valid
    assert missed <= 1e-6
    assert error == pytest.approx(result.objective, rel=1e-5)
    assert result.objective <= known()[number] * 1.001
    assert result.evidence is not None
    assert result.evidence.hits == result.evidence.counts[0]


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 12, 18])
def test_more_starts_are_never_worse(number: int) -> None:
    """The answer of N starts is the best of those of its first ones: valid stays valid, and no better one is lost."""
    file = optlink.read({**case(number).raw})
    computed = [optlink.solve(file, starts=starts, seed=number) for starts in (1, 8, 14)]
    for fewer, more in itertools.pairwise(computed):
        assert more.valid >= fewer.valid
        assert more.objective <= fewer.objective or not fewer.valid


@pytest.mark.slow
@pytest.mark.parametrize(("number", "starts"), [(12, 25), (18, 10)], ids=["one mode", "both modes"])
def test_the_oracle_finds_its_recorded_optima_from_other_starts(number: int, starts: int) -> None:
    assert oracle(case(number).task, starts, 7) == pytest.approx(known()[number], rel=2e-3)
