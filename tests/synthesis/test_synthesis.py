"""The engine of path and motion generation: exact slopes, linear fits, descent, starts and rounds, the programme."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

import optlink
from optlink.linkage.fourbar import LENGTHS, Inversion, grashof
from optlink.linkage.vector2d import unit
from optlink.optimization.programme import build
from optlink.problem.design import STEP
from optlink.synthesis import batch_search, levenberg_marquardt
from optlink.synthesis.batch import INSIDE, WEIGHT, Batch
from optlink.synthesis.batch_search import PERFECT, Searcher
from optlink.synthesis.levenberg_marquardt import SimilarityFit, minimise
from optlink.validation.design import deviations
from tests import synthesis_oracle as oracle
from tests.stated import ANGLE, SLIDER_CRANK, SPOTS, STEPHENSON, document, four_bar_section, free, model
from tests.tiers import mostly_slow

Array = np.ndarray
TURN = 2.0 * math.pi


# --- residuals and limits with their slopes --------------------------------------------------------------------------------

ANGLES5 = np.array([0.0, 1.1, 2.3, 3.7, 5.0])
POSES = np.column_stack([SPOTS[:4], [0.1, 0.5, -0.3, 2.9]])
WEIGHTS = np.array([1.0, 2.0, 0.5, 3.0, 1.5])
FOUR_LIMITS = {
    "transmission_angle": ["70 deg", "100 deg"],
    "link_ratio": [0.8, 1.5],
    "frame_length": ["50 mm", "90 mm"],
    "pivots": {"x": ["-5 mm", "5 mm"], "y": ["-5 mm", "6 mm"]},
}
TASKS: dict[str, Mapping[str, object]] = {
    "left, free": document(four_bar_section("left"), limits=FOUR_LIMITS, closed=True),
    "right, free, weights": document(four_bar_section("right"), limits=FOUR_LIMITS, weights=WEIGHTS),
    "timed from start": document(four_bar_section("right"), limits=FOUR_LIMITS, crank=ANGLES5, timing="from start"),
    "timed as given, clockwise": document(four_bar_section("left"), limits=FOUR_LIMITS, crank=-ANGLES5),
    "not placed": document(four_bar_section("left", pivot=None, direction=None), limits=FOUR_LIMITS),
    "some sizes fixed": document(four_bar_section("left", crank="25 mm", direction="20 deg"), limits=FOUR_LIMITS),
    "motion, free": document(four_bar_section("right"), POSES, FOUR_LIMITS, mark=ANGLE, angle_length="12 mm"),
    "motion, timed": document(four_bar_section("left"), POSES, FOUR_LIMITS, ANGLES5[:4], timing="from start"),
    "double-crank": document(four_bar_section("left"), limits={**FOUR_LIMITS, "crank": "double-crank"}),
    "swing and time ratio": document(
        four_bar_section("right"), limits={"swing_angle": ["50 deg", "55 deg"], "time_ratio": [1.3, 1.4]}
    ),
    "span": document(four_bar_section("left"), limits={"crank": "span", "transmission_angle": ["30 deg", "150 deg"]}),
    "slider-crank, free": document(SLIDER_CRANK, limits={"pivots": {"x": ["-1 mm", "1 mm"]}}, closed=True),
    "slider-crank, from start": document(SLIDER_CRANK, crank=-ANGLES5, timing="from start"),
    "slider-crank, given": document(SLIDER_CRANK, crank=ANGLES5),
    "six-bar, free": document(STEPHENSON, 2.0 * SPOTS + 80.0, {"transmission_angle": ["80 deg", "100 deg"]}),
    "six-bar, motion": document(STEPHENSON, POSES, {"pivots": {"y": ["-10 mm", "10 mm"]}}, ANGLES5[:4], timing="from start"),
}


@pytest.fixture(params=TASKS)
def batch(request: pytest.FixtureRequest) -> Batch:
    return Batch(model(TASKS[str(request.param)]))


def sample(batch: Batch, count: int, seed: int = 0) -> tuple[Array, Array]:
    """Random designs that assemble at their points, nowhere near where modes meet, and inside their bounds."""
    rng = np.random.default_rng(seed)
    result: list[tuple[Array, Array]] = []
    for _ in range(200):
        x = batch_search.random_designs(batch, 400, rng)
        t = batch_search.random_crank_angles(batch, 400, rng) if batch.free_timing else np.zeros((400, len(batch.data.columns)))
        x = batch.low + (batch.high - batch.low) * np.clip((x - batch.low) / (batch.high - batch.low), 1e-3, 1.0 - 1e-3)
        mechanism = batch.problem.linkage
        with np.errstate(all="ignore"):
            pose = mechanism.pose(batch.values(x), unit(batch.crank_angles(x, t)))
            whole = np.all([np.all(pose.margins[g.joint] > 0.02, axis=1) for g in mechanism.groups], axis=0)
        result.append((x[whole], t[whole]))
        if sum(len(each) for each, _ in result) >= count:
            break
    x, t = (np.concatenate(parts)[:count] for parts in zip(*result, strict=True))
    assert len(x) == count
    return x, t


def residual_of(batch: Batch, x: Array, t: Array) -> Array:
    """Residuals by the plain formulas, elementwise, of complex numbers too."""
    problem = batch.problem
    values: dict[str, Any] = {name: np.full((len(x), 1), quantity.value) for name, quantity in problem.quantities.items()}
    real = batch.origin + x * batch.scale
    values |= {name: real[:, i : i + 1] for i, name in enumerate(batch.names)}
    angles = t
    if not batch.free_timing:
        begin = x[:, batch.start : batch.start + 1] if batch.start >= 0 else np.zeros((len(x), 1))
        angles = begin + np.asarray(batch.data.offsets)
    pose = problem.linkage.pose(values, unit(angles))
    parts = problem.deviation(pose, values, tuple(batch.data.columns.T))
    return np.stack(parts, axis=-1) * (batch.data.roots / problem.size)[:, None]


def test_residuals_and_their_slopes_by_complex_step(batch: Batch) -> None:
    x, t = sample(batch, 12)
    r, by_x, by_t = batch.residuals(x, batch.crank_angles(x, t))
    plain = residual_of(batch, x, t)
    np.testing.assert_allclose(r, plain, rtol=1e-10, atol=1e-11)
    tiny = 1e-40
    scale = 1.0 + np.max(np.abs(by_x), axis=(1, 2, 3))
    for i in range(x.shape[1]):
        moved = x.astype(complex)
        moved[:, i] += 1j * tiny
        slope = residual_of(batch, moved, t.astype(complex)).imag / tiny
        assert np.max(np.abs(by_x[..., i] - slope), axis=(1, 2)) / scale == pytest.approx(0.0, abs=1e-9), batch.names[i]
    if batch.free_timing:
        slope = residual_of(batch, x.astype(complex), t + 1j * tiny).imag / tiny
        assert np.max(np.abs(by_t - slope), axis=(1, 2)) / scale == pytest.approx(0.0, abs=1e-9)


def test_slopes_of_missed_limits_by_differences(batch: Batch) -> None:
    x, t = sample(batch, 12, seed=1)
    n = x.shape[1]
    # off x = 0 for the limits of the whole revolution too, where a design may not close
    h, by_h = batch.violations(x, batch.crank_angles(x, t))
    assert h.shape == (*by_h.shape[:2],)
    assert by_h.shape[2] == n
    if batch.problem.limits.link_ratio or batch.problem.limits.pivots:
        assert np.any(h != 0.0)
    step = 1e-6
    for i in range(n):
        above, below = x.copy(), x.copy()
        above[:, i] += step
        below[:, i] -= step
        up, down = (batch.violations(side, batch.crank_angles(side, t))[0] for side in (above, below))
        slope = (up - down) / (2.0 * step)
        kink = (up == 0.0) | (down == 0.0) | (h == 0.0)  # a limit that holds on one side has no slope, or half of one
        close = np.isclose(by_h[..., i], slope, rtol=2e-5, atol=1e-4 * (1.0 + np.max(np.abs(by_h), initial=0.0)) * 1e-2)
        assert np.all(close | kink), batch.names[i]


def test_a_limit_that_holds_costs_nothing(batch: Batch) -> None:
    x, t = sample(batch, 30, seed=2)
    h, by_h = batch.violations(x, batch.crank_angles(x, t))
    assert np.all(np.isfinite(h))
    assert np.all(by_h[h == 0.0] == 0.0)


def test_missed_limits_are_those_of_the_lengths() -> None:
    """Grashof's conditions, link ratios and pivots by hand."""
    problem = model(document(four_bar_section("left"), limits={"link_ratio": [0.8, 1.5], "pivots": {"x": ["-5 mm", "5 mm"]}}))
    batch = Batch(problem)
    rng = np.random.default_rng(3)
    x, t = batch_search.random_designs(batch, 200, rng), batch_search.random_crank_angles(batch, 200, rng)
    values = {name: v[:, 0] for name, v in batch.values(x).items()}
    crank, coupler, rocker, frame = (values[name] for name in LENGTHS)
    others = np.sort([coupler, rocker, frame], axis=0)
    proper = (crank < others[0]) & (crank + others[2] < others[0] + others[1])
    ratio = np.array([crank, coupler, rocker]) / frame
    inside = np.all((ratio >= 0.8) & (ratio <= 1.5), axis=0)
    ends = np.array([values["A.x"], values["A.x"] + frame * np.cos(values["direction"])])
    inside &= np.all(np.abs(ends) <= 5e-3, axis=0)
    h, _ = batch.violations(x, batch.crank_angles(x, t))
    missed = np.any(h != 0.0, axis=1)
    assert np.all(missed[~(proper & inside)])
    sums = np.array([others[0] + others[1] - crank - others[2], others[0] - crank]) / problem.size
    clear = np.min(sums, axis=0) > 2.0 * INSIDE
    assert not np.any(missed[proper & inside & clear])
    off = np.maximum(0.8 - ratio, 0.0) + np.maximum(ratio - 1.5, 0.0)
    assert np.all(np.sum(h**2, axis=1) >= 0.99 * WEIGHT**2 * np.sum(off**2, axis=0))


