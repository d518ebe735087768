"""Six-bars for paths: limits hold between the positions of the programme, and none is worse than the best four-bar."""

from __future__ import annotations

import copy
import itertools
from dataclasses import replace

import numpy as np
import pytest

import optlink
from optlink.errors import Status
from optlink.optimization.programme import build
from optlink.problem.design import DesignProblem
from optlink.problem.file import read
from optlink.solvers import exchange
from optlink.solvers.exchange import RowPeak, peaks
from optlink.solvers.multistart import solution_at
from optlink.synthesis.batch import Batch
from optlink.synthesis.batch_search import Candidate
from optlink.synthesis.growth import contained_four_bar, grow_from_four_bar
from optlink.tasks import design as task
from optlink.tasks.design import SearchRounds, solve
from optlink.tasks.results.design import LinkageDesign
from optlink.tasks.search import Polisher, has_several_dyads
from optlink.validation.check import Check
from tests.random_six_bars import faults_of_six_bar, random_six_bar

STARTS = 60  # of the batch


def test_peaks_are_found_between_positions_of_the_grid() -> None:
    grid = np.linspace(0.0, 1.0, 41)
    computed = peaks(lambda at: np.array([np.sin(7.0 * at), -1.0 - at * (1.0 - at)]), grid)
    assert [(peak.row, round(peak.at, 6)) for peak in computed] == [(0, 0.224399), (0, 1.0)]
    assert computed[0].height == pytest.approx(1.0, abs=1e-12)
    assert isinstance(computed[0], RowPeak)


def test_the_exchange_of_positions_ends_where_a_round_does_not_move(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every further round would repeat it, to the largest number of iterations."""
    file = optlink.load("path-watt-leg").variants()[0]
    task = file.spec
    nlp = build(task, 1)
    start = solution_at(nlp, nlp.x_start, "")
    assert np.isfinite(start.objective)
    calls = []
    monkeypatch.setattr(exchange, "_followed", lambda _nlp, at, *_rest: (calls.append(at) or at, False))
    exchange.solve_semi_infinite(task, start, "ipopt", near=True)
    assert len(calls) == 1


@pytest.mark.slow
@pytest.mark.parametrize("watt", [False, True])
def test_a_six_bar_contains_the_curve_of_its_four_bar(watt: bool) -> None:
    """Starts that grow from a four-bar repeat its curve exactly and keep all limits: a coincident joint, and a pantograph."""
    task = random_six_bar(10 + (not watt), 12)
    part = contained_four_bar(task.file)
    assert part is not None
    assert (part.arms is not None) is watt
    four_bars = solve(part.file, starts=STARTS).designs
    count = 0
    for file, four_bar in itertools.product(task.file.variants(), four_bars):
        assert isinstance(file.model, DesignProblem)
        batch = Batch(file.model)
        contained = replace(part, file=four_bar.problem)
        x, t = grow_from_four_bar(contained, batch, four_bar.values, four_bar.crank_angles, 5, np.random.default_rng(0))
        r = batch.residuals(x, t)[0]
        count += len(x)
        whole = np.sum(r * r, axis=(1, 2)) * file.model.size**2
        assert whole == pytest.approx(np.full(len(x), four_bar.objective), rel=1e-5)
    assert count >= 3


def judge(seed: int) -> tuple[float, float]:
    """Errors [m^2] of the six-bar and of the best four-bar of a random path; the six-bar's designs are without fault."""
    task = random_six_bar(seed, 12)
    result = solve(task.file, starts=STARTS)
    assert result.valid
    for design in result.designs:
        assert faults_of_six_bar(design, task) == []
    part = contained_four_bar(task.file)
    assert part is not None
    four_bar = solve(task.four_bar, starts=STARTS)
    return result.objective, four_bar.objective


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_random_six_bars_are_valid_and_no_worse_than_the_best_four_bar(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """That of as many starts as the four-bar within the six-bar has."""
    monkeypatch.setattr(task, "PART_STARTS", STARTS)
    six, four = judge(seed)
    assert six <= four * (1.0 + 1e-9)


def planted(monkeypatch: pytest.MonkeyPatch, worse: float) -> None:
    """Let every local search of a six-bar stall at its start, or end at an optimum that is said to be worse than its start."""
    polish = Polisher.polish

    def failing(self: Polisher, candidate: Candidate, *, near: bool = False) -> LinkageDesign:
        if not has_several_dyads(self.files[candidate.variant].model):  # type: ignore[arg-type]
            return polish(self, candidate, near=near)
        start = self.unpolished(candidate)
        if worse > 1.0:
            return replace(start, objective=worse * start.objective, status=Status.OPTIMAL)
        limits = (*start.validation.checks, Check("optimality (KKT residual)", False, 1.0, "<= 1e-06", ""))
        return replace(start, status=Status.STALLED, validation=replace(start.validation, checks=limits))

    monkeypatch.setattr(Polisher, "polish", failing)
    monkeypatch.setattr(Polisher, "from_feasible", lambda *_: iter(()))
    monkeypatch.setattr(task, "PART_STARTS", STARTS)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "worse"), [(12, 1.0), (13, 1e4)], ids=["Watt, stalled", "Stephenson, worse"])
