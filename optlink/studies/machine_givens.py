"""What the optimum of a machine that is designed by its cycle depends on: sizes, limits, masses, loads, friction, speed, gravity.

Sizes and limits are numbers of its programme. The others go into the formulas: the programme is built once more with a little
more and a little less of each; central differences of the optimality system, where the optimum is, tell what they change there.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.design.constraints import Scale
from optlink.design.cycle_nlp import CycleNLP, build_cycle
from optlink.design.cycle_trace import Trace
from optlink.design.files import ProblemFile, read
from optlink.design.settled import place, write
from optlink.designed import task_of
from optlink.errors import Fault, InputError, Status
from optlink.machine_design import design_machine
from optlink.solvers.levels import sharpened
from optlink.solvers.solution import Solution
from optlink.studies.keys import raw_at, text
from optlink.studies.machines import restarted
from optlink.studies.optimality import Push, System
from optlink.studies.parameters import Parameter, parameters
from optlink.symbolic import Compiled
from optlink.units import KINDS

Array = NDArray[np.float64]
SECTIONS = ("bodies", "joints", "loads")
ALONE = ("drive.speed", "gravity")
STEP = 1e-4  # share of a number by which it is changed to either side: most go in linearly, the speed by its square
_FIGURE = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\d\s].*)?")


class Givens:
    """What is given to a machine, and what each does to the optimality system at its optimum."""

    def __init__(self, problem: ProblemFile, system: System) -> None:
        assert isinstance(system.nlp, CycleNLP)
        self.problem, self.system, self.nlp = problem, system, system.nlp

    @cached_property
    def parameters(self) -> list[Parameter]:
        """Sizes and limits of the programme under their keys of the file, then the other figures."""
        own = [replace(parameter, key=self._key(parameter)) for parameter in parameters(self.nlp)]
        return [*own, *_figures(self.problem)]

    def push(self, parameter: Parameter) -> Push:
        """What one unit of a parameter changes."""
        if parameter.constant >= 0 or parameter.entries:
            return self.system.push(parameter)
        step = STEP * abs(parameter.value)
        (low, below, under), (high, above, over) = (self._seen(parameter, parameter.value + way) for way in (-step, step))
        still = np.zeros(len(self.system.values))
        entries = still.copy()
        entries[self.system.free :] = (over - under) / (2.0 * step)
        return Push((high - low) / (2.0 * step), (above - below)[self.system.unknown] / (2.0 * step), entries, still, still)

    def _key(self, parameter: Parameter) -> str:
        if parameter.key.startswith("limits."):
            return f"{parameter.key}.exactly" if parameter.equal else parameter.key
        name = size_of(parameter, self.nlp)
        if name not in self.problem.model.mechanism.quantities:
            return parameter.key
        section, *rest = place(self.problem.raw["mechanism"], name)
        whole = f"{section}.{name.replace('.', '.points.', 1) if name.count('.') > 1 else name}" if rest else name
        side = "" if parameter.constant >= 0 else ".max" if parameter.upper else ".min"
        return f"mechanism.{whole}{side}"

    def _seen(self, parameter: Parameter, value: float) -> tuple[float, Array, Array]:
        """The Lagrangian, its gradient by (x, p) and the rows where the optimum is, with another value in the file."""
        system, nlp = self.system, self.nlp
        trace = Trace(task_of(changed(self.problem, nlp, parameter, value)))
        slots = nlp.slots // nlp.strokes
        other = build_cycle(trace, nlp.structure, nlp.design(system.x), nlp.nodes, slots, nlp.scales)
        if [row.label for row in other.rows] != [row.label for row in nlp.rows]:
            message = "the optimum cannot be compared with that of a neighbouring value: its programme has other rows"
            raise InputError(Fault(message, "Leave sensitivities out, or change it with --set", self.problem.file, parameter.key))
        prices = casadi.DM(system.multipliers[system.free :])
        whole = other.f_expression + casadi.dot(prices, other.g_expression)
        both = casadi.vertcat(other.x_symbol, other.p_symbol)
        seen = Compiled([other.x_symbol, other.p_symbol], [whole, casadi.gradient(whole, both), other.g_expression])
        value_, gradient, rows = seen(system.x, system.p)
        return float(value_[0]), gradient, rows


def _figures(problem: ProblemFile) -> list[Parameter]:
    """Every number that the file states of bodies, joints and loads, the speed and gravity."""
    found = [(key, raw_at(problem, key)) for key in ALONE]
    for section in SECTIONS:
        found += _leaves(section, problem.raw.get(section, {}))
    guides = problem.raw["mechanism"].get("guides", {})
    found += [(f"mechanism.guides.{name}.friction", guide.get("friction")) for name, guide in guides.items()]
    made = []
    for key, raw in found:
        value, unit = _read(raw)
        if value:  # of nothing there is no share to change it by
            name = key.removeprefix("mechanism.guides.").split(".", 1)
            short = name[-1] if name[0] in (*SECTIONS, "drive") else ".".join(name)
            made.append(Parameter(key, short, value, unit, Scale(unit, 1.0)))
    return made


def _leaves(key: str, raw: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(raw, Mapping):
        for name, part in raw.items():
            yield from _leaves(f"{key}.{name}", part)
    else:
        yield key, raw


def _read(raw: Any) -> tuple[float, str]:
    """A value and its unit; 0 of what is none."""
    if isinstance(raw, bool) or not isinstance(raw, int | float | str):
        return 0.0, ""
    match = _FIGURE.fullmatch(str(raw))
    return (float(match[1]), (match[2] or "").strip()) if match else (0.0, "")


def size_of(parameter: Parameter, nlp: CycleNLP) -> str:
    """Name of the quantity whose value or bound a parameter is."""
    if parameter.constant >= 0:
        return parameter.name
    first = parameter.entries[0] if parameter.entries else len(nlp.variables)
    return nlp.variables[first].name if first < len(nlp.variables) else ""


def changed(problem: ProblemFile, nlp: CycleNLP, parameter: Parameter, value: float) -> ProblemFile:
    """The problem with another value of a parameter [its unit]."""
    name = size_of(parameter, nlp)
    if not name:
        return problem.override({parameter.key: text(value, parameter.unit)})
    raw, own = copy.deepcopy(dict(problem.raw)), problem.model.mechanism.quantities[name]
    if parameter.constant >= 0:
        write(raw["mechanism"], name, text(value, parameter.unit))
    else:
        si = KINDS[own.kind].si
        low, high = (text(bound, si) for bound in own.bounds)
        bounds = [low, text(value, parameter.unit)] if parameter.upper else [text(value, parameter.unit), high]
        write(raw["mechanism"], name, {"start": text(own.value, si), "bounds": bounds})
    return read(raw, problem.name, problem.file, problem.folder)


def searched_again(
    problem: ProblemFile, solution: Solution, parameter: Parameter, value: float, backend: str
) -> tuple[float, dict[str, float]]:
    """Objective and free sizes [their units] of the machine with another value, built and searched anew from the optimum."""
    assert isinstance(solution.nlp, CycleNLP)
    other = changed(problem, solution.nlp, parameter, value)
    found = design_machine(restarted(other, solution.design), backend, starts=1)
    if found.solution is None or found.solution.status is not Status.OPTIMAL:
        message = f"searching again with {value:g} {parameter.unit} ended {found.status.value}"
        raise InputError(Fault(message, "Leave --check out", problem.file, parameter.key))
    nlp = found.solution.nlp
    assert isinstance(nlp, CycleNLP)
    end = sharpened(nlp, found.solution)
    free = zip(nlp.variables, end.x, strict=True)
    return end.objective, {v.name: v.scale.people(float(x)) for v, x in free if v.name not in nlp.helpers}
