from optlink import (
    control as control,
    extending as extending,
    linkage as linkage,
    studies as studies,
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
from optlink.presentation.interface import export as export, report as report
from optlink.presentation.registry import read_result as read_result
from optlink.problem.document import Document as Document
from optlink.problem.file import (
    AnyProblem as AnyProblem,
    ProblemFile as ProblemFile,
    load as load,
    read as read,
    shipped as shipped,
)
from optlink.problem.templates import new as new
from optlink.studio import explore as explore
from optlink.tasks.analyze import Analysis as Analysis, analyze as analyze, analyze_batch as analyze_batch, motion as motion
from optlink.tasks.balance import balance as balance
from optlink.tasks.programme import Programme as Programme, build as build
from optlink.tasks.results.balance import Balance as Balance
from optlink.tasks.results.common import DesignResult as DesignResult
from optlink.tasks.results.design import LinkageDesign as LinkageDesign, SynthesisResult as SynthesisResult
from optlink.tasks.run import read_design as read_design, solve as solve, validate as validate
from optlink.tasks.simulate import Simulation as Simulation, simulate as simulate

__version__: str
