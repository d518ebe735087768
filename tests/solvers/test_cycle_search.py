"""The search for machines by their cycle: starting points in one sequence, both slow strokes, distinct designs, continua."""

from __future__ import annotations

import itertools
import math
import tomllib
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import optlink
from optlink.errors import InputError, Status
from optlink.optimization.cycle_signals import TracedCycle
from optlink.problem.file import ProblemFile, read
from optlink.solvers import multistart
from optlink.solvers.exchange import OrderedStarts
from optlink.tasks import search
from optlink.tasks.design import solve, validate
from optlink.tasks.results.design import SynthesisResult
from optlink.tasks.search import Polisher
from optlink.validation.check import Check

PUMP = """
title = "Offset pump"
[mechanism.ground]
A = ["0 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = { start = "40 mm", bounds = ["20 mm", "70 mm"] } }
rod = { joints = ["B", "C"], length = { start = "180 mm", bounds = ["120 mm", "260 mm"] } }
piston = { joints = ["C"] }
[mechanism.guides]
G = { slider = "piston", direction = "0 deg", through = "A", offset = { start = "0 mm", bounds = ["-60 mm", "60 mm"] } }
[mechanism.assembly]
C = "forward"
[bodies]
piston = { mass = "3 kg" }
[loads]
delivery = { on = "piston", force = "2 kN", acts = "opposing", stroke = "slow" }
[drive]
speed = "120 rpm"
[objective]
quantity = "torque"
[limits]
stroke = { quantity = "stroke", of = "piston", exactly = "90 mm" }
ratio = { quantity = "time ratio", of = "piston", min = 1.06 }
"""

LINKS = """
title = "Crank-rocker, every length free"
[mechanism.ground]
A = ["0 mm", "0 mm"]
D = [{ start = "200 mm", bounds = ["100 mm", "400 mm"] }, "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = { start = "60 mm", bounds = ["20 mm", "120 mm"] } }
coupler = { joints = ["B", "C"], length = { start = "190 mm", bounds = ["40 mm", "600 mm"] } }
rocker = { joints = ["D", "C"], length = { start = "120 mm", bounds = ["40 mm", "400 mm"] } }
[mechanism.assembly]
C = "left of B-D"
[drive]
speed = "60 rpm"
[objective]
quantity = "transmission angle"
of = "C"
measure = "least"
sense = "maximise"
[limits]
swing = { quantity = "stroke", of = "rocker", exactly = "60 deg" }
ratio = { quantity = "time ratio", of = "rocker", stroke = "forward", exactly = 1.15 }
most = { quantity = "transmission angle", of = "C", measure = "largest", max = "150 deg" }
"""


def problem(text: str, **changes: object) -> ProblemFile:
    return read(tomllib.loads(text), "machine").override({key.replace("__", "."): value for key, value in changes.items()})


@cache
def pump(**changes: object) -> SynthesisResult:
    return solve(problem(PUMP, **changes), starts=2)


# --- the slow stroke in a search -----------------------------------------------------------------------------------------


def rotations(result: SynthesisResult) -> dict[str, float]:
    """Crank rotation of each stroke, from the signs of the ordinary analysis alone [deg]."""
    assert result.best.analysis is not None
    velocity = result.best.analysis["piston.v_m_s"][:-1]
    share = float(np.mean(velocity > 0.0))
    return {"forward": 360.0 * share, "backward": 360.0 * (1.0 - share)}


@pytest.mark.slow
@pytest.mark.parametrize("speed", ["120 rpm", "-120 rpm"])
@pytest.mark.parametrize("stroke", ["forward", "backward"])
def test_a_time_ratio_with_a_direction_makes_that_stroke_the_slow_one(stroke, speed):
    ratio = {"quantity": "time ratio", "of": "piston", "stroke": stroke, "exactly": 1.2}
    result = solve(problem(PUMP, limits__ratio=ratio, drive__speed=speed), starts=1)
    assert result.valid
    computed = rotations(result)
    other = next(name for name in computed if name != stroke)
    assert computed[stroke] / computed[other] == pytest.approx(1.2, abs=0.03)
    assert result.best.cycle.complete
    assert result.to_dict()["strokes"]["piston slides"]["slow_stroke"] == stroke


