"""Terminal tables of a tolerance analysis: variance contributions, worst case, scatter, yield, tolerance allocation."""

from __future__ import annotations

import math

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from optlink.problem.tolerances import CONTACT, Deviation
from optlink.report.views.function_tables import BAD, GOOD, HEAD, QUIET, fixed, grid, number
from optlink.studies.tolerance.allocation import Allocation
from optlink.studies.tolerance.analysis import Tolerance
from optlink.studies.tolerance.monte_carlo import MonteCarlo
from optlink.studies.tolerance.nominal import display_unit
from optlink.studies.tolerance.robust_design import YIELD, RobustDesign
from optlink.studies.tolerance.sampling import CONFIDENCE
from optlink.tasks.function import display_value as inhabited

SURE = f"{100.0 * CONFIDENCE:g} % sure"


def tolerances(result: Tolerance) -> RenderableType:
    """Summarise a tolerance analysis."""
    title = Text(result.problem.model.title, style=HEAD)
    title.append(f"\nwhat tolerances do to {result.nominal.name}, at {len(result.nominal.crank_angles)} crank angles")
    parts: list[RenderableType] = [title, Text()]
    if result.robust is not None:
        parts += [_redesigned(result, result.robust), Text()]
    parts += [_blame(result), Text(), _scatter(result)]
    if result.carlo is not None:
        parts += [Text(), _sampled(result, result.carlo)]
    if result.allocation is not None:
        parts += [Text(), _allocated(result, result.allocation)]
    return Group(*parts)


def size(deviation: Deviation, value: float, digits: int = 6) -> str:
    """Format a deviation in its display unit.

    Parameters
    ----------
    deviation : Deviation
        Determines the unit.
    value : float [m, rad]
    digits : int, optional
        Significant digits.
    """
    if deviation.kind == "angle":
        return f"{number(math.degrees(value), digits)} deg"
    return f"{number(1e3 * value, digits)} mm"


def _shape(deviation: Deviation) -> str:
    if deviation.values:
        return f"measured, {len(deviation.values):,} parts"
    return f"{deviation.shape}, adds to {deviation.size}" if deviation.shape == CONTACT else deviation.shape


def made(counted: str) -> str:
    """Describe the objective of a robust design."""
    return "Maximised: the yield" if counted == YIELD else f"Minimised: the largest error with {counted}"


def judged(counted: str) -> str:
    """Return the name of the largest error of a robust design."""
    return "largest as drawn" if counted == YIELD else "largest"


def proven(counted: str) -> str:
    """Describe what is proven of a robust design."""
    return "its limits are proven; none with more yield was found" if counted == YIELD else "proven"


def _redesigned(result: Tolerance, found: RobustDesign) -> Table:
    columns = [("", "left"), ("best as drawn", "right"), ("robust", "right"), ("", "left")]
    table = grid(made(found.counted), columns, header=True)
    for name, value in found.free.items():
        before, unit = inhabited(name, found.nominal[name])
        table.add_row(name, fixed(before), Text(fixed(inhabited(name, value)[0]), style=HEAD), unit)
    table.add_row(judged(found.counted), fixed(math.degrees(found.before), 4), fixed(math.degrees(found.value), 4), "deg")
    if result.carlo is not None and result.unrobust is not None and result.limit is not None:
        best, own = result.unrobust, result.carlo
        limit = f"within {number(math.degrees(result.limit))} deg"
        table.add_row("yield", percent(best.share), Text(percent(own.share), style=HEAD), Text(limit, style=QUIET))
        for end, name in enumerate(("at least", "at most")):
            ends = (percent(carlo.interval[end]) for carlo in (best, own))
            table.add_row(Text(name, style=QUIET), *(Text(text, style=QUIET) for text in ends), Text(SURE, style=QUIET))
    failed = ", ".join(check.name for check in found.result.validation.checks if not check.passed)
    word = Text(proven(found.counted) if found.valid else f"not proven: {failed}", style=GOOD if found.valid else BAD)
    if result.beaten:
        word.append("\nThe best as drawn yields more within this limit: build that one, or search --robust yield.", style=BAD)
    table.caption = word
    table.caption_justify = "left"
    return table


