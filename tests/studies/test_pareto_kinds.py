"""Pareto fronts of laws of dyads, points, poses, transmissions and several requirements: own formulas, single solves."""

from __future__ import annotations

import math

import numpy as np
import pytest

import optlink
from optlink.studies.fronts.design_objectives import design_objective, design_problem
from optlink.studies.fronts.epsilon_constraint import _with_known_designs, pareto
from optlink.studies.fronts.epsilon_ranges import RANGES, read_objectives
from optlink.studies.grid import column_name
from optlink.studies.reoptimise_task import optimum_task
from optlink.studies.sweep_task import FROM_KNOWN
from tests.studies.test_robust_kinds import no_neighbour_is_better, slide_errors

LAW = "law-slider-crank"


def slider_figure(most):
    """Sum of squares of a design of the slider-crank, infinite beyond its limits and a total length [m]."""

    def figure(design):
        crank, rod, offset = (design[name] for name in ("crank.length", "rod.length", "G.offset"))
        room = 1.0 + 1e-8
        aligned = (crank + abs(offset)) / rod > math.cos(math.radians(30.0)) * room
        if aligned or abs(offset) > 0.04 * room or rod < 0.02 / room or crank < 0.005 / room or crank + rod > most * room:
            return math.inf
        return float(np.sum(slide_errors(design) ** 2))

    return figure


@pytest.mark.slow
def test_a_front_of_a_law_of_dyads_over_the_total_length():
    """Every point is a local optimum of the law of the slider-crank with its length, by formulas of its own."""
    front = pareto(optlink.load(LAW), "error, total length=60..100 mm", points=3, workers=1)
    assert front.valid
    assert [objective.unit for objective in front.objectives] == ["mm^2", "mm"]
    assert len(front.points) == 3
    for point in front.points:
        design = dict(point.design)
        error, length = point.values
        assert length == pytest.approx(design["crank.length"] + design["rod.length"], rel=1e-9)
        figure = slider_figure(length)
        assert error == pytest.approx(figure(design), rel=1e-6)
        no_neighbour_is_better(figure, design, figure(design))


@pytest.mark.slow
def test_a_front_can_minimise_either_of_its_objectives():
    """The least total length with an rms error, and the least error with that length, are the same design."""
    front = pareto(optlink.load(LAW), "total length, error=0.3..0.6 mm", points=3, workers=1)
    assert front.valid
    assert front.objectives[front.minimised].name == "total length of the links"
    assert [(objective.name, objective.unit) for objective in front.objectives][1] == ("rms error", "mm")
    for length, rms in (point.values for point in front.points):
        single = pareto(
            optlink.load(LAW), f"error, total length={1e3 * length!r}..{1e3 * length + 1.0!r} mm", points=2, workers=1
        )
        least = min(single.points, key=lambda point: point.values[1])
        assert math.sqrt(least.values[0] / 31.0) == pytest.approx(rms, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "objectives", "key"),
    [
        ("transmission-optimal", "error, coupler=90..110 mm", "mechanism.coupler"),
        ("path-ellipse10", "error, limits.transmission_angle.min=105..115 deg", "limits.transmission_angle"),
        ("law-six-bar", "error, limits.transmission_angle.min=45..50 deg", "limits.transmission_angle"),
    ],
)
def test_points_of_a_front_are_single_optima(name, objectives, key):
    problem = optlink.load(name)
    front = pareto(problem, objectives, points=2, workers=1)
    assert front.valid
    costs = front.costs
    assert np.all(np.diff(costs[:, 0]) > 0.0)
    assert np.all(np.diff(costs[:, 1]) < 0.0)
    for error, other in (front.displayed(point.values) for point in front.points):
        raw = problem.at(key)
        pair = raw["bounds"] if isinstance(raw, dict) else raw or ["0 deg", "180 deg"]
        limited = [pair[0], f"{other!r} mm"] if key.startswith("mechanism") else [f"{other!r} deg", pair[1]]
        single = optlink.solve(problem.override({key: {"bounds": limited} if isinstance(raw, dict) else limited}), certify=False)
        factor = single.problem.spec.objective_display[0]
        assert error <= factor * single.objective * (1.0 + 1e-5)


