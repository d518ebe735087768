"""Planar machines with clearance in their revolute joints, by Newton and Euler in the bodies' coordinates; nothing of optlink.

Every body has the three coordinates of its centroid, (x, y, angle); pins without clearance, the slider's guide and the drive are
constraints with multipliers, solved with the accelerations and kept by Baumgarte's terms. A pin with clearance is a contact
force. Dormand and Prince's method of order 8 runs from switch to switch: contact begins, contact ends, the normal force reaches
zero.

    found = run(slider_crank({"C": Gap("rod")}, speed=5000.0 * np.pi / 30.0), t_end=2.4e-2)
    found.contacts[0].begin, found.contacts[0].depth, found.position["slider"][:, 0], found.residual
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853
from scipy.linalg.lapack import dgesv
from scipy.optimize import brentq

Array = NDArray[np.float64]
Values = Sequence[float] | Array
Point = tuple[float, float]

FRAME = "frame"
SLOWEST = 1e-3  # m/s, least approach speed at which a contact is taken to begin
RESTORING = 1000.0  # 1/s, of Baumgarte's terms
DAMPING: dict[str, Callable[[float], float]] = {
    "hertz": lambda e: 0.0,
    "hunt-crossley": lambda e: 1.5 * (1.0 - e),
    "lankarani-nikravesh": lambda e: 0.75 * (1.0 - e * e),
    "flores": lambda e: 1.6 * (1.0 - e) / e,
}


# --- what is simulated ---------------------------------------------------------------------------------------------


def stiffness(bearing: float, journal: float, modulus: float, poisson: float) -> float:
    """Of a journal in a bearing of the same material [N/m^1.5]."""
    return 2.0 * modulus / (3.0 * (1.0 - poisson**2)) * math.sqrt(bearing * journal / (bearing - journal))


STEEL = stiffness(10e-3, 9.5e-3, 207e9, 0.3)


@dataclass(frozen=True)
class Gap:
    """Clearance of a pin; SI throughout. `journal` is the body that has the journal, the pin's other body has the bearing."""

    journal: str
    clearance: float = 0.5e-3
    radius: float = 9.5e-3  # of the journal
    stiffness: float = STEEL
    restitution: float = 0.9
    friction: float = 0.0
    width: float = 0.01  # slip over which friction changes its sign
    viscous: float = 0.0  # N s/m, tangential, while there is a normal force
    law: str = "lankarani-nikravesh"


@dataclass(frozen=True)
class Body:
    """Mass, moment of inertia about the centroid, and where the pins are in axes through the centroid."""

    mass: float
    moment: float
    points: Mapping[str, Point]


@dataclass(frozen=True)
class Setup:
    """Bodies, pins (two bodies each), slider on a guide along x, driven body; `guess` of the positions at the start."""

    bodies: Mapping[str, Body]
    pins: Mapping[str, tuple[str, str]]
    frame: Mapping[str, Point]  # the frame's pins
    gaps: Mapping[str, Gap]
    driven: str
    start: float  # rad
    speed: float  # rad/s, held if there is no torque
    torque: float | None
    gravity: Point
    guess: Mapping[str, tuple[float, float, float]]
    slider: str | None = None
    height: float = 0.0  # of the guide


def slider_crank(
    gaps: Mapping[str, Gap],
    *,
    speed: float,
    start: float = 0.0,
    torque: float | None = None,
    gravity: Point = (0.0, -9.81),
    crank: float = 0.05,
    rod: float = 0.12,
    height: float = 0.0,
    crank_inertia: tuple[float, float] = (0.30, 1e-4),
    rod_inertia: tuple[float, float] = (0.21, 2.5e-4),
    slider_mass: float = 0.14,
    crank_centroid: float = 0.5,
    rod_centroid: float = 0.5,
) -> Setup:
    """Pins A (frame, crank), B (crank, rod), C (rod, slider); centroids as shares of the lengths."""
    bodies = {
        "crank": bar(crank, crank_inertia, crank_centroid, "A", "B"),
        "rod": bar(rod, rod_inertia, rod_centroid, "B", "C"),
        "slider": Body(slider_mass, 1.0, {"C": (0.0, 0.0)}),  # its moment of inertia is of no account: it does not turn
    }
    bx, by = crank * math.cos(start), crank * math.sin(start)
    angle = math.asin((height - by) / rod)
    guess = {
        "crank": (crank_centroid * bx, crank_centroid * by, start),
        "rod": (bx + rod_centroid * rod * math.cos(angle), by + rod_centroid * rod * math.sin(angle), angle),
        "slider": (bx + rod * math.cos(angle), height, 0.0),
    }
    pins = {"A": (FRAME, "crank"), "B": ("crank", "rod"), "C": ("rod", "slider")}
    frame = {"A": (0.0, 0.0)}
    return Setup(bodies, pins, frame, gaps, "crank", start, speed, torque, gravity, guess, "slider", height)


