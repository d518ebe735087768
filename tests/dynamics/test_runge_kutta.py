"""The integrator against SciPy's code of the same method, and its step in symbols against the same step in numbers."""

from __future__ import annotations

import casadi
import numpy as np
import pytest
from scipy.integrate import DOP853

import optlink
from optlink.dynamics import forward, runge_kutta
from optlink.dynamics.runge_kutta import ABSOLUTE, COEFFICIENTS, RELATIVE, Stepper, attempt, states_at
from optlink.symbolic import CompiledFunction, symbols_in_numpy


def orbit(state):
    """An eccentric orbit about a mass at the origin: the step size changes by a factor of ten."""
    x, y, u, v = state
    cube = (x * x + y * y) ** 1.5
    return np.array([u, v, -x / cube, -y / cube])


def own(end):
    start = np.array([0.2, 0.0, 0.0, 3.0])
    stepper = Stepper(orbit, lambda *at: numbers(orbit, *at), 0.0, end, start, orbit(start))
    steps = []
    while stepper.time < end:
        steps.append(stepper.step())
    return steps


def numbers(rates, *at):
    step = attempt(rates, np.column_stack, *at)
    return step._replace(rates=np.array(step.rates))


def scipys(end):
    solver = DOP853(lambda t, y: orbit(y), 0.0, np.array([0.2, 0.0, 0.0, 3.0]), end, rtol=RELATIVE, atol=ABSOLUTE)
    while solver.status == "running":
        solver.step()
        yield solver.t_old, solver.t, solver.y, solver.dense_output()


def differences(end=7.0):
    """Largest differences between the two codes of step ends and states within steps, and their numbers of steps."""
    steps, theirs = own(end), list(scipys(end))
    middles = np.array([0.3 * step.time + 0.7 * step.end for step in steps])
    inside = states_at(middles, steps)
    computed = [
        (abs(step.end - to), np.max(np.abs(here - curve(middle))))
        for step, (_, to, _, curve), here, middle in zip(steps, theirs, inside, middles, strict=False)
    ]
    return *np.max(computed, axis=0), len(steps), len(theirs)


def test_steps_and_states_are_those_of_scipy():
    ends, states, ours, theirs = differences()
    assert ours == theirs > 100
    assert ends < 1e-6  # the error estimates, and so the step sizes, are differences of nearly equal numbers
    assert states < 1e-11


def test_coefficients_are_those_of_scipy_to_the_last_digit():
    extra = ((0, 0), (0, 4))
    stages = np.vstack([np.pad(DOP853.A, extra), np.pad(DOP853.B[None], extra), DOP853.A_EXTRA])
    known = stages, np.concatenate([DOP853.C, [1.0], DOP853.C_EXTRA]), DOP853.E5, DOP853.E3, DOP853.D
    for ours, theirs in zip(COEFFICIENTS, known, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_wrong_coefficient_of_the_dense_output_is_detected(monkeypatch):
    wrong = COEFFICIENTS._replace(dense=COEFFICIENTS.dense * (1.0 + 1e-4))
    monkeypatch.setattr(runge_kutta, "COEFFICIENTS", wrong)
    assert differences(1.0)[1] > 1e-11


def test_rejected_steps_do_not_end_the_integration_and_states_without_a_value_do():
    def wall(state):
        return np.where(state <= 1.0, 1.0, np.nan)

    start = np.array([0.0])
    stepper = Stepper(wall, lambda *at: numbers(wall, *at), 0.0, 5.0, start, wall(start))
    steps = []
    while (step := stepper.step()) is not None:
        steps.append(step)
    assert 1.0 - 1e-9 < steps[-1].after[0] <= 1.0


@pytest.mark.parametrize("name", ["slider-crank", "six-bar", "whitworth"])
def test_compiled_step_is_the_step_in_numbers(name):
    problem = optlink.load(name)
    plant = forward.EquationsOfMotion(
        problem.model.machine(None), lambda known: 3.0 - 0.1 * known["omega"] + np.sin(known["phi"])
    )
    state = plant.start(0.4, 6.0)
    state[2:] += np.random.default_rng(0).normal(size=len(state) - 2)
    first = plant(state)
    fast = plant.attempt(state, first, 2e-3)
    plain = numbers(lambda y: np.concatenate(plant.placed(forward.flat(plant.rates(*y[:2])), y)), state, first, 2e-3)
    largest = np.max(np.abs(plain.rates), axis=0)
    assert np.all(np.abs(fast.rates - plain.rates) <= 1e-12 * largest + 1e-12)
    np.testing.assert_allclose(fast.state, plain.state, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(fast.fifth, plain.fifth, rtol=1e-3)  # a difference of nearly equal numbers


def test_step_in_symbols_needs_no_machine():
    state, first, size = casadi.SX.sym("state", 4), casadi.SX.sym("first", 4), casadi.SX.sym("size")

    def rates(y):
        cube = (y[0] * y[0] + y[1] * y[1]) ** 1.5
        return casadi.vertcat(y[2], y[3], -y[0] / cube, -y[1] / cube)

    with symbols_in_numpy():
        made = attempt(rates, lambda parts: casadi.horzcat(*parts), state, first, size)
    function = CompiledFunction([state, first, size], [made.state, made.fifth, made.third])
    at = np.array([0.3, 0.4, -1.0, 0.5])
    plain = numbers(orbit, at, orbit(at), 0.05)
    new, fifth, third = function(at, orbit(at), 0.05)
    np.testing.assert_allclose(new, plain.state, rtol=1e-14)
    np.testing.assert_allclose([fifth[0], third[0]], [plain.fifth, plain.third], rtol=1e-6)
