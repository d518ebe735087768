"""Orders of the ends of strokes: random designs of one order, whether a design has that of its programme, orders beside it."""

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from optlink.optimization.courses import EVENT
from optlink.optimization.cycle_signals import EventOrder, Sample, TracedCycle
from optlink.optimization.multipliers import ACTIVE, LEAST_PRICE
from optlink.problem.cycle.terms import Term
from optlink.solvers.multistart import latin_hypercubes
from optlink.solvers.solution import Solution

STARTS = 16  # default number of random designs with which a search begins
SAMPLES = 160  # random designs for each of them; only those with one order of events are used
BLOCK = 32  # random designs whose events are determined together
ORDERS = 2  # further orders of events searched while no feasible design is known
STEPS = (1e-3, 1e-2)  # of the range of a design variable: from a design at the edge of its order of events to the next order
NEIGHBOURS, CROSSINGS = 4, 12  # other orders searched from one such design; ends of searches from which others may be searched
FURTHER = "an output has further dead centres"


@dataclass(frozen=True)
class OrderedStart:
    """A starting point [SI] with an order of events and slow strokes, for which the programme is built at the design `near`.

    `first`: whether a search begins with this order.
    """

    order: EventOrder
    values: Mapping[str, float]
    near: Mapping[str, float]
    first: bool

    @property
    def insists(self) -> bool:
        """Whether it is searched although no feasible point is found beside it."""
        return self.first and self.values == self.near


class OrderedStarts:
    """Starting points of a search for up to `count` designs of each order of events: the first design, then random ones.

    Those of a smaller number come first in the same sequence. `fault`: of the first design in which an output with a stroke does
    not reciprocate, see `TracedCycle.strokeless`. `most`: number of starting points of one order that `rounds` has found.
    """

    def __init__(self, trace: TracedCycle, seed: int, count: int = 1) -> None:
        self.trace, self.count, self.most, self._known = trace, count, 0, list[Sample]()
        self.fault: tuple[str, Term, int] | None = None
        self.choices = list(itertools.product((True, False), repeat=len(trace.paced)))  # of the slow strokes
        task = trace.problem
        initial = {name: task.quantities[name].value for name in task.free}
        low, high = np.array([task.quantities[name].bounds for name in task.free]).T
        drawn = (dict(zip(task.free, x.tolist(), strict=True)) for x in latin_hypercubes(low, high, seed))
        self._next = itertools.chain([initial], drawn)

    def samples(self, count: int) -> Iterator[Sample]:
        """Iterate over the design of the file and `count` random ones."""
        for k in range(count + 1):
            if k == len(self._known):
                many = list(itertools.islice(self._next, BLOCK if k else 1))
                self._known += self.trace.samples(many)
            yield self._known[k]

    def fits(self, order: EventOrder) -> bool:
        """Return whether every output with a stroke reciprocates in a design."""
        fault = self.trace.strokeless(order)
        self.fault = self.fault or fault
        return fault is None

    @cached_property
    def begun(self) -> list[list[OrderedStart]]:
        """The groups with which a search begins: those with the order of events of the first suitable design, its own first."""
        return self._alike(None)

    def _alike(self, order: EventOrder | None) -> list[list[OrderedStart]]:
        """Return the starting points of an order of events, a group for each choice of slow strokes."""
        groups, first = dict[tuple[bool, ...], list[OrderedStart]](), order is None
        for k, sample in enumerate(self.samples(SAMPLES * self.count)):
            if order is not None and not sample.may_be_like(order):
                continue
            own = sample.structure
            if own is None or not self.fits(own):
                continue
            order = own if order is None else order
            if own.like(order):
                self._sort_in(groups, sample.values, own, first=first)
            if (k >= SAMPLES or len(self.choices) == 1) and any(len(group) >= self.count for group in groups.values()):
                break
        return [group[: self.count] for group in groups.values()]

    def _sort_in(
        self,
        groups: dict[tuple[bool, ...], list[OrderedStart]],
        values: Mapping[str, float],
        own: EventOrder,
        *,
        first: bool = False,
    ) -> None:
        """Add a starting point to the group of its slow strokes; to both groups if the strokes take equally long."""
        for slow in self.choices:
            if all(pace is None or pace == other for pace, other in zip(own.slow, slow, strict=True)):
                start = OrderedStart(replace(own, slow=slow), values, values, first)
                group = groups.setdefault(slow, [start])
                if group[0] is not start:
                    group.append(replace(group[0], values=values))

    def _further(self) -> list[list[OrderedStart]]:
        """Return groups for a search without a feasible design: missing slow strokes, the next most frequent orders."""
        first, known = self.begun[0], [group[0].order.slow for group in self.begun]
        missing = [slow for slow in self.choices if slow not in known]
        orders = [replace(first[0].order, slow=slow) for slow in missing]
        result = [[replace(start, order=order, first=False) for start in first] for order in orders]
        groups: dict[tuple[object, ...], dict[tuple[bool, ...], list[OrderedStart]]] = {}
        frequent: Counter[tuple[object, ...]] = Counter()
        for k, sample in enumerate(self.samples(SAMPLES * max(self.count, STARTS))):
            own = sample.structure
            if own is not None and not own.like(first[0].order) and self.fits(own):
                key = (own.which, own.rising)
                frequent[key] += k <= SAMPLES * STARTS
                self._sort_in(groups.setdefault(key, {}), sample.values, own)
        return [*result, *(group[: self.count] for key, _ in frequent.most_common(ORDERS) for group in groups[key].values())]

    def rounds(self, best: Callable[[], EventOrder | None]) -> Iterator[list[OrderedStart]]:
        """Yield the starting points of every round of a search: one of each group with which it begins.

        While no design is feasible, so that `best`, the order of events of the best one, is None, those of further groups follow.
        An order that turns out to be better is searched from all of its starting points.
        """
        more, groups = list[list[OrderedStart]](), list(self.begun)
        explored, self.most = [group[0].order for group in groups], max(map(len, groups))
        for k in range(max(map(len, self.begun))):
            yield one_of_each(self.begun, k)
            if best() is None:
                more = self._further() if k == 0 else more
                yield one_of_each(more, k)
                groups = [*self.begun, *more]
                explored = [group[0].order for group in groups]
            found = best()
            if found is not None and not any(found.like(order) for order in explored):
                explored.append(found)
                alike = self._alike(found)
                groups += alike
                yield list(itertools.chain(*alike))
            self.most = max(map(len, groups))


