"""Terms over the cycle: derivatives against differences, values against the ordinary analysis, input that cannot be used."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

import optlink
from optlink.dynamics.columns import MotionColumns
from optlink.errors import InputError
from optlink.optimization.courses import TermCourse
from optlink.optimization.cycle_signals import TracedCycle
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import build
from optlink.problem.terms import Term, read_words
from optlink.validation.cycle import Cycle

CUT = {"of": "F"}
EVERY = {
    "peak_torque": {"quantity": "torque", "measure": "peak", "max": "2000 N*m"},
    "rms_torque": {"quantity": "torque", "measure": "rms", "max": "2000 N*m"},
    "mean_torque": {"quantity": "torque", "measure": "mean", "max": "2000 N*m"},
    "least_torque": {"quantity": "torque", "measure": "least", "min": "-2000 N*m"},
    "static_torque": {"quantity": "torque", "measure": "largest", "static": True, "max": "2000 N*m"},
    "static_rms": {"quantity": "torque", "measure": "rms", "static": True, "max": "2000 N*m"},
    "pin": {"quantity": "reaction", "of": "B", "max": "30 kN"},
    "pin_rms": {"quantity": "reaction", "of": "D", "on": "coupler", "measure": "rms", "max": "30 kN"},
    "static_pin": {"quantity": "reaction", "of": "C", "static": True, "max": "30 kN"},
    "guide": {"quantity": "guide force", **CUT, "max": "3 kN"},
    "guide_rms": {"quantity": "guide force", **CUT, "measure": "rms", "max": "3 kN"},
    "tilt": {"quantity": "guide moment", "of": "G", "measure": "largest", "max": "300 N*m"},
    "shaking": {"quantity": "shaking force", "max": "9 kN"},
    "shaking_rms": {"quantity": "shaking force", "measure": "rms", "max": "9 kN"},
    "rocking": {"quantity": "shaking moment", "measure": "rms", "max": "2 kN*m"},
    "speed": {"quantity": "velocity", "of": "D", "max": "9 m/s"},
    "jolt": {"quantity": "acceleration", "of": "E", "max": "90 m/s^2"},
    "jolt_rms": {"quantity": "acceleration", "of": "E", "measure": "rms", "max": "90 m/s^2"},
    "incline": {"quantity": "transmission angle", "of": "E", "measure": "least", "min": "20 deg"},
    "near": {"quantity": "slide", "of": "G", "measure": "least", "min": "10 mm"},
    "lever": {"quantity": "lever arm", **CUT, "max": "900 mm"},
    "lever_rms": {"quantity": "lever arm", **CUT, "measure": "rms", "max": "900 mm"},
    "stroke": {"quantity": "stroke", "of": "ram", "max": "900 mm"},
    "swing": {"quantity": "stroke", "of": "rocker", "max": "90 deg"},
    "reach": {"quantity": "stroke", "of": "D", "direction": "20 deg", "max": "900 mm"},
    "farthest": {"quantity": "end", "of": "ram", "stroke": "backward", "min": "-900 mm"},
    "quick": {"quantity": "time ratio", "of": "ram", "max": 3.0},
    "work": {"quantity": "work", "max": "9000 J"},
    "cut": {"quantity": "work", "of": "ram", "stroke": "backward", "max": "9000 J"},
    "swing_ratio": {"quantity": "time ratio", "of": "rocker", "max": 3.0},
    "long": {"quantity": "length", "of": "coupler.length", "max": "500 mm"},
}


def changed(**changes: object) -> optlink.ProblemFile:
    return optlink.load("shaper-design").override(changes)


@cache
def programme(speed: str = "64 rpm") -> NLP:
    file = changed(**{"limits": EVERY, "drive.speed": speed})
    task = file.spec
    start = {name: quantity.value for name, quantity in task.quantities.items() if quantity.free}
    start["C.x"], start["coupler.length"] = 0.013, 0.21  # no symmetry, which would hide a wrong derivative
    nlp = build(task, terms=TermCourse(task, start))
    nlp.x_start[:] = nlp.lifted(nlp.x_start)
    return nlp


def differences(nlp: NLP, x: np.ndarray, h: float = 1e-4) -> np.ndarray:
    columns = []
    for e in h * np.eye(len(x)):
        rows = [np.append(nlp.values(x + k * e, nlp.p)[1], nlp.values(x + k * e, nlp.p)[0]) for k in (-2, -1, 1, 2)]
        columns.append((rows[0] - 8.0 * rows[1] + 8.0 * rows[2] - rows[3]) / (12.0 * h))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("speed", ["64 rpm", pytest.param("-40 rpm", marks=pytest.mark.slow)])
def test_derivatives_of_every_term_are_those_of_differences(speed):
    nlp = programme(speed)
    point, expected = nlp.at(nlp.x_start, nlp.p), differences(nlp, nlp.x_start)
    assert point.finite
    assert {row.limit for row in nlp.rows} >= {f"limits.{name}" for name in EVERY}
    size = np.maximum(np.max(np.abs(expected[:-1]), axis=1, keepdims=True), 1.0)
    worst = np.max(np.abs(point.jacobian - expected[:-1]) / size, axis=1)
    assert {row.label for row, miss in zip(nlp.rows, worst, strict=True) if miss > 1e-6} == set()
    np.testing.assert_allclose(point.gradient, expected[-1], rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("speed", ["64 rpm", "-40 rpm"])
def test_values_of_every_term_are_those_of_the_analysis(speed):
    """Figures are met; of what a single position decides no position exceeds the analysis, and the densest comes near."""
    nlp = programme(speed)
    problem = nlp.terms.problem
    cycle = Cycle(problem, nlp.design(nlp.x_start))
    _, g = nlp.values(nlp.x_start, nlp.p)
    for bound in problem.bounds:
        rows = [(row.scale.to_display(value), row) for row, value in zip(nlp.rows, g, strict=True) if row.limit == bound.key]
        unit = optlink.units.factor(bound.interval.unit, bound.interval.kind) if bound.interval.kind else 1.0
        figures = np.array([value * unit for value, _ in rows])
        computed, measured = (np.min if bound.term.how == "least" else np.max)(figures), cycle.figure(bound.term)
        assert math.isfinite(measured), bound.name
        if not bound.term.extreme:
            np.testing.assert_allclose(computed, measured, rtol=1e-7, err_msg=bound.name)
        else:
            np.testing.assert_allclose(computed, measured, rtol=0.05, err_msg=bound.name)
            beyond = (measured - computed) if bound.term.how == "least" else (computed - measured)
            assert beyond <= 1e-9 * abs(measured), bound.name


def test_work_of_the_stroke_and_mean_torque_are_those_of_the_cutting_force():
    """Independent of the dynamics: 5880 N along the stroke, which is what the drive gives in a revolution."""
    nlp = programme()
    stroke = 5880.0 * Cycle(nlp.terms.problem, nlp.design(nlp.x_start)).figure(nlp.terms.problem.limits.named["stroke"])
    _, g = nlp.values(nlp.x_start, nlp.p)
    computed = {row.limit: row.scale.to_display(value) for row, value in zip(nlp.rows, g, strict=True)}
    assert computed["limits.work"] == pytest.approx(stroke, rel=1e-8)
    assert computed["limits.mean_torque"] == pytest.approx(stroke / (2.0 * math.pi), rel=1e-8)


def test_static_torque_by_virtual_work():
    """Without inertia the torque is the cutting force and the weights times their velocities over that of the crank."""
    nlp = programme()
    trace, x = nlp.terms.trace, nlp.x_start
    machine = trace.problem.machine(nlp.design(x))
    at = np.linspace(0.3, 2.5, 7)  # in the cutting stroke
    moving = machine.moving(at, trace.speed)
    power = -5880.0 * np.abs(moving.velocity("E")[0])
    rocker, coupler = (0.5 * (moving.velocity(a)[1] + moving.velocity(b)[1]) for a, b in (("C", "D"), ("D", "E")))
    power = power - 9.8 * (20.0 * rocker + 3.0 * coupler)
    senses = np.asarray(trace.sensed([*trace.inputs(nlp.design(x)), 1.4])).ravel()
    static = trace.signals(*trace.inputs(nlp.design(x)), at, *senses)[sum(trace.widths[: trace.cyclic.index(_term(trace))])]
    np.testing.assert_allclose(static, -power / trace.speed, rtol=1e-10)


def _term(trace: TracedCycle) -> object:
    return next(term for term in trace.cyclic if term.static and term.how == "largest")


def test_a_wrong_direction_of_the_cutting_force_is_detected():
    nlp = programme()
    trace = nlp.terms.trace
    known, at = trace.inputs(nlp.design(nlp.x_start)), 1.4
    senses = np.asarray(trace.sensed([*known, at])).ravel()
    good, bad = (trace.signals(*known, np.array([at]), *(sign * senses))[0, 0] for sign in (1.0, -1.0))
    assert abs(good - bad) > 100.0


@pytest.mark.parametrize(
    "words",
    [
        "rms reaction at B on block",
        "maximise stroke of ram",
        "work in the forward stroke of ram",
        "peak static torque",
        "rms shaking moment about A from 300 to 420 deg",
        "peak pressure angle",
        "end of the backward stroke of G along 30 deg",
    ],
)
def test_the_words_of_a_term_are_read_to_that_term(words):
    keys = read_words(words)
    way = keys.pop("sense", "")
    assert f"{way} {Term.model_validate(keys)}".strip() == words


@pytest.mark.parametrize(("point", "place"), [("A", (0.0, 0.0)), (["30 mm", "-20 mm"], (0.03, -0.02)), (None, (0.0, 0.0))])
def test_a_shaking_moment_about_another_point(point, place):
    """Traced and measured, it is minus the moment of m a of a mass in the middle of the coupler, by differences of its places."""
    goal = {"quantity": "shaking moment", "measure": "rms"} | ({"about": point} if point else {})
    file = swinging(50.0, "-5*theta").override({"bodies.coupler": {"mass": "2 kg", "inertia": "1e-9 kg*m^2"}, "objective": goal})
    machine, speed, step = file.model.machine(), file.model.drive.speed.value, 1e-4
    angles = np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)

    def centre(at: np.ndarray) -> np.ndarray:
        moving = machine.moving(at, speed)
        return np.mean([moving.position(joint) for joint in "BC"], axis=0)

    before, (x, y), after = (centre(angles + turned) for turned in (-step, 0.0, step))
    ax, ay = (before - 2.0 * np.array([x, y]) + after) / step**2 * speed**2
    moment = -2.0 * ((x - place[0]) * ay - (y - place[1]) * ax)
    trace = TracedCycle(file.model)
    traced = trace.signals(*trace.inputs({}), angles)[0]
    np.testing.assert_allclose(traced, moment, rtol=0.0, atol=1e-5 * float(np.max(np.abs(moment))))
    assert Cycle(file.model, {}).figure(file.model.goals[0]) == pytest.approx(np.sqrt(np.mean(moment**2)), rel=1e-5)


def test_friction_is_refused_if_forces_are_requested():
    with pytest.raises(InputError, match="friction"):
        changed(**{"mechanism.guides.F.friction": 0.1})


def swinging(start: float, torque: str) -> optlink.ProblemFile:
    """A crank-rocker with a torque over the angle of its rocker; its frame, free, has a direction [deg] at the start."""
    links = {"crank": {"joints": ["A", "B"], "length": "40 mm"}, "coupler": {"joints": ["B", "C"], "length": "290 mm"}}
    links["rocker"] = {"joints": ["D", "C"], "length": "160 mm"}
    at = [f(math.radians(start)) * 300.0 for f in (math.cos, math.sin)]
    free = [{"start": f"{part!r} mm", "bounds": ["-400 mm", "400 mm"]} for part in at]
    raw = {
        "mechanism": {"ground": {"A": ["0 mm", "0 mm"], "D": free}, "links": links, "assembly": {"C": "left of B-D"}},
        "loads": {"spring": {"on": "rocker", "torque": {"expression": torque, "unit": "N*m"}}},
        "drive": {"speed": "60 rpm"},
        "objective": {"quantity": "torque"},
    }
    return optlink.read(raw)


@pytest.mark.parametrize(("start", "end"), [(50.0, 60.0), (60.0, 50.0), (90.0, 75.0)])
def test_a_torque_over_theta_is_that_of_every_design_that_a_search_passes(start, end):
    """At 60 degrees of the frame, not at 50, the rocker swings across 180 degrees from +x, where theta must not jump."""
    file = swinging(start, "-5*theta")
    x, y = (f(math.radians(end)) * 0.3 for f in (math.cos, math.sin))
    design = {"D.x": x, "D.y": y}
    trace = TracedCycle(file.model)
    angles = np.linspace(0.0, 2.0 * np.pi, 361)
    torque = trace.signals(*trace.inputs(design), angles)[0]
    alone = Cycle(file.model, design).machine.moving(angles, file.model.drive.speed.value)
    np.testing.assert_allclose(torque, MotionColumns(alone)["input.torque_Nm"], atol=1e-9)


@pytest.mark.parametrize(("end", "serves"), [(60.0, True), (75.0, False), (150.0, False)])
def test_a_trace_does_not_serve_a_design_whose_swing_counts_from_another_turn(end, serves):
    """At 75 degrees of the frame the middle of the swing is beyond 180 degrees, where theta is negative; at 150 it is far off."""
    file = swinging(50.0, "-5*theta")
    design = dict(zip(("D.x", "D.y"), (f(math.radians(end)) * 0.3 for f in (math.cos, math.sin)), strict=True))
    assert TracedCycle(file.model).serves(design) is serves
    assert TracedCycle(file.model, design).serves(design)


@pytest.mark.slow
def test_a_search_crosses_the_direction_where_theta_jumps():
    """The best direction of the frame turns with the free angle of a spring, and its torque stays the same."""
    beyond, beside = (optlink.solve(swinging(50.0, torque), starts=1) for torque in ("-5*(theta + 2.5)", "-5*(theta - 2.5)"))
    assert beyond.valid
    assert beside.valid
    assert beyond.objective == pytest.approx(beside.objective, rel=1e-6)
