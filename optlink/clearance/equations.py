"""Equations of motion of a machine with joint clearance, traced with casadi and compiled for its integrator.

The unknowns are the accelerations of the coordinates of the spanning tree, and the forces in the loop-closing joints (index 1):

    [M  C'] [a]   [Q - h]
    [C  0 ] [-f] = [-c   ]

Where the motion of the crank is prescribed (a servo follows a command, or the speed is constant) its row gives the drive torque.

References
----------
Newton-Euler equations by virtual power; wrenches and positions are those of the ideal machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple, TypeVar

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.clearance.joint import Gap, JournalMotion, Touch, acting, touch
from optlink.dynamics.inverse import required_wrench
from optlink.dynamics.machine import Acting, BodyMotion, Machine, Magnitude, Wrench, body_motion
from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.mechanism import FRAME, Guide, Mechanism, Pose
from optlink.linkage.vector2d import Array, Value, Vector, angle, cross, dot, minus, plus, turn, turn_back, unit
from optlink.symbolic import BufferedFunction, CompiledFunction, symbols_in_numpy

# Spanning tree of a mechanism cut at its gaps: the ideal joints form a tree of bodies with its coordinates.
#
# A body is connected to its parent by a pin (coordinate: its own angle) or by a guide (coordinate: the slide), or is free (two
# coordinates of its start, and its angle). Ideal joints outside the tree close loops; each gives two equations.

Kind = Literal["angle", "x", "y", "slide"]


class Coordinate(NamedTuple):
    """One coordinate of a body: its `angle` [rad], `x` or `y` of its start [m], or a `slide` [m]."""

    body: str
    kind: Kind

    @property
    def name(self) -> str:
        """Name for columns and messages."""
        return f"{self.body}.{self.kind}"


class BodyPlace(NamedTuple):
    """Position of a body: its start [m] and the unit vector of its x axis."""

    start: Vector
    axis: Vector


class Pin(NamedTuple):
    """An ideal revolute joint between two bodies."""

    point: str
    first: str
    second: str

    @property
    def bodies(self) -> tuple[str, str]:
        """The two bodies."""
        return self.first, self.second


class Branch(NamedTuple):
    """Connection of a body to the tree: by a joint to a body placed before it, or none (free body)."""

    body: str
    parent: str
    joint: Pin | Guide | None


@dataclass(frozen=True)
class SpanningTree:
    """A mechanism cut at its pins in `gaps`: point -> body that is cut off there (the journal)."""

    mechanism: Mechanism
    sizes: Mapping[str, Value]
    gaps: Mapping[str, str]

    @cached_property
    def joints(self) -> tuple[Pin | Guide, ...]:
        """The ideal joints, each between two bodies: pins, then guides."""
        pins = []
        for point, bodies in self.mechanism.pins.items():
            carriers = [body for body in bodies if body != self.gaps.get(point)]
            pins += [Pin(point, carriers[0], other) for other in carriers[1:]]
        return (*pins, *self.mechanism.guides)

    @cached_property
    def branches(self) -> tuple[Branch, ...]:
        """All bodies, each after its parent."""
        tree = self._grow(free_crank=False)
        crank = next(branch for branch in tree if branch.body == self.mechanism.crank.body)
        # the drive prescribes the crank angle, so it must be a coordinate: a crank connected by a guide becomes a root
        return self._grow(free_crank=True) if isinstance(crank.joint, Guide) else tree

    def _grow(self, *, free_crank: bool) -> tuple[Branch, ...]:
        tree: dict[str, Branch] = {}
        if free_crank:
            tree[self.mechanism.crank.body] = Branch(self.mechanism.crank.body, FRAME, None)
        waiting = [FRAME, *tree]
        for root in ["", *self.mechanism.bodies]:
            if root and root not in tree:
                tree[root] = Branch(root, FRAME, None)
                waiting.append(root)
            while waiting:
                at = waiting.pop(0)
                for joint in self.joints:
                    if at in joint.bodies:
                        other = joint.bodies[0] if joint.bodies[1] == at else joint.bodies[1]
                        if other != FRAME and other not in tree:
                            tree[other] = Branch(other, at, joint)
                            waiting.append(other)
        return tuple(tree.values())

    @cached_property
    def closing(self) -> tuple[Pin | Guide, ...]:
        """The ideal joints outside the tree."""
        used = {id(branch.joint) for branch in self.branches}
        return tuple(joint for joint in self.joints if id(joint) not in used)

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coordinates of the tree, in the order of the bodies."""
        coordinates = []
        for body, _, joint in self.branches:
            free: tuple[Kind, ...] = ("x", "y", "angle") if joint is None else ("slide" if isinstance(joint, Guide) else "angle",)
            coordinates += [Coordinate(body, kind) for kind in free]
        return tuple(coordinates)

    @cached_property
    def driven(self) -> int:
        """Index of the crank's angle among the coordinates."""
        return self.coordinates.index(Coordinate(self.mechanism.crank.body, "angle"))

    @cached_property
    def local(self) -> Pose:
        """Local coordinates of points and lines on the bodies; no body is placed in it."""
        return Pose(self.mechanism, self.sizes)

    def place(self, values: Sequence[Value]) -> dict[str, BodyPlace]:
        """Return the position of every body from the coordinates (floats, arrays, symbols or jets), in their order."""
        places = {FRAME: BodyPlace((0.0, 0.0), (1.0, 0.0))}
        remaining = iter(values)
        for body, parent, joint in self.branches:
            if joint is None:
                places[body] = BodyPlace((next(remaining), next(remaining)), unit(next(remaining)))
            elif isinstance(joint, Guide):
                at, line_on_body = self.local.local_line(joint, body)
                begin, way = self.line(joint, joint.other(body), places[parent])
                slide = next(remaining)
                axis, shift = turn_back(way, line_on_body), slide if body == joint.slider else -slide
                start = minus((begin[0] + shift * way[0], begin[1] + shift * way[1]), turn(at, axis))
                places[body] = BodyPlace(start, axis)
            else:
                axis = unit(next(remaining))
                at = self.at(joint.point, parent, places[parent])
                places[body] = BodyPlace(minus(at, turn(self.local.local(body, joint.point), axis)), axis)
        return places

    def at(self, point: str, body: str, place: BodyPlace | BodyMotion) -> Vector:
        """Return the position of a point of a placed body [m]."""
        return plus(place.start, turn(self.local.local(body, point), place.axis))

    def line(self, guide: Guide, body: str, place: BodyPlace | BodyMotion) -> tuple[Vector, Vector]:
        """Return a point [m] and the unit vector of a guide's line, from the place of one of its two bodies."""
        point, way = self.local.local_line(guide, body)
        return plus(place.start, turn(point, place.axis)), turn(way, place.axis)

    def slide(self, guide: Guide, places: Mapping[str, BodyPlace]) -> Value:
        """Return the displacement of the slider along its line [m]."""
        begin, way = self.line(guide, guide.on, places[guide.on])
        return dot(minus(self.line(guide, guide.slider, places[guide.slider])[0], begin), way)

    def open(self, places: Mapping[str, BodyPlace]) -> list[Value]:
        """Return the residuals of the closing joints [m, or the sine of an angle], two for each joint."""
        gaps: list[Value] = []
        for joint in self.closing:
            first, second = joint.bodies
            if isinstance(joint, Guide):
                at, direction = self.line(joint, first, places[first])
                begin, way = self.line(joint, second, places[second])
                gaps += [cross(way, minus(at, begin)), cross(way, direction)]
            else:
                gaps += minus(self.at(joint.point, first, places[first]), self.at(joint.point, second, places[second]))
        return gaps

    def read(self, pose: Pose) -> list[Value]:
        """Return the coordinates in a pose of the mechanism without gaps (jets if the pose has jets)."""
        values: list[Value] = []
        for body, kind in self.coordinates:
            if kind == "angle":
                values.append(angle(pose.direction(body)))
            elif kind == "slide":
                branch = next(branch for branch in self.branches if branch.body == body)
                assert isinstance(branch.joint, Guide)
                values.append(pose.slide(branch.joint))
            else:
                values.append(pose.points[self.mechanism.bodies[body].start][0 if kind == "x" else 1])
        return values


