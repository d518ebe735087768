"""Motion and deviations of a synthesised design, and their captions, shared by all its figures."""

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from optlink.linkage.motion import Motion, sweep
from optlink.linkage.vector2d import TURN, Array
from optlink.problem.file import ProblemFile
from optlink.problem.requirement import MARK
from optlink.report.causes import marked, why_invalid
from optlink.report.drawing import Sketch
from optlink.report.files import verdict
from optlink.report.format import round_below
from optlink.report.shapes import finite, spread
from optlink.report.style import Scale, degrees, heading, scale
from optlink.report.views.path_tables import exact, exact_places, measure, words
from optlink.tasks.results.cycle import CycleResult
from optlink.tasks.results.design import LinkageDesign, SynthesisResult

POSITIONS = 721  # positions per revolution
DEVIATION_LENGTH = 0.07  # length of the largest magnified deviation, as a share of the extent of the points


class PathView:
    """Motion of a synthesised design relative to its precision points.

    `motion` is the whole motion: a revolution, or the assembled range around the points. `run` is the motion from the first point
    to the last, or a revolution if the points are closed. `at` contains the positions at the points.
    """

    def __init__(self, design: LinkageDesign, refuted: str = "") -> None:
        self.design, self.task, self.refuted = design, design.task, refuted
        angles = design.crank_angles
        self.begin, self.end = float(angles[0]), float(angles[-1])
        self.direction = 1.0 if self.end >= self.begin else -1.0
        self.at = self.sweep(angles)
        self.reached = bool(np.any(self.at.assembled))
        self.first = int(np.argmax(self.at.assembled))
        around = self.task.closed and design.crank_turns
        span = TURN if around else abs(self.end - self.begin)
        count = max(61, math.ceil(span / TURN * (POSITIONS - 1)) + 1)
        self.run = self.sweep(self.begin + self.direction * np.linspace(0.0, span, count))
        self.motion = self.sweep(self._whole())
        self.here = self.sweep(angles[self.first : self.first + 1])

    def sweep(self, angles: Array) -> Motion:
        """Return the motion of the mechanism at crank angles [rad]."""
        return sweep(self.task.linkage, self.design.values, angles)

    def _whole(self) -> Array:
        once = self.begin + self.direction * np.linspace(0.0, TURN, POSITIONS)
        if self.design.crank_turns:
            return once
        low, high = sorted((self.begin, self.end))
        if self._farthest(high, low + TURN) == low + TURN:
            return once
        ends = self._farthest(low, high - TURN), self._farthest(high, low + TURN)
        return np.linspace(*(ends if self.direction > 0.0 else ends[::-1]), POSITIONS)

    def _farthest(self, start: float, stop: float) -> float:
        """Return the last angle from `start` towards `stop` at which the mechanism is assembled."""
        for _ in range(4):
            grid = np.linspace(start, stop, POSITIONS)
            unassembled = np.flatnonzero(~self.sweep(grid).assembled)
            if not unassembled.size:
                return stop
            if unassembled[0] == 0:
                return start
            start, stop = float(grid[unassembled[0] - 1]), float(grid[unassembled[0]])
        return start

    @cached_property
    def sketch(self) -> Sketch:
        """Sketch of the mechanism, with room for the points."""
        sketch = Sketch(self.motion)
        sketch.widen(self.targets * sketch.scale.factor)
        return sketch

    @property
    def targets(self) -> Array:
        """Precision points [m], shape (points, 2); empty for function and transmission synthesis."""
        return np.asarray(self.task.data.columns[:, :2] if self.task.pointed else np.empty((0, 2)))

    @property
    def generated(self) -> Array:
        """Generated points [m], shape (points, 2)."""
        return self.position(self.at)

    def position(self, motion: Motion) -> Array:
        """Return the positions of the coupler point [m], shape (positions, 2)."""
        return motion.position(self.task.point)

    @property
    def colour(self) -> str:
        """Colour of the body that carries the coupler point."""
        return self.sketch.colours[self.task.body]

    @property
    def exact(self) -> bool:
        """Whether every point is met to rounding."""
        return exact_places(self.design)

    @property
    def tolerances(self) -> Array:
        """Tolerances of the points [m]; infinite where there is none."""
        return self.task.data.tolerances

    def angles(self, motion: Motion) -> Array:
        """Return the pose angles of the guided body [rad]."""
        return np.asarray(motion.body_angle(self.task.body).value) + self.design.values[MARK]

    @cached_property
    def size(self) -> float:
        """Extent of the points [m]."""
        extent = np.max(spread(finite(np.concatenate([self.targets, self.generated]))))
        return extent if extent > 0.0 else self.task.size

    @cached_property
    def factor(self) -> float:
        """Magnification of deviations and tolerances in the figures."""
        largest = 0.0 if self.exact else np.nanmax(self.design.measured.distances)
        limit = DEVIATION_LENGTH * self.size / largest if largest > 0.0 else math.inf
        tolerances = self.tolerances[np.isfinite(self.tolerances)]
        if tolerances.size:
            distances = np.linalg.norm(np.diff(self.targets, axis=0), axis=1)
            limit = min(limit, 0.45 * np.median(distances) / float(np.max(tolerances)))
        return max(1.0, round_below(limit))


