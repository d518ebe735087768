"""Reactions, torque and energies of machines of every dyad against Newton and Euler written for all bodies at once.

The oracle (tests/oracle.py) knows no groups and no jets. The machines below hold each dyad in each of its variants, bodies with
three joints, pins of three and four bodies, every load; all masses lie off the axes of their bodies, gravity is oblique.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import casadi
import numpy as np
import pytest

import optlink
from optlink.dynamics import inverse, inverse as reactions_module
from optlink.dynamics.counterweights import Effects
from optlink.dynamics.inverse import Reactions, acting_on, reactions, reported_on, shaking, torque_parts
from optlink.dynamics.machine import (
    Force,
    Inertia,
    Load,
    Machine,
    Moving,
    Parameters,
    SlideDamper,
    Spring,
    Torque,
    TorsionSpring,
    Wrench,
)
from optlink.linkage.assur import Assembly
from optlink.linkage.jet import Jet
from optlink.linkage.mechanism import FRAME, BodyPoint, Guide, Link, Mechanism
from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import unit
from optlink.symbolic import symbols_in_numpy
from tests.oracle import External, Kinematics, Mass, Solution, newton_euler

GRAVITY = (3.1, -9.2)
PHI = 0.03 + np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
SAME = 1e-9

# --- the machines ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Example:
    """A machine as a file would tell it; lengths of links are parameters with the names of the bodies."""

    name: str
    kinds: tuple[str, ...]
    ground: dict[str, tuple[float, float]]
    lengths: dict[str, tuple[str, str, float]]  # body -> start, end, length
    modes: dict[str, str]
    points: tuple[BodyPoint, ...] = ()
    guides: tuple[Guide, ...] = ()
    loads: tuple[Load, ...] = ()
    phi: np.ndarray = field(default_factory=lambda: PHI)

    def __str__(self) -> str:
        return self.name

    @property
    def mechanism(self) -> Mechanism:
        links = [Link(body, start, end, body if end else 0.0) for body, (start, end, _) in self.lengths.items()]
        return Assembly(self.ground, links, self.points, self.guides, "crank", self.modes).mechanism(self.name)

    @property
    def sizes(self) -> dict[str, float]:
        return {body: length for body, (_, end, length) in self.lengths.items() if end}

    @property
    def inertias(self) -> dict[str, Inertia]:
        """Masses of all bodies, centroids off their axes, other ones in every machine."""
        rng = np.random.default_rng(zlib.crc32(self.name.encode()))
        return {
            body: Inertia(
                float(rng.uniform(0.5, 4.0)),
                *(float(v) for v in rng.uniform(-0.3, 0.3, 2)),
                float(rng.uniform(0.005, 0.2)),
            )
            for body in self.lengths
        }

    @property
    def machine(self) -> Machine:
        return Machine(self.mechanism, self.sizes, self.inertias, GRAVITY, self.loads)


FOUR_GROUND = {"A": (0.0, 0.0), "D": (0.5, 0.06)}
FOUR = {"crank": ("A", "B", 0.1), "coupler": ("B", "C", 0.41), "rocker": ("D", "C", 0.23)}
FOUR_MODE = {"C": "left of B-D"}
P = BodyPoint("P", "coupler", 0.2, 0.15)

EXAMPLES = (
    Example(
        "four-bar with springs",
        ("RRR",),
        {**FOUR_GROUND, "S": (0.2, -0.3)},
        FOUR,
        FOUR_MODE,
        (P, BodyPoint("Q", "rocker", 0.05, -0.08)),
        loads=(
            Force("pull", "coupler", "P", lambda v: 40.0 + 25.0 * np.sin(v["phi"]) + v["omega"], 0.7),
            Torque("brake", "rocker", lambda v: 3.0 + 0.2 * v["w"] + np.sin(v["theta"]), opposing=True),
            Spring("tie", ((FRAME, "S"), ("coupler", "P")), 300.0, 0.35, 12.0),
            Spring("inner", (("crank", "B"), ("rocker", "Q")), 120.0, 0.3, 3.0),
            TorsionSpring("twist", "rocker", "coupler", 2.5, 1.1, 0.3),
            TorsionSpring("leaf", "rocker", FRAME, 1.5, 1.9, 0.05),
        ),
    ),
    Example(
        "Watt I",
        ("RRR", "RRR"),
        FOUR_GROUND,
        {**FOUR, "rod": ("E", "G", 0.33), "lever": ("F", "G", 0.3)},
        {**FOUR_MODE, "G": "right of E-F"},
        (BodyPoint("E", "coupler", 0.25, 0.12), BodyPoint("F", "rocker", 0.26, -0.1), BodyPoint("K", "lever", 0.1, 0.05)),
        loads=(
            Force("saw", "lever", "K", lambda v: 55.0 + 0.0 * v["phi"], -0.4, opposing=True, stroke="forward"),
            Torque("load", "rod", lambda v: 2.0 * np.cos(v["phi"])),
            Spring("across", (("coupler", "B"), ("lever", "G")), 150.0, 0.6, 4.0),
        ),
    ),
    Example(
        "Stephenson III, coupler point as outer joint",
        ("RRR", "RRR"),
        {**FOUR_GROUND, "H": (0.45, 0.55)},
        {**FOUR, "rod": ("E", "F", 0.35), "lever": ("H", "F", 0.3)},
        {**FOUR_MODE, "F": "left of E-H"},
        (BodyPoint("E", "coupler", 0.25, 0.12),),
        loads=(Torque("pump", "lever", lambda v: 6.0 + v["w"] ** 2, opposing=True, stroke="backward"),),
    ),
    Example(
        "pins of three and four bodies",
        ("RRR", "RRP", "RRR", "RRR"),
        {"A": (0.0, 0.0), "D": (1.5, 0.0)},
        {
            "crank": ("A", "B", 0.4),
            "link2": ("B", "C", 1.2),
            "link3": ("D", "C", 0.8),
            "link5": ("C", "E", 1.2),
            "slider": ("E", "", 0.0),
            "link7": ("D", "K", 1.4),
            "link8": ("E", "K", 1.5),
            "link9": ("A", "M", 1.6),
            "link10": ("K", "M", 1.3),
        },
        {"C": "left of B-D", "E": "forward", "K": "right of D-E", "M": "left of A-K"},
        guides=(Guide("F", "slider", through="D"),),
        loads=(
            Force("press", "slider", "E", lambda v: 300.0 + 100.0 * v["s"] + 5.0 * v["v"], "F", opposing=True, stroke="forward"),
            Force("weight", "link10", "M", lambda v: 70.0, -1.2),
            SlideDamper("oil", "F", "slider", FRAME, "E", 25.0),
        ),
    ),
    Example(
        "slider-crank with offset and tilt",
        ("RRP",),
        {"A": (0.0, 0.0), "O": (0.1, -0.07)},
        {"crank": ("A", "B", 0.15), "rod": ("B", "C", 0.5), "slider": ("N", "T", 0.3)},
        {"C": "forward"},
        (BodyPoint("C", "slider", 0.08, 0.05), BodyPoint("R", "slider", -0.1, 0.04)),
        (Guide("way", "slider", through="O", direction=0.3, offset=0.03, at="R", tilt=0.45),),
        loads=(
            Force("gas", "slider", "T", lambda v: 200.0 * np.exp(-v["s"]) + 2.0 * v["v"], "way"),
            Force("drag", "slider", "N", lambda v: 30.0, 1.0, opposing=True),
        ),
    ),
    Example(
        "slider on the coupler",
        ("RRR", "RRP"),
        {**FOUR_GROUND, "G": (0.1, 0.5)},
        {**FOUR, "rod": ("G", "W", 0.4), "slider": ("W", "", 0.0)},
        {**FOUR_MODE, "W": "forward"},
        (P, BodyPoint("V", "slider", 0.03, 0.04)),
        (Guide("rail", "slider", on="coupler", through="P", direction=-0.25, offset=0.02, at="V", tilt=-0.3),),
        loads=(
            SlideDamper("oil", "rail", "slider", "coupler", "V", 40.0),
            Force("rub", "slider", "V", lambda v: 15.0 + 2.0 * v["s"], "rail", opposing=True),
        ),
    ),
    Example(
        "bar over a block of the rocker",
        ("RRR", "RRP"),
        {**FOUR_GROUND, "G": (0.9, 0.35)},
        {**FOUR, "rod": ("G", "W", 0.75), "bar": ("W", "X", 0.5)},
        {**FOUR_MODE, "W": "backward"},
        (BodyPoint("Y", "rocker", 0.28, 0.03),),
        (Guide("sleeve", "rocker", on="bar", through=(0.05, 0.02), direction=0.2, offset=-0.03, at="Y", tilt=1.2),),
        loads=(
            SlideDamper("oil", "sleeve", "rocker", "bar", "Y", 30.0),
            TorsionSpring("clock", "bar", FRAME, 2.0, 0.3, 0.1),
            Force("push", "bar", "X", lambda v: 20.0, 2.1),
        ),
    ),
    Example(
        "Whitworth",
        ("RPR", "RRP"),
        {"A": (0.0, 0.0), "D": (0.02, -0.35)},
        {
            "crank": ("A", "B", 0.15),
            "block": ("B", "", 0.0),
            "arm": ("D", "E", 0.7),
            "rod": ("E", "C", 0.25),
            "ram": ("C", "", 0.0),
        },
        {"slot": "forward", "C": "forward"},
        (BodyPoint("N", "block", 0.04, -0.02),),
        (
            Guide("slot", "block", on="arm", through="D", direction=0.1, offset=0.03, at="N", tilt=0.35),
            Guide("way", "ram", through=(0.0, 0.38)),
        ),
        loads=(
            Force("cut", "ram", "C", lambda v: 400.0 + 10.0 * v["v"], "way", opposing=True, stroke="forward"),
            SlideDamper("oil", "slot", "block", "arm", "N", 15.0),
            SlideDamper("film", "way", "ram", FRAME, "C", 60.0),
        ),
    ),
    Example(
        "rod through a trunnion",
        ("RPR",),
        {"A": (0.0, 0.0), "D": (0.55, 0.1)},
        {"crank": ("A", "B", 0.15), "rod": ("B", "T", 0.8), "trunnion": ("D", "", 0.0)},
        {"bush": "forward"},
        (BodyPoint("J", "trunnion", 0.02, 0.05),),
        (Guide("bush", "trunnion", on="rod", offset=-0.06, direction=-0.15, at="J", tilt=0.2),),
        loads=(
            Force("tip", "rod", "T", lambda v: 30.0 + v["omega"], 0.3, opposing=True),
            Torque("hand", "trunnion", lambda v: 1.5),
        ),
    ),
    Example(
        "Scotch yoke with an oblique slot",
        ("RPP",),
        {"A": (0.0, 0.0)},
        {"crank": ("A", "B", 0.15), "block": ("B", "", 0.0), "yoke": ("Y", "Z", 0.4)},
        {},
        (BodyPoint("N", "block", 0.02, 0.03), BodyPoint("U", "yoke", 0.05, -0.04)),
        (
            Guide("slot", "block", on="yoke", through="U", direction=0.9, offset=0.02, at="N", tilt=-0.4),
            Guide("way", "yoke", through=(0.3, 0.1), direction=0.2, offset=-0.05, at="U", tilt=0.25),
        ),
        loads=(
            Force("cut", "yoke", "Z", lambda v: 90.0, "way", opposing=True),
            SlideDamper("oil", "slot", "block", "yoke", "N", 20.0),
            Spring("back", ((FRAME, "A"), ("yoke", "Z")), 200.0, 0.5, 2.0),
        ),
    ),
    Example(
        "yoke on the rocker, slider of the block",
        ("RRR", "RPP"),
        FOUR_GROUND,
        {**FOUR, "block": ("P", "", 0.0), "yoke": ("Y", "", 0.0)},
        FOUR_MODE,
        (P, BodyPoint("N", "yoke", 0.1, 0.03)),
        (
            Guide("slot", "yoke", on="block", through=(0.02, 0.01), direction=0.4, offset=0.02, at="N", tilt=0.4),
            Guide("rail", "rocker", on="yoke", through="N", direction=0.7, offset=0.05, at="C", tilt=-0.2),
        ),
        loads=(
            SlideDamper("oil", "rail", "rocker", "yoke", "C", 35.0),
            Force("rub", "yoke", "N", lambda v: 12.0, "slot", opposing=True, stroke="backward"),
        ),
    ),
    Example(
        "two sliders on rocker and frame",
        ("RRR", "PRP"),
        FOUR_GROUND,
        {**FOUR, "one": ("J", "", 0.0), "two": ("O", "", 0.0)},
        FOUR_MODE,
        (BodyPoint("J", "two", 0.03, 0.02), BodyPoint("L", "one", -0.02, 0.04)),
        (
            Guide("arm", "one", on="rocker", direction=0.1, offset=0.03, at="L", tilt=0.3),
            Guide("way", "two", through=(0.2, 0.4), direction=0.7, tilt=-0.5),
        ),
        loads=(
            SlideDamper("oil", "arm", "one", "rocker", "L", 18.0),
            Force("cut", "two", "J", lambda v: 45.0, "way", opposing=True),
        ),
    ),
    Example(
        "block on the coupler in a bar on the rocker",
        ("RRR", "PRP"),
        FOUR_GROUND,
        {**FOUR, "block": ("J", "", 0.0), "bar": ("X", "J", 0.25)},
        FOUR_MODE,
        (),
        (
            Guide("rail", "block", on="coupler", through=(0.1, 0.05), direction=-0.1, tilt=0.2),
            Guide("sleeve", "rocker", on="bar", through=(0.02, 0.01), direction=0.3, offset=0.04, at="C", tilt=0.1),
        ),
        loads=(
            TorsionSpring("clip", "bar", "coupler", 1.2, 0.8, 0.2),
            Spring("pull", (("bar", "X"), (FRAME, "A")), 80.0, 0.4, 1.0),
        ),
    ),
)
BY_NAME = {example.name: example for example in EXAMPLES}
every_machine = pytest.mark.parametrize("example", EXAMPLES, ids=str)
DRIVES = ((7.0, 0.0), (-7.0, 11.0), (4.0, 60.0))
every_drive = pytest.mark.parametrize(("speed", "acceleration"), DRIVES, ids=["forward", "backward, braked", "run up"])


@cache
def machine_of(name: str) -> Machine:
    return BY_NAME[name].machine


# --- what the loads exert, written again --------------------------------------------------------------------------------


def reversing(load: Force | Torque, k: Kinematics) -> np.ndarray:
    """The velocity along a force's direction, or of the body that a torque acts on."""
    if isinstance(load, Torque):
        return k.turning(load.body)[1]
    if isinstance(load.direction, str):
        return k.slide(load.direction)[1]
    return k.point(load.body, load.point)[1] @ np.array([np.cos(load.direction), np.sin(load.direction)])


