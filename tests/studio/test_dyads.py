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


def test_what_cannot_be_picked_is_refused(page: Page) -> None:
    curves = page.ask("dyads")[0]
    driver = next(k for k, may in enumerate(curves["drives"]) if may and curves["pivots"][k])
    usable = page.ask("dyads", driver=driver)[0]["usable"]
    bad = next(k for k, may in enumerate(usable) if not may and curves["pivots"][k] and k != driver)
    for fields, words in (
        ({"driver": driver, "follower": bad}, "does not pass the poses"),
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
