"""Simulate a machine with joint clearance over revolutions of the crank."""

import contextlib
import contextvars
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from optlink.clearance.columns import MeasuredComparison, Output, measured_comparison
from optlink.clearance.control import (
    INSTALL,
    PID,
    ClosedLoop,
    Control,
    Controller,
    Gains,
    IntegratorKind,
    Inverse,
    chosen,
    installed,
    leverage,
    resumed,
    vibration,
)
from optlink.clearance.equations import Drive, ReferenceSignal, Servo, Weightless
from optlink.clearance.integration import TOO_DEEP, Stalled
from optlink.clearance.joint import Gap
from optlink.clearance.statistics import WATCHED, PredictabilityCheck, Statistics, table
from optlink.dynamics.forward import Ending
from optlink.dynamics.machine import Machine
from optlink.errors import InputError
from optlink.execution import interrupts
from optlink.execution.options import Checkpoints
from optlink.io import Summary
from optlink.linkage.arguments import check_array
from optlink.linkage.vector2d import TURN, Array, max_magnitude
from optlink.problem.arguments import typed
from optlink.problem.file import AnyProblem, ProblemFile, problem_of
from optlink.problem.quantity import check_range, input_of, nearest
from optlink.tasks.machine import (
    check_design,
    check_one_crank,
    check_pace,
    check_regular,
    crank_speed,
    machine_of,
    motion_range,
    pole_notes,
    start_value_notes,
    starting_speed,
    with_flywheel,
)
from optlink.tasks.results.clearance import RUNNING_IN, ClearanceCheckpoint, ClearanceSimulation, RevolutionState, read_checkpoint
from optlink.units import count_noun

EVERY = 5.0
"""Seconds between checkpoints."""

COMPILING: contextvars.ContextVar[Callable[[], contextlib.AbstractContextManager[None]]] = contextvars.ContextVar(
    "compiling", default=contextlib.nullcontext
)
"""Function to a context manager that is open while equations are compiled; a command shows there that it works."""

TOLERANCE_RATIO = 30.0
"""Ratio of the tolerances of the second run of the predictability check and of the run itself."""


@dataclass(frozen=True)
class _Setting:
    """All settings of one run."""

    file: ProblemFile
    machine: Machine
    gaps: tuple[Gap, ...]
    output: Output
    control: Control
    servo: Servo | None
    start: float
    speed: float  # initial
    nominal: float
    points: int

    def closed_loop(self, tolerance: float) -> ClosedLoop:
        """Return the machine in its initial state, with its controller."""
        section = self.file.model.control
        sampled = self.control.fed_back and section is not None
        try:
            closed_loop = ClosedLoop(
                self.machine,
                self.gaps,
                self.drive,
                self.output,
                start=self.start,
                speed=self.speed,
                nominal=self.nominal,
                points=self.points,
                tolerance=tolerance,
                sample_time=section.sample_time.value if section is not None and sampled else math.inf,
            )
        except Weightless as error:
            bar = ', inertia = "uniform bar"' if self.machine.mechanism.bodies[error.body].end else ""
            remedy = f'Give it a mass{" and a moment of inertia" if bar else ""}: {error.body} = {{ mass = "0.2 kg"{bar} }}'
            raise InputError(str(error), remedy, self.file.file, f"bodies.{error.body}") from None
        if section is not None and sampled:
            angles = self.start + math.copysign(TURN, self.nominal) * np.arange(closed_loop.samples) / closed_loop.samples
            ideal = np.broadcast_to(self.output.ideal(self.machine.moving(angles))[0], angles.shape)
            gains = Gains(section.proportional, section.integral, section.derivative, section.limit.value)
            lever = leverage(self.machine, self.output, angles, self.regularisation)
            closed_loop.controller = Controller(PID(gains, closed_loop.sample_time), ideal, lever, not self.output.guide)
        return closed_loop

    @cached_property
    def drive(self) -> Drive:
        """Drive of the crank."""
        if self.servo is None:
            return Drive(torque=self.file.model.drive.torque)
        command = ReferenceSignal(self.start, self.nominal)
        if self.control.inverted and self.modelled:
            inverse = Inverse(self.machine, self.modelled, self.output, self.start, self.nominal)
            command = inverse.reference_signal(self.regularisation, self.servo, self.bandwidth)
        return Drive(self.servo, command)

    @property
    def modelled(self) -> tuple[Gap, ...]:
        """Joints with clearance that the inverse model includes."""
        known = None if self.file.model.control is None else self.file.model.control.known
        return tuple(gap for gap in self.gaps if known is None or gap.point in known)

    @property
    def bandwidth(self) -> float:
        """Highest frequency [rad/s] that the inverse model corrects: that of the file, else half of the servo's bandwidth."""
        section = self.file.model.control
        if section is not None and section.bandwidth is not None:
            return section.bandwidth.value
        return math.inf if self.servo is None else 0.5 * self.servo.bandwidth

    @property
    def regularisation(self) -> float:
        """Regularisation of the inverse [m/rad, 1]: that of the file, else a tenth of the largest output rate per crank angle."""
        section = self.file.model.control
        if section is not None and section.regularisation is not None:
            return section.regularisation.value
        rates = self.output.ideal(self.machine.moving(np.linspace(0.0, TURN, 361)))[1]
        return 0.1 * max_magnitude(rates)


