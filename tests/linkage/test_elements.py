"""Drives and couplings: positions against closed forms, torques and forces against energy, equilibrium of every body."""

import math
from dataclasses import replace

import numpy as np
import pytest

from optlink.dynamics.inverse import reactions, required_wrench, virtual_torque
from optlink.dynamics.machine import Inertia, Machine
from optlink.linkage.assur import Assembly, StructureError
from optlink.linkage.elements import Cam, Drive, Gear, Rack
from optlink.linkage.laws import Segment, joined
from optlink.linkage.mechanism import Guide, Link
from optlink.linkage.motion import sweep
from optlink.linkage.vector2d import turn

WAVE = joined(0.0, [Segment(1.0, 0.6, "3-4-5"), Segment(0.5, 0.6, "dwell"), Segment(1.5, 0.0, "cycloidal")])
RATE = 3.0 / (2.0 * math.pi)
"""Time of the law per radian of the cycle variable."""
GROUND = {"A": (0.0, 0.0), "D": (0.3, 0.05)}
CRANK, WHEEL = Link("crank", "A", "B", 0.05), Link("wheel", "D", "E", 0.05)


def rail(**keys):
    return Guide("rail", "rack", **{"through": (0.0, -0.08), **keys})


def built(ground, links, guides=(), driver="crank", modes=(), drives=(), couplings=()):
    return Assembly(ground, links, (), guides, driver, dict(modes), drives, couplings).mechanism("test")


SECTOR = [Link("crank", "A", "B", 0.06), Link("block", "B"), Link("sector", "D"), Link("rack", "R")]
CARRIER, PLANET = Link("carrier", "A", "B", 0.03), Link("planet", "B", "P", 0.01)
INNER = Gear("inner", ("crank", "planet"), -2.0, 0.4, "carrier", pivots=("A", "B"))
OUTER = Gear("outer", ("planet", "frame"), 0.25, arm="carrier", pivots=("B", "A"))
WAY, TOP = Guide("way", "carriage"), Guide("top", "bar", through=(0.0, 0.03), direction=math.pi)
FIVE_BAR = [Link("one", "A", "B", 0.2), Link("two", "E", "D", 0.2), Link("f1", "B", "P", 0.25), Link("f2", "D", "P", 0.25)]
EXCAVATOR = [Link("boom", "A", "B", 1.5), Link("lift", "D", "B", "lift.length")]
FOLLOWER = Guide("way", "follower", through="A", direction=1.5, offset=0.01)

