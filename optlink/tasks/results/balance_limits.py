"""Limits of a balancing result in display units: at the optimum with their shadow prices, and where they conflict."""

from optlink.balancing.optimum import Conflict
from optlink.balancing.socp import NOTHING, BalanceBound, Price
from optlink.tasks.results.balance import ACTIVE, ActiveLimit, RelaxedLimit

SHOWN: dict[str, tuple[str, float, float]] = {
    "mass": ("kg", 1.0, 0.01),
    "length": ("mm", 1e3, 1e-3),
    "stiffness": ("N/m", 1.0, 0.0),
    "force": ("N", 1.0, 0.0),
    "measure": ("", 1.0, 0.0),
}
"""Kinds of limits: display unit, value in it of one in SI, step of the shadow price [SI]; zero: one per cent of the limit."""


def _shown(limit: Price | BalanceBound) -> tuple[str, str, float, float]:
    """Return sense, display unit, factor from SI to it, and step [SI] of a limit."""
    unit, factor, step = SHOWN[limit.kind]
    if limit.kind == "measure":
        unit = "N m" if "moment" in limit.name or "torque" in limit.name else "N"
    return "at most" if limit.sense > 0 else "at least", unit, factor, step or 0.01 * abs(limit.bound)


def active_limit(price: Price, after: float, scale: float) -> ActiveLimit:
    """Return a limit at the optimum with its shadow price.

    `after` is the scaled objective of the balanced machine, `scale` the objective over the scaled one.
    """
    sense, unit, factor, step = _shown(price)
    return ActiveLimit(
        price.name,
        sense,
        price.bound * factor,
        price.value * factor,
        unit,
        abs(price.bound - price.value) <= ACTIVE * max(abs(price.bound), 1e-12),
        price.price * scale / factor,
        step * factor,
        price.price * step / after if after > NOTHING else 0.0,
        price.depends_on,
    )


def relaxed_limit(item: Conflict) -> RelaxedLimit:
    """Return a limit that conflicts with others, with the values that it would need."""
    sense, unit, factor, _ = _shown(item.bound)
    bound, single, together = (value * factor for value in (item.bound.bound, item.alone, item.together))
    return RelaxedLimit(item.bound.name, sense, bound, single, together, unit)
