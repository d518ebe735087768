"""Joints with clearance: against an independent simulation, the ideal machine, symmetry, statics and the account of energy.

The oracle (tests/gap_oracle.py) knows neither cuts nor coordinates of joints: three coordinates per body, constraints with
multipliers, another integrator. Motion with clearance is sensitive: both agree to 1e-9 and better for some time, which is the
shorter the more joints are loose, and then part as two runs of either do. The cases below stop before.
"""

from __future__ import annotations

import contextlib
import copy
import json
import math
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest

import optlink
from optlink.clearance import (
    columns as record_module,
    control as plant_module,
    equations as equations_module,
    statistics as statistics_module,
)
from optlink.clearance.integration import Block, Impact, Integration, crossing, summit
from optlink.clearance.joint import SLOWEST, JournalMotion
from optlink.clearance.statistics import RETAINED_REVOLUTIONS
from optlink.dynamics.forward import Ending
from optlink.dynamics.inverse import acting_on
from optlink.dynamics.machine import Acting
from optlink.linkage.vector2d import cross, minus
from optlink.presentation.views import clearance as clearance_view
from optlink.tasks.clearance import simulate_clearance
from optlink.tasks.machine import machine_of
from optlink.tasks.results.clearance import ClearanceSimulation
from tests import gap_oracle as oracle
from tests.clearance.test_contact import DAMPING, closed_form
from tests.tiers import mostly_slow

RPM = math.pi / 30.0
STEEL = {"clearance": "0.5 mm", "bearing_radius": "10 mm", "modulus": "207 GPa", "poisson": 0.3}
RUBBING = {"friction": 0.1}
SAME = 3e-6
"""Difference from the oracle, as a share of the largest value of a column; found: a tenth of it and less."""

STIFF = oracle.STEEL

# --- machines ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A slider-crank (pins A, B, C) or a four-bar (A, B, C, D) with gaps: pin -> body with the journal."""

    name: str
    gaps: Mapping[str, str]
    bars: bool = False
    speed: float = 5000.0  # rpm
    start: float = 0.0  # deg
    gravity: tuple[float, float] = (0.0, -9.81)
    height: float = 0.0  # of the guide [m]
    centroids: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # in the axes of the body [m]
    torque: float | None = None
    initial: float = 0.0  # rpm
    joint: Mapping[str, object] = field(default_factory=lambda: RUBBING)
    assembly: str = "left"
    window: float = 0.25  # revolutions that are compared

    def __str__(self) -> str:
        return self.name

    @property
    def raw(self) -> dict:
        bodies: dict = {"crank": {"mass": "0.3 kg", "inertia": "1e-4 kg*m^2"}}
        if self.bars:
            lengths = {"crank": "50 mm", "coupler": "150 mm", "rocker": "100 mm", "frame": "140 mm"}
            mechanism: dict = {"type": "four-bar", **lengths, "assembly": self.assembly}
            bodies["coupler"] = {"mass": "0.25 kg", "inertia": "5e-4 kg*m^2"}
            bodies["rocker"] = {"mass": "0.2 kg", "inertia": "2e-4 kg*m^2"}
        else:
            mechanism = {
                "ground": {"A": ["0 m", "0 m"]},
                "links": {
                    "crank": {"joints": ["A", "B"], "length": "50 mm"},
                    "rod": {"joints": ["B", "C"], "length": "120 mm"},
                    "slider": {"joints": ["C"]},
                },
                "guides": {"G": {"slider": "slider", "through": ["0 m", f"{self.height} m"], "direction": "0 deg"}},
                "assembly": {"C": "forward"},
            }
            bodies["rod"] = {"mass": "0.21 kg", "inertia": "2.5e-4 kg*m^2"}
            bodies["slider"] = {"mass": "0.14 kg"}
        for body, (along, across) in self.centroids.items():
            bodies[body]["centroid"] = [f"{along} m", f"{across} m"]
        drive: dict = {"body": "crank", "start": f"{self.start} deg", "speed": f"{self.speed} rpm"}
        if self.torque is not None:
            drive |= {"torque": f"{self.torque} N*m", "initial_speed": f"{self.initial} rpm"}
        return {
            "title": self.name,
            "gravity": [f"{part} m/s^2" for part in self.gravity],
            "mechanism": mechanism,
            "bodies": bodies,
            "joints": {pin: {**STEEL, "journal": body, **self.joint} for pin, body in self.gaps.items()},
            "drive": drive,
        }

    @property
    def setup(self) -> oracle.Setup:
        said = dict(self.joint)
        said["viscous"] = float(str(said.pop("damping", "0 N*s/m")).split()[0])
        clearance = 1e-3 * float(str(said.pop("clearance", "0.5 mm")).split()[0])
        said |= {"clearance": clearance, "radius": 10e-3 - clearance}
        said["stiffness"] = oracle.stiffness(10e-3, 10e-3 - clearance, 207e9, 0.3)
        gaps = {pin: oracle.Gap(body, **said) for pin, body in self.gaps.items()}
        common = {
            "speed": (self.speed if self.torque is None else self.initial) * RPM,
            "start": math.radians(self.start),
            "torque": self.torque,
            "gravity": self.gravity,
        }
        if self.bars:
            result = oracle.four_bar(gaps, side=1.0 if self.assembly == "left" else -1.0, **common)
        else:
            result = oracle.slider_crank(gaps, height=self.height, **common)
        bodies = dict(result.bodies)
        for body, (along, across) in self.centroids.items():
            first, second = bodies[body].points
            length = bodies[body].points[second][0] - bodies[body].points[first][0]
            bodies[body] = replace(bodies[body], points={first: (-along, -across), second: (length - along, -across)})
        return replace(result, bodies=bodies)


def simulate(raw: Mapping, revolutions: int = 1, points: int = 360, tolerance: float = 1e-9, **more) -> ClearanceSimulation:
    return simulate_clearance(optlink.read(raw), revolutions, points, tolerance=tolerance, check_predictability=False, **more)


@contextlib.contextmanager
def ending_after(window: float) -> Iterator[None]:
    """Integrate no more than a share of each revolution: tests that compare a window of it do not need the rest."""
    advance = Integration.advance

    def shortened(self: Integration, rows: int) -> Iterator[Block]:
        return advance(self, min(rows, math.ceil((window + 0.02) * rows)))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Integration, "advance", shortened)
        yield


def edited(raw: Mapping, changes: Mapping[str, object]) -> dict:
    """A copy with other values: {"joints.C.clearance": "1 mm"}; None takes a key away."""
    computed = copy.deepcopy(dict(raw))
    for path, value in changes.items():
        *rooms, last = path.split(".")
        at = computed
        for room in rooms:
            at = at.setdefault(room, {})
        if value is None:
            at.pop(last, None)
        else:
            at[last] = value
    return computed


def wrapped(angle):
    return np.remainder(np.asarray(angle) + np.pi, 2.0 * np.pi) - np.pi


def largest(values) -> float:
    return float(np.max(np.abs(values)))


def ended(result: ClearanceSimulation) -> list[Impact]:
    """Contacts that are over: one that lasts has no end yet."""
    return [impact for impact in result.impacts if math.isfinite(impact.end)]


def imbalance(result: ClearanceSimulation) -> float:
    return result.figures["imbalance_J"] / result.figures["largest_energy_J"]


# --- against the oracle --------------------------------------------------------------------------------------------------


