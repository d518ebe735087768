"""Motion laws of any linkage of dyads, as expressions and as tables, judged by closed forms of slider-crank and four-bar."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

import numpy as np
import pytest

import optlink
from optlink.tasks.design import solve
from tests.solved import solution
from tests.tiers import mostly_slow

SPAN, POINTS = 0.5 * math.pi, 30
QUARTER = [f"{3.0 * k!r} deg" for k in range(POINTS + 1)]
ADVANCE = [f"{-40.0 * k / POINTS!r} mm" for k in range(POINTS + 1)]
SIX_BAR = {"slide": "s0 + 300*(phi - phi0)/pi", "unit": "mm"}


def slider_crank(**requirement: object) -> optlink.ProblemFile:
    changes = {f"requirement.{key}": value for key, value in requirement.items()}
    return optlink.load("law-slider-crank").override(changes)


def slides(design: Mapping[str, float], angles: np.ndarray) -> np.ndarray:
    """Slide [m] of the pin of a slider-crank along +x, by Pythagoras."""
    height = design["G.offset"] - design["crank.length"] * np.sin(angles)
    return design["crank.length"] * np.cos(angles) + np.sqrt(design["rod.length"] ** 2 - height**2)


@pytest.mark.parametrize(
    ("law", "backend"),
    mostly_slow(
        itertools.product(("expression", "table", "csv"), ("ipopt", "slsqp")),
        ("table", "slsqp"),
    ),
)
def test_slider_crank_follows_a_law(law: str, backend: str, tmp_path) -> None:
    """The objective is the closed form's, whatever way the law is stated, and both back ends agree."""
    file = slider_crank()
    if law == "table":
        file = slider_crank(law={"phi": QUARTER, "s": ADVANCE}, span=None, points=None)
    if law == "csv":
        rows = "".join(f"{3.0 * k!r},{-40.0 * k / POINTS!r}\n" for k in range(POINTS + 1))
        (tmp_path / "law.csv").write_text(f"phi_deg,s_mm\n{rows}")
        requirement = {"kind": "function", "output": "G", "law": {"csv": "law.csv"}}
        file = optlink.read({**slider_crank().raw, "requirement": requirement}, folder=tmp_path)
    result = solve(file, backend)
    assert result.valid
    design, best = result.design, result.best
    offsets = np.linspace(0.0, SPAN, POINTS + 1)
    error = slides(design, design["start"] + offsets) - (design["zero"] - 0.04 * offsets / SPAN)
    assert result.objective == pytest.approx(float(np.sum(error**2)), rel=1e-9)
    assert result.objective == pytest.approx(optlink.load("law-slider-crank").model.expected.objective, rel=1e-6)
    np.testing.assert_allclose(best.measured.distances, np.abs(error), atol=1e-12)


@pytest.mark.slow
def test_a_nearly_exact_largest_error_is_minimised_too() -> None:
    """A table rounded to 1e-4 mm: no worse than the linkage that it was computed from, with the best s0 (it was 26 % worse)."""
    original = {"crank.length": 0.0427, "rod.length": 0.177, "G.offset": 0.0004}
    offsets = np.linspace(0.0, 3.0, 20)
    slide = slides(original, 0.317 + offsets)
    table = np.round((slide - slide[0]) * 1e3, 4)
    law = {"phi": [f"{x!r} rad" for x in offsets.tolist()], "s": [f"{x!r} mm" for x in table.tolist()]}
    result = solve(slider_crank(law=law, span=None, points=None, measure="max"), starts=60)
    error = slide - slide[0] - 1e-3 * table
    assert result.valid
    assert result.objective <= 0.5 * np.ptp(error)


@pytest.mark.slow
def test_six_bar_follows_a_law() -> None:
    """Both back ends find the same, and an expression at the rows of the table is the same problem."""
    table = optlink.load("law-six-bar")
    expression = table.override({"requirement.law": SIX_BAR, "requirement.span": "180 deg", "requirement.points": 12})
    computed = [solution("law-six-bar"), solve(table, "slsqp", designs=1), solve(expression, designs=1)]
    assert all(result.valid for result in computed)
    assert [result.objective for result in computed[:2]] == pytest.approx([table.model.expected.objective] * 2, rel=1e-6)
    assert [result.objective for result in computed[1:]] == pytest.approx([computed[0].objective] * 2, rel=1e-7)


