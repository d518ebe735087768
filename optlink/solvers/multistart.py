"""Local searches and multistart: feasibility repair, back end, Newton refinement, optimality check; comparison of back ends."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optlink.errors import Status
from optlink.linkage.vector2d import TURN, Array, all_finite, finite_or, max_magnitude
from optlink.optimization.multipliers import ACTIVE
from optlink.optimization.nlp import NLP, SMALLEST_SCALE, NLPValues
from optlink.problem.design import EPIGRAPH
from optlink.problem.tolerances import SMOOTHED
from optlink.solvers.contract import MINIMAX, SOLVERS, backend
from optlink.solvers.solution import (
    FEASIBLE,
    SAME_OBJECTIVE,
    Attempt,
    Backend,
    Solution,
    Stationarity,
    stationarity,
    verified_solution,
    violation,
)

# Constants of local searches.
# What a search finds, and how much longer it takes, if one of them is halved or doubled: docs/constants.md.
# Repair of a starting point:
INSIDE = 1e-3  # distance (scaled units) to aim for inside a limit: at the limit a dead centre may have no derivative
REPAIR_STEPS = 60  # at most
LONGEST_REPAIR = 0.5  # scaled units; a longer step is shortened to it
# Newton's method:
NEAR = 1e-4  # a limit this close (scaled units), with a multiplier of the right sign, counts as active
MAX_STEPS = 6  # at most; two or three reach rounding error
TRIES = 3  # active sets: a limit violated at the end is added to the next set
LONGEST_STEP = 1e-2  # a longer step is rejected: it leaves the neighbourhood of the optimum
CONVERGED = 1e-10  # residual of the optimality conditions of an optimum
ROUNDING = 1e-14  # residual at which no further step is made, and that share of the largest second derivative
SHORTEST_STEP = 1e-9  # after a step this short the error is its square: rounding
# Comparison of two optima:
SAME_ERROR = 1e-8  # rad; errors that differ by less count as equal
SAME_DESIGN = 1e-5  # scaled units; designs that differ by less count as equal
# Searches and their starting points:
SMOOTHING = 1e-3, 1e-5, 1e-7  # rad; of successive searches for a robust design
CONTINUATIONS = 3  # number of restarts, with tighter tolerances, from an end that is not optimal
NEARLY = 1e-3  # a violation up to this, in scaled units, is attributed to the solver's tolerance and repaired
CREEPING = 1e-3  # relative decrease of the objective by a search that ran out of steps, up to which a restart helps little
SOBOL_BLOCK = 64  # Sobol points that are drawn at once; a power of two keeps them balanced
HYPERCUBE = 64  # points of a Latin hypercube sample
RESCALE = 1e-3  # if the objective fell below this share of its start, the search is repeated with a new scale

# Feasibility repair of a starting point by Gauss-Newton steps on the violated limits.


def repair(nlp: NLP, x: Array, p: Array, inside: float = INSIDE) -> Array | None:
    """Return a feasible x with a finite objective near a start, `inside` the limits if it moved; None if a violation remains."""
    low, high = nlp.low, nlp.high
    inset = np.minimum(inside, 0.25 * (high - low))
    low_inside, high_inside = low + inset, high - inset
    x = np.clip(x, nlp.x_low, nlp.x_high)
    limited = np.array([row.limit != EPIGRAPH for row in nlp.rows], dtype=bool)  # the others follow from lifting x
    for _ in range(REPAIR_STEPS):
        x = nlp.lifted(x)
        point = nlp.at(x, p)
        if math.isfinite(point.f) and violation(nlp, x, point.g) <= FEASIBLE:
            return x
        miss = np.maximum(low_inside - point.g, 0.0) + np.minimum(high_inside - point.g, 0.0)
        rows = np.flatnonzero(limited & np.isfinite(miss) & (miss != 0.0) & np.isfinite(point.jacobian).all(axis=1))
        if rows.size == 0:
            return None
        rows = _worst(nlp, rows, miss)
        step = _shortest(point.jacobian[rows], miss[rows], nlp.x_low - x, nlp.x_high - x)
        length = float(np.linalg.norm(step))
        if length < 1e-13:
            return None
        x = np.clip(x + step * min(1.0, LONGEST_REPAIR / length), nlp.x_low, nlp.x_high)
    return None


def _worst(nlp: NLP, rows: NDArray[np.intp], miss: Array) -> NDArray[np.intp]:
    """Return the most violated row of every limit.

    The rows of one limit at neighbouring positions are nearly dependent: a step that meets all of them exactly leads far away.
    """
    order = rows[np.argsort(-np.abs(miss[rows]), kind="stable")]
    worst = {(nlp.rows[j].limit, nlp.rows[j].label, bool(miss[j] > 0.0)): j for j in reversed(order.tolist())}
    return np.array(sorted(worst.values()), dtype=np.intp)


def _shortest(jacobian: Array, miss: Array, low: Array, high: Array) -> Array:
    """Return the least-norm step with jacobian @ step = miss (least squares), components limited to low ... high."""
    step = np.zeros(jacobian.shape[1])
    free = np.ones(step.size, dtype=bool)
    while free.any():
        rest = miss - jacobian[:, ~free] @ step[~free]
        step[free] = np.linalg.lstsq(jacobian[:, free], rest, rcond=1e-10)[0]
        out = free & ((step < low) | (step > high))
        if not out.any():
            break
        step[out] = np.clip(step[out], low[out], high[out])
        free &= ~out
    return step


# Newton's method on the KKT system with exact second derivatives, to refine an optimum to rounding error.
#
# A back end stops within its tolerance of the optimum; two or three Newton steps on the system of the active limits reach
# rounding error, which makes two back ends comparable to 1e-6 mm and the multipliers exact.


class Refined(NamedTuple):
    """A point (n,), the NLP there, and its optimality conditions if the point has moved."""

    x: Array
    point: NLPValues
    conditions: Stationarity | None = None


def polish(nlp: NLP, attempt: Attempt, p: Array, near: float = NEAR) -> Attempt:
    """Refine an attempt by Newton's method; see `refined`."""
    return replace(attempt, x=refined(nlp, attempt.x, p, nlp.at(attempt.x, p), near).x)


