"""Positions of a batch of four-bars: joints B and C of DESIGNS designs at ANGLES crank angles.

Every contender runs in a process of its own (`python batch.py NAME` prints its median seconds): how fast memory is
handed out depends on what the process did before, and nobody shall profit from another's arrays.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from timing import ROOT, Row, child, race

Array = NDArray[np.float64]

DESIGNS, ANGLES = 1000, 360
STEP = 2.0 * np.pi / ANGLES
PHI = np.arange(ANGLES) * STEP
REPETITIONS, ROUNDS = 15, 3
PORTION = 127  # designs whose intermediate arrays stay in the cache of a processor

# Operations on full arrays in `Mechanism.pose` of a four-bar, counted in its formulas: the crank pin takes 2 products
# and 2 sums; the dyad 10 products, 5 sums, 4 differences, 1 quotient, 1 root. One value per design is not counted.
OPERATIONS: tuple[tuple[np.ufunc, int], ...] = (
    (np.add, 7),
    (np.subtract, 4),
    (np.multiply, 12),
    (np.divide, 1),
)  # and one np.sqrt


def designs() -> dict[str, Array]:
    """Random crank-rockers [m], each size of shape (designs, 1)."""
    rng = np.random.default_rng(0)
    ranges = {"crank": (0.08, 0.12), "coupler": (0.40, 0.50), "rocker": (0.35, 0.45), "frame": (0.45, 0.55)}
    return {name: rng.uniform(*limits, (DESIGNS, 1)) for name, limits in ranges.items()}


def whole(sizes: dict[str, Array]) -> Callable[[], object]:
    """One call of the pose formula on full arrays, as the formulas are used inside a programme."""
    from optlink.linkage.fourbar import four_bar

    linkage = four_bar()
    return lambda: linkage.pose(sizes, (np.cos(PHI), np.sin(PHI)))


def portions(sizes: dict[str, Array]) -> Callable[[], object]:
    """The pose formula on portions that stay in the cache, gathered in one array."""
    from optlink.linkage.fourbar import four_bar

    linkage, crank = four_bar(), (np.cos(PHI), np.sin(PHI))

    def run() -> tuple[Array, Array]:
        points, margins = np.empty((2, 2, DESIGNS, ANGLES)), np.empty((DESIGNS, ANGLES))
        for first in range(0, DESIGNS, PORTION):
            part = slice(first, first + PORTION)
            pose = linkage.pose({name: size[part] for name, size in sizes.items()}, crank)
            for k, name in enumerate("BC"):
                points[k, 0, part], points[k, 1, part] = pose.points[name]
            margins[part] = pose.margins["C"]
        return points, margins

    return run


def bare() -> Callable[[], object]:
    """As many bare ufunc calls on arrays of that shape, each result thrown away at once: what numpy takes for them."""
    x, y = np.random.default_rng(1).uniform(1.0, 2.0, (2, DESIGNS, ANGLES))

    def run() -> None:
        np.cos(PHI), np.sin(PHI)
        for ufunc, count in OPERATIONS:
            for _ in range(count):
                ufunc(x, y)
        np.sqrt(x)

    return run


def compiled(sizes: dict[str, Array]) -> Callable[[], object]:
    """The same formulas as one loop over designs and angles, compiled by numba, in one thread: what a processor can do."""
    import numba

    @numba.njit
    def loop(r: Any, a: Any, b: Any, f: Any, c: Any, s: Any) -> Any:
        points, margins = np.empty((2, 2, DESIGNS, ANGLES)), np.empty((DESIGNS, ANGLES))
        for i in range(DESIGNS):
            sum_of_squares, double = 0.5 * (a[i] * a[i] - b[i] * b[i]), a[i] * a[i]
            for k in range(ANGLES):
                bx, by = r[i] * c[k], r[i] * s[k]
                dx, dy = f[i] - bx, -by
                inverse = 1.0 / (dx * dx + dy * dy)
                foot = 0.5 + sum_of_squares * inverse
                margin = double * inverse - foot * foot
                height = np.sqrt(margin)
                points[0, 0, i, k], points[0, 1, i, k] = bx, by
                points[1, 0, i, k], points[1, 1, i, k] = bx + foot * dx - height * dy, by + foot * dy + height * dx
                margins[i, k] = margin
        return points, margins

    lengths = [np.ascontiguousarray(sizes[name][:, 0]) for name in ("crank", "coupler", "rocker", "frame")]

    def run() -> Any:
        return loop(*lengths, np.cos(PHI), np.sin(PHI))

    np.testing.assert_allclose(run()[0], portions(sizes)()[0], rtol=0.0, atol=1e-12)  # type: ignore[index]
    return run


def formulas(sizes: dict[str, Array]) -> Callable[[], object]:
    """The same formulas written out for numpy, no toolkit around them."""
    r, a, b, f = (sizes[name] for name in ("crank", "coupler", "rocker", "frame"))

    def run() -> tuple[Array, ...]:
        bx, by = 0.0 + r * np.cos(PHI), 0.0 + r * np.sin(PHI)
        dx, dy = f - bx, 0.0 - by
        inverse = 1.0 / (dx * dx + dy * dy)
        foot = 0.5 + (0.5 * (a * a - b * b)) * inverse
        margin = (a * a) * inverse - foot * foot
        height = 1 * np.sqrt(margin)
        return bx, by, bx + foot * dx - height * dy, by + foot * dy + height * dx, margin

    return run


def pylinkage(sizes: dict[str, Array]) -> dict[str, Callable[[], object]]:
    """Its batch call, and its compiled loop over one linkage for as many positions; checked against ours first."""
    from pylinkage.actuators import Crank
    from pylinkage.components import Ground
    from pylinkage.dyads import RRRDyad
    from pylinkage.population import Ensemble
    from pylinkage.simulation import Linkage

    from optlink.linkage.fourbar import four_bar

    one = {name: float(values[0, 0]) for name, values in sizes.items()}
    a, d = Ground(0.0, 0.0, name="A"), Ground(one["frame"], 0.0, name="D")
    crank = Crank(anchor=a, radius=one["crank"], angular_velocity=STEP, name="crank")
    rocker = RRRDyad(anchor1=crank.output, anchor2=d, distance1=one["coupler"], distance2=one["rocker"], name="rocker")
    linkage = Linkage([a, d, crank, rocker], name="four-bar")
    before = four_bar().pose(sizes, (np.cos(-STEP), np.sin(-STEP)))  # it steps before it records
    start = np.zeros((DESIGNS, 4, 2))
    start[:, 1, 0] = sizes["frame"][:, 0]
    for k, joint in ((2, "B"), (3, "C")):
        start[:, k] = np.hstack(before.points[joint])
    ensemble = Ensemble(linkage, np.hstack([sizes[name] for name in ("crank", "coupler", "rocker")]), start)
    found = ensemble.simulate(ANGLES, store=False)[:, :, 3]
    pose = four_bar().pose(sizes, (np.cos(PHI), np.sin(PHI)))
    np.testing.assert_allclose(found, np.stack(pose.points["C"], axis=-1), rtol=0.0, atol=1e-12)
    linkage.set_completely([one["crank"], one["coupler"], one["rocker"]], [tuple(xy) for xy in start[0]])
    return {
        "Ensemble.simulate": lambda: ensemble.simulate(ANGLES, store=False),
        "Linkage.step_fast": lambda: linkage.step_fast(DESIGNS * ANGLES),
    }


def measure(name: str) -> dict[str, Any]:
    """Median processor seconds of a contender in this process."""
    sizes = designs()
    if name == "pylinkage":
        from pylinkage._numba_compat import HAS_NUMBA

        taken = race(pylinkage(sizes), REPETITIONS if HAS_NUMBA else 1, 1 if HAS_NUMBA else 0, time.process_time)
        way = min(taken, key=lambda key: taken[key])
        return {"seconds": taken[way], "way": way, "compiled": HAS_NUMBA}
    makers = {
        "positions": lambda: portions(sizes),
        "pose": lambda: whole(sizes),
        "bare": bare,
        "compiled": lambda: compiled(sizes),
        "formulas": lambda: formulas(sizes),
    }
    run = makers[name]()
    return {"seconds": race({name: run}, REPETITIONS, clock=time.process_time)[name]}


def rows() -> list[Row]:
    """Ours against a compiled loop, bare numpy calls, plain numpy and pylinkage."""
    names = ["positions", "pose", "compiled", "bare", "formulas", "pylinkage"]
    results: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    for turn in range(ROUNDS):
        for name in names:
            if name == "pylinkage" and turn and (not results[name] or not results[name][0]["compiled"]):
                continue  # absent, or so slow without its compiler that once is enough
            done = child(str(ROOT / "benchmarks" / "batch.py"), name)
            if done.returncode == 0:
                results[name].append(json.loads(done.stdout.splitlines()[-1]))
            elif not any(f"No module named '{name}" in done.stderr for name in ("pylinkage", "numba")):
                raise RuntimeError(done.stderr)
    rate = {
        name: DESIGNS * ANGLES / statistics.median(result["seconds"] for result in found)
        for name, found in results.items()
        if found
    }
    peer = results["pylinkage"][0] if results["pylinkage"] else None
    if peer is None:
        about = "pylinkage is not installed"
    elif peer["compiled"]:
        about = f"pylinkage's fastest: {peer['way']}, compiled, warm"
    else:
        about = "without numba pylinkage is plain Python, not at its best: install numba"

    def row(mine: str, theirs: str, what: str, target: str, note: str, percent: bool) -> Row:
        if theirs not in rate:
            return Row(what, millions(rate[mine]), "skipped", target=target, note=note, percent=percent)
        figures = {"ours": rate[mine], "theirs": rate[theirs]}
        ratio = rate[mine] / rate[theirs]
        return Row(what, millions(rate[mine]), millions(rate[theirs]), ratio, target, note, percent, figures)

    of = f"positions per processor second, {DESIGNS} designs x {ANGLES} angles"
    calls = f"{sum(count for _, count in OPERATIONS) + 1} calls, results thrown away at once: what numpy takes for them"
    loop = "the same formulas as one loop, compiled by numba, one thread: what a processor can do, and how far numpy is from it"
    fair = ">= 5" if peer is None or peer["compiled"] else ""
    alone = "overhead of the toolkit; both wait for memory handed back and forth"
    return [
        row("positions", "compiled", f"{of}, against a compiled loop", "", loop, True),
        row("positions", "bare", f"{of}, against bare numpy calls", ">= 0.5", calls, True),
        row("positions", "pylinkage", f"{of}, against pylinkage", fair, about, False),
        row("pose", "formulas", f"{of}: one pose call on full arrays, against its formulas in plain numpy", "", alone, True),
    ]


def millions(rate: float) -> str:
    return f"{rate / 1e6:.3g} M/s"


if __name__ == "__main__":
    sys.path.insert(0, os.fspath(ROOT))
    print(json.dumps(measure(sys.argv[1])))
