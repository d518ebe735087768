"""Working and return strokes: the crank ranges in which loads act, and the slow stroke of an output."""

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.machine import Load, Machine, Process, slider_names
from optlink.io import without
from optlink.linkage.extrema import POINTS, distinct, refined_minima, zeros
from optlink.linkage.mechanism import FRAME
from optlink.linkage.stroke import OTHER, Direction, Pace, StrokeRange, Travel, pace_of, slow_stroke, travels
from optlink.linkage.vector2d import TURN, Array, Value

GRID = 720  # crank angles among which reversals are bracketed
AHEAD = 1e-6  # rad beyond a reversal at which the direction of motion is read
SAME_ANGLE = 1e-6  # rad; crank angles that near to one another are one, also one found as a zero and as a minimum


def load_strokes(machine: Machine, load: Load) -> dict[Direction, list[tuple[float, float]]]:
    """Return the crank ranges [rad] of a cycle in which the motion of a load is forward and backward.

    The crank turns fully, counter-clockwise.
    """

    def rates(angles: Array) -> Array:
        velocities = load.reversing(machine.moving(angles))
        return np.broadcast_to(0.0 if velocities is None else velocities[0], angles.shape)[None, :]

    cycle = machine.mechanism.cycle
    count = GRID * round(cycle / TURN)
    grid = np.linspace(0.0, cycle, count + 1) + 0.37 * TURN / GRID  # no reversal at a round angle lies on the seam
    at = zeros(rates, grid, still=True)[0]
    ranges: dict[Direction, list[tuple[float, float]]] = {"forward": [], "backward": []}
    if at.size == 0:
        ranges["forward" if float(np.nanmean(rates(grid))) > 0.0 else "backward"].append((0.0, cycle))
        return ranges
    signs = rates(at + AHEAD)[0]
    turns = np.append(True, np.sign(signs[1:]) != np.sign(signs[:-1]))  # a motion that only pauses does not reverse
    at, signs = at[turns], signs[turns]
    for begin, end, sign in zip(at, [*at[1:], at[0] + cycle], signs, strict=True):
        ranges["forward" if sign > 0.0 else "backward"].append((float(begin), float(end)))
    return ranges


def slower(ranges: Mapping[Direction, list[tuple[float, float]]]) -> Direction | None:
    """Return the slow one of both strokes from their crank ranges (`load_strokes`); None if both are equally long."""
    forward, backward = (math.fsum(end - begin for begin, end in ranges[name]) for name in OTHER)
    return slow_stroke(forward, backward)


@dataclass(frozen=True)
class StrokeLoad:
    """A load that acts in one stroke only.

    `stroke`: "forward" or "backward" along the load's own direction, for the actual sense of crank rotation; `ranges`: the crank
    ranges [rad] in which it acts, for a crank that turns counter-clockwise; `pace` of this stroke: "slow", "quick" or "equal".
    """

    load: str
    body: str
    stroke: Direction
    ranges: tuple[tuple[float, float], ...]
    pace: Pace


def acting_loads(machine: Machine, speed: float) -> tuple[StrokeLoad, ...]:
    """Return the loads that act in one stroke only, of a machine whose crank turns fully; only the sign of the speed is used."""
    acting = []
    for load in machine.processes:
        if load.stroke != "both":
            ranges = load_strokes(machine, load)
            other = OTHER[load.stroke] if speed < 0.0 else load.stroke
            direct, counter = (other, load.stroke) if load.turning else (load.stroke, other)
            acting.append(StrokeLoad(load.name, load.body, direct, tuple(ranges[counter]), pace_of(counter, slower(ranges))))
    return tuple(acting)


def working_stroke(travel: Travel, speed: float, acting: tuple[StrokeLoad, ...]) -> tuple[Direction | None, tuple[str, ...]]:
    """Return the working stroke of an output and the loads that define it; only the sign of the crank speed is used.

    It is the stroke in which loads of the same dead centres act; None where no load is limited to one stroke, or loads act in
    both.
    """
    loads_by_stroke: dict[Direction, list[str]] = {}
    for stroke in travel.strokes(speed):
        ends = sorted((stroke.begin, stroke.end))
        for item in acting:
            if len(item.ranges) == 1 and all(
                abs(math.remainder(a - b, TURN)) < SAME_ANGLE for a, b in zip(item.ranges[0], ends, strict=True)
            ):
                loads_by_stroke.setdefault(stroke.name, []).append(item.load)
    if len(loads_by_stroke) == 1:
        ((name, loads),) = loads_by_stroke.items()
        return name, tuple(loads)
    return None, ()


