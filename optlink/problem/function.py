"""DesignProblem: function synthesis. The file's sections are the models of this module; its keys are their fields."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from optlink.linkage.assur import EITHER
from optlink.linkage.fourbar import dead_centre, lengths_of
from optlink.linkage.vector2d import TURN, Value, Vector, angle, angle_from, unit
from optlink.problem.base_model import Section, in_folder
from optlink.problem.limits import COUPLER_JOINT, MARGIN_KEYS, Limits, Reach, check_limits
from optlink.problem.machine.model import Problem
from optlink.problem.mechanism import FourBarSection, check_one_mode
from optlink.problem.quantity import Angle, FixedAngle, Quantity, Unusable, nearest, read_quantity
from optlink.problem.robust import Robustness, check_robust
from optlink.problem.targets.expression import Expression
from optlink.problem.targets.function import Function
from optlink.problem.targets.law import Law, Table, begins_at_psi0, check_rotation, is_periodic, read_law, rotation
from optlink.units import DISPLAYED

MAX_POINTS = 10_000
NUMBERS = ("mechanism.", "limits.", "tolerances.", "requirement.from", "requirement.psi0")
"""Beginnings of the keys whose values are parameters of a programme."""
CHOICES = ("limits.crank", "limits.transmission_over", *MARGIN_KEYS)
"""Keys with such a beginning that change the programme itself."""
POSITIONS = 60  # default number of design positions of a function
DEAD_CENTRES = ("outer dead centre", "inner dead centre")
EPIGRAPH = "largest error"  # name of the extra variable of a minimax NLP, and of its rows
ABSURD = 1e3  # rad; a larger rocker angle indicates an input error or a pole


def _read_start(raw: object) -> str | Quantity:
    if isinstance(raw, str) and not any(character.isdigit() for character in raw):
        if raw not in DEAD_CENTRES:
            raise Unusable("unknown start", nearest(raw, DEAD_CENTRES) + ', or an angle such as "60 deg"')
        return raw
    return read_quantity(raw, "angle")


class Requirement(Section):
    """Requirement of function synthesis: the rocker follows a law while the crank rotates through the span."""

    kind: Literal["function"] = "function"
    """Kind of requirement."""
    law: Annotated[Any, in_folder(read_law)]
    """Rocker angle over crank angle: an expression in phi, phi0, psi0; a table of angles or a CSV file; or a function y(x)."""
    start: Annotated[Any, BeforeValidator(_read_start), Field(alias="from")] = DEAD_CENTRES[0]
    """Start of the span: a dead centre of the rocker, or the crank angle phi0, fixed or free."""
    psi0: Angle | None = None
    """Rocker angle at the start, fixed or free; default: the rocker angle there (for a function: free)."""
    span: FixedAngle | None = None
    """Crank rotation over which the law applies, negative clockwise; a table or function defines it itself."""
    points: Annotated[int, Field(strict=True, ge=1, le=MAX_POINTS)] | None = None
    """Number of evenly spaced positions after the start; default: the rows of a table, else 60."""
    measure: Literal["sum of squares", "rms", "max"] = "sum of squares"
    """Measure that combines all errors into the objective; `max` is the largest error."""
    robust: Robustness = None
    """Effect of `[tolerances]` on the objective: `"3 sigma"` or `"worst case"` with the measure `max`, `"expected value"` with
    the sum of squares or rms; default: none."""


@dataclass(frozen=True)
class StartPosition:
    """Start of the requirement: crank direction, crank angle and prescribed rocker angle [rad] there."""

    crank: Vector
    phi0: Value
    psi0: Value


class DesignProblem(Problem):
    """A function synthesis problem: input of `solve`. Immutable; change it with `optlink.load(..., overrides)`."""

    mechanism: FourBarSection
    """The four-bar, with at least one free quantity."""
    requirement: Requirement
    """The law for the rocker."""
    limits: Limits = Limits()
    """Limits of the design."""
    task: ClassVar[str] = "function"
    has_error: ClassVar[bool] = True

    @cached_property
    def quantities(self) -> dict[str, Quantity]:
        """Fixed quantities and design variables by name: the four lengths, phi0 and psi0 where they are defined."""
        quantities, requirement, law = dict(self.mechanism.quantities), self.requirement, self.requirement.law
        anywhere = Quantity(0.0, "angle", "deg", -TURN, TURN)
        if isinstance(requirement.start, Quantity):
            quantities["phi0"] = requirement.start
        elif isinstance(law, Function):
            quantities["phi0"] = anywhere
        elif isinstance(law, Table) and not law.from_start:
            quantities["phi0"] = Quantity(law.phi[0], "angle", "deg")
        if requirement.psi0 is not None:
            quantities["psi0"] = requirement.psi0
        elif isinstance(law, Function):
            quantities["psi0"] = anywhere
        return quantities

    @property
    def side(self) -> int:
        """Assembly mode: +1 left, -1 right of B -> D."""
        return self.mechanism.side

    @cached_property
    def span(self) -> float:
        """Crank rotation [rad] of the requirement, negative clockwise."""
        return rotation(self.requirement.law, self.requirement.span)

    @property
    def sense(self) -> int:
        """Sense of crank rotation: +1 counter-clockwise, -1 clockwise."""
        return 1 if self.span > 0.0 else -1

    def is_periodic(self, name: str) -> bool:
        """Return whether values of an angle a revolution apart are one design; not those that the law contains as such."""
        return name in ("phi0", "psi0") and is_periodic(self.requirement.law, name)

    @property
    def tied(self) -> bool:
        """Whether psi0 is the actual rocker angle at the start."""
        return "psi0" not in self.quantities

    @property
    def counted(self) -> dict[str, float]:
        """Tolerances [SI] that enter the objective, by key; measured deviations are excluded."""
        if self.requirement.robust is None:
            return {}
        return {f"tolerances.{d.name}": d.tolerance for d in self.deviations if not d.values}

    @cached_property
    def law(self) -> Law:
        """The law at its design positions.

        If psi0 is the actual rocker angle at the start and the law prescribes just this there, the error is zero by definition,
        and the start position is left out. For a robust design it is kept, as the built linkage deviates there too.
        """
        source, points = self.requirement.law, self.requirement.points
        begin = int(self.tied and self.requirement.robust is None and begins_at_psi0(source))  # the error at the start is zero
        first = source.phi[0] if isinstance(source, Table) and source.from_start else 0.0
        if isinstance(source, Table) and points is None:
            return Law(source, source.offsets[begin:])
        count = points or POSITIONS
        steps = np.arange(begin, count + 1) / count
        return Law(source, first + (self.span - first) * steps)

    @property
    def measure(self) -> str:
        """Measure of the errors: "sum of squares", "rms" or "max"."""
        return self.requirement.measure

    @property
    def objective_unit(self) -> str:
        """SI unit of the objective."""
        return "rad^2" if self.measure == "sum of squares" else "rad"

    @property
    def objective_display(self) -> tuple[float, str]:
        """Factor from SI to the displayed value of the objective, and the unit of that: an error is shown in degrees."""
        return DISPLAYED.get(self.objective_unit, (1.0, self.objective_unit))

    def shares_programme(self, keys: Sequence[str]) -> bool:
        """Return whether one programme serves all values of keys of the file, including the side of a limit."""
        if self.everywhere or self.mechanism.assembly == EITHER:
            return False
        return all(key.startswith(NUMBERS) and key not in CHOICES for key in keys)

    @property
    def everywhere(self) -> bool:
        """Whether the largest error is taken over the whole range, not only at the design positions: unless it is a table."""
        return self.requirement.measure == "max" and not isinstance(self.requirement.law, Table)

    @property
    def error_bounded(self) -> bool:
        """Whether a lower bound of the largest error over all linkages is available: of a function, without tolerances."""
        return self.everywhere and self.requirement.robust is None and isinstance(self.requirement.law, Function)

    start_name: ClassVar[str] = "phi0"
    base_name: ClassVar[str] = "psi0"
    law_given: ClassVar[bool] = True
    pointed: ClassVar[bool] = False
    closed: ClassVar[bool] = False
    timing: ClassVar[str] = "from start"
    unit: ClassVar[str] = "rad"
    width: ClassVar[int] = 1
    whole: ClassVar[float] = 1.0
    centre: ClassVar[tuple[float, float]] = (0.0, 0.0)
    four_bar: ClassVar[bool] = True

    suffix: ClassVar[str] = ""
    key: ClassVar[str] = "requirement"
    tolerance: ClassVar[None] = None
    worth: ClassVar[float] = 1.0
    goals: ClassVar[tuple[Any, ...]] = ()
    bounds: ClassVar[tuple[Any, ...]] = ()

    @property
    def parts(self) -> tuple[Any, ...]:
        return (self,)

    @property
    def robust(self) -> Any:
        return self.requirement.robust

    @property
    def movable_span(self) -> bool:
        return isinstance(self.requirement.law, Expression)

    @property
    def size(self) -> float:
        return self.quantities["frame"].value

    @cached_property
    def data(self) -> Any:
        from optlink.problem.path import _plain

        return _plain(np.column_stack([self.law.offsets, self.law.tabulated]), self.law.offsets)

    def complete(self, values: Mapping[str, Value]) -> dict[str, Value]:
        values = {**{name: q.value for name, q in self.quantities.items()}, **values}
        start = self.start_position(values)
        return {**values, "phi0": start.phi0, "psi0": start.psi0}

    def deviation(self, pose: Any, values: Mapping[str, Value], target: Any) -> list[Value]:
        prescribed = self.law.target(*target, values["phi0"], values["psi0"])
        return [angle_from(unit(prescribed), pose.direction("rocker"))]

    def crank_angles(self, values: Mapping[str, Value], angles: Any) -> Any:
        return values["phi0"] + self.law.offsets

    def start_position(self, values: Mapping[str, Value]) -> StartPosition:
        """Return the start of the requirement for given quantities; elementwise, NaN where it does not exist."""
        if "phi0" in self.quantities:
            phi0 = values["phi0"]
            crank = unit(phi0)
            rocker = self.linkage.pose(values, crank).direction("rocker")
        else:
            limit = dead_centre(*lengths_of(values), self.side, outer=self.requirement.start == DEAD_CENTRES[0])
            crank, phi0, rocker = limit.crank, limit.phi, limit.rocker
        return StartPosition(crank, phi0, values["psi0"] if "psi0" in self.quantities else angle(rocker))

    def reach(self, values: Mapping[str, Value]) -> Reach:
        """Return the crank angles of the law for given quantities."""
        return Reach(self.start_position(values).phi0, self.span, self.sense)

    def sizes(self, design: Mapping[str, float]) -> dict[str, float]:
        """Return every dimension of the linkage [SI] from a design, with values of the file where it has none."""
        return {name: float(design.get(name, quantity.value)) for name, quantity in self.mechanism.quantities.items()}

    def design(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the complete design [SI] for values of the design variables: every length, phi0 and psi0."""
        return {name: float(value) for name, value in self.designs(values).items()}

    def designs(self, values: Mapping[str, Value]) -> dict[str, Value]:
        """Return the complete designs [SI] for values of the design variables, elementwise; see `design`."""
        full = {name: values.get(name, quantity.value) for name, quantity in self.quantities.items()}
        start = self.start_position(full)
        return {**full, "phi0": start.phi0, "psi0": start.psi0}

    def start(self, values: Mapping[str, float]) -> float:
        """Return the crank angle [rad] at which the requirement begins; 0 where it does not exist."""
        phi0 = float(self.start_position(values).phi0)
        return phi0 if math.isfinite(phi0) else 0.0

    def check(self) -> None:
        """Check that the sections are consistent.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        requirement, law, limits = self.requirement, self.requirement.law, self.limits
        check_one_mode(self.mechanism)
        if self.mechanism.placed:
            message = "a motion law does not depend on the position of the linkage"
            raise Unusable(message, "Leave pivot and direction out", "mechanism.pivot")
        start = requirement.start if "start" in requirement.model_fields_set else None
        check_rotation(law, requirement.span, "from", start)
        if isinstance(law, Function) and isinstance(start, str):
            raise Unusable(
                "the start of a function must be a crank angle, fixed or free",
                'Write from = { start = "50 deg", bounds = ["0 deg", "180 deg"] }, or leave it out: then it is a design variable',
                "requirement.from",
                start,
            )
        if isinstance(law, Table) and not law.from_start and requirement.psi0 is not None:
            message = "a table measured from the frame has no psi0"
            raise Unusable(message, "Leave psi0 out", "requirement.psi0", str(requirement.psi0))
        turns = self.quantities.get("phi0")
        if turns is not None and max(abs(bound) for bound in turns.bounds) > TURN * (1.0 + 1e-9):
            message = "the start angle lies beyond one revolution"
            raise Unusable(message, "Give it within -360 deg ... 360 deg", "requirement.from", str(turns))
        check_limits(limits, [COUPLER_JOINT])
        check_robust(requirement.robust, requirement.measure, len(self.tolerances))
        if limits.crank == "double-crank" and requirement.start in DEAD_CENTRES and "phi0" not in self.quantities:
            remedy = 'Start at an angle: from = "60 deg"'
            raise Unusable("a double-crank has no dead centres", remedy, "requirement.from", requirement.start)
        _check_law(self)
        super().check()


def _check_law(problem: DesignProblem) -> None:
    """Check that an expression has a plausible value over the span for some start angle."""
    law = problem.requirement.law
    if isinstance(law, Table):
        return
    nominal = problem.design({})
    start = (nominal["phi0"], nominal["psi0"])
    starts = [start] if np.all(np.isfinite(start)) else [(0.3, 0.5), (0.9, 1.2), (1.7, 2.1)]
    defects = [_defect(law, problem.span, phi0, psi0) for phi0, psi0 in starts]
    if all(defects):
        span, begin = (f"{np.degrees(angle):.6g} deg" for angle in (problem.span, starts[0][0]))
        message = f"the law {defects[0]} on the span, {span} from {begin} on"
        raise Unusable(message, "Change the law, the span or the start", "requirement.law", law.text)


def _defect(law: Expression | Function, span: float, phi0: float, psi0: float) -> str | None:
    """Return the defect of a law along the span, or None; poles of even order are found by refining around the largest value."""
    low, high = 0.0, 1.0
    for _ in range(5):
        share = np.linspace(low, high, 721)
        values = {"phi": phi0 + span * share, "phi0": phi0, "psi0": psi0}
        if worry := law.hazards(values):
            return worry
        size = np.abs(np.asarray(law(values), dtype=float) + 0.0 * share)
        peak, step = float(share[int(np.argmax(size))]), (high - low) / 720.0
        if np.max(size) > ABSURD:
            return f"exceeds {ABSURD:g} rad"
        low, high = max(0.0, peak - 2.0 * step), min(1.0, peak + 2.0 * step)
    return None
