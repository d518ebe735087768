"""Designs with linked quantities against own formulas: geometry by the cosine theorem and scans, without optlink."""

from __future__ import annotations

import json
import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

import optlink
from optlink.optimization.programme import build
from optlink.optimization.taylor_model import TaylorModel
from optlink.problem.file import read
from optlink.problem.machine.model import Problem
from optlink.problem.targets.expression import FUNCTIONS
from optlink.studies import tolerance
from optlink.studies.grid import Axis, Grid
from optlink.studies.reoptimise_task import optimum_task
from optlink.synthesis.batch import Batch

Array = NDArray[np.float64]


def golden(f: Callable[[float], float], low: float, high: float) -> float:
    """Place of the least value of a unimodal function."""
    share = 0.5 * (math.sqrt(5.0) - 1.0)
    for _ in range(100):
        a, b = high - share * (high - low), low + share * (high - low)
        low, high = (low, b) if f(a) < f(b) else (a, high)
    return 0.5 * (low + high)


def rocker(crank: float, coupler: float, rocker: float, frame: float, phi: Array) -> Array:
    """Rocker angles of a four-bar with C to the left of B -> D."""
    x, y = crank * np.cos(phi) - frame, crank * np.sin(phi)
    square = x * x + y * y
    return np.arctan2(y, x) - np.arccos((rocker**2 + square - coupler**2) / (2.0 * rocker * np.sqrt(square)))


# --- a steering trapezoid -------------------------------------------------------------------------------------------------


def steering_error(arm: float, half: float, span: float, count: int) -> float:
    """Largest error [rad] of a trapezoid whose arms stand at an angle `arm` from straight ahead; 400 and 2400 mm."""
    turned = np.linspace(0.0, span, count) - half
    right = rocker(0.4, 2.4 - 0.8 * math.sin(arm), 0.4, 2.4, 0.5 * math.pi - arm + turned)
    law = np.arctan(np.tan(turned) / (1.0 - 0.5 * np.tan(turned)))
    return float(np.max(np.abs(right - (0.5 * math.pi + arm) - law)))


@pytest.mark.parametrize(
    ("changes", "half", "span"),
    [
        ({}, math.radians(40.0), math.radians(70.5874453)),
        (
            {
                "requirement.law": "psi0 + 0.540420 + atan(tan(phi - phi0 - 0.698132)/(1 - 0.5*tan(phi - phi0 - 0.698132)))",
                "requirement.psi0": {"equals": "180 deg - 0.698132 rad - 0.540420 rad - start"},
                "mechanism.coupler": {"equals": "frame - 2*crank*cos(start + 0.698132 rad)"},
                "requirement.span": "70.964 deg",
            },
            0.698132,
            math.radians(70.964),
        ),
    ],
    ids=["up to 40 deg", "a little beyond, with decimals"],
)
def test_the_best_symmetric_trapezoid_is_that_of_a_scan(changes, half, span):
    arm = golden(lambda a: steering_error(a, half, span, 40001), math.radians(14.0), math.radians(22.0))
    result = optlink.solve(optlink.load("steering-trapezoid", changes))
    assert result.valid
    assert result.objective == pytest.approx(steering_error(arm, half, span, 40001), rel=1e-7)
    assert 0.5 * math.pi - half - result.design["phi0"] == pytest.approx(arm, abs=1e-8)
    assert result.design["rocker"] == result.design["crank"] == 0.4
    assert result.design["coupler"] == pytest.approx(2.4 - 0.8 * math.sin(arm), abs=1e-8)


# --- a law from the outer dead centre, rocker = 0.5 coupler + 3 mm ------------------------------------------------------------

LAW = """
[mechanism]
frame = "500 mm"
crank = "100 mm"
coupler = { start = "400 mm", bounds = ["100 mm", "900 mm"] }
rocker = { equals = "0.5*coupler + 3 mm" }
[requirement]
law = "psi0 + 2/(3*pi)*(phi - phi0)^2"
span = "90 deg"
[limits]
transmission_angle = ["40 deg", "140 deg"]
"""


