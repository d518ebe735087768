"""Optima of problems with two demands on one linkage, by formulas and searches of their own; numpy and scipy only.

Each function returns the optimum, and the figures of the design that has it. Lengths are in mm, angles in deg, torques in N m,
unless a name says otherwise.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import fsolve, least_squares, minimize, minimize_scalar, nnls

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

TURN = 2.0 * math.pi


@dataclass(frozen=True)
class Answer:
    """The optimal objective, and figures of the design by their names."""

    optimum: float
    figures: dict[str, float]


def third(p: Complex | complex, q: Complex | complex, a: float, b: float, side: float) -> Complex:
    """The corner of a triangle, a from p and b from q, to the left (+1) or right (-1) of p to q: cosine rule; or NaN."""
    line = np.asarray(q) - p
    c = np.abs(line)
    with np.errstate(invalid="ignore"):
        return np.asarray(p + a * line / c * np.exp(1j * side * np.arccos((a * a + c * c - b * b) / (2.0 * a * c))))


# --- a straight line with equal links --------------------------------------------------------------------------------------


def straight_line(span: float = 140.0) -> Answer:
    """Straightest line over a range of crank angles by a Hoecken linkage: coupler = rocker = extension of the coupler.

    Lengths are in cranks. The range lies symmetrically about the position where the crank points away from the rocker's pivot, so
    the line is parallel to the frame. The objective is the breadth of the curve over its travel; Nelder-Mead's method with frame
    and coupler, from three starts. Speed: the largest less the least, over the mean, of the velocity along the line.
    """
    half = math.radians(0.5 * span)
    phi = np.pi + np.linspace(-half, half, 4001)

    def curve(frame: float, coupler: float, turned: float = 0.0) -> Complex:
        b = np.exp(1j * (phi + turned))
        return 2.0 * third(b, complex(frame), coupler, coupler, 1.0) - b

    def breadth(x: Array) -> float:
        p = curve(*x)
        return float(np.ptp(p.imag) / abs(p.real[-1] - p.real[0]))

    precise = {"xatol": 1e-12, "fatol": 1e-16, "maxiter": 5000, "maxfev": 5000}
    found = [minimize(breadth, x, method="Nelder-Mead", options=precise) for x in ((2.5, 3.25), (2.0, 3.0), (3.0, 4.0))]
    best = min(found, key=lambda each: float(each.fun))
    p = curve(*best.x)
    speed = np.abs(curve(*best.x, 1e-5).real - curve(*best.x, -1e-5).real) / 2e-5
    figures = {"frame": float(best.x[0]), "coupler": float(best.x[1]), "travel": float(abs(p.real[-1] - p.real[0]))}
    return Answer(float(best.fun), figures | {"speed": float(np.ptp(speed) / np.mean(speed))})


# --- two wipers on one crank pin -------------------------------------------------------------------------------------------


def two_wipers(
    frames: tuple[float, float] = (400.0, 250.0),
    swings: tuple[float, float] = (90.0, 80.0),
    crank: tuple[float, float] = (60.0, 200.0),
) -> Answer:
    """Best worst transmission angle of two crank-rockers on one crank pin, each of a given swing and without quick return.

    Without quick return the dead centres of the pin C are in line with A: crank a = c sin(W/2), b^2 = a^2 + d^2 - c^2. The one
    unknown is the crank: a search over its bounds, of a grid and its refinement.
    """

    def bars(a: float, frame: float, swing: float) -> tuple[float, float]:
        rocker = a / math.sin(math.radians(0.5 * swing))
        return math.sqrt(a * a + frame * frame - rocker * rocker), rocker

    def least(a: float, frame: float, swing: float) -> float:
        coupler, rocker = bars(a, frame, swing)
        cosines = [(coupler**2 + rocker**2 - (frame + sign * a) ** 2) / (2.0 * coupler * rocker) for sign in (1.0, -1.0)]
        return min(min(angle, math.pi - angle) for angle in map(math.acos, cosines))

    def worst(a: float) -> float:
        try:
            return min(least(a, *each) for each in zip(frames, swings, strict=True))
        except ValueError:  # there is no such linkage
            return -math.inf

    best = max(np.linspace(*crank, 1401), key=worst)
    found = minimize_scalar(lambda a: -worst(a), bounds=(max(crank[0], best - 0.1), min(crank[1], best + 0.1)), method="bounded")
    best = max((float(best), float(found.x)), key=worst)
    figures = {"crank": best}
    for number, each in enumerate(zip(frames, swings, strict=True), 1):
        figures[f"coupler {number}"], figures[f"rocker {number}"] = bars(best, *each)
        figures[f"transmission {number}"] = math.degrees(least(best, *each))
    return Answer(math.degrees(worst(best)), figures)


# --- poses and a law -------------------------------------------------------------------------------------------------------

PLANTED = {"crank": 40.0, "coupler": 110.0, "rocker": 80.0, "frame": 120.0, "along": 60.0, "across": 35.0}


def poses_and_law() -> Answer:
    """Three poses of the coupler and six angles of the rocker of one four-bar, at prescribed crank angles: planted, so 0.

    The figures are the targets: place of P and angle of the coupler, angle of the rocker. That the planted lengths are the only
    optimum near them is shown by the least singular value of the residuals' derivatives.
    """
    posed, turned = np.radians([20.0, 75.0, 140.0]), np.radians([20.0, 60.0, 110.0, 180.0, 250.0, 300.0])

    def outputs(x: Array) -> Array:
        crank, coupler, rocker, frame, along, across = x
        b = crank * np.exp(1j * posed)
        unit = (third(b, frame, coupler, rocker, 1.0) - b) / coupler
        p = b + unit * complex(along, across)
        c = third(crank * np.exp(1j * turned), frame, coupler, rocker, 1.0)
        return np.concatenate([p.real, p.imag, np.degrees(np.angle(unit)), np.degrees(np.angle(c - frame))])

    planted = np.array(list(PLANTED.values()))
    targets = outputs(planted)
    slopes = np.column_stack([(outputs(planted + step) - outputs(planted - step)) / 2e-4 for step in 1e-4 * np.eye(6)])
    figures = {
        f"{name} {k + 1}": float(value)
        for name, row in zip(("x", "y", "angle"), targets[:9].reshape(3, 3), strict=True)
        for k, value in enumerate(row)
    }
    figures |= {f"rocker {k + 1}": float(value) for k, value in enumerate(targets[9:])}
    figures["least singular value"] = float(np.linalg.svd(slopes, compute_uv=False)[-1])
    found = least_squares(lambda x: outputs(x) - targets, planted * 1.05, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return Answer(float(2.0 * found.cost), figures)


# --- symmetric steering ----------------------------------------------------------------------------------------------------


def steering_trapezoid(track: float = 2400.0, base: float = 4800.0, arm: float = 400.0, outer: float = 0.6) -> Answer:
    """Least largest error [deg] of the second wheel of a symmetric steering trapezoid against Ackermann's condition.

    Both arms are inclined by beta to the direction of travel, so the tie rod is track - 2 arm sin(beta). The first wheel turns
    from the largest angle of the inner wheel on one side to that of the outer one on the other, whose tangent is `outer`. The
    largest error is that of 20,001 positions; the one unknown is beta: bounded minimisation about the best of a grid.
    """
    ratio = track / base
    most = math.atan(1.0 / (1.0 / outer - ratio))
    left = np.linspace(-most, math.atan(outer), 20001)
    wanted = np.arctan(
        np.tan(left) / (1.0 - ratio * np.tan(left))
    )  # cot(outer) - cot(inner) = track / base, turns of either sign

    def errors(beta: float) -> Array:
        rod = track - 2.0 * arm * math.sin(beta)
        arms = arm * np.exp(1j * (0.5 * math.pi - beta + left))
        c = third(arms, complex(track), rod, arm, 1.0)
        right = np.angle((c - track) * np.exp(-1j * (0.5 * math.pi + beta)))
        return np.asarray(right - wanted)

    def largest(beta: float) -> float:
        return float(np.max(np.nan_to_num(np.abs(errors(beta)), nan=math.inf)))

    grid = np.radians(np.arange(10.0, 30.0, 0.1))
    best = min(grid, key=largest)
    found = minimize_scalar(largest, bounds=(best - 2e-3, best + 2e-3), method="bounded", options={"xatol": 1e-12})
    beta = float(found.x)
    return Answer(
        math.degrees(found.fun),
        {"inner": math.degrees(most), "beta": math.degrees(beta), "tie rod": track - 2.0 * arm * math.sin(beta)},
    )


# --- a path as two edges ---------------------------------------------------------------------------------------------------


def path_of_two_edges() -> Answer:
    """A point must be on two edges at the same crank angles: |P - L|^2 + |P - R|^2 = 2 |P - M|^2 + |L - R|^2 / 2.

    M is the midpoint of a pair. The midpoints lie on the coupler curve of a planted four-bar, so the least sum of squares is half
    the squared distances of the pairs. It is reached by least squares of both edges from sizes that are up to 6 % wrong.
    """
    phi = np.radians([200.0, 215.0, 235.0, 250.0, 270.0, 285.0, 300.0, 320.0])

    def point(x: Array) -> Complex:
        crank, coupler, rocker, frame, along, across = x
        b = crank * np.exp(1j * phi)
        return np.asarray(b + (third(b, frame, coupler, rocker, 1.0) - b) / coupler * complex(along, across))

    planted = np.array(list(PLANTED.values()))
    half = np.linspace(2.0, 5.0, len(phi)) * np.exp(1j * np.linspace(1.0, 2.5, len(phi)))
    edges = point(planted) + half, point(planted) - half

    def residuals(x: Array) -> Array:
        gaps = np.concatenate([point(x) - edge for edge in edges])
        return np.concatenate([gaps.real, gaps.imag])

    start = planted * (1.0 + 0.06 * np.array([1.0, -1.0, 1.0, -0.5, 0.7, -0.8]))
    found = least_squares(residuals, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    figures = {"half the squared distances": 0.5 * float(np.sum(np.abs(edges[0] - edges[1]) ** 2))}
    for name, edge in zip("LR", edges, strict=True):
        figures |= {
            f"{name}{k + 1}.{axis}": float(value)
            for axis, row in (("x", edge.real), ("y", edge.imag))
            for k, value in enumerate(row)
        }
    return Answer(float(2.0 * found.cost), figures | dict(zip(PLANTED, map(float, found.x), strict=True)))


# --- a law or poses within a tolerance, then the smallest machine ----------------------------------------------------------


def smallest_machine(largest: float = 2.5, positions: int = 30) -> Answer:
    """Least coupler + rocker of a crank-rocker whose rocker follows a law within `largest` [deg].

    Crank 100, frame 500; psi = psi0 + 2 phi^2 / (3 pi) over a right angle from the outer dead centre, at even positions;
    transmission angle 45 ... 135 deg. SLSQP from the feasible positions of a grid; the grid itself has nothing less.
    """
    crank, frame = 100.0, 500.0
    offsets = np.arange(1, positions + 1) * (0.5 * math.pi / positions)

    def rows(x: Array) -> Array:
        """Not negative where coupler and rocker are admissible."""
        coupler, rocker = x
        reach = crank + coupler
        phi0 = np.arccos((reach**2 - rocker**2 + frame**2) / (2.0 * reach * frame))
        psi0 = np.arccos((reach**2 - rocker**2 - frame**2) / (2.0 * rocker * frame))
        b = crank * np.exp(1j * (phi0 + offsets))
        error = np.degrees(np.angle(third(b, frame, coupler, rocker, 1.0) - frame) - psi0 - 2.0 / (3.0 * math.pi) * offsets**2)
        double = 2.0 * coupler * rocker
        cosines = [(coupler**2 + rocker**2 - (frame + sign * crank) ** 2) / double for sign in (1.0, -1.0)]
        angles = math.sqrt(0.5)
        bars = (coupler + rocker - frame - crank, rocker + frame - crank - coupler, coupler + frame - crank - rocker)
        return np.concatenate(
            [largest - error, largest + error, [angles + cosines[0], angles - cosines[1]], np.array(bars) / 100.0]
        )

    with np.errstate(invalid="ignore"):
        grid = np.array(list(itertools.product(np.linspace(200.0, 900.0, 141), np.linspace(100.0, 600.0, 101))))
        feasible = [x for x in grid if np.min(np.nan_to_num(rows(x), nan=-1.0)) >= 0.0]
        ranked = sorted(feasible, key=lambda x: float(np.sum(x)))
        limits = {"type": "ineq", "fun": rows}
        found = [
            minimize(lambda x: float(np.sum(x)) / 100.0, x, method="SLSQP", constraints=limits, options={"ftol": 1e-13})
            for x in ranked[:: max(1, len(ranked) // 12)]
        ]
    best = min((each.x for each in found if np.min(rows(each.x)) >= -1e-9), key=lambda x: float(np.sum(x)))
    return Answer(
        float(np.sum(best)), {"coupler": float(best[0]), "rocker": float(best[1]), "least of the grid": float(np.sum(ranked[0]))}
    )


def smallest_machine_of_swing(swing: float, ratio: float = 1.0, largest: float = 2.5, positions: int = 1000) -> Answer:
    """Least crank + coupler + rocker of the law of `smallest_machine` with a free crank, a largest swing and a time ratio.

    The rocker swings by at most `swing` [deg]; its slow stroke takes at least `ratio` times as long as the quick one. Both follow
    from the triangles of the dead centres. Crank 50 ... 200, rocker at least 100. SLSQP from random admissible linkages.
    """
    frame, offsets = 500.0, np.linspace(0.0, 0.5 * math.pi, positions)

    def rows(x: Array) -> Array:
        crank, coupler, rocker = x
        at_d, at_a = [], []
        for reach in (coupler + crank, coupler - crank):
            at_d.append(np.arccos((frame**2 + rocker**2 - reach**2) / (2.0 * frame * rocker)))
            at_a.append(np.arccos((frame**2 + reach**2 - rocker**2) / (2.0 * frame * reach)))
        turned = math.pi + at_a[1] - at_a[0]  # of the crank from the outer dead centre to the inner one
        b = crank * np.exp(1j * (at_a[0] + offsets))
        psi = np.angle(third(b, frame, coupler, rocker, 1.0) - frame)
        error = np.degrees(psi - (math.pi - at_d[0]) - 2.0 / (3.0 * math.pi) * offsets**2)
        double = 2.0 * coupler * rocker
        cosines = [(coupler**2 + rocker**2 - (frame + sign * crank) ** 2) / double for sign in (1.0, -1.0)]
        angles = math.sqrt(0.5)
        bars = (coupler + rocker - frame - crank, rocker + frame - crank - coupler, coupler + frame - crank - rocker)
        slow = max(turned, TURN - turned)
        strokes = (swing - math.degrees(at_d[0] - at_d[1])) / 10.0, slow / (TURN - slow) - ratio
        admissible = [angles + cosines[0], angles - cosines[1], *strokes, *np.array(bars) / 100.0]
        return np.concatenate([largest - error, largest + error, admissible])

    bounds, rng, best = [(50.0, 200.0), (100.0, 900.0), (100.0, 900.0)], np.random.default_rng(0), np.full(3, math.inf)
    limits = {"type": "ineq", "fun": lambda u: rows(u * 100.0)}
    with np.errstate(all="ignore"):
        for start in rng.uniform(*np.transpose(bounds), (4000, 3)):
            if np.min(np.nan_to_num(rows(start)[2 * positions :], nan=-1.0)) < 0.0:
                continue
            scaled = [(low / 100.0, high / 100.0) for low, high in bounds]
            found = minimize(np.sum, start / 100.0, method="SLSQP", bounds=scaled, constraints=limits, options={"ftol": 1e-13})
            x = 100.0 * found.x
            if np.sum(x) < np.sum(best) and np.min(np.nan_to_num(rows(x), nan=-1.0)) > -1e-7:
                best = x
    return Answer(float(np.sum(best)), dict(zip(("crank", "coupler", "rocker"), map(float, best), strict=True)))


# --- a law, a stroke and a force that acts in one stroke -------------------------------------------------------------------


def slider_crank_against_a_force(
    measure: str = "peak",
    places: Sequence[float] = (0.0, 1.0),
    forces: Sequence[float] = (1000.0, 1000.0),
    mass: float = 0.0,
    positions: int = 7200,
) -> Answer:
    """Least torque [N m], peak or rms, of an offset slider-crank that moves its slider against a force on the way out only.

    The force [N] is linear between `places` [mm] of the slide and constant beyond them; with the force of inertia of the slider
    [kg] at one revolution per second it is multiplied by the derivative of the slide by the crank angle. Over a quarter turn the
    slider returns by 40 mm at constant speed within 3 mm; its stroke is 60 mm, its way back takes at least 1.1 times as long. Rod
    and guide stay 30 deg from the position where the assembly modes meet. SLSQP from random starts.
    """
    offsets, phi = np.linspace(0.0, 0.5 * math.pi, 1001), np.linspace(0.0, TURN, positions + 1)

    def slide(x: Array, at: Array) -> Array:
        return np.asarray(x[0] * np.cos(at) + np.sqrt(x[1] ** 2 - (x[0] * np.sin(at) - x[2]) ** 2))

    def rate(x: Array, at: Array) -> Array:
        u = x[0] * np.sin(at) - x[2]
        return np.asarray(-x[0] * np.sin(at) - u * x[0] * np.cos(at) / np.sqrt(x[1] ** 2 - u**2))

    def torques(x: Array) -> Array:
        moved, bent = rate(x, phi), (rate(x, phi + 1e-5) - rate(x, phi - 1e-5)) / 2e-5
        against = np.interp(slide(x, phi), places, forces) * np.maximum(moved, 0.0)
        return np.asarray(1e-3 * against + mass * TURN**2 * 1e-6 * moved * bent)

    def strokes(x: Array) -> tuple[float, float]:
        """Stroke, and crank rotation of the way back over that of the way out."""
        crank, rod, offset, _ = x
        out, back = rod + crank, rod - crank
        turned = math.pi + np.arcsin(offset / back) - np.arcsin(offset / out)
        return float(np.sqrt(out**2 - offset**2) - np.sqrt(back**2 - offset**2)), float(turned / (TURN - turned))

    def rows(x: Array) -> Array:
        gap = slide(x, x[3] + offsets) + 80.0 * offsets / math.pi
        away = math.cos(math.radians(30.0)) * x[1] - x[0] - x[2]
        return np.array([2.0 - np.ptp(gap) / 3.0, strokes(x)[1] - 1.1, away / x[1]])

    def cost(x: Array) -> float:
        """The largest torque is the vertex of the parabola through the largest of the grid and its neighbours."""
        size = np.abs(torques(x))
        if measure == "rms":
            return float(np.sqrt(np.mean(size[:-1] ** 2)))
        k = int(np.argmax(size[1:-1])) + 1
        a, b, c = size[k - 1 : k + 2]
        return float(b + (a - c) ** 2 / (8.0 * max(2.0 * b - a - c, 1e-12)))

    rng, best = np.random.default_rng(0), (math.inf, np.zeros(4))
    limits = [{"type": "ineq", "fun": rows}, {"type": "eq", "fun": lambda x: 0.1 * (strokes(x)[0] - 60.0)}]
    bounds = [(5.0, 100.0), (20.0, 300.0), (0.0, 40.0), (-3.0, 3.0)]
    with np.errstate(all="ignore"):
        for start in rng.uniform([20.0, 45.0, 0.0, 0.0], [40.0, 300.0, 40.0, 1.5], (40, 4)):
            if not np.all(np.isfinite(rows(start))):
                continue
            options = {"ftol": 1e-14, "maxiter": 500}
            x = minimize(lambda x: cost(x) / 30.0, start, method="SLSQP", bounds=bounds, constraints=limits, options=options).x
            met = np.min(np.nan_to_num(rows(x), nan=-1.0)) > -1e-8 and abs(strokes(x)[0] - 60.0) < 1e-6
            best = min(best, (cost(x) if met else math.inf, x), key=lambda one: one[0])
    return Answer(best[0], dict(zip(("crank", "rod", "offset"), map(float, best[1]), strict=False)))


FIVE_POSES = np.array(
    [
        (-5.025718345067, -2.774688418545, -34.571665970772),
        (-4.045110023497, -3.042128078578, -33.730843998759),
        (4.275880282646, -3.078102916333, -27.008428753130),
        (12.815844621983, 0.676640108429, -20.578458235293),
        (14.082863383722, 1.605617520889, -19.678086950757),
    ]
)
"""Place of the point and angle of the body, mm and deg."""


@functools.cache
def dyads_of_poses() -> tuple[tuple[complex, complex], ...]:
    """Every link of constant length from a pin of the body (in its axes) to a pivot, for five poses: Burmester's problem.

    The four differences of the squared lengths are solved from 4000 random starts.
    """
    places, turns = FIVE_POSES[:, 0] + 1j * FIVE_POSES[:, 1], np.exp(1j * np.radians(FIVE_POSES[:, 2]))

    def differences(x: Array) -> Array:
        squares = np.abs(places + turns * complex(x[0], x[1]) - complex(x[2], x[3])) ** 2
        return np.asarray(squares[1:] - squares[0])

    rng, found = np.random.default_rng(0), list[Array]()
    for start in rng.uniform(-150.0, 150.0, (4000, 4)):
        x, _, ended, _ = fsolve(differences, start, full_output=True, xtol=1e-13)
        solved = ended == 1 and np.max(np.abs(differences(x))) < 1e-7 and np.max(np.abs(x)) < 1e4
        if solved and not any(np.max(np.abs(x - other)) < 1e-4 for other in found):
            found.append(x)
    return tuple((complex(x[0], x[1]), complex(x[2], x[3])) for x in found)


def four_bars_of_poses() -> Iterator[dict[str, float]]:
    """The crank-rockers of two such links that take the poses in order on one circuit; least transmission angle [deg]."""
    places, turns = FIVE_POSES[:, 0] + 1j * FIVE_POSES[:, 1], np.exp(1j * np.radians(FIVE_POSES[:, 2]))
    for (pin, pivot), (other, end) in itertools.permutations(dyads_of_poses(), 2):
        b, c = places + turns * pin, places + turns * other
        crank, coupler, rocker, frame = bars = abs(b[0] - pivot), abs(pin - other), abs(c[0] - end), abs(pivot - end)
        sides = np.sign(((c - b) * np.conj(end - b)).imag)
        steps = np.diff(np.unwrap(np.angle((b - pivot) / (end - pivot))))
        if crank > min(bars) or 2.0 * (crank + max(bars)) > sum(bars) or np.ptp(sides) or np.ptp(np.sign(steps)):
            continue
        cosines = [(coupler**2 + rocker**2 - (frame + sign * crank) ** 2) / (2.0 * coupler * rocker) for sign in (1.0, -1.0)]
        least = min(min(angle, math.pi - angle) for angle in map(math.acos, cosines))
        names = ("crank", "coupler", "rocker", "frame")
        yield {
            **dict(zip(names, map(float, bars), strict=True)),
            "longest": float(max(bars)),
            "transmission": math.degrees(least),
        }


def smallest_of_exact_poses(least: float = 5.0) -> Answer:
    """Shortest longest link of the four-bars that take five poses exactly, with a transmission angle of at least `least` [deg].

    All pairs of the links of `dyads_of_poses`; four of them move through the poses.
    """
    designs = [design for design in four_bars_of_poses() if design["transmission"] >= least]
    best = min(designs, key=lambda design: design["longest"])
    return Answer(best["longest"], best | {"designs": float(len(designs))})


# --- a path and the peak torque --------------------------------------------------------------------------------------------

POINTS, SPEED, GRAVITY = 36, 8.0 * math.pi, 9.81  # of the bean; rad/s, m/s^2
MASSES = (0.5, 1.0, 0.8)  # kg: crank, coupler and rocker, uniform bars
LEAST_TRANSMISSION = math.radians(30.0)
PATH_OPTIMUM = np.array([20.074908, 41.677021, 190.672811, 200.0, 121.60453, -18.352097, 0.87658, 115.067758, -207.742823])
"""Where the searches of the bean begin: crank, coupler, rocker, frame, along, across, A.x, A.y [mm], direction [rad / 1000]."""
PATH_SQUARES = 6.87692799e-7
"""Its sum of squares [m^2]."""
LOW = np.array([5.0] * 4 + [-200.0] * 4 + [-1000.0 * math.pi]) * 1e-3
HIGH = np.array([200.0] * 8 + [1000.0 * math.pi]) * 1e-3
SIZE = np.array([0.1] * 8 + [1.0])
COMPLEX_STEP = 1e-30
Motion = tuple[Array, Array, Array, Array, Array, Array]


def bean() -> Complex:
    """Points of the bean [m]."""
    t = np.linspace(0.0, TURN, POINTS, endpoint=False)
    return 0.040 * np.cos(t) + 1j * (0.020 * np.sin(t) + 0.008 * np.cos(2.0 * t))


def _motion(x: Array, phi: Array) -> Motion:
    """Cosine and sine of crank, coupler and rocker from the frame; C lies to the right of B to D. Analytic in x and phi."""
    crank, coupler, rocker, frame = x[:4]
    cf, sf = np.cos(phi), np.sin(phi)
    wx, wy = frame - crank * cf, -crank * sf
    long = np.sqrt(wx * wx + wy * wy)
    k = (coupler * coupler + long * long - rocker * rocker) / (2.0 * coupler * long)
    s = -np.sqrt(1.0 - k * k)
    ct, st = (wx * k - wy * s) / long, (wy * k + wx * s) / long
    return cf, sf, ct, st, (crank * cf + coupler * ct - frame) / rocker, (crank * sf + coupler * st) / rocker


def _point(x: Array, phi: Array) -> tuple[Array, Array]:
    cf, sf, ct, st, _, _ = _motion(x, phi)
    along, across = x[0] * cf + x[4] * ct - x[5] * st, x[0] * sf + x[4] * st + x[5] * ct
    c, s = np.cos(x[8]), np.sin(x[8])
    return x[6] + c * along - s * across, x[7] + s * along + c * across


def driving_torque(x: Array, phi: Array, opposing: float = 0.0) -> Array:
    """Torque of the crank [N m]: derivative of the kinetic and potential energy by the crank angle, at constant speed.

    `opposing`: torque [N m] against the rocker while it turns as the crank does; negative for a crank that turns clockwise.
    """
    cf, sf, ct, st, cp, sp = _motion(x, phi)
    crank, coupler, rocker, _ = x[:4]
    s_tp, c_tp, s_fp, c_fp = st * cp - ct * sp, ct * cp + st * sp, sf * cp - cf * sp, cf * cp + sf * sp
    t1, p1 = -crank * s_fp / (coupler * s_tp), -crank * (sf * ct - cf * st) / (rocker * s_tp)  # rates of coupler and rocker
    t2 = (rocker * p1 * p1 - crank * c_fp - coupler * t1 * t1 * c_tp) / (coupler * s_tp)
    p2 = (-crank * s_fp + coupler * t2 * c_tp - coupler * t1 * t1 * s_tp) / rocker
    half = 0.5 * coupler
    v = (-crank * sf - half * t1 * st, crank * cf + half * t1 * ct)  # of the middle of the coupler
    w = (-crank * cf - half * (t2 * st + t1 * t1 * ct), -crank * sf + half * (t2 * ct - t1 * t1 * st))
    of_crank, of_coupler, of_rocker = MASSES
    kinetic = (
        of_coupler * (v[0] * w[0] + v[1] * w[1] + coupler * coupler / 12.0 * t1 * t2)
        + of_rocker * rocker * rocker / 3.0 * p1 * p2
    )
    c, s = np.cos(x[8]), np.sin(x[8])
    lift = of_crank * 0.5 * crank * (c * cf - s * sf) + of_coupler * (s * v[0] + c * v[1])
    lift = lift + of_rocker * 0.5 * rocker * p1 * (c * cp - s * sp)
    return np.asarray(SPEED**2 * kinetic + GRAVITY * lift + opposing * np.where(p1.real > 0.0, p1, 0.0))


def _refined(function: Callable[[Array], Array], phi: Array) -> Array:
    """Places of local extremes near crank angles: Newton's method by differences."""
    h = 1e-4
    for _ in range(5):
        below, at, above = function(phi - h), function(phi), function(phi + h)
        bend = above - 2.0 * at + below
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.where(bend == 0.0, 0.0, 0.5 * h * (above - below) / bend)
        phi = phi - np.clip(step, -0.01, 0.01)
    return phi


