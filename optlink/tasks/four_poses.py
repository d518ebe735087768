"""Families of linkages that meet the targets of a problem: the best ones, curves of dyads, and the four-bar of two given ones."""

import cmath
import math
import time
from collections.abc import Iterator, Mapping, Sequence
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
from optlink.synthesis.families import Family, FunctionFamily, PoseFamily, TimedFamily
from optlink.synthesis.five_poses import FourBarSolution
from optlink.synthesis.four_poses import DEFECTS, POSES, DyadCurves, Positions, curves, dyads_of_joint
from optlink.tasks.five_targets import (
    CRANKS,
    FiveTargets,
    ThreePoints,
    alone,
    applies as of_five_targets,
    determined,
    given_starts,
    in_words,
    loop_of,
    marked,
    places_of,
    quantities_of,
    rises,
)
from optlink.tasks.results.design import SynthesisResult, of_designs
from optlink.tasks.results.exact import BY_TRANSMISSION, MOST_CAUSES, ExactSolution, ExactSolutions
from optlink.units import count_noun
from optlink.validation.check import grashof_check

MOST = 400  # dyads that are drivers and followers of all pairs
APART = 0.04  # least distance of listed pairs along one of the curves, as a share of the dyads
TARGETS = ("timed points", "points of a function")
KINDS_OF = {2: "two poses with given joints", 3: "three poses with given joints", POSES: "four poses"}
DESIGNS = 6  # largest number of listed four-bars
TRIED = 40  # largest number of four-bars that are validated
TOTAL_LENGTH = "total length"
ROUNDED = 1e-9  # share of the size of a linkage by which rounding moves it beyond a bound
NO_LINKAGE = len(DEFECTS) - 1
MEASURED, CLIMBED = 100, 3  # pairs of dyads of which a quantity is measured, and best ones that are improved
STEPS = (9, 3, 1)  # of the dyads along a curve, to better ones
GRIDS, FINER, LAST = 40, 4, 1e-3  # most grids about a best pair, how much finer each is than the former, and the finest one


def curves_of(task: DesignProblem) -> DyadCurves | None:
    """Return the dyads of the poses of a requirement; None unless they are four."""
    columns = task.data.columns
    if task.requirement.kind != "motion" or len(columns) != POSES or not task.target_points.posed.all():
        return None
    return curves(places_of(task), np.unwrap(pose_angles(columns)))


def applies(task: DesignProblem) -> bool:
    """Return whether a problem has four poses, timed points, or points of a function, which leave a family of linkages."""
    return determined(task, POSES)


def guided(task: DesignProblem) -> bool:
    """Return whether each four-bar of two dyads of four poses is a design of a problem, but for its bounds and limits."""
    return task.requirement.kind == "motion" and applies(task)


def _guided(task: DesignProblem, count: int) -> bool:
    """Return whether the coupler of a four-bar takes a number of poses with free timing."""
    guided = alone(task, count) and task.requirement.kind == "motion" and task.timing == "free"
    return guided and bool(task.target_points.posed.all()) and marked(task)


def joints_given(task: DesignProblem) -> bool:
    """Return whether a problem of two or three poses fixes both pivots or both moving points of the body, and nothing else."""
    return (_guided(task, 2) or _guided(task, 3)) and _sides(task) is not None


def family_of(task: DesignProblem) -> Family:
    """Return the linkages that meet the targets of a problem, which `applies` or `joints_given` accepts."""
    if task.law_given:
        return FunctionFamily(task.law.offsets, rises(task), task.slides)
    if task.requirement.kind == "path":
        assert task.data.offsets is not None
        return TimedFamily(places_of(task), task.data.offsets)
    sides = _sides(task)
    assert sides is not None
    return PoseFamily(*sides)


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

    columns, joints = task.data.columns, joints_at(task, values)
    places, angles = columns[:, 0] + 1j * columns[:, 1], np.unwrap(pose_angles(columns))
    one, other = joints[:2] if fixed else joints[2:]
    crank, rocker = (dyads_of_joint(places, angles, joint, fixed=fixed, reach=abs(other - one)) for joint in (one, other))
    return crank, rocker


