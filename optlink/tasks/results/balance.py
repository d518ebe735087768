"""Result of balancing: counterweights and springs, measures before and after, shadow prices, trade-off; as data and JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.counterweights import BalanceMeasure, Counterweight, FreeSpring, quantities, quantities_of
from optlink.dynamics.inertia import Parameters
from optlink.dynamics.machine import Machine
from optlink.io import Summary, finite, head
from optlink.problem.file import ProblemFile

Array = NDArray[np.float64]
SCHEMA = "optlink/balance/1"
AGREES = 1e-8
"""Difference between the programme and the inverse dynamics of the balanced machine, over the largest amount, that is none."""

ACTIVE = 1e-6
"""Distance from a limit, relative, up to which it is active."""


@dataclass(frozen=True)
class AddedCounterweight:
    """A counterweight of the result: its inertia parameters in the axes of its body [SI]."""

    asked: Counterweight
    parameters: Parameters

    @property
    def body(self) -> str:
        """Body that carries the counterweight."""
        return self.asked.body

    @property
    def mass(self) -> float:
        """Its mass [kg]."""
        return float(self.parameters.mass)

    @property
    def place(self) -> tuple[float, float]:
        """Its centre in the axes of the body [m]."""
        return float(self.parameters.along) / self.mass, float(self.parameters.across) / self.mass

    @property
    def gyration(self) -> float:
        """Radius of gyration about its centre [m]."""
        x, y = self.place
        return math.sqrt(max(float(self.parameters.moment) / self.mass - x * x - y * y, 0.0))

    @property
    def radius(self) -> float | None:
        """Radius of the disc [m]; None for a free shape."""
        return self.asked.radius_of(self.mass) if self.asked.kind == "disc" else None

    def to_dict(self) -> dict[str, Any]:
        """Return the counterweight as a JSON object."""
        x, y = self.place
        return {
            "body": self.body,
            "kind": self.asked.kind,
            "mass_kg": self.mass,
            "along_m": x,
            "across_m": y,
            "first_moment_along_kg_m": self.parameters.along,
            "first_moment_across_kg_m": self.parameters.across,
            "moment_of_inertia_about_start_kg_m2": self.parameters.moment,
            "radius_of_gyration_m": self.gyration,
            "radius_m": self.radius,
            "thickness_m": self.asked.thickness_of(self.mass) if self.asked.kind == "disc" else None,
        }


@dataclass(frozen=True)
class FittedSpring:
    """A spring of the result: stiffness [N/m], free length [m]."""

    asked: FreeSpring
    stiffness: float
    free: float


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


@dataclass(frozen=True)
class ActiveLimit:
    """A limit at the optimum; `buys`: first-order share of the objective saved by relaxing it by one `step`."""

    name: str
    sense: str
    bound: float
    value: float
    unit: str
    active: bool
    price: float
    step: float
    buys: float


@dataclass(frozen=True)
class RelaxedLimit:
    """A limit that conflicts with others [display unit]: value required if relaxed alone (infinite: never) or together."""

    name: str
    sense: str
    bound: float
    alone: float
    together: float
    unit: str


@dataclass(frozen=True)
class TradePoint:
    """A point of the trade-off [SI]: `gap` relative; `made`: both measures by inverse dynamics, with realisable discs."""

    first: float
    second: float
    gap: float
    rate: float
    made: tuple[float, float]
    disagreement: float
    masses: Mapping[str, float]


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
        one, other = (np.array([getattr(p, key) for p in self.points]) for key in ("first", "second"))
        return bool(np.all(np.diff(one) >= -AGREES * self.before[0]) and np.all(np.diff(other) <= AGREES * self.before[1]))


@dataclass(frozen=True, repr=False)
class Balance(Summary):
    """A balanced machine, or the limits that conflict.

    `status`: "optimal", "relaxed" (discs come near the proven bound without reaching it), "infeasible" or "stalled". `objective`
    and `before` in the unit of the measure, or as weighted shares of the given machine; `lower`: proven lower bound; `gap`:
    relative duality gap; `slack`: relative excess of the realisable design over the bound. `disagreement`: difference of the
    programme from the inverse dynamics of `balanced`, the problem with the new bodies.
    """

    problem: ProblemFile
    goal: tuple[tuple[BalanceMeasure, float], ...]
    status: str
    machine: Machine
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
    balanced: ProblemFile | None = None
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
    def unit(self) -> str:
        """Unit of the objective."""
        return self.goal[0][0].unit if len(self.goal) == 1 else ""

    @property
    def measure(self) -> str:
        """The minimised measure, in words."""
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
        return self.status == "optimal"

    @property
    def valid(self) -> bool:
        """Whether there is a design that satisfies all limits and is verified."""
        return self.status in ("optimal", "relaxed") and self.verified and self.excess <= ACTIVE

    @cached_property
    def columns(self) -> dict[str, Array]:
        """All measured values over the positions, before and after balancing, by name with unit."""
        found = {"crank_angle_deg": np.degrees(self.angles)}
        machines = {"before": self.machine} | ({"after": self.heavier} if self.heavier is not None else {})
        for when, machine in machines.items():
            asked = quantities(machine)
            for quantity, values in zip(
                asked, quantities_of(machine.moving(self.angles, self.speed), asked, self.about), strict=True
            ):
                unit = quantity.unit.replace(" ", "")
                for axis, part in zip(("",) if values.shape[1] == 1 else ("_x", "_y"), values.T, strict=True):
                    found[f"{when}.{quantity.quantity.replace(' at ', '_').replace(' ', '_')}{axis}_{unit}"] = part
        return found

    @property
    def interrupted(self) -> bool:
        """Whether the search ended early: always False for a convex programme."""
        return False

    @property
    def starts(self) -> int:
        """Number of searches."""
        return 1

    @property
    def design(self) -> dict[str, float]:
        """Masses and centres of the counterweights [kg, m] and stiffnesses of the springs [N/m], by name."""
        found: dict[str, float] = {}
        for one in self.added:
            along, across = one.place
            found |= {f"{one.body}.mass": one.mass, f"{one.body}.along": along, f"{one.body}.across": across}
        for spring in self.springs:
            found |= {f"{spring.asked.name}.stiffness": spring.stiffness, f"{spring.asked.name}.free_length": spring.free}
        return found

    @property
    def reduction(self) -> float:
        """Reduction of the objective relative to its value before balancing."""
        return 1.0 - self.objective / self.before if self.before > 0.0 else math.nan

    def to_dict(self) -> dict[str, Any]:
        """Return the result as a JSON document (SI)."""
        document = {
            **head(SCHEMA, self.problem, self.status),
            "valid": self.valid,
            "proven": self.proven,
            "notes": list(self.notes),
            "measure": self.measure,
            "unit": self.unit,
            "before": self.before,
            "objective": self.objective,
            "reduction": self.reduction,
            "lower_bound": self.lower,
            "duality_gap": self.gap,
            "above_bound": self.slack,
            "exact_least_squares": self.exact,
            "solver": self.solver,
            "iterations": self.iterations,
            "positions": len(self.angles),
            "speed_rad_s": self.speed,
            "moment_about_m": list(self.about),
            "counterweights": [added.to_dict() for added in self.added],
            "springs": [
                {
                    "name": s.asked.name,
                    "stiffness_N_m": s.stiffness,
                    "free_length_m": s.free,
                    "between": [p for _, p in s.asked.ends],
                }
                for s in self.springs
            ],
            "verified": self.verified,
            "disagreement": self.disagreement,
            "measures": [
                {"name": str(r.measure), "unit": r.measure.unit, "before": r.before, "after": r.after, "change": r.change}
                for r in self.rows
            ],
            "limits": [vars(limit) | {} for limit in self.limits],
            "conflict": [vars(item) | {} for item in self.conflict],
            "seconds": dict(self.seconds),
        }
        if self.trade is not None:
            trade = self.trade
            document["trade"] = {
                "first": str(trade.first),
                "second": str(trade.second),
                "before": list(trade.before),
                "knee": trade.knee,
                "monotone": trade.monotone,
                "first_point_s": trade.first_seconds,
                "further_point_s": trade.further_seconds,
                "ratio": trade.ratio,
                "points": [vars(point) | {"made": list(point.made)} for point in trade.points],
            }
        return finite(document)  # type: ignore[no-any-return]
