"""Derivatives of output angles and points by every dimension of a linkage, at given crank angles.

Linear tolerance analysis sums these derivatives. They are exact: casadi differentiates the formulas of the motion itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import casadi
import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from optlink.linkage.mechanism import FRAME, Mechanism
from optlink.linkage.vector2d import Array, unit
from optlink.optimization.output_derivatives import output_derivatives
from optlink.problem.base_model import Column, Columns, ResultRecord
from optlink.problem.quantity import check_choice
from optlink.symbolic import NumpyEvaluator, symbols_in_numpy


class OutputSensitivityRecord(ResultRecord):
    """Document of the derivatives of an output by dimensions (SI)."""

    format: Literal["optlink/output-sensitivity/2"] = Field(alias="schema")
    output: Annotated[str, "name"]
    unit: Literal["rad", "m"]
    sizes_SI: dict[str, float]
    crank_angles_deg: Column
    value: Column
    per_size_SI: Annotated[Columns, "by"]


@dataclass(frozen=True)
class OutputSensitivity:
    """An output over crank angles [rad]: `value` [rad or m], and its derivatives by dimension [rad/m or m/m]; arrays (angles,).

    NaN where the linkage cannot be assembled.
    """

    name: str
    unit: str
    crank_angles: Array
    value: Array
    by: Mapping[str, Array]


def output_names(mechanism: Mechanism) -> list[str]:
    """Return the outputs of a linkage: the angle of every moving body by its name, and `P.x`, `P.y` of every moving point."""
    bodies = [name for name in mechanism.bodies if name != FRAME]
    points = [p for p, owners in mechanism.owners.items() if FRAME not in owners]
    return [*bodies, *(f"{point}.{axis}" for point in points for axis in "xy")]


def output_sensitivity(
    mechanism: Mechanism, sizes: Mapping[str, float], crank_angles: ArrayLike, output: str, by: Sequence[str] = ()
) -> OutputSensitivity:
    """Return the derivatives of an output by dimensions at fixed crank angles.

    Parameters
    ----------
    mechanism : Mechanism
    sizes : mapping of str to float [SI]
    crank_angles : array (angles,) [rad]
    output : str
        Body (its angle, counter-clockwise from +x), or "P.x", "P.y" of a point.
    by : sequence of str
        Names of quantities. Default: all.

    Raises
    ------
    InputError
        For an unknown output or quantity.
    """
    check_choice("output", output, output_names(mechanism), "unknown output")
    chosen = list(by or sizes)
    for name in chosen:
        check_choice("by", name, sizes, "unknown dimension")
    names = list(sizes)
    symbols = {name: casadi.SX.sym(name) for name in names}
    crank = casadi.SX.sym("crank angle")
    with symbols_in_numpy():
        value, slopes = output_derivatives(mechanism, symbols, unit(crank), output, chosen)
    angles = np.atleast_1d(np.asarray(crank_angles, dtype=float))
    tape = NumpyEvaluator([*symbols.values(), crank], [value, *slopes])
    values = np.asarray(tape(*[np.full(angles.shape, sizes[name]) for name in names], angles), dtype=float)
    return OutputSensitivity(
        output, "rad" if output in mechanism.bodies else "m", angles, values[0], dict(zip(chosen, values[1:], strict=True))
    )
