"""build_cycle(...) -> CycleNLP: cycle optimisation as one scaled nonlinear programme.

Its variables are the design variables, the crank angles of the events (their equations are rows) and, for every objective term
that is a maximum over the cycle, its largest value. Rows apply at the nodes of every stroke and at exchange points.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi
import numpy as np

from optlink.linkage.vector2d import TURN, Array
from optlink.optimization.courses import EVENT
from optlink.optimization.cycle_constraints import CycleTerms, WatchedTerm
from optlink.optimization.cycle_signals import EventOrder, TracedCycle
from optlink.optimization.nlp import NLP, boxed
from optlink.optimization.objectives import Figure
from optlink.problem.design import EPIGRAPH, DesignProblem
from optlink.symbolic import CompiledFunction, symbols_in_numpy

NODES = 48  # per revolution with integral terms; half of it with maxima only
EXCHANGE_POINTS = 24  # positions that are moved to the maxima of terms, shared among the strokes ...
ROUNDING = 1e-6  # share of the signal's magnitude below which a mean or a work counts as zero
SLOTS = (4, 6)  # ... least and most per stroke


@dataclass(frozen=True)
class CycleNLP(NLP):
    """The NLP of cycle optimisation, with the `trace` and `structure` from which it was built."""

    trace: TracedCycle | None = field(default=None, compare=False)
    structure: EventOrder = field(default_factory=lambda: EventOrder((), (), ()))
    free: tuple[str, ...] = ()
    watched: tuple[WatchedTerm, ...] = ()
    slots: int = 0  # of exchange points, all strokes together
    exchanged: tuple[Any, ...] = ()  # signals there
    nodes: int = 0  # per revolution
    scales: tuple[float, tuple[float, ...]] = (1.0, ())  # units: of length [m]; of each objective term [SI]

    @property
    def traced(self) -> TracedCycle:
        """The trace from which the NLP was built."""
        assert self.trace is not None
        return self.trace

    def design(self, x: Array) -> dict[str, float]:
        """Return the design variables of the problem [SI] at x."""
        count = len(self.free)
        return {v.name: v.value(float(y)) for v, y in zip(self.variables[:count], x[:count], strict=True)}

    def x_of(self, values: Mapping[str, float], *, bounded: bool = True) -> Array:
        """Return x for values of the design variables [SI], with the corresponding events and largest values; see `NLP.x_of`."""
        count = len(self.free)
        x = self.x_start.copy()
        x[:count] = [v.scaled(values[v.name]) for v in self.variables[:count]]
        return self.lifted(np.clip(x, self.x_low, self.x_high) if bounded else x)

    def lifted(self, x: Array) -> Array:
        """Return the same design with its own events (if they match the structure) and largest values."""
        count, events = len(self.free), len(self.structure.which)
        x = x.copy()
        if events:
            structure = self.traced.structure(self.design(x))
            if structure is not None and structure.like(self.structure):
                x[count : count + events] = structure.angles
        return super().lifted(x)

    @property
    def strokes(self) -> int:
        """Number of parts into which events divide the cycle."""
        return max(1, self.traced.cuts(self.structure)) * self.traced.revolutions

    def edges(self, x: Array) -> Array:
        """Return the crank angles [rad] at which the strokes begin, followed by the end of the last one."""
        count, cuts = len(self.free), self.traced.cuts(self.structure)
        return np.array(self.traced.edges(x[count : count + cuts].tolist()))


def build_cycle(
    trace: TracedCycle,
    structure: EventOrder,
    start: Mapping[str, float],
    nodes: int = NODES,
    slots: int | None = None,
    scales: tuple[float | None, Sequence[float]] = (None, ()),
) -> CycleNLP:
    """Build the nonlinear programme of cycle optimisation.

    It is valid for designs with the events of `structure`, that of `start` [SI], in the same order; the objective at `start` is
    its scale. `nodes` are positions per revolution, half as many if no term is an integral; `slots` exchange points per stroke.
    `scales` are the unit of length [m], by default the longest length of the file, and of each objective term [SI], by default
    its value at the start.
    """
    problem = trace.problem
    exchange = min(max(EXCHANGE_POINTS // max(1, trace.cuts(structure)), SLOTS[0]), SLOTS[1]) if slots is None else slots
    integral = any(term.integral for term in trace.terms)
    with symbols_in_numpy():
        parts = CycleTerms(trace, structure, start, nodes if integral else nodes // 2, exchange, scales[0])
        x, p, events, count = parts.x, parts.p, len(structure.which), len(parts.free)
        figures = [casadi.SX(0.0) if goal.extreme else parts.figure(goal) for goal in parts.goals]
        tops = [parts.heights(goal, 1.0) if goal.extreme else figure for goal, figure in zip(parts.goals, figures, strict=True)]
        begin = np.array([start[v.name] / v.size for v in parts.variables[:count]])
        at = np.concatenate([begin, structure.angles, np.ones(len(parts.epigraphs))])
        shares = np.tile(np.linspace(0.0, 1.0, exchange), parts.strokes)
        p_start = np.concatenate([[1.0], parts.x_fixed, shares])
        courses = parts.mapped(casadi.SX(0.0)).expanded([*tops, *(parts.natural(goal) for goal in parts.goals)])
        largest = [float(np.max(value)) for value in CompiledFunction([x, p], courses)(at, p_start)]
        maxima, naturals = largest[: len(tops)], largest[len(tops) :]
        sizes = list(scales[1]) or [
            (abs(value) if abs(value) > ROUNDING * natural else natural) or scale or 1.0
            for scale, value, natural in zip(problem.scales, maxima, naturals, strict=True)
        ]
        extremes = [each for each in zip(parts.goals, maxima, sizes, strict=True) if each[0].extreme]
        worths = [
            goal.weight * size / (scale or 1.0) for goal, scale, size in zip(parts.goals, problem.scales, sizes, strict=True)
        ]
        worth = math.fsum(worths)
        watched: list[WatchedTerm | None] = []
        f, k = casadi.SX(0.0), 0
        for goal, size, own, figure in zip(parts.goals, sizes, worths, figures, strict=True):
            if goal.extreme:
                watched.append(parts.goal(goal, size, parts.levels[k], count + events + k))
                f += own / worth * parts.levels[k]
                k += 1
            else:
                f += own / worth * (-1.0 if goal.sense == "maximise" else 1.0) * figure / size
        heights = [parts.heights(goal, size) for goal, _, size in extremes]
        watched += [parts.limit(bound) for bound in problem.bounds]
        watched += parts.close()
        mapped = parts.mapped(f / p[0])
        scaled, residual, g, *others = mapped.expanded([mapped.f, f, mapped.g, *heights, *parts.exchanged])
    at[count + events :] = [value / size for _, value, size in extremes]
    box = [boxed(problem.quantities[v.name], v)[:2] for v in parts.variables[:count]]
    box += [(-2.0 * TURN, 2.0 * TURN)] * events
    box += [(0.0 if goal.how == "peak" else -math.inf, math.inf) for goal in parts.epigraphs]
    x_low, x_high = np.array(box).reshape(-1, 2).T.copy()
    helpers = {EPIGRAPH, EVENT, *(v.name for v in parts.variables[count:])}
    levels = parts.levelled([size for *_, size in extremes])
    return CycleNLP(
        variables=(*parts.variables[: count + events], *levels),
        fixed=parts.fixed,
        rows=tuple(replace(row, value=g[k]) for k, row in enumerate(parts.rows)),
        measure=Figure("figure", problem.objective_unit),
        factor=worth,
        x_start=at,
        x_low=x_low,
        x_high=x_high,
        p=p_start,
        x_symbol=x,
        p_symbol=p,
        f_expression=scaled,
        g_expression=g,
        residual_expression=residual * worth,
        exact=0.0,
        constants=tuple(parts.constants),
        helpers=frozenset(helpers),
        states=frozenset({EVENT, *(v.name for v in parts.variables[count : count + events])}),
        cycle=True,
        mapped=mapped,
        trace=trace,
        structure=structure,
        free=parts.free,
        watched=tuple(item for item in watched if item is not None),
        level_symbols=tuple(others[: len(heights)]),
        first_level=count + events,
        slots=parts.slots,
        exchanged=tuple(others[len(heights) :]),
        nodes=nodes,
        scales=(parts.size, tuple(sizes)),
        recipe={
            "builder": "cycle",
            "values": None if trace.values is None else dict(trace.values),
            "loads": None if trace.slow is None else dict(trace.slow),
            "structure": vars(structure),
            "start": dict(start),
            "nodes": nodes,
            "slots": slots,
            "scales": scales,
        },
    )


def build_cycle_again(problem: DesignProblem, recipe: Mapping[str, Any]) -> CycleNLP:
    """Return the programme that `build_cycle` has built from the parts in its `recipe`."""
    order = {name: tuple(items) for name, items in recipe["structure"].items()}
    trace = TracedCycle(problem, recipe["values"], recipe["loads"])
    size, sizes = recipe["scales"]
    return build_cycle(trace, EventOrder(**order), recipe["start"], recipe["nodes"], recipe["slots"], (size, tuple(sizes)))
