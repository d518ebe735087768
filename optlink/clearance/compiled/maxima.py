"""Maxima of penetrations, normal forces and torque over a step, between its ends as well as at them. Compiled by numba."""

from numba import njit

from optlink.clearance.compiled.dop853 import (
    CONSTANTS,
    HELPER,
    WATCH,
    call,
    copy,
    cubic_summit,
    inside,
    interpolant,
    servo_reference,
)
from optlink.clearance.compiled.switches import penetration, root

PARTS = 8
"""Parts of a step in which the maximum of a force is sought."""

REACH = 0.625
"""Share of a step times the slope at its end by which a maximum within it may exceed that end; 0.5 for a concave curve."""

EQUAL = 1e-13
"""Relative excess over a maximum that is neglected."""


@njit(**HELPER)
def quantity(w, j, gaps):
    """Value and slope of a watched quantity: normal force of gap j, or for j = gaps the magnitude of the torque.

    Parameters
    ----------
    w : array
        Forces, their rates, torque, its rate.
    j : int
        Index of the quantity.
    gaps : int
        Number of gaps.
    """
    if j < gaps:
        return w[j], w[gaps + j]
    torque, rate = w[2 * gaps], w[2 * gaps + 1]
    return (torque, rate) if torque >= 0.0 else (-torque, -rate)


@njit(**HELPER)
def _watched(time, share, f, y, n, model, p, x, out):
    """Forces, torque and their rates at a share of a step."""
    inside(share, f, y, n, x)
    servo_reference(time, model, p)
    call(model[WATCH], x, p, model[CONSTANTS], out)


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
    """Update the maxima of the selected forces and of the torque within a step, from its dense output."""
    _, f, _, _, x, _, _, _, _, nodes, first, last, selected, p = space
    for i in range(1, PARTS):
        _watched(time + i * h / PARTS, i / PARTS, f, y, n, model, p, x, nodes[i])
    copy(first, nodes[0])
    copy(last, nodes[PARTS])
    spare = nodes[PARTS + 1]
    for j in range(gaps + 1):
        if selected[j] == 0.0:
            continue
        place = gaps + j if j < gaps else 2 * gaps
        for i in range(PARTS + 1):
            peaks[place] = max(peaks[place], quantity(nodes[i], j, gaps)[0])
        for i in range(PARTS):
            v0, s0 = quantity(nodes[i], j, gaps)
            v1, s1 = quantity(nodes[i + 1], j, gaps)
            part = h / PARTS
            if not (s0 > 0.0 and s1 < 0.0 and cubic_summit(v0, v1, s0 * part, s1 * part) > peaks[place] * (1.0 + EQUAL)):
                continue
            low, high, a, b, side = i / PARTS, (i + 1) / PARTS, s0, s1, 0
            for r in range(40):
                at = 0.5 * (low + high) if r % 8 == 7 else low + a * (high - low) / (a - b)
                if not low < at < high or high - low < 1e-10:
                    break
                _watched(time + at * h, at, f, y, n, model, p, x, spare)
                value, slope = quantity(spare, j, gaps)
                peaks[place] = max(peaks[place], value)
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
    """Update the maxima of penetrations, forces and torque over a step; return whether its dense output is known then.

    Parameters
    ----------
    time : float [s]
        Time at the start of the step.
    h : float [s]
        Step size.
    parts : int
        Parts of the step.
    dense : bool
        Whether the dense output is known.
    modes : array (gaps,)
        1 in contact, 0 apart.
    contact : array (gaps,)
        Largest penetrations of the contacts [m].
    peaks : array (2 gaps + 1,)
        Maxima.
    y : array (m,)
        State and works at the start of the step.
    n : int
        Length of the state without the works.
    model : tuple
        See above.
    space : tuple of arrays
        See `motion.workspace`.
    """
    k, f, new, between, x, _, _, spare, nodes, _, first, last, selected, p = space
    gaps, some = modes.shape[0], False
    servo_reference(time + h, model, p)
    call(model[WATCH], new, p, model[CONSTANTS], last)
    for j in range(gaps + 1):
        selected[j] = 0.0
        if j < gaps and modes[j] == 0.0:
            continue
        place = gaps + j if j < gaps else 2 * gaps
        if _promising(first, last, j, gaps, h, peaks[place]):
            selected[j], some = 1.0, True
        peaks[place] = max(peaks[place], quantity(last, j, gaps)[0])
    turns = False
    for j in range(gaps):
        if modes[j] > 0.0:
            for i in range(parts):
                contact[j] = max(contact[j], nodes[i + 1, j])
                turns = turns or (nodes[i, gaps + j] > 0.0 and nodes[i + 1, gaps + j] < 0.0)
    if (some or turns) and not dense:
        interpolant(time, h, y, new, k, between, n, model, p, f)
        dense = True
    for j in range(gaps):
        if modes[j] > 0.0:
            for i in range(parts if turns else 0):
                if nodes[i, gaps + j] > 0.0 and nodes[i + 1, gaps + j] < 0.0:
                    top = root(i / parts, (i + 1) / parts, gaps + j, -1.0, f, y, n, model, p, x, spare)
                    penetration(top, f, y, n, model, p, x, spare)
                    contact[j] = max(contact[j], spare[j])
            peaks[j] = max(peaks[j], contact[j])
    if some:
        _force_peaks(time, h, y, n, gaps, model, space, peaks)
    return dense