@pytest.mark.slow
def test_both_slow_strokes_are_searched_from_a_start_that_has_none():
    """The start is centred: the answer is the better of the two machines whose offset is kept to one side."""
    sides = [["-60 mm", "-1 mm"], ["1 mm", "60 mm"]]
    one, other = (
        solve(problem(PUMP, mechanism__guides__G__offset={"start": f"{5 * k} mm", "bounds": side}), starts=1)
        for k, side in zip((-1, 1), sides, strict=True)
    )
    assert one.valid
    assert other.valid
    assert pump().valid
    assert pump().objective <= min(one.objective, other.objective) * (1.0 + 1e-7)
    assert pump().best.cycle.complete
    (record,) = (r for name, r in pump().to_dict()["strokes"].items() if name == "piston slides")
    assert record["slow_stroke"] == record["working_stroke"]


def test_a_load_of_the_slow_stroke_needs_one():
    """Where every machine is centred the validation says so, and the start is refused where nothing is free."""
    result = validate(problem(PUMP), {"G.offset": 0.0})
    assert not result.valid
    assert any("neither stroke is the slow one" in check.name for check in result.validation.checks)
    fixed = {"mechanism__guides__G__offset": "0 mm", "mechanism__links__crank__length": "45 mm"}
    with pytest.raises(InputError, match="neither stroke is the slow one"):
        problem(PUMP, **fixed, mechanism__links__rod__length="180 mm")


@pytest.mark.slow
def test_a_ratio_below_a_limit_is_that_of_the_slow_stroke_in_either_direction():
    """A largest ratio of the slow stroke holds in both directions: the quick-return of the other direction is no way out."""
    ratio = {"quantity": "time ratio", "of": "piston", "max": 1.02}
    low = {"quantity": "length", "of": "rod.length", "max": "150 mm"}
    offset = {"start": "20 mm", "bounds": ["-60 mm", "60 mm"]}
    changes = {"limits__ratio": ratio, "limits__rod": low, "mechanism__guides__G__offset": offset}
    result = solve(problem(PUMP, **changes, loads__delivery__stroke="forward"), starts=2)
    assert result.valid
    outcome = rotations(result)
    assert max(outcome.values()) / min(outcome.values()) <= 1.03


# --- more starting points ------------------------------------------------------------------------------------------------


def test_starting_points_of_a_smaller_number_come_first():
    trace = TracedCycle(problem(PUMP).spec, slow={"delivery": "forward"})
    few, more = (OrderedStarts(trace, 3, count).begun for count in (3, 9))
    assert {own[0].order.slow for own in few} == {own[0].order.slow for own in more}
    for own in few:
        (same,) = (other for other in more if other[0].order.slow == own[0].order.slow)
        assert [start.values for start in same[: len(own)]] == [start.values for start in own]


