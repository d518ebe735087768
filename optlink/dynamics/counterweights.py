"""Reactions, torque and shaking forces as affine functions of the parameters of counterweights and springs.

A counterweight adds four inertial parameters to its body (`optlink.dynamics.machine.Parameters`), a spring its stiffness k and
the product k * free length; reactions, torque and shaking forces are linear in all of these. Balancing is therefore a convex
programme.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from optlink.dynamics.columns import MotionColumns
from optlink.dynamics.machine import UNITS, Inertia, Moving, Parameters, Spring
from optlink.linkage.vector2d import Array

Quantity: TypeAlias = Callable[[MotionColumns], Array]
"""A force or torque by inverse dynamics, an array (positions, parts); linear in the inertial parameters and in the loads."""


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
        return self.matrix @ parameters + self.offset

    def compressed(self) -> tuple[Array, Array]:
        """Return R (k, n) and r (k,), k <= n + 1, with |R x + r| the root mean square over the positions for every x.

        The result is exact, because the R factor of a QR decomposition preserves the norm.
        """
        n = self.matrix.shape[-1]
        tall = np.concatenate([self.matrix.reshape(-1, n), self.offset.reshape(-1, 1)], axis=1)
        small: Array = np.asarray(np.linalg.qr(tall / math.sqrt(len(self.offset)), mode="r"))
        return small[:, :n], small[:, n]


@dataclass(frozen=True)
class _Unit(Inertia):
    """One inertial parameter of a body by itself, which no mass distribution has."""

    parameters: Parameters = UNITS[0]


class Effects:
    """Effects of the parameters of counterweights (four for each body) and springs (k and k * free length each).

    `moving` is the original machine at the positions (positions,).
    """

    def __init__(self, moving: Moving, bodies: Sequence[str], springs: Sequence[FreeSpring]) -> None:
        self.bodies, self.springs = tuple(bodies), tuple(springs)
        self.original = MotionColumns(moving)
        self.count = 4 * len(self.bodies) + 2 * len(self.springs)
        bare = moving.machine.with_(inertias={}, loads=(), friction={})
        alone = [bare.with_(inertias={body: _Unit(parameters=unit)}) for body in self.bodies for unit in UNITS]
        alone += [bare.with_(loads=(spring.spring(1.0, free),)) for spring in self.springs for free in (0.0, 1.0)]
        self.alone = [MotionColumns(Moving(machine, moving.motion)) for machine in alone]

    def lengths(self, spring: FreeSpring) -> Array:
        """Return the length of a spring over the positions [m]."""
        (ax, ay), (bx, by) = (self.original.moving.position(point) for _, point in spring.ends)
        return self.original.full(np.hypot(np.asarray(bx) - ax, np.asarray(by) - ay))

    def affine(self, quantity: Quantity) -> Affine:
        """Return a quantity as an affine function: its value in the original machine, and its change per unit of a parameter."""
        matrix = np.stack([quantity(record) for record in self.alone], axis=-1)
        k = 4 * len(self.bodies)
        matrix[..., k + 1 :: 2] -= matrix[..., k::2]  # a spring of free length 1 m less one of free length 0
        return Affine(matrix, quantity(self.original))
