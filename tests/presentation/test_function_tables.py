"""Wording and figures of the tables of a synthesis result."""

from __future__ import annotations

import ast
import io
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

import optlink
from optlink.presentation import terminal
from optlink.presentation.chart_spec import ChartSpec
from optlink.presentation.format import change, dimension, figure, fixed, number, pretty, price_step, significant
from optlink.presentation.registry import table_of
from optlink.presentation.table_spec import Part, Summary
from optlink.presentation.views import conclusions, design, problem_tables
from optlink.presentation.views.search_tables import active, conflict
from optlink.problem.machine.model import ShownObjective
from optlink.solvers.solution import LimitState, Relaxation
from optlink.tasks.design import validate, validate as validate_path
from optlink.tasks.results.common import Optimum, evidence
from optlink.tasks.results.conflict import refutation


def words(shown: Summary | Part) -> str:
    """The words of a wide screen."""
    console = Console(file=io.StringIO(), width=300, record=True)
    console.print(terminal.rendered(shown))
    return " ".join(console.export_text().split())


def shown(result: optlink.SynthesisResult) -> str:
    return words(table_of(result.kind)(result))


def functions(result: optlink.SynthesisResult) -> list[ChartSpec]:
    """The charts of y(x)."""
    return [chart for chart in design.charts(result) if chart.file == "function"]


@pytest.mark.parametrize(
    ("value", "text"),
    [(412.8654, "412.865"), (1.0, "1.000"), (0.08733787, "0.0873379"), (-0.02, "-0.02"), (0.0, "0.000"), (-1e-9, "0.000")],
)
def test_a_dimension_of_a_small_linkage_keeps_its_digits(value: float, text: str) -> None:
    assert dimension(value) == text


def test_the_table_of_a_small_linkage_is_its_design() -> None:
    lengths = {"crank": "20 um", "coupler": "87.3379 um", "rocker": "45 um", "frame": "80 um"}
    small = optlink.load("crank-rocker").override({f"mechanism.{name}": value for name, value in lengths.items()})
    text = shown(validate(small, {}))
    assert "coupler 0.0873379 mm" in text
    assert "crank 0.0200000 mm" in text


def test_distinct_optima_have_the_units_of_the_objective_and_of_the_design_variables() -> None:
    """Their objective is that of the head: a pressure angle in deg, not in rad."""
    result = optlink.solve(optlink.load("stroke-slider-crank"), starts=3)
    optima = next(part for part in table_of("design")(result).parts if getattr(part, "title", "").startswith("Distinct optima"))
    assert [column.name for column in optima.columns[:3]] == ["objective [deg]", "crank.length [mm]", "rod.length [mm]"]
    assert number(np.degrees(result.objective), 8) in words(optima)


@pytest.mark.parametrize(
    ("name", "changes", "there", "not_there"),
    [
        ("function-sin", {}, ("psi0 free, -360 deg ... 360 deg", "span 90 deg"), ("outer dead centre", "that of the table")),
        ("path-bean", {}, ("timing free",), ("law", "span that", "psi0", "mark")),
        ("law-six-bar", {}, ("span 180 deg", "its 13 rows"), ("length_margin", "swing_angle", "timing", "psi0")),
        ("law-slider-crank", {}, ("points 30", "span 90 deg"), ("link_ratio",)),
        ("transmission-optimal", {}, ("measure max",), ("points", "timing")),
        ("path-bean", {"limits.pivots": {"x": ["-9 mm", "80 mm"]}}, ("pivots x -9 mm ... 80 mm, any y",), ("table:",)),
    ],
)
def test_a_problem_is_shown_with_the_keys_and_defaults_of_its_kind(
    name: str, changes: dict[str, object], there: tuple[str, ...], not_there: tuple[str, ...]
) -> None:
    shown = words(problem_tables.problem(optlink.load(name, changes))).partition("[requirement]")[2].partition("[expected]")[0]
    assert [text for text in there if text not in shown] == []
    assert [text for text in not_there if f" {text} " in shown] == []


def test_moments_of_inertia_have_the_product_dot_of_torques() -> None:
    parts = problem_tables.problem(optlink.load("six-bar")).parts
    bodies = next(part for part in parts if getattr(part, "title", "") == "[bodies]")
    assert [column.name for column in bodies.columns][-1] == "inertia [kg·m^2]"
    assert pretty("0.012 kg*m^2 + 1 %, 3 N*m per kg*m^2") == "0.012 kg·m² + 1 %, 3 N·m per kg·m²"


