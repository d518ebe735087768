"""The controller of a problem file: controlled output, inverse model and gains."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator

from optlink.clearance.joint import Gap
from optlink.dynamics.machine import Machine
from optlink.problem.base_model import Section
from optlink.problem.quantity import (
    Duration,
    FixedAngle,
    Frequency,
    Number,
    Quantity,
    Unusable,
    check_keys,
    check_name,
    read_fixed,
    read_scalar,
    where,
)
from optlink.problem.targets.target_points import read_columns, read_csv

if TYPE_CHECKING:
    from optlink.clearance.columns import Output


class ServoSection(Section):
    """Servo drive that follows a reference angle and speed: second order, with bandwidth and damping ratio."""

    bandwidth: Annotated[Frequency, where(lambda f: f > 0.0, "a servo has a bandwidth", 'Give for example "300 Hz"')]
    """Undamped natural frequency."""
    damping: Annotated[
        Number, where(lambda share: 0.0 < share <= 10.0, "a damping ratio lies above 0 and not above 10", "Give for example 0.7")
    ] = 0.7
    """Damping ratio, above 0 and at most 10."""


def _read_joints(raw: object) -> Any:
    if not isinstance(raw, list | tuple) or not all(isinstance(name, str) for name in raw):
        raise Unusable("expected a list of joints", 'Write known = ["C"]')
    return tuple(raw)


def _read_either(raw: object) -> Quantity:
    """Read a length or an angle."""
    try:
        return read_fixed(raw, "length")
    except Unusable as error:
        try:
            return read_fixed(raw, "angle")
        except Unusable:
            raise error from None


class ControlSection(Section):
    """Correction of the crank motion so that the output moves as it would without clearance.

    The controller is an inverse model of joints with known clearance, a PID on the output's error, or both.
    """

    output: str | None = None
    """Slider (its slide) or body (its angle) whose ideal motion the controller tracks; default: the last slider on the frame,
    else the last body pinned to it."""
    known: Annotated[Any, BeforeValidator(_read_joints)] | None = None
    """Joints whose clearance is included in the inverse model; default: all."""
    regularisation: Annotated[Quantity, BeforeValidator(_read_either)] | None = None
    """Regularisation of the inverse at dead centres: a length for a slider, an angle for a body; default: a tenth of the largest
    travel per radian of the crank."""
    bandwidth: Annotated[Frequency, where(lambda f: f > 0.0, "a bandwidth is positive", 'Give for example "200 Hz"')] | None = (
        None
    )
    """Highest frequency that the inverse model corrects; default: half of the servo's bandwidth."""
    sample_time: Annotated[
        Duration,
        where(lambda t: t >= 1e-6, "a controller samples at intervals, of a microsecond at least", 'Give for example "0.25 ms"'),
    ] = Quantity(2.5e-4, "time", "s")
    """Sample time of the PID, rounded to the nearest value that divides the revolution and fits its rows."""
    proportional: Number = 0.0
    """Proportional gain of the PID on the output error, referred to the crank [-]."""
    integral: Number = 0.0
    """Integral gain of the PID [1/s]."""
    derivative: Number = 0.0
    """Derivative gain of the PID [s]."""
    limit: Annotated[
        FixedAngle,
        where(lambda angle: angle > 0.0, "the correction limit of the PID is not positive", 'Give for example "5 deg"'),
    ] = Quantity(0.08726646259971647, "angle", "deg")
    """Largest crank angle correction of the PID."""

    def check(self, machine: Machine, gaps: Sequence[Gap]) -> None:
        """Check that the controller fits the machine and its joints with clearance.

        Raises
        ------
        Unusable
            with the key below the controller.
        """
        from optlink.clearance.columns import default_output, outputs

        available, points = outputs(machine), [gap.point for gap in gaps]
        if self.output is not None:
            check_name(self.output, available, "no such slider or body", "output")
        for point in self.known or ():
            check_name(point, points, "the joint has no clearance", "known")
        regularisation = self.regularisation
        if regularisation is not None:
            output = default_output(machine) if self.output is None else available[self.output]
            needed, example = ("a length", '"5 mm"') if output.guide else ("an angle", '"5 deg"')
            if (regularisation.kind == "length") != bool(output.guide):
                message = f"{output.name} moves by {needed} per radian"
                raise Unusable(message, f"Give {needed}: {example}", "regularisation", str(regularisation))
            if not regularisation.value > 0.0:
                message = "without regularisation the inverse has no solution at a dead centre"
                raise Unusable(message, f"Give for example {example}", "regularisation", str(regularisation))


