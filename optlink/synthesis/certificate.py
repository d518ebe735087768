"""Proofs that a solution of `homotopy` exists, is alone in its neighbourhood, and is real: Krawczyk's condition.

Residuals are computed with `pairs`, all else in double precision, with bounds of the rounding errors. Where that is not enough,
as for links that are nearly infinite and joints that nearly coincide, all is computed with 80 digits.

References
----------
R. Krawczyk, Computing 4 (1969) 187-201.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array
from optlink.synthesis.decimal_algebra import VANISHES, inverse_of, numbers, precise
from optlink.synthesis.homotopy import LEAST, PIVOTS, Problem, Roots
from optlink.synthesis.pairs import Complex, Pair, closure
from optlink.synthesis.start_problems import marks

PAIR, DOUBLE = 2.0**-94, 2.0**-46  # bounds of the rounding of a value, of pairs and of doubles, relative to the sum of its terms
DECIMAL = 1e-70  # the same of 80 digits
STEPS = 8  # of Newton's method with 80 digits at most, from the end of a path
CLOSE = 1e-3  # change by a step, relative to the coordinates, from which on they do not lead to a solution
KNOWN = 1e-10  # relative error of marks that is small enough to tell solutions apart
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
    """Refined solutions; radii of proven existence (inf: none) and of uniqueness, relative to `sizes`; whether they are real.

    `marks` (B, 2 or 3, 4): see `start_problems.marks`.
    """

    roots: Roots
    existence: Array
    uniqueness: Array
    real: NDArray[np.bool_]
    marks: Complex

    @property
    def proven(self) -> NDArray[np.bool_]:
        """Which solutions are proven."""
        return np.isfinite(self.existence)


@dataclass(frozen=True)
class Evidence:
    """Absolute values (B, n) or (B, n, n) that a proof needs, and bounds of the rounding of residuals and of derivatives.

    `deviation`: of the inverse times the Jacobian from one; `moved`: of the solution from where the Jacobian was evaluated;
    `apart`: of the conjugate from the solution.
    """

    residual: Array
    inverse: Array
    deviation: Array
    moved: Array
    apart: Array
    rounding: tuple[float, float]


def sizes(values: Complex) -> Array:
    """Return the sizes of the coordinates that radii refer to."""
    return np.maximum(np.abs(values), LEAST)


def certificate(problem: Problem, roots: Roots) -> Certificate:
    """Return the solutions refined, and what is proven about each of them, for the data as they are."""
    with np.errstate(all="ignore"):
        found = _with_doubles(problem, roots)
        x, y = np.moveaxis(found.roots.dyads[:, :, :2], 1, 0)
        near = np.minimum(LEAST, np.min(np.abs(x - y), axis=1))  # an error of the joints grows by so much in marks
        known = found.existence * np.max(sizes(found.roots.dyads), axis=(1, 2)) < KNOWN * near
        for k in np.flatnonzero(~known):
            again = _with_80_digits(problem, roots[k : k + 1])
            if again is not None and again.proven[0]:
                found.roots.dyads[k], found.roots.turns[k] = again.roots.dyads[0], again.roots.turns[0]
                for name in ("existence", "uniqueness", "real", "marks"):
                    getattr(found, name)[k] = getattr(again, name)[0]
    return found


def _flat(*parts: Any) -> Any:
    return np.concatenate([part.reshape(len(part), int(np.prod(part.shape[1:]))) for part in parts], axis=1)


def _at_poses(problem: Problem, turns: Complex) -> Complex:
    """Return rotations with the given ones at the poses."""
    return np.concatenate([np.broadcast_to(problem.turns, (len(turns), len(problem.turns))), turns[:, len(problem.turns) :]], 1)


def _jacobian(problem: Problem, dyads: Any, turns: Any, wrap: Any) -> Any:
    """Return the derivatives (B, n, n) of `_equations` by dyads and rotations at points."""
    poses, count, number = len(problem.turns), len(dyads), 8 + len(problem.d) - len(problem.turns)
    x, xb, u, ub = np.moveaxis(dyads, 2, 0)[..., None]
    d, e, one = (wrap(each) for each in (problem.d, problem.e, np.ones((count, len(problem.d)), complex)))
    t, s, more = turns[:, None], -turns, one + turns
    s[:, :poses], more[:, :poses] = wrap(np.conj(problem.turns)), one[:, :poses]
    s, more = s[:, None], more[:, None]
    p, q = d + t * x, e * more + s * xb
    by_x, by_u = ub * more + q, u + p
    matrix = wrap(np.zeros((count, 2, len(problem.d), number), complex))
    for k in range(2):
        for j, by in enumerate((t * by_x, s * by_u, q, p * more)):
            matrix[:, k, :, 4 * k + j] = by[:, k]
    by_turn = x * by_x + p * ub + by_u * (e - xb)
    for i in range(poses, len(problem.d)):
        matrix[:, :, i, 8 + i - poses] = by_turn[:, :, i]
    given = np.zeros((count, 0 if problem.pivots is None else 4, number), complex)
    given[:, :, :8] = PIVOTS[[0, 2, 1, 3]].reshape(4, 8)[: given.shape[1]]
    return _flat(*np.split(matrix, [poses], axis=2), wrap(given)).reshape(count, number, number)


def _to_twin(z: Any, t: Any, one: Any) -> tuple[Any, Any]:
    """Return the difference of dyads and rotations from those of the conjugate solution, which is the same if it is real."""
    return z[:, :, [1, 0, 3, 2]].conjugate() - z, (-t / (one + t)).conjugate() - t


def _with_doubles(problem: Problem, roots: Roots) -> Certificate:
    """Return the solutions refined with pairs, and what derivatives in double precision prove."""
    poses, count = len(problem.turns), len(roots)
    turns = _at_poses(problem, roots.turns)
    z, t = (Pair(part, np.zeros_like(part)) for part in (roots.dyads, turns))
    for _ in range(2):  # the second time with the derivatives at the refined ones
        begin = Roots(z.high, t.high)
        matrix = _jacobian(problem, z.high, t.high, np.asarray)
        good = np.all(np.isfinite(matrix), axis=(1, 2))
        good &= np.linalg.det(np.where(good[:, None, None], matrix, 0.0)) != 0.0
        inverse = np.linalg.inv(np.where(good[:, None, None], matrix, np.eye(matrix.shape[1])))
        for last in (False, False, False, True):
            pairs = _equations(problem, (z.high, z.low), (t.high, t.low), -1.0, Pair)
            residual = _flat(*(pair.high + 0.0 * pair.low for pair in pairs))
            if not last:
                step = -np.einsum("bij,bj->bi", inverse, residual)
                z += Pair(step[:, :8].reshape(count, 2, 4))
                t += Pair(np.pad(step[:, 8:], ((0, 0), (poses, 0))))
    # the derivatives of the start stay: the refinement moved it by less than what `bend` allows for
    moved = np.abs(_flat(z.high - begin.dyads + z.low, (t.high - begin.turns + t.low)[:, poses:]))
    evidence = Evidence(
        np.abs(residual),
        np.abs(inverse),
        np.abs(inverse @ matrix - np.eye(matrix.shape[1])),
        moved,
        _flat(*(np.abs(part.high) for part in _to_twin(z, t[:, poses:], Pair(np.ones(1, complex))))),
        (PAIR, DOUBLE),
    )
    shown = marks(z, problem, lambda pair: pair.high)
    return _proof(problem, Roots(z.high, t.high), good, evidence, shown)


def _with_80_digits(problem: Problem, roots: Roots) -> Certificate | None:
    """Return one solution refined to 80 digits, and what is proven; None if Newton's method does not converge."""
    poses = len(problem.turns)
    with precise() as context:
        context.clear_traps()
        z, t = numbers(roots.dyads), numbers(_at_poses(problem, roots.turns))
        for _ in range(STEPS):
            matrix = _jacobian(problem, z, t, numbers)
            inverse = inverse_of(matrix[0])
            residual = _flat(*_equations(problem, (z,), (t,), -1.0, numbers))
            step = inverse @ residual[0]
            found = _flat(z, t[:, poses:])
            change = float(np.max(np.abs(step).astype(float) / np.abs(found[0]).astype(float)))
            if not change < CLOSE or change < VANISHES:
                break
            z, t = z.copy(), t.copy()
            z[0] -= step[:8].reshape(2, 4)
            t[0, poses:] -= step[8:]
        if not change < VANISHES:
            return None
        unit = numbers(np.eye(matrix.shape[1], dtype=complex))
        twin = _flat(*_to_twin(z, t[:, poses:], numbers(np.ones(1, complex))))
        right, size, deviation, apart = (
            np.abs(each).astype(float) for each in (residual, inverse[None], (inverse @ matrix[0] - unit)[None], twin)
        )
        evidence = Evidence(right, size, deviation, np.zeros_like(apart), apart, (DECIMAL, DECIMAL))
        shown = marks(z, problem)
    return _proof(problem, Roots(z.astype(complex), t.astype(complex)), np.ones(1, bool), evidence, shown.astype(complex))


