"""CycleProblem: a machine whose design variables are optimised for quantities of its cycle."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import ConfigDict

from optlink.dynamics.inertia import Inertia
from optlink.linkage.dyad_types import transmitting
from optlink.linkage.vector2d import Value
from optlink.problem.base_model import Name, Section
from optlink.problem.cycle.quantities import guide_of
from optlink.problem.cycle.terms import Goal, Limit, Objective, Term, check_term, output_of, read_scale
from optlink.problem.interval import SIDES, AnglesOfJoints, Interval, LargestAnglesOfJoints, RatioOfStrokes
from optlink.problem.limits import Alignment, check_transmission, transmission_limit
from optlink.problem.machine.model import Problem
from optlink.problem.mechanism import FourBarSection, check_one_mode, moving_points
from optlink.problem.quantity import FixedAngle, Unusable, below, check_keys, check_pair, nearest
from optlink.units import KINDS, display_unit


@dataclass(frozen=True)
class Bound:
    """A limit with its name for display, its bounds [SI], and its key in the problem file."""

    name: str
    term: Limit
    interval: Interval
    key: str


class CycleLimits(Alignment):
    """Limits with names of the user's choice, in addition to those of every design problem."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[Name, Limit]
    transmission_angle: AnglesOfJoints | None = None
    """Range of the transmission angle of every dyad over the cycle; a table states the ranges of single dyads by their joints."""
    pressure_angle: LargestAnglesOfJoints | None = None
    """Largest pressure angle of every dyad over the cycle; a table states those of single dyads by their joints."""

    def transmission_bounds(self, joints: Sequence[str]) -> Iterator[Bound]:
        """Yield the limits of the transmission angle of the dyads with these joints."""
        for joint in joints:
            limit = transmission_limit(self.transmission_angle, self.pressure_angle, joint)
            if limit is None:
                continue
            if limit.pressure and limit.high is not None:
                most = limit.high - 0.5 * math.pi
                term = Limit(quantity="pressure angle", of=joint, max=_degrees(most))
                yield Bound(f"pressure_angle.{joint}", term, Interval(None, most, "angle", "deg"), limit.key)
                continue
            transmission: dict[str, Any] = {"quantity": "transmission angle", "of": joint}
            if limit.low is not None:
                term = Limit(**transmission, measure="least", min=_degrees(limit.low))
                yield Bound(f"transmission_angle.{joint}.min", term, Interval(limit.low, None, "angle", "deg"), limit.key)
            if limit.high is not None:
                term = Limit(**transmission, measure="largest", max=_degrees(limit.high))
                yield Bound(f"transmission_angle.{joint}.max", term, Interval(None, limit.high, "angle", "deg"), limit.key)

    @property
    def named(self) -> dict[str, Limit]:
        """The limits of the user by their names."""
        return dict(self.__pydantic_extra__ or {})


