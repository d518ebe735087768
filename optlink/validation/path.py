"""Validate path and motion synthesis: sweep the mechanism through the points and all positions between them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from optlink.linkage.dyad_types import RPR, RRP, RRR, transmitting
from optlink.linkage.extrema import extremes, maxima
from optlink.linkage.mechanism import FRAME, Guide, Mechanism
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.stroke import Travel, travels
from optlink.linkage.vector2d import TURN, Array, Vector, cross, dot, unit
from optlink.problem.design import STEP, DesignProblem
from optlink.problem.mechanism import FourBarSection
from optlink.problem.requirement import MARK, ZERO
from optlink.units import DISPLAYED
from optlink.validation.check import (
    POSITIONS,
    Check,
    Validation,
    bounds_and_links,
    finely,
    limit_checks,
    link_lengths,
    registered_checks,
    revolutions_check,
    same_objective,
    transmission_checks,
)
from optlink.validation.margins import alignment_checks, grashof_check

ROUNDING = 1e-11  # of the size of the curve; absolute agreement required of nearly zero deviations


@dataclass(frozen=True)
class MeasuredDeviations:
    """Measured deviations at the positions, and the objective [SI].

    `generated` (positions, 2) [m]: points; of a function (positions, 1): its output [m or rad]; of the transmission (positions,
    joints): angles [rad]. `distances` (positions,): from the points [m], of the output [m or rad], largest absolute cosine of the
    transmission angles. `turned`: angle errors [rad] of poses.
    """

    generated: Array
    distances: Array
    turned: Array | None
    objective: float


def deviations(problem: DesignProblem, design: Mapping[str, float], crank_angles: Array) -> MeasuredDeviations:
    """Move the mechanism to the crank angles [rad] and measure its deviations from the targets, weighted as in the problem.

    The problem has definite assembly modes; the design [m, rad] has all quantities.
    """
    motion = sweep(problem.linkage, design, crank_angles)
    targets, weights = problem.data.columns, problem.data.roots**2
    kind, turned = problem.requirement.kind, None
    if kind == "transmission":
        generated = transmission_angles(motion, problem.linkage)
        distances = np.max(np.abs(np.cos(generated)), axis=1)
        square = distances**2 if problem.measure == "max" else np.sum(np.cos(generated) ** 2, axis=1)
    elif kind == "function":
        output = str(problem.requirement.output)
        travel = np.asarray(motion.slide(output).value if problem.slides else motion.body_angle(output).value, dtype=float)
        begin, base = float(crank_angles[0]) - problem.law.offsets[0], float(design.get(ZERO, 0.0))
        error = travel - problem.law.curve(problem.law.offsets, begin, base)
        error = error if problem.slides else np.remainder(error + math.pi, TURN) - math.pi
        generated, distances, square = travel[:, None], np.abs(error), error**2
    else:
        point = problem.point
        generated = motion.position(point) if point in motion.pose.points else np.full((len(targets), 2), np.nan)
        distances = np.hypot(*(generated - targets[:, :2]).T)
        square = distances**2
    if kind == "motion":
        angle = np.asarray(motion.body_angle(problem.body).value) + design[MARK]
        direction = np.arctan2(targets[:, 3], targets[:, 2])
        turned = np.remainder(angle - direction + math.pi, TURN) - math.pi
        square = square + (problem.radian * turned) ** 2
    if problem.measure == "max":
        objective = float(np.max(np.sqrt(square * weights)))
        if kind == "transmission" and not isinstance(problem.mechanism, FourBarSection):
            objective = _worst_cosine(problem, design)
        elif problem.everywhere and problem.law_given:
            objective = _largest_error(problem, design, float(crank_angles[0]) - problem.law.offsets[0])
    else:
        objective = float(np.sum(square * weights))
        objective = math.sqrt(objective / len(targets)) if problem.measure == "rms" else objective
    return MeasuredDeviations(generated, distances, turned, objective)


def _worst_cosine(problem: DesignProblem, design: Mapping[str, float]) -> float:
    """Return the largest cosine of the transmission angle of any dyad over the revolution."""

    def sizes(angles: Array) -> Array:
        return np.abs(np.cos(transmission_angles(sweep(problem.linkage, design, angles), problem.linkage))).T

    grid = np.linspace(0.0, TURN, POSITIONS + 1)
    return float(np.max(maxima(sizes, grid, periodic=True)[1])) if np.all(np.isfinite(sizes(grid))) else math.nan


def _largest_error(problem: DesignProblem, design: Mapping[str, float], begin: float) -> float:
    """Return the largest error [rad or m] of a law over its span, with the crank at `begin` [rad] at its start."""
    output, base = str(problem.requirement.output), float(design.get(ZERO, 0.0))

    def sizes(offsets: Array) -> Array:
        motion = sweep(problem.linkage, design, begin + offsets)
        travel = np.asarray(motion.slide(output).value if problem.slides else motion.body_angle(output).value, dtype=float)
        error = travel - problem.law.curve(offsets, begin, base)
        return np.abs(error if problem.slides else np.remainder(error + math.pi, TURN) - math.pi)[None]

    grid = np.sort(np.linspace(0.0, problem.span, POSITIONS + 1))
    return float(np.max(maxima(sizes, grid)[1])) if np.all(np.isfinite(sizes(grid))) else math.nan


def transmission_angles(motion: Motion, mechanism: Mechanism) -> Array:
    """Return the transmission angle of every dyad (positions, dyads) [rad], from 0 to pi, from the moving links and lines."""

    def between(p: str, q: str) -> Vector:
        x, y = (motion.position(q) - motion.position(p)).T
        return x, y

    angles = []
    for group in transmitting(mechanism):
        if isinstance(group, RRR):
            first, second = (between(group.inner, outer) for outer in group.outer)
        elif isinstance(group, RRP):
            (x, y), second = _direction(motion, group.outer[1]), between(group.outer[0], group.inner)
            first = -y, x
        elif isinstance(group, RPR):
            (x, y), second = _direction(motion, group.inner), between(group.outer[1], group.outer[0])
            first = -y, x
        else:
            first, second = (_direction(motion, guide) for guide in group.prismatic)
        angles.append(np.arctan2(np.abs(cross(first, second)), dot(first, second)))
    return np.stack(angles, axis=1) if angles else np.zeros((len(motion.crank_angle), 0))


def _direction(motion: Motion, guide: Guide) -> Vector:
    """Return the direction of a guide, from the angle of the body that carries it."""
    carried = 0.0 if guide.on == FRAME else np.asarray(motion.body_angle(guide.on).value)
    return unit(carried + float(motion.pose.size(guide.direction)) + 0.0 * motion.crank_angle)


def validate_path(
    problem: DesignProblem, design: Mapping[str, float], crank_angles: Array, objective: float | None = None
) -> Validation:
    """Validate a design at the crank angles of its points [rad], or show where it fails.

    The problem has definite assembly modes; the design [m, rad] has all quantities. `objective`: that of the optimiser, compared
    with the measured one.
    """
    tested = _Tested(problem, design, np.asarray(crank_angles, dtype=float))
    measured = tested.measured.objective
    groups = (_sizes, _closure, _circuit, _order, _points, _transmission, _registered, _pivots)
    checks = [check for group in groups for check in group(tested)]
    if objective is not None:
        squared = problem.measure == "sum of squares"
        checks.append(same_objective(measured, objective, 1e-300, ROUNDING * problem.whole, squared=squared).of())
    return Validation(tuple(checks), measured)


class _Tested:
    """A design in motion: the sweeps shared by the checks."""

    def __init__(self, problem: DesignProblem, design: Mapping[str, float], crank_angles: Array) -> None:
        self.problem, self.design, self.crank_angles = problem, dict(design), crank_angles
        self.mechanism = problem.linkage
        self.turns = problem.limits.crank != "span"
        self.way = 1.0 if crank_angles[-1] >= crank_angles[0] else -1.0
        begin, end = float(crank_angles[0]), float(crank_angles[-1])
        count = max(2, math.ceil(abs(end - begin) / TURN * POSITIONS)) + 1
        self.span = self.sweep(np.linspace(begin, end, count))
        self.revolution = self.sweep(begin + self.way * np.linspace(0.0, TURN, POSITIONS, endpoint=False)) if self.turns else None
        self.measured = deviations(problem, design, crank_angles)

    def sweep(self, angles: Array) -> Motion:
        """Return the mechanism at crank angles."""
        return sweep(self.mechanism, self.design, angles)

    @property
    def required(self) -> Motion:
        """The motion over which the mechanism must be assembled."""
        return self.span if self.revolution is None else self.revolution

    def grid(self, motion: Motion) -> Array:
        """Return the crank angles of a motion, rising; those of the revolution with its end."""
        grid = np.sort(motion.crank_angle)
        return np.append(grid, grid[0] + TURN) if motion is self.revolution else grid

    def strokes(self) -> tuple[float, float, float]:
        """Return the swing angle of the rocker and the crank rotation of its forward and backward strokes [rad], or NaN."""
        travel = self._rocker
        if travel is None:
            return math.nan, math.nan, math.nan
        turned = {stroke.name: stroke.rotation for stroke in travel.strokes(self.way)}
        return travel.span, turned.get("forward", math.nan), turned.get("backward", math.nan)

    @cached_property
    def _rocker(self) -> Travel | None:
        """The travel of the rocker over a revolution."""
        return travels(self.mechanism, self.design, 0.0, TURN, True)[0].get("rocker")

    def output_angle(self) -> Array:
        """Return the angle of the output body (1, positions) [rad], continuous over the motion."""
        at, index = finely(self.crank_angles)
        angle = np.asarray(self.sweep(at).body_angle(str(self.problem.requirement.output)).value, dtype=float)
        return np.asarray(np.unwrap(angle)[None, index])


def _sizes(tested: _Tested) -> Iterator[Check]:
    """Check bounds, fixed quantities, and constant link lengths in motion."""
    problem, design = tested.problem, tested.design
    for checks in bounds_and_links(problem, design, problem.size):
        yield checks.of()
    yield link_lengths(tested.required, max(problem.size, *(design[name] for name in problem.mechanism.quantities))).of()


def _closure(tested: _Tested) -> Iterator[Check]:
    """Check the crank condition from the lengths, and the closure of every loop at every position."""
    problem = tested.problem
    if tested.turns and isinstance(problem.mechanism, FourBarSection):
        yield grashof_check(tested.design, problem.limits).of()
    where = "the whole revolution" if tested.turns else "the range of the points"
    yield from alignment_checks(tested.sweep, tested.grid(tested.required), problem.limits, where)


def _circuit(tested: _Tested) -> Iterator[Check]:
    """Check one branch (each joint of two links stays on its side) and one circuit (continuous, closed paths of all points)."""
    motion = tested.required
    groups = [group for group in tested.mechanism.groups if isinstance(group, RRR)]
    if groups:
        least = _least_height(motion, groups) * 1e3
        yield Check("one branch: every joint on one side", least > 0.0, least, "> 0", "mm")
    step = abs(motion.crank_angle[1] - motion.crank_angle[0])
    worst = 0.0
    for name in dict.fromkeys((*(group.joint for group in tested.mechanism.groups), tested.problem.point)):
        if name not in motion.pose.points:
            continue
        courses = motion.position(name), motion.velocity(name), motion.acceleration(name)
        path, velocity, acceleration = (np.concatenate([x, x[:1]]) if tested.turns else x for x in courses)
        speed, bend = (np.linalg.norm(x, axis=-1) for x in (velocity, acceleration))
        fastest = np.maximum(speed[1:], speed[:-1]) * step + np.maximum(bend[1:], bend[:-1]) * step * step
        jump = np.linalg.norm(np.diff(path, axis=0), axis=-1) / (1.5 * fastest + 1e-9 * tested.problem.size)
        worst = float(np.maximum(worst, np.max(jump) if np.all(np.isfinite(jump)) else np.nan))
    yield Check("one circuit: no point jumps", worst <= 1.0, worst, "<= 1 step at its speed", "")


def _least_height(motion: Motion, groups: Sequence[RRR]) -> float:
    """Return the least distance [m] of a joint from the line of its outer pins: negative on the wrong side, NaN if open."""
    least = math.inf
    for group in groups:
        p, q, c = (motion.position(name) for name in (*group.outer, group.inner))
        line, arm = q - p, c - p
        height = group.side * (line[:, 0] * arm[:, 1] - line[:, 1] * arm[:, 0]) / np.linalg.norm(line, axis=-1)
        least = min(least, float(np.min(height))) if np.all(np.isfinite(height)) else math.nan
    return least


def _order(tested: _Tested) -> Iterator[Check]:
    """Check that the points are passed in order within one revolution, with one direction of the crank."""
    problem, way = tested.problem, tested.way
    steps = np.diff(tested.crank_angles) * way
    if len(steps) and problem.pointed:
        gap = math.degrees(STEP) if problem.timing == "free" else 0.0  # between optimised crank angles
        least = math.degrees(float(np.min(steps)))
        yield Check("points met in order", least > 0.0 and least >= gap * (1.0 - 1e-3), least, "> 0", "deg")
        whole = math.degrees(float(np.sum(steps)))
        most = 360.0 if problem.meets_again else 360.0 - gap  # only a repeated point may lie there
        yield Check("points met within one revolution", whole <= most + 1e-6, whole, f"<= {most:.6g}", "deg")
    sense = problem.rotation
    rotation = {"counter-clockwise": 1.0, "clockwise": -1.0}.get(sense)
    if rotation is not None:
        yield Check(f"crank turns {sense}", way == rotation, way, f"= {rotation:g}", "")
    offsets = problem.data.offsets
    if offsets is not None and (problem.pointed or problem.timing != "given"):
        start = tested.design["start"] if problem.timing == "from start" else 0.0
        miss = math.degrees(float(np.max(np.abs(tested.crank_angles - start - offsets))))
        yield Check("crank angles as given", bool(miss <= 1e-7), miss, "<= 1e-07", "deg")


def _points(tested: _Tested) -> Iterator[Check]:
    """Check that every point has a position, and is passed within its tolerance."""
    problem, distances = tested.problem, tested.measured.distances
    factor, unit = DISPLAYED[problem.unit]
    whole, largest = bool(np.all(np.isfinite(distances))), float(np.max(distances)) * factor
    yield Check("the linkage has a position for every target", whole, largest, "finite", unit)
    if problem.requirement.kind == "function" and not problem.slides:
        target = problem.prescribed_outputs(tested.design)[None, :]
        yield from (check.of() for check in revolutions_check(tested.crank_angles, target, tested.output_angle))
    if np.any(np.isfinite(problem.data.tolerances)):
        used = float(np.max(distances / problem.data.tolerances))
        yield Check("points met within their tolerances", used <= 1.0 + 1e-6, used, "<= 1", "of the tolerance")


def _transmission(tested: _Tested) -> Iterator[Check]:
    """Check the extremes of the transmission angle of every dyad, by sweep and refinement."""
    groups = transmitting(tested.mechanism)
    limits = [tested.problem.limits.transmission_at(group.joint) for group in groups]
    if not any(limits):
        return

    def angles(at: Array) -> Array:
        return transmission_angles(tested.sweep(at), tested.mechanism).T

    motion = tested.span
    if tested.problem.limits.transmission_range == "revolution" and tested.revolution is not None:
        motion = tested.revolution
    extreme = np.degrees(extremes(angles, tested.grid(motion), periodic=motion is tested.revolution)[1])
    for group, limit, (least, largest) in zip(groups, limits, extreme, strict=True):
        where = "" if len(groups) == 1 else f" at {group.joint}"
        yield from (check.of() for check in transmission_checks(least, largest, limit, where))


def _registered(tested: _Tested) -> Iterator[Check]:
    """Check the registered limits, such as proportions, swing angle and time ratio."""
    yield from registered_checks(tested, tested.problem.limits, tested.design.get("frame", tested.problem.size))


def _pivots(tested: _Tested) -> Iterator[Check]:
    """Check that every point of the frame is inside the region."""
    region = tested.problem.limits.pivots
    if region is None:
        return
    tolerance = 1e-8 * tested.problem.size * 1e3
    for name in [point for point, bodies in tested.mechanism.owners.items() if FRAME in bodies]:
        place = (tested.required.position(name)[0] * 1e3).tolist()
        for axis, value, interval in zip("xy", place, (region.x, region.y), strict=True):
            if interval is not None:
                yield from limit_checks(f"pivot {name}.{axis}", value, interval, tolerance, 1e3, "mm")
