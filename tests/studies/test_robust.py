"""Robust designs as problems of their own: by the law of cosines, samples of numpy, and searches independent of optlink."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.optimize import minimize
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.errors import InputError
from optlink.optimization.programme import build
from optlink.problem.tolerances import read_robust, with_tolerance
from optlink.studies import sensitivities, sweep, tolerance
from optlink.tasks import design as task
from optlink.tasks.design import validate
from optlink.validation import validate as prove
from tests.solved import solution
from tests.tiers import mostly_slow

SIZES = ("crank", "coupler", "rocker", "D.x", "D.y", "C.clearance")
SIGMAS = {
    "crank": 0.5e-3 / 3.0,
    "coupler": 1e-3 / 3.0,
    "rocker": 0.8e-3 / math.sqrt(3.0),
    "D.x": 1e-3 / 3.0,
    "D.y": 0.5e-3 / 3.0,
    "C.clearance": 0.2e-3 / math.sqrt(2.0),
}
ENDS = {"crank": 0.5e-3, "coupler": 1e-3, "rocker": 0.8e-3, "D.x": 1e-3, "D.y": 0.5e-3, "C.clearance": 0.2e-3}


@pytest.fixture(scope="module")
def problem():
    return optlink.load("crank-rocker-robust")


def solve(problem, backend="ipopt", starts=4):
    """Few of the usual 49 starting points: what is found is compared with formulas and searches outside optlink."""
    return task.solve(problem, backend, starts=starts)


def rocker_angle(phi, crank, coupler, rocker, dx, dy=0.0):
    """Two circles, by complex numbers: C is where the coupler from B and the rocker from D meet, left of B -> D."""
    b, d = crank * np.exp(1j * phi), dx + 1j * dy
    far = np.abs(d - b)
    along = (coupler**2 - rocker**2 + far**2) / (2.0 * far)
    c = b + (d - b) / far * (along + 1j * np.sqrt(coupler**2 - along**2))
    return np.angle(c - d)


def errors(coupler, rocker, by=None, count=31, law=None):
    """Wanted minus actual angle along the span of a linkage whose sizes are off by `by`; the start is that of the drawing."""
    reach = coupler + 0.1  # crank and coupler in line: the outer dead centre
    phi0 = math.acos((reach**2 + 0.25 - rocker**2) / (2.0 * 0.5 * reach))
    phi = phi0 + np.linspace(0.0, math.pi / 2.0, count)
    by = by or {}
    psi0 = rocker_angle(phi[:1], 0.1, coupler, rocker, 0.5)[0]
    stretched = coupler + by.get("coupler", 0.0) + by.get("C.clearance", 0.0)
    dx, dy = 0.5 + by.get("D.x", 0.0), by.get("D.y", 0.0)
    psi = rocker_angle(phi, 0.1 + by.get("crank", 0.0), stretched, rocker + by.get("rocker", 0.0), dx, dy)
    return psi0 + 2.0 / (3.0 * math.pi) * (phi - phi0) ** 2 - psi


def slopes(coupler, rocker, count=31):
    """Derivatives of the error by every size that deviates, in `SIZES`' order."""
    h = 1e-6
    return np.array(
        [(errors(coupler, rocker, {n: h}, count) - errors(coupler, rocker, {n: -h}, count)) / (2.0 * h) for n in SIZES]
    )


def figure(coupler, rocker, robust, dense=2001):
    """What is made least, by its definition: at the design positions, or the largest value over the whole span."""
    count = 31 if robust == "expected value" else dense
    error, by = errors(coupler, rocker, None, count), slopes(coupler, rocker, count)
    sigma = np.sqrt(np.sum((by * np.array(list(SIGMAS.values()))[:, None]) ** 2, axis=0))
    if robust == "worst case":
        return largest(np.abs(error) + np.sum(np.abs(by * np.array(list(ENDS.values()))[:, None]), axis=0))
    if robust == "expected value":
        return np.sum(error**2 + sigma**2)
    return largest(np.abs(error) + float(robust.split()[0]) * sigma)


def largest(values):
    """The largest of two ends and of the vertices of the parabolas through every local maximum and its neighbours."""
    before, middle, after = values[:-2], values[1:-1], values[2:]
    top = (middle >= before) & (middle >= after)
    before, middle, after = before[top], middle[top], after[top]
    return max(values[0], values[-1], *(middle - (after - before) ** 2 / (8.0 * (before - 2.0 * middle + after))))


