"""Tables of a tolerance analysis: variance contributions, worst case, scatter, yield, tolerance allocation."""

from __future__ import annotations

import math

import numpy as np

from optlink.problem.tolerances import CONTACT, Deviation
from optlink.report.format import fixed, number, percent
from optlink.report.table_spec import Row, Summary, TableSpec, bad, good, quiet, strong, summary, table
from optlink.studies.tolerance.allocation import Allocation
from optlink.studies.tolerance.analysis import Tolerance
from optlink.studies.tolerance.monte_carlo import MonteCarlo
from optlink.studies.tolerance.nominal import display_unit
from optlink.studies.tolerance.robust_design import YIELD, RobustDesign
from optlink.studies.tolerance.sampling import CONFIDENCE
from optlink.tasks.function import display_value

SURE = f"{100.0 * CONFIDENCE:g} % sure"


def tolerances(result: Tolerance) -> Summary:
    """Summarise a tolerance analysis."""
    status = f"what tolerances do to {result.nominal.name}, at {len(result.nominal.crank_angles)} crank angles"
    return summary(
        result.problem.model.title,
        [status],
        _redesigned(result, result.robust) if result.robust is not None else None,
        _blame(result),
        _scatter(result),
        _sampled(result, result.carlo) if result.carlo is not None else None,
        _allocated(result, result.allocation) if result.allocation is not None else None,
    )


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


def _redesigned(result: Tolerance, found: RobustDesign) -> TableSpec:
    rows: list[Row] = []
    for name, value in found.free.items():
        before, unit = display_value(name, found.nominal[name])
        rows.append((name, fixed(before), strong(fixed(display_value(name, value)[0])), unit))
    ends = (fixed(math.degrees(value), 4) for value in (found.before, found.value))
    rows.append((judged(found.counted), *ends, "deg"))
    if result.carlo is not None and result.unrobust is not None and result.limit is not None:
        best, own = result.unrobust, result.carlo
        limit = f"within {number(math.degrees(result.limit))} deg"
        rows.append(("yield", percent(best.share), strong(percent(own.share)), quiet(limit)))
        for end, name in enumerate(("at least", "at most")):
            rows.append([quiet(text) for text in (name, *(percent(one.interval[end]) for one in (best, own)), SURE)])
    failed = ", ".join(check.name for check in found.result.validation.checks if not check.passed)
    notes = [good(proven(found.counted)) if found.valid else bad(f"not proven: {failed}")]
    if result.beaten:
        notes.append(bad("The best as drawn yields more within this limit: build that one, or search --robust yield."))
    return table(made(found.counted), ["", ">best as drawn", ">robust", ""], rows, notes=notes)


def _blame(result: Tolerance) -> TableSpec:
    scale, unit = display_unit(result.nominal)
    at = result.where
    each = " or ".join(sorted({"deg" if d.kind == "angle" else "mm" for d in result.deviations}, reverse=True))
    shares, overall = result.contributions[:, at], np.mean(result.contributions, axis=1)
    rows = []
    for i in np.argsort(-shares, kind="stable"):
        d = result.deviations[i]
        per = f"{scale * result.by[i, at] * (math.radians(1.0) if d.kind == 'angle' else 1e-3):+.5f}"
        share = strong(f"{100.0 * shares[i]:.1f} %")
        rows.append((d.name, f"±{size(d, d.tolerance)}", quiet(_shape(d)), per, share, f"{100.0 * overall[i]:.1f} %"))
    title = f"Variance contributions at the worst crank angle: {math.degrees(result.nominal.crank_angles[at]):.4g} deg"
    columns = ["", ">tolerance", "distribution", f">change [{unit}\nper {each}]", ">share of the\nvariance", ">over all\nangles"]
    return table(title, columns, rows)


def _scatter(result: Tolerance) -> TableSpec:
    scale, unit = display_unit(result.nominal)
    degrees = np.degrees(result.nominal.crank_angles)
    both = np.maximum(-result.worst[0], result.worst[1])
    rows = []
    for name, column, sign in (
        ("worst case", both, "±"),
        ("root of the sum of squares", result.rss, "±"),
        ("standard deviation", result.sigma, ""),
    ):
        at = int(np.argmax(column))
        rows.append((name, sign + number(scale * column[at], 5), quiet(f"at {degrees[at]:.4g} deg")))
    return table(f"Change of the output to first order [{unit}]", "<><", rows)


def _sampled(result: Tolerance, carlo: MonteCarlo) -> TableSpec:
    scale, unit = display_unit(result.nominal)
    what = "largest error" if np.any(result.nominal.base) else "largest change"
    at = result.where
    sigma = f"{number(scale * carlo.sigma[at], 5)} ± {number(scale * 2.0 * carlo.sigma_error[at], 2)}"
    where = f"{unit}, at {math.degrees(result.nominal.crank_angles[at]):.4g} deg"
    rows: list[Row] = [("standard deviation", sigma, where)]
    rows += [(f"{what}: {100.0 * share:g} % below", number(scale * carlo.below(share), 5), unit) for share in (0.5, 0.99)]
    if carlo.stuck:
        rows.append((bad("cannot be assembled"), f"{carlo.stuck:,}", ""))
    if result.limit is not None:
        limit = f"within {number(scale * result.limit)} {unit}"
        rows.append((f"yield, {limit}", strong(percent(carlo.share)), quiet(_between(carlo))))
        rows.append(("yield by the linear model", percent(carlo.linear_share), ""))
    rows.append((quiet("time"), quiet(f"{carlo.seconds:.2f} s"), ""))
    title = f"{carlo.samples:,} linkages with deviations drawn (Sobol, seed {carlo.seed}), moved exactly"
    return table(title, "<><", rows)


def _between(carlo: MonteCarlo) -> str:
    low, high = carlo.interval
    return f"{100.0 * low:.3f} ... {percent(high)} ({SURE})"


def _allocated(result: Tolerance, found: Allocation) -> TableSpec:
    rows = []
    for d, value, cost in zip(result.deviations, found.tolerances, found.costs, strict=True):
        remark = "has no effect" if d.name in found.free else ""
        rows.append((d.name, f"±{size(d, d.tolerance)}", strong(f"±{size(d, value, 4)}"), number(cost), remark))
    share = number(found.cost / found.before)
    checked = f"checked by {found.carlo.samples:,} others: {percent(found.carlo.share)}, {_between(found.carlo)}"
    title = f"The loosest tolerances for a yield of {percent(found.wanted)}: cost {share} of the given"
    columns = ["", ">given", ">allocated", ">cost coefficient", ""]
    return table(title, columns, rows, notes=[good(checked) if found.kept else bad(checked)])
