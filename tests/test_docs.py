"""The documentation: pages, links and pictures exist, commands exist, the reference lists every key, nothing made is stale."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import io
import itertools
import json
import math
import re
import shlex
import urllib.parse
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import optlink
from docs.generate import api, commands as cli_page, keys, measurements, pages as made, recipes, validation
from optlink.cli.app import app
from optlink.presentation.registry import json_schema
from optlink.problem.base_model import Section
from optlink.problem.targets.expression import FUNCTIONS
from optlink.problem.templates import template, templates
from tests.clearance.test_joint_clearance import ending_after
from tests.crank_rocker_oracle import best_of_ratio, shortest_pair
from tests.solved import once, shared_searches, solution
from tests.validation.test_clearance import simulate

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
READ = [*PAGES, *(ROOT / name for name in ("README.md", "README.zh.md", "CONTRIBUTING.md", "CHANGELOG.md"))]
NAV = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2].partition("\n\n")[0]


ANSWER = recipes.answer  # as it is while a test puts `answer` in its place


@cache
def answer(name: str) -> Any:
    """The answer to a template as its recipe shows it."""
    with shared_searches():
        return once(f"recipe {name}", lambda: ANSWER(name))


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


# --- pages, links, pictures --------------------------------------------------------------------------------------------

FENCES = re.compile(r"^(?P<mark>```+|~~~+)(?P<info>[^\n]*)\n(?P<text>.*?)^(?P=mark)[ ]*$", re.DOTALL | re.MULTILINE)
LINKS = re.compile(r"!?\[[^\]\n]*\]\((?P<target>[^)\s]+)\)")


@cache
def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def prose(path: Path) -> str:
    return re.sub(r"`[^`\n]+`", "code", FENCES.sub("", text_of(path)))


def slug(heading: str) -> str:
    """As GitHub and the site make it of a heading."""
    plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").strip().lower()
    return re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")


@cache
def anchors(path: Path) -> set[str]:
    text = FENCES.sub("", text_of(path))
    return {*re.findall(r'^<a id="([\w-]+)"></a>$', text, re.MULTILINE), *map(slug, re.findall(r"^#+ (.+)$", text, re.MULTILINE))}


def test_every_page_is_in_the_navigation():
    listed = re.findall(r"[:-] (\S+\.md)$", NAV, re.MULTILINE)
    assert len(listed) == len(set(listed))
    generated = {
        "contributing.md",
        "changelog.md",
        "zh.md",
        "overview.md",
        "security.md",
        "conduct.md",
        *(f"notebooks/{book.stem}.md" for book in (ROOT / "notebooks").glob("*.ipynb")),
    }
    assert {page.relative_to(DOCS).as_posix() for page in PAGES} | generated == set(listed)


@pytest.mark.parametrize("page", READ, ids=named)
def test_every_link_and_picture_exists(page):
    targets = [match["target"] for match in LINKS.finditer(prose(page))]
    for target in targets:
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = urllib.parse.unquote(target).partition("#")
        place = (page.parent / path).resolve() if path else page
        assert place.exists(), f"{named(page)} links to {target}"
        assert place.is_relative_to(ROOT), f"{named(page)} links out of the repository: {target}"
        if anchor:
            assert place.suffix == ".md", target
            assert anchor in anchors(place), f"{named(page)} links to {target}: no such heading"


def test_a_broken_link_is_detected():
    assert "no-such-heading" not in anchors(DOCS / "studies.md")
    assert "output-sensitivity" in anchors(DOCS / "studies.md")
    assert "joints-with-clearance-and-control" in anchors(DOCS / "problem-files.md")
    assert slug("Path, motion, function: kinds of requirement") == "path-motion-function-kinds-of-requirement"


def test_every_template_has_its_recipe():
    """Quoted output is in the stored output; other words are detected."""
    stored = {page.stem: page.read_text(encoding="utf-8") for page in (DOCS / "recipes").glob("*.md")}
    listed = stored.pop("index")
    assert set(stored) == set(templates())
    for name, text in stored.items():
        assert f"[{name}]({name}.md)" in listed
        assert f"![{template(name).summary}]({name}.svg)" in text
        assert optlink.new(name) in text
        assert recipes.READING in text
        assert recipes.missing(text) == []
    assert recipes.missing(stored["law"].replace("The second line is the verdict: `locally optimal", "`perfect")) == [
        "perfect, valid`"[:-1]
    ]


# --- what is made from the program ---------------------------------------------------------------------------------------

MADE = [block for page in made.pages() for block in made.blocks(page)]
REMEDY = "is stale: python -m docs.generate"


@pytest.mark.parametrize(
    "block", [block for block in MADE if block.kind not in made.SOLVED], ids=lambda block: block.what or block.kind
)
def test_what_is_made_in_a_moment_is_up_to_date(block):
    assert block.made() == block.text, f"{named(block.page)} {REMEDY}"


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    sorted({block.page for block in MADE if block.kind in made.SOLVED}),
    ids=lambda page: f"{page.parent.name}-{page.stem}",
)
def test_what_needs_solving_is_up_to_date(page, monkeypatch):
    """But for times and rounding; with the answers and solutions that other tests of this run need as well."""
    monkeypatch.setattr(recipes, "answer", answer)
    monkeypatch.setattr(validation, "solved", solution)
    monkeypatch.setattr(validation, "clearance_run", clearance_run)
    assert made.renewed(page, made.SOLVED) == page.read_text(encoding="utf-8"), f"{named(page)} {REMEDY}"


def clearance_run(rpm, revolutions, friction, tolerance):
    """The motion that the tests of the same reference values need; of first contacts no more than the beginning."""
    with ending_after(0.1) if revolutions == 1 else contextlib.nullcontext():
        return simulate(rpm, friction, revolutions, tolerance=tolerance)


def test_every_block_is_one_that_can_be_made():
    assert {block.kind for block in MADE} == set(made.MAKERS)
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert text.count("<!-- ") == 2 * len(made.blocks(page)), f"{named(page)}: a block without its end"


def test_pictures_show_the_problems_of_today():
    drawn = list(made.pictures())
    assert [named(one.file) for one in drawn if one.stale] == [], REMEDY
    assert {one.file for one in drawn} == {path.resolve() for path in DOCS.rglob("*.svg") if path.parent.name != "assets"}
    assert sum(one.file.stat().st_size for one in drawn) < 3_200_000


def test_a_stale_block_and_a_stale_picture_are_detected(tmp_path):
    block = next(block for block in MADE if "validate" in block.what and block.kind == "output")
    figures = next(block for block in MADE if block.kind == "figures")
    page = tmp_path / "page.md"
    page.write_text("# A page\n\n<!-- recipes -->\nold\n<!-- end -->\n\nend\n", encoding="utf-8")
    assert made.renewed(page, ("recipes",)) == f"# A page\n\n<!-- recipes -->\n\n{recipes.listed()}\n\n<!-- end -->\n\nend\n"
    assert made.renewed(page, ("keys",)) == page.read_text(encoding="utf-8")
    assert made.same(block, block.text)
    assert not made.same(block, block.text.replace("valid", "not valid"))
    assert not made.same(figures, figures.text.replace("412.86542 mm", "412.87 mm"))
    shown = tmp_path / "six.toml"
    shown.write_text("a = 1\n", encoding="utf-8")
    picture = made.Picture(tmp_path / "six.svg", shown, lambda: b'<svg><path d="M 1.23456 -0.0001"/></svg>\n')
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(made, "ROOT", tmp_path)
        assert picture.stale
        picture.write()
        assert not picture.stale
        assert picture.file.read_text(encoding="utf-8").startswith('<svg><path d="M 1.23 -0"/></svg>\n<!-- six.toml ')
        shown.write_text("a = 2\n", encoding="utf-8")
        assert picture.stale


@pytest.mark.parametrize("page", READ, ids=named)
def test_headings_are_in_order(page):
    """One title, and no level left out: the site makes its tables of contents of them."""
    levels = [len(mark) for mark in re.findall(r"^(#+) ", FENCES.sub("", text_of(page)), re.MULTILINE)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))


@pytest.mark.parametrize("page", READ, ids=named)
def test_tables_have_as_many_cells_in_every_row(page):
    """A stray | splits a cell, and what is left over is not shown."""
    for table in re.findall(r"(?:^\|.*\|\n)+", FENCES.sub("", text_of(page)), re.MULTILINE):
        cells = [len(re.findall(r"(?<!\\)\|", row)) for row in table.strip().split("\n")]
        assert len(set(cells)) == 1, f"{named(page)}: {table.strip().splitlines()[cells.index(max(cells))]}"


# --- commands ----------------------------------------------------------------------------------------------------------


def calls(line: str) -> list[tuple[list[str], str]]:
    """Calls of optlink in a shell line, as words, each with the file that takes its output."""
    words = shlex.shlex(line, posix=True, punctuation_chars=True)
    words.whitespace_split = True
    result: list[tuple[list[str], str]] = []
    call, target, into = [], "", False
    for word in [*words, ";"]:
        if set(word) <= set(";&|<>"):
            into = word == ">"
            if not into:
                if call and Path(call[0]).name == "optlink":
                    result.append((call[1:], target))
                call, target = [], ""
        elif into:
            target, into = word, False
        else:
            call.append(word)
    return result


def commands(page: Path) -> list[list[str]]:
    """Every call of optlink that a page shows, as words."""
    text = text_of(page)
    lines = [block["text"] for block in FENCES.finditer(text) if block["info"].strip() in ("sh", "bash")]
    lines += re.findall(r"^    (optlink .*)$", FENCES.sub("", text), re.MULTILINE)
    whole = "\n".join(lines).replace("\\\n", " ")
    return [arguments for line in whole.split("\n") for arguments, _ in calls(line)]


@cache
def command_line() -> Any:
    import typer.main

    return typer.main.get_command(app)


def parse(arguments: list[str]) -> Any:
    """The context of a call as the command line makes it, which knows all options and checks their values; nothing runs."""
    command = command_line()
    context = command.make_context("optlink", list(arguments))
    while hasattr(command, "commands"):
        rest = [*getattr(context, "_protected_args", ()), *context.args]
        name, command, rest = command.resolve_command(context, rest)
        context = command.make_context(name, rest, parent=context)
    return context


@pytest.mark.parametrize("page", READ, ids=named)
def test_commands_exist(page):
    known = {*optlink.shipped(), "out"}
    for arguments in commands(page):
        context = parse(arguments)
        known.add(str(context.params.get("out")))  # a folder with results may be reported on
        subject = context.params.get("problem") or context.params.get("subject")
        if subject is not None and not re.search(r"\.(toml|json)$", subject):
            assert subject in known, f"{named(page)}: {shlex.join(arguments)}"


@pytest.mark.parametrize(
    "wrong",
    [["slove", "crank-rocker"], ["solve", "crank-rocker", "--start", "5x"], ["solve"], ["study", "sweep", "six-bar", "--vray"]],
)
def test_unknown_commands_are_detected(wrong):
    with pytest.raises(Exception, match=r"(?i)no such|invalid|missing|whole number"):
        parse(wrong)


def test_inline_commands_exist():
    known = {name.split()[1] for name, _ in cli_page.commands() if " " in name}
    for page in READ:
        for word in re.findall(r"`optlink ([a-z]+)[ `]", FENCES.sub("", text_of(page))):
            assert word in known, f"{named(page)}: optlink {word}"


@pytest.mark.slow
def test_the_tutorial_output_is_correct(tmp_path, monkeypatch):
    """Every block of the page in its order: files are saved, commands run, and what is printed below them is what they print."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    page = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    output, compared = "", 0
    for block in FENCES.finditer(page):
        kind, text = block["info"].strip(), block["text"]
        if kind == "toml":
            name = re.findall(r"`([\w.]+)`", page[: block.start()].rstrip().rsplit("\n", 1)[-1])[-1]
            (tmp_path / name).write_text(text, encoding="utf-8")
        elif kind == "sh":
            output = ""
            for arguments, target in (call for line in text.replace("\\\n", " ").split("\n") for call in calls(line)):
                done = CliRunner().invoke(app, arguments)
                assert done.exit_code in (0, 1, 2), done.output
                output += done.output
                if target:
                    (tmp_path / target).write_text(done.stdout, encoding="utf-8")
        elif kind == "python":
            with contextlib.redirect_stdout(io.StringIO()) as stream:
                exec(text, {})
            output = stream.getvalue()
        else:
            assert kind == "text"
            shown = [" ".join(line.split()) for line in output.split("\n")]
            for line in text.split("\n"):
                expected = " ".join(line.split())
                if expected not in ("", "..."):
                    assert any(expected in one for one in shown), f"{expected}\n--- but ---\n{output}"
                    compared += 1
    assert compared > 40
    assert {"arm.toml", "final.toml", "arm.html", "arm.dxf", "frames", "out"} <= {place.name for place in tmp_path.iterdir()}


