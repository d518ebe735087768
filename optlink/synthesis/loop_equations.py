"""Loop equation of a four-bar that is linear in three constants (conventions of `optlink.linkage.fourbar`, frame = 1).

    F = K1 cos psi - K2 cos phi + K3 - cos(phi - psi)    K1 = 1/a, K2 = 1/c, K3 = (a^2 - b^2 + c^2 + 1) / (2 a c)

F = 0 states that the distance B-C equals the coupler length. On the assembly mode `side` (+1: C left of B -> D), side * F falls
through zero as the output rises.

References
----------
F. Freudenstein, Approximate synthesis of four-bar linkages, Trans. ASME 77 (1955) 853-861.
"""

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import TURN, Array, root

EXACT = 1e-9  # negligible output error [rad]


def _cosine_range(low: Array, high: Array) -> tuple[Array, Array]:
    """Return the least and largest cosine over low ... high [rad]."""
    ends = np.cos(low), np.cos(high)
    top = np.where(np.ceil(low / TURN) * TURN <= high, 1.0, np.maximum(*ends))
    bottom = np.where(np.ceil((low - np.pi) / TURN) * TURN + np.pi <= high, -1.0, np.minimum(*ends))
    return bottom, top


def _parts(k: Array) -> tuple[Array, Array, Array]:
    """Return K1, K2, K3 of constants (..., 3), shaped to broadcast with positions (..., n)."""
    return k[..., 0, None], k[..., 1, None], k[..., 2, None]


def _opposite(angle: Array, where: NDArray[np.bool_]) -> Array:
    """Turn angles by half a turn towards zero where `where` is True."""
    return np.where(where, angle - np.copysign(np.pi, angle), angle)


class LoopEquation:
    """Loop equation of a four-bar: F = K1 u + K2 v + K3 - w for crank angle x and rocker angle y [rad], both (..., n).

    `ratios` limits crank, coupler and rocker over the frame. Constants k (..., 3). `limits`: rows (r, 3) and bounds (r,) with
    rows @ k <= bounds, exactly; `corners`: those (4, 2) of the admissible region of K1, K2, in order; `box`: least and largest k
    (3,) of any linkage within the limits.
    """

    def __init__(self, ratios: tuple[float, float]) -> None:
        self.low, self.high = ratios
        least, largest = 1.0 / self.high, 1.0 / self.low
        self.limits = (np.vstack([np.eye(3)[:2], -np.eye(3)[:2]]), np.array([largest, largest, -least, -least]))
        self.corners = np.array([[least, least], [largest, least], [largest, largest], [least, largest]])
        reach = 1.0 + 2.0 * largest  # of |K3|: F = 0 at some position
        self.box = (np.array([least, least, -reach]), np.array([largest, largest, reach]))

    def terms(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Return the terms u, v, w of F."""
        return np.cos(y), -np.cos(x), np.cos(x - y)

    def slope(self, x: Array, y: Array, k: Array) -> Array:
        """Return dF/dy."""
        return -_parts(k)[0] * np.sin(y) - np.sin(x - y)

    def follow(self, x: Array, k: Array, side: Array) -> Array:
        """Return the output y (..., n) of the linkage; NaN where it cannot be assembled."""
        k1, k2, k3 = _parts(k)
        c, s = np.cos(x), np.sin(x)
        with np.errstate(invalid="ignore", divide="ignore"):
            inner = np.arccos((k2 * c - k3) / np.hypot(k1 - c, s))
        return np.arctan2(-s, k1 - c) + side[..., None] * inner

    def difference(self, y: Array, target: Array) -> Array:
        """Return the output error, angles wrapped to [-pi, pi)."""
        return np.remainder(y - target + np.pi, 2.0 * np.pi) - np.pi

    def upright(self, x0: Array, y0: Array, k: Array) -> tuple[Array, Array, Array]:
        """Return x0, y0, k of the equivalent linkages with positive lengths."""
        first, second = k[..., 0] < 0.0, k[..., 1] < 0.0
        k3 = np.where(first != second, -k[..., 2], k[..., 2])
        return _opposite(x0, first), _opposite(y0, second), np.stack([np.abs(k[..., 0]), np.abs(k[..., 1]), k3], axis=-1)

    def sizes(self, k: Array) -> tuple[Array, Array, Array]:
        """Return crank, coupler and rocker of linkages with positive lengths."""
        crank, rocker = 1.0 / k[..., 0], 1.0 / k[..., 1]
        return crank, np.asarray(root(crank * crank + rocker * rocker + 1.0 - 2.0 * crank * rocker * k[..., 2])), rocker

    def fits(self, sizes: tuple[Array, Array, Array]) -> Array:
        """Return whether the dimensions satisfy the limits of the ratios."""
        least, most = self.low * (1.0 - EXACT), self.high * (1.0 + EXACT)
        return np.asarray(np.all([(size >= least) & (size <= most) for size in sizes], axis=0))

    def margin(self, sizes: tuple[Array, Array, Array], low: Array, high: Array) -> Array:
        """Return the least squared sine of the transmission angle over low ... high.

        It is not positive if a dead position is reached.
        """
        crank, coupler, rocker = sizes
        spread = [
            (coupler**2 + rocker**2 - crank**2 - 1.0 + 2.0 * crank * cosine) / (2.0 * coupler * rocker)
            for cosine in _cosine_range(low, high)
        ]
        return 1.0 - np.maximum(spread[0] ** 2, spread[1] ** 2)


def linear_form(chain: LoopEquation, x: Array, y: Array) -> tuple[Array, Array]:
    """Return F in the form A @ k - w: A (n, 3) and w (n,)."""
    u, v, w = chain.terms(x, y)
    return np.stack([u, v, np.ones_like(w)], axis=-1), w
