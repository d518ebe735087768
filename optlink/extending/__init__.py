"""Adding to optlink from another package: each entry is one of these classes, and `register` adds it."""

from optlink.namespace import namespace

__all__, __getattr__, __dir__ = namespace(
    __name__,
    """
    optlink.dynamics.columns: MotionColumns
    optlink.dynamics.inverse: ForceBalance GroupForces Reactions solve_two_by_two
    optlink.dynamics.machine: Acting Load Moving
    optlink.errors: InvalidValue
    optlink.io: register
    optlink.linkage.assur: Assembly DyadType Former
    optlink.linkage.extrema: extremes
    optlink.linkage.mechanism: Dyad Guide Joint Link
    optlink.linkage.vector2d: Array Value Vector cross dot minus plus turn turn_back
    optlink.optimization.nlp: NLP
    optlink.presentation.chart_spec: Axis Bars ChartSpec Curve Panel crank_angle
    optlink.presentation.registry: ResultKind
    optlink.presentation.table_spec: Summary summary
    optlink.presentation.view: ResultChart View
    optlink.presentation.views.search_tables: checks
    optlink.problem.base_model: Section
    optlink.problem.design: DesignProblem
    optlink.problem.limits: LimitTerm Moved Reach
    optlink.problem.machine.loads: LoadKind LoadSection OnBody RevolutionSamples
    optlink.problem.machine.model: Problem ProblemKind
    optlink.problem.quantity: AngleInterval FixedLength Interval LengthInterval Number NumberInterval
    optlink.problem.terms: Course Element ElementTerm QuantityType Signal
    optlink.solvers.contract: Solver
    optlink.solvers.solution: Attempt Backend
    optlink.tasks.protocol: DesignTask Search
    optlink.tasks.results.common: SingleResult
    optlink.validation.check: Check Validation
    """,
)
