"""The nominal linkage of a tolerance analysis, its deviations, and their effect on an output to first order."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from optlink.errors import InputError
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.vector2d import Array, Value, cross, dot, unit
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import Unusable, check_choice
from optlink.problem.tolerances import (
    CLEARANCE,
    EXAMPLE,
    NORMAL,
    Deviation,
    ToleranceEntry,
    deviations,
    read_tolerance,
    with_deviating_pivots,
)
from optlink.studies.motion_sensitivity import output_names, output_sensitivity
from optlink.tasks.protocol import completed
from optlink.tasks.run import design_task, solve

ERROR = "error"
POSITIONS = 31  # positions along the span of a motion law
REVOLUTION_POSITIONS = 36  # crank angles of a revolution


@dataclass(frozen=True)
class Nominal:
    """A nominal linkage and one output of it over crank angles (angles,) [rad].

    `value`: the output [rad or m]; `base`: judged value without deviations: the error of the design, or zeros;
    `sign`: change of the judged value per change of the output.
    """

    mechanism: Mechanism
    sizes: Mapping[str, float]
    crank_angles: Array
    output: str
    name: str
    value: Array
    base: Array
    sign: float = 1.0

    @property
    def angular(self) -> bool:
        """Whether the output is an angle."""
        return self.output in self.mechanism.bodies

    @property
    def degrees(self) -> Array:
        """Crank angles (angles,) [deg]."""
        return np.degrees(self.crank_angles)

    @property
    def unit(self) -> str:
        """SI unit of the output."""
        return "rad" if self.angular else "m"

    @cached_property
    def _nominal_position(self) -> Any:
        return self._where(self.sizes)

    def _where(self, sizes: Mapping[str, Value]) -> Any:
        with np.errstate(all="ignore"):
            pose = self.mechanism.pose(sizes, unit(self.crank_angles))
            if self.angular:
                return pose.direction(self.output)
            point, _, axis = self.output.rpartition(".")
            return pose.point(point)["xy".index(axis)]

    def change(self, deviations: Mapping[str, Value]) -> Array:
        """Return the exact change (samples, angles) of the judged value for deviations of dimensions, arrays (samples, 1)."""
        moved = self._where({**self.sizes, **{name: self.sizes[name] + by for name, by in deviations.items()}})
        with np.errstate(all="ignore"):
            by = (
                np.arctan2(cross(self._nominal_position, moved), dot(self._nominal_position, moved))
                if self.angular
                else moved - self._nominal_position
            )
        samples = max((np.shape(column)[0] for column in deviations.values()), default=1)
        constant = np.broadcast_to(self.sign * by, (samples, len(self.crank_angles)))  # an output independent of the deviations
        return np.array(constant, dtype=float)


def nominal_design(
    problem: ProblemFile, output: str | None, crank_angles: Array | None = None, design: Mapping[str, float] | None = None
) -> Nominal:
    """Return the nominal linkage, optimised first if it has design variables, and its judged output.

    Parameters
    ----------
    problem : ProblemFile
    output : str, optional
        Body (its angle), "P.x", "P.y" of a point, or "error" of a motion law (its default).
    crank_angles : array (angles,) [rad], optional
        Default: the span of a motion law, the points of a path, otherwise a revolution.
    design : mapping of str to float [SI], optional
        Design variables. Default: the optimum.

    Raises
    ------
    InputError
        For an unknown output, no valid design, or a linkage that cannot be assembled at a crank angle.
    """
    file, values, angles = _design(problem, design)
    mechanism, pivots = with_deviating_pivots(file.model.mechanism, file.model.linkage)
    sizes = {name: values[name] for name in file.model.mechanism.quantities} | pivots
    law = file.model.has_error
    names = [*([ERROR] if law else []), *output_names(mechanism)]
    chosen = ERROR if output is None and law else output
    if chosen is None:
        raise InputError("the output to analyse is missing", f"One of: {', '.join(names)}", problem.file, "--quantity")
    check_choice("--quantity", chosen, names, "unknown output", problem.file)
    if law and chosen == ERROR:
        if crank_angles is not None:
            remedy = "Leave --angles out, or give --quantity rocker"
            raise InputError("the error is that over the span of the law", remedy, problem.file, "--angles")
        task = file.spec
        span = np.linspace(0.0, task.span, POSITIONS)
        at = values["phi0"] + span
        drawn_ = _placed(problem, mechanism, sizes, at, "rocker", ERROR, -1.0)
        target = task.law.curve(span, values["phi0"], values["psi0"])
        error = np.remainder(target - drawn_.value + math.pi, 2.0 * math.pi) - math.pi
        return replace(drawn_, base=error)
    if crank_angles is None:
        crank_angles = 2.0 * math.pi * np.arange(REVOLUTION_POSITIONS) / REVOLUTION_POSITIONS if angles is None else angles
    return _placed(problem, mechanism, sizes, np.asarray(crank_angles, dtype=float), chosen, chosen, 1.0)


def _placed(
    problem: ProblemFile, mechanism: Mechanism, sizes: Mapping[str, float], at: Array, output: str, name: str, sign: float
) -> Nominal:
    value = output_sensitivity(mechanism, sizes, at, output, list(sizes)[:1]).value
    if not np.all(np.isfinite(value)):
        angle = math.degrees(float(at[int(np.argmin(np.isfinite(value)))]))
        remedy = 'Give crank angles that it reaches: --angles "60..120 deg:13"'
        raise InputError(f"the linkage cannot be assembled at {angle:.4g} deg", remedy, problem.file, "--angles")
    return Nominal(mechanism, dict(sizes), at, output, name, value, np.zeros(len(at)), sign)


def _design(problem: ProblemFile, design: Mapping[str, float] | None) -> tuple[ProblemFile, dict[str, float], Array | None]:
    """Return the problem with definite assembly modes, all quantities of the design [SI], and its crank angles, if any."""
    model = problem.model
    if design is None and model.free:
        if problem.task not in ("function", "path", "cycle"):
            none = problem.task in ("analysis", "balance")
            message = "the problem has design variables " + ("but no requirement" if none else "that are not searched here")
            raise InputError(message, "Add --design", problem.file, "mechanism")
        result: Any = completed(solve(problem))
    elif problem.task == "path":
        result = design_task(problem).validate(problem, design or {})
    else:
        return problem, model.design(design or {}), None
    best = result.best
    if best is None or (design is None and not result.valid):
        raise _nothing(problem)
    angles = getattr(best, "crank_angles", None)
    timed = angles is not None and best.task.requirement.kind != "transmission"
    return best.problem, best.problem.model.design(best.design), np.asarray(angles) if timed else None


def _nothing(problem: ProblemFile) -> InputError:
    remedy = "See `optlink solve`, or give a design: --design NAME=VALUE"
    return InputError("no valid design was found, so there is none to build", remedy, problem.file)


OPTION = "--tolerance"


def read_tolerances(problem: ProblemFile, texts: Sequence[str], shape: str = NORMAL) -> dict[str, ToleranceEntry]:
    """Return tolerances by name from texts NAME=TOLERANCE; without texts, those of the file.

    Files of measured deviations are read from the working folder.

    Parameters
    ----------
    problem : ProblemFile
    texts : sequence of str
    shape : str
        Default distribution; measured deviations and clearances have their own.

    Raises
    ------
    InputError
        If there are no tolerances, or one is invalid.
    """
    entries: dict[str, ToleranceEntry] = {} if texts else dict(problem.model.tolerances)
    if not texts and not entries:
        raise InputError("no tolerance is given", f"{EXAMPLE}, or give the file [tolerances]", problem.file, OPTION)
    for assignment in texts:
        name, equals, text = assignment.partition("=")
        name = name.strip().removeprefix("mechanism.")
        if not equals or not name or not text.strip():
            raise InputError("expected NAME=TOLERANCE", EXAMPLE, key=OPTION, value=assignment)
        if name in entries:
            raise InputError("a tolerance is given twice", "Give each once", problem.file, OPTION, name)
        try:
            entries[name] = read_tolerance(text, Path())
        except Unusable as error:
            raise InputError(error.message, error.remedy, key=f"{OPTION} {name}", value=error.value) from None
    entry = {
        name: entry.shape or (None if entry.measured or name.endswith(CLEARANCE) else shape) for name, entry in entries.items()
    }
    return {name: replace(entries[name], shape=distribution) for name, distribution in entry.items()}


def read_deviations(problem: ProblemFile, nominal: Nominal, texts: Sequence[str], shape: str = NORMAL) -> tuple[Deviation, ...]:
    """Return the deviations of a nominal linkage; see `read_tolerances`.

    Parameters
    ----------
    problem : ProblemFile
    nominal : Nominal
    texts : sequence of str
    shape : str
        Default distribution.

    Raises
    ------
    InputError
        If there are no tolerances, or one is invalid.
    """
    entries = read_tolerances(problem, texts, shape)
    try:
        quantities, output = problem.model.mechanism.quantities, nominal.output
        return deviations(entries, nominal.mechanism, quantities, nominal.sizes, shape, output)
    except Unusable as error:
        key = f"{OPTION} {error.key}" if texts else f"tolerances.{error.key}"
        raise InputError(error.message, error.remedy, problem.file, key, error.value) from None


@dataclass(frozen=True, repr=False)
class LinearAnalysis:
    """Tolerances of a design and their effect; `by` (deviations, angles): change of the judged value per deviation [SI]."""

    problem: ProblemFile
    nominal: Nominal
    deviations: tuple[Deviation, ...]
    by: Array
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
    """Return the linear analysis with exact derivatives at the nominal design.

    Parameters
    ----------
    problem : ProblemFile
    nominal : Nominal
    deviations : sequence of Deviation
    limit : float [rad or m], optional
        Largest absolute judged value.
    """
    sizes = list(dict.fromkeys(d.size for d in deviations))
    slopes = output_sensitivity(nominal.mechanism, nominal.sizes, nominal.crank_angles, nominal.output, sizes).by
    by = nominal.sign * np.array([slopes[d.size] for d in deviations])
    return LinearAnalysis(problem, nominal, tuple(deviations), by, limit)
