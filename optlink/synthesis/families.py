"""Families of linkages that meet too few targets to be determined: pairs of dyads of poses, of functions, and of timed points."""

from dataclasses import dataclass, field

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.synthesis.five_poses import Complex, Dyad, link, seen_from_crank
from optlink.synthesis.four_poses import DyadCurves, Positions, curves, of_dyads

FOLLOWERS = 128  # points of each closed curve of the partners of a timed crank
ONE_ROW = np.zeros(1)


@dataclass(frozen=True, eq=False)
class PoseFamily:
    """Dyads of poses: any of `drivers` and any of `followers` are a four-bar.

    `noun`: what the rows of the curves are; `most`: number of drivers of which all four-bars are compared; `refined`: how many of
    the best ones are improved between rows.
    """

    drivers: DyadCurves
    followers: DyadCurves
    noun: str = "dyads"
    most: int = 400
    refined: int = 6

    @property
    def rows(self) -> Array:
        """Rows of all followers, some of them between curves."""
        return np.arange(len(self.followers.points), dtype=float)

    def may_drive(self, rows: Array) -> Array:
        """Return whether the crank of each driver (n,) passes the targets in order."""
        return np.asarray(self.drivers.in_order[rows.astype(int)])

    def positions(self, drivers: Array, rows: Array) -> Positions:
        """Return the linkages of drivers (n,) and followers (m,), by rows that need not be whole numbers."""
        poses = self.drivers
        return of_dyads(poses.places, poses.angles, poses.between(drivers), self.followers.between(rows))

    def ends(self, drivers: Array, rows: Array | None = None) -> tuple[Complex, Complex]:
        """Return pivots and points of the body at the first pose [m]: of drivers (n,), or of the partners (m,) of one."""
        points, pivots = self.drivers.between(drivers) if rows is None else self.followers.between(rows)
        return pivots, points


@dataclass(frozen=True, eq=False)
class _Timed:
    """Linkages at prescribed crank angles, of one curve of dyads."""

    drivers: DyadCurves = field(init=False)

    @property
    def followers(self) -> DyadCurves:
        """The same dyads, which have the defects of all."""
        return self.drivers

    def may_drive(self, rows: Array) -> Array:
        """Return whether the prescribed crank angles are in order: those of all alike."""
        return np.ones(len(rows), dtype=bool)


@dataclass(frozen=True, eq=False)
class FunctionFamily(_Timed):
    """Linkages whose output moves as prescribed at four crank angles: one for each dyad of the output as seen from the crank.

    `inputs`: crank angles [rad]; `outputs`: angles [rad] or, if the output `slides`, coordinates [m], see `five_poses.couplers`.
    """

    inputs: Array
    outputs: Array
    slides: bool
    noun: str = "couplers"
    most: int = 1000
    refined: int = 6

    def __post_init__(self) -> None:
        object.__setattr__(self, "drivers", curves(*seen_from_crank(self.inputs, self.outputs, slides=self.slides)))

    @property
    def rows(self) -> Array:
        """The only follower."""
        return ONE_ROW

    def positions(self, drivers: Array, rows: Array) -> Positions:
        """Return the linkages of drivers (n,), with one follower each."""
        joints, pins = (part[:, None, None] for part in self.drivers.between(drivers))
        rise = self.outputs - self.outputs[0]
        moved = joints + rise if self.slides else 1.0 + np.exp(1j * rise) * (joints - 1.0)
        fixed = np.full((1, 1), 1j if self.slides else 1.0 + 0j)
        return Positions(
            pins * np.exp(1j * (self.inputs - self.inputs[0])), moved, np.zeros((1, 1), complex), fixed, slides=self.slides
        )

    def ends(self, drivers: Array, rows: Array = ONE_ROW) -> tuple[Complex, Complex]:
        """Return crank pins and joints of the output at the first position.

        They count from the crank pivot, along the frame of length 1 or the guide.
        """
        found = self.positions(drivers, rows)
        return found.pin[:, 0, 0], found.joint[:, 0, 0]


