"""Arguments of other types than those that the public functions name are invalid input, not errors inside."""

from __future__ import annotations

import copy
import inspect
import math
import pickle
import types
from pathlib import Path
from typing import Unpack

import numpy as np
import pytest

import optlink
from optlink import control, linkage
from optlink.errors import InputError, arguments_for_options
from optlink.execution.options import Execution
from optlink.linkage.fourbar import classify
from optlink.linkage.motion import sweep as sweep_unchecked
from optlink.problem.arguments import typed
from optlink.studies import pareto, sensitivities, sweep, tolerance

LAW, MACHINE, CLEARANCE = (optlink.load(name) for name in ("crank-rocker", "six-bar", "slider-crank-clearance"))
SPEEDS = ["drive.speed=100..200 rpm:2"]
SIZES = {"crank": 0.2, "coupler": 0.7, "rocker": 0.6, "frame": 0.8}
DESIGN = {"coupler": 0.4, "rocker": 0.23}
SWEPT = {"mechanism": linkage.four_bar(), "sizes": SIZES}
COUPLER = linkage.CouplerLinkage(**SIZES, along=0.3, across=0.1)
ACCEPTED = {
    optlink.solve: {"problem": LAW, "certify": False},
    optlink.validate: {"problem": LAW, "design": DESIGN},
    optlink.build: {"problem": LAW},
    optlink.gradient: {"problem": LAW, "design": {"coupler": 0.4, "rocker": 0.26}},
    optlink.hessian: {"problem": LAW, "design": {"coupler": 0.4, "rocker": 0.26}},
    optlink.analyze: {"problem": MACHINE},
    optlink.analyze_batch: {"problem": MACHINE, "designs": {"crank.length": [0.1]}},
    optlink.simulate: {"problem": MACHINE, "duration": 0.01},
    control.simulate_clearance: {"problem": CLEARANCE},
    control.inverse_model: {"problem": CLEARANCE},
    control.compare: {"problem": CLEARANCE},
    control.tune: {"problem": CLEARANCE},
    optlink.balance: {"problem": optlink.load("balance-six-bar")},
    optlink.load: {"problem": "crank-rocker"},
    optlink.new: {"name": "law"},
    optlink.read: {"raw": dict(LAW.raw)},
    optlink.read_result: {"path": "nothing.json"},
    optlink.read_design: {"problem": LAW, "assignments": ["coupler=400 mm", "rocker=230 mm"]},
    optlink.explore: {"problem": LAW},
    optlink.shipped: {},
    optlink.linkage.four_bar: {},
    optlink.linkage.grashof: SIZES,
    optlink.linkage.cognates: {"linkage": COUPLER},
    optlink.linkage.reachable: SWEPT,
    optlink.linkage.travels: {**SWEPT, "low": 0.0, "high": 6.0, "full": False},
    optlink.linkage.sweep: {**SWEPT, "crank_angle": [0.1, 0.2]},
    sensitivities: {"problem": LAW},
    sweep: {"problem": LAW, "vary": ["mechanism.frame=480..520 mm:2"]},
    tolerance: {"problem": LAW, "tolerances": ["coupler=0.1 mm"], "design": DESIGN},
    pareto: {"problem": LAW, "objectives": "error, limits.transmission_angle.max"},
    optlink.studies.output_sensitivity: {
        "mechanism": linkage.four_bar(),
        "sizes": SIZES,
        "crank_angles": [0.1],
        "output": "rocker",
    },
    optlink.synthesis.starts: {"problem": optlink.load("path-arc5")},
    optlink.synthesis.exact: {"problem": optlink.load("motion-5-poses")},
    optlink.synthesis.dyad_curves: {"problem": optlink.load("motion-4-poses")},
    optlink.synthesis.four_bar_of_dyads: {"problem": optlink.load("motion-4-poses"), "driver": 40, "follower": 240},
    optlink.motion: {"problem": MACHINE, "crank_angle": [0.1, 0.2]},
    optlink.objective: {"unit": "N m", "measure": "rms"},
    optlink.limit: {"unit": "deg", "max": 45.0},
    optlink.report: {"source": MACHINE, "file": "page.html"},
    optlink.export: {"source": MACHINE, "file": "drawing.svg"},
    optlink.rename: {"problem": MACHINE, "old": "B", "new": "pin"},
}
"""Every public function with arguments that it accepts."""
WRONG = {
    "float": [math.nan, -math.inf, math.inf],
    "int": [-1, -(10**12)],
    "str": ["no such thing"],
    "Mapping": [{"no such name": 1.0}],
    "Mechanism": [None, "four-bar", COUPLER],
    "CouplerLinkage": [None, SIZES],
    "bool": [2, "yes"],
    "Value": [math.nan, [1.0, 2.0, 3.0]],
    "ArrayLike": [math.nan, [1.0, math.inf], "x"],
}
"""Values that no argument of an annotation takes."""
ANY = {"problem", "source", "resume", "file", "folder", "out", "time_limit", "name", "varied"}
"""Arguments that take any text, or an infinite number, and those of other types."""


