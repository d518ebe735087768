"""Effect of the deviations of a nominal linkage on an output, to first order."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.optimization.output_derivatives import ErrorDerivatives
from optlink.problem.document import Rows
from optlink.problem.file import ProblemFile
from optlink.problem.tolerances import Deviation
from optlink.studies.motion_sensitivity import output_sensitivity
from optlink.studies.tolerance.nominal import Nominal, error_names


@dataclass(frozen=True, repr=False)
class LinearAnalysis:
    """Tolerances of a design and their effect.

    `by` (deviations, components * angles): change of the components of the judged value per deviation [SI], those of the first
    component first.
    """

    problem: ProblemFile
    nominal: Nominal
    deviations: tuple[Deviation, ...]
    by: Rows
    limit: float | None

    @cached_property
    def effects(self) -> Array:
        """Change (deviations, angles) of the judged value per deviation [SI]; of a vector the length of its change."""
        if self.nominal.components == 1:
            return np.asarray(self.by)
        return np.asarray(np.linalg.norm(self.by.reshape(len(self.by), self.nominal.components, -1), axis=1))

    def changes(self, deviations: Array) -> Array:
        """Return the changes (..., components, angles) of the judged value to first order for deviations (..., deviations)."""
        return np.asarray((deviations @ self.by).reshape(*deviations.shape[:-1], self.nominal.components, -1))

    @cached_property
    def shift(self) -> Array:
        """Change (angles,) to first order by the mean deviations."""
        nominal = self.nominal
        change = self.changes(np.array([d.mean for d in self.deviations]))
        return change[0] if nominal.components == 1 else nominal.after(change) - nominal.base

    @cached_property
    def worst(self) -> tuple[Array, Array]:
        """Least and largest change (angles,) to first order with all deviations at their worst ends; bounds of a length."""
        ends = np.array([d.ends for d in self.deviations])
        changes = ends[:, :, None] * self.effects[:, None, :]
        low, high = np.sum(np.min(changes, axis=1), axis=0), np.sum(np.max(changes, axis=1), axis=0)
        if self.nominal.components == 1:
            return low, high
        reach = np.sum(np.max(np.abs(changes), axis=1), axis=0)
        return np.maximum(-reach, -self.nominal.base), reach

    @cached_property
    def rss(self) -> Array:
        """Root sum square (angles,) of each tolerance times its derivative; for measured deviations three sigma."""
        sizes = np.array([3.0 * d.sigma if d.values else d.tolerance for d in self.deviations])
        return np.asarray(np.sqrt(np.sum(np.square(sizes[:, None] * self.effects), axis=0)), dtype=float)

    @cached_property
    def sigma(self) -> Array:
        """Standard deviation (angles,) to first order; of a vector the root of the sum of the variances of its components."""
        return np.asarray(np.sqrt(np.sum(self._variances, axis=0)), dtype=float)

    @cached_property
    def _variances(self) -> Array:
        return np.square(np.array([d.sigma for d in self.deviations])[:, None] * self.effects)

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
    sizes = [d.size for d in deviations]
    if nominal.part is None:
        slopes = output_sensitivity(
            nominal.mechanism, nominal.sizes, nominal.crank_angles, nominal.output, list(dict.fromkeys(sizes))
        ).by
        by = nominal.sign * np.array([slopes[size] for size in sizes])
        return LinearAnalysis(problem, nominal, tuple(deviations), by, limit)
    exact = ErrorDerivatives(nominal.part, sizes)
    parts = exact.numeric({**nominal.sizes, **nominal.further}, nominal.crank_angles, nominal.targets)[1]
    chosen = parts if len(names := error_names(nominal.part)) == 1 else [parts[names.index(nominal.name)]]
    still = np.zeros((len(sizes), len(nominal.crank_angles)))
    by = nominal.sign * np.concatenate([np.array([slope + still[0] for slope in own]) for own in chosen], axis=1)
    return LinearAnalysis(problem, nominal, tuple(deviations), by, limit)
