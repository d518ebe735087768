"""Units at the edges: what people write becomes SI, and back; what cannot be read is refused with a remedy."""

from __future__ import annotations

import functools
import math
import re

import pint
import pytest
from hypothesis import assume, example, given, strategies as st

from optlink import units
from optlink.units import DEFINITIONS, KINDS, UnitProblem, count_noun, factor, parse, percent, plain, show
from tests.tiers import examples

seeded = examples(200)

# --- values: what one unit is in SI, written out by hand -------------------------------------------------------------

UNITS = [  # unit, kind, SI
    ("m", "length", 1.0),
    ("metre", "length", 1.0),
    ("mm", "length", 1e-3),
    ("millimetre", "length", 1e-3),
    ("cm", "length", 1e-2),
    ("dm", "length", 1e-1),
    ("um", "length", 1e-6),
    ("\u00b5m", "length", 1e-6),  # micro sign
    ("\u03bcm", "length", 1e-6),  # Greek mu
    ("km", "length", 1e3),
    ("in", "length", 0.0254),
    ("inch", "length", 0.0254),
    ("ft", "length", 0.3048),
    ("rad", "angle", 1.0),
    ("deg", "angle", math.pi / 180.0),
    ("°", "angle", math.pi / 180.0),
    ("degree", "angle", math.pi / 180.0),
    ("mrad", "angle", 1e-3),
    ("arcmin", "angle", math.pi / 10800.0),
    ("rev", "angle", 2.0 * math.pi),
    ("turn", "angle", 2.0 * math.pi),
    ("rad/s", "angular velocity", 1.0),
    ("rpm", "angular velocity", math.pi / 30.0),
    ("deg/s", "angular velocity", math.pi / 180.0),
    ("rev/min", "angular velocity", math.pi / 30.0),
    ("Hz", "angular velocity", 2.0 * math.pi),
    ("s", "time", 1.0),
    ("ms", "time", 1e-3),
    ("min", "time", 60.0),
    ("hour", "time", 3600.0),
    ("kg", "mass", 1.0),
    ("g", "mass", 1e-3),
    ("t", "mass", 1e3),
    ("lb", "mass", 0.45359237),
    ("N", "force", 1.0),
    ("kN", "force", 1e3),
    ("lbf", "force", 4.4482216152605),
    ("kg*m/s^2", "force", 1.0),
    ("kg·m/s**2", "force", 1.0),
    ("g * mm / s ** 2", "force", 1e-6),
    ("J/m", "force", 1.0),
    ("MPa*mm^2", "force", 1.0),
]
IDS = [f"{unit} ({kind})" for unit, kind, _ in UNITS]


@pytest.mark.parametrize(("unit", "kind", "si"), UNITS, ids=IDS)
def test_factor(unit, kind, si):
    assert factor(unit, kind) == pytest.approx(si, rel=1e-14)


@pytest.mark.parametrize(("unit", "kind", "si"), UNITS, ids=IDS)
def test_parse_scales_by_the_factor_and_spells_the_unit_canonically(unit, kind, si):
    value, written = parse(f"-2.5 {unit}", kind)
    assert value == pytest.approx(-2.5 * si, rel=1e-14)
    assert parse(f"-2.5 {written}", kind) == (value, written)
    assert written.isascii()


NUMBERS = [
    *(("412 mm", 0.412), ("412mm", 0.412), ("  412   mm  ", 0.412), ("\t412\nmm\n", 0.412), ("+412 mm", 0.412)),
    *(("-412 mm", -0.412), ("412. mm", 0.412), (".412 m", 0.412), ("4.12e2 mm", 0.412), ("4.12E+2 mm", 0.412)),
    *(("41200e-2mm", 0.412), ("0 mm", 0.0), ("-0 mm", 0.0), ("1e-300 mm", 1e-303), ("1e300 mm", 1e297)),
]


