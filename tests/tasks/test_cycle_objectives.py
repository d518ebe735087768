"""Other machines designed by their cycle: every objective is solved, proven and agreed upon; conflicts are named; odd input."""

from __future__ import annotations

import math
import pickle
import tomllib

import numpy as np
import pytest
from scipy.optimize import minimize

import optlink
from optlink.errors import InputError, Status
from optlink.optimization.cycle_signals import TracedCycle
from optlink.problem.file import ProblemFile, read
from optlink.solvers.exchange import OrderedStart
from optlink.tasks.design import solve
from optlink.tasks.search import Polisher
from optlink.validation import validate as validate_design
from optlink.validation.cycle import Cycle
from optlink.validation.design import BALANCE

PRESS = """
title = "Slider-crank press"
gravity = "9.81 m/s^2"

[mechanism]
type = "dyads"

[mechanism.ground]
A = ["0 mm", "0 mm"]

[mechanism.links]
crank = { joints = ["A", "B"], length = { start = "60 mm", bounds = ["30 mm", "120 mm"] } }
rod = { joints = ["B", "E"], length = { start = "300 mm", bounds = ["150 mm", "500 mm"] } }
ram = { joints = ["E"] }

[mechanism.guides]
F = { slider = "ram", on = "frame", through = [{ start = "0 mm", bounds = ["-60 mm", "60 mm"] }, "0 mm"], direction = "-90 deg" }

[mechanism.assembly]
E = "forward"

[bodies]
crank = { mass = "4 kg", inertia = "uniform bar" }
rod = { mass = "6 kg", inertia = "uniform bar" }
ram = { mass = "30 kg" }

[loads.pressing]
on = "ram"
acts = "opposing"
stroke = "forward"
force = "8 kN"

[drive]
body = "crank"
start = "0 deg"
speed = "60 rpm"

[objective]
quantity = "torque"
measure = "peak"

[limits]
stroke = { quantity = "stroke", of = "ram", exactly = "120 mm" }
guide = { quantity = "guide force", of = "F", measure = "peak", max = "2.5 kN" }
"""

ROCKER = """
title = "Crank-rocker with a load"
gravity = "9.81 m/s^2"

[mechanism]
type = "dyads"

[mechanism.ground]
A = ["0 mm", "0 mm"]
D = [{ start = "400 mm", bounds = ["250 mm", "600 mm"] }, "0 mm"]

[mechanism.links]
crank = { joints = ["A", "B"], length = { start = "100 mm", bounds = ["50 mm", "200 mm"] } }
coupler = { joints = ["B", "C"], length = { start = "350 mm", bounds = ["150 mm", "600 mm"] } }
rocker = { joints = ["D", "C"], length = { start = "250 mm", bounds = ["120 mm", "400 mm"] } }

[mechanism.assembly]
C = "left of B-D"

[bodies]
crank = { mass = "2 kg", inertia = "uniform bar" }
coupler = { mass = "3 kg", inertia = "uniform bar" }
rocker = { mass = "4 kg", inertia = "uniform bar" }

[loads]
work = { on = "rocker", torque = "40 N*m", acts = "opposing" }

[drive]
body = "crank"
start = "0 deg"
speed = "90 rpm"

[objective]
quantity = "torque"
measure = "peak"

[limits]
swing = { quantity = "stroke", of = "rocker", exactly = "50 deg" }
angle = { quantity = "transmission angle", of = "C", measure = "least", min = "40 deg" }
"""

WHITWORTH = """
title = "Whitworth designed"
gravity = "9.81 m/s^2"

[mechanism]
type = "dyads"

[mechanism.ground]
C = ["0 mm", "0 mm"]
A = ["0 mm", { start = "-50 mm", bounds = ["-80 mm", "-20 mm"] }]

[mechanism.links]
crank = { joints = ["A", "B"], length = { start = "100 mm", bounds = ["85 mm", "160 mm"] } }
block = { joints = ["B"] }
arm = { joints = ["C", "D"], length = { start = "90 mm", bounds = ["50 mm", "150 mm"] } }
coupler = { joints = ["D", "E"], length = { start = "320 mm", bounds = ["200 mm", "500 mm"] } }
ram = { joints = ["E"] }

[mechanism.guides]
G = { slider = "block", on = "arm", through = "C", direction = "180 deg" }
F = { slider = "ram", on = "frame", through = "C", direction = "0 deg" }

[mechanism.assembly]
G = "forward"
E = "forward"

[bodies]
crank = { mass = "3 kg", inertia = "uniform bar" }
block = { mass = "0.8 kg" }
arm = { mass = "6 kg", centroid = ["-20 mm", "0 mm"], inertia = "0.045 kg*m^2" }
coupler = { mass = "2.5 kg", inertia = "uniform bar" }
ram = { mass = "25 kg" }

[loads]
cutting = { on = "ram", force = "2 kN", acts = "opposing", stroke = "slow" }

[drive]
body = "crank"
start = "0 deg"
speed = "50 rpm"

[objective]
quantity = "torque"
measure = "peak"

[limits]
stroke = { quantity = "stroke", of = "ram", exactly = "180 mm" }
quick = { quantity = "time ratio", of = "ram", min = 1.8, max = 2.2 }
"""


