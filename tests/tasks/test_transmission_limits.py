"""Limits of transmission and pressure angles of every dyad: definitions by forces, closed forms, other programmes, defects."""

from __future__ import annotations

import math

import numpy as np
import pytest

import optlink
from optlink.linkage.dyads import transmitting
from optlink.linkage.motion import sweep
from optlink.linkage.vector2d import unit
from optlink.optimization.programme import build
from optlink.problem.design import DesignProblem
from optlink.studies.optimum_parameters import parameters
from optlink.tasks.design import solve, validate
from optlink.validation.motion import transmission_angles
from tests.tasks.test_motion_laws import LINKS

TURN = 2.0 * math.pi
Raw = dict[str, object]

ROCKER: Raw = {
    "title": "t",
    "mechanism": {
        **LINKS,
        "links": {
            "crank": {"joints": ["A", "B"], "length": "30 mm"},
            "coupler": {"joints": ["B", "C"], "length": "80 mm"},
            "rocker": {"joints": ["D", "C"], "length": "70 mm"},
        },
    },
    "drive": {"body": "crank", "speed": "10 rad/s"},
}
ALONE = {"bodies": None, "gravity": None, "expected": None}
MACHINES: dict[str, tuple[optlink.ProblemFile, str, str, float]] = {
    # problem with one load and no inertia, its dyad, the column of the force that the dyad transmits, the force for 90 deg
    "RRR": (optlink.read({**ROCKER, "loads": {"w": {"on": "rocker", "torque": "7 N*m"}}}), "C", "C", 100.0),
    "RRP": (
        optlink.load(
            "slider-crank",
            {**ALONE, "mechanism.guides.F.offset": "70 mm", "loads": {"w": {"on": "slider", "force": "100 N"}}},
        ),
        "E",
        "E",
        100.0,
    ),
    "RPR": (
        optlink.load("oscillating-cylinder", {**ALONE, "loads": {"w": {"on": "cylinder", "torque": "7 N*m"}}}),
        "G",
        "G",
        7.0,
    ),
    "RPP": (
        optlink.load(
            "scotch-yoke",
            {**ALONE, "mechanism.guides.slot.direction": "60 deg", "loads": {"w": {"on": "yoke", "force": "100 N"}}},
        ),
        "slot",
        "B",
        100.0,
    ),
    "PRP": (
        optlink.load(
            "slotted-quick-return",
            {**ALONE, "mechanism.guides.F.friction": None, "loads": {"w": {"on": "ram", "force": "100 N"}}},
        ),
        "D",
        "D",
        100.0,
    ),
}


@pytest.mark.parametrize("kind", MACHINES)
def test_sine_of_the_transmission_angle_is_load_over_transmitted_force(kind: str) -> None:
    """Inverse dynamics, which knows no transmission angle: the smaller its sine, the larger the force for the same load."""
    file, joint, column, load = MACHINES[kind]
    analysis = optlink.analyze(file, points=72)
    mechanism, sizes = file.model.linkage, {name: q.value for name, q in file.model.quantities.items()}
    motion = sweep(mechanism, sizes, np.radians(analysis["crank_angle_deg"]))
    groups = transmitting(mechanism)
    k = [group.joint for group in groups].index(joint)
    assert groups[k].kind == kind
    angles = transmission_angles(motion, mechanism)[:, k]
    force = analysis[f"{joint}.normal_N"] if kind == "RPR" else np.hypot(*(analysis[f"{column}.f{axis}_N"] for axis in "xy"))
    if kind == "RPR":  # lever: distance of the pins
        load = load / np.linalg.norm(motion.position("B") - motion.position("D"), axis=1)
    np.testing.assert_allclose(np.sin(angles), load / np.abs(force), rtol=1e-9)
    pose = mechanism.pose(sizes, unit(motion.crank_angle))
    np.testing.assert_allclose(np.cos(angles), np.broadcast_to(groups[k].cosine(pose), angles.shape), atol=1e-12)


