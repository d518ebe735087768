"""SciPy's trust-region method as a back end: `--backend trust-constr`."""

import numpy as np
from scipy.optimize import Bounds, NonlinearConstraint, minimize

from optlink.extending import NLP, Array, Attempt, Solver, Value, register


def trust_constr(nlp: NLP, x: Array, p: Array, *, track: bool = False, tight: bool = False) -> Attempt:
    """Minimise from x with exact gradients and Jacobians; undefined points count as very bad ones."""
    path = [x]

    def finite(values: Value) -> Array:
        return np.asarray(np.nan_to_num(values, nan=1e10, posinf=1e10, neginf=-1e10))

    limits = NonlinearConstraint(
        lambda x: finite(nlp.values(x, p)[1]), nlp.low, nlp.high, jac=lambda x: finite(nlp.at(x, p).jacobian)
    )
    result = minimize(
        lambda x: float(finite(nlp.values(x, p)[0])),
        x,
        method="trust-constr",
        jac=lambda x: finite(nlp.at(x, p).gradient),
        hess=lambda x: finite(nlp.hessian(x, p, np.zeros(len(nlp.rows)))),
        constraints=[limits] if nlp.rows else [],
        bounds=Bounds(nlp.x_low, nlp.x_high),
        callback=(lambda x, state: path.append(x.copy())) if track else None,
        options={"gtol": 1e-12 if tight else 1e-9, "xtol": 1e-12, "maxiter": 400},
    )
    end = np.clip(result.x, nlp.x_low, nlp.x_high)
    return Attempt(end, int(result.nit), str(result.message), np.array(path) if track else None)


register(Solver("trust-constr", lambda: trust_constr))
