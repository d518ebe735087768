"""Exchange method for semi-infinite constraints: maxima over the cycle between the positions of the NLP."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import casadi
import numpy as np

from optlink.errors import Status
from optlink.linkage.extrema import maxima
from optlink.linkage.vector2d import TURN, Array
from optlink.optimization.constraints import PLAIN, ConstraintRow
from optlink.optimization.mapped_terms import MappedTerms
from optlink.optimization.nlp import NLP, Variable
from optlink.solvers import multistart
from optlink.solvers.contract import CLOSE, backend
from optlink.solvers.newton import polish
from optlink.solvers.solution import FEASIBLE, STATIONARY, Attempt, Solution, stationarity, verified_solution, violation

if TYPE_CHECKING:
    from optlink.optimization.cycle_constraints import WatchedTerm
    from optlink.optimization.cycle_nlp import CycleNLP

POSITIONS_PER_STROKE = 241  # sampled positions per stroke
EXCHANGES, LEVELLED = 40, 1e-10  # rounds, and the share by which a peak may exceed the values at the positions of the NLP
CONVERGED = 1e-8  # the same after the last round
PEAK = "place of a peak"
REACH = 0.25  # share of a stroke by which the position of a peak may move in one round
EDGE = 1e-6  # share of a stroke: a peak this close to its end is due to a jump of a force, not a vanishing derivative
MOVABLE = 0.05  # share of its level by which a peak may be lower and its position still be an unknown
RADIUS, SMALLEST = 0.1, 1e-7  # scaled units: trust-region radius of the first round, and the one that ends the rounds
VIOLATION_PENALTY = 100.0  # penalty of a limit violated by its own size, in multiples of the objective
PEAK_SEPARATION = 1e-9  # share of a stroke: closer peaks count as one
EXACTLY = 1e-9  # scaled units: distance at which a row counts as active in the optimality conditions
ALLOWED = 1e2 * FEASIBLE  # permitted violation of the NLP with moving peaks, whose equations are steep
BESIDE = 0.02  # share of a stroke: distance of other positions from peaks, so that they do not count as active too
TRACKED_PEAK = 0.3  # share of its level by which a local peak may be lower and still be tracked


@dataclass(frozen=True)
class Peaks:
    """Maxima of the terms along every stroke.

    `shares` (slots,): positions within the strokes, 0 at the start and 1 at the end, for the exchange points. `excess`:
    relative excess of the worst peak over its level. `inner`: (slot, index of the watched term) of peaks inside a stroke. `tops`:
    largest value of every watched term, in its own scale; -inf if it is far below its level.
    """

    shares: Array
    excess: float
    inner: tuple[tuple[int, int], ...]
    tops: tuple[float, ...]


def exchange(nlp: CycleNLP, solution: Solution) -> Solution:
    """Move the exchange points to the peaks and continue the search until no peak exceeds the values at those positions.

    With fixed positions the NLP does not account for the shift of a peak with the design: where the limits alone do not determine
    the design, steps overshoot alternately. Therefore the positions of the peaks are unknowns too, the design variables move
    within a radius, and a step is accepted only if the merit at the peaks decreases. These steps do not depend on the back end.

    References
    ----------
    R. Hettich, K. O. Kortanek, Semi-infinite programming: theory, methods, and applications, SIAM Review 35 (1993) 380-429:
    exchange; local reduction.
    """
    if not solution.usable:
        return solution
    cycle_peaks, radius = peaks(nlp, solution.x), RADIUS
    for _ in range(EXCHANGES):
        nlp.set_exchange_points(cycle_peaks.shares)
        solution = _examined(nlp, Attempt(nlp.lifted(solution.x), solution.iterations, solution.message))
        if (cycle_peaks.excess <= LEVELLED and solution.status is Status.OPTIMAL) or radius < SMALLEST:
            break
        merit = _merit(nlp, solution.x, cycle_peaks)
        for step in (_polished, _levelled, _followed):
            nlp.set_exchange_points(cycle_peaks.shares)
            candidate = step(nlp, nlp.lifted(solution.x), cycle_peaks, radius)
            if candidate is None:
                continue
            there = peaks(nlp, candidate.x)
            converged = there.excess <= LEVELLED and candidate.status is Status.OPTIMAL
            if _merit(nlp, candidate.x, there) < merit + (1e-9 if converged else -1e-12) * abs(merit):
                moved = _distance(nlp, candidate.x, solution.x)
                radius = max(radius, 2.0 * moved) if moved > 0.9 * radius else radius
                solution, cycle_peaks = candidate, there
                break
        else:
            radius *= 0.25
    converged = cycle_peaks.excess <= CONVERGED and solution.usable
    return solution if converged else replace(solution, status=Status.STALLED, message="the peaks did not converge")


def restart_from(nlp: CycleNLP, solution: Solution, name: str) -> Solution:
    """Restart a back end from a levelled design; a true optimum does not move."""
    cycle_peaks = peaks(nlp, solution.x)
    nlp.set_exchange_points(cycle_peaks.shares)
    near = _followed(nlp, nlp.lifted(solution.x), cycle_peaks, RADIUS, name)
    return solution if near is None else exchange(nlp, near)


def reconcile_backends(nlp: CycleNLP, solutions: dict[str, Solution]) -> dict[str, Solution]:
    """As `multistart.reconcile`, with the largest values over the cycle."""
    winner = min(solutions.values(), key=rank)
    return {
        name: solution
        if multistart.compare(solution, winner).same
        else min((solution, restart_from(nlp, winner, name)), key=rank)
        for name, solution in solutions.items()
    }


def rank(solution: Solution) -> tuple[bool, bool, float]:
    """Return a sort key, best first: feasible, optimal, low objective."""
    return not solution.usable, solution.status is not Status.OPTIMAL, solution.objective


def _merit(nlp: CycleNLP, x: Array, cycle_peaks: Peaks) -> float:
    """Return the objective measured at the peaks plus a penalty on limits violated there."""
    x, excess = x.copy(), 0.0
    for watched, top in zip(nlp.watched, cycle_peaks.tops, strict=True):
        if watched.level is None:
            excess = max(excess, top - watched.bound)
        elif math.isfinite(top):
            x[watched.level] = top
    objective = nlp.measure.of(nlp.residuals(x))
    return objective + VIOLATION_PENALTY * excess * abs(objective)


def _distance(nlp: CycleNLP, x: Array, other: Array) -> float:
    """Return the largest difference of the design variables, scaled; of angles that may be any without whole revolutions."""
    away = (x - other)[: len(nlp.free)]
    away -= TURN * np.where(nlp.around[: len(away)], np.round(away / TURN), 0.0)
    return float(np.max(np.abs(away)))


def _examined(nlp: CycleNLP, attempt: Attempt) -> Solution:
    """Return a point with its optimality conditions, in which only exactly active rows count.

    A second position beside a peak is nearly active too; counting both would overstate the number of active constraints.
    """
    p = multistart.scaled_parameters(nlp, attempt.x)
    solution = verified_solution(nlp, attempt, p)
    if not solution.usable:
        return solution
    kkt = stationarity(nlp, solution.x, nlp.at(solution.x, p), EXACTLY).kkt
    return replace(solution, kkt=kkt, status=Status.OPTIMAL if kkt <= STATIONARY else Status.STALLED)


def _polished(nlp: CycleNLP, x: Array, cycle_peaks: Peaks, radius: float) -> Solution | None:
    """Return the optimum for fixed positions by a few Newton steps; None if there is none nearby."""
    near = _examined(nlp, polish(nlp, Attempt(x, 0, "peaks followed"), multistart.scaled_parameters(nlp, x)))
    return near if near.status is Status.OPTIMAL and _distance(nlp, near.x, x) <= radius else None


def _levelled(nlp: CycleNLP, x: Array, cycle_peaks: Peaks, radius: float) -> Solution | None:
    """Return the optimum by a few Newton steps, the positions of the peaks being unknowns; None if there is none nearby."""
    near = _newton(nlp, Attempt(x, 0, "peaks followed"), cycle_peaks)
    return near if near.status is Status.OPTIMAL and _distance(nlp, near.x, x) <= radius else None


def _followed(nlp: CycleNLP, x: Array, cycle_peaks: Peaks, radius: float, name: str = "") -> Solution | None:
    """Return the optimum within a radius, the positions of the peaks being unknowns; None if there is none.

    Without a name, IPOPT searches it; SLSQP if second derivatives would first have to be generated for the whole cycle.
    """
    name = name or (CLOSE if nlp.mapped is not None else "slsqp")
    n, count = len(nlp.variables), len(nlp.free)
    moving, start = _moving(nlp, x, cycle_peaks)
    reach = np.concatenate([np.full(count, radius), np.full(n - count, math.inf), np.full(len(start) - n, REACH)])
    around = moving.around  # a step may pass where such an angle jumps by a revolution
    low, high = np.where(around, -math.inf, moving.x_low), np.where(around, math.inf, moving.x_high)
    moving.set_bounds(np.maximum(low, start - reach), np.minimum(high, start + reach))
    p = multistart.scaled_parameters(moving, start)
    end = backend(name)(moving, start, p, tight=True)
    for attempt in (polish(moving, end, p), end):
        if violation(moving, attempt.x, moving.values(attempt.x, p)[1]) > ALLOWED:
            continue
        _place_inner(nlp, cycle_peaks, attempt.x[n:])
        near = _examined(nlp, replace(attempt, x=nlp.lifted(nlp.wrapped(attempt.x[:n]))))
        if near.status is Status.OPTIMAL or attempt is end:
            return near
    return None


def refine_peaks(nlp: CycleNLP, solution: Solution) -> Solution:
    """Refine an optimum by Newton's method with the positions of the peaks as unknowns; unchanged if the end is not optimal."""
    cycle_peaks = peaks(nlp, solution.x)
    nlp.set_exchange_points(cycle_peaks.shares)
    near = _newton(nlp, Attempt(nlp.lifted(solution.x), solution.iterations, solution.message), cycle_peaks)
    return near if near.status is Status.OPTIMAL else solution


