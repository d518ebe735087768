"""Every notebook runs from top to bottom in a fresh kernel: its own asserts are the tests. What it stores is fit to read."""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from nbformat import NotebookNode

from docs.generate import notebooks as stored
from docs.generate.pages import ALIKE, alike, plain

FOLDER = Path(__file__).resolve().parent.parent / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
LARGEST = 2_600_000  # bytes of all notebooks in the repository
FOREIGN = {
    "traceback": re.compile(r"Traceback \(most recent call last\)"),
    "warning": re.compile(r"\w*Warning\b"),
    "machine path": re.compile(r"(?<![\w.:/])/(?:home|root|work|tmp|usr|opt|var|mnt|Users)/|\b[A-Za-z]:\\\\?\w"),
    "memory address": re.compile(r"\bat 0x[0-9a-f]{6,}"),
    "words in place of a widget": re.compile(r"\b(?:interactive|\w*Box|\w*Slider|Image|Output)\(\w+="),
}
CHAOTIC = "chaotic"
"""Tag of cells with figures of chaotic motions, or of one of several equally good designs: there the words are compared."""
SLIDERS = "application/vnd.jupyter.widget-view+json"


def read(path: Path) -> NotebookNode:
    return nbformat.read(path, as_version=4)


def run(notebook: NotebookNode) -> NotebookNode:
    """Execute in place; CellExecutionError where a cell fails."""
    client = NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(FOLDER)}}, record_timing=False
    )
    return client.execute()


def code_cells(notebook: NotebookNode) -> list[NotebookNode]:
    return [cell for cell in notebook.cells if cell.cell_type == "code" and cell.source.strip()]


def faults(notebook: NotebookNode) -> Iterator[str]:
    """What a reader should not meet in the outputs; pictures are left out."""
    for cell in code_cells(notebook):
        for output in cell.outputs:
            if output.output_type == "error" or output.get("name") == "stderr":
                yield f"{cell.id}: {output.output_type} {output.get('text', '')}"
            data = {kind: value for kind, value in output.get("data", {}).items() if not kind.startswith("image/")}
            text = "\n".join([output.get("text", ""), *map(str, data.values()), *output.get("traceback", [])])
            yield from (f"{cell.id}: {name}" for name, pattern in FOREIGN.items() if pattern.search(text))
            if SLIDERS in data and not {"image/png", "text/html"} & output.data.keys():
                yield f"{cell.id}: a widget without a picture for those who cannot show it"


def told(notebook: NotebookNode) -> dict[str, str]:
    """The printed text and the shown values of each cell, without what differs between two runs."""
    texts = {}
    for cell in code_cells(notebook):
        shown = [output.get("data", {}) for output in cell.outputs]
        tables = [data.get("text/markdown") or data.get("text/plain", "") for data in shown]
        parts = [output.get("text") or table for output, table in zip(cell.outputs, tables, strict=True)]
        texts[cell.id] = plain("".join(parts))
    return texts


def test_outputs_are_compared_by_their_words_and_their_figures() -> None:
    assert alike("f = 1.000 mm, −2 deg", "f = 1.001 mm, −2 deg", ALIKE)
    assert not alike("f = 1.00 mm", "f = 1.10 mm", ALIKE)
    assert alike("f = 1.00 mm", "f = 7.10 mm", math.inf)
    assert not alike("f = 1.00 mm", "g = 1.00 mm", math.inf)
    assert not alike("1 and 2", "1", math.inf)
    assert alike(plain("moves 0 mm"), plain("moves 2.2e-13 mm"), ALIKE)
    assert not alike(plain("moves 0 mm"), plain("moves 0.2 mm"), ALIKE)


