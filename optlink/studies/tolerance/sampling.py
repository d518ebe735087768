"""Quasi-random samples of deviations, confidence intervals of a yield, and options of the tolerance command."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from optlink.errors import InputError
from optlink.linkage.vector2d import Array
from optlink.problem.tolerances import Deviation
from optlink.units import read_number

BATCH = 1 << 13  # samples per batch; a power of two keeps Sobol points balanced
MIN_PROBABILITY = 2.0**-31  # half of the last bit of scipy's Sobol points: avoids 0, where a normal deviate is infinite
CONFIDENCE = 0.95


def sample_deviations(deviations: Sequence[Deviation], samples: int, seed: int, begin: int = 0) -> Iterator[Array]:
    """Yield deviations [SI] in batches (samples, deviations) of scrambled Sobol points; memory does not grow with their number.

    `begin`: number of samples to skip, a multiple of `BATCH`.

    References
    ----------
    A. B. Owen, Scrambling Sobol' and Niederreiter-Xing points, J. Complexity 14 (1998); scipy.stats.qmc.
    """
    from scipy.stats import qmc

    sobol = qmc.Sobol(len(deviations), rng=np.random.default_rng(seed))
    if begin:
        sobol.fast_forward(begin)
    for first in range(begin, samples, BATCH):
        share = np.asarray(sobol.random(BATCH), dtype=float)[: samples - first] + MIN_PROBABILITY
        yield np.stack([deviation.at(share[:, i]) for i, deviation in enumerate(deviations)], axis=1)


def wilson(good: int, count: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the Wilson confidence interval of a proportion.

    References
    ----------
    E. B. Wilson, Probable inference, the law of succession, and statistical inference, J. Am. Stat. Assoc. 22 (1927).
    """
    from scipy.special import ndtri

    if count == 0:
        return 0.0, 1.0
    z, share = float(ndtri(0.5 + 0.5 * confidence)), good / count
    middle = (share + z * z / (2.0 * count)) / (1.0 + z * z / count)
    half = z / (1.0 + z * z / count) * math.sqrt(share * (1.0 - share) / count + (z / (2.0 * count)) ** 2)
    return (0.0 if good == 0 else middle - half), (1.0 if good == count else middle + half)


def read_yield(text: str) -> float:
    """Read a yield such as "99.7 %" or 0.997."""
    number = text.strip()
    try:
        share = float(number.removesuffix("%")) / (100.0 if number.endswith("%") else 1.0)
    except ValueError:
        share = math.nan
    if not 0.0 < share < 1.0:
        raise InputError("not a yield", 'Give one between 0 and 100 %, such as "99.7 %"', key="--allocate", value=text)
    return share


def read_sigmas(text: str) -> float | str:
    """Read a number of standard deviations, "3 sigma", "worst", "worst case", "margin" or "yield"."""
    word = text.strip().removesuffix(" case")
    if word in ("worst", "margin", "yield"):
        return word
    number = read_number(text.strip().removesuffix("sigma"))
    if math.isnan(number):
        raise InputError("not a number of standard deviations", "Write 3, or worst, margin or yield", key="--robust", value=text)
    return number


def read_costs(texts: Sequence[str]) -> dict[str, float]:
    """Read cost coefficients by name from texts such as "coupler=2"."""
    costs: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        number = read_number(value)
        if not number > 0.0:
            raise InputError("not a cost coefficient", "Write NAME=NUMBER, for example coupler=2", key="--cost", value=text)
        costs[name.strip().removeprefix("mechanism.")] = number
    return costs
