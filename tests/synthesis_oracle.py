"""Judge of path, motion and function synthesis of four-bars and slider-cranks; numpy only, nothing of optlink.

A design is a plain mapping, see `four_bar` and `slider_crank`; angles are in rad, points are complex numbers or rows (x, y).
There are two routes to a position, neither intersects circles: the loop closure as a quadratic in the tangent of half the
coupler angle (`direct`), and Newton's method on the loop closure in complex numbers, continued along the crank's rotation with
steps that cannot pass a position where the two modes meet (`follow`). Values are of the first, circuits of the second.

    report = judge_path(design, wanted, crank_angles)
    report.sse, report.nearest, report.free
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]
Design = Mapping[str, float]
Values = Sequence[float] | Array

TURN = 2.0 * math.pi
STEP = math.radians(2.0)  # longest of the continuation
SHORTEST = 1e-10  # step of the continuation; below, there is no way on
MEETING = 1e-6  # closure sine at which the two modes are taken to meet
EQUAL = 1e-9  # rad, angles that are the same
SAME = 1e-7  # share of the size, positions that are the same by both routes


# --- designs -------------------------------------------------------------------------------------------------------------


def four_bar(
    frame: float,
    crank: float,
    coupler: float,
    rocker: float,
    *,
    x: float = 0.0,
    y: float = 0.0,
    direction: float = 0.0,
    along: float = 0.0,
    across: float = 0.0,
    mode: float = 1,
) -> dict[str, float]:
    """A = (x, y), D = A + frame e^{i direction}, B = A + crank e^{i (direction + phi)}; mode +1: C is to the left of B to D."""
    return {
        "x": x,
        "y": y,
        "direction": direction,
        "frame": frame,
        "crank": crank,
        "coupler": coupler,
        "rocker": rocker,
        "along": along,
        "across": across,
        "mode": mode,
    }


def slider_crank(
    crank: float,
    coupler: float,
    *,
    x: float = 0.0,
    y: float = 0.0,
    guide: tuple[float, float] | None = None,
    direction: float = 0.0,
    offset: float = 0.0,
    along: float = 0.0,
    across: float = 0.0,
    mode: float = 1,
) -> dict[str, float]:
    """A = (x, y), B = A + crank e^{i phi}; C = G + (s + i offset) e^{i direction}; mode +1: C is forward of B on the guide."""
    g = (x, y) if guide is None else guide
    return {
        "x": x,
        "y": y,
        "crank": crank,
        "coupler": coupler,
        "guide_x": g[0],
        "guide_y": g[1],
        "direction": direction,
        "offset": offset,
        "along": along,
        "across": across,
        "mode": mode,
    }


def sliding(design: Design) -> bool:
    return "rocker" not in design


def size(design: Design) -> float:
    """Largest length that matters to where the points are."""
    return max(abs(design[key]) for key in ("frame", "crank", "coupler", "rocker", "along", "across", "x", "y") if key in design)


def complex_points(points: object) -> Complex:
    """Rows (x, y), or complex numbers, as complex numbers."""
    result = np.asarray(points)
    if np.iscomplexobj(result):
        return np.atleast_1d(result).astype(complex)
    rows = np.atleast_2d(result.astype(float))
    return rows[:, 0] + 1j * rows[:, 1]


def rows_of(points: Complex) -> Array:
    return np.stack([points.real, points.imag], axis=-1)


def wrapped(angle: Array) -> Array:
    """Into [-pi, pi]."""
    return angle - TURN * np.round(angle / TURN)


def _crank(design: Design) -> tuple[complex, complex]:
    """A, and the crank at phi = 0."""
    zero = 0.0 if sliding(design) else design["direction"]
    return complex(design["x"], design["y"]), design["crank"] * cmath.exp(1j * zero)


def _guide(design: Design) -> tuple[complex, complex]:
    """The guide's point at s = 0, offset included, and its unit vector."""
    u = cmath.exp(1j * design["direction"])
    return complex(design["guide_x"], design["guide_y"]) + 1j * design["offset"] * u, u


def _pivot(design: Design) -> complex:
    return complex(design["x"], design["y"]) + design["frame"] * cmath.exp(1j * design["direction"])


# --- first route: quadratic in the tangent of half the angle ---------------------------------------------------------------


class Position(NamedTuple):
    """Elementwise in phi; NaN where the linkage does not assemble, but for b and closure."""

    b: Complex
    c: Complex
    p: Complex
    angle: Array  # of the coupler, B to C, from the x axis
    output: Array  # rocker angle from the frame's direction, or place s of the slider
    closure: Array  # square of the closure sine (sine at C of coupler to rocker, or to the guide's normal), signed
    b_rate: Complex  # d b / d phi
    top: Array  # d angle / d phi = top / bottom
    bottom: Array


