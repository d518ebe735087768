"""Clearance in a joint: a slider-crank with a gap between rod and slider, in time; against Exudyn, and SciPy by hand.

Crank at a given speed, clearance at the rod-slider pin, contact of Lankarani and Nikravesh, friction. Whoever tells the slider's
position to ACCURATE everywhere in the first REVOLUTIONS counts, with the fastest settings that do. What is true comes from the
motion by hand at a tight tolerance (`tests/gap_oracle.py`, in other coordinates, agrees with it to 0.1 nm).

Every speed runs in a process of its own (`python clearance.py RPM` prints its figures), as in `dynamics.py`.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
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
from timing import ROOT, Row, child, race

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
# Tolerances tried, loosest first. A contact that is only just missed, or not, decides between errors of nm and of um, so that
# looser ones may be accurate by luck; the fastest that is accurate counts all the same.
BY_HAND = {"DOP853": (1e-8, 1e-9, 1e-10), "LSODA": (1e-8, 1e-9)}
# (relative, absolute) of Exudyn's Dormand-Prince of order 5
ITS = ((1e-7, 1e-7), (1e-8, 1e-6), (1e-8, 1e-7), (3e-9, 1e-7), (1e-9, 1e-8))


def times(omega: float) -> Array:
    """When the slider is looked at."""
    return np.linspace(0.0, REVOLUTIONS * 2.0 * np.pi / omega, REVOLUTIONS * SAMPLES + 1)


def longest(omega: float) -> float:
    """Step that no contact is too short for."""
    return math.radians(1.0) / omega


def depth(t: float, state: Any, omega: float) -> tuple[float, float]:
    """Penetration and its rate from rod angle, slider position and their rates."""
    phi, x, turning, speed = state
    theta = omega * t
    ex, ey = CRANK * cos(theta) + ROD * cos(phi) - x, CRANK * sin(theta) + ROD * sin(phi)
    vx = -CRANK * omega * sin(theta) - ROD * turning * sin(phi) - speed
    vy = CRANK * omega * cos(theta) + ROD * turning * cos(phi)
    size = hypot(ex, ey)
    return size - GAP, (ex * vx + ey * vy) / size if size else hypot(vx, vy)


# --- ours ----------------------------------------------------------------------------------------------------------


def ours(rpm: float) -> Motion:
    """TO BE WRITTEN when the package simulates clearance: read the problem here, return what simulates and samples it."""
    raise NotImplementedError(rpm)


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


# --- Exudyn --------------------------------------------------------------------------------------------------------


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
    with a Python user function 1.5 times as long; fixed steps of RK44, DOPRI5, RK67 2.5 to 10 times as long. Bodies and joints
    with the implicit trapezoidal rule, v0 from the first step in contact, still miss by um at 100 times as long.
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


# --- measurements, each in a process of its own --------------------------------------------------------------------


def measure(rpm: float) -> dict[str, Any]:
    """Median seconds per revolution of every contender, and its largest error [m]; ours is missing while there is none."""
    ways: dict[str, Motion] = {
        f"{method} {tolerance:g}": partial(by_hand, rpm, method, tolerance)
        for method, tolerances in BY_HAND.items()
        for tolerance in tolerances
    }
    if installed():
        model = peer(rpm)
        ways |= {f"Exudyn {relative:g}, {absolute:g}": partial(model.run, (relative, absolute)) for relative, absolute in ITS}
    with contextlib.suppress(NotImplementedError):
        ways = {"ours": ours(rpm)} | ways
    true = by_hand(rpm, "DOP853", TIGHT)
    errors = {name: float(np.max(np.abs(motion() - true))) for name, motion in ways.items()}
    seconds = race(ways, REPETITIONS, warm_up=0)
    return {"seconds": {name: taken / REVOLUTIONS for name, taken in seconds.items()}, "errors": errors}


# --- comparison ----------------------------------------------------------------------------------------------------


def measured(rpm: float) -> dict[str, Any]:
    """The figures of a measurement."""
    done = child(str(ROOT / "benchmarks" / "clearance.py"), str(rpm))
    if done.returncode:
        raise RuntimeError(done.stderr)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def listed(seconds: Mapping[str, float], errors: Mapping[str, float], who: str) -> str:
    """Tolerances with times and errors."""
    return "; ".join(
        f"{name.removeprefix(who).strip()}: {1e3 * seconds[name]:.0f} ms, {errors[name]:.1e} m"
        for name in seconds
        if name.startswith(who)
    )


SCIPY = "solve_ivp, two coordinates, plain floats, contact as an event; tolerance"
PEERS = {
    "Exudyn": "its tree of joints, compiled user function, Dormand-Prince 5, steps redone at contact; relative, absolute tol.",
    "DOP853": SCIPY,
    "LSODA": SCIPY,
}


def rows() -> list[Row]:
    """Seconds per revolution, ours against the fastest accurate settings of each peer."""
    return [row for rpm in SPEEDS for row in rows_at(rpm, measured(rpm))]


def rows_at(rpm: float, found: Mapping[str, Mapping[str, float]]) -> list[Row]:
    """One row per peer."""
    seconds, errors = found["seconds"], found["errors"]
    own = seconds.get("ours", math.nan)
    shown = "-" if math.isnan(own) else f"{1e3 * own:.1f} ms"
    about = "no simulation yet" if math.isnan(own) else f"ours {errors['ours']:.1e} m"
    sound = errors.get("ours", math.inf) <= ACCURATE
    if not (sound or math.isnan(own)):
        about += ", NOT ACCURATE"
    result = []
    for who, how in PEERS.items():
        name = f"SciPy's {who} by hand" if who in BY_HAND else who
        what = f"slider-crank with clearance, {rpm:g} rpm, friction {FRICTION:g}, time per revolution, against {name}"
        tried = {way: taken for way, taken in seconds.items() if way.startswith(who)}
        accurate = [taken for way, taken in tried.items() if errors[way] <= ACCURATE]
        figures = {} if math.isnan(own) else {"ours": own, "error": errors["ours"]}
        if not tried:
            result.append(Row(what, shown, "skipped", note=f"{about}; {ABSENT}", figures=figures))
            continue
        note = f"errors of the slider over {REVOLUTIONS} revolutions: {about}; theirs ({how}): {listed(seconds, errors, who)}"
        if not accurate:
            note += f"; none within {ACCURATE:g} m"
        theirs = min(accurate, default=math.nan)
        figures |= {"theirs": theirs} if accurate else {}
        told = f"{1e3 * theirs:.1f} ms" if accurate else "not accurate"
        result.append(Row(what, shown, told, theirs / own if sound else math.nan, note=note, figures=figures))
    return result


if __name__ == "__main__":
    sys.path.insert(0, os.fspath(ROOT))
    print("\n" + json.dumps(measure(float(sys.argv[1]))))
