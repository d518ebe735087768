"""Local searches and multistart: feasibility repair, back end, Newton refinement, optimality check; comparison of back ends."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from optlink.errors import Status
from optlink.linkage.vector2d import TURN, Array
from optlink.optimization.multipliers import ACTIVE
from optlink.optimization.nlp import NLP, SMALLEST_SCALE
from optlink.problem.robust import SMOOTHED
from optlink.solvers.contract import MINIMAX, SOLVERS, backend
from optlink.solvers.feasibility import repair
from optlink.solvers.newton import refined
from optlink.solvers.solution import FEASIBLE, Attempt, Backend, Solution, verified_solution, violation

SAME_OBJECTIVE = 1e-6  # relative
SAME_ERROR = 1e-8  # rad; errors that differ by less count as equal
SAME_DESIGN = 1e-5  # in scaled units
SMOOTHING = 1e-3, 1e-5, 1e-7  # rad; of successive searches for a robust design
CONTINUATIONS = 3  # number of restarts, with tighter tolerances, from an end that is not optimal
NEARLY = 1e-3  # a violation up to this, in scaled units, is attributed to the solver's tolerance and repaired
LEAST_VIOLATION = "Infeasible_Problem_Detected"  # message of IPOPT at a locally least violation
OUT_OF_STEPS = "Maximum_Iterations_Exceeded"  # message of IPOPT
CREEPING = 1e-3  # relative decrease of the objective by a search that ran out of steps, up to which a restart helps little
SOBOL_BLOCK = 64
HYPERCUBE = 64  # points of a Latin hypercube sample
RESCALE = 1e-3  # if the objective fell below this share of its start, the search is repeated with a new scale


def prepare(nlp: NLP, name: str) -> None:
    """Import and compile what a back end needs, so that timings cover the search alone."""
    backend(name)
    compile_ = SOLVERS[name].compile
    if compile_ is not None:
        compile_(nlp)
    nlp.at(nlp.x_start, nlp.p)
    nlp.hessian(nlp.x_start, nlp.p, np.zeros(len(nlp.rows)))
    nlp.residuals(nlp.x_start)


def scaled_parameters(nlp: NLP, x: Array) -> Array:
    """Return the parameters of the NLP with the objective scaled to 1 at x."""
    f = nlp.values(x, nlp.p)[0] * nlp.p[0]
    return np.array([max(abs(f), SMALLEST_SCALE) if math.isfinite(f) else 1.0, *nlp.p[1:]])


def solution_at(nlp: NLP, x: Array, message: str) -> Solution:
    """Wrap a given design as a Solution without optimising."""
    x = nlp.lifted(x)
    return verified_solution(nlp, Attempt(x, 0, message), scaled_parameters(nlp, x))


def infeasible_at(nlp: NLP, x: Array, message: str) -> Solution:
    """Wrap a design that satisfies no limits as a Solution."""
    return replace(solution_at(nlp, x, message), status=Status.INFEASIBLE)


def solve_from(
    nlp: NLP, x: Array, name: str, *, track: bool = False, persistent: bool = True, continuations: int = CONTINUATIONS
) -> Solution:
    """Run one local search from x; restart it up to `continuations` times from an end that is not optimal.

    The scatter of a robust error has kinks where a derivative of the error vanishes. From a start that is not close to an
    optimum, they are smoothed first, then less and less. `persistent`: restart also where little is to be expected, at a
    violation of the limits that is no matter of tolerances, and after a search that ran out of steps though it hardly decreased
    the objective.
    """
    start = repair(nlp, x, nlp.p)
    if start is None and not math.isfinite(nlp.values(x, nlp.p)[0]):
        return infeasible_at(nlp, x, "the start could not be repaired")
    x = nlp.lifted(x if start is None else start)
    smoothed = _smoothed(nlp, x, name, track) if nlp.smoothing and SOLVERS[name].selectable else None
    if smoothed is not None:
        x, name = nlp.lifted(smoothed.x), MINIMAX
    run = backend(name)
    p = scaled_parameters(nlp, x)
    solution = conclude(nlp, run(nlp, x, p, track=track), p)
    if smoothed is not None:
        solution = replace(solution, iterations=smoothed.iterations + solution.iterations, path=smoothed.path)
    for _ in range(continuations):
        fine = scaled_parameters(nlp, solution.x)
        if solution.status is Status.OPTIMAL and fine[0] >= RESCALE * p[0]:
            break
        if not persistent and (solution.message == LEAST_VIOLATION or solution.violation > NEARLY):
            break
        again = conclude(nlp, Attempt(solution.x, 0, solution.message), fine)  # Newton's method alone may suffice
        if again.status is not Status.OPTIMAL:
            creeping = solution.message == OUT_OF_STEPS and nlp.values(solution.x, p)[0] > 1.0 - CREEPING
            if not persistent and start is not None and creeping:
                break
            again = conclude(nlp, run(nlp, solution.x, fine, tight=True), fine)
        p = fine
        if not again.usable or (solution.usable and again.objective > solution.objective and again.status is not Status.OPTIMAL):
            break
        steps = solution.iterations + again.iterations
        solution = replace(best([again, solution]), iterations=steps, path=solution.path)
    return _continued_around(nlp, solution, run)


def solve_beside(nlp: NLP, x: Array, name: str, *, insist: bool) -> Solution:
    """Run one local search from a feasible point near x; with `insist`, if there is none, from x itself."""
    start = repair(nlp, x, nlp.p)
    if start is None and insist and math.isfinite(nlp.values(x, nlp.p)[0]):
        p = scaled_parameters(nlp, x)
        end = conclude(nlp, backend(name)(nlp, nlp.lifted(x), p), p)
        x = end.x
        if end.status is Status.OPTIMAL and scaled_parameters(nlp, x)[0] >= RESCALE * p[0]:
            return end
        start = repair(nlp, x, nlp.p, inside=0.0)
    if start is not None:
        return solve_from(nlp, start, name)
    end = solution_at(nlp, x, "no feasible point was found beside the start")
    return replace(end, status=Status.INFEASIBLE) if end.status is Status.NON_FINITE else end


def _continued_around(nlp: NLP, solution: Solution, run: Backend) -> Solution:
    """Return the optimum to which the objective decreases where an angle that may be any ended at one of its bounds."""
    x, around = solution.x.copy(), nlp.around
    if solution.status is not Status.STALLED or solution.message == OUT_OF_STEPS or not np.any(around):
        return solution
    beyond = (nlp.x_high - x <= ACTIVE) * 1.0 - (x - nlp.x_low <= ACTIVE)
    if not np.any(beyond[around]):
        return solution
    x[around] -= TURN * beyond[around]
    p = scaled_parameters(nlp, x)
    return best([conclude(nlp, run(nlp, x, p), p), solution])


def _smoothed(nlp: NLP, x: Array, name: str, track: bool) -> Attempt:
    """Search from x where kinks are smoothed less and less; the path is that of the first of these searches."""
    attempt = Attempt(x, 0, "")
    try:
        for k, nlp.p[nlp.smoothing] in enumerate(SMOOTHING):
            x = nlp.lifted(attempt.x)
            p = scaled_parameters(nlp, x)
            solution = conclude(nlp, backend(MINIMAX if k else name)(nlp, x, p, track=track and not k), p)
            attempt = Attempt(
                solution.x if solution.usable else x,
                attempt.iterations + solution.iterations,
                "",
                attempt.path if k else solution.path,
            )
    finally:
        nlp.p[nlp.smoothing] = SMOOTHED
    return attempt


def conclude(nlp: NLP, attempt: Attempt, p: Array) -> Solution:
    """Return the result of a back end as a Solution, after repair of a small violation and Newton refinement."""
    x = nlp.lifted(attempt.x)
    point = nlp.at(x, p)
    if FEASIBLE < violation(nlp, x, point.g) <= NEARLY:
        mended = repair(nlp, x, p, inside=0.0)
        if mended is not None:
            x, point = mended, nlp.at(mended, p)
    end = refined(nlp, x, p, point)
    return verified_solution(nlp, replace(attempt, x=end.x), p, end.point, end.conditions)


def starts(nlp: NLP, count: int, seed: int) -> list[Array]:
    """Return the start of the NLP, followed by count - 1 Sobol points over the bounds."""
    return [
        nlp.lifted(x)
        for x in (np.clip(nlp.x_start, nlp.x_low, nlp.x_high), *itertools.islice(sobol(nlp.x_low, nlp.x_high, seed), count - 1))
    ]


def sobol(low: Array, high: Array, seed: int) -> Iterator[Array]:
    """Generate scrambled Sobol points within bounds, without end; an infinite upper bound counts as 1."""
    from scipy.stats import qmc

    points = qmc.Sobol(len(low), rng=np.random.default_rng(seed))
    high = np.where(np.isfinite(high), high, 1.0)
    while True:
        yield from low + points.random(SOBOL_BLOCK) * (high - low)


def latin_hypercubes(low: Array, high: Array, seed: int) -> Iterator[Array]:
    """Generate points within bounds, without end: one Latin hypercube sample after the other.

    They need no import of `scipy.stats`, which takes longer than many a search.

    References
    ----------
    M. D. McKay, R. J. Beckman, W. J. Conover, A comparison of three methods for selecting values of input variables in the
    analysis of output from a computer code, Technometrics 21 (1979) 239-245.
    """
    rng = np.random.default_rng(seed)
    while True:
        strata = rng.permuted(np.tile(np.arange(HYPERCUBE), (len(low), 1)), axis=1).T
        yield from low + (strata + rng.random(strata.shape)) / HYPERCUBE * (high - low)


def best(solutions: list[Solution]) -> Solution:
    """Return the feasible solution with the least objective (ties: optimal before stalled), else the least infeasible one."""
    usable = [s for s in solutions if s.usable]
    if usable:
        return min(usable, key=lambda s: (s.objective, s.status is not Status.OPTIMAL))
    return min(solutions, key=lambda s: (s.status is Status.NON_FINITE, s.violation))


@dataclass(frozen=True)
class Agreement:
    """Difference between the results of two back ends.

    `objective`: relative difference of the errors (for a sum of squares: of its root), where differences below `SAME_ERROR` count
    as zero; `design`: largest difference in scaled units.
    """

    objective: float
    design: float

    @property
    def same(self) -> bool:
        """Whether the objectives agree; if the designs differ nevertheless, several designs are equally good."""
        return self.objective <= SAME_OBJECTIVE


def compare(a: Solution, b: Solution) -> Agreement:
    """Return the difference of two solutions; infinite if one is infeasible."""
    if not (a.usable and b.usable):
        return Agreement(math.inf, math.inf)
    root = math.sqrt if a.nlp.measure.name == "sum of squares" else float
    first, second = root(a.objective), root(b.objective)
    gap = max(0.0, abs(first - second) - SAME_ERROR)
    one, other = (s.x[: s.nlp.first_event] for s in (a, b))  # events may be others
    return Agreement(gap / max(abs(first), abs(second), SAME_ERROR), float(np.max(np.abs(one - other), initial=0.0)))
