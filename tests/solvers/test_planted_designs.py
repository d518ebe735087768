"""No box with a planted feasible design is discarded: a separate evaluator measures its error; its limits are met just so."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import optlink
from optlink.optimization.taylor_model import DesignBoxes, box_problem
from optlink.solvers.global_search import function_generator
from optlink.solvers.global_search.branch_and_bound import Bounder
from optlink.solvers.global_search.function_generator import FunctionSearch, linkage_sets
from optlink.solvers.global_search.lagrangian import OPEN, LagrangianBounds
from optlink.solvers.global_search.timed_path import TimedPathBounds
from tests import synthesis_oracle as oracle
from tests.random_linkages import transmission_range
from tests.stated import document, four_bar_section, free

Array = NDArray[np.float64]

TURN = 2.0 * math.pi
BOXES = 48
ABOVE = 1.0 + 1e-7  # threshold over the planted error
NAMES = ("crank", "coupler", "rocker")
SEEDS = range(9)


def kept(x: Array, bounds: Bounder, threshold: float, seed: int) -> NDArray[np.bool_]:
    """Whether boxes of very different widths about a point, at a corner of the first ones, remain with the point in them."""
    assert np.all((x > bounds.low - 1e-9) & (x < bounds.high + 1e-9))
    rng = np.random.default_rng(seed)
    x = np.clip(x, bounds.low, bounds.high)
    width = (bounds.high - bounds.low) * 10.0 ** rng.uniform(-9.0, -0.1, (BOXES, 1)) * rng.uniform(0.2, 1.0, (BOXES, len(x)))
    share = rng.random((BOXES, len(x)))
    share[:20] = np.round(share[:20])
    low, high = np.maximum(x - share * width, bounds.low), np.minimum(x + (1.0 - share) * width, bounds.high)
    result = bounds.bounded(low, high, threshold)
    return (result.test == OPEN) & np.all((result.low < x + 1e-12) & (result.high > x - 1e-12), axis=1)


def planted(seed: int) -> tuple[dict[str, float], dict[str, Any], dict[str, Any], np.random.Generator]:
    """A random four-bar that turns fully, bounds of its lengths that it meets exactly at times, and limits that it just meets."""
    rng = np.random.default_rng([seed, 20])
    double = seed % 3 == 0
    linkage = (oracle.random_double_crank if double else oracle.random_crank_rocker)(rng)
    lengths = {}
    for name in (*NAMES, "frame"):
        low, high = ((1.0, 2.0), (0.4, 1.0), (0.4, 2.0), (0.4, 2.0))[rng.integers(4)]
        lengths[name] = free(low * linkage[name], high * linkage[name])
    least, largest = np.degrees(transmission_range(linkage, 0.0, TURN)).tolist()
    ratios = [linkage[name] / linkage["frame"] for name in NAMES]
    limits = {
        "crank": "double-crank" if double else "full rotation",
        "transmission_angle": [f"{least - 1e-7!r} deg", f"{largest + 1e-7!r} deg"],
        "link_ratio": [min(ratios) * (1.0 - 1e-9), max(ratios) * (1.0 + 1e-9)],
    }
    return linkage, lengths, limits, rng


def timed_path(seed: int) -> NDArray[np.bool_]:
    """Points near a planted path, at prescribed crank angles; the proportions of the four-bar by its law of cosines."""
    linkage, lengths, limits, rng = planted(seed)
    angles = oracle.random_angles(rng, int(rng.integers(4, 12)), rng.uniform(1.0, 6.0)) * rng.choice([-1, 1])
    path = oracle.direct(linkage, angles).p
    points = path + rng.uniform(0.1, 20.0) * (rng.normal(size=len(path)) + 1j * rng.normal(size=len(path)))
    mode = "left" if linkage["mode"] > 0 else "right"
    section = four_bar_section(mode if rng.random() < 0.5 else "either", **lengths)
    if rng.random() < 0.5:
        section |= {"pivot": [f"{linkage['x']!r} mm", f"{linkage['y']!r} mm"], "direction": f"{linkage['direction']!r} rad"}
    rows = np.column_stack([points.real, points.imag])
    model = optlink.read(document(section, rows, limits, crank=angles, timing="given")).model
    bounds = TimedPathBounds(model)  # type: ignore[arg-type]
    crank, coupler, rocker, frame = (linkage[name] for name in (*NAMES, "frame"))
    swapped = bounds.reduced and linkage["mode"] > 0
    omega = math.asin((coupler - rocker if swapped else rocker - coupler) / (crank - frame))
    if not bounds.reduced and linkage["mode"] > 0:
        omega = math.pi - omega
    x = np.array([math.atan2(frame, crank), omega, math.acos((crank + frame) / (coupler + rocker))])
    return kept(x, bounds, 1e-6 * float(np.sum(np.abs(points - path) ** 2)) * ABOVE, seed)


def outputs(linkage: dict[str, float], angles: Array) -> Array:
    """Rocker angles of a four-bar whose frame lies along x [rad]."""
    return np.unwrap(oracle.direct({**linkage, "x": 0.0, "y": 0.0, "direction": 0.0}, angles).output)


def largest_error(seed: int) -> NDArray[np.bool_]:
    """A function that a planted four-bar follows with some error, which is the threshold; all sets of linkages together."""
    linkage, lengths, limits, rng = planted(seed)
    phi0, span = rng.uniform(-3.0, 3.0), float(rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.6))
    rotation = outputs(linkage, phi0 + np.linspace(0.0, span, 4001))
    travel = float(rotation[-1] - rotation[0])
    deviation = rotation - rotation[0] - travel * np.linspace(0.0, 1.0, 4001) ** 1.5
    psi0 = float(rotation[0] + 0.5 * (deviation.max() + deviation.min()))
    error = 0.5 * float(np.ptp(deviation)) * ABOVE + 1e-9
    assert error < 0.7
    section = {"type": "four-bar", "assembly": "either", **lengths, "frame": f"{linkage['frame']!r} mm"}
    law = {"function": "x^1.5", "x": [0, 1], "input": f"{span!r} rad", "output": f"{travel!r} rad"}
    requirement = {"law": law, "measure": "max"}
    model = optlink.read({"title": "t", "mechanism": section, "requirement": requirement, "limits": limits}).model
    search = FunctionSearch(model, error, None, None)  # type: ignore[arg-type]
    computed = np.zeros(BOXES, dtype=bool)
    for one in linkage_sets(model, error):  # type: ignore[arg-type]
        turn = one.low[:2] + np.remainder([phi0, psi0] - one.low[:2], TURN)
        x = np.array([*turn, linkage["frame"] / linkage["crank"], linkage["frame"] / linkage["rocker"]])
        if one.side == linkage["mode"] and np.all((x > one.low - 1e-9) & (x < one.high + 1e-9)):
            computed |= kept(x, search._bounds(one), error, seed)
    return computed


def motion_law(seed: int) -> NDArray[np.bool_]:
    """A table near the output of a planted four-bar; lengths and start angles are design variables."""
    linkage, lengths, limits, rng = planted(seed)
    phi0, offsets = rng.uniform(-2.0, 2.0), np.linspace(0.0, rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 5.0), 9)
    rotation = outputs(linkage, phi0 + offsets)
    psi0 = math.remainder(rotation[0], TURN) + 0.02
    table = rotation - rotation[0] + np.concatenate([[0.0], 0.1 * rng.normal(size=8)])
    error = rotation - rotation[0] - 0.02 - table
    measure, size = (("sum of squares", np.sum), ("rms", np.mean), ("max", np.max))[seed % 3]
    degrees = {"phi": [f"{x!r} rad" for x in offsets.tolist()], "psi": [f"{y!r} rad" for y in table.tolist()]}
    requirement = {"law": degrees, "measure": measure}
    requirement |= {key: free(x - 0.3, x + 0.2, unit="rad") for key, x in (("from", phi0), ("psi0", psi0))}
    section = {"type": "four-bar", "assembly": "left" if linkage["mode"] > 0 else "right", **lengths}
    boxes = box_problem(optlink.read({"title": "t", "mechanism": section, "requirement": requirement, "limits": limits}))
    values = {**{name: 1e-3 * linkage[name] for name in (*NAMES, "frame")}, "phi0": phi0, "psi0": psi0}
    x = np.array([values[name] for name in boxes.problem.free])
    return kept(x, LagrangianBounds(boxes), float(size(error**2)) * ABOVE, seed)


KINDS = {"timed path": timed_path, "largest error": largest_error, "motion law": motion_law}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_no_box_with_a_planted_design_is_discarded(kind: str) -> None:
    lost = {seed: int(np.sum(~computed)) for seed in SEEDS if not np.all(computed := KINDS[kind](seed))}
    assert lost == {}


def tighter_path(monkeypatch: pytest.MonkeyPatch) -> None:
    original = TimedPathBounds.bounded
    monkeypatch.setattr(TimedPathBounds, "bounded", lambda self, low, high, most: original(self, low, high, 0.9 * most))


def tighter_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    original = function_generator.loop_rows
    monkeypatch.setattr(function_generator, "loop_rows", lambda linkages, x, y, t: original(linkages, x, y, 0.9 * t))


def larger_residuals(monkeypatch: pytest.MonkeyPatch) -> None:
    original = DesignBoxes.over

    def larger(self: DesignBoxes, low: Array, high: Array) -> Any:
        result = original(self, low, high)
        result.residuals.coefficients[0] *= 1.1
        return result

    monkeypatch.setattr(DesignBoxes, "over", larger)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "defect"), [*zip(KINDS, (tighter_path, tighter_rows, larger_residuals), strict=True)])
def test_a_bound_that_is_too_high_is_detected(kind: str, defect: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    defect(monkeypatch)
    assert any(not np.all(KINDS[kind](seed)) for seed in SEEDS)
