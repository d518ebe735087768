"""Which limits conflict where no linkage for a path or the best transmission exists, and checks and prices that say something."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.errors import Status
from optlink.optimization.multipliers import LEAST_PRICE
from optlink.synthesis.batch_search import Candidate
from optlink.tasks.results.common import with_optimality
from optlink.tasks.results.design import LinkageDesign, SynthesisResult
from optlink.tasks.run import solve
from optlink.tasks.search import Polisher, validated_design
from optlink.validation.check import Validation

SWING = 110.0
MOVER: dict[str, Any] = {
    "title": "Swinging arm",
    "mechanism": {
        "type": "four-bar",
        "crank": "30 mm",
        "frame": {"bounds": ["80 mm", "300 mm"]},
        "coupler": {"bounds": ["80 mm", "400 mm"]},
        "rocker": {"bounds": ["20 mm", "150 mm"]},
    },
    "requirement": {"kind": "transmission"},
    "limits": {"swing_angle": f"{SWING} deg", "transmission_angle": ["40 deg", "140 deg"]},
}


@pytest.fixture(scope="module")
def mover() -> SynthesisResult:
    return solve(optlink.read(MOVER), starts=60)


def widest_swing() -> float:
    """Largest swing [deg] of a crank-rocker with 40 ... 140 deg of transmission: grids that close in, by the law of cosines."""
    low, high, r, best = np.array([80.0, 20.0, 80.0]), np.array([400.0, 150.0, 300.0]), 30.0, math.nan
    box = low, high
    for _ in range(12):
        axes = [np.linspace(*side, 61) for side in zip(*box, strict=True)]
        a, b, f = np.meshgrid(*axes, indexing="ij")
        with np.errstate(invalid="ignore"):
            far, near = (np.degrees(np.arccos((f**2 + b**2 - line**2) / (2 * f * b))) for line in (a + r, a - r))
            ends = [np.degrees(np.arccos((a**2 + b**2 - d**2) / (2 * a * b))) for d in (f - r, f + r)]
            swing = np.where((ends[0] >= 40.0) & (ends[1] <= 140.0), far - near, -1.0)
        k = np.unravel_index(np.argmax(np.nan_to_num(swing, nan=-1.0)), swing.shape)
        best, centre, half = float(swing[k]), np.array([a[k], b[k], f[k]]), 0.3 * (box[1] - box[0])
        box = np.maximum(centre - half, low), np.minimum(centre + half, high)
    return best


@pytest.mark.slow
def test_an_infeasible_transmission_problem_names_its_limits_and_their_amounts(mover: SynthesisResult) -> None:
    assert not mover.valid
    assert {item.key for item in mover.conflict} == {"limits.swing_angle", "limits.transmission_angle"}
    (swing,) = (item for item in mover.conflict if item.key == "limits.swing_angle")
    widest = widest_swing()
    assert widest < SWING
    assert swing.relaxed == pytest.approx(widest, abs=0.1)
    assert mover.to_dict()["conflict"][0]["amount"] > 0.0


@pytest.mark.slow
def test_a_crank_that_is_longer_than_all_cannot_be_the_shortest_link() -> None:
    mechanism = {**MOVER["mechanism"], "crank": "420 mm", "coupler": {"bounds": ["80 mm", "260 mm"]}}
    result = solve(optlink.read({**MOVER, "mechanism": mechanism, "limits": {}}), starts=60)
    assert not result.valid
    assert result.conflict
    assert any("cannot be the shortest link" in note for note in result.notes)


def test_a_law_with_the_longest_crank_is_reported() -> None:
    mechanism = {"crank": "310 mm", "frame": "240 mm"}
    mechanism |= {"coupler": {"bounds": ["50 mm", "290 mm"]}, "rocker": {"bounds": ["50 mm", "200 mm"]}}  # type: ignore[dict-item]
    requirement = {"law": "psi0 + 0.3*(phi - phi0)", "span": "90 deg", "points": 10}
    result = solve(optlink.read({"title": "long crank", "mechanism": mechanism, "requirement": requirement}))
    assert result.status is Status.INFEASIBLE
    assert any("cannot be the shortest link" in note for note in result.notes)


@pytest.mark.slow
def test_the_check_of_optimality_never_contradicts_its_figure(mover: SynthesisResult) -> None:
    solution = solve(optlink.load("crank-rocker")).solution
    assert solution is not None
    for status in Status:
        for kkt in (1e-16, 1e-3):
            for violation in (0.0, 1.0):
                given = replace(solution, status=status, kkt=kkt, violation=violation)
                names = [check.name for check in with_optimality(Validation((), 0.0), given).checks]
                assert names == ["all limits met (scaled)", "optimality (KKT residual)"][: 1 if violation else 2]
                if violation:  # no feasible design, no optimum: a consequence
                    continue
                check = with_optimality(Validation((), 0.0), given).checks[1]
                holds = kkt <= 1e-6
                assert ("<=" not in check.limit) or check.passed == holds, (status, kkt, check)


def test_a_limit_without_a_price_shows_none() -> None:
    """A law that the four-bar meets exactly has nothing to gain from any limit."""
    result = solve(optlink.load("crank-rocker"))
    assert result.solution is not None
    assert any(limit.multiplier for limit in result.solution.displayed_limits)
    conditions = result.solution.conditions
    dead = replace(conditions, multipliers=conditions.multipliers * (0.1 * LEAST_PRICE / np.max(np.abs(conditions.multipliers))))
    f = result.solution.nlp.values(result.solution.x, result.solution.p)[0]
    assert math.isfinite(f)
    scaled = replace(dead, multipliers=dead.multipliers * abs(f))
    assert not any(limit.multiplier for limit in replace(result.solution, conditions=scaled).limits)


ROD = 102.0  # mm; with a transmission angle just below its limit
LEVER: dict[str, Any] = {
    "title": "Lever of a Stephenson III six-bar",
    "mechanism": {
        "ground": {"A": ["0 mm", "0 mm"], "D": ["115 mm", "53 mm"], "F": ["111 mm", "-179 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": "33 mm"},
            "coupler": {"joints": ["B", "C"], "length": "127.2 mm", "points": {"E": ["23 mm", "-26 mm"]}},
            "rocker": {"joints": ["D", "C"], "length": "123 mm"},
            "rod": {"joints": ["E", "G"], "length": "64..128 mm"},
            "lever": {"joints": ["F", "G"], "length": "235 mm", "points": {"P": ["149..196 mm", "-77..-49 mm"]}},
        },
        "assembly": {"C": "right of B-D", "G": "left of E-F"},
    },
    "limits": {"transmission_angle": ["20 deg", "160 deg"]},
}


def lever(rod: float, turned: np.ndarray) -> tuple[np.ndarray, float]:
    """P [mm] of the lever with a rod [mm] and P at 173, -63 mm, and its least transmission angle [deg], by complex numbers."""

    def joint(p: Any, a: float, q: Any, b: float, side: int) -> Any:
        d = abs(q - p)
        x = (a * a - b * b + d * d) / (2 * d)
        return p + (q - p) / d * (x + 1j * side * np.sqrt(a * a - x * x))

    b, d, f = 33 * np.exp(1j * turned), 115 + 53j, 111 - 179j + 0 * turned
    c = joint(b, 127.2, d, 123, -1)
    e = b + (c - b) / abs(c - b) * (23 - 26j)
    g = joint(e, rod, f, 235, 1)
    least = min(
        float(np.min(np.degrees(np.abs(np.angle((one - at) / (other - at)))))) for one, other, at in ((b, d, c), (e, f, g))
    )
    return f + (g - f) / abs(g - f) * (173 - 63j), least


def lever_problem(**assembly: str) -> Any:
    """A path that a rod with a transmission angle just below its limit of 20 deg follows exactly."""
    turned = np.radians(-91.0 - 30.0 * np.arange(12))
    at = lever(ROD, turned)[0].tolist()
    points = [
        {"x": f"{p.real} mm", "y": f"{p.imag} mm", "crank": f"{math.degrees(a)} deg"} for p, a in zip(at, turned, strict=True)
    ]
    mechanism = {**LEVER["mechanism"], "assembly": LEVER["mechanism"]["assembly"] | assembly}
    return optlink.read({**LEVER, "mechanism": mechanism, "requirement": {"kind": "path", "point": "P", "points": points}})


def test_a_limit_that_an_exact_linkage_hardly_misses_is_met() -> None:
    """Near an exact linkage the objective is tiny: a merit in multiples of it preferred that linkage to all within the limit."""
    turned = np.linspace(0.0, 2.0 * np.pi, 721)
    assert 19.5 < lever(ROD, turned)[1] < 20.0
    result = solve(lever_problem(), starts=60)
    assert result.valid, result.conflict
    assert result.status is Status.OPTIMAL
    assert lever(result.design["rod.length"] * 1e3, turned)[1] == pytest.approx(20.0, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("assembly", [{}, {"C": "either"}])
def test_a_design_that_the_analysis_of_limits_finds_is_refined(monkeypatch: pytest.MonkeyPatch, assembly: dict[str, str]) -> None:
    """No candidate becomes valid, but a linkage meets all limits: it is the answer, in whichever assembly mode it is found."""

    def failing(self: Polisher, candidate: Candidate, *, near: bool = False) -> LinkageDesign:
        start = self._scaled_point(candidate)
        return validated_design(self.files[candidate.variant], replace(start, status=Status.STALLED))

    monkeypatch.setattr(Polisher, "polish", failing)
    result = solve(lever_problem(**assembly), starts=60)
    assert result.valid, result.conflict
    assert result.status is Status.OPTIMAL
    assert not result.conflict
