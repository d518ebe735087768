"""Charts of the joints with clearance: journal orbits, contact forces, impacts, Poincaré section."""

import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from optlink.clearance.integration import Impact
from optlink.clearance.joint import Gap
from optlink.report.chart_spec import (
    BODIES,
    GROUND,
    LIMIT,
    MUTED,
    RESULT,
    TARGET,
    Array,
    Axis,
    ChartSpec,
    Curve,
    Panel,
    charts_per_row,
    crank_angle,
    max_abs,
)
from optlink.report.format import Scale, round_below, scale
from optlink.report.views.revolutions import (
    CIRCLE,
    FULL,
    WINDOW,
    RevolutionCurves,
    clipped_limits,
    from_zero,
    joint_name,
    padded_limits,
    revolution_axis,
    rough,
)
from optlink.units import percent

MAX_PENETRATION = 0.22  # largest magnified penetration, as a share of the clearance
MAX_MAGNIFICATION = 50.0  # largest magnification
MAX_PERIOD = 8  # largest period considered [revolutions]
REPETITION_TOLERANCE = 0.01  # tolerance of a repetition, as a share of the clearance
MIN_REVOLUTIONS = 6  # smallest number of revolutions for a decision
ring = partial(Curve, mode="markers", symbol="open circle")


def charts(turns: RevolutionCurves) -> list[ChartSpec]:
    """Return the charts of all joints with clearance."""
    return [*journal_orbit(turns), *force(turns), *impacts(turns), *poincare_map(turns)]


# --- orbits --------------------------------------------------------------------------------------------------------------


def magnification(gap: Gap, deepest: float) -> float:
    """Return the factor by which penetrations [m] are magnified: a round number, 1 if they are visible to scale."""
    return max(1.0, min(round_below(MAX_PENETRATION * gap.clearance / deepest), MAX_MAGNIFICATION)) if deepest > 0.0 else 1.0


def _path(
    turns: RevolutionCurves, k: int, rows: slice, factor: float
) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.intp]]:
    """Return the journal centre relative to the bearing centre [m], with penetrations magnified by `factor`.

    Where a contact begins or ends between two rows, the path has a point on the clearance circle. Also returned: which segments
    are in contact, and the indices of the points where a contact begins.
    """
    result, gap = turns.result, turns.result.gaps[k]
    time = turns.time[rows]
    x, y = (result[f"{gap.point}.e{axis}_m"][rows] for axis in "xy")
    touching = result[f"{gap.point}.contact"][rows]
    events = [(at, 1.0 - end) for impact in _impacts_of(turns, k) for end, at in enumerate((impact.begin, impact.end))]
    events = [(at, mode) for at, mode in events if time[0] < at < time[-1]]
    separated = [at for at, mode in events if not mode] + list(time[touching < 0.5][-1:])
    # a contact at the end of the run has no impact record yet
    if touching[-1] > 0.5 and separated and not any(at > max(separated) for at, _ in events):
        i = int(np.searchsorted(time, max(separated), side="right"))
        left = gap.clearance - np.hypot(x, y)[i - 1 : i + 1]
        share = left[0] / (left[0] - left[1]) if touching[i - 1] < 0.5 else 0.0
        events.append((max(separated) + share * (time[i] - max(separated)), 1.0))
    at, modes = np.array(events).reshape(-1, 2).T
    ex, ey = np.interp(at, time, x), np.interp(at, time, y)
    length = np.maximum(np.hypot(ex, ey), 1e-300)
    every = np.concatenate([time, at])
    order = np.argsort(every, kind="stable")
    x, y = (np.concatenate([a, b / length * gap.clearance])[order] for a, b in ((x, ex), (y, ey)))
    closed = np.concatenate([touching, modes])[order] > 0.5
    is_event = np.concatenate([np.zeros(len(time)), np.ones(len(at))])[order] > 0.5
    eccentricity = np.hypot(x, y)
    more = np.where(
        eccentricity > gap.clearance,
        (gap.clearance + factor * (eccentricity - gap.clearance)) / np.maximum(eccentricity, 1e-300),
        1.0,
    )
    # the state after a point holds until the next; a contact of unknown start counts from its first row
    return x * more, y * more, closed[:-1] & (closed[1:] | is_event[1:]), np.flatnonzero(is_event & closed)


