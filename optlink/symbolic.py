"""Tracing of numpy formulas with casadi symbols, and evaluation of the traced functions on numpy arrays."""

from __future__ import annotations

import contextlib
import io
import itertools
import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PACKED = "expressions"  # attribute under which `packed` keeps them
_TRACING = threading.Lock()
_MODES = list[int]()  # of casadi before the threads that trace; the mode is one of the whole process


@contextlib.contextmanager
def symbols_in_numpy() -> Iterator[None]:
    """Let numpy functions accept casadi symbols within the context; the previous mode is restored after the last thread in it.

    They return casadi symbols, with which formulas are traced twice as fast as with casadi's imitation of arrays (mode 1).
    """
    with _TRACING:
        _MODES.append(_MODES[0] if _MODES else casadi.GlobalOptions.getNumpyMode())
        casadi.GlobalOptions.setNumpyMode(-1)
    try:
        yield
    finally:
        with _TRACING:
            before = _MODES.pop()
            if not _MODES:
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

    Programmes of several results share it, so that one thread at a time uses its arguments and results.

    Raises
    ------
    RuntimeError
        The function fails, as an integrator may.
    """

    def __init__(self, function: Any) -> None:
        self._arguments = [np.zeros(function.numel_in(i)) for i in range(function.n_in())]
        self._results = [np.zeros(function.numel_out(i)) for i in range(function.n_out())]
        self._one_thread = threading.Lock()
        self._buffer, self._evaluate = function.buffer()
        for i, argument in enumerate(self._arguments):
            self._buffer.set_arg(i, memoryview(argument))  # type: ignore[arg-type]
        for i, result in enumerate(self._results):
            self._buffer.set_res(i, memoryview(result))  # type: ignore[arg-type]

    def __call__(self, *arguments: Array) -> list[Array]:
        """Evaluate the function; matrices are returned flat, column by column."""
        with self._one_thread:
            for own, given in zip(self._arguments, arguments, strict=True):
                own[:] = given
            self._evaluate()
            if self._buffer.ret():
                raise RuntimeError("the function failed")
            return [result.copy() for result in self._results]


def dense_function(inputs: list[Any], outputs: list[Any]) -> Any:
    """Return a casadi function of expressions, whose results have all their elements."""
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

    The first `shared` inputs of `function` (of SX expressions) are the same at all `count` positions. Each other input of the
    result has a row for each position and a column for each element; so have its results, for all elements.
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


PORTION = 8_000
"""Positions whose inputs are broadcast at a time."""
BLOCKS = 32, 256
"""Positions that are evaluated at once, few or many: their intermediate results stay in the processor's cache."""


class _Block(BufferedFunction):
    """A function of one vector at a fixed number of positions; see `elementwise`."""

    def __init__(self, function: Any, size: int) -> None:
        super().__init__(elementwise(function, 0, size))
        self._given, self._found = (flat[0].reshape(-1, size) for flat in (self._arguments, self._results))
        self.size = size

    def evaluate(self, given: Array, out: Array) -> None:
        """Write the values at some positions to `out`; both arrays have a column for each position."""
        for begin in range(0, given.shape[1], self.size):
            own = given[:, begin : begin + self.size]
            count = own.shape[1]
            self._given[:, :count] = own
            self._evaluate()
            out[:, begin : begin + count] = self._found[:, :count]


class NumpyEvaluator:
    """Evaluator of scalar casadi expressions on numpy arrays, in blocks of positions; undefined values are NaN."""

    def __init__(self, inputs: Sequence[Any], outputs: Sequence[Any]) -> None:
        vector = casadi.densify(casadi.vertcat(*[casadi.vec(casadi.densify(output)) for output in outputs]))
        self._function = casadi.Function("tape", [casadi.vertcat(*inputs)], [vector], {"cse": True})
        self.outputs = int(self._function.numel_out(0))
        self._blocks: dict[int, _Block] = {}
        self._one_thread = threading.Lock()  # at a time: a block has its own inputs and results

    def __call__(self, *inputs: Any) -> Array:
        """Evaluate the expressions at arrays that broadcast to (rows, ...), one per scalar input; return (outputs, rows, ...)."""
        arrays = [np.asarray(x, dtype=float) for x in inputs]
        shape = np.broadcast_shapes(*{x.shape for x in arrays})
        first, *others = shape or (1,)
        width = math.prod(others)
        out = np.empty((self.outputs, first * width))
        rows = max(1, PORTION // max(1, width))
        with self._one_thread:
            size = BLOCKS[0] if first * width <= 2 * BLOCKS[0] else BLOCKS[1]
            if size not in self._blocks:
                self._blocks[size] = _Block(self._function, size)
            block = self._blocks[size]
            for row in range(0, first, rows):
                given = np.empty((len(arrays), min(rows, first - row), *others))
                for own, x in zip(given, arrays, strict=True):
                    own[...] = x[row : row + rows] if x.ndim == own.ndim and len(x) > 1 else x
                block.evaluate(given.reshape(len(arrays), -1), out[:, row * width : (row + rows) * width])
        return out.reshape(self.outputs, *shape)
