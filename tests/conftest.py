"""Shared fixtures."""

from __future__ import annotations

import pytest

import optlink


@pytest.fixture(scope="session")
def crank_rocker() -> optlink.ProblemFile:
    return optlink.load("crank-rocker")


@pytest.fixture(scope="session")
def solved(crank_rocker: optlink.ProblemFile) -> optlink.Result:
    """The crank-rocker solved by both back ends, with iterates."""
    return optlink.solve(crank_rocker, "both", track=True)
