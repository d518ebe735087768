"""The engine of path and motion generation: traced arrays, exact slopes, linear fits, descent; and the validator's eyes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import casadi
import numpy as np
import pytest
from scipy.optimize import least_squares

import optlink
from optlink.design.generation import STEP, GenerationProblem
from optlink.design.generation_nlp import build_generation
from optlink.generation import variants_of
from optlink.linkage.elementwise import unit
from optlink.linkage.fourbar import LENGTHS, Inversion, grashof
from optlink.symbolic import PORTION, Tape, tracing
from optlink.synthesis import starts
from optlink.synthesis.batch import INSIDE, WEIGHT, Batch
from optlink.synthesis.marquardt import descend
from optlink.synthesis.search import Searcher
from optlink.synthesis.similarity import Similarity
from optlink.validation.generation import deviations, validate_generation
from tests import synthesis_oracle as oracle

Array = np.ndarray
TURN = 2.0 * math.pi
SPOTS = np.array([(20.0, 25.0), (28.0, 31.0), (33.0, 27.0), (30.0, 18.0), (22.0, 16.0)])  # mm, once round


def free(low: float, high: float, start: float | None = None, unit: str = "mm") -> dict[str, object]:
    first = {} if start is None else {"start": f"{start!r} {unit}"}
    return {**first, "bounds": [f"{low!r} {unit}", f"{high!r} {unit}"]}


ANGLE = free(-180.0, 180.0, 0.0, "deg")
LENGTH, PLACE = free(1.0, 400.0), free(-400.0, 400.0)


def four_bar_section(assembly: str = "left", **changes: object) -> dict[str, object]:
    section = {
        "type": "four-bar",
        **dict.fromkeys(LENGTHS, LENGTH),
        "points": {"P": [PLACE, PLACE]},
        "pivot": [PLACE, PLACE],
        "direction": ANGLE,
        "assembly": assembly,
    }
    return {key: value for key, value in {**section, **changes}.items() if value is not None}


SLIDER_CRANK = {
    "type": "dyads",
    "ground": {"A": [PLACE, PLACE]},
    "links": {
        "crank": {"joints": ["A", "B"], "length": free(2.0, 200.0, 20.0)},
        "rod": {"joints": ["B", "E"], "length": free(5.0, 400.0, 70.0), "points": {"P": [PLACE, PLACE]}},
        "slider": {"joints": ["E"]},
    },
    "guides": {"F": {"slider": "slider", "on": "frame", "through": "A", "direction": ANGLE, "offset": free(-200.0, 200.0, 5.0)}},
    "assembly": {"E": "forward"},
}


def between(low: float, high: float, start: float) -> dict[str, object]:
    return free(low, high, start)


STEPHENSON = {
    "type": "dyads",
    "ground": {
        "A": [between(-300.0, 300.0, 0.0), between(-300.0, 300.0, 0.0)],
        "D": [between(-300.0, 300.0, 121.0), between(-300.0, 300.0, 0.0)],
        "F": [between(-300.0, 400.0, 84.0), between(-300.0, 400.0, 265.0)],
    },
    "links": {
        "crank": {"joints": ["A", "B"], "length": free(5.0, 200.0, 40.0)},
        "coupler": {
            "joints": ["B", "C"],
            "length": free(20.0, 300.0, 96.0),
            "points": {"E": [between(-300.0, 300.0, 156.0), between(-300.0, 300.0, 7.0)]},
        },
        "rocker": {"joints": ["D", "C"], "length": free(20.0, 400.0, 130.0)},
        "link": {
            "joints": ["E", "G"],
            "length": free(20.0, 400.0, 106.5),
            "points": {"P": [between(-300.0, 300.0, 60.0), between(-300.0, 300.0, 25.0)]},
        },
        "lever": {"joints": ["F", "G"], "length": free(20.0, 400.0, 100.0)},
    },
    "assembly": {"C": "left of B-D", "G": "left of E-F"},
}


def document(
    mechanism: Mapping[str, object],
    points: Array = SPOTS,
    limits: Mapping[str, object] | None = None,
    crank: Array | None = None,
    weights: Array | None = None,
    tolerances: Array | None = None,
    **requirement: object,
) -> dict[str, object]:
    """A problem as a file states it: points in mm, with a third column (rad) of a motion, crank angles in rad."""
    rows: list[dict[str, object]] = [{"x": f"{row[0]!r} mm", "y": f"{row[1]!r} mm"} for row in np.asarray(points).tolist()]
    kind = "motion" if np.shape(points)[1] == 3 else "path"
    for i, row in enumerate(rows):
        if kind == "motion":
            row["angle"] = f"{float(points[i, 2])!r} rad"
        if crank is not None:
            row["crank"] = f"{float(crank[i])!r} rad"
        if weights is not None:
            row["weight"] = float(weights[i])
        if tolerances is not None:
            row["tolerance"] = f"{float(tolerances[i])!r} mm"
    task = {"kind": kind, "points": rows, **requirement}
    return {"title": "t", "mechanism": mechanism, "requirement": task, "limits": dict(limits or {})}


def model(raw: Mapping[str, object]) -> GenerationProblem:
    (file,) = variants_of(optlink.read(dict(raw)))
    assert isinstance(file.model, GenerationProblem)
    return file.model


# --- the tape ----------------------------------------------------------------------------------------------------------------


def by_casadi(inputs: list[Any], outputs: list[Any], columns: list[Array]) -> Array:
    """The same values by casadi's own machine, position by position."""
    vector = casadi.densify(casadi.vertcat(*[casadi.vec(output) for output in outputs]))
    function = casadi.Function("f", inputs, [vector], {"cse": True})  # which may take 0 * NaN for 0
    columns = [np.ravel(column) for column in np.broadcast_arrays(*columns)]
    return np.array([np.ravel(np.asarray(function(*row))) for row in zip(*columns, strict=True)]).T


ONE: dict[str, Callable[[Any], Any]] = {
    "assign": lambda x: x,
    "neg": lambda x: -x,
    "exp": casadi.exp,
    "log": casadi.log,
    "sqrt": casadi.sqrt,
    "sq": lambda x: x * x,
    "twice": lambda x: 2 * x,
    "sin": casadi.sin,
    "cos": casadi.cos,
    "tan": casadi.tan,
    "asin": casadi.asin,
    "acos": casadi.acos,
    "atan": casadi.atan,
    "sinh": casadi.sinh,
    "cosh": casadi.cosh,
    "tanh": casadi.tanh,
    "inv": lambda x: 1 / x,
    "fabs": casadi.fabs,
    "sign": casadi.sign,
    "floor": casadi.floor,
    "ceil": casadi.ceil,
    "not": casadi.logic_not,
    "constpow": lambda x: x**2.5,
    "cube": lambda x: x**3,
}
TWO: dict[str, Callable[[Any, Any], Any]] = {
    "add": lambda x, y: x + y,
    "sub": lambda x, y: x - y,
    "mul": lambda x, y: x * y,
    "div": lambda x, y: x / y,
    "pow": lambda x, y: x**y,
    "atan2": casadi.atan2,
    "hypot": casadi.hypot,
    "fmod": casadi.fmod,
    "fmin": casadi.fmin,
    "fmax": casadi.fmax,
    "lt": lambda x, y: x < y,
    "le": lambda x, y: x <= y,
    "eq": lambda x, y: x == y,
    "ne": lambda x, y: x != y,
    "and": casadi.logic_and,
    "or": casadi.logic_or,
    "if else": lambda x, y: casadi.if_else(x > 0.25, y, -x),
    "if else zero": lambda x, y: casadi.if_else(x > 0.25, y, 0),
}
SPECIAL = np.array([-3.0, -1.0, -0.5, -0.0, 0.0, 0.25, 0.5, 1.0, 2.0, 7.5])


