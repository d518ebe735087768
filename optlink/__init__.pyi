from typing import Any

from typing_extensions import deprecated

from optlink import (
    control as control,
    extending as extending,
    linkage as linkage,
    studies as studies,
    style as style,
    synthesis as synthesis,
    testing as testing,
)
from optlink.errors import (
    InputError as InputError,
    OptlinkError as OptlinkError,
    SolverError as SolverError,
    Status as Status,
    UnknownName as UnknownName,
)
from optlink.execution.options import Execution as Execution
from optlink.presentation.interface import export as export, report as report
from optlink.presentation.registry import read_result as read_result
from optlink.problem.document import Document as Document, Result as Result
from optlink.problem.file import (
    AnyProblem as AnyProblem,
    ProblemFile as ProblemFile,
    load as load,
    read as read,
    shipped as shipped,
)
from optlink.problem.own_terms import limit as limit, objective as objective
from optlink.problem.renaming import rename as rename
from optlink.problem.templates import new as new
from optlink.studies.sweeps import sweep as sweep
from optlink.studio import explore as explore
from optlink.tasks.analyze import (
    Analysis as Analysis,
    BatchAnalysis as BatchAnalysis,
    analyze as analyze,
    analyze_batch as analyze_batch,
    motion as motion,
)
from optlink.tasks.balance import balance as balance
from optlink.tasks.derivatives import gradient as gradient, hessian as hessian
from optlink.tasks.programme import Programme as Programme, build as build
from optlink.tasks.results.balance import Balance as Balance
from optlink.tasks.results.common import DesignResult as DesignResult
from optlink.tasks.results.design import LinkageDesign as LinkageDesign, SynthesisResult as SynthesisResult
from optlink.tasks.run import read_design as read_design, solve as solve, validate as validate
from optlink.tasks.simulate import Simulation as Simulation, simulate as simulate

__version__: str

# Names of version 0.1, with those that took their place; docs/stability.md states how long they work.

@deprecated("optlink.four_bar is now optlink.linkage.four_bar")
def four_bar(*args: Any, **options: Any) -> linkage.Mechanism: ...
@deprecated("optlink.grashof is now optlink.linkage.grashof")
def grashof(*args: Any, **options: Any) -> linkage.GrashofClass: ...
@deprecated("optlink.compare is now optlink.control.compare")
def compare(*args: Any, **options: Any) -> control.Comparison: ...
@deprecated("optlink.inverse_model is now optlink.control.inverse_model")
def inverse_model(*args: Any, **options: Any) -> control.InverseMotion: ...
@deprecated("optlink.simulate_clearance is now optlink.control.simulate_clearance")
def simulate_clearance(*args: Any, **options: Any) -> control.ClearanceSimulation: ...
@deprecated("optlink.tune is now optlink.control.tune")
def tune(*args: Any, **options: Any) -> control.Tuning: ...

@deprecated("optlink.ClearanceSimulation is now optlink.control.ClearanceSimulation")
class ClearanceSimulation(control.ClearanceSimulation): ...

@deprecated("optlink.Comparison is now optlink.control.Comparison")
class Comparison(control.Comparison): ...

@deprecated("optlink.InverseMotion is now optlink.control.InverseMotion")
class InverseMotion(control.InverseMotion): ...

@deprecated("optlink.Tuning is now optlink.control.Tuning")
class Tuning(control.Tuning): ...

@deprecated("optlink.CycleResult is now optlink.SynthesisResult")
class CycleResult(SynthesisResult): ...

@deprecated("optlink.FunctionResult is now optlink.SynthesisResult")
class FunctionResult(SynthesisResult): ...

@deprecated("optlink.PathResult is now optlink.SynthesisResult")
class PathResult(SynthesisResult): ...

@deprecated("optlink.PathDesign is now optlink.LinkageDesign")
class PathDesign(LinkageDesign): ...
