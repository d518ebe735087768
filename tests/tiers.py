"""Which cases of a test a plain `pytest` runs, and how many examples of a property."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import hypothesis
import pytest

PLAIN: list[bool] = []
"""Whether this run leaves out slow tests. Set by `conftest.py` before tests are collected."""


def mostly_slow(cases: Iterable[Any], *kept: Any) -> list[Any]:
    """Return the cases of a test, with the mark of slow tests on all but some.

    Parameters
    ----------
    cases : iterable
    kept
        Those that a plain `pytest` runs, too.
    """
    every = list(cases)
    assert all(one in every for one in kept), "not a case"

    def slow(case: Any) -> Any:
        return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)

    return [one if one in kept else slow(one) for one in every]


def examples(count: int) -> hypothesis.settings:
    """Return the settings of a test of a property: a plain `pytest` tries a quarter of its examples, the same in every run."""
    return hypothesis.settings(max_examples=count // 4 if True in PLAIN else count)
