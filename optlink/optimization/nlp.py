"""NLP: one scaled nonlinear programme with exact derivatives and a label and unit for every row; see `programme.build`."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol, Self

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import TURN, Array, all_finite
from optlink.optimization.mapped_terms import MappedTerms
from optlink.optimization.terms import DEGREES, PLAIN, ConstraintRow, ErrorMeasure, Scale, millimetres
from optlink.problem.design import EPIGRAPH
from optlink.problem.machine.model import Problem
from optlink.problem.quantity import Quantity, quantity_key
from optlink.problem.targets.law import Law
from optlink.symbolic import BufferedFunction, CompiledFunction, NumpyEvaluator, packed, unpacked


@dataclass(frozen=True)
class Variable:
    """A component of the design vector: x = (value - origin) / size. `key`: that of the quantity in the problem file. `periodic`:
    an angle whose values a revolution apart are one design."""

    name: str
    size: float
    scale: Scale
    origin: float = 0.0
    key: str = ""
    periodic: bool = False

    def scaled(self, value: float) -> float:
        """Return the component of the design vector for a value [SI]."""
        return (value - self.origin) / self.size

    def value(self, component: Any) -> Any:
        """Return the value [SI], a number or symbol, for a component of the design vector."""
        return self.origin + self.size * component


def scaled_variable(problem: Problem, name: str, size: float, *, periodic: bool, origin: float = 0.0) -> Variable:
    """Return the scaling of a quantity: a length or coordinate, counted from an origin, by a size [m]; others by 1."""
    key = quantity_key(problem, name)
    periodic = periodic and not any(name in link.names.values() for link in problem.links.values())
    if problem.quantities[name].in_metres:
        return Variable(name, size, millimetres(size, origin), origin, key)
    scale = DEGREES if problem.quantities[name].kind == "angle" else PLAIN
    return Variable(name, 1.0, scale, key=key, periodic=periodic)


THREADED = 10_000  # elements from which BLAS shares a dot product among threads, which takes longer than any other test


class NLPValues(NamedTuple):
    """The NLP at one x: objective f, its gradient, rows g and their Jacobian. Not finite where undefined."""

    f: float
    gradient: Array
    g: Array
    jacobian: Array

    @property
    def finite(self) -> bool:
        """Whether all values are finite."""
        flat = self.jacobian.ravel(order="K")
        squares = self.gradient @ self.gradient + self.g @ self.g  # finite only if every value is
        if flat.size < THREADED:
            squares += flat @ flat
            if math.isfinite(self.f) and math.isfinite(squares):
                return True
        return math.isfinite(self.f) and all(all_finite(a) for a in (self.gradient, self.g, flat))


FEW = 4  # free quantities up to which casadi differentiates a whole programme sooner than its terms at one position
MAPPED = "mapped "  # prefix of the parts of `NLP.mapped` in a pickle


@dataclass(frozen=True)
class NLP:
    """Nonlinear programme: minimise f(x, p) subject to low <= g(x, p) <= high, x_low <= x <= x_high.

    `x` (n,) are the scaled design variables (and, last, the largest error of a minimax problem); `p` is the scale of the
    objective followed by the fixed quantities, the relevant tolerances and the exchange points, so that they can be varied
    without retracing.
    """

    variables: tuple[Variable, ...]
    fixed: tuple[str, ...]
    rows: tuple[ConstraintRow, ...]
    measure: ErrorMeasure
    x_start: Array
    x_low: Array
    x_high: Array
    p: Array
    x_symbol: Any
    p_symbol: Any
    f_expression: Any
    g_expression: Any
    residual_expression: Any
    exact: float = 1e-9  # largest residual that counts as zero
    helpers: frozenset[str] = frozenset({EPIGRAPH})  # variables and rows that formulate the objective rather than a limit
    factor: float = 1.0  # from f * p[0] to the measure of the residuals (for rms: their mean square)
    states: frozenset[str] = frozenset()  # variables and rows that are never relaxed, such as those defined by equations
    constants: tuple[Variable, ...] = ()  # the fixed quantities and tolerances in `p`, from its second component on
    position_symbol: Any = None  # crank rotation from the start, tabulated output: a position of the requirement
    position_expression: Any = None  # the residuals there, of which `residual_expression` has those of every position
    place_expression: Any = None  # crank angles [rad] of the rows, those of limits over a motion (`ConstraintRow.periodic`)
    smoothing: int = 0  # index in `p` of the smoothing of a scatter (`optlink.problem.tolerances.SMOOTHED`); 0: none
    exchange_rows: tuple[int, int] = (0, 0)  # index of the first row of the exchange points, number of rows per position
    cycle: bool = False  # of a machine cycle
    recipe: Mapping[str, Any] = field(default_factory=dict, compare=False)  # what it is built from, beside its problem
    level_symbols: tuple[Any, ...] = ()  # for each unknown that is the largest value of a term, the values whose largest it is
    first_level: int = 0  # index of the first of these unknowns
    level_slopes: tuple[float, ...] = ()  # change of the objective [SI] with each
    mapped: MappedTerms | None = field(default=None, compare=False)  # the same programme by vectors of positions
    terms: Any = field(default=None, compare=False)  # the quantities of the machine: an `optlink.optimization.courses.TermCourse`
    first_event: int = 0  # index of the first crank angle at which a stroke ends, if these are unknowns
    cache: dict[str, Any] = field(default_factory=dict, compare=False)  # functions compiled for this NLP by back ends

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes without compiled functions, which are compiled again when needed."""
        state = {name: value for name, value in vars(self).items() if not isinstance(value, CompiledFunction)}
        if self.mapped is not None:  # its symbols are those of the programme
            state |= {f"{MAPPED}{name}": value for name, value in self.mapped.parts.items()}
        return packed(state | {"cache": {}, "mapped": None, "rows": tuple(replace(row, value=None) for row in self.rows)})

    def __setstate__(self, state: dict[str, Any]) -> None:
        attributes = unpacked(state)
        parts = {name: attributes.pop(name) for name in list(attributes) if name.startswith(MAPPED)}
        if parts:
            attributes["mapped"] = MappedTerms(**{name.removeprefix(MAPPED): value for name, value in parts.items()})
        rows = tuple(replace(row, value=attributes["g_expression"][k]) for k, row in enumerate(attributes["rows"]))
        vars(self).update(attributes | {"rows": rows})

    def copy(self) -> Self:
        """Return the same programme with parameters of its own; the compiled functions are shared."""
        other = object.__new__(type(self))
        vars(other).update(vars(self) | {"p": self.p.copy()})
        return other

    def again(self, **numbers: Any) -> Self:
        """Return the programme with other parameters, bounds and start, and the compiled functions of this one."""
        other, kinds = object.__new__(type(self)), (BufferedFunction, casadi.Function)
        names = {one.name for one in fields(self)}
        vars(other).update({name: v for name, v in vars(self).items() if name in names or isinstance(v, kinds)} | numbers)
        compiled = ((key, v) for key, v in self.cache.items() if isinstance(v[0] if isinstance(v, tuple) else v, kinds))
        vars(other)["cache"] = dict(compiled)
        return other

    def bounded(self, x_low: Array, x_high: Array) -> Self:
        """Return a `copy` with other bounds of x."""
        other = self.copy()
        vars(other).update({"x_low": x_low, "x_high": x_high})
        for name in ("lower", "upper", "around"):
            vars(other).pop(name, None)
        return other

    @cached_property
    def low(self) -> Array:
        """Lower bounds of the rows."""
        return np.array([row.low for row in self.rows])

    @cached_property
    def high(self) -> Array:
        """Upper bounds of the rows."""
        return np.array([row.high for row in self.rows])

    @cached_property
    def lower(self) -> Array:
        """Lower bounds of x, then of the rows."""
        return np.concatenate([self.x_low, self.low])

    @cached_property
    def upper(self) -> Array:
        """Upper bounds of x, then of the rows."""
        return np.concatenate([self.x_high, self.high])

    def _compiled(self, *outputs: Any) -> CompiledFunction:
        return CompiledFunction([self.x_symbol, self.p_symbol], list(outputs))

    @cached_property
    def _values(self) -> CompiledFunction:
        return self._compiled(self.f_expression, self.g_expression)

    @property
    def programme(self) -> dict[str, Any]:
        """The programme for casadi.nlpsol: x, p, f and g."""
        if self.mapped is not None:
            return self.mapped.programme
        return {"x": self.x_symbol, "p": self.p_symbol, "f": self.f_expression, "g": self.g_expression}

    @property
    def derivatives(self) -> MappedTerms | None:
        """The terms if their derivatives are made at one position; None if casadi differentiates `programme`."""
        if self.mapped is not None and (self.cycle or self.mapped.local > FEW):
            return self.mapped
        return None

    @cached_property
    def _all(self) -> CompiledFunction:
        if self.derivatives is not None:
            return self.derivatives.values
        x, p, f, g = self.programme.values()
        return CompiledFunction([x, p], [f, casadi.gradient(f, x), g, casadi.jacobian(g, x)])

    @cached_property
    def _residuals(self) -> CompiledFunction:
        return self._compiled(self.residual_expression)

    @cached_property
    def _residual_slopes(self) -> CompiledFunction:
        return self._compiled(casadi.jacobian(self.residual_expression, self.x_symbol))

    def take_hessian(self, function: Any) -> None:
        """Use the Hessian of the Lagrangian that a back end has generated, unless there is one: generating it takes long.

        `function`: (x, p, factor of the objective, multipliers) -> upper triangle.
        """
        if "_hessian" not in vars(self):
            vars(self)["_hessian"] = _symmetric(function)

    @cached_property
    def _hessian(self) -> BufferedFunction:
        if self.derivatives is not None:
            return _symmetric(self.derivatives.hessian)
        known = casadi.Function("programme", self.programme, ["x", "p"], ["f", "g"])
        lagrangian = {"gamma": ["f", "g"]}
        return _symmetric(known.factory("hessian", ["x", "p", "lam:f", "lam:g"], ["triu:hess:gamma:x:x"], lagrangian))

    def values(self, x: Array, p: Array) -> tuple[float, Array]:
        """Return objective and rows."""
        f, g = self._values(x, p)
        return float(f[0]), g

    def at(self, x: Array, p: Array) -> NLPValues:
        """Return objective, rows and their exact first derivatives."""
        f, gradient, g, jacobian = self._all(x, p)
        return NLPValues(float(f[0]), gradient, g, jacobian.reshape((len(g), len(x)), order="F"))

    def hessian(self, x: Array, p: Array, multipliers: Array) -> Array:
        """Return the exact Hessian (n, n) of the Lagrangian f + multipliers . g."""
        return self._hessian(x, p, multipliers)[0].reshape(len(x), len(x))

    def residuals(self, x: Array, p: Array | None = None) -> Array:
        """Return the residuals of the objective, neither scaled nor smoothed."""
        p = (self.p if p is None else p).copy()
        if self.smoothing:
            p[self.smoothing] = 0.0
        return self._residuals(x, p)[0]

    def residual_derivatives(self, x: Array) -> Array:
        """Return the exact derivatives (residuals, n) of the residuals with respect to x."""
        return self._residual_slopes(x, self.p)[0].reshape((-1, len(x)), order="F")

    def design(self, x: Array) -> dict[str, float]:
        """Return the design variables of the problem [SI] at x."""
        own = ((v, y) for v, y in zip(self.variables, x, strict=True) if v.name not in self.states)
        return {v.name: v.value(float(y)) for v, y in own if not v.name.startswith(EPIGRAPH)}

    def x_of(self, values: Mapping[str, float], *, bounded: bool = True) -> Array:
        """Return x for values of the design variables [SI], with the ends of strokes and the least of largest values.

        `bounded`: values beyond a bound are moved to it.
        """
        x = np.array([v.scaled(values.get(v.name, 0.0)) for v in self.variables])
        x[self.first_event : self.first_level] = self.x_start[self.first_event : self.first_level]
        return self.lifted(np.clip(x, self.x_low, self.x_high) if bounded else x)

    @property
    def around(self) -> NDArray[np.bool_]:
        """Whether each component of x is an angle free over a full turn (n,): its bounds, a revolution apart, are no limits."""
        return np.array([v.periodic for v in self.variables], dtype=bool) & (self.x_high - self.x_low >= TURN - 1e-9)

    @property
    def exchange_count(self) -> int:
        """Number of exchange points."""
        return len(self.p) - 1 - len(self.constants) - (self.smoothing > 0)

    @property
    def exchange_points(self) -> Array:
        """The exchange points, see `set_exchange_points`."""
        return self.p[len(self.p) - self.exchange_count :].copy()

    def set_exchange_points(self, offsets: Array) -> None:
        """Set the last exchange points (at most `exchange_count`): crank rotations [rad], or shares of the motion or stroke."""
        self.p[len(self.p) - len(offsets) :] = offsets

    def spread_exchange_points(self) -> None:
        """Set the exchange points to evenly spaced shares, half-way between the positions of a grid."""
        self.set_exchange_points((np.arange(self.exchange_count) + 0.5) / max(1, self.exchange_count))

    def limit(self, entry: int, low: float | None, high: float | None) -> None:
        """Move bounds (scaled; None: not) of a component of x, or from n on of a row, in place; `rows` keep the original."""
        ends = (low, self.lower, self.x_low, self.low), (high, self.upper, self.x_high, self.high)
        for bound, both, own, rows in ends:
            if bound is not None:
                place, index = (own, entry) if entry < len(own) else (rows, entry - len(own))
                both[entry] = place[index] = bound

    def set_bounds(self, low: Array, high: Array) -> None:
        """Move the bounds (scaled) of all components of x in place."""
        self.lower[: len(low)] = self.x_low[:] = low
        self.upper[: len(high)] = self.x_high[:] = high

    def wrapped(self, x: Array) -> Array:
        """Return x with every angle free over a full turn moved by a revolution towards its bounds."""
        return x - TURN * self.around * ((x > self.x_high) * 1.0 - (x < self.x_low))

    @cached_property
    def _levels(self) -> CompiledFunction:
        return self._compiled(*self.level_symbols)

    @property
    def given(self) -> dict[str, float]:
        """Fixed quantities [SI], which are parameters."""
        values = zip(self.constants, self.p[1:].tolist(), strict=False)
        return {v.name: v.value(value) for v, value in values if v.name in self.fixed}

    def lifted(self, x: Array) -> Array:
        """Return the same design with its own events, if they match, and every largest value that is an unknown at its least."""
        events = self.terms is not None and bool(self.terms.events)
        if not self.level_symbols and not events:
            return x
        x = x.copy()
        angles = self.terms.event_angles(self.given | self.design(x)) if events else None
        if angles is not None:
            x[self.first_event : self.first_level] = angles
        if not self.level_symbols:
            return x
        for k, values in enumerate(self._levels(x, self.p)):
            largest = float(np.max(values))
            x[self.first_level + k] = largest if math.isfinite(largest) else 1.0
        return x