def direct(design: Design, phi: Values) -> Position:
    """Positions in the design's mode, by the quadratic, elementwise."""
    phi = np.asarray(phi, dtype=float)
    a, arm = _crank(design)
    swing = arm * np.exp(1j * phi)
    b, b_rate = a + swing, 1j * swing
    coupler, mode = design["coupler"], design["mode"]
    if sliding(design):
        origin, u = _guide(design)
        h = ((b - origin) * u.conjugate()).imag
        square = (coupler - h) * (coupler + h)  # h t^2 + 2 coupler t + h = 0
        root = coupler + _root(square, coupler**2)
        angle = design["direction"] + 2.0 * (np.arctan2(-h, root) if mode > 0 else np.arctan2(-root, h))
        closure = square / coupler**2
        c = b + coupler * np.exp(1j * angle)
        output = ((c - origin) * u.conjugate()).real
        top, bottom = -(b_rate * u.conjugate()).imag, ((c - b) * u.conjugate()).real
    else:
        d, rocker = _pivot(design), design["rocker"]
        w = b - d  # |w + coupler e^{i angle}| = rocker: k + 2 coupler (w.real cos + w.imag sin) = 0
        long = np.abs(w)
        k = long**2 + (coupler - rocker) * (coupler + rocker)
        outer, inner = (
            (long + coupler - rocker) * (long + coupler + rocker),
            (rocker - long + coupler) * (rocker + long - coupler),
        )
        square = outer * inner
        root = _root(square, (2.0 * coupler * rocker) ** 2)
        closure = square / (2.0 * coupler * rocker) ** 2
        minus, plus = k - 2.0 * coupler * w.real, k + 2.0 * coupler * w.real
        middle = -2.0 * coupler * w.imag
        angles = []
        for sign in (1.0, -1.0):  # t = (middle + sign root) / minus = plus / (middle - sign root), whichever is not 0 / 0
            first, second = (middle + sign * root, minus), (plus, middle - sign * root)
            larger = np.hypot(*first) >= np.hypot(*second)
            angles.append(2.0 * np.arctan2(np.where(larger, first[0], second[0]), np.where(larger, first[1], second[1])))
        side = _cross(-w, np.exp(1j * angles[0]))
        angle = np.where(side * mode > 0.0, angles[0], angles[1])
        c = b + coupler * np.exp(1j * angle)
        output = np.angle((c - d) * np.exp(-1j * design["direction"]))
        top, bottom = -((c - d).conj() * b_rate).real, _cross(-w, c - b)
    p = b + complex(design["along"], design["across"]) * np.exp(1j * angle)
    return Position(b, c, p, wrapped(angle), output, closure, b_rate, top, bottom)


def _root(square: Array, scale: float) -> Array:
    """NaN of a negative number, 0 of what is so by rounding."""
    return np.sqrt(np.where(square >= 0.0, square, np.where(square > -1e-13 * scale, 0.0, np.nan)))


def _cross(u: Complex, v: Complex) -> Array:
    return (u.conj() * v).imag


# --- second route: Newton's method, continued ------------------------------------------------------------------------------


class _State(NamedTuple):
    """Coupler angle and rocker angle (from the x axis), or coupler angle and place of the slider as a share of the coupler."""

    phi: float
    angle: float
    other: float


class _Loop:
    """a + arm e^{i phi} + coupler e^{i angle} - (d + rocker e^{i other}, or origin + coupler other u) = 0."""

    def __init__(self, design: Design) -> None:
        self.a, self.arm = _crank(design)
        self.coupler, self.mode, self.slides = design["coupler"], design["mode"], sliding(design)
        self.end, self.u = _guide(design) if self.slides else (_pivot(design), 0j)
        self.rocker = 0.0 if self.slides else design["rocker"]
        self.scale = design["crank"] + design["coupler"] + abs(self.end - self.a)

    def columns(self, state: _State) -> tuple[complex, complex, complex, complex]:
        """Residual and its derivatives by phi, angle and other."""
        turned = self.arm * cmath.exp(1j * state.phi)
        rod = self.coupler * cmath.exp(1j * state.angle)
        if self.slides:
            last, rate = self.coupler * state.other * self.u, self.coupler * self.u
        else:
            last = self.rocker * cmath.exp(1j * state.other)
            rate = 1j * last
        return self.a + turned + rod - self.end - last, 1j * turned, 1j * rod, -rate

    def sine(self, state: _State) -> float:
        """Signed closure sine."""
        if self.slides:
            return (cmath.exp(1j * state.angle) * self.u.conjugate()).real
        return math.sin(state.other - state.angle)

    def newton(self, state: _State, iterations: int, longest: float) -> _State | None:
        """The root near a state; None if there is none within so many iterations of a limited length."""
        phi, angle, other = state
        for _ in range(iterations):
            f, _, p, q = self.columns(_State(phi, angle, other))
            below = (p.conjugate() * q).imag
            if below == 0.0:
                return None
            one, two = -(f.conjugate() * q).imag / below, (f.conjugate() * p).imag / below
            move = abs(one) + abs(two)
            if not move < 1e3:
                return None
            share = min(1.0, longest / move) if move > 0.0 else 1.0
            angle, other = angle + share * one, other + share * two
            if move < 1e-11:  # quadratic: the next is below the rounding
                computed = _State(phi, angle, other)
                return computed if abs(self.columns(computed)[0]) < 1e-12 * self.scale else None
        return None

    def start(self, phi: float) -> _State | None:
        """The root in the wanted mode, from guesses all around."""
        b = self.a + self.arm * cmath.exp(1j * phi)
        for k in range(16):
            angle = TURN * k / 16.0 + 0.1
            c = b + self.coupler * cmath.exp(1j * angle) - self.end
            other = (c * self.u.conjugate()).real / self.coupler if self.slides else cmath.phase(c)
            computed = self.newton(_State(phi, angle, other), 60, 0.5)
            if computed is not None and self.sine(computed) * self.mode > 0.0:
                return computed
        return None

    def go(self, state: _State, phi: float) -> _State | None:
        """Turn the crank to phi without leaving the branch; None if it cannot be reached."""
        while state.phi != phi:
            _, f, p, q = self.columns(state)
            below = (p.conjugate() * q).imag
            one, two = -(f.conjugate() * q).imag / below, (f.conjugate() * p).imag / below
            sine = self.sine(state)
            closing = abs(one) if self.slides else abs(two - one)  # how fast the modes may approach one another
            step = min(STEP, 0.1 / max(abs(one), abs(two), 1e-9), 0.5 * abs(sine) / max(closing, 1e-9), abs(phi - state.phi))
            while True:
                if step < SHORTEST and step < abs(phi - state.phi):
                    return None
                there = phi if step >= abs(phi - state.phi) else state.phi + math.copysign(step, phi - state.phi)
                by = there - state.phi
                result = self.newton(_State(there, state.angle + one * by, state.other + two * by), 6, 1.0)
                if result is not None and self.sine(result) * self.mode > 0.25 * abs(sine):
                    change = abs(result.angle - state.angle - one * by) + abs(result.other - state.other - two * by)
                    if change < 0.1:
                        break
                step *= 0.5
            state = result
        return state