def along_the_limit(robust):
    """The least figure where the largest transmission angle is 135 deg, crank and frame in line: one length is left."""

    def rocker_of(coupler):
        c = 2.0 * coupler * math.cos(math.radians(135.0))
        return 0.5 * (c + math.sqrt(c * c - 4.0 * (coupler**2 - 0.36)))

    grid = np.linspace(0.36, 0.46, 401)
    values = [figure(coupler, rocker_of(coupler), robust, 301) for coupler in grid]
    best = int(np.argmin(values))
    low, high = grid[best - 1], grid[best + 1]
    for _ in range(80):  # by thirds: the least of a largest has a corner, where parabolas do not help
        first, second = low + (high - low) / 3.0, high - (high - low) / 3.0
        if figure(first, rocker_of(first), robust) < figure(second, rocker_of(second), robust):
            high = second
        else:
            low = first
    return low, rocker_of(low), figure(low, rocker_of(low), robust)


# --- the objective -----------------------------------------------------------------------------------------------------

CASES = [("3 sigma", "max"), ("1.5 sigma", "max"), ("worst case", "max"), ("expected value", "sum of squares")]


@pytest.mark.parametrize(("robust", "measure"), mostly_slow(CASES, CASES[3]))
def test_a_robust_design_is_the_best_along_its_limit(problem, robust, measure):
    changed = problem.override({"requirement.robust": robust, "requirement.measure": measure})
    result = solve(changed, "both")
    assert result.valid, [check for check in result.validation.checks if not check.passed]
    coupler, rocker, least = along_the_limit(robust)
    assert result.objective == pytest.approx(least, rel=1e-7)
    assert result.design["coupler"] == pytest.approx(coupler, abs=2e-6)
    assert result.design["rocker"] == pytest.approx(rocker, abs=2e-6)
    assert result.objective == pytest.approx(figure(result.design["coupler"], result.design["rocker"], robust), rel=1e-8)


@pytest.mark.slow
def test_rms_is_the_root_of_the_mean_expected_square(problem):
    squares = solve(problem.override({"requirement.robust": "expected value", "requirement.measure": "sum of squares"}))
    rms = solve(problem.override({"requirement.robust": "expected value", "requirement.measure": "rms"}))
    assert rms.objective == pytest.approx(math.sqrt(squares.objective / 31.0), rel=1e-9)
    assert rms.design["coupler"] == pytest.approx(squares.design["coupler"], abs=1e-8)
    assert squares.best.measure == "expected sum of squares"
    assert rms.best.measure == "root of the expected mean square"


def test_the_expected_square_is_that_of_samples(problem):
    """Linkages of pseudo-random sizes, each moved exactly."""
    result = solve(problem.override({"requirement.robust": "expected value", "requirement.measure": "sum of squares"}))
    random, count = np.random.default_rng(4), 20_000
    by = {name: sigma * random.standard_normal((count, 1)) for name, sigma in SIGMAS.items()}
    by["rocker"] = 0.8e-3 * random.uniform(-1.0, 1.0, (count, 1))
    by["C.clearance"] = 0.2e-3 * np.cos(random.uniform(0.0, math.pi, (count, 1)))
    squares = np.sum(errors(result.design["coupler"], result.design["rocker"], by) ** 2, axis=1)
    assert result.objective == pytest.approx(np.mean(squares), abs=4.0 * np.std(squares) / math.sqrt(count))
    drawn = np.sum(errors(result.design["coupler"], result.design["rocker"]) ** 2)
    assert result.objective - drawn > 20.0 * np.std(squares) / math.sqrt(count)  # what tolerances add is no rounding


@pytest.mark.slow
def test_a_start_that_the_drawing_meets_is_judged_too(problem):
    """Built, the rocker is not where the drawing has it at the start; as drawn, it is by definition."""
    assert len(problem.spec.law.offsets) == 31
    assert len(problem.override({"requirement.robust": None}).spec.law.offsets) == 30
    assert solve(problem.override({"requirement.robust": None})).valid


@pytest.mark.slow
def test_no_sigma_and_no_mean_is_the_minimax_design(problem):
    none = solve(problem.override({"requirement.robust": "0 sigma"}))
    plain = solve(problem.override({"requirement.robust": None}))
    assert none.objective == pytest.approx(plain.objective, rel=1e-9)
    assert none.design["coupler"] == pytest.approx(plain.design["coupler"], abs=1e-9)


