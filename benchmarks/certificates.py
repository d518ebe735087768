"""Boxes and time of proofs of global optima: `python benchmarks/certificates.py [--json FILE]`, or part of `benchmarks/run.py`.

The crank-rocker with two to four design variables at several gaps, the best transmission, and a problem without a design.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import sys
from pathlib import Path
from typing import Any

from timing import ROOT, Row

sys.path.insert(0, str(ROOT))

FRAME = {"mechanism.frame": {"start": "500 mm", "bounds": ["450 mm", "550 mm"]}}
PHI0 = {"requirement.from": {"start": "26 deg", "bounds": ["16 deg", "36 deg"]}}
PSI0 = {"requirement.psi0": {"start": "100 deg", "bounds": ["90 deg", "110 deg"]}}
NONE = {"limits.transmission_angle.min": "80 deg", "limits.transmission_angle.max": "100 deg"}
CASES: tuple[tuple[str, str, dict[str, Any], tuple[float, ...]], ...] = (
    ("crank-rocker: coupler, rocker", "crank-rocker", {}, (1e-3, 1e-6, 1e-9)),
    ("the same with the frame free, 450 ... 550 mm", "crank-rocker", FRAME, (1e-4,)),
    ("the same with the start angle free in 20 deg", "crank-rocker", PHI0, (1e-4,)),
    ("the same with the zero of the output free in 20 deg", "crank-rocker", PSI0, (1e-4,)),
    ("the same with frame and start angle free", "crank-rocker", FRAME | PHI0, (1e-3, 1e-4)),
    ("transmission-optimal: crank, coupler, rocker", "transmission-optimal", {}, (1e-4,)),
    ("crank-rocker with a transmission angle of 80 ... 100 deg: no design", "crank-rocker", NONE, (1e-6,)),
)
LONGEST = 600.0  # s


def measured() -> list[dict[str, Any]]:
    """Solve and certify every case; its figures."""
    import optlink

    found = []
    for what, name, changes, gaps in CASES:
        problem = optlink.load(name).override(changes)
        for gap in gaps:
            result = optlink.solve(problem, certify=True, gap=gap, time_limit=LONGEST)
            proof = result.certificate
            found.append(
                {
                    "what": what,
                    "unknowns": len(proof.unknowns),
                    "gap": gap,
                    "status": proof.status,
                    "text": proof.text,
                    "boxes": proof.boxes,
                    "seconds": result.seconds["certify"],
                }
            )
            print(what, gap, proof.status, proof.boxes, round(result.seconds["certify"], 2), file=sys.stderr, flush=True)
    return found


def rows() -> list[Row]:
    """Every case as a row."""
    return [
        Row(
            f"proof of the global optimum, {one['what']}, gap {one['gap']:g}",
            f"{one['seconds']:.2f} s",
            "",
            note=f"{one['unknowns']} unknowns, {one['boxes']:,} boxes: {one['text']}",
            figures={"ours": one["seconds"], "boxes": one["boxes"]},
        )
        for one in measured()
    ]


def main() -> None:
    """Measure, print a table, write the record of the documentation if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there as well")
    arguments = parser.parse_args()
    cases = measured()
    for one in cases:
        print(f"{one['what']} | {one['gap']:g} | {one['boxes']:,} boxes | {one['seconds']:.2f} s | {one['text']}")
    if arguments.json:
        record = {
            "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
            "python": platform.python_version(),
            "system": f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors",
            "rows": cases,
        }
        arguments.json.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
