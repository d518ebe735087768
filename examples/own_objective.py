"""An objective of your own: the shortest bars whose law deviates by at most 1.1 degrees (rms), with SciPy."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import NonlinearConstraint, minimize

import optlink

problem = optlink.load("crank-rocker", {"requirement.measure": "rms"})
best = optlink.solve(problem)
programme = optlink.build(problem).scaled()
names = [variable.name for variable in programme.variables]


def bars(x: NDArray[np.float64]) -> float:
    """Return the total length of coupler and rocker [m]."""
    return float(sum(programme.design(x).values()))


def deviation(x: NDArray[np.float64]) -> float:
    """Return the rms deviation from the law [deg]."""
    return float(np.degrees(programme.objective(x)))


limits = [
    NonlinearConstraint(programme.g, programme.g_low, programme.g_high, jac=programme.jacobian),
    NonlinearConstraint(deviation, -np.inf, 1.1),
]
start = programme.x_of(best.design)
bounds = list(zip(programme.x_low, programme.x_high, strict=True))
found = minimize(bars, start, method="SLSQP", bounds=bounds, constraints=limits, options={"ftol": 1e-12})
design = programme.design(found.x)
checked = optlink.validate(problem, design)
for name in names:
    print(f"{name}: {1e3 * best.design[name]:.3f} mm for the best law, {1e3 * design[name]:.3f} mm for the shortest bars")
print(f"deviation {deviation(start):.4f} deg -> {deviation(found.x):.4f} deg")
print("limits met:", all(check.passed for check in checked.validation.checks))