def four_bar(
    gaps: Mapping[str, Gap],
    *,
    speed: float,
    start: float = 0.0,
    torque: float | None = None,
    gravity: Point = (0.0, -9.81),
    lengths: tuple[float, float, float, float] = (0.05, 0.15, 0.10, 0.14),
    inertias: Sequence[tuple[float, float]] = ((0.30, 1e-4), (0.25, 5e-4), (0.20, 2e-4)),
    centroids: tuple[float, float, float] = (0.5, 0.5, 0.5),
    side: float = 1.0,
) -> Setup:
    """Pins A (frame, crank), B (crank, coupler), C (coupler, rocker), D (frame, rocker).

    `lengths` of crank, coupler, rocker, frame. `side` +1: C is to the left of the line from B to D. A bar's angle is that of the
    line from its pin nearer the frame's A (crank A to B, coupler B to C), the rocker's from D to C.
    """
    crank, coupler, rocker, base = lengths
    bodies = {
        "crank": bar(crank, inertias[0], centroids[0], "A", "B"),
        "coupler": bar(coupler, inertias[1], centroids[1], "B", "C"),
        "rocker": bar(rocker, inertias[2], centroids[2], "D", "C"),
    }
    bx, by = crank * math.cos(start), crank * math.sin(start)
    reach, towards = math.hypot(base - bx, by), math.atan2(-by, base - bx)
    within = math.acos((coupler**2 + reach**2 - rocker**2) / (2.0 * coupler * reach))
    angle = towards + side * within
    cx, cy = bx + coupler * math.cos(angle), by + coupler * math.sin(angle)
    swing = math.atan2(cy, cx - base)
    share = centroids
    guess = {
        "crank": (share[0] * bx, share[0] * by, start),
        "coupler": (bx + share[1] * (cx - bx), by + share[1] * (cy - by), angle),
        "rocker": (base + share[2] * (cx - base), share[2] * cy, swing),
    }
    pins = {"A": (FRAME, "crank"), "B": ("crank", "coupler"), "C": ("coupler", "rocker"), "D": (FRAME, "rocker")}
    return Setup(bodies, pins, {"A": (0.0, 0.0), "D": (base, 0.0)}, gaps, "crank", start, speed, torque, gravity, guess)


def bar(length: float, inertia: tuple[float, float], share: float, first: str, second: str) -> Body:
    return Body(*inertia, {first: (-share * length, 0.0), second: ((1.0 - share) * length, 0.0)})


# --- what is found -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Switch:
    """A contact begins (`into`) or ends; `rate` of the penetration there [m/s]."""

    time: float
    joint: str
    into: bool
    rate: float


@dataclass
class Contact:
    """One contact; `end` is infinite if it still lasts."""

    joint: str
    begin: float
    speed: float  # of the approach, not floored [m/s]
    depth: float = 0.0  # largest penetration
    deepest: float = math.nan  # when
    end: float = math.inf
    left: float = math.nan  # speed at which the bodies part


