"""Sensitivities of an optimum, against problems that are solved again, scaling laws, published tables and finite differences."""

from __future__ import annotations

import csv
import dataclasses
import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.errors import InputError
from optlink.linkage.motion import sweep
from optlink.presentation.views.sensitivity import charts, overview as summary
from optlink.studies.motion_sensitivity import output_names, output_sensitivity
from optlink.studies.sensitivity import sensitivities as sensitivities_in_si
from tests.tiers import mostly_slow


class Displayed:
    """A result whose rows are in display units, in which these tests state what they expect."""

    def __init__(self, result):
        self.result = result

    def __getitem__(self, key):
        return self.result.displayed[key]

    def __getattr__(self, name):
        return getattr(self.result.displayed if name in ("rows", "moving", "values", "units") else self.result, name)


def sensitivities(*arguments, **options):
    return Displayed(sensitivities_in_si(*arguments, **options))


LIMIT = "limits.transmission_angle.max"


def solved(**overrides) -> optlink.SynthesisResult:
    """The crank-rocker with other values, built and searched from its own start."""
    result = optlink.solve(optlink.load("crank-rocker", overrides))
    assert result.valid
    return result


def figures(result: optlink.SynthesisResult) -> np.ndarray:
    """Objective [rad^2], coupler and rocker [mm]."""
    return np.array([result.objective, 1e3 * result.design["coupler"], 1e3 * result.design["rocker"]])


@pytest.fixture(scope="module")
def crank_rocker():
    return sensitivities(optlink.load("crank-rocker"))


@pytest.mark.parametrize(
    ("key", "step", "override"),
    [
        ("mechanism.frame", 0.02, lambda h: {"mechanism.frame": f"{500.0 + h!r} mm"}),
        ("mechanism.crank", 0.004, lambda h: {"mechanism.crank": f"{100.0 + h!r} mm"}),
        (LIMIT, 0.004, lambda h: {"limits.transmission_angle": ["45 deg", f"{135.0 + h!r} deg"]}),
    ],
)
def test_derivatives_agree_with_reoptimised_problems(crank_rocker, key, step, override):
    above, below = (figures(solved(**override(h))) for h in (step, -step))
    row = crank_rocker[key]
    exact = np.array([row.objective, row.design["coupler"], row.design["rocker"]])
    np.testing.assert_allclose(exact, (above - below) / (2.0 * step), rtol=1e-5)


@pytest.mark.slow
def test_the_price_predicts_one_more_degree():
    """To first order: what is left over falls with the square of the change."""
    base = solved()
    (limit,) = (item for item in base.solution.displayed_limits if item.active)
    assert (limit.name, limit.bound, limit.unit) == ("largest transmission angle", 135.0, "deg")
    left = {}
    for change in (1.0, 0.5, 0.25):
        there = solved(**{"limits.transmission_angle": ["45 deg", f"{135.0 + change} deg"]})
        left[change] = there.objective - base.objective - limit.multiplier * change
    assert abs(left[1.0]) < 0.02 * abs(limit.multiplier)
    assert left[1.0] / left[0.5] == pytest.approx(4.0, rel=0.02)
    assert left[0.5] / left[0.25] == pytest.approx(4.0, rel=0.02)


def test_the_price_is_that_of_solve(crank_rocker):
    (limit,) = (item for item in solved().solution.displayed_limits if item.active)
    assert crank_rocker[LIMIT].objective == pytest.approx(limit.multiplier, rel=1e-9)


def test_scaling_the_given_lengths_scales_the_design(crank_rocker):
    """Euler: the objective is homogeneous of degree 0 in the lengths that are given, the design of degree 1."""
    crank, frame = crank_rocker["crank"], crank_rocker["frame"]
    assert 100.0 * crank.objective + 500.0 * frame.objective == pytest.approx(0.0, abs=1e-12)
    for name, value in crank_rocker.values.items():
        assert 100.0 * crank.design[name] + 500.0 * frame.design[name] == pytest.approx(value, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    "overrides",
    [
        {"requirement.measure": "max"},
        {"requirement.measure": "rms"},
        {"limits.swing_angle": "50 deg"},
        {"mechanism.frame": {"start": "500 mm", "bounds": ["450 mm", "550 mm"]}},
        {"mechanism.coupler": {"start": "400 mm", "bounds": ["100 mm", "410 mm"]}},
        {"requirement.psi0": {"start": "100 deg", "bounds": ["60 deg", "150 deg"]}},
        {"mechanism.crank": "4 in", "mechanism.frame": "20 in"},
    ],
)
def test_the_built_in_check_agrees_on_variations(overrides):
    result = sensitivities_in_si(optlink.load("crank-rocker", overrides), check=True)
    assert result.moving
    assert all(row.check is not None for row in result.moving)
    assert result.gap < 1e-5


