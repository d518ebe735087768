"""Tables of a tolerance analysis: variance contributions, worst case, scatter, yield, tolerance allocation."""

import math

import numpy as np

from optlink.problem.file import ProblemFile
from optlink.problem.tolerances import CONTACT, Deviation
from optlink.report.format import dimension, fixed, number
from optlink.report.table_spec import Row, Summary, TableSpec, bad, good, quiet, strong, summary, table
from optlink.studies.tolerance.allocation import Allocation
from optlink.studies.tolerance.analysis import Tolerance
from optlink.studies.tolerance.monte_carlo import MonteCarlo
from optlink.studies.tolerance.robust_design import RobustDesign
from optlink.studies.tolerance.sampling import CONFIDENCE
from optlink.units import percent

INTERVAL = f"{100.0 * CONFIDENCE:g} % CI"


def tolerances(result: Tolerance) -> Summary:
    """Summarise a tolerance analysis."""
    status = f"effect of the tolerances on {result.nominal.name}, at {len(result.nominal.crank_angles)} crank angles"
    return summary(
        result.problem.model.title,
        [status],
        _redesigned(result, result.robust) if result.robust is not None else None,
        _contributions(result),
        _scatter(result),
        _sampled(result, result.monte_carlo) if result.monte_carlo is not None else None,
        _allocated(result, result.allocation) if result.allocation is not None else None,
    )


def judged_value(result: Tolerance) -> str:
    """Return the name of the judged value: an error, or the change of an output."""
    return "error" if np.any(result.nominal.base) else "change"


def _unit(file: ProblemFile, deviation: Deviation) -> tuple[float, str]:
    """Return factor from SI and name of the display unit of a deviation."""
    quantity = file.model.mechanism.quantities.get(deviation.size)
    return (math.degrees(1.0), "deg") if quantity is not None and quantity.kind == "angle" else (1e3, "mm")


def _symmetric(value: float, unit: tuple[float, str], digits: int = 6) -> str:
    """Format a symmetric tolerance [SI] in its display unit."""
    return f"±{number(unit[0] * value, digits)} {unit[1]}"


def _distribution(deviation: Deviation) -> str:
    if deviation.values:
        return f"measured, {len(deviation.values):,} parts"
    return f"{CONTACT}, adds to {deviation.size}" if deviation.shape == CONTACT else deviation.shape


def _between(sampled: MonteCarlo) -> str:
    low, high = sampled.interval
    return f"{100.0 * low:z.3f} ... {percent(high, 3)} ({INTERVAL})"


def _redesigned(result: Tolerance, robust: RobustDesign) -> TableSpec:
    rows, redesign = list[Row](), robust.result
    for name in result.problem.model.free:
        factor, unit = result.problem.model.display(name)
        before, after = (dimension(factor * design[name]) for design in (robust.nominal, redesign.design))
        rows.append((name, before, strong(after), unit))
    words = "largest, nominal" if robust.by_yield else "largest"
    unit = result.display_unit
    rows.append((words, *(fixed(result.scale * value, 4) for value in (robust.before, redesign.objective)), unit))
    if result.unrobust is not None and result.monte_carlo is not None and result.limit is not None:
        both, limit = (result.unrobust, result.monte_carlo), f"within {number(result.scale * result.limit)} {unit}".strip()
        rows.append(("yield", percent(both[0].share, 3), strong(percent(both[1].share, 3)), quiet(limit)))
        for end, name in enumerate(("at least", "at most")):
            rows.append([quiet(text) for text in (name, *(percent(sample.interval[end], 3) for sample in both), INTERVAL)])
    passed = "verified; no design with a higher yield was found" if robust.by_yield else "verified"
    failed = ": ".join(filter(None, ("not verified", ", ".join(redesign.validation.failed))))
    notes = [good(passed) if redesign.valid else bad(failed)]
    if result.nominal_yields_more:
        notes.append(bad("The nominal optimum has a higher yield within this limit: use it, or search with --robust yield."))
    title = "Maximised: the yield" if robust.by_yield else f"Minimised: the largest error with {robust.counted}"
    return table(title, ["", ">nominal optimum", ">robust", ""], rows, notes=notes)


