"""Synthesis: paths against differential evolution, pylinkage and fourbarhinge; round trips; convex first steps; shipped problems.

`python benchmarks/synthesis.py [--parts evolution,peers,first,cases,six-bars,trips] [--seeds N] [--linkages N] [--laws N]
[--json FILE]`

Every measurement runs in a process of its own on one thread (`python synthesis.py NAME ARGUMENTS` prints its figures), after one
small search that imports and compiles. Seconds are processor seconds, those that a clock on the wall shows if nobody else is at
work; a peer is stopped after `LIMIT`. Errors are not taken from their makers but from `tests/synthesis_oracle.py`, which has
nothing of optlink and nothing of a peer.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rows import show
from timing import ERROR, RESULT, ROOT, Row

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Figures = dict[str, Any]

SEEDS, LINKAGES, LAWS = 10, 3, 100  # of the public cases; per count of points; of the convex step
LIMIT = 120.0  # s for one search of a peer
TURN = 2.0 * math.pi

# The assembly modes are those of the best known designs: evolution need not find them. Value in mm^2.
EVOLVED = {"path-closed18": -1, "path-ellipse10": -1}
EVOLUTIONS = 5  # seeds
LONGER = 30  # times our time, beyond the target of NEARER: a search that was stopped there has decided it
NEARER = ">= 20"
KNOWN = 1e-6  # share of the best known value up to which it is known; who is nearer counts as this far away
# The better of these counts, each having the whole time. Populations of 100, CR 0.3, pymoo's defaults (CR 0.2, F 0.5) and ordered
# crank angles as variables, instead of the nearest point of the curve, all did worse.
VARIANTS = ("DE/best/1/bin", "DE/rand/1/bin")
WAYS = {"population": 50, "CR": 0.9, "F": 0.6}
SAMPLES, CORRECTIONS = 120, 3  # of a curve on which the nearest points are searched; Newton steps from the nearest sample

COUNTS = (5, 9, 18, 60)  # points of the round trips
PEER_COUNTS = (5, 9)
TIMINGS = {
    "from start": "timed up to a start angle",
    "given": "timed",
    "even": "untimed, from even crank angles",
    "uneven": "untimed, from uneven crank angles",
}
LENGTHS, FAR = (5.0, 500.0), 1000.0  # mm; of the round trips: links, and how far the crank pivot is from the points' centre
PASSES, NEAR = 1e-8, 0.05  # of the points' size: error that is none; pylinkage's own tolerance
README_POINTS = ((0.0, 0.0), (1.0, 1.0), (2.0, 1.0), (3.0, 0.0))  # of pylinkage
README_HINGE = ((90, 10), (92, 25), (88, 40), (78, 54), (62, 64), (42, 70), (22, 70))  # of fourbarhinge
HINGE_LENGTHS, HINGE_PIVOT, HINGE_STARTS = (15.0, 120.0), (40.0, -10.0), 60

SIX_BARS, SIX_BAR_POINTS = 2, 12  # random paths for free six-bars, Watt I and Stephenson III in turn

STEPS, FEW, MANY = 5, 5, 48  # per assembly mode: convex first steps, as many random starts, and those of the large search
SAME = 1e-3  # share of the best error, and with it the best design
CASES = (
    *("path-vline6", "path-arc5", "path-closed18", "path-closed18-untimed", "path-ellipse10"),
    *("path-bean", "path-conveyor", "path-scott-russell", "path-slider-egg", "path-watt-leg", "path-stephenson-dwell"),
    *("motion-3-poses", "motion-3-poses-region", "motion-5-poses"),
    *("function-log10", "function-sin", "function-exp", "transmission-optimal"),
    *("shaper-design", "press-toggle"),
)


# --- measurements, each in a process of its own ----------------------------------------------------------------------


def clocked(run: Callable[[], Any]) -> tuple[Any, float, float]:
    """What a function returns, the processor's seconds, and those of a clock on the wall."""
    wall, begin = time.perf_counter(), sum(os.times()[:4])  # of this process and of those that it started and ended
    found = run()
    return found, sum(os.times()[:4]) - begin, time.perf_counter() - wall


def warm() -> None:
    """Import and compile what a search needs."""
    import optlink

    optlink.solve(optlink.load("path-vline6"), seed=99)


def median(values: Iterable[float]) -> float:
    return statistics.median(list(values))


# Differential evolution


