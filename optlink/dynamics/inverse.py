"""Inverse dynamics: joint reactions and driving torque of a machine in motion, dyad by dyad from the last to the crank.

Every dyad has one pin force that two balances determine (a moment about a joint, or a force along a guide); the other forces
follow. Everything is elementwise: angles, batches of designs, symbols.

References
----------
Kinetostatics of Assur groups; each balance is the Newton-Euler equation of one or both bodies of the group.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from optlink.dynamics.machine import Machine, Moving, Wrench, wrench
from optlink.linkage.dyads import JointedDyad
from optlink.linkage.elements import Drive
from optlink.linkage.jet import as_jet
from optlink.linkage.mechanism import FRAME, Dyad, Guide, Joint, Link, Pose
from optlink.linkage.trains import Single, Train
from optlink.linkage.vector2d import Array, Value, Vector, cross, dot, max_magnitude, minus, plus, turn

# Force balances of dyads: the pin force that two balances determine, and the forces that follow from it.


def solve_two_by_two(row: Vector, right: Value, other: Vector, other_right: Value) -> Vector:
    """Solve row . x = right, other . x = other_right for the vector x."""
    inverse = 1.0 / cross(row, other)
    return (right * other[1] - other_right * row[1]) * inverse, (row[0] * other_right - other[0] * right) * inverse


def moment_row(lever: Vector) -> Vector:
    """Row vector with row . force = moment of the force at the lever."""
    return -lever[1], lever[0]


@dataclass
class GroupForces:
    """Forces of one group: on `body` at a pin, and by a guide on a body (force, moment about the slider's point)."""

    pins: list[tuple[str, str, Vector]] = field(default_factory=list)
    guides: list[tuple[Guide, str, Vector, Value]] = field(default_factory=list)
    rows: tuple[Vector, Vector] = ((1.0, 0.0), (0.0, 1.0))

    @property
    def components(self) -> list[Value]:
        """Components of all forces."""
        return [x for *_, force in self.pins for x in force] + [x for _, _, force, _ in self.guides for x in force]

    def each(self, change: Callable[[Value], Value]) -> GroupForces:
        """Return the forces with every number changed."""
        (a, b), (c, d) = self.rows
        return GroupForces(
            [(point, body, (change(x), change(y))) for point, body, (x, y) in self.pins],
            [(guide, body, (change(x), change(y)), change(m)) for guide, body, (x, y), m in self.guides],
            ((change(a), change(b)), (change(c), change(d))),
        )

    def where(self, which: Value, other: GroupForces) -> GroupForces:
        """Return these forces where `which` is true, elementwise, and those of another solution elsewhere.

        Parameters
        ----------
        which : bool or array of bool
        other : GroupForces
        """
        numbers: list[Value] = []
        other.each(lambda x: numbers.append(x) or x)  # type: ignore[func-returns-value]
        rest = iter(numbers)
        return self.each(lambda x: np.where(which, x, next(rest)))


class ForceBalance:
    """Wrenches `needed` that the joints not solved yet must exert on the bodies of a machine in motion, solved group by group.

    `tilts` are the tangents of the friction angles of guides with friction, by name.
    """

    def __init__(self, moving: Moving, needed: Mapping[str, Wrench], normals: Mapping[str, Value] | None = None) -> None:
        self.moving, self.mechanism, self.needed = moving, moving.machine.mechanism, dict(needed)
        self.rods = {name: self.needed.pop(name) for name in self.mechanism.rods if name in self.needed}
        for name, rod in self.rods.items():  # a part of the link, but for the force of the cylinder
            link = self.mechanism.rods[name].body
            start, end = self.moving.state(link).start, self.moving.state(name).start
            self.needed[link] = self.needed[link] + Wrench(rod.force, rod.about(end, start))
        self._places: dict[str, Vector] = {}
        self.normals, self.result = normals, Reactions(np.nan, {}, {}, {})
        self.order = {body: k for k, body in enumerate((FRAME, *self.mechanism.bodies))}

    def across(self, guide: Guide, tilts: Mapping[str, Value]) -> Vector:
        """Return the direction in which a guide exerts no force: its line, rotated by the friction angle.

        Parameters
        ----------
        guide : Guide
        tilts : mapping of str to Value
            Tangents of the friction angles of guides with friction.
        """
        x, y = self.moving.line(guide.name)
        if guide.name not in tilts:
            return x, y
        tilt = tilts[guide.name]
        return x - tilt * y, y + tilt * x

    def at(self, joint: Joint) -> Vector:
        """Return the position of a pin, or of the point of the slider that slides along the line of a guide."""
        name = joint if isinstance(joint, str) else joint.at or self.mechanism.bodies[joint.slider].start
        if name not in self._places:
            self._places[name] = self.moving.position(name)
        return self._places[name]

    def about(self, link: Link, point: Vector) -> Value:
        """Return the moment about a point [m] that the joints exert on a body.

        Parameters
        ----------
        link : Link
        point : Vector [m]
        """
        return self.needed[link.body].about(self.moving.state(link.body).start, point)

    def directions(self, group: JointedDyad, tilts: Mapping[str, Value]) -> tuple[Vector, Vector]:
        """Return the two directions between which a group has its transmission angle; it is singular where they are parallel.

        They are those of two of its joints, seen from the third one, a pin: its inner joint or, if that is a guide, the outer
        one of the first body. A guide has that in which it exerts no force, another pin the normal to the lever between the two
        pins.

        Parameters
        ----------
        group : JointedDyad
        tilts : mapping of str to Value
            Tangents of the friction angles of guides with friction.
        """
        first, second, pin = *group.outer, group.inner
        if isinstance(pin, Guide):
            first, pin = pin, first
        return self._direction(first, pin, tilts), self._direction(second, pin, tilts)

    def _direction(self, joint: Joint, pin: Joint, tilts: Mapping[str, Value]) -> Vector:
        if isinstance(joint, Guide):
            return self.across(joint, tilts)
        return moment_row(minus(self.at(joint), self.at(pin)))

    def component(self, joint: Joint, row: Vector, force: Vector, *links: Link) -> Value:
        """Return row . force for the force of one or two bodies on others at the end of the lever from their outer joint.

        `row` is one of `directions`, `force` [N] that of all joints of the bodies on them.

        Parameters
        ----------
        joint : Joint
        row : Vector
            Row vector, see `moment_row`.
        force : Vector [N]
        *links : Link
        """
        if isinstance(joint, Guide):
            return -dot(row, force)
        place = self.at(joint)
        moment = self.about(links[0], place)
        return moment if len(links) == 1 else moment + self.about(links[1], place)

    def total(self, group: Dyad) -> Vector:
        """Return the force that the outer joints exert on both bodies of a group."""
        first, second = (self.needed[link.body].force for link in group.links)
        return plus(first, second)

    def solve(self) -> Reactions:
        """Solve all groups, the last one first."""
        mechanism = self.mechanism
        for group in reversed(mechanism.groups):
            self._commit_trains(group.joint)
            self._commit(group, self.with_friction(group))
        self._commit_trains("")
        if not mechanism.drives:
            crank = mechanism.crank
            force, self.result.torque = self.needed[crank.body]
            self._exert(crank.start, crank.body, force, FRAME)
            return self.result
        efforts, speed = self.result.efforts, self.moving.motion.speed
        for drive in mechanism.drives:
            if drive.size:
                efforts[drive.name] = self._push(drive)
        rates = {drive.name: as_jet(drive.value(self.moving.pose)).rate for drive in mechanism.drives}
        self.result.torque = sum(efforts[name] * rate for name, rate in rates.items()) / speed
        return self.result

    # --- bodies placed alone ---------------------------------------------------------------------------------------

    @property
    def pose(self) -> Pose:
        """Positions with their time derivatives."""
        return self.moving.pose

    def place(self, point: str) -> Vector:
        """Return the position of a point [m]."""
        return self.at(point)

    def line(self, guide: Guide) -> Vector:
        """Return the unit vector of a guide's line."""
        return self.moving.line(guide.name)

    def _commit_trains(self, after: str) -> None:
        """Solve the bodies that drives and couplings place after a group, the last ones first."""
        for train in reversed(self.mechanism.placed_after.get(after, ())):
            for element, effort in zip(train.elements, train.efforts(self.pose, self._loads(train)), strict=True):
                if isinstance(element, Drive):
                    self.result.efforts[element.name] = effort
                for action in element.actions(self, effort):
                    self._carry(action.body, action.point, (-action.force[0], -action.force[1]), -action.torque)
            for single in reversed(train.singles):
                body, needed, guide = single.link.body, self.needed[single.link.body], single.guide
                if guide is None:
                    carrier = self._carrier(single)
                    self._exert(str(single.joint), body, needed.force, carrier)
                    self._carry(carrier, self.at(single.joint), needed.force, 0.0)
                else:
                    self._guided(guide, body, needed.force, self.about(single.link, self.at(guide)))

    def _loads(self, train: Train) -> dict[Joint, Value]:
        """Return the moments about the pins and the forces along the guides that drives and couplings must exert together.

        A pin passes on a force, a guide what acts across its line, the moment and its friction.
        """
        needed, loads, own = dict(self.needed), dict[Joint, Value](), [single.link.body for single in train.singles]
        for single in reversed(train.singles):
            body, guide, place = single.link.body, single.guide, self.at(single.joint)
            force, moment = needed[body].force, needed[body].about(self.moving.state(body).start, place)
            if guide is None:
                loads[body], moment, carrier = moment, 0.0, self._carrier(single)
            else:
                carrier, way, (x, y) = guide.other(body), 1.0 if body == guide.slider else -1.0, self.line(guide)
                along, normal, friction = dot((x, y), force), cross((x, y), force), 0.0
                if guide.name in self.moving.machine.friction:  # against the sliding of this body on the other
                    sense = np.abs(normal) if self.normals is None else normal * self.normals[guide.name]
                    friction = -self._slip(guide) * sense * way
                loads[guide], force = way * (along - friction), turn((friction, normal), (x, y))
            if carrier in own:
                lever = minus(place, self.moving.state(carrier).start)
                needed[carrier] = needed[carrier] + Wrench(force, moment + cross(lever, force))
        return loads

    def _carrier(self, single: Single) -> str:
        """Return the body that carries the pin of another one."""
        pins = self.mechanism.pins[str(single.joint)]
        return next(body for body in pins if self.order[body] < self.order[single.link.body])

    def _push(self, drive: Drive) -> Value:
        """Return the force of a cylinder [N], positive where it pushes."""
        link = self.mechanism.bodies[drive.body]
        axis = self.moving.state(drive.body).axis
        pins, rod = self.result.pins[link.end], self.rods.get(drive.rod, ZERO_WRENCH)
        return dot(axis, minus(rod.force, pins[drive.body]))

    # --- one group -------------------------------------------------------------------------------------------------

    def with_friction(self, group: Dyad) -> GroupForces:
        """Solve a group; with guide friction, for the consistent signs of the normal forces."""
        solver: Callable[..., GroupForces] = group.forces
        rough = [guide for guide in group.prismatic if guide.name in self.moving.machine.friction]
        if not rough:
            return solver(self, {})
        senses = {guide.name: self._slip(guide) for guide in rough}
        if self.normals is not None:
            return solver(self, {name: self.normals[name] * sense for name, sense in senses.items()})
        balances = []
        for signs in itertools.product((1.0, -1.0), repeat=len(rough)):
            tilts = {guide.name: sign * senses[guide.name] for guide, sign in zip(rough, signs, strict=True)}
            trial = solver(self, tilts)
            least = -ROUNDING * sum(np.abs(force) for force in trial.components)
            fits: Value = np.True_
            for guide, sign in zip(rough, signs, strict=True):
                fits = fits & (sign * self._normal(trial, guide) >= least)
            balances.append((fits, trial))
        # no consistent signs: friction locks the guide; several that differ: the solution is not unique (Painleve paradox)
        chosen = balances[0][1].each(lambda x: np.nan * x)
        decided: Value = np.False_
        torn: Value = np.False_
        for fits, trial in balances:
            if not np.any(decided) and np.all(fits):
                chosen = trial
            else:
                differs = sum(np.abs(a - b) for a, b in zip(trial.components, chosen.components, strict=True))
                size = sum(np.abs(a) for a in chosen.components)
                torn = torn | (fits & decided & (differs > 1e-6 * size))
                chosen = trial.where(fits & ~decided, chosen)
            decided = decided | fits
        good = decided & ~torn
        self.result.jammed, self.result.several = self.result.jammed | ~good, self.result.several | torn
        return chosen if np.all(good) else chosen.each(lambda x: np.where(good, x, np.nan))

    def _normal(self, solved: GroupForces, guide: Guide) -> Value:
        """Normal force of a guide on its slider."""
        _, body, force, _ = next(entry for entry in solved.guides if entry[0] is guide)
        return cross(self.moving.line(guide.name), force) * (1.0 if body == guide.slider else -1.0)

    def _slip(self, guide: Guide) -> Value:
        """Coefficient of friction with the sign of the slider's velocity along the line."""
        sense = self.moving.sense(lambda source: source.slides[guide.name][1:], self.moving.machine.size)
        return self.moving.machine.friction[guide.name] * sense

    def jointed_forces(self, group: JointedDyad, tilts: Mapping[str, Value]) -> GroupForces:
        """Return the forces of a group from its three joints.

        A pin exerts no moment about itself, a guide no force along its line. With an inner pin its force follows from one balance
        of each body, with an inner guide that of the first body's outer pin from one balance of this body and one of both.

        Parameters
        ----------
        group : JointedDyad
        tilts : mapping of str to Value
            Tangents of the friction angles of guides with friction.
        """
        (first, second), (joint, other) = group.links, group.outer
        of_first, of_second = (self.needed[link.body].force for link in group.links)
        row, across = self.directions(group, tilts)
        at, moment = self.at(group.inner), 0.0
        pins: list[tuple[str, str, Vector]] = []
        guides: list[tuple[Guide, str, Vector, Value]] = []
        if isinstance(group.inner, Guide):
            both = self.component(other, across, plus(of_first, of_second), first, second)
            pin = solve_two_by_two(row, dot(row, of_first), across, -both)
            inner, moment = minus(of_first, pin), self.about(first, at) - cross(minus(self.at(joint), at), pin)
            guides.append((group.inner, first.body, inner, moment))
        else:
            component = self.component(joint, row, of_first, first)
            inner = solve_two_by_two(row, -component, across, self.component(other, across, of_second, second))
            pins.append((group.inner, first.body, inner))
        outer = minus(of_first, inner), plus(of_second, inner)
        for link, joint, force in zip(group.links, group.outer, outer, strict=True):
            if isinstance(joint, Guide):
                place = self.at(joint)
                whole, passed = self.about(link, place), cross(minus(at, place), inner)
                if isinstance(group.inner, Guide):
                    passed = passed + moment
                guides.append((joint, link.body, force, whole - passed if link is first else whole + passed))
            else:
                pins.append((joint, link.body, force))
        return GroupForces(pins, guides, (row, across))

    # --- transmitted forces ----------------------------------------------------------------------------------------

    def _commit(self, group: Dyad, solved: GroupForces) -> None:
        """Store the forces of a group and apply their counterparts to the bodies that carry it."""
        first, second = (link.body for link in group.links)
        for point, body, force in solved.pins:
            if point == group.joint:
                self._exert(point, body, force, second if body == first else first)
            else:
                before = min(self.order[first], self.order[second])
                carrier = next(holder for holder in self.mechanism.pins[point] if self.order[holder] < before)
                self._exert(point, body, force, carrier)
                self._carry(carrier, self.moving.position(point), force, 0.0)
        for guide, body, force, moment in solved.guides:
            self._guided(guide, body, force, moment, (first, second))
        self.result.rows[group.joint] = solved.rows

    def _guided(self, guide: Guide, body: str, force: Vector, moment: Value, solved: tuple[str, ...] = ()) -> None:
        """Store the force of a guide on one of its bodies, and apply its counterpart to the other, unless that is `solved`."""
        other, at = guide.other(body), self.at(guide)
        if other not in solved:
            self._carry(other, at, force, moment)
        sign = 1.0 if body == guide.slider else -1.0
        line, on = self.moving.line(guide.name), (sign * force[0], sign * force[1])
        self.result.guides[guide.name] = GuideForce(cross(line, on), dot(line, on), sign * moment, at, on)

    def _exert(self, point: str, body: str, force: Vector, by: str) -> None:
        """Add the force of one body on another at a pin."""
        forces = self.result.pins.setdefault(point, {})
        forces[body] = plus(forces[body], force) if body in forces else force
        forces[by] = minus(forces[by], force) if by in forces else (-force[0], -force[1])

    def _carry(self, body: str, point: Vector, force: Vector, moment: Value) -> None:
        """Add a transmitted force and moment to the wrench that a body requires."""
        if body != FRAME:
            start = self.moving.state(body).start
            self.needed[body] = self.needed[body] + Wrench(force, moment + cross(minus(point, start), force))


ROUNDING = 1e-9
"""Share of the forces of a group below which a normal force is zero."""

ZERO_WRENCH = Wrench((0.0, 0.0), 0.0)


@dataclass(frozen=True)
class GuideForce:
    """Force of a guide on its slider: `normal` to the left of the line and `friction` along it [N], acting at `point`.

    `moment` [N m] is the moment about that point. Positive normal: the slider is pushed to the left of the line.
    """

    normal: Value
    friction: Value
    moment: Value
    point: Vector
    force: Vector


@dataclass
class Reactions:
    """Joint reactions and torque of a machine in motion.

    `pins`: point -> body -> force of the pin on that body [N] (they sum to zero); `guides` by name; `torque` of the
    drive on the crank [N m]; `jammed` where friction locks a guide, or (`several`) several solutions satisfy its law; `rows`: the
    directions of the two balances of each group; `efforts` of drives by name: torque [N m] or force [N] on the driven body. With
    several drives, or laws, `torque` is what a crank at the cycle variable would need: their power over its rate.
    """

    torque: Value
    pins: dict[str, dict[str, Vector]]
    guides: dict[str, GuideForce]
    rows: dict[str, tuple[Vector, Vector]]
    jammed: Value = False
    several: Value = False
    efforts: dict[str, Value] = field(default_factory=dict)

    @cached_property
    def singularity(self) -> dict[str, Value]:
        """Sine of the angle between the two rows of each group, -1 ... 1; zero at a singular position.

        For an RRR group it is the sine of the transmission angle.
        """
        with np.errstate(all="ignore"):
            return {joint: cross(a, b) / np.sqrt(dot(a, a) * dot(b, b)) for joint, (a, b) in self.rows.items()}

    def pin(self, machine: Machine, point: str, on: str | None = None) -> Vector:
        """Return the reaction at a pin [N] on a body, by default that of `reported_on`.

        Parameters
        ----------
        machine : Machine
        point : str
            Name of the pin.
        on : str, optional
            Body on which the force acts.
        """
        return self.pins[point][on or reported_on(machine)[point]]


def reported_on(machine: Machine) -> dict[str, str]:
    """Return the body on which the reaction of each pin is reported.

    This is the crank at its pivot; at an outer joint of a group the body that the group adds; at the inner joint of a group the
    first of its two bodies; `machine.reported` overrides this.
    """
    mechanism = machine.mechanism
    bodies = {mechanism.crank.start: mechanism.crank.body}
    bodies |= {single.joint: single.link.body for single in mechanism.singles if isinstance(single.joint, str)}
    for group in mechanism.groups:
        for body, pin in group.outer_pins:
            bodies.setdefault(pin, body)
        if group.joint in mechanism.pins:
            bodies[group.joint] = group.links[0].body
    return {**bodies, **machine.reported}


def acting_on(machine: Machine) -> dict[str, tuple[str, str]]:
    """Return the (acting, loaded) bodies of the reported reaction of each pin; "pin" acts where three or more bodies meet."""
    on, acting = reported_on(machine), {}
    for point, bodies in machine.mechanism.pins.items():
        others = [body for body in bodies if body != on[point]]
        acting[point] = (others[0] if len(others) == 1 else "pin", on[point])
    return acting


def required_wrench(moving: Moving, *, inertia: bool = True, gravity: bool = True, loads: bool = True) -> dict[str, Wrench]:
    """Compute the wrench (about its start) that joints and drive together exert on each body, of the contributions chosen."""
    machine = moving.machine
    wrenches = dict.fromkeys((*machine.mechanism.bodies, *machine.mechanism.rods), ZERO_WRENCH)
    for body, mass in machine.inertias.items():
        state = moving.state(body)
        if inertia:
            wrenches[body] = wrench(mass.parameters, state, machine.gravity if gravity else (0.0, 0.0))
        elif gravity:
            wrenches[body] = wrench(
                mass.parameters, state._replace(acceleration=(0.0, 0.0), omega=0.0, alpha=0.0), machine.gravity
            )
    for load in machine.loads if loads else ():
        for acting in load.act(moving):
            if acting.body != FRAME:
                wrenches[acting.body] = wrenches[acting.body] + -acting.wrench(moving.state(acting.body))
    return wrenches


def reactions(
    moving: Moving, needed: Mapping[str, Wrench] | None = None, normals: Mapping[str, Value] | None = None
) -> Reactions:
    """Compute all reactions and the driving torque.

    By default the joints exert on each body the wrench that inertia, gravity and loads need, and the normal forces of guides
    with friction have consistent signs, not those of `normals` (+1 or -1). At a singular position of a group, where
    `singularity` is zero, reactions are infinite or NaN; the torque of a mechanism that is continued through singular positions
    is finite there.
    """
    wrenches = required_wrench(moving) if needed is None else needed
    with np.errstate(all="ignore"):
        solved = ForceBalance(moving, wrenches, normals).solve()
        if moving.machine.mechanism.followed and not moving.machine.friction:  # finite where reactions are not
            solved.torque = virtual_torque(wrenches, moving)
        return solved


SENSES = 73
"""Positions at which the forces of both senses of motion are compared."""


def depends_on_sense(machine: Machine, low: float, high: float, speed: float) -> bool:
    """Return whether forces differ on the way back through a range [rad]: by friction, dampers, loads of one stroke."""
    angles = np.linspace(low, high, SENSES + 2)[1:-1]
    there, back = (reactions(machine.moving(angles, way * speed)).torque + 0.0 * angles for way in (1.0, -1.0))
    return not np.allclose(there, back, rtol=1e-9, atol=1e-9 * max_magnitude(there))


def virtual_torque(wrenches: Mapping[str, Wrench], moving: Moving) -> Value:
    """Compute the driving torque that corresponds to wrenches on the bodies [N m], by the principle of virtual power."""
    source, power = moving.turning, 0.0
    for body, (force, moment) in wrenches.items():
        state = source.state(body)
        power = power + dot(force, state.velocity) + moment * state.omega
    return power / source.motion.speed


# --- derived quantities ------------------------------------------------------------------------------------------------


def torque_parts(moving: Moving, whole: Reactions | None = None) -> dict[str, Value]:
    """Split the driving torque [N m] into the parts of inertia, gravity and loads; friction counts among the loads.

    `whole` are the reactions of this motion, if already computed.
    """
    smooth = Moving(moving.machine.with_(friction={}), moving.motion, moving.side, moving.direction)
    inertia = reactions(smooth, required_wrench(smooth, gravity=False, loads=False)).torque
    gravity = reactions(smooth, required_wrench(smooth, inertia=False, loads=False)).torque
    total = (whole or reactions(moving)).torque
    return {"inertia": inertia, "gravity": gravity, "load": total - inertia - gravity}


def shaking(moving: Moving) -> Wrench:
    """Compute the shaking force [N] and shaking moment about the crank pivot [N m] that the inertia exerts on the frame.

    They are minus the rates of the momentum and of the angular momentum about the crank pivot, without gravity and loads (R. S.
    Berkof, G. G. Lowen, A new method for completely force balancing simple linkages, 1969).
    """
    needed = required_wrench(moving, gravity=False, loads=False)
    pivot = moving.position(moving.machine.mechanism.crank.start)
    total = ZERO_WRENCH
    for body, own in needed.items():
        total = total + Wrench(own.force, own.about(moving.state(body).start, pivot))
    return -total


def reduced_inertia(machine: Machine, crank_angle: Array) -> tuple[Array, Array]:
    """Return the inertia reduced to the crank [kg m^2] and its derivative with respect to the crank angle [kg m^2/rad]."""
    with np.errstate(all="ignore"):
        moving = machine.moving(crank_angle, 1.0)
        weightless = required_wrench(moving, gravity=False, loads=False)
        inertia = np.broadcast_to(2.0 * np.asarray(moving.kinetic), crank_angle.shape)
        return inertia, np.broadcast_to(2.0 * np.asarray(virtual_torque(weightless, moving)), crank_angle.shape)
