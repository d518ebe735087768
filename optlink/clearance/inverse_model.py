"""Inverse model: the crank motion that gives the target output, with the journals at their predicted positions.

In a bearing with clearance the load determines the position of the journal: opposite to the reaction of the ideal machine,
rotated by the friction angle, at the distance of clearance plus penetration under that load. The loops are closed with these gap
vectors, and the crank angle is corrected so that the output has its target value. At a dead centre the crank does not move the
output, and no drive has unlimited bandwidth: therefore the correction is a Fourier series up to a bandwidth, computed by
regularised least squares over the whole revolution. The speed command is the derivative of the series.
"""

from collections.abc import Sequence

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.clearance.equations import Servo
from optlink.clearance.joint import Gap
from optlink.clearance.output import Output
from optlink.clearance.reference_signal import ReferenceSignal
from optlink.clearance.spanning_tree import SpanningTree
from optlink.clearance.state import ClearanceState
from optlink.dynamics.inverse import reactions
from optlink.dynamics.machine import Machine
from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.vector2d import Array
from optlink.symbolic import CompiledFunction, symbols_in_numpy

POINTS = 720
ROUNDS = 60
HIGHEST = 60  # maximum harmonic of a correction


def predicted(machine: Machine, gaps: Sequence[Gap], angles: Array, speed: float) -> Array:
    """Predict the gap vectors (angles, 2 gaps) [m] at crank angles [rad] and a constant speed [rad/s].

    They are x, y of each journal relative to its bearing, in quasi-static contact along the ideal joint's reaction.
    """
    moving = machine.moving(angles, speed)
    joint_reactions = reactions(moving)
    columns = []
    for gap in gaps:
        x, y = (np.broadcast_to(part, angles.shape) for part in joint_reactions.pins[gap.point][gap.journal])
        load = np.hypot(x, y)
        away = gap.clearance + (load / gap.stiffness) ** (2.0 / 3.0)
        # the journal is pushed by (-normal, friction): the reaction leans against the slip by the angle of friction
        slip = gap.radius * (moving.state(gap.journal).omega - moving.state(gap.bearing).omega)
        lean = np.arctan(gap.friction * np.tanh(slip / gap.slip_speed))
        c, s = np.cos(lean), np.sin(lean)
        columns += [-away * (x * c + y * s) / load, -away * (y * c - x * s) / load]
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


