"""Random problems of all kinds as files state them, and what is known of their optima; numpy and scipy only.

Lengths are in mm, angles in rad; everything random comes from the number of the problem. Most problems are planted: a random
linkage gives the targets, sometimes with noise, and the limits leave room for it, so its objective bounds the optimum from above.
Others have their optimum from a search over a family in closed form, or are impossible. The judge of a problem computes the
objective of a design and what it exceeds by formulas of its own: joints by the cosine rule in complex numbers, torque by virtual
power.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from tests import synthesis_oracle as oracle
from tests.oracles.judge import LENGTHS, Judgement, RandomProblem, Raw, Values

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

TURN = 2.0 * math.pi
ROUND = 2881  # crank angles of a revolution
EXACT = 1e-7  # root mean square deviation, as a share of the size of the targets, that is as good as none


# --- texts -----------------------------------------------------------------------------------------------------------------


def mm(value: float) -> str:
    return f"{float(value)!r} mm"


def deg(value: float) -> str:
    """An angle [rad] in degrees."""
    return f"{math.degrees(value)!r} deg"


def free(low: float, high: float, unit: str = "mm") -> Raw:
    return {"bounds": [f"{float(low)!r} {unit}", f"{float(high)!r} {unit}"]}


ANY_ANGLE = free(-180.0, 180.0, "deg")


def about(rng: np.random.Generator, value: float) -> Raw:
    """Bounds about a length, not symmetric."""
    return free(value * rng.uniform(0.25, 0.7), value * rng.uniform(1.5, 4.0))


def around(rng: np.random.Generator, value: float, far: float = 200.0) -> Raw:
    """Bounds about a coordinate."""
    return free(value - rng.uniform(0.3, 1.0) * far, value + rng.uniform(0.3, 1.0) * far)


def document(mechanism: Raw, limits: Raw | None = None, **sections: Any) -> Raw:
    return {"title": "Random problem", "mechanism": mechanism, **sections, **({"limits": limits} if limits else {})}


# --- kinematics ------------------------------------------------------------------------------------------------------------


def corner(p: Complex | complex, q: Complex | complex, a: float, b: float, side: float) -> Complex:
    """The corner of a triangle, a from p and b from q, to the left (+1) or right (-1) of p to q; NaN where there is none."""
    c = np.abs(np.asarray(q) - p)
    cosine = (a * a + c * c - b * b) / (2.0 * a * c)
    with np.errstate(invalid="ignore"):
        return np.asarray(p + a * (np.asarray(q) - p) / c * np.exp(1j * side * np.arccos(cosine)))


@dataclass(frozen=True)
class FourBar:
    """Joints of a four-bar at crank angles from the frame."""

    d: complex
    b: Complex
    c: Complex
    p: Complex
    along: Array  # angle of the coupler
    output: Array  # angle of the rocker from the frame, continuous
    transmission: Array


def side_of(mode: str) -> float:
    return 1.0 if mode.startswith(("left", "forward")) else -1.0


def four_bar(design: Values, side: float, phi: Array) -> FourBar:
    """A four-bar in motion; its names are those of the section of a problem file."""
    a, u = complex(design.get("A.x", 0.0), design.get("A.y", 0.0)), np.exp(1j * design.get("direction", 0.0))
    d, b = a + design["frame"] * u, a + design["crank"] * u * np.exp(1j * phi)
    c = corner(b, d, design["coupler"], design["rocker"], side)
    unit = (c - b) / design["coupler"]
    p = b + unit * complex(design.get("P.along", 0.0), design.get("P.across", 0.0))
    with np.errstate(invalid="ignore"):
        output = np.unwrap(np.angle((c - d) / u))
        return FourBar(d, b, c, p, np.angle(unit), output, np.abs(np.angle((b - c) / (d - c))))


def revolution() -> Array:
    return np.linspace(0.0, TURN, ROUND)


def turning(design: Values, limits: Raw | None = None) -> tuple[str, ...]:
    """The fault of a four-bar that is no crank-rocker, where it has to be one."""
    if "crank" in (limits or {}):
        return ()
    crank, *others = (design[name] for name in LENGTHS)
    fine = crank < min(others) and crank + max(others) < sum(others) - max(others)
    return () if fine else ("the crank does not turn fully",)


def transmission_range(design: Values, side: float, phi: Array | None = None) -> tuple[float, float]:
    """Least and largest transmission angle over the revolution or a range: where crank and frame are in line, or at its ends."""
    at = np.array([0.0, math.pi])
    if phi is not None:
        low, high = float(np.min(phi)), float(np.max(phi))
        at = np.concatenate([[low, high], np.arange(math.ceil(low / math.pi), math.floor(high / math.pi) + 1) * math.pi])
    angles = four_bar(design, side, at).transmission
    return float(np.min(angles)), float(np.max(angles))


def within(raw: Raw, design: Values, side: float, phi: Array | None = None) -> dict[str, tuple[float, float, float]]:
    """Ranges of the limits of a four-bar; `phi`: the crank angles that it needs if the crank does not turn fully."""
    limits, ranges = raw.get("limits", {}), {}
    phi = phi if "crank" in limits else None
    if "transmission_angle" in limits:
        low, high = (math.radians(float(text.split()[0])) for text in limits["transmission_angle"])
        least, most = transmission_range(design, side, phi)
        ranges |= {"least transmission angle": (least, low, math.pi), "largest transmission angle": (most, 0.0, high)}
    if "link_ratio" in limits:
        ranges |= {f"ratio of {name}": (design[name] / design["frame"], *limits["link_ratio"]) for name in LENGTHS[:3]}
    if "pivots" in limits:
        a = complex(design["A.x"], design["A.y"])
        d = a + design["frame"] * np.exp(1j * design["direction"])
        for axis, part in (("x", np.real), ("y", np.imag)):
            low, high = (float(text.split()[0]) for text in limits["pivots"][axis])
            ranges |= {f"{axis} of {name}": (float(part(place)), low, high) for name, place in (("A", a), ("D", d))}
    return ranges


def room_for(rng: np.random.Generator, design: Values, side: float, *, placed: bool) -> Raw:
    """Limits of several sorts that leave room for a design, some of them little."""
    limits: Raw = {"crank": "span"} if placed and rng.random() < 0.2 else {}
    if rng.random() < 0.6:
        low, high = transmission_range(design, side)
        spare = np.radians(rng.choice([0.2, 2.0, 10.0], 2))
        limits["transmission_angle"] = [deg(max(low - spare[0], 0.02)), deg(min(high + spare[1], math.pi - 0.02))]
    if rng.random() < 0.5:
        ratios = [design[name] / design["frame"] for name in LENGTHS[:3]]
        limits["link_ratio"] = [float(min(ratios) * rng.uniform(0.3, 0.99)), float(max(ratios) * rng.uniform(1.01, 3.0))]
    if placed and rng.random() < 0.4:
        a = complex(design["A.x"], design["A.y"])
        d = a + design["frame"] * np.exp(1j * design["direction"])
        ends = {"x": (a.real, d.real), "y": (a.imag, d.imag)}
        limits["pivots"] = {
            axis: [mm(min(two) - rng.uniform(1.0, 60.0)), mm(max(two) + rng.uniform(1.0, 60.0))] for axis, two in ends.items()
        }
    return limits


def crank_rocker(rng: np.random.Generator) -> tuple[dict[str, float], float]:
    """A random crank-rocker in the names of a problem file, and its side."""
    raw = oracle.random_crank_rocker(rng)
    place = {"A.x": raw["x"], "A.y": raw["y"], "P.along": raw["along"], "P.across": raw["across"]}
    return {**{name: raw[name] for name in (*LENGTHS, "direction")}, **place}, float(raw["mode"])


def assembly(rng: np.random.Generator, side: float) -> str:
    """The mode of a planted four-bar, or either."""
    return "either" if rng.random() < 0.6 else ("left" if side > 0.0 else "right")


def measured(measure: str, errors: Array, weights: Array | float = 1.0) -> float:
    """The objective of deviations."""
    squares = weights * np.abs(errors) ** 2
    return float(
        {"sum of squares": np.sum, "rms": lambda s: math.sqrt(np.mean(s)), "max": lambda s: math.sqrt(np.max(s))}[measure](
            squares
        )
    )


def exactly(measure: str, size: float, count: int) -> float:
    """Objective that is as good as none for targets of a size."""
    return count * (EXACT * size) ** 2 if measure == "sum of squares" else EXACT * size


# --- laws ------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Table:
    """A planted crank-rocker with the table of its own law."""

    design: dict[str, float]
    side: float
    offsets: Array
    outputs: Array
    noise: Array
    measure: str
    limits: Raw
    lengths: Raw
    mode: str


def _table(rng: np.random.Generator) -> _Table:
    design, side = crank_rocker(rng)
    count, way = int(rng.integers(6, 15)), float(rng.choice([-1.0, 1.0]))
    offsets = way * np.linspace(0.0, rng.uniform(1.0, 5.5), count)
    outputs = four_bar(design, side, rng.uniform(0.0, TURN) + offsets).output
    noise = rng.normal(size=count) * float(rng.choice([0.0, 1e-3, 1e-2]))
    noise[0] = 0.0
    limits = {key: value for key, value in room_for(rng, design, side, placed=False).items() if key != "link_ratio"}
    lengths = {name: about(rng, design[name]) for name in LENGTHS[:3]}
    measure = str(rng.choice(["sum of squares", "max"], p=[0.7, 0.3]))
    return _Table(design, side, offsets, outputs - outputs[0], noise, measure, limits, lengths, assembly(rng, side))


def _law_problem(name: str, raw: Raw, table: _Table, names: Mapping[str, str]) -> RandomProblem:
    """The problem of a table; `names` of the design where they are not those of a four-bar section."""
    rows = table.outputs + table.noise

    def judge(found: Values, mode: str, angles: Array | None) -> Judgement:
        design = {own: found[other] for own, other in names.items() if other in found} | {"frame": table.design["frame"]}
        side, start = side_of(mode), found[names["phi0"]]
        output = four_bar(design, side, start + table.offsets).output
        errors = oracle.wrapped(output - found[names["psi0"]] - rows)
        ranges = within({"limits": table.limits}, design, side)
        return Judgement(measured(table.measure, errors), ranges, turning(design))

    planted = measured(table.measure, table.noise)  # with the output at the start as psi0
    return RandomProblem(name, raw, judge, planted=planted, least=exactly(table.measure, 1.0, len(rows)))


def law_of_four_bar(rng: np.random.Generator, name: str) -> RandomProblem:
    """A table of the rocker's angle over the crank's."""
    table = _table(rng)
    law = {"phi": [deg(x) for x in table.offsets], "psi": [deg(x) for x in table.outputs + table.noise]}
    section = {"type": "four-bar", "frame": mm(table.design["frame"]), **table.lengths, "assembly": table.mode}
    requirement: Raw = {"kind": "function", "law": law, "from": free(0.0, 360.0, "deg"), "psi0": free(-360.0, 360.0, "deg")}
    requirement["measure"] = table.measure
    names = {each: each for each in (*LENGTHS[:3], "phi0", "psi0")}
    return _law_problem(name, document(section, table.limits, requirement=requirement), table, names)


def law_of_dyads(rng: np.random.Generator, name: str) -> RandomProblem:
    """The same as dyads: the problem of the same number has the same linkage."""
    table = _table(rng)
    section: Raw = {
        "type": "dyads",
        "ground": {"A": ["0 mm", "0 mm"], "D": [mm(table.design["frame"]), "0 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": table.lengths["crank"]},
            "coupler": {"joints": ["B", "C"], "length": table.lengths["coupler"]},
            "rocker": {"joints": ["D", "C"], "length": table.lengths["rocker"]},
        },
        "assembly": {"C": table.mode if table.mode == "either" else f"{table.mode} of B-D"},
    }
    law = {"phi": [deg(x) for x in table.offsets], "psi": [deg(x) for x in table.outputs + table.noise]}
    requirement: Raw = {"kind": "function", "law": law, "output": "rocker", "measure": table.measure}
    requirement |= {"start": free(0.0, 360.0, "deg"), "psi0": free(-360.0, 360.0, "deg")}
    names = {each: f"{each}.length" for each in LENGTHS[:3]} | {"phi0": "start", "psi0": "zero"}
    return _law_problem(name, document(section, table.limits, requirement=requirement), table, names)


def law_of_two_lengths(rng: np.random.Generator, name: str) -> RandomProblem:
    """An expression, coupler and rocker free: its optimum by an own search; or a crank too long for any coupler and rocker."""
    design, side = crank_rocker(rng)
    crank, frame = design["crank"], design["frame"]
    start, span, count = rng.uniform(0.0, TURN), rng.uniform(0.8, 2.5), int(rng.integers(10, 41))
    slope, bend = rng.uniform(-0.5, 0.5), rng.uniform(-0.2, 0.2)
    bounds = {each: about(rng, design[each]) for each in ("coupler", "rocker")}
    possible = rng.random() > 0.15
    if not possible:  # crank + frame is more than coupler + rocker can reach
        bounds = {each: free(0.2 * (crank + frame), 0.48 * (crank + frame)) for each in ("coupler", "rocker")}
    least = float(rng.uniform(0.15, 0.5))
    limits: Raw = {"transmission_angle": [deg(least), deg(math.pi - least)]}
    section = {
        "type": "four-bar",
        "crank": mm(crank),
        "frame": mm(frame),
        **bounds,
        "assembly": "left" if side > 0.0 else "right",
    }
    law = f"psi0 + {slope!r}*(phi - phi0) + {bend!r}*(phi - phi0)^2"
    requirement: Raw = {"kind": "function", "law": law, "from": deg(start), "span": deg(span), "points": count}
    raw = document(section, limits, requirement=requirement)
    offsets = np.linspace(0.0, span, count + 1)
    aims = slope * offsets + bend * offsets**2

    def objective(coupler: float, rocker: float) -> float:
        values = {"crank": crank, "frame": frame, "coupler": coupler, "rocker": rocker}
        if turning(values):
            return math.inf
        low, high = transmission_range(values, side)
        if low < least or high > math.pi - least:
            return math.inf
        output = four_bar(values, side, start + offsets).output
        return float(np.sum((output - output[0] - aims) ** 2))

    def judge(found: Values, mode: str, angles: Array | None) -> Judgement:
        values = {"crank": crank, "frame": frame, "coupler": found["coupler"], "rocker": found["rocker"]}
        output = four_bar(values, side, start + offsets).output
        return Judgement(float(np.sum((output - output[0] - aims) ** 2)), within(raw, values, side), turning(values))

    ends = np.array([[float(text.split()[0]) for text in each["bounds"]] for each in bounds.values()])
    best = grid_search(objective, ends) if possible else math.inf
    if possible and not math.isfinite(best):
        return law_of_two_lengths(rng, name)
    return RandomProblem(name, raw, judge, possible, best if possible else None, least=exactly("sum of squares", 1.0, count))


def grid_search(objective: Callable[..., float], ends: Array, count: int = 25) -> float:
    """The least value in a box: the best of a grid and Nelder-Mead's method from its best positions, repeated."""
    axes = [np.linspace(low, high, count) for low, high in ends]
    rows = np.array(list(itertools.product(*axes)))
    values = np.array([objective(*row) for row in rows])
    best = float(np.min(values))

    def inside(x: Array) -> float:
        return objective(*x) if np.all(x >= ends[:, 0]) and np.all(x <= ends[:, 1]) else math.inf

    for row in rows[np.argsort(values)[:4]]:
        place = row
        for _ in range(3):
            if not math.isfinite(inside(place)):
                break
            steps = np.vstack([place, place + 0.3 * np.diag((ends[:, 1] - ends[:, 0]) / count)])
            with np.errstate(invalid="ignore"):
                found = minimize(
                    inside, place, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-15, "initial_simplex": steps}
                )
            place, best = found.x, min(best, float(found.fun))
    return best