def _symmetric(function: Any) -> CompiledFunction:
    """Return (x, p, multipliers) -> Hessian from a function whose result is its upper triangle; see `NLP.take_hessian`."""
    inputs = [casadi.MX.sym("given", function.sparsity_in(i)) for i in (0, 1, 3)]
    return CompiledFunction(inputs, [casadi.triu2symm(function(inputs[0], inputs[1], 1.0, inputs[2]))])


SMALLEST_SCALE = 1e-6  # least scale of the objective: for an exact solution, rounding errors must not be magnified


def boxed(quantity: Quantity, variable: Variable) -> tuple[float, float, float]:
    """Return the scaled bounds and starting value of a design variable."""
    low, high = quantity.bounds
    return variable.scaled(low), variable.scaled(high), variable.scaled(quantity.value)


# A nonlinear programme at many points, with many values of its parameters; every figure of a point is the same in any batch.
#
# The residual of a motion law at one fixed position is traced once with its derivatives, and evaluated by numpy at all positions
# of all points. Other programmes are evaluated point by point.


@dataclass(frozen=True)
class BatchValues:
    """A programme at many points: arrays over the points.

    `objective` (points,) is that of the measure; `gradient` (points, n) belongs to the scaled objective, `values` (points, n + m)
    are the variables and the rows, `jacobian` (points, n + m, n) their derivatives, `hessian` (points, n, n) is that of the
    Lagrangian.
    """

    objective: Array
    gradient: Array
    values: Array
    jacobian: Array
    hessian: Array


