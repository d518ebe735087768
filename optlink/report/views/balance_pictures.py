"""Files and figures of a balancing result: before and after, counterweights to scale, trade-off."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from optlink.dynamics.counterweights import BalanceMeasure, quantities
from optlink.linkage.motion import sweep
from optlink.problem.fixed_design import fixed_design
from optlink.problem.mechanism import sizes_of
from optlink.report.drawing import Sketch
from optlink.report.files import verdict, write_csv, write_design, write_json
from optlink.report.format import change
from optlink.report.labels import Label, place_labels
from optlink.report.style import BODIES, CRANK, FOUND, LIMIT, QUIET, ROCKER, WANTED, Scale, figure, heading, save, scale, styled
from optlink.tasks.results.balance import AddedCounterweight, Balance

Array = NDArray[np.float64]
GIVEN = "#8a8a8a"
COMMON = ("shaking force", "shaking moment", "driving torque")


def write_all(result: Balance, folder: Path) -> list[Path]:
    """Write result.json, the tables, the balanced machine as design.toml and the applicable figures; return the paths.

    Parameters
    ----------
    result : Balance
    folder : Path
        Existing folder to write to.
    """
    written = [folder / "result.json", folder / "balance.csv"]
    write_json(written[0], result.to_dict())
    write_csv(written[1], result.columns)
    if result.balanced is not None:
        sizes = sizes_of(result.balanced.model.quantities)
        machine = fixed_design(result.balanced, sizes) if result.balanced.model.free else result.balanced
        written += write_design(folder, machine, verdict(result.status, result.valid, result.status))
    if result.trade is not None:
        trade, points = result.trade, result.trade.points
        written.append(folder / "trade.csv")
        columns = {
            f"{m}_{m.unit}".replace(" ", "_"): [p.made[k] for p in points] for k, m in enumerate((trade.first, trade.second))
        }
        bodies = [weight.asked.body for weight in result.added] + [b for p in points for b in p.masses]
        masses = {f"{body}_kg": [point.masses.get(body, 0.0) for point in points] for body in dict.fromkeys(bodies)}
        write_csv(written[-1], {**columns, "rate": [p.rate for p in points], "gap": [p.gap for p in points], **masses})
    for name, draw in PICTURES.items():
        drawn = draw(result)
        if drawn is not None:
            written.append(folder / f"{name}.png")
            save(drawn, written[-1])
    return written


def _title(result: Balance, what: str, width: float) -> str:
    return heading(f"{result.problem.model.title}: {what}", width)


# --- curves ----------------------------------------------------------------------------------------------------------------


def _amounts(result: Balance, measure: BalanceMeasure, when: str) -> Array:
    """Return the magnitude of a force or the value of a torque at the positions [SI]."""
    stem = f"{when}.{measure.quantity.replace(' at ', '_').replace(' ', '_')}"
    unit = measure.unit.replace(" ", "")
    if f"{stem}_x_{unit}" in result.columns:
        return np.hypot(result.columns[f"{stem}_x_{unit}"], result.columns[f"{stem}_y_{unit}"])
    return result.columns[f"{stem}_{unit}"]


def _shown(result: Balance) -> list[BalanceMeasure]:
    """Return the measures to plot: shaking force and moment, driving torque, and the minimised or limited reactions."""
    asked = [measure for measure, _ in result.goal] + _limited(result)
    found = [BalanceMeasure(kind) for kind in COMMON]  # type: ignore[arg-type]
    for measure in asked:
        bare = next(q for q in quantities(result.machine) if _same(q, measure, result))
        if bare not in found:
            found.append(bare)
    return found


def _limited(result: Balance) -> list[BalanceMeasure]:
    section = result.problem.model.balance
    return [] if section is None else [ceiling.measure for ceiling in section.limits.values()]


def _same(bare: BalanceMeasure, measure: BalanceMeasure, result: Balance) -> bool:
    from optlink.dynamics.inverse import reported_on

    if bare.kind != measure.kind or bare.joint != measure.joint:
        return False
    return not bare.on or bare.on == (measure.on or reported_on(result.machine)[measure.joint])


@styled
def before_after(result: Balance) -> Figure | None:
    """Draw shaking force and moment, driving torque and selected reactions over the crank angle, before and after."""
    if result.heavier is None:
        return None
    shown = _shown(result)
    columns = 2 if len(shown) > 3 else 1
    rows = -(-len(shown) // columns)
    width = 7.8 * (1.0 if columns == 1 else 1.55)
    made = figure(width, 2.5 * rows + 1.0)
    panels = list(made.subplots(rows, columns, squeeze=False, sharex=True).flat)
    x = np.append(result.columns["crank_angle_deg"], np.nan)
    full = abs(abs(x[-2] - x[0]) + abs(x[1] - x[0]) - 360.0) < 1e-6
    if full:
        x[-1] = x[0] + math.copysign(360.0, x[1] - x[0])
    for axes, measure in zip(panels, shown, strict=False):
        old, new = (_amounts(result, measure, when) for when in ("before", "after"))
        unit = scale(float(np.max(np.abs([old, new]))), measure.unit)
        names = _values(measure, old, new, unit)
        for values, colour, thick, name in ((old, GIVEN, 1.3, "given"), (new, _colour(measure), 2.1, "balanced")):
            line = np.append(values, values[0] if full else np.nan) * unit.factor
            axes.plot(x, line, color=colour, linewidth=thick, label=names[name], gid=f"{name} {measure.quantity}", zorder=3)
        for limit in result.limits:
            if limit.name.startswith("largest") and limit.name == f"largest {measure.quantity}":
                for sign in (1.0,) if measure.unit == "N" else (1.0, -1.0):
                    axes.axhline(
                        sign * limit.bound * unit.factor, color=LIMIT, linewidth=1.1, linestyle="--", zorder=2, gid="limit"
                    )
        if measure.kind in ("shaking force", "reaction") and np.min([old, new]) >= 0.0:
            axes.set_ylim(bottom=0.0)
        low, high = axes.get_ylim()
        if low < 0.0 < high:
            axes.axhline(0.0, color=QUIET, linewidth=0.8, zorder=1)
        axes.set_ylabel(f"{measure.quantity}\n[{unit.unit}]")
        axes.legend(frameon=False, fontsize=8.5, loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, borderpad=0.1)
        axes.set_xlim(x[0], x[-1] if full else x[-2])
        if full:
            axes.xaxis.set_major_locator(MultipleLocator(60.0))
    for axes in panels[len(shown) :]:
        axes.remove()
    for axes in panels[max(0, len(shown) - columns) : len(shown)]:
        axes.set_xlabel("crank angle φ [deg]")
        axes.tick_params(labelbottom=True)
    made.suptitle(_title(result, f"least {result.measure}", width), fontsize=11)
    return made


def _colour(measure: BalanceMeasure) -> str:
    return {"shaking force": FOUND, "shaking moment": BODIES[3], "driving torque": CRANK}.get(measure.kind, ROCKER)


def _values(measure: BalanceMeasure, old: Array, new: Array, unit: Scale) -> dict[str, str]:
    rms = [float(np.sqrt(np.mean(values * values))) for values in (old, new)]
    told = change(rms[1] / rms[0] - 1.0) if rms[0] > 0.0 else ""
    shown = [unit.text(value) if value > 1e-12 * rms[0] else "0" for value in rms]
    return {"given": f"given: rms {shown[0]}", "balanced": f"balanced: {shown[1]} ({told})"}


@styled
def hodograph(result: Balance) -> Figure | None:
    """Draw the hodograph of the shaking force over a revolution before and after balancing, with equal scales."""
    if result.heavier is None:
        return None
    paths = {
        when: np.stack([result.columns[f"{when}.shaking_force_{axis}_N"] for axis in "xy"], axis=-1)
        for when in ("before", "after")
    }
    unit = scale(float(np.max(np.abs(paths["before"]))), "N")
    every = np.concatenate([*paths.values(), np.zeros((1, 2))])
    ratio = float(np.ptp(every[:, 1]) / max(float(np.ptp(every[:, 0])), 1e-300))
    made = figure(7.2, 6.2 * min(max(ratio, 0.4), 1.3) + 1.6)
    axes = made.subplots()
    labels: list[Label] = []
    for when, colour, width, name in (("before", GIVEN, 1.4, "given"), ("after", FOUND, 2.1, "balanced")):
        path = paths[when] * unit.factor
        closed = np.concatenate([path, path[:1]])
        most = float(np.max(np.linalg.norm(paths[when], axis=1)))
        told = unit.text(most) if most > 1e-12 * float(np.max(np.abs(paths["before"]))) else "0"
        axes.plot(*closed.T, color=colour, linewidth=width, zorder=3, label=f"{name}: at most {told}", gid=f"hodograph {name}")
        if most * unit.factor < 0.02 * float(np.max(np.abs(paths["before"]))) * unit.factor:
            axes.plot(*np.mean(path, axis=0), "o", color=colour, markersize=6, zorder=4)
            continue  # degenerates to a point: no crank angles to mark
        middle = np.mean(path, axis=0)
        for turned in range(0, 360, 60):
            k = int(np.argmin(np.abs(np.mod(result.columns["crank_angle_deg"] - turned + 180.0, 360.0) - 180.0)))
            axes.plot(*path[k], "o", color=colour, markersize=4, zorder=4)
            away = path[k] - middle
            away = away / max(float(np.linalg.norm(away)), 1e-30)
            labels.append(
                Label(
                    axes, (float(path[k, 0]), float(path[k, 1])), f"{turned}°", colour, 8.5, 2.5, (float(away[0]), float(away[1]))
                )
            )
    axes.plot([0.0], [0.0], "+", color=WANTED, markersize=10, zorder=5)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.1)
    axes.set(xlabel=f"shaking force in x [{unit.unit}]", ylabel=f"shaking force in y [{unit.unit}]")
    made.legend(frameon=False, fontsize=9, loc="outside lower center", ncols=2)
    axes.set_title(_title(result, "shaking force, crank angle marked", 6.4), fontsize=10.5)
    place_labels(made, labels)
    return made


# --- machine ------------------------------------------------------------------------------------------------------------------


@styled
def mechanism(result: Balance) -> Figure | None:
    """Draw the machine with its counterweights to scale: discs solid, other shapes dashed with their radius of gyration."""
    if result.heavier is None:
        return None
    machine = result.heavier
    sketch = Sketch(sweep(machine.mechanism, machine.sizes, result.angles, result.speed), machine)
    for one in result.added:
        size = _size(one, sketch)
        track = sketch.placed(sketch.motion, one.body, _centre(one, sketch))[:, 0]
        corners = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]) * size
        sketch.widen((track[:, None, :] + corners).reshape(-1, 2))
    start = result.problem.model.drive.start.value
    turn = math.copysign(2.0 * math.pi, result.speed)
    full = len(result.angles) == (result.problem.model.balance.positions if result.problem.model.balance else 0)
    places = [start, start + 0.5 * turn] if full else [float(result.angles[0]), float(result.angles[-1])]
    panel = 5.2
    made = figure(2.0 * panel, (panel - 0.7) * min(max(sketch.ratio, 0.35), 1.4) + 1.4)
    labels: list[Label] = []
    panels = list(made.subplots(1, 2, sharey=True))
    for axes in panels:
        sketch.stage(axes)
    for axes, at in zip(panels, places, strict=True):
        here = sweep(machine.mechanism, machine.sizes, np.array([at]), result.speed)
        for one in result.added:
            _disc(axes, sketch, one, sketch.placed(here, one.body, _centre(one, sketch))[0, 0])
            track = sketch.placed(sketch.motion, one.body, _centre(one, sketch))[:, 0]
            axes.plot(*track.T, color=sketch.colours[one.body], linewidth=0.8, linestyle=":", zorder=1, gid=f"track {one.body}")
        sketch.pose(axes, here)
        labels += sketch.letters(axes, here)
        axes.set_title(f"φ {math.degrees(at) % 360.0:.4g}°", fontsize=9.5)
    handles, words = sketch.legend()
    made.legend(handles, words, loc="outside lower center", ncols=min(len(handles), 9), frameon=False, fontsize=8.5)
    made.suptitle(_title(result, "counterweights to scale", 2.0 * panel), fontsize=11)
    made.draw_without_rendering()  # computes the layout, so that sizes in the figure are known
    for axes, at in zip(panels, places, strict=True):
        here = sweep(machine.mechanism, machine.sizes, np.array([at]), result.speed)
        labels += [_told(axes, sketch, one, sketch.placed(here, one.body, _centre(one, sketch))[0, 0]) for one in result.added]
    place_labels(made, labels)
    return made


def _centre(one: AddedCounterweight, sketch: Sketch) -> Array:
    return np.array([one.place]) * sketch.scale.factor


def _size(one: AddedCounterweight, sketch: Sketch) -> float:
    """Return the radius to draw, in the display unit."""
    return (one.radius if one.radius is not None else one.gyration) * sketch.scale.factor


def _disc(axes: Axes, sketch: Sketch, one: AddedCounterweight, centre: Array) -> None:
    """Draw a counterweight."""
    colour, disc = sketch.colours[one.body], one.radius is not None
    face, place = (*to_rgb(colour), 0.30 if disc else 0.10), (float(centre[0]), float(centre[1]))
    shape = Circle(place, _size(one, sketch), facecolor=face, edgecolor=colour)
    shape.set(linewidth=1.6, linestyle="-" if disc else "--", zorder=2.5, gid=f"counterweight {one.body}")
    axes.add_patch(shape)


def _told(axes: Axes, sketch: Sketch, one: AddedCounterweight, centre: Array) -> Label:
    """Label a counterweight with its mass and size."""
    shown = 2.0 * one.radius if one.radius is not None else one.gyration
    text = f"{one.body}: {one.mass:.4g} kg\n{'∅' if one.radius is not None else 'gyration'} {scale(shown, 'm').text(shown)}"
    ends = axes.transData.transform(np.array([centre, centre + np.array([_size(one, sketch), 0.0])]))
    drawn = axes.get_figure()
    assert drawn is not None
    clear = float(np.linalg.norm(ends[1] - ends[0])) * 72.0 / drawn.dpi
    return Label(axes, (float(centre[0]), float(centre[1])), text, sketch.colours[one.body], 8.5, clear)


# --- trade-off -------------------------------------------------------------------------------------------------------------


@styled
def trade(result: Balance) -> Figure | None:
    """Draw the trade-off curve with its end points, its knee and the unbalanced machine; below it the counterweight masses."""
    found = result.trade
    if found is None or len(found.points) < 2:
        return None
    first, second = found.first, found.second
    units = [
        scale(max([before, *(p.made[k] for p in found.points)]), m.unit)
        for k, (m, before) in enumerate(zip((first, second), found.before, strict=True))
    ]
    bodies = list(dict.fromkeys(body for point in found.points for body in point.masses))
    made = figure(7.6, 7.4 if bodies else 5.2)
    grid = made.subplots(2 if bodies else 1, 1, squeeze=False, sharex=True, height_ratios=(2.0, 1.0) if bodies else (1.0,))[:, 0]
    axes = grid[0]
    bound = np.array([[p.first, p.second] for p in found.points]) * [u.factor for u in units]
    real = np.array([p.made for p in found.points]) * [u.factor for u in units]
    axes.fill_between(bound[:, 0], bound[:, 1], float(np.min(bound[:, 1])), color="#eeeeee", zorder=1, gid="out of reach")
    axes.plot(*bound.T, "-", color=FOUND, linewidth=1.8, zorder=3, label="proven bound", gid="bound")
    axes.plot(*real.T, "o", color=FOUND, markersize=4.0, zorder=4, label="designs, by inverse dynamics", gid="made")
    given = np.array(found.before) * [u.factor for u in units]
    axes.plot(*given, "s", color=WANTED, markersize=6.5, zorder=5, label="given machine", gid="given")
    labels = [Label(axes, (float(given[0]), float(given[1])), "given machine", WANTED, 9.0, 4.0)]
    marks = {0: f"least {first.quantity}", len(found.points) - 1: f"least {second.quantity}"}
    if found.knee is not None:
        marks[found.knee] = "knee"
    for k, name in marks.items():
        shares = [change(v / b - 1.0) for v, b in zip(found.points[k].made, found.before, strict=True)]
        axes.plot(*real[k], "o", color=LIMIT, markersize=7.0, zorder=5, gid=name)
        text = f"{name}\n{_short(first)} {shares[0]}, {_short(second)} {shares[1]}"
        labels.append(Label(axes, (float(real[k, 0]), float(real[k, 1])), text, LIMIT, 8.5, 4.0, (0.7, 0.7)))
    axes.set_ylabel(f"{second} [{units[1].unit}]")
    axes.margins(x=0.08, y=0.14)
    axes.legend(frameon=False, fontsize=8.5, loc="upper right")
    crank = result.machine.mechanism.crank.body
    others = [body for body in result.machine.mechanism.bodies if body != crank]
    colours = {crank: CRANK} | {body: BODIES[k % len(BODIES)] for k, body in enumerate(others)}
    for body in bodies:
        colour = colours[body]
        masses = [point.masses.get(body, 0.0) for point in found.points]
        grid[1].plot(real[:, 0], masses, ".-", color=colour, linewidth=1.3, markersize=5, label=body, gid=f"mass {body}")
    if bodies:
        grid[1].set_ylabel("mass [kg]")
        grid[1].set_ylim(bottom=0.0)
        grid[1].legend(frameon=False, fontsize=8.5, loc="best", ncols=3)
    grid[-1].set_xlabel(f"{first} [{units[0].unit}]")
    made.suptitle(_title(result, "what one costs in the other", 7.2), fontsize=11)
    place_labels(made, labels)
    return made


def _short(measure: BalanceMeasure) -> str:
    return measure.quantity.split(" ")[-1] if measure.kind != "reaction" else measure.joint


PICTURES: dict[str, Callable[[Balance], Figure | None]] = {
    "before_after": before_after,
    "hodograph": hodograph,
    "mechanism": mechanism,
    "trade": trade,
}
