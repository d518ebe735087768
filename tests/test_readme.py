"""Figures and commands that README and docs quote, by benchmarks/readme.py."""

from __future__ import annotations

import dataclasses
import re
import sys
import tomllib

import pytest

import optlink
from optlink.presentation import report_model
from optlink.tasks import run
from tests.solved import solution
from tests.test_docs import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))
import readme

PAGES = readme.pages()


def test_readme_has_at_most_150_lines():
    assert readme.page("README.md").count("\n") <= 150


def test_both_languages_have_the_same_two_commands_and_link_to_each_other():
    english, chinese = (
        re.findall(r"^python3 -m venv .*$", readme.page(name), re.MULTILINE) for name in ("README.md", "README.zh.md")
    )
    assert english == chinese
    assert len(english) == 2
    assert "](README.zh.md)" in readme.page("README.md")
    assert "](README.md)" in readme.page("README.zh.md")


@pytest.mark.parametrize("language", ["text", "toml", "python"])
def test_both_languages_have_the_same_examples(language):
    """Output, problem file and program, apart from remarks."""
    english, chinese = (
        re.search(rf"```{language}\n(.*?)```", readme.page(name), re.DOTALL)[1] for name in ("README.md", "README.zh.md")
    )
    assert re.sub(r" *#.*", "", english) == re.sub(r" *#.*", "", chinese)


def test_quoted_words_are_on_their_pages():
    assert len(readme.FIGURES) > 60
    for figure in readme.FIGURES:
        assert readme.in_text(figure), f"{figure.page}: {figure.text}"
    for block in readme.BLOCKS:
        assert len(readme.block_lines(block)) > 2, block


def test_the_problem_file_of_the_readme_can_be_solved_as_it_stands(tmp_path):
    """Without a title: its own is then the name of the file."""
    file = tmp_path / "lever.toml"
    file.write_text(re.search(r"```toml\n(.*?)```", readme.page("README.md"), re.DOTALL)[1], encoding="utf-8")
    result = optlink.solve(optlink.load(file))
    assert result.valid
    assert result.problem.spec.title == "lever"


@pytest.mark.parametrize("page", sorted((ROOT / "docs").glob("*.md")), ids=lambda page: page.name)
def test_whole_problem_files_on_a_page_are_read(page):
    for text in re.findall(r"```toml[^\n]*\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
        if "[mechanism]" in text:
            optlink.read(tomllib.loads(text))


def quick(page: str) -> None:
    """Leave the figures and blocks of one page that take no time."""
    readme.FIGURES[:] = [figure for figure in readme.FIGURES if figure.page == page and figure.command not in readme.LONG]
    readme.BLOCKS[:] = [block for block in readme.BLOCKS if block.page == page and block.command not in readme.LONG]


@pytest.fixture
def own(monkeypatch):
    monkeypatch.setattr(readme, "FIGURES", list(readme.FIGURES))
    monkeypatch.setattr(readme, "BLOCKS", list(readme.BLOCKS))


def test_quick_values_agree_with_the_commands(own):
    quick("README.md")
    assert readme.FIGURES or readme.BLOCKS
    assert list(readme.failures(slow=False, record=readme.recorded())) == []


def test_a_wrong_value_is_detected(own):
    quick("docs/crank-rocker.md")
    figure = readme.FIGURES[0]
    readme.FIGURES[:] = [dataclasses.replace(figure, scale=1.0001), dataclasses.replace(figure, text="{412.9} elsewhere")]
    assert [line.rpartition(": ")[2][:10] for line in readme.failures(slow=False, record={})] == ["optlink so", "not on the"]


def test_an_unprinted_line_is_detected():
    block = next(block for block in readme.BLOCKS if block.page == "README.md")
    printed = readme.output(block.command, as_json=False)
    assert readme.missing(block, printed) == []
    assert readme.missing(block, printed.replace("412.865", "412.866")) == ["coupler 412.865 mm free, 100 ... 900"]


def test_a_command_that_is_not_run_here_is_in_the_record():
    """With the exit code of its last run; and no command is called long that no page and no figure has."""
    recorded = readme.recorded()["commands"]
    assert recorded.keys() == readme.long_commands()
    assert {one["exit code"] for one in recorded.values()} <= {0, 1}
    quoted = {one.command for one in (*readme.FIGURES, *readme.BLOCKS)}
    assert set(readme.LONG) - quoted <= {" ".join(line.removeprefix("optlink ").split()) for line in recorded}


@pytest.fixture
def shared_solutions(monkeypatch):
    """Let commands that solve a shipped path problem with default options take the solution that other tests need as well."""
    search = run.solve

    def changed(problem):
        return problem.hash != optlink.load(problem.name).hash

    def solve(problem, backend="ipopt", starts=None, seed=0, progress=None, *, designs=None, **options):
        plain = (backend, starts, seed, designs, options.get("certify")) == ("ipopt", None, 0, None, None)
        if plain and problem.task == "path" and problem.name in optlink.shipped() and not changed(problem):
            return solution(problem.name)
        return search(problem, backend, starts, seed, progress, designs=designs, **options)

    monkeypatch.setitem(vars(optlink), "solve", search)  # of `solution`
    for module in (run, report_model):
        monkeypatch.setattr(module, "solve", solve)


@pytest.mark.slow
@pytest.mark.usefixtures("shared_solutions")
def test_all_figures_are_those_of_the_commands_or_of_the_record():
    assert list(readme.failures(slow=False, record=readme.recorded())) == []


@pytest.mark.slow
@pytest.mark.usefixtures("shared_solutions")
@pytest.mark.parametrize("page", PAGES)
def test_commands_of_a_page_run(page):
    """In their order, in an empty folder; those that take long are run by `benchmarks/readme.py --commands --long --write`."""
    for line, code, _, errors in readme.run_page(page, long=False):
        assert code in (0, 1), f"{line}: {errors}"
