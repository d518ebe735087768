"""From a programme and its starts to a solution: repair, back end, polish, proof; many starts; both back ends."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optlink.errors import Status
from optlink.optimization.nlp import NLP, SMALLEST_SCALE
from optlink.solvers.feasibility import repair
from optlink.solvers.newton import polish
from optlink.solvers.solution import FEASIBLE, Attempt, Backend, Solution, examine, violation

Array = NDArray[np.float64]

BACKENDS = ("slsqp", "ipopt")
MINIMAX = "minimax"  # knows programmes of the largest of many deviations only
CLOSE = "ipopt, close"  # IPOPT with a small barrier, which does not leave the neighbourhood of a start that is nearly optimal
SAME_OBJECTIVE = 1e-6  # relative
SAME_ERROR = 1e-8  # rad; half a millionth of a degree is no difference
SAME_DESIGN = 1e-5  # in scaled units
CONTINUATIONS = 3  # an end that is no optimum is searched on from, more tightly
NEARLY = 1e-3  # a violation up to this, in scaled units, is a solver's tolerance rather than another design
SOBOL_BLOCK = 64
RESCALE = 1e-3  # an optimum this far below its start is searched again from there, on its own scale


def backend(name: str) -> Backend:
    """The back end of that name; its library is imported only now."""
    if name == "slsqp":
        from optlink.solvers.slsqp import slsqp

        return slsqp
    if name == MINIMAX:
        from optlink.solvers.minimax import minimax

        return minimax
    from optlink.solvers.ipopt import ipopt, ipopt_close

    if name == CLOSE:
        return ipopt_close

    return ipopt


def prepare(nlp: NLP, name: str) -> None:
    """Import and compile what a back end needs, so that the search itself is timed alone."""
    backend(name)
    if name == "ipopt":
        from optlink.solvers.ipopt import compiled

        compiled(nlp)
    nlp.at(nlp.x_start, nlp.p)
    nlp.hessian(nlp.x_start, nlp.p, np.zeros(len(nlp.rows)))
    nlp.residuals(nlp.x_start)


def scaled(nlp: NLP, x: Array) -> Array:
    """Parameters with the objective scaled to 1 at x."""
    f = nlp.values(x, nlp.p)[0] * nlp.p[0]
    return np.array([max(abs(f), SMALLEST_SCALE) if math.isfinite(f) else 1.0, *nlp.p[1:]])


def given(nlp: NLP, x: Array, message: str) -> Solution:
    """A point that was not searched, as a solution."""
    x = nlp.lifted(x)
    return examine(nlp, Attempt(x, 0, message), scaled(nlp, x))


def solve_from(nlp: NLP, x: Array, name: str, *, track: bool = False) -> Solution:
    """One local search from x."""
    start = repair(nlp, x, nlp.p)
    if start is None and not math.isfinite(nlp.values(x, nlp.p)[0]):
        return replace(given(nlp, x, "the start could not be repaired"), status=Status.INFEASIBLE)
    x = nlp.lifted(x if start is None else start)
    run = backend(name)
    p = scaled(nlp, x)
    solution = _ended(nlp, run(nlp, x, p, track=track), p)
    for _ in range(CONTINUATIONS):
        fine = scaled(nlp, solution.x)
        if solution.status is Status.OPTIMAL and fine[0] >= RESCALE * p[0]:
            break
        again = _ended(nlp, run(nlp, solution.x, fine, tight=True), fine)
        p = fine
        if not again.usable or (solution.usable and again.objective > solution.objective and again.status is not Status.OPTIMAL):
            break
        steps = solution.iterations + again.iterations
        solution = replace(best([again, solution]), iterations=steps, path=solution.path)
    return solution


def _ended(nlp: NLP, attempt: Attempt, p: Array) -> Solution:
    """What a back end brought back: put back onto a limit that it missed by a little, polished and examined."""
    x = nlp.lifted(attempt.x)
    if FEASIBLE < violation(nlp, x, nlp.values(x, p)[1]) <= NEARLY:
        mended = repair(nlp, x, p, inside=0.0)
        x = x if mended is None else mended
    return examine(nlp, polish(nlp, replace(attempt, x=x), p), p)


def starts(nlp: NLP, count: int, seed: int) -> list[Array]:
    """The given start, then count - 1 Sobol points over the bounds (scrambled by the seed)."""
    return [nlp.lifted(x) for x in (np.clip(nlp.x_start, nlp.x_low, nlp.x_high), *itertools.islice(sobol(nlp, seed), count - 1))]


def sobol(nlp: NLP, seed: int) -> Iterator[Array]:
    """Sobol points over the bounds, without end, scrambled by the seed."""
    from scipy.stats import qmc

    points = qmc.Sobol(len(nlp.variables), rng=np.random.default_rng(seed))
    high = np.where(np.isfinite(nlp.x_high), nlp.x_high, 1.0)
    while True:
        yield from nlp.x_low + points.random(SOBOL_BLOCK) * (high - nlp.x_low)


@dataclass(frozen=True)
class Cluster:
    """A distinct optimum: its best solution and how many starts ended there."""

    solution: Solution
    count: int


def cluster(nlp: NLP, solutions: list[Solution]) -> list[Cluster]:
    """Distinct optima, best first; solutions that are not feasible are left out."""
    found: list[Cluster] = []
    for solution in sorted((s for s in solutions if s.usable), key=lambda s: s.objective):
        for i, known in enumerate(found):
            if np.max(np.abs(known.solution.x - solution.x)) <= SAME_DESIGN:
                found[i] = Cluster(known.solution, known.count + 1)
                break
        else:
            found.append(Cluster(solution, 1))
    return found


def multistart(
    nlp: NLP,
    name: str,
    begin: list[Array],
    progress: Callable[[int], None] | None = None,
    *,
    track: bool = False,
) -> list[Solution]:
    """One solution per start, in the order of the starts; an interrupt (Ctrl-C) keeps those that are done, if there are any."""
    solutions: list[Solution] = []
    try:
        for k, x in enumerate(begin):
            solutions.append(solve_from(nlp, x, name, track=track and k == 0))
            if progress:
                progress(k + 1)
    except KeyboardInterrupt:
        if not solutions:
            raise
    return solutions


def best(solutions: list[Solution]) -> Solution:
    """The feasible solution with the least objective (optimal before stalled if they tie); else the least violated one."""
    usable = [s for s in solutions if s.usable]
    if usable:
        return min(usable, key=lambda s: (s.objective, s.status is not Status.OPTIMAL))
    return min(solutions, key=lambda s: (s.status is Status.NON_FINITE, s.violation))


@dataclass(frozen=True)
class Agreement:
    """How far two back ends are apart at the end.

    `objective`: difference of the errors (for a sum of squares: of its root) over their size, differences below `SAME_ERROR`
    counting as none; `design`: largest difference in scaled units.
    """

    objective: float
    design: float

    @property
    def same(self) -> bool:
        """Equal objective; where the designs differ all the same, several designs are equally good."""
        return self.objective <= SAME_OBJECTIVE


def compare(a: Solution, b: Solution) -> Agreement:
    """Difference of two solutions."""
    if not (a.usable and b.usable):
        return Agreement(math.inf, math.inf)
    root = math.sqrt if a.nlp.measure.name == "sum of squares" else float
    one, other = root(a.objective), root(b.objective)
    gap = max(0.0, abs(one - other) - SAME_ERROR)
    return Agreement(gap / max(abs(one), abs(other), SAME_ERROR), float(np.max(np.abs(a.x - b.x), initial=0.0)))


def reconcile(nlp: NLP, found: dict[str, Solution]) -> dict[str, Solution]:
    """Where two back ends ended in different optima, let the worse one search again from the better one's design.

    A true local optimum holds it there; if it does not, the two still disagree and the validation says so.
    """
    winner = best(list(found.values()))
    return {
        name: solution if compare(solution, winner).same else best([solution, solve_from(nlp, winner.x, name)])
        for name, solution in found.items()
    }
