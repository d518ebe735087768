"""The programme of `optlink.build`: derivatives, units, the way back to a design, and what it refuses."""

from __future__ import annotations

import itertools
import json
import math
import re
from functools import cache
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.tasks.programme import Programme
from tests.crank_rocker_oracle import FRAME, error, extreme_cosines, slacks
from tests.solved import loaded
from tests.tiers import mostly_slow

Array = np.ndarray
OTHERS = {"analysis", "balance"}
DESIGNED = [name for name in optlink.shipped() if loaded(name).task not in OTHERS]
QUICK = ("crank-rocker", "crank-rocker-robust", "path-ellipse10", "stroke-slider-crank")
MARGIN = loaded("crank-rocker").spec.limits.length_margin
STEP = 1e-6  # of a central difference, as a share of the size of a variable


def definite(name: str) -> optlink.ProblemFile:
    """A shipped problem with one programme: the first assembly mode, and a crank that turns clockwise where it may choose."""
    problem = optlink.load(name).variants()[0]
    requirement = getattr(problem.model, "requirement", None)
    if problem.task == "path" and problem.model.data.offsets is None and requirement.rotation == "either":
        problem = problem.override({"requirement.rotation": "clockwise"})
    return problem


@cache
def programme(name: str) -> Programme:
    return optlink.build(definite(name))


def somewhere(programme: Programme) -> Array:
    """A point beside the start, in which everything is defined."""
    random, reach = np.random.default_rng(1), 0.02
    design = programme.design(programme.x_start)
    for k in range(2000):
        bounds = {name: programme.problem.model.quantities[name].bounds for name in design}
        near = {name: design[name] + reach * (high - low) * random.uniform(-1.0, 1.0) for name, (low, high) in bounds.items()}
        x = programme.x_of(near)
        x = x + 1e-3 * np.where([v.key == "" for v in programme.variables], np.abs(x), 0.0) * random.uniform(-1.0, 1.0, len(x))
        if programme.at(x).finite:
            return x
        reach = 0.02 + 0.48 * k / 2000
    raise AssertionError("no such point")


def sizes(programme: Programme, x: Array) -> Array:
    width = programme.x_high - programme.x_low
    return np.maximum(np.abs(x), np.where(np.isfinite(width), 0.1 * width, 0.0))


FORMS = ("SI", "scaled")
QUICK_FORMS = list(itertools.product(QUICK, FORMS))
OTHER_FORMS = [(name, FORMS[k % 2]) for k, name in enumerate(DESIGNED) if name not in QUICK]  # each in one form


@pytest.mark.parametrize(("name", "form"), mostly_slow([*QUICK_FORMS, *OTHER_FORMS], *QUICK_FORMS))
def test_derivatives_are_those_of_finite_differences(name: str, form: str) -> None:
    built = programme(name) if form == "SI" else programme(name).scaled()
    x = somewhere(built)
    step, multipliers = STEP * sizes(built, x), np.random.default_rng(2).standard_normal(len(built.constraints))
    point, unit = built.at(x), np.eye(len(x))
    slopes = np.max(np.abs(point.jacobian), axis=1, initial=0.0)
    sloping = slopes > 1e-9 * np.max(slopes, initial=0.0)  # the error at the start vanishes for every design
    multipliers = np.where(sloping, multipliers / np.maximum(slopes * np.max(step), 1e-300), 0.0)
    hessian = built.hessian(x, multipliers, 0.7)
    for i, h in enumerate(step):
        ahead, behind = built.at(x + h * unit[i]), built.at(x - h * unit[i])
        if not (ahead.finite and behind.finite):
            continue
        for exact, one, other in (
            (point.gradient[[i]], ahead.f, behind.f),
            (point.jacobian[:, i], ahead.g, behind.g),
            (
                hessian[:, i],
                0.7 * ahead.gradient + ahead.jacobian.T @ multipliers,
                0.7 * behind.gradient + behind.jacobian.T @ multipliers,
            ),
        ):
            difference = np.atleast_1d(one - other) / (2.0 * h)
            rounding = 1e-15 * np.max(np.abs(np.atleast_1d(one)), initial=0.0) / h
            allowed = 2e-5 * np.max(np.abs(exact), initial=0.0) + 20.0 * rounding
            np.testing.assert_allclose(exact, difference, rtol=1e-5, atol=allowed)
    assert np.array_equal(hessian, hessian.T) or np.allclose(hessian, hessian.T, rtol=1e-9)


