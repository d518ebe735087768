"""Charts and page of a tolerance analysis: variance contributions, band over the crank angle, histogram."""

import math
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from optlink.problem.file import ProblemFile
from optlink.report.chart_spec import Array, Axis, Band, Bars, ChartSpec, Curve, Line, Panel, Trace, crank_angle
from optlink.report.html import chart_plotly
from optlink.report.html.shell import PageSection, StoredStudy
from optlink.report.stored.stored_study import turning_linkage
from optlink.report.style import BODIES, CRANK, LIMIT, RESULT, SHADE, TARGET
from optlink.report.view import View
from optlink.report.views import conclusions, tolerance_tables
from optlink.report.views.tolerance_tables import judged_value
from optlink.studies.tolerance.analysis import ToleranceRecord
from optlink.studies.tolerance.monte_carlo import MonteCarloRecord
from optlink.units import percent

COLOURS = (CRANK, *BODIES)
LIMIT_RATIO = 2.5  # the limit is drawn up to this multiple of the drawn range
MAX_BINS = 60  # largest number of bars in a histogram


# --- the page ----------------------------------------------------------------------------------------------------------------


def stored_study(record: ToleranceRecord, file: ProblemFile, _: Path) -> StoredStudy:
    """Build the report of a stored tolerance analysis.

    Parameters
    ----------
    file : ProblemFile
        The problem of the study.

    Raises
    ------
    Contradiction
        If a tolerance or a size of the problem is missing in its parts.
    """
    allocation, robust = record.allocation, record.robust
    shown = tolerance_tables.tolerance_result(record, file)
    by = "exact derivatives at the drawing"
    if record.monte_carlo is not None:
        samples, seed = record.monte_carlo.samples, record.monte_carlo.seed
        by += f", and {samples:,} sampled linkages (Sobol, seed {seed}), with exact kinematics"
    return StoredStudy(
        problem=file,
        kind="study of tolerances",
        verdict=_verdict(record),
        valid=(allocation is None or allocation.achieved) and (robust is None or robust.valid),
        conclusion=conclusions.tolerance(record),
        status=shown.status.lines,
        sections=[PageSection("Scatter", chart_plotly.charts(charts(record))), PageSection("Figures", (shown.parts,))],
        moving=partial(
            turning_linkage,
            file,
            {name: value for name, value in record.sizes_SI.items() if name in file.model.mechanism.quantities},
        ),
        by=by,
        drawn="The linkage with nominal dimensions.",
        after=1,
    )


def _verdict(record: ToleranceRecord) -> str:
    if record.allocation is not None and not record.allocation.achieved:
        return "The allocated tolerances do not keep the yield"
    if record.robust is not None and not record.robust.valid:
        return "The robust design is not valid"
    if record.monte_carlo is not None and math.isfinite(record.monte_carlo.share):
        return f"Yield {percent(record.monte_carlo.share, 3)}"
    return "Done"


# --- charts ------------------------------------------------------------------------------------------------------------------


def charts(record: ToleranceRecord) -> list[ChartSpec]:
    """Return variance contributions, band over the crank angle, and histogram of the samples."""
    sampled = record.monte_carlo
    histogram = [_histogram(record, sampled)] if sampled is not None and len(sampled.histogram.counts) else []
    shares = [_contributions(record)] if len(record.tolerances) > 1 else []  # of a single tolerance it is all
    return [*shares, _band(record), *histogram]


def _contributions(record: ToleranceRecord) -> ChartSpec:
    """Plot the variance contributions: stacked over the crank angle, or as bars if there is only one."""
    parts = sorted(record.tolerances, key=lambda part: -np.mean(part.contribution_percent))
    colours = [COLOURS[k % len(COLOURS)] for k in range(len(parts))]
    title, heading = f"Variance contributions to {record.output}", f"{record.title}: variance contributions to its scatter"
    x = record.crank_angles_deg
    if len(x) == 1:
        places, shares = np.arange(len(parts), 0.0, -1.0), np.array([float(part.contribution_percent[0]) for part in parts])
        bars = Bars(places, shares, "share", colours, 0.8, horizontal=True, legend=False)
        names = Axis(ticks=[(place, part.name) for place, part in zip(places.tolist(), parts, strict=True)])
        across = Axis(f"share of the variance at {x[0]:.4g} deg [%]")
        panel = Panel(names, [bars], 0.2 * len(parts) + 0.4)
        return ChartSpec("contributions", title, [panel], across, heading, cursor=False, width=8.0)
    ends = np.cumsum([np.zeros(len(x)), *(part.contribution_percent for part in parts)], axis=0)
    bands = [
        Band(x, low, high, part.name, colour, 0.85, values=part.contribution_percent)
        for part, colour, low, high in zip(parts, colours, ends[:-1], ends[1:], strict=True)
    ]
    panel = Panel(Axis("share of the variance [%]", (0.0, 100.0)), bands, 1.5)
    return ChartSpec("contributions", title, [panel], crank_angle(), heading, width=8.0)