def _impacts_of(turns: RevolutionCurves, k: int, since: float = -math.inf) -> list[Impact]:
    return [impact for impact in turns.result.impacts if impact.gap == k and impact.begin >= since]


def _circle(gap: Gap, unit: Scale) -> list[Curve]:
    """Return the clearance circle and its centre."""
    size = gap.clearance * unit.factor
    centre = Curve(np.zeros(1), np.zeros(1), "", MUTED, mode="markers", symbol="plus", size=8.0, legend=False, hover=False)
    return [centre, Curve(size * np.cos(CIRCLE), size * np.sin(CIRCLE), "clearance", GROUND, 1.2, hover=False, gid="clearance")]


def _eccentricity_chart(
    turns: RevolutionCurves, k: int, file: str, title: str, curves: list[Curve], unit: Scale, **more: object
) -> ChartSpec:
    """Return a chart of an eccentricity with equal scales around the clearance circle."""
    gap, count = turns.result.gaps[k], len(turns.result.gaps)
    furthest = max(np.nanmax(np.hypot(curve.x, curve.y), initial=0.0) for curve in curves)
    reach = 1.08 * max(gap.clearance * unit.factor, furthest)
    x, y = (Axis(f"e in {axis} [{unit.unit}]", (-reach, reach)) for axis in "xy")
    panel = Panel(y, [*_circle(gap, unit), *curves])
    row, width = k // charts_per_row(count), 4.2 if count > 1 else 6.2
    style = {"row": row, "width": width, "equal": True, "cursor": False, **more}
    return ChartSpec(file, title, [panel], x, **style)  # type: ignore[arg-type]


def journal_orbit(turns: RevolutionCurves) -> list[ChartSpec]:
    """Plot the orbit of every journal centre over the last revolutions with contacts and impacts; penetrations are magnified."""
    specs, rows = [], turns.rows(WINDOW)
    for k, gap in enumerate(turns.result.gaps):
        contact = turns.result[f"{gap.point}.contact"][rows] > 0.5
        deepest = turns.peak(f"{gap.point}.penetration_m", WINDOW)
        factor, unit = magnification(gap, deepest), scale(gap.clearance, "m")
        x, y, in_contact, begins = _path(turns, k, rows, factor)
        x, y = x * unit.factor, y * unit.factor
        curves = []
        for mask, colour, width, word in ((~in_contact, RESULT, 1.0, "apart"), (in_contact, LIMIT, 1.2, "in contact")):
            xs, ys = _masked(x, y, mask)
            curves.append(Curve(xs, ys, word, colour, width, legend=bool(len(xs)), gid=word))
        if begins.size:
            curves.append(ring(x[begins], y[begins], "impact", TARGET, size=4.0 if len(begins) < 60 else 2.5, gid="impact"))
        caption = f"clearance {rough(gap.clearance, 'm')}, in contact {percent(float(np.mean(contact)), 0)}"
        if deepest > 0.0:
            caption += f", deepest {rough(deepest, 'm')}" + (f", beyond the circle {factor:g}-fold" if factor > 1.0 else "")
        heading = turns.title("journals in their bearings", turns.span(WINDOW))
        title = f"Journal orbit at {joint_name(gap)}, {turns.span(WINDOW)}"
        specs.append(_eccentricity_chart(turns, k, "orbit", title, curves, unit, heading=heading, remark=caption))
    return specs


