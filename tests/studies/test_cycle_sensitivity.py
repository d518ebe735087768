"""What moves the optimum of a machine: against machines searched again, laws of scaling, and moves of the whole machine."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import tomli_w
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.errors import InputError
from optlink.studies import sensitivity as sensitivity_module
from optlink.studies.sensitivity import of_solution, sensitivities as sensitivities_in_si
from optlink.tasks.design import solve
from tests.solved import once, solution


class Displayed:
    """A result whose rows are in display units, in which these tests state what they expect."""

    def __init__(self, result):
        self.result = result

    def __getitem__(self, key):
        return self.result.displayed[key]

    def __getattr__(self, name):
        return getattr(self.result.displayed if name in ("rows", "moving") else self.result, name)


def sensitivities(*arguments, **options):
    return Displayed(sensitivities_in_si(*arguments, **options))


PUMP = {
    "title": "Pump on an inclined guide",
    "gravity": "9.81 m/s^2",
    "mechanism": {
        "ground": {"A": ["0 mm", "5 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": {"start": "42 mm", "bounds": ["20 mm", "80 mm"]}},
            "rod": {"joints": ["B", "C"], "length": {"start": "200 mm", "bounds": ["100 mm", "400 mm"]}},
            "ram": {"joints": ["C"]},
        },
        "guides": {
            "G": {
                "slider": "ram",
                "on": "frame",
                "through": ["0 mm", {"start": "0 mm", "bounds": ["-30 mm", "30 mm"]}],
                "direction": "3 deg",
            }
        },
        "assembly": {"C": "forward"},
    },
    "bodies": {
        "crank": {"mass": "1 kg", "inertia": "uniform bar"},
        "rod": {"mass": "1.5 kg", "inertia": "0.004 kg*m^2"},
        "ram": {"mass": "4 kg"},
    },
    "loads": {"pumping": {"on": "ram", "force": "900 N", "acts": "opposing", "stroke": "forward"}},
    "drive": {"speed": "150 rpm"},
    "objective": {"quantity": "torque", "measure": "peak"},
    "limits": {
        "stroke": {"quantity": "stroke", "of": "ram", "exactly": "80 mm"},
        "guide": {"quantity": "guide force", "of": "G", "measure": "peak", "max": "180 N"},
        "room": {"quantity": "length", "of": "rod.length", "max": "260 mm"},
    },
}


@pytest.fixture(scope="module")
def pump():
    return Displayed(once("sensitivities of the pump", lambda: sensitivities_in_si(optlink.read(PUMP), starts=2)))


@pytest.fixture(scope="module")
def shaper():
    return Displayed(once("sensitivities of the shaper", lambda: sensitivities_in_si(optlink.load("shaper-design"), starts=2)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "value", "unit"),
    [
        ("loads.pumping.force", 900.0, "N"),
        ("bodies.ram.mass", 4.0, "kg"),
        ("bodies.rod.inertia", 0.004, "kg*m^2"),
        ("drive.speed", 150.0, "rpm"),
        ("gravity", 9.81, "m/s^2"),
        ("limits.stroke.exactly", 80.0, "mm"),
        ("limits.guide.max", 180.0, "N"),
        ("mechanism.guides.G.direction", 3.0, "deg"),
    ],
)
def test_derivatives_agree_with_reoptimised_machines(pump, key, value, unit):
    step = 2e-3 * value
    low, high = (solve(optlink.read(PUMP).override({key: f"{value + way!r} {unit}"}), starts=1) for way in (-step, step))
    assert low.valid
    assert high.valid
    row = pump[key]
    assert row.objective == pytest.approx((high.objective - low.objective) / (2.0 * step), rel=2e-5)
    for name in ("crank.length", "G.y"):
        moved = 1e3 * (high.design[name] - low.design[name]) / (2.0 * step)
        assert row.design[name] == pytest.approx(moved, rel=2e-3, abs=2e-4 / step)


@pytest.mark.slow
def test_a_limit_of_a_length_moves_the_length(pump):
    row = pump["limits.room.max"]
    assert row.design["rod.length"] == pytest.approx(1.0, abs=1e-12)
    assert row.objective < 0.0


@pytest.mark.slow
def test_moving_the_pivot_is_equivalent_to_moving_the_guide(pump):
    """Along the guide nothing changes; across it, what lies on the machine goes along."""
    assert pump["mechanism.ground.A.y"].design["G.y"] == pytest.approx(1.0, abs=1e-9)
    assert pump["mechanism.ground.A.x"].design["G.y"] == pytest.approx(-math.tan(math.radians(3.0)), rel=1e-9)
    assert pump["mechanism.guides.G.through.x"].design["G.y"] == pytest.approx(math.tan(math.radians(3.0)), rel=1e-9)
    for key in ("mechanism.ground.A.x", "mechanism.ground.A.y", "mechanism.guides.G.through.x"):
        assert abs(pump[key].objective) < 1e-9
        assert abs(pump[key].design["crank.length"]) < 1e-9


@pytest.mark.slow
def test_a_translated_shaper_has_the_same_sensitivities(shaper):
    row = shaper["mechanism.ground.A.x"]
    assert row.design == pytest.approx({"C.x": 1.0} | dict.fromkeys(set(row.design) - {"C.x"}, 0.0), abs=1e-7)
    assert not shaper["mechanism.guides.F.through.x"].moves
    assert shaper.notes == ()  # although the peaks lie on positions of the programme


@pytest.mark.parametrize("name", ["pump", pytest.param("shaper", marks=pytest.mark.slow)])
def test_forces_scale_together(name, request):
    """What is minimised is linear in loads and limits of forces, and in masses times gravity or the square of the speed."""
    result = request.getfixturevalue(name)

    def weighed(keys):
        return sum(row.parameter.value * row.objective for row in result.rows if row.parameter.key.startswith(keys))

    loads = weighed(("loads.", "limits.guide"))
    masses, gravity, speed = weighed("bodies."), weighed("gravity"), 0.5 * weighed("drive.speed")
    objective = result.solution.objective
    assert masses == pytest.approx(gravity + speed, rel=1e-6)
    assert loads + gravity + speed == pytest.approx(objective, rel=1e-7)


def test_the_crank_angles_of_events_do_not_limit_a_range_of_validity(pump):
    """Their bounds only enclose the search: ranges ended at "the bound of end of a stroke 6"."""
    system = sensitivity_module.KKTSystem(pump.solution)
    assert {system.nlp.variables[k].name for k in system.unlimited} == {"end of a stroke 1", "end of a stroke 2"}


def test_every_number_of_the_file_is_a_parameter(pump):
    keys = {row.parameter.key for row in pump.rows}
    assert keys >= {
        "gravity",
        "drive.speed",
        "bodies.crank.mass",
        "bodies.rod.mass",
        "bodies.rod.inertia",
        "bodies.ram.mass",
        "loads.pumping.force",
        "limits.stroke.exactly",
        "limits.guide.max",
        "limits.room.max",
        "mechanism.ground.A.x",
        "mechanism.guides.G.direction",
        "mechanism.guides.G.through.y.max",
        "mechanism.links.rod.length.min",
    }
    assert len(keys) == len(pump.rows)


@pytest.mark.slow
def test_a_stored_sensitivity_gives_the_same_table(pump, tmp_path):
    file = tmp_path / "pump.toml"
    file.write_text(tomli_w.dumps(PUMP), encoding="utf-8")
    out = tmp_path / "out"
    run = CliRunner().invoke(app, ["study", "sensitivity", str(file), "--starts", "2", "--out", str(out)])
    assert run.exit_code == 0, run.output
    rows = {row["key"]: row for row in json.loads((out / "result.json").read_text(encoding="utf-8"))["parameters"]}
    result = optlink.read_result(out)
    again = of_solution(result.problem, result.solution)  # of the programme that is built again
    for row in again.displayed.rows:
        one = rows[row.parameter.key]
        assert row.objective == pytest.approx(one["objective_per_unit"], rel=1e-5, abs=1e-9)
        np.testing.assert_allclose(list(row.design.values()), list(one["design_per_unit"].values()), rtol=1e-4, atol=1e-6)
    assert pump["gravity"].objective == pytest.approx(rows["gravity"]["objective_per_unit"], rel=1e-6)


@pytest.mark.slow
def test_sensitivities_without_an_optimum_are_refused():
    tight = optlink.read(PUMP).override({"limits.guide.max": "1 N"})
    with pytest.raises(InputError, match="no optimum to analyse: infeasible"):
        sensitivities(tight, starts=1)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "count", "gap"), [("pump", 6, 1e-5), ("shaper", 3, 1e-5), ("press", 3, 1e-3)])
def test_some_derivatives_agree_with_reoptimisation(name, count, gap, request):
    """Evenly spread over the keys."""
    result = request.getfixturevalue(name) if name != "press" else sensitivities(optlink.load("press-toggle"), starts=1)
    chosen = [result.moving[k * len(result.moving) // count] for k in range(count)]
    known = sensitivity_module.CycleParameters(result.problem, sensitivity_module.KKTSystem(result.solution))
    for row in chosen:
        check = sensitivity_module._searched_again(known, result.solution, row, "ipopt", degenerate=False)
        assert check is not None
        assert check.gap < gap, row.parameter.key


@pytest.mark.parametrize("name", ["pump", pytest.param("shaper", marks=pytest.mark.slow)])
def test_every_key_can_be_set(name, request):
    """Every reported key can be set to its reported value."""
    result = request.getfixturevalue(name)
    for row in result.rows:
        p = row.parameter
        again = result.problem.override({p.key: f"{p.value!r} {p.unit}".strip() if p.unit else p.value})
        assert again.model.free == result.problem.model.free


def test_a_coordinate_has_a_key():
    problem = optlink.load("shaper-design")
    moved = problem.override({"mechanism.ground.A.x": "3 mm", "mechanism.ground.C.y.min": "-330 mm"}).model.quantities
    assert moved["A.x"].value == pytest.approx(3e-3)
    assert moved["C.y"].bounds == pytest.approx((-0.33, -0.18))
    for key, words in (
        ("mechanism.ground.A.z", "has no key z"),
        ("mechanism.ground.A.along", "has no key along"),
        ("mechanism.links.crank.joints.x", "has no key x"),
        ("limits.guide.max.x", "has no key x"),
    ):
        with pytest.raises(InputError, match=words):
            problem.override({key: "1 mm"})


def changed(**changes):
    return optlink.read(PUMP).override({key.replace("__", "."): value for key, value in changes.items()})


@pytest.mark.slow
def test_only_numbers_are_parameters():
    """Not the digits in an expression, a file's name or a unit; of a table all values together."""
    force = {"expression": "-20*v - 5*sin(phi)", "unit": "N"}
    result = sensitivities(changed(loads__drag={"on": "ram", "force": force}), starts=1)
    assert [row.parameter.key for row in result.rows if row.parameter.key.startswith("loads.")] == ["loads.pumping.force"]
    table = {"over": "phi", "at": ["0 deg", "120 deg", "240 deg"], "values": ["0 N", "-60 N", "-20 N"]}
    problem = changed(loads__gas={"on": "ram", "force": table})
    row = sensitivities(problem, starts=1)["loads.gas.force.values"]
    assert (row.parameter.value, row.parameter.unit) == (100.0, "%")
    low, high = (
        solve(problem.override({"loads.gas.force.values": ["0 N", f"{-60 * share!r} N", f"{-20 * share!r} N"]}), starts=1)
        for share in (0.98, 1.02)
    )
    assert row.objective == pytest.approx((high.objective - low.objective) / 4.0, rel=1e-4)


