"""Masses, loads and the drive of a problem file, read and turned into those of a machine."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from pydantic import BeforeValidator, Field, ValidationInfo, field_validator

from optlink.design.expression import Expression, LawError, parse
from optlink.design.law import read_columns
from optlink.design.quantity import (
    Damping,
    Duration,
    FixedAngle,
    FixedLength,
    Mass,
    Number,
    Quantity,
    Speed,
    Stiffness,
    TorsionalDamping,
    TorsionalStiffness,
    Unusable,
    nearest,
    read_fixed,
    read_positive,
    read_scalar,
)
from optlink.design.section import Section
from optlink.dynamics.inertia import Inertia
from optlink.dynamics.loads import Force, Load, SlideDamper, Spring, Stroke, Torque, TorsionSpring
from optlink.linkage.elementwise import Value
from optlink.linkage.mechanism import FRAME, Mechanism
from optlink.units import UnitProblem, factor

OVER = {"phi": "angle", "s": "coordinate", "omega": "angular velocity"}
"""What a table of forces may run over: crank angle, slider position, crank speed."""


# --- magnitudes -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Constant:
    """The same everywhere; `text` as written."""

    value: float
    text: str

    def __str__(self) -> str:
        return self.text

    def __call__(self, known: Mapping[str, Value]) -> Value:
        """The value [SI]."""
        return self.value


@dataclass(frozen=True)
class Formula:
    """An expression, in a unit of `size` SI."""

    expression: Expression
    unit: str
    size: float

    def __str__(self) -> str:
        return f"{self.expression.text} [{self.unit}]"

    def __call__(self, known: Mapping[str, Value]) -> Value:
        """The value [SI]."""
        return self.expression(known) * self.size


@dataclass(frozen=True)
class Curve:
    """A table over one variable, straight between its rows; over the crank angle it repeats every turn, else its ends go on."""

    over: str
    at: tuple[float, ...]
    values: tuple[float, ...]

    def __str__(self) -> str:
        return f"a table over {self.over}, {len(self.at)} rows"

    def __call__(self, known: Mapping[str, Value]) -> Value:
        """The value [SI]."""
        period = 2.0 * np.pi if self.over == "phi" else None
        return np.interp(np.asarray(known[self.over], dtype=float), self.at, self.values, period=period)


Size = Constant | Formula | Curve


def read_size(raw: object, kind: str, names: Iterable[str], folder: Path) -> Size:
    """Read a force or torque: a quantity, an expression with its unit, or a table over phi, s or omega."""
    if isinstance(raw, Constant | Formula | Curve):
        return raw
    if not isinstance(raw, dict):
        return Constant(read_scalar(raw, kind)[0], " ".join(str(raw).split()))
    known = [name for name in names if name in OVER]
    if "expression" in raw:
        for key in raw:
            if key not in ("expression", "unit"):
                raise Unusable("unknown key", nearest(str(key), ("expression", "unit")), str(key))
        if not isinstance(raw["expression"], str):
            raise Unusable("an expression is text", 'Write expression = "1000 + 200*sin(phi)"', "expression", raw["expression"])
        try:
            expression = parse(raw["expression"], names)
        except LawError as error:
            raise Unusable(error.message, error.remedy, "expression", raw["expression"]) from None
        unit = raw.get("unit")
        if not isinstance(unit, str):
            raise Unusable(
                "an expression gives a plain number", f'Add its unit: unit = "{"N" if kind == "force" else "N*m"}"', "unit", unit
            )
        try:
            return Formula(expression, unit, factor(unit, kind))
        except UnitProblem as problem:
            raise Unusable(problem.message, problem.remedy, "unit", unit) from None
    over = raw.get("over")
    if over not in known:
        raise Unusable("a table needs what it runs over", f"Write over = one of: {', '.join(known)}", "over", over)
    for key in raw:
        if key not in ("over", "at", "values", "csv"):
            raise Unusable("unknown key", nearest(str(key), ("over", "at", "values", "csv")), str(key))
    if "csv" in raw and ("at" in raw or "values" in raw):
        raise Unusable("the table is given twice", "Give csv, or at and values, not both", "csv", raw["csv"])
    if "csv" in raw:
        if not isinstance(raw["csv"], str) or "\0" in raw["csv"]:
            raise Unusable("expected the name of a CSV file", 'Write csv = "force.csv"', "csv", raw["csv"])
        at, values = read_columns(folder / raw["csv"], {str(over): OVER[str(over)], kind: kind})
    else:
        columns = []
        for key, of in (("at", OVER[str(over)]), ("values", kind)):
            if not isinstance(raw.get(key), list):
                raise Unusable("the table needs a list here", f"Write {key} = [...], with units", key, raw.get(key))
            columns.append([read_scalar(cell, of, f"{key}[{row}]")[0] for row, cell in enumerate(raw[key])])
        at, values = columns
    if len(at) != len(values) or len(at) < 2:
        raise Unusable(f"at has {len(at)} values, values has {len(values)}", "Give as many, and two or more", "values")
    falls = next((row for row, (a, b) in enumerate(itertools.pairwise(at), start=2) if b <= a), None)
    if falls:
        raise Unusable(f"the rows must rise, and row {falls} does not", "Sort them and remove repeated ones", "at")
    if over == "phi" and at[-1] - at[0] > 2.0 * math.pi * (1.0 + 1e-12):
        raise Unusable("the table is longer than one revolution", "It repeats every revolution: give one", "at")
    return Curve(str(over), tuple(at), tuple(values))


# --- bodies and joints ------------------------------------------------------------------------------------------------


def _read_centroid(raw: object) -> Any:
    if isinstance(raw, str | tuple):
        return raw
    if not isinstance(raw, list) or len(raw) != 2:
        raise Unusable("a centroid is a point of the body", 'Write "middle", a point, or ["100 mm", "0 mm"]', "", raw)
    return tuple(read_fixed(part, "coordinate") for part in raw)


def _read_moment(raw: object) -> Any:
    return raw if raw == "uniform bar" else read_positive(raw, "moment of inertia")


class BodySection(Section):
    """Mass properties of a body: mass, centroid in its own axes, moment of inertia about the centroid."""

    mass: Mass
    centroid: Annotated[Any, BeforeValidator(_read_centroid)] = None
    inertia: Annotated[Any, BeforeValidator(_read_moment)] = None

    def inertia_of(self, body: str, mechanism: Mechanism, sizes: Mapping[str, Value]) -> Inertia:
        """Mass properties for given sizes [SI].

        Raises
        ------
        Unusable
            naming the key below the body, when no body can be so.
        """
        link, mass = mechanism.bodies[body], self.mass.value
        length = (sizes[link.length] if isinstance(link.length, str) else link.length) if link.end else 0.0
        along: Value = 0.5 * length
        across: Value = 0.0
        if isinstance(self.centroid, tuple):
            along, across = (part.value for part in self.centroid)
        elif self.centroid not in (None, "middle"):
            own = [point for point, bodies in mechanism.owners.items() if body in bodies]
            if self.centroid not in own:
                raise Unusable("the body has no such point", nearest(self.centroid, ["middle", *own]), "centroid", self.centroid)
            if self.centroid == link.start:
                along = 0.0
            elif self.centroid == link.end:
                along = length
            else:
                mark = mechanism.marks[body, self.centroid]
                along, across = (sizes[part] if isinstance(part, str) else part for part in (mark.along, mark.across))
        if self.inertia == "uniform bar":
            if not link.end:
                raise Unusable("only a link with two joints is a bar", 'Write inertia = "0.016 kg*m^2"', "inertia", self.inertia)
            moment: Value = mass * length * length / 12.0
        elif self.inertia is None:
            if mass > 0.0 and link.end:
                example = f'inertia = "{mass * float(np.max(length)) ** 2 / 12.0:.3g} kg*m^2", or "uniform bar"'
                raise Unusable("a link with a mass has a moment of inertia about its centroid", f"Add {example}", "inertia")
            moment = 0.0
        else:
            moment = self.inertia.value
        if mass == 0.0 and np.any(np.asarray(moment) > 0.0):
            raise Unusable(
                "a body without mass has no moment of inertia",
                "Give it a mass, or take inertia out",
                "inertia",
                str(self.inertia),
            )
        return Inertia(mass, along, across, moment)


class JointSection(Section):
    """A joint: `on` is the body whose reaction is told."""

    on: str | None = None


# --- loads ------------------------------------------------------------------------------------------------------------


class Samples(Protocol):
    """What a load must know of the motion of its machine."""

    def slow(self, load: Load) -> Stroke:
        """Which stroke of a load's motion takes longer."""
        ...

    def check_moves(self, load: Load) -> None:
        """Refuse a load that opposes a motion that does not exist."""
        ...

    def middle(self, body: str, against: str, free: float) -> float:
        """The midst of the swing of a body against another [rad], at most half a turn from `free`."""
        ...


