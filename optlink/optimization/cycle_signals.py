"""Functions of a machine at one crank angle, traced once: signals of the terms, margins, events; and the structure of a cycle.

The formulas are those of `linkage` and `dynamics`. Forces jump where a motion reverses, so the revolution is divided there: the
crank angles of these events are unknowns of the NLP, and within a stroke everything is smooth in the design variables.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi
import numpy as np

from optlink.dynamics.inverse import Reactions, depends_on_sense, reactions, required_wrench
from optlink.dynamics.machine import Load, Machine, Moving
from optlink.linkage.elements import Element
from optlink.linkage.extrema import sign_changes, zeros
from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.motion import Motion
from optlink.linkage.stroke import Direction, slow_stroke
from optlink.linkage.vector2d import TURN, Array, Value, dot, sign, unit, whole_turns
from optlink.problem.design import DesignProblem
from optlink.problem.machine.loads import LoadTable
from optlink.problem.terms import Term, guide_of, output_of
from optlink.symbolic import CompiledFunction, NumpyEvaluator, symbols_in_numpy

GRID = 240  # crank angles among which events are bracketed
TOUCHING = 1e-2  # rad between two reversals of a motion that only comes to rest
CORNER, LAW = "corner", "law"
SAME_ANGLE = 1e-6  # rad between two events that are at one position, whose order is that of their numbers
PROBES = 3  # positions of two laws at which they pass a knot together if they always do
AHEAD = 1e-6  # rad beyond an event at which its sense (rising or falling) is determined


class _MovingWithSenses(Moving):
    """A machine in motion with symbols for the senses of motion in place of the signs of velocities.

    `requested` collects pairs of a velocity function and its symbol.
    """

    def __init__(self, machine: Machine, motion: Motion, direction: float) -> None:
        super().__init__(machine, motion, 1, direction)
        self.requested: list[tuple[Callable[[Moving], tuple[Value, Value]], Any]] = []

    def sense(self, of: Callable[[Moving], tuple[Value, Value]], size: Value = 1.0) -> Value:
        """Return a symbol for the sense of a motion, substituted later."""
        symbol = casadi.SX.sym(f"sense {len(self.requested)}")
        self.requested.append((of, symbol))
        return symbol


@dataclass(frozen=True)
class StrokeEnd:
    """A function whose sign changes at the end of a stroke: a velocity, or the distance from a corner of a load's table.

    `cuts`: whether forces or integrands jump there, so that the revolution is divided.
    """

    key: tuple[str, ...]
    value: Callable[[Moving], Value]
    cuts: bool

    @property
    def of_law(self) -> bool:
        """Whether it is the knot of a law."""
        return self.key[:2] == (CORNER, LAW)

    def unit(self, length: float, speed: float) -> float:
        """Return the unit of the function [SI] from those of lengths and of the crank speed: a velocity, unless of a corner."""
        return (1.0 if self.key[0] == "body" else length) * (1.0 if self.key[0] == CORNER else speed)


@dataclass(frozen=True)
class EventOrder:
    """The events of a revolution, or of the range of the drive: index of each, whether it rises, crank angle [rad].

    Dividing events come first, in a revolution from a rise of the first of them; the others follow for each output, as they may
    coincide.
    """

    which: tuple[int, ...]
    rising: tuple[bool, ...]
    angles: tuple[float, ...]
    slow: tuple[bool | None, ...] = ()
    """For every event of `Trace.paced`: whether the forward stroke is the slow one; None where both take equally long."""

    def like(self, other: EventOrder) -> bool:
        """Return whether the same events occur in the same order."""
        return (self.which, self.rising) == (other.which, other.rising)

    @property
    def definite(self) -> EventOrder:
        """The same order; of strokes that take equally long the forward one counts as the slow one."""
        return replace(self, slow=tuple(slow is not False for slow in self.slow))

    @property
    def key(self) -> tuple[tuple[Any, ...], ...]:
        """What distinguishes programmes: order and slow strokes."""
        return self.which, self.rising, self.slow


@dataclass(frozen=True)
class Sample:
    """A design [SI] with the number of its events of each kind; the events themselves are computed when they are needed."""

    values: Mapping[str, float]
    counts: tuple[int, ...]
    events: Callable[[], EventOrder] | None

    @cached_property
    def structure(self) -> EventOrder | None:
        """The events; None if the crank cannot rotate fully, or move through its range."""
        return None if self.events is None else self.events()

    def may_be_like(self, other: EventOrder) -> bool:
        """Return False if this design cannot have the events of another one in the same order."""
        return self.events is not None and all(count == other.which.count(k) for k, count in enumerate(self.counts))


def _reversal(load: Load, moving: Moving) -> Value:
    """Return the velocity at whose reversal a load jumps."""
    return (load.reversing(moving) or (0.0, 0.0))[0]


def _knot(element: Element, at: float, moving: Moving) -> Value:
    """Return a function that vanishes where the law of an element passes a knot: half a turn in a period of the law."""
    x, _, period = element.knots(moving.pose)
    return np.sin((as_jet(x).value - at) * (math.pi / period))


def _corner(guide: str, at: float, moving: Moving) -> Value:
    """Return the distance of a slider beyond a row of its load's table."""
    return moving.slides[guide][0] - at


