"""Files and figure of a Pareto front: one curve for two objectives, three projections for three."""

from __future__ import annotations

import csv
import itertools
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from optlink.report.files import whole, write_json
from optlink.report.labels import Label, place_labels
from optlink.report.style import FOUND, LIMIT, QUIET, WANTED, figure, heading, save, styled
from optlink.report.views.pareto_tables import against
from optlink.studies.pareto.epsilon_constraint import Pareto


def write_all(result: Pareto, folder: Path) -> list[Path]:
    """Write result.json, the front as front.csv, and its figure if it has two points; return the paths.

    The table of all solved points exists already.

    Parameters
    ----------
    result : Pareto
    folder : Path
        Existing folder to write to.
    """
    written = [folder / "result.json", folder / "front.csv"]
    write_json(written[0], result.to_dict())
    columns = result.columns
    with whole(written[1]) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow([repr(cell) if isinstance(cell, float) else cell for cell in row])
    if len(result.points) > 1:
        written.append(folder / "front.png")
        save(picture(result), written[-1])
    return written


@styled
def picture(result: Pareto) -> Figure:
    """Draw the front with its end points, its knee and the reference design."""
    pairs = list(itertools.combinations(range(len(result.aims)), 2))
    width, height = (7.6, 5.2) if len(pairs) == 1 else (13.0, 4.9)
    made = figure(width, height)
    panels: Any = made.subplots(1, len(pairs), squeeze=False)[0]
    labels = [label for panel, pair in zip(panels, pairs, strict=True) for label in _panel(result, panel, *pair)]
    words = ", ".join(aim.name for aim in result.aims)
    made.suptitle(heading(f"{result.problem.model.title}: {words}", 0.95 * width), fontsize=11)
    place_labels(made, labels)
    return made


def _panel(result: Pareto, axes: Axes, x: int, y: int) -> list[Label]:
    values = np.array([point.values for point in result.points])
    two = len(result.aims) == 2
    if two:
        axes.plot(values[:, x], values[:, y], "o-", color=FOUND, linewidth=1.6, markersize=4.0, zorder=3, gid="front")
        chord = values[list(result.ends)]
        axes.plot(chord[:, x], chord[:, y], "--", color=QUIET, linewidth=1.0, zorder=2, gid="chord")
    else:
        third = next(k for k in range(3) if k not in (x, y))
        drawn = axes.scatter(values[:, x], values[:, y], c=values[:, third], cmap="viridis", s=22.0, zorder=3, gid="front")
        axes.plot(values[:, x], values[:, y], "o", color="none", markersize=4.7, gid="kept clear of labels")
        colours: Any = axes.get_figure()
        colours.colorbar(drawn, ax=axes, label=_named(result, third), pad=0.02)
    labels = []
    for k, point in enumerate(result.points):
        if not point.mark:
            continue
        at = (float(values[k, x]), float(values[k, y]))
        axes.plot(*at, "o", color=LIMIT, markersize=7.0, markerfacecolor=LIMIT if two else "none", zorder=5, gid=point.mark)
        text = point.mark.replace(", ", ",\n")
        if two and result.given is not None:
            changes = [against(value, before) for value, before in zip(point.values, result.given, strict=True)]
            text += f"\n{', '.join(filter(None, changes))}"
        labels.append(Label(axes, at, text, LIMIT, 8.5 if two else 7.5, 4.0, _outward(result, x, y)))
    if result.given is not None:
        at = (result.given[x], result.given[y])
        axes.plot(*at, "s", color=WANTED, markersize=6.0, zorder=5, gid="given")
        labels.append(Label(axes, at, result.given_words, WANTED, 8.5, 4.0))
    axes.set_xlabel(_named(result, x))
    axes.set_ylabel(_named(result, y))
    axes.margins(x=0.12, y=0.14)
    return labels


def _outward(result: Pareto, x: int, y: int) -> tuple[float, float]:
    """Return the label direction that points to worse objectives, away from the unattainable side of the front."""
    return 0.7 * result.aims[x].sense, 0.7 * result.aims[y].sense


def _named(result: Pareto, k: int) -> str:
    aim = result.aims[k]
    arrow = "" if aim.sense > 0 else " (more is better)"
    return f"{aim.name} [{aim.unit.replace('*', ' ').replace('^2', '²')}]{arrow}" if aim.unit else f"{aim.name}{arrow}"