GRID = np.linspace(0.0, TURN, 1440, endpoint=False)


def _squares(x: Array, phi: Array, wanted: Complex) -> Array:
    px, py = _point(x, phi)
    return np.asarray((px - wanted.real) ** 2 + (py - wanted.imag) ** 2)


def nearest_angles(x: Array) -> Array:
    """Crank angle at which P is nearest to each point of the bean."""
    wanted = bean()
    phi = GRID[np.argmin(_squares(x, GRID, wanted[:, None]), axis=1)]
    return _refined(lambda f: _squares(x, f, wanted), phi)


def distances(x: Array) -> Array:
    """Distance of each point of the bean from the curve [m]."""
    return np.sqrt(_squares(x, nearest_angles(x), bean()))


def peaks(x: Array, opposing: float = 0.0) -> Array:
    """Crank angles of the local maxima of the magnitude of the torque."""
    size = np.abs(driving_torque(x, GRID, opposing))
    at = GRID[(size >= np.roll(size, 1)) & (size >= np.roll(size, -1))]
    return _refined(lambda f: driving_torque(x, f, opposing), at)


def peak_torque(x: Array, opposing: float = 0.0) -> float:
    """Largest magnitude of the torque over the revolution [N m]."""
    return float(np.max(np.abs(driving_torque(x, np.concatenate([GRID, peaks(x, opposing)]), opposing))))


