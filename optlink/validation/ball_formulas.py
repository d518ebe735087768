"""Deviations and limits of a problem over a box of designs, in ball arithmetic; written separately from the optimiser's terms.

Limits that cannot be evaluated are omitted, and limits at every crank angle are applied at some of them only. This relaxation can
only decrease a lower bound of the objective, so no wrong certificate passes. The rows have the order of the multipliers of a
certificate: crank condition, dead centres, transmission angle, registered limits, pivots, limits at single crank angles,
tolerances of points; for each the lower side first.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import arb

from optlink.linkage.dyad_types import RRR, Transmitting
from optlink.linkage.margins import FIXED_LIMIT_TOLERANCE
from optlink.linkage.mechanism import Pose
from optlink.linkage.vector2d import cross, dot, minus, turn
from optlink.problem.function import DEAD_CENTRES, DesignProblem
from optlink.problem.limits import COUPLER_JOINT, Reach, limits_in_file
from optlink.problem.mechanism import FourBarSection
from optlink.problem.path import MARK, START, PathProblem
from optlink.validation.balls import Ball, principal_angles

GRID = 36  # crank angles of a revolution at which limits of single positions apply
COSINE_ROUNDING = 1e-12  # cosines that differ by rounding alone

Row = tuple[str, Ball, float, float]
"""Key of the limit, value [m, rad or -], bounds."""


@dataclass(frozen=True)
class Deviation:
    """One component of the deviation at a position.

    Parameters
    ----------
    least : arb
        Lower bound of its size over the box.
    model : Ball or None
        The deviation, if it is known, and smooth, over the whole box.
    """

    least: Any
    model: Ball | None


class BallProblem:
    """A motion law, function, timed path or transmission problem with one assembly mode, over boxes of its design variables.

    Parameters
    ----------
    problem : DesignProblem or PathProblem
    """

    def __init__(self, problem: DesignProblem | PathProblem) -> None:
        self.problem, self.names = problem, list(problem.free)
        self.bounds = np.array([problem.quantities[name].bounds for name in self.names], dtype=float).reshape(-1, 2)
        self._tabulated = problem.law.tabulated if isinstance(problem, DesignProblem) else np.zeros(0)
        self.four_bar = isinstance(problem.mechanism, FourBarSection)

    @property
    def measure(self) -> str:
        """Measure of the deviations: "sum of squares", "rms" or "max"."""
        return self.problem.measure

    @property
    def positions(self) -> int:
        """Number of positions with a deviation."""
        law = self.problem.law if isinstance(self.problem, DesignProblem) else self.problem.data
        return len(law.offsets)  # type: ignore[arg-type]

    def values(self, centre: Sequence[float], scale: Sequence[Any] | None, *, over: bool = True) -> dict[str, Ball]:
        """Return every quantity over a box.

        Parameters
        ----------
        centre : sequence of float (n,)
        scale : sequence of arb (n,) or None
            Half widths; None for a single design, without derivatives.
        over : bool
            Whether the design variables vary over the box.
        """
        values = {name: Ball.constant(quantity.value) for name, quantity in self.problem.quantities.items()}
        for k, name in enumerate(self.names):
            values[name] = (
                Ball.constant(centre[k]) if scale is None else Ball.unknown(k, len(self.names), centre[k], scale[k], over=over)
            )
        return values

    # --- deviations ------------------------------------------------------------------------------------------------

    def starts(self, values: Mapping[str, Ball]) -> list[tuple[Any, Any, Any]]:
        """Return crank direction, crank angle and output at the start: several, if an angle passes half a turn in the box.

        The angles of the start position lie within -pi ... pi; those of the balls are continuous, and may lie beyond.
        """
        if isinstance(self.problem, PathProblem):
            start = values[START] if self.problem.timing == "from start" else Ball.constant(0.0)
            return [((np.cos(start), np.sin(start)), start, None)]
        position = self.problem.start_position(values)
        phis = [position.phi0] if "phi0" in self.problem.quantities else _principal(position.phi0)
        psis = [position.psi0] if "psi0" in self.problem.quantities else _principal(position.psi0)
        return [(position.crank, phi, psi) for phi in phis for psi in psis]

    def deviation(self, position: int, values: Mapping[str, Ball], start: tuple[Any, Any, Any]) -> list[Deviation]:
        """Return the components of the weighted deviation at a position.

        Parameters
        ----------
        position : int
        values : mapping of str to Ball
        start : tuple
            One of `starts`.
        """
        problem, (crank, phi0, psi0) = self.problem, start
        if isinstance(problem, PathProblem):
            data = problem.data
            assert data.offsets is not None
            offset, weight = float(data.offsets[position]), float(data.roots[position])
            components = self._at(values, phi0 + Ball.constant(offset), data.columns[position], offset)
            return [_scaled(component, weight) for component in components]
        at, tabulated = Ball.constant(problem.law.offsets[position]), Ball.constant(self._tabulated[position])
        pose = problem.linkage.pose(values, turn(crank, (np.cos(at), np.sin(at))))
        target = problem.law.target(at, tabulated, phi0, psi0) + Ball.constant(0.0)
        rocker = minus(pose.point("C"), pose.point("D"))
        return [_turned(_between(rocker, (np.cos(target), np.sin(target))))]

    def deviations(self, values: Mapping[str, Ball], start: tuple[Any, Any, Any]) -> list[list[Deviation]]:
        """Return the components of the weighted deviation at every position.

        Parameters
        ----------
        values : mapping of str to Ball
        start : tuple
            One of `starts`.
        """
        return [self.deviation(k, values, start) for k in range(self.positions)]

    def _at(self, values: Mapping[str, Ball], crank: Ball, columns: Any, offset: float) -> list[Deviation]:
        problem = self.problem
        assert isinstance(problem, PathProblem)
        kind, targets = problem.requirement.kind, [Ball.constant(x) for x in columns]
        if kind == "transmission":
            return [_plain(self._cosine(values, Ball.constant(math.cos(offset))))]
        pose = problem.linkage.pose(values, (np.cos(crank), np.sin(crank)))
        if kind == "function":
            target = problem.prescribed(values, targets[0], targets[1]) + Ball.constant(0.0)
            if problem.slides:
                guide = next(guide for guide in problem.linkage.guides if guide.name == problem.requirement.output)
                return [_plain(pose.slide(guide) - target)]
            body = pose.direction(str(problem.requirement.output))
            return [_turned(_between((np.cos(target), np.sin(target)), body))]
        x, y = pose.point(problem.requirement.point)
        components = [_plain(x - targets[0]), _plain(y - targets[1])]
        if kind == "motion":
            mark = values[MARK]
            body = turn(pose.direction(problem.body), (np.cos(mark), np.sin(mark)))
            components.append(_scaled(_turned(_between((targets[2], targets[3]), body)), problem.radian))
        return components

    # --- limits ----------------------------------------------------------------------------------------------------

    def slacks(self, values: Mapping[str, Ball], *, constant: bool = False) -> list[tuple[str, Ball]]:
        """Return the key of the limit and the slack, not negative for a feasible design, of every side of every row.

        Parameters
        ----------
        values : mapping of str to Ball
        constant : bool
            Whether all rows that do not depend on the design are included, not only those that every design misses.
        """
        slacks = []
        for key, value, low, high in self._rows(values):
            for slack in ([value - low] if math.isfinite(low) else []) + ([high - value] if math.isfinite(high) else []):
                if slack.slope is not None or constant or bool(slack.centre < -FIXED_LIMIT_TOLERANCE):
                    slacks.append((key, slack))
        return slacks

    def _rows(self, values: Mapping[str, Ball]) -> Iterator[Row]:
        problem = self.problem
        if isinstance(problem, DesignProblem):
            phi0 = self.starts(values)[0][1]
            reach = Reach(phi0, problem.span, problem.sense)
        else:
            offsets = problem.data.offsets
            assert offsets is not None
            span = float(offsets[-1] - offsets[0])
            reach = Reach(self.starts(values)[0][1] + float(offsets[0]), span, 1 if span >= 0.0 else -1)
        groups = [self._crank(values), self._dead_centre(values), self._transmission(values, reach)] if self.four_bar else []
        for rows in (*groups, self._registered(values, reach), self._pivots(values)):
            try:
                yield from rows
            except TypeError:  # an operation without a rule: these limits are left out
                continue
        if isinstance(problem, PathProblem):
            yield from () if self.four_bar else self._positions(values)
            yield from self._tolerances(values)

    def _crank(self, values: Mapping[str, Ball]) -> Iterator[Row]:
        """Yield Grashof's conditions with the driven link (crank-rocker) or the frame (double-crank) as the shortest."""
        limits = self.problem.limits
        if limits.crank == "span":
            return
        shortest, fourth = ("crank", "frame") if limits.crank == "full rotation" else ("frame", "crank")
        others = ("coupler", "rocker", fourth)
        for name in others:
            yield "limits.crank", values[name] - values[shortest], 0.0, math.inf
        for longest in (fourth, "coupler", "rocker"):
            middle = [values[name] for name in others if name != longest]
            slack = middle[0] + middle[1] - values[shortest] - values[longest]
            yield "limits.length_margin", slack - limits.length_margin * values[longest], 0.0, math.inf

    def _dead_centre(self, values: Mapping[str, Ball]) -> Iterator[Row]:
        """Yield the conditions for the dead centre at which a law starts, if the crank need not turn fully."""
        problem = self.problem
        begin = getattr(problem.requirement, "start", None)
        if problem.limits.crank != "span" or begin not in DEAD_CENTRES or "phi0" in problem.quantities:
            return
        crank, coupler, rocker, frame = (values[name] for name in ("crank", "coupler", "rocker", "frame"))
        line = coupler + crank if begin == DEAD_CENTRES[0] else np.absolute(coupler - crank)  # A-C
        for longest in (crank, coupler, rocker, frame):
            least = problem.limits.length_margin * longest
            for slack in (rocker + frame - line, line - rocker + frame, line - frame + rocker):  # triangle A-C-D
                yield "limits.length_margin", slack - least, 0.0, math.inf

    def _cosine(self, values: Mapping[str, Ball], cosine: Ball) -> Ball:
        """Return the cosine of the angle B-C-D for that of the crank angle: law of cosines in A-B-D and B-C-D."""
        crank, coupler, rocker, frame = (values[name] for name in ("crank", "coupler", "rocker", "frame"))
        diagonal = crank * crank + frame * frame - 2.0 * crank * frame * cosine
        result: Ball = (coupler * coupler + rocker * rocker - diagonal) / (2.0 * coupler * rocker)
        return result

    def _cosine_limits(self, joint: str) -> Iterator[tuple[str, float, float, str]]:
        """Yield key, bounds of the cosine of the transmission angle and their crank range, those of the alignment last."""
        limits, problem = self.problem.limits, self.problem
        required = "span" if limits.crank == "span" else "revolution"
        most, prescribed = math.cos(limits.alignment.value), limits.transmission_at(joint)
        low, high = -math.inf, math.inf
        if prescribed is not None:
            low = low if prescribed.high is None else math.cos(prescribed.high)
            high = high if prescribed.low is None else math.cos(prescribed.low)
            low, high = low if low >= -most - COSINE_ROUNDING else -math.inf, high if high <= most + COSINE_ROUNDING else math.inf
            if math.isfinite(low) or math.isfinite(high):
                yield prescribed.key, low, high, problem.limits.transmission_range
        replaced = problem.limits.transmission_range == required  # by a limit of the file that is as tight
        floor = -math.inf if replaced and abs(low + most) <= COSINE_ROUNDING else -most
        ceiling = math.inf if replaced and abs(high - most) <= COSINE_ROUNDING else most
        if math.isfinite(floor) or math.isfinite(ceiling):
            yield "limits.alignment", floor, ceiling, required

    def _transmission(self, values: Mapping[str, Ball], reach: Reach) -> Iterator[Row]:
        """Yield the limits of the transmission angle at its extremes, with the crank in line with the frame or at an end."""
        for key, low, high, over in self._cosine_limits(COUPLER_JOINT):
            if over == "revolution" and not key.startswith("limits.pressure_angle"):
                extremes = ((1.0, -math.inf, high), (-1.0, low, math.inf))
                for at, least, largest in extremes:
                    yield key, self._cosine(values, Ball.constant(at)), least, largest
                continue
            cosines = [Ball.constant(1.0), Ball.constant(-1.0)]
            if over == "span":
                ends = reach.start, reach.start + reach.span
                first, last = ends if reach.span >= 0.0 else ends[::-1]
                inner = (np.minimum(np.maximum(k * np.pi, first), last) for k in range(-4, 5))
                cosines = [np.cos(angle) for angle in (first, last, *inner)]
            for cosine in cosines:
                yield _cosine_row(key, self._cosine(values, cosine), low, high)

    def _registered(self, values: Mapping[str, Ball], reach: Reach) -> Iterator[Row]:
        for term, interval in limits_in_file(self.problem.limits):
            low, high = interval.bounds
            with principal_angles():
                rows = list(term.values(self.problem, values, reach, interval))
            yield from ((term.key, value, low, high) for _, value in rows if isinstance(value, Ball))

    def _pivots(self, values: Mapping[str, Ball]) -> Iterator[Row]:
        region = self.problem.limits.pivots if isinstance(self.problem, PathProblem) else None
        if region is None:
            return
        pose = Pose(self.problem.linkage, values)
        for place in self.problem.linkage.ground.values():
            for axis, coordinate in zip("xy", pose.fixed(place), strict=True):
                interval = getattr(region, axis)
                if interval is not None and isinstance(coordinate, Ball):
                    yield "limits.pivots", coordinate, *interval.bounds

    def _positions(self, values: Mapping[str, Ball]) -> Iterator[Row]:
        """Yield the limits of single crank angles: over the span at the positions of the target, else over a revolution."""
        problem = self.problem
        assert isinstance(problem, PathProblem)
        assert problem.data.offsets is not None
        required = "span" if problem.limits.crank == "span" else "revolution"
        start = self.starts(values)[0][1]

        def poses(angles: Any) -> list[Pose]:
            return [problem.linkage.pose(values, (np.cos(angle), np.sin(angle))) for angle in angles]

        over_span = poses([start + Ball.constant(offset) for offset in problem.data.offsets])
        whole = over_span
        if required == "revolution":
            whole = poses([Ball.constant(angle) for angle in np.linspace(0.0, math.tau, GRID, endpoint=False)])
        for group in problem.linkage.groups:
            aligned = not isinstance(group, RRR)
            for key, low, high, over in self._cosine_limits(group.joint) if isinstance(group, Transmitting) else ():
                aligned |= key == "limits.alignment"
                if key != "limits.alignment":
                    rows = [
                        _cosine_row(key, group.cosine(pose), low, high)  # type: ignore[attr-defined]
                        for pose in (over_span if over != required else whole)
                    ]
                    yield from ((key, value, low, math.inf) for key, value, low, _ in rows if math.isfinite(low))
                    yield from ((key, value, -math.inf, high) for key, value, _, high in rows if math.isfinite(high))
            if aligned:
                least = math.sin(problem.limits.alignment.value) ** 2
                yield from (("limits.alignment", group.alignment(pose), least, math.inf) for pose in whole)

    def _tolerances(self, values: Mapping[str, Ball]) -> Iterator[Row]:
        problem = self.problem
        assert isinstance(problem, PathProblem)
        data = problem.data
        limited = np.isfinite(data.tolerances)
        if not np.any(limited):
            return
        for k, deviations in enumerate(self.deviations(values, self.starts(values)[0])):
            if limited[k] and all(deviation.model is not None for deviation in deviations[:2]):
                x, y = (deviation.model for deviation in deviations[:2])
                most = float(data.tolerances[k]) * float(data.roots[k])
                yield "requirement.points", -(x * x) - y * y, -most * most, math.inf  # type: ignore[operator]


