"""A four-bar by its lengths written as a chain of dyads: links between pivots of the frame with coordinates."""

from __future__ import annotations

import copy
from typing import Any

import optlink

FAR = "700 mm"  # beyond every frame of the tests


def as_dyads(problem: optlink.ProblemFile, *, swapped: bool = False) -> optlink.ProblemFile:
    """Return the same problem; bounds of a frame of any direction become a limit. `swapped`: the group begins at the rocker."""
    raw: dict[str, Any] = copy.deepcopy(dict(problem.raw))
    section, requirement = raw["mechanism"], raw["requirement"]
    mode = section.get("assembly", "left")
    coupler = {"joints": ["B", "C"], "length": section["coupler"]}
    if "points" in section:
        coupler["points"] = section["points"]
    pivots = {"A": ["0 mm", "0 mm"], "D": [section["frame"], "0 mm"]}
    if {"pivot", "direction"} & set(section):
        anywhere = {"bounds": [f"-{FAR}", FAR]}
        pivots = {"A": section.get("pivot", ["0 mm", "0 mm"]), "D": [anywhere, anywhere]}
        raw.setdefault("limits", {})["frame_length"] = section["frame"]["bounds"]
    if mode != "either":
        other = {"left": "right", "right": "left"}[mode]
        mode = f"{other} of D-B" if swapped else f"{mode} of B-D"
    raw["mechanism"] = {
        "type": "dyads",
        "ground": pivots,
        "links": {
            "crank": {"joints": ["A", "B"], "length": section["crank"]},
            "coupler": coupler,
            "rocker": {"joints": ["D", "C"], "length": section["rocker"]},
        },
        "assembly": {"C": mode},
    }
    if requirement.get("kind", "function") == "function":
        requirement["output"] = "rocker"
        if "function" in requirement["law"]:
            requirement |= {key: {"bounds": ["-360 deg", "360 deg"]} for key in ("from", "psi0") if key not in requirement}
        else:
            requirement.setdefault("from", "outer dead centre")
            requirement.setdefault("psi0", "output at the start")
    raw.pop("expected", None)
    return problem.with_tables(raw)
