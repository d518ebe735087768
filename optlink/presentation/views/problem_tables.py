"""Tables of a problem file."""

import math
from collections.abc import Collection, Iterator, Mapping

import numpy as np

from optlink.presentation.format import joined
from optlink.presentation.table_spec import Part, Summary, TableSpec, quiet, summary, table
from optlink.problem.base_model import Section
from optlink.problem.design import DesignProblem
from optlink.problem.file import ProblemFile
from optlink.problem.limits import RegionSection
from optlink.problem.quantity import Interval, Quantity
from optlink.problem.targets.target_points import TargetPoints

MAX_POINTS = 8  # largest number of points listed


def problem(file: ProblemFile) -> Summary:
    """List all settings of a problem: every key with its value or default, in units."""
    model = file.model
    about = [" ".join(model.about.split())] if model.about else []
    parts: list[Part] = []
    if model.mechanism.by_lengths:
        parts.append(_section("mechanism", model.mechanism, {"assembly": file.mode()}))
    if model.parts or model.goals:
        parts += _demands(file.spec)
    if not model.parts or model.bodies or model.loads:
        from optlink.presentation.views.analysis_tables import machine

        parts += machine(file)
    if model.tolerances:
        rows = []
        for deviation, text in zip(model.deviations, model.tolerances.values(), strict=True):
            default = "" if text.shape or text.measured else f"default: {deviation.shape}"
            rows.append((deviation.name, str(text), quiet(default)))
        parts.append(table("[tolerances]", "<<<", rows))
    if model.report.model_fields_set:
        parts.append(_section("report", model.report, only_stated=True))
    if model.expected is not None:
        parts.append(_section("expected", model.expected, only_stated=True))
    return summary(model.title, [*about, quiet(f"Source: {model.source or 'none is given'}")], *parts)


def _demands(model: DesignProblem) -> Iterator[TableSpec]:
    """List requirements, limits, and what is demanded of quantities of the machine."""
    for part in model.parts:
        title = f"requirements: {part.prefix[:-1]}" if part.prefix else "requirement"
        effective, stated = part.requirement.effective(part), part.requirement.model_fields_set
        effective = {key: text for key, text in effective.items() if key not in stated}
        yield _section(title, part.requirement, effective, leave_out=_inapplicable(part, "requirement"))
    if model.parts:
        over = {"transmission_over": model.limits.transmission_range}
        yield _section("limits", model.limits, over, leave_out=_inapplicable(model, "limits"))
    if model.goals or model.bounds:
        yield _terms(model)
    if model.grids:
        yield table("[rounding]", "<<", [(name, grid.words(model.quantities[name])) for name, grid in model.grids.items()])


def _inapplicable(model: DesignProblem, section: str) -> set[str]:
    """Return the keys of a section that do not apply to the mechanism."""
    return {key.partition(".")[2] for key in model.inapplicable if key.startswith(f"{section}.")}


def _terms(model: DesignProblem) -> TableSpec:
    """List the quantities of the machine in objective and limits."""
    rows = []
    for goal in model.goals:
        share = "" if model.single else f"weight {goal.weight:g}" + (f" per {goal.scale}" if goal.scale is not None else "")
        rows.append((f"{goal.sense}", goal.words, share))
    rows += [(bound.name, bound.term.words, str(bound.interval)) for bound in model.bounds]
    if not model.parts:
        default = "" if "alignment" in model.limits.model_fields_set else ", default"
        rows.append(("alignment", "every joint off alignment", f"at least {model.limits.alignment}{default}"))
    stated = ["[[requirements]]" if model.requirements else "[requirement]"] * bool(model.required)
    stated += ["[objective]"] * bool(model.goals) + ["[limits]"] * bool(model.named_limits or not model.parts)
    return table(joined(stated), "<<<", rows)


def _section(
    name: str,
    section: Section,
    instead: Mapping[str, str] | None = None,
    *,
    only_stated: bool = False,
    leave_out: Collection[str] = (),
) -> TableSpec:
    rows = []
    for key, field in type(section).model_fields.items():
        explicit = key in section.model_fields_set
        if explicit or not (only_stated or key in leave_out):
            text = (instead or {}).get(key) or _plain(key, getattr(section, key))
            rows.append((field.alias or key, text, quiet("" if explicit else "default")))
    return table(f"[{name}]", "<<<", rows)


ABSENT = {
    "psi0": "the rocker angle at the start",
    "span": "that of the table",
    "points": "its rows",
    "robust": "no",
    "pivot": "fixed: 0 mm, 0 mm",
    "direction": "fixed: 0 deg",
    "law": "none",
    "output": "none",
    "zero": "none",
    "start": "none",
    "mark": "none",
    "name": "as its kind",
    "tolerance": "none: it is minimised",
    "weight": "none",
    "scale": "none",
}
"""Defaults of the keys that are not limits."""


def _plain(name: str, value: object) -> str:
    if value is None:
        return ABSENT.get(name, "no limit")
    if isinstance(value, Quantity | Interval | str | int | float):
        return str(value)
    if isinstance(value, dict):
        written = ((key, " and ".join(map(str, item)) if isinstance(item, tuple) else item) for key, item in value.items())
        return "\n".join(f"{key}  {item}" for key, item in written) or "none"
    if isinstance(value, tuple):
        return ", ".join(map(str, value))
    if isinstance(value, RegionSection):
        return ", ".join(f"{axis} {side}" if side else f"any {axis}" for axis, side in (("x", value.x), ("y", value.y)))
    if isinstance(value, TargetPoints):
        return _listed(value)
    text = getattr(value, "text", None)
    if text is not None:
        return str(text)
    phi, psi = getattr(value, "phi", ()), getattr(value, "psi", ())
    size, unit = (1e3, "mm") if getattr(value, "kind", "angle") == "coordinate" else (math.degrees(1.0), "deg")
    rows = (f"{np.degrees(a):g} deg -> {size * b:g} {unit}" for a, b in zip(phi, psi, strict=True))
    return "table: " + ", ".join(list(rows)[:MAX_POINTS]) + (f", ... ({len(phi)} rows)" if len(phi) > MAX_POINTS else "")


def _listed(targets: TargetPoints) -> str:
    """List the first points or poses."""
    angles = targets.angles or (math.nan,) * len(targets.points)
    written = (
        f"({1e3 * x:.6g}, {1e3 * y:.6g})" + ("" if math.isnan(angle) else f" at {math.degrees(angle):.6g} deg")
        for (x, y), angle in zip(targets.points, angles, strict=True)
    )
    count, what = len(targets.points), "poses" if targets.angles else "points"
    return f"{count} {what} [mm]: {', '.join(list(written)[:MAX_POINTS])}{', ...' if count > MAX_POINTS else ''}"
