"""Public functions describe their arguments and exceptions; CONTRIBUTING names files that exist.

Stricter than D417 of ruff, which skips functions without a Parameters section; but a name with its type needs no further words.
"""

from __future__ import annotations

import ast
import doctest
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.studies.pareto.epsilon_constraint import pareto
from optlink.studies.sensitivity import sensitivities
from optlink.studies.sweep import sweep
from optlink.studies.tolerance.analysis import tolerance

ROOT = Path(__file__).parent.parent
SECTION = re.compile(r"^Parameters\n-+\n(.*?)(?=^\w[\w ]*\n-{3,}|\Z)", re.DOTALL | re.MULTILINE)
PATHS = re.compile(r"`((?:optlink|tests|docs|problems|benchmarks)/[\w/.]*)`")


def arguments(function: ast.FunctionDef) -> list[str]:
    """Names of the arguments, without self, cls and private ones."""
    parameters = function.args
    more = [argument for argument in (parameters.vararg, parameters.kwarg) if argument is not None]
    names = [argument.arg for argument in (*parameters.posonlyargs, *parameters.args, *parameters.kwonlyargs, *more)]
    return [name for name in names if name not in ("self", "cls") and not name.startswith("_")]


def described(docstring: str) -> list[str]:
    """Names in the Parameters section of a numpy-style docstring, in order."""
    section = SECTION.search(docstring)
    lines = section.group(1).splitlines() if section else []
    entries = (line.split(" : ")[0].split(",") for line in lines if line and not line.startswith(" "))
    return [name.strip().lstrip("*") for entry in entries for name in entry]


def public(body: list[ast.stmt]) -> Iterator[ast.FunctionDef]:
    """Public functions and methods; commands are described by their options."""
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from public(node.body)
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield node


def raised(node: ast.AST) -> set[str]:
    """Names of the exceptions that a function raises itself; without those in a `try`, which may catch them."""
    if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and isinstance(node.exc.func, ast.Name):
        return {node.exc.func.id} if node.exc.func.id[0].isupper() else set()
    parts: list[ast.AST] = list(ast.iter_child_nodes(node))
    if isinstance(node, ast.Try):
        parts = [*node.handlers, *node.orelse, *node.finalbody]
    return {name for part in parts if not isinstance(part, ast.FunctionDef) for name in raised(part)}


def lacking(source: str) -> list[str]:
    """Functions of a module whose docstrings miss an argument or exception, or describe an argument that does not exist."""
    result = []
    for function in public(ast.parse(source).body):
        text = ast.get_docstring(function) or ""
        names, known = arguments(function), described(text)
        wrong = [name for name in names if name not in known] if len(names) > 1 else []
        wrong += [name for name in known if name not in names or known.count(name) > 1]
        _, _, section = text.partition("\nRaises\n------\n")
        wrong += sorted(name for name in raised(function) if not re.search(rf"^(\w+, )*{name}(, \w+)*$", section, re.MULTILINE))
        if wrong:
            result.append(f"{function.name}: {', '.join(wrong)}")
    return result


def commands() -> set[Path]:
    """Modules whose public functions are commands, described by the help texts of their options."""
    signs = ("typer.Option", "quiet: Quiet")
    modules = (ROOT / "optlink" / "cli").glob("*.py")
    return {path for path in modules if any(sign in path.read_text(encoding="utf-8") for sign in signs)}


def test_public_functions_describe_their_arguments() -> None:
    modules = sorted(set((ROOT / "optlink").rglob("*.py")) - commands())
    result = {str(path.relative_to(ROOT)): lacking(path.read_text(encoding="utf-8")) for path in modules}
    assert {path: names for path, names in result.items() if names} == {}


def test_the_check_detects_missing_sections() -> None:
    good = 'def f(a, b):\n    """Add.\n\n    Parameters\n    ----------\n    a, b : float\n    """\n'
    assert lacking(good) == []
    assert lacking(good.replace("a, b : float", "a : float")) == ["f: b"]
    assert lacking(good.replace("a, b : float", "a, b, c : float")) == ["f: c"]
    assert lacking(good.replace("a, b : float", "a, b, a : float")) == ["f: a, a"]
    assert lacking('class C:\n    def f(self, a, b):\n        """Add."""\n') == ["f: a, b"]
    raising = 'def f():\n    """Fail.{}"""\n    raise ValueError("always")\n'
    assert lacking(raising.format("")) == ["f: ValueError"]
    assert lacking(raising.format("\n\n    Raises\n    ------\n    ValueError\n        Always.\n    ")) == []


def test_contributing_names_files_that_exist() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    paths = set(PATHS.findall(text))
    assert len(paths) > 20
    assert {path for path in paths if not (ROOT / path).exists()} == set()


TASKS = {name: getattr(optlink, name) for name in optlink.__all__ if inspect.isfunction(getattr(optlink, name))}
READ = {"explore", "load", "new", "read", "read_design", "shipped"}  # their examples are those of all others
STUDIES = {f"studies.{function.__name__}": function for function in (pareto, sensitivities, sweep, tolerance)}
SLOW = ("tune",)


@pytest.mark.parametrize(
    ("name", "function"),
    [
        pytest.param(name, function, marks=pytest.mark.slow if name in SLOW else (), id=name)
        for name, function in {**TASKS, **STUDIES}.items()
        if name not in READ
    ],
)
def test_public_functions_have_an_example_that_runs(name: str, function: Any) -> None:
    (example,) = doctest.DocTestFinder().find(inspect.unwrap(function), name, globs={"optlink": optlink, "np": np})
    assert example.examples, f"{name} has no example"
    shown: list[str] = []
    assert doctest.DocTestRunner().run(example, out=shown.append).failed == 0, "".join(shown)
