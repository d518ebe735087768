"""Equations of motion of a machine with joint clearance, traced with casadi and compiled for its integrator.

The unknowns are the accelerations of the coordinates of the spanning tree, and the forces in the loop-closing joints (index 1):

    [M  C'] [a]   [Q - h]
    [C  0 ] [-f] = [-c   ]

Where the motion of the crank is prescribed (a servo follows a command, or the speed is constant) its row gives the drive torque.

References
----------
Newton-Euler equations by virtual power; wrenches and positions are those of the ideal machine.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import casadi
import numpy as np

from optlink.clearance.joint import Gap, Touch, acting, touch
from optlink.clearance.reference_signal import ReferenceSignal
from optlink.clearance.spanning_tree import SpanningTree
from optlink.clearance.state import ClearanceState
from optlink.dynamics.loads import Magnitude
from optlink.dynamics.machine import Machine
from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.vector2d import Array
from optlink.symbolic import BufferedFunction, CompiledFunction, symbols_in_numpy

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
    def _short_step(self) -> CompiledFunction:
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

    def nudge(self, state: Array, parameters: Array, time: float) -> tuple[Array, Array]:
        """Return state and works [J] after a time [s] too short for the integrator, by one classical Runge-Kutta step.

        The time may be negative; the span in the parameters is ignored.
        """
        moved, works = self._short_step(state, parameters, np.array([time]))
        return moved, works

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
