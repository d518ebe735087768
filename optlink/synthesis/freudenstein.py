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

from optlink.linkage.vector2d import Array
from optlink.synthesis.freudenstein_convex import PROVEN_GAP, Refinement
from optlink.synthesis.freudenstein_fit import Cells, FitProblem, distinct_cells, fit, scan, step_of, zoom
from optlink.synthesis.loop_equations import EXACT, linear_form

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


def first_steps(task: FitProblem, phi0: ArrayLike, psi0: ArrayLike, count: int = 5) -> list[FirstStep]:
    """Return at most `count` four-bars that fit a task as closely as possible, by increasing error: starting points of an NLP.

    Several start angles phi0 (p,) and psi0 (q,) [rad] form a grid, which is refined around its best points. The starts of the
    four-bars are at least `START_SEPARATION` grid steps apart, or they differ in assembly mode. There is none if no start gives a
    four-bar that keeps its assembly mode over the whole range.
    """
    grids = np.unique(phi0), np.unique(psi0)
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


def fit_pairs(task: FitProblem, phi0: Array, psi0: Array) -> list[FirstStep]:
    """Return the fit at each pair of start angles (m,) [rad] that gives an admissible linkage, in order and without bounds."""
    cells = fit(task, phi0, psi0)
    cells = cells[np.isfinite(cells.error)]
    return [_step(task, cells[i], math.nan, 0.0, False, "fit") for i in range(len(cells.error))]


def _step(task: FitProblem, cell: Cells, residual: float, bound: float, proven: bool, status: str) -> FirstStep:
    """Return one cell with what is known of its error; see `FirstStep`."""
    sizes = [float(size) for size in task.chain.sizes(cell.k)]
    start = [_wrapped(float(angle)) if task.shift else float(angle) for angle in (cell.x0, cell.y0)]
    return FirstStep(int(cell.side), residual, float(cell.error), bound, proven, status, *sizes, *start)
