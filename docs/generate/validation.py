"""Tables of reference values and of the results that optlink computes.

No table is made if a result differs from its reference by more than its tolerance. The page itself quotes results that take
minutes to compute, with the test that checks them.
"""

from __future__ import annotations

import ast
import csv
import functools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import optlink
from optlink.studies.motion_sensitivity import output_sensitivity

ROOT = Path(__file__).resolve().parents[2]
RPM = math.pi / 30.0
SIX_BAR, SHAPER = "tests/validation/test_six_bar.py", "tests/validation/test_shaper.py"
CRANK_ROCKER, CLEARANCE = "tests/validation/test_crank_rocker.py", "tests/validation/test_clearance.py"
BALANCE, PROBLEMS = "tests/validation/test_balance.py", "tests/test_problems.py"

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Row:
    """A figure: reference value, value of optlink, absolute tolerance, and the test (file::function) that compares them."""

    what: str
    unit: str
    target: float
    actual: float
    near: float
    test: str

    @property
    def off(self) -> float:
        """Difference from the reference: relative, or absolute if the reference is zero."""
        return self.actual - self.target if self.target == 0.0 else self.actual / self.target - 1.0

    @property
    def holds(self) -> bool:
        """Whether the difference is within the tolerance."""
        return abs(self.actual - self.target) <= self.near


@dataclass(frozen=True)
class Group:
    """The figures of one system: its heading, the source of the reference values, the rows."""

    title: str
    source: str
    rows: Callable[[], Iterator[Row]]