class LoadSection(Section):
    """A load; which keys it has says what it is."""

    on: str | None = None
    at: str | None = None
    force: Any = None
    torque: Any = None
    direction: FixedAngle | None = None
    acts: Literal["constant", "opposing"] = "constant"
    stroke: Literal["both", "forward", "backward", "slow", "fast"] = "both"
    between: tuple[str, str] | None = None
    against: str | None = None
    stiffness: Stiffness | None = None
    free_length: FixedLength | None = None
    damping: Damping | None = None
    torsional_stiffness: TorsionalStiffness | None = None
    free_angle: FixedAngle | None = None
    torsional_damping: TorsionalDamping | None = None

    @field_validator("force", "torque", mode="before")
    @classmethod
    def _size(cls, raw: object, info: ValidationInfo) -> Size | None:
        if raw is None:
            return None
        names = ("phi", "omega", "s", "v") if info.field_name == "force" else ("phi", "omega", "theta", "w")
        return read_size(raw, str(info.field_name), names, (info.context or {}).get("folder", Path()))

    def build(self, name: str, mechanism: Mechanism, motion: Samples) -> Load:
        """The load of a machine; `motion` are samples of it over a revolution.

        Raises
        ------
        Unusable
            naming the key below the load.
        """
        self._check_keys()
        if self.force is not None:
            body, point, guide = self._target(mechanism)
            direction: float | str | None = None if self.direction is None else self.direction.value
            if direction is None:
                if not guide:
                    raise Unusable("the force has no direction", 'Add direction = "90 deg" (from +x)', "direction")
                direction = guide
            if isinstance(self.force, Formula) and self.force.expression.names & {"s", "v"} and not isinstance(direction, str):
                raise Unusable("s and v are those of a slider along its guide", "Leave direction out, or use phi", "force")
            if isinstance(self.force, Curve) and self.force.over == "s" and not isinstance(direction, str):
                raise Unusable("s is the position of a slider along its guide", "Leave direction out, or use phi", "force")
            load = Force(name, body, point, self.force, direction, self.acts == "opposing")
            self._check_against(mechanism)
            return replace(load, against=self.against or FRAME, **self._stroke(load, motion))
        if self.torque is not None:
            body = self._body(mechanism, self.on, "on")
            twist = Torque(name, body, self.torque, self.acts == "opposing")
            self._check_against(mechanism)
            twist = replace(twist, against=self.against or FRAME)
            return replace(twist, **self._stroke(twist, motion))
        if self.between is not None:
            ends = []
            for point in self.between:
                if point not in mechanism.owners:
                    raise Unusable("no such point", nearest(point, mechanism.owners), "between", point)
                ends.append((mechanism.owners[point][0], point))
            if self.between[0] == self.between[1] or set(mechanism.owners[ends[0][1]]) & set(mechanism.owners[ends[1][1]]):
                raise Unusable("both ends are on one body", "Name two points of different bodies", "between", list(self.between))
            stiffness, damping = (0.0 if x is None else x.value for x in (self.stiffness, self.damping))
            return Spring(name, (ends[0], ends[1]), stiffness, self.free_length.value if self.free_length else 0.0, damping)
        if self.torsional_stiffness is not None or self.torsional_damping is not None:
            body = self._body(mechanism, self.on, "on")
            self._check_against(mechanism)
            against = self.against or FRAME
            stiffness, free, damping = (
                0.0 if x is None else x.value for x in (self.torsional_stiffness, self.free_angle, self.torsional_damping)
            )
            middle = motion.middle(body, against, free) if stiffness else 0.0
            return TorsionSpring(name, body, against, stiffness, free, damping, middle)
        if not any(guide.slider == self.on for guide in mechanism.guides):
            self._body(mechanism, self.on, "on")
            raise Unusable("only a body in a guide is damped so", "Name a slider, or two points: between = [...]", "on", self.on)
        _, _, guide = self._target(mechanism)
        known = next(g for g in mechanism.guides if g.name == guide)
        assert self.damping is not None
        return SlideDamper(
            name, guide, known.slider, known.on, known.at or mechanism.bodies[known.slider].start, self.damping.value
        )

    def _check_keys(self) -> None:
        """Keys that say nothing together."""
        given = {key for key in self.model_fields_set if getattr(self, key) is not None}
        kinds: dict[str, set[str]] = {
            "force": {"on", "at", "direction", "acts", "stroke", "against"},
            "torque": {"on", "acts", "stroke", "against"},
            "between": {"stiffness", "free_length", "damping"},
            "torsional_stiffness": {"on", "against", "free_angle", "torsional_damping"},
            "torsional_damping": {"on", "against"},
            "damping": {"on"},
        }
        kind = next((kind for kind in kinds if kind in given), None)
        if kind is None:
            raise Unusable(
                "the load has no size",
                'Give force = "1000 N", torque = "5 N*m", between = [...] with stiffness, or damping',
            )
        wrong = sorted(given - kinds[kind] - {kind})
        if wrong:
            raise Unusable(f"a load with {kind} has no {wrong[0]}", f"It may have: {', '.join(sorted(kinds[kind]))}", wrong[0])
        if kind == "between" and not {"stiffness", "damping"} & given:
            raise Unusable("a spring needs a stiffness", 'Add stiffness = "500 N/m" or damping = "20 N*s/m"', "stiffness")
        if kind != "between" and "on" not in given:
            raise Unusable("the load acts on nothing", 'Name a body: on = "slider"', "on")

    def _body(self, mechanism: Mechanism, body: str | None, key: str) -> str:
        if body not in mechanism.bodies:
            raise Unusable("no such body", nearest(str(body), mechanism.bodies), key, body)
        return str(body)

    def _target(self, mechanism: Mechanism) -> tuple[str, str, str]:
        """Body, point and guide (or "") of a force."""
        body = self._body(mechanism, self.on, "on")
        guide = next((g for g in mechanism.guides if g.slider == body), None)
        link = mechanism.bodies[body]
        if self.at is None:
            if link.end and guide is None:
                raise Unusable("the force has no point", f"Add at, one of: {link.start}, {link.end} or another", "at")
            point = (guide.at if guide else "") or link.start
        else:
            own = [point for point, bodies in mechanism.owners.items() if body in bodies]
            if self.at not in own:
                raise Unusable("the body has no such point", nearest(self.at, own), "at", self.at)
            point = self.at
        return body, point, guide.name if guide else ""

    def _check_against(self, mechanism: Mechanism) -> None:
        if self.against not in (None, FRAME):
            self._body(mechanism, self.against, "against")
            if self.against == self.on:
                raise Unusable("a load does not act against itself", "Name another body, or frame", "against", self.against)

    def _stroke(self, load: Force | Torque, motion: Samples) -> dict[str, Any]:
        """In which stroke it acts, and whether that goes with the sense of the crank."""
        if load.opposing or self.stroke != "both":
            motion.check_moves(load)
        if self.stroke not in ("slow", "fast"):
            return {"stroke": self.stroke}
        found = motion.slow(load)
        other: dict[Stroke, Stroke] = {"forward": "backward", "backward": "forward"}
        return {"stroke": found if self.stroke == "slow" else other[found], "turning": True}


