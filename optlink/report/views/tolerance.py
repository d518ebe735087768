"""Charts and page of a tolerance analysis: variance contributions, band over the crank angle, histogram."""

import math
from functools import partial
from typing import Literal

import numpy as np

from optlink.report.chart_spec import Array, Axis, Band, Bars, ChartSpec, Curve, Line, Panel, Trace, crank_angle
from optlink.report.html import chart_plotly
from optlink.report.html.shell import PageSection, StoredStudy
from optlink.report.html.study_page import turning_linkage
from optlink.report.style import BODIES, CRANK, LIMIT, RESULT, SHADE, TARGET
from optlink.report.view import View
from optlink.report.views import conclusions, tolerance_tables
from optlink.report.views.tolerance_tables import judged_value
from optlink.studies.tolerance.analysis import Tolerance
from optlink.studies.tolerance.monte_carlo import MonteCarlo
from optlink.units import percent

COLOURS = (CRANK, *BODIES)
LIMIT_RATIO = 2.5  # the limit is drawn up to this multiple of the drawn range
MAX_BINS = 60  # largest number of bars in a histogram


# --- the page ----------------------------------------------------------------------------------------------------------------


def page(result: Tolerance) -> StoredStudy:
    """Return the page of a tolerance analysis."""
    problem, sampled, robust = result.problem, result.monte_carlo, result.robust
    shown = tolerance_tables.tolerances(result)
    by = "exact derivatives at the drawing"
    if sampled is not None:
        by += f", and {sampled.samples:,} sampled linkages (Sobol, seed {sampled.seed}), with exact kinematics"
    sizes = {name: value for name, value in result.nominal.sizes.items() if name in problem.model.mechanism.quantities}
    return StoredStudy(
        problem=problem,
        kind="study of tolerances",
        verdict=_verdict(result),
        valid=(result.allocation is None or result.allocation.achieved) and (robust is None or robust.result.valid),
        conclusion=conclusions.tolerance(result),
        status=shown.status.lines,
        sections=[PageSection("Scatter", chart_plotly.charts(charts(result))), PageSection("Figures", (shown.parts,))],
        moving=partial(turning_linkage, problem, sizes),
        by=by,
        drawn="The linkage with nominal dimensions.",
        after=1,
    )


def _verdict(result: Tolerance) -> str:
    if result.allocation is not None and not result.allocation.achieved:
        return "The allocated tolerances do not keep the yield"
    if result.robust is not None and not result.robust.result.valid:
        return "The robust design is not valid"
    if result.monte_carlo is not None and result.limit is not None:
        return f"Yield {percent(result.monte_carlo.share, 3)}"
    return "Done"


# --- charts ------------------------------------------------------------------------------------------------------------------


def charts(result: Tolerance) -> list[ChartSpec]:
    """Return variance contributions, band over the crank angle, and histogram of the samples."""
    sampled = result.monte_carlo
    histogram = [_histogram(result, sampled)] if sampled is not None and np.any(sampled.counts) else []
    shares = [_contributions(result)] if len(result.deviations) > 1 else []  # of a single tolerance it is all
    return [*shares, _band(result), *histogram]


def _contributions(result: Tolerance) -> ChartSpec:
    """Plot the variance contributions: stacked over the crank angle, or as bars if there is only one."""
    named = zip([deviation.name for deviation in result.deviations], 100.0 * result.contributions, strict=True)
    parts = sorted(named, key=lambda part: -np.mean(part[1]))
    colours = [COLOURS[k % len(COLOURS)] for k in range(len(parts))]
    title = f"Variance contributions to {result.nominal.name}"
    heading, x = f"{result.problem.model.title}: variance contributions to its scatter", result.nominal.degrees
    if len(x) == 1:
        places, shares = np.arange(len(parts), 0.0, -1.0), np.array([float(share[0]) for _, share in parts])
        bars = Bars(places, shares, "share", colours, 0.8, horizontal=True, legend=False)
        names = Axis(ticks=[(place, name) for place, (name, _) in zip(places.tolist(), parts, strict=True)])
        across = Axis(f"share of the variance at {x[0]:.4g} deg [%]")
        panel = Panel(names, [bars], 0.2 * len(parts) + 0.4)
        return ChartSpec("contributions", title, [panel], across, heading, cursor=False, width=8.0)
    ends = np.cumsum([np.zeros(len(x)), *(share for _, share in parts)], axis=0)
    bands = [
        Band(x, low, high, name, colour, 0.85, values=share)
        for (name, share), colour, low, high in zip(parts, colours, ends[:-1], ends[1:], strict=True)
    ]
    panel = Panel(Axis("share of the variance [%]", (0.0, 100.0)), bands, 1.5)
    return ChartSpec("contributions", title, [panel], crank_angle(), heading, width=8.0)