def literal(file: str, name: str) -> Any:
    """Return a constant of a test module, so that every table of reference values is defined once."""
    for node in ast.parse((ROOT / file).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id == name:
            return ast.literal_eval(node.value)
    raise KeyError(f"{file} has no {name}")


def columns(file: str) -> dict[str, Array]:
    """Return the columns of a table of reference values."""
    with (ROOT / "tests" / "data" / file).open(encoding="utf-8", newline="") as stream:
        head, *rows = csv.reader(stream)
    return dict(zip(head, np.array(rows, dtype=float).T, strict=True))


# --- the crank-rocker --------------------------------------------------------------------------------------------------


def crank_rocker() -> Iterator[Row]:
    """Yield the figures of the optima, the published design, other numbers of points, and the sensitivity of the output angle."""
    problem = optlink.load("crank-rocker")
    test = f"{CRANK_ROCKER}::test_both_back_ends_reach_the_reference_and_agree"
    solved = optlink.solve(problem, "both")
    yield Row("coupler", "mm", 412.86542, solved.design["coupler"] * 1e3, 1e-3, test)
    yield Row("rocker", "mm", 232.24617, solved.design["rocker"] * 1e3, 1e-3, test)
    yield Row("sum of squares", "rad^2", 0.00759237, solved.objective, 1e-8, test)
    test = f"{CRANK_ROCKER}::test_source_s_rounding_of_the_square_root_of_two"
    changes = {"limits.transmission_angle": None, "limits.transmission_cosine": [-0.707, 0.707]}
    rounded = optlink.solve(problem.override(changes), "both")
    yield Row("coupler, with sqrt(2) rounded to 1.414", "mm", 412.88606, rounded.design["coupler"] * 1e3, 1e-3, test)
    yield Row("rocker, with sqrt(2) rounded to 1.414", "mm", 232.24298, rounded.design["rocker"] * 1e3, 1e-3, test)
    yield Row("sum of squares, with sqrt(2) rounded to 1.414", "rad^2", 0.00759364, rounded.objective, 1e-8, test)
    test = f"{CRANK_ROCKER}::test_printed_optimum_violates_its_own_limit"
    printed = optlink.validate(problem, {"coupler": 0.41226, "rocker": 0.2322417})
    angle = next(check.value for check in printed.validation.checks if check.name == "largest transmission angle")
    yield Row("largest transmission angle of the published design", "deg", 135.298, angle, 5e-4, test)
    yield Row("sum of squares of the published design", "rad^2", 0.0075491, printed.objective, 5e-8, test)
    test = f"{CRANK_ROCKER}::test_more_points"
    for points, objective, coupler in ((50, 0.01202913, 412.31429), (60, 0.01424872, 412.17469), (90, 0.02090930, 411.94041)):
        more = optlink.solve(problem.override({"requirement.points": points}), "both")
        yield Row(f"sum of squares for {points} points", "rad^2", objective, more.objective, 1e-8, test)
        yield Row(f"coupler for {points} points", "mm", coupler, more.design["coupler"] * 1e3, 1e-3, test)
    fewer = optlink.solve(problem.override({"requirement.span": "87 deg", "requirement.points": 29}), "both")
    test = "tests/test_docs.py::test_reference_values_agree"
    yield Row("sum of squares without the last of the 30 points", "rad^2", 0.00577, fewer.objective, 5e-6, test)
    yield from output_angles(problem)


def output_angles(problem: optlink.ProblemFile) -> Iterator[Row]:
    """Yield the rocker angle and its derivatives with respect to the four lengths at four crank angles."""
    sizes = {"crank": 1.0, "coupler": 4.12865417, "rocker": 2.3224617, "frame": 5.0}
    table = np.array(literal(CRANK_ROCKER, "SENSITIVITIES"))
    actual = output_sensitivity(problem.model.linkage, sizes, np.radians(table[:, 0]), "rocker")
    test = f"{CRANK_ROCKER}::test_output_angle_and_its_sensitivities"
    for k, (phi, psi, *slopes) in enumerate(table):
        yield Row(f"psi at {phi:.0f} deg", "deg", psi, math.degrees(actual.value[k]), 1e-6, test)
        for name, slope in zip(sizes, slopes, strict=True):
            yield Row(f"d psi / d {name} at {phi:.0f} deg", "rad per length", slope, actual.by[name][k], 1.5e-6, test)


# --- six-bar and shaper ----------------------------------------------------------------------------------------------------


@functools.cache
def cycle(name: str, speed: float | None = None) -> optlink.Analysis:
    """Return the analysis of a machine in steps of 15 degrees."""
    return optlink.analyze(optlink.load(name), step=math.radians(15.0), speed=speed)


def table_rows(actual: optlink.Analysis, file: str, names: dict[str, tuple[int, str]], test: str) -> Iterator[Row]:
    """Yield a row per column of a table: the position with the largest difference."""
    for name, target in columns(file).items():
        sign, ours = names[name]
        values = sign * actual[ours]
        scale = float(np.max(np.abs(target))) or 1.0
        worst = int(np.argmax(np.abs(values - target)))
        row = Row(
            f"{name}: `{ours}`, {len(target)} rows, position of the largest difference",
            _unit(ours),
            target[worst],
            values[worst],
            1e-9 * scale,
            test,
        )
        yield row


def _unit(column: str) -> str:
    for ending, unit in (("_rad_s2", "rad/s^2"), ("_rad_s", "rad/s"), ("_m_s2", "m/s^2"), ("_m_s", "m/s"), ("_rad", "rad")):
        if column.endswith(ending):
            return unit
    return {"Nm": "N·m", "deg": "deg", "m": "m", "N": "N", "J": "J", "s": "s"}[column.rpartition("_")[2]]


AT_62 = {
    "link2.angle_rad": 0.361152415429,
    "link3.angle_rad": 1.8101027425,
    "link5.angle_rad": -0.70452029398,
    "link2.omega_rad_s": -2.2344896487,
    "link3.omega_rad_s": 3.32515223805,
    "link5.omega_rad_s": 0.68962152575,
    "link2.alpha_rad_s2": 18.2547014994,
    "link3.alpha_rad_s2": 44.0308788324,
    "link5.alpha_rad_s2": 18.1261836966,
    "slider.s_m": 0.724683704184,
    "slider.v_m_s": -2.04833996839,
    "slider.a_m_s2": -18.4714133984,
    "A.fx_N": -991.838432025,
    "A.fy_N": -393.951498381,
    "B.fx_N": -980.571114518,
    "B.fy_N": -384.520756153,
    "C.link2.fx_N": 904.216375061,
    "C.link2.fy_N": 335.530131033,
    "C.link5.fx_N": -1201.90075934,
    "C.link5.fy_N": 976.432636377,
    "D.fx_N": -333.021111115,
    "D.fy_N": 1314.88600307,
    "E.fx_N": 1110.82848039,
    "E.fy_N": -971.649159835,
    "F.normal_N": -912.849159835,
    "input.torque_Nm": 275.212735066,
}
SIX_BAR_FIGURES = {
    "input.torque_Nm.max": 278.8344391,
    "input.torque_Nm.min": -320.0521365,
    "F.normal_N.max": -126.62251,
    "F.normal_N.min": -1159.270712,
    "slider.s_m.min": 0.417261753,
    "slider.s_m.max": 0.791165911,
    "slider.stroke_m": 0.3739041584796,
    "input.work_J.max": 259.773891,
}


def six_bar() -> Iterator[Row]:
    """Yield all columns at 62 degrees, extremes, work, and every column of the table."""
    actual = cycle("six-bar")
    for name, target in AT_62.items():
        near = 1e-9 * max(1.0, float(np.max(np.abs(actual[name]))))
        yield Row(
            f"`{name}` at 62 deg", _unit(name), target, float(actual[name][0]), near, f"{SIX_BAR}::test_every_column_agrees"
        )
    for name, target in SIX_BAR_FIGURES.items():
        unit = _unit(name.removesuffix(".min").removesuffix(".max"))
        yield Row(f"`{name}`", unit, target, actual.figures[name], 1e-6 * abs(target), f"{SIX_BAR}::test_extremes_and_stroke")
    test = f"{SIX_BAR}::test_where_the_extremes_are_met"
    torque, work = actual.extremes["input.torque_Nm"], actual.extremes["input.work_J"]
    for what, target, at in (
        ("crank angle of the largest torque", 67.0206, torque.largest_at),
        ("crank angle of the least torque", 356.3080, torque.least_at),
        ("crank angle of the largest work", 156.2980, work.largest_at),
        ("crank angle of the least work", 28.849, work.least_at),
    ):
        yield Row(what, "deg", target, math.degrees(at) % 360.0, 1e-3, test)
    test = f"{SIX_BAR}::test_least_work_against_the_sampled_one"
    yield Row("least work since the start (reference: least of the samples)", "J", -101.926927, work.least, 2.6e-4, test)
    yield Row(
        "work per revolution", "J", 0.0, actual.work, 1e-10, f"{SIX_BAR}::test_a_constant_force_does_no_work_in_a_revolution"
    )
    second = optlink.analyze(optlink.load("six-bar"), step=10.0 - 2.0 * math.pi)
    yield Row("work after 1 s", "J", 225.033, float(second["input.work_J"][1]), 1e-3, f"{SIX_BAR}::test_work_after_one_second")
    opposing = optlink.analyze(optlink.load("six-bar", {"loads.process.acts": "opposing"}))
    test = f"{SIX_BAR}::test_an_opposing_force_does"
    yield Row("work per revolution against an opposing load", "J", 747.808316959, opposing.work, 1e-6, test)
    names = {name: (1, ours) for name, ours in literal(SIX_BAR, "COLUMNS").items()}
    yield from table_rows(actual, "six_bar_15deg.csv", names, f"{SIX_BAR}::test_every_column_agrees")


AT_0 = {
    "rocker.angle_rad": math.radians(65.55604522),
    "coupler.angle_rad": math.radians(168.938215),
    "block.s_m": 0.3020761493,
    "rocker.omega_rad_s": 0.1712328767,
    "coupler.omega_rad_s": 0.2887921865,
    "rocker.alpha_rad_s2": 0.2477012572,
    "coupler.alpha_rad_s2": 0.2926632277,
    "ram.s_m": 0.1010686385,
    "ram.v_m_s": -0.1018422740,
    "ram.a_m_s2": -0.1387243160,
    "input.torque_Nm": 604.62396412,
}


def shaper() -> Iterator[Row]:
    """Yield limit positions, stroke, all columns at 0 degrees, extremes, work, and every column of both tables."""
    speeds = {"1 rad/s": (1.0, "shaper_1rad_15deg.csv"), "64 rpm": (64.0 * RPM, "shaper_64rpm_15deg.csv")}
    actual = {name: cycle("shaper", speed) for name, (speed, _) in speeds.items()}
    slow = actual["1 rad/s"]
    ram, rocker = slow.strokes["ram"], slow.swings["rocker"]
    test = f"{SHAPER}::test_limits_by_hand"
    yield Row("limit position of the ram", "mm", 128.316712718, ram.high * 1e3, 1e-8, test)
    yield Row("limit position of the ram", "mm", -417.137832736, ram.low * 1e3, 1e-8, test)
    yield Row("stroke", "mm", 545.454545454545, ram.span * 1e3, 1e-9, test)
    yield Row("limit position of the rocker", "deg", 62.96430821, math.degrees(rocker.low), 1e-7, test)
    yield Row("limit position of the rocker", "deg", 117.0356918, math.degrees(rocker.high), 1e-6, test)
    yield Row("time ratio", "", 1.85876244996, float(ram.time_ratio or math.nan), 1e-10, f"{SHAPER}::test_time_ratio_by_hand")
    test = f"{SHAPER}::test_source_limits_and_stroke"
    yield Row("stroke, printed (ADAMS)", "mm", 545.4, ram.span * 1e3, 0.1, test)
    yield Row("limit position of the ram, printed (ADAMS)", "mm", 128.1, ram.high * 1e3, 0.25, test)
    yield Row("limit position of the ram, printed (ADAMS)", "mm", -417.3, ram.low * 1e3, 0.25, test)
    for name, target in AT_0.items():
        near = 1e-8 * max(1.0, abs(target))
        yield Row(
            f"`{name}` at 0 deg, 1 rad/s", _unit(name), target, float(slow[name][0]), near, f"{SHAPER}::test_every_column_agrees"
        )
    for case, figures in literal(SHAPER, "EXTREMES").items():
        for name, target in figures.items():
            unit = _unit(name.removesuffix(".min").removesuffix(".max"))
            ours = actual[case].figures[name]
            yield Row(f"`{name}`, {case}", unit, target, ours, 1e-6 * abs(target), f"{SHAPER}::test_extremes")
    torque = slow.extremes["input.torque_Nm"]
    test = f"{SHAPER}::test_where_the_torque_is_extreme"
    yield Row("crank angle of the largest torque, 1 rad/s", "deg", 96.8944, math.degrees(torque.largest_at), 1e-3, test)
    yield Row("crank angle of the least torque, 1 rad/s", "deg", 288.463, math.degrees(torque.least_at), 1e-3, test)
    for case, analysis in actual.items():
        test = f"{SHAPER}::test_work_per_revolution_is_that_of_the_cut"
        yield Row(f"work per revolution, {case}", "J", 3207.27272727, analysis.work, 1e-7, test)
    for case, (_, file) in speeds.items():
        for row in table_rows(actual[case], file, literal(SHAPER, "COLUMNS"), f"{SHAPER}::test_every_column_agrees"):
            yield Row(f"{row.what}, {case}", row.unit, row.target, row.actual, row.near, row.test)


# --- slider-cranks -----------------------------------------------------------------------------------------------------


def under_a_torque() -> Iterator[Row]:
    """Yield angle and speed of the slider-crank that a constant torque drives from rest."""
    actual = optlink.simulate(optlink.load("slider-crank"), rows=2)
    test = "tests/dynamics/test_forward.py::test_slider_crank_under_a_torque_reaches_the_reference"
    yield Row("crank angle after 2 s", "rad", 55.0724438, actual.figures["end.crank_angle_rad"], 1e-7, test)
    yield Row("crank speed after 2 s", "rad/s", 39.79557704, actual.figures["end.speed_rad_s"], 1e-7, test)


@functools.cache
def clearance_run(rpm: int, revolutions: int, friction: float, tolerance: float) -> Any:
    """Return the motion of the slider-crank with clearance in steps of 5 degrees, at a speed of the crank.

    Parameters
    ----------
    rpm, revolutions : int
    friction, tolerance : float
    """
    problem = optlink.load("slider-crank-clearance", {"joints.C.friction": friction})
    sure = False
    return optlink.control.simulate_clearance(problem, revolutions, 72, rpm * RPM, tolerance=tolerance, check_predictability=sure)


def first_impacts() -> Iterator[Row]:
    """Yield the first contact after a start with centred journal, without friction, at four speeds."""
    test = f"{CLEARANCE}::test_first_impact_to_the_digits_that_were_noted"
    for rpm, target in literal(CLEARANCE, "IMPACTS").items():
        one = clearance_run(rpm, 1, 0.0, 1e-12).impacts[0]
        actual = (one.begin, math.degrees(one.crank_angle), one.approach, one.penetration, one.end, one.departure)
        names = ("start", "crank angle", "approach velocity", "largest penetration", "end", "separation velocity")
        units = ("s", "deg", "m/s", "m", "s", "m/s")
        for what, unit, number, ours in zip(names, units, target, actual, strict=True):
            yield Row(f"first contact at {rpm} rpm: {what}", unit, number, ours, 3e-9 * number, test)


def deviations() -> Iterator[Row]:
    """Yield the rms deviation of the slider with friction over revolutions 6 to 25, and all columns of revolution 11."""
    names = literal(CLEARANCE, "COLUMNS")
    for rpm, target in literal(CLEARANCE, "RMS").items():
        run = clearance_run(rpm, 25, 0.1, 1e-11)
        test = f"{CLEARANCE}::test_deviation_over_twenty_revolutions"
        yield Row(f"rms deviation at {rpm} rpm", "mm", target * 1e3, run.figures["rms_m"] * 1e3, target, test)
        table = columns(f"clearance_mu01_{rpm}rpm.csv")
        rows = 719 + np.arange(73)
        for name, (ours, near) in names.items():
            values = run[ours][rows]
            worst = int(np.argmax(np.abs(values - table[name])))
            yield Row(
                f"revolution 11 at {rpm} rpm: `{ours}`, 73 rows, position of the largest difference",
                _unit(ours),
                table[name][worst],
                values[worst],
                near,
                f"{CLEARANCE}::test_revolution_eleven",
            )


# --- balancing -----------------------------------------------------------------------------------------------------------


def balance() -> Iterator[Row]:
    """Yield the figures of Berkof and Lowen's four-bar without counterweights, with one, and with two."""
    problem = optlink.load("balance-four-bar")
    both = optlink.balance(problem)
    given = {row.measure.words: row.before for row in both.rows}
    test = f"{BALANCE}::test_the_given_machine"
    yield Row("rms shaking force, unbalanced", "N", 0.01102811, given["rms shaking force"], 1.2e-8, test)
    force = optlink.analyze(problem, 3600)
    largest = float(np.max(np.hypot(force["frame.shaking_fx_N"], force["frame.shaking_fy_N"])))
    yield Row("largest shaking force, unbalanced", "N", 0.02513242, largest, 2.6e-8, test)
    one = {"body": "crank", "thickness": "10 mm", "density": "7850 kg/m^3", "reach": "60 mm"}
    alone = optlink.balance(optlink.load("balance-four-bar", {"balance.counterweights": [one]}))
    (disc,) = alone.added
    test = f"{BALANCE}::test_one_counterweight_on_the_crank"
    yield Row("rms shaking force, one counterweight", "N", 0.007391318, alone.objective, 7.4e-9, test)
    yield Row("ratio to the unbalanced force, one counterweight", "", 0.670225, alone.objective / alone.before, 7e-7, test)
    yield Row("added mass-radius product along the crank", "kg·m", -0.0080645, disc.parameters.along, 8.1e-9, test)
    yield Row("added mass-radius product across the crank", "kg·m", 0.00139695, disc.parameters.across, 5e-9, test)
    test = f"{BALANCE}::test_complete_balance"
    added = {part.body: part.parameters for part in both.added}
    yield Row("rms shaking force, two counterweights", "N", 0.0, both.objective, 1e-10 * both.before, test)
    yield Row("added mass-radius product along the crank", "kg·m", -0.00516128, added["crank"].along, 5.2e-12, test)
    yield Row("added mass-radius product along the rocker", "kg·m", -0.00870966, added["rocker"].along, 8.8e-12, test)


# --- synthesis, and expected figures of the shipped machines --------------------------------------------------------------


def solved(name: str) -> Any:
    """Return the solution of a shipped problem.

    Parameters
    ----------
    name : str
    """
    return optlink.solve(optlink.load(name))


def synthesis() -> Iterator[Row]:
    """Yield results of the shipped problems that are solved in seconds, with the best known values."""
    test = f"{PROBLEMS}::test_best_known_objective_is_reached_or_beaten"
    arc = solved("path-arc5")
    yield Row("`path-arc5`, sum of squares", "mm^2", 7.4158e-7, arc.objective * 1e6, 1e-11, test)
    closed = solved("path-closed18")
    yield Row("`path-closed18`, sum of squares", "mm^2", 0.0090288846, closed.objective * 1e6, 1e-8, test)
    best = solved("transmission-optimal").best
    for name, length in (("crank", 46.67), ("coupler", 116.16), ("rocker", 73.88)):
        yield Row(f"`transmission-optimal`, {name}", "mm", length, best.values[name] * 1e3, 5e-3, test)
    angle = 90.0 - math.degrees(math.asin(best.objective))
    yield Row("`transmission-optimal`, worst angle", "deg", 37.733, angle, 5e-4, test)
    test = "tests/tasks/test_stroke_problems.py::test_{}_is_the_best_of_its_family"
    for name, known in (("crank-rocker", 40.671312175), ("slider-crank", 47.201069622)):
        angle = 90.0 - math.degrees(solved(f"stroke-{name}").objective)
        yield Row(f"`stroke-{name}`, worst angle", "deg", known, angle, 1e-8, test.format(name.replace("-", "_")))
    test = f"{PROBLEMS}::test_expected_design_is_reached"
    for name, known in (("log10", 0.003676), ("sin", 0.190337), ("exp", 0.025865)):
        actual = math.degrees(solved(f"function-{name}").objective)
        yield Row(f"`function-{name}`, largest error", "deg", known, actual, 2e-3 * known, test)


def machines() -> Iterator[Row]:
    """Yield the figures in `[expected]` of the shipped machines, from closed forms and independent equations."""
    test = f"{PROBLEMS}::test_expected_figures_are_reached"
    for name in optlink.shipped():
        problem = optlink.load(name)
        expected = problem.model.expected
        if expected is None or not expected.figures or name in ("six-bar", "shaper"):
            continue
        figures = cycle(name).figures
        for figure, target in expected.figures.items():
            near = max(expected.figure_tolerance * abs(target), 1e-9)
            yield Row(f"`{name}`: `{figure}`", "SI", target, figures[figure], near, test)


GROUPS = (
    Group(
        "Crank-rocker for a motion law",
        "Textbook case. Reference values: SciPy SLSQP with exact derivatives, IPOPT, Octave `sqp` and a grid; angles and "
        "derivatives in closed form. [Description](crank-rocker.md)",
        crank_rocker,
    ),
    Group(
        "Six-bar",
        "Machine of a Simulink tutorial. Reference values: Newton-Euler equations with 40 digits, confirmed by virtual power "
        "(difference 5e-41) and by an independent multibody code (2.4e-6). [Description](six-bar.md)",
        six_bar,
    ),
    Group(
        "Shaper",
        "Machine of a journal paper with an ADAMS model. Reference values: limit positions, stroke and time ratio in closed "
        "form, the others by Newton-Euler equations with 40 digits. [Description](shaper.md)",
        shaper,
    ),
    Group(
        "Slider-crank under a constant torque",
        "Crank 0.1 m, rod 0.3 m, uniform bars of 0.2 kg, slider 0.4 kg; 0.1 N·m from rest. Reference values: an independent "
        "integration.",
        under_a_torque,
    ),
    Group(
        "Slider-crank with clearance: first contacts",
        "No friction. Reference values: two integrators (difference 1e-13 in time, 1.5e-11 in penetration), confirmed by an "
        "independent multibody code (5e-7 and 2.6e-5). [Description](slider-crank.md)",
        first_impacts,
    ),
    Group(
        "Slider-crank with clearance: periodic motion",
        "Friction coefficient 0.1. Reference values: the same integrators. [Description](slider-crank.md)",
        deviations,
    ),
    Group(
        "Balancing",
        "Four-bar of R. S. Berkof, G. G. Lowen, J. Eng. Ind. 91(1), 1969, 21-26. Reference values: computed in complex "
        "numbers. [Balancing](balancing.md)",
        balance,
    ),
    Group(
        "Path, function and transmission",
        "Reference values: large multistart searches outside optlink, an independent design tool for the transmission, and "
        "dead-centre synthesis for strokes. "
        "The errors of the functions are slightly smaller than the references. [Synthesis](synthesis.md)",
        synthesis,
    ),
    Group(
        "Other shipped machines",
        "Reference values: closed-form loops, virtual power, the law of cosines and Newton-Euler equations; each problem file "
        "names its own. SI units.",
        machines,
    ),
)


# --- the page ------------------------------------------------------------------------------------------------------------


def page() -> str:
    """Return all tables as Markdown.

    Raises
    ------
    ValueError
        if a figure differs from its reference by more than its tolerance.
    """
    parts, count = [], 0
    for group in GROUPS:
        rows = list(group.rows())
        wrong = [row for row in rows if not row.holds]
        if wrong:
            raise ValueError(f"{group.title}: {wrong[0].what} is {wrong[0].actual!r}, the reference says {wrong[0].target!r}")
        count += len(rows)
        parts.append(_section(group, rows))
    return f"{count} figures are compared.\n\n" + "\n\n".join(parts)


def _section(group: Group, rows: list[Row]) -> str:
    lines = [f"## {group.title}", "", group.source, ""]
    lines += ["| figure | reference | optlink | difference | test |", "|---|---|---|---|---|"]
    for row in rows:
        target, actual = _number(row.target), _number(row.actual, _digits(row.target))
        unit = f" {row.unit}" if row.unit and row.unit != "SI" else ""
        lines.append(f"| {row.what} | {target}{unit} | {actual}{unit} | {_off(row)} | {_link(row.test)} |")
    return "\n".join(lines)


def _number(value: float, digits: int = 15) -> str:
    return f"{value:.{digits}g}"


def _digits(value: float) -> int:
    """Return the number of significant digits of a number as it is written."""
    return max(4, len(repr(float(f"{value:.15g}")).partition("e")[0].lstrip("-0.").replace(".", "")))


def _off(row: Row) -> str:
    """Return the difference with one digit."""
    share, _, power = f"{abs(row.off):.0e}".partition("e")
    return f"{share}e{int(power)}" if row.off else "0"


def _link(test: str) -> str:
    file, _, name = test.partition("::")
    return f"[{name.removeprefix('test_').replace('_', ' ')}](../{file})"