@pytest.mark.parametrize(("text", "value"), NUMBERS, ids=[repr(text) for text, _ in NUMBERS])
def test_numbers(text, value):
    assert parse(text, "length")[0] == pytest.approx(value, rel=1e-14, abs=0.0)


SHOWN = [
    *((0.412, "length", None, 6, "412 mm"), (0.41286541580, "length", None, 6, "412.865 mm")),
    *((0.41286541580, "length", None, 9, "412.865416 mm"), (0.412, "length", "m", 6, "0.412 m")),
    *((0.0254, "length", "in", 6, "1 in"), (math.pi / 4.0, "angle", None, 6, "45 deg")),
    *((-math.pi / 4.0, "angle", None, 6, "-45 deg"), (math.pi / 4.0, "angle", "rad", 4, "0.7854 rad")),
    *((2.0 * math.pi, "angular velocity", None, 6, "60 rpm"), (2.0, "time", None, 6, "2 s")),
    *((1.2, "mass", None, 6, "1.2 kg"), (1000.0, "force", None, 6, "1000 N"), (1000.0, "force", "kN", 6, "1 kN")),
    (0.0, "length", None, 6, "0 mm"),
]


@pytest.mark.parametrize(("value", "kind", "unit", "digits", "text"), SHOWN, ids=[row[-1] for row in SHOWN])
def test_show(value, kind, unit, digits, text):
    assert show(value, kind, unit, digits) == text


def test_kinds_have_a_valid_example_in_their_unit():
    for kind in KINDS.values():
        value, unit = parse(kind.example, kind.name)
        assert value > 0.0
        assert show(value, kind.name) == kind.example
        assert unit == kind.display
        assert factor(kind.si, kind.name) == 1.0


def test_every_unit_that_is_defined_is_known_by_all_of_its_names():
    dimensions = {"[length]": "length", "[time]": "time", "[mass]": "mass", "[angle]": "angle"}
    met = set()
    for definition in DEFINITIONS:
        names = [name.strip() for name in definition.split("=")]
        del names[1]
        for kind in KINDS:
            try:
                factors = {factor(name, kind) for name in names}
            except UnitProblem:
                continue
            assert len(factors) == 1, definition
            met.add(kind)
    composed = {kind.name for kind in KINDS.values() if set("*/^") & set(kind.display)} | {"torque"}
    assert met >= set(KINDS) - composed - {"ratio"}
    assert all(factor(KINDS[kind].display, kind) == 1.0 for kind in composed - {"volume"})
    assert set(dimensions.values()) < met


# --- units as people type them: read, and spelled in one way -------------------------------------------------------------

