"""Clearance in a joint: a slider-crank with a gap between rod and slider, in time; against Exudyn, and SciPy by hand.

Crank at a given speed, clearance at the rod-slider pin, contact of Lankarani and Nikravesh, friction. Whoever tells the slider's
position to ACCURATE everywhere in the first REVOLUTIONS counts, with the fastest settings that do. What is true comes from the
motion by hand at a tight tolerance (`tests/gap_oracle.py`, in other coordinates, agrees with it to 0.1 nm). Exudyn is there
twice: as fast as we could make it (`peer`), and as its examples write such a model (`bodies`, the first revolution only).

Every speed runs in a process of its own (`python clearance.py RPM` prints its figures), as in `dynamics.py`.
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import cos, hypot, sin, sqrt, tanh
from typing import Any

import numpy as np
from dynamics import ABSENT, installed
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline
from timing import COST, ROOT, Row, child, race

Array = NDArray[np.float64]
Motion = Callable[[], Array]  # runs the simulation; the slider's positions at `times`

CRANK, ROD, HALF = 0.05, 0.12, 0.06  # m; HALF: from the crank pin to the rod's centroid
ROD_MASS, ROD_MOMENT, SLIDER_MASS, GRAVITY = 0.21, 2.5e-4, 0.14, 9.81
GAP, RADIUS = 0.5e-3, 9.5e-3  # m, of the journal, which the rod has
STIFFNESS = 2.0 * 207e9 / (3.0 * (1.0 - 0.3**2)) * math.sqrt(10e-3 * 9.5e-3 / 0.5e-3)  # N/m^1.5
DAMPING = 0.75 * (1.0 - 0.9**2)
FRICTION, WIDTH, SLOWEST = 0.1, 0.01, 1e-3

SPEEDS = (5000, 1200)  # rpm
REVOLUTIONS, SAMPLES = 3, 360  # of the crank; times per revolution at which the slider is looked at
ACCURATE = 1e-7  # m, of the slider, at the most
TIGHT = 1e-13  # tolerance of what is taken as true
REPETITIONS = 5
ONE_GAP, THREE_GAPS = "slider-crank-clearance", "slider-crank-three-gaps"
COMMANDS = (
    f"simulate {THREE_GAPS} --control compare --revolutions 15 --starts 5",
    f"simulate {THREE_GAPS} --control inverse+pid --tune proportional --tune integral",
)
COMMON = 1e-8  # tolerance at which their times are compared
# Tolerances tried, loosest first. A contact that is only just missed, or not, decides between errors of nm and of um, so that
# looser ones may be accurate by luck; the fastest that is accurate counts all the same.
OWN = {"compiled": (1e-7, 1e-8, 1e-9), "CVODES": (1e-8, 1e-9)}  # the integrators of optlink
BY_HAND = {"DOP853": (1e-8, 1e-9, 1e-10), "LSODA": (1e-8, 1e-9)}
# (relative, absolute) of Exudyn's Dormand-Prince of order 5
ITS = ((1e-7, 1e-7), (1e-8, 1e-6), (1e-8, 1e-7), (3e-9, 1e-7), (1e-9, 1e-8))
STEPS, TURNS = (32_000, 150_000), 3  # of Exudyn's trapezoidal rule in the first revolution; repetitions


def times(omega: float, revolutions: int = REVOLUTIONS) -> Array:
    """When the slider is looked at."""
    return np.linspace(0.0, revolutions * 2.0 * np.pi / omega, revolutions * SAMPLES + 1)


def longest(omega: float) -> float:
    """Step that no contact is too short for."""
    return math.radians(1.0) / omega


def penetration(ex: float, ey: float, vx: float, vy: float) -> tuple[float, float]:
    """Penetration and its rate from the journal's centre in the bearing and its velocity."""
    size = hypot(ex, ey)
    return size - GAP, (ex * vx + ey * vy) / size if size else hypot(vx, vy)


