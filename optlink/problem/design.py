"""DesignProblem: a linkage with requirements or an objective of any kind. Its unknowns are design variables and crank angles."""

import contextlib
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from pydantic import Field, PrivateAttr, model_validator

from optlink.dynamics.machine import Inertia
from optlink.io import keeping
from optlink.linkage.dyads import transmitting
from optlink.linkage.fourbar import InnerFourBar, whole_four_bar
from optlink.linkage.mechanism import Pose
from optlink.linkage.vector2d import Array, Value, max_magnitude
from optlink.problem.driving import check_design_drive
from optlink.problem.elements import check_one_cycle
from optlink.problem.limits import MARGIN_KEYS, MODELS, Bound, Limits, Reach, check_limits, four_bar_limits
from optlink.problem.linked import Link
from optlink.problem.machine.bodies import STATIC
from optlink.problem.machine.model import Problem, ShownObjective
from optlink.problem.mechanism import check_one_mode, sizes_of
from optlink.problem.quantity import Quantity, Unusable, below, quantity_key, read_figure
from optlink.problem.requirements.base import NoRequirement, Requirement, StartPosition, TargetArrays, names_of
from optlink.problem.requirements.kinds import AnyRequirement
from optlink.problem.requirements.points import carrier
from optlink.problem.rounding import ALL, Grid, Rounding, read_grids
from optlink.problem.targets.expression import Expression
from optlink.problem.targets.law import Function, Law, SlideExpression
from optlink.problem.targets.target_points import TargetPoints
from optlink.problem.terms import Goal, Limit, Objective, Term, check_term, read_scale
from optlink.problem.tolerances import Robust, check_robust
from optlink.units import DISPLAYED, KINDS, display_unit

NUMBERS = ("mechanism.", "limits.", "tolerances.", "requirement.from", "requirement.start", "requirement.psi0")
"""Beginnings of the keys whose values are parameters of a programme."""
CHOICES = ("limits.crank", "limits.transmission_over", *MARGIN_KEYS)
"""Keys with such a beginning that change the programme itself."""
EPIGRAPH = "largest error"  # name of the extra variable of a minimax NLP, and of its rows
STEP = 1e-4  # rad, least crank rotation from a point to the next


