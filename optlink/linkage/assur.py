"""Decomposition of a mechanism into Assur groups: from bodies and joints to an ordered chain of dyads.

References
----------
L. V. Assur (1914): classification of mechanisms; a mechanism is a driving crank plus groups of zero mobility, added one by one.
"""

import itertools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import get_args

from optlink.errors import InvalidValue
from optlink.io import Entry, register
from optlink.linkage.dyads import FORWARD, RPR, LineDyad, ModalDyad, Transmitting
from optlink.linkage.elements import Drive, Element, key_of
from optlink.linkage.mechanism import FRAME, BodyPoint, Dyad, Ground, Guide, Joint, Link, Mechanism, owners_of
from optlink.linkage.trains import Single, Train
from optlink.units import count_noun
from optlink.unsupported import unsupported

_SIDE = re.compile(r"\s*(left|right)\s+of\s+(\S+)\s*(?:->|-|–|→|to)\s*(\S+)\s*", re.ASCII)
CONTINUE = "continue"
"""Follow the motion smoothly through change points; alone, or behind the assembly mode at the start: "left of B-D, continue"."""

EITHER = "either"
"""An assembly mode that a search shall choose; until then it counts as left, or forward."""


MOST_COUPLED = 6
"""Largest number of bodies whose angles and slides are determined together."""


class StructureError(InvalidValue):
    """Error for bodies that do not form a chain of dyads: `message`, `remedy`, and the faulty `key` below the mechanism."""


def _split(words: str) -> tuple[str, bool]:
    """Return an assembly mode and whether it is continued through change points; a missing mode counts as left, or forward."""
    mode, _, last = words.rpartition(",")
    return (mode.strip() or EITHER, True) if last.strip() == CONTINUE else (words, False)


def _list(joints: Sequence[Joint]) -> str:
    *first, last = (joint if isinstance(joint, str) else joint.name for joint in joints)
    return f"{', '.join(first)} and {last}" if first else last


