"""Starting points of cycle optimisation: random designs, grouped by their order of events and their slow strokes."""

import itertools
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from optlink.optimization.cycle_signals import EventOrder, Sample, TracedCycle
from optlink.problem.cycle.terms import Term
from optlink.solvers.multistart import latin_hypercubes

STARTS = 16  # default number of starting points
SAMPLES = 160  # random designs per starting point; only those with the structure of the initial design are used
BLOCK = 32  # random designs whose events are determined together
ORDERS = 2  # further orders of events searched while no feasible design is known


@dataclass(frozen=True)
class StartGroup:
    """Starting points [SI] with the same order of events and the same slow strokes, for which one NLP is valid."""

    structure: EventOrder
    starts: tuple[Mapping[str, float], ...]


class StartSequence:
    """A fixed sequence of starting points: the design of the file, then random ones within the bounds.

    `fault`: of the first design in which an output with a stroke does not reciprocate, see `TracedCycle.strokeless`.
    """

    def __init__(self, trace: TracedCycle, seed: int) -> None:
        self.trace, self._known = trace, list[Sample]()
        self.fault: tuple[str, Term, int] | None = None
        self.choices = list(itertools.product((True, False), repeat=len(trace.paced)))  # of the slow strokes
        task = trace.problem
        initial = {name: task.quantities[name].value for name in task.free}
        low, high = np.array([task.quantities[name].bounds for name in task.free]).T
        drawn = (dict(zip(task.free, x.tolist(), strict=True)) for x in latin_hypercubes(low, high, seed))
        self._next = itertools.chain([initial], drawn)

    def first(self, count: int) -> Iterator[Sample]:
        """Iterate over the design of the file and `count` random ones."""
        for k in range(count + 1):
            if k == len(self._known):
                many = list(itertools.islice(self._next, BLOCK if k else 1))
                self._known += self.trace.samples(many)
            yield self._known[k]

    def fits(self, structure: EventOrder) -> bool:
        """Return whether every output with a stroke reciprocates in a design."""
        fault = self.trace.strokeless(structure)
        self.fault = self.fault or fault
        return fault is None


def start_groups(samples: StartSequence, count: int, order: EventOrder | None = None) -> list[StartGroup]:
    """Return up to `count` starting points per choice of slow strokes that share one order of events.

    That order is the one of the first suitable starting point unless given; the group of this point comes first.
    """
    groups: dict[tuple[bool, ...], StartGroup] = {}
    for k, sample in enumerate(samples.first(SAMPLES * count)):
        if order is not None and not sample.may_be_like(order):
            continue
        structure = sample.structure
        if structure is None or not samples.fits(structure):
            continue
        order = structure if order is None else order
        if structure.like(order):
            _sort_in(groups, samples.choices, sample.values, structure)
        if (k >= SAMPLES or len(samples.choices) == 1) and any(len(group.starts) >= count for group in groups.values()):
            break
    return [StartGroup(group.structure, group.starts[:count]) for group in groups.values()]


def _sort_in(
    groups: dict[tuple[bool, ...], StartGroup],
    choices: list[tuple[bool, ...]],
    values: Mapping[str, float],
    structure: EventOrder,
) -> None:
    """Add a starting point to the group of its slow strokes; to both groups if the strokes take equally long."""
    for slow in choices:
        if all(pace is None or pace == other for pace, other in zip(structure.slow, slow, strict=True)):
            group = groups.get(slow, StartGroup(replace(structure, slow=slow), ()))
            groups[slow] = replace(group, starts=(*group.starts, values))


def further_start_groups(samples: StartSequence, existing: Sequence[StartGroup], count: int) -> list[StartGroup]:
    """Return further groups for a search without a feasible design: missing slow strokes, the next most frequent orders.

    The first of the `existing` groups defines the order of events; a group has up to `count` starting points.
    """
    first = existing[0]
    missing = [slow for slow in samples.choices if slow not in [group.structure.slow for group in existing]]
    result = [StartGroup(replace(first.structure, slow=slow), first.starts) for slow in missing]
    groups: dict[tuple[object, ...], dict[tuple[bool, ...], StartGroup]] = {}
    frequent: Counter[tuple[object, ...]] = Counter()
    for k, sample in enumerate(samples.first(SAMPLES * max(count, STARTS))):
        structure = sample.structure
        if structure is not None and not structure.like(first.structure) and samples.fits(structure):
            key = (structure.which, structure.rising)
            frequent[key] += k <= SAMPLES * STARTS
            _sort_in(groups.setdefault(key, {}), samples.choices, sample.values, structure)
    for order, _ in frequent.most_common(ORDERS):
        result += [StartGroup(group.structure, group.starts[:count]) for group in groups[order].values()]
    return result