SPELLINGS = [  # as typed, kind, canonical
    *(("5 Nm", "torque", "5 N*m"), ("5 N\u00b7m", "torque", "5 N*m"), ("5 N\u22c5m", "torque", "5 N*m")),
    *(("5 N-m", "torque", "5 N*m"), ("5 N m", "torque", "5 N*m"), ("5 kNm", "torque", "5 kN*m")),
    *(("5 Nmm", "torque", "5 N*mm"), ("5 Nm/rad", "torsional stiffness", "5 N*m/rad")),
    *(("5 N-m/rad", "torsional stiffness", "5 N*m/rad"), ("20 Ns/m", "damping", "20 N*s/m")),
    *(("3 N/mm", "stiffness", "3 N/mm"), ("2 kg\u00b7m\u00b2", "moment of inertia", "2 kg*m^2")),
    *(("2 kg m\u00b2", "moment of inertia", "2 kg*m^2"), ("2 kg m^2", "moment of inertia", "2 kg*m^2")),
    *(("2 kgm^2", "moment of inertia", "2 kg*m^2"), ("2 kg-m^2", "moment of inertia", "2 kg*m^2")),
    *(("2 kg*m2", "moment of inertia", "2 kg*m^2"), ("9 m/s\u00b2", "acceleration", "9 m/s^2")),
    *(("9 m/s2", "acceleration", "9 m/s^2"), ("9 m\u00b7s\u207b\u00b2", "acceleration", "9 m/s^2")),
    *(("7 g/cm\u00b3", "density", "7 g/cm^3"), ("60 1/min", "angular velocity", "60 rpm")),
    *(("60 min^-1", "angular velocity", "60 rpm"), ("60 min\u207b\u00b9", "angular velocity", "60 rpm")),
    *(("60 rev/min", "angular velocity", "60 rev/min"), ("60 RPM", "angular velocity", "60 rpm")),
    *(("6 1/s", "angular velocity", "6 rad/s"), ("6 s^-1", "angular velocity", "6 rad/s"), ("6 1/s", "frequency", "6 Hz")),
    *(("40\u00b0", "angle", "40 deg"), ("40 \u00b0/s", "angular velocity", "40 deg/s"), ("40 DEG", "angle", "40 deg")),
    *(("40 degrees", "angle", "40 deg"), ("5 \u00b5m", "length", "5 um"), ("5 \u03bcm", "length", "5 um")),
    *(("5 inches", "length", "5 in"), ("5 KG", "mass", "5 kg"), ("5\u00a0mm", "length", "5 mm")),
    *(("5\u202fmm", "length", "5 mm"), ("\u22125 mm", "coordinate", "-5 mm"), ("\u20135 mm", "coordinate", "-5 mm")),
]


@pytest.mark.parametrize(("typed", "kind", "canonical"), SPELLINGS, ids=[f"{row[0]} ({row[1]})" for row in SPELLINGS])
def test_spellings_are_read_and_shown_in_one_way(typed, kind, canonical):
    value, unit = parse(typed, kind)
    assert parse(canonical, kind) == (value, unit)
    assert show(value, kind, unit) == canonical


def test_rotation_per_minute_is_a_revolution_and_per_second_a_radian():
    assert parse("60 1/min", "angular velocity")[0] == pytest.approx(2.0 * math.pi, rel=1e-15)
    assert parse("1 1/s", "angular velocity")[0] == 1.0
    assert parse("1 1/s", "frequency")[0] == pytest.approx(2.0 * math.pi, rel=1e-15)


@pytest.mark.parametrize("text", ["5 mN", "5 MN", "5 KN", "5 Mpa", "5 mpa", "5 MM", "5 Km", "5 Kw", "5 nm", "5 S", "5 MRAD"])
def test_case_is_never_guessed_where_a_prefix_depends_on_it(text):
    for kind in KINDS:
        with pytest.raises(UnitProblem):
            parse(text, kind)


def test_remedy_for_a_wrong_case_names_the_unit():
    with pytest.raises(UnitProblem, match=r'unknown\. Upper and lower case matter: "mm"'):
        parse("412 MM", "length")
    with pytest.raises(UnitProblem, match='"kN"'):
        parse("4 KN", "force")


# --- pint as an oracle: every unit of the table, and products of them ------------------------------------------------------


@functools.cache
def oracle():
    registry = pint.UnitRegistry(None, on_redefinition="raise")
    for definition in DEFINITIONS:
        registry.define(definition)
    return registry


NAMES = sorted({name for line in DEFINITIONS for place, name in enumerate(line.split(" = ")) if place != 1})


def pint_factor(unit, kind):
    try:
        one = oracle().Quantity(1.0, oracle().parse_units(unit.replace("^", "**")))
        return float(one.to(KINDS[kind].si).magnitude)
    except pint.DimensionalityError:
        return None


WITH_UNIT = sorted(kind for kind, one in KINDS.items() if one.display)


def own_factor(unit, kind):
    try:
        return factor(unit, kind)
    except UnitProblem as problem:
        assert "is not a unit of" in problem.message
        return None


