"""Samples of a machine's motion over a revolution, on which its loads and clearances depend."""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from optlink.clearance.joint import Gap
from optlink.dynamics.loads import Force
from optlink.dynamics.machine import Load, Machine, Moving
from optlink.linkage.mechanism import FRAME
from optlink.linkage.stroke import LEAST_DIFFERENCE, Direction
from optlink.linkage.vector2d import TURN, Array, Value, cross, dot
from optlink.problem.quantity import Unusable

STROKES = 720  # positions of a revolution at which the motion of a load is sampled
FULL_TURN = TURN - 0.02  # rad; a sampled swing that is wider is a full turn
_SENSE: dict[Direction | None, float] = {"forward": 1.0, "backward": -1.0, None: 0.0}


class RevolutionSamples:
    """Samples of a machine's motion over a revolution, as far as it can be assembled."""

    def __init__(self, machine: Machine, slow: Mapping[str, Direction] | None = None) -> None:
        self.machine, self._slow = machine, slow or {}

    @cached_property
    def moving(self) -> Moving:
        """The machine at evenly spaced crank angles."""
        return self.machine.moving(np.linspace(0.0, self.machine.mechanism.cycle, STROKES, endpoint=False) + 1e-4)

    def check_clearances(self, gaps: Sequence[Gap]) -> None:
        """Refuse clearances that allow a group of the mechanism to disassemble or to change its assembly mode.

        Raises
        ------
        Unusable
            If there are such clearances, with the key of the first one.
        """
        mechanism, assembled = self.machine.mechanism, self.moving.motion.assembled
        with np.errstate(all="ignore"):
            pose = mechanism.at(self.machine.sizes, self.moving.motion.crank_angle)
        for group in mechanism.groups if np.all(assembled) else ():
            bodies = {link.body for link in group.links}
            in_group = [gap for gap in gaps if bodies & {gap.journal, gap.bearing}]
            with np.errstate(all="ignore"):
                gap = group.gap(pose)
            spare = -np.broadcast_to(np.asarray(gap, dtype=float), assembled.shape)[assembled]
            if not in_group or not spare.size or not np.any(spare > 0.0):
                continue
            clearances, least = sum(gap.clearance for gap in in_group), float(np.min(spare))
            if clearances >= least:
                at = float(np.degrees(self.moving.motion.crank_angle[assembled][int(np.argmin(spare))]))
                message = (
                    f"the clearance is too large for the mechanism: at a crank angle of {at:z.0f} deg the group of {group.joint} "
                    f"closes with {least * 1e3:.4g} mm to spare, and its joints have {clearances * 1e3:.4g} mm of clearance"
                )
                raise Unusable(message, "Give a smaller clearance, or other lengths", f"joints.{in_group[0].point}.clearance")

    def _rate(self, load: Load) -> Array:
        """Return the rate of the motion that reverses a load, at every position."""
        velocity = load.reversing(self.moving)
        return np.broadcast_to(np.asarray(velocity[0] if velocity else 0.0, dtype=float), self.moving.motion.assembled.shape)

    def check_moves(self, load: Load) -> None:
        """Refuse a load that opposes a motion that does not exist.

        Raises
        ------
        Unusable
        """
        rates = self._rate(load)
        rates = rates[np.isfinite(rates)]
        size = float(np.max(self.machine.size)) if isinstance(load, Force) else 1.0
        moves = np.count_nonzero(np.abs(rates) > 1e-12 * size)
        if rates.size and moves < 0.5 * rates.size:  # near singular positions rounding errors are larger
            what = "does not move in this direction" if isinstance(load, Force) else "does not turn"
            message = f"an opposing load needs a motion, but what it opposes {what}"
            raise Unusable(message, 'Remove the load, or write acts = "constant"', "acts")

    def slow(self, load: Load) -> Direction:
        """Return the stroke of a load's motion that takes longer at constant counter-clockwise crank speed.

        Raises
        ------
        Unusable
            when both take equally long.
        """
        if load.name in self._slow:
            return self._slow[load.name]
        sense = self.slow_senses(load)  # many designs share one machine only if they have the same slow stroke
        if np.all(sense > 0.0):
            return "forward"
        if np.all(sense < 0.0):
            return "backward"
        if not np.all(self.moving.motion.assembled):
            message = "the crank does not turn fully, and in the range that it reaches no stroke is the slow one"
            raise Unusable(message, 'Change the dimensions, or write stroke = "forward" or "backward"', "stroke")
        least = f"{math.degrees(LEAST_DIFFERENCE):g} deg"
        message = f"both strokes take equally long (to {least} of crank rotation), so neither stroke is the slow one"
        raise Unusable(message, 'Write stroke = "forward" or "backward", or change the dimensions', "stroke")

    def slow_senses(self, load: Load) -> Array:
        """Return the slow stroke of a load's motion for one or many designs: 1 forward, -1 backward, 0 for equal strokes.

        For one design with full crank rotation the exact crank angles of the reversals are used, else the sampled positions that
        can be reached, with interpolated reversals.
        """
        from optlink.dynamics.strokes import load_strokes, slower

        assembled = self.moving.motion.assembled
        if np.ndim(assembled) == 1 and np.all(assembled):
            return np.array([_SENSE[slower(load_strokes(self.machine, load))]])
        rate = self._rate(load) + np.zeros(STROKES)
        rate = np.concatenate([rate, rate[..., :1]], axis=-1)
        size = np.abs(rate[..., 1:]) + np.abs(rate[..., :-1])
        with np.errstate(all="ignore"):  # 0 / 0 for a design that can be assembled nowhere
            share = (rate[..., 1:] + rate[..., :-1]) / size
            difference = self.machine.mechanism.cycle * np.nansum(share, axis=-1) / np.sum(np.isfinite(share), axis=-1)
        sense = np.where(np.abs(difference) >= LEAST_DIFFERENCE, np.sign(difference), 0.0)
        return np.asarray(sense, dtype=float).reshape(-1)

    def middle(self, body: str, against: str, free: float) -> Value:
        """Return the middle of the swing of a body relative to another [rad], within half a revolution of `free` [rad].

        A number, or an array (designs, 1) if the swing differs from design to design.

        Raises
        ------
        Unusable
            when the body makes a full turn, as no torsion spring allows, in any design.
        """
        low, high = self._swing(body, against)
        if np.any(high - low > FULL_TURN):
            message = f"{body} turns fully against {against}, so a torsion spring cannot connect them"
            raise Unusable(message, "Use torsional_damping, or a spring between two points", "on")
        middle = 0.5 * (low + high)
        return _per_design(np.where(np.isnan(middle), free, _near(middle, free)))

    def branch(self, body: str) -> Value:
        """Return the middle [rad] of the swing of a body, from -180 to 180 deg; 0 for one that turns fully.

        A number, or an array (designs, 1) if the swing differs from design to design. It is a swing's middle too that does not
        cross 180 deg: that of a similar design, for which it serves as well, may do so.
        """
        low, high = self._swing(body, FRAME)
        return _per_design(np.where(high - low <= FULL_TURN, _near(0.5 * (low + high), 0.0), 0.0))

    def _swing(self, body: str, against: str) -> tuple[Array, Array]:
        """Return the ends [rad] of the swing of a body relative to another, of each design; NaN: no position is reached.

        If every position is reached, the first one is also the last one, so that a full turn counts as one.
        """
        one, other = (self.moving.state(name).axis for name in (body, against))
        angle = np.asarray(np.arctan2(cross(other, one), dot(other, one)) + 0.0 * self.moving.motion.crank_angle)
        closed = [np.append(row, row[0]) if np.all(np.isfinite(row)) else row[np.isfinite(row)] for row in np.atleast_2d(angle)]
        reached = [np.unwrap(row) for row in closed]
        ends = np.array([[np.min(swing), np.max(swing)] if swing.size else [np.nan, np.nan] for swing in reached])
        low, high = ends.T.reshape(2, *np.shape(angle)[:-1])
        return low, high


def _near(angle: Array, reference: float) -> Array:
    """Return angles less whole revolutions: at most half a revolution from a reference, ahead of it in the case of a tie."""
    return np.asarray(angle - TURN * np.ceil((angle - reference) / TURN - 0.5 - 1e-9))


def _per_design(values: Array) -> Value:
    """Return the value of one design as a number, those of many designs as an array (designs, 1)."""
    return values[:, None] if values.ndim else float(values)
