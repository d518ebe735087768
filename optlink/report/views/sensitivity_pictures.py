"""Files and tornado chart of the sensitivities of an optimum to its fixed parameters."""

from __future__ import annotations

import math
from pathlib import Path

from matplotlib.figure import Figure

from optlink.report.files import whole, write_json
from optlink.report.style import FOUND, LIMIT, QUIET, figure, heading, save, styled
from optlink.report.views.study_tables import step
from optlink.studies.sensitivity import Sensitivities

MANY, SEEN = 14, 1e-3  # largest number of bars, and smallest bar as a share of the largest


def write_all(result: Sensitivities, folder: Path) -> list[Path]:
    """Write result.json, sensitivity.csv and the tornado chart (if any parameter has an effect); return the paths.

    Parameters
    ----------
    result : Sensitivities
    folder : Path
        Existing folder to write to.
    """
    written = [folder / "result.json", folder / "sensitivity.csv"]
    write_json(written[0], result.to_dict())
    write_table(result, written[1])
    if result.moving:
        written.append(folder / "tornado.png")
        save(tornado(result), written[-1])
    return written


def write_table(result: Sensitivities, path: Path) -> None:
    """Write a CSV table with one row for each parameter, in full precision.

    Parameters
    ----------
    result : Sensitivities
    path : Path
        File to write.
    """
    import csv

    with whole(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        names = [f"{name}_{unit}_per_unit" for name, unit in result.units.items()]
        writer.writerow(["key", "name", "value", "unit", "step", "objective_per_unit", *names, "valid_from", "valid_to"])
        for row in result.rows:
            p = row.parameter
            numbers = [p.step, row.objective, *row.design.values(), row.below.value, row.above.value]
            writer.writerow(
                [p.key, p.name, repr(p.value), p.unit, *(repr(float(n)) if math.isfinite(n) else "" for n in numbers)]
            )


@styled
def tornado(result: Sensitivities) -> Figure:
    """Draw bars of the change of the objective by one step of each parameter, up and down."""
    least = SEEN * max(abs(row.effect) for row in result.moving)
    rows = [row for row in result.moving if abs(row.effect) >= least][:MANY]
    base = result.solution.objective
    relative = base > 0.0
    drawn = figure(8.0, 1.5 + 0.5 * len(rows))
    axes = drawn.add_subplot()
    places = range(len(rows), 0, -1)
    for place, row in zip(places, rows, strict=True):
        effect = 100.0 * row.effect / base if relative else row.effect
        axes.barh(place, effect, height=0.34, color=FOUND if effect < 0.0 else LIMIT)
        axes.barh(place - 0.34, -effect, height=0.26, color=FOUND if effect > 0.0 else LIMIT, alpha=0.45)
    labels = [
        f"{row.parameter.key}  ({row.parameter.value:.5g} {row.parameter.unit}".rstrip() + f", {step(row)})" for row in rows
    ]
    axes.set_yticks([place - 0.15 for place in places], labels)
    axes.axvline(0.0, color=QUIET, linewidth=1.0)
    axes.grid(axis="y", visible=False)
    unit = "%" if relative else result.unit
    axes.set_xlabel(
        f"change of the objective [{unit}], to first order\nsolid: one step more, pale: one step less; left is better"
    )
    drawn.suptitle(heading(f"{result.problem.model.title}: what matters", 8.0), x=0.01, ha="left", fontsize=11)
    return drawn
