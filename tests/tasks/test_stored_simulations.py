"""Stored simulations, comparisons of control and tunings: read from their file alone, they are what the functions returned."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.dynamics.forward import Ending
from optlink.errors import InputError
from optlink.presentation.format import single_units
from optlink.presentation.html.study_page import study_page
from optlink.presentation.registry import read_result, table_of, view_of
from optlink.problem.file import ProblemFile
from tests.tiers import mostly_slow

ROTOR = {
    "title": "A rotor",
    "mechanism": {"ground": {"A": ["0 m", "0 m"]}, "links": {"crank": {"joints": ["A", "B"], "length": "0.5 m"}}},
    "bodies": {"crank": {"mass": "2 kg", "inertia": "uniform bar"}},
}
BRAKE = {"brake": {"on": "crank", "torque": "0.6 N*m", "acts": "opposing"}}
SOFT = {"joints.C.modulus": None, "joints.C.poisson": None, "joints.C.stiffness": "1 N/m^1.5"}
QUICK: dict[str, Any] = {"points": 36, "tolerance": 1e-6, "integrator": "cvodes"}
PLAY, ROCKER = "slider-crank-clearance", "crank-rocker-clearance"


def rotor(**changes: object) -> optlink.Simulation:
    return optlink.simulate(optlink.read({**ROTOR, **changes}, folder=Path()), duration=3.0, rows=60)


def clearance(name: str, revolutions: int, changes: dict[str, Any] | None = None, **options: Any) -> Any:
    return optlink.control.simulate_clearance(optlink.load(name, changes or {}), revolutions, **{**QUICK, **options})


def interrupted() -> Any:
    def stop(rows: object) -> None:
        if rows is not None:
            seen.append(rows)
        if len(seen) == 2:
            raise KeyboardInterrupt

    seen: list[object] = []
    return clearance(PLAY, 4, stream=stop)


def pulled_through() -> Any:
    """The load grows until the bearing gives way."""
    pull = {"on": "slider", "force": {"expression": "exp(phi/3)", "unit": "N"}}
    return clearance(PLAY, 12, {**SOFT, "joints.C.stiffness": "1e8 N/m^1.5", "loads.pull": pull})


RESULTS: dict[str, Callable[[], Any]] = {
    "simulation": lambda: optlink.simulate(optlink.load("six-bar"), rows=60),
    "simulation under a torque": lambda: optlink.simulate(
        optlink.load("slider-crank", {"drive.torque": "5 N*m"}), duration=0.3, rows=60, flywheel=0.02
    ),
    "simulation of given sizes": lambda: optlink.simulate(
        optlink.load("crank-rocker"), speed=5.0, rows=60, design={"coupler": 0.43, "rocker": 0.22}
    ),
    "simulation to rest": lambda: rotor(loads=BRAKE, drive={"torque": "0 N*m", "initial_speed": "6 rad/s"}),
    "simulation that stalls": lambda: rotor(drive={"torque": {"expression": "log(omega)", "unit": "N*m"}, "speed": "0 rad/s"}),
    "simulation to a dead position": lambda: optlink.simulate(
        optlink.load("six-bar", {"mechanism.links.link3.length": "0.3 m"}), duration=1.0
    ),
    "clearance": lambda: clearance(PLAY, 12),
    "clearance with control": lambda: clearance(ROCKER, 2, control="inverse+pid", flywheel=0.1),
    "clearance that stalls at once": lambda: clearance(PLAY, 2, SOFT),
    "clearance that stalls later": pulled_through,
    "clearance, interrupted": interrupted,
    "comparison": lambda: optlink.control.compare(optlink.load(ROCKER), 1, 2, **QUICK),
    "comparison that stalls": lambda: optlink.control.compare(optlink.load(ROCKER, SOFT), 1, 1, kinds=("none", "pid"), **QUICK),
    "tuning": lambda: optlink.control.tune(
        optlink.load(ROCKER), "pid", ("proportional",), evaluations=4, starts=1, revolutions=1, **QUICK
    ),
    "tuning that stalls": lambda: optlink.control.tune(
        optlink.load(ROCKER, SOFT), "pid", evaluations=4, starts=1, revolutions=1, **QUICK
    ),
}
OFTEN = ("simulation of given sizes", "simulation to rest", "simulation that stalls", "clearance", "comparison that stalls")
PAGES = [name for name in RESULTS if not name.startswith("tuning")]


@cache
def made(name: str) -> Any:
    return RESULTS[name]()


def stored(result: Any, folder: Path) -> Any:
    path = folder / "result.json"
    path.write_text(json.dumps(result.to_dict(), allow_nan=False), encoding="utf-8")
    return read_result(path)


def same(one: Any, other: Any, place: str = "") -> None:
    """Fail unless two results have equal fields of the same types, to the last bit."""
    assert type(one) is type(other), place
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype, place
        np.testing.assert_array_equal(one, other, place)
    elif isinstance(one, ProblemFile):
        assert (one.hash, one.file, dict(one.overrides)) == (other.hash, other.file, dict(other.overrides)), place
    elif dataclasses.is_dataclass(one):
        for item in dataclasses.fields(one):
            same(getattr(one, item.name), getattr(other, item.name), f"{place}.{item.name}")
    elif isinstance(one, dict):
        assert list(one) == list(other), place
        for key in one:
            same(one[key], other[key], f"{place}.{key}")
    elif isinstance(one, tuple | list):
        assert len(one) == len(other), place
        for k, pair in enumerate(zip(one, other, strict=True)):
            same(*pair, f"{place}[{k}]")
    else:
        assert one == other or (isinstance(one, float) and math.isnan(one) and math.isnan(other)), place


@pytest.mark.parametrize("name", mostly_slow(RESULTS, *OFTEN, "tuning that stalls"))
def test_a_stored_result_is_the_one_that_was_written(name, tmp_path, monkeypatch):
    result = made(name)
    monkeypatch.chdir(tmp_path)
    again = stored(result, tmp_path)
    same(result, again)
    assert again.to_dict() == json.loads((tmp_path / "result.json").read_text())
    assert table_of(result.kind)(again) == table_of(result.kind)(result)


@pytest.mark.parametrize("name", mostly_slow(PAGES, *OFTEN))
def test_page_charts_and_table_of_a_stored_result(name, tmp_path):
    result, again = made(name), stored(made(name), tmp_path)
    view = view_of(result.kind)
    for one, other in ((view.charts(result), view.charts(again)), (view.tables(result), view.tables(again))):
        same(one, other)
    with single_units():
        assert study_page(view.page(again)) == study_page(view.page(result))


@pytest.mark.slow
def test_the_cases_end_as_their_names_say():
    endings = {name: getattr(made(name), "ending", None) for name in RESULTS}
    stalled = {name for name in RESULTS if name.endswith(("stalls", "at once", "later"))}
    assert {name for name, ending in endings.items() if ending is Ending.STALLED} == {
        name for name in stalled if not name.startswith(("comparison", "tuning"))
    }
    assert endings["simulation to rest"] is Ending.AT_REST
    assert endings["simulation to a dead position"] is Ending.DEAD_POSITION
    assert endings["clearance, interrupted"] is Ending.INTERRUPTED
    assert any(np.isnan(values).any() for values in made("simulation that stalls").columns.values())
    assert made("clearance that stalls at once").revolutions == 0 < made("clearance that stalls later").revolutions
    assert not made("comparison that stalls").valid
    assert np.isinf(made("tuning that stalls").costs).all()
    assert made("tuning").check is not None
    assert np.isinf(made("tuning").costs).any()


@pytest.mark.slow
def test_the_machine_of_a_stored_simulation_is_the_one_that_moved(tmp_path):
    for name in ("simulation under a torque", "simulation of given sizes", "clearance with control"):
        one, other = made(name).machine, stored(made(name), tmp_path).machine
        assert one.sizes == other.sizes
        assert one.inertias == other.inertias
    assert stored(made("simulation of given sizes"), tmp_path).sizes["coupler"] == 0.43
    heavier, plain = made("clearance with control").machine, optlink.load(ROCKER).model.machine()
    crank = plain.mechanism.crank.body
    assert heavier.inertias[crank].moment == pytest.approx(plain.inertias[crank].moment + 0.1)


@pytest.mark.slow
def test_a_measured_series_is_in_the_file(tmp_path):
    """The simulated output with a tenth of a millimetre added; the CSV file is gone when the result is read."""
    plain = made("clearance")
    rows = slice(-36, None)
    lines = [
        f"{at:.12g},{1e3 * value + 0.1:.12g}" for at, value in zip(plain["time_s"][rows], plain["slider.s_m"][rows], strict=True)
    ]
    series = tmp_path / "series.csv"
    series.write_text("\n".join(["time_s,displacement_mm", *lines]) + "\n")
    result = clearance(PLAY, 12, {"measured.csv": str(series)})
    assert result.figures["measured.mean_m"] == pytest.approx(1e-4, rel=1e-6)
    text = json.dumps(result.to_dict())
    series.unlink()
    (tmp_path / "result.json").write_text(text)
    again = read_result(tmp_path)
    same(result, again)
    assert "measured" in [chart.file for chart in view_of("clearance").charts(again)]


@pytest.mark.parametrize("name", ["simulation to rest", "clearance", "comparison that stalls", "tuning that stalls"])
@pytest.mark.parametrize("key", ["problem_file", "title", "crc32"])
def test_a_changed_document_is_refused_in_one_sentence(name, key, tmp_path):
    document = json.loads(json.dumps(made(name).to_dict()))
    document[key] = {**document[key], "file": "other.toml"} if key == "problem_file" else "other"
    (tmp_path / "result.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match="the result was changed since it was written") as caught:
        read_result(tmp_path)
    assert len(caught.value.faults) == 1