# --- functions y(x) --------------------------------------------------------------------------------------------------------

POSITIONS = 60  # steps between the design positions of a function


def function_of_four_bar(rng: np.random.Generator, name: str) -> RandomProblem:
    """A function y(x) for a rocker over a part of the revolution."""
    law = oracle.random_law(rng)
    turned, travel = (float(rng.choice([-1.0, 1.0])) * each for each in (law.input_range, law.output_range))
    measure = str(rng.choice(["sum of squares", "rms", "max"]))
    stated = {"function": law.expression, "x": [law.low, law.high], "input": f"{turned!r} rad", "output": f"{travel!r} rad"}
    section = {"type": "four-bar", "frame": "100 mm", **dict.fromkeys(LENGTHS[:3], free(5.0, 1000.0)), "assembly": "either"}
    limits = {"crank": "span", "transmission_angle": ["25 deg", "155 deg"], "link_ratio": [0.1, 10.0]}
    raw = document(section, limits, requirement={"kind": "function", "law": stated, "measure": measure})

    def judge(found: Values, mode: str, angles: Array | None) -> Judgement:
        count = 6001 if measure == "max" else POSITIONS + 1
        _, rises = law.offsets(count)
        phi = found["phi0"] + turned * np.linspace(0.0, 1.0, count)
        at = four_bar(found, side_of(mode), phi)
        errors = oracle.wrapped(at.output - found["psi0"] - rises * travel / law.output_range)
        return Judgement(measured(measure, errors), within(raw, found, side_of(mode), phi))

    return RandomProblem(name, raw, judge, least=exactly(measure, 1.0, POSITIONS))


