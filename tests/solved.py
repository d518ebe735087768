"""What several tests need and takes long is computed once per test run, by whichever process needs it first."""

from __future__ import annotations

import contextlib
import pickle
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import optlink
from optlink.errors import InputError
from optlink.io import locked
from optlink.problem.file import ProblemFile
from optlink.tasks.design import SynthesisTask
from optlink.tasks.protocol import Search
from optlink.tasks.results.balance import Balance

Solution = optlink.SynthesisResult | Balance
FOLDER: list[Path] = []
"""Folder of this run that all its processes share; none if it has one process. Set by `conftest.py`."""


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Wait until no other process is in there."""
    while True:
        with contextlib.ExitStack() as stack:
            try:
                stack.enter_context(locked(folder))
            except InputError:
                time.sleep(0.05)
                continue
            yield
            return


def once(name: str, make: Callable[[], Any]) -> Any:
    """Return what `make` returns, from the file of another process of this run if there is one.

    Parameters
    ----------
    name : str
        Of the file.
    make : callable
        Its answer must pickle.
    """
    if not FOLDER:
        return make()
    folder = FOLDER[0] / name
    folder.mkdir(parents=True, exist_ok=True)
    stored = folder / "stored.pickle"
    with _alone(folder):
        if stored.exists():
            return pickle.loads(stored.read_bytes())
        result = make()
        stored.write_bytes(pickle.dumps(result))
    return result


def folder_once(name: str, alone: Path, fill: Callable[[Path], None]) -> Path:
    """Return a folder that `fill` has filled: one for all processes of this run, or `alone`; tests only read it.

    Parameters
    ----------
    name : str
    alone : Path
        An empty folder, for a run of one process.
    fill : callable
        Takes the folder.
    """
    place = FOLDER[0] / f"{name}-files" if FOLDER else alone

    def filled() -> Path:
        place.mkdir(exist_ok=True)
        fill(place)
        return place

    return once(name, filled)


@contextlib.contextmanager
def shared_searches(changed: int | None = None) -> Iterator[None]:
    """Search a problem with the same options once per test run, with its iterates, and a changed one once in this context.

    Parameters
    ----------
    changed : int, optional
        Starts of a changed problem for which none are given.
    """
    whole, found = SynthesisTask.search, dict[str, Any]()

    def search(task: SynthesisTask, problem: ProblemFile, asked: Search) -> Any:
        if asked.begin is not None:
            return whole(task, problem, asked)
        if problem.overrides:
            asked = replace(asked, starts=asked.starts or changed)
        key = f"search {problem.file} {problem.hash} {asked.backend} {asked.starts} {asked.seed} {asked.designs}"
        if key not in found:
            make = lambda: whole(task, problem, replace(asked, track=True))  # noqa: E731
            found[key] = make() if problem.overrides else once(re.sub(r"\W+", "-", key), make)
        return found[key]

    with mock.patch.object(SynthesisTask, "search", search):
        yield


@cache
def loaded(name: str) -> ProblemFile:
    """Return a shipped problem, read once per process: to choose the cases of tests by what it is."""
    return optlink.load(name)


@cache
def solution(name: str) -> Solution:
    """Return the solution of a shipped problem with default options."""

    def solved() -> Solution:
        with shared_searches():
            return optlink.solve(optlink.load(name))

    return once(f"solution of {name}", solved)
