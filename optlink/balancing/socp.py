"""Balancing as a second-order cone programme (cvxpy), with a certificate computed from the dual solution.

All quantities are scaled: a measure by its value in the original machine, parameters by a typical mass and length of the machine.
"""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np

from optlink.dynamics.columns import MotionColumns
from optlink.dynamics.counterweights import Counterweight, Effects, FreeSpring
from optlink.dynamics.inverse import reactions, required_wrench
from optlink.dynamics.machine import Machine, Parameters
from optlink.errors import SolverError
from optlink.linkage.vector2d import TURN, Array, max_magnitude
from optlink.problem.machine.balance import BalanceSection
from optlink.problem.terms import Term, linear_drives
from optlink.units import KINDS

# Forces and torques that terms name, over the positions of a machine: convex in the masses and stiffnesses that are added.


def amounts(record: MotionColumns, term: Term) -> Array:
    """Return the force or torque of a term at the positions that count, (positions, parts); the parts of a force are x and y."""
    moving, signal = record.moving, term.nature.signal
    assert signal is not None
    acting = reactions(moving, required_wrench(moving, inertia=False)) if term.static else record.reactions
    values = np.stack([record.full(part) for part in signal(moving, acting, term)], axis=-1)
    if term.over is None:
        return values
    low, high = term.over.bounds
    turned = np.mod(np.asarray(moving.motion.crank_angle, dtype=float) - low, TURN)
    return values[(turned <= high - low + 1e-9) | (turned >= TURN - 1e-9)]


def value(term: Term, values: Array) -> float:
    """Return the root mean square or the largest magnitude of amounts (positions, parts)."""
    squares = np.sum(values * values, axis=1)
    return float(np.sqrt(np.mean(squares) if term.how == "rms" else np.max(squares)))


def unit_of(term: Term) -> str:
    """Return the display unit of a term."""
    return KINDS[term.nature.kind].display.replace("*", " ")


def measured(machine: Machine, section: BalanceSection) -> list[Term]:
    """Return all terms that are measured, as root mean squares: shaking force and moment, torque, every reaction."""
    drive = [{"quantity": "drive force", "of": drive.name} for drive in linear_drives(machine.mechanism)] or [
        {"quantity": "torque"}
    ]
    terms: list[dict[str, Any]] = [{"quantity": "shaking force"}, {"quantity": "shaking moment"}, *drive]
    for point, bodies in machine.mechanism.pins.items():
        terms += [{"quantity": "reaction", "of": point, "on": body} for body in (bodies if len(bodies) > 2 else (None,))]
    terms += [{"quantity": "guide force", "of": guide.name} for guide in machine.mechanism.guides]
    return [section.term(Term.model_validate({**term, "measure": "rms"})) for term in terms]


NOTHING = 1e-9
"""Scaled mass or stiffness below which a counterweight or spring counts as absent."""

SHORTEST = 1e-9
"""Free length of a spring [m] below which there is none: a problem file states no shorter one."""

CONSTRAINT_TOLERANCE = 1e-8
"""Violation of a scaled constraint that is permitted as rounding error."""


@dataclass(frozen=True)
class BalanceBound:
    """A limit that can be relaxed: `expression` (scaled) times `scale` is at most (sense +1) or at least (-1) `bound` [SI]."""

    name: str
    kind: str
    expression: Any
    bound: float
    scale: float
    sense: int = 1


@dataclass(frozen=True)
class PlaceLimit:
    """A limit on the position of a counterweight: `inside` <= mass * bound / length.

    For a limit on the radius of gyration, `inside` and the right side are squared.
    """

    name: str
    bound: float
    constraint: Any
    inside: Any
    mass: Any
    length: float
    squared: bool = False

    @property
    def reached(self) -> float:
        """Distance reached [m]; zero without a mass."""
        mass = float(self.mass.value)
        share = max(float(self.inside.value), 0.0) / mass if mass > NOTHING else 0.0
        return (math.sqrt(share) if self.squared else share) * self.length

    @property
    def rate(self) -> float:
        """Derivative of the right side of the constraint with respect to the bound [1/m]."""
        rate = float(self.mass.value) / self.length
        return 2.0 * rate * self.bound / self.length if self.squared else rate


