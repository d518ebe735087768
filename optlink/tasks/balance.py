"""Optimise the balancing of a machine by a convex programme, with a lower bound of the objective."""

import importlib
import math
import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from optlink.balancing import optimum as search
from optlink.balancing.socp import GAP, NOTHING, BalanceBound, BalancingProgramme, Price, amounts, measured, value, version
from optlink.dynamics.columns import MotionColumns
from optlink.dynamics.counterweights import Effects, with_counterweight
from optlink.dynamics.machine import Inertia, Machine, Parameters
from optlink.dynamics.strokes import poles
from optlink.errors import InputError, Status, given_as
from optlink.linkage.vector2d import Array, max_magnitude
from optlink.optimization.pareto_front import knee
from optlink.problem.arguments import typed
from optlink.problem.file import AnyProblem, ProblemFile, fixed_design, problem_of
from optlink.problem.quantity import check_range
from optlink.problem.terms import Term
from optlink.tasks.machine import (
    check_design,
    check_one_crank,
    check_regular,
    check_repeats,
    crank_speed,
    machine_of,
    motion_range,
    start_value_notes,
    table_angles,
)
from optlink.tasks.protocol import Progress
from optlink.tasks.results.balance import (
    ACTIVE,
    ActiveLimit,
    AddedCounterweight,
    Balance,
    FittedSpring,
    MeasureChange,
    RelaxedLimit,
    TradeOff,
    TradePoint,
)
from optlink.units import percent

# --- the problem ------------------------------------------------------------------------------------------------------------


def positions(problem: ProblemFile, machine: Machine, speed: float) -> Array:
    """Return the crank angles [rad] at which a machine is balanced; a cycle without its end, which equals its start."""
    section, start = problem.model.balance, problem.model.driving.first
    assert section is not None
    check_one_crank(problem, machine, "balancing", linear=True)
    ranges, low, high = motion_range(problem, machine, start)
    check_regular(problem, ranges, "nothing can be balanced")
    check_repeats(problem, machine)
    angles = table_angles(start, low, high, speed, ranges, section.positions, None)
    return angles[:-1] if ranges.full else angles


ROUNDING = 1e-9
"""Share of the value in the original machine below which the largest amount of a term counts as zero."""


class _Task:
    """A prepared problem: the machine at its positions, the possible counterweights and springs, the convex programme."""

    def __init__(self, problem: ProblemFile) -> None:
        section = problem.model.balance
        if section is None:
            goal = 'objective = { quantity = "shaking force", measure = "rms" }'
            example = f"{goal} and [[balance.counterweights]] with body, thickness, density and reach"
            raise InputError("the problem has no [balance]", f"Add it: {example}", problem.file, "balance")
        self.problem, self.section = problem, section
        self.machine = machine_of(problem)
        self.speed = crank_speed(problem)
        self.angles = positions(problem, self.machine, self.speed)
        self.counterweights, self.springs = section.build(self.machine)
        self.about = section.place(self.machine)
        self.moving = self.machine.moving(self.angles, self.speed)
        self._check_finite()
        self.effects = Effects(self.moving, [weight.body for weight in self.counterweights], self.springs)
        self.limited = [(term, limit.bound(self.before(term))) for term, limit in section.limited]
        masses = sum(float(inertia.mass) for inertia in self.machine.inertias.values())
        self.programme = BalancingProgramme(
            self.effects, self.counterweights, self.springs, self.limited, section.total, masses or 1.0, float(self.machine.size)
        )
        self.goal = [(term, weight * (self.before(term) / scale if scale else 1.0)) for term, weight, scale in section.goals]

    def before(self, term: Term) -> float:
        """Return the value of a term in the original machine [SI]."""
        return value(term, amounts(self.effects.original, term))

    def _check_finite(self) -> None:
        record = MotionColumns(self.moving)
        bad = [*self.angles[record.singular | record.jammed | record.undefined], *poles(self.machine, self.angles, self.speed)]
        if bad:
            where = self.problem.model.driving.texts(np.array(bad[:3]))
            message = f"the reactions are not finite at {where}, so the machine cannot be balanced"
            remedy = "`optlink analyze` gives the reason; keep away from singular positions"
            raise InputError(message, remedy, self.problem.file, "mechanism")

    def parts(self, x: Array) -> tuple[tuple[AddedCounterweight, ...], tuple[FittedSpring, ...]]:
        """Return counterweights and springs of scaled parameters; omit those of negligible size."""
        values = x * self.programme.scales
        added = tuple(
            AddedCounterweight(weight, Parameters(*(float(v) for v in values[4 * k : 4 * k + 4])))
            for k, weight in enumerate(self.counterweights)
            if x[4 * k] > NOTHING
        )
        begin = 4 * len(self.counterweights)
        springs = tuple(
            FittedSpring(spring, float(values[begin + 2 * k]), float(values[begin + 2 * k + 1] / values[begin + 2 * k]))
            for k, spring in enumerate(self.springs)
            if x[begin + 2 * k] > NOTHING
        )
        return added, springs


