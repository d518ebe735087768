"""Statistical evidence of a multistart search: how often the best optimum was reached, and how likely a better one was missed."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

Item = TypeVar("Item")


def tally(items: Iterable[tuple[Item, int]], alike: Callable[[Item, Item], bool]) -> list[tuple[Item, int]]:
    """Return distinct items in order, each with the sum of the counts of all items like it."""
    distinct: list[tuple[Item, int]] = []
    for item, count in items:
        for k, (first, total) in enumerate(distinct):
            if alike(first, item):
                distinct[k] = first, total + count
                break
        else:
            distinct.append((item, count))
    return distinct


INCOMPLETE = "search incomplete"
"""Beginning of the note on a search that may have missed the best design."""


@dataclass(frozen=True)
class Evidence:
    """Statistical evidence of a multistart search about optima that it did not find.

    `starts`: local searches that ended at an optimum; `optima`: distinct ones; `hits`: searches that reached the best one.
    `unseen`: estimated probability that the next start ends at an optimum not found before.
    `missed`: estimated probability that a better optimum exists than the best one found. `counts`: searches that reached each
    optimum, the best one first.
    """

    starts: int
    optima: int
    hits: int
    unseen: float
    missed: float
    counts: tuple[int, ...] = ()

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
    """Estimate the optima that a multistart search missed from the hits (none zero) of every distinct optimum, the best first.

    Both estimates assume independent random starts, and `missed` also that the size of an optimum's region of attraction
    says nothing about its objective. Each is the larger one of two: that of Good and Chao counts the optima found once and
    twice, that of Boender and Rinnooy Kan takes all divisions of the starts among the optima as equally likely beforehand. So
    a search that reached one optimum n times is not certain: `missed` is 1 / (n - 1). Both are 1 where there is no optimum, or
    hardly more starts than optima.

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
        return Evidence(n, w, hits, 1.0, 1.0, tuple(counts))
    once, twice = (sum(count == times for count in counts) for times in (1, 2))
    absent = once * (once - 1) / (2.0 * (twice + 1))
    unseen = max(once / n, w * (w + 1) / (n * (n - 1)))
    return Evidence(n, w, hits, min(1.0, unseen), min(1.0, max(w / (n - 1), absent / (w + absent))), tuple(counts))