def coupler_point(v: Mapping[str, Array], side: float, theta: Array) -> tuple[Complex, Complex]:
    """Coupler points and their rates by the crank angle, by complex numbers; a linkage that does not close is clipped."""
    pin = v["crank"] * np.exp(1j * theta)
    to_d = v["frame"] - pin
    long = np.abs(to_d)
    foot = (v["coupler"] ** 2 - v["rocker"] ** 2 + long**2) / (2.0 * long)
    coupler = (foot + 1j * side * np.sqrt(np.maximum(v["coupler"] ** 2 - foot**2, 0.0))) * to_d / long
    rocker = to_d - coupler
    rate = -(np.conj(1j * pin) * rocker).real / (np.conj(1j * coupler) * rocker).real
    arm = (v["P.along"] + 1j * v["P.across"]) * coupler / v["coupler"]
    turn = np.exp(1j * v["direction"])
    return v["A.x"] + 1j * v["A.y"] + turn * (pin + arm), turn * 1j * (pin + rate * arm)


def path_problem(name: str, side: float) -> Any:
    """A public case as pymoo takes it: same variables, bounds and limits, a population at a time; lengths in mm.

    Where timing is free each point counts with its distance to the nearest point of the curve; the order is not asked.
    """
    from pymoo.core.problem import Problem

    import optlink

    task: Any = optlink.load(name).model
    names = list(task.free)
    unit = [1e3 if task.quantities[each].kind != "angle" and each != "start" else 1.0 for each in names]
    bounds = np.array([task.quantities[each].bounds for each in names]) * np.array(unit)[:, None]
    points = (task.data.columns[:, 0] + 1j * task.data.columns[:, 1]) * 1e3
    offsets, ratio = task.data.offsets, task.limits.link_ratio
    grid = np.arange(SAMPLES) * TURN / SAMPLES

    class PathProblem(Problem):  # type: ignore[misc]
        def _evaluate(self, x: Array, out: dict[str, Array], *_args: Any, **_more: Any) -> None:
            v = {each: x[:, i, None] for i, each in enumerate(names)}
            with np.errstate(all="ignore"):
                if offsets is not None:
                    found = coupler_point(v, side, v["start"] + offsets)[0]
                else:
                    theta = grid[np.argmin(np.abs(coupler_point(v, side, grid)[0][:, :, None] - points), axis=1)]
                    for _ in range(CORRECTIONS):
                        found, rate = coupler_point(v, side, theta)
                        step = (np.conj(rate) * (found - points)).real / np.abs(rate) ** 2
                        theta = theta - np.clip(step, -TURN / SAMPLES, TURN / SAMPLES)
                    found = coupler_point(v, side, theta)[0]
                total = np.sum(np.abs(found - points) ** 2, axis=1)
            out["F"] = np.where(np.isfinite(total), total, 1e30)[:, None]
            links = x[:, [names.index(each) for each in ("crank", "coupler", "rocker", "frame")]]
            shares = links / links[:, 3:]
            others = np.sort(shares[:, 1:], axis=1)
            crank = shares[:, 0]
            limits = [crank - others[:, 0], crank + others[:, 2] - others[:, 0] - others[:, 1]]
            limits += [ratio.low - np.min(shares, axis=1), np.max(shares, axis=1) - ratio.high]
            out["G"] = np.stack(limits, axis=1)

    return PathProblem(n_var=len(names), n_obj=1, n_ieq_constr=4, xl=bounds[:, 0], xu=bounds[:, 1])


def evolution(name: str, seed: str) -> Figures:
    """A search of ours, and differential evolution for that time and `LONGER` times as long; values in mm^2."""
    import optlink

    problem: Any = optlink.load(name)
    best = 1e6 * problem.model.expected.objective
    warm()
    ours, seconds, wall = clocked(lambda: optlink.solve(problem, seed=int(seed)))
    figures: Figures = {"seconds": seconds, "wall": wall, "value": 1e6 * ours.objective, "best": best, "peers": []}
    try:
        from pymoo.algorithms.soo.nonconvex.de import DE
        from pymoo.core.termination import NoTermination
    except ModuleNotFoundError:
        return figures
    for variant in VARIANTS:
        algorithm = DE(pop_size=WAYS["population"], variant=variant, CR=WAYS["CR"], F=WAYS["F"])
        begin, trace = time.process_time(), list[tuple[float, float]]()
        algorithm.setup(path_problem(name, EVOLVED[name]), termination=NoTermination(), seed=int(seed), verbose=False)
        at = 0.0
        while at < LONGER * seconds:
            algorithm.next()
            one, at = algorithm.opt[0], time.process_time() - begin
            if one.CV[0] <= 0.0 and (not trace or one.F[0] < trace[-1][1]):
                trace.append((at, float(one.F[0])))

        def reached(until: float, known: list[tuple[float, float]] = trace) -> float:
            return min((value for at, value in known if at <= until), default=math.inf)

        near = next((at for at, value in trace if value <= 1.01 * best), None)
        equal, longer = reached(seconds), reached(LONGER * seconds)
        figures["peers"].append({"equal": equal, "longer": longer, "near": near, "evaluations": algorithm.evaluator.n_eval})
    return figures