@pytest.mark.parametrize("name", ONE)
def test_tape_has_every_function_of_one_argument(name: str) -> None:
    x = casadi.SX.sym("x")
    expected = by_casadi([x], [ONE[name](x)], [SPECIAL])
    np.testing.assert_allclose(Tape([x], [ONE[name](x)])(SPECIAL), expected, rtol=1e-15, atol=0.0)


@pytest.mark.parametrize("name", TWO)
def test_tape_has_every_function_of_two_arguments(name: str) -> None:
    x, y = casadi.SX.sym("x"), casadi.SX.sym("y")
    first, second = np.meshgrid(SPECIAL, SPECIAL, indexing="ij")
    expected = by_casadi([x, y], [TWO[name](x, y)], [first, second]).reshape(1, *first.shape)
    tape = Tape([x, y], [TWO[name](x, y)])
    np.testing.assert_allclose(tape(first, second), expected, rtol=1e-15, atol=0.0)
    np.testing.assert_allclose(tape(SPECIAL[:, None], SPECIAL), expected, rtol=1e-15, atol=0.0)


@pytest.mark.parametrize("name", [name for name in ONE if name != "not"])
def test_what_is_not_defined_stays_undefined(name: str) -> None:
    x = casadi.SX.sym("x")
    assert np.isnan(Tape([x], [ONE[name](x)])(np.array([math.nan]))).all()


def test_tape_refuses_what_it_does_not_know() -> None:
    x = casadi.SX.sym("x")
    with pytest.raises(NotImplementedError, match="no numpy function"):
        Tape([x], [casadi.erf(x)])


def tangle(rng: np.random.Generator, inputs: list[Any], size: int = 60) -> list[Any]:
    """Random expressions that share parts, some of them without any input."""
    known = [*inputs, casadi.SX(1.5), casadi.SX(-0.25)]
    one = [ONE[name] for name in ("neg", "sin", "cos", "sqrt", "sq", "twice", "fabs", "atan", "tanh")]
    two = [TWO[name] for name in ("add", "sub", "mul", "div", "atan2", "hypot", "lt", "if else")]
    for _ in range(size):
        x, y = (known[int(rng.integers(len(known)))] for _ in "xy")
        if rng.random() < 0.35:
            known.append(one[int(rng.integers(len(one)))](x))
        else:
            known.append(two[int(rng.integers(len(two)))](x, y))
    return [*known[-5:], inputs[0], casadi.SX(3.25)]


@pytest.mark.parametrize("seed", range(20))
def test_tape_of_random_expressions(seed: int) -> None:
    """Rows, points and one number broadcast; NaN appears where casadi has it (roots of negative numbers)."""
    rng = np.random.default_rng(seed)
    inputs = [casadi.SX.sym(f"x{k}") for k in range(4)]
    outputs = tangle(rng, inputs)
    slopes = casadi.jacobian(casadi.vertcat(*outputs), casadi.vertcat(*inputs))
    tape = Tape(inputs, [*outputs, slopes])
    rows, points = 7, 5
    columns = [rng.normal(size=(rows, 1)), rng.normal(size=points), rng.normal(size=(rows, points)), np.array(0.75)]
    if seed % 3 == 0:
        columns[0][2] = math.nan
    expected = by_casadi(inputs, [*outputs, slopes], columns).reshape(tape.outputs, rows, points)
    before = [column.copy() for column in columns]
    found = tape(*columns)
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-13)
    for column, was in zip(columns, before, strict=True):
        np.testing.assert_array_equal(column, was)
    np.testing.assert_array_equal(tape(*columns), found)  # nothing is kept from one call to the next


