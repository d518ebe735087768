"""Multistart search of cycle optimisation: one NLP for each order of events and slow stroke.

Where a design ends at the edge of its order of events, and a better one would have another order, that order is searched as well.

A larger number of starting points never worsens the result: the starting points of a smaller number come first in the same
sequence, no search depends on the others, and the best design is returned.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from optlink.errors import Status
from optlink.execution import interrupts
from optlink.execution.runner import ordered
from optlink.execution.worker import Runs
from optlink.linkage.vector2d import Array
from optlink.optimization.courses import TermCourse
from optlink.optimization.cycle_signals import EventOrder, TracedCycle
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import build
from optlink.solvers import multistart
from optlink.solvers.contract import CLOSE, backend
from optlink.solvers.cycle_starts import StartGroup
from optlink.solvers.event_orders import CROSSINGS, FURTHER, NEIGHBOURS, at_edge, misfit, orders_beside
from optlink.solvers.exchange import place_at_peaks, rank, reconcile_backends, solve_semi_infinite
from optlink.solvers.feasibility import repair
from optlink.solvers.solution import Relaxation, Solution


def neighbours(nlp: NLP, solution: Solution) -> list[StartGroup]:
    """Return starting points beside a solution, one for each other order of events, the nearest first."""
    beside = orders_beside(nlp.terms.trace, nlp.terms.structure, solution.design)
    return [StartGroup(structure, (values,)) for structure, values in beside]


def build_programme(trace: TracedCycle, begin: StartGroup) -> NLP:
    """Return the NLP of one order of events, with its exchange points at the peaks of the first starting point."""
    task = trace.problem
    nlp = build(task, terms=TermCourse(task, begin.starts[0], trace, begin.structure))
    place_at_peaks(task, nlp, nlp.lifted(nlp.x_start))
    return nlp


@dataclass
class OrderSearch:
    """The searches of one NLP, one starting point after the other.

    `runs`: for each back end, one solution per starting point so far, refined by the exchange method. Every search begins with
    the same exchange points; searches that end at the same design are refined once.
    """

    nlp: NLP
    begin: StartGroup
    names: tuple[str, ...]
    insists: bool = True  # whether the first search runs even without a feasible point near the start
    runs: dict[str, list[Solution]] = field(default_factory=dict)
    left: list[Solution] = field(default_factory=list)  # designs at the edge of the order, from which others were searched
    explored: bool = False  # beside the first orders: whether its order is searched from random starting points
    strayed: list[Solution] = field(default_factory=list)  # designs whose reversals or loads are not those of the NLP

    def __post_init__(self) -> None:
        self.runs = {name: [] for name in self.names}
        self._places = self.nlp.exchange_points
        self._refined: dict[str, list[tuple[Array, Solution]]] = {name: [] for name in self.names}

    def local(self, k: int) -> list[Solution]:
        """Return for each back end the end of a local search from the k-th starting point, before the exchange method."""
        ends = []
        for name in self.names:
            self.nlp.set_exchange_points(self._places)
            ends.append(self._from(self.nlp.x_of(self.begin.starts[k]), name, insist=self.insists and k == 0))
        return ends

    def advance(self, k: int, ends: Sequence[Solution] | None = None) -> None:
        """Search from the k-th starting point with every back end; `ends`: the local searches from there if already done."""
        for name, solution in zip(self.names, self.local(k) if ends is None else ends, strict=True):
            self.nlp.set_exchange_points(self._places)
            best = self.best(name)
            worse = best is not None and solution.status is not Status.OPTIMAL and rank(best) < rank(solution)
            self.runs[name].append(self._kept(self._exchanged(solution, name) if solution.usable and not worse else solution))

    def _kept(self, solution: Solution) -> Solution:
        """Return the end of a search, infeasible where the NLP does not describe its design; see `misfit`."""
        message = misfit(self.nlp.terms.trace, self.nlp.terms.structure, solution.design) if solution.usable else ""
        if not message:
            return solution
        if message != FURTHER:
            self.strayed.append(solution)
        return replace(solution, status=Status.INFEASIBLE, message=message)

    def _exchanged(self, solution: Solution, name: str) -> Solution:
        """Return the end of a search refined by the exchange method; an optimum that is known is not refined again."""
        free = self.nlp.first_event
        for x, previous in self._refined[name]:
            if solution.status is Status.OPTIMAL and np.max(np.abs(x - solution.x)[:free]) <= multistart.SAME_DESIGN:
                return previous
        refined = solve_semi_infinite(self.nlp.terms.problem, solution, CLOSE)
        if solution.status is Status.OPTIMAL:
            self._refined[name].append((solution.x, refined))
        return refined

    def _from(self, x: Array, name: str, *, insist: bool) -> Solution:
        """Search locally from a feasible point near x; with `insist`, if there is none, from x itself."""
        nlp = self.nlp
        start = repair(nlp, x, nlp.p)
        if start is None and insist and math.isfinite(nlp.values(x, nlp.p)[0]):
            p = multistart.scaled_parameters(nlp, x)
            end = multistart.conclude(nlp, backend(name)(nlp, nlp.lifted(x), p), p)
            x = end.x
            if end.status is Status.OPTIMAL and multistart.scaled_parameters(nlp, x)[0] >= multistart.RESCALE * p[0]:
                return end
            start = repair(nlp, x, nlp.p, inside=0.0)
        if start is None:
            infeasible = multistart.solution_at(nlp, x, "no feasible point was found beside the start")
            return replace(infeasible, status=Status.INFEASIBLE) if infeasible.status is Status.NON_FINITE else infeasible
        return multistart.solve_from(nlp, start, name)

    def best(self, name: str) -> Solution | None:
        """Return the best design of a back end so far."""
        return min(self.runs[name], key=rank, default=None)

    @property
    def top(self) -> Solution | None:
        """The best design of all back ends so far."""
        return min((best for name in self.names if (best := self.best(name)) is not None), key=rank, default=None)

    def rank(self) -> tuple[bool, bool, float]:
        """Return the sort key of the best design of all back ends; infeasible ones last."""
        return (True, True, math.inf) if self.top is None else rank(self.top)

    @property
    def usable(self) -> bool:
        """Whether a feasible design was found."""
        return any(solution.usable for run in self.runs.values() for solution in run)


@dataclass(frozen=True)
class LocalSearches:
    """Local searches of several programmes, round by round; each starting point of a programme is a chunk for the runner."""

    orders: tuple[OrderSearch, ...]

    def turns(self) -> list[tuple[OrderSearch, int]]:
        """Return the programme and the number of the starting point of every chunk."""
        most = max(len(order.begin.starts) for order in self.orders)
        return [(order, k) for k in range(most) for order in self.orders if k < len(order.begin.starts)]

    def __call__(self, index: int) -> list[dict[str, Any]]:
        """Return for each back end the fields of a solution, without the programme."""
        order, k = self.turns()[index]
        return [end.parts for end in order.local(k)]


@dataclass(frozen=True)
class CycleSearchResult:
    """Result of a search: the NLP of the best design, the best design for each back end, and every run.

    If no design is feasible, the conflicting limits. `starts`: number of starting points.
    """

    nlp: NLP
    best: dict[str, Solution]
    orders: tuple[OrderSearch, ...]
    starts: int
    conflict: tuple[Relaxation, ...] = ()
    together: tuple[Relaxation, ...] = ()
    interrupted: bool = False

    @property
    def usable(self) -> bool:
        """Whether a design satisfies all limits."""
        return any(solution.usable for solution in self.best.values())

    @property
    def begin(self) -> StartGroup:
        """The start group of the best design."""
        return next(order.begin for order in self.orders if order.nlp is self.nlp)

    @property
    def solutions(self) -> list[Solution]:
        """Every solution of every search."""
        return [solution for order in self.orders for run in order.runs.values() for solution in run]


def search_all(
    trace: TracedCycle,
    firsts: Sequence[StartGroup],
    names: Sequence[str],
    done: Callable[[int], None] = lambda _: None,
    further: Callable[[], Sequence[StartGroup]] = lambda: (),
    alike: Callable[[EventOrder], Sequence[StartGroup]] = lambda _: (),
    runs: Runs | None = None,
) -> CycleSearchResult:
    """Search from every starting point with every back end, refine by the exchange method, reconcile the back ends.

    `firsts` have the order of events of the initial design. `done` receives the number of complete starting points. `further`
    returns groups that are searched as well while no feasible design is found, `alike` those of the order of events of the best
    design. `runs`, from `optlink.execution.runner.pool`, makes the local searches of the first orders in other processes.
    """
    backends = tuple(names)
    orders = [OrderSearch(build_programme(trace, begin), begin, backends, explored=True) for begin in firsts]
    begun, more, beside = orders, list[OrderSearch](), list[OrderSearch]()
    count, interrupted = 0, False
    searches = LocalSearches(tuple(orders))
    ahead = None if runs is None else ordered(searches, len(searches.turns()), runs)
    try:
        for k in range(max(len(begin.starts) for begin in firsts)):
            _round(orders, k, ahead)
            if not any(order.usable for order in orders):
                if begun is orders:
                    more = [
                        OrderSearch(build_programme(trace, begin), begin, backends, False, explored=True) for begin in further()
                    ]
                    begun = [*orders, *more]
                _round(more, k)
            _cross(begun, beside)
            _return(begun, beside)
            _explore(begun, beside, alike)
            count = k + 1
            done(count)
    except KeyboardInterrupt:
        interrupts.handled()
        if not any(order.usable for order in begun):
            raise
        interrupted = True
    every = [order for order in (*begun, *beside) if all(order.runs.values())]
    winner = min(every, key=OrderSearch.rank)
    best_by_backend = {name: best for name in backends if (best := winner.best(name)) is not None}
    if winner.usable:
        best_by_backend = reconcile_backends(best_by_backend)
    return CycleSearchResult(winner.nlp, best_by_backend, tuple(every), count, interrupted=interrupted)


def _round(orders: Sequence[OrderSearch], k: int, ahead: Iterator[list[dict[str, Any]]] | None = None) -> None:
    """Search from the k-th starting point of each order; `ahead`: the local searches from there, made by other processes."""
    for order in orders:
        if k < len(order.begin.starts):
            order.advance(k, None if ahead is None else [Solution(source=order.nlp, **parts) for parts in next(ahead)])


def _search_beside(
    beside: list[OrderSearch], trace: TracedCycle, begin: StartGroup, names: tuple[str, ...], *, explored: bool = False
) -> None:
    """Search another order of events from all of its starting points, and add it to `beside`."""
    beside.append(OrderSearch(build_programme(trace, begin), begin, names, insists=False, explored=explored))
    for k in range(len(begin.starts)):
        beside[-1].advance(k)


def _cross(orders: Sequence[OrderSearch], beside: list[OrderSearch]) -> None:
    """Search the orders beside the best design while its own order keeps it from a better one, and add them to `beside`."""
    while len(beside) < CROSSINGS * NEIGHBOURS:
        winner = min((*orders, *beside), key=OrderSearch.rank)
        best = winner.top
        if best is None or best in winner.left or not at_edge(best):
            return
        winner.left.append(best)
        for begin in neighbours(winner.nlp, best):
            _search_beside(beside, winner.nlp.terms.trace, begin, winner.names)


def _explore(
    orders: Sequence[OrderSearch], beside: list[OrderSearch], alike: Callable[[EventOrder], Sequence[StartGroup]]
) -> None:
    """Search the order of events of the best design from its own starting points, for all slow strokes, unless that was done."""
    winner = min((*orders, *beside), key=OrderSearch.rank)
    structure = winner.nlp.terms.structure
    if not winner.usable or any(structure.like(search.nlp.terms.structure) for search in (*orders, *beside) if search.explored):
        return
    winner.explored = True
    for begin in alike(structure):
        _search_beside(beside, winner.nlp.terms.trace, begin, winner.names, explored=True)


def _return(orders: Sequence[OrderSearch], beside: list[OrderSearch]) -> None:
    """Continue searches that ended at a design with other reversals or loads than their programme, with those of that design."""
    while len(beside) < CROSSINGS * NEIGHBOURS:
        order = next((order for order in (*orders, *beside) if order.strayed), None)
        if order is None:
            return
        design, trace = order.strayed.pop().design, order.nlp.terms.trace
        traced = TracedCycle(trace.problem, design, trace.slow)
        structure = traced.structure(design)
        if structure is not None:
            begin = StartGroup(replace(structure, slow=order.nlp.terms.structure.slow), (design,))
            _search_beside(beside, traced, begin, order.names)
