"""Chart of a generated function y(x): target, generated values, and the error in y, of any mechanism."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from optlink.problem.targets.function import Function
from optlink.report.chart_spec import Axis, ChartSpec, Curve, Mark, Panel
from optlink.report.style import FOUND, LIMIT, WANTED

Array = NDArray[np.float64]


def function_chart(function: Function, offsets: Array, error: Array, title: str, *, warning: bool = False) -> ChartSpec:
    """Return the prescribed and the generated y(x) with the error in y.

    Parameters
    ----------
    function : Function
    offsets : array (positions,) [rad]
        Crank rotations from the start.
    error : array (positions,) [rad or m]
        Prescribed minus generated output; finite at one position at least.
    title : str
    warning : bool, optional
        Whether the title is that of a design that is not valid.
    """
    least, largest = function.ends
    x = function.low + (function.high - function.low) * offsets / function.input
    wanted = np.asarray(function.expression({"x": x}) + 0.0 * x, dtype=float)
    away = error * (largest - least) / function.output
    worst = int(np.nanargmax(np.abs(away)))
    above = [
        Curve(x, wanted, "target", WANTED, 1.4, "dash", gid="target y"),
        Curve(x, wanted - away, "generated", FOUND, 1.8, gid="generated y"),
    ]
    mark = Mark(
        float(x[worst]),
        float(away[worst]),
        f"largest {away[worst]:+.3g}".replace("-", "−"),
        size=1.0,
        prefer=(0.0, np.sign(away[worst])),
    )
    below = Panel(Axis("target minus generated"), [Curve(x, away, "", LIMIT, 1.5, gid="error in y")], marks=[mark])
    panels = [Panel(Axis("y"), above, 1.7), below]
    return ChartSpec("function", "Function y(x)", panels, Axis("x"), title, cursor=False, warning=warning)