def joints_at(task: DesignProblem, values: Mapping[str, float]) -> tuple[complex, complex, complex, complex]:
    """Return pivots and moving points [m] of a four-bar of quantities [SI] at the first pose, those of the crank first."""
    loop = task.four_bar
    assert loop is not None
    (begin, end), columns = loop.pivots, task.data.columns
    assert not isinstance(begin, Arm)

    def size(part: Any) -> float:
        return float(values[part] if isinstance(part, str) else part)

    pivot = complex(*map(size, begin))
    fixed = pivot + cmath.rect(size(end.length), size(end.direction)) if isinstance(end, Arm) else complex(*map(size, end))
    mark = task.linkage.marks[loop.coupler.body, task.point]
    way = cmath.exp(1j * (float(pose_angles(columns)[0]) - values[MARK]))  # from the start of the coupler to its end
    start = complex(*columns[0, :2]) - way * complex(size(mark.along), size(mark.across))
    ends = (start, start + way * size(loop.coupler.length))
    return (pivot, fixed, *ends) if loop.coupler.start == loop.pin else (pivot, fixed, *ends[::-1])


def _spread(side: DyadCurves, most: int) -> Array:
    """Return rows of finite dyads, evenly over their curves, at most `most`."""
    finite = np.flatnonzero(~np.isnan(side.dyads[0]))
    spread = finite[np.unique(np.linspace(0, len(finite) - 1, most).astype(int))] if len(finite) else finite
    return spread.astype(float)


