"""All four-bars through poses and points that leave them no freedom, each one certified before it is counted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optlink.errors import InputError
from optlink.linkage.vector2d import Array
from optlink.synthesis.certificate import certificate
from optlink.synthesis.homotopy import Problem, Roots, track
from optlink.synthesis.pairs import Complex
from optlink.synthesis.start_problems import COUNTS, FIVE_POINTS, NINE_POINTS, cognates, distinct, stored

ROUTES = 4  # sets of paths, from different generic problems, that are followed until no four-bar is missing
AT_END = 1e-7  # rest of a path at which one that is given up has no proper end


@dataclass(frozen=True)
class AllFourBars:
    """The certified four-bars of a problem: those with exchanged dyads, and for nine points the three cognates, count as one.

    `expected`: their number for generic data, complex ones included; `found`: the certified and different ones; `real`: the real
    ones among them, with both joints and pivots (B, 2) [m] as they lie at the first pose, and the rotations (B, K + 1) of the
    coupler [rad] at the poses and points; for nine points the three cognates follow each other. `size`: that of the data [m].
    """

    kind: tuple[int, int]
    expected: int
    found: int
    joints: Complex
    pivots: Complex
    angles: Array
    size: float

    @property
    def real(self) -> int:
        """Number of real ones; for nine points, of triples of cognates."""
        return len(self.joints) // (3 if self.kind == NINE_POINTS else 1)

    @property
    def missing(self) -> int:
        """Number of four-bars without a certificate, to the number for generic data: lost paths, or special data."""
        return self.expected - self.found


def four_bars(
    places: Sequence[complex] | Complex,
    angles: Sequence[float] | Array = (0.0,),
    seed: int = 0,
    pivots: Sequence[complex] | None = None,
) -> AllFourBars:
    """Return all four-bars through points x + iy [m] of the coupler, whose angles [rad] are given at the first ones.

    Their numbers: four poses and two points, three and four, two and six, or nine points; five points if both `pivots` are given.
    """
    z, angle = np.asarray(places, dtype=complex), np.asarray(angles, dtype=float)
    size = float(np.sqrt(np.mean(np.abs(z[1:] - z[0]) ** 2)))
    d = (z[1:] - z[0]) / size
    given = None
    if pivots is not None:
        at = (np.asarray(pivots, dtype=complex) - z[0]) / size
        given = np.stack([at, np.conj(at)], axis=1)
    problem = Problem(d, np.conj(d), _less_one(angle[1:] - angle[0]), given)
    if problem.kind not in COUNTS or (problem.kind == FIVE_POINTS) != (given is not None):
        message = f"{problem.kind[0]} poses and {problem.kind[1]} points do not determine finitely many four-bars"
        remedy = "Give 6 points, the angles at 4 of them; or 7 and 3, 8 and 2, or 9 and 1; or 5 points and both pivots"
        raise InputError(message, remedy, key="angles")
    expected, rng = COUNTS[problem.kind], np.random.default_rng([*problem.kind, seed])
    dyads, turns = np.zeros((0, 2, 4), complex), np.zeros((0, len(d)), complex)
    marked, real = np.zeros((0, 2 + (problem.kind == NINE_POINTS), 4), complex), np.zeros(0, bool)
    for _ in range(ROUTES):
        start, roots = route(problem.kind, rng)
        ends, at = track(roots, start, problem)
        proof = certificate(problem, ends[at >= 1.0])
        new = (proof.roots.dyads, proof.roots.turns, proof.marks, proof.real)
        both = [np.concatenate([old, more[proof.proven]]) for old, more in zip((dyads, turns, marked, real), new, strict=True)]
        kept = distinct(both[2])
        dyads, turns, marked, real = (each[kept] for each in both)
        without_end = np.sum((at < 1.0) & (at > 1.0 - AT_END))  # singular or infinite at the data themselves, from any start
        if len(dyads) + without_end >= expected:
            break
    shown = Roots(dyads[real], turns[real])
    if problem.kind == NINE_POINTS and len(shown):
        three = certificate(problem, cognates(shown, problem)).roots
        order = np.arange(len(three)).reshape(3, -1).T.ravel()
        shown = three[order]
    turned = np.unwrap(np.concatenate([np.zeros((len(shown), 1)), np.angle(1.0 + shown.turns)], axis=1), axis=1)
    joints, links = np.moveaxis(size * shown.dyads[..., [0, 2]], 2, 0)
    return AllFourBars(problem.kind, expected, len(dyads), z[0] + joints, z[0] + joints - links, angle[0] + turned, size)


def _less_one(turn: Array) -> Complex:
    """Return rotations by angles, less one."""
    return np.asarray(2j * np.sin(0.5 * turn) * np.exp(0.5j * turn))


def route(kind: tuple[int, int], rng: np.random.Generator) -> tuple[Problem, Roots]:
    """Return a generic problem with its four-bars: the stored one with displacements and conjugates times random numbers."""
    problem, roots = stored(*kind)
    one, other = np.exp(rng.normal(0.0, 0.3, 2) + 1j * rng.uniform(0.0, 2.0 * np.pi, 2))
    pivots = None if problem.pivots is None else problem.pivots * [one, other]
    return Problem(one * problem.d, other * problem.e, problem.turns, pivots), Roots(
        roots.dyads * [one, other, one, other], roots.turns
    )