LINKS = {
    "type": "dyads",
    "ground": {"A": ["0 mm", "0 mm"], "D": ["100 mm", "0 mm"]},
    "links": {
        "crank": {"joints": ["A", "B"], "length": {"start": "30 mm", "bounds": ["10 mm", "200 mm"]}},
        "coupler": {"joints": ["B", "C"], "length": {"start": "80 mm", "bounds": ["10 mm", "300 mm"]}},
        "rocker": {"joints": ["D", "C"], "length": {"start": "70 mm", "bounds": ["10 mm", "300 mm"]}},
    },
    "assembly": {"C": "left of B-D"},
}
FOUR_BAR = {
    "type": "four-bar",
    "frame": "100 mm",
    **{name: LINKS["links"][name]["length"] for name in ("crank", "coupler", "rocker")},
}
LIMITS = {"transmission_angle": ["30 deg", "150 deg"]}
SWINGS = "psi0 + 0.5*sin(phi - phi0)"


@pytest.mark.slow
def test_rocker_of_dyads_follows_a_law_as_that_of_a_four_bar() -> None:
    """The same law for a linkage stated in lengths, by another programme and another search."""
    anywhere = {"start": "40 deg", "bounds": ["-180 deg", "180 deg"]}
    task = {"law": SWINGS, "span": "120 deg", "points": 24}
    dyads = optlink.read({"title": "t", "mechanism": LINKS, "requirement": {**task, "output": "rocker"}, "limits": LIMITS})
    stated = {**task, "from": anywhere, "psi0": {**anywhere, "start": "80 deg"}}
    four_bar = optlink.read({"title": "t", "mechanism": FOUR_BAR, "requirement": stated, "limits": LIMITS})
    one, other = solve(dyads), optlink.solve(four_bar, starts=60)
    assert one.valid
    assert other.valid
    assert one.objective == pytest.approx(other.objective, rel=1e-6)
    sizes = {name: one.design[f"{name}.length"] for name in ("crank", "coupler", "rocker")}
    again = optlink.validate(four_bar, {**sizes, "phi0": one.design["start"], "psi0": one.design["zero"]})
    assert again.valid
    assert again.objective == pytest.approx(one.objective, rel=1e-9)


@pytest.mark.slow
def test_law_counted_from_the_frame_has_no_output_at_the_start() -> None:
    """Without s0 the slide itself is prescribed; a law of phi alone depends on where the crank starts."""
    design = {"crank.length": 0.025, "rod.length": 0.090, "G.offset": 0.010}
    law = {"slide": "25*cos(phi) + sqrt(90^2 - (10 - 25*sin(phi))^2)", "unit": "mm"}
    file = slider_crank(law=law, start="20 deg")
    assert "zero" not in file.model.quantities
    result = solve(file)
    assert result.valid
    assert result.best.exact
    for name, value in design.items():
        assert result.design[name] == pytest.approx(value, rel=1e-6)
    free = solve(slider_crank(law=law))  # the start is found, too
    assert free.best.exact


def test_table_counted_from_the_frame_brings_its_own_start() -> None:
    angles = np.radians(np.linspace(20.0, 110.0, 13))
    strokes = slides({"crank.length": 0.025, "rod.length": 0.090, "G.offset": 0.010}, angles)
    rows = {"phi": [f"{a!r} rad" for a in angles.tolist()], "s": [f"{s!r} m" for s in strokes.tolist()], "measured_from": "frame"}
    file = slider_crank(law=rows, span=None, points=None)
    assert set(file.model.free) == {"crank.length", "rod.length", "G.offset"}
    result = solve(file)
    assert result.best.exact
    assert result.design["rod.length"] == pytest.approx(0.090, rel=1e-6)


@pytest.mark.slow
def test_negative_span_turns_the_crank_clockwise() -> None:
    back = solve(slider_crank(law={"slide": "s0 + 40*(phi - phi0)/(pi/2)", "unit": "mm"}, span="-90 deg"))
    assert back.valid
    assert back.best.crank_angles[-1] < back.best.crank_angles[0]
    mirrored = optlink.load("law-slider-crank").model.expected.objective  # reflected in the x axis, offsets being symmetric
    assert back.objective == pytest.approx(mirrored, rel=1e-6)


@pytest.mark.parametrize("assembly", ["forward", "backward"])
def test_validation_takes_the_assembly_mode_that_fits_the_law(assembly: str) -> None:
    """Where the problem leaves the assembly mode open, a given design is judged in the better one."""
    slide = slides({"crank.length": 0.025, "rod.length": 0.090, "G.offset": 0.010}, np.radians(np.linspace(20.0, 110.0, 31)))
    rows = slide if assembly == "forward" else -slide[::-1]  # turned by half a revolution and mirrored
    angles = np.linspace(20.0, 110.0, 31) if assembly == "forward" else np.linspace(70.0, 160.0, 31)
    law = {"phi": [f"{a!r} deg" for a in angles.tolist()], "s": [f"{s!r} m" for s in rows.tolist()], "measured_from": "frame"}
    file = slider_crank(law=law, span=None, points=None).override({"mechanism.assembly": {"C": "either"}})
    result = optlink.validate(file, {"crank.length": 0.025, "rod.length": 0.090, "G.offset": 0.010})
    assert result.valid
    assert result.best.assembly == {"C": assembly}
    assert result.objective < 1e-24


