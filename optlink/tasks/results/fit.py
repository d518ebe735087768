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

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from optlink.errors import InputError
from optlink.linkage.fourbar import classify
from optlink.linkage.motion import sweep
from optlink.linkage.vector2d import TURN, Array, all_finite, finite_or, max_magnitude, wrapped
from optlink.problem.design import STEP, DesignProblem
from optlink.problem.document import Source
from optlink.problem.quantity import Quantity
from optlink.problem.requirements.base import pose_angles
from optlink.problem.targets.law import Function, Table, begins_at_psi0
from optlink.problem.targets.target_points import MAX_POINTS
from optlink.solvers.solution import LimitState, Solution
from optlink.units import show

if TYPE_CHECKING:
    from optlink.problem.file import ProblemFile
    from optlink.problem.machine.model import Problem
    from optlink.validation.design import MeasuredDeviations


# What would improve a poor fit, measured on the design: another start of a law, the other assembly mode, a fixed dimension.

BETTER = 0.9  # fraction of the error below which another start or mode, or a displaced linkage, counts as a reason
STARTS = 72  # start angles of a law that are tried
DIMENSION_STEP = 1e-6  # scaled, of a fixed dimension
MOST_VARIANTS = 32  # combinations of assembly modes that are tried
FREE_START = '{ bounds = ["0 deg", "360 deg"] }'
MAX_NAMED = 4  # fixed dimensions that are named
NO_EFFECT = 1e-6  # relative change of the objective by one unit of a dimension that counts as none


@dataclass(frozen=True)
class PoorFitReason:
    """A measured reason for a poor fit, and its remedy."""

    reason: str
    remedy: str


def start_reasons(task: DesignProblem, values: Mapping[str, float], error: float) -> Iterator[PoorFitReason]:
    """Yield the start of a law as a reason if it is the default, or if the same linkage is better from another crank angle.

    `error` is the root mean square error of the design, in the unit of the output.
    """
    requirement, law, quantity = task.requirement, task.requirement.law, task.quantities.get(task.start_name)
    own = isinstance(law, Function) or (isinstance(law, Table) and not law.from_start)
    if own or (quantity is not None and quantity.free):
        return
    start = task.dead_centre if quantity is None else in_degrees(quantity.value)
    default, key = "start" not in requirement.model_fields_set, requirement.of(task).key
    reason = f"the law starts at the {start}, the default of requirement.{key}" if default else f"the law starts at {start}"
    angles = np.linspace(0.0, TURN, STARTS, endpoint=False)
    errors = _errors(task, values, angles)
    best = int(np.argmin(finite_or(errors, np.inf)))
    gain = math.isfinite(errors[best]) and errors[best] < BETTER * error
    if gain:
        reason += f"; from {in_degrees(angles[best])} the same linkage has an rms error of {_shown(errors[best], task.unit)}"
        reason += f" instead of {_shown(error, task.unit)}"
    if gain or default:
        yield PoorFitReason(reason, f"free the start: requirement.{key} = {FREE_START}")


def _errors(task: DesignProblem, values: Mapping[str, float], starts: Array) -> Array:
    """Return the root mean square error (starts,) of a linkage whose law starts at each of these crank angles [rad].

    The output at the start is the actual one where it is tied to it, and the best one where it is free.
    """
    law, begin = task.law, starts[:, None]

    def output(angles: Array) -> Array:
        motion = sweep(task.linkage, values, angles.ravel())
        actual = motion.coordinate(task.output).value if task.slides else motion.body_angle(task.output).value
        return np.asarray(actual, dtype=float).reshape(angles.shape)

    base = output(begin) if task.tied else np.full_like(begin, values.get(task.base_name, 0.0))
    error = output(begin + law.offsets) - law.curve(law.offsets, begin, base)
    free = task.base_name in task.free
    if task.slides:
        return np.asarray(np.std(error, axis=1) if free else np.sqrt(np.mean(error**2, axis=1)))
    middle = np.angle(np.mean(np.exp(1j * error), axis=1, keepdims=True)) if free else 0.0
    error = wrapped(error - middle)
    return np.asarray(np.sqrt(np.mean(error**2, axis=1)))