# Round trips and the peers' own cases


def mm(value: float) -> str:
    return f"{value!r} mm"


def free(low: float, high: float, unit: str = "mm") -> dict[str, list[str]]:
    return {"bounds": [f"{low!r} {unit}", f"{high!r} {unit}"]}


def path_file(
    points: Iterable[Iterable[float]], links: tuple[float, float], far: float, crank: Array | None = None, timing: str = "even"
) -> dict[str, Any]:
    """A problem file as a mapping: every size of a four-bar free, the pivot within `far` [mm] of the points' centre."""
    rows = np.array(list(points), dtype=float)
    x, y = np.mean(rows, axis=0)
    arm = free(-links[1], links[1])
    mechanism = {
        "type": "four-bar",
        **dict.fromkeys(("crank", "coupler", "rocker", "frame"), free(*links)),
        "points": {"P": [arm, arm]},
        "pivot": [free(float(x) - far, float(x) + far), free(float(y) - far, float(y) + far)],
        "direction": free(-180.0, 180.0, "deg"),
        "assembly": "either",
    }
    wanted: list[dict[str, str]] = [{"x": mm(float(row[0])), "y": mm(float(row[1]))} for row in rows]
    requirement: dict[str, Any] = {"kind": "path", "points": wanted}
    if crank is not None:
        shown = np.degrees(crank - (crank[0] if timing == "from start" else 0.0))
        for each, angle in zip(wanted, shown.tolist(), strict=True):
            each["crank"] = f"{angle!r} deg"
        requirement["timing"] = timing
    return {"title": "Round trip", "source": "", "about": "", "mechanism": mechanism, "requirement": requirement}


def hinge_file() -> dict[str, Any]:
    """The case of fourbarhinge's README: both pivots given, the crank need not turn."""
    file = path_file(README_HINGE, HINGE_LENGTHS, 0.0)
    x, y = HINGE_PIVOT
    given = {"frame": mm(math.hypot(x, y)), "direction": f"{math.degrees(math.atan2(y, x))!r} deg", "pivot": ["0 mm", "0 mm"]}
    file["mechanism"] |= given
    return file | {"limits": {"crank": "span", "transmission_angle": ["30 deg", "150 deg"]}}


def planted(seed: int, count: int, timing: str) -> tuple[dict[str, float], Array, Array]:
    """A random proper crank-rocker, crank angles (count,) [rad] once round, and the points (count, 2) [mm] met there."""
    from tests import synthesis_oracle as oracle

    rng = np.random.default_rng(seed)
    linkage = oracle.random_crank_rocker(rng)
    way, begin = rng.choice([-1.0, 1.0]), rng.uniform(0.0, TURN)
    even, uneven = np.arange(count) * (TURN / count), oracle.random_angles(rng, count)
    angles = begin + way * (uneven - uneven[0] if timing == "uneven" else even)
    return linkage, angles, oracle.planted_path(linkage, angles)


def extent(points: Array) -> float:
    return float(np.hypot(*np.ptp(points, axis=0)))


def tried(case: str, seed: int, count: int) -> tuple[Array, Array | None]:
    """Points [mm] of a case and, if it is timed, the crank angles."""
    if case in ("pylinkage", "fourbarhinge"):
        return np.array(README_POINTS if case == "pylinkage" else README_HINGE, dtype=float), None
    _, angles, points = planted(seed, count, case)
    return points, angles if case == "given" else None


def off(linkage: Mapping[str, float], points: Array) -> float:
    """Root mean square distance of points to a curve over their size, order not asked; the better one of both modes counts."""
    from tests import synthesis_oracle as oracle

    each = [oracle.distance_to_curve(points, {**linkage, "mode": mode})[0] for mode in (1, -1)]
    return min(math.sqrt(float(np.mean(distances**2))) for distances in each) / extent(points)


