"""Switches of the contacts within a step: where a penetration changes its sign, on the dense output. Compiled by numba."""

from numba import njit

from optlink.clearance.compiled.dop853 import CONSTANTS, GAPS, HELPER, attempt, call, copy, inside

SUBINTERVALS = 32
"""Most parts of a step that are examined for contacts, each no longer than a row: bounds the step."""


@njit(**HELPER)
def penetration(share, f, y, n, model, p, x, out):
    """Penetrations and their rates at a share of the step.

    Parameters
    ----------
    share : float
        Place within the step, 0 to 1.
    f : array (7, m)
        Coefficients of the dense output.
    y : array (m,)
        State and works at the start of the step.
    n : int
        Length of the state without the works.
    model : tuple
        See above.
    p : array (parameters,)
        See above.
    x : array
        State; written where it is an intermediate array.
    out : array
        Result.
    """
    inside(share, f, y, n, x)
    call(model[GAPS], x, p, model[CONSTANTS], out)


@njit(**HELPER)
def root(low, high, place, sign, f, y, n, model, p, x, out):
    """Where a penetration or rate (`place`) with this sign rises through zero, between two shares of a step.

    It is not positive at `low`, and positive at `high`: the Illinois method, with bisection.

    Parameters
    ----------
    low, high : float
        Shares of the step.
    place : int
        Index among penetrations and rates.
    sign : float
        +1 or -1.
    f : array (7, m)
        Coefficients of the dense output.
    y : array (m,)
        State and works at the start of the step.
    n : int
        Length of the state without the works.
    model : tuple
        See above.
    p : array (parameters,)
        See above.
    x : array
        State; written where it is an intermediate array.
    out : array
        Result.
    """
    penetration(low, f, y, n, model, p, x, out)
    a, rates = sign * out[place], place + out.shape[0] // 2
    if a >= 0.0 and (rates >= out.shape[0] or sign * out[rates] > 0.0):
        return low
    begin = low
    for i in range(20, 0, -1):  # a gap that has just switched returns first
        if a < 0.0:
            break
        low = begin + (high - begin) * 0.5**i
        penetration(low, f, y, n, model, p, x, out)
        a = sign * out[place]
    if a >= 0.0:
        return begin
    penetration(high, f, y, n, model, p, x, out)
    b, side = sign * out[place], 0
    for i in range(60):
        if high - low <= 1e-13:
            break
        at = low - a * (high - low) / (b - a)
        if i % 8 == 7 or not low < at < high:
            at = 0.5 * (low + high)
        penetration(at, f, y, n, model, p, x, out)
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
def _reaches(nodes, i, j, side, part):
    """Whether a penetration that turns within a part of a step may reach zero there."""
    gaps = nodes.shape[1] // 2
    ahead = side * (nodes[i, j] + 0.5 * part * nodes[i, gaps + j])
    return max(ahead, side * (nodes[i + 1, j] - 0.5 * part * nodes[i + 1, gaps + j])) > 0.0


@njit(**HELPER)
def first_switch(parts, h, modes, y, n, model, space):
    """Share of the step at which the first gap switches, and that gap, or -1; the dense output is known.

    At the ends of the parts of the step penetrations and rates are in `nodes`.

    Parameters
    ----------
    parts : int
        Parts of the step.
    h : float [s]
        Step size.
    modes : array (gaps,)
        1 in contact, 0 apart.
    y : array (m,)
        State and works at the start of the step.
    n : int
        Length of the state without the works.
    model : tuple
        See above.
    space : tuple of arrays
        See `motion.workspace`.
    """
    _, f, _, _, x, _, _, spare, nodes, _, _, _, _, p = space
    gaps, share, switch = modes.shape[0], 2.0, -1
    for i in range(parts):
        for j in range(gaps):
            side = 1.0 - 2.0 * modes[j]
            s0, s1, high = side * nodes[i, gaps + j], side * nodes[i + 1, gaps + j], -1.0
            if side * nodes[i + 1, j] > 0.0:
                high = (i + 1) / parts
            elif s0 > 0.0 and s1 < 0.0 and _reaches(nodes, i, j, side, h / parts):
                top = root(i / parts, (i + 1) / parts, gaps + j, -side, f, y, n, model, p, x, spare)
                penetration(top, f, y, n, model, p, x, spare)
                if side * spare[j] > 0.0:
                    high = top
            if high >= 0.0:
                at = root(i / parts, high, j, side, f, y, n, model, p, x, spare)
                if at < share:
                    share, switch = at, j
        if switch >= 0:
            break
    return share, switch


@njit(**HELPER)
def may_switch(parts, h, modes, nodes):
    """Whether a gap may switch within a step.

    Parameters
    ----------
    parts : int
        Parts of the step.
    h : float [s]
        Step size.
    modes : array (gaps,)
        1 in contact, 0 apart.
    nodes : array (parts + 1, 2 gaps)
        Penetrations and rates at the ends of the parts.
    """
    gaps = modes.shape[0]
    for i in range(parts):
        for j in range(gaps):
            side = 1.0 - 2.0 * modes[j]
            if side * nodes[i + 1, j] > 0.0:
                return True
            turns = side * nodes[i, gaps + j] > 0.0 and side * nodes[i + 1, gaps + j] < 0.0
            if turns and _reaches(nodes, i, j, side, h / parts):
                return True
    return False


@njit(**HELPER)
def to_switch(time, length, most, gap, side, y, n, model, space):
    """Repeat the step with the time until a gap switches; return that time.

    Parameters
    ----------
    time : float [s]
        Time at the start of the step.
    length : float [s]
        Estimate of the time until the switch.
    most : float [s]
        Step size.
    side : float
        -1 in contact, 1 apart.
    y : array (m,)
        State and works at the start of the step.
    n : int
        Length of the state without the works.
    model : tuple
        See above.
    space : tuple of arrays
        See `motion.workspace`.
    """
    k, _, new, between, _, _, then, _, _, _, _, _, _, p = space
    for i in range(8):
        attempt(time, length, y, new, k, between, n, model, p)
        call(model[GAPS], new, p, model[CONSTANTS], then)
        slope = side * then[then.shape[0] // 2 + gap]
        rest = -side * then[gap] / slope if slope > 0.0 else 0.0
        if not abs(rest) < 0.01 * most or abs(rest) <= 1e-14 * (time + length) or length + rest <= 0.0 or i == 7:
            break
        length += rest
    return length


@njit(**HELPER)
def nodes_of(parts, y, n, model, space):
    """Evaluate penetrations and rates between the parts of a step; those at its ends are known.

    Parameters
    ----------
    parts : int
        Parts of the step.
    y : array (m,)
        State and works at the start of the step.
    n : int
        Length of the state without the works.
    model : tuple
        See above.
    space : tuple of arrays
        See `motion.workspace`.
    """
    _, f, _, _, x, now, then, _, nodes, _, _, _, _, p = space
    copy(now, nodes[0])
    copy(then, nodes[parts])
    for i in range(1, parts):
        penetration(i / parts, f, y, n, model, p, x, nodes[i])


@njit(**HELPER)
def parts_of(h, step):
    """Return the number of parts of a step, each no longer than a row.

    Parameters
    ----------
    h : float [s]
        Step size.
    step : float [s]
        Time between rows.
    """
    return 1 if h <= step * (1.0 + 1e-9) else min(SUBINTERVALS, int(h / step * (1.0 - 1e-12)) + 1)
