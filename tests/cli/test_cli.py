"""The command line for users and scripts: exit codes, clean JSON, one clear message, no partial files."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import typer.main
from typer.testing import CliRunner

import optlink
from optlink.cli import console
from optlink.cli.app import app, needed, rejoined
from optlink.cli.solve import _in_halves
from optlink.errors import Fault

ROOT = Path(__file__).parents[2]


def run(*arguments: str, **kwargs):
    """Run a command in this process; stdout, stderr and exit code."""
    return CliRunner().invoke(app, list(arguments), **kwargs)


def process(*arguments: str, cwd: Path | None = None):
    """Run a command in its own process."""
    environment = {**os.environ, "COLUMNS": "100", "PYTHONWARNINGS": "error"}
    return subprocess.run(
        [sys.executable, "-m", "optlink", *arguments], capture_output=True, text=True, cwd=cwd, env=environment, check=False
    )


@pytest.mark.slow
def test_solve_json_has_the_documented_keys():
    done = run("solve", "crank-rocker", "--backend", "both", "--json")
    assert done.exit_code == 0
    assert done.stderr == ""
    result = json.loads(done.stdout)
    promised = "schema problem status valid backend design objective limits validation seconds seed backends"
    assert set(promised.split()) <= set(result)
    assert result["status"] == "optimal"
    assert result["valid"] is True
    assert result["design"]["coupler_mm"] == pytest.approx(412.86542, abs=1e-3)
    assert result["design"]["rocker_mm"] == pytest.approx(232.24617, abs=1e-3)
    assert result["design"]["phi0_deg"] == pytest.approx(26.472, abs=1e-3)
    assert result["objective"] == {
        "value": pytest.approx(0.00759237, abs=1e-8),
        "unit": "rad^2",
        "measure": "sum of squares",
        "rms_deg": pytest.approx(0.911494, abs=1e-5),
        "largest_deg": pytest.approx(2.290047, abs=1e-5),
    }
    assert {"name", "value", "bound", "unit", "active", "multiplier"} <= set(result["limits"][0])
    assert {"name", "passed", "value", "limit", "unit"} == set(result["validation"][0])
    assert set(result["seconds"]) == {"build", "search, polish and validate", "certify"}
    assert set(result["backends"]) == {"slsqp", "ipopt"}
    for name in ("coupler_mm", "rocker_mm"):
        values = [result["backends"][b]["design"][name] for b in ("slsqp", "ipopt")]
        assert values[0] == pytest.approx(values[1], abs=1e-6)
    active = [limit for limit in result["limits"] if limit["active"]]
    assert [limit["name"] for limit in active] == ["largest transmission angle"]
    assert active[0]["multiplier"] == pytest.approx(-1.4646960e-4, rel=1e-6)


@pytest.mark.slow
def test_infeasible_problems_exit_with_1_and_list_the_conflict():
    changes = ("--set", 'limits.transmission_angle=["80 deg", "100 deg"]')
    for backend in ("slsqp", "ipopt"):
        done = run("solve", "crank-rocker", "--backend", backend, *changes)
        assert done.exit_code == 1
        assert "Conflicting limits" in done.stdout
        assert "67.38 ... 112.62 deg" in done.stdout  # coupler = rocker = 360.555 mm: cos 1 - 0.08 / 0.13
    document = json.loads(run("solve", "crank-rocker", "--json", *changes).stdout)
    assert document["status"] == "infeasible"
    assert document["valid"] is False
    assert {item["unit"] for item in document["conflict"]} == {"deg"}


def test_validating_the_published_design_exits_with_1():
    arguments = ("validate", "crank-rocker", "--design", "coupler=412.26 mm", "--design", 'rocker="232.2417 mm"')
    done = run(*arguments)
    assert done.exit_code == 1
    assert "FAIL" in done.stdout
    assert "135.298" in done.stdout
    document = json.loads(run(*arguments, "--json").stdout)
    failed = [check for check in document["validation"] if not check["passed"]]
    assert failed[0]["value"] == pytest.approx(135.298, abs=5e-4)
    assert run("solve", *arguments[1:]).exit_code == 1


@pytest.mark.slow
def test_out_writes_everything_and_can_be_validated_again(tmp_path):
    out = tmp_path / "new" / "folder"
    done = run("solve", "crank-rocker", "--backend", "both", "--out", str(out), "--json")
    assert done.exit_code == 0
    names = {path.name for path in out.iterdir()}
    assert names == {
        "result.json",
        "points.csv",
        "certificate.json",
        "boxes.png",
        "bounds.png",
        "design.toml",
        "mechanism.png",
        "law.png",
        "transmission.png",
        "map.png",
        ".optlink-run.json",
    }
    assert json.loads((out / "result.json").read_text()) == json.loads(done.stdout)
    again = run("validate", "crank-rocker", "--design", str(out / "result.json"), "--json")
    assert again.exit_code == 0
    assert json.loads(again.stdout)["design"] == pytest.approx(json.loads(done.stdout)["design"], rel=1e-12)


LINUX = pytest.mark.skipif(not Path("/proc").exists(), reason="a folder of Linux that nobody can write to")


@pytest.mark.parametrize("where", ["file", "beneath a file", pytest.param("read-only", marks=LINUX)])
def test_an_unwritable_output_folder_is_refused_before_solving(tmp_path, where):
    taken = tmp_path / "taken"
    taken.write_text("mine")
    out = {"file": taken, "beneath a file": taken / "deeper", "read-only": Path("/proc/optlink")}[where]
    done = run("solve", "crank-rocker", "--out", str(out))
    assert done.exit_code == 2
    assert "--out" in done.stderr
    assert taken.read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


@pytest.mark.slow
def test_error_with_json_is_one_document():
    done = process("solve", "crank-rocker", "--json", "--set", "mechanism.frame=480", "--set", "requirement.points=0")
    assert done.returncode == 2
    document = json.loads(done.stdout)
    assert document["status"] == "error"
    assert [fault["key"] for fault in document["faults"]] == ["mechanism.frame", "requirement.points"]
    assert done.stderr.count("Error:") == 2
    assert "Traceback" not in done.stderr


@pytest.fixture
def faulty(monkeypatch):
    """A program with a fault: the analysis of a machine raises an exception."""

    def analyze(*_, **__):
        raise ZeroDivisionError("of\none by zero")

    monkeypatch.setattr("optlink.tasks.analyze.analyze", analyze)


@pytest.mark.usefixtures("faulty")
def test_a_fault_has_an_exit_code_of_its_own_and_one_sentence(monkeypatch):
    done = run("analyze", "six-bar", "--json")
    assert done.exit_code == 4
    assert done.stderr.startswith("Error: unexpected ZeroDivisionError: of one by zero. This is a fault of optlink, ")
    assert done.stderr.endswith("OPTLINK_DEBUG=1 prints the traceback\n")
    assert done.stderr.count("\n") == 1
    document = json.loads(done.stdout)
    assert (document["status"], f"Error: {document['message']}\n") == ("error", done.stderr)
    monkeypatch.setenv("OPTLINK_DEBUG", "1")
    debugged = run("analyze", "six-bar")
    assert debugged.exit_code == 4
    assert "in analyze\n" in debugged.stderr
    assert debugged.stderr.count("Error: unexpected") == 1


@pytest.mark.slow
def test_a_fault_ends_the_process_with_4():
    program = (
        "from unittest.mock import patch\nimport optlink.cli.app as app\npatch('optlink.linkage.motion.sweep', int).start()\n"
    )
    program += "app.main()"
    done = subprocess.run([sys.executable, "-c", program, "analyze", "six-bar"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (4, 1), done.stderr


@pytest.mark.parametrize(
    "content",
    [
        "[" * 100_000,
        '{"design": {"coupler_mm": 1' + "0" * 400 + "}}",
    ],
)
def test_broken_designs_are_refused(tmp_path, content):
    path = tmp_path / "design.json"
    path.write_text(content)
    done = run("validate", "crank-rocker", "--design", str(path))
    assert done.exit_code == 2
    assert "--design" in done.stderr


@pytest.mark.slow
def test_titles_are_printed_as_they_are(tmp_path):
    """Brackets in a title are no markup, and a terminal that lacks a letter does not break the run."""
    path = tmp_path / "mine.toml"
    text = run("show", "crank-rocker", "--toml").stdout
    path.write_text("\ufeff" + text.replace("Crank-rocker that", "[/red] ψ [bold] that"), encoding="utf-8")
    assert "[/red] ψ [bold] that" in run("solve", str(path)).stdout
    assert "[/red]" in run("show", str(path)).stdout
    for encoding in ("ascii", "cp1252"):
        environment = {**os.environ, "PYTHONIOENCODING": encoding}
        command = [sys.executable, "-m", "optlink", "solve", str(path)]
        done = subprocess.run(command, capture_output=True, encoding=encoding, env=environment, check=False)
        assert done.returncode == 0, done.stderr
        assert "412.865" in done.stdout


WORDS = [  # the arguments, with | between those that belong together
    "--set|limits.transmission_angle=[40 deg, 140 deg]|--json",
    "--set=mechanism.coupler={start=200 mm, bounds=[-1 m, 3 m]}|x",
    "--speed|60 rpm|six-bar",
    "--vary|mechanism.frame=450..550 mm:101|--workers|1",
    "--speed|60 1/min|--starts|20|crank-rocker",
    "--set|a=40..50 mm|--design|b=12,5 mm|m",
    "crank-rocker|mm|--set|a=[3|--json",
    "show|six-bar|mm",
    "--starts|20|problem.toml",
]


@pytest.mark.parametrize("line", WORDS)
def test_values_split_by_the_shell_are_joined(line):
    assert rejoined(line.replace("|", " ").split(" ")) == line.split("|")


def test_overview_is_the_help_of_all_commands():
    assert CliRunner().invoke(needed(app, ["--help"]), ["--help"]).stdout == run("--help").stdout
    assert run("solve", "--help").stdout.count("--") > 5  # the commands themselves keep their options


@pytest.mark.parametrize(
    "line",
    [
        *("solve --help", "analyse --help", "study --help", "study sweep --help", "study swep", "study", "solv crank-rocker"),
        *("--bogus solve", "solve --bogus", "list --json", "show crank-rocker -q", "studio --help"),
    ],
)
def test_a_command_built_alone_behaves_as_in_the_full_program(line):
    whole, alone = (CliRunner().invoke(group, line.split(), prog_name="optlink") for group in (app, needed(app, line.split())))
    assert (alone.stdout, alone.stderr, alone.exit_code) == (whole.stdout, whole.stderr, whole.exit_code)


def test_only_the_invoked_command_is_built():
    group = typer.main.get_command(needed(app, ["study", "sweep", "crank-rocker"]))
    study = group.commands["study"]
    assert {name for name, one in study.commands.items() if len(one.params) > 0} == {"sweep"}
    assert not group.commands["solve"].params


@pytest.mark.slow
def test_split_values_are_read():
    line = "show crank-rocker --set limits.transmission_angle=[40 deg, 140 deg] --set mechanism.crank=95 mm"
    shown = process(*line.split(" ")).stdout
    assert "40 deg ... 140 deg" in shown
    assert "95 mm" in shown


def test_list_has_a_line_for_each_problem_below_its_kind():
    *lines, _ = run("list").stdout.splitlines()
    groups, kind = {}, ""
    for line in filter(None, lines):
        if line.startswith("  "):
            groups[line.split()[0]] = kind
        else:
            kind = line.partition(":")[0].lower()
    files = {name: optlink.load(name) for name in optlink.shipped()}
    assert groups == {name: file.kind.partition(", ")[2] for name, file in files.items()}
    assert "  crank-rocker             Crank-rocker that reproduces a motion law" in lines
    assert "Analysis: optlink analyze NAME" in lines
    document = json.loads(run("list", "--json").stdout)
    assert document["problems"] == [{"name": n, "kind": f.kind, "title": f.model.title} for n, f in files.items()]
    assert run("list", "-q").stdout.split() == list(files)


def test_show():
    shown = run("show", "crank-rocker").stdout
    for words in ("frame", "500 mm", "free, 100 mm ... 900 mm", "psi0 + 2/(3*pi)*(phi - phi0)^2", "default"):
        assert words in shown
    assert json.loads(run("show", "crank-rocker", "--json").stdout)["problem"]["mechanism"]["frame"] == "500 mm"


@pytest.mark.parametrize(
    ("words", "drive"),
    [
        (("slider-crank",), "crank at 10 rad/s, from 0 deg, for 2 s"),
        (("six-bar", "--set", "drive.duration=250 ms"), "crank at 10 rad/s, from 62 deg, for 250 ms"),
        (("toggle-press",), "crank at 60 rpm, from 0 deg"),
    ],
)
def test_show_states_how_long_the_drive_runs(words, drive):
    (line,) = (line for line in run("show", *words).stdout.splitlines() if line.startswith("drive "))
    assert line.removeprefix("drive").strip() == drive


def test_show_toml_writes_a_problem_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(run("show", "crank-rocker", "--toml", "--set", "mechanism.frame=480 mm").stdout)
    done = run("solve", str(path), "--json")
    assert done.exit_code == 0
    assert json.loads(done.stdout)["design"]["frame_mm"] == 480.0
    assert json.loads(done.stdout)["problem"] == "mine"


GAPPED = ("simulate", "crank-rocker-clearance")
COMPARED = (*GAPPED, "--control", "compare", "--revolutions", "1", "--starts", "1")


def test_a_comparison_accepts_tolerance_and_points(monkeypatch):
    """Given options reach the library; the others keep its defaults."""
    taken = []

    def compare(*arguments, **options):
        ignored = ("progress", "checkpoint", "resume", "workers")  # of the command
        taken.append((arguments[1:], {key: value for key, value in options.items() if key not in ignored}))
        raise optlink.InputError(Fault("enough", "Stop"))

    monkeypatch.setattr("optlink.tasks.control_comparison.compare", compare)
    assert run(*COMPARED, "--tolerance", "1e-5", "--points", "60", "--seed", "4").exit_code == 2
    assert run(*GAPPED, "--control", "compare").exit_code == 2
    common = {"speed": None, "design": None}
    assert taken[0] == ((1,), {**common, "starts": 1, "tolerance": 1e-5, "points": 60, "seed": 4})
    assert taken[1] == ((20,), common)


@pytest.mark.slow
def test_json_is_repeatable():
    first, second = (json.loads(run("solve", "crank-rocker", "--starts", "6", "--seed", "5", "--json").stdout) for _ in "ab")
    for document in (first, second):
        del document["seconds"], document["crc32"]
    assert first == second


@pytest.mark.parametrize(
    ("file", "text", "told"),
    [
        ("cli/app.py", "import numpy_that_is_not_there\n", "No module named 'numpy_that_is_not_there'. This is a damaged"),
        ("errors.py", "def broken(:\n", "invalid syntax"),
        ("cli/solve.py", "raise RuntimeError('in\\ntwo lines')\n", "RuntimeError: in two lines. This is a fault of optlink; "),
    ],
)
def test_a_fault_before_a_command_begins_is_one_sentence(file, text, told, tmp_path):
    """In a copy of the package with one damaged file."""
    shutil.copytree(ROOT / "optlink", tmp_path / "optlink", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "optlink" / file).write_text(text, encoding="utf-8")
    variables = {**os.environ, "PYTHONPATH": str(tmp_path)}
    called = {"args": [sys.executable, "-m", "optlink", "list"], "capture_output": True, "text": True}
    done = subprocess.run(**called, check=False, cwd=tmp_path, env=variables)
    assert done.returncode == 4
    assert done.stderr.startswith("Error: optlink cannot start: ")
    assert told in done.stderr
    assert done.stderr.endswith("OPTLINK_DEBUG=1 prints the traceback\n")
    assert len(done.stderr.splitlines()) == 1
    traced = subprocess.run(**called, check=False, cwd=tmp_path, env={**variables, "OPTLINK_DEBUG": "1"})
    assert traced.returncode == 4
    assert "Traceback" in traced.stderr or "SyntaxError" in traced.stderr


@pytest.mark.slow
def test_launcher_in_a_checkout():
    done = subprocess.run(
        [sys.executable, str(ROOT / "cli.py"), "solve", "crank-rocker", "--json"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0
    assert json.loads(done.stdout)["valid"] is True


def test_help_and_version():
    assert "Commands" in run("--help").stdout
    assert "4 a fault of optlink" in run("--help").stdout
    assert run("--version").stdout.startswith("optlink ")
    for command in ("list", "show", "solve", "validate", "analyze", "balance", "simulate", "report", "export", "study"):
        assert run(command, "--help").exit_code == 0
        assert command in run("--help").stdout


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ("mechanism.frame=\udcff", "mechanism.frame"),
        ("title=a\udcff", "title"),
        ("mechanism.\udcff=1", "mechanism."),
        ("\udcff=1", ""),
    ],
)
def test_bytes_that_are_no_text_are_refused(change, key):
    done = run("show", "crank-rocker", "--set", change)
    assert done.exit_code == 2
    assert "the text is not UTF-8. Write it in UTF-8" in done.stderr
    assert key in done.stderr
    with pytest.raises(optlink.InputError, match="not UTF-8"):
        optlink.load("crank-rocker", {"requirement.law": "\udcff"})


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="names of files are bytes on Linux only")
def test_a_file_whose_name_is_no_text_is_read_and_written(tmp_path):
    name = os.fsdecode(os.fsencode(tmp_path) + b"/pa\xffrt.toml")
    for words in (("new", "wiper", "--out", name), ("show", name), ("show", name, "--toml")):
        done = process(*words)
        assert done.returncode == 0, done.stderr
    out = os.fsdecode(os.fsencode(tmp_path) + b"/o\xffut")
    axis = "mechanism.links.rod.length=300..310mm:2"
    done = process("study", "sweep", "slider-crank", "--analyze", "--vary", axis, "--out", out, "--workers", "1")
    assert done.returncode == 0, done.stderr
    assert json.loads((Path(out) / "result.json").read_text(encoding="utf-8"))["table"] == f"{out}/sweep.csv"


@pytest.mark.parametrize("sign", ["", "-"])
def test_a_count_of_thousands_of_digits_is_refused(sign):
    done = run("study", "sweep", "crank-rocker", "--vary", f"mechanism.frame=450..550 mm:{sign}{'9' * 5000}")
    assert done.exit_code == 2
    assert ("exceed the limit" if not sign else "do not make a range") in done.stderr


@pytest.mark.parametrize(("key", "value", "units"), [("coupler", 46, ("mm", "m")), ("direction", 30, ("deg", "rad"))])
def test_a_number_without_a_unit_is_offered_in_si_in_python_alone(key, value, units):
    """Results of Python are in SI; on a command line a length is typed in mm."""
    base = ("path-arc5", "--set", f"mechanism.{key}={value}")
    remedies = [f'"{value} {unit}"' for unit in units]
    typed = run("solve", *base).stderr
    assert f"Write {remedies[0]}, with the quotes" in typed
    with pytest.raises(optlink.InputError, match=f"Write {remedies[0]} or {remedies[1]}, with the quotes"):
        optlink.load("path-arc5", {f"mechanism.{key}": value})


def test_work_without_a_terminal_says_each_stage_once(capsys):
    """A search, and the rounding of what it found: minutes in which nothing else is printed."""
    with console.share("", said=True) as progress:
        for done in (0.1, 0.4, 0.6, 0.9):
            _in_halves(progress, done)
    assert capsys.readouterr().err == "searching ...\nrounding the sizes; Ctrl-C keeps the best ones so far ...\n"