def test_random_starting_points_are_latin_hypercubes():
    """Each block has one point in each stratum of every coordinate, whatever the seed, and another seed has other points."""
    low, high = np.array([-2.0, 5.0, 0.0]), np.array([1.0, 5.5, 40.0])
    points, same, other = (
        np.array(list(itertools.islice(multistart.latin_hypercubes(low, high, seed), 2 * multistart.HYPERCUBE)))
        for seed in (7, 7, 8)
    )
    assert np.array_equal(points, same)
    assert not np.any(points == other)
    for block in np.split((points - low) / (high - low), 2):
        strata = np.sort(np.floor(block * multistart.HYPERCUBE), axis=0)
        assert np.array_equal(strata, np.tile(np.arange(multistart.HYPERCUBE)[:, None], (1, 3)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_more_starting_points_are_never_worse(seed):
    rng = np.random.default_rng(seed)
    load, mass = rng.uniform(0.5, 4.0), rng.uniform(1.0, 20.0)
    file = problem(
        PUMP,
        loads__delivery__force=f"{load} kN",
        bodies__piston__mass=f"{mass} kg",
        drive__speed=f"{rng.choice([-1, 1]) * rng.uniform(30.0, 300.0)} rpm",
        limits__ratio__min=float(rng.uniform(1.0, 1.15)),
    )
    computed = [solve(file, starts=count, seed=seed) for count in (1, 3, 8)]
    assert computed[-1].valid
    for few, more in itertools.pairwise(computed):
        assert (not more.valid, more.objective) <= (not few.valid, few.objective * (1.0 + 1e-9))
    usual = solve(file, seed=seed)
    assert usual.objective == computed[-1].objective


@pytest.mark.slow
def test_without_a_feasible_point_no_objective_is_searched(monkeypatch):
    """A stroke longer than any crank makes: the conflict is named although no local search of the objective ran."""
    monkeypatch.setattr(multistart, "solve_from", lambda *_, **__: pytest.fail("an objective was searched"))
    result = solve(problem(PUMP, limits__stroke__exactly="300 mm"), starts=3)
    assert not result.valid
    assert [item.key for item in result.conflict] == ["limits.stroke"]
    assert 140.0 < result.conflict[0].relaxed < 300.0  # twice the longest crank, and a little more by the offset


def begun(file: ProblemFile):
    """What refines the designs of a problem, its traced functions, its first starting point, and the end of a search there."""
    polisher = Polisher([file], "ipopt")
    trace = polisher.orders[0].trace
    start = OrderedStarts(trace, 0).begun[0][0]
    at = multistart.solution_at(polisher.of_start(0, start), polisher.of_start(0, start).x_of(start.values), "")
    return polisher, trace, start, replace(at, status=Status.STALLED)


def test_a_design_without_the_dead_centres_of_its_limits_is_refused():
    """A local search may end where the rocker turns fully: the NLP does not see it, the time ratio is not defined there."""
    polisher, trace, start, end = begun(optlink.load("shaper-design"))
    samples = OrderedStarts(trace, 0).samples(200)
    wrong = next(s.values for s in samples if s.structure is not None and trace.strokeless(s.structure))
    assert math.isnan(
        next(check.value for check in validate(optlink.load("shaper-design"), wrong).validation.checks if "ratio" in check.name)
    )
    assert polisher.over_orders(0, [end])[0].usable
    other = replace(end, design=dict(wrong), objective=0.5 * end.objective)
    refused, kept = polisher.over_orders(0, [end, other])
    assert refused.status is Status.INFEASIBLE
    assert "dead centres" in refused.message
    assert kept.design == start.values


# --- distinct designs ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_listed_optima_are_polished_and_none_is_below_the_result():
    result = pump()
    assert result.optima[0].objective == result.objective
    for optimum in result.optima:
        assert optimum.objective >= result.objective * (1.0 - 1e-9)
        proof = validate(result.problem, optimum.design)
        assert proof.valid  # also the others meet every limit where it is measured
        assert proof.objective == pytest.approx(optimum.objective, rel=1e-7)
    free = np.array([list(optimum.design.values()) for optimum in result.optima])
    for one, other in itertools.combinations(free, 2):
        assert np.max(np.abs(one - other)) > 1e-6


@pytest.mark.slow
def test_the_best_valid_design_is_the_result_and_a_better_optimum_is_named(monkeypatch):
    """A check that the best of two optima fails: the other one is the result."""
    file, honest = optlink.load("stroke-crank-rocker"), search.validate
    best, other = solve(file).optima

    def doubting(*given, **options):
        checked = honest(*given, **options)
        return checked.with_checks([Check("planted", checked.objective > 1.01 * best.objective, 1.0, "none", "")])

    monkeypatch.setattr(search, "validate", doubting)
    result = solve(file)
    assert result.valid
    assert result.objective == pytest.approx(other.objective, rel=1e-9)
    assert result.rejected is not None
    assert result.rejected.objective == pytest.approx(best.objective, rel=1e-9)
    assert any('fails the check "planted"' in note for note in result.notes)


@pytest.mark.slow
def test_a_scale_continuum_is_noted_and_listed_once():
    """Angles do not change with the scale of a linkage: all lengths together may be larger or smaller."""
    result = solve(problem(LINKS), starts=4)
    assert result.valid
    assert any("scaled together" in note for note in result.notes)
    assert len(result.optima) == 1
    assert result.optima[0].count >= 2
    fixed = solve(problem(LINKS, mechanism__links__coupler__length="150 mm"), starts=2)
    assert fixed.valid
    assert not any("scaled" in note or "continuum" in note for note in fixed.notes)
    assert fixed.objective == pytest.approx(result.objective, rel=1e-6)
    for factor in (0.97, 1.02):  # the independent route: the scaled machine measured
        scaled = {name: factor * value for name, value in result.best.values.items()}
        cycle = validate(problem(LINKS), scaled)
        assert cycle.objective == pytest.approx(result.objective, rel=1e-9)
        assert math.isfinite(cycle.objective)


@pytest.mark.slow
def test_a_single_optimum_is_no_continuum():
    assert not any("continuum" in note or "scaled" in note for note in pump().notes)
    assert optlink.load("press-toggle").model.free  # a machine whose lengths are held by loads and limits in millimetres


# --- the edge of an order of events ---------------------------------------------------------------------------------------

YOKE = """
title = "Scotch yoke against a spring that it reaches with a long crank"
[mechanism.ground]
A = ["0 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = { start = "68 mm", bounds = ["50 mm", "80 mm"] } }
block = { joints = ["B"] }
yoke = { joints = ["Y"] }
[mechanism.guides]
slot = { slider = "block", on = "yoke", direction = "90 deg" }
rail = { slider = "yoke", through = "A" }
[loads]
spring = { on = "yoke", force = { over = "s", at = ["60 mm", "90 mm"], values = ["0 N", "-300 N"] } }
[drive]
speed = "10 rad/s"
[objective]
quantity = "acceleration"
of = "Y"
"""


def test_a_row_of_a_load_table_that_the_slider_no_longer_reaches_ends_no_search():
    """The acceleration of the yoke is the crank times the square of the speed, whether it touches the spring at 60 mm or not."""
    result = solve(problem(YOKE), starts=1)
    assert result.valid
    assert result.design["crank.length"] == pytest.approx(0.05, rel=1e-6)
    assert result.objective == pytest.approx(0.05 * 10.0**2, rel=1e-6)


RAMP = """
title = "Slider against a table of forces, whose best design reaches fewer of its rows than the first one, in the quick stroke"
gravity = "9.81 m/s^2"
[mechanism.ground]
A = ["0 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = { bounds = ["20 mm", "90 mm"] } }
rod = { joints = ["B", "C"], length = { bounds = ["60 mm", "300 mm"] } }
slider = { joints = ["C"] }
[mechanism.guides]
G = { slider = "slider", through = "A", direction = "30 deg", offset = { bounds = ["-80 mm", "80 mm"] } }
[mechanism.assembly]
C = "backward"
[bodies]
crank = { mass = "1 kg", inertia = "uniform bar" }
rod = { mass = "2 kg", inertia = "uniform bar" }
slider = { mass = "4 kg" }
[loads.ramp]
on = "slider"
acts = "opposing"
stroke = "backward"
force = { over = "s", at = ["-200 mm", "-150 mm", "-100 mm"], values = ["3 kN", "1 kN", "0 kN"] }
[drive]
body = "crank"
speed = "-240 rpm"
[objective]
quantity = "torque"
measure = "peak"
[limits]
stroke = { quantity = "stroke", of = "slider", min = "100 mm" }
ratio = { quantity = "time ratio", of = "slider", min = 1.15 }
pressure = { quantity = "pressure angle", of = "C", max = "55 deg" }
"""


@pytest.mark.slow
def test_the_order_of_events_of_the_best_design_is_searched_with_both_slow_strokes():
    """Differential evolution with the slider-crank in closed form finds a design beside it; one order alone ends at 10.41 N m."""
    result = solve(problem(RAMP), starts=4)
    assert result.valid
    assert result.objective == pytest.approx(7.943908807, rel=1e-6)  # closed form, 2880 positions


def test_a_peak_at_a_row_of_a_load_table_is_measured_there():
    """The torque has a corner where the slider reaches -100 mm: between the positions it is 0.6 % larger than at any of them.

    The reference is the rate of the energy of this slider-crank in closed form, on both sides of the row (by Fourier series).
    """
    checked = validate(problem(RAMP), {"crank.length": 48.7870e-3, "rod.length": 83.1383e-3, "G.offset": 14.5462e-3})
    assert checked.objective == pytest.approx(7.97573, rel=2e-5)
    assert checked.best.analysis is not None
    largest = checked.best.analysis.figures["input.torque_Nm.max"], checked.best.analysis.figures["input.torque_Nm.min"]
    assert max(map(abs, largest)) == pytest.approx(checked.objective, rel=1e-9)


@pytest.mark.slow
def test_loads_do_not_divide_a_search_in_which_no_term_depends_on_forces():
    """With the load the search ends at 233.226 N; differential evolution with a closed form finds 231.03 N."""
    shaking = RAMP.replace('"torque"', '"shaking force"')
    result = solve(problem(shaking))
    assert result.valid
    assert result.objective == pytest.approx(231.0301, rel=1e-6)
    kinds = [{event.key[0] for event in TracedCycle(problem(text).spec).events} for text in (shaking, RAMP)]
    assert "corner" not in kinds[0]
    assert "corner" in kinds[1]


TOGGLE = {
    "objective": {"quantity": "end", "of": "ram", "stroke": "forward", "sense": "maximise"},
    "limits": {
        "stroke": {"quantity": "stroke", "of": "ram", "exactly": "65 mm"},
        "guide": {"quantity": "guide force", "of": "F", "measure": "peak", "max": "3.5 kN"},
    },
}


def test_a_design_whose_ram_reverses_more_often_is_searched_with_its_reversals(monkeypatch):
    """The toggle passes through its straight position: the ram makes two forward strokes, but the programme has one."""
    polisher, trace, start, end = begun(optlink.load("press-toggle").override(TOGGLE))
    searched = []
    monkeypatch.setattr(polisher, "_searched", lambda *given: searched.append(given) or end)
    straight = {"A.x": 0.4, "A.y": -0.1, "crank.length": 0.12, "rod.length": 0.402, "upper.length": 0.225, "lower.length": 0.38}
    for design, reversals, usable in ((start.values, 2, True), (straight, 4, False)):
        assert sum(trace.reversals(trace.structure(design)).values()) == reversals
        kept = polisher.over_orders(0, [replace(end, design=dict(design))])[0]
        assert kept.usable is usable
    ((_, _, own, order, design),) = searched
    assert design == straight
    assert sum(own.reversals(order).values()) == 4


def test_a_motion_that_only_comes_to_rest_does_not_reverse():
    _, trace, start, _ = begun(optlink.load("press-toggle").override(TOGGLE))
    structure = start.order
    reversal = next(k for k, event in enumerate(trace.events) if event.key[0] == "guide")
    assert structure.which.count(reversal) == 2
    for apart, more in ((1e-3, 0), (0.1, 2)):
        rest = replace(
            structure,
            which=(*structure.which, reversal, reversal),
            rising=(*structure.rising, False, True),
            angles=(*structure.angles, 7.0, 7.0 + apart),
        )
        assert sum(trace.reversals(rest).values()) == 2 + more


@pytest.mark.slow
def test_a_press_whose_toggle_passes_through_its_straight_position_is_valid():
    result = solve(optlink.load("press-toggle").override(TOGGLE), starts=2)
    assert result.valid
    assert result.objective == pytest.approx(-0.600442, abs=2e-5)  # it hardly changes where the toggle is nearly straight