def exerted(load: Load, k: Kinematics, creeping: Kinematics | None = None) -> list[External]:
    """A load from its data and the motion of the oracle; the senses are those of another motion where one is given."""
    nothing = np.zeros_like(k.phi)
    known = {"phi": k.phi, "omega": k.omega}
    if isinstance(load, Force | Torque):
        sense = np.sign(reversing(load, k if creeping is None else creeping))
        factor = (-sense if load.opposing else 1.0) * {"both": 1.0, "forward": sense > 0.0, "backward": sense < 0.0}[load.stroke]
    if isinstance(load, Force):
        if isinstance(load.direction, str):
            line = k.line(load.direction)
            known |= dict(zip("sv", k.slide(load.direction), strict=True))
        else:
            line = np.tile([np.cos(load.direction), np.sin(load.direction)], (len(k.phi), 1))
        size = load.magnitude(known) * factor + nothing
        return [External(load.body, k.point(load.body, load.point)[0], size[:, None] * line, nothing)]
    if isinstance(load, Torque):
        angle, rate, _ = k.turning(load.body)
        size = load.magnitude({**known, "theta": angle, "w": rate}) * factor + nothing
        place = k.material(load.body, np.zeros(2))[0]
        return [External(load.body, place, np.zeros_like(place), size)]
    if isinstance(load, Spring):
        (one, p), (two, q) = load.ends
        (start, slow, _), (end, fast, _) = k.point(one, p), k.point(two, q)
        apart = end - start
        length = np.hypot(apart[:, 0], apart[:, 1])
        way = apart / length[:, None]
        pull = load.stiffness * (length - load.free) + load.damping * np.sum(way * (fast - slow), axis=-1)
        return [External(one, start, pull[:, None] * way, nothing), External(two, end, -pull[:, None] * way, nothing)]
    if isinstance(load, TorsionSpring):
        (angle, rate, _), (other, carried, _) = k.turning(load.body), k.turning(load.against)
        twist = np.remainder(angle - other - load.free + np.pi, 2.0 * np.pi) - np.pi
        size, far = -load.stiffness * twist - load.damping * (rate - carried), np.zeros((len(k.phi), 2))
        return [External(load.body, far, far, size), External(load.against, far, far, -size)]
    assert isinstance(load, SlideDamper)
    place = k.point(load.slider, load.point)[0]
    force = (-load.damping * k.slide(load.guide)[1])[:, None] * k.line(load.guide)
    still = np.zeros_like(k.phi)
    return [External(load.slider, place, force, still), External(load.on, place, -force, still)]


