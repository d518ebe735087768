"""Tables, charts and page of a tolerance analysis: variance contributions, band over the crank angle, histogram."""

import math
from typing import Literal

import numpy as np

from optlink.presentation.chart_spec import (
    BODIES,
    CRANK,
    LIMIT,
    RESULT,
    SHADE,
    TARGET,
    Axis,
    Band,
    Bars,
    ChartSpec,
    Curve,
    Line,
    Panel,
    drive_axis,
)
from optlink.presentation.format import dimension, figure, fixed, number
from optlink.presentation.table_spec import Row, Summary, TableSpec, bad, good, quiet, strong, summary, table
from optlink.presentation.view import PageSection, StoredStudy, View
from optlink.problem.file import ProblemFile
from optlink.problem.tolerances import CONTACT, Deviation
from optlink.studies.tolerances.allocation import Allocation
from optlink.studies.tolerances.analysis import Tolerance
from optlink.studies.tolerances.monte_carlo import MonteCarlo
from optlink.studies.tolerances.robust_design import RobustDesign
from optlink.studies.tolerances.sampling import CONFIDENCE
from optlink.units import percent

INTERVAL = f"{100.0 * CONFIDENCE:g} % CI"

COLOURS = (CRANK, *BODIES)
LIMIT_RATIO = 2.5  # the limit is drawn up to this multiple of the drawn range
MAX_BINS = 60  # largest number of bars in a histogram


# --- the page ----------------------------------------------------------------------------------------------------------------


