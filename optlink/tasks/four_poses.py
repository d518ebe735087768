"""Dyads of a problem with four poses: their curves, the best four-bars of two of them, and the four-bar of two given ones."""

from __future__ import annotations

import cmath
import math
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.errors import InputError
from optlink.linkage.mechanism import Arm
from optlink.linkage.vector2d import Array
from optlink.problem.arguments import typed
from optlink.problem.design import DesignProblem
from optlink.problem.file import AnyProblem, ProblemFile, problem_of
from optlink.problem.requirements.base import MARK, pose_angles
from optlink.problem.terms import Goal
from optlink.synthesis.five_poses import Complex, FourBarSolution, link
from optlink.synthesis.four_poses import DEFECTS, POSES, DyadCurves, Pairs, curves, dyads_of_joint, pairs
from optlink.tasks.five_targets import CONDITIONS, FiveTargets, alone, applies as of_five_targets, marked
from optlink.tasks.results.design import SynthesisResult, of_designs
from optlink.tasks.results.exact import ExactSolutions
from optlink.units import count_noun

MOST = 400  # dyads that are drivers and followers of all pairs
APART = 0.04  # least distance of listed pairs along one of the curves, as a share of the dyads
KINDS_OF = {2: "two poses with given joints", 3: "three poses with given joints", POSES: "four poses"}
DESIGNS = 6  # largest number of listed four-bars
TRIED = 40  # largest number of four-bars that are validated
FRAME_LENGTH = "frame length"
MEASURED, CLIMBED = 100, 3  # pairs of dyads of which a quantity is measured, and best ones that are improved
STEPS = (9, 3, 1)  # of the dyads along a curve, to better ones


def curves_of(task: DesignProblem) -> DyadCurves | None:
    """Return the dyads of the poses of a requirement; None unless they are four."""
    columns = task.data.columns
    if task.requirement.kind != "motion" or len(columns) != POSES or not task.target_points.posed.all():
        return None
    return curves(columns[:, 0] + 1j * columns[:, 1], np.unwrap(pose_angles(columns)))


def applies(task: DesignProblem) -> bool:
    """Return whether each four-bar of two dyads of four poses is a design of a problem, but for its bounds and limits."""
    return _guided(task, POSES) and len(task.free) >= CONDITIONS


def _guided(task: DesignProblem, count: int) -> bool:
    """Return whether the coupler of a four-bar takes a number of poses with free timing."""
    guided = alone(task, count) and task.requirement.kind == "motion" and task.timing == "free"
    return guided and bool(task.target_points.posed.all()) and marked(task)


def joints_given(task: DesignProblem) -> bool:
    """Return whether a problem of two or three poses fixes both pivots or both moving points of the body, and nothing else."""
    return (_guided(task, 2) or _guided(task, 3)) and _sides(task) is not None


def _sides(task: DesignProblem) -> tuple[DyadCurves, DyadCurves] | None:
    """Return the dyads of crank and rocker: all of four poses, else those with the joints that are given; None without them."""
    if (found := curves_of(task)) is not None:
        return found, found
    loop, values, free = task.four_bar, task.design({}), set(task.free)
    assert loop is not None
    mark = task.linkage.marks[loop.coupler.body, task.point]
    frame, body = {*loop.ground}, {loop.names[1], str(mark.along), str(mark.across), MARK}
    fixed, begin = not frame & free, loop.pivots[0]
    if free != {loop.names[0], loop.names[2]} | (body if fixed else frame) or not (fixed or len(frame) == 4):
        return None
    if isinstance(begin, Arm) or any(task.quantities[name].equals for name in (frame if fixed else body)):
        return None

    def size(part: Any) -> float:
        return float(values[part] if isinstance(part, str) else part)

    columns = task.data.columns
    places, angles = columns[:, 0] + 1j * columns[:, 1], np.unwrap(pose_angles(columns))
    end, one = loop.pivots[1], complex(*map(size, begin))
    if not fixed:
        backwards = loop.coupler.start != loop.pin
        way = cmath.exp(1j * (float(angles[0]) - values[MARK]))  # from the start of the coupler to its end
        along, beside = way * size(loop.coupler.length), way * complex(size(mark.along), size(mark.across))
        one, other = complex(places[0]) - beside, complex(places[0]) - beside + along
        one, other = (other, one) if backwards else (one, other)
    elif isinstance(end, Arm):
        other = one + cmath.rect(size(end.length), size(end.direction))
    else:
        other = complex(*map(size, end))
    crank, rocker = (dyads_of_joint(places, angles, joint, fixed=fixed) for joint in (one, other))
    return crank, rocker


