"""Random tasks as problem files state them, and the judging of what the program answers by `tests.synthesis_oracle`.

Lengths are in mm, angles in rad; everything random comes from a seed. A faultless answer has an empty list of faults: what it
claims is compared with what the oracle finds, never with what the program measured itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import optlink
from optlink.linkage.fourbar import LENGTHS
from optlink.tasks.design import solve
from optlink.tasks.results.design import LinkageDesign
from tests import synthesis_oracle as oracle
from tests.stated import ANGLE, document, four_bar_section, free
from tests.synthesis_oracle import TURN

Array = np.ndarray
Raw = dict[str, Any]

CRANK_SIGN = {"clockwise": -1, "counter-clockwise": 1}
FIGURE = 1e-7  # share by which two routes to a figure may differ
ROUNDING = 1e-10  # of the size: below, a figure is rounding
LIMIT = 1e-6  # share, rad or size by which a limit may be missed: the program allows itself 1e-6 in its scaled rows
LEAST = math.radians(1e-4)  # by which a least transmission angle may differ; near 0 it has lost half its digits


def four_bar_of(design: LinkageDesign) -> dict[str, float]:
    """A design as the oracle takes it."""
    values = design.values
    lengths = [1e3 * values[name] for name in ("frame", "crank", "coupler", "rocker")]
    x, y = (1e3 * values.get(name, 0.0) for name in ("A.x", "A.y"))
    along, across = 1e3 * values["P.along"], 1e3 * values["P.across"]
    place = {"x": x, "y": y, "direction": values.get("direction", 0.0)}
    return oracle.four_bar(*lengths, **place, along=along, across=across, mode=design.task.four_bar.side)


def judged(design: LinkageDesign, expected: Array, *, closed: bool = False, timed: Array | None = None) -> oracle.Report:
    """The oracle's report of a path design; `wanted` (points, 2): target points in mm."""
    return oracle.judge_path(four_bar_of(design), expected, design.crank_angles, closed=closed, timed=timed)


# --- round trips: a linkage's own curve ------------------------------------------------------------------------------------

TIMINGS = ("from start", "given", "free, even", "free, uneven")
VARIANTS: dict[str, dict[str, float]] = {
    "plain": {},
    "tiny": {"scale": 1e-5},
    "huge": {"scale": 1e5},
    "turned": {"turn": 2.5},
    "shifted": {"shift": 30.0},
}
RECOVERED = 1e-8  # of the curve's size
WIDE = 10.0  # sizes that the bounds leave open around the linkage


@dataclass(frozen=True)
class RoundTrip:
    """A linkage, the crank angles of the points that were taken from its curve, and the points."""

    linkage: Mapping[str, float]
    crank: Array
    points: Array
    timing: str

    @property
    def size(self) -> float:
        """Root mean square distance of the points from their centre."""
        return float(np.sqrt(np.mean(np.sum((self.points - self.points.mean(axis=0)) ** 2, axis=1))))

    @property
    def raw(self) -> Raw:
        """The problem: nothing of the linkage but the order of its size."""
        longest = max(self.linkage[name] for name in LENGTHS)
        far = WIDE * max(longest, abs(self.linkage["along"]), abs(self.linkage["across"]))
        section = four_bar_section(
            "either",
            **dict.fromkeys(LENGTHS, free(0.01 * longest, 10.0 * longest)),
            points={"P": [free(-far, far)] * 2},
            pivot=[free(middle - far, middle + far) for middle in self.points.mean(axis=0).tolist()],
        )
        if self.timing == "from start":
            return document(section, self.points, crank=self.crank - self.crank[0], timing="from start")
        if self.timing == "given":
            return document(section, self.points, crank=self.crank, timing="given")
        return document(section, self.points, closed=True)