@pytest.mark.parametrize("unit", NAMES)
def test_each_unit_has_the_factor_of_pint(unit):
    for kind in WITH_UNIT:
        assert own_factor(unit, kind) == pint_factor(unit, kind)
    assert any(own_factor(unit, kind) or own_factor(f"J/{unit}", kind) or own_factor(f"{unit}/s", kind) for kind in WITH_UNIT)


powers = st.tuples(st.sampled_from(NAMES), st.sampled_from(["", "", "^2", "^-1", "^1.5"])).map("".join)
products = st.builds(
    lambda first, rest: first + "".join(sign + unit for sign, unit in rest),
    powers,
    st.lists(st.tuples(st.sampled_from("*/"), powers), max_size=3),
)
composed = st.builds(  # units of a kind, spelled with other units of the same dimensions
    lambda kind, length, time, mass, angle: (
        kind,
        re.sub(
            "[a-z]+|N|J|Pa",
            lambda computed: {"m": length, "s": time, "kg": mass, "rad": angle}.get(computed[0], computed[0]),
            KINDS[kind].si.replace("**", "^"),
        ),
    ),
    st.sampled_from(WITH_UNIT),
    st.sampled_from(["mm", "cm", "in", "ft", "km", "um"]),
    st.sampled_from(["ms", "min", "hour"]),
    st.sampled_from(["g", "t", "lb"]),
    st.sampled_from(["deg", "rev", "mrad", "arcmin"]),
)


@examples(100)
@given(composed | products.map(lambda unit: (None, unit)))
@example(("angular velocity", "rev/min"))
@example(("stiffness", "N/mm"))
@example(("torque", "N*mm"))
def test_products_have_the_factor_of_pint(case):
    kind, unit = case
    for name in WITH_UNIT if kind is None else (kind,):
        ours, theirs = own_factor(unit, name), pint_factor(unit, name)
        if name in units._PER_TIME and theirs is None and pint_factor(f"rad*{unit}", name) is not None:
            continue  # "1/s" is the radian per second, or the hertz
        assert (ours is None) == (theirs is None)
        assert theirs is None or abs(ours - theirs) <= math.ulp(theirs)


# --- round trip ------------------------------------------------------------------------------------------------------

numbers = st.floats(1e-9, 1e9) | st.floats(-1e9, -1e-9) | st.just(0.0)


@seeded
@given(numbers, st.sampled_from(UNITS))
@example(0.1 + 0.2, UNITS[2])
def test_displayed_values_can_be_read_back(value, row):
    unit, kind, _ = row
    computed, _ = parse(show(value, kind, unit, digits=17), kind)
    assert computed == pytest.approx(value, rel=4e-16, abs=0.0)


@seeded
@given(numbers, st.sampled_from(UNITS), st.sampled_from(UNITS))
def test_units_of_one_kind_agree(value, one, other):
    """The same quantity written in two units reads as the same SI value."""
    assume(one[1] == other[1])
    a, _ = parse(show(value, one[1], one[0], 17), one[1])
    b, _ = parse(show(value, other[1], other[0], 17), other[1])
    assert a == pytest.approx(b, rel=1e-14, abs=0.0)


@seeded
@given(st.floats(1e-6, 1e6))
def test_six_digits_are_kept(value):
    assert parse(show(value, "length"), "length")[0] == pytest.approx(value, rel=5.1e-6)


def test_round_trip_detects_a_wrong_factor(monkeypatch):
    """Degrees for radians on the way back is what the property above is for."""
    assert parse(show(1.0, "angle"), "angle")[0] == pytest.approx(1.0, rel=1e-5)
    monkeypatch.setattr(units, "factor", lambda unit, kind: 1.0)
    text = show(1.0, "angle")
    monkeypatch.undo()
    assert parse(text, "angle")[0] != pytest.approx(1.0, rel=0.5)


# --- refusals --------------------------------------------------------------------------------------------------------