class MachineTerms(Problem):
    """A problem with quantities of the machine in its objective, or limited under names of one's choice. Immutable."""

    objective: Objective | None = None
    """Objective of quantities of the machine."""
    if TYPE_CHECKING:
        limits: Alignment  # a key of each kind

    @cached_property
    def goals(self) -> tuple[Goal, ...]:
        """The quantities of the machine that are minimised or maximised."""
        return () if self.objective is None else self.objective.goals

    @property
    def named_limits(self) -> dict[str, Limit]:
        """Limits of quantities of the machine by their names."""
        return {}

    @cached_property
    def bounds(self) -> tuple[Bound, ...]:
        """The limits of quantities of the machine with their bounds."""
        bounds = []
        for name, limit in self.named_limits.items():
            with below(f"limits.{name}"):
                bounds.append(Bound(name, limit, limit.interval(self.linkage, self.quantities), f"limits.{name}"))
        return tuple(bounds)

    @cached_property
    def lengths(self) -> tuple[str, ...]:
        """Names of the lengths of the links; of a four-bar, the frame is one."""
        return tuple(name for name, quantity in self.mechanism.quantities.items() if quantity.kind == "length")

    @cached_property
    def scales(self) -> tuple[float | None, ...]:
        """Scale of each objective term [SI]; None if the file gives none."""
        return tuple(read_scale(goal, self.kind(goal)) for goal in self.goals)

    @property
    def single(self) -> bool:
        """Whether the objective is one quantity of the machine, in its own unit."""
        return self.objective is not None and not self.objective.terms

    def kind(self, term: Term) -> str:
        """Return the physical kind of a term."""
        if term.quantity == "length":
            return self.quantities[str(term.of)].kind
        return term.kind(self.linkage)

    def inertias(self, values: Mapping[str, Value]) -> dict[str, Inertia]:
        """Return mass properties of all bodies for dimensions that may be symbols [SI]; centroids and bars follow the lengths."""
        sizes = self.sizes(values)
        return {name: body.inertia_of(name, self.linkage, sizes) for name, body in self.bodies.items()}

    def _check_term(self, term: Term) -> None:
        check_term(term, self.linkage, self.quantities)
        if term.over is not None:
            remedy = "Leave it out; only terms of [balance] count a range of crank angles"
            raise Unusable("a design problem counts the whole revolution", remedy, "over", str(term.over))

    def check_terms(self) -> None:
        """Check the quantities of the machine and their elements.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        terms = (*self.goals, *self.named_limits.values())
        if any(term.nature.cyclic or term.ended or term.quantity == "work" for term in terms) and self.drive.speed.value == 0.0:
            remedy = "Give the constant speed of the cycle"
            raise Unusable("the crank speed is zero", remedy, "drive.speed", str(self.drive.speed))
        for k, goal in enumerate(self.goals):
            with below("objective" if self.single else f"objective.terms.{k}"):
                self._check_term(goal)
                if read_scale(goal, self.kind(goal)) is None and len(self.goals) > 1:
                    raise Unusable("terms of different units are added", 'Give each term a scale: scale = "1000 N"', "scale")
        for name, limit in self.named_limits.items():
            with below(f"limits.{name}"):
                self._check_term(limit)
        if self.mechanism.friction and any(_forced(term) for term in terms):
            guide = next(iter(self.mechanism.friction))
            message = "guide friction is not differentiable where the normal force changes sign"
            remedy = "Optimise without friction, then `optlink analyze` the result with friction"
            raise Unusable(message, remedy, f"mechanism.guides.{guide}.friction", self.mechanism.friction[guide])
        if not self.bodies and not self.loads and any(_forced(goal) for goal in self.goals):
            raise Unusable("no masses and no loads are given, so there are no forces", "Add [bodies] or [loads]", "objective")


class CycleProblem(MachineTerms):
    """A problem file with an objective over the cycle: input of `solve`. Immutable."""

    objective: Objective
    """Objective over the cycle."""
    limits: CycleLimits = CycleLimits()
    """Limits on quantities of the cycle, each under a name of your choice, and the least distance from positions where the
    mechanism locks."""

    task: ClassVar[str] = "cycle"

    @property
    def named_limits(self) -> dict[str, Limit]:
        """Limits of quantities of the machine by their names."""
        return self.limits.named

    @cached_property
    def bounds(self) -> tuple[Bound, ...]:
        """The limits with their bounds."""
        return (*super().bounds, *self.limits.transmission_bounds(self._joints))

    @property
    def _joints(self) -> list[str]:
        """Joints of the dyads that have a transmission angle."""
        return [group.joint for group in transmitting(self.linkage)]

    @property
    def unit_kind(self) -> str:
        """Physical kind of the objective; empty for a weighted sum, which is a plain number."""
        return self.kind(self.goals[0]) if self.single else ""

    @property
    def objective_unit(self) -> str:
        """SI unit of the objective; empty for a plain number."""
        return KINDS[self.unit_kind].si.replace("**", "^") if self.unit_kind else ""

    @property
    def objective_display(self) -> tuple[float, str]:
        """Factor from the minimised value [SI], the negative of a maximised one, to the displayed value, and the unit of that."""
        size, unit = display_unit(self.unit_kind) if self.unit_kind else (1.0, "")
        return (-size if self.single and self.goals[0].sense == "maximise" else size), unit

    def check_output(self) -> None:
        """Check the output of the requirement: this problem has none."""

    def check(self) -> None:
        """Check that the sections are consistent.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        check_one_mode(self.mechanism)
        self.check_terms()
        self.check_output()
        check_transmission(self.limits.transmission_angle, self.limits.pressure_angle, self._joints)
        _ = self.bounds
        super().check()
        self.check_repeats(self.machine(slow=self.slow_assumed))


