"""The document of this page: its faults, and values that no command prints, computed.

The formulas are those of the document, in millimetres and radians.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

import optlink
from tests.documents.faults import Fault

L1, L4 = 100.0, 500.0
PRINTED = (412.26, 232.2417)
ROOT_2 = 1.414
"""As the document rounds it."""


def start(l2: float, l3: float) -> tuple[float, float]:
    """Crank and rocker angle at the outer limit position, by equations (2) and (3)."""
    whole = L1 + l2
    return (
        math.acos((whole**2 - l3**2 + L4**2) / (2 * whole * L4)),
        math.acos((whole**2 - l3**2 - L4**2) / (2 * l3 * L4)),
    )


def rocker_angle(l2: float, l3: float, phi: float) -> float:
    """The rocker angle by the two branches of equation (6), with equations (7), (8) and (9)."""
    phi = phi % (2 * math.pi)
    rho = math.sqrt(L1**2 + L4**2 - 2 * L1 * L4 * math.cos(phi))
    alpha = math.acos((rho**2 + l3**2 - l2**2) / (2 * rho * l3))
    beta = math.acos((rho**2 + L4**2 - L1**2) / (2 * rho * L4))
    return math.pi - alpha + (beta if phi >= math.pi else -beta)


def errors(l2: float, l3: float) -> list[float]:
    """Deviations at the positions of the loop of Objfun.m."""
    phi0, psi0 = start(l2, l3)
    step = math.pi / 2 / 30
    turned = [i * step for i in range(round((math.pi / 2) / step) + 1)]
    return [rocker_angle(l2, l3, phi0 + angle) - psi0 - 2 / (3 * math.pi) * angle**2 for angle in turned]


def objective(l2: float, l3: float) -> float:
    return sum(error**2 for error in errors(l2, l3))


def constraints(l2: float, l3: float, root: float = ROOT_2) -> list[float]:
    """c(1) ... c(7) of confun.m; none may be positive."""
    squares, product = l2**2 + l3**2, root * l2 * l3
    linear = [100 - l2, 100 - l3, 600 - l2 - l3, l2 - l3 - 400, l3 - l2 - 400]
    return [*linear, squares - product - 160000, 360000 - squares - product]


def largest_angle(l2: float, l3: float) -> float:
    """The largest transmission angle [deg], left side of equation (16)."""
    return math.degrees(math.acos((l2**2 + l3**2 - (L1 + L4) ** 2) / (2 * l2 * l3)))


def coupler(l3: float, root: float = ROOT_2) -> float:
    """The coupler for which the last constraint is met exactly."""
    found: float = brentq(lambda l2: constraints(l2, l3, root)[6], 300.0, 600.0, xtol=1e-10)
    return found


@cache
def best(root: float) -> tuple[float, float]:
    """The optimum of the document's problem along its active constraint."""
    found = minimize_scalar(lambda l3: objective(coupler(l3, root), l3), bounds=(220.0, 245.0), options={"xatol": 1e-8})
    return coupler(found.x, root), float(found.x)


def in_another_unit(scale: float) -> float:
    """The objective at the optimum with all lengths in another unit of length, by optlink."""
    l2, l3 = best(ROOT_2)
    lengths = dict(zip(("crank", "coupler", "rocker", "frame"), np.array([L1, l2, l3, L4]) * scale, strict=True))
    phi0, psi0 = start(l2, l3)
    turned = np.linspace(0.0, math.pi / 2, 31)
    motion = optlink.linkage.sweep(optlink.linkage.four_bar(), lengths, phi0 + turned)
    error: NDArray[np.float64] = motion.body_angle("rocker").value - psi0 - 2 / (3 * math.pi) * turned**2
    return float(error @ error)


def angle_of_lengths(phi: float) -> float:
    """The rocker angle [deg] of optlink's one formula at the optimum; the two branches of the document agree with it."""
    l2, l3 = best(math.sqrt(2.0))
    moved = optlink.linkage.sweep(
        optlink.linkage.four_bar(), {"crank": 0.1, "coupler": l2 / 1e3, "rocker": l3 / 1e3, "frame": 0.5}, np.array([phi])
    )
    psi = float(moved.body_angle("rocker").value[0])
    assert abs(psi - rocker_angle(l2, l3, phi)) < 1e-9
    return math.degrees(psi)


def one_branch_is_enough() -> float:
    """The largest start angle [deg] of all lengths that satisfy the constraints, on a grid of 1 mm."""
    l2, l3 = np.meshgrid(np.arange(100.0, 901.0), np.arange(100.0, 901.0))
    feasible = np.all(np.array(constraints(l2, l3)) <= 0.0, axis=0)
    whole = L1 + l2[feasible]
    return float(np.degrees(np.arccos((whole**2 - l3[feasible] ** 2 + L4**2) / (2 * whole * L4)).max()))