def mode_reasons(
    problem: ProblemFile, values: Mapping[str, float], crank_angles: Array, error: float, unit: str
) -> Iterator[PoorFitReason]:
    """Yield the assembly modes of a linkage as a reason if the same sizes are better for a path or a law in other modes.

    The crank angle at which the task begins and the output there follow where they are free. `error` is the root mean square
    error of the design, in `unit` (m or rad).
    """

    def measured(variant: ProblemFile) -> float:
        task = variant.spec
        if task.pointed and task.data.offsets is None:
            return rms(curve_distances(task, values, crank_angles))
        full = task.design({name: values[name] for name in task.quantities})
        any_start = task.start_name in task.free
        begins = np.linspace(0.0, TURN, STARTS, endpoint=False) if any_start else np.array([full.get(task.start_name, 0.0)])
        if not task.pointed:
            errors = _errors(task, full, begins)
        else:
            errors = np.array([_distance(task, {**full, task.start_name: float(begin)}) for begin in begins])
        return min(filter(math.isfinite, errors.tolist()), default=math.inf)

    if problem.spec.requirement.kind in ("path", "function"):  # of poses the body would have to be placed again
        yield from _mode_reasons(problem, error, unit, measured)


def _distance(task: DesignProblem, values: Mapping[str, float]) -> float:
    """Return the root mean square distance of a design from points with prescribed crank angles."""
    from optlink.validation.design import deviations

    return rms(deviations(task, values, task.crank_angles(values, None)).distances)


def curve_distances(task: DesignProblem, values: Mapping[str, float], crank_angles: Array) -> Array:
    """Return the distance [m] of every point of a path from the curve of a linkage, at any crank angle.

    The curve of a crank that need not turn fully is that between the first and last of `crank_angles` [rad].
    """
    begin = float(crank_angles[0])
    end = begin + TURN if task.limits.crank != "span" else float(crank_angles[-1])
    begin, end = task.linkage.limits or (begin, end)
    curve = sweep(task.linkage, values, np.linspace(begin, end, FINE)).position(task.point)
    gaps = [np.hypot(*(curve - place).T) for place in task.data.columns[:, :2]]
    return np.array([np.min(gap) if all_finite(gap) else math.inf for gap in gaps])


def _mode_reasons(
    problem: ProblemFile, error: float, unit: str, measured: Callable[[ProblemFile], float]
) -> Iterator[PoorFitReason]:
    """Yield the assembly modes as a reason if the error `measured` is clearly less in other modes."""
    section, linkage = problem.model.mechanism, problem.model.linkage
    variants = section.with_open_modes(linkage).variants(linkage)
    best, changed = error, dict[str, tuple[str, str]]()
    for change in itertools.islice(variants, MOST_VARIANTS):
        try:
            variant = problem.override({**problem.located, **change})
        except InputError:  # a mode that the problem does not permit
            continue
        other_error = measured(variant)
        if other_error < min(best, BETTER * error):
            pairs = zip(linkage.groups, variant.model.linkage.groups, strict=True)
            best, changed = other_error, {one.joint: _mode(change, one.joint) for one, other in pairs if one != other}
    if not changed:
        return
    modes = " and ".join(f"{joint} {mode}" for joint, (_, mode) in changed.items())
    reason = f"with {modes} the same sizes have an rms error of {_shown(best, unit)} instead of {_shown(error, unit)}"
    yield PoorFitReason(reason, "write " + " and ".join(f'{key} = "either"' for key, _ in changed.values()))


def _mode(change: Mapping[str, str], joint: str) -> tuple[str, str]:
    """Return the key of the assembly mode of a joint in a change of the file, and its value in words; a four-bar has one mode."""
    ((key, mode),) = change.items() if "mechanism.assembly" in change else [(f"mechanism.assembly.{joint}", "")]
    return key, f"to the {mode}" if mode else change[key]


def rms(values: Array) -> float:
    """Return the root mean square of numbers, also complex ones."""
    return math.sqrt(float(np.mean(np.abs(values) ** 2)))


def _shown(value: float, unit: str) -> str:
    return in_degrees(value) if unit == "rad" else f"{1e3 * value:.4g} mm"