def differences(case: Case) -> dict[str, float]:
    """Of every column from the oracle's, as shares of its largest value within the window."""
    problem = optlink.read(case.raw)
    with ending_after(case.window):
        result = simulate_clearance(problem, 1, tolerance=1e-12, check_predictability=False)
    assert result.ending is Ending.FINISHED, result.message
    rows = round(360 * case.window)
    time, setup = result["time_s"][:rows], case.setup
    other = oracle.run(setup, float(time[-1]), np.concatenate([[0.0], time]))
    machine, off = machine_of(problem), {}

    def put(name, mine, theirs, size=None):
        off[name] = largest(np.asarray(mine)[:rows] - np.asarray(theirs)[1:]) / (size or largest(theirs) or 1.0)

    for body in setup.bodies:
        angle, omega = other.position[body][:, 2], other.velocity[body][:, 2]
        put(f"{body}.angle", wrapped(result[f"{body}.angle_rad"][:rows] - angle[1:]), 0.0 * angle, 1.0)
        put(f"{body}.omega", result[f"{body}.omega_rad_s"], omega)
    if setup.slider is not None:
        put("slider.s", result["slider.s_m"], other.position["slider"][:, 0])
        put("slider.v", result["slider.v_m_s"], other.velocity["slider"][:, 0])
    for pin, gap in setup.gaps.items():
        sign, strongest = 1.0 if acting_on(machine)[pin][1] == gap.journal else -1.0, largest(other.normal[pin])
        assert strongest > 0.0
        for i, axis in enumerate("xy"):
            put(f"{pin}.e{axis}", result[f"{pin}.e{axis}_m"], other.gap[pin][:, i], gap.clearance)
            put(f"{pin}.f{axis}", sign * result[f"{pin}.f{axis}_N"], other.force[pin][:, i], strongest)
        put(f"{pin}.normal", result[f"{pin}.normal_N"], other.normal[pin])
        put(f"{pin}.moment", gap.radius * result[f"{pin}.rub_N"], other.moment[pin], gap.radius * strongest)
    for pin, (_, second) in setup.pins.items():
        if pin not in setup.gaps:
            sign = 1.0 if acting_on(machine)[pin][1] == second else -1.0
            for i, axis in enumerate("xy"):
                put(f"{pin}.f{axis}", sign * result[f"{pin}.f{axis}_N"], other.reaction[pin][:, i], largest(other.reaction[pin]))
    put("torque", result["input.torque_Nm"], other.torque)
    put("work of the drive", result["work.drive_J"], other.work)
    put("impact", sum(result[f"work.{pin}.impact_J"] for pin in setup.gaps), other.impact_loss)
    put("friction", sum(result[f"work.{pin}.friction_J"] for pin in setup.gaps), other.friction_loss)
    put("kinetic", result["energy.kinetic_J"], other.kinetic)
    put("potential", result["energy.potential_J"], other.potential, largest(other.kinetic))
    put("elastic", result["energy.contact_J"], other.elastic)
    off["contacts"] = _contacts(result, other.contacts, float(time[-1]), list(setup.gaps))
    return off


def _contacts(result: ClearanceSimulation, contacts: Iterable[oracle.Contact], until: float, pins: list[str]) -> float:
    mine = [impact for impact in result.impacts if impact.end < until]
    theirs = sorted((contact for contact in contacts if contact.end < until), key=lambda contact: contact.end)
    assert [pins[impact.gap] for impact in mine] == [contact.joint for contact in theirs]
    off = 0.0
    for one, other in zip(mine, theirs, strict=True):
        off = max(off, abs(one.begin - other.begin) / until, abs(one.end - other.end) / until)
        off = max(off, abs(one.penetration / other.depth - 1.0) / 10.0)
        size = max(other.speed, 0.1)
        off = max(off, abs(one.approach - other.speed) / size, abs(one.departure - other.left) / size)
    return off


CASES = [
    Case("C without friction", {"C": "rod"}, joint={}),
    Case("C for a revolution", {"C": "rod"}, window=1.0),
    Case("C backwards", {"C": "rod"}, speed=-5000.0),
    Case("C journal on the slider", {"C": "slider"}, speed=-5000.0),
    Case("B", {"B": "rod"}),
    Case("B journal on the crank, viscous", {"B": "crank"}, joint={"friction": 0.05, "damping": "20 N*s/m"}),
    Case("B journal on the crank, backwards", {"B": "crank"}, speed=-1200.0, window=0.15),
    Case("A", {"A": "crank"}, window=0.2),
    Case("A journal on the frame, backwards", {"A": "frame"}, speed=-5000.0),
    Case("A and B", {"A": "crank", "B": "rod"}, window=0.2),
    Case("B and C", {"B": "rod", "C": "rod"}, window=0.15),
    Case("A and C", {"A": "crank", "C": "rod"}, window=0.2),
    Case("A, B and C", {"A": "crank", "B": "rod", "C": "rod"}, window=0.15),
    Case("Hertz", {"C": "rod"}, joint={**RUBBING, "law": "hertz"}, window=0.15),
    Case("Hunt and Crossley", {"C": "rod"}, joint={**RUBBING, "law": "hunt-crossley", "restitution": 0.8}),
    Case("Lankarani and Nikravesh", {"C": "rod"}, joint={**RUBBING, "law": "lankarani-nikravesh", "restitution": 0.5}),
    Case("Flores", {"C": "rod"}, joint={**RUBBING, "law": "flores", "restitution": 0.7}),
    Case("Flores, soft", {"C": "rod"}, joint={**RUBBING, "law": "flores", "restitution": 0.2}),
    Case("viscous", {"C": "rod"}, joint={"damping": "20 N*s/m"}, window=0.2),
    Case("gravity oblique", {"C": "rod"}, gravity=(300.0, 120.0), speed=1200.0, window=0.2),
    Case("gravity upwards at B", {"B": "rod"}, gravity=(-150.0, 200.0), speed=1200.0, window=0.15),
    Case("centroids off the axes", {"C": "rod"}, centroids={"crank": (0.01, 0.012), "rod": (0.07, -0.02)}),
    Case("guide beside the pivot, another start", {"C": "rod"}, height=0.012, start=70.0),
    Case("under a torque", {"C": "rod"}, torque=8.0, initial=2000.0, speed=3000.0, window=0.15),
    Case("under a torque, A", {"A": "crank"}, torque=8.0, initial=2000.0, speed=3000.0, window=0.15),
    Case("four-bar B", {"B": "coupler"}, bars=True, speed=1500.0, window=0.1),
    Case("four-bar B backwards", {"B": "coupler"}, bars=True, speed=-1500.0, window=0.15),
    Case("four-bar C", {"C": "coupler"}, bars=True, speed=1500.0, window=0.15),
    Case("four-bar C backwards", {"C": "coupler"}, bars=True, speed=-1500.0, window=0.15),
    Case("four-bar D journal on the frame", {"D": "frame"}, bars=True, speed=1500.0, window=0.2),
    Case("four-bar B and D", {"B": "coupler", "D": "rocker"}, bars=True, speed=1500.0, window=0.1),
    Case(
        "four-bar on the right, centroids off the axes",
        {"C": "rocker"},
        bars=True,
        speed=1500.0,
        assembly="right",
        start=40.0,
        centroids={"coupler": (0.06, 0.03), "rocker": (0.04, -0.02)},
        window=0.1,
    ),
    Case("four-bar under a torque", {"B": "crank"}, bars=True, torque=3.0, initial=600.0, speed=1500.0, start=40.0, window=0.2),
]


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=str)
def test_motion_and_forces_are_those_of_the_oracle(case):
    off = differences(case)
    assert not {name: share for name, share in off.items() if not share < SAME}


# --- the oracle sees defects ---------------------------------------------------------------------------------------------

SPOILT = Case("spoilt", {"B": "crank"}, joint={"friction": 0.1, "damping": "20 N*s/m"}, window=0.1)


def _no_moment(monkeypatch):
    """The force acts at the centre of the journal."""

    def acting(gap, motion, journal, contact):
        back = minus((0.0, 0.0), contact.force)
        return Acting(gap.journal, journal, contact.force, 0.0), Acting(gap.bearing, journal, back, 0.0)

    monkeypatch.setattr(equations_module, "acting", acting)
    monkeypatch.setattr(record_module, "acting", acting)


def _stale_approach(monkeypatch):
    """Every contact has the approach speed of a grazing one."""
    switch = Integration._switch

    def spoilt(self, computed):
        switch(self, computed)
        self.entered = np.full_like(self.entered, SLOWEST)

    monkeypatch.setattr(Integration, "_switch", spoilt)


def _radius_of_the_bearing(monkeypatch):
    """The bearing's surface is at its radius, however deep the journal is in it."""

    def slip(self, radius):
        return cross(self.normal, self.rate) + radius * self.journal - (radius + 0.5e-3) * self.bearing

    monkeypatch.setattr(JournalMotion, "slip", slip)


def _journal_does_not_turn(monkeypatch):
    def slip(self, radius):
        return cross(self.normal, self.rate) - (radius + self.distance) * self.bearing

    monkeypatch.setattr(JournalMotion, "slip", slip)


