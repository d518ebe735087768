"""The state of the page: a design with its picture, handles, figures, checks and charts, as plain data."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from optlink.dynamics.columns import MotionColumns
from optlink.io import finite
from optlink.linkage.dyad_types import transmitting
from optlink.linkage.vector2d import Array
from optlink.problem.file import ProblemFile
from optlink.problem.limits import Limits
from optlink.problem.quantity_keys import quantity_key
from optlink.report.chart_spec import max_abs
from optlink.report.format import price_step
from optlink.report.style import scale
from optlink.studio.design import Design
from optlink.studio.kinds import kind_of
from optlink.studio.picture import Picture
from optlink.validation.design import deviations
from optlink.validation.linkage_motion import transmission_angles

AT_BOUND = 1e-6  # share of the range of a variable
DIGITS = 6


def targets(problem: ProblemFile, design: Design) -> dict[str, Any]:
    """Return the target points, poses or curve [mm, deg], with the deviations of a design."""
    if not problem.model.parts or not (model := problem.spec).pointed:
        return {"points": [], "poses": [], "curve": []}
    targets = model.target_points
    places = 1e3 * np.asarray(targets.points)
    deviation = np.full(len(places), np.nan)
    if design.crank_angles is not None and len(design.crank_angles) == len(places):
        deviation = 1e3 * deviations(model, design.values, design.crank_angles).distances
    points = [{"at": place, "deviation": d} for place, d in zip(_rounded(places), finite(_rounded(deviation)), strict=True)]
    poses = []
    if targets.angles is not None:
        poses = [{"at": p["at"], "angle": math.degrees(a)} for p, a in zip(points, targets.angles, strict=True)]
    curve = [*_rounded(places), *_rounded(places[:1])] if model.closed else _rounded(places)
    return {"points": points, "poses": poses, "curve": curve}


def variables(problem: ProblemFile, design: Design, lockable: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the design variables, and the sizes that are fixed or were locked on the page, in display units."""
    rows = []
    for name, quantity in problem.model.quantities.items():
        if quantity.fixed and name not in lockable:
            continue
        size, unit = quantity.si_per_unit, quantity.display[1]
        low, high = (bound / size for bound in quantity.bounds)
        value = design.values.get(name, quantity.value) / size
        near = AT_BOUND * (high - low)
        rows.append(
            {
                "name": name,
                "value": value,
                "unit": unit,
                "lower": low if quantity.low is not None else None,
                "upper": high if quantity.low is not None else None,
                "locked": not quantity.free,
                "at_bound": quantity.low is not None and (value <= low + near or value >= high - near),
                "key": quantity_key(problem.model, name),
            }
            | ({} if quantity.equals is None else {"equals": quantity.equals})
        )
    return finite(rows)  # type: ignore[no-any-return]


def objective(problem: ProblemFile, value: float) -> dict[str, Any] | None:
    """Return an objective [SI] with its label, in a display unit; None if the problem has none."""
    shown = kind_of(problem).objective(problem.model, value)
    return {"label": shown.name, "value": finite(shown.value), "unit": shown.unit} if shown.name else None


def active(design: Design) -> list[dict[str, Any]]:
    """Return the active limits of a design with their shadow prices, in display units."""
    base, factor, unit, _ = kind_of(design.problem).objective(design.problem.model, design.objective)
    rows = []
    for limit in design.limits:
        if limit.active:
            row = {"limit": f"{limit.name} {limit.sense}", "value": limit.bound, "unit": limit.unit}
            size, step = price_step(limit.unit, limit.bound, abs(limit.multiplier * factor / base) if base else 0.0)
            price = {"price": limit.multiplier * factor * size, "price_unit": f"{unit or '1'} per {step}"}
            joint = {"joint_price": limit.joint_gain * factor * size} if limit.depends_on else {}
            rows.append(row | price | joint)
    return finite(rows)  # type: ignore[no-any-return]


def checks(design: Design) -> list[dict[str, Any]] | None:
    """Return the checks of the validator; None if it has not seen the design."""
    if design.checks is None:
        return None
    rows = [{"name": c.name, "ok": c.passed, "measured": c.value, "limit": c.limit, "unit": c.unit} for c in design.checks]
    return finite(rows)  # type: ignore[no-any-return]


