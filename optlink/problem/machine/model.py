"""Problem: a linkage with its masses, loads and drive, checked; input of `analyze` and `simulate`."""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from optlink.clearance.joint import Gap
from optlink.dynamics.loads import Force, Load
from optlink.dynamics.machine import Machine, Moving
from optlink.dynamics.strokes import slow_stroke_of
from optlink.linkage.continuation import continue_through_singularities
from optlink.linkage.mechanism import FRAME, Mechanism
from optlink.linkage.stroke import LEAST_DIFFERENCE, Direction
from optlink.linkage.vector2d import TURN, Value, cross, dot
from optlink.problem.base_model import RESERVED, Name, Section
from optlink.problem.machine.balance import BalanceSection
from optlink.problem.machine.bodies import BodySection, DriveSection, Gravity
from optlink.problem.machine.control import ControlSection
from optlink.problem.machine.joints import JointSection
from optlink.problem.machine.loads import LoadSection
from optlink.problem.mechanism import DyadsSection, FourBarSection, sizes_of
from optlink.problem.quantity import FixedAngle, FixedLength, Number, Quantity, Unusable, below, nearest
from optlink.problem.tolerances import Deviation, Tolerances, deviations, with_deviating_pivots

Array = NDArray[np.float64]
STROKES = 720  # positions of a revolution at which the motion of a load is sampled
FULL_TURN = TURN - 0.02  # rad; a sampled swing that is wider is a full turn
_SENSE: dict[Direction | None, float] = {"forward": 1.0, "backward": -1.0, None: 0.0}


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


def _dated(value: object) -> object:
    """Read a date of TOML as text."""
    return value.isoformat() if isinstance(value, datetime.date) else value


Fact = Annotated[str, Field(max_length=200)]


class ReportSection(Section):
    """What the head of a report page says about the part; none of it affects the result."""

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
    date: Annotated[Fact, BeforeValidator(_dated)] = ""
    """Date; default: the day on which the page is written."""


