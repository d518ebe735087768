"""Motion and deviations of a synthesised design, and their captions, shared by all its figures."""

import math
import textwrap
from collections.abc import Sequence
from functools import cached_property, partial

import numpy as np

from optlink.linkage.extrema import extremes
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.stroke import reachable
from optlink.linkage.vector2d import TURN, Array
from optlink.presentation.drawing import Sketch
from optlink.presentation.files import verdict
from optlink.presentation.format import Scale, degrees, marked, round_below, scale, why_invalid
from optlink.presentation.scene import regions_of
from optlink.presentation.shapes import finite, spread
from optlink.presentation.style import heading
from optlink.presentation.views.design_tables import captions
from optlink.problem.file import ProblemFile
from optlink.problem.requirements.base import MARK
from optlink.tasks.results.design import LinkageDesign, SynthesisResult
from optlink.validation.motion import transmission_angles

POSITIONS = 721  # positions per revolution
DEVIATION_LENGTH = 0.07  # length of the largest magnified deviation, as a share of the extent of the points


class DesignView:
    """Motion of a synthesised design relative to the range of its requirement.

    `begin` and `end` are the crank angles [rad] of that range, `at` contains the positions at its targets. `run` is the motion
    over the range, or a revolution if the points are closed; `motion` is the whole motion: a revolution, the range in which the
    crank swings, or the reachable range.
    """

    def __init__(self, design: LinkageDesign, refuted: str = "") -> None:
        self.design, self.task, self.refuted = design, design.task, refuted
        self.begin, span = design.rotation
        self.end = self.begin + span
        self.started = math.isfinite(self.begin)  # else without the dead centre at which the range begins
        if not self.started:
            self.begin = self.end = 0.0
        self.direction = 1.0 if self.end >= self.begin else -1.0
        self.at = self.sweep(design.crank_angles)
        self.first = int(np.argmax(self.at.assembled))
        around = self.task.closed and design.crank_turns
        limited = (self.task.pointed and not around) or design.follows_law
        self.partial = self.started and limited and abs(self.end - self.begin) < TURN - 1e-9
        span = TURN if around else abs(self.end - self.begin)
        count = max(61, math.ceil(span / TURN * (POSITIONS - 1)) + 1)
        self.run = self.sweep(self.begin + self.direction * np.linspace(0.0, span, count))
        self.motion = self.sweep(self._whole())
        self.reached = bool(np.any(self.at.assembled if self.started else self.motion.assembled))
        self.here = self.sweep(design.crank_angles[self.first : self.first + 1])

    def sweep(self, angles: Array) -> Motion:
        """Return the motion of the mechanism at crank angles [rad]."""
        return sweep(self.task.linkage, self.design.values, angles)

    def _whole(self) -> Array:
        if self.design.swing is not None:
            return np.asarray(np.linspace(*self.design.swing, POSITIONS)[:: int(self.direction)])
        low, high = sorted((self.begin, self.end))
        ranges = reachable(self.task.linkage, self.design.values)
        if ranges.limits is not None:
            return np.linspace(*(ranges.limits if self.direction > 0.0 else ranges.limits[::-1]), POSITIONS)
        if ranges.full or self.design.crank_turns:
            return self.begin + self.direction * np.linspace(0.0, TURN, POSITIONS)
        for place in (self.begin, self.end):
            held = ranges.holding(place)
            if held is not None:
                low, high = min(low, held[0]), max(high, held[1])
        return np.linspace(*((low, high) if self.direction > 0.0 else (high, low)), POSITIONS)

    @property
    def turns(self) -> bool:
        """Whether the motion is a whole revolution."""
        return bool(np.ptp(self.motion.crank_angle) > TURN - 1e-6)

    @cached_property
    def output(self) -> str | None:
        """The output of the requirement; without one the last body that turns about a fixed pivot."""
        mechanism = self.task.linkage
        pivoted = [link.body for link in mechanism.links if {link.start, link.end} & set(mechanism.ground)]
        last = next((body for body in pivoted[::-1] if body != mechanism.crank.body), None)
        return self.task.output if self.design.follows_law else last

    @property
    def slides(self) -> bool:
        """Whether the output is a slide or a coordinate, not the angle of a body."""
        return self.output is not None and self.output not in self.task.linkage.bodies

    def output_at(self, motion: Motion) -> list[str]:
        """Return the output at the first position of a motion, as text; nothing without an output."""
        if self.output is None:
            return []
        if self.slides:
            symbol = self.output if "." in self.output else "s"
            return [f"{symbol} {self.sketch.scale.text(float(motion.coordinate(self.output).value[0]))}"]
        return [f"ψ {degrees(float(motion.body_angle(self.output).value[0]))}"]

    def crank(self, angles: Array) -> Array:
        """Return crank angles [deg] for a chart, less than a revolution from zero at the begin of the range."""
        turns = 0.0 if -math.pi <= self.begin <= TURN else TURN * round(self.begin / TURN)
        return np.degrees(angles - turns)

    def transmission(self, angles: Array) -> Array:
        """Return the transmission angle [rad] of every dyad (angles, dyads)."""
        return transmission_angles(self.sweep(angles), self.task.linkage)

    @cached_property
    def transmission_extremes(self) -> tuple[Array, Array]:
        """Crank angles and values [rad] of the least and the largest transmission angle of every dyad (dyads, 2).

        Over the revolution, or over the range where the crank need not turn further.
        """
        grid = np.sort((self.motion if self.design.crank_turns or not self.partial else self.run).crank_angle)
        places, cosines = extremes(lambda at: np.cos(self.transmission(at)).T, grid, periodic=self.design.crank_turns)
        return places[:, ::-1], np.arccos(np.clip(cosines, -1.0, 1.0))[:, ::-1]

    @property
    def title(self) -> str:
        """Title of the problem, with the name of the requirement if there are several."""
        return f"{self.task.title}{self.task.prefix and f': {self.task.prefix[:-1]}'}"

    @cached_property
    def sketch(self) -> Sketch:
        """Sketch of the mechanism, with room for the points."""
        regions = regions_of(self.design.problem, self.design.validation.checks)
        sketch = Sketch(self.motion, regions=regions)
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
    def tolerances(self) -> Array:
        """Tolerances of the points [m]; infinite where there is none."""
        return self.task.data.tolerances

    def angles(self, motion: Motion) -> Array:
        """Return the pose angles of the guided body [rad]."""
        return np.asarray(motion.body_angle(self.task.body).value) + self.design.own[MARK]

    @cached_property
    def size(self) -> float:
        """Extent of the points [m]."""
        extent = np.max(spread(finite(np.concatenate([self.targets, self.generated]))))
        return extent if extent > 0.0 else self.task.size

    @cached_property
    def factor(self) -> float:
        """Magnification of deviations and tolerances in the figures."""
        largest = 0.0 if self.design.exact else np.nanmax(self.design.measured.distances)
        limit = DEVIATION_LENGTH * self.size / largest if largest > 0.0 else math.inf
        tolerances = self.tolerances[np.isfinite(self.tolerances)]
        if tolerances.size:
            distances = np.linalg.norm(np.diff(self.targets, axis=0), axis=1)
            limit = min(limit, 0.45 * np.median(distances) / np.max(tolerances))
        return max(1.0, round_below(limit))