def lossy(loads: Sequence[Load]) -> list[Load]:
    """The loads without what springs keep."""
    return [replace(load, stiffness=0.0) if isinstance(load, Spring | TorsionSpring) else load for load in loads]


# --- the comparison -----------------------------------------------------------------------------------------------------


KNOWN: dict[tuple[object, ...], Kinematics] = {}


def kinematics(moving: Moving, speed: object = None) -> Kinematics:
    """The motion found again from the loop equations, starting from positions that are a little wrong."""
    machine, phi = moving.machine, moving.motion.crank_angle
    turning, second = moving.motion.speed if speed is None else speed, moving.motion.crank_acceleration
    drive = b"".join(np.asarray(part, dtype=float).tobytes() for part in (phi, turning, second))
    key = id(machine.mechanism), tuple(machine.sizes.items()), drive
    if key in KNOWN:
        return KNOWN[key]
    near = np.empty((phi.size, len(machine.mechanism.bodies), 3))
    for k, body in enumerate(machine.mechanism.bodies):
        state = moving.state(body)
        near[:, k, 0], near[:, k, 1] = state.start
        near[:, k, 2] = np.arctan2(state.axis[1], state.axis[0])
    near += np.random.default_rng(3).uniform(-2e-3, 2e-3, near.shape)
    KNOWN[key] = Kinematics(machine.mechanism, machine.sizes, phi, turning, second, near)
    return KNOWN[key]


def masses(machine: Machine) -> dict[str, Mass]:
    return {body: Mass(inertia.mass, inertia.along, inertia.across, inertia.moment) for body, inertia in machine.inertias.items()}


def expected(moving: Moving, k: Kinematics | None = None, **known: object) -> Solution:
    """The oracle's answer for a machine."""
    machine = moving.machine
    k = kinematics(moving) if k is None else k
    loads = [acting for load in machine.loads for acting in exerted(load, k)]
    return newton_euler(k, masses(machine), machine.gravity, loads, machine.friction, **known)


def flat(vector: Sequence[object], like: np.ndarray) -> np.ndarray:
    """A pair of Values as (positions, 2)."""
    return np.stack(np.broadcast_arrays(*vector, like)[:2], axis=-1)


def close(computed: np.ndarray, reference: np.ndarray, tolerance: float, least: float, what: str) -> None:
    """Equal to a share of the largest value of the quantity (`least`: what counts as nothing beside the others)."""
    scale = max(float(np.nanmax(np.abs(reference), initial=0.0)), 1e-3 * least)
    np.testing.assert_allclose(computed, reference, rtol=0.0, atol=tolerance * scale, err_msg=what)


def check(result: Reactions, reference: Solution, tolerance: float = SAME, where: np.ndarray | slice = slice(None)) -> None:
    """Every reaction on every body, every guide, the torque."""
    like = np.zeros_like(reference.torque)
    force = max(float(np.nanmax(np.abs(f))) for bodies in reference.pins.values() for f in bodies.values())
    moment = float(np.nanmax(np.abs(reference.torque)))
    close((result.torque + like)[where], reference.torque[where], tolerance, 0.0, "torque")
    assert result.pins.keys() == reference.pins.keys()
    for point, bodies in reference.pins.items():
        assert result.pins[point].keys() == bodies.keys()
        for body, on in bodies.items():
            close(flat(result.pins[point][body], like)[where], on[where], tolerance, force, f"pin {point} on {body}")
    assert result.guides.keys() == reference.normal.keys()
    for name, guide in result.guides.items():
        close((guide.normal + like)[where], reference.normal[name][where], tolerance, force, f"normal force in {name}")
        close((guide.friction + like)[where], reference.friction[name][where], tolerance, force, f"friction in {name}")
        close((guide.moment + like)[where], reference.moment[name][where], tolerance, moment, f"moment in {name}")


def check_balance(moving: Moving, k: Kinematics, tolerance: float = SAME) -> None:
    """What the driver and the loads feed in is what inertia and weight take up."""
    machine, result = moving.machine, reactions(moving)
    loads = k.power([acting for load in machine.loads for acting in exerted(load, k)])
    for name, guide in result.guides.items():
        loads = loads + guide.friction * k.slide(name)[1]
    driver, taken = result.torque * k.omega, k.power_of_masses(masses(machine), machine.gravity)
    scale = np.max(np.abs([driver, taken, loads]))
    np.testing.assert_allclose(driver + loads, taken, rtol=0.0, atol=tolerance * scale)


EIGHTH = ((1, 4.0 / 5.0), (2, -1.0 / 5.0), (3, 4.0 / 105.0), (4, -1.0 / 280.0))


def check_energy(moving: Moving, k: Kinematics, tolerance: float = SAME) -> None:
    """The torque's power is the rate of the energy (by differences along the motion) and what is lost to the loads."""
    machine, motion = moving.machine, moving.motion
    step = 0.01 / abs(motion.speed)

    def energy(ahead: float) -> np.ndarray:
        speed = motion.speed + motion.crank_acceleration * ahead
        angle = motion.crank_angle + (motion.speed + 0.5 * motion.crank_acceleration * ahead) * ahead
        then = machine.moving(angle, speed, motion.crank_acceleration)
        return then.kinetic + then.potential

    rate = sum(weight * (energy(n * step) - energy(-n * step)) for n, weight in EIGHTH) / step
    driver = reactions(moving).torque * motion.speed
    lost = -k.power([acting for load in lossy(machine.loads) for acting in exerted(load, k)])
    scale = np.max(np.abs([driver, rate, lost]))
    np.testing.assert_allclose(driver, rate + lost, rtol=0.0, atol=tolerance * scale)


# --- motion and reactions of every machine --------------------------------------------------------------------------------


def test_the_machines_hold_every_dyad_in_every_variant():
    """Which the catalogue claims: each dyad, each side of a guide unknown, guides on bodies, offsets, pins of many bodies."""
    kinds, seen = set(), set()
    for example in EXAMPLES:
        mechanism = machine_of(example.name).mechanism
        assert tuple(group.kind for group in mechanism.groups) == example.kinds
        kinds |= set(example.kinds)
        motion = machine_of(example.name).moving(np.linspace(0.0, 2.0 * np.pi, 73)).motion
        assert all((motion.margin(joint) > 0.02).all() for joint in motion.pose.margins), "it moves through the revolution"
        for group in mechanism.groups:
            new = {link.body for link in group.links}
            for guide in mechanism.guides:
                if len(new & set(guide.bodies)) == 1:
                    seen.add((group.kind, "unknown slides" if guide.slider in new else "unknown carries"))
                    seen.add((group.kind, "frame" if FRAME in guide.bodies else "moving"))
        seen |= {("pin", len(bodies)) for bodies in mechanism.pins.values()}
        seen |= {("frame pin", len(bodies)) for bodies in mechanism.pins.values() if FRAME in bodies}
    assert kinds == {"RRR", "RRP", "RPR", "RPP", "PRP"}
    sliding = {(kind, how) for kind in ("RRP", "RPP", "PRP") for how in ("unknown slides", "unknown carries", "frame", "moving")}
    assert sliding | {("pin", 2), ("pin", 3), ("frame pin", 2), ("frame pin", 3)} <= seen


