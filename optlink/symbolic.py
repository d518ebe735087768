"""Tracing of numpy formulas with casadi symbols, and evaluation of the traced functions on numpy arrays."""

from __future__ import annotations

import contextlib
import io
import itertools
import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PACKED = "expressions"  # attribute under which `packed` keeps them


@contextlib.contextmanager
def symbols_in_numpy() -> Iterator[None]:
    """Let numpy functions accept casadi symbols within the context; the previous mode is restored.

    They return casadi symbols, with which formulas are traced twice as fast as with casadi's imitation of arrays (mode 1).
    """
    before = casadi.GlobalOptions.getNumpyMode()
    casadi.GlobalOptions.setNumpyMode(-1)
    try:
        yield
    finally:
        casadi.GlobalOptions.setNumpyMode(before)


def silent() -> contextlib.AbstractContextManager[object]:
    """Return a context without casadi's reports on standard error, which is for optlink's messages; for the main thread only."""
    if threading.current_thread() is not threading.main_thread():
        return contextlib.nullcontext()
    return contextlib.redirect_stderr(io.StringIO())


def packed(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return attributes that pickle: casadi expressions, single or in tuples, as one text that keeps their common nodes."""
    found = {name: v for name, v in state.items() if isinstance(v[0] if isinstance(v, tuple) and v else v, casadi.SX)}
    serializer = casadi.StringSerializer()
    serializer.pack([one for v in found.values() for one in (v if isinstance(v, tuple) else (v,))])
    counts = {name: len(v) if isinstance(v, tuple) else None for name, v in found.items()}
    return {name: v for name, v in state.items() if name not in found} | {PACKED: (counts, serializer.encode())}


def unpacked(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return the attributes that `packed` was given."""
    counts, text = state[PACKED]
    each = iter(casadi.StringDeserializer(text).unpack())
    found = {name: next(each) if count is None else tuple(itertools.islice(each, count)) for name, count in counts.items()}
    return {name: v for name, v in state.items() if name != PACKED} | found


class BufferedFunction:
    """A casadi function on numpy arrays without copies through casadi matrices (ten times less overhead per call).

    Raises
    ------
    RuntimeError
        The function fails, as an integrator may.
    """

    def __init__(self, function: Any) -> None:
        self._arguments = [np.zeros(function.numel_in(i)) for i in range(function.n_in())]
        self._results = [np.zeros(function.numel_out(i)) for i in range(function.n_out())]
        self._buffer, self._evaluate = function.buffer()
        for i, argument in enumerate(self._arguments):
            self._buffer.set_arg(i, memoryview(argument))  # type: ignore[arg-type]
        for i, result in enumerate(self._results):
            self._buffer.set_res(i, memoryview(result))  # type: ignore[arg-type]

    def __call__(self, *arguments: Array) -> list[Array]:
        """Evaluate the function; matrices are returned flat, column by column."""
        for own, given in zip(self._arguments, arguments, strict=True):
            own[:] = given
        self._evaluate()
        if self._buffer.ret():
            raise RuntimeError("the function failed")
        return [result.copy() for result in self._results]


def dense_function(inputs: list[Any], outputs: list[Any]) -> Any:
    """Return a casadi function of expressions, whose results have all their elements.

    Parameters
    ----------
    inputs, outputs : list of casadi expressions
    """
    return casadi.Function("compiled", inputs, [casadi.densify(output) for output in outputs])


class CompiledFunction(BufferedFunction):
    """Expressions of casadi symbols as a function on numpy arrays."""

    def __init__(self, inputs: list[Any], outputs: list[Any], copies: int = 1) -> None:
        function = dense_function(inputs, outputs)
        super().__init__(function if copies == 1 else function.map(copies))


def elementwise(function: Any, shared: int, count: int) -> Any:
    """Return a function at many positions at once, eight times faster than `casadi.Function.map`.

    casadi's virtual machine spends most of its time on the choice of the operation: it evaluates a function of SX expressions one
    number at a time, one of MX expressions one vector at a time.

    Parameters
    ----------
    function : casadi.Function
        Of SX expressions.
    shared : int
        Number of its first inputs that are the same at every position.
    count : int
        Number of positions.

    Returns
    -------
    casadi.Function
        Its other inputs have a row for each position and a column for each element; so have its results, for all elements.
    """
    whole = dense_function(function.sx_in(), list(function.call(function.sx_in())))
    rows = [1 if i < shared else count for i in range(whole.n_in())]
    symbols = [casadi.MX.sym("given", n, whole.numel_in(i)) for i, n in enumerate(rows)]
    columns = [casadi.horzsplit(symbol) for symbol in symbols]
    results: list[list[Any]] = [[None] * whole.numel_out(i) for i in range(whole.n_out())]
    slots: list[Any] = [None] * whole.sz_w()
    for k in range(whole.n_instructions()):
        code, to, sources = whole.instruction_id(k), whole.instruction_output(k), whole.instruction_input(k)
        if code == casadi.OP_INPUT:
            slots[to[0]] = columns[sources[0]][sources[1]]
        elif code == casadi.OP_OUTPUT:
            results[to[0]][to[1]] = slots[sources[0]]
        elif code == casadi.OP_CONST:
            slots[to[0]] = casadi.MX(whole.instruction_constant(k))
        elif len(sources) == 1:
            slots[to[0]] = casadi.MX.unary(code, slots[sources[0]])
        else:
            slots[to[0]] = casadi.MX.binary(code, slots[sources[0]], slots[sources[1]])
    every = casadi.MX.ones(count, 1)
    full = [[one if one.numel() == count else every * one for one in result] for result in results]
    return casadi.Function("elementwise", symbols, [casadi.densify(casadi.horzcat(*result)) for result in full])


_UFUNCS: dict[int, Any] = {
    casadi.OP_ASSIGN: np.positive,
    casadi.OP_ADD: np.add,
    casadi.OP_SUB: np.subtract,
    casadi.OP_MUL: np.multiply,
    casadi.OP_DIV: np.divide,
    casadi.OP_NEG: np.negative,
    casadi.OP_EXP: np.exp,
    casadi.OP_LOG: np.log,
    casadi.OP_POW: np.power,
    casadi.OP_CONSTPOW: np.power,
    casadi.OP_SQRT: np.sqrt,
    casadi.OP_SQ: np.square,
    casadi.OP_TWICE: lambda x, out=None: np.add(x, x, out=out),
    casadi.OP_SIN: np.sin,
    casadi.OP_COS: np.cos,
    casadi.OP_TAN: np.tan,
    casadi.OP_ASIN: np.arcsin,
    casadi.OP_ACOS: np.arccos,
    casadi.OP_ATAN: np.arctan,
    casadi.OP_ATAN2: np.arctan2,
    casadi.OP_SINH: np.sinh,
    casadi.OP_COSH: np.cosh,
    casadi.OP_TANH: np.tanh,
    casadi.OP_HYPOT: np.hypot,
    casadi.OP_INV: np.reciprocal,
    casadi.OP_FABS: np.abs,
    casadi.OP_SIGN: np.sign,
    casadi.OP_FLOOR: np.floor,
    casadi.OP_CEIL: np.ceil,
    casadi.OP_FMOD: np.fmod,
    casadi.OP_FMIN: np.fmin,
    casadi.OP_FMAX: np.fmax,
    casadi.OP_LT: lambda a, b, out=None: np.multiply(np.less(a, b), 1.0, out=out),
    casadi.OP_LE: lambda a, b, out=None: np.multiply(np.less_equal(a, b), 1.0, out=out),
    casadi.OP_EQ: lambda a, b, out=None: np.multiply(np.equal(a, b), 1.0, out=out),
    casadi.OP_NE: lambda a, b, out=None: np.multiply(np.not_equal(a, b), 1.0, out=out),
    casadi.OP_NOT: lambda a, out=None: np.multiply(np.logical_not(a), 1.0, out=out),
    casadi.OP_AND: lambda a, b, out=None: np.multiply(np.logical_and(a, b), 1.0, out=out),
    casadi.OP_OR: lambda a, b, out=None: np.multiply(np.logical_or(a, b), 1.0, out=out),
    casadi.OP_IF_ELSE_ZERO: lambda c, x, out=None: np.multiply(np.not_equal(c, 0.0), np.where(np.equal(c, 0.0), 0.0, x), out=out),
}

_INPUT, _OUTPUT, _CONSTANT = -2, -3, -4
PORTION = 8_000
"""Positions that a tape works on at a time: its intermediate arrays stay in the processor's cache."""


class NumpyEvaluator:
    """Evaluator of scalar casadi expressions, instruction by instruction on whole numpy arrays.

    casadi differentiates exactly and eliminates common subexpressions; numpy evaluates many points at once. For a few thousand
    points this is five times faster than casadi's virtual machine, which evaluates one point at a time. Undefined values are NaN,
    without warning.
    """

    def __init__(self, inputs: Sequence[Any], outputs: Sequence[Any]) -> None:
        vector = casadi.densify(casadi.vertcat(*[casadi.vec(casadi.densify(output)) for output in outputs]))
        function = casadi.Function("tape", [casadi.vertcat(*inputs)], [vector], {"cse": True})
        self.slots, self.outputs = int(function.sz_w()), int(function.numel_out(0))
        self.steps = [self._step(function, k) for k in range(function.n_instructions())]
        self._plans: dict[tuple[bool, ...], list[tuple[Any, int, int, int, float, bool]]] = {}

    @staticmethod
    def _step(function: Any, k: int) -> tuple[Any, int, int, int, float]:
        """(ufunc, slot or output written, first operand, second operand or -1, constant); no ufunc for inputs and outputs."""
        code, to, sources = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if code == casadi.OP_INPUT:
            return None, to[0], sources[1], _INPUT, 0.0
        if code == casadi.OP_OUTPUT:
            return None, to[1], sources[0], _OUTPUT, 0.0
        if code == casadi.OP_CONST:
            return None, to[0], 0, _CONSTANT, float(function.instruction_constant(k))
        if code not in _UFUNCS:
            names = [name for name in vars(casadi) if name.startswith("OP_") and getattr(casadi, name) == code]
            raise ValueError(f"{' or '.join(names)} of casadi has no numpy counterpart; write the formula with other functions")
        return _UFUNCS[code], to[0], sources[0], sources[1] if len(sources) > 1 else -1, 0.0

    def _plan(self, full: tuple[bool, ...]) -> list[tuple[Any, int, int, int, float, bool]]:
        """The steps, each with whether its result has the full shape; `full` is this property of the inputs."""
        if full not in self._plans:
            whole = [False] * self.slots
            plan = []
            for ufunc, to, first, second, constant in self.steps:
                if ufunc is not None:
                    whole[to] = whole[first] or (second >= 0 and whole[second])
                elif second != _OUTPUT:
                    whole[to] = second == _INPUT and full[first]
                plan.append((ufunc, to, first, second, constant, second != _OUTPUT and whole[to]))
            self._plans[full] = plan
        return self._plans[full]

    def __call__(self, *inputs: Any) -> Array:
        """Evaluate the expressions.

        Parameters
        ----------
        inputs : floats or arrays that broadcast to (rows, ...), one per scalar input

        Returns
        -------
        array (outputs, rows, ...)
        """
        arrays = [np.asarray(x, dtype=float) for x in inputs]
        shape = np.broadcast_shapes(*(x.shape for x in arrays))
        out = np.empty((self.outputs, *shape))
        plan = self._plan(tuple(x.shape == shape for x in arrays))
        if not shape:
            return self._run(plan, arrays, out)
        rows = max(1, PORTION * shape[0] // max(1, int(np.prod(shape))))
        for first in range(0, shape[0], rows):
            part = slice(first, first + rows)
            self._run(plan, [x[part] if x.ndim == len(shape) and len(x) > 1 else x for x in arrays], out[:, part])
        return out

    def _run(self, plan: list[tuple[Any, int, int, int, float, bool]], arrays: list[Array], out: Array) -> Array:
        pool = np.empty((self.slots, *out.shape[1:]))
        places = list(pool) if out.ndim > 1 else []
        held: list[Any] = [None] * self.slots
        with np.errstate(all="ignore"):
            for ufunc, to, first, second, constant, full in plan:
                if ufunc is not None:
                    if full and places:
                        place = places[to]
                        if second < 0:
                            ufunc(held[first], place)
                        else:
                            ufunc(held[first], held[second], place)
                        held[to] = place
                    else:
                        held[to] = ufunc(held[first]) if second < 0 else ufunc(held[first], held[second])
                elif second == _OUTPUT:
                    out[to] = held[first]
                else:
                    held[to] = arrays[first] if second == _INPUT else constant
        return out