def _spread(side: DyadCurves) -> NDArray[Any]:
    """Return rows of finite dyads, evenly over their curves, at most `MOST`."""
    finite = np.flatnonzero(~np.isnan(side.points[:, 0]))
    return finite[np.unique(np.linspace(0, len(finite) - 1, MOST).astype(int))] if len(finite) else finite


class FourTargets(FiveTargets):
    """The best four-bars of two dyads of four poses, or of two or three ones with given joints; see `applies`, `joints_given`.

    `files`: the problem with definite assembly modes.
    """

    def __init__(self, files: Sequence[ProblemFile], goal: Goal | None = None, chosen: tuple[int, int] | None = None) -> None:
        found = _sides(files[0].spec)
        assert found is not None
        self.curves, self.followers = found
        self.chosen, self.sentence = chosen, self.curves.special or self.followers.special
        super().__init__(files, goal)
        self.found = self.found[:DESIGNS]

    def _solved(self) -> tuple[ExactSolutions, Sequence[FourBarSolution]]:
        """Return how many pairs of dyads pass the poses, and varied four-bars that do so within the bounds, best first."""
        found = self.curves
        points, _ = found.dyads
        for row in self.chosen or ():
            if not 0 <= row < len(points) or np.isnan(points[row]):
                message = found.special or "no dyad of finite lengths"
                raise InputError(message, "Give a row of `dyad_curves`", self.files[0].file, "driver, follower", row)
        note = "; ".join(dict.fromkeys(filter(None, (found.note, self.followers.note))))
        if len(points) == len(self.followers.points) == 1:  # three poses: their only four-bar
            finite = [not np.isnan(side.dyads[0][0]) for side in (found, self.followers)]
            counts = ExactSolutions(KINDS_OF[3], 2, 2, 0, 2 - sum(finite), "", False, (), roots=2, counted="dyads", note=note)
            return counts, [self._four_bar(0, 0)] if all(finite) else []
        rows = [self.chosen] if self.chosen else [] if self.sentence else list(self._best())
        counts = ExactSolutions(KINDS_OF[len(found.places)], 0, 0, 0, 0, self.sentence, False, (), note=note)
        return counts, [self._four_bar(i, k) for i, k in rows]

    def _four_bar(self, driver: int, follower: int) -> FourBarSolution:
        """Return the four-bar of two dyads."""
        rows = (self.curves, driver), (self.followers, follower)
        crank, rocker = (link(side.dyads[0][row], side.dyads[1][row], side.size) for side, row in rows)
        return FourBarSolution(crank, rocker, self.curves.places, self.curves.angles)

    def _best(self) -> Iterator[tuple[int, int]]:
        """Yield driver and follower of varied pairs, the best one first, and compose the sentence."""
        found, task = self.curves, self.task
        cranks, rows = _spread(found), _spread(self.followers)
        drivers = cranks[found.in_order[cranks]]
        driving = len(drivers) / max(1, len(cranks))
        b, a, e, c = self._joints(drivers, rows)
        every = pairs(found.places, found.angles, (b, a), (e, c))
        turning = every.turns | (task.limits.crank == "span")
        passing = (every.defect == 0) & turning
        inside = passing & self._inside(drivers, rows)
        count, curve = inside.size, count_noun(found.count, "closed curve")
        curve = curve if len(found.places) == POSES else "a line"
        shares = {name: np.mean(every.defect == k) for k, name in enumerate(DEFECTS[:4]) if name}
        shares["crank does not turn"] = np.mean((every.defect == 0) & ~turning)
        reasons = ", ".join(f"{name} {share:z.0%}" for name, share in shares.items() if share >= 0.005)
        self.sentence = (
            f"{curve} of dyads, of which {driving:z.0%} may drive; {np.mean(passing):z.1%} of {count} four-bars "
            f"pass the poses in order (not: {reasons}), {np.mean(inside):z.1%} within the bounds"
        )
        value, limit = self._transmission(every), task.limits.transmission_angle
        least = 0.0 if limit is None else min(limit.low or 0.0, math.pi - (limit.high or math.pi))
        measure = np.where(inside & (value > 0.0) & (value >= least), value, -math.inf)
        near_crank, near_rocker = (max(1, round(APART * len(side))) for side in (cranks, rows))
        places = np.searchsorted(cranks, drivers)

        def varied(measure: Array, most: int) -> Iterator[tuple[int, int]]:
            measure = measure.copy()
            for _ in range(most):
                i, k = map(int, np.unravel_index(int(np.argmax(measure)), measure.shape))
                if measure[i, k] == -math.inf:
                    return
                yield i, k
                near = np.abs(places - places[i])[:, None] <= near_crank
                measure[near & (np.abs(np.arange(len(rows)) - k)[None, :] <= near_rocker)] = -math.inf

        if self.goals:
            measure = self._measured(np.isfinite(measure), [*varied(measure, DESIGNS)], drivers, rows)
        yield from ((int(drivers[i]), int(rows[k])) for i, k in varied(measure, TRIED))

    def _measured(self, passing: NDArray[np.bool_], first: Sequence[tuple[int, int]], drivers: Array, followers: Array) -> Array:
        """Return how good pairs are by the quantity that ranks them, -inf of those that are not measured.

        Lengths are known of all `passing` ones; else the `first` and a grid of them are measured, and the ways from the best to
        better neighbours.
        """
        lengths, ranked = self._lengths(drivers, followers), self._ranked
        if ranked is not None and (known := lengths.get(ranked.of or ranked.quantity)) is not None:
            return np.where(passing, -self._sense * known, -math.inf)
        good, seen = np.full(passing.shape, -math.inf), ~passing

        def measured(i: int, k: int) -> float:
            if not seen[i, k]:
                seen[i, k] = True
                found = self._judged(self._four_bar(drivers[i], followers[k]))
                if found is not None and found.solution.usable:
                    good[i, k] = -self._rank(found.solution)
            return float(good[i, k])

        places = np.argwhere(passing)
        for i, k in (*first, *places[:: max(1, len(places) // MEASURED)]):
            measured(i, k)
        shape: Array = np.array(good.shape)
        for start in np.argsort(good, axis=None)[::-1][:CLIMBED]:
            at = np.array(np.unravel_index(int(start), good.shape))
            for step in STEPS:
                while True:
                    near = [(at + step * np.array(way)) % shape for way in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1))]
                    best = max(near, key=lambda one: measured(*one))
                    if not measured(*best) > good[tuple(at)]:
                        break
                    at = best
        self.sentence += f"; of {int(np.sum(good > -math.inf))} of these the {self._words} was measured"
        return good

    def _transmission(self, every: Pairs) -> Array:
        """Return the least transmission angle [rad] over the range that the problem limits, as far as it is known."""
        return every.around if self.task.limits.transmission_range == "revolution" else every.transmission

    def _joints(self, drivers: Array, followers: Array) -> tuple[Complex, Complex, Complex, Complex]:
        """Return crank pins, crank pivots, rocker pins and rocker pivots of rows of the dyads as complex numbers."""
        (b, a), (e, c) = self.curves.dyads, self.followers.dyads
        return b[drivers], a[drivers], e[followers], c[followers]

    def _lengths(self, drivers: Array, followers: Array) -> dict[str, Array]:
        """Return lengths and pivots [m] of pairs by name, "frame length" and "total length" too, (drivers, followers)."""
        loop, (b, a, e, c) = self.task.four_bar, self._joints(drivers, followers)
        assert loop is not None
        b, a = b[:, None], a[:, None]
        named = dict(zip(loop.names, (np.abs(b - a), np.abs(e - b), np.abs(e - c)), strict=True))
        for place, at in zip(loop.pivots, (a, c), strict=True):
            parts = {place.length: np.abs(c - a)} if isinstance(place, Arm) else {place[0]: at.real, place[1]: at.imag}
            named |= {name: value for name, value in parts.items() if isinstance(name, str)}
        total = np.abs(b - a) + np.abs(e - b) + np.abs(e - c) + np.abs(c - a)
        return named | {FRAME_LENGTH: np.abs(c - a), "total length": total}

    def _inside(self, drivers: Array, followers: Array) -> Array:
        """Return whether the lengths and pivots of pairs lie within their bounds (drivers, followers)."""
        named, quantities, size = self._lengths(drivers, followers), self.task.quantities, 1e-9 * self.curves.size
        ranges = [(value, *quantities[name].bounds) for name, value in named.items() if name in quantities]
        if (frame := self.task.limits.frame_length) is not None:
            ranges.append((named[FRAME_LENGTH], frame.low or 0.0, math.inf if frame.high is None else frame.high))
        inside = np.ones((len(drivers), len(followers)), dtype=bool)
        for value, low, high in ranges:
            inside &= (value >= low - size) & (value <= high + size)
        return inside


CHEAP = ((FiveTargets, of_five_targets), (FourTargets, applies), (FourTargets, joints_given))
"""Exact solutions with which a search begins, and which problems have them."""


@typed
def dyad_curves(problem: AnyProblem) -> DyadCurves:
    """Trace the curves of all dyads that guide a body through four poses: Burmester's circle-point and centre-point curve.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        A problem with a requirement `kind = "motion"` of four poses, of any linkage.

    Returns
    -------
    DyadCurves
        `points` and `pivots` of the dyads (n, 2) [m]; `in_order`, the possible drivers; `partners`, the defects of four-bars.

    Raises
    ------
    InputError
        If the problem does not have four poses.

    Examples
    --------
    >>> curves = optlink.synthesis.dyad_curves("motion-4-poses")
    >>> curves.points.shape == curves.pivots.shape, len(curves.poles)
    (True, 6)
    """
    problem = problem_of(problem)
    found = next(filter(None, (curves_of(part) for part in problem.variants()[0].spec.parts)), None)
    if found is None:
        message = "only four poses have curves of dyads"
        raise InputError(message, "Give four poses; for five take optlink.synthesis.exact", problem.file, "requirement")
    return found


@typed
def four_bar_of_dyads(problem: AnyProblem, driver: int, follower: int) -> SynthesisResult:
    """Join two dyads of four poses to a four-bar, and validate it.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        A four-bar for four poses with free timing, all dimensions of which are design variables.
    driver, follower : int
        Rows of the dyads in `dyad_curves`.

    Returns
    -------
    SynthesisResult

    Raises
    ------
    InputError
        If the problem is of another kind, or if the four-bar does not pass the poses in order.

    Examples
    --------
    >>> curves = optlink.synthesis.dyad_curves("motion-4-poses")
    >>> driver = int(np.flatnonzero(curves.in_order)[100])
    >>> partners = curves.partners([driver])
    >>> follower = int(np.argmax(np.where(partners.defect[0] == 0, partners.around[0], 0.0)))
    >>> optlink.synthesis.four_bar_of_dyads("motion-4-poses", driver, follower).best.exact
    True
    """
    problem = problem_of(problem)
    if not applies(problem.variants()[0].spec):
        message, remedy = "only four poses of a four-bar with free timing are met by any two dyads", "Leave all dimensions free"
        raise InputError(message, remedy, problem.file, "requirement")
    clock = time.perf_counter()
    targets = FourTargets(problem.variants(), chosen=(driver, follower))
    if not targets.found or targets.found[0].design is None:
        reasons = ", ".join(reason for one in targets.found for reason in one.solution.reasons) or DEFECTS[-1]
        message = f"the four-bar of these dyads does not pass the poses: {reasons}"
        remedy = "Take a partner for which `partners` finds no defect"
        raise InputError(message, remedy, problem.file, "driver, follower", [driver, follower])
    return of_designs(problem, [targets.found[0].design], 1, seconds={"solve and validate": time.perf_counter() - clock})