@every_machine
@every_drive
def test_motion_is_that_of_the_loop_equations(example, speed, acceleration):
    moving = machine_of(example.name).moving(example.phi, speed, acceleration)
    k = kinematics(moving)
    for body in moving.machine.mechanism.bodies:
        state = moving.state(body)
        place, velocity, change = k.material(body, np.zeros(2))
        angle, rate, second = k.turning(body)
        close(flat(state.start, angle), place, 1e-11, 1.0, body)
        close(flat(state.velocity, angle), velocity, 1e-11, abs(speed), body)
        close(flat(state.acceleration, angle), change, 1e-11, speed**2, body)
        close(flat(state.axis, angle), np.stack([np.cos(angle), np.sin(angle)], axis=-1), 1e-11, 1.0, body)
        close(state.omega + 0.0 * angle, rate, 1e-11, abs(speed), body)
        close(state.alpha + 0.0 * angle, second, 1e-11, speed**2, body)
    for name, (s, v, _) in moving.slides.items():
        slid, fast = k.slide(name)
        close(s, slid, 1e-11, 1.0, name)
        close(v, fast, 1e-11, abs(speed), name)


@every_machine
@every_drive
def test_reactions_are_those_of_newton_and_euler(example, speed, acceleration):
    moving = machine_of(example.name).moving(example.phi, speed, acceleration)
    result = reactions(moving)
    check(result, expected(moving))
    assert result.jammed is False
    for guide in result.guides.values():
        assert np.max(np.abs(guide.friction)) <= 1e-12 * np.max(np.abs(guide.normal))
    for sine in result.singularity.values():
        assert np.all((np.abs(sine) > 0.1) & (np.abs(sine) <= 1.0 + 1e-12))


@every_machine
def test_guide_forces_state_their_point_and_direction(example):
    moving = machine_of(example.name).moving(example.phi, 7.0)
    k, result = kinematics(moving), reactions(moving)
    for name, guide in result.guides.items():
        line, place = k.line(name), k.material(k.guides[name].slider, k.runner(k.guides[name]))[0]
        np.testing.assert_allclose(flat(guide.point, k.phi), place, rtol=0.0, atol=1e-12)
        force = flat(guide.force, k.phi)
        scale = np.max(np.abs(force))
        np.testing.assert_allclose(np.sum(force * line, axis=-1), guide.friction, rtol=0.0, atol=1e-12 * scale)
        normal = line[:, 0] * force[:, 1] - line[:, 1] * force[:, 0]
        np.testing.assert_allclose(normal, guide.normal, rtol=0.0, atol=1e-12 * scale)


@every_machine
def test_forces_of_a_pin_sum_to_zero(example):
    check_pins(reactions(machine_of(example.name).moving(example.phi, 7.0, 3.0)), example.phi)


def test_check_of_pins_detects_a_force_transmitted_once_only():
    result = reactions(machine_of("pins of three and four bodies").moving(PHI, 7.0, 3.0))
    for body in ("link2", "link3", "link5"):
        bodies = {name: force for name, force in result.pins["C"].items() if name != body}
        with pytest.raises(AssertionError, match="C"):
            check_pins(replace(result, pins={**result.pins, "C": bodies}), PHI)


def check_pins(result: Reactions, like: np.ndarray) -> None:
    for point, bodies in result.pins.items():
        forces = np.array([flat(force, like) for force in bodies.values()])
        np.testing.assert_allclose(np.sum(forces, axis=0), 0.0, atol=1e-12 * np.max(np.abs(forces)), err_msg=point)


# --- energy ---------------------------------------------------------------------------------------------------------------


@every_machine
@every_drive
def test_power_is_balanced(example, speed, acceleration):
    moving = machine_of(example.name).moving(example.phi, speed, acceleration)
    k = kinematics(moving)
    check_balance(moving, k)
    check_energy(moving, k)


@every_machine
def test_energies_are_those_of_the_centroids(example):
    moving = machine_of(example.name).moving(example.phi, -7.0)
    check_energies(moving, kinematics(moving), masses(moving.machine))


def check_energies(moving: Moving, k: Kinematics, of_body: Mapping[str, Mass]) -> None:
    kinetic, potential = k.energy(of_body, GRAVITY)
    np.testing.assert_allclose(moving.kinetic, kinetic, rtol=1e-11)
    springs = np.zeros_like(k.phi)
    for load in moving.machine.loads:
        np.testing.assert_allclose(load.potential(moving) + 0.0 * k.phi, spring_energy(load, k), rtol=1e-9, atol=1e-12)
        springs = springs + spring_energy(load, k)
    scale = np.max(np.abs([potential, springs]))
    np.testing.assert_allclose(moving.potential, potential + springs, rtol=0.0, atol=1e-11 * scale)


@pytest.mark.parametrize("part", ["mass", "along", "across", "moment"])
def test_energy_check_detects_a_wrong_parameter(part):
    moving = machine_of("Watt I").moving(PHI, -7.0)
    k, of_body = kinematics(moving), masses(moving.machine)
    check_energies(moving, k, of_body)
    with pytest.raises(AssertionError):
        check_energies(
            moving, k, {**of_body, "rod": replace(of_body["rod"], **{part: getattr(of_body["rod"], part) * (1.0 + 1e-8)})}
        )


def spring_energy(load: Load, k: Kinematics) -> np.ndarray:
    if isinstance(load, Spring):
        (one, p), (two, q) = load.ends
        apart = k.point(two, q)[0] - k.point(one, p)[0]
        return 0.5 * load.stiffness * (np.hypot(apart[:, 0], apart[:, 1]) - load.free) ** 2
    if isinstance(load, TorsionSpring):
        twist = k.turning(load.body)[0] - k.turning(load.against)[0] - load.free
        return 0.5 * load.stiffness * (np.remainder(twist + np.pi, 2.0 * np.pi) - np.pi) ** 2
    return np.zeros_like(k.phi)


# --- what is made of the reactions ------------------------------------------------------------------------------------------


@every_machine
def test_torque_parts_are_those_of_each_cause_alone_and_sum_to_the_torque(example):
    moving = machine_of(example.name).moving(example.phi, 7.0, 20.0)
    result, k = torque_parts(moving), kinematics(moving)
    of_body, loads = masses(moving.machine), [acting for load in moving.machine.loads for acting in exerted(load, k)]
    alone = {
        "inertia": newton_euler(k, of_body, (0.0, 0.0)).torque,
        "gravity": newton_euler(k, of_body, GRAVITY, inertia=False).torque,
        "load": newton_euler(k, {}, (0.0, 0.0), loads).torque,
    }
    torque = reactions(moving).torque
    scale = np.max(np.abs([torque, *alone.values()]))
    assert result.keys() == alone.keys()
    for cause, part in alone.items():
        assert np.max(np.abs(part)) > 1e-3 * scale, "every cause matters"
        np.testing.assert_allclose(result[cause], part, rtol=0.0, atol=SAME * scale, err_msg=cause)
    np.testing.assert_allclose(sum(result.values()), torque, rtol=0.0, atol=1e-13 * scale)


def test_friction_counts_among_the_loads():
    machine = machine_of("Whitworth")
    smooth, rough = (machine.with_(friction=mu).moving(PHI, 7.0) for mu in ({}, {"slot": 0.1, "way": 0.2}))
    one, other = torque_parts(smooth), torque_parts(rough)
    for cause in ("inertia", "gravity"):
        np.testing.assert_array_equal(other[cause], one[cause])
    more = reactions(rough).torque - reactions(smooth).torque
    assert np.max(np.abs(more)) > 0.01 * np.max(np.abs(one["load"]))
    np.testing.assert_allclose(other["load"] - one["load"], more, rtol=0.0, atol=1e-10)


def parts_of(moving: Moving) -> dict[str, list[Reactions]]:
    """Return the reactions per unit of each inertial parameter, by body."""
    bodies = moving.machine.mechanism.bodies
    records = iter(Effects(moving, bodies, ()).alone)
    return {body: [next(records).reactions for _ in range(4)] for body in bodies}


