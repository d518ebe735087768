"""Find all linkages that meet targets exactly: five or four poses, five timed points or points of a function, or nine points."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from optlink.errors import InputError
from optlink.problem.arguments import typed
from optlink.problem.design import DesignProblem
from optlink.problem.file import AnyProblem, ProblemFile, problem_of
from optlink.problem.terms import QUANTITIES, Goal, read_words
from optlink.synthesis.five_poses import FourBarSolution, link
from optlink.synthesis.poses_and_points import four_bars
from optlink.tasks.five_targets import FiveTargets, alone, marked
from optlink.tasks.four_poses import CHEAP
from optlink.tasks.results.design import NO_SEARCH, SynthesisResult, of_designs
from optlink.tasks.results.exact import ExactSolutions

SAME_POINT = 1e-10  # distance of points that are one, relative to that of others
REPEATED_POINT = "points {} and {} are the same: infinitely many four-bars pass through the others"


class NinePoints(FiveTargets):
    """The exact solutions of a path of nine points without timing."""

    def _solved(self) -> tuple[ExactSolutions, Sequence[FourBarSolution]]:
        """Return the numbers of triples of cognates, and the real four-bars, each driven at either link."""
        points = self.task.data.columns
        places = points[:, 0] + 1j * points[:, 1]
        kind, counted, pairs = "nine points", "triples of cognates", list[FourBarSolution]()
        for i, j in itertools.combinations(range(len(places)), 2):
            if abs(places[i] - places[j]) <= SAME_POINT * np.max(np.abs(places - places[0])):
                return ExactSolutions(kind, 0, 0, 0, 0, REPEATED_POINT.format(i + 1, j + 1), True, ()), pairs
        found = four_bars(places)
        for joints, pivots, angles in zip(found.joints, found.pivots, found.angles, strict=True):
            one, other = (link(*ends, found.size) for ends in zip(joints, pivots, strict=True))
            pairs += [FourBarSolution(*links, places, angles) for links in ((one, other), (other, one))]
        real, complex_ones = found.real, found.found - found.real
        counts = ExactSolutions(kind, real, real, complex_ones, 0, "", True, ())
        return replace(counts, roots=found.expected, counted=counted), pairs


def nine_points(task: DesignProblem) -> bool:
    """Return whether a problem has finitely many exact solutions that take seconds: nine points of a four-bar, free timing."""
    return (
        alone(task, 9)
        and marked(task)
        and (task.requirement.kind, task.timing) == ("path", "free")
        and len(task.free) >= 9
        and not task.meets_again
    )


def _ranking(problem: ProblemFile, text: str) -> Goal:
    """Return the quantity of the machine that a text names."""
    keys = read_words(text)
    if keys is None:
        remedy = f'Write for example "total length" or "least transmission angle at C"; known: {", ".join(QUANTITIES)}'
        raise InputError("not a quantity of the machine", remedy, problem.file, "--by", text)
    keys.setdefault("sense", "maximise" if keys.get("measure") == "least" else "minimise")
    weights = {} if problem.spec.requirement.limited else {"requirement.weight": 1.0, "requirement.scale": None}
    try:
        goal: Goal = problem.override({**weights, "objective": {"terms": [keys]}}).spec.goals[0]
    except InputError as error:
        fault = error.faults[0]
        raise InputError(fault.message, fault.remedy, problem.file, "--by", text) from None
    return goal


@typed
def exact(problem: AnyProblem, by: str | None = None) -> SynthesisResult:
    """Find all linkages that meet the targets of a problem exactly, and tell of each why it is usable or not.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        A four-bar for five poses with free timing, five points timed from a free start, five points of a law or function with
        free start angles, or nine points with free timing; or a slider-crank for five points of a law of its slide. All
        dimensions are design variables. Of four poses, which two dyads of a curve meet, the best four-bars are listed; two or
        three poses need both pivots, or both moving points, fixed.
    by : str, optional
        Quantity of the machine that ranks them, in words: "total length", "peak acceleration of P", "maximise stroke of rocker".
        By default that of the objective of the file; without one, the transmission angle.

    Returns
    -------
    SynthesisResult
        `designs`: all usable ones, the best one first; `exact_solutions`: all, with the reasons.

    Raises
    ------
    InputError
        If the problem is of another kind, whose solutions are infinitely many or too many to list; or for an unknown quantity.

    Examples
    --------
    >>> result = optlink.synthesis.exact("motion-5-poses")
    >>> result.exact_solutions.real, len(result.exact_solutions.solutions)
    (4, 12)
    """
    problem = problem_of(problem)
    task = problem.variants()[0].spec
    kind = next((kind for kind, suits in (*CHEAP, (NinePoints, nine_points)) if suits(task)), None)
    if kind is None:
        message = (
            "only four or five poses, two or three with given pivots or moving points, five timed points or points of a "
            "function, and nine points have listed exact solutions"
        )
        remedy = (
            "Give as many targets, with all dimensions and the start of the timing free; or leave out --all and requirement.exact"
        )
        raise InputError(message, remedy, problem.file, "requirement")
    clock = time.perf_counter()
    targets = kind(problem.variants(), None if by is None else _ranking(problem, by))
    designs = [design for _, design in targets.usable]
    nearest = next((one.design for one in targets.found if one.design is not None), None)
    shown = designs or ([] if nearest is None else [nearest])
    seconds = {"solve and validate": time.perf_counter() - clock}
    result = SynthesisResult(problem, (), None, NO_SEARCH, seconds)
    if shown:
        result = of_designs(problem, shown, len(shown), seconds=seconds)
        result = replace(result, designs=tuple(designs))
    summary = targets.summary
    return replace(result, exact_solutions=summary, notes=(summary.sentence,))
