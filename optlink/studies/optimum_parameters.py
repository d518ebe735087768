"""The parameters of an optimum, and the optima at changed values, found by a new search or from a changed file."""

from collections.abc import Mapping
from functools import cached_property

from optlink.optimization.courses import course_again
from optlink.problem.file import ProblemFile
from optlink.solvers import multistart
from optlink.solvers.exchange import sharpened
from optlink.solvers.solution import Solution
from optlink.studies.continuation import follow_optimum
from optlink.studies.kkt_derivatives import KKTPerturbation, KKTSystem
from optlink.studies.parameters import Parameter, displayed, parameters
from optlink.studies.target_programme import TargetProgramme, variables_of
from optlink.studies.toml_keys import exact_text

CLOSE_BY = 1e-2  # scaled units: how far an optimum may move by a step of a difference in the first round
Optimum = tuple[float, dict[str, float]]
"""Objective [SI] and design variables in display units."""


class OptimumParameters:
    """The parameters of an optimum, which are those of its programme, and the optima at changed values.

    `share`, `most`: step of central differences relative to the value, and its largest share of the range of validity.
    """

    share, most = 3e-5, 0.4

    def __init__(self, problem: ProblemFile, system: KKTSystem) -> None:
        self.problem, self.system, self.nlp = problem, system, system.nlp

    @staticmethod
    def refined(solution: Solution) -> Solution:
        """Return an optimum with all digits."""
        return solution

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the derivatives."""
        return ()

    @cached_property
    def parameters(self) -> list[Parameter]:
        """All parameters, with the keys of the problem file."""
        return parameters(self.nlp)

    def push(self, parameter: Parameter) -> KKTPerturbation:
        """Return the change of the optimality system per unit of a parameter."""
        return self.system.push(parameter)

    def optimum_at(
        self, solution: Solution, parameter: Parameter, value: float, change: Mapping[str, float], backend: str
    ) -> Optimum | None:
        """Return the optimum with another value of a parameter; None if there is none, or a different one is found.

        `change` [display units]: predicted change of the design variables.
        """
        nlp = solution.nlp
        try:
            parameter.place(nlp, value)
            followed = follow_optimum(nlp, solution)  # has more digits where the search ends near many peaks of equal height
            optimum = multistart.best([multistart.solve_from(nlp, solution.x, backend), *([followed] if followed else [])])
        finally:
            parameter.place(nlp, parameter.value)
        return optimum.objective, displayed(nlp, optimum.x)


class TargetParameters(OptimumParameters):
    """The parameters of a design for targets, whose file is read, built and optimised again near it with another value.

    The largest error and limits hold between the positions of the programme again.
    """

    def optimum_at(
        self, solution: Solution, parameter: Parameter, value: float, change: Mapping[str, float], backend: str
    ) -> Optimum | None:
        """Return the optimum with another value; see `OptimumParameters.optimum_at`."""
        if not parameter.in_file:
            return super().optimum_at(solution, parameter, value, change, backend)
        stated, written = self.problem.at(parameter.key), exact_text(value, parameter.unit)
        ends = stated if isinstance(stated, Mapping) else {}
        sides = [f".{end}" for end in ("exactly", "min", "max") if end in ends and parameter.equal] or [""]
        changed = self.problem.override({f"{parameter.key}{side}": written for side in sides}).spec
        recipe = solution.nlp.recipe
        programme = TargetProgramme(changed, recipe["direction"], backend, terms=course_again(changed, recipe))
        optimum = programme.optimum(changed, variables_of(solution), CLOSE_BY)
        optimum = optimum if optimum.usable else programme.optimum(changed, variables_of(solution))
        optimum = sharpened(changed, optimum, backend) if optimum.usable else optimum
        return (optimum.objective, displayed(programme.nlp, optimum.x)) if optimum.usable else None
