"""build_cycle(problem) -> CycleNLP: the design of a machine by its cycle as one scaled nonlinear programme.

Its variables are the free sizes, the crank angles at which motions reverse (their equations are rows) and, for every term of the
objective that is the largest over the cycle, that largest value. Rows hold at the nodes of every stroke and at roaming positions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.optimization.cycle_constraints import EVENT, Parts, Watched
from optlink.optimization.cycle_signals import TURN, Structure, Trace
from optlink.optimization.nlp import NLP
from optlink.optimization.objectives import Measure
from optlink.problem.function import EPIGRAPH
from optlink.symbolic import Compiled, tracing
from optlink.units import KINDS

Array = NDArray[np.float64]

NODES = 48  # per revolution, where a figure is an integral; half of it where only largest values are asked for
ROAMING = 24  # positions that are moved to where a term is largest, shared among the strokes ...
ROUNDING = 1e-6  # of the size of its course, below which a mean or a work is taken for zero
SLOTS = (4, 6)  # ... which get so many each, least and most


@dataclass(frozen=True)
class Figure(Measure):
    """An objective that is one figure, `worth` times what the programme minimises."""

    worth: float = 1.0

    def sizes(self, residuals: ArrayLike) -> Array:
        """The figure itself."""
        return np.asarray(np.abs(np.asarray(residuals, dtype=float)), dtype=float)

    def of(self, residuals: ArrayLike) -> float:
        """The figure."""
        return float(np.asarray(residuals, dtype=float).ravel()[0])

    def slope(self, residuals: ArrayLike) -> float:
        """Change of the figure per change of what the programme minimises."""
        return self.worth


@dataclass(frozen=True)
class CycleNLP(NLP):
    """The programme of a machine's cycle. `trace` and `structure` are what it was built from."""

    trace: Trace | None = field(default=None, compare=False)
    structure: Structure = field(default_factory=lambda: Structure((), (), ()))
    free: tuple[str, ...] = ()
    watched: tuple[Watched, ...] = ()
    level_symbols: Any = None
    slots: int = 0  # of roaming positions, all strokes together
    roamed: tuple[Any, ...] = ()  # signals there
    nodes: int = 0  # per revolution
    scales: tuple[float, tuple[float, ...]] = (1.0, ())  # what counts as one: length [m]; each term of the objective [SI]

    @cached_property
    def _levels(self) -> Compiled:
        return Compiled([self.x_symbol, self.p_symbol], list(self.level_symbols))

    @property
    def traced(self) -> Trace:
        """The functions that it was built from."""
        assert self.trace is not None
        return self.trace

    def design(self, x: Array) -> dict[str, float]:
        """Free quantities of the problem [SI] at x."""
        count = len(self.free)
        return {v.name: v.origin + float(y) * v.size for v, y in zip(self.variables[:count], x[:count], strict=True)}

    def x_of(self, values: Mapping[str, float]) -> Array:
        """x of the given free quantities [SI], with the events and largest values that belong to them."""
        count = len(self.free)
        x = self.x_start.copy()
        x[:count] = [(values[v.name] - v.origin) / v.size for v in self.variables[:count]]
        return self.lifted(np.clip(x, self.x_low, self.x_high))

    def lifted(self, x: Array) -> Array:
        """The same sizes with their own events (where they are those of this programme) and largest values."""
        count, events = len(self.free), len(self.structure.which)
        x = x.copy()
        if events:
            found = self.traced.structure(self.design(x))
            if found is not None and found.like(self.structure):
                x[count : count + events] = found.angles
        if self.level_symbols:
            for k, values in enumerate(self._levels(x, self.p)):
                largest = float(np.max(values))
                x[count + events + k] = largest if math.isfinite(largest) else 1.0
        return x

    @property
    def strokes(self) -> int:
        """Number of parts that the revolution is cut into."""
        return max(1, self.traced.cuts(self.structure))

    def edges(self, x: Array) -> Array:
        """Crank angles [rad] at which the strokes begin, and last where the last one ends."""
        count, cuts = len(self.free), self.traced.cuts(self.structure)
        if not cuts:
            return np.array([0.0, TURN])
        begin = x[count : count + cuts]
        return np.append(begin, begin[0] + TURN)


