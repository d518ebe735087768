"""The section [balance] of a problem file: possible counterweights and springs, objective and limits."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, Self

from pydantic import Field, field_validator, model_validator

from optlink.dynamics.machine import Machine
from optlink.io import without
from optlink.linkage.mechanism import FRAME, Pose
from optlink.problem.base_model import RESERVED, Name, Section
from optlink.problem.machine.loads import spring_ends
from optlink.problem.quantity import (
    CoordinateInterval,
    Density,
    FixedForce,
    FixedLength,
    Interval,
    LengthInterval,
    MassInterval,
    StiffnessInterval,
    Unusable,
    below,
    check_name,
    is_number,
    read_figure,
    where,
)
from optlink.problem.terms import QUANTITIES, Limit, Objective, Place, Term, TermSection, check_term, read_scale, read_words
from optlink.units import KINDS, read_number, with_article

if TYPE_CHECKING:
    from optlink.dynamics.counterweights import Counterweight, FreeSpring

MAX_POSITIONS = 100_000  # of a revolution
MEASURES = ("rms", "peak")
MINIMISED = "[balance] makes forces and torques small: it maximises nothing"

# --- terms in words ---------------------------------------------------------------------------------------------------------

OLD_WORDS = {
    r"\blargest\b": "peak",
    r"\bdriving torque\b": "torque",
    r"(?<!shaking )(?<!guide )(?<!drive )\b(force|moment)\b": r"shaking \1",
}
"""Words of earlier versions, as regular expressions, with the present ones."""


def term_keys(text: str, guides: Collection[str]) -> dict[str, Any]:
    """Return the keys of a term in words, present or old: "rms shaking force", "peak torque from 90 to 180 deg"; default: rms.

    Raises
    ------
    Unusable
    """
    words, remedy = " ".join(text.split()), 'Write for example "rms torque", or a table: { quantity = "torque", measure = "rms" }'
    for old, new in OLD_WORDS.items():
        words = re.sub(old, new, words)
    keys = read_words(words)
    if keys is None:
        raise Unusable("not a term", remedy, "", text)
    if keys.pop("sense", "minimise") != "minimise":
        raise Unusable(MINIMISED, remedy, "", text)
    if keys["quantity"] == "reaction" and keys.get("of") in guides:
        keys["quantity"] = "guide force"
    return keys if "measure" in keys or not QUANTITIES[keys["quantity"]].cyclic else {**keys, "measure": "rms"}


def with_terms(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of a file with terms in place of the words in `balance`, whose objective was named `minimise`.

    Raises
    ------
    Unusable
        with the full key of the cause.
    """
    section, mechanism = raw.get("balance"), raw.get("mechanism")
    if not isinstance(section, Mapping):
        return dict(raw)
    guides = mechanism.get("guides", ()) if isinstance(mechanism, Mapping) else ()
    key = "minimise" if "minimise" in section else "objective"
    if key == "minimise" and "objective" in section:
        raise Unusable("the objective is given twice", "Remove it: objective replaces it", "balance.minimise", section[key])
    goal, limits = section.get(key), section.get("limits")
    with below(f"balance.{key}"):
        if isinstance(goal, str):
            goal = term_keys(goal, guides)
        elif isinstance(goal, Mapping) and goal and all(is_number(weight) for weight in goal.values()):
            terms = [{**term_keys(text, guides), "weight": weight} for text, weight in goal.items()]
            goal = term_keys(next(iter(goal)), guides) if list(goal.values()) == [1.0] else {"terms": terms}
    if isinstance(limits, Mapping):
        named = {}
        for name, limit in limits.items():
            with below(f"balance.limits.{name}"):
                named[name] = limit if isinstance(limit, Mapping) else {**term_keys(name, guides), "max": limit}
        limits = named
    rest = without(section, key)
    changed = {"objective": goal, **rest, "limits": limits}
    return {**raw, "balance": {name: item for name, item in changed.items() if item is not None}}


# --- objective and limits ---------------------------------------------------------------------------------------------------


def check_convex(term: Term, machine: Machine) -> None:
    """Check that a term is a convex function of the masses and stiffnesses that are added, and that its elements exist.

    Raises
    ------
    Unusable
        with the key below the term.
    """
    if not term.nature.affine:
        known = ", ".join(name for name, quantity in QUANTITIES.items() if quantity.affine)
        message = f"{with_article(term.quantity)} cannot be balanced: counterweights and springs reduce forces and torques"
        raise Unusable(message, f"Choose one of: {known}", "quantity", term.quantity)
    check_name(term.how, MEASURES, f"the {term.how} value is not supported in [balance]", "measure")
    check_term(term, machine.mechanism, {})
    if machine.friction and term.nature.forces:
        remedy = "Remove the friction of the guides, or choose the shaking force or moment"
        message = f"{with_article(term.quantity)} cannot be balanced in a machine with friction"
        raise Unusable(message, remedy, "quantity", term.quantity)


