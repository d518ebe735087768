"""Random starting points of path synthesis: proportions that can turn and timing along the points."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.inner_four_bar import InnerFourBar, inner_four_bars
from optlink.linkage.vector2d import TURN, Array, unit
from optlink.optimization.programme import path_variable
from optlink.problem.design import STEP
from optlink.synthesis.batch import Batch

SPREAD = 0.35  # relative standard deviation of a dimension about its value in the file


def random_designs(batch: Batch, count: int, rng: np.random.Generator) -> Array:
    """Return random design variables (count, n), scaled and within their bounds."""
    problem = batch.problem
    n = len(batch.names)
    x = np.empty((count, n))
    for i, name in enumerate(batch.names):
        quantity = problem.quantities[name]
        low, high = batch.low[i], batch.high[i]
        if quantity.kind == "angle":
            most = min(high, low + TURN) if problem.is_periodic(name) else high
            x[:, i] = rng.uniform(low, most, count) if low < most else low
        elif problem.four_bar is not None:
            x[:, i] = rng.standard_normal(count) * 1.5
        else:
            fixed = (quantity.value - batch.origin[i]) / batch.scale[i]
            size = max(abs(fixed), 0.1)
            near = fixed + size * SPREAD * rng.standard_normal(count)
            wide = rng.uniform(np.maximum(low, fixed - 3.0 * size), np.minimum(high, fixed + 3.0 * size), count)
            x[:, i] = np.where(rng.random(count) < 0.6, near, wide)
    if problem.four_bar is not None:
        _proportioned(batch, problem.four_bar, x, rng)
    else:
        _turning(batch, x, rng)
    return np.clip(x, batch.low, batch.high)


def _turning(batch: Batch, x: Array, rng: np.random.Generator) -> None:
    """Give half of the designs (count, n) a four-bar whose crank can turn, if all dimensions of the first one are free."""
    loop = next(inner_four_bars(batch.problem.linkage), None)
    if loop is None or not loop.plain or not batch.crank_turns or not {*loop.names, *loop.ground} <= set(batch.names):
        return
    half = x[: len(x) // 2]
    frame = _sized(batch, loop, half, rng)
    direction = rng.uniform(0.0, TURN, len(half))
    half[:, [batch.names.index(name) for name in loop.ground[:2]]] = rng.standard_normal((2, len(half))).T * 1.5
    _spaced(batch, loop, half, frame, direction)


def _proportioned(batch: Batch, loop: InnerFourBar, x: Array, rng: np.random.Generator) -> None:
    """Give the designs (count, n) random lengths of the four-bar that they are; the frame has any direction, or lies along x."""
    frame = _sized(batch, loop, x, rng)
    if not loop.frame_length:
        tilts = {loop.ground[1], loop.ground[3]} & set(batch.names)
        _spaced(batch, loop, x, frame, rng.uniform(0.0, TURN, len(x)) if tilts else np.zeros(len(x)))


def _sized(batch: Batch, loop: InnerFourBar, x: Array, rng: np.random.Generator) -> Array:
    """Give the designs (count, n) random lengths of a four-bar, where they are free; return that of the frame (count,)."""
    shape = _random_lengths(batch, len(x), rng)
    for k, name in enumerate((*loop.names, loop.frame_length)):
        if name in batch.names:
            x[:, batch.names.index(name)] = shape[:, k]
    return shape[:, 3]


def _spaced(batch: Batch, loop: InnerFourBar, x: Array, frame: Array, direction: Array) -> None:
    """Move the rocker pivots of the designs (count, n), or the crank pivots if they are fixed, to the lengths of the frame."""
    names, quantities = batch.names, batch.problem.quantities
    for axis, way in enumerate((np.cos(direction), np.sin(direction))):
        pair = [loop.ground[axis], loop.ground[axis + 2]]
        one, other = (
            x[:, names.index(name)] if name in names else path_variable(batch.problem, name).scaled(quantities[name].value)
            for name in pair
        )
        if pair[1] in names:
            x[:, names.index(pair[1])] = one + frame * way
        elif pair[0] in names:
            x[:, names.index(pair[0])] = other - frame * way


def _random_lengths(batch: Batch, count: int, rng: np.random.Generator) -> Array:
    """Return lengths of random four-bars (count, 4) of different sizes."""
    return random_proportions(batch, count, rng) * np.exp(rng.uniform(math.log(0.5), math.log(4.0), (count, 1)))


def random_proportions(batch: Batch, count: int, rng: np.random.Generator) -> Array:
    """Return random lengths of crank, coupler, rocker and frame (count, 4), relative to the frame.

    The lengths of all crank-rockers are crank a, coupler a + v + w, rocker a + u + w, frame a + u + v with a, u, v, w > 0:
    each of Grashof's sums has one of these numbers, twice, as its slack. In a double-crank crank and frame are interchanged.
    """
    crank = batch.problem.limits.crank
    if crank == "span":
        lengths = np.exp(rng.uniform(math.log(0.2), math.log(3.0), (count, 4)))
    else:
        a, u, v, w = np.where(
            rng.random(count) < 0.7, rng.exponential(size=(4, count)), np.exp(1.7 * rng.standard_normal((4, count)))
        )
        lengths = np.stack([a, a + v + w, a + u + w, a + u + v], axis=1)
        if crank == "double-crank":
            lengths = lengths[:, [3, 1, 2, 0]]
    return lengths / lengths[:, 3:]


def random_crank_angles(batch: Batch, count: int, rng: np.random.Generator) -> Array:
    """Return random crank angles (count, points) [rad] in order, with steps that loosely follow the distances of the points.

    Zeros with prescribed timing.
    """
    problem, points = batch.problem, batch.data.columns[:, :2]
    number = len(points)
    if not batch.free_timing:
        return np.zeros((count, number))
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if problem.closed:
        chords = np.append(chords, np.linalg.norm(points[0] - points[-1]))
    chords = chords / max(float(np.mean(chords)), 1e-300) + 1e-3
    noise = 0.4 * min(1.0, math.sqrt(9.0 / number))
    steps = chords ** rng.uniform(0.0, 1.0, (count, 1)) * np.exp(noise * rng.standard_normal((count, len(chords))))
    if problem.closed and problem.meets_again:
        steps[:, -1] = 0.0
    span = np.full((count, 1), TURN) if problem.closed else TURN * rng.uniform(0.1, 0.97, (count, 1))
    steps = np.maximum(steps / steps.sum(axis=1, keepdims=True) * span, 2.0 * STEP * (steps > 0.0))
    rotation = problem.rotation
    way = {"counter-clockwise": 1.0, "clockwise": -1.0}.get(rotation)
    ways = np.where(rng.random((count, 1)) < 0.5, 1.0, -1.0) if way is None else np.full((count, 1), way)
    turned = np.concatenate([np.zeros((count, 1)), np.cumsum(steps[:, : number - 1], axis=1)], axis=1)
    return np.asarray(rng.uniform(-math.pi, math.pi, (count, 1)) + ways * turned, dtype=float)


def within_reach(batch: Batch, x: Array, t: Array, rng: np.random.Generator) -> Array:
    """Shift and shorten crank angles of four-bars without full rotation to the range where they can be assembled."""
    loop = batch.problem.four_bar
    if batch.crank_turns or loop is None or not batch.free_timing:
        return t
    values = batch.values(x)
    crank, coupler, rocker, frame = (length[:, 0] for length in loop.lengths(values))
    turned = loop.turned(values)
    square, twice = crank**2 + frame**2, 2.0 * crank * frame
    near = np.arccos(np.clip((square - (coupler - rocker) ** 2) / twice, -1.0, 1.0))  # at smaller angles B is too near to D
    far = np.arccos(np.clip((square - (coupler + rocker) ** 2) / twice, -1.0, 1.0))  # at larger angles B is too far from D
    mirrored = rng.random(len(x)) < 0.5
    low = np.where(near <= 0.0, -far, np.where(far >= math.pi, near, np.where(mirrored, -far, near)))
    high = np.where(near <= 0.0, far, np.where(far >= math.pi, TURN - near, np.where(mirrored, -near, far)))
    span = np.abs(t[:, -1] - t[:, 0])
    room = 0.98 * (high - low)
    share = np.minimum(1.0, room * rng.uniform(0.3, 1.0, len(x)) / np.maximum(span, 1e-9))
    begin = low + 0.01 * (high - low) + rng.random(len(x)) * np.maximum(room - share * span, 0.0)
    least = np.minimum(t[:, 0], t[:, -1])
    limited = (near > 0.0) | (far < math.pi)
    moved = turned + begin[:, None] + (t - least[:, None]) * share[:, None]
    return np.where(limited[:, None], moved, t)


def assembles_everywhere(batch: Batch, x: Array, t: Array) -> NDArray[np.bool_]:
    """Return which designs can be assembled at all points, and over the whole revolution if the crank must turn."""
    mechanism, values = batch.problem.linkage, batch.values(x)
    angles = batch.crank_angles(x, t)
    with np.errstate(all="ignore"):
        angle_sets = [angles]
        if batch.crank_turns and batch.problem.four_bar is None:
            angle_sets.append(np.broadcast_to(batch.angles, (len(x), len(batch.angles))))
        assembled = np.ones(len(x), dtype=bool)
        for at in angle_sets:
            pose = mechanism.pose(values, unit(at))
            for group in mechanism.groups:
                margin = np.broadcast_to(pose.margins[group.joint], at.shape)
                assembled &= np.all(margin > group.least, axis=1)
    return assembled
