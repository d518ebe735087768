"""The parameters of an optimum, and the optima at changed values, found by a new search or from a changed file.

Dimensions and limits are parameters of the programme. Masses, loads, friction, speed and gravity of a machine enter its formulas:
the programme is built again with a slightly larger and smaller value of each; central differences of the optimality system at the
optimum give their effect.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import casadi
import numpy as np

from optlink.errors import InputError
from optlink.linkage.vector2d import Array
from optlink.optimization.constraints import Scale
from optlink.optimization.courses import TermCourse, course_again
from optlink.optimization.cycle_signals import TracedCycle
from optlink.optimization.programme import build
from optlink.problem.file import ProblemFile
from optlink.problem.limits import MARGIN_KEYS
from optlink.problem.quantity_keys import file_key
from optlink.solvers import multistart
from optlink.solvers.contract import CLOSE
from optlink.solvers.exchange import sharpened
from optlink.solvers.solution import Solution
from optlink.studies.continuation import follow_optimum
from optlink.studies.kkt_derivatives import KKTPerturbation, KKTSystem
from optlink.studies.parameters import Parameter, displayed, parameters
from optlink.studies.target_programme import TargetProgramme, variables_of
from optlink.studies.toml_keys import exact_text, read_figure
from optlink.symbolic import CompiledFunction
from optlink.units import UnitProblem, factor

SECTIONS = ("bodies", "loads")  # joint parameters do not affect an ideal machine
SINGLE_KEYS = ("drive.speed", "gravity")
STEP = 1e-4  # relative step of central differences: most parameters enter linearly, the speed by its square
ANGLE_STEP = 0.01  # step of an angle of 0, in its unit
TABLE_UNIT = "%"  # unit of a table whose values are scaled together
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
        changed, recipe = self.changed(parameter, value).spec, solution.nlp.recipe
        programme = TargetProgramme(changed, recipe["direction"], backend, terms=course_again(changed, recipe))
        optimum = programme.optimum(changed, variables_of(solution), CLOSE_BY)
        optimum = optimum if optimum.usable else programme.optimum(changed, variables_of(solution))
        optimum = sharpened(changed, optimum, backend) if optimum.usable else optimum
        return (optimum.objective, displayed(programme.nlp, optimum.x)) if optimum.usable else None

    def changed(self, parameter: Parameter, value: float) -> ProblemFile:
        """Return the problem with another value of a parameter."""
        stated, written = self.problem.at(parameter.key), exact_text(value, parameter.unit)
        ends = stated if isinstance(stated, Mapping) else {}
        sides = [f".{end}" for end in ("exactly", "min", "max") if end in ends and parameter.equal] or [""]
        return self.problem.override({f"{parameter.key}{side}": written for side in sides})


class CycleParameters(TargetParameters):
    """Parameters of a machine, and their effect on the optimality system at its optimum.

    Its optima are less accurate than those of other programmes, and more strongly curved.
    """

    share, most = 3e-4, 0.02

    @staticmethod
    def refined(solution: Solution) -> Solution:
        """Return an optimum at the exact positions of its peaks."""
        return sharpened(solution.nlp.terms.problem, solution, CLOSE)

    @property
    def notes(self) -> tuple[str, ...]:
        """Note on the sign of a maximised quantity."""
        maximised = any(goal.sense == "maximise" for goal in self.nlp.terms.problem.goals)
        return ("a maximised quantity is listed with the opposite sign: its negative is minimised",) * maximised

    @cached_property
    def parameters(self) -> list[Parameter]:
        """Dimensions and limits of the programme under their keys in the file, then the other parameters."""
        programme_parameters = [replace(parameter, key=self._key(parameter)) for parameter in parameters(self.nlp)]
        return [*(parameter for parameter in programme_parameters if parameter.key), *_figures(self.problem)]

    def push(self, parameter: Parameter) -> KKTPerturbation:
        """Return the change of the optimality system per unit of a parameter."""
        if parameter.constant >= 0 or parameter.entries:
            return self.system.push(parameter)
        step = STEP * abs(parameter.value) or ANGLE_STEP
        (low, below, under), (high, above, over) = (
            self._perturbed(parameter, parameter.value + change) for change in (-step, step)
        )
        still = np.zeros(len(self.system.values))
        entries = still.copy()
        entries[self.system.free :] = (over - under) / (2.0 * step)
        return KKTPerturbation(
            (high - low) / (2.0 * step), (above - below)[self.system.unknown] / (2.0 * step), entries, still, still
        )

    def changed(self, parameter: Parameter, value: float) -> ProblemFile:
        """Return the machine with another value of a parameter."""
        if parameter.unit != TABLE_UNIT:
            return super().changed(parameter, value)
        pairs, share = [read_figure(text) for text in self.problem.at(parameter.key)], value / parameter.value
        return self.problem.override({parameter.key: [exact_text(component * share, unit) for component, unit in pairs]})

    def _key(self, parameter: Parameter) -> str:
        """Return the key in the problem file; empty for a row that the file does not state."""
        entry = parameter.entries[0] if parameter.entries else 0
        side = "" if parameter.constant >= 0 else ".max" if parameter.upper else ".min"
        if parameter.constant < 0 and entry >= len(self.nlp.variables):
            limit = self.nlp.rows[entry - len(self.nlp.variables)].limit
            if not limit.startswith(("limits.", "requirement.", "mechanism.")) or limit in MARGIN_KEYS:
                return ""
            value = self.problem.at(limit)
            exactly = isinstance(value, Mapping) and "exactly" in value
            return f"{limit}.exactly" if exactly else limit if parameter.equal else f"{limit}{side}"
        name = parameter.name if parameter.constant >= 0 else self.nlp.variables[entry].name
        if name not in self.problem.model.mechanism.quantities:
            return f"{parameter.key}{side}"
        return file_key(self.problem.raw["mechanism"], name) + side

    def _perturbed(self, parameter: Parameter, value: float) -> tuple[float, Array, Array]:
        """Return the Lagrangian, its gradient by (x, p) and the rows at the optimum, with another value in the file."""
        system, nlp = self.system, self.nlp
        task, terms = self.changed(parameter, value).spec, nlp.terms
        trace = TracedCycle(task, slow=terms.trace.slow)
        course = TermCourse(task, nlp.design(system.x), trace, terms.structure, terms.count, terms.sizes)
        perturbed = build(task, terms=course)
        if [row.label for row in perturbed.rows] != [row.label for row in nlp.rows]:
            message = "at a neighbouring value the motions reverse in another order"
            raise InputError(message, "Change it with --set", self.problem.file, parameter.key)
        prices = casadi.DM(system.multipliers[system.free :])
        lagrangian = perturbed.f_expression + casadi.dot(prices, perturbed.g_expression)
        variables = casadi.vertcat(perturbed.x_symbol, perturbed.p_symbol)
        functions = CompiledFunction(
            [perturbed.x_symbol, perturbed.p_symbol], [lagrangian, casadi.gradient(lagrangian, variables), perturbed.g_expression]
        )
        value_, gradient, rows = functions(system.x, system.p)
        return float(value_[0]), gradient, rows


def _figures(problem: ProblemFile) -> list[Parameter]:
    """Return all numbers of bodies and loads in the file, guide friction, the speed and gravity as parameters."""
    keys = [*(leaf for key in SINGLE_KEYS for leaf in _leaves(key, problem.at(key)))]
    for section in SECTIONS:
        keys += _leaves(section, problem.raw.get(section, {}))
    guides = problem.raw["mechanism"].get("guides", {})
    keys += [(f"mechanism.guides.{name}.friction", guide.get("friction")) for name, guide in guides.items()]
    figures = []
    for key, raw in keys:
        value, unit = (100.0, TABLE_UNIT) if isinstance(raw, list) else read_figure(raw)
        if value or _angular(unit):  # other zeros have no relative step
            name = key.removeprefix("mechanism.guides.").split(".", 1)
            short = name[-1] if name[0] in (*SECTIONS, "drive") else ".".join(name)
            figures.append(Parameter(key, short, value, unit, Scale(unit, 1.0)))
    return figures


def _leaves(key: str, raw: Any) -> Iterator[tuple[str, Any]]:
    """Yield keys with their numbers: the coordinates of a pair, the values of a table together."""
    if isinstance(raw, Mapping):
        for name, part in raw.items():
            yield from _leaves(f"{key}.{name}", part)
    elif isinstance(raw, list) and len(raw) == 2 and (key == "gravity" or key.endswith(".centroid")):
        names = ("x", "y") if key == "gravity" else ("along", "across")
        yield from ((f"{key}.{name}", part) for name, part in zip(names, raw, strict=True))
    elif not isinstance(raw, list) or (key.startswith("loads.") and key.endswith(".values") and any(map(_number, raw))):
        yield key, raw


def _number(raw: Any) -> float:
    return read_figure(raw)[0]


def _angular(unit: str) -> bool:
    try:
        return factor(unit, "angle") > 0.0
    except UnitProblem:
        return False
