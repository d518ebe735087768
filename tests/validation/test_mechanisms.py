"""Closed forms of every shipped mechanism over its whole cycle: motion, torque, strokes, time ratios, work.

Nothing of the package's kinematics or dynamics is used. Points are complex numbers, loops are solved by the law of cosines and by
arcs of sines as textbooks do, and carried on to velocities and accelerations by the chain rule. The driving torque is the power
of the d'Alembert forces, weights and loads over the crank speed. Dimensions, masses and loads are repeated here as plain numbers,
so a problem file that is changed by mistake fails too.

Motions are arrays (value, rate, second rate) x positions, real for angles and lengths, complex for points.
Sources: the slider-crank, Whitworth and Scotch yoke formulas are those of every textbook on kinematics of machines.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pytest

import optlink
from optlink.tasks.analyze import Analysis, analyze

POINTS = 480
PHI = np.arange(POINTS + 1) * (2.0 * np.pi / POINTS)
SAME = 2e-12  # of the largest value of the column: second derivatives lose two or three digits
RPM = math.pi / 30.0
G = 9.81
MM = 1e-3
CORNERS = 1e-10  # of a work over a table in s


# --- vector loops -----------------------------------------------------------------------------------------------------------


def crank_of(phi: np.ndarray, omega: float) -> np.ndarray:
    """The crank angle as a motion at constant speed."""
    return np.array([phi, np.full_like(phi, omega), np.zeros_like(phi)])


def arm(angle: np.ndarray, lever: complex) -> np.ndarray:
    """A lever (along + across i) that turns with a body."""
    value, rate, second = angle
    turned = lever * np.exp(1j * value)
    return np.array([turned, 1j * rate * turned, (1j * second - rate * rate) * turned])


def still(place: complex) -> np.ndarray:
    return np.array([[place], [0.0], [0.0]])


def polar(vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Length and angle of a moving vector r exp(i t): its logarithmic rate is r'/r + i t'."""
    value, rate, second = vector
    first, other = rate / value, second / value
    size = np.abs(value)
    length = np.array([size, size * first.real, size * (other.real + first.imag**2)])
    return length, np.array([np.unwrap(np.angle(value)), first.imag, other.imag - 2.0 * first.real * first.imag])


