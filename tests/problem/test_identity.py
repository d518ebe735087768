"""A stored verdict is never shown for another problem: every key that can read a file, through every command that stores one."""

from __future__ import annotations

import ast
import copy
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pydantic
import pytest
import tomli_w
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.errors import InputError
from optlink.problem.base_model import InFolder, Section
from optlink.problem.design import DesignProblem
from optlink.problem.enclosed import identity
from optlink.problem.file import WORDS, read
from optlink.problem.machine.model import Problem
from optlink.studies import pareto, sweep, tolerance
from optlink.tasks.clearance import simulate_clearance
from optlink.tasks.results.certificate import certificate_document

PACKAGE = Path(optlink.__file__).parent
OTHER = "another problem|another study|another command|problem_hash"
"""How a command refuses what was stored for another problem."""


def rows(*columns: str, **values: Any) -> str:
    """A CSV file of columns."""
    lines = zip(*values.values(), strict=True)
    return "\n".join([",".join(columns or values), *(",".join(f"{cell:.12g}" for cell in line) for line in lines)]) + "\n"


def scaled(text: str, by: float) -> str:
    """A CSV file with its last column scaled."""
    title, *lines = text.splitlines()
    parts = [line.rpartition(",") for line in lines]
    return "\n".join([title, *(f"{head}{comma}{float(last) * by:.9g}" for head, comma, last in parts)]) + "\n"


PHI = np.radians(np.linspace(0.0, 90.0, 11))
LAW = rows(phi_deg=np.degrees(PHI), psi_deg=np.degrees(0.2 * PHI**2))
SLIDE = rows(phi_deg=np.degrees(PHI), s_mm=-25.0 * PHI)
TURN = np.linspace(0.0, 360.0, 9)
FORCE = rows(phi_deg=TURN, force_N=100.0 + 20.0 * np.cos(np.radians(TURN)))
PUSH = rows(s_mm=np.linspace(-500.0, 500.0, 5), force_N=np.linspace(80.0, 120.0, 5))
PRESSURE = rows(phi_deg=TURN, pressure_bar=3.0 + np.cos(np.radians(TURN)))
TORQUE = rows(phi_deg=TURN, torque_Nm=3.0 + np.cos(np.radians(TURN)))
MOTION = rows(time_s=np.linspace(0.0, 1.0, 13), angle_deg=60.0 - 30.0 * np.cos(np.linspace(0.0, 2.0 * np.pi, 13)))
MEASURED = rows(angle_deg=TURN[:-1], displacement_mm=120.0 + 50.0 * np.cos(np.radians(TURN[:-1])))
PARTS = rows("coupler_mm", coupler_mm=[-0.05, 0.0, 0.02, 0.06])

FREE = {
    name: {"start": f"{start} mm", "bounds": [f"{start - 60} mm", f"{start + 60} mm"]}
    for name, start in (("coupler", 400), ("rocker", 260))
}
FOUR_BAR = {"crank": "100 mm", "frame": "500 mm", **FREE}
FIXED = {"crank": "40 mm", "frame": "160 mm", "coupler": "150 mm", "rocker": "100 mm"}
TRACER = {
    **FIXED,
    "coupler": FREE["coupler"] | {"start": "150 mm", "bounds": ["130 mm", "170 mm"]},
    "points": {"P": ["75 mm", "40 mm"]},
}
LIMITS = {"crank": "full rotation", "transmission_angle": ["30 deg", "150 deg"]}
SLIDER_CRANK = {
    "ground": {"A": ["0 mm", "0 mm"]},
    "links": {
        "crank": {"joints": ["A", "B"], "length": {"bounds": ["20 mm", "60 mm"]}},
        "rod": {"joints": ["B", "C"], "length": "120 mm"},
        "slider": {"joints": ["C"]},
    },
    "guides": {"G": {"slider": "slider", "through": "A", "direction": "0 deg"}},
    "assembly": {"C": "forward"},
}

