"""DesignProblem: a linkage with a requirement, of any kind. Its unknowns are the design variables, and free crank angles."""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Self

import numpy as np
from pydantic.fields import FieldInfo

from optlink.linkage.assur import EITHER
from optlink.linkage.mechanism import Pose
from optlink.linkage.vector2d import Array, Value
from optlink.problem.cycle.model import MachineTerms
from optlink.problem.limits import LIMITS, MARGIN_KEYS, Limits, LimitTerm, Reach, check_limits, four_bar_limits
from optlink.problem.machine.model import ShownObjective
from optlink.problem.mechanism import FourBarSection, check_one_mode
from optlink.problem.quantity import Quantity
from optlink.problem.requirement import AnyRequirement, StartPosition, TargetArrays, carrier
from optlink.problem.robust import Robust
from optlink.problem.targets.expression import Expression
from optlink.problem.targets.function import Function
from optlink.problem.targets.law import Law, SlideExpression
from optlink.problem.targets.target_points import TargetPoints
from optlink.units import DISPLAYED

NUMBERS = ("mechanism.", "limits.", "tolerances.", "requirement.from", "requirement.start", "requirement.psi0")
"""Beginnings of the keys whose values are parameters of a programme."""
CHOICES = ("limits.crank", "limits.transmission_over", *MARGIN_KEYS)
"""Keys with such a beginning that change the programme itself."""
EPIGRAPH = "largest error"  # name of the extra variable of a minimax NLP, and of its rows
STEP = 1e-4  # rad, least crank rotation from a point to the next