def page(result: Tolerance) -> StoredStudy:
    """Return the page of a tolerance analysis."""
    problem, sampled = result.problem, result.monte_carlo
    shown = overview(result)
    by = "exact derivatives at the drawing"
    if sampled is not None:
        by += f", and {sampled.samples:,} sampled linkages (Sobol, seed {sampled.seed}), with exact kinematics"
    sizes = {name: value for name, value in result.nominal.sizes.items() if name in problem.model.mechanism.quantities}
    return StoredStudy(
        problem=problem,
        kind="study of tolerances",
        verdict=_verdict(result),
        valid=result.valid,
        conclusion=conclusion(result),
        status=shown.status.lines,
        sections=[PageSection("Scatter", charts(result)), PageSection("Figures", (shown.parts,))],
        design=(problem, sizes),
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
    heading, x = f"{result.problem.model.title}: variance contributions to its scatter", result.nominal.places
    if len(x) == 1:
        places, shares = np.arange(len(parts), 0.0, -1.0), np.array([share[0] for _, share in parts])
        bars = Bars(places, shares, "share", colours, 0.8, horizontal=True, legend=False)
        names = Axis(ticks=[(place, name) for place, (name, _) in zip(places.tolist(), parts, strict=True)])
        across = Axis(f"share of the variance at {_place(result, 0)} [%]")
        panel = Panel(names, [bars], 0.2 * len(parts) + 0.4)
        return ChartSpec("contributions", title, [panel], across, heading, cursor=False, width=8.0)
    ends = np.cumsum([np.zeros(len(x)), *(share for _, share in parts)], axis=0)
    bands = [
        Band(x, low, high, name, colour, 0.85, values=share)
        for (name, share), colour, low, high in zip(parts, colours, ends[:-1], ends[1:], strict=True)
    ]
    panel = Panel(Axis("share of the variance [%]", (0.0, 100.0)), bands, 1.5)
    return ChartSpec("contributions", title, [panel], drive_axis(result.problem.model.driving), heading, width=8.0)


def _band(result: Tolerance) -> ChartSpec:
    """Plot the error or the change of the output: worst case, three standard deviations, sample extremes, limit."""
    x, k, base, unit = result.nominal.places, result.scale, result.nominal.base, result.display_unit
    mode: Literal["lines", "lines+markers"] = "lines" if len(x) > 2 else "lines+markers"
    error, limit = bool(np.any(base)), math.nan if result.limit is None else k * result.limit
    wide = x if len(x) > 1 else x + np.array([-0.5, 0.5])  # a single angle has a visible band too
    low, high = (np.broadcast_to(k * (base + column), wide.shape) for column in result.worst)
    traces: list[Band | Curve] = [Band(wide, low, high, "worst case", SHADE, 1.0)]
    traces += [Curve(x, k * base, "nominal", RESULT, 2.0, mode=mode)] if error else []
    for sign in (1.0, -1.0):
        three = k * (base + result.shift + 3.0 * sign * result.sigma)
        traces.append(Curve(x, three, "three standard deviations", RESULT, 1.2, "dash", mode, legend=sign > 0.0))
    if result.monte_carlo is not None:
        ends = f"ends of {result.monte_carlo.samples:,} samples"
        for column, legend in ((result.monte_carlo.most, True), (result.monte_carlo.least, False)):
            traces.append(Curve(x, k * (base + column), ends, TARGET, 1.1, "dot", mode, legend=legend))
    heights = [y for trace in traces for y in ((trace.low, trace.high) if isinstance(trace, Band) else (trace.y,))]
    reach = 1.05 * max(np.nanmax(np.abs(y)) for y in heights)
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
    return ChartSpec("band", title, [panel], drive_axis(result.problem.model.driving), heading, width=8.0)


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
    panel, x = (
        Panel(Axis("share of the samples [%]"), bars, 1.4),
        f"largest {what} at any of the {result.problem.model.driving.noun}s",
    )
    text, unit = (f"{result.problem.model.title}: {title}", remark), result.display_unit
    lines = [Line(limit, f"limit {limit:.5g} {unit}", LIMIT, 1.6, "solid")] if limited else []
    return ChartSpec("histogram", title, [panel], Axis(f"{x}{result.bracketed}"), *text, lines, cursor=False, width=8.0)


def overview(result: Tolerance) -> Summary:
    """Summarise a tolerance analysis."""
    positions = f"{len(result.nominal.places)} {result.problem.model.driving.noun}s"
    status = f"effect of the tolerances on {result.nominal.name}, at {positions}"
    return summary(
        result.problem.model.title,
        [status],
        _redesigned(result, result.robust) if result.robust is not None else None,
        _shares(result),
        _scatter(result),
        _sampled(result, result.monte_carlo) if result.monte_carlo is not None else None,
        _allocated(result, result.allocation) if result.allocation is not None else None,
    )


def _place(result: Tolerance, k: int) -> str:
    """Format a position of the drive with its unit."""
    return f"{result.nominal.places[k]:.4g} {result.problem.model.driving.unit}"


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


def _shares(result: Tolerance) -> TableSpec:
    at, parts = result.where, zip(result.deviations, result.effects, 100.0 * result.contributions, strict=True)
    units, rows = {_unit(result.problem, deviation)[1] for deviation in result.deviations}, []
    for deviation, by, shares in sorted(parts, key=lambda part: -part[2][at]):
        unit = _unit(result.problem, deviation)
        per = f"{result.scale * by[at] / unit[0]:+z.5f}"
        made = f"{CONTACT}, adds to {deviation.size}" if deviation.shape == CONTACT else deviation.shape
        made = f"measured, {len(deviation.values):,} parts" if deviation.values else made
        cells = quiet(made), per, strong(f"{shares[at]:z.1f} %"), f"{np.mean(shares):z.1f} %"
        rows.append((deviation.name, _symmetric(deviation.tolerance, unit), *cells))
    change = f">change [{result.display_unit or '-'}\nper {' or '.join(sorted(units, reverse=True))}]"
    columns = ["", ">tolerance", "distribution", change, ">share of the\nvariance", ">over all\npositions"]
    return table(f"Variance contributions at the worst {result.problem.model.driving.noun}: {_place(result, at)}", columns, rows)


def _scatter(result: Tolerance) -> TableSpec:
    (low, high), rows = result.worst, []
    for name, column, sign in (
        ("worst case", np.maximum(-low, high), "±"),
        ("root of the sum of squares", result.rss, "±"),
        ("standard deviation", result.sigma, ""),
    ):
        at = int(np.argmax(column))
        rows.append((name, sign + number(result.scale * column[at], 5), quiet(f"at {_place(result, at)}")))
    return table(f"Change of the output to first order{result.bracketed}", "<><", rows)


def _sampled(result: Tolerance, sampled: MonteCarlo) -> TableSpec:
    scale, unit, at = result.scale, result.display_unit, result.where
    sigma = f"{number(scale * sampled.sigma[at], 5)} ± {number(scale * 2.0 * sampled.sigma_error[at], 2)}"
    rows: list[Row] = [("standard deviation", sigma, quiet(f"{unit}, at {_place(result, at)}".removeprefix(", ")))]
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


def conclusion(result: Tolerance) -> str:
    """Return the conclusion of a tolerance analysis: yield or worst case, and the tolerance with the largest share."""
    k, unit, sampled, shares = (
        result.scale,
        result.display_unit,
        result.monte_carlo,
        100.0 * result.contributions[:, result.where],
    )
    part = int(np.argmax(shares))
    most = f"{result.deviations[part].name} contributes {shares[part]:.3g} % of the variance"
    if sampled is not None and result.limit is not None:
        low, high = sampled.interval
        text = f"{100.0 * sampled.share:.4g} % of the linkages stay within the limit of ±{figure(k * result.limit, unit)} "
        text += f"(95 % confidence: {100.0 * low:.4g} ... {100.0 * high:.4g} %)"
    else:
        worst = float(np.max(np.abs(result.worst)))
        text = f"The tolerances change {result.nominal.name} by at most ±{figure(k * worst, unit)} in the worst case"
    if result.allocation is not None and not result.allocation.achieved:
        text = f"The allocated tolerances do not keep the yield of {100.0 * result.allocation.target_yield:.4g} %. {text}"
    return f"{text}; {most}."


VIEW = View(overview, charts=charts, tables=lambda result: {"tolerance": result.columns}, page=page)
