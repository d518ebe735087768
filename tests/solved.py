"""Solutions of the shipped problems with default options, each searched once per test run, whichever process needs it first."""

from __future__ import annotations

import fcntl
import os
import pickle
import tempfile
from functools import cache
from pathlib import Path

import optlink
from optlink.tasks.results.balance import Balance

Solution = optlink.FunctionResult | optlink.PathResult | optlink.CycleResult | Balance


@cache
def solution(name: str) -> Solution:
    """Return the solution of a shipped problem, from the file of another process of this run if there is one."""
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID")
    if run is None:
        return optlink.solve(optlink.load(name))
    folder = Path(tempfile.gettempdir(), f"optlink-tests-{os.getuid()}-{run}")
    folder.mkdir(mode=0o700, exist_ok=True)
    with (folder / name).open("a+b") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.seek(0)
        stored = file.read()
        if stored:
            return pickle.loads(stored)
        found = optlink.solve(optlink.load(name))
        file.write(pickle.dumps(found))
    return found