@pytest.mark.parametrize(
    ("rows", "points"), [(1, 3), (3, 1), (1, 1), (PORTION - 1, 1), (PORTION, 2), (PORTION // 3 + 1, 7), (2, 3 * PORTION), (0, 4)]
)
def test_a_tape_in_portions(rows: int, points: int) -> None:
    """A portion may be a part of the rows, and never changes a value."""
    rng = np.random.default_rng(rows + points)
    x, y, z = (casadi.SX.sym(name) for name in "xyz")
    tape = Tape([x, y, z], [casadi.sin(x) * y + z, x * x - 2 * z, casadi.SX(4.0)])
    a, b, c = rng.normal(size=(rows, 1)), rng.normal(size=(rows, points)), rng.normal(size=points)
    found = tape(a, b, c)
    assert found.shape == (3, rows, points)
    np.testing.assert_allclose(found[0], np.sin(a) * b + c, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(found[1], np.broadcast_to(a * a - 2.0 * c, (rows, points)), rtol=1e-14, atol=1e-15)
    assert np.all(found[2] == 4.0)


def test_a_tape_takes_plain_numbers() -> None:
    x, y = casadi.SX.sym("x"), casadi.SX.sym("y")
    assert Tape([x, y], [x / y, x - y])(3.0, 2.0).tolist() == [1.5, 1.0]


def test_tracing_restores_what_was_set() -> None:
    before = casadi.GlobalOptions.getNumpyMode()
    with tracing():
        assert casadi.is_equal(np.sin(casadi.SX(0)), casadi.SX(0))
    assert casadi.GlobalOptions.getNumpyMode() == before


# --- residuals and limits with their slopes --------------------------------------------------------------------------------

ANGLES5 = np.array([0.0, 1.1, 2.3, 3.7, 5.0])
POSES = np.column_stack([SPOTS[:4], [0.1, 0.5, -0.3, 2.9]])
WEIGHTS = np.array([1.0, 2.0, 0.5, 3.0, 1.5])
FOUR_LIMITS = {
    "transmission_angle": ["70 deg", "100 deg"],
    "link_ratio": [0.8, 1.5],
    "frame_length": ["50 mm", "90 mm"],
    "pivots": {"x": ["-5 mm", "5 mm"], "y": ["-5 mm", "6 mm"]},
}
TASKS: dict[str, Mapping[str, object]] = {
    "left, free": document(four_bar_section("left"), limits=FOUR_LIMITS, closed=True),
    "right, free, weights": document(four_bar_section("right"), limits=FOUR_LIMITS, weights=WEIGHTS),
    "timed from start": document(four_bar_section("right"), limits=FOUR_LIMITS, crank=ANGLES5, timing="from start"),
    "timed as given, clockwise": document(four_bar_section("left"), limits=FOUR_LIMITS, crank=-ANGLES5),
    "not placed": document(four_bar_section("left", pivot=None, direction=None), limits=FOUR_LIMITS),
    "some sizes fixed": document(four_bar_section("left", crank="25 mm", direction="20 deg"), limits=FOUR_LIMITS),
    "motion, free": document(four_bar_section("right"), POSES, FOUR_LIMITS, mark=ANGLE, angle_length="12 mm"),
    "motion, timed": document(four_bar_section("left"), POSES, FOUR_LIMITS, ANGLES5[:4], timing="from start"),
    "double-crank": document(four_bar_section("left"), limits={**FOUR_LIMITS, "crank": "double-crank"}),
    "swing and time ratio": document(
        four_bar_section("right"), limits={"swing_angle": ["50 deg", "55 deg"], "time_ratio": [1.3, 1.4]}
    ),
    "span": document(four_bar_section("left"), limits={"crank": "span", "transmission_angle": ["30 deg", "150 deg"]}),
    "slider-crank, free": document(SLIDER_CRANK, limits={"pivots": {"x": ["-1 mm", "1 mm"]}}, closed=True),
    "slider-crank, from start": document(SLIDER_CRANK, crank=-ANGLES5, timing="from start"),
    "slider-crank, given": document(SLIDER_CRANK, crank=ANGLES5),
    "six-bar, free": document(STEPHENSON, 2.0 * SPOTS + 80.0, {"transmission_angle": ["80 deg", "100 deg"]}),
    "six-bar, motion": document(STEPHENSON, POSES, {"pivots": {"y": ["-10 mm", "10 mm"]}}, ANGLES5[:4], timing="from start"),
}


@pytest.fixture(params=TASKS)
def batch(request: pytest.FixtureRequest) -> Batch:
    return Batch(model(TASKS[str(request.param)]))


def sample(batch: Batch, count: int, seed: int = 0) -> tuple[Array, Array]:
    """Random designs that assemble at their points, nowhere near where modes meet, and inside their bounds."""
    rng = np.random.default_rng(seed)
    found: list[tuple[Array, Array]] = []
    for _ in range(200):
        x = starts.designs(batch, 400, rng)
        t = starts.timing(batch, 400, rng) if batch.own else np.zeros((400, len(batch.data.columns)))
        x = batch.low + (batch.high - batch.low) * np.clip((x - batch.low) / (batch.high - batch.low), 1e-3, 1.0 - 1e-3)
        mechanism = batch.problem.linkage
        with np.errstate(all="ignore"):
            pose = mechanism.pose(batch.values(x), unit(batch.crank_angles(x, t)))
            whole = np.all([np.all(pose.margins[g.joint] > 0.02, axis=1) for g in mechanism.groups], axis=0)
        found.append((x[whole], t[whole]))
        if sum(len(each) for each, _ in found) >= count:
            break
    x, t = (np.concatenate(parts)[:count] for parts in zip(*found, strict=True))
    assert len(x) == count
    return x, t


def residual_of(batch: Batch, x: Array, t: Array) -> Array:
    """Residuals by the plain formulas, elementwise, of complex numbers too."""
    problem = batch.problem
    values: dict[str, Any] = {name: np.full((len(x), 1), quantity.value) for name, quantity in problem.quantities.items()}
    real = batch.origin + x * batch.scale
    values |= {name: real[:, i : i + 1] for i, name in enumerate(batch.names)}
    angles = t
    if not batch.own:
        begin = x[:, batch.start : batch.start + 1] if batch.start >= 0 else np.zeros((len(x), 1))
        angles = begin + np.asarray(batch.data.offsets)
    pose = problem.linkage.pose(values, unit(angles))
    parts = problem.deviation(pose, values, tuple(batch.data.columns.T))
    return np.stack(parts, axis=-1) * (batch.data.roots / problem.size)[:, None]


def test_residuals_and_their_slopes_by_complex_step(batch: Batch) -> None:
    x, t = sample(batch, 12)
    r, by_x, by_t = batch.residuals(x, batch.crank_angles(x, t))
    plain = residual_of(batch, x, t)
    np.testing.assert_allclose(r, plain, rtol=1e-10, atol=1e-11)
    tiny = 1e-40
    scale = 1.0 + np.max(np.abs(by_x), axis=(1, 2, 3))
    for i in range(x.shape[1]):
        moved = x.astype(complex)
        moved[:, i] += 1j * tiny
        slope = residual_of(batch, moved, t.astype(complex)).imag / tiny
        assert np.max(np.abs(by_x[..., i] - slope), axis=(1, 2)) / scale == pytest.approx(0.0, abs=1e-9), batch.names[i]
    if batch.own:
        slope = residual_of(batch, x.astype(complex), t + 1j * tiny).imag / tiny
        assert np.max(np.abs(by_t - slope), axis=(1, 2)) / scale == pytest.approx(0.0, abs=1e-9)


def test_slopes_of_missed_limits_by_differences(batch: Batch) -> None:
    x, t = sample(batch, 12, seed=1)
    n = x.shape[1]
    # off x = 0 for the limits of the whole revolution too, where a design may not close
    h, by_h = batch.misses(x, batch.crank_angles(x, t))
    assert h.shape == (*by_h.shape[:2],)
    assert by_h.shape[2] == n
    if batch.problem.limits.link_ratio or batch.problem.limits.pivots:
        assert np.any(h != 0.0)
    step = 1e-6
    for i in range(n):
        above, below = x.copy(), x.copy()
        above[:, i] += step
        below[:, i] -= step
        up, down = (batch.misses(side, batch.crank_angles(side, t))[0] for side in (above, below))
        slope = (up - down) / (2.0 * step)
        kink = (up == 0.0) | (down == 0.0) | (h == 0.0)  # a limit that holds on one side has no slope, or half of one
        close = np.isclose(by_h[..., i], slope, rtol=2e-5, atol=1e-4 * (1.0 + np.max(np.abs(by_h), initial=0.0)) * 1e-2)
        assert np.all(close | kink), batch.names[i]


def test_a_limit_that_holds_costs_nothing(batch: Batch) -> None:
    x, t = sample(batch, 30, seed=2)
    h, by_h = batch.misses(x, batch.crank_angles(x, t))
    assert np.all(np.isfinite(h))
    assert np.all(by_h[h == 0.0] == 0.0)


def test_missed_limits_are_those_of_the_lengths() -> None:
    """Grashof's conditions, link ratios and pivots by hand."""
    problem = model(document(four_bar_section("left"), limits={"link_ratio": [0.8, 1.5], "pivots": {"x": ["-5 mm", "5 mm"]}}))
    batch = Batch(problem)
    rng = np.random.default_rng(3)
    x, t = starts.designs(batch, 200, rng), starts.timing(batch, 200, rng)
    values = {name: v[:, 0] for name, v in batch.values(x).items()}
    crank, coupler, rocker, frame = (values[name] for name in LENGTHS)
    others = np.sort([coupler, rocker, frame], axis=0)
    proper = (crank < others[0]) & (crank + others[2] < others[0] + others[1])
    ratio = np.array([crank, coupler, rocker]) / frame
    inside = np.all((ratio >= 0.8) & (ratio <= 1.5), axis=0)
    ends = np.array([values["A.x"], values["A.x"] + frame * np.cos(values["direction"])])
    inside &= np.all(np.abs(ends) <= 5e-3, axis=0)
    h, _ = batch.misses(x, batch.crank_angles(x, t))
    missed = np.any(h != 0.0, axis=1)
    assert np.all(missed[~(proper & inside)])
    sums = np.array([others[0] + others[1] - crank - others[2], others[0] - crank]) / problem.size
    clear = np.min(sums, axis=0) > 2.0 * INSIDE
    assert not np.any(missed[proper & inside & clear])
    off = np.maximum(0.8 - ratio, 0.0) + np.maximum(ratio - 1.5, 0.0)
    assert np.all(np.sum(h**2, axis=1) >= 0.99 * WEIGHT**2 * np.sum(off**2, axis=0))


def test_crank_angles_follow_from_the_start() -> None:
    timed = Batch(model(TASKS["timed from start"]))
    x, t = sample(timed, 4)
    np.testing.assert_allclose(timed.crank_angles(x, t), x[:, timed.start : timed.start + 1] + ANGLES5, rtol=0, atol=1e-12)
    given = Batch(model(TASKS["timed as given, clockwise"]))
    x, t = sample(given, 4)
    np.testing.assert_allclose(given.crank_angles(x, t), np.tile(-ANGLES5, (4, 1)), rtol=0, atol=1e-12)
    assert Batch(model(TASKS["left, free"])).own


# --- the linear fit ----------------------------------------------------------------------------------------------------------


def cost_of(batch: Batch, x: Array, t: Array) -> Array:
    r, _, _ = batch.residuals(x, batch.crank_angles(x, t))
    return np.einsum("bpk,bpk->b", r, r)


FITTED = ["left, free", "right, free, weights", "timed from start", "timed as given, clockwise", "double-crank", "span"]


@pytest.mark.parametrize("name", FITTED)
def test_fit_of_a_four_bar_is_complex_least_squares(name: str) -> None:
    """Place, size, direction and coupler point by numpy's own least squares: P = a + w S + b u."""
    batch = Batch(model(TASKS[name]))
    fit = Similarity(batch)
    assert fit.applies
    x, t = sample(batch, 20)
    values, angles = batch.values(x), batch.crank_angles(x, t)
    fitted, moved = fit.fit(x, angles)
    assert np.array_equal(moved, angles)  # crank angles count from the frame, which turns with the rest
    found = cost_of(batch, fitted, t)
    with np.errstate(all="ignore"):
        pose = batch.problem.linkage.pose(values, unit(angles))
    arm = [np.broadcast_to(c, angles.shape) for c in pose.point("B")]
    axis = [np.broadcast_to(c, angles.shape) for c in pose.direction("coupler")]
    wanted = batch.data.columns[:, 0] + 1j * batch.data.columns[:, 1]
    size, roots = batch.problem.size, batch.data.roots
    for k in range(len(x)):
        basis = np.stack([np.ones(len(wanted)), (arm[0][k] + 1j * arm[1][k]) / size, axis[0][k] + 1j * axis[1][k]], axis=1)
        best = np.linalg.lstsq(basis * roots[:, None], wanted / size * roots, rcond=None)[0]
        left = np.sum(np.abs((basis @ best - wanted / size) * roots) ** 2)
        assert found[k] == pytest.approx(left, rel=1e-6, abs=1e-10)


def test_a_weight_draws_the_fit_to_its_point() -> None:
    heavy = np.array([1.0, 1.0, 1e6, 1.0, 1.0])
    batch = Batch(model(document(four_bar_section("right"), weights=heavy)))
    x, t = sample(batch, 10)
    fitted, _ = Similarity(batch).fit(x, t)
    r, _, _ = batch.residuals(fitted, t)
    assert np.all(np.abs(r[:, 2]) / 1e3 < 0.02 * np.max(np.abs(r), axis=(1, 2))[:, None])


PLACED = [*FITTED, "slider-crank, free", "slider-crank, from start", "six-bar, free"]


@pytest.mark.parametrize("name", PLACED)
def test_nothing_linear_is_better_than_the_fit(name: str) -> None:
    """Moving, turning and scaling the whole by a little never improves it, nor does moving the point on its body."""
    batch = Batch(model(TASKS[name]))
    fit = Similarity(batch)
    assert fit.applies
    x, t = sample(batch, 12, seed=3)
    fitted, t = fit.fit(x, batch.crank_angles(x, t))
    least = cost_of(batch, fitted, t)
    again, same = fit.fit(fitted, batch.crank_angles(fitted, t))
    np.testing.assert_allclose(cost_of(batch, again, same), least, rtol=1e-6, atol=1e-12)  # and it stays there
    rng = np.random.default_rng(4)
    ground = [i for pair in fit.ground for i in pair]
    for size in (1e-4, 1e-2, 0.3):
        for _ in range(8):
            moved, at = fitted.copy(), t.copy()
            x0 = fitted[:, fit._pivot]
            scale, by, shift = 1.0 + size * rng.normal(), size * rng.normal(), size * rng.normal(size=2)
            turn = np.array([[math.cos(by), -math.sin(by)], [math.sin(by), math.cos(by)]])
            for i, j in fit.ground:
                moved[:, [i, j]] = x0 + shift + scale * (fitted[:, [i, j]] - x0) @ turn.T
            moved[:, fit.lengths] *= scale
            moved[:, fit.turning] += by
            if fit.counted_from_x:
                at = at + by
                if batch.start >= 0:
                    moved[:, batch.start] += by
            if fit.point:
                moved[:, fit.point] = moved[:, fit.point] * scale + size * rng.normal(size=2)
            assert ground
            assert np.all(cost_of(batch, moved, at) >= least * (1.0 - 1e-9) - 1e-13)


def test_the_fit_finds_a_planted_linkage_again() -> None:
    """Right proportions and timing, anywhere: the fit alone puts place, size, direction and coupler point right."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        design = oracle.random_crank_rocker(rng)
        phi = oracle.random_angles(rng, 8)
        spots = oracle.planted_path(design, phi)
        wide = {"points": {"P": [free(-1e4, 1e4)] * 2}, "pivot": [free(-1e4, 1e4)] * 2}
        wide |= dict.fromkeys(LENGTHS, free(0.01, 1e4))
        batch = Batch(model(document(four_bar_section("left" if design["mode"] > 0 else "right", **wide), spots)))
        x = np.zeros((1, len(batch.names)))
        for name in LENGTHS:
            x[0, batch.names.index(name)] = 0.37 * design[name]
        fitted, _ = Similarity(batch).fit(x, phi[None])
        assert cost_of(batch, fitted, phi[None])[0] < 1e-16
        values = batch.values(fitted)
        for name in LENGTHS:
            assert values[name][0, 0] * 1e3 == pytest.approx(design[name], rel=1e-8)
        assert values["P.along"][0, 0] * 1e3 == pytest.approx(design["along"], rel=1e-6, abs=1e-6)
        assert values["A.x"][0, 0] * 1e3 == pytest.approx(design["x"], rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("name", ["not placed", "some sizes fixed", "motion, free", "motion, timed", "slider-crank, given"])
def test_where_place_or_size_is_bound_nothing_is_fitted(name: str) -> None:
    assert not Similarity(Batch(model(TASKS[name]))).applies


# --- descent -----------------------------------------------------------------------------------------------------------------


def as_vector(batch: Batch) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """Residuals and missed limits of one design as scipy takes them, and their slopes: crank angles behind the sizes."""
    n, count = len(batch.names), len(batch.data.columns)

    def split(z: Array) -> tuple[Array, Array]:
        x = z[None, :n]
        return x, batch.crank_angles(x, z[None, n:] if batch.own else np.zeros((1, count)))

    def f(z: Array) -> Array:
        x, angles = split(z)
        return np.concatenate([batch.residuals(x, angles)[0].ravel(), batch.misses(x, angles)[0].ravel()])

    def slopes(z: Array) -> Array:
        x, angles = split(z)
        _, by_x, by_t = batch.residuals(x, angles)
        upper = by_x[0].reshape(-1, n)
        lower = batch.misses(x, angles)[1][0]
        if batch.own:
            k = by_t.shape[2]
            own = np.zeros((count * k, count))
            for p in range(count):
                own[p * k : (p + 1) * k, p] = by_t[0, p]
            upper, lower = np.hstack([upper, own]), np.hstack([lower, np.zeros((len(lower), count))])
        return np.vstack([upper, lower])

    return f, slopes


def minimum_by_scipy(batch: Batch, x: Array, t: Array) -> float:
    f, slopes = as_vector(batch)
    more = [np.full(len(t), math.inf)] if batch.own else []
    begin = np.concatenate([x, t]) if batch.own else x
    bounds = (np.concatenate([batch.low, *(-m for m in more)]), np.concatenate([batch.high, *more]))
    found = least_squares(f, begin, slopes, bounds, xtol=1e-15, ftol=1e-15, gtol=1e-12, max_nfev=4000)
    return 2.0 * float(found.cost)


DESCENDED = [
    "left, free",
    "timed from start",
    "timed as given, clockwise",
    "some sizes fixed",
    "motion, timed",
    "slider-crank, from start",
]


@pytest.mark.parametrize("name", DESCENDED)
def test_descent_ends_where_scipy_does(name: str) -> None:
    """From near an optimum both reach it; the crank angles that are eliminated change nothing in that."""
    batch = Batch(model(TASKS[name]))
    x, t = sample(batch, 200, seed=5)
    ends = descend(batch, x, t, 300)
    rng = np.random.default_rng(6)
    checked = 0
    for i in np.argsort(ends.cost)[:4]:
        near = np.clip(ends.x[i] + 1e-3 * rng.normal(size=x.shape[1]), batch.low, batch.high)
        at = ends.t[i] + (1e-3 * rng.normal(size=t.shape[1]) if batch.own else 0.0)
        again = descend(batch, near[None], at[None], 1000, slow=1e-12)
        inside = np.clip(near, batch.low + 1e-9, batch.high - 1e-9)
        aim = minimum_by_scipy(batch, inside, at)
        assert again.cost[0] <= aim * (1.0 + 1e-4) + 1e-9
        checked += 1
    assert checked == 4


@pytest.mark.parametrize("name", [*DESCENDED, "span", "six-bar, free", "slider-crank, free"])
def test_descent_keeps_to_bounds_and_never_rises(name: str) -> None:
    batch = Batch(model(TASKS[name]))
    fit = Similarity(batch)
    x, t = sample(batch, 60, seed=7)
    angles = batch.crank_angles(x, t)
    h, _ = batch.misses(x, angles)
    before = cost_of(batch, x, t) + np.sum(h**2, axis=1)
    least = before
    ways: list[tuple[int, Similarity | None]] = [(1, None), (10, None), (30, None)]
    for steps, using in ways + [(10, fit)] * fit.applies:
        ends = descend(batch, x, t, steps, using.fit if using else None, using.linear if using else None)
        assert np.all(ends.x >= batch.low - 1e-12)
        assert np.all(ends.x <= batch.high + 1e-12)
        assert np.all(ends.cost <= before * (1.0 + 1e-12))
        angles = batch.crank_angles(ends.x, ends.t)
        h, _ = batch.misses(ends.x, angles)
        np.testing.assert_allclose(ends.missed, np.sum(h**2, axis=1), rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(ends.cost, cost_of(batch, ends.x, ends.t) + ends.missed, rtol=1e-9, atol=1e-15)
        if using is None:
            assert np.all(ends.cost <= least * (1.0 + 1e-12))  # more steps are never worse
            least = ends.cost


def test_a_start_that_does_not_assemble_is_given_back() -> None:
    batch = Batch(model(TASKS["left, free"]))
    x, t = sample(batch, 3)
    x[1, [batch.names.index(name) for name in LENGTHS]] = [0.1, 0.2, 0.3, 9.0]
    kept = x.copy()
    ends = descend(batch, x, t, 20)
    assert np.isinf(ends.cost[1])
    np.testing.assert_array_equal(ends.x[1], kept[1])
    assert np.all(np.isfinite(ends.cost[[0, 2]]))
    alone = descend(batch, kept[[0, 2]], t[[0, 2]], 20)
    np.testing.assert_allclose(alone.cost, ends.cost[[0, 2]], rtol=1e-6)


def test_a_bound_holds_the_optimum() -> None:
    """A coupler that may not be as long as it should ends on its bound."""
    rng = np.random.default_rng(1)
    design = oracle.random_crank_rocker(rng)
    phi = np.arange(12) * TURN / 12
    spots = oracle.planted_path(design, phi)
    wide = {name: free(0.5 * design[name], 2.0 * design[name], design[name]) for name in LENGTHS}
    wide["coupler"] = free(0.5 * design["coupler"], 0.97 * design["coupler"], 0.9 * design["coupler"])
    section = four_bar_section("left" if design["mode"] > 0 else "right", **wide)
    batch = Batch(model(document(section, spots, crank=phi)))
    truth = {**design, "A.x": design["x"], "A.y": design["y"], "P.along": design["along"], "P.across": design["across"]}
    x = np.array([[truth[name] * (1.0 if name == "direction" else 1e-3) for name in batch.names]])
    x = np.clip((x - batch.origin) / batch.scale, batch.low, batch.high)
    ends = descend(batch, x, np.zeros((1, 12)), 500, slow=1e-12)
    i = batch.names.index("coupler")
    assert ends.x[0, i] == pytest.approx(batch.high[i], rel=1e-9)
    assert 0.0 < ends.cost[0] <= cost_of(batch, x, np.zeros((1, 12)))[0]


# --- starts and rounds -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("crank", "inversion"), [("full rotation", Inversion.CRANK_ROCKER), ("double-crank", Inversion.DOUBLE_CRANK)]
)
def test_proportions_are_all_of_their_kind(crank: str, inversion: Inversion) -> None:
    batch = Batch(model(document(four_bar_section(), limits={"crank": crank})))
    lengths = starts.proportions(batch, 2000, np.random.default_rng(0))
    assert lengths.shape == (2000, 4)
    assert np.all(lengths > 0.0)
    assert np.all(lengths[:, 3] == 1.0)
    assert {grashof(*row).inversion for row in lengths.tolist()} == {inversion}


def test_proportions_leave_no_crank_rocker_out() -> None:
    """Around every random crank-rocker of the oracle there are some, though they are three numbers."""
    batch = Batch(model(document(four_bar_section())))
    logs = np.log(starts.proportions(batch, 60_000, np.random.default_rng(1))[:, :3])
    rng = np.random.default_rng(2)
    for _ in range(60):
        design = oracle.random_crank_rocker(rng)
        aim = np.log([design[name] / design["frame"] for name in LENGTHS[:3]])
        assert np.min(np.max(np.abs(logs - aim), axis=1)) < 0.35


@pytest.mark.parametrize("rotation", ["either", "clockwise", "counter-clockwise"])
@pytest.mark.parametrize("closed", [False, True])
def test_random_timing_is_in_order(rotation: str, closed: bool) -> None:
    batch = Batch(model(document(four_bar_section(), closed=closed, rotation=rotation)))
    t = starts.timing(batch, 500, np.random.default_rng(0))
    steps = np.diff(t, axis=1)
    way = np.sign(steps[:, :1])
    assert np.all(steps * way >= STEP)
    assert np.all(np.abs(t[:, -1] - t[:, 0]) < TURN)
    assert set(way.ravel().tolist()) == {"either": {-1.0, 1.0}, "clockwise": {-1.0}, "counter-clockwise": {1.0}}[rotation]


@pytest.mark.parametrize("rotation", ["clockwise", "counter-clockwise"])
def test_candidates_keep_order_and_rotation(rotation: str) -> None:
    files = variants_of(optlink.read(document(four_bar_section("either"), closed=True, rotation=rotation)))
    searcher = Searcher([file.model for file in files], 0)
    found = searcher.explore(120, 3)
    assert found.starts == 120
    assert found.candidates
    costs = [candidate.cost for candidate in found.candidates]
    assert costs == sorted(costs)
    for candidate in found.candidates:
        assert candidate.direction == (1 if rotation == "counter-clockwise" else -1)
        steps = np.diff(candidate.t) * candidate.direction
        assert np.all(steps >= STEP)
        assert np.sum(steps) <= TURN + 1e-9
        batch = searcher.batches[candidate.variant]
        again = cost_of(batch, candidate.x[None], candidate.t[None])[0]
        h, _ = batch.misses(candidate.x[None], candidate.t[None])
        assert again + np.sum(h**2) == pytest.approx(candidate.cost, rel=1e-9, abs=1e-20)


def test_the_same_seed_finds_the_same() -> None:
    def once(seed: int) -> list[float]:
        problem = model(document(four_bar_section("left"), crank=ANGLES5, timing="from start"))
        return [c.cost for c in Searcher([problem], seed).explore(60, 3).candidates]

    assert once(3)
    assert once(3) == once(3)
    assert once(3) != once(4)


# --- the programme that polishes ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("measure", ["sum of squares", "rms", "max"])
@pytest.mark.parametrize(
    "name", ["right, free, weights", "timed from start", "motion, free", "slider-crank, free", "six-bar, motion"]
)
def test_the_programme_measures_what_the_validator_does(name: str, measure: str) -> None:
    raw = TASKS[name]
    problem = model({**raw, "requirement": {**raw["requirement"], "measure": measure}})  # type: ignore[dict-item]
    batch = Batch(problem)
    nlp = build_generation(problem)
    x, t = sample(batch, 6, seed=8)
    for k in range(len(x)):
        values = {key: float(v[k, 0]) for key, v in batch.values(x).items()}
        angles = batch.crank_angles(x, t)[k]
        measured = deviations(problem, values, angles)
        z = np.concatenate([x[k], t[k]]) if batch.own else x[k]
        if len(nlp.variables) > len(z):
            z = np.append(z, 0.0)
        solution_x = nlp.lifted(z)
        scale = {"sum of squares": problem.size**2}.get(measure, problem.size)
        share = nlp.values(solution_x, nlp.p)[0] * nlp.p[0]
        if measure == "rms":
            assert math.sqrt(share) * scale == pytest.approx(measured.objective, rel=1e-8)
        else:
            assert share * scale == pytest.approx(measured.objective, rel=1e-8)
        square = np.sum(batch.residuals(x, batch.crank_angles(x, t))[0][k] ** 2) * problem.size**2
        if measure == "sum of squares":
            assert square == pytest.approx(measured.objective, rel=1e-9)


def test_the_programme_knows_order_and_whole_revolutions() -> None:
    for direction in (1, -1):
        nlp = build_generation(model(TASKS["left, free"]), direction)
        labels = [row.label for row in nlp.rows]
        assert sum(label.startswith("order of points") for label in labels) == len(SPOTS) - 1
        x = nlp.x_start.copy()
        count = len(x) - len(SPOTS)
        x[count:] = direction * TURN / 5 * np.arange(5)
        g = nlp.values(x, nlp.p)[1]
        order = np.array([label.startswith("order of points") for label in labels])
        np.testing.assert_allclose(g[order], TURN / 5, rtol=1e-12)
        x[count:] *= -1.0
        assert np.all(nlp.values(x, nlp.p)[1][order] < 0.0)


# --- the validator sees every planted defect ---------------------------------------------------------------------------------

CHECKS = {
    "within its bounds": "bounds",
    "link lengths": "lengths",
    "Grashof": "grashof",
    "assembled over": "assembled",
    "one branch": "branch",
    "one circuit": "circuit",
    "met in order": "order",
    "one revolution": "one revolution",
    "crank turns": "rotation",
    "crank angles as given": "timing",
    "position for every": "reached",
    "tolerances": "tolerance",
    "smallest transmission angle": "smallest",
    "largest transmission angle": "largest",
    "swing angle": "swing",
    "time ratio": "time ratio",
    "frame length": "frame length",
    " / frame": "link ratio",
    "A.": "pivots",
    "D.": "pivots",
    "objective": "objective",
}
DESIGN = oracle.four_bar(100.0, 35.0, 90.0, 80.0, x=-30.0, y=12.0, direction=0.35, along=40.0, across=55.0, mode=1)
PHI = 0.4 + np.arange(6) * 0.9
PLANTED = oracle.planted_path(DESIGN, PHI)
LOOSE = {"transmission_angle": ["30 deg", "150 deg"], "link_ratio": [0.2, 3.0]}


def quantities(design: Mapping[str, float]) -> dict[str, float]:
    """A design of the oracle [mm] as one of ours [m]."""
    found = {name: 1e-3 * design[name] for name in LENGTHS}
    found |= {"A.x": 1e-3 * design["x"], "A.y": 1e-3 * design["y"], "direction": design["direction"]}
    return found | {"P.along": 1e-3 * design["along"], "P.across": 1e-3 * design["across"]}


def planted(limits: Mapping[str, object] = LOOSE, **more: Any) -> GenerationProblem:
    return model(document(four_bar_section("left"), more.pop("points", PLANTED), limits, **more))


def failed(
    problem: GenerationProblem, design: Mapping[str, float], angles: Array, objective: float | None = None, **more: float
) -> set[str]:
    proof = validate_generation(problem, quantities(design) | more, angles, objective)
    kinds = {next(kind for word, kind in CHECKS.items() if word in check.name) for check in proof.checks if not check.passed}
    assert proof.valid == (not kinds)
    return kinds


def test_what_is_right_passes() -> None:
    problem = planted(closed=True)
    proof = validate_generation(problem, quantities(DESIGN), PHI, 0.0)
    assert proof.valid
    assert proof.objective < 1e-20
    assert all(check.limit for check in proof.checks)
    report = oracle.judge_path(DESIGN, PLANTED, PHI, closed=True)
    assert report.free
    assert report.sse < 1e-20


def test_the_figures_are_those_of_the_oracle() -> None:
    rng = np.random.default_rng(5)
    for mode in ("path", "motion"):
        off = PLANTED + rng.normal(size=PLANTED.shape)
        poses = np.column_stack([off, oracle.direct(DESIGN, PHI).angle + 0.1 * rng.normal(size=6) + 0.3])
        wanted = off if mode == "path" else poses
        problem = planted(points=wanted, **({} if mode == "path" else {"angle_length": "25 mm"}))
        extra = {} if mode == "path" else {"mark": 0.3}
        measured = deviations(problem, quantities(DESIGN) | extra, PHI)
        if mode == "path":
            report = oracle.judge_path(DESIGN, off, PHI)
            assert 1e6 * measured.objective == pytest.approx(report.sse, rel=1e-9)
        else:
            report = oracle.judge_motion(DESIGN, poses, PHI, 0.3)
            assert measured.turned is not None
            np.testing.assert_allclose(measured.turned, report.angle_errors, atol=1e-9)
            square = report.sse + 625.0 * float(np.sum(report.angle_errors**2))
            assert 1e6 * measured.objective == pytest.approx(square, rel=1e-9)
        np.testing.assert_allclose(1e3 * measured.distances, report.errors, atol=1e-9)


def test_the_other_assembly_mode() -> None:
    """The figures are those of the mode that the problem states; the claim of the other one is found out."""
    other = {**DESIGN, "mode": -1}
    problem = planted()
    spots = oracle.planted_path(other, PHI)
    assert failed(planted(points=spots), other, PHI) == set()  # nobody claimed anything
    assert failed(planted(points=spots), other, PHI, 0.0) == {"objective"}
    report = oracle.judge_path(DESIGN, spots, PHI)
    assert not report.branch_ok
    assert 1e6 * deviations(planted(points=spots), quantities(other), PHI).objective == pytest.approx(report.sse, rel=1e-9)
    assert failed(problem, DESIGN, PHI, 0.0) == set()


def test_coupler_and_rocker_swapped() -> None:
    swapped = {**DESIGN, "coupler": DESIGN["rocker"], "rocker": DESIGN["coupler"]}
    assert failed(planted(), swapped, PHI, 0.0) == {"objective"}
    assert oracle.judge_path(swapped, PLANTED, PHI).rms > 1.0


def test_crank_and_frame_swapped() -> None:
    swapped = {**DESIGN, "crank": DESIGN["frame"], "frame": DESIGN["crank"]}
    assert {"grashof", "objective"} <= failed(planted(limits={}), swapped, PHI, 0.0)
    assert failed(planted(limits={"crank": "double-crank"}), swapped, PHI) == set()


def test_crank_angles_out_of_order() -> None:
    mixed = PHI.copy()
    mixed[[2, 3]] = PHI[[3, 2]]
    spots = oracle.planted_path(DESIGN, mixed)
    assert failed(planted(points=spots), DESIGN, mixed, 0.0) == {"order"}
    assert not oracle.judge_path(DESIGN, spots, mixed).order_ok


def test_more_than_one_revolution() -> None:
    wide = 0.4 + np.arange(6) * 1.5
    spots = oracle.planted_path(DESIGN, wide)
    assert failed(planted(points=spots), DESIGN, wide, 0.0) == {"one revolution"}
    assert not oracle.judge_path(DESIGN, spots, wide).order_ok


def test_the_wrong_way_round() -> None:
    assert failed(planted(rotation="clockwise"), DESIGN, PHI, 0.0) == {"rotation"}
    assert failed(planted(rotation="counter-clockwise"), DESIGN, PHI, 0.0) == set()
    back, turned = PHI[::-1].copy(), PLANTED[::-1].copy()
    assert failed(planted(points=turned, rotation="clockwise"), DESIGN, back, 0.0) == set()
    assert oracle.judge_path(DESIGN, turned, back).rotation == -1


def test_a_claim_that_is_wrong() -> None:
    off = PLANTED + 0.5
    right = deviations(planted(points=off), quantities(DESIGN), PHI).objective
    assert failed(planted(points=off), DESIGN, PHI, right) == set()
    for wrong in (0.0, 0.5 * right, 1.00001 * right, math.nan):
        assert failed(planted(points=off), DESIGN, PHI, wrong) == {"objective"}


def test_not_grashof() -> None:
    """Over the points it assembles; over the revolution it does not."""
    long = {**DESIGN, "coupler": 60.0, "rocker": 65.0}
    phi = 0.3 + 0.2 * np.arange(5)
    assert np.all(np.isfinite(oracle.direct(long, phi).output))
    spots = oracle.planted_path(long, phi)
    found = failed(planted(points=spots, limits={}), long, phi, 0.0)
    assert {"grashof", "assembled"} <= found
    assert "objective" not in found
    assert not oracle.judge_path(long, spots, phi).turns
    assert failed(planted(points=spots, limits={"crank": "span"}), long, phi, 0.0) == set()


def test_a_gap_between_the_points() -> None:
    """All points are reached, but on the way from one to the next the linkage comes apart: no span, two circuits."""
    design = oracle.four_bar(100.0, 80.0, 30.0, 70.0, x=5.0, y=-3.0, direction=0.4, along=40.0, across=30.0)
    ranges = oracle.assembled(design)
    assert len(ranges) == 2
    phi = np.sort(np.concatenate([0.5 * (low + high) + 0.2 * (high - low) * np.array([-1.0, 0.0, 1.0]) for low, high in ranges]))
    spots = oracle.planted_path(design, phi)
    found = failed(planted(points=spots, limits={"crank": "span"}), design, phi, 0.0)
    assert "assembled" in found
    assert "objective" not in found
    assert not oracle.judge_path(design, spots, phi).circuit_ok


def test_a_kite_passes_its_change_point_on_no_side() -> None:
    """crank = coupler, frame = rocker: at phi = 0 all links lie in line, and nothing says which way it goes on."""
    kite = oracle.four_bar(150.0, 118.0, 118.0, 150.0, along=-14.0, across=27.0, mode=-1)
    phi = np.array([-1.0, -0.5, 0.5, 1.0])
    spots = oracle.planted_path(kite, phi)
    section = four_bar_section("right")
    problem = model(document(section, spots, {"crank": "span"}))
    assert not oracle.judge_path(kite, spots, phi).branch_ok
    proof = validate_generation(problem, quantities(kite), phi, 0.0)
    assert not proof.valid


CHANGE_POINTS = [  # frame, crank, coupler, rocker: in line at phi = 0
    (162.66, 32.532, 813.299, 683.171),
    (157.474, 126.287, 126.287, 157.474),
    (100.0, 50.0, 80.0, 130.0),
    (100.0, 50.0, 80.0, 130.0 - 1e-12),
    (100.0, 50.0, 80.0, 130.0 + 1e-12),
    (100.0, 50.0, 80.0, 130.0 + 1e-9),
]


@pytest.mark.parametrize("bars", CHANGE_POINTS)
@pytest.mark.parametrize("mode", ["left", "right"])
def test_a_change_point_on_the_way_is_seen(bars: tuple[float, ...], mode: str) -> None:
    """Its margin is 0, or what rounding makes of 0: no proof that the linkage keeps its assembly mode there."""
    design = oracle.four_bar(*bars, along=40.0, across=30.0, mode=1 if mode == "left" else -1)
    phi = np.array([-2.0, -1.2, -0.4, 0.4, 1.2, 2.0])
    if not np.all(np.isfinite(oracle.direct(design, phi).output)):
        phi = phi + math.pi
    spots = oracle.planted_path(design, phi)
    if not np.all(np.isfinite(spots)):
        pytest.skip("does not assemble at the points")
    problem = model(document(four_bar_section(mode), spots, {"crank": "span"}))
    report = oracle.judge_path(design, spots, phi)
    assert not report.branch_ok
    assert not validate_generation(problem, quantities(design), phi, 0.0).valid


@pytest.mark.parametrize("more", [0.0, 0.02, 0.05])
def test_a_narrow_gap_between_positions_is_seen(more: float) -> None:
    """Crank and frame all but equal: around phi = 0 the linkage comes apart within a few tenths of a degree."""
    design = oracle.four_bar(60.0, 60.3, 350.0, 350.3 + more, along=40.0, across=30.0, mode=-1)
    phi = np.array([-2.0, -1.2, -0.4, 0.37, 1.2, 2.2])
    spots = oracle.planted_path(design, phi)
    problem = model(document(four_bar_section("right"), spots, {"crank": "span"}))
    assert not oracle.judge_path(design, spots, phi).circuit_ok
    assert not validate_generation(problem, quantities(design), phi, 0.0).valid


def test_two_points_at_the_same_crank_angle() -> None:
    """After a whole revolution the crank is where it began: two different points cannot both be met there."""
    phi = 0.4 + np.array([0.0, 1.0, 3.0, TURN])
    spots = oracle.planted_path(DESIGN, phi)
    spots[3] += 7.0
    assert failed(planted(points=spots), DESIGN, phi) & {"order", "one revolution"}
    assert not oracle.judge_path(DESIGN, spots, phi).order_ok
    again = oracle.planted_path(DESIGN, phi)
    assert failed(planted(points=again, closed=True), DESIGN, phi, 0.0) == set()  # the first point, listed again


@pytest.mark.parametrize(("tolerance", "expected"), [(1.0, set()), (0.25, {"tolerance"})])
def test_point_out_of_its_tolerance(tolerance: float, expected: set[str]) -> None:
    off = PLANTED.copy()
    off[3, 0] += 0.5
    allowed = np.full(6, 10.0)
    allowed[3] = tolerance
    assert failed(planted(points=off, tolerances=allowed), DESIGN, PHI) == expected


def test_transmission_angle_missed() -> None:
    def angle(phi: float) -> float:
        square = 35.0**2 + 100.0**2 - 7000.0 * math.cos(phi)
        return math.degrees(math.acos((90.0**2 + 80.0**2 - square) / (2.0 * 90.0 * 80.0)))

    low, high = angle(0.0), angle(math.pi)

    def limits(at_least: float, at_most: float, **more: object) -> dict[str, object]:
        return {"transmission_angle": [f"{at_least} deg", f"{at_most} deg"], **more}

    assert failed(planted(limits=limits(low - 0.01, high + 0.01)), DESIGN, PHI) == set()
    assert failed(planted(limits=limits(low + 0.01, high + 0.01)), DESIGN, PHI) == {"smallest"}
    assert failed(planted(limits=limits(low - 0.01, high - 0.01)), DESIGN, PHI) == {"largest"}
    part = np.linspace(1.0, 2.0, 6)
    inner = limits(angle(1.0) - 0.01, angle(2.0) + 0.01)
    assert failed(planted(limits=inner), DESIGN, part) == {"smallest", "largest"}
    assert failed(planted(limits={**inner, "transmission_over": "span"}), DESIGN, part) == set()


def test_proportions_missed() -> None:
    assert failed(planted(limits={"link_ratio": [0.36, 3.0]}), DESIGN, PHI) == {"link ratio"}
    assert failed(planted(limits={"link_ratio": [0.2, 0.89]}), DESIGN, PHI) == {"link ratio"}
    assert failed(planted(limits={"frame_length": ["101 mm", "200 mm"]}), DESIGN, PHI) == {"frame length"}
    swings = oracle.direct(DESIGN, np.linspace(0.0, TURN, 100_001)).output
    swing = math.degrees(float(np.ptp(np.unwrap(swings))))
    assert failed(planted(limits={"swing_angle": [f"{swing - 0.01} deg", f"{swing + 0.01} deg"]}), DESIGN, PHI) == set()
    assert failed(planted(limits={"swing_angle": [f"{swing + 0.01} deg", "170 deg"]}), DESIGN, PHI) == {"swing"}
    assert failed(planted(limits={"time_ratio": [3.0, 4.0]}), DESIGN, PHI) == {"time ratio"}


def test_pivot_outside_its_region() -> None:
    d = DESIGN["x"] + 100.0 * math.cos(DESIGN["direction"])
    for low, high, expected in ((-31.0, d + 0.1, set()), (-29.9, d + 0.1, {"pivots"}), (-31.0, d - 0.1, {"pivots"})):
        region = {"pivots": {"x": [f"{low} mm", f"{high} mm"]}}
        assert failed(planted(limits=region), DESIGN, PHI) == expected
    assert failed(planted(limits={"pivots": {"y": ["13 mm", "200 mm"]}}), DESIGN, PHI) == {"pivots"}


def test_degrees_for_radians() -> None:
    turned = {**DESIGN, "direction": math.degrees(DESIGN["direction"])}
    assert "objective" in failed(planted(), turned, PHI, 0.0)
    assert "bounds" in failed(planted(), turned, PHI, 0.0)
    assert "one revolution" in failed(planted(), DESIGN, np.degrees(PHI), 0.0)
    poses = oracle.planted_poses(DESIGN, PHI, 0.3)
    assert failed(planted(points=poses), DESIGN, PHI, 0.0, mark=0.3) == set()
    assert {"objective", "bounds"} <= failed(planted(points=poses), DESIGN, PHI, 0.0, mark=math.degrees(0.3))
    assert "objective" in failed(planted(points=poses), DESIGN, PHI, 0.0, mark=-0.3)


def test_crank_angles_that_were_not_asked_for() -> None:
    problem = planted(crank=PHI)
    assert failed(problem, DESIGN, PHI, 0.0) == set()
    late = PHI.copy()
    late[2] += 1e-6
    assert failed(problem, DESIGN, late) == {"timing"}
    begun = planted(crank=PHI - PHI[0], timing="from start")
    assert failed(begun, DESIGN, PHI, 0.0, start=float(PHI[0])) == set()
    assert "timing" in failed(begun, DESIGN, PHI, 0.0, start=float(PHI[0]) + 0.01)


def test_a_size_beyond_its_bound() -> None:
    assert failed(planted(), {**DESIGN, "rocker": 401.0, "frame": 400.0, "coupler": 90.0}, PHI) & {"bounds"}
    shifted = {**DESIGN, "x": 401.0}
    assert failed(planted(limits={}), shifted, PHI) == {"bounds"}


def test_nothing_assembles_anywhere() -> None:
    """No exception and no pass: figures that are not numbers fail."""
    apart = {**DESIGN, "coupler": 5.0, "rocker": 6.0}
    found = failed(planted(limits={}), apart, PHI, 0.0)
    assert {"reached", "assembled", "objective"} <= found


@pytest.mark.parametrize("seed", range(15))
def test_validator_and_oracle_agree_on_random_linkages(seed: int) -> None:
    """Any four lengths, any points, in and out of order: valid by the one is free of defects by the other."""
    rng = np.random.default_rng(seed)
    for _ in range(4):
        bars = [float(v) for v in rng.uniform(20.0, 120.0, 4)]
        x, y, along, across = (float(v) for v in rng.uniform(-50.0, 50.0, 4))
        mode = int(rng.choice([-1, 1]))
        design = oracle.four_bar(*bars, x=x, y=y, direction=float(rng.uniform(-3.0, 3.0)), along=along, across=across, mode=mode)
        count = int(rng.integers(3, 8))
        phi = oracle.random_angles(rng, count, float(rng.uniform(0.5, TURN)))
        if rng.random() < 0.3:
            rng.shuffle(phi)
        spots = oracle.random_points(rng, count)
        crank = str(rng.choice(["full rotation", "double-crank", "span"]))
        problem = model(document(four_bar_section("left" if mode > 0 else "right"), spots, {"crank": crank}))
        proof = validate_generation(problem, quantities(design), phi)
        report = oracle.judge_path(design, spots, phi)
        if abs(report.margin) < 1e-3 or abs(report.turn_margin) < 1e-3:
            continue
        whole = report.order_ok and report.circuit_ok and report.branch_ok
        if crank != "span":
            shortest = "crank" if crank == "full rotation" else "frame"
            whole = whole and report.turns and design[shortest] == min(bars)
        assert proof.valid == whole, (crank, [check.name for check in proof.checks if not check.passed])
        if np.all(np.isfinite(report.errors)):
            assert 1e6 * proof.objective == pytest.approx(report.sse, rel=1e-8)
