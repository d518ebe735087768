"""Validate a four-bar design by a sweep of the mechanism itself, independent of the optimiser's formulas.

Link lengths are measured between joint positions, the transmission angle between two unit vectors, dead centres at sign changes
of the rocker velocity, the crank condition by closing the loop at every crank angle. The optimiser's terms and solvers are not
imported.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.extrema import extremes
from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.vector2d import Vector, cross, dot, minus, unit
from optlink.problem.function import DEAD_CENTRES, DesignProblem
from optlink.problem.robust import EXPECTED, WORST
from optlink.validation.check import (
    POSITIONS,
    Check,
    Validation,
    bound,
    link_lengths,
    registered_checks,
    transmission_checks,
)
from optlink.validation.margins import alignment_checks, at_least, grashof_check

Array = NDArray[np.float64]

CLOSING = 4  # refinement rounds of an extreme: to 6e-6 of a step of the sweep, where it is flat within rounding
ROUNDING = 1e-12  # rad; absolute agreement required of nearly zero errors
STEP = 1e-5  # of the frame; step of central differences by dimensions


def validate(
    problem: DesignProblem,
    design: Mapping[str, float],
    objective: float | None = None,
    mechanism: Mechanism | None = None,
) -> Validation:
    """Validate a design, or show where it fails.

    Parameters
    ----------
    problem : DesignProblem
    design : mapping of str to float [m, rad]
        crank, coupler, rocker, frame, phi0, psi0.
    objective : float, optional
        Objective of the optimiser, compared with the measured one.
    mechanism : Mechanism, optional
        Mechanism to be tested instead of the linkage of the problem (its bodies and joints must have the same names).
    """
    tested = _Tested(problem, design, mechanism or problem.linkage)
    found = tested.objective()
    checks = [check for group in (_sizes, _crank, _circuit, _transmission, _requirement, _extra) for check in group(tested)]
    if objective is not None:
        gap = abs(found - objective) / max(abs(found), 1e-12)
        error, claimed = (math.sqrt(f) if tested.squared else f for f in (max(found, 0.0), max(objective, 0.0)))
        agrees = bool(gap <= 1e-6 or abs(error - claimed) <= ROUNDING)
        what = "objective" if problem.requirement.robust is None else "error with tolerances"
        checks.append(Check(f"{what} measured in motion", agrees, gap, "<= 1e-06", ""))
    return Validation(tuple(checks), found)


class _Tested:
    """A design in motion: the sweeps shared by the checks."""

    def __init__(self, problem: DesignProblem, design: Mapping[str, float], mechanism: Mechanism) -> None:
        self.problem, self.design, self.mechanism = problem, dict(design), mechanism
        self.sizes = problem.sizes(design)
        self.phi0, self.psi0 = design["phi0"], design["psi0"]
        self.revolution = self._sweep(np.linspace(0.0, 2.0 * np.pi, POSITIONS, endpoint=False))

    @cached_property
    def span(self) -> Motion:
        """The motion over the span of the requirement."""
        count = max(2, math.ceil(abs(self.problem.span) / (2.0 * np.pi) * POSITIONS)) + 1
        return self._sweep(self.phi0 + np.linspace(0.0, self.problem.span, count))

    def _sweep(self, angles: Array) -> Motion:
        return sweep(self.mechanism, self.sizes, angles)

    def _placed(self, angles: Array) -> list[Vector]:
        """Return the coordinates of B, C and D at crank angles, without velocities."""
        with np.errstate(all="ignore"):
            pose = self.mechanism.pose(self.sizes, unit(angles))
        return [pose.point(name) for name in "BCD"]

    @property
    def squared(self) -> bool:
        """Whether the objective is in rad^2."""
        return self.problem.requirement.measure == "sum of squares"

    @property
    def turns(self) -> bool:
        """Whether the crank has to turn fully."""
        return self.problem.limits.crank != "span"

    @property
    def required(self) -> Motion:
        """The motion over which the mechanism must be assembled."""
        return self.revolution if self.turns else self.span

    def transmission(self, b: Vector, c: Vector, d: Vector) -> Array:
        """Return the angle B-C-D [rad] at each position.

        Parameters
        ----------
        b, c, d : Vector
            Coordinates [m] of the joints.
        """
        to_b, to_d = minus(b, c), minus(d, c)
        gamma: Array = np.abs(np.arctan2(cross(to_b, to_d), dot(to_b, to_d)))
        return gamma

    def transmission_extremes(self, motion: Motion) -> tuple[float, float]:
        """Return the least and largest transmission angle [rad], refined around the extreme positions of the sweep."""
        angles = motion.crank_angle
        gamma = self.transmission(*self._placed(angles))
        if not np.all(np.isfinite(gamma)):
            return math.nan, math.nan
        low, high = sorted((angles[0], angles[-1])) if motion is self.span else (-np.inf, np.inf)
        signs = np.array([[1.0], [-1.0]])  # both extremes are refined together
        centres, width = angles[np.argmin(signs * gamma, axis=1)], abs(angles[1] - angles[0])
        for _ in range(CLOSING):
            near = np.clip(centres[:, None] + width * np.linspace(-1.0, 1.0, 41), low, high)
            values = signs * self.transmission(*self._placed(near.ravel())).reshape(near.shape)
            best = np.argmin(np.where(np.isfinite(values), values, np.inf), axis=1)
            centres, width = near[[0, 1], best], width / 20.0
        least, largest = self.transmission(*self._placed(centres))
        return float(least), float(largest)

    @cached_property
    def dead_centres(self) -> list[tuple[float, float]]:
        """Return crank and rocker angles [rad] at sign changes of the rocker velocity, refined by secants."""

        def velocity(angle: float) -> float:
            return float(self._sweep(np.array([angle])).body_angle("rocker").rate[0])

        angles = self.revolution.crank_angle
        rates = self.revolution.body_angle("rocker").rate
        found = []
        for i in np.flatnonzero(np.sign(rates) * np.sign(np.roll(rates, -1)) <= 0.0):
            a, b = float(angles[i]), float(angles[i]) + 2.0 * np.pi / POSITIONS
            at_a, at_b = velocity(a), velocity(b)
            for _ in range(60):
                if not at_a * at_b < 0.0:
                    break
                middle = 0.5 * (a + b)
                secant = b - at_b * (b - a) / (at_b - at_a)
                for guess in (secant, middle):
                    value = velocity(guess)
                    if value * at_a <= 0.0:
                        b, at_b = guess, value
                    else:
                        a, at_a = guess, value
                if abs(b - a) < 1e-14:
                    break
            angle = a if abs(at_a) < abs(at_b) else b
            found.append((angle % (2.0 * np.pi), float(self._sweep(np.array([angle])).body_angle("rocker").value[0])))
        return found

    def strokes(self) -> tuple[float, float, float]:
        """Return the swing angle of the rocker and the crank rotation of its forward and backward strokes [rad]."""
        (phi_a, psi_a), (phi_b, psi_b) = self.dead_centres
        turned = math.copysign(1.0, self.problem.span) * (phi_b - phi_a) % (2.0 * math.pi)
        rest, rise = (
            2.0 * math.pi - turned,
            math.remainder(psi_b - psi_a, 2.0 * math.pi),
        )  # a rocker swings by less than half a turn
        return abs(rise), *((turned, rest) if rise > 0.0 else (rest, turned))

    def reach(self, crank_angle: float) -> float:
        """Return the distance A-C [m], large at the outer, small at the inner dead centre."""
        motion = self._sweep(np.array([crank_angle]))
        return float(np.linalg.norm(motion.position("C")[0] - motion.position("A")[0]))

    def target_minus_actual(self, offsets: Array | None = None) -> Array:
        """Return the error of the rocker angle [rad], from two angles and their difference modulo a turn.

        At crank rotations from the start. Default: the design positions.
        """
        law = self.problem.law
        at, tabulated = (law.offsets, law.tabulated) if offsets is None else (offsets, 0.0)
        _, c, d = self._placed(self.phi0 + at)
        actual = np.arctan2(c[1] - d[1], c[0] - d[0])
        wanted = np.asarray(law.target(at, tabulated, self.phi0, self.psi0) + 0.0 * at, dtype=float)
        error: Array = np.remainder(wanted - actual + np.pi, 2.0 * np.pi) - np.pi
        return error

    def _rocker(self, at: Array, name: str, by: float) -> Array:
        """Return rocker angles [rad] at crank rotations from the start, with one dimension or coordinate larger by `by` [m].

        The crank angle is that of the drawing. Displaced pivots rotate the frame, and thus the crank angle relative to it.
        """
        sizes = {**self.sizes, **({name: self.sizes[name] + by} if name in self.sizes else {})}
        along = sizes["frame"] - (by if name == "A.x" else 0.0)
        across = {"D.y": by, "A.y": -by}.get(name, 0.0)
        sizes["frame"], tilt = math.hypot(along, across), math.atan2(across, along)
        with np.errstate(all="ignore"):
            pose = self.mechanism.pose(sizes, unit(self.phi0 + at - tilt))
        c, d = pose.point("C"), pose.point("D")
        return np.asarray(np.arctan2(c[1] - d[1], c[0] - d[0]) + tilt, dtype=float)

    def scattered(self, offsets: Array | None = None) -> tuple[Array, Array]:
        """Return the mean error [rad] with tolerances and its scatter to either side, by central differences of the motion.

        The scatter is the requested number of standard deviations (one for an expected square), or the worst case.
        """
        at, robust = self.problem.law.offsets if offsets is None else offsets, self.problem.requirement.robust
        middle, spread = self.target_minus_actual(offsets), np.zeros(len(at))
        step = STEP * self.design["frame"]
        for deviation in self.problem.deviations if robust is not None else ():
            there, back = (self._rocker(at, deviation.size, way) for way in (step, -step))
            slope = -(np.remainder(there - back + np.pi, 2.0 * np.pi) - np.pi) / (2.0 * step)
            if robust is not None and robust.text == WORST:
                ends = slope * np.array(deviation.ends)[:, None]
                middle, spread = middle + np.mean(ends, axis=0), spread + 0.5 * np.abs(ends[1] - ends[0])
            else:
                middle, spread = middle + slope * deviation.mean, spread + np.square(slope * deviation.sigma)
        if robust is not None and robust.text != WORST:
            spread = (1.0 if robust.text == EXPECTED else robust.sigmas) * np.sqrt(spread)
        return middle, spread

    def objective(self) -> float:
        """Return the minimised value; the largest error of a function is that over its whole range."""

        def sides(at: Array) -> Array:
            middle, spread = self.scattered(at)
            return np.stack([spread + middle, spread - middle])

        if self.problem.everywhere:
            grid = np.sort(np.linspace(0.0, self.problem.span, POSITIONS + 1))
            return float(np.max(extremes(sides, grid)[1][:, 1]))
        middle, spread = self.scattered()
        if self.problem.requirement.measure == "max":
            return float(np.max(np.abs(middle) + spread))
        total = math.fsum(float(e) ** 2 for e in (*middle, *spread))
        return math.sqrt(total / len(middle)) if self.problem.requirement.measure == "rms" else total


def _sizes(tested: _Tested) -> Iterator[Check]:
    """Check bounds, fixed quantities, and constant link lengths in motion."""
    frame = tested.design["frame"]
    for name, quantity in tested.problem.quantities.items():
        yield bound(name, quantity, tested.design[name], frame)
    yield link_lengths(tested.required, lambda link: tested.design[link.body], frame)


def _crank(tested: _Tested) -> Iterator[Check]:
    """Check the crank condition from the lengths, and the closure of the loop at every position."""
    limits, longest = tested.problem.limits, max(tested.design[name] for name in LENGTHS)
    if tested.turns:
        yield grashof_check(tested.design, limits)
    grid = np.sort(tested.required.crank_angle)
    if tested.turns:
        grid = np.append(grid, grid[0] + 2.0 * np.pi)
    where = "the whole revolution" if tested.turns else "the span"
    yield from alignment_checks(tested._sweep, grid, limits, where)
    if "phi0" not in tested.problem.quantities and tested.problem.requirement.start == DEAD_CENTRES[1]:
        gap = abs(tested.design["coupler"] - tested.design["crank"])
        yield at_least("inner dead centre: C apart from A", gap * 1e3, limits.length_margin * longest * 1e3, "mm")


def _circuit(tested: _Tested) -> Iterator[Check]:
    """Check one branch (C stays on its side of the line B-D) and one circuit (continuous, closed path of C)."""
    motion = tested.required
    b, c, d = (motion.position(name) for name in "BCD")
    diagonal, coupler = d - b, c - b
    height = (diagonal[:, 0] * coupler[:, 1] - diagonal[:, 1] * coupler[:, 0]) / np.linalg.norm(diagonal, axis=-1)
    least = float(np.min(tested.problem.side * height)) * 1e3
    yield Check("one branch: C on one side of B-D", bool(least > 0.0), least, "> 0", "mm")
    step = abs(motion.crank_angle[1] - motion.crank_angle[0])
    closed = np.concatenate([c, c[:1]]) if tested.turns else c
    speed = np.linalg.norm(motion.velocity("C"), axis=-1)
    fastest = float(np.max(speed)) * step * 1.5 + 1e-9
    jump = float(np.max(np.linalg.norm(np.diff(closed, axis=0), axis=-1)))
    yield Check(
        "one circuit: C moves without a jump",
        bool(jump <= fastest),
        jump * 1e3,
        f"<= {fastest * 1e3:.3g}",
        "mm",
    )


def _transmission(tested: _Tested) -> Iterator[Check]:
    """Check the extremes of the transmission angle, by sweep and refinement."""
    limit = tested.problem.limits.transmission_at()
    if limit is not None:
        motion = tested.revolution if tested.problem.transmission_over == "revolution" else tested.span
        least, largest = tested.transmission_extremes(motion)
        yield from transmission_checks(math.degrees(least), math.degrees(largest), limit)


def _requirement(tested: _Tested) -> Iterator[Check]:
    """Check the start of the requirement, and that it is defined at every design position."""
    problem, start = tested.problem, tested.problem.requirement.start
    if start in DEAD_CENTRES and "phi0" not in problem.quantities:
        rate = abs(float(sweep(tested.mechanism, tested.sizes, [tested.phi0]).body_angle("rocker").rate[0]))
        yield Check("rocker at rest at its dead centre", bool(rate <= 1e-6), rate, "<= 1e-06", "")
        reach = tested.reach(tested.phi0) if math.isfinite(tested.phi0) else math.nan
        wanted = tested.design["coupler"] + (1.0 if start == DEAD_CENTRES[0] else -1.0) * tested.design["crank"]
        gap, near = abs(reach - abs(wanted)) * 1e3, 1e-6 * tested.design["frame"] * 1e3
        yield Check(
            "crank and coupler in line there",
            bool(gap <= near),
            gap,
            f"<= {near:.1e}",
            "mm",
        )
    if problem.tied:
        motion = sweep(tested.mechanism, tested.sizes, [tested.phi0])
        d, c = motion.position("D")[0], motion.position("C")[0]
        own = math.atan2(c[1] - d[1], c[0] - d[0])
        gap = math.degrees(abs(math.remainder(own - tested.psi0, 2.0 * math.pi)))
        yield Check("psi0 is the rocker's own angle", bool(gap <= 1e-7), gap, "<= 1e-07", "deg")
    error = tested.target_minus_actual()
    largest = math.degrees(float(np.max(np.abs(error))))
    yield Check("output error has a value everywhere", bool(np.all(np.isfinite(error))), largest, "finite", "deg")
    if problem.requirement.robust is not None:
        middle, spread = tested.scattered()
        most = math.degrees(float(np.max(np.abs(middle) + spread)))
        counted = problem.requirement.robust.band
        yield Check(f"error with tolerances, {counted}, has a value", bool(math.isfinite(most)), most, "finite", "deg")


def _extra(tested: _Tested) -> Iterator[Check]:
    """Check the registered limits; those of the strokes need two dead centres in the motion."""
    limits = tested.problem.limits
    if limits.swing_angle is not None or limits.time_ratio is not None:
        count = len(tested.dead_centres)
        yield Check("the rocker has two dead centres", count == 2, float(count), "= 2", "")
        if count != 2:
            return
    yield from registered_checks(tested, limits, tested.design["frame"])
