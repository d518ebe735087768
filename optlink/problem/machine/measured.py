"""A measured series of the output: a CSV file over time or crank angle, of displacements or of the voltages of a sensor."""

import contextlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from optlink.problem.quantity import Unusable, check_keys, read_scalar
from optlink.problem.targets.csv_table import read_columns, read_csv

if TYPE_CHECKING:
    from optlink.clearance.output import Output

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