@dataclass
class Run:
    """Everything at the times `t`; work, loss and energies in J from the start on (`kinetic`, `elastic`, `potential`: values)."""

    t: Array
    position: dict[str, Array]  # body -> (times, 3)
    velocity: dict[str, Array]
    gap: dict[str, Array]  # joint with clearance -> e, from bearing centre to journal centre
    force: dict[str, Array]  # joint with clearance -> force on the body with the journal
    normal: dict[str, Array]
    moment: dict[str, Array]  # joint with clearance -> moment of that force about the journal's centre
    reaction: dict[str, Array]  # pin without clearance -> force on its second body
    torque: Array  # of the drive
    work: Array  # of the drive
    impact_loss: Array
    friction_loss: Array
    kinetic: Array
    elastic: Array
    potential: Array
    switches: list[Switch] = field(default_factory=list)
    contacts: list[Contact] = field(default_factory=list)
    drift: float = 0.0  # largest violation of a constraint, at the ends of the steps [m or rad]
    steps: int = 0

    @property
    def residual(self) -> Array:
        """What the account of energy lacks [J]."""
        energy = self.kinetic + self.elastic + self.potential
        return np.asarray(energy - energy[0] - (self.work - self.impact_loss - self.friction_loss))


# --- equations -----------------------------------------------------------------------------------------------------


@dataclass
class State:
    """Of one contact, between two switches."""

    touching: bool = False
    pushing: bool = False  # the normal force is not zero
    speed: float = SLOWEST


@dataclass(frozen=True)
class Touch:
    """What a joint with clearance has at an instant."""

    gap: Point
    depth: float  # negative: no contact
    rate: float
    slip: float
    normal: float
    elastic: float  # part of the normal force that is not lost
    force: Point  # on the journal
    tangential: float


@dataclass(frozen=True)
class Row:
    """State, contacts and forces of the constraints at an instant."""

    t: float
    y: Array
    touches: dict[str, Touch]
    multipliers: Array