def test_the_crank_rocker_has_the_formulas_of_the_law_of_cosines() -> None:
    built, random = programme("crank-rocker"), np.random.default_rng(0)
    names = [constraint.name for constraint in built.constraints]
    pairs = [pair for pair in random.uniform(0.15, 0.6, (60, 2)).tolist() if min(slacks(*pair).values()) > 0.01]
    assert len(pairs) > 20
    for pair in pairs:
        longer = {"crank + frame <= coupler + rocker": FRAME, "crank + coupler <= rocker + frame": pair[0]}
        longer["crank + rocker <= coupler + frame"] = pair[1]
        near, far = extreme_cosines(*pair)
        expected = {name: [slack - MARGIN * longer.get(name, 0.0)] for name, slack in slacks(*pair).items()}
        expected |= {"smallest transmission angle": [near], "largest transmission angle": [far]}
        expected["coupler and rocker not in line"] = [near, far]
        assert built.f(pair) == pytest.approx(error(*pair), rel=1e-11, abs=1e-15)
        values = built.g(pair)
        measured = {name: [float(v) for other, v in zip(names, values, strict=True) if other == name] for name in names}
        assert measured.keys() == expected.keys()
        for name, numbers in expected.items():
            assert measured[name] == pytest.approx(numbers, abs=1e-12), name
    root = math.sqrt(0.5)
    by_name = {constraint.name: constraint for constraint in built.constraints}
    assert by_name["smallest transmission angle"].high == pytest.approx(root)
    assert by_name["largest transmission angle"].low == pytest.approx(-root)
    assert {c.unit for c in built.constraints if "<=" in c.name} == {"m"}
    assert {c.unit for c in built.constraints if "angle" in c.name} == {""}
    assert [(v.name, v.key, v.unit, v.low, v.high, v.start) for v in built.variables] == [
        ("coupler", "mechanism.coupler", "m", 0.1, 0.9, 0.4),
        ("rocker", "mechanism.rocker", "m", 0.1, 0.9, 0.4),
    ]


@pytest.mark.parametrize("name", ["crank-rocker", "function-sin", "law-slider-crank", "stroke-slider-crank", "path-ellipse10"])
@pytest.mark.parametrize("form", ["SI", "scaled"])
def test_casadi_expressions_have_the_same_values(name: str, form: str) -> None:
    casadi = pytest.importorskip("casadi")
    built = programme(name) if form == "SI" else programme(name).scaled()
    x = built.x_of(programme(name).design(somewhere(programme(name))))
    parts = built.expressions
    f, g = casadi.Function("both", [parts["x"]], [parts["f"], parts["g"]])(x)
    assert float(f) == pytest.approx(built.f(x), rel=1e-12)
    np.testing.assert_allclose(np.array(g).ravel(), built.g(x), rtol=1e-9, atol=1e-12 * np.max(np.abs(built.g(x))))


@pytest.mark.parametrize("name", ["crank-rocker", "path-arc5", "path-ellipse10", "law-slider-crank", "stroke-slider-crank"])
def test_the_objective_is_that_of_a_validated_design(name: str) -> None:
    built = programme(name)
    x = built.x_of(built.design(somewhere(built)))
    checked = optlink.validate(built.problem, built.design(x))
    assert built.at_peaks(x).objective(built.at_peaks(x).x_start) == pytest.approx(checked.objective, rel=1e-7)
    again = built.scaled()
    assert again.objective(again.x_of(built.design(x))) == pytest.approx(built.objective(x), rel=1e-9)
    assert again.design(again.x_start) == pytest.approx(built.design(built.x_start))
    assert again.f(again.x_start) == pytest.approx(1.0)
    assert (again.f_unit, {v.unit for v in again.variables}) == ("", {""})


def test_a_root_mean_square_is_minimised_by_its_square() -> None:
    built = optlink.build(definite("path-ellipse10").override({"requirement.measure": "rms"}))
    x = somewhere(built)
    assert built.f_unit == "m^2"
    assert built.f(x) == pytest.approx(built.objective(x) ** 2, rel=1e-10)
    assert built.objective(x) == pytest.approx(math.sqrt(programme("path-ellipse10").objective(x) / 10), rel=1e-10)


def test_a_maximised_quantity_is_minimised_by_its_negative() -> None:
    objective = {"quantity": "time ratio", "of": "ram", "sense": "maximise"}
    built = optlink.build(optlink.load("shaper-design").override({"objective": objective}))
    cycle = optlink.analyze(optlink.load("shaper-design"))
    assert built.f(built.x_start) == pytest.approx(-cycle.strokes["ram"].time_ratio, rel=1e-9)


@pytest.mark.parametrize("form", ["SI", "scaled"])
def test_undefined_points_are_nan(form: str) -> None:
    built = programme("crank-rocker") if form == "SI" else programme("crank-rocker").scaled()
    x = built.x_of({"coupler": 0.2, "rocker": 0.15})  # too short to close
    point = built.at(x)
    assert math.isnan(point.f)
    assert np.all(np.isnan(point.gradient))
    assert np.all(np.isfinite(point.g))
    assert np.min(point.g - built.g_low) < 0.0
    assert not point.finite


def test_values_may_be_changed_by_the_caller() -> None:
    built = programme("crank-rocker")
    x = np.array([0.42, 0.25])
    before = built.g(x)
    for array in (built.g(x), built.gradient(x), built.jacobian(x)):
        array[...] = 0.0
    assert np.array_equal(built.g(x), before)
    assert np.any(built.gradient(x))
    assert np.any(built.jacobian(x))


