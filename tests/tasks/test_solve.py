"""Search and proof on variations of the crank-rocker: other limits, laws, measures, freedoms, starts."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

import optlink
from optlink.errors import Status
from optlink.linkage.fourbar import LENGTHS, crank_rocker_conditions, transmission_cosine
from optlink.optimization.programme import build
from optlink.solvers import multistart
from optlink.solvers.infeasibility import Explanation, explain
from optlink.solvers.solution import verified_solution
from optlink.tasks.results.conflict import outward
from tests.tiers import mostly_slow

BACKENDS = ("slsqp", "ipopt")
TABLE = {
    "phi": [f"{15 * k} deg" for k in range(7)],
    "psi": [f"{math.degrees(2 / (3 * math.pi) * math.radians(15 * k) ** 2):.9f} deg" for k in range(7)],
}
VARIATIONS = {
    "transmission 40..140": {"limits.transmission_angle": ["40 deg", "140 deg"]},
    "transmission 50..130": {"limits.transmission_angle": ["50 deg", "130 deg"]},
    "frame 480": {"mechanism.frame": "480 mm"},
    "frame 520": {"mechanism.frame": "520 mm"},
    "measure max": {"requirement.measure": "max"},
    "measure rms": {"requirement.measure": "rms"},
    "span 60": {"requirement.span": "60 deg"},
    "linear law": {"requirement.law": "psi0 + 0.3*(phi - phi0)"},
    "law as a table": {"requirement.law": TABLE},
    "frame free": {"mechanism.frame": {"start": "500 mm", "bounds": ["450 mm", "550 mm"]}},
    "phi0 free": {"requirement.from": {"start": "40 deg", "bounds": ["0 deg", "360 deg"]}},
    "phi0 and psi0 free": {
        "requirement.from": {"start": "40 deg", "bounds": ["0 deg", "180 deg"]},
        "requirement.psi0": {"start": "100 deg", "bounds": ["60 deg", "150 deg"]},
    },
    "inner dead centre": {
        "requirement.from": "inner dead centre",
        "requirement.law": "psi0 - 2/(3*pi)*(phi - phi0)^2",
        "mechanism.crank": "110 mm",
    },
    "clockwise": {"requirement.span": "-90 deg"},
    "assembly right, mirrored": {
        "mechanism.assembly": "right",
        "requirement.law": "psi0 - 2/(3*pi)*(phi - phi0)^2",
        "requirement.span": "-90 deg",
    },
    "span only": {"limits.crank": "span"},
    "swing and time ratio": {"limits.swing_angle": ["48 deg", "52 deg"], "limits.time_ratio": {"max": 1.06}},
    "inches": {
        "mechanism.crank": "3.9370078740157481 in",
        "mechanism.frame": "19.685039370078741 in",
        "mechanism.coupler": {"start": "16 in", "bounds": ["4 in", "35 in"]},
        "mechanism.rocker": {"start": "16 in", "bounds": ["4 in", "35 in"]},
    },
}


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if "free" in n else n for n in VARIATIONS])
def test_variations_are_solved_and_validated_by_both_back_ends(crank_rocker, name):
    changes = dict(VARIATIONS[name])
    problem = crank_rocker.override(changes)
    if "law as a table" in name:
        problem = optlink.read(
            {
                **problem.raw,
                "requirement": {k: v for k, v in problem.raw["requirement"].items() if k not in ("span", "points")},
            }
        )
    result = optlink.solve(problem, "both")
    failed = [check for check in result.validation.checks if not check.passed]
    assert failed == []
    assert result.status is Status.OPTIMAL
    a, b = (result.backends[n] for n in BACKENDS)
    assert a.objective == pytest.approx(b.objective, rel=1e-7)
    for free in problem.spec.free:
        assert a.design[free] == pytest.approx(b.design[free], abs=1e-8)


def test_mirrored_problem_has_the_mirrored_design(crank_rocker, solved):
    mirrored = optlink.solve(crank_rocker.override(VARIATIONS["assembly right, mirrored"]))
    assert mirrored.design["coupler"] == pytest.approx(solved.design["coupler"], abs=1e-10)
    assert mirrored.design["phi0"] == pytest.approx(-solved.design["phi0"], abs=1e-10)
    assert mirrored.design["psi0"] == pytest.approx(-solved.design["psi0"], abs=1e-10)


def test_units_do_not_matter(crank_rocker, solved):
    inches = optlink.solve(crank_rocker.override(VARIATIONS["inches"]))
    assert inches.design["coupler"] == pytest.approx(solved.design["coupler"], abs=1e-10)


@pytest.mark.slow
def test_more_design_variables_are_never_worse(crank_rocker, solved):
    """More freedom or looser limits: the optimum cannot be worse."""
    for name in ("transmission 40..140", "frame free", "span only", "phi0 free"):
        assert optlink.solve(crank_rocker.override(VARIATIONS[name])).objective <= solved.objective + 1e-12
    assert optlink.solve(crank_rocker.override(VARIATIONS["transmission 50..130"])).objective > solved.objective


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
def test_thousand_random_starts(crank_rocker, backend):
    """At least 999 of 1000 starts in [100, 900]^2 mm end at the optimum; none is called optimal elsewhere."""
    nlp = build(crank_rocker.spec)
    rng = np.random.default_rng(20240601)
    reached = 0
    for point in rng.uniform(0.1, 0.9, (1000, 2)):
        solution = multistart.solve_from(nlp, nlp.x_of({"coupler": point[0], "rocker": point[1]}), backend)
        there = abs(solution.design["coupler"] - 0.41286542) < 1e-6 and abs(solution.design["rocker"] - 0.23224617) < 1e-6
        reached += there
        assert there or solution.status is not Status.OPTIMAL
    assert reached >= 999


def test_minimax_error_alternates(crank_rocker):
    """Largest error: it is reached with both signs, which the sum-of-squares optimum does not do."""
    result = optlink.solve(crank_rocker.override(VARIATIONS["measure max"]))
    shares = np.linspace(0.0, 1.0, 20001)  # the whole span counts
    errors = result.error(result.problem.spec.span * shares)
    assert np.max(errors) == pytest.approx(result.objective, rel=3e-8)
    assert np.min(errors) == pytest.approx(-result.objective, rel=3e-8)


def test_rms_and_sum_of_squares_have_the_same_design(crank_rocker, solved):
    rms = optlink.solve(crank_rocker.override({"requirement.measure": "rms"}))
    assert rms.design["coupler"] == pytest.approx(solved.design["coupler"], abs=1e-9)
    assert rms.objective == pytest.approx(math.sqrt(solved.objective / 30), rel=1e-9)


PRICES = [
    ({}, "limits.transmission_angle", "deg", lambda b: ["45 deg", f"{b!r} deg"], "largest transmission angle"),
    (
        {"requirement.measure": "rms"},
        "limits.transmission_angle",
        "deg",
        lambda b: ["45 deg", f"{b!r} deg"],
        "largest transmission angle",
    ),
    (
        {"requirement.measure": "max"},
        "limits.transmission_angle",
        "deg",
        lambda b: ["45 deg", f"{b!r} deg"],
        "largest transmission angle",
    ),
    (
        {"limits.crank": "span"},
        "limits.transmission_angle",
        "deg",
        lambda b: ["45 deg", f"{b!r} deg"],
        "transmission angle over the span",
    ),
    (
        {"limits.swing_angle": ["30 deg", "50 deg"]},
        "limits.swing_angle",
        "deg",
        lambda b: ["30 deg", f"{b!r} deg"],
        "swing angle of the rocker",
    ),
    ({"limits.time_ratio": 1.2}, "limits.time_ratio", "", lambda b: b, "time ratio"),
    ({"limits.link_ratio": [0.1, 0.8]}, "limits.link_ratio", "", lambda b: [0.1, b], "coupler / frame"),
    (
        {"mechanism.coupler": {"start": "380 mm", "bounds": ["100 mm", "400 mm"]}},
        "mechanism.coupler.bounds",
        "mm",
        lambda b: ["100 mm", f"{b!r} mm"],
        "coupler",
    ),
]


@pytest.mark.parametrize(("changes", "key", "unit", "write", "name"), mostly_slow(PRICES, PRICES[0], PRICES[-1]))
def test_shadow_price_agrees_with_reoptimisation(crank_rocker, changes, key, unit, write, name):
    """The multiplier per physical unit against central differences of re-solved optima."""
    base = crank_rocker.override(changes)
    result = optlink.solve(base)
    assert result.valid
    limit = next(limit for limit in result.solution.displayed_limits if limit.name == name and limit.active)
    assert limit.unit == unit
    step = 1e-4 * max(1.0, abs(limit.bound))
    up, down = (optlink.solve(base.override({key: write(limit.bound + sign * step)})).objective for sign in (1, -1))
    assert limit.multiplier == pytest.approx((up - down) / (2 * step), rel=1e-4)
    assert abs(limit.multiplier) > 1e-9


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_limit_that_is_only_near_has_no_price(crank_rocker, backend):
    """At 178.5 deg the optimum has 0.2 um to spare to the Grashof condition, nearly parallel to the angle's limit."""
    result = optlink.solve(crank_rocker.override({"limits.transmission_angle": ["45 deg", "178.5 deg"]}), backend)
    assert [limit.name for limit in result.solution.displayed_limits if limit.multiplier] == ["largest transmission angle"]
    assert result.solution.kkt < 1e-12
    spare = result.design["coupler"] + result.design["rocker"] - 0.60005
    assert 1e-7 < spare < 3e-7


