"""The machine of a problem, its crank speed and its range of motion."""

import importlib
import math
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from optlink.dynamics.machine import Inertia, Machine
from optlink.dynamics.strokes import SAMPLES, irregular
from optlink.errors import InputError
from optlink.linkage.singular import positions_text
from optlink.linkage.stroke import Ranges, failure
from optlink.linkage.vector2d import TURN, Array, Value, whole_turns
from optlink.problem.driving import Driving
from optlink.problem.file import AnyProblem, ProblemFile, check_plausible, problem_of
from optlink.problem.quantity import check_choice, check_scalar, input_of, read_quantity
from optlink.units import KINDS

_machines: dict[int, Machine] = {}
"""Machines at fixed and starting values by the identity of their problem, with their ranges and compiled functions."""

MIN_SPEED, MAX_SPEED = 1e-9, 1e6  # rad/s
MIN_DURATION, MAX_DURATION = 1e-9, 1e7  # s
MAX_PERIODS = 200_000  # of the fastest process within a revolution: minutes of computing time
POLE_TURNS = 50  # revolutions in which poles of loads are sought, from the start on
UNKNOWN_QUANTITY = "unknown quantity of the design"
RATES = ("omega", "v", "w")  # variables of a load that are not known before the motion under a torque
SAME_RANGE = 1e-9  # rad, difference of the ends of ranges that are the same
MARGIN = 1e-3  # fraction of a limited range omitted at either end: speeds are infinite at a dead position


def moved(problem: AnyProblem) -> ProblemFile:
    """Return the problem of a machine that is moved.

    A fixed design whose crank only swings gets the range of its requirement if the file starts its drive where that begins.
    """
    problem = problem_of(problem)
    model: Any = problem.model
    fixed = getattr(model, "parts", ()) and not model.free and model.limits.crank == "span"
    if not fixed or "start" not in model.drive.model_fields_set:
        return problem
    task = importlib.import_module("optlink.tasks.run").design_task(problem)  # whose results move machines
    machine: ProblemFile | None = task.validate(problem, {}).machine
    if machine is None or abs(machine.model.drive.start.value - model.drive.start.value) > SAME_RANGE:
        return problem
    return machine


def turning_machine(problem: ProblemFile, design: Mapping[str, float]) -> Machine | None:
    """Return the machine of a design [SI] if its crank turns fully, else None."""
    if not all(math.isfinite(value) for value in design.values()):
        return None
    try:
        machine = machine_of(problem, {name: design[name] for name in problem.model.mechanism.quantities})
    except InputError:
        return None
    return machine if machine.ranges.full else None


def check_design(problem: ProblemFile, design: Mapping[str, float | str] | None) -> dict[str, float] | None:
    """Return a design in SI, of numbers and of texts with units.

    The start angles of a motion law may be in it although they follow from the lengths, as in `result.design`.

    Raises
    ------
    InputError
        If the problem does not know a name, or a value is not finite or, as a number, not plausible in SI.
    """
    quantities, read = problem.model.quantities, dict[str, float]()
    with np.errstate(all="ignore"):
        known = problem.model.complete({}) if design else {}
    for name, value in (design or {}).items():
        check_choice("--design", name, known, UNKNOWN_QUANTITY, problem.file)
        kind = quantities[name].kind if name in quantities else "angle"
        with input_of(problem.file, f"design.{name}", value):
            if isinstance(value, str):
                read[name] = float(read_quantity(value, kind).value)
                continue
            check_scalar(value, kind)
        check_sizes(problem, name, value, f"design.{name}")
        read[name] = value
    return None if design is None else read


def check_sizes(problem: ProblemFile, name: str, values: Value, key: str) -> None:
    """Refuse values of a quantity [SI] that were meant in another unit; see `check_plausible`."""
    if name in problem.model.quantities:
        unit = KINDS[problem.model.quantities[name].kind].si
        check_plausible(problem.raw, values, unit, problem.file, key, texts=False)


def start_value_notes(problem: ProblemFile, design: Mapping[str, object] | None = None) -> list[str]:
    """Return a note that names the design variables without a given value, if there are any."""
    free = [name for name in problem.model.free if design is None or name not in design]
    return [f"design variables are at their start values: {', '.join(free)} (the design may be that of a result)"] if free else []


def machine_of(problem: ProblemFile, design: Mapping[str, Value] | None = None) -> Machine:
    """Return the machine of a problem at a given design [SI], numbers or arrays; by default at the values of the file."""
    if design is None and id(problem) in _machines:
        return _machines[id(problem)]
    with input_of(problem.file):
        machine = problem.model.machine(design)
    if design is None:
        _machines[id(problem)] = machine
        weakref.finalize(problem, _machines.pop, id(problem), None)
    return machine


