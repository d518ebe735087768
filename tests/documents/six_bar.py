"""The document of this page: its faults, and values that no command prints, computed.

`Diagram` is the block diagram of the document with its own equations: crank, RRR and RRP group, their dynamics, nine integrators.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import optlink
from tests.documents.faults import Fault

Array = NDArray[np.float64]

PRINTED = (math.radians(62.0), 10.0, 0.3612, 1.8101, -2.2345, 3.3250, math.radians(-41.0), 0.6962, -3.1323)
"""The nine start values of the document: theta1, omega1, theta2, theta3, omega2, omega3, theta5, omega5, ds."""
START = 0.7247  # m, of the slide, which the document does not state


def along(angle: float) -> Array:
    return np.array([math.cos(angle), math.sin(angle)])


def across(angle: float) -> Array:
    return np.array([-math.sin(angle), math.cos(angle)])


def moment(lever: Array, force: Array) -> float:
    return float(lever[0] * force[1] - lever[1] * force[0])


@dataclass(frozen=True)
class Blocks:
    """Accelerations and forces of the blocks: `accelerations` of links 2, 3, 5 and the slider."""

    accelerations: tuple[float, float, float, float]
    a: Array
    torque: float
    guide: float


def blocks(x: Array, load_across: float, with_moment: bool) -> Blocks:
    """The blocks of the document for its nine variables; `load_across` [N] acts on the slider across its guide."""
    theta1, omega1, theta2, theta3, omega2, omega3, theta5, omega5, _ = (float(one) for one in x)
    weight = np.array([0.0, 9.8])
    b = -0.4 * omega1**2 * along(theta1)
    columns = np.column_stack([1.2 * across(theta2), -0.8 * across(theta3)])
    alpha2, alpha3 = np.linalg.solve(columns, 1.2 * omega2**2 * along(theta2) - 0.8 * omega3**2 * along(theta3) - b)
    c = b + 1.2 * (alpha2 * across(theta2) - omega2**2 * along(theta2))
    columns = np.column_stack([1.2 * across(theta5), (-1.0, 0.0)])
    alpha5, slide = np.linalg.solve(columns, 1.2 * omega5**2 * along(theta5) - c)
    # RRP group: forces at C and E on link 5, and of the guide
    force = 3.6 * (c + 0.6 * (alpha5 * across(theta5) - omega5**2 * along(theta5)) + weight)
    arm = 0.6 * along(theta5)
    rows = np.zeros((5, 5))
    rows[[0, 1, 0, 1], [0, 1, 2, 3]] = 1.0
    rows[2, :4] = arm[1], -arm[0], -arm[1], arm[0]
    rows[3, 2] = rows[4, 3] = -1.0
    rows[4, 4] = 1.0
    *pins, guide = np.linalg.solve(rows, [*force, 0.45 * alpha5, 6.0 * slide - 1000.0, 6.0 * 9.8 - load_across])
    # RRR group: forces at B and C on link 2, at D on link 3, which link 5 loads at C
    of_link5 = -np.array(pins[:2])
    arm2, arm3 = 0.6 * along(theta2), 0.4 * along(theta3)
    rows = np.zeros((6, 6))
    rows[[0, 1, 0, 1], [0, 1, 2, 3]] = 1.0
    rows[2, :4] = arm2[1], -arm2[0], -arm2[1], arm2[0]
    rows[[3, 4, 3, 4], [2, 3, 4, 5]] = -1.0, -1.0, 1.0, 1.0
    rows[5, 2:] = arm3[1], -arm3[0], arm3[1], -arm3[0]
    force2 = 3.0 * (b + 0.6 * (alpha2 * across(theta2) - omega2**2 * along(theta2)) + weight)
    force3 = 2.2 * (0.4 * (alpha3 * across(theta3) - omega3**2 * along(theta3)) + weight) - of_link5
    of_c = moment(arm3, of_link5) if with_moment else 0.0
    at_b = np.linalg.solve(rows, [*force2, 0.25 * alpha2, *force3, 0.09 * alpha3 - of_c])[:2]
    arm1 = 0.2 * along(theta1)
    at_a = 1.2 * (-0.2 * omega1**2 * along(theta1) + weight) + at_b
    torque = moment(arm1, at_a) + moment(arm1, at_b)
    return Blocks((alpha2, alpha3, alpha5, slide), at_a, torque, guide)


@dataclass(frozen=True)
class Diagram:
    """One second of the block diagram: the slide [m], E below its guide [m], torque, guide force and work at 4001 times."""

    slide: Array
    below: Array
    torque: Array
    guide: Array
    work: Array


@functools.cache
def diagram(start: tuple[float, ...] = PRINTED, load_across: float = 1000.0, with_moment: bool = True) -> Diagram:
    """Run the block diagram for one second; the document has the load of 1000 N across the guide too."""

    def slopes(_: float, x: Array) -> list[float]:
        made = blocks(x[:9], load_across, with_moment)
        alpha2, alpha3, alpha5, slide = made.accelerations
        return [x[1], 0.0, x[4], x[5], alpha2, alpha3, x[7], alpha5, slide, x[8], made.torque * x[1]]

    times = np.linspace(0.0, 1.0, 4001)
    x = solve_ivp(slopes, (0.0, 1.0), [*start, START, 0.0], "DOP853", times, rtol=1e-10, atol=1e-12).y
    made = [blocks(row, load_across, with_moment) for row in x[:9].T]
    below = -0.8 * np.sin(x[3]) - 1.2 * np.sin(x[6])
    return Diagram(x[9], below, np.array([one.torque for one in made]), np.array([one.guide for one in made]), x[10])


@functools.cache
def cycle() -> optlink.Analysis:
    return optlink.analyze(optlink.load("six-bar"))


@functools.cache
def with_centroid() -> optlink.Analysis:
    """With the centroid of link 2 as a point."""
    return optlink.analyze(optlink.load("six-bar", {"mechanism.links.link2.points": {"S2": ["0.6 m", "0 m"]}}))


@functools.cache
def second() -> optlink.Simulation:
    return optlink.simulate(optlink.load("six-bar"))


@functools.cache
def consistent() -> tuple[float, ...]:
    """The nine start values that close the loops."""
    columns = ("link2.angle_rad", "link3.angle_rad", "link2.omega_rad_s", "link3.omega_rad_s", "link5.angle_rad")
    rates = ("link5.omega_rad_s", "slider.v_m_s")
    return *PRINTED[:2], *(first(name) for name in (*columns, *rates))


def first(column: str) -> float:
    """A column at the start, 62 deg."""
    return float(cycle()[column][0])


def newton() -> tuple[float, float]:
    """theta2, theta3 [rad] from the loop A, B, C, D by Newton's method from a sketch."""
    angles, b = np.radians([20.0, 100.0]), 0.4 * along(PRINTED[0])
    for _ in range(8):
        theta2, theta3 = angles
        gap = b + 1.2 * along(theta2) - 0.8 * along(theta3) - (1.5, 0.0)
        angles = angles - np.linalg.solve(np.column_stack([1.2 * across(theta2), -0.8 * across(theta3)]), gap)
    return float(angles[0]), float(angles[1])