def judged(design: Any, points: Array, timed: Array | None, *, closed: bool) -> Any:
    """One of our designs before the oracle: met at its own crank angles, in order, without defects, at the angles asked for."""
    from tests import synthesis_oracle as oracle

    found = design.coupler_linkage
    sizes = {key: 1e3 * getattr(found, key) for key in ("frame", "crank", "coupler", "rocker", "along", "across", "x", "y")}
    linkage = oracle.four_bar(**sizes, direction=found.direction, mode=found.side)
    return oracle.judge_path(linkage, points, design.crank_angles, closed=closed, timed=timed)


def ours(case: str, seed: str, count: str) -> Figures:
    """Our best design for a case: seconds, and its error over the size."""
    import optlink

    points, angles = tried(case, int(seed), int(count))
    if case == "fourbarhinge":
        file = hinge_file()
    elif case == "pylinkage":
        file = path_file(points, (0.1, 30.0), 30.0) | {"limits": {"link_ratio": [0.1, 10.0]}}
    else:
        file = path_file(points, LENGTHS, FAR, angles, case)
    warm()
    found, seconds, wall = clocked(lambda: optlink.solve(optlink.read(file)))
    figures: Figures = {"seconds": seconds, "wall": wall, "error": math.inf, "designs": len(found.designs), "valid": found.valid}
    if found.valid:
        report = judged(found.best, points, angles, closed=case in TIMINGS)
        if case == "fourbarhinge" or report.free:
            figures["error"] = math.sqrt(float(np.mean(report.errors**2))) / extent(points)
    return figures


def pylinkage(case: str, seed: str, count: str) -> Figures:
    """All that it returns; `error` of the best one, `wrong` those beyond its own tolerance of 5 %."""
    from pylinkage.synthesis import path_generation, path_generation_with_timing

    from tests import synthesis_oracle as oracle

    warnings.simplefilter("ignore")
    points, angles = tried(case, int(seed), int(count))
    path_generation(list(README_POINTS))  # compiles
    wanted = [(x, y) for x, y in points.tolist()]
    if angles is not None:
        found, seconds, wall = clocked(lambda: path_generation_with_timing(wanted, angles.tolist()))
    else:
        found, seconds, wall = clocked(lambda: path_generation(wanted))
    errors = []
    for one in found.raw_solutions:
        a, b, c, d, p = (complex(*xy) for xy in (one[0], one[2], one[3], one[1], one.coupler_point))
        arm = (p - b) * abs(c - b) / (c - b)
        place = {"x": a.real, "y": a.imag, "along": arm.real, "across": arm.imag, "direction": float(np.angle(d - a))}
        errors.append(off(oracle.four_bar(abs(d - a), abs(b - a), abs(c - b), abs(d - c), **place), points))
    wrong = sum(not error <= NEAR for error in errors)
    return {"seconds": seconds, "wall": wall, "error": min(errors, default=math.inf), "designs": len(errors), "wrong": wrong}


def fourbarhinge(case: str, seed: str, count: str) -> Figures:
    """Its best design from as many starts as its README takes; bounds as ours, its other options as they are."""
    from fourbarhinge import CouplerPathSynthesis, LinkBounds, Point as Place

    from tests import synthesis_oracle as oracle

    warnings.simplefilter("ignore")
    points, angles = tried(case, int(seed), int(count))
    if case == "fourbarhinge":
        low, high = HINGE_LENGTHS
        bounds = LinkBounds(min_length=low, max_length=high, min_transmission_angle=math.radians(30.0))
        pivots = {"ground_pivot_a": Place(x=0.0, y=0.0), "ground_pivot_d": Place(x=HINGE_PIVOT[0], y=HINGE_PIVOT[1])}
        search = CouplerPathSynthesis(points, bounds, **pivots)
    else:
        bounds = LinkBounds(min_length=LENGTHS[0], max_length=LENGTHS[1], min_transmission_angle=0.0)
        search = CouplerPathSynthesis(points, bounds, theta_inputs=angles)
    found, seconds, wall = clocked(lambda: search.solve(n_starts=HINGE_STARTS))
    p = found.params
    place = {"x": p["ax"], "y": p["ay"], "along": p["u"], "across": p["v"], "direction": p["theta_ground"]}
    error = off(oracle.four_bar(p["lg"], p["li"], p["lc"], p["lo"], **place), points)
    return {"seconds": seconds, "wall": wall, "error": error, "designs": 1}