MECHANISMS = {
    "gears": lambda: built(GROUND, [CRANK, WHEEL], couplings=[Gear("g", ("crank", "wheel"), -0.5, pivots=("A", "D"))]),
    "gears, driven first": lambda: built(
        GROUND, [CRANK, WHEEL], couplings=[Gear("g", ("wheel", "crank"), -2.0, pivots=("D", "A"))]
    ),
    "belt": lambda: built(
        GROUND, [CRANK, WHEEL], couplings=[Gear("b", ("crank", "wheel"), 1.0, pivots=("A", "D"), radii=(0.04, 0.08))]
    ),
    "crossed belt": lambda: built(
        GROUND, [CRANK, WHEEL], couplings=[Gear("b", ("crank", "wheel"), -1.0, pivots=("A", "D"), radii=(0.04, 0.08))]
    ),
    "planet in a ring": lambda: built(
        {"A": (0.0, 0.0)},
        [CRANK, Link("planet", "B", "E", 0.02)],
        couplings=[Gear("ring", ("planet", "frame"), 30 / 80, arm="crank", pivots=("B", "A"))],
    ),
    "planetary train, driven at the sun": lambda: built(
        {"A": (0.0, 0.0)},
        [Link("crank", "A"), CARRIER, PLANET],
        couplings=[OUTER, INNER],
    ),
    "planetary train, driven at the ring": lambda: built(
        {"A": (0.0, 0.0)},
        [Link("crank", "A"), Link("sun", "A"), CARRIER, PLANET],
        couplings=[
            replace(INNER, bodies=("sun", "planet")),
            replace(OUTER, bodies=("planet", "crank")),
            Gear("reverse", ("crank", "sun"), -0.4),
        ],
    ),
    "differential with two motors": lambda: built(
        {"A": (0.0, 0.0)},
        [Link("sun", "A"), Link("ring", "A"), PLANET, CARRIER],
        driver="",
        drives=[Drive("s", "angle", "sun", law=WAVE, rate=RATE), Drive("r", "angle", "ring", 0.2, rate=-2.0)],
        couplings=[replace(INNER, bodies=("sun", "planet")), replace(OUTER, bodies=("planet", "ring"))],
    ),
    "pinion between two racks": lambda: built(
        {"A": (-0.3, 0.0)},
        [CRANK, Link("rod", "B", "C", 0.2), Link("carriage", "C"), Link("pinion", "C"), Link("bar", "R")],
        [WAY, TOP],
        modes={"C": "forward"},
        couplings=[
            Rack("lower", "pinion", None, 0.03, "C", 1, path=WAY),
            Rack("upper", "pinion", TOP, 0.03, "C", 1, path=WAY, way=-1),
        ],
    ),
    "motor on a carriage": lambda: built(
        {"A": (0.0, 0.0)},
        [Link("carriage", "C"), Link("pinion", "C", "E", 0.03)],
        [replace(WAY, direction=0.4)],
        driver="",
        drives=[Drive("input", "angle", "pinion", 0.3, law=WAVE, rate=RATE, against="carriage")],
        couplings=[Rack("track", "pinion", None, 0.03, "C", -1, path=replace(WAY, direction=0.4))],
    ),
    "geared five-bar": lambda: built(
        {"A": (0.0, 0.0), "E": (0.15, 0.0)},
        FIVE_BAR,
        driver="one",
        modes={"P": "left of B-D"},
        couplings=[Gear("g", ("one", "two"), 1.0, 0.5)],
    ),
    "rack": lambda: built(
        {"A": (0.0, 0.0)}, [CRANK, Link("rack", "R")], [rail()], couplings=[Rack("r", "crank", rail(), 0.08, "A")]
    ),
    "rack that drives": lambda: built(
        {"A": (0.0, 0.0)},
        [Link("rack", "R"), Link("wheel", "A", "B", 0.05)],
        [rail()],
        driver="",
        drives=[Drive("input", "slide", "rack", law=WAVE.scaled(0.1), rate=RATE)],
        couplings=[Rack("r", "wheel", rail(), 0.08, "A")],
    ),
    "sector and rack": lambda: built(
        {"A": (0.0, 0.2), "D": (0.0, 0.0)},
        SECTOR,
        [Guide("slot", "block", on="sector", through="D"), rail()],
        modes={"slot": "forward"},
        couplings=[Rack("r", "sector", rail(), 0.08, "D")],
    ),
    "cam with a roller": lambda: built(
        {"A": (0.0, 0.0)},
        [Link("crank", "A"), Link("follower", "F")],
        [FOLLOWER],
        couplings=[Cam("c", "crank", "follower", "A", CAM, 0.02, 0.05, contact="F")],
    ),
    "cam with a flat follower": lambda: built(
        {"A": (0.0, 0.0)},
        [Link("crank", "A"), Link("follower", "F")],
        [FOLLOWER],
        couplings=[Cam("c", "crank", "follower", "A", CAM, 0.02, 0.05)],
    ),
    "cam with a swinging follower": lambda: built(
        {"A": (0.0, 0.0), "P": (0.1, 0.0)},
        [Link("crank", "A"), Link("follower", "P", "F", 0.07)],
        couplings=[Cam("c", "crank", "follower", "A", CAM, 0.3, 2.0, contact="F")],
    ),
    "driven slider": lambda: built(
        {"A": (0.0, 0.0)},
        [Link("crank", "A", "B", 0.305), Link("rod", "B", "C", 0.61), Link("slider", "C")],
        [Guide("G", "slider", through="A", offset=-0.259)],
        driver="",
        modes={"B": "left of A-C"},
        drives=[Drive("input", "slide", "slider", 0.4, law=WAVE.scaled(0.4), rate=RATE)],
    ),
    "two motors": lambda: built(
        {"A": (0.0, 0.0), "E": (0.15, 0.0)},
        FIVE_BAR,
        driver="",
        modes={"P": "left of B-D"},
        drives=[Drive("l", "angle", "one", 1.6, law=WAVE, rate=RATE), Drive("r", "angle", "two", 1.3, rate=0.0)],
    ),
    "arm with two motors": lambda: built(
        {"A": (0.0, 0.0)},
        [Link("upper", "A", "B", 0.3), Link("fore", "B", "T", 0.25)],
        driver="",
        drives=[Drive("s", "angle", "upper", rate=1.0), Drive("e", "angle", "fore", 0.3, rate=-3.0, against="upper")],
    ),
    "cylinder with a rod": lambda: built(
        {"A": (0.0, 0.0), "D": (0.6, -0.4)},
        EXCAVATOR,
        driver="",
        modes={"B": "left of A-D"},
        drives=[Drive("input", "length", "lift", 1.2, law=WAVE, rate=RATE, size="lift.length", rod="lift.rod")],
    ),
}
CAM = joined(0.0, [Segment(2.0, 1.0, "modified sine"), Segment(1.0, 1.0, "dwell"), Segment(2.0 * math.pi - 3.0, 0.0, "3-4-5")])
PRESSED = {"planet in a ring", "planetary train, driven at the sun", "pinion between two racks", "motor on a carriage"}
"""Those with a ring or a rack that is a part of the frame, and presses on it."""
ANGLES, SPEED = np.linspace(0.13, 6.1, 11), 1.3


