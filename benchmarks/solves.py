"""The crank-rocker solved by optlink, by plain SciPy with finite differences and by Octave's sqp."""

from __future__ import annotations

import shutil
import statistics
import subprocess
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from timing import HERE, Row, race

import optlink
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import build
from optlink.solvers.contract import BACKENDS
from optlink.solvers.multistart import solve_from

Array = NDArray[np.float64]

REPETITIONS = 200
RANDOM_STARTS = 300
REFERENCE = np.array([412.86542, 232.24617])  # coupler, rocker [mm]
TIGHT = 1e-11  # ftol that brings SciPy to the optimum from every start at which the objective is defined
CRANK, FRAME = 100.0, 500.0
LOW, HIGH, START = 100.0, 900.0, np.array([400.0, 400.0])
OFFSETS = np.arange(1, 31) * (np.pi / 2.0 / 30.0)


# --- an independent transcription, in mm ---------------------------------------------------------------------------


def objective(x: Array) -> float:
    """Sum of the squared output errors [rad^2] of coupler and rocker [mm]."""
    coupler, rocker = x
    reach = CRANK + coupler
    phi0 = np.arccos((reach**2 - rocker**2 + FRAME**2) / (2.0 * reach * FRAME))
    psi0 = np.arccos((reach**2 - rocker**2 - FRAME**2) / (2.0 * rocker * FRAME))
    x_bd, y_db = FRAME - CRANK * np.cos(phi0 + OFFSETS), CRANK * np.sin(phi0 + OFFSETS)
    diagonal = np.sqrt(x_bd**2 + y_db**2)
    at_d = np.arccos((diagonal**2 + rocker**2 - coupler**2) / (2.0 * diagonal * rocker))
    error = psi0 + 2.0 / (3.0 * np.pi) * OFFSETS**2 - (np.pi - np.arctan2(y_db, x_bd) - at_d)
    return float(error @ error)


def inequalities(x: Array) -> Array:
    """Grashof's conditions [mm] and the transmission angle's extremes as cosines; none may be negative."""
    coupler, rocker = x
    squares, double = coupler**2 + rocker**2, 2.0 * coupler * rocker
    return np.array(
        [
            coupler - CRANK,
            rocker - CRANK,
            FRAME - CRANK,
            coupler + rocker - CRANK - FRAME,
            rocker + FRAME - CRANK - coupler,
            coupler + FRAME - CRANK - rocker,
            (squares - (FRAME + CRANK) ** 2) / double - np.cos(0.75 * np.pi),
            np.cos(0.25 * np.pi) - (squares - (FRAME - CRANK) ** 2) / double,
        ]
    )


def scipy_raw(start: Array) -> Array:
    """As one writes it down first: in mm, default options."""
    limits = {"type": "ineq", "fun": inequalities}
    return np.asarray(minimize(objective, start, method="SLSQP", bounds=[(LOW, HIGH)] * 2, constraints=limits).x)


def scipy_scaled(start: Array, ftol: float) -> Array:
    """Lengths and Grashof's sums over the frame, objective over its value at the start."""
    size = np.array([FRAME] * 6 + [1.0] * 2)
    f0 = objective(start)
    result = minimize(
        lambda x: objective(x * FRAME) / f0,
        start / FRAME,
        method="SLSQP",
        bounds=[(LOW / FRAME, HIGH / FRAME)] * 2,
        constraints={"type": "ineq", "fun": lambda x: inequalities(x * FRAME) / size},
        options={"ftol": ftol, "maxiter": 300},
    )
    return np.asarray(result.x) * FRAME


def loosest_tolerance() -> float:
    """The loosest ftol at which SciPy arrives within 1e-3 mm: every digit more would cost it time for nothing."""
    for exponent in range(6, 16):
        if miss(scipy_scaled(START, 10.0**-exponent)) <= 1e-3:
            return float(10.0**-exponent)
    return 1e-15


# --- comparison ----------------------------------------------------------------------------------------------------


def miss(x: Array) -> float:
    """Distance from the reference [mm], infinite where there is no number."""
    return float(np.nan_to_num(np.max(np.abs(x - REFERENCE)), nan=np.inf))


def place(x: Array) -> str:
    return f"{x[0]:.5f}, {x[1]:.5f} mm"


def ours(nlp: NLP, x: Array, name: str) -> Array:
    """Coupler and rocker [mm] found from the scaled x."""
    design = solve_from(nlp, x, name).design
    return 1e3 * np.array([design["coupler"], design["rocker"]])


def ms(seconds: float) -> str:
    return f"{1e3 * seconds:.2f} ms"