@pytest.mark.parametrize("dimension", mostly_slow(["frame", "crank"], "crank"))
def test_an_optimum_without_active_limits(dimension):
    file = optlink.load("path-arc5", {f"mechanism.{dimension}": "2.9 mm"})
    result = sensitivities_in_si(file, starts=3, check=True)
    assert not [limit.name for limit in optlink.solve(file, starts=3).best.solution.limits if limit.active]
    assert [row.parameter.key for row in result.moving] == [f"mechanism.{dimension}"]
    assert result.gap < 1e-4  # the optimum is flat: the lengths move by 24 times the change of the crank


@pytest.mark.slow
def test_the_check_of_a_largest_error_has_all_digits():
    """IPOPT ends 1e-8 above the optimum where many values are nearly the largest: the gap was 4e-4, and the exit code 1.

    The objective has 13 digits. The direction of the guide is 0, has no effect, and is changed by only 3e-5 deg either way: in
    its difference quotient one unit of the 13th digit is 1.7e-7 of the reference, 1 % of the objective per degree.
    """
    result = sensitivities(optlink.load("law-slider-crank", {"requirement.measure": "max"}), check=True)
    *effective, direction = result.moving
    assert [row.parameter.key for row in effective] == ["limits.alignment", "mechanism.guides.G.offset.max"]
    assert max(row.check.gap for row in effective) < 1e-8
    assert direction.objective == 0.0
    assert direction.check.gap < 1e-6


@pytest.mark.slow
def test_the_check_of_a_bound_stays_at_its_optimum():
    """The search at a bound 4 um beside went to another local optimum, whose coupler is 11 mm shorter: the gap was 1."""
    raw = {
        "title": "Feeder lever",
        "mechanism": {
            "type": "four-bar",
            "crank": {"bounds": ["30 mm", "120 mm"]},
            "coupler": {"bounds": ["80 mm", "500 mm"]},
            "rocker": {"bounds": ["60 mm", "400 mm"]},
            "frame": {"bounds": ["120 mm", "400 mm"]},
            "points": {"K": [{"equals": "0.5*coupler"}, "40 mm"]},
            "assembly": "left",
        },
        "requirement": {
            "kind": "function",
            "law": "psi0 + 0.25*(phi - phi0) + 0.05*(phi-phi0)^2",
            "from": {"bounds": ["0 deg", "360 deg"]},
            "span": "100 deg",
            "tolerance": "2 deg",
        },
        "objective": {"quantity": "total length"},
        "limits": {
            "transmission_angle": ["45 deg", "135 deg"],
            "cover": {
                "region": "half-plane",
                "of": "K",
                "through": ["0 mm", "110 mm"],
                "direction": "180 deg",
                "side": "inside",
                "clearance": "3 mm",
            },
        },
    }
    result = sensitivities(optlink.read(raw), check=True)
    assert result.solution.objective == pytest.approx(0.3121502, rel=1e-5)
    assert result.gap < 1e-6


@pytest.mark.slow
def test_rounding_errors_end_no_range():
    row = sensitivities(optlink.load("law-slider-crank", {"mechanism.guides.G.offset": "0 mm"}))["mechanism.guides.G.direction"]
    assert (row.below.value, row.above.value) == (-math.inf, math.inf)  # was -8e10 deg


@pytest.mark.slow
def test_a_minimax_function_scales_with_its_frame():
    """Its largest errors lie anywhere in the range, and move along."""
    result = sensitivities(optlink.load("function-sin"), check=True)
    frame, size = result["frame"], result["frame"].parameter.value
    assert frame.objective == 0.0
    for name in ("crank", "coupler", "rocker"):
        assert frame.design[name] == pytest.approx(result.values[name] / size, rel=1e-6)
    assert frame.design["phi0"] == pytest.approx(0.0, abs=1e-6)
    assert result.gap < 1e-5