def travels_by_use(
    machine: Machine, swings: Mapping[str, Travel], strokes: Mapping[str, Travel]
) -> tuple[dict[str, Travel], dict[str, Travel]]:
    """Return slides and swings by label ("ram slides", "rocker swings"): first those of the outputs, then the others.

    Outputs are the bodies with limited motion on which forces or torques act; if there are none, the last output of the
    mechanism.
    """
    named = {f"{name} slides": travel for name, travel in strokes.items()}
    named |= {f"{name} swings": travel for name, travel in swings.items()}
    loaded = dict.fromkeys(load.body for load in machine.processes)
    outputs = [f"{body} {'slides' if body in strokes else 'swings'}" for body in loaded if body in strokes or body in swings]
    last, slides = last_output(machine, swings, strokes)
    outputs = outputs or [f"{last} {'slides' if slides else 'swings'}"]
    return {name: named[name] for name in outputs if name in named}, without(named, *outputs)


def named_travels(machine: Machine) -> tuple[dict[str, Travel], dict[str, Travel]]:
    """Return travels of the outputs and of the other bodies and sliders of a machine whose crank turns fully, by name."""
    swings, strokes = travels(machine.mechanism, machine.sizes, 0.0, TURN, True)
    names = slider_names(machine)
    return travels_by_use(machine, swings, {names[guide]: travel for guide, travel in strokes.items()})


def last_output(machine: Machine, swings: Collection[str], strokes: Collection[str]) -> tuple[str, bool]:
    """Return the last reciprocating slider on the frame and True, else the last body that swings (or turns) and False."""
    names = slider_names(machine)
    for guide in reversed(machine.mechanism.guides):
        if guide.on == FRAME and names[guide.name] in strokes:
            return names[guide.name], True
    bodies, cylinders = [link.body for link in machine.mechanism.links], machine.mechanism.cylinders
    return ([body for body in bodies[1:] if body in swings and body not in cylinders] or bodies)[-1], False


def use_of(stroke: StrokeRange, working: Direction | None) -> str:
    """Return the use of a stroke: "working", "return", or an empty string if there is no working stroke."""
    return "" if working is None else "working" if stroke.name == working else "return"


# Crank angles at which the expression of a load has a pole, a sharp peak, a corner or a jump, also between sampled positions.

SAMPLES = 1440  # of a range or revolution
SMALL = 1e-2  # share of its largest value below which a quantity may come close to zero between two samples
NOTHING = 1e-12  # share of its largest value that is zero
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
    for load in machine.processes:
        if not hasattr(load.magnitude, "breakpoints"):
            continue
        with np.errstate(all="ignore"):
            values = _breakpoints(machine, load, speed)
            samples = values(grid)
            crossed = np.concatenate([*zeros(values, grid, still=True, samples=samples), np.empty(0)])
            close, zero = _least(values, grid, samples)
            at = distinct(np.concatenate([crossed, close[zero]]))
            at = at[np.diff(at, prepend=-np.inf) > SAME_ANGLE]
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
            replace(load, magnitude=unknown) if load.name in names and isinstance(load, Process) else load  # type: ignore[call-arg]
            for load in machine.loads
        )
    )


def _breakpoints(machine: Machine, load: Process, speed: float) -> Callable[[Array], Array]:
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


def _grows(machine: Machine, load: Process, speed: float, at: Array) -> NDArray[np.bool_]:
    """Return whether the magnitude of a load grows without bound towards crank angles (n,), from either side."""
    beside = at[:, None, None] + BESIDE * np.array([[-1.0], [1.0]])
    values = load.magnitude(load.known(machine.moving(beside.ravel(), speed)))
    size = np.abs(np.broadcast_to(values, beside.size).reshape(beside.shape))
    steps = np.diff(size, axis=-1)
    grows = (steps[..., -1] > GROWTH * np.abs(steps[..., 0])) & (steps[..., -1] > ROUNDING * size[..., -1])
    return np.asarray(np.any(grows, axis=1))
