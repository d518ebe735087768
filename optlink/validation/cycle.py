"""Measure a machine over its cycle by ordinary inverse dynamics on a refined sweep, one-sided at load jumps."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property

import numpy as np

from optlink.dynamics.columns import MotionColumns
from optlink.dynamics.machine import Acting, Load, Machine, Moving, Parameters, slider_names
from optlink.dynamics.work import NODES, WEIGHTS, Work, gauss_points
from optlink.io import keeping
from optlink.linkage.extrema import distinct, extremes, maxima
from optlink.linkage.motion import sweep
from optlink.linkage.singular import AlignedPosition
from optlink.linkage.stroke import Ranges, Travel, reachable, travels
from optlink.linkage.vector2d import TURN, Array, max_magnitude, turn, whole_turns
from optlink.problem.design import DesignProblem
from optlink.problem.limits import stroke_ratio
from optlink.problem.quantity import Unusable
from optlink.problem.terms import Term, guide_of, output_of
from optlink.validation.check import POSITIONS
from optlink.validation.motion import FourBarMotion, LinkageMotion, motion_of

ROUNDING = 1e-6  # of the size of the signal, below which a mean or a work counts as zero


class _Weight(Load):
    """Gravity on a body as a separate load, which remains if its inertia is removed."""

    def __init__(self, body: str, parameters: Parameters, gravity: tuple[float, float]) -> None:
        self.name, self.body, self.parameters, self.gravity = f"weight of {body}", body, parameters, gravity

    def act(self, moving: Moving) -> Iterator[Acting]:
        """Yield the weight at the start of the body, and its moment."""
        state, (mass, along, across, _) = moving.state(self.body), self.parameters
        x, y = turn((along, across), state.axis)
        force = mass * self.gravity[0] + 0.0 * state.alpha, mass * self.gravity[1] + 0.0 * state.alpha
        yield Acting(self.body, state.start, force, x * self.gravity[1] - y * self.gravity[0])


class Cycle:
    """A design in motion, with the measured values of its terms; quantities [SI] not named have their value in the file."""

    def __init__(self, problem: DesignProblem, design: Mapping[str, float]) -> None:
        self.problem = problem
        self.design: dict[str, float] = problem.complete(design)
        self.machine = problem.machine(self.design)
        self.mechanism, self.speed = self.machine.mechanism, problem.driving.pace
        self.limits = self.mechanism.limits
        self.low, self.high = self.limits or (0.0, self.machine.cycle)
        self._figures: dict[Term, float] = {}
        self._back: dict[Term, bool] = {}

    @cached_property
    def _ranges(self) -> Ranges:
        return reachable(self.mechanism, self.design)

    @property
    def complete(self) -> bool:
        """Whether the crank turns fully, or the drive moves through its range."""
        return self._ranges.complete

    @property
    def singular(self) -> tuple[AlignedPosition, ...]:
        """Singular positions."""
        return self._ranges.singular

    @property
    def cycle(self) -> float:
        """Crank rotation [rad] of a cycle, or through the range of the drive."""
        return self.high - self.low

    @property
    def _motion(self) -> tuple[float, float]:
        """Crank angles [rad] between which the motion alone is complete."""
        return self.limits or (0.0, self.mechanism.cycle)

    @property
    def over(self) -> str:
        """What the quantities are taken over, in words."""
        return "the revolution" if self.limits is None else "the range"

    @cached_property
    def positions(self) -> Array:
        """Evenly spaced crank angles [rad] of a cycle, or of the range of the drive, with its end."""
        return np.linspace(self.low, self.high, POSITIONS * whole_turns(self.cycle) + 1)

    @property
    def longest(self) -> float:
        """The largest length or coordinate [m]."""
        return max(abs(value) for name, value in self.design.items() if self.problem.quantities[name].in_metres)

    @cached_property
    def revolution(self) -> FourBarMotion | LinkageMotion:
        """The motion over a revolution, or over the range of the drive."""
        sizes = {name: np.array([[value]]) for name, value in self.design.items()}
        if self.limits is None:
            angles = np.linspace(0.0, TURN, POSITIONS, endpoint=False)
            return motion_of(self.mechanism, self.mechanism, sizes, angles, self.longest, closed=True)
        return motion_of(self.mechanism, self.mechanism, sizes, self.positions, self.longest, span=self.cycle)

    @cached_property
    def work(self) -> Work:
        """Work of the drive from crank angle 0 over a cycle, or through the range of the drive."""
        if self.limits is not None:
            return Work(self.machine, self.low if self.speed > 0.0 else self.high, self.low, self.high, self.speed)
        low, high = (0.0, self.cycle) if self.speed > 0.0 else (-self.cycle, 0.0)
        return Work(self.machine, 0.0, low, high, self.speed)

    @cached_property
    def _travels(self) -> tuple[dict[str, Travel], dict[str, Travel]]:
        return travels(self.mechanism, self.design, *self._motion, self.limits is None)

    @cached_property
    def _still(self) -> Machine:
        """The machine with weights and loads only."""
        machine = self.machine
        weights = (_Weight(body, mass.parameters, machine.gravity) for body, mass in machine.inertias.items())
        return machine.with_(inertias={}, gravity=(0.0, 0.0), loads=(*machine.loads, *weights))

    def figure(self, term: Term) -> float:
        """Return the value of a term [SI], measured once; NaN if it is undefined."""
        if term not in self._figures:
            self._figures[term] = self._figure(term)
        return self._figures[term]

    def on_way_back(self, term: Term) -> bool:
        """Return whether the value of a term occurs on the way back through the range."""
        return math.isfinite(self.figure(term)) and self._back.get(term, False)

    def _figure(self, term: Term) -> float:
        if term.quantity == "total length":
            lengths, loop = [self.design[name] for name in self.problem.lengths], self.problem.placed_frame
            if loop is not None:
                pivots = (self.machine.moving([0.0]).position(pin) for pin in (self.mechanism.crank.start, loop.ground_pin))
                lengths.append(math.dist(*([float(part) for part in pivot] for pivot in pivots)))
            return math.fsum(lengths)
        if term.quantity == "length":
            return self.design[str(term.of)]
        if not self.complete:
            return math.nan
        if term.nature.cyclic:
            return self._cyclic(term)
        if term.quantity == "work":
            return self._work(term)
        kind, output = output_of(term, self.mechanism)
        if kind == "point":
            return self._point(term)
        swings, slides = self._travels
        travel = (slides if kind == "guide" else swings).get(output)
        if travel is None:
            return math.nan
        if term.quantity == "end":
            return travel.high if term.stroke == "forward" else travel.low
        if term.quantity == "stroke":
            return travel.span
        strokes = {stroke.name: stroke.rotation for stroke in travel.strokes(self.speed)}
        return stroke_ratio(strokes["forward"], strokes["backward"], term.stroke) if strokes else math.nan

    def _point(self, term: Term) -> float:
        """Return the stroke, an end, or the time ratio of a point along a direction, from the extremes of its path."""
        assert term.direction is not None
        way = np.array([math.cos(term.direction.value), math.sin(term.direction.value)])
        low, high = self._motion
        grid = np.linspace(low, high, POSITIONS * whole_turns(high - low) + 1)

        def along(at: Array) -> Array:
            placed: Array = sweep(self.mechanism, self.design, at).position(str(term.of)) @ way
            return placed[None, :]

        angles, values = extremes(along, grid, periodic=self.limits is None)
        if term.quantity == "end":
            return float(values[0, 1 if term.stroke == "forward" else 0])
        if term.quantity == "stroke":
            return float(values[0, 1] - values[0, 0])
        forward = math.copysign(1.0, self.speed) * float(angles[0, 1] - angles[0, 0]) % TURN
        return stroke_ratio(forward, TURN - forward, term.stroke)

    def _work(self, term: Term) -> float:
        """Return the work of the drive per revolution, or in a stroke of a slider, mean over the revolutions of a cycle.

        Of a range it is the work from the one end to the other.
        """
        if self.limits is not None:
            return float(self.work(np.array([self.high if self.speed > 0.0 else self.low]))[0])
        sense, revolutions = math.copysign(self.cycle, self.speed), round(self.cycle / TURN)
        whole, back = float(self.work(np.array([sense]))[0]), min(sense, 0.0)
        if term.of is None:
            return whole / revolutions
        travel = self._travels[1][str(guide_of(str(term.of), self.mechanism))]
        begin, end = (travel.low_at, travel.high_at) if term.stroke == "forward" else (travel.high_at, travel.low_at)
        begins, ends = (np.array([at % TURN + TURN * k + back for k in range(revolutions)]) for at in (begin, end))
        stroke_work = float(np.sum(self.work(ends) - self.work(begins)))
        return (stroke_work if (ends[0] - begins[0]) * sense >= 0.0 else stroke_work + whole) / revolutions

    def history(self, term: Term) -> tuple[Machine, Callable[[MotionColumns], Array]]:
        """Return the machine of a cyclic term, and a function that reads the term from a record."""
        read = term.nature.history
        assert read is not None
        return self._still if term.static else self.machine, lambda record: read(record, term)

    def _cyclic(self, term: Term) -> float:
        """Return the value of a cyclic term; extremes of the same machine are all measured on the same positions."""
        machine, read = self.history(term)
        if not term.extreme:
            return self.work.mean(lambda at: read(MotionColumns(machine.moving(at, self.speed))), square=term.how == "rms")
        terms = [term, *self.problem.goals, *(item.term for item in self.problem.bounds)]
        alike = [other for other in terms if other.extreme and other.static == term.static]
        self._figures |= zip(alike, self._extremes(machine, alike, self.speed, self.work).tolist(), strict=True)
        forced = [other for other in alike if other.nature.forces and self.mechanism.returns]
        if forced:
            back = self._extremes(machine, forced, -self.speed, Work(self.machine, self.low, self.low, self.high, -self.speed))
            for each, value in zip(forced, back.tolist(), strict=True):
                sense, there = -1.0 if each.how == "least" else 1.0, self._figures[each]
                self._back[each] = sense * (value - there) > ROUNDING * abs(there)
                self._figures[each] = sense * max(sense * value, sense * there)
        return self._figures[term]

    def _extremes(self, machine: Machine, terms: Sequence[Term], speed: float, work: Work) -> Array:
        """Return the values (terms,) of terms that a single position decides, one-sided at load jumps."""
        scores: dict[str, Callable[[Array], Array]] = {"peak": np.abs, "largest": np.positive, "least": np.negative}
        reads = [(scores[term.how], self.history(term)[1]) for term in terms]
        jumps, breaks, tops = work.jumps, work.breaks, work.peaks
        if periodic := self.limits is None:
            jumps, breaks, tops = (np.remainder(at, self.cycle) for at in (jumps, breaks, tops))

        def values(angles: Array, side: int = 1) -> Array:
            record = MotionColumns(machine.moving(angles, speed, side=side))
            return np.array([score(read(record)) for score, read in reads])

        peaks = maxima(values, distinct(np.concatenate([self.positions, tops])), tuple(breaks), periodic=periodic)[1]
        if jumps.size:
            peaks = np.maximum(peaks, np.nanmax(values(jumps, side=-1), axis=1))
        return np.where([term.how == "least" for term in terms], -peaks, peaks)

    def objective(self) -> float:
        """Return the minimised value: a term [SI], negative if maximised, or a weighted sum."""
        return self._weighted([self.figure(goal) * (-1.0 if goal.sense == "maximise" else 1.0) for goal in self.problem.goals])

    def _weighted(self, values: Sequence[float]) -> float:
        """Return the sum of values of the goals [SI], each over its scale if there are several."""
        if self.problem.single:
            return values[0]
        goals = zip(self.problem.goals, self.problem.scales, values, strict=True)
        return math.fsum(goal.weight * value / (scale or 1.0) for goal, scale, value in goals)

    def size(self, term: Term) -> float:
        """Return a reference value of the signal of a term [SI] if the term itself may vanish; otherwise zero."""
        if term.quantity in ("end", "slide", "length"):
            return self.longest
        if not self.complete or (term.how != "mean" and term.quantity != "work"):
            return 0.0
        if term.how != "mean":
            power = MotionColumns(self.machine.moving(self.positions, self.speed))["input.power_W"]
            return max_magnitude(power) / abs(self.speed) * (self.mechanism.extent[1] - self.mechanism.extent[0])
        machine, read = self.history(term)
        return max_magnitude(read(MotionColumns(machine.moving(self.positions, self.speed))))

    def natural(self) -> float:
        """Return the value [unit of the objective] below which the objective is a rounding error."""
        return self._weighted([ROUNDING * self.size(goal) for goal in self.problem.goals])

    def imbalance(self) -> float:
        """Return the work per revolution not balanced between drive and loads, relative to the exchanged energy; zero in a cycle.

        The exchanged energy is the integral of the absolute powers over the revolution plus the kinetic energy: without
        loads the works all vanish, in a machine balanced on its crank the powers too. Over a range the work also changes the
        energy of bodies, from the one end to the other.
        """
        points, half = gauss_points(self.work.knots[:-1], self.work.knots[1:])
        moving = self.machine.moving(points.ravel(), self.speed)
        record, names = MotionColumns(moving), slider_names(self.machine)
        powers = [record["input.power_W"]]
        powers += [record[f"{guide}.friction_N"] * record[f"{names[guide]}.v_m_s"] for guide in self.machine.friction]
        acting = [force for load in self.machine.loads for force in load.act(moving)]
        powers += [np.broadcast_to(force.power(moving.state(force.body)), points.size) for force in acting]

        def whole(power: Array) -> float:
            return float(np.sum(half * (power.reshape(-1, len(NODES)) @ WEIGHTS))) / self.speed

        fed = math.fsum(abs(whole(np.abs(power))) for power in powers)
        stored, gained = max_magnitude(moving.kinetic), 0.0
        if self.limits is not None:
            ends = self.machine.moving(np.array([self.low, self.high]), self.speed)
            energy = np.broadcast_to(ends.kinetic + self.machine.weight(ends.state), 2)
            gained = float(energy[1] - energy[0])
        return abs(math.fsum(whole(power) for power in powers) - gained) / max(fed + stored, 1e-300)


def cycle_of(problem: DesignProblem, values: Mapping[str, float]) -> Cycle | None:
    """Return a design [SI] in motion; None if it cannot be built."""
    try:
        return Cycle(problem, keeping(values, *problem.mechanism.quantities))
    except Unusable:
        return None
