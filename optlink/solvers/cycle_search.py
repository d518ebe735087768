"""The search for a machine by its cycle: where it begins, one search per order of events, and why nothing was found."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optlink.design.cycle import CycleProblem
from optlink.design.cycle_nlp import CycleNLP, build_cycle
from optlink.design.cycle_trace import Structure, Trace
from optlink.design.problem import EPIGRAPH
from optlink.errors import Status
from optlink.solvers import search
from optlink.solvers.conflict import Explanation, Relaxation, explain
from optlink.solvers.levels import held, level, peaks
from optlink.solvers.solution import Solution

Array = NDArray[np.float64]

SAMPLES = 64  # per start: random sizes, of which only those are searched from that move as the given machine does
COARSE, TRIED = 24, 2  # positions per revolution, and starts, where a conflict is looked for
FOLLOWED = 4  # optima of a search whose peaks are followed, where they promise more than the best that is levelled


@dataclass(frozen=True)
class Begin:
    """Sizes [SI] to search from, whose motions reverse in one order: a programme holds for such machines alone."""

    structure: Structure
    starts: tuple[Mapping[str, float], ...]


def begins(trace: Trace, count: int, seed: int) -> list[Begin]:
    """Up to `count` sizes to search from for every order of events that was met: that of the given sizes, then the most frequent.

    The given sizes come first; the others are random within the bounds. Empty where the crank can turn fully with none of them.
    """
    task = trace.problem
    given = {name: task.quantities[name].value for name in task.free}
    found: dict[tuple[object, ...], tuple[Structure, list[Mapping[str, float]]]] = {}
    for k, values in enumerate((given, *_samples(task, count, seed))):
        structure = trace.structure(values)
        if structure is not None:
            _, starts = found.setdefault((structure.which, structure.rising), (structure, []))
            starts.append(values)
        if k >= count and found and len(next(iter(found.values()))[1]) >= count:
            break
    orders = list(found.values())
    orders[1:] = sorted(orders[1:], key=lambda own: -len(own[1]))
    return [Begin(structure, tuple(starts[:count])) for structure, starts in orders]


def _samples(task: CycleProblem, count: int, seed: int) -> Iterator[dict[str, float]]:
    """Random sizes within the bounds (scrambled Sobol points)."""
    from scipy.stats import qmc

    sobol = qmc.Sobol(len(task.free), rng=np.random.default_rng(seed))
    low, high = np.array([task.quantities[name].bounds for name in task.free]).T
    for share in sobol.random_base2(math.ceil(math.log2(SAMPLES * count))):
        yield dict(zip(task.free, (low + share * (high - low)).tolist(), strict=True))


def programme(trace: Trace, begin: Begin) -> CycleNLP:
    """The programme of one order of events, its roaming positions where the first start has its peaks."""
    nlp = build_cycle(trace, begin.structure, begin.starts[0])
    nlp.roam(peaks(nlp, nlp.lifted(nlp.x_start)).shares)
    return nlp


@dataclass(frozen=True)
class Searched:
    """What a search brought: by back end the best design, and every run; or the limits that stand against any design.

    `starts`: how many were searched from, fewer than wanted where the search was interrupted.
    """

    nlp: CycleNLP
    found: dict[str, Solution]
    runs: dict[str, list[Solution]]
    starts: int
    conflict: tuple[Relaxation, ...] = ()
    together: tuple[Relaxation, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether a design meets all limits."""
        return any(solution.usable for solution in self.found.values())


def searched(nlp: CycleNLP, begin: Begin, names: Sequence[str], done: Callable[[], None]) -> Searched:
    """Search from every start with every back end, follow the peaks, reconcile the back ends."""
    points = [nlp.x_of(values) for values in begin.starts]
    runs: dict[str, list[Solution]] = {}
    for name in names:
        runs[name] = search.multistart(nlp, name, points, lambda _: done())
        points = points[: len(runs[name])]  # fewer if interrupted
    if not any(solution.usable for run in runs.values() for solution in run):
        return Searched(nlp, {name: search.best(run) for name, run in runs.items()}, runs, len(points))
    return Searched(nlp, settle(nlp, {name: _levelled(nlp, run) for name, run in runs.items()}), runs, len(points))


def settle(nlp: CycleNLP, found: dict[str, Solution]) -> dict[str, Solution]:
    """Where two back ends ended in different optima, let the worse one search again from the better one's design.

    A true local optimum holds it there; if it does not, the two still disagree and the validation says so.
    """
    winner = min(found.values(), key=rank)
    return {
        name: solution if search.compare(solution, winner).same else min((solution, held(nlp, winner, name)), key=rank)
        for name, solution in found.items()
    }


def _levelled(nlp: CycleNLP, run: list[Solution]) -> Solution:
    """The best optimum of a back end once peaks are followed: which lifts some optima more than others."""
    best: Solution | None = None
    for group in search.cluster(nlp, run)[:FOLLOWED]:
        if best is not None and best.status is Status.OPTIMAL and group.solution.objective >= best.objective:
            break
        own = level(nlp, group.solution)
        best = own if best is None else min((best, own), key=rank)
    return search.best(run) if best is None else best


def rank(solution: Solution) -> tuple[bool, bool, float]:
    """What comes first is better: feasible, proven, low."""
    return not solution.usable, solution.status is not Status.OPTIMAL, solution.objective


def explained(found: Searched, begin: Begin, names: Sequence[str]) -> Searched:
    """Why no design is feasible, with the nearest one; or a feasible one after all.

    Which of the [limits] conflict is asked of a programme with fewer positions; the bounds of the sizes hold.
    """
    nlp = found.nlp
    coarse = build_cycle(nlp.traced, nlp.structure, nlp.design(nlp.x_start), nodes=COARSE, slots=2)
    asked = {bound.key for bound in coarse.traced.problem.bounds}
    kept = coarse.states.union(coarse.free, {row.limit for row in coarse.rows} - asked - {EPIGRAPH})
    ends = [nlp.design(solution.x) for solution in next(iter(found.runs.values()))[:TRIED]]
    points = [coarse.x_of(values) for values in (*begin.starts[:TRIED], *ends)]
    reason = explain(replace(coarse, states=kept), points=points)
    if isinstance(reason, Explanation):
        miss = replace(search.given(nlp, nlp.x_of(coarse.design(reason.x)), "nearest design"), status=Status.INFEASIBLE)
        return replace(found, found=dict.fromkeys(names, miss), conflict=reason.conflict, together=reason.together)
    x = nlp.x_of(coarse.design(reason))
    again = {name: level(nlp, search.solve_from(nlp, x, name)) for name in names}
    return replace(found, found=settle(nlp, again))
