"""Figures and animation of an analysis: mechanism, motion, forces and work."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from optlink.dynamics.columns import slider_names
from optlink.dynamics.strokes import last_output
from optlink.linkage.mechanism import FRAME
from optlink.linkage.motion import sweep
from optlink.linkage.stroke import TURN, Travel
from optlink.report.animation import film, there_and_back
from optlink.report.drawing import Sketch, arrow
from optlink.report.files import write_csv, write_json
from optlink.report.labels import Label, place_labels
from optlink.report.style import BODIES, CRANK, FOUND, WANTED, Scale, degrees, figure, heading, save, save_film, scale, styled
from optlink.report.views import analysis_curves, analysis_forces
from optlink.report.views.analysis_curves import Course
from optlink.tasks.results.analysis import Analysis, Extreme

FRAMES = 80
SHOWN = 4  # largest number of sliders whose motion is drawn


def write_all(result: Analysis, folder: Path) -> list[Path]:
    """Write result.json, cycle.csv, the applicable figures and the animation; return the paths.

    Parameters
    ----------
    result : Analysis
    folder : Path
        Existing folder to write to.
    """
    written = [folder / "result.json", folder / "cycle.csv"]
    write_json(written[0], result.to_dict())
    write_csv(written[1], result.columns)
    course = Course(result)
    for name, draw in PICTURES.items():
        drawn = draw(course)
        if drawn is not None:
            written.append(folder / f"{name}.png")
            save(drawn, written[-1])
    written.append(folder / "motion.gif")
    save_film(frames(course), written[-1])
    return written


class Output(NamedTuple):
    """An output motion to draw: name, columns of position, velocity and acceleration, and its stroke or swing."""

    name: str
    columns: tuple[str, str, str]
    travel: Travel | None

    @property
    def slides(self) -> bool:
        """Whether the output is a slider [m] rather than a rotating body [rad]."""
        return self.columns[0].endswith(".s_m")

    def floors(self, course: Course) -> tuple[float, float, float]:
        """Return the ranges of position, velocity and acceleration [SI] below which variation is rounding error."""
        size = 1e-8 * (course.peak(self.columns[0]) if self.slides else 1.0)
        turning = abs(course.result.speed)
        return size, size * turning, size * turning * turning

    def scales(self, course: Course, others: Sequence[Output] = ()) -> tuple[Scale, Scale, Scale]:
        """Return the display units of position, velocity and acceleration, common to all outputs of the same kind.

        Parameters
        ----------
        course : Course
        others : sequence of Output, optional
            Other outputs that share the axes.
        """
        units = ("m", "m/s", "m/s²") if self.slides else ("deg", "rad/s", "rad/s²")
        alike = [out for out in (self, *others) if out.slides == self.slides]
        s, v, a = (
            scale(max(max(course.peak(out.columns[k]), out.floors(course)[k]) for out in alike), unit)
            for k, unit in enumerate(units)
        )
        return s, v, a


def _slider(course: Course, name: str) -> Output:
    return Output(name, (f"{name}.s_m", f"{name}.v_m_s", f"{name}.a_m_s2"), course.result.strokes.get(name))


def _body(course: Course, body: str) -> Output:
    columns = (f"{body}.angle_rad", f"{body}.omega_rad_s", f"{body}.alpha_rad_s2")
    return Output(body, columns, course.result.swings.get(body))


def output(course: Course) -> Output:
    """Return the main output of the machine: its last slider on the frame, otherwise its last oscillating body."""
    name, slides = last_output(course.result.machine, course.result.swings, course.result.strokes)
    return _slider(course, name) if slides else _body(course, name)


def outputs(course: Course) -> list[Output]:
    """Return the outputs shown in motion.png: the sliders, those on the frame last, or the main output."""
    names = slider_names(course.result.machine)
    ordered = sorted(course.result.machine.mechanism.guides, key=lambda guide: guide.on == FRAME)
    found = [_slider(course, names[guide.name]) for guide in ordered]
    return [slider for slider in found if course.has(slider.columns[1])][-SHOWN:] or [output(course)]


# --- mechanism -------------------------------------------------------------------------------------------------------------


def positions(course: Course) -> dict[str, float]:
    """Return the characteristic crank angles [rad] by name.

    These are the start (or start, middle and end of a limited range), the dead centres of the output and the torque extremes.
    """
    result, out = course.result, output(course)
    found = [("start", course.start)]
    if not result.full:
        middle = 0.5 * (course.start + course.end)
        found = [("start of the range", course.start), ("middle of the range", middle), ("end of the range", course.end)]
    centres = course.in_order(out.travel.dead_centres) if out.travel else []
    ends = (out.travel.low_at, out.travel.high_at) if out.travel else ()
    for number, at in enumerate(centres, 1):
        if len(centres) <= 4 or any(abs(math.remainder(at - end, TURN)) < 1e-6 for end in ends):
            found.append((f"dead centre {number} of {out.name}" if 1 < len(centres) <= 4 else f"limit of {out.name}", at))
    torque = result.extremes.get("input.torque_Nm")
    if (
        torque
        and course.has("input.torque_Nm")
        and torque.largest - torque.least > analysis_curves.NOTHING * course.peak("input.torque_Nm")
    ):
        found += [("largest torque", course.inside(torque.largest_at)), ("least torque", course.inside(torque.least_at))]
    merged: dict[str, float] = {}
    for name, at in found:
        same = next((k for k, v in merged.items() if abs(math.remainder(v - at, TURN) if result.full else v - at) < 1e-6), None)
        if same is None:
            merged[name] = at
        else:
            merged = {f"{k} = {name}" if k == same else k: v for k, v in merged.items()}
    return merged


@styled
def mechanism(course: Course) -> Figure:
    """Draw the mechanism at its characteristic positions with joint traces, and the joint velocities at one of them."""
    result = course.result
    machine = result.machine
    sketch = Sketch(sweep(machine.mechanism, machine.sizes, course.angles, result.speed), machine)
    named = positions(course)
    here = {name: sweep(machine.mechanism, machine.sizes, np.array([at]), result.speed) for name, at in named.items()}
    moving = [point for point, bodies in machine.mechanism.owners.items() if FRAME not in bodies]
    speeds = {name: max(float(np.linalg.norm(there.velocity(point)[0])) for point in moving) for name, there in here.items()}
    # show velocities at the largest torque or, if some are unbounded, where they are smallest
    slow = {name: speed for name, speed in speeds.items() if math.isfinite(speed)}
    chosen = next((name for name in named if "largest torque" in name), next(iter(named)))
    if slow and not course.steady:
        chosen = min(slow, key=lambda name: slow[name])
    longest = 0.2 * float(np.max(sketch.high - sketch.low))
    drawn_arrows = sketch.arrows(here[chosen], 0, moving, longest)
    sketch.widen(np.array([end for _, end in drawn_arrows.values()]).reshape(-1, 2))
    count = len(named) + bool(drawn_arrows)
    tall = sketch.ratio > 1.15
    columns = 4 if tall and count > 6 else 3 if count > 4 else 2 if count > 1 else 1
    rows = -(-count // columns)
    panel = 3.3 if tall else 4.0
    width = panel * columns
    made = figure(width, ((panel - 0.6) * min(max(sketch.ratio, 0.3), 1.6) + 0.95) * rows + 0.8)
    panels = list(made.subplots(rows, columns, squeeze=False).flat)
    labels: list[Label] = []
    for axes, (name, at) in zip(panels, named.items(), strict=False):
        sketch.stage(axes)
        sketch.pose(axes, here[name])
        labels += sketch.letters(axes, here[name])
        axes.set_title(f"{heading(name, panel, 9.5)}\n{_state(course, at)}", fontsize=9.5)
    if drawn_arrows:
        axes = panels[len(named)]
        sketch.stage(axes, traces=False)
        sketch.pose(axes, here[chosen])
        axes.set_xlabel(axes.get_xlabel(), loc="left")  # the scale of the arrows is drawn on the right
        labels += sketch.letters(axes, here[chosen])
        for point, (begin, end) in drawn_arrows.items():
            arrow(axes, begin, end, gid=f"velocity {point}")
        axes.set_title(f"velocities of the joints, φ {degrees(named[chosen])}\n{heading(chosen, panel, 9.5)}", fontsize=9.5)
    for axes in panels[count:]:
        axes.remove()
    made.suptitle(heading(result.problem.model.title, width), fontsize=11)
    handles, words = sketch.legend()
    made.legend(
        handles, words, loc="outside lower center", ncols=min(len(handles), int(1.1 * width)), frameon=False, fontsize=8.5
    )
    place_labels(made, labels)
    if drawn_arrows:
        top = max(float(np.linalg.norm(here[chosen].velocity(point)[0])) for point in drawn_arrows)
        _scale_arrow(panels[len(named)], top, longest)
    return made


def _scale_arrow(axes: Axes, top: float, longest: float) -> None:
    """Draw the scale arrow of the velocities below the x axis; a velocity `top` [m/s] is drawn `longest` long."""
    drawn = axes.get_figure()
    assert drawn is not None
    unit = scale(top, "m/s")
    shown = _round(0.6 * top * unit.factor)
    (_, low), (right, _) = axes.get_window_extent().get_points()
    x, y = axes.transData.inverted().transform((right, low - 27.0 / 72.0 * drawn.dpi))
    length = longest * shown / (top * unit.factor)
    arrow(axes, np.array([x - length, y]), np.array([x, y]), gid="scale").set_clip_on(False)
    room = 0.015 * float(np.ptp(axes.get_xlim()))
    axes.text(x - length - room, y, f"{shown:g} {unit.unit}", ha="right", va="center", fontsize=8.5, in_layout=False)


def _state(course: Course, at: float) -> str:
    """Format crank angle, output position and driving torque at a position."""
    out = output(course)
    parts = [
        f"φ {degrees(at)}",
        f"{'s' if out.slides else 'θ'} {out.scales(course)[0].text(course.at(at, out.columns[0]))}",
    ]
    torque = course.at(at, "input.torque_Nm")
    if course.has("input.torque_Nm") and math.isfinite(torque) and not np.any(np.abs(course.result.jumps - at) < 1e-6):
        parts.append(f"M {scale(course.peak('input.torque_Nm'), 'N m').text(torque)}")
    return "   ".join(parts)


def _round(value: float) -> float:
    """Return the next lower value of the series 1, 2, 5, 10, ..."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-12))


