"""What a multistart search missed, against sums over the published distribution and against random landscapes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from optlink.tasks.results.common import evidence


def posterior(n: int, w: int, most: int) -> np.ndarray:
    """Boender and Rinnooy Kan (1987): probability that there are k = w ... most optima, where n starts found w of them."""
    g = math.lgamma
    known = g(n) + g(n - 1) - g(w + 1) - g(w) - g(n - w - 1)
    return np.array([math.exp(known + g(k) + g(k + 1) - g(n + k) - g(k - w + 1)) for k in range(w, most)])


@pytest.mark.parametrize(("n", "w"), [(20, 1), (40, 7), (60, 20)])
def test_the_chance_of_a_missed_better_optimum_is_the_mean_over_the_published_distribution(n: int, w: int) -> None:
    counts = [n // w] * w
    counts[0] += n - sum(counts)
    k = np.arange(w, 20000)
    weight = posterior(n, w, 20000)
    assert weight.sum() == pytest.approx(1.0, abs=1e-4)
    assert evidence(counts).missed == pytest.approx(float(weight @ (1.0 - w / k)), rel=1e-3)


def test_good_estimate_of_the_unseen_share_is_unbiased_and_never_undercut() -> None:
    rng = np.random.default_rng(3)
    shares = rng.dirichlet(np.full(40, 0.3))
    estimates, truths = [], []
    for _ in range(400):
        counts = rng.multinomial(120, shares)
        estimates.append(evidence(sorted(counts[counts > 0].tolist(), reverse=True)).unseen)
        truths.append(shares[counts == 0].sum())
    assert np.mean(estimates) >= np.mean(truths)
    assert np.mean(estimates) <= 3.0 * np.mean(truths)


def test_a_better_optimum_is_missed_no_more_often_than_estimated() -> None:
    """Random landscapes with regions of all sizes, objectives independent of them."""
    rng = np.random.default_rng(5)
    missed, estimated = [], []
    for _ in range(600):
        shares = rng.dirichlet(np.full(rng.integers(1, 30), 1.0))
        ranks = rng.permutation(len(shares))  # 0 is the best optimum
        counts = rng.multinomial(50, shares)
        computed = sorted((ranks[i], counts[i]) for i in np.flatnonzero(counts))
        missed.append(computed[0][0] > 0)
        estimated.append(evidence([int(count) for _, count in computed]).missed)
    assert np.mean(missed) <= np.mean(estimated) <= 3.0 * np.mean(missed)


def test_nothing_found_or_nothing_found_twice_is_no_evidence() -> None:
    assert evidence([]).missed == evidence([1]).missed == evidence([1, 1, 1, 1]).missed == 1.0
    assert evidence([10]).missed == pytest.approx(1.0 / 9.0)
    assert evidence([200, 3, 3]).hits == 200