def test_unknown_iterations_of_a_stored_result_are_not_zero(solved: optlink.SynthesisResult) -> None:
    assert solved.solution is not None
    assert f"{solved.solution.iterations} iterations" in shown(solved)
    assert " iterations" not in shown(
        replace(solved, designs=(replace(solved.best, solution=replace(solved.solution, iterations=0)),))
    )


def test_a_multistart_search_is_not_recommended_after_one(solved: optlink.SynthesisResult) -> None:
    """The counts of the table and of the text above it agree: what the table leaves out is stated."""
    solved = replace(solved, certificate=None)
    assert "use --starts N" in shown(solved)
    many = replace(solved, starts=20, evidence=evidence((12, 2)), optima=(Optimum(solved.design, solved.objective, 18),))
    text = shown(many)
    assert "use --starts N" not in text
    assert "12 of 20 starts reached the best value" in text
    assert "of all 20 starting points, random and given; 2 of them ended at worse optima that are not listed, or at none" in text
    complete = replace(many, optima=(*many.optima, Optimum(solved.design, 1.0, 2)))
    assert "not listed" not in shown(complete)


@pytest.mark.parametrize(
    ("bound", "unit", "share", "step"),
    [
        (135.0, "deg", 0.02, "deg"),
        (0.02, "N m", 53.1687, "0.001 N m"),
        (0.4, "N m", 0.5, "0.01 N m"),
        (3.0, "mm", 0.0, "0.1 mm"),
        (60.0, "N", 0.0, "N"),
        (20_000.0, "N", 1e-5, "10 N"),
        (1.2, "", 3.0, "0.01"),
        (0.05, "", 3.0, "0.001"),
        (45.0, "deg", 7.0, "0.1 deg"),
        (0.0, "mm", 30.0, "0.01 mm"),
        (0.0, "mm", 1e12, "0.001 mm"),  # of an objective of zero no share is stated
        (-0.5, "m", 0.0, "0.01 m"),
    ],
)
def test_a_price_refers_to_a_step_that_suits_its_bound(bound: float, unit: str, share: float, step: str) -> None:
    size, words_of_step = price_step(unit, bound, share)
    assert words_of_step == step
    assert f"{size:g}" == (step.split()[0] if step[0].isdigit() else "1")
    assert share > 1e6 or share * size <= 1.0
    limit = LimitState("key", "peak torque", bound, bound, "<=", unit, True, -share, 0.0)
    model = SimpleNamespace(shown_objective=lambda objective: ShownObjective(objective, 1.0, "mm^2"))
    text = words(active(model, 1.0, [limit]))
    assert (f"per {pretty(step)} ({100.0 * share * size:.2f} %)" in text) is (0.0 < share < 1e6 and share * size >= 5e-5)
    assert ("%" in text) is (0.0 < share < 1e6 and share * size >= 5e-5)


def test_the_price_of_an_equality_has_its_sign() -> None:
    """An inequality has one direction that relaxes it, an equality has two; a limit without a price has no effect."""

    def limit(sense: str, multiplier: float) -> LimitState:
        return LimitState("key", "time ratio", 1.6, 1.6, sense, "", True, multiplier, 0.0)

    def priced(*limits: LimitState, size: float = 1.0) -> str:
        model = SimpleNamespace(shown_objective=lambda objective: ShownObjective(size * objective, size, "N"))
        return words(active(model, 100.0 / size, limits))

    rising, falling = priced(limit("=", 5.0)), priced(limit("=", -5.0))
    assert "= 1.6 +0.05 N per 0.01 (0.05 %) =: change of the objective if the value is raised by that much" in rising
    assert "= 1.6 -0.05 N per 0.01" in falling
    assert "= 1.6 -0.05 N per 0.01 (0.05 %)" in priced(limit("=", 5.0), size=-1.0)  # of a maximised force
    assert "= 1.6 +50 N per 0.01 (50.00 %)" in priced(limit("=", 5.0), size=1e3)
    relaxed = priced(limit("<=", -5.0))
    assert "<= 1.6 0.05 N per 0.01" in relaxed
    assert "raised" not in relaxed
    none = priced(limit("=", 0.0), limit(">=", 0.0))
    assert none.count("no effect") == 2
    assert "nothing" not in none


