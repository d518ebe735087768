"""Maxima of penetrations, normal forces and torque over a step, between its ends as well as at them. Compiled by numba.

Watched quantities are the normal forces of the gaps and, after them, the magnitude of the torque. In `peaks` the largest
penetrations stand before their maxima.
"""

from numba import njit

from optlink.clearance.compiled.dop853 import (
    FIRST,
    FORCES,
    HELPER,
    LAST,
    NEW,
    NODES,
    SELECTED,
    SPARE,
    STATE,
    copy,
    cubic_summit,
    forces,
    inside,
    interpolant,
)
from optlink.clearance.compiled.switches import penetrations_at, root

PARTS = 8
"""Parts of a step in which the maximum of a force is sought."""

REACH = 0.625
"""Share of a step times the slope at its end by which a maximum within it may exceed that end; 0.5 for a concave curve."""

EQUAL = 1e-13
"""Relative excess over a maximum that is neglected."""


@njit(**HELPER)
def quantity(w, j, gaps):
    """Value and slope of watched quantity j, from forces, their rates, torque and its rate."""
    if j < gaps:
        return w[j], w[gaps + j]
    torque, rate = w[2 * gaps], w[2 * gaps + 1]
    return (torque, rate) if torque >= 0.0 else (-torque, -rate)


@njit(**HELPER)
def _promising(first, last, j, gaps, h, best):
    """Whether a quantity may exceed its maximum within a step: bound and cubic from values and slopes at both ends."""
    v0, s0 = quantity(first, j, gaps)
    v1, s1 = quantity(last, j, gaps)
    high, cubic = max(v0, v1), cubic_summit(v0, v1, s0 * h, s1 * h)
    if s0 >= 0.0 and s1 >= 0.0 and v1 >= v0:  # it rises all the way: a step is shorter than half a vibration
        return cubic > high * (1.0 + 1e-3) and high > best
    bound = high + REACH * h * max(abs(s0), abs(s1))
    if min(v0, v1) > 0.5 * bound:
        bound = min(bound, cubic + 0.2 * (bound - high))
    return bound > best * (1.0 + EQUAL)


@njit(**HELPER)
def _force_peaks(time, h, y, n, gaps, model, space, peaks):
    """Update the maxima of the selected quantities within a step, from its dense output: by the Illinois method on the slope."""
    nodes, selected, part = space[FORCES], space[SELECTED], h / PARTS
    for i in range(1, PARTS):
        inside(i / PARTS, y, n, space)
        forces(time + i * h / PARTS, space[STATE], model, space, nodes[i])
    copy(space[FIRST], nodes[0])
    copy(space[LAST], nodes[PARTS])
    spare = nodes[PARTS + 1]
    for j in range(gaps + 1):
        if selected[j] == 0.0:
            continue
        for i in range(PARTS + 1):
            peaks[gaps + j] = max(peaks[gaps + j], quantity(nodes[i], j, gaps)[0])
        for i in range(PARTS):
            v0, s0 = quantity(nodes[i], j, gaps)
            v1, s1 = quantity(nodes[i + 1], j, gaps)
            if not (s0 > 0.0 and s1 < 0.0 and cubic_summit(v0, v1, s0 * part, s1 * part) > peaks[gaps + j] * (1.0 + EQUAL)):
                continue
            low, high, a, b, side = i / PARTS, (i + 1) / PARTS, s0, s1, 0
            for r in range(40):
                at = 0.5 * (low + high) if r % 8 == 7 else low + a * (high - low) / (a - b)
                if not low < at < high or high - low < 1e-10:
                    break
                inside(at, y, n, space)
                forces(time + at * h, space[STATE], model, space, spare)
                value, slope = quantity(spare, j, gaps)
                peaks[gaps + j] = max(peaks[gaps + j], value)
                if abs(slope) * h < 1e-12 * value:
                    break
                if slope > 0.0:
                    low, a = at, slope
                    b *= 0.5 if side == 1 else 1.0
                    side = 1
                else:
                    high, b = at, slope
                    a *= 0.5 if side == -1 else 1.0
                    side = -1


@njit(**HELPER)
def maxima(time, h, parts, dense, modes, contact, peaks, y, n, model, space):
    """Update the largest penetrations of the contacts and all maxima over a step; return whether its dense output is known then.

    `dense`: whether it is known before.
    """
    nodes, spare, last, selected = space[NODES], space[SPARE], space[LAST], space[SELECTED]
    gaps, some, turns = modes.shape[0], False, False
    forces(time + h, space[NEW], model, space, last)
    for j in range(gaps + 1):
        selected[j] = 0.0
        if j == gaps or modes[j] > 0.0:
            if _promising(space[FIRST], last, j, gaps, h, peaks[gaps + j]):
                selected[j], some = 1.0, True
            peaks[gaps + j] = max(peaks[gaps + j], quantity(last, j, gaps)[0])
    for j in range(gaps):
        if modes[j] > 0.0:
            for i in range(parts):
                contact[j] = max(contact[j], nodes[i + 1, j])
                turns = turns or (nodes[i, gaps + j] > 0.0 and nodes[i + 1, gaps + j] < 0.0)
    if (some or turns) and not dense:
        interpolant(time, h, y, n, model, space)
        dense = True
    for j in range(gaps):
        if modes[j] > 0.0:
            for i in range(parts):
                if nodes[i, gaps + j] > 0.0 and nodes[i + 1, gaps + j] < 0.0:
                    top = root(i / parts, (i + 1) / parts, gaps + j, -1.0, y, n, model, space)
                    penetrations_at(top, y, n, model, space, spare)
                    contact[j] = max(contact[j], spare[j])
            peaks[j] = max(peaks[j], contact[j])
    if some:
        _force_peaks(time, h, y, n, gaps, model, space, peaks)
    return dense