# A machine with joint clearance in motion: the coordinates place every body; pins with clearance impose nothing.
#
# It has the interface of `Moving`, so that loads act on it as on the ideal machine, with floats, arrays or symbols.

SMOOTH = 1e-4
"""Share of the nominal speed (crank speed times size of the machine) where a load that opposes a motion has 76 % of its size."""


class ClearanceState:
    """A machine with joint clearance at coordinates that are jets.

    The nominal speed of the crank [rad/s], with its sense, is the reference for the smoothing of `sense`.
    """

    def __init__(self, machine: Machine, cut: SpanningTree, values: Sequence[Value], speed: float) -> None:
        self.machine, self.tree, self.nominal = machine, cut, speed
        self.direction = -1.0 if speed < 0.0 else 1.0
        self.places = cut.place(values)
        self.crank: Jet = values[cut.driven]
        self._states: dict[str, BodyMotion] = {}

    @property
    def variables(self) -> dict[str, Value]:
        """Variables available to every load: crank angle [rad] and speed [rad/s]."""
        return {"phi": self.crank.value, "omega": self.crank.rate}

    def state(self, body: str) -> BodyMotion:
        """Return the motion of a body."""
        if body not in self._states:
            self._states[body] = body_motion(*self.places[body])
        return self._states[body]

    def position(self, point: str, body: str) -> Vector:
        """Return the position of a point of a body [m]."""
        return self.tree.at(point, body, self.state(body))

    def velocity(self, point: str, body: str) -> Vector:
        """Return the velocity of a point of a body [m/s]."""
        return self.state(body).at(self.position(point, body))[0]

    def acceleration(self, point: str, body: str) -> Vector:
        """Return the acceleration of a point of a body [m/s^2]."""
        return self.state(body).at(self.position(point, body))[1]

    def line(self, guide: str) -> Vector:
        """Return the unit vector of a guide's line."""
        joint = next(candidate for candidate in self.machine.mechanism.guides if candidate.name == guide)
        return self.tree.line(joint, joint.on, self.state(joint.on))[1]

    @cached_property
    def slides(self) -> dict[str, tuple[Value, Value, Value]]:
        """Slide in every guide, its velocity and acceleration [m, m/s, m/s^2]."""
        return {guide.name: as_jet(self.tree.slide(guide, self.places)).parts for guide in self.machine.mechanism.guides}

    def sense(self, of: Callable[[ClearanceState], tuple[Value, Value]], size: Value = 1.0) -> Value:
        """Return the smoothed sign of a velocity, because no equation of motion is integrated across a jump.

        `size` is that of the machine [m] for the velocity of a point, 1 for an angular velocity.
        """
        return np.tanh(of(self)[0] / (SMOOTH * abs(self.nominal) * size))

    def journal_motion(self, gap: Gap) -> JournalMotion:
        """Return the motion of the journal of a gap in its bearing."""
        bodies = gap.journal, gap.bearing
        eccentricity = minus(*(self.position(gap.point, body) for body in bodies))
        rate = minus(*(self.velocity(gap.point, body) for body in bodies))
        return JournalMotion(eccentricity, rate, *(self.state(body).omega for body in bodies))

    # --- forces and energies -----------------------------------------------------------------------------------------

    def needed(self) -> dict[str, Wrench]:
        """Return the total force, and moment about its start, that each body requires for its inertia and against gravity."""
        return required_wrench(self, loads=False)  # type: ignore[arg-type]

    def acting(self) -> dict[str, list[Acting]]:
        """Return the forces of each load, by the load's name."""
        return {load.name: list(load.act(self)) for load in self.machine.loads}  # type: ignore[arg-type]

    def power(self, acting: Sequence[Acting]) -> Value:
        """Return the power that loads feed into the machine [W]."""
        return sum(load.power(self.state(load.body)) for load in acting if load.body != FRAME)

    @cached_property
    def kinetic(self) -> Value:
        """Kinetic energy [J]."""
        return self.machine.kinetic(self.state)

    @cached_property
    def potential(self) -> Value:
        """Potential energy of gravity [J]; the energy of springs counts among the works of loads."""
        return self.machine.weight(self.state)