@pytest.mark.parametrize(
    ("value", "text"),
    [(5e-8, "0.000"), (-5e-8, "0.000"), (0.0, "0.000"), (1.2e-5, "0.0000120000"), (62.75446, "62.7545"), (123.8444, "123.844")],
)
def test_dimensions_below_the_resolution_are_zero(value: float, text: str) -> None:
    assert significant(value) == text


@pytest.mark.parametrize(("share", "text"), [(-1e-6, "0.00 %"), (0.0, "0.00 %"), (-0.01648, "-1.65 %"), (0.0308, "+3.08 %")])
def test_no_change_has_no_sign(share: float, text: str) -> None:
    assert change(share) == text


def signed_zeros(source: str) -> list[str]:
    """Format specifications with fixed decimals that print a negative zero: those without the option z."""
    fields = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FormattedValue)]
    specs = [ast.unparse(node.format_spec)[2:-1] for node in fields if isinstance(node.format_spec, ast.JoinedStr)]
    return [spec for spec in specs if spec.endswith(("f", "%")) and "z" not in spec]


@pytest.mark.slow
def test_no_number_with_fixed_decimals_is_a_negative_zero() -> None:
    assert signed_zeros('f"{x:+.1%} {x:.{n}f} {x:+z.1f} {x:.3g}"') == ["+.1%", ".{n}f"]
    package = Path(optlink.__file__).parent
    computed = {str(path): specs for path in package.rglob("*.py") if (specs := signed_zeros(path.read_text(encoding="utf-8")))}
    assert computed == {}
    assert (fixed(-4e-4, 3), fixed(-6e-4, 3), figure(-0.0, "mm")) == ("0.000", "-0.001", "0 mm")


def test_a_relaxed_limit_without_a_unit_has_one_space_before_its_difference() -> None:
    limit = Relaxation("time ratio", "limits.time_ratio", "<=", 1.0, 1.009778, 0.009778, "")
    console = terminal.console()
    with console.capture() as caught:
        console.print(terminal.rendered(conflict([limit], [])))
    assert "<= 1.00978 (0.009778)" in caught.get()


def test_a_conflicting_single_value_limit_is_explained_as_exact() -> None:
    """As one writes it who means the least transmission angle: `transmission_angle = "40 deg"`."""
    key, names = "limits.transmission_angle", ("smallest transmission angle", "largest transmission angle")
    pairs = zip(names, (">=", "<="), (31.67, 48.33), strict=True)
    exact = [Relaxation(name, key, sense, 40.0, end, 8.33, "deg", both_sides=True) for name, sense, end in pairs]
    hint = 'A single value is exact: write ">= 40 deg" for the smallest or "<= 40 deg" for the largest transmission angle.'
    shown = " ".join(words(conflict(exact, [])).split())
    assert "exactly 40 deg" in shown
    assert hint in shown
    assert refutation(exact).startswith("No such linkage: exactly 40 deg of transmission angle cannot be met")
    apart = [exact[0], replace(exact[1], bound=50.0)]
    assert "40 ... 50 deg" in words(conflict(apart, []))
    assert "exact" not in refutation(apart)


def test_the_generated_function_is_that_of_the_linkage() -> None:
    """y of the chart from the rocker angle at every x; the error of the lower panel is in y."""
    sizes = {"crank": 0.123844, "coupler": 0.062754, "rocker": 0.129321, "frame": 0.06}
    raw = {
        "title": "square root",
        "mechanism": {"type": "four-bar", "assembly": "right"} | {name: f"{1e3 * size} mm" for name, size in sizes.items()},
        "requirement": {
            "kind": "function",
            "from": "43.896 deg",
            "psi0": "97.168 deg",
            "law": {"function": "sqrt(x)", "x": [0.1, 1.0], "input": "70 deg", "output": "60 deg"},
        },
        "limits": {"crank": "span"},
    }
    result = validate(optlink.read(raw), {})
    (chart,) = functions(result)
    (target, generated), (error,) = chart.panels[0].traces, chart.panels[1].traces
    phi = np.radians(43.896 + 70.0 * (generated.x - 0.1) / 0.9)
    psi = np.degrees(optlink.linkage.sweep(result.problem.spec.linkage, sizes, phi).body_angle("rocker").value)
    low = np.sqrt(0.1)
    np.testing.assert_allclose(generated.y, low + (psi - 97.168) / 60.0 * (1.0 - low), atol=1e-9)
    np.testing.assert_allclose(target.y, np.sqrt(target.x), atol=1e-12)
    np.testing.assert_allclose(error.y, generated.y - target.y, atol=1e-12)


