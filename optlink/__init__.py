"""optlink: state a planar linkage and what it must do; get a design that is optimal, verified and explained.

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
    from optlink.errors import InputError, OptlinkError, SolverError, Status
    from optlink.linkage.fourbar import four_bar, grashof
    from optlink.linkage.motion import sweep
    from optlink.problem.file import ProblemFile, load, read, shipped
    from optlink.problem.templates import new
    from optlink.report.html.notebook import Explorer
    from optlink.studio import explore
    from optlink.tasks.analyze import analyze
    from optlink.tasks.balance import balance
    from optlink.tasks.batch import analyze_batch
    from optlink.tasks.clearance import simulate_clearance
    from optlink.tasks.control_comparison import compare, tune
    from optlink.tasks.function import FunctionResult, read_design
    from optlink.tasks.results.analysis import Analysis
    from optlink.tasks.results.balance import Balance
    from optlink.tasks.results.clearance import ClearanceSimulation
    from optlink.tasks.results.control_comparison import Comparison, Tuning
    from optlink.tasks.results.cycle import CycleResult
    from optlink.tasks.results.path import PathDesign, PathResult
    from optlink.tasks.run import solve, validate
    from optlink.tasks.simulate import Simulation, simulate

_HOME = {
    "Analysis": "optlink.tasks.results.analysis",
    "analyze": "optlink.tasks.analyze",
    "Balance": "optlink.tasks.results.balance",
    "balance": "optlink.tasks.balance",
    "Simulation": "optlink.tasks.simulate",
    "simulate": "optlink.tasks.simulate",
    "analyze_batch": "optlink.tasks.batch",
    "ClearanceSimulation": "optlink.tasks.results.clearance",
    "simulate_clearance": "optlink.tasks.clearance",
    "Comparison": "optlink.tasks.results.control_comparison",
    "Tuning": "optlink.tasks.results.control_comparison",
    "compare": "optlink.tasks.control_comparison",
    "tune": "optlink.tasks.control_comparison",
    "PathDesign": "optlink.tasks.results.path",
    "PathResult": "optlink.tasks.results.path",
    "InputError": "optlink.errors",
    "OptlinkError": "optlink.errors",
    "SolverError": "optlink.errors",
    "Status": "optlink.errors",
    "ProblemFile": "optlink.problem.file",
    "load": "optlink.problem.file",
    "new": "optlink.problem.templates",
    "Explorer": "optlink.report.html.notebook",
    "explore": "optlink.studio",
    "read": "optlink.problem.file",
    "shipped": "optlink.problem.file",
    "CycleResult": "optlink.tasks.results.cycle",
    "four_bar": "optlink.linkage.fourbar",
    "grashof": "optlink.linkage.fourbar",
    "sweep": "optlink.linkage.motion",
    "FunctionResult": "optlink.tasks.function",
    "read_design": "optlink.tasks.function",
    "solve": "optlink.tasks.run",
    "validate": "optlink.tasks.run",
}

__all__ = [
    "Analysis",
    "Balance",
    "ClearanceSimulation",
    "Comparison",
    "CycleResult",
    "Explorer",
    "FunctionResult",
    "InputError",
    "OptlinkError",
    "PathDesign",
    "PathResult",
    "ProblemFile",
    "Simulation",
    "SolverError",
    "Status",
    "Tuning",
    "__version__",
    "analyze",
    "analyze_batch",
    "balance",
    "compare",
    "explore",
    "four_bar",
    "grashof",
    "load",
    "new",
    "read",
    "read_design",
    "shipped",
    "simulate",
    "simulate_clearance",
    "solve",
    "sweep",
    "tune",
    "validate",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that `optlink --help` loads nothing heavy."""
    import importlib

    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from optlink.problem.base_model import Recorded

    Recorded.notebook = staticmethod(_notebook)
    return getattr(importlib.import_module(_HOME[name]), name)


def _notebook(result: Any) -> str | None:
    """Return a result as HTML for notebooks."""
    from optlink.report.html.notebook import notebook_html

    return notebook_html(result)
