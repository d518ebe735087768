"""The compiled integrator: the same motions as CVODES, the translation of formulas, its choice, and its cache."""

from __future__ import annotations

import contextlib
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import casadi
import numpy as np
import pytest

import optlink
from optlink.clearance import control
from optlink.clearance.compiled import machine
from optlink.clearance.compiled.integration import CompiledIntegration
from optlink.clearance.compiled.machine import LITERALS, OPERATIONS, Unsupported, written
from optlink.clearance.control import ClosedLoop, IntegratorKind, chosen
from optlink.dynamics.forward import Ending
from optlink.errors import InputError
from optlink.tasks.clearance import COMPILING, _setting, simulate_clearance

SHIPPED = ("slider-crank-clearance", "crank-rocker-clearance", "slider-crank-three-gaps")


def shares(problem: optlink.ProblemFile, part: float, **options) -> dict[str, float]:
    """Differences of the engines over the first part of a revolution, as shares of the largest value, at a tight tolerance."""
    one, other = (
        simulate_clearance(problem, 1, 360, tolerance=1e-12, check_predictability=False, integrator=integrator, **options)
        for integrator in ("cvodes", "compiled")
    )
    assert (one.integrator, other.integrator) == ("cvodes", "compiled")
    rows = slice(0, round(360 * part))
    units = ("_N", "_Nm", "_J", "_W", "_rad_s2", "_m_s2")
    sizes = {unit: max((np.max(np.abs(one[n][rows])) for n in one.columns if n.endswith(unit)), default=0.0) for unit in units}
    off = {}
    for name in one.columns:
        size = next((size for unit, size in sizes.items() if name.endswith(unit)), np.max(np.abs(one[name][rows])))
        off[name] = float(np.max(np.abs(one[name][rows] - other[name][rows]))) / max(size, 1e-9)
    until = part * 2.0 * math.pi / abs(one.speed)
    mine, theirs = ([impact for impact in run.impacts if impact.end < until] for run in (one, other))
    assert len(mine) == len(theirs) > 2
    for a, b in zip(mine, theirs, strict=True):
        assert tuple(b) == pytest.approx(tuple(a), rel=1e-5)
    return off


@pytest.mark.slow
def test_engines_agree():
    assert max(shares(optlink.load(SHIPPED[0]), 1.0).values()) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "control"),
    [
        *((name, control) for name in SHIPPED[:2] for control in ("none", "inverse", "pid", "inverse+pid")),
        *((SHIPPED[2], control) for control in ("none", "inverse+pid")),
    ],
)
def test_engines_agree_on_the_shipped_machines(name, control):
    """Three gaps scatter: their runs are compared until differences of rounding have grown by a few powers of ten."""
    part = 0.1 if name.endswith("three-gaps") else 0.5
    assert max(shares(optlink.load(name), part, control=control).values()) < 2e-5


@pytest.mark.slow
def test_engines_give_the_same_peaks_and_energy_account():
    problem = optlink.load(SHIPPED[0])
    one, other = (
        simulate_clearance(problem, 3, 36, tolerance=1e-11, check_predictability=False, integrator=integrator)
        for integrator in ("cvodes", "compiled")
    )
    for name in ("largest_normal_N", "largest_penetration_m", "torque_max_Nm", "rms_m", "C.impact.work_J", "C.friction.work_J"):
        assert other.figures[name] == pytest.approx(one.figures[name], rel=1e-6), name
    for run in (one, other):
        assert run.figures["imbalance_J"] < 1e-7 * run.figures["largest_energy_J"]
    assert len(one.impacts) == len(other.impacts)


@pytest.mark.slow
def test_planted_defect_is_detected(monkeypatch):
    """A work that is not integrated, and a servo reference without its harmonics."""
    problem = optlink.load(SHIPPED[0])
    code_of = machine.code_of

    def spoilt(equations):
        code = code_of(equations)
        first, _, rest = code.text.partition("def rhs(x, p, c, o):\n")
        body, mark, others = rest.partition("@cfunc")
        return machine.MachineCode(
            f"{first}def rhs(x, p, c, o):\n{body.rstrip()}\n    o[6] = 0.0\n\n\n{mark}{others}", code.constants
        )

    monkeypatch.setattr("optlink.clearance.compiled.integration.code_of", spoilt)
    assert shares(problem, 0.2)["work.drive_J"] > 1e-3
    monkeypatch.setattr("optlink.clearance.compiled.integration.code_of", code_of)
    begin = CompiledIntegration.__post_init__

    def evenly(self):
        begin(self)
        self._model[-1][:] = 0.0

    monkeypatch.setattr(CompiledIntegration, "__post_init__", evenly)
    with pytest.raises(AssertionError):
        assert shares(problem, 0.2, control="inverse")["slider.s_m"] < 1e-3