def trips(timing: str, count: str, linkages: str) -> Figures:
    """Round trips: share recovered to `PASSES` and free of defects before the oracle, and seconds of each."""
    import optlink

    warm()
    seconds, walls, errors, missed = [], [], [], []
    for seed in range(int(linkages)):
        _, angles, points = planted(seed, int(count), timing)
        asked = angles if timing in ("given", "from start") else None
        file = path_file(points, LENGTHS, FAR, asked, timing)
        if asked is None:
            file["requirement"]["closed"] = True
        found, one, wall = clocked(lambda file=file: optlink.solve(optlink.read(file)))  # type: ignore[misc]
        seconds.append(one)
        walls.append(wall)
        error = math.inf
        if found.valid:
            report = judged(found.best, points, asked, closed=True)
            if report.free and report.timing <= PASSES:
                error = math.sqrt(float(np.mean(report.errors**2))) / extent(points)
        errors.append(error)
        if error > PASSES:
            missed.append(seed)
    return {"seconds": seconds, "wall": walls, "errors": errors, "missed": missed}


# Convex first steps


def law_file(law: Any, side: str) -> dict[str, Any]:
    """The smallest largest error for a random law; its own range of ratios and transmission angles."""
    links = {"start": "100 mm", "bounds": ["5 mm", "2000 mm"]}
    starts = {"start": "60 deg", "bounds": ["-180 deg", "180 deg"]}
    spans = {"input": f"{math.degrees(law.input_range)!r} deg", "output": f"{math.degrees(law.output_range)!r} deg"}
    return {
        "title": law.name,
        "source": "",
        "about": "",
        "mechanism": {"type": "four-bar", "frame": "100 mm", "assembly": side, "crank": links, "coupler": links, "rocker": links},
        "requirement": {
            "kind": "function",
            "law": {"function": law.expression, "x": [law.low, law.high], **spans},
            "from": starts,
            "psi0": starts,
            "measure": "max",
        },
        "limits": {"crank": "span", "transmission_angle": ["30 deg", "150 deg"], "link_ratio": [0.05, 20.0]},
    }


def first(laws: str) -> Figures:
    """Best error [rad] of every random law from the convex first steps and from random starts, and processor seconds."""
    import optlink
    from optlink.optimization.programme import build
    from optlink.solvers import multistart as search
    from optlink.synthesis import freudenstein
    from tests import synthesis_oracle as oracle

    rng = np.random.default_rng(7)
    figures: Figures = {key: [] for key in ("steps", "random", "steps_seconds", "convex_seconds", "random_seconds", "one")}
    warm()
    for _ in range(int(laws)):
        law = oracle.random_law(rng, monotone=True)
        row: dict[str, list[list[float]]] = {"steps": [], "random": []}
        spent = dict.fromkeys(("convex", "steps", "random"), 0.0)
        one = (math.inf, math.inf)  # error of the best first step, and what its own search makes of it
        for side in ("left", "right"):
            problem = optlink.read(law_file(law, side)).spec
            nlp = build(problem)
            search.prepare(nlp, "ipopt")
            found, taken, _ = clocked(lambda problem=problem: freudenstein.steps(problem))  # type: ignore[misc]
            spent["convex"] += taken
            begin = [nlp.x_of(freudenstein.values(problem, step)) for step in found]
            drawn = []
            for _draw in range(MANY):  # lengths evenly in their logarithm
                lengths = 1e-3 * np.exp(rng.uniform(math.log(5.0), math.log(2000.0), 3))
                sizes = dict(zip(("crank", "coupler", "rocker"), lengths.tolist(), strict=True))
                angles = rng.uniform(-math.pi, math.pi, 2)
                drawn.append(nlp.x_of({**sizes, **dict(zip(("phi0", "psi0"), angles.tolist(), strict=True))}))
            for what, starts in (("steps", begin), ("random", drawn)):
                ends, taken, _ = clocked(lambda nlp=nlp, starts=starts: [search.solve_from(nlp, x, "ipopt") for x in starts])  # type: ignore[misc]
                spent[what] += taken
                row[what].append([float(end.objective) if end.usable else math.inf for end in ends])
            if found and found[0].error < one[0]:
                one = found[0].error, row["steps"][-1][0]
        for what in ("steps", "random"):
            figures[what].append(row[what])
        figures["one"].append(one)
        for what, taken in spent.items():
            figures[f"{what}_seconds"].append(taken)
    return figures


