"""Expressions of the NLP of cycle optimisation: positions, events, objective terms, rows of limits."""

import functools
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi
import numpy as np

from optlink.linkage.stroke import LEAST_DIFFERENCE
from optlink.linkage.vector2d import TURN, Array
from optlink.optimization.constraints import DEGREES, PLAIN, ConstraintRow, Scale, alignment_row, link_rows
from optlink.optimization.courses import EVENT, FEWEST
from optlink.optimization.cycle_signals import EventOrder, TracedCycle
from optlink.optimization.mapped_terms import MappedTerms
from optlink.optimization.nlp import Variable, scaled_variable
from optlink.optimization.term_rows import heights_at, rows_below_level, scaled_limit
from optlink.problem.cycle.terms import Goal, Term
from optlink.problem.limits import Bound
from optlink.symbolic import symbols_in_numpy
from optlink.units import KINDS

ROOM = 1.01  # factor on the least difference of slow and quick stroke that an NLP enforces
EVENT_SEPARATION = 1e-3  # rad, least crank rotation between two events


@dataclass(frozen=True)
class WatchedTerm:
    """A term to be monitored between the nodes: the indices of its components among the signals, and its level or bound.

    `level`: index of the variable that is its largest value; otherwise `bound` [SI] limits it. `sign`: -1 for a least value.
    `worst`: whether the largest component counts, not the magnitude of all.
    """

    first: int
    width: int
    peak: bool
    sign: float
    size: float
    level: int | None
    bound: float
    worst: bool = False

    def score(self, signals: Array) -> Array:
        """Return the value to maximise at each position, in units of `size`."""
        components = signals[self.first : self.first + self.width]
        if self.width > 1:
            return np.asarray((np.max(np.abs(components), axis=0) if self.worst else np.hypot(*components)) / self.size)
        return np.asarray(np.abs(components[0]) / self.size if self.peak else self.sign * components[0] / self.size)

    def height(self, signals: Any) -> Any:
        """Return a smooth expression with the same maxima as the score: its square where the score is not differentiable."""
        components = [signals[self.first + k] / self.size for k in range(self.width)]
        if self.worst:
            return functools.reduce(casadi.fmax, [part * part for part in components])
        return casadi.sumsqr(casadi.vertcat(*components)) if self.width > 1 or self.peak else self.sign * components[0]


def _keeps_slow(bound: Bound) -> bool:
    """Return whether a limit of a time ratio by itself keeps the slow stroke slower."""
    if bound.term.stroke == "quick":
        return bound.interval.high is not None
    return bound.interval.low is not None