class DesignProblem(Problem):
    """A linkage with requirements, limits, or an objective of quantities of its machine: input of `solve`. Immutable.

    Change it with `optlink.load(..., overrides)`.
    """

    requirement: AnyRequirement = None
    """Law or function, points, poses, stroke, or the best transmission; the first of several."""
    requirements: tuple[AnyRequirement, ...] = ()
    """Several requirements on one linkage, in place of one: those with a tolerance are limits, the others are minimised."""
    objective: Objective | None = None
    """Objective of quantities of the machine."""
    limits: Limits = Limits()
    """Limits of the design."""
    rounding: Rounding = Field(default_factory=dict)
    """Sizes that can be made, by name: a step `"0.1 mm"`, a list of stock sizes, `{ step, from }` such as a grid of holes, or
    `{ teeth = [12, 60] }` of the ratio of two gears; `step` for all other lengths. `solve` rounds to them; sweeps, fronts,
    sensitivities and proofs do not."""
    _place: tuple[str, str] = PrivateAttr(("requirement", ""))  # key of the requirement, and the beginning of its quantities

    @model_validator(mode="after")
    def _first(self) -> Self:
        if self.requirements and self.requirement is not None:
            raise Unusable("there is one requirement and a list of them", "Move it into the list", "requirement")
        if self.requirements:
            vars(self)["requirement"] = min(self.requirements, key=_order)
        if self.requirement is None:
            if self.objective is None:
                raise Unusable("there is no requirement", "Add the section [requirement]", "requirement")
            vars(self)["requirement"] = NoRequirement.model_validate({})
        return self

    @property
    def composed(self) -> bool:
        """Whether anything but the deviations of one requirement is minimised or limited by a measure."""
        return bool(self.requirements or self.requirement.limited or self.objective or self.limits.named)

    @property
    def task(self) -> str:
        """Kind of task: "function" for laws of the rocker of a four-bar, "cycle" without targets, else "path"."""
        return ("path" if self.parts else "cycle") if self.composed else str(self.requirement.task(self))

    @property
    def has_error(self) -> bool:
        """Whether a design has an error over the span of a motion law."""
        return self.task == "function"

    @cached_property
    def grids(self) -> dict[str, Grid]:
        """Grids of the free sizes that the file states; one that is fixed has its size."""
        quantities = self.mechanism.quantities
        free = [name for name in self.free if name in quantities]
        return read_grids(keeping(self.rounding, ALL, *free), quantities, free)

    @cached_property
    def four_bar(self) -> InnerFourBar | None:
        """The four-bar that the linkage is, however the file writes it; None for any other linkage, or within a range."""
        return whole_four_bar(self.linkage) if self.linkage.limits is None else None

    @cached_property
    def frame_angle(self) -> float | None:
        """Angle [rad] of the frame of a four-bar where crank angles count from; None if it differs between designs."""
        loop = self.four_bar
        if loop is None or loop.frame_length:
            return None if loop is None else 0.0
        ax, ay, dx, dy = places = [self.mechanism.quantities[name] for name in loop.ground]
        if ay.fixed and dy.fixed and np.all(ay.value == dy.value) and ax.equals is dx.equals is None:
            (left, right), (low, high) = ax.bounds, dx.bounds
            if np.all(low > right) or np.all(high < left):
                return 0.0 if np.all(low > right) else math.pi
        angle: float = np.arctan2(dy.value - ay.value, dx.value - ax.value)
        return angle if all(place.fixed for place in places) else None

    @property
    def frame_bounds(self) -> tuple[float, float]:
        """Least and largest length [m] of the frame of a four-bar within the bounds."""
        assert self.four_bar is not None
        return self.four_bar.frame_bounds({name: quantity.bounds for name, quantity in self.mechanism.quantities.items()})

    def check(self) -> None:
        """Check that the sections are consistent.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        check_one_mode(self.mechanism)
        check_design_drive(self.mechanism, self.drive)
        if self.linkage.limits is not None and "crank" in self.limits.model_fields_set:
            message = "the drive has a range, throughout which the linkage closes"
            raise Unusable(message, "Leave it out, or the range", "limits.crank", self.limits.crank)
        check_limits(self.limits, self.linkage, four_bar=self.four_bar is not None)
        for name in () if self.parts else self.limits.model_fields_set:
            if name in Limits.model_fields and f"limits.{name}" in self.inapplicable:
                remedy = f'Leave it out, or limit a quantity of the machine: {name} = {{ quantity = "torque", max = "10 N*m" }}'
                raise Unusable("not a limit of this kind of problem", remedy, f"limits.{name}")
        for name in () if self.parts else self.limits.regions:
            message = "a region is not supported in a problem without targets"
            raise Unusable(message, 'Limit a quantity instead, for example "slide", "end" or "length"', f"limits.{name}")
        for part in self.each:
            with part.keyed():
                part.requirement.check(part)
                part.requirement.check_reached(part)
                check_robust(part.robust, part.measure, len(part.tolerances))
        self._check_cycle()
        minimised = [part for part in self.each if not part.requirement.limited]
        for part in self.each:
            for key in ("weight", "scale"):
                stated = getattr(part.requirement, key)
                if stated is not None and (part not in minimised or len(minimised) + len(self.goals) < 2):
                    message = "only a term of an objective of several terms has one"
                    raise Unusable(message, "Leave it out", f"{part.key}.{key}", stated)
        if self.composed:
            self._check_composition()
        with below("rounding"):
            read_grids(self.rounding, self.mechanism.quantities, list(self.mechanism.quantities))
        super().check()

    def _check_cycle(self) -> None:
        """Refuse design variables with which the motion repeats after other turns of the crank in each design."""
        linkage, free = self.linkage, {name: self.quantities[name] for name in self.free}
        try:
            check_one_cycle(linkage, free, self.complete)
        except Unusable as error:
            error.key = quantity_key(self, error.key)
            raise

    @contextlib.contextmanager
    def keyed(self) -> Iterator[None]:
        """Name the requirement of a part in the keys of errors."""
        try:
            yield
        except Unusable as error:
            if error.key.partition(".")[0] == "requirement":
                error.key = self.key + error.key.removeprefix("requirement")
            raise

    def _check_composition(self) -> None:
        """Check that what is minimised can be added, and that quantities of the machine belong to a whole revolution.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        names = names_of([(requirement.name, requirement.kind) for requirement in self.requirements])
        for k, name in enumerate(names):
            if name in names[:k]:
                raise Unusable("two requirements have this name", "Give each another name", f"requirements.{k}.name", name)
            if any(quantity.startswith(f"{name}.") for quantity in self.mechanism.quantities):
                message = "a body or point of the mechanism has this name"
                raise Unusable(message, "Give the requirement another name", f"requirements.{k}.name", name)
        for part in self.parts:
            with part.keyed():
                _ = part.tolerance, part.worth
                if part.robust is not None:
                    message = "a robust design minimises the deviations of a single requirement, and nothing else"
                    remedy = "Leave robust out; `optlink study tolerance FILE` then shows what the tolerances do to the design"
                    raise Unusable(message, remedy, "requirement.robust", str(part.robust))
        minimised = [part for part in self.parts if part.tolerance is None]
        for part in minimised if len(minimised) + len(self.goals) > 1 else ():
            if part.requirement.weight is None:
                raise Unusable("several terms are minimised", "Give each a weight, or a tolerance", f"{part.key}.weight")
        if minimised and self.single:
            remedy = "Write it as a term with weight and scale: [[objective.terms]]"
            raise Unusable("several terms are minimised", remedy, "objective.quantity", self.goals[0].quantity)
        self.check_terms()
        terms = [*self.goals, *(bound.term for bound in self.bounds)]
        if terms:
            self.check_repeats(self.machine(slow=self.slow_assumed))
        for term in terms:
            if (term.nature.cyclic or term.ended or term.quantity == "work") and self.limits.crank == "span":
                message = "a quantity of the machine belongs to a whole revolution of the crank"
                raise Unusable(message, 'Write crank = "full rotation"', "limits.crank", "span")

    # --- several requirements

    @property
    def parts(self) -> tuple[Self, ...]:
        """The problem with each of its requirements of targets alone, whose quantities have their short names there."""
        return tuple(part for part in self.each if part.requirement.targeted)

    @property
    def each(self) -> tuple[Self, ...]:
        """The problem with each of its requirements alone, also those without targets."""
        return self._each or (self,)

    @cached_property
    def _each(self) -> tuple[Self, ...]:
        """The parts of several requirements; none of a single one, as a model that contains itself cannot be compared."""
        fields = {name: getattr(self, name) for name in type(self).model_fields}
        parts: list[Any] = []
        names = names_of([(requirement.name, requirement.kind) for requirement in self.requirements])
        for k, (name, requirement) in enumerate(zip(names, self.requirements, strict=True)):
            changes = {"requirement": requirement, "requirements": (), "objective": None}
            part = type(self).model_construct(**(fields | changes))
            part._place = f"requirements.{k}", f"{name}."
            parts.append(part)
        return tuple(sorted(parts, key=lambda part: _order(part.requirement)))

    @property
    def key(self) -> str:
        """Key of the requirement in the file."""
        return self._place[0]

    @property
    def prefix(self) -> str:
        """Beginning of the names of the requirement's quantities in the whole problem, if there are several."""
        return self._place[1]

    @property
    def suffix(self) -> str:
        """What names the requirement in labels, if there are several."""
        return f" of {self.prefix[:-1]}" if self.prefix else ""

    def of_parts(self, angles: Array | None, *, free: bool = False) -> Iterator[tuple[Self, Array | None]]:
        """Yield each part with its own ones among the crank angles of all positions; `free`: of those without given timing."""
        first = 0
        for part in self.parts:
            last = first + (len(part.data.columns) if part.data.offsets is None or not free else 0)
            yield part, None if angles is None else angles[first:last]
            first = last

    def own(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the quantities of a part, with their short names, from those of the whole problem."""
        return {name.removeprefix(self.prefix): value for name, value in values.items()} if self.prefix else dict(values)

    @cached_property
    def tolerance(self) -> float | None:
        """Largest measure of the deviations [SI] of a requirement that is a limit; None for one that is minimised."""
        return None if self.interval is None else max(-self.interval[0], self.interval[1])

    @cached_property
    def interval(self) -> tuple[float, float] | None:
        """Least and largest deviation, or measure of them, [SI] of a requirement that is a limit; else None."""
        interval: tuple[float, float] | None = self.requirement.interval(self)
        return interval

    @cached_property
    def worth(self) -> float:
        """Factor of the measure of the deviations [SI] in an objective of several terms; 1 if it is the only one."""
        if self.requirement.weight is None:
            return 1.0
        raw, squared = self.requirement.scale, self.measure == "sum of squares"
        if raw is not None and squared:
            raise Unusable("a scale divides the largest deviation or the rms", 'Write measure = "rms"', "requirement.scale", raw)
        scale = self.whole ** (2 if squared else 1)
        if raw is not None:
            with below("requirement"):
                scale = read_figure(raw, {"m": "length", "rad": "angle"}.get(self.unit, ""), "scale")[0]
        if scale <= 0.0:
            raise Unusable("a scale must be positive", "Give one above zero", "requirement.scale", raw)
        return float(self.requirement.weight) / scale

    @cached_property
    def goals(self) -> tuple[Goal, ...]:
        """Quantities of the machine that are minimised or maximised; where nothing else is, the worst pressure angle."""
        if self.objective is not None:
            return self.objective.goals
        if any(not part.requirement.limited for part in self.parts):
            return ()
        turns = self.limits.crank != "span" and transmitting(self.linkage)
        return Objective(quantity="pressure angle" if turns else "total length").goals

    @property
    def named_limits(self) -> dict[str, Limit]:
        """Limits of quantities of the machine by their names."""
        return {} if self.prefix else self.limits.named

    @cached_property
    def bounds(self) -> tuple[Bound, ...]:
        """The limits of quantities of the machine with their bounds; without targets those of the transmission angle too."""
        bounds = [*self.required]
        for name, limit in self.named_limits.items():
            with below(f"limits.{name}"):
                bounds.append(Bound(name, limit, limit.interval(self.linkage, self.quantities), f"limits.{name}"))
        joints = [] if self.parts else [group.joint for group in transmitting(self.linkage)]
        return (*bounds, *self.limits.transmission_bounds(joints))

    @cached_property
    def required(self) -> tuple[Bound, ...]:
        """The limits of quantities of the machine that the requirements state."""
        bounds: list[Bound] = []
        for part in () if self.prefix else self.each:
            with part.keyed():
                for bound in part.requirement.bounds(part):
                    key = part.key + bound.key.removeprefix("requirement")
                    bounds.append(replace(bound, name=f"{part.prefix}{bound.name}", key=key))
        return tuple(bounds)

    # --- quantities of the machine

    @cached_property
    def lengths(self) -> tuple[str, ...]:
        """Names of the lengths of the links; of a four-bar by its lengths, the frame is one."""
        coupling = {size for element in self.linkage.elements if element.bodies for size in element.sizes}
        return tuple(
            name for name, quantity in self.mechanism.quantities.items() if quantity.kind == "length" and name not in coupling
        )

    @property
    def placed_frame(self) -> InnerFourBar | None:
        """The four-bar that the linkage is, if coordinates of its pivots state the length of its frame."""
        return None if self.four_bar is None or self.four_bar.frame_length in self.lengths else self.four_bar

    @cached_property
    def scales(self) -> tuple[float | None, ...]:
        """Scale of each objective term [SI]; None if the file gives none."""
        return tuple(read_scale(goal, self.kind(goal)) for goal in self.goals)

    @property
    def single(self) -> bool:
        """Whether the objective is one quantity of the machine, in its own unit."""
        return len(self.goals) == 1 and (self.objective is None or not self.objective.terms)

    def kind(self, term: Term) -> str:
        """Return the physical kind of a term."""
        if term.quantity == "length":
            return self.quantities[str(term.of)].kind
        return term.kind(self.linkage)

    def inertias(self, values: Mapping[str, Value]) -> dict[str, Inertia]:
        """Return mass properties of all bodies for dimensions that may be symbols [SI]; centroids and bars follow the lengths."""
        sizes = self.sizes(values)
        bodies = {name: body.inertia_of(name, self.linkage, sizes) for name, body in self.bodies.items()}
        return {**self.mechanism.inertias, **bodies}

    def _check_term(self, term: Term) -> None:
        check_term(term, self.linkage, self.quantities)
        if term.over is not None:
            message = "a design problem counts the whole revolution, or the whole range of the drive"
            raise Unusable(
                message, "State the range as drive.range; only terms of [balance] count a part", "over", str(term.over)
            )

    def check_terms(self) -> None:
        """Check the quantities of the machine and their elements.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        terms = (*self.goals, *self.named_limits.values())
        for term in terms:
            term.counted(self.driving.whole)
        if any(term.nature.cyclic or term.ended or term.quantity == "work" for term in terms) and self.drive.speed.value == 0.0:
            remedy = "Give the constant speed of the cycle"
            raise Unusable("the crank speed is zero", remedy, "drive.speed", str(self.drive.speed))
        if self.drive.speed.kind == STATIC and any(term.quantity == "power" for term in terms):
            message, remedy = "a static drive has no power", 'Give its speed, for example "10 rpm" or "100 mm/s"'
            raise Unusable(message, remedy, "drive.speed", STATIC)
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

    @cached_property
    def _sole(self) -> tuple[float, str, str]:
        """Factor from SI to the displayed objective, its SI unit and its display unit; of a sum, a plain number."""
        minimised = [part for part in self.parts if part.tolerance is None]
        if len(minimised) == 1 and not self.goals:
            part = minimised[0]
            squared = part.measure == "sum of squares"
            (factor, shown), unit = DISPLAYED[part.unit], part.unit
            return (factor**2, f"{unit}^2", f"{shown}^2") if squared and unit else (factor, unit, shown)
        if not minimised and self.single:
            kind = self.kind(self.goals[0])
            size, shown = display_unit(kind) if kind else (1.0, "")
            sign = -1.0 if self.goals[0].sense == "maximise" else 1.0
            return sign * size, KINDS[kind].si.replace("**", "^") if kind else "", shown
        return 1.0, "", ""

    @property
    def inapplicable(self) -> set[str]:
        """Keys of requirement and limits, such as "limits.link_ratio", that do not apply to this mechanism."""
        limits: Collection[str] = () if self.four_bar else four_bar_limits()
        if not self.parts:
            limits = Limits.model_fields.keys() - {"alignment", "transmission_angle", "pressure_angle"}
        return {*(f"limits.{key}" for key in limits), *self.requirement.inapplicable(self)}

    # --- quantities

    @cached_property
    def quantities(self) -> dict[str, Quantity]:
        """Fixed quantities and design variables by name: those of the mechanism and those of the requirements."""
        if not self.requirements:
            return {**self.mechanism.quantities, **self.requirement.quantities(self)}
        each = ((part.prefix, part.requirement.quantities(part)) for part in self.each)
        own = {f"{prefix}{name}": quantity for prefix, quantities in each for name, quantity in quantities.items()}
        return {**self.mechanism.quantities, **own}

    @property
    def start_name(self) -> str:
        """Name of the crank angle at the common start of the positions: "phi0" for a law of a four-bar section, else "start"."""
        return str(self.requirement.names(self)[0])

    @property
    def base_name(self) -> str:
        """Name of the output at the start of a law: "psi0" for a four-bar section, else "zero"."""
        return str(self.requirement.names(self)[1])

    def is_periodic(self, name: str) -> bool:
        """Return whether values of an angle that are a revolution apart are one design; not those that a law contains as such."""
        kind = self.quantities[name].kind if name in self.quantities else "angle"
        part = next((part for part in self.each if part.prefix and name.startswith(part.prefix)), self.each[0])
        return kind == "angle" and bool(part.requirement.is_periodic(part, name.removeprefix(part.prefix)))

    @cached_property
    def links(self) -> dict[str, Link]:
        """The links by the names of the linked quantities; none of a requirement alone, whose values are those of the whole."""
        return {} if self.prefix else super().links

    def complete(self, values: Mapping[str, Value]) -> dict[str, Value]:
        """Return every quantity [SI] for values of the design variables, elementwise, with those that follow from others.

        These are linked quantities, the start angle of the crank at a dead centre, and the output there if a law starts from it.
        """
        known = super().complete(values)
        return self.derive({name: known[name] for name in self.quantities})

    def derive(self, full: Mapping[str, Value]) -> dict[str, Value]:
        """Return quantities [SI] with the start angle of the crank and the output there in place of those of other sizes."""
        full = dict(full)
        for part in self.each:
            derived = part.requirement.derived(part, part.own(full))
            prefix = part.prefix if self.requirements else ""
            full |= {f"{prefix}{name}": value for name, value in derived.items()}
        return full

    def design(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the complete design [SI] for values of the design variables."""
        return {name: float(value) for name, value in self.complete(values).items()}

    def start(self, values: Mapping[str, float]) -> float:
        """Return the crank angle [rad] at which the requirement begins, where it has one; else that of the drive.

        0 for a dead centre that does not exist.
        """
        first = self.each[0]
        own = first.own(values)
        begin = {**own, **first.requirement.derived(first, own)}.get(first.start_name)
        if begin is None:
            return super().start(values)
        return float(begin) if math.isfinite(begin) else 0.0

    # --- targets

    @property
    def timing(self) -> str:
        """Timing: "given" for prescribed crank angles, "from start" for angles relative to a common start, "free" for any."""
        return str(self.requirement.timed)

    @cached_property
    def data(self) -> TargetArrays:
        """The targets as arrays."""
        data: TargetArrays = self.requirement.data(self)
        return data

    def crank_angles(self, values: Mapping[str, Value], angles: Array | None) -> Array:
        """Return the crank angle [rad] at each position, those of all requirements one after the other.

        `angles` are those of the design at points without prescribed timing.
        """
        if self.requirements:
            return np.concatenate([part.crank_angles(part.own(values), own) for part, own in self.of_parts(angles, free=True)])
        offsets = self.data.offsets
        if offsets is None:
            assert angles is not None
            return angles
        return offsets + (values[self.start_name] if self.timing == "from start" else 0.0)

    def deviation(self, pose: Pose, values: Mapping[str, Value], target: tuple[Value, ...]) -> list[Value]:
        """Return actual minus prescribed output at one position, elementwise.

        For a path, x and y [m]; for a pose also the angle times `radian`; for a law the slide [m] or angle [rad]; for
        transmission the cosine of the angle of each dyad. `values`: every quantity; `target`: a row of `TargetArrays.columns`.
        """
        deviation: list[Value] = self.requirement.deviation(self, pose, values, target)
        return deviation

    @property
    def pointed(self) -> bool:
        """Whether points in the plane are prescribed."""
        return bool(self.requirement.pointed)

    @property
    def target_points(self) -> TargetPoints:
        """The target points; none for a law or transmission."""
        targets: TargetPoints = self.requirement.targets
        return targets

    @property
    def point(self) -> str:
        """The point that takes the positions; empty if none does."""
        return getattr(self.requirement, "point", "")

    @property
    def body(self) -> str:
        """The body that carries the point."""
        return carrier(self.linkage, self.point)

    @property
    def rotation(self) -> str:
        """Sense of crank rotation with free timing: "either", "counter-clockwise" or "clockwise"."""
        return self.requirement.rotation if self.pointed else "either"

    @property
    def ways(self) -> tuple[float, ...]:
        """Signs of the senses of crank rotation that may pass the points: 1 counter-clockwise, -1 clockwise."""
        return {"counter-clockwise": (1.0,), "clockwise": (-1.0,)}.get(self.rotation, (1.0, -1.0))

    @cached_property
    def closed(self) -> bool:
        """Whether the points form a closed curve: the last step leads back to the first point; not within a range."""
        return bool(self.requirement.is_closed) and self.linkage.limits is None

    @property
    def meets_again(self) -> bool:
        """Whether the last point coincides with the first: only then may the crank angles coincide."""
        columns = self.data.columns
        return max_magnitude(columns[0, :2] - columns[-1, :2]) <= 1e-9 * self.size

    @cached_property
    def centre(self) -> tuple[float, float]:
        """Mean of the points [m]; the origin if there are none."""
        return self.requirement.centre if self.pointed else (0.0, 0.0)

    @cached_property
    def size(self) -> float:
        """Unit of length [m]: the root mean square distance of the points from their centre, the travel of a slider, the frame of
        a four-bar with a law, else the longest fixed link; without links that have a length, the largest coordinate.
        """
        if (size := self.requirement.size(self)) is not None:
            return float(size)
        dimensions = self.mechanism.quantities
        quantities = [q for q in dimensions.values() if q.kind == "length"]
        fixed, lengths = [q.value for q in quantities if q.fixed], [q.value for q in quantities]
        if self.four_bar is not None and not self.four_bar.frame_length:
            frame = float(self.four_bar.lengths(sizes_of(dimensions))[3])
            lengths.append(frame)
            fixed += [frame] if all(dimensions[name].fixed for name in self.four_bar.ground) else []
        away = [abs(q.value) for q in dimensions.values() if q.kind == "coordinate"]
        return max(fixed or lengths or away, default=0.0) or 1.0

    @cached_property
    def radian(self) -> float:
        """Length [m] equivalent to one radian of a pose."""
        return float(self.requirement.radian(self))

    # --- objective

    @property
    def measure(self) -> str:
        """Measure that reduces the deviations to one value: "sum of squares", "rms" or "max"."""
        return str(self.requirement.reduction)

    @property
    def unit(self) -> str:
        """SI unit of a deviation: empty for cosines."""
        return str(self.requirement.unit(self))

    @property
    def width(self) -> int:
        """Number of components of the deviation at one position."""
        return int(self.requirement.width(self))

    @property
    def whole(self) -> float:
        """Scale of a deviation in the NLP: the unit of length, 1 for angles and cosines."""
        return self.size if self.unit == "m" else 1.0

    @property
    def objective_unit(self) -> str:
        """SI unit of the objective; empty for a weighted sum, which is a plain number."""
        if self.composed:
            return self._sole[1]
        return f"{self.unit}^2" if self.measure == "sum of squares" and self.unit else self.unit

    @property
    def objective_display(self) -> tuple[float, str]:
        """Factor from SI to the displayed value of the objective, and the unit of that."""
        if self.composed:
            return self._sole[0], self._sole[2]
        if self.task == "function" and self.measure == "sum of squares":
            return 1.0, self.objective_unit
        factor, unit = DISPLAYED[self.unit]
        return (factor**2, f"{unit}^2" if unit else unit) if self.measure == "sum of squares" else (factor, unit)

    @property
    def by_angle(self) -> bool:
        """Whether the objective is shown as an angle: the largest cosine of a transmission angle, by its distance from 90 deg."""
        return bool(self.requirement.by_angle) and not self.composed

    def shown_objective(self, objective: float) -> ShownObjective:
        """Return an objective, and how changes of it are shown; see `Problem.shown_objective`."""
        if not self.by_angle or not abs(objective) < 1.0:
            return super().shown_objective(objective)
        slope = 1.0 / math.sqrt(1.0 - objective * objective)
        return ShownObjective(math.degrees(math.asin(objective)), math.degrees(slope), "deg", "transmission angle from 90 deg")

    @property
    def sense(self) -> float:
        """Sense of crank rotation by its sign: +1 or -1 for a law of a four-bar, else the crank speed [rad/s]."""
        return self.requirement.sense(self) or super().sense

    # --- laws

    @cached_property
    def law(self) -> Law:
        """The law of the output at its design positions."""
        law: Law = self.requirement.law_of(self)
        return law

    @cached_property
    def span(self) -> float:
        """Crank rotation [rad] of the law, negative clockwise."""
        return float(self.requirement.rotation)

    @property
    def output(self) -> str:
        """Name of the output of a law: a guide or a body."""
        return str(self.requirement.output_of(self))

    @property
    def slides(self) -> bool:
        """Whether the output of a law is a slider, not the angle of a body."""
        return bool(self.requirement.slides(self))

    @property
    def based(self) -> bool:
        """Whether the law is relative to the output at the start (psi0, s0), not to the frame."""
        return bool(self.requirement.based)

    @property
    def robust(self) -> Robust | None:
        """Effect of manufacturing deviations on the objective; None if they have none."""
        robust: Robust | None = self.requirement.robust
        return robust

    @property
    def separate(self) -> bool:
        """Whether each component of a deviation is judged by itself, not the length of their vector."""
        return bool(self.requirement.separate)

    @property
    def loaded(self) -> str:
        """The output that shows to which side a joint clearance lies; see `Requirement.loaded`."""
        return str(self.requirement.loaded(self)) if self.robust is not None else super().loaded

    @property
    def tied(self) -> bool:
        """Whether the prescribed output at the start is the actual one there."""
        return bool(self.requirement.tied(self))

    @property
    def dead_centre(self) -> str | None:
        """The dead centre at which the law starts; None if it starts at a crank angle."""
        return None if self.start_name in self.quantities else self.requirement.dead_centre(self)

    @cached_property
    def travel(self) -> float:
        """Prescribed travel of the output of a law [rad or m], with the crank at its start angle."""
        return float(self.requirement.travel(self))

    def prescribed(self, values: Mapping[str, Value], offset: Value, tabulated: Value) -> Value:
        """Return the prescribed output of a law [rad or m] at a crank rotation from the start; elementwise.

        `values`: every quantity [m, rad]; `tabulated`: `Law.tabulated` at that `offset`.
        """
        return self.requirement.prescribed(self, values, offset, tabulated)

    def prescribed_outputs(self, values: Mapping[str, float]) -> Array:
        """Return the prescribed output of a law [rad or m] at every position, (positions,)."""
        law = self.law
        return np.asarray(self.prescribed(values, law.offsets, law.tabulated) + 0.0 * law.offsets, dtype=float)

    def start_position(self, values: Mapping[str, Value]) -> StartPosition:
        """Return the start of the law for given quantities; elementwise, NaN where it does not exist."""
        position: StartPosition = self.requirement.start_position(self, values)
        return position

    def reach(self, values: Mapping[str, Value]) -> Reach:
        """Return the crank angles of the law for given quantities."""
        return Reach(self.start_position(values).phi0, self.span, self.sense)

    @property
    def law_given(self) -> bool:
        """Whether the requirement is a law or a function."""
        return bool(self.requirement.law_given)

    @property
    def movable_span(self) -> bool:
        """Whether the crank rotation of the requirement may vary: of a law that is an expression."""
        stated = self.law_given and "span" in type(self.requirement).model_fields
        return stated and isinstance(self.requirement.law, Expression | SlideExpression)

    @property
    def everywhere(self) -> bool:
        """Whether the largest deviation is taken over a whole range, not only at positions: of a law unless it is a table, and of
        the transmission angle."""
        return self.measure == "max" and bool(self.requirement.ranged(self))

    @property
    def error_bounded(self) -> bool:
        """Whether a lower bound of the largest error over all linkages is available: of a function of a four-bar, without
        tolerances and links."""
        bounded = self.task == "function" and self.everywhere and self.robust is None and not self.links
        return bounded and isinstance(self.requirement.law, Function)

    @property
    def counted(self) -> dict[str, float]:
        """Tolerances [SI] that enter the objective, by key; measured deviations are excluded."""
        if self.robust is None:
            return {}
        return {f"tolerances.{d.name}": d.tolerance for d in self.deviations if not d.values}

    def shares_programme(self, keys: Sequence[str]) -> bool:
        """Return whether one programme serves all values of keys of the file, including the side of a limit."""
        if self.task != "function" or self.everywhere or self.limits.regions or len(self.mechanism.variants(self.linkage)) > 1:
            return False
        return all(map(is_parameter, keys))


MODELS.append(DesignProblem)


def _forced(term: Term) -> bool:
    return term.nature.kind in ("torque", "force", "energy", "power")


def _order(requirement: Requirement) -> tuple[bool, bool]:
    """Return a sort key: the first requirement is one by which results are shown."""
    return not requirement.targeted, requirement.secondary


def is_parameter(key: str) -> bool:
    """Return whether the value of a key is a parameter of a programme."""
    return key.startswith(NUMBERS) and key not in CHOICES
