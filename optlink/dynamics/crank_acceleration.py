"""Acceleration of the crank under a torque, with Coulomb friction in guides: none, one or several, and rest.

References
----------
P. Painleve, Sur les lois du frottement de glissement, C. R. Acad. Sci. 121 (1895): friction may admit no motion, or several.
"""

import itertools
import math
from collections.abc import Iterator

import numpy as np

from optlink.dynamics.inverse import ROUNDING, Reactions, reactions, required_wrench, virtual_torque
from optlink.dynamics.machine import Moving
from optlink.linkage.vector2d import Value

STEADY = 1e-13  # share of the larger torque by which a resting machine may be out of balance and still stay at rest


def required_torque(moving: Moving, geared: Moving) -> tuple[Value, Reactions | None]:
    """Return the torque on the crank that a motion requires [N m], and the reactions if friction requires them (else None).

    `geared` are the same positions at a crank speed of 1 rad/s, in this whole module.
    """
    if moving.machine.friction:
        joint_reactions = reactions(moving)
        return joint_reactions.torque, joint_reactions
    return virtual_torque(required_wrench(moving), geared), None


def crank_acceleration(geared: Moving, speed: Value, torque: Value, direction: Value) -> Value:
    """Compute the angular acceleration of the crank [rad/s^2] under a driving torque, elementwise (forward dynamics).

    It is NaN where no signs of the normal forces in guides with friction are consistent, or several that differ are. The crank
    turns, or is about to turn, in `direction`: +1 or -1.
    """
    if geared.machine.friction:
        return acceleration_with_friction(geared, speed, torque, direction)[0]
    needed, _ = required_torque(geared.scaled(speed, 0.0, direction), geared)
    return (torque - needed) / (2.0 * geared.kinetic)


def accelerations_with_friction(
    geared: Moving, speed: Value, torque: Value, direction: Value
) -> Iterator[tuple[Value, Value, dict[str, float]]]:
    """Yield for all signs of the normal forces in guides the acceleration, whether it is consistent with them, and the signs.

    For assumed signs, torque and normal forces are linear in the acceleration: two accelerations determine them.
    """
    names = tuple(geared.machine.friction)
    step = 1.0 + speed * speed + np.abs(torque) / (2.0 * geared.kinetic)
    ends = [geared.scaled(speed, alpha, direction) for alpha in (0.0, step)]
    wrenches = [required_wrench(moving) for moving in ends]
    for trial in itertools.product((1.0, -1.0), repeat=len(names)):
        normals = dict(zip(names, trial, strict=True))
        still, moved = (reactions(moving, needed, normals) for moving, needed in zip(ends, wrenches, strict=True))
        share = (torque - still.torque) / (moved.torque - still.torque)
        pins = (*still.pins.values(), *moved.pins.values())
        loaded = (np.hypot(*force) for on in pins for force in on.values())
        least = -ROUNDING * (1.0 + np.abs(share)) * sum(loaded)
        fits: Value = np.isfinite(share)
        for name, sign in normals.items():
            low, high = (joint_reactions.guides[name].normal for joint_reactions in (still, moved))
            fits = fits & (sign * (low + share * (high - low)) >= least)
        yield share * step, fits, normals


def acceleration_with_friction(
    geared: Moving, speed: Value, torque: Value, direction: Value
) -> tuple[Value, dict[str, Value], Value]:
    """Return the acceleration of the crank, the signs of the normal forces in guides, and where several fit.

    The acceleration is NaN where no signs are consistent, or several whose accelerations differ.
    """
    chosen: Value = np.nan
    signs: dict[str, Value] = dict.fromkeys(geared.machine.friction, 1.0)
    several: Value = False
    for alpha, fits, normals in accelerations_with_friction(geared, speed, torque, direction):
        step = 1.0 + speed * speed + np.abs(torque) / (2.0 * geared.kinetic)
        several = several | (fits & (np.abs(alpha - chosen) > 1e-6 * step))
        first = fits & np.isnan(chosen)
        chosen = np.where(first, alpha, chosen)
        signs = {name: np.where(first, normals[name], sign) for name, sign in signs.items()}
    return np.where(several, np.nan, chosen), signs, several


def can_rest(geared: Moving, torque: float) -> bool:
    """Return whether friction in guides can hold a machine at rest against a torque of the drive [N m].

    Torque and friction are out of balance by a polynomial that is linear in every coefficient of friction, between minus and
    plus its largest value: it vanishes if it has both signs among all the largest ones. It is the torque times the
    determinants.
    """
    signs = set()
    for direction in (1.0, -1.0):
        still = geared.scaled(0.0, 0.0, direction)
        needed = required_wrench(still)
        for trial in itertools.product((1.0, -1.0), repeat=len(geared.machine.friction)):
            joint_reactions = reactions(still, needed, dict(zip(geared.machine.friction, trial, strict=True)))
            least = np.asarray(joint_reactions.torque).item()
            determinant = math.prod(np.asarray(sine).item() for sine in joint_reactions.singularity.values())
            lacks = abs(torque - least) > STEADY * (abs(torque) + abs(least))
            signs.add(np.sign(determinant * (torque - least)) if lacks else 0.0)
    return 0.0 in signs or {1.0, -1.0} <= signs
