"""A machine designed by its cycle, proven: ordinary inverse dynamics on a fine sweep, refined, one-sided where forces jump."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.columns import Record, slider_names
from optlink.dynamics.inertia import Parameters
from optlink.dynamics.inverse import reported_on
from optlink.dynamics.loads import Acting
from optlink.dynamics.machine import Machine, Moving
from optlink.dynamics.work import NODES, WEIGHTS, Work
from optlink.linkage.dyad_types import RRP, RRR
from optlink.linkage.extrema import extremes
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.stroke import TURN, Travel, reachable, travels
from optlink.linkage.vector2d import Value, turn
from optlink.problem.cycle import Bound, CycleProblem
from optlink.problem.cycle_terms import Term, guide_of, output_of
from optlink.problem.mechanism import sizes_of
from optlink.problem.quantity import Unusable
from optlink.units import KINDS, factor
from optlink.validation.check import LENGTH_TOLERANCE, POSITIONS, Check, Validation, bound, nan_last, time_ratio
from optlink.validation.margins import alignment_checks

Array = NDArray[np.float64]

AGREE = 1e-6  # relative, of a figure that was measured by two routes
MEET = 1e-6  # relative, by which a limit may be missed
ROUNDING = 1e-6  # of the size of its course, below which a mean or a work is taken for zero
NOTHING = 1e-3  # of the same, by which the room of a limit of zero is measured
BALANCE = 1e-9  # relative, to which the work of the drive is that of the loads


class _Weight:
    """Gravity on a body as a load of its own: what is left of a body whose inertia is taken away."""

    switching = False

    def __init__(self, body: str, parameters: Parameters, gravity: tuple[float, float]) -> None:
        self.name, self.body, self.parameters, self.gravity = f"weight of {body}", body, parameters, gravity

    def act(self, moving: Moving) -> Iterator[Acting]:
        """The weight at the start of the body, and its moment."""
        state, (mass, along, across, _) = moving.state(self.body), self.parameters
        x, y = turn((along, across), state.axis)
        force = mass * self.gravity[0] + 0.0 * state.alpha, mass * self.gravity[1] + 0.0 * state.alpha
        yield Acting(self.body, state.start, force, x * self.gravity[1] - y * self.gravity[0])

    def reversing(self, moving: Moving) -> None:
        """It never jumps."""
        return

    def potential(self, moving: Moving) -> Value:
        """Not asked for here."""
        return 0.0


def without_inertia(machine: Machine) -> Machine:
    """The same machine with weights and loads alone."""
    weights = tuple(_Weight(body, mass.parameters, machine.gravity) for body, mass in machine.inertias.items())
    return machine.with_(inertias={}, gravity=(0.0, 0.0), loads=(*machine.loads, *weights))


@dataclass(frozen=True)
class Course:
    """One machine over its revolution: its records, on either side of where loads jump."""

    machine: Machine
    speed: float
    jumps: Array

    def values(self, columns: Callable[[Record], Array], angles: Array, side: int = 1) -> Array:
        """A quantity at crank angles (n,)."""
        return columns(Record(self.machine.moving(angles, self.speed, side=side)))


class Cycle:
    """A design in motion: what its terms are, measured.

    Parameters
    ----------
    problem : CycleProblem
    design : mapping of quantity to float [SI]; the start of the file where one is not named
    """

    def __init__(self, problem: CycleProblem, design: Mapping[str, float]) -> None:
        self.problem = problem
        self.design = {**sizes_of(problem.quantities), **design}
        self.machine = problem.machine(self.design)
        self.mechanism, self.speed = self.machine.mechanism, problem.drive.speed.value
        ranges = reachable(self.mechanism, self.design)
        self.full, self.singular = ranges.full, ranges.singular

    @cached_property
    def work(self) -> Work:
        """Work of the drive from crank angle 0 on."""
        low, high = (0.0, TURN) if self.speed > 0.0 else (-TURN, 0.0)
        return Work(self.machine, 0.0, low, high, self.speed)

    @cached_property
    def _travels(self) -> tuple[dict[str, Travel], dict[str, Travel]]:
        return travels(self.mechanism, self.design, 0.0, TURN, True)

    @cached_property
    def _still(self) -> Machine:
        return without_inertia(self.machine)

    def travel(self, term: Term) -> Travel | None:
        """The motion of an output between its dead centres."""
        kind, name = output_of(term, self.mechanism)
        swings, strokes = self._travels
        return strokes.get(name) if kind == "guide" else swings.get(name)

    def figure(self, term: Term) -> float:
        """A term of the problem [SI]; NaN where it has no value."""
        if not self.full:
            return self.design[str(term.of)] if term.quantity == "length" else math.nan
        if term.nature.cyclic:
            return self._cyclic(term)
        if term.quantity == "length":
            return self.design[str(term.of)]
        if term.quantity == "work":
            return self._work(term)
        if output_of(term, self.mechanism)[0] == "point":
            return self._point(term)
        found = self.travel(term)
        if found is None:
            return math.nan
        if term.quantity == "end":
            return found.high if term.stroke == "forward" else found.low
        if term.quantity == "stroke":
            return found.span
        strokes = {stroke.name: stroke.rotation for stroke in found.strokes(self.speed)}
        return time_ratio(strokes["forward"], strokes["backward"], term.stroke) if strokes else math.nan

    def _point(self, term: Term) -> float:
        """Stroke of a point along a direction, one of its ends, or its time ratio, from the extremes of its course."""
        assert term.direction is not None
        way = np.array([math.cos(term.direction.value), math.sin(term.direction.value)])
        grid = np.linspace(0.0, TURN, POSITIONS + 1)
        angles, values = extremes(lambda at: (sweep(self.mechanism, self.design, at).position(str(term.of)) @ way)[None, :], grid)
        if term.quantity == "end":
            return float(values[0, 1 if term.stroke == "forward" else 0])
        if term.quantity == "stroke":
            return float(values[0, 1] - values[0, 0])
        forward = math.copysign(1.0, self.speed) * float(angles[0, 1] - angles[0, 0]) % TURN
        return time_ratio(forward, TURN - forward, term.stroke)

    def _work(self, term: Term) -> float:
        sense = math.copysign(TURN, self.speed)
        if term.of is None:
            return float(self.work(np.array([sense]))[0])
        travel = self._travels[1][str(guide_of(str(term.of), self.mechanism))]
        begin, end = (travel.low_at, travel.high_at) if term.stroke == "forward" else (travel.high_at, travel.low_at)
        if self.speed < 0.0:
            begin, end = begin % TURN - TURN, end % TURN - TURN
            whole = float(self.work(np.array([-TURN]))[0])
            one = float(np.diff(self.work(np.array([begin, end])))[0])
            return one if end <= begin else one + whole
        begin, end = begin % TURN, end % TURN
        whole, one = float(self.work(np.array([TURN]))[0]), float(np.diff(self.work(np.array([begin, end])))[0])
        return one if end >= begin else one + whole

    def course(self, term: Term) -> tuple[Machine, Callable[[Record], Array]]:
        """The machine that a cyclic term is of, and how its size is read from a record."""
        what, name = term.quantity, str(term.of)
        machine = self._still if term.static else self.machine

        def size(x: str, y: str) -> Callable[[Record], Array]:
            return lambda record: np.hypot(record[x], record[y])

        if what == "torque":
            return machine, lambda record: record["input.torque_Nm"]
        if what == "reaction":
            on = term.on or reported_on(self.machine)[name]

            def pin(record: Record) -> Array:
                x, y = (record.full(part) for part in record.reactions.pins[name][on])
                return np.asarray(np.hypot(x, y))

            return machine, pin
        if what == "shaking force":
            return machine, size("frame.shaking_fx_N", "frame.shaking_fy_N")
        if what == "shaking moment":
            return machine, lambda record: record["frame.shaking_moment_Nm"]
        if what == "velocity":
            return machine, size(f"{name}.vx_m_s", f"{name}.vy_m_s")
        if what == "acceleration":
            return machine, size(f"{name}.ax_m_s2", f"{name}.ay_m_s2")
        if what == "transmission angle":
            return machine, lambda record: self._transmission(name, record)
        guide = str(guide_of(name, self.mechanism))
        slider = slider_names(self.machine)[guide]
        column = {"guide force": f"{guide}.normal_N", "guide moment": f"{guide}.moment_Nm", "slide": f"{slider}.s_m"}
        if what == "lever arm":
            return machine, lambda record: np.abs(record[f"{slider}.v_m_s"] / self.speed)
        return machine, lambda record: record[column[what]]

    def _transmission(self, joint: str, record: Record) -> Array:
        """Angle at a joint by its cosine [rad]: between two links, or of a link with the normal of the slider's line."""
        group = next(group for group in self.mechanism.groups if group.joint == joint)
        if isinstance(group, RRR):
            return record[f"{joint}.transmission_rad"]
        motion = record.moving.motion
        assert isinstance(group, RRP)
        link = np.asarray(motion.position(joint) - motion.position(group.outer))
        line = record.moving.line(group.guide.name)
        cosine = (line[0] * link[:, 1] - line[1] * link[:, 0]) / np.linalg.norm(link, axis=1)
        return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))  # beyond +-1 is rounding

    def _cyclic(self, term: Term) -> float:
        machine, read = self.course(term)
        if term.how in ("rms", "mean"):
            return self._average(machine, read, square=term.how == "rms")
        jumps = self.work.jumps

        def values(angles: Array, side: int = 1) -> Array:
            return read(Record(machine.moving(angles, self.speed, side=side)))[None, :]

        grid = np.unique(np.concatenate([np.linspace(0.0, TURN, POSITIONS + 1), np.remainder(jumps, TURN)]))
        least, largest = extremes(values, grid, tuple(np.remainder(jumps, TURN)))[1][0]
        if jumps.size:
            before = values(np.remainder(jumps, TURN), side=-1)
            least, largest = min(least, float(np.nanmin(before))), max(largest, float(np.nanmax(before)))
        return float({"least": least, "largest": largest, "peak": max(-least, largest)}[term.how])

    def _average(self, machine: Machine, read: Callable[[Record], Array], *, square: bool) -> float:
        """Mean, or root of the mean square, over the revolution: Gauss's rule between the knots of the work."""
        a, b = self.work.knots[:-1], self.work.knots[1:]
        half = 0.5 * (b - a)
        points = (0.5 * (a + b))[:, None] + half[:, None] * NODES
        values = read(Record(machine.moving(points.ravel(), self.speed))).reshape(points.shape)
        mean = float(np.sum(half * ((values**2 if square else values) @ WEIGHTS))) / TURN
        return math.sqrt(mean) if square else mean

    def objective(self) -> float:
        """What is minimised: a term [SI], negative where it shall be large, or a weighted sum."""
        found = []
        for goal, scale in zip(self.problem.goals, self.problem.scales, strict=True):
            value = self.figure(goal) * (-1.0 if goal.sense == "maximise" else 1.0)
            found.append(value if self.problem.single else goal.weight * value / (scale or 1.0))
        return math.fsum(found)

    def size(self, term: Term) -> float:
        """The size of what a term is made of [SI], where the term itself may vanish; zero where it does so by nature alone."""
        if term.quantity in ("end", "slide", "length"):
            return max(abs(value) for name, value in self.design.items() if self.problem.quantities[name].kind != "angle")
        if not self.full or (term.how != "mean" and term.quantity != "work"):
            return 0.0
        course = term if term.how == "mean" else Term(quantity="torque")
        machine, read = self.course(course)
        values = read(Record(machine.moving(np.linspace(0.0, TURN, POSITIONS + 1), self.speed)))
        return float(np.max(np.abs(values))) * (1.0 if term.how == "mean" else TURN)

    def natural(self) -> float:
        """Below what the objective is zero but for rounding [its unit]."""
        sizes = [ROUNDING * self.size(goal) for goal in self.problem.goals]
        if self.problem.single:
            return sizes[0]
        shares = zip(self.problem.goals, self.problem.scales, sizes, strict=True)
        return math.fsum(goal.weight * size / (scale or 1.0) for goal, scale, size in shares)

    def imbalance(self) -> float:
        """Work per revolution that drive and loads leave over, as a share of the energy that goes to and fro: zero in a cycle.

        That energy is the sum of the sizes of their powers over the revolution, and the kinetic energy: of a machine without
        loads the works themselves all vanish, of one that is balanced on its crank the powers too.
        """
        a, b = self.work.knots[:-1], self.work.knots[1:]
        half = 0.5 * (b - a)
        points = ((0.5 * (a + b))[:, None] + half[:, None] * NODES).ravel()
        moving = self.machine.moving(points, self.speed)
        record = Record(moving)
        powers = [record["input.power_W"]]
        names = slider_names(self.machine)
        powers += [record[f"{guide}.friction_N"] * record[f"{names[guide]}.v_m_s"] for guide in self.machine.friction]
        powers += [
            np.broadcast_to(np.asarray(one.power(moving.state(one.body))), points.shape)
            for load in self.machine.loads
            for one in load.act(moving)
        ]

        def whole(power: Array) -> float:
            return float(np.sum(half * (power.reshape(-1, len(NODES)) @ WEIGHTS))) / self.speed

        fed = math.fsum(abs(whole(np.abs(power))) for power in powers)
        stored = float(np.max(np.abs(moving.kinetic), initial=0.0))
        return abs(math.fsum(whole(power) for power in powers)) / max(fed + stored, 1e-300)


