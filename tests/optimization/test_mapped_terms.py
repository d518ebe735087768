"""Derivatives by the chain rule over the positions of a cycle against those of the whole expression."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import optlink
from optlink.optimization.cycle_nlp import build_cycle
from optlink.optimization.cycle_signals import TracedCycle
from optlink.optimization.nlp import NLP
from optlink.solvers.semi_infinite import with_following_peaks
from optlink.tasks.results.cycle import task_of

MACHINES = {
    "peaks": {},
    "integral": {"objective": {"quantity": "torque", "measure": "rms"}, "limits.guide": None},
    "no reversals": {"objective": {"quantity": "torque", "measure": "rms"}, "limits": {}, "loads": {}},
}


def same_derivatives(nlp: NLP) -> None:
    plain = replace(nlp, mapped=None, cache={})
    random = np.random.default_rng(0)
    x, p = nlp.x_start + 0.01 * random.standard_normal(len(nlp.x_start)), nlp.p.copy()
    p[0], multipliers = 1.7, random.standard_normal(len(nlp.rows))
    one, other = nlp.at(x, p), plain.at(x, p)
    pairs = [(getattr(one, name), getattr(other, name)) for name in ("f", "gradient", "g", "jacobian")]
    for own, expected in [*pairs, (nlp.hessian(x, p, multipliers), plain.hessian(x, p, multipliers))]:
        np.testing.assert_allclose(own, expected, rtol=0.0, atol=1e-12 * np.max(np.abs(expected), initial=1e-300))


@pytest.mark.parametrize("machine", MACHINES)
def test_derivatives_are_those_of_the_whole_expression(machine: str) -> None:
    task = task_of(optlink.load("shaper-design").override(MACHINES[machine]))
    trace = TracedCycle(task, slow=task.slow_assumed)
    start = {name: task.quantities[name].value for name in task.free}
    structure = trace.structure(start)
    assert structure is not None
    nlp = build_cycle(trace, structure, start, nodes=16, slots=3)
    assert (machine == "no reversals") == (not structure.which)
    same_derivatives(nlp)
    copy = pickle.loads(pickle.dumps(nlp))
    assert copy.mapped is not None
    same_derivatives(copy)
    if machine == "peaks":
        same_derivatives(with_following_peaks(copy, ((1, 0), (4, 2))))
