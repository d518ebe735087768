"""Formulas that casadi traces, run instruction by instruction on arrays, against casadi's own machine."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import casadi
import numpy as np
import pytest

from optlink.symbolic import PORTION, NumpyEvaluator, elementwise, symbols_in_numpy

Array = np.ndarray


def by_casadi(inputs: list[Any], outputs: list[Any], columns: list[Array]) -> Array:
    """The same values by casadi's own machine, position by position."""
    vector = casadi.densify(casadi.vertcat(*[casadi.vec(output) for output in outputs]))
    function = casadi.Function("f", inputs, [vector], {"cse": True})  # which may take 0 * NaN for 0
    columns = [np.ravel(column) for column in np.broadcast_arrays(*columns)]
    return np.array([np.ravel(np.asarray(function(*row))) for row in zip(*columns, strict=True)]).T


ONE: dict[str, Callable[[Any], Any]] = {
    "assign": lambda x: x,
    "neg": lambda x: -x,
    "exp": casadi.exp,
    "log": casadi.log,
    "sqrt": casadi.sqrt,
    "sq": lambda x: x * x,
    "twice": lambda x: 2 * x,
    "sin": casadi.sin,
    "cos": casadi.cos,
    "tan": casadi.tan,
    "asin": casadi.asin,
    "acos": casadi.acos,
    "atan": casadi.atan,
    "sinh": casadi.sinh,
    "cosh": casadi.cosh,
    "tanh": casadi.tanh,
    "inv": lambda x: 1 / x,
    "fabs": casadi.fabs,
    "sign": casadi.sign,
    "floor": casadi.floor,
    "ceil": casadi.ceil,
    "not": casadi.logic_not,
    "constpow": lambda x: x**2.5,
    "cube": lambda x: x**3,
}
TWO: dict[str, Callable[[Any, Any], Any]] = {
    "add": lambda x, y: x + y,
    "sub": lambda x, y: x - y,
    "mul": lambda x, y: x * y,
    "div": lambda x, y: x / y,
    "pow": lambda x, y: x**y,
    "atan2": casadi.atan2,
    "hypot": casadi.hypot,
    "fmod": casadi.fmod,
    "fmin": casadi.fmin,
    "fmax": casadi.fmax,
    "lt": lambda x, y: x < y,
    "le": lambda x, y: x <= y,
    "eq": lambda x, y: x == y,
    "ne": lambda x, y: x != y,
    "and": casadi.logic_and,
    "or": casadi.logic_or,
    "if else": lambda x, y: casadi.if_else(x > 0.25, y, -x),
    "if else zero": lambda x, y: casadi.if_else(x > 0.25, y, 0),
}
SPECIAL = np.array([-3.0, -1.0, -0.5, -0.0, 0.0, 0.25, 0.5, 1.0, 2.0, 7.5])


@pytest.mark.parametrize("name", ONE)
def test_tape_has_every_function_of_one_argument(name: str) -> None:
    x = casadi.SX.sym("x")
    expected = by_casadi([x], [ONE[name](x)], [SPECIAL])
    np.testing.assert_allclose(NumpyEvaluator([x], [ONE[name](x)])(SPECIAL), expected, rtol=1e-15, atol=0.0)


@pytest.mark.parametrize("name", TWO)
def test_tape_has_every_function_of_two_arguments(name: str) -> None:
    x, y = casadi.SX.sym("x"), casadi.SX.sym("y")
    first, second = np.meshgrid(SPECIAL, SPECIAL, indexing="ij")
    expected = by_casadi([x, y], [TWO[name](x, y)], [first, second]).reshape(1, *first.shape)
    tape = NumpyEvaluator([x, y], [TWO[name](x, y)])
    np.testing.assert_allclose(tape(first, second), expected, rtol=1e-15, atol=0.0)
    np.testing.assert_allclose(tape(SPECIAL[:, None], SPECIAL), expected, rtol=1e-15, atol=0.0)


@pytest.mark.parametrize("name", [name for name in ONE if name != "not"])
def test_undefined_values_stay_undefined(name: str) -> None:
    x = casadi.SX.sym("x")
    assert np.isnan(NumpyEvaluator([x], [ONE[name](x)])(np.array([math.nan]))).all()


def tangle(rng: np.random.Generator, inputs: list[Any], size: int = 60) -> list[Any]:
    """Random expressions that share parts, some of them without any input."""
    known = [*inputs, casadi.SX(1.5), casadi.SX(-0.25)]
    one = [ONE[name] for name in ("neg", "sin", "cos", "sqrt", "sq", "twice", "fabs", "atan", "tanh")]
    two = [TWO[name] for name in ("add", "sub", "mul", "div", "atan2", "hypot", "lt", "if else")]
    for _ in range(size):
        x, y = (known[int(rng.integers(len(known)))] for _ in "xy")
        if rng.random() < 0.35:
            known.append(one[int(rng.integers(len(one)))](x))
        else:
            known.append(two[int(rng.integers(len(two)))](x, y))
    return [*known[-5:], inputs[0], casadi.SX(3.25)]