def fixed_reasons(
    quantities: Mapping[str, Quantity],
    values: Mapping[str, float],
    solution: Solution | None = None,
    task: Problem | None = None,
) -> Iterator[PoorFitReason]:
    """Yield the fixed dimensions as a reason; of an optimum (`solution`), the one with the largest effect comes first."""
    effects = {} if solution is None or task is None else fixed_effects(solution, task)
    fixed = [name for name, quantity in quantities.items() if quantity.fixed]
    fixed.sort(key=lambda name: -abs(effects.get(name, 0.0)))
    if not fixed:
        return
    shown = ", ".join(
        f"{name} = {show(values.get(name, quantities[name].value), quantities[name].kind)}" for name in fixed[:MAX_NAMED]
    )
    more = f" and {len(fixed) - MAX_NAMED} more" if len(fixed) > MAX_NAMED else ""
    effect = effects.get(fixed[0], 0.0)
    if abs(effect) <= NO_EFFECT:
        yield PoorFitReason(f"fixed dimensions: {shown}{more}", "free those that need not be fixed, by bounds")
        return
    unit = quantities[fixed[0]].display[1]
    step = f"1 {unit} {'less' if effect > 0.0 else 'more'} improves the objective by {100.0 * abs(effect):.3g} %"
    which = (
        f"of the fixed dimensions ({shown}{more}), {fixed[0]} has the largest effect" if len(fixed) > 1 else f"{shown} is fixed"
    )
    yield PoorFitReason(f"{which}: {step}", f"free {fixed[0]} by bounds")


def fixed_effects(solution: Solution, task: Problem) -> dict[str, float]:
    """Return the relative change of the shown optimal objective per display unit of each fixed dimension, to first order.

    It is the partial derivative of the Lagrangian (the envelope theorem), by central differences.
    """
    shown = task.shown_objective(solution.objective)
    size = shown.factor * solution.objective / shown.value if shown.value else 1.0
    nlp, x = solution.nlp, solution.x
    multipliers = solution.conditions.multipliers[len(x) :]
    priced = multipliers != 0.0
    here = abs(nlp.values(x, solution.p)[0])
    effects = {}
    for k, constant in enumerate(nlp.constants):
        sides = []
        for way in (1.0, -1.0):
            p = solution.p.copy()
            p[1 + k] += way * DIMENSION_STEP
            f, g = nlp.values(x, p)
            sides.append(f + float(multipliers[priced] @ g[priced]))
        slope = size * (sides[0] - sides[1]) / (2.0 * DIMENSION_STEP * here) if here > 0.0 else 0.0
        effects[constant.name] = slope / constant.scale.slope(0.0) if math.isfinite(slope) else 0.0
    return effects


def in_degrees(value: float) -> str:
    """Format an angle [rad]."""
    return f"{math.degrees(value):.4g} deg"