def function_of_slider(rng: np.random.Generator, name: str) -> RandomProblem:
    """A function y(x) for a slider."""
    law = oracle.random_law(rng)
    turned = float(rng.choice([-1.0, 1.0])) * law.input_range
    travel = float(np.round(rng.uniform(20.0, 80.0), 1) * rng.choice([-1.0, 1.0]))
    measure = str(rng.choice(["sum of squares", "rms"]))
    stated = {"function": law.expression, "x": [law.low, law.high], "input": f"{turned!r} rad", "output": f"{travel!r} mm"}
    lengths = {"crank": free(10.0, 200.0), "rod": free(30.0, 500.0), "offset": free(-100.0, 100.0)}
    raw = document(
        slider_crank(lengths, "either"),
        {"crank": "span"},
        requirement={"kind": "function", "law": stated, "output": "G", "measure": measure},
    )

    def judge(found: Values, mode: str, angles: Array | None) -> Judgement:
        _, rises = law.offsets(POSITIONS + 1)
        phi = found["start"] + turned * np.linspace(0.0, 1.0, POSITIONS + 1)
        slide = sliding(found, side_of(mode), phi)
        return Judgement(measured(measure, slide - found["zero"] - rises * travel / law.output_range))

    scale = 1e6 if measure == "sum of squares" else 1e3
    return RandomProblem(name, raw, judge, unit=scale, least=exactly(measure, abs(travel), POSITIONS))


