"""Derivatives of output angles and points by every dimension of a linkage, at given crank angles.

Linear tolerance analysis sums these derivatives. They are exact: casadi differentiates the formulas of the motion itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import casadi
import numpy as np
from numpy.typing import ArrayLike

from optlink.linkage.arguments import check_array, check_design
from optlink.linkage.mechanism import FRAME, Mechanism
from optlink.linkage.vector2d import Array, all_finite
from optlink.optimization.output_derivatives import output_derivatives
from optlink.problem.arguments import typed
from optlink.problem.document import Document, Source
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import check_choice
from optlink.symbolic import NumpyEvaluator, symbols_in_numpy


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


@dataclass(frozen=True, repr=False, eq=False)
class OutputStudy(Document):
    """The derivatives of an output of a linkage with the dimensions `sizes` [SI], at crank angles [rad]."""

    kind = "output sensitivity"
    _stored = ("output", "sizes", "crank_angles")
    status = "done"
    shown: ClassVar[Mapping[str, Source]] = {
        "output": "output",
        "unit": "derivatives.unit",
        "sizes_SI": "sizes",
        "crank_angles_deg": lambda result: np.degrees(result.crank_angles),
        "value": "derivatives.value",
        "per_size_SI": "derivatives.by",
    }

    problem: ProblemFile
    output: str
    sizes: Mapping[str, float]
    crank_angles: Array

    @classmethod
    def _restored(cls, problem: ProblemFile, values: Mapping[str, Any]) -> Self:
        """Return the study for the values in a document."""
        return cls(problem, values["output"], values["sizes"], np.array(values["crank_angles"]))

    @property
    def valid(self) -> bool:
        """Whether the linkage can be assembled at every crank angle."""
        return all_finite(self.derivatives.value)

    @cached_property
    def derivatives(self) -> OutputSensitivity:
        """The output and its derivatives."""
        return output_sensitivity(self.problem.model.linkage, self.sizes, self.crank_angles, self.output)


def output_names(mechanism: Mechanism) -> list[str]:
    """Return the outputs of a linkage: the angle of every moving body by its name, and `P.x`, `P.y` of every moving point."""
    bodies = [name for name in mechanism.bodies if name != FRAME]
    points = [p for p, owners in mechanism.owners.items() if FRAME not in owners]
    return [*bodies, *(f"{point}.{axis}" for point in points for axis in "xy")]


@typed
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
        For an unknown output or quantity, or if a size is missing.

    Examples
    --------
    >>> sizes = {"crank": 0.1, "coupler": 0.4, "rocker": 0.25, "frame": 0.5}  # [m]
    >>> found = optlink.studies.output_sensitivity(optlink.linkage.four_bar(), sizes, [0.5], "rocker")
    >>> found.unit, sorted(found.by), found.by["crank"].round(3)  # [rad/m]
    ('rad', ['coupler', 'crank', 'frame', 'rocker'], array([-4.133]))
    """
    check_choice("output", output, output_names(mechanism), "unknown output")
    sizes = check_design(mechanism, sizes)
    chosen = list(by or sizes)
    for name in chosen:
        check_choice("by", name, sizes, "unknown dimension")
    names = list(sizes)
    symbols = {name: casadi.SX.sym(name) for name in names}
    crank = casadi.SX.sym("crank angle")
    with symbols_in_numpy():
        value, slopes = output_derivatives(mechanism, symbols, crank, output, chosen)
    angles = np.atleast_1d(check_array("crank_angles", crank_angles))
    tape = NumpyEvaluator([*symbols.values(), crank], [value, *slopes])
    values = np.asarray(tape(*[np.full(angles.shape, sizes[name]) for name in names], angles), dtype=float)
    return OutputSensitivity(
        output, "rad" if output in mechanism.bodies else "m", angles, values[0], dict(zip(chosen, values[1:], strict=True))
    )