# --- the result ---------------------------------------------------------------------------------------------------------------


@typed
def balance(
    problem: AnyProblem,
    minimise: str | None = None,
    trade: str | None = None,
    points: int = 25,
    progress: Progress = None,
    design: Mapping[str, float | str] | None = None,
) -> Balance:
    """Optimise counterweights and springs for a measure of a machine, with a lower bound from the dual.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        From `optlink.load`, the name of a shipped problem, or a file, with a section `[balance]`.
    minimise : str, optional
        Term in words, for example "rms shaking force" or "peak reaction at D". Default: the objective of the problem.
    trade : str, optional
        Two terms, for example "force,torque", whose Pareto front is computed.
    points : int
        Number of points of the Pareto front, 3 to 1000.
    progress : function of the completed fraction of the Pareto front, optional
    design : mapping of str to float [SI] or str, optional
        Values of design variables. Default: their starting values.

    Returns
    -------
    Balance
        Counterweights and springs, measures before and after, duality gap, shadow prices and, with `trade`, the Pareto front.

    Raises
    ------
    InputError
        If the problem or an argument is invalid.

    Examples
    --------
    >>> result = optlink.balance(optlink.load("balance-six-bar"))
    >>> result.valid, round(result.objective, 4), round(result.before, 3), [one.body for one in result.added]  # [N]
    (True, 93.7868, 339.668, ['crank', 'link3'])
    """
    problem = problem_of(problem)
    sizes = check_design(problem, design)
    begin = time.perf_counter()
    importlib.import_module("cvxpy")
    seconds = {"loading cvxpy": time.perf_counter() - begin}
    begin = time.perf_counter()
    if sizes is not None:
        problem = fixed_design(problem, problem.model.sizes(sizes))
    if minimise is not None:
        problem = _minimising(minimise, "--minimise", problem)
    task = _Task(problem)
    pair = [] if trade is None else _pair(trade, problem)
    _check(task, pair, points)
    programme, goal = task.programme, task.goal
    solution = search.optimum(programme, goal)
    seconds["optimum"] = time.perf_counter() - begin
    before = programme.before(goal[0][0]) if task.section.single else sum(weight for _, weight in goal)
    common: dict[str, Any] = {name: getattr(task, name) for name in ("problem", "angles", "speed", "about")}
    common |= {"before": before, "solver": version(), "seconds": seconds}
    common["iterations"] = solution.certificate.iterations
    if solution.certificate.status == "infeasible":
        return Balance(
            status=Status.INFEASIBLE, conflict=tuple(_relaxed_limit(item) for item in search.conflict(task.programme)), **common
        )
    if solution.certificate.status != "optimal":
        return Balance(status=Status.STALLED, **common)
    best = search.realised_discs(programme, goal, solution.x)
    added, springs = task.parts(best)
    after = search.evaluate(programme, goal, best)
    scale = before if task.section.single else 1.0
    size = max(solution.value, 1e-3)  # a negligible value is related to the initial machine
    gap, slack = max(solution.gap, 0.0) / size, max(after - solution.value, 0.0) / size
    excess = programme.excess(best)
    within = slack <= GAP and excess <= ACTIVE
    status = Status.STALLED if gap > GAP else Status.OPTIMAL if within else Status.RELAXED
    begin = time.perf_counter()
    balanced = _balanced_problem(task, added, springs)
    heavier, rows, disagreement = _verified(task, balanced, best)
    seconds["verification"] = time.perf_counter() - begin
    curve = None
    if pair:
        begin = time.perf_counter()
        curve = _trade(task, pair[0], pair[1], points, progress)
        seconds["trade"] = time.perf_counter() - begin
    return Balance(
        status=status,
        objective=after * scale,
        lower=solution.lower * scale,
        gap=gap,
        slack=slack,
        added=added,
        springs=springs,
        machine=balanced,
        rows=rows,
        disagreement=disagreement,
        limits=tuple(_active_limit(price, after, scale) for price in solution.prices),
        trade=curve,
        notes=(*_notes(task, status, slack, heavier, added, excess), *(curve.notes if curve else ())),
        exact=solution.exact,
        excess=excess,
        **common,
    )


