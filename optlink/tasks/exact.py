"""Find all linkages that meet targets exactly: poses, points, both, timed points, or points of a function."""

import cmath
import itertools
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from optlink.errors import InputError, given_as
from optlink.linkage.mechanism import Arm
from optlink.problem.arguments import typed
from optlink.problem.design import DesignProblem
from optlink.problem.file import AnyProblem, ProblemFile, problem_of
from optlink.problem.requirements.base import pose_angles
from optlink.problem.terms import QUANTITIES, Goal, read_words
from optlink.synthesis.five_poses import ONE_CENTRE, TRANSLATED, FourBarSolution, link, special
from optlink.synthesis.four_poses import POSES
from optlink.synthesis.poses_and_points import four_bars
from optlink.synthesis.start_problems import COUNTS, FIVE_POINTS
from optlink.tasks.five_targets import CONDITIONS, FiveTargets, alone, loop_of, marked, places_of
from optlink.tasks.four_poses import CHEAP
from optlink.tasks.results.design import NO_SEARCH, SynthesisResult, of_designs
from optlink.tasks.results.exact import ExactSolutions
from optlink.units import count_noun

SAME_POINT = 1e-10  # distance of points that are one, relative to that of others
REPEATED_POINT = "points {} and {} are the same: infinitely many four-bars pass through the others"
ONE_JOINT = "the body turns about one point in all poses: infinitely many four-bars have a joint there"
NUMBERS = ("", "one", "two", "three", "four", "five", "six", "seven", "eight")
ON_GIVEN_PIVOTS = 5  # dimensions of a four-bar with a point, besides its pivots, and conditions of as many points


class PosesAndPoints(FiveTargets):
    """The exact solutions of poses and points without timing, nine points, or five points if the pivots are given."""

    def _solved(self) -> tuple[ExactSolutions, Sequence[FourBarSolution]]:
        """Return the numbers of roots, and the real four-bars, each driven at either link unless the pivots are given."""
        places, posed = places_of(self.task), self.task.target_points.posed
        pivots = given_pivots(self.task) if len(places) == ON_GIVEN_PIVOTS else None
        wanted = pose_angles(self.task.data.columns)[posed] if posed.any() else np.zeros(1)
        poses, either = len(wanted), pivots is None
        kind = f"{NUMBERS[poses]} poses and {NUMBERS[len(places) - poses]} points"
        if poses == 1:
            kind = "nine points" if either else "five points and both pivots"
        counted = "triples of cognates" if poses == 1 and either else "four-bars"
        counts = ExactSolutions(kind, 0, 0, 0, 0, "", either, (), counted=counted)
        for i, j in itertools.combinations(range(len(places)), 2):
            same = abs(places[i] - places[j]) <= SAME_POINT * np.max(np.abs(places - places[0]))
            if same and not (posed[i] and posed[j]):
                return replace(counts, special=REPEATED_POINT.format(i + 1, j + 1)), ()
        relative = (places - places[0])[posed] / np.max(np.abs(places - places[0]))
        if poses > 2 and (sentence := special(relative, wanted)) and (poses == POSES or sentence == TRANSLATED):
            return replace(counts, special=ONE_JOINT if sentence == ONE_CENTRE else sentence), ()
        order = np.argsort(~posed, kind="stable")  # poses first
        found, back = four_bars(places[order], wanted, pivots=pivots), np.argsort(order)
        pairs = []
        for joints, ends, turned in zip(found.joints, found.pivots, found.angles, strict=True):
            angles = np.unwrap(turned[back])
            first = places[0] + np.exp(1j * (angles[0] - turned[0])) * (joints - places[order[0]])
            one, other = (link(*both, found.size) for both in zip(first, ends, strict=True))
            pairs += [FourBarSolution(*links, places, angles) for links in ((one, other), (other, one))[: 1 + either]]
        real = found.real
        return replace(counts, real=real, certified=real, complex=found.found - real, roots=found.expected), pairs


def given_pivots(task: DesignProblem) -> tuple[complex, complex] | None:
    """Return the pivots [m] of a four-bar, the crank's first; None if they are not all fixed."""
    loop, quantities = task.four_bar, task.quantities
    if loop is None or not all(quantities[name].fixed for name in loop.ground):
        return None

    def values(*sizes: str | float) -> Iterator[float]:
        return (quantities[size].value if isinstance(size, str) else size for size in sizes)

    one, other = loop.pivots
    assert not isinstance(one, Arm)
    pivot = complex(*values(*one))
    if isinstance(other, Arm):
        return pivot, pivot + cmath.rect(*values(other.length, other.direction))
    return pivot, complex(*values(*other))