CARRIAGE = {
    "mechanism": {
        "ground": {"A": ["0 mm", "0 mm"]},
        "links": {"carriage": {"joints": ["T"]}},
        "guides": {"rail": {"slider": "carriage", "through": "A"}},
    },
    "bodies": {"carriage": {"mass": "2 kg"}},
}


PENDULUM = {
    "mechanism": {"ground": {"A": ["0 mm", "0 mm"]}, "links": {"arm": {"joints": ["A", "B"], "length": "80 mm"}}},
    "bodies": {"arm": {"mass": "2 kg", "centroid": ["40 mm", "0 mm"], "inertia": "0.01 kg*m^2"}},
}


def beside(loose: Mapping[str, Any], **drive: Any) -> dict[str, Any]:
    """A mechanism that a free drive moves beside a wheel."""
    ground, links = {"W": ["0 mm", "300 mm"]}, {"wheel": {"joints": ["W", "R"], "length": "50 mm"}}
    mechanism, law = loose["mechanism"], [{"time": "0.5 s", "to": "60 deg", "law": "cycloidal"}]
    whole = mechanism | {"ground": mechanism["ground"] | ground, "links": mechanism["links"] | links}
    return {
        **loose,
        "mechanism": whole,
        "drives": {"motor": {"body": "wheel", "start": "0 deg", "law": law}, "other": drive},
    }