@pytest.mark.slow
def test_measured_deviations_shift_the_mean(problem, tmp_path):
    values = np.array([0.2, 0.5, 0.3, 0.9, 0.4]) * 1e-3
    (tmp_path / "parts.csv").write_text("coupler_mm\n" + "\n".join(f"{1e3 * v:.17g}" for v in values))
    for robust in ("2 sigma", "worst case"):
        changes = {"tolerances": {"coupler": str(tmp_path / "parts.csv")}, "requirement.robust": robust}
        result = solve(problem.override(changes))
        assert result.valid
        error = errors(result.design["coupler"], result.design["rocker"])
        by = slopes(result.design["coupler"], result.design["rocker"])[1]
        both = [error + by * d for d in ((values.min(), values.max()) if robust == "worst case" else (np.mean(values),))]
        spread = 0.0 if robust == "worst case" else 2.0 * np.std(values) * np.abs(by)
        assert result.objective == pytest.approx(max(np.max(np.abs(e) + spread) for e in both), rel=1e-8)


@pytest.mark.slow
def test_measured_pivots_move_as_they_are_measured(problem, tmp_path):
    """To which side matters: a pivot that is off one way turns the frame that way."""
    for pivot, way in (("A.x", -1.0), ("A.y", -1.0), ("D.y", 1.0)):
        (tmp_path / "pins.csv").write_text(f"{pivot}_mm\n1.0\n2.0\n")
        result = solve(problem.override({"tolerances": {pivot: str(tmp_path / "pins.csv")}, "requirement.robust": "0 sigma"}))
        assert result.valid, [check for check in result.validation.checks if not check.passed]
        same = {"A.x": "D.x", "A.y": "D.y"}.get(pivot, pivot)  # the frame carried along: the other pivot, the other way
        coupler, rocker, h = result.design["coupler"], result.design["rocker"], 1e-6
        by = (errors(coupler, rocker, {same: h}) - errors(coupler, rocker, {same: -h})) / (2.0 * h)
        assert result.objective == pytest.approx(np.max(np.abs(errors(coupler, rocker) + 1.5e-3 * way * by)), rel=1e-8)


@pytest.mark.slow
def test_a_function_is_robust_anywhere_in_its_range():
    """The largest error with its scatter along a fine grid, and the alternations that a minimax error has."""
    problem = optlink.load(
        "function-sin", {"tolerances": {"crank": "0.2 mm", "coupler": "0.2 mm"}, "requirement.robust": "3 sigma"}
    )
    result = solve(problem)
    assert result.valid
    plain = solution("function-sin")
    x = np.linspace(0.0, math.pi / 2.0, 4001)
    largest = []
    for design in (result.design, plain.design):
        side = 1.0 if (result if design is result.design else plain).definite.spec.four_bar.side > 0 else -1.0
        sizes = [design[name] for name in ("crank", "coupler", "rocker", "frame")]

        def psi(by=(0.0, 0.0), sizes=sizes, side=side, phi=design["phi0"] + x):
            angle = rocker_angle(side * phi, sizes[0] + by[0], sizes[1] + by[1], sizes[2], sizes[3])
            return side * angle

        target = design["psi0"] + np.sin(x) * math.pi / 2.0
        error = np.remainder(target - psi() + math.pi, 2.0 * math.pi) - math.pi
        h = 1e-7
        by = [(psi((h, 0.0)) - psi((-h, 0.0))) / (2.0 * h), (psi((0.0, h)) - psi((0.0, -h))) / (2.0 * h)]
        largest.append(np.max(np.abs(error) + 3.0 * np.hypot(*by) * 0.2e-3 / 3.0))
    assert result.objective == pytest.approx(largest[0], rel=1e-5)
    assert largest[0] < 0.9 * largest[1]  # and the design that is nominal optimum is worse when it is built


# --- prices ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_effect_of_a_tolerance_is_its_derivative(problem):
    result = sensitivities(problem, starts=4, check=True)
    assert result.gap < 1e-4
    coupler = result["tolerances.coupler"]
    assert coupler.parameter.value == pytest.approx(1e-3)
    assert coupler.parameter.unit == "m"
    low, high = (solve(problem.override({"tolerances.coupler": f"{1.0 + d} mm"})).objective for d in (-1e-3, 1e-3))
    assert coupler.objective == pytest.approx((high - low) / 2e-6, rel=1e-5)
    assert coupler.objective > 0.0
    assert coupler.below.value == -math.inf  # was -10 mm: a tolerance is not negative
    uniform, step = result["tolerances.rocker"], 1e-3
    low, high = (solve(problem.override({"tolerances.rocker": f"{0.8 + d} mm"})).objective for d in (-step, step))
    assert uniform.objective == pytest.approx((high - low) / (2e-3 * step), rel=1e-5)


