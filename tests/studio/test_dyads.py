"""Dyads of four poses in the studio: curves, partners and the picked four-bar as a step of the problem."""

from __future__ import annotations

import math
import tomllib

import pytest

import optlink
from optlink.problem.file import read
from optlink.studio import dyads
from tests.studio.test_session import Page


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


def test_the_dyads_of_a_design_at_its_bound_are_a_pair_of_their_own() -> None:
    """The frame of the best four-bar is as long as may be; the drawn points beside its dyads have longer ones."""
    page = Page()
    state = page.state("open", name="motion-4-poses")
    frame = next(one["value"] for one in state["variables"] if one["name"] == "frame")
    assert frame == pytest.approx(400.0, abs=1e-3)
    curves = page.ask("dyads")[0]
    driver, follower = len(curves["pivots"]) - 3, len(curves["pivots"]) - 1
    assert math.dist(curves["pivots"][driver], curves["pivots"][follower]) == pytest.approx(frame, abs=1e-5)
    usable = page.ask("dyads", driver=driver)[0]["usable"]
    assert usable[follower]
    near = [math.dist(at or (1e9, 0.0), curves["pivots"][follower]) for at in curves["pivots"][:-3]]
    assert not usable[near.index(min(near))]
    picked = page.ask("dyads", driver=driver, follower=follower)[0]
    assert {one["name"]: one["value"] for one in picked["variables"]}["frame"] == pytest.approx(frame, abs=1e-6)
    assert picked["status"] == "verified"


def test_bounds_that_leave_no_pair_have_no_driver(page: Page) -> None:
    short = optlink.load("motion-4-poses").override({"mechanism.crank.bounds": ["10 mm", "11 mm"]})
    assert not any(dyads.curves(short, None)["drives"])


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
    assert "only four poses" in other.ask("dyads")[0]["message"]
