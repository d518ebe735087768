"""Joint clearance, and the control that compensates for it."""

from optlink.namespace import namespace

__all__, __getattr__, __dir__ = namespace(
    __name__,
    """
    optlink.execution.options: Checkpoints ResumableExecution
    optlink.tasks.clearance: InverseMotion inverse_model simulate_clearance
    optlink.tasks.control_comparison: compare tune
    optlink.tasks.results.clearance: ClearanceSimulation Comparison Tuning
    """,
)