class Equations:
    """Accelerations, contact forces and powers of a setup, all joints either ideal or with their gaps."""

    def __init__(self, setup: Setup, gaps: Mapping[str, Gap]) -> None:
        self.setup, self.gaps = setup, dict(gaps)
        self.names = list(setup.bodies)
        self.index = {name: 3 * k for k, name in enumerate(self.names)}
        self.size = 3 * len(self.names)
        self.masses: Array = np.array([part for body in setup.bodies.values() for part in (body.mass, body.mass, body.moment)])
        self.ideal = [name for name in setup.pins if name not in gaps]
        self.locks: list[tuple[int, float, float]] = []  # coordinate, value at the start, rate
        if setup.slider is not None:
            at = self.index[setup.slider]
            self.locks += [(at + 1, setup.height, 0.0), (at + 2, 0.0, 0.0)]
        self.drive = self.index[setup.driven] + 2
        if setup.torque is None:
            self.locks.append((self.drive, setup.start, setup.speed))
        self.rows = 2 * len(self.ideal) + len(self.locks)
        whole = np.zeros((self.size + self.rows, self.size + self.rows), order="F")
        whole[: self.size, : self.size] = np.diag(self.masses)
        for k, (coordinate, _, _) in enumerate(self.locks):
            row = self.size + 2 * len(self.ideal) + k
            whole[row, coordinate] = whole[coordinate, row] = 1.0
        self.whole = whole
        self.weight = np.zeros(self.size)
        self.weight[0::3] = self.masses[0::3] * setup.gravity[0]
        self.weight[1::3] = self.masses[1::3] * setup.gravity[1]
        if setup.torque is not None:
            self.weight[self.drive] += setup.torque
        self.shares = {name: DAMPING[gap.law](gap.restitution) for name, gap in gaps.items()}
        self.sides = {name: self._sides(name, gap) for name, gap in gaps.items()}

    def _sides(self, name: str, gap: Gap) -> tuple[int, Point, int, Point]:
        """Where the coordinates of the journal's and of the bearing's body are (-1: frame), with the points."""
        (bearing,) = set(self.setup.pins[name]) - {gap.journal}
        return (*self._at(gap.journal, name), *self._at(bearing, name))

    def _at(self, body: str, pin: str) -> tuple[int, Point]:
        if body == FRAME:
            return -1, self.setup.frame[pin]
        return self.index[body], self.setup.bodies[body].points[pin]

    @staticmethod
    def place(at: int, point: Point, q: Values, v: Values) -> tuple[float, float, float, float, float, float]:
        """Of a body's point: position, velocity, lever from the centroid."""
        if at < 0:
            return point[0], point[1], 0.0, 0.0, 0.0, 0.0
        c, s = math.cos(q[at + 2]), math.sin(q[at + 2])
        x, y, omega = c * point[0] - s * point[1], s * point[0] + c * point[1], v[at + 2]
        return q[at] + x, q[at + 1] + y, v[at] - omega * y, v[at + 1] + omega * x, x, y

    def depth(self, name: str, q: Values, v: Values) -> tuple[float, float]:
        """Penetration and its rate."""
        j, journal, b, bearing = self.sides[name]
        jx, jy, jvx, jvy, _, _ = self.place(j, journal, q, v)
        bx, by, bvx, bvy, _, _ = self.place(b, bearing, q, v)
        ex, ey = jx - bx, jy - by
        size = math.hypot(ex, ey)
        rate = ((jvx - bvx) * ex + (jvy - bvy) * ey) / size if size else math.hypot(jvx - bvx, jvy - bvy)
        return size - self.gaps[name].clearance, rate

    def touch(self, name: str, q: Values, v: Values, state: State, out: Array | None = None) -> Touch:
        """Contact force of a joint; adds it with its moments to `out`."""
        gap = self.gaps[name]
        j, journal, b, bearing = self.sides[name]
        jx, jy, jvx, jvy, jlx, jly = self.place(j, journal, q, v)
        bx, by, bvx, bvy, blx, bly = self.place(b, bearing, q, v)
        ex, ey = jx - bx, jy - by
        size = math.hypot(ex, ey)
        depth = size - gap.clearance
        if not state.touching or size == 0.0:
            return Touch((ex, ey), depth, 0.0, 0.0, 0.0, 0.0, (0.0, 0.0), 0.0)
        nx, ny = ex / size, ey / size
        # The material points that touch, at the journal's surface: journal centre + radius n.
        px, py = gap.radius * nx, gap.radius * ny
        turning = v[j + 2] if j >= 0 else 0.0
        bearing_turning = v[b + 2] if b >= 0 else 0.0
        ux = (jvx - turning * py) - (bvx - bearing_turning * (ey + py))
        uy = (jvy + turning * px) - (bvy + bearing_turning * (ex + px))
        rate = ux * nx + uy * ny
        slip = -ux * ny + uy * nx
        elastic = gap.stiffness * max(depth, 0.0) ** 1.5
        normal = elastic * (1.0 + self.shares[name] * rate / state.speed) if state.pushing else 0.0
        tangential = -gap.friction * normal * math.tanh(slip / gap.width) - (gap.viscous * slip if state.pushing else 0.0)
        fx, fy = -normal * nx - tangential * ny, -normal * ny + tangential * nx
        if out is not None:
            if j >= 0:
                out[j] += fx
                out[j + 1] += fy
                out[j + 2] += (jlx + px) * fy - (jly + py) * fx
            if b >= 0:
                out[b] -= fx
                out[b + 1] -= fy
                out[b + 2] -= (blx + ex + px) * fy - (bly + ey + py) * fx
        return Touch((ex, ey), depth, rate, slip, normal, elastic, (fx, fy), tangential)

    def constraints(self, t: float, q: Values, v: Values) -> tuple[Array, Array, Array, Array]:
        """Matrix of masses and Jacobian; violations and their rates; accelerations that go with the velocities."""
        whole, n = self.whole.copy(order="F"), self.size
        off, rate, quadratic = np.zeros(self.rows), np.zeros(self.rows), np.zeros(self.rows)
        for k, name in enumerate(self.ideal):
            row = 2 * k
            for body, sign in zip(self.setup.pins[name], (-1.0, 1.0), strict=True):
                at, point = self._at(body, name)
                x, y, vx, vy, lx, ly = self.place(at, point, q, v)
                off[row] += sign * x
                off[row + 1] += sign * y
                rate[row] += sign * vx
                rate[row + 1] += sign * vy
                if at < 0:
                    continue
                square = sign * v[at + 2] ** 2
                quadratic[row] += square * lx
                quadratic[row + 1] += square * ly
                r = n + row
                whole[r, at] = whole[at, r] = whole[r + 1, at + 1] = whole[at + 1, r + 1] = sign
                whole[r, at + 2] = whole[at + 2, r] = -sign * ly
                whole[r + 1, at + 2] = whole[at + 2, r + 1] = sign * lx
        row = 2 * len(self.ideal)
        for k, (coordinate, start, speed) in enumerate(self.locks, row):
            off[k], rate[k] = q[coordinate] - start - speed * t, v[coordinate] - speed
        return whole, off, rate, quadratic

    def solve(self, t: float, q: Values, v: Values, states: Mapping[str, State]) -> tuple[Array, Array, dict[str, Touch]]:
        """Accelerations; forces of the constraints (pins: on the second body; last the drive's torque); contacts."""
        n = self.size
        whole, off, rate, quadratic = self.constraints(t, q, v)
        right = np.empty(n + self.rows)
        right[:n] = self.weight
        touches = {name: self.touch(name, q, v, states[name], right) for name in self.gaps}
        right[n:] = quadratic - 2.0 * RESTORING * rate - RESTORING**2 * off
        _, _, computed, info = dgesv(whole, right, overwrite_a=1, overwrite_b=1)
        if info:
            raise ArithmeticError("the mechanism is at a singular position")
        return computed[:n], -computed[n:], touches

    def torque(self, multipliers: Array) -> float:
        return float(multipliers[-1]) if self.setup.torque is None else self.setup.torque

    def right_hand_side(self, states: Mapping[str, State]) -> Callable[[float, Array], Array]:
        """Rates of coordinates, velocities, drive work, loss by impacts, loss by friction."""
        n = self.size

        def rates(t: float, y: Array) -> Array:
            values = y.tolist()
            q, v = values[:n], values[n : 2 * n]
            result = np.empty(2 * n + 3)
            result[:n] = v
            acceleration, multipliers, touches = self.solve(t, q, v, states)
            result[n : 2 * n] = acceleration
            result[2 * n] = self.torque(multipliers) * v[self.drive]
            result[2 * n + 1] = sum(touch.rate * (touch.normal - touch.elastic) for touch in touches.values())
            result[2 * n + 2] = -sum(touch.tangential * touch.slip for touch in touches.values())
            return result

        return rates

    def begin(self) -> tuple[Array, Array]:
        """Positions and velocities of the mechanism, without clearance, at the start; by Newton's method from the guess."""
        n = self.size
        exact = Equations(replace(self.setup, torque=None), {})
        q = np.array([part for name in self.names for part in self.setup.guess[name]])
        zero = np.zeros(n)
        for _ in range(20):
            whole, off, _, _ = exact.constraints(0.0, q, zero)
            step = np.linalg.solve(whole[n:, :n], off)
            q = q - step
            if float(np.max(np.abs(step))) < 1e-15:
                break
        whole, _, rate, _ = exact.constraints(0.0, q, zero)
        return np.asarray(q), np.asarray(np.linalg.solve(whole[n:, :n], -rate))