def slider_crank(lengths: Raw, mode: str, **points: Any) -> Raw:
    """A slider-crank; its guide is along x above A."""
    return {
        "type": "dyads",
        "ground": {"A": ["0 mm", "0 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": lengths["crank"]},
            "rod": {"joints": ["B", "C"], "length": lengths["rod"], **({"points": points} if points else {})},
            "slider": {"joints": ["C"]},
        },
        "guides": {"G": {"slider": "slider", "through": "A", "direction": "0 deg", "offset": lengths["offset"]}},
        "assembly": {"C": mode},
    }


def sliding(design: Values, side: float, phi: Array) -> Array:
    """Slide of a slider-crank."""
    crank, rod, offset = design["crank.length"], design["rod.length"], design["G.offset"]
    with np.errstate(invalid="ignore"):
        return np.asarray(crank * np.cos(phi) + side * np.sqrt(rod**2 - (crank * np.sin(phi) - offset) ** 2))


# --- paths and poses -------------------------------------------------------------------------------------------------------


def _points(rng: np.random.Generator, *, timed: bool, posed: bool, name: str) -> RandomProblem:
    design, side = crank_rocker(rng)
    count = int(rng.integers(3, 7)) if posed else int(rng.integers(5, 13))
    way = float(rng.choice([-1.0, 1.0]))
    closed = bool(not timed and not posed and rng.random() < 0.3)
    phi = way * oracle.random_angles(rng, count, TURN if closed else rng.uniform(2.0, 6.0))
    at = four_bar(design, side, phi)
    size = float(np.sqrt(np.mean(np.abs(at.p - at.p.mean()) ** 2)))
    noise = rng.normal(size=(3, count)) * float(rng.choice([0.0, 1e-3, 1e-2]))
    places = at.p + size * (noise[0] + 1j * noise[1])
    weights = np.round(rng.uniform(0.2, 5.0, count), 3) if rng.random() < 0.25 else np.ones(count)
    mark = float(rng.uniform(-3.0, 3.0))
    aims = oracle.wrapped(at.along + mark + noise[2])
    rows: list[Raw] = [{"x": mm(z.real), "y": mm(z.imag)} for z in places]
    from_start = timed and rng.random() < 0.5
    for k, row in enumerate(rows):
        if timed:
            row["crank"] = f"{float(phi[k] - (phi[0] if from_start else 0.0))!r} rad"
        if posed:
            row["angle"] = f"{float(aims[k])!r} rad"
        if np.ptp(weights):
            row["weight"] = float(weights[k])
    measure = str(rng.choice(["sum of squares", "rms", "max"], p=[0.6, 0.2, 0.2]))
    requirement: Raw = {"kind": "motion" if posed else "path", "point": "P", "points": rows, "measure": measure}
    if closed:
        requirement["closed"] = True
    elif not timed and rng.random() < 0.3:
        requirement["rotation"] = "counter-clockwise" if way > 0.0 else "clockwise"
    if timed:
        requirement["timing"] = "from start" if from_start else "given"
    if posed:
        requirement |= {"mark": ANY_ANGLE, "angle_length": "50 mm"}
    errors = np.abs(places - at.p) ** 2 + (50.0 * noise[2]) ** 2 * posed
    tolerance = None
    if rng.random() < 0.15 and not posed:
        tolerance = float(2.0 * np.max(np.abs(places - at.p)) + 1e-3 * size)
        for row in rows:
            row["tolerance"] = mm(tolerance)
    place = {each: around(rng, design[each]) for each in ("A.x", "A.y", "P.along", "P.across")}
    section = {
        "type": "four-bar",
        **{each: about(rng, design[each]) for each in LENGTHS},
        "points": {"P": [place["P.along"], place["P.across"]]},
        "pivot": [place["A.x"], place["A.y"]],
        "direction": ANY_ANGLE,
        "assembly": assembly(rng, side),
    }
    raw = document(section, room_for(rng, design, side, placed=True), requirement=requirement)

    def judge(found: Values, mode: str, angles: Array | None) -> Judgement:
        own = side_of(mode)
        faults = turning(found, raw.get("limits"))
        if timed:
            begin = found.get("start", 0.0) if from_start else 0.0
            crank = begin + phi - (phi[0] if from_start else 0.0)
        else:
            assert angles is not None
            crank = np.asarray(angles)
            steps = np.diff(crank)
            if not (np.all(steps > 0.0) or np.all(steps < 0.0)) or abs(steps.sum()) > TURN * (1.0 + 1e-12):
                faults += ("the points are not met in order within a revolution",)
            if "rotation" in requirement and way * steps[0] < 0.0:
                faults += ("turns the wrong way",)
        met = four_bar(found, own, crank)
        gaps = np.abs(met.p - places) ** 2
        ranges = within(raw, found, own, crank)
        if tolerance is not None:
            ranges["largest distance"] = (float(np.sqrt(np.max(gaps))), 0.0, tolerance)
        if posed:
            gaps = gaps + (50.0 * oracle.wrapped(met.along + found["mark"] - aims)) ** 2
        return Judgement(measured(measure, np.sqrt(gaps), weights), ranges, faults)

    planted = measured(measure, np.sqrt(errors), weights)
    unit = 1e6 if measure == "sum of squares" else 1e3
    return RandomProblem(
        name, raw, judge, planted=planted, unit=unit, least=exactly(measure, 3.0 * max(size, 50.0 * posed), count)
    )