def chain(x: np.ndarray, f: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """f(x) with f, f', f'' given."""
    return np.array([f, first * x[1], first * x[2] + second * x[1] ** 2])


def arccosine(x: np.ndarray) -> np.ndarray:
    sine = np.sqrt(1.0 - x[0] ** 2)
    return chain(x, np.arccos(x[0]), -1.0 / sine, -x[0] / sine**3)


def arcsine(x: np.ndarray) -> np.ndarray:
    cosine = np.sqrt(1.0 - x[0] ** 2)
    return chain(x, np.arcsin(x[0]), 1.0 / cosine, x[0] / cosine**3)


def two_links(p: np.ndarray, q: np.ndarray, a: float, b: float, side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles of links a from p and b from q that meet left (+1) or right (-1) of p -> q, and where: the law of cosines."""
    d, theta = polar(q - p)
    more = (a * a - b * b) / a
    cosine = chain(d, 0.5 * (d[0] / a + more / d[0]), 0.5 * (1.0 / a - more / d[0] ** 2), more / d[0] ** 3)
    first = theta + side * arccosine(cosine)
    joint = p + arm(first, a)
    return first, polar(joint - q)[1], joint


def to_line(p: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Angle of a link from p to the x axis, forward, and where it meets it: y + length sin(angle) = 0."""
    angle = arcsine(-p.imag / length)
    return angle, p + arm(angle, length)


# --- machines ---------------------------------------------------------------------------------------------------------------


@dataclass
class Closed:
    """Motions by body, point and slider; masses (m, J, centroid, body); forces (at, force) and torques (body, torque)."""

    angles: dict[str, np.ndarray]
    points: dict[str, np.ndarray]
    slides: dict[str, np.ndarray] = field(default_factory=dict)
    masses: list[tuple[float, float, np.ndarray, str]] = field(default_factory=list)
    forces: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)
    torques: list[tuple[str, np.ndarray]] = field(default_factory=list)
    dissipated: np.ndarray | float = 0.0  # power in dampers between moving bodies
    normal: np.ndarray | float = math.nan  # force of the guide of a ram with friction
    gravity: float = G

    def bar(self, body: str, mass: float, start: np.ndarray, length: float) -> None:
        self.mass(body, mass, mass * length**2 / 12.0, start, 0.5 * length)

    def mass(self, body: str, mass: float, moment: float, start: np.ndarray, lever: complex) -> None:
        self.masses.append((mass, moment, start + arm(self.angles[body], lever), body))

    def lump(self, mass: float, place: np.ndarray) -> None:
        self.masses.append((mass, 0.0, place, ""))

    def inertial_power(self) -> np.ndarray:
        """What inertia and weight take up."""
        total = 0.0 * self.angles["crank"][0]
        for mass, moment, (_, velocity, acceleration), body in self.masses:
            total = total + mass * ((acceleration + 1j * self.gravity) * velocity.conj()).real
            if moment:
                total = total + moment * self.angles[body][1] * self.angles[body][2]
        return total

    def load_power(self) -> np.ndarray:
        """What loads feed in."""
        total = 0.0 * self.angles["crank"][0] - self.dissipated
        for (_, velocity, _), force in self.forces:
            total = total + (force * velocity.conj()).real
        for body, torque in self.torques:
            total = total + torque * self.angles[body][1]
        return total

    def torque(self) -> np.ndarray:
        """Driving torque: virtual power."""
        return (self.inertial_power() - self.load_power()) / self.angles["crank"][1]


def slider_crank(phi: np.ndarray) -> Closed:
    crank = crank_of(phi, 10.0)
    b = arm(crank, 0.1)
    rod, e = to_line(b, 0.3)
    result = Closed({"crank": crank, "rod": rod}, {"B": b, "E": e}, {"slider": e.real}, gravity=0.0)
    result.bar("crank", 0.2, still(0.0), 0.1)
    result.bar("rod", 0.2, b, 0.3)
    result.lump(0.4, e)
    return result


def four_bar_of(crank: np.ndarray, r: float, a: float, b: float, pivot: complex, side: int) -> tuple[np.ndarray, ...]:
    at_b = arm(crank, r)
    return at_b, *two_links(at_b, still(pivot), a, b, side)


def watt(phi: np.ndarray) -> Closed:
    crank = crank_of(phi, 60 * RPM)
    b, coupler, rocker, c = four_bar_of(crank, 50 * MM, 152 * MM, 99 * MM, (170 + 45j) * MM, -1)
    e, f = b + arm(coupler, (48 - 124j) * MM), still((170 + 45j) * MM) + arm(rocker, (168 + 85j) * MM)
    rod, leg, g = two_links(e, f, 147 * MM, 138 * MM, -1)
    p = f + arm(leg, (151 + 124j) * MM)
    result = Closed(
        {"crank": crank, "coupler": coupler, "rocker": rocker, "rod": rod, "leg": leg},
        {"B": b, "C": c, "E": e, "F": f, "G": g, "P": p},
    )
    result.bar("crank", 0.15, still(0.0), 50 * MM)
    result.mass("coupler", 0.4, 1.6e-3, b, (67 - 41j) * MM)
    result.mass("rocker", 0.45, 1.5e-3, still((170 + 45j) * MM), (89 + 28j) * MM)
    result.bar("rod", 0.2, e, 147 * MM)
    result.mass("leg", 0.5, 2.2e-3, f, (96 + 41j) * MM)
    degrees = np.degrees(phi) % 360.0
    result.forces.append((p, 1j * 60.0 * np.clip(np.minimum((degrees - 95) / 20, (285 - degrees) / 20), 0.0, 1.0)))
    result.torques.append(("rocker", -0.8 * np.sign(rocker[1])))
    return result


def stephenson(phi: np.ndarray) -> Closed:
    crank = crank_of(phi, 120 * RPM)
    pivot = still((84 + 265j) * MM)
    b, coupler, rocker, c = four_bar_of(crank, 40 * MM, 96 * MM, 130 * MM, 121 * MM, +1)
    e = b + arm(coupler, (156 + 7j) * MM)
    link, lever, g = two_links(e, pivot, 106.5 * MM, 100 * MM, +1)
    result = Closed(
        {"crank": crank, "coupler": coupler, "rocker": rocker, "link": link, "lever": lever}, {"B": b, "C": c, "E": e, "G": g}
    )
    result.bar("crank", 0.3, still(0.0), 40 * MM)
    result.mass("coupler", 0.6, 1.4e-3, b, (78 + 3j) * MM)
    result.bar("rocker", 0.4, still(121 * MM), 130 * MM)
    result.bar("link", 0.35, e, 106.5 * MM)
    result.mass("lever", 0.9, 4e-3, pivot, 0.0)
    turned = np.angle(np.exp(1j * (lever[0] - math.pi)))
    result.torques.append(("lever", -12.0 * turned - 0.2 * lever[1]))
    result.torques.append(("lever", 3.0 + 2.0 * np.cos(phi - math.pi / 4)))
    return result


def whitworth(phi: np.ndarray) -> Closed:
    crank = crank_of(phi, 50 * RPM)
    b = still(-50j * MM) + arm(crank, 100 * MM)
    slide, toward = polar(b)
    d = arm(toward, -90 * MM)
    slotted = toward + np.array([math.pi, 0.0, 0.0])[:, None]
    coupler, e = to_line(d, 320 * MM)
    result = Closed(
        {"crank": crank, "arm": slotted, "block": toward, "coupler": coupler},
        {"B": b, "D": d, "E": e},
        {"block": slide, "ram": e.real},
    )
    result.bar("crank", 3.0, still(-50j * MM), 100 * MM)
    result.lump(0.8, b)
    result.mass("arm", 6.0, 0.045, still(0.0), -20 * MM)
    result.bar("coupler", 2.5, d, 320 * MM)
    result.lump(25.0, e)
    result.forces.append((e, np.where(e[1].real < 0.0, 2000.0, 0.0)))  # it moves towards -x in its slow stroke
    return result


def toggle_press(phi: np.ndarray) -> Closed:
    crank = crank_of(phi, 60 * RPM)
    a = still((550 - 270j) * MM)
    b = a + arm(crank, 60 * MM)
    rod, upper, c = two_links(b, still(0.0), 473 * MM, 300 * MM, +1)
    s = 2.0 * -c.imag  # an isosceles triangle on the ram's line
    lower, e = polar(-1j * s - c)[1], -1j * s
    result = Closed({"crank": crank, "rod": rod, "upper": upper, "lower": lower}, {"B": b, "C": c, "E": e}, {"ram": s})
    result.bar("crank", 5.0, a, 60 * MM)
    result.bar("rod", 8.0, b, 473 * MM)
    result.bar("upper", 6.0, still(0.0), 300 * MM)
    result.bar("lower", 6.0, c, 300 * MM)
    result.lump(40.0, e)
    result.forces.append((e, np.where(s[1] > 0.0, 1j * pressing(s[0]), 0.0)))
    return result


def pressing(s: np.ndarray) -> np.ndarray:
    return np.interp(s, [0.579, 0.589, 0.595, 0.599], [0.0, 8e3, 25e3, 60e3])


def scotch_yoke(phi: np.ndarray) -> Closed:
    crank = crank_of(phi, 300 * RPM)
    b = arm(crank, 40 * MM)
    s, still_standing = b.real, np.zeros((3, len(phi)))
    result = Closed({"crank": crank, "yoke": still_standing}, {"B": b, "Y": s + 0j}, {"block": b.imag, "yoke": s})
    result.bar("crank", 0.6, still(0.0), 40 * MM)
    result.lump(0.5, b)
    result.lump(6.0, s + 0j)
    result.forces.append((s + 0j, -900.0 * s[1] * np.abs(s[1])))
    return result


def slotted_quick_return(phi: np.ndarray) -> Closed:
    crank = crank_of(phi, 40 * RPM)
    b = still(250j * MM) + arm(crank, 100 * MM)
    slide, rocker = polar(b)
    t, h = rocker[0], 480 * MM  # the ram is at x = h cot(t), the die at h / sin(t) from C
    cot, sine = 1.0 / np.tan(t), np.sin(t)
    x = chain(rocker, h * cot, -h / sine**2, 2.0 * h * cot / sine**2)
    die = chain(rocker, h / sine, -h * cot / sine, h / sine * (1.0 + 2.0 * cot**2))
    d = x + still(1j * h)
    result = Closed(
        {"crank": crank, "rocker": rocker, "block": rocker, "die": rocker},
        {"B": b, "D": d},
        {"block": slide, "die": die, "ram": x},
    )
    result.bar("crank", 2.0, still(250j * MM), 100 * MM)
    result.bar("rocker", 7.0, still(0.0), 560 * MM)
    result.lump(30.0, d)
    reach = (700 - 150) * MM - x[0]  # the spring ends 150 mm before the ram's pin
    pull = 800.0 * (reach - 330 * MM)
    cutting = np.where(x[1] < 0.0, 1500.0, 0.0)  # it moves towards -x in its slow stroke
    # The massless die pushes the ram with p, square to the slot: 30 a = pull + cutting - mu |N| sign(v) + p_x, 0 = N + p_y - m g
    along, weight = 30.0 * x[2] - pull - cutting, 30.0 * G
    way = np.sign(x[1])
    fitting = []
    for sign in (1.0, -1.0):  # p = size (sin t, -cos t): along = size sin t - 0.1 sign N way, N = weight + size cos t
        size = (along + 0.1 * sign * way * weight) / (sine - 0.1 * sign * way * np.cos(t))
        normal = weight + size * np.cos(t)
        fitting.append(np.where(sign * normal >= 0.0, normal, np.nan))
    assert np.all(np.isfinite(fitting[0]) ^ np.isfinite(fitting[1])), "one sign of the normal force fits, and one alone"
    result.normal = np.where(np.isfinite(fitting[0]), *fitting)
    result.forces.append((d, pull + cutting - 0.1 * np.abs(result.normal) * way))
    return result


def oscillating_cylinder(phi: np.ndarray) -> Closed:
    crank = crank_of(phi, 120 * RPM)
    pivot, offset = still(220 * MM), 15 * MM
    b = arm(crank, 60 * MM)
    d, toward = polar(b - pivot)
    reach = np.sqrt(d[0] ** 2 - offset**2)
    slide = chain(d, reach, d[0] / reach, -(offset**2) / reach**3)
    share = chain(d, offset / d[0], -offset / d[0] ** 2, 2.0 * offset / d[0] ** 3)
    cylinder = toward - arcsine(share)
    result = Closed({"crank": crank, "piston": cylinder, "cylinder": cylinder}, {"B": b}, {"piston": slide})
    result.bar("crank", 1.0, still(0.0), 60 * MM)
    result.mass("piston", 0.8, 1.2e-3, b, -70 * MM)
    result.mass("cylinder", 2.5, 6e-3, pivot, (60 + 15j) * MM)
    way = np.exp(1j * toward[0])
    result.forces.append((b, -1500.0 * (d[0] - 280 * MM) * way))  # the spring; its other end stands still
    result.dissipated = 900.0 * slide[1] ** 2
    return result


SHIPPED: dict[str, Callable[[np.ndarray], Closed]] = {
    "slider-crank": slider_crank,
    "watt-i": watt,
    "stephenson-iii": stephenson,
    "whitworth": whitworth,
    "toggle-press": toggle_press,
    "scotch-yoke": scotch_yoke,
    "slotted-quick-return": slotted_quick_return,
    "oscillating-cylinder": oscillating_cylinder,
}


@cache
def analysed(name: str) -> Analysis:
    return analyze(optlink.load(name), points=POINTS)


@cache
def closed(name: str) -> Closed:
    return SHIPPED[name](PHI)


def same(result: np.ndarray, expected: np.ndarray, tolerance: float = SAME) -> None:
    scale = max(float(np.max(np.abs(expected))), 1e-9)
    np.testing.assert_allclose(result, np.broadcast_to(expected, result.shape), rtol=0.0, atol=tolerance * scale)


# --- every mechanism ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SHIPPED)
def test_motion(name):
    analysis, exact = analysed(name), closed(name)
    for body, (angle, rate, second) in exact.angles.items():
        turned = np.angle(np.exp(1j * (analysis[f"{body}.angle_rad"] - angle)))
        np.testing.assert_allclose(turned, 0.0, rtol=0.0, atol=1e-13)
        scale = max(abs(analysis.speed), float(np.max(np.abs(rate))))
        np.testing.assert_allclose(analysis[f"{body}.omega_rad_s"], rate, rtol=0.0, atol=SAME * scale)
        np.testing.assert_allclose(analysis[f"{body}.alpha_rad_s2"], second, rtol=0.0, atol=10 * SAME * scale**2)
    for point, motion in exact.points.items():
        for (kind, unit), value in zip((("", "m"), ("v", "m_s"), ("a", "m_s2")), motion, strict=True):
            place = analysis[f"{point}.{kind}x_{unit}"] + 1j * analysis[f"{point}.{kind}y_{unit}"]
            same(place, value, SAME if kind != "a" else 10 * SAME)
    for slider, motion in exact.slides.items():
        for kind, value in zip(("s_m", "v_m_s", "a_m_s2"), motion, strict=True):
            same(analysis[f"{slider}.{kind}"], value, SAME if kind != "a_m_s2" else 10 * SAME)


@pytest.mark.parametrize("name", SHIPPED)
def test_torque_is_that_of_virtual_power(name):
    same(analysed(name)["input.torque_Nm"], closed(name).torque(), 1e-11)


@pytest.mark.parametrize("name", SHIPPED)
def test_the_crank_turns_fully_and_nothing_is_singular(name):
    analysis = analysed(name)
    assert analysis.full
    assert analysis.valid
    assert analysis.notes == ()


def test_every_dyad_is_shipped():
    kinds = {group.kind for name in SHIPPED for group in analysed(name).machine.mechanism.groups}
    assert kinds == {"RRR", "RRP", "RPR", "RPP", "PRP"}


def gauss(function: Callable[[np.ndarray], np.ndarray], ends: list[float]) -> float:
    """Integral over pieces that begin and end at `ends`, 40 nodes each."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    total = 0.0
    for low, high in itertools.pairwise(ends):
        half = 0.5 * (high - low)
        total += half * float(weights @ np.broadcast_to(function(low + half * (1.0 + nodes)), nodes.shape))
    return total


# --- one by one -------------------------------------------------------------------------------------------------------------


def test_slider_crank_as_textbooks_print_it():
    analysis, r, length, w = analysed("slider-crank"), 0.1, 0.3, 10.0
    sine, cosine = np.sin(PHI), np.cos(PHI)
    root = np.sqrt(length**2 - (r * sine) ** 2)
    same(analysis["slider.s_m"], r * cosine + root)
    same(analysis["slider.v_m_s"], -r * w * sine * (1.0 + r * cosine / root))
    same(
        analysis["slider.a_m_s2"],
        -r * w * w * (cosine + r * np.cos(2 * PHI) / root + (r * sine) ** 2 * r * cosine**2 / root**3),
        1e-11,
    )
    figures = analysis.figures
    assert figures["slider.stroke_m"] == pytest.approx(2 * r, rel=1e-13)
    assert figures["slider.time_ratio"] == pytest.approx(1.0, rel=1e-12)
    assert figures["slider.a_m_s2.min"] == pytest.approx(-r * w * w * (1 + r / length), rel=1e-13)
    assert figures["rod.swing_rad"] == pytest.approx(2 * math.asin(r / length), rel=1e-12)


def test_slider_crank_torque_is_the_slope_of_its_reduced_inertia():
    """At constant speed T = w^2/2 dJ/dphi, J twice the kinetic energy per squared crank speed; the slope by a complex step."""
    analysis, r, length, m = analysed("slider-crank"), 0.1, 0.3, (0.2, 0.2, 0.4)
    phi = PHI + 1e-30j
    sine, cosine = np.sin(phi), np.cos(phi)
    root = np.sqrt(length**2 - (r * sine) ** 2)
    turning = -r * cosine / root  # of the rod, per crank speed
    slider = -r * sine * (1.0 + r * cosine / root)
    middle = -r * sine + 0.5 * r * cosine * (-r * sine) / root, 0.5 * r * cosine
    reduced = m[0] * r**2 / 3 + m[1] * (middle[0] ** 2 + middle[1] ** 2 + length**2 / 12 * turning**2) + m[2] * slider**2
    same(analysis["energy.kinetic_J"], 50.0 * reduced.real)
    same(analysis["input.torque_Nm"], 50.0 * reduced.imag / 1e-30, 1e-11)
    assert analysis.work == pytest.approx(0.0, abs=1e-12)


def test_slider_crank_guide_force():
    """The rod alone, moments about B: J alpha + lever x m a of its middle = that of the slider's force; the guide takes its y."""
    analysis, exact = analysed("slider-crank"), closed("slider-crank")
    angle, _, second = exact.angles["rod"]
    middle = (exact.points["B"][2] + exact.points["E"][2]) / 2
    needed = 0.2 * 0.3**2 / 12 * second + 0.2 * 0.15 * (np.cos(angle) * middle.imag - np.sin(angle) * middle.real)
    pull = -0.4 * exact.slides["slider"][2]
    normal = (needed + 0.3 * np.sin(angle) * pull) / (0.3 * np.cos(angle))
    same(analysis["F.normal_N"], normal, 1e-11)


def four_bar_limits(r: float, a: float, b: float, f: float) -> tuple[float, float, float]:
    """Least and largest angle of coupler and rocker (crank in line with the frame), swing (crank in line with the coupler)."""

    def corner(p: float, q: float, opposite: float) -> float:
        return math.acos((p * p + q * q - opposite * opposite) / (2 * p * q))

    return corner(a, b, f - r), corner(a, b, f + r), corner(f, b, a + r) - corner(f, b, a - r)


@pytest.mark.parametrize(
    ("name", "lengths"), [("watt-i", (50, 152, 99, math.hypot(170, 45))), ("stephenson-iii", (40, 96, 130, 121))]
)
def test_four_bar_inside_the_six_bars(name, lengths):
    figures = analysed(name).figures
    least, largest, swing = four_bar_limits(*lengths)
    assert figures["C.transmission_rad.min"] == pytest.approx(least, rel=1e-12)
    assert figures["C.transmission_rad.max"] == pytest.approx(largest, rel=1e-12)
    assert figures["rocker.swing_rad"] == pytest.approx(swing, rel=1e-12)


def test_watt_leg_walks():
    analysis = analysed("watt-i")
    degrees = PHI * 180 / math.pi
    down = (degrees > 104.9) & (degrees < 285.1)
    stand, x = analysis["P.y_m"][down], analysis["P.x_m"][down]
    assert np.ptp(stand) < 0.012
    assert np.max(analysis["P.y_m"]) - np.min(stand) > 0.039
    assert np.all(np.diff(x) > 0.0)
    assert x[-1] - x[0] > 0.2


def test_watt_leg_work_is_what_hip_and_ground_take():
    """The hip's torque opposes the rocker through two swings; the ground's push is integrated between the rows of its table."""
    analysis = analysed("watt-i")
    swing = four_bar_limits(50, 152, 99, math.hypot(170, 45))[2]

    def ground(phi: np.ndarray) -> np.ndarray:
        leg = watt(phi)
        (_, velocity, _), force = leg.forces[0]
        return (force * velocity.conj()).real / leg.angles["crank"][1]

    pushed = gauss(ground, [math.radians(d) for d in (95, 115, 165, 215, 265, 285)])
    assert abs(pushed) > 0.1
    assert analysis.work == pytest.approx(2 * 0.8 * swing - pushed, rel=1e-10)


def test_stephenson_lever_dwells():
    """Still to 0.04 deg while the crank turns through 100 deg, of a swing of 25 deg."""
    analysis, exact = analysed("stephenson-iii"), closed("stephenson-iii").angles["lever"][0]
    degrees = PHI * 180 / math.pi
    dwell = (degrees > 169.9) & (degrees < 270.1)
    angle = np.unwrap(analysis["lever.angle_rad"])
    assert math.degrees(np.ptp(angle[dwell])) < 0.04
    assert math.degrees(analysis.figures["lever.swing_rad"]) == pytest.approx(25.2518, abs=1e-4)
    assert analysis.figures["lever.swing_rad"] == pytest.approx(np.ptp(exact), rel=1e-4)  # the grid misses the limits


def mean_work(exact: Closed) -> float:
    """Work per revolution of a smooth machine: the mean over equal steps is exact for what is periodic and smooth."""
    return float(np.mean(exact.torque()[:-1])) * 2.0 * math.pi


@pytest.mark.parametrize("name", ["slider-crank", "stephenson-iii", "oscillating-cylinder"])
def test_work_of_smooth_machines(name):
    scale = float(np.max(np.abs(closed(name).torque())))
    assert analysed(name).work == pytest.approx(mean_work(closed(name)), abs=1e-12 * scale)


def test_whitworth():
    analysis = analysed("whitworth")
    figures, r, e = analysis.figures, 0.1, 0.05
    a = math.asin(e / r)
    assert figures["ram.time_ratio"] == pytest.approx((math.pi + 2 * a) / (math.pi - 2 * a), rel=1e-12)
    assert figures["ram.time_ratio"] == pytest.approx(2.0, rel=1e-12)
    assert figures["ram.stroke_m"] == pytest.approx(0.18, rel=1e-12)
    assert figures["ram.s_m.min"] == pytest.approx(0.32 - 0.09, rel=1e-12)
    assert np.degrees(np.sort(analysis.strokes["ram"].dead_centres)) == pytest.approx([30.0, 150.0], abs=1e-10)
    assert figures["coupler.swing_rad"] == pytest.approx(2 * math.asin(90 / 320), rel=1e-12)
    rate = r * (r - e * np.sin(PHI)) / (r * r + e * e - 2 * r * e * np.sin(PHI))
    same(analysis["arm.omega_rad_s"], 50 * RPM * rate)
    assert analysis.work == pytest.approx(2000.0 * 0.18, rel=1e-10)
    assert np.all(analysis["cutting.fx_N"][(PHI > 0.6) & (PHI < 2.5)] == 0.0)  # 30 ... 150 deg: the quick stroke


def test_whitworth_block_force():
    """Moments about C of the arm alone, the ram's force by the sum of works: block force times slide is what the arm needs."""
    analysis, exact = analysed("whitworth"), closed("whitworth")
    crank = Closed({"crank": exact.angles["crank"]}, {})
    crank.bar("crank", 3.0, still(-50j * MM), 100 * MM)
    crank.lump(0.8, exact.points["B"])  # the block is carried by the crank pin
    through = (exact.torque() - crank.torque()) * exact.angles["crank"][1]  # power that goes through the slot
    slide, turning = exact.slides["block"][0], exact.angles["block"][1]
    same(np.abs(analysis["G.normal_N"]), np.abs(through / (slide * turning)), 1e-10)


def test_toggle_press():
    analysis = analysed("toggle-press")
    far, rod, crank, link = math.hypot(550, 270), 473.0, 60.0, 300.0

    def s(reach: float) -> float:
        """C is `reach` from A: angle of the upper link by the law of cosines, two links above one another by its cosine."""
        of_frame = math.atan2(-270, 550)
        angle = of_frame - math.acos((far**2 + link**2 - reach**2) / (2 * far * link))
        return -2 * link * math.sin(angle) * MM

    figures = analysis.figures
    assert figures["ram.s_m.max"] == pytest.approx(s(rod + crank), rel=1e-12)
    assert figures["ram.s_m.min"] == pytest.approx(s(rod - crank), rel=1e-12)
    assert figures["ram.stroke_m"] == pytest.approx(s(rod + crank) - s(rod - crank), rel=1e-11)
    end = figures["ram.s_m.max"]
    area = gauss(pressing, [0.579, 0.589, 0.595, end])
    assert analysis.work == pytest.approx(area, rel=CORNERS)
    straight = math.degrees(math.acos(end / 0.6))
    assert 3.3 < straight < 3.5


def test_toggle_press_flywheel():
    """With the flywheel the speed varies by 10 %: energy equation from closed forms, the mean speed kept."""
    from scipy.optimize import brentq

    flywheel = analysed("toggle-press").flywheel
    phi = np.linspace(0.0, 2.0 * np.pi, 20001)
    exact, w = toggle_press(phi), 60 * RPM
    torque = exact.torque()
    kinetic = sum(0.5 * m * np.abs(place[1]) ** 2 for m, _, place, _ in exact.masses)
    kinetic = kinetic + sum(0.5 * j * exact.angles[body][1] ** 2 for _, j, _, body in exact.masses if j)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (torque[1:] + torque[:-1]) * np.diff(phi))])
    gain = work[-1] / (2 * np.pi) * phi - (work - kinetic)
    total = 2 * kinetic / w**2 + flywheel.inertia

    def speed(energy: float) -> np.ndarray:
        return np.sqrt(2 * (energy + gain - gain.min()) / total)

    energy = brentq(lambda x: np.mean(speed(x)[:-1]) - w, 0.0, 100.0 * total.max() * w**2, xtol=1e-12)
    assert np.ptp(speed(energy)) / w == pytest.approx(0.1, rel=1e-5)
    assert flywheel.mean_torque == pytest.approx(work[-1] / (2 * np.pi), rel=1e-7)  # trapezoids


