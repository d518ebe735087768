"""One step of an explicit Runge-Kutta method of order 8, with error estimate and dense output of order 7, compiled by numba.

The compiled functions of all modules take these arguments:

=============  ===================================================================================================
`model`        addresses of the compiled functions (x, p, c, o) of a machine, see `machine.py`; their constants c;
               start and speed of the servo reference, and its harmonics
`space`        intermediate arrays and parameters p of a call, see `motion.workspace`
`time`, `h`    time at the start of the step, and its size [s]
`y`, `n`       coordinates, rates and works at the start of the step (m,); the state without the works is the first n
`share`        place within the step, 0 to 1
`parts`        number of the parts of the step at whose ends penetrations are known
=============  ===================================================================================================

The parameters are the feedback correction; angle, speed and acceleration of the reference; the approach speeds of the gaps and
their modes.

References
----------
E. Hairer, S. P. Norsett, G. Wanner: Solving Ordinary Differential Equations I, 2nd ed. 1993, sections II.5 (error estimate of
orders 5 and 3 combined) and II.6 (dense output). The coefficients are those of their code DOP853.
"""

from math import cos, sin, sqrt
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from optlink.dynamics.dop853 import COEFFICIENTS

A, C, E5, E3, D = COEFFICIENTS
STAGES = 12
POWERS = 7  # of the dense output
SAFETY, LEAST, MOST = 0.9, 0.2, 10.0  # of the change of the step size
ABSOLUTE = 1e-3
"""Absolute tolerance as a share of the relative one [SI]."""

RHS, GAPS, WATCH, PROJECT, CONSTANTS, REFERENCE, HARMONICS = range(7)
"""Places in `model`."""

SLOPES, DENSE, NEW, BETWEEN, STATE, NOW, NODES, SPARE, FORCES, FIRST, LAST, SELECTED, PARAMETERS = range(13)
"""Places in `space`."""

ENTRY: Any = {"error_model": "numpy", "_nrt": False}
"""Options of a function that Python calls: no function allocates, so none counts references."""