# --- motion ------------------------------------------------------------------------------------------------------------------


@styled
def motion(course: Course) -> Figure:
    """Draw displacement, velocity and acceleration of every slider (or the last oscillating body) over the crank angle."""
    shown = outputs(course)
    width = 7.4 if len(shown) == 1 else min(5.6 * len(shown), 19.0)
    made = figure(width, 7.4)
    grid = made.subplots(3, len(shown), squeeze=False, sharex=True)
    labels: list[Label] = []
    for column, out in zip(grid.T, shown, strict=True):
        words = ("displacement s", "velocity", "acceleration")
        if not out.slides:
            words = ("angle θ", "angular velocity", "angular acceleration")
        scales, floors = out.scales(course, shown), out.floors(course)
        for k, axes in enumerate(column):
            name, unit, word = out.columns[k], scales[k], words[k]
            drawn = analysis_curves.draw(axes, course, name, unit, (FOUND, BODIES[1], CRANK)[k])
            held = analysis_curves.fit(axes, course, drawn, least=4.0 * floors[k] * unit.factor)
            analysis_curves.strokes(axes, course, out.travel, named=k == 0)
            limits = _limits(course, out) if name.endswith(".angle_rad") else course.result.extremes.get(name)
            if limits and limits.largest - limits.least > 2.0 * floors[k]:
                labels += analysis_curves.extremes(axes, course, name, unit, WANTED, limits)
            analysis_curves.zero(axes)
            analysis_curves.crank_axis(axes, course, named=axes is column[-1])
            axes.set_ylabel(f"{word} [{unit.unit}]" + ("" if held else "\n(cut off)"))
        column[0].set_title(_travelled(course, out, width / len(shown) - 0.8), fontsize=9.5)
    made.suptitle(heading(f"{course.result.problem.model.title}: motion", width), fontsize=11)
    place_labels(made, labels)
    return made


