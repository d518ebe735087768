from optlink.execution.options import Checkpoints as Checkpoints, ResumableExecution as ResumableExecution
from optlink.tasks.clearance import (
    InverseMotion as InverseMotion,
    inverse_model as inverse_model,
    simulate_clearance as simulate_clearance,
)
from optlink.tasks.control_comparison import compare as compare, tune as tune
from optlink.tasks.results.clearance import ClearanceSimulation as ClearanceSimulation, Comparison as Comparison, Tuning as Tuning