class BalanceLimit(Limit):
    """A term that must not exceed a value: `max`."""

    max: Any = None
    """Upper bound, in the unit of the term, or a share of its value in the original machine, for example `"90 %"`."""

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        if self.max is None and self.min is None and self.exactly is None:
            raise Unusable(
                "the limit has no value", f'Add max = "{KINDS[self.nature.kind or "force"].example}", or "90 %"', "max"
            )
        for key in ("min", "exactly"):
            if (value := getattr(self, key)) is not None:
                raise Unusable("[balance] limits forces and torques from above only", "Write max", key, value)
        self.bound(1.0)
        return self

    def bound(self, before: float) -> float:
        """Return the upper bound [SI] for the value in the original machine.

        Raises
        ------
        Unusable
            with the key below the limit.
        """
        if isinstance(self.max, str) and self.max.strip().endswith("%"):
            share = read_number(self.max.strip()[:-1]) / 100.0
            if not 0.0 <= share < 1e6:
                raise Unusable("not a share", 'Write for example "80 %"', "max", self.max)
            return share * before
        value = read_figure(self.max, self.nature.kind, "max")[0]
        if value < 0.0:
            raise Unusable("an upper bound of a magnitude must not be negative", "Give zero or more", "max", self.max)
        return value


class BalanceGoal(NamedTuple):
    """A term of the objective, weight * value / scale; the scale [SI] is None for the value in the original machine."""

    term: Term
    weight: float
    scale: float | None


# --- counterweights and springs ---------------------------------------------------------------------------------------------

_MASS = where(
    lambda mass: min(mass.bounds[1], mass.low or 0.0) >= 0.0,
    "a counterweight cannot have negative mass: [balance] removes no material from a body",
    "Give zero or more, and remove material in [bodies]",
)


def _ends(interval: Interval | None) -> tuple[float, float]:
    """Return the least and the largest value of an amount; default: from zero, without bound."""
    return (0.0, math.inf) if interval is None else (interval.low or 0.0, interval.bounds[1])