# A measured series of the output: a CSV file over time or crank angle, of displacements or of the voltages of a sensor.

MOST = 100_000  # rows
KEYS = ("csv", "column", "per_volt", "at_zero")
OVER: dict[str, Literal["time", "angle"]] = {"time": "time", "angle": "angle", "crank_angle": "angle"}
"""Columns over which a series may run, the first of them that a file has, with their kinds."""


@dataclass(frozen=True)
class MeasuredSeries:
    """Measured `values` [m, rad] of the output `at` times since the start [s] or crank angles [rad], of the file `name`."""

    over: Literal["time", "angle"]
    at: tuple[float, ...]
    values: tuple[float, ...]
    angular: bool
    name: str = field(compare=False)

    def check(self, output: "Output", *, steady: bool) -> None:
        """Check that the series is one of the output of a machine, and that its crank turns at a given speed (`steady`).

        Raises
        ------
        Unusable
            with the key below the series.
        """
        if not steady:
            message = "a measured series is not supported under a driving torque"
            raise Unusable(message, "Leave it out, or give drive.speed instead of drive.torque", "csv", self.name)
        if self.angular == bool(output.guide):
            what, title = ("a slide", "displacement_mm") if output.guide else ("an angle", "displacement_deg")
            message = f"the output {output.name} is {what}, the measured series is not"
            raise Unusable(message, f"Give a column {title}, or another control.output", "csv", self.name)

    def times(self, start: float, speed: float) -> list[float]:
        """Return the times since the start [s] of a crank with a constant speed [rad/s] and this angle at the start [rad]."""
        return list(self.at) if self.over == "time" else [(angle - start) / speed for angle in self.at]


def read_measured(raw: object, folder: Path) -> MeasuredSeries:
    """Read a measured series: `{ csv = "slide.csv" }`, of voltages with their linear calibration.

    Raises
    ------
    Unusable
        with the key below the series.
    """
    if not isinstance(raw, dict) or "csv" not in raw:
        raise Unusable("the measured series has no file", 'Write measured = { csv = "slide.csv" }', "", None)
    check_keys(raw, KEYS)
    titles = read_csv(raw, folder, MOST).titles
    stems = [title.rpartition("_")[0] for title in titles]
    first = next((name for name in OVER if name in stems), "time")
    column = raw.get("column", "voltage" if "voltage" in stems and "displacement" not in stems else "displacement")
    if not isinstance(column, str) or not column:
        raise Unusable("expected the name of a column without its unit", 'Write column = "slider.s"', "column", column)
    unit = next((title.removeprefix(f"{column}_") for title in titles if title.startswith(f"{column}_")), "")
    kind = "voltage" if unit == "V" else "angle" if unit in ("deg", "rad") else "coordinate"
    calibration = {key: raw[key] for key in ("per_volt", "at_zero") if key in raw}
    if kind != "voltage" and calibration:
        key, value = next(iter(calibration.items()))
        raise Unusable("the series has displacements, so it needs no calibration", "Leave it out", key, value)
    order: Literal["rising", "either way"] = "rising" if first == "time" else "either way"
    at, values = read_columns(raw, folder, {first: OVER[first], column: kind}, ordered=order, most=MOST)
    angular = kind == "angle"
    if kind == "voltage":
        if len(calibration) < 2:
            missing = "at_zero" if "per_volt" in raw else "per_volt"
            message = "a series of voltages needs its calibration: displacement per volt, and displacement at 0 V"
            raise Unusable(message, 'Write per_volt = "12.5 mm" and at_zero = "70 mm"', missing)
        angular = _is_angle(raw["per_volt"])
        of = "angle" if angular else "coordinate"
        per_volt, at_zero = (read_scalar(raw[key], of, key)[0] for key in ("per_volt", "at_zero"))
        if per_volt == 0.0:
            raise Unusable("the displacement per volt is zero", 'Give for example "12.5 mm"', "per_volt", raw["per_volt"])
        values = [at_zero + per_volt * value for value in values]
    return MeasuredSeries(OVER[first], tuple(at), tuple(values), angular, str(raw["csv"]))


def _is_angle(raw: object) -> bool:
    """Return whether a calibration is one of angles."""
    with contextlib.suppress(Unusable):
        read_scalar(raw, "angle")
        return True
    return False
