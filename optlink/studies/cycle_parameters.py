"""Parameters of an optimum over a machine cycle: dimensions, limits, masses, loads, friction, speed, gravity.

Dimensions and limits are parameters of the programme. The others enter its formulas: the programme is built again with a slightly
larger and smaller value of each; central differences of the optimality system at the optimum give their effect.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import casadi
import numpy as np

from optlink.errors import InputError, Status
from optlink.linkage.vector2d import Array
from optlink.optimization.constraints import Scale
from optlink.optimization.courses import TermCourse
from optlink.optimization.cycle_signals import TracedCycle
from optlink.optimization.programme import build
from optlink.problem.file import ProblemFile
from optlink.problem.limits import MARGIN_KEYS
from optlink.problem.quantity_keys import file_key
from optlink.solvers.contract import CLOSE
from optlink.solvers.exchange import sharpened
from optlink.solvers.solution import Solution
from optlink.studies.cycle_task import with_starting_values
from optlink.studies.kkt_derivatives import KKTPerturbation
from optlink.studies.optimum_parameters import Optimum, OptimumParameters
from optlink.studies.parameters import Parameter, design_variables, displayed, parameters
from optlink.studies.toml_keys import exact_text, read_figure
from optlink.symbolic import CompiledFunction
from optlink.tasks.design import solve as solve_cycle
from optlink.tasks.protocol import completed
from optlink.units import UnitProblem, factor

SECTIONS = ("bodies", "loads")  # joint parameters do not affect an ideal machine
SINGLE_KEYS = ("drive.speed", "gravity")
STEP = 1e-4  # relative step of central differences: most parameters enter linearly, the speed by its square
ANGLE_STEP = 0.01  # step of an angle of 0, in its unit
SAME_OPTIMUM = 0.02  # of the longest dimension: beyond this and ten times the prediction, an optimum is a different one
BACK_END = "slsqp"  # continues from its starting point
TABLE_UNIT = "%"  # unit of a table whose values are scaled together


class CycleParameters(OptimumParameters):
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

    def optimum_at(
        self, solution: Solution, parameter: Parameter, value: float, change: Mapping[str, float], backend: str
    ) -> Optimum | None:
        """Return the machine with another value, built anew and searched from the optimum; see `OptimumParameters.optimum_at`."""
        try:
            start = with_starting_values(with_parameter(self.problem, parameter, value), solution.design)
            optimum = completed(solve_cycle(start, BACK_END, starts=1)).solution
        except InputError:
            return None
        if optimum is None or optimum.status is not Status.OPTIMAL:
            return None
        gaps = (abs(optimum.design[name] - start_value) for name, start_value in solution.design.items())
        distance = max(gaps) / self.nlp.terms.problem.longest
        start_at = design_variables(self.nlp, self.nlp.x_start)
        predicted = max(abs(change[v.name] / v.scale.slope(x)) for v, x in start_at)
        if distance > 10.0 * predicted and distance > SAME_OPTIMUM:
            return None
        end = self.refined(optimum)
        return end.objective, displayed(optimum.nlp, end.x)

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
        task, terms = with_parameter(self.problem, parameter, value).spec, nlp.terms
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


def with_parameter(problem: ProblemFile, parameter: Parameter, value: float) -> ProblemFile:
    """Return the problem with another value of a parameter."""
    if parameter.unit == TABLE_UNIT:
        pairs = [read_figure(text) for text in problem.at(parameter.key)]
        return problem.override(
            {parameter.key: [exact_text(component * value / parameter.value, unit) for component, unit in pairs]}
        )
    written = exact_text(value, parameter.unit)
    if parameter.equal and not parameter.key.endswith(".exactly"):
        return problem.override({f"{parameter.key}.{side}": written for side in ("min", "max")})
    return problem.override({parameter.key: written})