def machine(name):
    """A machine with random masses of all bodies."""
    rng, mechanism = np.random.default_rng(4), MECHANISMS[name]()
    masses = {body: Inertia(*rng.uniform(0.5, 3.0, 4)) for body in (*mechanism.bodies, *mechanism.rods)}
    return Machine(mechanism, {}, masses, (0.4, -9.81))


@pytest.mark.parametrize("name", MECHANISMS)
def test_the_power_of_the_drives_is_the_rate_of_the_energy(name):
    tested = machine(name)
    moving = tested.moving(ANGLES, SPEED)
    found = reactions(moving)

    def energy(angles):
        at = tested.moving(angles, SPEED)
        return at.kinetic + at.potential

    h = 1e-5
    rate = (8.0 * (energy(ANGLES + h) - energy(ANGLES - h)) - (energy(ANGLES + 2 * h) - energy(ANGLES - 2 * h))) / (12.0 * h)
    np.testing.assert_allclose(found.torque, rate, rtol=1e-7, atol=1e-7 * np.max(np.abs(rate)))
    virtual = virtual_torque(required_wrench(moving), moving)
    np.testing.assert_allclose(found.torque, virtual, rtol=1e-9, atol=1e-11 * np.max(np.abs(virtual)))


@pytest.mark.parametrize("name", sorted(MECHANISMS.keys() - PRESSED))
def test_all_forces_on_the_frame_move_the_whole_machine(name):
    """Joints, drives and couplings exert inner forces but for those of the frame: with gravity they change the momentum."""
    tested = machine(name)
    moving = tested.moving(ANGLES, SPEED)
    found = reactions(moving)
    total = np.zeros((2, len(ANGLES)))
    for by_body in found.pins.values():
        if "frame" in by_body:
            total -= np.array([np.broadcast_to(part, ANGLES.shape) for part in by_body["frame"]])
    for guide in tested.mechanism.guides:
        if guide.on == "frame":
            total += np.array([np.broadcast_to(part, ANGLES.shape) for part in found.guides[guide.name].force])
    for drive in tested.mechanism.drives:
        if drive.kind == "slide":
            line = moving.line(next(guide.name for guide in tested.mechanism.guides if guide.slider == drive.body))
            total += np.array([np.broadcast_to(part * found.efforts[drive.name], ANGLES.shape) for part in line])
    needed = np.zeros((2, len(ANGLES)))
    for body, mass in tested.inertias.items():
        state = moving.state(body)
        x, y = turn((mass.along, mass.across), state.axis)
        ax = state.acceleration[0] - state.alpha * y - state.omega**2 * x
        ay = state.acceleration[1] + state.alpha * x - state.omega**2 * y
        needed += mass.mass * np.array([np.broadcast_to(part, ANGLES.shape) for part in (ax - 0.4, ay + 9.81)])
    np.testing.assert_allclose(total, needed, rtol=1e-9, atol=1e-9 * np.max(np.abs(needed)))


