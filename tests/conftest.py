"""Shared fixtures."""

from __future__ import annotations

import signal

import hypothesis
import pytest

import optlink

# the same examples in every run: what fails once fails again, and is found before it lands
hypothesis.settings.register_profile("repeatable", derandomize=True)
hypothesis.settings.load_profile("repeatable")

# a shell's background job ignores it, and so would all processes that are interrupted here
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def crank_rocker() -> optlink.ProblemFile:
    return optlink.load("crank-rocker")


@pytest.fixture(scope="session")
def solved(crank_rocker: optlink.ProblemFile) -> optlink.FunctionResult:
    """The crank-rocker solved by both back ends, with iterates."""
    return optlink.solve(crank_rocker, "both", track=True)