MACHINES = {"press": PRESS, "rocker": ROCKER, "whitworth": WHITWORTH}


def machine(name: str, **changes: object) -> ProblemFile:
    return read(tomllib.loads(MACHINES[name]), name).override({key.replace("__", "."): value for key, value in changes.items()})


def term(quantity: str, **more: object) -> dict[str, object]:
    return {"quantity": quantity, **more}


# --- every objective ---------------------------------------------------------------------------------------------------------

OBJECTIVES = {
    "press: peak torque": ("press", {}),
    "press: guide force": ("press", {"objective": term("guide force", of="F"), "limits__guide": None}),
    "press: rms torque": ("press", {"objective": term("torque", measure="rms")}),
    "rocker: peak torque": ("rocker", {}),
    "rocker: reaction": ("rocker", {"objective": term("reaction", of="C")}),
    "rocker: shaking": ("rocker", {"objective": term("shaking force", measure="rms")}),
    "rocker: transmission": (
        "rocker",
        {
            "objective": term("transmission angle", of="C", measure="least", sense="maximise"),
            "limits__angle": term("transmission angle", of="C", measure="largest", max="140 deg"),
        },
    ),
    "whitworth: peak torque": ("whitworth", {}),
    "whitworth: reaction": ("whitworth", {"objective": term("reaction", of="C")}),
    "whitworth: acceleration": ("whitworth", {"objective": term("acceleration", of="E", measure="rms")}),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", OBJECTIVES)
def test_every_objective_is_solved_and_both_back_ends_agree(case):
    name, changes = OBJECTIVES[case]
    result = solve(machine(name, **changes), "both", starts=2)
    assert result.valid, [check for check in result.validation.checks if not check.passed]
    one, other = result.backends.values()
    assert one.objective == pytest.approx(other.objective, rel=1e-7)
    assert result.conflict == ()


# --- against searches that share nothing with the programme ------------------------------------------------------------------


def crank_of(stroke: float, rod: float, offset: float) -> float:
    """Crank of a slider-crank with this stroke, by bisection of the textbook formula."""
    low, high = 0.0, rod - abs(offset)
    for _ in range(200):
        crank = 0.5 * (low + high)
        computed = math.sqrt((rod + crank) ** 2 - offset**2) - math.sqrt((rod - crank) ** 2 - offset**2)
        low, high = (crank, high) if computed < stroke else (low, crank)
    return 0.5 * (low + high)


@pytest.mark.slow
def test_press_against_a_simplex_search_over_its_free_sizes():
    """Offset and rod are searched by Nelder and Mead, the crank follows from the stroke; the cycle is measured as a machine's."""
    file = machine("press", objective=term("guide force", of="F"), limits__guide=None)
    result = solve(file, "slsqp", starts=2)
    task = result.problem.spec

    def measured(x: np.ndarray) -> float:
        offset, rod = 1e-3 * np.clip(x, [-60.0, 150.0], [60.0, 500.0])
        design = {"A.x": 0.0, "crank.length": crank_of(0.12, rod, offset), "rod.length": rod, "F.x": offset}
        return Cycle(task, {name: value for name, value in design.items() if name in task.quantities}).objective()

    best = min(
        minimize(measured, start, method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-7, "maxiter": 150}).fun
        for start in ([0.0, 300.0], [20.0, 450.0])
    )
    assert result.objective == pytest.approx(best, rel=1e-6)


