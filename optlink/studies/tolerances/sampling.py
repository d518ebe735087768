"""Quasi-random samples of deviations, confidence intervals of a yield, and options of the tolerance command."""

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from optlink.errors import InputError
from optlink.linkage.vector2d import Array
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import Unusable, nearest
from optlink.problem.tolerances import CLEARANCE, EXAMPLE, NORMAL, Deviation, ToleranceEntry, deviations, read_tolerance
from optlink.studies.grid import axis_of
from optlink.studies.tolerances.nominal import Nominal
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


# Tolerances from the command line, or from the problem file, as deviations of a linkage.

OPTION = "--tolerance"


def read_tolerances(problem: ProblemFile, texts: Sequence[str], shape: str = NORMAL) -> dict[str, ToleranceEntry]:
    """Return tolerances by name from texts NAME=TOLERANCE; without texts, those of the file.

    Files of measured deviations are read from the working folder.
    """
    entries: dict[str, ToleranceEntry] = {} if texts else dict(problem.model.tolerances)
    if not texts and not entries:
        raise InputError("no tolerance is given", f"{EXAMPLE}, or give the file [tolerances]", problem.file, OPTION)
    for assignment in texts:
        name, equals, text = assignment.partition("=")
        name = name.strip().removeprefix("mechanism.")
        if not equals or not name or not text.strip():
            raise InputError("expected NAME=TOLERANCE", EXAMPLE, key=OPTION, value=assignment)
        if name in entries:
            raise InputError("a tolerance is given twice", "Give each once", problem.file, OPTION, name)
        try:
            entries[name] = read_tolerance(text, Path())
        except Unusable as error:
            raise InputError(error.message, error.remedy, key=f"{OPTION} {name}", value=error.value) from None
    entry = {
        name: entry.shape or (None if entry.measured or name.endswith(CLEARANCE) else shape) for name, entry in entries.items()
    }
    return {name: replace(entries[name], shape=distribution) for name, distribution in entry.items()}


def stated(problem: ProblemFile, tolerances: Mapping[str, float | str]) -> list[str]:
    """Return tolerances as texts `NAME=TOLERANCE`, numbers in SI with the display unit of the quantity."""
    texts, quantities = [], problem.model.mechanism.quantities
    for name, value in tolerances.items():
        text = value
        if not isinstance(value, str):
            key = name.removeprefix("mechanism.")
            text = str(axis_of(problem, key, value, quantities[key].display[1] if key in quantities else "mm", OPTION).raw(0))
        texts.append(f"{name}={text}")
    return texts


def identified(problem: ProblemFile, texts: Sequence[str], shape: str, *, robust: bool) -> ProblemFile:
    """Return the problem of a study: with its tolerances, if measured ones are among those given, or of a robust design."""
    entries = read_tolerances(problem, texts, shape) if texts or robust else {}
    if not any(entry.measured for entry in entries.values()):
        return problem
    return problem.override({"tolerances": {name: entry.raw for name, entry in entries.items()}})


def check_tolerances(
    problem: ProblemFile, texts: Sequence[str], costs: Mapping[str, float], output: str, shape: str = NORMAL
) -> None:
    """Refuse tolerances, and costs, before a search for the design; what depends on its sizes is checked for the largest.

    `output` as in `Nominal.output`.

    Raises
    ------
    InputError
    """
    entries = read_tolerances(problem, texts, shape)
    with _named(problem, texts):
        problem.model.deviating(entries, output)
    for name, cost in costs.items():
        if not 0.0 < cost < math.inf:
            raise InputError("a cost coefficient must be above zero", "Give for example --cost coupler=2", key=f"--cost {name}")
        if name not in entries:
            raise InputError("no such tolerance", nearest(name, [*entries]), key=f"--cost {name}")


def read_deviations(problem: ProblemFile, nominal: Nominal, texts: Sequence[str], shape: str = NORMAL) -> tuple[Deviation, ...]:
    """Return the deviations of a nominal linkage; see `read_tolerances`."""
    entries = read_tolerances(problem, texts, shape)
    with _named(problem, texts):
        quantities, output = problem.model.mechanism.quantities, nominal.output
        return deviations(entries, nominal.mechanism, quantities, nominal.sizes, shape, output)


@contextlib.contextmanager
def _named(problem: ProblemFile, texts: Sequence[str]) -> Iterator[None]:
    """Name the option or the key of a tolerance that is refused."""
    try:
        yield
    except Unusable as error:
        key = f"{OPTION} {error.key}" if texts else f"tolerances.{error.key}"
        raise InputError(error.message, error.remedy, problem.file, key, error.value) from None
