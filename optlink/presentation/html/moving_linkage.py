"""Animated linkage of an HTML page: drawing, slider and quantities that follow it."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from optlink.dynamics.columns import MotionColumns, efforts
from optlink.dynamics.machine import slider_names
from optlink.errors import InputError
from optlink.io import finite
from optlink.linkage.vector2d import Array
from optlink.presentation.chart_spec import max_abs
from optlink.presentation.export.svg import motion_data, svg
from optlink.presentation.format import Scale, pretty, scale
from optlink.presentation.scene import Region, Scene, scene
from optlink.problem.file import ProblemFile, fixed_design, started
from optlink.tasks.analyze import Analysis, analyze

STILLS = 4  # positions that are printed
STACKED_RATIO = 0.45  # ratio of height to width below which the quantities are shown below the drawing


@dataclass(frozen=True)
class Readout:
    """A quantity that follows the slider: name, unit, and values in that unit at the positions of the scene."""

    name: str
    unit: str
    values: list[float | None]

    @property
    def shown_unit(self) -> str:
        """Unit as written in a page."""
        return "°" if self.unit == "deg" else pretty(self.unit)

    @property
    def decimals(self) -> int:
        """Number of decimals for four significant digits."""
        largest = max((abs(value) for value in self.values if value is not None), default=0.0)
        return 3 if largest < 10.0 else 2 if largest < 1000.0 else 1

    def text(self) -> str:
        """Format the first value."""
        value = self.values[0]
        return "–" if value is None else f"{value:z.{self.decimals}f}".replace("-", "−")


@dataclass(frozen=True, eq=False)
class Stops:
    """Positions of the slider: `values` (positions,) in `unit`; `turn` is the period of the values, if there is one."""

    name: str
    unit: str
    values: Array
    decimals: int
    turn: float | None = None

    def text(self) -> str:
        """Format the first position."""
        return f"{self.values[0]:z.{self.decimals}f}{self.unit}".replace("-", "−")


@dataclass(frozen=True, eq=False)
class Moving:
    """A scene of an analysed machine with its slider and the quantities beside it."""

    cycle: Analysis
    scene: Scene
    stops: Stops
    readouts: Sequence[Readout]

    def to_dict(self) -> dict[str, Any]:
        """Return the data that the page script needs for the animation."""
        stops = self.stops
        values = np.round(stops.values, 9).tolist()
        slider = {"values": values, "unit": stops.unit, "decimals": stops.decimals, "turn": stops.turn}
        listed = [{"values": readout.values, "decimals": readout.decimals} for readout in self.readouts]
        return motion_data(self.scene) | {"readouts": listed, "slider": slider}

    @property
    def flat(self) -> bool:
        """Whether the quantities are shown below the drawing."""
        return self.scene.ratio < STACKED_RATIO

    @property
    def stills(self) -> list[tuple[str, str]]:
        """Drawings of some positions, evenly over the motion, with the position as caption: what paper shows of the motion."""
        count, stops = len(self.stops.values), self.stops
        chosen = np.linspace(0, count - 1, STILLS + self.scene.closed).round().astype(int)[:STILLS]
        captions = [replace(stops, values=stops.values[k:]).text() for k in chosen]
        return [
            (caption, svg(self.scene, f"{stops.name} {caption}", int(k), names=False))
            for caption, k in zip(captions, chosen, strict=True)
        ]

    def svg(self, title: str) -> str:
        """Return the drawing."""
        return svg(self.scene, f"{title}, drawn to scale")


def in_time(cycle: Analysis, scene: Scene, time: Array, shown: Iterable[tuple[str, Scale, Array]]) -> Moving:
    """Return the animation of a scene whose positions are reached at times [s], with quantities [SI] that follow it."""
    listed = [
        Readout(name, unit.unit, [round(float(v) * unit.factor, 5) if math.isfinite(v) else None for v in values])
        for name, unit, values in shown
    ]
    return Moving(cycle, scene, Stops("time", " s", time, decimals_of(time)), listed)


def decimals_of(values: Array) -> int:
    """Return the number of decimals that distinguish neighbouring values."""
    step = float(np.min(np.abs(np.diff(values)), initial=math.inf))
    return min(6, max(0, math.ceil(-math.log10(step)))) if 0.0 < step < math.inf else 3


def turning(cycle: Analysis, steps: int, regions: Sequence[Region] = ()) -> Moving:
    """Return the animation of a machine over its crank angle, with `steps` positions per revolution and regions of its limits."""
    drawn = scene(cycle, steps, regions=regions)
    driving = cycle.problem.model.driving
    stops = Stops(driving.coordinate, "°", drawn.crank_angles, 1, 360.0)
    if driving.ends is not None:
        lengths = np.array([driving.shown(at) for at in np.radians(drawn.crank_angles)])
        stops = Stops(driving.coordinate, " mm", lengths, decimals_of(lengths))
    return Moving(cycle, drawn, stops, readouts(cycle, drawn.crank_angles))


def readouts(cycle: Analysis, angles: Array) -> list[Readout]:
    """Return the quantities beside the moving linkage: slides, transmission angles; with masses or loads, driving torque."""
    machine = cycle.machine
    record = MotionColumns(machine.moving(np.radians(angles), cycle.speed))
    sliders = [f"{name}.s_m" for name in slider_names(machine).values()]
    columns = [(name, f"slide of {name.removesuffix('.s_m')}", "m") for name in sliders]
    if not columns:
        last = machine.mechanism.links[-1].body
        columns.append((f"{last}.angle_rad", f"angle of {last}", "deg"))
    for name in record.columns:
        if name.endswith(".transmission_rad"):
            columns.append((name, f"transmission angle at {name.partition('.')[0]}", "deg"))
    if machine.inertias or machine.loads:
        columns += [(effort.column, effort.words, effort.unit) for effort in efforts(machine.mechanism)]
    result = []
    for column, label, unit in columns:
        values = record[column]
        shown = scale(max_abs(values), unit)
        result.append(Readout(label, shown.unit, finite(np.round(values * shown.factor, 4))))
    return result


def cycle_of(file: ProblemFile, design: Mapping[str, float], start: float = math.nan) -> Analysis | None:
    """Analyse the machine of a problem with a design [m, rad]; None if it cannot be assembled, or not at a crank angle [rad]."""
    try:
        return analyze(started(fixed_design(file, file.model.sizes(design)), start, 0.0))
    except InputError:
        return None
