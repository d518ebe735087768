"""HTML sections of a tolerance analysis: variance contributions, scatter, yield, tolerance allocation."""

from __future__ import annotations

import math
from collections.abc import Iterator
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from optlink.problem.file import ProblemFile
from optlink.record import Contradiction
from optlink.report.format import number, percent
from optlink.report.html.chart_plotly import Chart, Panel, Trace, axis, line, sheet, short, stacked
from optlink.report.html.shell import Section
from optlink.report.stored.stored_study import Studied, figures_of, turning
from optlink.report.style import BODIES, CRANK, FOUND, LIMIT, SHADE, WANTED
from optlink.report.table_spec import Row, TableSpec, bad, good, quiet, strong, table
from optlink.report.views.tolerance_tables import judged, made, proven
from optlink.studies.tolerance.allocation import AllocationRecord
from optlink.studies.tolerance.analysis import DeviationRecord, ToleranceRecord
from optlink.studies.tolerance.monte_carlo import MonteCarloRecord
from optlink.studies.tolerance.robust_design import RobustRecord
from optlink.tasks.function import display_value

Array = NDArray[np.float64]
COLOURS = (CRANK, *BODIES)
NEAR = 2.5  # the limit is drawn up to this multiple of the worst-case band
BARS = 60  # largest number of bars in a histogram


# --- the page ----------------------------------------------------------------------------------------------------------------


def studied(found: ToleranceRecord, file: ProblemFile, _: Path) -> Studied:
    """Build the report of a stored tolerance analysis.

    Parameters
    ----------
    found : ToleranceRecord
    file : ProblemFile
        The problem of the study.

    Raises
    ------
    InputError
        If the record is damaged.
    """
    allocation, robust = found.allocation, found.robust
    valid = (allocation is None or allocation.kept) and (robust is None or robust.valid)
    tables = [_blame(file, found), _scatter(found)]
    tables += [_told(found, found.monte_carlo)] if found.monte_carlo is not None else []
    tables += [_allocated(file, found, allocation)] if allocation is not None else []
    tables += [_redesigned(file, found, robust)] if robust is not None else []
    charts = [_contributions(found), _band(found)]
    charts += (
        [_histogram(found, found.monte_carlo)]
        if found.monte_carlo is not None and len(found.monte_carlo.histogram.counts)
        else []
    )
    return Studied(
        problem=file,
        kind="study of tolerances",
        verdict=_verdict(found),
        valid=valid,
        status=[f"what tolerances do to {found.output}, at {len(found.crank_angles_deg)} crank angles"],
        sections=[Section("Scatter", charts), *figures_of(tables)],
        moving=turning(file, {name: value for name, value in found.sizes_SI.items() if name in file.model.mechanism.quantities}),
        by=_by(found),
        drawn="The linkage as drawn.",
        after=1,
    )


def _verdict(found: ToleranceRecord) -> str:
    if found.allocation is not None and not found.allocation.kept:
        return "The allocated tolerances do not keep the yield"
    if found.robust is not None and not found.robust.valid:
        return "The robust design is not proven"
    if found.monte_carlo is not None and math.isfinite(found.monte_carlo.share):
        return f"Yield {percent(found.monte_carlo.share)}"
    return "Done"


def _by(found: ToleranceRecord) -> str:
    by = "exact derivatives at the drawing"
    if found.monte_carlo is not None:
        samples, seed = found.monte_carlo.samples, found.monte_carlo.seed
        by += f", and {samples:,} linkages with deviations drawn (Sobol, seed {seed}), moved exactly"
    return by


def _symmetric(value: float, factor: float, unit: str) -> str:
    """Format a symmetric tolerance [SI] in its display unit."""
    return f"±{number(factor * value)} {unit}"


