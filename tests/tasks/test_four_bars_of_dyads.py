"""A chain of dyads that is a four-bar gets all that a four-bar by its lengths has; a chain that is none gets nothing of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.optimization.terms import rows
from optlink.studies import sweep
from optlink.studies.grid import read_grid
from optlink.studies.optimum_parameters import FastOverride
from optlink.synthesis.batch import Batch, ByLengths
from optlink.synthesis.batch_search import random_crank_angles, random_designs
from optlink.validation import validate
from tests.as_dyads import FAR, as_dyads
from tests.tiers import mostly_slow

LENGTHS = ("crank", "coupler", "rocker", "frame")
NAMES = {f"{name}.length": name for name in LENGTHS} | {"D.x": "frame", "start": "phi0", "zero": "psi0"}
NARROW = {"mechanism.coupler": "412..418 mm", "mechanism.rocker": "228..232 mm", "requirement.points": 8}
SHORT = {"mechanism.coupler": "410..416 mm", "mechanism.rocker": "230..236 mm"}


def limits_of(result: optlink.SynthesisResult) -> dict[str, set[bool]]:
    """Names of the limits, whether one of that name is active; without those of the pose of the frame."""
    found: dict[str, set[bool]] = {}
    for limit in result.limits:
        name = NAMES.get(limit.name.removeprefix("coupler.P"), limit.name.replace("coupler.P", "P"))
        name = "frame" if name == "frame length" else name
        if name not in ("A.x", "A.y", "D.x", "D.y", "direction"):
            found.setdefault(name, set()).add(limit.active)
    return found


@pytest.mark.parametrize(
    "name",
    mostly_slow(["crank-rocker", "transmission-optimal", "path-closed18", "function-sin"], "crank-rocker", "path-closed18"),
)
def test_both_ways_to_write_a_four_bar_have_one_optimum_and_the_same_limits(name: str) -> None:
    section = optlink.load(name)
    one, other = (optlink.solve(file) for file in (section, as_dyads(section)))
    assert one.valid
    assert other.valid
    assert other.objective == pytest.approx(one.objective, rel=1e-12)
    if name != "path-closed18":
        assert limits_of(other) == limits_of(one)
        for key in LENGTHS[:3]:
            assert other.design[f"{key}.length"] == pytest.approx(one.design[key], rel=1e-8)
    assert set(limits_of(other)) - {"start", "phi0"} == set(limits_of(one)) - {"start", "phi0"}
    assert other.best is not None
    assert one.best is not None
    for mine, theirs in zip(other.best.cognates, one.best.cognates, strict=True):
        found, wanted = mine.linkage, theirs.linkage
        assert [getattr(found, key) for key in LENGTHS] == pytest.approx([getattr(wanted, key) for key in LENGTHS], rel=1e-6)
        assert (found.x, found.y) == pytest.approx((wanted.x, wanted.y), rel=1e-6)
    assert len(one.best.cognates) == (2 if name == "path-closed18" else 0)


@pytest.mark.slow
def test_exact_poses_are_found() -> None:
    section = optlink.load("motion-3-poses")
    result = optlink.solve(as_dyads(section))
    assert result.valid
    assert result.objective < 1e-22
    assert "Grashof: crank-rocker" in [check.name for check in result.validation.checks]


def test_the_optimum_of_a_law_is_certified_by_default() -> None:
    section = optlink.load("crank-rocker")
    one, other = (optlink.solve(file).certificate for file in (section, as_dyads(section)))
    assert one is not None
    assert other is not None
    assert (other.status, other.boxes, other.unknowns) == (one.status, one.boxes, ("coupler.length", "rocker.length"))
    assert other.lower_bound == pytest.approx(one.lower_bound, rel=1e-12)


@pytest.mark.slow
def test_a_function_has_its_certificate() -> None:
    """The convex first step, the optimum and the proof of the least largest error."""
    section = optlink.load("function-log10")
    one, other = (optlink.solve(file, certify=True, gap=0.3) for file in (section, as_dyads(section)))
    assert other.objective == pytest.approx(one.objective, rel=1e-12)
    assert other.first_step is not None
    assert other.first_step.error == pytest.approx(one.first_step.error, rel=1e-12)
    assert other.certificate.status == one.certificate.status
    assert other.certificate.lower_bound == pytest.approx(one.certificate.lower_bound, rel=1e-3)


@pytest.mark.slow
def test_a_sweep_of_dyads_runs_in_one_programme() -> None:
    """Every point of the sweep of a law shares it, the place of the pivot being its parameter; the optima are the same."""
    section = optlink.load("crank-rocker")
    tables = []
    for file, key in ((section, "mechanism.frame"), (as_dyads(section), "mechanism.ground.D.x")):
        assert file.spec.shares_programme([key])
        tables.append(sweep(file, [f"{key}=480..520 mm:5"], workers=1).columns)
    one, other = tables
    assert set(one["status"]) == set(other["status"]) == {"optimal"}
    assert other["objective_rad2"] == pytest.approx(one["objective_rad2"], rel=1e-10)
    assert other["coupler.length_m"] == pytest.approx(one["coupler_m"], rel=1e-8)


@pytest.mark.slow
def test_a_sweep_that_turns_the_frame_agrees_with_single_optima() -> None:
    """The programme is that of a frame along x, whose rows hold for any direction."""
    file, key = as_dyads(optlink.load("crank-rocker")), "mechanism.ground.D.y"
    assert FastOverride(file.spec, read_grid(file, [f"{key}=0..40 mm:3"]).axes).possible
    found = sweep(file, [f"{key}=0..40 mm:3"], workers=1).columns["objective_rad2"]
    single = [optlink.solve(file.override({key: f"{y} mm"})).objective for y in (0, 20, 40)]
    assert found == pytest.approx(single, rel=1e-9)
    assert len({round(value, 9) for value in single}) == 3


def test_coincident_pivots_of_a_random_design_give_finite_slopes() -> None:
    """Both may be clipped to one corner of their bounds, where the length of the frame has no derivative."""
    batch = Batch(as_dyads(optlink.load("path-closed18", {"mechanism.assembly": "left"})).spec)
    x = np.clip(np.full((2, len(batch.names)), 0.3), batch.low, batch.high)
    x[1, batch.names.index("D.x")] += 0.4
    excess, slopes = batch.violations(x, batch.crank_angles(x, np.zeros((2, 18))))
    assert np.isfinite(excess).all()
    assert np.isfinite(slopes).all()
    assert np.any(slopes[1])


@pytest.mark.parametrize("name", ["motion-3-poses", "path-closed18", "path-bean"])
def test_random_designs_by_lengths_are_those_of_the_dyads(name: str) -> None:
    """Least squares between free pivots have the lengths and the direction of the frame as unknowns: the same deviations."""
    stated = as_dyads(optlink.load(name, {"mechanism.assembly": "right"})).spec
    how = ByLengths(stated)
    assert how.problem is not None
    batches = Batch(how.problem), Batch(stated)
    rng = np.random.default_rng(3)
    x, t = random_designs(batches[0], 40, rng), random_crank_angles(batches[0], 40, rng)
    y, turned = how.stated_design(x, t)
    one, other = (
        batch.residual_values(values, batch.crank_angles(values, angles))
        for batch, values, angles in zip(batches, (x, y), (t, turned), strict=True)
    )
    inside = np.all((y > batches[1].low) & (y < batches[1].high), axis=1)
    assert np.count_nonzero(inside) > 20
    assert other[inside] == pytest.approx(one[inside], rel=1e-9, abs=1e-9, nan_ok=True)
    assert np.count_nonzero(np.isfinite(one[inside])) > 20


def test_a_fixed_pivot_or_a_prescribed_start_leaves_the_dyads_as_they_are() -> None:
    """Their crank angles count from +x, or a coordinate has one value, which no bound of a length expresses."""
    free = as_dyads(optlink.load("path-closed18", {"mechanism.assembly": "left"}))
    assert ByLengths(free.spec).problem is not None
    for change in ({"mechanism.ground.A.x": "1 mm"}, {"requirement.start": "20 deg"}, {"mechanism.links.rocker.length": "1 mm"}):
        assert (ByLengths(free.override(change).spec).problem is None) == ("mechanism.links.rocker.length" not in change)
    assert ByLengths(optlink.load("path-closed18").spec).problem is None


# --- closed forms in any place ------------------------------------------------------------------------------------------------

SIZES = {"crank": 0.05, "coupler": 0.17, "rocker": 0.12, "frame": 0.18}
LAW = {"kind": "function", "law": "psi0 + 0.3*(phi - phi0)", "span": "100 deg", "from": "outer dead centre"}


def moved(turn: float, x: float, y: float, *, swapped: bool, limits: dict[str, Any]) -> optlink.ProblemFile:
    """A crank-rocker of dyads with its crank pivot at (x, y) [m] and its frame turned [rad]."""
    place = {"A": [x, y], "D": [x + SIZES["frame"] * math.cos(turn), y + SIZES["frame"] * math.sin(turn)]}
    ground = {name: [f"{1e3 * coordinate!r} mm" for coordinate in pair] for name, pair in place.items()}
    joints = {"crank": ["A", "B"], "coupler": ["C", "B"], "rocker": ["D", "C"]}
    links = {name: {"joints": pins, "length": f"{1e3 * SIZES[name]!r} mm"} for name, pins in joints.items()}
    mode = {"C": "right of D-B" if swapped else "left of B-D"}
    law = {**LAW, "output": "rocker", "psi0": "output at the start"}
    mechanism = {"type": "dyads", "ground": ground, "links": links, "assembly": mode}
    return optlink.read({"title": "t", "mechanism": mechanism, "requirement": law, "limits": limits})


LIMITS = [
    {"transmission_angle": ["20 deg", "150 deg"], "swing_angle": ["20 deg", "100 deg"], "time_ratio": [1.0, 3.0]},
    {"crank": "span", "pressure_angle": "80 deg", "link_ratio": [0.1, 5.0], "frame_length": ["50 mm", "300 mm"]},
    {"transmission_cosine": [-0.9, 0.9], "transmission_over": "span", "length_margin": 1e-3},
]


@pytest.mark.parametrize("limits", LIMITS)
@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.7, 0.2, -0.1), (-2.9, -0.3, 0.4)])
def test_limits_of_a_turned_and_moved_four_bar_are_those_of_its_lengths(
    limits: dict[str, Any], swapped: bool, place: tuple[float, float, float]
) -> None:
    lengths = {name: f"{1e3 * size!r} mm" for name, size in SIZES.items()}
    section = optlink.read({"title": "t", "mechanism": lengths, "requirement": LAW, "limits": limits}).spec
    dyads = moved(*place, swapped=swapped, limits=limits).spec
    one, other = (problem.complete({}) for problem in (section, dyads))
    assert math.remainder(other["start"] - place[0] - one["phi0"], 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)
    found = [rows(problem, values, problem.reach(values), 0.18) for problem, values in ((section, one), (dyads, other))]
    for mine, theirs in zip(*found, strict=True):
        assert (mine.limit, mine.label, mine.scale) == (theirs.limit, theirs.label, theirs.scale)
        assert float(mine.value) == pytest.approx(float(theirs.value), rel=1e-9, abs=1e-12), mine.label
    checks = [
        {check.name: check.value for check in validate(problem, values).checks if not check.name.endswith(("bounds", "as given"))}
        for problem, values in ((section, one), (dyads, other))
    ]
    own = {"psi0 is the rocker angle at phi0", "zero is the rocker angle at start"}
    assert checks[0].keys() - own == checks[1].keys() - own
    for name in checks[0].keys() - own:
        rough = name == "one circuit: no point jumps"  # measured between positions that count from +x
        assert checks[1][name] == pytest.approx(checks[0][name], rel=1e-3 if rough else 1e-6, abs=1e-9), name


# --- what is no four-bar ------------------------------------------------------------------------------------------------------


def ternary(body: str) -> dict[str, Any]:
    """Dyads whose crank or rocker has a joint that is not an end of its link."""
    links: dict[str, Any] = {
        "crank": {"joints": ["A", "B"], "length": "50 mm"},
        "coupler": {"joints": ["Q" if body == "crank" else "B", "C"], "length": "170 mm"},
        "rocker": {"joints": ["D", "C"], "length": "120 mm"},
    }
    if body == "crank":
        links["crank"]["points"] = {"Q": ["40 mm", "10 mm"]}
    else:
        links["rocker"] = {"joints": ["D", "E"], "length": "120 mm", "points": {"C": ["100 mm", "20 mm"]}}
    mode = "left of Q-D" if body == "crank" else "left of B-D"
    return {"ground": {"A": ["0 mm", "0 mm"], "D": ["180 mm", "0 mm"]}, "links": links, "assembly": {"C": mode}}


OTHERS: dict[str, optlink.ProblemFile] = {
    "six-bar": optlink.load("path-watt-leg"),
    "slider-crank": optlink.load("law-slider-crank"),
    **{
        f"joint beside the line of the {body}": optlink.read(
            {"title": "t", "mechanism": ternary(body), "requirement": {"kind": "transmission"}}
        )
        for body in ("crank", "rocker")
    },
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_linkages_are_not_recognised(name: str) -> None:
    problem = OTHERS[name]
    assert problem.spec.four_bar is None
    assert problem.spec.frame_angle is None
    assert problem.spec.task == "path"
    assert "limits.link_ratio" in problem.spec.inapplicable
    with pytest.raises(InputError, match="applies to a four-bar only"):
        problem.override({"limits.link_ratio": [0.1, 5.0]})


def test_a_law_of_a_four_bar_with_a_frame_of_any_direction_is_searched_as_before() -> None:
    """Its limits are those of a four-bar; its start angles have no fixed datum, so it has no convex first designs."""
    file = as_dyads(optlink.load("function-sin"))
    free = file.override({"mechanism.ground.D": [{"bounds": [f"-{FAR}", FAR]}, {"bounds": [f"-{FAR}", FAR]}]})
    assert free.spec.four_bar is not None
    assert free.spec.frame_angle is None
    assert free.spec.task == "path"
    coupler = file.override({"requirement.output": "coupler"})
    assert coupler.spec.task == "path"
    assert file.spec.task == "function"
    assert np.isfinite(file.spec.frame_bounds).all()


@pytest.mark.parametrize("angle", [0.0, 30.0, 180.0])
def test_the_total_length_counts_the_frame_however_the_four_bar_is_written(angle: float) -> None:
    objective: dict[str, Any] = {
        "objective": {"quantity": "total length"},
        "requirement.tolerance": "2.5 deg",
        "requirement.measure": "max",
        "requirement.points": 12,
    }
    section = optlink.load("crank-rocker", {**objective, "mechanism.frame": "500 mm"})
    other = as_dyads(section)
    x, y = 500.0 * math.cos(math.radians(angle)), 500.0 * math.sin(math.radians(angle))
    other = other.override({"mechanism.ground.D": [f"{x!r} mm", f"{y!r} mm"]})
    one, two = (optlink.solve(file, starts=1) for file in (section, other))
    assert one.valid
    assert two.valid, two.validation.failures
    assert two.objective == pytest.approx(one.objective, rel=1e-6)
    assert one.objective == pytest.approx(sum(one.design[name] for name in LENGTHS), rel=1e-9)
