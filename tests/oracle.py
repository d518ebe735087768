"""Newton and Euler for a whole machine at once: every joint force, and the torque, from one linear system per position.

Nothing of the package's dynamics is used, no Assur groups, no jets. Of a mechanism only the data are read (who has which point,
which guide runs where); the positions are those where the loop equations hold, found by Newton's method from a guess, and the
velocities and accelerations follow from the Jacobian of the loop equations. Friction is settled by trying every combination of
signs of the normal forces.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from optlink.linkage.mechanism import FRAME, Guide, Mechanism

TINY = 1e-30


@dataclass(frozen=True)
class Mass:
    """Mass [kg], centroid in the body's axes [m], moment of inertia about the centroid [kg m^2]."""

    mass: float
    along: float
    across: float
    moment: float


@dataclass(frozen=True)
class External:
    """A force [N] at a point [m] of a body and a torque [N m] on it: (positions, 2), (positions, 2), (positions,)."""

    body: str
    point: np.ndarray
    force: np.ndarray
    torque: np.ndarray


@dataclass
class Solution:
    """What the joints exert: on every body at every pin, on the slider of every guide, by the driver on the crank."""

    torque: np.ndarray
    pins: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    normal: dict[str, np.ndarray] = field(default_factory=dict)
    friction: dict[str, np.ndarray] = field(default_factory=dict)
    moment: dict[str, np.ndarray] = field(default_factory=dict)
    consistent: np.ndarray | None = None  # how many combinations of signs of the normal forces contradict nothing


def left(v: np.ndarray) -> np.ndarray:
    """The vector turned by a right angle, counter-clockwise."""
    return np.stack([-v[..., 1], v[..., 0]], axis=-1)


def moment_of(lever: np.ndarray, force: np.ndarray) -> np.ndarray:
    return lever[..., 0] * force[..., 1] - lever[..., 1] * force[..., 0]