def law_error(coupler: float) -> float:
    """Sum of squared errors [rad^2] over 60 positions from the outer dead centre."""
    b = 0.5 * coupler + 0.003
    reach = 0.1 + coupler
    start = math.acos((reach**2 + 0.25 - b**2) / (2.0 * reach * 0.5))
    psi = rocker(0.1, coupler, b, 0.5, start + np.radians(90.0) * np.arange(61) / 60.0)
    turned = np.radians(90.0) * np.arange(61) / 60.0
    return float(np.sum((psi - psi[0] - 2.0 / (3.0 * math.pi) * turned**2) ** 2))


def test_the_best_coupler_with_half_a_rocker_is_that_of_a_scan():
    coupler = golden(law_error, 0.43, 0.48)
    result = optlink.solve(read(LAW), "both")
    assert result.valid
    assert result.objective == pytest.approx(law_error(coupler), rel=1e-10)
    assert result.design["coupler"] == pytest.approx(coupler, abs=1e-7)
    assert result.design["rocker"] == pytest.approx(0.5 * coupler + 0.003, abs=1e-7)
    assert result.certificate is not None
    assert result.certificate.status == "global"
    assert result.certificate.lower_bound <= result.objective


def test_a_bound_of_the_link_is_a_limit_with_its_name_and_price():
    bounded = read(LAW).override({"mechanism.rocker": {"equals": "0.5*coupler + 3 mm", "bounds": ["150 mm", "225 mm"]}})
    result = optlink.solve(bounded)
    assert result.valid
    assert result.design["coupler"] == pytest.approx(0.444, abs=1e-9)
    assert result.objective == pytest.approx(law_error(0.444), rel=1e-8)
    (limit,) = [limit for limit in result.limits if limit.active]
    assert (limit.name, limit.key) == ("rocker", "mechanism.rocker")
    slope = (law_error(0.444 + 1e-6) - law_error(0.444 - 1e-6)) / 1e-6  # per metre of the rocker: two of the coupler
    assert limit.effect == pytest.approx(abs(slope), rel=1e-4)
    assert slope < 0.0
    impossible = optlink.solve(bounded.override({"mechanism.rocker.max": "160 mm"}))
    assert impossible.conflict
    assert any(item.name == "rocker" for item in impossible.conflict)


def test_a_design_that_breaks_a_link_or_its_bounds_is_not_valid():
    problem = read(LAW.replace('3 mm" }', '3 mm", bounds = "150..230 mm" }'))
    design = {"coupler": 0.45, "rocker": 0.228}
    assert optlink.validate(problem, design).valid
    assert optlink.validate(problem, {"coupler": 0.45}).objective == optlink.validate(problem, design).objective
    broken = optlink.validate(problem, design | {"rocker": 0.228 + 1e-7})
    assert [check.name for check in broken.validation.checks if not check.passed] == ["rocker = 0.5*coupler + 3 mm"]
    wide = optlink.validate(problem, {"coupler": 0.46})
    assert [check.name for check in wide.validation.checks if not check.passed] == ["rocker within its bounds"]


def test_a_length_that_may_vanish_is_kept_above_zero():
    text = LAW.replace('"0.5*coupler + 3 mm"', '"coupler - 399 mm"').replace('["40 deg", "140 deg"]', '["5 deg", "175 deg"]')
    result = optlink.solve(read(text + 'crank = "span"\n'))
    assert result.design["rocker"] > 0.0
    assert any(limit.key == "mechanism.rocker" for limit in result.limits)
    assert not any(limit.key == "mechanism.rocker" for limit in optlink.solve(read(LAW)).limits)  # a sum of lengths


