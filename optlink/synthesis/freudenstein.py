"""First steps of function generation: four-bars and slider-cranks that follow a function, by fits and convex programmes.

Every pair of start positions gets the linkage that fits a loop equation which is linear in three constants (`loops`,
`first_fits`); the best are bettered to the least output error of their start position, with a proof (`first_optima`).

Source: F. Freudenstein, Approximate synthesis of four-bar linkages, Trans. ASME 77 (1955) 853-861.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.synthesis.freudenstein_convex import CLOSE, Refinement
from optlink.synthesis.freudenstein_fit import Cells, Keep, Task, apart, fit, scan, step_of, zoom
from optlink.synthesis.loop_equations import EXACT, linear, rocker_chain, slider_chain

Array = NDArray[np.float64]

MEASURES = ("sum of squares", "rms", "max")
UNLIMITED = (1e-3, 1e3)  # a link a thousand times as long as the frame is no link
APART = 3.0  # grid steps between two start positions that count as different
SPARE = 2  # so many times `count` start positions are zoomed in on, as some meet
ANYWHERE = (-math.inf, math.inf)


@dataclass(frozen=True)
class Step:
    """What every first step has.

    `side`: assembly mode. `residual`: of the loop equation at the wanted positions [-, or square of the unit of s]. `error`: of
    the output [rad, or unit of s], by the closed form. Both are the largest, or (for both other measures) the root mean square.
    `bound`: what no linkage of this start position, mode and range of ratios can undercut, in the unit of `error`: for "max" the
    output error itself; else that of its linearised model about this linkage. Recomputed from the multipliers; zero where nothing
    is proven, as where `keep` or the coupler's ratio, which are not convex, hold the linkage back.
    `proven`: whether `error` is within a share `CLOSE` of `bound`, or no error at all.
    `status`: what the solver said; "closed form" where none was needed, "no answer" where it broke down.
    """

    side: int
    residual: float
    error: float
    bound: float
    proven: bool
    status: str

    @property
    def gap(self) -> float:
        """How far below `error` the convex programme's optimum could still lie, in its unit."""
        return self.error - self.bound


@dataclass(frozen=True)
class FirstStep(Step):
    """A four-bar, its lengths over the frame, and where it starts [rad]."""

    crank: float
    coupler: float
    rocker: float
    phi0: float
    psi0: float


@dataclass(frozen=True)
class FirstStepSlider(Step):
    """An offset slider-crank, its lengths in the unit of s; phi0 [rad] from the guide's direction, s0 from the crank pivot."""

    crank: float
    coupler: float
    offset: float
    phi0: float
    s0: float


def _search(task: Task, x0: Array, y0: Array, count: int) -> list[tuple[Cells, dict[str, Any]]]:
    """The best linkages that lie apart, each a cell without dimension and the fields of its `Step`; least error first."""
    cells = scan(task, x0, y0)
    steps = max(step_of(x0), EXACT), max(step_of(y0), EXACT * task.unit)
    cells = zoom(task, cells[apart(task, cells, (APART * steps[0], APART * steps[1]), SPARE * count)], (x0, y0))
    cells = cells[apart(task, cells, steps, count)]
    refine, found = Refinement(task), []
    for i in range(len(cells.error)):
        cell, bound, status = refine(cells[i])
        a, w = linear(task.chain, cell.x0 + task.x, cell.y0 + task.y)
        error = float(cell.error)
        own: dict[str, Any] = {
            "side": int(cell.side),
            "residual": float(task.figure(a @ cell.k - w)),
            "error": error,
            "bound": bound,
            "proven": bound >= (1.0 - 2.0 * CLOSE) * error or error <= EXACT * task.unit,
            "status": status,
        }
        found.append((cell, own))
    return sorted(found, key=lambda one: (max(float(one[0].error), EXACT * task.unit), -float(one[0].margin)))


def _read(
    x: ArrayLike, y: ArrayLike, what: str, measure: str, ratios: tuple[float, float] | None, count: int
) -> tuple[Array, Array]:
    """The wanted rotations and outputs, checked."""
    one, other = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if one.ndim != 1 or one.shape != other.shape:
        raise ValueError(f"phi and {what} are two lists of the same length, not of shapes {one.shape} and {other.shape}")
    if not (np.all(np.isfinite(one)) and np.all(np.isfinite(other))):
        raise ValueError(f"phi and {what} must be finite")
    if np.unique(one).size < 3:
        raise ValueError("three positions at least, at different phi: fewer do not determine the three constants")
    if np.ptp(other) == 0.0:
        raise ValueError(f"{what} is constant: an output that does not move needs no linkage")
    if measure not in MEASURES:
        raise ValueError(f"measure is one of {', '.join(MEASURES)}, not {measure!r}")
    if ratios is not None and not 0.0 < ratios[0] < ratios[1] < math.inf:
        raise ValueError(f"ratios are two positive numbers, the lower one first, not {ratios}")
    if count < 1:
        raise ValueError(f"count is 1 or more, not {count}")
    return one, other


def _grid(values: ArrayLike, what: str) -> Array:
    grid = np.unique(np.asarray(values, dtype=float))
    if grid.size == 0 or not np.all(np.isfinite(grid)):
        raise ValueError(f"{what} must be one or more finite numbers")
    return grid


def _range(grid: Array) -> tuple[float, float]:
    return float(grid[0]), float(grid[-1])