HELPER: Any = {**ENTRY, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of functions that are called by compiled functions only."""


def _generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    pointer = ir.DoubleType().as_pointer()
    kind = ir.FunctionType(ir.VoidType(), [pointer] * 4)
    arrays = zip(signature.args[1:], values[1:], strict=True)
    data = [context.make_array(each)(context, builder, value).data for each, value in arrays]
    builder.call(builder.inttoptr(values[0], kind.as_pointer()), data)
    return context.get_dummy_value()


@intrinsic  # type: ignore[untyped-decorator, unused-ignore]
def _call(typing: Any, address: Any, x: Any, p: Any, c: Any, o: Any) -> Any:
    """Call the compiled function at an address with the data of four arrays."""
    return types.void(address, x, p, c, o), _generate


call: Any = _call


@njit(**HELPER)
def copy(source, target):
    """Copy one array to another."""
    for i in range(source.shape[0]):
        target[i] = source[i]


@njit(**HELPER)
def servo_reference(time, model, space):
    """Write angle, speed and acceleration of the servo reference to the parameters, as `ReferenceSignal.at` defines them."""
    harmonics, p = model[HARMONICS], space[PARAMETERS]
    start, speed = model[REFERENCE][0], model[REFERENCE][1]
    angle, rate, twice = start + speed * time, speed, 0.0
    base = abs(speed)
    one_c, one_s = cos(base * time), sin(base * time)
    c, s = 1.0, 0.0
    for k in range(harmonics.shape[0]):
        w, re, im = k * base, harmonics[k, 0], harmonics[k, 1]
        along, across = re * c - im * s, re * s + im * c
        angle += along
        rate -= w * across
        twice -= w * w * along
        c, s = c * one_c - s * one_s, s * one_c + c * one_s
    p[1], p[2], p[3] = angle, rate, twice


@njit(**HELPER)
def evaluate(time, x, model, space, slopes):
    """Evaluate the rates of the state and the powers at a time."""
    servo_reference(time, model, space)
    call(model[RHS], x, space[PARAMETERS], model[CONSTANTS], slopes)


@njit(**HELPER)
def penetrations(x, model, space, out):
    """Evaluate the penetrations of the gaps and their rates."""
    call(model[GAPS], x, space[PARAMETERS], model[CONSTANTS], out)


@njit(**HELPER)
def forces(time, x, model, space, out):
    """Evaluate the normal forces of the gaps, their rates, the torque and its rate at a time."""
    servo_reference(time, model, space)
    call(model[WATCH], x, space[PARAMETERS], model[CONSTANTS], out)


@njit(**HELPER)
def project(x, model, space, out):
    """Move a state onto the closing joints, from which it drifts by the error of the integration."""
    call(model[PROJECT], x, space[PARAMETERS], model[CONSTANTS], out)


@njit(**HELPER)
def combine(row, y, h, n, space, out):
    """Add h times the slopes, weighted by a row of the coefficients A, to the first n of a state."""
    slopes = space[SLOPES]
    for i in range(n):
        out[i] = y[i]
    for j in range(row):
        a = A[row, j]
        if a != 0.0:
            a *= h
            for i in range(n):
                out[i] += a * slopes[j, i]


@njit(**HELPER)
def attempt(time, h, y, n, model, space):
    """Take one step from y to the new state: stages 1 to 12, of which stage 0 is known."""
    for s in range(1, STAGES + 1):
        at = space[NEW] if s == STAGES else space[BETWEEN]
        combine(s, y, h, y.shape[0] if s == STAGES else n, space, at)
        evaluate(time + C[s] * h, at, model, space, space[SLOPES][s])


@njit(**HELPER)
def error_of(y, h, tolerance, space):
    """Return the estimated error of a step as a share of the relative tolerance (Hairer et al., II.5, equation 10.17)."""
    new, slopes = space[NEW], space[SLOPES]
    fifth, third = 0.0, 0.0
    for i in range(y.shape[0]):
        e5, e3 = 0.0, 0.0
        for j in range(STAGES + 1):
            e5 += slopes[j, i] * E5[j]
            e3 += slopes[j, i] * E3[j]
        scale = tolerance * (ABSOLUTE + max(abs(y[i]), abs(new[i])))
        fifth += (e5 / scale) ** 2
        third += (e3 / scale) ** 2
    if fifth == 0.0 and third == 0.0:
        return 0.0
    return abs(h) * fifth / sqrt((fifth + 0.01 * third) * y.shape[0])


@njit(**HELPER)
def change_of(error):
    """Return the factor of the next step size."""
    if not error < 1e300:
        return 0.1
    return MOST if error == 0.0 else min(MOST, max(LEAST, SAFETY * error ** (-0.125)))


@njit(**HELPER)
def interpolant(time, h, y, n, model, space):
    """Compute the dense output of a step: its coefficients (7, m)."""
    slopes, f, new = space[SLOPES], space[DENSE], space[NEW]
    for s in range(STAGES + 1, STAGES + 4):
        combine(s, y, h, n, space, space[BETWEEN])
        evaluate(time + C[s] * h, space[BETWEEN], model, space, slopes[s])
    for i in range(y.shape[0]):
        over = new[i] - y[i]
        f[0, i] = over
        f[1, i] = h * slopes[0, i] - over
        f[2, i] = 2.0 * over - h * (slopes[STAGES, i] + slopes[0, i])
        for r in range(POWERS - 3):
            total = 0.0
            for j in range(STAGES + 4):
                total += D[r, j] * slopes[j, i]
            f[3 + r, i] = h * total


@njit(**HELPER)
def inside(share, y, n, space):
    """Evaluate the first n of the state within the step, on the dense output."""
    f, x, rest = space[DENSE], space[STATE], 1.0 - share
    for i in range(n):
        value = f[POWERS - 1, i] * share
        for r in range(POWERS - 2, -1, -1):
            value = (value + f[r, i]) * (rest if (POWERS - 1 - r) % 2 else share)
        x[i] = y[i] + value


@njit(**HELPER)
def cubic_summit(y0, y1, a, b):
    """Return the maximum of the cubic with values y0, y1 and slopes a, b (per interval) at its ends."""
    p, q = a + b - 2.0 * (y1 - y0), 3.0 * (y1 - y0) - 2.0 * a - b
    below = sqrt(max(q * q - 3.0 * p * a, 0.0)) - q
    best = max(y0, y1)
    if below > 0.0:
        u = min(max(a / below, 0.0), 1.0)
        best = max(best, y0 + u * (a + u * (q + u * p)))
    return best