BESIDE = {
    "A.x": 400.0,
    "A.y": -124.0625,
    "crank.length": 79.5062,
    "rod.length": 355.2704,
    "upper.length": 220.0,
    "lower.length": 378.9,
}
"""A toggle press in whose programme two positions beside one peak seem to hold what is still free [mm]."""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["slsqp", "ipopt"])
def test_positions_near_a_peak_are_not_constrained(name):
    """A search that took those for a proof ended there; along the free direction the measured peak is lower."""
    file = optlink.load("press-toggle", {"objective": term("guide force", of="F")})
    task, values = file.spec, {key: 1e-3 * value for key, value in BESIDE.items()}
    polisher, order = Polisher([file], name), TracedCycle(task).structure(values)
    result = polisher.exchanged(polisher.at_start(0, OrderedStart(order, values, values, first=True)))
    assert result.status is Status.OPTIMAL
    lower = Cycle(task, result.design)
    assert result.objective == pytest.approx(lower.objective(), rel=1e-7)
    assert lower.objective() < Cycle(task, values).objective() - 0.5
    assert all(check.passed for check in validate_design(task, result.design).checks)


def test_a_result_measures_each_term_of_a_machine_once(monkeypatch):
    measured, measure = [], Cycle._figure

    def counted(cycle, term):
        measured.append((tuple(cycle.design.values()), term))
        return measure(cycle, term)

    monkeypatch.setattr(Cycle, "_figure", counted)
    result = solve(machine("press"), starts=1)
    assert result.figures[0].result == pytest.approx(result.objective, rel=1e-9)
    assert result.best.initial.objective == pytest.approx(result.figures[0].initial, rel=1e-12)
    assert len(measured) == len(set(measured))  # extremes of a machine are measured together
    assert len({design for design, _ in measured}) == 2  # of the initial machine and of the result


def test_copies_keep_cached_figures(monkeypatch):
    """A copy has terms of its own; figures by the address of a term were those of whatever came to lie there later."""
    cycle = Cycle(machine("press").model, {})
    goal = cycle.problem.goals[0]
    known = cycle.figure(goal)
    there, same = pickle.loads(pickle.dumps((cycle, goal)))
    monkeypatch.setattr(Cycle, "_figure", lambda *_: pytest.fail("measured again"))
    assert there.figure(same) == known


# --- limits that conflict ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_unreachable_stroke_is_reported():
    result = solve(machine("press", limits__stroke={**term("stroke", of="ram"), "exactly": "400 mm"}), starts=2)
    assert result.status is Status.INFEASIBLE
    assert [item.key for item in result.conflict] == ["limits.stroke"]
    assert 0.0 < result.conflict[0].relaxed < 400.0


@pytest.mark.slow
def test_two_conflicting_limits_are_both_listed():
    """A guide that is hardly pressed needs a long rod; a peak torque below that of the load at this stroke cannot be."""
    changes = {
        "limits__short": term("length", of="rod.length", max="180 mm"),
        "limits__guide": term("guide force", of="F", max="600 N"),
    }
    result = solve(machine("press", **changes), starts=2)
    assert result.status is Status.INFEASIBLE
    assert {"limits.guide", "limits.short"} <= {item.key for item in result.conflict}


# --- the balance of work -----------------------------------------------------------------------------------------------------


def idle() -> ProblemFile:
    """A slider-crank with masses, nothing to work against."""
    return machine("press", loads=None, gravity=None, objective=term("reaction", of="E"), limits__guide=None)


@pytest.mark.slow
def test_limits_missed_by_little_more_than_a_tolerance_are_named():
    """A stroke of 120 mm needs a crank of 60 mm; with the shortest rod, the links are 1e-5 mm longer than permitted."""
    problem = read(tomllib.loads(PRESS)).override({"mechanism.guides.F.through": ["0 mm", "0 mm"]})
    limits = {
        "stroke": {"quantity": "stroke", "of": "ram", "min": "120 mm"},
        "size": {"quantity": "total length", "max": "209.99999 mm"},
    }
    result = solve(problem.override({"limits": limits}), starts=1)
    assert result.status is Status.INFEASIBLE
    amounts = {item.key: item.amount for item in result.conflict}
    assert amounts == pytest.approx({"limits.stroke": 2e-5, "limits.size": 1e-5}, rel=0.05)


@pytest.mark.parametrize("term", [{}, {"scale": "1e10 N*m", "weight": 2.0}], ids=["without a scale", "far below its scale"])
def test_a_sum_of_one_term_has_the_optimum_of_that_term(term):
    """A scale divides the value and changes nothing else: without one, the value is that in SI units."""
    problem = read(tomllib.loads(PRESS))
    alone = solve(problem, starts=1)
    result = solve(problem.override({"objective": {"terms": [{"quantity": "torque", **term}]}}), starts=1)
    assert result.valid
    assert result.design == pytest.approx(alone.design, rel=1e-6, abs=1e-9)
    assert result.objective == pytest.approx(alone.objective * (2e-10 if term else 1.0), rel=1e-9)


