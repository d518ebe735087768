"""Parts in the studio: what is drawn is what is exported; sizes go into the file without a search; faults are those of files."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from typing import Any

import pytest

import optlink
from optlink.errors import InputError
from optlink.presentation.parts.layers import stacked
from optlink.presentation.parts.model import part_set
from optlink.problem.file import dump
from optlink.studio.document import Document
from tests.studio.test_session import Page, saved, values

DRAG_LINK = """title = "Drag link"
[mechanism]
crank = "100 mm"
coupler = "90 mm"
rocker = "110 mm"
frame = "40 mm"
"""


@pytest.fixture(scope="module")
def page() -> Page:
    made = Page()
    made.ask("open", name="crank-rocker")
    return made


def parts_of(page: Page) -> Mapping[str, Any]:
    (answer,) = page.ask("parts")
    assert answer["type"] == "parts"
    return answer


def extent(path: str) -> tuple[float, float]:
    """Width and height of a part whose ends are round: of the ends of its lines and arcs."""
    ends = re.findall(r"[MLA ](-?[\d.]+) (-?[\d.]+)(?=[ALMZ ]|$)", re.sub(r"A(\S+ ){4}\S+ ", "L", path.partition("Z")[0]))
    xs, ys = ([float(end[k]) for end in ends] for k in (0, 1))
    return max(xs) - min(xs), max(ys) - min(ys)


@pytest.mark.slow
def test_parts_have_the_sizes_of_the_design_and_the_layers_of_the_export(page: Page) -> None:
    lengths = values(page.state("search")) | {"crank": 100.0, "frame": 500.0}
    shown = parts_of(page)
    result = optlink.solve(saved(page), certify=False)
    made = stacked(part_set(optlink.analyze(result.machine)))
    assert {one["name"]: one["layer"] for one in shown["parts"]} == made.layers
    for one in shown["parts"]:
        width = one["fields"][0]["value"]
        assert width == made.parts.parts[one["name"]].width
        assert extent(one["path"]) == pytest.approx((lengths[one["name"]], width), abs=1e-6)
        assert one["path"].count("M") == 3  # its edge and two holes
    assert {pin["joint"]: pin["layer"] for pin in shown["pins"]} == {"A": 2, "B": 4, "C": 4, "D": 1}  # the upper part of each


@pytest.mark.slow
def test_a_size_of_a_part_goes_into_the_file_without_a_search(page: Page) -> None:
    before = page.state("search")
    answers = page.ask("edit", tables={"parts": {"width": "60 mm", "links": {"rocker": {"thickness": "4 mm"}}}})
    assert [answer["searching"] for answer in answers] == [False]
    assert (answers[0]["status"], answers[0]["conclusion"]) == ("verified", before["conclusion"])
    assert values(answers[0]) == values(before)
    assert saved(page).raw["parts"] == {"width": "60 mm", "links": {"rocker": {"thickness": "4 mm"}}}
    rocker = next(one for one in parts_of(page)["parts"] if one["name"] == "rocker")
    assert [one["value"] for one in rocker["fields"]] == [60.0, 4.0]
    assert [one["stated"] for one in rocker["fields"]] == [None, "4 mm"]
    assert len(page.ask("undo")) == 1
    assert "parts" not in saved(page).raw
    moved = page.ask("drag", handle="mechanism.frame", value=505.0, moving=False)
    assert any(answer["searching"] for answer in moved)  # another problem is searched
    page.ask("undo")


@pytest.mark.parametrize(
    "parts", [{"width": "5 mm"}, {"links": {"arm": {}}}, {"hole": "-2 mm"}, {"hole": "8 kg"}, {"joints": {"C": {"pin": "90 mm"}}}]
)
def test_bad_sizes_are_refused_with_the_sentences_of_files(page: Page, parts: dict[str, Any]) -> None:
    text = page.ask("save")[0]["text"]
    (answer,) = page.ask("edit", tables={"parts": parts})
    with pytest.raises(InputError) as refused:
        part_set(
            optlink.analyze(
                optlink.validate(
                    optlink.load("crank-rocker").override({"parts": parts}), {"coupler": 0.4129, "rocker": 0.2322}
                ).machine
            )
        )
    assert answer["type"] == "fault"
    assert answer["message"] == str(refused.value)
    assert page.ask("save")[0]["text"] == text


@pytest.mark.slow
def test_links_that_cannot_be_stacked_are_named_with_their_crank_angle() -> None:
    page = Page()
    page.ask("open", text=DRAG_LINK, title="drag-link")
    shown = parts_of(page)
    assert re.fullmatch(
        r"The links cannot be stacked: (pin )?\w+ and (pin )?\w+ collide at a crank angle of [\d.]+ deg\. .*", shown["refused"]
    )
    assert f"{shown['at']:.4g} deg" in shown["refused"]
    assert {one["layer"] for one in shown["parts"]} == {None}
    assert page.ask("export", format="parts.svg")[0]["type"] == "file"  # they can be cut all the same
    page.ask("new", template="cam-follower")
    shown = parts_of(page)
    assert "not supported as a part" in shown["refused"]
    assert "parts" not in shown


@pytest.mark.parametrize(
    ("format", "begin"),
    [
        ("parts.svg", b"<svg"),
        ("parts.3mf", b"PK"),
        pytest.param("parts.stl", b"", marks=pytest.mark.slow),
    ],
)
def test_the_files_of_the_parts_are_those_of_the_command(page: Page, format: str, begin: bytes) -> None:
    page.ask("edit", tables={"parts": {"width": "61 mm"}})
    answer = page.ask("export", format=format)[0]
    page.ask("undo")
    assert answer["name"] == f"crank-rocker.{format}"
    data = base64.b64decode(answer["data"])
    assert data.startswith(begin)
    if format == "parts.svg":
        assert "A30.5 30.5" in data.decode()
    if format == "parts.stl":
        assert len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")


def test_parts_of_a_design_that_is_not_valid_are_not_written() -> None:
    problem = optlink.load("crank-rocker", {"mechanism.coupler": "300 mm", "mechanism.rocker": "200 mm"})
    page = Page()
    page.session._begin([Document("fixed", dump(problem), problem.folder)])
    assert page.sent[-1]["status"] == "not valid"
    assert "Nothing was written" in page.ask("export", format="parts.svg")[0]["message"]