# --- closed forms -----------------------------------------------------------------------------------------------------------


def angle_of(name, body):
    tested = MECHANISMS[name]()
    return sweep(tested, {}, ANGLES).body_angle(body).value


def test_gears_and_belts_turn_by_their_ratio():
    assert angle_of("gears", "wheel") == pytest.approx(-0.5 * ANGLES, abs=1e-13)
    assert angle_of("belt", "wheel") == pytest.approx(0.5 * ANGLES, abs=1e-13)
    assert angle_of("crossed belt", "wheel") == pytest.approx(-0.5 * ANGLES, abs=1e-13)


def test_a_planet_turns_as_willis_says():
    """(planet - carrier) : (ring - carrier) = 80 : 30 for a ring of 80 teeth and a planet of 30 (R. Willis, 1841)."""
    turned = angle_of("planet in a ring", "planet")
    assert turned - turned[0] == pytest.approx((1.0 - 80.0 / 30.0) * (ANGLES - ANGLES[0]), abs=1e-12)


def test_planetary_trains_turn_as_willis_says():
    """(ring - carrier) = -(40 / 80) * (sun - carrier)."""
    turned = angle_of("planetary train, driven at the sun", "carrier")
    assert turned - turned[0] == pytest.approx((ANGLES - ANGLES[0]) / 3.0, abs=1e-13)
    motion = sweep(MECHANISMS["differential with two motors"](), {}, ANGLES, SPEED)
    sun, ring, carrier = (motion.body_rate(body) for body in ("sun", "ring", "carrier"))
    assert ring - carrier == pytest.approx(-0.5 * (sun - carrier), abs=1e-13)
    motion = sweep(MECHANISMS["planetary train, driven at the ring"](), {}, ANGLES)
    assert motion.body_rate("carrier") == pytest.approx(np.full(ANGLES.shape, (2.0 - 0.4) / 3.0), abs=1e-13)


def test_a_pinion_rolls_on_a_fixed_rack():
    motion = sweep(MECHANISMS["pinion between two racks"](), {}, ANGLES, SPEED)
    moved = motion.slide("way").value
    assert motion.body_angle("pinion").value == pytest.approx(-moved / 0.03, abs=1e-12)
    assert motion.slide("top").value == pytest.approx(-2.0 * moved, abs=1e-13)
    motion = sweep(MECHANISMS["motor on a carriage"](), {}, ANGLES, SPEED)
    assert motion.slide("way").value == pytest.approx(0.03 * (0.3 + 0.4 + WAVE(ANGLES * RATE)), abs=1e-13)


def test_a_cylinder_lifts_its_boom_by_the_cosine_rule():
    tested = MECHANISMS["cylinder with a rod"]()
    motion = sweep(tested, {}, ANGLES, SPEED)
    distance, length = math.hypot(0.6, 0.4), 1.2 + WAVE(ANGLES * RATE)
    cosine = (1.5**2 + distance**2 - length**2) / (2.0 * 1.5 * distance)
    assert motion.body_angle("boom").value == pytest.approx(math.atan2(-0.4, 0.6) + np.arccos(cosine), abs=1e-13)
    assert motion.distance("D", "B") == pytest.approx(length, abs=1e-14)
    rate = length * WAVE.derivative(ANGLES * RATE, 1) * RATE * SPEED / (1.5 * distance * np.sqrt(1.0 - cosine**2))
    assert motion.body_rate("boom") == pytest.approx(rate, abs=1e-12)


