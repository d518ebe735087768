"""Regions that a point stays in or out of; judged by nearest points of the region and grids of designs of their own."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.studies import sensitivities
from tests.oracles.composed_problems import third
from tests.tiers import mostly_slow

CRANK, COUPLER, ROCKER, FRAME = 0.03, 0.1, 0.09, 0.1
TARGETS = {0.0: (20.0, 100.0), 60.0: (0.0, 105.0), 120.0: (-20.0, 95.0), 180.0: (-25.0, 80.0)}
POINTS = [{"x": f"{x} mm", "y": f"{y} mm", "crank": f"{at} deg"} for at, (x, y) in TARGETS.items()]
HOOD = {"region": "box", "of": "P", "x": ["-12 mm", "60 mm"], "y": ["97 mm", "140 mm"], "clearance": "2 mm"}
DISC = {"region": "circle", "of": "P", "centre": ["10 mm", "110 mm"], "radius": "12 mm"}
WALL = {"region": "half-plane", "of": "P", "through": ["0 mm", "100 mm"], "direction": "10 deg"}
FRAMES = {"region": "box", "of": "P", "side": "inside", "x": ["-35 mm", "40 mm"], "y": ["20 mm", "110 mm"], "clearance": "1 mm"}


def four_bar(*, dyads: bool = False, **limits: Any) -> dict[str, Any]:
    """A four-bar of which only the coupler point is free, so that the curve is linear in the unknowns."""
    point = [{"start": "50 mm", "bounds": ["-50 mm", "200 mm"]}, {"start": "40 mm", "bounds": ["-50 mm", "200 mm"]}]
    lengths = {"crank": CRANK, "coupler": COUPLER, "rocker": ROCKER}
    mechanism: dict[str, Any] = {"type": "four-bar", "frame": f"{1e3 * FRAME} mm", "points": {"P": point}}
    mechanism |= {name: f"{1e3 * size} mm" for name, size in lengths.items()}
    if dyads:
        joints = {"crank": ["A", "B"], "coupler": ["B", "C"], "rocker": ["D", "C"]}
        links = {name: {"joints": joints[name], "length": f"{1e3 * size} mm"} for name, size in lengths.items()}
        links["coupler"]["points"] = {"P": point}
        ground = {"A": ["0 mm", "0 mm"], "D": [f"{1e3 * FRAME} mm", "0 mm"]}
        mechanism = {"type": "dyads", "ground": ground, "links": links, "assembly": {"C": "left of B-D"}}
    return {"title": "t", "mechanism": mechanism, "requirement": {"kind": "path", "points": POINTS}, "limits": limits}


def traced(u: Any, v: Any, phi: np.ndarray) -> np.ndarray:
    b = CRANK * np.exp(1j * phi)
    return np.asarray(b + (third(b, FRAME, COUPLER, ROCKER, 1.0) - b) / COUPLER * (u + 1j * v))


def error(u: Any, v: Any) -> Any:
    at = np.radians(list(TARGETS))
    return np.sum(np.abs(traced(u[..., None], v[..., None], at) - [complex(*p) * 1e-3 for p in TARGETS.values()]) ** 2, axis=-1)


def outside_hood(p: np.ndarray) -> np.ndarray:
    nearest = np.clip(p.real, -0.012, 0.06) + 1j * np.clip(p.imag, 0.097, 0.14)
    return np.abs(p - nearest) - 0.002


def outside_disc(p: np.ndarray) -> np.ndarray:
    return np.abs(p - (0.01 + 0.11j)) - 0.012


def outside_wall(p: np.ndarray) -> np.ndarray:
    return -((p - 0.1j) * np.exp(-1j * math.radians(10.0))).imag


def inside_frame(p: np.ndarray) -> np.ndarray:
    return np.min([p.real + 0.035, 0.04 - p.real, p.imag - 0.02, 0.11 - p.imag], axis=0) - 0.001


CASES: dict[str, tuple[dict[str, Any], Callable[[np.ndarray], np.ndarray]]] = {
    "hood": (HOOD, outside_hood),
    "disc": (DISC, outside_disc),
    "wall": (WALL, outside_wall),
    "frame": (FRAMES, inside_frame),
}
WHOLE = np.radians(np.linspace(0.0, 360.0, 20_001))


def scan(slack: Callable[[np.ndarray], np.ndarray]) -> float:
    """Least error of the coupler points of a grid that keep their distance at 721 crank angles, ever finer."""
    phi, middle, half = np.radians(np.linspace(0.0, 360.0, 721)), (0.075, 0.075), 0.125
    best = math.inf
    for _ in range(8):
        u, v = (np.linspace(at - half, at + half, 81) for at in middle)
        u, v = np.meshgrid(u, v)
        met = np.min(slack(traced(u[..., None], v[..., None], phi)), axis=-1) >= 0.0
        judged = np.where(met, error(u, v), math.inf)
        at = np.unravel_index(int(np.argmin(judged)), judged.shape)
        best, middle, half = float(judged[at]), (float(u[at]), float(v[at])), 0.25 * half
    return best


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_point_keeps_its_distance(name: str) -> None:
    limit, slack = CASES[name]
    result = optlink.solve(optlink.read(four_bar(zone=limit)), "both", starts=60)
    free = optlink.solve(optlink.read(four_bar()), starts=60)
    u, v = result.design["P.along"], result.design["P.across"]
    assert result.valid
    assert float(np.min(slack(traced(free.design["P.along"], free.design["P.across"], WHOLE)))) < -1e-3  # the limit matters
    assert float(np.min(slack(traced(u, v, WHOLE)))) == pytest.approx(0.0, abs=1e-8)
    assert result.objective == pytest.approx(float(error(np.array(u), np.array(v))), rel=1e-9)
    assert result.objective == pytest.approx(scan(slack), rel=3e-3)
    assert result.objective <= scan(slack) * (1.0 + 1e-4)
    first, second = result.backends.values()
    assert first.objective == pytest.approx(second.objective, rel=1e-8)


@pytest.mark.parametrize("name", mostly_slow(CASES, "hood"))
def test_dyads_give_the_same(name: str) -> None:
    limit, _ = CASES[name]
    one, other = (optlink.solve(optlink.read(four_bar(dyads=dyads, zone=limit)), starts=60) for dyads in (False, True))
    assert other.valid
    assert other.objective == pytest.approx(one.objective, rel=1e-8)


@pytest.mark.slow
def test_the_price_of_the_clearance() -> None:
    """Per mm, by solving again with 2.01 and 1.99 mm."""
    row = sensitivities(optlink.read(four_bar(hood=HOOD)))["limits.hood.clearance"]
    above, below = (
        optlink.solve(optlink.read(four_bar(hood=HOOD | {"clearance": f"{at} mm"})), starts=30).objective for at in (2.01, 1.99)
    )
    assert row.objective == pytest.approx((above - below) / 2e-5, rel=1e-3)


@pytest.mark.slow
def test_a_limit_over_the_span_alone() -> None:
    """The law of the span is the way from the first point to the last; the rest of the curve may enter the region."""
    whole, span = (
        optlink.solve(optlink.read(four_bar(hood=HOOD | {"over": over})), starts=60) for over in ("revolution", "span")
    )
    u, v = span.design["P.along"], span.design["P.across"]
    assert span.valid
    assert span.objective <= whole.objective * (1.0 + 1e-9)
    assert float(np.min(outside_hood(traced(u, v, np.radians(np.linspace(0.0, 180.0, 10_001)))))) >= -1e-8


def test_a_crank_that_does_not_turn_fully() -> None:
    result = optlink.solve(optlink.read(four_bar(hood=HOOD, crank="span")), starts=60)
    assert result.valid
    over = optlink.solve(optlink.read(four_bar(hood=HOOD | {"over": "span"})), starts=60)
    assert result.objective == pytest.approx(over.objective, rel=1e-8)


def test_a_small_obstacle_between_the_positions_is_seen() -> None:
    """Planted: a disc of 0.2 mm on the curve of the best design, between any two of 720 positions."""
    best = optlink.solve(optlink.read(four_bar()), starts=30).design
    place = complex(traced(best["P.along"], best["P.across"], np.radians([200.3]))[0])
    disc = {"region": "circle", "of": "P", "centre": [f"{place.real!r} m", f"{place.imag!r} m"], "radius": "0.05 mm"}
    tested = optlink.validate(optlink.read(four_bar(pin=disc)), {name: best[name] for name in ("P.along", "P.across")})
    (check,) = [check for check in tested.validation.checks if check.name == "P outside pin"]
    assert not check.passed
    assert check.value == pytest.approx(-0.05, abs=1e-4)
    avoided = optlink.solve(optlink.read(four_bar(pin=disc | {"radius": "1 mm"})), starts=30)
    u, v = avoided.design["P.along"], avoided.design["P.across"]
    assert avoided.valid
    assert float(np.min(np.abs(traced(u, v, WHOLE) - place))) >= 1e-3 * (1.0 - 1e-6)


@pytest.mark.parametrize("name", CASES)
def test_a_design_a_micrometre_inside_is_rejected(name: str) -> None:
    limit, slack = CASES[name]
    file = optlink.read(four_bar(zone=limit))
    best = optlink.solve(file, starts=30).design
    sound = np.array([best["P.along"], best["P.across"]])
    steps = [1e-6 * np.array([math.cos(a), math.sin(a)]) for a in np.linspace(0.0, 2.0 * math.pi, 13)]
    entered = min(steps, key=lambda step: float(np.min(slack(traced(*(sound + step), WHOLE)))))
    for place, met in ((sound, True), (sound + entered, False)):
        tested = optlink.validate(file, {"P.along": float(place[0]), "P.across": float(place[1])})
        (check,) = [check for check in tested.validation.checks if check.name.endswith(" zone")]
        assert check.passed is met


def test_the_default_clearance_is_a_share_of_the_box() -> None:
    """2 % of the larger half width of 36 and 21.5 mm."""
    file = optlink.read(four_bar(hood={key: value for key, value in HOOD.items() if key != "clearance"}))
    tested = optlink.validate(file, {"P.along": 0.05, "P.across": 0.04})
    (check,) = [check for check in tested.validation.checks if check.name == "P outside hood"]
    assert check.limit == ">= 0.72"


@pytest.mark.slow
def test_a_region_beside_a_dwell_and_a_position() -> None:
    """The straight line of 200 mm travel, with a roof over it that the whole curve stays below."""
    known = optlink.load("straight-line")
    free = optlink.solve(known, starts=30)
    phi = np.radians(np.linspace(0.0, 360.0, 7201))
    sizes = free.design
    b = 0.05 * np.exp(1j * phi)
    curve = 2.0 * third(b, complex(sizes["frame"]), sizes["coupler"], sizes["coupler"], 1.0) - b
    lowest = float(np.min(curve.imag))
    floor = {"region": "half-plane", "of": "P", "through": ["0 mm", f"{1e3 * lowest + 1.0!r} mm"], "direction": "0 deg"}
    raw = known.override({"limits.floor": floor | {"side": "inside"}})
    result = optlink.solve(raw, starts=30)
    sizes = result.design
    curve = 2.0 * third(b, complex(sizes["frame"]), sizes["coupler"], sizes["coupler"], 1.0) - b
    assert result.valid
    assert float(np.min(curve.imag)) == pytest.approx(lowest + 1e-3, abs=1e-8)
    assert result.objective > free.objective


def test_a_certificate_is_refused() -> None:
    with pytest.raises(InputError, match="limits of regions"):
        optlink.solve(optlink.read(four_bar(hood=HOOD)), starts=5, certify=True)


def test_a_region_over_the_span_applies_at_a_position_without_a_motion() -> None:
    """A position is a single crank angle: no peak of the distance moves along it."""
    raw = four_bar(dyads=True, hood=HOOD | {"over": "span"})
    position = {"kind": "position", "output": "P.x", "at": "240 deg", "value": {"max": "0 mm"}}
    raw["requirements"] = [raw.pop("requirement") | {"name": "hand"}, position]
    result = optlink.solve(optlink.read(raw), starts=1)
    assert result.valid
    point = traced(result.design["coupler.P.along"], result.design["coupler.P.across"], np.radians(np.linspace(0.0, 180.0, 2001)))
    outside = np.maximum([-0.012 - point.real, point.real - 0.06], 0.0).max(axis=0), np.maximum(0.097 - point.imag, 0.0)
    assert np.hypot(*outside).min() == pytest.approx(0.002, abs=1e-8)