SCRIPT = re.compile(r"^```python\n(.*?)^```\n\n```text\n(.*?)^```$", re.DOTALL | re.M)
SHOWN = SCRIPT.findall((DOCS / "builders.md").read_text(encoding="utf-8"))
GUIDE = SCRIPT.findall((DOCS / "from-fmincon.md").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("script", "shown"),
    [pytest.param(*pair, marks=pytest.mark.slow if "function-sin" in pair[0] else ()) for pair in SHOWN + GUIDE],
)
def test_every_script_of_a_page_prints_what_it_shows(script, shown):
    """Each on its own, as a reader copies it."""
    with contextlib.redirect_stdout(io.StringIO()) as stream:
        exec(script, {})
    assert stream.getvalue() == shown


def test_the_file_of_the_guide_from_other_programs_has_the_figures_that_it_states(tmp_path):
    page = (DOCS / "from-sam-pmks.md").read_text(encoding="utf-8")
    (tmp_path / "drawn.toml").write_text(re.findall(r"^```toml\n(.*?)^```$", page, re.DOTALL | re.M)[0], encoding="utf-8")
    extreme = optlink.analyze(tmp_path / "drawn.toml").extremes["C.transmission_rad"]
    assert f"from {math.degrees(extreme.least):.2f} to {math.degrees(extreme.largest):.2f} deg" in page


