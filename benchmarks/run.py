"""Ratios to peers and to what a machine can do: `python benchmarks/run.py [--parts NAMES] [--json FILE]`.

Medians only, contenders in turn. A peer that is not installed is skipped. Nothing here asserts a time. With `--json` the parts
that were measured replace those of the file, each with its date and the load of the machine. Of the synthesis a run has a sample
of several seeds and linkages; `python benchmarks/synthesis.py` measures all of it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from rich.console import Console
from rows import show
from timing import COST, ROOT, Row, child, race

sys.path.insert(0, str(ROOT))  # the checkout is measured, whether it is installed or not

PROCESS_RUNS = 9
SYNTHESIS = {"seeds": 3, "linkages": 3, "laws": 40}  # half an hour rather than hours
YARDSTICK = ("-c", "import numpy, scipy.optimize, casadi")
SOLVED, OUT = "solve crank-rocker", "FOLDER"
PROCESSES = {
    "--help": ("<= 0.25", ""),
    "list": ("<= 0.4", ""),
    SOLVED: ("<= 1.25", ""),
    f"{SOLVED} --out {OUT}": ("<= 3", SOLVED),
    "analyze six-bar": ("<= 1", ""),
    f"export crank-rocker -o {OUT}/motion.csv": ("<= 1", ""),
}
"""Command lines, each with its target and what it is compared with: nothing stands for the imports."""


def process_rows() -> list[Row]:
    """Whole processes against the imports that no solve can do without, and with pictures against one without."""
    with tempfile.TemporaryDirectory() as folder:
        arguments = {name: ("-m", "optlink", *name.replace(OUT, folder).split()) for name in PROCESSES}
        codes = {name: child(*words).returncode for name, words in arguments.items()}
        taken = race({name: partial(child, *words) for name, words in ({"": YARDSTICK} | arguments).items()}, PROCESS_RUNS, 1)
    rows = []
    for name, (target, other) in PROCESSES.items():
        what = f"process: optlink {name.removeprefix('--')}"
        if codes[name]:
            rows.append(Row(what, "failed", "", target=target, note=f"exit code {codes[name]}", kind=COST))
            continue
        against = f"optlink {other}" if other else f"python {YARDSTICK[0]} '{YARDSTICK[1]}'"
        figures = {"ours": taken[name], "theirs": taken[other]}
        shown = [f"{1e3 * seconds:.0f} ms" for seconds in figures.values()]
        rows.append(Row(what, *shown, taken[name] / taken[other], target, f"ours / {against}", figures=figures, kind=COST))
    return rows


def measurements() -> dict[str, Callable[[], list[Row]]]:
    """The parts by name; each measures and gives its rows."""
    import analyses
    import batch
    import certificates
    import clearance
    import drives
    import dynamics
    import solves
    import studies
    import synthesis

    return {
        "solves": solves.rows,
        "batches": batch.rows,
        "analyses": analyses.rows,
        "dynamics": dynamics.rows,
        "drives": drives.rows,
        "clearance": clearance.rows,
        "synthesis": partial(synthesis.rows, **SYNTHESIS),
        "studies": studies.rows,
        "certificates": certificates.rows,
        "processes": process_rows,
    }


def main() -> None:
    """Measure, print one table, write the JSON document if asked."""
    every = measurements()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parts", default="", help=f"{', '.join(every)}; left out: all")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there as well")
    arguments = parser.parse_args()
    parts = [part for part in arguments.parts.split(",") if part] or list(every)
    for part in parts:
        if part not in every:
            parser.error(f"no part {part!r}; known: {', '.join(every)}")
    progress = Console(stderr=True)
    rows: dict[str, list[Row]] = {}
    for part in parts:
        with progress.status(f"Timing {part} ..."):
            rows[part] = every[part]()
    show(rows, arguments.json)


if __name__ == "__main__":
    main()
