"""Named columns of a machine with joint clearance: motion, clearance, contacts, reactions, torque, energies."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from optlink.clearance.equations import ClearanceState, Equations, Pin
from optlink.clearance.integration import Block
from optlink.clearance.joint import Touch, acting
from optlink.dynamics.columns import Column, joint_forces
from optlink.dynamics.inverse import GuideForce
from optlink.dynamics.machine import Machine, Moving, Wrench, slider_names
from optlink.linkage.mechanism import FRAME, Guide
from optlink.linkage.vector2d import Array, Value, Vector, angle, cross, dot, max_magnitude, minus, plus, wrapped


class ClearanceColumns:
    """Columns by name of the rows of a motion, each (m,).

    `further` (m,) [rad] is the feedback correction of the crank angle beyond the command at each row.
    """

    def __init__(self, equations: Equations, block: Block, further: Array) -> None:
        self.equations, self.block = equations, block
        n, count = equations.size, len(block.time)
        parameters = np.column_stack([np.zeros(count), block.time, further, block.entered, block.modes])
        values = equations.dynamics(count)(block.states.ravel(), parameters.ravel(), np.zeros(count))
        accelerations, self.torque, self.pull = values[0].reshape(count, n), values[1], values[2].reshape(count, -1)
        self.motion: ClearanceState = equations.state(block.states[:, :n].T, block.states[:, n:].T, accelerations.T)
        self.touches: list[Touch] = equations.touches(self.motion, block.entered.T, block.modes.T)
        self.pins: dict[str, dict[str, Vector]] = {}
        self.guides: dict[str, GuideForce] = {}
        self._balance()

    # --- reactions ---------------------------------------------------------------------------------------------------

    def _balance(self) -> None:
        """Compute the forces in the ideal joints: first the closing joints, then body by body from the leaves of the tree."""
        moving, cut = self.motion, self.equations.tree
        self.needed = moving.needed()  # by the joints that are not computed yet
        forces = [exerted for of_load in moving.acting().values() for exerted in of_load]
        for gap, contact in zip(self.equations.gaps, self.touches, strict=True):
            both = acting(gap, moving.journal_motion(gap), moving.position(gap.point, gap.journal), contact)
            forces += both
            for exerted in both:
                self._exert(gap.point, exerted.body, exerted.force)
        for exerted in forces:
            if exerted.body != FRAME:
                self._need(exerted.body, exerted.wrench(moving.state(exerted.body)))
        for i, joint in enumerate(cut.closing):
            a, b = -self.pull[:, 2 * i], -self.pull[:, 2 * i + 1]
            if isinstance(joint, Guide):
                x, y = moving.line(joint.name)
                self._apply_joint_force(joint, (-a * y, a * x), b)
            else:
                self._apply_joint_force(joint, (a, b), 0.0)
        for body, _, branch_joint in reversed(cut.branches):
            if branch_joint is not None:
                total = self.needed[body]
                force, moment = total.force, total.about(moving.state(body).start, self._joint(branch_joint))
                sign = 1.0 if body == branch_joint.bodies[0] else -1.0
                self._apply_joint_force(branch_joint, (sign * force[0], sign * force[1]), sign * moment, skip=body)

    def _joint(self, joint: Pin | Guide) -> Vector:
        """Point at which a joint acts: the pin, or the slider's point."""
        if isinstance(joint, Guide):
            return self.equations.tree.line(joint, joint.slider, self.motion.state(joint.slider))[0]
        return self.motion.position(joint.point, joint.first)

    def _apply_joint_force(self, joint: Pin | Guide, force: Vector, moment: Value, skip: str = "") -> None:
        """Apply the force and moment of a joint to its first body, and the opposite to its second."""
        at = self._joint(joint)
        for body, sign in zip(joint.bodies, (1.0, -1.0), strict=True):
            force_on_body = (sign * force[0], sign * force[1])
            if isinstance(joint, Pin):
                self._exert(joint.point, body, force_on_body)
            elif sign > 0.0:
                line = self.motion.line(joint.name)
                self.guides[joint.name] = GuideForce(
                    cross(line, force_on_body), dot(line, force_on_body), moment, at, force_on_body
                )
            if body not in (FRAME, skip):
                lever = minus(at, self.motion.state(body).start)
                turned = sign * moment if isinstance(joint, Guide) else 0.0
                self._need(body, Wrench(force_on_body, turned + cross(lever, force_on_body)))

    def _need(self, body: str, wrench: Wrench) -> None:
        """Subtract a wrench that acts on a body from what its other joints must exert."""
        (x, y), moment = wrench
        self.needed[body] += Wrench((-x, -y), -moment)

    def _exert(self, point: str, body: str, force: Vector) -> None:
        forces = self.pins.setdefault(point, {})
        forces[body] = plus(forces[body], force) if body in forces else force

    # --- columns -----------------------------------------------------------------------------------------------------

    @property
    def columns(self) -> dict[str, Column]:
        """All columns by name."""
        shape = self.block.time.shape
        parts = self._motion(), self._gaps(), self._forces(), self._energies()
        return {
            name: Column(name, meaning, np.broadcast_to(np.asarray(value, dtype=float), shape))
            for name, meaning, value in itertools.chain.from_iterable(parts)
        }

    def _motion(self) -> Iterator[tuple[str, str, Value]]:
        moving, mechanism = self.motion, self.equations.tree.mechanism
        yield "time_s", "time", self.block.time
        yield "crank_angle_deg", "crank angle", np.degrees(moving.crank.value)
        for body in mechanism.bodies:
            state = moving.state(body)
            own, coordinates = (body, "angle"), self.equations.tree.coordinates
            known = own in coordinates  # then it is not wrapped
            angle = self.block.states[:, coordinates.index(own)] if known else np.arctan2(state.axis[1], state.axis[0])
            yield f"{body}.angle_rad", f"angle of {body}'s axis from +x", angle
            yield f"{body}.omega_rad_s", f"angular velocity of {body}", state.omega
            yield f"{body}.alpha_rad_s2", f"angular acceleration of {body}", state.alpha
        gaps = {gap.point: gap for gap in self.equations.gaps}
        for point, bodies in mechanism.owners.items():
            if FRAME in bodies and point not in gaps:
                continue
            for body in (gaps[point].journal, gaps[point].bearing) if point in gaps else bodies[:1]:
                if body != FRAME:
                    name, words = (f"{point}.{body}", f"{point} on {body}") if point in gaps else (point, point)
                    for axis, value in zip("xy", moving.position(point, body), strict=True):
                        yield f"{name}.{axis}_m", f"position of {words} in {axis}", value
        names = slider_names(self.equations.machine)
        for guide, (s, v, a) in moving.slides.items():
            yield f"{names[guide]}.s_m", f"slide in the guide {guide}", s
            yield f"{names[guide]}.v_m_s", f"sliding velocity in the guide {guide}", v
            yield f"{names[guide]}.a_m_s2", f"sliding acceleration in the guide {guide}", a

    def _gaps(self) -> Iterator[tuple[str, str, Value]]:
        for gap, contact, mode in zip(self.equations.gaps, self.touches, self.block.modes.T, strict=True):
            journal, name = self.motion.journal_motion(gap), gap.point
            for axis, value in zip("xy", journal.eccentricity, strict=True):
                yield f"{name}.e{axis}_m", f"journal's centre relative to the bearing's at {name} in {axis}", value
            yield f"{name}.contact", f"1 if journal and bearing are in contact at {name}, otherwise 0", mode
            yield f"{name}.penetration_m", f"penetration at {name}; negative: remaining gap", contact.penetration
            yield f"{name}.approach_m_s", f"rate of the penetration at {name}", contact.rate
            yield f"{name}.normal_N", f"normal force at {name}", contact.normal
            yield f"{name}.rub_N", f"friction at {name} on the journal, counter-clockwise", contact.friction
            yield f"{name}.slip_m_s", f"slip of the journal's surface at {name}", contact.slip

    def _forces(self) -> Iterator[tuple[str, str, Value]]:
        machine = self.equations.machine
        yield from joint_forces(machine, self.pins, self.guides)
        yield "input.torque_Nm", f"torque of the drive on {machine.mechanism.crank.body}", self.torque
        yield "input.power_W", "power of the drive", self.torque * self.motion.crank.rate

    def _energies(self) -> Iterator[tuple[str, str, Value]]:
        yield "energy.kinetic_J", "kinetic energy", self.motion.kinetic
        yield "energy.potential_J", "potential energy of gravity, zero at y = 0", self.motion.potential
        yield "energy.contact_J", "elastic energy of the contacts", self._elastic
        for name, values in zip(self.equations.losses, self.block.works.T, strict=True):
            yield f"work.{name}_J", _work(name), values

    @property
    def _elastic(self) -> Value:
        return sum(contact.elastic for contact in self.touches)

    @property
    def energy(self) -> Array:
        """Sum of kinetic energy, potential energy of gravity and elastic energy of the contacts [J]."""
        return np.asarray(self.motion.kinetic + self.motion.potential + self._elastic + 0.0 * self.block.time)