@pytest.mark.slow
@pytest.mark.parametrize("spoil", [_no_moment, _stale_approach, _radius_of_the_bearing, _journal_does_not_turn])
def test_oracle_detects_a_defect(monkeypatch, spoil):
    spoil(monkeypatch)
    try:
        off = differences(SPOILT)
    except AssertionError:  # other contacts
        return
    assert max(off.values()) > 100.0 * SAME


# --- the ideal machine ---------------------------------------------------------------------------------------------------


def assert_ideal(raw: Mapping, revolutions: int, near: float = 1e-3, points: int = 360) -> ClearanceSimulation:
    """The last revolution is that of the ideal machine: motion, reactions, torque."""
    result = simulate(raw, revolutions, points, 1e-10)
    assert result.ending is Ending.FINISHED, result.message
    ideal = edited(
        raw, {f"joints.{pin}": ({"on": joint["on"]} if "on" in joint else None) for pin, joint in raw["joints"].items()}
    )
    expected = optlink.analyze(optlink.read(ideal), points=points)
    scales = {unit: max(largest(expected[n]) for n in expected.columns if n.endswith(unit)) for unit in ("_N", "_Nm", "_rad_s2")}
    compared = 0
    for name in expected.columns:
        if name not in result.columns or name in ("time_s", "crank_angle_deg"):
            continue
        mine, ours = result[name][-points:], expected[name][1:]
        size = largest(ours)
        for unit, scale in scales.items():
            if name.endswith(unit) and size < 1e-6 * scale:  # none in the ideal machine: what would count beside the others
                size = scale
        off = wrapped(mine - ours) if name.endswith("angle_rad") else mine - ours
        assert largest(off) <= near * size, name
        compared += 1
    forces = [name for name in expected.columns if name.endswith(("fx_N", "fy_N", "normal_N", "moment_Nm", "torque_Nm"))]
    reported = {name for name in forces if name.partition(".")[0] not in ("frame", *raw.get("loads", {}))}
    assert compared > 15
    assert reported <= set(result.columns)
    return result


TIGHT = {"clearance": "1e-7 m", "friction": 1e-3, "restitution": 0.5}


@pytest.mark.slow
@pytest.mark.parametrize("gaps", ["A", "B", "C", "ABC"])
def test_gap_that_vanishes_leaves_the_ideal_slider_crank(gaps):
    """A load keeps the joints pressed together: a journal that flies is not where an ideal one is."""
    journals = {"A": "crank", "B": "rod", "C": "rod"}
    case = Case("limit", {pin: journals[pin] for pin in gaps}, speed=1200.0, start=20.0, joint=TIGHT)
    push = {"on": "slider", "force": "2000 N", "direction": "180 deg"}
    assert_ideal({**case.raw, "loads": {"push": push}}, 2)


@pytest.mark.slow
def test_gap_that_vanishes_leaves_the_ideal_four_bar():
    case = Case("limit", {"C": "rocker"}, bars=True, speed=300.0, joint=TIGHT)
    push = {"on": "rocker", "torque": "60 N*m"}
    assert_ideal({**case.raw, "loads": {"push": push}}, 2)


# --- cuts that leave closed loops ----------------------------------------------------------------------------------------


def shipped(name: str, pin: str, journal: str, **joint) -> dict:
    raw = dict(optlink.load(name).raw)
    known = raw.get("joints", {}).get(pin, {})
    fit = {**STEEL, "bearing_radius": "20 mm", "journal": journal, "restitution": 0.5}
    return edited(raw, {"joints": {pin: {**known, **fit, **joint}}, "expected": None})


def drift_of_six_bar(computed: ClearanceSimulation, cut: str) -> float:
    """By how much the links of the six-bar are not where its ideal pins and its guide want them [m]."""
    ends = {}
    for body, pin, length in (("link2", "B", 1.2), ("link3", "D", 0.8), ("link5", "C", 1.2)):
        angle = computed[f"{body}.angle_rad"]
        start = (1.5, 0.0) if pin == "D" else tuple(computed[f"{pin}.{axis}_m"] for axis in "xy")
        ends[body] = start[0] + length * np.cos(angle), start[1] + length * np.sin(angle)
    slider = 1.5 + computed["slider.s_m"], np.zeros_like(computed["slider.s_m"])
    points = {"C": [ends["link2"], ends["link3"]], "E": [ends["link5"], slider]}
    return max(largest(np.subtract(one, other)) for pin, (one, other) in points.items() if pin != cut)


@pytest.mark.slow
def test_six_bar_whose_first_loop_stays_closed():
    computed = assert_ideal(shipped("six-bar", "E", "link5", clearance="1e-7 m", friction=1e-3), 2)
    assert drift_of_six_bar(computed, "E") < 1e-12
    assert imbalance(computed) < 1e-7


@pytest.mark.slow
def test_shaper_with_a_block_without_mass():
    """The rocker's pivot is loose; crank, block, coupler and ram close two loops with guides."""
    raw = shipped("shaper", "C", "rocker", clearance="1e-7 m", friction=1e-3)
    raw = edited(raw, {"loads.cutting": {"on": "ram", "force": "5880 N", "direction": "180 deg"}, "drive.speed": "64 rpm"})
    assert imbalance(assert_ideal(raw, 2)) < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize(("pin", "journal"), [("E", "link5"), ("B", "link2"), ("D", "frame")])
def test_loops_stay_closed_in_a_machine_that_knocks(pin, journal):
    result = simulate(shipped("six-bar", pin, journal, friction=0.05), 2)
    assert result.ending is Ending.FINISHED, result.message
    assert len(result.impacts) > 2
    assert imbalance(result) < 1e-6
    if pin == "E":
        assert drift_of_six_bar(result, pin) < 1e-12


@pytest.mark.slow
def test_pin_of_three_bodies_with_one_clearance():
    """At C the journal is on link 2; links 3 and 5 share the bearing, pinned without play."""
    result = simulate(shipped("six-bar", "C", "link2", friction=0.05), 1)
    assert imbalance(result) < 1e-6
    assert len(result.impacts) > 2
    total = sum(result[f"C.{body}.fx_N"] for body in ("link2", "link3", "link5"))
    assert largest(total) < 1e-9 * largest(result["C.link2.fx_N"])
    touching = result["C.contact"] == 1.0
    assert np.any(touching)
    assert largest(result["C.link2.fx_N"][~touching]) == 0.0


# --- symmetry ------------------------------------------------------------------------------------------------------------


def mirrored(raw: Mapping) -> dict:
    """Across the x axis."""

    def minus_of(text: str) -> str:
        value, unit = text.split()
        return f"{-float(value)} {unit}"

    computed = copy.deepcopy(dict(raw))
    computed["gravity"][1] = minus_of(computed["gravity"][1])
    for body in computed["bodies"].values():
        if "centroid" in body:
            body["centroid"][1] = minus_of(body["centroid"][1])
    for key in ("start", "speed"):
        computed["drive"][key] = minus_of(computed["drive"][key])
    mechanism = computed["mechanism"]
    if "assembly" in mechanism and mechanism.get("type") == "four-bar":
        mechanism["assembly"] = {"left": "right", "right": "left"}[mechanism["assembly"]]
    else:
        mechanism["guides"]["G"]["through"][1] = minus_of(mechanism["guides"]["G"]["through"][1])
    return computed


ODD = ("angle_rad", "angle_deg", "omega_rad_s", "alpha_rad_s2", ".y_m", "ey_m", "fy_N", "rub_N", "slip_m_s", "G.normal_N")
ODD_TOO = ("moment_Nm", "torque_Nm", "rocker.ideal_rad", "rocker.error_rad")


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [
        Case(
            "slider-crank",
            {"C": "rod"},
            speed=1200.0,
            start=70.0,
            height=0.012,
            gravity=(-3.0, -20.0),
            centroids={"crank": (0.01, 0.012), "rod": (0.07, -0.02)},
        ),
        Case("four-bar", {"C": "coupler"}, bars=True, speed=1000.0, start=30.0, centroids={"rocker": (0.04, 0.02)}),
    ],
    ids=str,
)
def test_mirrored_machine_moves_mirrored(case):
    one, other = simulate(case.raw, tolerance=1e-11), simulate(mirrored(case.raw), tolerance=1e-11)
    assert len(one.impacts) == len(other.impacts) > 3
    for name in one.columns:
        sign = -1.0 if name.endswith(ODD + ODD_TOO) else 1.0
        size = 1e4 if name == "crank.alpha_rad_s2" else max(largest(one[name]), 1e-9)
        assert largest(sign * one[name] - other[name]) < 1e-5 * size, name


