"""What surrounds the code: the changelog of releases, the citation, the workflows, and lines that fit a screen."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess

import pytest

from tests.test_docs import DOCS, FENCES, READ, ROOT, named, text_of

RELEASED = {"0.1.0": "1553887f9a6fbff5"}
"""Beginning of the SHA-256 of the words of the changelog from a release to its end."""
LONGEST = 140
CHANGELOG = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
TOP = [ROOT / name for name in ("SECURITY.md", "CODE_OF_CONDUCT.md")]


def long_lines(text: str) -> list[str]:
    """Lines of prose that are too long; tables, code, comments, pictures and what is made from the program are none."""
    text = re.sub(r"(<!-- [^\n]* -->)(?:(?!<!--).)*<!-- end -->", r"\1", FENCES.sub("", text), flags=re.DOTALL)
    return [line for line in text.split("\n") if len(line) > LONGEST and not line.startswith(("|", "<!--", "    ", "!["))]


@pytest.mark.parametrize("page", [*READ, *TOP], ids=named)
def test_no_line_of_prose_is_long(page):
    assert long_lines(text_of(page)) == []


def test_a_long_line_is_detected():
    line = "word " * 30
    assert long_lines(f"short\n{line}\n```sh\n{line}\n```\n| {line} |\n<!-- keys -->\n{line}\n<!-- end -->\n") == [line]


def test_the_changelog_of_a_release_does_not_change():
    for version, digest in RELEASED.items():
        part = " ".join(CHANGELOG[CHANGELOG.index(f"## [{version}]") :].split())
        found = hashlib.sha256(part.encode()).hexdigest()[:16]
        assert found == digest, f"{version} is released: write under Unreleased"
    assert set(re.findall(r"^## \[([\d.]+)\]", CHANGELOG, re.MULTILINE)) == set(RELEASED)


def test_the_citation_is_that_of_the_newest_version():
    version = re.search(r"^## \[([\d.]+)\]", CHANGELOG, re.MULTILINE)[1]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {version}\n" in citation
    assert "date-released" not in citation  # as long as no version has a tag


FILES = re.compile(r"`((?:[\w.-]+/)+[\w-]+\.(?:py|pyi|toml|md|json|js|yml|html))`")
"""Files with their folders in the prose."""
MADE = ("DIR/", "run/")
"""Folders that commands make in the examples."""


def absent_files(text: str) -> list[str]:
    """Files that a text names and that neither the repository nor the package has."""
    return [
        name
        for name in FILES.findall(FENCES.sub("", text))
        if not name.startswith(MADE) and not any((place / name).is_file() for place in (ROOT, ROOT / "optlink", ROOT / "docs"))
    ]


@pytest.mark.parametrize("page", [page for page in READ if page.name != "CHANGELOG.md"], ids=named)
def test_every_file_that_the_prose_names_exists(page):
    assert absent_files(text_of(page)) == []


def test_a_file_that_does_not_exist_is_detected():
    assert absent_files("in `solvers/event_orders.py` and `optlink/io.py`") == ["solvers/event_orders.py"]


@pytest.mark.parametrize("page", sorted((DOCS / "decisions").glob("[01]*.md")), ids=named)
def test_a_decision_is_short_and_names_what_repeats_its_figures(page):
    text = text_of(page)
    assert len(text.splitlines()) <= 40
    assert re.match(r"(?:Accepted|Replaced by \[.+\]\(.+\)), \d{4}-\d\d-\d\d[.,]", text.splitlines()[2])
    assert re.findall(r"^\*\*(\w+)\.\*\*", text, re.MULTILINE) == ["Context", "Decision", "Figures", "Consequences"]
    assert f"[{text.splitlines()[0].removeprefix('# ')}]({page.name})" in text_of(page.parent / "index.md")
    for file in re.findall(r"(?:tests|benchmarks|docs|optlink)/[\w/]+\.\w+", text):
        assert (ROOT / file).is_file(), file


def test_workflows_have_the_least_permissions():
    for workflow in (ROOT / ".github" / "workflows").glob("*.yml"):
        text = workflow.read_text(encoding="utf-8")
        assert "\npermissions:\n  contents: read\n" in text, workflow.name
        assert text.count("uses: actions/checkout") == text.count("persist-credentials: false"), workflow.name
        assert len(re.findall(r": write\b", text)) == (workflow.name == "release.yml"), workflow.name


@pytest.mark.skipif(os.name == "nt" or not (shutil.which("git") and shutil.which("bash")), reason="needs bash and git")
def test_ci_tests_a_copy_of_the_tree_as_it_stands(tmp_path):
    """What is changed, added and deleted counts; what git ignores is neither copied nor touched; nothing is left behind."""
    tree, places = tmp_path / "tree", tmp_path / "places"
    (tree / ".ci").mkdir(parents=True)
    (tree / ".venv").mkdir()
    places.mkdir()
    head = (ROOT / ".ci" / "run").read_text(encoding="utf-8").partition("\nif ! {")[0]
    (tree / ".ci" / "run").write_text(f"{head}\nls -A\ncat changed\nsleep 60 &\nfalse\necho never\n", encoding="utf-8")
    files = {".gitignore": ".venv/\n", ".venv/mine": "mine", "gone": "", "changed": "before\n"}
    for name, text in files.items():
        (tree / name).write_text(text, encoding="utf-8")
    for call in (["init", "-q"], ["add", "--all"]):
        subprocess.run(["git", *call], cwd=tree, check=True, capture_output=True)
    (tree / "gone").unlink()
    (tree / "changed").write_text("after\n", encoding="utf-8")
    (tree / "a new file").touch()
    environment = {**os.environ, "TMPDIR": str(places), "LC_ALL": "C"}
    call = ["bash", ".ci/run"]
    done = subprocess.run(call, cwd=tree, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split("\n")) == (1, [".ci", ".git", ".gitignore", "a new file", "changed", "after", ""])
    assert (tree / ".venv" / "mine").read_text(encoding="utf-8") == "mine"
    assert not any(places.iterdir())


def test_readme_and_the_first_page_do_not_repeat_each_other():
    sentences = [
        {words for words in re.split(r"(?<=[.:])\s+|\n\n", " ".join(FENCES.sub("", text_of(page)).split())) if len(words) > 60}
        for page in (ROOT / "README.md", DOCS / "index.md")
    ]
    assert sentences[0] & sentences[1] == set()