@pytest.mark.parametrize(
    ("name", "several"),
    mostly_slow([("law-slider-crank", 8), ("path-conveyor", 16), ("crank-rocker", 6)], ("crank-rocker", 6)),
)
def test_every_key_of_a_dimension_can_be_changed(name, several):
    problem = optlink.load(name)
    keys = {
        row.parameter.key: f"{row.parameter.value} {row.parameter.unit}"
        for row in sensitivities(problem).rows
        if row.parameter.key.startswith("mechanism.")
    }
    assert len(keys) >= several
    assert problem.override(keys).hash  # mechanism.G.direction of a guide was no key


@pytest.mark.slow
@pytest.mark.parametrize("direction", ["0 deg", "37 deg"])
def test_rotating_the_guide_only_rotates_the_crank(direction):
    result = sensitivities(optlink.load("law-slider-crank", {"mechanism.guides.G.direction": direction}))
    row = result["mechanism.guides.G.direction"]
    assert row.objective == 0.0  # was -1.2e-13 of it by 1 deg
    assert row.design.pop("start") == pytest.approx(1.0)
    assert not any(row.design.values())
    assert (row.below.value, row.above.value) == (-math.inf, math.inf)  # was 3.8 deg, where C should have been aligned
    bound = result["start, largest allowed"]  # which is a limit once it is less than a revolution from the other one
    assert bound.below.value == pytest.approx(result.values["start"])
    assert bound.below.event == "the bound of start is reached"


@pytest.mark.slow
def test_peaks_of_a_limit_move_within_the_range_of_validity():
    """Where a pivot moves, so does the crank angle of the least transmission angle at E: the same limits stay active."""
    problem = optlink.load("law-six-bar")
    row = sensitivities(problem)["mechanism.ground.A.y"]
    assert row.below.value < -60.0  # was -4.9 mm
    assert row.above.value > 60.0
    for value in (0.0, -60.0, 60.0):
        result = optlink.solve(problem.override({"mechanism.ground.A": ["0 mm", f"{value} mm"]}))
        active = {limit.name for limit in result.solution.displayed_limits if limit.active}
        assert active == {"transmission angle at C", "transmission angle at E"}


def test_a_chart_of_effects_is_left_out_where_all_are_zero():
    """The errors of a function keep their size if the frame grows, so that its chart would be empty."""
    result = sensitivities_in_si(optlink.load("crank-rocker"))
    (chart,) = charts(result)
    assert len(chart.panels[0].traces[0].y) == 3
    rows = [dataclasses.replace(row, objective=1e-9 * row.objective) for row in result.displayed.rows]
    assert charts(dataclasses.replace(result, displayed=dataclasses.replace(result.displayed, rows=rows))) == []


def test_the_tables_use_display_units_and_name_what_the_file_states():
    """An objective that is an angle is in degrees; `crank <= coupler` (Grashof) is no value of the problem file."""
    stroke = sensitivities_in_si(optlink.load("stroke-slider-crank"))
    optimum, _, prices, *_ = summary(stroke).parts
    assert np.isclose(float(optimum.rows[0][1].text), math.degrees(stroke.solution.objective), rtol=1e-5)
    assert "deg per 0.01" in str(prices)
    price = next(row for row in stroke.moving if row.parameter.key == "requirement.time_ratio").objective
    assert f"{math.degrees(0.01 * price):+.6g}" in str(prices)
    still = str(summary(sensitivities_in_si(optlink.load("crank-rocker"))).parts[-1])
    assert "No effect to first order" in still
    assert "rocker, largest allowed" in still
    assert "<=" not in still


@pytest.mark.slow
def test_a_path_with_its_frame_at_a_bound():
    result = sensitivities_in_si(optlink.load("path-ellipse10"), starts=64, check=True)
    (row,) = result.displayed.moving
    assert row.parameter.key == "mechanism.frame.max"
    assert row.objective < 0.0
    assert row.design["frame"] == pytest.approx(1.0)
    assert result.gap < 1e-5


