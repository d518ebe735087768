from optlink.studies.fronts.epsilon_constraint import Pareto as Pareto, pareto as pareto
from optlink.studies.motion_sensitivity import OutputSensitivity as OutputSensitivity, output_sensitivity as output_sensitivity
from optlink.studies.sensitivity import (
    Derivatives as Derivatives,
    Sensitivities as Sensitivities,
    Sensitivity as Sensitivity,
    sensitivities as sensitivities,
)
from optlink.studies.sweeps import Sweep as Sweep, sweep as sweep
from optlink.studies.tolerances.allocation import Allocation as Allocation
from optlink.studies.tolerances.analysis import Tolerance as Tolerance, tolerance as tolerance
from optlink.studies.tolerances.monte_carlo import MonteCarlo as MonteCarlo
from optlink.studies.tolerances.robust_design import RobustDesign as RobustDesign