def wrong_values() -> list:
    cases = []
    for function, accepted in ACCEPTED.items():
        for name, parameter in inspect.signature(function).parameters.items():
            text = str(parameter.annotation)
            values = [value for kind, listed in WRONG.items() if kind in text for value in listed]
            if name in ANY or "Callable" in text or "Progress" in text:
                continue
            for value in values if name != "side" else [0, 7, -2]:
                label = f"{function.__name__}-{name}-{value}"
                cases.append(pytest.param(function, {**accepted, name: value}, name, id=label))
    return cases


def test_the_walk_below_has_every_public_function() -> None:
    spaces = (optlink, optlink.control, optlink.linkage, optlink.studies, optlink.synthesis)
    public = {getattr(space, name) for space in spaces for name in space.__all__}
    assert {item for item in public if isinstance(item, types.FunctionType)} <= set(ACCEPTED)


@pytest.mark.parametrize(("function", "arguments", "name"), wrong_values())
def test_a_wrong_value_of_any_argument_is_refused_in_a_sentence_about_it(function, arguments, name) -> None:
    """Not by a bare error from inside, and never in the words of the command line."""
    with pytest.raises(InputError) as caught:
        function(**arguments)
    said = str(caught.value)
    assert len(said.splitlines()) == len(caught.value.faults)
    assert name in said or "no such name" in said
    assert "--" not in said


def test_options_of_commands_become_arguments() -> None:
    for text, said in {
        "--gap": "gap",
        "Leave --time-limit out": "Leave time_limit out",
        "Give --starts 20 or more": "Give starts=20 or more",
        '--limit "0.5 deg"': 'limit="0.5 deg"',
        '--vary mechanism.frame="450..550 mm:3"': 'vary={"mechanism.frame": "450..550 mm:3"}',
        "Run `optlink new --list`, or add --analyze": "Run `optlink new --list`, or add analyze",
        "a well-known - and quoted -- word": "a well-known - and quoted -- word",
    }.items():
        assert arguments_for_options(text) == said


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: linkage.four_bar(7), "side = 7: not an assembly mode"),
        (lambda: linkage.four_bar(0.5), "side = 0.5: not an assembly mode"),
        (lambda: linkage.four_bar(0), "side = 0: not an assembly mode"),
        (lambda: linkage.four_bar(placed="yes"), 'placed = "yes": neither True nor False'),
        (lambda: linkage.sweep(linkage.four_bar(), {**SIZES, "crank": "200 mm"}, [0.0]), 'sizes.crank = "200 mm": not a finite'),
        (lambda: linkage.sweep(linkage.four_bar(), SIZES, None), "crank_angle: not a finite number or array"),
        (lambda: linkage.four_bar(points="P"), 'points = "P": not a list of names'),
        (lambda: linkage.four_bar(points=["P", "C"]), 'points = "C": a name of the four-bar itself'),
        (lambda: linkage.four_bar(points=["P", "Q", "P"]), 'points = "P": a name that is given twice'),
        (lambda: optlink.linkage.grashof(-1, 3, 3, 3), "crank = -1: a length must be positive"),
        (lambda: optlink.linkage.grashof(2, 3, 0, 3), "rocker = 0: a length must be positive"),
        (lambda: optlink.linkage.grashof(0, 0, 0, 0), "crank = 0: a length must be positive"),
        (lambda: optlink.linkage.grashof(2, 3, 4, math.inf), "frame = inf: not a finite number"),
        (lambda: linkage.sweep(linkage.four_bar(), {**SIZES, "rocker": -0.6}, [0.0]), "sizes.rocker = -0.6: a length must be"),
        (lambda: linkage.sweep(linkage.four_bar(), {**SIZES, "rokcer": 0.6}, [0.0]), 'sizes.rokcer: .* Did you mean "rocker"'),
        (lambda: linkage.sweep(linkage.four_bar(points=["P"]), SIZES, [0.0]), r"sizes: missing: P\.along, P\.across"),
        (
            lambda: linkage.sweep(linkage.four_bar(), SIZES, [0.0, 1.0], [1.0, 2.0, 3.0]),
            r"speed: its shape \(3,\) does not match",
        ),
        (lambda: linkage.sweep(linkage.four_bar(), SIZES, ["a"]), "crank_angle = .*: not a finite number or array"),
        (
            lambda: linkage.reachable(linkage.four_bar(), {**SIZES, "crank": [0.1, 0.2]}),
            r"sizes.crank = .*: not a number\. Give one",
        ),
        (
            lambda: linkage.reachable(linkage.four_bar(), {"crank": 0.1}),
            "^sizes: missing: coupler, rocker, frame. Give SI values",
        ),
        (
            lambda: linkage.travels(**SWEPT, low=1.0, high=1.0, full=False),
            "^high = 1.0: the range of the crank angle is empty. Give",
        ),
        (lambda: linkage.cognates(SIZES), "^linkage = .*: not a four-bar with a coupler point. Give one, for example optlink"),
        (lambda: linkage.cognates(COUPLER, math.nan), "^at = nan: not a finite number. Give one in SI units"),
        (lambda: optlink.solve(LAW, gap=0), "^gap = 0"),
        (lambda: optlink.solve(LAW, time_limit=-5.0), "^time_limit = .*out of range"),
        (lambda: optlink.validate(LAW, {"coupler": 0.4}), 'Add for example design=."rocker": 0.4'),
    ],
)
def test_kinematics_refuse_what_no_linkage_is(call, message) -> None:
    with pytest.raises(InputError, match=message):
        call()


