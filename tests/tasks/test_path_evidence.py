"""Evidence of searches for paths and poses: more starts are never worse, hits are counted after polishing."""

from __future__ import annotations

import importlib.util
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.linkage.fourbar import LENGTHS
from optlink.solvers.solution import SAME_OBJECTIVE
from optlink.synthesis.batch_search import Exploration, Searcher
from optlink.tasks.design import MISSED_CHANCE, SearchRounds, solve
from optlink.tasks.results.common import percent
from optlink.tasks.search import IDLE_ROUNDS, DesignCollection, Polisher
from tests import synthesis_oracle as oracle
from tests.stated import document, four_bar_section, free

MM = 1e3


def exact_task(seed: int, *, scrambled: bool = False) -> tuple[dict[str, Any], float]:
    """Nine points of a random crank-rocker's curve, as the untimed task, and the size of the curve [mm]."""
    rng = np.random.default_rng(seed)
    linkage = oracle.random_crank_rocker(rng)
    points = oracle.planted_path(linkage, np.sort(rng.uniform(0.0, 2.0 * math.pi, 9)))
    rows = oracle.rows_of(oracle.complex_points(points))
    if scrambled:
        rows = np.concatenate([rows[4::-1], rows[5:]])
    size = float(np.sqrt(np.mean(np.sum((rows - rows.mean(axis=0)) ** 2, axis=1))))
    place, length = free(-100.0 * size, 100.0 * size), free(0.01 * size, 100.0 * size)
    sizes = dict.fromkeys(("crank", "coupler", "rocker", "frame"), length)
    section = four_bar_section("either", **sizes, points={"P": [place, place]}, pivot=[place, place])
    return document(section, rows, {"link_ratio": [0.005, 200.0]}), size


@pytest.mark.slow
def test_four_seeds_agree_on_nine_exact_points() -> None:
    """Nine points of a four-bar's own curve: every seed finds a four-bar through all of them and reports that none is better."""
    raw, _ = exact_task(41)
    task = optlink.read(raw)
    for seed in range(4):
        result = solve(task, seed=seed, designs=1)
        assert result.designs[0].exact, seed
        assert result.evidence.missed == 0.0


@pytest.mark.slow
def test_seeds_agree_on_a_poor_fit_and_report_an_incomplete_search() -> None:
    """Nine points in an order that no four-bar follows: nearly all starts end out of order, and few reach the best value.

    Of seeds 0 and 1 the first finds it with 1380 starts; the second, searched here, has not found it by then.
    """
    raw, size = exact_task(7, scrambled=True)
    result = solve(optlink.read(raw), seed=1, designs=1)
    assert result.designs[0].error == pytest.approx(0.0066561042, rel=1e-3)  # of seed 0
    assert MM * result.designs[0].error > 1e-6 * size
    assert result.evidence.missed > MISSED_CHANCE
    notes = [note for note in result.notes if note.startswith("search incomplete: ")]
    assert len(notes) == 1
    assert f"search with starts={4 * result.starts}" in notes[0]


@pytest.mark.slow
def test_a_poor_fit_does_not_end_at_the_cost_of_candidates_out_of_order() -> None:
    """A candidate whose cost is far above the best design's may still lead to a better one, and is polished then."""
    raw, _ = exact_task(7, scrambled=True)
    files = optlink.read(raw).variants()
    collection = DesignCollection(Polisher(files, "ipopt"), 1)
    search = Searcher([file.spec for file in files], 0)
    collection.add(search.advance())
    assert collection.poor_fit
    best = collection.designs[0].error
    dear = [replace(candidate, cost=1e3) for candidate in search.advance().repaired[:2]]
    before = len(collection._ends)
    collection.add(Exploration(candidates=dear))
    assert len(collection._ends) == before + 2
    assert collection.designs[0].error <= best


@pytest.mark.slow
def test_reordered_candidates_are_refined_until_several_rounds_of_them_improve_nothing() -> None:
    """The rounds are those in which a reordered candidate is refined; an improvement by one makes them count anew."""
    files = optlink.load("path-closed18-untimed").variants()
    collection = DesignCollection(Polisher(files, "ipopt"), 3)
    search = Searcher([file.spec for file in files], 0)
    refined = []
    for _ in range(IDLE_ROUNDS + 2):
        result = search.advance()
        collection.add(result)
        refined.append(any(candidate in collection._ends for candidate in result.repaired))
    first = refined.index(True)
    assert refined[first:] == [True] * IDLE_ROUNDS + [False] * (len(refined) - first - IDLE_ROUNDS)
    result = search.advance()
    collection._idle = IDLE_ROUNDS - 1
    best, collection.designs = collection.designs[0], [replace(collection.designs[-1], objective=1.0)]
    collection.add(Exploration(repaired=result.repaired))
    assert collection.designs[0].objective < 1.0 - SAME_OBJECTIVE
    assert collection.designs[0].objective >= best.objective * (1.0 - SAME_OBJECTIVE)
    assert collection._idle == 0