class Followed(NamedTuple):
    """What was met along the crank's rotation; NaN where not reached."""

    p: Complex
    angle: Array
    output: Array  # as in Position, but the rocker angle is continuous
    sine: Array  # signed closure sine, the mode's sign

    @property
    def reached(self) -> bool:
        return bool(np.all(np.isfinite(self.sine)))


def follow(design: Design, phi: Values, again: bool = False) -> Followed:
    """Continue from phi[0] through all phi in turn; `again`: where there is no way, begin anew in the wanted mode."""
    loop = _Loop(design)
    rows: list[tuple[complex, float, float, float]] = []
    nothing = (complex(math.nan, math.nan), math.nan, math.nan, math.nan)
    point = complex(design["along"], design["across"])
    state: _State | None = None
    for k, value in enumerate(np.asarray(phi, dtype=float).tolist()):
        if state is not None:
            state = loop.go(state, value)
        if state is None and (again or k == 0):
            state = loop.start(value)
        if state is None:
            rows.append(nothing)
            continue
        b = loop.a + loop.arm * cmath.exp(1j * value)
        output = loop.coupler * state.other if loop.slides else state.other - design["direction"]
        rows.append((b + point * cmath.exp(1j * state.angle), state.angle, output, loop.sine(state)))
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    return Followed(*columns)


def curve(design: Design, phi: Values) -> tuple[Complex, Array]:
    """Coupler points and coupler angles (continuous while assembled), by continuation; NaN where not assembled."""
    result = follow(design, np.atleast_1d(np.asarray(phi, dtype=float)), again=True)
    return result.p, result.angle


# --- where it assembles ----------------------------------------------------------------------------------------------------


def _lowest(function: Callable[[Array], Array], low: float, high: float, samples: int) -> tuple[float, float]:
    """Least value of a smooth function and where it is: the best samples, each refined by thirds."""
    x = np.linspace(low, high, samples + 1)
    y = function(x)
    inside = np.concatenate([[True], y[1:] <= y[:-1]]) & np.concatenate([y[:-1] <= y[1:], [True]])
    at = np.flatnonzero(inside)
    at = at[np.argsort(y[at])][:12]
    left, right = x[np.maximum(at - 1, 0)], x[np.minimum(at + 1, samples)]
    for _ in range(28):  # to 1e-7 rad and better: the value, flat there, to its rounding
        one, two = left + (right - left) / 3.0, right - (right - left) / 3.0
        values = function(np.concatenate([one, two]))
        lower = values[: len(at)] < values[len(at) :]
        left, right = np.where(lower, left, one), np.where(lower, two, right)
    x = np.concatenate([x[at], 0.5 * (left + right)])
    y = function(x)
    return float(np.min(y)), float(x[np.argmin(y)])


def least_sine(design: Design, low: float, high: float, samples: int = 1440) -> float:
    """Least closure sine over a range of crank angles, in size; negative where the linkage does not assemble."""
    least = _lowest(lambda phi: direct(design, phi).closure, low, high, samples)[0]
    return math.copysign(math.sqrt(abs(least)), least)


class Turning(NamedTuple):
    turns: bool
    margin: float  # least closure sine over the revolution, negative if it does not close

    def __bool__(self) -> bool:
        return self.turns


def turns_fully(design: Design, positions: int = 720) -> Turning:
    """Whether the crank turns fully on one circuit: the loop closes everywhere, and followed it comes back where it was."""
    margin = least_sine(design, 0.0, TURN, 2 * positions)
    if margin < MEETING:
        return Turning(False, margin)
    result = follow(design, np.linspace(0.0, TURN, positions + 1))
    back = result.reached and abs(result.p[-1] - result.p[0]) < SAME * size(design)
    return Turning(bool(back and np.all(result.sine * design["mode"] > 0.0)), margin)


