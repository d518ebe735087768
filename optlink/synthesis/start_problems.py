"""Generic problems of poses and points with all their four-bars, from which `homotopy` starts: stored data, and how to make them.

`python -m optlink.synthesis.start_problems` makes the file again, in some minutes: the displacements return on random loops in
the complex plane to where they began, and the four-bars that move along exchange their places, until all have been met.
"""

import itertools
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.synthesis.homotopy import LEAST, Problem, Roots, steps, track
from optlink.synthesis.pairs import Complex

FILE = Path(__file__).with_suffix(".npz")

NINE_POINTS, FIVE_POINTS = (1, 8), (1, 4)  # the latter with given pivots
COUNTS = {(4, 2): 30, (3, 4): 201, (2, 6): 1112, (1, 8): 1442, (1, 4): 36}
"""Four-bars of poses (with the first one) and further points; exchanged dyads, and cognates of nine points, count once."""

SAME = 1e-8  # relative difference of the marks of certified four-bars that count as one
LOOPS = 60  # at most
_PLACE = 0.3137 + 0.7721j  # any point that is a symmetric function's argument


def cognates(roots: Roots, problem: Problem) -> Roots:
    """Return four-bars and their two cognates of each (3 B), which trace the same curve (Roberts)."""
    found = [roots]
    for dyads in (roots.dyads, roots.dyads[:, ::-1]):
        (x, u), (y, v) = np.moveaxis(dyads.reshape(-1, 2, 2, 2), (1, 2), (0, 1))  # (B, 2): numbers and their conjugates
        crossed = np.stack([-y * u, -x * v], axis=1) / (y - x)[:, None]
        images = np.stack([np.stack([-u, -x], axis=1), crossed], axis=1).reshape(-1, 2, 4)
        found.append(Roots(images, (problem.d + roots.turns * x[:, :1]) / u[:, :1]))
    return Roots(np.concatenate([each.dyads for each in found]), np.concatenate([each.turns for each in found]))


def marks(dyads: Any, problem: Problem, plain: Callable[[Any], Any] = np.asarray) -> Any:
    """Return numbers (B, 2 or 3, 4) for each pivot, of nine points for those of all cognates, that an orbit has in common.

    They are the pivot, the product of its joint and its link, which is the same for both cognates that have this pivot, and their
    conjugates. The dyads may be numbers of any kind, of which `plain` makes arrays.
    """
    joints, links = dyads[:, :, :2], dyads[:, :, 2:]
    pivots, products = joints - links, joints * links
    (x, y), (a, b), (p, q) = ((each[:, 0], each[:, 1]) for each in (joints, pivots, products))
    pairs = [(a, p), (b, q)]
    if problem.kind == NINE_POINTS:
        pairs.append(((b * x - a * y) / (x - y), p * q / ((x - y) * (x - y))))
    return np.stack([np.concatenate([plain(pivot), plain(product)], axis=1) for pivot, product in pairs], axis=1)


def distinct(marked: Complex, same: float = SAME) -> list[int]:
    """Return the indices of the first four-bar of each orbit, by their marks (B, 2 or 3, 4) that differ relatively by `same`."""
    products = np.prod(marked[:, :, 0] - _PLACE, axis=1)  # whatever the order of the pivots
    kept: list[int] = []
    for k in range(len(marked)):
        others = np.array(kept, dtype=int)
        near = others[np.abs(products[others] - products[k]) <= 1e2 * same * np.abs(products[k])]
        if not np.all(np.isfinite(marked[k])):
            continue
        apart = np.abs(marked[near][:, :, None] - marked[k]) / np.maximum(np.abs(marked[k]), LEAST)
        if not np.any(np.all(np.any(np.all(apart <= same, axis=3), axis=2), axis=1)):
            kept.append(k)
    return kept


# --- stored problems ---------------------------------------------------------------------------------------------------------


def packed(dyads: Complex) -> NDArray[np.uint8]:
    """Return dyads with a precision of 1.5e-5: the three upper bytes of each number."""
    return dyads.view(float).astype(">f4").view(np.uint8).reshape(*dyads.shape, 2, 4)[..., :3]


def unpacked(data: NDArray[np.uint8]) -> Complex:
    """Return the dyads of packed ones."""
    full = np.concatenate([data, np.full((*data.shape[:-1], 1), 128, np.uint8)], axis=-1)
    numbers: Complex = full.view(">f4")[..., 0].astype(float).view(complex)[..., 0]
    return numbers


