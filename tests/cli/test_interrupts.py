"""Ctrl-C, closed pipes, full devices and files without end: one sentence, the right exit code, nothing half written."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import typer
from typer.testing import CliRunner

import optlink
from optlink.cli import console
from optlink.cli.app import app
from optlink.execution.store import Store
from optlink.execution.worker import Processes
from optlink.presentation.view import View
from tests.tiers import mostly_slow

COMMAND = (sys.executable, "-m", "optlink")
posix = pytest.mark.skipif(os.name != "posix", reason="signals and devices of POSIX")

BEAN = """
title = "An ellipse that no four-bar passes exactly"
[mechanism]
type = "four-bar"
crank = { bounds = ["5 mm", "70 mm"] }
coupler = { bounds = ["5 mm", "90 mm"] }
rocker = { bounds = ["5 mm", "90 mm"] }
frame = { bounds = ["5 mm", "90 mm"] }
points = { P = [{ bounds = ["-90 mm", "90 mm"] }, { bounds = ["-90 mm", "90 mm"] }] }
pivot = [{ bounds = ["-90 mm", "90 mm"] }, { bounds = ["-90 mm", "90 mm"] }]
direction = { bounds = ["-180 deg", "180 deg"] }
assembly = "either"
[requirement]
kind = "path"
points = { x = "25*cos(t)", y = "12*sin(t) + 3*cos(3*t)", unit = "mm", t = [0, "2*pi"], points = 20 }
[limits]
transmission_angle = ["30 deg", "150 deg"]
link_ratio = [0.1, 10.0]
"""

PUMP = """
title = "A slider-crank whose sizes are free"
[mechanism.ground]
A = ["0 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = { bounds = ["20 mm", "60 mm"] } }
rod = { joints = ["B", "C"], length = { bounds = ["90 mm", "400 mm"] } }
ram = { joints = ["C"] }
[mechanism.guides]
G = { slider = "ram", direction = "-90 deg", through = "A", offset = { bounds = ["0 mm", "60 mm"] } }
[mechanism.assembly]
C = "forward"
[bodies]
ram = { mass = "5 kg" }
[loads]
pressing = { on = "ram", force = "2 kN", acts = "opposing", stroke = "forward" }
[drive]
speed = "90 rpm"
[objective]
quantity = "torque"
[limits]
stroke = { quantity = "stroke", of = "ram", exactly = "70 mm" }
"""


def run(*arguments, **options):
    options = {"capture_output": True, "text": True, "errors": "replace", "timeout": 120} | options
    return subprocess.run([*COMMAND, *map(str, arguments)], check=False, **options)


def processor_time(process):
    """Processor time [s] of a process and its workers; nothing where the system does not say."""
    used = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # the process has ended meanwhile
            fields = stat.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
            used += [int(fields[11]) + int(fields[12])] * (process in (int(stat.parent.name), int(fields[1])))
    return sum(used) / os.sysconf("SC_CLK_TCK") if used else None


def at_work(process, seconds):
    """Wait until a process and its workers have used so many seconds of a processor, where the system says so; else twice."""
    begin = time.monotonic()
    while time.monotonic() - begin < 300.0 and process.poll() is None:
        used = processor_time(process.pid)
        if used > seconds if used is not None else time.monotonic() - begin > 2.0 * seconds:
            return
        time.sleep(0.05)
    state = "too slow" if process.poll() is None else "too quick"
    process.kill()  # else its outputs would be awaited until it ends by itself
    raise AssertionError(f"{state}: {process.communicate()}")


def press(arguments, after, folder):
    """Start a command, press Ctrl-C when it has worked for a while; its exit code and both outputs."""
    with subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        start_new_session=True,
    ) as process:
        at_work(process, after)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    return process.returncode, out, err


@pytest.fixture
def files(tmp_path):
    (tmp_path / "bean.toml").write_text(BEAN)
    (tmp_path / "pump.toml").write_text(PUMP)
    return tmp_path


LONG = {
    "solve a path": ("solve", "bean.toml", "--starts", "900000", "--out", "out"),
    "solve a path by processes": ("solve", "bean.toml", "--starts", "900000", "--workers", "2", "--out", "out"),
    "solve a machine": ("solve", "pump.toml", "--starts", "2000", "--out", "out"),
    "solve a law": ("solve", "crank-rocker", "--starts", "90000", "--out", "out"),
    "report": ("report", "bean.toml", "-o", "page.html", "--starts", "900000"),
    "export": ("export", "bean.toml", "-o", "drawing.dxf", "--starts", "900000"),
    "sensitivity": ("study", "sensitivity", "bean.toml", "--starts", "900000", "--out", "out"),
    "pareto": (
        "study",
        "pareto",
        "crank-rocker",
        "--objectives",
        "error,limits.transmission_angle.max",
        "--points",
        "9000",
        "--out",
        "out",
    ),
    "tolerance": ("study", "tolerance", "crank-rocker", "--tolerance", "coupler=0.1 mm", "--samples", "90000000", "--out", "out"),
}


@posix
def test_child_processes_ignore_ctrl_c():
    """A terminal sends the signal to its session: a process that is just starting would answer with a traceback."""
    with Processes(2) as executor:
        sessions = {executor.submit(os.getsid, 0).result(60) for _ in range(2)}
    assert os.getsid(0) not in sessions


TUNED = (
    "simulate",
    "crank-rocker-clearance",
    "--control",
    "pid",
    "--tune",
    "proportional",
    "--evaluations",
    "900",
    "--workers",
    "3",
)


@posix
@pytest.mark.slow
@pytest.mark.parametrize("after", [2.5, 4.0])
def test_ctrl_c_ends_tuning_and_its_processes(after, files):
    """A terminal sends the signal to every process, also to those that are just starting: one sentence, nobody left."""
    with subprocess.Popen(
        [*COMMAND, *TUNED], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=files, start_new_session=True
    ) as process:
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(after)
        os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert out == ""
    lines = [line for line in err.splitlines() if "interrupted" not in line.lower()]
    assert lines == [], err
    assert "interrupted while compiled code" not in err
    for _ in range(100):
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            break
        time.sleep(0.1)
    else:
        raise AssertionError("a process is left")


def workers(parent):
    """The numbers of the child processes of a process."""
    children = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # the process has ended meanwhile
            if int(stat.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[1]) == parent:
                children.append(int(stat.parent.name))
    return children


def runs(process):
    """Whether a process has not ended; a dead one may stay in the table for a while."""
    with contextlib.suppress(OSError):
        return (
            Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[0] not in "ZX"
        )
    return False


PARALLEL = {
    "searches": LONG["solve a path by processes"],
    "sweep": ("study", "sweep", "pump.toml", "--vary", "loads.pressing.force=1..3 kN:9000", "--workers", "2", "--out", "out"),
    "samples": (*LONG["tolerance"], "--workers", "2"),
    "simulations": (*TUNED[:-1], "2", "--revolutions", "500", "--integrator", "cvodes"),
    "compiled simulations": (*TUNED[:-1], "2", "--revolutions", "9000", "--integrator", "compiled"),
}


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="the table of processes of Linux")
@pytest.mark.slow
@pytest.mark.parametrize(("case", "number"), [*((case, signal.SIGKILL) for case in PARALLEL), ("sweep", signal.SIGTERM)])
def test_workers_end_with_their_parent(case, number, files):
    """However the parent process ends, in the middle of long and compiled work too, its workers end."""
    with subprocess.Popen(
        [*COMMAND, *PARALLEL[case]], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=files, start_new_session=True
    ) as process:
        at_work(process, 5.0)
        children = workers(process.pid)
        process.send_signal(number)
        process.wait(10)
        begin = time.monotonic()
        left = children
        while left and time.monotonic() - begin < 30.0:
            time.sleep(0.02)
            left = [child for child in left if runs(child)]
        duration = time.monotonic() - begin
        for child in left:
            os.kill(child, signal.SIGKILL)
    assert len(children) == 2
    assert duration < 2.0, duration


@posix
@pytest.mark.slow
@pytest.mark.parametrize("case", LONG)
def test_ctrl_c_ends_long_work_with_one_sentence_and_no_pictures(case, files):
    code, _, err = press(LONG[case], 1.5, files)
    assert code == 130, err
    assert "Traceback" not in err
    assert "nterrupted" in err
    left = {path.name for path in files.rglob("*") if path.is_file()} - {"bean.toml", "pump.toml"}
    assert not any(name.endswith((".html", ".png", ".gif", ".dxf", ".svg")) for name in left), left
    if "result.json" in left:
        assert json.loads((files / "out" / "result.json").read_text())["interrupted"] is True


@posix
@pytest.mark.slow
def test_ctrl_c_during_a_proof_keeps_the_design_and_the_bound(files):
    """Five seconds of work: the local search takes two of them, the proof would take minutes."""
    code, out, err = press(("solve", "law-slider-crank", "--certify", "--gap", "1e-9", "--details"), 5.0, files)
    assert code == 130, err
    assert "Interrupted: the design is complete, the proof that it is the global optimum is incomplete: a design could" in err
    assert "Traceback" not in err
    assert "optimal, valid" in out
    assert "lower bound" in out


@posix
def test_a_second_ctrl_c_kills_at_once(files):
    script = "import time\nfrom optlink.execution import interrupts\ninterrupts.listen()\n"
    script += "try:\n    print('ready', flush=True)\n    time.sleep(60)\n"
    script += "except KeyboardInterrupt:\n    interrupts.handled()\n    time.sleep(60)\n"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", script], **pipes) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGINT)
        time.sleep(0.5)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "killed" in err


@posix
def test_a_lost_interrupt_is_raised_again():
    """Python drops what is raised in a destructor, as casadi does in some of its callbacks; compiled modules print it first."""
    script = "import os, signal, sys, time\nfrom optlink.execution import interrupts\ninterrupts.listen()\n"
    script += "class Thing:\n    def __del__(self):\n        try:\n"
    script += "            os.kill(os.getpid(), signal.SIGINT)\n            time.sleep(0.01)\n"
    script += "        except KeyboardInterrupt:\n            sys.excepthook(*sys.exc_info())\n            raise\n"
    script += "Thing()\ntry:\n    print('lost', flush=True)\n    time.sleep(60)\n"
    script += "except KeyboardInterrupt:\n    interrupts.handled()\n    time.sleep(0.6)\n    print('kept')\n"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "lost\nkept\n", "")


@pytest.mark.slow
@posix
def test_compiled_code_that_does_not_return_is_ended():
    script = "import hashlib, signal, threading, os\nfrom optlink.execution import interrupts\n"
    script += "interrupts.PATIENCE = 0.5\ninterrupts.listen()\n"
    script += "threading.Timer(0.2, os.kill, [os.getpid(), signal.SIGINT]).start()\n"
    script += "hashlib.pbkdf2_hmac('sha256', b'a', b'b', 10 ** 9)\n"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 130
    assert "compiled code" in done.stderr


@posix
def test_ipopt_passes_an_interrupt_on(monkeypatch):
    from optlink.execution import interrupts
    from optlink.solvers import ipopt

    class Solver:
        """Stops at Ctrl-C and returns, as casadi does."""

        def __call__(self, **_):
            monkeypatch.setattr(interrupts, "_pressed", True)
            return {"x": [0.0]}

        def stats(self):
            return {"iter_count": 1, "return_status": "User_Requested_Stop"}

    problem = optlink.load("crank-rocker").spec
    from optlink.optimization.programme import build

    nlp = build(problem)
    monkeypatch.setattr(ipopt, "compiled", lambda *_: Solver())
    with pytest.raises(KeyboardInterrupt):
        ipopt.ipopt(nlp, nlp.x_start, nlp.p)


@pytest.mark.slow
@posix
def test_unwritable_output_gives_one_sentence():
    for arguments in (("list",), ("solve", "crank-rocker", "--json")):
        with open("/dev/full", "w", encoding="utf-8") as full:
            done = run(*arguments, capture_output=False, stdout=full, stderr=subprocess.PIPE)
        assert done.returncode == 2
        assert done.stderr.count("\n") == 1
        assert "cannot write the output: No space left" in done.stderr


@pytest.mark.slow
@posix
@pytest.mark.parametrize("arguments", [("list",), ("show", "six-bar", "--toml"), ("solve", "crank-rocker", "--json")])
def test_a_closed_pipe_is_not_a_failure(arguments):
    read, write = os.pipe()
    os.close(read)
    done = run(*arguments, capture_output=False, stdout=write, stderr=subprocess.PIPE)
    os.close(write)
    assert done.returncode in (0, 141)
    assert done.stderr == ""


@pytest.mark.slow
@posix
def test_a_table_goes_to_standard_output_until_the_reader_closes_it():
    words = f"{sys.executable} -m optlink analyze scotch-yoke --points 5000 --csv /dev/stdout"
    for reader, code in (("cat", 0), ("head -n 1", 141)):
        done = subprocess.run(
            ["bash", "-c", f"{words} | {reader}; exit ${{PIPESTATUS[0]}}"], capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stderr) == (code, "")
        assert done.stdout.startswith("crank_angle_deg,")


@pytest.mark.slow
@posix
def test_closed_streams_are_not_a_failure(tmp_path):
    """Such as `>&-` of a shell: nothing is printed, and nothing of the one stream appears on the other."""
    words = f"{sys.executable} -m optlink show nowhere --json"
    for closed, code in ((">&-", 2), ("2>&-", 2), (">&- 2>&- <&-", 2)):
        done = subprocess.run(["sh", "-c", f"{words} {closed}"], capture_output=True, text=True, check=False, cwd=tmp_path)
        assert done.returncode == code
        assert "Traceback" not in done.stderr
        assert (closed == ">&-") == done.stderr.startswith("Error: ")
        assert (closed == "2>&-") == done.stdout.startswith("{")


@contextlib.contextmanager
def no_longer_than(seconds):
    """Raise an error in what has not ended after some seconds."""

    def late(*_):
        raise AssertionError(f"not ended after {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


ENDLESS = {
    "a law": ("show", "crank-rocker", "--set", 'requirement.law={{ csv = "{}" }}'),
    "a load": ("show", "slider-crank", "--set", 'loads.push={{ on = "slider", force = {{ over = "phi", csv = "{}" }} }}'),
    "a tolerance": ("study", "tolerance", "crank-rocker", "--tolerance", "coupler={}"),
}


@pytest.mark.slow
@posix
@pytest.mark.parametrize("case", ENDLESS)
@pytest.mark.parametrize("name", ["/dev/zero", "pipe.csv", "folder.csv", "x" * 300 + ".csv", "large.csv"])
def test_files_of_numbers_are_plain_files_of_moderate_size(case, name, tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "folder.csv").mkdir()
    with open(tmp_path / "large.csv", "wb") as file:
        file.truncate(200_000_000)
    place = name if name.startswith("/") else str(tmp_path / name)
    if case == "a tolerance" and name == "/dev/zero":
        os.symlink(name, tmp_path / "zero.csv")
        place = str(tmp_path / "zero.csv")
    with no_longer_than(60):  # a pipe would be waited for, a device read for ever
        done = CliRunner().invoke(app, [argument.format(place) for argument in ENDLESS[case]])
    assert done.exit_code == 2, done.stderr
    assert isinstance(done.exception, SystemExit)  # nothing else would be a traceback
    assert "cannot read the file" in done.stderr or "is larger than" in done.stderr


HUGE = "9" * 400


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("function-log10", "requirement.law.x", [1, int(HUGE)]),
        ("path-bean", "limits.link_ratio", [0.1, int(HUGE)]),
        ("slider-crank", "bodies.slider.mass", int(HUGE)),
        ("six-bar", "expected.figures", {"input.torque_Nm.max": int(HUGE)}),
    ],
)
def test_an_integer_of_400_digits_is_refused_with_its_position(name, key, value):
    with pytest.raises(optlink.InputError, match="too large") as refused:
        optlink.load(name).override({key: value})
    assert refused.value.faults[0].key.startswith(key)


@pytest.mark.parametrize("checkpoint", [True, False])
def test_an_interrupted_run_with_a_checkpoint_says_how_to_resume_it(tmp_path, monkeypatch, capsys, checkpoint):
    if checkpoint:
        (tmp_path / "checkpoint.json").write_text("{}")
    monkeypatch.setattr(console.interrupts, "interrupted", lambda: True)
    result = SimpleNamespace(valid=False, status="interrupted", to_dict=dict)
    with pytest.raises(typer.Exit):
        console.deliver(result, True, tmp_path)
    assert ("; add --resume to continue" in capsys.readouterr().err) is checkpoint


class Killed(BaseException):
    """Stands for SIGKILL: nothing handles it."""


SHORT = ("--revolutions", "2", "--points", "36", "--tolerance", "1e-5", "--integrator", "cvodes")
RESUMED = {
    "simulation": ("simulate", "slider-crank-clearance", *SHORT),
    "comparison": ("simulate", "crank-rocker-clearance", "--control", "compare", "--starts", "1", "--workers", "1", *SHORT),
    "sweep": ("study", "sweep", "crank-rocker", "--vary", "mechanism.frame=490 mm, 500 mm", "--workers", "1"),
    "front": ("study", "pareto", "crank-rocker", "--objectives", "error, limits.transmission_angle.max", "--points", "2"),
}
ENDS = [(case, View, "write") for case in RESUMED] + [(case, Store, "finish") for case in ("sweep", "front")]


@pytest.mark.slow
@pytest.mark.parametrize(("case", "part", "step"), ENDS, ids=[f"{case}-{step}" for case, _, step in ENDS])
def test_a_run_killed_between_its_last_row_and_its_results_is_resumed(case, part, step, tmp_path, monkeypatch):
    """What is done is what has been written: all is there but the results, and nothing is searched or simulated again."""

    def kill(*_: object, **__: object) -> None:
        raise Killed

    words, runner = RESUMED[case], CliRunner()
    whole = runner.invoke(app, [*words, "--out", str(tmp_path / "whole")])
    with monkeypatch.context() as patch:
        patch.setattr(part, step, kill)
        with pytest.raises(Killed):
            runner.invoke(app, [*words, "--out", str(tmp_path / "cut")])
    assert not (tmp_path / "cut" / "result.json").exists()
    resumed = runner.invoke(app, [*words, "--out", str(tmp_path / "cut"), "--resume"])
    assert resumed.exit_code == whole.exit_code == 0, resumed.output
    one, other = (json.loads((tmp_path / folder / "result.json").read_text()) for folder in ("whole", "cut"))
    for document in (one, other):
        for timed in ("seconds", "processor_seconds", "points_done_now", "table", "columns", "crc32"):
            document.pop(timed, None)
    assert one == other
    assert {file.name for file in (tmp_path / "whole").iterdir()} == {file.name for file in (tmp_path / "cut").iterdir()}
    again = runner.invoke(app, [*words, "--out", str(tmp_path / "cut"), "--resume"])  # now it is done
    assert again.exit_code == (0 if case in ("sweep", "front") else 2), again.output


IMPORTING = """import signal, sys
class Press:
    def find_spec(self, name, path=None, target=None):
        if name == "MODULE":
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Press())
sys.argv = ["optlink", *WORDS]
from optlink.__main__ import main
main()
"""
LOADED = ("typer", "optlink.cli.app", "optlink.cli.study", "optlink.execution.interrupts", "pydantic", "optlink.problem.file")
LOADED_LATER = ("numpy", "casadi", "optlink.solvers.multistart", "optlink.tasks.run", "scipy.optimize")


@posix
@pytest.mark.parametrize("module", mostly_slow((*LOADED, *LOADED_LATER), "typer", "optlink.cli.study"))
def test_ctrl_c_during_imports_ends_in_one_sentence_or_silence(module):
    code = IMPORTING.replace("MODULE", module).replace("WORDS", "('solve', 'crank-rocker', '--backend', 'slsqp')")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 130, done.stderr
    assert done.stdout == ""
    assert done.stderr in ("", "Error: interrupted before there was a result\n")