def round_trip(seed: int, count: int, timing: str, *, scale: float = 1.0, turn: float = 0.0, shift: float = 0.0) -> RoundTrip:
    """A random crank-rocker's own curve at `count` points; turned by an angle, scaled, shifted by so many sizes of the curve."""
    rng = np.random.default_rng(seed)
    linkage = oracle.random_crank_rocker(rng)
    way = 1.0 if rng.random() < 0.5 else -1.0
    begin = rng.uniform(0.0, TURN)
    steps = oracle.random_angles(rng, count) if timing == "free, uneven" else np.arange(count) * TURN / count
    crank = begin + way * (steps - steps[0])
    place = scale * complex(linkage["x"], linkage["y"]) * np.exp(1j * turn)
    sizes = {name: scale * linkage[name] for name in (*LENGTHS, "along", "across")}
    moved = {**linkage, **sizes, "x": place.real, "y": place.imag, "direction": linkage["direction"] + turn}
    by = shift * float(np.hypot(*np.ptp(oracle.planted_path(moved, crank), axis=0)))
    moved |= {"x": moved["x"] + by * math.cos(1.0), "y": moved["y"] + by * math.sin(1.0)}
    return RoundTrip(moved, crank, oracle.planted_path(moved, crank), timing)


@dataclass(frozen=True)
class Recovery:
    """Whether a linkage that passes the points was found, and what is wrong with any of the designs."""

    recovered: bool
    faults: tuple[str, ...]
    miss: float  # root mean square distance of the best design as a share of the curve's size; infinite if there is none


def recover(trip: RoundTrip, designs: int = 3) -> Recovery:
    """Search for a linkage through the points, judge everything that comes back."""
    result = solve(optlink.read(trip.raw), designs=designs)
    faults: list[str] = []
    miss = math.inf
    for rank, design in enumerate(result.designs):
        timed = None if trip.timing.startswith("free") else trip.crank
        report = judged(design, trip.points, closed=timed is None, timed=timed)
        faults += [f"design {rank}: {name}" for name in defects(report, turning=True)]
        if timed is not None and report.timing > 1e-9:
            faults.append(f"design {rank}: timing is off by {report.timing:.2e} rad")
        if trip.timing == "given" and np.max(np.abs(design.crank_angles - trip.crank)) > 1e-9:
            faults.append(f"design {rank}: not the crank angles given")
        claimed = 1e3 * math.sqrt(max(design.objective, 0.0))
        if abs(math.sqrt(report.sse) - claimed) > 1e-9 * trip.size + FIGURE * math.sqrt(report.sse):
            faults.append(f"design {rank}: error {math.sqrt(report.sse):.6e}, claimed {claimed:.6e}")
        miss = min(miss, report.rms / trip.size)
    return Recovery(miss <= RECOVERED, tuple(faults), miss)


def defects(report: oracle.Report, *, turning: bool) -> list[str]:
    """Defects of order, branch and circuit; of the crank if it must turn fully."""
    passed = {"order": report.order_ok, "branch": report.branch_ok, "circuit": report.circuit_ok}
    if turning:
        passed["does not turn"] = report.turns
    return [name for name, fine in passed.items() if not fine]


# --- random points and poses -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RandomTask:
    """A random problem, and what an answer is judged by: rows wanted (x, y and, of poses, angle), crank angles, weights."""

    raw: Raw
    wanted: Array
    crank: Array | None
    timing: str
    weights: Array
    closed: bool

    @property
    def size(self) -> float:
        """Root mean square distance of the points from their centre: also the length that one radian of a pose counts as."""
        places = self.wanted[:, :2]
        return float(np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1))))

    @property
    def limits(self) -> Raw:
        limits: Raw = self.raw["limits"]
        return limits

    @property
    def crank_limit(self) -> str:
        return str(self.limits.get("crank", "full rotation"))