def refined(nlp: NLP, x: Array, p: Array, begin: NLPValues, near: float = NEAR) -> Refined:
    """Refine a point by Newton's method, with limits within `near` (scaled) active; return it unchanged without improvement."""
    same = Refined(x, begin)
    if not begin.finite:
        return same
    conditions = stationarity(nlp, x, begin, near)
    allowed = max(FEASIBLE, violation(nlp, x, begin.g))
    active = np.array(conditions.active, dtype=int)
    for _ in range(TRIES):
        converged = _converged(nlp, x, p, begin, active, conditions.multipliers.copy())
        if converged is not None:
            y, here, threshold = converged
            values = np.concatenate([y, here.g])
            missed = np.flatnonzero(np.maximum(nlp.lower - values, values - nlp.upper) > allowed)
            if missed.size:
                if np.any(np.isin(missed, active)):
                    return same
                active = np.sort(np.concatenate([active, missed]))
                continue
            end = stationarity(nlp, y, here)
            if end.kkt <= max(conditions.kkt, threshold) and here.f <= begin.f + 1e-3 * abs(begin.f):
                return Refined(y, here, end)
        touching = stationarity(nlp, x, begin, FEASIBLE).active
        if len(touching) >= active.size:
            return same
        active = np.array(touching, dtype=int)  # a limit that is only near can have a multiplier of zero
    return same


def _converged(
    nlp: NLP, x: Array, p: Array, begin: NLPValues, active: NDArray[np.intp], multipliers: Array
) -> tuple[Array, NLPValues, float] | None:
    """Return the best Newton iterate of an active set, its values, and the residual tolerance; None without convergence."""
    n, here = len(x), begin
    rows = active[active >= n] - n
    values = np.concatenate([x, begin.g])
    bound = np.where(nlp.upper - values <= values - nlp.lower, nlp.upper, nlp.lower)[active]
    unit = np.eye(n)
    y, last, stiffness, worse, best, moved = x, np.inf, 0.0, 0, (x, begin), np.inf
    for _ in range(MAX_STEPS):
        jacobian = np.vstack([unit, here.jacobian])[active]
        missing = np.concatenate([y, here.g])[active] - bound
        residual = np.concatenate([here.gradient + jacobian.T @ multipliers[active], missing])
        size = max_magnitude(residual)
        worse = 0 if size < 0.5 * last else worse + 1
        if worse > 1:  # one increase is allowed: along a curved valley every other step restores the limits
            break
        if worse == 0:
            last, best = size, (y, here)
        if size <= ROUNDING or (moved <= SHORTEST_STEP and last <= CONVERGED):
            break
        weights = np.zeros(len(here.g))
        weights[rows] = multipliers[rows + n]
        hessian = nlp.hessian(y, p, weights)
        stiffness = max(stiffness, max_magnitude(hessian))
        step = newton(hessian, jacobian, residual)
        if step is None:
            break
        moved = max_magnitude(step[:n])
        y = np.clip(y + step[:n], nlp.x_low, nlp.x_high)
        multipliers[active] += step[n:]
        here = nlp.at(y, p)
        if not here.finite or max_magnitude(y - x) > LONGEST_STEP:
            return None
    threshold = max(CONVERGED, ROUNDING * stiffness)
    return (*best, threshold) if last <= threshold else None


def newton(hessian: Array, jacobian: Array, residual: Array) -> Array | None:
    """Return the Newton step of variables and multipliers (n + k,) of the KKT system; None if the system is not finite.

    `hessian` is that of the Lagrangian, `jacobian` (k, n) that of the active limits; `residual` (n + k,) is the gradient of the
    Lagrangian, then the active limits minus their bounds. A least-squares solution is used where limits are linearly dependent or
    the objective is flat.
    """
    n = len(hessian)
    system = np.zeros((len(residual), len(residual)))
    system[:n, :n], system[:n, n:], system[n:, :n] = hessian, jacobian.T, jacobian
    if not all_finite(system):
        return None
    try:
        step = np.asarray(np.linalg.solve(system, -residual), dtype=float)
        if max_magnitude(step) < 1.0:
            return step
    except np.linalg.LinAlgError:
        pass
    return np.asarray(np.linalg.lstsq(system, -residual, rcond=1e-12)[0], dtype=float)


LEAST_VIOLATION = "Infeasible_Problem_Detected"  # message of IPOPT at a locally least violation
OUT_OF_STEPS = "Maximum_Iterations_Exceeded"  # message of IPOPT


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
    """Return the optimum to which the objective decreases where an angle free over a full turn ended at one of its bounds."""
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
    high = finite_or(high, 1.0)
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
    return Agreement(gap / max(abs(first), abs(second), SAME_ERROR), max_magnitude(one - other))