def _minimising(text: str, option: str, problem: ProblemFile) -> ProblemFile:
    """Return the problem with the objective that a text names."""
    with given_as(problem.file, option, text):
        return problem.override({"balance.objective": text})


def _pair(text: str, problem: ProblemFile) -> list[Term]:
    first, comma, second = text.partition(",")
    if not comma or "," in second:
        raise InputError("a trade-off is between two measures", "Write for example force,torque", key="--trade", value=text)
    sections = (_minimising(part, "--trade", problem).model.balance for part in (first, second))
    return [section.goals[0].term for section in sections if section is not None]


def _check(task: _Task, pair: Sequence[Term], points: int) -> None:
    """Refuse measures that are zero already: they cannot be reduced, and no relative value is defined."""
    check_range("--points", points, 3, 1000)
    if len(pair) == 2 and pair[0] == pair[1]:
        raise InputError("both measures are the same", "Name two, for example force,torque", key="--trade", value=pair[0].words)
    for term in (*(term for term, _ in task.goal), *pair):
        if not task.before(term) > 0.0:
            message = f"the {term.words} of the initial machine is zero: there is nothing to balance"
            raise InputError(message, "Choose another measure, or give the bodies masses", task.problem.file, "balance.objective")


# --- check by inverse dynamics ------------------------------------------------------------------------------------------------


def _balanced_problem(task: _Task, added: Sequence[AddedCounterweight], springs: Sequence[FittedSpring]) -> ProblemFile:
    """Return the problem with the counterweights added to its bodies and the springs to its loads."""
    changes: dict[str, object] = {"balance": None}
    for counterweight in added:
        inertia = with_counterweight(task.machine.inertias.get(counterweight.body, Inertia()), counterweight.parameters)
        changes[f"bodies.{counterweight.body}"] = {
            "mass": f"{float(inertia.mass)!r} kg",
            "centroid": [f"{float(inertia.along)!r} m", f"{float(inertia.across)!r} m"],
            "inertia": f"{float(inertia.moment)!r} kg*m^2",
        }
    for spring in springs:
        changes[f"loads.{spring.specification.name}"] = {
            "between": [point for _, point in spring.specification.ends],
            "stiffness": f"{spring.stiffness!r} N/m",
            **({"free_length": f"{spring.free!r} m"} if spring.free > 0.0 else {}),
        }
    title = f"{task.problem.model.title[:188]}, balanced"
    return task.problem.override({**changes, "title": title, "expected": None})


def _verified(task: _Task, balanced: ProblemFile, x: Array) -> tuple[Machine, tuple[MeasureChange, ...], float]:
    """Return the balanced machine, measures before and after by inverse dynamics, and the disagreement."""
    machine = machine_of(balanced)
    observed, record = measured(task.machine, task.section), MotionColumns(machine.moving(task.angles, task.speed))
    changes = []
    for term in observed:
        before, after = amounts(task.effects.original, term), amounts(record, term)
        for measure in (term.model_copy(update={"measure": how}) for how in ("rms", "peak")):
            changes.append(MeasureChange(measure, value(measure, before), value(measure, after)))
    terms = [*observed, *(term for term, _ in (*task.goal, *task.limited))]
    return machine, tuple(changes), _disagreement(task, terms, record, x)


def _disagreement(task: _Task, terms: Sequence[Term], record: MotionColumns, x: Array) -> float:
    """Return the largest difference of the affine functions from the inverse dynamics, relative to the largest contribution."""
    worst, parameters = 0.0, x * task.programme.scales
    for term in terms:
        affine, amount = task.effects.affine(partial(amounts, term=term)), amounts(record, term)
        size = max(max_magnitude(affine.offset), max_magnitude(affine.matrix * parameters), 1e-300)
        worst = max(worst, max_magnitude(affine.at(parameters) - amount) / size)
    return worst


# --- limits -----------------------------------------------------------------------------------------------------------------

SHOWN: dict[str, tuple[str, float, float]] = {
    "mass": ("kg", 1.0, 0.01),
    "length": ("mm", 1e3, 1e-3),
    "stiffness": ("N/m", 1.0, 0.0),
    "force": ("N", 1.0, 0.0),
    "torque": ("N m", 1.0, 0.0),
}
"""Kinds of limits: display unit, value in it of one in SI, step of the shadow price [SI]; zero: one per cent of the limit."""


def _shown(limit: Price | BalanceBound) -> tuple[str, str, float, float]:
    """Return sense, display unit, factor from SI to it, and step [SI] of a limit."""
    unit, factor, step = SHOWN[limit.kind]
    return "<=" if limit.sense > 0 else ">=", unit, factor, step or 0.01 * abs(limit.bound)