@dataclass
class Assembly:
    """Decomposition of a mechanism into dyads, in an order in which the bodies can be placed two at a time.

    The start of the body `driver` is its pivot on the frame; it is empty where `drives` prescribe the motion instead. Bodies with
    one joint that drives and couplings determine are placed before a dyad. `modes` are by the name of the inner joint: "left of
    B-D" or "right of B-D" for RRR groups; "forward" or "backward" along the guide for RRP and RPR groups. With ", continue"
    appended the group is continued smoothly through its singular positions.
    """

    ground: Mapping[str, Ground]
    links: Sequence[Link]
    points: Sequence[BodyPoint]
    guides: Sequence[Guide]
    driver: str
    modes: Mapping[str, str]
    drives: Sequence[Drive] = ()
    couplings: Sequence[Element] = ()

    def __post_init__(self) -> None:
        self.bodies = {link.body: link for link in self.links}
        self.rank = {body: k for k, body in enumerate(self.bodies)}
        self.members = owners_of(self.ground, self.links, self.points)
        self.placed = {FRAME, self.driver} - {""}
        self.groups: list[Dyad] = []
        self.trains: list[Train] = []
        self.used: set[str] = set()  # joints whose assembly mode is that of a group
        shared = {point: bodies for point, bodies in self.members.items() if len(bodies) > 1}
        everything = (FRAME, *self.bodies)
        self.pins = {body: [point for point, bodies in shared.items() if body in bodies] for body in everything}
        self.rails = {body: [guide for guide in self.guides if body in guide.bodies] for body in everything}

    # --- joints of the bodies ------------------------------------------------------------------------------------

    def neighbours(self, body: str) -> list[str]:
        """Return the bodies, not yet placed, that share a joint with a body, in the order of the file."""
        near = {other for point in self.pins[body] for other in self.members[point]}
        near |= {guide.other(body) for guide in self.rails[body]}
        return sorted(near - self.placed - {body}, key=self.rank.__getitem__)

    def placed_joints(self, body: str, placed: set[str] | None = None) -> list[Joint]:
        """Return the joints of a body with bodies that are already placed, by default with all of them."""
        known = self.placed if placed is None else placed
        pins = [point for point in self.pins[body] if known.intersection(self.members[point])]
        return [*pins, *(guide for guide in self.rails[body] if guide.other(body) in known)]

    def _shared(self, first: str, second: str) -> list[Joint]:
        """Return the joints between two bodies that are not yet placed."""
        pins = [p for p in self.pins[first] if second in self.members[p] and not self.placed.intersection(self.members[p])]
        return [*pins, *(guide for guide in self.rails[first] if guide.other(first) == second)]

    # --- the search ------------------------------------------------------------------------------------------------

    def mechanism(self, name: str) -> Mechanism:
        """Return the decomposed mechanism.

        Raises
        ------
        StructureError
            If the bodies do not form a chain of dyads (the message names those that are left), or a mode is that of no group.
        """
        self.check_joints()
        connected = {body for start in self.placed for body in self.neighbours(start)}
        while len(self.placed) <= len(self.bodies):
            rank = self.rank.__getitem__
            if (train := next(self._trains(), None)) is not None:
                self.trains.append(train)
                bodies = [single.link.body for single in train.singles]
                self.placed.update(bodies)
                connected = connected.union(*map(self.neighbours, bodies)) - self.placed
                continue
            pairs = ((a, b) for a in sorted(connected, key=rank) for b in self.neighbours(a) if rank(a) < rank(b))
            group = next(filter(None, itertools.starmap(self._group, pairs)), None)  # the first one, in the order of the file
            if group is None:
                raise self.refusal([body for body in self.bodies if body not in self.placed])
            self.groups.append(group)
            self.placed.update(link.body for link in group.links)
            connected.update(body for link in group.links for body in self.neighbours(link.body))
            connected -= self.placed
        for joint in self.modes:
            if joint not in self.used:
                joints = [group.joint for group in self.groups if group.modes]
                remedy = f"Joints with an assembly mode: {', '.join(joints) or 'none'}"
                raise StructureError(
                    "no dyad has its inner joint there, or the dyad has only one assembly mode", remedy, f"assembly.{joint}"
                )
        for element in self.couplings:
            if element in self._idle:
                raise StructureError(
                    f"{element.name} couples bodies whose motions other joints and drives determine",
                    "Remove it, or a drive or joint",
                    key_of(element),
                )
        crank = self.bodies[self.driver or self.drives[0].body]
        groups, points = tuple(self.groups), tuple(self.points)
        return Mechanism(
            name, self.ground, crank, groups, points, tuple(self.guides), trains=tuple(self.trains), drives=tuple(self.drives)
        )

    @property
    def _idle(self) -> list[Element]:
        """The drives and couplings that determine no body yet."""
        acting = [element for train in self.trains for element in train.elements]
        return [element for element in (*self.drives, *self.couplings) if element not in acting]

    def _trains(self) -> Iterator[Train]:
        """Yield the bodies that drives and couplings can place next: as many as there are equations between them."""
        after = self.groups[-1].joint if self.groups else ""
        unknown = [(element, bodies) for element in self._idle if (bodies := element.unknown(self.placed))]
        for count in range(1, min(len(unknown), MOST_COUPLED) + 1):
            for chosen in itertools.combinations(unknown, count):
                left = set[str]().union(*(bodies for _, bodies in chosen))
                if len(left) == count and (singles := self._singles(left, chosen[0][0])):
                    yield Train(singles, tuple(element for element, _ in chosen), after)

    def _singles(self, left: set[str], element: Element) -> tuple[Single, ...]:
        """Return bodies in an order in which each has one joint with those before it; empty if there is none.

        Raises
        ------
        StructureError
            If joints with placed bodies already fix one of them.
        """
        singles: list[Single] = []
        order = sorted(left, key=self.rank.__getitem__)
        while order:
            placed = self.placed.union(single.link.body for single in singles)
            joints = {body: self.placed_joints(body, placed) for body in order}
            if len(left) == 1 and len(joints[order[0]]) > 1:
                raise StructureError(
                    f"{order[0]} cannot move by {element.name}: the joints {_list(joints[order[0]])} already fix it",
                    "Remove one of the joints, or the drive",
                    f"links.{order[0]}",
                )
            body = next((body for body in order if len(joints[body]) == 1), None)
            if body is None:
                return ()
            order.remove(body)
            singles.append(Single(self.bodies[body], joints[body][0]))
        return tuple(singles)

    def check_joints(self) -> None:
        """Refuse a driven body off the frame or fixed to it, and bodies without a joint.

        Raises
        ------
        StructureError
            If there is one of them.
        """
        if not self.driver:
            return self._check_bodies()
        crank = self.bodies[self.driver]
        if FRAME not in self.members[crank.start]:
            message = f"the driven body turns about its first joint, and {crank.start} of {crank.body} is not on the frame"
            remedy, missing = "Give its first joint a place under [mechanism.ground]", ""
            if FRAME in self.members.get(crank.end, []):
                remedy = "Exchange its two joints"
            elif self.rails[self.driver]:
                guide = self.rails[self.driver][0].name
                missing, remedy = "it slides", f'Write slide = "{guide}" instead of body, or give range, start or speed in "mm"'
            elif len(self.members[crank.start]) > 1:
                pinned = [body for body in self.bodies if any(FRAME in self.members[point] for point in self.pins[body])]
                missing, remedy = unsupported("drive on a moving link", bodies=", ".join(pinned))
            message = f"{message}: {missing}" if missing else message
            raise StructureError(message, remedy, f"links.{crank.body}.joints", crank.start)
        self._check_bodies()
        fixed_at: list[Joint] = [p for p in self.pins[self.driver] if FRAME in self.members[p] and p != crank.start]
        fixed_at += [guide for guide in self.rails[self.driver] if FRAME in guide.bodies]
        if fixed_at:
            raise StructureError(
                f"{self.driver} cannot turn about its pivot {crank.start}: the frame also fixes it at {_list(fixed_at)}",
                "Remove that joint",
                f"links.{self.driver}",
            )

    def _check_bodies(self) -> None:
        """Refuse bodies without a joint."""
        for body in self.bodies:
            if not self.pins[body] and not self.rails[body]:
                points = [point for point, bodies in self.members.items() if body in bodies]
                raise StructureError(
                    f"the body has no joint: no other body has its {'points' if len(points) > 1 else 'point'} {_list(points)}, "
                    "and no guide carries it",
                    "Give one of its joints the name of a joint of another body or of the ground, or remove it",
                    f"links.{body}",
                )

    def _group(self, first: str, second: str) -> Dyad | None:
        """Return the dyad of two bodies, if each has one joint with the placed bodies and they share one inner joint."""
        joints = self.placed_joints(first), self._shared(first, second), self.placed_joints(second)
        if any(len(some) != 1 for some in joints):
            return None
        (a,), (joint,), (b,) = joints
        if a == b and isinstance(a, str):
            raise self._one_body(first, second, [a, joint])
        letters = "".join("R" if isinstance(each, str) else "P" for each in (a, joint, b))
        if letters in DYADS:
            return DYADS[letters].form(self, self.bodies[first], self.bodies[second], a, joint, b)
        if letters[::-1] in DYADS:
            return DYADS[letters[::-1]].form(self, self.bodies[second], self.bodies[first], b, joint, a)
        return None  # three prismatic joints determine no position

    def side(self, joint: str, *joints: Joint) -> int:
        """Return the assembly mode of the group with the inner joint `joint`, from its outer, inner and other outer joint.

        Raises
        ------
        StructureError
            If the file states no mode for the group, or one that it does not have.
        """
        guide = next((each for each in joints if isinstance(each, Guide)), None)
        p, _, q = joints
        if guide is None:
            options = f'{joint} = "left of {p}-{q}" or "right of {p}-{q}"'
        else:
            options = f'{joint} = "forward" or "backward", along the guide {guide.name}'
        options += f'; in a design problem also "{EITHER}"'
        if joint not in self.modes:
            raise StructureError(
                "the group with this joint can be assembled in two ways, and the file does not state which",
                f"Add {options}",
                f"assembly.{joint}",
            )
        self.used.add(joint)
        words = _split(self.modes[joint])[0].strip()
        if words == EITHER:
            return 1
        if guide is not None and words in FORWARD:
            return FORWARD[words]
        match = None if guide is not None else _SIDE.fullmatch(words)
        if match is None or {match[2], match[3]} != {p, q} or p == q:
            raise StructureError("not an assembly mode of this group", f"Write {options}", f"assembly.{joint}", words)
        return (1 if match[1] == "left" else -1) * (1 if match[2] == p else -1)

    def _one_body(self, first: str, second: str, both: Sequence[Joint]) -> StructureError:
        """Return the error for two bodies that cannot move relative to each other."""
        return StructureError(
            f"{first} and {second} share the joints {_list(both)}, which makes them one body",
            "Give the points to one body, or remove one joint",
            f"links.{second}",
        )

    # --- structures that are not a chain of dyads --------------------------------------------------------------------

    def refusal(self, left: list[str]) -> StructureError:
        """Return the error that explains why no further group can be formed."""
        for body in left:
            for other in self.bodies:
                both = [point for point in self.pins[body] if other != body and other in self.members[point]]
                if other in self.placed and len(both) > 1:
                    return self._one_body(other, body, both)
            joints = self.placed_joints(body)
            if len(joints) > 1:
                missing, remedy = unsupported("redundant body", body=body)
                message = f"{body} moves only with special lengths, as {_list(joints)} already fix its position: {missing}"
                return StructureError(message, remedy, f"links.{body}")
        for first, second in itertools.combinations(left, 2):
            if len(self._shared(first, second)) > 1:
                return self._one_body(first, second, self._shared(first, second))
        joint_count = sum(len(bodies) - 1 for bodies in self.members.values()) + len(self.guides)
        free = 3 * len(self.bodies) - 2 * joint_count  # degrees of freedom, by Gruebler's formula
        driven = sum(drive.kind != "length" for drive in self.drives) + bool(self.driver) + len(self.couplings)
        by = "one driver" if self.driver and not self.couplings else f"{driven} of them are driven or coupled"
        freedom = count_noun(free, "degree of freedom", "degrees of freedom")
        if free > driven:
            ends = (point for body in left for point in (self.bodies[body].start, self.bodies[body].end))
            unshared = [point for point in ends if point and len(self.members[point]) == 1]
            check = f" (check the names of {_list(unshared)}, joints of one body alone)" if len(unshared) > 1 else ""
            missing, remedy = unsupported("free links", them="them" if len(left) > 1 else "it", check=check)
            message = f"{_list(left)} cannot be placed: the mechanism has {freedom} and {by}; {missing}"
            return StructureError(message, remedy, f"links.{left[-1]}")
        if free < driven:
            return StructureError(
                f"{_list(left)} cannot be placed: the mechanism has {freedom}"
                + (", it is a rigid structure" if free < 1 else f" and {by}"),
                "Remove a joint, or add a body",
                f"links.{left[-1]}",
            )
        for first, second in itertools.combinations(left, 2):
            joint_lists = self.placed_joints(first), self._shared(first, second), self.placed_joints(second)
            if all(len(some) == 1 and isinstance(some[0], Guide) for some in joint_lists):
                return StructureError(
                    f"{first} and {second} are connected by three guides and no pin, which does not determine their positions",
                    "Replace one guide by a pin",
                    f"links.{first}",
                )
        missing, remedy = unsupported("higher class")
        message = (
            f"{_list(left)} are not a chain of dyads: they form a group of a higher class (Assur class III or above), "
            f"or depend on one another in a ring; {missing}"
        )
        return StructureError(message, remedy, f"links.{left[0]}")


