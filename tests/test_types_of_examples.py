"""The Python of the README, the pages, the notebooks and the examples has no error of types; the examples run.

Every class of results has the members of `optlink.Result`, those of designs the members of `optlink.DesignResult`.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

from optlink.presentation.registry import KINDS
from tests.solved import once
from tests.test_docs import ROOT
from tests.test_notebooks import NOTEBOOKS, code_cells, read
from tests.test_public_names import DEPRECATED

GUIDES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "docs" / "api" / "index.md"]
PAGES = [page for page in GUIDES if "\n```python\n" in page.read_text(encoding="utf-8")]
UNTYPED = "def double(length):\n    return 2.0 * length\n"
FORMER = "import optlink\n\n" + "".join(f"print(optlink.{name})\n" for name in DEPRECATED)
UNFIT = """
import optlink


class Judged:
    kind = "judged"
    status = "done"


def result() -> optlink.Result:
    return Judged()
"""
PLANTED = {"untyped": UNTYPED, "former": FORMER, "unfit": UNFIT}
"""Modules with errors of types."""
COMMON = """
import optlink

found = optlink.solve("crank-rocker")
objective: float = found.objective
best_objective: float = found.objective if found.best is None else found.best.objective
prices: list[float] = [limit.multiplier for limit in found.limits]
checks: list[str] = [check.name for check in found.validation.checks]
proof = optlink.solve("crank-rocker", certify=True).certificate
bound: float = proof.lower_bound if proof else 0.0
designs: tuple[optlink.LinkageDesign, ...] = optlink.solve("path-bean", designs=3).designs
for result in (found, optlink.analyze("shaper"), optlink.simulate("six-bar"), optlink.read_result("out")):
    valid: bool = result.valid
    status: str = result.status
"""


def fulfils(protocol: str, kinds: Iterable[str]) -> str:
    """A module that returns the class of each of these kinds of results as a protocol."""
    results = [KINDS[kind].result() for kind in kinds]
    homes = [(result.__module__, result.__name__) for result in results]
    return "".join(
        f"import optlink\nimport {module}\n\n\ndef of_{name}(one: {module}.{name}) -> optlink.{protocol}:\n    return one\n\n\n"
        for module, name in homes
    )


pytestmark = pytest.mark.slow


def of_page(page: Path) -> str:
    """The Python of a page, as one module."""
    blocks = re.findall(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert blocks
    return "\n".join(blocks)


def of_notebook(path: Path) -> str:
    """The cells of a notebook as one module, without lines for IPython."""
    lines = "\n".join(cell.source for cell in code_cells(read(path))).splitlines()
    return "\n".join(line for line in lines if not line.lstrip().startswith(("%", "!"))) + "\n"


SCRIPTS = sorted((ROOT / "examples").glob("*.py"))
EXTENSIONS = sorted((ROOT / "tests" / "extending").glob("[a-z]*.py"))
EXAMPLES = {
    "common": COMMON,
    "results": fulfils("Result", KINDS),
    "designs": fulfils("DesignResult", ("design", "balance")),
    "single": "import optlink\n\n\ndef of_one(one: optlink.extending.SingleResult) -> optlink.DesignResult:\n    return one\n",
    **{f"page_{page.stem.replace('-', '_')}": of_page(page) for page in PAGES},
    **{path.stem: of_notebook(path) for path in NOTEBOOKS},
    **{path.stem: path.read_text(encoding="utf-8") for path in SCRIPTS},
    **{f"extending_{path.stem}": path.read_text(encoding="utf-8") for path in EXTENSIONS},
}


@pytest.fixture(scope="module")
def errors(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Lines of one run of `mypy --strict` over all examples, with the configuration of the project and what it knows already."""
    folder = tmp_path_factory.mktemp("types")

    def run() -> list[str]:
        for name, text in (EXAMPLES | PLANTED).items():
            (folder / f"{name}.py").write_text(text, encoding="utf-8")
        done = subprocess.run(
            [
                sys.executable,
                "-m",
                "mypy",
                "--strict",
                "--hide-error-context",
                *("--enable-error-code", "deprecated"),
                str(folder),
            ],
            capture_output=True,
            text=True,
            cwd=ROOT,
            check=False,
        )
        assert done.returncode in (0, 1), done.stdout + done.stderr
        return done.stdout.splitlines()

    found: list[str] = once("types of examples", run)
    return found


def of(name: str, errors: list[str]) -> list[str]:
    return [error for error in errors if f"/{name}.py:" in error]


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_has_the_types_that_it_assumes(name: str, errors: list[str]) -> None:
    assert of(name, errors) == []


@pytest.mark.parametrize("path", EXTENSIONS, ids=lambda path: path.stem)
def test_an_extension_is_typed_by_public_names(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert not re.search(r"\bAny\b|\bfrom optlink\.(?!extending\b|linkage\b)", text)


def test_a_function_without_annotations_is_detected(errors: list[str]) -> None:
    (error,) = of("untyped", errors)
    assert "no-untyped-def" in error


def test_a_deprecated_name_is_reported_with_its_successor(errors: list[str]) -> None:
    found = [re.search(r"optlink\.(\w+) is now (\S+) .*\[deprecated\]", error) for error in of("former", errors)]
    assert {match[1]: match[2] for match in found if match} == DEPRECATED
    assert len(found) == len(DEPRECATED)


def test_a_result_without_its_members_is_detected(errors: list[str]) -> None:
    assert any("return-value" in error for error in of("unfit", errors))


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_an_example_runs_and_fits_on_a_screen(path: Path, tmp_path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 45
    assert not re.search(r"^(from|import) optlink\.", text, re.MULTILINE)  # the public names alone
    done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    expected = {
        "batch_to_frame": r"max .*\nleast peak torque 0\.0118 N m; between the rows 0\.0118",
        "own_objective": r"deviation 0\.9115 deg -> 1\.1000 deg\nlimits met: True",
        "sweep_with_plots": r"33 of 33 optima are valid",
    }
    assert re.search(expected[path.stem], done.stdout), done.stdout
    if path.stem == "sweep_with_plots":
        assert {file.name for file in (tmp_path / "sweep").iterdir()} >= {"page.html", "table.csv", "objective.svg", "sweep.svg"}