CALL = "fmincon(@objfun,x0,[],[],[],[],[],[],@confun)"
OPTIONS = "options=optimset('LargeScale','off');"


def options_are_not_passed() -> bool:
    """They are the tenth argument of fmincon."""
    arguments = CALL.partition("(")[2].rstrip(")").split(",")
    return len(arguments) == 9 and OPTIONS.partition("=")[0] not in arguments


def file_has_another_name() -> bool:
    """MATLAB looks a function up by the name of its file."""
    handle = CALL.partition("@")[2].partition(",")[0]
    return handle != "Objfun" and handle.lower() == "objfun"


FAULTS: list[Fault] = [
    Fault(
        "step 4, result",
        "412.26mm",
        {
            "412.887": lambda: coupler(PRINTED[1]),
            "723.5": lambda: constraints(*PRINTED)[6],
            "135.298": lambda: largest_angle(*PRINTED),
            "0.0075491": lambda: objective(*PRINTED),
            "0.0075936": lambda: objective(coupler(PRINTED[1]), PRINTED[1]),
        },
        holds=lambda: (
            f"{objective(*PRINTED):.4f}" == "0.0075" and f"{objective(coupler(PRINTED[1]), PRINTED[1]):.4f}" == "0.0076"
        ),
    ),
    Fault(
        "step 4, result",
        "0.0076 mm2",
        {"0.0076": lambda: objective(*best(ROOT_2))},
        holds=lambda: math.isclose(in_another_unit(1.0), in_another_unit(1e-3), rel_tol=1e-9),
    ),
    Fault(
        "step 3, g6 and g7",
        "1.414",
        {
            "1.41421": lambda: math.sqrt(2.0),
            "134.99135": lambda: math.degrees(math.acos(-ROOT_2 / 2)),
            "0.0206": lambda: best(ROOT_2)[0] - best(math.sqrt(2.0))[0],
        },
    ),
    Fault(
        "step 2",
        "取30个观测点",
        {"31": lambda: len(errors(*PRINTED))},
        holds=lambda: abs(errors(*PRINTED)[0]) < 1e-7,
    ),
    Fault("step 4, run.m", OPTIONS, holds=options_are_not_passed),
    Fault("step 4", "编写m文件Objfun.m", holds=file_has_another_name),
]

FILE = optlink.load("crank-rocker").raw


def stated(*keys: str | int) -> Callable[[], float]:
    """The number of a quantity of the problem file."""

    def number() -> float:
        found: Any = FILE
        for key in keys:
            found = found[key]
        return float(str(found).partition(" ")[0])

    return number


COMPUTED: dict[str, dict[str, Callable[[], float]]] = {
    "$`l_1`$ = 100 mm, 曲柄长度": {"100": stated("mechanism", "crank")},
    "$`l_4`$ = 500 mm, 机架长度": {"500": stated("mechanism", "frame")},
    "$`l_2`$ = $`x_1`$, 连杆, start 400": {"400": stated("mechanism", "coupler", "start")},
    "$`l_3`$ = $`x_2`$, 摇杆, start 400": {"400": stated("mechanism", "rocker", "start")},
    "$`\\varphi`$, 曲柄转角, from $`\\varphi_0`$ to $`\\varphi_0`$ + 90°": {"90": stated("requirement", "span")},
    "$`m`$ = 30, 输入角的等分数": {"30": stated("requirement", "points")},
    "$`\\gamma`$ = 45° ~ 135°, 传动角 (连杆与摇杆的夹角)": {
        "45": stated("limits", "transmission_angle", 0),
        "135": stated("limits", "transmission_angle", 1),
    },
    "$`\\psi_E`$ (script), 预期输出角": {"30": lambda: math.degrees(2 / (3 * math.pi) * (math.pi / 2) ** 2)},
    "$`\\psi`$ = π − α ∓ β, (6) to (9), 实际输出角": {
        "115.976": lambda: angle_of_lengths(math.radians(90.0)),
        "138.596": lambda: angle_of_lengths(math.radians(270.0)),
    },
    "constants of steps 1 to 4": {
        "250000": lambda: L4**2,
        "10000": lambda: L1**2,
        "240000": lambda: L4**2 - L1**2,
        "260000": lambda: L4**2 + L1**2,
        "100000": lambda: 2 * L1 * L4,
        "160000": lambda: (L4 - L1) ** 2,
        "360000": lambda: (L4 + L1) ** 2,
        "400": lambda: L4 - L1,
        "600": lambda: L4 + L1,
        "1000": lambda: 2 * L4,
    },
    "only 「ps=pi-a-b」 in the script": {"76": one_branch_is_enough},
}
"""For the first cell of a row of the table, the numbers of its value."""