def random_task(seed: int) -> RandomTask:
    """Points in no order or around, a closed curve, poses, or points of a planted linkage; with random limits and timing."""
    rng = np.random.default_rng([77, seed])
    kind = rng.choice(["points", "curve", "poses", "planted"], p=[0.35, 0.3, 0.25, 0.1])
    if kind == "points":
        targets = oracle.random_points(rng, int(rng.integers(3, 21)))
        if rng.random() < 0.6:  # in an order that makes sense
            x, y = (targets - targets.mean(axis=0)).T
            targets = targets[np.argsort(np.arctan2(y, x))]
    elif kind == "curve":
        targets = oracle.random_closed_curve(rng, int(rng.integers(5, 21)))
    elif kind == "planted":
        linkage = oracle.random_crank_rocker(rng)
        targets = oracle.planted_path(linkage, oracle.random_angles(rng, int(rng.integers(3, 21)), rng.uniform(1.0, 6.0)))
    else:
        targets = oracle.random_poses(rng, int(rng.integers(2, 7)))
    count = len(targets)
    timing, crank = str(rng.choice(["free", "from start", "given"], p=[0.5, 0.25, 0.25])), None
    way = int(rng.choice([-1, 1]))
    if timing != "free":
        crank = way * oracle.random_angles(rng, count, rng.uniform(1.0, 6.0))
        crank = crank - crank[0] if timing == "from start" else crank
    assembly = str(rng.choice(["either", "left", "right"], p=[0.6, 0.2, 0.2]))
    requirement: Raw = {"measure": str(rng.choice(["sum of squares", "rms", "max"], p=[0.6, 0.2, 0.2]))}
    weights = np.round(rng.uniform(0.2, 5.0, count), 3) if rng.random() < 0.2 else np.ones(count)
    closed = kind == "curve" and timing == "free"
    if closed:
        requirement["closed"] = True
    if timing != "free":
        requirement["timing"] = timing
    elif rng.random() < 0.3:
        requirement["rotation"] = str(rng.choice(list(CRANK_SIGN)))
    if kind == "poses" and rng.random() < 0.7:
        requirement["mark"] = ANGLE
    far = free(-1500.0, 1500.0)
    place: Raw = {"pivot": [far, far]} if rng.random() < 0.85 else {"pivot": None, "direction": None}
    section = four_bar_section(assembly, **dict.fromkeys(LENGTHS, free(5.0, 1500.0)), points={"P": [far, far]}, **place)
    raw = document(section, targets, _random_limits(rng), crank=crank, weights=weights, **requirement)
    return RandomTask(raw, targets, crank, timing, weights, closed)


def _random_limits(rng: np.random.Generator) -> Raw:
    limits: Raw = {}
    crank = str(rng.choice(["span", "double-crank", "full rotation"], p=[0.35, 0.1, 0.55]))
    if crank != "full rotation":
        limits["crank"] = crank
    if rng.random() < 0.6:
        limits["transmission_angle"] = [f"{rng.uniform(10.0, 40.0)} deg", f"{180.0 - rng.uniform(10.0, 40.0)} deg"]
        if crank != "span" and rng.random() < 0.3:
            limits["transmission_over"] = "span"
    if rng.random() < 0.6:
        limits["link_ratio"] = [0.05, 20.0] if rng.random() < 0.5 else [0.2, 5.0]
    if rng.random() < 0.4:
        limits["pivots"] = {axis: [f"{-rng.uniform(50.0, 400.0)} mm", f"{rng.uniform(50.0, 400.0)} mm"] for axis in "xy"}
    return limits


def faults_of(design: LinkageDesign, task: RandomTask) -> list[str]:
    """Everything that is wrong with a design that the program calls valid."""
    linkage, phi = four_bar_of(design), design.crank_angles
    report, result = _report(design, task, linkage), []
    result += defects(report, turning=task.crank_limit != "span")
    if task.timing != "free" and report.timing > 1e-9:
        result.append(f"timing is off by {report.timing:.2e} rad")
    if task.crank is not None and task.timing == "given" and np.max(np.abs(phi - task.crank)) > 1e-9:
        result.append("not the crank angles given")
    rotation = CRANK_SIGN.get(task.raw["requirement"].get("rotation", ""))
    if rotation is not None and rotation * (phi[-1] - phi[0]) <= 0.0:
        result.append("turns the wrong way")
    return result + _wrong_figures(design, task, linkage, report) + _missed_limits(design, task, linkage)