def test_the_validity_range_ends_where_a_bound_becomes_inactive():
    """The coupler held at 412.5 mm: freed, it would go to 412.865 mm; nearly linear so close to it."""
    free = 1e3 * solved().design["coupler"]
    bounds = {"mechanism.coupler": {"start": "400 mm", "bounds": ["100 mm", "412.5 mm"]}}
    row = sensitivities(optlink.load("crank-rocker", bounds))["mechanism.coupler.max"]
    assert row.above.event == "the bound of coupler is no longer active"
    assert row.above.value == pytest.approx(free, abs=0.005)
    assert row.below.value < 412.5


@pytest.mark.slow
def test_the_validity_range_ends_where_another_limit_becomes_active():
    """A limit of the smallest angle just below the one that the optimum has."""
    computed = [check.value for check in solved().validation.checks if check.name == "smallest transmission angle"]
    limits = {"limits.transmission_angle": [f"{computed[0] - 0.05!r} deg", "135 deg"]}
    row = sensitivities(optlink.load("crank-rocker", limits))["mechanism.frame"]
    ends = {end.event: end.value for end in (row.below, row.above)}
    at = ends["smallest transmission angle is reached"]
    there = optlink.solve(optlink.load("crank-rocker", {"mechanism.frame": f"{at!r} mm"}))
    reached = [check.value for check in there.validation.checks if check.name == "smallest transmission angle"]
    assert reached[0] == pytest.approx(computed[0] - 0.05, abs=1e-3)


def test_the_range_of_an_inactive_angle_limit_ends_at_the_angle_of_the_design(crank_rocker):
    """Converted exactly from its cosine: 75.09 deg was printed, where the optimum had long changed, and 2181 deg."""
    crank, frame, coupler, rocker = 100.0, 500.0, *crank_rocker.values.values()
    smallest = math.degrees(math.acos((coupler**2 + rocker**2 - (frame - crank) ** 2) / (2.0 * coupler * rocker)))
    assert crank_rocker["limits.transmission_angle.min"].above.value == pytest.approx(smallest)
    assert {1.0, 179.0} <= {row.parameter.value for row in crank_rocker.rows}  # was 0.9999999999999 deg
    ends = {end.value for row in crank_rocker.rows if row.parameter.unit == "deg" for end in (row.below, row.above)}
    assert all(0.0 <= end <= 180.0 for end in ends if math.isfinite(end))


def test_the_range_ends_at_once_where_a_bound_is_just_reached():
    """A bound at the optimum, with a zero multiplier: the derivatives hold on the side that leads away from it."""
    design = solved().design
    bounds = {"mechanism.coupler": {"start": "400 mm", "bounds": ["100 mm", f"{1e3 * design['coupler']!r} mm"]}}
    result = sensitivities(optlink.load("crank-rocker", bounds))
    frame, bound = result["mechanism.frame"], result["mechanism.coupler.max"]
    assert frame.design["coupler"] > 0.0
    assert frame.above.value == pytest.approx(500.0)  # was 1800 mm
    assert frame.below.value < 400.0
    assert bound.below.value == pytest.approx(1e3 * design["coupler"])  # was unlimited
    assert bound.below.event == "the bound of coupler is reached"
    assert bound.above.value == math.inf


def test_a_change_of_the_largest_error_position_is_described():
    """Of a minimax objective the range ends where another error becomes the largest, or one of the largest no longer is."""
    file = optlink.load("crank-rocker", {"requirement.measure": "max"})
    events = {end.event for row in sensitivities(file).rows for end in (row.below, row.above)}
    moved = [event for event in events if event.startswith(("positive error", "negative error"))]
    assert moved
    assert all(
        event.endswith(("from the start determines the objective", "no longer determines the objective")) for event in moved
    )
    assert not any(", above" in event or ", below" in event for event in events)


def test_rows_are_sorted_by_effect(crank_rocker):
    """Effects that differ by rounding alone, as those of crank and frame, do not decide about the order."""
    effects = [float(f"{abs(row.effect):.6g}") for row in crank_rocker.rows]
    assert effects == sorted(effects, reverse=True)
    names = [row.parameter.key for row in crank_rocker.rows if row.parameter.key in ("mechanism.crank", "mechanism.frame")]
    assert names == ["mechanism.crank", "mechanism.frame"]
    first, *others = [(row.parameter.key, row.parameter.step) for row in crank_rocker.moving]
    assert first == (LIMIT, 1.0)
    assert sorted(others) == [("mechanism.crank", 1.0), ("mechanism.frame", 5.0)]  # a hundredth of each: as much, by similarity