def _slopes(function: Callable[[Array], Array], x: Array) -> Array:
    """Derivatives (rows, 9) by the scaled dimensions: complex step."""
    return np.asarray(function((x[:, None] + 1j * COMPLEX_STEP * np.diag(SIZE))[:, None, :]).imag / COMPLEX_STEP)


def _bars(x: Array) -> Array:
    """Not negative for a crank-rocker with a transmission angle of 30 ... 150 deg."""
    crank, coupler, rocker, frame = x[:4]
    spare = (coupler - crank, rocker - crank, frame - crank, frame + coupler - crank - rocker)
    spare += (frame + rocker - crank - coupler, coupler + rocker - crank - frame)
    cosines = [(coupler**2 + rocker**2 - (frame + sign * crank) ** 2) / (2.0 * coupler * rocker) for sign in (1.0, -1.0)]
    most = math.cos(LEAST_TRANSMISSION)
    return np.array([*(each / 0.1 for each in spare), most + cosines[0], most - cosines[0], most + cosines[1], most - cosines[1]])


def _optimum(start: Array, torque: float | None, distance: float | None, measure: str, opposing: float = 0.0) -> Array:
    """The design near a start with the least sum of squares within a torque, or the least peak torque within a distance.

    The bean and gravity are symmetric about the vertical, so one assembly mode stands for both; the sense of the crank does not
    matter to the peak. SLSQP with the nine dimensions and the level of the torque. The crank angle of each point is the nearest
    one, so its derivative does not count; the torque is kept below its level at 120 crank angles and at its maxima, which move.
    """
    wanted, nodes, x = bean(), np.linspace(0.0, TURN, 120, endpoint=False), start
    whole = peak_torque(start, opposing)
    level = whole if torque is None else torque
    for _ in range(12):
        before, scale = peaks(x, opposing), max(float(np.sum(distances(x) ** 2)), 1e-7)

        def places(x: Array, before: Array = before) -> Array:
            return np.concatenate([nodes, _refined(lambda f: driving_torque(x, f, opposing), before)])

        def rows(u: Array) -> Array:
            x = u[:9] * SIZE
            turning = driving_torque(x, places(x), opposing) / whole
            return np.concatenate([u[9] - turning, u[9] + turning, _bars(x), _near(distances(x) ** 2, distance, measure)])

        def row_slopes(u: Array) -> Array:
            x = u[:9] * SIZE
            at = places(x)
            turning = _slopes(lambda z: driving_torque(z, at[:, None], opposing), x) / whole
            squares = _slopes(lambda z: _squares(z, nearest_angles(x)[:, None], wanted[:, None]), x)
            bars = _slopes(lambda z: _bars(z)[:, 0], x)
            by_x = np.concatenate([-turning, turning, bars, _near(squares, distance, measure, slope=True)])
            by_level = np.zeros(len(by_x))
            by_level[: 2 * len(at)] = 1.0
            return np.column_stack([by_x, by_level])

        def cost(u: Array, scale: float = scale) -> float:
            return float(u[9]) if torque is None else float(np.sum(distances(u[:9] * SIZE) ** 2)) / scale

        def cost_slopes(u: Array, scale: float = scale) -> Array:
            if torque is None:
                return np.eye(10)[9]
            x = u[:9] * SIZE
            squares = _slopes(lambda z: _squares(z, nearest_angles(x)[:, None], wanted[:, None]), x)
            return np.append(np.sum(squares, axis=0) / scale, 0.0)

        fixed = (0.0, 10.0) if torque is None else (torque / whole, torque / whole)
        bounds = [*zip(LOW / SIZE, HIGH / SIZE, strict=True), fixed]
        limits = {"type": "ineq", "fun": rows, "jac": row_slopes}
        with np.errstate(all="ignore"):
            found = minimize(
                cost,
                np.append(x / SIZE, level / whole),
                jac=cost_slopes,
                method="SLSQP",
                bounds=bounds,
                constraints=limits,
                options={"maxiter": 300, "ftol": 1e-13},
            )
        moved = float(np.max(np.abs(found.x[:9] - x / SIZE)))
        x, level = found.x[:9] * SIZE, float(found.x[9]) * whole
        if not np.all(np.isfinite(x)) or moved < 1e-9:
            break
    return x


