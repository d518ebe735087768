"""Batches with drives: an arm with two cylinders and all its forces, and a crank alone against the same crank with a motor.

`python benchmarks/run.py --parts drives`. Times are processor times in one process, of problems that are read beforehand.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from timing import COST, Row, race

if TYPE_CHECKING:
    from optlink.problem.file import ProblemFile

DESIGNS, POINTS = 2000, 24
REPETITIONS = 9
POSES = 20_000  # designs at one position each
WANTED = 50_000  # designs with forces a second
EFFORTS = ["lift.force_N", "curl.force_N"]

ARM: dict[str, Any] = {
    "title": "arm with two cylinders",
    "gravity": "9.81 m/s^2",
    "mechanism": {
        "ground": {"A": ["0 mm", "0 mm"], "D": ["600 mm", "-400 mm"]},
        "links": {
            "boom": {
                "joints": ["A", "E"],
                "length": "3000 mm",
                "points": {"B": ["1400 mm", "100 mm"], "F": ["1600 mm", "500 mm"]},
            },
            "stick": {"joints": ["E", "H"], "length": "600 mm", "points": {"T": ["-1500 mm", "0 mm"]}},
        },
        "cylinders": {
            "lift": {"joints": ["D", "B"], "closed": "1000 mm", "open": "1500 mm"},
            "curl": {"joints": ["F", "H"], "closed": "1200 mm", "open": "1700 mm"},
        },
        "assembly": {"B": "left of A-D", "H": "left of F-E"},
    },
    "bodies": {
        "boom": {"mass": "300 kg", "centroid": ["1400 mm", "100 mm"], "inertia": "200 kg*m^2"},
        "stick": {"mass": "120 kg", "centroid": ["-500 mm", "0 mm"], "inertia": "40 kg*m^2"},
    },
    "loads": {"tip": {"on": "stick", "at": "T", "force": "3 kN", "direction": "90 deg"}},
    "drives": {
        "lift": {
            "cylinder": "lift",
            "law": [
                {"time": "2 s", "to": "1400 mm", "law": "3-4-5"},
                {"time": "2 s", "to": "1000 mm", "law": "3-4-5"},
            ],
        },
        "curl": {
            "cylinder": "curl",
            "law": [
                {"time": "2 s", "to": "1600 mm", "law": "3-4-5"},
                {"time": "2 s", "to": "1200 mm", "law": "3-4-5"},
            ],
        },
    },
}


def crank(*, motor: bool) -> ProblemFile:
    """A crank-rocker with masses at constant speed: stated as such, or by the law of a motor."""
    import optlink

    joints = {"crank": ["A", "B"], "coupler": ["B", "C"], "rocker": ["D", "C"]}
    lengths = {"crank": 100, "coupler": 350, "rocker": 250}
    links = {name: {"joints": pair, "length": f"{lengths[name]} mm"} for name, pair in joints.items()}
    ground = {"A": ["0 mm", "0 mm"], "D": ["400 mm", "0 mm"]}
    law = [{"time": "1 s", "to": "360 deg", "law": "constant"}]
    return optlink.read(
        {
            "title": "crank-rocker",
            "mechanism": {"ground": ground, "links": links, "assembly": {"C": "left of B-D"}},
            "bodies": {name: {"mass": "1 kg", "inertia": "1e-3 kg m^2"} for name in links},
            "drive": {"body": "crank"} | ({"law": law} if motor else {"speed": "60 rpm"}),
        }
    )


def rows() -> list[Row]:
    """All comparisons."""
    import numpy as np

    import optlink

    rng = np.random.default_rng(0)
    arm, plain, driven = optlink.read(ARM), crank(motor=False), crank(motor=True)
    booms, many = (
        {"boom.length": rng.uniform(2.9, 3.1, count), "boom.B.along": rng.uniform(1.3, 1.5, count)} for count in (DESIGNS, POSES)
    )
    couplers = {"coupler.length": rng.uniform(0.34, 0.40, DESIGNS)}
    found = optlink.analyze_batch(arm, booms, EFFORTS, POINTS)
    one = optlink.analyze(arm, design={name: float(values[0]) for name, values in booms.items()}, points=POINTS)
    assert np.all(found.valid)
    for name in EFFORTS:
        np.testing.assert_allclose(found[name][0], one[name][:POINTS], rtol=1e-9)
    torque = "input.torque_Nm"
    pair = [optlink.analyze_batch(each, couplers, [torque], POINTS)[torque] for each in (plain, driven)]
    np.testing.assert_allclose(*pair, rtol=1e-9, atol=1e-9)
    calls = {
        "pose": lambda: optlink.analyze_batch(arm, many, EFFORTS, 1),
        "arm": lambda: optlink.analyze_batch(arm, booms, EFFORTS, POINTS),
        "plain": lambda: optlink.analyze_batch(plain, couplers, [torque], POINTS),
        "driven": lambda: optlink.analyze_batch(driven, couplers, [torque], POINTS),
    }
    taken = race(calls, REPETITIONS, clock=time.process_time)
    told = "weights and accelerations, and a search of the cycle for singular positions; ours / the number that is wanted"
    return [
        *(
            Row(
                f"arm with two cylinders, whole designs with both forces in a batch, a second, {at}",
                f"{count / taken[name]:,.0f}",
                f"{WANTED:,}",
                count / taken[name] / WANTED,
                target,
                f"{count} designs; {told}",
                figures={"ours": taken[name], "theirs": count / WANTED},
            )
            for name, count, at, target in (
                ("pose", POSES, "at one position", ">= 1"),
                ("arm", DESIGNS, f"at {POINTS} positions", ""),
            )
        ),
        Row(
            "crank-rocker with forces in a batch, without elements against a law of the same motion",
            *(f"{1e3 * taken[name]:.1f} ms" for name in ("plain", "driven")),
            taken["plain"] / taken["driven"],
            "<= 1.1",
            f"{DESIGNS} designs at {POINTS} positions; time of the crank at constant speed / that of the crank by its law",
            figures={"ours": taken["plain"], "theirs": taken["driven"]},
            kind=COST,
        ),
    ]


if __name__ == "__main__":
    from rows import show

    show({"drives": rows()}, None)
