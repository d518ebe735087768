"""The glossary has the Chinese terms of the pages, and its names of optlink are real."""

from __future__ import annotations

import json
import re

import pytest
from typer.testing import CliRunner

import optlink
from docs.generate import commands, keys
from optlink.cli.app import app
from tests.documents.test_documents import PAGES, STATED
from tests.test_docs import DOCS, text_of

GLOSSARY = (DOCS / "glossary.md").read_text(encoding="utf-8")
CHINESE = re.compile(r"[\u4e00-\u9fff]{2,}")
TABLE = [[cell.strip() for cell in line[1:-1].split("|")] for line in GLOSSARY.split("\n") if line.startswith("| ")]


def words_of_optlink() -> str:
    """Keys, commands, columns, names of shipped problems, and the pages on them."""
    analysis = CliRunner().invoke(app, ["analyze", "shaper", "--step", "180 deg", "--json"]).stdout
    simulation = " ".join(json.loads(analysis)["columns"])
    pages = [
        text_of(DOCS / name) for name in ("problem-files.md", "analysis.md", "clearance.md", "conventions.md", "synthesis.md")
    ]
    return "\n".join([keys.reference(), commands.reference(), analysis, simulation, " ".join(optlink.shipped()), *pages])


def unknown(names: list[str], words: str) -> list[str]:
    """Names that do not occur among the words of optlink."""
    parts = [part for name in names for part in re.findall(r"[\w.-]+", name.replace("*", "")) if part.strip(".-_")]
    return [part for part in parts if part.strip(".") not in words]


def test_every_name_in_the_glossary_is_one_of_optlink():
    names = [name for row in TABLE for name in re.findall(r"`([^`]+)`", row[2])]
    assert len(names) > 80
    assert unknown([*names, "no_such_key"], words_of_optlink()) == ["no_such_key"]


def test_every_row_has_all_columns_and_no_term_has_two_rows():
    assert {len(row) for row in TABLE} == {7}
    terms = [term for row in TABLE if row[0] != "中文" for term in row[0].split(", ")]
    assert sorted(set(terms)) == sorted(terms)


PARTICLES = "的和與与為个加距上左右点點階軸所做"
"""Between the words of a compound: of, and, as, plus, from, on, left, right, point, order, axis."""


def unexplained(text: str) -> set[str]:
    """Chinese terms of a text that are not composed of words of the glossary."""
    words = sorted({word for row in TABLE for cell in row for word in re.findall(r"[\u4e00-\u9fff]+", cell)}, key=len)
    composed = re.compile(f"(?:{'|'.join(words)}|[{PARTICLES}])+")
    return {term for term in CHINESE.findall(text) if not composed.fullmatch(term)}


@pytest.mark.parametrize("page", PAGES)
def test_every_chinese_term_beside_a_document_is_in_the_glossary(page):
    section = (DOCS / f"{page}.md").read_text(encoding="utf-8").partition(STATED)[2].partition("\n## ")[0]
    assert len(set(CHINESE.findall(section))) > 20
    assert unexplained(section) == set()


def test_a_compound_with_a_foreign_word_is_detected():
    assert unexplained("曲柄滑塊機構參數, 摇杆与机架的夹角, 曲柄的齿轮") == {"曲柄的齿轮"}
