"""How the motion answers to a size: derivatives of output angles and points by every size of a linkage, at given crank angles.

Linear tolerances are sums of these. They are exact: casadi differentiates the formulas that the motion itself is made of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.errors import Fault, InputError
from optlink.linkage.mechanism import FRAME, Mechanism
from optlink.linkage.vector2d import unit
from optlink.optimization.output_derivatives import output_slopes
from optlink.problem.quantity import nearest
from optlink.symbolic import Tape, tracing

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OutputSensitivity:
    """An output over crank angles [rad]: `value` [rad or m], and its derivatives by size [rad/m or m/m]; (angles,) arrays.

    NaN where the linkage cannot be assembled.
    """

    name: str
    unit: str
    crank_angles: Array
    value: Array
    by: Mapping[str, Array]


def output_names(mechanism: Mechanism) -> list[str]:
    """Outputs of a linkage: the angle of every moving body by its name, and `P.x`, `P.y` of every point that moves."""
    bodies = [name for name in mechanism.bodies if name != FRAME]
    points = [p for p, owners in mechanism.owners.items() if FRAME not in owners]
    return [*bodies, *(f"{point}.{axis}" for point in points for axis in "xy")]


def output_sensitivity(
    mechanism: Mechanism, sizes: Mapping[str, float], crank_angles: ArrayLike, output: str, by: Sequence[str] = ()
) -> OutputSensitivity:
    """Derivatives of an output by sizes, at crank angles that stay as they are.

    Parameters
    ----------
    mechanism : Mechanism
    sizes : mapping of quantity to value [SI]
    crank_angles : array [rad]
    output : name of a body (its angle, counter-clockwise from +x), or "P.x", "P.y" of a point
    by : names of quantities; all sizes if left out

    Raises
    ------
    InputError
        unknown output or size.
    """
    if output not in output_names(mechanism):
        raise InputError(Fault("unknown output", nearest(output, output_names(mechanism)), key="output", value=output))
    chosen = list(by or sizes)
    for name in chosen:
        if name not in sizes:
            raise InputError(Fault("unknown size", nearest(name, sizes), key="by", value=name))
    names = list(sizes)
    symbols = {name: casadi.SX.sym(name) for name in names}
    crank = casadi.SX.sym("crank angle")
    with tracing():
        value, slopes = output_slopes(mechanism, symbols, unit(crank), output, chosen)
    angles = np.atleast_1d(np.asarray(crank_angles, dtype=float))
    tape = Tape([*symbols.values(), crank], [value, *slopes])
    found = np.asarray(tape(*[np.full(angles.shape, sizes[name]) for name in names], angles), dtype=float)
    return OutputSensitivity(
        output, "rad" if output in mechanism.bodies else "m", angles, found[0], dict(zip(chosen, found[1:], strict=True))
    )
