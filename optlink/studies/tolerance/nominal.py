"""Nominal linkage of a tolerance analysis, optimised first if it has design variables, and its judged output."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from optlink.errors import InputError
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.vector2d import Array, Value, cross, dot, unit
from optlink.problem.document import Column, Number
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import check_choice
from optlink.problem.tolerances import with_deviating_pivots
from optlink.studies.motion_sensitivity import output_names, output_sensitivity
from optlink.tasks.protocol import completed
from optlink.tasks.run import design_task, solve

ERROR = "error"
POSITIONS = 31  # positions along the span of a motion law
REVOLUTION_POSITIONS = 36  # crank angles of a revolution


@dataclass(frozen=True)
class Nominal:
    """A nominal linkage, of a problem with definite assembly modes, and one output of it over crank angles (angles,) [rad].

    `value`: the output [rad or m]; `base`: judged value without deviations: the error of the design, or zeros;
    `sign`: change of the judged value per change of the output.
    """

    problem: ProblemFile
    sizes: dict[str, Number]
    crank_angles: Column
    output: str
    name: str
    value: Column
    base: Column
    sign: float = 1.0

    @cached_property
    def mechanism(self) -> Mechanism:
        """The linkage, with pivots that can deviate."""
        return with_deviating_pivots(self.problem.model.mechanism, self.problem.model.linkage)[0]

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

    By default the output is the error over the span of a motion law, or is given at the points of a path, or over a revolution.
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
        drawn_ = _placed(file, sizes, at, "rocker", ERROR, -1.0)
        target = task.law.curve(span, values["phi0"], values["psi0"])
        error = np.remainder(target - drawn_.value + math.pi, 2.0 * math.pi) - math.pi
        return replace(drawn_, base=error)
    if crank_angles is None:
        crank_angles = 2.0 * math.pi * np.arange(REVOLUTION_POSITIONS) / REVOLUTION_POSITIONS if angles is None else angles
    return _placed(file, sizes, np.asarray(crank_angles, dtype=float), chosen, chosen, 1.0)


def _placed(problem: ProblemFile, sizes: dict[str, float], at: Array, output: str, name: str, sign: float) -> Nominal:
    drawn = Nominal(problem, sizes, at, output, name, np.zeros(len(at)), np.zeros(len(at)), sign)
    value = output_sensitivity(drawn.mechanism, sizes, at, output, list(sizes)[:1]).value
    if not np.all(np.isfinite(value)):
        angle = math.degrees(float(at[int(np.argmin(np.isfinite(value)))]))
        remedy = 'Give crank angles that it reaches: --angles "60..120 deg:13"'
        raise InputError(f"the linkage cannot be assembled at {angle:.4g} deg", remedy, problem.file, "--angles")
    return replace(drawn, value=value)


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
