"""Common parts of the searches: checked arguments, comparison of two back ends, progress, evidence of what was missed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from optlink.errors import Fault, InputError
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import nearest
from optlink.solvers import contract
from optlink.validation.check import Check

Item = TypeVar("Item")
Progress = Callable[[float], None] | None
"""Receives the share of the work that is done, from 0 to 1."""


class Timer:
    """Wall time per stage [s], in `seconds`."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        """End a stage."""
        now = time.perf_counter()
        self.seconds[stage], self._last = now - self._last, now


def tally(found: Iterable[tuple[Item, int]], alike: Callable[[Item, Item], bool]) -> list[tuple[Item, int]]:
    """Return distinct items in order, each with the sum of the counts of all items like it.

    Parameters
    ----------
    found : iterable of (item, count)
    alike : function of two items
    """
    distinct: list[tuple[Item, int]] = []
    for item, count in found:
        for k, (known, already) in enumerate(distinct):
            if alike(known, item):
                distinct[k] = known, already + count
                break
        else:
            distinct.append((item, count))
    return distinct


def check_count(key: str, value: int | None, most: int) -> None:
    """Check that a number lies between 1 and `most`.

    Parameters
    ----------
    key : str
        Argument, for the error.
    value : int or None
        None: the default.
    most : int

    Raises
    ------
    InputError
        If it does not.
    """
    if value is not None and not 1 <= value <= most:
        raise InputError(Fault("out of range", f"Give a number from 1 to {most}", key=key, value=value))


def back_ends(
    problem: ProblemFile, backend: str, starts: int | None, seed: int, most: int, *, both: bool = True
) -> tuple[str, ...]:
    """Check the arguments of a search, import its back ends and return their names.

    Parameters
    ----------
    problem : ProblemFile
    backend : str
        Name of a back end, or "both".
    starts : int, optional
        Number of starting points.
    seed : int
    most : int
        Largest number of starting points.
    both : bool
        Whether the search supports "both".

    Raises
    ------
    InputError
        If an argument is out of range, or there are no design variables.
    """
    known = [*contract.selectable(), *(["both"] if both else [])]
    if backend not in known:
        raise InputError(Fault("unknown back end", nearest(backend, known), key="backend", value=backend))
    check_count("starts", starts, most)
    if seed < 0:
        raise InputError(Fault("a seed is not negative", "Give 0 or more", key="seed", value=seed))
    if not problem.model.free:
        example, otherwise = {
            "function": ('coupler = { start = "400 mm", bounds = ["100 mm", "900 mm"] }', "check the design: optlink validate"),
            "cycle": ('length = { start = "120 mm", bounds = ["60 mm", "200 mm"] }', "`optlink analyze` the machine"),
        }.get(problem.task, ('coupler = { bounds = ["100 mm", "900 mm"] }', "check the design: optlink validate"))
        message = "no design variables: every dimension is fixed"
        raise InputError(Fault(message, f"Free one: {example}, or {otherwise}", problem.file, "mechanism"))
    names = contract.BACKENDS if backend == "both" else (backend,)
    for name in names:
        contract.backend(name)  # imports do not count as solving time
    return names


def agreement(
    what: str, same: bool, gaps: tuple[float, float], nearest_design: float, limit: str, unit: str = ""
) -> tuple[Check, ...]:
    """Check that two back ends found the same objective, and the same design unless several are equally good.

    Parameters
    ----------
    what : str
        "design" or "sizes".
    same : bool
        Whether the objectives agree.
    gaps : (float, float)
        Relative difference of the objectives, and difference of the designs.
    nearest_design : float
        Difference up to which two designs are the same.
    limit : str
        The same, for display.
    unit : str
        Unit of the difference of the designs.
    """
    alike = gaps[1] <= nearest_design
    words = "" if alike or not same else " (two of equal value)"
    return (
        Check("both back ends agree: objective", same, gaps[0], "<= 1e-06", ""),
        Check(f"both back ends agree: {what}{words}", same, gaps[1], limit if alike else "-", unit),
    )


def part(progress: Progress, k: int, count: int) -> Progress:
    """Return the progress function of the k-th of several searches.

    Parameters
    ----------
    progress : function of the completed fraction, optional
    k, count : int
    """
    return None if progress is None else lambda share: progress((k + share) / count)


@dataclass(frozen=True)
class Evidence:
    """Statistical evidence of a multistart search about optima that it did not find.

    `starts`: local searches that ended at an optimum; `optima`: distinct ones; `hits`: searches that reached the best one.
    `unseen`: estimated probability that the next start ends at an optimum not found before.
    `missed`: estimated probability that a better optimum exists than the best one found.
    """

    starts: int
    optima: int
    hits: int
    unseen: float
    missed: float

    @property
    def chance(self) -> str:
        """The estimate `missed` as a sentence."""
        return f"chance that a better optimum was missed: {percent(self.missed)} (estimate)"


def percent(share: float) -> str:
    """Format a share of 0 ... 1 in percent; only exact values are shown as 0 % or 100 %."""
    if share in (0.0, 1.0):
        return f"{100.0 * share:g} %"
    return "below 0.1 %" if share < 1e-3 else f"{min(100.0 * share, 99.9):.2g} %" if share < 0.995 else "over 99 %"


def evidence(counts: Sequence[int]) -> Evidence:
    """Estimate from the hits of every distinct optimum what a multistart search missed.

    Both estimates assume independent random starts, and `missed` also that the size of an optimum's region of attraction
    says nothing about its objective. Each is the larger one of two: that of Good and Chao counts the optima found once and
    twice, that of Boender and Rinnooy Kan takes all divisions of the starts among the optima as equally likely beforehand. So
    a search that reached one optimum n times is not certain: `missed` is 1 / (n - 1).

    Parameters
    ----------
    counts : (w,) int
        Searches that ended at each distinct optimum, the best optimum first; none is zero.

    Returns
    -------
    Evidence; both estimates are 1 where there is no optimum, or hardly more starts than optima

    References
    ----------
    I. J. Good, The population frequencies of species and the estimation of population parameters, Biometrika 40 (1953)
    237-264, eq. 9: unseen = f1 / n. A. Chao, Nonparametric estimation of the number of classes in a population, Scand. J.
    Statistics 11 (1984) 265-270, in its bias-corrected form: f1 (f1 - 1) / (2 (f2 + 1)) classes are unseen at least.
    C. G. E. Boender and A. H. G. Rinnooy Kan, Bayesian stopping rules for multistart global optimization methods, Math.
    Programming 37 (1987) 59-80: unseen = w (w + 1) / (n (n - 1)); the mean of 1 - w / k over their distribution of the
    number k of optima is w / (n - 1).
    """
    n, w = sum(counts), len(counts)
    hits = counts[0] if w else 0
    if w == 0 or n <= w + 1:
        return Evidence(n, w, hits, 1.0, 1.0)
    once, twice = (sum(count == times for count in counts) for times in (1, 2))
    absent = once * (once - 1) / (2.0 * (twice + 1))
    unseen = max(once / n, w * (w + 1) / (n * (n - 1)))
    return Evidence(n, w, hits, min(1.0, unseen), min(1.0, max(w / (n - 1), absent / (w + absent))))