def closing() -> float:
    """theta5 [rad] that puts E on its guide, from the document's theta3."""
    return math.asin(-0.8 * math.sin(PRINTED[3]) / 1.2)


def omega5(theta5: float) -> float:
    """omega5 [rad/s] of a link 5 whose end E moves along the guide, from the document's theta3 and omega3."""
    return -0.8 * PRINTED[5] * math.cos(PRINTED[3]) / (1.2 * math.cos(theta5))


def slider_speed(theta5: float, sign: float = 1.0) -> float:
    """The velocity [m/s] of C along the guide plus `sign` times that of E about C."""
    return -0.8 * PRINTED[5] * math.sin(PRINTED[3]) - sign * 1.2 * omega5(theta5) * math.sin(theta5)


def from_b_to_centroid_of_link5() -> float:
    angle = first("link5.angle_rad")
    x, y = (first(f"C.{one}_m") + 0.6 * turned(angle) - first(f"B.{one}_m") for one, turned in (("x", math.cos), ("y", math.sin)))
    return math.hypot(x, y)


NAMES = "theta-一、omega-一、theta-二、omega-二、omega-3、theta-5,omega-5 ds"
FIGURE_4 = "图 1-4 CD构件受力模型"
FORTY_ONE = PRINTED[6]

FAULTS: list[Fault] = [
    Fault(
        "section 4, vector x",
        "-41*pi/180",
        {
            "-40.366": lambda: math.degrees(first("link5.angle_rad")),
            "10.07": lambda: -1e3 * (0.8 * math.sin(PRINTED[3]) + 1.2 * math.sin(FORTY_ONE)),
        },
        lambda: abs(closing() - first("link5.angle_rad")) < 1e-4,
    ),
    Fault(
        "section 4, compvel",
        "W5=0.6962",
        {"0.6896": lambda: first("link5.omega_rad_s"), "0.6962": lambda: omega5(FORTY_ONE)},
    ),
    Fault(
        "section 4, compvel",
        "ds=-3.1323",
        {"-2.0483": lambda: first("slider.v_m_s"), "-3.1323": lambda: slider_speed(FORTY_ONE, -1.0)},
        lambda: abs(slider_speed(closing()) - first("slider.v_m_s")) < 5e-4,
    ),
    Fault(
        "section 2, chengrrpdy.m",
        "b(5,1)=m6*x(4)*sin(th6)-Fx6+m6*g",
        {"-1000": lambda: blocks(np.array(consistent()), 1000.0, True).guide - first("F.normal_N")},
        lambda: abs(blocks(np.array(consistent()), 0.0, True).guide - first("F.normal_N")) < 1e-8,
    ),
    Fault(
        "section 4",
        "2=0.3612rad/s,3=1.8101rad/s",
        {"0.3612": lambda: newton()[0], "1.8101": lambda: newton()[1]},
    ),
    Fault(
        "section 4",
        "辛普森方式",
        holds=lambda: np.allclose(newton(), PRINTED[2:4], atol=5e-5),
    ),
    Fault(
        "section 4",
        NAMES,
        {"9": lambda: len(PRINTED), "8": lambda: NAMES.count("theta") + NAMES.count("omega") + NAMES.count("ds")},
    ),
    Fault(
        "section 2, chengrrpdy.m",
        "rc5=0.6; %质心到铰链B的距离",
        {"1.580": from_b_to_centroid_of_link5, "0.600": lambda: 0.5 * cycle().machine.sizes["link5.length"]},
    ),
    Fault("section 1", "如图1-4,对构件BC", holds=lambda: "CD" in FIGURE_4 and "BC" not in FIGURE_4),
]


