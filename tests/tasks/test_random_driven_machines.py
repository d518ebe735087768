"""Random machines with drives and couplings against Newton's equations in absolute coordinates.

`python -m tests.tasks.test_random_driven_machines 300 2300` judges the machines of a range of seeds; the tests take the first.
"""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.tasks.analyze import reaction_conventions
from tests.driven_oracle import Machines, Oracle, faults


def disagreement(raw, oracle, points=12):
    """What differs between the table of a machine and the oracle."""
    analysis = optlink.analyze(optlink.read(raw), points=points)
    table = {name: np.asarray(analysis[name]) for name in analysis.columns}
    return faults(oracle, table, reaction_conventions(analysis.machine))


def judged(seed):
    """Whether a random machine can be moved; if so, its whole table agrees with the oracle, and else one sentence says why."""
    raw, oracle = Machines(seed).build()
    try:
        found = disagreement(raw, oracle)
    except InputError as error:
        assert len(error.faults) == 1, seed
        assert "\n" not in error.faults[0].message, seed
        return False
    assert not found, (seed, found[:4])
    return True


def agree(first, end):
    """Judge the machines of a range of seeds; three quarters of them move."""
    seeds = range(first, end)
    assert 4 * sum(map(judged, seeds)) >= 3 * len(seeds)


TURNS = {"sun": 2.0 * math.pi, "ring": -math.pi}


@pytest.mark.parametrize("driven", [["sun"], ["ring"], ["sun", "ring"]], ids=" and ".join)
def test_planetary_trains_agree_with_newton(driven):
    """A sun of 40 teeth, a planet of 20 and a ring of 80, of which those that are not driven are fixed; with all tooth forces."""
    sun, ring = (body if body in driven else "frame" for body in ("sun", "ring"))
    links = {body: {"joints": ["A"]} for body in driven}
    links |= {"carrier": {"joints": ["A", "B"], "length": "0.03 m"}, "planet": {"joints": ["B", "P"], "length": "0.01 m"}}
    gears = {
        "inner": {"bodies": [sun, "planet"], "teeth": [40, 20], "arm": "carrier"},
        "outer": {"bodies": ["planet", ring], "teeth": [20, 80], "internal": True, "arm": "carrier"},
    }
    own = {"mass": "1.3 kg", "centroid": ["0.004 m", "-0.003 m"], "inertia": "0.002 kg*m^2"}
    raw = {
        "title": "Planetary train",
        "gravity": "9.81 m/s^2",
        "mechanism": {"ground": {"A": ["0 m", "0 m"]}, "links": links, "gears": gears},
        "bodies": dict.fromkeys(links, own),
        "loads": {"brake": {"on": "carrier", "torque": "-3 N*m"}},
    }
    drives = {body if len(driven) > 1 else "input": {"body": body, "speed": f"{TURNS[body]!r} rad/s"} for body in driven}
    raw |= {"drives": drives} if len(driven) > 1 else {"drive": drives["input"]}
    laws = {name: (one, lambda t, rate=TURNS[one["body"]]: rate * t) for name, one in drives.items()}
    assert not disagreement(raw, Oracle(raw, laws), 36)


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