def test_crank_angles_follow_from_the_start() -> None:
    timed = Batch(model(TASKS["timed from start"]))
    x, t = sample(timed, 4)
    np.testing.assert_allclose(timed.crank_angles(x, t), x[:, timed.start : timed.start + 1] + ANGLES5, rtol=0, atol=1e-12)
    given = Batch(model(TASKS["timed as given, clockwise"]))
    x, t = sample(given, 4)
    np.testing.assert_allclose(given.crank_angles(x, t), np.tile(-ANGLES5, (4, 1)), rtol=0, atol=1e-12)
    assert Batch(model(TASKS["left, free"])).free_timing


# --- the linear fit ----------------------------------------------------------------------------------------------------------


def cost_of(batch: Batch, x: Array, t: Array) -> Array:
    r, _, _ = batch.residuals(x, batch.crank_angles(x, t))
    return np.einsum("bpk,bpk->b", r, r)


FITTED = ["left, free", "right, free, weights", "timed from start", "timed as given, clockwise", "double-crank", "span"]


@pytest.mark.parametrize("name", FITTED)
def test_fit_of_a_four_bar_is_complex_least_squares(name: str) -> None:
    """Place, size, direction and coupler point by numpy's own least squares: P = a + w S + b u."""
    batch = Batch(model(TASKS[name]))
    fit = SimilarityFit(batch)
    assert fit.applies
    x, t = sample(batch, 20)
    values, angles = batch.values(x), batch.crank_angles(x, t)
    fitted, moved = fit.fit(x, angles)
    assert np.array_equal(moved, angles)  # crank angles count from the frame, which turns with the rest
    computed = cost_of(batch, fitted, t)
    with np.errstate(all="ignore"):
        pose = batch.problem.linkage.pose(values, unit(angles))
    arm = [np.broadcast_to(c, angles.shape) for c in pose.point("B")]
    axis = [np.broadcast_to(c, angles.shape) for c in pose.direction("coupler")]
    expected = batch.data.columns[:, 0] + 1j * batch.data.columns[:, 1]
    size, roots = batch.problem.size, batch.data.roots
    for k in range(len(x)):
        basis = np.stack([np.ones(len(expected)), (arm[0][k] + 1j * arm[1][k]) / size, axis[0][k] + 1j * axis[1][k]], axis=1)
        best = np.linalg.lstsq(basis * roots[:, None], expected / size * roots, rcond=None)[0]
        left = np.sum(np.abs((basis @ best - expected / size) * roots) ** 2)
        assert computed[k] == pytest.approx(left, rel=1e-6, abs=1e-10)


