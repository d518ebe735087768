"""Lower bounds of timed path synthesis of a four-bar: the best linear variables in closed form, boxes of the proportions.

As complex numbers the points of the coupler are P_j = A + z exp(i t_j) + w u_j, with A the crank pivot, z the crank, u_j the
direction of the coupler and w the coupler point in it. A, z and w are linear, so the least sum of squares over them is known, and
only three proportions and the start angle are divided into boxes. With frame d, crank a, q = a exp(i theta) - d and Q = |q|^2 the
coupler of length b and the rocker of length c satisfy

    2 b u = f (b + c) - q,    f = (nu + i sqrt((Q - nu^2) (1 - Q / (b + c)^2))) / conj(q),    nu = c - b.

The crank turns fully if nu^2 <= (a - d)^2 and (b + c)^2 >= (a + d)^2, so the unknowns are angles: a : d = cos eta : sin eta,
nu = (a - d) sin omega, cos chi = (a + d) / (b + c). They contain every four-bar, up to infinitely long links. Where pivot and
direction are free the columns q and exp(i t_j) are the same, f replaces u, and the change of sign of the root is that of omega
(Roberts' cognate with coupler and rocker interchanged); otherwise cos omega < 0 stands for the other assembly mode.

The fit is bounded by `column_fit`. Positions where the root has a corner in the box, or whose model is poor, are left out:
the sum of squares only becomes smaller.

References
----------
J. M. McCarthy and G. S. Soh, Geometric Design of Linkages, 2nd ed., Springer 2011 (cognates of a four-bar).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.inner_four_bar import InnerFourBar
from optlink.linkage.vector2d import TURN, Array
from optlink.optimization.constraints import transmission_sides
from optlink.optimization.taylor_model import TINY, UNIT, UPWARD, TaylorModel, pairs
from optlink.problem.design import DesignProblem
from optlink.problem.requirements.base import START
from optlink.solvers.global_search.column_fit import SLACK, ColumnFit, Complex, as_real, changes
from optlink.solvers.global_search.lagrangian import OPEN, TESTS, BoxRecord

Mask = NDArray[np.bool_]

WIDE = 0.126  # share of the bounds beyond which a box is halved along its widest unknown
OMEGA = 1  # index of omega


@dataclass(frozen=True)
class FourBarUnknowns:
    """The quantities of a timed path of a four-bar, however it is written.

    `pivots`: names of the coordinates of the crank pivot, none in the origin; `direction`: name of the direction of the frame;
    `mark`: names of those of the coupler point. `frame`: bounds of the length of the frame [m]; `relative`: range of the crank
    angle from the frame [rad] at the start; `absolute`: that angle in the plane, None if a design variable changes it.
    """

    loop: InnerFourBar
    pivots: tuple[str, ...]
    direction: str
    mark: tuple[str, str]
    frame: tuple[float, float]
    relative: tuple[float, float]
    absolute: float | None

    @classmethod
    def of(cls, problem: DesignProblem) -> Self:
        """Return those of a problem.

        Raises
        ------
        ValueError
            if it has none.
        """
        loop, quantities, linkage = problem.four_bar, problem.quantities, problem.linkage
        mark = None if loop is None else linkage.marks.get((loop.coupler.body, problem.point))
        if loop is None:
            raise ValueError("the mechanism is not a four-bar")
        if mark is None or loop.coupler.start != loop.pin:
            raise ValueError(f"{problem.point} is not a point of the coupler that is measured from the crank")
        names = (*loop.names, *((loop.frame_length,) if loop.frame_length else ()), str(mark.along), str(mark.across))
        fixed = [name for name in names if name not in problem.free]
        if not loop.frame_length and not set(loop.ground) & set(problem.free):
            fixed.append("the frame")
        if fixed:
            raise ValueError(f"{fixed[0]} is fixed")
        frame, limit = problem.frame_bounds, problem.limits.frame_length
        if limit is not None:
            frame = max(frame[0], limit.bounds[0]), min(frame[1], limit.bounds[1])
        start = quantities[START].bounds if START in quantities else (0.0, 0.0)
        by_length, angle = bool(loop.frame_length), problem.frame_angle
        direction = linkage.datum if isinstance(linkage.datum, str) else ""
        turning = START in problem.free or direction in problem.free
        relative = start if by_length else (-math.pi, math.pi) if angle is None else (start[0] - angle, start[1] - angle)
        return cls(
            loop=loop,
            pivots=loop.ground[:2] if len(loop.ground) == 4 else (),
            direction=direction,
            mark=(str(mark.along), str(mark.across)),
            frame=frame,
            relative=relative,
            absolute=None if turning else start[0] + (quantities[direction].value if direction else 0.0),
        )

    def values(self, lengths: Sequence[float], pivot: Sequence[float], direction: float, arm: complex) -> dict[str, float]:
        """Return the quantities of a four-bar with a pivot [m], frame at an angle [rad] and coupler point [m]."""
        x, y = pivot
        values = dict(zip((*self.loop.names, self.loop.frame_length), lengths, strict=True))
        values |= dict(zip(self.mark, (float(arm.real), float(arm.imag)), strict=True)) | dict(
            zip(self.pivots, pivot, strict=False)
        )
        if self.direction:
            values[self.direction] = direction
        if not self.loop.frame_length:
            values[self.loop.ground[2]] = x + lengths[3] * math.cos(direction)
            values[self.loop.ground[3]] = y + lengths[3] * math.sin(direction)
        return {name: value for name, value in values.items() if name}


def unsuitable(problem: DesignProblem) -> str:
    """Return why a problem is not one that `TimedPathBounds` can bound; empty if it is."""
    if problem.four_bar is None:
        return "the mechanism is not a four-bar"
    if problem.requirement.kind != "path" or problem.data.offsets is None:
        return "the crank angles of the points are not prescribed"
    if problem.measure == "max":
        return 'the measure "max" is not a sum of squares'
    if problem.links:
        return "dimensions are linked"
    if problem.limits.crank == "span":
        return "the crank need not turn fully"
    if problem.mechanism.follows:
        return "the assembly mode continues through change points"
    try:
        FourBarUnknowns.of(problem)
    except ValueError as error:
        return str(error)
    return ""


class TimedPathBounds:
    """Lower bounds of the sum of squared distances [m^2] over boxes of eta, omega, chi, and the start angle where it is free.

    Lengths, coordinates and limits other than the frame's, `link_ratio` of the crank and transmission angles are left out: the
    bounds hold for more four-bars than the problem permits.

    Raises
    ------
    ValueError
        where `unsuitable` returns a reason.
    """

    def __init__(self, problem: DesignProblem) -> None:
        reason = unsuitable(problem)
        if reason:
            raise ValueError(reason)
        self.problem, data, free = problem, problem.data, set(problem.free)
        self.unknowns, quantities = FourBarUnknowns.of(problem), problem.quantities
        low, high = self.unknowns.relative
        self.start, self.started = low, low < high  # crank angle from the frame, and whether it is an unknown
        assert data.offsets is not None
        self.t, self.roots = data.offsets, data.roots
        self.turned = self.unknowns.absolute is None  # the crank column has a complex factor
        self.open = len(problem.mechanism.variants(problem.linkage)) > 1  # both assembly modes
        unknown_pivots = [name in free for name in self.unknowns.pivots] or [False, False]
        self.reduced = self.turned and all(unknown_pivots)  # f replaces u
        whole = self.turned and unknown_pivots[0] == unknown_pivots[1]
        self.unit = problem.size
        self.area = self.unit**2 / (len(self.t) if problem.measure == "rms" else 1)  # objective (rms: squared) of the sum 1
        pivots = zip(self.unknowns.pivots, problem.centre, strict=False)
        base = complex(*(c if name in free else quantities[name].value for name, c in pivots))
        targets = data.columns[:, 0] + 1j * data.columns[:, 1]
        self.points = (targets - base) / self.unit
        ones = np.ones(len(self.t), dtype=complex)
        crank = np.exp(1j * self.t) if self.turned else np.exp(1j * (self.t + (self.unknowns.absolute or 0.0)))
        columns = [factor * ones for factor, use in zip((1.0, 1j), unknown_pivots, strict=True) if use]
        self.columns: Complex = np.array([*columns, crank, 1j * crank] if self.turned else [*columns, crank], dtype=complex)
        self.low, self.high = self._ranges()
        rounding = 16.0 * len(self.t) * UNIT * float(np.max(self.roots) * np.max(np.abs(targets) + abs(base))) / self.unit
        weighted: Complex = self.columns * self.roots
        self.fit = ColumnFit(self.points * self.roots, weighted, whole=whole, size=self._largest(free), rounding=rounding)

    def _largest(self, free: set[str]) -> float:
        """Return a bound of the pivot and the crank, as parts of the column f too, in terms of the size of the curve."""
        quantities, known, ratio = self.problem.quantities, self.unknowns, self.problem.limits.link_ratio
        crank, coupler, _ = known.loop.names
        arm = math.hypot(*(max(abs(b) for b in quantities[name].bounds) for name in known.mark))
        longest = max(quantities[crank].bounds[1], known.frame[1])
        stretch = longest / quantities[coupler].bounds[0]  # of crank and frame over the coupler
        if ratio is not None and ratio.low is not None and ratio.low > 0.0 and ratio.high is not None:
            stretch = min(stretch, max(1.0, ratio.high) / ratio.low)
        base = sum(max(abs(b) for b in quantities[name].bounds) for name in known.pivots if name in free)
        return 1.001 * (base + math.hypot(*self.problem.centre) + longest + arm * (1.0 + stretch)) / self.unit

    # --- the fixed parts ------------------------------------------------------------------------------------------

    def _ranges(self) -> tuple[Array, Array]:
        """Return the bounds of the unknowns."""
        known, ratio = self.unknowns, self.problem.limits.link_ratio
        (a_low, a_high), (d_low, d_high) = self.problem.quantities[known.loop.names[0]].bounds, known.frame
        least, most = a_low / d_high, a_high / d_low if d_low > 0.0 else math.inf  # crank to frame
        if ratio is not None:
            least = max(least, -math.inf if ratio.low is None else ratio.low)
            most = min(most, math.inf if ratio.high is None else ratio.high)
        eta = math.atan(1.0 / most) * (1.0 - SLACK), min(math.atan(1.0 / least) * (1.0 + SLACK), 0.5 * math.pi)
        left = known.loop.side > 0
        omega = [-0.5 * math.pi * (1.0 + SLACK), 0.5 * math.pi * (1.0 + SLACK)]
        if not self.reduced and (self.open or left):
            omega[1] = 1.5 * math.pi * (1.0 + SLACK)
        if not self.reduced and left and not self.open:
            omega[0] = 0.5 * math.pi * (1.0 - SLACK)
        chi = (0.0, 0.5 * math.pi * (1.0 + SLACK))
        ranges = [eta, (omega[0], omega[1]), chi]
        if self.started:
            low, high = known.relative
            ranges.append((low, min(high, low + 2.0 * math.pi * (1.0 + SLACK))))
        low, high = np.array(ranges).T
        return low.copy(), high.copy()

    def left(self, point: Array) -> bool:
        """Return whether the four-bar at a point has the left assembly mode."""
        return self.unknowns.loop.side > 0 and not self.open if self.reduced else math.cos(point[OMEGA]) < 0.0

    def design(self, point: Array) -> dict[str, float]:
        """Return the four-bar at a point with the best linear variables: every quantity [m, rad], not within its bounds.

        Lengths are negative where the crank would have to point the other way.
        """
        a, d = math.cos(point[0]), math.sin(point[0])
        nu, total = (a - d) * math.sin(point[1]), (a + d) / max(math.cos(point[2]), 1e-6)
        start = float(point[3]) if len(point) > 3 else self.start
        left = self.left(point)
        nu = -nu if self.reduced and left else nu
        b, c = 0.5 * (total - nu), 0.5 * (total + nu)
        q = a * np.exp(1j * (self.t + start)) - d
        square = np.abs(q) ** 2
        root = np.sqrt(np.maximum((square - nu * nu) * (total * total - square), 0.0)) * (-1.0 if left else 1.0)
        u = ((nu * total + 1j * root) / np.conj(q) - q) / (2.0 * b)
        columns = as_real(np.array([*self.columns, u, 1j * u]) * self.roots)
        linear = np.linalg.lstsq(columns.T, as_real((self.points * self.roots)[None])[0], rcond=None)[0]
        crank = complex(linear[-4], linear[-3]) if self.turned else complex(linear[-3], 0.0)
        problem, known, size = self.problem, self.unknowns, (abs(crank) if self.turned else crank.real) / a * self.unit
        values = {name: quantity.value for name, quantity in problem.quantities.items()}
        pivot = [values[name] for name in known.pivots] or [0.0, 0.0]
        places = [k for k, name in enumerate(known.pivots) if name in problem.free]
        for k, x in zip(places, linear, strict=False):
            pivot[k] = float(problem.centre[k] + self.unit * x)
        absolute = known.absolute if known.absolute is not None else float(np.angle(crank))
        if known.absolute is None and START in problem.free and known.direction and known.direction not in problem.free:
            direction = values[known.direction]
        elif known.absolute is None and problem.frame_angle is not None and not known.direction:
            direction = problem.frame_angle
        else:
            direction = math.remainder(absolute - start, TURN)
        if START in problem.free:
            values[START] = start if known.loop.frame_length else math.remainder(start + direction, TURN)
        arm = complex(linear[-2], linear[-1]) * np.exp(-1j * direction) * self.unit
        return values | known.values((size * a, size * b, size * c, size * d), pivot, direction, arm)

    # --- boxes ----------------------------------------------------------------------------------------------------

    def columns_over(self, low: Array, high: Array) -> tuple[Array, Array, Mask, Mask]:
        """Return the column of w over boxes, and the slacks of the transmission limits.

        Returns
        -------
        coefficients : array (boxes, 1 + n + n (n + 1) / 2, 2 N)
            Of real parts and imaginary parts, weighted.
        remainder : array (boxes, 2 N)
        corner : array of bool (boxes,)
            Whether a model is only an interval.
        violated : array of bool (boxes,)
            Whether no design of the box has the required transmission angles.
        """
        with np.errstate(all="ignore"):
            unknowns = TaylorModel.unknowns(low, high)
            eta, omega, chi, *others = unknowns
            start: Any = others[0] if others else TaylorModel.constant(np.full((len(low), 1), self.start), low.shape[1])
            a, d = np.cos(eta), np.sin(eta)
            sin_omega, cos_omega, sin_chi, cos_chi = np.sin(omega), np.cos(omega), np.sin(chi), np.cos(chi)
            nu = (a - d) * sin_omega
            fold = (a - d) * cos_omega
            short = cos_chi / (a + d)  # 1 / (b + c)
            product = 4.0 * (a * d)
            half = 0.5 * (start + self.t)
            s, c = np.sin(half), np.cos(half)
            ss, cc = s * s, c * c
            near = product * ss + fold * fold  # Q - nu^2
            far = sin_chi * sin_chi + (product * (short * short)) * cc  # 1 - Q / (b + c)^2
            root, corner = _root(near * far)
            if not self.reduced:  # the other assembly mode
                middle = 0.5 * (low[:, OMEGA] + high[:, OMEGA])
                root = root * np.where(np.cos(middle) >= 0.0, 1.0, -1.0)[:, None]
            cos, sin = cc - ss, 2.0 * (s * c)
            x, y = a * cos - d, a * sin
            inverse = 1.0 / ((a - d) * (a - d) + product * ss)
            re, im = (nu * x - root * y) * inverse, (nu * y + root * x) * inverse
            if not self.reduced:
                re, im = re - short * x, im - short * y
            violated = self._violated(a, d, sin_omega, cos_chi)
        n = low.shape[1]
        coefficients = np.zeros((len(low), 1 + n + len(pairs(n)), 2 * len(self.t)))
        remainder = np.zeros((len(low), 2 * len(self.t)))
        limit = (1.0 if self.reduced else 2.0) * (1.0 + SLACK)  # of the size of the column
        for k, part in enumerate((re, im)):
            span = slice(k * len(self.t), (k + 1) * len(self.t))
            poor = ~(part.remainder < limit)
            block = np.where(poor, 0.0, part.coefficients) * self.roots
            coefficients[:, :, span] = np.moveaxis(block, 0, 1)
            remainder[:, span] = np.where(poor, limit, part.remainder) * self.roots * UPWARD
            corner = corner | poor
        straddles = np.zeros(len(low), dtype=bool)
        if not self.reduced and self.high[OMEGA] - self.low[OMEGA] > 4.0:  # both modes
            straddles = (low[:, OMEGA] < 0.5 * math.pi - 1e-9) & (high[:, OMEGA] > 0.5 * math.pi + 1e-9)
            remainder[straddles] = 2.0 * limit * float(np.max(self.roots))
            coefficients[straddles] = 0.0
        return coefficients, remainder, np.any(corner, axis=1) | straddles, violated

    def _violated(self, a: TaylorModel, d: TaylorModel, sin_omega: TaylorModel, cos_chi: TaylorModel) -> Mask:
        """Return whether a transmission limit over the revolution, or the alignment, is violated everywhere in a box."""
        far, near, square = (a + d) * (a + d), (a - d) * (a - d), cos_chi * cos_chi
        fold = near * (sin_omega * sin_omega) * square
        violated = np.zeros(a.remainder.shape, dtype=bool)
        for limit in transmission_sides(self.problem, self.unknowns.loop.joint):
            if limit.over != "revolution":
                continue
            if math.isfinite(limit.high):
                violated |= (limit.high * (far - fold) - (far + fold) + 2.0 * (near * square)).high < 0.0
            if math.isfinite(limit.low):
                violated |= ((far + fold) - 2.0 * (far * square) - limit.low * (far - fold)).high < 0.0
        return violated[:, 0]

    def bounded(self, low: Array, high: Array, threshold: float) -> BoxRecord:
        """Bound a batch of boxes; those whose lower bound is not below the threshold [m^2] are discarded."""
        boxes = len(low)
        coefficients, remainder, corner, violated = self.columns_over(low, high)
        has_threshold, fit = math.isfinite(threshold), self.fit
        level = threshold / self.area * (1.0 + SLACK) if has_threshold else 0.0
        none = np.zeros(boxes, dtype=np.intp)
        bound, size, value, worst = fit.bounds(coefficients, remainder, none, level)
        left = np.flatnonzero((bound < level) & ~violated) if has_threshold else none[:0]
        dropped, worst = np.zeros((left.size, 0), dtype=np.intp), worst[left]
        for _ in range(fit.largest):  # leave out one more position
            if not left.size:
                break
            dropped = np.sort(np.concatenate([dropped, worst[:, None]], axis=1), axis=1)
            chosen = np.array([fit.index[tuple(row)] for row in dropped.tolist()], dtype=np.intp)
            other, _, _, worst = fit.bounds(coefficients[left], remainder[left], chosen, level)
            bound[left] = np.maximum(bound[left], other)
            go = other < level
            left, dropped, worst = left[go], dropped[go], worst[go]
        proven = (bound >= level) & has_threshold
        test = np.where(violated, TESTS.index("limits"), np.where(proven, TESTS.index("objective"), OPEN)).astype(np.int8)
        bound = np.where(proven, threshold, bound * self.area * (1.0 - SLACK) if has_threshold else 0.0)
        width = (high - low) / (self.high - self.low)
        # of what counts, and of the model itself, with which its remainder grows
        change = changes(size) * changes(np.sqrt(np.sum(coefficients * coefficients, axis=2)))
        split = np.where(np.max(width, axis=1) > WIDE, np.argmax(width, axis=1), np.argmax(change, axis=1))
        centre = np.where(corner | violated, np.inf, value * self.area)
        return BoxRecord(bound, test, np.zeros((boxes, 0)), split, centre, low.copy(), high.copy())


def _root(x: TaylorModel) -> tuple[TaylorModel, Mask]:
    """Return the square root, as an interval where its argument is not positive in the whole box, and where that is."""
    root = np.sqrt(x)
    corner = ~np.isfinite(root.remainder)
    if np.any(corner):
        low, high = np.sqrt(np.maximum(x.low, 0.0)), np.sqrt(np.maximum(x.high, 0.0))
        coefficients = np.where(corner, 0.0, root.coefficients)
        coefficients[0] = np.where(corner, 0.5 * (low + high), coefficients[0])
        root = TaylorModel(coefficients, np.where(corner, 0.5 * (high - low) + SLACK * high + TINY, root.remainder), x.count)
    return root, corner
