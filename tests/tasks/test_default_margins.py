"""A margin that the file does not state is named where it excludes a better optimum: a planted four-bar near its change point."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import optlink
from tests import synthesis_oracle as oracle
from tests.stated import document, four_bar_section, free

SLACK = 3e-5  # of the longest link: below the default margin of 1e-4, above the smallest one of 1e-5
LINKAGE = {"crank": 30.0, "frame": 100.0, "coupler": 80.0, "rocker": 50.0 + 100.0 * SLACK}


def timed_path() -> dict[str, Any]:
    """Ten points of its coupler curve, at their crank angles."""
    angles = np.sort(np.random.default_rng(1).uniform(0.0, 5.5, 10))
    place = {"x": 0.0, "y": 0.0, "direction": 0.3, "mode": 1, "along": 40.0, "across": 30.0}
    rows = oracle.planted_path({**LINKAGE, **place}, angles)
    raw = document(four_bar_section("left"), rows, {"link_ratio": [0.01, 100.0], "alignment": "0.1 deg"})
    turned = np.degrees(angles - angles[0]).tolist()
    raw["requirement"]["points"] = [
        point | {"crank": f"{turn!r} deg"} for point, turn in zip(raw["requirement"]["points"], turned, strict=True)
    ]
    raw["requirement"] |= {"timing": "from start", "start": free(-180.0, 180.0, 0.0, "deg")}
    return raw


def law() -> dict[str, Any]:
    """A table of its rocker, by the law of cosines."""
    crank = np.radians(np.linspace(30.0, 330.0, 16))
    arm = LINKAGE["crank"] * np.exp(1j * crank) - LINKAGE["frame"]
    cosine = (np.abs(arm) ** 2 + LINKAGE["rocker"] ** 2 - LINKAGE["coupler"] ** 2) / (2.0 * LINKAGE["rocker"] * np.abs(arm))
    phi, psi = (np.degrees(one - one[0]).tolist() for one in (crank, np.unwrap(np.angle(arm) - np.arccos(cosine))))
    sizes = {name: {"start": f"{LINKAGE[name]} mm", "bounds": ["10 mm", "300 mm"]} for name in ("crank", "coupler", "rocker")}
    start = {"start": "30 deg", "bounds": ["0 deg", "60 deg"]}
    requirement = {"kind": "function", "from": start, "psi0": {"bounds": ["-360 deg", "360 deg"]}}
    table = {"phi": [f"{one!r} deg" for one in phi], "psi": [f"{one!r} deg" for one in psi]}
    return {
        "mechanism": {"type": "four-bar", "frame": "100 mm", "assembly": "left", **sizes},
        "requirement": {**requirement, "law": table},
        "limits": {"alignment": "0.1 deg", "crank": "full rotation"},
    }


@pytest.mark.slow
@pytest.mark.parametrize("raw", [timed_path(), law()], ids=["path", "law"])
def test_a_default_margin_that_excludes_a_better_optimum_is_named_with_its_gain(raw: dict[str, Any]) -> None:
    result = optlink.solve(optlink.read(raw), starts=60 if "points" in raw["requirement"] else 1, certify=False)
    note = next(note for note in result.notes if note.startswith("the default length_margin of 0.0001"))
    assert result.valid
    assert "limits.length_margin = 1e-05 gains" in note
    assert "(100.000 %)" in note  # the planted linkage is exact
    stated = {**raw, "limits": {**raw["limits"], "length_margin": 1e-5}}
    better = optlink.solve(optlink.read(stated), starts=60 if "points" in raw["requirement"] else 1, certify=False)
    assert not any("length_margin" in note for note in better.notes)
    assert math.sqrt(better.objective) < 1e-3 * math.sqrt(result.objective)
    assert better.design["rocker"] == pytest.approx(1e-3 * LINKAGE["rocker"], rel=1e-6)
