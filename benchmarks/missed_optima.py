"""Calibration of the chance that a search missed a better optimum: the stated chance against the observed frequency.

    python benchmarks/missed_optima.py --problems 200 --json benchmarks/missed_optima_record.json

Small untimed path problems of two kinds: points near a planted coupler curve, and points of one with a part of them in reverse
order, which no four-bar passes exactly. Each is searched with default options from several seeds, and once with 4500 starting
points; the best of all is taken as the known optimum. A row of the table has the searches that told a chance within a range, and
the share of them that missed it. A record is extended: problems in it are not searched again.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

import optlink

SEEDS, LONG = (0, 1, 2), 4500  # of the searches with default options; starting points of the long one
WORSE = 1e-4  # relative difference of the error by which an optimum is missed
TOLD = (0.0, 0.02, 0.05, 0.2, 1.0)  # ranges of the chances
SMOOTH, REVERSED = "near a coupler curve", "partly in reverse order"


def four_bar(rng: np.random.Generator) -> tuple[float, float, float]:
    """Crank, coupler and rocker of a crank-rocker with the frame 100, its transmission angle between 15 and 165 deg."""
    while True:
        crank, coupler, rocker = rng.uniform((15.0, 40.0, 40.0), (80.0, 200.0, 200.0)).tolist()
        others = sorted((100.0, coupler, rocker))
        diagonal = np.array([100.0 - crank, 100.0 + crank])
        cosine = (coupler**2 + rocker**2 - diagonal**2) / (2.0 * coupler * rocker)
        if crank < 0.98 * others[0] and crank + others[2] < 0.98 * (others[0] + others[1]) and np.all(np.abs(cosine) < 0.966):
            return crank, coupler, rocker


def points(number: int) -> np.ndarray:
    """Points (n, 2) [mm] of a problem: those with an odd number are partly in reverse order."""
    rng = np.random.default_rng([number, 78])
    crank, coupler, rocker = four_bar(rng)
    count = 5 + number % 4 if number % 2 else 6
    pin = crank * np.exp(1j * np.sort(rng.uniform(0.0, math.tau, count)))
    arm = 100.0 - pin  # from B to D
    turned = (np.abs(arm) ** 2 + coupler**2 - rocker**2) / (2.0 * coupler * np.abs(arm))
    along = arm / np.abs(arm) * np.exp(1j * np.arccos(turned))
    curve = pin + along * coupler * complex(rng.uniform(-1.0, 1.5), rng.uniform(-1.0, 1.0))
    rows = np.column_stack([curve.real, curve.imag])
    if number % 2:
        first = int(rng.integers(1, count - 2))
        last = first + int(rng.integers(2, min(4, count - first) + 1))
        return np.concatenate([rows[:first], rows[first:last][::-1], rows[last:]])
    size = math.sqrt(float(np.mean(np.sum((rows - rows.mean(axis=0)) ** 2, axis=1))))
    return rows + rng.normal(size=rows.shape) * size * math.exp(rng.uniform(math.log(0.003), math.log(0.1)))


def problem(number: int) -> optlink.ProblemFile:
    """The problem of these points: three lengths and the coupler point are free."""
    place, length = {"bounds": ["-500 mm", "500 mm"]}, {"bounds": ["5 mm", "400 mm"]}
    mechanism = {
        "type": "four-bar",
        "crank": {"bounds": ["2 mm", "100 mm"]},
        "coupler": length,
        "rocker": length,
        "frame": "100 mm",
        "points": {"P": [place, place]},
        "assembly": "left",
    }
    rows = [{"x": f"{x!r} mm", "y": f"{y!r} mm"} for x, y in points(number).tolist()]
    requirement = {"kind": "path", "point": "P", "points": rows}
    return optlink.read({"mechanism": mechanism, "requirement": requirement, "limits": {"link_ratio": [0.02, 50.0]}})


def searched(number: int) -> dict[str, Any]:
    """The searches of a problem: error [m], told chance, starting points; the last one is the long one."""
    file, rows = problem(number), []
    for seed, starts in (*((seed, None) for seed in SEEDS), (len(SEEDS), LONG)):
        begin = time.process_time()
        result = optlink.solve(file, starts=starts, seed=seed, designs=1, certify=False)
        error = result.designs[0].error if result.designs else math.inf
        rows.append((error, result.evidence.missed, result.starts, time.process_time() - begin))
    names = ("errors", "told", "starts", "seconds")
    columns = dict(zip(names, map(list, zip(*rows, strict=True)), strict=True))
    return {"number": number, "kind": REVERSED if number % 2 else SMOOTH, **columns}


def rates(records: list[dict[str, Any]]) -> list[tuple[str, int, int]]:
    """For each kind and range of told chances: the searches with default options, and those that missed the known optimum."""
    rows = []
    for kind, (low, high) in itertools.product((SMOOTH, REVERSED), itertools.pairwise(TOLD)):
        told = [
            error > min(one["errors"]) * (1.0 + WORSE)
            for one in records
            if one["kind"] == kind and math.isfinite(min(one["errors"]))
            for error, chance in zip(one["errors"][:-1], one["told"][:-1], strict=True)
            if low < chance <= high
        ]
        rows.append((f"{kind}, told {100.0 * low:g} to {100.0 * high:g} %", len(told), sum(told)))
    return rows


def main() -> None:
    """Search the problems that the record lacks, and print the table."""
    options = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    options.add_argument("--problems", type=int, default=200)
    options.add_argument("--json", type=Path)
    chosen = options.parse_args()
    records: list[dict[str, Any]] = []
    if chosen.json and chosen.json.exists():
        records = json.loads(chosen.json.read_text(encoding="utf-8"))
    known = {one["number"] for one in records}
    for number in range(chosen.problems):
        if number in known:
            continue
        records.append(searched(number))
        if chosen.json:
            chosen.json.write_text(json.dumps(records) + "\n", encoding="utf-8")
    for words, count, missed in rates(records):
        share = f"{100.0 * missed / count:.1f} %" if count else "-"
        print(f"{words:45s} {count:5d} searches, {missed:4d} missed ({share})")


if __name__ == "__main__":
    main()
