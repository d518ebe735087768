"""Monte Carlo analysis of tolerances with exact kinematics: scatter, extremes and yield."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainValidator, WithJsonSchema

from optlink.execution.runner import ordered
from optlink.execution.worker import Runs
from optlink.linkage.vector2d import Array
from optlink.optimization.output_derivatives import ErrorDerivatives
from optlink.problem.document import Column, Rows, Source
from optlink.problem.file import ProblemFile
from optlink.problem.tolerances import Deviation
from optlink.studies.motion_sensitivity import output_sensitivity
from optlink.studies.tolerances.nominal import Nominal, error_names
from optlink.studies.tolerances.sampling import sample_deviations, wilson

# Effect of the deviations of a nominal linkage on an output, to first order.


@dataclass(frozen=True, repr=False)
class LinearAnalysis:
    """Tolerances of a design and their effect.

    `by` (deviations, components * angles): change of the components of the judged value per deviation [SI], those of the first
    component first.
    """

    problem: ProblemFile
    nominal: Nominal
    deviations: tuple[Deviation, ...]
    by: Rows
    limit: float | None

    @cached_property
    def effects(self) -> Array:
        """Change (deviations, angles) of the judged value per deviation [SI]; of a vector the length of its change."""
        if self.nominal.components == 1:
            return np.asarray(self.by)
        return np.asarray(np.linalg.norm(self.by.reshape(len(self.by), self.nominal.components, -1), axis=1))

    def changes(self, deviations: Array) -> Array:
        """Return the changes (..., components, angles) of the judged value to first order for deviations (..., deviations)."""
        return np.asarray((deviations @ self.by).reshape(*deviations.shape[:-1], self.nominal.components, -1))

    @cached_property
    def shift(self) -> Array:
        """Change (angles,) to first order by the mean deviations."""
        nominal = self.nominal
        change = self.changes(np.array([d.mean for d in self.deviations]))
        return change[0] if nominal.components == 1 else nominal.after(change) - nominal.base

    @cached_property
    def worst(self) -> tuple[Array, Array]:
        """Least and largest change (angles,) to first order with all deviations at their worst ends; bounds of a length."""
        ends = np.array([d.ends for d in self.deviations])
        changes = ends[:, :, None] * self.effects[:, None, :]
        low, high = np.sum(np.min(changes, axis=1), axis=0), np.sum(np.max(changes, axis=1), axis=0)
        if self.nominal.components == 1:
            return low, high
        reach = np.sum(np.max(np.abs(changes), axis=1), axis=0)
        return np.maximum(-reach, -self.nominal.base), reach

    @cached_property
    def rss(self) -> Array:
        """Root sum square (angles,) of each tolerance times its derivative; for measured deviations three sigma."""
        sizes = np.array([3.0 * d.sigma if d.values else d.tolerance for d in self.deviations])
        return np.asarray(np.sqrt(np.sum(np.square(sizes[:, None] * self.effects), axis=0)), dtype=float)

    @cached_property
    def sigma(self) -> Array:
        """Standard deviation (angles,) to first order; of a vector the root of the sum of the variances of its components."""
        return np.asarray(np.sqrt(np.sum(self._variances, axis=0)), dtype=float)

    @cached_property
    def _variances(self) -> Array:
        return np.square(np.array([d.sigma for d in self.deviations])[:, None] * self.effects)

    @property
    def where(self) -> int:
        """Index of the crank angle of largest scatter."""
        return int(np.argmax(self.sigma))

    @cached_property
    def contributions(self) -> Array:
        """Share of each deviation in the variance (deviations, angles); zeros without scatter."""
        total = np.sum(self._variances, axis=0)
        return self._variances / np.where(total > 0.0, total, 1.0)


def linear_analysis(
    problem: ProblemFile, nominal: Nominal, deviations: Sequence[Deviation], limit: float | None
) -> LinearAnalysis:
    """Return the linear analysis with exact derivatives at the nominal design."""
    sizes = [d.size for d in deviations]
    if nominal.part is None:
        slopes = output_sensitivity(
            nominal.mechanism, nominal.sizes, nominal.crank_angles, nominal.output, list(dict.fromkeys(sizes))
        ).by
        by = nominal.sign * np.array([slopes[size] for size in sizes])
        return LinearAnalysis(problem, nominal, tuple(deviations), by, limit)
    exact = ErrorDerivatives(nominal.part, sizes)
    parts = exact.numeric({**nominal.sizes, **nominal.further}, nominal.crank_angles, nominal.targets)[1]
    chosen = parts if len(names := error_names(nominal.part)) == 1 else [parts[names.index(nominal.name)]]
    still = np.zeros((len(sizes), len(nominal.crank_angles)))
    by = nominal.sign * np.concatenate([np.array([slope + still[0] for slope in own]) for own in chosen], axis=1)
    return LinearAnalysis(problem, nominal, tuple(deviations), by, limit)


BLOCK_SIZE = 12_000  # positions per block, so that intermediate arrays fit in the processor cache
CHUNK = 1 << 17  # samples that are one piece of work, a multiple of those of a batch
BINS, HISTOGRAM_RATIO = 400, 1.25  # of the histogram, which extends by that multiple of the worst case about the nominal value
Progress = Callable[[float], None]
Counts = Annotated[
    NDArray[np.int64],
    PlainValidator(lambda counts: np.array(counts, dtype=np.int64)),
    WithJsonSchema({"type": "array", "items": {"type": "integer"}}),
]


@dataclass(frozen=True)
class MonteCarlo:
    """Result of the Monte Carlo analysis.

    `mean`, `sigma` and the standard error of sigma (angles,) [SI] of the change of the output; `least`, `most` of it; `counts` of
    samples by the largest absolute judged value over all crank angles, between `edges` [SI]; `stuck`: samples that cannot be
    assembled at some angle; `good`: samples within the limit everywhere, `linear`: by the linear model; -1 without a limit.
    """

    shown: ClassVar[Mapping[str, Source]] = {
        **{name: name for name in ("samples", "seed", "mean", "sigma", "least", "most", "seconds")},
        "cannot_be_assembled": "stuck",
        "sigma_standard_error": "sigma_error",
        "stays_below": "quantiles",
        "histogram": lambda sampled: dict(zip(("edges", "counts"), sampled.histogram, strict=True)),
        "yield": "share",
        "yield_interval_95_percent": lambda sampled: sampled.interval if sampled.good >= 0 else None,
        "yield_by_the_linear_model": "linear_share",
    }

    samples: int
    seed: int
    stuck: int
    mean: Column
    sigma: Column
    sigma_error: Column
    least: Column
    most: Column
    counts: Counts
    edges: Column
    good: int
    linear: int
    seconds: float

    @property
    def share(self) -> float:
        """Yield."""
        return self.good / self.samples if self.good >= 0 else math.nan

    @property
    def linear_share(self) -> float:
        """Yield by the linear model, for the same samples."""
        return self.linear / self.samples if self.linear >= 0 else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Ends of the 95 % confidence interval of the yield for independent samples; quasi-random ones are more accurate."""
        return wilson(self.good, self.samples) if self.good >= 0 else (math.nan, math.nan)

    @property
    def histogram(self) -> tuple[Array, NDArray[np.int64]]:
        """The bins without the empty ones at both ends: their edges [SI], one more than bins, and their counts."""
        filled = np.flatnonzero(self.counts)
        first, end = (filled[0], filled[-1] + 1) if len(filled) else (0, 0)
        return self.edges[first : end + 1], self.counts[first:end]

    @property
    def quantiles(self) -> dict[str, float]:
        """Values [SI] below which some shares of the samples lie; see `below`."""
        return {f"{100.0 * share:g}_percent": self.below(share) for share in (0.5, 0.95, 0.99, 0.999)}

    def below(self, share: float) -> float:
        """Return the value [SI] below which a share of the samples lies, to one histogram bin; infinite beyond its end."""
        within = np.cumsum(self.counts) >= share * self.samples
        place = int(np.argmax(within))
        return float(self.edges[place + 1]) if within[-1] and place < len(self.counts) - 1 else math.inf