@pytest.mark.slow
def test_resumed_compiled_run_is_the_uninterrupted_one_to_the_last_digit():
    problem = optlink.load(SHIPPED[2])
    options = {"control": "inverse+pid", "tolerance": 1e-8}
    whole = simulate_clearance(problem, 3, 100, integrator="compiled", **options)
    checkpoints: list[dict] = []
    simulate_clearance(problem, 2, 100, integrator="compiled", checkpoint=checkpoints.append, **options)
    on = simulate_clearance(problem, 3, 100, resume=checkpoints[-1], **options)  # keeps its integrator
    assert on.integrator == "compiled"
    assert dict(on.figures) == dict(whole.figures)
    assert np.array_equal(on["slider.s_m"], whole["slider.s_m"][200:])
    with pytest.raises(InputError, match="another command"):
        simulate_clearance(problem, 3, 100, resume=checkpoints[-1], integrator="cvodes", **options)


@pytest.mark.slow
def test_comparison_with_the_compiled_engine_in_processes_is_the_same_to_the_bit():
    problem = optlink.load(SHIPPED[2])
    options = {"starts": 2, "seed": 7, "kinds": ("none", "pid"), "points": 60, "integrator": "compiled"}
    alone, shared = (optlink.control.compare(problem, 2, workers=workers, **options) for workers in (None, 2))
    for kind in ("none", "pid"):
        np.testing.assert_array_equal(alone.trials[kind].rms, shared.trials[kind].rms)
        assert alone.examples[kind].integrator == "compiled"


@pytest.mark.slow
def test_stalls_and_interrupts_of_the_compiled_engine(monkeypatch):
    raw = optlink.load(SHIPPED[0]).override(
        {"joints.C.modulus": None, "joints.C.stiffness": "1 N/m^1.5", "joints.C.poisson": None}
    )
    result = simulate_clearance(raw, 3, check_predictability=False, integrator="compiled")
    assert result.ending is Ending.STALLED
    assert "deep in its bearing" in result.message
    assert 0.0 < result.stopped < 0.05
    stopped = []
    original = CompiledIntegration._call

    def once(self, rows):
        stopped.append(rows)
        if len(stopped) == 5:
            self.stop = lambda: True
        return original(self, rows)

    monkeypatch.setattr(CompiledIntegration, "_call", once)
    result = simulate_clearance(optlink.load(SHIPPED[0]), 30, 36, check_predictability=False, integrator="compiled")
    assert result.ending is Ending.INTERRUPTED
    assert len(stopped) == 5


# --- translation ---------------------------------------------------------------------------------------------------------


def python_functions(text: str) -> dict:
    """The functions of a source, without numba."""
    room: dict = {}
    lines = [
        line for line in text.splitlines() if not line.startswith(("from numba", "@cfunc", "_P =", "_SIGNATURE", "_OPTIONS"))
    ]
    exec("\n".join(lines), room)
    return room


def test_translation_gives_the_values_of_casadi():
    x, p = casadi.SX.sym("x", 2), casadi.SX.sym("p", 2)
    a, b, c, d = x[0], x[1], p[0], p[1]
    several = [
        *(a + b, a - b, a * b, a / b, -a, casadi.exp(a), casadi.log(b), b**a, casadi.sqrt(b), a * a, a + a, 1.0 / b),
        *(casadi.sin(a), casadi.cos(a), casadi.tan(a), casadi.asin(a), casadi.acos(a), casadi.atan(a), casadi.atan2(a, b)),
        *(casadi.sinh(a), casadi.cosh(a), casadi.tanh(a), casadi.hypot(a, b), casadi.fabs(c), casadi.sign(c), casadi.sign(b)),
        *(casadi.floor(d), casadi.ceil(d), casadi.fmod(d, b), casadi.fmin(a, b), casadi.fmax(a, b), casadi.sign(0.0 * a + c - c)),
        *(a < b, a <= b, casadi.eq(a, b), casadi.ne(a, b), casadi.logic_not(a < b), casadi.logic_and(a < b, c < d)),
        *(
            casadi.logic_or(a > b, c > d),
            casadi.if_else(a < b, a * c, d),
            b**1.5,
            b**-2.5,
            b**3,
            7.25 * a - 0.3,
            casadi.fmax(c, -3.5),
        ),
    ]
    text, constants = written({"f": ([x, p], several)})
    values, out = ([0.3, 0.7], [-1.3, 2.9]), [0.0] * len(several)
    python_functions(text)["f"](*values, constants, out)
    expected = casadi.Function("f", [x, p], [casadi.vertcat(*several)])(*values)
    np.testing.assert_allclose(out, np.array(expected).ravel(), rtol=1e-14)
    assert {7.25, 0.3, -3.5} <= {round(value, 12) for value in [*constants, -constants[0]]} | {-0.3, 0.3}
    assert not set(np.abs(constants[:-1])) & set(LITERALS)


