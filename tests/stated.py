"""Mechanisms and whole problems as files state them, for tests: lengths in mm, angles in deg or rad as written."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

import optlink
from optlink.linkage.fourbar import LENGTHS
from optlink.problem.design import DesignProblem

Array = np.ndarray
SPOTS = np.array([(20.0, 25.0), (28.0, 31.0), (33.0, 27.0), (30.0, 18.0), (22.0, 16.0)])  # mm, once round


def free(low: float, high: float, start: float | None = None, unit: str = "mm") -> dict[str, object]:
    first = {} if start is None else {"start": f"{start!r} {unit}"}
    return {**first, "bounds": [f"{low!r} {unit}", f"{high!r} {unit}"]}


ANGLE = free(-180.0, 180.0, 0.0, "deg")
LENGTH, PLACE = free(1.0, 400.0), free(-400.0, 400.0)


def four_bar_section(assembly: str = "left", **changes: object) -> dict[str, object]:
    section = {
        "type": "four-bar",
        **dict.fromkeys(LENGTHS, LENGTH),
        "points": {"P": [PLACE, PLACE]},
        "pivot": [PLACE, PLACE],
        "direction": ANGLE,
        "assembly": assembly,
    }
    return {key: value for key, value in {**section, **changes}.items() if value is not None}


SLIDER_CRANK = {
    "type": "dyads",
    "ground": {"A": [PLACE, PLACE]},
    "links": {
        "crank": {"joints": ["A", "B"], "length": free(2.0, 200.0, 20.0)},
        "rod": {"joints": ["B", "E"], "length": free(5.0, 400.0, 70.0), "points": {"P": [PLACE, PLACE]}},
        "slider": {"joints": ["E"]},
    },
    "guides": {"F": {"slider": "slider", "on": "frame", "through": "A", "direction": ANGLE, "offset": free(-200.0, 200.0, 5.0)}},
    "assembly": {"E": "forward"},
}


def between(low: float, high: float, start: float) -> dict[str, object]:
    return free(low, high, start)


STEPHENSON = {
    "type": "dyads",
    "ground": {
        "A": [between(-300.0, 300.0, 0.0), between(-300.0, 300.0, 0.0)],
        "D": [between(-300.0, 300.0, 121.0), between(-300.0, 300.0, 0.0)],
        "F": [between(-300.0, 400.0, 84.0), between(-300.0, 400.0, 265.0)],
    },
    "links": {
        "crank": {"joints": ["A", "B"], "length": free(5.0, 200.0, 40.0)},
        "coupler": {
            "joints": ["B", "C"],
            "length": free(20.0, 300.0, 96.0),
            "points": {"E": [between(-300.0, 300.0, 156.0), between(-300.0, 300.0, 7.0)]},
        },
        "rocker": {"joints": ["D", "C"], "length": free(20.0, 400.0, 130.0)},
        "link": {
            "joints": ["E", "G"],
            "length": free(20.0, 400.0, 106.5),
            "points": {"P": [between(-300.0, 300.0, 60.0), between(-300.0, 300.0, 25.0)]},
        },
        "lever": {"joints": ["F", "G"], "length": free(20.0, 400.0, 100.0)},
    },
    "assembly": {"C": "left of B-D", "G": "left of E-F"},
}


def document(
    mechanism: Mapping[str, object],
    points: Array = SPOTS,
    limits: Mapping[str, object] | None = None,
    crank: Array | None = None,
    weights: Array | None = None,
    tolerances: Array | None = None,
    **requirement: object,
) -> dict[str, object]:
    """A problem as a file states it: points in mm, with a third column (rad) of a motion, crank angles in rad."""
    rows: list[dict[str, object]] = [{"x": f"{row[0]!r} mm", "y": f"{row[1]!r} mm"} for row in np.asarray(points).tolist()]
    kind = "motion" if np.shape(points)[1] == 3 else "path"
    for i, row in enumerate(rows):
        if kind == "motion":
            row["angle"] = f"{float(points[i, 2])!r} rad"
        if crank is not None:
            row["crank"] = f"{float(crank[i])!r} rad"
        if weights is not None:
            row["weight"] = float(weights[i])
        if tolerances is not None:
            row["tolerance"] = f"{float(tolerances[i])!r} mm"
    task = {"kind": kind, "points": rows, **requirement}
    return {"title": "t", "mechanism": mechanism, "requirement": task, "limits": dict(limits or {})}


def model(raw: Mapping[str, object]) -> DesignProblem:
    """The model of a problem with definite assembly modes."""
    (file,) = optlink.read(dict(raw)).variants()
    assert isinstance(file.model, DesignProblem)
    return file.model