@cache
def least_relaxation() -> float:
    """Degrees by which 80 and 100 deg must be relaxed, by the formulas on a grid of linkages."""
    l2, l3 = np.meshgrid(np.linspace(0.1, 0.9, 1601), np.linspace(0.1, 0.9, 1601))
    turns = np.ones_like(l2, dtype=bool)
    for slack in crank_rocker_conditions(0.1, l2, l3, 0.5).values():
        turns &= slack >= 0
    with np.errstate(invalid="ignore"):
        least = np.degrees(np.arccos(np.where(turns, transmission_cosine(0.1, l2, l3, 0.5, 1.0), np.nan)))
        largest = np.degrees(np.arccos(np.where(turns, transmission_cosine(0.1, l2, l3, 0.5, -1.0), np.nan)))
    return float(np.nanmin(np.maximum(80.0 - least, largest - 100.0)))


@pytest.mark.parametrize("backend", [*BACKENDS, "both"])
def test_infeasible_transmission_limits(crank_rocker, backend):
    """80..100 deg: no linkage keeps the range; its least relaxation is checked against a brute-force grid of the formulas."""
    problem = crank_rocker.override({"limits.transmission_angle": ["80 deg", "100 deg"]})
    result = optlink.solve(problem, backend)
    assert result.status is Status.INFEASIBLE
    assert not result.valid
    conflict = {item.name: item for item in result.conflict}
    assert set(conflict) == {"smallest transmission angle", "largest transmission angle"}
    reachable = least_relaxation()
    for name, bound, sign in (("smallest", 80.0, -1.0), ("largest", 100.0, 1.0)):
        item = conflict[f"{name} transmission angle"]
        assert item.both_sides
        assert item.relaxed == pytest.approx(bound + sign * item.amount, abs=1e-9)
        assert item.amount == pytest.approx(reachable, abs=0.1)
        assert item.amount <= reachable + 1e-6
    assert conflict["smallest transmission angle"].unit == "deg"


