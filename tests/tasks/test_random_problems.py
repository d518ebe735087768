"""Random problems: in what is called valid an independent judge finds no defect, no wrong figure and no missed limit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

import optlink
from optlink.tasks.design import solve
from optlink.tasks.results.design import LinkageDesign
from tests.random_linkages import (
    RandomTask,
    faults_of,
    faults_of_rocker,
    faults_of_slider,
    random_law_task,
    random_task,
    round_trip,
    transmission,
    transmission_range,
)

FIRST, ENOUGH = 1001, 16  # the problem before takes as long as all these: the largest distance, minimised in a narrow valley
STARTS = 240  # of the batch: enough for answers, not for the best of them
LAW_STARTS = 8


def judged(seed: int) -> int:
    """Solve a random problem; the number of designs that are called valid, none of which has a fault."""
    task = random_task(seed)
    result = solve(optlink.read(task.raw), starts=STARTS)
    for rank, design in enumerate(result.designs):
        assert design.valid
        assert not (faults := faults_of(design, task)), (seed, rank, faults)
    return len(result.designs)


@pytest.mark.slow
def test_many_random_problems_give_consistent_results() -> None:
    """At least half of the problems have an answer, and an answer has one design and more."""
    answers: list[int] = []
    while sum(answers) < ENOUGH:
        answers.append(judged(FIRST + len(answers)))
        assert len(answers) < 2 * ENOUGH
    assert sum(answers) >= len(answers) <= 2 * sum(map(bool, answers))


def judged_law(seed: int, *, slides: bool) -> bool:
    """Solve for a random law; whether the answer is called valid, and then has no fault."""
    task = random_law_task(seed, slides=slides)
    file = optlink.read(task.raw)
    if slides:
        outcome = solve(file, starts=STARTS, designs=2)
        faults = [faults_of_slider(design, task) for design in outcome.designs]
        assert not any(faults), (seed, faults)
        return outcome.valid
    result = optlink.solve(file, starts=LAW_STARTS)
    if result.valid:
        assert not (wrong := faults_of_rocker(result, task)), (seed, wrong)
    return result.valid


@pytest.mark.slow
@pytest.mark.parametrize("slides", [False, True], ids=["four-bar", "slider-crank"])
def test_random_laws(slides: bool) -> None:
    """Of four laws, with the measures sum of squares, rms and max; most of them have an answer."""
    assert sum(judged_law(seed, slides=slides) for seed in (0, 1, 2, 100)) >= 3


# --- the judge sees what is planted ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def answer() -> tuple[LinkageDesign, RandomTask]:
    """A faultless design of a path with a transmission limit, and its task."""
    trip = round_trip(1000, 9, "given")
    low, high = map(math.degrees, transmission_range(trip.linkage, 0.0, 2.0 * math.pi))
    limits = {
        "transmission_angle": [f"{low - 1.0} deg", f"{high + 1.0} deg"],
        "link_ratio": [0.05, 20.0],
        "pivots": {"x": ["-400 mm", "400 mm"], "y": ["-400 mm", "400 mm"]},
    }
    raw = {**trip.raw, "limits": limits}
    raw["requirement"] |= {"measure": "rms"}
    task = RandomTask(raw, trip.points, trip.crank, "given", np.ones(9), closed=False)
    design = solve(optlink.read(raw), designs=1).designs[0]
    assert faults_of(design, task) == []
    return design, task


def changed(**values: float) -> Callable[[LinkageDesign], LinkageDesign]:
    """The design with other dimensions but unchanged results."""
    return lambda design: dataclasses.replace(design, values={**design.values, **values})


PLANTED: dict[str, tuple[Callable[[LinkageDesign], LinkageDesign], str]] = {
    "an error figure too good": (lambda d: dataclasses.replace(d, objective=d.objective + 1e-6), "objective"),
    "points out of order": (lambda d: dataclasses.replace(d, crank_angles=d.crank_angles[[0, 2, 1, *range(3, 9)]]), "order"),
    "another start": (lambda d: dataclasses.replace(d, crank_angles=d.crank_angles + 0.01), "not the crank angles given"),
    "a crank that does not turn": (changed(crank=0.4), "does not turn"),
    "a pivot outside": (changed(**{"A.x": 0.9}), "pivots at x"),
    "another point": (changed(**{"P.along": 9.0}), "along"),
}


@pytest.mark.parametrize("name", PLANTED)
def test_the_oracle_detects_a_planted_error(answer: tuple[LinkageDesign, RandomTask], name: str) -> None:
    design, task = answer
    plant, words = PLANTED[name]
    assert any(words in fault for fault in faults_of(plant(design), task)), faults_of(plant(design), task)


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"transmission_angle": ["89 deg", "91 deg"]}, "transmission angle"),
        ({"link_ratio": [0.999, 1.001]}, "link ratio"),
        ({"crank": "double-crank"}, "is no double-crank"),
        ({"pivots": {"x": ["399 mm", "400 mm"]}}, "pivots"),
    ],
)
def test_the_oracle_detects_a_violated_limit(
    answer: tuple[LinkageDesign, RandomTask], limits: dict[str, object], words: str
) -> None:
    design, task = answer
    pivots = {"pivots": {"x": ["-400 mm", "400 mm"], "y": ["-400 mm", "400 mm"], **limits.pop("pivots", {})}}
    tighter = dataclasses.replace(task, raw={**task.raw, "limits": {**limits, **pivots}})
    assert any(words in fault for fault in faults_of(design, tighter))


def test_least_transmission_angle_lies_between_sampled_positions() -> None:
    """A range of crank angles that passes, off every grid, the position where coupler and rocker all but stretch."""
    trip = round_trip(1000, 5, "given")
    design = solve(optlink.read(trip.raw), designs=1).designs[0]
    values = {**design.values, "frame": 0.1, "crank": 0.05, "coupler": 0.06, "rocker": 0.09}
    values["crank"] = values["coupler"] + values["rocker"] - values["frame"] - 1e-9  # crank + frame: all but coupler + rocker
    raw = {**design.problem.raw, "limits": {"crank": "span"}}
    sharp = dataclasses.replace(design, problem=optlink.read(raw).override({"mechanism.assembly": "left"}), values=values)
    sharp = dataclasses.replace(sharp, crank_angles=np.linspace(2.5, 3.6, 5))
    linkage = {name: 1e3 * values[name] for name in ("crank", "coupler", "rocker", "frame")}
    exact = math.pi - transmission(linkage, np.array([math.pi]))[0]
    assert exact < math.radians(0.1)
    assert sharp.least_transmission == pytest.approx(exact, rel=1e-3)
    assert design.least_transmission > math.radians(1.0)