@dataclass(frozen=True, eq=False)
class TimedFamily(_Timed):
    """Four-bars that pass four points at given crank rotations: a curve of cranks, and of each the curve of its partners.

    A body that turns with the crank takes the poses, see `five_poses.timed_paths`. `places` [m], `inputs` [rad].
    """

    places: Complex
    inputs: Array
    noun: str = "cranks"
    most: int = 100
    refined: int = 2

    def __post_init__(self) -> None:
        object.__setattr__(self, "drivers", curves(self.places, self.inputs - self.inputs[0]))

    @property
    def rows(self) -> Array:
        """Rows of the partners of a crank, on two closed curves at most."""
        return np.arange(2.0 * (FOLLOWERS + 1))

    def positions(self, drivers: Array, rows: Array) -> Positions:
        """Return the four-bars of cranks (n,) and partners (m,)."""
        corners, pivots = self.drivers.between(drivers)
        return self.of_cranks(pivots, self.places[0] - corners, rows)

    def ends(self, drivers: Array, rows: Array | None = None) -> tuple[Complex, Complex]:
        """Return pivots and pins at the first point [m] of cranks (n,), or those of the partners (m,) of one."""
        if rows is None:
            corners, pivots = self.drivers.between(drivers)
            return pivots, pivots + self.places[0] - corners
        found = self.positions(drivers, rows)
        return found.fixed[0], found.joint[0, :, 0]

    def of_cranks(self, pivots: Complex, cranks: Complex, rows: Array) -> Positions:
        """Return the four-bars of cranks (n,), from pivot to pin at the first point [m], and partners (m,)."""
        pins = pivots[:, None] + cranks[:, None] * np.exp(1j * (self.inputs - self.inputs[0]))
        joints = np.full((len(pivots), len(rows), len(self.places)), np.nan + 0j)
        fixed = joints[..., 0].copy()
        with np.errstate(all="ignore"):
            turned = (self.places - pins) / (self.places[0] - pins[:, :1])
        for k in np.flatnonzero(np.all(np.isfinite(turned), axis=1)):
            partners = curves(self.places, np.unwrap(np.angle(turned[k])), FOLLOWERS)
            ends, fixed[k] = partners.between(rows)
            joints[k] = self.places + turned[k] / np.abs(turned[k]) * (ends[:, None] - self.places[0])
        return Positions(pins[:, None], joints, pivots[:, None], fixed, self.places)


Family = PoseFamily | FunctionFamily | TimedFamily


def three_points(phi: Array, psi: Array, *, slides: bool) -> Dyad | None:
    """Return the coupler of three points of a function whose crank and output begin at given angles; None without one.

    The constant length of the coupler is linear in three constants (Freudenstein): of a four-bar cos(phi - psi) = k1 cos(psi) -
    k2 cos(phi) + k3, of a slide s, with sizes a and e, s^2 = 2 a s cos(phi) + 2 a e sin(phi) + k3.

    Parameters
    ----------
    phi, psi : array (3,) [rad]
        Angles of crank and output, from the line of the pivots of length 1; if it `slides`, its coordinate [m] along it.
    """
    one = np.ones(3)
    columns = [psi * np.cos(phi), np.sin(phi), one] if slides else [np.cos(psi), -np.cos(phi), one]
    matrix, right = np.stack(columns, axis=1), psi * psi if slides else np.cos(phi - psi)
    if np.linalg.cond(matrix) > 1e12:
        return None
    first, second, _ = np.linalg.solve(matrix, right)
    if first == 0.0 or (second == 0.0 and not slides):
        return None
    pin = 0.5 * first if slides else 1.0 / first
    joint = complex(psi[0], second / first) if slides else 1.0 + np.exp(1j * psi[0]) / second
    return link(joint, pin * np.exp(1j * phi[0]), 1.0)