@pytest.mark.slow
def test_shadow_prices_agree_with_relaxed_limits(problem):
    result = solve(problem)
    (held,) = [limit for limit in result.solution.displayed_limits if limit.multiplier]
    assert held.name == "largest transmission angle"
    low, high = (
        solve(problem.override({"limits.transmission_angle": ["45 deg", f"{135.0 + d} deg"]})).objective for d in (-1e-3, 1e-3)
    )
    assert held.multiplier == pytest.approx((high - low) / 2e-3, rel=1e-4)


def test_the_programme_is_differentiated_exactly(problem):
    for robust, measure in CASES:
        nlp = build(problem.override({"requirement.robust": robust, "requirement.measure": measure}).spec)
        x = nlp.lifted(nlp.x_of({"coupler": 0.41, "rocker": 0.235})) + (0.0 if measure == "max" else 1e-3)
        point, h = nlp.at(x, nlp.p), 1e-6
        for i in range(len(x)):
            step = h * np.eye(len(x))[i]
            (f1, g1), (f0, g0) = nlp.values(x + step, nlp.p), nlp.values(x - step, nlp.p)
            assert point.gradient[i] == pytest.approx((f1 - f0) / (2.0 * h), rel=1e-6, abs=1e-8)
            np.testing.assert_allclose(point.jacobian[:, i], (g1 - g0) / (2.0 * h), rtol=1e-5, atol=1e-6)


