"""The loads of a problem file."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import ModelWrapValidatorHandler, ValidationInfo, model_validator

from optlink.clearance.joint import Gap
from optlink.dynamics.machine import Force, Load, Machine, Moving, Process, SlideDamper, Spring, Torque, TorsionSpring
from optlink.io import Entry, register, without
from optlink.linkage.mechanism import FRAME, Mechanism
from optlink.linkage.stroke import LEAST_DIFFERENCE, OTHER, Direction
from optlink.linkage.vector2d import TURN, Array, Value, all_finite, cross, dot
from optlink.problem.base_model import Section, in_folder
from optlink.problem.quantity import (
    Damping,
    FixedAngle,
    FixedLength,
    Number,
    Quantity,
    Stiffness,
    TorsionalDamping,
    TorsionalStiffness,
    Unusable,
    below,
    check_keys,
    check_name,
    read_fixed,
    read_positive,
    read_scalar,
    reader,
    where,
)
from optlink.problem.targets.expression import MOST_REVOLUTIONS, Expression, parse, revolutions_of
from optlink.problem.targets.target_points import read_columns
from optlink.units import KINDS, factor, show
from optlink.unsupported import unsupported

# Size of a force or torque: a quantity, an expression with its unit, or a table over crank angle, slide or crank speed.

OVER = {"phi": "angle", "s": "coordinate", "v": "velocity", "omega": "angular velocity"}
"""Independent variables of a table of forces: crank angle, slider position and velocity, crank speed."""
REPEATED = 1e-12  # share of a revolution by which a row that repeats the first one may miss it


@dataclass(frozen=True)
class Constant:
    """A constant value; `text` as written."""

    value: float
    text: str
    revolutions: ClassVar[int] = 1
    names: ClassVar[frozenset[str]] = frozenset()
    """Variables on which it depends."""

    def __str__(self) -> str:
        return self.text

    def __call__(self, variables: Mapping[str, Value]) -> Value:
        """Return the value [SI]."""
        return self.value

    def scaled(self, factor: float, offset: float) -> Constant:
        """Return `factor` times the value plus `offset`, a force [N]."""
        return Constant(factor * self.value + offset, self.text)


@dataclass(frozen=True)
class Formula:
    """An expression in a unit of `size` SI."""

    expression: Expression
    unit: str
    size: float

    def __str__(self) -> str:
        return f"{self.expression.text} [{self.unit}]"

    def __call__(self, variables: Mapping[str, Value]) -> Value:
        """Return the value [SI]."""
        return self.expression(variables) * self.size

    @property
    def names(self) -> frozenset[str]:
        """Variables on which it depends."""
        return self.expression.names

    def scaled(self, factor: float, offset: float) -> Formula:
        """Return `factor` times the value plus `offset`, a force [N]."""
        return _formula(f"({self.expression.text})*({factor * self.size!r}) + ({offset!r})")

    @cached_property
    def revolutions(self) -> int | None:
        """Revolutions of the crank after which the value repeats, speeds and positions unchanged; None if it does not."""
        return revolutions_of(self.expression)

    @property
    def cornered(self) -> bool:
        """Whether the value may have a pole, a jump or a corner."""
        return bool(self.breakpoints({name: np.zeros(1) for name in self.expression.names}))

    def breakpoints(self, variables: Mapping[str, Value]) -> list[Value]:
        """Return quantities at whose zeros the value may have a pole, a jump or a corner, see `Expression.breakpoints`."""
        return self.expression.breakpoints(variables)


@dataclass(frozen=True)
class LoadTable:
    """A table over one variable with linear interpolation, constant beyond its ends.

    Over the crank angle it repeats after the least number of whole revolutions that hold its rows.
    """

    over: str
    at: tuple[float, ...]
    values: tuple[float, ...]
    cornered: ClassVar[bool] = True

    def __str__(self) -> str:
        return f"a table over {self.over}, {len(self.at)} rows"

    def __call__(self, variables: Mapping[str, Value]) -> Value:
        """Return the value [SI]."""
        x, (at, values) = variables[self.over], self._rows
        if self.over == "phi":
            period = self.revolutions * TURN
            x = x - period * np.floor((x - at[0]) / period)
        if isinstance(x, float | int | np.ndarray | np.generic):
            return np.interp(np.asarray(x, dtype=float), at, values)
        slopes = np.concatenate([[0.0], np.diff(values) / np.diff(at), [0.0]])
        value: Value = float(values[0])
        for begin, change in zip(at.tolist(), np.diff(slopes).tolist(), strict=True):
            value = value + change * np.maximum(x - begin, 0.0)
        return value

    @property
    def names(self) -> frozenset[str]:
        """Variables on which it depends."""
        return frozenset({self.over})

    def scaled(self, factor: float, offset: float) -> LoadTable:
        """Return `factor` times the values plus `offset`, forces [N]."""
        return replace(self, values=tuple(factor * value + offset for value in self.values))

    @property
    def revolutions(self) -> int:
        """Revolutions of the crank after which the values repeat."""
        turns = (self.at[-1] - self.at[0]) / TURN
        return max(1, math.ceil(turns * (1.0 - REPEATED))) if self.over == "phi" else 1

    @cached_property
    def _rows(self) -> tuple[Array, Array]:
        """The rows; over the crank angle those of whole revolutions, at whose end the value may jump to the first."""
        at, values = np.array(self.at), np.array(self.values)
        end = at[0] + self.revolutions * TURN
        if self.over == "phi" and at[-1] < end - TURN * REPEATED:
            return np.append(at, end), np.append(values, values[0])
        return at, values


Size = Constant | Formula | LoadTable
VARIABLES = ("phi", "omega", "s", "v")
"""Variables of a force along a guide, or between two points, whose distance is s."""


def _formula(text: str) -> Formula:
    """Return a force [N] as an expression in SI."""
    return Formula(parse(text, VARIABLES), "N", 1.0)


def read_size(raw: object, folder: Path, kind: str, names: Iterable[str]) -> Size:
    """Read a force or torque: a quantity, an expression with its unit, or a table over phi, s or omega.

    `names` are the variables of an expression; a table may run over those of them in `OVER`.

    Raises
    ------
    Unusable
    """
    if not isinstance(raw, dict):
        value, own_unit = read_scalar(raw, kind)
        return Constant(value, show(value, kind, own_unit, digits=12))
    if "expression" in raw:
        check_keys(raw, ("expression", "unit"))
        if not isinstance(raw["expression"], str):
            raise Unusable("an expression is text", 'Write expression = "1000 + 200*sin(phi)"', "expression", raw["expression"])
        with below("expression", raw["expression"]):
            expression = parse(raw["expression"], names)
            if not expression.constants_finite:
                raise Unusable("it has no finite value", "Correct the division by zero, or the root or logarithm of a constant")
        unit = raw.get("unit")
        if not isinstance(unit, str):
            raise Unusable("an expression gives a plain number", f'Add its unit: unit = "{KINDS[kind].display}"', "unit", unit)
        with below("unit", unit):
            return Formula(expression, unit, factor(unit, kind))
    over: Any = raw.get("over")
    variables = [name for name in names if name in OVER]
    if over in ("t", "time"):
        raise Unusable(*unsupported("load over time"), "over", over)
    if over not in variables:
        raise Unusable("the table has no independent variable", f"Write over = one of: {', '.join(variables)}", "over", over)
    check_keys(raw, ("over", "at", "values", "csv"))
    if "csv" in raw and ("at" in raw or "values" in raw):
        raise Unusable("the table is given twice", "Give csv, or at and values, not both", "csv", raw["csv"])
    if "csv" in raw:
        at, values = read_columns(raw, folder, {over: OVER[over], kind: kind}, ordered="rising")
    else:
        columns = []
        for key, of in (("at", OVER[over]), ("values", kind)):
            if not isinstance(raw.get(key), list):
                raise Unusable("the table needs a list here", f"Write {key} = [...], with units", key, raw.get(key))
            columns.append([read_scalar(cell, of, f"{key}[{row}]")[0] for row, cell in enumerate(raw[key])])
        at, values = columns
    if len(at) != len(values) or len(at) < 2:
        raise Unusable(f"at has {len(at)} values, values has {len(values)}", "Give as many, and two or more", "values")
    falls = next((row for row, (a, b) in enumerate(itertools.pairwise(at), start=2) if b <= a), None)
    if falls:
        raise Unusable(f"the rows must rise, and row {falls} does not", "Sort them and remove repeated ones", "at")
    table = LoadTable(over, tuple(at), tuple(values))
    if table.revolutions > MOST_REVOLUTIONS:
        message = f"the table is longer than {MOST_REVOLUTIONS} revolutions: {math.degrees(at[-1] - at[0]):.8g} deg"
        remedy = "A table is one cycle of the machine: give the rows after which the load repeats"
        raise Unusable(message, remedy, "csv" if "csv" in raw else "at")
    return table


# Samples of a machine's motion over a revolution, on which its loads and clearances depend.

STROKES = 720  # positions of a revolution at which the motion of a load is sampled
FULL_TURN = TURN - 0.02  # rad; a sampled swing that is wider is a full turn
_SENSE: dict[Direction | None, float] = {"forward": 1.0, "backward": -1.0, None: 0.0}


class RevolutionSamples:
    """Samples of a machine's motion over a revolution, or the range of its drive, as far as it can be assembled."""

    def __init__(self, machine: Machine, slow: Mapping[str, Direction] | None = None) -> None:
        self.machine, self._slow = machine, slow or {}

    @cached_property
    def moving(self) -> Moving:
        """The machine at evenly spaced crank angles."""
        if (limits := self.machine.mechanism.limits) is not None:
            return self.machine.moving(np.linspace(*limits, STROKES))
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
            bodies = {link.body for link in group.links}
            in_group = [gap for gap in gaps if bodies & {gap.journal, gap.bearing}]
            with np.errstate(all="ignore"):
                gap = group.gap(pose)
            spare = -np.broadcast_to(gap, assembled.shape)[assembled]
            if not in_group or not spare.size or not np.any(spare > 0.0):
                continue
            clearances, least = sum(gap.clearance for gap in in_group), float(np.min(spare))
            if clearances >= least:
                at = float(np.degrees(self.moving.motion.crank_angle[assembled][int(np.argmin(spare))]))
                message = (
                    f"the clearance is too large for the mechanism: at a crank angle of {at:z.0f} deg the group of {group.joint} "
                    f"closes with {least * 1e3:.4g} mm to spare, and its joints have {clearances * 1e3:.4g} mm of clearance"
                )
                raise Unusable(message, "Give a smaller clearance, or other lengths", f"joints.{in_group[0].point}.clearance")

    def _rate(self, load: Load) -> Array:
        """Return the rate of the motion that reverses a load, at every position."""
        velocity = load.reversing(self.moving)
        return np.broadcast_to(velocity[0] if velocity else 0.0, self.moving.motion.assembled.shape)

    def check_moves(self, load: Process) -> None:
        """Refuse a load that opposes a motion that does not exist.

        Raises
        ------
        Unusable
        """
        rates = self._rate(load)
        rates = rates[np.isfinite(rates)]
        moves = np.count_nonzero(np.abs(rates) > 1e-12 * float(np.max(load.extent(self.machine))))
        if rates.size and moves < 0.5 * rates.size:  # near singular positions rounding errors are larger
            message = f"an opposing load needs a motion, but what it opposes does not {load.moves}"
            raise Unusable(message, 'Remove the load, or write acts = "constant"', "acts")

    def slow(self, load: Load) -> Direction:
        """Return the stroke of a load's motion that takes longer at constant counter-clockwise crank speed.

        Raises
        ------
        Unusable
            when both take equally long.
        """
        if self.machine.mechanism.limits is not None:
            message = "slow and quick are strokes of a crank that turns fully, and the drive has a range"
            raise Unusable(message, 'Write stroke = "forward" or "backward"', "stroke")
        if load.name in self._slow:
            return self._slow[load.name]
        sense = self.slow_senses(load)  # many designs share one machine only if they have the same slow stroke
        if np.all(sense > 0.0):
            return "forward"
        if np.all(sense < 0.0):
            return "backward"
        if not np.all(self.moving.motion.assembled):
            message = "the crank does not turn fully, and in the range that it reaches no stroke is the slow one"
            raise Unusable(message, 'Change the dimensions, or write stroke = "forward" or "backward"', "stroke")
        least = f"{math.degrees(LEAST_DIFFERENCE):g} deg"
        message = f"both strokes take equally long (to {least} of crank rotation), so neither stroke is the slow one"
        raise Unusable(message, 'Write stroke = "forward" or "backward", or change the dimensions', "stroke")

    def slow_senses(self, load: Load) -> Array:
        """Return the slow stroke of a load's motion for one or many designs: 1 forward, -1 backward, 0 for equal strokes.

        For one design with full crank rotation the exact crank angles of the reversals are used, else the sampled positions that
        can be reached, with interpolated reversals.
        """
        from optlink.dynamics.strokes import load_strokes, slower

        assembled = self.moving.motion.assembled
        if np.ndim(assembled) == 1 and np.all(assembled):
            return np.array([_SENSE[slower(load_strokes(self.machine, load))]])
        rate = self._rate(load) + np.zeros(STROKES)
        rate = np.concatenate([rate, rate[..., :1]], axis=-1)
        size = np.abs(rate[..., 1:]) + np.abs(rate[..., :-1])
        with np.errstate(all="ignore"):  # 0 / 0 for a design that can be assembled nowhere
            share = (rate[..., 1:] + rate[..., :-1]) / size
            difference = self.machine.mechanism.cycle * np.nansum(share, axis=-1) / np.sum(np.isfinite(share), axis=-1)
        sense = np.where(np.abs(difference) >= LEAST_DIFFERENCE, np.sign(difference), 0.0)
        return np.asarray(sense, dtype=float).reshape(-1)

    def middle(self, body: str, against: str, free: float) -> Value:
        """Return the middle of the swing of a body relative to another [rad], within half a revolution of an angle.

        A number, or an array (designs, 1) if the swing differs from design to design.

        Parameters
        ----------
        body, against : str
            Names of the bodies.
        free : float [rad]
            The angle.

        Raises
        ------
        Unusable
            when the body makes a full turn, as no torsion spring allows, in any design.
        """
        low, high = self._swing(body, against)
        if np.any(high - low > FULL_TURN):
            message = f"{body} turns fully against {against}, so a torsion spring cannot connect them"
            raise Unusable(message, "Use torsional_damping, or a spring between two points", "on")
        middle = 0.5 * (low + high)
        return _per_design(np.where(np.isnan(middle), free, _near(middle, free)))

    def branch(self, body: str) -> Value:
        """Return the middle [rad] of the swing of a body, from -180 to 180 deg; 0 for one that turns fully.

        A number, or an array (designs, 1) if the swing differs from design to design. It is a swing's middle too that does not
        cross 180 deg: that of a similar design, for which it serves as well, may do so.
        """
        low, high = self._swing(body, FRAME)
        return _per_design(np.where(high - low <= FULL_TURN, _near(0.5 * (low + high), 0.0), 0.0))

    def _swing(self, body: str, against: str) -> tuple[Array, Array]:
        """Return the ends [rad] of the swing of a body relative to another, of each design; NaN: no position is reached.

        If every position of a revolution is reached, the first one is also the last one, so that a full turn counts as one.
        """
        around = self.machine.mechanism.limits is None
        one, other = (self.moving.state(name).axis for name in (body, against))
        angle = np.asarray(np.arctan2(cross(other, one), dot(other, one)) + 0.0 * self.moving.motion.crank_angle)
        closed = [np.append(row, row[0]) if around and all_finite(row) else row[np.isfinite(row)] for row in np.atleast_2d(angle)]
        reached = [np.unwrap(row) for row in closed]
        ends = np.array([[np.min(swing), np.max(swing)] if swing.size else [np.nan, np.nan] for swing in reached])
        low, high = ends.T.reshape(2, *np.shape(angle)[:-1])
        return low, high


