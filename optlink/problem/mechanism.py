"""The linkage of a problem file: a four-bar by four lengths, or any chain of dyads by ground points, links and guides."""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, WrapValidator

from optlink.dynamics.machine import Inertia
from optlink.linkage.assur import CONTINUE, EITHER, Assembly
from optlink.linkage.elements import Drive
from optlink.linkage.fourbar import LENGTHS, four_bar
from optlink.linkage.mechanism import FRAME, BodyPoint, Dyad, Guide, Link, Mechanism, Pose, Size
from optlink.linkage.trains import Single, Train
from optlink.linkage.vector2d import all_finite, unit
from optlink.problem.base_model import RESERVED, Name, Section
from optlink.problem.elements import (
    ELEMENTS,
    BeltSection,
    CamSection,
    CylinderSection,
    GearSection,
    Parts,
    RackSection,
    SlotSection,
    couplings,
)
from optlink.problem.quantity import (
    BOTH,
    DIMENSIONS,
    Angle,
    Coordinate,
    Friction,
    Length,
    Quantity,
    Unusable,
    below,
    check_name,
    check_pair,
    read_quantity,
    states,
)
from optlink.unsupported import unsupported

# Assembly modes given by the place of a joint where the drive starts: `near [12 mm, 40 mm]`.

_PLACE = re.compile(r"near\s*\[([^\[\],]*),([^\[\],]*)\]\s*(?:,\s*(\w+))?")
NEAR = 0.25
"""Largest distance of a place from a position of a joint that is near it, as a share of the distance of its two positions."""


class NearPlace(NamedTuple):
    """Place [m] near which a joint lies where the drive starts, and whether its group is continued through change points."""

    x: float
    y: float
    follow: bool
    words: str


def read_near(words: object) -> NearPlace | None:
    """Return the place that an assembly mode states; None for a mode in other words.

    Raises
    ------
    Unusable
    """
    if not isinstance(words, str) or not words.strip().lower().startswith("near"):
        return None
    match = _PLACE.fullmatch(words.strip())
    if match is None or match[3] not in (None, CONTINUE):
        remedy = f'Write "near [12 mm, 40 mm]" or "near [12 mm, 40 mm], {CONTINUE}"'
        raise Unusable("this is not the place of a joint", remedy, value=words)
    x, y = (read_quantity(coordinate.strip(), "coordinate").value for coordinate in match.groups()[:2])
    return NearPlace(x, y, match[3] is not None, words)


def nearest_modes(
    mechanism: Mechanism, sizes: Mapping[str, float], start: float, places: Mapping[str, NearPlace]
) -> dict[str, str]:
    """Return the assembly modes, by joint, in which the joints lie nearest to their places where the drive starts [rad].

    Raises
    ------
    Unusable
        If a place is near neither position of its joint, or the joint has no two positions; the key is the joint.
    """
    modes = {}
    with np.errstate(all="ignore"):
        pose = mechanism.begin(sizes, unit(start), start)
        for group in mechanism.groups:
            if group.joint in places:
                group, modes[group.joint] = _nearest(pose, group, places[group.joint])
            pose.add(group)
    return modes


def _nearest(pose: Pose, group: Dyad, near: NearPlace) -> tuple[Dyad, str]:
    """Return a group with the assembly mode in which its joint is nearest to a place, and that mode."""
    where = f"where the drive starts (crank angle {math.degrees(pose.angle):.6g} deg)"
    if group.joint not in pose.mechanism.owners:
        remedy = f'Write "{group.modes[0]}" or "{group.modes[1]}"'
        raise Unusable("this is a guide, and near states the place of a pin joint", remedy, group.joint, near.words)
    both = [replace(group, side=side) for side in (1, -1)]  # type: ignore[call-arg]
    points = [tuple(float(x) for x in pose.with_group(one).point(group.joint)) for one in both]
    if not all_finite(points):
        message = f"{group.joint} has no position {where}: its group cannot be assembled there"
        raise Unusable(
            message,
            "Start the drive at another angle, change the dimensions, or state the mode in words",
            group.joint,
            near.words,
        )
    distances = [math.hypot(x - near.x, y - near.y) for x, y in points]
    suffix = f", {CONTINUE}" if near.follow else ""
    texts = [f"[{1e3 * x:.6g} mm, {1e3 * y:.6g} mm]" for x, y in points]
    k = int(distances[1] < distances[0])
    if not distances[k] <= NEAR * math.dist(*points):
        message = (
            f"{group.joint} lies at {texts[0]} or {texts[1]} {where}, and this is near neither: "
            f"the distance from one of them must be at most {NEAR:g} times their distance from each other"
        )
        remedy = " or ".join(f'"near {text}{suffix}"' for text in texts)
        raise Unusable(message, f"Write {remedy}", group.joint, near.words)
    return both[k], group.modes[k] + suffix