def check_regressor(moving: Moving, parts: dict[str, list[Reactions]]) -> None:
    """Inertial parameters times the regressor against the oracle without loads."""
    machine = moving.machine
    reference = newton_euler(kinematics(moving), masses(machine), machine.gravity)
    like = np.zeros_like(reference.torque)
    terms = []
    for body, inertia in machine.inertias.items():
        centre = np.array([inertia.along, inertia.across])
        first = inertia.mass * centre
        parameters = (inertia.mass, *first, inertia.moment + inertia.mass * centre @ centre)
        np.testing.assert_allclose(inertia.parameters, parameters, rtol=1e-14)
        terms += list(zip(parameters, parts[body], strict=True))
    total = Solution(sum(weight * (part.torque + like) for weight, part in terms))
    for point, bodies in reference.pins.items():
        total.pins[point] = {b: sum(w * flat(part.pins[point][b], like) for w, part in terms) for b in bodies}
    for name in reference.normal:
        total.normal[name] = sum(w * (part.guides[name].normal + like) for w, part in terms)
        total.friction[name] = sum(w * (part.guides[name].friction + like) for w, part in terms)
        total.moment[name] = sum(w * (part.guides[name].moment + like) for w, part in terms)
    force = max(np.max(np.abs(f)) for bodies in reference.pins.values() for f in bodies.values())
    close(total.torque, reference.torque, SAME, 0.0, "torque")
    for point, bodies in reference.pins.items():
        for body in bodies:
            close(total.pins[point][body], bodies[body], SAME, force, f"pin {point} on {body}")
    for name in reference.normal:
        close(total.normal[name], reference.normal[name], SAME, force, name)
        close(total.friction[name], reference.friction[name], SAME, force, name)
        close(total.moment[name], reference.moment[name], SAME, np.max(np.abs(reference.torque)), name)


@every_machine
def test_regressor_gives_the_part_of_inertia_and_gravity_in_every_reaction(example):
    mu = {guide.name: 0.1 for guide in example.guides}  # the regressor is of the smooth machine
    moving = machine_of(example.name).with_(friction=mu).moving(example.phi, -7.0, 13.0)
    check_regressor(moving, parts_of(moving))


def test_regressor_check_detects_exchanged_parameters():
    moving = machine_of("Watt I").moving(PHI, 7.0)
    parts = parts_of(moving)
    mass, along, across, moment = parts["rod"]
    with pytest.raises(AssertionError):
        check_regressor(moving, {**parts, "rod": [mass, across, along, moment]})
    assert Parameters._fields == ("mass", "along", "across", "moment")


@every_machine
def test_shaking_force_equals_the_inertia_of_the_centroids(example):
    moving = machine_of(example.name).moving(example.phi, 7.0, -30.0)
    check_shaking(moving, kinematics(moving), shaking(moving))


def test_shaking_check_detects_gravity_another_pivot_and_a_sign(monkeypatch):
    moving = machine_of("Whitworth").moving(PHI, 7.0, -30.0)
    k, honest = kinematics(moving), shaking(moving)
    x, y = honest.force
    for wrong in (
        honest._replace(force=(x, -y)),
        honest._replace(moment=-honest.moment),
        honest._replace(moment=honest.about((0.0, 0.0), (0.01, 0.0))),
    ):
        with pytest.raises(AssertionError):
            check_shaking(moving, k, wrong)
    monkeypatch.setattr(reactions_module, "wrench", lambda p, state, gravity: HONEST_WRENCH(p, state, GRAVITY))
    with pytest.raises(AssertionError):
        check_shaking(moving, k, shaking(moving))


def check_shaking(moving: Moving, k: Kinematics, result: Wrench) -> None:
    """Minus the rates of the momentum and of the angular momentum about the crank pivot."""
    pivot = np.tile(moving.machine.mechanism.ground["A"], (len(k.phi), 1))
    force, moment = k.momentum_rate(masses(moving.machine), pivot)
    np.testing.assert_allclose(flat(result.force, k.phi), -force, rtol=0.0, atol=SAME * np.max(np.abs(force)))
    np.testing.assert_allclose(result.moment, -moment, rtol=0.0, atol=SAME * np.max(np.abs(moment)))


@every_machine
def test_shaking_without_gravity_and_loads_is_the_frame_reaction(example):
    """Reactions on the frame, the counter-torque of the driver and the forces of the guides are all that reaches it."""
    moving = machine_of(example.name).with_(gravity=(0.0, 0.0), loads=()).moving(example.phi, 7.0, -30.0)
    k, result = kinematics(moving), reactions(moving)
    total, about = np.zeros((len(k.phi), 2)), -result.torque
    for point, bodies in result.pins.items():
        if FRAME in bodies:
            force, place = flat(bodies[FRAME], k.phi), np.array(example.ground[point]) - example.ground["A"]
            total, about = total + force, about + place[0] * force[:, 1] - place[1] * force[:, 0]
    for name, guide in result.guides.items():
        if k.guides[name].on == FRAME:
            force, place = -flat(guide.force, k.phi), flat(guide.point, k.phi) - example.ground["A"]
            total, about = total + force, about - guide.moment + place[:, 0] * force[:, 1] - place[:, 1] * force[:, 0]
    shaken = shaking(moving)
    np.testing.assert_allclose(total, flat(shaken.force, k.phi), rtol=0.0, atol=SAME * np.max(np.abs(total)))
    np.testing.assert_allclose(about, shaken.moment, rtol=0.0, atol=SAME * np.max(np.abs(about)))


# --- who acts on whom -------------------------------------------------------------------------------------------------------

ACTING = {  # point -> (by, on): outer joints first what is placed before, inner joints the second of the group on the first
    "Watt I": {
        "A": (FRAME, "crank"),
        "B": ("crank", "coupler"),
        "C": ("rocker", "coupler"),
        "D": (FRAME, "rocker"),
        "E": ("coupler", "rod"),
        "F": ("rocker", "lever"),
        "G": ("lever", "rod"),
    },
    "pins of three and four bodies": {
        "A": ("pin", "crank"),
        "B": ("crank", "link2"),
        "C": ("pin", "link2"),
        "D": ("pin", "link3"),
        "E": ("pin", "link5"),
        "K": ("pin", "link7"),
        "M": ("link10", "link9"),
    },
    "Whitworth": {
        "A": (FRAME, "crank"),
        "B": ("crank", "block"),
        "D": (FRAME, "arm"),
        "E": ("arm", "rod"),
        "C": ("ram", "rod"),
    },
    "Scotch yoke with an oblique slot": {"A": (FRAME, "crank"), "B": ("crank", "block")},
    "two sliders on rocker and frame": {
        "A": (FRAME, "crank"),
        "B": ("crank", "coupler"),
        "C": ("rocker", "coupler"),
        "D": (FRAME, "rocker"),
        "J": ("two", "one"),
    },
}


@pytest.mark.parametrize("name", ACTING)
def test_directions_of_reactions_are_as_documented(name):
    machine = machine_of(name)
    moving = machine.moving(PHI, 7.0, 5.0)
    result, reference = reactions(moving), expected(moving)
    assert acting_on(machine) == ACTING[name]
    assert reported_on(machine) == {point: on for point, (_, on) in ACTING[name].items()}
    for point, (by, on) in ACTING[name].items():
        forces = flat(result.pin(machine, point), PHI)
        scale = np.max(np.abs(forces))
        np.testing.assert_allclose(forces, reference.pins[point][on], rtol=0.0, atol=SAME * scale)
        if by != "pin":
            np.testing.assert_allclose(forces, -reference.pins[point][by], rtol=0.0, atol=SAME * scale)
            assert scale > 0.1, "the sign would be lost in nothing"


def test_a_reaction_is_reported_on_the_named_body():
    machine = machine_of("pins of three and four bodies").with_(reported={"C": "link5", "B": "crank"})
    moving = machine.moving(PHI, 7.0)
    result, reference = reactions(moving), expected(moving)
    assert acting_on(machine)["C"] == ("pin", "link5")
    assert acting_on(machine)["B"] == ("link2", "crank")
    for point, body in machine.reported.items():
        forces = flat(result.pin(machine, point), PHI)
        np.testing.assert_allclose(forces, reference.pins[point][body], rtol=0.0, atol=SAME * np.max(np.abs(forces)))


# --- friction ---------------------------------------------------------------------------------------------------------------

ROUGH = [example for example in EXAMPLES if example.guides]
every_rough_machine = pytest.mark.parametrize("example", ROUGH, ids=str)


def rough(example: Example, mu: float) -> Machine:
    """Friction in every guide, not the same in each."""
    return machine_of(example.name).with_(friction={guide.name: mu * (1 + n) for n, guide in enumerate(example.guides)})


