"""Proofs that a solution of `homotopy` exists, is alone in its neighbourhood, and is real: Krawczyk's condition.

Residuals are computed with `pairs`, all else in double precision, with bounds of the rounding errors.

References
----------
R. Krawczyk, Computing 4 (1969) 187-201.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array
from optlink.synthesis.homotopy import LEAST, PIVOTS, Problem, Roots, slopes
from optlink.synthesis.pairs import Complex, Pair, closure

PAIR, DOUBLE = 2.0**-94, 2.0**-46  # bounds of the rounding of a value, of pairs and of doubles, relative to the sum of its terms
REACH = 0.1  # largest radius of a neighbourhood, relative to the coordinates
HALF = 0.49  # of the contraction, with which the rounding of the bounds themselves is covered


def _equations(problem: Problem, dyads: Any, turns: Any, sign: float, wrap: Any) -> Any:
    """Return the equations at poses, those at points times 1 + t, and those of given pivots.

    `wrap` makes the numbers of arrays; with `sign` 1, and absolute values as numbers, the result is the size of all terms.
    """
    poses = len(problem.turns)
    x, xb, u, ub = (wrap(*(part[:, :, k, None] for part in dyads)) for k in range(4))
    d, e = (wrap(each[:poses]) for each in (problem.d, problem.e))
    p, q = d + wrap(problem.turns) * x, e + wrap(np.conj(problem.turns)) * xb
    at_poses = p * (ub + q) + u * q
    d, e = (wrap(each[poses:]) for each in (problem.d, problem.e))
    t, one, minus = wrap(*(part[:, None, poses:] for part in turns)), wrap(np.array(1.0 + 0j)), wrap(np.array(sign + 0j))
    if problem.pivots is None:
        return at_poses, closure(x, xb, u, ub, d, e, t, one, minus)
    place, conjugate = (wrap(problem.pivots[:, k, None]) for k in range(2))
    given = (x + minus * (u + place), xb + minus * (ub + conjugate))
    return at_poses, closure(x, xb, u, ub, d, e, t, one, minus), *given


@dataclass(frozen=True)
class Certificate:
    """Refined solutions; radii of proven existence (inf: none) and of uniqueness, relative to `sizes`; whether they are real."""

    roots: Roots
    existence: Array
    uniqueness: Array
    real: NDArray[np.bool_]

    @property
    def proven(self) -> NDArray[np.bool_]:
        """Which solutions are proven."""
        return np.isfinite(self.existence)


def sizes(dyads: Complex) -> Array:
    """Return the sizes of the coordinates that radii refer to."""
    return np.maximum(np.abs(dyads), LEAST)


def certificate(problem: Problem, roots: Roots) -> Certificate:
    """Return the solutions refined, and what is proven about each of them, for the data as they are."""
    poses, count = len(problem.turns), len(roots)
    number = 8 + len(problem.d) - poses
    z, low_z = roots.dyads, np.zeros_like(roots.dyads)
    t, low_t = roots.turns, np.zeros_like(roots.turns)

    def flat(*parts: Any) -> Any:
        return np.concatenate([part.reshape(count, -1) for part in parts], axis=1)

    jacobian = np.zeros((count, 2, len(problem.d), number), complex)
    with np.errstate(all="ignore"):
        value, slope, by_turn, _ = slopes(z, t, problem.d, problem.e)
        scale = np.concatenate([np.ones((count, poses)), 1.0 + t[:, poses:]], axis=1)
        for k in range(2):
            jacobian[:, k, :, 4 * k : 4 * k + 4] = slope[:, k] * scale[..., None]
            for i in range(poses, len(problem.d)):
                jacobian[:, k, i, 8 + i - poses] = value[:, k, i] + scale[:, i] * by_turn[:, k, i]
        given = np.zeros((count, 0 if problem.pivots is None else 4, number))
        given[:, :, :8] = PIVOTS[[0, 2, 1, 3]].reshape(4, 8)[: given.shape[1]]
        matrix = flat(*np.split(jacobian, [poses], axis=2), given).reshape(count, number, number)
        good = np.all(np.isfinite(matrix), axis=(1, 2))
        good &= np.linalg.det(np.where(good[:, None, None], matrix, 0.0)) != 0.0
        inverse = np.linalg.inv(np.where(good[:, None, None], matrix, np.eye(number)))
        for last in (False, False, False, True):
            pairs = _equations(problem, (z, low_z), (t, low_t), -1.0, Pair)
            residual = flat(*(pair.high + 0.0 * pair.low for pair in pairs))
            if not last:
                step = -np.einsum("bij,bj->bi", inverse, residual)
                z_pair = Pair(z, low_z) + Pair(step[:, :8].reshape(z.shape))
                t_pair = Pair(t[:, poses:], low_t[:, poses:]) + Pair(step[:, 8:])
                z, low_z = z_pair.high, z_pair.low
                t, low_t = t.copy(), low_t.copy()
                t[:, poses:], low_t[:, poses:] = t_pair.high, t_pair.low
        # the Jacobian of the start stays: the refinement moved it by less than what `bend` allows for
        moved = np.concatenate([np.abs(z - roots.dyads).reshape(count, 8), np.abs(t - roots.turns)[:, poses:]], axis=1)
        of_dyads, of_turns = sizes(z), np.abs(t)
        weight = np.concatenate([of_dyads.reshape(count, 8), of_turns[:, poses:]], axis=1)
        pivots = None if problem.pivots is None else np.abs(problem.pivots)
        data = Problem(np.abs(problem.d), np.abs(problem.e), np.abs(problem.turns), pivots)

        def terms(factor: float) -> Any:
            return flat(*_equations(data, (factor * of_dyads,), (factor * of_turns,), 1.0, np.abs))

        size = np.abs(inverse)
        distance = np.max(moved / weight, axis=1)

        def bound(right: Any) -> Any:
            return np.max(np.einsum("bij,bj->bi", size, right) / weight, axis=1)

        off = bound(np.abs(residual) + PAIR * terms(1.01))
        deviation = np.abs(inverse @ matrix - np.eye(number))
        bend = bound(2.0 * terms(2.0 + 2.0 * REACH))
        shrink = (
            np.max(np.einsum("bij,bj->bi", deviation, weight) / weight, axis=1) + bound(DOUBLE * terms(2.02)) + distance * bend
        )
        existence = 2.0 * off
        proven = good & (distance < REACH) & (existence < REACH) & (shrink + bend * existence < HALF)
        uniqueness = np.minimum(REACH, (HALF - shrink) / bend)
        proven &= existence < 0.01 * uniqueness
        twin_z, twin_t = np.conj(z[..., [1, 0, 3, 2]]), np.conj(-t / (1.0 + t))[:, poses:]
        apart = np.maximum(
            np.max(np.abs(twin_z - z) / of_dyads, axis=(1, 2)),
            np.max(np.abs(twin_t - t[:, poses:]) / of_turns[:, poses:], axis=1),
        )
    real = proven & (apart + 4.0 * existence + DOUBLE < 0.5 * uniqueness)
    return Certificate(Roots(z, t), np.where(proven, existence, np.inf), np.where(proven, uniqueness, 0.0), real)
