"""Validate four-bar designs by a sweep of the mechanism itself, independent of the optimiser's formulas.

Link lengths are measured between joint positions, the transmission angle between two unit vectors, dead centres at sign changes
of the rocker velocity, the crank condition by closing the loop at every crank angle. The optimiser's terms and solvers are not
imported. Many designs are validated at once, each by the same operations as one: arrays have a leading axis of designs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from optlink.linkage.extrema import maxima
from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.vector2d import TURN, Array, Value, angle, minus, unit
from optlink.problem.design import DesignProblem
from optlink.problem.limits import limits_in_file
from optlink.problem.requirement import DEAD_CENTRES
from optlink.problem.robust import EXPECTED, WORST
from optlink.problem.targets.law import Table
from optlink.validation.check import (
    MEASURED_ROBUST,
    POSITIONS,
    Checks,
    Validation,
    Validations,
    bounds_and_links,
    finely,
    joined,
    registered_checks,
    revolutions_check,
    same_objective,
    text,
    transmission_checks,
)
from optlink.validation.four_bar_motion import FourBarMotion
from optlink.validation.margins import alignment_check, at_least, grashof_check

ROUNDING = 1e-12  # rad; absolute agreement required of nearly zero errors
STEP = 1e-5  # of the frame; step of central differences by dimensions


def validate(
    problem: DesignProblem,
    design: Mapping[str, float],
    objective: float | None = None,
    mechanism: Mechanism | None = None,
) -> Validation:
    """Validate a design (crank, coupler, rocker, frame, phi0, psi0 [m, rad]), or show where it fails.

    `objective`: that of the optimiser, compared with the measured one. `mechanism`: tested instead of the linkage of the problem;
    its bodies and joints must have the same names.
    """
    return validate_batch(problem, design, objective, mechanism).of()


def validate_batch(
    problem: DesignProblem,
    designs: Mapping[str, ArrayLike],
    objective: ArrayLike | None = None,
    mechanism: Mechanism | None = None,
) -> Validations:
    """Validate many designs at once, each as `validate`; the result for a design does not depend on the others.

    All numbers are arrays (designs,); those of the quantities and limits of the problem may be.
    """
    tested = _Tested(problem, designs, mechanism or problem.linkage)
    objectives = tested.objective()
    checks = [check for group in (_sizes, _crank, _circuit, _transmission, _requirement, _extra) for check in group(tested)]
    if objective is not None:
        agrees = same_objective(objectives, objective, 1e-12, ROUNDING, squared=problem.measure == "sum of squares")
        checks.append(agrees if problem.requirement.robust is None else replace(agrees, name=MEASURED_ROBUST))
    return Validations(tuple(checks), objectives)


class _Tested:
    """Designs in motion: the sweeps shared by the checks."""

    def __init__(self, problem: DesignProblem, designs: Mapping[str, ArrayLike], mechanism: Mechanism) -> None:
        self.problem, self.mechanism = problem, mechanism
        names, values = list(designs), np.broadcast_arrays(*(np.atleast_1d(value) for value in designs.values()))
        self.design = {name: np.asarray(value, dtype=float) for name, value in zip(names, values, strict=True)}
        self.count = len(values[0])
        quantities = problem.mechanism.quantities
        self.sizes = {name: self._column(self.design.get(name, quantity.value)) for name, quantity in quantities.items()}
        self.phi0, self.psi0 = (self._column(self.design[name]) for name in ("phi0", "psi0"))
        self.revolution = FourBarMotion(mechanism, self.sizes, np.linspace(0.0, TURN, POSITIONS, endpoint=False), closed=True)

    def _column(self, value: ArrayLike) -> Array:
        return np.array(np.broadcast_to(np.asarray(value, dtype=float), self.count))[:, None]

    @cached_property
    def span(self) -> FourBarMotion:
        """The motion over the span of the requirement."""
        span = self.problem.span
        count = max(2, math.ceil(abs(span) / TURN * POSITIONS)) + 1
        angles = self.phi0 + np.linspace(0.0, span, count)
        return FourBarMotion(self.mechanism, self.sizes, angles, span=span)

    def _rocker(self, crank: Array, sizes: Mapping[str, Array]) -> Array:
        """Return rocker angles [rad] at crank angles [rad]."""
        with np.errstate(all="ignore"):
            pose = self.mechanism.pose(sizes, unit(crank))
        return np.asarray(angle(minus(pose.point("C"), pose.point("D"))), dtype=float)

    @property
    def turns(self) -> bool:
        """Whether the crank has to turn fully."""
        return self.problem.limits.crank != "span"

    @property
    def required(self) -> FourBarMotion:
        """The motion over which the mechanism must be assembled."""
        return self.revolution if self.turns else self.span

    @cached_property
    def errors(self) -> Array:
        """Errors at the design positions."""
        return self.errors_at(self.problem.law.offsets, self.problem.law.tabulated)

    def errors_at(self, at: Array, tabulated: Value = 0.0) -> Array:
        """Return target minus rocker angle (designs, positions) [rad], modulo a turn, at crank rotations from the start."""
        actual = self._rocker(self.phi0 + at, self.sizes)
        with np.errstate(all="ignore"):
            target = np.asarray(self.problem.law.target(at, tabulated, self.phi0, self.psi0) + 0.0 * at, dtype=float)
        return np.asarray(np.remainder(target - actual + np.pi, TURN) - np.pi)

    def prescribed_from_start(self) -> tuple[Array, Array]:
        """Return crank rotations (rotations,) from the start on and the prescribed angles (designs, rotations) [rad] there.

        At the start and the design positions. NaN at the start where the law is not defined; a table is not extrapolated.
        """
        law = self.problem.law
        at = law.offsets if law.offsets[0] == 0.0 else np.concatenate([[0.0], law.offsets])
        with np.errstate(all="ignore"):
            target = np.array(np.broadcast_to(law.curve(at, self.phi0, self.psi0), (self.count, len(at))))
        if isinstance(law.source, Table) and law.source.from_start and not min(law.source.phi) <= 0.0 <= max(law.source.phi):
            target[:, :1] = self.psi0 if self.problem.tied else np.nan  # its rows are relative to that rocker angle
        return at, target

    def rocker_along(self, at: Array) -> Array:
        """Return rocker angles (designs, rotations) [rad], continuous, at crank rotations (rotations,) from the start."""
        fine, index = finely(at)
        return np.asarray(np.unwrap(self._rocker(self.phi0 + fine, self.sizes), axis=1)[:, index])

    def _deviating(self, at: Array, name: str, by: Array) -> Array:
        """Return rocker angles [rad] at crank rotations from the start, with one dimension or coordinate larger by `by` [m].

        The crank angle is that of the drawing. Displaced pivots rotate the frame, and thus the crank angle relative to it.
        """
        sizes = {key: size + by if key == name else size for key, size in self.sizes.items()}
        along = sizes["frame"] - (by if name == "A.x" else 0.0)
        across = {"D.y": by, "A.y": -by}.get(name, np.zeros_like(by))
        sizes["frame"], tilt = np.hypot(along, across), np.arctan2(across, along)
        return np.asarray(self._rocker(self.phi0 + at - tilt, sizes) + tilt)

    def scattered(self, offsets: Array | None = None) -> tuple[Array, Array]:
        """Return the mean error [rad] with tolerances and its scatter to either side, by central differences of the motion.

        The scatter is the requested number of standard deviations (one for an expected square), or the worst case.
        """
        middle = self.errors if offsets is None else self.errors_at(offsets)
        at, robust = self.problem.law.offsets if offsets is None else offsets, self.problem.requirement.robust
        spread = np.zeros_like(middle)
        if robust is None:
            return middle, spread
        step = STEP * self._column(self.design["frame"])
        for deviation in self.problem.deviations:
            there, back = (self._deviating(at, deviation.size, way) for way in (step, -step))
            slope = -(np.remainder(there - back + np.pi, 2.0 * np.pi) - np.pi) / (2.0 * step)
            if robust.text == WORST:
                low, high = (slope * end for end in deviation.ends)
                middle, spread = middle + 0.5 * (low + high), spread + 0.5 * np.abs(high - low)
            else:
                middle, spread = middle + slope * deviation.mean, spread + np.square(slope * deviation.sigma)
        if robust.text != WORST:
            spread = (1.0 if robust.text == EXPECTED else robust.sigmas) * np.sqrt(spread)
        return middle, spread

    def objective(self) -> Array:
        """Return the minimised values (designs,); the largest error of a function is that over its whole range."""

        def sides(at: Array) -> Array:
            middle, spread = self.scattered(at)
            return np.concatenate([spread + middle, spread - middle])

        measure = self.problem.measure
        if self.problem.everywhere:
            grid = np.sort(np.linspace(0.0, self.problem.span, POSITIONS + 1))
            return np.asarray(np.max(maxima(sides, grid)[1].reshape(2, -1), axis=0))
        middle, spread = self.scattered()
        if measure == "max":
            return np.asarray(np.max(np.abs(middle) + spread, axis=1))
        total = np.array([math.fsum(squares) for squares in np.square(np.concatenate([middle, spread], axis=1)).tolist()])
        return np.sqrt(total / middle.shape[1]) if measure == "rms" else total


class _OneDesign:
    """One of the designs in motion, as the limits of `optlink.problem.limits` measure it."""

    def __init__(self, tested: _Tested, design: int) -> None:
        self.mechanism, self._tested, self._number = tested.mechanism, tested, design
        self.design = {name: float(values[design]) for name, values in tested.design.items()}

    @cached_property
    def required(self) -> Motion:
        """The motion over which the mechanism must be assembled."""
        angles = self._tested.required.angles
        sizes = {name: float(values[self._number, 0]) for name, values in self._tested.sizes.items()}
        return sweep(self.mechanism, sizes, angles if angles.ndim == 1 else angles[self._number])

    def strokes(self) -> tuple[float, float, float]:
        """Return the swing angle of the rocker and the crank rotation of its forward and backward strokes [rad]."""
        phi, psi, which = self._tested.revolution.dead_centres
        (phi_a, phi_b), (psi_a, psi_b) = (values[which == self._number].tolist() for values in (phi, psi))
        turned = math.copysign(1.0, self._tested.problem.span) * (phi_b - phi_a) % TURN
        rest, rise = TURN - turned, math.remainder(psi_b - psi_a, TURN)  # a rocker swings by less than half a turn
        return abs(rise), *((turned, rest) if rise > 0.0 else (rest, turned))


def _sizes(tested: _Tested) -> Iterator[Checks]:
    """Check bounds, fixed quantities, and constant link lengths in motion."""
    frame = tested.design["frame"]
    yield from bounds_and_links(tested.problem, tested.design, frame)
    yield tested.required.link_lengths({link.body: tested.design[link.body] for link in tested.mechanism.links}, frame)


def _crank(tested: _Tested) -> Iterator[Checks]:
    """Check the crank condition from the lengths, and the closure of the loop at every position."""
    limits, design = tested.problem.limits, tested.design
    if tested.turns:
        yield grashof_check(design, limits)
    where, groups = "the whole revolution" if tested.turns else "the span", tested.mechanism.groups
    for group in groups:
        yield alignment_check(group, len(groups) == 1, tested.required.least_squared_sine, limits, where)
    if tested.problem.dead_centre == DEAD_CENTRES[1]:
        gap, longest = np.abs(design["coupler"] - design["crank"]), np.max([design[name] for name in LENGTHS], axis=0)
        yield at_least("inner dead centre: C apart from A", gap * 1e3, limits.length_margin * longest * 1e3, "mm")


def _circuit(tested: _Tested) -> Iterator[Checks]:
    """Check one branch (C stays on its side of the line B-D) and one circuit (continuous, closed path of C)."""
    motion = tested.required
    least = motion.least_height(tested.problem.side) * 1e3
    yield Checks("one branch: C on one side of B-D", least > 0.0, least, "> 0", "mm")
    fastest, jump = motion.survey.fastest * motion.step * 1.5 + 1e-9, motion.survey.longest
    yield Checks("one circuit: C moves without a jump", jump <= fastest, jump * 1e3, text("<= {:.3g}", fastest * 1e3), "mm")


def _transmission(tested: _Tested) -> Iterator[Checks]:
    """Check the extremes of the transmission angle, by sweep and refinement."""
    limit = tested.problem.limits.transmission_at()
    if limit is not None:
        motion = tested.revolution if tested.problem.limits.transmission_range == "revolution" else tested.span
        least, largest = motion.transmission_extremes
        yield from transmission_checks(np.degrees(least), np.degrees(largest), limit)


def _requirement(tested: _Tested) -> Iterator[Checks]:
    """Check the start of the requirement, and that it is defined at every design position."""
    problem, start, design = tested.problem, tested.problem.dead_centre, tested.design
    begin = sweep(tested.mechanism, tested.sizes, tested.phi0)
    if start is not None:
        rate = np.abs(begin.body_rate("rocker")[:, 0])
        yield Checks("rocker at rest at its dead centre", rate <= 1e-6, rate, "<= 1e-06", "")
        extended = design["coupler"] + (1.0 if start == DEAD_CENTRES[0] else -1.0) * design["crank"]
        gap, near = np.abs(begin.distance("A", "C")[:, 0] - np.abs(extended)) * 1e3, 1e-6 * design["frame"] * 1e3
        yield Checks("crank and coupler in line there", gap <= near, gap, text("<= {:.1e}", near), "mm")
    if problem.tied:
        c, d = begin.position("C")[:, 0].T, begin.position("D")[:, 0].T
        away = np.arctan2(c[1] - d[1], c[0] - d[0]) - tested.psi0[:, 0]
        gap = np.degrees(np.abs(away - TURN * np.round(away / TURN)))
        yield Checks("psi0 is the rocker angle at phi0", gap <= 1e-7, gap, "<= 1e-07", "deg")
    largest = np.degrees(np.max(np.abs(tested.errors), axis=1))
    yield Checks("output error has a value everywhere", np.isfinite(largest), largest, "finite", "deg")
    at, target = tested.prescribed_from_start()
    yield from revolutions_check(at, target, lambda: tested.rocker_along(at))
    if problem.requirement.robust is not None:
        middle, spread = tested.scattered()
        most = np.degrees(np.max(np.abs(middle) + spread, axis=1))
        name = f"error with tolerances, {problem.requirement.robust.band}, has a value"
        yield Checks(name, np.isfinite(most), most, "finite", "deg")


def _extra(tested: _Tested) -> Iterator[Checks]:
    """Check the registered limits; those of the strokes need two dead centres in the motion."""
    limits, applies = tested.problem.limits, np.ones(tested.count, dtype=bool)
    if limits.swing_angle is not None or limits.time_ratio is not None:
        counts = np.bincount(tested.revolution.dead_centres[2], minlength=tested.count)
        applies = counts == 2
        yield Checks("the rocker has two dead centres", applies, counts.astype(float), "= 2", "")
    if any(limits_in_file(limits)):
        of_design = {
            k: list(registered_checks(_OneDesign(tested, k), limits, float(tested.design["frame"][k]), k))
            for k in np.flatnonzero(applies).tolist()
        }
        yield from joined(of_design, tested.count)
