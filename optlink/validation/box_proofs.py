"""Proofs, in ball arithmetic, that a box of designs holds no feasible design with an objective below a bound."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import arb

from optlink.linkage.vector2d import Array
from optlink.problem.function import DesignProblem
from optlink.problem.path import PathProblem
from optlink.validation.ball_formulas import BallProblem, Deviation
from optlink.validation.balls import Ball, box_minimum, lower_bound, positive_definite, tangent_bound

DEPTH = 40  # times that a box is halved at most
PIECES = 20_000  # parts of one box that are bounded at most
TANGENTS = 4  # designs at which a tangent plane is tried
LAWSON = 12  # steps of the weights of a largest deviation
TOP = 1e-3  # share of the largest deviation within which others are as large at the design
NEAR_ACTIVE = 1e-6  # slack of a limit below which it is active at the design


@dataclass(frozen=True)
class _Lagrangian:
    """A Lagrangian that can be evaluated again at other designs: weights of the squares, multipliers of the slacks."""

    weights: Sequence[float]
    multipliers: Mapping[int, float]


class Prover:
    """Proofs for the boxes of one assembly mode.

    Parameters
    ----------
    model : DesignProblem or PathProblem
    lower_bound : float
        Bound of the objective; not finite for the proof that no design is feasible.
    design : mapping of str to float, optional
        The certified design, for the weights of a largest deviation.
    """

    def __init__(self, model: DesignProblem | PathProblem, lower_bound: float, design: Mapping[str, float] | None) -> None:
        self.problem, self.pieces = BallProblem(model), 0
        self.squared = self.problem.measure == "sum of squares"
        self.target: Any = None
        if math.isfinite(lower_bound):
            bound = arb(lower_bound)
            self.target = bound if self.squared else bound * bound
        self.sizes = np.ones(self.problem.positions)  # of the deviations in the last boxes: the largest are bounded first
        self._design = design
        self._known: _Lagrangian | None = None
        self._sought = False

    # --- the design ------------------------------------------------------------------------------------------------

    def design(self, design: Mapping[str, float]) -> tuple[float, float, float]:
        """Return objective, least slack of all limits, and largest difference from bounds, fixed values and start angles.

        Parameters
        ----------
        design : mapping of str to float
            Every quantity [SI].
        """
        model, problem = self.problem.problem, self.problem
        differs = 0.0
        for name, quantity in model.quantities.items():
            if name not in design:
                return math.nan, math.nan, math.inf
            low, high = quantity.bounds
            differs = max(differs, low - design[name], design[name] - high)
        values = problem.values([design[name] for name in problem.names], None)
        starts = problem.starts(values)
        if isinstance(model, DesignProblem):
            for name, value in (("phi0", starts[0][1]), ("psi0", starts[0][2])):
                away = abs(math.remainder(float(value.value) - design.get(name, math.nan), math.tau))
                differs = max(differs, away if math.isfinite(away) else math.inf)
        slacks = [slack.value.lower() for _, slack in problem.slacks(values, constant=True)]
        if any(not slack.is_finite() for slack in slacks):
            return math.nan, math.nan, differs
        objective = self._value(problem.deviations(values, starts[0]))
        if isinstance(model, DesignProblem) and model.everywhere:  # the largest deviation of the whole range, not of positions
            from optlink.validation.function import validate

            objective = validate(model, design).objective
        return objective, min((float(slack) for slack in slacks), default=0.0), differs

    def _value(self, deviations: list[list[Deviation]]) -> float:
        squares = [sum((deviation.least * deviation.least for deviation in position), arb(0)) for position in deviations]
        if any(deviation.model is None for position in deviations for deviation in position):
            return math.nan
        if self.problem.measure == "max":
            return math.sqrt(max(float(square) for square in squares))
        total = float(sum(squares, arb(0)))
        return total if self.squared else math.sqrt(total / len(squares))

    # --- boxes -----------------------------------------------------------------------------------------------------

    def proven(self, low: Array, high: Array, limits: Sequence[str], multipliers: Mapping[int, float]) -> str:
        """Return why a box cannot be proven; empty if it is.

        Parameters
        ----------
        low, high : array (n,)
            Corners.
        limits : sequence of str
            Keys of the limits that the multipliers belong to.
        multipliers : mapping of int to float
            By the index of the limit.
        """
        stack = [(low.astype(float), high.astype(float), 0)]
        begin = self.pieces
        while stack:
            a, b, depth = stack.pop()
            verdict, direction = _Piece(self, a, b).verdict(limits, multipliers)
            self.pieces += 1
            if verdict == "proven":
                continue
            if verdict == "refuted":
                place = ", ".join(f"{x:.9g}" for x in 0.5 * (a + b))
                lower = "" if self.target is None else " and has a lower objective"
                return f"the design {place} in it violates none of the limits{lower}"
            if depth >= DEPTH or self.pieces - begin >= PIECES:
                return f"no proof after {self.pieces - begin} parts"
            middle = 0.5 * (a[direction] + b[direction])
            first, last = b.copy(), a.copy()
            first[direction] = last[direction] = middle
            stack += [(a, first, depth + 1), (last, b, depth + 1)]
        return ""

    def known(self) -> _Lagrangian | None:
        """Return weights and multipliers from the conditions of optimality at the certified design."""
        if self._sought or self._design is None:
            return self._known
        self._sought = True
        from scipy.optimize import nnls

        problem = self.problem
        width = problem.bounds[:, 1] - problem.bounds[:, 0]
        x = [float(self._design[name]) for name in problem.names]
        values = problem.values(x, [arb(float(w)) for w in width], over=False)
        squares = [_square(position) for position in problem.deviations(values, problem.starts(values)[0])]
        slacks = [slack for _, slack in problem.slacks(values)]
        sizes = [math.nan if square is None else float(square.centre) for square in squares]
        inside = np.minimum(np.array(x) - problem.bounds[:, 0], problem.bounds[:, 1] - x) > NEAR_ACTIVE * width
        top = [k for k, size in enumerate(sizes) if size >= (1.0 - TOP) * np.nanmax(sizes)]
        active = [k for k, slack in enumerate(slacks) if abs(float(slack.centre)) < NEAR_ACTIVE and slack.known]
        columns = [_floats(squares[k]) for k in top] + [-_floats(slacks[k]) for k in active]
        rows = np.array(columns).T[inside]
        scale = 1e3 * max(float(np.max(np.abs(rows), initial=0.0)), 1e-300)
        total = np.concatenate([np.full(len(top), scale), np.zeros(len(active))])
        multipliers = nnls(np.vstack([rows, total]), np.append(np.zeros(len(rows)), scale))[0]
        weights = np.zeros(len(squares))
        weights[top] = multipliers[: len(top)]
        self._known = _Lagrangian(_normalised(weights), dict(zip(active, multipliers[len(top) :].tolist(), strict=True)))
        return self._known


class _Piece:
    """One part of a box."""

    def __init__(self, prover: Prover, low: Array, high: Array) -> None:
        self.prover, self.problem, self.target = prover, prover.problem, prover.target
        self.low, self.high = low, high
        self.centre = [float(x) for x in 0.5 * (low + high)]
        sides = zip(self.centre, low, high, strict=True)
        self.scale = [(arb(float(b)) - arb(c)).max(arb(c) - arb(float(a))).upper() for c, a, b in sides]
        self.values = self.problem.values(self.centre, self.scale)

    def verdict(self, limits: Sequence[str], multipliers: Mapping[int, float]) -> tuple[str, int]:
        """Return "proven", "refuted" or "open", and the unknown along which an open part should be halved.

        Parameters
        ----------
        limits : sequence of str
        multipliers : mapping of int to float
        """
        width = (self.high - self.low) / (self.problem.bounds[:, 1] - self.problem.bounds[:, 0])
        named = self.problem.slacks(self.values)
        slacks = [slack for _, slack in named]
        if any(float(slack.centre) < 0.0 and lower_bound(-slack) > 0 for slack in slacks):
            return "proven", 0
        fits = tuple(key for key, _ in named) == tuple(limits)
        used = {k: value for k, value in multipliers.items() if fits and value > 0.0 and slacks[k].known}
        if used and lower_bound(_combined(Ball.constant(0.0), slacks, used)) > 0:
            return "proven", 0
        if self.target is None:
            feasible = all(slack.centre > 0 for slack in slacks)
            return "refuted" if feasible else "open", _direction(slacks, width)
        better, open_ones = False, []
        starts = self.problem.starts(self.values)
        for start in starts:
            proof = self._objective(start, slacks, used, single_start=len(starts) == 1)
            if proof is None:
                continue
            models, value = proof
            better |= len(starts) == 1 and bool(value < self.target) and all(slack.centre > 0 for slack in slacks)
            open_ones += models
        if not open_ones:
            return "proven", 0
        return "refuted" if better else "open", _direction(open_ones, width)

    def _objective(
        self, start: Any, slacks: list[Ball], used: Mapping[int, float], *, single_start: bool
    ) -> tuple[list[Ball], Any] | None:
        """Return the weighted objective and its value at the centre; None if it is proven to be at least the target.

        Parameters
        ----------
        start : tuple
            See `BallProblem.starts`.
        slacks : list of Ball
        used : mapping of int to float
            Multipliers.
        single_start : bool
            Whether it is the only start position: then that of any design in the box is on the same branch.
        """
        most, target = self.problem.measure == "max", self.target * (self.problem.positions if self._mean else 1)
        sizes, total = self.prover.sizes, arb(0)
        deviations: list[list[Deviation]] = [[] for _ in sizes]
        for k in np.argsort(-sizes):
            deviations[k] = self.problem.deviation(int(k), self.values, start)
            least = sum((one.least * one.least for one in deviations[k]), arb(0))
            sizes[k] = float(least)
            total = total.max(least) if most else total + least
            if total >= target:
                return None
        squares = [_square(position) for position in deviations]
        usable = [square for square in squares if square is not None]
        value = arb("nan")
        if len(usable) == len(squares):
            centres = [square.centre for square in usable]
            value = max(centres, key=float) if most else sum(centres, arb(0))
            value = value / (self.problem.positions if self._mean else 1)
        models = []
        for tried in self._lagrangians(squares, used):
            plain = sum((s * w for s, w in zip(squares, tried.weights, strict=True) if s is not None), Ball.constant(0.0))
            if not most:
                rest = [
                    sum((o.least * o.least for o in p), arb(0)) for p, s in zip(deviations, squares, strict=True) if s is None
                ]
                plain = plain + Ball.constant(sum(rest, arb(0)) * arb(tried.weights[0]))
            models.append(plain)
            if plain.slope is None:
                continue
            if lower_bound(plain) >= self.target:
                return None
            kept = {k: m for k, m in tried.multipliers.items() if slacks[k].known}
            whole = _combined(plain, slacks, kept) if kept else plain
            if kept and lower_bound(whole) >= self.target:
                return None
            smooth = single_start and len(usable) == len(squares)
            if smooth and positive_definite(whole.hessian) and self._tangent(whole, tried.weights, kept):
                return None
        return models, value

    @property
    def _mean(self) -> bool:
        return self.problem.measure == "rms"

    def _lagrangians(self, squares: list[Ball | None], used: Mapping[int, float]) -> Iterator[_Lagrangian]:
        count = len(squares)
        if self.problem.measure != "max":
            yield _Lagrangian([1.0 / count if self._mean else 1.0] * count, used)
            return
        known = self.prover.known()
        if known is not None:
            yield known
        yield _Lagrangian(_lawson(squares), used)

    def _tangent(self, whole: Ball, weights: Sequence[float], multipliers: Mapping[int, float]) -> bool:
        """Return whether a tangent plane of the convex Lagrangian at about its minimum is at least the target."""
        n = len(self.centre)
        convex = np.array([float(x) for x in whole.hessian.entries()]).reshape(n, n)
        convex = 0.5 * (convex + convex.T)
        scale = np.array([float(s) for s in self.scale])
        point, model = np.zeros(n), whole
        for _ in range(TANGENTS):
            point = box_minimum(_floats(model), convex, point)
            x = [
                min(max(c + s * d, float(a)), float(b))
                for c, s, d, a, b in zip(self.centre, scale, point, self.low, self.high, strict=True)
            ]
            values = self.problem.values(x, self.scale, over=False)
            start = self.problem.starts(values)[0]
            squares = [_square(position) for position in self.problem.deviations(values, start)]
            if any(square is None for square in squares):
                return False
            plain = sum((s * w for s, w in zip(squares, weights, strict=True) if s is not None), Ball.constant(0.0))
            slacks = [slack for _, slack in self.problem.slacks(values)] if multipliers else []
            model = _combined(plain, slacks, multipliers)
            away = [(arb(a) - arb(c)) / s for a, c, s in zip(x, self.centre, self.scale, strict=True)]
            if tangent_bound(model, away) >= self.target:
                return True
            if model.centre < self.target:
                return False
        return False


def _square(position: list[Deviation]) -> Ball | None:
    """Return the squared size of a deviation; None if a component is unknown."""
    if any(deviation.model is None for deviation in position):
        return None
    total = Ball.constant(0.0)
    for deviation in position:
        assert deviation.model is not None
        total = total + deviation.model * deviation.model
    return total


def _combined(objective: Ball, slacks: Sequence[Ball], multipliers: Mapping[int, float]) -> Ball:
    """Return the Lagrangian: the objective minus multipliers times slacks."""
    for k, multiplier in multipliers.items():
        objective = objective - slacks[k] * multiplier
    return objective


def _floats(model: Ball | None) -> Array:
    assert model is not None
    return np.array([float(x) for x in model.slope.entries()])


def _direction(models: Sequence[Ball], width: Array) -> int:
    """Return the unknown that changes the first quantity most, or the widest if none is known."""
    for model in models:
        if model.slope is not None and model.known:
            n = len(width)
            change = np.abs(_floats(model)) + np.abs([float(x.abs_upper()) for x in model.hessian.entries()]).reshape(n, n).sum(
                axis=1
            )
            if np.all(np.isfinite(change)) and np.any(change > 0.0):
                return int(np.argmax(np.where(width > 0.0, change, -1.0)))
    return int(np.argmax(width))


def _normalised(weights: Array) -> list[float]:
    """Return weights with a sum of at most 1."""
    total = float(np.sum(weights))
    return [float(w) * (1.0 - 1e-14 * len(weights)) / total for w in weights] if total > 0.0 else [0.0] * len(weights)


def _lawson(squares: Sequence[Ball | None]) -> list[float]:
    """Return weights of the positions that raise the least weighted sum, by the sizes of their linear parts at its minimum.

    References
    ----------
    C. L. Lawson, Contributions to the theory of linear least maximum approximation, thesis, UCLA 1961.
    """
    usable = [k for k, square in enumerate(squares) if square is not None]
    weights = np.zeros(len(squares))
    if not usable:
        return _normalised(weights)
    value = np.array([float(squares[k].centre) for k in usable])  # type: ignore[union-attr]
    slope = np.array([_floats(squares[k]) for k in usable])
    root = np.sqrt(np.maximum(value, 1e-300))
    linear = slope / (2.0 * root[:, None])  # of the deviation itself
    lawson_weights = np.full(len(usable), 1.0 / len(usable))
    for _ in range(LAWSON):
        scaled = linear * lawson_weights[:, None]
        point = box_minimum(scaled.T @ root, scaled.T @ linear)
        sizes = lawson_weights * np.abs(root + linear @ point)
        if not float(np.sum(sizes)) > 0.0:
            break
        lawson_weights = sizes / np.sum(sizes)
    weights[usable] = lawson_weights
    return _normalised(weights)
