"""optlink: describe a planar linkage and its requirements; get a design that is optimised, verified and explained.

>>> import optlink
>>> result = optlink.solve("crank-rocker")
>>> result.valid, round(result.design["coupler"] * 1e3, 3)
(True, 412.865)
"""

from optlink.namespace import namespace
from optlink.version import VERSION as __version__  # noqa: F401

__all__, __getattr__, __dir__ = namespace(
    __name__,
    """
    optlink: control extending linkage studies style synthesis testing
    optlink.errors: InputError OptlinkError SolverError Status UnknownName
    optlink.execution.options: Execution
    optlink.presentation.interface: export report
    optlink.presentation.registry: read_result
    optlink.problem.document: Document Result
    optlink.problem.file: AnyProblem ProblemFile load read shipped
    optlink.problem.own_terms: limit objective
    optlink.problem.renaming: rename
    optlink.problem.templates: new
    optlink.studies.sweeps: sweep
    optlink.studio: explore
    optlink.tasks.analyze: Analysis BatchAnalysis analyze analyze_batch motion
    optlink.tasks.balance: balance
    optlink.tasks.derivatives: gradient hessian
    optlink.tasks.programme: Programme build
    optlink.tasks.results.balance: Balance
    optlink.tasks.results.common: DesignResult
    optlink.tasks.results.design: LinkageDesign SynthesisResult
    optlink.tasks.run: read_design solve validate
    optlink.tasks.simulate: Simulation simulate
    """,
    moved="""
    optlink.linkage.four_bar: four_bar
    optlink.linkage.grashof: grashof
    optlink.control.compare: compare
    optlink.control.inverse_model: inverse_model
    optlink.control.simulate_clearance: simulate_clearance
    optlink.control.tune: tune
    optlink.control.ClearanceSimulation: ClearanceSimulation
    optlink.control.Comparison: Comparison
    optlink.control.InverseMotion: InverseMotion
    optlink.control.Tuning: Tuning
    optlink.SynthesisResult: CycleResult FunctionResult PathResult
    optlink.LinkageDesign: PathDesign
    """,
)