@cache
def stored(poses: int, points: int) -> tuple[Problem, Roots]:
    """Return a generic problem of a kind with one four-bar of each orbit."""
    name = f"{poses}+{points}"
    with np.load(FILE) as file:
        number = poses - 1 + points
        d, e, turns, pivots = np.split(file[name], [number, 2 * number, 2 * number + poses - 1])
        dyads = unpacked(file[f"{name} dyads"])
    problem = Problem(d, e, turns, pivots.reshape(2, 2) if len(pivots) else None)
    return problem, refined(problem, dyads)


def refined(problem: Problem, dyads: Complex) -> Roots:
    """Return four-bars at their end of Newton steps, with the rotations that their dyads have in common."""
    poses = len(problem.turns)
    if problem.pivots is not None:
        dyads = np.concatenate([dyads[..., :2], dyads[..., :2] - problem.pivots], axis=-1)
    x, xb, u, ub = np.moveaxis(dyads, 2, 0)[..., None]
    d, e = problem.d, problem.e
    square, rest = x * (ub + e - xb), d * ub + (u + d) * e  # of the equation times 1 + t
    linear = x * (ub + e) + d * ub + (u + d) * (e - xb)
    top = square[:, 0] * rest[:, 1] - square[:, 1] * rest[:, 0]
    turns = top / (square[:, 1] * linear[:, 0] - square[:, 0] * linear[:, 1])
    turns[:, :poses] = problem.turns
    for _ in range(6):
        by_dyads, by_turns = steps(dyads, turns, d, e, poses)
        dyads, turns = dyads + by_dyads, turns + by_turns
    return Roots(dyads, turns)


# --- monodromy ---------------------------------------------------------------------------------------------------------------


def monodromy(poses: int, points: int, seed: int = 0) -> tuple[Problem, Roots]:
    """Return a generic problem with all its four-bars, one of each orbit, from one four-bar with the displacements it allows."""
    rng, number = np.random.default_rng([poses, points, seed]), poses - 1 + points

    def normal(*shape: int) -> Complex:
        values: Complex = (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2.0)
        return values

    def turned(count: int) -> Complex:
        return np.asarray(np.exp(normal(count)) - 1.0, dtype=complex)

    def generic() -> Problem:
        return Problem(
            normal(number), normal(number), turned(poses - 1), normal(2, 2) if (poses, points) == FIVE_POINTS else None
        )

    dyads, turns = normal(2, 4), turned(number)
    x, xb, u, ub = dyads.T[..., None]
    far, away = turns * x, -turns * xb / (1.0 + turns)
    p, q, r = u + far, ub + away, far * ub + u * away + far * away  # d e + p e + q d + r = 0
    one, other, rest = p[0] - p[1], q[0] - q[1], r[0] - r[1]
    half = 0.5 * (q[0] - p[0] * other / one - rest / one) * one / other
    d = half + np.sqrt(half**2 + (r[0] - p[0] * rest / one) * one / other)
    base = generic()
    at = Problem(d, -(d * other + rest) / one, turns[: poses - 1], None if base.pivots is None else dyads[:, :2] - dyads[:, 2:])
    found, _ = track(Roots(dyads[None], turns[None]), at, base)
    for loop in range(LOOPS):
        corners, moved = [base, generic(), generic(), base], found
        for begin, end in itertools.pairwise(corners):
            moved, reached = track(moved, begin, end)
            moved = moved[reached >= 1.0]
        both = Roots(np.concatenate([found.dyads, moved.dyads]), np.concatenate([found.turns, moved.turns]))
        found = both[distinct(marks(both.dyads, base), 1e-5)]
        print(f"{poses} poses + {points} points: {len(found)} after {loop + 1} loops", file=sys.stderr)
        if len(found) == COUNTS[poses, points]:
            break
    return base, found


def main() -> None:
    """Make the file of generic problems."""
    data: dict[str, NDArray[Any]] = {}
    for poses, points in COUNTS:
        problem, roots = monodromy(poses, points)
        pivots = [] if problem.pivots is None else [problem.pivots.ravel()]
        data[f"{poses}+{points}"] = np.concatenate([problem.d, problem.e, problem.turns, *pivots])
        data[f"{poses}+{points} dyads"] = packed(roots.dyads)
    np.savez_compressed(FILE, **data)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
