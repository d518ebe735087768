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
    from optlink.analysis import Analysis, analyze
    from optlink.balanced import Balance
    from optlink.balancing import balance
    from optlink.batch import analyze_batch
    from optlink.clearances import LooseSimulation, simulate_clearance
    from optlink.compensation import Comparison, Tuning, compare, tune
    from optlink.design.files import ProblemFile, load, read, shipped
    from optlink.designed import MachineDesign
    from optlink.errors import InputError, OptlinkError, SolverError, Status
    from optlink.generated import Design, Generation
    from optlink.generation import generate
    from optlink.linkage.fourbar import four_bar, grashof
    from optlink.linkage.motion import sweep
    from optlink.machine_design import design_machine
    from optlink.simulation import Simulation, simulate
    from optlink.workflow import Result, read_design, solve, validate

_HOME = {
    "Analysis": "optlink.analysis",
    "analyze": "optlink.analysis",
    "Balance": "optlink.balanced",
    "balance": "optlink.balancing",
    "Simulation": "optlink.simulation",
    "simulate": "optlink.simulation",
    "analyze_batch": "optlink.batch",
    "LooseSimulation": "optlink.clearances",
    "simulate_clearance": "optlink.clearances",
    "Comparison": "optlink.compensation",
    "Tuning": "optlink.compensation",
    "compare": "optlink.compensation",
    "tune": "optlink.compensation",
    "Design": "optlink.generated",
    "Generation": "optlink.generated",
    "generate": "optlink.generation",
    "InputError": "optlink.errors",
    "OptlinkError": "optlink.errors",
    "SolverError": "optlink.errors",
    "Status": "optlink.errors",
    "ProblemFile": "optlink.design.files",
    "load": "optlink.design.files",
    "read": "optlink.design.files",
    "shipped": "optlink.design.files",
    "MachineDesign": "optlink.designed",
    "design_machine": "optlink.machine_design",
    "four_bar": "optlink.linkage.fourbar",
    "grashof": "optlink.linkage.fourbar",
    "sweep": "optlink.linkage.motion",
    "Result": "optlink.workflow",
    "read_design": "optlink.workflow",
    "solve": "optlink.workflow",
    "validate": "optlink.workflow",
}

__all__ = [
    "Analysis",
    "Balance",
    "Comparison",
    "Design",
    "Generation",
    "InputError",
    "LooseSimulation",
    "MachineDesign",
    "OptlinkError",
    "ProblemFile",
    "Result",
    "Simulation",
    "SolverError",
    "Status",
    "Tuning",
    "__version__",
    "analyze",
    "analyze_batch",
    "balance",
    "compare",
    "design_machine",
    "four_bar",
    "generate",
    "grashof",
    "load",
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
    return getattr(importlib.import_module(_HOME[name]), name)