def validate_cycle(problem: CycleProblem, design: Mapping[str, float], objective: float | None = None) -> Validation:
    """Prove a design, or show where it fails.

    Parameters
    ----------
    problem : CycleProblem
    design : mapping of quantity to float [SI]
    objective : float, optional
        What the optimiser claims; compared with what is measured.
    """
    try:
        tested = Cycle(problem, design)
    except Unusable as error:
        return Validation((Check(f"the machine can be made: {error.message}", False, math.nan, "yes", ""),), math.nan)
    found = tested.objective()
    checks = [*_sizes(tested), *_motion(tested)]
    if tested.full:
        checks += [check for bound_ in problem.bounds for check in _limit(tested, bound_)]
    if objective is not None:
        gap = abs(found - objective) / max(abs(found), tested.natural(), 1e-300)
        checks.append(Check("objective measured in motion", bool(gap <= AGREE), gap, f"<= {AGREE:.0e}", ""))
    return Validation(tuple(checks), found)


def _sizes(tested: Cycle) -> Iterator[Check]:
    """Free quantities within their bounds, fixed ones as given; links keep their length while they move."""
    size = max(abs(value) for name, value in tested.design.items() if tested.problem.quantities[name].kind != "angle")
    for name, quantity in tested.problem.quantities.items():
        if quantity.free:
            yield bound(name, quantity, tested.design[name], size)
    fixed = [name for name, quantity in tested.problem.quantities.items() if not quantity.free]
    worst = max((abs(tested.design[name] - tested.problem.quantities[name].value) for name in fixed), default=0.0)
    yield Check("all other sizes as given", worst == 0.0, worst, "= 0", "")
    motion = sweep(tested.mechanism, tested.design, np.linspace(0.0, TURN, POSITIONS, endpoint=False))
    worst = 0.0
    for link in tested.mechanism.links:
        if link.end:
            measured = np.linalg.norm(motion.position(link.end) - motion.position(link.start), axis=-1)
            wanted = tested.design[link.length] if isinstance(link.length, str) else link.length
            miss = float(np.max(np.abs(measured - wanted))) if np.all(np.isfinite(measured)) else math.nan
            worst = max(worst, miss, key=nan_last)
    limit = LENGTH_TOLERANCE * size * 1e3
    yield Check("link lengths re-measured in motion", bool(worst * 1e3 <= limit), worst * 1e3, f"<= {limit:.1e}", "mm")