class CycleTerms:
    """The expressions of an NLP of cycle optimisation.

    The `structure` has the events of the design `start` [SI]; `nodes` are positions per revolution, `exchange` exchange points
    per stroke; `size` [m] is the unit of length, by default the longest length of the file.
    """

    def __init__(
        self,
        trace: TracedCycle,
        structure: EventOrder,
        start: Mapping[str, float],
        nodes: int,
        exchange: int,
        size: float | None = None,
    ) -> None:
        self.trace, self.structure, self.problem = trace, structure, trace.problem
        problem = self.problem
        self.size = problem.longest if size is None else size
        self.free = problem.free
        self.fixed = problem.fixed
        self.goals = problem.goals
        self.epigraphs = [goal for goal in self.goals if goal.extreme]
        events = len(structure.which)
        self.cuts = trace.cuts(structure)
        self.strokes = max(1, self.cuts) * trace.revolutions
        self.variables = [self._scaled(name) for name in self.free]
        self.variables += [Variable(f"{EVENT} {k + 1}", 1.0, DEGREES) for k in range(events)]
        self.variables += [Variable(f"{goal.words} {k + 1}", 1.0, PLAIN) for k, goal in enumerate(self.epigraphs)]
        self.constants = [self._scaled(name) for name in self.fixed]
        self.x = casadi.SX.sym("x", len(self.variables))
        self.exchange, self.slots = exchange, self.strokes * exchange
        self.p = casadi.SX.sym("p", 1 + len(self.fixed) + self.slots)
        self.values: dict[str, Any] = {v.name: v.size * self.x[i] for i, v in enumerate(self.variables[: len(self.free)])}
        self.values |= {v.name: v.size * self.p[1 + i] for i, v in enumerate(self.constants)}
        with symbols_in_numpy():
            self.values = problem.complete(self.values)
        self.known = casadi.vertcat(*[self.values[name] for name in trace.names])
        self.events = [self.x[len(self.free) + k] for k in range(events)]
        self.levels = [self.x[len(self.free) + events + k] for k in range(len(self.epigraphs))]
        self.x_fixed = [problem.quantities[v.name].value / v.size for v in self.constants]
        self.start = dict(start)
        self.rows: list[ConstraintRow] = []
        self._cut(nodes)
        self._at_events()
        self.rows += link_rows(problem, self.values, self.size)

    def _scaled(self, name: str) -> Variable:
        return scaled_variable(self.problem, name, self.size, periodic=self.problem.quantities[name].kind == "angle")

    # --- positions -------------------------------------------------------------------------------------------------------

    def _cut(self, nodes: int) -> None:
        """Define nodes and exchange points of every stroke, with the signals there."""
        edges = self.trace.edges(self.events[: self.cuts])
        self.edges = edges
        if self.cuts:
            count = max(FEWEST, math.ceil(nodes / self.cuts))
            at, weights = np.polynomial.legendre.leggauss(count)
            shares, weights = 0.5 * (at + 1.0), 0.5 * weights
        else:  # even steps integrate smooth periodic functions best
            shares, weights = np.arange(nodes) / nodes, np.full(nodes, 1.0 / nodes)
        self.spans = [b - a for a, b in itertools.pairwise(edges)]
        self.at: list[tuple[int, Any, Any]] = []  # stroke, weight or None, signals
        self.exchanged: list[Any] = []  # signals at the exchange points
        self.places: list[tuple[Any, Any, Any]] = []  # crank angle, senses, symbols for the signals
        exchange = [self.p[1 + len(self.fixed) + k] for k in range(self.slots)]
        for j, span in enumerate(self.spans):
            senses = self.trace.sensed(casadi.vertcat(self.known, edges[j] + 0.5 * span))
            for share, weight in zip(shares, weights, strict=True):
                self.at.append((j, weight * span, self._signals(edges[j] + share * span, senses)))
            for share in (0.0, 1.0) if self.cuts else ():  # forces are often largest where they jump
                self.at.append((j, None, self._signals(edges[j] + share * span, senses)))
            for share in exchange[j * self.exchange : (j + 1) * self.exchange]:
                self.exchanged.append(self._signals(edges[j] + share * span, senses))
                self.at.append((j, None, self.exchanged[-1]))

    def _signals(self, angle: Any, senses: Any) -> Any:
        """Return symbols for the signals at a crank angle; `mapped` replaces them."""
        symbols = casadi.SX.sym("z", self.trace.at.size1_out(0))
        self.places.append((angle, senses, symbols))
        return symbols

    def mapped(self, f: Any) -> MappedTerms:
        """Return objective f, an expression of x, p and the symbols for the signals, and rows as terms of the signals."""
        angles, senses, z = (casadi.horzcat(*parts) for parts in zip(*self.places, strict=True))
        g = casadi.vertcat(*[row.value for row in self.rows])
        places = (casadi.SX(angles),), (senses,), (z,)
        return MappedTerms(self.x, self.p, (self.trace.at,), self.known, len(self.free), *places, f, g)

    def _at_events(self) -> None:
        """Evaluate the functions at the events: event values, which must vanish, and the positions of the outputs."""
        self.there = [self.trace.at_event(casadi.vertcat(self.known, phi)) for phi in self.events]
        speed = abs(self.trace.speed)
        for k, (which, there) in enumerate(zip(self.structure.which, self.there, strict=True)):
            event = self.trace.events[which]
            label = f"{EVENT} {k + 1}: {' '.join(event.key)}"
            self.rows.append(ConstraintRow(EVENT, label, there[which] / event.unit(self.size, speed), 0.0, 0.0, PLAIN))
        angles = [*self.structure.angles[: self.cuts], self.structure.angles[0] + TURN] if self.cuts > 1 else []
        for k, (span, (begin, end)) in enumerate(zip(self.spans, itertools.pairwise(angles), strict=False)):
            if end - begin > EVENT_SEPARATION:  # otherwise both always coincide in this machine
                self.rows.append(ConstraintRow(EVENT, f"order of {EVENT} {k + 1}", span, EVENT_SEPARATION, math.inf, DEGREES))
        self._slow()

    def _slow(self) -> None:
        """Add rows that keep the slow stroke slower: for loads by the least difference, for time ratios without such a limit."""
        for name, which in self.trace.paced_loads.items() if self.events else ():
            label = f"slow minus quick stroke of {name}"
            least = ROOM * LEAST_DIFFERENCE
            self.rows.append(ConstraintRow(f"loads.{name}.stroke", label, self._slower(which), least, math.inf, DEGREES))
        implied = {id(bound.term) for bound in self.problem.bounds if _keeps_slow(bound)}
        for term in self.trace.terms:
            if term.by_pace and id(term) not in implied:
                label = f"slow minus quick stroke of {term.of}"
                self.rows.append(ConstraintRow(EVENT, label, self._slower(self.trace.event_of(term)), 0.0, math.inf, DEGREES))

    def _forward_slow(self, which: int) -> bool:
        """Return whether the forward stroke of a motion counts as the slow one in this NLP."""
        return self.structure.slow[self.trace.paced.index(which)] is not False

    def _slower(self, which: int) -> Any:
        """Return the crank rotation [rad] by which the slow stroke is longer than the quick one."""
        slow = self._forward_slow(which)
        return self.duration(which, slow) - self.duration(which, not slow)

    def _reversals(self, which: int) -> list[int]:
        """Return the indices of the events at which an output reverses."""
        return [k for k, event in enumerate(self.structure.which) if event == which]

    def forward(self, which: int) -> list[bool]:
        """Return for every stroke whether an output, whose reversals separate strokes, moves forward."""
        indices = [k for k in self._reversals(which) if k < self.cuts]
        if not indices:
            return [True] * self.strokes
        state, intervals = not self.structure.rising[indices[0]], []
        for k in range(self.cuts):
            state = self.structure.rising[k] if k in indices else state
            intervals.append(state)
        return intervals * self.trace.revolutions

    def duration(self, which: int, forward: bool) -> Any:
        """Return the crank rotation [rad] during which an output, which reverses at an event, moves forward or backward."""
        indices = self._reversals(which)
        total, angles = casadi.SX(0.0), [*(self.events[k] for k in indices), self.events[indices[0]] + TURN]
        for k, (begin, end) in zip(indices, itertools.pairwise(angles), strict=True):
            if self.structure.rising[k] is forward:
                total += end - begin
        return total

    # --- terms -----------------------------------------------------------------------------------------------------------

    def place(self, term: Term) -> tuple[int, int]:
        """Return the index of the first component of a cyclic term among the signals, and the number of components."""
        index = next(k for k, other in enumerate(self.trace.cyclic) if other is term)
        return sum(self.trace.widths[:index]), self.trace.widths[index]

    def components(self, term: Term) -> Iterator[tuple[Any, list[Any]]]:
        """Yield (weight or None, components) at every position."""
        first, width = self.place(term)
        for _, weight, signals in self.at:
            yield weight, [signals[first + k] for k in range(width)]

    def figure(self, term: Term) -> Any:
        """Return the expression of a term with a single value [SI]."""
        if term.how in ("rms", "mean"):
            square = term.how == "rms"
            total = casadi.SX(0.0)
            for weight, parts in self.components(term):
                if weight is not None:
                    total += weight * (sum(part * part for part in parts) if square else parts[0])
            cycle = TURN * self.trace.revolutions
            return casadi.sqrt(total / cycle) if square else total / cycle
        if term.quantity == "length":
            return self.values[str(term.of)]
        if term.quantity == "total length":
            return sum(self.values[name] for name in self.problem.lengths)
        if term.quantity == "work":
            return self._work(term)
        return self._ratio(term) if term.quantity == "time ratio" else self._stroke(term)

    def natural(self, goal: Goal) -> Any:
        """Return the magnitudes of the signal of a mean or a work [SI]; zero for a term that does not vanish by cancellation."""
        if goal.quantity == "work":
            last = sum(self.trace.widths) - 1
            return casadi.vertcat(*[TURN * casadi.fabs(signals[last]) for *_, signals in self.at])
        if goal.how == "mean":
            return casadi.vertcat(*[casadi.fabs(parts[0]) for _, parts in self.components(goal)])
        return casadi.SX(0.0)

    def _work(self, term: Term) -> Any:
        """Return the work of the drive per revolution, or in the strokes in which a slider moves one way, mean over a cycle."""
        last = sum(self.trace.widths) - 1
        way = [True] * self.strokes
        if term.stroke is not None:
            way = [forward is (term.stroke == "forward") for forward in self.forward(self.trace.event_of(term))]
        total = casadi.SX(0.0)
        for stroke, weight, signals in self.at:
            if weight is not None and way[stroke]:
                total += weight * self.trace.direction * signals[last]
        return total / self.trace.revolutions

    def _stroke(self, term: Term) -> Any:
        """Return the distance between the outermost dead centres of an output, or for the term "end" one of these positions.

        Which dead centres are outermost is decided by their positions at the start.
        """
        before = itertools.takewhile(lambda other: other is not term, self.trace.ended)
        width, *widths = (2 if self.problem.kind(each) == "angle" else 1 for each in (term, *before))
        place = len(self.trace.events) + sum(widths)
        ends, inputs = self._reversals(self.trace.event_of(term)), self.trace.inputs(self.start)
        numbers = np.array([np.ravel(self.trace.at_event([*inputs, self.structure.angles[k]])) for k in ends])
        positions = numbers[:, place]
        if width == 2:  # the direction of a body
            positions = np.unwrap([math.atan2(y, x) for x, y in numbers[:, place : place + 2]])
        low, high = ends[int(np.argmin(positions))], ends[int(np.argmax(positions))]
        if width == 1:
            if term.quantity == "end":
                return self.there[high if term.stroke == "forward" else low][place]
            return self.there[high][place] - self.there[low][place]
        (a, b), (c, d) = ((self.there[k][place], self.there[k][place + 1]) for k in (low, high))
        return casadi.atan2(a * d - b * c, a * c + b * d)

    def _ratio(self, term: Term) -> Any:
        """Return the ratio of the durations of two strokes; which one is slow is fixed in an NLP."""
        which = self.trace.event_of(term)
        forward = self._forward_slow(which) is (term.stroke != "quick") if term.by_pace else term.stroke == "forward"
        return self.duration(which, forward) / self.duration(which, not forward)

    # --- rows ------------------------------------------------------------------------------------------------------------

    def close(self) -> Iterator[WatchedTerm]:
        """Add rows that keep every group away from the position where its assembly modes meet, and yield what to monitor."""
        first, limits = sum(self.trace.widths), self.problem.limits
        for k, group in enumerate(self.trace.mechanism.groups):
            self.rows += [alignment_row(limits, group, signals[first + k]) for *_, signals in self.at]
            yield WatchedTerm(first + k, 1, False, -1.0, 1.0, None, -self.rows[-1].low)

    def limit(self, bound: Bound) -> WatchedTerm | None:
        """Add the rows of a limit; return what to monitor between the nodes, if anything."""
        term, scaled = bound.term, scaled_limit(bound, self.size)
        if not term.extreme:
            self.rows.append(scaled.row(self.figure(term)))
            return None
        for _, parts in self.components(term):
            self.rows += scaled.rows_at(parts)
        first, width = self.place(term)
        limit, sign = (scaled.above, 1.0) if bound.interval.high is not None else (-scaled.below, -1.0)
        return WatchedTerm(first, width, term.how == "peak", sign, scaled.size, None, limit, term.nature.general)

    def goal(self, goal: Goal, size: float, level: Any, index: int) -> WatchedTerm:
        """Add the rows that make `level`, component `index` of x, the largest value of a term in units of `size` [SI]."""
        for _, parts in self.components(goal):
            self.rows += rows_below_level(goal, size, level, parts)
        first, width = self.place(goal)
        sign, peak = -1.0 if goal.how == "least" else 1.0, goal.how == "peak"
        return WatchedTerm(first, width, peak, sign, size, index, math.inf, goal.nature.general)

    def levelled(self, sizes: Sequence[float]) -> list[Variable]:
        """Return the variables that are the largest values of terms, whose units [SI] are known only now."""
        found = []
        for variable, goal, size in zip(self.variables[len(self.variables) - len(sizes) :], self.epigraphs, sizes, strict=True):
            kind = self.problem.kind(goal)
            found.append(replace(variable, size=size, scale=Scale(KINDS[kind].si.replace("**", "^") if kind else "", size)))
        return found

    def heights(self, goal: Goal, size: float) -> Any:
        """Return the values at all positions whose largest is the level of a term, in units of `size` [SI]."""
        return casadi.vertcat(*[height for _, parts in self.components(goal) for height in heights_at(goal, size, parts)])