@pytest.mark.slow
def test_turned_machine_moves_turned():
    """Guide, start and gravity turned by 35 degrees."""
    turn, case = math.radians(35.0), Case("upright", {"B": "rod", "C": "rod"}, speed=2000.0)
    down = (9.81 * math.sin(turn), -9.81 * math.cos(turn))
    changes = {
        "mechanism.guides.G.direction": "35 deg",
        "drive.start": "35 deg",
        "gravity": [f"{part!r} m/s^2" for part in down],
    }
    one, other = simulate(case.raw, tolerance=1e-12), simulate(edited(case.raw, changes), tolerance=1e-12)
    rows = slice(0, 54)
    assert np.sum(one["B.contact"][rows]) > 5.0
    c, s = math.cos(turn), math.sin(turn)
    for pin in "BC":
        x, y = other[f"{pin}.ex_m"][rows], other[f"{pin}.ey_m"][rows]
        assert largest(c * x + s * y - one[f"{pin}.ex_m"][rows]) < 1e-9
        assert largest(c * y - s * x - one[f"{pin}.ey_m"][rows]) < 1e-9
    assert largest(one["slider.s_m"][rows] - other["slider.s_m"][rows]) < 1e-9


def double(raw: Mapping) -> dict:
    """A second rod with a second slider at the same crank pin, in the same place."""
    computed = copy.deepcopy(dict(raw))
    mechanism = computed["mechanism"]
    mechanism["links"] |= {"rod2": {"joints": ["B", "E"], "length": "120 mm"}, "slider2": {"joints": ["E"]}}
    mechanism["guides"]["H"] = {"slider": "slider2", "through": "A", "direction": "0 deg"}
    mechanism["assembly"]["E"] = "forward"
    computed["bodies"] |= {"rod2": computed["bodies"]["rod"], "slider2": computed["bodies"]["slider"]}
    computed["joints"]["E"] = {**computed["joints"]["C"], "journal": "rod2"}
    return computed


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-9, 1e-10, 1e-11])
def test_two_gaps_that_switch_at_the_same_instant(tolerance):
    """Twins on one crank: each does what it would do alone."""
    raw = Case("one", {"C": "rod"}).raw
    one, both = simulate(raw, tolerance=tolerance), simulate(double(raw), tolerance=tolerance)
    assert both.ending is Ending.FINISHED, both.message
    for pin in ("C", "E"):
        of_pin = [impact for impact in ended(both) if both.gaps[impact.gap].point == pin]
        assert len(of_pin) == len(ended(one)) > 10
        for a, b in zip(of_pin, ended(one), strict=True):
            assert tuple(a)[1:] == pytest.approx(tuple(b)[1:], rel=1e-2)
        assert largest(both[f"{pin}.ex_m"] - one["C.ex_m"]) < 1e-5
    assert imbalance(both) < 1e-6


# --- rest and bounces ----------------------------------------------------------------------------------------------------

LOADS = {"A": 0.65 * 9.81, "B": 0.35 * 9.81, "C": 0.14 * 9.81}  # weight of what hangs below the pin [N]


def hanging(gaps: str, nominal: float, restitution: float) -> dict:
    """Crank, rod and slider hang straight down, undriven: nothing moves but what falls in its bearing."""
    journals = {"A": "crank", "B": "rod", "C": "rod"}
    case = Case("hanging", {pin: journals[pin] for pin in gaps}, joint={**RUBBING, "restitution": restitution})
    drive = {"start": "-90 deg", "speed": f"{nominal} rpm", "torque": "0 N*m", "initial_speed": "0 rad/s"}
    guide = {"slider": "slider", "through": "A", "direction": "-90 deg"}
    return edited(case.raw, {"mechanism.guides.G": guide, "drive": drive})


@pytest.mark.slow
@pytest.mark.parametrize("gaps", ["A", "B", "C", "ABC"])
def test_resting_contact_stays_at_rest(gaps):
    """0.5 mm of fall, some bounces, and then the penetration of the weight, to seven digits, without an end."""
    computed = simulate(hanging(gaps, 600.0, 0.5), 2)
    late = computed["time_s"] > 0.15
    assert max(impact.end for impact in ended(computed)) < 0.1
    for pin in gaps:
        assert np.all(computed[f"{pin}.contact"][late] == 1.0)
        expected = (LOADS[pin] / STIFF) ** (2.0 / 3.0)
        assert computed[f"{pin}.penetration_m"][late] == pytest.approx(expected, rel=1e-6)
        assert computed[f"{pin}.normal_N"][late] == pytest.approx(LOADS[pin], rel=1e-6)
        assert largest(computed[f"{pin}.approach_m_s"][late]) < 1e-9
    for pin in "ABC":
        assert np.abs(computed[f"{pin}.fy_N"][late]) == pytest.approx(LOADS[pin], rel=1e-6)


@cache
def bouncing(nominal: float, points: int = 360) -> ClearanceSimulation:
    """Half a second of the slider's bounces on the rod's journal."""
    return simulate(hanging("C", nominal, 0.9), max(1, round(0.6 * nominal / 60.0)), points, 1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("nominal", [6.0, 60.0, 600.0, 6000.0])
def test_bounces_do_not_depend_on_the_rows(nominal):
    """The nominal speed sets no more than how far apart the rows are: 28 ms down to 28 us, contacts last 0.2 ms."""
    computed, fine = ended(bouncing(nominal)), ended(bouncing(600.0, 3600))
    assert len(computed) == len(fine)
    approach, departure = (np.array([getattr(impact, part) for impact in computed]) for part in ("approach", "departure"))
    assert np.all(departure < approach)
    assert approach[1:] == pytest.approx(departure[:-1], rel=1e-3)  # what rises comes down as fast
    assert approach[:20] == pytest.approx([impact.approach for impact in fine[:20]], rel=1e-4)


def test_bounces_have_the_restitution_of_the_closed_form():
    first = bouncing(600.0).impacts[0]
    assert first.approach == pytest.approx(math.sqrt(2.0 * 9.81 * 0.5e-3), rel=1e-6)
    expected = closed_form(DAMPING["lankarani-nikravesh"](0.9))
    assert first.departure / first.approach == pytest.approx(expected, rel=3e-3)  # its weight delays the journal a little


def test_slow_crank_carries_its_load_without_chatter():
    """60 rpm, the slider hangs on the rod: once its bounces are over, the contact follows the ideal load."""
    case = Case("hung", {"C": "rod"}, speed=60.0, start=-90.0, joint={**RUBBING, "restitution": 0.5})
    raw = edited(case.raw, {"mechanism.guides.G": {"slider": "slider", "through": "A", "direction": "-90 deg"}})
    computed = simulate(raw, 1)
    assert max(impact.end for impact in ended(computed)) < 0.1
    late = computed["time_s"] > 0.3
    assert np.all(computed["C.contact"][late] == 1.0)
    expected = optlink.analyze(optlink.read(edited(raw, {"joints": None})), points=360)
    load = np.hypot(expected["C.fx_N"], expected["C.fy_N"])[1:][late]
    assert largest(computed["C.normal_N"][late] / load - 1.0) < 0.02  # friction lets the journal creep along its bearing
    assert computed["C.penetration_m"][late] == pytest.approx((computed["C.normal_N"][late] / STIFF) ** (2.0 / 3.0), rel=1e-3)


# --- energy --------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("law", DAMPING)
def test_no_contact_creates_energy(law):
    joint = {"friction": 0.1, "damping": "5 N*s/m", "law": law, "restitution": 0.6}
    result = simulate(Case(law, {"B": "crank", "C": "rod"}, joint=joint, speed=2000.0).raw, 2)
    assert len(result.impacts) > 4
    assert imbalance(result) < 1e-6
    for pin in "BC":
        for kind in ("impact", "friction"):
            lost = result[f"work.{pin}.{kind}_J"]
            assert np.all(np.diff(lost, prepend=0.0) >= (-1e-15 if law == "hertz" else 0.0)), (pin, kind)
    hertz = max(largest(result[f"work.{pin}.impact_J"]) for pin in "BC")
    assert (hertz < 1e-12) is (law == "hertz")


@pytest.mark.slow
def test_machine_under_a_torque():
    """Nothing but the torque feeds it: constant, so its work is the angle's."""
    case = Case("torque", {"B": "crank", "C": "rod"}, torque=6.0, initial=1500.0, speed=3000.0, start=20.0)
    computed = simulate(case.raw, 3)
    assert imbalance(computed) < 1e-6
    turned = np.radians(computed["crank_angle_deg"]) - math.radians(20.0)
    assert computed["work.drive_J"] == pytest.approx(6.0 * turned, rel=1e-7)
    assert computed["crank.omega_rad_s"][-1] > computed["crank.omega_rad_s"][0]
    assert computed["time_s"][-1] == pytest.approx(0.06)
    gained = computed["energy.kinetic_J"] + computed["energy.potential_J"] + computed["energy.contact_J"]
    lost = sum(computed[f"work.{pin}.{kind}_J"] for pin in "BC" for kind in ("impact", "friction"))
    rest = gained + lost - computed["work.drive_J"]
    assert largest(rest - rest[0]) < 1e-6 * largest(gained)


@pytest.mark.slow
def test_servo_with_constant_reference_speed_turns_uniformly():
    raw = Case("servo", {"C": "rod"}).raw
    one, other = simulate(raw), simulate(edited(raw, {"drive.servo": {"bandwidth": "300 Hz", "damping": 0.7}}))
    assert largest(other["crank.omega_rad_s"] / one["crank.omega_rad_s"] - 1.0) < 1e-12
    assert largest(one["slider.s_m"] - other["slider.s_m"]) < 1e-6


# --- loads ---------------------------------------------------------------------------------------------------------------

LOADED = Case("loads", {"C": "rod"}, speed=1200.0, height=0.01)
FINE = 3600


def loaded(**loads) -> ClearanceSimulation:
    raw = edited(LOADED.raw, {"loads": loads, "mechanism.ground.S": ["30 mm", "90 mm"]})
    result = simulate(raw, 1, FINE, 1e-10)
    assert result.ending is Ending.FINISHED, result.message
    assert imbalance(result) < 1e-6
    return result


def path(power: np.ndarray, computed: ClearanceSimulation) -> np.ndarray:
    """Work since the first row, from the power at the rows."""
    time = computed["time_s"]
    return np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(time))])


