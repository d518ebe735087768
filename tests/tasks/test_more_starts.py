"""Starting points of laws and functions: prefixes of one sequence, one answer for all seeds, evidence, one headline figure."""

from __future__ import annotations

import functools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import optlink
from optlink.optimization.programme import build
from optlink.solvers import contract, multistart
from optlink.synthesis import freudenstein
from optlink.synthesis.batch_search import Searcher
from optlink.tasks.design import solve
from optlink.tasks.search import DesignCollection, Polisher
from optlink.validation import Check
from tests.solved import once
from tests.tasks.test_function_problems import case, default_answer, measured

SHORT = 11  # of the function problems


def short(**changes: object) -> optlink.ProblemFile:
    """A function that takes little time: one assembly mode."""
    return optlink.read(case(SHORT).raw).override(changes)


@functools.cache
def short_of_both_modes() -> optlink.SynthesisResult:
    """The same in both assembly modes, searched from the first starts alone; computed once for all tests of a run."""
    file = short(**{"mechanism.assembly": "either"})
    computed: optlink.SynthesisResult = once("short function of both modes", lambda: optlink.solve(file, starts=1))
    return computed


@pytest.mark.parametrize("file", [optlink.load("crank-rocker"), short()], ids=["law", "function"])
def test_starts_of_a_smaller_number_are_the_first_ones_of_a_larger_one(file: optlink.ProblemFile) -> None:
    few, many = (Searcher([file.spec], 5) for _ in "ab")
    for number in range(2):
        x, _ = few._sample(0, 60, number)
        np.testing.assert_array_equal(x, many._sample(0, 60, number)[0])
        assert len({tuple(row) for row in x}) > 40  # others are alike where bounds cut them off
    assert not np.array_equal(x, Searcher([file.spec], 6)._sample(0, 60, 1)[0])


@pytest.mark.slow
@pytest.mark.parametrize(("starts", "engine"), [(None, "local"), (40, "dask")])
def test_processes_change_no_digit_of_a_search(starts: int | None, engine: str) -> None:
    file = optlink.load("function-sin")
    one, other = (optlink.solve(file, "ipopt", starts, certify=False, **how) for how in ({}, {"workers": 2, "engine": engine}))
    assert (other.starts, other.evidence, other.optima, other.design) == (one.starts, one.evidence, one.optima, one.design)
    assert other.solution.conditions.multipliers.tobytes() == one.solution.conditions.multipliers.tobytes()
    assert len(one.optima) > 1


@pytest.mark.slow
def test_convex_first_steps_and_the_file_start_are_always_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    file = short(**{"mechanism.crank": {"start": "77 mm", "bounds": ["1 mm", "5000 mm"]}})
    begun: list[float] = []
    local = Polisher.from_values

    def noted(self: Polisher, variant: int, values: dict[str, float], *more: object, **options: bool) -> object:
        begun.append(values["crank"])
        return local(self, variant, values, *more, **options)

    monkeypatch.setattr(Polisher, "from_values", noted)
    result = optlink.solve(file, starts=1)
    assert result.starts == len(begun) > 1
    assert begun[-1] == pytest.approx(0.077)
    assert result.first_step is not None
    assert begun[0] == pytest.approx(0.1 * result.first_step.crank)


def test_a_valid_design_is_not_lost_to_an_invalid_better_one() -> None:
    """A start that leads to a lower objective beyond a limit of the validator comes last: the valid one before it stays."""
    file = short()
    collection = DesignCollection(Polisher([file], "ipopt"), 1)
    good = collection.polisher.from_values(0, freudenstein.values(file.spec, freudenstein.steps(file.spec)[0]), None)
    collection.take(good)
    assert collection.designs == [good]
    check = Check("the cover is not reached", False, 3.25, "<= 2", "mm")
    better = replace(good, objective=0.5 * good.objective, validation=replace(good.validation, checks=(check,)))
    assert not better.valid
    collection.take(better)
    assert collection.designs == [good]
    assert collection.rejected is not None
    assert collection.rejected.failed == (check,)


