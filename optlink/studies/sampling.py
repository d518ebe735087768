"""Deviations of sizes: their distributions, quasi-random samples of them, and how sure a yield that was counted is."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from optlink.design.law import read_columns
from optlink.design.quantity import Unusable, nearest
from optlink.errors import Fault, InputError
from optlink.units import UnitProblem, parse

Array = NDArray[np.float64]
NORMAL, CONTACT, MEASURED = "normal", "contact", "measured"
SIGMAS = 3.0  # of a normal distribution that a tolerance stands for
BATCH = 1 << 13  # samples that are drawn at a time; a power of two keeps Sobol points balanced
TINY = 2.0**-31  # half of the last bit of scipy's Sobol points: keeps shares off 0, where a normal deviation is infinite
CONFIDENCE = 0.95
EXAMPLE = 'Write for example coupler="0.1 mm", coupler="0.1 mm uniform" or coupler="parts.csv"'


def _normal(share: Array) -> Array:
    from scipy.special import ndtri

    return np.asarray(ndtri(share), dtype=float) / SIGMAS


def _triangular(share: Array) -> Array:
    low = np.sqrt(2.0 * np.minimum(share, 0.5)) - 1.0
    return np.asarray(np.where(share < 0.5, low, 1.0 - np.sqrt(2.0 * np.minimum(1.0 - share, 0.5))), dtype=float)


@dataclass(frozen=True)
class Shape:
    """A distribution with a tolerance of 1 and mean 0: its standard deviation, and the deviation below which a share lies."""

    sigma: float
    quantile: Callable[[Array], Array]


SHAPES: Mapping[str, Shape] = {
    NORMAL: Shape(1.0 / SIGMAS, _normal),
    "uniform": Shape(1.0 / math.sqrt(3.0), lambda share: 2.0 * share - 1.0),
    "triangular": Shape(1.0 / math.sqrt(6.0), _triangular),
    CONTACT: Shape(1.0 / math.sqrt(2.0), lambda share: -np.cos(np.pi * share)),
}
"""By name. Contact: the part along a link of a gap whose journal rests on the bearing's wall, in any direction alike."""

CHOICES = tuple(name for name in SHAPES if name != CONTACT)


@dataclass(frozen=True)
class Deviation:
    """How a size may differ from its nominal value.

    `name` as people call it, `size` the quantity of the linkage that it adds to; `kind` "length" or "angle"; `tolerance` [SI]: it
    lies within +- that (normal: that is three sigma). `values` (parts,) [SI]: deviations that were measured, in place of a shape.
    """

    name: str
    size: str
    kind: str
    tolerance: float
    shape: str = NORMAL
    values: tuple[float, ...] = field(default=(), repr=False)

    @cached_property
    def _sorted(self) -> Array:
        return np.sort(np.asarray(self.values, dtype=float))

    @property
    def mean(self) -> float:
        """Mean deviation [SI]."""
        return float(np.mean(self._sorted)) if self.values else 0.0

    @property
    def sigma(self) -> float:
        """Standard deviation [SI]."""
        return float(np.std(self._sorted)) if self.values else SHAPES[self.shape].sigma * self.tolerance

    @property
    def ends(self) -> tuple[float, float]:
        """Least and largest deviation [SI] that the worst case counts with."""
        return (float(self._sorted[0]), float(self._sorted[-1])) if self.values else (-self.tolerance, self.tolerance)

    def at(self, share: Array) -> Array:
        """The deviation [SI] below which a share of all lies; of measured ones, one of them."""
        if self.values:
            place = np.minimum((share * len(self.values)).astype(int), len(self.values) - 1)
            return np.asarray(self._sorted[place], dtype=float)
        return self.tolerance * SHAPES[self.shape].quantile(share)