class CounterweightSection(Section):
    """A mass that can be added to a body: a disc, or one of any shape."""

    body: str
    """The body to which the counterweight is fixed."""
    kind: Literal["disc", "free"] = "disc"
    """A disc, or any shape with physically consistent mass properties."""
    mass: Annotated[MassInterval, _MASS] | None = None
    """Mass: one value or a range; default: from zero."""
    thickness: FixedLength | None = None
    """Thickness of a disc; its mass determines the radius."""
    radius: LengthInterval | None = None
    """Without a thickness: the radius, one value. With a thickness: bounds of the radius."""
    density: Density | None = None
    """Density of the disc; required with a thickness."""
    reach: FixedLength | None = None
    """Largest distance of its centre from `origin`."""
    extent: FixedLength | None = None
    """Largest distance of its edge from `origin`."""
    origin: str | None = None
    """Reference point of the body for `reach` and `extent`; default: its pivot on the frame, else its first joint."""
    at: Place = None
    """Fixed position: a point of the body, or coordinates along and across. One of `reach`, `extent`, `at` is required."""

    def counterweight(self, machine: Machine) -> Counterweight:
        """Return the counterweight for a machine.

        Raises
        ------
        Unusable
            with the key below the section.
        """
        from optlink.dynamics.counterweights import Counterweight

        mechanism = machine.mechanism
        check_name(self.body, mechanism.bodies, "no such body", "body")
        low, most = _ends(self.mass)
        thickness, density = (None if part is None else part.value for part in (self.thickness, self.density))
        radius: float | None = None
        if self.kind == "disc":
            low, most, radius = self._disc(low, most, thickness, density)
        else:
            for key in ("thickness", "radius", "density"):
                if (value := getattr(self, key)) is not None:
                    raise Unusable("a free counterweight has any shape", 'Remove it, or write kind = "disc"', key, str(value))
        if low > most:
            message = f"no mass is admissible: at least {low:.6g} kg, at most {most:.6g} kg"
            raise Unusable(message, "Widen mass, radius or thickness", "mass", str(self.mass))
        extent = math.inf if self.extent is None else self.extent.value
        if radius is not None and extent < radius:
            raise Unusable(
                "the disc is larger than its extent", "Give a smaller radius, or a larger extent", "extent", str(self.extent)
            )
        if self.at is None and self.reach is None and self.extent is None:
            message = "its position is unbounded: ever less mass at an ever larger radius would be optimal"
            raise Unusable(message, 'Add reach = "100 mm" (of its centre), extent (of its edge), or at (its place)', "reach")
        return Counterweight(
            self.body,
            self.kind,
            (low, most),
            thickness,
            radius,
            density,
            math.inf if self.reach is None else self.reach.value,
            extent,
            self._origin(machine),
            self._at(machine),
        )

    def _disc(self, low: float, most: float, thickness: float | None, density: float | None) -> tuple[float, float, float | None]:
        """Return the least and largest mass of a disc, and its radius if that is fixed."""
        if density is not None and density <= 0.0:
            raise Unusable(
                "a disc without density has no mass", 'Write density = "7850 kg/m^3" (steel)', "density", str(self.density)
            )
        if thickness is None and self.radius is None:
            remedy = 'Add thickness = "10 mm" and density = "7850 kg/m^3", or radius = "40 mm"; or write kind = "free"'
            raise Unusable("a disc has a thickness and density, or a radius", remedy, "thickness")
        if thickness is None:
            assert self.radius is not None
            if self.radius.low is None or self.radius.low != self.radius.high:
                message = "radius and thickness of a counterweight cannot both be free"
                raise Unusable(
                    message, 'Give one radius, or a thickness and density, or kind = "free"', "radius", str(self.radius)
                )
            return low, most, self.radius.low
        if density is None:
            raise Unusable("the mass of a disc follows from its density", 'Add density = "7850 kg/m^3" (steel)', "density")
        if self.radius is not None:
            per = math.pi * density * thickness
            low = max(low, per * (self.radius.low or 0.0) ** 2)
            most = min(most, per * self.radius.high**2) if self.radius.high is not None else most
        return low, most, None

    def _points(self, machine: Machine) -> list[str]:
        return [point for point, bodies in machine.mechanism.owners.items() if self.body in bodies]

    def _local(self, machine: Machine, point: str, key: str) -> tuple[float, float]:
        """Return the coordinates of a point of the body in its own axes [m]."""
        check_name(point, self._points(machine), "the body has no such point", key)
        along, across = Pose(machine.mechanism, machine.sizes).local(self.body, point)
        return float(along), float(across)

    def _origin(self, machine: Machine) -> tuple[float, float]:
        if self.origin is not None:
            return self._local(machine, self.origin, "origin")
        fixed = [point for point in self._points(machine) if FRAME in machine.mechanism.owners[point]]
        return self._local(machine, fixed[0], "origin") if fixed else (0.0, 0.0)

    def _at(self, machine: Machine) -> tuple[float, float] | None:
        if self.at is None:
            return None
        if self.reach is not None:
            raise Unusable("the place is given, so it has no reach", "Remove one of the two", "reach", str(self.reach))
        if isinstance(self.at, str):
            return self._local(machine, self.at, "at")
        place: tuple[float, float] = self.at
        return place


_FREE = where(
    lambda free: free.high is not None and (free.low or 0.0) >= 0.0,
    "the range of a free length must rise, from zero or more",
    'Write ["0 mm", "200 mm"], or one length',
)


class SpringSection(Section):
    """A spring that can be added between two points: its stiffness, and its free length if that is a range, are optimised."""

    name: Name
    """Name of the spring among the loads of the balanced machine."""
    between: tuple[str, str]
    """The two points that the spring connects."""
    stiffness: StiffnessInterval | None = None
    """Stiffness: one value or a range; default: from zero."""
    free_length: Annotated[CoordinateInterval, _FREE] | None = None
    """Free length: fixed, or optimised within a range of two values; default: 0."""
    force: FixedForce | None = None
    """Largest permitted spring force; default: unlimited."""

    def spring(self, machine: Machine) -> FreeSpring:
        """Return the spring for a machine.

        Raises
        ------
        Unusable
            with the key below the section.
        """
        from optlink.dynamics.counterweights import FreeSpring

        mechanism = machine.mechanism
        used_names = (*mechanism.bodies, *mechanism.owners, *(g.name for g in mechanism.guides), *(x.name for x in machine.loads))
        if self.name in (*used_names, *RESERVED):
            raise Unusable("the name is taken", "Choose another for the spring", "name", self.name)
        ends = spring_ends(mechanism, self.between)
        low, most = _ends(self.stiffness)
        if min(low, most) < 0.0:
            raise Unusable("a stiffness must not be negative", "Give zero or more", "stiffness", str(self.stiffness))
        free = (0.0, 0.0) if self.free_length is None else _ends(self.free_length)
        return FreeSpring(self.name, (ends[0], ends[1]), (low, most), free, math.inf if self.force is None else self.force.value)


