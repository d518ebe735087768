"""Starting points for a search of your own: what a search of optlink begins with."""

from collections.abc import Mapping
from dataclasses import dataclass

from optlink.errors import InputError
from optlink.problem.arguments import typed
from optlink.problem.file import AnyProblem, problem_of
from optlink.problem.quantity import check_range
from optlink.tasks.search import mode_of

MOST_ROUNDS = 1000


@dataclass(frozen=True)
class FirstDesign:
    """A design that nearly meets the targets, before limits between the targets and exact optimality are considered.

    `design`: design variables [m, rad] by name; `assembly`: its assembly mode, in the words of the problem file; `cost`: half the
    sum of squared deviations, relative to the size of the task; `count`: how many random starting points converged to it.
    """

    design: Mapping[str, float]
    assembly: str
    cost: float
    count: int


@typed
def starts(problem: AnyProblem, rounds: int = 1, seed: int = 0) -> list[FirstDesign]:
    """Return distinct first designs of a problem with targets, best first: random designs after batched least squares.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        With a requirement that has targets: a motion law, points, poses.
    rounds : int
        Number of rounds of random starting points; the designs of fewer rounds are a part of those of more.
    seed : int

    Returns
    -------
    list of FirstDesign

    Raises
    ------
    InputError
        If the problem has no targets, or an argument is out of range.

    Examples
    --------
    >>> first = optlink.synthesis.starts("path-arc5")[0]
    >>> sorted(first.design) == sorted(optlink.load("path-arc5").model.free), first.cost < 1e-3
    (True, True)
    """
    from optlink.optimization.parameters import path_variable
    from optlink.synthesis.batch_search import Searcher

    problem = problem_of(problem)
    check_range("rounds", rounds, 1, MOST_ROUNDS)
    check_range("seed", seed, 0, 2**63 - 1)
    if not problem.model.parts:
        remedy = "Its searches begin at random designs within the bounds: `optlink.solve` draws them"
        raise InputError("this problem has no targets that first designs could meet", remedy, problem.file, "requirement")
    modes = problem.variants()
    tasks = [mode.spec.parts[0] for mode in modes]
    searcher = Searcher(tasks, seed)
    for _ in range(rounds):
        found = searcher.advance()
    variables = [path_variable(tasks[0], name) for name in tasks[0].free]
    return [
        FirstDesign(
            {variable.name: float(variable.value(x)) for variable, x in zip(variables, candidate.x.tolist(), strict=True)},
            mode_of(modes[candidate.variant]),
            float(candidate.cost),
            candidate.count,
        )
        for candidate in found.candidates
    ]