def _unit_of(file: ProblemFile, part: DeviationRecord) -> tuple[float, str]:
    """Return factor from SI and name of the display unit of a tolerance."""
    quantity = file.model.mechanism.quantities.get(part.adds_to)
    return (math.degrees(1.0), "deg") if quantity is not None and quantity.kind == "angle" else (1e3, "mm")


def _blame(file: ProblemFile, found: ToleranceRecord) -> TableSpec:
    at, rows = found.where, []
    for part in sorted(found.tolerances, key=lambda part: -part.contribution_percent[at]):
        shape = part.distribution if part.adds_to == part.name else f"{part.distribution}, adds to {part.adds_to}"
        per = f"{found.scale * part.per_deviation[at] * part.tolerance_SI:+.4g}"
        shares = strong(f"{part.contribution_percent[at]:.1f} %"), f"{float(np.mean(part.contribution_percent)):.1f} %"
        rows.append((part.name, _symmetric(part.tolerance_SI, *_unit_of(file, part)), quiet(shape), per, *shares))
    columns = ["", ">tolerance", "distribution", f">change [{found.display_unit}]\nper tolerance"]
    columns += [">share of the\nvariance", ">over all\nangles"]
    return table(f"Variance contributions at the worst crank angle: {found.crank_angles_deg[at]:.4g} deg", columns, rows)


def _scatter(found: ToleranceRecord) -> TableSpec:
    both = np.maximum(-found.linear.worst_low, found.linear.worst_high)
    values = {"worst case": both, "root of the sum of squares": found.linear.rss, "standard deviation": found.linear.sigma}
    rows = []
    for name, column in values.items():
        at = int(np.argmax(column))
        sign = "" if name == "standard deviation" else "±"
        rows.append((name, sign + number(found.scale * column[at], 5), quiet(f"at {found.crank_angles_deg[at]:.4g} deg")))
    return table(f"Change of the output to first order [{found.display_unit}]", "<><", rows)


def _told(found: ToleranceRecord, sampled: MonteCarloRecord) -> TableSpec:
    at = found.where
    sigma, error = (found.scale * getattr(sampled, name)[at] for name in ("sigma", "sigma_standard_error"))
    where = quiet(f"{found.display_unit}, at {found.crank_angles_deg[at]:.4g} deg")
    rows: list[Row] = [("standard deviation", f"{number(sigma, 5)} ± {number(2.0 * error, 2)}", where)]
    for name, value in sampled.stays_below.items():
        told = number(found.scale * value, 5) if math.isfinite(value) else "beyond the histogram"
        rows.append((f"{_judged(found)}: {name.removesuffix('_percent')} % below", told, found.display_unit))
    if sampled.cannot_be_assembled:
        rows.append((bad("cannot be assembled"), f"{sampled.cannot_be_assembled:,}", ""))
    if math.isfinite(sampled.share):
        low, high = sampled.interval
        limit = f"yield, within {number(found.scale * found.limit)} {found.display_unit}"
        rows.append((limit, strong(percent(sampled.share)), quiet(f"{percent(low)} ... {percent(high)} (95 % sure)")))
        rows.append(("yield by the linear model", percent(sampled.yield_by_the_linear_model), ""))
    title = f"{sampled.samples:,} linkages with deviations drawn (Sobol, seed {sampled.seed}), moved exactly"
    return table(title, "<><", rows)


def _judged(found: ToleranceRecord) -> str:
    return "largest error" if np.any(found.judged_as_drawn) else "largest change"


