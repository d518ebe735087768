"""Integration of a machine with joint clearance: CVODES between the instants at which contacts begin and end.

Every gap has a mode, apart or in contact, which is constant during a call of the integrator, so that its equations are smooth:
a journal that is apart penetrates the bearing without force until the end of the call, and the crossing is then located on
its path, independently of the integrator's steps. The motion restarts there in the other mode.

The path between two rows is checked by its values and slopes, so a contact shorter than a row is found too.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

import numpy as np

from optlink.clearance.equations import Equations
from optlink.clearance.joint import SLOWEST, Gap, normal_force
from optlink.linkage.vector2d import Array, all_finite
from optlink.symbolic import silent

# Quintic Hermite interpolation between two rows: zero crossing and maximum.
#
# The path is given by its value, slope and second derivative at both ends, and the span of time between them.


def _quintic(begin: Sequence[float], end: Sequence[float], span: float) -> Array:
    """The polynomial over a row (0 ... 1)."""
    (y0, s0, c0), (y1, s1, c1) = begin, end
    a, b = s0 * span, s1 * span
    c, d = 0.5 * c0 * span * span, 0.5 * c1 * span * span
    p, q, r = y1 - y0 - a - c, b - a - 2.0 * c, d - c
    return np.array([6.0 * p - 3.0 * q + r, -15.0 * p + 7.0 * q - 2.0 * r, 10.0 * p - 4.0 * q + r, c, a, y0])


def _real_roots(polynomial: Any) -> Array:
    roots = np.roots(polynomial)
    return np.sort(roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0) & (roots.real < 1.0)])


def crossing(begin: Sequence[float], end: Sequence[float], span: float) -> float:
    """Estimate the first upward zero crossing of a path that ends above zero, as a share of the row."""
    path = _quintic(begin, end, span)
    rising = [u for u in _real_roots(path) if np.polyval(np.polyder(path), u) > 0.0]
    return float(rising[0]) if rising else 0.5


def summit(begin: Sequence[float], end: Sequence[float], span: float) -> float:
    """Estimate the maximum of a path that rises at its start and falls at its end, as a share of the row."""
    path = _quintic(begin, end, span)
    tops = _real_roots(np.polyder(path))
    return float(tops[np.argmax(np.polyval(path, tops))]) if tops.size else begin[1] / (begin[1] - end[1])


# Maxima of penetrations, normal forces and torque over a motion, between its rows as well as at them.
#
# At every row the values and slopes of these quantities bound their values until the next row. Where the bound exceeds the
# current maximum, the row is stored, integrated again in small steps, and the maximum located there. The result depends on the
# motion alone, not on the number of rows.

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
    return np.maximum(np.maximum(y0, y1), y0 + u * (a + u * (q + u * p)))


CHUNKS = (1, 10, 64, 256, 2560)
"""Rows that one call of the integrator may cover; the most where the machine is slow and in contact only."""

BUSY = 2000
"""Number of switches within one row from which on the integration counts as stalled."""

SHARP = 1e-6
"""Resolution of time, as a share of a row."""

RUNGE_KUTTA_SHARE = 2e-3
"""Largest share of a row that one Runge-Kutta step covers with negligible error."""

DEEPEST = 0.2
"""Share of the journal's radius: a deeper penetration is no longer a contact."""


class Impact(NamedTuple):
    """One contact, from its start to its end.

    Gap, begin [s], crank angle then [rad], approach speed [m/s], largest penetration [m], end [s], departure speed [m/s]. The end
    is NaN while the contact lasts.
    """

    gap: int
    begin: float
    crank_angle: float
    approach: float
    penetration: float
    end: float
    departure: float

    def deepened(self, depth: float) -> Self:
        """Return the contact with a penetration of at least a depth [m]."""
        return self._replace(penetration=max(self.penetration, depth))


class Crossing(NamedTuple):
    """A switch of a gap: the gap, the time from the start of the row [s], the state there, the works until then [J]."""

    gap: int
    into: float
    state: Array
    works: Array


class Block(NamedTuple):
    """Rows of a motion.

    Times (m,) [s], states (m, 2n), modes and approach speeds of the gaps (m, k), works since the start (m, w) [J].
    """

    time: Array
    states: Array
    modes: Array
    entered: Array
    works: Array


TOO_DEEP = "too deep for the contact law"