@typed
def simulate_clearance(
    problem: AnyProblem,
    revolutions: int = 20,
    points: int = 360,
    speed: float | None = None,
    control: str = "none",
    *,
    start: float | None = None,
    design: Mapping[str, float | str] | None = None,
    flywheel: float = 0.0,
    tolerance: float = 1e-10,
    check_predictability: bool = True,
    integrator: str = "auto",
    stream: Callable[[Mapping[str, Array]], None] | None = None,
    **checkpoints: Unpack[Checkpoints],
) -> ClearanceSimulation:
    """Simulate a machine with joint clearance; the initial state is that of the machine without clearance.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        From `optlink.load`, the name of a shipped problem, or a file; at least one joint has a clearance.
    revolutions : int
        Duration in revolutions at the nominal speed.
    points : int
        Rows per revolution.
    speed : float [rad/s], optional
        Crank speed, of which a time of one revolution counts as one; under a torque also the speed at the start. Default:
        `drive.speed` of the problem; under a torque it starts at `drive.initial_speed`, else at that.
    control : str
        "none", "inverse", "pid" or "inverse+pid"; all but the first need `[drive] servo` and `[control]`.
    start : float [rad], optional
        Initial crank angle. Default: that of the problem.
    design : mapping of str to float [SI] or str, optional
        Values of design variables. Default: their starting values.
    flywheel : float [kg m^2]
        Additional moment of inertia at the crank.
    tolerance : float
        Relative tolerance of the integrator; the absolute one is a thousandth of it (SI).
    check_predictability : bool
        Whether a second run at a coarser tolerance determines how long the motion is predictable.
    integrator : str
        Integrator: "cvodes", "compiled" (needs numba), or "auto": compiled for long work, and where the machine is compiled
        already, if numba is installed; a run that resumes keeps its integrator.
    stream : function of the rows of a revolution, optional
        Called after every revolution; memory does not grow with the number of revolutions.
    **checkpoints : Checkpoints
        A checkpoint is made every few seconds and on termination. It does not contain earlier rows. If all revolutions are
        complete, the last one is simulated again.

    Returns
    -------
    ClearanceSimulation
        Columns, contacts, statistics and predictability. If the integration stalls or is interrupted, it contains the results
        up to that time.

    Raises
    ------
    InputError
        If no joint has clearance, an argument is invalid, or the checkpoint belongs to another run.

    Examples
    --------
    >>> run = optlink.control.simulate_clearance(optlink.load("slider-crank-clearance"), revolutions=2, points=36)
    >>> round(1e3 * run.figures["rms_m"], 4), run.figures["contacts"]  # deviation of the slider [mm]
    (0.4436, 32.0)
    """
    problem = problem_of(problem)
    progress, checkpoint, resume = checkpoints.get("progress"), checkpoints.get("checkpoint"), checkpoints.get("resume")
    sizes = check_design(problem, design)
    setting = _setting(problem, points, speed, control, start, sizes, flywheel)
    _check(revolutions, points, tolerance)
    closed_loop = setting.closed_loop(tolerance)
    work = revolutions + min(revolutions, WATCHED) * check_predictability
    integrator = chosen(resumed(integrator, resume), closed_loop, work, cache=True)
    pair = PredictabilityCheck(setting.closed_loop(tolerance * TOLERANCE_RATIO)) if check_predictability else None
    closed_loops = [closed_loop] if pair is None else [closed_loop, pair.closed_loop]
    if integrator is IntegratorKind.COMPILED:
        with COMPILING.get()():
            for member in closed_loops:
                member.compile()
    account = Statistics(closed_loop)
    skipped = revolutions - revolutions_counted(revolutions)
    options: dict[str, Any] = {
        "problem_hash": problem.hash,
        "speed_rad_s": setting.nominal,
        "start_rad": setting.start,
        "control": str(setting.control),
        "points": points,
        "tolerance": tolerance,
        "skipped": skipped,
        "integrator": str(integrator),
        "design": sizes,
        "flywheel_kg_m2": flywheel,
        "check_predictability": check_predictability,
    }
    if resume is not None:
        begun = read_checkpoint(ClearanceCheckpoint, resume, options)
        state = begun.state_for(revolutions)
        if state is None:
            message, remedy = (
                f"{count_noun(begun.revolutions, 'revolution is', 'revolutions are')} already complete",
                "Request more, or leave out --resume",
            )
            raise InputError(message, remedy, key="revolutions", value=revolutions)
        closed_loop.restore(state.closed_loop)
        account.restore(state.statistics)
        if pair is not None and state.predictability is not None:
            pair.restore(state.predictability)

    def save() -> dict[str, Any]:
        return {"closed_loop": closed_loop.save(), "predictability": None if pair is None else pair.save()}

    def keep(before: RevolutionState | None = None) -> None:
        if checkpoint is not None and account.count:
            after = RevolutionState(**saved, statistics=account.save())
            checkpoint(ClearanceCheckpoint(**options, revolutions=account.count, state=after, before=before).document())

    if progress is not None:
        closed_loop.advanced = lambda completed: progress(completed / revolutions)
    kept_at, saved = time.monotonic(), save()
    ending, message = Ending.FINISHED, f"{revolutions} revolution{' was' if revolutions == 1 else 's were'} simulated"
    notes = [*start_value_notes(problem, design), *_sample_time_note(setting, closed_loop)]
    notes += pole_notes(
        problem.model.driving, setting.machine, setting.start, revolutions, setting.nominal, setting.servo is not None
    )
    try:
        with interrupts.watched() as stop:
            for member in closed_loops:
                member.integration.stop = stop
            before = None
            for k in range(account.count, revolutions):
                if k + 1 == revolutions and checkpoint is not None:
                    before = RevolutionState(**saved, statistics=account.save())
                rows = account.add(k >= skipped)
                if stream is not None:
                    stream(rows)
                if pair is not None:
                    pair.follow(rows[setting.output.column])
                saved = save()
                if time.monotonic() - kept_at > EVERY or k + 1 == revolutions:
                    keep(before)
                    kept_at = time.monotonic()
    except Stalled as error:
        account.add_partial()
        ending = Ending.STALLED
        angle = math.degrees(float(closed_loop.integration.state[closed_loop.equations.tree.driven]))
        message = f"{error.reason}, at {closed_loop.time:.9g} s, crank angle {angle:.6g} deg, revolution {account.count + 1}"
    except KeyboardInterrupt:
        interrupts.handled()
        account.add_partial()
        ending, message = Ending.INTERRUPTED, f"{account.count} of {revolutions} revolutions were simulated"
    if ending is not Ending.FINISHED:
        keep()
    if ending is Ending.STALLED:
        notes.append(f"The state then: {_state(closed_loop)}")
        notes.append(
            "Results up to that time are kept. Another contact stiffness, a higher restitution, masses or a lower speed may help"
        )
        if integrator is IntegratorKind.CVODES and TOO_DEEP not in message:  # which every integrator finds
            notes.append(
                f"The other integrator may pass this position: --integrator compiled. {'' if installed() else INSTALL}".strip()
            )
    prediction = pair.prediction if pair is not None and account.count else None
    if prediction is not None and prediction.chaotic:
        notes.append(
            f"The motion is sensitive: runs at two tolerances diverge after {prediction.parted:z.2f} revolutions. From there on "
            "single values of the trajectory are meaningless; root mean squares and other statistics remain valid"
        )
    kept = {} if not account.rows else {name: np.concatenate([rows[name] for rows in account.rows]) for name in account.meanings}
    measured = _measured(setting, kept, (skipped, revolutions)) if ending is Ending.FINISHED else None
    figures = account.figures() | ({} if measured is None else measured.figures)
    return ClearanceSimulation(
        problem,
        sizes or {},
        flywheel,
        setting.gaps,
        setting.output,
        setting.control,
        setting.nominal,
        setting.start,
        closed_loop.sample_time if closed_loop.controller else None,
        kept,
        account.meanings,
        table(account.per_revolution),
        (*account.impacts, *closed_loop.integration.lasting),
        table(account.poincare_map),
        figures,
        prediction,
        ending,
        closed_loop.time,
        message,
        tuple(notes),
        tolerance,
        str(integrator),
        {} if measured is None else measured.columns,
    )


