"""A design may be given by texts with units, and many designs by a data frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

import optlink
from optlink.errors import InputError

TEXTS, NUMBERS = {"coupler": "412.9 mm", "rocker": "0.2323 m"}, {"coupler": 0.4129, "rocker": 0.2323}
ALONE: dict[str, Any] = {"tolerances": {"coupler": "0.1 mm"}, "workers": 1}
CALLS: dict[str, Callable[[Any], tuple[Any, Any]]] = {  # of a design: figures, and the design that the result keeps
    "simulate": lambda design: ((run := optlink.simulate("crank-rocker", rows=10, design=design))["time_s"], run.design),
    "motion": lambda design: (optlink.motion("crank-rocker", [0.0, 1.0], design=design).position("C"), None),
    "sweep": lambda design: (
        optlink.sweep("crank-rocker", {"mechanism.frame": "490..500 mm:2"}, analyze=True, design=design)
        .columns["valid"]
        .tolist(),
        None,
    ),
    "tolerance": lambda design: (optlink.studies.tolerance("crank-rocker", samples=0, design=design, **ALONE).by, None),
}


@pytest.mark.parametrize("name", CALLS)
def test_texts_with_units_are_the_same_design(name):
    (one, kept), (other, _) = (CALLS[name](design) for design in (TEXTS, NUMBERS))
    assert np.array_equal(one, other)
    assert kept is None or dict(kept) == pytest.approx(NUMBERS)
    with pytest.raises(InputError, match=r'design\.coupler = "412\.9 kg"'):
        CALLS[name]({**TEXTS, "coupler": "412.9 kg"})


LENGTHS = {"coupler.length": [0.14, 0.15, 0.16]}


@pytest.mark.parametrize(
    "designs",
    [
        pd.DataFrame(LENGTHS, index=["a", "b", "c"]),
        {"coupler.length": ["140 mm", "15 cm", 0.16]},
        pd.DataFrame({"mechanism.coupler.length": ["140 mm", "15 cm", "0.16 m"]}),
    ],
)
def test_many_designs_are_a_data_frame_or_texts(designs):
    batches = [optlink.analyze_batch("shaper", each, ["input.torque_Nm"], 36) for each in (designs, LENGTHS)]
    assert np.array_equal(*(batch["input.torque_Nm"] for batch in batches))


@pytest.mark.parametrize(
    ("designs", "message"),
    [
        ({"coupler.length": ["140 mm", "x"]}, r'designs\.coupler\.length = "x": this is not a length'),
        ({"coupler.length": ["140"]}, r"a length needs a unit. Write \"140 mm\""),
        (pd.DataFrame({"rod": [0.1]}), r'designs = "rod": unknown quantity'),
        ([0.1], r"designs = \[0\.1\]: not a mapping of names to values"),
    ],
)
def test_a_wrong_size_of_a_batch_is_named(designs, message):
    with pytest.raises(InputError, match=message):
        optlink.analyze_batch("shaper", designs)


def test_the_design_of_a_result_is_taken_everywhere(solved):
    motion = {"requirement.measure": "max", "requirement.tolerance": "3 deg", "objective": {"quantity": "torque"}}
    composed = optlink.load("crank-rocker", {**motion, "bodies.rocker": {"mass": "1 kg", "inertia": "0.01 kg*m^2"}})
    for problem in (solved.problem, composed):
        assert {"phi0", "psi0"} <= optlink.validate(problem, {"coupler": 0.42, "rocker": 0.24}).design.keys()
        for call in (optlink.validate, optlink.gradient):
            call(problem, {**solved.design})
        assert optlink.analyze(problem, 12, design=solved.design).design["phi0"] == solved.design["phi0"]
        place = optlink.motion(problem, [0.0], design=solved.design).position("C")
        assert np.hypot(*(place - [solved.design["frame"], 0.0]).T) == pytest.approx(solved.design["rocker"])