class DesignProblem(MachineTerms):
    """A linkage with a law, a path, a motion or its transmission as requirement: input of `solve`. Immutable.

    Change it with `optlink.load(..., overrides)`.
    """

    requirement: AnyRequirement
    """Law or function, points, poses, or the best transmission."""
    limits: Limits = Limits()
    """Limits of the design."""

    @property
    def task(self) -> str:
        """Kind of task: "function" for laws of a four-bar section, else "path"."""
        return str(self.requirement.task(self))

    @property
    def has_error(self) -> bool:
        """Whether a design has an error over the span of a motion law."""
        return self.task == "function"

    @property
    def four_bar(self) -> bool:
        """Whether the linkage is a four-bar by its lengths."""
        return isinstance(self.mechanism, FourBarSection)

    @property
    def side(self) -> int:
        """Assembly mode of a four-bar: +1 left, -1 right of B -> D."""
        assert isinstance(self.mechanism, FourBarSection)
        return self.mechanism.side

    def check(self) -> None:
        """Check that the sections are consistent.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        check_one_mode(self.mechanism)
        check_limits(self.limits, self.linkage, four_bar=self.four_bar)
        self.requirement.check(self)
        super().check()

    @property
    def inapplicable(self) -> set[str]:
        """Keys of requirement and limits, such as "limits.link_ratio", that do not apply to this mechanism."""
        limits = () if self.four_bar else four_bar_limits()
        return {*(f"limits.{key}" for key in limits), *self.requirement.inapplicable(self)}

    # --- quantities

    @cached_property
    def quantities(self) -> dict[str, Quantity]:
        """Fixed quantities and design variables by name: those of the mechanism and those of the requirement."""
        return {**self.mechanism.quantities, **self.requirement.quantities(self)}

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
        return kind == "angle" and bool(self.requirement.is_periodic(self, name))

    def complete(self, values: Mapping[str, Value]) -> dict[str, Value]:
        """Return every quantity [SI] for values of the design variables, elementwise, with those that follow from others.

        These are linked quantities, the start angle of the crank at a dead centre, and the output there if a law starts from it.
        """
        known = super().complete(values)
        full = {name: known[name] for name in self.quantities}
        return {**full, **self.requirement.derived(self, full)}

    def design(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the complete design [SI] for values of the design variables."""
        return {name: float(value) for name, value in self.complete(values).items()}

    def start(self, values: Mapping[str, float]) -> float:
        """Return the crank angle [rad] at which the requirement begins, where it has one; else that of the drive.

        0 for a dead centre that does not exist.
        """
        begin = {**values, **self.requirement.derived(self, values)}.get(self.start_name)
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

    def crank_angles(self, values: Mapping[str, float], angles: Array | None) -> Array:
        """Return the crank angle [rad] at each position; where the timing is free those of the design, `angles`."""
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

    @cached_property
    def closed(self) -> bool:
        """Whether the points form a closed curve: the last step leads back to the first point."""
        return bool(self.requirement.is_closed)

    @property
    def meets_again(self) -> bool:
        """Whether the last point coincides with the first: only then may the crank angles coincide."""
        columns = self.data.columns
        return bool(np.max(np.abs(columns[0, :2] - columns[-1, :2])) <= 1e-9 * self.size)

    @cached_property
    def centre(self) -> tuple[float, float]:
        """Mean of the points [m]; the origin if there are none."""
        return self.requirement.centre if self.pointed else (0.0, 0.0)

    @cached_property
    def size(self) -> float:
        """Unit of length [m]: the root mean square distance of the points from their centre, the travel of a slider, the frame of
        a four-bar with a law, else the longest fixed link.
        """
        if (size := self.requirement.size(self)) is not None:
            return float(size)
        quantities = [q for q in self.mechanism.quantities.values() if q.kind == "length"]
        fixed = [q.value for q in quantities if q.fixed]
        return max(fixed or [q.value for q in quantities])

    @cached_property
    def radian(self) -> float:
        """Length [m] equivalent to one radian of a pose."""
        return float(self.requirement.radian(self))

    # --- objective

    @property
    def measure(self) -> str:
        """Measure that reduces the deviations to one value: "sum of squares", "rms" or "max"."""
        return str(self.requirement.measure)

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
        """SI unit of the objective."""
        return f"{self.unit}^2" if self.measure == "sum of squares" and self.unit else self.unit

    @property
    def objective_display(self) -> tuple[float, str]:
        """Factor from SI to the displayed value of the objective, and the unit of that."""
        if self.task == "function" and self.measure == "sum of squares":
            return 1.0, self.objective_unit
        factor, unit = DISPLAYED[self.unit]
        return (factor**2, f"{unit}^2" if unit else unit) if self.measure == "sum of squares" else (factor, unit)

    @property
    def by_angle(self) -> bool:
        """Whether the objective is shown as an angle: the largest cosine of a transmission angle, by its distance from 90 deg."""
        return bool(self.requirement.by_angle)

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
        return getattr(self.requirement, "slides", False)

    @property
    def based(self) -> bool:
        """Whether the law is relative to the output at the start (psi0, s0), not to the frame."""
        return bool(self.requirement.based)

    @property
    def robust(self) -> Robust | None:
        """Effect of manufacturing deviations on the objective of a law; None if they have none."""
        return getattr(self.requirement, "robust", None)

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
        return self.law_given and isinstance(self.requirement.law, Expression | SlideExpression)

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

    # --- several requirements

    @property
    def parts(self) -> tuple[Self, ...]:
        """The problem with each of its requirements alone."""
        return (self,)

    @property
    def suffix(self) -> str:
        """What names the requirement in labels, if there are several."""
        return ""

    @property
    def key(self) -> str:
        """Key of the requirement in the file."""
        return "requirement"

    @property
    def tolerance(self) -> float | None:
        """Largest measure of the deviations [SI] of a requirement that is a limit; None for one that is minimised."""
        return None

    @property
    def worth(self) -> float:
        """Factor of the measure of the deviations in the objective."""
        return 1.0

    @property
    def counted(self) -> dict[str, float]:
        """Tolerances [SI] that enter the objective, by key; measured deviations are excluded."""
        if self.robust is None:
            return {}
        return {f"tolerances.{d.name}": d.tolerance for d in self.deviations if not d.values}

    def shares_programme(self, keys: Sequence[str]) -> bool:
        """Return whether one programme serves all values of keys of the file, including the side of a limit."""
        if self.task != "function" or self.everywhere or self.mechanism.assembly == EITHER:
            return False
        return all(key.startswith(NUMBERS) and key not in CHOICES for key in keys)


def add_limit(term: LimitTerm) -> None:
    """Register a limit of a design problem from outside the package.

    Raises
    ------
    ValueError
        if the key is already taken.
    """
    if term.name in Limits.model_fields:
        raise ValueError(f"{term.key} is already registered")
    LIMITS.add(term.name, term)
    Limits.model_fields[term.name] = FieldInfo(annotation=term.form | None, default=None, description=term.about)
    for model in (Limits, DesignProblem):
        model.model_rebuild(force=True)