@dataclass(frozen=True, repr=False, eq=False)
class InverseMotion(Summary):
    """Crank motion of the inverse model over one revolution, each (n,): the displacement r1 is its input, omega2 its output.

    Attributes
    ----------
    time
        Time since the start of the revolution [s].
    target
        Given output [m, rad].
    angle, speed
        Crank angle [rad] and crank speed [rad/s].
    reached
        Output at this crank angle, with the journals at their predicted positions [m, rad].
    """

    time: Array
    target: Array
    angle: Array
    speed: Array
    reached: Array


@typed
def inverse_model(
    problem: AnyProblem,
    displacement: ArrayLike | None = None,
    *,
    speed: float | None = None,
    design: Mapping[str, float | str] | None = None,
) -> InverseMotion:
    """Compute the crank motion with which the output of a machine with joint clearance has a given displacement.

    The journals lie where the load of the machine without clearance presses them, in the joints of `control.known`. At a dead
    centre of the output the motion is regularised (`control.regularisation`), and it has harmonics up to `control.bandwidth`.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        From `optlink.load`, the name of a shipped problem, or a file; at least one joint has a clearance.
    displacement : array (n,) [m, rad], optional
        Output at n equal intervals of a revolution, the first at `drive.start`. Default: that of the machine without clearance.
    speed : float [rad/s], optional
        Mean crank speed. Default: `drive.speed`.
    design : mapping of str to float [SI] or str, optional
        Values of design variables. Default: their starting values.

    Raises
    ------
    InputError
        If no joint has a clearance, or an argument is invalid.

    Examples
    --------
    >>> motion = optlink.control.inverse_model(optlink.load("slider-crank-clearance"))
    >>> [round(float(speed), 2) for speed in (motion.speed.min(), motion.speed.max())]  # 1200 rpm are 125.66 rad/s
    [118.9, 139.92]
    """
    problem = problem_of(problem)
    setting = _setting(problem, 360, speed, "none", None, check_design(problem, design), 0.0)
    if not setting.modelled:
        raise InputError("the inverse model includes no joint", 'Name one: known = ["C"]', problem.file, "control.known")
    inverse = Inverse(setting.machine, setting.modelled, setting.output, setting.start, setting.nominal)
    if displacement is not None:
        from scipy.signal import resample

        given = check_array("displacement", displacement)
        if given.ndim != 1 or len(given) < 3:
            message = "expected the output at three or more equal intervals of a revolution"
            raise InputError(message, "Give an array (n,) in m or rad", key="displacement", value=f"{given.shape} array")
        angles = setting.start + math.copysign(TURN, setting.nominal) * np.arange(len(given)) / len(given)
        ideal = np.broadcast_to(setting.output.ideal(setting.machine.moving(angles))[0], angles.shape)
        inverse.target = inverse.target + resample(setting.output.difference(given, ideal), len(inverse.target))
    return InverseMotion(*inverse.motion(setting.regularisation, setting.bandwidth))


