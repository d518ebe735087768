"""Maxima of penetrations, normal forces and torque over a motion, between its rows as well as at them.

At every row the values and slopes of these quantities bound their values until the next row. Where the bound exceeds the
current maximum, the row is stored, integrated again in small steps, and the maximum located there. The result depends on the
motion alone, not on the number of rows.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from optlink.clearance.contact_laws import normal_force
from optlink.clearance.joint import Gap
from optlink.linkage.vector2d import Array

PARTS = 16
"""Steps into which an interval is divided, twice: a cubic on the last of them is exact to 1e-11 of the value."""

REACH = 0.625
"""Share of an interval times the slope at its end that a peak within it lies above that end at most; 0.5 for a concave curve."""

STEADY, SHARE = 0.5, 0.2
"""Where a quantity is never below this share of its bound, a cubic errs by less than that share of how far the bound is off."""

PEAK_ACCURACY = 1e-13
"""Relative excess over the largest value that is neglected."""


class Watched(NamedTuple):
    """Rows (m, gaps) of penetration [m], its rate and second derivative, normal force [N] and its rate, torque per force [m].

    `torque` [N m] of the drive and its rate: (m, 1).
    """

    depth: Array
    rate: Array
    curve: Array
    normal: Array
    force_rate: Array
    lever: Array
    torque: Array
    torque_rate: Array


Solve = Callable[[Array, Array, int], tuple[Array, Watched]]
"""(state, parameters, steps) -> states and watched quantities at the start and after every step of the span."""


@dataclass
class MotionInterval:
    """A part of the motion without a switch: state at its start, parameters of the integrator (the first: its span [s])."""

    state: Array
    parameters: Array
    divided: tuple[Array, Watched] | None = None


@dataclass
class CurrentPeak:
    """The current maximum of one quantity, and the intervals where it may be exceeded: (bound, interval)."""

    value: float = 0.0
    waiting: list[tuple[float, MotionInterval]] = field(default_factory=list)


class Peaks:
    """Maxima over a motion: penetration and normal force of every gap, and the magnitude of the torque."""

    def __init__(self, gaps: Sequence[Gap], solve: Solve) -> None:
        self.gaps, self.solve, count = gaps, solve, len(gaps)
        self.contacts = [CurrentPeak() for _ in gaps]  # penetration of the current contact
        self.turn = [CurrentPeak() for _ in range(2 * count + 1)]  # since `take`: penetrations, forces, torque

    def note(self, states: Array, watched: Watched, parameters: Array) -> None:
        """Record consecutive rows, and where they may be exceeded between; the parameters are those of the first interval."""
        if len(states) < 2:
            return
        k, modes = len(self.gaps), parameters[3 + len(self.gaps) :]
        values, _ = _curves(watched)
        bounds = self._bounds(watched, parameters)
        inside: dict[int, MotionInterval] = {}
        several = [(self.contacts[j], j) for j in range(k) if modes[j]]
        several += [(peak, j) for j, peak in enumerate(self.turn) if j == 2 * k or modes[j % k]]
        for peak, j in several:
            peak.value = max(peak.value, float(np.max(values[:, j])))
            least = peak.value * (1.0 + PEAK_ACCURACY)
            peak.waiting = [one for one in peak.waiting if one[0] > least]
            for i in np.flatnonzero(bounds[:, j] > least).tolist():
                if i not in inside:
                    inside[i] = MotionInterval(states[i].copy(), _later(parameters, i))
                peak.waiting.append((float(bounds[i, j]), inside[i]))

    def _bounds(self, watched: Watched, parameters: Array) -> Array:
        """Upper bounds of each quantity between two rows (m - 1, 2 gaps + 1)."""
        span, entered = float(parameters[0]), parameters[3 : 3 + len(self.gaps)]
        rise, fall = np.maximum(watched.rate, 0.0), np.maximum(-watched.rate, 0.0)
        bend = 0.25 * span * span * np.maximum(watched.curve, 0.0)
        ahead = watched.depth + REACH * span * rise + bend
        back = watched.depth + REACH * span * fall + bend
        depth = np.maximum(ahead[:-1], back[1:])
        fastest = np.maximum(rise[:-1], rise[1:]) + span * np.maximum(np.maximum(watched.curve[:-1], watched.curve[1:]), 0.0)
        force = np.stack(
            [
                normal_force(gap.law, np.maximum(depth[:, j], 0.0), fastest[:, j], entered[j], gap.stiffness, gap.restitution)
                for j, gap in enumerate(self.gaps)
            ],
            axis=-1,
        )
        more = np.maximum(force - np.maximum(watched.normal[:-1], watched.normal[1:]), 0.0)
        lever = np.maximum(np.abs(watched.lever[:-1]), np.abs(watched.lever[1:]))
        size, slope = np.abs(watched.torque[:, 0]), np.abs(watched.torque_rate[:, 0])
        torque = np.maximum(size[:-1], size[1:]) + REACH * span * np.maximum(slope[:-1], slope[1:])
        torque = torque + 2.0 * REACH * np.sum(np.where(more > 0.0, lever * more, 0.0), axis=1)
        bounds = np.column_stack([depth, force, torque])
        values, slopes = _curves(watched)
        high, low = np.maximum(values[:-1], values[1:]), np.minimum(values[:-1], values[1:])
        cubic = _cubic_summits(values, slopes, span)
        return np.where(low > STEADY * bounds, np.minimum(bounds, cubic + SHARE * (bounds - high)), bounds)

    def begin(self, gap: int) -> None:
        """Start a new contact at a gap."""
        self.contacts[gap] = CurrentPeak()

    def deepest(self, gap: int) -> float:
        """Return the largest penetration of the current contact, or of the one just ended [m]."""
        return self._resolve(self.contacts[gap], gap)

    def take(self) -> tuple[float, ...]:
        """Return the maxima since the last call: penetrations [m] and normal forces [N] of all gaps, torque [N m]."""
        values = tuple(self._resolve(peak, j) for j, peak in enumerate(self.turn))
        self.turn = [CurrentPeak() for _ in self.turn]
        return values

    def _resolve(self, peak: CurrentPeak, j: int) -> float:
        """Check every interval that may exceed the maximum, in the order of decreasing bounds."""
        waiting, peak.waiting = sorted(peak.waiting, key=lambda one: -one[0]), []
        for bound, interval in waiting:
            if bound <= peak.value * (1.0 + PEAK_ACCURACY):
                break
            peak.value = self._larger(peak.value, interval, j, twice=True)
        return peak.value

    def _larger(self, best: float, interval: MotionInterval, j: int, *, twice: bool) -> float:
        """Return the larger of `best` and the maximum of quantity j in an interval, which is divided once or twice."""
        if interval.divided is None:
            interval.divided = self.solve(interval.state, interval.parameters, PARTS)
        states, watched = interval.divided
        parameters = interval.parameters.copy()
        parameters[0] /= PARTS
        values, slopes = (part[:, j] for part in _curves(watched))
        best = max(best, float(np.max(values)))
        if not twice:
            return max(best, float(np.max(_cubic_summits(values, slopes, float(parameters[0])))))
        bounds = self._bounds(watched, parameters)[:, j]
        for i in np.argsort(-bounds).tolist():
            if bounds[i] <= best * (1.0 + PEAK_ACCURACY):
                break
            best = self._larger(best, MotionInterval(states[i], _later(parameters, i)), j, twice=False)
        return best


def _later(parameters: Array, count: int) -> Array:
    """Return the parameters of the interval that begins `count` spans later."""
    return np.concatenate([parameters[:1], parameters[1:2] + count * parameters[0], parameters[2:]])


def _curves(watched: Watched) -> tuple[Array, Array]:
    """Values and slopes of penetrations, forces and the torque's magnitude, (m, 2 gaps + 1) each."""
    sign = np.sign(watched.torque)
    values = np.column_stack([watched.depth, watched.normal, sign * watched.torque])
    return values, np.column_stack([watched.rate, watched.force_rate, sign * watched.torque_rate])


def _cubic_summits(values: Array, slopes: Array, span: float) -> Array:
    """Maxima (m - 1,) between rows of the cubics with these values and slopes at the rows."""
    y0, y1, a, b = values[:-1], values[1:], slopes[:-1] * span, slopes[1:] * span
    # y0 + a u + q u^2 + p u^3; its slope is a + 2 q u + 3 p u^2
    p, q = a + b - 2.0 * (y1 - y0), 3.0 * (y1 - y0) - 2.0 * a - b
    root = np.sqrt(np.maximum(q * q - 3.0 * p * a, 0.0))
    below = root - q  # the root of the slope where it falls is a / (root - q), without cancellation for q < 0
    u = np.clip(np.divide(a, below, out=np.zeros_like(a), where=below > 0.0), 0.0, 1.0)
    return np.asarray(np.maximum(np.maximum(y0, y1), y0 + u * (a + u * (q + u * p))))
