"""Simulate the motion of a machine in time."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from optlink.dynamics.columns import effort_of, efforts, tabulated
from optlink.dynamics.forward import DriveForce, Ending, Limits, Run, integrated, run
from optlink.dynamics.freedoms import Controller, Freedom, FreeEquations
from optlink.dynamics.inverse import reduced_inertia
from optlink.dynamics.machine import EndStops, Machine, Moving
from optlink.errors import InputError
from optlink.execution import interrupts
from optlink.linkage.continuation import continue_through_singularities
from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.stroke import Ranges, failure
from optlink.linkage.vector2d import TURN, Array, finite_or, max_magnitude
from optlink.problem.arguments import typed
from optlink.problem.document import Columns, Number, Renamed, Source, Tabled
from optlink.problem.driving import end_with_speed
from optlink.problem.file import AnyProblem, ProblemFile
from optlink.problem.machine.bodies import StopsSection
from optlink.problem.quantity import check_range
from optlink.tasks.machine import (
    MAX_DURATION,
    check_design,
    duration_of,
    machine_of,
    motion_range,
    moved,
    pole_notes,
    start_value_notes,
    starting_angle,
    starting_speed,
    with_flywheel,
)

MAX_ROWS = 1_000_000
POSITION = (("crank_angle_deg", "crank angle"), ("cycle_deg", "cycle of the drive, in `analyze` too"))
AHEAD = 0.02  # rad beyond the end of a simulation, which may have stopped before a pole


@dataclass(frozen=True, repr=False, eq=False)
class Simulation(Tabled):
    """Simulation in time: `columns` by name over the output times, `meanings` describe them, `figures` summarise them [SI].

    `driven`: by what; `stopped`: time [s] up to which was simulated; `steps` of the integrator, and
    `evaluations` of the accelerations; `design`: the given values [SI]; `flywheel`: the added moment of inertia [kg m^2].
    """

    kind = "simulation"
    shown: ClassVar[Mapping[str, Source]] = {
        "message": "ending.text",
        "sizes_SI": "sizes",
        "mean_speed_over": lambda _: "time",
        "stopped_s": "stopped",
    }

    problem: ProblemFile
    design: dict[str, float]
    flywheel: float
    driven: str
    ending: Ending
    notes: tuple[str, ...]
    figures: dict[str, Number]
    stopped: float
    steps: int
    evaluations: int
    meanings: dict[str, str]
    columns: Columns

    finished = Renamed("valid")

    @property
    def free(self) -> bool:
        """Whether some of several drives, or one with a controller, moved freely: their positions are in the columns alone."""
        model = self.problem.model
        return model.drive.controller is not None or any(drive.free for drive in model.drives.values())

    @property
    def valid(self) -> bool:
        """Whether the whole duration was simulated, or the machine came to rest."""
        return self.ending in (Ending.FINISHED, Ending.AT_REST, Ending.AT_STOP, Ending.END_OF_RANGE)

    @property
    def status(self) -> str:
        """Why the simulation ended, in words."""
        return self.ending.value

    @cached_property
    def machine(self) -> Machine:
        """The machine."""
        return with_flywheel(machine_of(self.problem, self.design or None), self.flywheel)

    @property
    def position(self) -> Array:
        """Crank angle, or cycle of the drive [deg], at the rows."""
        return self.columns[POSITION[bool(self.machine.mechanism.drives)][0]]

    @property
    def sizes(self) -> dict[str, float]:
        """Dimensions of the machine [SI]."""
        return {name: self.machine.sizes[name] for name in self.problem.model.mechanism.quantities}


@typed
def simulate(
    problem: AnyProblem,
    duration: float | None = None,
    rows: int = 1000,
    speed: float | None = None,
    design: Mapping[str, float | str] | None = None,
    progress: Callable[[float], None] | None = None,
    flywheel: float = 0.0,
) -> Simulation:
    """Simulate a machine in time, under the drive torque of the problem, at constant speed or as laws of its drives prescribe.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        From `optlink.load`, the name of a shipped problem, or a file.
    duration : float [s], optional
        Simulated time. Default: that of the problem, else the time of one revolution at its speed, to the end of the range of
        its drive, or of the laws of its drives.
    rows : int
        Number of evenly spaced time steps of the table, which has one row more. The integrator chooses its own steps.
    speed : float [rad/s], optional
        Crank speed at the start, which stays constant without a torque. Default: `drive.initial_speed` of the problem under a
        torque, else its `drive.speed`; under a torque without either at rest.
    design : mapping of str to float [SI] or str, optional
        Values of design variables. Default: their starting values.
    progress : function of the completed fraction, optional
    flywheel : float [kg m^2]
        Additional moment of inertia at the crank.

    Returns
    -------
    Simulation
        Columns over time by name, figures, and the energy account.

    Raises
    ------
    InputError
        If the mechanism cannot be assembled, or an argument is out of range.

    Examples
    --------
    >>> run = optlink.simulate(optlink.load("six-bar"), duration=0.1, rows=10)
    >>> float(run["time_s"][-1]), round(run.figures["input.work_J"], 3)
    (0.1, 220.81)
    """
    problem = moved(problem)
    sizes = check_design(problem, design)
    if progress is not None:
        progress(0.0)  # the preparation of a long chain of links takes seconds
    drive = problem.model.drive
    machine = machine_of(problem, sizes)
    start, begun = starting_angle(problem, machine, sizes)
    driving = problem.model.driving
    torque = drive.torque if drive.force is None else DriveForce(drive.force, driving.place(0.0), driving.lever)
    prescribed = bool(machine.mechanism.drives) and driving.ends is None
    freedoms = freedoms_of(problem, with_flywheel(machine, flywheel))
    ranges, low, high = (Ranges((), full=True), 0.0, TURN) if freedoms else motion_range(problem, machine, start)
    free = [one.drive for one in freedoms]
    laws = [one.law for one in machine.mechanism.drives if one.law is not None and one not in free]
    end = end_with_speed(laws)
    if end is not None:
        high = end * driving.pace
    bounded = machine.mechanism.limits is not None and (not prescribed or end is not None)
    if machine.mechanism.limits is not None and not bounded:  # the drives rest at the ends of their laws
        machine = machine.with_(mechanism=replace(machine.mechanism, limits=None))
    if machine.mechanism.drives and (speed is not None or (flywheel and machine.mechanism.drives[0].kind != "angle")):
        key, what = ("speed", "a crank speed") if speed is not None else ("flywheel", "a flywheel on a crank")
        message = "the drive moves by its law" if prescribed else "the drive moves along a line"
        raise InputError(
            f"{message}, which {what} does not fit", "Leave it out, or change [drive] of the file", problem.file, key
        )
    machine = with_flywheel(machine, flywheel)
    speed = starting_speed(problem, speed)
    duration = duration_of(problem, duration)
    if duration is None:
        way = TURN if not bounded else high - start if driving.pace > 0.0 else start - low
        if freedoms and not any(one.law or one.rate for one in machine.mechanism.drives):
            message = "the drives move freely, so the duration of the motion is not known"
            raise InputError(message, 'Give it: --duration "2 s"', problem.file, "drives")
        if MAX_DURATION * abs(driving.pace) < way:
            message = "the duration is missing, and the speed is too low for a default"
            raise InputError(message, 'Give drive.duration = "2 s"', problem.file, "drive.duration")
        duration = way / abs(driving.pace)
    check_range("rows", rows, 1, MAX_ROWS)
    notes = [*begun, *start_value_notes(problem, design)]
    if torque is not None:
        inertia, _ = reduced_inertia(machine, np.linspace(low, high, 361)[1:-1])
        if not np.nanmin(inertia) > 0.0:
            message = "the machine has no inertia, so no torque can govern its motion"
            raise InputError(message, "Give the bodies masses", problem.file, "bodies")
    limits = Limits(low, high, Ending.END_OF_RANGE) if bounded else None if ranges.full or prescribed else Limits(low, high)
    elastic = None
    if bounded and torque is not None and (drive.range is not None or driving.mechanism.cylinders):
        stops = drive.stops or StopsSection()
        limits = Limits(low, high, None, stops.restitution if stops.stiffness is None else None)
        if stops.stiffness is not None:
            elastic = EndStops("stops", low, high, stops.stiffness.value, stops.restitution, driving.lever)
            machine = machine.with_(loads=(*machine.loads, elastic))
    singular = [position.crank_angle for position in ranges.singular]
    if singular:  # same motion up to there, without the rounding errors of 0/0 expressions
        cycle = machine.mechanism.cycle
        mechanism = continue_through_singularities(machine.mechanism, machine.sizes, start, every=True)
        singular = [at + k * cycle for at in singular for k in range(round(mechanism.cycle / cycle))]
        machine = machine.with_(mechanism=mechanism)
    times = np.linspace(0.0, duration, rows + 1)
    if freedoms:
        equations = FreeEquations(machine, freedoms)
        machine = equations.machine
        result = integrated(equations, times, start, speed, limits, progress, (), interrupts.handled)
    else:
        result = run(machine, times, start, speed, torque, limits, progress, singular, interrupts.handled)
    pressed = 0.0 if elastic is None else float(elastic.force(result.crank_angle[-1]))
    if pressed and result.ending is Ending.AT_REST:
        result = replace(result, ending=Ending.AT_STOP)
    if result.ending is not Ending.FINISHED:
        last, cycle = float(result.crank_angle[-1]), machine.mechanism.cycle
        if result.ending is Ending.SINGULAR:
            last = min((at + cycle * round((last - at) / cycle) for at in singular), key=lambda at: abs(at - last))
        notes.append(f"{result.ending.text} (at {result.stopped:.9g} s, {driving.text(last)})")
    low, high = float(np.min(result.crank_angle)), float(np.max(result.crank_angle))
    way = speed if torque is None else 1.0  # a torque may swing the crank to and fro
    revolutions = (high - low + (0.0 if result.ending is Ending.FINISHED else AHEAD)) / TURN
    if not freedoms:
        notes += pole_notes(problem.model.driving, machine, low if way > 0.0 else high, revolutions, way, torque is None)
    columns, meanings = _columns(machine, result)
    figures = _figures(problem, machine, result)
    for freedom in freedoms:
        one, effort, name = result.coordinates[freedom.size], effort_of(freedom.drive), freedom.drive.name
        if freedom.limits is not None:  # the balance is that of drive and stop together
            columns[effort.column] = columns[effort.column] - one.stop
            column = effort.column.replace(f"{name}.", f"{name}.stop_")
            columns[column], meanings[column] = one.stop, f"{effort.quantity} of the end stop of {name} on {effort.body}"
        if freedom.controller is not None:
            column = f"{name}.error_{'rad' if freedom.drive.kind == 'angle' else 'm'}"
            columns[column], meanings[column] = one.error, f"distance from {name} to its law"
            figures[column.replace("error", "largest_error")] = far = max_magnitude(one.error)
            notes.append(f"the drive {name} is at most {far:.4g} {column.rpartition('_')[2]} from its law")
    if result.ending is Ending.AT_STOP:  # the balance of the last row is that of drive and stop together
        effort = efforts(machine.mechanism)[0]
        both, column = columns[effort.column], effort.column.replace("input", "stops")
        held = float(both[-1]) - float(result.torque[-1]) / driving.lever
        total = held
        if pressed and elastic is not None:  # at rest it holds between its force going in and that going out
            own = {name: columns[name] for name in columns if name.startswith("stops.") and not name.endswith("_J")}
            on_one = (float(part[-1]) for name, part in own.items() if name.count(".") == 1)  # not on both bodies of a cylinder
            size, least = math.hypot(*on_one) / abs(pressed), elastic.restitution**2
            before = pressed * min((1.0, least), key=lambda share: abs(share - size))
            low, high = sorted((pressed, pressed * least))
            total = min(max(before + held, low), high)
            held = total - before
            for part in own.values():
                part[-1] *= total / before if before else 1.0
            if (load := effort.column.replace("_", "_load_", 1)) in columns:
                columns[load][-1] -= held
        both[-1] -= held
        figures[column] = held = total
        notes.append(f"the end stop holds it with {held:.6g} {effort.unit}")
    law = "motion laws" if len(machine.mechanism.drives) > 1 else "a motion law"
    if freedoms:
        law = f"{len(machine.mechanism.drives)} drives, {len(free)} of them free" if problem.model.drives else "a controller"
    return Simulation(
        problem,
        sizes or {},
        flywheel,
        efforts(machine.mechanism)[0].quantity if torque is not None else law if prescribed else "constant speed",
        result.ending,
        tuple(notes),
        figures,
        result.stopped,
        result.steps,
        result.evaluations,
        meanings,
        columns,
    )


def freedoms_of(problem: ProblemFile, machine: Machine) -> list[Freedom]:
    """Return the drives that move freely, beside others or by a controller.

    Raises
    ------
    InputError
        If what the machine has is not supported beside them, or no inertia governs their motion.
    """
    model, mechanism, freedoms = problem.model, machine.mechanism, list[Freedom]()
    sections = model.drives or ({"input": model.drive} if model.drive.controller is not None else {})
    if not any(section.free for section in sections.values()):
        return freedoms
    key, pace = "drives" if model.drives else "drive", model.driving.pace
    remedy = (
        'Give damping, or a load with a smooth change over the speed: torque = { expression = "-2*tanh(w/0.01)", unit = "N*m" }'
    )
    opposing = "a load that opposes the motion, or acts in one stroke,"
    refused = {f"loads.{load.name}": opposing for load in machine.loads if load.switching}
    refused |= {f"mechanism.guides.{name}.friction": "friction in a guide" for name in machine.friction}
    if mechanism.followed and not refused:
        refused, remedy = {"mechanism.assembly": "motion through singular positions"}, 'Leave ", continue" out'
    for where, what in refused.items():
        raise InputError(f"{what} is not supported with drives that move freely", remedy, problem.file, where)
    if failed := failure(mechanism, machine.sizes, 0.0):
        raise InputError(failed.at("the start"), "Change the start of the drives", problem.file, key)
    pose = mechanism.at(machine.sizes, Jet(0.0, pace))
    for drive in mechanism.drives:
        section = sections[drive.name]
        if not section.free:
            continue
        at = as_jet(drive.value(pose))
        stops, control = section.stops or StopsSection(), section.controller
        limits = (machine.sizes[str(end)] for end in drive.stroke) if drive.size else None
        if section.range is not None:
            limits = (end.value for end in section.range)
        of = None
        if control is not None:
            gains = [None if one is None else one.value for one in (control.derivative, control.limit)]
            of = Controller(control.proportional.value, gains[0] or 0.0, gains[1] or math.inf, control.feedforward)
        speed = at.rate if section.initial_speed is None else section.initial_speed.value
        ends = None if limits is None else (float(next(limits)), float(next(limits)))
        stiff = 0.0 if stops.stiffness is None else stops.stiffness.value
        freedoms.append(Freedom(drive, float(at.value), float(speed), section.effort, of, ends, stops.restitution, stiff))
    if not np.linalg.eigvalsh(FreeEquations(machine, freedoms).inertia)[0] > 0.0:
        message = "the machine has no inertia, so the motion of its free drives is not determined"
        raise InputError(message, "Give the bodies masses", problem.file, "bodies")
    return freedoms


def _figures(problem: ProblemFile, machine: Machine, result: Run) -> dict[str, float]:
    """Return the summary figures by name [SI]."""
    angle, speed, driving = float(result.crank_angle[-1]), float(result.speed[-1]), problem.model.driving
    end = {"end.crank_angle_rad": angle, "end.speed_rad_s": speed}
    if driving.ends is not None:
        place = driving.place(angle)
        end = {"end.position_m": place, "end.speed_m_s": driving.place(angle + speed) - place}
    figures = {
        "end.time_s": float(result.time[-1]),
        **({} if driving.ends is None and machine.mechanism.drives else end),
        **{f"{name}.work_J": float(work[-1]) for name, work in result.works.items()},
        "drift_m": result.drift,
        "drift_rad": result.drift_angle,
        "imbalance_J": result.imbalance,
        "turnover_J": result.turnover,
    }
    if result.last_turn is not None and not machine.mechanism.drives:
        figures["last_turn.mean_speed_rad_s"], figures["last_turn.fluctuation"] = result.last_turn
        if (revolutions := round(machine.cycle / TURN)) > 1:
            figures["last_turn.revolutions"] = float(revolutions)
    return figures


def _columns(machine: Machine, result: Run) -> tuple[dict[str, Array], dict[str, str]]:
    """Return the table, the columns of `analyze` over time, with NaN where there is no finite value."""

    def moving(rows: slice) -> Moving:
        angles, speeds, accelerations = result.crank_angle[rows], result.speed[rows], result.acceleration[rows]
        placed = {name: Jet(*(part[rows] for part in one.value.parts)) for name, one in result.coordinates.items()}
        whole = machine.with_(sizes={**machine.sizes, **placed}) if placed else machine
        return whole.moving(angles, speeds, accelerations, direction=result.direction[rows])

    crank = machine.mechanism.crank.body
    first, what = POSITION[bool(machine.mechanism.drives)]
    columns = {"time_s": result.time, first: np.degrees(result.crank_angle)}
    meanings = {"time_s": "time", first: what}
    for name, column in tabulated(moving, len(result.time)).columns.items():
        columns[name], meanings[name] = finite_or(column.values, np.nan), column.meaning
        if name == "input.power_W":
            columns["input.work_J"], meanings["input.work_J"] = result.works["input"], "work of the drive, integrated"
    for name, work in result.works.items():
        if name != "input":
            columns[f"{name}.work_J"], meanings[f"{name}.work_J"] = work, f"work of {name}, integrated"
    columns["energy.gained_J"] = result.energy - result.energy[0]
    meanings["energy.gained_J"] = "kinetic energy and potential energy of gravity, gained since the start"
    if not machine.mechanism.drives:
        columns[f"{crank}.angle_rad"] = result.crank_angle
    return columns, meanings
