"""Arguments of other types than those that the public functions name are invalid input, not errors inside."""

from __future__ import annotations

import inspect
from pathlib import Path

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.problem.arguments import typed
from optlink.studies.pareto.epsilon_constraint import pareto
from optlink.studies.sensitivity import sensitivities
from optlink.studies.sweep import sweep
from optlink.studies.tolerance.analysis import tolerance

LAW, MACHINE, CLEARANCE = (optlink.load(name) for name in ("crank-rocker", "six-bar", "slider-crank-clearance"))
SPEEDS = ["drive.speed=100..200 rpm:2"]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: optlink.solve(LAW, starts="3"), 'starts = "3": not a whole number'),
        (lambda: optlink.solve(LAW, seed=1.5), "seed = 1.5: not a whole number"),
        (lambda: optlink.solve(LAW, "both", True), "starts = true: not a whole number"),
        (lambda: optlink.solve(LAW, backend=3), "backend = 3: not a text"),
        (lambda: optlink.solve(LAW, workers=-1), "--workers = -1: out of range"),
        (lambda: optlink.solve(LAW, gap=float("nan")), "gap = nan: out of range"),
        (lambda: optlink.solve(LAW, certify=1), "certify = 1: neither True nor False"),
        (lambda: optlink.solve(LAW, certify=True, folder=3), "folder = 3: not a file or folder"),
        (lambda: optlink.validate(LAW, {"coupler": "0.4", "rocker": 0.2}), 'design.coupler = "0.4": not a number'),
        (lambda: optlink.validate(LAW, {3: 0.4}), "design.3 = 3: not a text"),
        (lambda: optlink.analyze(MACHINE, speed="64 rpm"), 'speed = "64 rpm": not a number'),
        (lambda: optlink.analyze_batch(MACHINE, {"crank.length": "x"}), "not an array of numbers"),
        (lambda: optlink.analyze_batch(MACHINE, {}, "input.torque_Nm"), "columns = .*not a list"),
        (lambda: optlink.simulate(MACHINE, "2 s"), 'duration = "2 s": not a number'),
        (lambda: optlink.simulate_clearance(CLEARANCE, revolutions="2"), 'revolutions = "2": not a whole number'),
        (lambda: optlink.simulate_clearance(CLEARANCE, progress=3), "progress = 3: not a function"),
        (lambda: optlink.compare(CLEARANCE, kinds="none"), "kinds = .*not a list"),
        (lambda: optlink.tune(CLEARANCE, starts=1.5), "starts = 1.5: not a whole number"),
        (lambda: optlink.balance(MACHINE, minimise=3), "minimise = 3: not a text"),
        (lambda: sensitivities("crank-rocker"), 'problem = "crank-rocker": not a problem'),
        (lambda: sweep(LAW, "mechanism.frame=480..520 mm:3"), "vary = .*not a list"),
        (lambda: sweep(MACHINE, SPEEDS, 3, analyze=True), "out = 3: not a file or folder"),
        (lambda: tolerance(LAW, [3]), "tolerances.0 = 3: not a text"),
        (lambda: tolerance(LAW, ["coupler=0.1 mm"], robust=[3]), "robust = .*not a number"),
        (lambda: pareto(LAW, ["error"]), "objectives = .*not a text"),
        (lambda: sweep(CLEARANCE, SPEEDS, simulate={"revolutions": "3"}), 'revolutions = "3": not a whole number'),
        (lambda: optlink.load(3), "problem = 3: not a text"),
        (lambda: optlink.load("crank-rocker", {3: 3}), "overrides.3 = 3: not a text"),
        (lambda: optlink.load("crank-rocker", 3), "overrides = 3: not a mapping"),
        (lambda: optlink.grashof("1", 2, 3, 4), 'crank = "1": not a number'),
        (lambda: LAW.override("x"), "changes = .*not a mapping"),
        (lambda: optlink.read(3), "raw = 3: not a mapping"),
        (lambda: optlink.read_design(LAW, "coupler=3"), "assignments = .*not a list"),
        (lambda: optlink.explore(LAW, 3), "design = 3: not a mapping"),
    ],
)
def test_an_argument_of_another_type_is_refused_in_one_sentence(call, message) -> None:
    with pytest.raises(InputError, match=message) as caught:
        call()
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    "function",
    [
        *(optlink.solve, optlink.analyze, optlink.simulate, optlink.simulate_clearance, optlink.compare, optlink.tune),
        *(optlink.balance, sensitivities, sweep, tolerance, pareto, optlink.explore),
    ],
)
def test_every_argument_of_a_public_function_is_checked(function) -> None:
    class Other:
        pass

    names = [name for name, parameter in inspect.signature(function).parameters.items() if parameter.annotation != "object"]
    with pytest.raises(InputError) as caught:
        function(**dict.fromkeys(names, Other()))
    assert [fault.key for fault in caught.value.faults] == names


def test_all_wrong_arguments_are_reported_together() -> None:
    with pytest.raises(InputError) as caught:
        optlink.solve(LAW, 3, "x", None)
    assert [fault.key for fault in caught.value.faults] == ["backend", "starts", "seed"]


def test_numbers_of_numpy_and_whole_floats_are_numbers() -> None:
    @typed
    def used(count: int, value: float, flag: bool, place: Path | None = None, more: float | str = "x"):
        return count, value, flag, place, more

    computed = used(np.int64(3), np.float32(0.5), np.bool_(True), "out", more=np.float64(2))
    assert computed == (3, 0.5, True, Path("out"), 2.0)
    assert [type(value) for value in computed] == [int, float, bool, type(Path()), float]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: optlink.simulate(MACHINE, time=3), r"time = 3: unknown argument of simulate\. Known: problem, duration, rows,"),
        (lambda: optlink.solve(LAW, start=3), r'start = 3: unknown argument of solve\. Did you mean "starts"\?'),
        (lambda: optlink.load("crank-rocker", override={}), 'unknown argument of load. Did you mean "overrides"?'),
        (lambda: LAW.override(crank="1 m"), r'crank = "1 m": unknown argument of override\. Known: changes'),
        (lambda: optlink.analyze(), "problem: analyze needs this argument"),
        (lambda: optlink.analyze(MACHINE, problem=MACHINE), "problem: given twice to analyze"),
        (lambda: LAW.override({}, {}), "override takes at most 1 arguments without a name"),
        (lambda: optlink.balance(MACHINE, minimize="force"), 'Did you mean "minimise"?'),
        (lambda: sweep(MACHINE, SPEEDS, point=3), 'point = 3: unknown argument of sweep. Did you mean "points"?'),
        (lambda: sweep(CLEARANCE, SPEEDS, simulate={"turns": 3}), "turns = 3: unknown"),
    ],
)
def test_unknown_and_missing_arguments_are_refused_in_one_sentence(call, message) -> None:
    with pytest.raises(InputError, match=message) as caught:
        call()
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("optimize", "optlink.solve"),
        ("sensitivity", "sensitivities"),
        ("pareto", "import pareto"),
        ("report", "import write_page"),
    ],
)
def test_names_defined_elsewhere_in_the_package_are_suggested(name: str, meant: str) -> None:
    with pytest.raises(AttributeError, match=rf"no attribute '{name}'\. .*{meant}"):
        optlink.__getattr__(name)
