"""Explicit Runge-Kutta method of order 8 with step size control and dense output, for equations that time does not enter.

The stages of a step are plain formulas: of numbers, or of symbols that are compiled once and then take microseconds a step.

References
----------
E. Hairer, S. P. Norsett, G. Wanner: Solving Ordinary Differential Equations I, 2nd ed. 1993, sections II.4 (first step size),
II.5 (error estimate of orders 5 and 3 combined) and II.6 (dense output). The coefficients are those of their code DOP853.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from optlink.dynamics.dop853 import ALL, COEFFICIENTS
from optlink.linkage.vector2d import Array

RELATIVE, ABSOLUTE = 1e-11, 1e-12  # tolerances
STAGES = 12  # stages of a step
SAFETY, LEAST, MOST = 0.9, 0.2, 10.0  # of the change of the step size
EXPONENT = -1.0 / 8.0
PLACES = 16  # of each step, the last one its end, from which the speed over a turn is measured


class TrialStep(NamedTuple):
    """A step: the new state, the rates at all stages, and the squares of its errors of orders 5 and 3 over their tolerances."""

    state: Any
    rates: Any
    fifth: Any
    third: Any


def attempt(rates: Callable[[Any], Any], stack: Callable[[list[Any]], Any], state: Any, first: Any, size: Any) -> TrialStep:
    """Take one step of a size [s], of numbers or symbols, from a state and the rates `first` at it, columns (n,).

    `rates` maps a state to its rates; `stack` maps a list of rates to a matrix with these columns.
    """
    stages, new = [first], state

    def combined(row: Array) -> Any:
        used = np.flatnonzero(row)
        return stack([stages[k] for k in used]) @ row[used]

    for stage in range(1, ALL):
        at = state + size * combined(COEFFICIENTS.stages[stage])
        stages.append(rates(at))
        if stage == STAGES:
            new = at
    scale = ABSOLUTE + RELATIVE * np.maximum(np.abs(state), np.abs(new))
    fifth, third = (combined(row) / scale for row in (COEFFICIENTS.fifth, COEFFICIENTS.third))
    return TrialStep(new, stages, fifth.T @ fifth, third.T @ third)


class Step(NamedTuple):
    """An accepted step: its start, end and size [s], the states (n,) at both ends, and the rates (16, n) at all stages."""

    time: float
    end: float
    size: float
    before: Array
    after: Array
    rates: Array

    def at(self, time: float, part: int) -> float:
        """Return the element number `part` of the state at a time [s] within the step."""
        parts = (self.before[None, [part]], self.after[None, [part]], self.rates[None, :, [part]])
        return float(dense(np.array([(time - self.time) / self.size]), np.array([self.size]), *parts)[0, 0])


def dense(shares: Array, sizes: Array, before: Array, after: Array, rates: Array) -> Array:
    """Return the states within steps, from the dense output of order 7.

    `shares` (m,), 0 to 1, are the places within the steps of `sizes` (m,) [s]; `before` and `after` (m, n) the states at their
    ends and `rates` (m, 16, n) those at all stages.
    """
    over, first, last = after - before, sizes[:, None] * rates[:, 0], sizes[:, None] * rates[:, STAGES]
    upper = sizes[:, None, None] * (COEFFICIENTS.dense @ rates)
    parts = [over, first - over, 2.0 * over - last - first, *np.moveaxis(upper, 1, 0)]
    state, x = np.zeros_like(before), shares[:, None]
    for k, part in enumerate(reversed(parts)):
        state = (state + part) * (1.0 - x if k % 2 else x)
    return before + state


def states_at(times: Array, steps: Sequence[Step]) -> Array:
    """Return the states (m, n) at rising times (m,) [s] within consecutive steps."""
    starts = np.array([step.time for step in steps])
    places = np.clip(np.searchsorted(starts, times, side="left") - 1, 0, len(steps) - 1)
    chosen = [steps[k] for k in places]
    sizes = np.array([step.size for step in chosen])
    before, after, rates = (np.array([step[k] for step in chosen]) for k in (3, 4, 5))
    return dense((times - starts[places]) / sizes, sizes, before, after, rates)


def between(steps: Sequence[Step], until: float, parts: int) -> tuple[Array, Array]:
    """Return times (m,) at even places within consecutive steps, and the first `parts` elements of the state (m, parts) there.

    The last step counts as ended at `until` [s].
    """
    starts, sizes = (np.array([step[k] for step in steps]) for k in (0, 2))
    durations = np.array([min(step.end, until) for step in steps]) - starts
    shares = ((durations / sizes)[:, None] * np.arange(1.0, PLACES + 1.0) / PLACES).ravel()
    states = [(step.before[:parts], step.after[:parts], step.rates[:, :parts]) for step in steps]
    before, after, rates = (np.array(column).repeat(PLACES, axis=0) for column in zip(*states, strict=True))
    sizes = sizes.repeat(PLACES)
    return starts.repeat(PLACES) + shares * sizes, dense(shares, sizes, before, after, rates)


class Stepper:
    """Integration from a state (n,) and its rates on, one accepted step at a time, from `time` to `end` [s].

    `attempt` maps a state, its rates and a step size to a `TrialStep`.
    """

    def __init__(
        self,
        rates: Callable[[Array], Array],
        attempt: Callable[[Array, Array, float], TrialStep],
        time: float,
        end: float,
        state: Array,
        first: Array,
    ) -> None:
        self.attempt, self.time, self.end, self.state, self.rates = attempt, time, end, state, first
        self.size = _first_size(rates, state, first, end - time)

    def step(self) -> Step | None:
        """Return the next step that meets the tolerances; None if no step size of the number format does."""
        time, least = self.time, 10.0 * math.ulp(self.time)
        size, rejected = max(self.size, least), False
        while size >= least:
            after = min(time + size, self.end)
            size = after - time
            new, rates, fifth, third = self.attempt(self.state, self.rates, size)
            total = fifth + 0.01 * third
            error = 0.0 if total == 0.0 else size * fifth / math.sqrt(total * len(self.state))
            if error < 1.0:
                factor = MOST if error == 0.0 else min(MOST, SAFETY * error**EXPONENT)
                self.size = size * (min(1.0, factor) if rejected else factor)
                done = Step(time, after, size, self.state, new, rates)
                self.time, self.state, self.rates = after, new, rates[STAGES]
                return done
            rejected = True
            size *= max(LEAST, SAFETY * error**EXPONENT)  # the least where the error is no number
        return None


def _first_size(rates: Callable[[Array], Array], state: Array, first: Array, span: float) -> float:
    """Return a first step size from the rates at the start and after a short explicit step."""
    scale = ABSOLUTE + RELATIVE * np.abs(state)

    def norm(values: Array) -> float:
        return float(np.linalg.norm(values / scale)) / math.sqrt(len(state))

    sizes = norm(state), norm(first)
    if math.isinf(sizes[1]):  # no step size would do
        return 0.0
    short = min(1e-6 if min(sizes) < 1e-5 else 0.01 * sizes[0] / sizes[1], span)
    bend = norm(rates(state + short * first) - first) / short
    flat = sizes[1] <= 1e-15 and bend <= 1e-15
    size = max(1e-6, 1e-3 * short) if flat else (0.01 / max(sizes[1], bend)) ** -EXPONENT
    return min(100.0 * short, size, span)