def test_the_page_of_builders_has_the_optima_of_independent_formulas():
    page = (DOCS / "builders.md").read_text(encoding="utf-8")
    assert len(SHOWN) == page.count("```python") == 10
    assert sum("coupler 412.865 mm rocker 232.246 mm" in shown for _, shown in SHOWN) == 3
    shortest = shortest_pair()
    assert f"coupler {1e3 * shortest[0]:.3f} mm rocker {1e3 * shortest[1]:.3f} mm" in page
    coupler, rocker, error = best_of_ratio(1.7)
    assert f"coupler {1e3 * coupler:.3f} mm rocker {1e3 * rocker:.3f} mm" in page
    assert f"objective {error:.8f} rad^2" in page


# --- the reference -------------------------------------------------------------------------------------------------------


def test_the_reference_has_every_key_of_every_model():
    stated = {(keys.owner(part.model, name), name) for part in keys.sections() for name in part.model.model_fields}
    models = [model for model in keys.every_model() if model.__module__.startswith("optlink.")]  # none of an extension
    assert len(models) > 30
    for model in models:
        for name in model.model_fields:
            assert (keys.owner(model, name), name) in stated, f"{model.__name__}.{name}"


def test_the_reference_describes_every_key():
    for part in keys.sections():
        table = keys._table(part)
        for name, field in part.model.model_fields.items():
            assert len(keys.description(part.model, name)) > 5, f"{part.model.__name__}.{name} has no text below it"
            assert keys.value(part.model, name)
            if part.path:
                assert f"| `{field.alias or name}`" in table
    assert "required" in keys.reference()


