"""What a user may ask does not depend on the kind of requirement, nor on how the linkage is written: every cell is tried.

Each row is a kind of requirement on a linkage; each column an operation. A four-bar and the same four bars as dyads must give the
same optimum.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.presentation.export.export import export
from optlink.studies import pareto, sensitivities, sweep, tolerance
from tests.solved import once

pytestmark = pytest.mark.slow

BOUNDS = ["20 mm", "400 mm"]
FREE = {"start": "90 mm", "bounds": BOUNDS}


def four_bar(*, placed: bool, section: bool) -> dict[str, Any]:
    """A four-bar with free coupler and rocker; `placed`: with a coupler point and free pivots."""
    crank, frame = "40 mm", "120 mm"
    point = {"P": [{"bounds": ["-100 mm", "100 mm"]}, {"bounds": ["-100 mm", "100 mm"]}]}
    if section:
        own = {"pivot": [{"bounds": ["-50 mm", "50 mm"]}, {"bounds": ["-50 mm", "50 mm"]}], "points": point} if placed else {}
        return {"type": "four-bar", "crank": crank, "coupler": FREE, "rocker": FREE, "frame": frame, "assembly": "left", **own}
    links = {
        "crank": {"joints": ["A", "B"], "length": crank},
        "coupler": {"joints": ["B", "C"], "length": FREE, **({"points": point} if placed else {})},
        "rocker": {"joints": ["D", "C"], "length": FREE},
    }
    return {"ground": {"A": ["0 mm", "0 mm"], "D": [frame, "0 mm"]}, "links": links, "assembly": {"C": "left of B-D"}}


def slider_crank() -> dict[str, Any]:
    """A slider-crank with free crank and rod."""
    return {
        "ground": {"A": ["0 mm", "0 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": {"start": "40 mm", "bounds": ["20 mm", "80 mm"]}},
            "rod": {"joints": ["B", "C"], "length": FREE, "points": {"P": ["50 mm", {"bounds": ["-60 mm", "60 mm"]}]}},
            "piston": {"joints": ["C"]},
        },
        "guides": {"slide": {"slider": "piston", "at": "C", "through": ["0 mm", "0 mm"], "direction": "0 deg"}},
        "assembly": {"C": "forward"},
    }


def six_bar() -> dict[str, Any]:
    """A four-bar that drives a slider from its rocker."""
    return {
        "ground": {"A": ["0 mm", "0 mm"], "D": ["120 mm", "0 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": "40 mm"},
            "coupler": {"joints": ["B", "C"], "length": FREE},
            "rocker": {"joints": ["D", "C"], "length": FREE, "points": {"E": ["80 mm", "0 mm"]}},
            "rod": {"joints": ["E", "F"], "length": {"start": "160 mm", "bounds": ["100 mm", "300 mm"]}},
            "ram": {"joints": ["F"]},
        },
        "guides": {"slide": {"slider": "ram", "at": "F", "through": ["0 mm", "130 mm"], "direction": "0 deg"}},
        "assembly": {"C": "left of B-D", "F": "forward"},
    }


LAW = {"kind": "function", "law": "psi0 + 0.3*(1 - cos(phi - phi0))", "span": "180 deg"}
PLACES = [(60.0, 80.0, 37.0), (52.0, 93.0, 22.0), (13.0, 80.0, 20.0)]
POINTS = [{"x": f"{x} mm", "y": f"{y} mm"} for x, y, _ in PLACES]
POSES = [{"x": f"{x} mm", "y": f"{y} mm", "angle": f"{turned} deg"} for x, y, turned in PLACES]
LINKAGES: dict[str, Callable[..., dict[str, Any]]] = {
    "four-bar": functools.partial(four_bar, section=True),
    "dyads": functools.partial(four_bar, section=False),
}
ROWS: dict[str, dict[str, Any]] = {}
for _name, _linkage in LINKAGES.items():
    _law = {"output": "rocker", "psi0": "output at the start"} if _name == "dyads" else {}
    ROWS |= {
        f"law, {_name}": {"mechanism": _linkage(placed=False), "requirement": {**LAW, **_law, "start": "20 deg"}},
        f"largest law error, {_name}": {
            "mechanism": _linkage(placed=False),
            "requirement": {**LAW, **_law, "start": "20 deg", "measure": "max"},
        },
        f"path, {_name}": {"mechanism": _linkage(placed=True), "requirement": {"kind": "path", "points": POINTS}},
        f"poses, {_name}": {"mechanism": _linkage(placed=True), "requirement": {"kind": "motion", "points": POSES}},
        f"transmission, {_name}": {"mechanism": _linkage(placed=False), "requirement": {"kind": "transmission"}},
    }
ROWS |= {
    "law, slider-crank": {
        "mechanism": slider_crank(),
        "requirement": {
            "kind": "function",
            "output": "slide",
            "law": {"slide": "s0 + 30*(cos(phi - phi0) - 1)", "unit": "mm"},
            "span": "120 deg",
            "start": "10 deg",
        },
    },
    "path, slider-crank": {
        "mechanism": slider_crank(),
        "requirement": {"kind": "path", "points": [["70 mm", "30 mm"], ["55 mm", "38 mm"], ["20 mm", "35 mm"]]},
    },
    "transmission, six-bar": {"mechanism": six_bar(), "requirement": {"kind": "transmission"}},
    "stroke, slider-crank": {
        "mechanism": slider_crank(),
        "requirement": {"kind": "stroke", "output": "piston", "stroke": "100 mm"},
        "drive": {"speed": "60 rpm"},
    },
}
SAME = ("law", "largest law error", "transmission")


def problem(row: str, changes: dict[str, Any] | None = None) -> optlink.ProblemFile:
    """The problem of a row, with tolerances of its free lengths."""
    raw = {"title": row, **ROWS[row]}
    lengths = (
        ("coupler", "rocker")
        if "links" not in raw["mechanism"]
        else tuple(f"{name}.length" for name, link in raw["mechanism"]["links"].items() if isinstance(link.get("length"), dict))
    )
    read = optlink.read({**raw, "tolerances": dict.fromkeys(lengths, "0.1 mm")})
    return read if changes is None else read.override(changes)


@functools.cache
def solved(row: str) -> Any:
    """The result of a row."""
    return once(f"matrix, {row}", lambda: optlink.solve(problem(row), starts=24))


def _back_ends(row: str, folder: Path) -> None:
    result = optlink.solve(problem(row), "both", starts=24)
    assert result.valid
    assert set(result.backends) == {"ipopt", "slsqp"}
    assert result.objective == pytest.approx(solved(row).objective, rel=1e-6, abs=1e-12)


def _designs(row: str, folder: Path) -> None:
    if row.startswith("stroke"):
        pytest.skip("a problem over the cycle has its distinct optima in its result")
    result = optlink.solve(problem(row), starts=24, designs=2)
    assert result.valid
    assert result.objective == pytest.approx(solved(row).objective, rel=1e-6, abs=1e-12)


def _either(row: str, folder: Path) -> None:
    dyads = "links" in ROWS[row]["mechanism"]
    joints = ROWS[row]["mechanism"]["assembly"]
    open_ = {"mechanism.assembly": dict.fromkeys(joints, "either") if dyads else "either"}
    result = optlink.solve(problem(row, open_), starts=48)
    assert result.valid
    assert result.objective <= solved(row).objective * (1.0 + 1e-6) + 1e-12


def _sweep(row: str, folder: Path) -> None:
    varied = {
        "mechanism.frame": "119, 120 mm",
        "mechanism.links.crank.length": "39, 40 mm",
        "requirement.stroke": "95, 100 mm",
        "mechanism.guides.slide.direction": "0, 1 deg",
    }
    key = next(key for key in varied if _fixed(row, key))
    found = sweep(problem(row), [f"{key}={varied[key]}"], folder / "sweep")
    assert found.statuses == {"optimal": 2}


def _fixed(row: str, key: str) -> bool:
    """Whether the problem of a row has a fixed value under a key."""
    table: Any = ROWS[row]
    for step in key.split("."):
        if not isinstance(table, dict) or step not in table:
            return False
        table = table[step]
    return not isinstance(table, dict)


def _sensitivity(row: str, folder: Path) -> None:
    assert sensitivities(problem(row)).to_dict()


def _pareto(row: str, folder: Path) -> None:
    own, other = ("error", "limits.transmission_angle.min")
    if row.startswith("transmission"):
        other = "limits.total.max"
    if row.startswith("stroke"):
        own, other = "objective", "total length"
    changes: dict[str, dict[str, Any]] = {
        "limits.transmission_angle.min": {"limits.transmission_angle": ["20 deg", "160 deg"]},
        "limits.total.max": {"limits.total": {"quantity": "total length", "max": "700 mm"}},
        "total length": {},
    }
    front = pareto(problem(row, changes[other]), f"{own}, {other}", folder / "front", points=3)
    assert front.to_dict()


def _tolerance(row: str, folder: Path) -> None:
    if row.startswith("stroke"):
        pytest.skip("a stroke is kept exactly: it has no error")
    study = tolerance(problem(row), output="error at F" if row.endswith("six-bar") else "error", samples=2000)
    assert np.all(np.isfinite(study.sigma))


def _robust(row: str, folder: Path) -> None:
    if row.startswith("stroke"):
        pytest.skip("quantities of machine cycles have no robust objective")
    largest = row.startswith(("largest", "transmission"))
    measure, robust = ("max", "3 sigma") if largest else ("sum of squares", "expected value")
    result = optlink.solve(problem(row, {"requirement.measure": measure, "requirement.robust": robust}), starts=24)
    assert result.valid
    assert result.objective >= solved(row).objective * (1.0 - 1e-9)


def _validate(row: str, folder: Path) -> None:
    again = optlink.validate(problem(row), {name: solved(row).design[name] for name in problem(row).model.free})
    assert again.valid
    assert again.objective == pytest.approx(solved(row).objective, rel=1e-6, abs=1e-12)


def _report(row: str, folder: Path) -> None:
    from optlink.presentation.html.page import page
    from optlink.presentation.report_model import report_model_of

    text = page(report_model_of(solved(row)))
    assert row in text
    assert "nan" not in text.lower().split()


def _export(row: str, folder: Path) -> None:
    from optlink.presentation.report_model import report_model_of

    for suffix in ("dxf", "svg", "csv", "json"):
        export(report_model_of(solved(row)), folder / f"file.{suffix}")
    assert json.loads((folder / "file.json").read_text())


def _certificate(row: str, folder: Path) -> None:
    try:
        result = optlink.solve(problem(row), starts=24, certify=True, gap=0.5, time_limit=1.0)
    except optlink.InputError as refusal:
        assert "certificate" in str(refusal)
        assert refusal.faults[0].remedy
    else:
        assert result.certificate is not None
        assert result.certificate.lower_bound <= result.objective * (1.0 + 1e-9) + 1e-15


COLUMNS: dict[str, Callable[[str, Path], None]] = {
    "both back ends": _back_ends,
    "several designs": _designs,
    "either mode": _either,
    "sweep": _sweep,
    "sensitivity": _sensitivity,
    "pareto": _pareto,
    "tolerance of the error": _tolerance,
    "robust": _robust,
    "validate": _validate,
    "report": _report,
    "export": _export,
    "certificate": _certificate,
}


@pytest.mark.parametrize("row", ROWS)
@pytest.mark.parametrize("column", COLUMNS)
def test_every_operation_serves_every_requirement_on_every_linkage(row: str, column: str, tmp_path: Path) -> None:
    assert solved(row).valid
    COLUMNS[column](row, tmp_path)


@pytest.mark.parametrize("kind", SAME)
def test_four_bars_have_the_same_optimum_however_they_are_written(kind: str) -> None:
    section, dyads = solved(f"{kind}, four-bar"), solved(f"{kind}, dyads")
    assert math.sqrt(section.objective) == pytest.approx(math.sqrt(dyads.objective), rel=1e-8, abs=1e-9)
