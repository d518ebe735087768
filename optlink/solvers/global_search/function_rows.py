"""Lower bounds of the largest output error of a four-bar function generator over boxes of start angles, by Farkas multipliers.

With the frame as the unit of length, the constants K1 = 1/crank, K2 = 1/rocker, K3 and

    F(x, y) = K1 cos(psi0 + y) - K2 cos(phi0 + x) + K3 - cos(phi0 - psi0 + x - y)

(Freudenstein; F = 0 closes the loop), the output error of a linkage with the assembly mode s = +1 or -1 stays within t only if

    s F(x_i, y_i - t) >= 0 >= s F(x_i, y_i + t)    at every position x_i.                                                (1)

Proof: as a function of the output angle psi, F = R (cos(psi - theta) - cos alpha), where theta is the direction from crank pin to
rocker pivot, R = K1 times their distance, and psi = theta + s alpha the output. With an error e, |e| <= t, the left side is
s R (cos(alpha - s (e + t)) - cos alpha), 0 <= e + t <= 2 t: not negative if t <= alpha <= pi - t; likewise the right side. Nearer
to a dead position, s F falls short by at most 2 R sin(t)^2 <= 2 (1 + K1) sin(t)^2. As sin(alpha) = coupler sin(gamma) / distance
and distance <= coupler + rocker, 1 + crank, only long cranks and rockers come so near: they are searched apart, with the rows
relaxed by that much (`near_dead`); their coupler is at most (1 + crank) sin(t) / sin(least gamma).

The length b and the transmission angle gamma of the coupler are, in any position of the linkage and for every angle omega,

    V = K1 cos(psi - s omega) + (K1 / K2) cos(omega) - cos(phi - psi + s omega) = (b / crank) cos(gamma - omega).        (2)

Limits of gamma are V <= 0 at
omega = gamma_low - pi/2 and gamma_high + pi/2; the longest coupler is V <= b_high K1 for every omega; the shortest one gives
V >= b_low sin(gamma) K1 at omega = pi/2. At the prescribed instead of the actual output, V + kappa F differs by at most t times
its largest slope, for any kappa (F = 0 at the actual output); the kappa with the least slope is taken.

A box of (phi0, psi0, K1, K2) holds no linkage with an error within t if multipliers lambda >= 0 of these rows exist with
sum lambda_i row_i < 0 everywhere in it (Farkas). The sum is linear in K1, K2, K3 and a sinusoid in each of phi0, psi0 and
phi0 - psi0, so its maximum over the box follows from a second-order expansion with a bound of the third derivative. The
multipliers come from the linear programme of the least violation at the centre, in which the products K1 (psi0 - centre),
K2 (phi0 - centre) and K1 = (K1/K2) K2 are unknowns of their own within their envelopes; they need not be exact.

References
----------
F. Freudenstein, Approximate synthesis of four-bar linkages, Trans. ASME 77 (1955) 853-861. G. P. McCormick, Computability of
global solutions to factorable nonconvex programs I, Mathematical Programming 10 (1976) 147-175 (envelopes).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array
from optlink.solvers.global_search.quadratic import quadratic_bound

Complex = NDArray[np.complex128]

STEEPEST = 5.0  # largest |kappa|
ANGLES = 4  # angles omega of the rows of the longest coupler
UNIT = 2.0**-53
FIELDS = ("output", "crank", "both", "k0", "k1", "k2", "k3", "ratio")
GRASHOF = {
    "span": (),
    "full rotation": ((1.0, 1.0, -1.0, -1.0), (-1.0, 1.0, 1.0, -1.0), (-1.0, 1.0, -1.0, 1.0), (0.0, 1.0, -1.0, 0.0)),
    "double-crank": ((1.0, 1.0, -1.0, -1.0), (1.0, -1.0, 1.0, -1.0), (1.0, -1.0, -1.0, 1.0)),
}
"""Rows (1, K1, K2, K3) of Grashof's conditions, not negative: each compares the squared coupler with the square of the sum or
difference of the three other lengths, both divided by 2 * crank * rocker; the last one of a crank-rocker is crank <= rocker."""


@dataclass(frozen=True)
class LinkageSet:
    """The linkages searched: one assembly mode and ranges of lengths over the frame.

    `low` and `high` bound phi0, psi0 [rad], K1 and K2; `coupler` has the least and largest coupler, `transmission` the same of
    the transmission angle [rad] over the span; `grashof` is a key of `GRASHOF`. `near_dead`: they may come nearer to a dead
    position than the error; `share` is the largest coupler over the sum of frame and crank of those that do.
    """

    side: int
    low: Array
    high: Array
    coupler: tuple[float, float]
    transmission: tuple[float, float]
    grashof: str = "span"
    near_dead: bool = False
    share: float = math.inf

    @property
    def least_sine(self) -> float:
        """Least sine of the transmission angle."""
        return min(math.sin(angle) for angle in self.transmission)

    def dead_part(self, error: float) -> LinkageSet | None:
        """Return the linkages that may come nearer to a dead position than an error [rad]; None if there are none."""
        share = math.sin(error) / self.least_sine  # coupler over distance, at most, in such a position
        distance = self.coupler[0] / share
        if error >= min(self.transmission[0], math.pi - self.transmission[1]) or share >= 1.0:
            return replace(self, near_dead=True)
        crank, rocker = distance - 1.0, distance * (1.0 - share)
        most = [1.0 / size if size > 0.0 else math.inf for size in (crank, rocker)]
        high = np.minimum(self.high, [math.inf, math.inf, most[0] * (1.0 + 1e-9), most[1] * (1.0 + 1e-9)])
        part = replace(self, high=high, near_dead=True, share=share * (1.0 + 1e-12))
        return part if np.all(high >= self.low) else None


@dataclass(frozen=True)
class Rows:
    """Rows that no wanted linkage makes negative, each array (boxes or 1, rows).

    Row = K1 (Re(output e^(i psi0)) + k1) + K2 (Re(crank e^(i phi0)) + k2) + K3 k3 + (K1 / K2) ratio
    + Re(both e^(i (phi0 - psi0))) + k0.
    """

    output: Complex
    crank: Complex
    both: Complex
    k0: Array
    k1: Array
    k2: Array
    k3: Array
    ratio: Array

    @staticmethod
    def joined(parts: list[Rows], boxes: int) -> Rows:
        """Return all rows of several sets."""

        def whole(name: str) -> Any:
            arrays = [getattr(part, name) for part in parts]
            return np.concatenate([np.broadcast_to(a, (boxes, a.shape[1])) for a in arrays], axis=1)

        return Rows(*(whole(name) for name in FIELDS))


def loop_rows(linkages: LinkageSet, x: Array, y: Array, t: float) -> Rows:
    """Return the rows (1) of an output error t at input and prescribed output rotations x and y (n,), all in rad."""
    signs = np.repeat([linkages.side, -linkages.side], x.size)[None]
    x, y = np.tile(x, 2)[None], np.concatenate([y - t, y + t])[None]
    short = np.full(x.shape, 2.0 * math.sin(t) ** 2 if linkages.near_dead else 0.0)
    zero = np.zeros(x.shape)
    return Rows(
        signs * unit_vector(y), -signs * unit_vector(x), -signs * unit_vector(x - y), short, short, zero, signs + zero, zero
    )


def grashof_rows(linkages: LinkageSet) -> Rows:
    """Return the rows of Grashof's conditions."""
    k0, k1, k2, k3 = np.array(GRASHOF[linkages.grashof], dtype=float).reshape(-1, 4).T[:, None]
    zero = np.zeros(k0.shape)
    return Rows(zero + 0.0j, zero + 0.0j, zero + 0.0j, k0, k1, k2, k3, zero)


