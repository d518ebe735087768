"""Motion of a machine with joint clearance over rows: steps, switches of the contacts, and maxima, compiled by numba.

Between two switches the modes are constant. On the dense output of a step the penetrations are examined at intervals of at most
a row: a penetration that changes its sign is a switch, and one that rises and falls again has its summit located. At a switch the
step is repeated with exactly the time until it, corrected by Newton's method on the motion itself, so a switch has order 8.

`machine.py` imports this file from the cache folder, under the hash of all that it is compiled from.
"""

import numpy as np
from numba import njit

from optlink.clearance.compiled.dop853 import (
    CONSTANTS,
    ENTRY,
    GAPS,
    POWERS,
    PROJECT,
    STAGES,
    WATCH,
    attempt,
    call,
    change_of,
    copy,
    error_of,
    evaluate,
    inside,
    interpolant,
)
from optlink.clearance.compiled.maxima import PARTS, maxima, quantity
from optlink.clearance.compiled.switches import SUBINTERVALS, first_switch, may_switch, nodes_of, parts_of, to_switch
from optlink.linkage.vector2d import Array

FIRST = 0.05
"""Share of a row that is the first trial step at the start of a contact."""

DONE, FULL, PAUSED, STUCK, DEEP, BUSY, INFINITE = range(7)
"""Why a call ended."""

AHEAD, TRIAL, REJECTED, SWITCHED, TOO_DEEP = range(5)
"""Places in `clock`: time since the last row [s], next step size [s], steps rejected in succession, switches since the last row,
gap that is too deep."""

GAP, BEGINS, TIME, ANGLE, RATE, DEPTH = range(6)
"""Columns of `events`: gap, 1 begin or 0 end, time [s], crank angle [rad], rate of the penetration [m/s], the largest one [m]."""


def workspace(n: int, m: int, gaps: int) -> tuple[Array, ...]:
    """Return the intermediate arrays of `advance`, which allocates nothing.

    Parameters
    ----------
    n, m : int
        Length of the state, and with the works.
    """
    w, q = 2 * gaps, 2 * gaps + 2
    sizes = [(STAGES + 4, m), (POWERS, m), m, m, m, w, w, w, (SUBINTERVALS + 1, w), (PARTS + 2, q), q, q, gaps + 1, 4 + w]
    return tuple(np.zeros(size) for size in sizes)


@njit(cache=True, **ENTRY)
def advance(
    model, closing, row, rows, step, tolerance, further, driven, limits, most_steps, most_switches, slowest,
    y, offset, clock, modes, entered, contact, peaks, space, out_x, out_works, out_modes, out_entered, events,
):  # fmt: skip
    """Integrate rows of a motion; returns why it ended, the number of rows and of events written.

    Parameters
    ----------
    model : tuple
        See `dop853`.
    closing : int
        Number of closing equations.
    row, rows : int
        Number of the first row, and of the rows to integrate.
    step, tolerance, further : float
        Time between rows [s]; relative tolerance; feedback correction [rad].
    driven : int
        Index of the crank angle.
    limits : array (k,)
        Penetrations [m] that end the motion.
    most_steps, most_switches : int
        Steps of a call, and switches within a row.
    slowest : float
        Least approach speed [m/s].
    y, offset, clock, modes, entered, contact, peaks : arrays, changed in place
        State and works; works before them; see AHEAD; modes, approach speeds and penetrations of the contacts; maxima.
    space : tuple of arrays
        From `workspace`.
    out_x, out_works, out_modes, out_entered, events : arrays
        Results of the rows, and switches.
    """
    gaps, n, m = modes.shape[0], out_x.shape[1], y.shape[0]
    k, f, new, between, x, now, then, _, nodes, _, first, last, _, p = space
    p[0] = further
    begin, end = row * step, rows * step
    t, h, done, written, steps = clock[AHEAD], clock[TRIAL], 0, 0, 0
    fresh, status = True, DONE
    while done < rows:
        if fresh:  # after a switch, and at the start
            for j in range(gaps):
                p[4 + j], p[4 + gaps + j] = entered[j], modes[j]
            evaluate(begin + t, y, model, p, k[0])
            call(model[GAPS], y, p, model[CONSTANTS], now)
            call(model[WATCH], y, p, model[CONSTANTS], first)
            for j in range(gaps + 1):
                if j == gaps or modes[j] > 0.0:
                    place = gaps + j if j < gaps else 2 * gaps
                    peaks[place] = max(peaks[place], quantity(first, j, gaps)[0])
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
            h = min(h if h > 0.0 else FIRST * step, SUBINTERVALS * step)
            trial, whole = h, t + h * (1.0 + 1e-9) >= end
            if whole:
                h = end - t
            attempt(begin + t, h, y, new, k, between, n, model, p)
            error = error_of(y, new, k, h, tolerance)
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
            parts = parts_of(h, step)
            dense = parts > 1
            if dense:
                interpolant(begin + t, h, y, new, k, between, n, model, p, f)
            call(model[GAPS], new, p, model[CONSTANTS], then)
            nodes_of(parts, y, n, model, space)
            if may_switch(parts, h, modes, nodes):
                if not dense:
                    interpolant(begin + t, h, y, new, k, between, n, model, p, f)
                    dense = True
                share, switch = first_switch(parts, h, modes, y, n, model, space)
                if switch >= 0:
                    length = to_switch(begin + t, share * h, h, switch, 1.0 - 2.0 * modes[switch], y, n, model, space)
                    after, h, whole = max(after, h), length, False
                    parts = parts_of(h, step)
                    dense = parts > 1
                    if dense:
                        interpolant(begin + t, h, y, new, k, between, n, model, p, f)
                    nodes_of(parts, y, n, model, space)
            dense = maxima(begin + t, h, parts, dense, modes, contact, peaks, y, n, model, space)
            later = end if whole else t + h
            while done < rows and ((done + 1) * step <= later or (whole and done + 1 == rows)):
                at = (done + 1) * step
                if at >= later:
                    copy(new, x)
                else:
                    if not dense:
                        interpolant(begin + t, h, y, new, k, between, n, model, p, f)
                        dense = True
                    inside((at - t) / h, f, y, m, x)
                for i in range(m - n):
                    out_works[done, i] = offset[i] + x[n + i]
                if closing:
                    call(model[PROJECT], x, p, model[CONSTANTS], out_x[done])
                else:
                    for i in range(n):
                        out_x[done, i] = x[i]
                copy(modes, out_modes[done])
                copy(entered, out_entered[done])
                done += 1
                clock[SWITCHED] = 0.0
            t, h = later, after
            copy(new, y)
            copy(k[STAGES], k[0])
            if closing:
                call(model[PROJECT], new, p, model[CONSTANTS], between)
                for i in range(n):
                    y[i] = between[i]
                evaluate(begin + t, y, model, p, k[0])
                call(model[GAPS], y, p, model[CONSTANTS], then)
            copy(then, now)
            copy(last, first)
            for j in range(gaps):
                if now[j] > limits[j] and modes[j] > 0.0:
                    clock[TOO_DEEP], status = j, DEEP
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
                h = min(h, FIRST * step)
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