def _newton(nlp: CycleNLP, attempt: Attempt, cycle_peaks: Peaks) -> Solution:
    """Return a point refined by Newton's method with the positions of the peaks as unknowns."""
    n = len(nlp.variables)
    moving, start = _moving(nlp, attempt.x, cycle_peaks)
    end = polish(moving, replace(attempt, x=start), multistart.scaled_parameters(moving, start))
    _place_inner(nlp, cycle_peaks, end.x[n:])
    return _examined(nlp, replace(end, x=nlp.lifted(end.x[:n])))


def _place_inner(nlp: CycleNLP, cycle_peaks: Peaks, places: Array) -> None:
    """Set the exchange points to the peaks, the inner ones at new places."""
    shares = cycle_peaks.shares.copy()
    shares[[slot for slot, _ in cycle_peaks.inner]] = places
    nlp.set_exchange_points(shares)


def _moving(nlp: CycleNLP, x: Array, cycle_peaks: Peaks) -> tuple[NLP, Array]:
    """Return the NLP with the positions of inner peaks as unknowns (cached), and its starting point."""
    key = f"following {cycle_peaks.inner}"
    if key not in nlp.cache:
        nlp.cache[key] = with_following_peaks(nlp, cycle_peaks.inner)
    moving: NLP = nlp.cache[key]
    count = len(cycle_peaks.inner)
    moving.set_bounds(np.append(nlp.x_low, np.zeros(count)), np.append(nlp.x_high, np.ones(count)))
    return moving, np.concatenate([x, [cycle_peaks.shares[slot] for slot, _ in cycle_peaks.inner]])