def test_deviations_are_those_of_the_parts_not_of_the_link():
    linked = optlink.solve(read(LAW))
    lengths = {f"mechanism.{name}": linked.design[name] for name in ("coupler", "rocker")}
    fixed = read(LAW).override(lengths)
    tolerances = ["crank=0.1 mm", "coupler=0.1 mm", "rocker=0.1 mm"]
    one = tolerance(read(LAW), tolerances, design={"coupler": linked.design["coupler"]}, samples=1 << 10)
    other = tolerance(fixed, tolerances, samples=1 << 10)
    assert len(one.deviations) == 3
    np.testing.assert_allclose(one.by, other.by, rtol=1e-9)


@pytest.mark.slow
def test_a_sweep_carries_the_link_along_and_an_axis_replaces_it():
    problem = read(LAW)
    for key in ("mechanism.crank", "mechanism.rocker"):
        grid = Grid((Axis(key, "mm", (95.0, 105.0) if key == "mechanism.crank" else (220.0, 230.0)),))
        lines = optimum_task(problem, grid, "ipopt", 2).lines(0)
        for point, line in enumerate(lines):
            alone = optlink.solve(problem.override(grid.changes(point)))
            assert float(line[1]) == pytest.approx(alone.design["coupler"], rel=1e-6)
            assert float(line[2]) == pytest.approx(alone.objective, rel=1e-8)


def test_many_designs_follow_the_link():
    problem = read(LAW.split("[requirement]")[0])
    couplers = np.array([0.4, 0.45])
    linked = optlink.analyze_batch(problem, {"coupler": couplers}, ["rocker.angle_rad"], points=12)
    stated = optlink.analyze_batch(
        problem, {"coupler": couplers, "rocker": 0.5 * couplers + 0.003}, ["rocker.angle_rad"], points=12
    )
    other = optlink.analyze_batch(problem, {"coupler": couplers, "rocker": [0.2, 0.2]}, ["rocker.angle_rad"], points=12)
    np.testing.assert_array_equal(linked["rocker.angle_rad"], stated["rocker.angle_rad"])
    assert not np.allclose(linked["rocker.angle_rad"], other["rocker.angle_rad"])
    by_hand = rocker(0.1, 0.45, 0.228, 0.5, 2.0 * math.pi * np.arange(12) / 12.0)
    np.testing.assert_allclose(np.cos(linked["rocker.angle_rad"][1] - by_hand), 1.0, atol=1e-12)


# --- paths, transmission, strokes ---------------------------------------------------------------------------------------------

PARALLELOGRAM = """
[mechanism]
crank = "20..200 mm"
rocker = { equals = "crank" }
coupler = "80..600 mm"
frame = { equals = "coupler" }
pivot = ["0..200 mm", { equals = "A.x - 20 mm" }]
points.P = [{ equals = "0.5*coupler" }, "10..100 mm"]
[requirement]
kind = "path"
point = "P"
points = { x = "150 + 60*cos(t)", y = "140 + 60*sin(t)", unit = "mm", t = [0.5, 2.6], points = 12 }
[limits]
crank = "span"
"""


def test_the_points_of_a_parallelogram_trace_circles():
    result = optlink.solve(read(PARALLELOGRAM))
    values = result.best.values
    assert result.valid
    assert result.objective < 1e-24
    assert values["crank"] == values["rocker"] == pytest.approx(0.06, abs=1e-9)
    assert values["frame"] == values["coupler"]
    assert values["A.y"] == pytest.approx(values["A.x"] - 0.02, abs=1e-15)
    assert values["A.x"] + 0.5 * values["coupler"] == pytest.approx(0.15, abs=1e-9)
    assert values["A.y"] + values["P.across"] == pytest.approx(0.14, abs=1e-9)


TRANSMISSION = """
[mechanism]
frame = "300 mm"
crank = "60 mm"
coupler = "100..400 mm"
rocker = { equals = "coupler" }
[requirement]
kind = "transmission"
"""
TRANSMISSION_BY_DYADS = """
[mechanism.ground]
A = ["0 mm", "0 mm"]
D = ["300 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "60 mm" }
coupler = { joints = ["B", "C"], length = "100..400 mm" }
rocker = { joints = ["C", "D"], length = { equals = "coupler.length" } }
[mechanism.assembly]
C = "left of B-D"
[requirement]
kind = "transmission"
"""