def _allocated(file: ProblemFile, found: ToleranceRecord, allocation: AllocationRecord) -> TableSpec:
    rows, check = [], allocation.check
    for part in found.tolerances:
        if part.name not in allocation.tolerances_SI or part.name not in allocation.cost_coefficients:
            raise Contradiction(f"allocation.tolerances_SI.{part.name}", "this is missing")
        unit = _unit_of(file, part)
        sizes = _symmetric(part.tolerance_SI, *unit), strong(_symmetric(allocation.tolerances_SI[part.name], *unit))
        idle = "has no effect" if part.name in allocation.without_effect else ""
        rows.append((part.name, *sizes, number(allocation.cost_coefficients[part.name]), idle))
    low, high = check.interval
    told = f"checked by {check.samples:,} others: {percent(check.share)}, {percent(low)} ... {percent(high)} (95 % sure)"
    share = number(allocation.cost / allocation.cost_of_those_given)
    title = f"The loosest tolerances for a yield of {percent(allocation.wanted_yield)}: cost {share} of the given"
    columns = ["", ">given", ">allocated", ">cost coefficient", ""]
    return table(title, columns, rows, notes=[good(told) if allocation.kept else bad(told)])


def _redesigned(file: ProblemFile, found: ToleranceRecord, robust: RobustRecord) -> TableSpec:
    rows: list[Row] = []
    for name in file.model.free:
        if name not in robust.design_SI or name not in robust.nominal_design_SI:
            raise Contradiction(f"robust.design_SI.{name}", "this is missing")
        old, unit = display_value(name, robust.nominal_design_SI[name])
        rows.append((name, number(old, 7), strong(number(display_value(name, robust.design_SI[name])[0], 7)), unit))
    values = [number(math.degrees(value), 5) for value in (robust.largest_of_the_nominal_design_rad, robust.largest_rad)]
    rows.append((judged(robust.counted), *values, "deg"))
    other = robust.monte_carlo_of_the_nominal_design
    if other is not None and found.monte_carlo is not None and math.isfinite(found.monte_carlo.share):
        rows.append(("yield", percent(other.share), strong(percent(found.monte_carlo.share)), ""))
    note = good(proven(robust.counted)) if robust.valid else bad("not proven")
    return table(made(robust.counted), ["", ">best as drawn", ">robust", ""], rows, notes=[note])


# --- charts ------------------------------------------------------------------------------------------------------------------


def _ordered(found: ToleranceRecord) -> Iterator[tuple[DeviationRecord, str]]:
    """Yield the deviations with their colours, by decreasing mean contribution."""
    order = sorted(found.tolerances, key=lambda part: -float(np.mean(part.contribution_percent)))
    return ((part, COLOURS[k % len(COLOURS)]) for k, part in enumerate(order))


def _contributions(found: ToleranceRecord) -> Chart:
    """Plot the variance contributions: stacked over the crank angle, or as bars if there is only one."""
    title = f"Variance contributions to {found.output}"
    if len(found.crank_angles_deg) > 1:
        curves: list[Trace] = [
            line(found.crank_angles_deg, part.contribution_percent, part.name, colour, width=0.6)
            | {"stackgroup": "shares", "fillcolor": colour}
            for part, colour in _ordered(found)
        ]
        figure = stacked([Panel("share of the variance [%]", curves, 1.4)])
        figure["layout"]["yaxis"] |= {"range": [0, 100]}
        figure["layout"]["legend"] |= {"traceorder": "normal"}
        return Chart(title, figure)
    parts = list(_ordered(found))[::-1]
    names, shares = (
        [escape(part.name) for part, _ in parts],
        short(np.array([float(part.contribution_percent[0]) for part, _ in parts])),
    )
    bars: Trace = {"type": "bar", "orientation": "h", "name": "share", "y": names, "x": shares}
    layout = sheet(110 + 26 * len(parts)) | {"showlegend": False, "hovermode": "closest"}
    layout["xaxis"] = axis(f"share of the variance at {found.crank_angles_deg[0]:.4g} deg [%]")
    layout["yaxis"] = axis("") | {"type": "category"}
    return Chart(
        title, {"data": [bars | {"marker": {"color": [colour for _, colour in parts]}}], "layout": layout}, cranked=False
    )


