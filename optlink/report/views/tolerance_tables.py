"""Tables of a tolerance analysis: variance contributions, worst case, scatter, yield, tolerance allocation."""

import math

import numpy as np

from optlink.problem.base_model import Contradiction
from optlink.problem.file import ProblemFile
from optlink.problem.tolerances import CONTACT
from optlink.report.format import dimension, fixed, number
from optlink.report.table_spec import Row, Summary, TableSpec, bad, good, quiet, strong, summary, table
from optlink.studies.tolerance.allocation import AllocationRecord
from optlink.studies.tolerance.analysis import DeviationRecord, Tolerance, ToleranceRecord
from optlink.studies.tolerance.monte_carlo import MonteCarloRecord
from optlink.studies.tolerance.robust_design import YIELD, RobustRecord
from optlink.studies.tolerance.sampling import CONFIDENCE
from optlink.units import percent

INTERVAL = f"{100.0 * CONFIDENCE:g} % CI"


def tolerances(result: Tolerance) -> Summary:
    """Summarise a tolerance analysis."""
    return tolerance_result(ToleranceRecord.of(result), result.problem)


def tolerance_result(record: ToleranceRecord, file: ProblemFile) -> Summary:
    """Summarise the record of a tolerance analysis.

    Parameters
    ----------
    file : ProblemFile
        The problem of the study.

    Raises
    ------
    Contradiction
        If a tolerance or a size of the problem is missing in its parts.
    """
    status = f"effect of the tolerances on {record.output}, at {len(record.crank_angles_deg)} crank angles"
    return summary(
        file.model.title,
        [status],
        _redesigned(file, record, record.robust) if record.robust is not None else None,
        _contributions(file, record),
        _scatter(record),
        _sampled(record, record.monte_carlo) if record.monte_carlo is not None else None,
        _allocated(file, record, record.allocation) if record.allocation is not None else None,
    )


def judged_value(record: ToleranceRecord) -> str:
    """Return the name of the judged value: an error, or the change of an output."""
    return "error" if np.any(record.judged_as_drawn) else "change"


def _unit(file: ProblemFile, part: DeviationRecord) -> tuple[float, str]:
    """Return factor from SI and name of the display unit of a deviation."""
    quantity = file.model.mechanism.quantities.get(part.adds_to)
    return (math.degrees(1.0), "deg") if quantity is not None and quantity.kind == "angle" else (1e3, "mm")


def _symmetric(value: float, unit: tuple[float, str], digits: int = 6) -> str:
    """Format a symmetric tolerance [SI] in its display unit."""
    return f"±{number(unit[0] * value, digits)} {unit[1]}"


def _distribution(part: DeviationRecord) -> str:
    if part.measured_parts:
        return f"measured, {part.measured_parts:,} parts"
    return f"{CONTACT}, adds to {part.adds_to}" if part.distribution == CONTACT else part.distribution


def _between(sampled: MonteCarloRecord) -> str:
    low, high = sampled.interval
    return f"{100.0 * low:z.3f} ... {percent(high, 3)} ({INTERVAL})"


def _redesigned(file: ProblemFile, record: ToleranceRecord, robust: RobustRecord) -> TableSpec:
    counted, rows = robust.counted, list[Row]()
    for name in file.model.free:
        if name not in robust.design_SI or name not in robust.nominal_design_SI:
            raise Contradiction(f"robust.design_SI.{name}", "this is missing")
        factor, unit = file.model.display(name)
        before, after = (dimension(factor * design[name]) for design in (robust.nominal_design_SI, robust.design_SI))
        rows.append((name, before, strong(after), unit))
    largest = (robust.largest_of_the_nominal_design_rad, robust.largest_rad)
    words = "largest, nominal" if counted == YIELD else "largest"
    rows.append((words, *(fixed(math.degrees(value), 4) for value in largest), "deg"))
    best, redesign = robust.monte_carlo_of_the_nominal_design, record.monte_carlo
    if best is not None and redesign is not None and math.isfinite(record.limit):
        limit = f"within {number(math.degrees(record.limit))} deg"
        rows.append(("yield", percent(best.share, 3), strong(percent(redesign.share, 3)), quiet(limit)))
        for end, name in enumerate(("at least", "at most")):
            rows.append(
                [quiet(text) for text in (name, *(percent(sample.interval[end], 3) for sample in (best, redesign)), INTERVAL)]
            )
    passed = "verified; no design with a higher yield was found" if counted == YIELD else "verified"
    failed = ": ".join(filter(None, ("not verified", ", ".join(robust.failed_checks or ()))))
    notes = [good(passed) if robust.valid else bad(failed)]
    if robust.the_nominal_design_yields_more:
        notes.append(bad("The nominal optimum has a higher yield within this limit: use it, or search with --robust yield."))
    title = "Maximised: the yield" if counted == YIELD else f"Minimised: the largest error with {counted}"
    return table(title, ["", ">nominal optimum", ">robust", ""], rows, notes=notes)


