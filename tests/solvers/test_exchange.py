"""Exchange of function synthesis: the largest error over the whole range, by brute force with another formula."""

from __future__ import annotations

import math

import numpy as np
import pytest

import optlink
from optlink.errors import Status
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import build
from optlink.solvers import exchange, multistart
from optlink.solvers.contract import BACKENDS
from optlink.solvers.solution import Solution
from optlink.synthesis import freudenstein

RAW = {
    "title": "function",
    "mechanism": {
        "type": "four-bar",
        "frame": "100 mm",
        **{name: {"bounds": ["1 mm", "5000 mm"]} for name in ("crank", "coupler", "rocker")},
        "assembly": "right",
    },
    "limits": {"crank": "span", "transmission_angle": ["30 deg", "150 deg"], "link_ratio": [0.05, 20]},
}


def problem(function: str, x: list[float], turned: float, swung: float, assembly: str = "right") -> optlink.ProblemFile:
    """The problem of a function y(x) over a range [deg]."""
    law = {"function": function, "x": x, "input": f"{turned} deg", "output": f"{swung} deg"}
    requirement = {"kind": "function", "measure": "max", "law": law}
    return optlink.read(RAW | {"requirement": requirement}).override({"mechanism.assembly": assembly})


def at_positions(file: optlink.ProblemFile) -> tuple[NLP, Solution]:
    """The programme, and its optimum at the design positions from the best convex first design."""
    nlp = build(file.spec)
    first = freudenstein.values(file.spec, freudenstein.steps(file.spec)[0])
    return nlp, multistart.solve_from(nlp, nlp.x_of(first), "ipopt, close")


def largest_error(file: optlink.ProblemFile, design: dict[str, float]) -> float:
    """The largest error [rad] at 40,001 positions, by the law of cosines."""
    offsets = np.linspace(0.0, file.spec.span, 40_001)
    crank = design["phi0"] + offsets
    x, y = design["frame"] - design["crank"] * np.cos(crank), -design["crank"] * np.sin(crank)  # from B to D
    diagonal = np.hypot(x, y)
    cosine = (diagonal**2 + design["rocker"] ** 2 - design["coupler"] ** 2) / (2.0 * diagonal * design["rocker"])
    side = 1.0 if file.spec.four_bar.side > 0 else -1.0
    rocker = np.arctan2(-y, -x) - side * np.arccos(cosine)  # C lies to the left of B -> D
    target = file.spec.law.curve(offsets, design["phi0"], design["psi0"])
    return float(np.max(np.abs(np.remainder(target - rocker + math.pi, 2.0 * math.pi) - math.pi)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("function", "x", "turned", "swung", "known"),
    [
        ("cos(x)", [-0.62, 0.52], -60, -48, 0.00253929821),  # fewer peaks than unknowns determine the optimum
        ("sin(x)", [0.95, 2.09], -58, -50, 0.00286064),
        ("x + 0.002*sin(200*x)", [0, 1], -60, -50, math.inf),  # 64 peaks, of which the programme has 12
    ],
)
def test_an_optimum_is_level_at_all_peaks(function: str, x: list[float], turned: float, swung: float, known: float) -> None:
    file = problem(function, x, turned, swung, "right" if math.isfinite(known) else "left")
    nlp, solution = at_positions(file)
    level = exchange.solve_semi_infinite(file.spec, solution, "ipopt", near=True)
    assert level.status is Status.OPTIMAL
    design = file.spec.design(level.design)
    error = largest_error(file, design)
    assert error == pytest.approx(level.objective, rel=1e-7)
    assert error <= known * (1.0 + 1e-5)
    rng = np.random.default_rng(3)
    for step in (1e-3, 1e-4, 1e-5):  # no neighbour within the limits is better
        for x in level.x + step * rng.standard_normal((40, len(level.x))):
            near = multistart.solution_at(nlp, np.clip(x, nlp.x_low, nlp.x_high), "")
            if near.usable:
                assert largest_error(file, file.spec.design(near.design)) >= error * (1.0 - 1e-8)


@pytest.mark.slow
def test_peaks_that_are_not_level_are_no_optimum(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error of a stalled design is that of the whole range, so that it is not compared with the error of other positions."""
    file = problem("sin(x)", [0.95, 2.09], -58, -50)
    _, solution = at_positions(file)
    monkeypatch.setattr(exchange, "EXCHANGES", 1)
    stalled = exchange.solve_semi_infinite(file.spec, solution, "ipopt", near=True)
    assert stalled.status is Status.STALLED
    assert stalled.objective > solution.objective
    assert stalled.objective == pytest.approx(largest_error(file, file.spec.design(stalled.design)), rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("assembly", ["left", "right"])
def test_both_back_ends_level_the_peaks(assembly: str) -> None:
    """A largest error of 1e-4 needs its own scale in SLSQP, also beside the places of its peaks: its line search failed."""
    file = optlink.load("function-log10", {"mechanism.assembly": assembly})
    _, solution = at_positions(file)
    ends = [exchange.solve_semi_infinite(file.spec, solution, name) for name in BACKENDS]
    assert [end.status for end in ends] == [Status.OPTIMAL, Status.OPTIMAL]
    assert ends[0].objective == pytest.approx(ends[1].objective, rel=1e-9)
    assert ends[0].objective == pytest.approx(largest_error(file, file.spec.design(ends[1].design)), rel=1e-7)
