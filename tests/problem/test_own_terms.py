"""Objectives and limits from functions: the same optimum as the quantities of optlink, and sentences for what is wrong."""

from __future__ import annotations

import numpy as np
import pytest

import optlink
from optlink import InputError
from optlink.execution.runner import known_here
from optlink.problem.terms import QuantityType


def test_an_own_objective_and_limit_give_the_optimum_of_the_quantities_that_they_repeat():
    @optlink.objective(unit="N m", measure="rms")
    def drive_torque(machine, reactions):
        return reactions.torque

    @optlink.limit(unit="m/s", max=3.5)
    def ram_speed(machine):
        return machine.slides["F"][1]

    mine = {**drive_torque.changes, **ram_speed.changes}
    speed = {"quantity": "velocity", "of": "E", "measure": "peak", "max": "3.5 m/s"}
    same = {"objective": {"quantity": "torque", "measure": "rms"}, "limits.ram_speed": speed}
    found, other = (optlink.solve(optlink.load("shaper-design", changes), starts=1) for changes in (mine, same))
    assert found.valid
    assert found.objective == pytest.approx(other.objective, rel=1e-8)
    (one, two) = (
        next(check for check in result.best.validation.checks if check.name.startswith("ram_speed: "))
        for result in (found, other)
    )
    assert (one.name, one.limit, one.unit) == ("ram_speed: largest ram speed", "<= 3.5", "m/s")
    assert one.value == pytest.approx(two.value, rel=1e-6)


def test_a_cell_that_runs_again_replaces_its_function():
    for factor in (1.0, 2.0):

        @optlink.objective(unit="N m", measure="peak")
        def doubled(machine, reactions, factor=factor):
            return factor * reactions.torque

    plain = {"objective": {"quantity": "torque", "measure": "peak"}}
    values = [
        optlink.validate(optlink.load("shaper-design", changes), STARTING).objective for changes in (doubled.changes, plain)
    ]
    assert values[0] == pytest.approx(2.0 * values[1])


STARTING = {"C.x": 0.0, "C.y": -0.275, "crank.length": 0.125, "rocker.length": 0.55, "coupler.length": 0.1375, "F.y": 0.275}


def test_a_decorated_function_can_still_be_called():
    @optlink.limit(unit="deg", min=10)
    def half(angle):
        return 0.5 * angle

    assert half(np.pi) == pytest.approx(np.pi / 2.0)
    assert half.changes == {"limits.half": {"quantity": "half", "measure": "least", "min": "10.0 deg"}}


@pytest.mark.parametrize(
    ("decorator", "words"),
    [
        (lambda: optlink.objective(unit="parsec"), '"parsec" is not a unit'),
        (lambda: optlink.limit(unit="deg"), "a limit has one bound"),
        (lambda: optlink.limit(unit="deg", min=1, max=2), "a limit has one bound"),
        (lambda: optlink.objective(unit="N m"), "optlink has a quantity of this name"),
    ],
)
def test_a_faulty_decorator_is_refused_in_a_sentence(decorator, words):
    def torque(machine, reactions):
        return reactions.torque

    with pytest.raises(InputError, match=words):
        decorator()(torque)
    with pytest.raises(InputError, match=f"{words}|only a function with a name"):
        decorator()(lambda machine: 1.0)


def lacking(machine):
    return machine.nothing


def choosing(machine):
    return 1.0 if machine.slides["F"][1] > 0.0 else 2.0


def several(machine):
    return machine.slides["F"]


def misspelt(machine):
    return machine.state("rokcer").angular_rate


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lacking, r"lacking: .* in line \d+: AttributeError: .* 'nothing'\. Known: .*slides"),
        (choosing, r"choosing: .* in line \d+: RuntimeError: .*truth value.* without if"),
        (several, r"several: this function returns a tuple\. Return one number"),
        (misspelt, r"misspelt: .* in line \d+: the machine has no 'rokcer'\. Did you mean \"rocker\""),
    ],
)
def test_a_function_that_fails_is_named_with_its_line(function, words):
    term = optlink.objective(measure="rms")(function)
    with pytest.raises(InputError, match=words):
        optlink.solve(optlink.load("shaper-design", term.changes), starts=1)


def test_an_integrand_with_kinks_is_measured_to_its_own_accuracy():
    """Sums over evenly spaced positions have few digits there; the trapezoidal rule with many more is the oracle."""

    @optlink.objective(unit="W", measure="mean")
    def friction_loss(machine, reactions):
        return 0.05 * abs(reactions.guides["G"].normal) * abs(machine.slides["G"][1])

    free = {
        "mechanism.links.rod.length": {"start": "160 mm", "bounds": ["90 mm", "260 mm"]},
        "mechanism.guides.G.through": ["0 mm", {"start": "0 mm", "bounds": ["-25 mm", "25 mm"]}],
        "mechanism.guides.G.friction": None,
    }
    result = optlink.solve(optlink.read(optlink.new("pump")).override(free | friction_loss.changes))
    assert (result.valid, result.status) == (True, optlink.Status.OPTIMAL), result.notes
    columns = optlink.analyze(result.machine, points=20000)
    values = 0.05 * np.abs(columns["G.normal_N"]) * np.abs(columns["piston.v_m_s"])
    assert result.objective == pytest.approx(np.mean(values[:-1]), rel=1e-4)


def test_a_bound_with_its_own_unit():
    @optlink.limit(unit="mm", max="0.03 m")
    def travel(machine):
        return machine.slides["F"][0]

    assert travel.changes["limits.travel"]["max"] == "0.03 m"
    with pytest.raises(optlink.InputError, match=r'max = "30 deg": not a finite value .* "45 mm"'):
        optlink.limit(unit="mm", max="30 deg")


def test_own_functions_stay_in_their_process(tmp_path):
    @optlink.objective(unit="N m", measure="rms")
    def rms_effort(machine, reactions):
        return reactions.torque

    problem = optlink.load("shaper-design", rms_effort.changes)
    with pytest.raises(InputError, match=r"other processes do not know your function rms effort\. Leave the option out"):
        optlink.solve(problem, starts=1, workers=2)
    with pytest.raises(InputError, match=r"workers = 2: other processes"):
        optlink.studies.sweep(problem, ["gravity=9.8..9.9 m/s^2:2"], workers=2)
    assert known_here(problem, {}) == {"workers": 1}
    assert known_here(optlink.load("shaper-design"), {}) == {}
    result = optlink.validate(problem, STARTING)
    result.write(tmp_path)
    assert optlink.read_result(tmp_path).objective == result.objective
    forgotten = QuantityType.registry.pop("rms effort")
    with pytest.raises(InputError, match=r'objective\.quantity = "rms effort": .* run its cell$'):
        optlink.read_result(tmp_path)
    QuantityType.registry["rms effort"] = forgotten