# --- the types of dyads --------------------------------------------------------------------------------------------------

Former = Callable[[Assembly, Link, Link, Joint, Joint, Joint], Dyad]
"""(assembly, first body, second body, outer joint of the first, inner joint, outer joint of the second) -> group"""


@dataclass(frozen=True)
class DyadType(Entry):
    """A dyad of three joints, each R, a pin, or P, a guide.

    Parameters
    ----------
    name : str
        Letters of its outer joint, inner joint and other outer joint, such as "RPP".
    form : function of (assembly, first body, second body, outer joint, inner joint, other outer joint)
        Returns the `Dyad` of two bodies; a pin is given by its name, a guide as a `Guide`.
    """

    name: str
    form: Former

    def fault(self) -> tuple[str, str] | None:
        """Refuse other names than three of the letters R and P."""
        named = re.fullmatch("[RP]{3}", self.name)
        return None if named else ("a dyad is named by its three joints", 'Write R for a pin and P for a guide, such as "RPP"')


DYADS: dict[str, DyadType] = DyadType.registry


def _formed(
    kind: type[ModalDyad | LineDyad], assembly: Assembly, first: Link, second: Link, p: Joint, inner: Joint, q: Joint
) -> Dyad:
    if kind is RPR and isinstance(inner, Guide) and inner.slider != first.body:
        first, second, p, q = second, first, q, p
    if issubclass(kind, LineDyad):
        return kind(first, second, (p, q), inner)
    joint = inner if isinstance(inner, str) else inner.name
    return kind(first, second, (p, q), inner, assembly.side(joint, p, inner, q), follow=_split(assembly.modes[joint])[1])


register(*(DyadType(dyad.kind, partial(_formed, dyad)) for dyad in get_args(Transmitting)))