def _read_place(raw: object) -> tuple[Quantity, Quantity]:
    pair = check_pair(raw, "a place is a list of two coordinates", 'Write ["100 mm", "0 mm"]')
    coordinates = []
    for axis, coordinate in zip("xy", pair, strict=True):
        try:
            coordinates.append(read_quantity(coordinate, "coordinate"))
        except Unusable as error:
            raise Unusable(error.message, error.remedy, axis, coordinate) from None
    return coordinates[0], coordinates[1]


Place = Annotated[Any, BeforeValidator(_read_place)]


def _read_mode(raw: object, read: Callable[[object], Any]) -> Any:
    """Read one of the assembly modes, or the place of the joint."""
    if read_near(raw) is not None:
        return raw
    return read(", ".join(part.strip() for part in raw.split(",")) if isinstance(raw, str) else raw)


def _check_place(raw: str) -> str:
    read_near(raw)
    return raw


EQUAL = 1e-10
"""Share of their length by which opposite links of a parallelogram may differ."""


class FourBarSection(Section):
    """A four-bar with fixed or free lengths: pivots A and D on the frame, joints B and C, further points on the coupler.

    Without `pivot` (of the crank, A) and `direction` (of the frame A -> D), A lies in the origin and D on the x axis.
    """

    by_lengths: ClassVar[bool] = True
    """Whether the file states the lengths of a four-bar, so that its parts have the names of a textbook."""

    type: Literal["four-bar"] = "four-bar"
    """Optional: the default for a mechanism without links."""
    crank: Length
    """Length A-B."""
    coupler: Length
    """Length B-C."""
    rocker: Length
    """Length D-C."""
    frame: Length
    """Length A-D."""
    points: dict[Name, Place] = Field(default_factory=dict)
    """Further points of the coupler: distance from B towards C, and distance to the left of that line."""
    pivot: Place | None = None
    """Position of the crank pivot A; default: the origin."""
    direction: Angle | None = None
    """Angle of the frame A -> D from +x; default: 0."""
    assembly: Annotated[
        Literal[
            "left",
            "right",
            "either",
            "continue",
            "left, continue",
            "right, continue",
            "parallelogram",
            "antiparallelogram",
        ],
        WrapValidator(_read_mode),
    ] = "left"
    """Side of B -> D on which the joint C lies, or its place where the drive starts: `near [12 mm, 40 mm]`; `either`: both are
    searched. With `continue` this is the side at the start, and the motion continues smoothly through change points; a
    parallelogram or antiparallelogram remains one."""

    @property
    def side(self) -> int:
        """Assembly mode: +1 left, -1 right of B -> D; for parallelograms at a crank angle of 90 deg."""
        return -1 if self.assembly in ("right", "right, continue", "antiparallelogram") else 1

    @property
    def follows(self) -> bool:
        """Whether the motion continues through change points."""
        return self.assembly not in ("left", "right", "either")

    @property
    def near(self) -> dict[str, NearPlace]:
        """The place of the joint C, by its name, if it determines the assembly mode."""
        place = read_near(self.assembly)
        return {} if place is None else {"C": place}

    def with_modes(self, modes: Mapping[str, str]) -> Self:
        """Return the section with the assembly mode of C in place of its position."""
        return self.model_copy(update={"assembly": modes["C"].replace(" of B-D", "")})

    def check_mode(self, sizes: Mapping[str, Any]) -> None:
        """Refuse an assembly mode that four-bars of these lengths do not have.

        Raises
        ------
        Unusable
            when opposite links of a parallelogram differ in length.
        """
        crank, coupler, rocker, frame = (sizes[name] for name in LENGTHS)
        if "parallelogram" in self.assembly:
            for one, other, names in ((crank, rocker, "crank and rocker"), (coupler, frame, "coupler and frame")):
                if abs(one - other) > EQUAL * max(one, other):
                    message = f"{names} of a parallelogram are equally long, and these differ by {abs(one - other) * 1e3:.6g} mm"
                    raise Unusable(message, 'Change the lengths, or write "left" or "right"', "mechanism.assembly", self.assembly)

    @property
    def placed(self) -> bool:
        """Whether the file defines the pose of the frame."""
        return self.pivot is not None or self.direction is not None

    @cached_property
    def quantities(self) -> dict[str, Quantity]:
        """The four lengths; P.along and P.across of each point; A.x, A.y and direction if the pose of the frame is defined."""
        quantities = {name: getattr(self, name) for name in LENGTHS}
        for point, (along, across) in self.points.items():
            quantities[f"{point}.along"], quantities[f"{point}.across"] = along, across
        if self.placed:
            nowhere = Quantity(0.0, "coordinate", "mm")
            quantities["A.x"], quantities["A.y"] = self.pivot or (nowhere, nowhere)
            quantities["direction"] = self.direction or Quantity(0.0, "angle", "deg")
        return quantities

    def linkage(self, name: str, driver: str | None, drives: Sequence[Drive] = ()) -> Mechanism:
        """Return the kinematic model, driven at the body `driver`; an undetermined assembly mode counts as left.

        Raises
        ------
        Unusable
            when another body is driven, or a point has a reserved name.
        """
        if driver not in (None, "crank"):
            message, remedy = "a four-bar is driven at its crank", 'Leave body out, or write body = "crank"'
            if driver in ("coupler", "rocker"):
                missing, remedy = unsupported("drive of a four-bar", body=driver)
                message = f"{message}: {missing}"
            raise Unusable(message, remedy, "drive.body", driver)
        for point in self.points:
            if point in RESERVED or point in "ABCD" or point in LENGTHS:
                raise Unusable(f"{point} is a name of the four-bar itself", "Choose another", "mechanism.points", point)
        upright = 0.5 * math.pi if "parallelogram" in self.assembly else None
        return four_bar(self.side, self.points, placed=self.placed, follow=self.follows, holds_at=upright)

    def with_open_modes(self, mechanism: Mechanism) -> Self:
        """Return the section with every assembly mode left open."""
        return self.model_copy(update={"assembly": EITHER})

    def variants(self, mechanism: Mechanism) -> list[dict[str, str]]:
        """Return changes of the file that determine the assembly modes left open, one per combination."""
        return [{"mechanism.assembly": side} for side in ("left", "right")] if self.assembly == EITHER else [{}]

    @property
    def inertias(self) -> dict[str, Inertia]:
        """Mass properties of elements: none, as a four-bar has links alone."""
        return {}

    @property
    def friction(self) -> dict[str, float]:
        """Coefficients of friction: none, as a four-bar has no guides."""
        return {}