def _contributions(file: ProblemFile, record: ToleranceRecord) -> TableSpec:
    at, rows = record.where, []
    units = {_unit(file, part)[1] for part in record.tolerances}
    for part in sorted(record.tolerances, key=lambda part: -part.contribution_percent[at]):
        unit, shares = _unit(file, part), part.contribution_percent
        per = f"{record.scale * part.per_deviation[at] / unit[0]:+z.5f}"
        cells = quiet(_distribution(part)), per, strong(f"{shares[at]:z.1f} %"), f"{np.mean(shares):z.1f} %"
        rows.append((part.name, _symmetric(part.tolerance_SI, unit), *cells))
    change = f">change [{record.display_unit}\nper {' or '.join(sorted(units, reverse=True))}]"
    columns = ["", ">tolerance", "distribution", change, ">share of the\nvariance", ">over all\nangles"]
    return table(f"Variance contributions at the worst crank angle: {record.crank_angles_deg[at]:.4g} deg", columns, rows)


def _scatter(record: ToleranceRecord) -> TableSpec:
    linear, rows = record.linear, []
    for name, column, sign in (
        ("worst case", np.maximum(-linear.worst_low, linear.worst_high), "±"),
        ("root of the sum of squares", linear.rss, "±"),
        ("standard deviation", linear.sigma, ""),
    ):
        at = int(np.argmax(column))
        rows.append((name, sign + number(record.scale * column[at], 5), quiet(f"at {record.crank_angles_deg[at]:.4g} deg")))
    return table(f"Change of the output to first order [{record.display_unit}]", "<><", rows)


def _sampled(record: ToleranceRecord, sampled: MonteCarloRecord) -> TableSpec:
    scale, unit, at = record.scale, record.display_unit, record.where
    sigma = f"{number(scale * sampled.sigma[at], 5)} ± {number(scale * 2.0 * sampled.sigma_standard_error[at], 2)}"
    rows: list[Row] = [("standard deviation", sigma, quiet(f"{unit}, at {record.crank_angles_deg[at]:.4g} deg"))]
    for name, value in sampled.stays_below.items():
        shown = number(scale * value, 5) if math.isfinite(value) else "beyond the histogram"
        rows.append((f"largest {judged_value(record)}: {name.removesuffix('_percent')} % below", shown, unit))
    if sampled.cannot_be_assembled:
        rows.append((bad("cannot be assembled"), f"{sampled.cannot_be_assembled:,}", ""))
    if math.isfinite(sampled.share):
        limit = f"yield, within {number(scale * record.limit)} {unit}"
        rows.append((limit, strong(percent(sampled.share, 3)), quiet(_between(sampled))))
        rows.append(("yield by the linear model", percent(sampled.yield_by_the_linear_model, 3), ""))
    rows.append((quiet("time"), quiet(f"{sampled.seconds:z.2f} s"), ""))
    title = f"{sampled.samples:,} sampled linkages (Sobol, seed {sampled.seed}), exact kinematics"
    return table(title, "<><", rows)


def _allocated(file: ProblemFile, record: ToleranceRecord, allocation: AllocationRecord) -> TableSpec:
    rows, check = [], allocation.check
    for part in record.tolerances:
        if part.name not in allocation.tolerances_SI or part.name not in allocation.cost_coefficients:
            raise Contradiction(f"allocation.tolerances_SI.{part.name}", "this is missing")
        unit = _unit(file, part)
        sizes = _symmetric(part.tolerance_SI, unit), strong(_symmetric(allocation.tolerances_SI[part.name], unit, 4))
        remark = "has no effect" if part.name in allocation.without_effect else ""
        rows.append((part.name, *sizes, number(allocation.cost_coefficients[part.name]), remark))
    checked = f"checked by {check.samples:,} others: {percent(check.share, 3)}, {_between(check)}"
    share = number(allocation.cost / allocation.cost_of_specified)
    title = f"Least costly tolerances for a yield of {percent(allocation.target_yield, 3)}: cost {share} of the specified ones"
    columns = ["", ">specified", ">allocated", ">cost coefficient", ""]
    return table(title, columns, rows, notes=[good(checked) if allocation.achieved else bad(checked)])
