"""Shared fixtures."""

from __future__ import annotations

import os
import signal

import hypothesis
import pytest

import optlink
from tests import solved as shared
from tests.browser import browser

# a test run has a process per core: libraries of linear algebra use one thread in each
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# the same examples in every run: what fails once fails again, and is found before it lands
hypothesis.settings.register_profile("repeatable", derandomize=True)
hypothesis.settings.load_profile("repeatable")

# a shell's background job ignores it, and so would all processes that are interrupted here
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


FIRST = ("test_the_site_builds", "test_notebooks.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the documentation and the notebooks, which take a minute: no core waits for the other at the end."""
    items.sort(key=lambda item: next((k for k, name in enumerate(FIRST) if name in item.nodeid), len(FIRST)))


@pytest.fixture(scope="session", autouse=True)
def _shared_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Let the processes of this run share what is computed once; see `tests/solved.py`."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared.FOLDER[:] = [tmp_path_factory.getbasetemp().parent / "shared"]


@pytest.fixture(scope="session")
def crank_rocker() -> optlink.ProblemFile:
    return optlink.load("crank-rocker")


@pytest.fixture(scope="session")
def solved(crank_rocker: optlink.ProblemFile) -> optlink.FunctionResult:
    """The crank-rocker solved by both back ends, with iterates."""
    return optlink.solve(crank_rocker, "both", track=True)


@pytest.fixture(scope="session")
def driver():
    """A browser, started once per process."""
    with browser() as started:
        yield started
