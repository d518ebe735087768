"""The joints of a problem file: the body whose reaction is reported, and the clearance of a pin."""

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from optlink.clearance.contact_laws import DAMPING, compliance, stiffness
from optlink.clearance.joint import Gap
from optlink.linkage.mechanism import Mechanism
from optlink.problem.base_model import Section
from optlink.problem.quantity import (
    SHORTEST,
    ContactStiffness,
    Damping,
    FixedLength,
    Friction,
    Number,
    Quantity,
    Unusable,
    Velocity,
    check_name,
    check_pair,
    is_number,
    read_positive,
    read_scalar,
    where,
)
from optlink.unsupported import unsupported

RADII_AGREE = 1e-6
"""Share of the clearance by which the difference of two given radii may differ from it."""

EXAMPLE = 'clearance = "0.5 mm", bearing_radius = "10 mm", modulus = "207 GPa", poisson = 0.3'


def _read_clearance(raw: object) -> Quantity:
    value, unit = read_scalar(raw, "coordinate")
    if value <= 0.0:
        message = "a clearance is positive: the radius of the bearing minus that of the journal"
        raise Unusable(message, 'Give one such as "0.5 mm", or remove the key for an ideal joint')
    if value < SHORTEST:
        raise Unusable("no joint has such a clearance", "Give 1e-9 m or more, and check its unit")
    return Quantity(value, "length", unit)


def _read_pair(raw: object, kind: str) -> tuple[float, float]:
    """Read one value for both parts, or the values of the journal and of the bearing."""
    if isinstance(raw, list):
        check_pair(raw, "one value, or two: of the journal and of the bearing", "Give one or two")
        return _one(raw[0], kind), _one(raw[1], kind)
    value = _one(raw, kind)
    return value, value


def _one(raw: object, kind: str) -> float:
    if kind:
        value = read_positive(raw, kind).value
        if value == 0.0:
            raise Unusable(f"a {kind} of the contact must be positive", 'Give for example "207 GPa"')
        return value
    if not is_number(raw):
        raise Unusable("expected a plain number", "Write a number without a unit, for example 0.3")
    if not -1.0 < raw <= 0.5:
        raise Unusable("Poisson's ratio lies above -1 and not above 0.5", "Give for example 0.3, that of steel")
    return float(raw)