# --- motion --------------------------------------------------------------------------------------------------------


def run(setup: Setup, t_end: float, t_eval: Iterable[float] | None = None, tolerance: float = 1e-12) -> Run:
    """Simulate from the positions and velocities of the mechanism without clearance on.

    Parameters
    ----------
    setup : Setup
    t_end : float [s]
    t_eval : times [s]
        When the motion is told, in order, none after `t_end`; 361 equal steps else.
    tolerance : float
        Relative; absolute of positions in m and rad a tenth of it, of velocities 100 times as large, of works in J as large.
    """
    equations = Equations(setup, setup.gaps)
    n, joints = equations.size, list(setup.gaps)
    times = np.linspace(0.0, t_end, 361) if t_eval is None else np.asarray(list(t_eval), dtype=float)
    absolute = tolerance * np.concatenate([np.full(n, 0.1), np.full(n, 100.0), np.ones(3)])
    longest = math.radians(1.0) / abs(setup.speed) if setup.speed else t_end / 360.0
    states = {name: State() for name in joints}
    lasting: dict[str, Contact] = {}
    switches: list[Switch] = []
    contacts: list[Contact] = []
    t, y = 0.0, np.concatenate([*equations.begin(), np.zeros(3)])
    rows = [_told(equations, t, y, states) for _ in range(int(np.sum(times <= 0.0)))]
    drift, steps = 0.0, 0

    def switch(name: str, kind: str) -> None:
        """Change what a joint does, at the present time."""
        rate = float(equations.depth(name, y[:n], y[n : 2 * n])[1])
        if kind == "in":
            lasting[name] = Contact(name, t, rate)
            contacts.append(lasting[name])
            states[name] = State(True, True, max(rate, SLOWEST))
        elif kind == "out":
            lasting[name].end, lasting[name].left = t, -rate
            states[name] = State()
        else:
            states[name] = State(True, kind == "push", states[name].speed)
        if kind in ("in", "out"):
            switches.append(Switch(t, name, kind == "in", rate))

    while t < t_end:
        rates = equations.right_hand_side(states)
        solver = DOP853(rates, t, y, t_end, max_step=longest, rtol=tolerance, atol=absolute)
        when = math.inf
        while solver.status == "running" and when == math.inf:
            message = solver.step()
            if solver.status == "failed":
                raise ArithmeticError(message)
            steps += 1
            step = _Step(equations, solver, n)
            computed = [(time, name, kind) for name in joints for time, kind in step.switches(name, states[name])]
            when, name, kind = min(computed, default=(math.inf, "", ""))
            t = min(when, solver.t)
            y = step.at(t)
            for joint in joints:
                if states[joint].touching:
                    step.deepen(lasting[joint], t)
            while len(rows) < len(times) and times[len(rows)] <= t:
                time = float(times[len(rows)])
                rows.append(_told(equations, time, step.at(time), states))
            _, off, _, _ = equations.constraints(t, y[:n], y[n : 2 * n])
            drift = max(drift, float(np.max(np.abs(off), initial=0.0)))
        if when < math.inf:
            switch(name, kind)
    columns = _gathered(equations, rows)
    columns.switches, columns.contacts, columns.drift, columns.steps = switches, contacts, drift, steps
    return columns