def test_results_cannot_be_changed_and_problems_can_be_keys() -> None:
    result, analysis = optlink.validate(LAW, DESIGN), optlink.analyze(MACHINE, points=12)
    before = result.to_dict()
    for change in (
        lambda: result.design.update(crank=9.9),
        lambda: result.design.__setitem__("crank", 9.9),
        lambda: result.design.pop("crank"),
        lambda: analysis.columns["input.torque_Nm"].__setitem__(0, 1.0),
        lambda: setattr(result, "objective", 0.0),
    ):
        with pytest.raises((TypeError, ValueError, AttributeError)):
            change()
    assert result.to_dict() == before
    design = result.design
    design |= {"crank": 9.9}
    assert (design["crank"], result.design["crank"]) == (9.9, 0.1)
    for copied in (copy.deepcopy(result), pickle.loads(pickle.dumps(result))):
        assert copied.design == result.design
        assert type(copied.design) is type(result.design)
    with pytest.raises(KeyError, match=r'crnk: unknown name\. Did you mean "crank"'):
        _ = result.design["crnk"]
    with pytest.raises(InputError, match=r'torque: unknown name\. Did you mean "input\.torque_Nm"'):
        _ = analysis.columns["torque"]
    assert len({LAW, optlink.load("crank-rocker"), LAW.override({"mechanism.frame": "480 mm"}), MACHINE}) == 3


def test_a_template_is_read_as_it_is() -> None:
    for name in ("wiper", "law"):
        assert optlink.read(optlink.new(name), name).model.mechanism.quantities
    with pytest.raises(InputError, match=r'not the text of a problem file\. Load a file: optlink\.load\("crank-rocker"\)'):
        optlink.read("crank-rocker")
    with pytest.raises(InputError, match="mine: not valid TOML"):
        optlink.read("[mechanism\ncrank = 3", "mine", "mine")


def test_inner_kinematics_take_any_values() -> None:
    """The checks stand at the boundary only: the formulas inside stay fast and take what a search gives them."""
    motion = sweep_unchecked(linkage.four_bar(), {**SIZES, "coupler": -0.7, "other": 1.0}, [0.0, math.nan])
    assert motion.position("C").shape == (2, 2)
    assert classify(math.nan, 2, 3, 4).inversion.value == "cannot be assembled"