def _band(record: ToleranceRecord) -> ChartSpec:
    """Plot the error or the change of the output: worst case, three standard deviations, sample extremes, limit."""
    x, k, linear, base = record.crank_angles_deg, record.scale, record.linear, record.judged_as_drawn
    mode: Literal["lines", "lines+markers"] = "lines" if len(x) > 2 else "lines+markers"
    error, limit = bool(np.any(base)), k * record.limit
    wide = x if len(x) > 1 else x + np.array([-0.5, 0.5])  # a single angle has a visible band too
    low, high = (np.broadcast_to(k * (base + column), wide.shape) for column in (linear.worst_low, linear.worst_high))
    traces: list[Trace] = [Band(wide, low, high, "worst case", SHADE, 1.0)]
    traces += [Curve(x, k * base, "nominal", RESULT, 2.0, mode=mode)] if error else []
    for sign in (1.0, -1.0):
        three = k * (base + linear.shift + 3.0 * sign * linear.sigma)
        traces.append(Curve(x, three, "three standard deviations", RESULT, 1.2, "dash", mode, legend=sign > 0.0))
    if record.monte_carlo is not None:
        ends = f"ends of {record.monte_carlo.samples:,} samples"
        for column, legend in ((record.monte_carlo.most, True), (record.monte_carlo.least, False)):
            traces.append(Curve(x, k * (base + column), ends, TARGET, 1.1, "dot", mode, legend=legend))
    reach = 1.05 * max(np.nanmax(np.abs(y)) for trace in traces for y in _heights(trace))
    words, lines, ends_of_y = f"limit ±{limit:.5g} {record.display_unit}", list[Line](), None
    if limit <= LIMIT_RATIO * reach:
        lines = [Line(limit, words, LIMIT, 1.6, "solid"), Line(-limit, "", LIMIT, 1.6, "solid")]
        ends_of_y = -max(reach, 1.1 * limit), max(reach, 1.1 * limit)
    elif math.isfinite(limit):
        traces.append(Curve.entry(f"{words} (far outside)", LIMIT))
    what = record.output if error else f"change of {record.output}"
    panel = Panel(Axis(f"{what} [{record.display_unit}]", ends_of_y), traces, 1.7, lines)
    output = f"the {record.output}" if error else record.output
    title, heading = f"Scatter of {record.output}", f"{record.title}: {output} as built"
    return ChartSpec("band", title, [panel], crank_angle(), heading, width=8.0)


def _heights(trace: Trace) -> tuple[Array, ...]:
    return (trace.low, trace.high) if isinstance(trace, Band) else (trace.y,) if isinstance(trace, Curve) else ()


def _histogram(record: ToleranceRecord, sampled: MonteCarloRecord) -> ChartSpec:
    """Plot the histogram of the largest error or change of each sample, and the limit."""
    counts, edges = sampled.histogram.counts, record.scale * sampled.histogram.edges
    merged = max(1, -(-len(counts) // MAX_BINS))
    starts = np.arange(0, len(counts), merged)
    left, right = edges[starts], edges[np.minimum(starts + merged, len(counts))]
    heights = 100.0 * np.add.reduceat(counts, starts) / sampled.samples
    middle, limit = 0.5 * (left + right), record.scale * record.limit
    limited = math.isfinite(limit)
    over = middle > limit
    bars = [
        Bars(middle[mask], heights[mask], words, colour, (right - left)[mask], legend=limited)
        for mask, words, colour in ((~over, "within the limit" if limited else "samples", RESULT), (over, "beyond it", LIMIT))
        if np.any(mask)
    ]
    low, high = sampled.interval
    share, least, most = (percent(value, 3) for value in (sampled.share, low, high))
    remark = f"Yield {share}, with 95 % confidence {least} ... {most}." if limited else ""
    what = judged_value(record) if np.any(record.judged_as_drawn) else f"change of {record.output}"
    title = f"{sampled.samples:,} linkages with their tolerances"
    panel, x = Panel(Axis("share of the samples [%]"), bars, 1.4), f"largest {what} at any of the crank angles"
    text, unit = (f"{record.title}: {title}", remark), record.display_unit
    lines = [Line(limit, f"limit {limit:.5g} {unit}", LIMIT, 1.6, "solid")] if limited else []
    return ChartSpec("histogram", title, [panel], Axis(f"{x} [{unit}]"), *text, lines, cursor=False, width=8.0)


VIEW = View(model=ToleranceRecord.of, charts=charts, tables=lambda result: {"tolerance": result.columns}, page=stored_study)