def path_free(rng: np.random.Generator, name: str) -> RandomProblem:
    """Points of a coupler curve at free crank angles, with noise."""
    return _points(rng, timed=False, posed=False, name=name)


def path_timed(rng: np.random.Generator, name: str) -> RandomProblem:
    """Points at prescribed crank angles."""
    return _points(rng, timed=True, posed=False, name=name)


def poses(rng: np.random.Generator, name: str) -> RandomProblem:
    """Poses of the coupler, timed or not."""
    return _points(rng, timed=bool(rng.random() < 0.4), posed=True, name=name)


# --- transmission and strokes ----------------------------------------------------------------------------------------------


def crank_rocker_family(swing: float, ratio: float, frame: float) -> Callable[[float], list[dict[str, float]]]:
    """Crank-rockers of a swing and time ratio over the ratio q of crank and coupler (Alt): two dead centres seen from A.

    With the coupler 1 and the outer dead centre along x, the pin C is at 1 + q and, turned by alpha, at 1 - q; D sees the chord
    under the swing.
    """
    alpha = math.pi * (ratio - 1.0) / (ratio + 1.0)

    def of(q: float) -> list[dict[str, float]]:
        found = []
        for turned, above in itertools.product((alpha, -alpha), (1.0, -1.0)):
            outer, inner = complex(1.0 + q), (1.0 - q) * np.exp(1j * turned)
            chord = outer - inner
            d = 0.5 * (outer + inner) + above * 0.5j * chord / math.tan(0.5 * swing)
            scale = frame / abs(d)
            rocker = 0.5 * abs(chord) / math.sin(0.5 * swing)
            design = {"crank": q * scale, "coupler": scale, "rocker": rocker * scale, "frame": frame}
            sides = [((c - 0.0) * np.conj(d)).imag for c in (outer, inner)]  # C on one side of A to D: one circuit
            if sides[0] * sides[1] > 0.0 and not turning(design):
                found.append(design)
        return found

    return of


def best_of_family(swing: float, ratio: float, frame: float, bounds: Mapping[str, tuple[float, float]]) -> float:
    """The least worst pressure angle [rad] of the family within bounds; infinite if there is none."""
    family = crank_rocker_family(swing, ratio, frame)

    def worst(q: float, kind: int) -> float:
        designs = family(q)
        if kind >= len(designs) or not all(low <= designs[kind][each] <= high for each, (low, high) in bounds.items()):
            return math.inf
        return max(abs(0.5 * math.pi - angle) for angle in transmission_range(designs[kind], 1.0))

    return min(least_on_line(lambda q, k=kind: worst(q, k), 1e-3, 1.0 - 1e-3) for kind in range(4))


def least_on_line(function: Callable[[float], float], low: float, high: float, count: int = 2000) -> float:
    """The least value on a line, which may be infinite in parts: of a grid, then of ever finer ones about its best position."""
    best = math.inf
    for _ in range(8):
        grid = np.linspace(low, high, count)
        values = np.array([function(float(x)) for x in grid])
        k = int(np.argmin(values))
        best = min(best, float(values[k]))
        low, high = float(grid[max(k - 2, 0)]), float(grid[min(k + 2, count - 1)])
        count = 41
    return best


