"""Taylor models against ball arithmetic: no value of any rule or formula lies outside the polynomial and its remainder.

Random quantities over random boxes are passed through every rule; at random points of the boxes the value is computed with 200
bits (Arb) and compared with the polynomial, in exact arithmetic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import flint
import numpy as np
import pytest
from flint import arb
from numpy.lib.mixins import NDArrayOperatorsMixin

from optlink.linkage.dyads import rrr
from optlink.linkage.fourbar import dead_centre, transmission_cosine
from optlink.linkage.vector2d import angle_from
from optlink.optimization import taylor_model
from optlink.optimization.taylor_model import TaylorModel, pairs

BITS = 200
BOXES = 40  # of a batch
POINTS = 10  # of a box

Formula = Callable[..., Any]


@dataclass(frozen=True)
class Case:
    """A rule or formula of `arity` quantities, whose values at the centres of boxes have a size between 10^low and 10^high."""

    formula: Formula
    arity: int = 1
    low: float = -3.0
    high: float = 1.0
    positive: bool = False
    angle: bool = False  # known but for full turns
    exact: Formula | None = None  # the same for numbers of Arb; default: the formula with `Exact` numbers
    offset: float = 0.0
    roots: bool = False  # whether square roots occur


def _number(x: Any) -> arb:
    return x.value if isinstance(x, Exact) else arb(float(x))


class Exact(NDArrayOperatorsMixin):
    """A number of Arb that passes through numpy's functions."""

    RULES: ClassVar[dict[Any, Formula]] = {
        np.add: lambda x, y: x + y,
        np.subtract: lambda x, y: x - y,
        np.multiply: lambda x, y: x * y,
        np.divide: lambda x, y: x / y,
        np.power: lambda x, y: x**y,
        np.negative: lambda x: -x,
        np.positive: lambda x: x,
        np.square: lambda x: x * x,
        np.sqrt: arb.sqrt,
        np.sin: arb.sin,
        np.cos: arb.cos,
        np.arcsin: arb.asin,
        np.arccos: arb.acos,
        np.arctan: arb.atan,
        np.arctan2: arb.atan2,
        np.exp: arb.exp,
        np.log10: lambda x: x.log() / arb(10).log(),
    }

    def __init__(self, value: arb) -> None:
        self.value = value

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Exact:
        assert method == "__call__"
        assert not kwargs
        return Exact(self.RULES[ufunc](*map(_number, inputs)))


def _constant(formula: Formula) -> Formula:
    return lambda *x: formula(*map(Exact, x)).value


CASES: dict[Any, list[Case]] = {
    np.add: [Case(lambda x, y: x + y, 2, -3.0, 4.0), Case(lambda x: x + 1234.567)],
    np.subtract: [Case(lambda x, y: x - y, 2, -3.0, 4.0), Case(lambda x: 1234.567 - x)],
    np.multiply: [Case(lambda x, y: x * y, 2), Case(lambda x: x * 0.3), Case(lambda x: x * x)],
    np.divide: [Case(lambda x, y: x / y, 2, 0.0, 1.0), Case(lambda x: x / 3.7), Case(lambda x: 1.0 / x, low=-1.0)],
    np.power: [
        *(Case(lambda x, n=n: x**n, low=-1.0, high=0.5, positive=True) for n in (2, 3, -2, 0.5, 1.7, -0.3, 17)),
        Case(lambda x, y: x**y, 2, -1.0, 0.5, positive=True),
    ],
    np.negative: [Case(lambda x: -x)],
    np.positive: [Case(lambda x: +x)],
    np.square: [Case(np.square)],
    np.sqrt: [Case(np.sqrt, positive=True, exact=arb.sqrt)],
    np.sin: [Case(np.sin, exact=arb.sin), Case(np.sin, low=-6.0, high=-4.0, offset=0.5 * math.pi)],
    np.cos: [Case(np.cos, exact=arb.cos)],
    np.tan: [Case(np.tan, high=0.0, exact=arb.tan)],
    np.arcsin: [Case(np.arcsin, high=-0.3, exact=arb.asin, roots=True)],
    np.arccos: [Case(np.arccos, high=-0.3, exact=arb.acos, roots=True)],
    np.arctan: [Case(np.arctan, exact=arb.atan)],
    np.arctan2: [Case(np.arctan2, 2, -1.0, angle=True, exact=arb.atan2)],
    np.exp: [Case(np.exp, exact=arb.exp), Case(np.exp, low=-6.0, high=-3.0)],
    np.log: [Case(np.log, positive=True, exact=arb.log)],
    np.log10: [Case(np.log10, positive=True)],
    np.sinh: [Case(np.sinh, exact=arb.sinh)],
    np.cosh: [Case(np.cosh, exact=arb.cosh)],
    np.tanh: [Case(np.tanh, exact=arb.tanh)],
    np.absolute: [Case(np.absolute, exact=abs)],
    np.sign: [Case(np.sign, exact=arb.sgn)],
    np.minimum: [Case(np.minimum, 2, exact=arb.min)],
    np.maximum: [Case(np.maximum, 2, exact=arb.max)],
    "rrr dyad": [
        *(
            Case(lambda r, a, b, f, k=k: rrr((0.6 * r, 0.8 * r), (f, 0.0 * f), a, b, 1)[0][k], 4, -0.2, 0.2, True, roots=True)
            for k in (0, 1)
        )
    ],
    "dead centre": [
        Case(lambda r, a, b, f, k=k: dead_centre(0.3 * r, a, b, f, 1, outer=k).psi, 4, -0.1, 0.1, True, angle=True, roots=True)
        for k in (True, False)
    ],
    "angle_from": [Case(lambda a, b, c, d: angle_from((a, b), (c, d)), 4, -0.5, angle=True)],
    "transmission cosine": [Case(lambda r, a, b, f: transmission_cosine(0.3 * r, a, b, f, 0.4), 4, -0.3, 0.3, True)],
}


