"""Linked quantities as they are read: their grammar, kinds, order and values, and the errors of bad links."""

from __future__ import annotations

import math

import numpy as np
import pytest

import optlink
from optlink.problem.file import fixed_design, read

LAW = """
[mechanism]
frame = "500 mm"
crank = "100 mm"
coupler = "300..900 mm"
rocker = { equals = "0.5*coupler + 3 mm" }
[requirement]
law = "psi0 + 0.2*(phi - phi0)"
from = "0..90 deg"
psi0 = "0..180 deg"
span = "60 deg"
"""
DYADS = """
[mechanism.ground]
A = ["0 mm", "0 mm"]
D = [{ equals = "A.x + 3*crank.length" }, "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "40 mm" }
coupler = { joints = ["B", "C"], length = { equals = "rocker.length" } }
rocker = { joints = ["C", "D"], length = "90 mm", points = { P = [{ equals = "2*rocker.length" }, "0 mm"] } }
[mechanism.assembly]
C = "left of B-D"
"""


def law(key: str, equals: str, text: str = LAW) -> optlink.ProblemFile:
    return read(text).override({key: {"equals": equals}})


VALUES = [  # with coupler 600, phi0 45, psi0 90 at the middle of their bounds
    ("crank", 0.1),
    ("2*crank - 50 mm", 0.15),
    ("-crank + frame", 0.4),
    ("3mm + 1 in + 0.2 m + crank", 0.003 + 0.0254 + 0.2 + 0.1),
    ("sqrt(crank*frame)", math.sqrt(0.05)),
    ("crank^2/frame", 0.02),
    ("(crank^3)^(1/3)", 0.1),
    ("frame*cos(60 deg)", 0.25),
    ("crank*(1 + tan(phi0))", 0.2),
    ("crank*(1 + tan(start))", 0.2),
    ("crank*psi0", 0.1 * math.pi / 2.0),
    ("abs(crank - frame)", 0.4),
    ("crank*acos(crank/frame)/(60\N{DEGREE SIGN})", 0.1 * math.acos(0.2) / (math.pi / 3.0)),
    ("crank*exp(crank/frame)", 0.1 * math.exp(0.2)),
    ("crank + 0*(3 mm)", 0.1),
    ("pi*crank/2", 0.05 * math.pi),
]


@pytest.mark.parametrize(("equals", "value"), VALUES)
def test_the_value_of_a_link_follows_from_the_other_quantities(equals, value):
    problem = law("mechanism.rocker", equals).model
    assert problem.quantities["rocker"].value == pytest.approx(value, rel=1e-14)
    assert problem.quantities["rocker"].equals
    assert "rocker" not in (*problem.free, *problem.fixed)


@pytest.mark.parametrize(
    ("equals", "value"),
    [
        ("180 deg - phi0", 0.75 * math.pi),
        ("180\N{DEGREE SIGN} - 2*phi0", 0.5 * math.pi),
        ("pi - start", 0.75 * math.pi),
        ("pi/2 - 2*pi/8 + start", 0.5 * math.pi),
        ("atan(crank/frame) + 1 rad", math.atan(0.2) + 1.0),
        ("phi0*crank/frame", 0.05 * math.pi),
        ("0.5*acos(2*crank/frame)", 0.5 * math.acos(0.4)),
    ],
)
def test_an_angle_can_be_linked(equals, value):
    problem = law("requirement.psi0", equals).model
    assert problem.quantities["psi0"].value == pytest.approx(value, rel=1e-14)
    assert problem.start_position(problem.complete({})).psi0 == pytest.approx(value, rel=1e-14)


def test_links_follow_one_another_in_any_order():
    problem = read(LAW).override(
        {"mechanism.crank": {"equals": "rocker/3"}, "mechanism.frame": {"equals": "crank + rocker + 100 mm"}}
    )
    assert list(problem.model.links) == ["rocker", "crank", "frame"]
    values = problem.model.complete({"coupler": np.array([0.4, 0.5])})
    np.testing.assert_allclose(values["rocker"], [0.203, 0.253])
    np.testing.assert_allclose(values["crank"], [0.203 / 3.0, 0.253 / 3.0])
    np.testing.assert_allclose(values["frame"], [0.1 + 0.203 * 4.0 / 3.0, 0.1 + 0.253 * 4.0 / 3.0])


def test_a_stated_value_is_kept():
    problem = read(LAW).model
    assert problem.complete({"rocker": 0.2, "coupler": 0.5})["rocker"] == 0.2
    assert problem.design({"coupler": 0.5})["rocker"] == pytest.approx(0.253, rel=1e-15)


def test_every_dimension_of_dyads_has_a_name():
    problem = read(DYADS).model
    assert {name: problem.quantities[name].value for name in problem.links} == pytest.approx(
        {"D.x": 0.12, "coupler.length": 0.09, "rocker.P.along": 0.18}
    )
    sizes = problem.machine({"crank.length": 0.03, "rocker.length": 0.1}).sizes
    assert (sizes["D.x"], sizes["coupler.length"], sizes["rocker.P.along"]) == pytest.approx((0.09, 0.1, 0.2))


def test_changes_of_other_quantities_reach_the_link_and_a_value_replaces_it():
    problem = read(LAW)
    assert problem.override({"mechanism.coupler": "400 mm"}).model.quantities["rocker"].value == pytest.approx(0.203)
    replaced = problem.override({"mechanism.rocker": "250 mm"}).model
    assert not replaced.links
    assert "rocker" in replaced.fixed
    assert problem.override({"mechanism.rocker": 0.25}).model.design({}) == replaced.design({})  # SI, as of every quantity
    assert problem.override({"mechanism.rocker": "200..300 mm"}).model.free == ("coupler", "rocker", "phi0", "psi0")
    bounded = problem.override({"mechanism.rocker": {"equals": "0.5*coupler + 3 mm", "bounds": ["200 mm", "300 mm"]}})
    assert bounded.model.quantities["rocker"].bounds == (0.2, 0.3)
    wider = bounded.override({"mechanism.rocker.max": "310 mm"}).model.quantities["rocker"]
    assert (wider.bounds, wider.equals) == (pytest.approx((0.2, 0.31)), "0.5*coupler + 3 mm")


def test_a_fixed_design_has_numbers_in_place_of_links():
    problem = read(LAW)
    machine = fixed_design(problem, problem.model.design({"coupler": 0.5}))
    assert not machine.model.links
    assert machine.model.quantities["rocker"].value == pytest.approx(0.253, rel=1e-15)


def test_the_hash_depends_on_the_link_not_only_on_its_value():
    fixed = read(LAW).override({"mechanism.rocker": "303 mm"})
    assert read(LAW).model.quantities["rocker"].value == pytest.approx(fixed.model.quantities["rocker"].value)
    assert read(LAW).hash != fixed.hash


def test_the_text_of_a_linked_quantity_shows_link_bounds_and_value():
    quantity = law("mechanism.rocker", "crank").model.quantities["rocker"]
    assert str(quantity) == "= crank, 100 mm"
    bounded = read(LAW.replace('+ 3 mm" }', '+ 3 mm", bounds = "200..400 mm" }')).model.quantities["rocker"]
    assert str(bounded) == "= 0.5*coupler + 3 mm, 200 mm ... 400 mm, 303 mm"


def test_a_link_in_a_file_without_a_law_is_no_fault_of_optlink():
    with pytest.raises(optlink.InputError, match="law"):
        read(DYADS + '[requirement]\nkind = "function"\noutput = "rocker"\n')
