"""The inverse model: which motion of the crank gives the wanted output, once the journals lie where they are predicted to lie.

In a bearing with play the journal lies where the load presses it: against the reaction that the ideal machine would have there,
turned by the angle of friction, at the clearance and the penetration of that load. The loops are closed with these gap vectors,
and the crank is turned so that the output is the wanted one. At a dead centre no turn of the crank moves the output, and no drive
turns at any rate: so the turn is a Fourier series up to a bandwidth, found as a whole by least squares, and weighed against the
output. Its derivative, the speed command, is that of the series.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.clearance.equations import Servo
from optlink.clearance.joint import Gap
from optlink.clearance.output import Output
from optlink.clearance.reference_signal import Command
from optlink.clearance.spanning_tree import Cut
from optlink.clearance.state import Loose
from optlink.dynamics.inverse import reactions
from optlink.dynamics.machine import Machine, parts
from optlink.linkage.jet import Jet
from optlink.symbolic import Compiled, tracing

Array = NDArray[np.float64]
POINTS = 720
ROUNDS = 60
HIGHEST = 60  # harmonics of a correction, at most


def predicted(machine: Machine, gaps: Sequence[Gap], angles: Array, speed: float) -> Array:
    """Where the journals lie (angles, 2 gaps) [m] while the machine moves at constant speed: x, y of each gap vector.

    Source: quasi-static contact in the direction of the ideal joint's reaction.
    """
    moving = machine.moving(angles, speed)
    found = reactions(moving)
    columns = []
    for gap in gaps:
        x, y = (np.broadcast_to(part, angles.shape) for part in found.pins[gap.point][gap.journal])
        load = np.hypot(x, y)
        away = gap.clearance + (load / gap.stiffness) ** (2.0 / 3.0)
        # the journal is pushed by (-normal, friction): the reaction leans against the slip by the angle of friction
        slip = gap.radius * (moving.state(gap.journal).omega - moving.state(gap.bearing).omega)
        lean = np.arctan(gap.friction * np.tanh(slip / gap.slip_speed))
        c, s = np.cos(lean), np.sin(lean)
        columns += [-away * (x * c + y * s) / load, -away * (y * c - x * s) / load]
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


class Inverse:
    """Loop closure of a machine with known gaps, at `POINTS` positions of a revolution at once."""

    def __init__(self, machine: Machine, gaps: Sequence[Gap], output: Output, start: float, speed: float) -> None:
        self.output, self.start, self.speed = output, start, speed
        self.cut = Cut(machine.mechanism, machine.sizes, {gap.point: gap.journal for gap in gaps})
        self.size, crank = len(self.cut.coordinates), self.cut.driven
        self.free = [i for i in range(self.size) if i != crank]
        with tracing():
            q, e = casadi.SX.sym("q", self.size), casadi.SX.sym("e", 2 * len(gaps))
            loose = Loose(machine, self.cut, [Jet(value) for value in casadi.vertsplit(q)], speed)
            apart = [loose.play(gap).eccentricity for gap in gaps]
            missing = [value - e[i] for i, value in enumerate(part for pair in apart for part in pair)]
            missing += [parts(value)[0] for value in self.cut.open(loose.places)]
            value, gone = output.of(loose), casadi.vertcat(*missing)
            results = [gone, casadi.jacobian(gone, q), value, casadi.jacobian(value, q)]
            self._loops = Compiled([q, e], results, POINTS)
        self.angles: Array = np.asarray(start + np.sign(speed) * np.linspace(0.0, 2.0 * np.pi, POINTS, endpoint=False))
        moving = machine.moving(self.angles, speed)
        self.wanted = np.asarray(output.ideal(moving)[0])
        self._ideal = np.stack([np.broadcast_to(parts(c)[0], (POINTS,)) for c in self.cut.read(moving.pose)], axis=-1)
        self.gaps: Array = predicted(machine, gaps, self.angles, speed)

    def close(self, crank: Array) -> tuple[Array, Array]:
        """Output at these crank angles (POINTS,) with the predicted gap vectors, and its derivative over the crank angle."""
        q = self._ideal.copy()
        q[:, self.cut.driven] = crank
        for _ in range(ROUNDS):
            gone, slopes, value, gradient = self._loops(q.ravel(), self.gaps.ravel())
            gone = gone.reshape(POINTS, -1)
            slopes = slopes.reshape(POINTS, self.size, -1).transpose(0, 2, 1)
            if np.max(np.abs(gone), initial=0.0) < 1e-13:
                break
            q[:, self.free] -= np.linalg.solve(slopes[:, :, self.free], gone[:, :, None])[:, :, 0]
        gradient = gradient.reshape(POINTS, self.size)
        follow = -np.linalg.solve(slopes[:, :, self.free], slopes[:, :, self.cut.driven, None])[:, :, 0]
        return value, gradient[:, self.cut.driven] + np.sum(gradient[:, self.free] * follow, axis=1)

    def solve(self, regularisation: float, order: int) -> NDArray[np.complex128]:
        """Harmonics (order + 1,) of the correction of the crank angle [rad] that brings the output nearest to what is wanted.

        It minimises the mean of (output - wanted)^2 + (regularisation * correction)^2 over the revolution, among all corrections
        of these harmonics: where the output stands still it is the other positions that decide. Gauss-Newton, exact slopes.
        """
        phase = 2.0 * np.pi * np.arange(POINTS) / POINTS
        waves = [wave(k * phase) for k in range(1, order + 1) for wave in (np.cos, np.sin)]
        basis = np.stack([np.ones(POINTS), *waves], axis=-1)
        shares = np.zeros(basis.shape[1])
        for _ in range(ROUNDS):
            turned = basis @ shares
            value, slope = self.close(self.angles + turned)
            missing = -self.output.difference(value, self.wanted)
            rows = np.vstack([slope[:, None] * basis, regularisation * basis])
            step = np.linalg.lstsq(rows, np.concatenate([missing, -regularisation * turned]), rcond=None)[0]
            shares = shares + step
            if np.max(np.abs(step)) < 1e-11:
                break
        return np.concatenate([shares[:1], shares[1::2] - 1j * shares[2::2]])

    def command(self, regularisation: float, servo: Servo, bandwidth: float) -> Command:
        """The crank's command: the correction up to `bandwidth` [rad/s], ahead of what the servo will make of it.

        A correction that is too lively shakes the machine so that the journals lie elsewhere than predicted.
        """
        order = min(HIGHEST, max(1, int(bandwidth / abs(self.speed) + 1e-9)))
        s = 1j * np.arange(order + 1) * abs(self.speed)
        follows = 2.0 * servo.damping * servo.bandwidth * s + servo.bandwidth**2
        return Command(self.start, self.speed, self.solve(regularisation, order) * (s * s + follows) / follows)


def leverage(machine: Machine, output: Output, angles: Array, regularisation: float) -> Array:
    """Turn of the crank per change of the output [rad/m, 1] at crank angles (n,), regularised where the output stands still."""
    slope = np.broadcast_to(output.ideal(machine.moving(angles))[1], angles.shape)
    found: Array = slope / (slope * slope + regularisation * regularisation)
    return found