def test_a_weight_draws_the_fit_to_its_point() -> None:
    heavy = np.array([1.0, 1.0, 1e6, 1.0, 1.0])
    batch = Batch(model(document(four_bar_section("right"), weights=heavy)))
    x, t = sample(batch, 10)
    fitted, _ = SimilarityFit(batch).fit(x, t)
    r, _, _ = batch.residuals(fitted, t)
    assert np.all(np.abs(r[:, 2]) / 1e3 < 0.02 * np.max(np.abs(r), axis=(1, 2))[:, None])


PLACED = [*FITTED, "slider-crank, free", "slider-crank, from start", "six-bar, free"]


@pytest.mark.parametrize("name", PLACED)
def test_no_linear_parameters_are_better_than_the_fit(name: str) -> None:
    """Moving, turning and scaling the whole by a little never improves it, nor does moving the point on its body."""
    batch = Batch(model(TASKS[name]))
    fit = SimilarityFit(batch)
    assert fit.applies
    x, t = sample(batch, 12, seed=3)
    fitted, t = fit.fit(x, batch.crank_angles(x, t))
    least = cost_of(batch, fitted, t)
    again, same = fit.fit(fitted, batch.crank_angles(fitted, t))
    np.testing.assert_allclose(cost_of(batch, again, same), least, rtol=1e-6, atol=1e-12)  # and it stays there
    rng = np.random.default_rng(4)
    ground = [i for pair in fit.ground for i in pair]
    for size in (1e-4, 1e-2, 0.3):
        for _ in range(8):
            moved, at = fitted.copy(), t.copy()
            x0 = fitted[:, fit._pivot]
            scale, by, shift = 1.0 + size * rng.normal(), size * rng.normal(), size * rng.normal(size=2)
            turn = np.array([[math.cos(by), -math.sin(by)], [math.sin(by), math.cos(by)]])
            for i, j in fit.ground:
                moved[:, [i, j]] = x0 + shift + scale * (fitted[:, [i, j]] - x0) @ turn.T
            moved[:, fit.lengths] *= scale
            moved[:, fit.turning] += by
            if fit.counted_from_x:
                at = at + by
                if batch.start >= 0:
                    moved[:, batch.start] += by
            if fit.point:
                moved[:, fit.point] = moved[:, fit.point] * scale + size * rng.normal(size=2)
            assert ground
            assert np.all(cost_of(batch, moved, at) >= least * (1.0 - 1e-9) - 1e-13)


