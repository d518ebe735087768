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
        if self.force is not None:
            body, point, guide = self._target(mechanism)
            direction: float | str | None = None if self.direction is None else self.direction.value
            if direction is None:
                if not guide:
                    raise Unusable("the force has no direction", 'Add direction = "90 deg" (from +x)', "direction")
                direction = guide
            if isinstance(self.force, Formula) and self.force.expression.names & {"s", "v"} and not isinstance(direction, str):
                raise Unusable("s and v are those of a slider along its guide", "Leave direction out, or use phi", "force")
            if isinstance(self.force, LoadTable) and self.force.over == "s" and not isinstance(direction, str):
                raise Unusable("s is the position of a slider along its guide", "Leave direction out, or use phi", "force")
            self._check_against(mechanism)
            load = Force(
                name, body, point, self.force, direction, opposing=self.acts == "opposing", against=self.against or FRAME
            )
            return replace(load, **self._stroke(load, motion))
        if self.torque is not None:
            body = self._body(mechanism, self.on, "on")
            self._check_against(mechanism)
            angular = isinstance(self.torque, Formula) and "theta" in self.torque.expression.names
            twist = Torque(
                name,
                body,
                self.torque,
                motion.branch(body) if angular else 0.0,
                opposing=self.acts == "opposing",
                against=self.against or FRAME,
            )
            return replace(twist, **self._stroke(twist, motion))
        if self.between is not None:
            ends = spring_ends(mechanism, self.between)
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
            message = "damping without two points applies to a body in a guide only"
            raise Unusable(message, "Name a slider, or two points: between = [...]", "on", self.on)
        _, _, guide = self._target(mechanism)
        joint = next(g for g in mechanism.guides if g.name == guide)
        assert self.damping is not None
        return SlideDamper(
            name, guide, joint.slider, joint.on, joint.at or mechanism.bodies[joint.slider].start, self.damping.value
        )

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
            raise Unusable(
                "the load has no magnitude",
                'Give force = "1000 N", torque = "5 N*m", between = [...] with stiffness, or damping',
            )
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
        if self.at is None:
            if link.end and guide is None:
                raise Unusable("the force has no point", f"Add at, one of: {link.start}, {link.end} or another", "at")
            point = (guide.at if guide else "") or link.start
        else:
            points = [point for point, bodies in mechanism.owners.items() if body in bodies]
            check_name(self.at, points, "the body has no such point", "at")
            point = self.at
        return body, point, guide.name if guide else ""

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