def _near(squares: Array, distance: float | None, measure: str, *, slope: bool = False) -> Array:
    """Rows of the distances, not negative within the tolerance: of their mean square, or of each."""
    if distance is None:
        return squares[:0]
    within = (np.mean(squares, axis=0, keepdims=True) if measure == "rms" else squares) / distance**2
    return np.asarray(-within if slope else 1.0 - within)


def _best(torque: float | None, distance: float | None, measure: str, starts: int, opposing: float = 0.0) -> Array:
    """The best feasible design from the path's optimum and from random changes of it."""
    first = PATH_OPTIMUM * np.array([1e-3] * 9)
    rng, designs = np.random.default_rng(0), list[Array]()
    for number in range(starts):
        factors = np.exp(0.25 * rng.normal(size=9)) if number else np.ones(9)
        x = np.clip(first * factors, LOW, HIGH)
        with np.errstate(all="ignore"):
            if np.min(_bars(x)) < 0.0 or not np.all(np.isfinite(distances(x))):
                continue
            x = _optimum(x, torque, distance, measure, opposing)
            fine = np.all(np.isfinite(x)) and np.min(_bars(x)) > -1e-8
            if not fine or not math.isfinite(peak_torque(x, opposing)):
                continue
            met = torque is None or peak_torque(x, opposing) <= torque * (1.0 + 1e-7)
            near = distance is None or np.min(_near(distances(x) ** 2, distance, measure)) >= -1e-7
        if met and near:
            designs.append(x)
    return min(designs, key=lambda x: float(np.sum(distances(x) ** 2)) if torque is not None else peak_torque(x, opposing))