# Servo reference: constant speed plus a Fourier-series correction.


@dataclass(frozen=True)
class ReferenceSignal:
    """Reference angle = start + speed t + a Fourier series of the revolution; its derivative is the reference speed.

    `harmonics` (h,): complex [rad], by default none. The correction is the real part of their sum with exp(i k |speed| t).
    """

    start: float
    speed: float
    harmonics: NDArray[np.complex128] = field(default_factory=lambda: np.zeros(0, dtype=complex))

    def at(self, time: Value) -> tuple[Value, Value]:
        """Return the reference angle [rad] and speed [rad/s] at a time [s] (float, array or symbol)."""
        angle, speed = self.start + self.speed * time, self.speed + 0.0 * time
        for k, harmonic in enumerate(self.harmonics.tolist()):
            rate = k * abs(self.speed)
            c, s = np.cos(rate * time), np.sin(rate * time)
            angle = angle + harmonic.real * c - harmonic.imag * s
            speed = speed - rate * (harmonic.real * s + harmonic.imag * c)
        return angle, speed

    def correction(self, time: Value) -> Value:
        """Return the reference angle minus that of constant speed [rad]."""
        return self.at(time)[0] - (self.start + self.speed * time)


Made = TypeVar("Made")
LEAST_FORCE = 1e-300
"""Force [N] that keeps a ratio of forces finite where there are none."""


