"""Figure of several path synthesis designs side by side."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from optlink.report.labels import Label, place_labels
from optlink.report.style import figure, heading, panels, styled
from optlink.report.views.path_captions import assembly, objective, transmission, wrapped
from optlink.report.views.path_initial_pose import BESIDE, initial_pose, trim
from optlink.report.views.path_tables import kin
from optlink.report.views.path_view import PathView
from optlink.report.views.revolutions import beside
from optlink.tasks.results.path import PathResult

PANELS = 9  # largest number of designs
APART = 4.0  # designs up to this multiple of the smallest size share one scale


@styled
def designs(result: PathResult) -> Figure | None:
    """Draw the distinct designs side by side on one scale and name their cognates."""
    if len(result.designs) < 2:
        return None
    related = kin(result.designs)
    tracks = [PathView(design) for design in result.designs[:PANELS]]
    sizes = np.array([np.ptp(track.sketch.limits, axis=1) / track.sketch.scale.factor for track in tracks])
    reach = sizes.max(axis=1)
    common = sizes[reach <= APART * float(np.min(reach))].max(axis=0)
    columns = beside(len(tracks))
    rows = -(-len(tracks) // columns)
    panel = 3.9 if columns > 2 else 4.6
    tall = min(max(float(common[1] / common[0]), 0.4), 1.5)
    made = figure(panel * columns, ((panel - BESIDE) * tall + 1.35) * rows + 0.4)
    labels: list[Label] = []
    for number, (axes, track) in enumerate(zip(panels(made, len(tracks), columns), tracks, strict=True)):
        labels += initial_pose(axes, track)
        smaller = max(1.0, float(np.max(sizes[number] / common)))
        half = 0.5 * common * smaller * track.sketch.scale.factor
        middle = np.mean(track.sketch.limits, axis=1)
        axes.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]))
        told = [heading(f"{number + 1}: {objective(track)}", panel - 0.3, 9.0), transmission(track.design)]
        told.append(wrapped(assembly(track.design), panel - 0.3, ", ", 9.0))
        if number in related:
            told.append(f"cognate of {related[number] + 1}: the same curve")
        if smaller > 1.0:
            told.append(f"drawn {smaller:.2g} times smaller than the others")
        axes.set_title("\n".join(filter(None, told)), fontsize=9.0)
    count = len(result.designs)
    many = f"{count} distinct designs, best first" + (f"; the first {PANELS}" if count > PANELS else "")
    made.suptitle(heading(f"{tracks[0].task.title}: {many}", panel * columns - 0.4, 10.5), fontsize=10.5)
    trim(made, rows)
    place_labels(made, labels)
    return made
