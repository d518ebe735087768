"""Table of the conflicting limits of an infeasible problem."""

from collections.abc import Callable, Sequence

from optlink.report.table_spec import TableSpec, table
from optlink.solvers.solution import Relaxation
from optlink.tasks.results.conflict import OpposedLimit, opposed_limits, outward


def conflict(limits: Sequence[Relaxation], together: Sequence[Relaxation]) -> TableSpec:
    """Tabulate conflicting limits with the relaxation that each would need alone, infinite where that does not suffice.

    Limits relaxed together are shown in that case.
    """
    opposed = opposed_limits(limits)
    rows = [(limit.name, _limit(limit), _relaxed(limit) or "not by this limit alone") for limit in opposed]
    single = len(rows)
    if not all(limit.satisfiable for limit in opposed):
        shared = opposed_limits(together)
        rows += [(limit.name, _limit(limit), f"together: {_relaxed(limit) or 'dropped'}") for limit in shared]
    columns = ["limit", "limit value", "feasible if relaxed alone"]
    return table("Conflicting limits", columns, rows, sections=[single], notes=_exact_values(opposed))


def _exact_values(limits: Sequence[OpposedLimit]) -> list[str]:
    """Return how to state a least or a greatest value, for each limit whose two sides are the same."""
    values = [(limit.name, _value(limit.sides[0])) for limit in limits if limit.exact]
    return [f'A single value is exact: write ">= {x}" for the smallest or "<= {x}" for the largest {name}.' for name, x in values]


def _value(side: Relaxation) -> str:
    return f"{side.bound:g} {side.unit}".rstrip()


def _limit(limit: OpposedLimit) -> str:
    if "<=" in limit.name:
        return "must hold"
    if limit.exact:
        return f"exactly {_value(limit.sides[0])}"
    return _stated(limit.sides, lambda side: f"{side.bound:g}")


def _relaxed(limit: OpposedLimit) -> str:
    if not limit.satisfiable:
        return ""
    sides = limit.sides
    amounts = dict.fromkeys(f"{side.amount:.4g} {side.unit}".rstrip() for side in sides)
    amount = f"{' and '.join(amounts)}{' each' * (len(amounts) < len(sides))}"
    if "<=" in limit.name:
        return f"missed by {amount}"
    return f"{_stated(sides, lambda side: f'{outward(side, 6):.6g}', 'about ' * sides[0].approximate)} ({amount})"


def _stated(sides: tuple[Relaxation, ...], value: Callable[[Relaxation], str], before: str = "") -> str:
    """Return a limit as sense and value, or a range as its two values, with the unit."""
    sense = f"{sides[0].sense} " if len(sides) == 1 else ""
    return f"{sense}{before}{' ... '.join(value(side) for side in sides)} {sides[0].unit}".rstrip()
