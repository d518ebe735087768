"""Reference of what an extension can add: each kind of entry with its fields, an example that a test runs, and its oracles."""

from __future__ import annotations

from typing import NamedTuple

from docs.generate.api import ROOT, cell, code, package, reference
from optlink.io import Entry
from optlink.linkage.assur import DyadType
from optlink.presentation.registry import ResultKind
from optlink.presentation.view import ResultChart
from optlink.problem.limits import LimitTerm
from optlink.problem.machine.loads import LoadKind
from optlink.problem.machine.model import ProblemKind
from optlink.problem.terms import QuantityType
from optlink.solvers.contract import Solver

QUOTES = "'\""
EXAMPLES = ROOT / "tests" / "extending"


class Addition(NamedTuple):
    """What can be added: the class of its entries, a module of `tests/extending`, its oracles, other classes that it needs."""

    words: str
    entry: type[Entry]
    example: str
    oracles: tuple[str, ...]
    further: tuple[str, ...] = ()


ADDITIONS = (
    Addition(
        "limit",
        LimitTerm,
        "constraint",
        ("check_derivatives", "check_prices"),
        ("problem.limits.Reach", "problem.limits.Moved", "problem.quantity.Interval"),
    ),
    Addition(
        "quantity",
        QuantityType,
        "objective",
        ("check_derivatives",),
        (
            *(f"problem.terms.{name}" for name in ("Element", "ElementTerm")),
            *("dynamics.machine.Moving", "dynamics.inverse.Reactions", "dynamics.columns.MotionColumns"),
        ),
    ),
    Addition(
        "kind of load",
        LoadKind,
        "load",
        ("check_forces",),
        (
            *(f"dynamics.machine.{name}" for name in ("Load", "Acting")),
            *(f"problem.machine.loads.{name}" for name in ("LoadSection", "OnBody", "RevolutionSamples")),
            "errors.InvalidValue",
        ),
    ),
    Addition("back end", Solver, "back_end", ("check_optimum",), ("solvers.solution.Backend", "solvers.solution.Attempt")),
    Addition(
        "dyad",
        DyadType,
        "dyad",
        ("check_motion", "check_forces"),
        ("linkage.mechanism.Dyad", "linkage.bodies.Guide", "dynamics.inverse.ForceBalance", "dynamics.inverse.GroupForces"),
    ),
    Addition("kind of problem", ProblemKind, "kind", ("check_stored",), ("tasks.protocol.DesignTask", "tasks.protocol.Search")),
    Addition("kind of result", ResultKind, "view", ("check_stored",), ("presentation.view.View",)),
    Addition(
        "chart",
        ResultChart,
        "chart",
        ("check_stored",),
        tuple(f"presentation.chart_spec.{name}" for name in ("ChartSpec", "Panel", "Axis", "Curve", "Bars", "crank_angle")),
    ),
)


TYPES = (
    *(f"linkage.vector2d.{name}" for name in ("Value", "Vector", "Array")),
    *("linkage.bodies.Joint", "linkage.assur.Former", "problem.terms.Signal", "problem.terms.Course"),
)
"""Names for types."""


def types() -> str:
    """Return a table of the names for types."""
    found = [package()[path] for path in TYPES]
    rows = [f"| `{one.name}` | {cell(code(str(one.value).strip(QUOTES)))} | {one.docstring.value} |" for one in found]
    return "\n".join(["| type | stands for | meaning |", "|---|---|---|", *rows])


def path_of(entry: type[Entry]) -> str:
    """Return the full name of a class of entries."""
    return f"{entry.__module__}.{entry.__qualname__}"


def page() -> str:
    """Return a table of all kinds of entries, then a section for each."""
    rows = []
    for one in ADDITIONS:
        oracles = ", ".join(f"[`{name}`](testing.md#{name})" for name in one.oracles)
        rows.append(f"| {one.words} | [`{one.entry.__name__}`](#{one.entry.__name__.lower()}) | {oracles} |")
    parts = ["\n".join(["| to add | register | check it by |", "|---|---|---|", *rows])]
    for one in ADDITIONS:
        example = EXAMPLES / f"{one.example}.py"
        parts += [
            reference(path_of(one.entry), ("fault", "entered")),
            f"An example, `tests/extending/{example.name}`:",
            f"```python\n{example.read_text(encoding='utf-8').strip()}\n```",
            *(reference(f"optlink.{path}") for path in one.further),
        ]
    return "\n\n".join([*parts, "## Names for types", types()])
