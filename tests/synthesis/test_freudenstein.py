"""First steps of function generation against triangles, published optima, and linear programmes solved by another solver."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog, lsq_linear

import optlink
from optlink.linkage.fourbar import four_bar
from optlink.linkage.motion import sweep
from optlink.synthesis import freudenstein, freudenstein as freudenstein_convex
from optlink.synthesis.freudenstein import UNLIMITED, FirstStep, FitProblem, Keep, LoopEquation
from optlink.tasks.design import has_first_steps
from tests.tiers import mostly_slow

DEGREE = math.radians(1.0)
HALF_TURN = np.arange(36) * np.pi / 36
SHARE = np.linspace(0.0, 1.0, 61)
RATIOS = (0.05, 20.0)

# Ranges 60/60, 90/90, 90/90 deg; best largest error [deg], transmission angle within 30 ... 150 deg, found by large multistarts.
LAWS = {
    "log10": (60.0, 60.0, lambda x: np.log10(1.0 + x) / np.log10(2.0), 0.003676),
    "sin": (90.0, 90.0, lambda x: np.sin(0.5 * np.pi * x), 0.190337),
    "exp": (90.0, 90.0, lambda x: (np.exp(x) - 1.0) / (math.e - 1.0), 0.025865),
}


def positions(name: str, share: np.ndarray = SHARE) -> tuple[np.ndarray, np.ndarray]:
    span, rise, law, _ = LAWS[name]
    return np.radians(span * share), np.radians(rise * law(share))


def first_steps(
    phi: np.ndarray,
    psi: np.ndarray,
    phi0: np.ndarray | float,
    psi0: np.ndarray | float,
    measure: str = "max",
    ratios: tuple[float, float] = UNLIMITED,
    count: int = 5,
    *,
    shift: bool = True,
    keep: Keep | None = None,
) -> list[FirstStep]:
    task = FitProblem(LoopEquation(ratios), phi, psi, measure == "max", shift, keep)
    return freudenstein.first_steps(task, phi0, psi0, count)


# --- the two linkages, written again ---------------------------------------------------------------------------------


def rocker_angle(step: FirstStep, phi: np.ndarray) -> np.ndarray:
    """From the triangle B-C-D: direction D -> B, then the angle B-D-C by the law of cosines, C left of B -> D for side +1."""
    to_b = step.crank * np.exp(1j * phi) - 1.0
    cosine = (step.rocker**2 + abs(to_b) ** 2 - step.coupler**2) / (2.0 * step.rocker * abs(to_b))
    return np.angle(to_b) - step.side * np.arccos(cosine)


def rocker_error(step: FirstStep, phi: np.ndarray, psi: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * (rocker_angle(step, step.phi0 + phi) - step.psi0 - psi)))


def nothing(**sizes: float) -> dict[str, float | int | bool | str]:
    return {"residual": 0.0, "error": 0.0, "bound": 0.0, "proven": True, "status": "", **sizes}


def random_four_bar(rng: np.random.Generator) -> tuple[FirstStep, np.ndarray]:
    """A four-bar and inputs, 60 ... 150 deg, over which its transmission angle stays within 20 ... 160 deg."""
    while True:
        crank, coupler, rocker = np.exp(rng.uniform(-1.5, 1.5, 3))
        phi0, side = rng.uniform(-np.pi, np.pi), int(rng.choice([-1, 1]))
        phi = np.radians(rng.uniform(60.0, 150.0)) * rng.choice([-1, 1]) * np.linspace(0.0, 1.0, 15)
        diagonal = abs(crank * np.exp(1j * (phi0 + np.linspace(0.0, phi[-1], 200))) - 1.0)
        if np.max(abs(coupler**2 + rocker**2 - diagonal**2)) < math.cos(20.0 * DEGREE) * 2.0 * coupler * rocker:
            step = FirstStep(**nothing(side=side, crank=crank, coupler=coupler, rocker=rocker, phi0=phi0, psi0=0.0))
            psi0 = float(np.angle(np.exp(1j * rocker_angle(step, np.array([phi0]))[0])))
            return replace(step, psi0=psi0), phi


# --- a linkage is found again in its own motion ----------------------------------------------------------------------


@pytest.mark.parametrize("measure", ["max", "rms"])
@pytest.mark.parametrize("turned", [(0, 0), (1, 0), (0, 1), (1, 1)])
def test_four_bars_are_recovered(measure: str, turned: tuple[int, int]) -> None:
    """Also where the start is given half a turn away, which makes crank or rocker negative."""
    rng = np.random.default_rng(3)
    for _ in range(25):
        true, phi = random_four_bar(rng)
        psi = np.unwrap(rocker_angle(true, true.phi0 + phi) - true.psi0)
        (result,) = first_steps(phi, psi - psi[0], true.phi0 + turned[0] * np.pi, true.psi0 + turned[1] * np.pi, measure)
        for name in ("crank", "coupler", "rocker"):
            assert getattr(result, name) == pytest.approx(getattr(true, name), rel=1e-9)
        assert abs(np.exp(1j * result.phi0) - np.exp(1j * true.phi0)) < 1e-12
        assert abs(np.exp(1j * result.psi0) - np.exp(1j * true.psi0)) < 1e-12
        assert result.side == true.side
        assert max(result.error, result.residual) < 1e-9
        assert result.proven


def test_short_motions_leave_all_digits() -> None:
    """A few degrees: the three columns of the fit are nearly dependent."""
    rng = np.random.default_rng(3)
    errors = []
    for _ in range(200):
        true, phi = random_four_bar(rng)
        phi = 0.06 * phi
        psi = np.unwrap(rocker_angle(true, true.phi0 + phi) - true.psi0)
        (computed,) = first_steps(phi, psi - psi[0], true.phi0, true.psi0)
        errors.append(max(abs(getattr(computed, name) / getattr(true, name) - 1.0) for name in ("crank", "coupler", "rocker")))
    assert np.median(errors) < 2e-12
    assert max(errors) < 2e-9  # the worst conditioned one multiplies the rounding of its angles by 1e6


def test_starts_are_used_as_given() -> None:
    true, phi = random_four_bar(np.random.default_rng(5))
    psi = np.unwrap(rocker_angle(true, true.phi0 + phi) - true.psi0)
    there = first_steps(phi, psi - psi[0], true.phi0, true.psi0, shift=False)[0]
    assert there.error < 1e-9
    assert (there.phi0, there.psi0) == (true.phi0, true.psi0)
    other = (true.phi0 + np.pi, true.psi0)
    for step in first_steps(phi, psi - psi[0], *other, shift=False):
        assert (step.phi0, step.psi0) == other
        assert step.error > 0.1 * DEGREE


def test_between_the_points_of_a_grid() -> None:
    """The search goes on between them, and never leaves the range of a grid that is meant as given."""
    true, phi = random_four_bar(np.random.default_rng(8))
    psi = np.unwrap(rocker_angle(true, true.phi0 + phi) - true.psi0)
    near = np.array([-0.05, 0.04])
    best = first_steps(phi, psi - psi[0], true.phi0 + near, true.psi0 + near, shift=False)[0]
    corners = [first_steps(phi, psi - psi[0], true.phi0 + a, true.psi0 + b)[0].error for a in near for b in near]
    assert best.error < 0.2 * min(corners)
    assert near[0] <= best.phi0 - true.phi0 <= near[1]
    assert near[0] <= best.psi0 - true.psi0 <= near[1]


def test_a_grid_is_not_left() -> None:
    """The true start lies outside: the search goes to the rim and no further."""
    true, phi = random_four_bar(np.random.default_rng(8))
    psi = np.unwrap(rocker_angle(true, true.phi0 + phi) - true.psi0)
    beside = np.array([0.02, 0.05])
    best = first_steps(phi, psi - psi[0], true.phi0 + beside, true.psi0 + beside, shift=False)[0]
    assert min(best.phi0 - true.phi0, best.psi0 - true.psi0) == pytest.approx(0.02, abs=1e-12)
    assert max(best.phi0 - true.phi0, best.psi0 - true.psi0) <= 0.05
    assert best.error > 1e-6


def test_a_linkage_that_does_not_assemble_on_its_way_is_rejected() -> None:
    """Four prescribed positions on one mode, two on either side of a gap that the crank cannot cross."""
    step = FirstStep(**nothing(side=1, crank=1.0, coupler=0.6, rocker=0.7, phi0=-0.9, psi0=0.0))
    assert np.isnan(
        sweep(four_bar(), {"crank": 1.0, "coupler": 0.6, "rocker": 0.7, "frame": 1.0}, 0.0).body_angle("rocker").value
    )
    phi = np.array([-0.9, -0.5, 0.5, 0.9]) + 0.9
    psi = np.unwrap(rocker_angle(step, step.phi0 + phi))
    assert np.all(np.isfinite(psi))
    for result in first_steps(phi, psi - psi[0], step.phi0, float(psi[0])):
        assert result.error > 0.1 * DEGREE


# --- classical functions ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(LAWS))
def test_classical_functions_come_close_to_their_optimum(name: str) -> None:
    """Measured: 1.105, 1.035 and 1.043 times the best known largest error, before any nonlinear programme."""
    phi, psi = positions(name)
    best = first_steps(phi, psi, HALF_TURN, HALF_TURN, "max", RATIOS, 5)[0]
    dense = positions(name, np.linspace(0.0, 1.0, 2001))
    error = np.max(np.abs(rocker_error(best, *dense))) / DEGREE
    assert 0.999 * LAWS[name][-1] < error < 1.15 * LAWS[name][-1]
    assert best.error == pytest.approx(np.max(np.abs(rocker_error(best, phi, psi))), rel=1e-9)
    sizes = {"crank": best.crank, "coupler": best.coupler, "rocker": best.rocker, "frame": 1.0}
    generated = sweep(four_bar(best.side), sizes, best.phi0 + phi).body_angle("rocker").value
    assert np.max(np.abs(np.angle(np.exp(1j * (generated - best.psi0 - psi))))) == pytest.approx(best.error, rel=1e-6)


@pytest.mark.parametrize("name", list(LAWS))
def test_every_step_is_a_proper_linkage(name: str) -> None:
    """Sorted, distinct, one mode over the whole range, ratios met; a planted wrong mode is seen by the same oracle."""
    phi, psi = positions(name)
    steps = first_steps(phi, psi, HALF_TURN, HALF_TURN, "rms", (0.2, 5.0), 8)
    assert len(steps) == 8
    assert [step.error for step in steps] == sorted(step.error for step in steps)
    fine = positions(name, np.linspace(0.0, 1.0, 501))
    for step in steps:
        assert all(0.2 * (1 - 1e-6) < size < 5.0 * (1 + 1e-6) for size in (step.crank, step.coupler, step.rocker))
        assert np.sqrt(np.mean(rocker_error(step, phi, psi) ** 2)) == pytest.approx(step.error, rel=1e-9)
        assert np.max(np.abs(rocker_error(step, *fine))) < 6.0 * step.error
        assert np.max(np.abs(rocker_error(replace(step, side=-step.side), phi, psi))) > 10.0 * step.error
        assert max(abs(step.phi0), abs(step.psi0)) <= np.pi
    starts = np.array([(step.phi0, step.psi0, step.side) for step in steps])
    assert len(np.unique(np.round(starts, 2), axis=0)) == 8


def test_only_required_linkages_are_kept() -> None:
    phi, psi = positions("sin")

    def keep(crank: np.ndarray, coupler: np.ndarray, rocker: np.ndarray, *rest: np.ndarray) -> np.ndarray:
        assert all(a.shape == crank.shape for a in (coupler, rocker, *rest))
        return (rest[-1] == -1) & (coupler < 1.5)

    steps = first_steps(phi, psi, HALF_TURN, HALF_TURN, "max", RATIOS, 6, keep=keep)
    assert len(steps) == 6
    assert all(step.side == -1 and step.coupler < 1.5 for step in steps)


# --- the convex programmes, by another solver ------------------------------------------------------------------------


def band(step: FirstStep, phi: np.ndarray, psi: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows G, g: G @ K <= g holds for the linkages which follow psi on the step's mode with no error above t.

    Freudenstein's equation once more: |B - C|^2 = b^2 with B = a e^(i phi), C = 1 + c e^(i psi), over 2 a c.
    """
    rows, right = [], []
    for x, y in zip(step.phi0 + phi, step.psi0 + psi, strict=True):
        for end, sign in ((y - t, -step.side), (y + t, step.side)):
            rows.append(sign * np.array([math.cos(end), -math.cos(x), 1.0]))
            right.append(sign * math.cos(x - end))
    return np.array(rows), np.array(right)