def test_the_fit_recovers_a_planted_linkage() -> None:
    """Right proportions and timing, anywhere: the fit alone puts place, size, direction and coupler point right."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        design = oracle.random_crank_rocker(rng)
        phi = oracle.random_angles(rng, 8)
        spots = oracle.planted_path(design, phi)
        wide = {"points": {"P": [free(-1e4, 1e4)] * 2}, "pivot": [free(-1e4, 1e4)] * 2}
        wide |= dict.fromkeys(LENGTHS, free(0.01, 1e4))
        batch = Batch(model(document(four_bar_section("left" if design["mode"] > 0 else "right", **wide), spots)))
        x = np.zeros((1, len(batch.names)))
        for name in LENGTHS:
            x[0, batch.names.index(name)] = 0.37 * design[name]
        fitted, _ = SimilarityFit(batch).fit(x, phi[None])
        assert cost_of(batch, fitted, phi[None])[0] < 1e-16
        values = batch.values(fitted)
        for name in LENGTHS:
            assert values[name][0, 0] * 1e3 == pytest.approx(design[name], rel=1e-8)
        assert values["P.along"][0, 0] * 1e3 == pytest.approx(design["along"], rel=1e-6, abs=1e-6)
        assert values["A.x"][0, 0] * 1e3 == pytest.approx(design["x"], rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("name", ["not placed", "some sizes fixed", "motion, free", "motion, timed", "slider-crank, given"])
def test_fixed_position_or_size_is_not_fitted(name: str) -> None:
    assert not SimilarityFit(Batch(model(TASKS[name]))).applies


# --- descent -----------------------------------------------------------------------------------------------------------------


def as_vector(batch: Batch) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """Residuals and missed limits of one design as scipy takes them, and their slopes: crank angles behind the sizes."""
    n, count = len(batch.names), len(batch.data.columns)

    def split(z: Array) -> tuple[Array, Array]:
        x = z[None, :n]
        return x, batch.crank_angles(x, z[None, n:] if batch.free_timing else np.zeros((1, count)))

    def f(z: Array) -> Array:
        x, angles = split(z)
        return np.concatenate([batch.residuals(x, angles)[0].ravel(), batch.violations(x, angles)[0].ravel()])

    def slopes(z: Array) -> Array:
        x, angles = split(z)
        _, by_x, by_t = batch.residuals(x, angles)
        upper = by_x[0].reshape(-1, n)
        lower = batch.violations(x, angles)[1][0]
        if batch.free_timing:
            k = by_t.shape[2]
            own = np.zeros((count * k, count))
            for p in range(count):
                own[p * k : (p + 1) * k, p] = by_t[0, p]
            upper, lower = np.hstack([upper, own]), np.hstack([lower, np.zeros((len(lower), count))])
        return np.vstack([upper, lower])

    return f, slopes


def minimum_by_scipy(batch: Batch, x: Array, t: Array) -> float:
    f, slopes = as_vector(batch)
    more = [np.full(len(t), math.inf)] if batch.free_timing else []
    begin = np.concatenate([x, t]) if batch.free_timing else x
    bounds = (np.concatenate([batch.low, *(-m for m in more)]), np.concatenate([batch.high, *more]))
    result = least_squares(f, begin, slopes, bounds, xtol=1e-15, ftol=1e-15, gtol=1e-12, max_nfev=4000)
    return 2.0 * float(result.cost)


DESCENDED = [
    "left, free",
    "timed from start",
    "timed as given, clockwise",
    "some sizes fixed",
    "motion, timed",
    "slider-crank, from start",
]


@pytest.mark.parametrize("name", mostly_slow(DESCENDED, "left, free", "motion, timed", "slider-crank, from start"))
def test_descent_ends_where_scipy_does(name: str) -> None:
    """From near an optimum both reach it; the crank angles that are eliminated change nothing in that."""
    batch = Batch(model(TASKS[name]))
    x, t = sample(batch, 200, seed=5)
    ends = minimise(batch, x, t, 300)
    rng = np.random.default_rng(6)
    checked = 0
    for i in np.argsort(ends.cost)[:4]:
        near = np.clip(ends.x[i] + 1e-3 * rng.normal(size=x.shape[1]), batch.low, batch.high)
        at = ends.t[i] + (1e-3 * rng.normal(size=t.shape[1]) if batch.free_timing else 0.0)
        again = minimise(batch, near[None], at[None], 1000, slow=1e-12)
        inside = np.clip(near, batch.low + 1e-9, batch.high - 1e-9)
        aim = minimum_by_scipy(batch, inside, at)
        assert again.cost[0] <= aim * (1.0 + 1e-4) + 1e-9
        checked += 1
    assert checked == 4


def test_poor_designs_end_early_and_change_no_good_one(monkeypatch: pytest.MonkeyPatch) -> None:
    batch = Batch(model(TASKS["slider-crank, from start"]))
    x, t = sample(batch, 30, seed=5)
    steps: list[int] = []
    advance = levenberg_marquardt._advance

    def counted(*given: Any) -> None:
        steps[-1] += len(given[1].index)
        advance(*given)

    monkeypatch.setattr(levenberg_marquardt, "_advance", counted)
    ends = []
    for good in (None, 3):
        steps.append(0)
        ends.append(minimise(batch, x, t, 150, slow=1e-9, good=good))
    assert steps[1] < 0.9 * steps[0]
    best = np.argsort(ends[0].cost)[:3]
    np.testing.assert_allclose(ends[1].x[best], ends[0].x[best], rtol=1e-12)
    late = ends[1].cost > ends[0].cost
    assert np.all(ends[1].cost[late] > levenberg_marquardt.POOR * ends[0].cost[best[-1]])


@pytest.mark.parametrize("name", [*DESCENDED, "span", "six-bar, free", "slider-crank, free"])
def test_descent_keeps_to_bounds_and_never_rises(name: str) -> None:
    batch = Batch(model(TASKS[name]))
    fit = SimilarityFit(batch)
    x, t = sample(batch, 60, seed=7)
    angles = batch.crank_angles(x, t)
    h, _ = batch.violations(x, angles)
    before = cost_of(batch, x, t) + np.sum(h**2, axis=1)
    least = before
    ways: list[tuple[int, SimilarityFit | None]] = [(1, None), (10, None), (30, None)]
    for steps, using in ways + [(10, fit)] * fit.applies:
        ends = minimise(batch, x, t, steps, using.fit if using else None, using.linear if using else None)
        assert np.all(ends.x >= batch.low - 1e-12)
        assert np.all(ends.x <= batch.high + 1e-12)
        assert np.all(ends.cost <= before * (1.0 + 1e-12))
        angles = batch.crank_angles(ends.x, ends.t)
        h, _ = batch.violations(ends.x, angles)
        np.testing.assert_allclose(ends.missed, np.sum(h**2, axis=1), rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(ends.cost, cost_of(batch, ends.x, ends.t) + ends.missed, rtol=1e-9, atol=1e-15)
        if using is None:
            assert np.all(ends.cost <= least * (1.0 + 1e-12))  # more steps are never worse
            least = ends.cost


def test_a_start_that_does_not_assemble_is_returned() -> None:
    batch = Batch(model(TASKS["left, free"]))
    x, t = sample(batch, 3)
    x[1, [batch.names.index(name) for name in LENGTHS]] = [0.1, 0.2, 0.3, 9.0]
    kept = x.copy()
    ends = minimise(batch, x, t, 20)
    assert np.isinf(ends.cost[1])
    np.testing.assert_array_equal(ends.x[1], kept[1])
    assert np.all(np.isfinite(ends.cost[[0, 2]]))
    alone = minimise(batch, kept[[0, 2]], t[[0, 2]], 20)
    np.testing.assert_allclose(alone.cost, ends.cost[[0, 2]], rtol=1e-6)


def test_a_bound_holds_the_optimum() -> None:
    """A coupler that may not be as long as it should ends on its bound."""
    rng = np.random.default_rng(1)
    design = oracle.random_crank_rocker(rng)
    phi = np.arange(12) * TURN / 12
    spots = oracle.planted_path(design, phi)
    wide = {name: free(0.5 * design[name], 2.0 * design[name], design[name]) for name in LENGTHS}
    wide["coupler"] = free(0.5 * design["coupler"], 0.97 * design["coupler"], 0.9 * design["coupler"])
    section = four_bar_section("left" if design["mode"] > 0 else "right", **wide)
    batch = Batch(model(document(section, spots, crank=phi)))
    truth = {**design, "A.x": design["x"], "A.y": design["y"], "P.along": design["along"], "P.across": design["across"]}
    x = np.array([[truth[name] * (1.0 if name == "direction" else 1e-3) for name in batch.names]])
    x = np.clip((x - batch.origin) / batch.scale, batch.low, batch.high)
    ends = minimise(batch, x, np.zeros((1, 12)), 500, slow=1e-12)
    i = batch.names.index("coupler")
    assert ends.x[0, i] == pytest.approx(batch.high[i], rel=1e-9)
    assert 0.0 < ends.cost[0] <= cost_of(batch, x, np.zeros((1, 12)))[0]


# --- starts and rounds -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("crank", "inversion"), [("full rotation", Inversion.CRANK_ROCKER), ("double-crank", Inversion.DOUBLE_CRANK)]
)
def test_proportions_are_all_of_their_kind(crank: str, inversion: Inversion) -> None:
    batch = Batch(model(document(four_bar_section(), limits={"crank": crank})))
    lengths = batch_search.random_proportions(batch, 2000, np.random.default_rng(0))
    assert lengths.shape == (2000, 4)
    assert np.all(lengths > 0.0)
    assert np.all(lengths[:, 3] == 1.0)
    assert {grashof(*row).inversion for row in lengths.tolist()} == {inversion}


def test_proportions_leave_no_crank_rocker_out() -> None:
    """Around every random crank-rocker of the oracle there are some, though they are three numbers."""
    batch = Batch(model(document(four_bar_section())))
    logs = np.log(batch_search.random_proportions(batch, 60_000, np.random.default_rng(1))[:, :3])
    rng = np.random.default_rng(2)
    for _ in range(60):
        design = oracle.random_crank_rocker(rng)
        aim = np.log([design[name] / design["frame"] for name in LENGTHS[:3]])
        assert np.min(np.max(np.abs(logs - aim), axis=1)) < 0.35


@pytest.mark.parametrize("rotation", ["either", "clockwise", "counter-clockwise"])
@pytest.mark.parametrize("closed", [False, True])
def test_random_timing_is_in_order(rotation: str, closed: bool) -> None:
    batch = Batch(model(document(four_bar_section(), closed=closed, rotation=rotation)))
    t = batch_search.random_crank_angles(batch, 500, np.random.default_rng(0))
    steps = np.diff(t, axis=1)
    way = np.sign(steps[:, :1])
    assert np.all(steps * way >= STEP)
    assert np.all(np.abs(t[:, -1] - t[:, 0]) < TURN)
    assert set(way.ravel().tolist()) == {"either": {-1.0, 1.0}, "clockwise": {-1.0}, "counter-clockwise": {1.0}}[rotation]


@pytest.mark.parametrize("rotation", ["clockwise", "counter-clockwise"])
def test_candidates_keep_order_and_rotation(rotation: str) -> None:
    files = optlink.read(document(four_bar_section("either"), closed=True, rotation=rotation)).variants()
    searcher = Searcher([file.model for file in files], 0)
    searcher.advance()
    result = searcher.advance()
    assert result.starts == 180
    assert result.candidates
    costs = [candidate.cost for candidate in result.candidates]
    assert costs == sorted(costs)
    for candidate in result.candidates:
        assert candidate.direction == (1 if rotation == "counter-clockwise" else -1)
        steps = np.diff(candidate.t) * candidate.direction
        assert np.all(steps >= STEP)
        assert np.sum(steps) <= TURN + 1e-9
        batch = searcher.batches[candidate.variant]
        again = cost_of(batch, candidate.x[None], candidate.t[None])[0]
        h, _ = batch.violations(candidate.x[None], candidate.t[None])
        assert again + np.sum(h**2) == pytest.approx(candidate.cost, rel=1e-9, abs=1e-20)


@pytest.mark.slow
def test_the_same_seed_finds_the_same() -> None:
    def once(seed: int) -> list[float]:
        problem = model(document(four_bar_section("left"), crank=ANGLES5, timing="from start"))
        return [c.cost for c in Searcher([problem], seed).advance().candidates]

    assert once(3)
    assert once(3) == once(3)
    assert once(3) != once(4)


# --- the programme that polishes ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("measure", ["sum of squares", "rms", "max"])
@pytest.mark.parametrize(
    "name", ["right, free, weights", "timed from start", "motion, free", "slider-crank, free", "six-bar, motion"]
)
def test_programme_and_validator_measure_the_same(name: str, measure: str) -> None:
    raw = TASKS[name]
    problem = model({**raw, "requirement": {**raw["requirement"], "measure": measure}})  # type: ignore[dict-item]
    batch = Batch(problem)
    nlp = build(problem)
    x, t = sample(batch, 6, seed=8)
    for k in range(len(x)):
        values = {key: float(v[k, 0]) for key, v in batch.values(x).items()}
        angles = batch.crank_angles(x, t)[k]
        measured = deviations(problem, values, angles)
        z = np.concatenate([x[k], t[k]]) if batch.free_timing else x[k]
        if len(nlp.variables) > len(z):
            z = np.append(z, 0.0)
        solution_x = nlp.lifted(z)
        scale = {"sum of squares": problem.size**2}.get(measure, problem.size)
        share = nlp.values(solution_x, nlp.p)[0] * nlp.p[0]
        if measure == "rms":
            assert math.sqrt(share) * scale == pytest.approx(measured.objective, rel=1e-8)
        else:
            assert share * scale == pytest.approx(measured.objective, rel=1e-8)
        square = np.sum(batch.residuals(x, batch.crank_angles(x, t))[0][k] ** 2) * problem.size**2
        if measure == "sum of squares":
            assert square == pytest.approx(measured.objective, rel=1e-9)


def test_the_programme_includes_order_and_full_revolutions() -> None:
    for direction in (1, -1):
        nlp = build(model(TASKS["left, free"]), direction)
        labels = [row.label for row in nlp.rows]
        assert sum(label.startswith("order of points") for label in labels) == len(SPOTS) - 1
        x = nlp.x_start.copy()
        count = len(x) - len(SPOTS)
        x[count:] = direction * TURN / 5 * np.arange(5)
        g = nlp.values(x, nlp.p)[1]
        order = np.array([label.startswith("order of points") for label in labels])
        np.testing.assert_allclose(g[order], TURN / 5, rtol=1e-12)
        x[count:] *= -1.0
        assert np.all(nlp.values(x, nlp.p)[1][order] < 0.0)


# --- rounds and assembly modes in one batch ----------------------------------------------------------------------------------


def test_designs_of_several_assembly_modes_in_one_batch_are_those_of_each_alone() -> None:
    limits = {"swing_angle": ["20 deg", "120 deg"], "transmission_angle": ["30 deg", "150 deg"]}
    files = optlink.read(document(four_bar_section("either"), limits=limits)).variants()
    problems = [file.model for file in files]
    both = Batch(problems[0], problems[1:])
    x, t = sample(both, 40, seed=2)
    variant = np.arange(len(x)) % 2
    whole = (*both.residuals(x, t, variant), *both.violations(x, t, variant), *SimilarityFit(both).fit(x, t, variant))
    for k, problem in enumerate(problems):
        one, own = Batch(problem), variant == k
        alone = (*one.residuals(x[own], t[own]), *one.violations(x[own], t[own]), *SimilarityFit(one).fit(x[own], t[own]))
        for together, each in zip(whole, alone, strict=True):
            assert np.allclose(together[own], each, rtol=1e-9, atol=1e-12)


def test_a_round_does_not_depend_on_the_rounds_computed_with_it() -> None:
    files = optlink.read(document(four_bar_section("either"), closed=True)).variants()
    one, ahead = (Searcher([file.model for file in files], 0) for _ in range(2))
    for k in range(2):
        result, other = one.advance(), ahead.advance(2)
        assert (result.starts, result.rounds) == (other.starts, other.rounds) == ((60, 180)[k], k + 1)
        assert [c.cost for c in result.candidates] == pytest.approx([c.cost for c in other.candidates], rel=1e-9)
        assert [c.cost for c in result.repaired] == pytest.approx([c.cost for c in other.repaired], rel=1e-9)


def test_designs_do_not_stop_on_the_way_along_a_valley():
    """As links grow the curve of an arc hardly changes: without second-order corrections many designs are on the way there."""
    searcher = Searcher([file.model for file in optlink.load("path-arc5").variants()], 0)
    ends = minimise(searcher.batches[0], *searcher._sample(0, 30, 0), 100, slow=1e-9)
    costs = np.sort(ends.cost[np.isfinite(ends.cost)])
    assert len(costs) == 30
    assert 1 + np.count_nonzero(np.diff(costs) > 1e-6 * costs[1:]) == 3  # different ends


class Valley:
    """The curved valley of Rosenbrock as a batch of one point: residuals 10 (y - x^2) and 1 - x, zero at (1, 1)."""

    free_timing, low = False, np.array([-2.0, -2.0])

    def __init__(self, most: float) -> None:
        self.high = np.array([most, 2.0])

    def crank_angles(self, x, t, variant=0):
        return t

    def residual_values(self, x, t, variant=0):
        return np.stack([10.0 * (x[:, 1] - x[:, 0] ** 2), 1.0 - x[:, 0]], axis=-1)[:, None]

    def residuals(self, x, t, variant=0):
        by_x = np.zeros((len(x), 1, 2, 2))
        by_x[:, 0, 0, 0], by_x[:, 0, 0, 1], by_x[:, 0, 1, 0] = -20.0 * x[:, 0], 10.0, -1.0
        return self.residual_values(x, t), by_x, np.zeros((len(x), 1, 2))

    def violations(self, x, t, variant=0):
        return np.zeros((len(x), 0)), np.zeros((len(x), 0, 2))


def test_a_bound_in_the_way_is_followed():
    """The step ends at the bound and the other variable takes its best value there, instead of its place beyond the bound."""
    ends = minimise(Valley(0.5), np.array([[-1.5, -1.0], [-1.2, 1.0], [0.3, 0.0]]), np.zeros((3, 1)), 30)
    np.testing.assert_allclose(ends.x, [[0.5, 0.25]] * 3, atol=1e-6)
    np.testing.assert_allclose(ends.cost, 0.25, rtol=1e-9)


def test_a_search_with_exact_designs_takes_few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """The variable projection went on for 200 steps although full steps converge at once from the designs of the descent."""
    advance, steps = levenberg_marquardt._advance, []
    monkeypatch.setattr(levenberg_marquardt, "_advance", lambda *given: (steps.append(1), advance(*given))[1])
    result = Searcher([file.model for file in optlink.load("path-vline6").variants()], 0).advance()
    assert sum(candidate.cost <= PERFECT for candidate in result.candidates) >= 3
    assert len(steps) < 150


@pytest.mark.parametrize("start", ["outer dead centre", {"bounds": ["0 deg", "360 deg"]}, "70 deg"])
def test_a_batch_differentiates_starts_and_outputs_that_follow_from_the_lengths(start: object) -> None:
    """Each assembly mode has its own dead centre and output there: central differences of the residuals, which are the errors."""
    file = optlink.load("crank-rocker", {"mechanism.assembly": "either", "requirement.from": start})
    problems = [variant.spec for variant in file.variants()]
    batch = Batch(problems[0], problems[1:])
    x = np.array([[0.85, 0.45], [0.85, 0.45], [0.95, 0.52], [0.9, 0.5]])
    x = np.column_stack([x, np.full((4, len(batch.names) - 2), 0.4)])
    variant, t = np.array([0, 1, 1, 0]), np.zeros((4, len(batch.data.columns)))

    def errors(at: np.ndarray) -> np.ndarray:
        return batch.residuals(at, batch.crank_angles(at, t, variant), variant)[0]

    slopes = batch.residuals(x, batch.crank_angles(x, t, variant), variant)[1]
    for k in range(x.shape[1]):
        step = 1e-6 * np.eye(x.shape[1])[k]
        np.testing.assert_allclose(slopes[..., k], (errors(x + step) - errors(x - step)) / 2e-6, atol=1e-8)
    for row, side, one in zip(x, variant, errors(x), strict=True):
        values = {v.name: float(v.value(value)) for v, value in zip(batch.variables, row, strict=True)}
        result = optlink.validate(file.variants()[side], values)
        np.testing.assert_allclose(one[:, 0], result.error(), atol=1e-12)
