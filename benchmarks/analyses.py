"""Single calls: analyses by rows, links and memory, and the search for a law that a linkage follows exactly.

`python benchmarks/run.py --parts analyses`. Times are processor times in one process, of problems that are read beforehand.
"""

from __future__ import annotations

import time
import tracemalloc
from typing import TYPE_CHECKING

from timing import COST, GROWTH, Row, race

if TYPE_CHECKING:
    from optlink.problem.file import ProblemFile

REPETITIONS = 9
FEW, BUDGET = 10, 15e-3  # positions of a short table, and the seconds that it may take
LONG = 300_000  # positions of a long one
DYADS = 5, 50  # of chains of 11 and 101 links
ROWS = 20  # of the exact law
PLAIN = "crank-rocker"


def chain(dyads: int) -> ProblemFile:
    """A crank-rocker whose rocker swings further ones in a row, through parallelograms; all links have masses."""
    import optlink

    ground, assembly = {"A0": ["0 mm", "0 mm"]}, {}
    links = {"crank": {"joints": ["A0", "B0"], "length": "40 mm"}}
    for k in range(1, dyads + 1):
        ground[f"A{k}"] = [f"{200 * k} mm", "0 mm"]
        links[f"coupler{k}"] = {"joints": [f"B{k - 1}", f"B{k}"], "length": f"{210 if k == 1 else 200} mm"}
        links[f"rocker{k}"] = {"joints": [f"A{k}", f"B{k}"], "length": "100 mm"}
        assembly[f"B{k}"] = f"left of B{k - 1}-A{k}"
    mechanism = {"ground": ground, "links": links, "assembly": assembly}
    bodies = {name: {"mass": "1 kg", "inertia": "1e-3 kg m^2"} for name in links}
    return optlink.read({"title": "chain", "mechanism": mechanism, "bodies": bodies})


def exact_law() -> ProblemFile:
    """A table of angles of a known four-bar, of which two lengths are sought."""
    import numpy as np

    import optlink

    sizes = {"crank": 0.1, "coupler": 0.35, "rocker": 0.25, "frame": 0.4}
    phi = np.radians(np.linspace(40.0, 140.0, ROWS))
    psi = optlink.linkage.sweep(optlink.linkage.four_bar(), sizes, phi).body_angle("rocker").value
    angles = {"phi": [f"{angle!r} rad" for angle in phi.tolist()], "psi": [f"{angle!r} rad" for angle in psi.tolist()]}
    free = {"start": "300 mm", "bounds": ["100 mm", "600 mm"]}
    mechanism = {"crank": "100 mm", "frame": "400 mm", "coupler": free, "rocker": free}
    return optlink.read(
        {"title": "exact law", "mechanism": mechanism, "requirement": {"law": angles | {"measured_from": "frame"}}}
    )


def beside() -> tuple[int, int]:
    """Bytes held at the peak of an analysis with a long table, and those of its columns."""
    import optlink

    problem = optlink.load("six-bar")
    optlink.analyze(problem, points=FEW)  # imports and caches
    tracemalloc.start()
    result = optlink.analyze(problem, points=LONG)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak, sum(column.nbytes for column in result.columns.values())


def rows() -> list[Row]:
    """All comparisons."""
    import optlink

    machine, plain, law = optlink.load("six-bar"), optlink.load(PLAIN), exact_law()
    few, many = (chain(dyads) for dyads in DYADS)
    assert optlink.solve(law).objective < 1e-20
    assert optlink.analyze(many).full
    calls = {
        "short": lambda: optlink.analyze(machine, points=FEW),
        "few": lambda: dict(optlink.analyze(few).extremes.items()),
        "many": lambda: dict(optlink.analyze(many).extremes.items()),
        "plain": lambda: optlink.solve(plain),
        "law": lambda: optlink.solve(law),
    }
    taken = race(calls, REPETITIONS, clock=time.process_time)
    peak, size = beside()
    links = [2 * dyads + 1 for dyads in DYADS]
    per = [taken[name] / count for name, count in zip(("few", "many"), links, strict=True)]

    def against(what: str, ours: float, theirs: float, target: str, note: str) -> Row:
        shown = f"{1e3 * ours:.1f} ms", f"{1e3 * theirs:.1f} ms"
        return Row(what, *shown, ours / theirs, target, note, figures={"ours": ours, "theirs": theirs}, kind=COST)

    return [
        against(
            f"analyze of the six-bar at {FEW} positions: time against a budget of {1e3 * BUDGET:.0f} ms",
            *(taken["short"], BUDGET, "<= 1", "of the file read beforehand; no extremes are read; ours / the budget"),
        ),
        Row(
            f"time per link, analyze of a chain of {links[1]} links against one of {links[0]}",
            *(f"{1e6 * seconds:.0f} us" for seconds in reversed(per)),
            per[0] / per[1],
            note="361 positions, with all extremes; in proportion to the links is 1x",
            figures={"ours": per[1], "theirs": per[0]},
            kind=GROWTH,
        ),
        Row(
            f"memory, analyze of the six-bar at {LONG:,} positions, against its columns",
            *(f"{part / 1e6:.0f} MB" for part in (peak, size)),
            peak / size,
            note="peak by tracemalloc; ours / the arrays of the result",
            figures={"ours": float(peak), "theirs": float(size)},
            kind=COST,
        ),
        against(
            f"solve of a law of {ROWS} rows that a four-bar follows exactly, against {PLAIN}",
            *(taken["law"], taken["plain"], "", f"two lengths free; ours / optlink solve {PLAIN} with its certificate"),
        ),
    ]


if __name__ == "__main__":
    from rows import show

    show({"analyses": rows()}, None)
