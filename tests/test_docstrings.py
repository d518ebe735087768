"""Functions of the Python reference describe their arguments and exceptions; CONTRIBUTING names files that exist.

Elsewhere a section names only what a signature does not tell: a shape, a unit, a meaning. No section names what does not exist.
"""

from __future__ import annotations

import ast
import doctest
import importlib
import inspect
import re
from collections.abc import Collection, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import optlink
from docs.generate import extending

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


EXTENSION_POINTS = {
    *(extending.path_of(one.entry) for one in extending.ADDITIONS),
    *(f"optlink.{name}" for one in extending.ADDITIONS for name in one.further),
}


@cache
def reference() -> set[str]:
    """Full names of the functions and classes of the Python reference, and of the extension points."""
    pages = "\n".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs" / "api").glob("*.md"))
    found = set(EXTENSION_POINTS)
    for name in re.findall(r"^<!-- api: (optlink\.\S+) ", pages, re.MULTILINE):
        home, _, last = name.rpartition(".")
        item = getattr(importlib.import_module(home), last, None) or importlib.import_module(name)
        if inspect.ismodule(item):
            found |= {f"{name}.{key}" for key, member in vars(item).items() if getattr(member, "__module__", "") == name}
        else:
            member = inspect.unwrap(item) if inspect.isfunction(item) else item
            found.add(f"{member.__module__}.{member.__qualname__}")
    return found


def functions(body: list[ast.stmt], within: str) -> Iterator[tuple[str, ast.FunctionDef]]:
    """Public functions and methods with their full names; commands are described by their options."""
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from functions(node.body, f"{within}.{node.name}")
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield f"{within}.{node.name}", node


def raised(node: ast.AST) -> set[str]:
    """Names of the exceptions that a function raises itself; without those in a `try`, which may catch them."""
    if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and isinstance(node.exc.func, ast.Name):
        return {node.exc.func.id} if node.exc.func.id[0].isupper() else set()
    parts: list[ast.AST] = list(ast.iter_child_nodes(node))
    if isinstance(node, ast.Try):
        parts = [*node.handlers, *node.orelse, *node.finalbody]
    return {name for part in parts if not isinstance(part, ast.FunctionDef) for name in raised(part)}


def lacking(source: str, module: str, public: Collection[str]) -> list[str]:
    """Functions of a module whose docstrings describe an argument that does not exist.

    Those of public functions, and of the methods of public classes, lack no argument and no exception.
    """
    result = []
    for full_name, function in functions(ast.parse(source).body, module):
        if "overload" in map(ast.unparse, function.decorator_list):
            continue
        text = ast.get_docstring(function) or ""
        names, known = arguments(function), described(text)
        shown = full_name in public or full_name.rpartition(".")[0] in public
        wrong = [name for name in names if name not in known] if shown and len(names) > 1 else []
        wrong += [name for name in known if name not in names or known.count(name) > 1]
        _, _, section = text.partition("\nRaises\n------\n")
        unsaid = (name for name in raised(function) if not re.search(rf"^(\w+, )*{name}(, \w+)*$", section, re.MULTILINE))
        wrong += sorted(unsaid) if shown else []
        if wrong:
            result.append(f"{function.name}: {', '.join(wrong)}")
    return result


def commands() -> set[Path]:
    """Modules whose public functions are commands, described by the help texts of their options."""
    signs = ("typer.Option", "quiet: Quiet")
    modules = (ROOT / "optlink" / "cli").glob("*.py")
    return {path for path in modules if any(sign in path.read_text(encoding="utf-8") for sign in signs)}


def test_public_functions_describe_their_arguments() -> None:
    result = {}
    for path in sorted(set((ROOT / "optlink").rglob("*.py")) - commands()):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        result[module] = lacking(path.read_text(encoding="utf-8"), module.removesuffix(".__init__"), reference())
    assert {module: names for module, names in result.items() if names} == {}


def test_the_reference_has_the_public_names() -> None:
    assert {"optlink.tasks.run.solve", "optlink.linkage.fourbar.four_bar", "optlink.studies.sweeps.sweep"} <= reference()
    assert len(reference()) > 90


def test_the_check_detects_missing_sections() -> None:
    good = 'def f(a, b):\n    """Add.\n\n    Parameters\n    ----------\n    a, b : float\n    """\n'

    def found(source: str, *public: str) -> list[str]:
        return lacking(source, "m", public)

    assert found(good, "m.f") == []
    assert found(good.replace("a, b : float", "a : float"), "m.f") == ["f: b"]
    assert found(good.replace("a, b : float", "a : float")) == []
    assert found(good.replace("a, b : float", "a, b, c : float")) == ["f: c"]
    assert found(good.replace("a, b : float", "a, b, a : float")) == ["f: a, a"]
    assert found('class C:\n    def f(self, a, b):\n        """Add."""\n', "m.C") == ["f: a, b"]
    raising = 'def f():\n    """Fail.{}"""\n    raise ValueError("always")\n'
    assert found(raising.format("")) == []
    assert found(raising.format(""), "m.f") == ["f: ValueError"]
    assert found(raising.format("\n\n    Raises\n    ------\n    ValueError\n        Always.\n    "), "m.f") == []


def test_contributing_names_files_that_exist() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    paths = set(PATHS.findall(text))
    assert len(paths) > 20
    assert {path for path in paths if not (ROOT / path).exists()} == set()


SPACES = {"": optlink, "control.": optlink.control, "studies.": optlink.studies, "synthesis.": optlink.synthesis}
TASKS = {
    f"{space}{name}": getattr(package, name)
    for space, package in SPACES.items()
    for name in package.__all__
    if inspect.isfunction(getattr(package, name))
}
READ = {"explore", "load", "new", "read", "read_design", "shipped"}  # their examples are those of all others
SLOW = ("control.tune",)


@pytest.mark.parametrize(
    ("name", "function"),
    [
        pytest.param(name, function, marks=pytest.mark.slow if name in SLOW else (), id=name)
        for name, function in TASKS.items()
        if name not in READ
    ],
)
def test_public_functions_have_an_example_that_runs(name: str, function: Any) -> None:
    (example,) = doctest.DocTestFinder().find(inspect.unwrap(function), name, globs={"optlink": optlink, "np": np})
    assert example.examples, f"{name} has no example"
    shown: list[str] = []
    assert doctest.DocTestRunner().run(example, out=shown.append).failed == 0, "".join(shown)