class Kinematics:
    """Coordinates x, y (of the start) and angle of every moving body with their rates, (positions, bodies, 3) each."""

    def __init__(
        self,
        mechanism: Mechanism,
        sizes: Mapping[str, float],
        crank_angle: np.ndarray,
        speed: np.ndarray | float,
        acceleration: np.ndarray | float,
        near: np.ndarray,
    ) -> None:
        self.mechanism, self.sizes = mechanism, sizes
        self.phi = np.asarray(crank_angle, dtype=float)
        self.omega = np.broadcast_to(np.asarray(speed, dtype=float), self.phi.shape)
        self.alpha = np.broadcast_to(np.asarray(acceleration, dtype=float), self.phi.shape)
        self.links = {link.body: link for link in mechanism.links}
        self.index = {body: k for k, body in enumerate(self.links)}
        self.guides: dict[str, Guide] = {guide.name: guide for guide in mechanism.guides}
        self.pins = self._pins()
        self.q = self._closed(np.array(near, dtype=float))
        jacobian = self.jacobian(self.q)
        driven = np.zeros(jacobian.shape[:2])
        driven[:, -1] = self.omega
        flat = np.linalg.solve(jacobian, driven[..., None])[..., 0]
        stepped = self.jacobian(self.q + 1j * TINY * flat.reshape(self.q.shape))  # J' along the motion
        bias = np.einsum("nij,nj->ni", stepped.imag / TINY, flat)
        driven[:, -1] = self.alpha
        self.rate = flat.reshape(self.q.shape)
        self.second = np.linalg.solve(jacobian, (driven - bias)[..., None])[..., 0].reshape(self.q.shape)

    # --- the data ------------------------------------------------------------------------------------------------

    def size(self, size: str | float) -> float:
        return float(self.sizes[size]) if isinstance(size, str) else float(size)

    def _pins(self) -> dict[str, list[str]]:
        owners: dict[str, list[str]] = {name: [FRAME] for name in self.mechanism.ground}
        for body, link in self.links.items():
            for name in filter(None, (link.start, link.end, *(p.name for p in self.mechanism.points if p.body == body))):
                owners.setdefault(name, []).append(body)
        return {name: bodies for name, bodies in owners.items() if len(bodies) > 1}

    def local(self, body: str, point: str) -> np.ndarray:
        """A point in the axes of a body."""
        if body == FRAME:
            return np.array([self.size(v) for v in self.mechanism.ground[point]])
        link = self.links[body]
        for own in self.mechanism.points:
            if (own.body, own.name) == (body, point):
                return np.array([self.size(own.along), self.size(own.across)])
        return np.array([self.size(link.length) if point == link.end else 0.0, 0.0])

    def rail(self, guide: Guide) -> tuple[np.ndarray, np.ndarray]:
        """A point and the unit vector of a guide's line in the axes of the body that carries it."""
        if isinstance(guide.through, str):
            through = self.local(guide.on, guide.through)
        else:
            through = np.array([self.size(v) for v in guide.through])
        angle = self.size(guide.direction)
        way = np.array([np.cos(angle), np.sin(angle)])
        return through + self.size(guide.offset) * left(way), way

    def runner(self, guide: Guide) -> np.ndarray:
        """The point of the slider that runs on the line, in the axes of the slider."""
        return self.local(guide.slider, guide.at or self.links[guide.slider].start)

    # --- the loop equations --------------------------------------------------------------------------------------

    def _turned(self, body: str, v: np.ndarray, q: np.ndarray) -> np.ndarray:
        if body == FRAME:
            return np.broadcast_to(v, (len(q), 2)).astype(q.dtype)
        angle = q[:, self.index[body], 2]
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([c * v[0] - s * v[1], s * v[0] + c * v[1]], axis=-1)

    def _at(self, body: str, v: np.ndarray, q: np.ndarray) -> np.ndarray:
        return self._turned(body, v, q) + (0.0 if body == FRAME else q[:, self.index[body], :2])

    def residual(self, q: np.ndarray) -> np.ndarray:
        """Pins apart, sliders off their line and turned against it, crank behind its angle: (positions, equations)."""
        rows = []
        for point, (first, *rest) in self.pins.items():
            for body in rest:
                apart = self._at(body, self.local(body, point), q) - self._at(first, self.local(first, point), q)
                rows += [apart[:, 0], apart[:, 1]]
        for guide in self.guides.values():
            begin, way = self.rail(guide)
            line = self._turned(guide.on, way, q)
            rows.append(moment_of(line, self._at(guide.slider, self.runner(guide), q) - self._at(guide.on, begin, q)))
            carried = 0.0 if guide.on == FRAME else q[:, self.index[guide.on], 2]
            turned = q[:, self.index[guide.slider], 2] - carried - self.size(guide.direction) - self.size(guide.tilt)
            rows.append(np.remainder(turned.real + np.pi, 2.0 * np.pi) - np.pi)
        behind = q[:, 0, 2].real - self.phi
        rows.append(np.remainder(behind + np.pi, 2.0 * np.pi) - np.pi)
        return np.stack(rows, axis=-1)

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Derivatives of the loop equations, (positions, equations, 3 bodies)."""
        rows: list[np.ndarray] = []

        def row() -> np.ndarray:
            rows.append(np.zeros(q.shape, dtype=q.dtype))
            return rows[-1]

        for point, (first, *rest) in self.pins.items():
            for body in rest:
                for k in (0, 1):
                    new = row()
                    for member, sign in ((body, 1.0), (first, -1.0)):
                        if member != FRAME:
                            i = self.index[member]
                            new[:, i, k] += sign
                            new[:, i, 2] += sign * left(self._turned(member, self.local(member, point), q))[:, k]
        for guide in self.guides.values():
            normal = left(self._turned(guide.on, self.rail(guide)[1], q))
            runner = self._turned(guide.slider, self.runner(guide), q)
            off, i = row(), self.index[guide.slider]
            off[:, i, :2] += normal
            off[:, i, 2] += np.sum(normal * left(runner), axis=-1)
            if guide.on != FRAME:  # the line turns about the start of the body that carries it
                k = self.index[guide.on]
                lever = self._at(guide.slider, self.runner(guide), q) - q[:, k, :2]
                off[:, k, :2] -= normal
                off[:, k, 2] -= np.sum(normal * left(lever), axis=-1)
            turned = row()
            turned[:, i, 2] += 1.0
            if guide.on != FRAME:
                turned[:, self.index[guide.on], 2] -= 1.0
        row()[:, 0, 2] = 1.0  # the crank comes first
        return np.stack([new.reshape(len(q), -1) for new in rows], axis=1)

    def _closed(self, q: np.ndarray) -> np.ndarray:
        for _ in range(12):
            step = np.linalg.solve(self.jacobian(q), self.residual(q)[..., None])[..., 0]
            q = q - step.reshape(q.shape)
        assert np.max(np.abs(self.residual(q))) < 1e-12, "the loop equations do not hold"
        return q

    # --- what moves how ------------------------------------------------------------------------------------------

    def material(self, body: str, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity, acceleration of the point of a body that has the coordinates v in its axes."""
        if body == FRAME:
            place = np.broadcast_to(v, (len(self.q), 2))
            return place, np.zeros_like(place), np.zeros_like(place)
        i, arm = self.index[body], self._turned(body, v, self.q)
        turning, speeding = self.rate[:, i, 2, None], self.second[:, i, 2, None]
        return (
            self.q[:, i, :2] + arm,
            self.rate[:, i, :2] + turning * left(arm),
            self.second[:, i, :2] + speeding * left(arm) - turning**2 * arm,
        )

    def point(self, body: str, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity, acceleration of a named point."""
        return self.material(body, self.local(body, name))

    def turning(self, body: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Angle of a body, its rate and acceleration."""
        if body == FRAME:
            return np.zeros_like(self.phi), np.zeros_like(self.phi), np.zeros_like(self.phi)
        i = self.index[body]
        return self.q[:, i, 2], self.rate[:, i, 2], self.second[:, i, 2]

    def velocity_at(self, body: str, place: np.ndarray) -> np.ndarray:
        """Velocity of the matter of a body that is at a place of the plane just now."""
        if body == FRAME:
            return np.zeros_like(place)
        i = self.index[body]
        return self.rate[:, i, :2] + self.rate[:, i, 2, None] * left(place - self.q[:, i, :2])

    def line(self, name: str) -> np.ndarray:
        """Unit vector of a guide's line."""
        guide = self.guides[name]
        return self._turned(guide.on, self.rail(guide)[1], self.q)

    def slide(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """How far a slider is along its line, and how fast it slides on the body that carries the line."""
        guide = self.guides[name]
        place, velocity, _ = self.material(guide.slider, self.runner(guide))
        begin = self._at(guide.on, self.rail(guide)[0], self.q)
        line = self.line(name)
        return np.sum(line * (place - begin), axis=-1), np.sum(line * (velocity - self.velocity_at(guide.on, place)), axis=-1)

    # --- energy --------------------------------------------------------------------------------------------------

    def momentum_rate(self, masses: Mapping[str, Mass], about: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rates of the momentum and of the angular momentum about a fixed place."""
        force, moment = np.zeros_like(about), np.zeros(len(about))
        for body, own in masses.items():
            place, _, acceleration = self.material(body, np.array([own.along, own.across]))
            force = force + own.mass * acceleration
            moment = moment + own.moment * self.turning(body)[2] + moment_of(place - about, own.mass * acceleration)
        return force, moment

    def energy(self, masses: Mapping[str, Mass], gravity: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """Kinetic energy, and potential energy of gravity."""
        kinetic = potential = np.zeros(len(self.q))
        for body, own in masses.items():
            place, velocity, _ = self.material(body, np.array([own.along, own.across]))
            kinetic = kinetic + 0.5 * own.mass * np.sum(velocity**2, axis=-1) + 0.5 * own.moment * self.turning(body)[1] ** 2
            potential = potential - own.mass * (place @ np.asarray(gravity, dtype=float))
        return kinetic, potential

    def power_of_masses(self, masses: Mapping[str, Mass], gravity: Sequence[float]) -> np.ndarray:
        """What inertia and weight take up [W]."""
        total = np.zeros(len(self.q))
        for body, own in masses.items():
            _, velocity, acceleration = self.material(body, np.array([own.along, own.across]))
            _, rate, second = self.turning(body)
            total = total + own.mass * np.sum((acceleration - gravity) * velocity, axis=-1) + own.moment * second * rate
        return total

    def power(self, loads: Sequence[External]) -> np.ndarray:
        """What loads feed in [W]."""
        total = np.zeros(len(self.q))
        for load in loads:
            total = total + np.sum(load.force * self.velocity_at(load.body, load.point), axis=-1)
            total = total + load.torque * self.turning(load.body)[1]
        return total


# --- forces ---------------------------------------------------------------------------------------------------------------


def newton_euler(
    k: Kinematics,
    masses: Mapping[str, Mass],
    gravity: Sequence[float],
    loads: Sequence[External] = (),
    friction: Mapping[str, float] | None = None,
    senses: Mapping[str, np.ndarray] | None = None,
    inertia: bool = True,
) -> Solution:
    """All joint forces and the driving torque.

    Three equations per body: force, and moment about its centroid. Unknown are, at a pin of n bodies, n - 1 forces between the
    first of them and each other; at a guide the normal force on the slider (to the left of the line, at the point that runs on
    it) and a moment; and the torque. `friction` is mu by guide: -mu |N| sign(v) along the line on the slider; `senses` are the
    signs of v where they are not those of the motion. `inertia` False: as if the machine stood still.
    """
    rough = list(friction or {})
    chosen: Solution | None = None
    count = np.zeros(len(k.q), dtype=int)
    for signs in itertools.product((1.0, -1.0), repeat=len(rough)):
        ratio = {}
        for name, sign in zip(rough, signs, strict=True):
            way = senses[name] if senses and name in senses else np.sign(k.slide(name)[1])
            ratio[name] = -friction[name] * sign * way  # of the friction along the line to the normal force
        trial = _linear(k, masses, gravity, loads, ratio, inertia)
        fits = np.ones(len(k.q), dtype=bool)
        for name, sign in zip(rough, signs, strict=True):
            fits &= sign * trial.normal[name] >= 0.0
        if chosen is None:
            chosen = _map(trial, trial, lambda x, _: np.full_like(x, np.nan))
        chosen = _map(trial, chosen, lambda x, y, fits=fits: np.where(fits if x.ndim == 1 else fits[:, None], x, y))
        count += fits
    assert chosen is not None
    chosen.consistent = count
    return chosen


def _map(one: Solution, other: Solution, change) -> Solution:
    pins = {p: {b: change(f, other.pins[p][b]) for b, f in bodies.items()} for p, bodies in one.pins.items()}
    parts = [
        {name: change(x, getattr(other, part)[name]) for name, x in getattr(one, part).items()}
        for part in ("normal", "friction", "moment")
    ]
    return Solution(change(one.torque, other.torque), pins, *parts)


def _linear(
    k: Kinematics,
    masses: Mapping[str, Mass],
    gravity: Sequence[float],
    loads: Sequence[External],
    ratio: Mapping[str, np.ndarray],
    inertia: bool,
) -> Solution:
    positions, bodies = len(k.q), len(k.links)
    matrix, right = np.zeros((positions, 3 * bodies, 3 * bodies)), np.zeros((positions, 3 * bodies))
    centre = {}
    for body, i in k.index.items():
        own = masses.get(body, Mass(0.0, 0.0, 0.0, 0.0))
        centre[body], _, acceleration = k.material(body, np.array([own.along, own.across]))
        needed = (acceleration if inertia else 0.0) - np.asarray(gravity, dtype=float)
        right[:, 3 * i : 3 * i + 2] += own.mass * needed
        right[:, 3 * i + 2] += own.moment * k.turning(body)[2] * inertia
    for load in loads:
        if load.body != FRAME:
            i = k.index[load.body]
            right[:, 3 * i : 3 * i + 2] -= load.force
            right[:, 3 * i + 2] -= load.torque + moment_of(load.point - centre[load.body], load.force)

    column = itertools.count()

    def unknown(members: Sequence[tuple[str, float]], place: np.ndarray, force: np.ndarray, moment: float) -> int:
        """A column: the wrench of a unit, on one body and back on another."""
        j = next(column)
        for body, sign in members:
            if body != FRAME:
                i = k.index[body]
                matrix[:, 3 * i : 3 * i + 2, j] += sign * force
                matrix[:, 3 * i + 2, j] += sign * (moment_of(place - centre[body], force) + moment)
        return j

    pairs: dict[str, list[tuple[str, str, int, int]]] = {}
    for point, (first, *rest) in k.pins.items():
        owner = next(body for body in (first, *rest) if body != FRAME)
        place = k.point(owner, point)[0]
        ex, ey = np.tile([1.0, 0.0], (positions, 1)), np.tile([0.0, 1.0], (positions, 1))
        pairs[point] = []
        for body in rest:
            both = ((body, 1.0), (first, -1.0))
            pairs[point].append((body, first, unknown(both, place, ex, 0.0), unknown(both, place, ey, 0.0)))
    held: dict[str, tuple[int, int]] = {}
    for name, guide in k.guides.items():
        both = ((guide.slider, 1.0), (guide.on, -1.0))
        place, line = k.material(guide.slider, k.runner(guide))[0], k.line(name)
        push = left(line) + (np.asarray(ratio[name])[:, None] * line if name in ratio else 0.0)
        held[name] = unknown(both, place, push, 0.0), unknown(both, place, np.zeros_like(line), 1.0)
    driver = unknown(((next(iter(k.links)), 1.0),), np.zeros((positions, 2)), np.zeros((positions, 2)), 1.0)
    assert next(column) == 3 * bodies, "as many unknowns as equations"
    x = np.linalg.solve(matrix, right[..., None])[..., 0]

    result = Solution(x[:, driver])
    for point, forces in pairs.items():
        on = result.pins[point] = {body: np.zeros((positions, 2)) for body in k.pins[point]}
        for body, first, jx, jy in forces:
            on[body] = on[body] + x[:, [jx, jy]]
            on[first] = on[first] - x[:, [jx, jy]]
    for name, (normal, moment) in held.items():
        result.normal[name], result.moment[name] = x[:, normal], x[:, moment]
        result.friction[name] = x[:, normal] * ratio.get(name, 0.0)
    return result
