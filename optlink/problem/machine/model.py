"""Problem: a linkage with its masses, loads and drive, checked; input of `analyze` and `simulate`."""

import copy
import datetime
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import AfterValidator, AliasChoices, BeforeValidator, Field

from optlink.clearance.joint import Gap
from optlink.dynamics.machine import Machine
from optlink.io import Entry
from optlink.linkage.continuation import continue_through_singularities
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.stroke import Direction
from optlink.linkage.vector2d import Array, Value
from optlink.problem.base_model import RESERVED, Fact, Name, Section, in_folder
from optlink.problem.driving import Driving, check_same_drive, driven
from optlink.problem.linked import Link, check_linked, links_of
from optlink.problem.machine.balance import BalanceSection
from optlink.problem.machine.bodies import BodySection, DriveMotion, DriveSection, Gravity, JointSection
from optlink.problem.machine.control import ControlSection, MeasuredSeries, read_measured
from optlink.problem.machine.loads import LoadSection, RevolutionSamples
from optlink.problem.machine.parts import PartsSection
from optlink.problem.mechanism import DyadsSection, FourBarSection, nearest_modes, sizes_of
from optlink.problem.quantity import (
    FixedAngle,
    FixedLength,
    Number,
    Quantity,
    Unusable,
    below,
    check_name,
    nearest,
    quantity_key,
    write,
)
from optlink.problem.targets.expression import MOST_REVOLUTIONS
from optlink.problem.tolerances import Deviation, ToleranceEntry, Tolerances, deviations, with_deviating_pivots
from optlink.units import display_unit

if TYPE_CHECKING:
    from optlink.clearance.columns import Output

SPELLINGS = {
    "phi0": ("from", "start"),
    "start": ("from", "start"),
    "psi0": ("psi0",),
    "zero": ("psi0", "zero"),
    "mark": ("mark",),
}
"""Keys of the requirement for the quantities that it adds to those of the mechanism."""
FORMAT: Literal[1] = 1
"""The latest format of problem files, and so far the only one."""
MAX_SHIFT = 1e6  # largest distance of a mechanism or a curve from the origin, in multiples of its size


class Expected(Section):
    """Reference values from a trusted source, and their tolerances."""

    source: str
    """Origin of the reference values."""
    crank: FixedLength | None = None
    """Length of the crank."""
    coupler: FixedLength | None = None
    """Length of the coupler."""
    rocker: FixedLength | None = None
    """Length of the rocker."""
    frame: FixedLength | None = None
    """Length of the frame."""
    phi0: FixedAngle | None = None
    """Crank angle at the start of the law."""
    psi0: FixedAngle | None = None
    """Rocker angle at the start of the law."""
    length_tolerance: FixedLength | None = None
    """Absolute tolerance of the lengths."""
    objective: Number | None = None
    """The objective of the best design, a plain number in SI units."""
    objective_tolerance: Number | None = None
    """Absolute tolerance of the objective."""
    figures: dict[str, Number] = Field(default_factory=dict)
    """Figures of the analysis of the machine without clearance, by name, plain numbers in SI units."""
    figure_tolerance: Number = 1e-6
    """Relative tolerance of the figures."""


class ReportSection(Section):
    """Head of a report page: data of the part, without effect on the result."""

    title: Fact = ""
    """Title of the page; default: that of the problem."""
    company: Fact = ""
    """Company."""
    author: Fact = ""
    """Name of the author."""
    part: Fact = ""
    """Name or number of the part."""
    revision: Fact = ""
    """Revision."""
    date: Annotated[Fact, BeforeValidator(lambda raw: raw.isoformat() if isinstance(raw, datetime.date) else raw)] = ""
    """Date; default: the day on which the page is written."""


class ShownObjective(NamedTuple):
    """An objective in its display `unit`: `value`, and the `factor` from a small change of the minimised value [SI]."""

    value: float
    factor: float
    unit: str
    name: str = "objective"


