"""The five dyads as data: assembled from bodies and joints, over random sizes, against geometry written a second time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from optlink.linkage import dyads as groups_module
from optlink.linkage.assur import Assembly, StructureError
from optlink.linkage.mechanism import FRAME, BodyPoint, Guide, Link, Mechanism
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.vector2d import unit
from tests.dynamics.test_inverse import EXAMPLES
from tests.tiers import examples

seeded = examples(100)
fewer = examples(40)

KINDS = ("RRR", "RRP", "RPR", "RPP", "PRP")
every_kind = pytest.mark.parametrize("kind", KINDS)
with_modes = pytest.mark.parametrize("kind", KINDS[:3])

length = st.floats(0.1, 1.0)
small = st.floats(-0.3, 0.3)
wide = st.floats(-1.0, 1.0)
turn = st.floats(-math.pi, math.pi)
place = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
sides = st.sampled_from([1, -1])

# --- a crank and one dyad, of any sizes ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Parts:
    """What `Assembly` is given."""

    ground: dict[str, tuple[float, float]]
    links: tuple[Link, ...]
    points: tuple[BodyPoint, ...] = ()
    guides: tuple[Guide, ...] = ()
    modes: dict[str, str] = field(default_factory=dict)

    @property
    def mechanism(self) -> Mechanism:
        return Assembly(self.ground, self.links, self.points, self.guides, "crank", self.modes).mechanism("test")

    def pose(self, phi: float):
        return self.mechanism.pose({}, unit(phi))

    def guide(self, name: str) -> Guide:
        return next(guide for guide in self.guides if guide.name == name)

    def local(self, body: str, point: str) -> np.ndarray:
        """A point in the axes of its body."""
        if body == FRAME:
            return np.array(self.ground[point])
        link = next(link for link in self.links if link.body == body)
        own = [p for p in self.points if (p.body, p.name) == (body, point)]
        if own:
            return np.array([own[0].along, own[0].across])
        return np.array([link.length if point == link.end else 0.0, 0.0])


MODES = {1: "forward", -1: "backward"}
TURNS = {1: "left", -1: "right"}


@st.composite
def dyads(draw: Callable, kind: str) -> Parts:
    """A crank at the origin and a dyad whose joints are points of bodies off their axes, its guides anywhere on their bodies."""
    crank, d = Link("crank", "A", "B", draw(length)), draw(place)
    side = draw(sides)

    def mark(name: str, body: str) -> BodyPoint:
        return BodyPoint(name, body, draw(small), draw(small))

    def guide(name: str, slider: str, on: str, at: str) -> Guide:
        offset = draw(wide if kind == "RPR" else small)  # only a large one keeps a crank slide from closing
        return Guide(name, slider, on, (draw(small), draw(small)), draw(turn), offset, at, draw(turn))

    ground = {"A": (0.0, 0.0), "D": d}
    if kind == "RRR":
        links = (crank, Link("one", "B", "E", draw(length)), Link("two", "T"))
        points = (BodyPoint("C", "one", draw(length), draw(small)), BodyPoint("C", "two", draw(length), 0.1), mark("D", "two"))
        return Parts(ground, links, points, (), {"C": f"{TURNS[side]} of B-D"})
    ground = {"A": (0.0, 0.0), "D": d} if kind == "RPR" else {"A": (0.0, 0.0)}
    if kind == "RRP":
        links = (crank, Link("one", "B", "E", draw(length)), Link("two", "T", "U", draw(length)))
        points = (BodyPoint("C", "one", draw(length), draw(small)), mark("C", "two"), mark("N", "two"))
        return Parts(ground, links, points, (guide("way", "two", FRAME, "N"),), {"C": MODES[side]})
    if kind == "RPR":
        links = (crank, Link("one", "S"), Link("two", "T", "U", draw(length)))
        points = (mark("B", "one"), mark("N", "one"), mark("D", "two"))
        return Parts(ground, links, points, (guide("way", "one", "two", "N"),), {"way": MODES[side]})
    if kind == "RPP":
        links = (crank, Link("one", "S"), Link("two", "T", "U", draw(length)))
        points = (mark("B", "one"), mark("N", "one"), mark("M", "two"))
        return Parts(ground, links, points, (guide("way", "one", "two", "N"), guide("rail", "two", FRAME, "M")))
    links = (crank, Link("one", "S"), Link("two", "T", "U", draw(length)))
    points = (mark("C", "one"), mark("C", "two"), mark("N", "one"), mark("M", "two"))
    return Parts(ground, links, points, (guide("way", "one", "crank", "N"), guide("rail", "two", FRAME, "M")))


def radius(parts: Parts, body: str, p: str, q: str) -> float:
    return float(np.hypot(*(parts.local(body, p) - parts.local(body, q))))


def directed(angle: float) -> np.ndarray:
    return np.array([math.cos(angle), math.sin(angle)])


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def rail(parts: Parts, guide: Guide) -> tuple[np.ndarray, np.ndarray]:
    """A point and the direction of a guide's line in the axes of the body that carries it."""
    way = directed(guide.direction)
    through = parts.local(guide.on, guide.through) if isinstance(guide.through, str) else np.array(guide.through)
    return through + guide.offset * np.array([-way[1], way[0]]), way


