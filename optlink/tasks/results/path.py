"""Result of path, motion, function or transmission synthesis: designs with their validation, as data and JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from optlink.errors import InputError, Status
from optlink.io import Summary, finite
from optlink.linkage.cognates import Cognate, CouplerLinkage, cognates
from optlink.linkage.dyad_types import transmitting
from optlink.linkage.extrema import extremes
from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.motion import sweep
from optlink.linkage.vector2d import TURN, Array
from optlink.problem.design import DesignProblem
from optlink.problem.document import Column, Document, Number, Source, adapter, entries
from optlink.problem.file import ProblemFile
from optlink.problem.fixed_design import fixed_design, started
from optlink.problem.mechanism import FourBarSection
from optlink.problem.requirement import START
from optlink.solvers.solution import LimitState, Relaxation, Solution
from optlink.tasks.machine import turning_machine
from optlink.tasks.results.certificate import Certificate, message
from optlink.tasks.results.common import FOUND, ROUNDED, SEARCHED, RejectedDesign, of_solution, verified
from optlink.tasks.results.conflict import refutation
from optlink.tasks.results.evidence import INCOMPLETE, Evidence
from optlink.tasks.results.fit import Fit, path_fit, transmission_fit
from optlink.tasks.results.strokes import stroke_document
from optlink.units import DISPLAYED
from optlink.validation.between import excursions
from optlink.validation.check import Check, Validation
from optlink.validation.design import MeasuredDeviations, deviations
from optlink.validation.linkage_motion import transmission_angles

DISTINCT = 1e-2  # least relative difference of two distinct designs
EQUALLY_GOOD = 1e-6  # relative difference of the errors of equally good designs
NEARLY_TURNED = 1e-9  # difference [rad] of an angle from -180 deg that counts as rounding error
LEVEL = 1e-9  # of the size: deviation that is shown as exact


@dataclass(frozen=True, eq=False, repr=False)
class PathDesign(Summary):
    """One design with its validation.

    `problem` has definite assembly modes; `values` are all quantities [m, rad], `crank_angles` (points,) [rad] those of
    the points; `objective` in the SI unit of the measure.
    """

    shown: ClassVar[Mapping[str, Source]] = {
        **{name: name for name in ("valid", "status", "assembly")},
        "design": "displayed",
        "objective": "stated_objective",
        "fit": "fit",
        "least_transmission_deg": lambda design: math.degrees(design.least_transmission),
        "points": "points",
        "limits": "displayed_limits",
        "validation": "validation.checks",
        "cognates": lambda design: [_cognate_document(cognate) for cognate in design.cognates],
        **{f"{name}?": of_solution(name) for name in ("kkt", "violation", "iterations")},
    }

    problem: ProblemFile
    values: dict[str, Number]
    crank_angles: Column
    objective: Number
    status: Status
    validation: Validation
    solution: Solution | None = None

    @property
    def task(self) -> DesignProblem:
        """The model of the problem."""
        assert isinstance(self.problem.model, DesignProblem)
        return self.problem.model

    @property
    def design(self) -> dict[str, float]:
        """All quantities [m, rad], as in other results."""
        return self.values

    @property
    def displayed(self) -> dict[str, float]:
        """All quantities of the problem in display units, which end the keys."""
        return self.task.displayed({name: self.values[name] for name in self.task.quantities})

    @property
    def valid(self) -> bool:
        """Whether the design is validated, and optimal if it was searched."""
        return verified(self.status, self.validation)

    @cached_property
    def measured(self) -> MeasuredDeviations:
        """Generated points and their deviations from the targets."""
        return deviations(self.task, self.values, self.crank_angles)

    @cached_property
    def fit(self) -> Fit | None:
        """Error relative to the size of the task, or least transmission angle; None if neither is defined."""
        if self.task.requirement.kind == "transmission":
            quantities, limits = self.task.mechanism.quantities, self.displayed_limits
            return transmission_fit(self.least_transmission, quantities, self.values, limits, self.solution, self.task)
        measured, limits = self.measured, self.displayed_limits
        return path_fit(self.problem, self.values, self.crank_angles, measured, self.between, limits, self.solution)

    @cached_property
    def between(self) -> Array | None:
        """Excursion [m] of the traced curve between each point and the next; None for other tasks than paths."""
        return excursions(self.task, self.values, self.crank_angles)

    @property
    def exact(self) -> bool:
        """Whether it satisfies all targets within the rounding of their decimals."""
        return self.error <= self.level

    @property
    def error(self) -> float:
        """The objective as a deviation [m, rad or 1]: the root of a sum of squares."""
        return math.sqrt(max(self.objective, 0.0)) if self.task.measure == "sum of squares" else self.objective

    @property
    def level(self) -> float:
        """Largest error of an exact design [m, rad or 1]."""
        count = len(self.task.data.columns) if self.task.measure == "sum of squares" else 1
        return ROUNDED * math.sqrt(count) * self.task.whole

    def unwrapped(self, name: str) -> float:
        """Return a quantity [SI]: of an angle that may be any, 180 deg instead of -180 deg."""
        value, quantity = self.values[name], self.task.quantities.get(name)
        if quantity is None or not quantity.free or not self.task.is_periodic(name):
            return value
        turned = value + math.pi <= NEARLY_TURNED and quantity.bounds[1] >= math.pi - NEARLY_TURNED
        return min(value + TURN, quantity.bounds[1]) if turned else value

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
    def crank_turns(self) -> bool:
        """Whether the crank turns fully."""
        return self.task.limits.crank != "span"

    @cached_property
    def least_transmission(self) -> float:
        """Least distance of the transmission angle from 0 and 180 deg over the required motion [rad]; NaN if there is none."""
        begin, end = (0.0, TURN) if self.crank_turns else sorted((float(self.crank_angles[0]), float(self.crank_angles[-1])))
        groups = transmitting(self.task.linkage)

        def cosines(angles: Array) -> Array:  # smooth, unlike the angles, which have corners at 0 and pi
            gamma = transmission_angles(sweep(self.task.linkage, self.values, angles), self.task.linkage)
            return np.cos(gamma).T

        grid = np.linspace(begin, end, 721)
        if not groups or not np.all(np.isfinite(cosines(grid))):
            return math.nan
        return math.acos(min(float(np.max(np.abs(extremes(cosines, grid, periodic=self.crank_turns)[1]))), 1.0))

    @cached_property
    def cognates(self) -> tuple[Cognate, ...]:
        """The other four-bars with the same coupler curve, fully turning cranks first; none for other mechanisms."""
        linkage = self.coupler_linkage
        if linkage is None:
            return ()
        try:
            others = [c for c in cognates(linkage, at=float(self.crank_angles[0])) if c is not None]
        except InputError:  # a miss that cannot be assembled at its first point
            return ()
        return tuple(sorted(others, key=lambda c: not (c.crank_turns and c.keeps_side)))

    @property
    def coupler_linkage(self) -> CouplerLinkage | None:
        """The four-bar with its coupler point as plain numbers."""
        if not isinstance(self.task.mechanism, FourBarSection) or self.task.point not in self.task.mechanism.points:
            return None
        point, values = self.task.point, self.values
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

    @property
    def limits(self) -> tuple[LimitState, ...]:
        """All bounds and limits in SI."""
        return self.solution.limits if self.solution is not None else ()

    @property
    def displayed_limits(self) -> tuple[LimitState, ...]:
        """All bounds and limits in display units."""
        return self.solution.displayed_limits if self.solution is not None else ()

    @property
    def points(self) -> dict[str, Array]:
        """Crank angles, generated points and their deviations, in the unit that ends the key."""
        measured, task = self.measured, self.task
        size, unit = DISPLAYED[task.unit]
        points: dict[str, Array] = {"crank_deg": np.degrees(self.crank_angles)}
        if task.pointed:
            points["x_mm"], points["y_mm"] = (measured.generated * 1e3).T
        elif task.requirement.kind == "transmission":
            points["transmission_deg"] = np.degrees(measured.generated)
        else:
            points[f"output_{unit}"] = measured.generated[:, 0] * size
        points[f"distance_{unit}".rstrip("_")] = measured.distances * size
        if self.between is not None:
            missing = np.full(len(measured.distances) - len(self.between), np.nan)
            points["between_mm"] = 1e3 * np.append(self.between, missing)
        if measured.turned is not None:
            points["turned_deg"] = np.degrees(measured.turned)
        return points

    @property
    def stated_objective(self) -> dict[str, Any]:
        """Objective [SI], and the deviations in the unit that ends the key."""
        measured, task = self.measured, self.task
        size, unit = DISPLAYED[task.unit]
        objective = {
            "value": self.objective,
            "unit": task.objective_unit,
            "measure": task.measure,
            f"rms_{unit}".rstrip("_"): size * math.sqrt(float(np.mean(measured.distances**2))),
            f"largest_{unit}".rstrip("_"): size * float(np.max(measured.distances)),
        }
        if self.between is not None:
            objective["largest_between_mm"] = 1e3 * float(np.nanmax(self.between, initial=0.0))
        if measured.turned is not None:
            objective["largest_turned_deg"] = math.degrees(float(np.max(np.abs(measured.turned))))
        return objective

    def to_dict(self) -> dict[str, Any]:
        """Return the design as a JSON document: SI, or the unit that ends the key."""
        return finite(dict(entries(self)))  # type: ignore[no-any-return]


def _cognate_document(cognate: Cognate) -> dict[str, Any]:
    """Return another four-bar with the same coupler curve: SI, or the unit that ends the key."""
    linkage = cognate.linkage
    places = ("frame", "crank", "coupler", "rocker", "along", "across")
    return {
        **{f"{name}_mm": 1e3 * getattr(linkage, name) for name in places},
        "A.x_mm": 1e3 * linkage.x,
        "A.y_mm": 1e3 * linkage.y,
        "direction_deg": math.degrees(linkage.direction),
        "side": linkage.side,
        "inversion": cognate.inversion.value,
        **{name: getattr(cognate, name) for name in ("crank_turns", "keeps_side", "turns_as")},
    }


@dataclass(frozen=True, eq=False, repr=False)
class PathResult(Document):
    """Result of path, motion or function synthesis: validated designs, best first; or the nearest invalid one and the reason."""

    kind = "path"
    shown: ClassVar[Mapping[str, Source]] = {
        **{key: source for key, source in SEARCHED.items() if key != "notes"},
        "starts_that_reached_the_best": "hits",
        "design?": lambda result: result.best and result.best.displayed,
        "strokes?": "strokes",
        "assembly?": lambda result: result.best and result.best.assembly,
        "fit": lambda result: result.best and result.best.fit,
        "designs": "designs",
        **FOUND,
        "nearest_miss": lambda result: None if result.designs else result.nearest,
    }

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
    certificate: Certificate | None = None
    backends: dict[str, Solution] = field(default_factory=dict)
    rejected: RejectedDesign | None = None

    @classmethod
    def _restored(cls, problem: ProblemFile, values: Mapping[str, Any]) -> Self:
        """Return the result for the fields in a document; the solutions of the back ends are those of its best design."""
        result = super()._restored(problem, {**values, "backends": {}})
        context = {"problem": problem, "present": result.definite}
        return replace(result, backends=adapter(dict[str, Solution]).validate_python(values["backends"], context=context))

    @property
    def hits(self) -> int:
        """Number of starts that reached the best design."""
        return self.evidence.hits

    @property
    def incomplete(self) -> bool:
        """Whether a note states that the search may have missed the best design."""
        return any(note.startswith(INCOMPLETE) for note in self.notes)

    @cached_property
    def refuted(self) -> str:
        """Which limits exclude each other, in a sentence; empty if no limits conflict."""
        return refutation(self.conflict)

    @property
    def message(self) -> str:
        """Description of how the search ended."""
        return message(self.status, self.certificate, self.refuted)

    @property
    def valid(self) -> bool:
        """Whether there is a validated design."""
        return bool(self.designs)

    @property
    def best(self) -> PathDesign | None:
        """The best validated design; else the nearest invalid one; None if no linkage reaches the points."""
        return self.designs[0] if self.designs else self.nearest

    @property
    def machine(self) -> ProblemFile | None:
        """The best linkage with all dimensions fixed; its crank starts at the first point and turns to the last; or None."""
        if self.best is None:
            return None
        begin, end = float(self.best.crank_angles[0]), float(self.best.crank_angles[-1])
        return started(self.best.machine, begin, end - begin)

    @property
    def strokes(self) -> dict[str, Any] | None:
        """Strokes of every output of the best design, as JSON; empty if the crank does not turn fully, None without a design."""
        if self.best is None:
            return None
        machine, angles = turning_machine(self.best.problem, self.best.values), self.best.crank_angles
        return {} if machine is None else stroke_document(machine, float(angles[-1] - angles[0]))

    @property
    def definite(self) -> ProblemFile:
        """The problem with the assembly modes of the best design."""
        return self.problem if self.best is None else self.best.problem

    @property
    def design(self) -> dict[str, float]:
        """Quantities of the best design [m, rad]; empty if there is none."""
        return {} if self.best is None else dict(self.best.values)

    def displayed(self, design: Mapping[str, float]) -> dict[str, float]:
        """Return the design variables [SI] of a solution in display units, which end the keys."""
        model = self.problem.model
        return model.displayed({name: design[name] for name in model.free})

    @property
    def solution(self) -> Solution | None:
        """Solver solution of the best design."""
        return None if self.best is None else self.best.solution

    @property
    def limits(self) -> tuple[LimitState, ...]:
        """All bounds and limits of the best design, in SI; none without a search."""
        return () if self.best is None else self.best.limits

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

    @property
    def oriented(self) -> Self:
        """The result with the same one of several equally good designs first, whichever of them a search finds first.

        These are mirror images for a symmetric path, for example. The one with the largest first design variable in which they
        differ is chosen, so that results of neighbouring problems belong together. An angle of -180 deg is 180 deg.
        """
        if not self.designs:
            return self
        first = self.designs[0]
        equal = [d for d in self.designs if d.error <= first.error * (1.0 + EQUALLY_GOOD) or (d.exact and first.exact)]
        equal = [d for d in equal if str(d.assembly) == min(str(other.assembly) for other in equal)]
        for name in first.task.free:
            most = max(design.unwrapped(name) for design in equal)
            within = DISTINCT * max(first.task.size if first.task.quantities[name].kind != "angle" else 1.0, abs(most))
            equal = [design for design in equal if design.unwrapped(name) >= most - within]
        chosen = replace(equal[0], values={name: equal[0].unwrapped(name) for name in equal[0].values})
        return replace(self, designs=(chosen, *(design for design in self.designs if design is not equal[0])))

    def with_best(self, **changes: Any) -> Self:
        """Return the result with other fields of its best valid design."""
        return replace(self, designs=(replace(self.designs[0], **changes), *self.designs[1:])) if self.designs else self

    def with_checks(self, checks: Sequence[Check]) -> Self:
        """Return the result with further checks of its designs, in order; designs that fail one are no longer valid."""
        flagged = [replace(design, validation=design.validation.with_checks(checks)) for design in self.designs]
        good = tuple(design for design in flagged if design.valid)
        nearest = next((design for design in flagged if not design.valid), self.nearest)
        return replace(self, designs=good, nearest=None if good else nearest)
