"""Objective and limits of a problem over boxes of designs: the formulas of the NLP, evaluated with Taylor models.

Limits that cannot be evaluated over a box are left out, and limits at every crank angle apply at some of them only. So every
feasible design is feasible here too, and a lower bound of the objective here holds there.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from optlink.errors import Fault, InputError
from optlink.linkage.fourbar import transmission_cosine
from optlink.linkage.margins import FIXED_LIMIT_TOLERANCE
from optlink.linkage.vector2d import TURN, Array, unit
from optlink.optimization.constraints import TERMS, ConstraintRow, position_rows
from optlink.optimization.objectives import output_error
from optlink.optimization.taylor_model import TaylorModel, pairs
from optlink.problem.design import DesignProblem
from optlink.problem.file import ProblemFile
from optlink.problem.limits import Reach
from optlink.problem.requirements.base import START, StartPosition, at_positions
from optlink.problem.targets.law import Law

GRID = 36  # crank angles at which limits of single positions apply
TRIALS = 6.0 * (np.outer((0.7548776662466927, 0.5698402909980532), np.arange(1, 17)) % 1.0) - 3.0
"""Start positions [rad] at which the period of a law is tested: the R2 sequence, without loading a random generator."""


@dataclass(frozen=True)
class BoxModels:
    """Objective and limits over a batch of boxes.

    `residuals` (boxes, positions, components); `slacks` (boxes, limits), not negative for a feasible design; `periodic`: the
    residuals are angles [rad] of which the nearest multiple of a full turn is subtracted.
    """

    residuals: TaylorModel
    slacks: TaylorModel
    periodic: bool = False


@dataclass
class DesignBoxes:
    """A motion law, function, timed path or transmission problem (see `box_problem`) over boxes of its design variables [SI].

    `low` and `high` (n,) are the bounds of the design variables; `limits` names the limit of every slack, once evaluated.
    """

    problem: DesignProblem
    further: Array = field(default_factory=lambda: np.zeros(0))
    """Crank rotations [rad] from the start of a law at which its error counts too, those of the peaks of a largest error."""
    low: Array = field(init=False)
    high: Array = field(init=False)
    limits: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        bounds = [self.problem.quantities[name].bounds for name in self.problem.free]
        self.low, self.high = np.array(bounds, dtype=float).reshape(-1, 2).T.copy()

    @property
    def law(self) -> Law:
        """The law at all positions."""
        return Law(self.problem.law.source, np.concatenate([self.problem.law.offsets, self.further]))

    @property
    def measure(self) -> str:
        """Measure of the residuals: "sum of squares", "rms" or "max"."""
        return self.problem.measure

    def over(self, low: Array, high: Array) -> BoxModels:
        """Return the models over boxes with corners (boxes, n) [SI]."""
        values: dict[str, Any] = dict(zip(self.problem.free, TaylorModel.unknowns(low, high), strict=True))
        with np.errstate(all="ignore"):
            values = self.problem.complete(values)
            if self.problem.task == "function":
                residuals, rows = _function(self.problem, self.law, values, low.shape[1])
            else:
                law = self.law if self.problem.law_given else None
                residuals, rows = _timed(self.problem, law, values, low.shape[1])
        labelled: list[tuple[str, TaylorModel]] = []
        count = low.shape[1]
        for row in rows:
            for bound, sign in ((row.low, 1.0), (row.high, -1.0)):
                slack = sign * (row.value - bound) if np.isfinite(bound) else np.inf
                if not isinstance(slack, TaylorModel) or slack.remainder.ndim < 2:  # no design changes it
                    least = np.min(slack.high if isinstance(slack, TaylorModel) else slack)
                    slack = TaylorModel.constant(least, count) if least < -FIXED_LIMIT_TOLERANCE else None
                if slack is not None:
                    labelled += [(row.limit, column) for column in _columns(slack)]
        self.limits = tuple(limit for limit, _ in labelled)
        slacks = _joined([column for _, column in labelled], (len(low),), count)
        return BoxModels(residuals, slacks, periodic=self.problem.unit == "rad")


def box_problem(problem: ProblemFile, further: Array | None = None) -> DesignBoxes:
    """Return a problem with definite assembly modes in the form in which it can be bounded over boxes.

    `further`: see `DesignBoxes`.

    Raises
    ------
    InputError
        If no lower bound is available for this kind of problem.
    """
    if not problem.model.parts:
        reason = "only motion laws, functions, timed paths and transmission problems have one"
    elif (model := problem.spec).composed:
        reason = "only the deviations of one requirement alone have one"
    elif model.robust is not None:
        reason = "the objective of a robust design has none"
    elif model.data.offsets is None:
        reason = "the crank angles at the points are unknowns too"
    elif model.limits.regions:
        reason = "with limits of regions there is none"
    elif model.slides and "." in model.output:
        reason = "among laws, those of a coordinate of a point have none"
    elif model.requirement.kind == "transmission" and model.frame_angle is None:
        reason = "among transmission problems, only those of four-bars with a fixed direction of the frame have one"
    else:
        return DesignBoxes(model, np.zeros(0) if further is None else further)
    raise InputError(Fault(f"no certificate of the global optimum: {reason}", "Leave --certify out", problem.file, "--certify"))


Evaluated = tuple[TaylorModel, list[ConstraintRow]]


def _function(problem: DesignProblem, law: Law, values: dict[str, Any], count: int) -> Evaluated:
    """Return the residuals (boxes, positions, 1) and the limits of a function synthesis problem."""
    start = problem.start_position(values)
    residuals = output_error(
        problem, values, start, TaylorModel.constant(law.offsets, count), TaylorModel.constant(law.tabulated, count)
    )
    if not _has_period(problem):
        residuals = _where_principal(residuals, start)
    return residuals[..., None], _limits(problem, values, Reach(start.phi0, problem.span, problem.sense))


def _has_period(problem: DesignProblem) -> bool:
    """Return whether start angles that differ by a full turn prescribe the same law; the models of angles are continuous."""
    phi0, psi0 = TRIALS[:, :, None]
    law = problem.law
    with np.errstate(all="ignore"):
        shifts = [law.target(law.offsets, law.tabulated, phi0 + a, psi0 + b) for a, b in ((0.0, 0.0), (TURN, 0.0), (0.0, TURN))]
        gaps = [np.abs(np.exp(1j * shifted) - np.exp(1j * shifts[0])) for shifted in shifts[1:]]
    free = "phi0" in problem.quantities, "psi0" in problem.quantities
    return all(is_free or bool(np.nanmax(gap, initial=0.0) < 1e-9) for is_free, gap in zip(free, gaps, strict=True))


def _where_principal(residuals: TaylorModel, start: StartPosition) -> TaylorModel:
    """Return the residuals, unknown in boxes in which an angle of the start position passes half a turn."""
    unknown = np.zeros(residuals.remainder.shape, dtype=bool)
    for angle in (start.phi0, start.psi0):
        if isinstance(angle, TaylorModel):
            unknown |= (angle.high > np.pi) | (angle.low < -np.pi)
    return TaylorModel(residuals.coefficients, np.where(unknown, np.inf, residuals.remainder), residuals.count)


def _known_within(model: TaylorModel, most: float) -> TaylorModel:
    """Return a model that is undefined in boxes in which its magnitude may exceed `most`."""
    beyond = ~((model.high < most) & (model.low > -most))
    return TaylorModel(model.coefficients, np.where(beyond, np.inf, model.remainder), model.count)


def _timed(problem: DesignProblem, law: Law | None, values: dict[str, Any], count: int) -> Evaluated:
    """Return the residuals (boxes, positions, components) and the limits of a problem with prescribed crank angles."""
    data = problem.data if law is None else at_positions(np.column_stack([law.offsets, law.tabulated]), law.offsets)
    assert data.offsets is not None
    start = values[START] if problem.timing == "from start" else TaylorModel.constant(0.0, count)
    pose = problem.linkage.pose(values, unit(start + TaylorModel.constant(data.offsets, count)))
    if problem.requirement.kind == "transmission":  # rational in the lengths, so known where the linkage cannot be assembled too
        assert problem.four_bar is not None
        ends = np.cos(data.offsets - data.offsets[0])
        cosines = [transmission_cosine(*problem.four_bar.lengths(values), TaylorModel.constant(ends, count))]
    else:
        cosines = problem.deviation(pose, values, tuple(TaylorModel.constant(column, count) for column in data.columns.T))
        if problem.requirement.kind == "motion":  # the models of angles are continuous, and may pass half a turn
            cosines[2] = _known_within(cosines[2], problem.radian * np.pi)
    shape = next(iter(values[name] for name in problem.free)).remainder.shape[0], len(data.offsets)
    residuals = _joined(cosines, shape, count) * data.roots[:, None]
    assert problem.data.offsets is not None
    span = float(problem.data.offsets[-1] - problem.data.offsets[0])
    sense = 1 if span >= 0.0 else -1
    rows = _limits(problem, values, Reach(start + float(data.offsets[0]), span, sense))
    if not problem.four_bar:
        turns = problem.limits.crank != "span"
        over_span = position_rows(problem, pose)
        whole = over_span
        if turns:
            angles = TaylorModel.constant(np.linspace(0.0, TURN, GRID, endpoint=False), count)
            whole = position_rows(problem, problem.linkage.pose(values, unit(angles)))
        rows += [span_row if span_row.over_span else row for row, span_row in zip(whole, over_span, strict=True)]
    if np.any(np.isfinite(data.tolerances)):
        distance = (residuals[..., :2] * residuals[..., :2]).sum()
        limited = np.isfinite(data.tolerances)
        most = np.where(limited, data.tolerances, 0.0) * data.roots
        slack = (TaylorModel.constant(most * most, count) - distance)[:, limited]
        rows.append(ConstraintRow("requirement.points", "tolerance", slack, 0.0, np.inf, None))  # type: ignore[arg-type]
    return residuals, rows


def _limits(problem: DesignProblem, values: dict[str, Any], reach: Reach) -> list[ConstraintRow]:
    """Return the limits that can be evaluated with Taylor models."""
    rows: list[ConstraintRow] = []
    for term in TERMS:
        with contextlib.suppress(TypeError):  # an operation without a rule: the remaining limits of this term are left out
            rows.extend(term(problem, values, reach, 1.0))
    return rows


def _columns(model: TaylorModel) -> list[TaylorModel]:
    """Return a quantity over boxes as models (boxes,), one for each of its positions."""
    if model.remainder.ndim < 2:
        return [model]
    return [model[..., k] for k in range(model.remainder.shape[-1])]


def _joined(models: list[TaylorModel], shape: tuple[int, ...], count: int) -> TaylorModel:
    """Return models of `count` unknowns that broadcast to a shape as one, along a new last axis."""
    coefficients = np.zeros((1 + count + len(pairs(count)), *shape, len(models)))
    remainder = np.zeros((*shape, len(models)))
    for k, model in enumerate(models):
        coefficients[: len(model.coefficients), ..., k] = np.broadcast_to(model.coefficients, (len(model.coefficients), *shape))
        remainder[..., k] = model.remainder
    return TaylorModel(coefficients, remainder, count)
