"""Mass properties, gravity and drive of a problem file."""

from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BeforeValidator, model_validator

from optlink.dynamics.inertia import Inertia
from optlink.linkage.mechanism import Mechanism, Pose
from optlink.linkage.vector2d import Value
from optlink.problem.base_model import Section, in_folder
from optlink.problem.machine.control import ServoSection
from optlink.problem.machine.load_curves import read_size
from optlink.problem.quantity import (
    Duration,
    FixedAngle,
    Mass,
    Number,
    Quantity,
    Speed,
    Unusable,
    check_name,
    check_pair,
    read_fixed,
    read_positive,
    where,
)
from optlink.units import measures
from optlink.unsupported import unsupported

# --- bodies ----------------------------------------------------------------------------------------------------------


def _read_centroid(raw: object) -> Any:
    if isinstance(raw, str):
        return raw
    parts = check_pair(raw, "a centroid is a point of the body", 'Write "middle", a point, or ["100 mm", "0 mm"]')
    return tuple(read_fixed(part, "coordinate") for part in parts)


def _read_moment(raw: object) -> Any:
    return raw if raw == "uniform bar" else read_positive(raw, "moment of inertia")


class BodySection(Section):
    """Mass properties of a body: mass, centroid in its own axes, moment of inertia about the centroid."""

    mass: Mass
    """Mass of the body."""
    centroid: Annotated[Any, BeforeValidator(_read_centroid)] = None
    """`middle`, a point of the body, or coordinates along and across; default: the middle, or the only joint."""
    inertia: Annotated[Any, BeforeValidator(_read_moment)] = None
    """Moment of inertia about the centroid, or `uniform bar`; required for a link with a mass."""

    def inertia_of(self, body: str, mechanism: Mechanism, sizes: Mapping[str, Value]) -> Inertia:
        """Return the mass properties of a body for given dimensions of the mechanism [m, rad].

        Raises
        ------
        Unusable
            when the properties are inconsistent, with the key below the body.
        """
        link, mass = mechanism.bodies[body], self.mass.value
        length = (sizes[link.length] if isinstance(link.length, str) else link.length) if link.end else 0.0
        along: Value = 0.5 * length
        across: Value = 0.0
        if isinstance(self.centroid, tuple):
            along, across = (part.value for part in self.centroid)
        elif self.centroid not in (None, "middle"):
            points = [point for point, bodies in mechanism.owners.items() if body in bodies]
            check_name(self.centroid, ["middle", *points], "the body has no such point", "centroid")
            along, across = Pose(mechanism, sizes).local(body, self.centroid)
        if self.inertia == "uniform bar":
            if not link.end:
                raise Unusable("only a link with two joints is a bar", 'Write inertia = "0.016 kg*m^2"', "inertia", self.inertia)
            moment: Value = mass * length * length / 12.0
        elif self.inertia is None:
            if mass > 0.0 and link.end:
                example = f'inertia = "{mass * float(np.max(length)) ** 2 / 12.0:.3g} kg*m^2", or "uniform bar"'
                raise Unusable("a link with a mass needs a moment of inertia about its centroid", f"Add {example}", "inertia")
            moment = 0.0
        else:
            moment = self.inertia.value
        if mass == 0.0 and np.any(np.asarray(moment) > 0.0):
            message = "a body without mass has no moment of inertia"
            raise Unusable(message, "Give it a mass, or remove inertia", "inertia", str(self.inertia))
        return Inertia(mass, along, across, moment)


# --- the drive --------------------------------------------------------------------------------------------------------


_SMALL = where(
    lambda share: 0.0 < share < 2.0,
    "out of range",
    "Give the share of the mean speed by which it may vary, for example 0.02",
)


LINEAR = {"speed": "velocity", "initial_speed": "velocity", "start": "length"}
"""Kinds of the values that a drive along a guide would have."""


class DriveSection(Section):
    """Drive of the machine: a constant speed, or (for `simulate`) a torque or motor curve."""

    body: str | None = None
    """The driven body; default: the body called `crank`."""
    start: FixedAngle = Quantity(0.0, "angle", "deg")
    """Crank angle of the first row."""
    speed: Speed = Quantity(1.0, "angular velocity", "rad/s")
    """Constant speed of the crank, negative clockwise; for `optlink simulate` under a torque the speed at the start."""
    torque: Annotated[Any, in_folder(partial(read_size, kind="torque", names=("phi", "omega")))] = None
    """For `optlink simulate`, instead of the constant speed: a torque, or a table or expression over phi or omega."""
    servo: ServoSection | None = None
    """For `optlink simulate` with clearance: the crank follows a reference signal; not together with `torque`."""
    initial_speed: Speed | None = None
    """Crank speed at the start of `optlink simulate` under a torque; default: `speed` if that is given, else at rest."""
    duration: Duration | None = None
    """Duration of `optlink simulate`."""
    fluctuation: Annotated[Number, _SMALL] | None = None
    """Permitted speed fluctuation relative to the mean speed, 0.02 or "2 %"; `optlink analyze` computes the flywheel for it."""

    @model_validator(mode="before")
    @classmethod
    def _supported(cls, raw: object) -> object:
        for key, value in raw.items() if isinstance(raw, dict) else ():
            if key in ("body", "speed", "start") and isinstance(value, list):
                message, remedy = unsupported("several drives")
                raise Unusable(f"exactly one body must be driven: {message}", remedy, key, value)
            if key in ("speed", "initial_speed") and isinstance(value, dict) and {"over", "expression"} & set(value):
                raise Unusable(*unsupported("varying speed"), key, value)
            if key in LINEAR and isinstance(value, str) and measures(value, LINEAR[key]):
                raise Unusable(*unsupported("linear drive"), key, value)
        return raw

    @model_validator(mode="after")
    def _turns(self) -> Self:
        if self.speed.value == 0.0 and self.torque is None:
            remedy = 'Give a speed, for statics a low one such as "0.01 rpm"; from rest the drive needs a torque'
            raise Unusable("the crank speed is zero", remedy, "speed", str(self.speed))
        return self


def _read_gravity(raw: object) -> Any:
    """Read gravity: a value along -y, or two components."""
    if isinstance(raw, list):
        check_pair(raw, "gravity has two components", 'Write "9.81 m/s^2" (downwards) or ["0 m/s^2", "-9.81 m/s^2"]')
        return tuple(read_fixed(part, "acceleration").value for part in raw)
    return 0.0, -read_fixed(raw, "acceleration").value


Gravity = Annotated[Any, BeforeValidator(_read_gravity)]