def transmission(rng: np.random.Generator, name: str) -> RandomProblem:
    """Best worst transmission angle for a swing and a time ratio: as a transmission or a stroke; sometimes more than exists."""
    bounds = {"crank": (5.0, 500.0), "coupler": (5.0, 1000.0), "rocker": (5.0, 1000.0)}
    best, swing, ratio = math.inf, 0.0, 1.0
    while not best < math.radians(75.0):
        swing, ratio = math.radians(rng.uniform(20.0, 100.0)), float(rng.uniform(1.02, 1.4))
        best = best_of_family(swing, ratio, 100.0, bounds)
    section = {"type": "four-bar", "frame": "100 mm", **{each: free(*ends) for each, ends in bounds.items()}}
    section["assembly"] = "either"
    possible = rng.random() > 0.2
    limits: Raw = {}
    if not possible:
        most = best - math.radians(rng.uniform(1.0, 8.0))
        limits["pressure_angle"] = deg(most)
    as_stroke = bool(rng.random() < 0.5)
    if as_stroke:
        raw = document(section, limits, requirement={"kind": "stroke", "stroke": deg(swing), "time_ratio": ratio})
    else:
        raw = document(section, {**limits, "swing_angle": deg(swing), "time_ratio": ratio}, requirement={"kind": "transmission"})

    def judge(found: Values, mode: str, angles: Array | None) -> Judgement:
        found = {**found, "frame": 100.0}
        worst = max(abs(0.5 * math.pi - angle) for angle in transmission_range(found, 1.0))
        crank, coupler, rocker = (found[each] for each in LENGTHS[:3])
        outer, inner = (
            math.acos((reach**2 + 100.0**2 - rocker**2) / (200.0 * reach)) for reach in (coupler + crank, coupler - crank)
        )
        at_d = [math.acos((rocker**2 + 100.0**2 - reach**2) / (200.0 * rocker)) for reach in (coupler + crank, coupler - crank)]
        alpha = abs(outer - inner)
        ranges = {
            "swing": (at_d[0] - at_d[1], swing, swing),
            "time ratio": ((math.pi + alpha) / (math.pi - alpha), ratio, ratio),
        }
        return Judgement(worst if as_stroke else math.sin(worst), ranges, turning(found))

    known = best if as_stroke else math.sin(best)
    return RandomProblem(name, raw, judge, possible, known if possible else None, least=1e-9)


def stroke(rng: np.random.Generator, name: str) -> RandomProblem:
    """A slider-crank of a stroke and time ratio with the least pressure angle or the least total length."""
    travel, ratio = float(rng.uniform(30.0, 200.0)), float(rng.uniform(1.03, 1.6))
    alpha = math.pi * (ratio - 1.0) / (ratio + 1.0)
    longest = float(travel * rng.uniform(0.7, 4.0))

    def design(t: float) -> dict[str, float]:
        """Of the ratio t of the two distances of A from the dead centres of the pin."""
        far = travel / math.sqrt(1.0 + t * t - 2.0 * t * math.cos(alpha))
        near = t * far
        return {"crank": 0.5 * (far - near), "rod": 0.5 * (far + near), "offset": far * near * math.sin(alpha) / travel}

    def pressure(values: Values) -> float:
        sine = (values["crank"] + abs(values["offset"])) / values["rod"]
        return math.asin(sine) if sine < 0.999 else math.inf

    def worst(t: float) -> float:
        values = design(t)
        ahead = (values["crank"] + values["rod"]) ** 2 - values["offset"] ** 2
        behind = (values["rod"] - values["crank"]) ** 2 - values["offset"] ** 2
        fine = behind > 0.0 and values["rod"] <= longest and abs(math.sqrt(ahead) - math.sqrt(behind) - travel) < 1e-9 * travel
        return pressure(values) if fine else math.inf

    best = least_on_line(worst, 1e-3, 1.0 - 1e-3)
    if not math.isfinite(best):
        return stroke(rng, name)
    possible = rng.random() > 0.2
    smallest = bool(possible and rng.random() < 0.4)
    limits: Raw = {}
    most = math.pi
    if not possible:
        limits["pressure_angle"] = deg(best - math.radians(rng.uniform(1.0, 5.0)))
    elif smallest:
        most = best + 0.3 * (math.radians(80.0) - best)
        limits["pressure_angle"] = deg(most)
    lengths = {"crank": free(0.05 * travel, travel), "rod": free(0.1 * travel, longest), "offset": free(0.0, 3.0 * travel)}
    requirement = {"kind": "stroke", "output": "slider", "stroke": mm(travel), "time_ratio": ratio}
    sections: Raw = {"requirement": requirement} | ({"objective": {"quantity": "total length"}} if smallest else {})
    raw = document(slider_crank(lengths, "forward"), limits, **sections)

    def total(t: float) -> float:
        values = design(t)
        return values["crank"] + values["rod"] if worst(t) <= most else math.inf

    known = least_on_line(total, 1e-3, 1.0 - 1e-3) if smallest else best

    def judge(found: Values, mode: str, angles: Array | None) -> Judgement:
        crank, rod, offset = found["crank.length"], found["rod.length"], found["G.offset"]
        far, near = (math.sqrt(reach**2 - offset**2) for reach in (rod + crank, rod - crank))
        turned = abs(math.asin(offset / (rod - crank)) - math.asin(offset / (rod + crank)))
        values = {"crank": crank, "rod": rod, "offset": offset}
        ranges = {
            "stroke": (far - near, travel, travel),
            "time ratio": ((math.pi + turned) / (math.pi - turned), ratio, ratio),
            "pressure angle": (pressure(values), 0.0, most),
        }
        return Judgement(crank + rod if smallest else pressure(values), ranges)

    unit = 1e3 if smallest else 1.0
    return RandomProblem(
        name, raw, judge, possible, known if possible else None, unit=unit, least=1e-9 * (travel if smallest else 1.0)
    )


# --- machines --------------------------------------------------------------------------------------------------------------


