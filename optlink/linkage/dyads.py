"""Assur groups of two bodies (dyads) in closed form.

Every dyad is one elementwise function ``dyad(known ..., sizes ..., side) -> (new, margin)``. The margin is dimensionless,
positive where the group can be assembled, zero where its assembly modes meet (dead position) or its lines become parallel,
negative where the loop cannot close; there the result is NaN. Nothing is clipped.

A line is a point on it and its unit vector w; its left normal is n = (-w_y, w_x), and offsets count along n.
"""

import numpy as np

from optlink.linkage.vector2d import Value, Vector, cross, dot, minus, root


def rrr(p: Vector, q: Vector, a: Value, b: Value, side: Value) -> tuple[Vector, Value]:
    """Compute the joint of two links pinned at p and q (RRR dyad).

    Parameters
    ----------
    p, q : pair of Value, any common shape [m]
        The two outer joints.
    a, b : Value [m]
        Link lengths from p and from q, positive.
    side : int or array of int
        +1: the joint lies to the left of p -> q; -1: to the right.

    Returns
    -------
    joint : pair of Value [m]; NaN where the group cannot be assembled
    margin : Value [-]
        (height / distance)^2 of the joint above p -> q; negative where it cannot be assembled, NaN where p = q.

    Notes
    -----
    Intersection of two circles (law of cosines in the triangle of p, q and the joint).
    """
    dx, dy = minus(q, p)
    square = dx * dx + dy * dy
    with np.errstate(all="ignore"):
        inverse = np.divide(1.0, square)
        foot = 0.5 + (0.5 * (a * a - b * b)) * inverse  # along p -> q, as a fraction of it
        margin = (a * a) * inverse - foot * foot
        height = side * root(margin)
        return (p[0] + foot * dx - height * dy, p[1] + foot * dy + height * dx), margin


def rrp(p: Vector, g: Vector, w: Vector, a: Value, offset: Value, side: Value) -> tuple[Vector, Value]:
    """Compute the joint of a link pinned at p and a slider on a known line (RRP dyad).

    Parameters
    ----------
    p : pair of Value [m]
        The outer pin.
    g, w : pair of Value [m], [-]
        A point and the unit vector of the slider's line.
    a : Value [m]
        Link length from p to the joint, positive.
    offset : Value [m]
        Distance of the joint to the left of the line, fixed on the slider.
    side : int or array of int
        +1: the joint lies forward (along w) of the foot of p on the line; -1: backward.

    Returns
    -------
    joint : pair of Value [m]; NaN where the group cannot be assembled
    margin : Value [-]
        1 - (h / a)^2, h the distance of p from the path of the joint; negative where that exceeds the link.

    Notes
    -----
    Intersection of a circle and a line.
    """
    to_p = minus(p, g)
    height = cross(w, to_p) - offset
    with np.errstate(all="ignore"):
        ratio = height / a
        margin = 1.0 - ratio * ratio
        along = dot(w, to_p) + side * (a * root(margin))
        return (g[0] + along * w[0] - offset * w[1], g[1] + along * w[1] + offset * w[0]), margin


def rpr(p: Vector, q: Vector, offset: Value, side: Value) -> tuple[Vector, Value]:
    """Compute the direction of the line along which two bodies pinned at p and q slide (RPR dyad).

    Parameters
    ----------
    p, q : pair of Value [m]
        Outer pins of the body that carries the line (p) and of the slider (q).
    offset : Value [m]
        Distance of q minus that of p to the left of the line, fixed on the two bodies.
    side : int or array of int
        +1: q lies forward (along the line) of p; -1: backward.

    Returns
    -------
    direction : pair of Value [-], unit vector of the line; NaN where the group cannot be assembled
    margin : Value [-]
        1 - (offset / distance)^2; negative where the pins are nearer than the offset, NaN where p = q.

    Notes
    -----
    p -> q is the sum of the slide along the line and the offset across it (right triangle).
    """
    dx, dy = minus(q, p)
    with np.errstate(all="ignore"):
        inverse = np.divide(1.0, np.sqrt(dx * dx + dy * dy))
        c, s = dx * inverse, dy * inverse
        across = offset * inverse
        margin = 1.0 - across * across
        along = side * root(margin)
        return (c * along + s * across, s * along - c * across), margin


def rpp(p: Vector, y: Vector, w: Vector, u: Vector, offset: Value) -> tuple[Value, Value]:
    """Compute the displacement of a yoke on its known line, moved by a slider that is pinned at p (RPP dyad).

    Parameters
    ----------
    p : pair of Value [m]
        The outer pin, fixed on the slider.
    y : pair of Value [m]
        A point of the slider's line when the yoke is at zero.
    w, u : pair of Value [-]
        Unit vectors of the yoke's own line and of the slider's line on the yoke.
    offset : Value [m]
        Distance of p to the left of the slider's line.

    Returns
    -------
    displacement : Value [m], of the yoke along w
    margin : Value [-]
        Squared sine of the angle between the two lines: zero where they are parallel.

    Notes
    -----
    Intersection of two lines.
    """
    sine = cross(u, w)
    with np.errstate(all="ignore"):
        return (cross(u, minus(p, y)) - offset) / sine, sine * sine


def prp(g: Vector, w: Vector, h: Vector, u: Vector, first: Value, second: Value) -> tuple[Vector, Value]:
    """Compute the joint of two sliders on two known lines (PRP dyad).

    Parameters
    ----------
    g, w, h, u : pair of Value [m], [-], [m], [-]
        Point and unit vector of the first line, and of the second.
    first, second : Value [m]
        Distances of the joint to the left of the two lines, fixed on the two sliders.

    Returns
    -------
    joint : pair of Value [m]
    margin : Value [-]
        Squared sine of the angle between the two lines: zero where they are parallel.

    Notes
    -----
    Intersection of two lines.
    """
    sine = cross(w, u)
    start = (g[0] - first * w[1], g[1] + first * w[0])
    with np.errstate(all="ignore"):
        along = (second - cross(u, minus(start, h))) / cross(u, w)
        return (start[0] + along * w[0], start[1] + along * w[1]), sine * sine