@pytest.mark.slow
def test_a_law_of_a_linkage_with_extra_points_is_drawn(tmp_path):
    place = 'mechanism.points={ P = ["10 mm", "5 mm"] }'
    result = run("solve", "crank-rocker", "--set", place, "--out", str(tmp_path), "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["design"]["coupler_mm"] == pytest.approx(412.86542, abs=1e-4)
    assert (tmp_path / "mechanism.png").stat().st_size > 5000


@pytest.mark.slow
def test_a_tolerance_without_effect_changes_nothing(problem):
    """Its standard deviation is nought everywhere, where a square root has no slope."""
    result = solve(problem.override({"mechanism.points": {"P": ["10 mm", "5 mm"]}, "tolerances": {"P.along": "1 mm"}}))
    plain = solve(problem.override({"requirement.robust": None}))
    assert result.valid
    assert result.objective == pytest.approx(plain.objective, abs=1e-10)


# --- the validator -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_validator_measures_the_error_with_tolerances_itself(problem):
    result = solve(problem)
    named = {check.name: check for check in result.validation.checks}
    assert named["error with tolerances measured in motion"].value < 1e-8
    assert named["error with tolerances, 3 sigma, has a value"].value == pytest.approx(math.degrees(result.objective))
    given = validate(problem, {"coupler": 0.42, "rocker": 0.225})
    assert given.objective == pytest.approx(figure(0.42, 0.225, "3 sigma"), rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("robust", "measure"), CASES)
def test_a_wrong_scatter_fails_validation(problem, robust, measure):
    changed = problem.override({"requirement.robust": robust, "requirement.measure": measure})
    result = solve(changed)
    plain = solve(changed.override({"requirement.robust": None}))
    assert plain.objective < result.objective
    for claim in (result.objective * (1.0 + 1e-5), plain.objective):
        failed = [check.name for check in prove(changed.spec, result.design, objective=claim).checks if not check.passed]
        assert failed == ["error with tolerances measured in motion"]


@pytest.mark.slow
def test_the_validator_fails_on_a_changed_linkage(problem):
    """The same lengths in the other assembly mode move otherwise, and so does what tolerances do."""
    result = solve(problem)
    mirrored = problem.override({"mechanism.assembly": "right"}).spec.linkage
    failed = [c.name for c in prove(problem.spec, result.design, None, result.objective, mirrored).checks if not c.passed]
    assert "error with tolerances measured in motion" in failed


# --- studies of a robust problem ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_sweep_over_a_tolerance_and_over_a_length(problem):
    result = sweep(problem, ["tolerances.rocker=0.2..1 mm:2"])
    assert result.valid
    for value, objective in zip(result.columns["tolerances.rocker_m"], result.columns["objective_rad"], strict=True):
        one = problem.override({"tolerances.rocker": {"tolerance": f"{value} m", "distribution": "uniform"}})
        assert objective == pytest.approx(solve(one).objective, rel=1e-8)
    lengths = sweep(problem, ["mechanism.frame=490..510 mm:2"])
    assert lengths.valid
    for value, objective in zip(lengths.columns["mechanism.frame_m"], lengths.columns["objective_rad"], strict=True):
        assert objective == pytest.approx(solve(problem.override({"mechanism.frame": value})).objective, rel=1e-8)
    counted = sweep(problem, ["requirement.robust=1..3 sigma:2"])
    assert counted.valid
    assert np.all(np.diff(counted.columns["objective_rad"]) > 0.0)


@pytest.mark.slow
def test_a_study_of_tolerances_reads_those_of_the_file(problem):
    result = tolerance(problem, limit="1.85 deg", samples=1 << 12)
    assert [d.name for d in result.deviations] == list(SIZES)
    for deviation in result.deviations:
        assert deviation.sigma == pytest.approx(SIGMAS[deviation.name])
    best = solve(problem)
    assert result.nominal.sizes["coupler"] == pytest.approx(best.design["coupler"])
    worst = np.max(np.abs(result.nominal.base) + 3.0 * result.sigma)
    assert worst == pytest.approx(best.objective, rel=1e-9)
    assert [d.name for d in tolerance(problem, ["coupler=0.1 mm"], samples=0, design=best.design).deviations] == ["coupler"]
    again = tolerance(problem, limit="1.85 deg", samples=1 << 12, robust=3.0)
    assert again.robust.result.design["coupler"] == pytest.approx(best.design["coupler"], abs=1e-8)
    assert again.unrobust.share < again.monte_carlo.share


@pytest.mark.slow
def test_costs_of_the_file_are_used_in_an_allocation(problem):
    given = {"limit": "2.2 deg", "target_yield": 0.99, "samples": 1 << 10, "design": solve(problem).design}
    allocation = tolerance(problem, **given).allocation
    assert allocation.costs.tolist() == [1.0, 1.0, 2.0, 1.0, 1.0, 1.0]
    assert tolerance(problem, costs={"rocker": 5.0}, **given).allocation.costs[2] == 5.0


# --- does it yield more -------------------------------------------------------------------------------------------------

SHAPES = {
    "normal": lambda random, shape: random.standard_normal(shape) / 3.0,
    "uniform": lambda random, shape: random.uniform(-1.0, 1.0, shape),
    "triangular": lambda random, shape: random.triangular(-1.0, 0.0, 1.0, shape),
    "contact": lambda random, shape: np.cos(random.uniform(0.0, math.pi, shape)),
}


def feeder(crank, frame, law, span, **requirement):
    """Two crank-rockers of no textbook."""
    free = {"bounds": [f"{0.2 * frame} mm", f"{2.5 * frame} mm"]}
    lengths = {"coupler": free | {"start": f"{0.9 * frame} mm"}, "rocker": free | {"start": f"{0.6 * frame} mm"}}
    return optlink.read(
        {
            "title": "Feeder",
            "mechanism": {"type": "four-bar", "crank": f"{crank} mm", "frame": f"{frame} mm", **lengths},
            "requirement": {"law": law, "span": span, "points": 24, **requirement},
            "limits": {"transmission_angle": ["40 deg", "140 deg"]},
        }
    )


def kept(design, law, span, limit, deviations, unit):
    """Which of the linkages with these deviations, shares of their tolerances, keep a limit [rad] at 31 angles of the span."""
    by = {d.name: d.tolerance * unit[:, i : i + 1] for i, d in enumerate(deviations)}
    phi = design["phi0"] + np.linspace(0.0, span, 31)
    target = law(phi - design["phi0"]) + design["psi0"]
    lengths = (design["crank"] + by.get("crank", 0.0), design["coupler"] + by.get("coupler", 0.0) + by.get("C.clearance", 0.0))
    dx = design["frame"] + by.get("frame", 0.0) + by.get("D.x", 0.0)
    psi = rocker_angle(phi, *lengths, design["rocker"] + by.get("rocker", 0.0), dx, by.get("D.y", 0.0))
    return np.max(np.abs(np.remainder(target - psi + math.pi, 2.0 * math.pi) - math.pi), axis=1) <= limit


PARABOLA = ("psi0 + 0.25*(phi - phi0)^2", lambda t: 0.25 * t**2)
BACK = ("psi0 - 0.22*(phi - phi0)^2", lambda t: -0.22 * t**2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("problem", "law", "span", "limit", "texts", "better"),
    [
        (
            optlink.load("crank-rocker"),
            lambda t: 2.0 / (3.0 * math.pi) * t**2,
            90.0,
            1.8,
            ["crank=0.5 mm", "coupler=1 mm", "rocker=0.8 mm", "frame=1.2 mm"],
            True,
        ),
        (
            feeder(60, 200, PARABOLA[0], "80 deg", measure="max"),
            PARABOLA[1],
            80.0,
            1.675,
            ["crank=0.3 mm", "coupler=0.5 mm", "rocker=0.4 mm uniform", "D.x=0.5 mm", "D.y=0.5 mm"],
            True,
        ),
        (
            feeder(45, 150, BACK[0], "90 deg", **{"from": "inner dead centre"}),
            BACK[1],
            90.0,
            0.8,
            ["crank=0.2 mm", "coupler=0.3 mm triangular", "rocker=0.3 mm", "D.x=0.3 mm uniform", "C.clearance=0.05 mm"],
            True,
        ),
        (  # margins that are even need not yield more than one weak angle, which is reported
            feeder(45, 150, BACK[0], "90 deg", **{"from": "inner dead centre", "measure": "max"}),
            BACK[1],
            90.0,
            0.6,
            ["crank=0.2 mm", "coupler=0.3 mm", "rocker=0.3 mm", "D.x=0.3 mm"],
            False,
        ),
    ],
)
def test_yield_of_the_design_with_the_largest_margin(problem, law, span, limit, texts, better):
    """The same linkages of pseudo-random sizes of both designs: how many more keep the limit."""
    result = tolerance(problem, texts, limit=f"{limit} deg", samples=1 << 14, robust="margin")
    assert result.robust.result.valid
    random, count = np.random.default_rng(8), 60_000
    unit = np.stack([SHAPES[d.shape](random, count) for d in result.deviations], axis=1)
    arguments = (law, math.radians(span), math.radians(limit), result.deviations, unit)
    own, before = (kept(design, *arguments) for design in (result.robust.result.design, result.robust.nominal))
    gained, lost = np.sum(own & ~before), np.sum(before & ~own)
    surplus = (gained - lost) / math.sqrt(gained + lost)  # standard deviations by which chance would favour either
    assert surplus > 5.0 if better else surplus < -3.0
    assert result.nominal_yields_more is not better
    for carlo, share in ((result.monte_carlo, np.mean(own)), (result.unrobust, np.mean(before))):
        assert carlo.share == pytest.approx(share, abs=4.0 * math.sqrt(max(share * (1.0 - share), 1e-4) / count))
        assert carlo.interval[0] <= carlo.share <= carlo.interval[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("problem", "law", "span", "limit", "texts"),
    [
        (
            optlink.load("crank-rocker"),
            lambda t: 2.0 / (3.0 * math.pi) * t**2,
            90.0,
            1.7,
            ["crank=0.5 mm", "coupler=1 mm", "rocker=0.8 mm", "frame=1.2 mm"],
        ),
        (  # where the most standard deviations yield less than the nominal optimum
            feeder(45, 150, BACK[0], "90 deg", **{"from": "inner dead centre", "measure": "max"}),
            BACK[1],
            90.0,
            0.6,
            ["crank=0.2 mm", "coupler=0.3 mm", "rocker=0.3 mm", "D.x=0.3 mm"],
        ),
    ],
)
def test_no_design_yields_more_than_the_one_with_most_yield(problem, law, span, limit, texts):
    """By linkages of pseudo-random sizes: not the nominal optimum, not the one with most standard deviations, none nearby."""
    result = tolerance(problem, texts, limit=f"{limit} deg", samples=1 << 14, robust="yield")
    assert result.robust.result.valid
    assert not result.nominal_yields_more
    random, count = np.random.default_rng(3), 40_000
    unit = np.stack([SHAPES[d.shape](random, count) for d in result.deviations], axis=1)
    arguments = (law, math.radians(span), math.radians(limit), result.deviations, unit)
    passing = kept(result.robust.result.design, *arguments)

    def surplus(design):
        """Standard deviations by which chance would favour the design that was found."""
        other = kept(design, *arguments)
        gained, lost = np.sum(passing & ~other), np.sum(other & ~passing)
        return (gained - lost) / math.sqrt(max(gained + lost, 1))

    margin = tolerance(problem, texts, limit=f"{limit} deg", samples=0, robust="margin").robust
    assert surplus(result.robust.nominal) > 3.0
    assert surplus(margin.result.design) > -1.0
    base, tried = result.robust.result.problem, 0
    while tried < 10:
        near = {name: value + random.normal() * 0.01 * abs(value) for name, value in result.robust.free.items()}
        if optlink.validate(base, near).valid:
            tried += 1
            assert surplus(base.spec.design(near)) > -2.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("texts", "limit", "target"),
    [
        (["crank=0.1 mm uniform", "coupler=0.1 mm uniform", "rocker=0.1 mm uniform", "D.x=0.1 mm uniform"], 2.4, 0.99),
        (["crank=0.1 mm uniform", "coupler=0.1 mm triangular", "rocker=0.1 mm", "D.y=0.1 mm", "C.clearance=0.1 mm"], 2.5, 0.9),
        (["coupler=0.1 mm uniform", "D.y=0.2 mm"], 2.35, 0.999),
        (["coupler=0.1 mm", "rocker=0.1 mm", "crank=0.1 mm"], 5.0, 0.9973),  # so wide that first order is not enough
    ],
)
def test_an_allocation_keeps_its_yield_whatever_the_distributions(texts, limit, target):
    design = {"coupler": 0.412865417, "rocker": 0.23224617}
    given = {"design": design, "target_yield": target, "samples": 1 << 14}
    result = tolerance(optlink.load("crank-rocker"), texts, limit=f"{limit} deg", **given)
    assert result.allocation.achieved
    random, count = np.random.default_rng(77), 100_000
    unit = np.stack([SHAPES[d.shape](random, count) for d in result.deviations], axis=1) * result.allocation.tolerances
    unit /= [d.tolerance for d in result.deviations]
    full = optlink.load("crank-rocker").spec.design(design)

    def law(t):
        return 2.0 / (3.0 * math.pi) * t**2

    share = np.mean(kept(full, law, math.pi / 2.0, math.radians(limit), result.deviations, unit))
    assert share == pytest.approx(target, abs=4.0 * math.sqrt(target * (1.0 - target) / count))


