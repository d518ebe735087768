"""Oracles for extensions: each compares what an extension adds with another route to the same figure.

Functions with a `tolerance` return the largest relative difference that they saw; all raise `Disagreement`, an AssertionError.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from optlink.errors import InputError
from optlink.linkage.vector2d import TURN, Array, minus, plus, turn, turn_back
from optlink.problem.document import Result
from optlink.problem.file import AnyProblem, problem_of

__all__ = [
    "Disagreement",
    "check_derivatives",
    "check_forces",
    "check_motion",
    "check_optimum",
    "check_prices",
    "check_stored",
]


def __dir__() -> list[str]:
    return __all__


STEP = 1e-5  # rad, and share of a design variable: cube root of the rounding error of central differences
NEAR = 0.02  # share by which designs differ at random from the start


class Disagreement(AssertionError):
    """Two routes to one figure do not agree."""


def _compared(what: str, one: Array, other: Array, tolerance: float, scale: float = 0.0) -> float:
    """Return the largest difference relative to the largest value, or to a larger `scale`."""
    size = max(float(np.max(np.abs(other), initial=0.0)), scale)
    gaps = np.abs(one - other)
    if not np.array_equal(np.isnan(one), np.isnan(other)):
        raise Disagreement(f"{what}: one route has a value where the other has none")
    error = float(np.nanmax(gaps, initial=0.0)) / size if size else 0.0
    if error > tolerance:
        at = np.unravel_index(int(np.nanargmax(gaps)), gaps.shape)
        raise Disagreement(
            f"{what}: {one[at]:.9g}, by the other route {other[at]:.9g} (difference {error:.2g}, {tolerance:g} allowed)"
        )
    return error


def check_motion(problem: AnyProblem, design: Mapping[str, float | str] | None = None, tolerance: float = 1e-6) -> float:
    """Compare velocities and accelerations of all points and bodies with differences of their positions: of a dyad.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        With a linkage that contains the dyad.
    design : mapping of str to float [SI] or str, optional
        Values of design variables. Default: their starting values.
    tolerance : float

    Raises
    ------
    Disagreement
    """
    from optlink.tasks.machine import check_design, machine_of

    problem = problem_of(problem)
    machine = machine_of(problem, check_design(problem, design))
    angles = np.linspace(0.0, TURN, 48, endpoint=False)
    before, moved, after = (machine.motion(angles + step) for step in (-STEP, 0.0, STEP))
    worst = 0.0
    for point in moved.pose.points:
        rate = (after.position(point) - before.position(point)) / (2.0 * STEP)
        change = (after.velocity(point) - before.velocity(point)) / (2.0 * STEP)
        inside = ~np.isnan(rate + change).any(axis=1)
        for what, one, other in (
            ("velocity", moved.velocity(point), rate),
            ("acceleration", moved.acceleration(point), change),
        ):
            scale = float(np.nanmax(np.abs(moved.position(point)), initial=0.0))
            worst = max(worst, _compared(f"{what} of {point}", one[inside], other[inside], tolerance, scale))
    for body in machine.mechanism.bodies:
        angle, earlier, later = (motion.body_angle(body) for motion in (moved, before, after))
        turned = np.angle(np.exp(1j * (later.value - earlier.value))) / (2.0 * STEP)
        inside = ~np.isnan(turned)
        rate = np.broadcast_to(angle.rate, angles.shape)
        worst = max(worst, _compared(f"angular velocity of {body}", rate[inside], turned[inside], tolerance, 1.0))
    return worst


def check_forces(problem: AnyProblem, design: Mapping[str, float | str] | None = None, tolerance: float = 1e-6) -> float:
    """Compare the driving torque, which follows from all joint reactions, with the slope of the energy: of a dyad or a load.

    Loads take up power at the velocities of differences of positions.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        A machine with masses or loads, without friction.
    design : mapping of str to float [SI] or str, optional
        Values of design variables. Default: their starting values.
    tolerance : float

    Raises
    ------
    Disagreement
    InputError
        If the machine has neither masses nor loads, or has friction.
    """
    from optlink.linkage.mechanism import FRAME
    from optlink.tasks.analyze import analyze
    from optlink.tasks.machine import check_design, machine_of

    problem = problem_of(problem)
    machine = machine_of(problem, check_design(problem, design))
    if machine.friction or not (machine.inertias or machine.loads):
        raise InputError("energies are compared for machines with masses or loads, without friction", "Give such a machine")
    cycle = analyze(problem, design=design)
    angles = cycle.positions

    now = machine.moving(angles, cycle.speed)
    acting = [one for load in machine.loads for one in load.act(now) if one.body != FRAME]

    def energy(at: Array) -> Array:
        moving = machine.moving(at, cycle.speed)
        return np.asarray(machine.kinetic(moving.state) + machine.weight(moving.state))

    def place(at: Array) -> list[Array]:
        """Return the places of the points of bodies on which loads act now, and the angles of these bodies."""
        moving, places = machine.moving(at, cycle.speed), []
        for one in acting:
            here, there = now.state(one.body), moving.state(one.body)
            arm = turn(turn_back(minus(one.point, here.start), here.axis), there.axis)
            places.append(np.stack(np.broadcast_arrays(*plus(there.start, arm), np.arctan2(*there.axis[::-1]))))
        return places

    slope = (energy(angles + STEP) - energy(angles - STEP)) / (2.0 * STEP)
    for one, later, earlier in zip(acting, place(angles + STEP), place(angles - STEP), strict=True):
        along, across, turned = later - earlier
        turned = np.angle(np.exp(1j * turned))
        slope = slope - (one.force[0] * along + one.force[1] * across + one.torque * turned) / (2.0 * STEP)
    return _compared("driving torque", cycle["input.torque_Nm"], slope, tolerance)


def check_derivatives(problem: AnyProblem, designs: int = 3, seed: int = 0, tolerance: float = 1e-5) -> float:
    """Compare the derivatives of the objective and of all limits with differences: of a quantity, a limit or a requirement.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        A design problem that uses it.
    designs : int
        Number of designs at random near the start.
    seed : int
    tolerance : float

    Raises
    ------
    Disagreement
    """
    from optlink.tasks.programme import build

    programme = build(problem).scaled()
    rng, worst = np.random.default_rng(seed), 0.0
    for _ in range(designs):
        shift = 1.0 + NEAR * rng.uniform(-1.0, 1.0, len(programme.x_start))
        x = np.clip(programme.x_start * shift, programme.x_low, programme.x_high)
        slopes = np.vstack([programme.gradient(x), programme.jacobian(x)])
        columns = []
        for step in STEP * np.eye(len(x)):
            low, high = (np.array([programme.f(at), *programme.g(at)]) for at in (x - step, x + step))
            columns.append((high - low) / (2.0 * STEP))
        names = ["objective", *(constraint.name for constraint in programme.constraints)]
        for name, exact, differences in zip(names, slopes, np.array(columns).T, strict=True):
            worst = max(worst, _compared(f"derivatives of {name}", exact, differences, tolerance, 1.0))
    return worst


def check_optimum(problem: AnyProblem, backend: str = "slsqp", tolerance: float = 1e-6) -> float:
    """Compare the optima of a back end with that of IPOPT, both validated: of a back end.

    Parameters
    ----------
    problem : ProblemFile, str or Path
    backend : str
    tolerance : float

    Raises
    ------
    Disagreement
    """
    from optlink.tasks.run import solve

    results = {name: solve(problem, name) for name in ("ipopt", backend)}
    for name, result in results.items():
        if not result.valid:
            raise Disagreement(f"{name} finds no valid design: {result.message}")
    one, other = (np.array([results[name].objective]) for name in (backend, "ipopt"))
    return _compared("objective", one, other, tolerance)


def check_prices(problem: AnyProblem, tolerance: float = 1e-3) -> float:
    """Compare the shadow price of every active limit with optima for a changed limit: of a limit.

    Parameters
    ----------
    problem : ProblemFile, str or Path
    tolerance : float

    Raises
    ------
    Disagreement
    """
    from optlink.studies.sensitivity import sensitivities

    gap = sensitivities(problem, check=True).gap
    if gap is not None and gap > tolerance:
        raise Disagreement(f"shadow prices differ by {gap:.2g} from optima for changed limits ({tolerance:g} allowed)")
    return gap or 0.0


def check_stored(result: Result) -> None:
    """Check that a result is read back as it was, that its files can be written, and that it has a page: of a view or a result.

    Parameters
    ----------
    result : any result

    Raises
    ------
    Disagreement
        If the document that is read back differs.
    """
    from optlink.presentation.interface import report
    from optlink.presentation.registry import read_result, view_of

    with TemporaryDirectory() as name:
        folder = Path(name)
        result.write(folder)
        again = read_result(folder)
        if type(again) is not type(result) or again.to_dict() != result.to_dict():
            one, other = (json.dumps(item.to_dict(), indent=1).splitlines() for item in (result, again))
            line = next((pair for pair in zip(one, other, strict=False) if pair[0] != pair[1]), ("", ""))
            raise Disagreement(f"the result reads back otherwise: {line[0].strip()} became {line[1].strip()}")
        if not view_of(result.kind).no_page:
            report(again, folder / "page.html")