def curve(size: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Points [mm] of the coupler of a four-bar, scaled about their centre, with the crank angles [deg]."""
    file = read({"mechanism": {**TRACER, "coupler": "150 mm"}})
    machine, angles = file.model.machine(), np.linspace(0.0, 300.0, 6)
    points = np.array([machine.mechanism.at(machine.sizes, math.radians(angle)).point("P") for angle in angles])
    return angles, 1e3 * (points.mean(axis=0) + size * (points - points.mean(axis=0)))


def timed(size: float) -> str:
    angles, points = curve(size)
    return rows(crank_deg=angles, x_mm=points[:, 0], y_mm=points[:, 1])


def poses(size: float) -> str:
    angles, points = curve(size)
    return rows(crank_deg=angles, angle_deg=20.0 * np.cos(np.radians(angles)), x_mm=points[:, 0], y_mm=points[:, 1])


def drawing(size: float) -> str:
    text = " ".join(f"{'L' if k else 'M'} {x:.6f} {-y:.6f}" for k, (x, y) in enumerate(curve(size)[1]))
    return f'<svg xmlns="http://www.w3.org/2000/svg" width="500mm" height="500mm" viewBox="0 0 500 500"><path d="{text}"/></svg>'


# --- commands: each stores something for a problem, and returns what must be refused or computed again ------------------------


Again = Callable[[optlink.ProblemFile], object]


def stored(result: Any, folder: Path) -> Again:
    """The result as the file that `--out` writes, for `optlink report`."""
    path = folder / "result.json"
    path.write_text(json.dumps(result.to_dict()))

    def again(file: optlink.ProblemFile) -> None:
        """The result stays that of the problem that it contains."""
        own = optlink.read_result(path)
        assert own.to_dict() == result.to_dict()
        if own.problem.hash != file.hash:
            raise InputError("another problem", "Solve it again")

    again(result.problem)
    return again


def report(file: optlink.ProblemFile, folder: Path) -> Again:
    if file.task == "balance":
        return stored(optlink.balance(file), folder)
    return stored(optlink.solve(file, starts=2) if file.model.free else optlink.analyze(file, points=12), folder)


def validation(file: optlink.ProblemFile, folder: Path) -> Again:
    """`validate --design result.json` measures the old design against the new problem, and says so."""
    report(file, folder)
    words = ["validate", str(folder / "mine.toml"), "--design", str(folder / "result.json"), "--json"]
    before = CliRunner().invoke(app, words)
    assert "Warning" not in before.stderr, before.stderr

    def again(_: optlink.ProblemFile) -> None:
        after = CliRunner().invoke(app, words)
        assert figures(after.stdout) != figures(before.stdout)
        raise InputError(after.stderr, "")

    return again


def figures(text: str) -> dict[str, Any]:
    """What a result says of its designs."""
    document = json.loads(text)
    return {name: document.get(name) for name in ("objective", "designs", "fit")}


def simulation(file: optlink.ProblemFile, folder: Path) -> Again:
    return stored(optlink.simulate(file, 0.02), folder)


def table(file: optlink.ProblemFile, folder: Path, **mode: Any) -> Again:
    length = "crank.length" if "links" in file.raw["mechanism"] else "frame"
    key = "mechanism.frame" if length == "frame" else "mechanism.links.rod.length"
    size = 1e3 * file.model.quantities["frame" if length == "frame" else "rod.length"].value
    options = {"vary": [f"{key}={size} mm, {size * 1.01} mm"], "out": folder / "sweep", "workers": 1, **mode}
    sweep(file, **options)
    return lambda changed: sweep(changed, resume=True, **options)


def analyses(file: optlink.ProblemFile, folder: Path) -> Again:
    return table(file, folder, analyze=True, points=12)


def front(file: optlink.ProblemFile, folder: Path) -> Again:
    options: dict[str, Any] = {"out": folder / "front", "points": 2, "workers": 1}
    objectives = "error, limits.transmission_angle.max"
    pareto(file, objectives, **options)
    return lambda changed: pareto(changed, objectives, resume=True, **options)


def scatter(file: optlink.ProblemFile, folder: Path) -> Again:
    design = {name: file.model.quantities[name].value for name in file.model.free}
    texts = [] if file.model.tolerances else ["coupler=0.1 mm"]
    output = None if file.task == "function" else "P.x"
    return stored(tolerance(file, texts, output, samples=0, design=design), folder)


def certificate(file: optlink.ProblemFile, folder: Path) -> Again:
    result = optlink.solve(file, starts=2, certify=True, gap=0.9)
    document = certificate_document(result.certificate, result)
    assert document["problem_hash"] == file.hash

    def again(changed: optlink.ProblemFile) -> None:
        if document["problem_hash"] != changed.hash:
            raise InputError("the certificate of another problem", "Make it again")

    return again


def clearance(file: optlink.ProblemFile, folder: Path) -> Again:
    kept: list[dict[str, Any]] = []
    options: dict[str, Any] = {"points": 36, "check_predictability": False}
    simulate_clearance(file, 1, checkpoint=kept.append, **options)
    simulate_clearance(file, 2, resume=kept[-1], **options)
    return lambda changed: simulate_clearance(changed, 2, resume=kept[-1], **options)


# --- the keys -----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A key that can read a file: its field in the models, the problem, the file as it was and as it is, the commands."""

    field: str
    problem: Mapping[str, Any]
    file: str
    before: str
    after: str
    commands: tuple[Callable[[optlink.ProblemFile, Path], Again], ...]


def path(mechanism: Mapping[str, Any], **requirement: Any) -> dict[str, Any]:
    return {"mechanism": mechanism, "requirement": {"point": "P", **requirement}, "limits": LIMITS}


def machine(name: str, **sections: Any) -> dict[str, Any]:
    """A shipped problem without controller, with other sections."""
    raw = copy.deepcopy(dict(optlink.load(name).raw))
    return {key: value for key, value in raw.items() if key not in ("control", "expected")} | sections


DESIGN = (report, validation, table)
PROVEN = (*DESIGN, certificate)
OPTIMA = (*PROVEN, front)
LAW_PROBLEM = {"mechanism": FOUR_BAR, "requirement": {"law": {"csv": "data.csv"}}, "limits": LIMITS}
ROBUST = {"law": "psi0 + 0.2*(phi - phi0)^2", "span": "90 deg", "points": 10, "measure": "max", "robust": "3 sigma"}
IDEAL = {"drive": {"body": "crank", "speed": "60 rpm"}}
GAP = {"clearance": "0.5 mm", "bearing_radius": "10 mm", "journal": "rod", "modulus": "207 GPa", "restitution": 0.9}
TABLE = {"over": "phi", "csv": "data.csv"}


def listed(mechanism: Mapping[str, Any], **requirement: Any) -> dict[str, Any]:
    """A problem whose requirement is a limit in a list, beside the best transmission."""
    return {"mechanism": mechanism, "requirements": [requirement, {"kind": "transmission"}], "limits": LIMITS}


CASES = {
    "law in a list": Case(
        "requirements.*.law",
        listed(FOUR_BAR, law={"csv": "data.csv"}, measure="max", tolerance="40 deg"),
        "data.csv",
        LAW,
        scaled(LAW, 1.3),
        (validation,),
    ),
    "points in a list": Case(
        "requirements.*.points",
        listed(TRACER, kind="path", point="P", points={"csv": "data.csv"}, measure="max", tolerance="20 mm"),
        "data.csv",
        timed(1.02),
        timed(1.1),
        (validation,),
    ),
    "law": Case("requirement.law", LAW_PROBLEM, "data.csv", LAW, scaled(LAW, 1.3), (*OPTIMA, scatter)),
    "law of a slide": Case(
        "requirement.law",
        {
            "mechanism": SLIDER_CRANK,
            "requirement": {"kind": "function", "law": {"csv": "data.csv"}, "output": "G"},
            "limits": {"alignment": "20 deg"},
        },
        "data.csv",
        SLIDE,
        scaled(SLIDE, 1.2),
        DESIGN,
    ),
    "points": Case(
        "requirement.points",
        path(TRACER, kind="path", points={"csv": "data.csv"}),
        "data.csv",
        timed(1.02),
        timed(1.1),
        (*PROVEN, scatter),
    ),
    "poses": Case(
        "requirement.points", path(TRACER, kind="motion", points={"csv": "data.csv"}), "data.csv", poses(1.02), poses(1.1), DESIGN
    ),
    "drawing": Case(
        "requirement.points",
        path(TRACER, kind="path", points={"svg": "data.svg", "points": 8}),
        "data.svg",
        drawing(1.02),
        drawing(1.1),
        DESIGN,
    ),
    "force": Case(
        "loads.*.force",
        machine("slider-crank", loads={"process": {"on": "slider", "force": TABLE}}, **IDEAL),
        "data.csv",
        FORCE,
        scaled(FORCE, 1.5),
        (report, analyses),
    ),
    "torque": Case(
        "loads.*.torque",
        machine("slider-crank-clearance", loads={"process": {"on": "rod", "torque": TABLE}}),
        "data.csv",
        TORQUE,
        scaled(TORQUE, 1.5),
        (report, analyses, clearance),
    ),
    "measured": Case(
        "measured",
        machine("slider-crank-clearance", measured={"csv": "data.csv"}),
        "data.csv",
        MEASURED,
        scaled(MEASURED, 1.01),
        (report, clearance),
    ),
    "drive": Case(
        "drive.torque",
        machine("slider-crank", drive={"body": "crank", "speed": "60 rpm", "torque": TABLE, "duration": "1 s"}),
        "data.csv",
        TORQUE,
        scaled(TORQUE, 1.5),
        (simulation,),
    ),
    "push": Case(
        "drive.force",
        CARRIAGE | {"drive": {"slide": "rail", "speed": "0.1 m/s", "force": {"over": "s", "csv": "data.csv"}, "duration": "1 s"}},
        "data.csv",
        PUSH,
        scaled(PUSH, 1.5),
        (simulation,),
    ),
    "turned beside another": Case(
        "drives.*.torque",
        beside(PENDULUM, body="arm", torque=TABLE),
        "data.csv",
        TORQUE,
        scaled(TORQUE, 1.5),
        (simulation,),
    ),
    "pushed beside another": Case(
        "drives.*.force",
        beside(CARRIAGE, slide="rail", force={"over": "s", "csv": "data.csv"}),
        "data.csv",
        PUSH,
        scaled(PUSH, 1.5),
        (simulation,),
    ),
    "gas": Case(
        "loads.*.gas.pressure",
        machine("slider-crank", loads={"gas": {"on": "slider", "gas": {"pressure": TABLE, "bore": "40 mm"}}}),
        "data.csv",
        PRESSURE,
        scaled(PRESSURE, 1.5),
        (report, analyses),
    ),
    "motion": Case(
        "drive.law",
        machine("slider-crank", drive={"body": "crank", "law": {"csv": "data.csv"}}),
        "data.csv",
        MOTION,
        scaled(MOTION, 1.5),
        (report, analyses),
    ),
    "motions": Case(
        "drives.*.law",
        machine("slider-crank", drive={}, drives={"motor": {"body": "crank", "law": {"csv": "data.csv"}}}),
        "data.csv",
        MOTION,
        scaled(MOTION, 1.5),
        (report, analyses),
    ),
    "balancing": Case(
        "loads.*.torque",
        machine("balance-four-bar", loads={"process": {"on": "rocker", "torque": TABLE}}),
        "data.csv",
        TORQUE,
        scaled(TORQUE, 1.5),
        (report,),
    ),
    "deviations": Case(
        "tolerances",
        {**LAW_PROBLEM, "requirement": ROBUST, "tolerances": {"coupler": "data.csv"}},
        "data.csv",
        PARTS,
        scaled(PARTS, 3.0),
        (*DESIGN, front, scatter),
    ),
}


def fields(model: type[pydantic.BaseModel], above: str = "") -> Iterator[str]:
    """The keys of a model whose values can be in another file; * stands for any name."""
    for name, field in model.model_fields.items():
        key = f"{above}{name}"
        if any(isinstance(mark, InFolder) for mark in (*field.metadata, *marks(field.annotation))):
            yield key
        for part, named in sections(field.annotation):
            yield from fields(part, f"{key}.*." if named else f"{key}.")


def marks(annotation: Any) -> Iterator[Any]:
    yield from getattr(annotation, "__metadata__", ())
    for part in get_args(annotation):
        yield from marks(part)


def sections(annotation: Any, named: bool = False) -> Iterator[tuple[type[pydantic.BaseModel], bool]]:
    if isinstance(annotation, type) and issubclass(annotation, Section):
        yield from ((model, named) for model in annotation.models().values())
    for part in get_args(annotation):
        yield from sections(part, named or getattr(annotation, "__origin__", None) in (dict, list, tuple))


def test_every_key_that_can_read_a_file_is_among_the_cases():
    models = (Problem, DesignProblem)
    keys = {key for model in models for key in fields(model)}
    assert keys == {case.field for case in CASES.values()}


def test_no_other_function_of_problems_reads_a_file():
    """What a field reads, it reads by `read_file`, in the folder that only `in_folder` gives it."""
    openers = {"open", "read_text", "read_bytes", "loadtxt", "genfromtxt", "fromfile"}
    readers = set()
    for module in sorted((PACKAGE / "problem").rglob("*.py")):
        for function in [node for node in ast.walk(ast.parse(module.read_text())) if isinstance(node, ast.FunctionDef)]:
            for call in [node for node in ast.walk(function) if isinstance(node, ast.Call)]:
                name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
                if name in openers:
                    readers.add(f"{module.stem}.{function.name}")
    assert readers == {
        "target_points.read_file",
        "file._read_toml",
        "document.read_document",
        "templates.template",
        "foreign._content",
        "overview.overview",
    }


# --- the walk -----------------------------------------------------------------------------------------------------------------


def written(case: Case, folder: Path) -> optlink.ProblemFile:
    """The problem of a case, read from files in a folder."""
    (folder / case.file).write_text(case.before)
    (folder / "mine.toml").write_text(tomli_w.dumps(case.problem))
    return optlink.load(folder / "mine.toml")


@pytest.mark.parametrize("name", CASES)
def test_the_identity_is_that_of_the_numbers_in_the_file(name, tmp_path):
    case = CASES[name]
    first = written(case, tmp_path)
    assert optlink.load(tmp_path / "mine.toml").hash == first.hash == first.override({"title": "Another"}).hash
    if case.file.endswith(".csv"):  # the same numbers, in other words
        titles, *lines = case.before.splitlines()
        (tmp_path / case.file).write_text(
            "\r\n".join([f"# measured\n{titles.replace(',', ';')}", *(t.replace(",", " ; ") for t in lines)])
        )
        assert optlink.load(tmp_path / "mine.toml").hash == first.hash
    (tmp_path / case.file).write_text(case.after)
    assert optlink.load(tmp_path / "mine.toml").hash != first.hash == first.override({}).hash  # a problem keeps what was read


WALK = [(name, command) for name, case in CASES.items() for command in case.commands]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "command"), WALK, ids=[f"{name}-{command.__name__}" for name, command in WALK])
def test_what_was_stored_is_refused_once_the_file_has_changed(name, command, tmp_path):
    case = CASES[name]
    again = command(written(case, tmp_path), tmp_path)
    (tmp_path / case.file).write_text(case.after)
    with pytest.raises(InputError, match=OTHER):
        again(optlink.load(tmp_path / "mine.toml"))


