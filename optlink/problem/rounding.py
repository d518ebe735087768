"""Grids of sizes that can be made: section `[rounding]` of problem files, and what `--round` states."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Annotated, Any

from pydantic import BeforeValidator

from optlink.problem.quantity import Quantity, Unusable, below, check_keys, check_name, check_pair, read_scalar
from optlink.problem.tolerances import by_name, remove
from optlink.units import show

ALL = "step"  # name of what is stated for all lengths without an own grid
KEYS = (ALL, "from", "teeth")
NO_GRID = "none"
ON_GRID = 1e-7  # share of a step: a size this close to a grid value has it
MOST_TEETH = 400
FEW = 4  # sizes of a stock that are listed


@dataclass(frozen=True)
class Grid:
    """Values of a size [SI]: `origin` and whole multiples of `step` from it, or the `stock` in ascending order.

    `teeth`: least and largest number of teeth of two gears whose ratios are the stock.
    """

    step: float = 0.0
    stock: tuple[float, ...] = ()
    origin: float = 0.0
    teeth: tuple[int, int] | None = None

    def below(self, value: float) -> float:
        """Return the largest value of the grid up to a value; -inf if there is none."""
        if self.step:
            return self._at(math.floor((value - self.origin) / self.step + ON_GRID))
        k = bisect_right(self.stock, value * (1.0 + ON_GRID * math.copysign(1.0, value)))
        return self.stock[k - 1] if k else -math.inf

    def above(self, value: float) -> float:
        """Return the least value of the grid from a value on; inf if there is none."""
        if self.step:
            return self._at(math.ceil((value - self.origin) / self.step - ON_GRID))
        k = bisect_left(self.stock, value * (1.0 - ON_GRID * math.copysign(1.0, value)))
        return self.stock[k] if k < len(self.stock) else math.inf

    def _at(self, count: int) -> float:
        return float(f"{count * self.step + self.origin:.15g}")  # 535 steps of 0.0001 m are 0.0535 m

    def nearest(self, value: float) -> float:
        """Return the nearest value of the grid."""
        return min(self.below(value), self.above(value), key=lambda one: abs(one - value))

    def width(self, value: float) -> float:
        """Return the distance of the two values of the grid about a value, that to the nearest one beyond the last."""
        gap = self.above(value) - self.below(value)
        return self.step or (gap if gap < math.inf else abs(self.nearest(value) - value))

    def off(self, value: float) -> float:
        """Return how far a value is from the grid, as a share of its width there; zero on the grid but for rounding."""
        gap = abs(self.nearest(value) - value)
        return gap / self.width(value) if gap > ON_GRID * (self.step or abs(value)) else 0.0

    def finer(self, share: float) -> Grid:
        """Return the grid of steps divided by a number; stock remains."""
        return replace(self, step=self.step / share)

    def words(self, quantity: Quantity, value: float = math.nan) -> str:
        """Return the grid of a quantity in words; of gears with the numbers of teeth of a ratio on it."""
        if self.teeth:
            low, high = self.teeth
            ratio = Fraction(abs(value)).limit_denominator(high) if math.isfinite(value) else None
            least = 1 if ratio is None else math.ceil(low / min(ratio.numerator, ratio.denominator))
            chosen = f"{ratio.numerator * least}:{ratio.denominator * least} teeth, of " if ratio else ""
            return f"{chosen}{low} to {high} teeth"
        kind, unit = quantity.kind, quantity.unit
        if self.step:
            return show(self.step, kind, unit) + (f" from {show(self.origin, kind, unit)}" if self.origin else "")
        texts = [show(value, kind, unit) for value in self.stock]
        return ", ".join(texts) if len(texts) <= FEW else f"{len(texts)} sizes, {texts[0]} to {texts[-1]}"


def read_grids(stated: Mapping[str, object], quantities: Mapping[str, Quantity], names: Collection[str]) -> dict[str, Grid]:
    """Return the grid of each of some quantities for which one is stated, by name or by the step of all lengths.

    Parameters
    ----------
    stated : mapping of str to object
        A step, a list of stock sizes, or a table of `step` and `from` or of `teeth`, by the name of a quantity; a step by `step`.
    quantities : mapping of str to Quantity
    names : collection of str
        Quantities that may have a grid.

    Raises
    ------
    Unusable
        with the name as its key.
    """
    grids: dict[str, Grid] = {}
    for name, raw in stated.items():
        with below(name, raw):
            if name == ALL:
                if isinstance(raw, list | tuple | Mapping):
                    raise Unusable("a single step is needed for all sizes", 'Write step = "0.1 mm", and name the size of a stock')
                grid = Grid(_step(raw, "length"))
                grids |= {one: grid for one in names if quantities[one].in_metres and one not in stated}
                continue
            check_name(name, quantities, "no such size", value=raw)
            if name not in names:
                raise Unusable(f"{name} is no free size", f"Free sizes: {', '.join(names)}")
            grids[name] = _read(raw, quantities[name])
    return {name: grids[name] for name in names if name in grids}


def _read(raw: object, quantity: Quantity) -> Grid:
    """Read the grid of one quantity."""
    kind = quantity.kind
    if isinstance(raw, Mapping):
        check_keys(raw, KEYS)
        if "teeth" in raw and len(raw) == 1:
            return _of_teeth(raw["teeth"], quantity)
        if "teeth" in raw or ALL not in raw:
            raise Unusable(
                "a grid is a step, with or without a value from which it counts", 'Write { step = "25 mm", from = "5 mm" }'
            )
        signed = "coordinate" if kind == "length" else kind
        return Grid(_step(raw[ALL], kind, ALL), origin=read_scalar(raw["from"], signed, "from")[0] if "from" in raw else 0.0)
    if not isinstance(raw, list | tuple):
        return Grid(_step(raw, kind))
    values = {read_scalar(one, kind)[0] for one in raw}
    if not values:
        raise Unusable("the stock has no size", 'Write its sizes: ["50 mm", "60 mm"]')
    return Grid(stock=tuple(sorted(values)))


def _step(raw: object, kind: str, key: str = "") -> float:
    value = read_scalar(raw, "length" if kind == "coordinate" else kind, key)[0]
    if value <= 0.0:
        raise Unusable("a step must be positive", 'Give one above zero, for example "0.1 mm"', key)
    return value


def _of_teeth(raw: object, quantity: Quantity) -> Grid:
    """Return the ratios of two gears with whole numbers of teeth."""
    if quantity.kind != "ratio":
        raise Unusable("only the ratio of two gears has teeth", 'Give a step, for example "0.1 mm"', "teeth", raw)
    low, high = check_pair(
        raw, "two whole numbers are needed", "Write the least and the largest number: teeth = [12, 60]", "teeth"
    )
    if not (type(low) is type(high) is int and 1 <= low <= high <= MOST_TEETH):
        remedy = f"Write the least and the largest number, up to {MOST_TEETH}: teeth = [12, 60]"
        raise Unusable("two whole numbers in ascending order are needed", remedy, "teeth", raw)
    sign, counts = math.copysign(1.0, quantity.bounds[0]), range(low, high + 1)
    return Grid(stock=tuple(sorted({sign * one / other for one in counts for other in counts})), teeth=(low, high))


def with_grid(table: dict[str, Any], name: str, value: object) -> None:
    """Assign a grid in a [rounding] table, in place; None removes it."""
    remove(table, name)
    if value is not None:
        table[name] = value


Rounding = Annotated[dict[str, Any], BeforeValidator(lambda raw: by_name(raw, "rounding", KEYS))]
"""Grids as stated, by the name of the size, that of all other lengths by `step`."""