def test_scotch_yoke():
    analysis, r, w, m, c = analysed("scotch-yoke"), 0.04, 300 * RPM, 6.0, 900.0
    sine, cosine = np.sin(PHI), np.cos(PHI)
    same(analysis["yoke.s_m"], r * cosine)
    same(analysis["yoke.v_m_s"], -r * w * sine)
    same(analysis["yoke.a_m_s2"], -r * w * w * cosine)
    same(analysis["block.s_m"], r * sine)
    weight = (0.6 / 2 + 0.5) * G * r * cosine
    same(analysis["input.torque_Nm"], m * (r * w) ** 2 * sine * cosine + c * r**3 * w * w * np.abs(sine) ** 3 + weight)
    push = -m * r * w * w * cosine - c * (r * w) ** 2 * sine * np.abs(sine)  # of the block on the yoke
    same(analysis["slot.normal_N"], push)  # of the yoke on the block, to the left of a line that points up
    same(analysis["rail.normal_N"], np.full_like(PHI, m * G), 1e-11)
    same(analysis["rail.moment_Nm"], push * r * sine)
    assert analysis.figures["yoke.stroke_m"] == pytest.approx(2 * r, rel=1e-13)
    assert analysis.figures["yoke.time_ratio"] == pytest.approx(1.0, rel=1e-12)
    assert analysis.work == pytest.approx(8 / 3 * c * r**3 * w * w, rel=1e-11)


