"""A design that stays good when it is built: the largest of error plus k standard deviations, or plus the worst case, made least.

The derivatives of the error by every size are traced with the programme, so the scatter is a formula of the design like any
other, and the search has its exact derivatives. Limits are those of the problem, for the linkage as drawn.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi
import numpy as np

from optlink.design.constraints import DEGREES, Row
from optlink.design.files import ProblemFile
from optlink.design.law import Table
from optlink.design.nlp import NLP, build
from optlink.design.objectives import output_error
from optlink.design.problem import EPIGRAPH, DesignProblem
from optlink.errors import Fault, InputError, Status
from optlink.linkage.elementwise import cross, turn, unit
from optlink.linkage.mechanism import Mechanism
from optlink.solvers.search import solve_from
from optlink.solvers.solution import Solution
from optlink.studies.sampling import NORMAL, Deviation
from optlink.studies.tolerance import ALONG, drawing, read_deviations
from optlink.symbolic import tracing
from optlink.validation import Validation
from optlink.workflow import solve, validate

MOST = 100.0  # standard deviations
STEPS, CLOSE = 30, 1e-4  # of the search for most of them


@dataclass(frozen=True)
class Robust:
    """A robust design [SI] and the best as drawn, `nominal`; `value` [rad]: what was made least, and what it is `before`.

    `sigmas`: how many standard deviations count, None: the worst case.
    """

    problem: ProblemFile
    design: Mapping[str, float]
    nominal: Mapping[str, float]
    sigmas: float | None
    value: float
    before: float
    solution: Solution
    validation: Validation

    @property
    def valid(self) -> bool:
        """Whether it is an optimum, and its limits are proven by the validator."""
        return self.solution.status is Status.OPTIMAL and self.validation.valid

    @property
    def counted(self) -> str:
        """What is added to the size of the error, in words."""
        return "the worst case" if self.sigmas is None else f"{self.sigmas:.4g} standard deviations"

    @property
    def free(self) -> dict[str, float]:
        """The free quantities of the design [SI]."""
        return {name: self.design[name] for name in self.problem.model.free}

    def to_dict(self) -> dict[str, Any]:
        """As part of a JSON document."""
        return {
            "counted": self.counted,
            "status": self.solution.status.value,
            "valid": self.valid,
            "kkt": self.solution.kkt,
            "design_SI": dict(self.design),
            "nominal_design_SI": dict(self.nominal),
            "largest_rad": self.value,
            "largest_of_the_nominal_design_rad": self.before,
        }


def robust(
    problem: ProblemFile, tolerances: Sequence[str], sigmas: float | None = 3.0, *, shape: str = NORMAL, backend: str = "ipopt"
) -> Robust:
    """The design whose largest error over the span, with its scatter, is least.

    Parameters
    ----------
    problem : ProblemFile with a motion law
    tolerances : texts, see `optlink.studies.tolerance.tolerance`
    sigmas : standard deviations that are added to the size of the mean error; None: the worst case is
    shape : distribution where none is said
    backend : "slsqp" or "ipopt"

    Raises
    ------
    InputError
    """
    if sigmas is not None and not 0.0 <= sigmas <= MOST:
        raise InputError(Fault("out of range", 'Give 0 to 100 standard deviations, or "worst"', key="--robust", value=sigmas))
    return _Redesign(problem, tolerances, shape, backend).least(sigmas)


def safest(
    problem: ProblemFile, tolerances: Sequence[str], limit: float, *, shape: str = NORMAL, backend: str = "ipopt"
) -> Robust:
    """The design that keeps a limit [rad] of its error with most standard deviations: those whose least value is the limit.

    Raises
    ------
    InputError
        as `robust`; where no design keeps the limit even as drawn.
    """
    redesign = _Redesign(problem, tolerances, shape, backend)
    low, high = redesign.least(0.0), None
    if low.value > limit:
        least = f"{math.degrees(low.value):.4g} deg"
        message = f"no design keeps the limit, not even as drawn: the least largest error that was found is {least}"
        raise InputError(Fault(message, f"Give more than {least}", problem.file, "--limit", f"{math.degrees(limit):.4g} deg"))
    step = 1.0
    while high is None and step <= MOST:
        found = redesign.least(step, low.free)
        low, high, step = (found, None, 2.0 * step) if found.value <= limit else (low, found, step)
    for _ in range(STEPS):
        if high is None or low.sigmas is None or high.sigmas is None or high.sigmas - low.sigmas <= CLOSE:
            break
        share = (limit - low.value) / (high.value - low.value)  # nearly linear in between; kept off the ends
        found = redesign.least(low.sigmas + min(max(share, 0.05), 0.95) * (high.sigmas - low.sigmas), low.free)
        low, high = (found, high) if found.value <= limit else (low, found)
    return low


class _Redesign:
    """Searches robust designs of one problem, from its best design as drawn."""

    def __init__(self, problem: ProblemFile, tolerances: Sequence[str], shape: str, backend: str) -> None:
        model = problem.model
        if not isinstance(model, DesignProblem):
            message = "a robust design is found for motion laws of a four-bar only"
            raise InputError(Fault(message, "Judge designs of it without --robust", problem.file, "--robust"))
        first = solve(problem, backend)
        if not first.valid:
            raise InputError(Fault("no design was proven, so there is none to begin with", "See `optlink solve`", problem.file))
        self.problem, self.backend, self.nominal = first.problem, backend, first.design
        self.names = model.free
        drawn = drawing(self.problem, "rocker", np.array([first.design["phi0"]]), self._free(first.design))
        self.mechanism, self.deviations = drawn.mechanism, read_deviations(self.problem, drawn, tolerances, shape)

    def _free(self, design: Mapping[str, float]) -> dict[str, float]:
        return {name: design[name] for name in self.names}

    def least(self, sigmas: float | None, start: Mapping[str, float] | None = None) -> Robust:
        """The design with the least largest error and scatter, searched from a start [SI]."""
        nlp = _programme(self.problem, self.mechanism, self.deviations, sigmas)
        nominal = nlp.x_of(self._free(self.nominal))
        solution = solve_from(nlp, nominal if start is None else nlp.x_of(dict(start)), self.backend)
        found = self.problem.spec.design(solution.design)
        proof = validate(self.problem, self._free(found)).validation
        before = nlp.measure.of(nlp.residuals(nominal))
        return Robust(self.problem, found, dict(self.nominal), sigmas, solution.objective, before, solution, proof)


def _programme(problem: ProblemFile, mechanism: Mechanism, deviations: Sequence[Deviation], sigmas: float | None) -> NLP:
    """The minimax programme of the problem with the scatter in its errors, at positions along the span, both ends included."""
    model = problem.override({"requirement.measure": "max"}).model
    assert isinstance(model, DesignProblem)
    nlp = build(model)
    x, p = nlp.x_symbol, nlp.p_symbol
    values: dict[str, Any] = {v.name: v.origin + x[i] * v.size for i, v in enumerate(nlp.variables) if v.name != EPIGRAPH}
    values |= {c.name: p[1 + i] * c.size for i, c in enumerate(nlp.constants)}
    offsets = np.linspace(0.0, model.span, ALONG)
    law = model.law
    tabulated = law.source.at(offsets) if isinstance(law.source, Table) else np.zeros(ALONG)
    slopes = _slopes(mechanism, deviations)
    rows = [row for row in nlp.rows if row.limit != EPIGRAPH]
    residuals = []
    with tracing():
        start = model.start_position(values)
        for offset, wanted in zip(offsets, tabulated, strict=True):
            error = output_error(model, values, start, float(offset), float(wanted))
            by = slopes(values, turn(start.crank, unit(float(offset))))
            middle, spread = _scatter(deviations, by, sigmas)
            label = f"error {math.degrees(offset):.4g} deg from the start"
            for side in (1.0, -1.0):
                residual = error - middle + side * spread
                residuals.append(residual)
                for sign in (1.0, -1.0):
                    rows.append(Row(EPIGRAPH, label, (x[-1] - sign * residual) / p[0], 0.0, math.inf, DEGREES))
        g = casadi.vertcat(*[row.value for row in rows])
        vector = casadi.vertcat(*residuals)
    return replace(nlp, rows=tuple(rows), g_expression=g, residual_expression=vector, cache={})


def _scatter(deviations: Sequence[Deviation], by: Any, sigmas: float | None) -> tuple[Any, Any]:
    """Middle of the change of the output, and how far it counts to either side."""
    if sigmas is None:
        ends = [d.ends for d in deviations]
        middle = sum(0.5 * (low + high) * by[i] for i, (low, high) in enumerate(ends))
        return middle, sum(0.5 * (high - low) * casadi.fabs(by[i]) for i, (low, high) in enumerate(ends))
    middle = sum(d.mean * by[i] for i, d in enumerate(deviations))
    return middle, sigmas * casadi.sqrt(sum((d.sigma * by[i]) ** 2 for i, d in enumerate(deviations)))


def _slopes(mechanism: Mechanism, deviations: Sequence[Deviation]) -> Any:
    """Function of sizes and the crank's direction: derivatives of the rocker's angle by the size of every deviation."""
    names = ["crank", "coupler", "rocker", "frame", "A.x", "A.y", "D.y"]
    symbols = {name: casadi.SX.sym(name) for name in names}
    crank = casadi.SX.sym("crank direction", 2)
    with tracing():
        axis = mechanism.pose(symbols, (crank[0], crank[1])).direction("rocker")
        by = [
            cross(axis, (casadi.jacobian(axis[0], symbols[d.size]), casadi.jacobian(axis[1], symbols[d.size])))
            for d in deviations
        ]
    traced = casadi.Function("slopes", [casadi.vertcat(*symbols.values()), crank], [casadi.vertcat(*by)])
    return lambda sizes, direction: traced(casadi.vertcat(*[sizes.get(name, 0.0) for name in names]), casadi.vertcat(*direction))