def _band(result: Tolerance) -> ChartSpec:
    """Plot the error or the change of the output: worst case, three standard deviations, sample extremes, limit."""
    x, k, base, unit = result.nominal.degrees, result.scale, result.nominal.base, result.display_unit
    mode: Literal["lines", "lines+markers"] = "lines" if len(x) > 2 else "lines+markers"
    error, limit = bool(np.any(base)), math.nan if result.limit is None else k * result.limit
    wide = x if len(x) > 1 else x + np.array([-0.5, 0.5])  # a single angle has a visible band too
    low, high = (np.broadcast_to(k * (base + column), wide.shape) for column in result.worst)
    traces: list[Trace] = [Band(wide, low, high, "worst case", SHADE, 1.0)]
    traces += [Curve(x, k * base, "nominal", RESULT, 2.0, mode=mode)] if error else []
    for sign in (1.0, -1.0):
        three = k * (base + result.shift + 3.0 * sign * result.sigma)
        traces.append(Curve(x, three, "three standard deviations", RESULT, 1.2, "dash", mode, legend=sign > 0.0))
    if result.monte_carlo is not None:
        ends = f"ends of {result.monte_carlo.samples:,} samples"
        for column, legend in ((result.monte_carlo.most, True), (result.monte_carlo.least, False)):
            traces.append(Curve(x, k * (base + column), ends, TARGET, 1.1, "dot", mode, legend=legend))
    reach = 1.05 * max(np.nanmax(np.abs(y)) for trace in traces for y in _heights(trace))
    words, lines, ends_of_y = f"limit ±{limit:.5g} {unit}", list[Line](), None
    if limit <= LIMIT_RATIO * reach:
        lines = [Line(limit, words, LIMIT, 1.6, "solid"), Line(-limit, "", LIMIT, 1.6, "solid")]
        ends_of_y = -max(reach, 1.1 * limit), max(reach, 1.1 * limit)
    elif math.isfinite(limit):
        traces.append(Curve.entry(f"{words} (far outside)", LIMIT))
    name = result.nominal.name
    what = name if error else f"change of {name}"
    panel = Panel(Axis(f"{what}{result.bracketed}", ends_of_y), traces, 1.7, lines)
    output = f"the {name}" if error else name
    title, heading = f"Scatter of {name}", f"{result.problem.model.title}: {output} as built"
    return ChartSpec("band", title, [panel], crank_angle(), heading, width=8.0)


def _heights(trace: Trace) -> tuple[Array, ...]:
    return (trace.low, trace.high) if isinstance(trace, Band) else (trace.y,) if isinstance(trace, Curve) else ()


def _histogram(result: Tolerance, sampled: MonteCarlo) -> ChartSpec:
    """Plot the histogram of the largest error or change of each sample, and the limit."""
    edges, counts = sampled.histogram
    edges = result.scale * edges
    merged = max(1, -(-len(counts) // MAX_BINS))
    starts = np.arange(0, len(counts), merged)
    left, right = edges[starts], edges[np.minimum(starts + merged, len(counts))]
    heights = 100.0 * np.add.reduceat(counts, starts) / sampled.samples
    middle, limited = 0.5 * (left + right), result.limit is not None
    limit = math.nan if result.limit is None else result.scale * result.limit
    over = middle > limit
    bars = [
        Bars(middle[mask], heights[mask], words, colour, (right - left)[mask], legend=limited)
        for mask, words, colour in ((~over, "within the limit" if limited else "samples", RESULT), (over, "beyond it", LIMIT))
        if np.any(mask)
    ]
    low, high = sampled.interval
    share, least, most = (percent(value, 3) for value in (sampled.share, low, high))
    remark = f"Yield {share}, with 95 % confidence {least} ... {most}." if limited else ""
    what = judged_value(result) if np.any(result.nominal.base) else f"change of {result.nominal.name}"
    title = f"{sampled.samples:,} linkages with their tolerances"
    panel, x = Panel(Axis("share of the samples [%]"), bars, 1.4), f"largest {what} at any of the crank angles"
    text, unit = (f"{result.problem.model.title}: {title}", remark), result.display_unit
    lines = [Line(limit, f"limit {limit:.5g} {unit}", LIMIT, 1.6, "solid")] if limited else []
    return ChartSpec("histogram", title, [panel], Axis(f"{x}{result.bracketed}"), *text, lines, cursor=False, width=8.0)


VIEW = View(charts=charts, tables=lambda result: {"tolerance": result.columns}, page=page, result=Tolerance)