def crank_speed(problem: ProblemFile, speed: float | None = None, key: str = "speed") -> float:
    """Return the constant speed of the crank [rad/s]: `speed`, else that of the drive under `key`.

    Raises
    ------
    InputError
        If it is zero, as in a file that is simulated from rest, or out of range.
    """
    stated = problem.model.driving.pace if key == "speed" else getattr(problem.model.drive, key).value
    value: float = stated if speed is None else speed
    if not MIN_SPEED <= abs(value) <= MAX_SPEED:
        message = "the crank speed is zero" if value == 0.0 else "out of range"
        remedy = 'Give one between 1e-9 and 1e6 rad/s, for statics a low one such as "0.01 rpm"'
        if speed is not None:
            raise InputError(message, remedy, key="speed", value=f"{speed:.6g} rad/s")
        raise _of_drive(problem, f"drive.{key}", message, remedy)
    return value


def starting_speed(problem: ProblemFile, speed: float | None = None) -> float:
    """Return the rate of the crank angle, or cycle variable, at the start of a simulation [rad/s]: under a torque or force, zero
    if none is stated.

    `speed` replaces that of the problem, `drive.initial_speed`, else `drive.speed`.
    """
    drive, driving = problem.model.drive, problem.model.driving
    if drive.torque is None and drive.force is None:
        return crank_speed(problem, speed)
    key = "speed" if drive.initial_speed is None else "initial_speed"
    if driving.ends is not None:
        of = getattr(drive, key)
        return of.value / driving.lever if key in drive.model_fields_set and of.kind == "velocity" else 0.0
    stated = speed if speed is not None else getattr(drive, key).value if key in drive.model_fields_set else 0.0
    return crank_speed(problem, speed, key) if stated else 0.0


def duration_of(problem: ProblemFile, duration: float | None = None) -> float | None:
    """Return the simulated time [s]; None if neither the argument nor the problem states it.

    Raises
    ------
    InputError
        If it is out of range.
    """
    of_problem = problem.model.drive.duration
    value = duration if duration is not None or of_problem is None else of_problem.value
    if value is not None and not MIN_DURATION <= value <= MAX_DURATION:
        remedy = "Give a time from 1e-9 s to 1e7 s"
        if duration is not None:
            raise InputError("out of range", remedy, key="duration", value=f"{duration:.6g} s")
        raise _of_drive(problem, "drive.duration", "out of range", remedy)
    return value


def check_pace(problem: ProblemFile, speed: float, processes: Mapping[str, tuple[str, float]]) -> None:
    """Refuse a revolution that lasts so much longer than the fastest process of the machine that it would take hours.

    `processes` has each process and its period [s] by the key that determines it.
    """
    turn = TURN / abs(speed)
    for key, (process, period) in processes.items():
        if turn > MAX_PERIODS * period:
            message = f"{process} takes {period:.3g} s, so that a revolution of {turn:.3g} s contains {turn / period:.2g}"
            raise _of_drive(
                problem, key, message, f"Change this value, or raise the speed, so that there are at most {MAX_PERIODS:,}"
            )


def _of_drive(problem: ProblemFile, key: str, message: str, remedy: str) -> InputError:
    """Return the error for a key of the drive or the controller."""
    return InputError(message, remedy, problem.file, key, problem.at(key))


def with_flywheel(machine: Machine, inertia: float) -> Machine:
    """Return the machine with a flywheel of this inertia [kg m^2] on its crank, balanced about the crank pivot.

    Raises
    ------
    InputError
        If the inertia is out of range.
    """
    if not 0.0 <= inertia < 1e12:
        raise InputError("out of range", "Give a moment of inertia from 0 to 1e12 kg*m^2", key="flywheel", value=inertia)
    if inertia == 0.0:
        return machine
    crank = machine.mechanism.crank.body
    crank_inertia = machine.inertias.get(crank, Inertia())
    return machine.with_(inertias={**machine.inertias, crank: replace(crank_inertia, moment=crank_inertia.moment + inertia)})


