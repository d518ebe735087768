"""Which cases of a test a plain `pytest` runs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


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
