"""Parametric studies: sensitivities, sweeps, tolerances, Pareto fronts."""

from optlink.namespace import namespace

__all__, __getattr__, __dir__ = namespace(
    __name__,
    """
    optlink.studies.fronts.epsilon_constraint: Pareto pareto
    optlink.studies.motion_sensitivity: OutputSensitivity output_sensitivity
    optlink.studies.sensitivity: Derivatives Sensitivities Sensitivity sensitivities
    optlink.studies.sweeps: Sweep sweep
    optlink.studies.tolerances.allocation: Allocation
    optlink.studies.tolerances.analysis: Tolerance tolerance
    optlink.studies.tolerances.monte_carlo: MonteCarlo
    optlink.studies.tolerances.robust_design: RobustDesign
    """,
)