def certificate(step: FirstStep, phi: np.ndarray, psi: np.ndarray, t: float, ratios: tuple[float, float]) -> float:
    """Least excess z over the band t, G @ K - g <= z, as its dual proves it (HiGHS); positive: no linkage has an error below t.

    The dual is evaluated here: multipliers p >= 0 of the rows with sum 1 and r of the bounds of K.
    """
    matrix, right = band(step, phi, psi, t)
    low, high = 1.0 / ratios[1], 1.0 / ratios[0]
    result = linprog(
        [0.0, 0.0, 0.0, 1.0],
        A_ub=np.column_stack([matrix, -np.ones(len(right))]),
        b_ub=right,
        bounds=[(low, high), (low, high), (None, None), (None, None)],
        method="highs",
    )
    assert result.status == 0
    p = -result.ineqlin.marginals
    assert np.min(p) >= 0.0
    assert np.sum(p) == pytest.approx(1.0, abs=1e-9)
    pull = matrix.T @ p
    assert abs(pull[2]) < 1e-9  # K3 is free
    return float(-p @ right + sum(min(pull[i] * low, pull[i] * high) for i in range(2)))


@pytest.mark.parametrize(
    ("name", "ratios"),
    mostly_slow(
        itertools.product(LAWS, (RATIOS, (0.3, 2.5))), *((name, RATIOS) for name in LAWS), (next(iter(LAWS)), (0.3, 2.5))
    ),
)
def test_largest_error_is_proven_least(name: str, ratios: tuple[float, float]) -> None:
    """For random given starts: the linkage's own constants meet its band, and the dual says that none meets a narrower one."""
    phi, psi = positions(name, np.linspace(0.0, 1.0, 25))
    rng = np.random.default_rng(11)
    proven = limited = 0
    for phi0, psi0 in rng.uniform(0.0, np.pi, (40, 2)):
        for step in first_steps(phi, psi, phi0, psi0, "max", ratios):
            if step.error > 20.0 * DEGREE:
                continue
            k = np.array([1.0 / step.crank, 1.0 / step.rocker, 0.0])
            k[2] = (step.crank**2 - step.coupler**2 + step.rocker**2 + 1.0) / (2.0 * step.crank * step.rocker)
            matrix, right = band(step, phi, psi, step.error * (1.0 + 1e-9))
            assert np.max(matrix @ k - right) < 1e-12
            if step.proven:
                assert step.gap == pytest.approx(1e-4 * step.error, rel=1e-6)
                assert certificate(step, phi, psi, step.bound * (1.0 - 1e-6), ratios) > 0.0
                assert certificate(step, phi, psi, step.error * (1.0 + 1e-6), ratios) < 0.0  # the proof is no tautology
                proven += 1
                limited += max(step.crank, step.rocker) > ratios[1] * (1.0 - 1e-6)
            else:  # the coupler's ratio, which is not convex, is in the way
                assert step.bound == 0.0
                assert min(abs(step.coupler / ratio - 1.0) for ratio in ratios) < 0.05
    assert proven >= 10
    if ratios != RATIOS:
        assert limited >= 3