def assembled(design: Design, samples: int = 1440) -> list[tuple[float, float]]:
    """Ranges of crank angles over which the linkage assembles; (0, 2 pi) if over all, else they begin in [0, 2 pi)."""
    worst, at_worst = _lowest(lambda phi: direct(design, phi).closure, 0.0, TURN, samples)
    if worst >= MEETING**2:
        return [(0.0, TURN)]
    at_best = _lowest(lambda phi: -direct(design, phi).closure, 0.0, TURN, samples)[1]
    phi = np.unique(np.mod(np.append(np.arange(samples) * (TURN / samples), [at_worst, at_best]), TURN))
    closes, following = direct(design, phi).closure > 0.0, np.append(phi[1:], phi[0] + TURN)
    if np.all(closes):
        return [(at_worst % TURN, at_worst % TURN + TURN)]
    edges: list[tuple[float, bool]] = []
    for k in np.flatnonzero(closes != np.roll(closes, -1)):
        left, right = phi[k], following[k]
        for _ in range(60):
            middle = 0.5 * (left + right)
            same = bool(direct(design, [middle]).closure[0] > 0.0) == bool(closes[k])
            left, right = (middle, right) if same else (left, middle)
        edges.append((float(left if closes[k] else right), not closes[k]))  # on the side that assembles
    begins = [at for at, opens in edges if opens]
    ends = [at for at, opens in edges if not opens]
    return [(low, min((e if e > low else e + TURN) for e in ends)) for low in begins]


# --- feet of perpendiculars ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Goal:
    """Places, and angles with a weight (length per rad) if they count; one row each."""

    places: Complex
    angles: Array
    weight: float = 0.0

    def take(self, rows: NDArray[np.intp]) -> _Goal:
        return _Goal(self.places[rows], self.angles[rows], self.weight)

    def square(self, at: Position) -> Array:
        computed = np.abs(at.p - self.places) ** 2
        if self.weight:
            computed = computed + (self.weight * wrapped(at.angle - self.angles)) ** 2
        return np.where(np.isfinite(computed), computed, np.inf)

    def slope(self, at: Position, mode: float) -> Array:
        """Half the derivative of the square by phi, times the size of `bottom`: finite where the modes meet."""
        error = at.p - self.places
        computed = np.abs(at.bottom) * (error.conj() * at.b_rate).real + mode * at.top * (error.conj() * 1j * (at.p - at.b)).real
        if self.weight:
            computed = computed + mode * at.top * self.weight**2 * wrapped(at.angle - self.angles)
        return computed


def _feet(design: Design, goal: _Goal, low: Array, high: Array, samples: int) -> tuple[Array, Array]:
    """Least distance of each goal over its own range of crank angles, and where; infinite for an empty range."""
    mode = design["mode"]
    middle, half = 0.5 * (low + high), 0.5 * (high - low)  # phi = middle - half cos tau: smooth at the ends of a circuit too
    tau = np.linspace(0.0, math.pi, samples + 1)
    at = direct(design, middle[:, None] - half[:, None] * np.cos(tau))
    spread = _Goal(goal.places[:, None], goal.angles[:, None], goal.weight)
    value, slope = spread.square(at), spread.slope(at, mode)
    row, k = np.nonzero((slope[:, :-1] <= 0.0) & (slope[:, 1:] > 0.0))
    left, right, own = tau[k], tau[k + 1], goal.take(row)
    for _ in range(56):
        mid = 0.5 * (left + right)
        down = own.slope(direct(design, middle[row] - half[row] * np.cos(mid)), mode) <= 0.0
        left, right = np.where(down, mid, left), np.where(down, right, mid)
    phi = middle[row] - half[row] * np.cos(0.5 * (left + right))
    computed = own.square(direct(design, phi))
    best = np.argmin(value, axis=1)
    every = np.arange(len(low))
    least, where = value[every, best], middle - half * np.cos(tau[best])
    order = np.argsort(-computed, kind="stable")  # the least of a row is written last
    order = order[computed[order] < least[row[order]]]
    least[row[order]], where[row[order]] = computed[order], phi[order]
    return np.where(high >= low, np.sqrt(least), np.inf), where


def distance_to_curve(points: object, design: Design, samples: int = 1440) -> tuple[Array, Array]:
    """Least distance of each point to the whole curve of the design's mode, and the crank angle there, in [0, 2 pi).

    At the very ends of the curve of a crank that does not turn, where the modes meet, to about 1e-8 of the size; else to 1e-12.
    """
    places = complex_points(points)
    goal = _Goal(places, np.zeros(len(places)))
    least, where = np.full(len(places), np.inf), np.full(len(places), np.nan)
    for low, high in assembled(design, samples):
        more = 0.01 if high - low == TURN else 0.0
        ends = np.full(len(places), low - more), np.full(len(places), high + more)
        computed, phi = _feet(design, goal, *ends, samples)
        where, least = np.where(computed < least, phi, where), np.minimum(computed, least)
    return least, where % TURN