def test_no_sensitivities_without_an_optimum():
    with pytest.raises(InputError, match="no optimum"):
        sensitivities(optlink.load("crank-rocker", {"limits.transmission_angle": ["80 deg", "90 deg"]}))


# --- outputs ---------------------------------------------------------------------------------------------------------

# Sensitivities of the output angle of the crank-rocker optimum, l = 1, 4.12865417, 2.3224617, 5: computed by others from the
# closed form of the four-bar; crank angle and psi in deg, d psi / d l1 .. l4 in rad per unit length.
TABLE = """
0    103.533936  -0.382699 -0.457120  0.153498  0.382699
60   105.157531  -0.328158 -0.431796  0.032414  0.407123
120  129.480461   0.140934 -0.481177 -0.214789  0.468903
240  147.377012   0.420297 -0.481177 -0.214789  0.413031
"""
SIZES = {"crank": 1.0, "coupler": 4.12865417, "rocker": 2.3224617, "frame": 5.0}


def test_output_angle_table():
    rows = np.array([[float(x) for x in line.split()] for line in TABLE.strip().splitlines()])
    linkage = optlink.load("crank-rocker").model.linkage
    result = output_sensitivity(linkage, SIZES, np.radians(rows[:, 0]), "rocker")
    np.testing.assert_allclose(np.degrees(result.value), rows[:, 1], atol=1e-5)
    np.testing.assert_allclose(np.column_stack([result.by[name] for name in SIZES]), rows[:, 2:], atol=1e-5, rtol=0.0)


@pytest.mark.parametrize("name", ["crank-rocker", "six-bar", "shaper", "slider-crank"])
def test_outputs_of_every_kind_against_central_differences(name):
    model = optlink.load(name).model
    sizes = {key: quantity.value for key, quantity in model.mechanism.quantities.items()}
    angles = np.radians([20.0, 100.0, 215.0])

    def measured(output: str, values: dict[str, float]) -> np.ndarray:
        motion = sweep(model.linkage, values, angles)
        if output in model.linkage.bodies:
            return np.asarray(motion.body_angle(output).value)
        point, _, axis = output.rpartition(".")
        return motion.position(point)[:, "xy".index(axis)]

    for output in output_names(model.linkage):
        result = output_sensitivity(model.linkage, sizes, angles, output)
        np.testing.assert_allclose(np.exp(1j * result.value), np.exp(1j * measured(output, sizes)), atol=1e-12)
        for size, value in sizes.items():
            step = 1e-6 * max(1.0, abs(value))
            above, below = (measured(output, {**sizes, size: value + way}) for way in (step, -step))
            np.testing.assert_allclose(result.by[size], (above - below) / (2.0 * step), atol=2e-7, rtol=1e-6)


def test_unknown_outputs_suggest_the_nearest_name():
    linkage = optlink.load("crank-rocker").model.linkage
    with pytest.raises(InputError, match='Did you mean "rocker"'):
        output_sensitivity(linkage, SIZES, [0.0], "roker")
    with pytest.raises(InputError, match='Did you mean "coupler"'):
        output_sensitivity(linkage, SIZES, [0.0], "rocker", ["copler"])


# --- keys and the command --------------------------------------------------------------------------------------------


def test_sides_of_ranges_can_be_changed():
    problem = optlink.load("crank-rocker")
    other = problem.override({LIMIT: "140 deg", "limits.transmission_angle.min": "40 deg", "mechanism.coupler.min": "200 mm"})
    interval = other.spec.limits.transmission_angle
    assert (interval.low, interval.high) == pytest.approx((math.radians(40.0), math.radians(140.0)))
    assert other.spec.quantities["coupler"].bounds == pytest.approx((0.2, 0.9))
    one_sided = optlink.load("crank-rocker", {"limits.transmission_angle": {"max": "135 deg"}})
    assert one_sided.override({LIMIT: "130 deg"}).spec.limits.transmission_angle.low is None