def _arguments(case: Case, low: Any, high: Any, rng: np.random.Generator) -> tuple[list[TaylorModel], Formula]:
    """Return random quantities over boxes of unknowns near 1, and their values for exact unknowns of one of the boxes."""
    unknowns = TaylorModel.unknowns(low, high)
    n, size = low.shape[1], 10.0 ** rng.uniform(case.low, case.high, case.arity)
    sign = np.where(rng.random(case.arity) < 0.5, -1.0, 1.0) if not case.positive else np.ones(case.arity)
    weights = sign[:, None] * size[:, None] * rng.dirichlet(np.ones(n + 1), case.arity)

    def values(x: list[Any]) -> list[Any]:
        result = []
        for row in weights:
            total = x[0] * x[-1] * float(row[n])
            for weight, one in zip(row, x, strict=False):
                total = total + one * float(weight)
            result.append(total + case.offset if case.offset else total)
        return result

    return values(unknowns), values


def _batches(case: Case, rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    """Yield value, polynomial and remainder at random points of a batch of boxes."""
    n = int(rng.integers(1, 5))
    width = 10.0 ** rng.uniform(-12.0, 0.0, (BOXES, 1)) * rng.uniform(0.1, 1.0, (BOXES, n))
    middle = rng.uniform(0.7, 1.3, (BOXES, n))
    low, high = middle - 0.5 * width, middle + 0.5 * width
    arguments, exact = _arguments(case, low, high, rng)
    model = case.formula(*arguments)
    own = TaylorModel.unknowns(low, high)
    formula = case.exact or _constant(case.formula)
    for k in np.flatnonzero(np.isfinite(model.remainder[:, 0])):
        remainder = arb(float(model.remainder[k, 0]))
        coefficients = [arb(float(x)) for x in model.coefficients[:, k, 0]]
        centre = [arb(float(x.coefficients[0, k, 0])) for x in own]
        radius = [arb(float(x.coefficients[1 + i, k, 0])) for i, x in enumerate(own)]
        points = rng.uniform(-1.0, 1.0, (POINTS, n))
        points[:2] = np.sign(points[:2])  # corners
        for point in points:
            d = [arb(float(x)) for x in point]
            value = formula(*exact([c + r * x for c, r, x in zip(centre, radius, d, strict=True)]))
            if not value.is_finite():  # a root at the edge of its domain: bounded where it is defined
                assert case.roots
                continue
            polynomial = coefficients[0]
            if len(coefficients) > 1:
                for i in range(n):
                    polynomial += coefficients[1 + i] * d[i]
                for (i, j), h in zip(pairs(n), coefficients[1 + n :], strict=True):
                    polynomial += h * d[i] * d[j]
            if case.angle:
                turns = round(float((value - polynomial) / (2 * arb.pi())))
                value -= 2 * arb.pi() * turns
            yield value, polynomial, remainder


def _outside(cases: list[Case], count: int, seed: int) -> tuple[int, int]:
    """Return the number of points that were compared, at least `count` of each case, and of those that lie outside."""
    rng, compared, outside = np.random.default_rng(seed), 0, 0
    with flint.ctx.workprec(BITS):
        for case in cases:
            own, tries = 0, 0
            while own < count and tries < 40 + count // 50:
                tries += 1
                for value, polynomial, remainder in _batches(case, rng):
                    own += 1
                    outside += not abs(value - polynomial) <= remainder
            assert own >= count
            compared += own
    return compared, outside


EVERY = [case for cases in CASES.values() for case in cases]


def test_every_rule_has_a_case() -> None:
    assert set(taylor_model._RULES) == {key for key in CASES if isinstance(key, np.ufunc)}


def test_no_value_lies_outside() -> None:
    compared, outside = _outside(EVERY, 500, 1)
    assert compared >= 20_000
    assert outside == 0


@pytest.mark.slow
def test_no_value_of_two_hundred_thousand_lies_outside() -> None:
    """A few thousand of each case: each planted defect below shows within a thousand."""
    compared, outside = _outside(EVERY, 200_000 // len(EVERY) + 1, 2)
    assert compared >= 200_000
    assert outside == 0


UNDEFINED: list[tuple[Formula, float, float]] = [
    *((np.sqrt, -2.0, -1.0), (np.log, -0.1, 1.0), (np.log10, 0.0, 1.0), (lambda x: 1.0 / x, -1.0, 1.0)),
    *((lambda x: x**-3, -1.0, 2.0), (lambda x: x**0.5, -1.0, 1.0), (lambda x: 2.0 / (x * x - 1.0), 0.5, 1.5)),
    *((np.arcsin, 1.1, 1.5), (np.arccos, -1.3, -1.1), (np.tan, 1.0, 2.0), (lambda x: np.arctan2(x, x), -1.0, 1.0)),
    *((lambda x: np.arctan2(0.0 * x, x), -1.0, 0.5), (lambda x: x**x, -0.5, 0.5)),
    (lambda x: rrr((0.0, 0.0), (x, 0.0), 1.0, 1.0, 1)[0][1], 2.5, 3.5),
]


@pytest.mark.parametrize(("formula", "low", "high"), UNDEFINED)
def test_undefined_regions_have_no_bound(formula: Formula, low: float, high: float) -> None:
    [x] = TaylorModel.unknowns(np.array([[low]]), np.array([[high]]))
    result = formula(x)
    assert not np.any(np.isfinite(result.remainder))
    assert np.all(result.low == -np.inf)
    assert np.all(result.high == np.inf)


def test_a_root_that_is_defined_in_a_part_of_the_box_is_bounded_there() -> None:
    [x] = TaylorModel.unknowns(np.array([[-0.1]]), np.array([[1.0]]))
    root = np.sqrt(x)
    assert root.low[0, 0] <= 0.0
    assert 1.0 <= root.high[0, 0] < 1.0 + 1e-12


def _without_third_order(monkeypatch: pytest.MonkeyPatch) -> None:
    compose = taylor_model._compose

    def second_order(x: Any, rule: Any, error: float = 0.0) -> Any:
        return compose(x, lambda c, low, high: (*(known := rule(c, low, high))[:3], 0.0 * known[3]), error)

    monkeypatch.setattr(taylor_model, "_compose", second_order)


def _wrong_derivative(monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(x: Any, low: Any, high: Any) -> Any:
        s, c = np.sin(x), np.cos(x)
        return s, c, s, np.ones_like(x)  # the sign of the second

    monkeypatch.setitem(taylor_model.DERIVATIVES, np.sin, wrong)


def _product_without_third_order(monkeypatch: pytest.MonkeyPatch) -> None:
    multiply = taylor_model._multiply

    def second_order(a: Any, b: Any) -> Any:
        result = multiply(a, b)
        a, b = taylor_model._two(a, b)
        (ga, qa), (gb, qb) = a.sizes, b.sizes
        return TaylorModel(result.coefficients, np.maximum(result.remainder - (ga * qb + qa * (gb + qb)), 0.0), result.count)

    monkeypatch.setattr(taylor_model, "_multiply", second_order)


@pytest.mark.parametrize(
    ("defect", "keys"),
    [
        (_wrong_derivative, [np.sin]),
        (_without_third_order, [np.exp]),
        (_without_third_order, [np.sqrt]),
        (_product_without_third_order, [np.multiply]),
        (lambda patch: patch.setattr(taylor_model, "ROUNDING", 0.0), [np.add]),
        (lambda patch: patch.setattr(taylor_model, "LIBRARY", 0.0), [np.exp]),
        (lambda patch: patch.setattr(taylor_model, "LIBRARY", 0.0), [np.sin]),
    ],
)
def test_planted_defects_are_detected(
    defect: Callable[[pytest.MonkeyPatch], None], keys: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    cases = [case for key in keys for case in CASES[key]]
    assert _outside(cases, 1000, 3)[1] == 0
    defect(monkeypatch)
    assert _outside(cases, 1000, 3)[1] > 0


def test_an_angle_of_a_pose_beyond_half_a_turn_is_unknown() -> None:
    """The angle of a pose lies within -pi ... pi; its model is continuous, so beyond it would be wrong by a turn."""
    from optlink.optimization.taylor_model import _known_within

    [x] = TaylorModel.unknowns(np.array([[-0.1], [-0.5]]), np.array([[0.1], [-0.3]]))
    angle = np.arctan2(x, TaylorModel.constant(-1.0, 1))
    assert angle.high[0, 0] > math.pi > angle.low[0, 0]
    assert np.isinf(_known_within(0.2 * angle, 0.2 * math.pi).remainder[0, 0])
    assert np.isfinite(_known_within(0.2 * angle, 0.2 * math.pi).remainder[1, 0])