REFUSED = [  # text, kind, what the message says
    ("412", "length", "needs a unit"),
    (" 4.12e2 ", "length", "needs a unit"),
    (412, "length", "needs a unit"),
    (412.5, "angle", "needs a unit"),
    (0, "length", "needs a unit"),
    ("412 s", "length", "not a unit of length"),
    ("412 deg", "length", "not a unit of length"),
    ("412 mm", "angle", "not a unit of angle"),
    ("412 mm^2", "length", "not a unit of length"),
    ("412 1/mm", "length", "not a unit|not a length"),
    ("64 rpm", "angle", "not a unit of angle"),
    ("64 deg", "angular velocity", "not a unit of angular velocity"),
    ("10 kg", "force", "not a unit of force"),
    ("10 N", "mass", "not a unit of mass"),
    ("nan mm", "length", "must be finite"),
    ("NaN mm", "length", "must be finite"),
    ("inf mm", "length", "must be finite"),
    ("-inf mm", "length", "must be finite"),
    ("+Infinity mm", "length", "must be finite"),
    ("inf", "length", "must be finite"),
    (math.nan, "length", "must be finite"),
    (math.inf, "angle", "must be finite"),
    (-math.inf, "angle", "must be finite"),
    ("1e999 mm", "length", "must be finite"),
    ("-1e999 mm", "length", "must be finite"),
    ("1e308 km", "length", "must be finite"),
    ("412 furlong", "length", "unknown"),
    ("412 MM", "length", "unknown"),
    ("412 mmm", "length", "unknown"),
    ("45 degC", "angle", "unknown"),
    ("1 h", "time", "unknown"),
    ("mm", "length", "not a length"),
    ("rpm", "angular velocity", "not an? angular velocity"),
    ("", "length", "not a length"),
    ("   ", "length", "not a length"),
    ("mm 412", "length", "not a length"),
    ("four mm", "length", "not a length"),
    ("1 mm mm", "length", "not a unit"),
    ("5 m^^2", "length", "not a unit"),
    ("5 m^", "length", "not a unit"),
    ("5 m/", "length", "not a unit"),
    ("5 /m", "length", "not a unit"),
    ("5 m//s", "length", "not a unit"),
    ("5 (mm)", "length", "not a unit"),
    ("5 mm; 6 mm", "length", "not a unit"),
    ("5 mm,", "length", "not a unit"),
    ("1,5 mm", "length", "decimal comma"),
    ("1_000 mm", "length", "thousands separators"),
    ("1 000 mm", "length", "thousands separators"),
    ("0x10 mm", "length", "not a unit|unknown|not a length"),
    ("--5 mm", "length", "not a length"),
    ("5 - 3 mm", "length", "not a unit"),
    ("5*3 mm", "length", "not a unit|not a length"),
    ("1/3 mm", "length", "not a unit|not a length"),
    ("1e mm", "length", "not a unit|unknown"),
    ("5 m^99999999999", "length", "not a unit"),
    ("5 m^-1", "length", "not a unit of length"),
    ("5 m^0", "length", "not a unit"),
    ("1 um^500*km^-500*m", "length", "not a unit"),  # its factor would be zero
    ("5 mm__class__", "length", "not a unit|unknown"),
    ("5 __import__('os')", "length", "not a unit"),
    ("5 {mm}", "length", "not a unit"),
    ("\uff15 mm", "length", "not a length"),  # full-width digit
    ("\u0665 mm", "length", "not a length"),  # Arabic digit
    ("5 \uff4d\uff4d", "length", "not a unit"),  # full-width letters
    ("5 mm\0", "length", "not a unit"),
    ("½ mm", "length", "not a length"),
    ("😀", "length", "not a length"),
    ("5 😀", "length", "not a unit"),
    ("x" * 10_000, "length", "not a length"),
    ("1" * 10_000, "length", "not a length"),
    ("1 " + "m" * 10_000, "length", "not a length"),
    ("1 " + "mm" * 80, "length", "unknown"),
    ("1 m" + "*m" * 90, "length", "not a unit|not a length"),
    (True, "length", "found a logical value"),
    (None, "length", "found NoneType"),
    (["1 mm"], "length", "found a list"),
    ({"value": 1}, "length", "found a table"),
    (b"1 mm", "length", "found bytes"),
]