@pytest.mark.slow
def test_seeds_agree_on_an_optimum_that_few_starts_reach() -> None:
    """One random start in ten reaches the best value; another one is 2 % above it."""
    results = [default_answer(2), optlink.solve(optlink.read(case(2).raw), seed=3)]
    assert results[0].objective == pytest.approx(results[1].objective, rel=1e-8)
    evidence = results[0].evidence
    assert evidence is not None
    assert 1 < evidence.hits < evidence.starts / 4
    assert 0.0 < evidence.missed <= 0.02


@pytest.mark.slow
def test_three_seeds_agree_where_the_first_steps_miss_the_best_optimum() -> None:
    law = {"function": "1/x", "x": [1, 2], "input": "90 deg", "output": "90 deg"}
    changes = {"requirement.law": law, "mechanism.assembly": "right"}
    file = optlink.load("function-log10", changes)
    computed = [optlink.solve(file, seed=seed) for seed in range(3)]
    assert all(result.valid for result in computed)
    assert {round(math.degrees(result.objective), 6) for result in computed} == {0.326990}


@pytest.mark.slow
def test_the_distinct_optima_of_a_law_are_its_designs() -> None:
    """Best first, each valid and an optimum: a search that begins there returns it."""
    file = optlink.load("function-sin")
    result = optlink.solve(file, designs=2, certify=False)
    first, second = result.designs
    assert first.objective < 0.9 * second.objective
    assert [optimum.objective for optimum in result.optima[:2]] == [first.objective, second.objective]
    for one in result.designs:
        checked = optlink.validate(one.problem, {name: one.values[name] for name in one.task.free})
        assert checked.valid
        assert checked.objective == pytest.approx(one.objective, rel=1e-6)
        again = solve(one.problem, begin=one.values)
        assert again.objective == pytest.approx(one.objective, rel=1e-8)
    assert [len(optlink.solve(file, designs=count, certify=False).designs) for count in (1, 2)] == [1, 2]


@pytest.mark.slow
def test_the_objective_is_the_same_in_every_output() -> None:
    """Design, distinct optima and validation show the largest error over the range, not that at the design positions."""
    file, result = short(), default_answer(SHORT)
    document = json.loads(json.dumps(result.to_dict()))
    first = document["optima"][0]
    assert first["objective"] == document["objective"]["value"] == result.objective
    assert first["design"] == document["design"]
    assert measured(result, case(SHORT).task)[0] == pytest.approx(first["objective"], rel=1e-6)
    nlp = build(file.spec)
    coarse = multistart.solve_from(nlp, nlp.x_of({name: result.design[name] for name in file.spec.free}), contract.CLOSE)
    assert coarse.objective < result.objective * (1.0 - 1e-6)  # what the programme of the design positions alone has


@pytest.mark.slow
def test_every_result_states_its_assembly_mode() -> None:
    from optlink.presentation import terminal
    from optlink.presentation.registry import table_of

    result = short_of_both_modes()
    document = result.to_dict()
    assert document["assembly"] == result.assembly in ("left", "right")
    assert {optimum["assembly"] for optimum in document["optima"]} <= {"left", "right"}
    console = terminal.console()
    with console.capture() as text:
        console.print(terminal.rendered(table_of("design")(result)))
    assert f"joint C lies to the {result.assembly} of B -> D" in text.get()


@pytest.mark.slow
def test_a_given_design_is_checked_in_the_assembly_mode_that_fits_it() -> None:
    either, result = short(**{"mechanism.assembly": "either"}), short_of_both_modes()
    checked = optlink.validate(either, {name: result.design[name] for name in either.spec.free})
    assert checked.assembly == result.assembly
    assert checked.objective == pytest.approx(result.objective, rel=1e-6)