def _report(design: LinkageDesign, task: RandomTask, linkage: oracle.Design) -> oracle.Report:
    if task.wanted.shape[1] == 2:
        return judged(design, task.wanted, closed=task.closed, timed=task.crank)
    mark = design.values["mark"]
    return oracle.judge_motion(
        linkage, task.wanted, design.crank_angles, mark, weight=task.size, closed=task.closed, timed=task.crank
    )


def _wrong_figures(design: LinkageDesign, task: RandomTask, linkage: oracle.Design, report: oracle.Report) -> list[str]:
    """Figures of the result that are not what the oracle measures."""
    places = oracle.direct(linkage, design.crank_angles).p
    squares = task.weights * report.errors**2
    if report.angle_errors.size and task.wanted.shape[1] == 3:
        squares = squares + task.weights * (task.size * report.angle_errors) ** 2
    measure, document = task.raw["requirement"]["measure"], design.to_dict()
    root = {"sum of squares": np.sum, "rms": np.mean, "max": np.max}[measure](squares) ** 0.5
    claimed = 1e3 * (math.sqrt(design.objective) if measure == "sum of squares" else design.objective)
    objective, points = document["objective"], document["points"]
    figures = {
        "objective": (claimed, root),
        "rms": (objective["rms_mm"], report.rms),
        "largest": (objective["largest_mm"], report.largest),
        "distances": (points["distance_mm"], report.errors),
        "x": (points["x_mm"], places.real),
        "y": (points["y_mm"], places.imag),
    }
    figures = {name: (np.array(one, dtype=float), other) for name, (one, other) in figures.items()}  # null is not a number
    rounding = ROUNDING * max(task.size, oracle.size(linkage))
    return [
        f"{name}: {np.max(one)!r} is reported, {np.max(other)!r} measured"
        for name, (one, other) in figures.items()
        if not np.all(np.abs(one - other) <= FIGURE * np.abs(other) + rounding)
    ]


def transmission(linkage: oracle.Design, phi: Array) -> Array:
    """Angle between coupler and rocker by the cosine rule [rad]; crank angles count from the frame."""
    frame, crank, coupler, rocker = (linkage[name] for name in ("frame", "crank", "coupler", "rocker"))
    across = crank**2 + frame**2 - 2.0 * crank * frame * np.cos(phi)
    return np.arccos(np.clip((coupler**2 + rocker**2 - across) / (2.0 * coupler * rocker), -1.0, 1.0))


def transmission_range(linkage: oracle.Design, begin: float, end: float) -> tuple[float, float]:
    """Least and largest transmission angle: where the crank lies along the frame, or at the ends of the range."""
    low, high = min(begin, end), max(begin, end)
    along = math.pi * np.arange(math.ceil(low / math.pi), math.floor(high / math.pi) + 1)
    angles = transmission(linkage, np.concatenate([[low, high], along]))
    return float(np.min(angles)), float(np.max(angles))