def _near(angle: Array, reference: float) -> Array:
    """Return angles less whole revolutions: at most half a revolution from a reference, ahead of it in the case of a tie."""
    return angle - TURN * np.ceil((angle - reference) / TURN - 0.5 - 1e-9)


def _per_design(values: Array) -> Value:
    """Return the value of one design as a number, those of many designs as an array (designs, 1)."""
    return values[:, None] if values.ndim else float(values)


def _value(quantity: Quantity | None) -> float:
    return 0.0 if quantity is None else quantity.value


# Kinds of loads: one model and one entry of the registry for each. The key that marks a kind is in no other table.


class LoadSection(Section):
    """A load; its keys determine its kind."""

    @classmethod
    def models(cls) -> dict[str, type[Section]]:
        """Return the models of the registered kinds by the keys that mark them, of which the first in a table counts."""
        return {name: kind.form for name, kind in LOADS.items()} if cls is LoadSection else super().models()

    @model_validator(mode="wrap")
    @classmethod
    def _of_kind(cls, raw: Any, handler: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        """Read a table with the model of its kind."""
        if cls is not LoadSection or not isinstance(raw, Mapping):
            return handler(raw)
        kind = kind_of(raw)
        known = {key for one in LOADS.values() for key in one.form.model_fields}
        if kind is None and known.issuperset(raw):
            others = ", ".join(name for name in LOADS if name != "force")
            raise Unusable("the load has no magnitude", f'Give force = "1000 N", or one of: {others}', "force")
        if kind is None:
            return handler(without(raw, *known))
        keys = set(kind.form.model_fields)
        if wrong := sorted(known & set(raw) - keys):
            possible = ", ".join(sorted(keys - {kind.name}))
            raise Unusable(f"a load with {kind.name} has no {wrong[0]}", f"Possible:  {possible}", wrong[0])
        return kind.form.model_validate(raw, context=info.context)  # type: ignore[return-value]

    @property
    def kind(self) -> str:
        """The key that marks its kind."""
        return next(name for name, kind in LOADS.items() if kind.form is type(self))

    @property
    def by_pace(self) -> bool:
        """Whether the dimensions determine its direction: it acts in the slow or in the quick stroke."""
        return False

    @property
    def words(self) -> str:
        """What the file states of it, for tables."""
        keys = dict.fromkeys(("on", *type(self).__annotations__, *type(self).model_fields))
        stated = ((key, getattr(self, key)) for key in keys if key in self.model_fields_set)
        return ", ".join(f"{key} {'-'.join(value) if isinstance(value, tuple) else value}" for key, value in stated)

    def build(self, name: str, mechanism: Mechanism, motion: RevolutionSamples) -> Load:
        """Return the load of a machine.

        Parameters
        ----------
        name : str
            Of the load.
        mechanism : Mechanism
            With the bodies and points that the keys name.
        motion : RevolutionSamples
            Motion over a revolution, which decides on strokes and angles.

        Raises
        ------
        Unusable
            With the key below the load.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class LoadKind(Entry):
    """A kind of load: the tables of `[loads]` with its key.

    Parameters
    ----------
    name : str
        The key, by which a table is known to be of this kind.
    form : type of LoadSection
        Its keys, and how the load is built from them.
    """

    name: str
    form: type[LoadSection]

    def fault(self) -> tuple[str, str] | None:
        """Refuse a form without the key, and one with the key of another kind, whose tables would be taken for that."""
        if self.name not in self.form.model_fields:
            return f"its form has no key {self.name}", "Give the form a field of this name"
        if taken := next((key for key in self.form.model_fields if key in self.registry), None):
            return f"the key {taken} of its form marks another kind of load", "Choose another name for the key"
        return None


LOADS: dict[str, LoadKind] = LoadKind.registry


def kind_of(table: Mapping[str, Any]) -> LoadKind | None:
    """Return the kind of a load by the keys of its table: of several that mark a kind the first registered one counts."""
    return next((kind for name, kind in LOADS.items() if name in table), None)


class OnBody(LoadSection):
    """A load on a body."""

    on: str | None = None
    """The body on which the load acts."""

    def body(self, mechanism: Mechanism) -> str:
        """Return the body on which it acts.

        Parameters
        ----------
        mechanism : Mechanism

        Raises
        ------
        Unusable
            If there is none of this name.
        """
        if self.on is None:
            raise Unusable("the load has no body to act on", 'Name a body: on = "slider"', "on")
        check_name(self.on, mechanism.bodies, "no such body", "on")
        return self.on


class _Between(OnBody):
    """A load on a body with its reaction on another."""

    against: str | None = None
    """The body on which the reaction of the load acts; default: the frame."""

    def taking(self, mechanism: Mechanism) -> str:
        """Return the body on which the reaction acts."""
        if self.against not in (None, FRAME):
            check_name(self.against, mechanism.bodies, "no such body", "against")
            if self.against == self.on:
                raise Unusable("a load does not act against itself", "Name another body, or frame", "against", self.against)
        return self.against or FRAME


class _Stroked(_Between):
    """A force or torque that may act in one stroke, and against the motion."""

    acts: Literal["constant", "opposing"] = "constant"
    """`constant`: in a fixed direction; `opposing`: against the motion."""
    stroke: Literal["both", "forward", "backward", "slow", "quick"] = "both"
    """Stroke in which the load acts; forward is along the guide, or counter-clockwise."""

    @property
    def by_pace(self) -> bool:
        """Whether the dimensions determine its direction: it acts in the slow or in the quick stroke."""
        return self.stroke in ("slow", "quick")

    def in_stroke(self, load: Process, motion: RevolutionSamples) -> Load:
        """Return the load in its stroke: of the slow or quick stroke that of a crank that turns counter-clockwise."""
        load = replace(load, opposing=self.acts == "opposing")
        if load.opposing or self.stroke != "both":
            motion.check_moves(load)
        if self.stroke == "slow" or self.stroke == "quick":
            slow = motion.slow(load)
            return replace(load, stroke=slow if self.stroke == "slow" else OTHER[slow], turning=True)
        return replace(load, stroke=self.stroke)


def _point_of(body: str, at: str | None, mechanism: Mechanism) -> tuple[str, str]:
    """Return the point of a body at which a force acts, and the guide (or "") of the body."""
    guide, link = next((g for g in mechanism.guides if g.slider == body), None), mechanism.bodies[body]
    if at is not None:
        points = [point for point, bodies in mechanism.owners.items() if body in bodies]
        check_name(at, points, "the body has no such point", "at")
    elif link.end and guide is None:
        raise Unusable("the force has no point", f"Add at, one of: {link.start}, {link.end} or another", "at")
    return at or (guide and guide.at) or link.start, guide.name if guide else ""


class ForceLoad(_Stroked):
    """A force on a point of a body."""

    at: str | None = None
    """Point of that body where the force acts; default: the point of a slider on its guide."""
    force: Annotated[Any, in_folder(partial(read_size, kind="force", names=VARIABLES))]
    """Magnitude of the force: a quantity, a table over phi, omega, s or v, or an expression."""
    direction: FixedAngle | None = None
    """Direction of the force, from +x; default: along the guide of a slider."""

    def build(self, name: str, mechanism: Mechanism, motion: RevolutionSamples) -> Load:
        """Return the force."""
        body = self.body(mechanism)
        point, guide = _point_of(body, self.at, mechanism)
        if self.direction is None and not guide:
            raise Unusable("the force has no direction", 'Add direction = "90 deg" (from +x)', "direction")
        if self.force.names & {"s", "v"} and self.direction is not None:
            raise Unusable("s and v are those of a slider along its guide", "Leave direction out, or use phi", "force")
        direction = guide if self.direction is None else self.direction.value
        return self.in_stroke(Force(name, body, point, self.force, direction, against=self.taking(mechanism)), motion)


class TorqueLoad(_Stroked):
    """A torque on a body."""

    torque: Annotated[Any, in_folder(partial(read_size, kind="torque", names=("phi", "omega", "theta", "w")))]
    """Magnitude of the torque: a quantity, a table over phi or omega, or an expression."""

    def build(self, name: str, mechanism: Mechanism, motion: RevolutionSamples) -> Load:
        """Return the torque."""
        body = self.body(mechanism)
        against, middle = self.taking(mechanism), motion.branch(body) if "theta" in self.torque.names else 0.0
        return self.in_stroke(Torque(name, body, self.torque, middle, against=against), motion)


class GasSection(Section):
    """Gas that pushes with its pressure on an area: in the cylinder of an engine or compressor, or in a gas spring."""

    pressure: Annotated[Any, in_folder(partial(read_size, kind="pressure", names=VARIABLES))]
    """Pressure: constant, a table over phi, s or v, or an expression; with a `volume` that where the gas has this volume."""
    bore: FixedLength
    """Diameter of the area; of a gas spring, whose gas is on both sides of the piston, that of the rod."""
    pushes: Literal["forward", "backward"] = "forward"
    """Way of the force: forward is along the guide, or drives two points apart."""
    ambient: Annotated[Quantity, reader(read_positive, "pressure")] = Quantity(0.0, "pressure", "bar")
    """Pressure on the other side; default: 0, if `pressure` is that above the ambient one."""
    volume: Annotated[Quantity, reader(read_positive, "volume")] | None = None
    """Enclosed volume, which changes with the motion: pressure * volume^exponent is constant."""
    at: Annotated[Quantity, reader(read_fixed, "coordinate")] = Quantity(0.0, "coordinate", "mm")
    """Slide, or distance of the two points, at which the gas has this volume."""
    exponent: Annotated[Number, where(lambda n: 1.0 <= n <= 2.0, "an exponent lies between 1 and 2", "Give 1.4 for air")] = 1.4
    """Polytropic exponent: 1 for a constant temperature; default: 1.4, without exchange of heat."""

    def __str__(self) -> str:
        return f"of {self.pressure} on {self.bore}"

    @property
    def lever(self) -> float:
        """Force per pressure [m^2], with its sign."""
        return (-0.25 if self.pushes == "backward" else 0.25) * math.pi * self.bore.value**2

    def force(self) -> Size:
        """Return the force [N].

        Raises
        ------
        Unusable
            with the key below the gas.
        """
        outside = -self.lever * self.ambient.value
        size: Size = self.pressure.scaled(self.lever, outside)
        if self.volume is None:
            return size
        if size.names:
            message = "the pressure of an enclosed volume follows from the motion"
            raise Unusable(message, "Leave volume out, or give the pressure at this volume", "pressure", str(self.pressure))
        grown = f"({self.volume.value!r} + ({self.lever!r})*(s - ({self.at.value!r})))"
        return _formula(f"({size({}) - outside!r})*({self.volume.value!r}/{grown})^{self.exponent!r} + ({outside!r})")

    def check(self, place: Callable[[], Value]) -> None:
        """Check that an enclosed volume stays positive at slides or distances [m], which are computed if there is one.

        Raises
        ------
        Unusable
            with the key below the gas.
        """
        if self.volume is not None:
            least = float(np.nanmin(self.volume.value + self.lever * (np.asarray(place()) - self.at.value)))
            if least <= 0.0:
                message = f"the volume of the gas would fall to {1e6 * least:.4g} cm^3"
                raise Unusable(message, "Give a larger volume, or the place at which it is this one", "volume", str(self.volume))


class GasLoad(_Between):
    """The force of a gas on a slider, along its guide."""

    at: str | None = None
    """Point of the slider where the force acts; default: that on its guide."""
    gas: GasSection
    """The pressure of the gas."""

    def build(self, name: str, mechanism: Mechanism, motion: RevolutionSamples) -> Load:
        """Return the force of the gas."""
        with below("gas"):
            push = self.gas.force()
        body = self.body(mechanism)
        point, guide = _point_of(body, self.at, mechanism)
        if not guide:
            raise Unusable("the gas has no direction", "Name a slider, or two points: between = [...]", "on", body)
        against = self.taking(mechanism)
        with below("gas"):
            self.gas.check(lambda: motion.moving.slides[guide][0])
        return Force(name, body, point, push, guide, against=against)


def spring_ends(mechanism: Mechanism, between: tuple[str, str]) -> list[tuple[str, str]]:
    """Return body and point of both ends of a spring or damper between two points.

    Raises
    ------
    Unusable
        when a point does not exist, or both are on one body.
    """
    for point in between:
        check_name(point, mechanism.owners, "no such point", "between")
    one, other = (mechanism.owners[point] for point in between)
    if set(one) & set(other):
        raise Unusable("both ends are on one body", "Name two points of different bodies", "between", list(between))
    return [(one[0], between[0]), (other[0], between[1])]


class SpringLoad(LoadSection):
    """A spring, damper, gas spring or other force between two points."""

    between: tuple[str, str]
    """The two points that it connects."""
    stiffness: Stiffness | None = None
    """Stiffness of the spring."""
    free_length: FixedLength | None = None
    """Free length of the spring; default: 0."""
    damping: Damping | None = None
    """Viscous damping."""
    force: Annotated[Any, in_folder(partial(read_size, kind="force", names=VARIABLES))] = None
    """Force that drives the two points apart: a quantity, or a table or expression over their distance s and its rate v."""
    gas: GasSection | None = None
    """Instead of a force: the pressure of a gas."""

    def build(self, name: str, mechanism: Mechanism, motion: RevolutionSamples) -> Load:
        """Return the spring."""
        push = self.force
        if push is not None and self.gas is not None:
            raise Unusable("the load has a force and a gas", "Give one of the two, or two loads", "gas")
        if self.gas is not None:
            with below("gas"):
                push = self.gas.force()
        if push is None and self.stiffness is None and self.damping is None:
            raise Unusable("a spring needs a stiffness", 'Add stiffness = "500 N/m" or damping = "20 N*s/m"', "stiffness")
        one, other = spring_ends(mechanism, self.between)
        if push is not None and not push.names <= {"s", "v"}:
            message = "a force between two points depends on their distance s and its rate v"
            raise Unusable(message, "Give a quantity, or a table or expression over s or v", "force" if self.force else "gas")
        spring = Spring(name, (one, other), _value(self.stiffness), _value(self.free_length), _value(self.damping), push)
        if self.gas is not None:
            with below("gas"):
                self.gas.check(lambda: spring.length(motion.moving))
        return spring


class TorsionDamperLoad(_Between):
    """Viscous damping of a rotation."""

    torsional_damping: TorsionalDamping
    """Viscous damping of the rotation of `on` relative to `against`."""

    def build(self, name: str, mechanism: Mechanism, motion: RevolutionSamples) -> Load:
        """Return the damper."""
        return TorsionSpring(name, self.body(mechanism), self.taking(mechanism), 0.0, 0.0, self.torsional_damping.value)


class TorsionSpringLoad(_Between):
    """A torsion spring between two bodies."""

    torsional_stiffness: TorsionalStiffness
    """Stiffness of a torsion spring between `on` and `against`."""
    free_angle: FixedAngle | None = None
    """Free angle of the spring; default: 0."""
    torsional_damping: TorsionalDamping | None = None
    """Viscous damping of the rotation of `on` relative to `against`."""

    def build(self, name: str, mechanism: Mechanism, motion: RevolutionSamples) -> Load:
        """Return the spring."""
        body, against = self.body(mechanism), self.taking(mechanism)
        stiffness, free = self.torsional_stiffness.value, _value(self.free_angle)
        middle = motion.middle(body, against, free) if stiffness else 0.0
        return TorsionSpring(name, body, against, stiffness, free, _value(self.torsional_damping), middle)


class GuideDamperLoad(OnBody):
    """Viscous damping in a guide."""

    damping: Damping
    """Viscous damping of the slider `on` in its guide."""

    def build(self, name: str, mechanism: Mechanism, motion: RevolutionSamples) -> Load:
        """Return the damper."""
        body = self.body(mechanism)
        slot = next((guide for guide in mechanism.guides if guide.slider == body), None)
        if slot is None:
            message = "damping without two points applies to a body in a guide only"
            raise Unusable(message, "Name a slider, or two points: between = [...]", "on", body)
        return SlideDamper(name, slot.name, body, slot.on, slot.at or mechanism.bodies[body].start, self.damping.value)


register(
    LoadKind("between", SpringLoad),
    LoadKind("gas", GasLoad),
    LoadKind("force", ForceLoad),
    LoadKind("torque", TorqueLoad),
    LoadKind("torsional_stiffness", TorsionSpringLoad),
    LoadKind("torsional_damping", TorsionDamperLoad),
    LoadKind("damping", GuideDamperLoad),
)