def starting_angle(problem: ProblemFile, machine: Machine, design: Mapping[str, float] | None) -> tuple[float, list[str]]:
    """Return the crank angle [rad] at which the motion starts, and a note where it is not that of the drive.

    A crank that cannot turn fully moves in the range in which its requirement begins: there it starts if the file does not state
    `drive.start`, and the default lies outside that range.
    """
    model, ranges = problem.model, machine.ranges
    start = model.driving.first
    if ranges.full or ranges.limits or "start" in model.drive.model_fields_set:
        return start, []
    begin = model.start(model.design(design or {})) % TURN
    here, there = ranges.holding(start), ranges.holding(begin)
    if there is None or (here is not None and abs(math.remainder(there[0] - here[0], TURN)) < SAME_RANGE):
        return start, []
    where = f"the crank starts at {math.degrees(begin):.6g} deg, where the requirement begins"
    return begin, [f"{where}: {model.drive.start} is {'not reached' if here is None else 'in another range'}"]


def motion_range(problem: ProblemFile, machine: Machine, start: float) -> tuple[Ranges, float, float]:
    """Return the reachable crank ranges, and the limits [rad] of the motion with `start`: one cycle if the crank turns fully.

    Raises
    ------
    InputError
        If the mechanism cannot be assembled at the start.
    """
    ranges = machine.ranges
    if ranges.full:
        return ranges, start, start + machine.cycle
    if machine.mechanism.drives and problem.model.driving.ends is None and not ranges.complete:
        raise _not_followed(problem, machine)
    if ranges.limits is not None:
        check_range_reached(problem, machine)
        return ranges, *ranges.limits
    holding = ranges.holding(start)
    if holding is None:
        failed = failure(machine.mechanism, machine.sizes, start)
        remedy = (
            f"Start in a range that can be reached: {ranges.text}"
            if ranges.ranges
            else "No crank angle can be reached: change the dimensions"
        )
        message = f"{failed}" if failed else "the mechanism cannot be assembled"
        raise InputError(message, remedy, problem.file, "drive.start", f"{math.degrees(start):.6g} deg")
    low, high = holding
    return ranges, low, high


def _not_followed(problem: ProblemFile, machine: Machine) -> InputError:
    """Return the error for laws of drives that the mechanism cannot follow, with the first time at which it fails."""
    mechanism, key = machine.mechanism, "drives" if problem.model.drives else "drive.law"
    grid = np.linspace(*(mechanism.limits or (0.0, mechanism.cycle)), SAMPLES + 1)
    failed = next(filter(None, (failure(mechanism, machine.sizes, float(at)) for at in grid)), None)
    why = "the mechanism cannot be assembled"
    if failed is not None:
        why = failed.at(f"{failed.crank_angle / abs(problem.model.driving.pace):.4g} s")
    return InputError(f"the drives cannot be followed: {why}", "Change their laws, or the dimensions", problem.file, key)


def check_range_reached(problem: ProblemFile, machine: Machine) -> None:
    """Refuse a range of the drive in which the mechanism cannot be assembled, or that crosses a singular position.

    Raises
    ------
    InputError
        With the position.
    """
    ranges = machine.ranges
    assert ranges.limits is not None
    if not ranges.complete:
        low, high = ranges.limits
        ends = [end for reached in ranges.ranges for end in reached if low < end < high] or [low]
        aside = 1e-6 * (high - low)
        failed = next(
            filter(
                None, (failure(machine.mechanism, machine.sizes, at) for end in ends for at in (end - aside, end, end + aside))
            ),
            None,
        )
        driving = problem.model.driving
        moves = (f"{driving.shown(a):.6g} ... {driving.shown(b):.6g} {driving.unit}" for a, b in ranges.ranges)
        reached = f"it can move in {', '.join(moves)}" if ranges.ranges else "no position of it can be reached"
        why = failed.at(driving.text(failed.crank_angle)) if failed else "the mechanism cannot be assembled"
        message = f"the range cannot be moved through: {why}; {reached}"
        key = "drive.range"
        if problem.at(key) is None and driving.ends is not None:  # a cylinder, whose stroke is its range
            beyond = bool(ranges.ranges) and ranges.ranges[0][0] <= low
            key = f"mechanism.cylinders.{machine.mechanism.drives[0].body}.{'open' if beyond else 'closed'}"
        raise InputError(message, "Change the range, or the dimensions", problem.file, key, problem.at(key))
    if ranges.singular:
        where = problem.model.driving.text(ranges.singular[0].crank_angle)
        message = f"the range crosses a singular position at {where}: the motion beyond it is not determined"
        remedy = 'End the range before it, change the dimensions, or append ", continue" to the mode for the smooth motion'
        raise InputError(message, remedy, problem.file, "drive.range", problem.at("drive.range"))