@pytest.mark.slow
def test_the_written_machine_moves_like_the_design(tmp_path: Path) -> None:
    """Law and function: loaded by `analyze`, from the same crank angle, the rocker turns as the result says."""
    from optlink.presentation.view import View
    from optlink.presentation.views.design import VIEW

    for result in (optlink.solve(optlink.load("crank-rocker"), starts=1), short_of_both_modes()):
        View(design=VIEW.design).write(result, tmp_path)
        machine = optlink.load(tmp_path / "design.toml")
        outcome = optlink.analyze(machine)
        assert machine.raw["mechanism"].get("assembly", "left") == result.assembly
        crank, rocker = outcome.columns["crank_angle_deg"], outcome.columns["rocker.angle_rad"]
        at = np.degrees(result.design["phi0"] + 0.5 * result.problem.spec.span)
        k = int(np.argmin(np.abs(np.remainder(crank - at + 180.0, 360.0) - 180.0)))
        offset = math.remainder(math.radians(crank[k]) - result.design["phi0"], 2.0 * math.pi)
        target = result.problem.spec.law.curve(np.array([offset]), result.design["phi0"], result.design["psi0"])[0]
        generated = target + result.error([offset])[0]
        assert math.remainder(rocker[k] - generated, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_a_law_of_three_variables_is_searched_from_random_starts_by_default():
    """From its one starting point the search ends at an error 36 times as large."""
    bounds = {"bounds": ["42 mm", "634 mm"]}
    mechanism = {
        "type": "four-bar",
        "frame": "211 mm",
        "crank": "49.5 mm",
        "coupler": bounds,
        "rocker": bounds,
        "assembly": "left",
    }
    law = {"law": "psi0 + 0.2*(phi - phi0)^2", "span": "40 deg", "measure": "max", "from": {"bounds": ["0 deg", "360 deg"]}}
    problem = optlink.read({"mechanism": mechanism, "requirement": law, "limits": {"transmission_angle": ["35 deg", "145 deg"]}})
    one, result = optlink.solve(problem, starts=1), optlink.solve(problem)
    assert one.valid
    assert result.valid
    assert result.objective < 0.1 * one.objective
    assert result.starts > 24
    assert result.evidence.missed <= 0.02


def rocker_table(digits: int) -> optlink.ProblemFile:
    """Twelve rows of the motion of a four-bar of 30, 90, 75 and 100 mm, by the law of cosines, with some decimals."""
    crank = np.radians(np.linspace(50.0, 170.0, 12))
    arm = 30.0 * np.exp(1j * crank) - 100.0  # from D to B
    rocker = np.angle(arm) - np.arccos((np.abs(arm) ** 2 + 75.0**2 - 90.0**2) / (150.0 * np.abs(arm)))
    phi, psi = (np.degrees(np.unwrap(one) - one[0]) for one in (crank, rocker))
    law = {"phi": [f"{one:.{digits}f} deg" for one in phi], "psi": [f"{one:.{digits}f} deg" for one in psi]}
    sizes = {
        name: {"start": f"{start} mm", "bounds": ["10 mm", "300 mm"]} for name, start in zip(SIZES, (35, 80, 70), strict=True)
    }
    starts = {"from": {"bounds": ["0 deg", "360 deg"]}, "psi0": {"bounds": ["-360 deg", "360 deg"]}}
    mechanism = {"type": "four-bar", "frame": "100 mm", "assembly": "left", **sizes}
    return optlink.read({"mechanism": mechanism, "requirement": {"kind": "function", "law": law, **starts}})


SIZES = "crank", "coupler", "rocker"


@pytest.mark.parametrize("digits", [12, 6])
def test_a_law_that_is_met_exactly_needs_no_further_start(digits: int) -> None:
    result = optlink.solve(rocker_table(digits))
    assert result.valid
    assert result.starts == 1
    assert [1e3 * result.design[name] for name in SIZES] == pytest.approx([30.0, 90.0, 75.0], rel=1e-3)
    assert result.evidence is None or result.evidence.missed == 0.0


@pytest.mark.slow
def test_random_starts_and_assembly_modes_end_at_the_first_exact_design() -> None:
    """From a start that leads elsewhere; the number of processes changes nothing."""
    far = {f"mechanism.{name}": {"start": "290 mm", "bounds": ["10 mm", "300 mm"]} for name in SIZES}
    far["requirement.from"] = {"start": "340 deg", "bounds": ["0 deg", "360 deg"]}
    file = rocker_table(12).override(far)
    both = optlink.solve(rocker_table(12).override({"mechanism.assembly": "either"}))
    assert both.starts == 1  # the first assembly mode has the design
    one, other = optlink.solve(file), optlink.solve(file, workers=2)
    assert (one.starts, one.design) == (other.starts, other.design)
    assert 1 < one.starts < 100
    assert float(np.max(np.abs(one.error()))) < 1e-9