@pytest.mark.parametrize("seed", range(20))
def test_tape_of_random_expressions(seed: int) -> None:
    """Rows, points and one number broadcast; NaN appears where casadi has it (roots of negative numbers)."""
    rng = np.random.default_rng(seed)
    inputs = [casadi.SX.sym(f"x{k}") for k in range(4)]
    outputs = tangle(rng, inputs)
    slopes = casadi.jacobian(casadi.vertcat(*outputs), casadi.vertcat(*inputs))
    tape = NumpyEvaluator(inputs, [*outputs, slopes])
    rows, points = 7, 5
    columns = [rng.normal(size=(rows, 1)), rng.normal(size=points), rng.normal(size=(rows, points)), np.array(0.75)]
    if seed % 3 == 0:
        columns[0][2] = math.nan
    expected = by_casadi(inputs, [*outputs, slopes], columns).reshape(tape.outputs, rows, points)
    before = [column.copy() for column in columns]
    computed = tape(*columns)
    np.testing.assert_allclose(computed, expected, rtol=1e-11, atol=1e-13)
    for column, was in zip(columns, before, strict=True):
        np.testing.assert_array_equal(column, was)
    np.testing.assert_array_equal(tape(*columns), computed)  # nothing is kept from one call to the next


@pytest.mark.parametrize(
    ("rows", "points"), [(1, 3), (3, 1), (1, 1), (PORTION - 1, 1), (PORTION, 2), (PORTION // 3 + 1, 7), (2, 3 * PORTION), (0, 4)]
)
def test_a_tape_in_portions(rows: int, points: int) -> None:
    """A portion may be a part of the rows, and never changes a value."""
    rng = np.random.default_rng(rows + points)
    x, y, z = (casadi.SX.sym(name) for name in "xyz")
    tape = NumpyEvaluator([x, y, z], [casadi.sin(x) * y + z, x * x - 2 * z, casadi.SX(4.0)])
    a, b, c = rng.normal(size=(rows, 1)), rng.normal(size=(rows, points)), rng.normal(size=points)
    result = tape(a, b, c)
    assert result.shape == (3, rows, points)
    np.testing.assert_allclose(result[0], np.sin(a) * b + c, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(result[1], np.broadcast_to(a * a - 2.0 * c, (rows, points)), rtol=1e-14, atol=1e-15)
    assert np.all(result[2] == 4.0)


def test_a_tape_takes_plain_numbers() -> None:
    x, y = casadi.SX.sym("x"), casadi.SX.sym("y")
    assert NumpyEvaluator([x, y], [x / y, x - y])(3.0, 2.0).tolist() == [1.5, 1.0]


@pytest.mark.parametrize("name", [*ONE, *TWO])
def test_every_function_at_many_positions_at_once(name: str) -> None:
    x, y = casadi.SX.sym("x"), casadi.SX.sym("y")
    inputs, output = ([x], ONE[name](x)) if name in ONE else ([x, y], TWO[name](x, y))
    columns = [np.ravel(one) for one in np.meshgrid(*[SPECIAL] * len(inputs), indexing="ij")]
    many = elementwise(casadi.Function("one", inputs, [output]), 0, columns[0].size)
    expected = by_casadi(inputs, [output], columns)[0]
    np.testing.assert_array_equal(np.asarray(many(*columns)).ravel(), expected)


@pytest.mark.parametrize("seed", range(5))
def test_random_expressions_at_many_positions_at_once(seed: int) -> None:
    """Shared inputs, results that depend on them alone or on nothing, sparse derivatives: as at each position alone."""
    rng, count = np.random.default_rng(seed), 7
    shared, own = casadi.SX.sym("shared", 2), casadi.SX.sym("own", 3)
    outputs = casadi.vertcat(*tangle(rng, [*casadi.vertsplit(shared), *casadi.vertsplit(own)]), shared[0] * shared[1])
    one = casadi.Function("one", [shared, own], [outputs, casadi.jacobian(outputs, own)])
    same, columns = rng.normal(size=2), rng.normal(size=(count, 3))
    computed = elementwise(one, 1, count)(same.reshape(1, 2), columns)
    for k, row in enumerate(columns):
        for values, expected in zip(computed, one(same, row), strict=True):
            np.testing.assert_array_equal(np.asarray(values)[k], np.asarray(expected).ravel(order="F"))


def test_tracing_restores_what_was_set() -> None:
    before = casadi.GlobalOptions.getNumpyMode()
    with symbols_in_numpy():
        assert casadi.is_equal(np.sin(casadi.SX(0)), casadi.SX(0))
    assert casadi.GlobalOptions.getNumpyMode() == before
