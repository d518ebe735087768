"""Linear equations, complex numbers, and real roots of polynomials in 80 decimal digits, for roots that doubles do not separate.

Matrices are lists of rows, or arrays of complex numbers. The precision is that of the decimal context, which `precise` sets.
"""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from decimal import Context, Decimal, localcontext
from typing import Any

import numpy as np

DIGITS = 80
VANISHES = Decimal("1e-40")  # relative size of a number that rounding alone makes differ from zero

Matrix = list[list[Decimal]]


def precise() -> AbstractContextManager[Context]:
    """Return a context in which decimals have 80 digits."""
    return localcontext(Context(prec=DIGITS))


@dataclass(frozen=True, slots=True)
class Number:
    """A complex number, as element of arrays."""

    real: Decimal
    imag: Decimal

    def __add__(self, other: "Number") -> "Number":
        return Number(self.real + other.real, self.imag + other.imag)

    def __sub__(self, other: "Number") -> "Number":
        return Number(self.real - other.real, self.imag - other.imag)

    def __mul__(self, other: "Number") -> "Number":
        return Number(self.real * other.real - self.imag * other.imag, self.real * other.imag + self.imag * other.real)

    def __truediv__(self, other: "Number") -> "Number":
        size = other.real * other.real + other.imag * other.imag
        return self * Number(other.real / size, -other.imag / size)

    def __neg__(self) -> "Number":
        return Number(-self.real, -self.imag)

    def __abs__(self) -> float:
        return abs(complex(self))

    def __complex__(self) -> complex:
        return complex(float(self.real), float(self.imag))

    def conjugate(self) -> "Number":
        """Return the conjugate."""
        return Number(self.real, -self.imag)


def _number(value: complex | Number) -> Number:
    return value if isinstance(value, Number) else Number(Decimal(value.real), Decimal(value.imag))


numbers: Any = np.vectorize(_number, otypes=[object])
"""Arrays of `Number` from complex arrays, or from such ones."""


def inverse_of(matrix: Any) -> Any:
    """Return the inverse of a square array of `Number`, by elimination; not finite if it is singular."""
    size = len(matrix)
    rows = np.concatenate([matrix, numbers(np.eye(size, dtype=complex))], axis=1)
    for k in range(size):
        best = k + int(np.argmax(np.abs(rows[k:, k])))
        rows[[k, best]] = rows[[best, k]]
        rows[k] = rows[k] / rows[k, k]
        others = np.arange(size) != k
        rows[others] = rows[others] - rows[others, k, None] * rows[k]
    return rows[:, size:]


def cos_sin(angle: float) -> tuple[Decimal, Decimal]:
    """Return cosine and sine of an angle [rad] by their series."""
    x = Decimal(angle)
    sums, term, k = [Decimal(1), Decimal(0)], Decimal(1), 0
    while abs(term) > Decimal(10) ** -DIGITS:
        k += 1
        term = term * x / k
        sums[k % 2] += term if k % 4 < 2 else -term
    return sums[0], sums[1]


def null_space(matrix: Sequence[Sequence[Decimal]], rank: int, columns: int | None = None) -> tuple[Matrix, Decimal]:
    """Return vectors that a matrix of given rank maps to zero, and the last pivot relative to the first one.

    One vector for each column without a pivot, in their order, with 1 there. Pivots lie in the first `columns` only.
    """
    rows = [list(row) for row in matrix]
    width, pivots, first, last = len(rows[0]), list[int](), Decimal(1), Decimal(0)
    for k in range(rank):
        places = [(i, j) for i in range(k, len(rows)) for j in range(columns or width) if j not in pivots]
        i, j = max(places, key=lambda place: abs(rows[place[0]][place[1]]))
        rows[k], rows[i] = rows[i], rows[k]
        last = rows[k][j]
        first = last if k == 0 else first
        if last == 0:
            break
        rows[k] = [entry / last for entry in rows[k]]
        pivots.append(j)
        for m, row in enumerate(rows):
            if m != k and row[j]:
                rows[m] = [entry - row[j] * above for entry, above in zip(row, rows[k], strict=True)]
    basis = []
    for free in (j for j in range(width) if j not in pivots):
        vector = [Decimal(int(j == free)) for j in range(width)]
        for k, j in enumerate(pivots):
            vector[j] = -rows[k][free]
        basis.append(vector)
    return basis, abs(last / first) if first else Decimal(0)