def random_points(seed: int) -> dict[str, Any]:
    """Points or poses without an exact answer, limits on lengths and, every other time, on the transmission."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(6, 11))
    turn = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
    radius = 40.0 * np.exp(0.25 * rng.standard_normal(count))
    rows = np.column_stack([radius * np.cos(turn), 0.6 * radius * np.sin(turn)])
    if seed % 3 == 0:
        rows = np.column_stack([rows, np.cumsum(rng.uniform(-0.3, 0.3, count))])
    limits = {"link_ratio": [0.1, 10.0]} | ({"transmission_angle": ["30 deg", "150 deg"]} if seed % 2 else {})
    length, place = free(5.0, 300.0), free(-300.0, 300.0)
    sizes = dict.fromkeys(("crank", "coupler", "rocker", "frame"), length)
    section = four_bar_section("left", **sizes, points={"P": [place, place]}, pivot=[place, place])
    more = {"measure": "max"} if seed % 5 == 4 else {}
    return document(section, rows, limits, closed=True, **more)


def monotone(seed: int, numbers: tuple[int | None, ...]) -> None:
    task = optlink.read(random_points(seed))
    results = sorted((solve(task, starts=n, designs=1) for n in numbers), key=lambda result: result.starts)
    best = math.inf
    for result in results:
        objective = result.objective if result.valid else math.inf
        assert objective <= best * (1.0 + 1e-12), (seed, result.starts, objective, best)
        best = objective


@pytest.mark.slow
def test_more_starts_never_give_a_worse_path() -> None:
    monotone(1, (50, 100))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 28])
def test_more_starts_never_give_a_worse_path_or_motion(seed: int) -> None:
    """Nor is the default, of some thousand starts, worse than fewer, or better than more."""
    monotone(seed, (100, None) if seed == 3 else (50, None, 1500))


@pytest.mark.slow
def test_hits_are_counted_after_polishing_with_limits() -> None:
    """An active transmission limit, and the largest distance: many starts reach the polished value, none the unpolished one."""
    for measure in ("sum of squares", "max"):
        raw = random_points(1)
        raw["requirement"]["measure"] = measure
        result = solve(optlink.read(raw), starts=180, designs=1)
        assert result.valid
        assert any(limit.active for limit in result.designs[0].limits)
        assert result.hits >= 2, measure
        assert result.evidence.starts >= result.hits


@pytest.mark.slow
def test_a_search_states_the_chance_of_a_missed_optimum() -> None:
    task = optlink.read(random_points(1))
    short = solve(task, starts=1, designs=1)
    assert short.evidence.missed > MISSED_CHANCE
    assert any("chance that a better optimum was missed" in note for note in short.notes)
    whole = solve(task, designs=1)
    assert whole.evidence.missed < short.evidence.missed
    assert whole.to_dict()["evidence"]["missed"] == whole.evidence.missed


def test_a_small_chance_is_never_shown_as_none() -> None:
    assert [percent(x) for x in (0.0, 1e-9, 0.12, 0.999999, 1.0)] == ["0 %", "below 0.1 %", "12 %", "over 99 %", "100 %"]


def bean(tolerance: float) -> optlink.ProblemFile:
    """Nine points that a four-bar misses by up to 0.47 mm, with a tolerance [mm]."""
    places = [(20, 10), (17, 16), (10, 18), (3, 16), (0, 10), (3, 4), (8, 5), (12, 5), (17, 4)]
    points = [{"x": f"{x} mm", "y": f"{y} mm", "tolerance": f"{tolerance} mm"} for x, y in places]
    length, place = free(5.0, 80.0), free(-80.0, 80.0)
    section = four_bar_section("either", **dict.fromkeys(LENGTHS, length), points={"P": [place, place]}, pivot=[place, place])
    requirement = {"kind": "path", "point": "P", "points": points, "closed": True}
    limits = {"transmission_angle": ["30 deg", "150 deg"], "link_ratio": [0.05, 20.0]}
    return optlink.read({"mechanism": section, "requirement": requirement, "limits": limits})


@pytest.mark.slow
def test_a_search_ends_early_where_no_curve_comes_near_the_tolerances(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tolerances of all points bound the sum of squares; those that the best curve meets change nothing."""
    wide = solve(bean(5.0))
    assert wide.valid
    worst = float(np.max(wide.best.measured.distances))
    just = solve(bean(1.01 * MM * worst))
    assert just.valid
    assert just.objective == pytest.approx(wide.objective, rel=1e-9)
    assert just.starts <= 2 * wide.starts
    monkeypatch.setattr(SearchRounds, "explained", lambda _: None)  # which limits conflict is another question
    narrow = solve(bean(0.02))
    assert not narrow.valid
    assert narrow.starts < 1000
    assert narrow.objective == pytest.approx(wide.objective, rel=0.1)


