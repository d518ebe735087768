"""From points or poses to proven designs: search in one batch, polish with all limits, prove, rank."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from optlink.design.files import ProblemFile
from optlink.design.generation import GenerationProblem
from optlink.design.quantity import nearest
from optlink.errors import Fault, InputError, Status
from optlink.generated import Design, Generation
from optlink.outcome import optimality
from optlink.solvers.solution import Solution
from optlink.validation.generation import validate_generation

if TYPE_CHECKING:
    from optlink.design.nlp import NLP
    from optlink.synthesis.search import Candidate, Exploration

MAX_STARTS = 1_000_000
MOST_DESIGNS = 50
TRIES = 6  # candidates polished per design that is wanted


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
        Polishes what the batch finds, with every limit; `optlink.solvers.minimax` does where the largest deviation counts.
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
        backend=local.MINIMAX if _task(problem).measure == "max" else backend,
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
        solution = local.solve_from(nlp, start.x, local.MINIMAX if minimax else self.backend)
        if minimax and solution.status is not Status.OPTIMAL:
            solution = local.best([solution, local.solve_from(nlp, start.x, self.backend)])
        if minimax and start.usable and solution.objective > start.objective * (1.0 + 1e-9):
            solution = replace(solution, status=Status.STALLED)  # an optimum, but not the one beside the start
        return proven(file, nlp, solution)


def proven(file: ProblemFile, nlp: NLP, solution: Solution) -> Design:
    """A solution of the programme as a design with its proof."""
    task = _task(file)
    values = {name: quantity.value for name, quantity in task.quantities.items()}
    values |= {name: solution.design[name] for name in task.free}
    free = len(task.free)
    own = solution.x[free : free + len(task.data.columns)] if task.data.offsets is None else None
    angles = task.crank_angles(values, own)
    proof = validate_generation(task, values, angles, solution.objective)
    proof = replace(proof, checks=(*proof.checks, *optimality(solution)))
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
            if designs and designs[0].exact and candidate.cost > PERFECT:
                break  # beside a design that passes everything nobody wants one that does not
            design = polisher.polish(candidate)
            if not design.valid:
                misses.append(design)
            elif not any(design.alike(known) for known in designs):
                designs.append(design)

    follow(found.candidates, TRIES * wanted)
    if not (designs and designs[0].exact):
        better = found.candidates[len(designs) - 1].cost if len(designs) >= wanted else math.inf
        follow([c for c in found.repaired if c.cost < better], (2 if designs else TRIES) * wanted)
    designs.sort(key=_rank)
    misses.sort(key=lambda d: (sum(not check.passed for check in d.validation.checks), d.objective))
    return designs[:wanted], (misses[0] if misses else None)


def _rank(design: Design) -> tuple[float, float]:
    """By objective; those that pass the points exactly by their worst transmission angle, best first."""
    transmission = design.least_transmission
    return (0.0 if design.exact else design.objective), -(transmission if math.isfinite(transmission) else 0.0)