def test_a_key_without_a_description_is_detected():

    class Bare(Section):
        """A table that somebody has just added."""

        key: str = ""
        other: float = 1.0
        """With a text."""

    assert keys.description(Bare, "key") == ""
    assert keys.description(Bare, "other") == "With a text."
    assert Bare not in {part.model for part in keys.sections()}


def test_units_and_formats_agree_with_the_models():
    """Against the models: values that the reference permits are accepted, and values that it excludes are refused."""
    from optlink.problem.limits import Limits
    from optlink.problem.machine.bodies import DriveSection, JointSection
    from optlink.problem.mechanism import FourBarSection

    assert keys.value(FourBarSection, "crank") == "length, fixed, free or linked"
    assert keys.value(DriveSection, "initial_speed") == "angular velocity or velocity"
    assert keys.value(DriveSection, "duration") == "time, not negative"
    assert keys.value(Limits, "time_ratio").startswith("range of numbers, with `stroke`")
    assert keys.value(Limits, "transmission_angle") == "range of angle, or table of ranges by joint"
    assert keys.left_out(JointSection.model_fields["restitution"]) == "`0.9`"
    assert keys.left_out(FourBarSection.model_fields["crank"]) == "required"
    page = keys.reference()
    assert re.search(r"\| length \| m \| `100 mm` \| .*`mm`.*`in`", page)
    assert "`deg`" not in re.search(r"^\| length \|.*$", page, re.MULTILINE)[0]


