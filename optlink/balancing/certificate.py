"""Certificate of a second-order cone programme, computed from its dual solution."""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from optlink.errors import SolverError
from optlink.linkage.vector2d import Array

GAP = 1e-7
"""Duality gap, relative, up to which an optimum counts as proven."""

TOLERANCES: tuple[dict[str, float], ...] = (
    {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11, "tol_ktratio": 1e-9},
    {"tol_gap_abs": 1e-9, "tol_gap_rel": 1e-9, "tol_feas": 1e-9},
    {},
)
"""Tolerances of the solver, tried from the tightest one on."""

REFINED = {"iterative_refinement_reltol": 1e-14, "iterative_refinement_abstol": 1e-14, "iterative_refinement_max_iter": 30}


@dataclass
class ConeCertificate:
    """Certificate of an optimum: primal value, lower bound from the dual point, and feasibility of the primal point.

    `lower` is already reduced by the residual of the dual point. `outside`: largest violation of cones and rows by the primal
    point.
    """

    status: str
    value: float = math.nan
    lower: float = -math.inf
    outside: float = math.inf
    iterations: int = 0

    @property
    def gap(self) -> float:
        """Value minus lower bound."""
        return self.value - self.lower

    @property
    def proven(self) -> bool:
        """Whether the duality gap and the violation of the primal point are within `GAP`."""
        return self.gap <= GAP * max(1.0, abs(self.value)) and self.outside <= GAP


def solved(cp: Any, problem: Any) -> ConeCertificate:
    """Solve a problem of cvxpy (`cp`) to the tightest tolerance that the solver reaches, and certify the solution."""
    best = ConeCertificate("not solved")
    for options in TOLERANCES:
        settings = {**options, **REFINED}
        data, chain, inverse = problem.get_problem_data(cp.CLARABEL, solver_opts=settings)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an inaccurate solution is judged by its certificate, not by a warning
            raw = chain.solve_via_data(problem, data, False, False, settings)
            try:
                problem.unpack_results(raw, chain, inverse)
            except cp.error.SolverError:
                best.status = str(raw.status)
                continue
        if problem.status in ("infeasible", "unbounded"):
            return ConeCertificate(problem.status, iterations=int(raw.iterations))
        if problem.status not in ("optimal", "optimal_inaccurate"):
            continue
        best = _certified(data, raw)
        if best.proven:
            break
    return best


def _certified(data: Mapping[str, Any], raw: Any) -> ConeCertificate:
    """Compute the certificate of the cone programme.

    Primal: minimise c x subject to b - A x in K; dual: maximise -b z subject to A' z + c = 0, z in K*.
    """
    c, a, b = (data[key] for key in ("c", "A", "b"))
    x, z = np.array(raw.x), np.array(raw.z)
    dims = data["dims"]
    residual = np.abs(a.T @ z + c)
    lower = -float(b @ z) - float(residual @ np.maximum(np.abs(x), 1.0)) - _outside(z, dims, dual=True) * float(np.sum(np.abs(b)))
    return ConeCertificate("optimal", float(c @ x), lower, _outside(b - a @ x, dims, dual=False), int(raw.iterations))


def _outside(s: Array, dims: Any, *, dual: bool) -> float:
    """Return the violation of a cone: equations, nonnegative numbers, second-order cones; all but the first are self-dual."""
    worst = 0.0 if dual or not dims.zero else float(np.max(np.abs(s[: dims.zero])))
    place = dims.zero + dims.nonneg
    worst = max(worst, -float(np.min(s[dims.zero : place], initial=0.0)))
    for size in dims.soc:
        cone = s[place : place + size]
        worst = max(worst, float(np.linalg.norm(cone[1:]) - cone[0]))
        place += size
    if place != len(s):
        raise SolverError("the programme has a cone that is not certified")
    return worst