def views(result: SynthesisResult) -> list[DesignView]:
    """Return the best design or the nearest miss, one view for each of its requirements; empty if there is nothing to draw."""
    parts = () if result.best is None else result.best.parts
    return [view for view in (DesignView(part, result.refuted) for part in parts) if view.reached]


def best(result: SynthesisResult) -> DesignView | None:
    """Return the view of the first requirement; None if there is nothing to draw."""
    return next(iter(views(result)), None)


MAX_DIMENSIONS = 14  # largest number of dimensions below a title
TITLE, SMALL = 10.0, 9.5  # font sizes of the title of a figure and of a panel [pt]
NO_BREAK = "\N{NO-BREAK SPACE}"
LINE = 0.17  # line height of a figure title [inch]


def fitting(value: float, unit: Scale) -> Scale:
    """Return the unit of the figure, or a smaller unit for values [m] that are small in it."""
    return unit if value == 0.0 or not math.isfinite(value) or value * unit.factor >= 0.01 else scale(value, "m")


def with_verdict(design: LinkageDesign | None, refuted: str = "") -> tuple[ProblemFile, str] | None:
    """Return a design as a problem with its verdict; None if there is none, or if it has no cycle although only that counts."""
    if design is None or (design.whole.of_cycle and design.analysis is None):
        return None
    why = refuted or why_invalid(design.validation.checks, design.status.text)
    return design.as_problem, verdict(design.status.value, design.valid, why)


def sizes(view: DesignView) -> list[str]:
    """Return the captions of all dimensions, or of the design variables only if there are too many."""
    task, unit, values = view.task, view.sketch.scale, view.design.own
    names = [name for name in task.quantities if name in task.mechanism.quantities or name == MARK]
    if len(names) > MAX_DIMENSIONS:
        names = [name for name in names if not task.quantities[name].fixed]
    if not names or len(names) > MAX_DIMENSIONS:
        return []
    lengths = {name: values[name] * unit.factor for name in names if task.quantities[name].kind != "angle"}
    texts = [f"{name} {f'{lengths[name]:z.{unit.decimals}f}' if name in lengths else degrees(values[name])}" for name in names]
    texts = [text.replace(" -", " −") for text in texts]
    return [f"in {unit.unit}: {texts[0]}", *texts[1:]]


def wrapped(items: Sequence[str], width: float, gap: str, size: float = TITLE) -> str:
    """Join items to lines of similar length that fit a width [inch] at a font size [pt]; items are not broken."""
    text, most = gap.join(item.replace(" ", NO_BREAK) for item in items), max(16, int(72.0 * width / (0.56 * size)))
    wrap = partial(textwrap.wrap, text, break_long_words=False, break_on_hyphens=False)
    lines = next(lines for limit in range(1, most + 1) if len(lines := wrap(limit)) <= len(wrap(most)))
    return "\n".join(lines).replace(NO_BREAK, " ")


def title_of(view: DesignView, width: float, title: str, *more: str) -> str:
    """Compose a title with further lines below it, without empty ones; an invalid design is marked as not valid."""
    lines, fit = marked(title, view.design, view.refuted), view.design.fit
    if view.design.valid and fit is not None and fit.grade == "poor":
        lines.append(fit.text.capitalize())
    return "\n".join([heading("\n".join(lines), width, TITLE), *filter(None, more)])


def mechanism_title(view: DesignView, width: float) -> str:
    """Compose the title of a mechanism with its deviations and dimensions."""
    texts = wrapped(captions(view.design), width, "; "), wrapped(sizes(view), width, "   ")
    return title_of(view, width, view.title, *texts)