def _limits(course: Course, out: Output) -> Extreme | None:
    travel = out.travel
    if travel is None:
        return None
    turn = TURN * round(
        (course.at(course.inside(travel.low_at), out.columns[0]) - travel.low) / TURN
    )  # the curve may be shifted by a turn
    return Extreme(travel.low + turn, travel.low_at, travel.high + turn, travel.high_at)


def _travelled(course: Course, out: Output, width: float) -> str:
    if out.travel is None:
        angles = course[out.columns[0]]
        turns = not out.slides and abs(abs(angles[-1] - angles[0]) - TURN) < 1e-6
        return f"{out.name}: turns fully" if turns else out.name
    centres = ""
    span = scale(out.travel.span, "m" if out.slides else "deg").text(out.travel.span)
    parts = [f"{out.name}: {'stroke' if out.slides else 'swing'} {span}"]
    if math.isfinite(out.travel.time_ratio):
        parts.append(f"time ratio {out.travel.time_ratio:.4f}")
    if out.travel.dead_centres:
        some = [degrees(at) for at in course.in_order(out.travel.dead_centres)]
        some = [*some[:8], "..."] if len(some) > 8 else some
        centres = heading(f"dead centre{'s' if len(some) > 1 else ''} at {', '.join(some)}", width, 9.5)
    return heading(", ".join(parts), width, 9.5) + (f"\n{centres}" if centres else "")


