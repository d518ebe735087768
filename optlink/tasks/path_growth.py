"""Designs of a linkage derived from designs of its inner four-bar, so that none is worse than the best four-bar."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from optlink.problem.path import GenerationProblem
from optlink.synthesis.batch import Batch
from optlink.synthesis.batch_search import MISSED, Candidate, ordered
from optlink.synthesis.growth import Contained, grown
from optlink.synthesis.levenberg_marquardt import descend
from optlink.tasks.path_search import Polisher, as_good, feasible
from optlink.tasks.results.path import Design

STARTS = 12  # per design of the four-bar and combination of assembly modes
POLISHED = 4  # candidates refined, in total
STEPS = 120


def grow(part: Contained, four_bars: Sequence[Design], polisher: Polisher, seed: int) -> list[Design]:
    """Return valid designs derived from designs of the four-bar, best first; empty if its curve cannot be repeated.

    If no local search ends at an optimum as good as the best four-bar, the starts themselves and the feasible designs
    at which the searches stalled are included.

    Parameters
    ----------
    part : Contained
    four_bars : sequence of Design
        Valid designs of `part.file`.
    polisher : Polisher
        For the whole linkage.
    seed : int
        Seed of the random dimensions.
    """
    files = polisher.files
    rng = np.random.default_rng([seed, len(files)])
    begun: list[Candidate] = []
    ended: list[Candidate] = []
    for variant, file in enumerate(files):
        task = file.model
        assert isinstance(task, GenerationProblem)
        batch = Batch(task)
        for design in four_bars:
            x, t = grown(replace(part, file=design.problem), batch, design.values, design.crank_angles, STARTS, rng)
            if not len(x):
                continue
            begun += _candidates(variant, batch, x, t)
            ends = descend(batch, x, t, STEPS, slow=1e-9)
            good = ordered(batch, ends)[0] & (ends.missed <= MISSED)
            ended += _candidates(variant, batch, ends.x[good], ends.t[good])
    polished: list[Design] = []
    best = min(four_bars, key=lambda design: design.objective, default=None)
    for near, candidates in ((False, ended), (True, begun)):
        if best is None or not any(design.valid and as_good(design, best) for design in polished):
            candidates.sort(key=lambda candidate: candidate.cost)
            polished += [polisher.polish(c, near=near) for c in candidates[:POLISHED]]
    found = [design for design in polished if design.valid]
    if best is not None and not any(as_good(design, best) for design in found):
        found += [design for end in polished if (design := feasible(end)).valid]
        found += itertools.islice(filter(lambda start: start.valid, map(polisher.unpolished, begun)), 1)
    return sorted(found, key=lambda design: design.objective)


def _candidates(variant: int, batch: Batch, x: np.ndarray, t: np.ndarray) -> list[Candidate]:
    angles = batch.crank_angles(x, t)
    r = batch.residuals(x, angles)[0]
    cost = np.einsum("bpk,bpk->b", r, r)
    way = np.where(angles[:, -1] >= angles[:, 0], 1, -1)
    return [Candidate(variant, x[i], t[i], float(cost[i]), int(way[i])) for i in range(len(x))]
