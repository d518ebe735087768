"""Effect of the deviations of a nominal linkage on an output, to first order."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.problem.document import Rows
from optlink.problem.file import ProblemFile
from optlink.problem.tolerances import Deviation
from optlink.studies.motion_sensitivity import output_sensitivity
from optlink.studies.tolerance.nominal import Nominal


@dataclass(frozen=True, repr=False)
class LinearAnalysis:
    """Tolerances of a design and their effect; `by` (deviations, angles): change of the judged value per deviation [SI]."""

    problem: ProblemFile
    nominal: Nominal
    deviations: tuple[Deviation, ...]
    by: Rows
    limit: float | None

    @cached_property
    def shift(self) -> Array:
        """Mean change (angles,) to first order."""
        return np.asarray(np.array([d.mean for d in self.deviations]) @ self.by, dtype=float)

    @cached_property
    def worst(self) -> tuple[Array, Array]:
        """Least and largest change (angles,) to first order with all deviations at their worst ends."""
        ends = np.array([d.ends for d in self.deviations])
        changes = ends[:, :, None] * self.by[:, None, :]
        return np.sum(np.min(changes, axis=1), axis=0), np.sum(np.max(changes, axis=1), axis=0)

    @cached_property
    def rss(self) -> Array:
        """Root sum square (angles,) of each tolerance times its derivative; for measured deviations three sigma."""
        sizes = np.array([3.0 * d.sigma if d.values else d.tolerance for d in self.deviations])
        return np.asarray(np.sqrt(np.sum(np.square(sizes[:, None] * self.by), axis=0)), dtype=float)

    @cached_property
    def sigma(self) -> Array:
        """Standard deviation (angles,) to first order."""
        return np.asarray(np.sqrt(np.sum(self._variances, axis=0)), dtype=float)

    @cached_property
    def _variances(self) -> Array:
        return np.square(np.array([d.sigma for d in self.deviations])[:, None] * self.by)

    @property
    def where(self) -> int:
        """Index of the crank angle of largest scatter."""
        return int(np.argmax(self.sigma))

    @cached_property
    def contributions(self) -> Array:
        """Share of each deviation in the variance (deviations, angles); zeros without scatter."""
        total = np.sum(self._variances, axis=0)
        return self._variances / np.where(total > 0.0, total, 1.0)


def linear_analysis(
    problem: ProblemFile, nominal: Nominal, deviations: Sequence[Deviation], limit: float | None
) -> LinearAnalysis:
    """Return the linear analysis with exact derivatives at the nominal design."""
    sizes = list(dict.fromkeys(d.size for d in deviations))
    slopes = output_sensitivity(nominal.mechanism, nominal.sizes, nominal.crank_angles, nominal.output, sizes).by
    by = nominal.sign * np.array([slopes[d.size] for d in deviations])
    return LinearAnalysis(problem, nominal, tuple(deviations), by, limit)