def _proof(problem: Problem, roots: Roots, good: NDArray[np.bool_], evidence: Evidence, shown: Complex) -> Certificate:
    """Return what is proven of solutions."""
    z, t, poses, (fine, coarse) = roots.dyads, roots.turns, len(problem.turns), evidence.rounding
    of_dyads, of_turns = sizes(z), np.abs(t)
    weight = _flat(of_dyads, of_turns[:, poses:])
    pivots = None if problem.pivots is None else np.abs(problem.pivots)
    data = Problem(np.abs(problem.d), np.abs(problem.e), np.abs(problem.turns), pivots)

    def terms(factor: float) -> Any:
        return _flat(*_equations(data, (factor * of_dyads,), (factor * of_turns,), 1.0, np.abs))

    def bound(right: Any) -> Any:
        return np.max(np.einsum("bij,bj->bi", evidence.inverse, right) / weight, axis=1)

    off = bound(evidence.residual + fine * terms(1.01))
    bend = bound(2.0 * terms(2.0 + 2.0 * REACH))
    distance = np.max(evidence.moved / weight, axis=1)
    deviation = np.max(np.einsum("bij,bj->bi", evidence.deviation, weight) / weight, axis=1)
    shrink = deviation + bound(coarse * terms(2.02)) + distance * bend
    existence = 2.0 * off
    proven = good & (distance < REACH) & (existence < REACH) & (shrink + bend * existence < HALF)
    uniqueness = np.minimum(REACH, (HALF - shrink) / bend)
    proven &= existence < 0.01 * uniqueness
    real = proven & (np.max(evidence.apart / weight, axis=1) + 4.0 * existence + fine < 0.5 * uniqueness)
    return Certificate(roots, np.where(proven, existence, np.inf), np.where(proven, uniqueness, 0.0), real, shown)
