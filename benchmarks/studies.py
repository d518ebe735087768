"""What-if studies of the crank-rocker: a sweep of optima against cold solves and on Dask, samples of its tolerances.

`python benchmarks/studies.py`, or as a part of `benchmarks/run.py`. Dask is skipped where it is not installed.
"""

from __future__ import annotations

import importlib.util
import os
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

from timing import ROOT, Row

POINTS = 2500  # of a sweep: 50 frames, 50 limits
COLD = 25  # of them, each solved from the start of the file
RUNS = 3
SAMPLES = 1_000_000
TOLERANCES = ("crank=0.05 mm", "coupler=0.1 mm", "rocker=0.1 mm", "D.x=0.1 mm", "D.y=0.05 mm")


def taken(run: Callable[[], Any], clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds of one run."""
    begin = clock()
    run()
    return clock() - begin


def rows() -> list[Row]:
    """All comparisons."""
    import optlink
    from optlink.studies.sweep import sweep
    from optlink.studies.tolerance.analysis import tolerance

    problem = optlink.load("crank-rocker")
    vary = ["mechanism.frame=450..550 mm:50", "limits.transmission_angle.max=125..140 deg:50"]
    engines = ["local", "dask"] if importlib.util.find_spec("distributed") else ["local"]
    walls: dict[str, list[float]] = {engine: [] for engine in engines}
    processor = []
    for _ in range(RUNS):
        for engine in engines:
            begin = time.perf_counter()
            study = sweep(problem, vary, engine=engine, workers=2)
            walls[engine].append(time.perf_counter() - begin)
            if engine == "local":
                processor.append(study.cpu)
    each = statistics.median(processor) / POINTS

    def cold() -> None:
        for k in range(COLD):
            optlink.solve(problem.override({"mechanism.frame": f"{450 + 100 * k / (COLD - 1):.9g} mm"}), "ipopt", certify=False)

    cold()
    alone = statistics.median(taken(cold, time.process_time) for _ in range(RUNS)) / COLD
    wall = statistics.median(walls["local"])
    result = [
        Row(
            f"sweep of {POINTS:,} optima, every one proven: processor time each, against a cold solve in the same process",
            f"{1e3 * each:.2f} ms",
            f"{1e3 * alone:.2f} ms",
            alone / each,
            ">= 1",
            f"crank-rocker, frame and transmission angle varied; {wall:.1f} s on 2 processes, {POINTS / wall:.0f} a second",
            figures={"ours": each, "theirs": alone, "wall": wall},
        )
    ]
    what = f"the same sweep on 2 Dask workers of this machine, {os.cpu_count()} processors"
    if "dask" in walls:
        dask = statistics.median(walls["dask"])
        note = "cluster started and closed within the time; the share grows with the number of points"
        figures = {"ours": dask, "theirs": wall}
        result.append(Row(what, f"{dask:.1f} s", f"{wall:.1f} s", wall / dask, note=note, percent=True, figures=figures))
    else:
        result.append(Row(what, "skipped", f"{wall:.1f} s", note="distributed is not installed", figures={"theirs": wall}))
    seconds = [taken(lambda: tolerance(problem, TOLERANCES, limit="2.5 deg", samples=SAMPLES)) for _ in range(RUNS)]
    sampled = statistics.median(seconds)
    what = f"yield from {SAMPLES:,} linkages, output error along the span, {len(TOLERANCES)} tolerances"
    result.append(Row(what, f"{sampled:.2f} s", "", note="solved first, quasi-random, one process", figures={"ours": sampled}))
    return result


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    for row in rows():
        print(f"{row.what}: {row.ours} | {row.theirs} | {row.shown(row.ratio)} | {row.note}")