@pytest.mark.parametrize("text", [TRANSMISSION, TRANSMISSION_BY_DYADS], ids=["four-bar", "dyads"])
def test_equal_links_transmit_best_at_the_root_of_the_mean_square(text):
    """The cosines at the extremes, (2 b^2 - (f -+ a)^2)/(2 b^2), are opposite at b^2 = (f^2 + a^2)/2."""
    result = optlink.solve(read(text))
    length = math.sqrt(0.5 * (0.3**2 + 0.06**2))
    assert result.valid
    assert result.objective == pytest.approx(1.0 - 0.24**2 / (2.0 * length**2), rel=1e-8)
    for name in ("coupler", "rocker"):
        assert result.best.values.get(name, result.best.values.get(f"{name}.length")) == pytest.approx(length, rel=1e-6)


@pytest.mark.slow
def test_a_rod_of_three_cranks_has_the_pressure_angle_of_a_third():
    problem = read("""
[mechanism.ground]
A = ["0 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "20..200 mm" }
rod = { joints = ["B", "C"], length = { equals = "3*crank.length", bounds = "60..600 mm" } }
slider = { joints = ["C"] }
[mechanism.guides]
slide = { slider = "slider", through = "A" }
[mechanism.assembly]
C = "forward"
[requirement]
kind = "stroke"
output = "slide"
stroke = "100 mm"
""")
    result = optlink.solve(problem)
    assert result.valid
    assert result.objective == pytest.approx(math.asin(1.0 / 3.0), rel=1e-8)
    assert result.design == pytest.approx({"A.x": 0.0, "A.y": 0.0, "crank.length": 0.05, "rod.length": 0.15})
    short = optlink.solve(problem.override({"mechanism.links.rod.length.max": "140 mm"}))
    assert not short.valid  # a stroke of 100 mm needs a rod of 150 mm
    longest = {"quantity": "stroke", "of": "slide", "sense": "maximise"}
    most = optlink.solve(
        problem.override(
            {"objective": longest, "requirement.stroke": ["50 mm", "500 mm"], "mechanism.links.rod.length.max": "240 mm"}
        )
    )
    assert most.valid
    assert most.design["crank.length"] == pytest.approx(0.08, rel=1e-8)
    assert [limit.key for limit in most.limits if limit.active] == ["mechanism.links.rod.length"]
    broken = optlink.validate(problem, {"crank.length": 0.05, "rod.length": 0.151})
    assert [check.name for check in broken.validation.checks if not check.passed] == ["rod.length = 3*crank.length"]


