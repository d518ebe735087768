"""The document of this page: its faults, and its equations solved without optlink."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

import optlink
from optlink.dynamics.machine import Inertia
from optlink.tasks.analyze import Analysis, analyze
from tests.documents.faults import Fault

CRANK, ROCKER, COUPLER, PIVOT, RAM_LINE = 0.125, 0.6, 0.15, 0.275, 0.575
M3, M4, M5, J3, J4, CUTTING, GRAVITY = 20.0, 3.0, 62.0, 0.12, 0.00025, 5880.0, 9.8
UNKNOWNS = ["Md", "F12x", "F12y", "F16x", "F16y", "F23x", "F23y", "F34x", "F34y", "F36x", "F36y", "F45x", "F45y", "F65", "M65"]
"""The column F_R of eq. (13)."""


@dataclass(frozen=True)
class Solution:
    """Positions, rates and accelerations of eqs. (3) to (6), and the forces of eqs. (7) to (12), at a crank angle and 1 rad/s."""

    positions: tuple[float, float, float, float]
    rates: NDArray[np.float64]
    accelerations: NDArray[np.float64]
    forces: Mapping[str, float]
    size: tuple[int, int]


@cache
def solution(crank: float = 0.0) -> Solution:
    """Solve the equations of the document at a crank angle of the working stroke."""
    pin = np.array([CRANK * np.cos(crank), PIVOT + CRANK * np.sin(crank)])  # (3)
    theta3, s3 = np.arctan2(pin[1], pin[0]), np.hypot(*pin)
    theta4 = np.pi - np.arcsin((RAM_LINE - ROCKER * np.sin(theta3)) / COUPLER)  # (4), E to the left of D
    s_e = ROCKER * np.cos(theta3) + COUPLER * np.cos(theta4)
    c3, d3, c4, d4 = np.cos(theta3), np.sin(theta3), np.cos(theta4), np.sin(theta4)
    matrix = np.array(
        [[c3, -s3 * d3, 0, 0], [d3, s3 * c3, 0, 0], [0, -ROCKER * d3, -COUPLER * d4, -1], [0, ROCKER * c3, COUPLER * c4, 0]]
    )
    rates = np.linalg.solve(matrix, CRANK * np.array([-np.sin(crank), np.cos(crank), 0, 0]))  # (5)
    v3, w3, w4, _ = rates
    derivative = np.array(
        [
            [-w3 * d3, -v3 * d3 - s3 * w3 * c3, 0, 0],
            [w3 * c3, v3 * c3 - s3 * w3 * d3, 0, 0],
            [0, -ROCKER * w3 * c3, -COUPLER * w4 * c4, 0],
            [0, -ROCKER * w3 * d3, -COUPLER * w4 * d4, 0],
        ]
    )
    right = -derivative @ rates - CRANK * np.array([np.cos(crank), np.sin(crank), 0, 0])
    accelerations = np.linalg.solve(matrix, right)  # (6)
    _, a3, a4, a_e = accelerations

    along3, across3 = np.array([c3, d3]), np.array([-d3, c3])
    along4, across4 = np.array([c4, d4]), np.array([-d4, c4])
    acceleration_d = ROCKER * (a3 * across3 - w3**2 * along3)
    f3 = -M3 * acceleration_d / 2
    f4 = -M4 * (acceleration_d + COUPLER / 2 * (a4 * across4 - w4**2 * along4))
    rows: list[dict[str, float]] = []
    known: list[float] = []

    def equation(known_part: float, **terms: float) -> None:
        rows.append(terms)
        known.append(-known_part)

    def moment(force: str, arm: NDArray[np.float64], sign: float = 1.0) -> dict[str, float]:
        return {f"{force}x": -sign * arm[1], f"{force}y": sign * arm[0]}

    equation(0, F12x=-1, F16x=-1)  # (7), F21 = -F12
    equation(0, F12y=-1, F16y=-1)
    equation(0, Md=1, **moment("F12", pin - [0, PIVOT], -1))
    equation(0, F12x=1, F23x=-1)  # (8)
    equation(0, F12y=1, F23y=-1)
    equation(0, F23x=c3, F23y=d3)  # the supplementary equation
    equation(f3[0], F34x=-1, F23x=1, F36x=-1)  # (10)
    equation(f3[1] - M3 * GRAVITY, F34y=-1, F23y=1, F36y=-1)
    half = ROCKER / 2 * along3
    equation(-J3 * a3, **moment("F34", half, -1), **moment("F23", pin - half), **moment("F36", -half, -1))
    equation(f4[0], F45x=-1, F34x=1)  # (11)
    equation(f4[1] - M4 * GRAVITY, F45y=-1, F34y=1)
    half = COUPLER / 2 * along4
    equation(-J4 * a4, **moment("F45", half, -1), **moment("F34", -half))
    equation(CUTTING - M5 * a_e, F45x=1)  # (12)
    equation(-M5 * GRAVITY, F45y=1, F65=1)
    equation(0, M65=1)  # S5 in E
    coefficients = np.array([[row.get(name, 0.0) for name in UNKNOWNS] for row in rows])  # (13)
    forces = np.linalg.solve(coefficients, np.array(known))
    return Solution((theta3, theta4, s3, s_e), rates, accelerations, dict(zip(UNKNOWNS, forces, strict=True)), coefficients.shape)


def force(name: str) -> Callable[[], float]:
    """One of the unknowns of eq. (13) at the crank angle 0."""
    return lambda: solution().forces[name]


def ram_limit(side: float, rocker: float = 63.0, height: float = RAM_LINE) -> float:
    """Limit of the ram [mm] by eqs. (3) and (4), for the rocker at `rocker` degrees from the horizontal on either side."""
    angle = np.radians(rocker)
    return 1e3 * float(side * ROCKER * np.cos(angle) - np.sqrt(COUPLER**2 - (height - ROCKER * np.sin(angle)) ** 2))


def ram_height(side: float, limit: float, rocker: float = 63.0) -> float:
    """Height of the ram [mm] that gives a limit [mm]."""
    angle = np.radians(rocker)
    return 1e3 * float(ROCKER * np.sin(angle) + np.sqrt(COUPLER**2 - (side * ROCKER * np.cos(angle) - limit / 1e3) ** 2))


EXACT = float(np.degrees(np.arccos(CRANK / PIVOT)))


def rod(mass: float, length: float) -> float:
    """Moment of inertia of a uniform rod about its centroid."""
    return mass * length**2 / 12


@cache
def analysed(speed: float, *changes: tuple[str, str]) -> Analysis:
    """The machine at a speed [rad/s], with other values."""
    return analyze(optlink.load("shaper").override(dict(changes)), speed=speed, points=1440)


RPM64 = 64 * np.pi / 30


def torque_range(speed: float, working: bool) -> float:
    """Range of the driving torque in the working or in the return stroke."""
    result = analysed(speed)
    torque, back = result["input.torque_Nm"][:-1], result["ram.v_m_s"][:-1] > 0
    return float(np.ptp(torque[~back if working else back]))


def change_without_inertia() -> float:
    """Largest change of the y reaction in A when inertia vanishes, in percent of its largest value."""
    slow, creep = analysed(1.0)["A.fy_N"], analysed(1e-3)["A.fy_N"]
    return 100 * float(np.max(abs(slow - creep)) / np.max(abs(creep)))


def follows_the_rocker() -> bool:
    """Whether the y reaction is that in x times -cot theta3, at both speeds."""
    return all(
        np.allclose(run["A.fy_N"], -run["A.fx_N"] / np.tan(run["rocker.angle_rad"]), atol=1e-6, rtol=0)
        for run in (analysed(1.0), analysed(RPM64))
    )


def touch(one: str, other: str) -> bool:
    """Whether a joint connects two bodies."""
    mechanism = analysed(1.0).machine.mechanism
    joints = [set(bodies) for bodies in mechanism.pins.values()] + [{guide.slider, guide.on} for guide in mechanism.guides]
    return any({one, other} <= bodies for bodies in joints)


def no_inertia() -> bool:
    """Whether optlink refuses kg/m^2 as a moment of inertia."""
    try:
        optlink.load("shaper").override({"bodies.rocker.inertia": "0.12 kg/m^2"})
    except optlink.InputError:
        return True
    return False


def stroke(rocker: float, height: float = RAM_LINE) -> float:
    """Difference of the limits [mm]."""
    return ram_limit(1, rocker, height) - ram_limit(-1, rocker, height)


def largest_acceleration(working: bool) -> float:
    """Largest acceleration of the ram in the working or in the return stroke."""
    run = analysed(1.0)
    back = run["ram.v_m_s"] > 0
    return float(np.max(abs(run["ram.a_m_s2"][~back if working else back])))


def return_prevails() -> float:
    """Speed [rpm] from which the return stroke needs a larger torque than the cut."""
    run = analysed(1.0)
    static, back = run["input.torque_gravity_Nm"] + run["input.torque_load_Nm"], run["ram.v_m_s"] > 0

    def excess(rpm: float) -> float:
        torque = static + (rpm * np.pi / 30) ** 2 * run["input.torque_inertia_Nm"]
        return float(torque[back].max() - torque[~back].max())

    return float(brentq(excess, 20.0, 100.0))


def minus(name: str) -> Callable[[], float]:
    """One of the unknowns of eq. (13) with the other sign."""
    return lambda: -solution().forces[name]


def across_the_rocker() -> float:
    """F32 to the left of C-D."""
    angle, forces = solution().positions[0], solution().forces
    return float(forces["F23x"] * np.sin(angle) - forces["F23y"] * np.cos(angle))


def least_pull() -> float:
    """The x reaction in A that is nearest to zero within the cut."""
    run = analysed(1.0)
    return float(run["A.fx_N"][run["cutting.fx_N"] > 0].max())


def inertia(body: str) -> Inertia:
    """Mass, centroid and moment of inertia of a body of the problem file."""
    return analysed(1.0).machine.inertias[body]


UNIFORM = (("bodies.rocker.inertia", "0.6 kg*m^2"), ("bodies.coupler.inertia", "0.005625 kg*m^2"))

FAULTS = [
    Fault("data", "0.12kg/2m", holds=no_inertia),
    Fault(
        "data",
        "3s J =0.12",
        {"0.6": lambda: rod(M3, ROCKER), "5": lambda: rod(M3, ROCKER) / J3, "77.5": lambda: 1e3 * (J3 / M3) ** 0.5},
    ),
    Fault(
        "data",
        "4s J =0.00025",
        {
            "0.0056": lambda: rod(M4, COUPLER),
            "22.5": lambda: rod(M4, COUPLER) / J4,
            "-713.43": lambda: analysed(RPM64, *UNIFORM).extremes["input.torque_Nm"].least,
            "-700.27": lambda: analysed(RPM64).extremes["input.torque_Nm"].least,
        },
    ),
    Fault("(8)", "12310y y F F +=", holds=lambda: not touch("crank", "rocker") and touch("block", "rocker")),
    Fault("1.2.2", "=544.78mm", {"545.45": lambda: stroke(EXACT), "0.67": lambda: stroke(EXACT) - stroke(63.0)}),
    Fault(
        "1.2.2",
        "与仿真结果相当,因此仿真是正确的",
        {"545.45": lambda: stroke(EXACT, 0.56), "3.4": lambda: ram_limit(1, EXACT) - ram_limit(1, EXACT, 0.56)},
    ),
    Fault("2.2.2", "主要是由于机器振动而引起", {"0.77": change_without_inertia}, holds=follows_the_rocker),
    Fault(
        "2.2.2",
        "平衡力矩变化较平缓,而空行程时变化较大",
        {
            "1107": lambda: torque_range(RPM64, working=True),
            "1528": lambda: torque_range(RPM64, working=False),
            "1105": lambda: torque_range(1.0, working=True),
            "55": lambda: torque_range(1.0, working=False),
            "74.2": return_prevails,
        },
    ),
]

COMPUTED: dict[str, dict[str, Callable[[], float]]] = {
    "l6 in (1), from C to A": {"275.3": lambda: 1e3 * CRANK / np.cos(np.radians(63.0))},
    "m3 = 20 kg, m4 = 3 kg, m5 = 62 kg, 质量 mass; 1 and 2: 忽略不计 negligible": {
        "20": lambda: inertia("rocker").mass,
        "3": lambda: inertia("coupler").mass,
        "62": lambda: inertia("ram").mass,
    },
    "Js3 = 0.12, Js4 = 0.00025, 转动惯量 moment of inertia": {
        "0.12": lambda: inertia("rocker").moment,
        "0.00025": lambda: inertia("coupler").moment,
    },
    "质心 S3, S4 at 中点, the middle": {
        "300": lambda: 1e3 * inertia("rocker").along,
        "75": lambda: 1e3 * inertia("coupler").along,
    },
    "匀速 constant speed ω1; g": {
        "1": lambda: analyze(optlink.load("shaper")).speed,
        "9.8": lambda: -analysed(1.0).machine.gravity[1],
    },
    "(3), θ1, θ3 方位角 direction angle": {"65.5560": lambda: np.degrees(solution().positions[0])},
    "(3), s3 位移量 slide of the block": {"302.0761": lambda: 1e3 * solution().positions[2]},
    "(4), θ4": {"168.9382": lambda: np.degrees(solution().positions[1])},
    "(4), sE 位移 displacement of the ram": {"101.0686": lambda: 1e3 * solution().positions[3]},
    "(5), ω3 角速度 angular velocity": {"0.171233": lambda: solution().rates[1]},
    "(5), ω4": {"0.288792": lambda: solution().rates[2]},
    "(5), ds3/dt 滑动速度 sliding velocity": {"0.113796": lambda: solution().rates[0]},
    "(5), vE 速度 velocity": {"-0.101842": lambda: solution().rates[3]},
    "(6), α3 角加速度 angular acceleration": {"0.247701": lambda: solution().accelerations[1]},
    "(6), α4": {"0.292663": lambda: solution().accelerations[2]},
    "(6), d²s3/dt² 滑动加速度 sliding acceleration": {"-0.042868": lambda: solution().accelerations[0]},
    "(6), αE 加速度 acceleration": {"-0.138724": lambda: solution().accelerations[3]},
    "最大位移 128.1 mm (ADAMS)": {"574.22": lambda: ram_height(1, 128.1, EXACT)},
    "最小位移 -417.3 mm (ADAMS)": {"574.42": lambda: ram_height(-1, -417.3, EXACT)},
    "127.93 mm by hand (理论计算)": {"127.936": lambda: ram_limit(1), "574.98": lambda: ram_height(1, 127.93)},
    "-416.85 mm by hand": {"-416.852": lambda: ram_limit(-1), "575.01": lambda: ram_height(-1, -416.85)},
    "S = 544.78 mm by hand": {"544.789": lambda: stroke(63.0)},
    "(7), Md 平衡力矩 balancing moment": {"604.6240": force("Md")},
    "(7), F16 = -F61, 转动副 A (JOINT_1)": {"-10641.382": minus("F16x"), "4836.992": minus("F16y")},
    "(8), F12 = -F21, pin B": {"-10641.382": force("F12x"), "4836.992": force("F12y")},
    "F23 = -F32; 补充方程 F23x cos θ3 + F23y sin θ3 = 0 (its number is lost)": {"-11689.119": across_the_rocker},
    "(10), F36 = -F63, pin C": {"4750.933": minus("F36x"), "-3474.542": minus("F36y")},
    "(10), F34 = -F43, pin D": {"-5889.023": force("F34x"), "1165.995": force("F34y")},
    "(11), F45 = -F54, pin E": {"-5888.601": force("F45x"), "1136.527": force("F45y")},
    "(12), F65 垂直反力, 导路 guide": {"-528.927": force("F65")},
    "(12), M65 反力矩 moment of the guide": {"0": force("M65")},
    "(13), C FR = D: 系数矩阵, 未知力矩阵, 已知力矩阵": {"15": lambda: float(sum(solution().size)) / 2},
    "figure 5: Fx of A 约束反力 reaction (水平): smoother (平滑), its direction stays in the cut": {"-8707.9": least_pull},
    "3: 加速度 small in the cut, large in the 回程 return": {
        "0.312": lambda: largest_acceleration(working=True),
        "0.716": lambda: largest_acceleration(working=False),
    },
}
"""For the first cell of a row of the table, the numbers of its value."""
