"""Help without gaps, one meaning of an option everywhere, other spellings, and quiet commands."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys

import pytest
import typer.main
from typer.testing import CliRunner

from optlink.cli.app import app
from tests.tiers import mostly_slow


def run(*arguments: str):
    return CliRunner().invoke(app, list(arguments))


def below(words, command):
    yield words, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from below((*words, name), inner)


COMMANDS = dict(below((), typer.main.get_command(app)))
LEAVES = {words: command for words, command in COMMANDS.items() if not hasattr(command, "commands")}


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
@pytest.mark.parametrize("width", [60, 80])
def test_help_shows_every_word_within_the_terminal(words, width):
    """No word is cut at any width, and none is taken as markup."""
    command, done = COMMANDS[words], CliRunner().invoke(app, [*words, "--help"], terminal_width=width)
    assert done.exit_code == 0
    texts = [command.help or "", *(param.help or "" for param in command.params)]
    options = [param for param in command.params if param.param_type_name == "option"]
    texts += [word for param in options for word in (*param.opts, *param.secondary_opts)]
    texts += [param.metavar or "" for param in command.params]
    texts += [inner.help for inner in getattr(command, "commands", {}).values()]
    whole = done.stdout.replace("[PROBLEM]", "PROBLEM").replace("[TEMPLATE]", "TEMPLATE")  # as older versions of typer write them
    shown = {*whole.split(), *re.sub(r"-\n\s+", "-", whole).split()}  # a word with a hyphen may end a line there
    assert [word for text in texts for word in text.split() if word not in shown and f"{word}," not in shown] == []
    assert max(map(len, done.stdout.splitlines())) <= width
    assert "{" not in done.stdout
    assert "<bool>" not in done.stdout, "a flag has no value"


def test_out_and_quiet_are_consistent_across_commands():
    for words, command in LEAVES.items():
        options = {param.opts[-1]: param for param in command.params if param.param_type_name == "option"}
        assert options["--quiet"].opts == ["-q", "--quiet"], words
        if "--out" in options:
            assert options["--out"].opts == ["-o", "--out"], words
            assert options["--out"].metavar in ("DIR", "FILE", "FILE.html"), words
    with_folder = {words for words, command in LEAVES.items() if any(param.metavar == "DIR" for param in command.params)}
    assert ("solve",) in with_folder
    assert ("study", "tolerance") in with_folder


@pytest.mark.parametrize(
    ("old", "new"),
    mostly_slow(
        [
            (("balance", "slider-crank", "--minimize", "nothing"), ("balance", "slider-crank", "--minimise", "nothing")),
            (("balance", "slider-crank", "--minimize=nothing"), ("balance", "slider-crank", "--minimise=nothing")),
            (("analyse", "nothing"), ("analyze", "nothing")),
            (
                ("study", "sweep", "six-bar", "--analyse", "--vary", "x"),
                ("study", "sweep", "six-bar", "--analyze", "--vary", "x"),
            ),
        ],
        (("analyse", "nothing"), ("analyze", "nothing")),
    ),
)
def test_other_spellings_are_the_same_option(old, new):
    first, second = run(*old), run(*new)
    assert first.exit_code == second.exit_code == 2
    assert first.stderr == second.stderr
    assert "No such" not in first.stderr


@pytest.mark.parametrize("words", [(), ("study",)])
def test_a_group_alone_shows_its_help_and_no_error(words):
    done = run(*words)
    assert (done.exit_code, done.stderr) == (2, "")
    assert done.stdout == run(*words, "--help").stdout


def test_a_result_folder_as_design_suggests_the_file(tmp_path):
    (tmp_path / "result.json").write_text("{}", encoding="utf-8")
    done = run("validate", "crank-rocker", "--design", str(tmp_path))
    assert done.exit_code == 2
    assert f"Write --design {tmp_path / 'result.json'}" in done.stderr


def test_values_after_two_dashes_are_not_options():
    assert "--minimize" in run("show", "--", "--minimize").stderr


GIVEN = ("--design", "rocker=235 mm", "--design")


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("validate", "crank-rocker", *GIVEN, "coupler=415 mm"), 0, "given design, valid"),
        (("validate", "crank-rocker", *GIVEN, "coupler=300 mm"), 1, "not valid"),
        (("analyze", "slider-crank"), 0, "analysed"),
        (("show", "crank-rocker"), 0, "crank-rocker: four-bar, function design"),
    ],
)
def test_quiet_prints_only_the_verdict(arguments, code, words):
    done = run(*arguments, "-q")
    assert done.exit_code == code == run(*arguments).exit_code
    assert words in done.stdout
    assert done.stdout.count("\n") == 1
    assert done.stderr == ""
    document = run(*arguments, "-q", "--json").stdout
    assert json.loads(document)["schema"] == json.loads(run(*arguments, "--json").stdout)["schema"]


def test_quiet_ends_with_its_command():
    assert run("list", "--quiet").stdout.splitlines() == [
        row["name"] for row in json.loads(run("list", "--json").stdout)["problems"]
    ]
    assert "Path design" in run("list").stdout
    failed = run("solve", "nothing", "-q")
    assert failed.exit_code == 2
    assert failed.stderr.startswith("Error: ")


@pytest.mark.slow
def test_quiet_shows_no_progress(tmp_path):
    """Not even the lines that a file gets of a bar or a spinner."""
    command = [sys.executable, "-m", "optlink", "solve", "crank-rocker", "-q", "--starts", "4", "-o", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert done.stderr == ""
    assert done.stdout.count("\n") == 1
    assert (tmp_path / "result.json").is_file()


# --- completion in the shell ---------------------------------------------------------------------------------------------------


def completed(line: str) -> set[str]:
    """What a shell offers for the last word of a line."""
    environment = {"_OPTLINK_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(line.count(" "))}
    return set(CliRunner().invoke(app, [], env=environment, prog_name="optlink").stdout.split())


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("optlink solve crank-rocker-", {"crank-rocker-clearance", "crank-rocker-robust"}),
        ("optlink report watt", {"watt-i"}),
        ("optlink show tog", {"toggle-press"}),
        ("optlink new wi", {"wiper"}),
        ("optlink solve crank-rocker --set mechanism.c", {"mechanism.crank=", "mechanism.coupler="}),
        ("optlink study sweep crank-rocker --set limits.tr", {"limits.transmission_angle="}),
        ("optlink solve nothing --set m", set()),
        ("optlink analyze pu", {"pump.toml"}),
        ("optlink stu", {"study", "studio"}),
        ("optlink solve --qu", {"--quiet"}),
    ],
)
def test_completion(line, offered, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("pump.toml", "pump.txt"):
        (tmp_path / name).write_text("title = 'x'\n")
    assert completed(line) == offered


def test_a_process_completes_options():
    environment = os.environ | {"_OPTLINK_COMPLETE": "complete_bash", "COMP_WORDS": "optlink solve --qu", "COMP_CWORD": "2"}
    code = "import sys; sys.argv = ['optlink']; from optlink.__main__ import main; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment)
    assert done.stdout.split() == ["--quiet"], done.stderr


def test_completion_can_be_installed(monkeypatch):
    monkeypatch.setattr("shellingham.detect_shell", lambda *_: ("bash", "/bin/bash"))  # the tests may run without a shell
    shown = run("--help").stdout
    assert "--install-completion" in shown
    assert "COMP_WORDS" in CliRunner().invoke(app, ["--show-completion", "bash"], prog_name="optlink").stdout


GAPPED = ("simulate", "slider-crank-clearance")


@pytest.mark.parametrize(
    "arguments",
    [
        ("solve", "crank-rocker", "--out"),
        ("study", "sweep", "crank-rocker", "--vary", "mechanism.frame=490..510 mm:2", "--out"),
        ("study", "sweep", "crank-rocker", "--vary", "mechanism.frame=490..510 mm:2", "--resume", "--out"),
        ("analyze", "six-bar", "--csv"),
    ],
    ids=" ".join,
)
def test_an_inaccessible_path_is_invalid_input(arguments, tmp_path, monkeypatch):
    """Such as a folder with a name that is too long, or inside a folder that may not be read."""
    monkeypatch.chdir(tmp_path)
    done = run(*arguments, f"{300 * 'n'}/a.csv")
    assert (done.exit_code, done.stderr.splitlines()[0][:7]) == (2, "Error: ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_table_may_lie_in_the_folder_of_the_results(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = tmp_path / "out" / "rows.csv"
    arguments = ("analyze", "crank-rocker", "--points", "20", "--csv", "out/rows.csv")
    assert run(*arguments, "--out", "out").exit_code == 0
    before = rows.stat().st_ino
    assert run(*arguments).exit_code == 0  # replaced as a whole, like all files
    assert rows.stat().st_ino != before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "note"),
    [
        (("--duration", "0.08 s"), "0.08 s are 1.6 revolutions; with clearance whole revolutions are simulated: 2"),
        (("--set", "drive.duration=0.012 s"), "0.012 s are 0.24 revolutions; with clearance whole revolutions are simulated: 1"),
        (("--duration", "0.1 s"), None),
        (("--duration", "0.08 s", "--quiet"), None),
    ],
)
def test_a_duration_that_is_rounded_to_revolutions_is_noted(options, note):
    done = run(*GAPPED, "--points", "12", *options)
    assert done.exit_code == 0
    assert done.stderr.strip() == ("" if note is None else f"Note: {note}")


@pytest.mark.slow
def test_an_animation_is_drawn_on_request_only(tmp_path):
    for folder, options in (("plain", ()), ("film", ("--film",))):
        assert run("analyze", "slider-crank", "--points", "6", "--out", str(tmp_path / folder), *options).exit_code == 0
    assert {path.name for path in (tmp_path / "film").iterdir()} - {path.name for path in (tmp_path / "plain").iterdir()} == {
        "motion.gif"
    }
    done = run("analyze", "slider-crank", "--film")
    assert done.exit_code == 2
    assert "--film" in done.stderr
    assert "Add --out DIR" in done.stderr


@pytest.mark.parametrize(
    ("words", "key"),
    [
        (("solve", "path-bean", "--round", "0.1"), "--round"),
        (("export", "path-bean", "-o", "x.svg", "--content", "nonsense"), "--content"),
        (("study", "tolerance", "path-bean", "--tolerance", "crank=0.1 mm", "--limit", "5"), "--limit"),
    ],
)
def test_an_option_is_refused_before_any_search(words, key, monkeypatch):
    def searched(*_args, **_options):
        pytest.fail("the search began")

    monkeypatch.setattr("optlink.tasks.design.SearchRounds", searched)
    done = CliRunner().invoke(app, list(words))
    assert done.exit_code == 2, done.output
    assert done.stderr.startswith("Error: ")
    assert key in done.stderr


TOLERANCE = ["study", "tolerance", "crank-rocker", "--tolerance"]
BEFORE_A_SEARCH = [
    [*TOLERANCE, "crank=0.1"],
    [*TOLERANCE, "crnk=0.1 mm"],
    [*TOLERANCE, "crank=0.1 mm", "--quantity", "rocket"],
    [*TOLERANCE, "crank=0.1 mm", "--angles", "0 deg"],
    [*TOLERANCE, "crank=0.1 mm", "--quantity", "rocker", "--limit", "5 mm"],
    [*TOLERANCE, "crank=0.1 mm", "--limit", "2 deg", "--allocate", "99 %", "--cost", "rocker=2"],
    ["study", "sensitivity", "crank-rocker", "--quantity", "rocket"],
    ["export", "crank-rocker", "-o", "drawing.dxf", "--at", "50 mm"],
]


@pytest.mark.parametrize("words", BEFORE_A_SEARCH, ids=" ".join)
def test_an_option_is_refused_before_a_search(words, monkeypatch):
    def searched(*_, **__):
        raise AssertionError

    monkeypatch.setattr("optlink.tasks.protocol.DesignTask.solve", searched)
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 2, done.output