@pytest.mark.slow
def test_a_search_from_beyond_a_limit_of_many_positions_stays_near() -> None:
    """The least squares end beyond the transmission limit at eight positions; led far away, the search ended 5 % worse."""
    length = {"mechanism.links.crank.length": "77.5 mm", "mechanism.links.rod.length": {"bounds": ["143.5 mm", "276.9 mm"]}}
    free = {"mechanism.guides.G.offset": {"bounds": ["-50 mm", "50 mm"]}, "requirement.start": "-172.5 deg"}
    law = {"requirement.law": {"slide": "72.8 + 20.52*(phi - phi0)", "unit": "mm"}, "requirement.span": "-247.1 deg"}
    limits = {"limits": {"crank": "span", "transmission_angle": ["31.9 deg", "150.9 deg"]}, "requirement.points": 11}
    result = optlink.solve(optlink.load("law-slider-crank", length | free | law | limits), starts=60)
    rod, offset = np.meshgrid(np.linspace(143.5, 160.0, 34), np.linspace(-50.0, 50.0, 201))
    angles = np.radians(np.linspace(-172.5, -172.5 - 247.1, 12))
    over = np.radians(np.linspace(-172.5, -172.5 - 247.1, 1000))
    cosines = [(offset - 77.5 * end(np.sin(over))) / rod for end in (np.min, np.max)]
    met = (cosines[0] <= math.cos(math.radians(31.9))) & (cosines[1] >= math.cos(math.radians(150.9)))
    reached = [77.5 * np.cos(a) + np.sqrt(rod**2 - (offset - 77.5 * np.sin(a)) ** 2) for a in angles]
    total = sum((x - 72.8 - 20.52 * (a - angles[0])) ** 2 for x, a in zip(reached, angles, strict=True))
    assert result.valid
    assert result.designs[0].objective <= 1e-6 * float(np.min(total[met])) * (1.0 + 1e-9)


def arm(start: str, bounds: tuple[str, str], law: str = "psi0 + 0.4*sin(phi - phi0)") -> optlink.ProblemFile:
    """A crank-rocker whose best start angle is near 126.8 deg."""
    lengths = {
        name: {"start": f"{at} mm", "bounds": [f"{at - 1} mm", f"{at + 1} mm"]} for name, at in (("coupler", 95), ("rocker", 70))
    }
    mechanism = {"type": "four-bar", "crank": "30 mm", "frame": "100 mm", **lengths}
    requirement = {"law": law, "from": {"start": start, "bounds": list(bounds)}, "span": "90 deg", "points": 12}
    return optlink.read({"title": "arm", "mechanism": mechanism, "requirement": requirement})


@pytest.mark.parametrize("backend", ["ipopt", "slsqp"])
def test_a_search_crosses_the_wrap_of_an_unbounded_angle(backend: str) -> None:
    """Both bounds are one position: the search ended at one of them, "locally optimal", with 3.6 times the objective."""
    whole = optlink.solve(arm("100 deg", ("0 deg", "360 deg")), backend, 1)
    ends = optlink.solve(arm("100 deg", ("-235 deg", "125 deg")), backend, 1)
    assert ends.valid
    assert ends.objective == pytest.approx(whole.objective, rel=1e-9)
    assert math.cos(ends.design["phi0"] - whole.design["phi0"]) == pytest.approx(1.0, abs=1e-12)


def test_an_optimum_at_the_jump_has_no_active_bound_there() -> None:
    best = math.degrees(optlink.solve(arm("100 deg", ("0 deg", "360 deg")), starts=1).design["phi0"])
    result = optlink.solve(arm("100 deg", (f"{best - 360.0!r} deg", f"{best!r} deg")), starts=1).solution
    assert result is not None
    assert [limit.name for limit in result.limits if limit.active] == ["coupler"]


def test_a_start_angle_that_the_law_contains_as_such_has_bounds() -> None:
    """With 0.3 phi0 in the law, start angles a revolution apart prescribe different outputs."""
    law = "psi0 + 0.3*phi0 + 0.4*sin(phi - phi0)"
    assert not arm("100 deg", ("-235 deg", "125 deg"), law).spec.is_periodic("phi0")
    assert arm("100 deg", ("-235 deg", "125 deg"), "psi0 + 0.3*sin(phi0)*(phi - phi0)").spec.is_periodic("phi0")
