"""Assur groups in closed form: outer joints and sizes in, inner joint and assembly margin out.

Every dyad is one elementwise function ``dyad(outer, outer, size, size, side) -> (joint, margin)``. The margin is
dimensionless, positive where the group can be assembled in two modes, zero where the two modes meet (dead position),
negative where the loop cannot close; there the joint is NaN. Nothing is clipped.
"""

from __future__ import annotations

import numpy as np

from optlink.linkage.elementwise import Value, Vector, root


def rrr(p: Vector, q: Vector, a: Value, b: Value, side: int) -> tuple[Vector, Value]:
    """Joint of two links pinned at p and q (RRR dyad).

    Parameters
    ----------
    p, q : pair of Value, any common shape [m]
        The two outer joints.
    a, b : Value [m]
        Link lengths from p and from q, positive.
    side : int
        +1: the joint lies to the left of p -> q; -1: to the right.

    Returns
    -------
    joint : pair of Value [m]; NaN where the group cannot be assembled
    margin : Value [-]
        (height / distance)^2 of the joint above p -> q; negative where it cannot be assembled, NaN where p = q.

    Source: intersection of two circles (law of cosines in the triangle of p, q and the joint).
    """
    dx, dy = q[0] - p[0], q[1] - p[1]
    square = dx * dx + dy * dy
    with np.errstate(all="ignore"):
        inverse = np.divide(1.0, square)
        foot = 0.5 + (0.5 * (a * a - b * b)) * inverse  # along p -> q, as a fraction of it
        margin = (a * a) * inverse - foot * foot
        height = side * root(margin)
        return (p[0] + foot * dx - height * dy, p[1] + foot * dy + height * dx), margin