def since(computed: ClearanceSimulation, load: str) -> np.ndarray:
    work = computed[f"work.{load}_J"]
    return work - work[0]


def test_work_of_a_constant_force():
    computed = loaded(push={"on": "rod", "at": "C", "force": "300 N", "direction": "200 deg"})
    way = math.radians(200.0)
    along = math.cos(way) * computed["C.rod.x_m"] + math.sin(way) * computed["C.rod.y_m"]
    assert since(computed, "push") == pytest.approx(300.0 * (along - along[0]), abs=1e-6)


def test_work_of_a_spring_and_a_damper():
    spring = {"between": ["B", "S"], "stiffness": "8000 N/m", "free_length": "80 mm"}
    computed = loaded(spring=spring, oil={"on": "slider", "damping": "25 N*s/m"})
    stretch = np.hypot(computed["B.x_m"] - 0.03, computed["B.y_m"] - 0.09) - 0.08
    stored = 4000.0 * stretch * stretch
    assert since(computed, "spring") == pytest.approx(stored[0] - stored, abs=1e-7)
    lost = path(25.0 * computed["slider.v_m_s"] ** 2, computed)
    assert since(computed, "oil") == pytest.approx(-lost, abs=1e-3 * lost[-1])
    assert np.all(np.diff(computed["work.oil_J"]) <= 0.0)


@pytest.mark.slow
def test_work_of_a_torsion_spring_and_of_a_torque():
    twist = {"on": "rod", "torsional_stiffness": "40 N*m/rad", "free_angle": "10 deg"}
    computed = loaded(twist=twist, drag={"on": "rod", "torque": "2 N*m", "acts": "opposing"})
    bend = wrapped(computed["rod.angle_rad"] - math.radians(10.0))
    stored = 20.0 * bend * bend
    assert since(computed, "twist") == pytest.approx(stored[0] - stored, abs=1e-7)
    assert np.all(np.diff(computed["work.drag_J"]) <= 0.0)
    lost = path(2.0 * np.abs(computed["rod.omega_rad_s"]), computed)
    assert since(computed, "drag") == pytest.approx(-lost, abs=1e-2 * lost[-1])


@pytest.mark.slow
def test_work_of_a_formula():
    computed = loaded(gas={"on": "slider", "force": {"expression": "200 + 150*sin(phi) - 5*v", "unit": "N"}})
    force = 200.0 + 150.0 * np.sin(np.radians(computed["crank_angle_deg"])) - 5.0 * computed["slider.v_m_s"]
    power = force * computed["slider.v_m_s"]
    assert since(computed, "gas") == pytest.approx(path(power, computed), abs=1e-4 * largest(path(np.abs(power), computed)))


AT, VALUES = (0.0, 90.0, 180.0, 270.0, 360.0), (0.0, 400.0, 900.0, 200.0, 0.0)


def test_work_of_a_table_over_the_crank_angle():
    table = {"over": "phi", "at": [f"{at} deg" for at in AT], "values": [f"{value} N" for value in VALUES]}
    computed = loaded(gas={"on": "slider", "force": table})
    power = np.interp(np.remainder(computed["crank_angle_deg"], 360.0), AT, VALUES) * computed["slider.v_m_s"]
    assert since(computed, "gas") == pytest.approx(path(power, computed), abs=1e-4 * largest(path(np.abs(power), computed)))


def test_work_of_a_table_over_the_slide():
    table = {"over": "s", "at": ["60 mm", "100 mm", "180 mm"], "values": ["0 N", "400 N", "900 N"]}
    computed = loaded(gas={"on": "slider", "force": table})
    power = np.interp(computed["slider.s_m"], (0.06, 0.1, 0.18), (0.0, 400.0, 900.0)) * computed["slider.v_m_s"]
    assert since(computed, "gas") == pytest.approx(path(power, computed), abs=1e-4 * largest(path(np.abs(power), computed)))


def test_motor_curve_drives_the_crank():
    motor = {"over": "omega", "at": ["0 rad/s", "200 rad/s"], "values": ["10 N*m", "0 N*m"]}
    raw = edited(LOADED.raw, {"drive.torque": motor, "drive.initial_speed": "100 rad/s"})
    result = simulate(raw, 2, tolerance=1e-10)
    assert result.ending is Ending.FINISHED, result.message
    assert result["input.torque_Nm"] == pytest.approx(np.maximum(10.0 - 0.05 * result["crank.omega_rad_s"], 0.0), abs=1e-9)
    assert imbalance(result) < 1e-6


# --- switches ------------------------------------------------------------------------------------------------------------


def ends(path: np.poly1d, span: float) -> tuple[list[float], list[float]]:
    """Value, slope and second derivative at both ends of a row; the path runs over a share of it."""
    slope, curve = path.deriv(), path.deriv(2)
    return tuple([float(path(u)), float(slope(u)) / span, float(curve(u)) / span**2] for u in (0.0, 1.0))


@pytest.mark.parametrize("span", [1e-5, 1.0])
def test_estimate_of_a_crossing(span):
    for at in (1e-3, 0.3, 0.97):
        path = np.poly1d([1.0, -at]) * np.poly1d([0.3, 0.2, 1.0]) * 1e-6
        assert crossing(*ends(path, span), span) == pytest.approx(at, rel=1e-9)
    thrice = np.poly1d([0.2, 0.5, 0.7], r=True)  # rises at 0.2, falls at 0.5, rises at 0.7
    assert crossing(*ends(thrice, span), span) == pytest.approx(0.2, rel=1e-9)
    gone = np.poly1d([0.5, 0.5], r=True) + 1.0  # above zero all the time: no estimate
    assert crossing(*ends(gone, span), span) == 0.5