def test_error_of_a_proven_optimum_alternates() -> None:
    """Three constants: the largest error is met four times at least, its sign changing (Chebyshev)."""
    phi, psi = positions("exp")
    step = first_steps(phi, psi, -120.0 * DEGREE, -140.0 * DEGREE, "max", RATIOS)[0]
    error = rocker_error(step, phi, psi)
    peaks = np.sign(error[np.abs(error) > (1.0 - 1e-3) * step.error])
    assert np.count_nonzero(np.diff(peaks)) >= 3


@pytest.mark.parametrize("ratios", [RATIOS, (0.3, 2.5)])
def test_least_squares_bound(ratios: tuple[float, float]) -> None:
    """Against bounded least squares (scipy) of the model linearised by differences about the step."""
    phi, psi = positions("sin", np.linspace(0.0, 1.0, 25))
    rng = np.random.default_rng(12)
    closed = solved = 0
    for phi0, psi0 in rng.uniform(0.0, np.pi, (40, 2)):
        for step in first_steps(phi, psi, phi0, psi0, "rms", ratios):
            if not step.proven or step.error > 20.0 * DEGREE:
                continue
            k = np.array([1.0 / step.crank, 1.0 / step.rocker, 0.0])
            k[2] = (step.crank**2 - step.coupler**2 + step.rocker**2 + 1.0) / (2.0 * step.crank * step.rocker)

            def error(k: np.ndarray, step: FirstStep = step) -> np.ndarray:
                crank, rocker = 1.0 / k[0], 1.0 / k[1]
                coupler = math.sqrt(crank**2 + rocker**2 + 1.0 - 2.0 * crank * rocker * k[2])
                return rocker_error(replace(step, crank=crank, coupler=coupler, rocker=rocker), phi, psi)

            jacobian = np.column_stack([(error(k + 1e-6 * e) - error(k - 1e-6 * e)) / 2e-6 for e in np.eye(3)])
            low = np.array([1.0 / ratios[1], 1.0 / ratios[1], -np.inf])
            high = np.array([1.0 / ratios[0], 1.0 / ratios[0], np.inf])
            model = lsq_linear(jacobian, jacobian @ k - error(k), (low - 1e-12, high + 1e-12), tol=1e-14)
            least = math.sqrt(2.0 * model.cost / phi.size)
            assert (1.0 - 3e-4) * step.error < least < (1.0 + 1e-6) * step.error
            assert step.bound < (1.0 + 1e-6) * least
            closed += step.status == "closed form"
            solved += step.status == "optimal"
    assert closed >= 3
    if ratios != RATIOS:
        assert solved >= 3


