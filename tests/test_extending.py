"""The recipes of CONTRIBUTING.md, each in one module outside the package: through command line, page and validation."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from itertools import chain
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from docs.generate.extending import ADDITIONS
from optlink import InputError
from optlink.cli.app import app
from optlink.extending import (
    ChartSpec,
    DyadType,
    LimitTerm,
    LoadKind,
    ProblemKind,
    QuantityType,
    ResultChart,
    Solver,
    crank_angle,
    register,
)
from optlink.io import Entry
from optlink.problem.limits import MODELS
from optlink.problem.machine.loads import LOADS
from optlink.studio import design as studio_design

FOLDER = Path(__file__).parent / "extending"
REGISTRIES = [one.entry.registry for one in ADDITIONS]
LONGEST = 110  # lines of an extension


@pytest.fixture
def extended():
    """A function that registers an extension until the end of the test."""
    before = [dict(registry) for registry in REGISTRIES]
    fields = [dict(model.model_fields) for model in MODELS]
    modules: list[str] = []

    def register(name: str) -> None:
        modules.append(f"tests.extending.{name}")
        importlib.import_module(modules[-1])

    yield register
    for registry, items in zip(REGISTRIES, before, strict=True):
        registry.clear()
        registry.update(items)
    for model, own in zip(MODELS, fields, strict=True):
        model.model_fields.clear()
        model.model_fields.update(own)
    for model in MODELS:
        model.model_rebuild(force=True)
    for module in modules:
        sys.modules.pop(module, None)


def run(*arguments: str, code: int = 0):
    """Run a command in this process and return its output."""
    done = CliRunner().invoke(app, list(arguments))
    assert done.exit_code == code, done.output
    return done.stdout if code == 0 else done.stderr


def solved(*arguments: str, code: int = 0):
    done = CliRunner().invoke(app, [*arguments, "--json"])
    assert done.exit_code == code, done.output
    return json.loads(done.stdout)


def page(tmp_path: Path, *arguments: str) -> str:
    run("report", *arguments, "-o", str(tmp_path / "page.html"))
    return (tmp_path / "page.html").read_text()


@pytest.mark.parametrize("path", sorted(FOLDER.glob("[a-z]*.py")), ids=lambda path: path.stem)
def test_an_extension_is_short(path):
    assert len(path.read_text().splitlines()) <= LONGEST


def test_a_new_constraint(extended, tmp_path):
    changes = ("--set", "limits.coupler_ratio=[0.1, 2.5]")
    assert "unknown key" in run("solve", "crank-rocker", *changes, code=2)
    extended("constraint")
    document = solved("solve", "crank-rocker", *changes)
    assert document["design"]["coupler_mm"] / document["design"]["crank_mm"] == pytest.approx(2.5, rel=1e-6)
    limit = next(limit for limit in document["limits"] if limit["key"] == "limits.coupler_ratio" and limit["active"])
    assert limit["bound"] == 2.5
    step = 1e-4
    further = solved("solve", "crank-rocker", "--set", f"limits.coupler_ratio=[0.1, {2.5 + step}]")
    price = (further["objective"]["value"] - document["objective"]["value"]) / step
    assert limit["multiplier"] == pytest.approx(price, rel=1e-2)
    names = {check["name"]: check["passed"] for check in document["validation"]}
    assert names["coupler / crank, largest"]
    assert "coupler / crank" in page(tmp_path, "crank-rocker", *changes)
    assert "coupler_ratio" in run("show", "crank-rocker", *changes)
    assert "out of range" in run("solve", "crank-rocker", "--set", "limits.coupler_ratio=[-1.0, 2.0]", code=2)


def test_the_validator_measures_a_new_constraint_itself(extended):
    extended("constraint")
    free = optlink.solve(optlink.load("crank-rocker"))
    tight = optlink.load("crank-rocker", {"limits.coupler_ratio": [0.1, 2.5]})
    failed = [check.name for check in optlink.validate(tight, free.design).validation.checks if not check.passed]
    assert failed == ["coupler / crank, largest"]


def test_a_new_constraint_of_a_path(extended):
    extended("constraint")
    problem = optlink.load("path-arc5", {"limits.coupler_ratio": [0.5, 2.0]})
    best = optlink.solve(problem, starts=1, designs=1).best
    assert best is not None
    assert best.valid
    assert 0.5 - 1e-6 <= best.values["coupler"] / best.values["crank"] <= 2.0 + 1e-6


TURNING = {"objective": {"quantity": "turning", "of": "rocker", "measure": "peak"}}
SLOW_ROCKER = {
    "title": "Slow rocker",
    "mechanism": {
        "type": "four-bar",
        "crank": "100 mm",
        "coupler": {"start": "300 mm", "bounds": ["250 mm", "450 mm"]},
        "rocker": {"start": "250 mm", "bounds": ["200 mm", "320 mm"]},
        "frame": "350 mm",
    },
    "drive": {"body": "crank", "speed": "60 rpm"},
    "limits": {"swing": {"quantity": "stroke", "of": "rocker", "exactly": "50 deg"}},
    **TURNING,
}


def test_a_new_objective(extended, tmp_path):
    raw = SLOW_ROCKER
    with pytest.raises(InputError, match="not one of the choices"):
        optlink.read(raw)
    extended("objective")
    file = tmp_path / "slow.toml"
    file.write_text(optlink.problem.file.dump(optlink.read({**raw, **TURNING})))
    assert solved("solve", str(file), "--starts", "1")["valid"]
    result = optlink.solve(optlink.load(file), starts=1)
    motion = optlink.analyze(result.machine, points=3600)
    assert result.objective == pytest.approx(np.max(np.abs(motion.columns["rocker.omega_rad_s"])), rel=1e-5)
    assert "peak turning of rocker" in page(tmp_path, str(file), "--starts", "1")
    assert "no such body" in run("solve", str(file), "--set", "objective.of=roker", code=2)
    limited = optlink.read(
        {**raw, "objective": {"quantity": "stroke", "of": "rocker"}, "limits": {"top": TURNING["objective"] | {"max": "30 rpm"}}}
    )
    assert optlink.solve(limited, starts=1).valid


@pytest.mark.slow
def test_a_new_back_end(extended, tmp_path):
    assert "trust-constr" in run("solve", "crank-rocker", "--backend", "trust-constr", code=2)
    extended("back_end")
    document = solved("solve", "crank-rocker", "--backend", "trust-constr", "--out", str(tmp_path))
    reference = solved("solve", "crank-rocker")
    assert document["backend"] == "trust-constr"
    assert document["valid"]
    assert document["objective"]["value"] == pytest.approx(reference["objective"]["value"], rel=1e-6)
    assert len(list(tmp_path.glob("*.png"))) > 3
    assert "trust-constr" in page(tmp_path, str(tmp_path / "result.json"))
    assert solved("solve", "crank-rocker", "--backend", "both")["valid"]


def test_a_new_dyad(extended, tmp_path):
    reference = optlink.analyze(optlink.load("scotch-yoke"), points=180)
    built_in = DyadType.registry.pop("RPP")
    with pytest.raises(InputError):
        optlink.load("scotch-yoke")
    extended("dyad")
    problem = optlink.load("scotch-yoke")
    assert [group.kind for group in problem.model.linkage.groups] == ["yoke"]
    analysis = optlink.analyze(problem, points=180)
    for name, column in reference.columns.items():
        assert np.allclose(analysis.columns[name], column, rtol=1e-9, atol=1e-9 * max(1.0, float(np.max(np.abs(column))))), name
    assert DyadType.registry["RPP"] is not built_in
    assert solved("analyze", "scotch-yoke")["groups"][0]["kind"] == "yoke"
    assert np.max(analysis.columns["input.torque_Nm"]) == pytest.approx(57.129, rel=1e-3)
    assert "Scotch yoke" in page(tmp_path, "scotch-yoke")


@pytest.mark.slow
def test_a_new_kind_of_result_and_its_view(extended, tmp_path):
    raw = dict(optlink.load("six-bar").raw)
    raw.pop("expected", None)
    stated = {**raw, "clearing": {"point": "C", "least": "10 mm"}}
    with pytest.raises(InputError, match="unknown key"):
        optlink.read(stated)
    extended("kind")
    extended("view")
    file = tmp_path / "clearing.toml"
    file.write_text(optlink.problem.file.dump(optlink.read(stated)))
    with pytest.raises(InputError, match="no nonlinear programme of its dimensions"):
        optlink.build(optlink.load(str(file)))
    document = solved("solve", str(file), "--out", str(tmp_path / "out"))
    assert document["valid"]
    assert {name for name in vars(optlink.DesignResult) if not name.startswith("_")} <= set(
        dir(optlink.solve(optlink.load(file)))
    )
    assert json.loads((tmp_path / "out" / "result.json").read_text())["distance_m"] == document["distance_m"]
    assert "least distance" in run("solve", str(file))
    shown = page(tmp_path, str(file))
    assert "agrees with a sweep" in shown
    assert "Linkage in motion" in shown
    assert solved("solve", str(file), "--set", "clearing.least=10 m", code=1)["valid"] is False
    analysed = studio_design.solved_design(optlink.read({**raw, "clearing": {"point": "C", "least": "10 m"}}))
    assert analysed.status == "not verified"  # its own validation is not that of the studio
    assert "optlink solve" in analysed.conclusion
    assert studio_design.solved_design(optlink.read(raw)).status == "verified"
    stored = page(tmp_path, str(tmp_path / "out"))
    assert "agrees with a sweep" in stored
    assert "Linkage in motion" in stored
    assert optlink.read_result(tmp_path / "out").to_dict() == document
    other = tmp_path / "other.json"
    other.write_text(json.dumps(document | {"distance_m": 2.0 * document["distance_m"]}))
    assert "the result was changed" in run("report", str(other), "-o", str(tmp_path / "no.html"), code=2)
    assert "unknown key" in run("solve", str(file), "--set", "clearing.poit=B", code=2)


AIR = {"on": "rocker", "at": "C", "drag": 1.2, "width": "300 mm", "height": "200 mm"}
WINDY = SLOW_ROCKER | {
    "bodies": {name: {"mass": "1 kg", "inertia": "uniform bar"} for name in ("crank", "rocker")},
    "objective": {"quantity": "torque", "measure": "peak"},
    "loads": {"air": AIR},
}


@pytest.mark.slow
def test_a_new_load(extended, tmp_path):
    with pytest.raises(InputError, match="unknown key"):
        optlink.read(WINDY)
    extended("load")
    file = tmp_path / "windy.toml"
    file.write_text(optlink.problem.file.dump(optlink.read(WINDY)))
    windy, calm = (optlink.analyze(optlink.read(raw), points=3600) for raw in (WINDY, {**WINDY, "loads": {}}))
    velocity = np.gradient(np.stack([windy["C.x_m"], windy["C.y_m"]]), windy.positions / windy.speed, axis=1)  # by differences
    power = 0.5 * 1.2 * 1.2 * 0.06 * np.linalg.norm(velocity, axis=0) ** 3
    added = (windy["input.torque_Nm"] - calm["input.torque_Nm"]) * windy.speed
    assert added[1:-1] == pytest.approx(power[1:-1], abs=1e-4 * np.max(power))
    assert np.max(power) > 1e-3
    result = optlink.solve(optlink.load(file), starts=1)
    assert result.valid
    found = optlink.analyze(result.machine, points=3600)
    assert result.objective == pytest.approx(np.max(np.abs(found["input.torque_Nm"])), rel=1e-4)
    run_down = optlink.simulate(optlink.load(file, {"drive.torque": "1 N*m"}), duration=0.5)
    assert run_down.valid
    assert run_down["air.work_J"][-1] < 0.0
    balanced = optlink.load("balance-four-bar", {"loads.air": {**AIR, "width": "30 mm"}})
    assert optlink.solve(balanced).valid
    assert "on rocker, at C, drag 1.2" in page(tmp_path, str(file), "--starts", "1")
    assert "the body has no such point. Known: D, C" in run("analyze", str(file), "--set", "loads.air.at=B", code=2)
    assert "a load with drag has no stiffness" in run("analyze", str(file), "--set", "loads.air.stiffness=1 N/m", code=2)
    assert "damping, drag" in run("analyze", "six-bar", "--set", 'loads.air={ on = "slider" }', code=2)
    assert 'Did you mean "width"' in run("analyze", str(file), "--set", "loads.air.wdth=1 m", code=2)
    schema = optlink.presentation.registry.json_schema("problem")
    assert schema["$defs"]["DragLoad"]["properties"]["drag"]["description"] == "Drag coefficient."
    validator = jsonschema.Draft202012Validator(schema)
    assert validator.is_valid(WINDY)
    assert not validator.is_valid({**WINDY, "loads": {"air": AIR | {"stiffness": "1 N/m"}}})


@pytest.mark.slow
def test_a_new_chart(extended, tmp_path):
    before = optlink.analyze("six-bar").plots
    extended("chart")
    result = optlink.analyze("six-bar")
    assert result.plots[: len(before) + 1] == (*before[: len(before) - 1], "power", before[-1])  # drawings are last
    (line,) = [line for line in result.plot("power").axes[0].lines if len(line.get_xdata()) > 2]
    assert line.get_ydata() == pytest.approx(result["input.torque_Nm"] * result.speed)
    assert {path.name for path in result.write(tmp_path)} >= {"power.png"}
    assert ">Power of the drive<" in page(tmp_path, "six-bar")
    assert ">Power of the drive<" in page(tmp_path, str(tmp_path))
    calm = optlink.analyze("crank-rocker")
    assert "power" not in calm.plots
    with pytest.raises(InputError, match="no picture power"):
        calm.plot("power")
    register(ResultChart("ends", "simulation", lambda run: ChartSpec("", "Ends", [], crank_angle(), page=False)))
    assert "ends" in optlink.simulate(optlink.load("six-bar", {"drive.torque": "1 N*m"}), duration=0.05).plots


def test_the_schema_of_problem_files_has_what_is_registered(extended):
    for name in ("constraint", "objective", "kind"):
        extended(name)
    schema = json.loads(run("show", "--schema", "problem"))
    assert schema["$defs"]["Limits"]["properties"]["coupler_ratio"]["description"] == "Coupler over crank; of a four-bar."
    assert "turning" in schema["$defs"]["quantity-of-the-cycle"]["enum"]
    assert schema["$defs"]["Clearing"]["required"] == ["point", "least"]
    own = {"mechanism": optlink.load("crank-rocker").raw["mechanism"], "clearing": {"point": "C", "least": "300 mm"}}
    validator = jsonschema.Draft202012Validator(schema)
    assert validator.is_valid(own)
    assert not validator.is_valid(own | {"clearing": {"point": "C", "last": "300 mm"}})


def test_a_name_is_registered_once(extended):
    extended("constraint")
    with pytest.raises(InputError, match=r'^LimitTerm = "coupler_ratio": this name is already registered\. Choose another name$'):
        importlib.reload(sys.modules["tests.extending.constraint"])


COURSE = {"signal": lambda moving, reactions, term: (0.0,), "history": lambda record, term: np.zeros(3)}
FAULTY = {
    'QuantityType = "torque": this name is already registered': QuantityType("torque", "torque", ("peak",), **COURSE),
    'QuantityType = "field": the physical kind "charge" is unknown. Known: ': QuantityType(
        "field", "charge", ("peak",), **COURSE
    ),
    'QuantityType = "x": the measure "peek" is unknown. Did you mean "peak"': QuantityType("x", "force", ("peek",), **COURSE),
    'QuantityType = "half": only one of signal and history': QuantityType("half", "force", ("peak",), signal=COURSE["signal"]),
    'LimitTerm = "crank": limits.crank is a key of problem files': LimitTerm("crank", None, None, None),
    'LoadKind = "wind": its form has no key wind': LoadKind("wind", LOADS["force"].form),
    'LoadKind = "at": the key force of its form marks another kind of load': LoadKind("at", LOADS["force"].form),
    'Solver = "both": it stands for two back ends': Solver("both", lambda: None),
    'DyadType = "slot": a dyad is named by its three joints': DyadType("slot", None),
    'ProblemKind = "own": the section "mechanism" belongs to another kind': ProblemKind("own", None, "mechanism", object),
    'ProblemKind = "own": the section "mine" has no model': ProblemKind("own", None, "mine"),
    'register = "dict": not an entry': {"name": "torque"},
}


@pytest.mark.parametrize("message", FAULTY)
def test_a_faulty_entry_is_refused_by_name(message):
    before = [dict(registry) for registry in REGISTRIES]
    with pytest.raises(InputError) as caught:
        register(FAULTY[message])
    assert str(caught.value).startswith(message)
    assert [dict(registry) for registry in REGISTRIES] == before


def test_the_reference_has_every_kind_of_entry():
    assert {one.entry for one in ADDITIONS} == set(Entry.__subclasses__())
    assert {one.example for one in ADDITIONS} == {path.stem for path in FOLDER.glob("[a-z]*.py")}
    assert set(chain.from_iterable(one.oracles for one in ADDITIONS)) == {
        name for name in optlink.testing.__all__ if name.startswith("check_")
    }


def clearing():
    stated = {key: value for key, value in optlink.load("six-bar").raw.items() if key != "expected"}
    return optlink.solve(optlink.read({**stated, "clearing": {"point": "C", "least": "10 mm"}}))


def without_loads(name):
    return optlink.read({key: value for key, value in optlink.load(name).raw.items() if key not in ("expected", "loads")})


SUBJECTS = {
    "constraint": lambda: optlink.load("crank-rocker", {"limits.coupler_ratio": [0.1, 2.5]}),
    "objective": lambda: optlink.read(SLOW_ROCKER),
    "load": lambda: optlink.read(WINDY),
    "back_end": lambda: "crank-rocker",
    "dyad": lambda: without_loads("scotch-yoke"),
    "kind": clearing,
    "view": clearing,
    "chart": lambda: optlink.analyze("six-bar"),
}
"""What the oracles of an example take: a problem that uses it, or a result."""


@pytest.mark.parametrize(("one", "oracle"), [(one.example, oracle) for one in ADDITIONS for oracle in one.oracles])
def test_the_oracles_check_each_example(extended, one, oracle):
    if one == "dyad":
        DyadType.registry.pop("RPP")
    for name in ("kind", "view") if one in ("kind", "view") else (one,):
        extended(name)
    options = ("trust-constr",) if one == "back_end" else ()
    error = getattr(optlink.testing, oracle)(SUBJECTS[one](), *options)
    assert error is None or error < 1e-3


@pytest.mark.parametrize("module", ["tests.extending.back_end", "tests.extending.missing"])
def test_an_installed_package_extends_the_command_line(tmp_path, module):
    package = tmp_path / "example-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: example\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text(f"[optlink.extensions]\nexample = {module}\n")
    root = Path(__file__).parents[1]
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{root}", "COLUMNS": "100"}
    done = subprocess.run(
        [sys.executable, "-m", "optlink", "solve", "--help"], capture_output=True, text=True, env=environment, check=True
    )
    assert ("trust-constr" in done.stdout) == (module == "tests.extending.back_end")
    assert ("Warning: the extension example" in done.stderr) == (module == "tests.extending.missing")
