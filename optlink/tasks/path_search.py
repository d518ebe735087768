"""Polish what the rounds of a search find, with every limit, and collect the distinct valid designs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from optlink.errors import Status
from optlink.problem.file import ProblemFile
from optlink.problem.path import GenerationProblem
from optlink.solvers.evidence import Evidence, evidence
from optlink.solvers.solution import Solution
from optlink.tasks.path_result import Design
from optlink.tasks.result import OPTIMALITY_CHECK, optimality
from optlink.validation.path import validate_generation

if TYPE_CHECKING:
    from optlink.optimization.nlp import NLP
    from optlink.synthesis.batch_search import Candidate, Exploration

TRIES = 6  # candidates of the first round that are polished per requested design, while too few are valid
PER_ROUND = 10  # candidates polished in a later round
REPAIRED = 2  # candidates of a round that were put in order, and those polished in vain, in a later round
COMPOUND_TRIES = 4  # candidates of the first round that are polished in vain, of a linkage of several dyads: each takes seconds
FAR_TRIES = 3  # candidates of a later round that are polished whatever they cost, and of the repaired ones, while the fit is poor
COMPARABLE = 1.5  # error, as a multiple of the least one, up to which optima are counted: a better one would be among them
SAME = 1e-6  # relative difference of two objectives that are the same
ROUNDING = 1e-9  # the same of one coupler curve of two linkages


def model(file: ProblemFile) -> GenerationProblem:
    """The model of a path or motion problem."""
    assert isinstance(file.model, GenerationProblem)
    return file.model


def compound(task: GenerationProblem) -> bool:
    """Whether a linkage has several dyads."""
    return len(task.linkage.groups) > 1


class Polisher:
    """From candidates to designs: the programme with every limit, built once per assembly mode and direction of the crank."""

    def __init__(self, files: list[ProblemFile], backend: str) -> None:
        self.files, self.backend = files, backend
        self.programmes: dict[tuple[int, int], NLP] = {}

    def programme(self, variant: int, direction: int) -> NLP:
        """The programme of a variant."""
        from optlink.optimization.path_nlp import build_generation

        key = (variant, direction if model(self.files[variant]).data.offsets is None else 1)
        if key not in self.programmes:
            self.programmes[key] = build_generation(model(self.files[variant]), key[1])
        return self.programmes[key]

    def polish(self, candidate: Candidate, *, near: bool = False) -> Design:
        """The nearest optimum with every limit, validated; `near` where the candidate itself keeps its limits everywhere."""
        from optlink.solvers import multistart as local
        from optlink.solvers.path_exchange import search_everywhere

        file, start = self.files[candidate.variant], self._given(candidate)
        task, minimax = model(file), model(file).measure == "max"
        solution = search_everywhere(task, start, local.MINIMAX if minimax else self.backend, near=near)
        if minimax and solution.status is not Status.OPTIMAL:
            solution = local.best([solution, search_everywhere(task, start, self.backend, near=near)])
        if minimax and start.usable and solution.objective > start.objective * (1.0 + 1e-9):
            solution = replace(solution, status=Status.STALLED)  # an optimum, but not the one beside the start
        return proven(file, start.nlp, solution)

    def unpolished(self, candidate: Candidate) -> Design:
        """The candidate itself, validated: a feasible design where it keeps its limits everywhere."""
        start = self._given(candidate)
        return feasible(proven(self.files[candidate.variant], start.nlp, start))

    def _given(self, candidate: Candidate) -> Solution:
        """A candidate as a point of its programme."""
        from optlink.solvers import multistart as local

        nlp = self.programme(candidate.variant, candidate.direction)
        own = model(self.files[candidate.variant]).data.offsets is None
        x = np.concatenate([candidate.x, candidate.t]) if own else candidate.x
        if len(nlp.variables) > len(x):
            x = np.append(x, 0.0)  # the largest deviation; `given` lifts it
        return local.given(nlp, np.clip(x, nlp.x_low, nlp.x_high), "found by least squares")


def feasible(design: Design) -> Design:
    """A design that is not proven to be an optimum, as one that need only meet all limits."""
    checks = tuple(check for check in design.validation.checks if check.name != OPTIMALITY_CHECK)
    proof = replace(design.validation, checks=checks)
    return replace(design, status=Status.FEASIBLE, validation=proof, solution=None)  # its limits have no prices


def proven(file: ProblemFile, nlp: NLP, solution: Solution) -> Design:
    """A solution of the programme as a design with its proof."""
    task = model(file)
    values = {name: quantity.value for name, quantity in task.quantities.items()}
    values |= {name: solution.design[name] for name in task.free}
    free = len(task.free)
    own = solution.x[free : free + len(task.data.columns)] if task.data.offsets is None else None
    angles = task.crank_angles(values, own)
    proof = validate_generation(task, values, angles, solution.objective)
    proof = replace(proof, checks=(*proof.checks, *optimality(solution)))
    return Design(file, values, angles, solution.objective, solution.status, proof, solution)


class Collection:
    """Distinct valid designs, best first, and the optima that every polished candidate led to.

    Candidates are polished after every round, so that what a search of few rounds collects is a part of what a longer one with
    the same seed does: more starts never give a worse design.

    Parameters
    ----------
    polisher : Polisher
    requested : int
        Number of distinct designs.
    """

    def __init__(self, polisher: Polisher, requested: int) -> None:
        self.polisher, self.requested = polisher, requested
        self.designs: list[Design] = []
        self.nearest: Design | None = None
        self._ends: dict[Candidate, Design] = {}
        self._tries = COMPOUND_TRIES if compound(model(polisher.files[0])) else PER_ROUND
        self._vain = (COMPOUND_TRIES, 1) if compound(model(polisher.files[0])) else (TRIES * requested, REPAIRED)
        self._first = True

    @property
    def exact(self) -> int:
        """Number of distinct designs that pass everything."""
        return sum(design.exact for design in self.designs)

    def add(self, found: Exploration) -> None:
        """Polish what the latest round found."""
        vain = self._vain[0] if self._first else self._vain[1]
        far = FAR_TRIES if self.far and not self._first else 0
        self._follow(found.candidates, vain if self._first else self._tries, max(vain, far), far)
        if far:
            self._follow(found.repaired[:: max(1, len(found.repaired) // far)], far, far, far)
        elif not self.exact:
            self._follow(found.repaired, self._vain[1] if self.designs else vain, vain)
        self._first = False

    @property
    def far(self) -> bool:
        """Whether the best design fits poorly: the order of the points then decides, and costs without it say little."""
        if not self.designs or compound(self.designs[0].task):
            return False
        fit = self.designs[0].fit
        return fit is not None and fit.grade == "poor"

    def _follow(self, candidates: list[Candidate], tries: int, vain: int, dear: int = 0) -> None:
        """Polish candidates in turn: `tries` at most, `vain` of them without a valid design, `dear` beyond the largest cost."""
        from optlink.synthesis.batch_search import PERFECT

        for candidate in candidates:
            if candidate in self._ends:
                continue
            beyond = candidate.cost > self._dearest()
            if not tries or not vain or (beyond and not dear):
                break
            dear -= beyond
            if self.exact and candidate.cost > PERFECT:
                break  # beside a design that passes everything, no other one counts
            design = self._ends[candidate] = self.polisher.polish(candidate)
            tries -= 1
            if design.valid:
                self.insert(design)
            else:
                vain -= 1
                self.nearest = min(filter(None, (self.nearest, design)), key=_failing)

    def _dearest(self) -> float:
        """Largest cost of a candidate that is worth polishing: limits only add to it."""
        if len(self.designs) < self.requested:
            return math.inf
        return max(_cost(self.designs[0]) * COMPARABLE**2, _cost(self.designs[-1]))

    def no_worse(self, other: Design) -> bool:
        """Whether the best design is as good as another design of the same curve, but for rounding."""
        return any(as_good(design, other) for design in self.designs[:1])

    def insert(self, design: Design) -> None:
        """Add a valid design, unless a better one is alike."""
        alike = next((known for known in self.designs if design.alike(known)), None)
        if alike is not None:
            if _rank(design) >= _rank(alike):
                return
            self.designs.remove(alike)
        self.designs.append(design)
        self.designs.sort(key=_rank)
        del self.designs[self.requested :]

    def evidence(self) -> Evidence:
        """How many starts reached the best optimum, and how likely a better one was missed.

        Counted are the starts whose polished designs are valid and come near the best one (`COMPARABLE`): a better optimum would
        be one of these.
        """
        ends = sorted(((d.error, c.count) for c, d in self._ends.items() if d.valid), key=lambda end: end[0])
        if not ends:
            return evidence(())
        best = self.designs[0]
        level = 0.0 if best.exact else best.error
        values: list[float] = []
        counts: list[int] = []
        if ends[0][0] > level * (1.0 + SAME) and not (best.exact and ends[0][0] <= best.level):
            values, counts = [level], [1]  # no random start reached the best design: it was grown, from one start
        for error, count in ends:
            value = 0.0 if best.exact and error <= best.level else error
            if value > COMPARABLE * level:
                break
            if values and value <= values[-1] * (1.0 + SAME):
                counts[-1] += count
            else:
                values.append(value)
                counts.append(count)
        told = evidence(counts)
        return replace(told, missed=0.0) if best.exact else told  # nothing is better than an exact design


def as_good(design: Design, other: Design) -> bool:
    """Whether a design is no worse than another one for the same points, but for rounding."""
    return design.exact or design.error <= other.error * (1.0 + ROUNDING)


def _cost(design: Design) -> float:
    """The cost of a candidate of the batch that has the error of a design, at most."""
    task = design.task
    share = (design.error / task.whole) ** 2
    return share if task.measure == "sum of squares" else share * len(task.data.columns)


def _failing(design: Design) -> tuple[int, float]:
    return sum(not check.passed for check in design.validation.checks), design.objective


def _rank(design: Design) -> tuple[float, float]:
    """By objective; those that pass the points exactly by their worst transmission angle, best first."""
    transmission = design.least_transmission
    return (0.0 if design.exact else design.objective), -(transmission if math.isfinite(transmission) else 0.0)
