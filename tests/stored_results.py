"""Small stored results of every kind, kept as they were written: `python -m tests.stored_results` writes those of a new number.

The files of a released number stay as they are: its versions wrote them. Those of a number that is not yet released follow it:
remove them and write them again.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import optlink
from optlink.problem.upgrades import VERSION_OF_SCHEMAS
from optlink.studies.motion_sensitivity import OutputStudy

FOLDER = Path(__file__).parent / "data" / "results"
CLEARANCE = optlink.load("crank-rocker-clearance")


def _slopes() -> OutputStudy:
    machine = optlink.analyze("shaper", points=6).machine
    return OutputStudy(optlink.load("shaper"), "rocker", machine.sizes, np.array([0.1, 0.2]))


MAKERS: dict[str, Callable[[], Any]] = {
    "design": lambda: optlink.solve("crank-rocker"),
    "design-not-valid": lambda: optlink.validate("crank-rocker", {"coupler": 0.4, "rocker": 0.32, "phi0": 0.8}),
    "design-infeasible": lambda: optlink.solve(
        optlink.load("crank-rocker").override({"limits.transmission_angle": ["85 deg", "95 deg"]})
    ),
    "design-poses": lambda: optlink.solve("motion-3-poses", designs=1),
    "design-machine": lambda: optlink.solve("shaper-design", starts=1),
    "analysis": lambda: optlink.analyze("shaper", points=12),
    "simulation": lambda: optlink.simulate("slider-crank", rows=12),
    "clearance": lambda: optlink.control.simulate_clearance("slider-crank-clearance", 1, points=12),
    "control-comparison": lambda: optlink.control.compare(CLEARANCE, 1, 1, points=72),
    "tuning": lambda: optlink.control.tune(
        CLEARANCE, "pid", ("proportional",), evaluations=4, starts=1, revolutions=2, points=72
    ),
    "balance": lambda: optlink.balance("balance-four-bar", trade="force,torque", points=3),
    "sensitivity": lambda: optlink.studies.sensitivities("crank-rocker"),
    "output-sensitivity": _slopes,
    "sweep": lambda: optlink.studies.sweep("crank-rocker", ["limits.transmission_angle.min=30..40 deg:2"], workers=1),
    "tolerance": lambda: optlink.studies.tolerance("crank-rocker-robust", samples=64),
    "pareto": lambda: optlink.studies.pareto("crank-rocker", "error, limits.transmission_angle.max", points=3, workers=1),
}
"""By name of the file, which begins with the kind."""


def main() -> int:
    """Write the files of the present number that there are not yet."""
    place = FOLDER / str(VERSION_OF_SCHEMAS)
    place.mkdir(parents=True, exist_ok=True)
    for name, make in MAKERS.items():
        file = place / f"{name}.json"
        if not file.exists():
            file.write_text(json.dumps(make().to_dict()) + "\n", encoding="utf-8", newline="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