def test_a_linked_start_moves_the_crank_angles_of_the_batch():
    """Derivatives of the batched residuals against central differences."""
    problem = read("""
[mechanism.ground]
A = ["0 mm", "0 mm"]
D = ["200..400 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "60..90 mm" }
coupler = { joints = ["B", "C"], length = { equals = "D.x - 10 mm" } }
rocker = { joints = ["C", "D"], length = "150..190 mm" }
[mechanism.assembly]
C = "left of B-D"
[requirement]
kind = "function"
output = "rocker"
law = "psi0 + 0.3*(phi - phi0)"
start = { equals = "90 deg - asin(crank.length/D.x)" }
span = "60 deg"
points = 5
""").model
    batch = Batch(problem)
    rng = np.random.default_rng(1)
    x = batch.low + (batch.high - batch.low) * rng.random((3, len(batch.names)))
    values = batch.values(x)
    np.testing.assert_allclose(values["start"], math.pi / 2.0 - np.arcsin(values["crank.length"] / values["D.x"]), rtol=1e-15)
    t = batch.crank_angles(x, np.empty(0))
    np.testing.assert_allclose(t, values["start"] + problem.data.offsets, rtol=1e-15)
    _, slopes, _ = batch.residuals(x, t)
    for i in range(x.shape[1]):
        step = np.zeros(x.shape[1])
        step[i] = 1e-6
        over, under = (
            batch.residual_values(x + sign * step, batch.crank_angles(x + sign * step, np.empty(0))) for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(slopes[..., i], (over - under) / 2e-6, rtol=1e-6, atol=1e-8)


# --- certificates -------------------------------------------------------------------------------------------------------------


def test_certificates_of_linked_designs_hold_or_are_refused_with_a_reason():
    proven = optlink.solve(read(TRANSMISSION), certify=True)
    assert proven.certificate is not None
    assert proven.certificate.status == "global"
    wanted = 1.0 - 0.24**2 / (0.3**2 + 0.06**2)
    assert proven.certificate.lower_bound == pytest.approx(wanted, rel=1e-6)
    with pytest.raises(optlink.InputError, match="crank angles at the points are unknowns"):
        optlink.solve(read(PARALLELOGRAM), certify=True)


def test_results_are_read_again_with_their_links(tmp_path):
    result = optlink.solve(read(LAW))
    document = json.loads(json.dumps(result.to_dict()))
    assert document["design"]["rocker_mm"] == pytest.approx(1e3 * result.design["rocker"])
    (tmp_path / "result.json").write_text(json.dumps(document), encoding="utf-8")
    again = optlink.read_result(tmp_path / "result.json")
    assert again.design == result.design
    assert again.problem.model.quantities["rocker"].equals == "0.5*coupler + 3 mm"


# --- deviations in the objective ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_robust_objective_has_the_deviations_of_the_parts():
    """At the same dimensions the scatter of a linked rocker is that of a stated one."""
    changes = {"requirement.measure": "max", "requirement.robust": "3 sigma", "tolerances.coupler": "0.1 mm"}
    linked = read(LAW).override({**changes, "tolerances.rocker": "0.1 mm"})
    design = {"coupler": 0.45}
    stated = linked.override({"mechanism.rocker": "228 mm"})
    one, other = (optlink.validate(problem, design) for problem in (linked, stated))
    assert one.objective == pytest.approx(other.objective, rel=1e-12)
    assert one.objective > optlink.validate(read(LAW).override({"requirement.measure": "max"}), design).objective
    result = optlink.solve(linked)
    assert result.valid
    assert result.design["rocker"] == pytest.approx(0.5 * result.design["coupler"] + 0.003, rel=1e-15)


def test_an_angle_from_which_others_follow_is_not_periodic():
    """With psi0 = 0.5 start, a start angle a revolution later is another design."""
    free = LAW.replace("[limits]", 'from = "-180..180 deg"\npsi0 = "0..180 deg"\n[limits]')
    linked = free.replace('psi0 = "0..180 deg"', 'psi0 = { equals = "0.5*start + 90 deg" }')
    assert [v.periodic for v in build(read(free).model).variables if v.name == "phi0"] == [True]
    assert [v.periodic for v in build(read(linked).model).variables if v.name == "phi0"] == [False]


def test_links_hold_for_every_requirement_of_one_linkage():
    """Points and rocker angles of the four-bar 40, 110, 80, 120 mm with P (60, 35): the design is exact, as are its links."""
    at = np.radians([20.0, 60.0, 110.0, 180.0, 250.0])
    psi = np.unwrap(rocker(0.04, 0.11, 0.08, 0.12, at))
    turned = np.arctan2(0.08 * np.sin(psi) - 0.04 * np.sin(at), 0.12 + 0.08 * np.cos(psi) - 0.04 * np.cos(at))
    x = 40.0 * np.cos(at) + 60.0 * np.cos(turned) - 35.0 * np.sin(turned)
    y = 40.0 * np.sin(at) + 60.0 * np.sin(turned) + 35.0 * np.cos(turned)
    problem = optlink.read(
        {
            "mechanism": {
                "crank": {"equals": "0.5*rocker"},
                "coupler": "80..150 mm",
                "rocker": "50..100 mm",
                "frame": {"equals": "coupler + 10 mm"},
                "points": {"P": [{"equals": "rocker - 20 mm"}, "0..80 mm"]},
            },
            "requirements": [
                {
                    "kind": "path",
                    "point": "P",
                    "points": [
                        {"x": f"{a!r} mm", "y": f"{b!r} mm", "crank": f"{c!r} rad"}
                        for a, b, c in zip(x.tolist(), y.tolist(), at.tolist(), strict=True)
                    ],
                    "weight": 1.0,
                },
                {
                    "kind": "function",
                    "law": {name: [f"{angle!r} rad" for angle in angles.tolist()] for name, angles in (("phi", at), ("psi", psi))}
                    | {"measured_from": "frame"},
                    "weight": 1.0,
                },
            ],
            "limits": {"transmission_angle": ["20 deg", "160 deg"]},
        }
    )
    free = {"coupler": 0.11, "rocker": 0.08, "P.across": 0.035}
    assert set(problem.model.free) == set(free)
    design = problem.model.design(free)
    lengths = {"crank": 0.04, "frame": 0.12, "P.along": 0.06}
    assert {name: design[name] for name in lengths} == pytest.approx(lengths, rel=1e-14)
    exact = optlink.validate(problem, free)
    assert exact.valid
    assert exact.objective < 1e-18
    broken = optlink.validate(problem, free | {"crank": 0.041})
    assert "crank = 0.5*rocker" in [check.name for check in broken.validation.checks if not check.passed]


def test_quantities_of_several_requirements_can_be_linked():
    problem = optlink.read(
        {
            "mechanism": {
                "crank": "40 mm",
                "coupler": {"equals": "100 mm + 10 mm*function.phi0/(30 deg)"},
                "rocker": "50..100 mm",
                "frame": "120 mm",
                "points": {"P": ["60 mm", "35 mm"]},
            },
            "requirements": [
                {"kind": "path", "point": "P", "points": [["50 mm", "60 mm"], ["30 mm", "70 mm"], ["20 mm", "50 mm"]]},
                {
                    "kind": "function",
                    "law": "psi0 + 0.2*(phi - phi0)",
                    "span": "40 deg",
                    "from": "20..40 deg",
                    "psi0": {"equals": "2*function.phi0"},
                    "tolerance": "20 deg",
                    "measure": "max",
                },
            ],
        }
    )
    values = problem.model.design({})
    assert values["coupler"] == pytest.approx(0.11)
    assert values["function.psi0"] == pytest.approx(math.radians(60.0))
    moved = problem.model.design({"function.phi0": math.radians(24.0)})
    assert (moved["coupler"], moved["function.psi0"]) == pytest.approx((0.108, math.radians(48.0)))


ARGUMENTS = {"sin": "30 deg*coupler/frame", "cos": "30 deg*coupler/frame", "tan": "30 deg*coupler/frame"}


@pytest.mark.parametrize("name", [*FUNCTIONS, "^"])
def test_every_function_of_a_link_is_bounded_over_boxes(name):
    """A link with any function allows a certificate: its values in a box lie within the bounds there."""
    term = f"{name}({ARGUMENTS.get(name, 'coupler/frame + 0.1')})" if name != "^" else "(coupler/frame)^1.5"
    term = f"{term}/(60 deg)" if name in ("asin", "acos", "atan") else f"(2 + {term})"
    problem = read(LAW).override({"mechanism.rocker": {"equals": f"0.5*frame*{term}"}, "mechanism.coupler": "395..405 mm"}).model
    low, high = np.array([[0.395]]), np.array([[0.405]])
    values = problem.complete({"coupler": np.linspace(0.395, 0.405, 101)})["rocker"]
    bounds = Problem.complete(problem, {"coupler": TaylorModel.unknowns(low, high)[0]})["rocker"]
    assert np.min(bounds.low) <= np.min(values)
    assert np.max(values) <= np.max(bounds.high)
    assert np.max(bounds.high) - np.min(bounds.low) < 1.1 * np.ptp(values) + 1e-12