def test_a_six_bar_is_never_worse_than_its_four_bar(monkeypatch: pytest.MonkeyPatch, seed: int, worse: float) -> None:
    planted(monkeypatch, worse)
    task = random_six_bar(seed, 12)
    part = contained_four_bar(task.file)
    assert part is not None
    four_bar = solve(part.file, starts=STARTS)
    assert four_bar.valid
    result = solve(task.file, starts=1)
    assert result.valid
    assert result.objective <= four_bar.objective * (1.0 + 1e-9)
    assert faults_of_six_bar(result.designs[0], task) == []
    document = result.to_dict()
    assert document["status"] == "feasible"
    assert not any(check["name"].startswith("optimality") for check in document["designs"][0]["validation"])


@pytest.mark.slow
def test_a_six_bar_that_cannot_repeat_its_four_bar_is_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second dyad is too short to meet its joints, the four-bar is free: the answer has one sentence about it."""
    planted(monkeypatch, 1.0)
    monkeypatch.setattr(SearchRounds, "explained", lambda _: None)  # which limits conflict is another question, of half a minute
    raw = copy.deepcopy(random_six_bar(13, 12).file.raw)
    raw["mechanism"]["links"]["other"]["length"] = "1 mm"
    raw["mechanism"]["links"]["one"]["length"] = {"bounds": ["1 mm", "2 mm"]}
    result = solve(read(raw), starts=1)
    assert not result.valid
    notes = [note for note in result.notes if "repeats its coupler curve" in note]
    assert len(notes) == 1
    assert "mm (rms)" in notes[0]


@pytest.mark.slow
def test_a_linkage_without_coupler_curves_is_noted() -> None:
    """The point of a lever on the frame moves on a circle."""
    raw = dict(random_six_bar(1).file.raw)
    raw["requirement"] = raw["requirement"] | {"point": "G"}
    result = solve(read(raw), starts=1)
    assert any("no four-bar within this linkage carries" in note for note in result.notes)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_four_bar_within_a_six_bar_has_its_own_limits_alone(seed: int) -> None:
    """Not those of points and joints that it lacks, nor of the machine; and not the tolerance of the path."""
    raw = copy.deepcopy(dict(random_six_bar(seed, 4).file.raw))
    own, other = ["20 deg", "160 deg"], ["10 deg", "170 deg"]
    raw["limits"] = {
        "transmission_angle": {"C": own, "G": other},
        "lid": {"region": "half-plane", "of": "G", "through": ["0 mm", "900 mm"], "direction": "180 deg", "side": "inside"},
        "size": {"quantity": "total length", "max": "9 m"},
    }
    lever = {"kind": "position", "output": "G.x", "at": "20 deg", "value": {"max": "9 m"}}
    raw["requirements"] = [raw.pop("requirement") | {"tolerance": "5 mm"}, lever]
    part = contained_four_bar(read(raw))
    assert part is not None
    assert part.file.raw["limits"] == {"transmission_angle": {"C": own}}
    assert "tolerance" not in part.file.raw["requirement"]
    links = raw["mechanism"]["links"]
    links["crank"]["length"] = {"equals": "0.4*one.length"}
    assert contained_four_bar(read(raw)) is None