# --- the drive --------------------------------------------------------------------------------------------------------


class DriveSection(Section):
    """What drives the machine: at a constant speed, or (for `simulate`) by a torque or motor curve."""

    body: str | None = None
    start: FixedAngle = Quantity(0.0, "angle", "deg")
    speed: Speed = Quantity(1.0, "angular velocity", "rad/s")
    torque: Any = None
    initial_speed: Speed | None = None
    duration: Duration | None = None
    fluctuation: Number | None = None

    @field_validator("body", mode="before")
    @classmethod
    def _one(cls, raw: object) -> object:
        if isinstance(raw, list):
            raise Unusable("one body is driven, the others follow", 'Name one: body = "crank"', "", raw)
        return raw

    @field_validator("torque", mode="before")
    @classmethod
    def _size(cls, raw: object, info: ValidationInfo) -> Size | None:
        if raw is None:
            return None
        return read_size(raw, "torque", ("phi", "omega"), (info.context or {}).get("folder", Path()))

    @field_validator("speed", mode="after")
    @classmethod
    def _turns(cls, speed: Quantity) -> Quantity:
        if speed.value == 0.0:
            raise Unusable("the crank stands still", 'Give a speed, for statics a low one such as "0.01 rpm"', "", str(speed))
        return speed

    @field_validator("fluctuation", mode="after")
    @classmethod
    def _small(cls, share: float | None) -> float | None:
        if share is not None and not 0.0 < share < 2.0:
            raise Unusable("out of range", "Give the share of the mean speed by which it may vary, for example 0.02", "", share)
        return share


def read_gravity(raw: object) -> Any:
    """Gravity: a value along -y, or two components."""
    if isinstance(raw, tuple):
        return raw
    if isinstance(raw, list):
        if len(raw) != 2:
            raise Unusable("gravity has two components", 'Write "9.81 m/s^2" (downwards) or ["0 m/s^2", "-9.81 m/s^2"]', "", raw)
        return tuple(read_fixed(part, "acceleration").value for part in raw)
    return 0.0, -read_fixed(raw, "acceleration").value


Gravity = Annotated[Any, BeforeValidator(read_gravity)]
Bodies = Annotated[dict[str, BodySection], Field(default_factory=dict)]