def one_of_each(groups: Iterable[Sequence[OrderedStart]], k: int) -> list[OrderedStart]:
    """Return the k-th starting point of each group that has so many."""
    return [start for group in groups for start in group[k : k + 1]]


def misfit(trace: TracedCycle, structure: EventOrder, design: Mapping[str, float]) -> str:
    """Return why a programme with the events of `structure` does not describe a design [SI]; empty if it does.

    A programme knows the dead centres of its own order of events only: a design may have further ones, so that an output does not
    reciprocate as its stroke or time ratio requires (`FURTHER`), or a load acts in other strokes. The angle of a load may count
    from another turn than in the trace.
    """
    own = trace.structure(design)
    if own is None:
        return ""
    if trace.strokeless(own) is not None:
        return FURTHER
    if trace.reversals(own) != trace.reversals(structure):
        return "a motion has further reversals"
    return "" if trace.serves(design) else "the angle of a load counts from another turn"


def at_edge(solution: Solution) -> bool:
    """Return whether the order of events, which no limit prescribes, keeps a solution from a better one."""
    rows = solution.nlp.rows
    prices = np.abs(solution.conditions.multipliers[len(solution.x) :])
    return solution.usable and any(
        row.limit == EVENT and row.low < row.high and value - row.low <= ACTIVE and price > LEAST_PRICE
        for row, value, price in zip(rows, solution.g, prices, strict=True)
    )


def orders_beside(
    trace: TracedCycle, structure: EventOrder, design: Mapping[str, float]
) -> list[tuple[EventOrder, Mapping[str, float]]]:
    """Return the other orders of events beside a design [SI], each with a design that has it, the nearest first."""
    designs = []
    for step, (name, way) in itertools.product(STEPS, itertools.product(trace.problem.free, (-1.0, 1.0))):
        low, high = trace.problem.quantities[name].bounds
        designs.append({**design, name: min(max(design[name] + way * step * (high - low), low), high)})
    orders: dict[tuple[object, ...], tuple[EventOrder, Mapping[str, float]]] = {}
    for sample in trace.samples(designs):
        own = sample.structure
        if own is not None and not own.like(structure):
            orders.setdefault((own.which, own.rising), (replace(own, slow=structure.slow), sample.values))
    return list(orders.values())[:NEIGHBOURS]
