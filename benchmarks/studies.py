"""What-if studies of the crank-rocker: a sweep of optima against cold solves and on Dask, samples of its tolerances.

`python benchmarks/studies.py`, or as a part of `benchmarks/run.py`. Dask is skipped where it is not installed.
`python benchmarks/studies.py optima 100` compares sweeps of 10^4 paths and machines with separate searches.
`python benchmarks/studies.py million [local|dask]` sweeps 10^5 and 10^6 points on 2 processes and prints time, memory, and
the share of the time, the start included, for which both workers compute.
"""

from __future__ import annotations

import importlib.util
import itertools
import os
import random
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from timing import GROWTH, ROOT, Row

SIDE, LARGE, MILLION = 100, 300, 1000  # points along each of the two axes of a grid
COLD = 25  # points solved each from the start of the file
RUNS = 3
FEW, SEARCHED = 10, 5  # points along each axis of a grid of paths or machines, and of them those searched one by one
DESIGNS = {
    "path-crank-rocker": ("mechanism.crank=95..105 mm", "mechanism.frame=480..520 mm"),
    "shaper-design": ("limits.guide.max=1450..1550 N", "limits.time_ratio.exactly=1.78..1.82"),
}
SAMPLES = 1_000_000
SWEEPS = itertools.count()
TOLERANCES = ("crank=0.05 mm", "coupler=0.1 mm", "rocker=0.1 mm", "D.x=0.1 mm", "D.y=0.05 mm")


def taken(run: Callable[[], Any], clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds of one run."""
    begin = clock()
    run()
    return clock() - begin


def swept(side: int, **options: Any) -> tuple[Any, float]:
    """Sweep a grid of optima; return the study and its seconds.

    Each call has a slightly larger grid: a process keeps the searches of the grid before, and repeats none of them.
    """
    import optlink
    from optlink.studies import sweep

    vary = [
        f"mechanism.frame=450..{550 + 1e-6 * next(SWEEPS):.9g} mm:{side}",
        f"limits.transmission_angle.max=125..140 deg:{side}",
    ]
    begin = time.perf_counter()
    study = sweep(optlink.load("crank-rocker"), vary, **options)
    assert study.complete
    return study, time.perf_counter() - begin


def rows() -> list[Row]:
    """All comparisons."""
    import optlink
    from optlink.studies import tolerance

    problem = optlink.load("crank-rocker")

    def cold() -> None:
        for k in range(COLD):
            optlink.solve(problem.override({"mechanism.frame": f"{450 + 100 * k / (COLD - 1):.9g} mm"}), "ipopt", certify=False)

    cold()
    walls, each, alone = [], [], []
    for _ in range(RUNS):  # in turn
        study, wall = swept(SIDE, workers=1)
        walls.append(wall)
        each.append(study.processor_seconds / SIDE**2)
        alone.append(taken(cold, time.process_time) / COLD)
    ours, theirs, wall = (statistics.median(values) for values in (each, alone, walls))
    result = [
        Row(
            f"sweep of {SIDE**2:,} optima, each verified: processor time each, against a cold solve in the same process",
            f"{1e3 * ours:.3f} ms",
            f"{1e3 * theirs:.2f} ms",
            theirs / ours,
            ">= 10",
            f"crank-rocker, frame and transmission angle varied; {wall:.1f} s in one process, {SIDE**2 / wall:,.0f} a second",
            figures={"ours": ours, "theirs": theirs, "wall": wall},
        )
    ]
    result += optima()
    what = f"sweep of {LARGE**2:,} optima on 2 Dask workers of this machine ({os.cpu_count()} processors): efficiency"
    if importlib.util.find_spec("distributed"):
        cluster = {"workers": 2, "engine": "dask"}
        times = [[swept(side, **way)[1] for side in (LARGE, SIDE) for way in ({"workers": 1}, cluster)] for _ in range(RUNS)]
        single, dask, short, begun = (statistics.median(values) for values in zip(*times, strict=True))
        note = f"without the start of the cluster (from a sweep of {SIDE**2:,}); with it {single / (2.0 * dask):.0%}"
        figures = {"ours": dask, "theirs": single, "ours_small": begun, "theirs_small": short}
        share = (single - short) / (2.0 * (dask - begun))
        shown = f"{dask:.1f} s", f"{single:.1f} s"
        result.append(Row(what, *shown, share, note=note, percent=True, figures=figures, kind=GROWTH))
    else:
        result.append(Row(what, "skipped", "", note="distributed is not installed"))
    seconds = [taken(lambda: tolerance(problem, TOLERANCES, limit="2.5 deg", samples=SAMPLES)) for _ in range(RUNS)]
    sampled = statistics.median(seconds)
    what = f"yield from {SAMPLES:,} linkages, output error along the span, {len(TOLERANCES)} tolerances"
    result.append(Row(what, f"{sampled:.2f} s", "", note="solved first, quasi-random, one process", figures={"ours": sampled}))
    return result


def optima(side: int = FEW, searched: int = SEARCHED) -> list[Row]:
    """Sweeps of paths and of machines against searches of a random sample of their points."""
    import optlink
    from optlink.studies import sweep
    from optlink.studies.grid import read_grid

    def alone(files: list[Any]) -> None:
        for file in files:
            optlink.solve(file, "ipopt", certify=False)

    result = []
    for name, axes in DESIGNS.items():
        problem, vary = optlink.load(name), [f"{axis}:{side}" for axis in axes]
        grid = read_grid(problem, vary)
        alone([problem])  # what is compiled and imported once
        files = [problem.override(grid.changes(point)) for point in random.Random(0).sample(range(grid.count), searched)]
        theirs = taken(partial(alone, files), time.process_time) / searched
        study = sweep(problem, vary, workers=1)
        assert study.complete
        ours = study.processor_seconds / grid.count
        what = f"sweep of {grid.count:,} optima of {name}: processor time each, against a search of one point"
        note = f"{' and '.join(axes)}; {study.searched_points} points of the sweep searched"
        figures = {"ours": ours, "theirs": theirs}
        result.append(Row(what, f"{1e3 * ours:.1f} ms", f"{1e3 * theirs:.0f} ms", theirs / ours, ">= 5", note, figures=figures))
    return result


def million(engine: str = "local") -> None:
    """Print time, share of computing and peak resident memory of sweeps of 10^5 and 10^6 optima on 2 processes."""
    import resource

    for side in (round(MILLION / 10**0.5), MILLION):
        study, wall = swept(side, workers=2, engine=engine)
        own, workers = (resource.getrusage(who).ru_maxrss / 1024 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        share = study.processor_seconds / (2.0 * wall)
        found = f"{side**2:,} optima: {wall:.1f} s on 2 processes ({engine}), {share:.0%} of it computing"
        print(f"{found}, the start included; peak memory {own:.0f} MB, of a worker {workers:.0f} MB", flush=True)


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    if sys.argv[1:2] == ["million"]:
        million(*sys.argv[2:3])
        sys.exit()
    for row in optima(int(sys.argv[2]), 20) if sys.argv[1:2] == ["optima"] else rows():
        print(f"{row.what}: {row.ours} | {row.theirs} | {row.shown(row.ratio)} | {row.note}", flush=True)
