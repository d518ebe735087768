"""Every class that a public function or a result leads to is in the Python reference, or is internal by name."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Any

import griffe

from docs.generate import api
from tests.test_docs import MADE
from tests.test_public_names import PUBLIC

INTERNAL = """
    Problem DesignProblem BalanceSection Term NLP Machine Cycle Link Arm Dyad BodyPoint Guide Parameters
    Drive Element Single Train Pose Counterweight FreeSpring Output Canvas Summary Stationarity Scale TemporaryFolder
"""
"""Classes of models, programmes and machines, which docs/api/parts.md calls internal: what they lead to is so too."""


def item(path: str) -> Any:
    """What a full name stands for."""
    found = api.package()[path.removeprefix("optlink.")]
    return found.final_target if found.is_alias else found


def names_in(expression: Any) -> Iterator[str]:
    """Full names of optlink in an annotation or a value."""
    if isinstance(expression, griffe.Expr):
        for name in expression.iterate(flat=True):
            if isinstance(name, griffe.ExprName) and name.canonical_path.startswith("optlink."):
                yield name.canonical_path


def annotations(found: Any) -> Iterator[Any]:
    """Annotations of a function and of the public members of a class; the value of a name for a type."""
    if found.is_function:
        yield from (found.returns, *(parameter.annotation for parameter in found.parameters))
    elif found.is_class:
        yield from found.bases
        for name, member in found.members.items():
            if not name.startswith("_") and not member.is_alias and (member.is_function or member.is_attribute):
                yield from annotations(member) if member.is_function else (member.annotation,)
    elif found.is_attribute:
        yield found.value


def reached(public: dict[str, str], internal: set[str]) -> dict[str, str]:
    """Full names of all classes that public names lead to, each with the name that leads there; not beyond internal ones."""
    todo, seen, classes = deque([(f"{space}.{name}", "") for space, names in public.items() for name in names.split()]), set(), {}
    while todo:
        path, before = todo.popleft()
        found = item(path)
        if found.path in seen or found.is_module:
            continue
        seen.add(found.path)
        if found.is_class:
            classes[found.path] = before
        if found.name not in internal:
            todo += [(name, found.path) for annotation in annotations(found) for name in names_in(annotation)]
    return classes


APART = ("optlink.style", "optlink.extending")
"""Namespaces of colours, and of what the page on extensions describes with its own classes."""


def test_every_class_of_a_result_is_in_the_reference() -> None:
    shown = [item(block.what) for block in MADE if block.kind == "api"]
    documented = {one.path for page in shown for one in (page, *(page.members.values() if page.is_module else ()))}
    internal = set(INTERNAL.split())
    classes = reached({space: names for space, names in PUBLIC.items() if space not in APART}, internal)
    assert {path: before for path, before in classes.items() if path not in documented and item(path).name not in internal} == {}
    assert len(classes) > 100
    assert {item(path).name for path in classes} >= {"ValidityEnd", "DifferenceCheck", "Evidence", "Certificate", *internal}


def test_a_class_that_is_not_in_the_reference_is_found() -> None:
    classes = reached({"optlink": "Analysis"}, set())
    assert {"optlink.dynamics.machine.Machine", "optlink.dynamics.machine.Inertia"} <= set(classes)
    assert "optlink.dynamics.machine.Inertia" not in reached({"optlink": "Analysis"}, {"Machine", "ProblemFile"})
