"""Animation of a mechanism beside a curve with a moving marker."""

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.lines import Line2D
from PIL import Image

from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import TURN, Array
from optlink.report.chart_mpl import draw_into
from optlink.report.chart_spec import ChartSpec
from optlink.report.drawing import Sketch
from optlink.report.fonts import legible
from optlink.report.style import CRANK, figure, heading, one_palette, styled

STACKED_RATIO = 0.42  # ratio of height to width below which the curve is drawn below the mechanism


@styled
def film(
    sketch: Sketch,
    steps: Motion,
    curve: ChartSpec | Callable[[Axes], object],
    marks: Array,
    titles: Sequence[str],
    *,
    more: Callable[[Axes], object] | None = None,
) -> list[Image.Image]:
    """Draw every position of a motion, one frame each with a common palette, beside a curve with a moving marker.

    `curve` is a chart, or draws itself into axes; `marks` (frames, 2) are the places of the marker there, NaN for none; `more`
    draws further fixed parts into the axes of the mechanism.
    """
    flat = sketch.ratio < STACKED_RATIO
    if flat:
        fig = figure(7.8, 7.2 * sketch.ratio + 3.0)
        stage, strip = fig.subplots(2, 1, height_ratios=(7.2 * sketch.ratio + 0.5, 1.9))
    else:
        fig = figure(8.4, min(max(4.3 * sketch.ratio + 0.9, 3.5), 5.2))
        stage, strip = fig.subplots(1, 2, width_ratios=(1.25, 1.0))
    fig.set_dpi(80)
    canvas = FigureCanvasAgg(fig)
    sketch.stage(stage)
    if more:
        more(stage)
    draw_into(strip, curve) if isinstance(curve, ChartSpec) else curve(strip)
    mark = Line2D([], [], linestyle="none", marker="o", markersize=7, color=CRANK, zorder=8, animated=True)
    strip.add_artist(mark)
    fig.suptitle("\n".join(heading(title, fig.get_figwidth(), 10.0) for title in titles), fontsize=10)
    legible(fig)
    canvas.draw()  # all that stands still is drawn once
    fig.set_layout_engine("none")
    still = canvas.copy_from_bbox(fig.bbox)
    pictures = []
    for k in range(len(steps.crank_angle)):
        canvas.restore_region(still)
        moving = sketch.pose(stage, steps, k)
        for artist in sorted(moving, key=lambda item: item.get_zorder()):
            artist.set_animated(True)
            stage.draw_artist(artist)
            artist.remove()
        mark.set_data([marks[k, 0]], [marks[k, 1]])
        strip.draw_artist(mark)
        buffer = canvas.buffer_rgba()
        pictures.append(np.array(np.asarray(buffer)[..., :3]))
    return one_palette(pictures)


def there_and_back(low: float, high: float, count: int) -> Array:
    """Return crank angles [rad] that swing smoothly through a range and back."""
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    return np.asarray(middle - half * np.cos(np.linspace(0.0, TURN, count, endpoint=False)))