def offset_on_slider(parts: Parts, guide: Guide, point: str) -> float:
    """How far to the left of its line a point of a slider is."""
    lever = parts.local(guide.slider, point) - parts.local(guide.slider, guide.at)
    return float(cross(directed(-guide.tilt), lever))


def offset_on_carrier(parts: Parts, guide: Guide, point: str) -> float:
    begin, way = rail(parts, guide)
    return float(cross(way, parts.local(guide.on, point) - begin))


def apart(parts: Parts, kind: str, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    """By how much the dyad fails to close if its first body (RPR: the line) is turned to the angle t."""
    ray = np.stack([np.cos(t), np.sin(t)], axis=-1)
    if kind == "RRR":
        end = b + radius(parts, "one", "B", "C") * ray
        return np.abs(np.hypot(*(end - parts.ground["D"]).T) - radius(parts, "two", "D", "C"))
    guide = parts.guide("way")
    if kind == "RRP":
        begin, way = rail(parts, guide)
        end = b + radius(parts, "one", "B", "C") * ray
        return np.abs(cross(way, end - begin) - offset_on_slider(parts, guide, "C"))
    offset = offset_on_slider(parts, guide, "B") - offset_on_carrier(parts, guide, "D")
    return np.abs(cross(ray, b - np.array(parts.ground["D"])) - offset)


def least(function: Callable[[np.ndarray], np.ndarray]) -> float:
    """Smallest value over a whole turn, by narrowing dense sweeps."""
    centre, width = 0.0, math.pi
    for _ in range(7):
        near = centre + width * np.linspace(-1.0, 1.0, 721)
        centre, width = float(near[np.argmin(function(near))]), width / 60.0
    return float(np.min(function(near)))


def check_joints(parts: Parts, motion: Motion) -> None:
    """Every point is where each of its bodies has it, every slider on its line and turned as the line says."""
    angles = {FRAME: np.zeros(motion.crank_angle.shape)}
    places = {}
    for link in parts.links:
        angles[link.body] = motion.body_angle(link.body).value
    for body, angle in angles.items():
        c, s = np.cos(angle), np.sin(angle)

        def material(v: np.ndarray, body: str = body, c: np.ndarray = c, s: np.ndarray = s) -> np.ndarray:
            start = 0.0 if body == FRAME else motion.position(next(k.start for k in parts.links if k.body == body))
            return start + np.stack([c * v[0] - s * v[1], s * v[0] + c * v[1]], axis=-1)

        places[body] = material
    for link in parts.links:
        for point in filter(None, (link.start, link.end, *(p.name for p in parts.points if p.body == link.body))):
            own = places[link.body](parts.local(link.body, point))
            np.testing.assert_allclose(own, motion.position(point), rtol=0.0, atol=1e-9, err_msg=f"{point} of {link.body}")
    for guide in parts.guides:
        begin, way = rail(parts, guide)
        line = places[guide.on](way) - places[guide.on](np.zeros(2))
        runner = places[guide.slider](parts.local(guide.slider, guide.at))
        off = cross(line, runner - places[guide.on](begin))
        np.testing.assert_allclose(off, 0.0, atol=1e-9 * (1.0 + np.max(np.abs(runner))), err_msg=guide.name)
        turned = angles[guide.slider] - angles[guide.on] - guide.direction - guide.tilt
        np.testing.assert_allclose(np.cos(turned), 1.0, atol=1e-12, err_msg=guide.name)
        np.testing.assert_allclose(np.sin(turned), 0.0, atol=1e-9, err_msg=guide.name)
        slid = np.sum(line * (runner - places[guide.on](begin)), axis=-1)
        np.testing.assert_allclose(motion.slide(guide.name).value, slid, rtol=1e-9, atol=1e-9)


def check_side(parts: Parts, kind: str, motion: Motion) -> None:
    """On which side of its dead position the dyad is: that of the mode."""
    b = motion.position("B")
    if kind == "RRR":
        sense = cross(motion.position("D") - b, motion.position("C") - b)
        assert np.all(sense * (1.0 if parts.modes["C"].startswith("left") else -1.0) > 0.0)
    elif kind == "RRP":
        _, way = rail(parts, parts.guide("way"))
        sense = (motion.position("C") - b) @ way  # the foot of B on the line is as far along it as B
        assert np.all(sense * (1.0 if parts.modes["C"] == "forward" else -1.0) > 0.0)
    elif kind == "RPR":
        angle = motion.body_angle("two").value + parts.guide("way").direction
        sense = np.sum((b - motion.position("D")) * np.stack([np.cos(angle), np.sin(angle)], axis=-1), axis=-1)
        assert np.all(sense * (1.0 if parts.modes["way"] == "forward" else -1.0) > 0.0)


ANGLES = 0.1 + np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)


def closing(parts: Parts, phi: np.ndarray = ANGLES) -> np.ndarray:
    """The crank angles at which the dyad is well away from a dead position, from lines that are parallel, and from failing."""
    mechanism = parts.mechanism
    with np.errstate(all="ignore"):
        margin = sweep(mechanism, {}, phi).margin(mechanism.groups[0].joint)
    return phi[margin > 0.02]


# --- where the joints are ------------------------------------------------------------------------------------------------------


