"""HTML sections of a tolerance analysis: variance contributions, scatter, yield, tolerance allocation."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

from optlink.problem.file import ProblemFile
from optlink.report.format import number, percent
from optlink.report.html.chart_plotly import Chart, Panel, Trace, axis, line, sheet, short, stacked
from optlink.report.html.shell import Section
from optlink.report.stored.reader import Record
from optlink.report.stored.stored_study import Studied, figures_of, turning
from optlink.report.style import BODIES, CRANK, FOUND, LIMIT, SHADE, WANTED
from optlink.report.table_spec import Row, TableSpec, bad, good, quiet, strong, table
from optlink.report.views.tolerance_tables import judged, made, proven
from optlink.studies.tolerance.analysis import SCHEMA
from optlink.tasks.function import display_value

__all__ = ["SCHEMA", "studied"]

Array = NDArray[np.float64]
COLOURS = (CRANK, *BODIES)
NEAR = 2.5  # the limit is drawn up to this multiple of the worst-case band
BARS = 60  # largest number of bars in a histogram
LINEAR = ("shift", "worst_low", "worst_high", "rss", "sigma")
SCATTERED = ("mean", "sigma", "sigma_standard_error", "least", "most")


@dataclass(frozen=True, eq=False)
class Part:
    """A deviation and its effects: change of the output per deviation and share of the variance [%], over the crank angles."""

    name: str
    size: str
    tolerance: float
    shape: str
    sigma: float
    by: Array
    share: Array

    def text(self, value: float, factor: float, unit: str) -> str:
        """Format a symmetric tolerance.

        Parameters
        ----------
        value : float [SI]
        factor : float
            Factor from SI to the display unit.
        unit : str
            Display unit.
        """
        return f"±{number(factor * value)} {unit}"


@dataclass(frozen=True, eq=False)
class Sampled:
    """Monte MonteCarlo results: `arrays` over the crank angles [SI], yield statistics, and the histogram if it was stored."""

    samples: int
    seed: int
    stuck: int
    arrays: dict[str, Array]
    below: dict[str, float]
    share: float
    interval: tuple[float, float]
    linear: float
    edges: Array
    counts: Array


@dataclass(frozen=True, eq=False)
class Toleranced:
    """A stored tolerance analysis; `scale` is the factor from SI to the display unit `unit`."""

    output: str
    scale: float
    unit: str
    degrees: Array
    value: Array
    base: Array
    limit: float
    parts: tuple[Part, ...]
    linear: dict[str, Array]
    sampled: Sampled | None

    @property
    def where(self) -> int:
        """Index of the crank angle with the largest standard deviation of the output."""
        return int(np.argmax(self.linear["sigma"]))


# --- reading -----------------------------------------------------------------------------------------------------------------


def read(record: Record) -> Toleranced:
    """Read a stored tolerance analysis.

    Raises
    ------
    InputError
        If the record is damaged.
    """
    unit = record.text("unit")
    if unit not in ("rad", "m"):
        raise record.fault("unit", "no output has that", unit)
    degrees = record.numbers("crank_angles_deg")
    count = len(degrees)
    if not count:
        raise record.fault("crank_angles_deg", "there are none")
    linear = record.record("linear")
    return Toleranced(
        output=record.text("output"),
        scale=math.degrees(1.0) if unit == "rad" else 1e3,
        unit="deg" if unit == "rad" else "mm",
        degrees=degrees,
        value=record.numbers("value", count),
        base=record.numbers("judged_as_drawn", count),
        limit=record.number("limit") if record.has("limit") else math.nan,
        parts=tuple(_part(one, count) for one in record.records("tolerances")),
        linear={name: linear.numbers(name, count) for name in LINEAR},
        sampled=_sampled(record.record("monte_carlo"), count) if record.has("monte_carlo") else None,
    )


def _part(record: Record, count: int) -> Part:
    return Part(
        name=record.text("name"),
        size=record.text("adds_to"),
        tolerance=record.number("tolerance_SI"),
        shape=record.text("distribution"),
        sigma=record.number("sigma_SI"),
        by=record.numbers("per_deviation", count),
        share=record.numbers("contribution_percent", count),
    )


def _sampled(record: Record, count: int) -> Sampled:
    bars = record.record("histogram") if record.has("histogram") else None
    edges, counts = (np.zeros(0), np.zeros(0)) if bars is None else (bars.numbers("edges"), bars.numbers("counts"))
    if len(counts) and len(edges) != len(counts) + 1:
        raise record.fault("histogram", "it has not one edge more than bins")
    if record.whole("samples") <= 0:
        raise record.fault("samples", "there are none", record.whole("samples"))
    asked = record.has("yield")
    interval = record.numbers("yield_interval_95_percent", 2) if asked else np.full(2, math.nan)
    return Sampled(
        samples=record.whole("samples"),
        seed=record.whole("seed"),
        stuck=record.whole("cannot_be_assembled"),
        arrays={name: record.numbers(name, count) for name in SCATTERED},
        below=record.figures("stays_below"),
        share=record.number("yield") if asked else math.nan,
        interval=(float(interval[0]), float(interval[1])),
        linear=record.maybe("yield_by_the_linear_model"),
        edges=edges,
        counts=counts,
    )


# --- the page ----------------------------------------------------------------------------------------------------------------


def studied(record: Record, file: ProblemFile) -> Studied:
    """Build the report of a stored tolerance analysis.

    Parameters
    ----------
    record : Record
    file : ProblemFile
        The problem of the study.

    Raises
    ------
    InputError
        If the record is damaged.
    """
    found = read(record)
    allocation = record.record("allocation") if record.has("allocation") else None
    robust = record.record("robust") if record.has("robust") else None
    valid = (allocation is None or allocation.flag("kept")) and (robust is None or robust.flag("valid"))
    sizes = record.figures("sizes_SI")
    tables = [_blame(file, found), _scatter(found)]
    tables += [_told(found, found.sampled)] if found.sampled is not None else []
    tables += [_allocated(file, found, allocation)] if allocation is not None else []
    tables += [_redesigned(file, found, robust)] if robust is not None else []
    charts = [_contributions(found), _band(found)]
    charts += [_histogram(found, found.sampled)] if found.sampled is not None and len(found.sampled.counts) else []
    return Studied(
        problem=file,
        kind="study of tolerances",
        verdict=_verdict(found, allocation, robust),
        valid=valid,
        status=[f"what tolerances do to {found.output}, at {len(found.degrees)} crank angles"],
        sections=[Section("Scatter", charts), *figures_of(tables)],
        moving=turning(file, {name: value for name, value in sizes.items() if name in file.model.mechanism.quantities}),
        by=_by(found),
        drawn="The linkage as drawn.",
        after=1,
    )


def _verdict(found: Toleranced, allocation: Record | None, robust: Record | None) -> str:
    if allocation is not None and not allocation.flag("kept"):
        return "The allocated tolerances do not keep the yield"
    if robust is not None and not robust.flag("valid"):
        return "The robust design is not proven"
    if found.sampled is not None and math.isfinite(found.sampled.share):
        return f"Yield {percent(found.sampled.share)}"
    return "Done"


def _by(found: Toleranced) -> str:
    by = "exact derivatives at the drawing"
    if found.sampled is not None:
        by += f", and {found.sampled.samples:,} linkages with deviations drawn (Sobol, seed {found.sampled.seed}), moved exactly"
    return by


def _unit_of(file: ProblemFile, part: Part) -> tuple[float, str]:
    """Return factor from SI and name of the display unit of a tolerance."""
    quantity = file.model.mechanism.quantities.get(part.size)
    return (math.degrees(1.0), "deg") if quantity is not None and quantity.kind == "angle" else (1e3, "mm")


def _blame(file: ProblemFile, found: Toleranced) -> TableSpec:
    at, rows = found.where, []
    for part in sorted(found.parts, key=lambda part: -part.share[at]):
        shape = part.shape if part.size == part.name else f"{part.shape}, adds to {part.size}"
        per = f"{found.scale * part.by[at] * part.tolerance:+.4g}"
        shares = strong(f"{part.share[at]:.1f} %"), f"{float(np.mean(part.share)):.1f} %"
        rows.append((part.name, part.text(part.tolerance, *_unit_of(file, part)), quiet(shape), per, *shares))
    columns = ["", ">tolerance", "distribution", f">change [{found.unit}]\nper tolerance"]
    columns += [">share of the\nvariance", ">over all\nangles"]
    return table(f"Variance contributions at the worst crank angle: {found.degrees[at]:.4g} deg", columns, rows)


def _scatter(found: Toleranced) -> TableSpec:
    both = np.maximum(-found.linear["worst_low"], found.linear["worst_high"])
    values = {"worst case": both, "root of the sum of squares": found.linear["rss"], "standard deviation": found.linear["sigma"]}
    rows = []
    for name, column in values.items():
        at = int(np.argmax(column))
        sign = "" if name == "standard deviation" else "±"
        rows.append((name, sign + number(found.scale * column[at], 5), quiet(f"at {found.degrees[at]:.4g} deg")))
    return table(f"Change of the output to first order [{found.unit}]", "<><", rows)


def _told(found: Toleranced, sampled: Sampled) -> TableSpec:
    at, arrays = found.where, sampled.arrays
    sigma, error = (found.scale * arrays[name][at] for name in ("sigma", "sigma_standard_error"))
    where = quiet(f"{found.unit}, at {found.degrees[at]:.4g} deg")
    rows: list[Row] = [("standard deviation", f"{number(sigma, 5)} ± {number(2.0 * error, 2)}", where)]
    for name, value in sampled.below.items():
        told = number(found.scale * value, 5) if math.isfinite(value) else "beyond the histogram"
        rows.append((f"{_judged(found)}: {name.removesuffix('_percent')} % below", told, found.unit))
    if sampled.stuck:
        rows.append((bad("cannot be assembled"), f"{sampled.stuck:,}", ""))
    if math.isfinite(sampled.share):
        low, high = sampled.interval
        limit = f"yield, within {number(found.scale * found.limit)} {found.unit}"
        rows.append((limit, strong(percent(sampled.share)), quiet(f"{percent(low)} ... {percent(high)} (95 % sure)")))
        rows.append(("yield by the linear model", percent(sampled.linear), ""))
    title = f"{sampled.samples:,} linkages with deviations drawn (Sobol, seed {sampled.seed}), moved exactly"
    return table(title, "<><", rows)


def _judged(found: Toleranced) -> str:
    return "largest error" if np.any(found.base) else "largest change"


def _allocated(file: ProblemFile, found: Toleranced, record: Record) -> TableSpec:
    values, costs = record.figures("tolerances_SI"), record.figures("cost_coefficients")
    idle, before = record.texts("without_effect"), record.number("cost_of_those_given")
    if not before > 0.0:
        raise record.fault("cost_of_those_given", "a cost is above zero", before)
    share, rows = record.number("cost") / before, []
    for part in found.parts:
        if part.name not in values or part.name not in costs:
            raise record.fault(f"tolerances_SI.{part.name}", "this is missing")
        unit = _unit_of(file, part)
        sizes = part.text(part.tolerance, *unit), strong(part.text(values[part.name], *unit))
        rows.append((part.name, *sizes, number(costs[part.name]), "has no effect" if part.name in idle else ""))
    check = _sampled(record.record("check"), len(found.degrees))
    low, high = check.interval
    told = f"checked by {check.samples:,} others: {percent(check.share)}, {percent(low)} ... {percent(high)} (95 % sure)"
    title = f"The loosest tolerances for a yield of {percent(record.number('wanted_yield'))}: cost {number(share)} of the given"
    columns = ["", ">given", ">allocated", ">cost coefficient", ""]
    return table(title, columns, rows, notes=[good(told) if record.flag("kept") else bad(told)])


def _redesigned(file: ProblemFile, found: Toleranced, record: Record) -> TableSpec:
    now, before = record.figures("design_SI"), record.figures("nominal_design_SI")
    rows: list[Row] = []
    for name in file.model.free:
        if name not in now or name not in before:
            raise record.fault(f"design_SI.{name}", "this is missing")
        old, unit = display_value(name, before[name])
        rows.append((name, number(old, 7), strong(number(display_value(name, now[name])[0], 7)), unit))
    values = [number(math.degrees(record.number(key)), 5) for key in ("largest_of_the_nominal_design_rad", "largest_rad")]
    rows.append((judged(record.text("counted")), *values, "deg"))
    if record.has("monte_carlo_of_the_nominal_design") and found.sampled is not None and math.isfinite(found.sampled.share):
        other = _sampled(record.record("monte_carlo_of_the_nominal_design"), len(found.degrees))
        rows.append(("yield", percent(other.share), strong(percent(found.sampled.share)), ""))
    note = good(proven(record.text("counted"))) if record.flag("valid") else bad("not proven")
    return table(made(record.text("counted")), ["", ">best as drawn", ">robust", ""], rows, notes=[note])


# --- charts ------------------------------------------------------------------------------------------------------------------


def _ordered(found: Toleranced) -> Iterator[tuple[Part, str]]:
    """Yield the deviations with their colours, by decreasing mean contribution."""
    order = sorted(found.parts, key=lambda part: -float(np.mean(part.share)))
    return ((part, COLOURS[k % len(COLOURS)]) for k, part in enumerate(order))


def _contributions(found: Toleranced) -> Chart:
    """Plot the variance contributions: stacked over the crank angle, or as bars if there is only one."""
    title = f"Variance contributions to {found.output}"
    if len(found.degrees) > 1:
        curves: list[Trace] = [
            line(found.degrees, part.share, part.name, colour, width=0.6) | {"stackgroup": "shares", "fillcolor": colour}
            for part, colour in _ordered(found)
        ]
        figure = stacked([Panel("share of the variance [%]", curves, 1.4)])
        figure["layout"]["yaxis"] |= {"range": [0, 100]}
        figure["layout"]["legend"] |= {"traceorder": "normal"}
        return Chart(title, figure)
    parts = list(_ordered(found))[::-1]
    names, shares = [escape(part.name) for part, _ in parts], short(np.array([float(part.share[0]) for part, _ in parts]))
    bars: Trace = {"type": "bar", "orientation": "h", "name": "share", "y": names, "x": shares}
    layout = sheet(110 + 26 * len(parts)) | {"showlegend": False, "hovermode": "closest"}
    layout["xaxis"] = axis(f"share of the variance at {found.degrees[0]:.4g} deg [%]")
    layout["yaxis"] = axis("") | {"type": "category"}
    return Chart(
        title, {"data": [bars | {"marker": {"color": [colour for _, colour in parts]}}], "layout": layout}, cranked=False
    )


def _band(found: Toleranced) -> Chart:
    """Plot the change of the output: worst case, three standard deviations, sample extremes, and the margin to the limit."""
    x, k, linear = found.degrees, found.scale, found.linear
    mode = "lines" if len(x) > 2 else "markers"
    low = line(x, k * linear["worst_low"], "worst case", SHADE, width=1.0)
    high = line(x, k * linear["worst_high"], "worst case", SHADE, width=1.0)
    curves: list[Trace] = [low | {"showlegend": False}, high | {"fill": "tonexty", "fillcolor": SHADE}]
    for sign in (1.0, -1.0):
        three = line(x, k * (linear["shift"] + 3.0 * sign * linear["sigma"]), "three standard deviations", FOUND, mode=mode)
        curves.append(three | {"showlegend": sign > 0.0})
    if found.sampled is not None:
        for name in ("most", "least"):
            reached = line(
                x, k * found.sampled.arrays[name], f"ends of {found.sampled.samples:,} samples", WANTED, width=1.3, dash="dot"
            )
            curves.append(reached | {"showlegend": name == "most"})
    reach = 1.1 * k * float(np.max(np.abs([linear["worst_low"], linear["worst_high"]])))
    if math.isfinite(found.limit):
        rooms = [k * (sign * found.limit - found.base) for sign in (1.0, -1.0)]
        near = 1.1 * float(np.min(np.abs(rooms)))
        far = near > NEAR * reach
        words = "what the limit leaves (far outside)" if far else "what the limit leaves"
        curves += [line(x, room, words, LIMIT, width=1.5) | {"showlegend": room is rooms[0]} for room in rooms]
        reach = reach if far else max(reach, near)
    figure = stacked([Panel(f"change of {found.output} [{found.unit}]", curves, 1.6)])
    figure["layout"]["yaxis"] |= {"range": [-reach, reach]} if reach > 0.0 else {}
    figure["layout"]["legend"] |= {"traceorder": "normal"}
    return Chart(f"Scatter of {found.output}", figure)


def _histogram(found: Toleranced, sampled: Sampled) -> Chart:
    """Plot the histogram of the largest error or change of each sample."""
    merged = max(1, -(-len(sampled.counts) // BARS))
    starts = np.arange(0, len(sampled.counts), merged)
    ends = np.minimum(starts + merged, len(sampled.counts))
    left, right = found.scale * sampled.edges[starts], found.scale * sampled.edges[ends]
    heights = 100.0 * np.add.reduceat(sampled.counts, starts) / sampled.samples
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
    layout["xaxis"] = axis(f"{_judged(found)} at any of the crank angles [{found.unit}]")
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
