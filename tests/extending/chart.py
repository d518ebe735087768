"""A chart of analyses: the power of the drive over the crank angle, as `result.plot("power")` and on the page."""

import numpy as np

from optlink import Analysis
from optlink.extending import Axis, ChartSpec, Curve, Panel, ResultChart, crank_angle, register


def power(result: Analysis) -> ChartSpec | None:
    """Return the chart; None for a machine without forces."""
    values = result["input.power_W"]
    if not np.any(values):
        return None
    curve = Curve(np.degrees(result.positions), values, "power of the drive")
    return ChartSpec("power", "Power of the drive", [Panel(Axis("power [W]"), [curve])], crank_angle())


register(ResultChart("power", "analysis", power))