def test_the_identity_does_not_depend_on_what_was_computed_before():
    for name in ("crank-rocker-robust", "shaper", "path-bean"):
        used = optlink.load(name)
        _ = used.model.linkage, used.model.deviations, used.model.longest
        assert identity(used.model, WORDS) == optlink.load(name).hash == read(dict(reversed(used.raw.items()))).hash


def test_an_object_without_fields_has_no_identity():
    class Opaque:
        pass

    model = optlink.load("crank-rocker").model
    with pytest.raises(TypeError, match="Opaque is not part of the identity"):
        identity(model.model_copy(update={"requirement": Opaque()}))


def test_long_tables_count_in_full(tmp_path):
    """numpy writes arrays of more than 1,000 numbers with dots in the middle."""
    phi = np.linspace(0.0, 90.0, 2001)
    hashes = set()
    for change in (0.0, 1e-9):
        psi = 0.2 * phi
        psi[1000] += change
        (tmp_path / "data.csv").write_text(rows(phi_deg=phi, psi_deg=psi))
        hashes.add(read(LAW_PROBLEM, folder=tmp_path).hash)
    assert len(hashes) == 2


def test_measured_deviations_of_the_command_line_belong_to_a_study(tmp_path, monkeypatch):
    """The file is read from the working folder, the study is shown from anywhere, but only with the same numbers."""
    study, elsewhere = tmp_path / "study", tmp_path / "elsewhere"
    study.mkdir(), elsewhere.mkdir()
    monkeypatch.chdir(study)
    parts = Path("parts.csv")
    parts.write_text("rocker_mm\n0.11\n-0.07\n0.02\n0.05\n", encoding="utf-8")
    texts = ["rocker=parts.csv", "crank=0.04 mm uniform"]
    shared = {"samples": 0, "design": {"coupler": 0.41, "rocker": 0.23}}
    problem = optlink.load("crank-rocker")
    plain = tolerance(problem, ["crank=0.04 mm"], **shared)
    assert plain.problem.hash == problem.hash
    result = tolerance(problem, texts, **shared)
    again = tolerance(problem, texts, **shared)
    assert again.problem.hash == result.problem.hash != problem.hash
    (elsewhere / "result.json").write_text(json.dumps(result.to_dict()))
    monkeypatch.chdir(elsewhere)
    for _ in range(2):
        assert optlink.read_result("result.json").to_dict() == result.to_dict()
        (study / parts).write_text("rocker_mm\n0.11\n-0.07\n0.02\n0.06\n", encoding="utf-8")  # of another study now