def read_deviation(text: str, size: str, kind: str, name: str, shape: str) -> Deviation:
    """Read what is said of one size: "0.1 mm", "0.1 mm uniform", or the CSV file of measured deviations.

    Parameters
    ----------
    text : str
    size, kind : the quantity that it adds to, and the kind of its unit: "length" or "angle"
    name : as people call it; a column of a CSV file is named so too, with its unit: `coupler_mm`
    shape : the distribution where none is said

    Raises
    ------
    InputError
    """
    key, text = f"--tolerance {name}", text.strip().strip("\"'").strip()
    quantity, _, word = text.rpartition(" ")
    try:
        if text.lower().endswith(".csv"):
            if not Path(text).is_file():
                raise Unusable("no such file", "Give its path from the working folder", "", text)
            (values,) = read_columns(Path(text), {name: "angle" if kind == "angle" else "coordinate"})
            if len(values) < 2:
                raise Unusable("one deviation is no distribution", "Give at least two rows", "", text)
            return Deviation(name, size, kind, max(map(abs, values)), MEASURED, tuple(values))
        if word.isalpha() and quantity.strip()[-1:].isalpha():  # two words after the number: a unit and a distribution
            if word not in CHOICES:
                raise Unusable("unknown distribution", nearest(word, CHOICES), "", word)
            text, shape = quantity, word
        value, _ = parse(text, kind)
    except (UnitProblem, Unusable) as error:
        raise InputError(Fault(error.message, error.remedy, key=key, value=text)) from None
    if not value > 0.0:
        raise InputError(Fault("a tolerance is above zero: it goes to both sides", EXAMPLE, key=key, value=text))
    return Deviation(name, size, kind, value, shape)


def drawn(deviations: Sequence[Deviation], samples: int, seed: int) -> Iterator[Array]:
    """Deviations [SI] in batches (samples, deviations) of scrambled Sobol points; memory does not grow with their number.

    Source: A. B. Owen, Scrambling Sobol' and Niederreiter-Xing points, J. Complexity 14 (1998); scipy.stats.qmc.
    """
    from scipy.stats import qmc

    sobol = qmc.Sobol(len(deviations), rng=np.random.default_rng(seed))
    for first in range(0, samples, BATCH):
        share = np.asarray(sobol.random(BATCH), dtype=float)[: samples - first] + TINY
        yield np.stack([deviation.at(share[:, i]) for i, deviation in enumerate(deviations)], axis=1)


def wilson(good: int, count: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Ends of the interval in which a share lies, `good` of `count` independent samples having been so.

    Source: E. B. Wilson, Probable inference, the law of succession, and statistical inference, J. Am. Stat. Assoc. 22 (1927).
    """
    from scipy.special import ndtri

    if count == 0:
        return 0.0, 1.0
    z, share = float(ndtri(0.5 + 0.5 * confidence)), good / count
    middle = (share + z * z / (2.0 * count)) / (1.0 + z * z / count)
    half = z / (1.0 + z * z / count) * math.sqrt(share * (1.0 - share) / count + (z / (2.0 * count)) ** 2)
    return (0.0 if good == 0 else middle - half), (1.0 if good == count else middle + half)


def read_yield(text: str) -> float:
    """A share written as "99.7 %" or 0.997.

    Raises
    ------
    InputError
    """
    plain = text.strip()
    try:
        share = float(plain.removesuffix("%")) / (100.0 if plain.endswith("%") else 1.0)
    except ValueError:
        share = math.nan
    if not 0.0 < share < 1.0:
        raise InputError(Fault("no yield", 'Give one between 0 and 100 %, such as "99.7 %"', key="--allocate", value=text))
    return share


def read_sigmas(text: str) -> float | str:
    """A number of standard deviations, or "worst", or "margin".

    Raises
    ------
    InputError
    """
    if text.strip() in ("worst", "margin"):
        return text.strip()
    try:
        return float(text)
    except ValueError:
        raise InputError(
            Fault("no number of standard deviations", "Write 3, or worst, or margin", key="--robust", value=text)
        ) from None


def read_costs(texts: Sequence[str]) -> dict[str, float]:
    """Cost coefficients by name, of texts such as "coupler=2".

    Raises
    ------
    InputError
    """
    found: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not (math.isfinite(number) and number > 0.0):
            raise InputError(Fault("no cost coefficient", "Write NAME=NUMBER, for example coupler=2", key="--cost", value=text))
        found[name.strip().removeprefix("mechanism.")] = number
    return found