# Public cases


def case(name: str, seeds: str) -> Figures:
    """Values [SI] and seconds of a shipped problem with default options, one for each seed."""
    import optlink

    problem: Any = optlink.load(name)
    expected = problem.model.expected
    warm()
    figures: Figures = {"values": [], "seconds": [], "wall": [], "valid": []}
    figures |= {"best": expected.objective, "tolerance": expected.objective_tolerance}
    for seed in range(int(seeds)):
        found, seconds, wall = clocked(lambda seed=seed: optlink.solve(problem, seed=seed))  # type: ignore[misc]
        figures["values"].append(found.objective)
        figures["seconds"].append(seconds)
        figures["wall"].append(wall)
        figures["valid"].append(found.valid)
    return figures


def six_bar(seed: str) -> Figures:
    """Rms error [mm], and seconds, of a six-bar for a random path, every dimension free."""
    import optlink
    from tests.random_six_bars import random_six_bar

    task = random_six_bar(int(seed), SIX_BAR_POINTS)
    file = task.file
    warm()
    found, seconds, wall = clocked(lambda: optlink.solve(file))
    error = math.sqrt(found.objective / SIX_BAR_POINTS) / 1e-3 if found.valid else math.inf  # mm
    return {"seconds": seconds, "wall": wall, "error": error, "watt": task.watt, "starts": found.starts}


MEASUREMENTS: dict[str, Callable[..., Figures]] = {
    "evolution": evolution,
    "ours": ours,
    "pylinkage": pylinkage,
    "fourbarhinge": fourbarhinge,
    "trips": trips,
    "first": first,
    "case": case,
    "six_bar": six_bar,
}


# --- rows ---------------------------------------------------------------------------------------------------------------