class Problem(Section):
    """A problem file, read and checked; immutable. Change it with `optlink.load(..., overrides)` or `override`."""

    format: Literal[1] = FORMAT
    """Version of the format of the file, which rises when a later optlink can no longer read it as before."""
    title: Annotated[str, AfterValidator(lambda text: " ".join(text.splitlines()))] = Field(
        "problem", min_length=1, max_length=200
    )
    """Title, one line of at most 200 characters; default: the name of the file."""
    source: str = ""
    """Origin of the problem."""
    about: str = ""
    """Data and purpose of the problem, in a few sentences."""
    gravity: Gravity = (0.0, 0.0)
    """Acceleration of gravity along -y, or its two components."""
    mechanism: FourBarSection | DyadsSection = Field(discriminator="type")
    """The linkage: a four-bar, or any chain of dyads."""
    bodies: dict[Name, BodySection] = Field(default_factory=dict)
    """Mass properties by the name of the body; a body without an entry has no mass."""
    joints: dict[Name, JointSection] = Field(default_factory=dict)
    """By the name of the pin: the body whose reaction is reported, and the joint clearance."""
    loads: dict[Name, LoadSection] = Field(default_factory=dict)
    """Forces, torques, springs and dampers, each under a name of your choice."""
    drive: DriveSection = DriveSection()
    """Driven body, speed, torque or servo of the drive."""
    drives: dict[Name, DriveMotion] = Field(default_factory=dict)
    """Several drives by name, in place of `drive`; one without law and speed is held where it starts."""
    control: ControlSection | None = None
    """Controller of the crank that compensates joint clearance."""
    measured: Annotated[MeasuredSeries | None, in_folder(read_measured)] = None
    """Measured series of the output with which a simulation with joint clearance is compared."""
    balance: BalanceSection | None = None
    """Counterweights and springs to be dimensioned, their objective and limits."""
    tolerances: Tolerances = Field(default_factory=dict)
    """Manufacturing tolerances of dimensions, pivots and clearances, by name: `"0.1 mm"`, `"0.1 mm uniform"`, a CSV file with
    deviations, or `{ tolerance, distribution, cost }`."""
    report: ReportSection = ReportSection()
    """Head of the report page: title, company, author, part, revision, date."""
    made: PartsSection = Field(default=PartsSection(), validation_alias=AliasChoices("parts"))
    """How the links are cut or printed: width, thickness, holes, pins."""
    expected: Expected | None = None
    """Reference values from a trusted source; the tests check them for every shipped problem."""

    @property
    def task(self) -> str:
        """Kind of task: "function", "path", "cycle", "balance" or "analysis"."""
        return "analysis" if self.balance is None else "balance"

    @cached_property
    def quantities(self) -> dict[str, Quantity]:
        """Fixed and linked quantities and design variables by name."""
        return self.mechanism.quantities

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the design variables, in the order of the design vector."""
        return tuple(name for name, quantity in self.quantities.items() if quantity.free)

    @property
    def fixed(self) -> tuple[str, ...]:
        """Names of the fixed quantities, which are the parameters of the programme."""
        return tuple(name for name, quantity in self.quantities.items() if quantity.fixed)

    @cached_property
    def links(self) -> dict[str, Link]:
        """The links by the names of the linked quantities, each after those from which it follows.

        Raises
        ------
        Unusable
            with the full key of the quantity.
        """
        try:
            return links_of(self.quantities)
        except Unusable as error:
            error.key = f"{quantity_key(self, error.key)}.equals"
            raise

    def complete(self, values: Mapping[str, Value]) -> dict[str, Value]:
        """Return every quantity [SI] from some of them, elementwise; each stated value is kept.

        Fixed quantities and design variables that are not stated have their value in the file; linked ones follow from the rest.
        """
        complete: dict[str, Value] = sizes_of(self.quantities) | dict(values)
        for name, link in self.links.items():
            if name not in values:
                complete[name] = link(complete)
        return complete

    def sizes(self, design: Mapping[str, Value]) -> dict[str, Value]:
        """Return every dimension of the linkage [SI] from some quantities, as `complete` does."""
        known = Problem.complete(self, design)
        return {name: known[name] for name in self.mechanism.quantities}

    def check_stated(self) -> None:
        """Check that the requirement has the keys on which its quantities depend."""

    def with_links(self, raw: Mapping[str, Any]) -> dict[str, Any]:
        """Return the nested tables of the file with the values of linked quantities.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        self.check_stated()
        tables, values = copy.deepcopy(dict(raw)), Problem.complete(self, {})
        for name in self.links:
            key, quantity = quantity_key(self, name), self.quantities[name]
            with below(f"{key}.equals", quantity.equals):
                check_linked(name, quantity, float(values[name]))
            known = replace(quantity, value=float(values[name]))
            if name in self.mechanism.quantities:
                write(tables["mechanism"], name, known)
            else:
                section, *number, _ = key.split(".")
                requirement = tables[section][int(number[0])] if number else tables[section]
                requirement[next(one for one in SPELLINGS[name.rpartition(".")[2]] if one in requirement)] = known
        return tables

    @property
    def objective_unit(self) -> str:
        """SI unit of the objective; empty for a plain number, and without an objective."""
        return ""

    @property
    def objective_display(self) -> tuple[float, str]:
        """Factor from the minimised value [SI] to the displayed value of the objective, and the unit of that."""
        return 1.0, self.objective_unit

    def shown_objective(self, objective: float) -> ShownObjective:
        """Return an objective, the minimised value [SI], and how changes of it are shown."""
        factor, unit = self.objective_display
        return ShownObjective(factor * objective, factor, unit)

    @property
    def sense(self) -> float:
        """Sense of crank rotation by its sign: the crank speed [rad/s]."""
        return self.driving.pace or 1.0

    def design(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return every quantity [SI] for values of design variables; those not named have their value in the file."""
        return dict(self.complete(values))

    def display(self, name: str) -> tuple[float, str]:
        """Return the factor of a value of a design from SI to its display unit, and that unit; derived values are angles."""
        return display_unit(self.quantities[name].kind if name in self.quantities else "angle")

    def displayed(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return values of a design in display units, each unit appended to the key."""
        units = {name: self.display(name) for name in values}
        return {f"{name}_{units[name][1]}": value * units[name][0] for name, value in values.items()}

    def start(self, values: Mapping[str, float]) -> float:
        """Return the crank angle [rad] at which the motion of a design begins."""
        return self.driving.first

    @property
    def parts(self) -> tuple[Any, ...]:
        """The problem with each of its requirements of targets alone; none without."""
        return ()

    @property
    def goals(self) -> tuple[Any, ...]:
        """The quantities of the machine that are minimised or maximised."""
        return ()

    @property
    def bounds(self) -> tuple[Any, ...]:
        """The limits of quantities of the machine with their bounds."""
        return ()

    @property
    def of_cycle(self) -> bool:
        """Whether only quantities of the machine over its cycle are demanded, without targets."""
        return bool(self.goals) and not self.parts

    def shares_programme(self, keys: Sequence[str]) -> bool:
        """Return whether one programme serves all values of keys of the file, including the side of a limit."""
        return False

    def check(self) -> None:
        """Check that the sections are consistent.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        self._check_places()
        machine = self.machine(slow=self.slow_assumed)
        gaps = self.gaps(machine)
        with below("tolerances"):
            _ = self.deviations
        with below("parts"):
            self.made.check(machine.mechanism)
        if self.control is not None:
            with below("control"):
                self.control.check(machine, gaps)
        if self.measured is not None:
            with below("measured"):
                self.measured.check(self.controlled_output(machine), steady=self.drive.torque is None)
        if self.balance is not None:
            with below("balance"):
                self.balance.build(machine)
        if self.drives and self.drive.model_fields_set:
            raise Unusable("the machine has a drive and several drives", "Give one of the two sections", "drive")
        if self.drive.servo is not None and self.drive.torque is not None:
            raise Unusable("the drive has a torque and a servo", "Give one of the two", "drive.servo")

    def controlled_output(self, machine: Machine) -> "Output":
        """Return the output whose deviation is measured: that of `control.output`, else the default one."""
        from optlink.clearance.columns import default_output, outputs

        named = None if self.control is None else self.control.output
        return default_output(machine) if named is None else outputs(machine)[named]

    def _check_places(self) -> None:
        """Refuse points of the frame so far from the origin that rounding errors of their coordinates distort the motion."""
        quantities = self.mechanism.quantities
        size = max((quantity.value for quantity in quantities.values() if quantity.kind == "length"), default=np.inf)
        for name, quantity in quantities.items():
            place, _, axis = name.rpartition(".")
            if axis in ("x", "y") and abs(quantity.value) > MAX_SHIFT * size:
                key = "mechanism.pivot"
                if isinstance(self.mechanism, DyadsSection):
                    key = f"mechanism.guides.{place}.through" if place in self.mechanism.guides else f"mechanism.ground.{place}"
                message = (
                    f"{place} lies {abs(quantity.value) / size:.1e} times the longest link away from the origin, "
                    "so double precision does not resolve the motion"
                )
                raise Unusable(message, "Check the units, or move the origin near the mechanism", key, str(quantity))

    @cached_property
    def longest(self) -> float:
        """Largest length or coordinate of the file [m], at the start of design variables."""
        sizes = [abs(q.value) for q in self.mechanism.quantities.values() if q.kind in ("length", "coordinate")]
        return max([*sizes, 1e-9])

    def assembled(self) -> Self:
        """Return the problem with the assembly modes that follow from places of joints, at the start of the design variables.

        Raises
        ------
        Unusable
            with the full key of the place.
        """
        if not (places := self.mechanism.near):
            return self
        try:
            sizes = sizes_of(self.mechanism.quantities)
            driving = driven(self.mechanism, self.title, self.drive, self.drives, sizes)  # not cached: the copy has another
            modes = nearest_modes(driving.mechanism, sizes, driving.first, places)
        except Unusable as error:
            error.key = "mechanism.assembly" + ("" if isinstance(self.mechanism, FourBarSection) else f".{error.key}")
            raise
        return self.model_copy(update={"mechanism": self.mechanism.with_modes(modes)})

    @cached_property
    def linkage(self) -> Mechanism:
        """Kinematic model of the mechanism."""
        return self.driving.mechanism

    @cached_property
    def driving(self) -> Driving:
        """The mechanism as it is driven, the rate of the crank angle or cycle variable [rad/s], and its first value [rad]."""
        return driven(self.mechanism, self.title, self.drive, self.drives, sizes_of(self.mechanism.quantities))

    @cached_property
    def deviations(self) -> tuple[Deviation, ...]:
        """Manufacturing deviations of dimensions.

        Raises
        ------
        Unusable
            whose key is the name of the dimension.
        """
        return self.deviating(self.tolerances, self.loaded)

    def deviating(self, tolerances: Mapping[str, ToleranceEntry], output: str) -> tuple[Deviation, ...]:
        """Return the deviations of given tolerances, whatever the design; see `deviations`."""
        quantities = self.mechanism.quantities
        mechanism, pivots = with_deviating_pivots(self.mechanism, self.linkage)
        largest = {name: quantity.value if quantity.low is None else quantity.bounds[1] for name, quantity in quantities.items()}
        return deviations(tolerances, mechanism, quantities, largest | pivots, output=output)

    @property
    def loaded(self) -> str:
        """The output that shows to which side a joint clearance lies: a body (its angle), "P.x" of a point, or none."""
        return "rocker" if isinstance(self.mechanism, FourBarSection) else ""

    def machine(self, design: Mapping[str, Value] | None = None, slow: Mapping[str, Direction] | None = None) -> Machine:
        """Return the machine for given quantities [m, rad]; values and starts of the file are the defaults.

        `slow`: the slow stroke of loads of the slow or quick stroke, for a crank that turns counter-clockwise; default: that
        of the machine of this design.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        mechanism, sizes = self.linkage, {**self.sizes(design or {}), **(design or {})}
        if design and self.drive.linear:
            check_same_drive(self.drive, mechanism, sizes_of(self.mechanism.quantities), sizes)
        guides = [guide.name for guide in mechanism.guides]
        for name in self.bodies:
            if name not in mechanism.bodies:
                raise Unusable("no such body", nearest(name, mechanism.bodies), f"bodies.{name}")
        for name in self.joints:
            if name not in mechanism.pins:
                sliding = "a guide is a sliding joint; clearance is supported in pin joints"
                what = sliding if name in guides else "no such pin joint"
                raise Unusable(what, nearest(name, mechanism.pins), f"joints.{name}")
        for name, joint in self.joints.items():
            with below(f"joints.{name}"):
                if joint.on is not None:
                    check_name(joint.on, mechanism.pins[name], "the joint is not one of that body", "on")
                joint.check_unused(name, mechanism.pins[name])
        inertias = self.mechanism.inertias
        for name, body in self.bodies.items():
            with below(f"bodies.{name}"):
                if name in mechanism.rods or any(name == drive.body and drive.size for drive in mechanism.drives):
                    remedy = f"Give them to its parts: mechanism.cylinders.{name}.barrel and .rod"
                    raise Unusable("a cylinder has the masses of barrel and rod", remedy)
                inertias[name] = body.inertia_of(name, mechanism, sizes)
        if self.mechanism.follows and all(np.ndim(size) == 0 for size in sizes.values()):
            self.mechanism.check_mode(sizes)
            mechanism = continue_through_singularities(mechanism, sizes, self.driving.first)
        motion = RevolutionSamples(Machine(mechanism, sizes), slow or {})
        loads = []
        for name, load in self.loads.items():
            if name in RESERVED:
                raise Unusable(f"{name} is a reserved name", "Choose another", f"loads.{name}")
            if name in (*mechanism.bodies, *mechanism.owners, *guides):
                raise Unusable("the name of a body, point or guide", "Choose another for the load", f"loads.{name}")
            with below(f"loads.{name}"):
                loads.append(load.build(name, mechanism, motion))
        return Machine(
            mechanism,
            sizes,
            inertias,
            self.gravity,
            tuple(loads),
            self.mechanism.friction,
            {name: joint.on for name, joint in self.joints.items() if joint.on is not None},
        )

    def check_repeats(self, machine: Machine) -> None:
        """Refuse loads that do not repeat after whole revolutions of a crank that turns fully, so that the machine has no cycle.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        if machine.revolutions is not None and machine.revolutions <= MOST_REVOLUTIONS:
            return
        sizes = {load.name: load.magnitude for load in machine.processes}
        revolutions = {name: getattr(size, "revolutions", 1) for name, size in sizes.items()}
        if machine.revolutions is None:
            name = next(name for name, count in revolutions.items() if count is None)
            message = f"the load does not repeat after {MOST_REVOLUTIONS} revolutions of the crank or fewer, so there is no cycle"
            remedy = (
                "Write phi within sin, cos or tan, times a fraction such as phi/2 for two revolutions, or give a table over phi; "
                "`optlink simulate` follows a load that never repeats"
            )
        else:
            name = max(revolutions, key=lambda name: revolutions[name] or 0)
            message = f"motion and loads repeat together only after {machine.revolutions} revolutions of the crank"
            remedy = f"Change its period: cycles of at most {MOST_REVOLUTIONS} revolutions are supported"
        raise Unusable(message, remedy, f"loads.{name}.{self.loads[name].kind}", str(sizes[name]))

    @property
    def slow_assumed(self) -> dict[str, Direction] | None:
        """Assumed slow stroke of every load if there are design variables, which determine it; else None."""
        return dict.fromkeys(self.loads, "forward") if self.free else None

    def slow_senses(self, design: Mapping[str, Value]) -> Array:
        """Return the slow strokes of the loads that act by pace (loads, designs): 1 forward, -1 backward, 0 for equal strokes.

        Each quantity of `design` is an array (designs, 1) [m, rad].
        """
        machine = self.machine(design, dict.fromkeys(self.loads, "forward"))
        motion = RevolutionSamples(Machine(machine.mechanism, machine.sizes))
        return np.array([motion.slow_senses(load) for load in machine.loads if self.loads[load.name].by_pace])

    @property
    def has_clearance(self) -> bool:
        """Whether some joint has clearance."""
        return any(joint.has_clearance for joint in self.joints.values())

    def gaps(self, machine: Machine) -> tuple[Gap, ...]:
        """Return the joints with clearance."""
        gaps = []
        for name, joint in self.joints.items():
            if joint.has_clearance:
                with below(f"joints.{name}"):
                    gaps.append(joint.gap(name, machine.mechanism))
        if gaps:
            RevolutionSamples(machine).check_clearances(gaps)
        return tuple(gaps)


@dataclass(frozen=True)
class ProblemKind(Entry):
    """A kind of design problem: what is searched for, and how.

    Parameters
    ----------
    name : str
        That of the property `task` of its model.
    load : function
        Imports its `DesignTask` and returns one.
    section : str, optional
        Section of problem files that marks the kind.
    model : type of Problem, optional
        Model of such files.
    """

    name: str
    load: Callable[[], Any]
    section: str = ""
    model: type[Problem] | None = None

    def fault(self) -> tuple[str, str] | None:
        """Refuse a section that another kind has, and one without a model."""
        if self.section in Problem.model_fields or any(self.section == kind.section for kind in self.registry.values()):
            return f'the section "{self.section}" belongs to another kind', "Choose another one"
        return None if self.model else (f'the section "{self.section}" has no model', "Give a subclass of Problem")


TASKS: dict[str, ProblemKind] = ProblemKind.registry


def marked_kinds() -> dict[str, type[Problem]]:
    """Return the models of kinds of problems by the section of a file that marks them."""
    return {kind.section: kind.model for kind in TASKS.values() if kind.model is not None}
