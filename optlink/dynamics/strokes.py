"""Working and return strokes: the crank ranges in which loads act, and the slow stroke of an output."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from optlink.dynamics.loads import Force, Torque
from optlink.dynamics.machine import Load, Machine, slider_names
from optlink.linkage.mechanism import FRAME
from optlink.linkage.stroke import OTHER, Direction, Pace, StrokeRange, Travel, pace_of, slow_stroke, travels
from optlink.linkage.vector2d import TURN, Array
from optlink.linkage.zeros import zeros

GRID = 720  # crank angles among which reversals are bracketed
AHEAD = 1e-6  # rad beyond a reversal at which the direction of motion is read
SAME_ANGLE = 1e-6  # rad; crank angles that near to one another are one


def load_strokes(machine: Machine, load: Load) -> dict[Direction, list[tuple[float, float]]]:
    """Return the crank ranges [rad] of a cycle in which the motion of a load is forward and backward.

    The crank turns fully, counter-clockwise.
    """

    def rates(angles: Array) -> Array:
        velocities = load.reversing(machine.moving(angles))
        return np.broadcast_to(np.asarray(0.0 if velocities is None else velocities[0], dtype=float), angles.shape)[None, :]

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
    for load in machine.loads:
        if isinstance(load, Force | Torque) and load.stroke != "both":
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
    loaded = dict.fromkeys(load.body for load in machine.loads if isinstance(load, Force | Torque))
    outputs = [f"{body} {'slides' if body in strokes else 'swings'}" for body in loaded if body in strokes or body in swings]
    last, slides = last_output(machine, swings, strokes)
    outputs = outputs or [f"{last} {'slides' if slides else 'swings'}"]
    return {name: named[name] for name in outputs if name in named}, {n: t for n, t in named.items() if n not in outputs}


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
    bodies = [link.body for link in machine.mechanism.links]
    return ([body for body in bodies[1:] if body in swings] or bodies)[-1], False


def use_of(stroke: StrokeRange, working: Direction | None) -> str:
    """Return the use of a stroke: "working", "return", or an empty string if there is no working stroke."""
    return "" if working is None else "working" if stroke.name == working else "return"