class _Step:
    """One step of the integrator: what happens in it. The interpolant is made only if it is asked for."""

    def __init__(self, equations: Equations, solver: DOP853, n: int) -> None:
        self.equations, self.solver, self.n = equations, solver, n
        self.interpolant: Callable[[float], Array] | None = None
        self.ends: tuple[float, float] = (solver.t_old, solver.t)

    def at(self, t: float) -> Array:
        if t in self.ends:
            return np.asarray(self.solver.y if t == self.solver.t else self.solver.y_old)
        if self.interpolant is None:
            self.interpolant = self.solver.dense_output()
        return self.interpolant(t)

    def depth(self, name: str, t: float) -> tuple[float, float]:
        y = self.at(t)
        return self.equations.depth(name, y[: self.n], y[self.n : 2 * self.n])

    def root(self, of: Callable[[float], float], first: float, last: float) -> float:
        """Where the interpolant passes zero; an end where rounding leaves no change of sign."""
        low, high = of(first), of(last)
        if low * high >= 0.0:
            return first if abs(low) < abs(high) else last
        return float(brentq(of, first, last, xtol=1e-18, rtol=1e-15))

    def turn(self, name: str) -> float | None:
        """When the penetration is extreme."""
        first, last = self.ends
        return (
            self.root(lambda t: self.depth(name, t)[1], first, last)
            if self.depth(name, first)[1] * self.depth(name, last)[1] < 0.0
            else None
        )

    def switches(self, name: str, state: State) -> list[tuple[float, str]]:
        """When contact begins or ends, the normal force comes to zero or returns."""
        first, last = self.ends
        (depth0, rate0), (depth1, rate1) = self.depth(name, first), self.depth(name, last)
        result = []
        sign, kind = (-1.0, "out") if state.touching else (1.0, "in")
        if sign * depth1 > 0.0:
            # After a switch the depth is zero up to rounding: what leaves there can return after its turn only.
            begin = self.turn(name) if sign * rate0 < 0.0 else first
            if begin is not None:
                result.append((self.root(lambda t: self.depth(name, t)[0], begin, last), kind))
        elif sign * rate0 > 0.0 and sign * rate1 < 0.0:
            turn = self.turn(name)
            if turn is not None and sign * self.depth(name, turn)[0] > 0.0 and sign * depth0 < 0.0:
                result.append((self.root(lambda t: self.depth(name, t)[0], first, turn), kind))
        if state.touching:
            result += self.kinks(name, state)
        return result

    def kinks(self, name: str, state: State) -> list[tuple[float, str]]:
        """When the normal force comes to zero within a contact, or returns."""
        first, last = self.ends
        share, sign = self.equations.shares[name], -1.0 if state.pushing else 1.0

        def beyond(t: float) -> float:
            return sign * (state.speed + share * self.depth(name, t)[1])

        if max(beyond(first), beyond(last)) < -state.speed:  # far from it
            return []
        times = [first + part * (last - first) for part in (0.0, 0.2, 0.4, 0.6, 0.8)] + [last]
        for before, after in itertools.pairwise(times):
            if beyond(after) > 0.0:
                return [(self.root(beyond, before, after), "slack" if state.pushing else "push")]
        return []

    def deepen(self, contact: Contact, last: float) -> None:
        """Greatest penetration of a contact, until `last`."""
        turn = self.turn(contact.joint)
        for time in (self.ends[0], last, *([turn] if turn is not None and turn < last else [])):
            depth = self.depth(contact.joint, time)[0]
            if depth > contact.depth:
                contact.depth, contact.deepest = depth, time