def octave() -> dict[str, tuple[float, Array, float]]:
    """Median seconds, end [mm] and objective of each variant in crank_rocker.m; empty without Octave."""
    program = shutil.which("octave-cli") or shutil.which("octave")
    if program is None:
        return {}
    script = HERE / "crank_rocker.m"
    done = subprocess.run([program, "--norc", "--quiet", str(script)], capture_output=True, text=True, check=False)
    lines = [line.split() for line in done.stdout.splitlines() if len(line.split()) == 5]
    return {name: (float(t), np.array([float(a), float(b)]), float(f)) for name, t, a, b, f in lines}


def from_the_start(nlp: NLP) -> list[Row]:
    """Everyone from (400, 400) mm."""
    ftol = loosest_tolerance()
    raw, fine = scipy_raw(START), scipy_scaled(START, ftol)
    contenders: dict[str, Callable[[], object]] = {
        "slsqp": lambda: solve_from(nlp, nlp.x_start, "slsqp"),
        "ipopt": lambda: solve_from(nlp, nlp.x_start, "ipopt"),
        "scaled": lambda: scipy_scaled(START, ftol),
        "raw": lambda: scipy_raw(START),
    }
    taken = race(contenders, REPETITIONS)
    rows = []
    for name in BACKENDS:
        note = f"ends at {place(ours(nlp, nlp.x_start, name))}"
        rows.append(Row(f"solve, {name}", ms(taken[name]), "", note=note, figures={"ours": taken[name]}))
    best = min(taken[name] for name in BACKENDS)

    def against(what: str, theirs: float, target: str, note: str) -> Row:
        figures = {"ours": best, "theirs": theirs}
        return Row(f"solve against {what}", ms(best), ms(theirs), theirs / best, target, note, figures=figures)

    reached = f"ftol {ftol:.0e}, ends at {place(fine)}"
    if miss(fine) > 1e-3:
        reached += ": no tolerance brings it to 1e-3 mm"
    excess = 100.0 * (objective(raw) / objective(REFERENCE) - 1.0)
    stopped = f"stops at {place(raw)}, {excess:+.1f} % objective: not the optimum"
    rows.append(against("SciPy SLSQP, finite differences, scaled by hand", taken["scaled"], ">= 1", reached))
    rows.append(against("SciPy SLSQP, finite differences, in mm", taken["raw"], "", stopped))
    found = octave()
    for key, how in (
        ("loop", "objective as a loop, in mm"),
        ("vectorised", "vectorised, in mm"),
        ("scaled", "vectorised, scaled by hand"),
    ):
        what = f"Octave sqp, {how}"
        if key in found:
            theirs, end, f = found[key]
            note = f"ends at {place(end)}, {f:.8f} rad^2" + ("" if miss(end) <= 1e-2 else ": not the optimum")
            rows.append(against(what, theirs, ">= 10", note))
        else:
            note = "Octave is not installed, or crank_rocker.m failed in it"
            rows.append(Row(f"solve against {what}", ms(best), "skipped", target=">= 10", note=note))
    return rows


def from_anywhere(nlp: NLP) -> list[Row]:
    """Random starts over the bounds, usable or not; the ratio is that of the time spent per optimum found."""
    points = np.random.default_rng(0).uniform(LOW, HIGH, (RANDOM_STARTS, 2))
    defined = np.mean([np.isfinite(objective(point)) for point in points])
    contenders: dict[str, Callable[[Array], Array]] = {
        "slsqp": lambda x: ours(nlp, x / FRAME, "slsqp"),
        "ipopt": lambda x: ours(nlp, x / FRAME, "ipopt"),
        "scipy": lambda x: scipy_scaled(x, TIGHT),
    }
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    hits = dict.fromkeys(contenders, 0)
    for point in points:
        for name, run in contenders.items():
            begin = time.perf_counter()
            end = run(point)
            seconds[name].append(time.perf_counter() - begin)
            hits[name] += miss(end) <= 1e-3
    share = {name: hit / RANDOM_STARTS for name, hit in hits.items()}
    taken = {name: statistics.median(values) for name, values in seconds.items()}
    rows = []
    for name in BACKENDS:
        ratio = taken["scipy"] / taken[name] * share[name] / max(share["scipy"], 0.5 / RANDOM_STARTS)
        figures = {"ours": taken[name], "theirs": taken["scipy"], "share": share[name], "their_share": share["scipy"]}
        what = f"solve, {name}, from {RANDOM_STARTS} random starts against scaled SciPy"
        note = (
            f"at the optimum within 1e-3 mm: ours {100.0 * share[name]:.1f} %, theirs {100.0 * share['scipy']:.1f} % "
            f"(objective defined at {100.0 * defined:.1f} % of the starts); ratio: time per optimum found"
        )
        rows.append(Row(what, ms(taken[name]), ms(taken["scipy"]), ratio, "", note, figures=figures))
    return rows


def rows() -> list[Row]:
    """Every comparison of a solve, without the build."""
    nlp = build(optlink.load("crank-rocker").spec)
    with np.errstate(all="ignore"):  # the plain transcription has no value where no linkage can be assembled
        return [*from_the_start(nlp), *from_anywhere(nlp)]
