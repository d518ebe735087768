"""The loads of a problem file."""

from dataclasses import replace
from functools import partial
from typing import Annotated, Any, Literal

from optlink.dynamics.loads import Force, SlideDamper, Spring, Torque, TorsionSpring
from optlink.dynamics.machine import Load
from optlink.linkage.mechanism import FRAME, Mechanism
from optlink.linkage.stroke import OTHER
from optlink.problem.base_model import Section, in_folder
from optlink.problem.machine.load_curves import Formula, LoadTable, read_size
from optlink.problem.machine.revolution import RevolutionSamples
from optlink.problem.quantity import (
    Damping,
    FixedAngle,
    FixedLength,
    Quantity,
    Stiffness,
    TorsionalDamping,
    TorsionalStiffness,
    Unusable,
    check_name,
)


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


def _value(quantity: Quantity | None) -> float:
    return 0.0 if quantity is None else quantity.value


class LoadSection(Section):
    """A load; its keys determine its type."""

    on: str | None = None
    """The body on which the load acts."""
    at: str | None = None
    """Point of that body where a force acts; default: the point of a slider on its guide."""
    force: Annotated[Any, in_folder(partial(read_size, kind="force", names=("phi", "omega", "s", "v")))] = None
    """Magnitude of the force: a quantity, a table over phi, omega or s, or an expression."""
    torque: Annotated[Any, in_folder(partial(read_size, kind="torque", names=("phi", "omega", "theta", "w")))] = None
    """Magnitude of the torque: a quantity, a table over phi or omega, or an expression."""
    direction: FixedAngle | None = None
    """Direction of the force, from +x; default: along the guide of a slider."""
    acts: Literal["constant", "opposing"] = "constant"
    """`constant`: in a fixed direction; `opposing`: against the motion."""
    stroke: Literal["both", "forward", "backward", "slow", "quick"] = "both"
    """Stroke in which the load acts; forward is along the guide, or counter-clockwise."""
    between: tuple[str, str] | None = None
    """The two points that a spring or damper connects."""
    against: str | None = None
    """The body on which the reaction of the load acts; default: the frame."""
    stiffness: Stiffness | None = None
    """Stiffness of a spring between two points."""
    free_length: FixedLength | None = None
    """Free length of that spring; default: 0."""
    damping: Damping | None = None
    """Viscous damping between two points, or in the guide of a slider."""
    torsional_stiffness: TorsionalStiffness | None = None
    """Stiffness of a torsion spring between `on` and `against`."""
    free_angle: FixedAngle | None = None
    """Free angle of that spring; default: 0."""
    torsional_damping: TorsionalDamping | None = None
    """Viscous damping of the rotation of `on` relative to `against`."""

    def build(self, name: str, mechanism: Mechanism, motion: RevolutionSamples) -> Load:
        """Return the load of a machine, whose motion over a revolution decides on strokes and angles.

        Raises
        ------
        Unusable
            with the key below the load.
        """
        self._check_keys()
        opposing, against = self.acts == "opposing", self.against or FRAME
        if self.force is not None:
            body, point, guide = self._target(mechanism)
            along_guide = self.direction is None
            if along_guide and not guide:
                raise Unusable("the force has no direction", 'Add direction = "90 deg" (from +x)', "direction")
            if isinstance(self.force, Formula) and self.force.expression.names & {"s", "v"} and not along_guide:
                raise Unusable("s and v are those of a slider along its guide", "Leave direction out, or use phi", "force")
            if isinstance(self.force, LoadTable) and self.force.over == "s" and not along_guide:
                raise Unusable("s is the position of a slider along its guide", "Leave direction out, or use phi", "force")
            self._check_against(mechanism)
            direction = guide if self.direction is None else self.direction.value
            force = Force(name, body, point, self.force, direction, opposing=opposing, against=against)
            return replace(force, **self._stroke(force, motion))
        if self.torque is not None:
            body = self._body(mechanism, self.on, "on")
            self._check_against(mechanism)
            angular = isinstance(self.torque, Formula) and "theta" in self.torque.expression.names
            branch = motion.branch(body) if angular else 0.0
            torque = Torque(name, body, self.torque, branch, opposing=opposing, against=against)
            return replace(torque, **self._stroke(torque, motion))
        if self.between is not None:
            one, other = spring_ends(mechanism, self.between)
            return Spring(name, (one, other), _value(self.stiffness), _value(self.free_length), _value(self.damping))
        if self.torsional_stiffness is not None or self.torsional_damping is not None:
            body = self._body(mechanism, self.on, "on")
            self._check_against(mechanism)
            stiffness, free = _value(self.torsional_stiffness), _value(self.free_angle)
            middle = motion.middle(body, against, free) if stiffness else 0.0
            return TorsionSpring(name, body, against, stiffness, free, _value(self.torsional_damping), middle)
        slot = next((guide for guide in mechanism.guides if guide.slider == self.on), None)
        if slot is None:
            self._body(mechanism, self.on, "on")
            message = "damping without two points applies to a body in a guide only"
            raise Unusable(message, "Name a slider, or two points: between = [...]", "on", self.on)
        at = slot.at or mechanism.bodies[slot.slider].start
        return SlideDamper(name, slot.name, slot.slider, slot.on, at, _value(self.damping))

    @property
    def by_pace(self) -> bool:
        """Whether the dimensions determine its direction: it acts in the slow or in the quick stroke."""
        return self.stroke in ("slow", "quick")

    def _check_keys(self) -> None:
        """Refuse inconsistent combinations of keys."""
        keys = {key for key in self.model_fields_set if getattr(self, key) is not None}
        kinds: dict[str, set[str]] = {
            "force": {"on", "at", "direction", "acts", "stroke", "against"},
            "torque": {"on", "acts", "stroke", "against"},
            "between": {"stiffness", "free_length", "damping"},
            "torsional_stiffness": {"on", "against", "free_angle", "torsional_damping"},
            "torsional_damping": {"on", "against"},
            "damping": {"on"},
        }
        kind = next((kind for kind in kinds if kind in keys), None)
        if kind is None:
            remedy = 'Give force = "1000 N", torque = "5 N*m", between = [...] with stiffness, or damping'
            raise Unusable("the load has no magnitude", remedy)
        wrong = sorted(keys - kinds[kind] - {kind})
        if wrong:
            raise Unusable(f"a load with {kind} has no {wrong[0]}", f"Possible:  {', '.join(sorted(kinds[kind]))}", wrong[0])
        if kind == "between" and not {"stiffness", "damping"} & keys:
            raise Unusable("a spring needs a stiffness", 'Add stiffness = "500 N/m" or damping = "20 N*s/m"', "stiffness")
        if kind != "between" and "on" not in keys:
            raise Unusable("the load has no body to act on", 'Name a body: on = "slider"', "on")

    def _body(self, mechanism: Mechanism, body: str | None, key: str) -> str:
        check_name(body, mechanism.bodies, "no such body", key)
        return str(body)

    def _target(self, mechanism: Mechanism) -> tuple[str, str, str]:
        """Return body, point and guide (or "") of a force."""
        body = self._body(mechanism, self.on, "on")
        guide = next((g for g in mechanism.guides if g.slider == body), None)
        link = mechanism.bodies[body]
        if self.at is not None:
            points = [point for point, bodies in mechanism.owners.items() if body in bodies]
            check_name(self.at, points, "the body has no such point", "at")
        elif link.end and guide is None:
            raise Unusable("the force has no point", f"Add at, one of: {link.start}, {link.end} or another", "at")
        return body, self.at or (guide and guide.at) or link.start, guide.name if guide else ""

    def _check_against(self, mechanism: Mechanism) -> None:
        if self.against not in (None, FRAME):
            self._body(mechanism, self.against, "against")
            if self.against == self.on:
                raise Unusable("a load does not act against itself", "Name another body, or frame", "against", self.against)

    def _stroke(self, load: Force | Torque, motion: RevolutionSamples) -> dict[str, Any]:
        """Return the stroke in which the load acts, and whether it follows the sense of crank rotation."""
        if load.opposing or self.stroke != "both":
            motion.check_moves(load)
        if not self.by_pace:
            return {"stroke": self.stroke}
        slow = motion.slow(load)
        return {"stroke": slow if self.stroke == "slow" else OTHER[slow], "turning": True}