def test_a_function_of_a_slider_has_the_chart_too() -> None:
    """y of the chart by the law of cosines; the same slider as a law of the crank angle has no such chart."""
    crank, rod, offset = 30.0, 120.0, -20.0
    law = {"function": "x^2", "x": [1.0, 3.0], "input": "50 deg", "output": "30 mm"}
    raw = {
        "title": "square",
        "mechanism": {
            "type": "dyads",
            "ground": {"A": ["0 mm", "0 mm"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": f"{crank} mm"},
                "rod": {"joints": ["B", "C"], "length": f"{rod} mm"},
                "ram": {"joints": ["C"]},
            },
            "guides": {"G": {"slider": "ram", "through": "A", "direction": "0 deg", "offset": f"{offset} mm"}},
            "assembly": {"C": "forward"},
        },
        "requirement": {"kind": "function", "output": "G", "start": "-120 deg", "zero": "95 mm", "law": law},
    }
    result = validate_path(optlink.read(raw), {})
    (chart,) = functions(result)
    (target, generated), (error,) = chart.panels[0].traces, chart.panels[1].traces
    phi = np.radians(-120.0 + 50.0 * (generated.x - 1.0) / 2.0)
    place = crank * np.cos(phi) + np.sqrt(rod**2 - (offset - crank * np.sin(phi)) ** 2)
    np.testing.assert_allclose(generated.y, 1.0 + (place - 95.0) / 30.0 * 8.0, atol=1e-9)
    np.testing.assert_allclose(target.y, target.x**2, atol=1e-12)
    np.testing.assert_allclose(error.y, generated.y - target.y, atol=1e-12)
    turned = {"slide": "s0 + 40*(1 - cos(phi - phi0))", "unit": "mm"}
    other = optlink.read({**raw, "requirement": {**raw["requirement"], "law": turned, "span": "50 deg"}})
    assert functions(validate_path(other, {})) == []


def test_a_law_of_the_crank_angle_has_no_chart_in_x_and_y(solved: optlink.SynthesisResult) -> None:
    assert functions(solved) == []


def test_a_larger_error_between_the_positions_is_shown() -> None:
    law = {"requirement.law": "psi0 + 0.35*(phi - phi0)", "requirement.from": {"bounds": ["0 deg", "360 deg"]}}
    file = optlink.load("crank-rocker").override({**law, "requirement.points": 3})
    result = optlink.validate(file, {"coupler": 0.45, "rocker": 0.25, "phi0": 1.0})
    crank, coupler, rocker, frame, phi0, psi0 = (
        result.design[name] for name in ("crank", "coupler", "rocker", "frame", "phi0", "psi0")
    )
    turn = np.linspace(0.0, np.pi / 2.0, 9001)
    diagonal = frame - crank * np.exp(1j * (phi0 + turn))
    reach = np.arccos((coupler**2 + np.abs(diagonal) ** 2 - rocker**2) / (2.0 * coupler * np.abs(diagonal)))
    angle = np.angle(coupler * np.exp(1j * (np.angle(diagonal) + reach)) - diagonal)
    largest = np.degrees(np.max(np.abs(psi0 + 0.35 * turn - angle)))
    at = np.degrees(np.max(np.abs(result.error())))
    assert largest > 1.01 * at
    text = f"largest {number(at, 4)} deg at the positions, {number(largest, 4)} deg between them"
    assert text in shown(result)
    assert f"{figure(largest, 'deg')} between them" in conclusions.design(result, ())
    assert optlink.validate(optlink.load("crank-rocker"), {"coupler": 0.412865, "rocker": 0.232246}).best.largest_between is None


@pytest.mark.slow
def test_the_headline_of_a_largest_error_and_its_prices_have_one_unit() -> None:
    """Of a law and of its limits: solved again with a limit that is 0.01 deg wider."""
    file = optlink.load("crank-rocker", {"requirement.measure": "max", "limits.transmission_angle": ["45 deg", "130 deg"]})
    result = optlink.solve(file)
    text = " ".join(words(table_of("design")(result)).split())
    assert f"largest error {math.degrees(result.objective):.6g} deg" in text
    assert not re.search(r"\brad\b", text)
    wider = optlink.solve(file.override({"limits.transmission_angle": ["45 deg", "130.01 deg"]}))
    price = 100.0 * math.degrees(result.objective - wider.objective)
    (stated,) = re.findall(r"largest transmission angle <= 130 deg ([\d.]+) deg per deg", text)
    assert float(stated) == pytest.approx(price, rel=1e-3)
