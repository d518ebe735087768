"""Exchange for function synthesis: locate the error peaks between the design positions and level them.

A round of the Remez exchange moves the exchange points to the peaks and solves the NLP again. Where fewer peaks than unknowns
determine the optimum, the shift of the peaks with the design matters, and these rounds alternate about it. Then the positions of
the peaks become unknowns too, the design moves within a radius, and a step is accepted if it lowers the largest peak.

References
----------
R. Hettich, K. O. Kortanek, Semi-infinite programming: theory, methods, and applications, SIAM Review 35 (1993) 380-429:
exchange; local reduction.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from optlink.errors import Status
from optlink.linkage.extrema import maxima
from optlink.linkage.motion import sweep
from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP
from optlink.problem.design import EPIGRAPH, DesignProblem
from optlink.solvers import multistart
from optlink.solvers.contract import CLOSE, MINIMAX, backend as solver
from optlink.solvers.newton import polish
from optlink.solvers.solution import Attempt, Solution

ALONG = 2001  # positions along the span at which the error is sampled
EXCHANGES, LEVELLED = 40, 1e-8  # rounds, and the share by which an error may exceed those at the positions of the NLP
POSITION_SEPARATION = 1e-4  # rad; closer positions count as one
PROGRESS = 0.1  # share of the excess of a round above which the next one lets the positions of the peaks move
TRACKED_PEAK = 0.3  # share of the largest peak by which another may be lower and still be tracked
REACH = 0.1  # share of the span by which the position of a peak may move in a step
RADIUS, SMALLEST, LARGEST = 0.1, 1e-6, 1.0  # scaled units: trust-region radius of the first step, and its range
GROWTH, ALL_BUT = 2.5, 0.9  # of the radius after a step of at least that share of it
SHARP = (1e-4, 1e-7, 1e-9)  # scaled units: active-set distances of Newton's method


def error_at(problem: DesignProblem, design: Mapping[str, float], offsets: Array) -> Array:
    """Return prescribed minus generated rocker angle [rad], in (-pi, pi], at crank rotations (n,) [rad] from the start."""
    target = problem.law.curve(offsets, design["phi0"], design["psi0"])
    motion = sweep(problem.linkage, problem.sizes(design), design["phi0"] + offsets)
    angle = np.asarray(motion.body_angle("rocker").value, dtype=float)
    return np.asarray(np.remainder(target - angle + np.pi, 2.0 * np.pi) - np.pi, dtype=float)


def error_function(problem: DesignProblem) -> Callable[[Mapping[str, float], Array], Array]:
    """Return the error [rad] as a function of design and crank rotations, enlarged by the tolerances for a robust requirement."""
    if problem.requirement.robust is None or problem.measure != "max":
        return lambda design, offsets: error_at(problem, design, offsets)
    from optlink.optimization.output_derivatives import ErrorResiduals

    judge = ErrorResiduals(problem)

    def widened(design: Mapping[str, float], offsets: Array) -> Array:
        lower, upper = judge.band(design, offsets)
        return np.where(np.abs(upper) >= np.abs(lower), upper, lower)

    return widened


@dataclass(frozen=True)
class ErrorPeak:
    """A local maximum of the size of the error [rad], at a crank rotation [rad] from the start; `sign` is that of the error."""

    at: float
    height: float
    sign: int


class _Exchange:
    """The exchange of one problem: its programme and its error over the whole range."""

    def __init__(self, problem: DesignProblem, nlp: NLP, backend: str) -> None:
        self.problem, self.nlp, self.backend = problem, nlp, backend
        self.grid = np.sort(np.linspace(0.0, problem.span, ALONG))
        self.ends = [0.0, problem.span]  # already positions of the NLP
        self.error = error_function(problem)

    def peaks(self, solution: Solution) -> list[ErrorPeak]:
        """Return the local maxima of the error of a design, largest first."""
        design = self.problem.design(solution.design)

        def size(angles: Array) -> Array:
            return np.abs(self.error(design, angles))

        grid, heights = self.grid, size(self.grid)
        tops = np.flatnonzero((heights >= np.append(heights[1:], 0.0)) & (heights >= np.insert(heights[:-1], 0, 0.0)))
        peaks = []
        for k in tops[heights[tops] >= (1.0 - TRACKED_PEAK) * np.max(heights)].tolist():
            bracket = np.linspace(grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)], 9)
            at, height = maxima(lambda angles: size(angles)[None, :], bracket)
            peaks.append(ErrorPeak(float(at[0]), float(height[0]), 1 if float(self.error(design, at)[0]) >= 0.0 else -1))
        return sorted(peaks, key=lambda peak: -peak.height)

    def placed(self, solution: Solution, peaks: list[ErrorPeak]) -> Solution:
        """Return the same design with the exchange points at its peaks, and thus with its largest error as objective."""
        self._place([peak.at for peak in peaks])
        return multistart.solution_at(self.nlp, solution.x, solution.message)

    def solved(self, solution: Solution, peaks: list[ErrorPeak], earlier: list[float]) -> Solution:
        """Return the optimum with the exchange points at the peaks; positions of `earlier` rounds are kept if there is room.

        Where the error is flat, two designs would otherwise alternate. The trust-region method of `optlink.solvers.minimax`
        stays at the optimum where it started.
        """
        design = self.problem.design(solution.design)
        new = [peak.at for peak in peaks if _apart(peak.at, self.ends)]
        kept = [at for at in earlier if _apart(at, new)]
        kept.sort(key=lambda at: -abs(float(self.error(design, np.array([at]))[0])))
        earlier[:] = self._place(new + kept)
        solved = multistart.solve_from(self.nlp, solution.x, MINIMAX)
        return solved if solved.status is Status.OPTIMAL else multistart.solve_from(self.nlp, solution.x, self.backend)

    def followed(self, solution: Solution, peaks: list[ErrorPeak], radius: float) -> list[Solution]:
        """Return points within a radius at which the peaks are level, their positions being unknowns: by Newton, and by IPOPT."""
        nlp, n = self.nlp, len(solution.x)
        chosen = sorted((peak for peak in peaks[: nlp.exchange_count] if _apart(peak.at, self.ends)), key=lambda peak: peak.at)
        if not chosen:
            return []
        start = self.placed(solution, chosen)
        moving = self._with_moving_peaks(tuple(peak.sign for peak in chosen))
        moving.p[:] = nlp.p
        x = np.append(start.x, [peak.at for peak in chosen])
        p, reach = multistart.scaled_parameters(moving, x), REACH * abs(self.problem.span)
        low, high = x - radius, x + radius
        low[n:], high[n:] = np.maximum(x[n:] - reach, self.grid[0]), np.minimum(x[n:] + reach, self.grid[-1])
        low[:n], high[:n] = np.maximum(low[:n], nlp.x_low), np.minimum(high[:n], nlp.x_high)
        low[n - 1], high[n - 1] = 0.0, math.inf  # the largest error
        moving.set_bounds(low, high)
        begin = Attempt(x, 0, "peaks followed")
        tries = (polish(moving, begin, p, near) for near in SHARP)
        newton = next((end for end in tries if not np.array_equal(end.x, x)), begin)
        ends = [newton, polish(moving, solver(CLOSE)(moving, x, p, tight=True), p)]
        return [multistart.solution_at(nlp, end.x[:n], end.message) for end in ends if np.all(np.isfinite(end.x))]

    def _place(self, offsets: list[float]) -> list[float]:
        """Set the exchange points; those that are not needed repeat the start. Return the positions for which there is room."""
        nlp = self.nlp
        places = np.zeros(nlp.exchange_count)
        places[: len(offsets)] = offsets[: nlp.exchange_count]
        nlp.set_exchange_points(places)
        return offsets[: nlp.exchange_count]

    def _with_moving_peaks(self, signs: tuple[int, ...]) -> NLP:
        """Return the programme (cached) with the positions of peaks as unknowns, and of the other positions the ends alone."""
        nlp, (first, each) = self.nlp, self.nlp.exchange_rows
        key = f"following peaks {signs}"
        if key not in nlp.cache:
            from optlink.solvers.semi_infinite import with_moving_rows

            limits = [j for j in range(first) if nlp.rows[j].limit != EPIGRAPH]
            fixed = [j for j in range(first) if nlp.rows[j].limit == EPIGRAPH]
            moved = range(first, first + each * len(signs))
            keep = [*limits, *fixed[:each], *fixed[-each:], *moved]
            slots = [first + each * k + (0 if sign > 0 else each - 1) for k, sign in enumerate(signs)]
            nlp.cache[key] = with_moving_rows(nlp, keep, slots)
        moving: NLP = nlp.cache[key]
        return moving


def add_peak_errors(problem: DesignProblem, nlp: NLP, solution: Solution, backend: str) -> Solution:
    """Level the largest errors between the design positions, until none exceeds those at the positions of the NLP.

    `backend` is used where the minimax method does not end at an optimum. A design whose peaks do not become level is returned as
    stalled, with its largest error over the range as objective.
    """
    if not solution.usable:
        return solution
    exchange = _Exchange(problem, nlp, backend)
    peaks, earlier, radius = exchange.peaks(solution), list[float](), RADIUS
    best, slow = (solution, peaks), False
    for _ in range(EXCHANGES):
        excess = _excess(solution, peaks)
        if (excess <= 0.0 and solution.status is Status.OPTIMAL) or radius < SMALLEST:
            break
        if not slow:
            moved = exchange.solved(solution, peaks, earlier)
            there = exchange.peaks(moved) if moved.usable else []
            slow = not there or _excess(moved, there) > PROGRESS * excess
            if there:
                solution, peaks = moved, there
                best = min(best, (moved, there), key=lambda design: design[1][0].height)
            continue
        solution, peaks = exchange.placed(*best), best[1]
        for moved in exchange.followed(solution, peaks, radius):
            if not moved.usable:
                continue
            there = exchange.peaks(moved)
            moved = exchange.placed(moved, there)
            levelled = moved.status is Status.OPTIMAL and _excess(moved, there) <= 0.0
            if there[0].height < peaks[0].height or (levelled and there[0].height <= peaks[0].height * (1.0 + LEVELLED)):
                length = float(np.max(np.abs(moved.x - solution.x)[:-1], initial=0.0))
                radius = min(GROWTH * radius, LARGEST) if length > ALL_BUT * radius else radius
                solution, peaks = best = moved, there
                break
        else:
            radius *= 0.25
    if solution.status is Status.OPTIMAL and _excess(solution, peaks) <= 0.0:
        return solution
    return replace(exchange.placed(*best), status=Status.STALLED, message="the largest errors did not become level")


def place_at_peaks(problem: DesignProblem, nlp: NLP, x: Array) -> None:
    """Move the exchange points, if there are any, to the peaks of the error of a design."""
    if nlp.exchange_count:
        exchange, solution = _Exchange(problem, nlp, ""), multistart.solution_at(nlp, x, "")
        exchange.placed(solution, exchange.peaks(solution))


def _excess(solution: Solution, peaks: list[ErrorPeak]) -> float:
    """Return by how much the largest peak exceeds the errors at the positions of the NLP, beyond rounding."""
    return peaks[0].height - (solution.objective * (1.0 + LEVELLED) + 1e-12)


def _apart(at: float, others: list[float]) -> bool:
    """Return whether a position [rad] differs from all others."""
    return min((abs(at - other) for other in others), default=math.inf) > POSITION_SEPARATION