def characteristic_polynomial(matrix: Matrix) -> list[Decimal]:
    """Return the coefficients of det(x I - A), that of the highest power first, by the method of Faddeev and LeVerrier."""
    size = range(len(matrix))
    coefficients, product = [Decimal(1)], [[Decimal(int(i == j)) for j in size] for i in size]
    for k in size:
        product = [[sum((matrix[i][m] * product[m][j] for m in size), Decimal(0)) for j in size] for i in size]
        coefficients.append(-sum((product[i][i] for i in size), Decimal(0)) / (k + 1))
        for i in size:
            product[i][i] += coefficients[-1]
    return coefficients


def divided(polynomial: Sequence[Decimal], divisor: Sequence[Decimal]) -> tuple[list[Decimal], bool]:
    """Return the quotient by a polynomial with a highest coefficient of 1, and whether nothing remains."""
    rest, quotient = list(polynomial), list[Decimal]()
    size = max(map(abs, rest))
    while len(rest) >= len(divisor):
        quotient.append(rest[0])
        rest = [entry - (quotient[-1] * divisor[k] if k < len(divisor) else 0) for k, entry in enumerate(rest)][1:]
    return quotient, all(abs(entry) <= VANISHES * size for entry in rest)


def _value(polynomial: Sequence[Decimal], x: Decimal) -> tuple[Decimal, bool]:
    """Return the value of a polynomial, and whether it vanishes but for rounding."""
    value = size = Decimal(0)
    for coefficient in polynomial:
        value, size = value * x + coefficient, size * abs(x) + abs(coefficient)
    return value, abs(value) <= VANISHES * size


def _derivative(polynomial: Sequence[Decimal]) -> list[Decimal]:
    degree = len(polynomial) - 1
    return [coefficient * (degree - k) for k, coefficient in enumerate(polynomial[:-1])]


def real_roots(polynomial: Sequence[Decimal]) -> list[tuple[Decimal, int]]:
    """Return real roots and their multiplicity: one in each interval between roots of the derivative, if the sign changes."""
    if len(polynomial) < 2:
        return []
    slope = _derivative(polynomial)
    turning = sorted(root for root, _ in real_roots(slope))
    multiple = [x for x in turning if _value(polynomial, x)[1]]
    far = 1 + max(abs(coefficient / polynomial[0]) for coefficient in polynomial)
    found = []
    for low, high in zip([-far, *turning], [*turning, far], strict=True):
        if low in multiple or high in multiple or (_value(polynomial, low)[0] > 0) == (_value(polynomial, high)[0] > 0):
            continue
        found.append((_bracketed(polynomial, slope, low, high), 1))
    for x in multiple:
        order, part = 1, slope
        while _value(part, x)[1]:
            order, part = order + 1, _derivative(part)
        found.append((x, order))
    return found


def _bracketed(polynomial: Sequence[Decimal], slope: Sequence[Decimal], low: Decimal, high: Decimal) -> Decimal:
    """Return the root between points with values of different sign, by Newton steps that stay between them, else bisection."""
    rising = _value(polynomial, high)[0] > 0
    x = (low + high) / 2
    while True:
        value, steep = _value(polynomial, x)[0], _value(slope, x)[0]
        low, high = (low, x) if (value > 0) == rising else (x, high)
        after = x - value / steep if steep else low
        if not low < after < high:
            after = (low + high) / 2
        if abs(after - x) <= Decimal(10) ** (5 - DIGITS) * (1 + abs(x)):
            return after
        x = after