def coupler_rows(linkages: LinkageSet, x: Array, y: Array, t: float, low: Array, high: Array) -> list[Rows]:
    """Return the rows (2) of the limits of transmission angle and coupler, relaxed so that they hold in the whole of each box.

    x, y and t: as in `loop_rows`, the ends of the span first and last.
    """
    ends, (least, most), right = linkages.transmission, linkages.coupler, 0.5 * math.pi
    row, two = _CouplerRow(linkages.side, t, low, high), [0, -1]
    rows = [row(x, y, -1.0, right, least * linkages.least_sine)]
    for omega in (ends[0] - right, ends[1] + right):
        rows += [row(x, y, 1.0, omega, 0.0, shift) for shift in (-t, 0.0, t)]
    for omega in np.linspace(*ends, ANGLES):
        rows.append(row(x[two], y[two], 1.0, float(omega), -most))
        if math.isfinite(linkages.share):
            rows.append(row(x, y, 1.0, float(omega), -linkages.share, constant=linkages.share))
    return rows


@dataclass(frozen=True)
class _CouplerRow:
    side: int
    t: float
    low: Array
    high: Array

    def __call__(
        self, x: Array, y: Array, sign: float, omega: float, share: float, shift: float = 0.0, constant: float = 0.0
    ) -> Rows:
        """Return the rows constant - (sign V + kappa F + share K1) + relaxation >= 0 at outputs `shift` off the prescribed ones.

        F = 0 and sign V + share K1 <= constant at the actual output, which is at most d = t + |shift| away. So the relaxation is
        d times the largest slope of sign V + kappa F, plus d^2 / 2 times its largest curvature downwards.
        """
        x, y, turn, away = x[None], y[None] + shift, self.side * omega, self.t + abs(shift)
        centre, radius = 0.5 * (self.low + self.high)[:, :, None], 0.5 * (self.high - self.low)[:, :, None]
        psi, phi, k1, most = unit_vector(centre[:, 1]), unit_vector(centre[:, 0]), centre[:, 2], self.high[:, 2, None]
        across = phi * np.conj(psi)

        def slope(output: Complex, both: Complex) -> Array:
            return -k1 * np.imag(output * psi) + np.imag(both * across)

        v = sign * unit_vector(y - turn), -sign * unit_vector(x - y + turn)
        f = unit_vector(y), -unit_vector(x - y)
        with np.errstate(divide="ignore", invalid="ignore"):
            kappa = np.nan_to_num(np.clip(-slope(*v) / slope(*f), -STEEPEST, STEEPEST))
        output, both = v[0] + kappa * f[0], v[1] + kappa * f[1]
        turned = most * np.abs(output) * radius[:, 1] + np.abs(both) * (radius[:, 0] + radius[:, 1])
        steepest = np.abs(slope(output, both)) + np.abs(np.imag(output * psi)) * radius[:, 2] + turned
        curved = k1 * np.real(output * psi) + np.real(both * across) + np.abs(np.real(output * psi)) * radius[:, 2] + turned
        curved = np.maximum(0.0, curved + (most * np.abs(output) + np.abs(both)) * away)
        room = constant + (away * steepest + 0.5 * away * away * curved) * (1.0 + 1e-12)
        zero = np.zeros(kappa.shape)
        return Rows(-output, kappa * unit_vector(x), -both, room, zero - share, zero, -kappa, zero - sign * math.cos(omega))