class JointSection(Section):
    """A joint: `on` is the body whose reaction is reported; `clearance` and the following keys define a journal in a bearing."""

    on: str | None = None
    """The body on which the reported reaction acts; default: the one that is placed last."""
    clearance: Annotated[Quantity, BeforeValidator(_read_clearance)] | None = None
    """Radial clearance: radius of the bearing minus that of the journal."""
    bearing_radius: FixedLength | None = None
    """Radius of the bearing; one of the two radii together with `clearance`, or both without it."""
    journal_radius: FixedLength | None = None
    """Radius of the journal."""
    journal: str | None = None
    """The body with the journal; default: the one that is placed last. Required where three or more bodies meet."""
    modulus: Annotated[Any, BeforeValidator(lambda raw: _read_pair(raw, "pressure"))] = None
    """Modulus of elasticity of both parts, or of journal and bearing; it determines the Hertz stiffness."""
    poisson: Annotated[Any, BeforeValidator(lambda raw: _read_pair(raw, ""))] = Field(default=(0.3, 0.3))
    """Poisson's ratio of both parts, or of journal and bearing."""
    stiffness: (
        Annotated[ContactStiffness, where(lambda k: k > 0.0, "a contact needs a stiffness", 'Give for example "6.6e+10 N/m^1.5"')]
        | None
    ) = None
    """Instead of `modulus`: contact force divided by penetration to the power 1.5."""
    restitution: Annotated[
        Number,
        where(lambda e: 0.0 < e <= 1.0, "a coefficient of restitution lies above 0 and not above 1", "Give for example 0.9"),
    ] = 0.9
    """Coefficient of restitution, above 0 and at most 1."""
    law: str = "lankarani-nikravesh"
    """Contact law."""
    friction: Friction = 0.0
    """Coulomb friction coefficient, below 10."""
    slip_speed: Annotated[
        Velocity,
        where(
            lambda v: v >= 1e-6, "friction changes its sign over some speed, of 1e-6 m/s at least", 'Give for example "0.01 m/s"'
        ),
    ] = Quantity(0.01, "velocity", "m/s")
    """The friction force is `friction` times normal force times tanh(slip / `slip_speed`)."""
    damping: Damping = Quantity(0.0, "damping", "N*s/m")
    """Tangential viscous damping during contact."""

    @property
    def has_clearance(self) -> bool:
        """Whether the joint has clearance."""
        both = self.bearing_radius is not None and self.journal_radius is not None
        return self.clearance is not None or both

    def gap(self, point: str, mechanism: Mechanism) -> Gap:
        """Return the pin `point` as a joint with clearance.

        Raises
        ------
        Unusable
            with the key below the joint.
        """
        bodies = mechanism.pins[point]
        journal = self.journal if self.journal is not None else bodies[-1] if len(bodies) == 2 else None
        if journal is None:
            message = f"the pin joins {', '.join(bodies)}, and only one of them can have the journal"
            raise Unusable(message, f'Add journal = "{bodies[-1]}"', "journal")
        check_name(journal, bodies, "the joint is not one of that body", "journal")
        clearance, radius = self._radii()
        check_name(self.law, DAMPING, "no such contact law", "law")
        return Gap(
            point,
            journal,
            next(body for body in bodies if body != journal),
            clearance,
            radius,
            self._stiffness(clearance, radius),
            self.restitution,
            self.law,
            self.friction,
            slip_speed=self.slip_speed.value,
            damping=self.damping.value,
        )

    def _radii(self) -> tuple[float, float]:
        """Return clearance and radius of the journal [m]."""
        bearing, journal, clearance = self.bearing_radius, self.journal_radius, self.clearance
        if bearing is not None and journal is not None:
            difference = bearing.value - journal.value
            if difference <= 0.0:
                message = f"the journal ({journal}) is not smaller than the bearing ({bearing})"
                raise Unusable(message, "Exchange the radii, or make the bearing larger", "journal_radius", str(journal))
            if clearance is not None and abs(difference - clearance.value) > RADII_AGREE * difference:
                message = f"the radii differ by {difference * 1e3:.6g} mm, but the clearance is stated as {clearance}"
                raise Unusable(message, "Remove one of the three", "clearance", str(clearance))
            return difference, journal.value
        if clearance is None:
            raise Unusable("the joint has radii, but no clearance", f"Add the other radius, or {EXAMPLE}", "clearance")
        if bearing is not None:
            if clearance.value >= bearing.value:
                message = f"the clearance ({clearance}) is not smaller than the bearing ({bearing}): no journal is left"
                raise Unusable(message, "Check both", "clearance", str(clearance))
            return clearance.value, bearing.value - clearance.value
        if journal is None:
            message = "the sizes of journal and bearing are missing"
            raise Unusable(message, 'Add bearing_radius = "10 mm" (or journal_radius)', "bearing_radius")
        return clearance.value, journal.value

    def _stiffness(self, clearance: float, radius: float) -> float:
        if self.stiffness is not None:
            if self.modulus is not None:
                message = "the contact has a stiffness and a modulus of elasticity"
                raise Unusable(message, "Give one of the two", "stiffness", str(self.stiffness))
            return self.stiffness.value
        if self.modulus is None:
            message = "the contact has no stiffness and no material"
            raise Unusable(message, 'Add modulus = "207 GPa" (and poisson = 0.3), or stiffness = "6.6e+10 N/m^1.5"', "stiffness")
        first, second = (compliance(e, nu) for e, nu in zip(self.modulus, self.poisson, strict=True))
        return float(stiffness(radius + clearance, radius, first, second))

    def check_unused(self, point: str, bodies: Sequence[str]) -> None:
        """Refuse keys without effect in a pin without clearance that joins these bodies.

        Raises
        ------
        Unusable
            with the first such key.
        """
        unused = sorted(key for key in self.model_fields_set - {"on"} if getattr(self, key) is not None)
        if "friction" in unused and not self.has_clearance:
            other, body = bodies[0], bodies[-1]
            raise Unusable(*unsupported("pin friction", point=point, body=body, other=other), "friction")
        if unused and not self.has_clearance:
            message = f"the joint has no clearance, so {unused[0]} has no effect"
            raise Unusable(message, f"Add {EXAMPLE}, or remove the key", unused[0])