@every_kind
def test_the_joints_hold_and_the_side_is_that_of_the_mode(kind):
    met = []

    @seeded
    @given(dyads(kind))
    def holds(parts):
        assert [group.kind for group in parts.mechanism.groups] == [kind]
        phi = closing(parts)
        assume(phi.size)
        met.append(phi.size)
        motion = sweep(parts.mechanism, {}, phi)
        check_joints(parts, motion)
        check_side(parts, kind, motion)

    holds()
    assert sum(met) > 100


@with_modes
def test_the_other_mode_is_another_position(kind):
    """Both modes of the same sizes: each on its own side, and not in one place."""

    @fewer
    @given(dyads(kind))
    def differs(parts):
        swap = {"left": "right", "right": "left", "forward": "backward", "backward": "forward"}
        (joint, mode), *_ = parts.modes.items()
        first, *rest = mode.split(" ", 1)
        other = replace(parts, modes={joint: " ".join([swap[first], *rest])})
        phi = closing(parts)
        assume(phi.size)
        np.testing.assert_array_equal(closing(other), phi)
        motion = sweep(other.mechanism, {}, phi)
        check_joints(other, motion)
        check_side(other, kind, motion)
        with pytest.raises(AssertionError):
            check_side(parts, kind, motion)

    differs()


@with_modes
def test_a_dyad_closes_iff_its_margin_is_not_negative_and_its_gap_is_the_distance(kind):
    met = {True: 0, False: 0}

    @settings(max_examples=100)  # fewer do not meet both kinds
    @given(dyads(kind), turn)
    def closes(parts, phi):
        pose = parts.pose(phi)
        (group,) = parts.mechanism.groups
        margin, gap = float(pose.margins[group.joint]), float(group.gap(pose))
        b = np.array([float(v) for v in pose.points["B"]])
        missing = least(lambda t: apart(parts, kind, b, t))
        assume(abs(gap) > 1e-3)
        met[gap > 0.0] += 1
        assert (margin < 0.0) == (gap > 0.0)
        solved = [coordinate for name in ("T", "C") if name in pose.points for coordinate in pose.points[name]]
        if gap > 0.0:
            np.testing.assert_allclose(gap, missing, rtol=1e-6, atol=1e-9)
            assert np.all(np.isnan(solved))
        else:
            assert missing < 1e-6
            assert np.all(np.isfinite(solved))

    closes()
    assert min(met.values()) >= 5, "both kinds are met"  # examples vary with the constants in the source


def test_gap_and_margin_check_see_links_that_do_not_reach():
    """By hand: B and D are 5 apart, the links 1 and 3 long; the pins of a slider 0.3 apart, its offset 0.5."""
    ground, crank = {"A": (0.0, 0.0), "D": (6.0, 0.0)}, Link("crank", "A", "B", 1.0)
    links = (crank, Link("one", "B", "C", 1.0), Link("two", "D", "C", 3.0))
    for phi, expected in ((0.0, 5.0 - 4.0), (math.pi, 7.0 - 4.0)):
        parts = Parts(ground, links, modes={"C": "left of B-D"})
        pose = parts.pose(phi)
        np.testing.assert_allclose(parts.mechanism.groups[0].gap(pose), expected, rtol=1e-14)
        assert pose.margins["C"] < 0.0
    near = Parts({"A": (0.0, 0.0), "D": (1.5, 0.0)}, links, modes={"C": "left of B-D"})
    np.testing.assert_allclose(near.mechanism.groups[0].gap(near.pose(0.0)), 2.0 - 0.5, rtol=1e-14)  # too near
    arm = (crank, Link("one", "B"), Link("two", "D"))
    tight = Parts({"A": (0.0, 0.0), "D": (1.3, 0.0)}, arm, (), (Guide("way", "one", "two", offset=0.5),), {"way": "forward"})
    pose = tight.pose(0.0)
    np.testing.assert_allclose(tight.mechanism.groups[0].gap(pose), 0.5 - 0.3, rtol=1e-12)
    np.testing.assert_allclose(pose.margins["way"], 1.0 - (0.5 / 0.3) ** 2, rtol=1e-12)
    rod = (crank, Link("one", "B", "C", 0.6), Link("two", "C"))
    low = Parts({"A": (0.0, 0.0)}, rod, (), (Guide("way", "two", offset=-0.2),), {"C": "forward"})
    pose = low.pose(math.pi / 2)
    np.testing.assert_allclose(low.mechanism.groups[0].gap(pose), 1.2 - 0.6, rtol=1e-12)
    np.testing.assert_allclose(pose.margins["C"], 1.0 - 4.0, rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS[3:])
def test_lines_that_cross_always_close_and_parallel_ones_never(kind):
    @seeded
    @given(dyads(kind), turn)
    def crosses(parts, phi):
        pose = parts.pose(phi)
        (group,) = parts.mechanism.groups
        joint = group.joint
        way, beside = parts.guide("way"), parts.guide("rail")
        between = phi + way.direction - beside.direction if kind == "PRP" else way.direction + beside.tilt
        np.testing.assert_allclose(pose.margins[joint], math.sin(between) ** 2, rtol=1e-9, atol=1e-12)
        assert not group.gap(pose) > 0.0
        parallel = -beside.tilt if kind == "RPP" else beside.direction - phi
        guides = (replace(way, direction=parallel), beside)
        flat = sweep(replace(parts, guides=guides).mechanism, {}, [phi])
        assert flat.margin(joint) < 1e-24
        assert not np.all(np.abs(flat.position("T")) < 1e9)  # infinite, but for rounding

    crosses()