class Inverse:
    """Loop closure of a machine with prescribed gap vectors, at `POINTS` positions of a revolution at once.

    The `target` of the output at these positions is that of the machine without clearance.
    """

    def __init__(self, machine: Machine, gaps: Sequence[Gap], output: Output, start: float, speed: float) -> None:
        self.output, self.start, self.speed = output, start, speed
        self.tree = SpanningTree(machine.mechanism, machine.sizes, {gap.point: gap.journal for gap in gaps})
        self.size, crank = len(self.tree.coordinates), self.tree.driven
        self.free = [i for i in range(self.size) if i != crank]
        with symbols_in_numpy():
            q, e = casadi.SX.sym("q", self.size), casadi.SX.sym("e", 2 * len(gaps))
            moved = ClearanceState(machine, self.tree, [Jet(value) for value in casadi.vertsplit(q)], speed)
            apart = [moved.journal_motion(gap).eccentricity for gap in gaps]
            missing = [value - e[i] for i, value in enumerate(part for pair in apart for part in pair)]
            missing += [as_jet(value).value for value in self.tree.open(moved.places)]
            value, residuals = output.of(moved), casadi.vertcat(*missing)
            results = [residuals, casadi.jacobian(residuals, q), value, casadi.jacobian(value, q)]
            self._loops = CompiledFunction([q, e], results, POINTS)
        self.angles: Array = np.asarray(start + np.sign(speed) * np.linspace(0.0, 2.0 * np.pi, POINTS, endpoint=False))
        moving = machine.moving(self.angles, speed)
        self.target = np.asarray(output.ideal(moving)[0])
        self._ideal = np.stack([np.broadcast_to(as_jet(c).value, (POINTS,)) for c in self.tree.read(moving.pose)], axis=-1)
        self.gaps: Array = predicted(machine, gaps, self.angles, speed)

    def close(self, crank: Array) -> tuple[Array, Array]:
        """Return the output at crank angles (POINTS,) with the predicted gap vectors, and its derivative over the crank angle."""
        q = self._ideal.copy()
        q[:, self.tree.driven] = crank
        for _ in range(ROUNDS):
            residuals, slopes, value, gradient = self._loops(q.ravel(), self.gaps.ravel())
            residuals = residuals.reshape(POINTS, -1)
            slopes = slopes.reshape(POINTS, self.size, -1).transpose(0, 2, 1)
            if np.max(np.abs(residuals), initial=0.0) < 1e-13:
                break
            q[:, self.free] -= np.linalg.solve(slopes[:, :, self.free], residuals[:, :, None])[:, :, 0]
        gradient = gradient.reshape(POINTS, self.size)
        follow = -np.linalg.solve(slopes[:, :, self.free], slopes[:, :, self.tree.driven, None])[:, :, 0]
        return value, gradient[:, self.tree.driven] + np.sum(gradient[:, self.free] * follow, axis=1)

    def solve(self, regularisation: float, order: int) -> NDArray[np.complex128]:
        """Compute the harmonics (order + 1,) of the crank angle correction [rad] that brings the output closest to its target.

        It minimises the mean of (output - target)^2 + (regularisation * correction)^2 over the revolution among all corrections
        up to the harmonic `order`; near dead centres of the output the other positions determine it. Gauss-Newton with exact
        derivatives. The unit of the regularisation is m/rad or 1.
        """
        phase = 2.0 * np.pi * np.arange(POINTS) / POINTS
        waves = [wave(k * phase) for k in range(1, order + 1) for wave in (np.cos, np.sin)]
        basis = np.stack([np.ones(POINTS), *waves], axis=-1)
        shares = np.zeros(basis.shape[1])
        for _ in range(ROUNDS):
            turned = basis @ shares
            value, slope = self.close(self.angles + turned)
            missing = -self.output.difference(value, self.target)
            normal = basis.T @ ((slope**2 + regularisation**2)[:, None] * basis)  # well conditioned: waves are orthogonal
            step = np.linalg.lstsq(normal, basis.T @ (slope * missing - regularisation**2 * turned), rcond=None)[0]
            shares = shares + step
            if np.max(np.abs(step)) < 1e-11:
                break
        return np.concatenate([shares[:1], shares[1::2] - 1j * shares[2::2]])

    def motion(self, regularisation: float, bandwidth: float) -> tuple[Array, Array, Array, Array, Array]:
        """Return time [s], target, crank angle [rad], crank speed [rad/s] and reached output at the positions, each (POINTS,).

        `bandwidth` [rad/s] is the highest frequency of the correction.
        """
        signal = ReferenceSignal(self.start, self.speed, self.solve(regularisation, self._order(bandwidth)))
        time: Array = np.asarray(2.0 * np.pi / (POINTS * abs(self.speed)) * np.arange(POINTS))
        angle, speed = map(np.asarray, signal.at(time))
        return time, self.target, angle, speed, self.close(angle)[0]

    def _order(self, bandwidth: float) -> int:
        """Number of harmonics up to a frequency [rad/s]."""
        return int(min(HIGHEST, max(1.0, bandwidth / abs(self.speed) + 1e-9)))

    def reference_signal(self, regularisation: float, servo: Servo, bandwidth: float) -> ReferenceSignal:
        """Return the crank command: the correction up to a bandwidth, multiplied by the inverse transfer function of the servo.

        A correction of too high a bandwidth [rad/s] excites the machine so that the journals leave their predicted positions.
        """
        order = self._order(bandwidth)
        s = 1j * np.arange(order + 1) * abs(self.speed)
        follows = 2.0 * servo.damping * servo.bandwidth * s + servo.bandwidth**2
        return ReferenceSignal(self.start, self.speed, self.solve(regularisation, order) * (s * s + follows) / follows)


def leverage(machine: Machine, output: Output, angles: Array, regularisation: float) -> Array:
    """Return the crank rotation per change of the output [rad/m, -] at crank angles (n,) [rad].

    It is reduced near dead centres, at slopes of the output below the regularisation.
    """
    slope = np.broadcast_to(output.ideal(machine.moving(angles))[1], angles.shape)
    return np.asarray(slope / (slope * slope + regularisation * regularisation))