class TracedCycle:
    """The traced functions of one problem.

    Quantities `values` [SI] determine which stroke is the slow one; or `slow` states the slow stroke of loads of the slow or
    quick stroke, for a crank that turns counter-clockwise.

    Raises
    ------
    Unusable
        when no machine can be built with these values, with the full key of the cause.
    """

    def __init__(
        self,
        problem: DesignProblem,
        values: Mapping[str, float] | None = None,
        slow: Mapping[str, Direction] | None = None,
    ) -> None:
        self.problem, self.mechanism, self.values = problem, problem.linkage, values
        self.speed = problem.driving.pace
        self.limited = self.mechanism.limits is not None
        self.low, self.high = self.mechanism.limits or (0.0, self.mechanism.cycle)
        self.direction = -1.0 if self.speed < 0.0 else 1.0
        self.names = list(problem.quantities)
        self.terms: tuple[Term, ...] = (*problem.goals, *(bound.term for bound in problem.bounds))
        self.cyclic = [term for term in self.terms if term.nature.cyclic]
        self.ended = [term for term in self.terms if term.quantity in ("stroke", "end")]  # computed at the ends of strokes
        self.works = any(term.quantity == "work" for term in self.terms)
        self.base, self.slow = self._relevant(problem.machine(values, slow)), slow
        self.repeats = 1 if self.limited else round(self.base.cycle / self.high)
        self.events = self._events()
        inputs = casadi.SX.sym("inputs", len(self.names) + 1)
        with symbols_in_numpy():
            moving = self._moving(inputs)
            margins = [as_jet(group.alignment(moving.pose)).value - group.least for group in self.mechanism.groups]
            ends = [part for term in self.ended for part in self._output(term, moving)]
            event_values = [event.value(moving) for event in self.events]
        self.at_event = casadi.Function("event", [inputs], [casadi.vertcat(*event_values, *ends)])
        self._inputs, self._machine, self._found, self._margins = inputs, moving, event_values, margins

    def with_slow(self, structure: EventOrder) -> TracedCycle:
        """Return the trace in which loads of the slow or quick stroke act as the slow strokes of an order of events require."""
        slow = self.slow_loads(structure.slow) if structure.slow else None
        return self if not slow or slow == self.slow else TracedCycle(self.problem, self.values, slow)

    @property
    def assumed(self) -> EventOrder:
        """An order of events for designs of which none is known: every motion goes to and fro once, one after the other.

        Within a range there are none.
        """
        if self.limited:
            return EventOrder((), (), ())
        cutting = sorted(range(len(self.events)), key=lambda k: not self.events[k].cuts)
        half = 0.5 * self.high
        angles = [half * k / max(1, len(cutting)) for k in range(len(cutting))]
        every = [
            (k, at if up else at + half, up)
            for up in (True, False)
            for k, at in zip(cutting, angles, strict=True)
            if up or not self.events[k].of_law  # a law passes each of its knots once
        ]
        every.sort(key=lambda event: (not self.events[event[0]].cuts, event[1] if self.events[event[0]].cuts else event[0]))
        which, places, rising = zip(*every, strict=True) if every else ((), (), ())
        return EventOrder(which, rising, places, (True,) * len(self.paced))

    def _relevant(self, machine: Machine) -> Machine:
        """Return the machine, without its loads if no term depends on forces: their switches would only divide the search."""
        forced = self.works or any(term.nature.forces for term in self.cyclic)
        return machine if forced else replace(machine, loads=())

    def __reduce__(self) -> tuple[Any, ...]:
        return TracedCycle, (self.problem, self.values, self.slow)

    # --- the machine in symbols ------------------------------------------------------------------------------------------

    def _moving(self, inputs: Any, way: float = 1.0) -> _MovingWithSenses:
        """Return the machine in motion; with -1 for the `way`, on the way back through the range."""
        sizes = {name: inputs[i] for i, name in enumerate(self.names)}
        machine = self.base.with_(sizes=sizes, inertias=self.problem.inertias(sizes))
        phi, speed = inputs[len(self.names)], way * self.speed
        still = {name: Jet(size) for name, size in sizes.items()}  # casadi operators reject jets: use jets throughout
        pose = self.mechanism.at(still, Jet(phi, speed, 0.0))
        return _MovingWithSenses(machine, Motion(self.mechanism, sizes, phi, speed, pose, 0.0), way * self.direction)

    @cached_property
    def _both_ways(self) -> list[Term]:
        """Terms that also count on the way back through a range: extremes of forces that differ there."""
        terms = [term for term in self.cyclic if self.mechanism.returns and term.nature.forces and term.extreme]
        differs = bool(terms) and depends_on_sense(self.base, self.low, self.high, self.speed)
        return [term for term in terms if differs or term.nature.kind == "power"]

    def _signals(self, moving: Moving, terms: Sequence[Term]) -> list[tuple[Value, ...]]:
        """Return the components of cyclic terms, followed by the driving torque if work is required."""
        signals = {term.quantity: term.nature.signal for term in terms}
        forced = [term for term in terms if term.nature.forces]
        # friction, with which reactions cannot be traced, does not affect the motion
        whole = reactions(moving) if forced or self.works else Reactions(0.0, {}, {}, {})
        still = reactions(moving, required_wrench(moving, inertia=False)) if any(t.static for t in forced) else whole
        values = [signal(moving, still if t.static else whole, t) for t in terms if (signal := signals[t.quantity])]
        return [*values, (whole.torque,)] if self.works else values

    def _output(self, term: Term, moving: Moving) -> tuple[Value, ...]:
        """Return the position of an output: slide, coordinate of a point, or direction of a body."""
        kind, name = output_of(term, self.mechanism)
        if kind == "guide":
            return (moving.slides[name][0],)
        if kind == "body":
            return moving.state(name).axis
        assert term.direction is not None
        return (dot(unit(term.direction.value), moving.position(name)),)

    @cached_property
    def _traced(self) -> tuple[list[int], Any, Any, Any]:
        """Numbers of components, signals and margins, symbols for the senses, and these senses; events need no forces."""
        inputs, machines = self._inputs, [self._machine]
        with symbols_in_numpy():
            signals = self._signals(self._machine, self.cyclic)
            if self._both_ways:
                machines.append(self._moving(inputs, -1.0))
                for term, parts in zip(self._both_ways, self._signals(machines[1], self._both_ways), strict=False):
                    signals[next(k for k, other in enumerate(self.cyclic) if other is term)] += parts
            requested = [(moving, *one) for moving in machines for one in moving.requested]
            senses = [moving.direction * sign(of(moving)[0] / moving.motion.speed) for moving, of, _ in requested]
        outputs = casadi.vertcat(*[part for signal in signals for part in signal], *self._margins)
        symbols = casadi.vertcat(*[symbol for *_, symbol in requested])
        return (
            [len(signal) for signal in signals],
            outputs,
            symbols,
            casadi.Function("sensed", [inputs], [casadi.vertcat(*senses)]),
        )

    @property
    def widths(self) -> list[int]:
        """Number of components of each signal."""
        return self._traced[0]

    @cached_property
    def at(self) -> Any:
        """(quantities and crank angle, senses) -> signals, then margins."""
        _, outputs, symbols, _ = self._traced
        return casadi.Function("at", [self._inputs, symbols], [outputs])

    @property
    def sensed(self) -> Any:
        """(quantities and crank angle) -> senses of motion."""
        return self._traced[3]

    # --- events ----------------------------------------------------------------------------------------------------------

    def cuts(self, structure: EventOrder) -> int:
        """Return the number of events that divide the revolution; they come first."""
        return sum(self.events[which].cuts for which in structure.which)

    def edges(self, begins: Sequence[Any]) -> list[Any]:
        """Return the crank angles [rad] that divide a cycle, and its end, from those of the cuts in its first period.

        Those of the other periods of a longer cycle of the loads follow. There are none where nothing divides a period. A range
        begins at its lower end.
        """
        if self.limited:
            return [self.low, *begins, self.high]
        begins = list(begins) or [0.0]
        return [*(begin + k * self.high for k in range(self.repeats) for begin in begins), begins[0] + self.repeats * self.high]

    def event_of(self, term: Term) -> int:
        """Return the index of the event that ends the strokes of a term's output."""
        return [event.key for event in self.events].index(self._key(term))

    @cached_property
    def paced_loads(self) -> dict[str, int]:
        """Loads of the slow or quick stroke, with the index of the event that ends their strokes."""
        keys = [event.key for event in self.events]
        guides = {load.name: ("guide", load.guide) for load in self.base.processes}
        return {
            name: keys.index(guides[name] if guides[name] in keys else ("load", name))
            for name, section in self.problem.loads.items()
            if section.by_pace and name in guides
        }

    @cached_property
    def paced(self) -> tuple[int, ...]:
        """Events of the motions whose slow stroke matters: of loads, and of time ratios, of the slow or quick stroke."""
        terms = [self.event_of(term) for term in self.terms if term.by_pace]
        return tuple(dict.fromkeys([*self.paced_loads.values(), *terms]))

    def slow_loads(self, slow: Sequence[bool | None]) -> dict[str, Direction]:
        """Return the slow stroke of loads for a crank that turns counter-clockwise, from `slow` for every event of `paced`."""
        forward = dict(zip(self.paced, slow, strict=True))
        same = self.direction > 0.0
        return {
            name: "forward" if (forward[which] is not False) is same else "backward" for name, which in self.paced_loads.items()
        }

    def _key(self, term: Term) -> tuple[str, ...]:
        if term.quantity == "work":
            return "guide", str(guide_of(str(term.of), self.mechanism))
        kind, name = output_of(term, self.mechanism)
        return (kind, name, repr(term.direction.value)) if term.direction is not None else (kind, name)

    def _events(self) -> list[StrokeEnd]:
        events: dict[tuple[str, ...], StrokeEnd] = {}

        def add(key: tuple[str, ...], value: Callable[[Moving], Value], *, cuts: bool = True) -> None:
            cuts = cuts or (key in events and events[key].cuts)
            events[key] = StrokeEnd(key, value, cuts)

        for load in self.base.loads:
            if load.switching:
                guide = getattr(load, "guide", "")
                add(("guide", guide) if guide else ("load", load.name), functools.partial(_reversal, load))
        for load in self.base.processes:
            if isinstance(load.magnitude, LoadTable) and load.magnitude.over == "s":
                for row, at in enumerate(load.magnitude.at):
                    add((CORNER, load.name, str(row)), functools.partial(_corner, load.guide, at))
        for number, (element, at) in enumerate(self._knots()):
            add((CORNER, LAW, str(number)), functools.partial(_knot, element, at))
        for term in self.terms:
            if term.ended:
                add(self._key(term), functools.partial(self._rate, term), cuts=term.quantity == "work")
        return list(events.values())

    def _knots(self) -> list[tuple[Element, float]]:
        """Return the elements with a law and its knots, each once: where a law passes from one piece to the next.

        They move with the design variables, as the phase of a cam. Laws that always pass two knots together do so at any probe.
        """
        rng, found = np.random.default_rng(0), dict[tuple[float, ...], tuple[Element, float]]()
        sizes = {name: value * rng.uniform(0.99, 1.01) for name, value in self.base.sizes.items()}
        pose = self.mechanism.at(sizes, rng.uniform(self.low, self.high, PROBES))
        for element in self.mechanism.elements:
            x, knots, period = element.knots(pose)
            for at in knots:
                share = np.broadcast_to((x - at) / period, PROBES)
                found.setdefault(tuple(np.round(share - np.round(share), 9).tolist()), (element, at))
        return list(found.values())

    @property
    def divided_by_laws(self) -> bool:
        """Whether knots of laws divide the cycle, beside which alone a quantity has the values of its piece."""
        return any(event.of_law for event in self.events)

    def _rate(self, term: Term, moving: Moving) -> Value:
        """Return the velocity of an output."""
        kind, name = self._key(term)[:2]
        if kind == "guide":
            return moving.slides[name][1]
        if kind == "body":
            return moving.state(name).omega
        return dot(unit(0.0 if term.direction is None else term.direction.value), moving.velocity(name))

    # --- numbers ---------------------------------------------------------------------------------------------------------

    @cached_property
    def _watch(self) -> NumpyEvaluator:
        """Margins, then events, as functions of (quantities, crank angle)."""
        outputs = [*self._margins, *self._found] or [casadi.SX(1, 1)]
        return NumpyEvaluator([self._inputs], outputs)

    @cached_property
    def signals(self) -> NumpyEvaluator:
        """Signals, then margins, as functions of (quantities, crank angle, senses)."""
        _, outputs, symbols, _ = self._traced
        return NumpyEvaluator([casadi.vertcat(self._inputs, symbols)], [outputs])

    def inputs(self, values: Mapping[str, float]) -> list[float]:
        """Return the quantities in the order of the inputs; values of the file for missing ones."""
        sizes = self.problem.complete(values)
        return [sizes[name] for name in self.names]

    @cached_property
    def _event_rates(self) -> CompiledFunction:
        """Events and their derivatives by the crank angle, at one crank angle."""
        events = casadi.vertcat(*self._found)
        return CompiledFunction([self._inputs], [events, casadi.jacobian(events, self._inputs[-1])])

    def serves(self, values: Mapping[str, float]) -> bool:
        """Return whether the loads of the trace are those of a design: none counts the angle of a swing from another turn.

        They also differ where the middle of a swing has moved by more than a quarter of a turn, beyond which a search could come
        upon the angle that is opposite to the middle in the trace.
        """
        relevant = self._relevant(self.problem.machine(values, self.slow))
        middles = np.array([[load.middle for load in machine.loads] for machine in (self.base, relevant)])
        moved = middles[0] - middles[1]
        whole = self.high if self.limited else relevant.cycle
        count = GRID * whole_turns(whole)
        moving = relevant.moving(np.linspace(self.low, whole, count, endpoint=self.limited), self.speed)
        return all(
            abs(moved[k]) <= 0.25 * TURN and np.allclose(before.torque, after.torque, rtol=1e-9)
            for k in np.flatnonzero(moved)
            for before, after in zip(self.base.loads[k].act(moving), relevant.loads[k].act(moving), strict=True)
        )

    def structure(self, values: Mapping[str, float]) -> EventOrder | None:
        """Return the events of a design; None if the crank cannot rotate fully, or move through its range."""
        return next(self.samples([values])).structure

    def strokeless(self, structure: EventOrder) -> tuple[str, Term, int] | None:
        """Return a stroke term whose output has too few dead centres, with its key and their number.

        A time ratio requires exactly two. In a range every output has a stroke, from one end or dead centre to another one.
        """
        if self.limited:
            return None
        placed: list[tuple[str, Term]] = [("objective", goal) for goal in self.problem.goals]
        for key, term in [*placed, *((bound.key, bound.term) for bound in self.problem.bounds)]:
            if term.ended:
                count = structure.which.count(self.event_of(term))
                if count < 2 or (term.quantity not in ("stroke", "end") and count != 2):
                    return key, term, count
        return None

    def reversals(self, structure: EventOrder) -> Counter[tuple[int, bool]]:
        """Return the number of reversals of every motion in either sense, without those that are as good as one position."""
        numbers = Counter[tuple[int, bool]]()
        events = list(zip(structure.which, structure.angles, structure.rising, strict=True))
        if self.limited:
            return Counter((which, up) for which, _, up in events if self.events[which].key[0] != CORNER)
        for k in (k for k, event in enumerate(self.events) if event.key[0] != CORNER):
            places = sorted((angle % self.high, up) for which, angle, up in events if which == k)
            numbers.update((k, up) for _, up in places)
            for (angle, up), (after, up_after) in itertools.pairwise([*places, *places[:1]]):
                if up != up_after and (after - angle) % self.high < TOUCHING:
                    numbers.subtract([(k, True), (k, False)])
        return +numbers

    def samples(self, designs: Sequence[Mapping[str, float]]) -> Iterator[Sample]:
        """Yield each design with what is needed to compute its events."""
        inputs = np.array([self.inputs(values) for values in designs])
        count = GRID * whole_turns(self.high - self.low)
        grid = np.linspace(self.low, self.high, count + 1) + (0.0 if self.limited else 0.37 * TURN / GRID)
        inside = slice(None)
        if self.limited:  # a motion may come to rest, and a law begin, at an end of the range
            grid[[1, -2]], inside = (self.low + TOUCHING, self.high - TOUCHING), slice(1, -1)
        there = self._watch(*inputs.T[..., None], grid)
        groups = len(self.mechanism.groups)
        rotates = np.all(np.isfinite(there), axis=(0, 2)) & np.all(there[:groups] >= 0.0, axis=(0, 2))
        counts = np.count_nonzero(sign_changes(there[groups : groups + len(self.events), :, inside], still=True)[0], axis=-1).T
        for k, values in enumerate(designs):
            structure = functools.partial(self._structure, inputs[k], grid, there[:, k]) if rotates[k] else None
            yield Sample(values, tuple(counts[k].tolist()), structure)

    def _structure(self, inputs: Array, grid: Array, there: Array) -> EventOrder:
        """Return the events of a design from its margins and event functions on a grid of crank angles."""
        groups = len(self.mechanism.groups)
        if not self.events:
            return EventOrder((), (), ())

        def values_at(angles: Array) -> Array:
            return self._watch(*inputs, angles)[groups:]

        def slope(k: int, angle: float) -> tuple[float, float]:
            value, rate = self._event_rates(np.append(inputs, angle))
            return float(value[k]), float(rate[k])

        cutting: list[tuple[float, int, bool]] = []
        every: dict[int, list[tuple[float, int, bool]]] = {}
        separate: list[tuple[float, int, bool]] = []
        for k, places in enumerate(zeros(values_at, grid, still=True, slope=slope, samples=there[groups:])):
            if self.limited:
                places = places[(places > self.low + TOUCHING) & (places < self.high - TOUCHING)]
            of_law = self.events[k].of_law  # the function of a knot rises and falls in turn, for the same event
            rises = [of_law or slope(k, at + AHEAD)[0] > 0.0 for at in places.tolist()]
            begins = places if self.limited else (places + SAME_ANGLE) % self.high - SAME_ANGLE
            events = [(float(at), k, bool(up)) for at, up in zip(begins, rises, strict=True)]
            every[k] = events
            if self.events[k].cuts:
                cutting += events
            else:
                separate += self._ordered(events)
        ordered = [*self._ordered(cutting), *separate]
        slow = tuple(_forward_slow(every[k], self.high) for k in self.paced)
        return EventOrder(tuple(k for _, k, _ in ordered), tuple(up for *_, up in ordered), tuple(at for at, *_ in ordered), slow)

    def _ordered(self, events: list[tuple[float, int, bool]]) -> list[tuple[float, int, bool]]:
        """Sort events (angle, which, rising) within a range; or a period, starting at the first rise of the first of them."""
        if not events:
            return []
        events = sorted(events)
        groups = itertools.accumulate(b[0] - a[0] > SAME_ANGLE for a, b in zip([events[0], *events], events, strict=False))
        events = [event for _, event in sorted(zip(groups, events, strict=True), key=lambda pair: (pair[0], pair[1][1]))]
        if self.limited:
            return events
        first = min(range(len(events)), key=lambda i: (events[i][1], not events[i][2], events[i][0]))
        return [*events[first:], *((at + self.high, k, up) for at, k, up in events[:first])]


def _forward_slow(events: list[tuple[float, int, bool]], period: float) -> bool | None:
    """Return whether the forward stroke between reversals (angle, which, rising) is slow; None if undetermined."""
    if len(events) < 2:
        return None
    events = sorted(events)
    ends = [*(at for at, *_ in events[1:]), events[0][0] + period]
    forward = sum(end - at for (at, _, up), end in zip(events, ends, strict=True) if up)
    slow = slow_stroke(forward, period - forward)
    return None if slow is None else slow == "forward"
