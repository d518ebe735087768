"""From points or poses to proven designs: search in one batch, polish with all limits, prove, rank."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from optlink.design.files import ProblemFile
from optlink.design.generation import START, TURN, GenerationProblem
from optlink.design.linkages import FourBarSection
from optlink.design.quantity import nearest
from optlink.design.settled import settled
from optlink.documents import finite, head
from optlink.errors import Fault, InputError, Status
from optlink.linkage.cognates import Cognate, CouplerLinkage, cognates
from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.groups import RRR
from optlink.linkage.motion import sweep
from optlink.linkage.refine import extremes
from optlink.solvers.solution import FEASIBLE, STATIONARY, LimitState, Solution
from optlink.units import KINDS, factor
from optlink.validation.check import Check, Validation
from optlink.validation.generation import Deviations, deviations, transmission_angles, validate_generation

if TYPE_CHECKING:
    from optlink.design.nlp import NLP
    from optlink.synthesis.search import Candidate, Exploration

SCHEMA = "optlink/generation/1"
MAX_STARTS = 1_000_000
MOST_DESIGNS = 50
TRIES = 6  # candidates polished per design that is wanted
DISTINCT = 1e-2  # least difference of two designs, as a share of their size
LEVEL = 1e-9  # of the size: root of a sum of squares below which a design passes the points

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Design:
    """One design with its proof.

    `problem` has definite assembly modes; `values` are all quantities [m, rad], `crank_angles` (points,) [rad] those at which
    the points are met; `objective` in the unit of the measure, SI.
    """

    problem: ProblemFile
    values: dict[str, float]
    crank_angles: Array
    objective: float
    status: Status
    validation: Validation
    solution: Solution | None = None

    @property
    def task(self) -> GenerationProblem:
        """The model of the problem."""
        assert isinstance(self.problem.model, GenerationProblem)
        return self.problem.model

    @property
    def valid(self) -> bool:
        """Whether the design is proven, and an optimum if one was searched."""
        return self.status in (Status.OPTIMAL, Status.NOT_SEARCHED) and self.validation.valid

    @cached_property
    def measured(self) -> Deviations:
        """Generated points and how far they miss the wanted ones."""
        return deviations(self.task, self.values, self.crank_angles)

    @property
    def turns(self) -> bool:
        """Whether the crank turns fully."""
        return self.task.limits.crank != "span"

    @cached_property
    def least_transmission(self) -> float:
        """How far the worst transmission angle of the needed motion is from 0 and 180 deg [rad]; NaN if there is none."""
        begin, end = (0.0, TURN) if self.turns else sorted((float(self.crank_angles[0]), float(self.crank_angles[-1])))
        groups = [group for group in self.task.linkage.groups if isinstance(group, RRR)]

        def cosines(angles: Array) -> Array:  # smooth, other than the angles, which turn back sharply near 0 and pi
            gamma = transmission_angles(sweep(self.task.linkage, self.values, angles), self.task.linkage)
            return np.cos(gamma).T

        grid = np.linspace(begin, end, 721)
        if not groups or not np.all(np.isfinite(cosines(grid))):
            return math.nan
        return math.acos(min(float(np.max(np.abs(extremes(cosines, grid)[1]))), 1.0))

    @cached_property
    def cognates(self) -> tuple[Cognate, ...]:
        """The other four-bars with the same coupler curve, those whose crank turns fully first; none of other mechanisms."""
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
        """The linkage alone as a problem with every size fixed: what `analyze`, `simulate` and pictures take."""
        return settled(self.problem, self.values)

    @property
    def assembly(self) -> object:
        """Assembly modes, as the problem file words them."""
        return self.problem.raw["mechanism"].get("assembly", "left")

    def to_dict(self) -> dict[str, Any]:
        """The design as a JSON object: SI, or the unit that a key ends in."""
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
                f"{name}_{people_unit(self.task, name)[1]}": v for name, v in people_design(self.task, self.values).items()
            },
            "objective": {"value": self.objective, **_figures(self)},
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
        """Every bound and limit as people read it."""
        return self.solution.limits if self.solution is not None else ()


def _cognate(cognate: Cognate) -> dict[str, Any]:
    linkage = cognate.linkage
    lengths = {f"{name}_mm": 1e3 * getattr(linkage, name) for name in (*LENGTHS, "along", "across")}
    place = {"A.x_mm": 1e3 * linkage.x, "A.y_mm": 1e3 * linkage.y, "direction_deg": math.degrees(linkage.direction)}
    kind = {"inversion": cognate.inversion.value, "crank_turns": cognate.crank_turns, "keeps_side": cognate.keeps_side}
    return {**lengths, **place, "side": linkage.side, **kind, "turns_as": cognate.turns_as}


def people_unit(task: GenerationProblem, name: str) -> tuple[float, str]:
    """Factor from SI and unit in which people read a quantity of a design."""
    unit = KINDS[task.quantities[name].kind].people
    return 1.0 / factor(unit, task.quantities[name].kind), unit


def people_design(task: GenerationProblem, values: Mapping[str, float]) -> dict[str, float]:
    """A design in the units of `people_unit`."""
    return {name: values[name] * people_unit(task, name)[0] for name in task.quantities}


OUTPUT = {"m": (1e3, "mm"), "rad": (math.degrees(1.0), "deg"), "": (1.0, "")}
"""Factor from SI and unit in which people read deviations."""


def objective_unit(task: GenerationProblem) -> str:
    """SI unit of the objective."""
    return f"{task.unit}^2" if task.measure == "sum of squares" and task.unit else task.unit


def _figures(design: Design) -> dict[str, Any]:
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


@dataclass(frozen=True, eq=False)
class Generation:
    """What a search for points or poses brought: designs, best first, each proven; or the nearest miss and why it fails."""

    problem: ProblemFile
    designs: tuple[Design, ...]
    nearest: Design | None
    backend: str
    seed: int
    starts: int
    hits: int
    seconds: dict[str, float]
    interrupted: bool = False
    notes: tuple[str, ...] = field(default=())

    @property
    def valid(self) -> bool:
        """Whether a proven design was found."""
        return bool(self.designs)

    @property
    def best(self) -> Design | None:
        """The best proven design; the nearest miss if there is none; None if no linkage reaches the points at all."""
        return self.designs[0] if self.designs else self.nearest

    @property
    def status(self) -> Status:
        """How the search ended."""
        return Status.INFEASIBLE if self.best is None else self.best.status

    @property
    def objective(self) -> float:
        """Objective of the best design [SI]; NaN if there is none."""
        return math.nan if self.best is None else self.best.objective

    def to_dict(self) -> dict[str, Any]:
        """The result as a JSON document."""
        document = head(SCHEMA, self.problem, self.status.value, self.seed)
        document |= {
            "message": self.status.text,
            "valid": self.valid,
            "notes": list(self.notes),
            "backend": self.backend,
            "starts": self.starts,
            "starts_that_reached_the_best": self.hits,
            "seconds": self.seconds,
        }
        if self.best is not None:
            document["design"] = self.best.to_dict()["design"]
            document["assembly"] = self.best.assembly
        document["designs"] = [design.to_dict() for design in self.designs]
        document["nearest_miss"] = None if self.nearest is None or self.designs else self.nearest.to_dict()
        return finite(document)  # type: ignore[no-any-return]


def variants_of(problem: ProblemFile) -> list[ProblemFile]:
    """The problem with definite assembly modes: one for each combination that the file leaves open."""
    changes = problem.model.mechanism.variants(problem.model.linkage)
    return [problem.override(change) if change else problem for change in changes]


def generate(
    problem: ProblemFile,
    backend: str = "ipopt",
    starts: int | None = None,
    seed: int = 0,
    designs: int = 3,
    progress: Callable[[float], None] | None = None,
) -> Generation:
    """Find linkages that pass the points or take the poses, and prove them.

    Parameters
    ----------
    problem : ProblemFile
        From `optlink.load`, with a requirement of the kind "path" or "motion".
    backend : "slsqp" or "ipopt"
        Polishes what the batch finds, with every limit.
    starts : int, optional
        Of the batch; if not given, as many as it takes for the best value to come up several times.
    seed : int
    designs : int
        Distinct designs that are wanted.
    progress : function of the share that is done, optional

    Raises
    ------
    InputError
        when nothing is free, or an argument is out of range.
    """
    from optlink.solvers import search as local

    if backend not in local.BACKENDS:
        raise InputError(Fault("unknown back end", nearest(backend, local.BACKENDS), key="backend", value=backend))
    if starts is not None and not 1 <= starts <= MAX_STARTS:
        raise InputError(Fault("out of range", f"Give a number from 1 to {MAX_STARTS}", key="starts", value=starts))
    if seed < 0:
        raise InputError(Fault("a seed is not negative", "Give 0 or more", key="seed", value=seed))
    if not 1 <= designs <= MOST_DESIGNS:
        raise InputError(Fault("out of range", f"Give a number from 1 to {MOST_DESIGNS}", key="designs", value=designs))
    if not problem.model.free:
        example = 'Free one: coupler = { bounds = ["100 mm", "900 mm"] }, or check the design: optlink validate'
        raise InputError(Fault("nothing is free, there is nothing to find", example, problem.file, "mechanism"))
    from optlink.synthesis.search import Searcher

    local.backend(backend)
    clock = [time.perf_counter()]
    files = variants_of(problem)
    searcher = Searcher([_task(file) for file in files], seed)
    clock.append(time.perf_counter())
    found = searcher.explore(starts, designs, progress)
    clock.append(time.perf_counter())
    polisher = _Polisher(files, backend)
    proven, miss = _prove(polisher, found, designs)
    clock.append(time.perf_counter())
    notes = [_task(problem).wanted.note] if _task(problem).wanted.note else []
    if proven and proven[0].objective > 0 and found.hits < 2 and not found.perfect and _task(problem).measure != "max":
        notes.append(f"only {found.hits} of {found.starts} starts reached the best value: more may find a better one (--starts)")
    return Generation(
        problem=problem,
        designs=tuple(proven),
        nearest=miss,
        backend=backend,
        seed=seed,
        starts=found.starts,
        hits=found.hits,
        seconds={name: b - a for name, a, b in zip(("build", "search", "polish and validate"), clock, clock[1:], strict=False)},
        interrupted=found.interrupted,
        notes=tuple(notes),
    )


def validate(problem: ProblemFile, given: Mapping[str, float]) -> Generation:
    """Prove a given design, or show where it fails; where the timing is free, at the crank angles at which it passes best.

    Parameters
    ----------
    problem : ProblemFile
    given : mapping of every free quantity [m, rad]; others may be given too and replace what the file says
    """
    from optlink.validation.passing import passing

    clock = time.perf_counter()
    found = []
    for file in variants_of(problem):
        task = _task(file)
        values = {name: float(given.get(name, quantity.value)) for name, quantity in task.quantities.items()}
        angles, figure = passing(task, values)
        found.append((figure, file, values, angles))
    _, file, values, angles = min(found, key=lambda each: each[0])
    proof = validate_generation(_task(file), values, angles)
    design = Design(file, values, angles, proof.objective, Status.NOT_SEARCHED, proof)
    return Generation(
        problem=problem,
        designs=(design,) if design.valid else (),
        nearest=None if design.valid else design,
        backend="none",
        seed=0,
        starts=0,
        hits=0,
        seconds={"validate": time.perf_counter() - clock},
        notes=tuple(filter(None, [_task(problem).wanted.note])),
    )


def _task(file: ProblemFile) -> GenerationProblem:
    assert isinstance(file.model, GenerationProblem)
    return file.model


class _Polisher:
    """From candidates to designs: the programme with every limit, built once per assembly and direction of the crank."""

    def __init__(self, files: list[ProblemFile], backend: str) -> None:
        self.files, self.backend = files, backend
        self.programmes: dict[tuple[int, int], NLP] = {}

    def programme(self, variant: int, direction: int) -> NLP:
        """The programme of a variant."""
        from optlink.design.generation_nlp import build_generation

        key = (variant, direction if _task(self.files[variant]).data.offsets is None else 1)
        if key not in self.programmes:
            self.programmes[key] = build_generation(_task(self.files[variant]), key[1])
        return self.programmes[key]

    def polish(self, candidate: Candidate) -> Design:
        """The nearest optimum with every limit, proven."""
        from optlink.solvers import search as local

        file = self.files[candidate.variant]
        task, nlp = _task(file), self.programme(candidate.variant, candidate.direction)
        own, minimax = task.data.offsets is None, task.measure == "max"
        x = np.concatenate([candidate.x, candidate.t]) if own else candidate.x
        if len(nlp.variables) > len(x):
            x = np.append(x, 0.0)  # the largest deviation; `given` lifts it
        start = local.given(nlp, np.clip(x, nlp.x_low, nlp.x_high), "found by least squares")
        if start.status is Status.OPTIMAL:
            return proven(file, nlp, start)
        solution = local.solve_from(nlp, start.x, self.backend)
        if minimax and start.usable and not _improves(solution, start):
            (other,) = (name for name in local.BACKENDS if name != self.backend)
            solution = local.best([solution, local.solve_from(nlp, start.x, other)])
            if not _improves(solution, start):  # an optimum, but not the one beside the start
                solution = replace(solution, status=Status.STALLED)
        return proven(file, nlp, solution)


def _improves(solution: Solution, start: Solution) -> bool:
    return solution.status is Status.OPTIMAL and solution.objective <= start.objective * (1.0 + 1e-9)


def proven(file: ProblemFile, nlp: NLP, solution: Solution) -> Design:
    """A solution of the programme as a design with its proof."""
    task = _task(file)
    values = {name: quantity.value for name, quantity in task.quantities.items()}
    values |= {name: solution.design[name] for name in task.free}
    free = len(task.free)
    own = solution.x[free : free + len(task.data.columns)] if task.data.offsets is None else None
    angles = task.crank_angles(values, own)
    proof = validate_generation(task, values, angles, solution.objective)
    checks = (
        *proof.checks,
        Check("all limits met (scaled)", solution.violation <= FEASIBLE, solution.violation, f"<= {FEASIBLE:.0e}", ""),
        Check("optimality (KKT residual)", solution.status is Status.OPTIMAL, solution.kkt, f"<= {STATIONARY:.0e}", ""),
    )
    proof = replace(proof, checks=checks)
    return Design(file, values, angles, solution.objective, solution.status, proof, solution)


def _prove(polisher: _Polisher, found: Exploration, wanted: int) -> tuple[list[Design], Design | None]:
    """Polish candidates, best first, until enough distinct designs are proven; and the best of those that are not."""
    from optlink.synthesis.search import PERFECT

    designs: list[Design] = []
    misses: list[Design] = []

    def follow(candidates: list[Candidate], tries: int) -> None:
        many = len(designs)
        for candidate in candidates[:tries]:
            if len(designs) - many >= wanted:
                break
            if designs and _exact(designs[0]) and candidate.cost > PERFECT:
                break  # beside a design that passes everything nobody wants one that does not
            design = polisher.polish(candidate)
            if not design.valid:
                misses.append(design)
            elif not any(_same(design, known) for known in designs):
                designs.append(design)

    follow(found.candidates, TRIES * wanted)
    if not (designs and _exact(designs[0])):
        better = found.candidates[len(designs) - 1].cost if len(designs) >= wanted else math.inf
        follow([c for c in found.repaired if c.cost < better], (2 if designs else TRIES) * wanted)
    designs.sort(key=_rank)
    misses.sort(key=lambda d: (sum(not check.passed for check in d.validation.checks), d.objective))
    return designs[:wanted], (misses[0] if misses else None)


def _rank(design: Design) -> tuple[float, float]:
    """By objective; those that pass the points exactly by their worst transmission angle, best first."""
    transmission = design.least_transmission
    return (0.0 if _exact(design) else design.objective), -(transmission if math.isfinite(transmission) else 0.0)


def _exact(design: Design) -> bool:
    """Whether a design passes everything but for rounding."""
    error = math.sqrt(max(design.objective, 0.0)) if design.task.measure == "sum of squares" else design.objective
    return error <= LEVEL * design.task.whole


def _same(a: Design, b: Design) -> bool:
    """Whether two designs differ by less than anybody would call another design."""
    if a.assembly != b.assembly:
        return False
    size = a.task.size
    gaps = []
    for name, quantity in a.task.quantities.items():
        gap = abs(a.values[name] - b.values[name])
        if quantity.kind == "angle" or name == START:
            gaps.append(abs(math.remainder(gap, TURN)))
        else:
            gaps.append(gap / max(size, abs(a.values[name])))
    return max(gaps, default=0.0) <= DISTINCT