def test_slotted_quick_return():
    analysis, exact = analysed("slotted-quick-return"), closed("slotted-quick-return")
    figures, h = analysis.figures, 0.48
    a = math.asin(100 / 250)
    assert figures["ram.stroke_m"] == pytest.approx(2 * h * math.tan(a), rel=1e-12)
    assert figures["ram.time_ratio"] == pytest.approx((math.pi + 2 * a) / (math.pi - 2 * a), rel=1e-12)
    assert figures["rocker.swing_rad"] == pytest.approx(2 * a, rel=1e-12)
    assert figures["block.s_m.min"] == pytest.approx(0.15, rel=1e-12)
    assert figures["block.s_m.max"] == pytest.approx(0.35, rel=1e-12)
    assert figures["die.s_m.max"] == pytest.approx(h / math.cos(a), rel=1e-12)
    way = np.sign(exact.slides["ram"][1])
    same(analysis["F.normal_N"], exact.normal, 1e-11)
    same(analysis["F.friction_N"], -0.1 * np.abs(exact.normal) * way, 1e-11)
    same(analysis["spring.fx_N"], 800 * (0.7 - 0.15 - exact.slides["ram"][0] - 0.33), 1e-11)


def test_slotted_quick_return_work():
    """Cutting through one stroke, and the friction, integrated between the angles where its parts have corners."""
    analysis = analysed("slotted-quick-return")

    def rubbing(phi: np.ndarray) -> np.ndarray:
        exact = slotted_quick_return(phi)
        return 0.1 * np.abs(exact.normal * exact.slides["ram"][1]) / exact.angles["crank"][1]

    from scipy.optimize import brentq

    fine = np.linspace(0.0, 2.0 * np.pi, 2001) + 1e-4
    normal = slotted_quick_return(fine).normal
    turns = [  # where the normal force passes through zero, and where the ram reverses, jumping
        brentq(lambda x: float(slotted_quick_return(np.array([x])).normal[0]), a, b, xtol=1e-15)
        for a, b, u, v in zip(fine[:-1], fine[1:], normal[:-1], normal[1:], strict=True)
        if u * v < 0.0
    ]
    centre = math.asin(100 / 250)
    dead = [-centre, math.pi + centre]
    ends = sorted({*dead, 2 * math.pi - centre, *(t - 2 * math.pi * (t > 2 * math.pi - centre) for t in turns)})
    ends = sorted({*ends, *(0.5 * (a + b) for a, b in itertools.pairwise(ends))})
    work = 1500 * 2 * 0.48 * math.tan(centre) + gauss(rubbing, ends)
    assert analysis.work == pytest.approx(work, rel=1e-7)  # friction has corners where the normal force changes its sign