@pytest.mark.parametrize("span", [1e-5, 1.0])
def test_estimate_of_a_summit(span):
    for at in (0.02, 0.4, 0.9):
        path = -(np.poly1d([1.0, -at]) ** 2) * np.poly1d([0.1, 1.0]) * 1e-6 + 1e-7
        tops = [u for u in path.deriv().roots.real if 0.0 < u < 1.0]
        assert summit(*ends(path, span), span) == pytest.approx(tops[0], rel=1e-6)
    straight = ([0.0, 1.0, 0.0], [0.0, -3.0, 0.0])
    assert 0.0 < summit(*straight, 1.0) < 1.0


@pytest.mark.slow
def test_requested_rows_do_not_change_the_motion():
    """However few are told, as many are looked at as it takes."""
    raw = Case("rows", {"C": "rod"}).raw
    few, usual = simulate(raw, points=12, tolerance=1e-11), simulate(raw, points=360, tolerance=1e-11)
    assert len(few.impacts) == len(usual.impacts) > 10
    for one, other in zip(ended(few), ended(usual), strict=True):
        assert tuple(one) == pytest.approx(tuple(other), rel=1e-4)
    for name in few.columns:
        assert largest(few[name] - usual[name][29::30]) <= 1e-5 * largest(usual[name]) + 1e-9, name


