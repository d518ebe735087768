"""The names that a program may rely on: one is added in one line, and none disappears without a deprecation."""

import ast
import importlib
import inspect
import json
import os
import re
import subprocess
import sys
import types
import warnings
import zipfile
from pathlib import Path

import pytest

import optlink
from optlink.namespace import by_name

PUBLIC = {
    "optlink": """
        Analysis AnyProblem Balance BatchAnalysis DesignResult Document Execution InputError LinkageDesign OptlinkError
        ProblemFile Programme Result Simulation SolverError Status SynthesisResult UnknownName
        analyze analyze_batch balance build explore export gradient hessian load motion new read read_design read_result rename
        report shipped simulate
        limit objective solve sweep validate
        control extending linkage studies style synthesis testing
    """,
    "optlink.control": """
        Checkpoints ClearanceSimulation Comparison InverseMotion ResumableExecution Tuning
        compare inverse_model simulate_clearance tune
    """,
    "optlink.extending": """
        Acting AngleInterval Array Assembly Attempt Axis Backend Bars ChartSpec Check Course Curve DesignProblem
        DesignTask Dyad DyadType Element ElementTerm FixedLength ForceBalance Former GroupForces Guide Interval
        InvalidValue Joint LengthInterval LimitTerm Link Load LoadKind LoadSection MotionColumns Moved Moving NLP Number
        NumberInterval OnBody Panel Problem ProblemKind QuantityType Reach Reactions ResultChart ResultKind
        RevolutionSamples Search Section Signal SingleResult Solver Summary Validation Value Vector View
        checks crank_angle cross dot extremes minus plus register solve_two_by_two summary turn turn_back
    """,
    "optlink.linkage": """
        Cognate CouplerLinkage GrashofClass Jet Mechanism Motion Pose Travel cognates four_bar grashof reachable sweep travels
        dyads fourbar
    """,
    "optlink.linkage.dyads": "prp rpp rpr rrp rrr",
    "optlink.linkage.fourbar": """
        DeadCentre GrashofClass Inversion classify crank_rocker_conditions dead_centre diagonal_squared double_crank_conditions
        four_bar grashof reachable swing time_ratio transmission_cosine turning_points
    """,
    "optlink.studies": """
        Allocation Derivatives MonteCarlo OutputSensitivity Pareto RobustDesign Sensitivities Sensitivity Sweep Tolerance
        output_sensitivity pareto sensitivities sweep tolerance
    """,
    "optlink.style": "BODIES COUPLER CRANK GROUND LIMIT MUTED RESULT ROCKER SHADE STYLE TARGET",
    "optlink.synthesis": "DyadCurves FirstDesign Pairs dyad_curves exact four_bar_of_dyads starts",
    "optlink.testing": """
        Disagreement check_derivatives check_forces check_motion check_optimum check_prices check_stored
    """,
}
"""Public names by namespace. One that goes stays, deprecated, for as long as docs/stability.md states."""
TYPES = ("AnyProblem", "Course", "Former", "Joint", "Number", "Signal", "Value", "Vector")
"""Names for types, which have no docstring of their own."""
DEPRECATED = {
    **{name: f"optlink.linkage.{name}" for name in ("four_bar", "grashof")},
    **{name: f"optlink.control.{name}" for name in ("ClearanceSimulation", "Comparison", "InverseMotion", "Tuning")},
    **{name: f"optlink.control.{name}" for name in ("compare", "inverse_model", "simulate_clearance", "tune")},
    **dict.fromkeys(("CycleResult", "FunctionResult", "PathResult"), "optlink.SynthesisResult"),
    "PathDesign": "optlink.LinkageDesign",
}
"""Former names by those that took their place."""
PACKAGES = [importlib.import_module(name) for name in PUBLIC]


ROOT = Path(__file__).resolve().parents[1]
WRITTEN = [ROOT / "README.md", ROOT / "README.zh.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").glob("*.py")]
IMPORTED = re.compile(r"^[ >]*(?:from (optlink[\w.]*) import (\([^)]*\)|[^#\n]*)|import (optlink[\w.]*))", re.MULTILINE)


def internal(code: str) -> list[str]:
    """Names that code imports from optlink although they are not public."""
    found = []
    for module, listed, whole in IMPORTED.findall(code):
        own = re.findall(r"(\w+)(?: as \w+)?", listed)
        found += [name for name in own if name not in PUBLIC.get(module, "").split()]
        found += [whole] if whole and whole not in PUBLIC else []
    return sorted(set(found))


