"""View of a synthesised design of any linkage: pictures by kind of requirement, tables, animation."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from PIL import Image

from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import TURN
from optlink.presentation.chart_spec import CRANK, TARGET, Array, ChartSpec
from optlink.presentation.drawing import Sketch, film, there_and_back
from optlink.presentation.format import marked
from optlink.presentation.style import styled
from optlink.presentation.view import View
from optlink.presentation.views import conclusions, dyad_curves
from optlink.presentation.views.design_charts import (
    CloseUp,
    dots,
    errors,
    law,
    output,
    output_film,
    points_on,
    small_frames,
    transmission,
)
from optlink.presentation.views.design_cycle import beside_initial, courses
from optlink.presentation.views.design_drawings import at_positions, beside_curve, designs
from optlink.presentation.views.design_tables import design_result, words_of
from optlink.presentation.views.design_view import DesignView, best, views, with_verdict
from optlink.presentation.views.objective_map import objective_map
from optlink.presentation.views.search_tables import certificate_charts, limits
from optlink.tasks.results.design import SynthesisResult

FRAMES = 90
MAX_BRIEF = 10  # limits on the short page
HIGHLIGHT = "#ffc20a"


class Passing(Sketch):
    """Sketch of a mechanism that highlights the precision points it has passed."""

    def __init__(self, view: DesignView) -> None:
        super().__init__(view.motion)
        self.widen(view.targets * self.scale.factor)
        self.track, self.close = view, CloseUp(view)
        self.strip: Axes | None = None

    def lay(self, axes: Axes) -> None:
        """Draw the close-up of the curve, in which passed points are highlighted too."""
        self.strip = axes
        self.close.draw(axes, None)

    def pose(self, axes: Axes, motion: Motion, k: int = 0) -> list[Artist]:
        """Draw position `k`, the points passed so far and the pose of the guided body."""
        artists = super().pose(axes, motion, k)
        view = self.track
        assert self.strip is not None
        passed = view.direction * (motion.crank_angle[k] - view.design.crank_angles) >= -1e-9
        for place, factor in ((axes, self.scale.factor), (self.strip, self.close.unit.factor)):
            x, y = (view.targets[passed] * factor).T
            size = dots(len(view.targets)) + 1.0
            lit = Line2D(
                x, y, linestyle="none", marker="o", markersize=size, color=HIGHLIGHT, mec=TARGET, mew=0.6, zorder=6, gid="lit"
            )
            more = [lit]
            if self.close.motion:
                length = self.close.length * factor / self.close.unit.factor
                frame = small_frames(view.position(motion)[k : k + 1] * factor, view.angles(motion)[k : k + 1], length)
                more.append(Line2D(*frame.T, color=CRANK, linewidth=1.8, zorder=7, gid="pose"))
            for artist in more:
                place.add_artist(artist)
            artists += more
        return artists


def _passing_film(view: DesignView, steps: Array, titles: Sequence[str]) -> list[Image.Image]:
    """Draw the frames of the mechanism at crank angles [rad] beside the close-up of its curve."""
    sketch, motion = Passing(view), view.sweep(steps)
    marks = view.position(motion) * sketch.close.unit.factor

    def points(axes: Axes) -> None:
        points_on(axes, view.targets * sketch.scale.factor)

    return film(sketch, motion, sketch.lay, marks, titles, more=points)


class Pictures(NamedTuple):
    """Pictures of a kind of requirement: its charts, and the frames of the animation at crank angles."""

    charts: Callable[[DesignView], list[ChartSpec]]
    film: Callable[[DesignView, Array, Sequence[str]], list[Image.Image]]


POINTS = Pictures(lambda view: [CloseUp(view).chart(), *errors(view)], _passing_film)
PICTURES = {
    "function": Pictures(law, output_film),
    "path": POINTS,
    "motion": POINTS,
    "position": Pictures(lambda _: [], output_film),
    "transmission": Pictures(output, output_film),
}
"""Pictures by kind of requirement."""


def charts(result: SynthesisResult) -> list[ChartSpec]:
    """Return the charts of requirements, transmission angle, quantities of the machine, and of the global search."""
    shown, model, best_design = views(result), result.problem.model, result.best
    specs = [chart for view in shown for chart in PICTURES[view.task.requirement.family].charts(view)]
    specs += [*dyad_curves.charts(result, shown), *(chart for view in shown[:1] for chart in transmission(view))]
    specs += [] if best_design is None else courses(best_design)
    values, mode = ({}, "") if best_design is None else (best_design.values if best_design.valid else {}, best_design.assembly)
    return specs + certificate_charts(result.certificate, model.title, model.shown_objective, values, mode, model.display)


@styled
def frames(result: SynthesisResult, count: int = FRAMES) -> list[Image.Image]:
    """Draw the frames of the best design in motion: one revolution, or back and forth over the range that can be reached."""
    view = best(result)
    if view is None:
        return []
    steps = view.begin + view.direction * np.linspace(0.0, TURN, count, endpoint=False)
    if not view.turns:
        ends = view.run if view.task.pointed else view.motion
        steps = there_and_back(ends.crank_angle[0], ends.crank_angle[-1], count)
    titles = marked(view.task.title, view.design, view.refuted)
    return PICTURES[view.task.requirement.family].film(view, steps, titles)


def tables(result: SynthesisResult) -> dict[str, Mapping[str, Array]]:
    """Return the columns of points.csv, of several requirements one for each with its name; without targets of cycle.csv."""
    parts = () if result.best is None else result.best.parts
    if result.best is not None and result.best.whole.of_cycle:
        return {} if result.best.analysis is None else {"cycle": result.best.analysis.columns}
    return {f"points{part.task.prefix and f'-{part.task.prefix[:-1]}'}": words_of(part).columns(part) for part in parts}


def conclusion(result: SynthesisResult) -> str:
    """Return the conclusion, with the active limit that has the largest price."""
    best = result.best
    return conclusions.design(result, () if best is None or best.solution is None else best.solution.displayed_limits)


VIEW = View(
    design_result,
    conclusion,
    charts=charts,
    drawings={
        **{"path": beside_curve, "mechanism": at_positions, "mechanisms": beside_initial},
        **{"map": objective_map, "designs": designs},
    },
    tables=tables,
    design=lambda result: with_verdict(result.best, result.refuted),
    frames=frames,
    achieved=conclusions.achieved,
    limits=lambda result: [] if result.best is None else limits(result.best.validation.checks, MAX_BRIEF),
)
