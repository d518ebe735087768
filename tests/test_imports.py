"""Heavy libraries stay in their room, and the package is what it says."""

from __future__ import annotations

import graphlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import grimp
import pytest

import optlink
from optlink.io import write_json

ROOT = Path(__file__).parent.parent
NOT_FOR_A_LAW = {
    "multiprocessing",
    "numpy.random",
    "optlink.clearance.equations",
    "optlink.dynamics.columns",
    "optlink.dynamics.counterweights",
    "optlink.dynamics.work",
    "optlink.tasks.analyze",
}
HEAVY = {"casadi", "matplotlib", "cvxpy", "scipy.optimize", "scipy.stats", "pint"}
LIBRARIES = {"casadi", "cvxpy", "matplotlib", "PIL", "scipy", "jinja2", "ezdxf"}


def loaded_after(code: str) -> set[str]:
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys; print('\\n'.join(sys.modules))"], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def test_help_loads_no_heavy_library():
    code = "import sys; sys.argv = ['optlink', '--help']\nfrom optlink.cli.app import main\ntry: main()\nexcept SystemExit: pass"
    assert loaded_after(code) & HEAVY == set()


def test_no_module_imports_itself_through_others():
    """Not even by deferred imports or for annotations."""
    graph = grimp.build_graph("optlink", cache_dir=None)
    imports = {one: set(graph.find_modules_directly_imported_by(one)) for one in graph.modules}
    assert "optlink.tasks.design" in imports["optlink.tasks.run"]  # deferred imports are seen
    graphlib.TopologicalSorter(imports).prepare()  # CycleError names the cycle
    imports["optlink.units"].add("optlink.problem.file")
    with pytest.raises(graphlib.CycleError, match=r"optlink\.units"):
        graphlib.TopologicalSorter(imports).prepare()


def command(*words: str) -> str:
    run = "from optlink.__main__ import main\ntry: main()\nexcept SystemExit as end: assert not end.code"
    return f"import sys; sys.argv[1:] = {list(words)}\n{run}"


@pytest.mark.parametrize(
    ("words", "unwanted"),
    [
        (("--help",), {"numpy", "pydantic", "markdown_it", "optlink.units", "pygments", "importlib.metadata"}),
        (("list",), LIBRARIES | {"numpy", "optlink.problem.file"}),
        (("show", "crank-rocker"), LIBRARIES | {"optlink.tasks"}),
        (("new", "stroke", "-o", "mine.toml"), LIBRARIES),
        (("export", "six-bar", "-o", "motion.csv"), LIBRARIES),
        (("analyze", "six-bar"), HEAVY | {"numpy.ma", "optlink.optimization", "optlink.synthesis", "optlink.tasks.design"}),
        (("simulate", "slider-crank"), HEAVY - {"casadi"} | {"scipy", "numpy.ma", "markdown_it"}),
        (("solve", "crank-rocker"), HEAVY - {"casadi"} | {"numpy.ma", "markdown_it"} | NOT_FOR_A_LAW),
    ],
)
def test_each_command_loads_only_what_it_needs(words, unwanted, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert loaded_after(command(*words)) & unwanted == set()


@pytest.mark.slow
def test_a_stored_design_is_exported_without_the_libraries_that_found_it(tmp_path):
    result = optlink.solve(optlink.load("crank-rocker"))
    write_json(tmp_path / "result.json", result.to_dict())
    for suffix, used in (("csv", set()), ("json", set()), ("svg", set()), ("dxf", {"ezdxf"})):
        drawn = tmp_path / f"motion.{suffix}"
        assert loaded_after(command("export", str(tmp_path), "-o", str(drawn))) & LIBRARIES == used
        assert drawn.stat().st_size > 1000


def test_garbage_is_collected_rarely_and_not_at_exit():
    """Without a callback of the collector, in which Python would drop the interrupt of a Ctrl-C."""
    code = """
import contextlib, gc, sys
from optlink.__main__ import main
usual, sys.argv = gc.get_threshold(), ["optlink", "--version"]
with contextlib.suppress(SystemExit):
    main()
assert gc.get_threshold()[0] > 100 * usual[0] and gc.get_threshold()[1:] == usual[1:]
assert gc.get_freeze_count() > 1000 and not gc.callbacks
"""
    assert "gc" in loaded_after(code)


def test_the_check_detects_violations():
    assert loaded_after("import casadi") & HEAVY == {"casadi"}


@pytest.mark.parametrize(
    ("code", "unwanted"),
    [
        ("import optlink", HEAVY | {"numpy", "pydantic"}),
        ("import optlink.linkage.motion, optlink.linkage.fourbar", HEAVY | {"pydantic"}),
        ("import optlink.validation", HEAVY),
        ("import optlink; optlink.load('crank-rocker')", HEAVY),
        ("import optlink; optlink.analyze(optlink.load('shaper'))", HEAVY),
        ("import optlink; optlink.analyze_batch(optlink.load('six-bar'), {'link2.length': [1.2]})", HEAVY),
        ("import optlink; optlink.solve(optlink.load('crank-rocker'))", HEAVY - {"casadi"}),
    ],
)
def test_each_task_loads_only_what_it_needs(code, unwanted):
    assert loaded_after(code) & unwanted == set()


def test_version_is_that_of_the_package():
    """Stated once, in optlink/version.py: hatch reads it there, and tests/test_package.py looks at what it makes of it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert project["project"]["dynamic"] == ["version"]
    assert project["tool"]["hatch"]["version"]["path"] == "optlink/version.py"
    newest, *released = re.findall(
        r"^## \[(.+)\](?: - \d{4}-\d\d-\d\d)?$", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE
    )
    assert newest == ("Unreleased" if optlink.__version__.endswith(".dev0") else optlink.__version__)
    assert optlink.__version__.removesuffix(".dev0") not in released


def test_no_module_evaluates_text():
    """Problem files are data: neither eval nor exec nor compile nor pickle anywhere in the package but between its processes."""
    import ast

    forbidden = {"eval", "exec", "compile", "__import__"}
    words = re.compile(r"\b(eval|exec|compile|__import__)\s*\(|\b(pickle|shelve|marshal)\b")  # only where there are any
    for text, path in ((path.read_text(), path) for path in (ROOT / "optlink").rglob("*.py")):
        for node in ast.walk(ast.parse(text)) if words.search(text) else ():
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in forbidden, f"{path}: {node.func.id}"
            if isinstance(node, ast.Import) and path.parent.name != "execution":
                assert not {alias.name for alias in node.names} & {"pickle", "shelve", "marshal"}, path