# --- judges ----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Report:
    """What a claimed answer is worth. Lengths, and rad for angles and for all errors of a function."""

    errors: Array  # at the claimed crank angles; infinite where the linkage does not assemble
    order_ok: bool  # crank angles strictly in the wanted order, within one revolution (True if no order is required)
    branch_ok: bool  # closure sine of one sign where needed, and no point met by the other mode only
    circuit_ok: bool  # the crank reaches each position from the first, rotating, without a jump
    turns: bool
    rotation: int  # +1 or -1: how the crank passes the points; 0: not in order
    margin: float  # least closure sine over the crank angles needed
    turn_margin: float  # over the whole revolution
    modes: Array  # which mode is nearer to each wanted point at its crank angle
    angle_errors: Array = field(default_factory=lambda: np.zeros(0))  # of a motion, signed
    nearest: Array = field(default_factory=lambda: np.zeros(0))  # least distance between the neighbours' crank angles
    foot: Array = field(default_factory=lambda: np.zeros(0))  # crank angle there
    local: Array = field(default_factory=lambda: np.zeros(0))  # distance of the foot reached downhill from the claimed angle
    tangential: Array = field(default_factory=lambda: np.zeros(0))  # part of the error along the curve: 0 at a foot
    timing: float = 0.0  # largest deviation of the crank angles from the prescribed ones, apart from the common start
    start: float = 0.0  # common start angle of a timed path
    mark: float = 0.0  # constant angle of a motion, from the coupler's angle to the body's
    weight: float = 0.0  # of the angle of a motion in nearest, local and tangential (length per rad)
    other_sse: float = math.inf  # of the other mode

    @property
    def sse(self) -> float:
        return float(np.sum(self.errors**2))

    @property
    def rms(self) -> float:
        return math.sqrt(float(np.mean(self.errors**2)))

    @property
    def largest(self) -> float:
        return float(np.max(np.abs(self.errors)))

    @property
    def largest_angle(self) -> float:
        return float(np.max(np.abs(self.angle_errors), initial=0.0))

    @property
    def gain(self) -> float:
        """By how much one point's distance could still fall without disturbing the order: 0 if every claimed angle is a foot."""
        if not self.nearest.size:
            return 0.0  # of a function: nothing is free
        claimed = self.errors if not self.weight else np.hypot(self.errors, self.weight * self.angle_errors)
        return float(np.max(claimed - self.nearest, initial=0.0)) if np.all(np.isfinite(claimed)) else math.inf

    @property
    def free(self) -> bool:
        """Of defects of order, branch and circuit, with a crank that turns fully."""
        return self.order_ok and self.branch_ok and self.circuit_ok and self.turns


def judge_path(
    design: Design,
    expected: object,
    crank_angles: Values,
    *,
    closed: bool = False,
    timed: Values | None = None,
    order: bool = True,
) -> Report:
    """Wanted points (rows x, y) at claimed crank angles; `timed`: the prescribed ones, up to a common start angle."""
    places = complex_points(expected)
    return _judge(design, _Goal(places, np.zeros(len(places))), crank_angles, closed=closed, timed=timed, order=order)


def judge_motion(
    design: Design,
    poses: object,
    crank_angles: Values,
    mark: float | None = 0.0,
    *,
    weight: float = 0.0,
    closed: bool = False,
    timed: Values | None = None,
    order: bool = True,
) -> Report:
    """Wanted poses (rows x, y, angle) of a body at the coupler's angle + mark (None: the best constant).

    `errors` are distances; `weight` (length per rad) lets the angle count in `nearest`, `local` and `tangential`, which then
    are to be compared with sqrt(errors^2 + (weight angle_errors)^2).
    """
    rows = np.atleast_2d(np.asarray(poses, dtype=float))
    if mark is None:
        ahead = rows[:, 2] - direct(design, crank_angles).angle
        mark = float(np.angle(np.nanmean(np.exp(1j * ahead)))) if np.any(np.isfinite(ahead)) else 0.0
    goal = _Goal(rows[:, 0] + 1j * rows[:, 1], rows[:, 2] - mark, weight)
    return _judge(design, goal, crank_angles, closed=closed, timed=timed, order=order, mark=mark)


def judge_function(design: Design, phi0: float, psi0: float, phi_offsets: Values, psi_offsets: Values) -> Report:
    """Output at phi0 + offsets against psi0 + offsets: rocker angle from the frame's direction, or place of the slider."""
    offsets, aims = np.asarray(phi_offsets, dtype=float), psi0 + np.asarray(psi_offsets, dtype=float)
    phi = phi0 + offsets
    low, high = float(np.min(phi)), float(np.max(phi))
    errors, others = (_output_errors(d, phi, aims) for d in (design, {**design, "mode": -design["mode"]}))
    scale = size(design) if sliding(design) else 1.0
    margin = least_sine(design, low, high)
    path = np.concatenate([np.sort(phi), np.linspace(high, low, 181)])
    turning = turns_fully(design)
    return Report(
        errors=errors,
        order_ok=bool(high - low <= TURN),
        branch_ok=margin >= MEETING and not np.any(_only(np.abs(others), np.abs(errors), scale)),
        circuit_ok=_agree(design, path),
        turns=turning.turns,
        rotation=1 if phi[-1] >= phi[0] else -1,
        margin=margin,
        turn_margin=turning.margin,
        modes=np.where(np.abs(others) < np.abs(errors), -design["mode"], design["mode"]),
        other_sse=float(np.sum(others**2)),
    )


def _output_errors(design: Design, phi: Array, aims: Array) -> Array:
    computed: Array = direct(design, phi).output - aims
    return np.where(np.isfinite(computed), computed if sliding(design) else wrapped(computed), np.inf)


def _only(others: Array, errors: Array, scale: float) -> Flags:
    """Met by the other mode, missed by the own: no coincidence."""
    return (errors > 1e-6 * scale) & (others < 1e-3 * errors)


def _agree(design: Design, path: Array) -> bool:
    """Whether the continuation reaches all of a path of crank angles, and is where the quadratic is."""
    result, at = follow(design, path), direct(design, path)
    return result.reached and bool(np.all(np.abs(result.p - at.p) < SAME * size(design))) and bool(np.all(at.closure > 0.0))


