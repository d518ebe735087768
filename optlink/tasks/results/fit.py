"""Grade the error of a design relative to the size of its task, with likely reasons for a poor fit.

The transmission angle is graded by its least value: 45 deg and 40 deg, the least values that textbooks recommend.

References
----------
R. L. Norton, Design of Machinery, McGraw-Hill, section on the transmission angle (about 40 deg).

J. J. Uicker, G. R. Pennock, J. E. Shigley, Theory of Machines and Mechanisms, Oxford, section on the transmission angle (45 deg
or 50 deg).

S. S. Balli, S. Chand, Transmission angle in mechanisms, Mechanism and Machine Theory 37 (2002) 175-195 (survey).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from optlink.linkage.fourbar import classify
from optlink.linkage.motion import sweep
from optlink.linkage.vector2d import TURN, Array
from optlink.problem.design import STEP, DesignProblem
from optlink.problem.document import Source
from optlink.problem.quantity import Quantity
from optlink.problem.targets.law import begins_at_psi0
from optlink.solvers.solution import LimitState, Solution
from optlink.tasks.results.remedies import (
    PoorFitReason,
    curve_distances,
    fixed_reasons,
    in_degrees,
    mode_reasons,
    rms,
    start_reasons,
)

if TYPE_CHECKING:
    from optlink.problem.file import ProblemFile
    from optlink.problem.machine.model import Problem
    from optlink.validation.design import MeasuredDeviations

EXACT, GOOD, FAIR = 1e-9, 0.01, 0.05  # largest relative errors of these grades; beyond, a fit is poor
GOOD_ANGLE, FAIR_ANGLE = math.radians(45.0), math.radians(40.0)  # least transmission angles of these grades
ROUNDING = 1e-6  # rad: rounding tolerance, so that an active limit of 40 deg counts as satisfied
MAX_DISPLACED_ERROR = 0.9  # fraction of the error below which a displaced linkage counts as a reason
MAX_TIMED_ERROR = 0.5  # fraction of the error below which the distance of the curve makes the crank angles a reason
MIN_LIMIT_SHARE = 1e-2  # least share of a limit in the sum of multiplier times bound that counts as a reason
TRANSMISSION_KEYS = (
    "transmission_",
    "pressure_angle",
    "transmission angle",
    "pressure angle",
)  # limits of the transmission angle
POSITIONS = 721  # positions along a motion
NO_RANGE = 1e-3  # share of a radian, or of the longest link, below which targets are all the same: a dwell, a single position
GRADES = ("exact", "good", "fair", "poor")
MAX_ACTIVE_LIMITS = 2  # largest number of active limits given as reasons


@dataclass(frozen=True)
class Fit:
    """Root mean square error of a design relative to the size of its task.

    `error` and `size` in `unit` (m, rad); `of` names the size; `reasons` only for a poor fit.
    """

    shown: ClassVar[Mapping[str, Source]] = {name: name for name in ("grade", "share", "error", "size", "unit", "of", "reasons")}

    error: float
    size: float
    unit: str
    of: str
    reasons: tuple[PoorFitReason, ...] = ()

    @property
    def at_points(self) -> str:
        """Grade of the prescribed positions alone."""
        return self.grade

    @property
    def share(self) -> float:
        """Error relative to the size."""
        return self.error / self.size

    @property
    def grade(self) -> str:
        """Exact, good (up to 1 %), fair (up to 5 %) or poor."""
        for grade, most in (("exact", EXACT), ("good", GOOD), ("fair", FAIR)):
            if self.share <= most:
                return grade
        return "poor"

    @property
    def text(self) -> str:
        """The grade with its figure."""
        if self.grade == "exact":
            return "exact fit"
        return f"{self.grade} fit: rms error is {_percent(self.share)} of {self.of}"


@dataclass(frozen=True)
class PathFit(Fit):
    """Error of a path at its points and, where that is worse, between them.

    `excursion` [m]: the largest one of the curve between two points, the first of which has the index `after`.
    """

    excursion: float = 0.0
    after: int = 0
    count: int = 0

    @property
    def at_points(self) -> str:
        """Grade of the points alone."""
        return super().grade

    @property
    def grade(self) -> str:
        """The worse grade of the points and of the curve between them, whose excursions count as little up to 1 %."""
        between = Fit(self.excursion, self.size, self.unit, self.of).grade
        worst = max(self.at_points, between, key=GRADES.index)
        return worst if between in ("fair", "poor") else self.at_points

    @property
    def segment(self) -> str:
        """Names of the two points between which the excursion is largest."""
        return f"points {self.after + 1} and {(self.after + 1) % self.count + 1}"

    @property
    def text(self) -> str:
        """The grade with the figure that determines it."""
        if self.grade == self.at_points:
            return super().text
        share = f"{_percent(self.excursion / self.size)} of {self.of}"
        return f"{self.grade} fit: between {self.segment} the curve deviates by {_length(self.excursion)}, {share}"


def _percent(share: float) -> str:
    """Format a share in percent, from 100 % on without digits after the point."""
    return f"{100.0 * share:.2g} %" if share < 0.99 else f"{100.0 * share:z.0f} %"


@dataclass(frozen=True)
class TransmissionFit(Fit):
    """Least transmission angle of a design: `error` is its difference from a right angle, `size` a right angle [rad]."""

    @property
    def angle(self) -> float:
        """Least transmission angle [rad]."""
        return self.size - self.error

    @property
    def grade(self) -> str:
        """Good (45 deg or more), fair (40 deg or more) or poor."""
        angle = self.angle + ROUNDING
        return "good" if angle >= GOOD_ANGLE else "fair" if angle >= FAIR_ANGLE else "poor"

    @property
    def text(self) -> str:
        """The grade with its figure."""
        advised = f", below {math.degrees(FAIR_ANGLE):z.0f} deg" if self.grade == "poor" else ""
        return f"{self.grade} transmission: least transmission angle is {in_degrees(self.angle)}{advised}"


def transmission_fit(
    least: float,
    quantities: Mapping[str, Quantity],
    values: Mapping[str, float],
    limits: Sequence[LimitState] = (),
    solution: Solution | None = None,
    task: Problem | None = None,
) -> TransmissionFit | None:
    """Grade a design by its least transmission angle [rad]; return None if it has none.

    A given design has no optimum: no `limits` with multipliers, and no `solution`.
    """
    if not math.isfinite(least):
        return None
    right = 0.5 * math.pi
    fit = TransmissionFit(right - least, right, "rad", "a right angle")
    if fit.grade != "poor":
        return fit
    remaining = [limit for limit in limits if not any(words in f"{limit.key} {limit.name}" for words in TRANSMISSION_KEYS)]
    return replace(fit, reasons=(*active_reasons(remaining), *fixed_reasons(quantities, values, solution, task)))


def fit(
    problem: ProblemFile,
    values: Mapping[str, float],
    crank_angles: Array,
    measured: MeasuredDeviations,
    between: Array | None = None,
    limits: Sequence[LimitState] = (),
    solution: Solution | None = None,
) -> Fit | None:
    """Grade a design for points, poses or a law; return None for transmission (see `transmission_fit`) or without motion.

    `between` are the excursions [m] of the curve between the points. A given design has no `limits` and no `solution`.
    """
    task = problem.spec
    targets, distances = task.data.columns, measured.distances
    if task.requirement.kind == "transmission" or not np.all(np.isfinite(distances)):
        return None
    links = [values[name] for name, quantity in task.mechanism.quantities.items() if quantity.kind == "length"]
    if task.pointed:
        places = targets[:, 0] + 1j * targets[:, 1]
        of = "the size of the path" if measured.turned is None else "the distance of the poses"
        diameter = max(float(np.max(np.abs(places - place))) for place in places)
        fits = [_sized(distances, diameter, "m", of, links)]
        if measured.turned is not None:
            fits.append(_sized(measured.turned, _rotation(task), "rad", "the rotation of the poses"))
    else:
        outputs = task.prescribed_outputs(values)
        law = task.law.source
        relative = getattr(law, "from_start", False) or begins_at_psi0(law)
        if task.tied and relative and task.law.offsets[0] != 0.0:
            outputs = np.insert(outputs, 0, values[task.base_name])  # where the error is zero by definition
        travel = float(np.ptp(outputs if task.slides else np.unwrap(outputs)))
        fits = [_sized(distances, travel, task.unit, "the output range", links)]
    worst = max(fits, key=lambda one: one.share)
    if between is not None and np.any(np.isfinite(between)):
        after = int(np.nanargmax(between))
        path = PathFit(worst.error, worst.size, worst.unit, worst.of, (), float(between[after]), after, len(targets))
        if path.grade != path.at_points:
            reason = (
                f"the {len(targets)} points are met within {_length(float(np.max(distances)))}, the curve between them is not"
            )
            advice = f"prescribe further points between {path.segment}, or more weight beside them"
            return replace(path, reasons=(PoorFitReason(f"{reason} prescribed", advice),))
    if worst.grade != "poor":
        return worst
    reasons = [
        *_rotating(task, values),
        *_crowded(task, crank_angles),
        *_timed(task, values, crank_angles, measured),
        *_placed(task, values, measured),
        *(() if task.pointed else start_reasons(task, values, rms(distances))),
        *mode_reasons(problem, values, crank_angles, rms(distances), "m" if task.pointed else str(task.unit)),
    ]
    reasons += [*active_reasons(limits), *fixed_reasons(_quantities(task), values, solution, task), *_kind(task, values)]
    return Fit(worst.error, worst.size, worst.unit, worst.of, tuple(reasons))


def _sized(errors: Array, size: float, unit: str, of: str, links: Sequence[float] = ()) -> Fit:
    """Return the fit for a size of the targets, or for that of a link if they have none: a radian, or the longest link.

    An angle error in radians is the error of the end of a lever, relative to its length.
    """
    whole, name = (1.0, "a radian") if unit == "rad" else (max(links, default=0.0), "the longest link")
    return Fit(rms(errors), *((whole, unit, name) if size <= NO_RANGE * whole else (size, unit, of)))


def _rotation(task: DesignProblem) -> float:
    return float(np.ptp(np.unwrap(np.arctan2(task.data.columns[:, 3], task.data.columns[:, 2]))))


def _four_bar(task: DesignProblem, values: Mapping[str, float]) -> str:
    """Return the Grashof type of a four-bar; an empty text for other mechanisms."""
    return "" if task.four_bar is None else classify(*task.four_bar.lengths(values)).inversion.value


def _rotating(task: DesignProblem, values: Mapping[str, float]) -> Iterator[PoorFitReason]:
    """Detect poses that rotate farther than the body over its whole motion."""
    if task.requirement.kind != "motion" or task.limits.crank == "span":
        return
    angle = np.asarray(sweep(task.linkage, values, np.linspace(0.0, TURN, POSITIONS)).body_angle(task.body).value, dtype=float)
    if not np.all(np.isfinite(angle)):
        return
    turned, needed = float(np.ptp(np.unwrap(angle))), _rotation(task)
    if needed > turned:
        kind = _four_bar(task, values) or "linkage"
        reason = (
            f"the poses turn through {in_degrees(needed)}, the {task.body} of this {kind} through {in_degrees(turned)} at most"
        )
        suggestion = 'allow double-cranks, whose coupler turns fully (limits.crank = "double-crank"), or ' * (
            kind == "crank-rocker"
        )
        yield PoorFitReason(reason, f'{suggestion}drive it over a part of a turn (limits.crank = "span")')


def _timed(
    task: DesignProblem, values: Mapping[str, float], angles: Array, measured: MeasuredDeviations
) -> Iterator[PoorFitReason]:
    """Detect a curve that passes the points, but at crank angles other than those prescribed."""
    if task.requirement.kind != "path" or task.data.offsets is None:
        return
    near, error = rms(curve_distances(task, values, angles)), rms(measured.distances)
    if near < MAX_TIMED_ERROR * error:
        reason = f"the curve passes the points at an rms distance of {_length(near)}, but at other crank angles"
        yield PoorFitReason(reason, 'free the timing: requirement.timing = "free"')


def _crowded(task: DesignProblem, angles: Array) -> Iterator[PoorFitReason]:
    """Detect an order of points that the curve does not follow: several occur at nearly the same crank angle."""
    if task.data.offsets is not None or not task.pointed:
        return
    close = np.flatnonzero(np.abs(np.diff(angles)) <= 2.0 * STEP)
    if len(close):
        shown = ", ".join(f"{i + 1} and {i + 2}" for i in close[:3]) + (", ..." if len(close) > 3 else "")
        reason = f"the curve does not follow the order of the points: {shown} are met at the same crank angle"
        yield PoorFitReason(reason, "check the order of requirement.points, or smooth them")


def _placed(task: DesignProblem, values: Mapping[str, float], measured: MeasuredDeviations) -> Iterator[PoorFitReason]:
    """Detect a fixed frame where a rigid displacement of the linkage would reduce the error."""
    if not task.mechanism.by_lengths or not task.pointed:
        return
    free = set(task.free)
    pivot, turn = not {"A.x", "A.y"} <= free, "direction" not in free
    if not (pivot or turn):
        return
    generated, targets = (rows[:, 0] + 1j * rows[:, 1] for rows in (measured.generated, task.data.columns))
    path, goal = generated - np.mean(generated), targets - np.mean(targets)
    rotation = np.sum(goal * path.conj())
    turned = path * (rotation / abs(rotation)) if turn and abs(rotation) > 0.0 and task.requirement.kind == "path" else path
    moved, error = rms(goal - turned), rms(measured.distances)
    if moved < MAX_DISPLACED_ERROR * error:
        place = f"({_length(values.get('A.x', 0.0))}, {_length(values.get('A.y', 0.0))})"
        fixed = [f"the crank pivot is fixed at {place}"] * pivot
        fixed += [f"the frame's direction is fixed at {in_degrees(values.get('direction', 0.0))}"] * turn
        gain = f"moved as a whole, this linkage has an rms error of {_length(moved)} instead of {_length(error)}"
        keys = ["mechanism.pivot"] * pivot + ["mechanism.direction"] * turn
        yield PoorFitReason(f"{' and '.join(fixed)}; {gain}", f"free {' and '.join(keys)} by bounds")


def active_reasons(limits: Sequence[LimitState]) -> Iterator[PoorFitReason]:
    """Yield the active limits with the largest shadow prices relative to their size."""

    def weight(limit: LimitState) -> float:
        return limit.effect * max(abs(limit.bound), abs(limit.value))

    priced = [limit for limit in limits if limit.active and limit.effect and not limit.key.startswith("requirement.points")]
    priced.sort(key=weight, reverse=True)
    total = sum(weight(limit) for limit in priced)
    keys: set[str] = set()
    for limit in priced:
        if len(keys) == MAX_ACTIVE_LIMITS or weight(limit) < MIN_LIMIT_SHARE * total:
            break
        if limit.key not in keys:
            together = dict.fromkeys(other.key for other in priced if other is limit or other.name in limit.depends_on)
            keys.update(together)
            bound = f"{limit.sense} {limit.bound:.4g} {limit.unit}".rstrip()
            word, remedy = ("at its prescribed value", "change") if limit.sense == "=" else ("at its limit", "widen")
            yield PoorFitReason(f"{limit.name} is {word} ({bound})", f"{remedy} {' and '.join(together)}")


def _quantities(task: DesignProblem) -> dict[str, Quantity]:
    """Return the quantities of a law; of points the dimensions, including the default frame position of a four-bar."""
    if not task.pointed:
        return task.quantities
    nowhere = {f"A.{axis}": Quantity(0.0, "coordinate", "mm") for axis in "xy"} | {"direction": Quantity(0.0, "angle", "deg")}
    dimensions = task.mechanism.quantities
    return nowhere | dimensions if task.mechanism.by_lengths else dimensions


def _kind(task: DesignProblem, values: Mapping[str, float]) -> Iterator[PoorFitReason]:
    """Detect a restriction to four-bars of one kind."""
    kind, crank = _four_bar(task, values), task.limits.crank
    if kind and crank != "span":
        suggestion = "full rotation" if crank == "double-crank" else "double-crank"
        reason = f'only four-bars of one kind were allowed: {kind} (limits.crank = "{crank}")'
        yield PoorFitReason(reason, f'try limits.crank = "{suggestion}" or "span", or a six-bar')


def _length(value: float) -> str:
    return f"{1e3 * value:.3g} mm"
