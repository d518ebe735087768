"""Optima that follow a changed problem, against those of a new programme."""

from __future__ import annotations

import pytest

import optlink
from optlink.errors import Status
from optlink.solvers import multistart
from optlink.studio.design import TargetsFollower


@pytest.mark.slow
def test_a_path_follows_new_and_moved_limits() -> None:
    """A limit that is added needs another programme; one that moves, moves at the positions of peaks too."""
    file = optlink.load("path-slider-egg").variants()[0]
    begun = optlink.solve(file, starts=60, designs=1, workers=1).best
    way = 1 if begun.crank_angles[-1] >= begun.crank_angles[0] else -1
    follower = TargetsFollower(file, way)
    near = follower.follow(file, multistart.solution_at(follower.programme.nlp, begun.solution.x, "begun"))
    for least in (50, 60, 52):
        changed = file.override({"limits.transmission_angle": [f"{least} deg", f"{180 - least} deg"]})
        other = TargetsFollower(changed, way)
        expected = other.follow(changed, multistart.solution_at(other.programme.nlp, near.x, "begun"))
        near = follower.follow(changed, near)
        assert near.status is expected.status is Status.OPTIMAL
        assert near.objective == pytest.approx(expected.objective, rel=1e-8)
        bounds = [{(one.name, one.sense): one.bound for one in s.limits if one.active} for s in (near, expected)]
        assert bounds[0] == pytest.approx(bounds[1], rel=1e-9)
        assert any(key[0].startswith("transmission") for key in bounds[0]), bounds
