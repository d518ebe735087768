"""optlink: describe a planar linkage and its requirements; get a design that is optimised, verified and explained.

>>> import optlink
>>> problem = optlink.load("crank-rocker")
>>> result = optlink.solve(problem)
>>> result.valid, round(result.design["coupler"] * 1e3, 3)
(True, 412.865)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from optlink.version import VERSION as __version__

if TYPE_CHECKING:
    from optlink.errors import InputError, OptlinkError, SolverError, Status, UnknownName
    from optlink.linkage.arguments import sweep
    from optlink.linkage.fourbar import four_bar, grashof
    from optlink.problem.file import ProblemFile, load, read, shipped
    from optlink.problem.templates import new
    from optlink.report.registry import read_result
    from optlink.studio import explore
    from optlink.tasks.analyze import Analysis, analyze, analyze_batch
    from optlink.tasks.balance import balance
    from optlink.tasks.clearance import InverseMotion, inverse_model, simulate_clearance
    from optlink.tasks.control_comparison import compare, tune
    from optlink.tasks.programme import Programme, build
    from optlink.tasks.results.balance import Balance
    from optlink.tasks.results.clearance import ClearanceSimulation, Comparison, Tuning
    from optlink.tasks.results.common import DesignResult
    from optlink.tasks.results.design import (
        CycleResult as CycleResult,
        FunctionResult as FunctionResult,
        LinkageDesign,
        PathDesign as PathDesign,
        PathResult as PathResult,
        SynthesisResult,
    )
    from optlink.tasks.run import read_design, solve, validate
    from optlink.tasks.simulate import Simulation, simulate

_NAMES = {
    "optlink.errors": ("InputError", "OptlinkError", "SolverError", "Status", "UnknownName"),
    "optlink.linkage.arguments": ("sweep",),
    "optlink.linkage.fourbar": ("four_bar", "grashof"),
    "optlink.problem.file": ("ProblemFile", "load", "read", "shipped"),
    "optlink.problem.templates": ("new",),
    "optlink.report.registry": ("read_result",),
    "optlink.studio": ("explore",),
    "optlink.tasks.balance": ("balance",),
    "optlink.tasks.analyze": ("Analysis", "analyze", "analyze_batch"),
    "optlink.tasks.clearance": ("InverseMotion", "inverse_model", "simulate_clearance"),
    "optlink.tasks.control_comparison": ("compare", "tune"),
    "optlink.tasks.programme": ("Programme", "build"),
    "optlink.tasks.results.balance": ("Balance",),
    "optlink.tasks.results.common": ("DesignResult",),
    "optlink.tasks.results.clearance": ("ClearanceSimulation", "Comparison", "Tuning"),
    "optlink.tasks.results.design": (
        "LinkageDesign",
        "CycleResult",
        "FunctionResult",
        "PathDesign",
        "PathResult",
        "SynthesisResult",
    ),
    "optlink.tasks.run": ("read_design", "solve", "validate"),
    "optlink.tasks.simulate": ("Simulation", "simulate"),
}
"""Public names by their modules."""

__all__ = [
    "Analysis",
    "Balance",
    "ClearanceSimulation",
    "Comparison",
    "DesignResult",
    "InputError",
    "InverseMotion",
    "LinkageDesign",
    "OptlinkError",
    "ProblemFile",
    "Programme",
    "Simulation",
    "SolverError",
    "Status",
    "SynthesisResult",
    "Tuning",
    "UnknownName",
    "__version__",
    "analyze",
    "analyze_batch",
    "balance",
    "build",
    "compare",
    "explore",
    "four_bar",
    "grashof",
    "inverse_model",
    "load",
    "new",
    "read",
    "read_design",
    "read_result",
    "shipped",
    "simulate",
    "simulate_clearance",
    "solve",
    "sweep",
    "tune",
    "validate",
]


STUDIES = {
    "pareto": "optlink.studies.pareto.epsilon_constraint",
    "sensitivities": "optlink.studies.sensitivity",
    "tolerance": "optlink.studies.tolerance.analysis",
}
"""Studies that are looked for here, by their modules."""


_DEPRECATED: dict[str, str] = {}
"""Successors of names that are no longer public, by these names; docs/stability.md states how long they still work."""


def __dir__() -> list[str]:
    """Return the public names, for the completion of editors and notebooks."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that `optlink --help` loads nothing heavy."""
    import importlib
    import sys

    if name in _DEPRECATED:
        import warnings

        warnings.warn(f"optlink.{name} is deprecated: use optlink.{_DEPRECATED[name]}", DeprecationWarning, stacklevel=2)
        name = _DEPRECATED[name]
    home = next((module for module, names in _NAMES.items() if name in names), None)
    if home is None:
        study = STUDIES.get(name)
        hint = "" if study is None else f". It is a study: from {study} import {name}"
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}", name=name, obj=sys.modules[__name__])
    from optlink.problem.document import Document

    Document.notebook = staticmethod(_notebook)
    return getattr(importlib.import_module(home), name)


def _notebook(result: Any) -> str | None:
    """Return a result as HTML for notebooks."""
    from optlink.report.html.notebook import notebook_html

    return notebook_html(result)