def _contributions(result: Tolerance) -> TableSpec:
    at, parts = result.where, zip(result.deviations, result.effects, 100.0 * result.contributions, strict=True)
    units, rows = {_unit(result.problem, deviation)[1] for deviation in result.deviations}, []
    for deviation, by, shares in sorted(parts, key=lambda part: -part[2][at]):
        unit = _unit(result.problem, deviation)
        per = f"{result.scale * by[at] / unit[0]:+z.5f}"
        cells = quiet(_distribution(deviation)), per, strong(f"{shares[at]:z.1f} %"), f"{np.mean(shares):z.1f} %"
        rows.append((deviation.name, _symmetric(deviation.tolerance, unit), *cells))
    change = f">change [{result.display_unit or '-'}\nper {' or '.join(sorted(units, reverse=True))}]"
    columns = ["", ">tolerance", "distribution", change, ">share of the\nvariance", ">over all\nangles"]
    return table(f"Variance contributions at the worst crank angle: {result.nominal.degrees[at]:.4g} deg", columns, rows)


def _scatter(result: Tolerance) -> TableSpec:
    (low, high), rows = result.worst, []
    for name, column, sign in (
        ("worst case", np.maximum(-low, high), "±"),
        ("root of the sum of squares", result.rss, "±"),
        ("standard deviation", result.sigma, ""),
    ):
        at = int(np.argmax(column))
        rows.append((name, sign + number(result.scale * column[at], 5), quiet(f"at {result.nominal.degrees[at]:.4g} deg")))
    return table(f"Change of the output to first order{result.bracketed}", "<><", rows)


def _sampled(result: Tolerance, sampled: MonteCarlo) -> TableSpec:
    scale, unit, at = result.scale, result.display_unit, result.where
    sigma = f"{number(scale * sampled.sigma[at], 5)} ± {number(scale * 2.0 * sampled.sigma_error[at], 2)}"
    rows: list[Row] = [
        ("standard deviation", sigma, quiet(f"{unit}, at {result.nominal.degrees[at]:.4g} deg".removeprefix(", ")))
    ]
    for name, value in sampled.quantiles.items():
        shown = number(scale * value, 5) if math.isfinite(value) else "beyond the histogram"
        rows.append((f"largest {judged_value(result)}: {name.removesuffix('_percent')} % below", shown, unit))
    if sampled.stuck:
        rows.append((bad("cannot be assembled"), f"{sampled.stuck:,}", ""))
    if result.limit is not None:
        limit = f"yield, within {number(scale * result.limit)} {unit}".strip()
        rows.append((limit, strong(percent(sampled.share, 3)), quiet(_between(sampled))))
        rows.append(("yield by the linear model", percent(sampled.linear_share, 3), ""))
    rows.append((quiet("time"), quiet(f"{sampled.seconds:z.2f} s"), ""))
    title = f"{sampled.samples:,} sampled linkages (Sobol, seed {sampled.seed}), exact kinematics"
    return table(title, "<><", rows)


def _allocated(result: Tolerance, allocation: Allocation) -> TableSpec:
    rows, check = [], allocation.monte_carlo
    for deviation, allocated, cost in zip(result.deviations, allocation.tolerances, allocation.costs, strict=True):
        unit = _unit(result.problem, deviation)
        sizes = _symmetric(deviation.tolerance, unit), strong(_symmetric(allocated, unit, 4))
        rows.append((deviation.name, *sizes, number(cost), "has no effect" if deviation.name in allocation.free else ""))
    checked = f"checked by {check.samples:,} others: {percent(check.share, 3)}, {_between(check)}"
    share = number(allocation.cost / allocation.before)
    title = f"Least costly tolerances for a yield of {percent(allocation.target_yield, 3)}: cost {share} of the specified ones"
    columns = ["", ">specified", ">allocated", ">cost coefficient", ""]
    return table(title, columns, rows, notes=[good(checked) if allocation.achieved else bad(checked)])
