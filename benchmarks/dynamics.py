"""Forces of machines: the six-bar's reactions and torque, batches of its designs, the slider-crank in time; against Exudyn.

Every measurement runs in a process of its own (`python dynamics.py NAME` prints its figures): Exudyn writes to the console and
brings its own threads, and nobody shall profit from another's memory.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from timing import COST, GROWTH, ROOT, Row, child, race

if TYPE_CHECKING:
    from optlink.dynamics.machine import Machine

Array = NDArray[np.float64]

POSITIONS, SPEED = 360, 10.0  # of the crank, once round [rad/s]
BUDGET = 3e-3  # s for all reactions and the torque of POSITIONS positions
ACCURATE = 1e-6  # error at which the peer's way counts, as a share of the largest value
FORCE = 1000.0  # N along +x on the six-bar's slider
REPETITIONS, ROUNDS, INNER = 25, 5, 50
COUNTS = (10, 100, 1000, 10_000)  # designs in a call
DESIGNS = 1000  # of which positions per second are told
SPREAD = 0.03  # of the link lengths, either way: every design still turns fully
DURATION, TORQUE = 2.0, 0.1  # s, N m, of the slider-crank
# Its crank angle [rad] after that, from t = integral of sqrt(I / (2 M phi)) over phi, with I(phi) by hand (Gauss-Legendre).
END = 55.072443795656
# Ways to the peer's reactions, each a list of runs (steps, tolerance of Newton's method); the fastest that is accurate counts.
# Steps are multiples of POSITIONS. Two runs are extrapolated by Richardson, which the peer does not do itself.
WAYS = {
    "one run of 2,520 steps": ((2520, 1e-10),),
    "runs of 360 and 1,080 steps, extrapolated": ((360, 1e-8), (1080, 1e-8)),
}
STEPS, TOLERANCE = (2000, 4000, 6000, 8000), 1e-11  # of the simulation; all extrapolated together, else the last alone


# --- the peer ------------------------------------------------------------------------------------------------------


@dataclass
class Peer:
    """A mechanism of links and a slider along the x axis as an Exudyn model, rigid bodies in the plane."""

    exudyn: Any
    container: Any  # owns the system
    system: Any
    joints: dict[str, tuple[int, int]]  # name -> (sensor, number of components)
    crank: int  # node

    def run(self, duration: float, steps: int, tolerance: float, rows: int) -> None:
        """Trapezoidal rule with velocity constraints, EigenDense, a new Jacobian per step: its fastest settings for this size."""
        settings = self.exudyn.SimulationSettings()
        settings.solution.file.write = False
        settings.solution.sensors.writePeriod = duration / rows
        settings.linearSolver.solverType = self.exudyn.LinearSolverType.EigenDense
        integration = settings.timeIntegration
        integration.endTime, integration.numberOfSteps = duration, steps
        integration.generalizedAlpha.computeInitialAccelerations = True
        integration.generalizedAlpha.storeInitialAlgebraicCoordinates = True
        integration.newton.useModifiedNewton = integration.newton.modifiedNewtonJacUpdatePerStep = True
        integration.newton.relativeTolerance, integration.newton.absoluteTolerance = tolerance, 1e-12
        self.system.SolveDynamic(settings, solverType=self.exudyn.DynamicSolverType.TrapezoidalIndex2)

    def reactions(self) -> Array:
        """Forces of all joints on the second body, last the torque of the drive, stored in the last run; one position per row."""
        stored = [(self.system.GetSensorStoredData(sensor), size) for sensor, size in self.joints.values()]
        return -np.hstack([table[:, 1 : 1 + size] for table, size in stored])

    def angle(self) -> float:
        """By how much the crank has turned at the end of the last run [rad]."""
        return float(self.system.GetNodeOutput(self.crank, self.exudyn.OutputVariableType.Coordinates)[2])


def peer(machine: Machine, start: float, speed: float, force: float = 0.0, torque: float | None = None) -> Peer:
    """The model; the crank is held at its speed, or driven by a torque."""
    import exudyn as exu
    import exudyn.itemInterface as item

    container = exu.SystemContainer()
    system = container.AddSystem()
    moving = machine.moving(np.array([start]), speed)
    ground, fixed = system.AddObject(item.ObjectGround()), system.AddNode(item.NodePointGround())
    zero = system.AddMarker(item.MarkerNodeCoordinate(nodeNumber=fixed, coordinate=0))
    bodies: dict[str, int] = {}
    nodes: dict[str, int] = {}
    joints: dict[str, tuple[int, int]] = {}

    def number(value: Any) -> float:
        return float(np.ravel(value)[0])

    def frame(body: str) -> tuple[Array, Array]:
        """Centroid and x axis."""
        state, inertia = moving.state(body), machine.inertias[body]
        axis = np.array([number(part) for part in state.axis])
        return np.array([number(part) for part in state.start]) + inertia.along * axis, axis

    def marker(body: str, point: str) -> Any:
        at = np.array([number(part) for part in moving.position(point)])
        if body == "frame":
            return system.AddMarker(item.MarkerBodyPosition(bodyNumber=ground, localPosition=[*at, 0.0]))
        centroid, axis = frame(body)
        local = [axis @ (at - centroid), axis[0] * (at - centroid)[1] - axis[1] * (at - centroid)[0], 0.0]
        return system.AddMarker(item.MarkerBodyPosition(bodyNumber=bodies[body], localPosition=local))

    def told(name: str, connector: Any, size: int) -> None:
        sensor = item.SensorObject(
            objectNumber=system.AddObject(connector),
            storeInternal=True,
            writeToFile=False,
            outputVariableType=exu.OutputVariableType.Force,
        )
        joints[name] = (system.AddSensor(sensor), size)

    for body, inertia in machine.inertias.items():
        state = moving.state(body)
        centroid, axis = frame(body)
        omega = number(state.omega)
        velocity = np.array([number(part) for part in state.velocity]) + omega * inertia.along * np.array([-axis[1], axis[0]])
        if inertia.moment:
            place = [*centroid, np.arctan2(axis[1], axis[0])]
            nodes[body] = system.AddNode(item.NodeRigidBody2D(referenceCoordinates=place, initialVelocities=[*velocity, omega]))
            made = item.ObjectRigidBody2D(mass=inertia.mass, inertia=inertia.moment, nodeNumber=nodes[body])
        else:  # the slider: a point that has no rotation to be held
            nodes[body] = system.AddNode(item.NodePoint2D(referenceCoordinates=centroid, initialVelocities=velocity))
            made = item.ObjectMassPoint2D(mass=inertia.mass, nodeNumber=nodes[body])
        bodies[body] = system.AddObject(made)
        whole = system.AddMarker(item.MarkerBodyMass(bodyNumber=bodies[body]))
        weight = [*(number(part) for part in machine.gravity), 0.0]
        system.AddLoad(item.LoadMassProportional(markerNumber=whole, loadVector=weight))
    for point, (first, *others) in machine.mechanism.pins.items():
        for other in others:
            told(f"{point}.{other}", item.ObjectJointRevolute2D(markerNumbers=[marker(first, point), marker(other, point)]), 2)
    (guide,) = machine.mechanism.guides
    across = system.AddMarker(item.MarkerNodeCoordinate(nodeNumber=nodes[guide.slider], coordinate=1))
    told(guide.name, item.ObjectConnectorCoordinate(markerNumbers=[zero, across]), 1)
    crank = nodes[machine.mechanism.crank.body]
    turning = system.AddMarker(item.MarkerNodeCoordinate(nodeNumber=crank, coordinate=2))
    if torque is None:
        told("torque", item.ObjectConnectorCoordinate(markerNumbers=[zero, turning], velocityLevel=True, offset=speed), 1)
    else:
        system.AddLoad(item.LoadCoordinate(markerNumber=turning, load=torque))
    if force:
        pin = next(point for point, on in machine.mechanism.pins.items() if guide.slider in on)
        system.AddLoad(item.LoadForceVector(markerNumber=marker(guide.slider, pin), loadVector=[force, 0.0, 0.0]))
    system.Assemble()
    return Peer(exu, container, system, joints, crank)


def installed() -> bool:
    """Whether the peer can be imported."""
    sys.exudynFast = True  # type: ignore[attr-defined]  # its build without range checks
    try:
        import exudyn  # noqa: F401
    except ImportError:
        return False
    return True


def extrapolated(values: Sequence[Any], steps: Sequence[int]) -> Any:
    """What runs with these numbers of steps tend to, if their error is a series in the square of the step (Neville)."""
    table, squares = list(values), [count**-2.0 for count in steps]
    for k in range(1, len(steps)):
        pairs = zip(squares, squares[k:], table, table[1:], strict=False)
        table = [fine + (fine - coarse) * small / (large - small) for large, small, coarse, fine in pairs]
    return table[0]


# --- measurements, each in a process of its own --------------------------------------------------------------------


def columns(forces: dict[str, Any], names: Sequence[str]) -> Array:
    """Our reactions as the peer tells them: both parts of each force, position by position."""
    parts = [part for name in names for part in (forces[name] if isinstance(forces[name], tuple) else (forces[name],))]
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def measure_reactions() -> dict[str, Any]:
    """Seconds for all reactions and the torque once round, ours and by each of the peer's ways, and the peer's errors."""
    import optlink
    from optlink.dynamics.inverse import reactions
    from optlink.tasks.machine import machine_of

    problem = optlink.load("six-bar")
    machine, start = machine_of(problem), problem.model.drive.start.value
    angles = start + 2.0 * np.pi * np.arange(POSITIONS) / POSITIONS
    contenders: dict[str, Callable[[], Any]] = {"ours": lambda: reactions(machine.moving(angles, SPEED))}
    errors = {}
    if installed():
        model = peer(machine, start, SPEED, force=FORCE)

        def by(runs: Sequence[tuple[int, float]]) -> Array:
            found = []
            for steps, tolerance in runs:
                model.run(2.0 * np.pi / SPEED, steps, tolerance, POSITIONS)
                found.append(model.reactions()[:POSITIONS])
            return np.asarray(extrapolated(found, [steps for steps, _ in runs]))

        own = contenders["ours"]()
        forces = {f"{point}.{body}": force for point, on in own.pins.items() for body, force in on.items()}
        forces |= {name: guide.normal for name, guide in own.guides.items()} | {"torque": own.torque}
        told = columns(forces, list(model.joints))
        for way, runs in WAYS.items():
            errors[way] = float(np.max(np.max(np.abs(by(runs) - told), axis=0) / np.max(np.abs(told), axis=0)))
            contenders[way] = lambda runs=runs: by(runs)
    once = contenders["ours"]
    contenders["ours"] = lambda: [once() for _ in range(INNER)]  # as long a turn as the peer's, so that neither starts cold
    seconds = race(contenders, REPETITIONS)
    return {"seconds": seconds | {"ours": seconds["ours"] / INNER}, "errors": errors}


def chosen(kind: str) -> list[str]:
    """The torque alone, or with it both parts of every joint reaction of the six-bar."""
    pins = ("A", "B", "C.link2", "C.link3", "C.link5", "D", "E")
    told = [f"{pin}.f{axis}_N" for pin in pins for axis in "xy"] + ["F.normal_N"]
    return ["input.torque_Nm"] + (told if kind == "all" else [])


def designs(count: int) -> dict[str, Array]:
    """Six-bars with random link lengths [m]."""
    rng = np.random.default_rng(0)
    sizes = {"crank": 0.4, "link2": 1.2, "link3": 0.8, "link5": 1.2}
    return {f"{link}.length": size * rng.uniform(1.0 - SPREAD, 1.0 + SPREAD, count) for link, size in sizes.items()}


def measure_batch(kind: str) -> dict[str, Any]:
    """Median seconds of a call by number of designs, in turn; and whether every value is finite."""
    import optlink

    problem = optlink.load("six-bar")
    sets, wanted = {count: designs(count) for count in COUNTS}, chosen(kind)
    seconds: dict[int, list[float]] = {count: [] for count in COUNTS}
    sound = True
    for turn in range(-1, ROUNDS):
        for count, sizes in sets.items():
            for _ in range(max(1, DESIGNS // 4 // count)):  # the short calls several times
                begin = time.perf_counter()
                found = optlink.analyze_batch(problem, sizes, wanted, points=POSITIONS)
                if turn >= 0:
                    seconds[count].append(time.perf_counter() - begin)
            sound = sound and (turn >= 0 or all(bool(np.all(np.isfinite(values))) for values in found.values()))
            del found
    return {"seconds": [statistics.median(taken) for taken in seconds.values()], "sound": sound}


def measure_memory(kind: str) -> dict[str, Any]:
    """Bytes held at the peak of a call beside its results, by number of designs."""
    import optlink

    problem, wanted = optlink.load("six-bar"), chosen(kind)
    optlink.analyze_batch(problem, designs(COUNTS[0]), wanted, points=POSITIONS)  # imports and caches
    beside = []
    for count in COUNTS:
        sizes = designs(count)
        tracemalloc.start()
        found = optlink.analyze_batch(problem, sizes, wanted, points=POSITIONS)
        beside.append(tracemalloc.get_traced_memory()[1] - sum(values.nbytes for values in found.values()))
        tracemalloc.stop()
        del found
    return {"bytes": beside}


def measure_simulation() -> dict[str, Any]:
    """Seconds for the slider-crank's end angle and its error [rad]: ours, the peer's extrapolated and its last run alone."""
    import optlink
    from optlink.tasks.machine import machine_of

    problem = optlink.load("slider-crank")
    machine = machine_of(problem)
    ends: dict[str, float] = {}

    def ours() -> None:
        ends["ours"] = float(optlink.simulate(problem, duration=DURATION).figures["end.crank_angle_rad"])

    def afresh() -> None:
        optlink.simulate(optlink.load("slider-crank"), duration=DURATION)

    contenders: dict[str, Callable[[], object]] = {"ours": ours, "afresh": afresh}
    if installed():
        model = peer(machine, 0.0, 0.0, torque=TORQUE)

        def by(name: str, steps: Sequence[int]) -> None:
            found = []
            for count in steps:
                model.run(DURATION, count, TOLERANCE, 1)
                found.append(model.angle())
            ends[name] = float(extrapolated(found, steps))

        contenders |= {"extrapolated": lambda: by("extrapolated", STEPS), "single": lambda: by("single", STEPS[-1:])}
    seconds = race(contenders, 7, warm_up=1)
    return {"seconds": seconds, "errors": {name: abs(end - END) for name, end in ends.items()}}


MEASUREMENTS: dict[str, Callable[[], dict[str, Any]]] = {
    "reactions": measure_reactions,
    "batch-torque": lambda: measure_batch("torque"),
    "batch-all": lambda: measure_batch("all"),
    "memory-torque": lambda: measure_memory("torque"),
    "memory-all": lambda: measure_memory("all"),
    "simulation": measure_simulation,
}


# --- comparison ----------------------------------------------------------------------------------------------------


def measured(name: str) -> dict[str, Any]:
    """The figures of a measurement."""
    done = child(str(ROOT / "benchmarks" / "dynamics.py"), name)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def rate(value: float) -> str:
    return f"{value / 1e6:.3g} M/s" if value >= 1e5 else f"{value / 1e3:.3g} k/s"


def listed(values: Sequence[float], unit: float, decimals: int) -> str:
    return ", ".join(f"{value / unit:.{decimals}f}" for value in values)


ABSENT = "Exudyn is not installed"
KINDS = {"all": "all reactions and torque", "torque": "torque alone"}


def rows() -> list[Row]:
    """Inverse dynamics once round, batches, memory, simulation."""
    once = measured("reactions")
    own = once["seconds"]["ours"]
    accurate = {way: once["seconds"][way] for way, error in once["errors"].items() if error <= ACCURATE}
    what = f"inverse dynamics of the six-bar, all reactions and torque, {POSITIONS} positions in one call"
    note = "reactions(machine.moving(angles, 10 rad/s)), the problem read beforehand; ours / the budget"
    figures = {"ours": own, "theirs": BUDGET}
    shown = f"{1e3 * own:.2f} ms", f"{1e3 * BUDGET:.0f} ms"
    about = f"{what}: time against a budget of {1e3 * BUDGET:.0f} ms"
    result = [Row(about, *shown, own / BUDGET, "<= 1", note, figures=figures, kind=COST)]
    theirs = POSITIONS / min(accurate.values()) if accurate else float("nan")
    for way, runs in WAYS.items():
        target = ">= 100" if len(runs) == 1 else ""  # extrapolating two runs is a user's own work, told for information
        if way not in once["seconds"]:
            result.append(against(f"positions/s, {what}, against Exudyn, {way}", POSITIONS / own, float("nan"), target, ABSENT))
            continue
        note = (
            "its build without range checks, rigid bodies in the plane, model built beforehand; "
            f"{1e3 * once['seconds'][way]:.1f} ms, differs from ours by {once['errors'][way]:.1e} of the largest value"
        )
        peer = POSITIONS / once["seconds"][way]
        result.append(against(f"positions/s, {what}, against Exudyn, {way}", POSITIONS / own, peer, target, note))

    for kind, wanted in KINDS.items():
        batch, memory = measured(f"batch-{kind}"), measured(f"memory-{kind}")["bytes"]
        taken = dict(zip(COUNTS, batch["seconds"], strict=True))
        about = f"analyze_batch of the six-bar, {len(chosen(kind))} column{'s' if kind == 'all' else ''} ({wanted})"
        note = f"link lengths +-{100.0 * SPREAD:.0f} %" + ("" if batch["sound"] else "; NOT ALL VALUES ARE FINITE")
        note += (
            f"; Exudyn's positions/s as in the faster of the rows above, {KINDS['all']}, one model already built"
            if accurate
            else f"; {ABSENT}"
        )
        of = f"positions/s, {about}, {DESIGNS:,} designs x {POSITIONS} angles in one call, against Exudyn"
        result.append(against(of, DESIGNS * POSITIONS / taken[DESIGNS], theirs, "", note))
        per = [seconds / count for count, seconds in taken.items()]
        fewer, most = per[COUNTS.index(DESIGNS)], per[-1]
        counts = ", ".join(f"{count:,}" for count in COUNTS)
        result.append(
            Row(
                f"time per design, {about}: {COUNTS[-1]:,} designs in a call against {DESIGNS:,}",
                f"{1e6 * most:.0f} us",
                f"{1e6 * fewer:.0f} us",
                fewer / most,
                note=f"linear is 1x; at {counts} designs: {listed(per, 1e-6, 0)} us",
                figures={"ours": most, "theirs": fewer} | {f"designs_{n}": x for n, x in zip(COUNTS, per, strict=True)},
                kind=GROWTH,
            )
        )
        fewer, most = memory[COUNTS.index(DESIGNS)], memory[-1]
        size = 8e-6 * len(chosen(kind)) * POSITIONS * COUNTS[-1]
        result.append(
            Row(
                f"memory beside the result, {about}: {COUNTS[-1]:,} designs in a call against {DESIGNS:,}",
                f"{most / 1e6:.1f} MB",
                f"{fewer / 1e6:.1f} MB",
                fewer / most,
                note=f"peak by tracemalloc, without the result arrays ({size:.0f} MB at the most); "
                f"at {counts} designs: {listed(memory, 1e6, 1)} MB",
                figures={"ours": most, "theirs": fewer} | {f"bytes_{n}": x for n, x in zip(COUNTS, memory, strict=True)},
                kind=GROWTH,
            )
        )
    return [*result, *simulation_rows()]


def against(what: str, ours: float, theirs: float, target: str, note: str) -> Row:
    """Positions per second against the peer's, NaN where there is no peer."""
    if np.isnan(theirs):
        return Row(what, rate(ours), "skipped", target=target, note=note, figures={"ours": ours})
    return Row(what, rate(ours), rate(theirs), ours / theirs, target, note, figures={"ours": ours, "theirs": theirs})