def _figures(x: Array) -> dict[str, float]:
    names = ("crank", "coupler", "rocker", "frame", "along", "across", "A.x", "A.y")
    figures = {name: 1e3 * float(value) for name, value in zip(names, x, strict=False)} | {"direction": math.degrees(x[8])}
    gaps = distances(x)
    return figures | {
        "rms": 1e3 * float(np.sqrt(np.mean(gaps**2))),
        "largest": 1e3 * float(np.max(gaps)),
        "peak torque": peak_torque(x),
    }


def path_alone() -> Answer:
    """Least sum of squares [m^2] of the bean without a limit on the torque."""
    x = _best(100.0, None, "rms", 1)
    return Answer(float(np.sum(distances(x) ** 2)), _figures(x))


def path_within_torque(torque: float, starts: int = 12) -> Answer:
    """Least sum of squares [m^2] of the bean, by a crank whose peak torque is limited [N m]."""
    x = _best(torque, None, "rms", starts)
    return Answer(float(np.sum(distances(x) ** 2)), _figures(x))


def least_torque(distance: float, measure: str = "max", starts: int = 12, opposing: float = 0.0) -> Answer:
    """Least peak torque [N m] of a crank whose coupler point follows the bean within a distance [mm]: its rms, or the largest.

    `opposing`: see `driving_torque`.
    """
    x = _best(None, 1e-3 * distance, measure, starts, opposing)
    return Answer(peak_torque(x, opposing), _figures(x))


