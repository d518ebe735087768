"""Motion of a machine with joint clearance over rows: steps, switches of the contacts, and maxima, compiled by numba.

Between two switches the modes are constant. On the dense output of a step the penetrations are examined at intervals of at most
a row: a penetration that changes its sign is a switch, and one that rises and falls again has its summit located. At a switch the
step is repeated with exactly the time until it, corrected by Newton's method on the motion itself, so a switch has order 8.

`machine.py` imports this file from the cache folder, under the hash of all that it is compiled from.
"""

import numpy as np
from numba import njit

from optlink.clearance.compiled.dop853 import (
    BETWEEN,
    ENTRY,
    FIRST,
    LAST,
    NEW,
    NODES,
    NOW,
    PARAMETERS,
    POWERS,
    SLOPES,
    STAGES,
    STATE,
    attempt,
    change_of,
    copy,
    error_of,
    evaluate,
    forces,
    inside,
    interpolant,
    penetrations,
    project,
)
from optlink.clearance.compiled.maxima import PARTS, maxima, quantity
from optlink.clearance.compiled.switches import SUBINTERVALS, examine, first_switch, to_switch
from optlink.linkage.vector2d import Array

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