def _blame(result: Tolerance) -> Table:
    scale, unit = display_unit(result.nominal)
    at = result.where
    each = " or ".join(sorted({"deg" if d.kind == "angle" else "mm" for d in result.deviations}, reverse=True))
    angle = math.degrees(result.nominal.crank_angles[at])
    table = grid(
        f"Variance contributions at the worst crank angle: {angle:.4g} deg",
        [
            ("", "left"),
            ("tolerance", "right"),
            ("distribution", "left"),
            (f"change [{unit}\nper {each}]", "right"),
            ("share of the\nvariance", "right"),
            ("over all\nangles", "right"),
        ],
        header=True,
    )
    shares, overall = result.contributions[:, at], np.mean(result.contributions, axis=1)
    for i in np.argsort(-shares, kind="stable"):
        d = result.deviations[i]
        per = scale * result.by[i, at] * (math.radians(1.0) if d.kind == "angle" else 1e-3)
        shown = (f"{per:+.5f}", Text(f"{100.0 * shares[i]:.1f} %", style=HEAD), f"{100.0 * overall[i]:.1f} %")
        table.add_row(d.name, f"±{size(d, d.tolerance)}", Text(_shape(d), style=QUIET), *shown)
    return table


def _scatter(result: Tolerance) -> Table:
    scale, unit = display_unit(result.nominal)
    degrees = np.degrees(result.nominal.crank_angles)
    table = grid(f"Change of the output to first order [{unit}]", [("", "left"), ("", "right"), ("", "left")])
    both = np.maximum(-result.worst[0], result.worst[1])
    rows = [("worst case", both), ("root of the sum of squares", result.rss), ("standard deviation", result.sigma)]
    for name, column in rows:
        at = int(np.argmax(column))
        sign = "±" if name != "standard deviation" else ""
        table.add_row(name, sign + number(scale * column[at], 5), Text(f"at {degrees[at]:.4g} deg", style=QUIET))
    return table


def _sampled(result: Tolerance, carlo: MonteCarlo) -> Table:
    scale, unit = display_unit(result.nominal)
    what = "largest error" if np.any(result.nominal.base) else "largest change"
    title = f"{carlo.samples:,} linkages with deviations drawn (Sobol, seed {carlo.seed}), moved exactly"
    table = grid(title, [("", "left"), ("", "right"), ("", "left")])
    at = result.where
    sigma = f"{number(scale * carlo.sigma[at], 5)} ± {number(scale * 2.0 * carlo.sigma_error[at], 2)}"
    table.add_row("standard deviation", sigma, Text(f"{unit}, at {math.degrees(result.nominal.crank_angles[at]):.4g} deg"))
    for share in (0.5, 0.99):
        table.add_row(f"{what}: {100.0 * share:g} % below", number(scale * carlo.below(share), 5), unit)
    if carlo.stuck:
        table.add_row(Text("cannot be assembled", style=BAD), f"{carlo.stuck:,}", "")
    if result.limit is not None:
        limit = f"within {number(scale * result.limit)} {unit}"
        table.add_row(f"yield, {limit}", Text(percent(carlo.share), style=HEAD), Text(_between(carlo), style=QUIET))
        table.add_row("yield by the linear model", percent(carlo.linear_share), "")
    table.add_row(Text("time", style=QUIET), Text(f"{carlo.seconds:.2f} s", style=QUIET), "")
    return table


def percent(share: float) -> str:
    """Format a yield in per cent; a dash if it is not finite."""
    return f"{100.0 * share:.3f} %" if math.isfinite(share) else "-"


def _between(carlo: MonteCarlo) -> str:
    low, high = carlo.interval
    return f"{100.0 * low:.3f} ... {percent(high)} ({SURE})"


def _allocated(result: Tolerance, found: Allocation) -> Table:
    title = (
        f"The loosest tolerances for a yield of {percent(found.wanted)}: cost {number(found.cost / found.before)} of the given"
    )
    columns = [("", "left"), ("given", "right"), ("allocated", "right"), ("cost coefficient", "right"), ("", "left")]
    table = grid(title, columns, header=True)
    for d, value, cost in zip(result.deviations, found.tolerances, found.costs, strict=True):
        remark = "has no effect" if d.name in found.free else ""
        table.add_row(d.name, f"±{size(d, d.tolerance)}", Text(f"±{size(d, value, 4)}", style=HEAD), number(cost), remark)
    checked = f"checked by {found.carlo.samples:,} others: {percent(found.carlo.share)}, {_between(found.carlo)}"
    table.caption = Text(checked, style=GOOD if found.kept else BAD)
    table.caption_justify = "left"
    return table
