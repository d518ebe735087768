"""A random problem with what is known of it, and the judge of results: claims, limits, verdict; nothing of optlink.

Lengths are in mm, angles in rad, but for the results and `known`, which are in SI.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Raw = dict[str, Any]
Values = Mapping[str, float]

LENGTHS = ("crank", "coupler", "rocker", "frame")
MISSED = 2e-6  # share (or rad) by which a limit may be missed
FIGURE = 1e-6  # share by which two routes to an objective may differ
WORSE = 1e-6  # share by which an objective may exceed that of a known design


@dataclass(frozen=True)
class Judgement:
    """Objective of a design in mm and rad; what has to lie in a range, as (value, low, high)."""

    objective: float
    ranges: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    faults: tuple[str, ...] = ()


Judge = Callable[[Values, str, Array | None], Judgement]
"""Judge a design [mm, rad] by its assembly mode and, of free crank angles, these."""


@dataclass(frozen=True)
class RandomProblem:
    """A problem; `known`: objective [SI] of a design within its limits; `possible`: whether there is any, None if unknown.

    `unit`: the objective in mm and rad over that in SI; `least`: objective [mm, rad] that is as good as none.
    """

    name: str
    raw: Raw
    judge: Judge
    possible: bool | None = True
    planted: float | None = None  # objective of the known design [mm, rad]
    unit: float = 1.0
    least: float = 0.0

    @property
    def known(self) -> float | None:
        return None if self.planted is None else self.planted / self.unit


def faults_of(problem: RandomProblem, result: Any) -> list[str]:
    """What is wrong with a result of optlink: a claim about its design, a verdict, or a worse design than a known one."""
    if not result.valid:
        return [f"no valid design ({result.status}), although there is one"] if problem.possible else []
    if problem.possible is False:
        return ["a valid design of an impossible problem"]
    assembly = result.definite.raw["mechanism"].get("assembly", "left")
    mode = assembly if isinstance(assembly, str) else next(iter(assembly.values()))
    angles = {"zero"} if "psi" in problem.raw.get("requirement", {}).get("law", ()) else set()  # the output at the start
    lengths = {name for name in result.design if is_length(name)} - angles
    design = {name: float(value) * (1e3 if name in lengths else 1.0) for name, value in dict(result.design).items()}
    judged = problem.judge(design, str(mode), getattr(getattr(result, "best", None), "crank_angles", None))
    found = list(judged.faults)
    for name, (value, low, high) in (judged.ranges | bounds_of(problem.raw, design)).items():
        room = MISSED * max(1.0, abs(low) if math.isfinite(low) else 0.0, abs(high) if math.isfinite(high) else 0.0)
        if not low - room <= value <= high + room:
            found.append(f"{name} is {value!r}, not within {low!r} ... {high!r}")
    claimed = float(result.objective) * problem.unit
    if not abs(claimed - judged.objective) <= FIGURE * abs(judged.objective) + problem.least:
        found.append(f"objective: {claimed!r} is reported, {judged.objective!r} measured")
    if problem.planted is not None and judged.objective > problem.planted * (1.0 + WORSE) + problem.least:
        found.append(f"objective {judged.objective!r} is worse than {problem.planted!r} of a known design")
    return found


def is_length(name: str) -> bool:
    return name.rpartition(".")[2] in {*LENGTHS, "x", "y", "along", "across", "length", "offset", "zero"}


def bounds_of(raw: Raw, design: Values) -> dict[str, tuple[float, float, float]]:
    """Each design variable of a mechanism with its bounds."""
    mechanism = raw["mechanism"]
    stated: dict[str, Any] = {name: mechanism.get(name) for name in (*LENGTHS, "direction")}
    for point, row in (mechanism.get("ground", {}) | {"A": mechanism.get("pivot", [None, None])}).items():
        if row != [None, None] or point in mechanism.get("ground", {}):
            row = mechanism.get("ground", {}).get(point, row)
            stated |= {f"{point}.{axis}": value for axis, value in zip("xy", row, strict=True)}
    for link, body in (mechanism.get("links", {}) | {"": mechanism}).items():
        stated[f"{link}.length"] = body.get("length")
        for point, row in body.get("points", {}).items():
            prefix = f"{link}.{point}" if link else point
            stated |= {f"{prefix}.{axis}": value for axis, value in zip(("along", "across"), row, strict=True)}
    for guide, keys in mechanism.get("guides", {}).items():
        stated |= {f"{guide}.{key}": keys.get(key) for key in ("offset", "direction")}
    ends = {name: [float(text.split()[0]) for text in each["bounds"]] for name, each in stated.items() if isinstance(each, dict)}
    angles = {name for name in ends if not is_length(name)}
    return {name: (design[name], low, high) for name, (low, high) in ends.items() if name not in angles and name in design}