def _masked(x: Array, y: Array, segments: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the selected segments of a path, separated by NaN."""
    ends = np.concatenate([segments, [False]]) | np.concatenate([[False], segments])
    selected = np.flatnonzero(ends)
    breaks = np.flatnonzero(~np.concatenate([segments, [False]])[selected[:-1]]) + 1
    return np.insert(x[selected], breaks, np.nan), np.insert(y[selected], breaks, np.nan)


# --- forces --------------------------------------------------------------------------------------------------------------


def force(turns: RevolutionCurves) -> list[ChartSpec]:
    """Plot the normal force, friction and penetration of every joint over the crank angle; contact phases are shaded."""
    result, specs = turns.result, []
    rows, last = turns.rows(turns.shown), turns.rows(1)
    columns = charts_per_row(len(result.gaps))
    for k, gap in enumerate(result.gaps):
        normal, rub, depth = (result[f"{gap.point}.{name}"] for name in ("normal_N", "rub_N", "penetration_m"))
        strongest = turns.peak(f"{gap.point}.normal_N", turns.shown)
        unit, small = scale(strongest, "N"), scale(np.max(depth[rows]), "m")
        forces = turns.overlay(normal, unit, "normal force")
        if gap.friction or gap.damping:
            x, y = turns.fold(rub * unit.factor, last)
            forces.append(Curve(x, y, "friction on the journal, counter-clockwise", BODIES[2], 1.1, gid="friction"))
        depths = turns.overlay(np.maximum(depth, 0.0), small, "penetration")
        joint_impacts = _impacts_of(turns, k, float(turns.time[last.start]))
        deepest = max([0.0, *(impact.penetration for impact in joint_impacts)])
        if joint_impacts:
            at = np.degrees([impact.crank_angle for impact in joint_impacts]) % FULL
            peaks = np.array([impact.penetration for impact in joint_impacts]) * small.factor
            depths.append(ring(at, peaks, "deepest of an impact, where it begins", TARGET, size=3.5, gid="impact"))
        limits, cut = clipped_limits(turns, normal * unit.factor, min(0.0, np.min(rub[last]) * unit.factor), 0.0)
        limits_below, cut_below = clipped_limits(turns, depth * small.factor, 0.0, deepest * small.factor)
        share = float(np.mean(result[f"{gap.point}.contact"][last][-turns.points :]))
        above = Panel(Axis(f"force [{unit.unit}]{cut}", limits), forces, 1.5)
        panels = [above, Panel(Axis(f"penetration [{small.unit}]{cut_below}", limits_below), depths)]
        phase = "in contact" + (", last revolution" if turns.shown > 1 else "")
        spans = turns.bands(result[f"{gap.point}.contact"], last, phase)
        title, heading = f"Contact force at {joint_name(gap)}, {turns.overlaid}", turns.title("contact forces", turns.overlaid)
        caption, width = f"in contact {percent(share, 0)}, at most {rough(strongest, 'N')}", 7.6 if columns == 1 else 5.4
        spec = partial(ChartSpec, "force", title, panels, turns.crank_axis, heading, caption)
        specs.append(spec(spans=spans, cursor=False, row=k // columns, width=width))
    return specs


# --- impacts -------------------------------------------------------------------------------------------------------------


def impacts(turns: RevolutionCurves) -> list[ChartSpec]:
    """Plot approach speed and largest penetration of every contact over the revolutions, and where in a revolution it begins."""
    result = turns.result
    if not result.impacts:
        return []
    fastest, deepest = (max(getattr(contact, name) for contact in result.impacts) for name in ("approach", "penetration"))
    unit, small = scale(fastest, "m/s"), scale(deepest, "m")
    above, below, around = [], [], []
    dots = partial(Curve, mode="markers", size=4.5 if len(result.impacts) < 400 else 2.5, opacity=0.6)
    for k, gap in enumerate(result.gaps):
        joint_impacts = _impacts_of(turns, k)
        if joint_impacts:
            at = np.array([impact.begin for impact in joint_impacts]) / turns.period
            angle = np.degrees([impact.crank_angle for impact in joint_impacts]) % FULL
            speed, depth = (
                np.array([getattr(contact, name) for contact in joint_impacts]) for name in ("approach", "penetration")
            )
            name, colour = f"{joint_name(gap)}: {len(joint_impacts)}", BODIES[k % len(BODIES)]
            above.append(dots(at, speed * unit.factor, name, colour, gid=f"approach {gap.point}"))
            below.append(dots(at, depth * small.factor, name, colour, legend=False, gid=f"penetration {gap.point}"))
            around.append(dots(angle, speed * unit.factor, name, colour, legend=False, gid=f"angle {gap.point}"))
    times = [impact.begin / turns.period for impact in result.impacts]
    begin = math.floor(min(times))
    caption = f"{len(result.impacts)} contacts, the last begins in revolution {math.floor(max(times)) + 1} of {turns.last}"
    lasting = [gap.point for gap in result.gaps if result[f"{gap.point}.contact"][-1] > 0.5]
    if lasting:
        caption += f"; still in contact at the end: {', '.join(lasting)}"
    x = Axis("revolutions since the start", (float(begin), float(max(math.ceil(max(times)), begin + 1))))
    speeds = Axis(f"approach speed [{unit.unit}]", from_zero(fastest * unit.factor))
    panels = [Panel(speeds, above), Panel(Axis(f"largest penetration [{small.unit}]", from_zero(deepest * small.factor)), below)]
    where = crank_angle(limits=(0.0, FULL))
    return [
        ChartSpec("impacts", "Impacts over the revolutions", panels, x, turns.title("impacts"), caption, cursor=False),
        ChartSpec(
            "impacts", "Contacts: position and approach speed at their start", [Panel(speeds, around)], where, cursor=False, row=1
        ),
    ]


# --- Poincaré section ----------------------------------------------------------------------------------------------------


def repetition(turns: RevolutionCurves) -> tuple[int | None, float] | None:
    """Return the period of the motion in revolutions and the largest difference as a share of the clearance.

    The second half of the run is used, at most 200 revolutions. The period is None if the motion does not repeat; the result is
    None if there are too few revolutions.
    """
    result = turns.result
    count = len(next(iter(result.poincare_map.values()), ()))
    if count < MIN_REVOLUTIONS:
        return None
    places = np.stack(
        [result.poincare_map[f"{gap.point}.e{axis}_m"] / gap.clearance for gap in result.gaps for axis in "xy"], axis=1
    )
    late = places[-min(200, -(-count // 2)) :]
    differences = {p: max_abs(late[p:] - late[:-p]) for p in range(1, min(MAX_PERIOD, len(late) // 2) + 1)}
    period = next((p for p, most in differences.items() if most < REPETITION_TOLERANCE), None)
    return period, differences[period or 1]


def _verdict(turns: RevolutionCurves) -> str:
    """Describe whether the motion is periodic and whether it is predictable."""
    repeated, predicted = repetition(turns), turns.result.prediction
    if turns.free:
        caption = "under a prescribed torque these are the ends of nominal periods, not of the crank's revolutions"
    elif repeated is None:
        caption = "too few revolutions to tell whether the motion repeats"
    elif repeated[0] is None:
        caption = "not periodic: the journals' positions at the ends of the revolutions do not repeat"
    else:
        after = "every revolution" if repeated[0] == 1 else f"every {repeated[0]} revolutions"
        caption = f"periodic: the journals' positions repeat {after} within {max(repeated[1], 1e-9):.1g} of the clearance"
    if predicted is not None and predicted.chaotic:
        caption += f"; sensitive: runs at two tolerances diverge after {predicted.parted:.2g} revolutions"
    elif predicted is not None and predicted.watched:
        turned = "revolution" if predicted.watched == 1 else f"{predicted.watched} revolutions"
        caption += f"; runs at two tolerances agree over the {turned} compared"
    return caption


def poincare_map(turns: RevolutionCurves) -> list[ChartSpec]:
    """Plot the Poincaré section: output deviation and journal positions at the ends of the revolutions."""
    result, out = turns.result, turns.result.output
    if not result.poincare_map:
        return []
    numbers, values = result.poincare_map["revolution"], result.poincare_map[f"{out.name}.error_{out.unit}"]
    unit, size = turns.shares(max_abs(values)), 4.5 if len(numbers) < 300 else 2.0

    def points(x: Array, y: Array, *, legend: bool = False) -> list[Curve]:
        early = numbers < turns.begin
        first = ring(x[early], y[early], "running-in", MUTED, size=size, legend=legend and bool(early.any()), gid="early")
        late = partial(Curve, mode="markers", size=size, opacity=0.7, legend=legend, gid="late")
        return [first, late(x[~early], y[~early], "end of a revolution", RESULT)]

    y = Axis(f"deviation [{unit.unit}]", padded_limits(values * unit.factor, least=0.02))
    ends = "at the ends of the revolutions"
    heading = f"{turns.title('Poincaré section')}\n{_verdict(turns)}"
    title = f"Deviation of {out.name} at the ends of the revolutions"
    panel = Panel(y, points(numbers, values * unit.factor, legend=True))
    specs = [ChartSpec("section", title, [panel], revolution_axis(numbers), heading, cursor=False, width=4.4)]
    for k, gap in enumerate(result.gaps):
        shown = scale(gap.clearance, "m")
        x, y_ = (result.poincare_map[f"{gap.point}.e{axis}_m"] * shown.factor for axis in "xy")
        row = (k + 1) // charts_per_row(len(result.gaps) + 1)
        words = f"Journal at {joint_name(gap)}"
        specs.append(_eccentricity_chart(turns, k, "section", words, points(x, y_), shown, row=row, width=4.4, remark=ends))
    return specs
