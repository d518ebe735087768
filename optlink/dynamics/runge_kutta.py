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

from optlink.linkage.vector2d import Array

# Coefficients of the explicit Runge-Kutta method of order 8 of Dormand and Prince with dense output of order 7 (DOP853).
#
# Written out because importing them from SciPy takes longer than a simulation.
#
# References
# ---------- E. Hairer, S. P. Norsett, G. Wanner: Solving Ordinary Differential Equations I, 2nd ed. 1993, sections II.5 and
# II.6, and their code DOP853; the digits are those of SciPy (scipy.integrate.DOP853).

ALL = 16  # stages of a step, with its end and those of the dense output

STAGE_WEIGHTS = """
;
    0.05260015195876773;
    0.0197250569845379 0.0591751709536137;
    0.02958758547680685 0 0.08876275643042054;
    0.2413651341592667 0 -0.8845494793282861 0.924834003261792;
    0.037037037037037035 0 0 0.17082860872947386 0.12546768756682242;
    0.037109375 0 0 0.17025221101954405 0.06021653898045596 -0.017578125;
    0.03709200011850479 0 0 0.17038392571223998 0.10726203044637328 -0.015319437748624402 0.008273789163814023;
    0.6241109587160757 0 0 -3.3608926294469414 -0.868219346841726 27.59209969944671 20.154067550477894
    -43.48988418106996;
    0.47766253643826434 0 0 -2.4881146199716677 -0.590290826836843 21.230051448181193 15.279233632882423
    -33.28821096898486 -0.020331201708508627;
    -0.9371424300859873 0 0 5.186372428844064 1.0914373489967295 -8.149787010746927 -18.52006565999696
    22.739487099350505 2.4936055526796523 -3.0467644718982196;
    2.273310147516538 0 0 -10.53449546673725 -2.0008720582248625 -17.9589318631188 27.94888452941996
    -2.8589982771350235 -8.87285693353063 12.360567175794303 0.6433927460157636;
    0.054293734116568765 0 0 0 0 4.450312892752409 1.8915178993145003 -5.801203960010585 0.3111643669578199
    -0.1521609496625161 0.20136540080403034 0.04471061572777259;
    0.056167502283047954 0 0 0 0 0 0.25350021021662483 -0.2462390374708025 -0.12419142326381637 0.15329179827876568
    0.00820105229563469 0.007567897660545699 -0.008298;
    0.03183464816350214 0 0 0 0 0.028300909672366776 0.053541988307438566 -0.05492374857139099 0 0
    -0.00010834732869724932 0.0003825710908356584 -0.00034046500868740456 0.1413124436746325;
    -0.42889630158379194 0 0 0 0 -4.697621415361164 7.683421196062599 4.06898981839711 0.3567271874552811 0 0 0
    -0.0013990241651590145 2.9475147891527724 -9.15095847217987
"""
NODES = """
    0 0.05260015195876773 0.0789002279381516 0.1183503419072274 0.2816496580927726 0.3333333333333333 0.25
    0.3076923076923077 0.6512820512820513 0.6 0.8571428571428571 1.0 1.0 0.1 0.2 0.7777777777777778
"""
ERRORS = """
    0.01312004499419488 0 0 0 0 -1.2251564463762044 -0.4957589496572502 1.6643771824549864 -0.35032884874997366
    0.3341791187130175 0.08192320648511571 -0.022355307863886294 0;
    -0.18980075407240762 0 0 0 0 4.450312892752409 1.8915178993145003 -5.801203960010585 -0.4226823213237919
    -0.1521609496625161 0.20136540080403034 0.02265179219836082 0
"""
DENSE = """
    -8.428938276109013 0 0 0 0 0.5667149535193777 -3.0689499459498917 2.38466765651207 2.117034582445028
    -0.871391583777973 2.2404374302607883 0.6315787787694688 -0.08899033645133331 18.148505520854727
    -9.194632392478356 -4.436036387594894;
    10.427508642579134 0 0 0 0 242.28349177525817 165.20045171727028 -374.5467547226902 -22.113666853125306
    7.733432668472264 -30.674084731089398 -9.332130526430229 15.697238121770845 -31.139403219565178 -9.35292435884448
    35.81684148639408;
    19.985053242002433 0 0 0 0 -387.0373087493518 -189.17813819516758 527.8081592054236 -11.57390253995963
    6.8812326946963 -1.0006050966910838 0.7777137798053443 -2.778205752353508 -60.19669523126412 84.32040550667716
    11.99229113618279;
    -25.69393346270375 0 0 0 0 -154.18974869023643 -231.5293791760455 357.6391179106141 93.40532418362432
    -37.45832313645163 104.0996495089623 29.8402934266605 -43.53345659001114 96.32455395918828 -39.17726167561544
    -149.72683625798564
"""


class Coefficients(NamedTuple):
    """Coefficients of the method.

    `stages` (16, 16): of the stages, row 12 that of the new state, rows 13 to 15 of the dense output; `nodes` (16,): their times;
    `fifth`, `third` (13,): of the errors; `dense` (4, 16): of the dense output.
    """

    stages: Array
    nodes: Array
    fifth: Array
    third: Array
    dense: Array


def _table(text: str, width: int) -> Array:
    """Return the rows of a text, separated by semicolons, filled up with zeros."""
    rows = [row.split() for row in text.split(";")]
    return np.array([[*map(float, row), *[0.0] * (width - len(row))] for row in rows])


_FIFTH, _THIRD = _table(ERRORS, ALL - 3)
COEFFICIENTS = Coefficients(_table(STAGE_WEIGHTS, ALL), _table(NODES, ALL)[0], _FIFTH, _THIRD, _table(DENSE, ALL))


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

    def at(self, time: float) -> Array:
        """Return the state (n,) at a time [s] within the step."""
        state: Array = states_at(np.array([time]), [self])[0]
        return state


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
