"""Forward dynamics of a machine of which some drives move freely, under a torque, force or controller, beside prescribed ones.

The state has the coordinate of every free drive. For the prescribed motion alone and for each free coordinate alone the closed
form gives the velocities of all bodies; by the principle of virtual power the wrenches that the motion requires, at accelerations
that are linear in the unknown ones, then do the work of the drives (Kane's equations).

References
----------
T. R. Kane, D. A. Levinson: Dynamics, Theory and Applications, 1985, section 6.1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import itemgetter
from typing import Any

import numpy as np

from optlink.dynamics.forward import STILL, Coordinate, EquationsOfMotion, Mark
from optlink.dynamics.inverse import ROUNDING, required_wrench, virtual_torque
from optlink.dynamics.machine import Machine, Magnitude, Moving, Wrench, wrench
from optlink.dynamics.work import law_knots
from optlink.linkage.elements import Drive
from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.motion import Motion
from optlink.linkage.trains import determinant
from optlink.linkage.vector2d import Array, Value

AWAY = 1e-12  # share of its range by which a drive at rest that nothing presses against its stop is away from it


@dataclass(frozen=True)
class Controller:
    """Torque [N m] or force [N] by which a drive follows its law: gains on the error and on its rate, at most `limit`.

    With `feedforward` it adds the effort that the law would need if all controlled drives followed theirs.
    """

    proportional: float
    derivative: float = 0.0
    limit: float = np.inf
    feedforward: bool = False


@dataclass(frozen=True)
class Freedom:
    """A drive that moves freely: from a position [rad, m] and speed, under its `effort` or by its `controller`.

    `limits`: end stops, from which it rebounds with `restitution` times its speed; with a `stiffness` [N m/rad, N/m] elastic
    ones, as those of one drive (`EndStops`).
    """

    drive: Drive
    position: float
    speed: float
    effort: Magnitude | None = None
    controller: Controller | None = None
    limits: tuple[float, float] | None = None
    restitution: float = 0.0
    stiffness: float = 0.0

    def end(self, position: Value) -> tuple[float, float, Value]:
        """The nearer stop, the direction out of the range there, and how far the drive is beyond it [rad, m]."""
        low, high = self.limits or (-np.inf, np.inf)
        end, out = (high, 1.0) if position - low > high - position else (low, -1.0)
        return end, out, (position - end) * out

    def spring(self, position: Value) -> Value:
        """The torque [N m] or force [N] of elastic stops that compress."""
        low, high = self.limits or (-np.inf, np.inf)
        return self.stiffness * (np.maximum(low - position, 0.0) - np.maximum(position - high, 0.0)) if self.stiffness else 0.0

    @property
    def size(self) -> str:
        """Name of the coordinate among the sizes of the machine."""
        return f"{self.drive.name}.position"


def freed(machine: Machine, freedoms: Sequence[Freedom]) -> Machine:
    """Return the machine in which the coordinates of free drives are sizes."""
    mechanism = machine.mechanism
    free = {one.drive: replace(one.drive, begin=one.size, end=None, law=None, rate=0.0) for one in freedoms}
    trains = tuple(
        replace(train, elements=tuple(free.get(element, element) for element in train.elements))  # type: ignore[call-overload]
        for train in mechanism.trains
    )
    drives = tuple(free.get(drive, drive) for drive in mechanism.drives)
    sizes = {**machine.sizes, **{one.size: one.position for one in freedoms}}
    return machine.with_(mechanism=replace(mechanism, trains=trains, drives=drives), sizes=sizes)


class FreeEquations(EquationsOfMotion):
    """Right-hand side; the state begins with cycle variable and its rate, free coordinates, and speeds.

    Then follow for each coordinate 1 where a stop holds it, and the share of the force of its elastic stop that acts.
    """

    def __init__(self, machine: Machine, freedoms: Sequence[Freedom]) -> None:
        super().__init__(freed(machine, freedoms), None, stops=any(one.limits for one in freedoms))
        self.freedoms, self.count = tuple(freedoms), len(freedoms)
        self.head = 2 + 4 * self.count
        self.knots, self.hardest = law_knots(machine, 0.0, self.cycle), 0.0

    @property
    def switches(self) -> Array:
        """Values of the cycle variable [rad] at which a law passes a knot."""
        return self.knots

    def at(self, angle: Jet, coordinates: Sequence[Value], speed: Value = 1.0) -> Moving:
        """The machine in motion at the cycle variable [rad] and free coordinates, numbers or jets."""
        machine = self.machine
        sizes = {**machine.sizes, **{one.size: value for one, value in zip(self.freedoms, coordinates, strict=True)}}
        pose = machine.mechanism.at(sizes, angle)
        return Moving(machine, Motion(machine.mechanism, machine.sizes, angle.value, speed, pose), 1, 1.0)

    def ways(self, angle: Value, coordinates: Sequence[Value]) -> list[Moving]:
        """The motions in which one free coordinate alone has the speed 1."""
        return [
            self.at(Jet(angle), [Jet(value, float(k == own)) for k, value in enumerate(coordinates)]) for own in range(self.count)
        ]

    def momenta(self, way: Moving) -> dict[str, Wrench]:
        """The impulses that set the bodies in motion as in `way`."""
        states = {body: way.state(body) for body in self.machine.inertias}
        return {
            body: wrench(
                self.machine.inertias[body].parameters,
                state._replace(acceleration=state.velocity, omega=0.0, alpha=state.omega),
                (0.0, 0.0),
            )
            for body, state in states.items()
        }

    def masses(self, ways: Sequence[Moving]) -> list[list[Value]]:
        """The mass matrix of the free coordinates."""
        return [[virtual_torque(momenta, way) for way in ways] for momenta in map(self.momenta, ways)]

    @property
    def inertia(self) -> Array:
        """The mass matrix at the start."""
        return np.array(self.masses(self.ways(0.0, [one.position for one in self.freedoms])), dtype=float)

    def aims(self, angle: Jet, actual: Sequence[Jet]) -> list[Jet]:
        """The coordinates of the laws of controlled drives; those of the others are the actual ones."""
        pose = self.at(angle, actual).pose
        return [
            real if one.controller is None else as_jet(one.drive.value(pose))
            for one, real in zip(self.freedoms, actual, strict=True)
        ]

    def efforts(self, angle: Jet, positions: Sequence[Value], speeds: Sequence[Value]) -> list[Value]:
        """The torques [N m] and forces [N] of the free drives."""
        actual = [Jet(*parts) for parts in zip(positions, speeds, strict=True)]
        aims = self.aims(angle, actual)
        ideal = ways = None
        efforts = list[Value]()
        for k, (one, aim, (q, v, _)) in enumerate(zip(self.freedoms, aims, (jet.parts for jet in actual), strict=True)):
            control = one.controller
            if control is None:
                assert one.effort is not None
                efforts.append(one.effort({"phi": q, "s": q, "omega": v, "v": v}))
                continue
            effort = control.proportional * (aim.value - q) + control.derivative * (aim.rate - v)
            if control.feedforward:
                ideal = ideal or required_wrench(self.at(angle, aims, angle.rate))
                ways = ways or self.ways(angle.value, [jet.value for jet in aims])
                effort = effort + virtual_torque(ideal, ways[k])
            efforts.append(np.maximum(np.minimum(effort, control.limit), -control.limit) if control.limit < np.inf else effort)
        return efforts

    def balance(self, head: Any) -> tuple[Moving, list[Value], list[Value], list[Value], Value]:
        """The motion, accelerations of the free coordinates, their efforts and those of their stops, power of all drives."""
        n, (phi, pace) = self.count, head[:2]
        q, v, held, shares = (head[2 + k * n : 2 + (k + 1) * n] for k in range(4))
        angle, ways, efforts = Jet(phi, pace), self.ways(phi, q), self.efforts(Jet(phi, pace), q, v)
        springs = [share * one.spring(at) for one, at, share in zip(self.freedoms, q, shares, strict=True)]
        needed = required_wrench(self.at(angle, list(map(Jet, q, v)), pace))
        rows, right = list[dict[Any, Value]](), list[Value]()
        for j, masses in enumerate(self.masses(ways)):
            free = 1.0 - held[j]
            rows.append({k: free * mass + float(k == j) * held[j] for k, mass in enumerate(masses)})
            right.append(free * (efforts[j] + springs[j] - virtual_torque(needed, ways[j])))
        columns: list[Any] = list(range(n))
        whole = determinant(rows, columns)
        bends = [determinant([{**row, k: r} for row, r in zip(rows, right, strict=True)], columns) / whole for k in columns]
        moving = self.at(angle, list(map(Jet, q, v, bends)), pace)
        required = required_wrench(moving)
        stops = [
            spring + rest * (virtual_torque(required, way) - own - spring)
            for spring, rest, way, own in zip(springs, held, ways, efforts, strict=True)
        ]
        power = virtual_torque(required, self.at(angle, q)) + sum(own * speed for own, speed in zip(efforts, v, strict=True))
        return moving, bends, efforts, stops, power

    def rates(self, *head: Value) -> list[Value]:
        """Rates of the cycle variable's rate, of the free coordinates, of works and of velocities of bodies."""
        moving, bends, _, stops, power = self.balance(head)
        powers = [power, *self.load_powers(moving)]
        still, speeds = [0.0] * (2 * self.count), head[2 + self.count : 2 + 2 * self.count]
        if self.rigid:  # rigid stops act at an instant, and do no work while they hold a drive
            powers.append(sum((stop * speed for stop, speed in zip(stops, speeds, strict=True)), 0.0))
        return [0.0, *speeds, *bends, *still, *powers, *self.accelerations(moving)]

    def start(self, angle: float, speed: float) -> Array:
        """The state at the start, at rest against a stop where it is pressed against it."""
        places, speeds = ([getattr(one, key) for one in self.freedoms] for key in ("position", "speed"))
        moving = self.at(Jet(angle, speed), list(map(Jet, places, speeds)), speed)
        return self.settled(self.begun(np.array([angle, speed, *places, *speeds, *[0.0] * (2 * self.count)]), moving))

    def coordinates(self, states: Array) -> dict[str, Coordinate]:
        """The free coordinates at states (n, size), by the names of their sizes."""
        head = states[:, : self.head].T
        _, bends, efforts, stops, _ = self.balance(head)
        jets = list(map(Jet, head[2:], head[2 + self.count :], bends))
        errors = [aim.value - jet.value for aim, jet in zip(self.aims(Jet(head[0], head[1]), jets), jets, strict=True)]
        return {one.size: Coordinate(*parts) for one, *parts in zip(self.freedoms, jets, efforts, stops, errors, strict=True)}

    def along(self, states: Array, ways: Array, resting: bool) -> tuple[Moving, Value]:
        """The motion at states (n, size)."""
        return self.balance(states[:, : self.head].T)[0], 0.0

    # --- end stops -------------------------------------------------------------------------------------------------

    def marks(self, state: Array) -> list[Mark]:
        """Impacts, turning points, after which another may follow, and where a stop that holds a drive releases it."""
        n, marks = self.count, list[Mark]()
        for k, one in enumerate(self.freedoms):
            if one.limits is None:
                continue
            if state[2 + 2 * n + k]:
                full, pressing = one.spring(float(state[2 + k])), partial(self.pressing, k)
                marks.append((("leave", k, one.restitution**2), pressing, one.restitution**2 * full))
                marks += [(("leave", k, 1.0), pressing, full)] if one.stiffness else []
                continue
            marks += [(("hit", k, end), itemgetter(2 + k), end) for end in one.limits]
            marks.append((("turn", k, 0.0), itemgetter(2 + n + k), 0.0))
        return marks

    def pressing(self, k: int, state: Array) -> float:
        """The torque [N m] or force [N] of the stop of a drive that is held there."""
        return float(self.balance(state[: self.head].tolist())[3][k])

    def met(self, state: Array, event: Any) -> Array:
        """The state after an impact, or where a drive leaves its stop."""
        if not isinstance(event, tuple):
            return state
        (kind, k, what), n = event, self.count
        state = state.copy()
        if kind == "leave":
            state[2 + 2 * n + k], state[2 + 3 * n + k] = 0.0, what
            return state if self.freedoms[k].stiffness else self.settled(state)
        if kind == "turn":
            state[2 + n + k] = 0.0
        else:
            state[2 + k] = what
        return self.settled(state)

    def settled(self, state: Array) -> Array:
        """The state in which drives that press against their stops rebound or are held, and elastic stops act as they move."""
        n, state = self.count, state.copy()
        for k, one in [*enumerate(self.freedoms)] * 2:
            if one.limits is None:
                continue
            end, out, beyond = one.end(float(state[2 + k]))
            if one.stiffness:
                self.compress(state, k, out, beyond)
                continue
            span = one.limits[1] - one.limits[0]
            if abs(beyond) > ROUNDING * span:
                continue
            if state[2 + n + k] * out > 0.0:
                state = self.rebound(state, k, end)
            if state[2 + n + k] == 0.0:
                state[2 + k], state[2 + 2 * n + k] = end, 0.0
                if self.bend(state, k) * out > 0.0:
                    state[2 + 2 * n + k] = 1.0
                else:  # a force that begins with zero may still press it against the stop, which then is an event
                    state[2 + k] = end - out * AWAY * span
        return state

    def bend(self, state: Array, k: int) -> float:
        """The acceleration of a free coordinate."""
        return float(self.balance(state[: self.head].tolist())[1][k])

    def compress(self, state: Array, k: int, out: float, beyond: float) -> None:
        """Set the share of the force of an elastic stop by the sense of motion; at rest it holds what the shares enclose."""
        n, back = self.count, self.freedoms[k].restitution ** 2
        held, share, way = 2 + 2 * n + k, 2 + 3 * n + k, out * float(state[2 + n + k])
        state[held], state[share] = 0.0, 1.0 if way >= 0.0 else back
        if way == 0.0 < beyond and self.bend(state, k) * out <= 0.0:
            state[share] = back
            if self.bend(state, k) * out >= 0.0:
                state[held], state[share] = 1.0, 0.0

    def rebound(self, state: Array, k: int, end: float) -> Array:
        """Reverse a free coordinate at its stop: the impulse changes the other free speeds too, and the prescribed drives resist.

        A drive held at its own rigid stop stays there unless the impulse pulls it away.
        """
        n, own = self.count, self.freedoms[k]
        state = state.copy()
        state[2 + 2 * n : 2 + 3 * n] *= [not one.stiffness for one in self.freedoms]
        state[2 + k], before = end, float(state[2 + n + k])
        self.hardest = max(self.hardest, abs(before))
        after = -own.restitution * before if own.restitution * abs(before) > STILL * self.hardest else 0.0
        ways = self.ways(float(state[0]), state[2 : 2 + n].tolist())
        masses = np.array(self.masses(ways), dtype=float)
        while True:
            free = np.flatnonzero(state[2 + 2 * n : 2 + 3 * n] == 0.0)
            response = np.zeros(n)
            response[free] = np.linalg.solve(masses[np.ix_(free, free)], 1.0 * (free == k))
            change = response * (after - before) / response[k]
            impulses = masses @ change
            middles = [0.5 * sum(one.limits or ()) for one in self.freedoms]
            away = impulses * (state[2 : 2 + n] - middles) > 0.0
            pulled = np.flatnonzero(away & (state[2 + 2 * n : 2 + 3 * n] == 1.0))
            if not pulled.size:
                break
            state[2 + 2 * n + pulled] = 0.0
        prescribed = self.at(Jet(float(state[0]), float(state[1])), state[2 : 2 + n].tolist())
        for step, way in zip(change, ways, strict=True):
            state[self.head] += step * float(virtual_torque(self.momenta(way), prescribed))
            state[-3 * len(self.bodies) :] += step * self.velocities(way)
        state[self.head + self.names.index("stops")] += 0.5 * impulses[k] * (before + after)
        state[2 + n : 2 + 2 * n] += change
        state[2 + n + k] = after
        return state