def columns(*named: str) -> dict[str, Callable[[], float]]:
    """Numbers as printed, each with the column whose value it is at the start: `-18.7789 B.ax_m_s2`."""
    pairs = [one.split() for one in named]
    return {number: functools.partial(first, column) for number, column in pairs}


def read(*named: str) -> dict[str, Callable[[], float]]:
    """Numbers as printed, each with its size or the attribute of its body: `0.6 link2.along`."""

    def value(name: str) -> float:
        owner, _, quantity = name.partition(".")
        sizes = cycle().machine.sizes
        return float(sizes[name] if name in sizes else getattr(cycle().machine.inertias[owner], quantity))

    return {number: functools.partial(value, name) for number, name in (one.split() for one in named)}


def of_link5() -> Array:
    """Force that link 5 exerts on link 3 at C."""
    return -np.array([first("C.link5.fx_N"), first("C.link5.fy_N")])


def drive(key: str) -> float:
    return float(getattr(optlink.load("six-bar").model.drive, key).value)


COMPUTED: dict[str, dict[str, Callable[[], float]]] = {
    "r1 = 400 mm, rc1 = 200 mm, m1 = 1.2 kg, J1 = 0.016 kg·m²; 曲柄1, 原动件": read(
        "0.4 crank.length", "0.2 crank.along", "1.2 crank.mass", "0.016 crank.moment"
    ),
    "r2 = 1200 mm, rc2 = 600 mm, m2 = 3 kg, J2 = 0.25 kg·m²; 构件BC": read(
        "1.2 link2.length", "0.6 link2.along", "3 link2.mass", "0.25 link2.moment"
    ),
    "r3 = 800 mm, rc3 = 400 mm, m3 = 2.2 kg, J3 = 0.09 kg·m²; CD构件": read(
        "0.8 link3.length", "0.4 link3.along", "2.2 link3.mass", "0.09 link3.moment"
    ),
    "r4 = 1500 mm; AD": read("1.5 D.x"),
    "r5 = 1200 mm, rc5 = 600 mm, m5 = 3.6 kg, J5 = 0.45 kg·m²; CE杆件": read(
        "1.2 link5.length", "0.6 link5.along", "3.6 link5.mass", "0.45 link5.moment"
    ),
    "m6 = 6 kg, θ6 (th6) = 0; 构件6, 滑块": read("6 slider.mass", "0 F.direction"),
    "F6 = Fx6 = 1000 N, Fy6 = 0; 工作阻力": columns("1000 process.fx_N", "0 process.fy_N"),
    "g = 9.8; 重力加速度": {"9.8": lambda: -float(cycle().machine.gravity[1])},
    "θ1 (theta-1) = 62, ω1 (omega-1, dtheta-1) = 10 rad/s, ddθ1 = 0, 1 s; 初始夹角, 等角速度, 逆时针, 仿真时刻": {
        "62": lambda: math.degrees(drive("start")),
        "10": lambda: drive("speed"),
        "1": lambda: drive("duration"),
    },
    "chengcrank.m: ddB; 曲柄": columns("-18.7789 B.ax_m_s2", "-35.3179 B.ay_m_s2"),
    "rrrposi: θ2 = 0.3612, θ3 = 1.8101; 角位移": columns("0.361152 link2.angle_rad", "1.810103 link3.angle_rad"),
    "rrrvel: W2 = -2.2345, W3 = 3.3250 (ω2, ω3); 角速度": columns("-2.234490 link2.omega_rad_s", "3.325152 link3.omega_rad_s"),
    "chengrrr.m: ddθ2, ddθ3, ddC; RRR II级杆组": columns(
        "18.2547 link2.alpha_rad_s2", "44.0309 link3.alpha_rad_s2", "-32.1243 C.ax_m_s2", "-16.9425 C.ay_m_s2"
    ),
    "θ5 = -41 deg": {"-40.3660": lambda: math.degrees(first("link5.angle_rad"))},
    "compvel: W5 = 0.6962 (ω5), ds = -3.1323; 滑块的速度": columns("0.689622 link5.omega_rad_s", "-2.048340 slider.v_m_s"),
    "chengrrp.m: ddθ5, dds; RRP II级杆组": columns("18.1262 link5.alpha_rad_s2", "-18.4714 slider.a_m_s2"),
    "Re s̈2, Im s̈2, 质心; 1, 3, 5 alike": {
        "-25.4516": lambda: float(with_centroid()["S2.ax_m_s2"][0]),
        "-26.1302": lambda: float(with_centroid()["S2.ay_m_s2"][0]),
    },
    "s6, no value": columns("0.724684 slider.s_m"),
    "eq. (1-23), chengrrpdy.m: RxC, RyC of link 5": columns("-1201.9008 C.link5.fx_N", "976.4326 C.link5.fy_N"),
    "eq. (1-23): RxE, RyE": columns("1110.8285 E.fx_N", "-971.6492 E.fy_N"),
    "eq. (1-23): RF; 移动副F的约束反力": columns("-912.8492 F.normal_N"),
    "eq. (1-22), chengrrrdy.m: RxB, RyB": columns("-980.5711 B.fx_N", "-384.5208 B.fy_N"),
    "eq. (1-22): RxC, RyC of link 2": columns("904.2164 C.link2.fx_N", "335.5301 C.link2.fy_N"),
    "chengrrrdy.m: Fx3, Fy3, M3 = x(9), x(10), x(11)": {
        "1201.9008": lambda: float(of_link5()[0]),
        "-976.4326": lambda: float(of_link5()[1]),
        "-374.4828": lambda: moment(0.4 * along(first("link3.angle_rad")), of_link5()),
    },
    "eq. (1-22): RxD, RyD": columns("-333.0211 D.fx_N", "1314.8860 D.fy_N"),
    "eq. (1-21), chengcrankdy.m: RxA, RyA; 转动副A的约束反力": columns("-991.8384 A.fx_N", "-393.9515 A.fy_N"),
    "M1; 驱动力矩": columns("275.2127 input.torque_Nm"),
    "W1; 曲柄力矩所做的功": {"225.0337": lambda: float(second()["input.work_J"][-1])},
}
"""For the first cell of a row of the table, the numbers of its value."""
