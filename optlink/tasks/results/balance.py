"""Result of balancing: counterweights and springs, measures before and after, shadow prices, trade-off; as data and JSON."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Literal, Self

import numpy as np
from annotated_types import Gt
from pydantic import Field, PlainSerializer, PlainValidator, WithJsonSchema, model_validator

from optlink.dynamics.counterweights import BalanceMeasure, Counterweight, FreeSpring, quantities, quantities_of
from optlink.dynamics.inertia import Parameters
from optlink.dynamics.machine import Machine
from optlink.errors import Status
from optlink.linkage.vector2d import Array
from optlink.problem.base_model import Contradiction, Never, Number, Record, Recorded, ResultRecord, absent
from optlink.problem.file import ProblemFile
from optlink.problem.machine.balance import read_measure
from optlink.solvers.solution import Relaxation
from optlink.tasks.results.conflict import refutation

AGREES = 1e-8
"""Tolerance between the programme and the inverse dynamics of the balanced machine, relative to the largest amount."""

Measure = Annotated[BalanceMeasure, PlainValidator(read_measure), PlainSerializer(str), WithJsonSchema({"type": "string"})]
"""A measure as a text, such as "rms shaking force"."""

ACTIVE = 1e-6
"""Distance from a limit, relative, up to which it is active."""


@dataclass(frozen=True)
class AddedCounterweight:
    """A counterweight of the result: its inertia parameters in the axes of its body [SI]."""

    specification: Counterweight
    parameters: Parameters

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


class CounterweightRecord(Record):
    """A counterweight of the result, in the axes of its body [SI]."""

    body: str
    kind: Annotated[str, "specification.kind"]
    mass_kg: Annotated[float, "mass", Gt(0)]
    along_m: Annotated[float, "along"]
    across_m: Annotated[float, "across"]
    first_moment_along_kg_m: Annotated[float, "parameters.along"]
    first_moment_across_kg_m: Annotated[float, "parameters.across"]
    moment_of_inertia_about_start_kg_m2: Annotated[float, "parameters.moment"]
    radius_of_gyration_m: Annotated[float, "gyration"]
    radius_m: Annotated[float | None, "radius"]
    thickness_m: Annotated[float | None, "thickness"]

    @property
    def parameters(self) -> Parameters:
        """Inertia parameters in the axes of the body [SI]."""
        first = self.first_moment_along_kg_m, self.first_moment_across_kg_m
        return Parameters(self.mass_kg, *first, self.moment_of_inertia_about_start_kg_m2)


@dataclass(frozen=True)
class FittedSpring:
    """A spring of the result: stiffness [N/m], free length [m]."""

    specification: FreeSpring
    stiffness: float
    free: float

    @property
    def between(self) -> list[str]:
        """Points to which it is attached."""
        return [point for _, point in self.specification.ends]


class SpringRecord(Record):
    """A spring of the result."""

    name: Annotated[str, "specification.name"]
    stiffness_N_m: Annotated[float, "stiffness"]
    free_length_m: Annotated[float, "free"]
    between: list[str]


@dataclass(frozen=True)
class MeasureChange:
    """A measure before and after balancing [SI]."""

    measure: BalanceMeasure
    before: float
    after: float

    @property
    def change(self) -> float:
        """Relative change; -0.3 is a reduction by 30 per cent."""
        return self.after / self.before - 1.0 if self.before > 0.0 else math.nan


class MeasureRecord(Record):
    """A measure before and after balancing [SI]."""

    name: Annotated[Measure, "measure"]
    unit: Annotated[str, "measure.unit"]
    before: float
    after: float
    change: Number


@dataclass(frozen=True)
class ActiveLimit:
    """A limit at the optimum; `buys`: first-order relative reduction of the objective if it alone is relaxed by one `step`.

    `depends_on`: names of other limits that keep the optimum then.
    """

    name: str
    sense: str
    bound: float
    value: float
    unit: str
    active: bool
    price: float
    step: float
    buys: float
    depends_on: tuple[str, ...] = ()


@dataclass(frozen=True)
class RelaxedLimit:
    """A limit that conflicts with others [display unit]: value required if relaxed alone (infinite: never) or together."""

    name: str
    sense: str
    bound: float
    alone: Never
    together: float
    unit: str

    @property
    def relaxation(self) -> Relaxation:
        """The limit relaxed alone."""
        sense = {"at most": "<=", "at least": ">="}[self.sense]
        alone = self.alone if math.isfinite(self.alone) else math.nan
        return Relaxation(self.name, self.name, sense, self.bound, alone, abs(alone - self.bound), self.unit)


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

    first: BalanceMeasure
    second: BalanceMeasure
    before: tuple[float, float]
    points: tuple[TradePoint, ...]
    knee: int | None
    first_seconds: float
    further_seconds: float

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


Above = Annotated[float, Gt(0)]


class TradeRecord(Record):
    """The trade-off between two measures [SI]."""

    first: Measure
    second: Measure
    before: tuple[Above, Above]
    knee: int | None
    monotone: bool
    first_point_s: Annotated[Above, "first_seconds"]
    further_point_s: Annotated[Number, "further_seconds"]
    ratio: Number
    points: tuple[TradePoint, ...]

    @model_validator(mode="after")
    def _check_points(self) -> Self:
        if not self.points or (self.knee is not None and not 0 <= self.knee < len(self.points)):
            raise Contradiction("points", "there are none, or the knee is none of them")
        return self


MESSAGES = {
    Status.OPTIMAL: "globally optimal: no counterweights within the limits do better, up to the duality gap",
    Status.RELAXED: "near the lower bound: no discs were found that reach it",
    Status.INFEASIBLE: "no counterweights meet all limits",
    Status.STALLED: "the duality gap stayed too large: not verified as an optimum; relax a limit or scale the problem",
}


class BalanceRecord(ResultRecord):
    """Document of a balanced machine (SI)."""

    format: Literal["optlink/balance/2"] = Field(alias="schema")
    status: Literal[Status.OPTIMAL, Status.RELAXED, Status.INFEASIBLE, Status.STALLED]
    valid: bool
    proven: bool
    notes: tuple[str, ...]
    measure: str
    unit: str
    before: float
    objective: Number
    reduction: Number
    lower_bound: Annotated[Number, "lower"]
    duality_gap: Annotated[Number, "gap"]
    above_bound: Annotated[float, "slack"]
    exact_least_squares: Annotated[bool, "exact"]
    solver: str
    iterations: int
    positions: Annotated[int, "angles.size"]
    speed_rad_s: Annotated[float, "speed"]
    moment_about_m: Annotated[tuple[float, float], "about"]
    counterweights: Annotated[tuple[CounterweightRecord, ...], "added"]
    springs: tuple[SpringRecord, ...]
    verified: bool
    disagreement: Never
    measures: Annotated[tuple[MeasureRecord, ...], "rows"]
    limits: tuple[ActiveLimit, ...]
    conflict: tuple[RelaxedLimit, ...]
    seconds: dict[str, float]
    trade: TradeRecord | None = absent()


@dataclass(frozen=True, repr=False)
class Balance(Recorded):
    """A balanced machine, or the limits that conflict.

    `status`: optimal, relaxed (discs approach the proven bound without reaching it), infeasible or stalled. `objective` and
    `before` in the unit of the measure, or as weighted ratios to the original machine; `lower`: proven lower bound; `gap`:
    relative duality gap; `slack`: relative excess of the realisable design over the bound. `disagreement`: difference of the
    programme from the inverse dynamics of `machine`, the problem with the new bodies; `original`: the machine before balancing.
    """

    record = BalanceRecord
    interrupted = False
    """A convex programme is never left early."""
    starts = 1
    """Number of searches."""

    problem: ProblemFile
    goal: tuple[tuple[BalanceMeasure, float], ...]
    status: Status
    original: Machine
    angles: Array
    speed: float
    about: tuple[float, float]
    before: float
    objective: float = math.nan
    lower: float = math.nan
    gap: float = math.nan
    slack: float = 0.0
    added: tuple[AddedCounterweight, ...] = ()
    springs: tuple[FittedSpring, ...] = ()
    machine: ProblemFile | None = None
    heavier: Machine | None = None
    rows: tuple[MeasureChange, ...] = ()
    disagreement: float = math.inf
    limits: tuple[ActiveLimit, ...] = ()
    conflict: tuple[RelaxedLimit, ...] = ()
    trade: TradeOff | None = None
    notes: tuple[str, ...] = ()
    solver: str = ""
    iterations: int = 0
    exact: bool = False
    excess: float = 0.0
    seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def best(self) -> Self:
        """The result itself."""
        return self

    @property
    def unit(self) -> str:
        """Unit of the objective."""
        return self.goal[0][0].unit if len(self.goal) == 1 else ""

    @property
    def measure(self) -> str:
        """Name of the minimised measure."""
        if len(self.goal) == 1:
            return str(self.goal[0][0])
        return " + ".join(f"{weight:g} {measure}" for measure, weight in self.goal)

    @property
    def verified(self) -> bool:
        """Whether the inverse dynamics of the balanced machine agrees with the programme."""
        return self.disagreement <= AGREES and all(p.disagreement <= AGREES for p in (self.trade.points if self.trade else ()))

    @property
    def proven(self) -> bool:
        """Whether the design is proven to be the optimum."""
        return self.status is Status.OPTIMAL

    @cached_property
    def refuted(self) -> str:
        """Which limits exclude each other, in a sentence; empty if no limits conflict."""
        return refutation([limit.relaxation for limit in self.conflict], "counterweights")

    @property
    def message(self) -> str:
        """What the status means, in one sentence."""
        return self.refuted or MESSAGES[self.status]

    @property
    def valid(self) -> bool:
        """Whether a design satisfies all limits and is verified, and one does at every point of a trade-off."""
        excess = max([self.excess, *(p.excess for p in (self.trade.points if self.trade else ()))])
        return self.status in (Status.OPTIMAL, Status.RELAXED) and self.verified and excess <= ACTIVE

    @cached_property
    def columns(self) -> dict[str, Array]:
        """All measured values over the positions, before and after balancing, by name with unit."""
        columns = {"crank_angle_deg": np.degrees(self.angles)}
        machines = {"before": self.original} | ({"after": self.heavier} if self.heavier is not None else {})
        for when, machine in machines.items():
            measures = quantities(machine)
            for quantity, values in zip(
                measures, quantities_of(machine.moving(self.angles, self.speed), measures, self.about), strict=True
            ):
                unit = quantity.unit.replace(" ", "")
                for axis, part in zip(("",) if values.shape[1] == 1 else ("_x", "_y"), values.T, strict=True):
                    columns[f"{when}.{quantity.quantity.replace(' at ', '_').replace(' ', '_')}{axis}_{unit}"] = part
        return columns

    @property
    def design(self) -> dict[str, float]:
        """Masses and centres of the counterweights [kg, m] and stiffnesses of the springs [N/m], by name."""
        design: dict[str, float] = {}
        for counterweight in self.added:
            along, across = counterweight.place
            design |= {
                f"{counterweight.body}.mass": counterweight.mass,
                f"{counterweight.body}.along": along,
                f"{counterweight.body}.across": across,
            }
        for spring in self.springs:
            design |= {
                f"{spring.specification.name}.stiffness": spring.stiffness,
                f"{spring.specification.name}.free_length": spring.free,
            }
        return design

    @property
    def reduction(self) -> float:
        """Reduction of the objective relative to its value before balancing."""
        return 1.0 - self.objective / self.before if self.before > 0.0 else math.nan
