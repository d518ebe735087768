"""Notes on margins that the file leaves at their defaults although these exclude a better optimum."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from optlink.linkage.margins import LEAST_LENGTH_MARGIN, SMALLEST_LENGTH_MARGIN
from optlink.problem.file import ProblemFile
from optlink.solvers.solution import LimitState
from optlink.units import percent

KEY = "length_margin"
MARGIN_NOTE = f"the default {KEY} "
"""Beginning of such a note."""
LEAST_GAIN = 1e-6  # share of the objective; less is none


def margin_notes(
    problem: ProblemFile,
    design: Mapping[str, float],
    limits: Iterable[LimitState],
    objective: float,
    relaxed: Callable[[ProblemFile], float],
) -> tuple[str, ...]:
    """Return a note if the default length margin excludes a better optimum, with its value and gain; empty if it does not.

    `relaxed` returns the objective [SI] of the local optimum near the design in a problem with other margins.
    """
    if KEY in problem.raw.get("limits", {}):
        return ()
    if not any(limit.key == f"limits.{KEY}" and limit.active and limit.multiplier for limit in limits):
        return ()
    loop = problem.spec.four_bar
    assert loop is not None
    gain = objective - relaxed(problem.override({f"limits.{KEY}": SMALLEST_LENGTH_MARGIN}))
    if not gain > LEAST_GAIN * abs(objective):
        return ()
    shown = problem.model.shown_objective(objective)
    length = 1e3 * LEAST_LENGTH_MARGIN * max(loop.lengths(design))
    return (
        f"{MARGIN_NOTE}of {LEAST_LENGTH_MARGIN:g} ({length:.3g} mm), which keeps it from change points, excludes a better "
        f"optimum: limits.{KEY} = {SMALLEST_LENGTH_MARGIN:g} gains {shown.factor * gain:.3g} {shown.unit} "
        f"({percent(gain / abs(objective), 3)})",
    )