class Evaluator(Protocol):
    """Evaluates a programme of `size` variables at x (points, n).

    p (points, k) are its parameters, the multipliers (points, n + m) those of the bounds of the variables and of the rows.
    """

    size: int

    def __call__(self, x: Array, p: Array, multipliers: Array) -> BatchValues:
        """Evaluate the programme."""


class PointwiseNLP:
    """Evaluates any programme, one point after the other."""

    def __init__(self, nlp: NLP) -> None:
        self.nlp, self.size = nlp, len(nlp.variables)

    def __call__(self, x: Array, p: Array, multipliers: Array) -> BatchValues:
        """Evaluate the programme; see `Evaluator`."""
        each, unit = [], np.eye(self.size)
        for y, q, prices in zip(x, p, multipliers, strict=True):
            point, objective = self.nlp.at(y, q), self.nlp.measure.of(self.nlp.residuals(y, q))
            values, jacobian = np.concatenate([y, point.g]), np.concatenate([unit, point.jacobian])
            each.append((objective, point.gradient, values, jacobian, self.nlp.hessian(y, q, prices[self.size :])))
        return BatchValues(*map(np.array, zip(*each, strict=True)))


class BatchNLP:
    """Evaluates a programme without exchange points at the positions of its law."""

    def __init__(self, nlp: NLP, law: Law) -> None:
        self.nlp, self.size, self.offsets, self.tabulated = nlp, len(nlp.variables), law.offsets, law.tabulated
        self.minimax = nlp.variables[-1].name == EPIGRAPH
        self.limits = sum(row.limit != EPIGRAPH for row in nlp.rows)
        self.pairs = [(i, j) for i in range(self.size) for j in range(i, self.size)]
        x, p, position = nlp.x_symbol, nlp.p_symbol, nlp.position_expression
        self.width = position.numel()
        parts: list[Any] = []
        for k in range(self.width):
            hessian, gradient = casadi.hessian(position[k], x)
            parts += [position[k], gradient, *(hessian[i, j] for i, j in self.pairs)]
        self._residuals = NumpyEvaluator([x, p, nlp.position_symbol], parts)
        multipliers, rows = casadi.SX.sym("multipliers", self.limits), nlp.g_expression[: self.limits]
        hessian = casadi.hessian(casadi.dot(multipliers, rows), x)[0]
        second = [hessian[i, j] for i, j in self.pairs]
        self._limits = NumpyEvaluator([x, p, multipliers], [rows, casadi.jacobian(rows, x).T, *second])

    def __call__(self, x: Array, p: Array, multipliers: Array) -> BatchValues:
        """Evaluate the programme; see `Evaluator`."""
        n, count, scale = self.size, len(x), p[:, :1]
        of_rows = multipliers[:, n:]
        positions = [np.broadcast_to(axis, (count, len(axis))) for axis in (self.offsets, self.tabulated)]
        inputs = [*x.T[:, :, None], *p.T[:, :, None], *positions]
        residuals = self._residuals(*inputs).reshape(self.width, -1, count, len(self.offsets))
        error, first, second = residuals[:, 0], residuals[:, 1 : 1 + n], residuals[:, 1 + n :]
        limits = self._limits(*x.T, *p.T, *of_rows[:, : self.limits].T).reshape(-1, count)
        rows, slopes = limits[: self.limits].T, limits[self.limits : self.limits * (1 + n)].T.reshape(count, -1, n)
        bent = limits[self.limits * (1 + n) :]
        if self.minimax:
            objective = np.max(np.abs(error), axis=(0, 2))
            gradient = np.zeros((count, n))
            gradient[:, -1] = 1.0 / scale[:, 0]
            signed = np.stack([-error[0], error[-1]], axis=-1)
            steep = np.stack([-first[0], first[-1]], axis=-1)  # (n, points, positions, 2)
            steep[-1] += 1.0
            rows = np.concatenate([rows, (x[:, -1:] + signed.reshape(count, -1)) / scale], axis=1)
            slopes = np.concatenate([slopes, np.moveaxis(steep, 0, -1).reshape(count, -1, n) / scale[:, :, None]], axis=1)
            weights = (of_rows[:, self.limits :] / scale).reshape(count, -1, 2)
            bent = bent + np.sum(weights[..., 1] * second[-1] - weights[..., 0] * second[0], axis=-1)
        else:
            mean = len(self.offsets) if self.nlp.measure.name == "rms" else 1
            total = np.sum(np.sum(error * error, axis=-1), axis=0)
            objective = np.sqrt(total / mean) if mean > 1 else total
            factor = 2.0 / (mean * scale[:, 0])
            gradient = (factor * np.sum(np.sum(error[:, None] * first, axis=-1), axis=0)).T
            bent = bent + factor * np.array(
                [
                    np.sum(np.sum(first[:, i] * first[:, j] + error * second[:, k], axis=-1), axis=0)
                    for k, (i, j) in enumerate(self.pairs)
                ]
            )
        hessian = np.empty((count, n, n))
        for k, (i, j) in enumerate(self.pairs):
            hessian[:, i, j] = hessian[:, j, i] = bent[k]
        unit = np.broadcast_to(np.eye(n), (count, n, n))
        values, jacobian = np.concatenate([x, rows], axis=1), np.concatenate([unit, slopes], axis=1)
        return BatchValues(objective, gradient, values, jacobian, hessian)