def unit_vector(angle: Array) -> Complex:
    """Return e^(i angle)."""
    return np.asarray(np.exp(1j * angle))


def most_k3(high: Array) -> Array:
    """Return the largest |K3|: F = 0 in some position."""
    return (1.0 + high[:, 2] + high[:, 3]) * (1.0 + 1e-12)


def largest(rows: Rows, weights: Array, low: Array, high: Array) -> Array:
    """Return a rigorous upper bound (boxes,) of the sum of the rows over each box; negative weights (boxes, rows) are zero."""
    weights = np.maximum(weights, 0.0)
    centre, radius = 0.5 * (low + high), 0.5 * (high - low)
    output, crank, both, k0, k1, k2, k3, ratio = (np.sum(weights * getattr(rows, name), axis=1) for name in FIELDS)
    f, p, k1_high, k2_high, k3_high = radius[:, 0], radius[:, 1], high[:, 2], high[:, 3], most_k3(high)
    output, crank = output * unit_vector(centre[:, 1]), crank * unit_vector(centre[:, 0])
    both = both * unit_vector(centre[:, 0] - centre[:, 1])
    most, steepest = np.full(len(low), -np.inf), np.zeros(len(low))
    middle = np.sqrt(low[:, 3] * high[:, 3])
    for first in (low[:, 2], high[:, 2]):  # the sum is linear in K1, and convex or linear in K2: largest at a corner
        for second in (low[:, 3], high[:, 3]):
            tangent = first * (2.0 * middle - second) / (middle * middle)  # below K1 / K2, a convex function of K2
            quotient = np.where(ratio >= 0.0, first / second, tangent)
            value = first * (output.real + k1) + second * (crank.real + k2) + both.real + k0 + ratio * quotient
            linear = np.stack([-(second * crank.imag + both.imag) * f, -(first * output.imag - both.imag) * p], axis=1)
            curved = (second * crank.real + both.real) * f * f, both.real * f * p, (first * output.real + both.real) * p * p
            quadratic = np.stack([0.5 * curved[0], -curved[1], 0.5 * curved[2]], axis=1)
            most = np.maximum(most, -quadratic_bound(-value, -linear, quadratic, np.zeros(len(low))))
            steepest = np.maximum(steepest, np.abs(quotient))
    third = (k1_high * np.abs(output) * p**3 + k2_high * np.abs(crank) * f**3 + np.abs(both) * (f + p) ** 3) / 6.0
    factors = k1_high, k2_high, 1.0, 1.0, k1_high, k2_high, k3_high, steepest
    total = (1.0 + STEEPEST) * np.sum(weights, axis=1) * (1.0 + k1_high + k2_high + k3_high)  # of the sums within a coefficient
    for name, factor in zip(FIELDS, factors, strict=True):
        total = total + factor * np.sum(weights * np.abs(getattr(rows, name)), axis=1)
    rounding = (128.0 + 8.0 * weights.shape[1]) * UNIT * total
    return np.asarray(most + np.abs(k3) * k3_high + third * (1.0 + 1e-12) + rounding)
