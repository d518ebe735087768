"""`optlink.build`: the nonlinear programme of a design problem, for solvers, objectives and constraints of one's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import casadi
import numpy as np
from numpy.typing import ArrayLike

from optlink.errors import InputError
from optlink.linkage.arguments import check_array, check_number
from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP, NLPValues
from optlink.problem.arguments import typed
from optlink.problem.design import EPIGRAPH
from optlink.problem.document import Document
from optlink.problem.file import AnyProblem, ProblemFile, problem_of
from optlink.solvers.multistart import scaled_parameters
from optlink.tasks.machine import check_design, crank_speed
from optlink.tasks.run import check_complete, design_task
from optlink.tasks.search import mode_of

if TYPE_CHECKING:
    from optlink.tasks.results.common import DesignResult
else:
    DesignResult = Document  # as all results are


@dataclass(frozen=True)
class Unknown:
    """A component of x: low <= x <= high.

    `key`: key of the design variable in the problem file; empty for an unknown that the formulation adds: the crank angle of a
    point or of an event, the largest value of an objective. `unit`: SI; empty for a plain number.
    """

    name: str
    key: str
    unit: str
    low: float
    high: float
    start: float


@dataclass(frozen=True)
class Constraint:
    """A component of g: low <= g <= high.

    `key`: key of the limit in the problem file; empty for a constraint that the formulation adds: the equation of an event, a
    bound of the largest value. Constraints of the same key and name are one limit at several positions. `unit`: SI; empty for a
    plain number, such as a cosine or a squared sine.
    """

    name: str
    key: str
    unit: str
    low: float
    high: float


class Programme:
    """Nonlinear programme of a design problem: minimise f(x) subject to x_low <= x <= x_high and g_low <= g(x) <= g_high.

    Every value is in SI and not scaled; `scaled` returns the same programme in units in which the unknowns and f are near 1. The
    derivatives are exact. f is smooth: for an objective `rms` it is the mean square, for `max` an unknown that constraints keep
    above every deviation, for a quantity that is maximised its negative; `objective` returns the value that a result shows.

    Where the linkage cannot be assembled, f and the components of g that need its positions are NaN, and so are their
    derivatives. Conditions of the lengths alone remain finite.

    Limits over a range of crank angles apply at fixed positions and at the peaks of the start; `at_peaks` moves the latter.

    Attributes
    ----------
    problem : ProblemFile
    variables : tuple of Unknown
        The design variables, then the unknowns that the formulation adds.
    constraints : tuple of Constraint
    f_unit : str
        Unit of f.
    x_start, x_low, x_high : array (n,)
    g_low, g_high : array (m,)
    """

    def __init__(self, problem: ProblemFile, nlp: NLP, start: Array, *, scaled: bool = False) -> None:
        self.problem, self._nlp, self._start, self._scaled = problem, nlp, start, scaled
        n, m = len(nlp.variables), len(nlp.rows)
        if scaled:
            self._p = scaled_parameters(nlp, start)
            units, self.f_unit, self._f_size = [(1.0, 0.0, "")] * (n + m), "", 1.0
            if nlp.variables[-1].name == EPIGRAPH:  # in units of the objective
                units[n - 1] = (float(self._p[0]), 0.0, "")
        else:
            self._p = np.array([1.0, *nlp.p[1:]])
            units = [(v.size, v.origin, v.scale.in_si[2]) for v in nlp.variables] + [row.scale.in_si for row in nlp.rows]
            self.f_unit, self._f_size = nlp.measure.smooth_unit, nlp.factor
        sizes: Array = np.array([size for size, *_ in units])
        origins: Array = np.array([origin for _, origin, _ in units])
        self._x_size, self._x_origin, self._g_size, self._g_origin = sizes[:n], origins[:n], sizes[n:], origins[n:]
        self._point: tuple[bytes, NLPValues] | None = None
        self.x_start, self.x_low, self.x_high = (self._shown(y) for y in (start, nlp.x_low, nlp.x_high))
        self.g_low, self.g_high = (self._g_origin + self._g_size * bound for bound in (nlp.low, nlp.high))
        unit_names = [unit for *_, unit in units]
        self.variables = tuple(
            Unknown(v.name, "" if v.name in nlp.helpers else v.key, unit, low, high, at)
            for v, unit, low, high, at in zip(
                nlp.variables, unit_names[:n], *(a.tolist() for a in (self.x_low, self.x_high, self.x_start)), strict=True
            )
        )
        self.constraints = tuple(
            Constraint(row.label, "" if row.limit in nlp.helpers else row.limit, unit, low, high)
            for row, unit, low, high in zip(nlp.rows, unit_names[n:], self.g_low.tolist(), self.g_high.tolist(), strict=True)
        )

    def __repr__(self) -> str:
        """Return the size of the programme."""
        return f"<Programme {self.problem.name!r}: {len(self.variables)} variables, {len(self.constraints)} constraints>"

    # --- values ----------------------------------------------------------------------------------------------------------

    def at(self, x: ArrayLike) -> NLPValues:
        """Return f, its gradient (n,), g (m,) and its Jacobian (m, n) at x; the last point is kept, so that f, g, ... are cheap.

        Parameters
        ----------
        x : array (n,)
        """
        y = self._scaled_point(x)
        key = y.tobytes()
        if self._point is None or self._point[0] != key:
            f, gradient, g, jacobian = self._nlp.at(y, self._p)
            slopes = self._f_size * gradient / self._x_size, self._g_size[:, None] * jacobian / self._x_size
            self._point = key, NLPValues(self._f_size * f, slopes[0], self._g_origin + self._g_size * g, slopes[1])
        return self._point[1]

    def f(self, x: ArrayLike) -> float:
        """Return the objective at x, to be minimised.

        Parameters
        ----------
        x : array (n,)
        """
        return self.at(x).f

    def gradient(self, x: ArrayLike) -> Array:
        """Return the derivatives (n,) of f at x.

        Parameters
        ----------
        x : array (n,)
        """
        return self.at(x).gradient.copy()

    def g(self, x: ArrayLike) -> Array:
        """Return the constraints (m,) at x.

        Parameters
        ----------
        x : array (n,)
        """
        return self.at(x).g.copy()

    def jacobian(self, x: ArrayLike) -> Array:
        """Return the derivatives (m, n) of g at x.

        Parameters
        ----------
        x : array (n,)
        """
        return self.at(x).jacobian.copy()

    def hessian(self, x: ArrayLike, multipliers: ArrayLike, factor: float = 1.0) -> Array:
        """Return the second derivatives (n, n) of the Lagrangian factor * f + multipliers . g at x.

        Parameters
        ----------
        x : array (n,)
        multipliers : array (m,)
            Of the constraints.
        factor : float
            Of f; with 0 the second derivatives of the constraints alone.
        """
        y, weights = self._scaled_point(x), self._sized("multipliers", multipliers, len(self.constraints), "constraints")
        factor = check_number("factor", factor)
        none = np.zeros(len(weights))
        total = self._nlp.hessian(y, self._p, weights * self._g_size / self._f_size)
        if factor != 1.0:
            total = total + (factor - 1.0) * self._nlp.hessian(y, self._p, none)
        return self._f_size * total / np.outer(self._x_size, self._x_size)

    def objective(self, x: ArrayLike) -> float:
        """Return the objective at x as `optlink.solve` and `optlink.validate` state it [SI].

        Parameters
        ----------
        x : array (n,)
        """
        return self._nlp.measure.of(self._nlp.residuals(self._scaled_point(x)))

    def stated_derivatives(self, x: ArrayLike) -> tuple[float, float]:
        """Return the first and second derivative of `objective` with respect to f at x.

        Parameters
        ----------
        x : array (n,)
        """
        measure, residuals = self._nlp.measure, self._nlp.residuals(self._scaled_point(x))
        slope = measure.slope(residuals)
        return slope, -slope / max(measure.of(residuals), 1e-150) * slope if measure.rooted else 0.0

    @cached_property
    def expressions(self) -> dict[str, Any]:
        """The casadi symbol `x` and the casadi expressions `f` and `g` of it, as `casadi.nlpsol` takes them."""
        x = casadi.SX.sym("x", len(self.variables))
        y = (x - self._x_origin) / self._x_size
        both = casadi.Function(
            "programme", [self._nlp.x_symbol, self._nlp.p_symbol], [self._nlp.f_expression, self._nlp.g_expression]
        )
        f, g = both(y, self._p)
        return {"x": x, "f": self._f_size * f, "g": self._g_origin + self._g_size * g}

    # --- designs ---------------------------------------------------------------------------------------------------------

    def design(self, x: ArrayLike) -> dict[str, float]:
        """Return the design variables [SI] at x by name, for `optlink.validate`.

        Parameters
        ----------
        x : array (n,)
        """
        values = self._nlp.design(self._scaled_point(x))
        return {name: values[name] for name in self.problem.model.free}

    @typed
    def x_of(self, design: Mapping[str, float | str]) -> Array:
        """Return x of a design; the unknowns that the formulation adds follow from it.

        Parameters
        ----------
        design : mapping of str to float [SI] or str
            Value of every design variable, for example `result.design`.

        Raises
        ------
        InputError
            If it has unknown names or lacks a design variable.
        """
        values = check_design(self.problem, design) or {}
        check_complete(self.problem, design)
        return self._shown(design_task(self.problem).unknowns(self.problem, self._nlp, values))

    # --- other forms -----------------------------------------------------------------------------------------------------

    def scaled(self) -> Programme:
        """Return the same programme without units: lengths by a typical length, angles by 1 rad, f by its value at the start.

        Solvers that begin with a unit matrix as the second derivatives, such as SLSQP, need it. `design` returns SI also here.
        """
        return Programme(self.problem, self._nlp, self._start, scaled=True)

    def at_peaks(self, x: ArrayLike) -> Programme:
        """Return the programme that starts at x, with its movable positions where limits or largest values have their peaks.

        Repeat until x stays: then limits and largest values hold between the positions too.

        Parameters
        ----------
        x : array (n,)
        """
        return _placed(self.problem, self._nlp.copy(), self._scaled_point(x), scaled=self._scaled)

    # --- units -----------------------------------------------------------------------------------------------------------

    def _shown(self, y: Array) -> Array:
        """Return x of a point of the scaled programme."""
        return self._x_origin + self._x_size * y

    def _scaled_point(self, x: ArrayLike) -> Array:
        return (self._sized("x", x, len(self.variables), "variables") - self._x_origin) / self._x_size

    def _sized(self, name: str, value: ArrayLike, count: int, of: str) -> Array:
        """Return an argument that has a number for each variable or constraint.

        Raises
        ------
        InputError
            If it has not.
        """
        array = check_array(name, value)
        if array.shape != (count,):
            message = f"its shape is {array.shape}, the programme has {count} {of}"
            raise InputError(message, f"Give an array of shape ({count},)", key=name)
        return array


def _placed(problem: ProblemFile, nlp: NLP, y: Array, *, scaled: bool = False) -> Programme:
    """Return the programme that starts at a point, with the exchange points at its peaks."""
    design_task(problem).place(problem, nlp, y)
    return Programme(problem, nlp, nlp.lifted(y), scaled=scaled)


def cosines(programme: Programme) -> list[bool]:
    """Return of each constraint whether it is the cosine of a limited angle, which falls as the angle rises."""
    return [row.scale.cosine for row in programme._nlp.rows]


def slot_of(programme: Programme, row: int) -> int | None:
    """Return the number of the movable position to which a constraint belongs; None if it has a fixed one, or none."""
    first, each = programme._nlp.exchange_rows
    slot = (row - first) // max(1, each)
    return slot if each and 0 <= slot < programme._nlp.exchange_count else None


def moved_rows(programme: Programme, x: Array, slot: int, share: float) -> Array:
    """Move a movable position of a programme to a share of its motion; return the constraints (m,) at x."""
    programme._p[len(programme._p) - programme._nlp.exchange_count + slot] = share
    programme._point = None
    return programme._g_origin + programme._g_size * programme._nlp.values(programme._scaled_point(x), programme._p)[1]


def _as_designed(result: DesignResult) -> ProblemFile:
    """Return the problem of a result with the assembly modes of its design, and its rotation where the points leave it open."""
    problem, machine = result.definite, result.machine
    if machine is None or not getattr(problem.model, "pointed", False):
        return problem
    model = problem.spec
    if model.data.offsets is not None or model.rotation != "either":
        return problem
    return problem.override({f"{model.each[0].key}.rotation": "clockwise" if crank_speed(machine) < 0.0 else "counter-clockwise"})


@typed
def build(problem: AnyProblem | DesignResult) -> Programme:
    """Return the nonlinear programme of a design problem.

    Parameters
    ----------
    problem : ProblemFile, str, Path or DesignResult
        From `optlink.load`, the name of a shipped problem, or a file. It has a requirement or an objective over the cycle,
        definite assembly modes, and for points or poses with free timing a definite rotation. With an objective over the cycle
        the programme is that of the order of reversals and loads at the start. Of a result of `optlink.solve` or `validate`: the
        programme with the assembly modes and the rotation of its design, which is the start.

    Returns
    -------
    Programme

    Raises
    ------
    InputError
        If the problem has no design variables or no such programme, or if it leaves an assembly mode or the rotation open.

    Examples
    --------
    >>> programme = optlink.build(optlink.load("crank-rocker"))
    >>> [(variable.name, variable.unit, variable.low, variable.high) for variable in programme.variables]
    [('coupler', 'm', 0.1, 0.9), ('rocker', 'm', 0.1, 0.9)]
    >>> x = programme.x_of({"coupler": 0.412865, "rocker": 0.232246})  # [m]
    >>> round(programme.f(x), 6), programme.f_unit, programme.gradient(x).round(3)  # [rad^2], [rad^2/m]
    (0.007592, 'rad^2', array([0.071, 0.065]))
    """
    design: Mapping[str, float] = {}
    if not isinstance(problem, ProblemFile | str | Path):
        if not hasattr(problem, "definite"):
            message, remedy = "this result has no design variables", "Give its problem, or a result of optlink.solve"
            raise InputError(message, remedy, key="problem", value=problem)
        design, problem = problem.design, _as_designed(problem)
    problem = problem_of(problem)
    task = design_task(problem)
    if task.most_starts is not None:
        task.check_free(problem)
    variants = problem.variants()
    if len(variants) > 1:
        message = (
            f"{len(variants)} assembly modes are left open ({'; '.join(map(mode_of, variants))}): each has its own programme"
        )
        raise InputError(message, "Build one: optlink.build(problem.variants()[0])", problem.file, "mechanism.assembly")
    nlp = task.programme(variants[0])
    start = task.unknowns(variants[0], nlp, design or nlp.design(nlp.x_start))
    return _placed(variants[0], nlp, start)