@pytest.mark.parametrize(("text", "kind", "says"), REFUSED, ids=[f"{str(text)[:20]!r} {kind}" for text, kind, _ in REFUSED])
def test_refused_with_a_reason_and_a_remedy(text, kind, says):
    with pytest.raises(UnitProblem) as caught:
        parse(text, kind)
    problem = caught.value
    assert re.search(says, problem.message), problem.message
    assert len(str(problem)) < 250
    # the remedy shows something that will do, whatever was written
    shown = re.findall(r'"([^"]+)"', problem.remedy)
    assert shown
    assert math.isfinite(parse(shown[-1], kind)[0])
    assert str(problem) == f"{problem.message}. {problem.remedy}"


def test_remedy_for_a_missing_unit_repeats_the_number():
    for number, text in ((412, "412 mm"), (41.25, "41.25 mm"), ("412", "412 mm"), ("4.5e2", "4.5e2 mm")):
        with pytest.raises(UnitProblem) as caught:
            parse(number, "length")
        assert f'"{text}"' in caught.value.remedy


def test_remedy_for_a_wrong_unit_names_the_kind_and_does_not_depend_on_the_value():
    remedies = set()
    for text in ("412 s", "-3 kg", "1e9 rpm", "7 furlong", "5 m^^2"):
        with pytest.raises(UnitProblem) as caught:
            parse(text, "length")
        remedies.add(caught.value.remedy)
    assert remedies == {'Use a unit of length, for example "100 mm"'}


def test_an_unknown_kind_is_a_programming_error():
    with pytest.raises(KeyError):
        parse("1 mm", "colour")


@seeded
@given(st.text(max_size=40) | st.text(alphabet="0123456789.eE+-*/^ mmradegs°µ()_", max_size=30), st.sampled_from(sorted(KINDS)))
@example("1e5mm*", "length")
@example("1 m/s*s", "length")
@example("5 m^0", "length")
@example("5 rad^0*m", "length")
@example("1 m^400/m^399", "length")
@example("1 km^999/km^998", "length")
@example("1 km^-999*km^1000", "length")
def test_any_text_is_a_quantity_or_a_unit_problem(text, kind):
    try:
        value, unit = parse(text, kind)
    except UnitProblem as problem:
        words = (problem.message, problem.remedy)
    else:
        words = ()
        assert math.isfinite(value)
        number, written = re.fullmatch(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)(.*?)\s*", plain(text), re.DOTALL).groups()
        assert value == float(number) * factor(written.strip(), kind) == float(number) * factor(unit, kind)
    assert all(words)


@pytest.mark.parametrize(
    ("share", "options", "text"),
    [
        (0.9731, {}, "97.3 %"),
        (0.53944, {"decimals": 2}, "53.94 %"),
        (-0.20931, {"decimals": 2, "signed": True}, "-20.93 %"),
        (0.0308, {"decimals": 0, "signed": True}, "+3 %"),
        (4e-4, {"decimals": 0, "signed": True}, "0 %"),
        (-4e-5, {}, "0.0 %"),
        (math.nan, {}, "-"),
    ],
)
def test_a_share_has_a_space_before_its_sign(share, options, text):
    assert percent(share, **options) == text


def test_a_counted_noun_is_singular_for_one_alone():
    assert [count_noun(n, "point") for n in (0, 1, 2, 1200)] == ["0 points", "1 point", "2 points", "1,200 points"]
    assert count_noun(1, "box is", "boxes are") == "1 box is"
    assert count_noun(3, "box is", "boxes are") == "3 boxes are"