def _read_joints(raw: object) -> tuple[str, ...]:
    if not isinstance(raw, list | tuple) or not 1 <= len(raw) <= 2 or not all(isinstance(name, str) for name in raw):
        remedy = 'Write joints = ["B", "C"] (more under points), or joints = ["E"] for a body that a guide carries'
        raise Unusable("expected the names of one or two joints", remedy)
    return tuple(raw)


def _read_through(raw: object) -> Any:
    return raw if isinstance(raw, str) else _read_place(raw)


class LinkSection(Section):
    """A moving body: one or two joints, their distance, and further points (along and across the line of the two)."""

    joints: Annotated[tuple[Name, ...], BeforeValidator(_read_joints)]
    """Names of its two joints, or of its only joint if the body is on a guide."""
    length: Length | None = None
    """Distance of its two joints; not for a body with one joint."""
    points: dict[Name, Place] = Field(default_factory=dict)
    """Further points: distance along the line from the first to the second joint, and distance to the left of it."""


class GuideSection(Section):
    """A sliding joint: a line on one body, along which another body slides without rotating relative to it."""

    slider: str
    """The body that slides."""
    on: str = FRAME
    """The body that carries the line."""
    through: Annotated[Any, BeforeValidator(_read_through)] = None
    """A point of that body, or coordinates in its axes; default: the first joint of that body. Required on the frame."""
    direction: Angle | None = None
    """Angle of the line relative to the x axis of that body; default: 0."""
    offset: Coordinate | None = None
    """Distance of the line from `through`, positive to the left; default: 0."""
    at: str = ""
    """The point of the slider that moves on the line; default: its first joint."""
    tilt: Angle | None = None
    """Angle of the slider's x axis relative to the line; default: 0."""
    friction: Friction = 0.0
    """Coulomb friction coefficient, below 10."""


