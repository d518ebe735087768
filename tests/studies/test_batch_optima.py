"""Optima of many points at once: those of single searches, the same bytes in any batch, and no worse optimum than next door."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import optlink
from optlink.execution.runner import apart
from optlink.optimization.nlp import BatchNLP
from optlink.optimization.programme import build
from optlink.solvers import multistart
from optlink.solvers.exchange import solve_semi_infinite
from optlink.studies import reoptimise_task, sweep
from optlink.studies.batch_optima import MAX_BLOCK_POINTS, Blocks, block_nodes
from optlink.studies.grid import Axis, Grid, read_grid
from optlink.studies.reoptimise_task import FOLLOWED, ReoptimiseTask, chunk_of
from optlink.validation import validate_batch

LIMIT = "limits.transmission_angle.max"
CHANGING = ["mechanism.crank=60..140 mm:12", "mechanism.coupler.max=402..440 mm:9"]  # the bound of the coupler, the angle, both


def task(vary: list[str], chunk: int = 100, **overrides) -> ReoptimiseTask:
    problem = optlink.load("crank-rocker", overrides)
    return ReoptimiseTask(problem, read_grid(problem, vary), chunk, "ipopt")


@pytest.mark.parametrize("measure", ["sum of squares", "rms", "max"])
def test_the_programme_of_a_batch_is_that_of_a_point(measure):
    limits = {"limits.transmission_over": "span", "limits.swing_angle": ["40 deg", "60 deg"]}
    if measure == "max":  # only the largest error at the rows of a table has a programme without exchange points
        rows = [3.0 * k for k in range(31)]
        table = {"phi": [f"{at} deg" for at in rows], "psi": [f"{at * at / 270.0!r} deg" for at in rows]}
        limits |= {"requirement.law": table, "requirement.span": None, "requirement.points": None}
    spec = optlink.load("crank-rocker", {"requirement.measure": measure, **limits}).spec
    nlp, rng = build(spec), np.random.default_rng(1)
    x = np.clip(nlp.x_start, 0.0, 1.0) * (1.0 + 0.02 * rng.random((5, len(nlp.variables))))
    p = nlp.p * (1.0 + 0.02 * rng.random((5, len(nlp.p))))
    multipliers = rng.normal(size=(5, len(nlp.lower)))
    batch = BatchNLP(nlp, spec.law)(x, p, multipliers)
    n = len(nlp.variables)
    for k in range(5):
        single = nlp.at(x[k], p[k])
        np.testing.assert_allclose(batch.gradient[k], single.gradient, rtol=1e-11, atol=1e-13)
        np.testing.assert_allclose(batch.values[k], [*x[k], *single.g], rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(batch.jacobian[k], [*np.eye(n), *single.jacobian], rtol=1e-11, atol=1e-13)
        np.testing.assert_allclose(batch.hessian[k], nlp.hessian(x[k], p[k], multipliers[k, n:]), rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("sizes", [(61,), (1000,), (20, 30), (2, 5000), (7, 1, 40), (12, 12, 12, 12)])
def test_blocks_cover_a_grid_with_few_points_each(sizes):
    grid = Grid(tuple(Axis(f"a{k}", "", tuple(map(float, range(size)))) for k, size in enumerate(sizes)))
    blocks = Blocks(grid)
    of = blocks.of(np.arange(grid.count))
    counts = np.bincount(of)
    assert len(counts) == math.prod(blocks.counts)
    assert 1 <= counts.min() <= counts.max() <= MAX_BLOCK_POINTS
    assert len(counts) <= 6 * math.ceil(
        grid.count / MAX_BLOCK_POINTS
    )  # at least as many searches as one for 100 points, not many more
    for block in range(0, len(counts), max(1, len(counts) // 7)):
        middle = blocks.middle(block)
        assert of[middle] == block
        assert [blocks.corners(block)[k] for k in (0, -1)] == [f(np.flatnonzero(of == block)) for f in (np.min, np.max)]
        places = np.array([grid.place(int(point)) for point in np.flatnonzero(of == block)])
        assert np.all(np.abs(np.median(places, axis=0) - grid.place(middle)) <= 0.5)
        assert all(block in blocks.neighbours(other) for other in blocks.neighbours(block))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vary", "overrides"),
    [
        (CHANGING, {}),
        ([f"{LIMIT}=81..135 deg:10", "mechanism.frame=430..560 mm:9"], {}),
        (["mechanism.rocker.max=210..260 mm:7", "mechanism.crank=90..110 mm:7"], {"requirement.measure": "max"}),
        (
            ["requirement.from=10..50 deg:7", f"{LIMIT}=110..140 deg:7"],
            {"requirement.from": "20 deg", "limits.transmission_over": "span"},
        ),
    ],
    ids=["bounds", "limits", "largest error", "span"],
)
def test_rows_are_those_of_single_searches(vary, overrides):
    if "mechanism.rocker.max" in vary[0]:
        overrides = {**overrides, "mechanism.rocker": {"start": "205 mm", "bounds": ["100 mm", "900 mm"]}}
    problem = optlink.load("crank-rocker", overrides)
    table = sweep(problem, vary, workers=1).columns
    study = task(vary, **overrides)
    rng, count = np.random.default_rng(2), study.grid.count
    assert len(set(table["active"])) > 1
    assert np.count_nonzero(table["method"] == FOLLOWED) > 0.5 * count
    for point in rng.choice(count, 12, replace=False).tolist():
        model = study.model(point)
        single = multistart.solve_from(build(model), build(model).x_start, "ipopt")
        if model.everywhere:  # the largest error counts over the whole span
            single = solve_semi_infinite(model, single, "ipopt")
        assert table["valid"][point]
        assert table[study.objective_column][point] == pytest.approx(single.objective, rel=1e-7 if model.everywhere else 1e-9)
        for name in ("coupler", "rocker"):
            size = pytest.approx(single.design[name], rel=1e-5 if model.everywhere else 1e-8)
            assert table[f"{name}_m"][point] == size
        assert table["active"][point] == "; ".join(reoptimise_task.active(single))


@pytest.mark.slow
def test_rows_do_not_depend_on_the_batch(monkeypatch):
    """One point at a time, seven, and all at once, in any order of the chunks: the same text."""
    vary = [*CHANGING[:1], f"{LIMIT}=75..135 deg:6"]  # no design below 80 deg
    whole = task(vary, 1000).lines(0)
    assert {row[5] for row in whole} == {"optimal", "infeasible"}
    assert len({row[-2] for row in whole if row[5] == "optimal"}) > 1
    monkeypatch.setattr(reoptimise_task, "BATCH", 5)
    parts = task(vary, 7)
    rows = {index: parts.lines(index) for index in reversed(range(parts.chunks))}
    assert [row for index in range(parts.chunks) for row in rows[index]] == whole
    single = task(vary, 1)
    assert [row for index in (0, 40, 71) for row in single.lines(index)] == [whole[index] for index in (0, 40, 71)]


def test_chunks_of_large_grids_are_larger():
    def chunk(*sizes: int) -> int:
        return chunk_of(Grid(tuple(Axis("a", "", tuple(map(float, range(size)))) for size in sizes)))

    assert [chunk(20), chunk(400), chunk(100, 100), chunk(1000, 1000)] == [100, 100, 1000, 10_000]


def test_a_wrong_row_of_a_batch_is_invalid(monkeypatch):
    """A coupler that is 0.1 mm too short, an objective that is wrong by 2e-6: the validator rejects these rows and no others."""
    study = task(["mechanism.frame=490..510 mm:30"])
    real = study.grid_search.optima

    def wrong(points):
        result = real(points)
        result.x[4, 0] -= 2e-4
        result.objective[20] *= 1.0 + 2e-6
        return replace(result)

    monkeypatch.setattr(study.grid_search, "optima", wrong)
    rows = study.lines(0)
    names = study.columns
    valid = [row[names.index("valid")] for row in rows]
    assert [point for point, word in enumerate(valid) if word != "true"] == [4, 20]
    assert "objective measured in motion" in rows[4][names.index("failed")]
    assert rows[20][names.index("failed")] == "objective measured in motion"


def test_a_limit_of_the_validator_alone_is_found_in_the_batch(monkeypatch):
    seen = []

    def recorded(task, designs, objective):
        seen.append((task, designs, objective))
        return validate_batch(task, designs, objective=objective)

    monkeypatch.setattr(reoptimise_task, "validate_batch", recorded)
    assert sweep(optlink.load("crank-rocker"), ["mechanism.frame=490..510 mm:30"], workers=1).valid
    ((task_, designs, objectives),) = seen
    assert len(designs["coupler"]) == len(objectives) == 30
    assert np.ptp(task_.mechanism.frame.value) == pytest.approx(0.02)


WIDE = {
    "requirement.from": {"start": "40 deg", "bounds": ["-180 deg", "180 deg"]},
    "limits.transmission_angle": ["20 deg", "160 deg"],
}


@pytest.mark.slow
def test_neighbours_correct_a_search_that_ends_in_a_worse_optimum(monkeypatch):
    """The problem has optima of 0.0012 and 0.36 rad^2; one search is led to the worse one, another finds no design."""
    vary = ["mechanism.crank=98..102 mm:21"]
    expected = task(vary, **WIDE).lines(0)
    monkeypatch.setattr("optlink.studies.batch_optima.MAX_BLOCK_POINTS", 7)
    study = task(vary, **WIDE)
    search, nlp = study.grid_search, study.programme.nlp
    assert search.blocks.counts == (3,)
    real = search.search

    def misled(point: int):
        good = real(point)
        if point == search.blocks.middle(1):
            ends = [
                multistart.solve_from(nlp, np.clip([0.8, 0.5, phi], nlp.x_low, nlp.x_high), "ipopt") for phi in (-2.5, -1.5, 2.5)
            ]
            bad = [end for end in ends if end.usable and end.objective > 100.0 * good.objective]
            assert bad
            return bad[0]
        return good

    monkeypatch.setattr(search, "search", misled)
    rows = study.lines(0)
    column = study.columns.index(study.objective_column)
    assert [float(row[column]) for row in rows] == pytest.approx([float(row[column]) for row in expected], rel=1e-9)
    assert len(search._others(np.array([1]), [[0, 2]])[0]) == 2
    assert search._others(np.array([0]), [[1]]) == [{1}]


@pytest.mark.slow
def test_random_starts_correct_searches_that_end_in_a_worse_optimum():
    """From a bad start every middle of a block leads to an optimum of 0.36 rad^2 or more; the best one is 0.0012 rad^2."""
    vary = ["mechanism.crank=98..102 mm:21"]
    far = {"start": "-150 deg", "bounds": ["-180 deg", "180 deg"]}
    expected = task(vary, **WIDE).lines(0)
    bad = task(vary, **(WIDE | {"requirement.from": far}))
    assert all(bad.grid_search.at_middle(block).objective > 0.3 for block in bad.grid_search.blocks)
    column = bad.columns.index(bad.objective_column)
    assert [float(row[column]) for row in bad.lines(0)] == pytest.approx([float(row[column]) for row in expected], rel=1e-9)


@pytest.mark.slow
def test_rows_at_the_end_of_a_sweep_can_have_another_branch():
    """Where the rocker is at its bound the best of two optima exists at the end of the sweep alone: a fifth to a third better."""
    vary = ["mechanism.crank=20..300 mm:15"]
    study = task(vary, **WIDE)
    rows, column = study.lines(0), study.columns.index(study.objective_column)
    for point in (0, 1, 7):
        nlp = build(study.model(point))
        ends = [multistart.solve_from(nlp, x, "ipopt") for x in multistart.starts(nlp, 12, 1)]
        best = multistart.best(ends)
        assert best.usable
        assert float(rows[point][column]) <= best.objective * (1.0 + 1e-6)


@pytest.mark.parametrize(("count", "workers"), [(10, 2), (11, 3), (1, 4), (0, 2)])
def test_workers_get_neighbouring_chunks(count, workers):
    order = apart(list(range(count)), workers)
    assert sorted(order) == list(range(count))
    if count >= 2 * workers:
        assert all(order[k + workers] == order[k] + 1 for k in range(workers * (count // workers - 1)))


# --- coarse blocks ---------------------------------------------------------------------------------------------------

FINE = ["mechanism.frame=450..550 mm:50", f"{LIMIT}=125..140 deg:52"]  # 2600 points, in coarse blocks of at most 200


@pytest.fixture(scope="module")
def fine_rows() -> list[list[str]]:
    return task(FINE, 2600).lines(0)


@pytest.mark.slow
def test_coarse_blocks_need_fewer_searches_for_the_same_optima(fine_rows, monkeypatch):
    monkeypatch.setattr(reoptimise_task, "coarse_block", lambda count: 0)
    study = task(FINE, 2600)
    assert study.grid_search.coarse is None
    every, names = study.lines(0), study.columns
    searched = [sum(row[names.index("method")] == reoptimise_task.SEARCHED for row in rows) for rows in (fine_rows, every)]
    assert searched[0] <= 0.6 * searched[1]
    numbers = [np.array([[float(cell) for cell in row[:5]] for row in rows]) for rows in (fine_rows, every)]
    np.testing.assert_allclose(numbers[0], numbers[1], rtol=1e-9)
    assert [row[5:-1] for row in fine_rows] == [row[5:-1] for row in every]


@pytest.mark.slow
def test_rows_of_coarse_blocks_do_not_depend_on_the_batch(fine_rows, monkeypatch):
    monkeypatch.setattr(reoptimise_task, "BATCH", 5)
    parts = task(FINE, 13)
    for index in (199, 0, 103):
        assert parts.lines(index) == fine_rows[13 * index : 13 * index + 13]


def test_the_prediction_of_a_block_is_close_to_its_optima():
    study = task(FINE)
    search = study.grid_search.coarse
    blocks = search.blocks
    points = np.flatnonzero(blocks.of(np.arange(study.grid.count)) == 7)
    result = search.optima(points)
    x, _ = search._predictions_of(np.array([7]))[7].at(np.unravel_index(points, blocks.shape))
    middle = search.at_middle(7).x
    assert np.max(np.abs(x - result.x)) < 1e-5 < 1e-3 < np.max(np.abs(middle - result.x))
    nodes = blocks.points(block_nodes(blocks.ends(7)))
    np.testing.assert_allclose(x[np.searchsorted(points, nodes)], result.x[np.searchsorted(points, nodes)], rtol=1e-9)


def test_a_block_with_two_active_sets_has_no_prediction():
    study = task(["mechanism.coupler.max=405..420 mm:150"])  # the bound of the coupler is active up to 412.865 mm
    search = study.grid_search
    assert set(search._predictions_of(np.array([*search.blocks]))) == {0, 2}
    assert block_nodes([(0, 28)]) is None
    assert [study.tolist() for study in block_nodes([(0, 40), (3, 3)])] == [[0, 4, 14, 26, 36, 40], [3]]


@pytest.mark.slow
def test_fine_blocks_are_searched_where_a_coarse_search_ends_elsewhere(monkeypatch):
    """One of 13 coarse searches ends at an optimum of 0.36 instead of 0.0012 rad^2."""
    vary = ["mechanism.crank=98..102 mm:2601"]
    study = task(vary, 2601, **WIDE)
    fine, nlp = study.grid_search, study.programme.nlp
    coarse = fine.coarse
    real, bad = coarse.search, coarse.blocks.middle(4)

    def misled(point: int):
        good = real(point)
        if point != bad:
            return good
        ends = [multistart.solve_from(nlp, np.clip([0.8, 0.5, phi], nlp.x_low, nlp.x_high), "ipopt") for phi in (-2.5, -1.5, 2.5)]
        return next(end for end in ends if end.usable and end.objective > 100.0 * good.objective)

    monkeypatch.setattr(coarse, "search", misled)
    points = np.arange(bad - 20, bad + 20)
    result = fine.optima(points)
    assert coarse.calm(np.arange(8)).tolist() == [True, True, True, False, False, False, True, True]
    assert len(fine._searches) > 0
    monkeypatch.setattr(coarse, "search", real)
    np.testing.assert_allclose(result.objective, task(vary, **WIDE).grid_search.optima(points).objective, rtol=1e-9)