def check_opposed(result: Reactions, k: Kinematics, mu: Mapping[str, float]) -> None:
    """mu |N| against the sliding of the oracle: signed, so that N * friction * v alone does not decide."""
    for name, guide in result.guides.items():
        _, v = k.slide(name)
        opposed = -mu[name] * np.abs(guide.normal) * np.sign(v)
        np.testing.assert_allclose(guide.friction, opposed, rtol=1e-9, atol=1e-9 * np.max(np.abs(guide.normal)))
        assert np.all(guide.friction * v <= 0.0)


@every_rough_machine
@every_drive
def test_friction_is_mu_times_the_normal_force_against_the_motion(example, speed, acceleration):
    moving = rough(example, 0.11).moving(example.phi, speed, acceleration)
    result, k = reactions(moving), kinematics(moving)
    reference = expected(moving, k)
    np.testing.assert_array_equal(reference.consistent, 1)
    check(result, reference)
    assert not np.any(result.jammed)
    check_opposed(result, k, moving.machine.friction)
    check_balance(moving, k)


def test_friction_checks_see_the_wrong_sense(monkeypatch):
    example = BY_NAME["Whitworth"]
    machine = rough(example, 0.11).with_(loads=())
    moving = machine.moving(example.phi, 7.0)
    k = kinematics(moving)
    check(reactions(moving), expected(moving))
    check_opposed(reactions(moving), k, machine.friction)
    monkeypatch.setattr(Moving, "sense", lambda self, of, size=1.0: -np.sign(of(self)[0]))
    wrong = reactions(machine.moving(example.phi, 7.0))
    with pytest.raises(AssertionError):
        check(wrong, expected(moving))
    with pytest.raises(AssertionError):
        check_opposed(wrong, k, machine.friction)


JAMMING = {
    "pins of three and four bodies": 1.2,
    "slider-crank with offset and tilt": 8.0,
    "slider on the coupler": 0.8,
    "bar over a block of the rocker": 0.5,
    "Whitworth": 1.2,
    "rod through a trunnion": 4.0,
    "Scotch yoke with an oblique slot": 0.5,
    "two sliders on rocker and frame": 0.5,
    "block on the coupler in a bar on the rocker": 0.5,
}


@pytest.mark.parametrize(("name", "mu"), JAMMING.items())
def test_a_jammed_guide_is_reported_and_has_no_reactions(name, mu):
    """With much friction no sign of the normal force is consistent at some positions: NaN there, else the oracle's values.

    Positions with more than one consistent answer (Painleve's paradox) are left out: the law of friction does not decide there.
    """
    example = BY_NAME[name]
    moving = rough(example, mu).moving(np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False) + 0.013, 7.0)
    result, reference = reactions(moving), expected(moving)
    decided = reference.consistent <= 1
    stuck, clear = reference.consistent == 0, reference.consistent == 1
    assert stuck.sum() > 5
    assert clear.sum() > 5
    np.testing.assert_array_equal(result.jammed[decided], stuck[decided])
    np.testing.assert_array_equal(np.isnan(result.torque)[decided], stuck[decided])
    nothing = np.zeros(stuck.shape)
    guides = [np.isnan(guide.normal + nothing) | np.isnan(guide.moment + nothing) for guide in result.guides.values()]
    np.testing.assert_array_equal(np.any(guides, axis=0)[decided], stuck[decided])
    check(result, reference, where=clear)


def test_a_wedge_jams_beyond_the_angle_of_friction_by_hand():
    """A massless slider pulled along by a rod at the angle beta to its way: it jams where mu tan(beta) exceeds one.

    Across: N = R sin(beta), along: R cos(beta) = sense (F + mu |N|), so N = F sense tan(beta) / (1 - mu |tan(beta)|).
    """
    links = [Link("crank", "A", "B", 0.1), Link("rod", "B", "C", 0.3), Link("slider", "C")]
    mechanism = Assembly({"A": (0.0, 0.15)}, links, (), [Guide("way", "slider")], "crank", {"C": "forward"}).mechanism("wedge")
    push = Force("push", "slider", "C", lambda v: 10.0, "way", opposing=True)
    phi = np.linspace(0.05, 6.2, 40)
    for mu, jams in ((0.05, False), (0.5, False), (0.9, True), (1.5, True)):
        machine = Machine(mechanism, {}, loads=(push,), friction={"way": mu})
        moving = machine.moving(phi, 3.0)
        result = reactions(moving)
        (x, y), sense = moving.position("B"), np.sign(moving.slides["way"][1])
        slope = y / (moving.position("C")[0] - x)  # tan(beta), of the rod downward to the slider
        stuck = mu * np.abs(slope) > 1.0
        assert stuck.any() == jams
        assert not stuck.all()
        np.testing.assert_array_equal(result.jammed, stuck)
        assert np.isnan(result.torque[stuck]).all()
        normal = 10.0 * sense * slope / (1.0 - mu * np.abs(slope))
        np.testing.assert_allclose(result.guides["way"].normal[~stuck], normal[~stuck], rtol=1e-10)
        pull = flat(result.pins["B"]["rod"], phi)[:, 0]  # what the crank exerts on the rod, along the way
        np.testing.assert_allclose(pull[~stuck], (sense * (10.0 + mu * np.abs(normal)))[~stuck], rtol=1e-10)


# --- one side or the other of a reversal, and from rest -----------------------------------------------------------------------


def centric() -> Machine:
    """A slider-crank whose slider reverses at 0 and pi exactly, against a load and friction, and lifted in one stroke only."""
    links = [Link("crank", "A", "B", 0.1), Link("rod", "B", "C", 0.3), Link("slider", "C")]
    mechanism = Assembly({"A": (0.0, 0.0)}, links, (), [Guide("way", "slider")], "crank", {"C": "forward"}).mechanism("centric")
    inertias = {"rod": Inertia(1.0, 0.14, 0.02, 0.01), "slider": Inertia(2.0, 0.01, 0.03, 0.002)}
    loads = (
        Force("cut", "slider", "C", lambda v: 80.0, "way", opposing=True),
        Force("lift", "slider", "C", lambda v: 37.0, 1.2, stroke="backward"),
        Torque("brake", "rod", lambda v: 2.0, opposing=True, stroke="forward"),
    )
    return Machine(mechanism, {}, inertias, GRAVITY, loads, {"way": 0.2})


@pytest.mark.parametrize("speed", [5.0, -5.0])
@pytest.mark.parametrize("phi", [0.0, np.pi], ids=["outer", "inner"])
@pytest.mark.parametrize("side", [1, -1], ids=["just after", "just before"])
def test_at_a_reversal_the_side_decides(speed, phi, side):
    machine = centric()
    computed = reactions(machine.moving(np.array([phi]), speed, side=side))
    near = np.array([phi + side * np.sign(speed) * 1e-7])  # after, in time
    moving = machine.moving(near, speed)
    reference = expected(moving)
    check(computed, reference, 1e-5)
    check(reactions(moving), reference)
    opposite = reactions(machine.moving(np.array([phi]), speed, side=-side))
    with pytest.raises(AssertionError):
        check(opposite, reference, 1e-2)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("name", ["centric", *(example.name for example in EXAMPLES)])
def test_from_rest_loads_oppose_the_rotation_to_come(name, direction):
    machine = centric() if name == "centric" else rough(BY_NAME[name], 0.07)
    moving = machine.moving(PHI, 0.0, 30.0, direction=direction)
    k = kinematics(moving)
    slow = kinematics(moving, speed=direction)  # the senses of a crank that creeps
    loads = [acting for load in machine.loads for acting in exerted(load, k, slow)]
    senses = {guide: np.sign(slow.slide(guide)[1]) for guide in machine.friction}
    reference = newton_euler(k, masses(machine), machine.gravity, loads, machine.friction, senses)
    np.testing.assert_array_equal(reference.consistent, 1)
    check(reactions(moving), reference)
    if machine.switching:
        other = machine.moving(PHI, 0.0, 30.0, direction=-direction)
        with pytest.raises(AssertionError):
            check(reactions(other), reference, 1e-3)


@pytest.mark.parametrize("name", ["centric", "Whitworth", "pins of three and four bodies"])
def test_rest_at_one_position_of_many_does_not_disturb_the_others(name):
    """A run up from rest: speeds by position, the first of them zero."""
    machine = centric() if name == "centric" else rough(BY_NAME[name], 0.07)
    speed = np.array([0.0, 0.5, 4.0, 0.0])
    together = machine.moving(PHI[:4], speed, 9.0)
    computed = values(reactions(together))
    for k in range(4):
        alone = values(reactions(machine.moving(PHI[k : k + 1], float(speed[k]), 9.0, direction=1)))
        for quantity, value in alone.items():
            reference = float(np.ravel(value)[0])
            np.testing.assert_allclose(
                (computed[quantity] + 0.0 * PHI[:4])[k], reference, rtol=1e-10, atol=1e-9, err_msg=quantity
            )


