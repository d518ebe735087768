"""The forms of the page for elements and drives: from the schema, with the sentences of the command line, into the file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

import optlink
from optlink.errors import InputError
from optlink.problem.mechanism import DyadsSection
from optlink.problem.renaming import kinds
from optlink.problem.templates import template
from optlink.studio import forms
from optlink.studio.document import from_template
from optlink.studio.picture import Picture
from tests.studio.test_session import Page, saved

DATA = Path(__file__).parents[1] / "data"
TRAIN = "mechanism.gears.train"
GEARED = {"bodies": ["crank", "second"], "teeth": [40, 20], "phase": "60 deg"}


@pytest.fixture
def page() -> Page:
    """The geared five-bar; what is done with it is undone by opening it again."""
    made = Page(patient=False)
    made.ask("new", template="geared-five-bar")
    return made


def text(page: Page) -> str:
    return str(page.ask("save")[0]["text"])


def group(problem: optlink.ProblemFile, key: str) -> dict[str, Any]:
    return next(one for one in forms.groups(problem) if one["key"] == key)


def test_every_table_of_a_linkage_has_a_form_with_the_keys_of_its_model():
    problem = from_template("geared-five-bar").problem
    sections = {one["key"]: one["form"] for one in forms.groups(problem)}
    assert {"drive", "drives"} < set(sections)
    for name, field in DyadsSection.model_fields.items():
        assert (f"mechanism.{name}" in sections) == (name != "type"), name
        for model in getattr(field.annotation, "__args__", ())[1:]:
            if hasattr(model, "model_fields"):
                assert list(sections[f"mechanism.{name}"]["of"]["fields"]) == list(model.model_fields)
    assert sections["mechanism.cylinders"]["of"]["required"] == ["joints", "closed", "open"]
    segment = sections["mechanism.cams"]["of"]["fields"]["law"]["of"]["fields"]
    assert list(segment) == ["to", "rise", "fall", "law"]
    assert "modified sine" in segment["law"]["options"]
    assert [one["is"] for one in sections["drive"]["fields"]["law"]["of"]] == ["text", "list", "table"]
    assert group(problem, TRAIN.rpartition(".")[0])["value"] == {"train": GEARED}
    assert kinds(problem).items() >= {"A": "joint", "crank": "body", "frame": "body"}.items()


def test_a_four_bar_has_the_forms_of_its_drives_points_and_parts():
    assert [one["key"] for one in forms.groups(optlink.load("crank-rocker"))] == ["drive", "drives", "mechanism.points", "parts"]


def test_a_change_keeps_the_comments_and_is_read_as_on_the_command_line(page: Page) -> None:
    page.ask("edit", tables={TRAIN: GEARED | {"teeth": ["60", "20"]}})
    before = template("geared-five-bar").text
    assert text(page) == before.replace("teeth = [40, 20]", "teeth = [60, 20]")
    page.ask("undo")
    assert text(page) == before


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({TRAIN: GEARED | {"teeth": ["0", "20"]}}, f"{TRAIN}.teeth"),
        ({TRAIN: GEARED | {"phase": "60"}}, f"{TRAIN}.phase"),
        ({"drive": {"speed": "60 rpm", "range": ["40 deg", "20 deg"]}}, "drive.range"),
        ({"drive": {"law": [{"time": "0 s", "to": "90 deg"}]}}, "drive.law[0].time"),
        ({"mechanism.cylinders.ram": {"joints": ["A", "C"], "closed": "90 mm", "open": "80 mm"}}, "mechanism.cylinders.ram.open"),
    ],
)
def test_an_error_names_its_field_with_the_sentence_of_the_command_line(page: Page, change: dict[str, Any], key: str) -> None:
    (answer,) = page.ask("edit", tables=change)
    assert answer["type"] == "fault"
    problem = from_template("geared-five-bar").problem
    changes = forms.changes(problem, change)
    with pytest.raises(InputError) as refused:
        problem.override(changes)
    (fault,) = refused.value.faults
    sentence = f"{fault.message}. {fault.remedy.rstrip('.')}."
    assert answer["faults"] == [{"key": key, "text": sentence[:1].upper() + sentence[1:]}]
    assert fault.message in answer["message"]
    assert text(page) == template("geared-five-bar").text


def test_an_element_takes_the_place_of_another_in_one_step(page: Page) -> None:
    assert page.ask("edit", tables={TRAIN: None})[0]["faults"][0]["key"] == "mechanism.links.arm"  # would hang freely
    belt = {"bodies": ["crank", "second"], "diameters": ["80 mm", "40 mm"], "crossed": True}
    state = page.ask("edit", tables={TRAIN: None, "mechanism.belts.belt1": belt})[-1]
    assert state["type"] == "state"
    raw = saved(page).raw["mechanism"]
    assert "gears" not in raw
    assert raw["belts"] == {"belt1": belt}
    assert "# shaft of the second crank" in text(page)
    assert "\n\n[mechanism.belts]\nbelt1 = {" in text(page)
    assert "}\n\n[bodies]" in text(page)
    back = page.ask("undo")[-1]
    assert next(one["value"] for one in back["tables"] if one["key"] == "mechanism.gears") == {"train": GEARED}


def test_a_drive_becomes_two_with_a_law_over_the_time(page: Page) -> None:
    law = [{"time": "0.5 s", "to": "90 deg"}, {"time": "1.5 s", "to": "0 deg", "law": "modified sine"}]
    two = {"one": {"body": "crank", "speed": "60 rpm"}, "two": {"body": "second", "law": law}}
    state = page.ask("edit", tables={TRAIN: None, "drive": None} | {f"drives.{name}": one for name, one in two.items()})[-1]
    assert (state["scene"]["drive"]["label"], state["scene"]["drive"]["unit"]) == ("time", "s")
    assert state["scene"]["drive"]["values"][0] == 0.0
    assert state["scene"]["drive"]["values"][-1] == 2.0  # the common period
    assert {chart["x"]["unit"] for chart in state["charts"]} == {"s"}
    assert saved(page).raw["drives"] == two
    assert "drive" not in saved(page).raw


def test_a_cylinder_moves_over_its_range_in_millimetres(page: Page) -> None:
    state = page.ask("new", template="lift")[-1]
    positions = state["scene"]["drive"]
    assert (positions["label"], positions["unit"]) == ("length of lift", "mm")
    assert positions["values"] == pytest.approx([800.0 + 500.0 * k / 72 for k in range(73)], abs=1e-2)
    assert not state["scene"]["closed"]
    assert "Driving force" in [chart["title"] for chart in state["charts"]]
    state = page.ask("edit", tables={"mechanism.cylinders.lift": {"joints": ["G", "M"], "closed": "0.85 m", "open": "1.3 m"}})[-1]
    assert state["scene"]["drive"]["values"][0] == pytest.approx(850.0, abs=1e-2)
    assert 'closed = "0.85 m"' in text(page)


def test_a_range_limits_the_positions_that_are_shown() -> None:
    problem = from_template("hood").problem
    machine = optlink.load(DATA / "driven" / "rack-and-sector.toml").model.machine()
    assert Picture(machine, 0.0).closed == (machine.mechanism.limits is None)
    picture = Picture(problem.model.machine(problem.model.design({})), 0.0, driving=problem.model.driving)
    assert not picture.closed
    assert picture.complete
    assert picture.axis(picture.angles)["values"][0] == 0.0
    assert picture.axis(picture.angles)["values"][-1] == 75.0
    assert math.isclose(picture.angles[-1], math.radians(75.0))


def test_the_pins_of_a_cylinder_are_dragged_like_other_joints(page: Page) -> None:
    before = page.ask("new", template="excavator-arm")[-1]
    handle = next(one for one in before["handles"] if one["id"] == "mechanism.ground.G.x")
    assert (handle["kind"], handle["at"]) == ("point", [0.0, 0.0])
    after = page.ask("drag", handle=handle["id"], at=[-10.0, 5.0], moving=False)[-1]
    assert after["scene"]["points"]["G"][0] == [-10.0, 5.0]
    assert [saved(page).model.quantities[name].value for name in ("G.x", "G.y")] == pytest.approx([-0.01, 0.005])
    assert len(after["scene"]["points"]["C"]) == len(after["scene"]["drive"]["values"])


def test_other_files_are_not_named_on_the_page(page: Page) -> None:
    (answer,) = page.ask("edit", tables={"drive": {"law": {"csv": "law.csv"}}})
    assert "cannot name a file" in answer["message"]
    assert page.ask("edit", tables=["drive"])[0]["message"].startswith("tables")


def test_a_problem_of_all_elements_round_trips_through_its_forms() -> None:
    """Tables that come back as they were sent change nothing."""
    for path in sorted((DATA / "driven").glob("*.toml")):
        problem = optlink.load(path)
        for one in forms.groups(problem):
            if one["value"] is not None:
                assert forms.changes(problem, {one["key"]: one["value"]}) == {one["key"]: one["value"]}, path
