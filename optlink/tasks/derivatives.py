"""`optlink.gradient` and `optlink.hessian`: derivatives of the objective and of the limits of a design problem, by name."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from optlink.errors import InputError, nearest
from optlink.linkage.vector2d import Array, max_magnitude
from optlink.problem.arguments import typed
from optlink.problem.file import AnyProblem, problem_of
from optlink.tasks.programme import Programme, build, cosines, moved_rows, slot_of

OBJECTIVE, LIMITS = "objective", "limits."
ACTIVE = 1e-7  # distance from a bound, as a share of the size of the row, within which a row holds with equality
SAME = 1e-2  # relative difference below which the derivatives of two rows are those of one position
STEPS = 4  # of Newton's method, from crank angles that are near the best ones
NEAR = 1e-2  # rad; largest distance of crank angles of points from those with the least objective
POSITIONS, FINE, ROUNDS = 181, 9, 6  # positions of a motion; then of two of these steps, in five more rounds
STATIONARY = 1e-6  # rad; largest distance of crank angles from those at which a limit has no slope


class _Local:
    """A programme at a design, whose further unknowns (crank angles of events and points, largest values) follow from it.

    Each of them is that with the least objective, subject to the rows that the formulation adds. `moved` (n, free) are the
    derivatives of all unknowns with respect to the design variables, by the implicit function theorem (Fiacco 1983, theorem 2.1).
    """

    def __init__(self, programme: Programme, x: Array) -> None:
        self.programme, self.x, self.values = programme, x, programme.at(x)
        if not self.values.finite:
            message = "the linkage cannot be assembled at every position of this design"
            raise InputError(message, "Check it with optlink.validate", programme.problem.file, "design")
        self.free = np.array([bool(variable.key) for variable in programme.variables])
        self.rows: list[int] = []
        if self._free_angles():
            self._approach()
        self._hold()
        self.jacobian = self.values.jacobian[self.rows]
        self.moved = np.eye(len(x))[:, self.free]
        self.followed = True
        if not np.all(self.free):
            self._follow()

    def _free_angles(self) -> bool:
        """Return whether unknowns minimise the objective alone: crank angles of points, without largest values and events."""
        return not np.all(self.free) and all(row.key for row in self.programme.constraints)

    def _approach(self) -> None:
        """Move crank angles of points, which are near, to those with the least objective, by Newton's method."""
        added, multipliers, start = ~self.free, np.zeros(len(self.programme.constraints)), self.x
        for _ in range(STEPS):
            curvature = self.programme.hessian(self.x, multipliers)[np.ix_(added, added)]
            self.x = self.x.copy()
            self.x[added] -= np.linalg.lstsq(curvature, self.values.gradient[added], rcond=None)[0]
            self.values = self.programme.at(self.x)
        if not max_magnitude(self.x - start) < NEAR:
            message = "this design does not pass all points where it comes nearest to them"
            raise InputError(message, "Give one that follows the points, such as that of a solution", key="design")

    def _hold(self) -> None:
        """Find the rows that the formulation adds and that hold with equality, of several at one position the nearest."""
        low, high, values = self.programme.g_low, self.programme.g_high, self.values
        gap = np.minimum(np.abs(values.g - low), np.abs(values.g - high))
        size = np.maximum(np.abs(values.g), np.max(np.abs(values.jacobian * self.x), axis=1, initial=0.0))
        for k in np.argsort(gap, kind="stable").tolist():
            row, one = values.jacobian[k], self.programme.constraints[k]
            if one.key or gap[k] > ACTIVE * size[k] or not np.any(row[~self.free]):
                continue
            held = values.jacobian[self.rows]
            share, *_ = np.linalg.lstsq(held[:, ~self.free].T, row[~self.free], rcond=None)
            rest = (row - share @ held) * self.x
            if np.linalg.norm(rest[~self.free]) > SAME * np.linalg.norm((row * self.x)[~self.free]):
                self.rows.append(k)
            elif np.linalg.norm(rest) > SAME * np.linalg.norm(row * self.x):
                message = "the objective has a corner at this design, where several positions share its largest value"
                raise InputError(message, "Choose a design beside it", self.programme.problem.file, "design")

    def _follow(self) -> None:
        added, own = self.jacobian[:, ~self.free], self.jacobian[:, self.free]
        hessian = self._hessian(self.values.gradient, 1.0, None)
        count = len(self.rows)
        system = np.block([[hessian[np.ix_(~self.free, ~self.free)], added.T], [added, np.zeros((count, count))]])
        right = np.concatenate([hessian[np.ix_(~self.free, self.free)], own])
        moved, _, rank, _ = np.linalg.lstsq(system, right, rcond=None)
        self.followed = rank == len(system)
        self.moved[~self.free] = -moved[: np.sum(~self.free)]

    def _hessian(self, slopes: Array, factor: float, row: int | None) -> Array:
        """Return the second derivatives (n, n) of the Lagrangian of the objective or of a row with derivatives (n,)."""
        multipliers = np.zeros(len(self.programme.constraints))
        left = slopes[~self.free]
        if len(self.rows):
            multipliers[self.rows] = -np.linalg.lstsq(self.jacobian[:, ~self.free].T, left, rcond=None)[0]
            left = left + self.jacobian[:, ~self.free].T @ multipliers[self.rows]
        curvature = self.programme.hessian(self.x, multipliers, 1.0)[np.ix_(~self.free, ~self.free)]
        away = np.linalg.norm(left) / max(float(np.linalg.norm(curvature)), 1e-300)
        if len(left) and row is not None and len(self.rows) < len(left) and away > STATIONARY:
            message = "there are no second derivatives of this where the crank angles of points follow from the objective"
            raise InputError(message, "Prescribe the crank angles, or take those of the objective", key="of")
        if row is not None:
            multipliers[row] += 1.0
        return self.programme.hessian(self.x, multipliers, factor)

    def row(self, of: str) -> int | None:
        """Return the row of a limit, at several positions the one that is nearest to its bound; None for the objective.

        Raises
        ------
        InputError
            If there is no limit of this name or key, or if several have the key.
        """
        if of in (OBJECTIVE, *self._terms()):
            return None
        own = (f"{LIMITS}{of.replace(' ', '_')}", of)
        rows = [k for k, one in enumerate(self.programme.constraints) if one.key and (one.name == of or one.key in own)]
        rows = rows or self._side(*of.rpartition(".")[::2])
        if not rows:
            known = [OBJECTIVE, *dict.fromkeys(one.name for one in self.programme.constraints if one.key)]
            raise InputError("no such limit", nearest(of, known), self.programme.problem.file, "of", of)
        if len(names := {self.programme.constraints[k].name for k in rows} - {of}) > 1:
            message, remedy = "several limits have this key", f"Give one of {', '.join(sorted(names))}"
            raise InputError(message, remedy, self.programme.problem.file, "of", of)
        return self._nearest(rows)

    def _side(self, key: str, side: str) -> list[int]:
        """Return the rows with a bound of one side, "min" or "max", of a limit by its key; its angles fall as cosines rise."""
        ends, falling = {"min": self.programme.g_low, "max": self.programme.g_high}, cosines(self.programme)
        sides = {"min": ("min", "max"), "max": ("max", "min")}.get(side, ())
        return [
            k
            for k, one in enumerate(self.programme.constraints)
            if one.key == key and sides and math.isfinite(ends[sides[falling[k]]][k])
        ]

    def _nearest(self, rows: Sequence[int]) -> int:
        """Return the row that is nearest to its bound, of a limit over a motion moved to where the limit is nearest to it."""
        programme = self.programme

        def gap(k: int) -> float:
            g = self.values.g[k]
            return float(min(g - programme.g_low[k], programme.g_high[k] - g))

        nearest = min(rows, key=gap)
        slots = [slot_of(programme, k) for k in rows]
        free = {slot for slot in slots if slot is not None} - {slot_of(programme, k) for k in self.rows}
        if not free:
            return nearest
        slot = max(free)
        same, share, grid = [k for k, at in zip(rows, slots, strict=True) if at == slot], 0.0, np.linspace(0.0, 1.0, POSITIONS)
        for _ in range(ROUNDS):
            g = np.array([moved_rows(programme, self.x, slot, share)[same] for share in grid])
            best = int(np.nanargmin(np.min(np.minimum(g - programme.g_low[same], programme.g_high[same] - g), axis=1)))
            share, grid = grid[best], np.linspace(grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)], FINE)
        moved_rows(programme, self.x, slot, share)
        self.values = programme.at(self.x)
        return min((*same, nearest), key=gap)

    def _terms(self) -> tuple[str, ...]:
        """Return the names of the quantity that alone is minimised, as the file and a function of the user have it."""
        model = self.programme.problem.spec
        names = [goal.quantity for goal in model.goals if model.single]
        return (*names, *(name.replace(" ", "_") for name in names))

    def derivatives(self, of: str, *, second: bool) -> tuple[Array, Array]:
        """Return the derivatives (free,) and, if wanted, the second ones (free, free) of the objective or of a limit."""
        row = self.row(of)
        slopes = self.values.gradient if row is None else self.values.jacobian[row]
        if row is not None and not self.followed and np.any(slopes[~self.free]):
            message = "the crank angles of points, on which this limit depends, do not follow from the design"
            raise InputError(message, "Take a limit of the sizes, or the objective", self.programme.problem.file, "of", of)
        gradient = slopes @ self.moved
        hessian = np.zeros((len(gradient), len(gradient)))
        if second:
            hessian = self.moved.T @ self._hessian(slopes, float(row is None), row) @ self.moved
        if row is not None:
            return gradient, hessian
        slope, curvature = self.programme.stated_derivatives(self.x)
        return slope * gradient, slope * hessian + curvature * np.outer(gradient, gradient)