# --- velocities and accelerations ---------------------------------------------------------------------------------------------


def check_rates(parts: Parts, phi: np.ndarray, motion: Motion) -> None:
    """Points, angles of bodies and slides against five-point differences in time, the crank at a changing speed."""
    speed, acceleration = float(motion.speed), float(motion.crank_acceleration)
    h = 2e-4 / abs(speed)
    mechanism = parts.mechanism
    turned = [phi + (speed + 0.5 * acceleration * k * h) * k * h for k in (-2, -1, 0, 1, 2)]
    steps = [sweep(mechanism, {}, angle) for angle in turned]

    def compare(read: Callable[[Motion], np.ndarray], rate: np.ndarray, second: np.ndarray, what: str) -> None:
        beyond, back, here, near, far = (read(step) for step in steps)
        first = (8.0 * (near - back) - (far - beyond)) / (12.0 * h)
        twice = (16.0 * (near + back) - (far + beyond) - 30.0 * here) / (12.0 * h**2)
        size = max(1.0, float(np.max(np.abs(here))))
        for computed, expected, tolerance, unit_of in ((rate, first, 1e-7, abs(speed)), (second, twice, 1e-4, speed**2)):
            scale = max(float(np.max(np.abs(expected))), size * unit_of)
            np.testing.assert_allclose(computed, expected, rtol=0.0, atol=tolerance * scale, err_msg=what)

    for point in mechanism.owners:
        compare(lambda m, point=point: m.position(point), motion.velocity(point), motion.acceleration(point), point)
    for link in mechanism.links:
        angle = motion.body_angle(link.body)

        def read(m: Motion, body: str = link.body, near: np.ndarray = angle.value) -> np.ndarray:
            return near + np.remainder(m.body_angle(body).value - near + np.pi, 2.0 * np.pi) - np.pi

        compare(read, angle.rate, angle.acceleration, link.body)
    for guide in parts.guides:
        slide = motion.slide(guide.name)
        compare(lambda m, guide=guide: m.slide(guide.name).value, slide.rate, slide.acceleration, guide.name)


@every_kind
def test_rates_are_the_differences_of_positions(kind):
    met = []

    @fewer
    @given(dyads(kind), st.sampled_from([(1.0, 0.0), (-2.5, 3.0), (6.0, -20.0)]))
    def differ(parts, drive):
        with np.errstate(all="ignore"):
            margin = sweep(parts.mechanism, {}, ANGLES).margin(parts.mechanism.groups[0].joint)
        phi = ANGLES[margin > 0.15]  # differences over a finite step need a smooth motion
        if kind in ("RRR", "RRP"):
            assume(radius(parts, "one", "B", "C") > 0.25)
        if kind in ("RRR", "RPR"):  # where B passes D the group turns too fast for a finite step
            b, d = np.stack([np.cos(phi), np.sin(phi)], axis=-1) * parts.links[0].length, parts.ground["D"]
            phi = phi[np.hypot(*(b - d).T) > 0.3]
        assume(phi.size)
        met.append(phi.size)
        check_rates(parts, phi, sweep(parts.mechanism, {}, phi, *drive))

    differ()
    assert sum(met) > 50


def test_rate_check_detects_a_wrong_speed_and_a_missing_acceleration():
    example = by_hand("RRP")
    motion = sweep(example.mechanism, {}, ANGLES, 2.0, 5.0)
    check_rates(example, ANGLES, motion)
    with pytest.raises(AssertionError):
        check_rates(example, ANGLES, replace(motion, crank_acceleration=-5.0))
    with pytest.raises(AssertionError):
        check_rates(example, ANGLES, replace(motion, speed=-2.0))