def test_a_rack_rolls_without_slip():
    tested = MECHANISMS["sector and rack"]()
    motion = sweep(tested, {}, ANGLES, SPEED)
    assert motion.slide("rail").value == pytest.approx(0.08 * motion.body_angle("sector").value, abs=1e-14)
    assert motion.slide("rail").rate == pytest.approx(0.08 * motion.body_rate("sector"), abs=1e-14)
    moved = angle_of("rack that drives", "wheel")
    assert moved == pytest.approx(0.1 * WAVE(ANGLES * RATE) / 0.08, abs=1e-13)


def test_teeth_press_along_the_line_of_action():
    """The tooth force of a wheel of 0.2 m pitch radius at 20 deg, from the torque on it alone."""
    tested = Machine(MECHANISMS["gears"](), {}, {"wheel": Inertia(0.0, 0.0, 0.0, 0.0)})
    load = 5.0
    moving = tested.moving(np.array([0.3]), 1.0)
    needed = dict(required_wrench(moving))
    needed["wheel"] = needed["wheel"]._replace(moment=needed["wheel"].moment + load)
    found = reactions(moving, needed)
    distance = math.hypot(0.3, 0.05)
    tangent = load / (distance * 2.0 / 3.0)
    size = math.hypot(*(float(part.item()) for part in found.pins["D"]["wheel"]))
    assert size == pytest.approx(tangent / math.cos(math.radians(20.0)), rel=1e-12)
    assert float(found.torque.item()) == pytest.approx(-0.5 * load, rel=1e-12)


def test_the_tight_strand_of_a_belt_pulls_along_a_common_tangent():
    tested = Machine(MECHANISMS["belt"](), {})
    moving = tested.moving(np.array([0.3]), 1.0)
    for load in (5.0, -5.0):
        needed = dict(required_wrench(moving))
        needed["wheel"] = needed["wheel"]._replace(moment=load)
        force = [-float(np.ravel(part)[0]) for part in reactions(moving, needed).pins["D"]["wheel"]]
        assert math.hypot(*force) == pytest.approx(abs(load) / 0.08, rel=1e-12)
        between = np.array([0.0, 0.0]) - np.array([0.3, 0.05])
        slant = math.asin((0.08 - 0.04) / np.hypot(*between))
        angle = math.atan2(*force[::-1]) - math.atan2(*between[::-1])
        assert math.remainder(angle, 2.0 * math.pi) == pytest.approx(math.copysign(slant, load), abs=1e-12)


def test_a_cam_presses_along_the_common_normal():
    tested = MECHANISMS["cam with a roller"]()
    moving = Machine(tested, {}).moving(ANGLES, SPEED)
    needed = dict(required_wrench(moving))
    line = np.array([math.cos(1.5), math.sin(1.5)])
    needed["follower"] = needed["follower"]._replace(force=(3.0 * line[0], 3.0 * line[1]))
    found = reactions(moving, needed)
    slope = 0.02 * CAM.derivative(ANGLES, 1)
    slide = 0.05 + 0.02 * CAM(ANGLES)
    pressure = np.arctan((slope + 0.01) / slide)  # the axis of the cam lies 10 mm to the right of the line
    assert np.abs(found.guides["way"].normal) == pytest.approx(3.0 * np.abs(np.tan(pressure)), abs=1e-12)
    assert found.torque == pytest.approx(3.0 * slope, abs=1e-12)


def test_bodies_that_are_fixed_already_cannot_be_driven():
    with pytest.raises(StructureError, match="already fix it"):
        built(GROUND, [CRANK, Link("wheel", "D", "B", 0.3)], couplings=[Gear("g", ("crank", "wheel"), -0.5)])
    with pytest.raises(StructureError, match="couples bodies"):
        built(
            GROUND,
            [CRANK, Link("rod", "B", "C", 0.3), Link("rocker", "D", "C", 0.2)],
            modes={"C": "left of B-D"},
            couplings=[Gear("g", ("rod", "rocker"), 2.0)],
        )