def names(package: types.ModuleType) -> list[str]:
    return PUBLIC[package.__name__].split()


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)
def test_the_public_names_are_those_of_the_table(package: types.ModuleType) -> None:
    """A new name is one word above; a name that goes is first deprecated."""
    assert sorted(package.__all__) == sorted(names(package))
    assert [name for name in dir(package) if not name.startswith("__")] == sorted(package.__all__)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        for name in package.__all__:
            assert inspect.getdoc(getattr(package, name)) or name in TYPES
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = package.nonsense


@pytest.mark.parametrize("path", WRITTEN, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_pages_and_examples_import_public_names(path: Path) -> None:
    assert internal(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("path", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_import_public_names(path: Path) -> None:
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    assert internal(code) == []


def test_an_import_from_inside_is_found() -> None:
    code = ">>> from optlink.tasks.run import solve\nfrom optlink.linkage import (\n    Jet,\n    jet as one,\n)\n"
    code += "import optlink.io\nfrom optlink import load, studies\nimport optlink\n"
    assert internal(code) == ["jet", "optlink.io", "solve"]


def test_a_name_of_an_inner_namespace_is_found_there() -> None:
    with pytest.raises(AttributeError, match=r"no attribute 'pareto'\. It is optlink\.studies\.pareto"):
        _ = optlink.pareto  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match=r"no attribute 'paretto'$"):
        _ = optlink.paretto  # type: ignore[attr-defined]


def test_no_module_hides_a_function_of_its_name() -> None:
    """Importing `package.name` sets that attribute, so that a public function must not have the name of a module beside it."""
    for package in PACKAGES:
        place = Path(str(package.__file__))
        if place.name == "__init__.py":
            modules = {path.stem for path in place.parent.iterdir() if path.suffix == ".py" or path.is_dir()}
            functions = {name for name in names(package) if not inspect.ismodule(getattr(package, name))}
            assert functions & modules == set()


@pytest.mark.parametrize("name", DEPRECATED)
def test_a_deprecated_name_works_and_names_its_successor(name: str) -> None:
    home, _, own = DEPRECATED[name].rpartition(".")
    with pytest.warns(DeprecationWarning, match=rf"optlink\.{name} is now {DEPRECATED[name]}$") as caught:
        found = getattr(optlink, name)
    assert found is getattr(importlib.import_module(home), own)
    assert caught[0].filename == __file__  # the line of the user
    assert name not in dir(optlink)


@pytest.mark.parametrize("package", [one for one in PACKAGES if Path(str(one.__file__)).with_suffix(".pyi").exists()], ids=str)
def test_the_stub_declares_the_same_names(package: types.ModuleType) -> None:
    """Type checkers read the stub: the names, their modules and the deprecated names are those of the package."""
    stub = ast.parse(Path(str(package.__file__)).with_suffix(".pyi").read_text(encoding="utf-8"))
    shown = {
        own.asname: node.module for node in stub.body if isinstance(node, ast.ImportFrom) for own in node.names if own.asname
    }
    assert shown == declared(package)
    former = [ast.unparse(node.decorator_list[0]) for node in stub.body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
    deprecated = DEPRECATED if package is optlink else {}
    assert sorted(former) == sorted(f"deprecated('optlink.{name} is now {place}')" for name, place in deprecated.items())
    assert {node.name for node in stub.body if isinstance(node, ast.FunctionDef | ast.ClassDef)} == deprecated.keys()


def declared(package: types.ModuleType) -> dict[str, str]:
    """Modules by public name, from the table that the package gives to `namespace`."""
    module = ast.parse(Path(str(package.__file__)).read_text(encoding="utf-8"))
    (call,) = (node for node in ast.walk(module) if isinstance(node, ast.Call))
    found: dict[str, str] = by_name(ast.literal_eval(call.args[1]))
    return found


def test_a_package_in_an_archive_has_its_names(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "optlink.zip", "w") as archive:
        for name in ("__init__", "namespace", "version", "errors"):
            archive.write(ROOT / "optlink" / f"{name}.py", f"optlink/{name}.py")
    code = "import optlink; print(optlink.__file__, optlink.InputError.__name__)"
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "optlink.zip")}
    done = subprocess.run([sys.executable, "-c", code], env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(tmp_path / "optlink.zip" / "optlink" / "__init__.py"), "InputError"]