def _cosine_row(key: str, cosine: Ball, low: float, high: float) -> Row:
    """Return the row of a limit of the transmission angle, or of the pressure angle, which lies on both sides of 90 deg."""
    if key.startswith("limits.pressure_angle"):
        return key, cosine * cosine, -math.inf, high * high
    return key, cosine, low, high


def _principal(angle: Ball) -> list[Ball]:
    """Return the angles within -pi ... pi that a continuous one, which may lie beyond, can stand for over the box."""
    turn, angles = 2 * arb.pi(), [angle]
    if not angle.range < arb.pi():
        angles.append(angle - turn)
    if not angle.range > -arb.pi():
        angles.append(angle + turn)
    return angles


def _between(first: Any, second: Any) -> Ball:
    """Return the angle from one direction to another [rad]."""
    angle: Ball = np.arctan2(cross(first, second), dot(first, second))
    return angle


def _plain(model: Ball) -> Deviation:
    inside = model.range
    least = inside.lower().max(-inside.upper()).max(arb(0)) if inside.is_finite() else arb(0)
    return Deviation(least, model if model.known else None)


def _turned(model: Ball) -> Deviation:
    """Return a deviation in angle: the difference from the nearest full turn."""
    plain = _plain(model)
    if plain.model is None or (model.range < arb.pi() and model.range > -arb.pi()):
        return plain
    farthest = model.range.abs_upper()
    return Deviation(plain.least.min((2 * arb.pi() - farthest).max(arb(0))), None)


def _scaled(one: Deviation, factor: float) -> Deviation:
    return Deviation(one.least * arb(factor), None if one.model is None else one.model * factor)
