"""Exact solutions in the studio: the list of the command line, and a chosen one as a step of the problem."""

from __future__ import annotations

import pytest

import optlink
from tests.studio.test_session import Page, saved


@pytest.fixture(scope="module")
def page() -> Page:
    made = Page(patient=False)
    made.ask("open", name="motion-4-poses")
    made.patient = True
    return made


@pytest.mark.slow
def test_the_list_is_that_of_the_command_with_a_scene_of_each() -> None:
    page = Page(patient=False)
    assert page.state("open", name="motion-5-poses")["solutions"]
    page.patient = True
    listed = page.ask("solutions")[0]
    found = optlink.synthesis.exact("motion-5-poses").exact_solutions
    assert found is not None
    assert (listed["count"], listed["usable"]) == (len(found.solutions), found.usable) == (12, 1)
    for item, one in zip(listed["items"], found.solutions, strict=True):
        assert item["usable"] == one.usable
        assert [reason.partition(":")[0] for reason in item["reasons"]] == [reason.partition(":")[0] for reason in one.reasons]
        link = next(body for body in item["scene"]["bodies"] if body["name"] == "crank")
        (x, y), (u, v) = link["parts"][0]["outline"]
        assert ((u - x) ** 2 + (v - y) ** 2) ** 0.5 == pytest.approx(1e3 * one.values["crank"], rel=1e-3)
    assert "no such usable solution" in page.ask("solutions", chosen=1)[0]["message"]
    assert not page.state("open", name="crank-rocker")["solutions"]
    assert "list of exact solutions" in page.ask("solutions")[0]["message"]


@pytest.mark.slow
def test_the_ranking_is_chosen_in_words(page: Page) -> None:
    listed = page.ask("solutions", by="total length")[0]
    lengths = [item["figure"] for item in listed["items"]]
    assert lengths == sorted(lengths)
    assert (listed["by"], listed["unit"]) == ("total length of the links", "mm")
    five = Page(patient=False)
    five.ask("open", name="motion-5-poses")
    five.patient = True
    for way in listed["ways"][1:]:
        assert five.ask("solutions", by=way)[0]["type"] == "solutions"
    assert "not a quantity of the machine" in five.ask("solutions", by="beauty")[0]["message"]


@pytest.mark.slow
def test_a_chosen_solution_is_a_verified_step_that_is_saved(page: Page) -> None:
    listed = page.ask("solutions")[0]
    state = page.ask("solutions", chosen=2)[0]
    assert (state["type"], state["status"], state["document"]["can_undo"]) == ("state", "verified", True)
    problem = saved(page)
    starts = {name: quantity.value for name, quantity in problem.model.quantities.items() if quantity.free}
    result = optlink.validate(problem, starts)
    assert result.valid
    assert result.best.least_transmission * 57.29577951 == pytest.approx(listed["items"][2]["figure"], abs=1e-6)
    (parted,) = page.ask("edit", tables={"parts": {"width": "20 mm"}})
    assert parted["variables"] == state["variables"]  # the other best design does not take its place
    page.ask("undo")
    page.ask("undo")
    assert "start" not in page.ask("save")[0]["text"]