CRANK, ROD, OFFSET = 0.025, 0.090, 0.010
MADE = {"crank.length": CRANK, "rod.length": ROD, "start": 0.3, "zero": 0.1}


@pytest.mark.parametrize("offset", [0.0, OFFSET])
@pytest.mark.parametrize("excess", [-1e-5, 1e-5])
def test_largest_pressure_angle_of_a_slider_crank(offset: float, excess: float) -> None:
    """asin((r + e) / l), at a crank angle of the revolution alone, not of the span; just met, and just missed."""
    most = math.degrees(math.asin((CRANK + offset) / ROD)) + excess
    key = ("limits.pressure_angle", f"{most!r} deg")
    if excess > 0.0:
        key = ("limits.transmission_angle", {"C": [f"{90.0 - most!r} deg", "170 deg"]})
    result = validate(optlink.load("law-slider-crank", dict([key])), MADE | {"G.offset": offset})
    (check,) = (check for check in result.validation.checks if "pressure" in check.name or "smallest trans" in check.name)
    assert check.passed == (excess > 0.0)
    computed = check.value if "pressure" in check.name else 90.0 - check.value
    assert computed == pytest.approx(most - excess, abs=1e-9)
    assert math.degrees(result.best.least_transmission) == pytest.approx(90.0 - most + excess, abs=1e-9)


def test_pressure_angle_of_a_four_bar_of_dyads_is_that_of_the_four_bar() -> None:
    """The four-bar has the extremes in closed form, the dyads at single crank angles; the optimum is at its limit."""
    four_bar = optlink.solve(optlink.load("crank-rocker", {"limits": {"pressure_angle": "45 deg"}}))
    stated = optlink.load("crank-rocker").raw["requirement"]
    bounds = {"bounds": ["50 mm", "900 mm"]}
    links = {name: {**link, "length": bounds} for name, link in LINKS["links"].items()}
    mechanism = {**LINKS, "ground": {"A": ["0 mm", "0 mm"], "D": ["500 mm", "0 mm"]}, "links": links}
    task = {"kind": "function", "law": stated["law"], "span": stated["span"], "points": stated["points"], "output": "rocker"}
    file = optlink.read({"title": "t", "mechanism": mechanism, "requirement": task, "limits": {"pressure_angle": "45 deg"}})
    design = {f"{name}.length": four_bar.design[name] for name in ("crank", "coupler", "rocker")}
    design |= {"start": four_bar.design["phi0"], "zero": four_bar.design["psi0"]}
    dyads = validate(file, design)
    assert four_bar.valid
    assert dyads.valid
    computed = [next(c.value for c in r.validation.checks if c.name == "largest pressure angle") for r in (four_bar, dyads)]
    assert computed == pytest.approx([45.0, 45.0], abs=1e-6)
    assert dyads.objective == pytest.approx(four_bar.objective, rel=1e-9)
    nlp = build(file.model)
    values = nlp.values(nlp.x_of(design), nlp.p)[1]
    shown = [
        row.scale.to_display(float(value))
        for row, value in zip(nlp.rows, values, strict=True)
        if row.limit == "limits.pressure_angle"
    ]
    assert max(shown) == pytest.approx(45.0, abs=1e-6)  # crank angles of 0 and 180 deg are among the positions


def test_named_dyads_have_specific_limits_and_others_the_general_one() -> None:
    def limits(changes: Raw) -> dict[str, tuple[float, float]]:
        model = optlink.load("law-six-bar", {f"limits.{key}": value for key, value in changes.items()}).model
        assert isinstance(model, DesignProblem)
        computed = {}
        for joint in ("C", "E"):
            limit = model.limits.transmission_at(joint)
            if limit is not None:
                computed[limit.key.removeprefix("limits.")] = tuple(round(math.degrees(b), 9) for b in (limit.low, limit.high))
        return computed

    both = {"transmission_angle": {"min": "40 deg", "max": "140 deg", "E": ["30 deg", "120 deg"]}}
    assert limits(both) == {"transmission_angle": (40.0, 140.0), "transmission_angle.E": (30.0, 120.0)}
    assert limits({"pressure_angle": {"E": "35 deg"}}) == {"transmission_angle": (40.0, 140.0), "pressure_angle.E": (55.0, 125.0)}
    assert limits({"transmission_angle": {"E": ["30 deg", "120 deg"]}}) == {"transmission_angle.E": (30.0, 120.0)}
    assert limits({"transmission_angle": None, "pressure_angle.C": "20 deg"}) == {"pressure_angle.C": (70.0, 110.0)}


