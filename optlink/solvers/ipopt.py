"""IPOPT (through casadi) as a Backend: an interior-point method with exact first and second derivatives."""

from typing import Any

import casadi
import numpy as np

from optlink.execution.interrupts import interrupted
from optlink.linkage.vector2d import Array, all_finite
from optlink.optimization.nlp import NLP
from optlink.solvers.solution import Attempt
from optlink.symbolic import silent

OPTIONS: dict[str, Any] = {
    "print_time": False,
    "error_on_fail": False,
    "show_eval_warnings": False,
    "calc_lam_x": False,
    "calc_lam_p": False,
    "calc_multipliers": False,  # multipliers are recomputed from the NLP
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-8,
    "ipopt.constr_viol_tol": 1e-8,
    "ipopt.compl_inf_tol": 1e-8,
    "ipopt.acceptable_iter": 0,
    "ipopt.max_iter": 300,
    "ipopt.mu_strategy": "adaptive",
    # the systems are small and well scaled: multiplier estimates, scaling and refinement cost more than they save
    "ipopt.constr_mult_init_max": 0.0,
    "ipopt.min_refinement_steps": 0,
    "ipopt.mumps_scaling": 0,
    "ipopt.mumps_permuting_scaling": 0,
    # bounds are exact: by default IPOPT widens them by 1e-8, which shows in the sixth digit of a millimetre
    "ipopt.bound_relax_factor": 0.0,
    "ipopt.honor_original_bounds": "yes",
}

TIGHT = {f"ipopt.{name}": 1e-11 for name in ("tol", "constr_viol_tol", "compl_inf_tol", "dual_inf_tol")}

CYCLE = {"ipopt.adaptive_mu_globalization": "kkt-error"}
"""Programmes of machine cycles: half the iterations, as the barrier parameter seldom falls back to a monotone decrease."""

STAYING = {f"ipopt.{name}": 1e-8 for name in ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")}
"""Begin at the start itself. By default IPOPT moves it away from the bounds, by up to 1 % of their distance: in a narrow feasible
region beside a bound the objective then has no value."""
UNDEFINED = "Invalid_Number_Detected"

CLOSE_START = {"ipopt.mu_strategy": "monotone", "ipopt.mu_init": 1e-4}


class _Recorder(casadi.Callback):
    """Callback that records the iterates."""

    def __init__(self, nlp: NLP) -> None:
        casadi.Callback.__init__(self)
        self.sizes = {"x": len(nlp.variables), "f": 1, "g": len(nlp.rows), "lam_x": len(nlp.variables)}
        self.sizes |= {"lam_g": len(nlp.rows), "lam_p": len(nlp.p)}
        self.path: list[Array] = []
        self.construct("recorder", {})

    def get_n_in(self) -> int:
        return int(casadi.nlpsol_n_out())

    def get_sparsity_in(self, i: int) -> Any:
        return casadi.Sparsity.dense(self.sizes[casadi.nlpsol_out(i)], 1)

    def eval(self, arguments: Any) -> Any:
        self.path.append(np.asarray(arguments[0], dtype=float).ravel())
        return [0]


def _solver(nlp: NLP, tight: bool, close: bool, **further: Any) -> Any:
    options = (CYCLE if nlp.cycle else {}) | ({} if nlp.derivatives is None else nlp.derivatives.options)
    options |= (TIGHT if tight else {}) | (CLOSE_START if close else {})
    return casadi.nlpsol("ipopt", "ipopt", nlp.programme, OPTIONS | options | further)


def compiled(nlp: NLP, tight: bool = False, close: bool = False, staying: bool = False) -> Any:
    """Return the solver of an NLP, built once and cached in `nlp.cache`, with options `TIGHT`, `CLOSE_START` and `STAYING`."""
    key = f"ipopt, {tight}, {close}, {staying}"
    if key not in nlp.cache:
        nlp.cache[key] = _solver(nlp, tight, close, **STAYING if staying else {})
        nlp.take_hessian(nlp.cache[key].get_function("nlp_hess_l"))
    return nlp.cache[key]


def ipopt(nlp: NLP, x: Array, p: Array, *, track: bool = False, tight: bool = False, close: bool = False) -> Attempt:
    """Minimise from x with IPOPT; `close`: with a small barrier parameter, for a start near an optimum."""
    recorder = _Recorder(nlp) if track else None
    solver = compiled(nlp, tight, close) if recorder is None else _solver(nlp, tight, close, iteration_callback=recorder)
    before, limits = interrupted(), {"lbx": nlp.x_low, "ubx": nlp.x_high, "lbg": nlp.low, "ubg": nlp.high}
    with silent():
        result = solver(x0=x, p=p, **limits)
        if solver.stats()["return_status"] == UNDEFINED and nlp.at(x, p).finite:
            solver = compiled(nlp, tight, close, staying=True)
            result = solver(x0=x, p=p, **limits)
    if interrupted() and not before:  # casadi stops at Ctrl-C, but returns
        raise KeyboardInterrupt
    statistics = solver.stats()
    end = np.asarray(result["x"], dtype=float).ravel()
    if not all_finite(end):
        end = x
    path = np.array([x, *recorder.path]) if recorder is not None else None
    end = np.clip(end, nlp.x_low, nlp.x_high)
    return Attempt(end, int(statistics["iter_count"]), str(statistics["return_status"]), path)