@every_machine
def test_a_motion_at_another_speed_is_the_even_one_scaled(example):
    machine = rough(example, 0.07) if example.guides else machine_of(example.name)
    even = machine.moving(example.phi, 1.0)
    for speed, acceleration in DRIVES:
        scaled = even.scaled(speed, acceleration, np.sign(speed))
        check(reactions(scaled), expected(machine.moving(example.phi, speed, acceleration)))


# --- one formula for batches, symbols and complex steps ---------------------------------------------------------------------


def values(result: Reactions) -> dict[str, object]:
    """Every number of a solution by name."""
    named = {"torque": result.torque}
    for point, bodies in result.pins.items():
        named |= {f"{point} {body} {axis}": v for body, force in bodies.items() for axis, v in zip("xy", force, strict=True)}
    for name, guide in result.guides.items():
        named |= {f"{name} normal": guide.normal, f"{name} friction": guide.friction, f"{name} moment": guide.moment}
        named |= {f"{name} {axis}": v for axis, v in zip("xy", guide.force, strict=True)}
    return named | {f"sine {joint}": sine for joint, sine in result.singularity.items()}


@every_machine
@pytest.mark.parametrize("mu", [0.0, 0.11])
def test_batch_is_the_loop(example, mu):
    """Designs as rows of lengths and of masses, angles as columns with a speed of their own."""
    rng = np.random.default_rng(17)
    machine = rough(example, mu) if mu else machine_of(example.name)
    designs = 3
    lengths = {name: length * rng.uniform(0.99, 1.01, (designs, 1)) for name, length in machine.sizes.items()}
    heavy = {
        body: Inertia(*(getattr(inertia, part) * rng.uniform(0.8, 1.2, (designs, 1)) for part in Parameters._fields))
        for body, inertia in machine.inertias.items()
    }
    phi, speed = example.phi[::4], rng.uniform(2.0, 6.0, example.phi[::4].size)
    batch = values(reactions(machine.with_(sizes=lengths, inertias=heavy).moving(phi, speed, 5.0)))
    loop = np.empty((designs, phi.size), dtype=object)
    for row, column in np.ndindex(*loop.shape):
        one = machine.with_(
            sizes={name: float(length[row, 0]) for name, length in lengths.items()},
            inertias={
                body: Inertia(*(float(getattr(inertia, part)[row, 0]) for part in Parameters._fields))
                for body, inertia in heavy.items()
            },
        )
        loop[row, column] = values(reactions(one.moving(phi[column : column + 1], float(speed[column]), 5.0)))
    check_batch(batch, loop)
    for exchanged in (loop[::-1], loop[:, ::-1]):
        with pytest.raises(AssertionError):
            check_batch(batch, exchanged)


def check_batch(batch: Mapping[str, object], loop: np.ndarray) -> None:
    for name, value in batch.items():
        whole = np.broadcast_to(value, loop.shape)
        alone = np.array([[float(np.ravel(one[name])[0]) for one in row] for row in loop])
        scale = max(float(np.max(np.abs(whole))), 1.0)
        np.testing.assert_allclose(alone, whole, rtol=0.0, atol=1e-11 * scale, err_msg=name)


def traced(machine: Machine, phi: object, speed: float = 7.0, acceleration: float = 3.0) -> Reactions:
    """Reactions for symbols, or for any other Value."""
    pose = machine.mechanism.pose(machine.sizes, unit(Jet(phi, speed, acceleration)))
    return reactions(Moving(machine, Motion(machine.mechanism, machine.sizes, phi, speed, pose, acceleration)))


def symbolic(machine: Machine) -> tuple[casadi.Function, casadi.Function, list[str]]:
    """All reactions of lengths and crank angle; derivative of the torque with respect to the lengths and the angle."""
    with symbols_in_numpy():
        x = casadi.SX.sym("x", len(machine.sizes) + 1)
        sizes = {name: Jet(x[k]) for k, name in enumerate(machine.sizes)}  # casadi does not leave a product with a Jet to it
        named = values(traced(machine.with_(sizes=sizes), x[len(machine.sizes)]))
        whole = casadi.Function("all", [x], [casadi.vertcat(*(casadi.SX(v) for v in named.values()))])
        slope = casadi.Function("slope", [x], [casadi.jacobian(named["torque"], x)])
    return whole, slope, list(named)


def check_symbols(whole: casadi.Function, machine: Machine, names: Sequence[str]) -> None:
    lengths = list(machine.sizes.values())
    rows = np.array([np.array(whole([*lengths, phi])).ravel() for phi in PHI])
    computed = values(traced(machine, PHI))
    for k, name in enumerate(names):
        expected_values = computed[name] + 0.0 * PHI
        scale = max(np.max(np.abs(expected_values)), 1.0)
        np.testing.assert_allclose(rows[:, k], expected_values, rtol=0.0, atol=1e-12 * scale, err_msg=name)


@every_machine
def test_symbols_give_the_reactions_of_numbers(example):
    machine = machine_of(example.name)
    whole, _, names = symbolic(machine)
    check_symbols(whole, machine, names)
    assert set(names) == set(values(reactions(machine.moving(PHI, 7.0))))
    with pytest.raises(AssertionError):  # a gravity that is wrong in the ninth place is seen
        check_symbols(whole, machine.with_(gravity=(GRAVITY[0], GRAVITY[1] * (1.0 + 1e-9))), names)


@every_machine
def test_the_slope_of_the_torque_is_that_of_differences_and_of_the_complex_step(example):
    """Complex numbers pass where no load has a sign to find."""
    machine = machine_of(example.name)
    steady = machine.with_(loads=tuple(load for load in machine.loads if not load.switching))
    for subject, by_step in ((machine, False), (steady, True)):
        _, slope, _ = symbolic(subject)
        lengths = list(subject.sizes.values())
        expected_rows = np.array([np.array(slope([*lengths, phi])).ravel() for phi in PHI]).T
        for k, name in enumerate(subject.sizes):

            def torque(change: object, name: str = name, subject: Machine = subject) -> np.ndarray:
                sizes = {**subject.sizes, name: subject.sizes[name] + change}
                return traced(subject.with_(sizes=sizes), PHI).torque

            h = 2e-4 * subject.sizes[name]
            near, far = torque(h) - torque(-h), torque(2.0 * h) - torque(-2.0 * h)
            scale = max(np.max(np.abs(expected_rows[k])), 1.0)
            np.testing.assert_allclose((8.0 * near - far) / (12.0 * h), expected_rows[k], rtol=0.0, atol=1e-7 * scale)
            if by_step:
                step = np.imag(torque(1e-30j)) / 1e-30
                np.testing.assert_allclose(step, expected_rows[k], rtol=0.0, atol=1e-11 * scale, err_msg=name)


# --- singular positions -------------------------------------------------------------------------------------------------------


def test_a_dead_position_is_detected_by_its_sine_without_a_warning():
    """A parallelogram stretched along its frame: the pins and the joint lie on one line."""
    links = [Link("crank", "A", "B", 0.2), Link("coupler", "B", "C", 0.5), Link("rocker", "D", "C", 0.2)]
    mechanism = Assembly({"A": (0.0, 0.0), "D": (0.5, 0.0)}, links, (), (), "crank", {"C": "left of B-D"}).mechanism(
        "parallelogram"
    )
    machine = Machine(mechanism, {}, {"coupler": Inertia(1.0, 0.2, 0.1, 0.02)}, GRAVITY)
    phi = np.array([0.0, 1e-6, 0.5, 1.0])
    result = reactions(machine.moving(phi, 2.0))
    sine = np.abs(result.singularity["C"])
    assert not sine[0] > 1e-7
    assert not np.abs(result.torque[0]) < 1e3 * np.abs(result.torque[2])  # infinite, but for rounding
    assert sine[1] < 1e-5
    assert np.all((sine[2:] > 0.1) & (sine[2:] <= 1.0))
    clear = machine.moving(phi[2:], 2.0)
    check(reactions(clear), expected(clear))