class FourTargets(FiveTargets):
    """The best linkages of a family that four targets leave, or two or three poses with given joints; see `family_of`.

    `files`: the problem with definite assembly modes.
    """

    def __init__(self, files: Sequence[ProblemFile], goal: Goal | None = None, chosen: tuple[float, float] | None = None) -> None:
        self.family = family_of(files[0].spec)
        self.curves, self.followers = self.family.drivers, self.family.followers
        self.chosen = chosen
        self.sentence = in_words(files[0].spec, self.curves.special or self.followers.special)
        super().__init__(files, goal)
        self.found = self.found[:DESIGNS]

    def _solved(self) -> tuple[ExactSolutions, Sequence[FourBarSolution]]:
        """Return how many linkages meet the targets, and varied ones that do so within the bounds, best first."""
        curves, task = self.curves, self.task
        for row, count in zip(self.chosen or (), (len(curves.points), len(self.family.rows)), strict=False):
            if not 0 <= row < count:
                message = curves.special or "no dyad of finite lengths"
                raise InputError(message, "Give a row of `dyad_curves`", self.files[0].file, "driver, follower", row)
        note = "; ".join(dict.fromkeys(filter(None, (curves.note, self.followers.note))))
        if len(curves.points) == len(self.followers.points) == 1:  # three poses: their only four-bar
            finite = [not np.isnan(side.dyads[0][0]) for side in (curves, self.followers)]
            counts = ExactSolutions(KINDS_OF[3], 2, 2, 0, 2 - sum(finite), "", False, (), roots=2, counted="dyads", note=note)
            return counts, [self._linkage(0, 0)] if all(finite) else []
        rows = [self.chosen] if self.chosen else [] if self.sentence else list(self._best())
        kind = KINDS_OF[len(curves.places)] if task.requirement.kind == "motion" else f"four {TARGETS[task.law_given]}"
        linkage = "four-bar" if task.four_bar else "slider-crank"
        counts = ExactSolutions(kind, 0, 0, 0, 0, self.sentence, False, (), linkage, note=note)
        found = [self.family.positions(np.array([float(i)]), np.array([float(k)])) for i, k in rows]
        return counts, [one[0, 0] for one in found if one.pairs.defect[0, 0] != NO_LINKAGE]

    def _linkage(self, driver: float, follower: float) -> FourBarSolution:
        """Return the linkage of two rows of the family."""
        return self.family.positions(np.array([driver], dtype=float), np.array([follower], dtype=float))[0, 0]

    def _passing(self, driver: float, follower: float) -> ExactSolution | None:
        """Return the linkage of two rows of the family if it passes all checks."""
        found = self._judged(self._linkage(driver, follower))
        return found.solution if found is not None and found.solution.usable else None

    def _best(self) -> Iterator[tuple[float, float]]:
        """Yield driver and follower of varied pairs, the best one first, and compose the sentence."""
        family, task = self.family, self.task
        cranks = _spread(self.curves, family.most)
        rows = family.rows if len(family.rows) <= MOST else _spread(self.followers, MOST)
        drivers = cranks[family.may_drive(cranks)]
        driving = len(drivers) / max(1, len(cranks))
        found = family.positions(drivers, rows)
        every = found.pairs
        turned = turning(task, found)
        passing, inside = (every.defect == 0) & turned, usable(self.files, found)
        closing = np.isfinite(found.joint[..., 0]) & np.isfinite(found.pin[..., 0])
        count = int(np.sum(closing))
        curve = count_noun(self.curves.count, "closed curve") if self.curves.count else "a line"
        shares = {name: np.sum((every.defect == k) & closing) for k, name in enumerate(DEFECTS) if name}
        shares["crank does not turn"] = np.sum((every.defect == 0) & ~every.turns & ~turned)
        shares[f"no {CRANKS[task.limits.crank == 'double-crank']}"] = np.sum((every.defect == 0) & every.turns & ~turned)
        reasons = ", ".join(f"{name} {share / count:z.0%}" for name, share in shares.items() if share >= 0.005 * count)
        drive = f", of which {driving:z.0%} may drive" if task.requirement.kind == "motion" else ""
        self.sentence = (
            f"{curve} of {family.noun}{drive}; {np.sum(passing) / max(1, count):z.1%} of {count} {self._made} pass the "
            f"{self.passed} in order (not: {reasons}), {np.sum(inside) / max(1, count):z.1%} within the bounds and limits"
        )
        if np.any(passing) and not np.any(inside):
            met = sorted(
                (np.mean(np.broadcast_to(met, passing.shape)[passing]), name) for name, met in _conditions(self.files, found)
            )[:MOST_CAUSES]
            excluded = ", ".join(f"{name} ({1.0 - share:z.0%})" for share, name in met if share < 1.0)
            self.sentence += f"; of those that pass, these exclude: {excluded}"
        measure = self._score(found)
        near_crank, near_rocker = (max(1, round(APART * len(side))) for side in (cranks, rows))
        places = np.searchsorted(cranks, drivers)

        def varied(measure: Array, most: int) -> Iterator[tuple[int, int]]:
            measure = measure.copy()
            for _ in range(most if measure.size else 0):
                i, k = map(int, np.unravel_index(int(np.argmax(measure)), measure.shape))
                if measure[i, k] == -math.inf:
                    return
                yield i, k
                near = np.abs(places - places[i])[:, None] <= near_crank
                measure[near & (np.abs(np.arange(len(rows)) - k)[None, :] <= near_rocker)] = -math.inf

        known = self._known(found) is not None
        steps = [float(np.median(np.diff(side))) if len(side) > 1 else 0.0 for side in (cranks, rows)]

        def pairs_of(measure: Array) -> list[Array]:
            return [np.array([drivers[i], rows[k]], dtype=float) for i, k in varied(measure, TRIED)]

        first = pairs_of(measure)
        if known:
            better = sorted((self._refined(pair, steps) for pair in first[: family.refined]), key=lambda one: -one[0])
            first = [*(pair for _, pair in better), *first]
        if first and not (known and self._passing(*first[0])):  # what ranks or excludes them is known of validated ones alone
            first = pairs_of(self._measured(np.isfinite(measure), [*varied(measure, DESIGNS)], drivers, rows))
        room, kept = np.array([near_crank, near_rocker]) * steps, list[Array]()
        for pair in first:
            if not any(np.all(np.abs(pair - other) <= room) for other in kept):  # climbed to one that is listed
                kept.append(pair)
                yield float(pair[0]), float(pair[1])

    def _refined(self, pair: Array, steps: Sequence[float]) -> tuple[float, Array]:
        """Return the best pair near a pair of rows and its score, on grids about the best one, finer where none is better."""
        share, best = 1.0, -math.inf
        for _ in range(GRIDS):
            grid = share * np.linspace(-1.0, 1.0, 2 * FINER + 1)
            window = [np.unique(at + step * grid) for at, step in zip(pair, steps, strict=True)]
            score = self._score(self.family.positions(*window))
            i, k = np.unravel_index(int(np.argmax(score)), score.shape)
            if not score[i, k] > best:
                share /= FINER
                if share < LAST:
                    break
                continue
            best, pair = float(score[i, k]), np.array([window[0][i], window[1][k]])
        return best, pair

    def _score(self, found: Positions) -> Array:
        """Return how good linkages are by what ranks them if it is known in closed form, else by their transmission angle.

        It is -inf of those that are not `usable`.
        """
        known = self._known(found)
        return np.where(usable(self.files, found), angles_of(self.task, found) if known is None else known, -math.inf)

    def _known(self, found: Positions) -> Array | None:
        """Return what ranks linkages, the largest one best, if it is known in closed form: lengths, the transmission angle."""
        if not self.goals:
            return angles_of(self.task, found)
        ranked = self._ranked
        if ranked is None or ranked.quantity not in ("length", TOTAL_LENGTH):
            return None
        named = quantities_of(self.task, found)
        if (loop := self.task.four_bar) is not None:
            named[TOTAL_LENGTH] = sum((named[name] for name in loop.names), frame_of(self.task, found))
        size = named.get(ranked.of or TOTAL_LENGTH)
        return None if size is None else -self._sense * size

    @property
    def _made(self) -> str:
        return "four-bars" if self.task.four_bar else "slider-cranks"

    @property
    def passed(self) -> str:
        """What the linkages pass, in words."""
        return "poses" if self.task.requirement.kind == "motion" else "positions" if self.task.law_given else "points"

    def _measured(self, passing: NDArray[np.bool_], first: Sequence[tuple[int, int]], drivers: Array, followers: Array) -> Array:
        """Return how good pairs are by the quantity that ranks them, -inf of those that are not measured.

        Of `passing` ones the `first` and a grid of them are measured, and the ways from the best to better neighbours.
        """
        good, seen = np.full(passing.shape, -math.inf), ~passing

        def measured(i: int, k: int) -> float:
            if not seen[i, k]:
                seen[i, k] = True
                found = self._passing(drivers[i], followers[k])
                good[i, k] = -math.inf if found is None else -self._rank(found)
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