def test_examples_of_the_reference_are_toml():
    import tomllib

    count = 0
    for part in keys.sections():
        for name in part.model.model_fields:
            shown = keys.example(part.model, name)
            if shown:
                assert list(tomllib.loads(shown)) == [part.model.model_fields[name].alias or name]
                count += 1
    assert count > 100


def test_laws_of_the_reference_are_read(tmp_path):
    import tomllib

    page = (DOCS / "reference" / "keys.md").read_text(encoding="utf-8")
    (tmp_path / "law.csv").write_text("phi_deg,psi_deg\n0,0\n45,10\n90,25\n", encoding="utf-8")
    lines = re.search(r"```toml laws\n(.*?)```", page, re.DOTALL)[1].strip().split("\n")
    assert len(lines) == 5
    raw = dict(optlink.load("crank-rocker").raw)
    asked = {key: value for key, value in raw["requirement"].items() if key not in ("law", "from", "span", "points")}
    for line in lines:
        law = tomllib.loads(line)
        span = {"span": "90 deg", "points": 30} if isinstance(law["law"], str) else {}
        assert optlink.read({**raw, "requirement": {**asked, **law, **span}}, folder=tmp_path).model.law.offsets.size > 0
    documented = re.search(r"the functions `([a-z0-9 ]+)`", page)[1].split()
    assert set(documented) == set(FUNCTIONS)


def test_the_command_reference_has_every_option():
    text = cli_page.reference()
    for name, command in cli_page.commands():
        section = text.partition(f"## {name}\n")[2].partition("\n## ")[0]
        assert command.help
        for param in command.params:
            for spelling in param.opts if param.param_type_name == "option" else [param.metavar]:
                documented = re.escape(spelling.replace("|", "\\|"))
                assert re.search(rf"^\| `(?:\S+, )*{documented}(?:, \S+)*(?: .*)?` \|", section, re.MULTILINE), (
                    f"{name} {spelling}"
                )
            assert param.help, f"{name} {param.name} has no help"


def test_public_names_have_a_page():
    shown = [block.what for block in MADE if block.kind == "api"]
    assert len(shown) == len(set(shown))
    spaces = (optlink, optlink.control, optlink.linkage, optlink.studies, optlink.synthesis)
    for space in spaces:
        for name in set(space.__all__) - {"__version__"}:
            own = getattr(space, name)
            if inspect.isfunction(own) or inspect.isclass(own):
                homes = {f"{home.__name__}.{name}" for home in spaces if name in home.__all__ and getattr(home, name) is own}
                assert homes & {*shown}, name
    for path in shown:
        room, _, name = path.rpartition(".")
        try:
            assert hasattr(importlib.import_module(room), name), path
        except ModuleNotFoundError:
            pytest.fail(f"{path} does not exist")


def test_words_of_docstrings_are_no_types():
    given = """Sum.

Parameters
----------
a, b : float [m], positive
    Lengths.
c : int
d : str or Path, optional
    A file.
e, f
    See `g`.

Returns
-------
x : float [m]
"""
    expected = """Sum.

Parameters
----------
a
    [m], positive.
    Lengths.
b
    [m], positive.
    Lengths.
c
    int
d
    A file.
e
    See `g`.
f
    See `g`.

Returns
-------
x :
    [m]
"""
    assert api.spelled(given) == expected


# --- figures -------------------------------------------------------------------------------------------------------------


def test_reference_values_name_existing_tests():
    source = Path(validation.__file__).read_text(encoding="utf-8")
    named_tests = {(getattr(validation, file), name) for file, name in re.findall(r"\{([A-Z_]+)\}::(test_\w+)", source)}
    named_tests |= set(re.findall(r'"(tests/\S+\.py)::(test_\w+)"', source))
    assert len(named_tests) > 15
    for file, name in named_tests:
        assert f"\ndef {name}(" in (ROOT / file).read_text(encoding="utf-8"), f"{file}::{name}"