def _wrapped(angle: float) -> float:
    """The same direction in (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


def first_steps(
    phi: ArrayLike,
    psi: ArrayLike,
    phi0: ArrayLike,
    psi0: ArrayLike,
    measure: str = "max",
    ratios: tuple[float, float] | None = None,
    count: int = 5,
    *,
    shift: bool = True,
    keep: Keep | None = None,
) -> list[FirstStep]:
    """Four-bars whose rocker turns by psi while the crank turns by phi, as nearly as they can: starts for a design programme.

    Parameters
    ----------
    phi, psi : (n,) [rad]
        Wanted rotations of crank and rocker, counted from their starts; n >= 3.
    phi0, psi0 : float or (p,), (q,) [rad]
        Starts to be scanned; several make a grid, between whose points the search goes on.
    measure : "max", "rms" or "sum of squares"
        Of the output error.
    ratios : (low, high), optional [-]
        Limits of crank, coupler and rocker over the frame; left out: `UNLIMITED`.
    count : int
        So many linkages at most, their starts at least `APART` grid steps apart or on different modes.
    shift : bool
        True: a fit with a negative crank or rocker is one that starts half a turn further; grids over half a turn then cover all
        starts. False: starts are meant as they are given, none leaves the range of its grid.
    keep : function (crank, coupler, rocker, phi0, psi0, side), all (m,), to (m,) of bool, optional
        Which linkages are wanted, lengths over the frame. A limit that the best design lies upon should be a little wider here
        (28 deg for a transmission angle of 30 deg): the fit at the nearest start may just miss it.

    Returns
    -------
    list of FirstStep, least error first; empty where no start gives a linkage that stays on its mode over the whole range

    Raises
    ------
    ValueError
        when there are fewer than three positions, psi is constant, something is not finite, or an option is out of range.
    """
    x, y = _read(phi, psi, "psi", measure, ratios, count)
    grids = _grid(phi0, "phi0"), _grid(psi0, "psi0")
    ranges = (ANYWHERE, ANYWHERE) if shift else (_range(grids[0]), _range(grids[1]))
    task = Task(rocker_chain(ratios or UNLIMITED), x, y, measure == "max", 1.0, shift, keep, *ranges)
    return [_step(task, cell, own) for cell, own in _search(task, *grids, count)]


def fitted(
    phi: ArrayLike,
    psi: ArrayLike,
    phi0: ArrayLike,
    psi0: ArrayLike,
    measure: str = "max",
    ratios: tuple[float, float] | None = None,
    *,
    shift: bool = True,
    keep: Keep | None = None,
) -> list[FirstStep]:
    """The fit at each pair of start angles (phi0, psi0), (m,) each, that gives a linkage; in their order, nothing proven.

    Parameters and errors as of `first_steps`.
    """
    x, y = _read(phi, psi, "psi", measure, ratios, 1)
    task = Task(rocker_chain(ratios or UNLIMITED), x, y, measure == "max", 1.0, shift, keep, ANYWHERE, ANYWHERE)
    cells = fit(task, np.asarray(phi0, dtype=float), np.asarray(psi0, dtype=float))
    cells = cells[np.isfinite(cells.error)]
    own = {"residual": math.nan, "bound": 0.0, "proven": False, "status": "fit"}
    return [
        _step(task, cells[i], own | {"side": int(cells.side[i]), "error": float(cells.error[i])}) for i in range(len(cells.error))
    ]


def _step(task: Task, cell: Cells, own: dict[str, Any]) -> FirstStep:
    crank, coupler, rocker = (float(size) for size in task.chain.sizes(cell.k))
    start = [_wrapped(float(angle)) if task.shift else float(angle) for angle in (cell.x0, cell.y0)]
    return FirstStep(**own, crank=crank, coupler=coupler, rocker=rocker, phi0=start[0], psi0=start[1])


def first_steps_slider(
    phi: ArrayLike,
    s: ArrayLike,
    phi0: ArrayLike,
    s0: ArrayLike,
    measure: str = "max",
    ratios: tuple[float, float] | None = None,
    count: int = 5,
    *,
    shift: bool = True,
    keep: Keep | None = None,
) -> list[FirstStepSlider]:
    """Slider-cranks whose slider moves by s while the crank turns by phi, as nearly as they can.

    Parameters
    ----------
    phi, s : (n,) [rad], [any unit of length]
        Wanted rotation of the crank and displacement of the slider along the guide, counted from their starts; n >= 3.
    phi0, s0 : float or (p,), (q,) [rad], [unit of s]
        Starts to be scanned: crank angle from the guide's direction, place of the slider from the crank pivot along the guide. No
        start leaves the range of s0.
    ratios : (low, high), optional [-]
        Limits of crank and coupler over the stroke (largest less least s); the offset's size has the upper one.
    keep : function (crank, coupler, offset, phi0, s0, side), all (m,), to (m,) of bool, optional
    measure, count, shift
        As in `first_steps`.

    Returns
    -------
    list of FirstStepSlider, least error first; empty where no start gives a linkage that stays on its mode over the whole range

    Raises
    ------
    ValueError
        as `first_steps`.
    """
    x, y = _read(phi, s, "s", measure, ratios, count)
    grids = _grid(phi0, "phi0"), _grid(s0, "s0")
    stroke = float(np.ptp(y))
    ranges = ANYWHERE if shift else _range(grids[0]), _range(grids[1])
    task = Task(slider_chain(ratios or UNLIMITED, stroke), x, y, measure == "max", stroke, shift, keep, *ranges)
    steps = []
    for cell, own in _search(task, *grids, count):
        crank, coupler, offset = (float(size) for size in task.chain.sizes(cell.k))
        start = _wrapped(float(cell.x0)) if shift else float(cell.x0)
        steps.append(FirstStepSlider(**own, crank=crank, coupler=coupler, offset=offset, phi0=start, s0=float(cell.y0)))
    return steps