def with_following_peaks(nlp: CycleNLP, inner: tuple[tuple[int, int], ...]) -> NLP:
    """Return the NLP with the positions of inner peaks as unknowns; `inner`: see `Peaks`."""
    return with_places(nlp, nlp.slots, {slot: nlp.watched[index].height(nlp.exchanged[slot]) for slot, index in inner})


def with_moving_rows(nlp: NLP, keep: Sequence[int], slots: Sequence[int]) -> NLP:
    """Return some rows of an NLP; the first exchange points are unknowns, each where a row of `slots` has a maximum."""
    assert nlp.mapped is not None
    count = nlp.exchange_count
    reduced = replace(nlp, rows=tuple(nlp.rows[j] for j in keep), g_expression=nlp.g_expression[keep], cache={})
    heights = dict(enumerate(casadi.vertsplit(nlp.g_expression[slots])))
    places = casadi.vertsplit(nlp.p_symbol)[len(nlp.p) - count :][: len(slots)]
    terms = nlp.mapped.of_rows(keep).with_slopes(casadi.vertsplit(nlp.mapped.g[slots]), places)
    return with_places(reduced, count, heights, terms)


def with_places(nlp: NLP, slots: int, heights: Mapping[int, Any], terms: tuple[MappedTerms, Any] | None = None) -> NLP:
    """Return an NLP with some exchange points as additional unknowns: each where the derivative of a height vanishes.

    The last `slots` parameters of the NLP are the exchange points; `heights` has expressions of its x and p by the number of an
    exchange point. `terms`: the NLP by vectors of positions, and the derivatives of the heights by the exchange points in its
    terms; by default those of the NLP, and derivatives in terms of x and p.
    """
    n, first, count = len(nlp.variables), len(nlp.p) - slots, len(heights)
    x = casadi.SX.sym("x", n + count)
    slopes, p = [], casadi.vertsplit(nlp.p_symbol)
    for k, (slot, height) in enumerate(heights.items()):
        slopes.append(casadi.gradient(height, nlp.p_symbol[first + slot]))
        p[first + slot] = x[n + k]
    expressions = [nlp.f_expression, nlp.g_expression, nlp.residual_expression, casadi.vertcat(*slopes)]
    moved: tuple[list[Any], list[Any]] = ([nlp.x_symbol, nlp.p_symbol], [x[:n], casadi.vertcat(*p)])
    mapped, rates = terms or (nlp.mapped, expressions[-1])
    f, g, residual, slope, rates = map(casadi.densify, casadi.substitute([*expressions, rates], *moved))  # a slope may be zero
    at = np.array([nlp.p[first + slot] for slot in heights])
    names = [f"{PEAK} {k + 1}" for k in range(count)]
    return NLP(
        variables=(*nlp.variables, *(Variable(label, 1.0, PLAIN) for label in names)),
        fixed=nlp.fixed,
        rows=(*nlp.rows, *(ConstraintRow(PEAK, label, slope[k], 0.0, 0.0, PLAIN) for k, label in enumerate(names))),
        measure=nlp.measure,
        x_start=np.concatenate([nlp.x_start, at]),
        x_low=np.concatenate([nlp.x_low, np.zeros(count)]),
        x_high=np.concatenate([nlp.x_high, np.ones(count)]),
        p=nlp.p,
        x_symbol=x,
        p_symbol=nlp.p_symbol,
        f_expression=f,
        g_expression=casadi.vertcat(g, slope),
        residual_expression=residual,
        cycle=nlp.cycle,
        mapped=None if mapped is None else mapped.substituted(x, moved, rates),
        exact=nlp.exact,
        factor=nlp.factor,
        helpers=nlp.helpers | {PEAK, *names},
        states=nlp.states | {PEAK, *names},
    )