def check_one_crank(problem: ProblemFile, machine: Machine, what: str, *, linear: bool = False) -> None:
    """Refuse a machine with laws, several drives or couplings, and unless allowed one driven along a line.

    Raises
    ------
    InputError
        whose message says `what` is not supported.
    """
    mechanism = machine.mechanism
    alone = linear and problem.model.driving.ends is not None
    if mechanism.drives and not alone:
        key = "drives" if problem.model.drives else "drive"
        remedy = "`optlink analyze` computes its motion, forces and work; or drive one crank at constant speed"
        raise InputError(f"{what} of a machine with a prescribed motion is not supported", remedy, problem.file, key)
    if mechanism.singles and not alone:
        names = ", ".join(element.name for element in mechanism.elements)
        remedy = "`optlink analyze` computes its motion, forces and work; or leave them out"
        raise InputError(f"{what} of a machine with {names} is not supported", remedy, problem.file, "mechanism")


def check_within_range(problem: ProblemFile, crank_angles: Array) -> None:
    """Refuse crank angles [rad] outside the range of the drive.

    Raises
    ------
    InputError
        With the first one.
    """
    mechanism = problem.model.linkage
    if mechanism.limits is None:
        return
    low, high = mechanism.limits
    slack = 1e-9 * (high - low)
    outside = crank_angles[(crank_angles < low - slack) | (crank_angles > high + slack)]
    if outside.size:
        message = f"the position {position_text(problem, float(outside[0]))} lies outside the range of the drive"
        remedy = f"Give positions from {position_text(problem, low)} to {position_text(problem, high)}, or change the range"
        raise InputError(message, remedy, problem.file, "drive.range", problem.at("drive.range"))


def position_text(problem: ProblemFile, position: float) -> str:
    """Return a crank angle [rad], or the slide or length at a value of the cycle variable [rad], with its unit."""
    return problem.model.driving.text(position)


def check_repeats(problem: ProblemFile, machine: Machine) -> None:
    """Refuse a machine whose crank turns fully, but whose loads do not repeat after whole revolutions."""
    if machine.ranges.full:
        with input_of(problem.file):
            problem.model.check_repeats(machine)


def check_regular(problem: ProblemFile, ranges: Ranges, what: str) -> None:
    """Refuse mechanisms with singular positions, continued or not: reactions may grow without bound towards them.

    Raises
    ------
    InputError
        If there is a singular position; its message ends with `what`.
    """
    positions = (*ranges.singular, *ranges.followed)
    if positions:
        message = (
            f"singular position at {positions_text(positions, problem.model.driving.text)}, where reactions have no bound: {what}"
        )
        remedy = "Change the lengths so that coupler and rocker, or a link and the normal of its guide, are never in line"
        raise InputError(message, remedy, problem.file, "mechanism")


def table_angles(start: float, low: float, high: float, speed: float, ranges: Ranges, points: int, step: float | None) -> Array:
    """Return the crank angles [rad] of the table: one cycle from the start in the direction of rotation, or through the range.

    There are `points` steps per revolution, or over the range, shortened by `MARGIN` at either end unless the file states it;
    else steps of `step`.
    """
    direction = 1.0 if speed > 0.0 else -1.0
    if not ranges.full:
        edge = 0.0 if ranges.complete else MARGIN * (high - low)
        first, last = (low + edge, high - edge) if direction > 0.0 else (high - edge, low + edge)
        count = points if step is None else max(1, round((high - low) / step))
        return np.asarray(first + (last - first) * (np.arange(count + 1) / count), dtype=float)
    if step is None:
        rows = points * whole_turns(high - low)
        return np.asarray(start + direction * TURN * np.arange(rows + 1) / points, dtype=float)
    count = math.floor((high - low) / step * (1.0 + 1e-12))
    return np.asarray(start + direction * step * np.arange(count + 1), dtype=float)


def pole_notes(driving: Driving, machine: Machine, start: float, revolutions: float, speed: float, steady: bool) -> Iterator[str]:
    """Yield a note for every load that grows without bound at a crank angle that the motion passes.

    An integrator may step over such a position, where the work of the load is finite but the load is not. Unless the speed is
    `steady`, loads that depend on speeds are left out.
    """
    loads = []
    for load in machine.processes:
        names = getattr(getattr(load.magnitude, "expression", None), "names", ())
        if names and getattr(load.magnitude, "cornered", False) and (steady or set(RATES).isdisjoint(names)):
            loads.append(load)
    turned = TURN * min(revolutions, POLE_TURNS)
    if not loads or not turned:
        return
    ends = start, start + math.copysign(turned, speed)
    grid = np.linspace(min(ends), max(ends), max(2, math.ceil(SAMPLES * turned / TURN)) + 1)
    for name, angles in irregular(machine.with_(loads=tuple(loads)), grid, speed).poles.items():
        yield f"{name} grows without bound at {driving.texts(angles)}: forces and torque have no largest value there"
