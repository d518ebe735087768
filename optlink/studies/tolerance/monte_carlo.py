"""Monte Carlo analysis of tolerances with exact kinematics: scatter, extremes and yield."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from annotated_types import Gt
from numpy.typing import NDArray
from pydantic import Field, model_validator

from optlink.problem.base_model import Column, Contradiction, Number, Record
from optlink.problem.tolerances import Deviation
from optlink.studies.tolerance.nominal import Nominal
from optlink.studies.tolerance.sampling import sample_deviations, wilson

if TYPE_CHECKING:
    from optlink.studies.tolerance.analysis import Tolerance

Array = NDArray[np.float64]
PORTION = 12_000  # positions per block, so that intermediate arrays fit in the processor cache
BINS, ROOM = 400, 1.25  # of the histogram, which extends by that multiple of the worst case about the nominal value
Progress = Callable[[float], None]


@dataclass(frozen=True)
class MonteCarlo:
    """Result of the Monte Carlo analysis.

    `mean`, `sigma` and the standard error of sigma (angles,) [SI] of the change of the output; `least`, `most` of it; `counts` of
    samples by the largest absolute judged value over all crank angles, between `edges` [SI]; `stuck`: samples that cannot be
    assembled at some angle; `good`: samples within the limit everywhere, `linear`: by the linear model; -1 without a limit.
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

    def below(self, share: float) -> float:
        """Return the value [SI] below which a share of the samples lies, to one histogram bin; infinite beyond its end."""
        reached = np.cumsum(self.counts) >= share * self.samples
        place = int(np.argmax(reached))
        return float(self.edges[place + 1]) if reached[-1] and place < len(self.counts) - 1 else math.inf


class HistogramRecord(Record):
    """The non-empty bins of the largest judged value: their edges [SI], one more than bins, and their counts."""

    edges: Column
    counts: Column

    @model_validator(mode="after")
    def _check_edges(self) -> Self:
        if len(self.counts) and len(self.edges) != len(self.counts) + 1:
            raise Contradiction("", "it has not one edge more than bins")
        return self

    @classmethod
    def of(cls, result: MonteCarlo, **values: Any) -> Self:
        """As `Record.of`, without the empty bins at both ends.

        Parameters
        ----------
        result : MonteCarlo
        **values
            Values of fields, in place of those of the result.
        """
        held = np.flatnonzero(result.counts)
        first, last = (int(held[0]), int(held[-1]) + 1) if len(held) else (0, 0)
        return super().of(result, edges=result.edges[first : last + 1], counts=result.counts[first:last], **values)


class MonteCarloRecord(Record):
    """The samples [SI]; the yield only with a limit."""

    samples: Annotated[int, Gt(0)]
    seed: int
    cannot_be_assembled: Annotated[int, "stuck"]
    mean: Column
    sigma: Column
    sigma_standard_error: Annotated[Column, "sigma_error"]
    least: Column
    most: Column
    stays_below: dict[str, Number]
    histogram: HistogramRecord
    share: Number = Field(alias="yield")
    yield_interval_95_percent: tuple[float, float] | None
    yield_by_the_linear_model: Annotated[Number, "linear_share"]
    seconds: float

    @property
    def interval(self) -> tuple[float, float]:
        """Ends of the 95 % confidence interval of the yield; NaN without a limit."""
        return self.yield_interval_95_percent or (math.nan, math.nan)

    @classmethod
    def of(cls, result: MonteCarlo, **values: Any) -> Self:
        """As `Record.of`, with quantiles and without bounds of a yield that has no limit.

        Parameters
        ----------
        result : MonteCarlo
        **values
            Values of fields, in place of those of the result.
        """
        below = {f"{100.0 * share:g}_percent": result.below(share) for share in (0.5, 0.95, 0.99, 0.999)}
        interval = result.interval if result.good >= 0 else None
        histogram = HistogramRecord.of(result)
        return super().of(result, stays_below=below, histogram=histogram, yield_interval_95_percent=interval, **values)


def monte_carlo(study: Tolerance, samples: int, seed: int, progress: Progress | None = None) -> MonteCarlo:
    """Assemble and move random linkages exactly, and return their statistics; memory does not grow with their number.

    Parameters
    ----------
    study : Tolerance
    samples : int
    seed : int
        Seed of the Sobol points.
    progress : function of the completed fraction, optional
    """
    begin = time.perf_counter()
    nominal, shift, angles = study.nominal, study.shift, len(study.nominal.crank_angles)
    limit, middle = study.limit, float(np.max(np.abs(nominal.base)))
    reach = ROOM * max(float(np.max(np.maximum(-study.worst[0], study.worst[1]))), 1e-15)
    bottom, bins = max(0.0, middle - reach), BINS / (middle + reach - max(0.0, middle - reach))
    counts = np.zeros(BINS, dtype=np.int64)
    sums = np.zeros((4, angles))
    least, most = np.full(angles, math.inf), np.full(angles, -math.inf)
    stuck = good = linear = done = 0
    for batch in sample_deviations(study.deviations, samples, seed):
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
            change -= shift  # keeps the sums of powers accurate
            power = change
            for i in range(4):
                sums[i] += np.sum(power, axis=0)
                power = power * change
        done += len(batch)
        if progress is not None:
            progress(done / samples)
    mean, sigma, error = _moments(sums, samples - stuck)
    return MonteCarlo(
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
    """Return the largest absolute judged value of each linkage (samples,) [SI]; NaN if it cannot be assembled at some angle.

    Parameters
    ----------
    nominal : Nominal
    deviations : sequence of Deviation
    batch : array (samples, deviations) [SI]
    """
    return np.concatenate([np.max(np.abs(nominal.base + change), axis=1) for _, change in _moved(nominal, deviations, batch)])


def _moved(nominal: Nominal, deviations: Sequence[Deviation], batch: Array) -> Iterator[tuple[Array, Array]]:
    """Yield blocks of deviations, with the change of the judged value of each."""
    rows = max(1, PORTION // len(nominal.crank_angles))
    for first in range(0, len(batch), rows):
        part = batch[first : first + rows]
        yield part, nominal.change(_by_size(deviations, part))


def _by_size(deviations: Sequence[Deviation], batch: Array) -> dict[str, Array]:
    """Return deviations (samples, 1) by dimension; several may add up."""
    found: dict[str, Array] = {}
    for i, deviation in enumerate(deviations):
        own = batch[:, i : i + 1]
        found[deviation.size] = found[deviation.size] + own if deviation.size in found else own
    return found


def _moments(sums: Array, count: int) -> tuple[Array, Array, Array]:
    """Return mean, standard deviation and its standard error from sums of the first four powers."""
    if count < 2:
        nothing = np.full(sums.shape[1], math.nan)
        return nothing, nothing, nothing
    first, second, third, fourth = sums / count
    variance = np.maximum(second - first * first, 0.0)
    central = np.maximum(fourth - 4.0 * first * third + 6.0 * first**2 * second - 3.0 * first**4, 0.0)
    sigma = np.sqrt(variance * count / (count - 1))
    spread = np.sqrt(np.maximum(central - variance * variance, 0.0) / count)  # of the variance
    return first, sigma, spread / np.where(sigma > 0.0, 2.0 * sigma, 1.0)