def test_oscillating_cylinder():
    """The cylinder reverses where its bore, 15 mm beside D, is square to the crank: sin of its angle = (60 +- 15)/220."""
    analysis = analysed("oscillating-cylinder")
    figures = analysis.figures
    swing = math.asin((60 + 15) / 220) + math.asin((60 - 15) / 220)
    assert figures["cylinder.swing_rad"] == pytest.approx(swing, rel=1e-12)
    ratio = (math.pi + swing) / (math.pi - swing)
    assert figures["cylinder.time_ratio"] == pytest.approx(ratio, rel=1e-12)
    assert figures["piston.swing_time_ratio"] == pytest.approx(ratio, rel=1e-12)
    low, high = (math.sqrt((220 + k * 60) ** 2 - 15**2) * MM for k in (-1, 1))
    assert figures["piston.s_m.min"] == pytest.approx(low, rel=1e-13)
    assert figures["piston.s_m.max"] == pytest.approx(high, rel=1e-13)
    assert figures["piston.stroke_m"] == pytest.approx(high - low, rel=1e-12)
    assert figures["piston.time_ratio"] == pytest.approx(1.0, rel=1e-12)
    exact = closed("oscillating-cylinder")
    pull = -900 * exact.slides["piston"][1] * np.exp(1j * exact.angles["cylinder"][0])
    same(analysis["oil.fx_N"] + 1j * analysis["oil.fy_N"], pull, 1e-11)
    same(analysis["oil.cylinder.fx_N"] + 1j * analysis["oil.cylinder.fy_N"], -pull, 1e-11)
