"""Figure of the mechanism with magnified clearances and close-ups of its joints."""

import math
import textwrap
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch
from numpy.typing import NDArray

from optlink.clearance.joint import Gap
from optlink.linkage.mechanism import FRAME
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.vector2d import TURN, Array
from optlink.report.animation import STACKED_RATIO
from optlink.report.chart_mpl import FONT, TITLE
from optlink.report.chart_spec import GROUND, MUTED, TARGET, max_abs
from optlink.report.drawing import Sketch
from optlink.report.format import degrees, round_below
from optlink.report.labels import Label, in_points, lay_out, place_labels
from optlink.report.style import figure, heading, styled
from optlink.report.views.revolutions import FULL, RevolutionCurves, joint_name, rough
from optlink.tasks.results.clearance import ClearanceSimulation

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
        super().__init__(sweep(machine.mechanism, machine.sizes, turn, speed), machine)
        self.turns, self.rows, self.gaps = turns, rows, {gap.point: gap for gap in result.gaps}
        self.pins = tuple(name for name in self.pins if name not in self.gaps)
        self.steps = sweep(machine.mechanism, machine.sizes, np.radians(turns.angle[rows]), speed)
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
        ring = _circle(centre, radius, "white", self._colour(gap.bearing), 1.6, 4.1, f"bearing {gap.point}")
        disc = _circle(journal, self.radius, self._colour(gap.journal), "none", 0.0, 4.3, f"journal {gap.point}")
        artists: list[Artist] = [ring, disc]
        joints = [name for name, bodies in self.mechanism.owners.items() if gap.journal in bodies and name != gap.point]
        if joints and gap.journal != FRAME:
            direction = np.mean([self.at(name, gap.journal)[k] for name in joints], axis=0) - journal
            direction, off = direction / max(float(np.linalg.norm(direction)), 1e-30), journal - centre
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
            axes.add_patch(_circle(middle, 1.0, "white", self._colour(gap.bearing), 3.0, 2.0, f"bearing {gap.point}"))
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
        depth, force = float(self.columns(f"{gap.point}.penetration_m")[k]), float(self.force(gap)[k])
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
        artists: list[Artist] = [_circle(centre, 1.0 - share, tint, colour, 1.4, 3.0, f"journal {gap.point}")]
        for body, at, begin, end in ((gap.journal, centre, 0.6 * (1.0 - share), 1.0 - share), (gap.bearing, middle, 1.0, 1.14)):
            angle = 0.0 if body == FRAME else float(self.columns(f"{body}.angle_rad")[k])
            ends = at + np.outer([begin, end], [math.cos(angle), math.sin(angle)])
            artists.append(Line2D(ends[:, 0], ends[:, 1], color=self._colour(body), linewidth=2.0, zorder=4, gid=f"mark {body}"))
        artists.append(Line2D([centre[0]], [centre[1]], marker="o", markersize=3.0, color=TARGET, linestyle="none", zorder=6))
        if float(self.force(gap)[k]) > MIN_FORCE_SHARE * self.strongest:
            x, y = e / max(float(np.hypot(*e)), 1e-300)
            normal, rub = (float(self.columns(f"{gap.point}.{name}_N")[k]) for name in ("normal", "rub"))
            tip = middle + np.array([x, y])
            tail = tip + np.array([normal * x + rub * y, normal * y - rub * x]) * MAX_ARROW / self.strongest
            arrow = FancyArrowPatch((tail[0], tail[1]), (tip[0], tip[1]), arrowstyle="-|>", mutation_scale=10.0, color=TARGET)
            arrow.set(linewidth=1.6, zorder=7, gid=f"force {gap.point}")
            arrow.shrinkA = arrow.shrinkB = 0.0
            artists.append(arrow)
        return artists


def _circle(at: Array, radius: float, face: Any, edge: str, width: float, above: float, gid: str) -> Circle:
    """Return a filled circle; artists of larger `above` hide it."""
    return Circle((at[0], at[1]), radius, facecolor=face, edgecolor=edge, linewidth=width, zorder=above, gid=gid)


@styled
def mechanism(result: ClearanceSimulation) -> Figure | None:
    """Draw the mechanism at the largest contact force of the last revolution, with close-ups of its joints with clearance."""
    turns = RevolutionCurves(result)
    if not turns:
        return None
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
    words = turns.title("joint clearance, magnified", place).split("\n")
    fig.suptitle("\n".join(heading(line, width - 0.4, TITLE) for line in words), fontsize=TITLE)
    drawn = f"drawn {sketch.factor:g}-fold" if sketch.factor > 1.0 else "as they are"
    stage.set_title(f"deviations of the bodies {drawn}", fontsize=9.5)
    caption = heading("journals, their paths, contact forces on them", width if strip.get_position().x0 < 0.5 else 3.0, 9.5)
    strip.set_title(caption, fontsize=9.5)
    sketch.add_legend(fig, int(width))
    lay_out(fig)
    place_labels(fig, sketch.letters(stage, sketch.steps))
    return fig
