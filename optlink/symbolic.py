"""Formulas written for numpy, traced with casadi symbols and called again on numpy arrays."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@contextlib.contextmanager
def tracing() -> Iterator[None]:
    """Let numpy's functions take casadi symbols meanwhile, as they take arrays; what was set before is restored."""
    before = casadi.GlobalOptions.getNumpyMode()
    casadi.GlobalOptions.setNumpyMode(1)
    try:
        yield
    finally:
        casadi.GlobalOptions.setNumpyMode(before)


class Buffered:
    """A casadi function on numpy arrays without copies through casadi's own matrices (ten times less overhead per call).

    Raises
    ------
    RuntimeError
        when it fails, as an integrator may.
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
        """Evaluate; matrices come flat, column by column."""
        for own, given in zip(self._arguments, arguments, strict=True):
            own[:] = given
        self._evaluate()
        if self._buffer.ret():
            raise RuntimeError("the function failed")
        return [result.copy() for result in self._results]


class Compiled(Buffered):
    """Expressions of casadi symbols as a function on numpy arrays."""

    def __init__(self, inputs: list[Any], outputs: list[Any], copies: int = 1) -> None:
        function = casadi.Function("compiled", inputs, [casadi.densify(output) for output in outputs])
        super().__init__(function if copies == 1 else function.map(copies))