def usable(files: Sequence[ProblemFile], found: Positions) -> NDArray[np.bool_]:
    """Return whether linkages meet the targets without a defect, within the bounds and the limits that closed forms tell.

    `files`: the problem with definite assembly modes. The validator knows the other limits.
    """
    fits: NDArray[np.bool_] = (found.pairs.defect == 0) & turning(files[0].spec, found)
    for _, met in _conditions(files, found):
        fits &= met
    return fits


def _conditions(files: Sequence[ProblemFile], found: Positions) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield what a bound or limit is, and whether linkages meet it."""
    task, size = files[0].spec, float(np.nanmax(np.abs(found.pin), initial=0.0))
    limits, named = task.limits, quantities_of(task, found)
    loops = [loop_of(file.spec) for file in files]
    yield "assembly", np.isin(found.side, [loop.side for loop in loops if loop is not None])
    if task.data.offsets is None:
        yield "rotation", np.isin(found.sense, task.ways)
    for name in task.free:
        quantity = task.quantities[name]
        (low, high), (_, unit), near = quantity.bounds, quantity.display, ROUNDED * (size if quantity.in_metres else 1.0)
        shown = f"{name} {low / quantity.si_per_unit:.4g} ... {high / quantity.si_per_unit:.4g} {unit}"
        yield shown, (named[name] >= low - near) & (named[name] <= high + near)
    *links, frame = found.lengths
    with np.errstate(all="ignore"):
        ratios = [] if found.slides else [("link ratio", each / frame, limits.link_ratio) for each in links]
    for name, value, interval in (("frame length", frame_of(task, found), limits.frame_length), *ratios):
        if interval is not None:
            high = math.inf if interval.high is None else interval.high
            yield name, (value >= (interval.low or 0.0)) & (value <= high)
    least, limit = limits.alignment.value, limits.transmission_angle
    if limit is not None:
        least = max(least, min(limit.low or 0.0, math.pi - (limit.high or math.pi)))
    yield BY_TRANSMISSION, angles_of(task, found) >= least


def turning(task: DesignProblem, found: Positions) -> NDArray[np.bool_]:
    """Return whether the cranks of linkages turn as `limits.crank` requires, by its margin."""
    if task.limits.crank == "span":
        return np.ones(found.pairs.turns.shape, dtype=bool)
    if found.slides:
        return found.pairs.turns
    with np.errstate(invalid="ignore"):
        passed: NDArray[np.bool_] = grashof_check(found.lengths, task.limits).passed
        return passed


def frame_of(task: DesignProblem, found: Positions) -> Array:
    """Return the lengths [m] of the frames of linkages; of those of a law that of the file."""
    loop = task.four_bar
    return np.asarray(found.lengths[-1] if loop is None or not task.law_given else loop.frame(task.design({}))[0])


def angles_of(task: DesignProblem, found: Positions) -> Array:
    """Return the least distance [rad] of the transmission angle of linkages from 0 and 180 deg over the required motion."""
    return found.pairs.around if task.limits.transmission_range == "revolution" else found.pairs.transmission


CHEAP = ((FiveTargets, of_five_targets), (FourTargets, applies), (FourTargets, joints_given), (ThreePoints, given_starts))
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
def four_bar_of_dyads(problem: AnyProblem, driver: float, follower: float) -> SynthesisResult:
    """Join two dyads of four poses to a four-bar, and validate it.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        A four-bar for four poses with free timing, all dimensions of which are design variables.
    driver, follower : float
        Rows of the dyads in `dyad_curves`; between whole ones lie the dyads between them.

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
    if not guided(problem.variants()[0].spec):
        message, remedy = "only four poses of a four-bar with free timing are met by any two dyads", "Leave all dimensions free"
        raise InputError(message, remedy, problem.file, "requirement")
    return of_family(problem, driver, follower)


def of_family(problem: ProblemFile, driver: float, follower: float) -> SynthesisResult:
    """Return the validated linkage of two rows of the family of a problem, see `family_of`.

    Raises
    ------
    InputError
        If it does not meet the targets in order.
    """
    clock = time.perf_counter()
    targets = FourTargets(problem.variants(), chosen=(driver, follower))
    if not targets.found or targets.found[0].design is None:
        reasons = ", ".join(reason for one in targets.found for reason in one.solution.reasons) or DEFECTS[-1]
        message = f"this linkage does not pass the {targets.passed}: {reasons}"
        raise InputError(message, "Take a partner without a defect", problem.file, "driver, follower", [driver, follower])
    return of_designs(problem, [targets.found[0].design], 1, seconds={"solve and validate": time.perf_counter() - clock})
