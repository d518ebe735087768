"""Re-solving of stored optima, to recover their shadow prices and sensitivities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from optlink.errors import Status
from optlink.linkage.vector2d import TURN
from optlink.optimization.nlp import NLP
from optlink.solvers.solution import Solution
from optlink.tasks.function import FunctionResult
from optlink.tasks.results.cycle import CycleResult
from optlink.tasks.results.path import PathDesign

Array = NDArray[np.float64]
SAME = 1e-5  # tolerance in scaled units; a larger step leads to a different optimum


def optimum(design: FunctionResult | CycleResult | PathDesign) -> Solution | None:
    """Return the optimum at a design; None if the design is not an optimum."""
    if isinstance(design, PathDesign):
        return _path_optimum(design)
    return _machine_optimum(design) if isinstance(design, CycleResult) else _law_optimum(design)


def _law_optimum(result: FunctionResult) -> Solution | None:
    from optlink.optimization.nlp import build
    from optlink.tasks.function import solve

    file, design = result.problem, result.design
    if not file.spec.everywhere:
        return _at(build(file.spec), dict(design))
    # the positions of the largest errors belong to the nonlinear program: solve from the optimum, which must not move
    found = solve(file, "ipopt", begin={name: design[name] for name in file.spec.free}).solution
    return None if found is None else _same(found, found.nlp.x_of(dict(design)))


def _machine_optimum(result: CycleResult) -> Solution | None:
    """Return the optimum of a cycle optimisation.

    The crank angles of the peaks belong to the nonlinear program, which is therefore solved from the design; it must not move.
    """
    from optlink.optimization.cycle_nlp import CycleNLP
    from optlink.studies.cycle_parameters import CLOSE
    from optlink.studies.cycle_task import with_starting_values
    from optlink.tasks.cycle import solve as solve_cycle

    found = solve_cycle(with_starting_values(result.problem, result.values), CLOSE, starts=1).solution
    if found is None or found.status is not Status.OPTIMAL:
        return None
    assert isinstance(found.nlp, CycleNLP)
    count = len(found.nlp.free)
    away = found.x[:count] - found.nlp.x_of(result.values)[:count]
    return found if float(np.max(np.abs(away))) <= SAME else None


def _path_optimum(design: PathDesign) -> Solution | None:
    from optlink.optimization.path_nlp import angle_name, build_path_nlp
    from optlink.solvers import multistart
    from optlink.solvers.path_exchange import solve_semi_infinite

    angles = design.crank_angles
    nlp = build_path_nlp(design.task, 1 if angles[-1] >= angles[0] else -1)
    own = {angle_name(k): float(angle) for k, angle in enumerate(angles)}
    x = nlp.x_of({**design.values, **own})
    start = multistart.solution_at(nlp, x, "read from a result file")
    return _same(solve_semi_infinite(design.task, start, "ipopt", near=True), x)


def _at(nlp: NLP, values: dict[str, float]) -> Solution | None:
    """Return the optimum at given values, directly or after an optimisation that must not move them."""
    from optlink.solvers import multistart

    x = nlp.x_of(values)
    found = multistart.solution_at(nlp, x, "read from a result file")
    if found.status is not Status.OPTIMAL:
        found = multistart.solve_from(nlp, x, "ipopt")
    return _same(found, x)


def _same(found: Solution, x: Array) -> Solution | None:
    """Return a solution if it is optimal and coincides with the stored one at `x`; None otherwise."""
    away = found.x - x
    angular = np.array([variable.scale.unit == "deg" for variable in found.nlp.variables])
    turns = TURN / np.array([variable.size for variable in found.nlp.variables])
    away -= np.where(angular, turns * np.round(away / turns), 0.0)  # angles are equal modulo a turn
    near = float(np.max(np.abs(away), initial=0.0)) <= SAME
    return found if found.status is Status.OPTIMAL and near else None