class Stalled(RuntimeError):
    """The integration cannot continue; `reason` describes why."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


@dataclass
class Integration:
    """A motion during its integration from a state (2n,), with rows every `step` [s].

    `tolerance` is relative; the absolute one is a thousandth of it (SI). `slow`: contacts vibrate far faster than the machine
    moves; an implicit method then steps over decayed vibrations.
    """

    equations: Equations
    state: Array
    step: float
    tolerance: float
    slow: bool

    def __post_init__(self) -> None:
        gaps = len(self.equations.gaps)
        self.row, self.ahead = 0, 0.0  # and the time since that row [s]
        self.further = 0.0  # feedback correction beyond the command [rad]
        self.modes, self.entered = np.zeros(gaps), np.full(gaps, SLOWEST)
        self.works = np.zeros(len(self.equations.losses))
        self._chunk = self._busy = 0
        self.open: dict[int, Impact] = {}
        self.peaks = Peaks(self.equations.gaps, self._again)
        self.stop: Callable[[], bool] = lambda: False
        self.finished: list[Impact] = []
        self.switches = 0

    @property
    def time(self) -> float:
        """Current time [s]."""
        return float(self.row * self.step + self.ahead)

    def parameters(self, span: float, time: float) -> Array:
        """Return the constants of a call of the integrator with this duration and begin [s]."""
        return np.concatenate([[span, time, self.further], self.entered, self.modes])

    def restart(self) -> None:
        """Reset the number of rows per call of the integrator, so that the continuation depends on the state alone."""
        self._chunk = 0

    def advance(self, rows: int) -> Iterator[Block]:
        """Integrate a number of rows; yields them in blocks.

        Raises
        ------
        Stalled
            The integration cannot continue.
        """
        end = self.row + rows
        while self.row < end:
            count = 1
            if self.ahead == 0.0:
                left = end - self.row
                count = max(n for n in CHUNKS[: self._chunk + 1] if n <= left)
                if left <= min(CHUNKS[self._chunk], CHUNKS[1]):
                    count = left
            span = count * self.step - self.ahead
            states, works = self._solve(self.state, self.parameters(span, self.time), count)
            row, suspects = self._suspects(states, span / count)
            switch, whole = None, count
            if suspects:
                offset, into = row * span / count, span / count
                switch = self._first_switch(states[row], offset, into, suspects)
                whole = row + (switch is None)  # a false alarm: the row is accepted
                there, into = (states[row + 1], into) if switch is None else (switch.state, switch.into)
                last, parameters = np.vstack([states[row], there]), self.parameters(into, self.time + offset)
                self.peaks.note(last, self._watch(last, parameters), parameters)
            if whole:
                yield self._accept(states[1 : whole + 1], works[:whole])
            if switch is not None:
                self._switch(switch)
            elif not suspects:
                self._chunk = min(self._chunk + 1, len(CHUNKS) - 1 - (not self._stiff(self.modes)))

    # --- one call ------------------------------------------------------------------------------------------------------

    def _solve(self, state: Array, parameters: Array, count: int) -> tuple[Array, Array]:
        """States at the start and after each of `count` equal steps of the span, and the works after each [J]."""
        try:
            with silent():
                stiff = self._stiff(parameters[-len(self.equations.gaps) :])
                states, works = self.equations.integrator(count, self.tolerance, stiff=stiff)(state, parameters)
        except RuntimeError:
            if self.stop():  # a keyboard interrupt also aborts a call
                raise KeyboardInterrupt from None
            raise Stalled("the integrator cannot continue") from None
        if self.stop():
            raise KeyboardInterrupt
        if not all_finite(states):
            raise Stalled("the motion is no longer finite")
        return np.vstack([state, states.reshape(count, -1)]), works.reshape(count, -1)

    def _stiff(self, modes: Array) -> bool:
        return self.slow and bool(np.any(modes > 0.0))

    def _observe(self, states: Array, span: float) -> Watched:
        """Watched quantities of gaps and torque at states that are `span` apart, the first one now."""
        return self._watch(states, self.parameters(span * (len(states) - 1), self.time))

    def _penetrations(self, state: Array) -> tuple[Array, Array]:
        """Penetrations of the gaps and their rates at a state."""
        watched = self._observe(state[None, :], 0.0)
        return watched.depth[0], watched.rate[0]

    def _watch(self, states: Array, parameters: Array) -> Watched:
        count = len(states)
        values = self.equations.watch(count)(states.ravel(), np.tile(parameters, count), np.linspace(0.0, 1.0, count))
        return Watched(*(part.reshape(count, -1) for part in values))

    def _suspects(self, states: Array, span: float) -> tuple[int, dict[int, tuple[float, bool]]]:
        """Return the first row in which a gap may switch, and by gap the estimated time and whether the switch is certain.

        Records the penetrations and forces of contacts until then.
        """
        watched = self._observe(states, span)
        depth, rate, curve = watched[:3]
        side = 1.0 - 2.0 * self.modes  # the penetration with this sign rises above zero at a switch
        y, slope = side * depth, side * rate
        turns = (slope[:-1] > 0.0) & (slope[1:] < 0.0)  # may touch zero within the row
        reach = np.maximum(y[:-1] + 0.5 * span * slope[:-1], y[1:] - 0.5 * span * slope[1:])
        rows = np.argwhere((y[1:] > 0.0) | (turns & (reach > 0.0)))
        row = len(states) - 1
        suspects: dict[int, tuple[float, bool]] = {}
        for i, j in rows:
            if suspects and i > row:
                break
            begin, end = ([float(side[j] * part[m, j]) for part in (depth, rate, curve)] for m in (i, i + 1))
            sure = bool(y[i + 1, j] > 0.0)
            row, suspects[int(j)] = int(i), ((crossing if sure else summit)(begin, end, span) * span, sure)
        until = Watched(*(part[: row + 1] for part in watched))
        self.peaks.note(states[: row + 1], until, self.parameters(span, self.time))
        return row, suspects

    def _first_switch(self, state: Array, offset: float, span: float, suspects: dict[int, tuple[float, bool]]) -> Crossing | None:
        """The first switch within a row that begins with this state, `offset` from now; None if no gap switches."""
        first: Crossing | None = None
        for gap, (guess, sure) in sorted(suspects.items(), key=lambda item: item[1][0]):
            end = span if first is None else first.into
            if end <= 0.0:
                break
            if guess < end or sure:
                first = self._cross(state, offset, end, gap, min(guess, end), sure and first is None) or first
        for _ in self.equations.gaps if first else ():
            assert first is not None
            before = self._beyond(first)
            if before is None:
                break
            first = self._cross(state, offset, first.into, before, 0.5 * first.into, True) or first
        return first

    def _beyond(self, switch: Crossing) -> int | None:
        """Return a gap that has already switched before another one does."""
        depth, rate = self._penetrations(switch.state)
        late = (1.0 - 2.0 * self.modes) * depth / np.maximum(np.abs(rate), 1e-300) > SHARP * self.step
        late[switch.gap] = False
        return int(np.argmax(late)) if np.any(late) else None

    def _cross(self, state: Array, offset: float, end: float, gap: int, guess: float, sure: bool) -> Crossing | None:
        """Locate the switch of a gap between a state (`offset` from now) and the time `end` later, by Newton on the motion.

        `sure`: it has switched at the end.
        """
        side = 1.0 - 2.0 * self.modes[gap]
        low, high, s = 0.0, end if sure else np.inf, guess
        works = np.zeros_like(self.works)
        for _ in range(100):
            states, more = self._solve(state, self.parameters(s - low, self.time + offset + low), 1)
            y, slope, curve = (side * float(part[1, gap]) for part in self._observe(states, s - low)[:3])
            rest = -y / slope if slope > 0.0 else np.inf
            if abs(rest) < RUNGE_KUTTA_SHARE * self.step:
                there, last, into = self._land(states[1], self.time + offset + s, rest, gap, side)
                return Crossing(gap, s + into, there, works + more[0] + last)
            if y > 0.0:
                high = s
            else:
                low, state, works = s, states[1], works + more[0]
            if low < s + rest < high and (high < np.inf or s + rest < end):
                s += rest
            elif high < np.inf:
                s = 0.5 * (low + high)
            else:  # not switched yet, and may return before it does: check the maximum
                peak = s - slope / curve if curve < 0.0 else np.inf
                if not low < peak < end or abs(peak - s) < SHARP * self.step:
                    return None
                s = peak
            if high - low < SHARP * SHARP * self.step:
                states, more = self._solve(state, self.parameters(high - low, self.time + offset + low), 1)
                return Crossing(gap, high, states[1], works + more[0])
        return None

    def _land(self, state: Array, time: float, rest: float, gap: int, side: float) -> tuple[Array, Array, float]:
        """Integrate the last interval before a switch, too short for a call of the integrator: (state, works, time)."""
        into, works = 0.0, np.zeros_like(self.works)
        for _ in range(6):
            state, more = self.equations.short_step(state, self.parameters(0.0, time + into), np.array([rest]))
            into, works = into + rest, works + more
            depth, rate = (side * float(part[gap]) for part in self._penetrations(state))
            rest = -depth / rate if rate > 0.0 else 0.0
            if abs(rest) <= 1e-14 * (time + into) or abs(rest) > RUNGE_KUTTA_SHARE * self.step:
                break
        return state, works, into

    def _again(self, state: Array, parameters: Array, steps: int) -> tuple[Array, Watched]:
        """Integrate an interval again, in small steps."""
        states, _ = self._solve(state, parameters, steps)
        return states, self._watch(states, parameters)

    def _accept(self, states: Array, works: Array) -> Block:
        """Advance to the last of these rows."""
        count = len(states)
        times = (self.row + np.arange(1.0, count + 1.0)) * self.step
        states = self._closed(states)
        block = Block(times, states, np.tile(self.modes, (count, 1)), np.tile(self.entered, (count, 1)), self.works + works)
        self.row, self.ahead, self._busy = self.row + count, 0.0, 0
        self.state, self.works = states[-1].copy(), block.works[-1].copy()
        self._check()
        return block

    def _switch(self, switch: Crossing) -> None:
        """Advance to the start or end of a contact, and change its mode."""
        gap, self.state = switch.gap, self._closed(switch.state[None, :])[0]
        self.works = self.works + switch.works
        self.ahead = min(max(self.ahead + switch.into, self.ahead), self.step * (1.0 - 1e-12))
        rate, begins = float(self._penetrations(self.state)[1][gap]), self.modes[gap] == 0.0
        self.modes = self.modes.copy()
        self.modes[gap] = 1.0 if begins else 0.0
        if begins:
            self.entered = self.entered.copy()
            self.entered[gap] = max(rate, SLOWEST)
            self.peaks.begin(gap)
        deepest = 0.0 if begins else self.peaks.deepest(gap)
        self._record(gap, begins, self.time, float(self.state[self.equations.tree.driven]), rate, deepest)
        self._busy += 1
        self._chunk = 0
        if self._busy > BUSY:
            raise Stalled(f"more than {BUSY} contacts begin and end within {self.step:.3g} s")

    def _record(self, gap: int, begins: bool, time: float, angle: float, rate: float, deepest: float) -> None:
        """Record the start or end of a contact: time [s], crank angle [rad], rate of the penetration [m/s], largest one [m]."""
        self.switches += 1
        if begins:
            self.open[gap] = Impact(gap, time, angle, rate, 0.0, np.nan, np.nan)
        else:
            self.finished.append(self.open.pop(gap).deepened(deepest)._replace(end=time, departure=-rate))

    def take_peaks(self) -> tuple[float, ...]:
        """Return the maxima since the last call: penetrations [m] and normal forces [N] of all gaps, torque [N m]."""
        for gap, impact in self.open.items():
            self.open[gap] = impact.deepened(self.peaks.deepest(gap))
        return self.peaks.take()

    @property
    def lasting(self) -> tuple[Impact, ...]:
        """The contacts that have not ended."""
        return tuple(impact.deepened(self.peaks.contacts[gap].value) for gap, impact in self.open.items())

    def _closed(self, states: Array) -> Array:
        """Project states (m, 2n) onto the closing joints, from which they drift by the integrator's error."""
        if not self.equations.closing:
            return states
        n, crank = self.equations.size, self.equations.tree.driven
        states = states.copy()
        for _ in range(2):
            residuals, grip = self.equations.closure(states)
            grip[:, :, crank] = 0.0
            states[:, :n] -= np.einsum("mij,mj->mi", np.linalg.pinv(grip), residuals)
        _, grip = self.equations.closure(states)
        moving = np.einsum("mji,mi->mj", grip, states[:, n:])
        grip[:, :, crank] = 0.0
        states[:, n:] -= np.einsum("mij,mj->mi", np.linalg.pinv(grip), moving)
        return states

    def _check(self) -> None:
        for gap, delta in zip(self.equations.gaps, self._penetrations(self.state)[0], strict=True):
            if delta > DEEPEST * gap.radius:
                raise Stalled(f"the journal at {gap.point} is {delta:.3g} m deep in its bearing, {TOO_DEEP}")
