"""A sweep as files: result.json, and the objective and the designs over one parameter, or a map of the objective over two."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from optlink.report.store import write_json
from optlink.report.style import BODIES, FOUND, LIMIT, QUIET, figure, heading, save, styled
from optlink.studies.sweep import CHANGED, Sweep

LARGE = 200_000  # points that are drawn at most


def write_all(result: Sweep, folder: Path) -> list[Path]:
    """Write result.json and the picture (if the sweep has one or two parameters); the table is there already."""
    written = [folder / "result.json"]
    write_json(written[0], result.to_dict())
    if len(result.grid.axes) <= 2 and result.grid.count <= LARGE:
        written.append(folder / "sweep.png")
        save(picture(result), written[-1])
    return written


@styled
def picture(result: Sweep) -> Figure:
    """Curves over one parameter, a map over two."""
    return _curves(result) if len(result.grid.axes) == 1 else _map(result)


def _objective(result: Sweep) -> str:
    fallback = result.names[len(result.grid.axes)]
    return next((name for name in result.names if name.startswith("objective")), fallback)


def _name(column: str) -> str:
    """A column's name as people read it: the unit in brackets."""
    name, _, unit = column.rpartition("_")
    return f"{name} [{unit}]" if name else column


def _curves(result: Sweep) -> Figure:
    columns, axis = result.columns, result.grid.axes[0]
    x, objective = columns[axis.column], _objective(result)
    designs = [] if result.analysed else list(result.names[1 : result.names.index(objective)])
    drawn = figure(8.0, 6.0 if designs else 4.0)
    panels: Any = drawn.subplots(2 if designs else 1, 1, sharex=True, squeeze=False)[:, 0]
    names = (
        [name for name in result.names[1:] if name.startswith(objective.rpartition(".")[0])] if result.analysed else [objective]
    )
    for name, colour in zip(names, (FOUND, *BODIES[1:]), strict=False):
        panels[0].plot(x, columns[name], color=colour, label=name)
    if result.analysed:
        panels[0].set_ylabel("over the revolution")
        panels[0].legend(frameon=False)
    else:
        panels[0].set_ylabel(_name(objective))
        for name, colour in zip(designs, BODIES, strict=False):
            panels[1].plot(x, columns[name], color=colour, label=_name(name))
        panels[1].legend(frameon=False)
        bad = ~columns["valid"]
        panels[0].plot(x[bad], columns[objective][bad], "x", color=LIMIT)
        for panel in panels:
            for at in x[columns[CHANGED]]:
                panel.axvline(at, color=QUIET, linestyle=":", linewidth=1.0)
    panels[-1].set_xlabel(f"{axis.key} [{axis.unit}]" if axis.unit else axis.key)
    ending = " (dotted: other limits begin to hold)" if result.changed else ""
    panels[0].set_title(heading(f"{result.problem.model.title}: over {axis.key}{ending}", 8.0), loc="left")
    return drawn


def _map(result: Sweep) -> Figure:
    slow, fast = result.grid.axes
    name = _objective(result)
    values = result.columns[name].reshape(len(slow.values), len(fast.values))
    drawn = figure(8.0, 5.6)
    axes = drawn.add_subplot()
    shaded = axes.pcolormesh(fast.values, slow.values, np.ma.masked_invalid(values), shading="nearest", cmap="viridis")
    drawn.colorbar(shaded, ax=axes, label=_name(name))
    if CHANGED in result.columns:
        marked = np.argwhere(result.columns[CHANGED].reshape(values.shape))
        axes.plot(np.asarray(fast.values)[marked[:, 1]], np.asarray(slow.values)[marked[:, 0]], ".", color="white", markersize=3)
    for axis, put in ((fast, axes.set_xlabel), (slow, axes.set_ylabel)):
        put(f"{axis.key} [{axis.unit}]" if axis.unit else axis.key)
    axes.grid(visible=False)
    ending = " (white: other limits begin to hold)" if result.changed else ""
    axes.set_title(heading(f"{result.problem.model.title}{ending}", 8.0), loc="left")
    return drawn