# --- the file ----------------------------------------------------------------------------------------------------------


def test_dotted_names_have_two_spellings(problem):
    raw = dict(problem.raw)
    nested = {name: entry for name, entry in raw["tolerances"].items() if "." not in name}
    nested |= {"D": {"x": "1 mm", "y": "0.5 mm"}, "C": {"clearance": "0.2 mm"}}
    again = optlink.read({**raw, "tolerances": nested})
    assert again.spec.deviations == problem.spec.deviations
    moved = again.override({"tolerances.D.x": "2 mm"})
    assert {d.name: d.tolerance for d in moved.spec.deviations}["D.x"] == pytest.approx(2e-3)
    assert len(moved.spec.deviations) == len(problem.spec.deviations)
    assert len(again.override({"tolerances.D.x": None}).spec.deviations) == len(problem.spec.deviations) - 1


def test_a_new_tolerance_keeps_distribution_and_cost():
    table = {"coupler": "0.1 mm uniform", "rocker": {"tolerance": "1 mm", "cost": 3}}
    with_tolerance(table, "coupler", "0.2 mm")
    with_tolerance(table, "rocker", "2 mm triangular")
    with_tolerance(table, "crank", "0.1 mm")
    assert table == {
        "coupler": {"tolerance": "0.2 mm", "distribution": "uniform"},
        "rocker": {"tolerance": "2 mm", "distribution": "triangular", "cost": 3.0},
        "crank": "0.1 mm",
    }
    with_tolerance(table, "coupler", "0.2 mm normal")
    assert table["coupler"] == {"tolerance": "0.2 mm", "distribution": "normal"}
    with_tolerance(table, "coupler", {"tolerance": "0.3 mm"})
    assert table["coupler"] == {"tolerance": "0.3 mm"}


