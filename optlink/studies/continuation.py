"""Continue an optimum to a neighbouring problem by Newton's method on the optimality conditions with a fixed active set.

The first step equals the prediction by sensitivities, further steps remove the residual. If the neighbour has another active set,
the final point violates the optimality conditions; the caller detects this and starts a search.
"""

import numpy as np

from optlink.errors import Status
from optlink.optimization.nlp import NLP
from optlink.solvers.multistart import newton
from optlink.solvers.solution import Attempt, Solution, verified_solution

MAX_STEPS = 8
MAX_DISTANCE = 0.3  # scaled units; largest distance of a neighbour
MAX_RESIDUAL = 1e-10
FOLLOWED = "followed from a neighbour"


def follow_optimum(nlp: NLP, near: Solution) -> Solution | None:
    """Return the optimum of a programme after a change of its parameters or bounds; None if a search is needed."""
    p = np.array([near.p[0], *nlp.p[1:]])
    x, n = near.x, len(near.x)
    active = np.array(near.conditions.active, dtype=int)
    rows = active[active >= n] - n
    multipliers = near.conditions.multipliers[active]
    bound = np.where(multipliers > 0.0, nlp.upper[active], nlp.lower[active])
    if not np.all(np.isfinite(bound)):
        return None
    unit, steps = np.eye(n), 0
    while steps < MAX_STEPS:
        values = nlp.at(x, p)
        if not values.finite or np.max(np.abs(x - near.x), initial=0.0) > MAX_DISTANCE:
            return None
        jacobian = np.vstack([unit, values.jacobian])[active]
        missing = np.concatenate([x, values.g])[active] - bound
        residual = np.concatenate([values.gradient + jacobian.T @ multipliers, missing])
        if np.max(np.abs(residual), initial=0.0) <= MAX_RESIDUAL:
            break
        weights = np.zeros(len(values.g))
        weights[rows] = multipliers[len(active) - len(rows) :]
        step = newton(nlp.hessian(x, p, weights), jacobian, residual)
        if step is None:
            return None
        x, steps = x + step[:n], steps + 1
        multipliers = multipliers + step[n:]
    solution = verified_solution(nlp, Attempt(nlp.lifted(np.clip(x, nlp.x_low, nlp.x_high)), steps, FOLLOWED), p)
    return solution if solution.status is Status.OPTIMAL and not solution.curvature < 0.0 else None
