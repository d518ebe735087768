"""Searches that several processes share: the digits of one process, in any order of completion; Ctrl-C keeps what is complete."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import pytest

import optlink
from optlink.execution.runner import ordered, pool
from optlink.execution.worker import ChunkResult, ChunkTask, Runs, run_chunk
from optlink.synthesis.batch_search import Searcher
from optlink.tasks.run import design_task
from optlink.tasks.search import PolishTask

PATH = {"designs": 3, "starts": 60}


def digits(result: Any) -> list[object]:
    """All figures of a path result, bit by bit."""
    computed: list[object] = [result.starts, repr(result.evidence), result.notes]
    for one in result.designs:
        computed += [x.hex() for x in (one.objective, *one.values.values(), *one.crank_angles)]
        computed += [one.status, repr(one.validation.checks), repr(one.limits)]
    return computed


def shared(name: str, runs: Runs | None, **options: Any) -> Any:
    file = optlink.load(name)
    return design_task(file).solve(file, runs=runs, shared=runs is not None, **options)


def backwards(task: ChunkTask, todo: Iterable[int]) -> Iterator[tuple[int, ChunkResult]]:
    """The chunks in the present process, the last one first."""
    for index in reversed(list(todo)):
        yield index, run_chunk(task, index)


def exchanged(task: ChunkTask, todo: Iterable[int]) -> Iterator[tuple[int, ChunkResult]]:
    """The same with a defect: each refined design is taken for that of the candidate at the other end."""
    computed = dict(backwards(task, todo))
    count = len(computed) if isinstance(task, PolishTask) else 0
    yield from ((index, computed[count - 1 - index if count else index]) for index in computed)


def cycle_digits(result: Any) -> list[object]:
    """All figures of a machine, bit by bit."""
    computed: list[object] = [result.starts, result.notes, repr(result.validation.checks)]
    for one in (result, *result.optima):
        computed += [x.hex() for x in (one.objective, *one.design.values())]
    return [*computed, *(one.count for one in result.optima)]


def other_starts(task: ChunkTask, todo: Iterable[int]) -> Iterator[tuple[int, ChunkResult]]:
    """A defect: each local search is taken for that from the starting point at the other end."""
    computed = dict(backwards(task, todo))
    yield from ((index, computed[len(computed) - 1 - index]) for index in computed)


def pressed(after: int) -> Runs:
    """Chunks in the present process, of one task after the other; Ctrl-C after some refined candidates."""
    done = 0

    def runs(task: ChunkTask, todo: Iterable[int]) -> Iterator[tuple[int, ChunkResult]]:
        nonlocal done
        for index in todo:
            if done == after and not type(task).__name__.startswith("Round"):
                raise KeyboardInterrupt
            done += not type(task).__name__.startswith("Round")
            yield index, run_chunk(task, index)

    return runs


@pytest.mark.slow
def test_the_order_of_completion_changes_no_digit_of_a_path() -> None:
    alone = digits(shared("path-slider-egg", None, **PATH))
    assert digits(shared("path-slider-egg", backwards, **PATH)) == alone
    assert digits(shared("path-slider-egg", exchanged, **PATH)) != alone


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "starts", "how"),
    [
        ("path-conveyor", 60, [{"workers": 2}]),  # refined by the exchange method, with several directions
        ("path-vline6", None, [{"workers": 4}, {"workers": 2, "engine": "dask"}]),  # exact: needless refinements
        ("path-watt-leg", None, [{"workers": 2}]),
        ("motion-3-poses-region", None, [{"workers": 1}, {"workers": 2}]),
    ],
)
def test_processes_change_no_digit_of_a_path(name: str, starts: int | None, how: list[dict[str, Any]]) -> None:
    file = optlink.load(name)
    alone = digits(optlink.solve(file, seed=1, starts=starts))
    for one in how:
        assert digits(optlink.solve(file, seed=1, starts=starts, **one)) == alone


@pytest.mark.slow
def test_the_order_of_completion_changes_no_digit_of_a_machine() -> None:
    alone = cycle_digits(shared("shaper-design", None, starts=4))
    assert cycle_digits(shared("shaper-design", backwards, starts=4)) == alone
    assert cycle_digits(shared("shaper-design", other_starts, starts=4)) != alone


@pytest.mark.slow
def test_processes_change_no_digit_of_a_machine() -> None:
    file = optlink.load("press-toggle")
    alone = optlink.solve(file, "both", seed=1)
    assert cycle_digits(optlink.solve(file, "both", seed=1, workers=2)) == cycle_digits(alone)


@pytest.mark.slow
def test_ctrl_c_keeps_the_searches_of_a_machine() -> None:
    part = shared("shaper-design", pressed(2), starts=8)
    assert part.interrupted
    assert part.valid
    assert part.starts == 2


@pytest.mark.slow
def test_ctrl_c_keeps_the_refined_designs_of_a_path() -> None:
    whole, part = shared("path-conveyor", None, starts=60), shared("path-conveyor", pressed(2), starts=60)
    assert part.interrupted
    assert not whole.interrupted
    assert 0 < part.evidence.starts < whole.evidence.starts
    assert part.valid
    with pytest.raises(KeyboardInterrupt):
        shared("path-conveyor", pressed(0), starts=60)


@pytest.mark.slow
def test_ctrl_c_keeps_the_searches_of_a_law() -> None:
    """Pressed while the designs of the first round are refined: the start of the file and those that are refined remain."""
    part = shared("crank-rocker", pressed(3), starts=200)
    assert part.interrupted
    assert part.valid
    assert part.starts < 200


def test_no_cluster_is_started_for_a_problem_that_cannot_use_it(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")

    def refused(**given: object) -> None:
        raise AssertionError(given)

    monkeypatch.setattr("optlink.execution.runner.pool", refused)
    assert optlink.solve(optlink.load("balance-four-bar"), engine="dask").valid
    with pytest.raises(AssertionError):
        optlink.solve(optlink.load("path-vline6"), engine="dask")


@pytest.mark.slow
def test_one_worker_computes_no_round_of_starts_ahead(monkeypatch: pytest.MonkeyPatch) -> None:
    """A round that is computed ahead is not used if the search ends before it: one process gains nothing by it."""
    computed, sample = [], Searcher._sample
    monkeypatch.setattr(Searcher, "_sample", lambda *args: computed.append(args[2]) or sample(*args))
    results = [optlink.solve("path-arc5", workers=workers) for workers in (1, None)]
    assert digits(results[0]) == digits(results[1])
    assert sum(computed) == 2 * results[0].starts


@dataclass(frozen=True)
class OwnProcess:
    """Returns the number of the process."""

    def __call__(self, index: int) -> tuple[int, int]:
        """Return the number of the chunk, and of the process."""
        return index, os.getpid()


@pytest.mark.slow
def test_processes_outlive_a_task_of_which_no_further_result_is_needed() -> None:
    with pool("local", 2) as runs:
        first = ordered(OwnProcess(), 50, runs)
        some = [next(first) for _ in range(3)]
        del first
        rest = list(ordered(OwnProcess(), 50, runs))
    assert [index for index, _ in some + rest] == [0, 1, 2, *range(50)]
    processes = {process for _, process in some + rest}
    assert len(processes) <= 2
    assert os.getpid() not in processes
