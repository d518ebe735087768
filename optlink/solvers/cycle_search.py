"""The search for a machine by its cycle: starting points in one sequence, one search per order of events and slow stroke.

More starting points never make the answer worse: those of a smaller number come first in the same sequence, every search starts
from what the searches before it left, and the best of all designs is taken.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from optlink.errors import Status
from optlink.optimization.cycle_nlp import CycleNLP, build_cycle
from optlink.optimization.cycle_signals import Structure, Trace
from optlink.problem.cycle import CycleProblem
from optlink.problem.function import EPIGRAPH
from optlink.solvers import multistart
from optlink.solvers.feasibility import repair
from optlink.solvers.infeasibility import Explanation, Relaxation, explain
from optlink.solvers.semi_infinite import held, level, peaks
from optlink.solvers.solution import Solution

Array = NDArray[np.float64]

STARTS = 8  # starting points where no number is asked for
SAMPLES = 64  # per start: random sizes, of which only those are searched from that move as the given machine does
ORDERS = 2  # further orders of events that are searched while nothing feasible is known
COARSE, TRIED = 24, 2  # positions per revolution, and starts, where a conflict is looked for


@dataclass(frozen=True)
class Begin:
    """Sizes [SI] to search from, whose motions reverse in one order and have one slow stroke: one programme holds for them."""

    structure: Structure
    starts: tuple[Mapping[str, float], ...]


class Samples:
    """Sizes to search from, in one sequence whatever number is taken: those of the file, then random ones within the bounds."""

    def __init__(self, trace: Trace, seed: int) -> None:
        self.trace, self._known = trace, list[tuple[Mapping[str, float], Structure | None]]()
        task = trace.problem
        given = {name: task.quantities[name].value for name in task.free}
        self._next = itertools.chain([given], _random(task, seed))

    def first(self, count: int) -> Iterator[tuple[Mapping[str, float], Structure | None]]:
        """The sizes of the file and that many random ones, with how they move (None where the crank cannot turn fully)."""
        for k in range(count + 1):
            if k == len(self._known):
                values = next(self._next)
                self._known.append((values, self.trace.structure(values)))
            yield self._known[k]


def _random(task: CycleProblem, seed: int) -> Iterator[dict[str, float]]:
    """Random sizes within the bounds (scrambled Sobol points), without end."""
    from scipy.stats import qmc

    sobol = qmc.Sobol(len(task.free), rng=np.random.default_rng(seed))
    low, high = np.array([task.quantities[name].bounds for name in task.free]).T
    while True:
        for share in sobol.random(SAMPLES):
            yield dict(zip(task.free, (low + share * (high - low)).tolist(), strict=True))


def begins(samples: Samples, count: int, fits: Callable[[Structure], bool]) -> list[Begin]:
    """Up to `count` sizes to search from that move as the first ones that fit, apart by which strokes are slow.

    Parameters
    ----------
    samples : Samples
    count : int
    fits : function of a Structure
        Whether every output with a stroke goes to and fro.

    Returns
    -------
    list of Begin, that of the first sizes first; empty where no sizes fit
    """
    order: Structure | None = None
    found: dict[tuple[bool, ...], Begin] = {}
    choices = list(itertools.product((True, False), repeat=len(samples.trace.paced)))
    for k, (values, structure) in enumerate(samples.first(SAMPLES * count)):
        if structure is None or not fits(structure):
            continue
        order = structure if order is None else order
        if structure.like(order):
            _sort_in(found, choices, values, structure)
        if (k >= SAMPLES or len(choices) == 1) and any(len(own.starts) >= count for own in found.values()):
            break
    return [Begin(own.structure, own.starts[:count]) for own in found.values()]


def _sort_in(
    found: dict[tuple[bool, ...], Begin], choices: list[tuple[bool, ...]], values: Mapping[str, float], structure: Structure
) -> None:
    """Add sizes to the begins of their slow strokes: to both where the strokes take equally long."""
    for slow in choices:
        if all(own is None or own == other for own, other in zip(structure.slow, slow, strict=True)):
            known = found.get(slow, Begin(replace(structure, slow=slow), ()))
            found[slow] = replace(known, starts=(*known.starts, values))


def others(samples: Samples, known: Sequence[Begin], count: int, fits: Callable[[Structure], bool]) -> list[Begin]:
    """Where to search while nothing feasible is known: the slow strokes that no sizes had, and the next frequent orders."""
    trace, first = samples.trace, known[0]
    choices = list(itertools.product((True, False), repeat=len(trace.paced)))
    missing = [slow for slow in choices if slow not in [own.structure.slow for own in known]]
    found = [Begin(replace(first.structure, slow=slow), first.starts) for slow in missing]
    groups: dict[tuple[object, ...], dict[tuple[bool, ...], Begin]] = {}
    frequent: Counter[tuple[object, ...]] = Counter()
    for k, (values, structure) in enumerate(samples.first(SAMPLES * max(count, STARTS))):
        if structure is not None and not structure.like(first.structure) and fits(structure):
            key = (structure.which, structure.rising)
            frequent[key] += k <= SAMPLES * STARTS
            _sort_in(groups.setdefault(key, {}), choices, values, structure)
    for order, _ in frequent.most_common(ORDERS):
        found += [Begin(own.structure, own.starts[:count]) for own in groups[order].values()]
    return found


def programme(trace: Trace, begin: Begin) -> CycleNLP:
    """The programme of one order of events, its roaming positions where the first start has its peaks."""
    slow = trace.slow_loads(begin.structure.slow) if begin.structure.slow else None
    if slow and slow != trace.slow:
        trace = Trace(trace.problem, slow=slow)
    nlp = build_cycle(trace, begin.structure, begin.starts[0])
    nlp.roam(peaks(nlp, nlp.lifted(nlp.x_start)).shares)
    return nlp


@dataclass
class OrderSearch:
    """The searches of one programme, one starting point after the other.

    `runs`: by back end a solution for every starting point so far, its peaks followed; the positions that the programme knows
    are those of the best design so far, so that a solution depends on the starting points before it alone.
    """

    nlp: CycleNLP
    begin: Begin
    names: tuple[str, ...]
    insists: bool = True  # whether its first search begins even where no feasible point is found beside the start
    runs: dict[str, list[Solution]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.runs = {name: [] for name in self.names}
        self._places = {name: self._roaming() for name in self.names}

    def _roaming(self) -> Array:
        return self.nlp.p[len(self.nlp.p) - self.nlp.slots :].copy()

    def advance(self, k: int) -> None:
        """Search from the k-th starting point with every back end."""
        for name in self.names:
            self.nlp.roam(self._places[name])
            best = self.best(name)
            found = self._from(self.nlp.x_of(self.begin.starts[k]), name, insist=self.insists and k == 0)
            worse = best is not None and found.status is not Status.OPTIMAL and rank(best) < rank(found)
            if found.usable and not worse:
                found = level(self.nlp, found)
            self.runs[name].append(found)
            if best is None or rank(found) < rank(best):
                self._places[name] = self._roaming()

    def _from(self, x: Array, name: str, *, insist: bool) -> Solution:
        """A local search from a feasible point beside x; `insist`: from where one run of the back end ends if there is none."""
        nlp = self.nlp
        start = repair(nlp, x, nlp.p)
        if start is None and insist and math.isfinite(nlp.values(x, nlp.p)[0]):
            x = multistart.backend(name)(nlp, nlp.lifted(x), multistart.scaled(nlp, x)).x
            start = repair(nlp, x, nlp.p, inside=0.0)
        if start is None:
            missed = multistart.given(nlp, x, "no feasible point was found beside the start")
            return replace(missed, status=Status.INFEASIBLE) if missed.status is Status.NON_FINITE else missed
        return multistart.solve_from(nlp, start, name)

    def best(self, name: str) -> Solution | None:
        """The best design of a back end so far."""
        return min(self.runs[name], key=rank, default=None)

    @property
    def usable(self) -> bool:
        """Whether a feasible design is known."""
        return any(solution.usable for run in self.runs.values() for solution in run)


@dataclass(frozen=True)
class Searched:
    """What a search brought: the programme of the best design, by back end the best design of it, and every run.

    Or, where no design is feasible, the limits that conflict. `starts`: how many starting points were searched from.
    """

    nlp: CycleNLP
    found: dict[str, Solution]
    orders: tuple[OrderSearch, ...]
    starts: int
    conflict: tuple[Relaxation, ...] = ()
    together: tuple[Relaxation, ...] = ()
    interrupted: bool = False

    @property
    def usable(self) -> bool:
        """Whether a design meets all limits."""
        return any(solution.usable for solution in self.found.values())

    @property
    def begin(self) -> Begin:
        """Where the search of the best design began."""
        return next(order.begin for order in self.orders if order.nlp is self.nlp)

    @property
    def solutions(self) -> list[Solution]:
        """Every solution of every search."""
        return [solution for order in self.orders for run in order.runs.values() for solution in run]


def searched(
    trace: Trace,
    firsts: Sequence[Begin],
    names: Sequence[str],
    done: Callable[[], None],
    further: Callable[[], Sequence[Begin]] = lambda: (),
) -> Searched:
    """Search from every starting point with every back end, follow the peaks, reconcile the back ends.

    Parameters
    ----------
    trace : Trace
    firsts : sequence of Begin
        Of the order of events of the given machine.
    names : names of back ends
    done : function
        Called after each starting point.
    further : function that returns more begins
        Where to search as well while nothing feasible is known.
    """
    own = tuple(names)
    orders = [OrderSearch(programme(trace, begin), begin, own) for begin in firsts]
    more: list[OrderSearch] | None = None
    count, interrupted = 0, False
    try:
        for k in range(max(len(begin.starts) for begin in firsts)):
            _round(orders, k)
            if not any(order.usable for order in orders):
                if more is None:
                    more = [OrderSearch(programme(trace, begin), begin, own, False) for begin in further()]
                _round(more, k)
            count = k + 1
            done()
    except KeyboardInterrupt:
        if not any(order.usable for order in (*orders, *(more or ()))):
            raise
        interrupted = True
    every = [order for order in (*orders, *(more or ())) if all(order.runs.values())]
    winner = min(every, key=lambda order: min(rank(best) for name in own if (best := order.best(name)) is not None))
    found = {name: best for name in own if (best := winner.best(name)) is not None}
    if winner.usable:
        found = settle(winner.nlp, found)
    return Searched(winner.nlp, found, tuple(every), count, interrupted=interrupted)


def _round(orders: Sequence[OrderSearch], k: int) -> None:
    for order in orders:
        if k < len(order.begin.starts):
            order.advance(k)


def settle(nlp: CycleNLP, found: dict[str, Solution]) -> dict[str, Solution]:
    """Where two back ends ended in different optima, let the worse one search again from the better one's design.

    A true local optimum holds it there; if it does not, the two still disagree and the validation says so.
    """
    winner = min(found.values(), key=rank)
    return {
        name: solution if multistart.compare(solution, winner).same else min((solution, held(nlp, winner, name)), key=rank)
        for name, solution in found.items()
    }


def rank(solution: Solution) -> tuple[bool, bool, float]:
    """What comes first is better: feasible, proven, low."""
    return not solution.usable, solution.status is not Status.OPTIMAL, solution.objective


def explained(found: Searched, names: Sequence[str]) -> Searched:
    """Why no design is feasible, with the nearest one; or a feasible one after all.

    Which of the [limits] conflict is asked of a programme with fewer positions; the bounds of the sizes hold.
    """
    nlp, order = found.orders[0].nlp, found.orders[0]
    coarse = build_cycle(nlp.traced, nlp.structure, nlp.design(nlp.x_start), nodes=COARSE)
    asked = {bound.key for bound in coarse.traced.problem.bounds}
    kept = coarse.states.union(coarse.free, {row.limit for row in coarse.rows} - asked - {EPIGRAPH})
    ends = [nlp.design(solution.x) for solution in next(iter(order.runs.values()))[:TRIED]]
    points = [coarse.x_of(values) for values in (*order.begin.starts[:TRIED], *ends)]

    def follow(x: Array) -> Array:
        coarse.roam(peaks(coarse, x).shares)
        return coarse.p

    reason = explain(replace(coarse, states=kept), points=points, quick=True, follow=follow)
    if isinstance(reason, Explanation):
        miss = replace(multistart.given(nlp, nlp.x_of(coarse.design(reason.x)), "nearest design"), status=Status.INFEASIBLE)
        return replace(found, nlp=nlp, found=dict.fromkeys(names, miss), conflict=reason.conflict, together=reason.together)
    x = nlp.x_of(coarse.design(reason))
    again = {name: level(nlp, multistart.solve_from(nlp, x, name)) for name in names}
    return replace(found, nlp=nlp, found=settle(nlp, again))