def _band(found: ToleranceRecord) -> Chart:
    """Plot the change of the output: worst case, three standard deviations, sample extremes, and the margin to the limit."""
    x, k, linear = found.crank_angles_deg, found.scale, found.linear
    mode = "lines" if len(x) > 2 else "markers"
    low = line(x, k * linear.worst_low, "worst case", SHADE, width=1.0)
    high = line(x, k * linear.worst_high, "worst case", SHADE, width=1.0)
    curves: list[Trace] = [low | {"showlegend": False}, high | {"fill": "tonexty", "fillcolor": SHADE}]
    for sign in (1.0, -1.0):
        three = line(x, k * (linear.shift + 3.0 * sign * linear.sigma), "three standard deviations", FOUND, mode=mode)
        curves.append(three | {"showlegend": sign > 0.0})
    if found.monte_carlo is not None:
        for name in ("most", "least"):
            reached = line(
                x,
                k * getattr(found.monte_carlo, name),
                f"ends of {found.monte_carlo.samples:,} samples",
                WANTED,
                width=1.3,
                dash="dot",
            )
            curves.append(reached | {"showlegend": name == "most"})
    reach = 1.1 * k * float(np.max(np.abs([linear.worst_low, linear.worst_high])))
    if math.isfinite(found.limit):
        rooms = [k * (sign * found.limit - found.judged_as_drawn) for sign in (1.0, -1.0)]
        near = 1.1 * float(np.min(np.abs(rooms)))
        far = near > NEAR * reach
        words = "what the limit leaves (far outside)" if far else "what the limit leaves"
        curves += [line(x, room, words, LIMIT, width=1.5) | {"showlegend": room is rooms[0]} for room in rooms]
        reach = reach if far else max(reach, near)
    figure = stacked([Panel(f"change of {found.output} [{found.display_unit}]", curves, 1.6)])
    figure["layout"]["yaxis"] |= {"range": [-reach, reach]} if reach > 0.0 else {}
    figure["layout"]["legend"] |= {"traceorder": "normal"}
    return Chart(f"Scatter of {found.output}", figure)


def _histogram(found: ToleranceRecord, sampled: MonteCarloRecord) -> Chart:
    """Plot the histogram of the largest error or change of each sample."""
    merged = max(1, -(-len(sampled.histogram.counts) // BARS))
    starts = np.arange(0, len(sampled.histogram.counts), merged)
    ends = np.minimum(starts + merged, len(sampled.histogram.counts))
    left, right = found.scale * sampled.histogram.edges[starts], found.scale * sampled.histogram.edges[ends]
    heights = 100.0 * np.add.reduceat(sampled.histogram.counts, starts) / sampled.samples
    middle, limit = 0.5 * (left + right), found.scale * found.limit
    over = middle > limit if math.isfinite(limit) else np.zeros(len(middle), dtype=bool)
    bars: list[Trace] = [
        {"type": "bar", "name": words, "x": short(middle[own]), "y": short(heights[own]), "width": short((right - left)[own])}
        | {"marker": {"color": colour}}
        for own, words, colour in (
            (~over, "within the limit" if math.isfinite(limit) else "samples", FOUND),
            (over, "beyond it", LIMIT),
        )
        if np.any(own)
    ]
    layout = sheet(380) | {"bargap": 0.0, "barmode": "overlay", "hovermode": "closest"}
    layout["xaxis"] = axis(f"{_judged(found)} at any of the crank angles [{found.display_unit}]")
    layout["yaxis"] = axis("share of the samples [%]")
    if math.isfinite(limit):
        layout["shapes"] = [
            {"type": "line", "x0": limit, "x1": limit, "yref": "paper", "y0": 0, "y1": 1, "line": {"color": LIMIT}}
        ]
    title = f"{sampled.samples:,} linkages with their tolerances"
    low, high = sampled.interval
    remark = (
        f"Yield {percent(sampled.share)}, with 95 % confidence {percent(low)} ... {percent(high)}."
        if math.isfinite(limit)
        else ""
    )
    return Chart(title, {"data": bars, "layout": layout}, cranked=False, remark=remark)