class StrokeRequirement(Section):
    """Requirement of a stroke problem: an output goes to and fro once per revolution of the crank."""

    kind: Literal["stroke"]
    """Kind of requirement."""
    output: str | None = None
    """Output: a slider or guide (its stroke is a length), a body that swings (an angle), or a point along `direction`; default:
    the rocker of a four-bar."""
    stroke: Any = None
    """Stroke of the output: a length or an angle, a range `[low, high]`, or a table of `min`, `max` or `exactly`."""
    time_ratio: RatioOfStrokes | None = None
    """Duration of the slow stroke divided by that of the quick one at constant crank speed; with `stroke`, that of the stroke
    `"forward"`, `"backward"`, `"slow"` or `"quick"`."""
    direction: FixedAngle | None = None
    """Direction of the stroke of a point, from +x."""


REQUIRED = ("stroke", "time_ratio")
"""Names of the bounds that the requirement of a stroke problem states."""


class StrokeProblem(CycleProblem):
    """A linkage for a stroke and a time ratio: a problem over the cycle with its own requirement. Immutable."""

    requirement: StrokeRequirement
    """Output, stroke and time ratio."""
    objective: Objective = Objective(quantity="pressure angle")
    """Objective over the cycle; default: the least worst pressure angle of all dyads, which is the best transmission angle."""

    @property
    def output(self) -> str:
        """Name of the output."""
        return self.requirement.output or ("rocker" if isinstance(self.mechanism, FourBarSection) else "")

    @cached_property
    def bounds(self) -> tuple[Bound, ...]:
        """The stroke, the time ratio, and the limits with their bounds."""
        task, bounds = self.requirement, []
        raw = {"of": self.output, "direction": task.direction}
        try:
            term = Limit.model_validate({"quantity": "stroke", **raw, **_sides(task.stroke)})
            check_term(term, self.linkage, self.quantities)
            bounds.append(Bound(REQUIRED[0], term, term.interval(self.linkage, self.quantities), "requirement.stroke"))
        except Unusable as error:  # a plain value has no sides in the file
            side = error.key if isinstance(task.stroke, dict) else ""
            error.key = f"requirement.stroke.{side}".rstrip(".")
            raise
        ratio = task.time_ratio
        if ratio is not None:
            sides = {side: value for side, value in (("min", ratio.low), ("max", ratio.high)) if value is not None}
            term = Limit.model_validate({"quantity": "time ratio", **raw, "stroke": ratio.stroke, **sides})
            bounds.append(Bound(REQUIRED[1], term, Interval(ratio.low, ratio.high, None, ""), "requirement.time_ratio"))
        return (*bounds, *super().bounds)

    def check_output(self) -> None:
        """Check that the output exists and can go to and fro.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        mechanism = self.linkage
        guides, bodies = (guide.name for guide in mechanism.guides), (link.body for link in mechanism.links[1:])
        name, names = self.output, [*guides, *bodies, *moving_points(mechanism)]
        if name not in names and guide_of(name, mechanism) is None:
            remedy = nearest(name, names) if name else f"Write output = one of: {', '.join(names)}"
            message = "the output is the name of a slider, a body that swings, or a point"
            raise Unusable(message, remedy, "requirement.output", name or None)
        try:
            output_of(Term(quantity="stroke", of=name, direction=self.requirement.direction), mechanism)
        except Unusable as error:
            error.key = f"requirement.{error.key.replace('of', 'output')}"
            raise


def _sides(raw: object) -> dict[str, object]:
    """Return a stroke as the bounds of a limit."""
    if raw is None:
        raise Unusable("the stroke is missing", 'Write stroke = "60 deg", or "100 mm" for a slider')
    if isinstance(raw, dict):
        check_keys(raw, SIDES)
        return raw
    if isinstance(raw, list):
        check_pair(raw, "a range is a list of two values, lower and upper", 'Write ["55 deg", "60 deg"]')
        return {"exactly": raw[0]} if raw[0] == raw[1] else dict(zip(SIDES, raw, strict=False))
    return {"exactly": raw}


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.12g} deg"


def _forced(term: Term) -> bool:
    return term.nature.kind in ("torque", "force", "energy")