def best(result: SynthesisResult) -> PathView | None:
    """Return the best design or the nearest miss; None if there is nothing to draw."""
    if result.best is None:
        return None
    view = PathView(result.best, result.refuted)
    return view if view.reached else None


MAX_DIMENSIONS = 14  # largest number of dimensions below a title
DIGITS = 5  # significant digits of a dimension
TITLE = 10.0  # font size of a figure title [pt]
SMALL = 9.5  # font size of a panel title [pt]
LINE = 0.17  # line height of a figure title [inch]


def fitting(value: float, unit: Scale) -> Scale:
    """Return the unit of the figure, or a smaller unit for values [m] that are small in it."""
    return unit if value == 0.0 or not math.isfinite(value) or value * unit.factor >= 0.01 else scale(value, "m")


def length(value: float, unit: Scale) -> str:
    """Format a deviation [m] with its unit, from the unit of the figure."""
    shown = fitting(value, unit)
    return f"{_digits(value * shown.factor, 4)} {shown.unit}"


def squares(value: float, unit: Scale) -> str:
    """Format a sum of squares [m²] in the square of the figure's unit, or of a smaller one that avoids an exponent."""
    small = Scale(1e3, "mm"), Scale(1e6, "µm"), Scale(1e9, "nm")
    units = [unit, *(smaller for smaller in small if smaller.factor > unit.factor)]
    shown = next((item for item in units if value * item.factor**2 >= 1e-4), units[-1])
    return f"{_digits(value * shown.factor**2, 4)} {shown.unit}²"


def _digits(value: float, count: int) -> str:
    """Format `count` significant digits, without an exponent for moderate sizes and with a typographic minus."""
    if not math.isfinite(value):
        return "–"
    size = math.floor(math.log10(abs(value))) if value else 0
    shown = f"{value:z.{min(max(count - 1 - size, 0), 9)}f}" if -5 <= size < 7 else f"{value:.{count}g}"
    if "." in shown and "e" not in shown:
        shown = shown.rstrip("0").rstrip(".")
    return shown.replace("-", "−") if "e" not in shown else shown


def with_verdict(
    machine: ProblemFile | None, design: LinkageDesign | CycleResult | None, refuted: str = ""
) -> tuple[ProblemFile, str] | None:
    """Return the machine of a design with its verdict; None if there is none."""
    if machine is None or design is None:
        return None
    why = refuted or why_invalid(design.validation.checks, design.status.text)
    return machine, verdict(design.status.value, design.valid, why)


def objective(view: PathView) -> str:
    """Format the objective with its measure."""
    design, unit, task = view.design, view.sketch.scale, view.task
    if exact(design):
        return "exact to rounding"
    what = measure(task)
    squared = task.measure == "sum of squares"
    if task.unit == "m":
        return f"{what} {squares(design.objective, unit) if squared else length(design.objective, unit)}"
    if task.unit == "rad":
        return f"{what} {_digits(design.objective * math.degrees(1.0) ** (1 + squared), 4)} deg{'²' if squared else ''}"
    label = "largest cosine of a transmission angle" if task.measure == "max" else f"cosines of the transmission angles: {what}"
    return f"{label} {design.objective:.4g}"


def assembly(design: LinkageDesign) -> list[str]:
    """Return the assembly modes, one text for each joint."""
    first, *rest = words(design).split(", ")
    return [f"assembly {first}", *rest]


def transmission(design: LinkageDesign) -> str:
    """Format the worst transmission angle; empty if there is none."""
    least = design.least_transmission
    return f"least transmission angle {math.degrees(least):z.1f}°" if math.isfinite(least) else ""