def test_a_batch_of_designs_moves_as_each_of_them() -> None:
    cranks, angles = np.array([0.1, 0.15, 0.2]), np.linspace(0.0, 6.0, 7)
    together = linkage.sweep(linkage.four_bar(-1), {**SIZES, "crank": cranks[:, None]}, angles, speed=2)
    for crank, row in zip(cranks, together.velocity("C"), strict=True):
        assert np.array_equal(row, linkage.sweep(linkage.four_bar(-1), {**SIZES, "crank": crank}, angles, speed=2).velocity("C"))


class Table:
    """Numbers of another package, which cannot be compared to one number."""

    def __array__(self, *_, **__):
        return np.array([0.48, 0.5])

    __hash__ = None

    def __eq__(self, other):
        raise ValueError("the truth value is ambiguous")


def named(machine):
    return 1.0


@pytest.mark.parametrize("method", ["position", "velocity", "acceleration", "margin", "body_angle", "body_rate", "slide"])
def test_an_unknown_part_of_a_motion_is_named(method) -> None:
    motion = linkage.sweep(linkage.four_bar(), SIZES, [0.1])
    for error in (InputError, KeyError, ValueError):
        with pytest.raises(error, match=r'= "Z": the mechanism has no such .*\. Known: '):
            getattr(motion, method)("Z")
    with pytest.raises(InputError, match='point = "Q": the mechanism has no such point'):
        motion.distance("A", "Q")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: optlink.solve(LAW, starts="3"), 'starts = "3": not a whole number'),
        (lambda: optlink.solve(LAW, seed=1.5), "seed = 1.5: not a whole number"),
        (lambda: optlink.solve(LAW, "both", True), "starts = true: not a whole number"),
        (lambda: optlink.solve(LAW, backend=3), "backend = 3: not a text"),
        (lambda: optlink.solve(LAW, workers=-1), "^workers = -1: out of range"),
        (lambda: optlink.solve(LAW, gap=float("nan")), "gap = nan: out of range"),
        (lambda: optlink.solve(LAW, certify=1), "certify = 1: neither True nor False"),
        (lambda: optlink.validate(LAW, {"coupler": "0.4", "rocker": 0.2}), 'design.coupler = "0.4": a length needs a unit'),
        (lambda: optlink.validate(LAW, {3: 0.4}), "design.3 = 3: not a text"),
        (
            lambda: optlink.analyze(LAW, design={"coupler": -0.4, "rocker": 0.2}),
            "design.coupler = -0.4: a length must be positive",
        ),
        (
            lambda: optlink.load("crank-rocker", {"mechanism.frame": Table()}),
            r"mechanism.frame = \[0.48, 0.5\]: this is not a length",
        ),
        (lambda: optlink.load("crank-rocker", {"mechanism.frame": "0.48"}), 'Write "0.48 mm" or "0.48 m"'),
        (lambda: optlink.objective(measure="max"), 'measure = "max": no such value. Known: .*rms'),
        (lambda: optlink.objective(abs), "objective takes no argument without a name"),
        (lambda: optlink.load("crank-rocker", optlink.objective()(named)), "overrides = .*not a mapping.* Give its changes"),
        (lambda: optlink.analyze(MACHINE, speed="64 rpm"), 'speed = "64 rpm": not a number'),
        (lambda: optlink.analyze_batch(MACHINE, {"crank.length": "x"}), "this is not a length"),
        (lambda: optlink.analyze_batch(MACHINE, {}, "input.torque_Nm"), "columns = .*not a list"),
        (lambda: optlink.simulate(MACHINE, "2 s"), 'duration = "2 s": not a number'),
        (lambda: control.simulate_clearance(CLEARANCE, revolutions="2"), 'revolutions = "2": not a whole number'),
        (lambda: control.simulate_clearance(CLEARANCE, progress=3), "progress = 3: not a function"),
        (lambda: control.compare(CLEARANCE, kinds="none"), "kinds = .*not a list"),
        (lambda: control.tune(CLEARANCE, starts=1.5), "starts = 1.5: not a whole number"),
        (lambda: optlink.balance(MACHINE, minimise=3), "minimise = 3: not a text"),
        (lambda: sweep(LAW, "mechanism.frame=480..520 mm:3"), "vary = .*not a mapping"),
        (lambda: sweep(MACHINE, SPEEDS, 3, analyze=True), "out = 3: not a file or folder"),
        (lambda: sweep(LAW, 3), "vary = 3: not a mapping"),
        (lambda: sweep(LAW, {"mechanism.frame": "x"}), "vary.mechanism.frame = .*not a list of numbers"),
        (lambda: sweep(LAW, {"mechanism.frame": [0.4, math.nan]}), "vary.mechanism.frame = .*not a list of finite numbers"),
        (lambda: tolerance(LAW, [3]), "tolerances.0 = 3: not a text"),
        (lambda: tolerance(LAW, ["coupler=0.1 mm"], robust=[3]), "robust = .*not a number"),
        (lambda: pareto(LAW, ["error"]), "objectives = .*not a mapping"),
        (lambda: sweep(CLEARANCE, SPEEDS, simulate={"revolutions": "3"}), 'revolutions = "3": not a whole number'),
        (lambda: optlink.load(3), "problem = 3: not a text"),
        (lambda: optlink.load("crank-rocker", {3: 3}), "overrides.3 = 3: not a text"),
        (lambda: optlink.load("crank-rocker", 3), "overrides = 3: not a mapping"),
        (lambda: optlink.linkage.grashof("1", 2, 3, 4), 'crank = "1": not a number'),
        (lambda: LAW.override("x"), "changes = .*not a mapping"),
        (lambda: optlink.read(3), "raw = 3: not a mapping"),
        (lambda: optlink.read_design(LAW, "coupler=3"), "assignments = .*not a list"),
        (lambda: optlink.explore(3), "problem = 3: .*"),
    ],
)
def test_an_argument_of_another_type_is_refused_in_one_sentence(call, message) -> None:
    with pytest.raises(InputError, match=message) as caught:
        call()
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    "function",
    [
        *(optlink.solve, optlink.analyze, optlink.simulate, control.simulate_clearance, control.compare, control.tune),
        *(control.inverse_model, optlink.balance, sensitivities, sweep, tolerance, pareto, optlink.explore),
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


def test_options_of_a_dictionary_are_arguments_that_keep_their_defaults_if_they_are_not_given() -> None:
    @typed
    def where(count: int, **execution: Unpack[Execution]) -> Execution:
        return execution

    assert where(1) == {}
    assert where(1, workers=np.int64(2), scheduler=None) == {"workers": 2, "scheduler": None}
    defaults = {name: one.default for name, one in inspect.signature(where).parameters.items() if name != "count"}
    assert defaults == {"engine": "local", "workers": None, "scheduler": None}
    with pytest.raises(InputError, match=r'workers = "two": not a whole number'):
        where(1, workers="two")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r'worker = 2: unknown argument of where\. Did you mean "workers"'):
        where(1, worker=2)  # type: ignore[call-arg]


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
        (lambda: linkage.four_bar(crank=0.1), r"crank = 0\.1: unknown argument of four_bar\. Give sizes to sweep\(mechanism, \{"),
        (lambda: linkage.four_bar(sides=1), r'sides = 1: unknown argument of four_bar\. Did you mean "side"'),
        (
            lambda: linkage.four_bar(0.2, 0.7, 0.6, 0.8),
            r"four_bar takes at most 2 arguments without a name\. Give sizes to sweep\(",
        ),
        (lambda: linkage.sweep(linkage.four_bar(), SIZES), "crank_angle: sweep needs this argument. Known: mechanism, sizes"),
        (lambda: linkage.sweep(linkage.four_bar(), SIZES, [0.1], spead=3), 'unknown argument of sweep. Did you mean "speed"'),
        (lambda: linkage.grashof(0.2, 0.7, 0.6), "frame: grashof needs this argument"),
    ],
)
def test_unknown_and_missing_arguments_are_refused_in_one_sentence(call, message) -> None:
    with pytest.raises(InputError, match=message) as caught:
        call()
    assert len(str(caught.value).splitlines()) == 1


def test_the_motion_is_that_at_one_angle_too() -> None:
    one, same = (optlink.motion(MACHINE, angle).position("B") for angle in (0.5, [0.5]))
    np.testing.assert_array_equal(one, same)
    with pytest.raises(InputError, match="crank_angle = true: not an array of numbers"):
        optlink.motion(MACHINE, True)


def test_a_missing_name_has_what_python_needs_to_suggest_a_similar_one() -> None:
    with pytest.raises(AttributeError) as missing:
        optlink.__getattr__("slove")
    assert (missing.value.name, missing.value.obj) == ("slove", optlink)