def _told(equations: Equations, t: float, y: Array, states: Mapping[str, State]) -> Row:
    n = equations.size
    _, multipliers, touches = equations.solve(t, y[:n].tolist(), y[n : 2 * n].tolist(), states)
    return Row(t, y.copy(), touches, multipliers)


def _gathered(equations: Equations, rows: Sequence[Row]) -> Run:
    """Arrays from the rows."""
    n, at, gravity = equations.size, equations.index, equations.setup.gravity
    y, multipliers = np.array([row.y for row in rows]), np.array([row.multipliers for row in rows])
    q, v = y[:, :n], y[:, n : 2 * n]

    def of_touch(what: Callable[[Touch, Gap], object]) -> dict[str, Array]:
        return {name: np.array([what(row.touches[name], gap) for row in rows]) for name, gap in equations.gaps.items()}

    # Without contact the elastic force is zero, so the energy of its depth, 2/5 F depth, is too.
    elastic = of_touch(lambda touch, gap: 0.4 * touch.elastic * touch.depth)
    return Run(
        t=np.array([row.t for row in rows]),
        position={name: q[:, at[name] : at[name] + 3] for name in equations.names},
        velocity={name: v[:, at[name] : at[name] + 3] for name in equations.names},
        gap=of_touch(lambda touch, gap: touch.gap),
        force=of_touch(lambda touch, gap: touch.force),
        normal=of_touch(lambda touch, gap: touch.normal),
        moment=of_touch(lambda touch, gap: gap.radius * touch.tangential),
        reaction={name: multipliers[:, 2 * k : 2 * k + 2] for k, name in enumerate(equations.ideal)},
        torque=np.array([equations.torque(row.multipliers) for row in rows]),
        work=y[:, 2 * n],
        impact_loss=y[:, 2 * n + 1],
        friction_loss=y[:, 2 * n + 2],
        kinetic=0.5 * (v**2 @ equations.masses),
        elastic=np.sum(np.array(list(elastic.values())), axis=0) if elastic else np.zeros(len(rows)),
        potential=-(q[:, 0::3] * gravity[0] + q[:, 1::3] * gravity[1]) @ equations.masses[0::3],
    )