REFUSED = {
    "balance-six-bar": ("balance", "cone programme", "optlink.balance"),
    "six-bar": ("[requirement]", "nothing to solve", "Add one"),
    "path-bean": ("mechanism.assembly", "2 assembly modes are left open (left; right)", "problem.variants()[0]"),
    "path-slider-egg": ("requirement.rotation", "either direction", '"requirement.rotation": "clockwise"'),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_single_programme_is_refused(name: str) -> None:
    with pytest.raises(InputError) as error:
        optlink.build(optlink.load(name))
    assert len(error.value.faults) == 1
    for part in REFUSED[name]:
        assert part in str(error.value)


def test_the_remedy_for_an_open_rotation_fits_several_requirements() -> None:
    single = optlink.load("path-closed18-untimed").override({"mechanism.assembly": "left"})
    tables = {key: value for key, value in single.raw.items() if key != "requirement"}
    stroke = {"kind": "stroke", "output": "rocker", "stroke": "40 deg"}
    problem = single.with_tables({**tables, "requirements": [stroke, single.raw["requirement"]]})
    with pytest.raises(InputError, match=r"requirements\.1\.rotation: .* either direction") as error:
        optlink.build(problem)
    [stated] = re.findall(r"override\((.*)\)", str(error.value))
    assert optlink.build(problem.override(json.loads(stated))).variables


@pytest.mark.parametrize("name", ["path-closed18-untimed", "path-arc5", "crank-rocker"])
def test_a_result_has_the_programme_of_its_design(name: str) -> None:
    """Its assembly mode and rotation are chosen, and its design is the start."""
    result = optlink.solve(name, starts=4)
    programme = optlink.build(result)
    assert programme.objective(programme.x_start) == pytest.approx(result.objective, rel=1e-9)
    assert optlink.validate(programme.problem, programme.design(programme.x_start)).valid
    with pytest.raises(InputError, match=r"problem.*: this result has no design variables"):
        optlink.build(optlink.analyze("shaper"))  # type: ignore[arg-type]


def test_a_machine_that_never_turns_is_refused() -> None:
    bounds = {"mechanism.links.rod.length": {"bounds": ["20 mm", "30 mm"]}}
    problem = optlink.load("stroke-slider-crank").override(bounds)
    with pytest.raises(InputError, match="crank turns fully"):
        optlink.build(problem)


ARGUMENTS: dict[str, tuple[Any, str]] = {
    "f": (([0.4],), r"x: its shape is \(1,\), the programme has 2 variables"),
    "g": (([0.4, math.nan],), "x = .*: not a finite number or array"),
    "hessian": (([0.4, 0.4], [1.0]), r"multipliers: its shape is \(1,\), the programme has 10 constraints"),
    "design": ((0.4,), r"x: its shape is \(\)"),
    "x_of": (({"coupler": 0.4},), "the design lacks rocker"),
    "at_peaks": (("coupler",), "x = .*: not a finite number or array"),
}


@pytest.mark.parametrize("method", ARGUMENTS)
def test_arguments_are_checked(method: str) -> None:
    arguments, message = ARGUMENTS[method]
    with pytest.raises(InputError, match=message):
        getattr(programme("crank-rocker"), method)(*arguments)


def test_unknown_names_of_a_design_are_refused() -> None:
    with pytest.raises(InputError, match=re.escape("couple")):
        programme("crank-rocker").x_of({"couple": 0.4, "rocker": 0.3})


def ipopt(built: Programme) -> Array:
    casadi = pytest.importorskip("casadi")
    quiet = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "show_eval_warnings": False}
    solver = casadi.nlpsol("solver", "ipopt", built.expressions, {**quiet, "ipopt.tol": 1e-10, "ipopt.bound_relax_factor": 0.0})
    end = solver(x0=built.x_start, lbx=built.x_low, ubx=built.x_high, lbg=built.g_low, ubg=built.g_high)
    assert solver.stats()["success"]
    return np.array(end["x"]).ravel()


@pytest.mark.parametrize(
    ("name", "optimum"),
    [
        ("stroke-slider-crank", 0.74698225),
        ("law-slider-crank", 2.10737e-6),
        pytest.param("function-sin", 3.320926e-3, marks=pytest.mark.slow),
        pytest.param("shaper-design", 1.0020357, marks=pytest.mark.slow),
    ],
)
def test_peaks_between_the_positions_are_found(name: str, optimum: float) -> None:
    """Values of `optlink.solve`; without moving positions function-sin ends at 3.318e-3 and shaper-design at 1.00088."""
    built = programme(name).scaled()
    for _ in range(5):
        x = ipopt(built)
        built = built.at_peaks(x)
    checked = optlink.validate(built.problem, built.design(x))
    assert checked.objective == pytest.approx(optimum, rel=2e-6 if name != "law-slider-crank" else 2e-5)
    assert built.objective(built.x_start) == pytest.approx(checked.objective, rel=1e-6)
