"""Motion of a machine with joint clearance over rows: steps, switches of the contacts, and maxima, compiled by numba.

Between two switches the modes are constant. On the dense output of a step the penetrations are examined at intervals of at most
a row: a penetration that changes its sign is a switch, and one that rises and falls again has its summit located. At a switch the
step is repeated with exactly the time until it, corrected by Newton's method on the motion itself, so a switch has order 8.

`machine.py` imports this file from the cache folder, under the hash of all that it is compiled from.
"""

from math import cos, sin, sqrt
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from optlink.dynamics.runge_kutta import COEFFICIENTS, EXPONENT, LEAST, MOST, SAFETY, STAGES
from optlink.linkage.vector2d import Array

# One step of an explicit Runge-Kutta method of order 8, with error estimate and dense output of order 7, compiled by numba.
#
# The compiled functions of all modules take these arguments:
#
# =============  =================================================================================================== `model`
# addresses of the compiled functions (x, p, c, o) of a machine, see `machine.py`; their constants c;
#                start and speed of the servo reference, and its harmonics `space`        intermediate arrays and parameters p of
# a call, see `motion.workspace` `time`, `h`    time at the start of the step, and its size [s] `y`, `n`       coordinates, rates
# and works at the start of the step (m,); the state without the works is the first n `share`        place within the step, 0 to
# 1 `parts`        number of the parts of the step at whose ends penetrations are known =============
# ===================================================================================================
#
# The parameters are the feedback correction; angle, speed and acceleration of the reference; the approach speeds of the gaps and
# their modes.
#
# References
# ---------- E. Hairer, S. P. Norsett, G. Wanner: Solving Ordinary Differential Equations I, 2nd ed. 1993, sections II.5 (error
# estimate of orders 5 and 3 combined) and II.6 (dense output). The coefficients are those of their code DOP853.

A, C, E5, E3, D = COEFFICIENTS
POWERS = 7  # of the dense output
ABSOLUTE = 1e-3
"""Absolute tolerance as a share of the relative one [SI]."""

RHS, GAPS, WATCH, PROJECT, CONSTANTS, REFERENCE, HARMONICS = range(7)
"""Places in `model`."""

SLOPES, DENSE, NEW, BETWEEN, STATE, NOW, NODES, SPARE, FORCES, FIRST, LAST, SELECTED, PARAMETERS = range(13)
"""Places in `space`."""

ENTRY: Any = {"error_model": "numpy", "_nrt": False}
"""Options of a function that Python calls: no function allocates, so none counts references."""