@cache
def by_hand(kind: str) -> Parts:
    """One dyad of each kind that moves through the whole revolution."""
    crank = Link("crank", "A", "B", 0.2)
    if kind == "RRR":
        links = (crank, Link("one", "B", "E", 0.9), Link("two", "T"))
        points = (BodyPoint("C", "one", 0.8, 0.1), BodyPoint("C", "two", 0.4, 0.1), BodyPoint("D", "two", -0.1, -0.2))
        return Parts({"A": (0.0, 0.0), "D": (0.7, 0.2)}, links, points, (), {"C": "left of B-D"})
    if kind == "RRP":
        links = (crank, Link("one", "B", "E", 0.9), Link("two", "T", "U", 0.3))
        points = (BodyPoint("C", "one", 0.8, 0.1), BodyPoint("C", "two", 0.1, 0.05), BodyPoint("N", "two", -0.1, 0.02))
        return Parts(
            {"A": (0.0, 0.0)}, links, points, (Guide("way", "two", FRAME, (0.1, 0.05), 0.3, 0.1, "N", 0.7),), {"C": "forward"}
        )
    links = (crank, Link("one", "S"), Link("two", "T", "U", 0.4))
    points = (BodyPoint("N", "one", 0.05, -0.03), BodyPoint("M", "two", 0.1, 0.08))
    if kind == "RPR":
        points = (*points, BodyPoint("B", "one", 0.02, 0.04), BodyPoint("D", "two", 0.03, -0.06))
        way = Guide("way", "one", "two", (0.02, 0.01), 0.2, -0.05, "N", 0.6)
        return Parts({"A": (0.0, 0.0), "D": (0.6, 0.1)}, links, points, (way,), {"way": "backward"})
    if kind == "RPP":
        points = (*points, BodyPoint("B", "one", 0.02, 0.04))
        way = Guide("way", "one", "two", (0.02, 0.01), 1.1, -0.05, "N", 0.6)
        return Parts({"A": (0.0, 0.0)}, links, points, (way, Guide("rail", "two", FRAME, (0.1, 0.2), 0.4, 0.03, "M", -0.2)))
    points = (*points, BodyPoint("C", "one", 0.02, 0.04), BodyPoint("C", "two", -0.02, 0.04))
    way = Guide("way", "one", "crank", (0.02, 0.01), 1.1, -0.05, "N", 0.6)
    return Parts({"A": (0.0, 0.0)}, links, points, (way, Guide("rail", "two", FRAME, (0.1, 0.2), 0.4, 0.03, "M", -0.2)))


