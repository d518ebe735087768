"""Result of balancing: counterweights and springs, measures before and after, shadow prices, trade-off; as data and JSON."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import PlainSerializer, PlainValidator, ValidationInfo, WithJsonSchema

from optlink.balancing.socp import amounts, measured, unit_of
from optlink.dynamics.columns import MotionColumns
from optlink.dynamics.counterweights import Counterweight, FreeSpring
from optlink.dynamics.machine import Machine, Parameters
from optlink.errors import Status
from optlink.linkage.vector2d import Array
from optlink.problem.document import Column, Document, Never, Number, Source
from optlink.problem.file import ProblemFile
from optlink.problem.machine.balance import BalanceSection
from optlink.problem.terms import Term, read_words
from optlink.solvers.solution import LimitState, Relaxation, Solution
from optlink.tasks.machine import machine_of
from optlink.tasks.results.conflict import refutation
from optlink.validation.check import Check, Validation

AGREES = 1e-8
"""Tolerance between the programme and the inverse dynamics of the balanced machine, relative to the largest amount."""

ACTIVE = 1e-6
"""Distance from a limit, relative, up to which it is active."""


def _by_name(key: str) -> tuple[Any, ...]:
    """Return how a permitted counterweight or spring is written: by its name in the problem, the attribute `key`."""

    def found(name: str, info: ValidationInfo) -> Any:
        problem: ProblemFile = (info.context or {})["problem"]
        assert problem.model.balance is not None
        permitted = problem.model.balance.build(machine_of(problem))
        return next(item for group in permitted for item in group if getattr(item, key, None) == name)

    return PlainSerializer(attrgetter(key)), PlainValidator(found), WithJsonSchema({"type": "string"})


def _term(words: str, info: ValidationInfo) -> Term:
    """Return the term that a document names."""
    return (info.context or {})["problem"].model.balance.term(Term.model_validate(read_words(words)))  # type: ignore[no-any-return]


Measured = Annotated[Term, PlainSerializer(attrgetter("words")), PlainValidator(_term), WithJsonSchema({"type": "string"})]


def column_of(term: Term, axis: str = "") -> str:
    """Return the name of a column of a term, with its unit; `axis` is "_x" or "_y" for a component."""
    parts = (term.quantity, term.of, term.on and f"on {term.on}")
    return f"{' '.join(filter(None, parts)).replace(' ', '_')}{axis}_{unit_of(term).replace(' ', '')}"


@dataclass(frozen=True)
class AddedCounterweight:
    """A counterweight of the result: its inertia parameters in the axes of its body [SI]."""

    shown: ClassVar[Mapping[str, Source]] = {
        "body": "body",
        "kind": "specification.kind",
        "mass_kg": "mass",
        "along_m": "along",
        "across_m": "across",
        "first_moment_along_kg_m": "parameters.along",
        "first_moment_across_kg_m": "parameters.across",
        "moment_of_inertia_about_start_kg_m2": "parameters.moment",
        "radius_of_gyration_m": "gyration",
        "radius_m": "radius",
        "thickness_m": "thickness",
    }

    specification: Annotated[Counterweight, *_by_name("body")]
    parameters: Annotated[
        Parameters,
        PlainSerializer(lambda parameters: [float(value) for value in parameters]),
        PlainValidator(lambda values: Parameters(*values)),
        WithJsonSchema({"type": "array", "items": {"type": "number"}}),
    ]

    @property
    def body(self) -> str:
        """Body that carries the counterweight."""
        return self.specification.body

    @property
    def mass(self) -> float:
        """Its mass [kg]."""
        return float(self.parameters.mass)

    @property
    def along(self) -> float:
        """Its centre along the body [m]."""
        return float(self.parameters.along) / self.mass

    @property
    def across(self) -> float:
        """Its centre across the body [m]."""
        return float(self.parameters.across) / self.mass

    @property
    def place(self) -> tuple[float, float]:
        """Its centre in the axes of the body [m]."""
        return self.along, self.across

    @property
    def gyration(self) -> float:
        """Radius of gyration about its centre [m]."""
        x, y = self.place
        return math.sqrt(max(float(self.parameters.moment) / self.mass - x * x - y * y, 0.0))

    @property
    def radius(self) -> float | None:
        """Radius of the disc [m]; None for a free shape."""
        return self.specification.radius_of(self.mass) if self.specification.kind == "disc" else None

    @property
    def thickness(self) -> float | None:
        """Thickness of the disc [m]; None for a free shape, or where its density is unknown."""
        return self.specification.thickness_of(self.mass) if self.specification.kind == "disc" else None


@dataclass(frozen=True)
class FittedSpring:
    """A spring of the result: stiffness [N/m], free length [m]."""

    shown: ClassVar[Mapping[str, Source]] = {
        "name": "specification.name",
        "stiffness_N_m": "stiffness",
        "free_length_m": "free",
        "between": "between",
    }

    specification: Annotated[FreeSpring, *_by_name("name")]
    stiffness: float
    free: float

    @property
    def between(self) -> list[str]:
        """Points to which it is attached."""
        return [point for _, point in self.specification.ends]


@dataclass(frozen=True)
class MeasureChange:
    """A measure before and after balancing [SI]."""

    shown: ClassVar[Mapping[str, Source]] = {
        "name": "measure.words",
        "unit": lambda row: unit_of(row.measure),
        **{name: name for name in ("before", "after", "change")},
    }

    measure: Measured
    before: float
    after: float

    @property
    def change(self) -> float:
        """Relative change; -0.3 is a reduction by 30 per cent."""
        return self.after / self.before - 1.0 if self.before > 0.0 else math.nan


@dataclass(frozen=True, kw_only=True)
class ActiveLimit(LimitState):
    """A limit at the optimum; `buys`: first-order relative reduction of the objective if it alone is relaxed by one `step`."""

    step: float
    buys: Number

    @property
    def price(self) -> float:
        """Reduction of the objective per unit by which the limit is relaxed."""
        return abs(self.multiplier)


@dataclass(frozen=True, kw_only=True)
class RelaxedLimit(Relaxation):
    """A limit that conflicts with others [display unit]: `relaxed` alone, or the value required if all are relaxed `together`."""

    together: float


@dataclass(frozen=True)
class TradePoint:
    """A point of the trade-off [SI]: `gap` relative; `realised`: both measures by inverse dynamics, with realisable discs.

    `excess`: largest relative violation of a limit by these discs.
    """

    first: float
    second: float
    gap: float
    rate: Number
    realised: tuple[float, float]
    disagreement: float
    masses: Mapping[str, float]
    excess: float


@dataclass(frozen=True)
class TradeOff:
    """The trade-off between two measures.

    `knee`: index of the point farthest from the chord of the ends; None if the curve is practically straight.
    """

    shown: ClassVar[Mapping[str, Source]] = {
        "first": "first.words",
        "second": "second.words",
        **{name: name for name in ("before", "knee", "monotone")},
        "first_point_s": "first_seconds",
        "further_point_s": "further_seconds",
        "ratio": "ratio",
        "points": "points",
    }

    first: Measured
    second: Measured
    before: tuple[float, float]
    points: tuple[TradePoint, ...]
    knee: int | None
    first_seconds: float
    further_seconds: Number

    @property
    def ratio(self) -> float:
        """Solution time of a further point over that of the first, which the parametrised programme saves."""
        return self.further_seconds / self.first_seconds

    @property
    def monotone(self) -> bool:
        """Whether the first measure rises and the second falls from point to point."""
        first, second = (np.array([getattr(p, key) for p in self.points]) for key in ("first", "second"))
        return bool(np.all(np.diff(first) >= -AGREES * self.before[0]) and np.all(np.diff(second) <= AGREES * self.before[1]))

    @property
    def notes(self) -> list[str]:
        """A note on points whose discs miss a limit."""
        missed = [f"{k}" for k, point in enumerate(self.points, 1) if point.excess > ACTIVE]
        text = f"points {', '.join(missed)} of {len(self.points)} of the trade-off are bounds only"
        return [f"{text}: no discs were found there that meet all limits"] if missed else []


MESSAGES = {
    Status.OPTIMAL: "globally optimal: no counterweights within the limits do better, up to the duality gap",
    Status.RELAXED: "near the lower bound: no discs were found that reach it",
    Status.INFEASIBLE: "no counterweights meet all limits",
    Status.STALLED: "the duality gap stayed too large: not verified as an optimum; relax a limit or scale the problem",
}


@dataclass(frozen=True, repr=False)
class Balance(Document):
    """A balanced machine, or the limits that conflict.

    `status`: optimal, relaxed (discs approach the proven bound without reaching it), infeasible or stalled. `objective` and
    `before` in the unit of the measure, or as weighted ratios to the original machine; `lower`: proven lower bound; `gap`:
    relative duality gap; `slack`: relative excess of the realisable design over the bound. `disagreement`: difference of the
    programme from the inverse dynamics of `machine`, the problem with the new bodies.
    """

    kind = "balance"
    shown: ClassVar[Mapping[str, Source]] = {
        **{name: name for name in ("proven", "measure", "unit", "reduction", "verified")},
        "lower_bound": "lower",
        "duality_gap": "gap",
        "above_bound": "slack",
        "exact_least_squares": "exact",
        "positions": "angles.size",
        "speed_rad_s": "speed",
        "moment_about_m": "about",
        "counterweights": "added",
        "springs": "springs",
        "measures": "rows",
        "trade?": "trade",
        "validation": "validation.checks",
    }
    interrupted = False
    """A convex programme is never left early."""
    starts = 1
    """Number of searches."""
    seed: ClassVar[None] = None
    """It has no random starting points."""
    solution: ClassVar[None] = None
    """It is a cone programme, not a nonlinear one."""
    certificate: ClassVar[None] = None
    """The optimum of a convex programme is global: see `lower` and `gap`."""
    backends: ClassVar[Mapping[str, Solution]] = MappingProxyType({})
    """There is one solver."""

    problem: ProblemFile
    status: Status
    angles: Column
    speed: float
    about: tuple[float, float]
    before: float
    objective: Number = math.nan
    lower: Number = math.nan
    gap: Number = math.nan
    slack: float = 0.0
    added: tuple[AddedCounterweight, ...] = ()
    springs: tuple[FittedSpring, ...] = ()
    machine: ProblemFile | None = None
    rows: tuple[MeasureChange, ...] = ()
    disagreement: Never = math.inf
    limits: tuple[ActiveLimit, ...] = ()
    conflict: tuple[RelaxedLimit, ...] = ()
    trade: TradeOff | None = None
    notes: tuple[str, ...] = ()
    solver: str = ""
    iterations: int = 0
    exact: bool = False
    excess: float = 0.0
    seconds: Mapping[str, float] = field(default_factory=dict)
    further: tuple[Check, ...] = ()

    @property
    def backend(self) -> str:
        """The solver."""
        return self.solver

    @property
    def definite(self) -> ProblemFile:
        """The problem."""
        return self.problem

    @cached_property
    def original(self) -> Machine:
        """The machine before balancing."""
        return machine_of(self.problem)

    @cached_property
    def heavier(self) -> Machine | None:
        """The balanced machine; None if there is none."""
        return None if self.machine is None else machine_of(self.machine)

    @property
    def best(self) -> Self:
        """The result itself."""
        return self

    @property
    def section(self) -> BalanceSection:
        """The section `[balance]` of the problem."""
        assert self.problem.model.balance is not None
        return self.problem.model.balance

    @property
    def unit(self) -> str:
        """Unit of the objective."""
        return unit_of(self.section.goals[0].term) if self.section.single else ""

    @property
    def measure(self) -> str:
        """Name of the minimised measure."""
        return self.section.words

    @property
    def verified(self) -> bool:
        """Whether the inverse dynamics of the balanced machine agrees with the programme."""
        return self.machine is not None and self.validation.checks[0].passed

    @property
    def proven(self) -> bool:
        """Whether the design is proven to be the optimum."""
        return self.status is Status.OPTIMAL

    @cached_property
    def refuted(self) -> str:
        """Which limits exclude each other, in a sentence; empty if no limits conflict."""
        return refutation(self.conflict, "counterweights")

    @property
    def message(self) -> str:
        """What the status means, in one sentence."""
        return self.refuted or MESSAGES[self.status]

    @property
    def valid(self) -> bool:
        """Whether a design satisfies all limits and is verified, and one does at every point of a trade-off."""
        return self.status in (Status.OPTIMAL, Status.RELAXED) and self.validation.valid

    @cached_property
    def validation(self) -> Validation:
        """Checks of the design by inverse dynamics, with those of every point of a trade-off; none without a design."""
        if self.machine is None:
            return Validation(self.further, math.nan)
        points = self.trade.points if self.trade else ()
        gap = max([self.disagreement, *(point.disagreement for point in points)])
        excess = max([self.excess, *(point.excess for point in points)])
        agrees = Check("the programme agrees with inverse dynamics", gap <= AGREES, gap, f"<= {AGREES:.0e}", "")
        within = Check("all limits met (relative)", excess <= ACTIVE, excess, f"<= {ACTIVE:.0e}", "")
        return Validation((agrees, within, *self.further), self.objective)

    def with_checks(self, checks: Sequence[Check]) -> Self:
        """Return the result with further checks."""
        return replace(self, further=(*self.further, *checks))

    @cached_property
    def columns(self) -> dict[str, Array]:
        """All measured values over the positions, before and after balancing, by name with unit."""
        driving = self.problem.model.driving
        columns = {driving.column: driving.shown(self.angles)}
        machines = {"before": self.original} | ({"after": self.heavier} if self.heavier is not None else {})
        for when, machine in machines.items():
            record = MotionColumns(machine.moving(self.angles, self.speed))
            for term in measured(machine, self.section):
                values = amounts(record, term)
                for axis, part in zip(("",) if values.shape[1] == 1 else ("_x", "_y"), values.T, strict=True):
                    columns[f"{when}.{column_of(term, axis)}"] = part
        return columns

    @property
    def design(self) -> dict[str, float]:
        """Masses and centres of the counterweights [kg, m] and stiffnesses of the springs [N/m], by name."""
        design: dict[str, float] = {}
        for weight in self.added:
            design |= {f"{weight.body}.{name}": getattr(weight, name) for name in ("mass", "along", "across")}
        for spring in self.springs:
            name = spring.specification.name
            design |= {f"{name}.stiffness": spring.stiffness, f"{name}.free_length": spring.free}
        return design

    @property
    def reduction(self) -> float:
        """Reduction of the objective relative to its value before balancing."""
        return 1.0 - self.objective / self.before if self.before > 0.0 else math.nan
