"""Reactions, torque and shaking forces as affine functions of the parameters of counterweights and springs.

A counterweight adds four inertial parameters to its body (`optlink.dynamics.inertia.Parameters`), a spring its stiffness k and
the product k * free length; reactions, torque and shaking forces are linear in all of these. Balancing is therefore a convex
programme.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.inertia import UNITS, Inertia, Parameters, Wrench, wrench
from optlink.dynamics.inverse import ZERO_WRENCH, Reactions, reactions, regressor, shaking
from optlink.dynamics.loads import Spring
from optlink.dynamics.machine import Machine, Moving
from optlink.linkage.vector2d import TURN, Array, Value, Vector, minus

Kind = Literal["shaking force", "shaking moment", "driving torque", "reaction"]
KINDS: tuple[Kind, ...] = ("shaking force", "shaking moment", "driving torque", "reaction")


@dataclass(frozen=True)
class BalanceMeasure:
    """Root mean square or maximum, over the positions, of a force or torque that is minimised or limited.

    `joint` (a pin or a guide) and `on` (a body, for a pin of three bodies) select the reaction; for a guide it is the normal
    force. `arc` [rad]: only crank angles from the first to the second are included.
    """

    kind: Kind
    of: Literal["rms", "largest"] = "rms"
    joint: str = ""
    on: str = ""
    arc: tuple[float, float] | None = None

    @property
    def unit(self) -> str:
        """Display unit of the value."""
        return "N" if self.kind in ("shaking force", "reaction") else "N m"

    @property
    def quantity(self) -> str:
        """Name of the measured quantity, without the kind of mean."""
        on = f" on {self.on}" if self.on else ""
        return f"{self.kind} at {self.joint}{on}" if self.joint else self.kind

    def __str__(self) -> str:
        arc = "" if self.arc is None else " from {:g} to {:g} deg".format(*(math.degrees(a) for a in self.arc))
        return f"{self.of} {self.quantity}{arc}"

    def rows(self, angles: Array) -> NDArray[np.bool_]:
        """Return which of the crank angles [rad] are included."""
        if self.arc is None:
            return np.ones(len(angles), dtype=bool)
        low, high = self.arc
        turned = np.mod(angles - low, TURN)
        return np.asarray((turned <= math.fmod(high - low, TURN) + 1e-9) | (turned >= TURN - 1e-9))

    def value(self, amounts: Array) -> float:
        """Return the measure of a quantity (positions, parts)."""
        squares = np.sum(amounts * amounts, axis=1)
        return float(np.sqrt(np.mean(squares) if self.of == "rms" else np.max(squares)))


def quantity_over_cycle(
    quantity: BalanceMeasure,
    machine: Machine,
    joint_reactions: Reactions,
    shaken: Wrench,
    shape: tuple[int, ...],
) -> Array:
    """Return a quantity over positions of some shape, array (positions, parts); the parts of a force are x and y."""
    parts: tuple[Value, ...]
    if quantity.kind == "shaking force":
        parts = shaken.force
    elif quantity.kind == "shaking moment":
        parts = (shaken.moment,)
    elif quantity.kind == "driving torque":
        parts = (joint_reactions.torque,)
    elif quantity.joint in joint_reactions.guides:
        parts = (joint_reactions.guides[quantity.joint].normal,)
    else:
        parts = joint_reactions.pin(machine, quantity.joint, quantity.on)
    return np.stack([np.broadcast_to(np.asarray(part, dtype=float), shape) for part in parts], axis=-1)


def quantities_of(moving: Moving, quantities: Sequence[BalanceMeasure], about: Vector) -> list[Array]:
    """Compute quantities of a machine in motion by inverse dynamics, each (positions, parts).

    `about` [m] is the reference point of the shaking moment.
    """
    shape, machine = np.shape(moving.motion.assembled), moving.machine
    joint_reactions, shaken = reactions(moving), _shaking_about(moving, about)
    return [quantity_over_cycle(quantity, machine, joint_reactions, shaken, shape) for quantity in quantities]


def _shaking_about(moving: Moving, point: Vector) -> Wrench:
    """Return the shaking force, and the shaking moment about a point instead of the crank pivot."""
    shaken = shaking(moving)
    return Wrench(shaken.force, shaken.about(moving.position(moving.machine.mechanism.crank.start), point))


def quantities(machine: Machine) -> list[BalanceMeasure]:
    """Return all measurable quantities of a machine (shaking, torque, every reaction), each as root mean square."""
    measures = [BalanceMeasure("shaking force"), BalanceMeasure("shaking moment"), BalanceMeasure("driving torque")]
    for point, bodies in machine.mechanism.pins.items():
        measures += [BalanceMeasure("reaction", "rms", point, body) for body in (bodies if len(bodies) > 2 else ("",))]
    return measures + [BalanceMeasure("reaction", "rms", guide.name) for guide in machine.mechanism.guides]


# --- counterweights and springs ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Counterweight:
    """A mass added to a body; missing bounds are infinite, missing values None. SI units, in the body's axes.

    A disc has a `thickness` (its radius follows from its mass), or a `radius` (its thickness follows). A free counterweight may
    have any shape. `mass`: least and largest; `reach`: largest distance of its centre from `origin`; `extent`: largest distance
    of any of its points from `origin`; `at`: prescribed position of its centre.
    """

    body: str
    kind: Literal["disc", "free"]
    mass: tuple[float, float] = (0.0, math.inf)
    thickness: float | None = None
    radius: float | None = None
    density: float | None = None
    reach: float = math.inf
    extent: float = math.inf
    origin: tuple[float, float] = (0.0, 0.0)
    at: tuple[float, float] | None = None

    @property
    def spread(self) -> float:
        """Central moment of inertia of a disc of prescribed thickness, per mass squared [m^2/kg]."""
        assert self.thickness is not None
        assert self.density is not None
        return 1.0 / (2.0 * math.pi * self.density * self.thickness)

    def radius_of(self, mass: float) -> float:
        """Return the radius of the disc [m]."""
        if self.radius is not None:
            return self.radius
        assert self.thickness is not None
        assert self.density is not None
        return math.sqrt(max(mass, 0.0) / (math.pi * self.density * self.thickness))

    def thickness_of(self, mass: float) -> float | None:
        """Return the thickness of the disc [m], None where its density is unknown."""
        if self.thickness is not None or self.density is None or self.radius is None:
            return self.thickness
        return mass / (math.pi * self.density * self.radius**2)

    def realised(self, parameters: Parameters) -> Parameters:
        """Return the nearest feasible parameters: mass and position of a disc determine its moment of inertia."""
        mass, along, across, moment = (float(part) for part in parameters)
        if mass <= 0.0:
            return Parameters(0.0, 0.0, 0.0, 0.0)
        if self.at is not None:
            along, across = (mass * part for part in self.at)
        steiner = (along * along + across * across) / mass
        moment = steiner + 0.5 * mass * self.radius_of(mass) ** 2 if self.kind == "disc" else max(moment, steiner)
        return Parameters(mass, along, across, moment)


@dataclass(frozen=True)
class FreeSpring:
    """A linear spring between two points with bounds on stiffness [N/m] and free length [m]; `force`: largest force [N]."""

    name: str
    ends: tuple[tuple[str, str], tuple[str, str]]
    stiffness: tuple[float, float] = (0.0, math.inf)
    free: tuple[float, float] = (0.0, 0.0)
    force: float = math.inf

    def spring(self, stiffness: float, free: float) -> Spring:
        """Return the spring of a stiffness [N/m] and free length [m] as a load."""
        return Spring(self.name, self.ends, stiffness, free, 0.0)


def with_counterweight(inertia: Inertia, added: Parameters) -> Inertia:
    """Return the mass properties of a body with a counterweight, whose parameters are `added`."""
    mass, along, across, moment = (a + b for a, b in zip(inertia.parameters, added, strict=True))
    if mass <= 0.0:
        return inertia
    x, y = along / mass, across / mass
    return Inertia(mass, x, y, max(moment - mass * (x * x + y * y), 0.0))


# --- the affine functions -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Affine:
    """Affine function matrix (positions, parts, n) @ parameters (n,) + offset (positions, parts)."""

    matrix: Array
    offset: Array

    def at(self, parameters: Array) -> Array:
        """Return its value (positions, parts)."""
        return np.asarray(self.matrix @ parameters + self.offset)

    def compressed(self) -> tuple[Array, Array]:
        """Return R (k, n) and r (k,), k <= n + 1, with |R x + r| the root mean square over the positions for every x.

        The result is exact, because the R factor of a QR decomposition preserves the norm.
        """
        n = self.matrix.shape[-1]
        tall = np.concatenate([self.matrix.reshape(-1, n), self.offset.reshape(-1, 1)], axis=1)
        small: Array = np.asarray(np.linalg.qr(tall / math.sqrt(len(self.offset)), mode="r"))
        return small[:, :n], small[:, n]


class Effects:
    """Effects of the parameters of counterweights (four for each body) and springs (k and k * free length each).

    `moving` is the original machine at the positions (positions,), `about` [m] the reference point of shaking moments.
    """

    def __init__(self, moving: Moving, bodies: Sequence[str], springs: Sequence[FreeSpring], about: Vector) -> None:
        self.moving, self.bodies, self.springs, self.about = moving, tuple(bodies), tuple(springs), about
        self.shape = np.shape(moving.motion.assembled)
        self.count = 4 * len(self.bodies) + 2 * len(self.springs)

    @cached_property
    def _original(self) -> tuple[Reactions, Wrench]:
        return reactions(self.moving), _shaking_about(self.moving, self.about)

    @cached_property
    def _columns(self) -> list[tuple[Reactions, Wrench]]:
        """Reactions and shaking (its moment about `about`) per unit of each parameter."""
        effects: list[tuple[Reactions, Wrench]] = []
        bare = self.moving.machine.with_(inertias={}, friction={})
        per_unit = regressor(self.moving) if self.bodies else {}
        for body in self.bodies:
            state = self.moving.state(body)
            for unit, reaction in zip(UNITS, per_unit[body], strict=True):
                body_wrench = wrench(unit, state, (0.0, 0.0))
                effects.append((reaction, -Wrench(body_wrench.force, body_wrench.about(state.start, self.about))))
        for spring in self.springs:
            machines = (bare.with_(loads=(spring.spring(1.0, free),)) for free in (0.0, 1.0))
            slack, tight = (reactions(Moving(machine, self.moving.motion)) for machine in machines)
            effects += [(slack, ZERO_WRENCH), (_difference(tight, slack), ZERO_WRENCH)]
        return effects

    def lengths(self, spring: FreeSpring) -> Array:
        """Return the length of a spring over the positions [m]."""
        (_, p), (_, q) = spring.ends
        (ax, ay), (bx, by) = self.moving.position(p), self.moving.position(q)
        return np.broadcast_to(np.hypot(np.asarray(bx) - ax, np.asarray(by) - ay), self.shape)

    def affine(self, quantity: BalanceMeasure) -> Affine:
        """Return a quantity as an affine function, over the positions that its measure includes."""
        machine, rows = self.moving.machine, quantity.rows(np.asarray(self.moving.motion.crank_angle, dtype=float))
        offset = quantity_over_cycle(quantity, machine, *self._original, self.shape)
        matrix = np.empty((*offset.shape, self.count))
        for k, (reaction, shaken) in enumerate(self._columns):
            matrix[..., k] = quantity_over_cycle(quantity, machine, reaction, shaken, self.shape)
        return Affine(matrix[rows], offset[rows])


def _difference(one: Reactions, other: Reactions) -> Reactions:
    """Difference of two sets of reactions; for guides only of the normal force."""
    pins = {point: {body: minus(force, other.pins[point][body]) for body, force in on.items()} for point, on in one.pins.items()}
    guides = {name: replace(force, normal=force.normal - other.guides[name].normal) for name, force in one.guides.items()}
    return Reactions(one.torque - other.torque, pins, guides, one.rows)