def depth(t: float, state: Any, omega: float) -> tuple[float, float]:
    """Penetration and its rate from rod angle, slider position and their rates."""
    phi, x, turning, speed = state
    theta = omega * t
    ex, ey = CRANK * cos(theta) + ROD * cos(phi) - x, CRANK * sin(theta) + ROD * sin(phi)
    vx = -CRANK * omega * sin(theta) - ROD * turning * sin(phi) - speed
    vy = CRANK * omega * cos(theta) + ROD * turning * cos(phi)
    return penetration(ex, ey, vx, vy)


# --- ours ----------------------------------------------------------------------------------------------------------


def ours(rpm: float, integrator: str, tolerance: float, revolutions: int = REVOLUTIONS, problem: str = ONE_GAP) -> Motion:
    """A shipped problem; equations are compiled once, as the peers' are. Peaks and works are part of it."""
    import optlink
    from optlink.clearance.columns import default_output
    from optlink.clearance.control import ClosedLoop
    from optlink.clearance.equations import Drive

    omega = rpm * math.pi / 30.0
    model = optlink.load(problem).model
    machine = model.machine()
    given: dict[str, Any] = {"start": 0.0, "speed": omega, "nominal": omega, "points": SAMPLES, "tolerance": tolerance}
    plant = ClosedLoop(machine, model.gaps(machine), Drive(), default_output(machine), **given)
    if integrator == "compiled":
        plant.compile()
    first = plant.integration
    begin = first.state
    slide = [coordinate.kind for coordinate in plant.equations.tree.coordinates].index("slide")

    def run() -> Array:
        course = type(first)(plant.equations, begin, first.step, tolerance, first.slow)
        blocks = list(course.advance(revolutions * plant.rows))  # it looks at as many samples, or a multiple
        return np.concatenate([begin[None, slide], *(block.states[:, slide] for block in blocks)])[:: plant.rows // SAMPLES]

    return run


def fast() -> bool:
    """Whether optlink can compile."""
    from optlink.clearance.control import installed as numba_is_installed

    return numba_is_installed()


# --- SciPy, by hand ------------------------------------------------------------------------------------------------


def by_hand(rpm: float, method: str, tolerance: float) -> Array:
    """Rod angle and slider position are all there is: solve_ivp from contact to contact, the right-hand side in plain floats."""
    omega = rpm * math.pi / 30.0
    moment, pull = ROD_MOMENT + ROD_MASS * HALF**2, ROD_MASS * HALF
    crank_pull, crank_speed, weight = pull * CRANK * omega**2, CRANK * omega, pull * GRAVITY

    def free(t: float, y: Array) -> list[float]:
        phi, _, turning, speed = y.tolist()
        return [turning, speed, (crank_pull * sin(omega * t - phi) - weight * cos(phi)) / moment, 0.0]

    def touching(approach: float) -> Callable[[float, Array], list[float]]:
        damping = DAMPING / approach

        def rates(t: float, y: Array) -> list[float]:
            phi, x, turning, speed = y.tolist()
            theta = omega * t
            s, c, sin_theta, cos_theta = sin(phi), cos(phi), sin(theta), cos(theta)
            ex, ey = CRANK * cos_theta + ROD * c - x, CRANK * sin_theta + ROD * s
            size = hypot(ex, ey)
            turned = crank_pull * (sin_theta * c - cos_theta * s) - weight * c
            delta = size - GAP
            if delta <= 0.0:
                return [turning, speed, turned / moment, 0.0]
            nx, ny = ex / size, ey / size
            vx, vy = -crank_speed * sin_theta - ROD * s * turning - speed, crank_speed * cos_theta + ROD * c * turning
            factor = 1.0 + damping * (vx * nx + vy * ny)
            if factor <= 0.0:
                return [turning, speed, turned / moment, 0.0]
            normal = STIFFNESS * delta * sqrt(delta) * factor
            tangential = -FRICTION * normal * tanh((vy * nx - vx * ny + RADIUS * turning) / WIDTH)
            fx, fy = -normal * nx - tangential * ny, tangential * nx - normal * ny
            return [turning, speed, (turned + ROD * (c * fy - s * fx) + RADIUS * tangential) / moment, -fx / SLIDER_MASS]

        return rates

    # Just after a switch the penetration is zero up to rounding: with this sign of its rate there is nothing to be found.
    def begins(t: float, y: Array) -> float:
        delta, rate = depth(t, y, omega)
        return delta if rate > 0.0 else -abs(delta) - 1e-12

    def ends(t: float, y: Array) -> float:
        delta, rate = depth(t, y, omega)
        return delta if rate < 0.0 else abs(delta) + 1e-12

    begins.terminal, begins.direction = True, 1.0  # type: ignore[attr-defined]
    ends.terminal, ends.direction = True, -1.0  # type: ignore[attr-defined]
    wanted, absolute = times(omega), tolerance * np.array([0.1, 0.01, 10.0, 1.0])
    slider, told = np.empty(len(wanted)), 0
    t, y, contact = 0.0, np.array([0.0, CRANK + ROD, -crank_speed / ROD, 0.0]), None
    while True:
        found = solve_ivp(
            free if contact is None else touching(contact),
            (t, wanted[-1]),
            y,
            method=method,
            t_eval=wanted[told:],
            events=begins if contact is None else ends,
            rtol=tolerance,
            atol=absolute,
            max_step=longest(omega),
        )
        if len(found.t):
            slider[told : told + len(found.t)] = found.y[1]
            told += len(found.t)
        if found.status != 1:
            return slider
        t, y = float(found.t_events[0][0]), found.y_events[0][0]
        contact = max(depth(t, y, omega)[1], SLOWEST) if contact is None else None


# --- Exudyn, as fast as we could make it ---------------------------------------------------------------------------


@dataclass
class Peer:
    """The machine as an Exudyn model; `connector` is the contact, `approach` the speed with which it began."""

    exudyn: Any
    container: Any  # owns the system
    system: Any
    connector: Any
    approach: Any
    force: Any  # the user function, kept alive
    omega: float

    def place(self, t: float, q: Array, v: Array) -> tuple[float, float]:
        """Penetration and its rate."""
        return depth(t, (q[0] + q[1], q[2], v[0] + v[1], v[2]), self.omega)

    def go(self, t: float, q: Array, v: Array, until: float, steps: int, tolerances: tuple[float, float] | None) -> None:
        """From a state on; no tolerances: equal steps, else they are the longest."""
        initial, data = self.exudyn.ConfigurationType.Initial, self.system.systemData
        data.SetODE2Coordinates(q, initial)
        data.SetODE2Coordinates_t(v, initial)
        settings = self.exudyn.SimulationSettings()
        settings.solution.file.write = False
        integration = settings.timeIntegration
        integration.explicit.computeEndOfStepAccelerations = integration.reuseConstantMassMatrix = False
        integration.startTime, integration.endTime, integration.numberOfSteps = t, until, steps
        integration.automaticStepSize = tolerances is not None
        if tolerances is not None:
            integration.relativeTolerance, integration.absoluteTolerance = tolerances
            integration.initialStepSize, integration.minimumStepSize = 1e-8, 1e-13
        self.system.SolveDynamic(settings, solverType=self.exudyn.DynamicSolverType.DOPRI5)

    def switch(self, before: tuple[float, Array, Array], after: tuple[float, Array, Array]) -> tuple[float, Array, Array]:
        """State at the change of sign of the penetration within a step: its cubic, then Newton's method with single steps."""
        (t, q, v), data = before, self.system.systemData
        step = after[0] - t
        ends = [self.place(*state) for state in (before, after)]
        cubic = CubicHermiteSpline([0.0, step], [delta for delta, _ in ends], [rate for _, rate in ends])
        part = next((root for root in cubic.roots(extrapolate=False) if root > 0.0), 0.5 * step)
        for _ in range(6):
            self.go(t, q, v, t + part, 1, None)
            state = t + part, data.GetODE2Coordinates(), data.GetODE2Coordinates_t()
            delta, rate = self.place(*state)
            if abs(delta) < 2e-14 or not rate:
                break
            part = min(max(part - delta / rate, 1e-15), step)
        return state

    def run(self, tolerances: tuple[float, float]) -> Array:
        """The slider at `times`; the solver is stopped after the step in which contact begins or ends, and the step is redone."""
        system, data, omega = self.system, self.system.systemData, self.omega
        initial, end = self.exudyn.ConfigurationType.Initial, float(times(omega)[-1])
        state = 0.0, np.array([0.0, 0.0, CRANK + ROD]), np.array([omega, -CRANK * omega / ROD - omega, 0.0])
        passed: list[tuple[float, float, float]] = []  # times, slider, its speed
        touching, beyond, last = False, None, state

        def after_step(_: Any, t: float) -> bool:
            nonlocal beyond, last
            if t <= last[0]:  # it is called at the start too
                return True
            q, v = data.GetODE2Coordinates(), data.GetODE2Coordinates_t()
            theta, relative, x = q.tolist()
            phi = theta + relative
            inside = hypot(CRANK * cos(theta) + ROD * cos(phi) - x, CRANK * sin(theta) + ROD * sin(phi)) < GAP
            if inside == touching:
                beyond = t, q, v
                return False
            last = t, q, v
            passed.append((t, x, v[2]))
            return True

        while True:
            system.SetObjectParameter(self.connector, "activeConnector", touching)
            system.SetPostStepUserFunction(after_step)
            last, beyond = state, None
            passed.append((state[0], state[1][2], state[2][2]))
            self.go(*state, end, math.ceil((end - state[0]) / longest(omega)), tolerances)
            if beyond is None:
                break
            system.SetPostStepUserFunction(0)
            state = self.switch(last, beyond)
            touching = not touching
            if touching:
                self.approach.SetValue(max(self.place(*state)[1], SLOWEST))
        system.SetPostStepUserFunction(0)
        data.SetODE2Coordinates(state[1], initial)
        told = np.array(passed)
        t, x, v = told[np.diff(told[:, 0], prepend=-1.0) > 0.0].T
        return np.asarray(CubicHermiteSpline(t, x, v)(times(omega)))


def peer(rpm: float) -> Peer:
    """Crank and rod as its tree of joints, the slider as a mass on a line: no constraints, so that explicit methods can be used.

    The crank is so heavy that it keeps its speed to 1e-10. The contact is a connector with a compiled ("symbolic") user function.
    Others at the same accuracy: the equations of `by_hand` as a generic ODE with a Python user function take as long; the tree
    with a Python user function 1.5 times as long; fixed steps of RK44, DOPRI5, RK67 2.5 to 10 times as long.
    """
    import exudyn as exu
    import exudyn.itemInterface as item
    from exudyn.advancedUtilities import CreateSymbolicUserFunction

    omega, symbolic, unit = rpm * math.pi / 30.0, exu.symbolic, np.eye(3)
    container = exu.SystemContainer()
    system = container.AddSystem()
    joints = system.AddNode(
        item.NodeGenericODE2(
            referenceCoordinates=[0.0, 0.0],
            initialCoordinates=[0.0, 0.0],
            initialCoordinates_t=[omega, -CRANK * omega / ROD - omega],
            numberOfODE2Coordinates=2,
        )
    )
    tree = system.AddObject(
        item.ObjectKinematicTree(
            nodeNumber=joints,
            gravity=[0.0, -GRAVITY, 0.0],
            jointTypes=[exu.JointType.RevoluteZ] * 2,
            linkParents=[-1, 0],
            jointTransformations=exu.Matrix3DList([unit, unit]),
            jointOffsets=exu.Vector3DList([[0.0, 0.0, 0.0], [CRANK, 0.0, 0.0]]),
            linkInertiasCOM=exu.Matrix3DList([1e9 * unit, ROD_MOMENT * unit]),
            linkCOMs=exu.Vector3DList([[0.0, 0.0, 0.0], [HALF, 0.0, 0.0]]),
            linkMasses=[1.0, ROD_MASS],
        )
    )
    node = system.AddNode(item.Node1D(referenceCoordinates=[0.0], initialCoordinates=[CRANK + ROD]))
    slider = system.AddObject(item.ObjectMass1D(mass=SLIDER_MASS, nodeNumber=node))
    bearing = system.AddMarker(item.MarkerBodyRigid(bodyNumber=slider, localPosition=[0.0, 0.0, 0.0]))
    journal = system.AddMarker(item.MarkerKinematicTreeRigid(objectNumber=tree, linkNumber=1, localPosition=[ROD, 0.0, 0.0]))
    approach, zero = symbolic.Real("approach", SLOWEST), symbolic.Real(0.0)

    # Each argument is an expression, and used again it is evaluated again: the sums are arranged for few uses.
    def contact(mbs, t, number, gap, angles, velocity, turning, stiffness, damping, first, second, offset):  # type: ignore[no-untyped-def]
        ex, ey, vx, vy = gap[0], gap[1], velocity[0], velocity[1]
        size = symbolic.sqrt(ex * ex + ey * ey)
        over = 1.0 / size
        factor = symbolic.max(zero, 1.0 + (DAMPING / approach) * ((vx * ex + vy * ey) * over))
        normal = symbolic.pow(symbolic.max(size - GAP, zero), symbolic.Real(1.5)) * factor * STIFFNESS
        share = symbolic.tanh(((vy * ex - vx * ey) * over + turning[2] * RADIUS) * (1.0 / WIDTH)) * FRICTION
        along = normal * over
        return [along * (ex - share * ey), along * (ey + share * ex), zero, zero, zero, normal * share * RADIUS]

    force = CreateSymbolicUserFunction(
        system,
        function=contact,
        userFunctionName="springForceTorqueUserFunction",
        itemTypeName="ObjectConnectorRigidBodySpringDamper",
    )
    connector = system.AddObject(
        item.ObjectConnectorRigidBodySpringDamper(markerNumbers=[bearing, journal], springForceTorqueUserFunction=force)
    )
    system.Assemble()
    return Peer(exu, container, system, connector, approach, force, omega)


# --- Exudyn, as its examples write it ------------------------------------------------------------------------------


def bodies(rpm: float) -> Callable[[int], Array]:
    """Rigid bodies and joints (its SliderCrank.py), contact as connector with a Python user function; a run by number of steps.

    Contact begins and ends as in its postNewtonStepContactTest.py: a step that goes beyond the switch is repeated, shorter, at
    the wish of the PostNewtonUserFunction, which also sets v0. With v0 from the first step in contact (PreStepUserFunction),
    errors are 2 to 8 times as large. Explicit methods know no joints; generalized-alpha is no faster and no more accurate.
    Newton's method has the loosest tolerances that cost no accuracy, and few iterations before a new Jacobian: with the default
    number all takes 1.4 times as long.
    """
    import exudyn as exu
    import exudyn.itemInterface as item

    omega = rpm * math.pi / 30.0
    turning = -CRANK * omega / ROD
    container = exu.SystemContainer()
    system = container.AddSystem()
    ground, fixed = system.AddObject(item.ObjectGround()), system.AddNode(item.NodePointGround())
    crank_node = system.AddNode(item.NodeRigidBody2D(initialVelocities=[0.0, 0.0, omega]))
    crank = system.AddObject(item.ObjectRigidBody2D(mass=0.3, inertia=1e-4, nodeNumber=crank_node))
    velocity = [0.0, CRANK * omega + HALF * turning, turning]
    rod_node = system.AddNode(item.NodeRigidBody2D(referenceCoordinates=[CRANK + HALF, 0.0, 0.0], initialVelocities=velocity))
    rod = system.AddObject(item.ObjectRigidBody2D(mass=ROD_MASS, inertia=ROD_MOMENT, nodeNumber=rod_node))
    slider_node = system.AddNode(item.Node1D(referenceCoordinates=[CRANK + ROD]))
    slider = system.AddObject(item.ObjectMass1D(mass=SLIDER_MASS, nodeNumber=slider_node))

    def marker(body: Any, x: float) -> Any:
        return system.AddMarker(item.MarkerBodyRigid(bodyNumber=body, localPosition=[x, 0.0, 0.0]))

    system.AddObject(item.ObjectJointRevolute2D(markerNumbers=[marker(ground, 0.0), marker(crank, 0.0)]))
    system.AddObject(item.ObjectJointRevolute2D(markerNumbers=[marker(crank, CRANK), marker(rod, -HALF)]))
    zero = system.AddMarker(item.MarkerNodeCoordinate(nodeNumber=fixed, coordinate=0))
    angle = system.AddMarker(item.MarkerNodeCoordinate(nodeNumber=crank_node, coordinate=2))
    system.AddObject(item.ObjectConnectorCoordinate(markerNumbers=[zero, angle], velocityLevel=True, offset=omega))
    whole = system.AddMarker(item.MarkerBodyMass(bodyNumber=rod))
    system.AddLoad(item.LoadMassProportional(markerNumber=whole, loadVector=[0.0, -GRAVITY, 0.0]))
    nothing = [0.0] * 6
    touching, damping = False, 0.0

    def contact(mbs, t, number, gap, angles, velocity, turning, stiffness, dampers, first, second, offset):  # type: ignore[no-untyped-def]
        if not touching:
            return nothing
        (ex, ey, _), (vx, vy, _) = gap, velocity
        size = sqrt(ex * ex + ey * ey)
        delta = size - GAP
        if delta <= 0.0:
            return nothing
        nx, ny = ex / size, ey / size
        normal = STIFFNESS * delta * sqrt(delta) * max(1.0 + damping * (vx * nx + vy * ny), 0.0)
        share = FRICTION * normal * tanh((vy * nx - vx * ny + turning[2] * RADIUS) / WIDTH)
        return [normal * nx - share * ny, normal * ny + share * nx, 0.0, 0.0, 0.0, share * RADIUS]

    system.AddObject(
        item.ObjectConnectorRigidBodySpringDamper(
            markerNumbers=[marker(slider, 0.0), marker(rod, HALF)], springForceTorqueUserFunction=contact
        )
    )
    kinds = exu.OutputVariableType.Coordinates, exu.OutputVariableType.Coordinates_t
    sensors = [
        system.AddSensor(item.SensorNode(nodeNumber=slider_node, storeInternal=True, writeToFile=False, outputVariableType=kind))
        for kind in kinds
    ]
    system.Assemble()
    data, begin, now = system.systemData, exu.ConfigurationType.StartOfStep, exu.ConfigurationType.Current

    def place(when: Any) -> tuple[float, float]:
        x, y, phi, slid = data.GetODE2Coordinates(when, copy=False).tolist()[3:]
        vx, vy, turning, speed = data.GetODE2Coordinates_t(when, copy=False).tolist()[3:]
        s, c = HALF * sin(phi), HALF * cos(phi)
        return penetration(x + c - HALF - slid, y + s, vx - turning * s - speed, vy + turning * c)

    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    settings.linearSolver.solverType = exu.LinearSolverType.EigenDense
    integration = settings.timeIntegration
    integration.endTime, integration.minimumStepSize = 2.0 * math.pi / omega, 1e-14
    settings.solution.sensors.writePeriod = integration.endTime / (10 * SAMPLES)
    integration.stepInformation = 3  # not every repeated step
    newton, discontinuous = integration.newton, integration.discontinuous
    newton.relativeTolerance, newton.absoluteTolerance, newton.maxModifiedNewtonIterations = 1e-6, 1e-8, 2
    integration.generalizedAlpha.spectralRadius = 1.0
    discontinuous.iterationTolerance = 1e-11  # penetration at which contact may begin or end [m]
    discontinuous.maxIterations, discontinuous.ignoreMaxIterations = 1, False  # repeat the step at once
    integration.adaptiveStepRecoverySteps, integration.adaptiveStepIncrease = 0, 10.0  # and after it be fast again
    integration.adaptiveStepRecoveryIterations = 100

    def after_newton(mbs: Any, t: float) -> list[float]:
        """How far beyond a switch this step has gone, and the step recommended instead."""
        nonlocal touching, damping
        delta, rate = place(now)
        if (delta > 0.0) == touching:
            return [0.0, -1.0]
        if abs(delta) > discontinuous.iterationTolerance:
            before, step = place(begin)[0], mbs.sys["dynamicSolver"].it.currentStepSize
            return [abs(delta), step * before / (before - delta) if before * delta < 0.0 else 0.25 * step]
        touching, damping = not touching, DAMPING / max(rate, SLOWEST)
        return [0.0, -1.0]

    system.SetPostNewtonUserFunction(after_newton)

    def run(steps: int, owner: Any = container) -> Array:  # kept alive by that
        nonlocal touching
        touching, integration.numberOfSteps = False, steps
        system.SolveDynamic(settings, solverType=exu.DynamicSolverType.TrapezoidalIndex2)
        (t, x), (_, v) = (system.GetSensorStoredData(sensor).T for sensor in sensors)
        new = np.diff(t, prepend=-1.0) > 0.0
        return np.asarray(CRANK + ROD + CubicHermiteSpline(t[new], x[new], v[new])(times(omega, 1)))

    return run


# --- measurements, each in a process of its own --------------------------------------------------------------------


def measure(rpm: float) -> dict[str, Any]:
    """Of all revolutions, and of the first one alone: median seconds per revolution of every contender, its largest error [m]."""
    own = {kind: tolerances for kind, tolerances in OWN.items() if kind != "compiled" or fast()}
    ways = {f"ours {kind} {tolerance:g}": ours(rpm, kind, tolerance) for kind in own for tolerance in own[kind]} | {
        f"{method} {tolerance:g}": partial(by_hand, rpm, method, tolerance)
        for method, tolerances in BY_HAND.items()
        for tolerance in tolerances
    }
    first = {f"ours {kind} {tolerance:g}": ours(rpm, kind, tolerance, 1) for kind in own for tolerance in own[kind]}
    if installed():
        model, usual = peer(rpm), bodies(rpm)
        ways |= {f"Exudyn {relative:g}, {absolute:g}": partial(model.run, (relative, absolute)) for relative, absolute in ITS}
        first |= {f"bodies {steps:,} steps": partial(usual, steps) for steps in STEPS}
    true = by_hand(rpm, "DOP853", TIGHT)

    def timed(ways: Mapping[str, Motion], revolutions: int, repetitions: int) -> dict[str, dict[str, float]]:
        errors = {name: float(np.max(np.abs(motion() - true[: revolutions * SAMPLES + 1]))) for name, motion in ways.items()}
        seconds = race(ways, repetitions, warm_up=0)
        return {"seconds": {name: taken / revolutions for name, taken in seconds.items()}, "errors": errors}

    gaps = {name: ours(rpm, "compiled", COMMON, problem=name) for name in (ONE_GAP, THREE_GAPS)} if fast() else {}
    taken = {name: seconds / REVOLUTIONS for name, seconds in race(gaps, REPETITIONS).items()}
    return {"all": timed(ways, REVOLUTIONS, REPETITIONS), "first": timed(first, 1, TURNS), "gaps": taken}


# --- comparison ----------------------------------------------------------------------------------------------------


def measured(rpm: float) -> dict[str, Any]:
    """The figures of a measurement."""
    done = child(str(ROOT / "benchmarks" / "clearance.py"), str(rpm))
    if done.returncode:
        raise RuntimeError(done.stderr)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def listed(seconds: Mapping[str, float], errors: Mapping[str, float], who: str) -> str:
    """Settings with times and errors."""
    return "; ".join(
        f"{way.removeprefix(who).strip()}: {1e3 * seconds[way]:.0f} ms, {errors[way]:.1e} m"
        for way in seconds
        if way.startswith(who)
    )


def chosen(seconds: Mapping[str, float], errors: Mapping[str, float], who: str) -> str:
    """The fastest of the accurate settings; if none are, the most accurate ones."""
    tried = [way for way in seconds if way.startswith(who)]
    accurate = [way for way in tried if errors[way] <= ACCURATE]
    return min(accurate, key=seconds.__getitem__) if accurate else min(tried, key=errors.__getitem__)


def told(seconds: float, error: float) -> str:
    return f"{1e3 * seconds:.1f} ms" + ("" if error <= ACCURATE else f" at {error:.0e} m")


HAND = "solve_ivp, two coordinates, plain floats, contact as an event; tolerance"
PEERS = {  # who -> name, how
    "Exudyn": (
        "Exudyn, tuned by hand",
        "its tree of joints, compiled user function, Dormand-Prince 5, steps redone at contact; relative, absolute tol.",
    ),
    "bodies": (
        "Exudyn, as its examples write it",
        "rigid bodies and joints, Python user function, TrapezoidalIndex2, steps repeated at contact by PostNewtonUserFunction",
    ),
    "DOP853": ("SciPy's DOP853 by hand", HAND),
    "LSODA": ("SciPy's LSODA by hand", HAND),
}


def rows() -> list[Row]:
    """Seconds per revolution against the fastest accurate settings of each peer; seconds of commands that simulate often."""
    return [row for rpm in SPEEDS for row in rows_at(rpm, measured(rpm))] + [command_row(text) for text in COMMANDS]


def command_row(text: str) -> Row:
    """Seconds of a whole process, once."""
    begin = time.perf_counter()
    done = child("-m", "optlink", *text.split())
    seconds, what = time.perf_counter() - begin, f"process: optlink {text}"
    if done.returncode:
        return Row(what, "failed", "", note=f"exit code {done.returncode}")
    return Row(what, f"{seconds:.1f} s", "", note="by the wall, once", figures={"ours": seconds})


def rows_at(rpm: float, found: Mapping[str, Any]) -> list[Row]:
    """One row per peer, and three gaps against one; times of inaccurate settings are shown with their error."""
    result = []
    for who, (name, how) in PEERS.items():
        part, over = ("first", "the first revolution") if who == "bodies" else ("all", f"{REVOLUTIONS} revolutions")
        seconds, errors = found[part]["seconds"], found[part]["errors"]
        own = chosen(seconds, errors, "ours")
        what = f"slider-crank with clearance, {rpm:g} rpm, friction {FRICTION:g}, time per revolution, against {name}"
        shown = told(seconds[own], errors[own])
        note = f"errors of the slider over {over}: ours (integrator, tolerance) {listed(seconds, errors, 'ours')}"
        figures = {"ours": seconds[own], "error": errors[own]}
        if not any(way.startswith(who) for way in seconds):
            result.append(Row(what, shown, "skipped", note=f"{note}; {ABSENT}", figures=figures))
            continue
        best = chosen(seconds, errors, who)
        theirs, miss = seconds[best], errors[best]
        note += f"; theirs ({how}) {listed(seconds, errors, who)}"
        figures |= {"theirs": theirs, "their_error": miss}
        ratio = theirs / seconds[own] if errors[own] <= max(ACCURATE, miss) else math.nan
        target = ">= 8" if who == "Exudyn" else ""
        result.append(Row(what, shown, told(theirs, miss), ratio, target, note, figures=figures))
    if found["gaps"]:
        one, three = found["gaps"][ONE_GAP], found["gaps"][THREE_GAPS]
        what = f"slider-crank with clearance in three joints, {rpm:g} rpm, time per revolution, against one joint"
        note = f"ours / ours with one gap (less is better), both compiled, tolerance {COMMON:g}"
        figures = {"ours": three, "theirs": one}
        shown = f"{1e3 * three:.1f} ms", f"{1e3 * one:.1f} ms"
        result.append(Row(what, *shown, three / one, "<= 4", note, figures=figures, kind=COST))
    return result


if __name__ == "__main__":
    sys.path.insert(0, os.fspath(ROOT))
    print("\n" + json.dumps(measure(float(sys.argv[1]))))