def measured(name: str, *arguments: object, limit: float | None = None) -> Figures | None:
    """Figures of a measurement in a process of its own; none where its peer is not installed; "over" if it was stopped."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    command = [sys.executable, str(Path(__file__).resolve()), name, *map(str, arguments)]
    try:
        done = subprocess.run(
            command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=limit, env={**os.environ, **threads}
        )
    except subprocess.TimeoutExpired:
        return {"over": limit, "seconds": limit, "error": math.inf}
    if done.returncode == 0:
        return dict(json.loads(done.stdout.splitlines()[-1]))
    if f"No module named '{name}" in done.stderr:
        return None
    raise RuntimeError(done.stderr)


def took(seconds: float) -> str:
    return f"{1e3 * seconds:.0f} ms" if seconds < 1.0 else f"{seconds:.2f} s"


def digits(value: float) -> str:
    return f"{value:.2g}" if math.isfinite(value) else "none"


def finite(**figures: float) -> dict[str, float]:
    """Those that a JSON document can hold."""
    return {name: value for name, value in figures.items() if math.isfinite(value)}


def spread(found: Figures) -> str:
    return f"slowest {max(found['seconds']):.2f} s; median by the wall {median(found['wall']):.2f} s"


def evolution_rows(seeds: int = EVOLUTIONS) -> list[Row]:
    """Value less the best known, at our time and longer; time to within 1 % of it."""
    result = []
    for name in EVOLVED:
        found = [figures for seed in range(seeds) if (figures := measured("evolution", name, seed))]
        best, own = found[0]["best"], median(each["seconds"] for each in found)
        least = KNOWN * best
        excess = median(max(each["value"] - best, least) for each in found)
        what = f"{name}, against pymoo's differential evolution"
        if not found[0]["peers"]:
            result.append(Row(what, took(own), "skipped", target=">= 10", note="pymoo is not installed"))
            continue
        for key, times in (("equal", 1), ("longer", LONGER)):
            each_best = [min(peer[key] for peer in each["peers"]) for each in found]
            theirs = median(value - best for value in each_best)
            note = (
                f"value less the best known, {best:.6g} mm^2; medians of {seeds} seeds; their best value {digits(min(each_best))}"
            )
            figures = finite(ours=excess, theirs=theirs, seconds=own)
            shown = f"< {excess:.1g} mm^2" if excess <= least else f"{excess:.1g} mm^2", f"{theirs:.2g} mm^2"
            target, about = ">= 10" if key == "equal" else "", f"{what}: error after {times} x our time"
            result.append(Row(about, *shown, theirs / excess, target, note, figures=figures, kind=ERROR))
        near = [min((peer["near"] for peer in each["peers"] if peer["near"]), default=None) for each in found]
        hits = [seconds for seconds in near if seconds]
        floor = median(seconds or LONGER * each["seconds"] for seconds, each in zip(near, found, strict=True))
        shown_theirs = f"> {floor:.3g} s" if 2 * len(hits) <= len(found) else f"{floor:.3g} s"
        note = f"differential evolution comes there with {len(hits)} of {seeds} seeds within {LONGER} x our time"
        figures, cut = finite(ours=own, theirs=floor, hits=len(hits)), 2 * len(hits) <= len(found)
        about = f"{what}: time to within 1 %"
        result.append(Row(about, took(own), shown_theirs, floor / own, NEARER, note, figures=figures, cut=cut))
    return result


def peer_row(peer: str, case: str, count: int, linkages: int) -> Row:
    """One of the peers against ours on the same points."""
    own = case in ("pylinkage", "fourbarhinge")
    about = f"README case of {case}" if own else f"round trips, {count} points, {TIMINGS[case]}"
    what = f"{about}: against {peer}"
    runs = range(1 if own else linkages)
    mine = [measured("ours", case, seed, count) or {} for seed in runs]
    theirs = [figures for seed in runs if (figures := measured(peer, case, seed, count, limit=LIMIT))]
    seconds, error = median(each["seconds"] for each in mine), median(each["error"] for each in mine)
    if not theirs:
        return Row(what, took(seconds), "skipped", target=">= 50", note=f"{peer} is not installed")
    taken, miss = median(each["seconds"] for each in theirs), median(each["error"] for each in theirs)
    over = sum("over" in each for each in theirs)
    note = f"error over the points' size: ours {digits(error)}, theirs {digits(miss)}"
    answers = sum(each.get("designs", 0) for each in theirs)
    if not answers and not over:
        note += "; it gives no answer"
    elif peer == "pylinkage":
        note += f"; of its {answers} answers {sum(each.get('wrong', 0) for each in theirs)} miss the points by more than 5 %"
    elif not own:
        exact = sum(each["error"] <= PASSES for each in theirs)
        note += f"; it recovers {exact} of {len(theirs)}, we {sum(each['error'] <= PASSES for each in mine)}"
    if over:
        note += f"; {over} stopped after {LIMIT:.0f} s"
    shown = took(seconds), ("> " if 2 * over > len(theirs) else "") + took(taken)
    figures = finite(ours=seconds, theirs=taken, error=error, their_error=miss)
    ratio = taken / seconds if answers or over else math.nan  # to give up is no achievement
    return Row(what, *shown, ratio, ">= 50", note, figures=figures, cut=2 * over > len(theirs))


def peer_rows(linkages: int = LINKAGES) -> list[Row]:
    """Both peers on their own README cases and on round trips."""
    result = []
    for peer in ("pylinkage", "fourbarhinge"):
        result.append(peer_row(peer, peer, 0, 1))
        for timing in ("even", "given"):
            result += [peer_row(peer, timing, count, linkages) for count in PEER_COUNTS]
    return result


def first_rows(laws: int = LAWS) -> list[Row]:
    """How often the convex first steps bring the best design, beside random starts."""
    found = measured("first", laws) or {}
    sets = ("steps", STEPS), ("random", FEW), ("random", MANY)
    reach = [[min(min(side[:count], default=math.inf) for side in row) for row in found[what]] for what, count in sets]
    table, one = np.array(reach), np.array(found["one"])
    solved = np.isfinite(np.min(table, axis=0))
    best = np.min(table, axis=0)[solved]
    enough = (1.0 + SAME) * best + 1e-9
    share = [float(np.mean(row[solved] <= enough)) for row in table]
    alone = float(np.mean(one[solved, 1] <= enough))
    extra = float(np.median(one[solved, 0] / best)) - 1.0
    step, local, many = (median(found[f"{key}_seconds"]) for key in ("convex", "steps", "random"))
    about = (
        f"{best.size} of {laws} laws have a linkage; from the best step alone {100 * alone:.0f} %; "
        f"that step lies {100 * extra:.0f} % above the best (median)"
    )
    result = []
    for theirs, seconds, starts in ((share[1], many * FEW / MANY, 2 * FEW), (share[2], many, 2 * MANY)):
        note = (
            f"{about}; ms per law: {1e3 * step:.0f} for {2 * STEPS} steps and {1e3 * local:.0f} for the searches from them, "
            f"theirs {1e3 * seconds:.0f}"
        )
        figures = finite(share=share[0], their_share=theirs, alone=alone, ours=step + local, theirs=seconds, convex=step)
        shown = f"{100 * share[0]:.0f} %", f"{100 * theirs:.0f} %"
        what = f"functions, {laws} random laws: best found by convex first steps, and by {starts} random starts"
        result.append(Row(what, *shown, share[0] / theirs if theirs else math.nan, "", note, figures=figures, kind=RESULT))
    return result


def case_rows(seeds: int = SEEDS) -> list[Row]:
    """The shipped problems with default options."""
    result = []
    for name in CASES:
        found = measured("case", name, seeds) or {}
        best, tolerance = found["best"], found["tolerance"] or 0.0
        pairs = zip(found["values"], found["valid"], strict=True)
        good = [valid and value <= best + tolerance for value, valid in pairs]
        value, seconds = median(found["values"]), median(found["seconds"])
        note = (
            f"best known reached with {sum(good)} of {seeds} seeds; value {value:.9g}, best known {best:.9g}, SI; {spread(found)}"
        )
        figures = finite(ours=seconds, value=value, best=best, reached=sum(good), seeds=seeds, slowest=max(found["seconds"]))
        result.append(Row(f"optlink solve {name}", took(seconds), "", note=note, figures=figures))
    return result


def six_bar_rows(count: int = SIX_BARS) -> list[Row]:
    """Six-bars for random paths, every dimension free."""
    result = []
    for seed in range(count):
        found = measured("six_bar", seed) or {}
        name = "Watt I" if found["watt"] else "Stephenson III"
        note = f"{found['starts']} starts; rms error {digits(found['error'])} mm; by the wall {found['wall']:.1f} s"
        figures = finite(ours=found["seconds"], wall=found["wall"], error=found["error"])
        what = f"free six-bar {name}, random path of {SIX_BAR_POINTS} points"
        result.append(Row(what, took(found["seconds"]), "", note=note, figures=figures))
    return result


def trip_rows(linkages: int = LINKAGES) -> list[Row]:
    """Round trips: a linkage's own points, given back to the search."""
    result = []
    for timing, words in TIMINGS.items():
        for count in COUNTS:
            found = measured("trips", timing, count, linkages) or {}
            good = linkages - len(found["missed"])
            seconds = median(found["seconds"])
            note = f"{good} of {linkages} recovered to {PASSES:.0e} of the size, free of defects; {spread(found)}"
            if found["missed"]:
                note += f"; missed: {', '.join(map(str, found['missed']))}"
            figures = finite(ours=seconds, recovered=good, linkages=linkages, slowest=max(found["seconds"]))
            result.append(Row(f"round trips, {count} points, {words}", took(seconds), "", note=note, figures=figures))
    return result


