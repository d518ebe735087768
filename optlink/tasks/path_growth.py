"""Designs of a linkage derived from designs of its inner four-bar, so that none is worse than the best four-bar."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from optlink.problem.path import PathProblem
from optlink.synthesis.batch import Batch
from optlink.synthesis.batch_search import MISSED, Candidate, pass_in_order
from optlink.synthesis.growth import ContainedFourBar, grow_from_four_bar
from optlink.synthesis.levenberg_marquardt import minimise
from optlink.tasks.path_search import Polisher, feasible, no_worse_fit
from optlink.tasks.results.path import PathDesign

STARTS = 12  # per design of the four-bar and combination of assembly modes
POLISHED = 4  # candidates refined, in total
STEPS = 120


def designs_from_four_bar(
    part: ContainedFourBar, four_bars: Sequence[PathDesign], polisher: Polisher, seed: int
) -> list[PathDesign]:
    """Return valid designs derived from designs of the four-bar, best first; empty if its curve cannot be repeated.

    If no local search ends at an optimum as good as the best four-bar, the starts themselves and the feasible designs
    at which the searches stalled are included.

    Parameters
    ----------
    part : ContainedFourBar
    four_bars : sequence of PathDesign
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
        assert isinstance(task, PathProblem)
        batch = Batch(task)
        for design in four_bars:
            x, t = grow_from_four_bar(replace(part, file=design.problem), batch, design.values, design.crank_angles, STARTS, rng)
            if not len(x):
                continue
            begun += _candidates(variant, batch, x, t)
            ends = minimise(batch, x, t, STEPS, slow=1e-9)
            good = pass_in_order(batch, ends)[0] & (ends.missed <= MISSED)
            ended += _candidates(variant, batch, ends.x[good], ends.t[good])
    polished: list[PathDesign] = []
    best = min(four_bars, key=lambda design: design.objective, default=None)
    for near, candidates in ((False, ended), (True, begun)):
        if best is None or not any(design.valid and no_worse_fit(design, best) for design in polished):
            candidates.sort(key=lambda candidate: candidate.cost)
            polished += [polisher.polish(c, near=near) for c in candidates[:POLISHED]]
    found = [design for design in polished if design.valid]
    if best is not None and not any(no_worse_fit(design, best) for design in found):
        found += [design for end in polished if (design := feasible(end)).valid]
        found += itertools.islice(filter(lambda start: start.valid, map(polisher.unpolished, begun)), 1)
    return sorted(found, key=lambda design: design.objective)


def _candidates(variant: int, batch: Batch, x: np.ndarray, t: np.ndarray) -> list[Candidate]:
    angles = batch.crank_angles(x, t)
    r = batch.residuals(x, angles)[0]
    cost = np.einsum("bpk,bpk->b", r, r)
    way = np.where(angles[:, -1] >= angles[:, 0], 1, -1)
    return [Candidate(variant, x[i], t[i], float(cost[i]), int(way[i])) for i in range(len(x))]