def _work(name: str) -> str:
    point, _, kind = name.rpartition(".")
    if kind == "impact" and point:
        return f"energy lost at {point} by the damping of the contact"
    if kind == "friction" and point:
        return f"energy lost at {point} by friction"
    return "work of the drive" if name == "drive" else f"work of the load {name}"


# Output of a machine: the slide of a slider or the angle of a body, and its deviation from the ideal motion.


@dataclass(frozen=True)
class Output:
    """Output of a machine: the slide in a `guide`, or, without a guide, the angle of a body."""

    name: str
    guide: str = ""

    @property
    def unit(self) -> str:
        """SI unit: m or rad."""
        return "m" if self.guide else "rad"

    @property
    def column(self) -> str:
        """Name of the column in tables."""
        return f"{self.name}.s_m" if self.guide else f"{self.name}.angle_rad"

    @property
    def error(self) -> str:
        """Name of the column of the deviation from the machine without clearance."""
        return f"{self.name}.error_{self.unit}"

    def of(self, with_clearance: ClearanceState) -> Value:
        """Return the output [m, rad]; an angle lies in (-pi, pi]."""
        return with_clearance.slides[self.guide][0] if self.guide else angle(with_clearance.state(self.name).axis)

    def ideal(self, moving: Moving) -> tuple[Value, Value]:
        """Return the output of the machine without clearance [m, rad], and its velocity."""
        if self.guide:
            return moving.slides[self.guide][:2]
        state = moving.state(self.name)
        return angle(state.axis), state.omega

    def difference(self, value: Value, ideal: Value) -> Value:
        """Return the deviation of a value from a target [m, rad]; that of an angle is wrapped to (-pi, pi]."""
        return value - ideal if self.guide else wrapped(value - ideal)