@pytest.mark.slow
def test_span_limits_do_not_apply_beyond_the_span() -> None:
    """A tight limit that only the span can satisfy, with a crank that turns fully."""
    file = optlink.load("law-slider-crank", {"limits.pressure_angle": "20 deg", "limits.alignment": "1 deg"})
    over = file.override({"limits.transmission_over": "span"})
    whole, span = (solve(one, starts=60, designs=1) for one in (file, over))
    assert whole.valid
    assert span.valid
    assert span.objective < 0.9 * whole.objective
    result = span.best
    begin, end = result.crank_angles[[0, -1]]
    pressure = {}
    for name, angles in {"span": np.linspace(begin, end, 2001), "turn": np.linspace(0.0, TURN, 2001)}.items():
        height = result.design["crank.length"] * np.sin(angles) - result.design["G.offset"]
        pressure[name] = math.degrees(math.asin(np.max(np.abs(height)) / result.design["rod.length"]))
    assert pressure["span"] == pytest.approx(20.0, abs=1e-5)
    assert pressure["turn"] > 21.0


@pytest.mark.slow
@pytest.mark.parametrize("key", ["transmission_angle.min", "pressure_angle.max"])
def test_price_of_the_limit_is_the_difference_of_two_optima(key: str) -> None:
    limit, _, side = key.partition(".")
    stated = ["45 deg", "135 deg"] if side == "min" else "45 deg"
    file = optlink.load("law-slider-crank", {f"limits.{limit}": stated})
    computed = {}
    for backend in ("ipopt", "slsqp"):
        for bound in (44.95, 45.0, 45.05):
            result = solve(file.override({f"limits.{key}": f"{bound} deg"}), backend, starts=120, designs=1)
            assert result.valid
            computed[backend, bound] = result
    for backend in ("ipopt", "slsqp"):
        limits = computed[backend, 45.0].best.displayed_limits
        (price,) = (one.multiplier for one in limits if one.key == f"limits.{limit}" and one.active)
        slope = (computed[backend, 45.05].objective - computed[backend, 44.95].objective) / 0.1
        assert price == pytest.approx(slope, rel=1e-3)
    assert computed["slsqp", 45.0].objective == pytest.approx(computed["ipopt", 45.0].objective, rel=1e-7)


@pytest.mark.slow
def test_conflict_is_relaxed_to_the_closed_form() -> None:
    """Crank at least 15 mm, rod at most 60 mm: a pressure angle of asin(1/4) at best; or a crank of 60 mm sin(8 deg)."""
    rod, crank = ({"bounds": [f"{low} mm", "60 mm"]} for low in (20, 15))
    changes = {"mechanism.links.rod.length": rod, "mechanism.links.crank.length": crank, "limits.pressure_angle": "8 deg"}
    result = solve(optlink.load("law-slider-crank", changes), starts=60)
    assert not result.valid
    relaxed = {one.key: one.relaxed for one in result.conflict}
    assert relaxed["limits.pressure_angle"] == pytest.approx(math.degrees(math.asin(0.25)), abs=1e-4)
    assert relaxed["mechanism.links.crank.length"] == pytest.approx(60.0 * math.sin(math.radians(8.0)), abs=1e-4)