def build_cycle(
    trace: Trace,
    structure: Structure,
    start: Mapping[str, float],
    nodes: int = NODES,
    slots: int | None = None,
    scales: tuple[float | None, Sequence[float]] = (None, ()),
) -> CycleNLP:
    """Trace a problem into a nonlinear programme.

    Parameters
    ----------
    trace : Trace
    structure : Structure
        The events at `start`; a programme holds for designs with the same events in the same order.
    start : mapping of free quantity to float [SI]
        Where the search begins; its figures are the scale of the objective.
    nodes : int
        Positions per revolution.
    slots : int, optional
        Roaming positions per stroke.
    scales : length [m] and a number [SI] for each term of the objective, optional
        What counts as one: the longest length of the file; what the file says of the term, else its figure at the start.
    """
    problem = trace.problem
    roaming = min(max(ROAMING // max(1, trace.cuts(structure)), SLOTS[0]), SLOTS[1]) if slots is None else slots
    integral = any(term.integral for term in trace.terms)
    with tracing():
        parts = Parts(trace, structure, start, nodes if integral else nodes // 2, roaming, scales[0])
        x, p, events, count = parts.x, parts.p, len(structure.which), len(parts.free)
        figures = [casadi.SX(0.0) if goal.extreme else parts.figure(goal) for goal in parts.goals]
        tops = [parts.heights(goal, 1.0) if goal.extreme else figure for goal, figure in zip(parts.goals, figures, strict=True)]
        begin = np.array([start[v.name] / v.size for v in parts.variables[:count]])
        at = np.concatenate([begin, structure.angles, np.ones(len(parts.epigraphs))])
        shares = np.tile(np.linspace(0.0, 1.0, roaming), parts.strokes)
        p_start = np.concatenate([[1.0], parts.x_fixed, shares])
        found = [float(np.max(value)) for value in Compiled([x, p], tops)(at, p_start)]
        courses = Compiled([x, p], [parts.natural(goal) for goal in parts.goals])
        naturals = [float(np.max(value)) for value in courses(at, p_start)]
        sizes = list(scales[1]) or [
            scale or (abs(value) if abs(value) > ROUNDING * natural else natural) or 1.0
            for scale, value, natural in zip(problem.scales, found, naturals, strict=True)
        ]
        watched: list[Watched | None] = []
        f, k = casadi.SX(0.0), 0
        for goal, size, figure in zip(parts.goals, sizes, figures, strict=True):
            if goal.extreme:
                watched.append(parts.goal(goal, size, parts.levels[k], count + events + k))
                f += goal.weight * parts.levels[k]
                k += 1
            else:
                f += goal.weight * (-1.0 if goal.sense == "maximise" else 1.0) * figure / size
        heights = [parts.heights(goal, size) for goal, size in zip(parts.goals, sizes, strict=True) if goal.extreme]
        watched += [parts.limit(bound) for bound in problem.bounds]
        watched += parts.close()
    worth = sizes[0] if problem.single else 1.0
    at[count + events :] = [value / size for goal, value, size in zip(parts.goals, found, sizes, strict=True) if goal.extreme]
    bounds = [problem.quantities[name].bounds for name in parts.free]
    room = [(-2.0 * TURN, 2.0 * TURN)] * events
    floors = [0.0 if goal.how == "peak" else -math.inf for goal in parts.epigraphs]
    kind = problem.unit_kind
    helpers = {EPIGRAPH, EVENT, *(v.name for v in parts.variables[count:])}
    return CycleNLP(
        variables=tuple(parts.variables),
        fixed=parts.fixed,
        rows=tuple(parts.rows),
        measure=Figure("figure", KINDS[kind].si if kind else "", 1, worth),
        x_start=at,
        x_low=np.array(
            [*(low / v.size for (low, _), v in zip(bounds, parts.variables, strict=False)), *(a for a, _ in room), *floors]
        ),
        x_high=np.array(
            [
                *(high / v.size for (_, high), v in zip(bounds, parts.variables, strict=False)),
                *(b for _, b in room),
                *[math.inf] * k,
            ]
        ),
        p=p_start,
        x_symbol=x,
        p_symbol=p,
        f_expression=f / p[0],
        g_expression=casadi.vertcat(*[row.value for row in parts.rows]),
        residual_expression=f * worth,
        exact=0.0,
        constants=tuple(parts.constants),
        helpers=frozenset(helpers),
        states=frozenset({EVENT, *(v.name for v in parts.variables[count : count + events])}),
        trace=trace,
        structure=structure,
        free=parts.free,
        watched=tuple(item for item in watched if item is not None),
        level_symbols=tuple(heights),
        slots=parts.slots,
        roamed=tuple(parts.roamed),
        nodes=nodes,
        scales=(parts.size, tuple(sizes)),
    )
