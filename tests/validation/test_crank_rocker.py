"""Published and independently computed numbers of the crank-rocker.

The case is a classic of Chinese textbooks on optimum machine design (solved there with MATLAB's fmincon; printed optimum
l2 = 412.26, l3 = 232.2417 mm). The reference values were computed by four routes: SciPy SLSQP with exact derivatives, IPOPT,
Octave's sqp on the textbook's own functions, and a grid.

The tolerance of 1e-3 mm on lengths is that of the reference table (five decimals of a millimetre); the printed optimum itself
is 0.6 mm away from it because it is no feasible point of its own problem.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

import optlink
from tests.tiers import mostly_slow

L2, L3, F = 412.86542, 232.24617, 0.00759237


@pytest.mark.parametrize("backend", ["slsqp", "ipopt"])
def test_crank_rocker_l2_412_l3_232(crank_rocker, backend):
    result = optlink.solve(crank_rocker, backend)
    assert result.valid
    assert abs(result.design["coupler"] * 1e3 - 412) < 1
    assert abs(result.design["rocker"] * 1e3 - 232) < 0.5


def test_both_back_ends_reach_the_reference_and_agree(solved):
    assert solved.valid
    for name in ("slsqp", "ipopt"):
        solution = solved.backends[name]
        assert solution.design["coupler"] * 1e3 == pytest.approx(L2, abs=1e-3)
        assert solution.design["rocker"] * 1e3 == pytest.approx(L3, abs=1e-3)
        assert solution.objective == pytest.approx(F, abs=1e-8)
    slsqp, ipopt = solved.backends["slsqp"].design, solved.backends["ipopt"].design
    assert slsqp["coupler"] * 1e3 == pytest.approx(ipopt["coupler"] * 1e3, abs=1e-6)
    assert slsqp["rocker"] * 1e3 == pytest.approx(ipopt["rocker"] * 1e3, abs=1e-6)


def transcription(l2: float, l3: float, points: int = 30) -> tuple[float, float, float]:
    """The textbook's formulas as printed, in mm and plain math: objective, and the cosines of the transmission extremes."""
    l1, l4 = 100.0, 500.0
    phi0 = math.acos(((l1 + l2) ** 2 - l3**2 + l4**2) / (2 * (l1 + l2) * l4))
    psi0 = math.acos(((l1 + l2) ** 2 - l3**2 - l4**2) / (2 * l3 * l4))
    total = 0.0
    for i in range(points + 1):
        phi = phi0 + i * math.pi / 2 / points
        r = math.sqrt(l1**2 + l4**2 - 2 * l1 * l4 * math.cos(phi))
        alpha = math.acos((r**2 + l3**2 - l2**2) / (2 * r * l3))
        beta = math.acos((r**2 + l4**2 - l1**2) / (2 * r * l4))
        psi = math.pi - alpha - beta if phi <= math.pi else math.pi - alpha + beta
        total += (psi0 + 2 / (3 * math.pi) * (phi - phi0) ** 2 - psi) ** 2
    at_pi = (l2**2 + l3**2 - (l4 + l1) ** 2) / (2 * l2 * l3)
    at_0 = (l2**2 + l3**2 - (l4 - l1) ** 2) / (2 * l2 * l3)
    return total, at_pi, at_0


def test_objective_equals_the_textbook_s_own_formulas(crank_rocker):
    for l2, l3 in ((412.86542, 232.24617), (412.26, 232.2417), (430.0, 300.0), (300.0, 420.0)):
        computed = optlink.validate(crank_rocker, {"coupler": l2 / 1e3, "rocker": l3 / 1e3}).objective
        assert computed == pytest.approx(transcription(l2, l3)[0], rel=1e-11)


