"""Random machines with drives and couplings against Newton's equations in absolute coordinates.

`python -m tests.tasks.test_random_driven_machines 300 2300` judges the machines of a range of seeds; the tests take the first.
"""

from __future__ import annotations

import sys

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.tasks.analyze import reaction_conventions
from tests.driven_oracle import Machines, faults


def judged(seed):
    """Whether a random machine can be moved; if so, its whole table agrees with the oracle, and else one sentence says why."""
    raw, oracle = Machines(seed).build()
    try:
        analysis = optlink.analyze(optlink.read(raw), points=12)
    except InputError as error:
        assert len(error.faults) == 1, seed
        assert "\n" not in error.faults[0].message, seed
        return False
    table = {name: np.asarray(analysis[name]) for name in analysis.columns}
    assert not (found := faults(oracle, table, reaction_conventions(analysis.machine))), (seed, found[:4])
    return True


def agree(first, end):
    """Judge the machines of a range of seeds; three quarters of them move."""
    seeds = range(first, end)
    assert 4 * sum(map(judged, seeds)) >= 3 * len(seeds)


def test_random_machines_agree_with_newton():
    agree(0, 20)


def test_range_within_a_cycle_of_two_turns():
    """A gear of ratio 1:2 and a group that does not close in one of the two revolutions."""
    assert judged(1688)


@pytest.mark.slow
def test_many_random_machines_agree_with_newton():
    agree(300, 800)


if __name__ == "__main__":
    agree(*map(int, sys.argv[1:]))
