"""Properties of each kind of problem in the studio: one entry of `KINDS` per kind."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from optlink.io import Registry
from optlink.linkage.vector2d import Array
from optlink.optimization.output_derivatives import error_at
from optlink.optimization.programme import solved_values
from optlink.problem.file import WORDS as PROSE, ProblemFile
from optlink.problem.limits import MARGINS
from optlink.problem.machine.model import ShownObjective
from optlink.problem.quantity import Quantity
from optlink.problem.targets.function import Function
from optlink.solvers.solution import Solution
from optlink.studio.follow import CycleFollower, Follower, TargetsFollower
from optlink.units import DISPLAYED
from optlink.validation.design import deviations

CURVE_POSITIONS = 60  # positions of the error curve
STRUCTURAL_LIMITS = ("crank", "transmission_over", *MARGINS)  # limits that change the structure of a programme


class ErrorCurve(NamedTuple):
    """Error of a design over the crank angle [rad], in a display unit."""

    title: str
    crank_angles: Array
    label: str
    unit: str
    values: Array


class Kind:
    """A machine without requirement, which is analysed; base class of the other kinds."""

    slow_programme = False
    """Whether the programme of a follower takes seconds to build."""

    def name(self, model: Any) -> str:
        """Return the name of the kind for the page."""
        return "analysis"

    def result(self, problem: ProblemFile, progress: Callable[[float], None] | None) -> Any:
        """Return the result that the command line finds: the same search, the same validation."""
        from optlink.tasks.analyze import analyze

        return analyze(problem)

    def values(self, model: Any, solution: Solution) -> tuple[dict[str, float], Array | None]:
        """Return all quantities [SI] of a local optimum, and the crank angles of the target points if it determines them."""
        return model.design({name: solution.design[name] for name in model.free}), None

    def objective(self, model: Any, value: float) -> ShownObjective:
        """Return an objective [SI] as it is shown, with its name; no name if there is none."""
        return ShownObjective(value, 1.0, "", "")

    def error_curves(self, model: Any, values: Mapping[str, float], start: float, angles: Array | None) -> Iterator[ErrorCurve]:
        """Yield the error of a design [SI] from its first crank angle [rad] on, if the kind has one.

        `angles` (points,) [rad] are those of the target points, where the values do not determine them.
        """
        yield from ()

    def follower(self, problem: ProblemFile, values: Mapping[str, float], direction: int) -> Follower | None:
        """Return a follower from the last design [SI] and its sense of crank rotation; None if a drag does not optimise."""
        return None

    def fixed_parts(self, model: Any, requirement: Mapping[str, Any]) -> list[Any]:
        """Return the parts of the requirement section that a programme does not have as parameters."""
        return []


class _Balancing(Kind):
    """A machine that is balanced."""

    def result(self, problem: ProblemFile, progress: Callable[[float], None] | None) -> Any:
        from optlink.tasks.balance import balance

        return balance(problem)


class _Searched(Kind):
    """A problem whose design variables are searched; a design without any is validated."""

    def result(self, problem: ProblemFile, progress: Callable[[float], None] | None) -> Any:
        from optlink.tasks.run import solve, validate

        return solve(problem, progress=progress) if problem.model.free else validate(problem, {})


class _Synthesis(_Searched):
    """A requirement on the motion of a linkage."""

    def name(self, model: Any) -> str:
        kind = str(model.requirement.kind)
        return "law" if model.law_given and not isinstance(model.requirement.law, Function) else kind

    def values(self, model: Any, solution: Solution) -> tuple[dict[str, float], Array | None]:
        return solved_values(model, solution.design, solution.x)

    def objective(self, model: Any, value: float) -> ShownObjective:
        shown = model.shown_objective(value)
        if model.by_angle or model.composed:
            return shown  # type: ignore[no-any-return]
        what = "error" if model.law_given else "deviation"
        words = {"max": f"largest {what}", "rms": f"root mean square {what}"}.get(model.measure, f"sum of squared {what}s")
        words += " of the cosines" * (model.requirement.kind == "transmission")
        return shown._replace(unit=shown.unit.replace("^2", "²"), name=words)  # type: ignore[no-any-return]

    def error_curves(self, model: Any, values: Mapping[str, float], start: float, angles: Array | None) -> Iterator[ErrorCurve]:
        part = model.parts[0]
        factor, unit = DISPLAYED[part.unit]
        if part.law_given:
            offsets = part.span * np.linspace(0.0, 1.0, CURVE_POSITIONS + 1)
            with np.errstate(all="ignore"):
                error = factor * error_at(part, part.own(values), offsets)
            yield ErrorCurve("Output error", start + offsets, "target minus generated", unit, error)
        elif part.requirement.kind != "transmission" and angles is not None:
            own = angles[: len(part.data.columns)]
            distances = deviations(part, part.own(values), own).distances
            yield ErrorCurve("Deviation at the points", own, "deviation", unit, factor * distances)

    def follower(self, problem: ProblemFile, values: Mapping[str, float], direction: int) -> Follower | None:
        return TargetsFollower(problem, direction)

    def fixed_parts(self, model: Any, requirement: Mapping[str, Any]) -> list[Any]:
        task, data = model.requirement, model.data
        if model.composed or not model.law_given:
            places = data.columns.shape if model.pointed and not model.composed else data.columns.tolist()
            timing = None if data.offsets is None else data.offsets.tolist()
            rest = {key: value for key, value in requirement.items() if key != "points"}
            return [rest, places, timing, data.roots.tolist(), data.tolerances.tolist()]
        moving = {"span": model.movable_span, "zero": isinstance(task.zero, Quantity)}
        moving |= {**dict.fromkeys(("from", "start"), isinstance(task.start, Quantity)), "psi0": isinstance(task.psi0, Quantity)}
        return [{key: value for key, value in requirement.items() if not moving.get(key)}, model.sense]


class _CycleOptimisation(_Searched):
    slow_programme = True

    def name(self, model: Any) -> str:
        return "machine"

    def objective(self, model: Any, value: float) -> ShownObjective:
        shown = model.shown_objective(value)
        return shown._replace(name=model.goals[0].words) if model.single else shown  # type: ignore[no-any-return]

    def follower(self, problem: ProblemFile, values: Mapping[str, float], direction: int) -> Follower | None:
        return CycleFollower(problem, values)

    def fixed_parts(self, model: Any, requirement: Mapping[str, Any]) -> list[Any]:
        return [_without_numbers(requirement)]


KINDS: Registry[Kind] = Registry()
KINDS |= {"function": _Synthesis(), "path": _Synthesis(), "cycle": _CycleOptimisation(), "balance": _Balancing()}
"""Kinds by the name of the task; all others are analysed."""


def kind_of(problem: ProblemFile) -> Kind:
    """Return the kind of a problem."""
    return KINDS.get(problem.task) or Kind()


def structure(problem: ProblemFile) -> Any:
    """Return the data that determine the structure of a programme; equal for problems that can share one."""
    model, raw = problem.model, problem.raw
    limits = {
        key: repr(value) if key in STRUCTURAL_LIMITS else _without_numbers(value)
        for key, value in (raw.get("limits") or {}).items()
    }
    parts: list[Any] = [
        problem.task,
        tuple(model.quantities),
        tuple(model.free),
        {name: model.quantities[name].equals for name in model.links},
        limits,
        raw["mechanism"].get("assembly"),
    ]
    parts += [{key: value for key, value in raw.items() if key not in ("mechanism", "limits", "requirement", *PROSE)}]
    parts += kind_of(problem).fixed_parts(model, dict(raw.get("requirement") or {}))
    return tuple(map(repr, parts))


def _without_numbers(value: Any) -> Any:
    """Return a value of the file without its numbers."""
    if isinstance(value, Mapping):
        return {key: _without_numbers(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_numbers(item) for item in value]
    return type(value).__name__
