"""Validate designs by a sweep of the mechanism itself, independent of the optimiser's formulas.

Link lengths are measured between joint positions, transmission angles between two unit vectors, dead centres at sign changes of
the rocker velocity, the crank condition by closing every loop at every crank angle. The optimiser's terms and solvers are not
imported. Many designs are validated at once, each by the same operations as one: arrays have a leading axis of designs.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from optlink.io import keeping
from optlink.linkage.dyads import RRR, transmitting
from optlink.linkage.extrema import extremes_of_rows
from optlink.linkage.fourbar import inner_four_bars
from optlink.linkage.mechanism import FRAME, Mechanism
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.vector2d import TURN, Array, Value, max_magnitude, whole_turns, wrapped
from optlink.problem.design import STEP, DesignProblem
from optlink.problem.limits import Bound, RegionLimit, limits_in_file
from optlink.problem.quantity import Unusable
from optlink.problem.requirements.base import MARK, pose_angles
from optlink.problem.requirements.laws import DEAD_CENTRES
from optlink.problem.targets.law import Table
from optlink.problem.tolerances import EXPECTED, WORST
from optlink.units import DISPLAYED, KINDS, factor
from optlink.validation.check import (
    ANGLE_TOLERANCE,
    LENGTH_TOLERANCE,
    MEASURED_ROBUST,
    POSITIONS,
    SAME,
    Check,
    Checks,
    Validation,
    Validations,
    alignment_check,
    at_least,
    bounds_and_links,
    finely,
    grashof_check,
    joined,
    limit_checks,
    registered_checks,
    revolutions_check,
    same_objective,
    text,
    transmission_checks,
)
from optlink.validation.motion import FourBarMotion, LinkageMotion, motion_of, placed, rows_of, transmission_angles

if TYPE_CHECKING:
    from optlink.validation.cycle import Cycle

MEET = 1e-6  # relative violation permitted for a limit of a quantity of the machine, and for a tolerance
ZERO_LIMIT_REFERENCE = 1e-3  # of the size of the signal, the reference for the tolerance of a limit of zero
BALANCE = 1e-9  # relative difference permitted between the work of the drive and of the loads
ROUNDING = {"rad": 1e-12, "m": 1e-11, "": 1e-11}
"""Absolute agreement required of nearly zero deviations, by their SI unit: lengths as a share of the size of the curve."""
BASE = math.radians(1e-7)  # or share of the size; tolerance of an output at the start that is the actual one
LEAST_PART = 0.25  # of a revolution whose positions cover the range of a law at least
PLACED = 1e-8  # of the size; tolerance of the places of pivots, and of points
DIFFERENCE = 1e-5  # of the reference length; step of central differences by dimensions


def validate(
    problem: DesignProblem,
    design: Mapping[str, float],
    angles: ArrayLike | None = None,
    objective: float | None = None,
    mechanism: Mechanism | None = None,
    cycle: Cycle | None = None,
    accuracy: float = 0.0,
) -> Validation:
    """Validate a design, or show where it fails.

    Parameters
    ----------
    problem : DesignProblem
        With definite assembly modes.
    design : mapping of name to float [m, rad]
        All quantities; of the dimensions those of the file are the defaults.
    angles : array (positions,) [rad], optional
        Crank angles at the positions. Default: those that the problem prescribes; needed if it does not.
    objective : float [SI], optional
        That of the optimiser, compared with the measured one.
    mechanism : Mechanism, optional
        Tested instead of the linkage of the problem; its bodies and joints must have the same names.
    cycle : Cycle, optional
        The machine in motion, with what was measured of it already.
    accuracy : float
        Of integrals in the objective of the optimiser, relative; integrands with kinks have many positions and few digits.
    """
    if not problem.composed:
        return validate_batch(problem, design, angles, objective, mechanism).of()
    checks, total, least = _targets(problem, design, angles, mechanism) if problem.parts else ([], 0.0, 1e-300)
    if problem.goals or problem.bounds:
        from optlink.validation.cycle import Cycle

        try:
            cycle = cycle or Cycle(problem, keeping(design, *problem.mechanism.quantities))
        except Unusable as error:
            return Validation((Check(f"the machine can be made: {error.message}", False, math.nan, "yes", ""),), math.nan)
        checks += [] if problem.parts else [*_machine_sizes(cycle), *_machine_motion(cycle)]
        if problem.parts or cycle.complete:
            checks += [check for item in problem.bounds for check in _bound(cycle, item)]
        total, least = total + cycle.objective(), max(least, cycle.natural())
    if objective is not None:
        checks.append(same_objective(total, objective, least, same=max(SAME, accuracy)).of())
    return Validation(tuple(checks), total)


def _targets(
    problem: DesignProblem, design: Mapping[str, float], angles: ArrayLike | None, mechanism: Mechanism | None
) -> tuple[list[Check], float, float]:
    """Return the checks of the requirements with targets, their share of the objective, and its rounding error."""
    every = problem.crank_angles(design, None) if angles is None else np.asarray(angles, dtype=float)
    linked = {f"{name} {problem.quantities[name].status}" for name in problem.links}  # which the parts do not know
    sizes = [tested.of() for tested in bounds_and_links(problem, design, problem.size)]
    checks = {check.name: check for check in sizes if check.name in linked}
    total, least = 0.0, 1e-300
    for part, own in problem.of_parts(every):
        tested = validate_batch(part, part.own(design), own, None, mechanism).of()
        for check in tested.checks:
            if check.name in checks and checks[check.name] != check:
                check = replace(check, name=f"{check.name}{part.suffix}")
            checks[check.name] = check
        if part.tolerance is None:
            total += part.worth * tested.objective
            rounding = ROUNDING[part.unit] * part.whole
            least = max(least, part.worth * (rounding**2 if part.measure == "sum of squares" else rounding) / SAME)
        (factor, unit), (stated, offset) = DISPLAYED[part.unit], part.requirement.stated(part)
        if part.tolerance is None or offset is not None:  # the output itself is limited, by a check of its own
            continue
        name = (f"largest {part.requirement.limited_by[1]}" if part.measure == "max" else "rms") + part.suffix
        met = bool(tested.objective <= part.tolerance * (1.0 + MEET))
        checks[name] = Check(name, met, tested.objective * factor * stated, f"<= {part.tolerance * factor * stated:.6g}", unit)
    return [*checks.values()], total, least


def validate_batch(
    problem: DesignProblem,
    designs: Mapping[str, ArrayLike],
    angles: ArrayLike | None = None,
    objective: ArrayLike | None = None,
    mechanism: Mechanism | None = None,
) -> Validations:
    """Validate many designs at once, each as `validate`; the result for a design does not depend on the others.

    All numbers are arrays (designs,), those of the quantities and limits of the problem may be; `angles` are
    (designs, positions).
    """
    tested = _Tested(problem, designs, angles, mechanism)
    measured = tested.targets.measured.objective
    checks = [*_sizes(tested), *_crank(tested), *_circuit(tested.problem.linkage, tested.required), *_timing(tested)]
    checks += tested.targets.checks()
    checks += [check for group in (_transmission, _registered, _pivots, _regions) for check in group(tested)]
    if objective is not None:
        rounding, squared = ROUNDING[problem.unit] * problem.whole, problem.measure == "sum of squares"
        agrees = same_objective(measured, objective, 1e-300, rounding, squared=squared)
        checks.append(agrees if problem.robust is None else replace(agrees, name=MEASURED_ROBUST))
    return Validations(tuple(checks), measured)


@dataclass(frozen=True)
class MeasuredDeviations:
    """Measured deviations at the positions, and the objective [SI], of one design.

    `generated` (positions, 2) [m]: points; of a law (positions, 1): its output [m or rad]; of the transmission (positions,
    joints): angles [rad]. `distances` (positions,): from the points [m], of the output [m or rad], largest absolute cosine of the
    transmission angles. `turned`: angle errors [rad] of poses. For many designs all have a leading axis.
    """

    generated: Array
    distances: Array
    turned: Array | None
    objective: Array


def deviations(problem: DesignProblem, design: Mapping[str, float], angles: ArrayLike) -> MeasuredDeviations:
    """Move the mechanism to the crank angles [rad] and measure its deviations from the targets, weighted as in the problem.

    The problem has definite assembly modes; the design [m, rad] has all quantities.
    """
    measured = _Tested(problem, design, angles).targets.measured
    turned = None if measured.turned is None else measured.turned[0]
    return MeasuredDeviations(measured.generated[0], measured.distances[0], turned, measured.objective[0])


class _Tested:
    """Designs in motion: the sweeps shared by the checks."""

    def __init__(
        self,
        problem: DesignProblem,
        designs: Mapping[str, ArrayLike],
        angles: ArrayLike | None,
        mechanism: Mechanism | None = None,
    ) -> None:
        self.problem, self.mechanism, self.given = problem, mechanism or problem.linkage, angles is not None
        columns = np.broadcast_arrays(*(np.atleast_1d(value) for value in designs.values()))
        self.count = len(columns[0])
        self.design = {name: np.asarray(column, dtype=float) for name, column in zip(designs, columns, strict=True)}
        self.values = {name: column[:, None] for name, column in self.design.items()}
        quantities = problem.mechanism.quantities
        self.sizes = {name: self._column(self.design.get(name, quantity.value)) for name, quantity in quantities.items()}
        angles = problem.crank_angles(self.values, None) if angles is None else angles
        self.angles = np.array(np.broadcast_to(np.asarray(angles, dtype=float), (self.count, np.shape(angles)[-1])))
        self.size = problem.size if problem.unit == "m" or self.lengths is None else self.lengths[3]
        self.targets = TARGETS[problem.requirement.family](self)

    def _column(self, value: ArrayLike) -> Array:
        return np.array(np.broadcast_to(np.asarray(value, dtype=float), self.count))[:, None]

    @cached_property
    def lengths(self) -> tuple[Array, ...] | None:
        """Lengths (designs,) [m] of crank, coupler, rocker and frame, between its pivots; None if the linkage is no four-bar."""
        loop = self.problem.four_bar
        if loop is None:
            return None
        frame = self.placed(np.zeros(1)).distance(loop.crank.start, loop.ground_pin)
        return (*(self.sizes[name][:, 0] for name in loop.names), np.broadcast_to(frame, (self.count, 1))[:, 0])

    @cached_property
    def revolution(self) -> FourBarMotion | LinkageMotion:
        """The motion over a revolution, or over the range of the drive."""
        low, high = self.problem.linkage.extent
        if not self.limited:
            return self._motion(np.linspace(low, high, POSITIONS, endpoint=False), closed=True)
        return self._motion(np.linspace(low, high, POSITIONS * whole_turns(high - low) + 1), span=high - low)

    @property
    def limited(self) -> bool:
        """Whether the drive moves through a range."""
        return self.problem.linkage.limits is not None

    @cached_property
    def span(self) -> FourBarMotion | LinkageMotion:
        """The motion over the span of a law, or from the first position to the last."""
        begin, span = self.targets.range
        if self.problem.data.offsets is None:  # every design has its own span, and the same number of positions
            count = POSITIONS + 1
        else:
            offsets = self.problem.data.offsets
            whole = abs(span if isinstance(span, float) else float(offsets[-1] - offsets[0]))
            count = max(2, math.ceil(whole / TURN * POSITIONS)) + 1
        return self._motion(begin + np.linspace(0.0, 1.0, count) * span, span=span)

    def _motion(self, angles: Array, *, closed: bool = False, span: Value = TURN) -> FourBarMotion | LinkageMotion:
        prescribed, point = self.problem.linkage, self.problem.point
        return motion_of(prescribed, self.mechanism, self.sizes, angles, self.size, point, closed=closed, span=span)

    @property
    def way(self) -> Array:
        """Sense of rotation of the crank (designs,): 1 or -1."""
        return np.broadcast_to(np.ravel(np.where(np.asarray(self.targets.range[1]) >= 0.0, 1.0, -1.0)), self.count)

    @property
    def turns(self) -> bool:
        """Whether the crank has to turn fully."""
        return self.problem.limits.crank != "span"

    @property
    def required(self) -> FourBarMotion | LinkageMotion:
        """The motion over which the mechanism must be assembled."""
        return self.revolution if self.turns else self.span

    def placed(self, angles: Array, sizes: Mapping[str, Array] | None = None) -> Motion:
        """Return the positions at crank angles (..., designs, n) [rad]."""
        return placed(self.mechanism, sizes or self.sizes, angles)

    def deviating(self, angles: Array, name: str, by: Array) -> tuple[Motion, Array, tuple[Array, Array]]:
        """Return the positions at crank angles [rad], with one dimension or coordinate larger by `by` (designs, 1) [m, rad].

        The crank angle is that of the drawing. Displaced pivots of a four-bar that is given by its lengths rotate its frame, and
        thus the crank angle relative to it: the positions are in the frame, which is turned [rad] and moved [m].
        """
        still = np.zeros_like(by)
        sizes = {key: size + by if key == name else size for key, size in self.sizes.items()}
        if name in sizes:
            return self.placed(angles, sizes), still, (still, still)
        along = sizes["frame"] - (by if name == "A.x" else 0.0)
        across = {"D.y": by, "A.y": -by}.get(name, still)
        sizes["frame"], tilt = np.hypot(along, across), np.arctan2(across, along)
        return self.placed(angles - tilt, sizes), tilt, (by if name == "A.x" else still, by if name == "A.y" else still)


class _OneDesign:
    """One of the designs in motion, as the limits of `optlink.problem.limits` measure it."""

    def __init__(self, tested: _Tested, design: int) -> None:
        self.mechanism, self._tested, self._number = tested.mechanism, tested, design
        self.design = {name: float(values[design]) for name, values in tested.design.items()}
        crank, coupler, rocker, frame = (float(length[design]) for length in tested.lengths or [np.full(design + 1, np.nan)] * 4)
        self.lengths = crank, coupler, rocker, frame

    @cached_property
    def required(self) -> Motion:
        """The motion over which the mechanism must be assembled."""
        angles = self._tested.required.angles
        sizes = {name: float(values[self._number, 0]) for name, values in self._tested.sizes.items()}
        return sweep(self.mechanism, sizes, angles if angles.ndim == 1 else angles[self._number])

    def strokes(self) -> tuple[float, float, float]:
        """Return the swing angle of the rocker and the crank rotation of its forward and backward strokes [rad], or NaN."""
        return self._tested.revolution.strokes(self._number, float(self._tested.way[self._number]))


# --- requirements -----------------------------------------------------------------------------------------------------------


class _Targets:
    """Measured deviations from a requirement, and the checks of it."""

    def __init__(self, tested: _Tested) -> None:
        self.tested, self.problem = tested, tested.problem

    @property
    def range(self) -> tuple[Array, Value]:
        """Crank angle at the start (designs, 1) and rotation from there [rad], a number or (designs, 1): between positions."""
        angles = self.tested.angles
        return angles[:, :1], angles[:, -1:] - angles[:, :1]

    @cached_property
    def measured(self) -> MeasuredDeviations:
        """Deviations at the positions."""
        raise NotImplementedError

    def checks(self) -> Iterator[Checks]:
        """Check that every position has a deviation."""
        distances = self.measured.distances
        factor, unit = DISPLAYED[self.problem.unit]
        whole, largest = np.all(np.isfinite(distances), axis=1), np.max(distances, axis=1) * factor
        yield Checks("the linkage has a position for every target", whole, largest, "finite", unit)

    def scattered(self, middle: Array, outputs: Callable[[str, Array], Array]) -> tuple[Array, Array]:
        """Return the mean deviation (..., components) with tolerances and its scatter (...), by central differences.

        The scatter is the requested number of standard deviations (one for an expected square), or the worst case; of several
        components it is the root of the sum of their variances, or the sum of the lengths of the changes. `outputs` has the
        deviation with one dimension or coordinate larger by some columns [m, rad].
        """
        robust, spread = self.problem.robust, np.zeros(middle.shape[:-1])
        if robust is None:
            return middle, spread
        reference = np.broadcast_to(np.asarray(self.tested.size, dtype=float), self.tested.count)[:, None]
        for deviation in self.problem.deviations:
            step = DIFFERENCE * (np.ones_like(reference) if deviation.kind == "angle" else reference)
            change = self.difference(*(outputs(deviation.size, way) for way in (step, -step)))
            slope = change / (2.0 * step[..., None])
            length = np.linalg.norm(slope, axis=-1)
            if robust.text == WORST:
                low, high = deviation.ends
                middle, spread = middle + 0.5 * (low + high) * slope, spread + 0.5 * (high - low) * length
            else:
                middle, spread = middle + slope * deviation.mean, spread + np.square(length * deviation.sigma)
        if robust.text != WORST:
            spread = (1.0 if robust.text == EXPECTED else robust.sigmas) * np.sqrt(spread)
        return middle, spread

    def difference(self, one: Array, other: Array) -> Array:
        """Return the difference of two deviations (..., components)."""
        return one - other

    def with_scatter(self, middle: Array, spread: Array) -> Array:
        """Return the squares of deviations (..., components) with their scatter: the largest ones, or the expected ones."""
        length = np.linalg.norm(middle, axis=-1)
        return np.asarray(np.square(length + spread) if self.problem.measure == "max" else np.square(length) + np.square(spread))

    def robust_check(self, largest: Array) -> Checks:
        """Check that the largest deviation (designs,) with tolerances has a value."""
        factor, unit = DISPLAYED[self.problem.unit]
        most = largest * factor
        name = f"error with tolerances, {'' if self.problem.robust is None else self.problem.robust.band}, has a value"
        return Checks(name, np.isfinite(most), most, "finite", unit)

    def reduced(self, squares: Array) -> Array:
        """Return the objectives (designs,) for squared deviations (designs, positions)."""
        weighted, measure = squares * self.problem.data.roots**2, self.problem.measure
        if measure == "max":
            return np.asarray(np.sqrt(np.max(weighted, axis=1)))
        total = np.array([math.fsum(row) for row in weighted.tolist()])
        return np.sqrt(total / squares.shape[1]) if measure == "rms" else total


def point_deviations(
    problem: DesignProblem, motion: Motion, values: Mapping[str, Value], targets: Array
) -> tuple[Array, Array, Array | None, Array]:
    """Return the positions of the point, its distances from the targets, angle errors of poses, and squared deviations.

    Without weights; `targets` are rows of `TargetArrays.columns` (..., k) that broadcast against the motion.
    """
    known = problem.point in motion.pose.points
    generated = motion.position(problem.point) if known else np.full((*motion.shape, 2), np.nan)
    away = generated - targets[..., :2]
    distances, turned = np.hypot(away[..., 0], away[..., 1]), None
    squares = distances**2
    if MARK in problem.quantities:
        angle = motion.wrapped_angle(problem.body) + values[MARK]
        wanted = pose_angles(targets)
        turned = np.where(np.isnan(wanted), 0.0, wrapped(angle - wanted))
        squares = squares + (problem.radian * turned) ** 2
    return generated, distances, turned, squares


class _Points(_Targets):
    """Points or poses that are passed in order."""

    @cached_property
    def measured(self) -> MeasuredDeviations:
        """Distances from the points, and angle errors of poses."""
        tested, targets = self.tested, self.problem.data.columns
        motion = tested.placed(tested.angles)
        generated, distances, turned, squares = point_deviations(self.problem, motion, tested.values, targets)
        if self.problem.robust is not None:
            away = generated - targets[..., :2]
            parts = [away] if turned is None else [away, self.problem.radian * turned[..., None]]
            squares = self.with_scatter(*self.scattered(np.concatenate(parts, axis=-1), self._deviating))
        return MeasuredDeviations(generated, distances, turned, self.reduced(squares))

    def _deviating(self, name: str, by: Array) -> Array:
        """Return the places of the point [m], and the angles of its body times `radian`, with a dimension larger by `by`."""
        motion, tilt, (x, y) = self.tested.deviating(self.tested.angles, name, by)
        place = motion.position(self.problem.point)
        cosine, sine = np.cos(tilt), np.sin(tilt)
        parts = [x + cosine * place[..., 0] - sine * place[..., 1], y + sine * place[..., 0] + cosine * place[..., 1]]
        if MARK in self.problem.quantities:
            turned = motion.wrapped_angle(self.problem.body) + tilt
            parts.append(self.problem.radian * np.where(np.isnan(pose_angles(self.problem.data.columns)), 0.0, turned))
        return np.stack(parts, axis=-1)

    def difference(self, one: Array, other: Array) -> Array:
        """Return the difference of two positions, of angles within half a turn."""
        change, whole = one - other, TURN * self.problem.radian
        turned = np.remainder(change[..., 2:] + 0.5 * whole, whole) - 0.5 * whole
        return np.concatenate([change[..., :2], turned], axis=-1)

    def checks(self) -> Iterator[Checks]:
        """Check that the points are passed in order within a revolution, in one sense of rotation, within their tolerances."""
        tested, problem, tolerances = self.tested, self.problem, self.problem.data.tolerances
        steps = np.degrees(np.diff(tested.angles, axis=1) * tested.way[:, None])
        if steps.size:
            gap = math.degrees(STEP) if problem.timing == "free" else 0.0  # between optimised crank angles
            least, whole = np.min(steps, axis=1), np.sum(steps, axis=1)
            yield Checks("points met in order", (least > 0.0) & (least >= gap * (1.0 - 1e-3)), least, "> 0", "deg")
            most = 360.0 if problem.meets_again else 360.0 - gap  # only a repeated point may lie there
            if not tested.limited:
                yield Checks("points met within one revolution", whole <= most + 1e-6, whole, f"<= {most:.6g}", "deg")
        if len(problem.ways) == 1:
            right = tested.way == problem.ways[0]
            yield Checks(f"crank turns {problem.rotation}", right, tested.way, f"= {problem.ways[0]:g}", "")
        yield from super().checks()
        if problem.robust is not None:
            yield self.robust_check(self.measured.objective)
        if np.any(np.isfinite(tolerances)):
            used = np.max(self.measured.distances / tolerances, axis=1)
            yield Checks("points met within their tolerances", used <= 1.0 + 1e-6, used, "<= 1", "of the tolerance")


class _Transmission(_Targets):
    """Transmission angles of all dyads."""

    @cached_property
    def measured(self) -> MeasuredDeviations:
        """Transmission angles, and the largest cosine: of the measure `max` that over the revolution."""
        tested = self.tested
        generated = transmission_angles(tested.placed(tested.angles), self.problem.linkage)
        cosines = np.abs(np.cos(generated))
        if self.problem.measure != "max":
            squares = cosines**2 if self.problem.robust is None else self.with_scatter(*self._cosines(tested.angles))
            objective = self.reduced(np.sum(squares, axis=2))
        elif self.problem.robust is not None:
            grid = np.linspace(*self.problem.linkage.extent, POSITIONS, endpoint=tested.limited)

            def ends(angles: Array) -> Array:
                middle, spread = self._cosines(angles)
                return np.moveaxis(np.abs(middle[..., 0]) + spread, -1, 0)

            rows = rows_of(ends, cosines.shape[-1], tested.count)
            largest = extremes_of_rows(rows, grid, periodic=not tested.limited, signs=(-1.0,))
            objective = np.max(largest.reshape(-1, tested.count), axis=0)
        else:
            worst = np.max(np.abs(np.cos(tested.revolution.transmission_extremes)), axis=(0, 1))
            objective = np.where(np.all(tested.revolution.least_squared_sines >= 0.0, axis=0), worst, np.nan)
        return MeasuredDeviations(generated, np.max(cosines, axis=2), None, objective)

    def _cosines(self, angles: Array) -> tuple[Array, Array]:
        """Return the mean cosines (designs, positions, joints, 1) with tolerances at crank angles [rad], and their scatter."""

        def outputs(name: str, by: Array) -> Array:
            motion = self.tested.deviating(angles, name, by)[0]
            return np.cos(transmission_angles(motion, self.problem.linkage))[..., None]

        drawn = np.cos(transmission_angles(self.tested.placed(angles), self.problem.linkage))[..., None]
        return self.scattered(drawn, outputs)

    def checks(self) -> Iterator[Checks]:
        """Check that every position has a deviation, with tolerances too."""
        yield from super().checks()
        if self.problem.robust is not None:
            yield self.robust_check(self.measured.objective)


class _Law(_Targets):
    """An output that follows a law, with the effect of tolerances on its error."""

    def __init__(self, tested: _Tested) -> None:
        super().__init__(tested)
        problem, zero = tested.problem, np.zeros((tested.count, 1))
        self.law, self.name = problem.law, problem.output
        self.start, self.base = tested.values[problem.start_name], tested.values.get(problem.base_name, zero)

    @property
    def range(self) -> tuple[Array, Value]:
        """Crank angle at the start (designs, 1), and the span of the law [rad]."""
        return self.start, self.problem.span

    @cached_property
    def measured(self) -> MeasuredDeviations:
        """Output and its errors; the largest error of a law that is a formula is that over its whole range."""
        middle, spread = self._at_positions
        if self.problem.everywhere:
            objective = self._largest()
        elif self.problem.measure == "max":
            objective = np.max(np.abs(middle) + spread, axis=1)
        else:
            objective = self.reduced(np.square(middle) + np.square(spread))
        return MeasuredDeviations(self._actual[..., None], np.abs(self._errors), None, objective)

    @cached_property
    def _actual(self) -> Array:
        """Output at the positions (designs, positions)."""
        return self._output(self.tested.angles)

    @cached_property
    def _errors(self) -> Array:
        """Errors at the positions (designs, positions)."""
        return self._error(self._actual, self.law.offsets, self.law.tabulated)

    @cached_property
    def _at_positions(self) -> tuple[Array, Array]:
        """Mean error and scatter at the positions (designs, positions)."""
        return self._scattered(self._errors, self.tested.angles)

    def _output(self, angles: Array) -> Array:
        """Return the output (..., designs, n) [rad, within a turn, or m] at crank angles [rad]."""
        return self._shown(self.tested.placed(angles))

    def _shown(self, motion: Motion) -> Array:
        return np.asarray(motion.coordinate(self.name).value) if self.problem.slides else motion.wrapped_angle(self.name)

    def difference(self, one: Array, other: Array) -> Array:
        """Return the difference of two outputs [rad, of angles within half a turn, or m]."""
        return one - other if self.problem.slides else np.asarray(wrapped(one - other))

    def _error(self, actual: Array, at: Array, tabulated: Value = 0.0) -> Array:
        """Return actual minus prescribed output at crank rotations from the start [rad]."""
        with np.errstate(all="ignore"):
            target = np.asarray(self.law.target(at, tabulated, self.start, self.base) + 0.0 * at, dtype=float)
        return self.difference(actual, target)

    def _scattered(self, middle: Array, angles: Array) -> tuple[Array, Array]:
        """Return the mean error with tolerances at crank angles [rad] and its scatter to either side."""

        def outputs(name: str, by: Array) -> Array:
            motion, tilt, _ = self.tested.deviating(angles, name, by)
            return np.asarray(self._shown(motion) + tilt)[..., None]

        mean, spread = self.scattered(middle[..., None], outputs)
        return mean[..., 0], spread

    def _largest(self) -> Array:
        """Return the largest magnitude of the error with its scatter over the whole range (designs,)."""
        span = self.problem.span
        grid = np.linspace(0.0, 1.0, math.ceil(max(abs(span) / TURN, LEAST_PART) * POSITIONS) + 1)

        def sides(shares: Array) -> Array:
            at = span * shares
            middle, spread = self._scattered(self._error(self._output(self.start + at), at), self.start + at)
            return np.stack([spread + middle, spread - middle])

        largest = extremes_of_rows(rows_of(sides, 2, self.tested.count), grid, periodic=False, signs=(-1.0,))
        return np.asarray(np.max(largest.reshape(2, -1), axis=0))

    def _prescribed_from_start(self) -> tuple[Array, Array]:
        """Return crank rotations (rotations,) from the start on and the prescribed output (designs, rotations) there.

        At the start and the positions. NaN at the start where the law is not defined; a table is not extrapolated.
        """
        law = self.law
        at = law.offsets if law.offsets[0] == 0.0 else np.concatenate([[0.0], law.offsets])
        with np.errstate(all="ignore"):
            target = np.array(np.broadcast_to(law.curve(at, self.start, self.base), (self.tested.count, len(at))))
        if isinstance(law.source, Table) and law.source.from_start and not min(law.source.phi) <= 0.0 <= max(law.source.phi):
            target[:, :1] = self.base if self.problem.tied else np.nan  # its rows are relative to that output
        return at, target

    def checks(self) -> Iterator[Checks]:
        """Check the start of the law, and that its error has a value at every position without extra revolutions."""
        problem = self.problem
        yield from self._dead_centre()
        factor, unit = DISPLAYED[problem.unit]
        if problem.tied:
            gap = np.abs(self.difference(self._output(self.start), self.base))[:, 0] * factor
            near = BASE * problem.whole * factor
            name = f"{problem.base_name} is the {self.name} {'slide' if problem.slides else 'angle'} at {problem.start_name}"
            yield Checks(name, gap <= near, gap, f"<= {near:.0e}", unit)
        largest = np.max(self.measured.distances, axis=1) * factor
        yield Checks("output error has a value everywhere", np.isfinite(largest), largest, "finite", unit)
        if not problem.slides:
            at, target = self._prescribed_from_start()
            fine, index = finely(at)
            yield from revolutions_check(at, target, lambda: np.unwrap(self._output(self.start + fine), axis=1)[:, index])
        if problem.robust is not None:
            middle, spread = self._at_positions
            yield self.robust_check(np.max(np.abs(middle) + spread, axis=1))

    def _dead_centre(self) -> Iterator[Checks]:
        """Check that a start at a dead centre is one: the rocker at rest, crank and coupler in line."""
        start, loops = self.problem.dead_centre, inner_four_bars(self.problem.linkage)
        loop = next((loop for loop in loops if loop.plain and loop.rocker.body == self.name), None)
        if start is None or loop is None:
            return
        begin = sweep(self.tested.mechanism, self.tested.sizes, self.start)
        rate = np.abs(begin.body_rate(loop.rocker.body)[:, 0])
        yield Checks("rocker at rest at its dead centre", rate <= 1e-6, rate, "<= 1e-06", "")
        bars = crank, coupler, _ = [self.tested.sizes[str(link.length)][:, 0] for link in (loop.crank, loop.coupler, loop.rocker)]
        frame, away = (begin.distance(loop.crank.start, name)[:, 0] for name in (loop.ground_pin, loop.joint))
        extended = coupler + (1.0 if start == DEAD_CENTRES[0] else -1.0) * crank
        gap, near = np.abs(away - np.abs(extended)) * 1e3, 1e-6 * frame * 1e3
        yield Checks("crank and coupler in line there", gap <= near, gap, text("<= {:.1e}", near), "mm")
        if start == DEAD_CENTRES[1]:
            margin = self.problem.limits.length_margin * np.max([*bars, frame], axis=0)
            yield at_least("inner dead centre: C apart from A", np.abs(coupler - crank) * 1e3, margin * 1e3, "mm")


class _Position(_Targets):
    """An output at one crank angle."""

    @cached_property
    def measured(self) -> MeasuredDeviations:
        """Output, and its difference from the middle of its range."""
        motion, output, middle = self.tested.placed(self.tested.angles), self.problem.output, self.problem.requirement.middle
        if self.problem.slides:
            generated = np.asarray(motion.coordinate(output).value)
        else:
            generated = middle + np.remainder(motion.wrapped_angle(output) - middle + math.pi, TURN) - math.pi
        away = np.abs(generated - middle)
        return MeasuredDeviations(generated[..., None], away, None, away[:, 0])

    def checks(self) -> Iterator[Checks]:
        """Check that the output lies in its range."""
        problem, stated = self.problem, self.problem.requirement
        factor, unit = DISPLAYED[problem.unit]
        near = ANGLE_TOLERANCE if unit == "deg" else PLACED * problem.size * factor
        value, driving = self.measured.generated[:, 0, 0] * factor, problem.driving
        yield from limit_checks(
            f"{problem.output} at {driving.shown(stated.at.value):g} {driving.unit}", value, stated.value, near, factor, unit
        )


TARGETS: Mapping[str, type[_Targets]] = {
    "path": _Points,
    "motion": _Points,
    "function": _Law,
    "position": _Position,
    "transmission": _Transmission,
}
"""What is measured, by the kind of the requirement."""


# --- the linkage ------------------------------------------------------------------------------------------------------------


def _sizes(tested: _Tested) -> Iterator[Checks]:
    """Check bounds, fixed quantities, and constant link lengths in motion."""
    yield from bounds_and_links(tested.problem, tested.design, tested.size)
    yield from _reached(tested)
    lengths = (np.abs(tested.sizes[name][:, 0]) for name, q in tested.problem.mechanism.quantities.items() if q.in_metres)
    yield tested.required.link_lengths(functools.reduce(np.maximum, lengths, np.asarray(tested.size)))


def _reached(tested: _Tested) -> Iterator[Checks]:
    """Check that all positions lie within the range of the drive."""
    if tested.limited:
        low, high = tested.problem.linkage.extent
        beyond = np.degrees(np.max(np.maximum(low - tested.angles, tested.angles - high), axis=1, initial=0.0))
        yield Checks("positions within the range of the drive", beyond <= 1e-6, beyond, "<= 1e-06", "deg")


def _crank(tested: _Tested) -> Iterator[Checks]:
    """Check the crank condition from the lengths, and the closure of every loop at every position."""
    limits, groups = tested.problem.limits, tested.problem.linkage.groups
    if tested.turns and tested.lengths is not None:
        yield grashof_check(tested.lengths, limits)
    where = "the range" if tested.limited else "the whole revolution" if tested.turns else "the span"
    for group, least in zip(groups, tested.required.least_squared_sines, strict=True):
        yield alignment_check(group, len(groups) == 1, least, limits, where)


def _circuit(linkage: Mechanism, motion: FourBarMotion | LinkageMotion) -> Iterator[Checks]:
    """Check one branch (each joint of two links stays on its side) and one circuit (continuous, closed paths of the joints)."""
    if any(isinstance(group, RRR) for group in linkage.groups):
        least = motion.least_height * 1e3
        yield Checks("one branch: every joint on one side", least > 0.0, least, "> 0", "mm")
    worst = motion.largest_jump
    yield Checks("one circuit: no point jumps", worst <= 1.0, worst, "<= 1 step at its speed", "")


def _timing(tested: _Tested) -> Iterator[Checks]:
    """Check the crank angles at the positions, if they are prescribed up to their start."""
    problem = tested.problem
    if tested.given and problem.data.offsets is not None and (problem.pointed or problem.timing != "given"):
        wrong = np.abs(tested.angles - problem.crank_angles(tested.values, None))
        miss = np.degrees(np.max(wrong, axis=1))
        yield Checks("crank angles as given", miss <= 1e-7, miss, "<= 1e-07", "deg")


def _transmission(tested: _Tested) -> Iterator[Checks]:
    """Check the extremes of the transmission angle of every dyad, by sweep and refinement."""
    groups, all_limits = transmitting(tested.problem.linkage), tested.problem.limits
    limits = [all_limits.transmission_at(group.joint) for group in groups]
    if any(limits):
        motion = tested.revolution if all_limits.transmission_range == "revolution" and tested.turns else tested.span
        extremes = np.degrees(motion.transmission_extremes)
        for group, limit, least, largest in zip(groups, limits, *extremes, strict=True):
            yield from transmission_checks(least, largest, limit, "" if len(groups) == 1 else f" at {group.joint}")


def _registered(tested: _Tested) -> Iterator[Checks]:
    """Check the registered limits, such as proportions; those of the strokes need two dead centres in the motion."""
    limits, applies, motion = tested.problem.limits, np.ones(tested.count, dtype=bool), tested.required
    if (limits.swing_angle is not None or limits.time_ratio is not None) and isinstance(motion, FourBarMotion):
        counts = np.bincount(motion.dead_centres[2], minlength=tested.count)
        applies = counts == 2
        yield Checks("the rocker has two dead centres", applies, counts.astype(float), "= 2", "")
    if any(limits_in_file(limits)):
        size = np.broadcast_to(tested.size if tested.lengths is None else tested.lengths[3], tested.count)
        of_design = {
            k: list(registered_checks(_OneDesign(tested, k), limits, float(size[k]), k)) for k in np.flatnonzero(applies).tolist()
        }
        yield from joined(of_design, tested.count)


def _pivots(tested: _Tested) -> Iterator[Checks]:
    """Check that every point of the frame is inside the region."""
    region = tested.problem.limits.pivots
    if region is None:
        return
    motion = tested.placed(np.zeros(1))
    for name in [point for point, bodies in tested.mechanism.owners.items() if FRAME in bodies]:
        for axis, value, interval in zip("xy", motion.position(name)[:, 0].T, (region.x, region.y), strict=True):
            if interval is not None:
                yield from limit_checks(f"pivot {name}.{axis}", value * 1e3, interval, PLACED * tested.size * 1e3, 1e3, "mm")


def _distances(tested: _Tested, region: RegionLimit, motion: tuple[Value, Value], shares: Array) -> Array:
    """Return the distances (sides, ..., designs, n) [m] of a point from a region at shares of a motion [rad]."""
    begin, span = motion
    return np.asarray(region.measured(tested.placed(begin + span * shares).position(region.of)))


def _regions(tested: _Tested) -> Iterator[Checks]:
    """Check that points stay in or out of the regions, at every crank angle: by sweep and refinement."""
    for name, region in tested.problem.limits.regions.items():
        whole = tested.turns and region.over != "span"
        low, high = tested.problem.linkage.extent
        begin, span = (low, high - low) if whole else tested.targets.range
        grid = np.linspace(0.0, 1.0, POSITIONS + 1)

        distances = functools.partial(_distances, tested, region, (begin, span))
        sides = len(distances(grid[None, :1]))
        least = extremes_of_rows(
            rows_of(distances, sides, tested.count), grid, periodic=whole and not tested.limited, signs=(1.0,)
        )
        nearest = np.min(least.reshape(sides, -1), axis=0) * 1e3
        near = PLACED * tested.problem.size * 1e3
        yield Checks(region.label(name), nearest >= region.margin * 1e3 - near, nearest, f">= {region.margin * 1e3:.6g}", "mm")


# --- the machine over its cycle -----------------------------------------------------------------------------------------


def _machine_sizes(tested: Cycle) -> Iterator[Check]:
    """Check bounds of design variables, fixed quantities, and constant link lengths in motion."""
    size = tested.longest
    problem, within = tested.problem, [checks.of() for checks in bounds_and_links(tested.problem, tested.design, size)]
    as_given = [f"{name} within its bounds" for name in problem.fixed]
    yield from (check for check in within if check.name not in as_given)
    changed = [check for check in within if check.name in as_given and not check.passed]
    yield from changed or [Check("all other dimensions as given", True, 0.0, "= 0", "")]
    yield tested.revolution.link_lengths(size).of()
    for drive in tested.mechanism.drives if tested.complete else ():
        if drive.size:
            link, motion = tested.mechanism.bodies[drive.body], tested.revolution
            ends = [tested.design[end] if isinstance(end, str) else float(end or 0.0) for end in (drive.begin, drive.end)]
            lengths = sweep(tested.mechanism, tested.design, motion.angles[[0, -1]]).distance(link.start, link.end)
            error = max_magnitude(lengths - ends)
            limit = LENGTH_TOLERANCE * size
            yield Check(f"{drive.body} moves from end to end", error <= limit, error * 1e3, f"<= {limit * 1e3:.1e}", "mm")


def _machine_motion(tested: Cycle) -> Iterator[Check]:
    """Check the whole motion on one branch and circuit, finite forces, and the energy balance of drive and loads."""
    moves = "the crank turns fully" if tested.limits is None else "the linkage closes throughout the range"
    yield Check(moves, tested.complete, float(tested.complete), "= 1", "")
    if not tested.complete:
        return
    yield Check(f"no singular position in {tested.over}", not tested.singular, float(len(tested.singular)), "= 0", "")
    groups = tested.mechanism.groups
    for group, least in zip(groups, tested.revolution.least_squared_sines, strict=True):
        yield alignment_check(group, len(groups) == 1, least, tested.problem.limits, tested.over).of()
    yield from (checks.of() for checks in _circuit(tested.mechanism, tested.revolution))
    from optlink.dynamics.columns import MotionColumns

    record = MotionColumns(tested.machine.moving(tested.positions, tested.speed))
    good = not np.any(record.singular | record.jammed | record.undefined) and not tested.work.poles
    yield Check(f"finite forces over {tested.over}", bool(good), float(good), "= 1", "")
    if tested.machine.inertias or tested.machine.loads:
        gap = tested.imbalance()
        yield Check("work of the drive is that of the loads", bool(gap <= BALANCE), gap, f"<= {BALANCE:.0e}", "")


def _bound(tested: Cycle, item: Bound) -> Iterator[Check]:
    """Check a limit of a quantity of the machine."""
    kind, unit = item.interval.kind, item.interval.unit
    size = 1.0 / factor(unit or KINDS[kind].display, kind) if kind else 1.0
    value = tested.figure(item.term)
    reference = max(abs(value) if math.isfinite(value) else 0.0, ZERO_LIMIT_REFERENCE * tested.size(item.term))
    for limit, words, sense in ((item.interval.low, ">=", 1.0), (item.interval.high, "<=", -1.0)):
        if limit is not None:
            passed = bool(sense * (value - limit) >= -MEET * max(abs(limit), reference))
            yield Check(f"{item.name}: {item.term.words}", passed, value * size, f"{words} {limit * size:.6g}", unit)