# --- charts -----------------------------------------------------------------------------------------------------------------


def charts(design: Design, picture: Picture, problem: ProblemFile) -> list[dict[str, Any]]:
    """Return the curves of a design over the crank angle, with the limits of the present problem."""
    kind, model = kind_of(design.problem), design.problem.model
    curves = kind.error_curves(model, design.values, design.start, design.crank_angles)
    specs = [_chart(*curve[:2], [curve[2:]]) for curve in curves]
    specs += _transmission(picture, problem)
    if model.loads or model.bodies:
        specs += _forces(design, picture)
    elif design.problem.task == "cycle" or not model.free:
        specs += _motion(picture)
    return specs


def _chart(
    title: str, x: Array, series: Sequence[tuple[str, str, Array]], limits: Sequence[tuple[str, float]] = ()
) -> dict[str, Any]:
    curves = [{"label": label, "unit": unit, "values": finite(_rounded(values))} for label, unit, values in series]
    axis = {"label": "crank angle", "unit": "deg", "values": np.round(np.degrees(x), 3).tolist()}
    return {"title": title, "x": axis, "series": curves, "limits": [{"label": n, "value": v} for n, v in limits]}


def _transmission(picture: Picture, problem: ProblemFile) -> Iterator[dict[str, Any]]:
    groups = transmitting(picture.mechanism)
    if not groups:
        return
    with np.errstate(all="ignore"):
        angles = np.degrees(transmission_angles(picture.motion, picture.mechanism))
    limits = []
    allowed = getattr(problem.model, "limits", None)
    if isinstance(allowed, Limits):
        limit = allowed.transmission_at(groups[0].joint)
        for word, bound in () if limit is None else (("least", limit.low), ("largest", limit.high)):
            if bound is not None:
                limits.append((word, math.degrees(bound)))
    series = [(f"at {group.joint}", "deg", angles[:, k]) for k, group in enumerate(groups)]
    yield _chart("Transmission angle", picture.angles, series, limits)


def _motion(picture: Picture) -> Iterator[dict[str, Any]]:
    mechanism, motion = picture.mechanism, picture.motion
    for guide in mechanism.guides:
        if guide.on == "frame":
            slide = np.asarray(motion.slide(guide.name).value)
            yield _chart(f"Slide of {guide.slider}", picture.angles, [(guide.slider, "mm", 1e3 * slide)])
            return
    body = mechanism.links[-1].body
    yield _chart(f"Angle of {body}", picture.angles, [(body, "deg", np.degrees(np.asarray(motion.body_angle(body).value)))])


def _forces(design: Design, picture: Picture) -> Iterator[dict[str, Any]]:
    """Yield the driving torque and the joint reactions."""
    yield from _motion(picture)
    moving = picture.machine.moving(picture.angles, design.speed)
    with np.errstate(all="ignore"):
        record = MotionColumns(moving)
        torque = np.asarray(record["input.torque_Nm"], dtype=float)
        pins = {
            name.partition(".")[0]: np.hypot(record[name], record[name.replace(".fx_N", ".fy_N")])
            for name in record.columns
            if name.endswith(".fx_N") and name.replace(".fx_N", ".fy_N") in record.columns
        }
    torque_scale = scale(float(np.nanmax(np.abs(torque), initial=0.0)), "N m")
    yield _chart("Driving torque", picture.angles, [("torque", torque_scale.unit, torque * torque_scale.factor)])
    if pins:
        most = scale(max(float(np.nanmax(force, initial=0.0)) for force in pins.values()), "N")
        yield _chart("Joint reactions", picture.angles, [(pin, most.unit, force * most.factor) for pin, force in pins.items()])


def _rounded(values: Array) -> Any:
    """Return numbers as lists, with as many digits as a drawing can show."""
    largest = max_abs(values)
    return np.round(values, max(0, DIGITS - 1 - math.floor(math.log10(largest))) if largest > 0.0 else 0).tolist()
