"""Switches of the contacts within a step: where a penetration changes its sign, on the dense output. Compiled by numba.

A gap switches where its penetration, with the sign `side` (1 apart, -1 in contact), rises through zero.
"""

from numba import njit

from optlink.clearance.compiled.dop853 import (
    HELPER,
    NEW,
    NODES,
    NOW,
    SPARE,
    STATE,
    attempt,
    copy,
    inside,
    interpolant,
    penetrations,
)

SUBINTERVALS = 32
"""Most parts of a step that are examined for contacts, each no longer than a row: bounds the step."""


@njit(**HELPER)
def penetrations_at(share, y, n, model, space, out):
    """Evaluate the penetrations and their rates within a step."""
    inside(share, y, n, space)
    penetrations(space[STATE], model, space, out)


@njit(**HELPER)
def root(low, high, place, sign, y, n, model, space):
    """Where a penetration or rate with this sign rises through zero: not positive at share `low`, positive at share `high`.

    `place` is its index among penetrations and rates. Illinois method (Dowell and Jarratt, 1971): a false position that halves
    the value of an end which stays twice; every eighth step bisects.
    """
    out = space[SPARE]
    penetrations_at(low, y, n, model, space, out)
    a, rates = sign * out[place], place + out.shape[0] // 2
    if a >= 0.0 and (rates >= out.shape[0] or sign * out[rates] > 0.0):
        return low
    begin = low
    for i in range(20, 0, -1):  # a gap that has just switched returns first
        if a < 0.0:
            break
        low = begin + (high - begin) * 0.5**i
        penetrations_at(low, y, n, model, space, out)
        a = sign * out[place]
    if a >= 0.0:
        return begin
    penetrations_at(high, y, n, model, space, out)
    b, side = sign * out[place], 0
    for i in range(60):
        if high - low <= 1e-13:
            break
        at = low - a * (high - low) / (b - a)
        if i % 8 == 7 or not low < at < high:
            at = 0.5 * (low + high)
        penetrations_at(at, y, n, model, space, out)
        value = sign * out[place]
        if value > 0.0:
            if value < 1e-17 and i > 2:
                return at
            high, b = at, value
            a *= 0.5 if side == 1 else 1.0
            side = 1
        elif value < 0.0:
            low, a = at, value
            b *= 0.5 if side == -1 else 1.0
            side = -1
        else:
            return at
    return high


@njit(**HELPER)
def examine(time, h, step, y, n, model, space):
    """Divide a step into parts no longer than a row, and evaluate penetrations and rates at their ends; return their number.

    The dense output is known then if there are several.
    """
    parts = 1 if h <= step * (1.0 + 1e-9) else min(SUBINTERVALS, int(h / step * (1.0 - 1e-12)) + 1)
    nodes = space[NODES]
    copy(space[NOW], nodes[0])
    penetrations(space[NEW], model, space, nodes[parts])
    if parts > 1:
        interpolant(time, h, y, n, model, space)
    for i in range(1, parts):
        penetrations_at(i / parts, y, n, model, space, nodes[i])
    return parts


@njit(**HELPER)
def first_switch(time, h, parts, modes, y, n, model, space):
    """Share of the step at which the first gap switches; that gap, or -1; and whether the dense output is known then."""
    nodes, spare = space[NODES], space[SPARE]
    gaps, first, switch, dense, part = modes.shape[0], 2.0, -1, parts > 1, h / parts
    for i in range(parts):
        for j in range(gaps):
            side = 1.0 - 2.0 * modes[j]
            y0, s0 = side * nodes[i, j], side * nodes[i, gaps + j]
            y1, s1 = side * nodes[i + 1, j], side * nodes[i + 1, gaps + j]
            turns = s0 > 0.0 and s1 < 0.0 and max(y0 + 0.5 * part * s0, y1 - 0.5 * part * s1) > 0.0
            if not (y1 > 0.0 or turns):
                continue
            if not dense:
                interpolant(time, h, y, n, model, space)
                dense = True
            low, high = i / parts, (i + 1) / parts
            if not y1 > 0.0:  # beyond zero at most where it turns
                high = root(low, high, gaps + j, -side, y, n, model, space)
                penetrations_at(high, y, n, model, space, spare)
                if not side * spare[j] > 0.0:
                    continue
            at = root(low, high, j, side, y, n, model, space)
            if at < first:
                first, switch = at, j
        if switch >= 0:
            break
    return first, switch, dense


@njit(**HELPER)
def to_switch(time, length, most, gap, side, y, n, model, space):
    """Repeat a step of size `most` with the time until a gap switches: Newton's method from the estimate `length`; return it."""
    new, then = space[NEW], space[SPARE]
    for i in range(8):
        attempt(time, length, y, n, model, space)
        penetrations(new, model, space, then)
        slope = side * then[then.shape[0] // 2 + gap]
        rest = -side * then[gap] / slope if slope > 0.0 else 0.0
        if not abs(rest) < 0.01 * most or abs(rest) <= 1e-14 * (time + length) or length + rest <= 0.0 or i == 7:
            break
        length += rest
    return length
