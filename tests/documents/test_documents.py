"""The pages of the four systems beside their documents: each charged fault quotes the document, each number is computed.

A page has a table of symbols and values under the heading `The document and optlink`, and one of its faults under `Faults of
the document`, whose first cells are the place and the quotation. The module `tests/documents/<page>.py` has the same faults as
`FAULTS`, with their computations, and as `COMPUTED` the values that no command prints.
"""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from tests.documents.faults import Fault
from tests.tiers import mostly_slow

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import readme

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = ("crank-rocker", "six-bar", "shaper", "slider-crank")
HEADING = "## Faults of the document"
QUOTED = re.compile(r"\S.*: 「[^」]+」$")
NUMBER = re.compile(r"(?<![\w.+(])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.)])")


def rows(text: str) -> list[list[str]]:
    """Cells of the table of faults of a page."""
    section = text.partition(HEADING)[2].partition("\n## ")[0]
    lines = [line for line in section.split("\n") if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[2:]]


def wrong(text: str, faults: list[Fault]) -> list[str]:
    """What is charged without a source line, or with another number than the computed one."""
    found, known = [], {fault.cell: fault for fault in faults}
    for cell, *others in rows(text):
        fault = known.pop(cell, None)
        if not QUOTED.match(cell) or fault is None:
            found.append(f"{cell}: no quotation, or no computation")
            continue
        if not fault.figures and fault.holds is None:
            found.append(f"{cell}: nothing shows it")
        if fault.holds is not None and not fault.holds():
            found.append(f"{cell}: does not hold")
        printed = " | ".join(others)
        for figure, compute in fault.figures.items():
            digits = len(figure.partition(".")[2].partition("e")[0])
            scale = 10.0 ** float(figure.partition("e")[2] or 0.0)
            if figure not in NUMBER.findall(printed):
                found.append(f"{cell}: {figure} is not in its row")
            if not abs(compute() - float(figure)) <= 0.5000001 * scale * 10.0**-digits:
                found.append(f"{cell}: {figure} is {compute()!r}")
    return [*found, *(f"{cell}: not on the page" for cell in known)]


@pytest.mark.parametrize("page", PAGES)
def test_each_fault_of_a_document_quotes_it_and_is_computed(page):
    faults = importlib.import_module(f"tests.documents.{page.replace('-', '_')}").FAULTS
    assert faults
    assert wrong((DOCS / f"{page}.md").read_text(encoding="utf-8"), faults) == []


TABLE = f"""
{HEADING}

| the document | right | seen by |
|---|---|---|
| eq. (2): 「c = 5.1」 | 5.00 | the sides 3 and 4 |

## Next
"""


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("5.00", "5.00", None),
        ("eq. (2): 「c = 5.1」", "it is 5.1", "no quotation"),
        ("c = 5.1", "c = 5.2", "no computation"),
        ("5.00", "5.10", "is not in its row"),
    ],
)
def test_a_charge_without_a_line_of_the_document_is_detected(old, new, word):
    found = wrong(TABLE.replace(old, new), [Fault("eq. (2)", "c = 5.1", {"5.00": lambda: (3.0**2 + 4.0**2) ** 0.5})])
    assert bool(found) == (word is not None)
    assert word is None or any(word in line for line in found)


def test_a_wrong_number_of_a_charge_is_detected():
    assert wrong(TABLE, [Fault("eq. (2)", "c = 5.1", {"5.00": lambda: 5.01})])
    assert wrong(TABLE, [Fault("eq. (2)", "c = 5.1", holds=lambda: False)])
    assert wrong(TABLE, [Fault("eq. (2)", "c = 5.1")])


# --- the table of symbols and values ---------------------------------------------------------------------------------------

STATED = "## The document and optlink"


def uncomputed(text: str, figures: list[readme.Figure], own: Mapping[str, Mapping[str, Callable[[], float]]]) -> list[str]:
    """Numbers in the column `value` that neither a figure of benchmarks/readme_figures.py nor an own computation gives."""
    found = []
    section = text.partition(STATED)[2].partition("\n## ")[0]
    table = [line for line in section.split("\n") if line.startswith("|")]
    for line in table[2:]:
        cells = [cell.strip() for cell in line.strip("|").replace("| |", "|  |").split(" | ")]
        words = " ".join(line.split())
        marked = {
            readme.NUMBER.search(figure.text)[1] for figure in figures if readme.NUMBER.sub(r"\1", figure.text).strip() in words
        }
        for number in NUMBER.findall(cells[3]):
            compute = own.get(cells[0], {}).get(number)
            near = 0.5000001 * 10.0 ** -len(number.partition(".")[2])
            if compute is not None and not abs(compute() - float(number)) <= near:
                found.append(f"{cells[0]}: {number} is {compute()!r}")
            if compute is None and number not in marked:
                found.append(f"{cells[0]}: nothing computes {number}")
    return found if len(table) > 2 else ["no table"]


@pytest.mark.parametrize("page", mostly_slow(PAGES, *(page for page in PAGES if page != "slider-crank")))
def test_each_value_beside_a_document_is_computed(page):
    module = importlib.import_module(f"tests.documents.{page.replace('-', '_')}")
    figures = [figure for figure in readme.FIGURES if figure.page == f"docs/{page}.md"]
    assert uncomputed((DOCS / f"{page}.md").read_text(encoding="utf-8"), figures, module.COMPUTED) == []


def test_a_value_without_a_computation_is_detected():
    head = "| in the document | here | command | value | equal |\n|---|---|---|---|---|"
    text = f"{STATED}\n\n{head}\n| c = 5, 弦 | `c` | | 5.00 m | = |\n"
    assert uncomputed(text, [], {}) == ["c = 5, 弦: nothing computes 5.00"]
    assert uncomputed(text, [], {"c = 5, 弦": {"5.00": lambda: 5.0}}) == []
    assert uncomputed(text, [], {"c = 5, 弦": {"5.00": lambda: 5.01}}) != []
    assert uncomputed(text, [readme.Figure("docs/c.md", "`c` | | {5.00} m |", "analyze c", "c")], {}) == []
