"""Detect reactions that grow without bound towards change points through which the motion is continued."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from optlink.dynamics.columns import MotionColumns
from optlink.dynamics.machine import Machine
from optlink.linkage.alignment import AlignedPosition
from optlink.linkage.vector2d import Array

NEAR, NEARER, ASIDE = 1e-4, 1e-5, 1e-2
"""Distances from a change point [rad] at which reactions are compared with one another, and with what they usually are."""

GROWS, NOTHING = 0.3, 1e-9
"""Shares: force times distance that stays as large when the distance is a tenth; and of the usual force what is rounding."""


def pin_columns(machine: Machine) -> list[tuple[str, str, str]]:
    """Return the column name of the magnitude, the pin and the body of every joint force."""
    return [
        (f"{point}.f_N" if len(bodies) == 2 else f"{point}.{body}.f_N", point, body)
        for point, bodies in machine.mechanism.pins.items()
        for body in (bodies[:1] if len(bodies) == 2 else bodies)
    ]


def unbounded_reactions(machine: Machine, positions: Sequence[AlignedPosition], speed: float) -> tuple[str, ...]:
    """Return the columns of reactions that grow without bound towards change points.

    Parameters
    ----------
    machine : Machine
    positions : sequence of AlignedPosition
        Change points through which the machine is continued.
    speed : float [rad/s]

    Notes
    -----
    Such a force grows as the inverse of the distance, so force times distance has a limit other than zero.
    """
    if not positions:
        return ()
    at = np.array([position.crank_angle for position in positions])
    names, near = _amounts(machine, at, NEAR, speed)
    _, nearer = _amounts(machine, at, NEARER, speed)
    _, usual = _amounts(machine, at, ASIDE, speed)
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