EXACT, GOOD, FAIR = 1e-9, 0.01, 0.05  # largest relative errors of these grades; beyond, a fit is poor
GOOD_ANGLE, FAIR_ANGLE = math.radians(45.0), math.radians(40.0)  # least transmission angles of these grades
ROUNDING = 1e-6  # rad: rounding tolerance, so that an active limit of 40 deg counts as satisfied
MAX_TIMED_ERROR = 0.5  # fraction of the error below which the distance of the curve makes the crank angles a reason
MIN_LIMIT_SHARE = 1e-2  # least share of a limit in the sum of multiplier times bound that counts as a reason
TRANSMISSION_KEYS = (
    "transmission_",
    "pressure_angle",
    "transmission angle",
    "pressure angle",
)  # limits of the transmission angle
FINE = 721  # positions along a motion, such as those at which the error of a law is measured over its whole range
NO_RANGE = 1e-3  # share of a radian, or of the longest link, below which targets are all the same: a dwell, a single position
NEAR = 0.05  # share of the size of the path up to which the rest of the curve is where the path is
REST = math.radians(1.0)  # rotation of the crank up to which an open path leaves no rest of the curve
MORE_POINTS = 3  # of a drawing: times as many are advised where the curve leaves the drawing between them
GRADES = ("exact", "good", "fair", "poor")
SIZEABLE = 0.5  # least share of the objective of a limit's price times its bound, or the size of the path, beside its excursions
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

    `excursion` [m]: the largest one of the curve between two points, whose names are the `segment`.
    """

    excursion: float = 0.0
    segment: str = ""

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
    def text(self) -> str:
        """The grade with the figure that determines it."""
        if self.grade == self.at_points:
            return super().text
        share = f"{_percent(self.excursion / self.size)} of {self.of}"
        return f"{self.grade} fit: between {self.segment} the curve deviates by {_length(self.excursion)}, {share}"


@dataclass(frozen=True)
class WayBack:
    """The curve of a point beyond an open path, on which it returns while the crank turns on.

    `drawn` and `whole` [m]: the lengths of the curve along the points and of all of it; `away` [m]: the largest distance of the
    rest from the points' part; `bounded`: whether a limit of the file keeps the point in or out of a region.
    """

    point: str
    drawn: float
    whole: float
    away: float
    bounded: bool

    @property
    def text(self) -> str:
        """What the rest of the curve does, as a clause."""
        lengths = f"{1e3 * self.drawn:.3g} of {1e3 * self.whole:.3g} mm"
        return f"the points are {lengths} of the curve of {self.point}, whose rest lies up to {_length(self.away)} away"

    @property
    def note(self) -> str:
        """The same with what to do about it."""
        return f"{self.text}; if that matters, close the path{'' if self.bounded else f' or keep {self.point} in a region'}"


def way_back(task: DesignProblem, values: Mapping[str, float], angles: Array) -> WayBack | None:
    """Return the rest of the curve of an open path, of which the points are passed at crank angles [rad].

    None without any, or where it stays near the points: the point returns on the same way, or nearly so.
    """
    open_path = task.requirement.kind == "path" and not task.closed and task.limits.crank != "span"
    if not open_path or task.linkage.limits is not None or len(angles) < 2:
        return None
    first, last = float(angles[0]), float(angles[-1])
    rest = math.copysign(TURN, last - first) - (last - first)
    if abs(rest) <= REST:
        return None
    ways = (np.linspace(first, last, FINE), np.linspace(last, last + rest, FINE))
    drawn, back = (sweep(task.linkage, values, way).position(task.point) @ [1.0, 1.0j] for way in ways)
    away = float(np.max(np.min(np.abs(back[:, None] - drawn), axis=1)))
    lengths = [float(np.sum(np.abs(np.diff(part)))) for part in (drawn, back)]
    bounded = any(region.of == task.point for region in task.limits.regions.values())
    return WayBack(task.point, lengths[0], sum(lengths), away, bounded) if away > NEAR * task.size else None


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
    solution: Solution | None = None,
    task: Problem | None = None,
) -> TransmissionFit | None:
    """Grade a design by its least transmission angle [rad]; return None if it has none.

    A given design has no `solution`, whose limits with their multipliers explain a poor fit.
    """
    if not math.isfinite(least):
        return None
    right = 0.5 * math.pi
    fit = TransmissionFit(right - least, right, "rad", "a right angle")
    if fit.grade != "poor":
        return fit
    limits = () if solution is None else solution.displayed_limits
    remaining = [limit for limit in limits if not any(words in f"{limit.key} {limit.name}" for words in TRANSMISSION_KEYS)]
    return replace(fit, reasons=(*active_reasons(remaining), *fixed_reasons(quantities, values, solution, task)))


def fit(
    problem: ProblemFile,
    values: Mapping[str, float],
    crank_angles: Array,
    measured: MeasuredDeviations,
    between: Array | None = None,
    solution: Solution | None = None,
) -> Fit | None:
    """Grade a design for points, poses or a law; return None for transmission (see `transmission_fit`) or without motion.

    `between` are the excursions [m] of the curve between the points. A given design has no `solution`.
    """
    task = problem.spec
    targets, distances = task.data.columns, measured.distances
    if task.requirement.kind == "transmission" or not all_finite(distances):
        return None
    links = [values[name] for name, quantity in task.mechanism.quantities.items() if quantity.kind == "length"]
    if task.pointed:
        places = targets[:, 0] + 1j * targets[:, 1]
        of = "the size of the path" if measured.turned is None else "the distance of the poses"
        diameter = max(max_magnitude(places - place) for place in places)
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
        segment, advice = segment_of(task, after, float(between[after]))
        path = PathFit(worst.error, worst.size, worst.unit, worst.of, (), float(between[after]), segment)
        if path.grade != path.at_points:
            reason = (
                f"the {len(targets)} points are met within {_length(float(np.max(distances)))}, the curve between them is not"
            )
            priced = [] if solution is None or path.at_points not in ("fair", "poor") else _sizeable(solution, path.size)
            return replace(path, reasons=(*active_reasons(priced), PoorFitReason(f"{reason} prescribed", advice)))
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
    limits = () if solution is None else solution.displayed_limits
    reasons += [*active_reasons(limits), *fixed_reasons(_quantities(task), values, solution, task), *_kind(task, values)]
    return Fit(worst.error, worst.size, worst.unit, worst.of, tuple(reasons))


def segment_of(task: DesignProblem, after: int, excursion: float = 0.0) -> tuple[str, str]:
    """Return the names of a point, by its index, and of the next one, and how to prescribe the curve between them.

    Points that were sampled from a curve have no names in the file, but places. More of them are no remedy for an `excursion` [m]
    longer than their distance: the curve has a loop there, for which there is room between denser points as well.
    """
    points, data = task.data.columns, task.target_points
    ends = [after, (after + 1) % len(points)]
    if not data.sampled:
        segment = f"points {ends[0] + 1} and {ends[1] + 1}"
        return segment, f"prescribe further points between {segment}, or more weight beside them"
    segment = " and ".join(f"({', '.join(f'{1e3 * value:z.4g}' for value in points[end, :2])})" for end in ends) + " mm"
    more = min(MAX_POINTS, MORE_POINTS * len(points))
    if more == len(points) or excursion > math.dist(*points[ends, :2]):
        return segment, f"give the curve wider bends near {segment}"
    key = "requirement.points.points"
    return segment, f"take more points of the curve: {key} = {more} in the file, or --set {key}={more}"


def _sized(errors: Array, size: float, unit: str, of: str, links: Sequence[float] = ()) -> Fit:
    """Return the fit for a size of the targets, or for that of a link if they have none: a radian, or the longest link.

    An angle error in radians is the error of the end of a lever, relative to its length.
    """
    whole, name = (1.0, "a radian") if unit == "rad" else (max(links, default=0.0), "the longest link")
    return Fit(rms(errors), *((whole, unit, name) if size <= NO_RANGE * whole else (size, unit, of)))


def _rotation(task: DesignProblem) -> float:
    angles = pose_angles(task.data.columns)
    return float(np.ptp(np.unwrap(angles[np.isfinite(angles)])))


def _four_bar(task: DesignProblem, values: Mapping[str, float]) -> str:
    """Return the Grashof type of a four-bar; an empty text for other mechanisms."""
    return "" if task.four_bar is None else classify(*task.four_bar.lengths(values)).inversion.value


def _rotating(task: DesignProblem, values: Mapping[str, float]) -> Iterator[PoorFitReason]:
    """Detect poses that rotate farther than the body over its whole motion."""
    if task.requirement.kind != "motion" or task.limits.crank == "span":
        return
    angle = np.asarray(sweep(task.linkage, values, np.linspace(0.0, TURN, FINE)).body_angle(task.body).value, dtype=float)
    if not all_finite(angle):
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
    if moved < BETTER * error:
        place = f"({_length(values.get('A.x', 0.0))}, {_length(values.get('A.y', 0.0))})"
        fixed = [f"the crank pivot is fixed at {place}"] * pivot
        fixed += [f"the frame's direction is fixed at {in_degrees(values.get('direction', 0.0))}"] * turn
        gain = f"moved as a whole, this linkage has an rms error of {_length(moved)} instead of {_length(error)}"
        keys = ["mechanism.pivot"] * pivot + ["mechanism.direction"] * turn
        yield PoorFitReason(f"{' and '.join(fixed)}; {gain}", f"free {' and '.join(keys)} by bounds")


def _sizeable(solution: Solution, size: float) -> list[LimitState]:
    """Return the active limits with a sizeable price for a path of a size [m]."""
    return [
        limit
        for limit in solution.displayed_limits
        if limit.effect * max(abs(limit.bound), 1e3 * size * (limit.unit == "mm")) >= SIZEABLE * solution.objective
    ]


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