@pytest.mark.slow
def test_one_per_cent_of_a_negative_speed_increases_its_magnitude(pump):
    row = sensitivities(changed(drive__speed="-150 rpm", limits__guide__max="400 N"), starts=1)["drive.speed"]
    other = sensitivities(changed(limits__guide__max="400 N"), starts=1)["drive.speed"]
    assert row.parameter.step == -other.parameter.step == -1.5
    assert row.effect == row.objective * row.parameter.step


@pytest.mark.slow
def test_tilted_gravity_has_two_parameters():
    result = sensitivities(changed(gravity=["1 m/s^2", "-9.7 m/s^2"]), starts=1)
    assert {"gravity.x", "gravity.y"} <= {row.parameter.key for row in result.moving}


@pytest.mark.slow
def test_masses_are_parameters_of_a_path_with_a_limited_torque():
    """With all masses and the limit of the torque in one ratio, the best path stays: the effects of a common factor vanish."""
    best = solution("path-within-torque").best
    found = of_solution(best.problem, best.solution)
    limit = found["limits.driving_torque.max"]
    masses = [found[f"bodies.{body}.mass"] for body in ("crank", "coupler", "rocker")]
    effect = limit.objective * limit.parameter.value
    assert effect < 0.0
    assert sum(row.objective * row.parameter.value for row in masses) == pytest.approx(-effect, rel=1e-6)
