"""Conflicts are explained although the programmes of the search were dropped meanwhile."""

import optlink
from optlink.tasks import search


def test_an_infeasible_machine_is_explained_after_its_programmes_were_dropped(monkeypatch):
    monkeypatch.setattr(search, "MOST_PROGRAMMES", 1)
    machine = optlink.load("shaper-design")
    raw = {**machine.raw, "limits": {**machine.raw["limits"], "guide": {**machine.raw["limits"]["guide"], "max": "1 N"}}}
    result = optlink.solve(machine.with_tables(raw), starts=1)
    assert not result.valid
    assert result.conflict