@pytest.mark.parametrize(
    "group", ["crank_rocker", "six_bar", "shaper", "under_a_torque", pytest.param("machines", marks=pytest.mark.slow)]
)
def test_reference_values_agree(group):
    rows = list(getattr(validation, group)())
    assert len(rows) > 1
    assert [row.what for row in rows if not row.holds] == []
    assert max(row.near / abs(row.target) for row in rows if abs(row.target) > 1e-3) < 0.01


def test_a_wrong_reference_value_stops_the_site(monkeypatch):
    row = validation.Row("a figure", "mm", 100.0, 100.2, 0.1, "tests/test_docs.py::test_x")
    assert not row.holds
    monkeypatch.setattr(validation, "GROUPS", (validation.Group("A", "by hand", lambda: iter([row])),))
    with pytest.raises(ValueError, match=r"a figure is 100\.2"):
        validation.page()


@pytest.mark.parametrize("kind", ["problem", "result"])
def test_published_schemas_are_up_to_date(kind: str) -> None:
    """Write it again: optlink show --schema KIND > docs/reference/KIND.schema.json."""
    published = json.loads((ROOT / f"docs/reference/{kind}.schema.json").read_text())
    assert published == json_schema(kind)


def test_measurements_mark_what_is_missed_and_what_is_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A ratio at which the peer was stopped meets no target that it equals, and no error stands among the speeds."""
    monkeypatch.syspath_prepend(str(DOCS.parent / "benchmarks"))
    from rows import show
    from timing import COST, ERROR, Row

    def row(ratio: float, target: str, **more: Any) -> Row:
        return Row(f"row {ratio:g} {target} {more.get('cut', False)}", "1 s", f"{ratio} s", ratio, target, **more)

    shown = [
        row(30.0, ">= 20"), row(19.0, ">= 20"), row(20.0, ">= 20", cut=True), row(31.0, ">= 20", cut=True),
        row(float("nan"), ">= 20"), row(0.9, "<= 1", kind=COST), row(1.1, "<= 1", kind=COST), row(5.0, "", kind=ERROR),
    ]  # fmt: skip
    assert [one.holds for one in shown] == [True, False, None, True, None, True, False, None]
    file = tmp_path / "measurements.json"
    show({"first": shown[:5]}, file)
    show({"second": shown[5:]}, file)  # the other part stays
    monkeypatch.setattr(measurements, "RECORD", file)
    text = measurements.page()
    assert "Of 7 targets: 3 met, 2 missed, 2 open." in text
    parts = re.split(r"^## ", text, flags=re.MULTILINE)
    assert [part.partition("\n")[0] for part in parts[1:]] == ["Speed", "Errors", "Cost", "Times of optlink alone"]
    assert parts[1].count("| > ") == 2
    assert (parts[1].count("**missed**"), parts[3].count("**missed**")) == (1, 1)
    assert ("other programs ran" in text) or ("nothing else ran" in text) or ("not recorded" in text)


def test_the_record_of_the_measurements_names_its_machine() -> None:
    """And a bare numpy call is not called a limit: the ratio to a compiled loop stands beside it."""
    record = json.loads((DOCS.parent / "benchmarks" / "measurements.json").read_text(encoding="utf-8"))
    for part in record["parts"].values():
        assert {"date", "python", "system", "load", "packages"} <= part.keys()
        for row in part["rows"]:
            assert not row["cut"] or row["holds"] is None or row["ratio"] > float((row["target"] or ">= 0").split()[1])
    assert "against a compiled loop" in measurements.page()


def test_the_comparison_names_the_versions_that_were_run() -> None:
    """A version that the page calls run is that of the record of the measurements."""
    text = (DOCS / "comparison.md").read_text(encoding="utf-8")
    run = {name.lower(): version for name, version in re.findall(r"^\| \[(\w+)\]\S+ ([\d.]+), \*\*run\*\*", text, re.MULTILINE)}
    record = json.loads((DOCS.parent / "benchmarks" / "measurements.json").read_text(encoding="utf-8"))
    used: dict[str, set[str]] = {}
    for part in record["parts"].values():
        for name, version in part["packages"].items():
            used.setdefault(name, set()).add(version)
    assert {name: {version} for name, version in run.items()} == {name: used[name] for name in run}
    assert run.keys() >= {"pylinkage", "fourbarhinge", "pymoo", "exudyn"}