@dataclass(frozen=True)
class Price:
    """Shadow price of a limit: its bound [SI], the value reached, and the decrease of the objective per SI unit of relaxation.

    It is relaxed alone; `depends_on`: names of other limits that keep the optimum then.
    """

    name: str
    kind: str
    bound: float
    value: float
    sense: int
    price: float
    depends_on: tuple[str, ...] = ()


class BalancingProgramme:
    """The feasible counterweights and springs of a machine, and measures of them, as convex expressions.

    `measures` have upper bounds [SI], and `total` are the least and the largest mass of all counterweights together [kg];
    `mass` [kg] and `length` [m] are typical of the machine. The parameters are in the order of `effects`.
    """

    def __init__(
        self,
        effects: Effects,
        counterweights: Sequence[Counterweight],
        springs: Sequence[FreeSpring],
        measures: Sequence[tuple[Term, float]],
        total: tuple[float, float],
        mass: float,
        length: float,
    ) -> None:
        import cvxpy

        self.cp: Any = cvxpy
        self.effects, self.counterweights, self.springs = effects, counterweights, springs
        self.length, self.begin = length, 4 * len(counterweights)  # of the parameters of springs
        self._cached_rows: dict[Term, tuple[float, Array, Array]] = {}
        self.scales = np.concatenate([self._scale(w, mass) for w in counterweights] + [self._stiffness(s) for s in springs])
        self.x = self.cp.Variable(effects.count)
        self.hard: list[PlaceLimit] = []
        self.roots: list[tuple[Any, int]] = []  # variables that stand for square roots of parameters
        self.cones: list[Any] = []
        self.relaxed: list[Any] = []  # relaxations of the moments of inertia of discs
        self.bounds: list[BalanceBound] = []
        for k, weight in enumerate(counterweights):
            self._counterweight(weight, self.x[4 * k : 4 * k + 4], self.scales[4 * k : 4 * k + 4])
        for k, spring in zip(range(self.begin, effects.count, 2), springs, strict=True):
            self._spring(spring, self.x[k : k + 2], self.scales[k : k + 2])
        if counterweights:
            self._between("mass of all counterweights together", "mass", self.total, total, self.mass_scale)
        for measure, bound in measures:
            scale = self.before(measure) or 1.0
            self.bounds.append(BalanceBound(measure.words, measure.nature.kind, self.expression(measure), bound, scale))

    # --- scaling ------------------------------------------------------------------------------------------------------

    def _scale(self, weight: Counterweight, mass: float) -> Array:
        size = weight.mass[1] if 0.0 < weight.mass[1] < math.inf else mass
        reach = min(weight.reach, weight.extent, self.length)
        return np.array([size, size * reach, size * reach, size * reach * reach])

    def _stiffness(self, spring: FreeSpring) -> Array:
        """Return the scales of a spring: the upper bound of its stiffness, else a stiffness typical of the driving torque."""
        high = spring.stiffness[1]
        if not 0.0 < high < math.inf:
            linear = linear_drives(self.effects.original.machine.mechanism)
            effort = (
                Term(quantity="drive force", of=linear[0].name, measure="rms")
                if linear
                else Term(quantity="torque", measure="rms")
            )
            size = self.length if linear else self.length**2
            high = (value(effort, amounts(self.effects.original, effort)) or 1.0) / size
        return np.array([high, high * self.length])

    @cached_property
    def mass_scale(self) -> float:
        """Unit of the total mass [kg]."""
        return float(np.max(self.scales[: self.begin : 4]))

    @property
    def total(self) -> Any:
        """Mass of all counterweights, in units of `mass_scale`."""
        share = np.zeros(self.effects.count)
        share[: self.begin : 4] = self.scales[: self.begin : 4] / self.mass_scale
        return share @ self.x

    # --- feasible counterweights and springs -----------------------------------------------------------------------------

    def _counterweight(self, weight: Counterweight, x: Any, scale: Array) -> None:
        """Add the cones of a counterweight: with mass m, first moments p about the start of the body, moment of inertia J.

        J >= |p|^2 / m holds for every mass distribution; a disc adds its own m^2 / (2 pi rho t) or m r^2 / 2. A disc needs
        equality, which is relaxed to an inequality with an upper bound from its limits and restored afterwards.
        """
        cp, unit, length = self.cp, float(scale[0]), float(scale[1] / scale[0])
        m, p, inertia = x[0], x[1:3], x[3]
        label = f"of the counterweight on {weight.body}"
        self.cones.append(m >= 0.0)
        self._between(f"mass {label}", "mass", m, weight.mass, unit)
        origin = np.array(weight.origin) / length
        away = p - m * origin
        if weight.at is None:
            steiner = cp.quad_over_lin(p, m)
        else:
            at = np.array(weight.at) / length
            self.cones.append(p == m * at)
            steiner = float(at @ at) * m
        moment: Any = 0.0
        if weight.kind == "disc":
            linear, square = self._own_moment(weight, unit, length)
            moment = linear * m if weight.radius is not None else square * cp.square(m)
        if weight.at is not None and weight.radius is not None:
            self.cones.append(inertia == steiner + moment)  # linear: nothing to relax
        else:
            (self.relaxed if weight.kind == "disc" else self.cones).append(steiner + moment <= inertia)
        furthest = math.hypot(*weight.origin) + min(weight.reach, weight.extent) if weight.at is None else math.hypot(*weight.at)
        if weight.reach < math.inf:
            self._hard(f"reach {label}", weight.reach, cp.norm(away), m, length)
        if weight.extent < math.inf:
            name = f"extent {label}"
            if weight.kind == "free":  # no part of it lies further from the origin, so nor does its radius of gyration
                about = inertia - 2.0 * (origin @ p) + float(origin @ origin) * m
                self._hard(name, weight.extent, about, m, length, squared=True)
            elif weight.radius is not None:
                self._hard(name, weight.extent, cp.norm(away) + m * (weight.radius / length), m, length)
            else:  # m |c| + m r, with m r ~ m^(3/2): m^2 / s with s <= sqrt(m)
                root = cp.Variable()
                self.roots.append((root, 4 * self.counterweights.index(weight)))
                edge = math.sqrt(2.0 * weight.spread * unit) / length
                self.cones.append(cp.square(root) <= m)
                self._hard(name, weight.extent, cp.norm(away) + edge * cp.quad_over_lin(m, root), m, length)
        if weight.kind == "disc" and furthest < math.inf:
            # the largest that a disc's moment of inertia can be, as a multiple of its mass
            widest = min(weight.radius_of(weight.mass[1]), weight.extent)
            if widest < math.inf:
                self.relaxed.append(inertia <= m * (furthest**2 + 0.5 * widest**2) / length**2)

    @staticmethod
    def _own_moment(weight: Counterweight, unit: float, length: float) -> tuple[float, float]:
        """Return the scaled central moment of inertia of a disc over its mass, if its radius is given, else over its square."""
        if weight.radius is not None:
            return 0.5 * (weight.radius / length) ** 2, 0.0
        return 0.0, weight.spread * unit / length**2

    def _between(self, name: str, kind: str, expression: Any, ends: tuple[float, float], scale: float) -> None:
        """Add the bounds of a quantity that are neither zero nor infinite."""
        low, high = ends
        if low > 0.0:
            self.bounds.append(BalanceBound(name, kind, expression, low, scale, -1))
        if high < math.inf:
            self.bounds.append(BalanceBound(name, kind, expression, high, scale))

    def _hard(self, name: str, bound: float, inside: Any, mass: Any, length: float, *, squared: bool = False) -> None:
        constraint = inside <= mass * (bound / length) ** (2 if squared else 1)
        self.cones.append(constraint)
        self.hard.append(PlaceLimit(name, bound, constraint, inside, mass, length, squared))

    def _spring(self, spring: FreeSpring, x: Any, scale: Array) -> None:
        """Add the limits of a spring: stiffness k, k * free length, and the force at every position."""
        k, p = x[0], x[1]
        self.cones.append(k >= 0.0)
        self._between(f"stiffness of {spring.name}", "stiffness", k, spring.stiffness, float(scale[0]))
        shortest, longest = (end / self.length for end in spring.free)
        self.cones += [p == k * shortest] if shortest == longest else [p >= k * shortest, p <= k * longest]
        if spring.force < math.inf:
            lengths = self.effects.lengths(spring) / self.length
            ends = np.array([float(np.min(lengths)), float(np.max(lengths))])  # the force is linear in the length
            largest = self.cp.max(self.cp.abs(ends * k - p))
            self.bounds.append(BalanceBound(f"force of {spring.name}", "force", largest, spring.force, float(scale[1])))

    @property
    def size(self) -> Any:
        """Added mass plus added stiffness, each in its scale."""
        mass = self.total if self.counterweights else 0.0
        return mass + self.cp.sum(self.x[self.begin :: 2]) if self.springs else mass

    # --- measures -----------------------------------------------------------------------------------------------------------

    def _rows(self, measure: Term) -> tuple[float, Array, Array]:
        """Return the original value of a measure, its scaled rows (positions, parts, n) or (k, n), and its offsets."""
        if measure not in self._cached_rows:
            affine = self.effects.affine(lambda record: amounts(record, measure))
            before = value(measure, affine.offset)
            rows, offset = affine.compressed() if measure.how == "rms" else (affine.matrix, affine.offset)
            scale = before or max_magnitude(rows @ self.scales) or 1.0
            self._cached_rows[measure] = before, rows * self.scales / scale, offset / scale
        return self._cached_rows[measure]

    def before(self, measure: Term) -> float:
        """Return the value of a measure in the original machine [SI]."""
        return self._rows(measure)[0]

    def rows(self, measure: Term) -> tuple[Array, Array]:
        """Return scaled rows and offset of a measure: (k, n) and (k,) for a root mean square, else (positions, parts, n)."""
        return self._rows(measure)[1:]

    def expression(self, measure: Term) -> Any:
        """Return a measure divided by its value in the original machine, as a convex expression."""
        cp = self.cp
        _, rows, offset = self._rows(measure)
        if measure.how == "rms":
            return cp.norm(rows @ self.x + offset)
        positions, parts = offset.shape
        total = cp.reshape(rows.reshape(-1, rows.shape[-1]) @ self.x + offset.ravel(), (positions, parts), order="C")
        return cp.max(cp.norm(total, axis=1)) if parts > 1 else cp.max(cp.abs(total))

    def evaluate(self, measure: Term, x: Array) -> float:
        """Return a measure at scaled parameters (n,), divided by its value in the original machine."""
        _, rows, offset = self._rows(measure)
        total = rows @ x + offset
        return float(np.linalg.norm(total)) if measure.how == "rms" else value(measure, total)

    @property
    def found(self) -> Array:
        """Scaled parameters of the programme that was solved last."""
        return np.array(self.x.value, dtype=float)

    # --- solving ---------------------------------------------------------------------------------------------------------------

    def constraints(self, skip: BalanceBound | None = None) -> list[Any]:
        """Return all constraints except one, those that can be relaxed last."""
        return [*self.cones, *self.relaxed, *(self.row(bound) for bound in self.bounds if bound is not skip)]

    def realised(self, x: Array) -> Array:
        """Return scaled parameters that can be built: discs have the moments of inertia of their masses and positions."""
        result = x.copy()
        for k, weight in enumerate(self.counterweights):
            place = slice(4 * k, 4 * k + 4)
            if result[4 * k] <= NOTHING:
                result[place] = 0.0
                continue
            result[place] = np.array(weight.realised(Parameters(*(x[place] * self.scales[place])))) / self.scales[place]
        for i, spring in zip(range(self.begin, len(x), 2), self.springs, strict=True):
            stiffness = float(x[i]) if x[i] > NOTHING else 0.0
            low, high = (end / self.length * stiffness for end in spring.free)
            rest = min(max(x[i + 1], low), high)
            result[i : i + 2] = stiffness, 0.0 if rest * self.length < stiffness * SHORTEST else rest
        return result

    def with_mass(self, x: Array) -> Array:
        """Return scaled parameters in which discs without mass have the mass of a disc with their moment of inertia."""
        result = x.copy()
        for k, weight in enumerate(self.counterweights):
            place = slice(4 * k, 4 * k + 4)
            moment = float(x[4 * k + 3] * self.scales[4 * k + 3])
            if weight.kind == "disc" and x[4 * k] <= NOTHING < x[4 * k + 3]:
                mass = math.sqrt(moment / weight.spread) if weight.radius is None else 2.0 * moment / weight.radius**2
                along, across = weight.at or weight.origin
                result[place] = np.array([mass, mass * along, mass * across, moment]) / self.scales[place]
        return result

    def put(self, x: Array) -> None:
        """Assign scaled parameters to the variables of the expressions."""
        filled = x.copy()
        for k in range(len(self.counterweights)):
            if x[4 * k] <= NOTHING:  # without a mass the position is undefined
                filled[4 * k : 4 * k + 4] = 1e-200, 0.0, 0.0, max(float(x[4 * k + 3]), 0.0)
        self.x.value = filled
        for root, place in self.roots:
            root.value = math.sqrt(max(float(filled[place]), 0.0))

    def excess(self, x: Array) -> float:
        """Return the largest violation of limits and cones, without the relaxed moments of inertia of discs."""
        self.put(x)
        return max((float(np.max(row.violation())) for row in [*self.cones, *map(self.row, self.bounds)]), default=0.0)

    def satisfies(self, x: Array, rows: Sequence[Any]) -> bool:
        """Return whether scaled parameters satisfy the cones and some constraints."""
        self.put(x)
        return all(float(np.max(row.violation())) <= CONSTRAINT_TOLERANCE for row in [*self.cones, *rows])

    def tangent(self, x: Array, k: int) -> tuple[Array, float]:
        """Linearise the moment of inertia of the disc number `k` at scaled parameters: it is about slope . x + level."""
        weight, place = self.counterweights[k], 4 * k
        unit, length = float(self.scales[place]), float(self.scales[place + 1] / self.scales[place])
        m, p = float(x[place]), x[place + 1 : place + 3]
        slope = np.zeros(len(x))
        if m <= NOTHING:
            return slope, 0.0
        linear, square = self._own_moment(weight, unit, length)
        slope[place] = -float(p @ p) / m**2 + linear + 2.0 * square * m
        slope[place + 1 : place + 3] = 2.0 * p / m
        return slope, float(p @ p) / m + linear * m + square * m * m - float(slope @ x)

    @staticmethod
    def row(bound: BalanceBound, slack: Any = 0.0) -> Any:
        """Return the cvxpy constraint of a bound, relaxed by a slack in units of its scale."""
        return bound.sense * bound.expression <= bound.sense * bound.bound / bound.scale + slack