def peaks(nlp: CycleNLP, x: Array) -> Peaks:
    """Return the maxima of the watched terms along every stroke."""
    trace, edges, slots = nlp.traced, nlp.edges(x), nlp.slots // nlp.strokes
    inputs = trace.inputs(nlp.design(x))
    grid = np.linspace(0.0, 1.0, POSITIONS_PER_STROKE)
    shares = nlp.exchange_points  # earlier peaks are kept as far as there is room
    worst, tops, inner = -math.inf, [-math.inf] * len(nlp.watched), []
    for j in range(nlp.strokes):
        begin, span = edges[j], edges[j + 1] - edges[j]
        senses = np.asarray(trace.sensed([*inputs, begin + 0.5 * span]), dtype=float).ravel()

        def signals(at: Array, begin: float = begin, span: float = span, senses: Array = senses) -> Array:
            return trace.signals(*inputs, begin + span * at, *senses)

        summits: list[tuple[float, float, int]] = []
        whole = signals(grid)
        for index, watched in enumerate(nlp.watched):
            top = x[watched.level] if watched.level is not None else watched.bound
            size = max(abs(top), 1e-9)
            least = top - 1.1 * TRACKED_PEAK * size
            term_maxima = list(_local(watched, least, whole, grid, signals))
            summits += [((height - top) / size, at, index) for height, at in term_maxima]
            tops[index] = max([tops[index], *(height for height, _ in term_maxima)])
        if summits:
            worst = max(worst, max(summits)[0])
        chosen: list[float] = []
        for excess, at, index in sorted(summits, reverse=True):
            if excess < -TRACKED_PEAK or len(chosen) == slots:
                break
            if all(abs(at - other) > PEAK_SEPARATION for other in chosen):
                if excess > -MOVABLE and EDGE < at < 1.0 - EDGE:
                    inner.append((j * slots + len(chosen), index))
                chosen.append(at)
        for other in (*shares[j * slots : (j + 1) * slots].tolist(), *np.linspace(0.0, 1.0, 2 * slots).tolist()):
            if len(chosen) < slots and all(abs(other - at) > BESIDE for at in chosen):
                chosen.append(other)
        shares[j * slots : (j + 1) * slots] = chosen
    return Peaks(shares, worst, tuple(sorted(inner)), tuple(tops))


def _local(
    watched: WatchedTerm, least: float, whole: Array, grid: Array, signals: Callable[[Array], Array]
) -> Iterator[tuple[float, float]]:
    """Generate the refined local maxima (height, position) of a term along a stroke that are at least `least` high."""
    score = watched.score(whole)
    left, right = np.insert(score[:-1], 0, -np.inf), np.append(score[1:], -np.inf)
    for k in np.flatnonzero((score >= left) & (score > right) & (score >= least)).tolist():
        bracket = np.linspace(grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)], 9)
        at, values = maxima(lambda u: watched.score(signals(u))[None, :], bracket)
        yield float(values[0]), float(at[0])