def test_operation_without_a_counterpart_is_reported():
    x = casadi.SX.sym("x", 1)
    assert casadi.OP_ERF not in OPERATIONS
    with pytest.raises(Unsupported, match="OP_ERF"):
        written({"f": ([x, casadi.SX.sym("p", 1)], [casadi.erf(x)])})


def plant_of(name: str, **changes) -> ClosedLoop:
    return _setting(optlink.load(name, changes), 36, None, "none", None, None, 0.0).closed_loop(1e-8)


def test_designs_of_a_machine_share_their_source():
    """Dimensions, masses, stiffness and control change constants, not the source; another load changes it."""
    one = machine.code_of(plant_of(SHIPPED[0]).equations)
    changes = {"mechanism.links.rod.length": "133 mm", "bodies.rod.mass": "0.3 kg", "joints.C.modulus": "150 GPa"}
    other = machine.code_of(plant_of(SHIPPED[0], **changes).equations)
    controlled = _setting(optlink.load(SHIPPED[0]), 36, None, "inverse", None, None, 0.0).closed_loop(1e-8).equations
    assert one.text == other.text == machine.code_of(controlled).text
    assert not np.array_equal(one.constants, other.constants)
    loads = {"loads.push": {"on": "slider", "force": "30 N", "direction": "180 deg"}}
    assert machine.code_of(plant_of(SHIPPED[0], **loads).equations).text != one.text


# --- choice and cache ----------------------------------------------------------------------------------------------------


def test_engine_is_chosen_by_the_work(monkeypatch):
    plant = plant_of(SHIPPED[0])
    assert chosen("auto", plant, 10) is IntegratorKind.CVODES
    assert chosen("auto", plant, 300) is IntegratorKind.COMPILED
    assert chosen("compiled", plant, 1) is IntegratorKind.COMPILED
    assert chosen("cvodes", plant, 1e6) is IntegratorKind.CVODES
    plant.integration.slow = True  # stiff: steps of an explicit method would follow every vibration
    assert chosen("auto", plant, 300) is IntegratorKind.CVODES
    plant.integration.slow = False
    with pytest.raises(InputError, match="no such integrator"):
        chosen("fast", plant, 1)
    monkeypatch.setattr(control, "installed", lambda: False)
    assert chosen("auto", plant, 300) is IntegratorKind.CVODES
    with pytest.raises(InputError, match=r"numba is not installed.*\[fast\]"):
        chosen("compiled", plant, 1)


CACHED = machine.is_cached  # the fixture of all tests replaces it


@pytest.mark.slow
def test_what_is_compiled_already_is_used_for_shorter_work(monkeypatch):
    plant = plant_of(SHIPPED[0])
    plant.compile()
    monkeypatch.setattr(machine, "is_cached", CACHED)
    assert machine.is_cached(plant.equations)
    assert chosen("auto", plant, 30, cache=True) is IntegratorKind.COMPILED
    assert chosen("auto", plant, 2, cache=True) is IntegratorKind.CVODES  # it takes longer to load
    assert chosen("auto", plant, 30) is IntegratorKind.CVODES  # of a study
    assert chosen("cvodes", plant, 30, cache=True) is IntegratorKind.CVODES
    plant.integration.slow = True
    assert chosen("auto", plant, 30, cache=True) is IntegratorKind.CVODES
    run = simulate_clearance(optlink.load(SHIPPED[0]), 20, 36)
    assert run.integrator == "compiled"
    reference = simulate_clearance(optlink.load(SHIPPED[0]), 20, 36, integrator="cvodes")
    assert run.figures["contacts"] == reference.figures["contacts"]
    loads = {"loads.push": {"on": "slider", "force": {"expression": "3*sin(phi)*s^5 + 2*v^3", "unit": "N"}}}
    assert not machine.is_cached(plant_of(SHIPPED[0], **loads).equations)