def _motion(tested: Cycle) -> Iterator[Check]:
    """The crank turns fully on one branch, with finite forces everywhere; what the drive gives the loads take."""
    yield Check("the crank turns fully", tested.full, float(tested.full), "= 1", "")
    if not tested.full:
        return
    yield Check("no singular position in the revolution", not tested.singular, float(len(tested.singular)), "= 0", "")
    grid = np.linspace(0.0, TURN, POSITIONS + 1)

    def placed(angles: Array) -> Motion:
        return sweep(tested.mechanism, tested.design, angles)

    yield from alignment_checks(placed, grid, tested.problem.limits, "the revolution")
    record = Record(tested.machine.moving(grid, tested.speed))
    good = not np.any(record.singular | record.jammed | record.undefined)
    yield Check("finite forces over the revolution", bool(good), float(good), "= 1", "")
    if tested.machine.inertias or tested.machine.loads:
        gap = tested.imbalance()
        yield Check("work of the drive is that of the loads", bool(gap <= BALANCE), gap, f"<= {BALANCE:.0e}", "")


def _limit(tested: Cycle, item: Bound) -> Iterator[Check]:
    """A limit, measured."""
    kind, unit = item.interval.kind, item.interval.unit
    size = 1.0 / factor(unit or KINDS[kind].people, kind) if kind else 1.0
    value = tested.figure(item.term)
    for wanted, words, sense in ((item.interval.low, ">=", 1.0), (item.interval.high, "<=", -1.0)):
        if wanted is not None:
            room = MEET * max(abs(wanted), abs(value) if math.isfinite(value) else 0.0, NOTHING * tested.size(item.term))
            passed = bool(sense * (value - wanted) >= -room)
            yield Check(f"{item.name}: {item.term.words}", passed, value * size, f"{words} {wanted * size:.6g}", unit)
