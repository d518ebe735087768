"""First designs for function synthesis: four-bars from Freudenstein fits and convex programmes.

Every pair of start positions gets the linkage that fits a loop equation linear in three constants (`loop_equations`,
`freudenstein_fit`); the best fits are refined to the least output error of their start position, with an optimality proof
(`freudenstein_convex`).

References
----------
F. Freudenstein, Approximate synthesis of four-bar linkages, Trans. ASME 77 (1955) 853-861.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optlink.synthesis.freudenstein_convex import PROVEN_GAP, Refinement
from optlink.synthesis.freudenstein_fit import Cells, FitProblem, Keep, distinct_cells, fit, scan, step_of, zoom
from optlink.synthesis.loop_equations import EXACT, LoopEquation, linear_form

UNLIMITED = (1e-3, 1e3)  # ratios beyond a thousand are not practical
START_SEPARATION = 3.0  # least distance of two distinct start positions, in grid steps
SPARE = 2  # `SPARE * count` start positions are refined, as some coincide afterwards


@dataclass(frozen=True)
class FirstStep:
    """A four-bar with lengths relative to the frame and start angles [rad].

    `side`: assembly mode. `residual`: of the loop equation at the target positions. `error`: of the output [rad], in closed
    form. Both are the largest value, or (for both other measures) the root mean square. `bound`: lower bound of the error for
    this start position, assembly mode and range of ratios [rad]: for "max" of the output error itself, otherwise of its
    linearised model about this linkage. Recomputed from the multipliers; zero without a proof, for example where `keep` or the
    coupler ratio, which are not convex, restrict the linkage. `proven`: whether `error` is within a share `PROVEN_GAP` of
    `bound`, or zero. `status`: solver status; "closed form" where no solver was needed, "no answer" where it failed.
    """

    side: int
    residual: float
    error: float
    bound: float
    proven: bool
    status: str
    crank: float
    coupler: float
    rocker: float
    phi0: float
    psi0: float

    @property
    def gap(self) -> float:
        """Difference of `error` and its lower bound [rad]."""
        return self.error - self.bound


def _wrapped(angle: float) -> float:
    """Wrap an angle to (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


def first_steps(
    phi: ArrayLike,
    psi: ArrayLike,
    phi0: ArrayLike,
    psi0: ArrayLike,
    measure: str = "max",
    ratios: tuple[float, float] = UNLIMITED,
    count: int = 5,
    *,
    shift: bool = True,
    keep: Keep | None = None,
) -> list[FirstStep]:
    """Return four-bars whose rocker turns by psi while the crank turns by phi, as closely as possible: starting points of an NLP.

    Parameters
    ----------
    phi, psi : array (n,) [rad]
        Target rotations of crank and rocker from their starts: three different ones of the crank at least, and the rocker moves.
    phi0, psi0 : float or array (p,), (q,) [rad]
        Start angles to scan; several values form a grid, which is refined around its best points.
    measure : "max", "rms" or "sum of squares"
        Measure of the output error.
    ratios : (low, high) [-]
        Limits of crank, coupler and rocker over the frame.
    count : int
        Largest number of linkages; their starts are at least `START_SEPARATION` grid steps apart or differ in assembly mode.
    shift : bool
        True: a fit with a negative crank or rocker is replaced by the linkage that starts half a turn further; grids over half a
        turn then cover all starts. False: start angles stay within the range of their grid.
    keep : function (crank, coupler, rocker, phi0, psi0, side), all (m,), to (m,) of bool, optional
        Selects the admissible linkages, lengths over the frame. Relax a limit slightly that may be active at the optimum (28 deg
        for a transmission angle of 30 deg): the fit at the nearest start may just violate it.

    Returns
    -------
    list of FirstStep
        By increasing error; empty if no start gives a linkage that keeps its assembly mode over the whole range.
    """
    x, y = np.asarray(phi, dtype=float), np.asarray(psi, dtype=float)
    grids = np.unique(np.asarray(phi0, dtype=float)), np.unique(np.asarray(psi0, dtype=float))
    task = FitProblem(LoopEquation(ratios), x, y, measure == "max", shift, keep)
    cells = scan(task, *grids)
    steps = max(step_of(grids[0]), EXACT), max(step_of(grids[1]), EXACT)
    apart = START_SEPARATION * steps[0], START_SEPARATION * steps[1]
    cells = zoom(task, cells[distinct_cells(task, cells, apart, SPARE * count)], grids)
    cells = cells[distinct_cells(task, cells, steps, count)]
    refine, designs = Refinement(task), []
    for i in range(len(cells.error)):
        cell, bound, status = refine(cells[i])
        a, w = linear_form(task.chain, cell.x0 + task.x, cell.y0 + task.y)
        error = float(cell.error)
        proven = bound >= (1.0 - 2.0 * PROVEN_GAP) * error or error <= EXACT
        step = _step(task, cell, float(task.figure(a @ cell.k - w)), bound, proven, status)
        designs.append((max(error, EXACT), -float(cell.margin), step))
    return [step for *_, step in sorted(designs, key=lambda one: one[:2])]


def fit_pairs(
    phi: ArrayLike,
    psi: ArrayLike,
    phi0: ArrayLike,
    psi0: ArrayLike,
    measure: str = "max",
    ratios: tuple[float, float] = UNLIMITED,
    *,
    shift: bool = True,
    keep: Keep | None = None,
) -> list[FirstStep]:
    """Return the fit at each pair of start angles (m,) that gives an admissible linkage, in their order and without bounds.

    The other arguments are those of `first_steps`.
    """
    x, y = np.asarray(phi, dtype=float), np.asarray(psi, dtype=float)
    task = FitProblem(LoopEquation(ratios), x, y, measure == "max", shift, keep)
    cells = fit(task, np.asarray(phi0, dtype=float), np.asarray(psi0, dtype=float))
    cells = cells[np.isfinite(cells.error)]
    return [_step(task, cells[i], math.nan, 0.0, False, "fit") for i in range(len(cells.error))]


def _step(task: FitProblem, cell: Cells, residual: float, bound: float, proven: bool, status: str) -> FirstStep:
    """Return one cell with what is known of its error; see `FirstStep`."""
    sizes = [float(size) for size in task.chain.sizes(cell.k)]
    start = [_wrapped(float(angle)) if task.shift else float(angle) for angle in (cell.x0, cell.y0)]
    return FirstStep(int(cell.side), residual, float(cell.error), bound, proven, status, *sizes, *start)