# --- a path between two obstacles --------------------------------------------------------------------------------------------


def clearances(x: Array, phi: Array, *, bottom: bool = True) -> Array:
    """Rows (2, n) [m] of what is left of the distances: 3 mm from a shaft of 10 mm at (0, 24), and 2 mm from y = -29."""
    px, py = _point(x, phi)
    return np.array([np.sqrt(px * px + (py - 0.024) ** 2) - 0.013, *[py + 0.027][: 1 * bottom]])


def least_clearances(x: Array) -> Array:
    """The least of every row of `clearances` over a revolution [m], at 40,000 crank angles."""
    return np.min(clearances(x, np.linspace(0.0, TURN, 40_000)), axis=1)


def path_in_trough(starts: int = 12, *, bottom: bool = True) -> Answer:
    """Least sum of squares [m^2] of the bean by a point that keeps clear of the shaft, and of the bottom.

    Gauss-Newton steps within a trust region from the optimum of the path and from random changes of it, with the clearances at
    their local minima, which move; then the conditions of Karush, Kuhn and Tucker of the rows that are active are solved by
    Powell's method. Bean, shaft and bottom are symmetric about the vertical, so one assembly mode stands for both. Dimensions are
    scaled by `SIZE`; lengths, and the two quantities of the conditions, in mm.
    """
    kept = functools.partial(clearances, bottom=bottom)
    wanted, low, high = bean(), LOW / SIZE, HIGH / SIZE

    def places(u: Array, near: list[Array] | None = None) -> list[Array]:
        """Local minima of each row: all of them, or those near other ones."""
        rows = kept(u * SIZE, GRID)
        near = near or [GRID[(row <= np.roll(row, 1)) & (row <= np.roll(row, -1))] for row in rows]
        return [_refined(lambda f, j=j: kept(u * SIZE, f)[j], at) for j, at in enumerate(near)]

    def limits(u: Array, near: list[Array]) -> tuple[Array, Array]:
        """What is left of the clearances, of the bars and of the bounds, and its derivatives."""
        x, at = u * SIZE, places(u, near)
        rows = [kept(x, each)[j] for j, each in enumerate(at)]
        slopes = [_slopes(lambda z, j=j: kept(z, at[j][:, None])[j], x) for j in range(len(at))]
        bars = 100.0 * _bars(x), 100.0 * _slopes(lambda z: _bars(z)[:, 0], x)
        ends = 100.0 * (u - low), 100.0 * (high - u)
        return np.concatenate([*(1e3 * row for row in rows), bars[0], *ends]), np.concatenate(
            [*(1e3 * slope for slope in slopes), bars[1], 100.0 * np.eye(9), -100.0 * np.eye(9)]
        )

    def errors(u: Array) -> tuple[Array, Array]:
        """Distances along the normals of the curve at the nearest points, and their derivatives."""
        x = u * SIZE
        at = nearest_angles(x)
        (p, q), (r, s) = (_point(x, at + h) for h in (1e-5, -1e-5))
        normal = np.array([s - q, p - r]) / np.hypot(p - r, q - s)
        away = np.array(_point(x, at)) - np.array([wanted.real, wanted.imag])
        slopes = [_slopes(lambda z, k=k: _point(z, at[:, None])[k], x) for k in range(2)]
        return 1e3 * np.sum(normal * away, axis=0), 1e3 * (normal[0][:, None] * slopes[0] + normal[1][:, None] * slopes[1])

    def merit(u: Array) -> float:
        worst = float(np.max(-limits(u, places(u))[0], initial=0.0))
        return float(np.sum(errors(u)[0] ** 2)) + 50.0 * worst if math.isfinite(worst) else math.inf

    def step(u: Array, reach: float) -> Array:
        near = places(u)
        (error, slope), (now, rows), moved = errors(u), limits(u, near), np.zeros(9)
        for _ in range(2):  # again with the limits where the first step leads
            if not all(np.all(np.isfinite(each)) for each in (now, rows, error, slope)):
                break
            found = minimize(
                lambda d: 0.5 * float(np.sum((error + slope @ d) ** 2)),
                moved,
                jac=lambda d: slope.T @ (error + slope @ d),
                method="SLSQP",
                bounds=[(-reach, reach)] * 9,
                constraints={"type": "ineq", "fun": lambda d, now=now: now + rows @ d, "jac": lambda _: rows},
                options={"maxiter": 100, "ftol": 1e-13},
            )
            moved = np.asarray(found.x)
            now = limits(u + moved, near)[0] - rows @ moved
        return moved

    def stationary(u: Array) -> Array:
        """The design that fulfils the conditions with the rows that are active here."""
        near = places(u)
        error, slope = errors(u)
        now, rows = limits(u, near)
        active = np.flatnonzero(now < 0.05)
        prices = nnls(rows[active].T, 2.0 * slope.T @ error)[0]
        active, prices = active[prices > 0.0], prices[prices > 0.0]

        def conditions(y: Array) -> Array:
            error, slope = errors(y[:9])
            now, rows = limits(y[:9], near)
            return np.concatenate([2.0 * slope.T @ error - y[9:] @ rows[active], now[active]])

        y = fsolve(conditions, np.concatenate([u, prices]), full_output=True, xtol=1e-12)[0]
        met = np.max(np.abs(conditions(y))) < 1e-6  # the solver may see no progress beyond rounding
        return np.asarray(y[:9] if met and np.min(y[9:], initial=0.0) >= 0.0 else u)

    rng, designs = np.random.default_rng(0), list[Array]()
    for number in range(starts):
        u = np.clip(PATH_OPTIMUM * 1e-3 * (np.exp(0.25 * rng.normal(size=9)) if number else 1.0) / SIZE, low, high)
        with np.errstate(all="ignore"):
            if np.min(_bars(u * SIZE)) < 0.0 or not math.isfinite(best := merit(u)):
                continue
            reach = 0.1
            for _ in range(60):
                moved = np.clip(u + step(u, reach), low, high)
                if (value := merit(moved)) < best:
                    u, best, reach = moved, value, min(2.0 * reach, 0.3)
                else:
                    reach *= 0.25
                if reach < 1e-6:
                    break
            u = stationary(u)
            if np.min(limits(u, places(u))[0]) > -1e-6:
                designs.append(u * SIZE)
    found = min(designs, key=lambda x: float(np.sum(distances(x) ** 2)))
    names = ("crank", "coupler", "rocker", "frame", "along", "across", "A.x", "A.y")
    figures = {name: 1e3 * float(value) for name, value in zip(names, found, strict=False)}
    return Answer(float(np.sum(distances(found) ** 2)), figures | {"designs": float(len(designs))})
