"""Sweeps whose programmes are not those of laws at fixed positions: rows of single searches, the same over workers and chunks."""

from __future__ import annotations

import csv
from dataclasses import replace

import pytest

import optlink
from optlink.execution.runner import pool
from optlink.studies import sweep, target_programme
from optlink.studies.batch_optima import FOLLOWED
from optlink.studies.grid import read_grid
from optlink.studies.reoptimise_task import SEARCHED, optimum_task
from optlink.units import in_si
from tests.tiers import mostly_slow

CASES = [
    ("crank-rocker", {"requirement.measure": "max"}, "limits.transmission_angle.max=125..140 deg:9"),
    ("law-slider-crank", {"requirement.measure": "max"}, "mechanism.guides.G.offset.max=20..40 mm:4"),
    ("function-sin", {}, "limits.link_ratio.max=2..8:4"),
    ("path-ellipse10", {"requirement.measure": "max"}, "limits.transmission_angle.min=30..45 deg:4"),
    ("motion-3-poses", {}, "limits.transmission_angle.min=20..40 deg:3"),
    ("transmission-optimal", {}, "limits.swing_angle=70..90 deg:5"),
    ("crank-rocker", {"requirement.measure": "max"}, "requirement.span=60..90 deg:4"),
    ("crank-rocker-robust", {}, "tolerances.coupler=0.5..1.5 mm:4"),
]


def rows_of(result):
    with open(result.table.path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize(
    ("name", "changes", "vary"),
    mostly_slow(CASES, CASES[0]),
)
def test_followed_rows_are_those_of_single_searches(name, changes, vary):
    """Three followed points, or fewer, are solved from the problem file alone: no row is worse. All others are searched."""
    problem = optlink.load(name, changes)
    rows = rows_of(sweep(problem, [vary], workers=1))
    key, _, _ = vary.partition("=")
    objective = next(column for column in rows[0] if column.startswith("objective"))
    assert {row["method"] for row in rows} == {SEARCHED, FOLLOWED}
    assert {row["valid"] for row in rows} == {"true"}
    followed = [row for row in rows if row["method"] == FOLLOWED]
    for row in followed[:: -(-len(followed) // 3)]:
        value, unit = next(iter(row.values())), vary.rpartition(" ")[2].partition(":")[0] if " " in vary else ""
        single = optlink.solve(problem.override({key: f"{value} {in_si(unit)[1]}" if unit else float(value)}), certify=False)
        objective_shown = single.problem.model.shown_objective(single.objective)
        shown = objective_shown.value * in_si(objective_shown.unit)[0]
        assert float(row[objective]) <= shown + 1e-6 * abs(shown) + 1e-9, (row, shown)


@pytest.mark.slow
def test_followed_rows_do_not_depend_on_workers():
    problem = optlink.load("crank-rocker", {"requirement.measure": "max"})
    vary = ["limits.transmission_angle.max=125..140 deg:5", "mechanism.frame=480..520 mm:4"]
    one, *others = [rows_of(sweep(problem, vary, workers=workers)) for workers in (1, 2, 3)]
    assert len(one) == 20
    assert {row["method"] for row in one} == {SEARCHED, FOLLOWED}
    assert all(rows == one for rows in others)


@pytest.mark.slow
def test_few_points_are_shared_by_processes_and_each_search_is_made_once():
    """Two blocks of six points: two searches in all, before eight chunks or fewer, and the same rows as without them."""
    problem = optlink.load("crank-rocker", {"requirement.measure": "max"})
    task = optimum_task(problem, read_grid(problem, ["limits.transmission_angle.max=125..140 deg:12"]), "ipopt", 100)
    assert [task.size(index) for index in range(task.chunks)] == [2] * 6
    with pool(workers=2) as runs:
        shared, cpu = task.prepared([0, 5], runs)
    assert [point for point, _ in sorted(shared.found)] == [2, 8]
    assert cpu > 0.0
    rows = [row for index in range(6) for row in task.lines(index)]
    with pytest.MonkeyPatch.context() as refused:
        refused.setattr("optlink.studies.reoptimise_task.solve", lambda *_: pytest.fail("a point is searched again"))
        assert [row for index in range(6) for row in shared.lines(index)] == rows


@pytest.mark.slow
def test_a_point_without_a_neighbour_is_searched():
    """Short couplers have no transmission angle within the limits: these rows say so, and the design beside them is searched."""
    problem = optlink.load("crank-rocker", {"requirement.measure": "max", "mechanism.coupler": {"bounds": ["100 mm", "900 mm"]}})
    rows = rows_of(sweep(problem, ["mechanism.coupler.max=110 mm, 120 mm, 420 mm, 430 mm"], workers=1))
    assert [(row["valid"], row["method"]) for row in rows] == [
        ("false", SEARCHED),
        ("false", SEARCHED),
        ("true", SEARCHED),
        ("true", FOLLOWED),
    ]


BATCHES = [
    ("crank-rocker", {"requirement.measure": "max"}, "limits.transmission_angle.max=125..140 deg:12"),
    pytest.param("path-crank-rocker", {}, "mechanism.crank=98..102 mm:12", marks=pytest.mark.slow),
    pytest.param("shaper-design", {}, "limits.guide.max=1480..1520 N:12", marks=pytest.mark.slow),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "changes", "vary"), BATCHES)
def test_optima_of_a_batch_are_those_of_the_exchange(name, changes, vary, monkeypatch):
    """Newton's method with the places of the peaks as unknowns, against rounds of searches with peaks that are found anew.

    The latter end at a largest error that is level within their tolerance.
    """
    problem = optlink.load(name, changes)
    task = replace(optimum_task(problem, read_grid(problem, [vary]), "ipopt", 12), chunk=12)
    with monkeypatch.context() as refused:
        refused.setattr(target_programme.TargetProgramme, "optimum", lambda *_, **__: pytest.fail("a point is not in the batch"))
        rows = task.lines(0)
    monkeypatch.setattr(target_programme.PeakProgramme, "solution", lambda *_: None)
    others = replace(task).lines(0)
    first, last = len(task.grid.axes), task.columns.index("status")
    for row, other in zip(rows, others, strict=True):
        assert row[last : last + 2] == other[last : last + 2] == ["optimal", "true"]
        numbers, expected = ([float(cell) for cell in cells[first:last]] for cells in (row, other))
        levelled = "requirement.measure" in changes
        assert numbers[-1] == pytest.approx(expected[-1], rel=1e-6 if levelled else 1e-9)
        assert numbers[-1] <= expected[-1] * (1.0 + 1e-9)
        assert numbers[:-1] == pytest.approx(expected[:-1], rel=1e-3 if levelled else 1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "changes", "vary"), BATCHES)
def test_rows_do_not_depend_on_the_batch(name, changes, vary):
    """One point at a time, five, and all at once, in any order of the chunks: the same text."""
    problem = optlink.load(name, changes)
    whole = replace(optimum_task(problem, read_grid(problem, [vary]), "ipopt", 12), chunk=12)
    rows = whole.lines(0)
    parts = replace(whole, chunk=5)
    assert [row for rows in [parts.lines(index) for index in (2, 1, 0)][::-1] for row in rows] == rows
    single = replace(whole, chunk=1)
    assert [single.lines(index) for index in (11, 3)] == [[rows[11]], [rows[3]]]