@dataclass
class SampleSums:
    """Sums over samples: counts as in `MonteCarlo`, `powers` (4, angles) of the change of the output less its mean shift."""

    counts: NDArray[np.int64]
    powers: Array
    least: Array
    most: Array
    stuck: int = 0
    good: int = 0
    linear: int = 0

    @classmethod
    def none(cls, angles: int) -> Self:
        """Return the sums over no samples."""
        counts = np.zeros(BINS, dtype=np.int64)
        return cls(counts, np.zeros((4, angles)), np.full(angles, math.inf), np.full(angles, -math.inf))

    def add(self, other: SampleSums) -> None:
        """Add the sums over other samples."""
        self.counts += other.counts
        self.powers += other.powers
        np.minimum(self.least, other.least, out=self.least)
        np.maximum(self.most, other.most, out=self.most)
        self.stuck, self.good, self.linear = self.stuck + other.stuck, self.good + other.good, self.linear + other.linear


@dataclass(frozen=True)
class SampleTask:
    """Moves the samples of a tolerance study, `chunk` of them in each chunk for `optlink.execution.runner`.

    The histogram has `bins` per unit from `bottom` [SI] on.
    """

    study: LinearAnalysis
    bottom: float
    bins: float
    samples: int
    seed: int
    chunk: int

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return -(-self.samples // self.chunk)

    def __call__(self, index: int, advance: Callable[[int], None] | None = None) -> SampleSums:
        """Return the sums over a chunk; `advance` receives the number of samples of every completed batch."""
        study, begin = self.study, self.chunk * index
        sums = SampleSums.none(len(study.shift))
        for batch in sample_deviations(study.deviations, min(begin + self.chunk, self.samples), self.seed, begin):
            for part, change in _moved(study.nominal, study.deviations, batch):
                self._count(sums, part, change)
            if advance is not None:
                advance(len(batch))
        return sums

    def _count(self, sums: SampleSums, part: Array, change: Array) -> None:
        """Add a block of deviations and the changes that they cause."""
        study, assembled = self.study, np.isfinite(change).all(axis=1)
        if not assembled.all():
            sums.stuck += int(np.sum(~assembled))
            change = change[assembled]
        largest = np.max(np.abs(study.nominal.base + change), axis=1)
        places = np.clip((largest - self.bottom) * self.bins, 0, BINS - 1).astype(int)
        sums.counts += np.bincount(places, minlength=BINS)
        if len(change):
            np.minimum(sums.least, np.min(change, axis=0), out=sums.least)
            np.maximum(sums.most, np.max(change, axis=0), out=sums.most)
        if study.limit is not None:
            sums.good += int(np.sum(largest <= study.limit))
            sums.linear += int(np.sum(np.max(np.abs(study.nominal.after(study.changes(part))), axis=1) <= study.limit))
        change -= study.shift  # keeps the sums of powers accurate
        power = change
        for i in range(4):
            sums.powers[i] += np.sum(power, axis=0)
            power = power * change


def monte_carlo(
    study: LinearAnalysis, samples: int, seed: int, progress: Progress | None = None, runs: Runs | None = None
) -> MonteCarlo:
    """Assemble and move random linkages exactly, and return their statistics; memory does not grow with their number."""
    begin = time.perf_counter()
    nominal, limit = study.nominal, study.limit
    middle = float(np.max(np.abs(nominal.base)))
    reach = HISTOGRAM_RATIO * max(float(np.max(np.maximum(-study.worst[0], study.worst[1]))), 1e-15)
    bottom = max(0.0, middle - reach)
    bins = BINS / (middle + reach - bottom)
    study = LinearAnalysis(study.problem, nominal, study.deviations, study.by, limit)  # alone, for other processes
    task = SampleTask(study, bottom, bins, samples, seed, CHUNK)
    total = SampleSums.none(len(study.shift))
    for part in _parts(task, progress, runs):
        total.add(part)
    mean, sigma, error = _moments(total.powers, samples - total.stuck)
    return MonteCarlo(
        samples=samples,
        seed=seed,
        stuck=total.stuck,
        mean=mean + study.shift,
        sigma=sigma,
        sigma_error=error,
        least=total.least,
        most=total.most,
        counts=total.counts,
        edges=np.linspace(bottom, middle + reach, BINS + 1),
        good=-1 if limit is None else total.good,
        linear=-1 if limit is None else total.linear,
        seconds=time.perf_counter() - begin,
    )


def _parts(task: SampleTask, progress: Progress | None, runs: Runs | None) -> Iterator[SampleSums]:
    """Yield the sums over the chunks in order, as the rounding of a total depends on it."""
    done = 0

    def advance(samples: int) -> None:
        nonlocal done
        done += samples
        if progress is not None:
            progress(done / task.samples)

    if runs is None or task.chunks == 1:
        yield from (task(index, advance) for index in range(task.chunks))
    else:
        size = task.chunk
        yield from ordered(task, task.chunks, runs, lambda index: advance(min(size, task.samples - size * index)))


def largest_errors(nominal: Nominal, deviations: Sequence[Deviation], batch: Array) -> Array:
    """Return the largest absolute judged value of each linkage (samples,) [SI]; NaN if it cannot be assembled at some angle."""
    return np.concatenate([np.max(np.abs(nominal.base + change), axis=1) for _, change in _moved(nominal, deviations, batch)])


def _moved(nominal: Nominal, deviations: Sequence[Deviation], batch: Array) -> Iterator[tuple[Array, Array]]:
    """Yield blocks of deviations, with the change of the judged value of each."""
    rows = max(1, BLOCK_SIZE // len(nominal.crank_angles))
    for first in range(0, len(batch), rows):
        part = batch[first : first + rows]
        yield part, nominal.change(_by_size(deviations, part))


def _by_size(deviations: Sequence[Deviation], batch: Array) -> dict[str, Array]:
    """Return deviations (samples, 1) by dimension; several may add up."""
    bins: dict[str, Array] = {}
    for i, deviation in enumerate(deviations):
        column = batch[:, i : i + 1]
        bins[deviation.size] = bins[deviation.size] + column if deviation.size in bins else column
    return bins


def _moments(sums: Array, count: int) -> tuple[Array, Array, Array]:
    """Return mean, standard deviation and its standard error from sums of the first four powers."""
    if count < 2:
        undefined = np.full(sums.shape[1], math.nan)
        return undefined, undefined, undefined
    first, second, third, fourth = sums / count
    variance = np.maximum(second - first * first, 0.0)
    central = np.maximum(fourth - 4.0 * first * third + 6.0 * first**2 * second - 3.0 * first**4, 0.0)
    sigma = np.sqrt(variance * count / (count - 1))
    spread = np.sqrt(np.maximum(central - variance * variance, 0.0) / count)  # of the variance
    return first, sigma, spread / np.where(sigma > 0.0, 2.0 * sigma, 1.0)
