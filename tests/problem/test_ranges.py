"""Ranges, and lists whose quotes the shell has removed, as people type them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, strategies as st

from optlink.cli.show import _template
from optlink.errors import InputError
from optlink.problem.assignment import parse_assignment
from optlink.problem.base_model import with_ranges
from optlink.problem.file import load, read
from optlink.problem.quantity import Unusable, read_interval, read_quantity
from optlink.units import UnitProblem, parse, split_range
from tests.tiers import examples

seeded = examples(150)
LIMIT, RATIO, SIZE = "limits.transmission_angle", "limits.time_ratio", "mechanism.coupler"


@pytest.fixture(scope="module")
def problem():
    return load("crank-rocker")


BOTH = [
    *("40..140 deg", "40 .. 140 deg", "40 ... 140 deg", "40 deg .. 140 deg", "40 deg ... 140 deg", "40 deg..140 deg"),
    *("40 deg .. 140", "40\u2026140 deg", "40\u00b0 \u2026 140\u00b0", "40\u00a0..\u00a0140\u00a0deg", "4e1..1.4e2 deg"),
    *("40.0..140.0 DEG",),
]


@pytest.mark.parametrize("text", BOTH)
def test_range_of_a_limit(problem, text):
    changed = problem.override({LIMIT: text})
    same = problem.override({LIMIT: ["40 deg", "140 deg"]})
    assert changed.model.limits.transmission_angle.bounds == same.model.limits.transmission_angle.bounds
    assert str(changed.model.limits.transmission_angle) == "40 deg ... 140 deg"


def test_both_spellings_are_the_same_problem(problem):
    assert problem.override({LIMIT: "40..140 deg"}).hash == problem.override({LIMIT: ["40 deg", "140 deg"]}).hash
    assert problem.override({LIMIT: "40..140 deg", f"{LIMIT}.max": "135 deg"}).raw["limits"]["transmission_angle"] == [
        "40 deg",
        "135 deg",
    ]


TOLERANCES = [
    (LIMIT, "90 deg +- 5 deg", (math.radians(85.0), math.radians(95.0))),
    (LIMIT, "90\u00b0 \u00b1 5\u00b0", (math.radians(85.0), math.radians(95.0))),
    (LIMIT, "5400 +/- 300 arcmin", (math.radians(85.0), math.radians(95.0))),
    (LIMIT, "90 deg +- 30 arcmin", (math.radians(89.5), math.radians(90.5))),
    (LIMIT, "90 +- 5 deg", (math.radians(85.0), math.radians(95.0))),
    (LIMIT, "90 deg +- 10 %", (math.radians(81.0), math.radians(99.0))),
    (RATIO, "1.25 +- 0.05", (1.2, 1.3)),
    (RATIO, "1.25 +- 4 %", (1.2, 1.3)),
    (LIMIT, "90 deg +- 5 mm", None),
    (LIMIT, "90 deg +- -5 deg", None),
]


@pytest.mark.parametrize(("key", "text", "bounds"), TOLERANCES)
def test_a_value_with_a_tolerance_limits_both_sides(problem, key, text, bounds):
    if bounds is None:
        with pytest.raises(InputError, match="transmission_angle"):
            problem.override({key: text})
    else:
        limit = getattr(problem.override({key: text}).model.limits, key.partition(".")[2])
        assert limit.bounds == pytest.approx(bounds, rel=1e-14)


def test_exactly_with_a_tolerance(problem):
    stroke = load("press-toggle").override({"limits.stroke.exactly": "65 mm +- 0.1 mm"}).spec.bounds[0].interval
    assert stroke.bounds == pytest.approx((0.0649, 0.0651), rel=1e-14)


@pytest.mark.parametrize("key", ["mechanism.coupler", "requirement.from"])
def test_a_tolerance_is_no_design_variable(problem, key):
    unit = "mm" if key.startswith("mech") else "deg"
    with pytest.raises(InputError, match=rf'{key} = "300 {unit} \+- 5 {unit}".*Write bounds = \["295 {unit}", "305 {unit}"\]'):
        problem.override({key: f"300 {unit} +- 5 {unit}"})


ONE_SIDED = [
    (LIMIT, ">= 40 deg", (math.radians(40.0), math.inf)),
    (LIMIT, ">=40deg", (math.radians(40.0), math.inf)),
    (LIMIT, "\u2265 40\u00b0", (math.radians(40.0), math.inf)),
    (LIMIT, "<= 135 deg", (-math.inf, math.radians(135.0))),
    (LIMIT, "\u2264 135 deg", (-math.inf, math.radians(135.0))),
    (RATIO, ">= 1.2", (1.2, math.inf)),
    (RATIO, "1.2..1.5", (1.2, 1.5)),
    (RATIO, "1.2 ... 1.5", (1.2, 1.5)),
]


@pytest.mark.parametrize(("key", "text", "bounds"), ONE_SIDED)
def test_one_side_and_plain_numbers(problem, key, text, bounds):
    limits = problem.override({key: text}).model.limits
    assert getattr(limits, key.partition(".")[2]).bounds == pytest.approx(bounds, rel=1e-15)


@pytest.mark.parametrize(
    ("value", "start"),
    [
        ("100..500 mm", 0.3),
        ("10 cm .. 50 cm", 0.3),
        ({"bounds": "100..500 mm"}, 0.3),
        ({"start": "200 mm", "bounds": "100 ... 500 mm"}, 0.2),
    ],
)
def test_design_variable_between_bounds(problem, value, start):
    quantity = problem.override({SIZE: value}).model.mechanism.coupler
    assert quantity.bounds == pytest.approx((0.1, 0.5), rel=1e-15)
    assert quantity.value == pytest.approx(start, rel=1e-15)


def test_coordinates_below_zero(problem):
    free = load("path-closed18-untimed").override({"mechanism.pivot": ["-80..80 mm", "0 mm"], "mechanism.pivot.x.max": "90 mm"})
    assert free.raw["mechanism"]["pivot"] == [{"bounds": ["-80 mm", "90 mm"]}, "0 mm"]
    assert free.model.quantities["A.x"].bounds == pytest.approx((-0.08, 0.09))


def test_words_are_unchanged(problem):
    assert problem.override({"title": "1..2 mm", "about": ">= 3"}).model.title == "1..2 mm"


def test_plain_numbers_of_the_terms_of_a_machine_are_read_like_others():
    machine, key = load("shaper-design"), "limits.time_ratio.exactly"
    bounds = machine.override({key: "180 %"}).model.bounds
    assert [bound.interval.low for bound in bounds if bound.key == "limits.time_ratio"] == [1.8]


BARE = [
    ("[40 deg, 140 deg]", ["40 deg", "140 deg"]),
    ("[ 40 deg , 140 deg ]", ["40 deg", "140 deg"]),
    ('["40 deg", 140 deg]', ["40 deg", "140 deg"]),
    ("{start=200 mm, bounds=[100 mm, 300 mm]}", {"start": "200 mm", "bounds": ["100 mm", "300 mm"]}),
    ("{ bounds = 100..300 mm }", {"bounds": "100..300 mm"}),
    ("[A, B]", ["A", "B"]),
    ("{mass=1 kg, inertia=uniform bar}", {"mass": "1 kg", "inertia": "uniform bar"}),
    ("[[1 mm, 2 mm], [3 mm, -4e1 mm]]", [["1 mm", "2 mm"], ["3 mm", "-4e1 mm"]]),
    ("{min=1.5, exact=true, name=B}", {"min": 1.5, "exact": True, "name": "B"}),
    ("\u22121.5", -1.5),
    ("40\u00b0", "40\u00b0"),
    (">= 40 deg", ">= 40 deg"),
    ("12,5 mm", "12,5 mm"),
]


@pytest.mark.parametrize(("text", "value"), BARE)
def test_assignment_without_inner_quotes(text, value):
    assert parse_assignment(f"key={text}") == ("key", value)


@pytest.mark.parametrize("text", ["[40 deg", "{start=", "[phi^2 + 1, 2*x]", '["a, 5 mm]', "[40 deg, x^2]"])
def test_assignment_that_cannot_be_read_shows_the_line_to_write(text):
    with pytest.raises(InputError, match=r"""--set 'key=\["40 deg", "140 deg"\]'"""):
        parse_assignment(f"key={text}")


# --- round trip, and any text --------------------------------------------------------------------------------------------

numbers = st.floats(-1e6, 1e6).map(lambda x: float(f"{x:.12g}"))
forms = st.sampled_from(["{a!r}..{b!r} {u}", "{a!r} ... {b!r} {u}", "{a!r} {u} .. {b!r} {u}", "{a!r}{u}\u2026{b!r}{u}"])


@seeded
@given(numbers, numbers, st.sampled_from(["mm", "m", "in", "\u00b5m"]), forms)
def test_range_is_read_as_its_two_ends(a, b, unit, form):
    low, high = sorted((a, b))
    sides = split_range(form.format(a=low, b=high, u=unit))
    assert sides is not None
    for side, value in (("min", low), ("max", high)):
        assert parse(sides[side], "coordinate") == parse(f"{value!r} {unit}", "coordinate")
    interval = read_interval(sides, "coordinate")
    shown = read_interval(split_range(str(interval)) or str(interval).removeprefix("exactly "), "coordinate")
    assert shown.bounds == pytest.approx(interval.bounds, rel=5.1e-6)
    assert str(shown) == str(interval)


@seeded
@given(
    st.text(max_size=30) | st.text(alphabet="0123456789.,..-+<>=eE degmNs/^*[]{}\"'\u2026\u2212\u00b0\u00b2", max_size=25),
    st.sampled_from(["length", "angle", "torque", "angular velocity", None]),
)
def test_any_text_is_a_value_or_a_fault(text, kind):
    for raw in (
        text,
        with_ranges({"limits": {"a": text}})["limits"]["a"],
        with_ranges({"mechanism": {"a": text}})["mechanism"]["a"],
    ):
        try:
            low, high = read_interval(raw, kind).bounds
            assert low <= high
            if kind is not None:
                assert math.isfinite(read_quantity(raw, kind).value)
        except (Unusable, UnitProblem) as error:
            assert error.message
            assert error.remedy
    try:
        key, value = parse_assignment(f"key={text}")
    except InputError as error:
        assert error.faults[0].remedy
    else:
        assert key == "key"
        assert value is not None


# --- show --toml ---------------------------------------------------------------------------------------------------------


def test_template_keeps_comments_and_spellings(tmp_path):
    path = tmp_path / "mine.toml"
    lines = [
        "# mine",
        'title = "x" # short',
        "[mechanism] # four bars",
        'crank = "10 cm"   # catalogue',
        'frame = "500 mm"',
        'coupler = { start = "400 mm", bounds = "100..900 mm" } # free',
        'rocker = "100..900 mm"',
        "",
        "# the task",
        "[requirement]",
        'kind = "function"',
        'law = "psi0 + 2/(3*pi)*(phi - phi0)^2"',
        'from = "outer dead centre"',
        'span = "90\u00b0" # a quarter',
        "points = 30",
        "[limits]",
        'transmission_angle = ">= 45 deg" # rule',
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    whole = _template(load(path)).splitlines()
    added = ["format = 1", 'type = "four-bar"', 'alignment = "1 deg"', "length_margin = 0.0001"]
    assert [line for line in whole if line not in added] == lines
    assert [line for line in whole if line in added] == added
    assert whole.index(added[1]) == lines.index("") + 1 == whole.index("") - 1

    changed = load(path, {"mechanism.frame": "480 mm", f"{SIZE}.max": "700 mm", "mechanism.rocker": "250 mm", RATIO: ">= 1.1"})
    text = _template(changed)
    for line in (
        'frame = "480 mm"',
        'crank = "10 cm"   # catalogue',
        'coupler = { start = "400 mm", bounds = ["100 mm", "700 mm"] } # free',
        'rocker = "250 mm"',
        "# the task",
        'span = "90\u00b0" # a quarter',
        'transmission_angle = ">= 45 deg" # rule',
    ):
        assert line in text.splitlines()
    path.write_text(text, encoding="utf-8")
    again = load(path)
    assert again.model.limits == changed.model.limits
    assert again.model.mechanism == changed.model.mechanism
    assert read(again.raw).hash == again.hash


def test_percent_is_a_fraction():
    assert read_interval({"max": "2 %"}, None).high == 0.02
    for text, reason in (("2,5 %", "plain number"), (f"{'9' * 400} %", "finite")):
        with pytest.raises(Unusable, match=reason):
            read_interval({"max": text}, None)


@pytest.mark.parametrize(
    ("bounds", "start", "kept"), [(["0.06 m", "0.208 m"], "208 mm", 0.208), (["1.1 cm", "20 cm"], "11.0 mm", 1.1 * 0.01)]
)
def test_a_start_at_a_bound_may_be_written_in_another_unit(bounds, start, kept):
    """Rounding puts the start an ulp outside; a millionth of a millimetre outside is refused."""
    assert read_quantity({"bounds": bounds, "start": start}, "length").value == kept
    way = 1e-6 if start == "208 mm" else -1e-6
    with pytest.raises(Unusable, match="outside the bounds"):
        read_quantity({"bounds": bounds, "start": f"{float(start.split()[0]) + way!r} mm"}, "length")