# --- what a mirror, a turn, a scale or a shift does -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Change:
    """Mirrored in the x axis or not, then larger, turned and shifted."""

    mirrored: bool
    factor: float
    turned: float
    shift: tuple[float, float]

    def vector(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        y = -y if self.mirrored else y
        c, s = math.cos(self.turned), math.sin(self.turned)
        return self.factor * (c * x - s * y) + self.shift[0], self.factor * (s * x + c * y) + self.shift[1]

    def angle(self, angle: float) -> float:
        return -angle if self.mirrored else angle

    def parts(self, parts: Parts) -> Parts:
        f, g = self.factor, -self.factor if self.mirrored else self.factor

        def guide(own: Guide) -> Guide:
            if own.on == FRAME:
                through, direction = self.vector(*own.through), self.angle(own.direction) + self.turned
            else:
                through, direction = (f * own.through[0], g * own.through[1]), self.angle(own.direction)
            return replace(own, through=through, direction=direction, offset=g * own.offset, tilt=self.angle(own.tilt))

        swap = {"left": "right", "right": "left"} if self.mirrored else {}
        return Parts(
            {name: self.vector(*xy) for name, xy in parts.ground.items()},
            tuple(replace(link, length=f * link.length) for link in parts.links),
            tuple(replace(p, along=f * p.along, across=g * p.across) for p in parts.points),
            tuple(guide(own) for own in parts.guides),
            {joint: " ".join(swap.get(word, word) for word in mode.split(" ")) for joint, mode in parts.modes.items()},
        )


changes = st.builds(Change, st.booleans(), st.floats(0.01, 100.0), turn, place)


def check_covariance(parts: Parts, phi: np.ndarray, change: Change, changed: Mechanism) -> None:
    """All points, velocities, margins and slides of the changed mechanism are those of the first, changed."""
    one = sweep(parts.mechanism, {}, phi, 2.0, 1.0)
    sense = -1.0 if change.mirrored else 1.0
    other = sweep(changed, {}, sense * phi + change.turned, sense * 2.0, sense * 1.0)
    still = replace(change, shift=(0.0, 0.0))
    for point in parts.mechanism.owners:
        for part, way in ((Motion.position, change), (Motion.velocity, still), (Motion.acceleration, still)):
            before = part(one, point)
            expected = np.stack(way.vector(before[:, 0], before[:, 1]), axis=-1)
            scale = np.max(np.abs(expected)) + change.factor
            np.testing.assert_allclose(
                part(other, point), expected, rtol=0.0, atol=1e-9 * scale, err_msg=f"{point} {part.__name__}"
            )
    for joint in one.pose.margins:
        np.testing.assert_allclose(other.margin(joint), one.margin(joint), rtol=0.0, atol=1e-8)
    for guide in parts.guides:
        before, after = one.slide(guide.name).value, other.slide(guide.name).value
        scale = change.factor * (1.0 + np.max(np.abs(before)))
        np.testing.assert_allclose(after, change.factor * before, rtol=0.0, atol=1e-9 * scale)
    for link in parts.links:
        rate = one.body_angle(link.body).rate
        np.testing.assert_allclose(other.body_angle(link.body).rate, sense * rate, rtol=1e-7, atol=1e-7)


@pytest.mark.slow
@every_kind
def test_mirror_turn_scale_and_shift(kind):
    met = []

    @seeded
    @given(dyads(kind), changes)
    def covariant(parts, change):
        phi = closing(parts)
        if kind == "RPR":
            b = np.stack([np.cos(phi), np.sin(phi)], axis=-1) * parts.links[0].length
            phi = phi[np.hypot(*(b - parts.ground["D"]).T) > 0.05]
        assume(phi.size)
        met.append((change.mirrored, phi.size))
        check_covariance(parts, phi, change, change.parts(parts).mechanism)

    covariant()
    for mirrored in (True, False):
        assert sum(size for way, size in met if way == mirrored) > 50


@every_kind
def test_covariance_check_detects_a_mode_or_offset_that_is_not_mirrored(kind):
    parts, change = by_hand(kind), Change(True, 2.0, 0.7, (0.3, -0.2))
    phi = closing(parts)
    changed = change.parts(parts)
    check_covariance(parts, phi, change, changed.mechanism)
    wrong = []
    if kind == "RRR":
        wrong.append(replace(changed, modes=parts.modes))
    for k, guide in enumerate(changed.guides):
        for slip in (replace(guide, offset=-guide.offset), replace(guide, tilt=-guide.tilt)):
            wrong.append(replace(changed, guides=(*changed.guides[:k], slip, *changed.guides[k + 1 :])))
    assert wrong
    for slipped in wrong:
        with pytest.raises(AssertionError):
            check_covariance(parts, phi, change, slipped.mechanism)


# --- planted defects: the geometry must see them --------------------------------------------------------------------------------


def swapped_side(honest: Callable) -> Callable:
    return lambda *known: honest(*known[:-1], -known[-1])


def offset_to_the_right(honest: Callable) -> Callable:
    return lambda *known: honest(*known[:-2], -known[-2], known[-1])


def last_offset_to_the_right(honest: Callable) -> Callable:
    return lambda *known: honest(*known[:-1], -known[-1])


DEFECTS = [
    ("RRR", swapped_side, check_side),
    ("RRP", swapped_side, check_side),
    ("RPR", swapped_side, check_side),
    ("RRP", offset_to_the_right, check_joints),
    ("RPR", offset_to_the_right, check_joints),
    ("RPP", last_offset_to_the_right, check_joints),
    ("PRP", last_offset_to_the_right, check_joints),
]


@pytest.mark.parametrize(("kind", "defect", "check"), DEFECTS, ids=[f"{k} {d.__name__}" for k, d, _ in DEFECTS])
def test_the_checks_see_a_defective_dyad(kind, defect, check, monkeypatch):
    parts = by_hand(kind)
    phi = closing(parts)

    def run() -> None:
        motion = sweep(parts.mechanism, {}, phi)
        if check is check_side:
            check_side(parts, kind, motion)
        else:
            check_joints(parts, motion)

    run()
    monkeypatch.setattr(groups_module, kind.lower(), defect(getattr(groups_module, kind.lower())))
    with pytest.raises(AssertionError):
        run()


def test_joint_check_detects_a_wrong_guide():
    parts = by_hand("RPP")
    motion = sweep(parts.mechanism, {}, ANGLES)
    check_joints(parts, motion)
    for slip in ({"offset": 0.01}, {"tilt": 0.01}, {"direction": 0.01}, {"at": "S"}, {"through": (0.0, 0.0)}):
        other = replace(parts, guides=(replace(parts.guides[0], **slip), parts.guides[1]))
        with pytest.raises(AssertionError):
            check_joints(other, motion)


# --- the order of the file ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("example", EXAMPLES, ids=str)
def test_the_order_of_the_file_does_not_matter(example):
    """Bodies, points and guides shuffled: the same groups, the same motion."""
    rng = np.random.default_rng(23)
    mechanism = example.mechanism
    motion = sweep(mechanism, example.sizes, example.phi, 3.0, 2.0)
    links = [Link(body, start, end, body if end else 0.0) for body, (start, end, _) in example.lengths.items()]
    for _ in range(6):
        shuffled = Assembly(
            dict(reversed(example.ground.items())),
            [links[k] for k in rng.permutation(len(links))],
            [example.points[k] for k in rng.permutation(len(example.points))],
            [example.guides[k] for k in rng.permutation(len(example.guides))],
            "crank",
            example.modes,
        ).mechanism(example.name)
        assert {frozenset(link.body for link in group.links) for group in shuffled.groups} == {
            frozenset(link.body for link in group.links) for group in mechanism.groups
        }
        other = sweep(shuffled, example.sizes, example.phi, 3.0, 2.0)
        for point in mechanism.owners:
            for part in (Motion.position, Motion.velocity, Motion.acceleration):
                np.testing.assert_allclose(part(other, point), part(motion, point), rtol=1e-9, atol=1e-9, err_msg=point)
        for body in mechanism.bodies:
            np.testing.assert_allclose(other.body_angle(body).rate, motion.body_angle(body).rate, rtol=1e-9, atol=1e-9)
        for joint in motion.pose.margins:
            np.testing.assert_allclose(other.margin(joint), motion.margin(joint), rtol=1e-9, atol=1e-11)


def test_the_outer_joints_of_a_mode_may_be_named_in_either_order():
    parts = by_hand("RRR")
    motion = sweep(parts.mechanism, {}, ANGLES)
    for words in ("right of D-B", " left  of B -> D ", "left of B – D", "left of B to D"):
        other = sweep(replace(parts, modes={"C": words}).mechanism, {}, ANGLES)
        np.testing.assert_array_equal(other.position("C"), motion.position("C"))
    other = sweep(replace(parts, modes={"C": "left of D-B"}).mechanism, {}, ANGLES)
    assert np.min(np.abs(other.position("C") - motion.position("C")).max(axis=-1)) > 0.01


# --- what is not a chain of dyads ---------------------------------------------------------------------------------------------

CRANK = Link("crank", "A", "B", 0.1)
BASE = {"A": (0.0, 0.0), "D": (0.5, 0.0)}


def pinned(body: str, *points: str) -> tuple[Link, list[BodyPoint]]:
    """A body with pins anywhere."""
    start, *rest = points
    return Link(body, start), [BodyPoint(name, body, 0.1 * (k + 1), 0.05 * k) for k, name in enumerate(rest)]


def structure(ground, *bodies, guides=(), modes=None, driver=CRANK) -> Mechanism:
    links = [driver, *(link for link, _ in bodies)]
    points = [point for _, own in bodies for point in own]
    return Assembly(ground, links, points, list(guides), driver.body, modes or {}).mechanism("test")


@dataclass(frozen=True)
class Refused:
    """A structure, and what must be said of it."""

    name: str
    build: Callable[[], Mechanism]
    message: tuple[str, ...]
    remedy: tuple[str, ...]
    key: str

    def __str__(self) -> str:
        return self.name


REFUSED = [
    Refused(
        "class III",
        lambda: structure(
            {**BASE, "E": (0.2, 0.5)},
            pinned("plate", "P", "Q", "R"),
            pinned("rod", "B", "P"),
            pinned("bar", "D", "Q"),
            pinned("arm", "E", "R"),
        ),
        ("plate, rod, bar and arm", "not a chain of dyads", "class III"),
        ("Drive another body", "two at a time"),
        "links.plate",
    ),
    Refused(
        "ring",
        lambda: structure(
            BASE, pinned("one", "B", "E", "F"), pinned("two", "E", "G"), pinned("three", "D", "G", "H"), pinned("four", "F", "H")
        ),
        ("one, two, three and four", "not a chain of dyads", "ring"),
        ("Drive another body",),
        "links.one",
    ),
    Refused(
        "ring on a four-bar",
        lambda: structure(
            BASE,
            pinned("coupler", "B", "C"),
            pinned("rocker", "D", "C", "K"),
            pinned("two", "K", "G", "I"),
            pinned("three", "G", "H"),
            pinned("four", "H", "J", "D"),
            pinned("five", "I", "J"),
            modes={"C": "left of B-D"},
        ),
        ("two, three, four and five", "not a chain of dyads", "ring"),
        ("Drive another body",),
        "links.two",
    ),
    Refused(
        "rigid",
        lambda: structure(
            {**BASE, "E": (0.3, 0.4)},
            pinned("coupler", "B", "C", "G"),
            pinned("rocker", "D", "C"),
            pinned("brace", "E", "G"),
            modes={"C": "left of B-D"},
        ),
        ("brace moves only with special lengths", "E and G already fix its position", "redundant bodies are not supported"),
        ("Remove one of these joints", "add a body between"),
        "links.brace",
    ),
    Refused(
        "rigid, held by nobody alone",
        lambda: structure(
            {**BASE, "E": (0.2, 0.5), "H": (0.7, 0.5)},
            pinned("plate", "P", "Q", "R", "S"),
            pinned("rod", "B", "P"),
            pinned("bar", "D", "Q"),
            pinned("arm", "E", "R"),
            pinned("leg", "H", "S"),
        ),
        ("plate, rod, bar, arm and leg", "0 degrees of freedom", "rigid structure"),
        ("Remove a joint", "add a body"),
        "links.leg",
    ),
    Refused(
        "two degrees of freedom",
        lambda: structure(BASE, pinned("one", "B", "C"), pinned("two", "C", "E"), pinned("three", "E", "D")),
        ("one, two and three", "2 degrees of freedom", "one driver"),
        ("join them to the frame", "hold them still"),
        "links.three",
    ),
    Refused(
        "loose end",
        lambda: structure(
            BASE, pinned("coupler", "B", "C"), pinned("rocker", "D", "C"), pinned("tail", "C", "T"), modes={"C": "left of B-D"}
        ),
        ("tail", "2 degrees of freedom"),
        ("join it to the frame", "hold it still"),
        "links.tail",
    ),
    Refused(
        "ring that hangs on nothing",
        lambda: structure(
            BASE,
            pinned("coupler", "B", "C"),
            pinned("rocker", "D", "C"),
            pinned("one", "W", "X"),
            pinned("two", "X", "Y"),
            pinned("three", "Y", "Z"),
            pinned("four", "Z", "W"),
            modes={"C": "left of B-D"},
        ),
        ("one, two, three and four", "5 degrees of freedom"),
        ("join them to the frame",),
        "links.four",
    ),
    Refused(
        "body without a joint",
        lambda: structure(BASE, pinned("coupler", "B", "C"), pinned("rocker", "D", "C"), pinned("stone", "X", "Y")),
        ("the body has no joint", "X and Y"),
        ("Give one of its joints the name", "remove it"),
        "links.stone",
    ),
    Refused(
        "mode missing",
        lambda: structure(BASE, pinned("coupler", "B", "C"), pinned("rocker", "D", "C")),
        ("in two ways",),
        ('C = "left of B-D" or "right of B-D"',),
        "assembly.C",
    ),
    Refused(
        "mode of a slider missing",
        lambda: structure(BASE, pinned("rod", "B", "C"), pinned("slider", "C"), guides=[Guide("way", "slider")]),
        ("in two ways",),
        ('C = "forward" or "backward"', "way"),
        "assembly.C",
    ),
    Refused(
        "mode of a crank slide missing",
        lambda: structure(BASE, pinned("block", "B"), pinned("arm", "D"), guides=[Guide("slot", "block", "arm")]),
        ("in two ways",),
        ('slot = "forward" or "backward"', "slot"),
        "assembly.slot",
    ),
    *(
        Refused(
            f"mode {words!r}",
            lambda words=words: structure(BASE, pinned("coupler", "B", "C"), pinned("rocker", "D", "C"), modes={"C": words}),
            ("not an assembly mode",),
            ('C = "left of B-D" or "right of B-D"',),
            "assembly.C",
        )
        for words in ("forward", "left of B-E", "left of B-B", "left", "above B-D", "")
    ),
    *(
        Refused(
            f"mode of a slider {words!r}",
            lambda words=words: structure(
                BASE, pinned("rod", "B", "C"), pinned("slider", "C"), guides=[Guide("way", "slider")], modes={"C": words}
            ),
            ("not an assembly mode",),
            ('C = "forward" or "backward"',),
            "assembly.C",
        )
        for words in ("left of B-D", "onward", "Forward")
    ),
    Refused(
        "mode of a group that has one",
        lambda: structure(
            BASE,
            pinned("block", "B"),
            pinned("yoke", "Y"),
            guides=[Guide("slot", "block", "yoke", direction=1.5), Guide("way", "yoke")],
            modes={"slot": "forward"},
        ),
        ("the dyad has only one assembly mode",),
        ("Joints with an assembly mode: none",),
        "assembly.slot",
    ),
    Refused(
        "mode of a joint that is not there",
        lambda: structure(
            BASE, pinned("coupler", "B", "C"), pinned("rocker", "D", "C"), modes={"C": "left of B-D", "E": "left of B-D"}
        ),
        ("no dyad has its inner joint there",),
        ("Joints with an assembly mode: C",),
        "assembly.E",
    ),
    Refused(
        "two bodies with two joints",
        lambda: structure(BASE, pinned("one", "B", "C", "E"), pinned("two", "C", "E", "F"), pinned("three", "F", "D")),
        ("one and two share the joints C and E", "one body"),
        ("Give the points to one body", "remove one joint"),
        "links.two",
    ),
    Refused(
        "driver told from its far end",
        lambda: structure(BASE, pinned("coupler", "B", "C"), pinned("rocker", "D", "C"), driver=Link("wheel", "B", "A", 0.1)),
        ("turns about its first joint", "B of wheel is not on the frame"),
        ("Exchange its two joints",),
        "links.wheel.joints",
    ),
    Refused(
        "driver not on the frame",
        lambda: structure(BASE, pinned("coupler", "B", "C"), pinned("rocker", "D", "C"), driver=Link("wheel", "X", "B", 0.1)),
        ("turns about its first joint", "X of wheel is not on the frame"),
        ("[mechanism.ground]",),
        "links.wheel.joints",
    ),
    Refused(
        "driver held twice",
        lambda: structure(BASE, pinned("coupler", "D", "C"), pinned("rocker", "D", "C"), driver=Link("wheel", "A", "D", 0.1)),
        ("wheel cannot turn", "pivot A", "D"),
        ("Remove that joint",),
        "links.wheel",
    ),
    Refused(
        "driver in a guide",
        lambda: structure(BASE, pinned("coupler", "B", "C"), pinned("rocker", "D", "C"), guides=[Guide("way", "crank")]),
        ("crank cannot turn", "way"),
        ("Remove that joint",),
        "links.crank",
    ),
    Refused(
        "three prismatic joints",
        lambda: structure(
            BASE,
            pinned("one", "S"),
            pinned("two", "T"),
            guides=[Guide("way", "one", "crank"), Guide("rail", "two"), Guide("slot", "one", "two", direction=1.0)],
        ),
        ("one and two",),
        (),
        "links.",
    ),
]


@pytest.mark.parametrize("case", REFUSED, ids=str)
def test_linkages_that_are_not_chains_of_dyads_are_refused(case):
    with pytest.raises(StructureError) as refused:
        case.build()
    error = refused.value
    for words in case.message:
        assert words in error.message
    for words in case.remedy:
        assert words in error.remedy
    assert error.key.startswith(case.key) if case.key.endswith(".") else error.key == case.key
    assert error.message in str(error)
    assert error.remedy in str(error)


@pytest.mark.parametrize("seed", range(4))
def test_refusals_do_not_hang_on_the_order_of_the_file(seed):
    """The same members are named, whichever body comes first."""
    bodies = [pinned("plate", "P", "Q", "R"), pinned("rod", "B", "P"), pinned("bar", "D", "Q"), pinned("arm", "E", "R")]
    order = np.random.default_rng(seed).permutation(4)
    with pytest.raises(StructureError, match="not a chain of dyads") as refused:
        structure({**BASE, "E": (0.2, 0.5)}, *(bodies[k] for k in order))
    assert all(name in refused.value.message for name in ("plate", "rod", "bar", "arm"))
    assert refused.value.key == f"links.{bodies[order[0]][0].body}"
