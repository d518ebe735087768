"""Charts of the joints with clearance: journal orbits, contact forces, impacts, Poincaré section."""

import math
import textwrap
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch
from numpy.typing import NDArray

from optlink.clearance.integration import Impact
from optlink.clearance.joint import Gap
from optlink.linkage.mechanism import FRAME
from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import TURN, Array
from optlink.presentation.chart_mpl import FONT, TITLE
from optlink.presentation.chart_spec import (
    BODIES,
    GROUND,
    LIMIT,
    MUTED,
    RESULT,
    TARGET,
    Axis,
    ChartSpec,
    Curve,
    Panel,
    charts_per_row,
    crank_angle,
    max_abs,
)
from optlink.presentation.drawing import STACKED_RATIO, Sketch
from optlink.presentation.format import Scale, degrees, round_below, scale
from optlink.presentation.labels import Label, in_points, lay_out, place_labels
from optlink.presentation.shapes import normed
from optlink.presentation.style import figure, heading, styled
from optlink.presentation.views.revolutions import (
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
        joint_impacts = _impacts_of(turns, k, turns.time[last.start])
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


# Figure of the mechanism with magnified clearances and close-ups of its joints.

TRACE_POSITIONS = 361  # number of positions of the ideal machine in the traces
MAX_OFFSET = 0.55  # largest magnified eccentricity of a journal, in heights of a ground pivot
MAX_ROTATION = 0.1  # largest magnified rotation error of a body [rad]; beyond it, joints without clearance would appear open
JOURNAL_RADIUS = 0.25  # radius of a drawn journal, in heights of a ground pivot
CLEARANCE_SHARE = 0.25  # clearance in the close-up, as a share of the bearing radius
CLOSE_UP_WIDTH, CAPTION_HEIGHT = 3.5, 1.1  # width of a close-up and height of its caption, in bearing radii
CAPTION_LENGTH = 28  # line length of the captions [characters]
MAX_ARROW = 0.62  # length of the longest force arrow, in bearing radii
MIN_FORCE_SHARE = 0.02  # share of the largest force above which a force is drawn


class MagnifiedMachine(Sketch):
    """Sketch of a mechanism with clearance at rows of its simulation, deviations from the ideal machine magnified.

    `steps` is the motion of the ideal machine at these rows.
    """

    def __init__(self, turns: RevolutionCurves, rows: NDArray[np.intp]) -> None:
        result = turns.result
        machine, speed = result.machine, result.speed
        turn = np.radians(turns.angle[rows[-1]]) + np.linspace(0.0, TURN, TRACE_POSITIONS)
        super().__init__(machine.motion(turn, speed), machine)
        self.turns, self.rows, self.gaps = turns, rows, {gap.point: gap for gap in result.gaps}
        self.pins = tuple(name for name in self.pins if name not in self.gaps)
        self.steps = machine.motion(np.radians(turns.angle[rows]), speed)
        self.close_up: Axes | None = None
        self.middles: dict[str, Array] = {}
        ideal = {body: self.steps.body_angle(body).value for body in self.mechanism.bodies}
        bends = {
            body: np.remainder(self.columns(f"{body}.angle_rad") - ideal_angle + math.pi, TURN) - math.pi
            for body, ideal_angle in ideal.items()
        }
        play = max(gap.clearance for gap in self.gaps.values()) * self.scale.factor
        bent = max(max_abs(bend) for bend in bends.values())
        self.factor = max(1.0, round_below(min(MAX_OFFSET * self.size / play, MAX_ROTATION / max(bent, 1e-9))))
        self.angles = {body: ideal[body] + self.factor * bends[body] for body in ideal}
        self.radius = JOURNAL_RADIUS * self.size
        self.strongest = max(np.max(self.force(gap)) for gap in self.gaps.values())
        reach = self.radius + self.factor * play
        self.low, self.high = self.low - reach, self.high + reach

    def columns(self, name: str) -> Array:
        """Return a column at the rows."""
        return self.turns.result[name][self.rows]

    def force(self, gap: Gap) -> Array:
        """Return the magnitude of the contact force at the rows [N]."""
        return np.asarray(np.hypot(self.columns(f"{gap.point}.normal_N"), self.columns(f"{gap.point}.rub_N")))

    def eccentricity(self, gap: Gap) -> Array:
        """Return the vectors from the bearing centre to the journal centre at the rows [m], shape (positions, 2)."""
        return np.stack([self.columns(f"{gap.point}.e{axis}_m") for axis in "xy"], axis=-1)

    # --- positions -------------------------------------------------------------------------------------------------------

    def at(self, point: str, body: str) -> Array:
        """Return the drawn positions (positions, 2) of a point at the rows; at a joint with clearance its bodies differ."""
        ideal, columns = super().position(self.steps, point), self.turns.result.columns
        name = f"{point}.{body}" if f"{point}.{body}.x_m" in columns else point
        if name == point and point in self.gaps:  # a third body shares the bearing
            name = f"{point}.{self.gaps[point].bearing}"
        if f"{name}.x_m" not in columns:
            return ideal
        actual = np.stack([self.columns(f"{name}.{axis}_m") for axis in "xy"], axis=-1) * self.scale.factor
        return np.asarray(ideal + self.factor * (actual - ideal))

    def position(self, motion: Motion, name: str) -> Array:
        """Return the positions of a point in the display unit; at a joint with clearance, those of the bearing centre.

        They are those of the ideal machine for `self.motion`, otherwise those of the rows; the same holds for `placed`.
        """
        if motion is self.motion:
            return super().position(motion, name)
        return self.at(name, self.gaps[name].bearing if name in self.gaps else self.mechanism.owners[name][0])

    def placed(self, motion: Motion, body: str, outline: Array) -> Array:
        """Return the positions (positions, corners, 2) of an outline (corners, 2) in the axes of a body, see `position`."""
        if motion is self.motion:
            return super().placed(motion, body, outline)
        x, y = np.cos(self.angles[body])[:, None], np.sin(self.angles[body])[:, None]
        along, across = outline[:, 0], outline[:, 1]
        start = self.at(self.mechanism.bodies[body].start, body)[:, None, :]
        return np.asarray(start + np.stack([along * x - across * y, along * y + across * x], axis=-1))

    # --- drawing -----------------------------------------------------------------------------------------------------------

    def pose(self, axes: Axes, motion: Motion, k: int = 0) -> list[Artist]:
        """Draw the mechanism at row `k`, with joints with clearance as journals in bearings; also draw the close-ups, if any."""
        artists = super().pose(axes, motion, k)
        more = [(axes, artist) for gap in self.gaps.values() for artist in self._joint(gap, k)]
        if self.close_up is not None:
            more += [(self.close_up, artist) for gap in self.gaps.values() for artist in self._magnified(gap, k)]
        for place, artist in more:
            place.add_artist(artist)
        return artists + [artist for _, artist in more]

    def _colour(self, body: str) -> str:
        return GROUND if body == FRAME else self.colours[body]

    def _joint(self, gap: Gap, k: int) -> list[Artist]:
        """Draw the bearing as a ring, the journal as a disc, and the part of the journal's body that the ring would hide."""
        centre, journal = self.at(gap.point, gap.bearing)[k], self.at(gap.point, gap.journal)[k]
        radius = self.radius + self.factor * gap.clearance * self.scale.factor
        ring = _magnified_circle(centre, radius, "white", self._colour(gap.bearing), 1.6, 4.1, f"bearing {gap.point}")
        disc = _magnified_circle(journal, self.radius, self._colour(gap.journal), "none", 0.0, 4.3, f"journal {gap.point}")
        artists: list[Artist] = [ring, disc]
        joints = [name for name, bodies in self.mechanism.owners.items() if gap.journal in bodies and name != gap.point]
        if joints and gap.journal != FRAME:
            direction = np.mean([self.at(name, gap.journal)[k] for name in joints], axis=0) - journal
            direction, off = normed(direction), journal - centre
            inside = radius * radius - float(off @ off) + float(off @ direction) ** 2
            end = journal + direction * max(math.sqrt(max(inside, 0.0)) - float(off @ direction), 0.0)
            line = 3.8 if gap.journal == self.mechanism.crank.body else 3.0
            artists.append(Line2D(*np.array([journal, end]).T, color=self._colour(gap.journal), linewidth=line, zorder=4.2))
        return artists

    def letters(self, axes: Axes, motion: Motion) -> list[Label]:
        """Return the labels of all points, clear of the bearing rings; the axes must have their final size."""
        play = max(gap.clearance for gap in self.gaps.values()) * self.scale.factor
        ring = in_points(axes, self.radius + self.factor * play)
        return [replace(label, clear=ring) if label.text in self.gaps else label for label in super().letters(axes, motion)]

    # --- close-ups ---------------------------------------------------------------------------------------------------------

    def lay(self, axes: Axes, columns: int, at_row: int) -> None:
        """Draw the fixed parts of the close-ups, `columns` of joints: the bearings and the paths of the journal centres.

        The contact state at one row is written below each joint; `pose` draws into the same axes.
        """
        self.close_up = axes
        for i, gap in enumerate(self.gaps.values()):
            row, column = divmod(i, columns)
            middle, share = np.array([CLOSE_UP_WIDTH * column, -(CLOSE_UP_WIDTH + CAPTION_HEIGHT) * row]), self._share(gap)
            self.middles[gap.point] = middle
            axes.add_patch(_magnified_circle(middle, 1.0, "white", self._colour(gap.bearing), 3.0, 2.0, f"bearing {gap.point}"))
            last = self.turns.rows(1)
            x, y = (self.turns.result[f"{gap.point}.e{axis}_m"][last] / gap.clearance * share for axis in "xy")
            axes.plot(middle[0] + x, middle[1] + y, color=MUTED, linewidth=0.8, zorder=5, gid=f"path {gap.point}")
            lines = textwrap.wrap(joint_name(gap), CAPTION_LENGTH)
            lines += [self._state(gap, at_row), f"gap drawn {share * (gap.radius + gap.clearance) / gap.clearance:.2g}-fold"]
            axes.text(middle[0], middle[1] - 0.52 * CLOSE_UP_WIDTH, "\n".join(lines), ha="center", va="top", fontsize=FONT)
        every = np.array(list(self.middles.values()))
        (x0, y0), (x1, y1) = every.min(axis=0) - 0.5 * CLOSE_UP_WIDTH, every.max(axis=0) + 0.5 * CLOSE_UP_WIDTH
        axes.set(xlim=(x0, x1), ylim=(y0 - CAPTION_HEIGHT, y1))
        axes.set_aspect("equal")
        axes.set_axis_off()

    def _state(self, gap: Gap, k: int) -> str:
        depth, force = self.columns(f"{gap.point}.penetration_m")[k], self.force(gap)[k]
        if self.columns(f"{gap.point}.contact")[k] < 0.5:
            return f"apart, {rough(-depth, 'm')} left"
        return f"{rough(force, 'N')}, {rough(depth, 'm')} deep"

    def _share(self, gap: Gap) -> float:
        """Return the share of the bearing radius that the clearance takes in the close-up."""
        return max(CLEARANCE_SHARE, gap.clearance / (gap.radius + gap.clearance))

    def _magnified(self, gap: Gap, k: int) -> list[Artist]:
        """Draw the journal, the rotation marks of both bodies and the contact force on the journal."""
        middle, share = self.middles[gap.point], self._share(gap)
        e = self.eccentricity(gap)[k]
        centre, colour = middle + e / gap.clearance * share, self._colour(gap.journal)
        tint = tuple(1.0 - 0.35 * (1.0 - part) for part in to_rgb(colour))
        artists: list[Artist] = [_magnified_circle(centre, 1.0 - share, tint, colour, 1.4, 3.0, f"journal {gap.point}")]
        for body, at, begin, end in ((gap.journal, centre, 0.6 * (1.0 - share), 1.0 - share), (gap.bearing, middle, 1.0, 1.14)):
            angle = 0.0 if body == FRAME else self.columns(f"{body}.angle_rad")[k]
            ends = at + np.outer([begin, end], [math.cos(angle), math.sin(angle)])
            artists.append(Line2D(*ends.T, color=self._colour(body), linewidth=2.0, zorder=4, gid=f"mark {body}"))
        artists.append(Line2D([centre[0]], [centre[1]], marker="o", markersize=3.0, color=TARGET, linestyle="none", zorder=6))
        if self.force(gap)[k] > MIN_FORCE_SHARE * self.strongest:
            x, y = e / max(float(np.hypot(*e)), 1e-300)
            normal, rub = (self.columns(f"{gap.point}.{name}_N")[k] for name in ("normal", "rub"))
            tip = middle + np.array([x, y])
            tail = tip + np.array([normal * x + rub * y, normal * y - rub * x]) * MAX_ARROW / self.strongest
            arrow = FancyArrowPatch((tail[0], tail[1]), (tip[0], tip[1]), arrowstyle="-|>", mutation_scale=10.0, color=TARGET)
            arrow.set(linewidth=1.6, zorder=7, gid=f"force {gap.point}")
            arrow.shrinkA = arrow.shrinkB = 0.0
            artists.append(arrow)
        return artists


def _magnified_circle(at: Array, radius: float, face: Any, edge: str, width: float, above: float, gid: str) -> Circle:
    """Return a filled circle; artists of larger `above` hide it."""
    return Circle((at[0], at[1]), radius, facecolor=face, edgecolor=edge, linewidth=width, zorder=above, gid=gid)


@styled
def mechanism(turns: RevolutionCurves) -> Figure:
    """Draw the mechanism at the largest contact force of the last revolution, with close-ups of its joints with clearance."""
    result = turns.result
    last = np.arange(max(0, len(turns.time) - turns.points), len(turns.time))
    row = int(last[np.argmax(np.max([result[f"{gap.point}.normal_N"][last] for gap in result.gaps], axis=0))])
    sketch, count = MagnifiedMachine(turns, np.array([row])), len(result.gaps)
    if sketch.ratio < (0.75 if count > 1 else STACKED_RATIO):  # close-ups below the mechanism
        width, columns = 8.4, min(count, 4)
        low = 2.35 if count > 1 else 2.7
        tall = 7.6 * sketch.ratio + 0.6
        fig = figure(width, tall + low * -(-count // columns) + 1.4)
        stage, strip = fig.subplots(2, 1, height_ratios=(tall, low * -(-count // columns)))
    else:
        width, columns = 9.6, 1 if count < 3 else 2
        fig = figure(width, max(4.4, min(5.4 * sketch.ratio + 1.6, 7.0)))
        stage, strip = fig.subplots(1, 2, width_ratios=(2.0, 1.0))
    sketch.lay(strip, columns, 0)
    sketch.show(stage, sketch.steps)
    place = f"φ {degrees(math.radians(float(turns.angle[row]) % FULL))}, largest contact force of {turns.span(1)}"
    fig.suptitle(heading(turns.title("joint clearance, magnified", place), width - 0.4, TITLE), fontsize=TITLE)
    drawn = f"drawn {sketch.factor:g}-fold" if sketch.factor > 1.0 else "as they are"
    stage.set_title(f"deviations of the bodies {drawn}", fontsize=9.5)
    caption = heading("journals, their paths, contact forces on them", width if strip.get_position().x0 < 0.5 else 3.0, 9.5)
    strip.set_title(caption, fontsize=9.5)
    sketch.add_legend(fig, int(width))
    lay_out(fig)
    place_labels(fig, sketch.letters(stage, sketch.steps))
    return fig