def test_the_order_decides_only_between_more_than_three_points() -> None:
    relied = {}
    for name in ("motion-3-poses", "motion-5-poses", "path-closed18"):
        collection = DesignCollection(Polisher(optlink.load(name).variants(), "ipopt"), 3)
        collection._accepted = 0.1
        relied[name] = collection.in_order
    assert relied == {"motion-3-poses": 1.0, "motion-5-poses": 0.2, "path-closed18": 1.0}


@pytest.mark.slow
@pytest.mark.parametrize("timed", [True, False])
def test_points_with_six_decimals_end_a_search_like_exact_ones(timed: bool) -> None:
    """Twelve points of a four-bar's own curve: no search for a better design than the decimals allow."""
    rng = np.random.default_rng(12)
    angles = np.sort(rng.uniform(0.0, 2.0 * math.pi, 12))
    rows = oracle.planted_path(oracle.random_crank_rocker(rng), angles)
    found = []
    for digits in (13, 6):
        points = [{"x": f"{x:.{digits}f} mm", "y": f"{y:.{digits}f} mm"} for x, y in rows]
        if timed:
            turned = np.degrees(angles - angles[0])
            points = [point | {"crank": f"{turn:.{digits}f} deg"} for point, turn in zip(points, turned, strict=True)]
        raw = document(four_bar_section("either"), rows, {"link_ratio": [0.005, 200.0]})
        raw["requirement"]["points"] = points
        if timed:
            raw["requirement"] |= {"timing": "from start", "start": free(-180.0, 180.0, 0.0, "deg")}
        found.append(solve(optlink.read(raw)))
    exact, rounded = found
    assert exact.best.error < 1e-9 * exact.best.task.size
    assert 1e-9 * rounded.best.task.size < rounded.best.error < 1e-6 * rounded.best.task.size
    assert rounded.starts == exact.starts
    assert rounded.evidence.missed == 0.0
    assert not rounded.incomplete


def calibration() -> Any:
    """The module `benchmarks/missed_optima.py`."""
    path = Path(__file__).parents[2] / "benchmarks" / "missed_optima.py"
    spec = importlib.util.spec_from_file_location("missed_optima", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_starts_that_end_out_of_order_prolong_a_search() -> None:
    """Of five points, three in reverse order, few starts pass all in order; of points along a curve most do."""
    module, shares = calibration(), []
    for file in (module.problem(1), optlink.load("path-bean")):
        files = file.variants()
        collection, search = DesignCollection(Polisher(files, "ipopt"), 1), Searcher([file.spec for file in files], 0)
        for _ in range(3):
            exploration = search.advance()
            collection.add(exploration)
        share = exploration.accepted / exploration.starts
        assert collection.in_order == pytest.approx(min(1.0, 2.0 * share))
        shares.append(share)
    assert shares[0] < 0.4
    assert shares[1] > 0.5


def test_recorded_searches_that_told_two_per_cent_missed_no_more_than_four() -> None:
    """The record of `benchmarks/missed_optima.py`."""
    module = calibration()
    records = json.loads((Path(module.__file__).with_name("missed_optima_record.json")).read_text(encoding="utf-8"))
    told = [row for row in module.rates(records) if "told 0 to 2 %" in row[0]]
    assert len(told) == 2
    searches, missed = (sum(row[k] for row in told) for k in (1, 2))
    assert searches > 0
    assert missed <= 0.04 * searches
    page = " ".join((Path(module.__file__).parents[1] / "docs" / "synthesis.md").read_text(encoding="utf-8").split())
    assert f"of {searches} searches that told at most 2 %, in {len(records)} problems, {['none', 'one'][missed]} missed" in page


@pytest.mark.slow
def test_a_sample_of_the_calibration_repeats_its_record() -> None:
    module = calibration()
    records = json.loads((Path(module.__file__).with_name("missed_optima_record.json")).read_text(encoding="utf-8"))
    recorded = next(one for one in records if one["number"] == SAMPLE)
    one = module.searched(SAMPLE)
    assert one["starts"] == recorded["starts"]
    assert one["errors"] == pytest.approx(recorded["errors"], rel=1e-6)
    assert one["told"] == pytest.approx(recorded["told"], rel=0.1)  # a start or two may end elsewhere on another machine


SAMPLE = 2  # a problem of little time