def test_the_hash_includes_measured_deviations(problem, tmp_path):
    file = tmp_path / "parts.csv"
    hashes = []
    for last in ("0.1", "0.2"):
        file.write_text(f"coupler_mm\n0.0\n{last}\n")
        hashes.append(problem.override({"tolerances": {"coupler": str(file)}}).hash)
    assert hashes[0] != hashes[1]


def run(*arguments):
    return CliRunner().invoke(app, list(arguments))


@pytest.mark.slow
def test_the_command_solves_reports_and_validates(problem, tmp_path):
    result = run("solve", "crank-rocker-robust", "--backend", "both", "--starts", "3", "--json", "--out", str(tmp_path))
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert document["objective"]["robust"] == "3 sigma"
    assert document["objective"]["measure"] == "max"
    assert document["objective"]["tolerances_SI"]["coupler"] == pytest.approx(1e-3)
    assert document["objective"]["largest_deg"] < math.degrees(document["objective"]["value"])
    command = run("solve", "crank-rocker-robust", "--set", "tolerances.coupler=2 mm")
    assert command.exit_code == 0, command.output
    assert "largest error with 3 sigma" in command.output
    checked = run("validate", "crank-rocker-robust", "--design", str(tmp_path / "result.json"))
    assert checked.exit_code == 0, checked.output
    shown = run("show", "crank-rocker-robust").output
    assert "[tolerances]" in shown
    assert "±0.8 mm uniform, cost 2" in shown