@pytest.mark.parametrize("limits", [pytest.param((80.0, 100.0), marks=pytest.mark.slow), (70.0, 95.0)])
def test_the_relaxation_of_a_range_is_the_least_one(crank_rocker, limits):
    """Also of a range that is not centred on 90 deg, and as its printed values."""
    computed = optlink.solve(crank_rocker.override({"limits.transmission_angle": [f"{x} deg" for x in limits]})).conflict
    assert [item.sense for item in computed] == [">=", "<="]
    low, high = (item.relaxed for item in computed)
    printed = [outward(item, 6) for item in computed]
    for changed, feasible in (((low - 0.01, high + 0.01), True), (printed, True), ((low + 0.01, high), False)):
        result = optlink.solve(crank_rocker.override({"limits.transmission_angle": [f"{x!r} deg" for x in changed]}))
        assert (result.status is Status.OPTIMAL) == feasible, changed


def test_a_crank_longer_than_all_links_fails_the_design(crank_rocker):
    result = optlink.solve(crank_rocker.override({"mechanism.crank": "950 mm"}))
    assert result.status is Status.INFEASIBLE
    assert [item.name for item in result.conflict] == ["crank <= frame"]
    assert "crank <= frame" in [item.name for item in result.together]


def test_bounds_can_conflict(crank_rocker):
    short = {"bounds": ["100 mm", "150 mm"]}
    result = optlink.solve(crank_rocker.override({"mechanism.coupler": short, "mechanism.rocker": short}))
    assert result.status is Status.INFEASIBLE
    assert {"mechanism.coupler", "mechanism.rocker"} & {item.key for item in result.conflict + result.together}


