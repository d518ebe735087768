"""One programme for many problems with targets: what varies are its parameters, bounds and limits."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.errors import Status
from optlink.linkage.vector2d import Array
from optlink.optimization.courses import TermCourse, has_position_limits
from optlink.optimization.nlp import NLP, PointwiseNLP
from optlink.optimization.parameters import constant_values
from optlink.optimization.programme import build
from optlink.optimization.terms import alignment_row, link_rows, position_rows, rows as limit_rows
from optlink.problem.design import DesignProblem
from optlink.problem.file import ProblemFile
from optlink.problem.limits import Reach
from optlink.problem.machine.model import Problem
from optlink.problem.mechanism import sizes_of
from optlink.solvers import multistart
from optlink.solvers.contract import MINIMAX
from optlink.solvers.exchange import RADIUS, at_edge, has_accurate_integrals, largest_excess, misfit, solve_semi_infinite
from optlink.solvers.solution import Solution
from optlink.studies.batch_optima import FOLLOWED, BatchProblem, keep
from optlink.units import DISPLAYED, KINDS, factor

OF_PROBLEM = ("courses", "forward", "backward")
"""Keys of what the exchange keeps of a problem in the cache of its programme."""
MOST_POINTS = 2_000  # points of a grid whose parameters and bounds are kept


class TargetProgramme:
    """The programme of a problem, traced once, for all problems of the same structure.

    `direction`: sense of crank rotation from point to point, +1 or -1; `movable`: whether targets and the rotation of a law are
    parameters too; `terms`: the quantities of the machine, with an order of the ends of strokes.
    """

    def __init__(
        self, task: DesignProblem, direction: int, backend: str, *, movable: bool = False, terms: TermCourse | None = None
    ) -> None:
        self.task, self.direction, self.backend = task, direction, backend
        self.nlp: NLP = build(task, direction, movable=movable, terms=terms)
        multistart.prepare(self.nlp, backend)

    def bind(self, task: DesignProblem) -> bool:
        """Set parameters, bounds and limits; return whether the limits of the programme are those of the problem."""
        nlp, n = self.nlp, len(self.nlp.variables)
        values = sizes_of(task.quantities)
        with np.errstate(all="ignore"):
            pose = task.linkage.at(values, 0.0)
            if task.parts:
                rows = limit_rows(task, values, Reach(0.0, 1.0, self.direction), self.task.size)
                placed = position_rows(task, pose) if has_position_limits(task) else []
            else:
                rows = list(link_rows(task, values, self.task.longest))
                placed = [alignment_row(task.limits, group, group.alignment(pose)) for group in task.linkage.groups]
        anywhere = {(row.limit, row.label): row for row in placed}
        first, each = nlp.exchange_rows
        limited = {limit_key(part): part for part in task.parts}
        bounds = {bound.key: bound.interval for bound in task.bounds}
        others = nlp.helpers | limited.keys() | bounds.keys()
        labels = [(row.limit, row.label) for row in nlp.rows[first : first + each] if row.limit not in others]
        stated = [(row.limit, row.label) for row in rows]
        if stated != [(row.limit, row.label) for row in nlp.rows[: len(rows)]] or set(anywhere) != set(labels):
            return False
        for key in OF_PROBLEM:
            nlp.cache.pop(key, None)
        nlp.spread_exchange_points()
        nlp.p[1 : 1 + len(nlp.constants)] = constant_values(task, nlp.constants)
        set_bounds(nlp, task)
        for j, programme_row in enumerate(nlp.rows):
            row = rows[j] if j < len(rows) else anywhere.get((programme_row.limit, programme_row.label))
            if row is not None:
                nlp.limit(n + j, row.low, row.high)
            elif programme_row.limit in bounds:
                interval, scale = bounds[programme_row.limit], programme_row.scale
                size = factor(interval.unit or KINDS[interval.kind].display, interval.kind) if interval.kind else 1.0
                ends = interval.low, interval.high
                nlp.limit(n + j, *(None if end is None else scale.to_internal(end / size) for end in ends))
            elif programme_row.limit in limited:
                part = limited[programme_row.limit]
                stated, offset = part.requirement.stated(part)
                if offset is not None:  # that of a range is in the formula
                    return False
                if part.tolerance is not None:
                    nlp.limit(n + j, None, programme_row.scale.to_internal(part.tolerance * stated * DISPLAYED[part.unit][0]))
        return True

    def optimum(self, task: DesignProblem, values: Mapping[str, float], radius: float = RADIUS) -> Solution:
        """Return the local optimum of a problem to which the programme is bound, near values of its variables [SI].

        Limits and the largest error hold also between the positions of the programme. `radius` (scaled): how far it may lie in
        the first round, for a change after which it is that near.
        """
        nlp = self.nlp
        start = multistart.solution_at(nlp, nlp.x_of(values), "the last optimum")
        minimax = not task.composed and task.measure == "max" and not (task.law_given or task.robust is not None)
        for method in (MINIMAX, self.backend) if minimax else (self.backend,):
            near = start.usable or radius < RADIUS
            solution = solve_semi_infinite(task, start, method, near=near, radius=radius)
            if solution.usable:
                break
        return solution


class PeakProgramme:
    """The programme of designs of the same assembly modes, sense of rotation and order of strokes at all points of a grid.

    The positions of the peaks of an optimum are unknowns; programmes differ in the rows that have these peaks. `file` returns the
    problem of a point, with definite assembly modes.
    """

    def __init__(self, target: TargetProgramme, file: Callable[[int], ProblemFile], nlp: NLP, rows: list[int]) -> None:
        self.target, self.file, self.nlp, self.rows = target, file, nlp, rows
        self.evaluate, self._known = PointwiseNLP(nlp), dict[int, tuple[Array, Array, Array]]()
        self.kept = np.array([0, *range(len(nlp.p) - target.nlp.exchange_count, len(nlp.p))])

    def problem(self, points: NDArray[np.intp]) -> BatchProblem:
        """Return parameters and bounds at points of the grid; NaN where the programme of a point has other limits."""
        each = [self._at(point) for point in points.tolist()]
        return BatchProblem(*(np.array(arrays) for arrays in zip(*each, strict=True)))

    def _at(self, point: int) -> tuple[Array, Array, Array]:
        if point not in self._known:
            base, peaks = self.target.nlp, np.zeros(len(self.nlp.rows) - len(self.rows))
            fits = self.target.bind(self.file(point).spec)
            low, high = np.where(base.around, -np.inf, base.x_low), np.where(base.around, np.inf, base.x_high)
            lower = np.concatenate([low, peaks, base.low[self.rows], peaks])
            upper = np.concatenate([high, peaks + 1.0, base.high[self.rows], peaks])
            wrong = 1.0 if fits else np.nan
            keep(self._known, point, (base.p.copy(), lower * wrong, upper * wrong), MOST_POINTS)
        return self._known[point]

    def solution(self, point: int, near: Solution, x: Array) -> Solution | None:
        """Return the optimum x, continued from another one, verified anew; None if it is none, also between the positions."""
        base, task = self.target.nlp, self.file(point).spec
        n, many = len(base.variables), base.exchange_count
        if not self.target.bind(task):
            return None
        places = near.p[len(near.p) - many :].copy()
        places[: len(self.nlp.variables) - n] = x[n : len(self.nlp.variables)]
        base.set_exchange_points(places)
        solution = multistart.solution_at(base, base.wrapped(x[:n]), FOLLOWED)
        if solution.status is not Status.OPTIMAL or (many and largest_excess(task, base, solution.x) > 0.0):
            return None
        return solution if in_order(solution) else None


def in_order(solution: Solution) -> bool:
    """Return whether an optimum has the order of ends of strokes of its programme, and accurate integrals."""
    terms, nlp = solution.nlp.terms, solution.nlp
    if terms is None:
        return True
    if at_edge(solution) or (terms.events and misfit(terms.trace, terms.structure, nlp.given | solution.design)):
        return False
    return has_accurate_integrals(solution)


def limit_key(part: DesignProblem) -> str:
    """Return the key whose value makes a requirement a limit."""
    return f"{part.key}.{part.requirement.limited_by[0]}"


def set_bounds(nlp: NLP, task: Problem) -> None:
    """Set the bounds of the design variables to those of a problem."""
    for i, v in enumerate(nlp.variables):
        if v.name not in nlp.helpers:
            low, high = task.quantities[v.name].bounds
            nlp.limit(i, v.scaled(low), v.scaled(high))


def variables_of(solution: Solution) -> dict[str, Any]:
    """Return the values [SI] of all variables of a solved programme by their names."""
    return {v.name: v.value(float(value)) for v, value in zip(solution.nlp.variables, solution.x, strict=True)}