@dataclass(frozen=True)
class Servo:
    """A drive that follows a command of angle and speed: second-order system of `bandwidth` [rad/s] and `damping` ratio."""

    bandwidth: float
    damping: float


@dataclass(frozen=True)
class Drive:
    """Drive of the crank: a `servo` that follows a `reference`, a `torque` [N m] over phi and omega, or a constant speed."""

    servo: Servo | None = None
    reference: ReferenceSignal | None = None
    torque: Magnitude | None = None


class Weightless(ValueError):
    """Error: a coordinate without inertia, whose motion no force determines; `body` names its body."""

    def __init__(self, body: str) -> None:
        super().__init__(f"{body} has no inertia, so its motion in the gap is undefined")
        self.body = body


class Equations:
    """The compiled equations of a machine with gaps.

    A state is (q, v): coordinates in the order of `cut.coordinates` and their rates. `modes` of the gaps are 1 in contact, 0
    apart; `speeds` the approach speeds with which the contacts began [m/s].
    """

    def __init__(self, machine: Machine, gaps: Sequence[Gap], drive: Drive, speed: float) -> None:
        self.machine, self.gaps, self.drive, self.speed = machine, tuple(gaps), drive, speed
        self.tree = SpanningTree(machine.mechanism, machine.sizes, {gap.point: gap.journal for gap in gaps})
        self.size = len(self.tree.coordinates)
        self._functions: dict[tuple[Any, ...], Any] = {}
        with symbols_in_numpy():
            self._trace()

    def state(self, q: Iterable[Any], v: Iterable[Any], a: Iterable[Any]) -> ClearanceState:
        """Return the machine at coordinates [rad, m], rates and accelerations (floats, arrays or symbols), in that order."""
        return ClearanceState(self.machine, self.tree, [Jet(*three) for three in zip(q, v, a, strict=True)], self.speed)

    def touches(self, moving: ClearanceState, speeds: Iterable[Any], modes: Iterable[Any]) -> list[Touch]:
        """Return the contacts at the gaps, from their approach speeds at the start of the contact [m/s] and their modes."""
        return [touch(gap, moving.journal_motion(gap), v, m) for gap, v, m in zip(self.gaps, speeds, modes, strict=True)]

    @property
    def losses(self) -> tuple[str, ...]:
        """Names of the works that are integrated with the motion [J]: of the drive, of loads, dissipated at gaps."""
        names = [f"{gap.point}.{kind}" for gap in self.gaps for kind in ("impact", "friction")]
        return ("drive", *(load.name for load in self.machine.loads), *names)

    def _trace(self) -> None:
        n, k, symbol = self.size, len(self.gaps), casadi.SX.sym
        self.x, a = symbol("x", 2 * n), symbol("a", n)
        self.entered, self.modes = symbol("entered", k), symbol("modes", k)
        self.span, self.tau, self.begin = symbol("span"), symbol("tau"), symbol("begin")  # times of a call of the integrator
        self.further = symbol("further")  # turn beyond the command
        self.command = symbol("command", 3)  # angle, speed and acceleration of the servo reference
        x, entered = self.x, casadi.vertsplit(self.entered)
        q, v = casadi.vertsplit(x)[:n], casadi.vertsplit(x)[n:]
        moving = self.state(q, v, casadi.vertsplit(a))
        # loads must not depend on the symbols of unknown accelerations
        self.symbolic = unaccelerated = self.state(q, v, [casadi.SX(0.0)] * n)
        touches = self.touches(unaccelerated, entered, casadi.vertsplit(self.modes))
        loads = unaccelerated.acting()
        forces = [force for of_load in loads.values() for force in of_load]
        for gap, contact in zip(self.gaps, touches, strict=True):
            forces += acting(gap, unaccelerated.journal_motion(gap), unaccelerated.position(gap.point, gap.journal), contact)
        residual = casadi.SX.zeros(n)
        for body, (force, moment) in moving.needed().items():
            state = unaccelerated.state(body)
            (fx, fy), total = force, moment
            for one in forces:
                if one.body == body:
                    (gx, gy), turned = one.wrench(state)
                    fx, fy, total = fx - gx, fy - gy, total - turned
            rates = casadi.vertcat(*state.velocity, state.omega)
            residual += casadi.jacobian(rates, x[n:]).T @ casadi.vertcat(fx, fy, total)
        residuals = [as_jet(value).parts for value in self.tree.open(moving.places)]
        closure, bent = (casadi.vertcat(casadi.SX(0, 1), *[parts[order] for parts in residuals]) for order in (0, 2))
        grip = casadi.jacobian(closure, x[:n])
        crank = self.tree.driven
        prescribed, torque = self._driven(unaccelerated)
        self.free = free = [i for i in range(n) if prescribed is None or i != crank]
        # linear in the accelerations: matrix and right-hand side by differentiation, at a = 0 (and the prescribed one)
        whole = casadi.SX.zeros(n)
        if prescribed is not None:
            whole[crank] = prescribed
        rest, late = (casadi.substitute(part, a, whole) for part in (residual, bent))
        if torque is not None:
            rest[crank] -= torque
        mass, constraint_rows = casadi.jacobian(residual, a), grip[:, free]
        self.closing = m = closure.numel()
        if not free:
            solved = casadi.SX(0, 1)
        elif m:
            matrix = casadi.blockcat([[mass[free, free], constraint_rows.T], [constraint_rows, casadi.SX(m, m)]])
            solved = casadi.solve(matrix, -casadi.vertcat(rest[free], late))
        else:  # positive definite and sparse
            solved = casadi.ldl_solve(-rest[free], *casadi.ldl(mass[free, free], False))
        for place, i in enumerate(free):
            whole[i] = solved[place]
        pull = solved[len(free) :]  # minus the forces in the closing joints
        if torque is None:
            torque = rest[crank] + mass[crank, free] @ solved[: len(free)] + (grip[:, crank].T @ pull if m else 0.0)
        powers = [torque * v[crank], *(unaccelerated.power(several) for several in loads.values())]
        powers += [power for contact in touches for power in (contact.loss, contact.rubbing)]
        ode = casadi.vertcat(x[n:], whole)
        depth = casadi.vertcat(*[contact.penetration for contact in touches])
        rate = casadi.vertcat(*[contact.rate for contact in touches])
        normal = casadi.vertcat(*[contact.normal for contact in touches])
        torque = casadi.SX(torque)
        # the torque is linear in the modes, which scale the contact forces: derivative with respect to each contact force
        bare = casadi.vertcat(*[contact.normal for contact in self.touches(unaccelerated, entered, [1.0] * k)])
        lever = casadi.jacobian(torque, self.modes).T / (bare + LEAST_FORCE)
        ahead = casadi.vertcat(self.command[1:], 0.0)
        over = [casadi.jtimes(part, x, ode) + casadi.jtimes(part, self.command, ahead) for part in (normal, torque)]
        self.rates = [ode, casadi.vertcat(*powers)]
        self.watched = [depth, rate, casadi.jtimes(rate, x, ode), normal, over[0], lever, torque, over[1]]
        self._outcome = [whole, torque, pull]
        self.masses = CompiledFunction([x], [mass[free, free], constraint_rows])
        self.closed = [x[:n], closure, grip]

    def _driven(self, state: ClearanceState) -> tuple[Any, Any]:
        """Acceleration of the crank (or None), and torque on it (or None where it follows from the motion)."""
        if self.drive.torque is not None:
            return None, self.drive.torque(state.variables)
        if self.drive.servo is None or self.drive.reference is None:
            return casadi.SX(0.0), None
        servo, crank = self.drive.servo, state.crank
        lag, slow = self.command[0] + self.further - crank.value, self.command[1] - crank.rate
        return servo.bandwidth * servo.bandwidth * lag + 2.0 * servo.damping * servo.bandwidth * slow, None

    def _in_time(self, parts: list[Any]) -> list[Any]:
        """Return expressions with the servo reference at the time `begin + span tau`."""
        if self.drive.reference is not None:
            with symbols_in_numpy():
                angle, speed = self.drive.reference.at(self.begin + self.span * self.tau)
            signal = casadi.densify(casadi.vertcat(angle, speed, casadi.jacobian(casadi.SX(speed), self.begin)))
            parts = casadi.substitute(parts, [self.command], [signal])
        return list(casadi.cse(parts))

    @cached_property
    def _flow(self) -> list[Any]:
        return self._in_time(self.rates)

    @cached_property
    def short_step(self) -> CompiledFunction:
        """Function (x, parameters, time) -> state, works [J] after a time [s] too short for the integrator.

        One classical Runge-Kutta step; the time may be negative, and the span in the parameters is ignored.
        """
        flow = casadi.Function("flow", [self.x, self.parameters, self.tau], self._flow)
        time, now = casadi.SX.sym("time"), casadi.vertcat(0.0, self.parameters[1:])  # span 0: tau has no effect

        def at(slopes: Any, share: float) -> Any:
            later = casadi.vertcat(now[0], now[1] + share * time, now[2:])
            return flow(self.x + share * time * slopes, later, 0.0)

        one = at(casadi.SX.zeros(self.x.numel()), 0.0)
        two = at(one[0], 0.5)
        three = at(two[0], 0.5)
        four = at(three[0], 1.0)
        means = [(a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(one, two, three, four, strict=True)]
        return CompiledFunction([self.x, self.parameters, time], [self.x + time * means[0], time * means[1]])

    @cached_property
    def parameters(self) -> Any:
        """Constants of one call of the integrator: span and begin of its time, feedback, contacts."""
        return casadi.vertcat(self.span, self.begin, self.further, self.entered, self.modes)

    def _once(self, key: tuple[Any, ...], make: Callable[[], Made]) -> Made:
        """Return a function that is compiled at its first use."""
        if key not in self._functions:
            self._functions[key] = make()
        function: Made = self._functions[key]
        return function

    def watch(self, copies: int) -> CompiledFunction:
        """Return the function (x, parameters, tau) -> fields of `peaks.Watched`, in order, at `copies` points at a time."""
        return self._in_motion("watch", self.watched, copies)

    def dynamics(self, copies: int) -> CompiledFunction:
        """Return the function (x, parameters, tau) -> accelerations, drive torque [N m], forces in the closing joints.

        It evaluates `copies` points at a time.
        """
        return self._in_motion("dynamics", self._outcome, copies)

    def _in_motion(self, name: str, parts: list[Any], copies: int) -> CompiledFunction:
        arguments = [self.x, self.parameters, self.tau]
        return self._once((name, copies), lambda: CompiledFunction(arguments, self._in_time(parts), copies))

    def closure(self, states: Array) -> tuple[Array, Array]:
        """Return the residuals of the closing joints (m, rows), and their Jacobian over the coordinates (m, rows, n)."""
        count = len(states)
        closed = self._once(("closure", count), lambda: CompiledFunction(self.closed[:1], self.closed[1:], count))
        residuals, grip = closed(states[:, : self.size].ravel())
        return residuals.reshape(count, -1), grip.reshape(count, self.size, -1).transpose(0, 2, 1)

    def integrator(self, steps: int, tolerance: float, *, stiff: bool = False) -> BufferedFunction:
        """Return the CVODES integrator (x, parameters) -> states, works [J] after each of the equal steps of the span.

        Its relative tolerance is given; the absolute one is a thousandth of it. A stiff motion takes BDF instead of Adams.
        """
        return self._once(("steps", steps, tolerance, stiff), lambda: self._integrator(steps, tolerance, stiff))

    def _integrator(self, steps: int, tolerance: float, stiff: bool) -> BufferedFunction:
        ode, quad = (self.span * part for part in self._flow)
        problem = {"x": self.x, "p": self.parameters, "t": self.tau, "ode": ode, "quad": quad}
        # Adams: between the switches the motion is smooth; measured a quarter faster than BDF, in contact as well as apart.
        # In a contact that lasts for many of its vibrations these have decayed: then only BDF takes steps of the motion's scale.
        options: dict[str, Any] = {
            "linear_multistep_method": "bdf" if stiff else "adams",
            "quad_err_con": True,  # the works are as accurate as the motion
            "reltol": tolerance,
            "abstol": 1e-3 * tolerance,
            "max_num_steps": 200_000 if stiff else 20_000,  # per row; a hundred are typical
        }
        grid = [(i + 1.0) / steps for i in range(steps)]
        x, p = casadi.MX.sym("x", self.x.numel()), casadi.MX.sym("p", self.parameters.numel())
        result = casadi.integrator("motion", "cvodes", problem, 0.0, grid, options)(x0=x, p=p)
        return BufferedFunction(casadi.Function("steps", [x, p], [result["xf"], result["qf"]]))