def outputs(machine: Machine) -> dict[str, Output]:
    """Return the possible outputs by name: sliders in their guides, and the angles of other bodies."""
    sliding = {name: Output(name, guide) for guide, name in slider_names(machine).items()}
    turning = {body: Output(body) for body in machine.mechanism.bodies if body != machine.mechanism.crank.body}
    return {**turning, **sliding}


def default_output(machine: Machine) -> Output:
    """Return the default output: the last slider on the frame, else the last body that is pinned to the frame."""
    available = outputs(machine)
    names = slider_names(machine)
    rams = [names[guide.name] for guide in machine.mechanism.guides if FRAME in guide.bodies]
    if rams:
        return available[rams[-1]]
    pinned = {body for bodies in machine.mechanism.pins.values() if FRAME in bodies for body in bodies}
    moving = [link.body for link in machine.mechanism.links[1:]]
    return available[next((body for body in reversed(moving) if body in pinned), moving[-1])]


# Comparison of a measured series with the simulated output: the series ends in the last simulated revolution.


@dataclass(frozen=True, eq=False)
class MeasuredComparison:
    """Rows of a measured series beside the simulation, each (n,): time of the simulation [s], outputs [m, rad]."""

    time: Array
    measured: Array
    simulated: Array
    ideal: Array
    output: Output

    @property
    def difference(self) -> Array:
        """Measured minus simulated output [m, rad]."""
        return np.asarray(self.output.difference(self.measured, self.simulated))

    @property
    def columns(self) -> dict[str, Array]:
        """The rows by name, with their units."""
        unit = self.output.unit
        names = {"measured": self.measured, "simulated": self.simulated, "ideal": self.ideal, "difference": self.difference}
        return {"time_s": self.time, **{f"{name}_{unit}": values for name, values in names.items()}}

    @property
    def figures(self) -> dict[str, float]:
        """Root mean square, largest and mean difference from the simulation, and from the machine without clearance."""
        unit, found = self.output.unit, {"measured.rows": float(len(self.time))}
        without = np.asarray(self.output.difference(self.measured, self.ideal))
        for name, values in (("measured", self.difference), ("measured.ideal", without)):
            found[f"{name}.rms_{unit}"] = math.sqrt(float(np.mean(values * values)))
            found[f"{name}.peak_{unit}"] = max_magnitude(values)
            found[f"{name}.mean_{unit}"] = float(np.mean(values))
        return found


def measured_comparison(
    times: Sequence[float],
    measured: Sequence[float],
    rows: Mapping[str, Array],
    output: Output,
    period: float,
    counted: tuple[int, int],
) -> MeasuredComparison | None:
    """Compare a measured series [s; m, rad] with the rows of a simulation; None if no row of the series lies within them.

    The times of the series, from the start angle of the crank, are moved by whole revolutions of duration `period` [s], so that
    the last one lies in the last simulated revolution. `counted`: numbers of revolutions before the counted ones, and of all
    simulated ones; other rows of the series are left out.
    """
    time, values = rows["time_s"], rows[output.column]
    rate = rows[f"{output.name}.v_m_s" if output.guide else f"{output.name}.omega_rad_s"]
    values = values if output.guide else np.unwrap(values)
    begin, end = counted[0] * period, counted[1] * period
    at = np.asarray(times, dtype=float)
    at = at + period * math.floor((end - np.max(at)) / period + 1e-6)
    near = 1e-6 * period
    within = (at > begin + near) & (at >= float(time[0]) - near) & (at <= float(time[-1]) + near)
    if not np.any(within):
        return None
    at = np.clip(at[within], time[0], time[-1])
    simulated = np.asarray(CubicHermiteSpline(time, values, rate)(at))
    error = np.interp(at, time, rows[output.error])
    return MeasuredComparison(at, np.asarray(measured, dtype=float)[within], simulated, simulated - error, output)
