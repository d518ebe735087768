"""Lower bounds of timed paths: never above the best fit of any four-bar, for random boxes; the search closes on a subset."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import optlink
from optlink.linkage.vector2d import unit
from optlink.solvers.global_search.branch_and_bound import BranchAndBound
from optlink.solvers.global_search.lagrangian import OPEN, TESTS
from optlink.solvers.global_search.timed_path import ColumnFit, TimedPathBounds, unsuitable
from tests.tiers import mostly_slow

Array = NDArray[np.float64]

BEST = 9.02888464e-9  # m^2, closed path of 18 points
OPTIMUM = [1.18841202, -0.52414634, 0.21657324, 0.89155585]
PROBLEMS = {
    "free frame": ("path-closed18", {}),
    "fixed frame": ("path-arc5", {}),
    "fixed pivot": ("path-closed18", {"mechanism.pivot": ["0 mm", "0 mm"]}),
}


def bounds_of(case: str, assembly: str = "either") -> TimedPathBounds:
    name, changes = PROBLEMS[case]
    return TimedPathBounds(optlink.load(name, {**changes, "mechanism.assembly": assembly}).model)  # type: ignore[arg-type]


def least_squares(bounds: TimedPathBounds, points: Array) -> Array:
    """Best fits of four-bars, the joint C from the intersection of two circles: independent of the formulas of the bounds."""
    problem = bounds.problem
    eta, omega, chi, start = np.column_stack([points, np.full(len(points), bounds.start)]).T[:4, :, None]
    a, d = np.cos(eta), np.sin(eta)
    total, nu = (a + d) / np.cos(chi), (a - d) * np.sin(omega)
    b, c = (total - nu) / 2, (total + nu) / 2
    theta = start + problem.data.offsets
    pin = a * np.exp(1j * theta)
    line = d - pin
    length = np.abs(line)
    along = (b * b - c * c + length**2) / (2 * length)
    side = -np.sign(np.cos(omega))
    u = (line / length * (along + 1j * side * np.sqrt(np.maximum(b * b - along * along, 0)))) / b
    crank = np.exp(1j * theta)
    one = np.ones_like(crank)
    free = [name for name in ("A.x", "A.y", "direction") if name in problem.free]
    columns = {"A.x": [one], "A.y": [1j * one], "direction": [1j * crank]}
    chosen = [crank, u, 1j * u, *(part for name in free for part in columns[name])]
    matrix = np.stack([np.concatenate([z.real, z.imag], axis=1) for z in chosen], axis=2)
    targets = problem.data.columns.T.reshape(-1)
    q = np.linalg.qr(matrix)[0]
    rest = targets - np.einsum("bij,bj->bi", q, np.einsum("bij,i->bj", q, targets))
    return np.asarray(np.sum(rest * rest, axis=1))


def random_boxes(bounds: TimedPathBounds, count: int, seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    width = (
        (bounds.high - bounds.low) * 10.0 ** rng.uniform(-3.0, -0.9, (count, 1)) * rng.uniform(0.3, 1.0, (count, len(bounds.low)))
    )
    low = bounds.low + rng.random((count, len(bounds.low))) * (bounds.high - bounds.low - width)
    crossing = (low[:, 1] < np.pi / 2) & (low[:, 1] + width[:, 1] > np.pi / 2)  # no box contains both assembly modes
    return low[~crossing], (low + width)[~crossing]


def falsified(bounds: TimedPathBounds) -> tuple[int, int]:
    """Number of times that boxes are discarded although a design in them is better than the threshold, and rightly."""
    rng = np.random.default_rng(1)
    low, high = random_boxes(bounds, 100, 0)
    share = rng.random((len(low), 40, low.shape[1]))
    share[:, :20] = np.round(share[:, :20])  # corners
    points = low[:, None] + share * (high - low)[:, None]
    least = least_squares(bounds, points.reshape(-1, low.shape[1])).reshape(len(low), -1).min(axis=1)
    wrong = right = 0
    for threshold in np.quantile(least, np.linspace(0.02, 0.98, 15)):
        gone = bounds.bounded(low, high, threshold).test == TESTS.index("objective")
        wrong += int(np.sum(gone & (least * (1.0 + 1e-9) < threshold)))
        right += int(np.sum(gone & (least >= threshold)))
    return wrong, right


@pytest.mark.parametrize("case", mostly_slow(PROBLEMS, "fixed pivot"))
def test_no_design_in_a_box_is_better_than_its_bound(case: str) -> None:
    wrong, right = falsified(bounds_of(case))
    assert wrong == 0
    assert right > 80


def no_remainder(monkeypatch: pytest.MonkeyPatch) -> None:
    original = TimedPathBounds.columns_over
    monkeypatch.setattr(TimedPathBounds, "columns_over", lambda *x: (lambda f: (f[0], 0.0 * f[1], *f[2:]))(original(*x)))


def no_tangent(monkeypatch: pytest.MonkeyPatch) -> None:
    original = TimedPathBounds.columns_over

    def without(self: TimedPathBounds, low: Array, high: Array) -> tuple[Array, ...]:
        computed = original(self, low, high)
        computed[0][:, len(self.low)] = 0.0  # of the last unknown
        return computed

    monkeypatch.setattr(TimedPathBounds, "columns_over", without)


def other_sign(monkeypatch: pytest.MonkeyPatch) -> None:
    original = TimedPathBounds.columns_over

    def turned(self: TimedPathBounds, low: Array, high: Array) -> tuple[Array, ...]:
        computed = original(self, low, high)
        computed[0][..., computed[0].shape[-1] // 2 :] *= -1.0
        return computed

    monkeypatch.setattr(TimedPathBounds, "columns_over", turned)


@pytest.mark.parametrize("defect", mostly_slow([no_remainder, no_tangent, other_sign], no_tangent))
def test_defects_are_detected(defect: object, monkeypatch: pytest.MonkeyPatch) -> None:
    defect(monkeypatch)  # type: ignore[operator]
    wrong, _ = falsified(bounds_of("free frame"))
    assert wrong > 0


@pytest.mark.parametrize("assembly", ["left", "right"])
@pytest.mark.parametrize("case", PROBLEMS)
def test_designs_have_the_value_at_the_centre_of_their_box(case: str, assembly: str) -> None:
    bounds = bounds_of(case, assembly)
    problem = bounds.problem
    points = bounds.low + np.random.default_rng(3).random((5, len(bounds.low))) * (bounds.high - bounds.low)
    seen = 0
    for point in points:
        design = bounds.design(point)
        if design["crank"] < 0.0:  # the best real factor of a crank with a fixed direction
            continue
        pose = problem.linkage.pose(design, unit(np.asarray(problem.crank_angles(design, None))))
        x, y = pose.point("P")
        expected = problem.data.columns
        objective = float(np.sum((x - expected[:, 0]) ** 2 + (y - expected[:, 1]) ** 2))
        record = bounds.bounded(point[None] - 1e-9, point[None] + 1e-9, objective)
        if record.test[0] != TESTS.index("limits"):
            seen += 1
            assert record.centre[0] == pytest.approx(objective, rel=1e-6)
    assert seen


def test_the_bound_of_all_positions_is_not_below_that_of_fewer() -> None:
    rng = np.random.default_rng(2)
    points, known = np.array([1.0, 1j]) @ rng.normal(size=(2, 10)), np.array([np.ones(10), 1j * np.ones(10)])
    fit = ColumnFit(points, known, whole=True, size=1.0, rounding=0.0)
    column = rng.normal(size=(1, 1, 20)) * np.array([1.0, 0.0, 0.0])[None, :, None]
    computed = [fit.bounds(column, np.zeros((1, 20)), np.array([k]), 0.0)[2][0] for k in range(len(fit.square))]
    assert len(computed) == 1 + 10 + 45
    assert all(value < computed[0] for value in computed[1:])


def test_search_closes_about_the_optimum() -> None:
    bounds = bounds_of("free frame")
    width = 0.01 * (bounds.high - bounds.low)
    bounds.low, bounds.high = OPTIMUM - width, OPTIMUM + 0.7 * width
    search = BranchAndBound(bounds, BEST, 1e-4)
    search.run(boxes=20_000)
    assert search.closed
    assert search.lower * (1.0 + 1e-12) >= BEST * (1.0 - 1e-4)
    better = BranchAndBound(bounds, 1.001 * BEST, 1e-4)  # a better design than the threshold exists: it must not close
    better.run(boxes=search.boxes)
    assert not better.closed
    assert better.lower <= BEST


def test_transmission_limits_discard_boxes() -> None:
    plain = bounds_of("free frame")
    limited = TimedPathBounds(optlink.load("path-closed18", {"limits.transmission_angle": ["60 deg", "120 deg"]}).model)  # type: ignore[arg-type]
    low, high = random_boxes(plain, 300, 5)
    gone = limited.bounded(low, high, np.inf).test == TESTS.index("limits")
    assert np.sum(gone) > np.sum(plain.bounded(low, high, np.inf).test != OPEN)
    for k in np.flatnonzero(gone)[:40]:
        for point in (low[k], high[k], 0.5 * (low[k] + high[k])):
            size = limited.design(np.clip(point, limited.low, [*limited.high[:2], 1.57, limited.high[3]]))
            b, c = size["coupler"], size["rocker"]
            extremes = [(b * b + c * c - (size["frame"] + s * size["crank"]) ** 2) / (2.0 * b * c) for s in (-1.0, 1.0)]
            assert max(np.abs(extremes)) > 0.5 - 1e-9


def test_unsuitable_problems_are_refused_with_a_reason() -> None:
    assert unsuitable(optlink.load("path-bean").model) == "the crank angles of the points are not prescribed"  # type: ignore[arg-type]
    span = optlink.load("path-arc5", {"limits.crank": "span"}).model
    assert unsuitable(span) == "the crank need not turn fully"  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="not turn fully"):
        TimedPathBounds(span)  # type: ignore[arg-type]