def test_no_feasible_neighbour_on_a_grid_is_better(solved):
    """The optimum against brute force with the textbook's formulas: a fine grid around it, feasible points alone."""
    l2, l3 = solved.design["coupler"] * 1e3, solved.design["rocker"] * 1e3
    best, cosine = transcription(l2, l3)[:2]
    assert cosine == pytest.approx(-math.sqrt(0.5), abs=1e-12)
    better = [
        (a, b)
        for a in np.linspace(l2 - 30, l2 + 30, 61)
        for b in np.linspace(l3 - 30, l3 + 30, 61)
        if (values := transcription(a, b))[1] >= -math.sqrt(0.5) and values[0] < best - 1e-12
    ]
    assert better == []
    infeasible_and_better = transcription(412.26, 232.2417)
    assert infeasible_and_better[0] < best
    assert infeasible_and_better[1] < -math.sqrt(0.5)


def test_source_s_rounding_of_the_square_root_of_two(crank_rocker):
    """1.414 for sqrt(2): limits on the cosine given as numbers; second row of the reference table."""
    raw = {**crank_rocker.raw, "limits": {"crank": "full rotation", "transmission_cosine": [-1.414 / 2, 1.414 / 2]}}
    result = optlink.solve(optlink.read(raw), "both")
    assert result.valid
    assert result.design["coupler"] * 1e3 == pytest.approx(412.88606, abs=1e-3)
    assert result.design["rocker"] * 1e3 == pytest.approx(232.24298, abs=1e-3)
    assert result.objective == pytest.approx(0.00759364, abs=1e-8)


def test_printed_optimum_violates_its_own_limit(crank_rocker):
    result = optlink.validate(crank_rocker, {"coupler": 0.41226, "rocker": 0.2322417})
    failed = [check for check in result.validation.checks if not check.passed]
    assert [check.name for check in failed] == ["largest transmission angle"]
    assert failed[0].value == pytest.approx(135.298, abs=5e-4)
    assert result.objective == pytest.approx(0.0075491, abs=5e-8)
    assert not result.valid


@pytest.mark.parametrize(
    ("points", "f", "l2"),
    mostly_slow(
        [(50, 0.01202913, 412.31429), (60, 0.01424872, 412.17469), (90, 0.02090930, 411.94041)], (50, 0.01202913, 412.31429)
    ),
)
def test_more_points(crank_rocker, points, f, l2):
    result = optlink.solve(crank_rocker.override({"requirement.points": points}), "both")
    assert result.valid
    assert result.objective == pytest.approx(f, abs=1e-8)
    assert result.design["coupler"] * 1e3 == pytest.approx(l2, abs=1e-3)


# Angle of the output link and its sensitivities at the optimum (lengths 1, 4.12865417, 2.3224617, 5): phi, psi [deg],
# d psi / d l1 ... l4 [rad per unit length]. Six printed decimals, hence 1e-6.
SENSITIVITIES = [
    (0, 103.533936, -0.382699, -0.457120, 0.153498, 0.382699),
    (60, 105.157531, -0.328158, -0.431796, 0.032414, 0.407123),
    (120, 129.480461, 0.140934, -0.481177, -0.214789, 0.468903),
    (240, 147.377012, 0.420297, -0.481177, -0.214789, 0.413031),
]


@pytest.mark.parametrize(("phi", "psi", "d1", "d2", "d3", "d4"), SENSITIVITIES)
def test_output_angle_and_its_sensitivities(phi, psi, d1, d2, d3, d4):
    lengths = {"crank": 1.0, "coupler": 4.12865417, "rocker": 2.3224617, "frame": 5.0}
    linkage = optlink.linkage.four_bar()
    crank = (math.cos(math.radians(phi)), math.sin(math.radians(phi)))

    def angle(sizes):
        from optlink.linkage.vector2d import angle as direction_angle

        pose = linkage.pose(sizes, crank)
        return direction_angle(pose.direction("rocker"))

    assert math.degrees(angle(lengths)) == pytest.approx(psi, abs=1e-6)
    for name, expected in zip(lengths, (d1, d2, d3, d4), strict=True):
        step = angle({**{k: complex(v) for k, v in lengths.items()}, name: lengths[name] + 1e-30j})
        assert step.imag / 1e-30 == pytest.approx(expected, abs=1.5e-6)