def _missed_limits(design: LinkageDesign, task: RandomTask, linkage: oracle.Design) -> list[str]:
    limits, result, size = task.limits, [], task.size
    begin, end = float(design.crank_angles[0]), float(design.crank_angles[-1])
    span, whole = transmission_range(linkage, begin, end), transmission_range(linkage, 0.0, TURN)
    needed = span if task.crank_limit == "span" else whole
    if abs(design.least_transmission - min(needed[0], math.pi - needed[1])) > LEAST:
        result.append(f"least transmission angle: {design.least_transmission} is reported, it is {needed}")
    if "transmission_angle" in limits:
        low, high = (math.radians(number(text)) for text in limits["transmission_angle"])
        over = span if limits.get("transmission_over") == "span" else needed
        if over[0] < low - LIMIT or over[1] > high + LIMIT:
            result.append(f"transmission angle {over}, limits {low}, {high}")
    crank, coupler, rocker, frame = lengths = [linkage[name] for name in LENGTHS]
    if task.crank_limit != "span":
        shortest = frame if task.crank_limit == "double-crank" else crank
        if min(lengths) != shortest or not 2.0 * (shortest + max(lengths)) < sum(lengths):
            result.append(f"is no {task.crank_limit}")
    if "link_ratio" in limits:
        low, high = limits["link_ratio"]
        if not all(low * (1.0 - LIMIT) <= length / frame <= high * (1.0 + LIMIT) for length in (crank, coupler, rocker)):
            result.append("link ratio")
    if "pivots" in limits:
        d = complex(linkage["x"], linkage["y"]) + frame * np.exp(1j * linkage["direction"])
        for axis, places in {"x": (linkage["x"], d.real), "y": (linkage["y"], d.imag)}.items():
            low, high = (number(text) for text in limits["pivots"][axis])
            if min(places) < low - LIMIT * size or max(places) > high + LIMIT * size:
                result.append(f"pivots at {axis} = {places}, limits {low}, {high}")
    mechanism = task.raw["mechanism"]
    bounds = {name: (linkage[name], mechanism[name]["bounds"]) for name in LENGTHS}
    bounds |= {name: (linkage[name], mechanism["points"]["P"][k]["bounds"]) for k, name in enumerate(("along", "across"))}
    for name, (value, ends) in bounds.items():
        low, high = (number(text) for text in ends)
        if not low - LIMIT * size <= value <= high + LIMIT * size:
            result.append(f"{name} = {value}, bounds {low}, {high}")
    return result


def number(text: str) -> float:
    """The number of a quantity such as "20 mm"."""
    return float(text.split()[0])


# --- random laws -----------------------------------------------------------------------------------------------------------

POSITIONS = 60  # steps between the design positions of a law, as the program's pages say
MEASURES: dict[str, Callable[[Array], float]] = {
    "sum of squares": lambda errors: float(np.sum(errors**2)),
    "rms": lambda errors: float(np.sqrt(np.mean(errors**2))),
    "max": lambda errors: float(np.max(np.abs(errors))),
}


@dataclass(frozen=True)
class LawTask:
    """A random function y(x) that a rocker or a slider shall generate; `travel` of the output [rad or mm]."""

    raw: Raw
    law: oracle.Law
    turned: float
    travel: float
    measure: str

    def offsets(self, count: int) -> tuple[Array, Array]:
        """Crank rotations from the start, and the output wanted there above that at the least y."""
        _, rises = self.law.offsets(count)
        return self.turned * np.linspace(0.0, 1.0, count), rises * (self.travel / self.law.output_range)