def simulation_rows() -> list[Row]:
    """The slider-crank under a torque: time to its end angle, and how exact that is."""
    found = measured("simulation")
    seconds, errors = found["seconds"], found["errors"]
    own, miss = seconds["ours"], errors["ours"]
    what = f"simulation of the slider-crank, {DURATION:g} s under {TORQUE:g} N m, against Exudyn"
    afresh = f"simulated before, as the peer's model is built beforehand; read and compiled as well: {seconds['afresh']:.3f} s"
    note = f"{afresh}; error of the end angle {END:.7f} rad: ours {miss:.0e} rad (with 1,001 rows of all columns, works, drift)"
    if "single" not in seconds:
        figures = {"ours": own, "error": miss}
        return [Row(what, f"{own:.3f} s", "skipped", target=">= 5", note=f"{note}; {ABSENT}", figures=figures)]
    result = []
    for name, how in (
        ("extrapolated", f"end angles of runs of {', '.join(f'{n:,}' for n in STEPS)} steps, extrapolated"),
        ("single", f"one run of {STEPS[-1]:,} steps"),
    ):
        figures = {"ours": own, "theirs": seconds[name], "error": miss, "their_error": errors[name]}
        full = f"{note}, theirs {errors[name]:.0e} rad, the end angle only"
        shown = f"{own:.3f} s", f"{seconds[name]:.3f} s"
        target = ">= 5" if name == "extrapolated" else ""
        result.append(Row(f"{what}: {how}", *shown, seconds[name] / own, target, full, figures=figures))
    return result


if __name__ == "__main__":
    sys.path.insert(0, os.fspath(ROOT))
    print("\n" + json.dumps(MEASUREMENTS[sys.argv[1]]()))