def passage(crank_angles: Values) -> tuple[int, Array]:
    """How the crank passes the angles in their order within one revolution: +1 or -1, or 0 if it does not; and its rotations."""
    phi = np.asarray(crank_angles, dtype=float)
    result: list[tuple[float, int, Array]] = []
    for sign in (1, -1):
        by = np.mod(sign * np.diff(phi), TURN)
        total = float(np.sum(by))
        if np.all((by > EQUAL) & (by < TURN - EQUAL)) and total <= TURN + EQUAL:
            result.append((total, sign, np.concatenate([[0.0], np.cumsum(by)])))
    if not result:
        return 0, np.zeros(len(phi))
    _, sign, rotation = min(result, key=lambda each: each[:2])
    return (1 if len(phi) == 1 else sign), rotation


def _needed(phi: Array, rotation: int, turned: Array) -> Array:
    """Crank angles in the order in which the crank must reach them: the wanted order, or the shortest arc over all."""
    if rotation:
        return phi[0] + rotation * turned
    ring = np.sort(np.mod(phi, TURN))
    gaps = np.diff(np.concatenate([ring, ring[:1] + TURN]))
    first = (int(np.argmax(gaps)) + 1) % len(ring)
    return np.concatenate([ring[first:], ring[:first] + TURN])


def _judge(
    design: Design,
    goal: _Goal,
    crank_angles: Values,
    *,
    closed: bool,
    timed: Values | None,
    order: bool,
    mark: float = 0.0,
) -> Report:
    phi = np.asarray(crank_angles, dtype=float)
    if phi.shape != goal.places.shape:
        raise ValueError(f"{len(goal.places)} wanted, {phi.size} crank angles")
    at, other = direct(design, phi), direct({**design, "mode": -design["mode"]}, phi)
    plain = _Goal(goal.places, goal.angles)
    errors, others = np.sqrt(plain.square(at)), np.sqrt(plain.square(other))
    rotation, turned = passage(phi)
    if turned[-1] >= TURN - EQUAL and abs(goal.places[-1] - goal.places[0]) > SAME * size(design):
        rotation = 0  # only a point that is wanted again may be met at the first crank angle again
    turning = turns_fully(design)
    path = _needed(phi, rotation, turned)
    low, high = float(np.min(path)), float(np.max(path))
    whole = closed or turning.turns
    margin = turning.margin if whole else least_sine(design, low, high)
    if closed:
        path = np.concatenate([path, [path[0] + math.copysign(TURN, rotation or 1)]])
    circuit = _circuit(design, phi)
    local, tangential = _downhill(design, goal, phi, circuit)
    nearest, foot = _between(design, goal, phi, circuit, rotation, turned)
    timing, start = _timing(phi, timed)
    return Report(
        errors=errors,
        order_ok=rotation != 0 or not order,
        branch_ok=margin >= MEETING and not np.any(_only(others, errors, size(design))),
        circuit_ok=_agree(design, path),
        turns=turning.turns,
        rotation=rotation,
        margin=margin,
        turn_margin=turning.margin,
        modes=np.where(others < errors, -design["mode"], design["mode"]),
        angle_errors=wrapped(at.angle - goal.angles),
        nearest=nearest,
        foot=foot,
        local=local,
        tangential=tangential,
        timing=timing,
        start=start,
        mark=mark,
        weight=goal.weight,
        other_sse=float(np.sum(others**2)),
    )


def _timing(phi: Array, timed: Values | None) -> tuple[float, float]:
    """Largest deviation from the prescribed angles, and the common start angle."""
    if timed is None:
        return 0.0, 0.0
    ahead = phi - np.asarray(timed, dtype=float)
    start = float(np.angle(np.mean(np.exp(1j * ahead))))
    return float(np.max(np.abs(wrapped(ahead - start)))), start


def _circuit(design: Design, phi: Array) -> tuple[Array, Array]:
    """Range of crank angles of the circuit that each angle is on, about that angle; empty where it does not assemble."""
    low, high = np.full(len(phi), np.inf), np.full(len(phi), -np.inf)
    for begin, end in assembled(design):
        if end - begin == TURN:
            return phi - math.pi, phi + math.pi
        shift = phi - begin - np.mod(phi - begin, TURN)
        inside = phi <= end + shift
        low, high = np.where(inside, begin + shift, low), np.where(inside, end + shift, high)
    return low, high


def _between(
    design: Design, goal: _Goal, phi: Array, circuit: tuple[Array, Array], rotation: int, turned: Array
) -> tuple[Array, Array]:
    """Least distance of each wanted to the curve between the crank angles of its neighbours, on the circuit that it is on."""
    low, high = circuit
    if rotation and len(phi) > 1:
        ring = turned if turned[-1] < TURN - EQUAL else turned[:-1]  # a repeated first point has the neighbours of the first
        gaps = np.diff(np.concatenate([ring, ring[:1] + TURN]))
        after = np.resize(gaps, len(phi))
        before = np.resize(np.roll(gaps, 1), len(phi))
        back, ahead = (before, after) if rotation > 0 else (after, before)
        low, high = np.maximum(low, phi - back), np.minimum(high, phi + ahead)
    return _solved(design, goal, low, high, 180)


