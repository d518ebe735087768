"""The document of this page: its faults, and values that no command prints, computed."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import optlink
from optlink.clearance.equations import SpanningTree
from tests.documents.faults import Fault

CRANK, ROD = 50.0, 120.0  # mm, of the page
SAMPLE, SPEEDS = 0.005, (1200.0, 1500.0, 1800.0)  # s, r/min
TABLES = {3: "實驗平臺規格", 4: "滑塊位移誤差的均方差"}


def slide(theta2: float) -> float:
    """r1 of (1) and (2) [mm]."""
    return CRANK * math.cos(theta2) + math.sqrt(ROD**2 - (CRANK * math.sin(theta2)) ** 2)


def crank_of_the_squares(theta2: float) -> float:
    """r2 from the sum of the squares of (7) and (8) as printed, without a gap [mm]."""
    theta3 = -math.asin(CRANK / ROD * math.sin(theta2))
    r1 = slide(theta2)
    return math.hypot(r1 - ROD * math.cos(theta3), r1 - ROD * math.sin(theta3))


FAULTS: list[Fault] = [
    Fault(
        "eq. (8)",
        "r2sinθ2+r3sinθ3=r1+r4sinθ4",
        {"136.9": lambda: slide(math.radians(60.0)), "181.9": lambda: crank_of_the_squares(math.radians(60.0))},
    ),
    Fault("section 2.2", "採樣頻率設置為0.005 s", {"200": lambda: 1.0 / SAMPLE}),
    Fault(
        "section 2.3",
        "由表3可以看出,滑塊位移誤差隨著電機的轉速增加而減小",
        holds=lambda: "誤差" in TABLES[4] and "誤差" not in TABLES[3],
    ),
]


@functools.cache
def problem() -> optlink.ProblemFile:
    return optlink.load("slider-crank-clearance")


@functools.cache
def ideal() -> optlink.Analysis:
    return optlink.analyze(problem(), points=720)


@functools.cache
def inverse() -> optlink.control.InverseMotion:
    return optlink.control.inverse_model(problem())


@functools.cache
def late() -> optlink.control.ClearanceSimulation:
    """Eight revolutions of the machine with one gap."""
    return optlink.control.simulate_clearance(problem(), 8, 360, check_predictability=False)


def largest(*remainders: NDArray[np.float64]) -> float:
    return float(np.max(np.abs(remainders)))


def loop(projection: str, gap_column: str) -> NDArray[np.float64]:
    """R2 + R3 - R4 along an axis [mm]."""
    along, run = {"cos": np.cos, "sin": np.sin}[projection], late()
    reach: NDArray[np.float64] = CRANK * along(run["crank.angle_rad"]) + ROD * along(run["rod.angle_rad"])
    return reach - 1e3 * run[gap_column]


def contact_force() -> NDArray[np.float64]:
    """Fx and Fy of (19) and (20) [N]."""
    run = late()
    theta4, normal, tangential = np.arctan2(run["C.ey_m"], run["C.ex_m"]), run["C.normal_N"], run["C.rub_N"]
    cosine, sine = np.cos(theta4), np.sin(theta4)
    return np.array([tangential * sine + normal * cosine, -tangential * cosine + normal * sine])


def crossings() -> list[float]:
    """Crank angles of the last of eight revolutions at which the error changes its sign [deg]."""
    run = late()
    angle, error = run["crank_angle_deg"][-361:] - 7 * 360.0, run["slider.error_m"][-361:]
    at = np.flatnonzero(np.diff(np.sign(error)))
    return [float(angle[k] - error[k] * (angle[k + 1] - angle[k]) / (error[k + 1] - error[k])) for k in at]


def millimetres(name: str) -> float:
    return 1e3 * float(problem().model.quantities[name].value)


def centroid(body: str) -> float:
    """Distance of the centroid from the first joint [mm]."""
    inertia = problem().model.machine().inertias[body]
    return 1e3 * math.hypot(float(inertia.along), float(inertia.across))


def coordinates() -> float:
    """Free coordinates of the machine with the gap at C."""
    machine = problem().model.machine()
    return len(SpanningTree(machine.mechanism, machine.sizes, {"C": "rod"}).coordinates)


def gap(of: str) -> float:
    (joint,) = problem().model.gaps(problem().model.machine())
    return 1e3 * float(getattr(joint, of))


COMPUTED: dict[str, dict[str, Callable[[], float]]] = {
    "r2, 曲柄長度": {"50": lambda: millimetres("crank.length")},
    "r3, 連桿長度": {"120": lambda: millimetres("rod.length")},
    "r1, 滑塊位移, (1)": {
        "70": lambda: 1e3 * ideal().extremes["slider.s_m"].least,
        "170": lambda: 1e3 * ideal().extremes["slider.s_m"].largest,
    },
    "θ2, 曲柄轉角; ω2": {"125.66": lambda: float(ideal()["crank.omega_rad_s"][0])},
    "θ3, 連桿轉角, (2); ω3, (4)": {"24.62": lambda: math.degrees(max(abs(ideal()["rod.angle_rad"])))},
    "R1 ... R4, 閉環矢量方程, (6), (7)": {"0.000": lambda: largest(loop("cos", "C.ex_m") - 1e3 * late()["slider.s_m"])},
    "r2 sin θ2 + r3 sin θ3 = r1 + r4 sin θ4, (8); (9), (10)": {"0.000": lambda: largest(loop("sin", "C.ey_m"))},
    "Fx, Fy, (19), (20)": {
        "0.000": lambda: largest(contact_force()[0] + late()["C.fx_N"], contact_force()[1] + late()["C.fy_N"])
    },
    "r4, 間隙半徑": {"0.5": lambda: gap("clearance")},
    "R, 軸銷半徑, (12)": {"9.5": lambda: gap("radius")},
    "rs1, 曲柄質心距o點的長度": {"25": lambda: centroid("crank")},
    "rs2, 連桿質心距曲柄的長度": {"60": lambda: centroid("rod")},
    "m4, 滑塊質量; g, (13), (14)": {
        "0.14": lambda: float(problem().model.machine().inertias["slider"].mass),
        "9.81": lambda: -float(problem().model.gravity[1]),
        "1.3734": lambda: float(np.max(ideal()["G.normal_N"] - ideal()["C.fy_N"])),
    },
    "f, Ft = (-f sign(Vt) Fn - Ct Vt) S, 切向觸力, (18)": {"0.1": lambda: gap("friction") / 1e3},
    "Ct, 切向阻尼": {"0": lambda: gap("damping")},
    "16階的矩陣, (6)-(20), fig. 2 仿真模型": {"3": coordinates},
    "極限位置: there the journal crosses the gap, and the machine lags (滯後)": {
        "86": lambda: crossings()[0],
        "298": lambda: crossings()[1],
    },
    "0.005 s, 採樣": {
        f"{digits}": functools.partial(lambda speed: 60.0 / speed / SAMPLE, speed)
        for digits, speed in zip(("10.0", "8.0", "6.7"), SPEEDS, strict=True)
    },
    "逆模型, r1為輸入, ω2為輸出, (26)-(30), 反餘弦, fig. 9": {
        "118.90": lambda: float(inverse().speed.min()),
        "139.92": lambda: float(inverse().speed.max()),
    },
}
"""For the first cell of a row of the table, the numbers of its value."""
