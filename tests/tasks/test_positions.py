"""Positions: an output has a value, or lies in a range, at a crank angle; judged by circles and searches of their own."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

import optlink
from optlink.studies import sensitivities
from tests.oracles.composed_problems import straight_line, third

LINE = {
    "title": "straight line of given travel",
    "mechanism": {
        "type": "dyads",
        "ground": {"A": [{"bounds": ["-200 mm", "-50 mm"]}, "0 mm"], "D": ["0 mm", "0 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": {"bounds": ["20 mm", "100 mm"]}},
            "coupler": {
                "joints": ["B", "C"],
                "length": {"bounds": ["50 mm", "400 mm"]},
                "points": {"P": [{"equals": "2*coupler.length"}, "0 mm"]},
            },
            "rocker": {"joints": ["D", "C"], "length": {"equals": "coupler.length"}},
        },
        "assembly": {"C": "left of B-D"},
    },
}
TRAVEL = {"kind": "position", "output": "P.x", "at": "110 deg", "value": "100 mm"}
DWELL = {"kind": "dwell", "output": "P.y", "over": "110..250 deg"}
ARM = {
    "title": "arm",
    "mechanism": {
        "type": "four-bar",
        "frame": {"start": "100 mm", "bounds": ["80 mm", "150 mm"]},
        "crank": "40 mm",
        "coupler": {"start": "110 mm", "bounds": ["80 mm", "200 mm"]},
        "rocker": {"start": "80 mm", "bounds": ["60 mm", "150 mm"]},
    },
}


def arm(*positions: dict[str, Any]) -> optlink.ProblemFile:
    """An arm of the best worst transmission angle that passes positions."""
    stated = [{"kind": "position", **position} for position in positions]
    return optlink.read(ARM | ({"requirement": stated[0]} if len(stated) == 1 else {"requirements": stated}))


def line(*requirements: dict[str, Any]) -> optlink.ProblemFile:
    return optlink.read(LINE | {"requirements": list(requirements)})


def rocker(frame: float, coupler: float, length: float, degrees: float) -> float:
    """Angle [deg] of the arm by the intersection of two circles."""
    return math.degrees(float(np.angle(third(0.04 * np.exp(1j * np.radians([degrees])), frame, coupler, length, 1.0) - frame)[0]))


def pressure(frame: float, coupler: float, length: float) -> float:
    cosines = [(coupler**2 + length**2 - (frame + way * 0.04) ** 2) / (2.0 * coupler * length) for way in (1.0, -1.0)]
    return max(math.degrees(abs(math.asin(c))) if abs(c) <= 1.0 else 90.0 + abs(c) for c in cosines)


@pytest.fixture(scope="module")
def travelled() -> Any:
    return optlink.solve(line(TRAVEL, DWELL), "both", starts=60)


@pytest.mark.slow
def test_the_straightest_line_of_a_given_travel(travelled: Any) -> None:
    """The line is symmetric about D, so that P.x at 110 deg is half the travel; scale, breadth and proportions are known."""
    known = straight_line()
    assert travelled.valid
    assert travelled.objective == pytest.approx(0.5 * known.optimum * 0.2, rel=1e-6)
    crank = travelled.design["crank.length"]
    assert crank == pytest.approx(0.2 / known.figures["travel"], rel=1e-6)
    assert -travelled.design["A.x"] / crank == pytest.approx(known.figures["frame"], rel=1e-6)
    assert travelled.design["coupler.length"] / crank == pytest.approx(known.figures["coupler"], rel=1e-6)
    first, second = travelled.backends.values()
    assert first.objective == pytest.approx(second.objective, rel=1e-9)


def test_the_order_of_the_requirements_does_not_matter(travelled: Any) -> None:
    other = optlink.solve(line(DWELL, TRAVEL), starts=60)
    assert other.objective == pytest.approx(travelled.objective, rel=1e-9)
    assert {check.name for check in other.validation.checks} < {check.name for check in travelled.validation.checks}


@pytest.mark.slow
def test_the_price_of_the_travel(travelled: Any) -> None:
    """The breadth is proportional to the travel."""
    row = sensitivities(line(TRAVEL, DWELL))["requirements.0.value"]
    assert row.objective == pytest.approx(travelled.objective / 0.1, rel=1e-5)


@pytest.mark.slow
def test_a_range_of_an_angle() -> None:
    """The best worst pressure angle with the arm at 110 to 120 deg, by an own search with a penalty over three lengths."""
    result = optlink.solve(arm({"at": "30 deg", "value": ["110 deg", "120 deg"]}), starts=60)
    sizes = [result.design[name] for name in ("frame", "coupler", "rocker")]
    assert result.valid
    assert math.degrees(result.objective) == pytest.approx(pressure(*sizes), rel=1e-8)
    assert 110.0 - 1e-6 <= rocker(*sizes, 30.0) <= 120.0 + 1e-6

    def judged(x: np.ndarray) -> float:
        at = rocker(*x, 30.0)
        outside = max(110.0 - at, at - 120.0, 0.0) if math.isfinite(at) else 90.0
        grashof = max(0.04 + max(x) - (sum(x) - max(x)), 0.0)
        return pressure(*x) + 100.0 * outside + 1e5 * grashof

    limits = ((0.08, 0.15), (0.08, 0.2), (0.06, 0.15))
    precise = {"xatol": 1e-10, "fatol": 1e-10, "maxiter": 5000, "maxfev": 5000}
    starts = ((0.1, 0.11, 0.08), (0.12, 0.15, 0.1), (0.14, 0.12, 0.12), (0.15, 0.15, 0.1), (0.09, 0.1, 0.09))
    own = min(float(minimize(judged, x, method="Nelder-Mead", bounds=limits, options=precise).fun) for x in starts)
    assert math.degrees(result.objective) <= own * (1.0 + 1e-6)


def test_two_exact_positions() -> None:
    """Equalities: both angles are met to rounding, and each has a price."""
    result = optlink.solve(arm({"at": "30 deg", "value": "115 deg"}, {"at": "200 deg", "value": "160 deg"}), starts=60)
    sizes = [result.design[name] for name in ("frame", "coupler", "rocker")]
    assert result.valid
    assert rocker(*sizes, 30.0) == pytest.approx(115.0, abs=1e-6)
    assert rocker(*sizes, 200.0) == pytest.approx(160.0, abs=1e-6)
    assert {limit.key for limit in result.best.limits if limit.active} >= {"requirements.0.value", "requirements.1.value"}


@pytest.mark.slow
def test_an_open_side_of_a_coordinate() -> None:
    """P.x at least 120 mm: as narrow a band as that of exactly 120 mm, as it grows with the travel."""
    least = optlink.solve(line(TRAVEL | {"value": {"min": "120 mm"}}, DWELL), starts=60)
    assert least.valid
    assert least.objective == pytest.approx(0.5 * straight_line().optimum * 0.24, rel=1e-6)


ACROSS = {"170 deg..190 deg": True, "150 deg..170 deg": False, "-190 deg..-170 deg": True}


@pytest.mark.parametrize("stated", ACROSS)
def test_a_range_across_half_a_turn(stated: str) -> None:
    """The coupler of a turned four-bar points to an angle beyond 180 deg, which is also one above -180 deg."""
    direction = np.exp(1j * math.radians(136.0))
    place = [f"{100.0 * part!r} mm" for part in (float(direction.real), float(direction.imag))]
    lengths = {"crank": (["A", "B"], "40 mm"), "coupler": (["B", "C"], "110 mm"), "rocker": (["D", "C"], "80 mm")}
    links = {name: {"joints": joints, "length": length} for name, (joints, length) in lengths.items()}
    ground = {"A": ["0 mm", "0 mm"], "D": place}
    turned = {"type": "dyads", "ground": ground, "links": links, "assembly": {"C": "left of B-D"}}
    requirement = {"kind": "position", "output": "coupler", "at": "136 deg", "value": stated.split("..")}
    tested = optlink.validate(optlink.read({"title": "t", "mechanism": turned, "requirement": requirement}), {})
    b = 0.04 * direction
    angle = math.degrees(float(np.angle(third(np.array([b]), complex(0.1 * direction), 0.11, 0.08, 1.0) - b)[0]))
    checks = [check for check in tested.validation.checks if check.name.startswith("coupler at 136 deg")]
    assert len(checks) == 2
    assert all(math.cos(math.radians(check.value - angle)) == pytest.approx(1.0, abs=1e-12) for check in checks)
    assert all(check.passed for check in checks) is ACROSS[stated]


def test_a_design_beside_the_position_is_rejected(travelled: Any) -> None:
    """Planted: a crank 1 um longer."""
    file, sound = line(TRAVEL, DWELL), {name: travelled.design[name] for name in ("A.x", "crank.length", "coupler.length")}
    sound |= {"dwell.zero": travelled.design["dwell.zero"]}
    for change, met in ((0.0, True), (1e-6, False)):
        tested = optlink.validate(file, sound | {"crank.length": sound["crank.length"] + change})
        checks = {check.name: check.passed for check in tested.validation.checks if check.name.startswith("P.x at 110 deg")}
        assert len(checks) == 2
        assert all(checks.values()) is met


@pytest.mark.slow
def test_a_position_out_of_reach_is_told() -> None:
    """The arm stays left of the line from the pin of the crank to its pivot, so that it cannot point to -120 deg at 90 deg."""
    result = optlink.solve(arm({"at": "90 deg", "value": "-120 deg"}), starts=5)
    assert not result.valid
    assert [one.key for one in result.conflict] == ["requirement.value"]