# --- animation ---------------------------------------------------------------------------------------------------------------


@styled
def frames(course: Course, count: int = FRAMES) -> list[Image.Image]:
    """Draw the frames of the animation: one revolution, or back and forth over a limited crank range.

    Beside the mechanism, the driving torque or the output motion is drawn.

    Parameters
    ----------
    course : Course
    count : int, optional
        Number of frames.
    """
    result = course.result
    machine = result.machine
    sketch = Sketch(sweep(machine.mechanism, machine.sizes, course.angles), machine)
    once = course.start + course.way * result.cycle * np.arange(count) / count
    steps = once if result.full else there_and_back(course.start, course.end, count)
    out = output(course)
    name = "input.torque_Nm" if course.has("input.torque_Nm") else out.columns[0]
    unit = scale(course.peak(name), "N m") if course.has("input.torque_Nm") else out.scales(course)[0]

    def curve(axes: Axes) -> None:
        analysis_curves.fit(axes, course, analysis_curves.draw(axes, course, name, unit, CRANK), room=0.08)
        analysis_curves.zero(axes)
        analysis_curves.crank_axis(axes, course)
        word = "driving torque" if name == "input.torque_Nm" else f"{out.name}: {'slide' if out.slides else 'angle'}"
        axes.set_ylabel(f"{word} [{unit.unit}]")

    marks = np.array([[math.degrees(at), course.at(at, name) * unit.factor] for at in steps])
    return film(sketch, sweep(machine.mechanism, machine.sizes, steps), curve, marks, result.problem.model.title)


PICTURES: dict[str, Callable[[Course], Figure | None]] = {
    "mechanism": mechanism,
    "motion": motion,
    "torque": analysis_forces.torque,
    "reactions": analysis_forces.reactions,
    "guides": analysis_forces.guides,
    "work": analysis_forces.work,
    "shaking": analysis_forces.shaking,
}