def _solved(design: Design, goal: _Goal, low: Array, high: Array, samples: int) -> tuple[Array, Array]:
    """Feet for the ranges that are not empty."""
    there = np.flatnonzero(high >= low)
    least, where = np.full(len(low), np.inf), np.full(len(low), np.nan)
    if there.size:
        least[there], where[there] = _feet(design, goal.take(there), low[there], high[there], samples)
    return least, where


def _downhill(design: Design, goal: _Goal, phi: Array, circuit: tuple[Array, Array]) -> tuple[Array, Array]:
    """Distance of the foot that is reached downhill from each angle, and the part of the error along the curve."""
    at, mode = direct(design, phi), design["mode"]
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = at.top / at.bottom
        speed = np.sqrt(np.abs(at.b_rate + 1j * rate * (at.p - at.b)) ** 2 + (goal.weight * rate) ** 2)
        tangential = goal.slope(at, mode) / np.abs(at.bottom) / speed
    low, high = circuit
    least, there = np.sqrt(goal.square(at)), np.flatnonzero(np.isfinite(tangential) & (high >= low))
    if not there.size:
        return least, tangential
    sign, begin = np.where(tangential[there] > 0.0, -1.0, 1.0), phi[there]
    end = np.where(sign > 0.0, high[there], low[there])
    own, steps = goal.take(there), begin[:, None] + (end - begin)[:, None] * np.linspace(0.0, 1.0, 721)
    spread = _Goal(own.places[:, None], own.angles[:, None], own.weight)
    up = sign[:, None] * spread.slope(direct(design, steps), mode)[:, 1:] > 0.0
    k = np.where(np.any(up, axis=1), np.argmax(up, axis=1), 719)  # the first step that is past the foot, or the last
    every = np.arange(len(there))
    since, past = steps[every, k], steps[every, k + 1]
    least[there] = np.minimum(least[there], _feet(design, own, np.minimum(since, past), np.maximum(since, past), 4)[0])
    return least, tangential


# --- random tasks ----------------------------------------------------------------------------------------------------------


def _somewhere(rng: np.random.Generator) -> dict[str, float]:
    """Placement, coupler point and mode."""
    x, y = rng.uniform(-200.0, 200.0, 2).tolist()
    along, across = rng.uniform(-150.0, 150.0, 2).tolist()
    direction, mode = rng.uniform(-math.pi, math.pi), int(rng.choice([-1, 1]))
    return {"x": x, "y": y, "direction": direction, "along": along, "across": across, "mode": mode}


def _even(rng: np.random.Generator, low: float, high: float) -> float:
    """Evenly spread in its logarithm."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _bars(
    rng: np.random.Generator, least: float, kinds: Callable[[float, float, float], tuple[float, float] | None]
) -> dict[str, float]:
    while True:
        bars = _even(rng, 5.0, 500.0), _even(rng, 10.0, 500.0), _even(rng, 10.0, 500.0)
        sums = kinds(*bars)
        if sums is None or max(*bars, 100.0) > 20.0 * min(*bars, 100.0) or sums[0] > 0.98 * sums[1]:
            continue
        design = four_bar(100.0, *bars, **_somewhere(rng))
        if np.min(direct(design, np.linspace(0.0, TURN, 25)).closure) < math.sin(least) ** 2:
            continue
        if least_sine(design, 0.0, TURN, 360) >= math.sin(least):
            return design


def random_crank_rocker(rng: np.random.Generator, least: float = math.radians(15.0)) -> dict[str, float]:
    """Crank shortest by 2 % and more, Grashof by 2 %, transmission angle in [least, pi - least], frame 100."""

    def kinds(crank: float, coupler: float, rocker: float) -> tuple[float, float] | None:
        others = sorted((100.0, coupler, rocker))
        return None if crank > 0.98 * others[0] else (crank + others[2], others[0] + others[1])

    return _bars(rng, least, kinds)


def random_double_crank(rng: np.random.Generator, least: float = math.radians(15.0)) -> dict[str, float]:
    """Frame shortest by 2 % and more, Grashof by 2 %, transmission angle in [least, pi - least], frame 100."""

    def kinds(crank: float, coupler: float, rocker: float) -> tuple[float, float] | None:
        others = sorted((crank, coupler, rocker))
        return None if others[0] < 100.0 / 0.98 else (100.0 + others[2], others[0] + others[1])

    return _bars(rng, least, kinds)


def random_slider_crank(rng: np.random.Generator, least: float = math.radians(15.0)) -> dict[str, float]:
    """Crank turns fully; coupler to the guide's normal at `least` or more; crank 5 to 100, coupler up to 20 cranks."""
    crank = _even(rng, 5.0, 100.0)
    gap = crank * rng.uniform(-1.0, 1.0)  # of the guide from A
    coupler = min((crank + abs(gap)) / math.cos(least) * _even(rng, 1.0, 6.0), 20.0 * crank)
    place = _somewhere(rng)
    guide = rng.uniform(-200.0, 200.0, 2).tolist()
    u = cmath.exp(1j * place["direction"])
    offset = gap + ((complex(place["x"], place["y"]) - complex(*guide)) * u.conjugate()).imag
    return slider_crank(crank, coupler, guide=(guide[0], guide[1]), offset=offset, **place)


def random_angles(rng: np.random.Generator, n: int, span: float = TURN) -> Array:
    """Crank angles in increasing order within a span, nowhere nearer than a fifth of the mean distance."""
    gaps = 0.2 + 0.8 * rng.dirichlet(np.ones(n)) * n
    return rng.uniform(0.0, TURN) + np.cumsum(gaps) * span / n


