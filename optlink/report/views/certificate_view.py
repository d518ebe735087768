"""Table, clauses and charts for the certificate of a global optimum, the same for every kind of result."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from decimal import ROUND_FLOOR, Context
from typing import Any

import numpy as np

from optlink.problem.machine.model import ShownObjective
from optlink.report.chart_spec import Axis, Boxes, ChartSpec, Curve, Mark, Panel
from optlink.report.format import pretty
from optlink.report.table_spec import Line, Row, TableSpec, quiet, strong, table
from optlink.tasks.results.certificate import MOST_DRAWN, Certificate, Cover, share_text

ROUNDING_NOTE = "no design within the bounds has a smaller one; rounding errors are included"
Shown = Callable[[float], ShownObjective]
"""Returns an objective [SI] in its display unit."""
CONTINUE = "to continue the proof: --certify with a longer --time-limit or a larger --gap"


def certificate_table(certificate: Certificate, shown: Shown, seconds: Mapping[str, float]) -> TableSpec:
    """Tabulate a certificate: best design and lower bound, gap, effort, finding, and how to continue a proof that is not closed.

    `shown` returns an objective [SI] in its display unit; `seconds` is the wall time per stage.
    """
    rows: list[Row] = []
    objective, bound = certificate.objective, certificate.lower_bound
    digits = min(14, max(6, 2 - math.floor(math.log10(certificate.gap)))) if 0.0 < certificate.gap < 1.0 else 6
    value, unit, name = shown(objective).value, *shown(objective if math.isfinite(objective) else bound)[2:]
    if math.isfinite(objective):
        rows.append(("best design", strong(f"{value:.{digits}g}"), unit, quiet(name * (name != "objective"))))
    if math.isfinite(bound):
        rows.append(("lower bound", strong(rounded_down(shown(bound).value, digits)), unit, quiet(ROUNDING_NOTE)))
    if math.isfinite(objective) and not certificate.exact:
        required = "" if certificate.proven else f", {share_text(certificate.asked)} was required"
        rows.append(("gap", share_text(certificate.gap), "", quiet(f"largest share by which a design could be better{required}")))
    left = f", {certificate.open_boxes:,} of them left" if certificate.open_boxes else ""
    if certificate.boxes:
        rows.append(("boxes", f"{certificate.boxes:,}", "", quiet(f"parts of the bounds that were examined{left}")))
    if "certify" in seconds:
        rows.append(("time", f"{seconds['certify']:.3g}", "s", ""))
    notes = [certificate.text]
    if certificate.improved:
        notes.append("the design is better than that of the local search: the proof found it")
    if not certificate.closed:
        notes.append(CONTINUE)
    return table("Global optimum", "<><<", rows, notes=[quiet(note) for note in notes], exact=True)


def rounded_down(value: float, digits: int) -> str:
    """Format a lower bound with significant digits that do not exceed it."""
    return f"{float(Context(digits, ROUND_FLOOR).create_decimal_from_float(value)):.{digits}g}"


def certified(certificate: Certificate | None) -> bool:
    """Return whether a certificate takes the place of statistical evidence: its search came to an end."""
    return certificate is not None and certificate.closed


def certificate_lines(certificate: Certificate | None) -> list[Line]:
    """Return the line of a status; none without a certificate."""
    return [] if certificate is None else [quiet(certificate.text)]


def clause(certificate: Certificate | None) -> str:
    """Return the sentence of a conclusion; an empty text if nothing is proven."""
    if certificate is None or not certificate.closed:
        return ""
    if not certificate.proven:
        return "It is proven that no design within the bounds meets all limits."
    if certificate.exact:
        return "No design can be better."
    return f"It is proven that no design within the bounds is better by more than {share_text(certificate.gap)}."


# --- charts ------------------------------------------------------------------------------------------------------------------

Design = Mapping[str, float]
Display = Callable[[str], tuple[float, str]]
"""Returns factor and display unit of a design variable."""
MIN_BOXES = 256  # boxes up to which the bounds are not drawn: about one batch of the search
SCHEME = {
    "limits": ("limit violated", "#c0392b"),
    "objective": ("objective too large", "#2c6fbb"),
    "Lagrangian": ("Lagrangian too large", "#2e8b57"),
    "cut": ("cut off", "#d07d00"),
}
"""Name and colour of the boxes that each test discards."""


def certificate_charts(
    certificate: Certificate | None, title: str, shown: Shown, design: Design, assembly: Any, display: Display
) -> list[ChartSpec]:
    """Return the boxes of two design variables, and the bounds of the objective against the number of boxes.

    `design` [SI] and `assembly`, its mode in the words of the file, are those of the best design, empty if there is none; `shown`
    returns an objective [SI] in its display unit, `display` factor and unit of a design variable.
    """
    if certificate is None:
        return []
    charts = []
    if len(certificate.unknowns) == 2 and 0 < sum(len(cover.test) for cover in certificate.covers) <= MOST_DRAWN:
        for k, cover in enumerate(certificate.covers):
            at = design if certificate.proven and str(cover.assembly) == str(assembly) else {}
            mode = f", assembly {cover.assembly}" if len(certificate.covers) > 1 else ""
            charts.append(replace(_boxes(cover, certificate.unknowns, title, mode, at, display), remark=certificate.text, row=k))
    if certificate.boxes > MIN_BOXES and np.isfinite(certificate.history[-1:, 2]).any():
        charts.append(_bounds(certificate, title, shown))
    return charts


def _boxes(cover: Cover, unknowns: Sequence[str], about: str, mode: str, design: Design, display: Display) -> ChartSpec:
    """Return the boxes of one assembly mode, coloured by the tests that discarded them."""
    scales = [display(name) for name in unknowns]
    factors = np.array([factor for factor, _ in scales])
    low, high = cover.low * factors, cover.high * factors
    x, y = (np.stack([low[:, k], high[:, k]], axis=1) for k in range(2))
    traces = []
    for k, (key, (name, colour)) in enumerate(SCHEME.items()):
        chosen = cover.test == k
        if chosen.any():
            traces.append(Boxes(x[chosen], y[chosen], f"{name} ({int(chosen.sum())})", colour, gid=f"boxes {key}"))
    marks = []
    if design:
        at_x, at_y = (design[name] * factor for name, factor in zip(unknowns, factors, strict=True))
        marks.append(Mark(at_x, at_y, "design", "#111111", "star", 11.0, prefer=(1.0, 1.0), gid="design"))
    axes = [
        Axis(f"{name} [{unit}]", (float(ends.min()), float(ends.max())))
        for name, (_, unit), ends in zip(unknowns, scales, (x, y), strict=True)
    ]
    panel = Panel(axes[1], traces, 2.1, marks=marks)
    title = f"Global search: boxes of designs and the test that discarded each{mode}"
    return ChartSpec("boxes", title, [panel], axes[0], f"{about}: boxes of the global search", cursor=False)


def _bounds(certificate: Certificate, title: str, shown: Shown) -> ChartSpec:
    """Return the lower bound and the best known objective as steps over the number of boxes."""
    boxes, lower, best = certificate.history.T
    steps = np.repeat(boxes, 2)[1:]
    curves = [
        Curve(steps, np.repeat([shown(value).value for value in values.tolist()], 2)[:-1], name, colour, 1.8, gid=name)
        for values, name, colour in ((best, "best known design", "#2e8b57"), (lower, "lower bound", "#2c6fbb"))
    ]
    unit = pretty(shown(certificate.objective).unit)
    axis = Axis(f"objective [{unit}]" if unit else "objective")
    x = Axis("boxes examined", (boxes[0], boxes[-1]), "log")
    name, heading = "Global search: bounds of the objective", f"{title}: bounds of the objective"
    return ChartSpec("bounds", name, [Panel(axis, curves, 1.4)], x, heading, certificate.text, cursor=False)