def test_equation_slope_and_output_belong_together() -> None:
    """F vanishes where the output follows, falls there on the mode +1 and rises on -1, and its slope is its derivative."""
    chain = LoopEquation(RATIOS)
    rng = np.random.default_rng(6)
    x = rng.uniform(-3.0, 3.0, (500, 4))
    k = np.column_stack([rng.uniform(*np.sort(chain.box)[:, i], 500) for i in range(2)] + [rng.normal(size=500)]) * [1, 0.1, 1]

    def equation(y: np.ndarray) -> np.ndarray:
        u, v, w = chain.terms(x, y)
        return k[:, :1] * u + k[:, 1:2] * v + k[:, 2:] - w

    for side in (1.0, -1.0):
        y = chain.follow(x, k, np.full(500, side))
        there = np.isfinite(y)
        assert np.count_nonzero(there) > 300
        size = 1.0 + np.abs(k).max(axis=1, keepdims=True) ** 2
        assert np.max(np.abs(equation(y) / size)[there]) < 1e-12
        slope = chain.slope(x, y, k)
        assert np.max(side * slope[there]) <= 1e-9
        difference = (equation(y + 1e-5) - equation(y - 1e-5)) / 2e-5
        assert np.max(np.abs((slope - difference) / size)[there]) < 1e-8


