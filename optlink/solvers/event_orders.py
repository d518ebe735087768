"""Orders of the ends of strokes: whether a design has that of its programme, and the orders beside it."""

import itertools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from optlink.optimization.courses import EVENT
from optlink.optimization.cycle_signals import EventOrder, TracedCycle
from optlink.optimization.multipliers import ACTIVE, LEAST_PRICE
from optlink.solvers.solution import Solution

STEPS = (1e-3, 1e-2)  # of the range of a design variable: from a design at the edge of its order of events to the next order
NEIGHBOURS, CROSSINGS = 4, 12  # other orders searched from one such design; designs from which orders beside are searched
FURTHER = "an output has further dead centres"


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