def test_explain_returns_a_feasible_design(crank_rocker):
    nlp = build(crank_rocker.spec)
    x = explain(nlp)
    assert not isinstance(x, Explanation)
    assert multistart.solution_at(nlp, x, "").violation < 1e-6


def test_unusable_start_is_repaired(crank_rocker):
    """(100, 100) cannot be assembled at all; the violation is minimised first."""
    start = {"start": "100 mm", "bounds": ["100 mm", "900 mm"]}
    result = optlink.solve(crank_rocker.override({"mechanism.coupler": start, "mechanism.rocker": start}), "both")
    assert result.valid
    assert result.design["coupler"] * 1e3 == pytest.approx(412.86542, abs=1e-3)


@pytest.mark.slow
def test_optima_of_many_starts_are_grouped(crank_rocker):
    seen = []
    result = optlink.solve(crank_rocker, "slsqp", starts=100, seed=3, progress=seen.append)
    assert seen == pytest.approx([61 / 100, 1.0])  # the start of the file and two rounds
    assert len(result.optima) == 1
    assert 60 < result.optima[0].count <= result.starts
    again = optlink.solve(crank_rocker, "slsqp", starts=100, seed=3)
    assert again.design == result.design


def test_an_interrupted_search_keeps_its_best_design(crank_rocker, monkeypatch):
    real, calls = multistart.solve_from, []

    def interrupted(*args, **kwargs):
        calls.append(1)
        if len(calls) > 4:
            raise KeyboardInterrupt
        return real(*args, **kwargs)

    monkeypatch.setattr(multistart, "solve_from", interrupted)
    result = optlink.solve(crank_rocker, "slsqp", starts=50)
    assert result.interrupted
    assert len(calls) == 5
    assert result.valid
    monkeypatch.setattr(multistart, "solve_from", lambda *_args, **_kwargs: interrupted())
    with pytest.raises(KeyboardInterrupt):
        optlink.solve(crank_rocker, "slsqp", starts=50)


@pytest.mark.slow
def test_distinct_optima_are_listed(crank_rocker):
    """With a bounded start angle the problem has more than one local optimum, one at a bound; the best is taken."""
    problem = crank_rocker.override(
        {
            "requirement.from": {"start": "150 deg", "bounds": ["0 deg", "350 deg"]},
            "mechanism.frame": {"start": "300 mm", "bounds": ["200 mm", "600 mm"]},
        }
    )
    result = optlink.solve(problem, "ipopt", starts=24, seed=1)
    assert len(result.optima) >= 2
    whole = problem.override({"requirement.from": {"start": "150 deg", "bounds": ["0 deg", "360 deg"]}})
    assert len(optlink.solve(whole, "ipopt", starts=24, seed=1).optima) == 1
    objectives = [optimum.objective for optimum in result.optima]
    assert objectives == sorted(objectives)
    assert result.objective == objectives[0]
    assert sum(optimum.count for optimum in result.optima) <= result.starts