def run(*arguments: str):
    return CliRunner().invoke(app, ["study", "sensitivity", *arguments])


@pytest.mark.slow
def test_the_command_writes_a_table_a_picture_and_json(tmp_path):
    done = run("crank-rocker", "--check", "--json", "--out", str(tmp_path))
    assert done.exit_code == 0
    document = json.loads(done.stdout)
    assert document["schema"] == "optlink/sensitivity/4"
    assert document["largest_gap"] < 1e-5
    assert document["parameters"][0]["key"] == LIMIT
    assert document["parameters"][0]["objective_per_unit"] == pytest.approx(-1.4647e-4, rel=1e-3)
    assert (tmp_path / "tornado.png").stat().st_size > 5000
    with (tmp_path / "sensitivity.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[0]["coupler_m_per_unit"]) == pytest.approx(-2.3856e-3 * 180.0 / math.pi, abs=1e-4)


def test_the_command_prints_the_sensitivities():
    done = run("crank-rocker")
    assert done.exit_code == 0
    for words in ("limits.transmission_angle.max", "-1.929 %", "rad^2 per deg", "the bound of rocker is reached"):
        assert words in done.stdout


def test_the_command_prints_output_sensitivities():
    done = run("crank-rocker", "--quantity", "rocker", "--angles", "0, 120 deg")
    assert done.exit_code == 0
    assert "0.26866" in done.stdout  # 0.468903 rad per 100 mm, in deg per mm


def test_bad_input_of_the_command():
    done = run("crank-rocker", "--design", "coupler=412 mm", "--json")
    assert done.exit_code == 2
    assert json.loads(done.stdout)["status"] == "error"
    assert run("shaper").exit_code == 2


def test_output_sensitivities_are_written(tmp_path):
    """The rocker's slope by the frame from the file against the difference of two linkages of a table that was written alike."""
    given = ["--design", "coupler=412.87 mm", "--design", "rocker=232.25 mm"]

    def table(frame: str) -> dict[str, float]:
        out = tmp_path / frame
        done = run(
            *("crank-rocker", "--quantity", "rocker", "--angles", "60 deg", *given),
            *("--set", f"mechanism.frame={frame} mm", "--out", str(out), "--json"),
        )
        assert json.loads(done.stdout) == json.loads((out / "result.json").read_text())
        with (out / "sensitivity.csv").open(encoding="utf-8") as file:
            [row] = csv.DictReader(file)
        return {name: float(value) for name, value in row.items()}

    below, here, above = (table(frame) for frame in ("499", "500", "501"))
    assert here["crank_angle_deg"] == pytest.approx(60.0)
    assert here["per_frame_SI"] == pytest.approx((above["rocker_rad"] - below["rocker_rad"]) / 0.002, rel=1e-4)
    page = CliRunner().invoke(app, ["report", str(tmp_path / "500"), "-o", str(tmp_path / "a.html")])
    assert page.exit_code == 2
    assert "has no page" in page.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "measure"),
    [("law-slider-crank", "max"), ("path-ellipse10", "max"), ("transmission-optimal", "max"), ("path-ellipse10", "rms")],
)
def test_derivatives_of_largest_values_are_those_of_new_optima(name, measure):
    """Each parameter is written to the file and the optimum there exchanged again: peaks and free crank angles move along."""
    result = sensitivities(optlink.load(name, {"requirement.measure": measure}), check=True)
    assert result.moving
    assert all(row.check is not None for row in result.moving)
    assert result.gap < 1e-5


@pytest.mark.slow
def test_an_idle_crank_angle_does_not_make_several_designs():
    """At point 10 the deviation is below the largest one, so its crank angle may be any: dimensions and prices are unique."""
    problem = optlink.load("path-ellipse10", {"requirement.measure": "max"})
    result = sensitivities(problem)
    assert not [note for note in result.notes if "equally good" in note]
    row = result["mechanism.frame.max"]
    assert row.above.value > row.parameter.value * 1.01  # was the value itself
    low, high = (optlink.solve(problem.override({"mechanism.frame.max": f"{size} mm"})).objective for size in (79.95, 80.05))
    assert row.objective == pytest.approx((high - low) / 0.1, rel=1e-4)
