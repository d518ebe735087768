"""Linkages with deviations that were drawn, each assembled and moved exactly: scatter, extremes and yield."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from optlink.problem.tolerances import Deviation
from optlink.studies.nominal import Nominal
from optlink.studies.sampling import drawn, wilson

if TYPE_CHECKING:
    from optlink.studies.tolerance import Tolerance

Array = NDArray[np.float64]
PORTION = 12_000  # positions that are worked on at a time: their intermediate arrays stay in the processor's cache
BINS, ROOM = 400, 1.25  # of the histogram, which reaches that many worst cases to both sides of the drawing
Progress = Callable[[float], None]


@dataclass(frozen=True)
class Carlo:
    """What samples of the parts gave.

    `mean`, `sigma` and the latter's standard error (angles,) [SI] of the change of the output; `least`, `most` of it; `counts` of
    samples by the largest size that what is judged has at any crank angle, between `edges` [SI]; `stuck`: samples that cannot be
    assembled at some angle; `good`: those within the limit everywhere, by the linear model `linear`; -1 where no limit is given.
    """

    samples: int
    seed: int
    stuck: int
    mean: Array
    sigma: Array
    sigma_error: Array
    least: Array
    most: Array
    counts: NDArray[np.int64]
    edges: Array
    good: int
    linear: int
    seconds: float

    @property
    def share(self) -> float:
        """The yield."""
        return self.good / self.samples if self.good >= 0 else math.nan

    @property
    def linear_share(self) -> float:
        """The yield by the linear model, of the same samples."""
        return self.linear / self.samples if self.linear >= 0 else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """The ends of its interval of 95 % confidence, as of independent samples: quasi-random ones lie closer."""
        return wilson(self.good, self.samples) if self.good >= 0 else (math.nan, math.nan)

    def below(self, share: float) -> float:
        """The size [SI] that a share of the samples stays below: to a bin of the histogram; infinite beyond its end."""
        reached = np.cumsum(self.counts) >= share * self.samples
        place = int(np.argmax(reached))
        return float(self.edges[place + 1]) if reached[-1] and place < len(self.counts) - 1 else math.inf


def sampled_document(carlo: Carlo) -> dict[str, Any]:
    """Samples as part of a JSON document."""
    asked = carlo.good >= 0
    return {
        "samples": carlo.samples,
        "seed": carlo.seed,
        "cannot_be_assembled": carlo.stuck,
        "mean": carlo.mean,
        "sigma": carlo.sigma,
        "sigma_standard_error": carlo.sigma_error,
        "least": carlo.least,
        "most": carlo.most,
        "stays_below": {f"{100.0 * share:g}_percent": carlo.below(share) for share in (0.5, 0.95, 0.99, 0.999)},
        "histogram": _histogram(carlo),
        "yield": carlo.share if asked else None,
        "yield_interval_95_percent": list(carlo.interval) if asked else None,
        "yield_by_the_linear_model": carlo.linear_share if asked else None,
        "seconds": carlo.seconds,
    }


def _histogram(carlo: Carlo) -> dict[str, Any]:
    """The bins that hold samples: their edges [SI], one more than bins, and how many samples each holds."""
    held = np.flatnonzero(carlo.counts)
    first, last = (int(held[0]), int(held[-1]) + 1) if len(held) else (0, 0)
    return {"edges": carlo.edges[first : last + 1], "counts": carlo.counts[first:last]}


def monte_carlo(study: Tolerance, samples: int, seed: int, progress: Progress | None = None) -> Carlo:
    """Linkages with deviations that were drawn, each assembled and moved exactly; memory does not grow with their number."""
    begin = time.perf_counter()
    nominal, shift, angles = study.nominal, study.shift, len(study.nominal.crank_angles)
    limit, middle = study.limit, float(np.max(np.abs(nominal.base)))
    reach = ROOM * max(float(np.max(np.maximum(-study.worst[0], study.worst[1]))), 1e-15)
    bottom, bins = max(0.0, middle - reach), BINS / (middle + reach - max(0.0, middle - reach))
    counts = np.zeros(BINS, dtype=np.int64)
    sums = np.zeros((4, angles))
    least, most = np.full(angles, math.inf), np.full(angles, -math.inf)
    stuck = good = linear = done = 0
    for batch in drawn(study.deviations, samples, seed):
        for part, change in _moved(nominal, study.deviations, batch):
            whole = np.isfinite(change).all(axis=1)
            if not whole.all():
                stuck += int(np.sum(~whole))
                change = change[whole]
            largest = np.max(np.abs(nominal.base + change), axis=1)
            counts += np.bincount(np.clip((largest - bottom) * bins, 0, BINS - 1).astype(int), minlength=BINS)
            if len(change):
                np.minimum(least, np.min(change, axis=0), out=least)
                np.maximum(most, np.max(change, axis=0), out=most)
            if limit is not None:
                good += int(np.sum(largest <= limit))
                linear += int(np.sum(np.max(np.abs(nominal.base + part @ study.by), axis=1) <= limit))
            change -= shift  # so that the sums of powers lose no digits
            power = change
            for i in range(4):
                sums[i] += np.sum(power, axis=0)
                power = power * change
        done += len(batch)
        if progress is not None:
            progress(done / samples)
    mean, sigma, error = _moments(sums, samples - stuck)
    return Carlo(
        samples=samples,
        seed=seed,
        stuck=stuck,
        mean=mean + shift,
        sigma=sigma,
        sigma_error=error,
        least=least,
        most=most,
        counts=counts,
        edges=np.linspace(bottom, middle + reach, BINS + 1),
        good=-1 if limit is None else good,
        linear=-1 if limit is None else linear,
        seconds=time.perf_counter() - begin,
    )


def largest_errors(nominal: Nominal, deviations: Sequence[Deviation], batch: Array) -> Array:
    """Largest size of what is judged, of linkages with deviations (samples, deviations) [SI]; nan where one sticks."""
    return np.concatenate([np.max(np.abs(nominal.base + change), axis=1) for _, change in _moved(nominal, deviations, batch)])


def _moved(nominal: Nominal, deviations: Sequence[Deviation], batch: Array) -> Iterator[tuple[Array, Array]]:
    """Deviations in portions, and the change of what is judged that each makes."""
    rows = max(1, PORTION // len(nominal.crank_angles))
    for first in range(0, len(batch), rows):
        part = batch[first : first + rows]
        yield part, nominal.change(_by_size(deviations, part))


def _by_size(deviations: Sequence[Deviation], batch: Array) -> dict[str, Array]:
    """Deviations (samples, 1) of each size; several may add to one."""
    found: dict[str, Array] = {}
    for i, deviation in enumerate(deviations):
        own = batch[:, i : i + 1]
        found[deviation.size] = found[deviation.size] + own if deviation.size in found else own
    return found


def _moments(sums: Array, count: int) -> tuple[Array, Array, Array]:
    """Mean, standard deviation and the latter's standard error, from sums of the first four powers."""
    if count < 2:
        nothing = np.full(sums.shape[1], math.nan)
        return nothing, nothing, nothing
    first, second, third, fourth = sums / count
    variance = np.maximum(second - first * first, 0.0)
    central = np.maximum(fourth - 4.0 * first * third + 6.0 * first**2 * second - 3.0 * first**4, 0.0)
    sigma = np.sqrt(variance * count / (count - 1))
    spread = np.sqrt(np.maximum(central - variance * variance, 0.0) / count)  # of the variance
    return first, sigma, spread / np.where(sigma > 0.0, 2.0 * sigma, 1.0)
