"""Families of linkages in the studio: curves, partners and the picked linkage as a step of the problem."""

from __future__ import annotations

import math
import tomllib
from typing import Any

import pytest
import tomli_w

import optlink
from optlink.problem.file import read
from tests.studio.test_session import Page
from tests.tasks.test_four_poses import posed
from tests.tasks.test_four_targets import function, slide, timed


@pytest.fixture(scope="module")
def page() -> Page:
    made = Page(patient=False)
    made.ask("open", name="motion-4-poses")
    return made


def test_two_picked_dyads_are_a_verified_step_that_is_saved(page: Page) -> None:
    curves = page.ask("dyads")[0]
    assert len(curves["points"]) == len(curves["pivots"]) == len(curves["drives"])
    driver = next(
        k for k, may in enumerate(curves["drives"]) if may and math.dist(curves["pivots"][k] or [1e9, 0], [-77, -96]) < 5.0
    )
    usable = page.ask("dyads", driver=driver)[0]["usable"]
    follower = next(k for k, may in enumerate(usable) if may and math.dist(curves["pivots"][k] or [1e9, 0], [314, -80]) < 5.0)
    answers = page.ask("dyads", driver=driver, follower=follower)
    assert [answer["type"] for answer in answers] == ["state"]
    state = answers[0]
    assert state["status"] == "verified"
    assert state["document"]["can_undo"]
    shown = {one["name"]: one["value"] for one in state["variables"]}
    assert shown["A.x"] == pytest.approx(curves["pivots"][driver][0], abs=1e-3)
    saved = read(tomllib.loads(page.ask("save")[0]["text"]), "saved.toml")
    starts = {name: quantity.value for name, quantity in saved.model.quantities.items() if quantity.free}
    result = optlink.validate(saved, starts)
    assert result.best.exact
    assert result.best.values["crank"] == pytest.approx(math.dist(curves["pivots"][driver], curves["points"][driver]) / 1e3)
    page.ask("undo")
    assert "start" not in page.ask("save")[0]["text"]


def nearest(places: list[list[float] | None], place: list[float]) -> int:
    return min(range(len(places)), key=lambda k: math.dist(places[k] or (1e9, 0.0), place))


def test_the_dyads_of_a_design_at_its_bound_are_a_pair_of_their_own() -> None:
    """The frame of the best four-bar is as long as may be; the drawn points beside its dyads have longer ones."""
    page = Page()
    state = page.state("open", name="motion-4-poses")
    frame = next(one["value"] for one in state["variables"] if one["name"] == "frame")
    assert frame == pytest.approx(400.0, abs=1e-3)
    curves = page.ask("dyads")[0]
    driver = nearest(curves["pivots"], state["scene"]["points"]["A"][0])
    partners = page.ask("dyads", driver=driver)[0]
    follower = nearest(partners["pivots"], state["scene"]["points"]["D"][0])
    assert math.dist(curves["pivots"][driver], partners["pivots"][follower]) == pytest.approx(frame, abs=1e-5)
    assert partners["usable"][follower]
    picked = page.ask("dyads", driver=driver, follower=follower)[0]
    assert {one["name"]: one["value"] for one in picked["variables"]}["frame"] == pytest.approx(frame, abs=1e-6)
    assert picked["status"] == "verified"


@pytest.mark.slow
def test_the_design_of_two_poses_with_given_pivots_lies_on_both_lines() -> None:
    file, _, given, _ = posed(2, 0)
    page = Page()
    points = page.state("open", text=tomli_w.dumps(file.override(given).raw), title="two poses")["scene"]["points"]
    curves = page.ask("dyads")[0]
    driver = nearest(curves["points"], points["B"][0])
    partners = page.ask("dyads", driver=driver)[0]
    follower = nearest(partners["points"], points["C"][0])
    assert curves["points"][driver] == pytest.approx(points["B"][0], abs=0.006)
    assert partners["points"][follower] == pytest.approx(points["C"][0], abs=0.006)
    assert partners["usable"][follower]


def test_bounds_that_leave_no_pair_have_no_driver() -> None:
    page, short = Page(patient=False), optlink.load("motion-4-poses").override({"mechanism.crank.bounds": ["10 mm", "11 mm"]})
    page.ask("open", text=tomli_w.dumps(short.raw), title="short")
    curves = page.ask("dyads")[0]
    assert not any(curves["drives"])
    assert "No linkage of these curves" in curves["hint"]


def test_what_cannot_be_picked_is_refused(page: Page) -> None:
    curves = page.ask("dyads")[0]
    driver = next(k for k, may in enumerate(curves["drives"]) if may and curves["pivots"][k])
    defect = optlink.synthesis.dyad_curves("motion-4-poses").partners([driver]).defect[0]
    bad = next(k for k, found in enumerate(defect) if found == 1)
    outside = next(k for k, found in enumerate(defect) if found == 0 and not page.ask("dyads", driver=driver)[0]["usable"][k])
    for fields, words in (
        ({"driver": driver, "follower": bad}, "does not pass the poses"),
        ({"driver": driver, "follower": outside}, "allowed"),
        ({"driver": -1}, "no such dyad"),
        ({"driver": "first"}, "no such dyad"),
        ({"driver": "first", "follower": 2}, "driver"),
    ):
        answers = page.ask("dyads", **fields)
        assert answers[0]["type"] == "fault"
        assert words in answers[0]["message"]
    other = Page(patient=False)
    assert not other.state("open", name="six-bar")["dyads"]
    assert not other.state("open", name="motion-3-poses")["dyads"]
    assert "only four poses, timed points or positions" in other.ask("dyads")[0]["message"]


@pytest.mark.slow
@pytest.mark.parametrize("raw", [function(0, 4)[0], slide(0, 4)[0], timed(0)[0]], ids=["function", "slide", "timed points"])
def test_a_picked_linkage_has_its_joints_where_the_curves_have_them(raw: dict[str, Any]) -> None:
    """The linkage that is drawn, at its first position, is an independent check of the places of the curves."""
    page = Page(patient=False)
    assert page.ask("open", text=tomli_w.dumps(raw), title="targets")[0]["dyads"]
    curves = page.ask("dyads")[0]
    driver = curves["drives"].index(True, 70)
    ends, follower = {"B": curves["pivots"][driver], "C": curves["points"][driver]}, 0
    if not curves["single"]:
        partners = page.ask("dyads", driver=driver)[0]
        follower = partners["usable"].index(True)
        ends = {"A": curves["pivots"][driver], "B": curves["points"][driver]}
        ends |= {"D": partners["pivots"][follower], "C": partners["points"][follower]}
    state = page.ask("dyads", driver=driver, follower=follower)[0]
    assert state["status"] == "verified"
    for name, place in ends.items():
        assert math.dist(state["scene"]["points"][name][0], place) < 0.006  # that of the scene is rounded