HELPER: Any = {**ENTRY, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of functions that are called by compiled functions only."""


def _generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    pointer = ir.DoubleType().as_pointer()
    kind = ir.FunctionType(ir.VoidType(), [pointer] * 4)
    arrays = zip(signature.args[1:], values[1:], strict=True)
    data = [context.make_array(each)(context, builder, value).data for each, value in arrays]
    builder.call(builder.inttoptr(values[0], kind.as_pointer()), data)
    return context.get_dummy_value()


@intrinsic  # type: ignore[untyped-decorator, unused-ignore]
def _call(typing: Any, address: Any, x: Any, p: Any, c: Any, o: Any) -> Any:
    """Call the compiled function at an address with the data of four arrays."""
    return types.void(address, x, p, c, o), _generate


call: Any = _call


@njit(**HELPER)
def copy(source, target):
    """Copy one array to another."""
    for i in range(source.shape[0]):
        target[i] = source[i]


@njit(**HELPER)
def servo_reference(time, model, space):
    """Write angle, speed and acceleration of the servo reference to the parameters, as `ReferenceSignal.at` defines them."""
    harmonics, p = model[HARMONICS], space[PARAMETERS]
    start, speed = model[REFERENCE][0], model[REFERENCE][1]
    angle, rate, twice = start + speed * time, speed, 0.0
    base = abs(speed)
    one_c, one_s = cos(base * time), sin(base * time)
    c, s = 1.0, 0.0
    for k in range(harmonics.shape[0]):
        w, re, im = k * base, harmonics[k, 0], harmonics[k, 1]
        along, across = re * c - im * s, re * s + im * c
        angle += along
        rate -= w * across
        twice -= w * w * along
        c, s = c * one_c - s * one_s, s * one_c + c * one_s
    p[1], p[2], p[3] = angle, rate, twice


@njit(**HELPER)
def evaluate(time, x, model, space, slopes):
    """Evaluate the rates of the state and the powers at a time."""
    servo_reference(time, model, space)
    call(model[RHS], x, space[PARAMETERS], model[CONSTANTS], slopes)


@njit(**HELPER)
def penetrations(x, model, space, out):
    """Evaluate the penetrations of the gaps and their rates."""
    call(model[GAPS], x, space[PARAMETERS], model[CONSTANTS], out)


@njit(**HELPER)
def forces(time, x, model, space, out):
    """Evaluate the normal forces of the gaps, their rates, the torque and its rate at a time."""
    servo_reference(time, model, space)
    call(model[WATCH], x, space[PARAMETERS], model[CONSTANTS], out)


@njit(**HELPER)
def project(x, model, space, out):
    """Move a state onto the closing joints, from which it drifts by the error of the integration."""
    call(model[PROJECT], x, space[PARAMETERS], model[CONSTANTS], out)


@njit(**HELPER)
def combine(row, y, h, n, space, out):
    """Add h times the slopes, weighted by a row of the coefficients A, to the first n of a state."""
    slopes = space[SLOPES]
    for i in range(n):
        out[i] = y[i]
    for j in range(row):
        a = A[row, j]
        if a != 0.0:
            a *= h
            for i in range(n):
                out[i] += a * slopes[j, i]


@njit(**HELPER)
def attempt(time, h, y, n, model, space):
    """Take one step from y to the new state: stages 1 to 12, of which stage 0 is known."""
    for s in range(1, STAGES + 1):
        at = space[NEW] if s == STAGES else space[BETWEEN]
        combine(s, y, h, y.shape[0] if s == STAGES else n, space, at)
        evaluate(time + C[s] * h, at, model, space, space[SLOPES][s])


@njit(**HELPER)
def error_of(y, h, tolerance, space):
    """Return the estimated error of a step as a share of the relative tolerance (Hairer et al., II.5, equation 10.17)."""
    new, slopes = space[NEW], space[SLOPES]
    fifth, third = 0.0, 0.0
    for i in range(y.shape[0]):
        e5, e3 = 0.0, 0.0
        for j in range(STAGES + 1):
            e5 += slopes[j, i] * E5[j]
            e3 += slopes[j, i] * E3[j]
        scale = tolerance * (ABSOLUTE + max(abs(y[i]), abs(new[i])))
        fifth += (e5 / scale) ** 2
        third += (e3 / scale) ** 2
    if fifth == 0.0 and third == 0.0:
        return 0.0
    return abs(h) * fifth / sqrt((fifth + 0.01 * third) * y.shape[0])


@njit(**HELPER)
def change_of(error):
    """Return the factor of the next step size."""
    if not error < 1e300:
        return 0.1
    return MOST if error == 0.0 else min(MOST, max(LEAST, SAFETY * error**EXPONENT))


@njit(**HELPER)
def interpolant(time, h, y, n, model, space):
    """Compute the dense output of a step: its coefficients (7, m)."""
    slopes, f, new = space[SLOPES], space[DENSE], space[NEW]
    for s in range(STAGES + 1, STAGES + 4):
        combine(s, y, h, n, space, space[BETWEEN])
        evaluate(time + C[s] * h, space[BETWEEN], model, space, slopes[s])
    for i in range(y.shape[0]):
        over = new[i] - y[i]
        f[0, i] = over
        f[1, i] = h * slopes[0, i] - over
        f[2, i] = 2.0 * over - h * (slopes[STAGES, i] + slopes[0, i])
        for r in range(POWERS - 3):
            total = 0.0
            for j in range(STAGES + 4):
                total += D[r, j] * slopes[j, i]
            f[3 + r, i] = h * total


@njit(**HELPER)
def inside(share, y, n, space):
    """Evaluate the first n of the state within the step, on the dense output."""
    f, x, rest = space[DENSE], space[STATE], 1.0 - share
    for i in range(n):
        value = f[POWERS - 1, i] * share
        for r in range(POWERS - 2, -1, -1):
            value = (value + f[r, i]) * (rest if (POWERS - 1 - r) % 2 else share)
        x[i] = y[i] + value


@njit(**HELPER)
def cubic_summit(y0, y1, a, b):
    """Return the maximum of the cubic with values y0, y1 and slopes a, b (per interval) at its ends."""
    p, q = a + b - 2.0 * (y1 - y0), 3.0 * (y1 - y0) - 2.0 * a - b
    below = sqrt(max(q * q - 3.0 * p * a, 0.0)) - q
    best = max(y0, y1)
    if below > 0.0:
        u = min(max(a / below, 0.0), 1.0)
        best = max(best, y0 + u * (a + u * (q + u * p)))
    return best


# Switches of the contacts within a step: where a penetration changes its sign, on the dense output. Compiled by numba.
#
# A gap switches where its penetration, with the sign `side` (1 apart, -1 in contact), rises through zero.

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


# Maxima of penetrations, normal forces and torque over a step, between its ends as well as at them. Compiled by numba.
#
# Watched quantities are the normal forces of the gaps and, after them, the magnitude of the torque. In `peaks` the largest
# penetrations stand before their maxima.

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


START = 0.05
"""Share of a row that is the first trial step at the start of a contact."""

DONE, FULL, PAUSED, STUCK, DEEP, BUSY, INFINITE = range(7)
"""Why a call ended."""

AHEAD, TRIAL, REJECTED, SWITCHED = range(4)
"""Places in `clock`: time since the last row [s], next step size [s], steps rejected in turn, switches since the last row."""

GAP, BEGINS, TIME, ANGLE, RATE, DEPTH = range(6)
"""Columns of `events`: gap, 1 begin or 0 end, time [s], crank angle [rad], rate of the penetration [m/s], the largest one [m]."""


def workspace(n: int, m: int, gaps: int) -> tuple[Array, ...]:
    """Return the arrays `space` of `advance`, which allocates nothing.

    In the order of their places: slopes of the stages; coefficients of the dense output; state and works at the end of the step,
    at an intermediate time, and on the dense output; penetrations and rates now, at the ends of the parts of the step, and
    elsewhere; forces and torque with their rates at places of the step, at its start, and at its end; which of them may have a
    maximum within it; parameters.
    """
    w, q = 2 * gaps, 2 * gaps + 2
    sizes = [(STAGES + 4, m), (POWERS, m), m, m, m, w, (SUBINTERVALS + 1, w), w, (PARTS + 2, q), q, q, gaps + 1, 4 + w]
    return tuple(np.zeros(size) for size in sizes)


@njit(cache=True, **ENTRY)
def advance(
    model, closing, n, row, step, tolerance, driven, limits, most_steps, most_switches, slowest,
    y, clock, contact, peaks, space, out, out_contacts, events,
):  # fmt: skip
    """Integrate the rows of `out`; return why it ended, and the numbers of rows and events written.

    Parameters
    ----------
    closing : int
        Number of closing equations.
    n : int
        Length of the state without the works.
    row : int
        Number of the row at which the call begins.
    step, tolerance : float
        Time between rows [s]; relative tolerance.
    driven : int
        Index of the crank angle.
    limits : array (gaps,)
        Penetrations [m] that end the motion.
    most_steps, most_switches : int
        Steps of a call, and switches within a row.
    slowest : float
        Least approach speed [m/s].
    y, clock, contact, peaks, space : arrays, changed in place
        State and works; see AHEAD; largest penetrations of the contacts; maxima; intermediate arrays and parameters.
    out, out_contacts, events : arrays
        Results: states and works, approach speeds and modes of the gaps at the rows; switches.
    """
    p, now, first, new, x, between = space[PARAMETERS], space[NOW], space[FIRST], space[NEW], space[STATE], space[BETWEEN]
    gaps, rows = contact.shape[0], out.shape[0]
    entered, modes = p[4 : 4 + gaps], p[4 + gaps :]
    begin, end = row * step, rows * step
    t, h, done, written, steps = clock[AHEAD], clock[TRIAL], 0, 0, 0
    fresh, status = True, DONE
    while done < rows:
        if fresh:  # after a switch, and at the start
            evaluate(begin + t, y, model, space, space[SLOPES][0])
            penetrations(y, model, space, now)
            forces(begin + t, y, model, space, first)
            for j in range(gaps + 1):
                if j == gaps or modes[j] > 0.0:
                    peaks[gaps + j] = max(peaks[gaps + j], quantity(first, j, gaps)[0])
            fresh = False
        if steps >= most_steps:
            status = PAUSED
            break
        steps += 1
        switch = -1
        for j in range(gaps):  # another gap that has switched at the same instant
            side = 1.0 - 2.0 * modes[j]
            if side * now[j] > 0.0 and side * now[gaps + j] > 0.0:
                switch = j
        if switch < 0:
            h = min(h if h > 0.0 else START * step, SUBINTERVALS * step)
            trial, whole = h, t + h * (1.0 + 1e-9) >= end
            if whole:
                h = end - t
            attempt(begin + t, h, y, n, model, space)
            error = error_of(y, h, tolerance, space)
            if not error <= 1.0:
                h *= change_of(error)
                clock[REJECTED] += 1.0
                if (clock[REJECTED] > 100.0 and h < 1e-13 * step) or h < 1e-16 * (begin + t):
                    status = STUCK if error == error else INFINITE
                    break
                continue
            clock[REJECTED] = 0.0
            after = h * change_of(error)
            if whole:
                after = max(after, trial)
            parts = examine(begin + t, h, step, y, n, model, space)
            share, switch, dense = first_switch(begin + t, h, parts, modes, y, n, model, space)
            if switch >= 0:
                length = to_switch(begin + t, share * h, h, switch, 1.0 - 2.0 * modes[switch], y, n, model, space)
                after, h, whole = max(after, h), length, False
                parts = examine(begin + t, h, step, y, n, model, space)
                dense = parts > 1
            dense = maxima(begin + t, h, parts, dense, modes, contact, peaks, y, n, model, space)
            later = end if whole else t + h
            while done < rows and ((done + 1) * step <= later or (whole and done + 1 == rows)):
                at = (done + 1) * step
                if at >= later:
                    copy(new, x)
                else:
                    if not dense:
                        interpolant(begin + t, h, y, n, model, space)
                        dense = True
                    inside((at - t) / h, y, y.shape[0], space)
                copy(x, out[done])
                if closing:
                    project(x, model, space, out[done])
                copy(p[4:], out_contacts[done])
                done += 1
                clock[SWITCHED] = 0.0
            t, h = later, after
            copy(new, y)
            copy(space[SLOPES][STAGES], space[SLOPES][0])
            copy(space[NODES][parts], now)
            copy(space[LAST], first)
            if closing:
                project(new, model, space, between)
                copy(between[:n], y)
                evaluate(begin + t, y, model, space, space[SLOPES][0])
                penetrations(y, model, space, now)
            for j in range(gaps):
                if now[j] > limits[j] and modes[j] > 0.0:
                    status = DEEP
            if status == DEEP:
                break
        if switch >= 0:
            starts = modes[switch] == 0.0
            events[written, GAP], events[written, BEGINS] = switch, 1.0 if starts else 0.0
            events[written, TIME], events[written, ANGLE] = begin + t, y[driven]
            events[written, RATE], events[written, DEPTH] = now[gaps + switch], contact[switch]
            written += 1
            modes[switch] = 1.0 if starts else 0.0
            if starts:
                entered[switch], contact[switch] = max(now[gaps + switch], slowest), 0.0
                h = min(h, START * step)
            clock[SWITCHED] += 1.0
            fresh = True
            if clock[SWITCHED] > most_switches:
                status = BUSY
                break
            if written == events.shape[0]:
                status = FULL
                break
    clock[AHEAD], clock[TRIAL] = (0.0 if done == rows else t - done * step), h
    return status, done, written
