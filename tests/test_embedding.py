"""What docs/embedding.md states of a program that calls optlink: threads, signals, the state of the process."""

import json
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

NAMES = ["crank-rocker", "law-slider-crank", "stroke-crank-rocker", "motion-3-poses"]
SCRIPT = f"""
import json, signal, sys, threading
from concurrent.futures import ThreadPoolExecutor

def press(*_): ...

def hook(*_): ...

signal.signal(signal.SIGINT, press)
sys.excepthook = sys.unraisablehook = hook
error, output = sys.stderr, sys.stdout
import optlink
assert not {{"numpy", "scipy", "casadi"}} & set(sys.modules)

def solved(name):
    found = optlink.solve(name)
    return found.objective, dict(found.best.design if hasattr(found.best, "design") else found.best.values)

with ThreadPoolExecutor(4) as pool:
    together = list(pool.map(solved, {NAMES!r}))
alone = list(map(solved, {NAMES!r}))
import casadi
assert signal.getsignal(signal.SIGINT) is press
assert sys.excepthook is hook and sys.unraisablehook is hook
assert sys.stderr is error and sys.stdout is output
assert casadi.GlobalOptions.getNumpyMode() == int(sys.argv[1])
assert threading.active_count() == 1
print(json.dumps([together, alone]))
"""
MODE = "import casadi; print(casadi.GlobalOptions.getNumpyMode())"


def done(*words: str) -> str:
    found = subprocess.run([sys.executable, "-c", *words], capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    assert found.stderr == ""
    return found.stdout


@pytest.mark.slow
def test_threads_find_what_one_thread_finds_and_leave_the_process_as_it_was() -> None:
    together, alone = json.loads(done(SCRIPT, done(MODE).strip()))
    assert together == alone


def test_ctrl_c_has_the_handler_of_before_after_a_study() -> None:
    from optlink.execution.interrupts import watched

    mine = signal.getsignal(signal.SIGINT)
    with watched() as asked:
        assert not asked()
    assert signal.getsignal(signal.SIGINT) is mine
    with ThreadPoolExecutor(1) as pool:  # signals belong to the main thread

        def inside() -> bool:
            with watched():
                return signal.getsignal(signal.SIGINT) is mine

        assert pool.submit(inside).result()