def test_a_machine_without_loads_passes_validation():
    result = solve(idle(), "slsqp", starts=1)
    assert result.valid, [check for check in result.validation.checks if not check.passed]
    assert Cycle(result.problem.spec, result.best.values).imbalance() < 0.1 * BALANCE


def test_quadrature_near_alignment_passes_validation(monkeypatch):
    """The coupler comes close to the line of the rocker, where the kinetic energy has a sharp peak; finer steps resolve it."""
    lengths = {"crank": {"start": "60 mm", "bounds": ["50 mm", "70 mm"]}, "coupler": "170.003 mm", "rocker": "100 mm"}
    mechanism = {"type": "four-bar", "frame": "210 mm", **lengths}
    bodies = {name: {"mass": "3 kg", "inertia": "uniform bar"} for name in ("coupler", "rocker")}
    file = read(
        {"mechanism": mechanism, "bodies": bodies, "objective": {"quantity": "torque"}, "limits": {"alignment": "0.2 deg"}}
    )
    assert validate_design(file.model, {}).valid
    monkeypatch.setattr("optlink.dynamics.work.ROUGH", 1.0)  # no panel is halved
    assert not validate_design(file.model, {}).valid


def test_a_wrong_power_fails_validation(monkeypatch):
    from optlink.dynamics.machine import Acting

    file = machine("press")
    good = Cycle(file.model, {})
    assert good.imbalance() < 0.1 * BALANCE
    power = Acting.power
    monkeypatch.setattr(Acting, "power", lambda self, state: 1.0001 * power(self, state))
    assert Cycle(file.model, {}).imbalance() > 1e3 * BALANCE
    assert "work of the drive is that of the loads" in [c.name for c in validate_design(file.model, {}).checks if not c.passed]


# --- odd input ---------------------------------------------------------------------------------------------------------------

REFUSED = {
    "unknown joint": ({"objective": term("reaction", of="Q")}, "objective.of", "no such pin joint"),
    "unknown body of a limit": (
        {"limits__stroke": term("stroke", of="rma", max="1 m")},
        "limits.stroke.of",
        'Did you mean "ram"',
    ),
    "unknown quantity": ({"objective": term("troque")}, "objective.quantity", "torque"),
    "contradiction": (
        {"limits__stroke": term("stroke", of="ram", min="2 m", max="1 m")},
        "limits.stroke.min",
        "min is above max",
    ),
    "nothing free": (
        {
            "mechanism__links__crank__length": "60 mm",
            "mechanism__links__rod__length": "300 mm",
            "mechanism__guides__F__through": ["0 mm", "0 mm"],
        },
        "mechanism",
        "no design variables",
    ),
    "infinite bound": (
        {"mechanism__links__crank__length": {"bounds": ["30 mm", "inf mm"]}},
        "mechanism.links.crank.length",
        "bounds",
    ),
    "wrong unit": ({"limits__stroke": term("stroke", of="ram", max="1 kg")}, "limits.stroke.max", "kg"),
    "a body that turns": ({"objective": term("stroke", of="crank")}, "objective.of", "turns fully"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_odd_input_is_refused_with_its_key(case):
    changes, key, words = REFUSED[case]
    with pytest.raises(InputError) as caught:
        solve(machine("press", **changes), starts=1)
    assert any(key in str(fault.key) and words in str(fault) for fault in caught.value.faults), caught.value


def test_dimensions_without_crank_rotation_are_refused():
    changes = {"mechanism__links__crank__length": {"bounds": ["480 mm", "490 mm"]}, "mechanism__links__rod__length": "300 mm"}
    result = solve(machine("press", **changes, limits__stroke=None), starts=2)
    assert result.status is Status.INFEASIBLE
    assert any("turn fully" in note for note in result.notes)


@pytest.mark.slow
def test_a_start_without_crank_rotation_is_replaced():
    rod = {"start": "155 mm", "bounds": ["150 mm", "500 mm"]}
    crank = {"start": "119 mm", "bounds": ["30 mm", "120 mm"]}
    offset = [{"start": "59 mm", "bounds": ["-60 mm", "60 mm"]}, "0 mm"]
    changes = {
        "mechanism__links__rod__length": rod,
        "mechanism__links__crank__length": crank,
        "mechanism__guides__F__through": offset,
    }
    result = solve(machine("press", **changes), starts=4)
    assert result.valid
    assert result.objective == pytest.approx(solve(machine("press"), starts=2).objective, rel=1e-7)