def _measured(setting: _Setting, rows: Mapping[str, Array], counted: tuple[int, int]) -> MeasuredComparison | None:
    """Compare the rows with the measured series of the problem, if it has one."""
    series = setting.file.model.measured
    if series is None:
        return None
    times = series.times(setting.start, setting.nominal)
    return measured_comparison(times, series.values, rows, setting.output, TURN / abs(setting.nominal), counted)


def revolutions_counted(revolutions: int) -> int:
    """Return the number of last revolutions of a run that the statistics include."""
    return revolutions - RUNNING_IN if revolutions > 2 * RUNNING_IN else revolutions


@typed
def check_simulations(
    problem: ProblemFile,
    control: str,
    *,
    revolutions: int,
    points: int,
    tolerance: float,
    speed: float | None = None,
    design: Mapping[str, float | str] | None = None,
    integrator: str = "auto",
    runs: int = 1,
) -> tuple[Output, str]:
    """Check the options of `runs` simulations; return the output whose deviation they measure, and their integrator.

    Equations for the compiled integrator are compiled and cached on the disk.
    """
    setting = _setting(problem, points, speed, control, None, check_design(problem, design), 0.0)
    _check(revolutions, points, tolerance)
    closed_loop = setting.closed_loop(tolerance)
    integrator = chosen(integrator, closed_loop, revolutions * runs)
    if integrator is IntegratorKind.COMPILED:
        with COMPILING.get()():
            closed_loop.compile()
    return setting.output, str(integrator)