class Problem(Section):
    """A problem file, read and checked; immutable. Change it with `optlink.load(..., overrides)` or `override`."""

    title: str = Field(default="problem", min_length=1, max_length=200)
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
    control: ControlSection | None = None
    """Controller of the crank that compensates joint clearance."""
    balance: BalanceSection | None = None
    """Counterweights and springs to be dimensioned, their objective and limits."""
    tolerances: Tolerances = Field(default_factory=dict)
    """Manufacturing tolerances of dimensions, pivots and clearances, by name: `"0.1 mm"`, `"0.1 mm uniform"`, a CSV file with
    deviations, or `{ tolerance, distribution, cost }`."""
    report: ReportSection = ReportSection()
    """Head of the report page: title, company, author, part, revision, date."""
    expected: Expected | None = None
    """Reference values from a trusted source; the tests check them for every shipped problem."""

    @property
    def task(self) -> str:
        """Kind of task: "function", "path", "cycle", "balance" or "analysis"."""
        return "analysis" if self.balance is None else "balance"

    @cached_property
    def quantities(self) -> dict[str, Quantity]:
        """Fixed quantities and design variables by name."""
        return self.mechanism.quantities

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the design variables, in the order of the design vector."""
        return tuple(name for name, quantity in self.quantities.items() if quantity.free)

    @property
    def sense(self) -> float:
        """Sense of crank rotation by its sign: the crank speed [rad/s]."""
        return float(self.drive.speed.value) or 1.0

    def design(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return every quantity [SI] for values of design variables; those not named have their value in the file."""
        return {**sizes_of(self.quantities), **values}

    def start(self, values: Mapping[str, float]) -> float:
        """Return the crank angle [rad] at which the motion of a design begins."""
        return float(self.drive.start.value)

    def check(self) -> None:
        """Check that the sections are consistent.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        machine = self.machine(slow=self.slow_assumed)
        gaps = self.gaps(machine)
        with below("tolerances"):
            _ = self.deviations
        if self.control is not None:
            with below("control"):
                self.control.check(machine, gaps)
        if self.balance is not None:
            with below("balance"):
                self.balance.build(machine)
        if self.drive.servo is not None and self.drive.torque is not None:
            raise Unusable("the drive has a torque and a servo", "Give one of the two", "drive.servo")

    @cached_property
    def longest(self) -> float:
        """Largest length or coordinate of the file [m], at the start of design variables."""
        lengths = [q.value for q in self.mechanism.quantities.values() if q.kind == "length"]
        coordinates = [abs(q.value) for q in self.mechanism.quantities.values() if q.kind == "coordinate"]
        return max([*lengths, *coordinates, 1e-9])

    @cached_property
    def linkage(self) -> Mechanism:
        """Kinematic model of the mechanism."""
        return self.mechanism.linkage(self.title, self.drive.body)

    @cached_property
    def deviations(self) -> tuple[Deviation, ...]:
        """Manufacturing deviations of dimensions.

        Raises
        ------
        Unusable
            whose key is the name of the dimension.
        """
        quantities = self.mechanism.quantities
        mechanism, pivots = with_deviating_pivots(self.mechanism, self.linkage)
        largest = {name: quantity.bounds[1] for name, quantity in quantities.items()}
        return deviations(self.tolerances, mechanism, quantities, largest | pivots)

    def machine(self, design: Mapping[str, Value] | None = None, slow: Mapping[str, Direction] | None = None) -> Machine:
        """Return the machine for given quantities; values and starts of the file are the defaults.

        Parameters
        ----------
        design : mapping of str to float, array or symbol [m, rad], optional
            Values of quantities.
        slow : mapping of str to "forward" or "backward", optional
            The slow stroke of loads of the slow or quick stroke, for a crank that turns counter-clockwise; default: that of the
            machine of this design.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        mechanism, sizes = self.linkage, {**sizes_of(self.mechanism.quantities), **(design or {})}
        for section, names in (("bodies", mechanism.bodies), ("joints", mechanism.pins)):
            for name in getattr(self, section):
                if name not in names:
                    what = "no such body" if section == "bodies" else "no such pin joint"
                    if section == "joints" and name in [guide.name for guide in mechanism.guides]:
                        what = "a guide is a sliding joint; clearance is supported in pin joints"
                    raise Unusable(what, nearest(name, names), f"{section}.{name}")
        for name, joint in self.joints.items():
            if joint.on is not None and joint.on not in mechanism.pins[name]:
                remedy = nearest(joint.on, mechanism.pins[name])
                raise Unusable("the joint is not one of that body", remedy, f"joints.{name}.on", joint.on)
            with below(f"joints.{name}"):
                joint.check_unused()
        inertias = {}
        for name, body in self.bodies.items():
            with below(f"bodies.{name}"):
                inertias[name] = body.inertia_of(name, mechanism, sizes)
        if self.mechanism.follows and all(np.ndim(size) == 0 for size in sizes.values()):
            self.mechanism.check_mode(sizes)
            mechanism = continue_through_singularities(mechanism, sizes, self.drive.start.value)
        motion = Revolution(Machine(mechanism, sizes), slow or {})
        loads = []
        for name, section_ in self.loads.items():
            if name in RESERVED:
                raise Unusable(f"{name} is a reserved name", "Choose another", f"loads.{name}")
            if name in (*mechanism.bodies, *mechanism.owners, *(guide.name for guide in mechanism.guides), FRAME):
                raise Unusable("the name of a body, point or guide", "Choose another for the load", f"loads.{name}")
            with below(f"loads.{name}"):
                loads.append(section_.build(name, mechanism, motion))
        return Machine(
            mechanism,
            sizes,
            inertias,
            self.gravity,
            tuple(loads),
            self.mechanism.friction,
            {name: joint.on for name, joint in self.joints.items() if joint.on is not None},
        )

    @property
    def slow_assumed(self) -> dict[str, Direction] | None:
        """Assumed slow stroke of every load if there are design variables, which determine it; else None."""
        return dict.fromkeys(self.loads, "forward") if self.free else None

    def slow_senses(self, design: Mapping[str, Value]) -> Array:
        """Return the slow strokes of the loads that act by pace (loads, designs): 1 forward, -1 backward, 0 for equal strokes.

        Parameters
        ----------
        design : mapping of str to array (designs, 1) [m, rad]
            Values of quantities.
        """
        machine = self.machine(design, dict.fromkeys(self.loads, "forward"))
        motion = Revolution(Machine(machine.mechanism, machine.sizes))
        return np.array([motion.slow_senses(load) for load in machine.loads if self.loads[load.name].by_pace])

    @property
    def has_clearance(self) -> bool:
        """Whether some joint has clearance."""
        return any(joint.has_clearance for joint in self.joints.values())

    def gaps(self, machine: Machine) -> tuple[Gap, ...]:
        """Return the joints with clearance.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        found = []
        for name, joint in self.joints.items():
            if joint.has_clearance:
                with below(f"joints.{name}"):
                    found.append(joint.gap(name, machine.mechanism))
        if found:
            Revolution(machine).check_clearances(found)
        return tuple(found)


class Revolution:
    """Samples of a machine's motion over a revolution, as far as it can be assembled."""

    def __init__(self, machine: Machine, slow: Mapping[str, Direction] | None = None) -> None:
        self.machine, self._slow = machine, slow or {}

    @cached_property
    def moving(self) -> Moving:
        """The machine at evenly spaced crank angles."""
        return self.machine.moving(np.linspace(0.0, self.machine.mechanism.cycle, STROKES, endpoint=False) + 1e-4)

    def check_clearances(self, gaps: Sequence[Gap]) -> None:
        """Refuse clearances that allow a group of the mechanism to disassemble or to change its assembly mode.

        Raises
        ------
        Unusable
            If there are such clearances, with the key of the first one.
        """
        mechanism, assembled = self.machine.mechanism, self.moving.motion.assembled
        with np.errstate(all="ignore"):
            pose = mechanism.at(self.machine.sizes, self.moving.motion.crank_angle)
        for group in mechanism.groups if np.all(assembled) else ():
            own = {link.body for link in group.links}
            loose = [gap for gap in gaps if own & {gap.journal, gap.bearing}]
            with np.errstate(all="ignore"):
                gap = group.gap(pose)
            spare = -np.broadcast_to(np.asarray(gap, dtype=float), assembled.shape)[assembled]
            if not loose or not spare.size or not np.any(spare > 0.0):
                continue
            play, least = sum(gap.clearance for gap in loose), float(np.min(spare))
            if play >= least:
                at = float(np.degrees(self.moving.motion.crank_angle[assembled][int(np.argmin(spare))]))
                message = (
                    f"the clearance lets the mechanism come apart: at a crank angle of {at:z.0f} deg the group of {group.joint} "
                    f"closes with {least * 1e3:.4g} mm to spare, and its joints have {play * 1e3:.4g} mm of play"
                )
                raise Unusable(message, "Give a smaller clearance, or other lengths", f"joints.{loose[0].point}.clearance")

    def _rates(self, load: Load) -> Array:
        velocity = load.reversing(self.moving)
        shape = np.shape(self.moving.motion.assembled)
        rate = np.broadcast_to(np.asarray(velocity[0] if velocity else 0.0, dtype=float), shape)
        known: Array = rate[np.isfinite(rate)]
        return known

    def check_moves(self, load: Load) -> None:
        """Refuse a load that opposes a motion that does not exist.

        Raises
        ------
        Unusable
            If the load is one.
        """
        rates = self._rates(load)
        size = float(np.max(self.machine.size)) if isinstance(load, Force) else 1.0
        moves = np.count_nonzero(np.abs(rates) > 1e-12 * size)
        if rates.size and moves < 0.5 * rates.size:  # near singular positions rounding errors are larger
            what = "does not move in this direction" if isinstance(load, Force) else "does not turn"
            raise Unusable(f"what it opposes {what}", 'Take the load out, or write acts = "constant"', "acts")

    def slow(self, load: Load) -> Direction:
        """Return the stroke of a load's motion that takes longer at constant counter-clockwise crank speed.

        Raises
        ------
        Unusable
            when both take equally long.
        """
        if load.name in self._slow:
            return self._slow[load.name]
        sense = self.slow_senses(load)  # many designs share one machine only if they have the same slow stroke
        found: Direction | None = "forward" if np.all(sense > 0.0) else "backward" if np.all(sense < 0.0) else None
        if not np.all(self.moving.motion.assembled) and found is None:
            message = "the crank does not turn fully, and in the range that it reaches no stroke is the slow one"
            raise Unusable(message, 'Change the sizes, or write stroke = "forward" or "backward"', "stroke")
        if found is None:
            least = f"{math.degrees(LEAST_DIFFERENCE):g} deg"
            message = f"both strokes take equally long (to {least} of crank rotation), so there is no slow stroke"
            raise Unusable(message, 'Write stroke = "forward" or "backward", or change the sizes', "stroke")
        return found

    def slow_senses(self, load: Load) -> Array:
        """Return the slow stroke of a load's motion for one or many designs: 1 forward, -1 backward, 0 for equal strokes.

        For one design with full crank rotation the exact crank angles of the reversals are used, else the sampled positions that
        can be reached, with interpolated reversals.
        """
        assembled = self.moving.motion.assembled
        if np.ndim(assembled) == 1 and np.all(assembled):
            return np.array([_SENSE[slow_stroke_of(self.machine, load)]])
        velocity = load.reversing(self.moving)
        rate = np.asarray(velocity[0] if velocity else 0.0, dtype=float)
        rate = np.broadcast_to(rate, np.shape(assembled)) + np.zeros(STROKES)
        rate = np.concatenate([rate, rate[..., :1]], axis=-1)
        size = np.abs(rate[..., 1:]) + np.abs(rate[..., :-1])
        with np.errstate(all="ignore"):  # 0 / 0 for a design that can be assembled nowhere
            share = (rate[..., 1:] + rate[..., :-1]) / size
            difference = self.machine.mechanism.cycle * np.nansum(share, axis=-1) / np.sum(np.isfinite(share), axis=-1)
        sense = np.where(np.abs(difference) >= LEAST_DIFFERENCE, np.sign(difference), 0.0)
        return np.asarray(sense, dtype=float).reshape(-1)

    def middle(self, body: str, against: str, free: float) -> Value:
        """Return the middle of the swing of a body relative to another [rad], within half a revolution of `free`.

        A number, or an array (designs, 1) if the swing differs from design to design.

        Parameters
        ----------
        body : str
        against : str
            The other body.
        free : float [rad]
            Reference angle.

        Raises
        ------
        Unusable
            when the body makes a full turn, as no torsion spring allows, in any design.
        """
        low, high = self._swing(body, against)
        if np.any(high - low > FULL_TURN):
            message = f"{body} turns fully against {against}, which no torsion spring follows"
            raise Unusable(message, "Use torsional_damping, or a spring between two points", "on")
        middle = 0.5 * (low + high)
        return _per_design(np.where(np.isnan(middle), free, _near(middle, free)))

    def branch(self, body: str) -> Value:
        """Return the middle [rad] of the swing of a body across 180 deg from +x, within that range; 0 for any other motion.

        A number, or an array (designs, 1) if the swing differs from design to design.
        """
        low, high = self._swing(body, FRAME)
        middle, width = _near(0.5 * (low + high), 0.0), high - low
        return _per_design(np.where((width <= FULL_TURN) & (np.abs(middle) + 0.5 * width >= 0.5 * FULL_TURN), middle, 0.0))

    def _swing(self, body: str, against: str) -> tuple[Array, Array]:
        """Return the ends [rad] of the swing of a body relative to another, of each design; NaN: no position is reached."""
        one, other = (self.moving.state(name).axis for name in (body, against))
        angle = np.asarray(np.arctan2(cross(other, one), dot(other, one)) + 0.0 * self.moving.motion.crank_angle)
        reached = [np.unwrap(row[np.isfinite(row)]) for row in np.atleast_2d(angle)]
        ends = np.array([[np.min(swing), np.max(swing)] if swing.size else [np.nan, np.nan] for swing in reached])
        low, high = ends.T.reshape(2, *np.shape(angle)[:-1])
        return low, high


def _near(angle: Array, reference: float) -> Array:
    """Return angles less whole revolutions: at most half a revolution from a reference, ahead of it in the case of a tie."""
    return np.asarray(angle - TURN * np.ceil((angle - reference) / TURN - 0.5 - 1e-9))


def _per_design(values: Array) -> Value:
    """Return the value of one design as a number, those of many designs as an array (designs, 1)."""
    return values[:, None] if values.ndim else float(values)
