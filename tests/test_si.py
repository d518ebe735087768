"""Every number of the Python interface is SI; a display value stands beside its unit in one object, or has it in its key."""

from __future__ import annotations

import contextlib
import inspect
import math
import numbers
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.studies import pareto, sensitivities, sweep, tolerance
from optlink.units import in_si

RESULTS = {
    "law": lambda: optlink.solve(optlink.load("crank-rocker")),
    "law of a slider-crank": lambda: optlink.solve(optlink.load("law-slider-crank")),
    "stroke": lambda: optlink.solve(optlink.load("stroke-crank-rocker")),
    "conflict": lambda: optlink.solve(optlink.load("crank-rocker", {"limits.transmission_angle": ["80 deg", "90 deg"]})),
    "validation": lambda: optlink.validate(optlink.load("crank-rocker"), {"coupler": 0.4, "rocker": 0.2}),
    "cycle": lambda: optlink.solve(optlink.load("shaper-design"), starts=1),
    "path": lambda: optlink.solve(optlink.load("path-arc5"), starts=4),
    "function": lambda: optlink.solve(optlink.load("function-sin"), starts=2),
    "balance": lambda: optlink.balance(optlink.load("balance-six-bar"), trade="force,torque", points=4),
    "analysis": lambda: optlink.analyze(optlink.load("six-bar"), points=12),
    "simulation": lambda: optlink.simulate(optlink.load("six-bar"), duration=0.01, rows=3),
    "clearance": lambda: optlink.control.simulate_clearance(optlink.load("slider-crank-clearance"), revolutions=1, points=12),
    "comparison": lambda: optlink.control.compare(optlink.load("crank-rocker-clearance"), 2, 1, kinds=["none"], points=12),
    "sensitivities": lambda: sensitivities(optlink.load("crank-rocker"), check=True),
    "sweep": lambda: sweep(optlink.load("crank-rocker"), ["mechanism.frame=480..520 mm:2"]),
    "tolerance": lambda: tolerance(optlink.load("crank-rocker"), ["coupler=0.1 mm"], limit="2.3 deg", samples=256),
    "front": lambda: pareto(optlink.load("crank-rocker"), "error, limits.transmission_angle.max", points=3),
}
PAIRS = {"Check", "Relaxation", "TermFigure", "ActiveLimit", "RelaxedLimit", "Axis", "ParetoObjective"}
"""Classes that state a display value with its unit beside it, as the description of the Python interface says."""
DISPLAYED = {"displayed", "displayed_limits", "shown"}
"""Attributes that are documents in display units, by name."""
NO_RESULTS = {
    "nlp",
    "source",  # the same
    "whole",
    "part",
    "section",
    "problem",
    "machine",
    "task",
    "spec",
    "model",
    "definite",
    "variants",
    "record",
    "scale",
}
SI = {"", "rad", "rad^2", "m", "m^2", "N", "N m", "N*m"}


@cache
def result(name: str) -> Any:
    return RESULTS[name]()