def random_law_task(seed: int, *, slides: bool) -> LawTask:
    """A random law of a four-bar's rocker, or of a slider-crank's slider."""
    rng = np.random.default_rng([78, seed, slides])
    law = oracle.random_law(rng)
    way = float(rng.choice([-1.0, 1.0]))
    turned = way * law.input_range
    measure = str(rng.choice(["sum of squares", "rms", "max"]))
    stated: Raw = {"function": law.expression, "x": [law.low, law.high], "input": f"{turned!r} rad"}
    requirement: Raw = {"kind": "function", "measure": measure}
    limits: Raw = {"crank": "span"}
    if slides:
        travel = float(np.round(rng.uniform(20.0, 80.0), 1)) * float(rng.choice([-1.0, 1.0]))
        stated["output"] = f"{travel!r} mm"
        requirement["output"] = "G"
        mechanism: Raw = {
            "type": "dyads",
            "ground": {"A": ["3 mm", "-5 mm"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": free(10.0, 200.0)},
                "rod": {"joints": ["B", "C"], "length": free(30.0, 500.0)},
                "slider": {"joints": ["C"]},
            },
            "guides": {"G": {"slider": "slider", "through": "A", "direction": "20 deg", "offset": free(-100.0, 100.0)}},
            "assembly": {"C": "either"},
        }
    else:
        travel = law.output_range * float(rng.choice([-1.0, 1.0]))
        stated["output"] = f"{travel!r} rad"
        mechanism = {"type": "four-bar", "frame": "100 mm", **dict.fromkeys(LENGTHS[:3], free(5.0, 2000.0)), "assembly": "either"}
        limits |= {"transmission_angle": ["25 deg", "155 deg"], "link_ratio": [0.05, 20.0]}
    raw = {"title": "t", "mechanism": mechanism, "requirement": {**requirement, "law": stated}, "limits": limits}
    return LawTask(raw, law, turned, travel, measure)


def slider_crank_of(design: LinkageDesign) -> tuple[dict[str, float], float, float]:
    """A slider-crank as the oracle takes it, and the crank angle and slide [mm] at the start."""
    values, raw = design.values, design.problem.raw["mechanism"]
    x, y = (1e3 * values[f"A.{axis}"] for axis in "xy")
    mode = 1 if raw["assembly"]["C"] == "forward" else -1
    linkage = oracle.slider_crank(
        1e3 * values["crank.length"],
        1e3 * values["rod.length"],
        x=x,
        y=y,
        guide=(x, y),
        direction=values["G.direction"],
        offset=1e3 * values["G.offset"],
        mode=mode,
    )
    return linkage, values["start"], 1e3 * values["zero"]


def faults_of_slider(design: LinkageDesign, task: LawTask) -> list[str]:
    """Everything that is wrong with a slider-crank called valid."""
    linkage, phi0, zero = slider_crank_of(design)
    phi, rises = task.offsets(POSITIONS + 1)
    report = oracle.judge_function(linkage, phi0, zero, phi, rises)
    computed = defects(report, turning=False)
    errors, reported = MEASURES[task.measure](report.errors), design.to_dict()["objective"]
    claimed = design.objective * (1e6 if task.measure == "sum of squares" else 1e3)
    figures = {
        "objective": (claimed, errors),
        "rms": (reported["rms_mm"], report.rms),
        "largest": (reported["largest_mm"], report.largest),
    }
    return computed + _apart(figures, abs(task.travel))


def faults_of_rocker(result: optlink.SynthesisResult, task: LawTask) -> list[str]:
    """Everything that is wrong with a four-bar called valid; "max" is that of the whole range."""
    design = result.design
    lengths = [1e3 * design[name] for name in ("frame", "crank", "coupler", "rocker")]
    mode = 1 if result.definite.raw["mechanism"]["assembly"] == "left" else -1
    linkage = oracle.four_bar(*lengths, mode=mode)
    reports = {
        count: oracle.judge_function(linkage, design["phi0"], design["psi0"], *task.offsets(count))
        for count in (POSITIONS + 1, 6001)
    }
    at, dense = reports[POSITIONS + 1], reports[6001]
    outcome = defects(at, turning=False)
    errors = dense.errors if task.measure == "max" else at.errors
    claimed = result.to_dict()["objective"]
    figures = {
        "objective": (result.objective, MEASURES[task.measure](errors)),
        "rms": (math.radians(claimed["rms_deg"]), at.rms),
        "largest": (math.radians(claimed["largest_deg"]), at.largest),
    }
    low, high = transmission_range(linkage, design["phi0"], design["phi0"] + task.turned)
    if low < math.radians(25.0) - LIMIT or high > math.radians(155.0) + LIMIT:
        outcome.append(f"transmission angle {low}, {high}")
    if not all(0.05 * (1.0 - LIMIT) <= length / lengths[0] <= 20.0 * (1.0 + LIMIT) for length in lengths[1:]):
        outcome.append("link ratio")
    return outcome + _apart(figures, 1.0, 1e-6 if task.measure == "max" else FIGURE)


def _apart(figures: Mapping[str, tuple[float, float]], scale: float, share: float = FIGURE) -> list[str]:
    return [
        f"{name}: {one!r} is reported, {other!r} measured"
        for name, (one, other) in figures.items()
        if not abs(one - other) <= share * abs(other) + ROUNDING * scale
    ]
