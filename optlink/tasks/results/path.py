"""Result of path, motion, function or transmission synthesis: designs with their validation, as data and JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from optlink.errors import InputError, Status
from optlink.io import Summary, finite
from optlink.linkage.cognates import Cognate, CouplerLinkage, cognates
from optlink.linkage.dyad_types import RRR
from optlink.linkage.extrema import extremes
from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.motion import sweep
from optlink.problem.file import ProblemFile
from optlink.problem.fixed_design import fixed_design
from optlink.problem.mechanism import FourBarSection
from optlink.problem.path import START, TURN, PathProblem
from optlink.solvers.evidence import Evidence
from optlink.solvers.solution import LimitState, Relaxation, Solution
from optlink.tasks.machine import turning_machine
from optlink.tasks.results.analysis import stroke_document
from optlink.tasks.results.common import heading, proven
from optlink.tasks.results.fit import Fit, path_fit, transmission_fit
from optlink.units import KINDS, factor
from optlink.validation.check import Check, Validation
from optlink.validation.path import MeasuredDeviations, deviations, transmission_angles

SCHEMA = "optlink/generation/1"
DISTINCT = 1e-2  # least relative difference of two distinct designs
LEVEL = 1e-9  # of the size: root of a sum of squares below which a design passes the points

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class PathDesign(Summary):
    """One design with its validation.

    `problem` has definite assembly modes; `values` are all quantities [m, rad], `crank_angles` (points,) [rad] those of
    the points; `objective` in the SI unit of the measure.
    """

    problem: ProblemFile
    values: dict[str, float]
    crank_angles: Array
    objective: float
    status: Status
    validation: Validation
    solution: Solution | None = None

    @property
    def task(self) -> PathProblem:
        """The model of the problem."""
        assert isinstance(self.problem.model, PathProblem)
        return self.problem.model

    @property
    def valid(self) -> bool:
        """Whether the design is validated, and optimal if it was searched."""
        return proven(self.status, self.validation)

    @cached_property
    def measured(self) -> MeasuredDeviations:
        """Generated points and their deviations from the targets."""
        return deviations(self.task, self.values, self.crank_angles)

    @cached_property
    def fit(self) -> Fit | None:
        """Error relative to the size of the task, or least transmission angle; None if neither is defined."""
        if self.task.requirement.kind == "transmission":
            return transmission_fit(self.least_transmission, self.task.mechanism.quantities, self.values, self.limits)
        return path_fit(self.task, self.values, self.crank_angles, self.measured, self.limits)

    @property
    def exact(self) -> bool:
        """Whether it satisfies all targets within rounding."""
        return self.error <= self.level

    @property
    def error(self) -> float:
        """The objective as a deviation [m, rad or 1]: the root of a sum of squares."""
        return math.sqrt(max(self.objective, 0.0)) if self.task.measure == "sum of squares" else self.objective

    @property
    def level(self) -> float:
        """Largest error of an exact design [m, rad or 1]."""
        return LEVEL * self.task.whole

    def alike(self, other: PathDesign) -> bool:
        """Return whether two designs are practically the same."""
        if self.assembly != other.assembly:
            return False
        gaps = []
        for name, quantity in self.task.quantities.items():
            gap = abs(self.values[name] - other.values[name])
            if quantity.kind == "angle" or name == START:
                gaps.append(abs(math.remainder(gap, TURN)))
            else:
                gaps.append(gap / max(self.task.size, abs(self.values[name])))
        return max(gaps, default=0.0) <= DISTINCT

    @property
    def turns(self) -> bool:
        """Whether the crank turns fully."""
        return self.task.limits.crank != "span"

    @cached_property
    def least_transmission(self) -> float:
        """Least distance of the transmission angle from 0 and 180 deg over the required motion [rad]; NaN if there is none."""
        begin, end = (0.0, TURN) if self.turns else sorted((float(self.crank_angles[0]), float(self.crank_angles[-1])))
        groups = [group for group in self.task.linkage.groups if isinstance(group, RRR)]

        def cosines(angles: Array) -> Array:  # smooth, unlike the angles, which have corners at 0 and pi
            gamma = transmission_angles(sweep(self.task.linkage, self.values, angles), self.task.linkage)
            return np.cos(gamma).T

        grid = np.linspace(begin, end, 721)
        if not groups or not np.all(np.isfinite(cosines(grid))):
            return math.nan
        return math.acos(min(float(np.max(np.abs(extremes(cosines, grid)[1]))), 1.0))

    @cached_property
    def cognates(self) -> tuple[Cognate, ...]:
        """The other four-bars with the same coupler curve, fully turning cranks first; none for other mechanisms."""
        linkage = self.coupler_linkage
        if linkage is None:
            return ()
        try:
            found = [c for c in cognates(linkage, at=float(self.crank_angles[0])) if c is not None]
        except InputError:  # a miss that cannot be assembled at its first point
            return ()
        return tuple(sorted(found, key=lambda c: not (c.crank_turns and c.keeps_side)))

    @property
    def coupler_linkage(self) -> CouplerLinkage | None:
        """The four-bar with its coupler point as plain numbers."""
        if not isinstance(self.task.mechanism, FourBarSection) or self.task.requirement.point not in self.task.mechanism.points:
            return None
        point, values = self.task.requirement.point, self.values
        x, y, direction = (values.get(name, 0.0) for name in ("A.x", "A.y", "direction"))
        sizes = {name: values[name] for name in LENGTHS}
        along, across = values[f"{point}.along"], values[f"{point}.across"]
        return CouplerLinkage(**sizes, along=along, across=across, x=x, y=y, direction=direction, side=self.task.side)

    @property
    def machine(self) -> ProblemFile:
        """The linkage as a problem with every size fixed, for `analyze`, `simulate` and pictures."""
        return fixed_design(self.problem, self.values)

    @property
    def assembly(self) -> object:
        """Assembly modes, in the words of the problem file."""
        return self.problem.raw["mechanism"].get("assembly", "left")

    def to_dict(self) -> dict[str, Any]:
        """Return the design as a JSON object: SI, or the unit that ends the key."""
        measured, task = self.measured, self.task
        point: dict[str, Any] = {"crank_deg": np.degrees(self.crank_angles).tolist()}
        if task.pointed:
            point["x_mm"], point["y_mm"] = (measured.generated * 1e3).T.tolist()
        elif task.requirement.kind == "transmission":
            point["transmission_deg"] = np.degrees(measured.generated).tolist()
        else:
            factor_, unit = OUTPUT[task.unit]
            point[f"output_{unit}"] = (measured.generated[:, 0] * factor_).tolist()
        factor_, unit = OUTPUT[task.unit]
        point[f"distance_{unit}".rstrip("_")] = (measured.distances * factor_).tolist()
        if measured.turned is not None:
            point["turned_deg"] = np.degrees(measured.turned).tolist()
        document: dict[str, Any] = {
            "valid": self.valid,
            "status": self.status.value,
            "assembly": self.assembly,
            "design": {
                f"{name}_{display_unit(self.task, name)[1]}": v for name, v in display_values(self.task, self.values).items()
            },
            "objective": {"value": self.objective, **_figures(self)},
            "fit": None if self.fit is None else self.fit.to_dict(),
            "least_transmission_deg": math.degrees(self.least_transmission),
            "points": point,
            "limits": [vars(limit) | {} for limit in self.limits],
            "validation": [vars(check) | {} for check in self.validation.checks],
        }
        if self.solution is not None:
            document |= {"kkt": self.solution.kkt, "violation": self.solution.violation, "iterations": self.solution.iterations}
        document["cognates"] = [_cognate(cognate) for cognate in self.cognates]
        return document

    @property
    def limits(self) -> tuple[LimitState, ...]:
        """All bounds and limits in display units."""
        return self.solution.limits if self.solution is not None else ()


def _cognate(cognate: Cognate) -> dict[str, Any]:
    linkage = cognate.linkage
    lengths = {f"{name}_mm": 1e3 * getattr(linkage, name) for name in (*LENGTHS, "along", "across")}
    place = {"A.x_mm": 1e3 * linkage.x, "A.y_mm": 1e3 * linkage.y, "direction_deg": math.degrees(linkage.direction)}
    kind = {"inversion": cognate.inversion.value, "crank_turns": cognate.crank_turns, "keeps_side": cognate.keeps_side}
    return {**lengths, **place, "side": linkage.side, **kind, "turns_as": cognate.turns_as}


def display_unit(task: PathProblem, name: str) -> tuple[float, str]:
    """Return the factor from SI and the display unit of a quantity.

    Parameters
    ----------
    task : PathProblem
    name : str
        Name of a quantity.
    """
    unit = KINDS[task.quantities[name].kind].display
    return 1.0 / factor(unit, task.quantities[name].kind), unit


def display_values(task: PathProblem, values: Mapping[str, float]) -> dict[str, float]:
    """Return a design in display units.

    Parameters
    ----------
    task : PathProblem
    values : mapping of str to float [m, rad]
        All quantities.
    """
    return {name: values[name] * display_unit(task, name)[0] for name in task.quantities}


OUTPUT = {"m": (1e3, "mm"), "rad": (math.degrees(1.0), "deg"), "": (1.0, "")}
"""Factor from SI and unit in which deviations are shown."""


def objective_unit(task: PathProblem) -> str:
    """Return the SI unit of the objective."""
    return f"{task.unit}^2" if task.measure == "sum of squares" and task.unit else task.unit


def _figures(design: PathDesign) -> dict[str, Any]:
    measured, task = design.measured, design.task
    factor_, unit = OUTPUT[task.unit]
    found = {
        "unit": objective_unit(task),
        "measure": task.measure,
        f"rms_{unit}".rstrip("_"): factor_ * math.sqrt(float(np.mean(measured.distances**2))),
        f"largest_{unit}".rstrip("_"): factor_ * float(np.max(measured.distances)),
    }
    if measured.turned is not None:
        found["largest_turned_deg"] = math.degrees(float(np.max(np.abs(measured.turned))))
    return found


@dataclass(frozen=True, eq=False, repr=False)
class PathResult(Summary):
    """Result of a path or motion search: validated designs, best first; or the nearest miss and the reason of its failure."""

    problem: ProblemFile
    designs: tuple[PathDesign, ...]
    nearest: PathDesign | None
    backend: str
    seed: int
    starts: int
    evidence: Evidence
    seconds: dict[str, float]
    interrupted: bool = False
    notes: tuple[str, ...] = field(default=())
    conflict: tuple[Relaxation, ...] = ()
    together: tuple[Relaxation, ...] = ()

    @property
    def hits(self) -> int:
        """Number of starts that reached the best design."""
        return self.evidence.hits

    @property
    def valid(self) -> bool:
        """Whether there is a validated design."""
        return bool(self.designs)

    @property
    def best(self) -> PathDesign | None:
        """The best validated design; the nearest miss if there is none; None if no linkage reaches the points at all."""
        return self.designs[0] if self.designs else self.nearest

    @property
    def definite(self) -> ProblemFile:
        """The problem with the assembly modes of the best design."""
        return self.problem if self.best is None else self.best.problem

    @property
    def design(self) -> dict[str, float]:
        """Quantities of the best design [m, rad]; empty if there is none."""
        return {} if self.best is None else dict(self.best.values)

    @property
    def solution(self) -> Solution | None:
        """Solver solution of the best design."""
        return None if self.best is None else self.best.solution

    @property
    def validation(self) -> Validation:
        """Checks of the best design."""
        return Validation((), math.nan) if self.best is None else self.best.validation

    @property
    def status(self) -> Status:
        """Status of the search."""
        return Status.INFEASIBLE if self.best is None else self.best.status

    @property
    def objective(self) -> float:
        """Objective of the best design [SI]; NaN if there is none."""
        return math.nan if self.best is None else self.best.objective

    def with_checks(self, checks: Sequence[Check]) -> Self:
        """Return the result with further checks of its designs, in order; designs that fail one are no longer valid."""
        flagged = [replace(d, validation=replace(d.validation, checks=(*d.validation.checks, *checks))) for d in self.designs]
        good = tuple(design for design in flagged if design.valid)
        nearest = next((design for design in flagged if not design.valid), self.nearest)
        return replace(self, designs=good, nearest=None if good else nearest)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as a JSON document."""
        document = heading(SCHEMA, self) | {
            "starts_that_reached_the_best": self.hits,
            "evidence": vars(self.evidence) | {},
        }
        if self.best is not None:
            document["design"] = self.best.to_dict()["design"]
            machine, angles = turning_machine(self.best.problem, self.best.values), self.best.crank_angles
            document["strokes"] = {} if machine is None else stroke_document(machine, float(angles[-1] - angles[0]))
            document["assembly"] = self.best.assembly
            document["fit"] = None if self.best.fit is None else self.best.fit.to_dict()
        document["designs"] = [design.to_dict() for design in self.designs]
        if self.conflict:
            document["conflict"] = [vars(item) | {} for item in self.conflict]
            document["relax_together"] = [vars(item) | {} for item in self.together]
        document["nearest_miss"] = None if self.nearest is None or self.designs else self.nearest.to_dict()
        return finite(document)  # type: ignore[no-any-return]