def random_points(rng: np.random.Generator, n: int) -> Array:
    """Rows (x, y) in a square of 200, in no order."""
    return rng.uniform(-100.0, 100.0, (n, 2))


def random_closed_curve(rng: np.random.Generator, n: int) -> Array:
    """Rows (x, y) along a smooth closed curve of three harmonics, the first point not repeated."""
    t = TURN * np.arange(n) / n
    computed = complex(*rng.uniform(-100.0, 100.0, 2)) + np.zeros(n, dtype=complex)
    for k in (1, -1, 2, -2, 3, -3):
        computed += 60.0 / k**2 * complex(*rng.normal(size=2)) * np.exp(1j * k * t)
    return rows_of(computed)


def random_poses(rng: np.random.Generator, n: int) -> Array:
    """Rows (x, y, angle) in a square of 200, angles within a right angle either way, in no order."""
    return np.column_stack([random_points(rng, n), rng.uniform(-0.5 * math.pi, 0.5 * math.pi, n)])


@dataclass(frozen=True)
class Law:
    """y(x): text, range of x, ranges (rad) onto which x and y are mapped linearly; the extremes of y bound its range."""

    name: str
    expression: str
    value: Callable[[Array], Array]
    low: float
    high: float
    input_range: float
    output_range: float
    monotone: bool

    def extremes(self) -> tuple[float, float]:
        below = _lowest(self.value, self.low, self.high, 720)[0]
        above = -_lowest(lambda x: -self.value(x), self.low, self.high, 720)[0]
        return below, above

    def offsets(self, n: int) -> tuple[Array, Array]:
        """Crank angles from phi0 (at x low) and output angles from psi0 (at the least y), at n even x."""
        x = np.linspace(self.low, self.high, n)
        below, above = self.extremes()
        return self.input_range * np.linspace(0.0, 1.0, n), self.output_range * (self.value(x) - below) / (above - below)


def random_law(rng: np.random.Generator, monotone: bool | None = None) -> Law:
    """A smooth function; monotone, not monotone, or (None) either."""
    forms = [each for each in _laws(rng) if monotone is None or each[-1] == monotone]
    name, text, value, low, high, rises = forms[int(rng.integers(len(forms)))]
    ranges = np.radians(np.round(rng.uniform([40.0, 30.0], [100.0, 90.0]), 1))
    return Law(name, text, value, low, high, float(ranges[0]), float(ranges[1]), rises)


def _laws(rng: np.random.Generator) -> Iterator[tuple[str, str, Callable[[Array], Array], float, float, bool]]:
    def number(low: float, high: float) -> float:
        return float(np.round(rng.uniform(low, high), 3))

    power, rate, bend, wave = number(0.4, 2.6), number(0.3, 1.5), number(0.2, 2.0), number(0.05, 0.6)
    tilt, fall, peak = number(0.3, 0.7), number(0.5, 1.5), number(1.8, 2.6)
    yield "power", f"x^{power}", lambda x: x**power, 1.0, 2.0, True
    yield "exponential", f"exp({rate}*x)", lambda x: np.exp(rate * x), 0.0, 1.0, True
    yield "decay", f"exp(-{fall}*x)", lambda x: np.exp(-fall * x), 0.0, 1.0, True
    yield "logarithm", "log(x)", np.log, 1.0, 1.0 + bend, True
    yield "log10", "log10(x)", np.log10, 1.0, 2.0, True
    yield "sine", "sin(x)", np.sin, 0.0, 0.5 * math.pi, True
    yield "tangent", f"tan({tilt}*x)", lambda x: np.tan(tilt * x), 0.0, 1.0, True
    yield "hyperbola", f"1/(1 + {bend}*x)", lambda x: 1.0 / (1.0 + bend * x), 0.0, 1.0, True
    yield "root", f"sqrt(x + {tilt})", lambda x: np.sqrt(x + tilt), 0.0, 1.0, True
    yield "wave on a line", f"x + {wave}*sin(x)", lambda x: x + wave * np.sin(x), 0.0, 3.0, True
    yield "half wave", "sin(x)", np.sin, 0.0, math.pi, False
    yield "parabola", f"x*({fall} - x)", lambda x: x * (fall - x), 0.0, round(0.8 * fall, 3), False
    yield "cosine past its turn", f"cos({peak}*x)", lambda x: np.cos(peak * x), 0.0, 2.0, False
    yield "rise and decay", f"x*exp(-{peak}*x)", lambda x: x * np.exp(-peak * x), 0.0, 1.0, False
    yield "dip", f"{tilt}*x^3 - x", lambda x: tilt * x**3 - x, 0.0, 1.6, False


def planted_path(design: Design, crank_angles: Values) -> Array:
    """Rows (x, y) that the design itself passes."""
    return rows_of(direct(design, crank_angles).p)


def planted_poses(design: Design, crank_angles: Values, mark: float = 0.0) -> Array:
    """Rows (x, y, angle) that the design itself passes."""
    at = direct(design, crank_angles)
    return np.column_stack([rows_of(at.p), wrapped(at.angle + mark)])


def planted_outputs(design: Design, crank_angles: Iterable[float]) -> Array:
    """Rocker angles, continuous, or places of the slider that the design itself has."""
    computed = direct(design, np.fromiter(crank_angles, dtype=float)).output
    return computed if sliding(design) else np.unwrap(computed)