def parts(item: Any, place: str, seen: dict[int, Any], depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yield every object of the package in a result, with the attributes that lead to it."""
    plain = isinstance(item, str | bytes | numbers.Number | np.ndarray | type | None) or callable(item)
    if plain or depth > 7 or id(item) in seen:
        return
    seen[id(item)] = item
    if hasattr(item, "items") or isinstance(item, list | tuple):
        entries = item.items() if hasattr(item, "items") else enumerate(item)
        for key, value in list(entries)[:50]:
            yield from parts(value, f"{place}[{key!r}]", seen, depth + 1)
    elif type(item).__module__.startswith("optlink"):
        yield place, item
        for name in set(dir(item)) - DISPLAYED - NO_RESULTS:
            value = None
            with contextlib.suppress(Exception):  # what the result of this kind does not have
                value = getattr(item, name)
            if not name.startswith("_") and not inspect.isroutine(value):
                yield from parts(value, f"{place}.{name}", seen, depth + 1)


@pytest.mark.slow
@pytest.mark.parametrize("name", RESULTS)
def test_a_number_with_a_unit_beside_it_is_si_or_states_both_in_one_object(name: str) -> None:
    met = 0
    for place, item in parts(result(name), name, {}):
        if not isinstance(unit := getattr(item, "unit", None), str):
            continue
        met += 1
        if type(item).__name__ in PAIRS:
            assert any(isinstance(value, float | tuple) for value in vars(item).values()), place
        else:
            assert unit in SI, f"{place} has the unit {unit}"
    assert met or name in {"analysis", "simulation"}


def test_every_unit_that_counts_as_si_here_is() -> None:
    for unit in SI - {"", "rad^2", "m^2"}:
        assert in_si(unit)[0] == 1.0
    assert in_si("mm") == (1e-3, "m")
    assert in_si("deg") == (math.radians(1.0), "rad")
    assert in_si("kN*m") == (1e3, "N*m")
    assert in_si("rpm") == (pytest.approx(math.tau / 60.0, rel=1e-15), "rad/s")
    assert in_si("") == (1.0, "")
    assert in_si("%") == (1.0, "%")


@pytest.mark.parametrize("name", ["law of a slider-crank", "stroke", pytest.param("cycle", marks=pytest.mark.slow)])
def test_limits_are_those_of_the_tables_in_si(name: str) -> None:
    solution = result(name).solution
    assert len(solution.limits) == len(solution.displayed_limits) > 3
    for limit, shown in zip(solution.limits, solution.displayed_limits, strict=True):
        size, unit = in_si(shown.unit)
        assert (limit.key, limit.name, limit.sense, limit.active, limit.unit) == (
            shown.key, shown.name, shown.sense, shown.active, unit,
        )  # fmt: skip
        for one, other in ((limit.value, shown.value), (limit.bound, shown.bound), (limit.slack, shown.slack)):
            assert one == pytest.approx(size * other, rel=1e-12, abs=1e-14, nan_ok=True)
        assert limit.multiplier == pytest.approx(shown.multiplier / size, rel=1e-12)
    assert any(limit.multiplier for limit in solution.limits)


@pytest.mark.slow
def test_the_objective_of_a_stroke_is_in_the_unit_beside_it() -> None:
    stroke = result("stroke")
    goal = stroke.figures[0]
    size, unit = in_si(goal.unit)
    assert unit == stroke.problem.spec.objective_unit == stroke.to_dict()["objective"]["unit"] == "rad"
    assert stroke.objective == pytest.approx(size * goal.result, rel=1e-9)
    assert goal.unit == "deg"


def test_a_conflict_is_known_in_si() -> None:
    for item in result("conflict").conflict:
        assert (item.unit, item.in_si.unit) == ("deg", "rad")
        assert item.in_si.relaxed == pytest.approx(math.radians(item.relaxed), rel=1e-15)
        assert item.in_si.amount == pytest.approx(math.radians(item.amount), rel=1e-15)


@pytest.mark.parametrize(("key", "step"), [("mechanism.frame", 2e-5), ("limits.transmission_angle.max", 7e-5)])
def test_sensitivities_agree_with_problems_changed_by_numbers_in_si(key: str, step: float) -> None:
    problem, row = optlink.load("crank-rocker"), result("sensitivities")[key]
    value = row.parameter.value
    above, below = (optlink.solve(problem.override({key: value + change})) for change in (step, -step))
    assert row.objective == pytest.approx((above.objective - below.objective) / (2.0 * step), rel=1e-4)
    for name, rate in row.design.items():
        assert rate == pytest.approx((above.design[name] - below.design[name]) / (2.0 * step), rel=1e-4)
        assert result("sensitivities").units[name] == "m"
        assert result("sensitivities").values[name] == pytest.approx(0.5 * (above.design[name] + below.design[name]), rel=1e-4)
    assert row.below.value < value < row.above.value or math.isinf(row.above.value)
    assert row.check.objective == pytest.approx(row.objective, rel=1e-3)
    shown = result("sensitivities").displayed[key]
    assert in_si(shown.parameter.unit) == (pytest.approx(row.objective and shown.objective / row.objective), row.parameter.unit)
    assert shown.effect == pytest.approx(row.effect, rel=1e-9)


def test_the_optimum_of_one_problem_can_be_fed_back_into_another() -> None:
    found = result("law")
    fixed = {f"mechanism.{name}": value for name, value in found.sizes.items()}
    other = optlink.load("crank-rocker", {"limits.transmission_angle.max": math.radians(150.0)})
    started = other.override({f"mechanism.{name}.start": found.design[name] for name in ("coupler", "rocker")})
    assert started.model.quantities["coupler"].value == pytest.approx(found.design["coupler"], rel=1e-15)
    assert started.model.quantities["coupler"].bounds == other.model.quantities["coupler"].bounds
    assert optlink.solve(started).objective <= found.objective
    angles = [optlink.analyze(one).extremes["C.transmission_rad"] for one in (other.override(fixed), found.machine)]
    assert angles[0].largest == pytest.approx(angles[1].largest, rel=1e-9)
    assert optlink.load("crank-rocker", other.overrides).model == other.model  # they are texts with units: a file can have them


def ends(model: Any) -> tuple[float, float]:
    return model.limits.transmission_angle.low, model.limits.transmission_angle.high


@pytest.mark.parametrize(
    ("name", "key", "value", "read"),
    [
        ("six-bar", "drive.speed", 12.5, lambda model: model.drive.speed.value),
        ("six-bar", "bodies.link2.mass", np.float64(1.75), lambda model: model.bodies["link2"].mass.value),
        ("crank-rocker", "limits.transmission_angle", [0.8, 2.25], ends),
        ("crank-rocker", "mechanism.coupler.min", 0.25, lambda model: model.quantities["coupler"].low),
        ("crank-rocker", "mechanism.coupler", {"start": 0.5, "bounds": [0.4, 0.6]}, lambda m: m.quantities["coupler"].value),
    ],
)
def test_a_number_in_an_override_is_si(name, key, value, read) -> None:
    model = optlink.load(name).override({key: value}).model
    expected = value["start"] if isinstance(value, dict) else value
    assert np.allclose(read(model), expected, rtol=1e-15)


def test_a_number_without_a_unit_in_a_file_is_not_guessed() -> None:
    raw = dict(optlink.load("crank-rocker").raw)
    for value in (480, "480"):
        with pytest.raises(optlink.InputError, match=r'frame = .*: a length needs a unit\. Write "480 mm"'):
            optlink.load("crank-rocker", {"mechanism.frame": value})
    with pytest.raises(optlink.InputError, match=r'crank = 0\.1: a length needs a unit\. Write "0\.1 mm" or "0\.1 m"'):
        optlink.read({**raw, "mechanism": {**raw["mechanism"], "crank": 0.1}})
