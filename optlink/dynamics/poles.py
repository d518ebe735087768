"""Crank angles at which the expression of a load has a pole, a sharp peak, a corner or a jump, also between sampled positions."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.loads import Force, Torque
from optlink.dynamics.machine import Machine
from optlink.linkage.extrema import POINTS, distinct, refined_minima
from optlink.linkage.vector2d import Array, Value
from optlink.linkage.zeros import zeros

SAMPLES = 1440  # of a range or revolution
SMALL = 1e-2  # share of its largest value below which a quantity may come close to zero between two samples
NOTHING = 1e-12  # share of its largest value that is zero
SAME = 1e-6  # rad between positions that are one, found as a zero and as a minimum
BESIDE = np.array([1e-3, 1e-4, 1e-5, 1e-6])  # rad from a position at which a load may grow without bound
GROWTH, ROUNDING = 0.5, 1e-3  # least ratio of its last step to its first, and share of its value that may be rounding error


class Irregular(NamedTuple):
    """Irregular crank angles [rad] of the loads of a machine.

    `corners`: where an expression may have a corner or a jump; `peaks`: where it may have a sharp peak; `poles`: by the name of
    the load, where it grows without bound.
    """

    corners: Array
    peaks: Array
    poles: dict[str, Array]


def irregular(machine: Machine, grid: Array, speed: float) -> Irregular:
    """Return the irregular crank angles of the loads of a machine at a crank speed [rad/s].

    The rising grid [rad] is so fine that a denominator has at most one zero or minimum between neighbours.
    """
    corners, peaks, unbounded = [np.empty(0)], [np.empty(0)], {}
    for load in machine.loads:
        if not isinstance(load, Force | Torque) or not hasattr(load.magnitude, "breakpoints"):
            continue
        with np.errstate(all="ignore"):
            values = _breakpoints(machine, load, speed)
            samples = values(grid)
            crossed = np.concatenate([*zeros(values, grid, still=True, samples=samples), np.empty(0)])
            close, zero = _least(values, grid, samples)
            at = distinct(np.concatenate([crossed, close[zero]]))
            at = at[np.diff(at, prepend=-np.inf) > SAME]
            irregular_angles = at[_grows(machine, load, speed, at)] if at.size else at
        corners.append(crossed)
        peaks.append(close)
        if irregular_angles.size:
            unbounded[load.name] = irregular_angles
    return Irregular(np.concatenate(corners), np.concatenate(peaks), unbounded)


def poles(machine: Machine, angles: Array, speed: float) -> Array:
    """Return the crank angles [rad] at which a load grows without bound, in the range of some crank angles (n,)."""
    grid = np.linspace(np.min(angles), np.max(angles), SAMPLES + 1)
    return np.concatenate([*irregular(machine, grid, speed).poles.values(), np.empty(0)])


def without_values(machine: Machine, names: Collection[str]) -> Machine:
    """Return a machine whose loads of some names have the value NaN, which marks all that depends on them."""

    def unknown(known: Mapping[str, Value]) -> Value:
        return np.nan

    return machine.with_(
        loads=tuple(
            replace(load, magnitude=unknown) if load.name in names and isinstance(load, Force | Torque) else load
            for load in machine.loads
        )
    )


def _breakpoints(machine: Machine, load: Force | Torque, speed: float) -> Callable[[Array], Array]:
    """Return a function of crank angles (n,) to the quantities (k, n) at whose zeros the magnitude of a load is irregular."""

    def values(angles: Array) -> Array:
        points = load.magnitude.breakpoints(load.known(machine.moving(angles, speed)))  # type: ignore[attr-defined]
        return np.array([np.broadcast_to(value, angles.shape) for value in points]).reshape(len(points), len(angles))

    return values


def _least(values: Callable[[Array], Array], grid: Array, samples: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the crank angles at which a quantity comes close to zero, its sign unchanged, and whether it is zero there."""
    size = np.where(np.isfinite(samples), np.abs(samples), np.inf)
    largest = np.max(np.where(np.isfinite(samples), size, 0.0), axis=1, initial=0.0)
    wide = np.pad(size, ((0, 0), (1, 1)), constant_values=np.inf)
    signs = np.sign(np.pad(samples, ((0, 0), (1, 1)), mode="edge"))
    same = (signs[:, :-2] * signs[:, 1:-1] >= 0.0) & (signs[:, 1:-1] * signs[:, 2:] >= 0.0)
    lowest = (size <= wide[:, :-2]) & (size <= wide[:, 2:]) & (size <= SMALL * largest[:, None])
    rows, place = np.nonzero(lowest & same)
    if not rows.size:
        return np.empty(0), np.zeros(0, dtype=bool)

    def own(points: Array, which: NDArray[np.intp]) -> Array:
        every = values(points.ravel())[rows[which].repeat(points.shape[1]), np.arange(points.size)]
        return np.abs(every).reshape(points.shape)

    low, high = grid[np.maximum(place - 1, 0)], grid[np.minimum(place + 1, len(grid) - 1)]
    none = np.full((len(rows), POINTS), np.nan)
    best = (grid[place], size[rows, place], low, high)
    at, least = refined_minima(own, best, np.arange(len(rows)), none, none.copy())
    return at, least <= NOTHING * largest[rows]


def _grows(machine: Machine, load: Force | Torque, speed: float, at: Array) -> NDArray[np.bool_]:
    """Return whether the magnitude of a load grows without bound towards crank angles (n,), from either side."""
    beside = at[:, None, None] + BESIDE * np.array([[-1.0], [1.0]])
    values = load.magnitude(load.known(machine.moving(beside.ravel(), speed)))
    size = np.abs(np.broadcast_to(np.asarray(values, dtype=float), beside.size).reshape(beside.shape))
    steps = np.diff(size, axis=-1)
    grows = (steps[..., -1] > GROWTH * np.abs(steps[..., 0])) & (steps[..., -1] > ROUNDING * size[..., -1])
    return np.asarray(np.any(grows, axis=1))