class BalanceSection(Section):
    """Optimal balancing with `optlink balance`."""

    objective: Objective
    """Objective over the cycle: a term, or a weighted sum of terms, each by default over its value in the original machine."""
    counterweights: tuple[CounterweightSection, ...] = ()
    """Counterweights that can be added to bodies."""
    springs: tuple[SpringSection, ...] = ()
    """Springs that can be added between points."""
    limits: dict[str, BalanceLimit] = Field(default_factory=dict)
    """Limits of terms, each under a name of your choice."""
    mass: Annotated[MassInterval, _MASS] | None = None
    """Total mass of all counterweights: one value or a range; default: any."""
    about: Place = None
    """Reference point of shaking moments on the frame; default: the crank pivot."""
    positions: int = Field(default=360, ge=8, le=MAX_POSITIONS)
    """Number of evenly spaced crank angles of the programme, 8 to 100000."""

    @field_validator("counterweights", "springs", mode="before")
    @classmethod
    def _list(cls, raw: object) -> object:
        if not isinstance(raw, list | tuple):
            raise Unusable("expected a list of tables", "Begin each with [[balance.counterweights]]", "", raw)
        return tuple(raw)

    def term(self, term: Term) -> Term:
        """Return a term without other keys, with its measure and reference point."""
        keys = {key: getattr(term, key) for key in TermSection.model_fields}
        about = term.about or self.about if term.quantity == "shaking moment" else None
        return Term.model_construct(**{**keys, "measure": term.how, "about": about})

    @property
    def goals(self) -> tuple[BalanceGoal, ...]:
        """The terms of the objective."""
        goals = self.objective.goals
        return tuple(BalanceGoal(self.term(goal), goal.weight, read_scale(goal, goal.nature.kind)) for goal in goals)

    @property
    def single(self) -> bool:
        """Whether the objective is one term, in its own unit."""
        return not self.objective.terms

    @property
    def words(self) -> str:
        """The objective in words."""
        return " + ".join(f"{'' if self.single else f'{goal.weight:g} '}{goal.term.words}" for goal in self.goals)

    @property
    def limited(self) -> tuple[tuple[Term, BalanceLimit], ...]:
        """The terms that are limited, with their limits."""
        return tuple((self.term(limit), limit) for limit in self.limits.values())

    @property
    def total(self) -> tuple[float, float]:
        """Least and largest mass of all counterweights together [kg]."""
        return _ends(self.mass)

    def build(self, machine: Machine) -> tuple[tuple[Counterweight, ...], tuple[FreeSpring, ...]]:
        """Return the counterweights and springs, with all names checked.

        Raises
        ------
        Unusable
            with the key below the section.
        """
        if not self.counterweights and not self.springs:
            example = '[[balance.counterweights]] with body = "crank", thickness = "10 mm", density = "7850 kg/m^3"'
            message = "no counterweights or springs are permitted, so balancing has no design variables"
            raise Unusable(message, f"Add {example}", "counterweights")
        weights, springs = [], []
        for k, section in enumerate(self.counterweights):
            with below(f"counterweights.{k}"):
                weights.append(section.counterweight(machine))
        for k, weight in enumerate(weights):
            if weight.kind == "free" and math.isinf(min(weight.mass[1], self.total[1])):
                message = "its mass is unbounded: ever more mass with ever less moment of inertia would be optimal"
                raise Unusable(message, 'Add mass = { max = "2 kg" }, to it or to [balance]', f"counterweights.{k}.mass")
            if weight.kind == "free" and math.isinf(weight.extent):
                message = "its moment of inertia is unbounded: ever less mass ever further from its centre would be optimal"
                raise Unusable(message, 'Add extent = "100 mm" (of its edge)', f"counterweights.{k}.extent")
        bodies = [weight.body for weight in weights]
        for k, body in enumerate(bodies):
            if body in bodies[:k]:
                remedy = "Together they are one counterweight: give that its mass and reach"
                raise Unusable("the body has two counterweights", remedy, f"counterweights.{k}.body", body)
        for k, spring in enumerate(self.springs):
            with below(f"springs.{k}"):
                springs.append(spring.spring(machine))
        for k, goal in enumerate(self.objective.goals):
            with below(f"objective.terms.{k}" if self.objective.terms else "objective"):
                check_convex(goal, machine)
                if goal.sense == "maximise":
                    raise Unusable(MINIMISED, "Leave it out", "sense", goal.sense)
                read_scale(goal, goal.nature.kind)
        for name, limit in self.limits.items():
            with below(f"limits.{name}"):
                check_convex(limit, machine)
        self.place(machine)
        return tuple(weights), tuple(springs)

    def place(self, machine: Machine) -> tuple[float, float]:
        """Return the reference point of shaking moments [m]; default: the crank pivot."""
        mechanism = machine.mechanism
        if isinstance(self.about, tuple):
            return self.about
        point = mechanism.crank.start if self.about is None else self.about
        check_name(point, mechanism.ground, "not a point of the frame", "about")
        x, y = machine.moving([0.0]).position(point)
        return float(x), float(y)