def _active_limit(price: Price, after: float, scale: float) -> ActiveLimit:
    """Return a limit at the optimum with its shadow price.

    `after` is the scaled objective of the balanced machine, `scale` the objective over the scaled one.
    """
    sense, unit, factor, step = _shown(price)
    bound, value = price.bound * factor, price.value * factor
    return ActiveLimit(
        key=price.name,
        name=price.name,
        value=value,
        bound=bound,
        sense=sense,
        unit=unit,
        active=abs(price.bound - price.value) <= ACTIVE * max(abs(price.bound), 1e-12),
        multiplier=-price.sense * price.price * scale / factor,
        slack=price.sense * (bound - value),
        step=step * factor,
        buys=price.price * step / after if after > NOTHING else 0.0,
        depends_on=price.depends_on,
    )


def _relaxed_limit(item: search.Conflict) -> RelaxedLimit:
    """Return a limit that conflicts with others, with the values that it would need."""
    sense, unit, factor, _ = _shown(item.bound)
    bound, single, together = (value * factor for value in (item.bound.bound, item.alone, item.together))
    alone, name = single if math.isfinite(single) else math.nan, item.bound.name
    return RelaxedLimit(name, name, sense, bound, alone, abs(alone - bound), unit, together=together)


# --- the trade-off -----------------------------------------------------------------------------------------------------------


def _trade(task: _Task, first: Term, second: Term, count: int, progress: Progress) -> TradeOff:
    programme = task.programme
    front = search.curve(programme, first, second, count)
    scales = programme.before(first), programme.before(second)
    points = []
    for k, point in enumerate(front.points):
        x = min(map(programme.realised, (point.x, programme.with_mass(point.x))), key=lambda y: max(programme.excess(y), ACTIVE))
        added, springs = task.parts(x)
        machine = machine_of(_balanced_problem(task, added, springs))
        record = MotionColumns(machine.moving(task.angles, task.speed))
        realised = tuple(value(term, amounts(record, term)) for term in (first, second))
        points.append(
            TradePoint(
                point.first * scales[0],
                point.second * scales[1],
                max(point.gap, 0.0),
                point.rate * scales[0] / scales[1],
                (realised[0], realised[1]),
                _disagreement(task, (first, second), record, x),
                {counterweight.body: counterweight.mass for counterweight in added},
                programme.excess(x),
            )
        )
        if progress is not None:
            progress((k + 1) / len(front.points))
    bend = knee(np.array([[point.first, point.second] for point in points]))
    return TradeOff(
        first, second, scales, tuple(points), None if bend is None else bend[0], front.first_seconds, front.further_seconds
    )


# --- notes -------------------------------------------------------------------------------------------------------------------


def _notes(
    task: _Task,
    status: Status,
    slack: float,
    heavier: Machine,
    added: Sequence[AddedCounterweight],
    excess: float,
) -> list[str]:
    notes = []
    if any(weight.kind == "disc" for weight in task.counterweights):
        relaxed_note = "the moments of inertia of discs were relaxed to a convex cone"
        end = (
            "the optimum satisfies the equation of a disc, so it is also the optimum of real discs"
            if status is Status.OPTIMAL
            else f"discs come within {percent(slack, 2)} of the bound"
            if excess <= ACTIVE
            else "no discs were found that meet all limits"
        )
        notes.append(f"{relaxed_note}: {end}")
    idle = [weight.body for weight in task.counterweights if weight.body not in [counterweight.body for counterweight in added]]
    if idle:
        notes.append(f"no counterweight is of use on {', '.join(idle)}")
    notes += start_value_notes(task.problem)
    if len(task.angles) != task.section.positions and task.problem.model.linkage.limits is None:
        notes.append("the crank cannot turn fully: the positions are those of its range")
    notes += _between(task, heavier)
    return notes


def _between(task: _Task, heavier: Machine) -> list[str]:
    """Return notes on higher values between the positions, for largest amounts that are minimised or limited."""
    peaks = [term for term, _ in (*task.goal, *task.limited) if term.how == "peak"]
    if not peaks:
        return []
    fine = np.interp(np.linspace(0, len(task.angles) - 1, 16 * len(task.angles)), np.arange(len(task.angles)), task.angles)
    coarse, dense = (MotionColumns(heavier.moving(angles, task.speed)) for angles in (task.angles, fine))
    notes = []
    for term in peaks:
        at, between = (value(term, amounts(record, term)) for record in (coarse, dense))
        if between > at * (1.0 + 1e-4) + ROUNDING * task.before(term):
            higher = percent(between / at - 1.0, 2)
            notes.append(f"between the positions the {term.words} is up to {higher} higher: use more positions")
    return notes