def machine(rng: np.random.Generator, name: str) -> RandomProblem:
    """A slider-crank with a heavy slider and a force against its forward stroke: least torque for a stroke, within a guide force.

    With massless crank and rod the torque is (m a + F) v / omega, and the guide force (m a + F) tan(pressure angle).
    """
    travel = float(rng.uniform(40.0, 150.0))
    mass, force = float(rng.uniform(0.5, 10.0)), float(rng.uniform(100.0, 2000.0))
    speed = float(rng.uniform(10.0, 40.0))  # rad/s
    measure = str(rng.choice(["peak", "rms"]))
    phi = np.linspace(0.0, TURN, 3601)[:-1]

    def course(crank: float, rod: float, offset: float) -> tuple[Array, Array]:
        """Torque [N m] and guide force [N] over the revolution."""
        sine = crank * np.sin(phi) - offset
        root = np.sqrt(rod**2 - sine**2)
        rate = -crank * np.sin(phi) - sine * crank * np.cos(phi) / root  # ds / dphi
        second = (
            -crank * np.cos(phi)
            - crank**2 * (np.cos(phi) ** 2 * (1.0 / root + sine**2 / root**3))
            + sine * crank * np.sin(phi) / root
        )
        push = mass * speed**2 * 1e-3 * second + force * (rate > 0.0)
        return push * rate * 1e-3, np.abs(push * sine / root)

    def figures(crank: float, rod: float, offset: float) -> tuple[float, float]:
        torque, guide = course(crank, rod, offset)
        return (peak(torque) if measure == "peak" else float(np.sqrt(np.mean(torque**2)))), float(np.max(guide))

    def crank_of(rod: float, offset: float) -> float:
        """The crank of the stroke: sqrt((l + r)^2 - e^2) - sqrt((l - r)^2 - e^2) grows with r."""
        low, high = 0.3 * travel, 0.999999 * (rod - offset)

        def reached(r: float) -> float:
            return math.sqrt((rod + r) ** 2 - offset**2) - math.sqrt(max((rod - r) ** 2 - offset**2, 0.0)) - travel

        if high <= low or reached(high) < 0.0:
            return math.nan
        for _ in range(80):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if reached(middle) < 0.0 else (low, middle)
        return 0.5 * (low + high)

    shortest, longest = travel * rng.uniform(0.7, 1.2), travel * rng.uniform(1.4, 4.0)
    highest = float(0.4 * travel)
    first = figures(crank_of(0.6 * longest + 0.4 * shortest, 0.1 * travel), 0.6 * longest + 0.4 * shortest, 0.1 * travel)
    most = float(first[1] * rng.uniform(0.9, 1.3)) if rng.random() < 0.6 else math.inf

    def objective(rod: float, offset: float) -> float:
        crank = crank_of(rod, offset)
        if not math.isfinite(crank) or crank + offset > rod * math.sin(math.radians(89.0)):
            return math.inf
        value, guide = figures(crank, rod, offset)
        return value if guide <= most * (1.0 - 1e-9) else math.inf

    best = grid_search(objective, np.array([[shortest, longest], [0.0, highest]]), 15)
    if not math.isfinite(best):
        return machine(rng, name)
    lengths = {
        "crank": free(0.3 * travel, 0.7 * travel),
        "rod": {"start": mm(0.6 * longest + 0.4 * shortest), **free(shortest, longest)},
        "offset": {"start": mm(0.1 * travel), **free(0.0, highest)},
    }
    lengths["crank"]["start"] = mm(crank_of(0.6 * longest + 0.4 * shortest, 0.1 * travel))
    limits: Raw = {"stroke": {"quantity": "stroke", "of": "slider", "exactly": mm(travel)}}
    if math.isfinite(most):
        limits["guide"] = {"quantity": "guide force", "of": "G", "measure": "peak", "max": f"{most!r} N"}
    raw = document(
        slider_crank(lengths, "forward"),
        limits,
        bodies={"slider": {"mass": f"{mass!r} kg"}},
        loads={"process": {"on": "slider", "force": f"{force!r} N", "acts": "opposing", "stroke": "forward"}},
        drive={"speed": f"{speed!r} rad/s"},
        objective={"quantity": "torque", "measure": measure},
    )

    def judge(found: Values, mode: str, angles: Array | None) -> Judgement:
        crank, rod, offset = found["crank.length"], found["rod.length"], found["G.offset"]
        value, guide = figures(crank, rod, offset)
        far, near = (math.sqrt(reach**2 - offset**2) for reach in (rod + crank, rod - crank))
        ranges = {"stroke": (far - near, travel, travel), "guide force": (guide, 0.0, most)}
        return Judgement(value, ranges)

    return RandomProblem(name, raw, judge, planted=best, least=1e-9)


def peak(values: Array) -> float:
    """The largest magnitude of a periodic course, of the parabola through its three largest neighbours."""
    size = np.abs(values)
    k = int(np.argmax(size))
    before, at, after = size[k - 1], size[k], size[(k + 1) % len(size)]
    bend = before - 2.0 * at + after
    return float(at - (after - before) ** 2 / (8.0 * bend)) if bend < 0.0 else float(at)


# --- further linkages ------------------------------------------------------------------------------------------------------


