"""Named columns of a machine in motion: motion, reactions, torque, energies."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.inverse import Reactions, acting_on, reactions, shaking, torque_parts
from optlink.dynamics.machine import Machine, Moving
from optlink.linkage.dyad_types import RRR
from optlink.linkage.mechanism import FRAME
from optlink.linkage.vector2d import Value, cross, dot, magnitude, minus

Array = NDArray[np.float64]
SINGULAR = 1e-7
"""Sine below which a group counts as singular: its reactions are rounding errors."""


class Column(NamedTuple):
    """A column of the record: its name (ending in the unit), its meaning and its values."""

    name: str
    meaning: str
    values: Array


class MotionColumns:
    """Columns by name of a machine at crank angles (n,), or of a batch of designs (designs, n).

    `singular`: positions without finite reactions; `jammed`: positions in which friction locks a guide; `undefined`: positions in
    which a load has no finite value; `reaction_names`: names of the reaction columns. `requested`: names of the required columns,
    default all.
    """

    def __init__(self, moving: Moving, requested: Collection[str] | None = None) -> None:
        self.moving, self.machine, self.requested = moving, moving.machine, requested
        self.shape = np.shape(moving.motion.assembled)
        self.reaction_names: set[str] = set()
        with np.errstate(all="ignore"):
            self.reactions: Reactions = reactions(moving)
            near = [np.abs(self.full(sine)) < SINGULAR for sine in self.reactions.singularity.values()]
            closed = moving.motion.assembled
            self.jammed = self.full(self.reactions.jammed).astype(bool) & closed
            self.singular: NDArray[np.bool_] = np.any([*near, np.zeros(self.shape)], axis=0) & closed
            self.undefined = ~np.isfinite(self.full(self.reactions.torque)) & closed & ~self.jammed & ~self.singular
            self.columns = {column.name: column for column in self._all() if self._wants(column.name)}

    def _wants(self, *names: str) -> bool:
        return self.requested is None or any(name in self.requested for name in names)

    def full(self, value: Value) -> Array:
        """Broadcast a value to all positions."""
        return np.broadcast_to(np.asarray(value, dtype=float), self.shape)

    def __getitem__(self, name: str) -> Array:
        return self.columns[name].values

    def _all(self) -> Iterator[Column]:
        for name, meaning, value in self._motion():
            yield Column(name, meaning, self.full(value))
        for name, meaning, value in self._reactions():
            self.reaction_names.add(name)
            yield Column(name, meaning, np.where(self.singular, np.nan, self.full(value)))
        unknown = self.singular & (not self.machine.mechanism.followed)
        for name, meaning, value in self._forces():
            yield Column(name, meaning, np.where(unknown, np.nan, self.full(value)))

    def _motion(self) -> Iterator[tuple[str, str, Value]]:
        moving, mechanism = self.moving, self.machine.mechanism
        for body in mechanism.bodies:
            state = moving.state(body)
            if self._wants(f"{body}.angle_rad"):
                yield f"{body}.angle_rad", f"angle of {body}'s axis from +x", moving.motion.body_angle(body).value
            yield f"{body}.omega_rad_s", f"angular velocity of {body}", state.omega
            yield f"{body}.alpha_rad_s2", f"angular acceleration of {body}", state.alpha
        for point, bodies in mechanism.owners.items():
            if FRAME not in bodies:
                for part, unit, vector in (
                    ("", "m", moving.position(point)),
                    ("v", "m_s", moving.velocity(point)),
                    ("a", "m_s2", moving.acceleration(point)),
                ):
                    what = {"": "position", "v": "velocity", "a": "acceleration"}[part]
                    for axis, value in zip("xy", vector, strict=True):
                        yield f"{point}.{part}{axis}_{unit}", f"{what} of {point} in {axis}", value
        names = slider_names(self.machine)
        for guide, (s, v, a) in moving.slides.items():
            yield f"{names[guide]}.s_m", f"slide in the guide {guide}", s
            yield f"{names[guide]}.v_m_s", f"sliding velocity in the guide {guide}", v
            yield f"{names[guide]}.a_m_s2", f"sliding acceleration in the guide {guide}", a
        for group in mechanism.groups:
            if isinstance(group, RRR) and self._wants(f"{group.joint}.transmission_rad"):
                j = moving.position(group.joint)
                p, q = (minus(moving.position(pin), j) for pin in group.pins)
                yield (
                    f"{group.joint}.transmission_rad",
                    f"angle between the two links at {group.joint}",
                    np.arctan2(magnitude(cross(p, q)), dot(p, q)),
                )

    def _reactions(self) -> Iterator[tuple[str, str, Value]]:
        machine, found = self.machine, self.reactions
        for point, (by, on) in acting_on(machine).items():
            bodies = machine.mechanism.pins[point]
            if len(bodies) == 2:
                for axis, value in zip("xy", found.pins[point][on], strict=True):
                    yield f"{point}.f{axis}_N", f"force of {by} on {on} at {point} in {axis}", value
            else:
                for body in (on, *(b for b in bodies if b != on)):
                    for axis, value in zip("xy", found.pins[point][body], strict=True):
                        yield f"{point}.{body}.f{axis}_N", f"force of the pin on {body} at {point} in {axis}", value
        for guide in machine.mechanism.guides:
            force = found.guides[guide.name]
            what = f"of {guide.on} on {guide.slider} in the guide {guide.name}"
            yield f"{guide.name}.normal_N", f"normal force {what}, to the left of the line", force.normal
            yield f"{guide.name}.moment_Nm", f"moment {what}", force.moment
            if guide.name in machine.friction:
                yield f"{guide.name}.friction_N", f"friction {what}, along the line", force.friction

    def _forces(self) -> Iterator[tuple[str, str, Value]]:
        moving, machine, found = self.moving, self.machine, self.reactions
        for load in machine.loads:
            for k, acting in enumerate(act for act in load.act(moving) if act.body != FRAME):
                name = f"{load.name}.{acting.body}" if k else load.name
                if not _nothing(acting.force):
                    for axis, value in zip("xy", acting.force, strict=True):
                        yield f"{name}.f{axis}_N", f"force of the load {load.name} on {acting.body} in {axis}", value
                if not _nothing((acting.torque, 0.0)):
                    yield f"{name}.torque_Nm", f"torque of the load {load.name} on {acting.body}", acting.torque
        torque = found.torque
        yield "input.torque_Nm", f"torque of the drive on {machine.mechanism.crank.body}", torque
        parts = ("inertia", "gravity", "load")
        if self._wants(*(f"input.torque_{part}_Nm" for part in parts)):
            for part, value in torque_parts(moving, found).items():
                yield f"input.torque_{part}_Nm", f"what of the driving torque goes into {part}", value
        yield "input.power_W", "power of the drive", torque * moving.motion.speed
        if self._wants(*(f"frame.shaking_{part}" for part in ("fx_N", "fy_N", "moment_Nm"))):
            yield from self._shaking()
        if self._wants("energy.kinetic_J", "energy.potential_J"):
            yield "energy.kinetic_J", "kinetic energy", moving.kinetic
            yield "energy.potential_J", "potential energy of gravity and springs, gravity's zero at y = 0", moving.potential

    def _shaking(self) -> Iterator[tuple[str, str, Value]]:
        shaken, pivot = shaking(self.moving), self.machine.mechanism.crank.start
        for axis, value in zip("xy", shaken.force, strict=True):
            yield f"frame.shaking_f{axis}_N", f"shaking force on the frame in {axis}: minus the rate of momentum", value
        yield "frame.shaking_moment_Nm", f"shaking moment on the frame about {pivot}", shaken.moment


def _nothing(parts: tuple[Any, Any]) -> bool:
    return all(isinstance(part, float) and part == 0.0 for part in parts)


def slider_names(machine: Machine) -> dict[str, str]:
    """Return the name of the slide of every guide: the slider's name, or the guide's name where one body slides in two guides."""
    sliders = [guide.slider for guide in machine.mechanism.guides]
    return {g.name: g.slider if sliders.count(g.slider) == 1 else g.name for g in machine.mechanism.guides}