def test_best_transmission_is_the_worst_of_the_revolution() -> None:
    """The extremes of a slider-crank lie between all sampled crank angles; its best pressure angle is asin((r + e) / l)."""
    lengths = {
        name: {"bounds": [f"{low} mm", f"{high} mm"]} for name, low, high in (("r", 20, 60), ("l", 50, 200), ("e", 15, 40))
    }
    links = {
        "crank": {"joints": ["A", "B"], "length": lengths["r"]},
        "rod": {"joints": ["B", "C"], "length": lengths["l"]},
        "slider": {"joints": ["C"]},
    }
    guide = {"slider": "slider", "through": "A", "direction": "33 deg", "offset": lengths["e"]}
    mechanism = {"type": "dyads", "ground": {"A": ["0 mm", "0 mm"]}, "links": links, "guides": {"G": guide}}
    raw = {"title": "t", "mechanism": {**mechanism, "assembly": {"C": "forward"}}, "requirement": {"kind": "transmission"}}
    result = solve(optlink.read(raw), "slsqp", starts=60, designs=1)
    assert result.valid
    assert result.objective == pytest.approx(35.0 / 200.0, abs=1e-9)
    assert result.best.least_transmission == pytest.approx(math.acos(35.0 / 200.0), abs=1e-9)


@pytest.mark.slow
def test_the_worst_angle_of_several_dyads_counts() -> None:
    """Of a toggle press: that of the programme of its cycle, which has its own formula and its own search."""
    links = {
        "crank": {"joints": ["A", "B"], "length": "60 mm"},
        "rod": {"joints": ["B", "C"], "length": {"bounds": ["300 mm", "600 mm"]}},
        "upper": {"joints": ["D", "C"], "length": "300 mm"},
        "lower": {"joints": ["C", "E"], "length": {"bounds": ["200 mm", "400 mm"]}},
        "ram": {"joints": ["E"]},
    }
    ground = {"D": ["0 mm", "0 mm"], "A": [{"bounds": ["300 mm", "700 mm"]}, {"bounds": ["-450 mm", "-100 mm"]}]}
    guides = {"F": {"slider": "ram", "through": "D", "direction": "-90 deg"}}
    assembly = {"C": "left of B-D", "E": "forward"}
    mechanism = {"type": "dyads", "ground": ground, "links": links, "guides": guides, "assembly": assembly}
    best = solve(optlink.read({"title": "t", "mechanism": mechanism, "requirement": {"kind": "transmission"}}))
    assert best.valid
    goal = {"quantity": "pressure angle", "sense": "minimise", "measure": "peak"}
    drive = {"body": "crank", "speed": "60 rpm"}
    cycle = optlink.solve(optlink.read({"title": "t", "mechanism": mechanism, "drive": drive, "objective": goal}))
    assert isinstance(cycle, optlink.SynthesisResult)
    assert cycle.valid
    assert math.acos(best.objective) == pytest.approx(0.5 * math.pi - cycle.objective, abs=1e-9)
    assert best.best.least_transmission == pytest.approx(math.acos(best.objective), abs=1e-9)
    linkage = best.best.task.linkage
    angles = transmission_angles(sweep(linkage, best.design, np.linspace(0.0, TURN, 20_001)), linkage)
    assert np.max(np.abs(np.cos(angles))) == pytest.approx(best.objective, abs=1e-7)


def test_one_value_for_several_dyads_is_one_parameter() -> None:
    """Its price in a study is that of the number in the file: of the rows of every dyad together."""
    nlp = build(optlink.load("law-six-bar", {"limits.pressure_angle.E": "40 deg"}).model)
    single = {(one.key, one.name) for one in parameters(nlp) if "angle" in one.key}
    assert single == {(f"limits.transmission_angle.{side}", "transmission angle at C") for side in ("min", "max")} | {
        ("limits.pressure_angle.E.max", "pressure angle at E")
    }
    nlp = build(optlink.load("law-six-bar").model)
    both = {one.key: one for one in parameters(nlp) if "transmission" in one.key}
    assert {one.name for one in both.values()} == {"transmission angle at C, E"}
    labels = {nlp.rows[entry - len(nlp.variables)].label for entry in both["limits.transmission_angle.min"].entries}
    assert labels == {"transmission angle at C", "transmission angle at E"}