def rows(seeds: int = SEEDS, linkages: int = LINKAGES, laws: int = LAWS, parts: Iterable[str] = ()) -> list[Row]:
    """All parts, or those that are named."""
    every: dict[str, Callable[[], list[Row]]] = {
        "evolution": lambda: evolution_rows(min(seeds, EVOLUTIONS)),
        "peers": lambda: peer_rows(linkages),
        "first": lambda: first_rows(laws),
        "cases": lambda: case_rows(seeds),
        "six-bars": six_bar_rows,
        "trips": lambda: trip_rows(linkages),
    }
    return [row for name in (parts or every) for row in every[name]()]


def main() -> None:
    """Measure, print one table, write the JSON document if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", default="", help="evolution, peers, first, cases, six-bars, trips; left out: all")
    for name, value in (("seeds", SEEDS), ("linkages", LINKAGES), ("laws", LAWS)):
        parser.add_argument(f"--{name}", type=int, default=value)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there as well")
    given = parser.parse_args()
    parts = [part for part in given.parts.split(",") if part]
    show({"synthesis": rows(given.seeds, given.linkages, given.laws, parts)}, given.json)


if __name__ == "__main__":
    sys.path.insert(0, os.fspath(ROOT))
    if len(sys.argv) > 1 and sys.argv[1] in MEASUREMENTS:
        print("\n" + json.dumps(MEASUREMENTS[sys.argv[1]](*sys.argv[2:])))
    else:
        main()