@pytest.mark.slow
def test_the_ends_of_a_front_of_a_largest_error():
    """One end is the optimum without the limit, the other one the tightest limit, as for sums of squares."""
    problem = optlink.load("crank-rocker", {"requirement.measure": "max"})
    front = pareto(problem, "error, limits.transmission_angle.max", points=3, workers=1)
    assert front.valid
    free = optlink.solve(problem.override({"limits.transmission_angle": {"min": "45 deg"}}), certify=False)
    assert front.points[0].values[0] == pytest.approx(free.objective, rel=1e-5)
    squares = pareto(optlink.load("crank-rocker"), "error, limits.transmission_angle.max", points=2, workers=1)
    assert front.points[-1].values[1] == pytest.approx(squares.points[-1].values[1], rel=1e-3)


@pytest.mark.slow
def test_each_of_several_requirements_is_an_objective():
    problem = optlink.load("crank-rocker")
    tables = {key: value for key, value in problem.raw.items() if key not in ("requirement", "expected")}
    swing = {**problem.raw["requirement"], "name": "swing"}
    several = problem.with_tables({**tables, "requirements": [swing, {"kind": "transmission", "name": "push", "tolerance": 0.7}]})
    read = read_objectives(several, "swing.error, push.error")
    assert [objective.key for objective in read] == ["requirements.0.tolerance", "requirements.1.tolerance"]
    front = pareto(several, "swing.error, push.error=0.6..0.7", points=2, workers=1)
    assert front.valid
    for point in front.points:  # the cosine of a crank-rocker is largest where crank and frame are in line
        coupler, rocker = point.design["coupler"], point.design["rocker"]
        cosines = [(coupler**2 + rocker**2 - far**2) / (2.0 * coupler * rocker) for far in (0.4, 0.6)]
        assert max(map(abs, cosines)) == pytest.approx(point.values[1], rel=1e-6)
    assert front.points[0].values[0] < front.points[-1].values[0]


@pytest.mark.slow
def test_the_breadth_of_a_dwell_is_constrained_by_its_band():
    """The half breadth that is least for a length, and the length that is least for the breadth, belong to the same design."""
    problem = optlink.load("straight-line")
    front = pareto(problem, "total length, error=1..3 mm", points=2, workers=1)
    assert front.valid
    assert [objective.name for objective in front.objectives] == ["total length of the links", "breadth"]
    assert {axis.key for axis in front.grid.axes} == {"requirement.band"}
    for length, breadth in (front.displayed(point.values) for point in front.points):
        other = pareto(problem, f"error, total length={length!r}..{length + 1.0!r} mm", points=2, workers=1)
        least = min(other.points, key=lambda point: point.values[1])
        assert 2.0 * other.displayed(least.values)[0] == pytest.approx(breadth, rel=1e-5)


@pytest.mark.slow
def test_a_limit_of_the_file_on_a_quantity_is_replaced_along_the_front():
    limits = {"limits.size": {"quantity": "total length", "max": "1230 mm"}}
    front = pareto(optlink.load("crank-rocker", limits), "error, limits.size=1235..1245 mm", points=2, workers=1)
    assert front.objectives[0].unit == "rad^2"
    assert front.valid  # beyond the limit of the file, which one of them replaces
    for point in front.points:
        assert point.values[1] == pytest.approx(0.6 + point.design["coupler"] + point.design["rocker"], rel=1e-9)
    errors = [point.values[0] for point in front.points]
    for size, error in zip((1245.0, 1235.0), errors, strict=True):
        table = {"limits.size": {"quantity": "total length", "max": f"{size} mm"}}
        assert error == pytest.approx(optlink.solve(optlink.load("crank-rocker", table)).objective, rel=1e-6)