def slider_path(rng: np.random.Generator, name: str) -> RandomProblem:
    """Points of the rod of a slider-crank at free or prescribed crank angles."""
    crank = float(rng.uniform(15.0, 60.0))
    rod, offset = crank * float(rng.uniform(2.0, 5.0)), crank * float(rng.uniform(-0.6, 0.6))
    point = complex(*rng.uniform(-80.0, 120.0, 2))
    count, timed = int(rng.integers(4, 11)), bool(rng.random() < 0.5)
    phi = oracle.random_angles(rng, count, rng.uniform(2.0, 6.0))

    def traced(values: Values, angles: Array) -> Complex:
        b = values["crank.length"] * np.exp(1j * angles)
        c = sliding(values, 1.0, angles) + 1j * values["G.offset"]
        return np.asarray(b + (c - b) / values["rod.length"] * complex(values["rod.P.along"], values["rod.P.across"]))

    planted = {
        "crank.length": crank,
        "rod.length": rod,
        "G.offset": offset,
        "rod.P.along": point.real,
        "rod.P.across": point.imag,
    }
    exact = traced(planted, phi)
    size = float(np.sqrt(np.mean(np.abs(exact - exact.mean()) ** 2)))
    noise = rng.normal(size=(2, count)) * float(rng.choice([0.0, 1e-3, 1e-2])) * size
    places = exact + noise[0] + 1j * noise[1]
    rows = [
        {"x": mm(z.real), "y": mm(z.imag), **({"crank": f"{float(a)!r} rad"} if timed else {})}
        for z, a in zip(places, phi, strict=True)
    ]
    lengths = {"crank": about(rng, crank), "rod": about(rng, rod), "offset": around(rng, offset, 60.0)}
    section = slider_crank(lengths, "forward", P=[around(rng, point.real), around(rng, point.imag)])
    raw = document(section, requirement={"kind": "path", "point": "P", "points": rows})

    def judge(found: Values, mode: str, angles: Array | None) -> Judgement:
        crank = phi if timed else np.asarray(angles)
        faults = (
            () if found["crank.length"] + abs(found["G.offset"]) < found["rod.length"] else ("the crank does not turn fully",)
        )
        return Judgement(float(np.sum(np.abs(traced(found, crank) - places) ** 2)), {}, faults)

    return RandomProblem(
        name, raw, judge, planted=float(np.sum(noise**2)), unit=1e6, least=exactly("sum of squares", size, count)
    )


def six_bar(rng: np.random.Generator, name: str) -> RandomProblem:
    """A table of the slide of a crank-rocker with a rod and slider; the four-bar is given, or free as well."""
    design, side = crank_rocker(rng)
    frame = design["frame"]
    whole = bool(rng.random() < 0.4)
    rocker = design["rocker"]
    rod, offset = rocker * float(rng.uniform(1.5, 4.0)), rocker * float(rng.uniform(-0.4, 0.4))
    count = int(rng.integers(6, 13))
    offsets = np.linspace(0.0, rng.uniform(1.0, 5.0), count)

    def slide(values: Values, own: float, phi: Array) -> Array:
        c = four_bar(values | {"A.x": 0.0, "A.y": 0.0, "direction": 0.0, "frame": frame}, own, phi).c
        with np.errstate(invalid="ignore"):
            return np.asarray((c - frame).real + np.sqrt(values["rod"] ** 2 - (c.imag - values["offset"]) ** 2))

    planted = {each: design[each] for each in LENGTHS} | {"rod": rod, "offset": offset}
    start = float(rng.uniform(0.0, TURN))
    exact = slide(planted, side, start + offsets)
    if not np.all(np.isfinite(slide(planted, side, revolution()))):
        return six_bar(rng, name)
    size = float(np.ptp(exact))
    noise = rng.normal(size=count) * float(rng.choice([0.0, 1e-3, 1e-2])) * size
    noise[0] = 0.0
    rows = exact - exact[0] + noise
    bounds = {each: about(rng, design[each]) if whole else mm(design[each]) for each in LENGTHS[:3]}
    mode = "left" if side > 0.0 else "right"
    section: Raw = {
        "type": "dyads",
        "ground": {"A": ["0 mm", "0 mm"], "D": [mm(frame), "0 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": bounds["crank"]},
            "coupler": {"joints": ["B", "C"], "length": bounds["coupler"]},
            "rocker": {"joints": ["D", "C"], "length": bounds["rocker"]},
            "rod": {"joints": ["C", "E"], "length": about(rng, rod)},
            "slider": {"joints": ["E"]},
        },
        "guides": {"G": {"slider": "slider", "through": "D", "direction": "0 deg", "offset": around(rng, offset, rocker)}},
        "assembly": {"C": f"{mode} of B-D", "E": "forward"},
    }
    law = {"phi": [deg(x) for x in offsets], "s": [mm(x) for x in rows]}
    raw = document(section, requirement={"kind": "function", "law": law, "output": "G"})

    def judge(found: Values, mode: str, angles: Array | None) -> Judgement:
        values = {each: found.get(f"{each}.length", design[each]) for each in LENGTHS[:3]} | {"frame": frame}
        values |= {"rod": found["rod.length"], "offset": found["G.offset"]}
        errors = slide(values, side, found["start"] + offsets) - found["zero"] - rows
        faults = turning(values)
        if not np.all(np.isfinite(slide(values, side, revolution()))):
            faults += ("the slider does not follow over the revolution",)
        return Judgement(float(np.sum(errors**2)), {}, faults)

    least = exactly("sum of squares", size, count)
    return RandomProblem(name, raw, judge, planted=float(np.sum(noise**2)), unit=1e6, least=least)


KINDS: tuple[Callable[[np.random.Generator, str], RandomProblem], ...] = (
    law_of_four_bar,
    law_of_dyads,
    law_of_two_lengths,
    function_of_four_bar,
    function_of_slider,
    path_free,
    path_timed,
    poses,
    transmission,
    stroke,
    machine,
    slider_path,
    six_bar,
)


def random_problem(number: int) -> RandomProblem:
    """The problem of a number: the kinds in turn, a law of a four-bar and that of dyads from the same numbers."""
    kind = KINDS[number % len(KINDS)]
    family = "law" if kind in (law_of_four_bar, law_of_dyads) else kind.__name__
    rng = np.random.default_rng([number // len(KINDS), sum(family.encode())])
    return kind(rng, f"{kind.__name__} {number // len(KINDS)}")