@pytest.mark.slow
def test_other_kinds_of_problems_are_not_robust():
    with pytest.raises(InputError, match="needs tolerances"):
        optlink.load("path-arc5", {"requirement.robust": "3 sigma"})
    with pytest.raises(InputError, match="unknown key"):
        optlink.load("shaper-design", {"objective.robust": "3 sigma"})
    path = optlink.load("path-arc5", {"tolerances": {"coupler": "0.01 mm", "P.along": "0.01 mm"}})
    result = tolerance(path, output="P.x", samples=0)
    assert [d.name for d in result.deviations] == ["coupler", "P.along"]
    with pytest.raises(InputError, match="unknown dimension"):
        optlink.load("path-arc5", {"tolerances": {"couplr": "0.01 mm"}})


def test_spellings():
    assert read_robust("2.5 sigma").sigmas == 2.5
    assert read_robust("2 sigma").named("max") == "max with 2 sigma"
    assert read_robust(None) is None


@pytest.mark.slow
def test_worst_case_whose_tolerances_change_sign_at_the_worst_angle():
    """Where the effect of a tolerance on the critical error vanishes, the worst case has a kink: the optimum lies on one."""
    crank, frame, clockwise = 0.09, 0.26, np.radians(-80.0) * np.linspace(0.0, 1.0, 4001)
    problem = optlink.read(
        {
            "title": "A lever in proportion to a crank that turns clockwise",
            "mechanism": {
                "type": "four-bar",
                "crank": "90 mm",
                "frame": "260 mm",
                "coupler": {"start": "250 mm", "bounds": ["100 mm", "500 mm"]},
                "rocker": {"start": "150 mm", "bounds": ["80 mm", "400 mm"]},
                "assembly": "right",
            },
            "tolerances": {name: f"{1e3 * size} mm" for name, size in ENDS.items()},
            "requirement": {
                "kind": "function",
                "law": "psi0 + 0.45*(phi - phi0)",
                "from": {"start": "280 deg", "bounds": ["180 deg", "360 deg"]},
                "span": "-80 deg",
                "points": 16,
                "measure": "max",
                "robust": "worst case",
            },
            "limits": {"crank": "span", "transmission_angle": ["40 deg", "140 deg"]},
        }
    )

    def worst(design):
        coupler, rocker, phi0 = design
        phi = phi0 + clockwise  # the whole span

        def angle(by):
            sizes = np.array([crank, coupler, rocker, frame, 0.0]) + by
            return -rocker_angle(-phi, *sizes[:4], -sizes[4])  # the mirror image of C to the left

        error = angle(np.zeros(5))[0] + 0.45 * clockwise - angle(np.zeros(5))
        steps = 1e-6 * np.eye(5)
        by = np.array([(angle(step) - angle(-step)) / 2e-6 for step in steps])
        by = np.vstack([by, by[1]])
        return np.max(np.abs(error) + np.sum(np.abs(by) * np.array(list(ENDS.values()))[:, None], axis=0))

    best = minimize(worst, (0.281, 0.196, 5.01), method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-13, "maxfev": 2000})
    for backend in ("ipopt", "slsqp"):
        result = solve(problem, backend, starts=1)
        assert result.valid, [check for check in result.validation.checks if not check.passed]
        assert result.objective == pytest.approx(best.fun, rel=1e-5)
        assert result.objective <= best.fun * (1.0 + 1e-6)
        assert result.objective == pytest.approx(worst([result.design[name] for name in ("coupler", "rocker", "phi0")]), rel=1e-6)
