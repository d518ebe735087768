"""Random paths for six-bars and their oracle: positions by complex numbers and the cosine rule, without formulas of optlink."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.problem.file import ProblemFile, read
from optlink.tasks.results.design import LinkageDesign
from tests.synthesis_oracle import random_closed_curve

Raw = dict[str, Any]
Complex = NDArray[np.complex128]

MOVES = 20_000  # crank angles of a revolution
SIZE = 0.03  # m, of the curves
FAR, LONG = 0.3, 0.3  # m, bounds of coordinates and lengths
SHARE = 1e-6  # of the size of the curve, or of a radian


@dataclass(frozen=True)
class SixBarTask:
    """A path for a six-bar, `watt` or `stephenson`, and the same path for its four-bar; `least` transmission angle [rad]."""

    watt: bool
    points: Complex
    least: float

    @property
    def file(self) -> ProblemFile:
        """The problem of the six-bar."""
        free = {"bounds": [f"{-1e3 * FAR} mm", f"{1e3 * FAR} mm"]}
        place = [free, free]
        length = {"bounds": ["8 mm", f"{1e3 * LONG} mm"]}
        links: Raw = {
            "crank": {"joints": ["A", "B"], "length": length},
            "coupler": {"joints": ["B", "C"], "length": length, "points": {"E": place}},
            "rocker": {"joints": ["D", "C"], "length": length, "points": {"F": place} if self.watt else {}},
            "one": {"joints": ["E", "G"], "length": length, "points": {} if self.watt else {"P": place}},
            "other": {"joints": ["F", "G"], "length": length, "points": {"P": place} if self.watt else {}},
        }
        ground = dict.fromkeys("AD" if self.watt else "ADF", place)
        return read(self._raw({"ground": ground, "links": links, "assembly": {"C": "either", "G": "either"}}, "P"))

    @property
    def four_bar(self) -> ProblemFile:
        """The same path for a four-bar within the same bounds, stated in its own terms."""
        span = [f"{-1e3 * FAR} mm", f"{1e3 * FAR} mm"]
        free = {"bounds": span}
        length = {"bounds": ["8 mm", f"{1e3 * LONG} mm"]}
        section = dict.fromkeys(("crank", "coupler", "rocker"), length) | {"frame": {"bounds": ["8 mm", "848 mm"]}}
        section |= {"points": {"P": [free, free]}, "pivot": [free, free], "assembly": "either"}
        section["direction"] = {"bounds": ["-180 deg", "180 deg"]}
        raw = self._raw(section, "P")
        raw["limits"]["pivots"] = {"x": span, "y": span}
        return read(raw)

    def _raw(self, section: Raw, point: str) -> Raw:
        points = [[f"{1e3 * z.real:.9f} mm", f"{1e3 * z.imag:.9f} mm"] for z in self.points]
        low = math.degrees(self.least)
        return {
            "title": "Random path",
            "source": "Random numbers.",
            "mechanism": section | ({"type": "dyads"} if "links" in section else {}),
            "requirement": {"kind": "path", "point": point, "closed": True, "points": points},
            "limits": {"transmission_angle": [f"{low!r} deg", f"{180.0 - low!r} deg"]},
        }


def random_six_bar(seed: int, count: int = 24) -> SixBarTask:
    """Watt I and Stephenson III in turn, with random curves and limits."""
    rng = np.random.default_rng([seed, 6])
    curve = random_closed_curve(rng, count)
    z = curve[:, 0] + 1j * curve[:, 1]
    z = (z - z.mean()) / np.sqrt(np.mean(np.abs(z - z.mean()) ** 2)) * SIZE * np.exp(rng.uniform(-0.4, 0.4))
    return SixBarTask(seed % 2 == 0, z, math.radians(rng.uniform(20.0, 32.0)))


def _third(p: Complex, q: Complex, a: float, b: float, side: int) -> Complex:
    """The corner of a triangle a from p, b from q, left (+1) or right of p to q, by the cosine rule."""
    c = np.abs(q - p)
    angle = np.arccos((a * a + c * c - b * b) / (2.0 * a * c))
    return p + a * np.exp(1j * (np.angle(q - p) + side * angle))


def _at(start: Complex, end: Complex, along: float, across: float) -> Complex:
    return start + (along + 1j * across) * np.exp(1j * np.angle(end - start))


def positions(design: LinkageDesign, watt: bool, crank_angles: NDArray[np.float64]) -> dict[str, Complex]:
    """Every joint, and the point P."""
    v, modes = design.values, design.assembly
    assert isinstance(modes, dict)
    side = {joint: 1 if mode.startswith("left") else -1 for joint, mode in modes.items()}
    a, d = (complex(v[f"{n}.x"], v[f"{n}.y"]) + 0.0 * crank_angles for n in "AD")
    b = a + v["crank.length"] * np.exp(1j * crank_angles)
    c = _third(b, d, v["coupler.length"], v["rocker.length"], side["C"])
    e = _at(b, c, v["coupler.E.along"], v["coupler.E.across"])
    f = _at(d, c, v["rocker.F.along"], v["rocker.F.across"]) if watt else complex(v["F.x"], v["F.y"]) + 0.0 * crank_angles
    g = _third(e, f, v["one.length"], v["other.length"], side["G"])
    body, start = ("other", f) if watt else ("one", e)
    p = _at(start, g, v[f"{body}.P.along"], v[f"{body}.P.across"])
    return {"A": a, "B": b, "C": c, "D": d, "E": e, "F": f, "G": g, "P": p}


def faults_of_six_bar(design: LinkageDesign, task: SixBarTask) -> list[str]:
    """What is wrong with a design that is called valid."""
    result = []
    moving = positions(design, task.watt, np.linspace(0.0, 2.0 * math.pi, MOVES))
    for joint, pins in {"C": "BD", "G": "EF"}.items():
        arms = [moving[pin] - moving[joint] for pin in pins]
        angle = np.abs(np.angle(arms[0] / arms[1]))
        if not np.all(np.isfinite(angle)):
            result.append(f"{joint} does not close over the whole revolution")
        elif angle.min() < task.least - SHARE or angle.max() > math.pi - task.least + SHARE:
            result.append(f"transmission at {joint}: {np.degrees(angle.min())} ... {np.degrees(angle.max())} deg")
    jump = np.max(np.abs(np.diff(moving["P"])))
    if not jump < 0.1 * SIZE:
        result.append(f"P jumps by {jump} m")
    met = positions(design, task.watt, design.crank_angles)["P"]
    error = float(np.sum(np.abs(met - task.points) ** 2))
    if not abs(error - design.objective) <= 1e-6 * design.objective + (1e-9 * SIZE) ** 2:
        result.append(f"objective {design.objective}, measured {error}")
    steps = np.diff(design.crank_angles)
    if not (np.all(steps > 0.0) or np.all(steps < 0.0)) or abs(steps.sum()) > 2.0 * math.pi:
        result.append("the points are not met in order within one revolution")
    for name, value in design.values.items():
        low, high = (0.008, LONG) if name.endswith("length") else (-FAR, FAR)
        if not low - 1e-9 <= value <= high + 1e-9:
            result.append(f"{name} = {value} m")
    return result