def _at(problem: AnyProblem, design: Mapping[str, float | str]) -> _Local:
    programme = build(problem_of(problem))
    programme = programme.at_peaks(programme.x_of(design))
    return _Local(programme, programme.x_of(design))


@typed
def gradient(problem: AnyProblem, design: Mapping[str, float | str], of: str = OBJECTIVE) -> dict[str, float]:
    """Return the exact derivatives of the objective or of a limit with respect to the design variables.

    Unknowns that follow from a design, such as the crank angle at which a stroke ends, move with it.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        As in `optlink.build`.
    design : mapping of str to float [SI] or str
        Value of every design variable, for example `result.design`.
    of : str
        "objective", as `optlink.solve` states it; or the name of a limit, or its key if no other has it, as
        `optlink.build(problem).constraints` has them, also with its side: "limits.transmission_angle.min". An own function
        has its name in Python. A limit over a motion counts where it is nearest to its bound. That of a transmission angle is
        its cosine; of a problem without targets, such as a machine, the angle [rad].

    Returns
    -------
    dict of str to float
        Derivative by design variable, SI per SI.

    Raises
    ------
    InputError
        As `optlink.build`; and if the linkage cannot be assembled, if there is no such limit or more than one, or if the
        objective has a corner at the design: several positions that share its largest value.

    Examples
    --------
    >>> slopes = optlink.gradient("crank-rocker", {"coupler": 0.412865, "rocker": 0.232246})  # [m]
    >>> {name: round(slope, 3) for name, slope in slopes.items()}  # [rad^2/m]
    {'coupler': 0.071, 'rocker': 0.065}
    """
    local = _at(problem, design)
    values, _ = local.derivatives(of, second=False)
    return dict(zip(_names(local), values.tolist(), strict=True))


@typed
def hessian(problem: AnyProblem, design: Mapping[str, float | str], of: str = OBJECTIVE) -> dict[str, dict[str, float]]:
    """Return the exact second derivatives of the objective or of a limit with respect to the design variables.

    A largest value over the positions is taken at the position where it is, which does not move with the design.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        As in `optlink.build`.
    design : mapping of str to float [SI] or str
        Value of every design variable.
    of : str
        As in `optlink.gradient`.

    Returns
    -------
    dict of str to dict of str to float
        Second derivative by two design variables [SI].

    Raises
    ------
    InputError
        As `optlink.gradient`; and for limits of points whose crank angles follow from the objective.

    Examples
    --------
    >>> curvature = optlink.hessian("crank-rocker", {"coupler": 0.412865, "rocker": 0.232246})  # [m]
    >>> round(curvature["coupler"]["rocker"], 2)  # [rad^2/m^2]
    10.62
    """
    local = _at(problem, design)
    _, values = local.derivatives(of, second=True)
    names = _names(local)
    return {name: dict(zip(names, row, strict=True)) for name, row in zip(names, values.tolist(), strict=True)}


def _names(local: _Local) -> list[str]:
    return [variable.name for variable in local.programme.variables if variable.key]