def test_an_exact_law_is_met_to_rounding(crank_rocker):
    """A table taken from a known linkage: the optimum is that linkage, the objective zero, and both back ends agree."""
    known = {"crank": 0.1, "coupler": 0.36, "rocker": 0.25, "frame": 0.4}
    phi = np.radians(np.arange(0, 181, 20) + 30.0)
    psi = optlink.linkage.sweep(optlink.linkage.four_bar(), known, phi).body_angle("rocker").value
    raw = {
        "title": "recover a linkage",
        "mechanism": {
            "crank": "100 mm",
            "frame": "400 mm",
            "coupler": {"start": "300 mm", "bounds": ["100 mm", "600 mm"]},
            "rocker": {"start": "300 mm", "bounds": ["100 mm", "600 mm"]},
        },
        "requirement": {
            "law": {
                "phi": [f"{x!r} rad" for x in phi.tolist()],
                "psi": [f"{x!r} rad" for x in psi.tolist()],
                "measured_from": "frame",
            }
        },
    }
    result = optlink.solve(optlink.read(raw), "both")
    assert result.status is Status.OPTIMAL
    assert result.objective < 1e-20
    for name in LENGTHS:
        assert result.design[name] == pytest.approx(known[name], abs=1e-9)
    assert result.valid


@pytest.mark.slow
def test_scale_invariance_is_noted(solved):
    starts = dict(zip(LENGTHS, ("100 mm", "400 mm", "300 mm", "500 mm"), strict=True))
    raw = {
        "title": "all lengths free",
        "mechanism": {name: {"start": start, "bounds": ["20 mm", "3000 mm"]} for name, start in starts.items()},
        "requirement": {"law": "psi0 + 0.3*sin(2*(phi - phi0))", "from": "40 deg", "span": "80 deg", "points": 20},
        "limits": {"transmission_angle": ["45 deg", "135 deg"], "link_ratio": [0.15, 2]},
    }
    result = optlink.solve(optlink.read(raw), "both")
    assert result.valid
    assert "all lengths may be scaled together" in result.notes[0]
    scaled = optlink.validate(result.problem, {name: 0.7 * value for name, value in result.sizes.items()})
    assert scaled.valid
    assert scaled.objective == pytest.approx(result.objective, rel=1e-9)
    assert solved.notes == ()


def test_a_non_optimal_point_is_not_reported_as_optimal(crank_rocker):
    """Planted: the solver reports success at a feasible point near the optimum; the recomputed conditions reject it."""
    from optlink.solvers.solution import Attempt

    nlp = build(crank_rocker.spec)
    for offset, status in (((0.02, 0.02), Status.STALLED), ((-0.02, -0.02), Status.INFEASIBLE)):
        x = nlp.x_of({"coupler": 0.41286542 + offset[0], "rocker": 0.23224617 + offset[1]})
        assert verified_solution(nlp, Attempt(x, 1, "Optimization terminated successfully"), nlp.p).status is status
    broken = nlp.x_of({"coupler": 0.1, "rocker": 0.1})
    assert verified_solution(nlp, Attempt(broken, 1, "success"), nlp.p).status is Status.NON_FINITE


def test_kkt_of_the_solution_is_that_of_the_programme(crank_rocker, solved):
    """Stationarity from finite differences of the objective and the active row alone."""
    nlp = build(crank_rocker.spec)
    x = nlp.x_of(solved.design)
    p = multistart.scaled_parameters(nlp, nlp.x_start)
    names = [row.label for row in nlp.rows]
    active = names.index("largest transmission angle")
    step = 1e-6
    gradient, slope = np.zeros(2), np.zeros(2)
    for i in range(2):
        e = np.eye(2)[i] * step
        (f1, g1), (f0, g0) = nlp.values(x + e, p), nlp.values(x - e, p)
        gradient[i], slope[i] = (f1 - f0) / (2 * step), (g1[active] - g0[active]) / (2 * step)
    price = gradient @ slope / (slope @ slope)
    assert price > 0  # the cosine's lower side holds the design back
    np.testing.assert_allclose(gradient, price * slope, rtol=0, atol=1e-7)
    limit = next(limit for limit in solved.solution.displayed_limits if limit.active)
    per_degree = price * p[0] * -math.sin(math.radians(135)) * math.pi / 180
    assert limit.multiplier == pytest.approx(per_degree, rel=1e-6)