class DyadsSection(Section):
    """Any linkage of a driving crank and dyads: points on the ground, links, guides, assembly modes."""

    by_lengths: ClassVar[bool] = False
    """Whether the file states the lengths of a four-bar, so that its parts have the names of a textbook."""

    type: Literal["dyads"] = "dyads"
    """Optional: the default for a mechanism with links."""
    ground: dict[Name, Place]
    """Points on the frame."""
    links: dict[Name, LinkSection]
    """Every moving body."""
    guides: dict[Name, GuideSection] = Field(default_factory=dict)
    """Sliding joints."""
    cylinders: dict[Name, CylinderSection] = Field(default_factory=dict)
    """Links whose length is driven."""
    slots: dict[Name, SlotSection] = Field(default_factory=dict)
    """Pins in straight slots."""
    gears: dict[Name, GearSection] = Field(default_factory=dict)
    """Gears, and other fixed ratios of two angles."""
    racks: dict[Name, RackSection] = Field(default_factory=dict)
    """Racks and pinions."""
    belts: dict[Name, BeltSection] = Field(default_factory=dict)
    """Belts and chains."""
    cams: dict[Name, CamSection] = Field(default_factory=dict)
    """Disc cams and their followers."""
    assembly: dict[str, Annotated[str, AfterValidator(_check_place)]] = Field(default_factory=dict)
    """Assembly mode of each group: for an RRR joint `left of B-D` or `right of B-D`, for an RRP pin or an RPR guide `forward` or
    `backward`; for a pin also its place where the drive starts, `near [12 mm, 40 mm]`. With `left of B-D, continue` this is the
    mode at the start, and the motion continues smoothly through change points. In a design problem also `either`."""

    @property
    def follows(self) -> bool:
        """Whether the motion continues through change points in any group."""
        return any(mode.rpartition(",")[2].strip() == CONTINUE for mode in self.assembly.values())

    @property
    def near(self) -> dict[str, NearPlace]:
        """The places of joints that determine the assembly modes of their groups."""
        places = {joint: read_near(mode) for joint, mode in self.assembly.items()}
        return {joint: place for joint, place in places.items() if place is not None}

    def with_modes(self, modes: Mapping[str, str]) -> Self:
        """Return the section with other assembly modes."""
        return self.model_copy(update={"assembly": {**self.assembly, **modes}})

    def check_mode(self, sizes: Mapping[str, Any]) -> None:
        """Accept any lengths: dyads of any lengths have their assembly modes."""

    @cached_property
    def quantities(self) -> dict[str, Quantity]:
        """Every dimension of the file by name: D.x, crank.length, link2.P.along, F.offset, F.direction."""
        quantities = {}
        for point, (x, y) in self.ground.items():
            quantities[f"{point}.x"], quantities[f"{point}.y"] = x, y
        for name, link in self.links.items():
            if link.length is not None:
                quantities[f"{name}.length"] = link.length
            for point, (along, across) in link.points.items():
                quantities[f"{name}.{point}.along"], quantities[f"{name}.{point}.across"] = along, across
        for table, keys in DIMENSIONS.items():
            for name, entry in getattr(self, table).items():
                if isinstance(getattr(entry, "through", None), tuple):
                    quantities[f"{name}.x"], quantities[f"{name}.y"] = entry.through
                for key in (key for key in keys if states(entry, key)):
                    value = getattr(entry, key)
                    both = zip(BOTH, value, strict=True) if isinstance(value, tuple) else [("", value)]
                    quantities |= {f"{name}.{key}.{which}".rstrip("."): one for which, one in both}
        return quantities

    @property
    def inertias(self) -> dict[str, Inertia]:
        """Mass properties of the parts of cylinders."""
        return {body: part for name, one in self.cylinders.items() for body, part in one.inertias(name).items()}

    @property
    def friction(self) -> dict[str, float]:
        """Coefficients of friction of the guides with friction."""
        return {name: guide.friction for name, guide in self.guides.items() if guide.friction}

    def with_open_modes(self, mechanism: Mechanism) -> Self:
        """Return the section with every assembly mode left open."""
        return self.model_copy(update={"assembly": {group.joint: EITHER for group in mechanism.groups if group.modes}})

    def variants(self, mechanism: Mechanism) -> list[dict[str, str]]:
        """Return changes of the file that determine the assembly modes left open, one per combination."""
        variants: list[dict[str, str]] = [{}]
        for group in mechanism.groups:
            if self.assembly.get(group.joint) == EITHER:
                variants = [
                    {**variant, f"mechanism.assembly.{group.joint}": mode} for variant in variants for mode in group.modes
                ]
        return variants

    def linkage(self, name: str, driver: str | None, drives: Sequence[Drive] = ()) -> Mechanism:
        """Return the kinematic model, driven at the body `driver`, or by `drives` if it is empty.

        Undetermined assembly modes count as left or forward.

        Raises
        ------
        Unusable
            when the bodies do not form a chain of dyads.
        """
        self._check_names()
        links = list(self._links())
        body = driver if drives else driver or ("crank" if "crank" in self.links else None)
        if body is None:
            other = f", or cylinder, one of: {', '.join(self.cylinders)}" if self.cylinders else ""
            raise Unusable("no body is driven", f"Add [drive] body, one of: {', '.join(self.links)}{other}", "drive.body")
        if body:
            check_name(body, self.links, "no such body", "drive.body")
        points = [
            BodyPoint(point, name_of, f"{name_of}.{point}.along", f"{name_of}.{point}.across")
            for name_of, link in self.links.items()
            for point in link.points
        ]
        guides = list(self._guides())
        ground: dict[str, tuple[Size, Size]] = {point: (f"{point}.x", f"{point}.y") for point in self.ground}
        modes = {**self.assembly, **dict.fromkeys(self.near, EITHER)}
        with below("mechanism"), self._tables_of_bodies():
            elements = list(
                couplings({kind: getattr(self, kind) for kind in ELEMENTS}, self._parts(name, ground, links, points, guides))
            )
            return Assembly(ground, links, points, guides, body or "", modes, drives, elements).mechanism(name)

    @contextmanager
    def _tables_of_bodies(self) -> Iterator[None]:
        """Name the table of a body in an `Unusable`: cylinders and slots are links of the model, but not in the file."""
        try:
            yield
        except Unusable as error:
            table, _, name = error.key.partition(".")
            own = (kind for kind in ("cylinders", "slots") if table == "links" and name.partition(".")[0] in getattr(self, kind))
            error.key = f"{next(own, table)}.{name}" if name else table
            raise

    def _parts(
        self, name: str, ground: Mapping[str, tuple[Size, Size]], links: list[Link], points: list[BodyPoint], guides: list[Guide]
    ) -> Parts:
        """Return the parts of the linkage, to which elements refer."""
        others = Train(tuple(Single(link, "") for link in links[1:]), ())
        bare = Mechanism("", ground, links[0], (), tuple(points), tuple(guides), trains=(others,))
        return Parts(Pose(bare, sizes_of(self.quantities)), bare.owners)

    def _links(self) -> Iterator[Link]:
        for name, link in self.links.items():
            key = f"mechanism.links.{name}"
            start, end = (*link.joints, "")[:2]
            if end and link.length is None:
                raise Unusable("a link with two joints needs a length", 'Add length = "100 mm"', f"{key}.length")
            if not end and link.length is not None:
                raise Unusable("a body with one joint has no length", 'Add its other joint: joints = ["B", "C"]', f"{key}.joints")
            names = [start, *([end] if end else []), *link.points]
            for point in names:
                if names.count(point) > 1:
                    raise Unusable("the point is given twice", "Remove one of the two, or rename it", key, point)
            yield Link(name, start, end, f"{name}.length" if end else 0.0)
        for name, cylinder in self.cylinders.items():
            with below(f"mechanism.cylinders.{name}"):
                yield cylinder.link(name)
        for name, slot in self.slots.items():
            yield Link(name, slot.pin)

    def _guides(self) -> Iterator[Guide]:
        for name, guide in self.guides.items():
            key = f"mechanism.guides.{name}"
            check_name(guide.slider, self.links, "no such body", f"{key}.slider")
            check_name(guide.on, [*self.links, FRAME], "no such body", f"{key}.on")
            if guide.slider == guide.on:
                raise Unusable("a body cannot slide on itself", "Name the body that carries the line", f"{key}.on", guide.on)
            through: str | tuple[Size, Size]
            if isinstance(guide.through, tuple):
                through = (f"{name}.x", f"{name}.y")
            elif guide.through is None:
                if guide.on == FRAME:
                    example = f'through = "{next(iter(self.ground), "D")}", or through = ["0 mm", "575 mm"]'
                    raise Unusable("a guide on the frame needs a point on its line", f"Add {example}", f"{key}.through")
                through = self.links[guide.on].joints[0]
            else:
                through = self._point(guide.through, guide.on, f"{key}.through")
            at = self._point(guide.at, guide.slider, f"{key}.at") if guide.at else ""
            sizes = {k: f"{name}.{k}" if getattr(guide, k) is not None else 0.0 for k in ("direction", "offset", "tilt")}
            yield Guide(name, guide.slider, guide.on, through, at=at, **sizes)
        for name, slot in self.slots.items():
            key = f"mechanism.slots.{name}"
            check_name(slot.on, [*self.links, FRAME], "no such body", f"{key}.on")
            if slot.through is None and slot.on == FRAME:
                raise Unusable("a slot in the frame needs a point on its middle line", 'Add through = "D"', f"{key}.through")
            through = (
                self.links[slot.on].joints[0] if slot.through is None else self._point(slot.through, slot.on, f"{key}.through")
            )
            yield Guide(name, name, slot.on, through, 0.0 if slot.direction is None else f"{name}.direction")

    def _point(self, point: str, body: str, key: str) -> str:
        names = [*self.ground] if body == FRAME else [*self.links[body].joints, *self.links[body].points]
        check_name(point, names, f"{body} has no such point", key)
        return point

    def _check_names(self) -> None:
        seen: dict[str, str] = {}
        points = dict.fromkeys([*self.ground, *(p for link in self.links.values() for p in (*link.joints, *link.points))])
        points |= dict.fromkeys(joint for cylinder in self.cylinders.values() for joint in cylinder.joints)
        kinds = (
            ("body", self.links),
            ("cylinder", self.cylinders),
            ("slot", self.slots),
            ("point", points),
            ("guide", self.guides),
        )
        for kind, names in kinds:
            for name in names:
                if name in RESERVED:
                    raise Unusable(f"{name} is a reserved name", "Choose another", "mechanism", name)
                if name in seen:
                    raise Unusable(f"{name} names a {seen[name]} and a {kind}", "Rename one of them", "mechanism", name)
                seen[name] = kind
        coupled = [(kind, name, entry) for kind in ELEMENTS for name, entry in getattr(self, kind).items()]
        stated = [(kind, name, key) for kind, name, entry in coupled for key in DIMENSIONS[kind] if states(entry, key)]
        for at, (kind, *of) in enumerate(stated):
            if of in [other for _, *other in stated[:at]]:
                raise Unusable(f"two couplings have this name and a {of[1]}", "Rename one of them", f"mechanism.{kind}", of[0])
        if not self.ground:
            raise Unusable("there is no ground pivot", 'Add A = ["0 mm", "0 mm"]', "mechanism.ground")
        if not self.links:
            raise Unusable("no link is given", 'Add crank = { joints = ["A", "B"], length = "100 mm" }', "mechanism.links")


def check_one_mode(mechanism: FourBarSection | DyadsSection) -> None:
    """Refuse a design problem for a linkage that passes through change points.

    Raises
    ------
    Unusable
        with the key of the assembly mode.
    """
    if mechanism.follows:
        message = "a linkage is designed for one assembly mode, without change points"
        if isinstance(mechanism, FourBarSection):
            raise Unusable(message, 'Write "left", "right" or "either"', "mechanism.assembly", mechanism.assembly)
        joint, mode = next((joint, mode) for joint, mode in mechanism.assembly.items() if CONTINUE in mode)
        raise Unusable(message, f'Take "{CONTINUE}" out', f"mechanism.assembly.{joint}", mode)


def moving_points(mechanism: Mechanism) -> list[str]:
    """Return the names of the points that move."""
    return [point for point, bodies in mechanism.owners.items() if FRAME not in bodies]


def sizes_of(quantities: Mapping[str, Quantity]) -> dict[str, float]:
    """Return the values [SI] of quantities; the start of design variables."""
    return {name: quantity.value for name, quantity in quantities.items()}