def figures(view: PathView) -> list[str]:
    """Return the captions of objective, deviations and transmission angle."""
    design, task, unit = view.design, view.task, view.sketch.scale
    distances, turned = design.measured.distances, design.measured.turned
    if task.by_angle:
        return list(filter(None, [transmission(design)]))
    if not task.pointed:
        return [objective(view), *_error(view), *filter(None, [transmission(design)])]
    texts = []
    if exact(design):
        many = f"all {len(distances)}" if len(distances) > 2 else "both"
        texts.append(f"{many} {'points' if turned is None else 'poses'} met exactly, to rounding")
    else:
        plain = turned is None and task.target_points.weights is None
        rms, largest = math.sqrt(np.nanmean(distances**2)), np.nanmax(distances)
        if not (plain and task.measure in ("rms", "max")):
            texts.append(objective(view))
        shown = fitting(rms, unit)
        texts.append(f"distances: rms {length(rms, shown)}, largest {length(largest, shown)}")
        if turned is not None:
            texts.append(f"angles: largest {_digits(math.degrees(np.nanmax(np.abs(turned))), 4)}°")
        if np.any(np.isfinite(view.tolerances)):
            used = np.nanmax(distances / view.tolerances)
            texts.append(f"at most {f'{100.0 * used:.3g} % of' if used < 10.0 else f'{used:.3g} times'} the tolerance")
    return [*texts, *filter(None, [transmission(design)])]


def _error(view: PathView) -> list[str]:
    """Return the caption of the output error of a function."""
    task, errors = view.task, view.design.measured.distances
    if not task.unit or view.exact:
        return []
    rms, largest = math.sqrt(np.nanmean(errors**2)), np.nanmax(errors)
    unit = fitting(rms, view.sketch.scale) if task.slides else Scale(math.degrees(1.0), "deg")
    shown = (f"{_digits(value * unit.factor, 4)} {unit.unit}" for value in (rms, largest))
    return ["error: rms {}, largest {}".format(*shown)]


def sizes(view: PathView) -> list[str]:
    """Return the captions of all dimensions, or of the design variables only if there are too many."""
    task, unit, values = view.task, view.sketch.scale, view.design.values
    names = [*task.mechanism.quantities, *([MARK] if MARK in task.quantities else [])]
    if len(names) > MAX_DIMENSIONS:
        names = [name for name in names if not task.quantities[name].fixed]
    if not names or len(names) > MAX_DIMENSIONS:
        return []
    angles = [task.quantities[name].kind == "angle" for name in names]
    largest = max([abs(values[name]) for name, angle in zip(names, angles, strict=True) if not angle], default=0.0)
    decimals = DIGITS - math.floor(math.log10(largest * unit.factor)) if largest else 0
    texts = []
    for name, angle in zip(names, angles, strict=True):
        shown = degrees(values[name]) if angle else _digits(round(values[name] * unit.factor, decimals), DIGITS)
        texts.append(f"{name} {shown}")
    return [f"in {unit.unit}: {texts[0]}", *texts[1:]]


def wrapped(items: Sequence[str], width: float, gap: str, size: float = TITLE) -> str:
    """Join items to lines of similar length that fit a width [inch] at a font size [pt]; items are not broken."""
    most = max(16, int(72.0 * width / (0.56 * size)))

    def lines(limit: int) -> list[str]:
        wrapped_lines = [""]
        for item in items:
            longer = f"{wrapped_lines[-1]}{gap if wrapped_lines[-1] else ''}{item}"
            if wrapped_lines[-1] and len(longer) > limit:
                wrapped_lines.append(item)
            else:
                wrapped_lines[-1] = longer
        return wrapped_lines

    count = len(lines(most))
    best = next(wrapped_lines for limit in range(1, most + 1) if len(wrapped_lines := lines(limit)) == count)
    return f"{gap.rstrip()}\n".join(best)


def title_of(view: PathView, width: float, title: str, *more: str) -> str:
    """Compose a title with further lines below it, without empty ones; an invalid design is marked as not valid."""
    lines, fit = marked(title, view.design, view.refuted), view.design.fit
    if view.design.valid and fit is not None and fit.grade == "poor":
        lines.append(fit.text.capitalize())
    return "\n".join([*(heading(line, width, TITLE) for line in lines), *filter(None, more)])


def mechanism_title(view: PathView, width: float) -> str:
    """Compose the title of a mechanism with its deviations and dimensions."""
    texts = wrapped(figures(view), width, "; "), wrapped(sizes(view), width, "   ")
    return title_of(view, width, view.task.title, *texts)
