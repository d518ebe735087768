"""Poincaré section of a machine with clearance, taken at the ends of the revolutions."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from optlink.report.style import FOUND, GROUND, QUIET, Scale, figure, heading, scale, styled
from optlink.report.views.revolutions import TITLE, Turns, beside, hold, legend, named, square, turn_axis
from optlink.tasks.results.clearance import ClearanceSimulation

Array = NDArray[np.float64]
PERIODS = 8  # largest period considered [revolutions]
REPEATS = 0.01  # tolerance of a repetition, as a share of the clearance
FEW = 6  # smallest number of revolutions for a decision


def repetition(turns: Turns) -> tuple[int | None, float] | None:
    """Return the period of the motion in revolutions and the largest difference as a share of the clearance.

    The second half of the run is used, at most 200 revolutions. The period is None if the motion does not repeat; the result is
    None if there are too few revolutions.
    """
    result = turns.result
    count = len(next(iter(result.section.values()), ()))
    if count < FEW:
        return None
    places = np.stack([result.section[f"{gap.point}.e{axis}_m"] / gap.clearance for gap in result.gaps for axis in "xy"], axis=1)
    late = places[-min(200, -(-count // 2)) :]
    away = {p: float(np.max(np.abs(late[p:] - late[:-p]))) for p in range(1, min(PERIODS, len(late) // 2) + 1)}
    period = next((p for p, most in away.items() if most < REPEATS), None)
    return period, away[period or 1]


def _verdict(turns: Turns) -> str:
    """Describe whether the motion is periodic and whether it is predictable."""
    found, predicted = repetition(turns), turns.result.prediction
    if turns.free:
        told = "under a given torque these are the ends of nominal periods, not of the crank's revolutions"
    elif found is None:
        told = "too few revolutions to tell whether the motion repeats"
    elif found[0] is None:
        told = "not periodic: the journals' places at the ends of the revolutions do not repeat"
    else:
        after = "every revolution" if found[0] == 1 else f"every {found[0]} revolutions"
        told = f"periodic: the journals' places repeat {after} within {max(found[1], 1e-9):.1g} of the clearance"
    if predicted is not None and predicted.chaotic:
        told += f"; sensitive: runs at two tolerances part after {predicted.parted:.2g} revolutions"
    elif predicted is not None and predicted.watched:
        turned = "revolution" if predicted.watched == 1 else f"{predicted.watched} revolutions"
        told += f"; runs at two tolerances keep together for the {turned} watched"
    return told


@styled
def section(result: ClearanceSimulation) -> Figure | None:
    """Draw the Poincaré section: output deviation and journal positions at the ends of the revolutions."""
    turns = Turns(result)
    if not turns or not result.section:
        return None
    count = len(result.gaps) + 1
    columns = beside(count)
    width = 4.4 * columns
    made = figure(width, 4.1 * -(-count // columns) + 0.9)
    panels = list(made.subplots(-(-count // columns), columns, squeeze=False).flat)
    for axes in panels[count:]:
        axes.remove()
    numbers = result.section["revolution"]
    early = numbers < turns.begin
    size = 4.5 if len(numbers) < 300 else 2.0
    out = result.output
    values = result.section[f"{out.name}.error_{out.unit}"]
    unit = turns.shares(float(np.max(np.abs(values))))

    def points(axes: Axes, x: Array, y: Array) -> None:
        axes.plot(
            x[early],
            y[early],
            "o",
            mfc="white",
            mec=QUIET,
            mew=0.9,
            markersize=size,
            linestyle="none",
            zorder=3,
            label="running-in" if early.any() else None,
            gid="early",
        )
        axes.plot(
            x[~early],
            y[~early],
            "o",
            color=FOUND,
            mew=0.0,
            alpha=0.7,
            markersize=size,
            linestyle="none",
            zorder=4,
            label="end of a revolution",
            gid="late",
        )

    points(panels[0], numbers, values * unit.factor)
    turn_axis(panels[0], float(numbers[0]) - 0.5, float(numbers[-1]) + 0.5)
    hold(panels[0], values * unit.factor, least=0.02)
    panels[0].ticklabel_format(axis="y", useOffset=False)
    panels[0].set_ylabel(f"deviation [{unit.unit}]")
    panels[0].set_title(heading(f"{out.name}: deviation at the end of each revolution", 3.9, 9.5), fontsize=9.5)
    for gap, axes in zip(result.gaps, panels[1:], strict=False):
        shown: Scale = scale(gap.clearance, "m")
        x, y = (result.section[f"{gap.point}.e{axis}_m"] * shown.factor for axis in "xy")
        round_ = gap.clearance * shown.factor
        axes.add_patch(
            Circle(
                (0.0, 0.0),
                round_,
                facecolor="none",
                edgecolor=GROUND,
                linewidth=1.2,
                zorder=2,
                label="clearance",
                gid="clearance",
            )
        )
        axes.plot([0.0], [0.0], "+", color=QUIET, markersize=8, zorder=1)
        points(axes, x, y)
        reach = 1.08 * max(round_, float(np.max(np.hypot(x, y))))
        square(axes, reach, shown)
        axes.set_title(heading(named(gap), 3.9, 9.5), fontsize=9.5)
    made.suptitle(turns.title("Poincaré section", width - 0.4, "", _verdict(turns)), fontsize=TITLE)
    legend(made, *panels[:count])
    return made
