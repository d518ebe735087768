"""Nominal linkage of a tolerance analysis, optimised first if it has design variables, and its judged output."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from optlink.errors import InputError
from optlink.linkage.dyads import transmitting
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.vector2d import TURN, Array, Value, cross, dot
from optlink.problem.design import DesignProblem
from optlink.problem.document import Column, Number, Rows
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import check_choice
from optlink.problem.targets.law import Table
from optlink.problem.tolerances import with_deviating_pivots
from optlink.studies.motion_sensitivity import output_names, output_sensitivity
from optlink.tasks.machine import position_text
from optlink.tasks.protocol import completed
from optlink.tasks.run import design_task, solve

ERROR = "error"
POSITIONS = 31  # positions along the span of a motion law
REVOLUTION_POSITIONS = 36  # crank angles of a revolution


def error_names(part: DesignProblem) -> list[str]:
    """Return the names of the errors of a requirement: one, or one for the transmission angle of every dyad."""
    name, joints = f"{part.prefix}{ERROR}", [group.joint for group in transmitting(part.linkage)]
    return [f"{name} at {joint}" for joint in joints] if part.separate and len(joints) > 1 else [name]


@dataclass(frozen=True)
class Nominal:
    """A nominal linkage, of a problem with definite assembly modes, and one output of it over crank angles (angles,) [rad].

    `value`: the output [rad or m]; `base`: judged value without deviations: the error of the design, or zeros;
    `sign`: change of the judged value per change of the output. `further`: quantities of a requirement that do not deviate;
    `vectors` (components, angles): the error of points or poses, whose length is judged.
    """

    problem: ProblemFile
    sizes: dict[str, Number]
    crank_angles: Column
    output: str
    name: str
    value: Column
    base: Column
    sign: float = 1.0
    further: dict[str, Number] = field(default_factory=dict)
    vectors: Rows | None = None

    @cached_property
    def mechanism(self) -> Mechanism:
        """The linkage, with pivots that can deviate."""
        return with_deviating_pivots(self.problem.model.mechanism, self.problem.model.linkage)[0]

    @cached_property
    def part(self) -> DesignProblem | None:
        """The requirement whose error is judged; None for another output."""
        return next((part for part in self.problem.model.parts if self.name in error_names(part)), None)

    @property
    def angular(self) -> bool:
        """Whether the output is an angle."""
        return self.output in self.mechanism.bodies

    @property
    def degrees(self) -> Array:
        """Crank angles (angles,) [deg]."""
        return np.degrees(self.crank_angles)

    @property
    def places(self) -> Array:
        """Positions of the drive (angles,) in its unit."""
        return self.problem.model.driving.shown(self.crank_angles)

    @property
    def unit(self) -> str:
        """SI unit of the judged value; empty for the cosine of a transmission angle."""
        if self.part is not None:
            return self.part.unit
        return "rad" if self.angular else "m"

    @property
    def components(self) -> int:
        """Number of components of the judged value."""
        return 1 if self.vectors is None else len(self.vectors)

    def after(self, changes: Array) -> Array:
        """Return the judged value after changes (..., components, angles) of its components."""
        if self.vectors is None:
            return np.asarray(self.base + changes[..., 0, :])
        return np.asarray(np.linalg.norm(self.vectors + changes, axis=-2))

    @property
    def targets(self) -> tuple[Array, ...]:
        """Targets of the requirement at the crank angles, see `DesignProblem.deviation`."""
        assert self.part is not None
        if self.part.pointed:
            return tuple(self.part.data.columns.T)
        if not self.part.law_given:
            return (np.zeros(len(self.crank_angles)),)
        offsets, law = self.crank_angles - self.further[self.part.start_name], self.part.requirement.law
        return offsets, law.at(offsets) if isinstance(law, Table) else np.zeros(len(offsets))

    def errors(self, sizes: Mapping[str, Value]) -> list[Any]:
        """Return the components of the error over the crank angles; of a law prescribed minus actual output."""
        assert self.part is not None
        with np.errstate(all="ignore"):
            pose = self.mechanism.at(sizes, self.crank_angles)
            parts = self.part.deviation(pose, {**sizes, **self.further}, self.targets)
        names = error_names(self.part)
        return [self.sign * part for part in (parts if len(names) == 1 else [parts[names.index(self.name)]])]

    @cached_property
    def _nominal_position(self) -> Any:
        return self._where(self.sizes)

    def _where(self, sizes: Mapping[str, Value]) -> Any:
        with np.errstate(all="ignore"):
            pose = self.mechanism.at(sizes, self.crank_angles)
            return pose.direction(self.output) if self.angular else pose.coordinate(self.output)

    def change(self, deviations: Mapping[str, Value]) -> Array:
        """Return the exact change (samples, angles) of the judged value for deviations of dimensions, arrays (samples, 1)."""
        sizes = {**self.sizes, **{name: self.sizes[name] + by for name, by in deviations.items()}}
        with np.errstate(all="ignore"):
            if self.vectors is not None:
                by = np.sqrt(sum(np.square(part) for part in self.errors(sizes))) - self.base
            elif self.part is not None:
                by = self.errors(sizes)[0] - self.base
                by = np.remainder(by + math.pi, TURN) - math.pi if self.unit == "rad" else by
            else:
                moved, before = self._where(sizes), self._nominal_position
                turned = np.arctan2(cross(before, moved), dot(before, moved)) if self.angular else moved - before
                by = self.sign * turned
        samples = max((np.shape(column)[0] for column in deviations.values()), default=1)
        constant = np.broadcast_to(by, (samples, len(self.crank_angles)))  # an output independent of the deviations
        return np.array(constant, dtype=float)


def nominal_design(
    problem: ProblemFile, output: str | None, crank_angles: Array | None = None, design: Mapping[str, float] | None = None
) -> Nominal:
    """Return the nominal linkage, optimised first if it has design variables, and its judged output.

    By default the output is the error of the first requirement: over the span of a motion law, at the points or poses, over the
    revolution of a transmission; of several dyads, that of the worst one.
    """
    judged(problem.model, output, crank_angles, problem.file)
    file, values, angles = _design(problem, design)
    model: Any = file.model
    mechanism, pivots = with_deviating_pivots(model.mechanism, model.linkage)
    sizes = {name: values[name] for name in model.mechanism.quantities} | pivots
    if output is None or output in [name for part in model.parts for name in error_names(part)]:
        part, own = next((part, own) for part, own in model.of_parts(angles) if output in (None, *error_names(part)))
        drawn = [_judged(file, part, sizes, part.own(values), own, name) for name in error_names(part) if output in (None, name)]
        return max(drawn, key=lambda nominal: float(np.max(np.abs(nominal.base))))
    if crank_angles is None:
        crank_angles = _whole_motion(mechanism) if angles is None else angles
    return _placed(file, sizes, np.asarray(crank_angles, dtype=float), output)


def judged(model: Any, output: str | None, crank_angles: Array | None, file: str) -> tuple[str, str]:
    """Return what stands for an output in the linkage, as `Nominal.output`, and its SI unit; empty for a cosine.

    Raises
    ------
    InputError
        If there is no such output, or crank angles are given for an error.
    """
    mechanism, _ = with_deviating_pivots(model.mechanism, model.linkage)
    errors = [name for part in model.parts for name in error_names(part)]
    names = [*errors, *output_names(mechanism)]
    if output is None and not errors:
        raise InputError("the output to analyse is missing", f"One of: {', '.join(names)}", file, "--quantity")
    if output is not None:
        check_choice("--quantity", output, names, "unknown output", file)
    if output is not None and output not in errors:
        return output, "rad" if output in mechanism.bodies else "m"
    if crank_angles is not None:
        other = model.parts[0].requirement.loaded(model.parts[0]) or output_names(mechanism)[0]
        remedy = f"Leave --angles out, or give --quantity {other}"
        raise InputError("the error is that at the positions of the requirement", remedy, file, "--angles")
    part = next(part for part in model.parts if output in (None, *error_names(part)))
    return part.requirement.loaded(part), part.unit


def _whole_motion(mechanism: Mechanism) -> Array:
    """Return the crank angles [rad] of a revolution, or of the range of the drive."""
    if mechanism.limits is not None:
        return np.linspace(*mechanism.limits, REVOLUTION_POSITIONS + 1)
    return TURN * np.arange(REVOLUTION_POSITIONS) / REVOLUTION_POSITIONS


def _judged(
    problem: ProblemFile, part: DesignProblem, sizes: dict[str, float], values: dict[str, float], angles: Array | None, name: str
) -> Nominal:
    """Return the linkage with an error of a requirement."""
    further = {key: value for key, value in values.items() if key not in sizes}
    if part.law_given:
        at = values[part.start_name] + np.linspace(0.0, part.span, POSITIONS)
    elif part.pointed:
        at = part.crank_angles(values, angles)
    else:
        at = _whole_motion(problem.model.linkage)
    blank, sign = np.zeros(len(at)), -1.0 if part.law_given else 1.0
    drawn = Nominal(problem, sizes, at, part.requirement.loaded(part), name, blank, blank, sign, further)
    errors = np.array([error + blank for error in drawn.errors(sizes)])
    value = base = errors[0] if len(errors) == 1 else np.linalg.norm(errors, axis=0)
    _check_assembled(problem, at, base)
    if part.law_given:
        value = part.requirement.actual(part, drawn.mechanism.at(sizes, at)) + blank
    return replace(drawn, value=value, base=base, vectors=errors if len(errors) > 1 else None)


def _placed(problem: ProblemFile, sizes: dict[str, float], at: Array, output: str) -> Nominal:
    """Return the linkage with an output that has no target."""
    drawn = Nominal(problem, sizes, at, output, output, np.zeros(len(at)), np.zeros(len(at)))
    value = output_sensitivity(drawn.mechanism, sizes, at, output, list(sizes)[:1]).value
    _check_assembled(problem, at, value)
    return replace(drawn, value=value)


def _check_assembled(problem: ProblemFile, at: Array, value: Array) -> None:
    """Refuse crank angles that the linkage does not reach."""
    if not np.all(np.isfinite(value)):
        where = position_text(problem, float(at[int(np.argmin(np.isfinite(value)))]))
        remedy = "Give positions that it reaches with --angles"
        raise InputError(f"the linkage cannot be assembled at {where}", remedy, problem.file, "--angles")


def _design(problem: ProblemFile, design: Mapping[str, float] | None) -> tuple[ProblemFile, dict[str, float], Array | None]:
    """Return the problem with definite assembly modes, all quantities of the design [SI], and its crank angles, if any."""
    model: Any = problem.model
    if design is None and model.free:
        if problem.task not in ("function", "path", "cycle"):
            none = problem.task in ("analysis", "balance")
            message = "the problem has design variables " + ("but no requirement" if none else "that are not searched here")
            raise InputError(message, "Add --design", problem.file, "mechanism")
        result: Any = completed(solve(problem))
    elif model.parts and not (len(problem.variants()) == 1 and all(part.data.offsets is not None for part in model.parts)):
        result = design_task(problem).validate(problem, design or {})
    else:
        values = model.design(design or {})
        return problem, values, model.crank_angles(values, None) if any(part.pointed for part in model.parts) else None
    best = result.best
    if best is None or (design is None and not result.valid):
        raise _nothing(problem)
    angles = getattr(best, "crank_angles", None)
    timed = angles is not None and any(part.pointed for part in best.task.parts)
    return best.problem, best.problem.model.design(best.design), np.asarray(angles) if timed else None


def _nothing(problem: ProblemFile) -> InputError:
    remedy = "See `optlink solve`, or give a design: --design NAME=VALUE"
    return InputError("no valid design was found, so there is none to build", remedy, problem.file)
