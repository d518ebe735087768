"""Conflicting limits of an infeasible problem, as a table and as a sentence.

Relaxed values are rounded away from the limit value, so that a limit with the printed value is feasible.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Context

from optlink.report.format import figure, joined
from optlink.report.table_spec import TableSpec, table
from optlink.solvers.solution import Relaxation

MARGIN = 1e-6  # relative margin of a printed value: relaxations are found to about this accuracy


def conflict(limits: Sequence[Relaxation], together: Sequence[Relaxation]) -> TableSpec:
    """Tabulate conflicting limits with the relaxation that each would need.

    Parameters
    ----------
    limits : sequence of Relaxation
        Each limit relaxed alone; an infinite amount where that does not suffice.
    together : sequence of Relaxation
        Limits relaxed simultaneously; shown if one of `limits` does not suffice alone.
    """
    rows = [(_name(pair), _limit(pair), _relaxed(pair) or "not by this limit alone") for pair in _ranges(limits)]
    single = len(rows)
    if any(not math.isfinite(limit.amount) for limit in limits):
        rows += [(_name(pair), _limit(pair), f"together: {_relaxed(pair) or 'dropped'}") for pair in _ranges(together)]
    columns = ["limit", "limit value", "feasible if relaxed alone"]
    return table("Conflicting limits", columns, rows, sections=[single], notes=_exact_values(_ranges(limits)))


def contradiction(conflict: Sequence[Relaxation], together: Sequence[Relaxation]) -> str:
    """State in a sentence which limits conflict, and which relaxation makes the problem feasible.

    Parameters
    ----------
    conflict, together : sequence of Relaxation
        As for the table.
    """
    if not conflict:
        return ""
    limits = list(_ranges(conflict))
    options = [_option(pair) for pair in limits if math.isfinite(pair[0].amount)]
    if options:
        remedy = f"relax {' or '.join(options[:3])}"
    else:
        shared = [_option(pair) for pair in _ranges(together) if math.isfinite(pair[0].amount)]
        remedy = f"relax together {joined(shared[:3])}" if shared else "drop one of them"
    if len(limits) == 1:
        subject = f"the limit {_name(limits[0])} cannot be met"
    else:
        names = joined([f"{_name(pair)} ({_limit(pair)})" for pair in limits][:4])
        subject = f"{names} exclude {'each other' if len(limits) == 2 else 'one another'}"
    sentence = f"No design was found that meets all limits: {subject}. To make it feasible, {remedy}."
    return " ".join([sentence, *_exact_values(limits)])


def _exact_values(limits: Sequence[tuple[Relaxation, ...]]) -> list[str]:
    """Return how to state a least or a greatest value, for each limit whose two sides are the same."""
    values = [(_name(one), _value(one[0])) for one in limits if _exact(one)]
    return [f'A single value is exact: write ">= {x}" for the smallest or "<= {x}" for the largest {name}.' for name, x in values]


def _value(side: Relaxation) -> str:
    return f"{side.bound:g} {side.unit}".rstrip()


def _exact(sides: tuple[Relaxation, ...]) -> bool:
    return len(sides) > 1 and sides[0].bound == sides[1].bound


def _ranges(items: Sequence[Relaxation]) -> list[tuple[Relaxation, ...]]:
    """Group the two sides of each range that is relaxed as one."""
    groups: list[tuple[Relaxation, ...]] = []
    for item in items:
        pair = item.both_sides and groups and len(groups[-1]) == 1 and groups[-1][0].both_sides and groups[-1][0].key == item.key
        groups[-1:] = [(*groups[-1], item)] if pair else [*groups[-1:], (item,)]
    return groups


def _name(sides: tuple[Relaxation, ...]) -> str:
    """Return the name of a limit; of a range the last words that the names of both sides share."""
    words = [side.name.split()[::-1] for side in sides]
    shared = [word_pair for word_pair, *rest in itertools.takewhile(lambda pair: len(set(pair)) == 1, zip(*words, strict=False))]
    return " ".join(shared[::-1]) or sides[0].name


def _limit(sides: tuple[Relaxation, ...]) -> str:
    if "<=" in sides[0].name:
        return "must hold"
    if _exact(sides):
        return f"exactly {_value(sides[0])}"
    return _stated(sides, lambda side: f"{side.bound:g}")


def _relaxed(sides: tuple[Relaxation, ...]) -> str:
    if not math.isfinite(sides[0].amount):
        return ""
    amounts = dict.fromkeys(f"{side.amount:.4g} {side.unit}".rstrip() for side in sides)
    amount = f"{' and '.join(amounts)}{' each' * (len(amounts) < len(sides))}"
    if "<=" in sides[0].name:
        return f"missed by {amount}"
    return f"{_stated(sides, lambda side: f'{outward(side, 6):.6g}', 'about ' * sides[0].approximate)} ({amount})"


def _stated(sides: tuple[Relaxation, ...], value: Callable[[Relaxation], str], before: str = "") -> str:
    """Return a limit as sense and value, or a range as its two values, with the unit."""
    sense = f"{sides[0].sense} " if len(sides) == 1 else ""
    return f"{sense}{before}{' ... '.join(value(side) for side in sides)} {sides[0].unit}".rstrip()


def _option(sides: tuple[Relaxation, ...]) -> str:
    values = " ... ".join(figure(outward(side, 4), side.unit) for side in sides)
    return f"{_name(sides)} to {'about ' * sides[0].approximate}{values}"


def outward(side: Relaxation, digits: int) -> float:
    """Round a relaxed value away from its limit value.

    Parameters
    ----------
    side : Relaxation
    digits : int
        Significant digits.
    """
    if not math.isfinite(side.relaxed) or side.relaxed == 0.0:
        return side.relaxed
    rounding, sign = (ROUND_CEILING, 1.0) if side.relaxed > side.bound else (ROUND_FLOOR, -1.0)
    return float(Context(digits, rounding).create_decimal_from_float(side.relaxed + sign * MARGIN * abs(side.relaxed)))
