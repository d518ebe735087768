"""Named columns of a machine in motion: motion, reactions, torque, energies."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cache, cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.inverse import GuideForce, Reactions, acting_on, reactions, shaking, torque_parts
from optlink.dynamics.machine import Machine, Moving, slider_names
from optlink.linkage.dyads import RRR
from optlink.linkage.elements import Drive
from optlink.linkage.jet import as_jet
from optlink.linkage.mechanism import FRAME, Mechanism
from optlink.linkage.motion import continuous
from optlink.linkage.singular import AlignedPosition
from optlink.linkage.vector2d import Array, Value, Vector, cross, dot, magnitude, minus

NEAR, NEARER, ASIDE = 1e-4, 1e-5, 1e-2
"""Distances from a change point [rad]: two at which reactions are compared, and one with reactions of the usual size."""

GROWS, NOTHING = 0.3, 1e-9
"""An unbounded force has at least this ratio of force times distance at `NEARER` and `NEAR`, and this share of usual forces."""

ANGLE = ".angle_rad"
"""Ending of the columns that are continuous from row to row."""

FAULTS = ("singular", "jammed", "undefined")
"""Kinds of positions without finite reactions: attributes of `MotionColumns`."""

BLOCK = 2_000
"""Positions whose motion is kept in memory at a time."""

SINGULAR = 1e-7
"""Sine below which a group counts as singular: its reactions are rounding errors."""


class Column(NamedTuple):
    """A column of the record: its name (ending in the unit), its meaning and its values."""

    name: str
    meaning: str
    values: Array


class Effort(NamedTuple):
    """What a drive exerts on a body: name of the column, "torque" or "force", its symbol and unit, the body, and the drive.

    The name of an only drive is empty.
    """

    column: str
    quantity: str
    symbol: str
    unit: str
    body: str
    drive: str = ""

    @property
    def words(self) -> str:
        """What it is called."""
        return f"{self.quantity} of {self.drive}" if self.drive else f"driving {self.quantity}"


def effort_of(drive: Drive) -> Effort:
    """Return what a drive exerts."""
    kind = ("torque_Nm", "torque", "M", "N m") if drive.kind == "angle" else ("force_N", "force", "F", "N")
    return Effort(f"{drive.name}.{kind[0]}", *kind[1:], drive.body, "" if drive.name == "input" else drive.name)


def efforts(mechanism: Mechanism) -> list[Effort]:
    """Return what the drives of a mechanism exert."""
    crank = Drive("input", "angle", mechanism.crank.body)
    return [effort_of(drive) for drive in mechanism.drives or (crank,)]


Named = Iterator[tuple[str, str, Callable[[], Value]]]
"""Columns: name, meaning, and a function that computes the value."""
Sources = dict[str, tuple[str, Callable[[], Value]]]


def _by_name(columns: Callable[[Any], Named]) -> cached_property[Sources]:
    """Return a property that has the columns of a generator by name."""

    def named(self: Any) -> Sources:
        with np.errstate(all="ignore"):
            return {name: (meaning, value) for name, meaning, value in columns(self)}

    return cached_property(named)


def _constant(value: Value) -> Callable[[], Value]:
    return lambda: value


def _part(whole: Callable[..., Any], part: Any, *arguments: str) -> Callable[[], Value]:
    return lambda: whole(*arguments)[part]


class MotionColumns:
    """Columns by name of a machine at crank angles (n,), or of a batch of designs (designs, n); each is computed when read."""

    def __init__(self, moving: Moving) -> None:
        self.moving, self.machine = moving, moving.machine
        self.shape = moving.motion.shape
        self._values: dict[str, Array] = {}

    @cached_property
    def reactions(self) -> Reactions:
        """Joint reactions and torque of the drive."""
        with np.errstate(all="ignore"):
            return reactions(self.moving)

    @cached_property
    def jammed(self) -> NDArray[np.bool_]:
        """Positions in which friction locks a guide."""
        return self.full(self.reactions.jammed).astype(bool) & self.moving.motion.assembled

    @cached_property
    def singular(self) -> NDArray[np.bool_]:
        """Positions without finite reactions."""
        with np.errstate(all="ignore"):
            near = [np.abs(self.full(sine)) < SINGULAR for sine in self.reactions.singularity.values()]
            singular: NDArray[np.bool_] = np.any([*near, np.zeros(self.shape)], axis=0) & self.moving.motion.assembled
        return singular

    @cached_property
    def undefined(self) -> NDArray[np.bool_]:
        """Positions in which a load has no finite value."""
        known = np.isfinite(self.full(self.reactions.torque))
        undefined: NDArray[np.bool_] = ~known & self.moving.motion.assembled & ~self.jammed & ~self.singular
        return undefined

    def full(self, value: Value) -> Array:
        """Broadcast a value to all positions."""
        return np.broadcast_to(np.asarray(value, dtype=float), self.shape)

    def __getitem__(self, name: str) -> Array:
        if name not in self._values:
            with np.errstate(all="ignore"):
                if name in self._motion:
                    self._values[name] = self.full(self._motion[name][1]())
                else:
                    sources = next((part for part in (self._reactions, self._drive) if name in part), self._loads)
                    unknown = self.singular & (sources is self._reactions or not self.machine.mechanism.followed)
                    self._values[name] = np.where(unknown, np.nan, self.full(sources[name][1]()))
        return self._values[name]

    @cached_property
    def columns(self) -> dict[str, Column]:
        """All columns by name."""
        return {name: Column(name, meaning, self[name]) for name, meaning in self.meanings.items()}

    @cached_property
    def meanings(self) -> dict[str, str]:
        """The meanings of all columns by name."""
        sections = (self._motion, self._reactions, self._loads, self._drive)
        return {name: meaning for part in sections for name, (meaning, _) in part.items()}

    @property
    def motion_names(self) -> Collection[str]:
        """Names of the columns of the motion alone."""
        return self._motion.keys()

    @property
    def reaction_names(self) -> Collection[str]:
        """Names of the reaction columns."""
        return self._reactions.keys()

    @cached_property
    def _reactions(self) -> Sources:
        forces = joint_forces(self.machine, self.reactions.pins, self.reactions.guides)
        return {name: (meaning, _constant(value)) for name, meaning, value in forces}

    @_by_name
    def _motion(self) -> Named:
        moving, mechanism = self.moving, self.machine.mechanism
        for body in mechanism.bodies:
            yield from self._turning(body)
        for point, bodies in mechanism.owners.items():
            if FRAME not in bodies:
                for part, unit, what, vector in (
                    ("", "m", "position", moving.position),
                    ("v", "m_s", "velocity", moving.velocity),
                    ("a", "m_s2", "acceleration", moving.acceleration),
                ):
                    for k, axis in enumerate("xy"):
                        yield f"{point}.{part}{axis}_{unit}", f"{what} of {point} in {axis}", _part(vector, k, point)
        for guide, name in slider_names(self.machine).items():
            for k, (part, what) in enumerate(
                (("s_m", "slide"), ("v_m_s", "sliding velocity"), ("a_m_s2", "sliding acceleration"))
            ):
                yield f"{name}.{part}", f"{what} in the guide {guide}", _part(lambda guide: moving.slides[guide], k, guide)
        for drive in mechanism.drives:
            if drive.size:
                course = as_jet(drive.value(moving.pose))
                for part, what, value in zip(
                    ("length_m", "v_m_s", "a_m_s2"), ("length", "speed", "acceleration"), course.parts, strict=True
                ):
                    yield f"{drive.body}.{part}", f"{what} of the cylinder {drive.body}", _constant(value)
        for group in mechanism.groups:
            if isinstance(group, RRR):
                what = f"angle between the two links at {group.joint}"
                yield f"{group.joint}.transmission_rad", what, partial(_transmission, moving, group)

    def _driven(self, drive: Drive) -> Named:
        """Yield the columns of one of several drives, or of one that does not turn a crank at constant speed."""
        effort, name = self.reactions.efforts[drive.name], drive.name
        pushes = "" if drive.kind == "angle" else ", positive where it pushes"
        column, quantity = effort_of(drive)[:2]
        yield column, f"{quantity} of the drive {name} on {drive.body}{pushes}", _constant(effort)
        if name != "input":
            yield f"{name}.power_W", f"power of the drive {name}", _constant(effort * as_jet(drive.value(self.moving.pose)).rate)

    def _turning(self, body: str) -> Named:
        moving = self.moving
        yield f"{body}{ANGLE}", f"angle of {body}'s axis from +x", lambda: moving.motion.body_angle(body).value
        yield f"{body}.omega_rad_s", f"angular velocity of {body}", lambda: moving.state(body).omega
        yield f"{body}.alpha_rad_s2", f"angular acceleration of {body}", lambda: moving.state(body).alpha

    @_by_name
    def _loads(self) -> Named:
        for load in self.machine.loads:
            for k, acting in enumerate(act for act in load.act(self.moving) if act.body != FRAME):
                name = f"{load.name}.{acting.body}" if k else load.name
                if not _nothing(*acting.force):
                    for axis, value in zip("xy", acting.force, strict=True):
                        yield f"{name}.f{axis}_N", f"force of the load {load.name} on {acting.body} in {axis}", _constant(value)
                if not _nothing(acting.torque):
                    yield f"{name}.torque_Nm", f"torque of the load {load.name} on {acting.body}", _constant(acting.torque)

    @_by_name
    def _drive(self) -> Named:  # no function refers to the record, which would then outlive its use
        moving, joint_reactions, torque = self.moving, self.reactions, self.reactions.torque
        parts, shaken = cache(lambda: torque_parts(moving, joint_reactions)), cache(lambda: shaking(moving))
        mechanism = self.machine.mechanism
        for drive in mechanism.drives:
            yield from self._driven(drive)
        if not mechanism.drives:
            yield "input.torque_Nm", f"torque of the drive on {mechanism.crank.body}", _constant(torque)
            for part in ("inertia", "gravity", "load"):
                yield f"input.torque_{part}_Nm", f"what of the driving torque goes into {part}", _part(parts, part)
        speed = moving.motion.speed  # at rest a drive along a line has no torque about its cycle, 0/0
        yield "input.power_W", "power of the drive", lambda: np.where(np.asarray(speed) == 0.0, 0.0, torque * speed)
        for k, axis in enumerate("xy"):
            what = f"shaking force on the frame in {axis}: minus the rate of momentum"
            yield f"frame.shaking_f{axis}_N", what, _part(lambda: shaken().force, k)
        yield "frame.shaking_moment_Nm", f"shaking moment on the frame about {mechanism.crank.start}", lambda: shaken().moment
        yield "energy.kinetic_J", "kinetic energy", lambda: moving.kinetic
        what = "potential energy of gravity and springs, gravity's zero at y = 0"
        yield "energy.potential_J", what, lambda: moving.potential


class Table(NamedTuple):
    """Columns by name over many positions (n,), and where there is a fault, by `FAULTS`."""

    columns: dict[str, Column]
    faults: dict[str, NDArray[np.bool_]]


def tabulated(moving: Callable[[slice], Moving], count: int) -> Table:
    """Return all columns of a machine over many positions, computed in blocks so that only the results take memory.

    `moving` maps the rows of a block to the machine in motion there.
    """
    columns: dict[str, Column] = {}
    faults = {kind: np.zeros(count, dtype=bool) for kind in FAULTS}
    for begin in range(0, count, BLOCK):
        rows = slice(begin, min(begin + BLOCK, count))
        record = MotionColumns(moving(rows))
        for name, meaning in record.meanings.items():
            if name not in columns:
                columns[name] = Column(name, meaning, np.empty(count))
            turns = name.endswith(ANGLE)
            values = record.moving.motion.wrapped_angle(name.removesuffix(ANGLE)) if turns else record[name]
            columns[name].values[rows] = values
        for kind, fault in faults.items():
            fault[rows] = getattr(record, kind)
    for name, column in columns.items():
        if name.endswith(ANGLE):
            column.values[:] = continuous(column.values)
    return Table(columns, faults)


def joint_forces(
    machine: Machine, pins: Mapping[str, Mapping[str, Vector]], guides: Mapping[str, GuideForce]
) -> Iterator[tuple[str, str, Value]]:
    """Yield name, meaning and values of the columns of the joint reactions, as in `Reactions`."""
    for point, (by, on) in acting_on(machine).items():
        bodies = machine.mechanism.pins[point]
        several = len(bodies) > 2
        for body in (on, *(b for b in bodies if b != on)) if several else (on,):
            name, what = (f"{point}.{body}", "the pin") if several else (point, by)
            for axis, value in zip("xy", pins[point][body], strict=True):
                yield f"{name}.f{axis}_N", f"force of {what} on {body} at {point} in {axis}", value
    for guide in machine.mechanism.guides:
        force, what = guides[guide.name], f"of {guide.on} on {guide.slider} in the guide {guide.name}"
        yield f"{guide.name}.normal_N", f"normal force {what}, to the left of the line", force.normal
        yield f"{guide.name}.moment_Nm", f"moment {what}", force.moment
        if guide.name in machine.friction:
            yield f"{guide.name}.friction_N", f"friction {what}, along the line", force.friction


def _transmission(moving: Moving, group: RRR) -> Value:
    j = moving.position(group.joint)
    p, q = (minus(moving.position(pin), j) for pin in group.outer)
    return np.arctan2(magnitude(cross(p, q)), dot(p, q))


def _nothing(*parts: Value) -> bool:
    return all(isinstance(part, float) and part == 0.0 for part in parts)


# --- reactions that grow without bound towards change points ------------------------------------------------------------------


def pin_columns(machine: Machine) -> list[tuple[str, str, str]]:
    """Return the column name of the magnitude, the pin and the body of every joint force."""
    return [
        (f"{point}.f_N" if len(bodies) == 2 else f"{point}.{body}.f_N", point, body)
        for point, bodies in machine.mechanism.pins.items()
        for body in (bodies[:1] if len(bodies) == 2 else bodies)
    ]


def unbounded_reactions(machine: Machine, positions: Sequence[AlignedPosition], speed: float) -> tuple[str, ...]:
    """Return the columns of reactions that grow without bound towards the change points through which a machine is continued.

    Such a force grows as the inverse of the distance, so force times distance has a limit other than zero.
    """
    if not positions:
        return ()
    at = np.array([position.crank_angle for position in positions])
    (names, near), (_, nearer), (_, usual) = (_amounts(machine, at, distance, speed) for distance in (NEAR, NEARER, ASIDE))
    size = max(float(np.max(usual, initial=0.0)), 1e-300)
    grows = (NEARER * nearer > GROWS * NEAR * near) & (NEARER * nearer > NOTHING * size)
    return tuple(name for name, unbounded in zip(names, grows, strict=True) if unbounded)


def _amounts(machine: Machine, at: Array, distance: float, speed: float) -> tuple[list[str], Array]:
    """Names and largest magnitudes of all reactions at a distance before and after crank angles."""
    record = MotionColumns(machine.moving(np.concatenate([at - distance, at + distance]), speed))
    columns = {name: record[name] for name in record.columns if name in record.reaction_names}
    for name, point, body in pin_columns(machine):
        columns[name] = np.hypot(*(record.full(part) for part in record.reactions.pins[point][body]))
    return list(columns), np.array([np.max(np.abs(values)) for values in columns.values()])