def test_without_a_cache_nothing_is_compiled_already(tmp_path, monkeypatch):
    monkeypatch.setenv(machine.FOLDER, str(tmp_path))
    assert not CACHED(plant_of(SHIPPED[0]).equations)
    (tmp_path / "__pycache__").mkdir()
    assert not CACHED(plant_of(SHIPPED[0]).equations)


@pytest.mark.slow
def test_short_run_does_not_import_numba():
    code = (
        "import sys, optlink; problem = optlink.load('slider-crank-clearance');"
        "optlink.control.simulate_clearance(problem, 1, 12, check_predictability=False);"
        "assert 'numba' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_compilation_is_announced(monkeypatch):
    seen = []

    @contextlib.contextmanager
    def compiling():
        seen.append("begins")
        yield
        seen.append("ends")

    monkeypatch.setattr(ClosedLoop, "compile", lambda self: seen.append("compiles"))
    said = COMPILING.set(compiling)
    simulate_clearance(optlink.load(SHIPPED[0]), 1, 12, check_predictability=False, integrator="compiled")
    COMPILING.reset(said)
    assert seen == ["begins", "compiles", "ends"]


def test_source_is_stored_once_and_repaired(tmp_path, monkeypatch):
    monkeypatch.setenv(machine.FOLDER, str(tmp_path / "deep" / "folder"))
    path = machine._stored("one = 1\n", "part.py")
    assert path == tmp_path / "deep" / "folder" / "part.py"
    assert path.read_text() == "one = 1\n"
    assert path.stat().st_mtime == machine.STAMP  # equal for all writers: numba's cache compares it
    before = path.stat().st_ino
    assert machine._stored("one = 1\n", "part.py").stat().st_ino == before
    path.write_text("one =")  # cut short
    assert machine._stored("one = 1\n", "part.py").read_text() == "one = 1\n"
    assert [file.name for file in path.parent.iterdir()] == ["part.py"]


def test_cache_that_cannot_be_written_is_elsewhere(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv(machine.FOLDER, str(blocked / "folder"))
    monkeypatch.setattr(machine.tempfile, "gettempdir", lambda: str(tmp_path))
    assert machine._stored("two = 2\n", "part.py").parent.parent == tmp_path


@pytest.mark.slow
def test_processes_that_compile_at_the_same_time_agree(tmp_path):
    """Two processes without the equations of a machine in their cache; a third finds them. The engine is copied there before."""
    simulate_clearance(
        optlink.load(SHIPPED[0]), 1, 12, check_predictability=False, integrator="compiled"
    )  # compiles the engine, if it has to
    source = Path(machine.engine().__file__)
    shutil.copy2(source, tmp_path)
    (tmp_path / "__pycache__").mkdir()
    for file in source.parent.glob(f"__pycache__/{source.stem}.*"):
        shutil.copy2(file, tmp_path / "__pycache__")
    code = """
import sys, optlink
problem = optlink.load("slider-crank-clearance")
found = optlink.control.simulate_clearance(problem, 1, 12, check_predictability=False, integrator="compiled")
from optlink.clearance.compiled import machine
[equations] = [module for module in [*sys.modules.values()] if hasattr(module, "rhs") and hasattr(module, "project")]
print(repr(found.figures["rms_m"]), equations.rhs.cache_hits, sum(machine.engine().advance.stats.cache_hits.values()))
"""
    room = {**os.environ, machine.FOLDER: str(tmp_path)}

    def begin():
        return subprocess.Popen([sys.executable, "-c", code], env=room, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def end(process):
        out, err = process.communicate(timeout=300)
        assert process.returncode == 0, err
        return out.split()

    computed = [end(process) for process in [begin() for _ in range(2)]]
    last = end(begin())
    assert {figure for figure, *_ in [*computed, last]} == {last[0]}
    assert "0" in [hits for _, hits, _ in computed]  # at least the first one compiled
    assert last[1:] == ["1", "1"]
    assert not list(tmp_path.glob("*.tmp"))