def test_one_of_several_weighted_requirements_is_minimised_alone():
    """Beside the error of the gripper, that of the arm is constrained or left open: no weighted sum of both is minimised."""
    problem = optlink.load("poses-and-law")
    names = [f"{part.prefix}error" for part in problem.spec.parts]
    (first, second) = read_objectives(problem, ", ".join(names))
    only = design_problem(problem, (first, second), 0, {1: "3 deg"}).spec
    assert [part.tolerance is None for part in only.parts] == [True, False]
    loose = design_problem(problem, (first, second), 0, {}).spec
    assert loose.parts[1].tolerance == pytest.approx(3.0)


def test_the_bound_of_an_error_stands_at_its_requirement_in_any_order_of_the_file():
    position = {"kind": "position", "at": "60 deg", "value": ["10 deg", "170 deg"]}
    raw = {key: value for key, value in optlink.load("crank-rocker").raw.items() if key not in ("requirement", "expected")}
    law = {**optlink.load("crank-rocker").raw["requirement"], "kind": "function"}
    problem = optlink.read({**raw, "requirements": [position, law]})
    objectives = [design_objective(problem, name, k) for k, name in enumerate(("function.error", "total length"))]
    bounded = design_problem(problem, objectives, 1, {0: "2 deg"})
    assert bounded.raw["requirements"][1]["tolerance"] == "2 deg"
    assert bounded.raw["requirements"][0] == problem.raw["requirements"][0]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["path-watt-leg", "function-sin", "least-torque", "motion-3-poses"])
def test_the_ends_of_a_front_are_feasible(name):
    """The front of an exact path of a fixed four-bar was "2 without a feasible design", and the tight end of a function too."""
    front = pareto(optlink.load(name), "error, limits.transmission_angle.max", points=3, workers=1)
    assert (front.valid_points, front.infeasible) == (front.solved, 0)


@pytest.mark.slow
def test_a_point_without_a_design_gets_the_one_of_a_tighter_limit():
    """A row whose search failed is that of a search from a neighbour; at the tightest limit no design is known."""
    problem = optlink.load("crank-rocker", {"mechanism.coupler": {"bounds": ["100 mm", "900 mm"]}})
    front = pareto(problem, "error, coupler=330..410 mm", points=3, workers=1)
    task = optimum_task(problem, front.grid, "ipopt", 3)
    rows = task.lines(0)

    def with_known(failed):
        damaged = [list(row) for row in rows]
        at = {name: k for k, name in enumerate(task.columns)}
        damaged[failed][at["valid"]], damaged[failed][at["status"]] = "false", "infeasible"
        for name in task.free:
            damaged[failed][at[column_name(name, task.free[name].display[1])]] = ""
        ranges = RANGES["function"](problem, front.objectives, front.minimised, 3, "ipopt")
        mended = _with_known_designs(task, ranges, damaged, ())
        return [dict(zip(task.columns, row, strict=True)) for row in mended]

    objective = task.objective_column
    for failed in (0, 1):
        row = with_known(failed)[failed]
        assert (row["valid"], row["status"], row["method"]) == ("true", "optimal", FROM_KNOWN)
        assert float(row[objective]) == pytest.approx(
            float(dict(zip(task.columns, rows[failed], strict=True))[objective]), rel=1e-6
        )
    assert [row["valid"] for row in with_known(2)] == ["true", "true", "false"]


def test_an_error_that_the_file_limits_is_minimised_alone():
    """The front of `error` minimised the torque of the file within its tolerance, and called it the error."""
    problem = optlink.load("least-torque")
    error, angle = read_objectives(problem, "error, limits.transmission_angle.max")
    only = design_problem(problem, (error, angle), 0, {1: "120 deg"}).spec
    assert (only.parts[0].tolerance, only.objective, only.composed) == (None, None, False)