def test_any_multipliers_give_a_bound() -> None:
    """Weak duality: also those that cannot be balanced, where the box of the constants must stand in."""
    rng = np.random.default_rng(7)
    useful = 0
    for _ in range(300):
        matrix, vector, rows = rng.normal(size=(6, 3)), rng.normal(size=6), rng.normal(size=(2, 3))
        room = rng.uniform(0.0, 1.0, 2)
        p = np.where(rng.random(8) < 0.3, rng.random(8), 0.0) + rng.normal(size=8) * 1e-3
        bound = freudenstein_convex.lower_bound(matrix, vector, rows, room, (-np.ones(3), np.ones(3)), p[:6], p[6:])
        result = linprog(
            [0.0, 0.0, 0.0, 1.0],
            A_ub=np.block([[matrix, -np.ones((6, 1))], [rows, np.zeros((2, 1))]]),
            b_ub=np.concatenate([-vector, room]),
            bounds=[(-1.0, 1.0)] * 3 + [(None, None)],
        )
        assert bound <= result.fun + 1e-9
        useful += bound > result.fun - 1.0
    assert useful > 30


def test_a_lying_solver_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever multipliers and steps come back as "optimal": the error is measured, and the bound stays below the optimum."""
    phi, psi = positions("log10")
    start = (0.9, 1.3)
    honest = first_steps(phi, psi, *start, "max", RATIOS)[0]
    rng = np.random.default_rng(1)
    solve = freudenstein_convex.ConvexFit.__call__

    def lie(self: freudenstein_convex.ConvexFit, *data: np.ndarray) -> freudenstein_convex.ConvexStep:
        answer = solve(self, *data)
        assert answer is not None
        noise = [rng.normal(size=part.shape) for part in (answer.step, answer.rows, answer.limits)]
        return freudenstein_convex.ConvexStep(answer.step + noise[0], answer.rows + noise[1], answer.limits + noise[2], "optimal")

    monkeypatch.setattr(freudenstein_convex.ConvexFit, "__call__", lie)
    for _ in range(10):
        (step,) = first_steps(phi, psi, *start, "max", RATIOS)
        assert step.status == "optimal"
        assert step.error >= honest.bound
        assert step.bound <= honest.error
        assert np.max(np.abs(rocker_error(step, phi, psi))) == pytest.approx(step.error, rel=1e-9)
        assert step.proven == (step.error <= honest.error * (1.0 + 3e-4) and step.bound > 0.0)
    monkeypatch.setattr(freudenstein_convex.ConvexFit, "__call__", lambda self, *data: None)
    (silent,) = first_steps(phi, psi, *start, "max", RATIOS)
    assert (silent.status, silent.bound, silent.proven) == ("no answer", 0.0, False)


# --- what has no convex first designs ----------------------------------------------------------------------------------


@pytest.mark.parametrize("change", [{"requirement.points": 1}, {"limits.link_ratio": 1.0}, {"limits.link_ratio": {"min": 2e3}}])
def test_a_function_without_convex_first_designs_is_searched_from_the_start_of_the_file(change: dict[str, object]) -> None:
    """Two positions do not determine three constants, and a single ratio leaves no range of lengths."""
    file = optlink.load("function-sin", change)
    assert not has_first_steps(file.spec)
    result = optlink.solve(file, starts=1)
    assert result.starts == len(file.variants())
    assert result.first_step is None
    assert result.evidence is None


@pytest.mark.parametrize("psi", [[0.0, 1e-13, 0.0, 1e-13, 0.0], [0.0, 1.0, 0.0, 1.0, 0.0], [0.0, 3.0, -3.0, 2.0, 9.0]])
def test_hopeless_laws_give_no_wonders(psi: list[float]) -> None:
    """An output that all but stands still, jumps or tumbles: an empty list, or linkages whose error is what it is."""
    phi = np.linspace(0.0, 1.0, 5)
    for step in first_steps(phi, psi, HALF_TURN, HALF_TURN, "max", RATIOS):
        assert np.max(np.abs(rocker_error(step, phi, np.array(psi)))) == pytest.approx(step.error, rel=1e-6, abs=1e-9)


def test_three_positions_are_met_exactly() -> None:
    """Three constants, three positions: every start does, those with the best transmission come first."""
    phi, psi = np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.3, 0.8])
    steps = first_steps(phi, psi, HALF_TURN, HALF_TURN, "max", RATIOS, 20)
    assert len(steps) == 20
    assert max(np.max(np.abs(rocker_error(step, phi, psi))) for step in steps) < 1e-9
    diagonals = [abs(step.crank * np.exp(1j * (step.phi0 + np.linspace(0.0, 1.0, 50))) - 1.0) for step in steps]
    cosines = [
        np.max(np.abs((step.coupler**2 + step.rocker**2 - diagonal**2) / (2.0 * step.coupler * step.rocker)))
        for step, diagonal in zip(steps, diagonals, strict=True)
    ]
    assert np.all(np.diff(cosines) > -1e-3)
    assert cosines[0] < math.cos(60.0 * DEGREE)