def _setting(
    problem: ProblemFile,
    points: int,
    speed: float | None,
    control: str,
    start: float | None,
    design: Mapping[str, float] | None,
    flywheel: float,
) -> _Setting:
    model, name = problem.model, problem.file
    if control not in [str(kind) for kind in Control]:
        raise InputError(
            "no such control", nearest(control, [*(str(kind) for kind in Control), "compare"]), key="control", value=control
        )
    machine = with_flywheel(machine_of(problem, design), flywheel)
    check_one_crank(problem, machine, "joint clearance")
    with input_of(name):
        gaps = model.gaps(machine)
    if not gaps:
        pin = next(iter(machine.mechanism.pins))
        remedy = f'Add one: [joints.{pin}] clearance = "0.5 mm", bearing_radius = "10 mm", modulus = "207 GPa"'
        raise InputError("no joint of the problem has a clearance", remedy, name, "joints")
    if machine.friction:
        guide = next(iter(machine.friction))
        message = "friction in a guide and clearance in a pin are not simulated together"
        raise InputError(
            message, "Remove the friction of the guide, or the clearance", name, f"mechanism.guides.{guide}.friction"
        )
    if start is not None and not abs(start) <= 1e6:
        raise InputError("out of range", "Give an angle", key="start", value=f"{start} rad")
    drive, kind = model.drive, Control(control)
    begin = problem.model.driving.first if start is None else start
    if machine.mechanism.limits is not None:
        message, remedy = "the drive has a range; simulation with clearance needs full revolutions", "Leave it out"
        raise InputError(message, remedy, name, "drive.range", problem.at("drive.range"))
    ranges, _, _ = motion_range(problem, machine, begin)
    check_regular(problem, ranges, "clearance is not simulated there")
    if not ranges.full:
        message = "the crank cannot turn fully; simulation with clearance needs full revolutions"
        raise InputError(message, "Change the dimensions so that it can", name, "mechanism")
    nominal = crank_speed(problem, speed)
    processes = {
        "drive.speed" if speed is None else "--speed": (
            "a vibration of a journal on its bearing",
            vibration(machine, gaps, nominal),
        )
    }
    servo = None if drive.servo is None else Servo(drive.servo.bandwidth.value, drive.servo.damping)
    if kind is not Control.NONE:
        if servo is None:
            remedy = 'Add servo = { bandwidth = "300 Hz", damping = 0.7 } below [drive]'
            raise InputError(f"control {kind} needs a servo drive", remedy, name, "drive.servo")
        if model.control is None:
            remedy = 'Add [control] with regularisation = "5 mm", proportional = 0.05, integral = 10.0'
            raise InputError(f"control {kind} needs the controlled joint", remedy, name, "control")
        if kind.fed_back and not any((model.control.proportional, model.control.integral, model.control.derivative)):
            raise InputError("all gains of the PID are zero", "Give proportional = 0.05 or integral = 10.0", name, "control")
        if kind.fed_back:
            processes["control.sample_time"] = ("a sample", model.control.sample_time.value)
    if servo is not None:
        processes["drive.servo.bandwidth"] = ("a vibration of the servo", TURN / servo.bandwidth)
    check_pace(problem, nominal, processes)
    first = starting_speed(problem, speed)
    output = model.controlled_output(machine)
    return _Setting(problem, machine, gaps, output, kind, servo, begin, first, nominal, points)


def _check(revolutions: int, points: int, tolerance: float) -> None:
    check_range("revolutions", revolutions, 1, 10_000_000)
    check_range("points", points, 12, 100_000)
    if not 1e-13 <= tolerance <= 1e-4:
        raise InputError("out of range", "Give a number from 1e-13 to 1e-4", key="tolerance", value=tolerance)


def _state(closed_loop: ClosedLoop) -> str:
    """Return the coordinates and their rates as text."""
    tree, state = closed_loop.equations.tree, closed_loop.integration.state
    units = {"angle": "rad", "x": "m", "y": "m", "slide": "m"}
    pairs = zip(tree.coordinates, state[: closed_loop.equations.size], state[closed_loop.equations.size :], strict=True)
    return "; ".join(f"{c.name} {q:.6g} {units[c.kind]}, {v:.6g} {units[c.kind]}/s" for c, q, v in pairs)


def _sample_time_note(setting: _Setting, closed_loop: ClosedLoop) -> list[str]:
    section = setting.file.model.control
    if closed_loop.controller and section is not None and abs(closed_loop.sample_time / section.sample_time.value - 1.0) > 1e-9:
        return [f"The sample time is {closed_loop.sample_time * 1e3:.6g} ms, so that it fits the revolution and its rows"]
    return []
