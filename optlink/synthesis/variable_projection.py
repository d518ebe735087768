"""Variable projection: position, size and direction of a linkage and its coupler point by linear least squares.

As complex numbers the points of a body are P = a + w S + b u, with S the path of one of its joints and u its direction, both
known from the proportions and the crank angles; a, w and b follow from linear least squares. The remaining nonlinear unknowns
are the proportions (three numbers for a four-bar) and the crank angles.

References
----------
G. H. Golub and V. Pereyra, The differentiation of pseudo-inverses and nonlinear least squares problems whose variables
separate, SIAM J. Numer. Anal. 10 (1973).
"""

from __future__ import annotations

import copy
from collections.abc import Iterable

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.linkage.mechanism import FRAME
from optlink.linkage.vector2d import TURN, Array, minus, unit
from optlink.problem.requirements.base import START
from optlink.symbolic import NumpyEvaluator, symbols_in_numpy
from optlink.synthesis.batch import Batch, Variant

Complex = NDArray[np.complex128]


class SimilarityFit:
    """Optimal position, direction and size of every design of a batch, and its optimal coupler point where that is free."""

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        problem = batch.problem
        names = list(batch.names)

        def indices(wanted: Iterable[str]) -> list[int]:
            return [names.index(name) for name in wanted if name in names]

        quantities = problem.mechanism.quantities
        mark = problem.linkage.marks.get((problem.body, problem.point))
        marks = () if mark is None else (str(mark.along), str(mark.across))
        self.point = indices(marks) if mark is not None and set(marks) <= set(names) else []
        ground = {name: q for name, q in quantities.items() if q.kind == "coordinate" and name.rpartition(".")[2] in ("x", "y")}
        angles = [name for name, q in quantities.items() if q.kind == "angle"]
        sizes = [
            name for name in quantities if name not in ground and name not in angles and (name not in marks or not self.point)
        ]
        turning = [name for name in angles if self._on_frame(name)]
        self.lengths, self.turning = indices(sizes), indices(turning)
        bases = sorted({name.rpartition(".")[0] for name in ground})
        pivots = (indices((f"{base}.x", f"{base}.y")) for base in bases)
        self.ground = [(pivot[0], pivot[1]) for pivot in pivots if len(pivot) == 2]
        placed = getattr(problem.mechanism, "placed", True)
        free = [name for name in (*sizes, *ground, *turning) if name not in names and quantities[name].value != 0.0]
        bound = [name for name in (*ground, *turning) if name not in names]
        self.counted_from_x = problem.linkage.datum == 0.0
        timed = not batch.free_timing and batch.start < 0 and self.counted_from_x
        similar = placed and not free and not bound and not problem.links  # a link need not hold for a similar linkage
        self.applies = problem.requirement.kind == "path" and similar and not timed
        if self.applies:
            self._trace()

    def of(self, batch: Batch) -> SimilarityFit:
        """Return the same projection for a batch with fewer points, or with fewer assembly modes."""
        other = copy.copy(self)
        other.batch = batch
        return other

    def _on_frame(self, name: str) -> bool:
        """Return whether an angle turns with the frame: the direction of the frame, or of a guide on it."""
        mechanism = self.batch.problem.linkage
        if name == "direction":
            return True
        base, _, key = name.rpartition(".")
        return key == "direction" and any(guide.name == base and guide.on == FRAME for guide in mechanism.guides)

    def _trace(self) -> None:
        batch, problem = self.batch, self.batch.problem
        x, t = casadi.SX.sym("x", len(batch.names)), casadi.SX.sym("t")
        values = problem.complete({v.name: v.value(x[i]) for i, v in enumerate(batch.variables)})
        mechanism = batch.linkage(problem)
        with symbols_in_numpy():
            pose = mechanism.pose(values, unit(t))
            link = mechanism.link(problem.body)
            pivot = pose.point(mechanism.crank.start)
            at = pose.point(link.start if self.point else problem.point)
            arm, axis = minus(at, pivot), pose.direction(problem.body)
            outputs = [arm[0] / problem.size, arm[1] / problem.size, axis[0] + 0.0 * t, axis[1] + 0.0 * t]
            self._tape = NumpyEvaluator([*casadi.vertsplit(x), t, *batch.side_symbols.values()], outputs)
        self._pivot = [batch.names.index(f"{mechanism.crank.start}.{axis}") for axis in "xy"]

    def fit(self, x: Array, t: Array, variant: Variant = 0) -> tuple[Array, Array]:
        """Return designs with optimal linear variables, and their crank angles; designs without a finite fit stay unchanged."""
        batch = self.batch
        arm_x, arm_y, axis_x, axis_y = self._tape(*x.T[..., None], t, *batch.side_columns(variant))
        centre = np.array(batch.problem.centre)
        targets = ((batch.data.columns[:, 0] - centre[0]) + 1j * (batch.data.columns[:, 1] - centre[1])) / batch.problem.size
        arm, axis = arm_x + 1j * arm_y, axis_x + 1j * axis_y
        weights = batch.data.roots**2 / np.sum(batch.data.roots**2)

        def mean(z: Complex) -> Complex:
            return np.asarray((z * weights).sum(axis=-1, keepdims=True))

        with np.errstate(all="ignore"):
            s, u, z = arm - mean(arm), axis - mean(axis), targets - mean(targets)
            ss, sz = mean(s * s.conj()).real, mean(s.conj() * z)
            if self.point:
                uu, su, uz = mean(u * u.conj()).real, mean(s.conj() * u), mean(u.conj() * z)
                uu = uu + 1e-12
                w = (uu * sz - su * uz) / (ss * uu - np.abs(su) ** 2)
                b = (uz - su.conj() * w) / uu
            else:
                w, b = sz / ss, np.zeros_like(sz)
            a = mean(targets) - w * mean(arm) - b * mean(axis)
            size, turned = np.abs(w), w / np.abs(w)
            y = x.copy()
            pivot = x[:, self._pivot[0]] + 1j * x[:, self._pivot[1]]  # scaled, counted from the centre of the points
            for i, j in self.ground:
                place = a[:, 0] + w[:, 0] * (x[:, i] + 1j * x[:, j] - pivot)
                y[:, i], y[:, j] = place.real, place.imag
            y[:, self.lengths] *= size
            if self.point:
                local = (b / turned)[:, 0]
                y[:, self.point[0]], y[:, self.point[1]] = local.real, local.imag
            by = np.angle(turned)
            started = [batch.start] if self.counted_from_x and batch.start >= 0 else []
            turning = [*self.turning, *started]
            y[:, turning] = np.remainder(x[:, turning] + by + np.pi, TURN) - np.pi
            moved = t + by if self.counted_from_x and batch.free_timing else t
        good = np.all(np.isfinite(y), axis=1) & np.all(np.isfinite(moved), axis=1)
        return np.where(good[:, None], y, x), np.where(good[:, None], moved, t)

    @property
    def linear(self) -> list[int]:
        """Indices of the variables that follow from the others."""
        names = [*self.point, *self.turning, *(i for pair in self.ground for i in pair)]
        return [i for i in names if self.batch.names[i] != START]