def poses_and_points(task: DesignProblem) -> bool:
    """Return whether a problem of a four-bar with free timing has finitely many exact solutions that take seconds."""
    kind, posed = task.requirement.kind, task.target_points.posed
    if kind not in ("path", "motion") or task.timing != "free" or task.meets_again or not marked(task):
        return False
    count, poses = len(posed), max(1, int(posed.sum()))
    if kind == "path" and given_pivots(task) is not None:
        return alone(task, ON_GIVEN_PIVOTS) and len(task.free) >= ON_GIVEN_PIVOTS
    number = CONDITIONS - (kind == "path")  # the angle of the poses on the coupler is one more
    return alone(task, count) and (poses, count - poses) in COUNTS.keys() - {FIVE_POINTS} and len(task.free) >= number


def _ranking(problem: ProblemFile, text: str) -> Goal:
    """Return the quantity of the machine that a text names."""
    keys = read_words(text)
    if keys is None:
        remedy = f'Write for example "total length" or "least transmission angle at C"; known: {", ".join(QUANTITIES)}'
        raise InputError("not a quantity of the machine", remedy, problem.file, "--by", text)
    keys.setdefault("sense", "maximise" if keys.get("measure") == "least" else "minimise")
    weights = {} if problem.spec.requirement.limited else {"requirement.weight": 1.0, "requirement.scale": None}
    with given_as(problem.file, "--by", text):
        return problem.override({**weights, "objective": {"terms": [keys]}}).spec.goals[0]


def listing(problem: ProblemFile) -> type[FiveTargets] | None:
    """Return what lists the exact solutions of a problem; None for infinitely many, or too many to list."""
    task = problem.variants()[0].spec
    return next((kind for kind, suits in (*CHEAP, (PosesAndPoints, poses_and_points)) if suits(task)), None)


TIMED = "timed point"
KNOWN = {
    "position": "Give 4 or 5 positions (one more than `points` with even spacing) and no start values, or 3 and both",
    "pose": "Give 4 or 5 poses, 4 with 2 points, 3 with 4 or 2 with 6, or 2 or 3 poses and both pivots or both moving points",
    TIMED: "Give 4 or 5 points that are timed from a free start",
    "point": "Give 9 points, or 5 and both pivots",
}
"""What determines a four-bar or a family of them, by what the targets are."""


def _refusal(task: DesignProblem) -> tuple[str, str]:
    """Return why the solutions of a problem are not listed, and what would be."""
    leave = "or leave out --all and requirement.exact, for a search"
    pointed = task.law_given or task.requirement.kind in ("path", "motion")
    if not pointed or len(task.parts) != 1 or task.requirements or task.robust is not None:
        return (
            "there is a list of exact solutions of poses, points, or positions of an output alone",
            f"State one such requirement, {leave}",
        )
    if (loop := loop_of(task)) is None:
        return (
            "there is a list of exact solutions of four-bars alone, and of slider-cranks for a slide",
            f"Choose such a linkage, {leave}",
        )
    kind = {"motion": "pose", "path": "point" if task.timing == "free" else TIMED}.get(task.requirement.kind, "position")
    if task.everywhere:
        return (
            "there is no list of exact solutions of a law that is approximated everywhere",
            f"Give 3 to 5 precision points, {leave}",
        )
    if kind == TIMED and task.meets_again:
        return "there is no list of exact solutions of points that the linkage passes twice", f"Remove the second one, {leave}"
    needed = {task.start_name, task.base_name, *loop.names} if task.law_given else task.quantities.keys()
    given = [name for name in task.quantities if name in needed and name not in task.free]
    fixed, count = f" with {', '.join(given)} given" if given else "", count_noun(len(task.data.columns), kind)
    return f"there is no list of exact solutions of {count}{fixed}", f"{KNOWN[kind]}, with all else free; {leave}"


@typed
def exact(problem: AnyProblem, by: str | None = None) -> SynthesisResult:
    """Find all linkages that meet the targets of a problem exactly, and tell of each why it is usable or not.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        A four-bar for five poses with free timing, five points timed from a free start, five points of a law or function with
        free start angles; with free timing four poses and two points, three and four, two and six, nine points, or five with
        fixed pivots; or a slider-crank for five points of a law of its slide. All other dimensions are design variables. Of four
        poses, timed points or points of a law, which a family of linkages meets, the best ones are listed; two or three poses
        need both pivots, or both moving points, fixed, three points of a law both start values.
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
    kind = listing(problem)
    if kind is None:
        message, remedy = _refusal(problem.variants()[0].spec)
        raise InputError(message, remedy, problem.file, "requirement")
    clock = time.perf_counter()
    targets = kind(problem.variants(), None if by is None else _ranking(problem, by))
    designs = [design for _, design in targets.usable]
    nearest = next((one.design for one in targets.found if one.design is not None), None)
    shown = designs or ([] if nearest is None else [nearest])
    seconds = {"solve and validate": time.perf_counter() - clock}
    result = SynthesisResult(problem, (), None, NO_SEARCH, seconds)
    if shown:
        result = replace(of_designs(problem, shown, len(shown), seconds=seconds), designs=tuple(designs))
    summary = targets.summary
    return replace(result, exact_solutions=summary, notes=(summary.sentence,))
