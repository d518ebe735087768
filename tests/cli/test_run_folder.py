"""One output folder per run: the lock, what an earlier run left there, and what another command left there."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.errors import InputError
from optlink.execution.store import JOURNAL
from optlink.io import LOCK, locked
from optlink.studies import sweep
from tests.chunks import complete
from tests.tiers import mostly_slow

ROOT = Path(__file__).parents[2]
HOLD = """
import sys, time
from pathlib import Path
from optlink.io import locked
with locked(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(60)
"""
FRAME = "mechanism.frame=450..550 mm:20"


def run(*arguments: object):
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.fixture
def holder(tmp_path):
    """A process that has locked a folder."""
    out = tmp_path / "out"
    out.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(out)], stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout.readline() == "locked\n"
    yield out, process
    process.kill()
    process.wait()
    process.stdout.close()


@pytest.mark.parametrize(
    "arguments",
    [
        ("solve", "crank-rocker"),
        ("validate", "crank-rocker", "--design", "coupler=412 mm", "--design", "rocker=232 mm"),
        ("analyze", "slider-crank"),
        ("simulate", "slider-crank", "--duration", "10 ms"),
        ("balance", "balance-four-bar"),
        ("study", "sweep", "crank-rocker", "--vary", FRAME),
        ("study", "sweep", "crank-rocker", "--vary", FRAME, "--resume"),
        ("study", "pareto", "crank-rocker", "--objectives", "error, limits.transmission_angle.max"),
        ("study", "sensitivity", "crank-rocker"),
        ("study", "tolerance", "crank-rocker", "--tolerance", "coupler=0.1 mm"),
    ],
    ids=lambda arguments: " ".join(arguments[:2]),
)
def test_a_second_run_into_a_folder_is_refused_by_every_command(holder, arguments):
    out, process = holder
    done = run(*arguments, "--out", out)
    assert done.exit_code == 2
    assert f"another run of optlink (process {process.pid}) is writing into this folder" in done.output
    assert "Wait until it has ended, or choose another folder" in done.output
    assert [path.name for path in out.iterdir()] == [LOCK]


def test_a_killed_run_leaves_no_lock_behind(holder):
    out, process = holder
    with pytest.raises(InputError, match="another run"), locked(out):
        pass
    process.kill()
    process.wait()
    assert (out / LOCK).exists()  # the file alone locks nothing
    with locked(out), locked(out):  # the same thread may take it again
        pass
    assert not (out / LOCK).exists()


STUDY = """
import sys
from pathlib import Path
import optlink
from optlink.studies import sweep

def slowly(done, wanted):
    import time
    print(done, flush=True)
    time.sleep(0.3)

sweep(optlink.load("crank-rocker"), ["mechanism.frame=450..550 mm:300"], Path(sys.argv[1]), resume=sys.argv[2] == "resume",
      workers=1, progress=slowly)
"""


@pytest.mark.slow
def test_concurrent_resumes_of_a_study_are_refused(tmp_path):
    out = tmp_path / "out"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}

    def begin(how: str) -> subprocess.Popen:
        process = subprocess.Popen(
            [sys.executable, "-c", STUDY, str(out), how], stdout=subprocess.PIPE, text=True, env=environment
        )
        while int(process.stdout.readline()) < 100:
            pass
        return process

    with begin("anew") as killed:
        killed.kill()
    file, vary = optlink.load("crank-rocker"), ["mechanism.frame=450..550 mm:300"]
    with begin("resume") as first:
        with pytest.raises(InputError, match=f"another run of optlink .process {first.pid}. is writing"):
            sweep(file, vary, out, resume=True, workers=1)
        first.kill()
    assert sweep(file, vary, out, resume=True, workers=1).valid
    assert not (out / LOCK).exists()


@pytest.mark.slow
def test_pictures_of_an_earlier_run_are_removed_and_files_of_the_user_kept(tmp_path):
    out, path = tmp_path / "out", tmp_path / "press.toml"
    text = (ROOT / "problems" / "slider-crank.toml").read_text()
    path.write_text(text.replace('torque = "0.1 N*m"\n', "").replace('initial_speed = "0 rad/s"\n', ""))
    assert run("simulate", path, "--duration", "0.2 s", "--out", out).exit_code == 0
    first = {one.name for one in out.glob("*.*")}
    assert "drive.png" in first
    (out / "mine.png").write_bytes(b"a picture of the user")
    (out / "course.csv").write_text("changed by the user")
    from optlink.cli import console

    about = json.loads((out / console.MANIFEST).read_text())
    assert about["command"] == "simulate"
    about["files"]["old.png"] = console._sum(out / "mine.png")  # as if a run before had written two more pictures
    (out / "old.png").write_bytes(b"a picture of the user")
    about["files"]["edited.png"] = "00000000"
    (out / "edited.png").write_bytes(b"which the user has changed since")
    (out / console.MANIFEST).write_text(json.dumps(about))
    assert run("simulate", path, "--duration", "0.1 s", "--out", out).exit_code == 0
    assert not (out / "old.png").exists()
    assert (out / "mine.png").exists()
    assert (out / "edited.png").exists()
    assert not (out / LOCK).exists()


@pytest.mark.slow
def test_a_folder_with_the_result_of_another_command_or_problem_is_refused(tmp_path):
    """By its manifest, and without one by its result."""
    out = tmp_path / "out"
    assert run("analyze", "slider-crank", "--out", out).exit_code == 0
    for manifest in (True, False):
        if not manifest:
            (out / ".optlink-run.json").unlink()
        before = {path.name: path.read_bytes() for path in out.iterdir()}
        for arguments, held in (
            (("simulate", "slider-crank"), "`analyze` for slider-crank"),
            (("analyze", "scotch-yoke"), "`analyze` for slider-crank"),
            (("study", "sweep", "six-bar", "--analyze", "--vary", "mechanism.links.link2.length=1.1..1.3 m:3"), "`analyze`"),
        ):
            done = run(*arguments, "--out", out)
            assert done.exit_code == 2
            assert f"the folder contains the result of {held}" in done.output
        assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert run("analyze", "slider-crank", "--points", 90, "--out", out).exit_code == 0


def test_a_refused_input_leaves_no_new_folder(tmp_path):
    done = run("validate", "crank-rocker", "--design", "coupler=wide", "--out", tmp_path / "new" / "out")
    assert done.exit_code == 2
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="a signal of POSIX")
def test_ctrl_c_releases_the_folder(tmp_path):
    out = tmp_path / "out"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "optlink", "study", "sweep", "crank-rocker", "--vary", "mechanism.frame=450..550 mm:30000"]
    with subprocess.Popen([*command, "--workers", "1", "--out", str(out)], env=environment, stderr=subprocess.PIPE) as process:
        while not complete(out):
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        assert process.wait() == 130
    assert not (out / LOCK).exists()


SWEPT = ("study", "sweep", "crank-rocker", "--vary", "mechanism.frame=490 mm, 500 mm", "--workers", "1", "--out", "out")
LINKED = {
    "result.json": ("validate", "crank-rocker", "--design", "coupler=412 mm", "--design", "rocker=232.5 mm", "--out", "out"),
    "design.toml": ("validate", "crank-rocker", "--design", "coupler=412 mm", "--design", "rocker=232.5 mm", "--out", "out"),
    "mechanism.png": ("analyze", "slider-crank", "--points", "12", "--out", "out"),
    "checkpoint.json": ("simulate", "slider-crank-clearance", "--revolutions", "1", "--points", "12", "--out", "out"),
    "study.sqlite": SWEPT,
    "sweep.csv": SWEPT,
    "motion.csv": ("analyze", "slider-crank", "--points", "12", "--csv", "out/motion.csv"),
    "page.html": ("report", "slider-crank", "-o", "out/page.html"),
    "drawing.dxf": ("export", "slider-crank", "-o", "out/drawing.dxf"),
    "mine.toml": ("new", "law", "--force", "-o", "out/mine.toml"),
}


@pytest.mark.skipif(os.name != "posix", reason="links need a privilege on Windows")
@pytest.mark.parametrize("there", [True, False], ids=["file", "nothing"])
@pytest.mark.parametrize("name", mostly_slow(LINKED, "result.json", "motion.csv", "mine.toml"))
def test_a_link_out_of_the_folder_is_refused(name, there, tmp_path, monkeypatch):
    """Whoever prepared the folder does not choose which file of the user is replaced."""
    monkeypatch.chdir(tmp_path)
    Path("out").mkdir()
    if there:
        Path("precious").write_text("mine", encoding="utf-8")
    Path("out", name).symlink_to("../precious")
    done = run(*LINKED[name])
    assert done.exit_code == 2, done.output
    if not (there and name == "sweep.csv"):  # what these hold is not of optlink
        sentence = rf"Error: out/{name}: this is a link out of its folder, to \S+/precious. Remove the link, .*\n"
        assert re.fullmatch(sentence, done.stderr), done.stderr
    assert Path("precious").exists() is there
    assert not there or Path("precious").read_text(encoding="utf-8") == "mine"
    assert sorted(path.name for path in Path().iterdir()) == ["out", *(["precious"] if there else [])]


@pytest.mark.skipif(os.name != "posix", reason="links need a privilege on Windows")
def test_no_journal_is_written_through_a_link_out_of_the_folder(tmp_path, monkeypatch):
    """sqlite would follow the link at the first entry."""
    monkeypatch.chdir(tmp_path)
    Path("out").mkdir()
    Path("precious").write_text("mine", encoding="utf-8")
    Path("out", JOURNAL).symlink_to("../precious")
    done = run(*SWEPT)
    assert done.exit_code == 2
    assert "link out of its folder" in done.stderr
    assert Path("precious").read_text(encoding="utf-8") == "mine"


@pytest.mark.skipif(os.name != "posix", reason="links need a privilege on Windows")
def test_links_within_the_folder_and_of_the_folder_itself_are_followed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("real").mkdir()
    Path("out").symlink_to("real")  # the user names it
    Path("out", "loop.toml").symlink_to("loop.toml")
    Path("out", "motion.csv").symlink_to("first.csv")
    assert run(*LINKED["motion.csv"]).exit_code == 0
    assert Path("real", "motion.csv").is_symlink()
    assert Path("real", "first.csv").read_text(encoding="utf-8").startswith("crank_angle_deg,")
    assert run("new", "law", "--force", "-o", "out/loop.toml").exit_code == 0
    assert Path("real", "loop.toml").is_file()