SPARSE = [
    Case("slider-crank", {"C": "rod"}, window=1.0),
    Case("slider-crank, slow", {"C": "rod"}, gravity=(60.0, 25.0), speed=300.0),
    Case("slider-crank, very slow", {"C": "rod"}, speed=60.0, window=0.1),
    Case("crank pin", {"B": "crank"}, speed=-1200.0),
    Case("four-bar", {"C": "coupler"}, bars=True, speed=1500.0),
    Case(
        "a short flight between two contacts",
        {"B": "rod", "C": "rod"},
        speed=269.0,
        start=289.0,
        gravity=(-1.0, 2.0),
        joint={**RUBBING, "law": "hertz", "clearance": "0.1 mm"},
        window=0.0744,
    ),
    Case(
        "deepest in the row in which another contact ends",
        {"A": "crank", "B": "rod"},
        speed=115.0,
        start=277.0,
        gravity=(-21.0, -17.0),
        joint={**RUBBING, "law": "hunt-crossley", "restitution": 0.3, "clearance": "0.1 mm"},
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize("case", SPARSE, ids=str)
def test_contacts_shorter_than_a_row_are_found(case):
    """Ten times as many rows show the same contacts."""
    until = case.window * 60.0 / abs(case.speed)
    with ending_after(case.window):
        few, many = (simulate(case.raw, points=points, tolerance=1e-11).impacts for points in (360, 3600))
    few, many = ([impact for impact in impacts if impact.end < until] for impacts in (few, many))
    assert len(few) == len(many) > 5
    for one, other in zip(few, many, strict=True):
        assert one.begin == pytest.approx(other.begin, abs=1e-5 * until)
        assert one.end == pytest.approx(other.end, abs=1e-5 * until)
        assert one.penetration == pytest.approx(other.penetration, rel=1e-2)
        assert one.departure == pytest.approx(other.departure, rel=1e-2)


# --- runs ----------------------------------------------------------------------------------------------------------------

PERIODIC = Case("runs", {"C": "rod"}).raw
CHAOTIC = Case("chaos", {"C": "rod"}, joint={}).raw


@pytest.mark.slow
def test_runs_are_reproducible_to_the_bit():
    one, other = (simulate(Case("three", {"A": "crank", "B": "rod", "C": "rod"}).raw) for _ in range(2))
    assert ended(one) == ended(other)
    assert len(one.impacts) == len(other.impacts)
    assert one.figures == other.figures
    for name in one.columns:
        assert np.array_equal(one[name], other[name]), name


@pytest.mark.slow
def test_longer_run_begins_as_the_shorter_one():
    short, long = (simulate(CHAOTIC, revolutions, 90) for revolutions in (3, 6))
    assert ended(long)[: len(ended(short))] == ended(short)
    for name in short.columns:
        assert np.array_equal(short[name], long[name][:270]), name
    for name, values in short.per_revolution.items():
        assert np.array_equal(values, long.per_revolution[name][:3]), name


@pytest.mark.slow
def test_the_predictability_check_does_not_disturb_the_run():
    one = simulate(PERIODIC, 1, 90)
    other = simulate_clearance(optlink.read(PERIODIC), 1, 90, tolerance=one.tolerance)
    assert other.prediction is not None
    assert one.prediction is None
    assert np.array_equal(one["slider.s_m"], other["slider.s_m"])


@pytest.mark.slow
def test_memory_is_bounded_and_all_rows_are_streamed():
    streamed: list[dict] = []
    shares: list[float] = []
    result = simulate(PERIODIC, 100, 12, stream=lambda rows: streamed.append(dict(rows)), progress=shares.append)
    assert len(streamed) == 100 > RETAINED_REVOLUTIONS
    assert shares == sorted(shares)
    assert 0.0 < shares[0] < 0.01  # within a revolution too
    assert {(k + 1) / 100 for k in range(100)} <= {round(share, 12) for share in shares}
    for name in ("time_s", "slider.error_m", "C.normal_N"):
        whole = np.concatenate([rows[name] for rows in streamed])
        assert len(whole) == 1200
        assert np.array_equal(result[name], whole[-12 * RETAINED_REVOLUTIONS :]), name
    assert set(streamed[0]) == set(result.columns)
    assert len(result.per_revolution["revolution"]) == len(result.poincare_map["revolution"]) == 100
    error = np.concatenate([rows["slider.error_m"] for rows in streamed])
    assert result.figures["rms_m"] == pytest.approx(math.sqrt(float(np.mean(error[60:] ** 2))), rel=1e-12)
    assert result.figures["rms_from_start_m"] == pytest.approx(math.sqrt(float(np.mean(error**2))), rel=1e-12)


@pytest.mark.slow
def test_every_contact_is_counted_however_few_stay_in_memory(monkeypatch):
    raw = edited(PERIODIC, {"joints.C.law": "hertz", "joints.C.friction": 0.0})
    known = simulate(raw, 1, 90)
    monkeypatch.setattr(statistics_module, "MAX_SUMMARIES", 5)
    result = simulate(raw, 1, 90)
    counted = len(known.impacts)
    assert len(result.impacts) < 10 < counted
    assert result.figures["contacts"] == result.figures["C.contacts"] == counted
    contacts = clearance_view.overview(result).parts[1]
    assert contacts.rows[0][4].text == str(counted)


@pytest.mark.slow
def test_figures_of_revolutions_are_those_of_their_rows():
    result = simulate(CHAOTIC, 3, 90)
    for k in range(3):
        rows = slice(90 * k, 90 * (k + 1))
        error = result["slider.error_m"][rows]
        assert result.per_revolution["rms_m"][k] == pytest.approx(math.sqrt(float(np.mean(error**2))), rel=1e-12)
        assert result.per_revolution["peak_m"][k] == largest(error)
        assert result.per_revolution["C.contact_share"][k] == pytest.approx(float(np.mean(result["C.contact"][rows])))
        assert result.per_revolution["C.normal_max_N"][k] >= np.max(result["C.normal_N"][rows])
        assert result.poincare_map["C.ex_m"][k] == result["C.ex_m"][rows][-1]
        during = [impact for impact in result.impacts if k * 0.012 < impact.end <= (k + 1) * 0.012]
        assert result.per_revolution["impacts"][k] == len(during)
    assert result.figures["largest_penetration_m"] >= np.max(result["C.penetration_m"])
    assert result.figures["largest_penetration_m"] == pytest.approx(max(i.penetration for i in result.impacts), rel=1e-9)


@pytest.mark.slow
def test_largest_force_is_found_with_few_rows():
    """At a restitution of 0.9 the force is largest where the contact is deepest, within 1 %."""
    few, many = (simulate(CHAOTIC, 1, points, 1e-11) for points in (12, 7200))
    strongest = np.max(many["C.normal_N"])
    assert few.figures["largest_normal_N"] == pytest.approx(strongest, rel=0.02)
    assert few.figures["largest_penetration_m"] == pytest.approx(np.max(many["C.penetration_m"]), rel=1e-3)
    assert np.max(few["C.normal_N"]) < 0.9 * strongest  # the rows themselves miss it


def brake(torque: float, rpm: float) -> dict:
    """A four-bar whose rocker is held back: its journal stays on the bearing, and what it vibrates by soon dies."""
    raw = Case("brake", {"C": "coupler"}, bars=True, speed=rpm, joint={"friction": 0.15}).raw
    raw["loads"] = {"brake": {"on": "rocker", "torque": f"{torque} N*m", "acts": "opposing"}}
    return raw


@pytest.mark.slow
def test_slow_machine_under_load_is_not_stepped_by_its_contact(monkeypatch):
    """An explicit method would need a step for every time constant of the contact, though nothing vibrates any more."""
    calls = []
    solve = Integration._solve
    monkeypatch.setattr(Integration, "_solve", lambda self, *told: calls.append(told[2]) or solve(self, *told))
    result = simulate(brake(80.0, 3.0), 1, 36, 1e-9)
    assert result.ending is Ending.FINISHED, result.message
    assert max(calls) > 1000  # rows at once
    assert imbalance(result) < 1e-5


@pytest.mark.slow
def test_slow_machine_agrees_with_an_explicit_method_at_a_tight_tolerance(monkeypatch):
    raw = brake(25.0, 60.0)
    result = simulate(raw, 1, 90, 1e-9)
    monkeypatch.setattr(plant_module, "SLOW", math.inf)
    true = simulate(raw, 1, 90, 1e-11)
    assert result.figures["rms_rad"] == pytest.approx(true.figures["rms_rad"], rel=1e-5)
    assert largest(result["rocker.error_rad"] - true["rocker.error_rad"]) < 1e-4 * true.figures["peak_rad"]
    assert len(result.impacts) == len(true.impacts)
    assert result.figures["C.normal_max_N"] == pytest.approx(true.figures["C.normal_max_N"], rel=1e-4)
    assert imbalance(result) < 1e-6


PEAKED = [
    Case("viscous four-bar", {"D": "rocker"}, bars=True, speed=1500.0, joint={"friction": 0.2, "damping": "8 N*s/m"}),
    Case(
        "Flores at the crank's pin", {"B": "crank"}, speed=2600.0, joint={"friction": 0.15, "law": "flores", "restitution": 0.6}
    ),
    Case("heavy torque", {"C": "slider"}, torque=5.0, initial=900.0, speed=1100.0, joint={"friction": 0.3}),
]


@pytest.mark.slow
@pytest.mark.parametrize("case", PEAKED, ids=str)
def test_peaks_do_not_depend_on_the_rows(case):
    """Of forces, penetrations and torque, and of every contact, that which is still on at the end too."""
    few, many = (simulate(case.raw, 1, points, 1e-12) for points in (24, 7200))
    assert math.isnan(few.impacts[-1].end)
    for name in ("largest_normal_N", "largest_penetration_m", "torque_max_Nm"):
        assert few.figures[name] == pytest.approx(many.figures[name], rel=3e-8), name
    assert len(few.impacts) == len(many.impacts)
    for one, other in zip(few.impacts, many.impacts, strict=True):
        assert one.penetration == pytest.approx(other.penetration, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("case", PEAKED[1:], ids=str)
def test_peaks_are_those_of_the_oracle(case):
    """Its motion at 10,000 instants stays below them and comes near to them."""
    part = 0.12 if case.torque is None else 0.08  # of the revolution
    whole = case.raw
    whole["drive"]["speed"] = f"{case.speed / part} rpm"  # the revolution that counts ends there
    if case.torque is None:
        whole["drive"] |= {"torque": "0 N*m", "initial_speed": f"{case.speed} rpm"}
    setup = replace(case.setup, torque=0.0 if case.torque is None else case.torque)
    result = simulate(whole, 1, 24, 1e-12)
    end = 60.0 * part / case.speed
    other = oracle.run(setup, end, np.linspace(0.0, end, 10_001))
    for name, force in other.normal.items():
        assert result.figures[f"{name}.normal_max_N"] == pytest.approx(float(np.max(force)), rel=1e-4)
    deepest = {name: max((one.depth for one in other.contacts if one.joint == name), default=0.0) for name in other.normal}
    for name, depth in deepest.items():
        assert result.figures[f"{name}.penetration_max_m"] == pytest.approx(depth, rel=1e-6, abs=1e-12)


@pytest.mark.slow
def test_largest_torque_is_that_of_the_oracle():
    """Of a crank that turns evenly: the drive feels every impact."""
    case = Case("torque", {"B": "rod", "C": "rod"}, speed=1600.0, start=35.0)
    result = simulate(case.raw, 1, 24, 1e-12)
    first = result.impacts[0]
    fine = simulate(case.raw, 1, 20_000, 1e-12)
    until = int(0.1 * 20_000)
    end = float(fine["time_s"][until - 1])
    other = oracle.run(case.setup, end, np.linspace(0.0, end, 10_001))
    assert first.begin < end
    assert float(np.max(np.abs(fine["input.torque_Nm"][:until]))) == pytest.approx(largest(other.torque), rel=2e-3)
    assert result.figures["torque_max_Nm"] >= largest(other.torque) * (1.0 - 1e-9)
    assert result.figures["torque_max_Nm"] == pytest.approx(largest(fine["input.torque_Nm"]), rel=2e-3)
    assert result.figures["torque_max_Nm"] >= largest(fine["input.torque_Nm"]) * (1.0 - 1e-9)


@pytest.mark.slow
def test_peaks_agree_in_all_outputs():
    """In figures, revolutions, contacts and rows."""
    result = simulate(Case("three", {"A": "crank", "B": "rod", "C": "rod"}, speed=900.0).raw, 2, 40, 1e-10)
    figures = result.to_dict()["figures"]
    for k, point in enumerate("ABC"):
        depth, force = figures[f"{point}.penetration_max_m"], figures[f"{point}.normal_max_N"]
        assert depth == np.max(result.per_revolution[f"{point}.penetration_max_m"])
        assert force == np.max(result.per_revolution[f"{point}.normal_max_N"])
        assert depth == max(one.penetration for one in result.impacts if one.gap == k)
        assert depth >= np.max(result[f"{point}.penetration_m"])
        assert force >= np.max(result[f"{point}.normal_N"])
    assert figures["torque_max_Nm"] == np.max(result.per_revolution["torque_max_Nm"]) >= largest(result["input.torque_Nm"])


@pytest.mark.slow
def test_interrupted_run_returns_what_was_computed():
    def stop(share: float) -> None:
        if share > 1 / 3:
            raise KeyboardInterrupt

    result = simulate(PERIODIC, 3, 90, progress=stop)
    assert (result.ending, result.valid, result.revolutions) == (Ending.INTERRUPTED, False, 1)
    assert result.message == "1 of 3 revolutions were simulated"
    whole = simulate(PERIODIC, 1, 90)
    assert np.array_equal(result["slider.s_m"][:90], whole["slider.s_m"])
    assert result.to_dict()["status"] == "interrupted"


@pytest.mark.slow
def test_run_that_ends_before_it_settles_has_the_statistics_of_all_its_revolutions():
    def stop(share: float) -> None:
        if share > 2 / 12:  # of 12 revolutions, of which the first five are not counted
            raise KeyboardInterrupt

    result, whole = simulate(PERIODIC, 12, 90, progress=stop), simulate(PERIODIC, 2, 90)
    assert (result.revolutions, result.figures["settled_revolutions"]) == (2, 0.0)
    for name in ("rms_m", "mean_square_m2", "peak_m", "torque_rms_Nm"):
        assert result.figures[name] == whole.figures[name] > 0.0, name
    deviation = clearance_view.overview(result).parts[0]
    assert deviation.title == "Deviation of slider from the machine without clearance, revolutions 1 ... 2"


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="a signal of POSIX")
@pytest.mark.parametrize("check_predictability", [False, True])
def test_interrupt_from_the_keyboard(check_predictability):
    """It meets the integrator at work, mostly."""
    code = f"""
import json, os, signal, sys, threading
import optlink
from optlink.tasks.clearance import simulate_clearance
raw = json.load(sys.stdin)
begun = []
def stream(rows):
    if not begun:
        begun.append(1)
        threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
found = simulate_clearance(optlink.read(raw), 200, 90, check_predictability={check_predictability}, stream=stream)
print(found.ending.value, found.revolutions)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], input=json.dumps(PERIODIC), capture_output=True, text=True, timeout=60, check=True
    )
    ending, revolutions = done.stdout.split()
    assert ending == "interrupted"
    assert 1 <= int(revolutions) < 200


def test_journal_that_falls_through_its_bearing_stalls_the_run():
    raw = edited(PERIODIC, {"joints.C.modulus": None, "joints.C.poisson": None, "joints.C.stiffness": "1 N/m^1.5"})
    result = simulate(raw, 3)
    assert (result.ending, result.valid, result.revolutions) == (Ending.STALLED, False, 0)
    for part in ("C", "deep in its bearing", " s, crank angle ", " deg, revolution 1"):
        assert part in result.message
    assert 0.0 < result.stopped < 0.012
    assert result.notes
    assert not any("other integrator" in note for note in result.notes)  # it would fall through as well
    assert json.loads(json.dumps(result.to_dict(), allow_nan=False))["status"] == "stalled"


def test_stall_keeps_the_revolutions_before_it():
    """The load grows until the bearing gives way."""
    changes = {
        "joints.C.modulus": None,
        "joints.C.poisson": None,
        "joints.C.stiffness": "1e8 N/m^1.5",
        "loads.pull": {"on": "slider", "force": {"expression": "exp(phi/3)", "unit": "N"}},
    }
    result = simulate(edited(PERIODIC, changes), 12, 90)
    assert result.ending is Ending.STALLED
    assert 2 < result.revolutions < 11
    assert f"revolution {result.revolutions + 1}" in result.message
    assert len(result["time_s"]) >= 90 * result.revolutions
    assert len(result.per_revolution["rms_m"]) == result.revolutions
    assert result["time_s"][-1] <= result.stopped < 0.012 * (result.revolutions + 1)
    assert f"{result.stopped:.9g} s" in result.message


# --- bad input -----------------------------------------------------------------------------------------------------------

C = "joints.C."
NEAR = {"clearance": "0.5 mm", "bearing_radius": "10 mm", "modulus": "207 GPa"}


def machine(changes: Mapping[str, object]) -> optlink.ProblemFile:
    return optlink.read(edited(optlink.load("slider-crank-clearance").raw, changes), file="machine.toml")


@pytest.mark.slow
def test_the_largest_energy_does_not_depend_on_the_height_of_the_machine():
    low, high = (simulate(machine({"mechanism.ground.A": ["0 m", y]}).raw, tolerance=1e-7).figures for y in ("0 m", "5 m"))
    assert high["largest_energy_J"] == pytest.approx(low["largest_energy_J"], rel=1e-3)


def refused(fault, key: str, message: str, remedy: str) -> None:
    assert fault.file == "machine.toml"
    assert fault.key == key
    assert message in fault.message
    assert remedy in fault.remedy
    assert str(fault).startswith(f"machine.toml: {key}")


NOT_SIMULATED = {
    "slider without mass": ({"bodies.slider": None}, {}, "bodies.slider", "no inertia", "mass"),
    "rod without mass": ({"bodies.rod": None, "joints.B": NEAR}, {}, "bodies.rod", "no inertia", "mass"),
    "friction in a guide": ({"mechanism.guides.G.friction": 0.1}, {}, "mechanism.guides.G.friction", "together", "or the clear"),
    "no clearance": ({"joints": None, "control": None}, {}, "joints", "no joint of the problem", "clearance"),
    "control without a servo": ({"drive.servo": None}, {"control": "pid"}, "drive.servo", "needs a servo drive", "servo ="),
    "control of nothing": ({"control": None}, {"control": "inverse"}, "control", "the controlled joint", "[control]"),
    "PID without gains": (
        {"control.proportional": None, "control.integral": None},
        {"control": "pid"},
        "control",
        "gains",
        "proportional",
    ),
}


@pytest.mark.parametrize("what", NOT_SIMULATED)
def test_machine_that_cannot_be_simulated_is_refused(what):
    changes, options, *words = NOT_SIMULATED[what]
    problem = machine(changes)
    with pytest.raises(optlink.InputError) as caught:
        simulate_clearance(problem, 1, check_predictability=False, **options)
    (fault,) = caught.value.faults
    refused(fault, *words)


@pytest.mark.slow
def test_remedy_for_a_body_without_mass_helps():
    """Who follows the advice word for word gets on."""
    with pytest.raises(optlink.InputError) as caught:
        simulate_clearance(machine({"bodies.slider": None}), 1, check_predictability=False)
    advice = caught.value.faults[0].remedy
    body = {key: advice.split(f'{key} = "')[1].split('"')[0] for key in ("mass", "inertia") if f'{key} = "' in advice}
    assert simulate_clearance(machine({"bodies.slider": body}), 1, 12, check_predictability=False).valid


@pytest.mark.parametrize(
    ("options", "key", "remedy"),
    [
        ({"control": "pdi"}, "control", 'Did you mean "pid"'),
        ({"revolutions": 0}, "revolutions", "from 1"),
        ({"revolutions": -3}, "revolutions", "from 1"),
        ({"points": 5}, "points", "from 12"),
        ({"points": 1_000_000}, "points", "100,000"),
        ({"speed": 0.0}, "speed", "between 1e-9"),
        ({"speed": math.nan}, "speed", "between 1e-9"),
        ({"tolerance": 0.0}, "tolerance", "1e-13"),
        ({"tolerance": math.nan}, "tolerance", "1e-13"),
        ({"start": math.nan}, "start", ""),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_unusable_option_is_refused(options, key, remedy):
    with pytest.raises(optlink.InputError) as caught:
        simulate_clearance(machine({}), **{"revolutions": 1, "check_predictability": False, **options})
    (fault,) = caught.value.faults
    assert fault.key == key
    assert remedy in fault.remedy


@pytest.mark.parametrize(
    ("changes", "options", "key", "words"),
    [
        ({"drive.servo.bandwidth": "1e9 Hz"}, {}, "drive.servo.bandwidth", '= "1e9 Hz": a vibration of the servo takes 1e-09 s'),
        ({"drive.speed": "0.01 rpm"}, {}, "drive.speed", '"0.01 rpm": a vibration of a journal on its bearing takes'),
        ({}, {"speed": 1e-6}, "speed", "a revolution of 6.28e+06 s"),
        (
            {"drive.speed": "1 rpm", "control.sample_time": "1e-6 s"},
            {"control": "pid"},
            "control.sample_time",
            'sample_time = "1e-6 s": a sample takes 1e-06 s, so that a revolution of 60 s contains 6e+07',
        ),
    ],
    ids=["servo", "speed", "argument", "samples"],
)  # fmt: skip
def test_a_revolution_that_would_take_hours_is_refused(changes, options, key, words):
    with pytest.raises(optlink.InputError, match="at most 200,000") as caught:
        simulate_clearance(machine(changes), 1, **options)
    assert [fault.key for fault in caught.value.faults] == [key]
    assert words in str(caught.value)


def test_friction_needs_a_slip_speed_that_can_be_resolved():
    with pytest.raises(optlink.InputError, match=r'slip_speed = "1e-300 m/s": .* of 1e-6 m/s at least'):
        machine({"joints.C.slip_speed": "1e-300 m/s"})
    assert simulate_clearance(
        machine({"joints.C.slip_speed": "1e-6 m/s"}), 1, 36, tolerance=1e-6, check_predictability=False
    ).valid


def test_progress_is_shown_within_a_revolution():
    shares: list[float] = []
    simulate(PERIODIC, 2, 90, progress=shares.append)
    assert shares == sorted(shares)
    assert sum(share < 0.5 for share in shares) > 3
    assert shares[-1] == 1.0


@pytest.mark.parametrize("present", mostly_slow((True, False), True))
def test_a_stall_of_cvodes_names_the_other_integrator(present, monkeypatch):
    monkeypatch.setattr("optlink.tasks.clearance.installed", lambda: present)
    result = simulate_clearance(
        machine({"joints.C.damping": "1e12 N*s/m"}), 1, 36, check_predictability=False, integrator="cvodes"
    )
    assert result.ending is Ending.STALLED
    (note,) = (note for note in result.notes if "--integrator compiled" in note)
    assert (".[fast]" in note) is not present