@pytest.fixture(autouse=True)
def own_ipython(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No profile, history or start-up file of the user."""
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))


def test_there_are_notebooks_and_they_are_small() -> None:
    assert sum(path.stat().st_size for path in NOTEBOOKS) < LARGEST


def test_pictures_have_few_colours() -> None:
    from PIL import Image

    picture = Image.fromarray((np.indices((64, 64)).sum(axis=0)[..., None] * np.array([1, 2, 0]) % 256).astype(np.uint8))
    with io.BytesIO() as stream:
        picture.save(stream, format="png")
        few = stored.few_colours(stream.getvalue())
    assert len(Image.open(io.BytesIO(few)).convert("RGB").getcolors()) <= stored.COLOURS
    assert stored.few_colours(few) == few
    for path in NOTEBOOKS:
        book = json.loads(path.read_text(encoding="utf-8"))
        before = json.dumps(book)
        stored.reduce(book)
        assert json.dumps(book) == before, f"{path.name}: python -m docs.generate notebooks"


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_runs_in_a_fresh_kernel(path: Path) -> None:
    """Where there are pictures to move, they have sliders: `ipywidgets` is installed with the tests."""
    notebook = run(read(path))
    assert list(faults(notebook)) == []
    before, now = told(read(path)), told(notebook)
    live = {cell.id for cell in notebook.cells if "= live(" in cell.source}  # whose stored output is a picture
    chaotic = {cell.id for cell in notebook.cells if CHAOTIC in cell.metadata.get("tags", ())}
    older = [
        cell
        for cell in before
        if cell not in live and not alike(before[cell], now[cell], within=math.inf if cell in chaotic else ALIKE)
    ]
    assert older == [], "its stored outputs are older than the code: python -m docs.generate notebooks"
    for cell in notebook.cells:
        if "= live(" in cell.source:
            assert SLIDERS in picture(cell)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_stored_outputs_are_clean(path: Path) -> None:
    notebook = read(path)
    nbformat.validate(notebook)
    assert notebook.metadata.kernelspec.name == "python3"
    cells = code_cells(notebook)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1)), "python -m docs.generate notebooks"
    assert list(faults(notebook)) == []
    live = [cell.id for cell in cells for output in cell.outputs if SLIDERS in output.get("data", {})]
    assert live == [], "sliders do not outlive their kernel: python -m docs.generate notebooks"
    assert "widgets" not in notebook.metadata
    words = [cell.source for cell in notebook.cells] + [json.dumps(notebook.metadata)]
    assert not [text for text in words if FOREIGN["machine path"].search(text)]


def picture(cell: NotebookNode) -> NotebookNode:
    """The one output of a cell that has a picture."""
    (shown,) = [output.data for output in cell.outputs if "image/png" in output.get("data", {})]
    return shown


@pytest.mark.slow
@pytest.mark.parametrize("name", ["what_if", "what_if_clearance"])
def test_a_picture_takes_the_place_of_sliders_without_ipywidgets(name: str) -> None:
    notebook = read(FOLDER / f"{name}.ipynb")
    first = next(k for k, cell in enumerate(notebook.cells) if "= live(" in cell.source)
    block = 'import sys\n\nsys.modules["ipywidgets"] = None  # as if it were not installed'
    notebook.cells = [nbformat.v4.new_code_cell(block), *notebook.cells[: first + 1]]
    assert list(faults(run(notebook))) == []
    assert SLIDERS not in picture(notebook.cells[-1])


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("Traceback (most recent call last):", "traceback"),
        ("RuntimeWarning: invalid value", "warning"),
        ("File /home/someone/optlink/x.py", "machine path"),
        (r"C:\Users\someone", "machine path"),
        ("<Figure at 0x7f3a2b1c>", "memory address"),
        ("interactive(children=(FloatSlider(value=1.0),))", "words in place of a widget"),
    ],
)
def test_a_planted_output_is_detected(text: str, name: str) -> None:
    cell = nbformat.v4.new_code_cell("1", outputs=[nbformat.v4.new_output("stream", name="stdout", text=text)])
    assert name in [fault.split(": ")[1] for fault in faults(nbformat.v4.new_notebook(cells=[cell]))]


def test_a_stored_output_of_other_code_is_detected() -> None:
    def of(text: str) -> dict[str, str]:
        cell = nbformat.v4.new_code_cell("1", id="one", outputs=[nbformat.v4.new_output("stream", name="stdout", text=text)])
        return told(nbformat.v4.new_notebook(cells=[cell]))

    assert of("rms 1.25 deg in 0.31 s, residual 3.1e-16") == of("rms 1.25 deg in 12 ms, residual 1.0e-15")
    assert of("rms 1.25 deg in 0.31 s") != of("rms 1.26 deg in 0.31 s")
    tables = [{"text/plain": "<Markdown object>", "text/markdown": f"| rms | {rms} deg |"} for rms in (1.25, 1.26)]
    cells = [nbformat.v4.new_code_cell("1", id="one", outputs=[nbformat.v4.new_output("display_data", data)]) for data in tables]
    first, second = (told(nbformat.v4.new_notebook(cells=[cell])) for cell in cells)
    assert first != second


@pytest.mark.slow
def test_a_wrong_value_in_a_copy_is_detected() -> None:
    notebook = read(FOLDER / "crank_rocker.ipynb")
    right, wrong = "abs(np.degrees(rise[-1]) - 30)", "abs(np.degrees(rise[-1]) - 30.1)"
    last = next(k for k, cell in enumerate(notebook.cells) if right in cell.source)
    notebook.cells = notebook.cells[: last + 1]
    notebook.cells[last].source = notebook.cells[last].source.replace(right, wrong)
    with pytest.raises(CellExecutionError, match="AssertionError"):
        run(notebook)


def test_plots_show_themselves_in_a_fresh_kernel() -> None:
    """Once each: the value of a cell and, as with pyplot, axes that a cell keeps and changes; the settings of pyplot remain."""
    lines = [
        'import optlink\nresult = optlink.validate("crank-rocker", {"coupler": 0.412, "rocker": 0.232})',
        'result.plot("law")',
        'axes = result.plot()\naxes.set_title("mine");',
        "from matplotlib import pyplot\npyplot.plot([0, 1]);",
    ]
    notebook = run(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(line) for line in lines]))
    shown = [sum("image/png" in output.get("data", {}) for output in cell.outputs) for cell in notebook.cells]
    assert shown == [0, 1, 1, 1]