def version() -> str:
    """Return the names and versions of the solver and of cvxpy."""
    solver, modelling = map(import_module, ("clarabel", "cvxpy"))
    return f"Clarabel {solver.__version__}, cvxpy {modelling.__version__}"


# Certificate of a second-order cone programme, computed from its dual solution.

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


def solved(problem: Any) -> ConeCertificate:
    """Solve a problem of cvxpy (`cp`) to the tightest tolerance that the solver reaches, and certify the solution."""
    import cvxpy

    best = ConeCertificate("not solved")
    for options in TOLERANCES:
        settings = {**options, **REFINED}
        data, chain, inverse = problem.get_problem_data(cvxpy.CLARABEL, solver_opts=settings)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an inaccurate solution is judged by its certificate, not by a warning
            raw = chain.solve_via_data(problem, data, False, False, settings)
            try:
                problem.unpack_results(raw, chain, inverse)
            except cvxpy.error.SolverError:
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
    worst = 0.0 if dual or not dims.zero else max_magnitude(s[: dims.zero])
    place = dims.zero + dims.nonneg
    worst = max(worst, -float(np.min(s[dims.zero : place], initial=0.0)))
    for size in dims.soc:
        cone = s[place : place + size]
        worst = max(worst, float(np.linalg.norm(cone[1:]) - cone[0]))
        place += size
    if place != len(s):
        raise SolverError("the programme has a cone that is not certified")
    return worst