# --- planted defects: each check must see them --------------------------------------------------------------------------------


def fails(check_it: Callable[[], None]) -> bool:
    try:
        check_it()
    except AssertionError:
        return True
    return False


def verdicts(moving: Moving, k: Kinematics, reference: Solution) -> dict[str, bool]:
    """Which of the checks fail."""
    return {
        "oracle": fails(lambda: check(reactions(moving), reference, 1e-6)),
        "balance": fails(lambda: check_balance(moving, k, 1e-6)),
        "energy": fails(lambda: check_energy(moving, k, 1e-6)),
    }


def at_the_centroid(honest: Callable) -> Callable:
    """Loads whose force keeps its size but loses its moment: it acts at the centroid instead of its point."""

    def act(self, moving):
        for acting in honest(self, moving):
            if acting.body == FRAME:
                yield acting
                continue
            inertia, state = moving.machine.inertias[acting.body], moving.state(acting.body)
            x, y = state.axis
            arm = inertia.along * x - inertia.across * y, inertia.along * y + inertia.across * x
            yield acting._replace(point=(state.start[0] + arm[0], state.start[1] + arm[1]))

    return act


MOVED = [
    ("four-bar with springs", Force),
    ("four-bar with springs", Spring),
    ("Watt I", Force),
    ("pins of three and four bodies", Force),
    ("slider on the coupler", SlideDamper),
    ("slider-crank with offset and tilt", Force),
    ("bar over a block of the rocker", Force),
    ("Whitworth", SlideDamper),
    ("rod through a trunnion", Force),
]


@pytest.mark.parametrize(("name", "kind"), MOVED)
def test_checks_see_a_load_moved_to_the_centroid(name, kind, monkeypatch):
    machine = machine_of(name)
    moving = machine.moving(PHI, 7.0, 3.0)
    k, reference = kinematics(moving), expected(moving)
    assert not any(verdicts(moving, k, reference).values())
    monkeypatch.setattr(kind, "act", at_the_centroid(kind.act))
    computed = verdicts(machine.moving(PHI, 7.0, 3.0), k, reference)
    turns = any(isinstance(load, kind) and np.any(k.turning(body)[1]) for load in machine.loads for body in bodies_of(load))
    assert computed == {"oracle": True, "balance": turns, "energy": turns}


def bodies_of(load: Load) -> list[str]:
    """The moving bodies that a load acts on."""
    if isinstance(load, Spring):
        return [body for body, _ in load.ends if body != FRAME]
    if isinstance(load, SlideDamper):
        return [body for body in (load.slider, load.on) if body != FRAME]
    return [load.body]


def other_lever(lever):
    return lever[1], lever[0]


def without_steiner(parameters, state, gravity):
    honest = HONEST_WRENCH(parameters, state, gravity)
    return honest._replace(moment=honest.moment - parameters.along * state.acceleration[1])


def without_centripetal(parameters, state, gravity):
    return HONEST_WRENCH(parameters, state._replace(omega=0.0), gravity)


def turned_gravity(parameters, state, gravity):
    return HONEST_WRENCH(parameters, state, (-gravity[0], gravity[1]))


HONEST_WRENCH = reactions_module.wrench


@pytest.mark.parametrize("name", ["Watt I", "pins of three and four bodies", "Whitworth", "bar over a block of the rocker"])
@pytest.mark.parametrize("defect", [without_steiner, without_centripetal, turned_gravity])
def test_checks_see_a_wrong_wrench(name, defect, monkeypatch):
    moving = machine_of(name).moving(PHI, 7.0, 3.0)
    k, reference = kinematics(moving), expected(moving)
    monkeypatch.setattr(reactions_module, "wrench", defect)
    assert all(verdicts(moving, k, reference).values())


@pytest.mark.parametrize("name", ["Watt I", "slider-crank with offset and tilt", "Whitworth"])
def test_checks_see_a_sign_in_a_balance(name, monkeypatch):
    moving = machine_of(name).moving(PHI, 7.0, 3.0)
    k, reference = kinematics(moving), expected(moving)
    monkeypatch.setattr(inverse, "moment_row", other_lever)
    assert all(verdicts(moving, k, reference).values())


@pytest.mark.parametrize("example", [e for e in EXAMPLES if len(e.kinds) > 1], ids=str)
def test_checks_see_a_reaction_that_is_not_carried_on(example, monkeypatch):
    moving = machine_of(example.name).moving(PHI, 7.0, 3.0)
    k, reference = kinematics(moving), expected(moving)
    monkeypatch.setattr(reactions_module.ForceBalance, "_carry", lambda self, body, point, force, moment: None)
    assert all(verdicts(moving, k, reference).values())


@pytest.mark.parametrize(
    "example", [e for e in EXAMPLES if any(g.on != FRAME for g in e.guides) and e.kinds[-1] in ("RRP", "RPP", "PRP")], ids=str
)
def test_checks_see_a_guide_moment_that_is_not_carried_on(example, monkeypatch):
    """Of a guide on a moving body the force alone is handed on."""
    moving = machine_of(example.name).moving(PHI, 7.0, 3.0)
    k, reference = kinematics(moving), expected(moving)
    honest = reactions_module.ForceBalance._carry
    monkeypatch.setattr(
        reactions_module.ForceBalance, "_carry", lambda self, body, point, force, moment: honest(self, body, point, force, 0.0)
    )
    computed = verdicts(moving, k, reference)
    carried = any(
        len({link.body for link in group.links} & set(guide.bodies)) == 1 and guide.other(link.body) != FRAME
        for group in moving.machine.mechanism.groups
        for guide in moving.machine.mechanism.guides
        for link in group.links
        if link.body in guide.bodies
    )
    assert computed == dict.fromkeys(computed, carried)


@pytest.mark.parametrize("name", ["four-bar with springs", "Whitworth"])
def test_checks_see_a_driver_torque_of_the_wrong_sign_or_a_lost_load(name, monkeypatch):
    machine = machine_of(name)
    moving = machine.moving(PHI, 7.0, 3.0)
    k, reference = kinematics(moving), expected(moving)
    wrong = reactions(moving)
    with pytest.raises(AssertionError, match="torque"):
        check(replace(wrong, torque=-wrong.torque), reference)
    for lost in machine.loads:
        others = tuple(load for load in machine.loads if load is not lost)
        with pytest.raises(AssertionError):
            check(reactions(machine.with_(loads=others).moving(PHI, 7.0, 3.0)), reference, 1e-6)
    assert not any(verdicts(moving, k, reference).values())


def test_motion_check_detects_a_wrong_acceleration(monkeypatch):
    """The loop equations do not share the rule that jets use for a product."""
    example = BY_NAME["Scotch yoke with an oblique slot"]
    moving = machine_of(example.name).moving(PHI, 7.0)
    honest = moving.state("yoke")
    moving._states["yoke"] = honest._replace(acceleration=(honest.acceleration[0], -honest.acceleration[1]))
    k = kinematics(moving)
    with pytest.raises(AssertionError):
        close(flat(moving.state("yoke").acceleration, PHI), k.material("yoke", np.zeros(2))[2], 1e-6, 49.0, "yoke")
    with pytest.raises(AssertionError):
        check(reactions(moving), expected(moving, k), 1e-6)


@pytest.mark.parametrize("against", ["frame", "crank"])
def test_acceleration_of_the_motion_that_a_force_opposes_is_the_derivative_of_its_velocity(against):
    """Relative to a turning body too, whose point that the force meets changes."""
    sizes = {"crank": "100 mm", "coupler": "410 mm", "rocker": "230 mm", "frame": "500 mm"}
    load = {"on": "rocker", "at": "C", "force": "20 N", "direction": "20 deg", "acts": "opposing", "against": against}
    mechanism = {"type": "four-bar", **sizes}
    machine = optlink.read({"mechanism": mechanism, "loads": {"drag": load}}).model.machine()
    angles, step = np.linspace(0.0, 6.0, 9), 1e-5

    def velocity(at):
        return machine.loads[0].reversing(machine.moving(at, 3.0))[0]

    expected = 3.0 * (velocity(angles + step) - velocity(angles - step)) / (2.0 * step)
    computed = machine.loads[0].reversing(machine.moving(angles, 3.0))[1]
    np.testing.assert_allclose(computed, expected, rtol=0.0, atol=1e-8)
