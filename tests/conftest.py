"""Shared fixtures."""

from __future__ import annotations

import functools
import gc
import os
import signal
import sys
from collections.abc import Iterator

import hypothesis
import pytest
import typer.main

import optlink
from optlink.problem import own_terms
from optlink.problem.terms import QuantityType
from tests import solved as shared, tiers
from tests.browser import browser

# a test run has a process per core: libraries of linear algebra use one thread in each
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# the processes that tests start, and the next run, need not compile the modules and rewrite the assertions again
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# if it is installed, jsonschema builds a grammar of addresses from it for seconds; no schema here has such a format
sys.modules["rfc3987_syntax"] = None  # type: ignore[assignment]

# the same examples in every run: what fails once fails again, and is found before it lands; a busy machine fails nothing
hypothesis.settings.register_profile(
    "repeatable", derandomize=True, deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("repeatable")

# a shell's background job ignores it, and so would all processes that are interrupted here
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


FIRST = (
    "test_the_site_builds",
    "test_what_needs_solving",
    "test_notebooks.py",
    "test_every_command_ends_with_its_exit_code",
    "test_six_bars.py",
    "test_path_evidence.py",
    "test_the_front_does_not_depend_on_workers",
    "test_function_problems.py",
    "test_a_cluster_whose_worker_is_killed",
    "test_some_derivatives_agree_with_reoptimisation",
    "test_three_seeds_agree",
    "test_random_problems.py",
    "test_all_figures_are_those",
    "test_the_tutorial_output_is_correct",
    "test_the_margin_design_has",
    "test_no_random_span_law_of_many",
    "test_best_known_value_is_reached",
    "test_best_known_objective_is_reached",
    "test_least_torque_within",
    "test_compiled.py",
    "test_control.py",
    "test_extrema.py",
    "test_taylor_model.py",
    "test_templates.py",
)
"""What takes ten seconds and more."""


def pytest_configure(config: pytest.Config) -> None:
    """Say to the tests whether slow ones are left out."""
    tiers.PLAIN[:] = [config.getoption("markexpr") == "not slow"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what takes longest: no core waits for the other at the end."""
    items.sort(key=lambda item: next((k for k, name in enumerate(FIRST) if name in item.nodeid), len(FIRST)))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collect no garbage while tests are collected, never look through them again, and collect seldom later: it takes time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(50_000, *gc.get_threshold()[1:])
        gc.enable()


@pytest.fixture(scope="session", autouse=True)
def _shared_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Let the processes of this run share what is computed once; see `tests/solved.py`."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared.FOLDER[:] = [tmp_path_factory.getbasetemp().parent / "shared"]


@pytest.fixture(scope="session", autouse=True)
def _one_command_line() -> Iterator[None]:
    """Build the tree of all commands once per process: it takes as long as most calls that tests make."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("typer.testing._get_command", functools.cache(typer.main.get_command))
        yield


@pytest.fixture(scope="session", autouse=True)
def _nothing_compiled() -> Iterator[None]:
    """Let the choice of an integrator depend on the request alone, not on the cache of the user."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("optlink.clearance.compiled.machine.is_cached", lambda equations: False)
        yield


@pytest.fixture(scope="session", autouse=True)
def _one_process() -> Iterator[None]:
    """Let a study run in the process of its test unless it asks for more: each further one imports optlink for seconds."""
    with pytest.MonkeyPatch.context() as patch:
        for module in ("runner", "store"):
            patch.setattr(f"optlink.execution.{module}.cores", lambda: 1)
        yield


@pytest.fixture(autouse=True)
def _without_own_terms() -> Iterator[None]:
    """Forget the objectives and limits that a test has made of functions: the next one counts the quantities of optlink."""
    yield
    for name in own_terms.OWN:
        QuantityType.registry.pop(name, None)
    own_terms.OWN.clear()


@pytest.fixture(scope="session")
def crank_rocker() -> optlink.ProblemFile:
    return optlink.load("crank-rocker")


@pytest.fixture(scope="session")
def solved(crank_rocker: optlink.ProblemFile) -> optlink.SynthesisResult:
    """The crank-rocker solved by both back ends, with iterates."""
    return optlink.solve(crank_rocker, "both", track=True)


@pytest.fixture(scope="session")
def _driver():
    with browser() as started:
        yield started


@pytest.fixture
def driver(_driver):
    """A browser, started once per process; a page that moves would go on to take a core from the other tests."""
    yield _driver
    _driver.get("about:blank")
