"""Robust objectives: an error with its scatter, as standard deviations, worst case or expected value.

To first order, a deviation d of a dimension changes the error by its derivative times d; the derivatives are those of the
linkage. An error of one component has the exact scatter of this model. Of a vector, such as the distance of a point from its
target, the expected square is exact too; its length with scatter is an upper bound by the triangle inequality, the length of the
mean error plus the root of the sum of the variances of all components, or plus the sum of the lengths of the worst changes.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator

from optlink.linkage.vector2d import Value
from optlink.problem.quantity import Unusable
from optlink.problem.tolerances import Deviation

MAX_SIGMAS = 100.0  # standard deviations
WORST, EXPECTED = "worst case", "expected value"
SQUARES, LARGEST = ("sum of squares", "rms"), ("max",)  # measures for the expected value, and for the others
SMOOTHED = 1e-8  # of the scale of an error; a programme has sqrt(s^2 + SMOOTHED^2) for |s|, smooth where the scatter s vanishes
_SIGMAS = re.compile(r"([-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?) *sigma")
_REMEDY = f'Write robust = "3 sigma" or "{WORST}" with measure = "max", or "{EXPECTED}" with squares'


@dataclass(frozen=True)
class Robust:
    """Robustness: `sigmas` standard deviations or the worst case added to each error, or the expected square of the error."""

    text: str
    sigmas: float = 0.0

    def __str__(self) -> str:
        return self.text

    @property
    def measures(self) -> tuple[str, ...]:
        """Measures that can be combined with it."""
        return SQUARES if self.text == EXPECTED else LARGEST

    @property
    def band(self) -> str:
        """Name of the band drawn around an error."""
        return "1 sigma" if self.text == EXPECTED else self.text

    def named(self, measure: str) -> str:
        """Return the name of the robust measure for display."""
        if self.text != EXPECTED:
            return f"{measure} with {self.text}"
        return "root of the expected mean square" if measure == "rms" else f"expected {measure}"


def read_robust(raw: object) -> Robust | None:
    """Read "3 sigma", "worst case" or "expected value".

    Raises
    ------
    Unusable
    """
    if raw is None:
        return None
    text = raw.strip() if isinstance(raw, str) else ""
    if text in (WORST, EXPECTED):
        return Robust(text)
    match = _SIGMAS.fullmatch(text)
    if match is None:
        raise Unusable("this does not state how tolerances are taken into account", _REMEDY)
    sigmas = float(match[1])
    if not 0.0 <= sigmas <= MAX_SIGMAS:
        raise Unusable("out of range", f'Give 0 to {MAX_SIGMAS:g} standard deviations, such as "3 sigma"')
    return Robust(f"{sigmas:g} sigma", sigmas)


Robustness = Annotated[Robust | None, BeforeValidator(read_robust)]


def residuals(
    robust: Robust | None,
    deviations: Sequence[Deviation],
    errors: Sequence[Value],
    slopes: Sequence[Sequence[Value]],
    smoothed: Value = 0.0,
    *,
    separate: bool = False,
) -> list[Value]:
    """Return the residuals at one position, elementwise: the error, or the error with its scatter.

    Parameters
    ----------
    robust : Robust or None
        None: the nominal error only.
    deviations : sequence of Deviation
        Of dimensions; their tolerances may be symbols.
    errors : sequence of float, array or symbol [SI]
        Components of the nominal error.
    slopes : sequence of sequences of float, array or symbol
        For each component the derivatives [1/SI] with respect to the dimension of every deviation.
    smoothed : float or symbol [SI]
        See `SMOOTHED`; 0: none.
    separate : bool
        Whether every component is an error of its own, not one of a vector.

    Returns
    -------
    list [SI]
        Without robustness the error. For sigmas or the worst case of one component, the upper and the lower end of the error
        band: the larger of their magnitudes is that of the mean error plus the scatter; of a vector, the components of its mean
        and its scatter. For the expected value, the mean error and the standard deviation due to every dimension, whose squares
        add up to the expected square of the error.
    """
    if robust is None:
        return list(errors)
    worst = robust.text == WORST
    means = [0.5 * (d.ends[0] + d.ends[1]) if worst else d.mean for d in deviations]
    sizes = [0.5 * (d.ends[1] - d.ends[0]) if worst else d.sigma for d in deviations]
    middle = [error + sum(m * by for m, by in zip(means, own, strict=True)) for error, own in zip(errors, slopes, strict=True)]
    parts = [[size * by for size, by in zip(sizes, own, strict=True)] for own in slopes]
    if robust.text == EXPECTED:
        return [*middle, *(part for own in zip(*parts, strict=True) for part in own)]

    def spread(components: Sequence[Sequence[Value]]) -> Value:
        squares = [sum(part * part for part in own) for own in zip(*components, strict=True)]  # of every deviation
        if worst:
            return sum(np.sqrt(square + smoothed * smoothed) for square in squares)
        return robust.sigmas * np.sqrt(sum(squares) + smoothed * smoothed)

    if separate or len(errors) == 1:
        bands = [(mean, spread([own])) for mean, own in zip(middle, parts, strict=True)]
        return [end for mean, by in bands for end in (mean + by, mean - by)]
    return [*middle, spread(parts)]


def check_robust(robust: Robust | None, measure: str, tolerance_count: int) -> None:
    """Check that the robustness measure is compatible with that of the requirement and that tolerances are defined.

    Raises
    ------
    Unusable
        with the full key of the cause.
    """
    if robust is None:
        return
    if not tolerance_count:
        remedy = 'Add the section [tolerances], for example coupler = "0.1 mm"'
        raise Unusable("a robust design needs tolerances", remedy, "requirement.robust", robust.text)
    if measure not in robust.measures:
        other = f'robust = "{EXPECTED}"' if measure in SQUARES else 'robust = "3 sigma"'
        message = f'"{robust.text}" is not compatible with measure = "{measure}"'
        raise Unusable(message, f'Write measure = "{robust.measures[0]}", or {other}', "requirement.robust", robust.text)


def sizes_of(parts: Sequence[Value]) -> Value:
    """Return the largest magnitude of the upper and lower end of an error band; elementwise on arrays."""
    return np.max([np.abs(part) for part in parts], axis=0)
