"""One formula, five readers: floats, batches, casadi symbols, complex steps and jets must all see the same function.

casadi is the reference for derivatives; it is held against a complex step and against jets, so that two of the three would have
to be wrong in the same way. Every check is shown to fail on a planted defect at the end of its section.
"""

from __future__ import annotations

import contextlib
import inspect
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import casadi
import numpy as np
import pytest

import optlink
from optlink.linkage import dyads, fourbar, vector2d
from optlink.linkage.jet import _CHAIN, Jet
from optlink.linkage.mechanism import BodyPoint, Mechanism
from optlink.optimization import terms
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import build
from optlink.optimization.terms import MEASURES
from optlink.problem.design import DesignProblem
from optlink.problem.requirements.base import StartPosition
from optlink.problem.targets.expression import FUNCTIONS, parse
from optlink.symbolic import symbols_in_numpy
from tests.solved import loaded

SAME = 1e-12
JET = 1e-10
TINY = 1e-30  # imaginary step: no difference is formed, so it may be as small as one likes


# --- what is compared ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """An elementwise formula: `function` takes Values and returns Values.

    `designs` are rows of all arguments but the last, `along` are values of the last one: a batch is (designs, 1) x (along,).
    `complex_step`, `jet`: whether numpy's functions in it know complex numbers and jets. `undefined`: further rows that have no
    value, used where only values are compared.
    """

    name: str
    function: Callable[..., Sequence[object]]
    designs: tuple[tuple[float, ...], ...]
    along: tuple[float, ...]
    complex_step: bool = True
    jet: bool = True
    undefined: tuple[tuple[float, ...], ...] = ()

    def __str__(self) -> str:
        return self.name

    def points(self, rows: tuple[tuple[float, ...], ...]) -> np.ndarray:
        """All arguments, (designs, along, arguments)."""
        grid = np.empty((len(rows), len(self.along), len(rows[0]) + 1))
        grid[..., :-1] = np.array(rows)[:, None, :]
        grid[..., -1] = self.along
        return grid


SIDES = {1: "left", -1: "right"}
# crank-rockers (the two links that follow the crank and its frame in a row), well away from change points
CRANK_ROCKERS = ((0.1, 0.41286, 0.23224, 0.5), (0.1, 0.4, 0.4, 0.5), (0.3, 1.1, 0.8, 1.2), (0.05, 0.2, 0.3, 0.27))
FRAMES = (0.5, 0.47)
DOUBLE_CRANKS = ((0.5, 0.41, 0.43, 0.1), (1.2, 1.1, 0.8, 0.3))


def lengths_along_frame(linkages: Sequence[tuple[float, ...]]) -> tuple[tuple[float, ...], ...]:
    return tuple(row[:3] for row in linkages)


def law(text: str, names: str, designs: tuple[tuple[float, ...], ...], along: tuple[float, ...], **known: bool) -> Case:
    """A law as a case; its arguments are `names`, in that order."""
    order = names.split()
    expression = parse(text, order)
    assert expression.names == set(order), "an argument that the law does not use would be compared in vain"
    return Case(f"law {text}", lambda *v: [expression(dict(zip(order, v, strict=True)))], designs, along, **known)


def coupler_point_pose(side: int) -> Callable[..., list[object]]:
    base = fourbar.four_bar(side)
    points = (BodyPoint("P", "coupler", "along", "across"), BodyPoint("Q", "rocker", 0.07, -0.02))
    mechanism = Mechanism("with points", base.ground, base.crank, base.groups, points)

    def pose(crank, coupler, rocker, frame, along, across, phi):
        sizes = {"crank": crank, "coupler": coupler, "rocker": rocker, "frame": frame, "along": along, "across": across}
        result = mechanism.pose(sizes, vector2d.unit(phi))
        moving = [result.points[name] for name in ("B", "C", "P", "Q")]
        moving += [result.direction(link.body) for link in mechanism.links]
        return [coordinate for vector in moving for coordinate in vector] + [result.margins["C"]]

    return pose


def dead_centre(side: int, outer: bool) -> Callable[..., list[object]]:
    def function(*lengths):
        limit = fourbar.dead_centre(*lengths, side, outer)
        return [*limit.crank, *limit.rocker, limit.margin, limit.phi, limit.psi]

    return function


def problem(
    mechanism: dict[str, object] | None = None,
    requirement: dict[str, object] | None = None,
    limits: dict[str, object] | None = None,
) -> DesignProblem:
    """The shipped crank-rocker with other values (None: without that key)."""
    raw = {key: value for key, value in loaded("crank-rocker").raw.items() if key != "expected"}
    for section, changes in (("mechanism", mechanism), ("requirement", requirement), ("limits", limits)):
        merged = {**raw[section], **(changes or {})}
        raw[section] = {key: value for key, value in merged.items() if value is not None}
    return optlink.read(raw).spec


TABLE = {"phi": ["10 deg", "40 deg", "95 deg"], "psi": ["1 deg", "8 deg", "25 deg"]}
RULES = {  # problems whose requirement is read differently
    "tied, outer": problem(),
    "tied, inner, right": problem({"assembly": "right"}, {"from": "inner dead centre", "law": "psi0 - 0.3*(phi-phi0)"}),
    "table": problem(None, {"law": TABLE, "span": None, "points": None}),
    "phi0 given": problem(None, {"from": "60 deg", "law": "psi0 + 0.2*sin(phi - phi0) + 0.1*phi"}),
    "phi0 and psi0 given": problem(None, {"from": "60 deg", "psi0": "100 deg"}),
    "table from the frame": problem(
        None, {"law": {**TABLE, "measured_from": "frame"}, "from": None, "span": None, "points": None}
    ),
}


def start_values(rule: DesignProblem, values: Sequence[object]) -> dict[str, object]:
    return dict(zip(rule.quantities, values, strict=True))


def output_error(rule: DesignProblem) -> Callable[..., list[object]]:
    def function(*arguments):
        *values, offset = arguments
        named = start_values(rule, values)
        start = rule.start_position(named)
        return [
            *start.crank,
            start.phi0,
            start.psi0,
            terms.output_error(rule, named, start, offset, 0.2),
        ]

    return function


def starts_of(rule: DesignProblem) -> tuple[tuple[float, ...], ...]:
    extra = {"phi0": (0.9, 1.3), "psi0": (1.8, 2.1)}
    added = [name for name in rule.quantities if name in extra]
    return tuple((*row, *(extra[name][k % 2] for name in added)) for k, row in enumerate(CRANK_ROCKERS[:3]))


ALL = {"swing_angle": ["1 deg", "170 deg"], "frame_length": ["1 mm", "9 m"], "link_ratio": [0.01, 9.0]}
LIMITS = {  # name -> (problem, has abs, has maximum or minimum)
    "revolution": (problem(None, None, ALL), False, False),
    "cosine": (
        problem(None, None, {"transmission_angle": None, "transmission_cosine": [-0.7, 0.7], **ALL}),
        False,
        False,
    ),
    "pressure angle": (problem(None, None, {"transmission_angle": None, "pressure_angle": "50 deg"}), False, False),
    "time ratio": (problem(None, None, {"time_ratio": [1.0, 1.5]}), True, False),
    "over the span": (problem(None, None, {"transmission_over": "span"}), False, True),
    "crank over the span": (problem(None, None, {"crank": "span", **ALL, "swing_angle": None}), False, True),
    "crank over the span, inner, right": (
        problem({"assembly": "right"}, {"from": "inner dead centre"}, {"crank": "span"}),
        False,
        True,
    ),
    "crank over the span from an angle": (
        problem(None, {"from": "60 deg", "span": "-200 deg"}, {"crank": "span"}),
        False,
        True,
    ),
    "double crank": (problem(None, {"from": "60 deg"}, {"crank": "double-crank"}), False, False),
}


def limit_rows(rule: DesignProblem) -> Callable[..., list[object]]:
    def function(*values):
        named = start_values(rule, values)
        return [row.value for row in terms.rows(rule, named, rule.reach(named), 0.5)]

    return function


def limit_case(name: str) -> Case:
    rule, has_abs, has_maximum = LIMITS[name]
    linkages = DOUBLE_CRANKS if rule.limits.crank == "double-crank" else CRANK_ROCKERS[:3]
    rows, last = (linkages, (1.1, 0.7)) if "phi0" in rule.quantities else (lengths_along_frame(linkages[:2]), FRAMES)
    return Case(f"rows: {name}", limit_rows(rule), rows, last, not (has_abs or has_maximum), not has_maximum)


DOMAINS = {  # of every function of the language, on both sides of zero where it has both
    "sin": (-2.0, 0.3, 5.0),
    "cos": (-2.0, 0.3, 5.0),
    "tan": (-1.2, 0.3, 2.0),
    "asin": (-0.8, 0.1, 0.9),
    "acos": (-0.8, 0.1, 0.9),
    "atan": (-3.0, 0.1, 2.0),
    "sinh": (-2.0, 0.3, 1.5),
    "cosh": (-2.0, 0.3, 1.5),
    "tanh": (-2.0, 0.3, 1.5),
    "exp": (-2.0, 0.3, 1.5),
    "log": (0.2, 1.1, 7.0),
    "log10": (0.2, 1.1, 7.0),
    "sqrt": (0.2, 1.1, 7.0),
    "abs": (-2.0, -0.1, 0.1, 3.0),
}


def cases() -> Iterator[Case]:
    for side, where in SIDES.items():
        yield Case(
            f"rrr {where}",
            lambda px, py, qx, qy, a, b, side=side: (lambda joint, m: [*joint, m])(*dyads.rrr((px, py), (qx, qy), a, b, side)),
            ((0.0, 0.0, 0.5, 0.1, 0.4), (0.2, -0.3, -0.6, 0.2, 0.7), (1.0, 2.0, 1.5, 2.5, 0.6)),
            (0.45, 0.61),
            undefined=((0.0, 0.0, 0.5, 0.1, 3.0), (0.0, 0.0, 5.0, 0.1, 0.4)),
        )
        yield Case(
            f"rrp {where}",
            lambda px, py, gx, gy, direction, offset, a, side=side: (lambda joint, m: [*joint, m])(
                *dyads.rrp((px, py), (gx, gy), vector2d.unit(direction), a, offset, side)
            ),
            ((0.0, 0.3, 0.5, 0.1, 0.2, 0.05), (0.2, -0.3, -0.6, 0.2, 2.5, -0.1)),
            (1.1, 0.9),
            undefined=((0.0, 3.0, 0.5, 0.1, 0.2, 0.05),),
        )
        yield Case(
            f"rpr {where}",
            lambda px, py, qx, qy, offset, side=side: (lambda line, m: [*line, m])(*dyads.rpr((px, py), (qx, qy), offset, side)),
            ((0.0, 0.3, 0.5, 0.1), (0.2, -0.3, -0.6, 0.2)),
            (0.0, 0.1, -0.3),
            undefined=((0.0, 0.0, 0.05, 0.0), (0.0, 0.0, 0.0, -0.05)),
        )
        yield Case(
            f"pose {where}",
            coupler_point_pose(side),
            ((0.1, 0.41286, 0.23224, 0.5, 0.2, 0.15), (0.5, 0.41, 0.43, 0.1, -0.1, 0.3)),
            (0.0, 1.0, 2.5, math.pi, 4.4, 6.0),
            undefined=((0.1, 0.9, 0.1, 0.5, 0.2, 0.15),),
        )
        for outer in (True, False):
            yield Case(
                f"dead_centre {where} {'outer' if outer else 'inner'}",
                dead_centre(side, outer),
                lengths_along_frame(CRANK_ROCKERS[:2]),
                FRAMES,
                undefined=((0.1, 0.2, 0.1), (0.3, 0.9, 0.1)),
            )
        for stroke, has_abs in ((fourbar.swing, False), (fourbar.time_ratio, True)):
            yield Case(
                f"{stroke.__name__} {where}",
                lambda *v, stroke=stroke, side=side: [stroke(*v, side)],
                lengths_along_frame(CRANK_ROCKERS[:2]),
                FRAMES,
                complex_step=not has_abs,
                undefined=((0.1, 0.9, 0.1),),
            )
    yield Case(
        "rpp line",
        lambda px, py, yx, yy, w, u, offset: dyads.rpp((px, py), (yx, yy), vector2d.unit(w), vector2d.unit(u), offset),
        ((0.0, 0.3, 0.5, 0.1, 0.2, 1.7), (0.2, -0.3, -0.6, 0.2, 2.5, 0.4)),
        (0.0, 0.07, -0.2),
    )
    yield Case(
        "prp line",
        lambda gx, gy, w, hx, hy, u, first, second: (lambda joint, m: [*joint, m])(
            *dyads.prp((gx, gy), vector2d.unit(w), (hx, hy), vector2d.unit(u), first, second)
        ),
        ((0.0, 0.3, 0.2, 0.5, 0.1, 1.7, 0.05), (0.2, -0.3, 2.5, -0.6, 0.2, 0.4, -0.1)),
        (0.0, 0.07, -0.2),
    )
    for conditions in (fourbar.crank_rocker_conditions, fourbar.double_crank_conditions):
        yield Case(
            conditions.__name__,
            lambda *v, conditions=conditions: list(conditions(*v).values()),
            lengths_along_frame((*CRANK_ROCKERS, *DOUBLE_CRANKS)),
            (0.5, 0.1),
        )
    yield Case(
        "diagonal_squared",
        lambda crank, frame, phi: [fourbar.diagonal_squared(crank, frame, np.cos(phi))],
        ((0.1, 0.5), (0.7, 0.3)),
        (0.0, 1.0, math.pi, 4.0),
    )
    yield Case(
        "transmission_cosine",
        lambda *v: [fourbar.transmission_cosine(*v[:4], np.cos(v[4])), fourbar.transmission_cosine(*v[:4], -1.0)],
        (*CRANK_ROCKERS, (0.1, 0.9, 0.1, 0.5)),
        (0.0, 1.0, math.pi, 4.0),
    )
    for span in (1.5, 2.0 * math.pi, -2.0):
        yield Case(
            f"turning_points over {span:.3g}",
            lambda unused, start, span=span: [x + 0.0 * unused for x in fourbar.turning_points(start, span)],
            ((1.0,),),
            (-2.0, 0.5, 2.2, 3.0),
            complex_step=False,
            jet=False,
        )
    quadrants = ((0.3, 0.4), (-0.3, 0.4), (-0.3, -0.4), (0.3, -0.4), (1e-3, 2.0), (-2.0, 1e-3))
    yield Case("angle", lambda x, y: [vector2d.angle((x, y))], tuple((x,) for x, _ in quadrants), (0.4, -0.7, 1e-3))
    yield Case(
        "angle_from",
        lambda ax, ay, bx, by: [vector2d.angle_from((ax, ay), (bx, by))],
        tuple((*a, b[0]) for a in quadrants for b in quadrants[:4]),
        (0.45, -0.37),
    )
    yield Case("turn", lambda *v: vector2d.turn(v[:2], v[2:]), ((0.3, -0.4, 0.8), (2.0, 1.0, -0.6)), (0.6, -0.8))
    vectors = ((0.3, -0.4, 0.8), (2.0, 1.0, -0.6))
    yield Case("turn_back", lambda *v: vector2d.turn_back(v[:2], v[2:]), vectors, (0.6, -0.8))
    yield Case("dot", lambda *v: [vector2d.dot(v[:2], v[2:])], vectors, (0.6, -0.8))
    yield Case("cross", lambda *v: [vector2d.cross(v[:2], v[2:])], vectors, (0.6, -0.8))
    yield Case("plus", lambda *v: vector2d.plus(v[:2], v[2:]), vectors, (0.6, -0.8))
    yield Case("minus", lambda *v: vector2d.minus(v[:2], v[2:]), vectors, (0.6, -0.8))
    yield Case("unit", lambda k, phi: vector2d.unit(k * phi), ((1.0,), (-3.0,)), (0.0, 1.0, 4.0))
    yield Case("magnitude", lambda k, x: [vector2d.magnitude(k * x)], ((1.0,), (-3.0,)), (0.2, 5.0))
    yield Case("real", lambda k, x: [vector2d.real(k * x)], ((1.0,), (-3.0,)), (0.2, 5.0), complex_step=False)
    yield Case("sign", lambda k, x: [vector2d.sign(k * x) * x], ((1.0,), (-3.0,)), (0.2, 5.0), jet=False)
    yield Case("root", lambda k, x: [vector2d.root(k * x)], ((1.0,), (3.0,)), (0.2, 5.0), undefined=((-1.0,),))
    for name, rule in RULES.items():
        yield Case(f"output_error {name}", output_error(rule), starts_of(rule), (0.0, 0.7, 1.9, -2.5))
    for name in LIMITS:
        yield limit_case(name)
    for name in FUNCTIONS:
        yield law(f"{name}(phi0*phi)", "phi0 phi", ((1.0,), (0.97,)), DOMAINS[name], complex_step=name != "abs")
    yield law("psi0 + 2/(3*pi)*(phi - phi0)^2", "psi0 phi0 phi", ((2.0, 1.1), (0.3, 0.5)), (0.5, 1.1, 3.0))
    for exponent in ("0", "1", "2", "3", "5"):  # at zero too: there is where a law starts
        yield law(f"phi0*phi^{exponent}", "phi0 phi", ((1.0,), (-2.0,)), (-0.7, 0.0, 1.3))
    for exponent in ("-1", "-2"):
        yield law(f"phi0*phi^{exponent}", "phi0 phi", ((1.0,), (-2.0,)), (-0.7, 0.2, 1.3))
    for exponent in ("0.5", "1.5", "-0.3", "(1/3)"):
        yield law(f"phi0*phi^{exponent}", "phi0 phi", ((1.0,), (-2.0,)), (0.2, 1.3))
    yield law("phi0*2^phi", "phi0 phi", ((1.0,), (-2.0,)), (-0.7, 0.2, 1.3))
    yield law("phi0^phi", "phi0 phi", ((1.5,), (0.2,)), (-0.7, 0.2, 1.3))
    yield law("phi^phi0", "phi0 phi", ((1.5,), (-0.2,)), (0.2, 1.3))
    yield law("-phi/phi0 + +phi*phi0 - (phi0 - phi)/(2 + phi)", "phi0 phi", ((1.5,), (-0.2,)), (0.2, 1.3))


CASES = tuple(cases())
IDS = [case.name for case in CASES]


# --- the readers ---------------------------------------------------------------------------------------------------


def one_by_one(case: Case, rows: tuple[tuple[float, ...], ...]) -> np.ndarray:
    """Python floats in, one call per point: (designs, along, outputs)."""
    grid = case.points(rows)
    return np.array([[[float(v) for v in case.function(*map(float, x))] for x in line] for line in grid])


def batched(case: Case, rows: tuple[tuple[float, ...], ...]) -> np.ndarray:
    grid = case.points(rows)
    columns = [grid[:, :1, i] for i in range(grid.shape[-1] - 1)]
    computed = case.function(*columns, grid[0, :, -1])
    return np.stack([np.broadcast_to(v, grid.shape[:2]) for v in computed], axis=-1)


class Traced:
    """The formula as casadi sees it: values, Jacobian, and the derivatives along a motion x + v t + a t^2 / 2 at t = 0."""

    def __init__(self, function: Callable[..., Sequence[object]], arguments: int) -> None:
        x, v, a = (casadi.SX.sym(name, arguments) for name in "xva")
        t = casadi.SX.sym("t")
        with symbols_in_numpy():
            out = casadi.vertcat(*function(*casadi.vertsplit(x)))
        moving = casadi.substitute(out, x, x + v * t + 0.5 * a * t**2)
        rate = casadi.jacobian(moving, t)
        zero = casadi.SX(0)
        self.outputs = out.numel()
        self._values = casadi.Function("values", [x], [out])
        self._jacobian = casadi.Function("jacobian", [x], [casadi.densify(casadi.jacobian(out, x))])
        motion = [casadi.substitute(y, t, zero) for y in (rate, casadi.jacobian(rate, t))]
        self._motion = casadi.Function("motion", [x, v, a], [casadi.densify(y) for y in motion])

    def values(self, x: np.ndarray) -> np.ndarray:
        flat = x.reshape(-1, x.shape[-1])
        return np.array(self._values(flat.T)).T.reshape(*x.shape[:-1], self.outputs)

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        flat = x.reshape(-1, x.shape[-1])
        return np.array([np.array(self._jacobian(point)) for point in flat])

    def motion(self, x: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rate, acceleration = self._motion(x, v, a)
        return np.array(rate).ravel(), np.array(acceleration).ravel()


@cache
def traced(case: Case) -> Traced:
    return Traced(case.function, len(case.designs[0]) + 1)


def motions(case: Case) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Every point of the case with a random velocity and acceleration."""
    rng = np.random.default_rng(7)
    flat = case.points(case.designs).reshape(-1, len(case.designs[0]) + 1)
    return [(x, rng.uniform(-1.0, 1.0, x.size), rng.uniform(-1.0, 1.0, x.size)) for x in flat]


def check_values(case: Case, reference: Callable[..., Sequence[object]] | None = None) -> None:
    rows = case.designs + case.undefined
    expected = one_by_one(case, rows)
    assert np.isfinite(expected[: len(case.designs)]).all(), "a case without values compares nothing"
    if case.undefined:
        assert np.isnan(expected[len(case.designs) :]).any()
    np.testing.assert_allclose(batched(case, rows), expected, rtol=SAME, atol=1e-14)
    programme = Traced(reference, len(rows[0]) + 1) if reference else traced(case)
    np.testing.assert_allclose(programme.values(case.points(rows)), expected, rtol=SAME, atol=1e-14)


def check_complex_step(case: Case) -> None:
    grid = case.points(case.designs).reshape(-1, len(case.designs[0]) + 1)
    exact = traced(case).jacobian(grid)
    assert np.isfinite(exact).all()
    assert np.any(exact != 0.0)
    for i in range(grid.shape[-1]):
        stepped = grid.astype(complex)
        stepped[:, i] += 1j * TINY
        columns = [stepped[:, k] for k in range(grid.shape[-1])]
        computed = np.stack(
            [np.broadcast_to(np.imag(np.asarray(v, complex)) / TINY, len(grid)) for v in case.function(*columns)], -1
        )
        np.testing.assert_allclose(computed, exact[:, :, i], rtol=SAME, atol=1e-13, err_msg=f"d / d argument {i}")


def check_jets(case: Case, form: str) -> None:
    moved = 0
    for x, v, a in motions(case):
        if form == "scalar":
            jets = [Jet(*map(float, parts)) for parts in zip(x, v, a, strict=True)]
        else:
            jets = [Jet(*(np.array([p]) for p in parts)) for parts in zip(x, v, a, strict=True)]
        computed = [y if isinstance(y, Jet) else Jet(y) for y in case.function(*jets)]
        values, rates, accelerations = (
            np.array([float(np.squeeze(getattr(y, part))) for y in computed]) for part in ("value", "rate", "acceleration")
        )
        rate, acceleration = traced(case).motion(x, v, a)
        np.testing.assert_allclose(values, traced(case).values(x), rtol=SAME, atol=1e-14)
        np.testing.assert_allclose(rates, rate, rtol=JET, atol=1e-12)
        np.testing.assert_allclose(accelerations, acceleration, rtol=JET, atol=1e-11)
        if case.complex_step:
            stepped = case.function(*(x + 1j * TINY * v))
            along = np.array([np.imag(complex(y)) / TINY for y in stepped])
            np.testing.assert_allclose(rates, along, rtol=SAME, atol=1e-13)
        moved += np.count_nonzero(np.abs(rate) > 1e-6)
    assert moved, "nothing moved"


def check_differences(case: Case, reference: Callable[..., Sequence[object]] | None = None) -> None:
    """casadi's Jacobian against five-point differences, for what knows no complex numbers."""
    grid = case.points(case.designs).reshape(-1, len(case.designs[0]) + 1)
    programme = Traced(reference, grid.shape[-1]) if reference else traced(case)
    exact = programme.jacobian(grid)
    assert np.any(exact != 0.0)
    h = 1e-4

    def at(x: np.ndarray) -> np.ndarray:
        return np.array([float(v) for v in case.function(*map(float, x))])

    for k, x in enumerate(grid):
        for i in range(x.size):
            e = h * np.eye(x.size)[i]
            slope = (8.0 * (at(x + e) - at(x - e)) - (at(x + 2 * e) - at(x - 2 * e))) / (12.0 * h)
            np.testing.assert_allclose(slope, exact[k, :, i], rtol=1e-7, atol=1e-9)


# --- the checks ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_floats_batches_and_symbols_give_the_same_value(case):
    check_values(case)


@pytest.mark.parametrize("case", [c for c in CASES if c.complex_step], ids=str)
def test_casadi_jacobian_is_the_complex_step(case):
    check_complex_step(case)


@pytest.mark.parametrize("form", ["scalar", "array"])
@pytest.mark.parametrize("case", [c for c in CASES if c.jet], ids=str)
def test_jets_are_the_derivatives_along_a_motion(case, form):
    check_jets(case, form)


@pytest.mark.parametrize("case", [c for c in CASES if not c.complex_step], ids=str)
def test_casadi_jacobian_is_the_difference_where_no_complex_step_exists(case):
    check_differences(case)


def test_every_elementwise_function_is_compared():
    """A formula added to the core without a case above fails here."""
    no_formulas = {"four_bar", "grashof", "classify", "reachable", "whole_four_bar", "inner_four_bars", "transmitting"}
    no_formulas |= {"all_finite", "max_magnitude", "finite_or", "wrapped", "whole_turns"}  # of arrays and plain numbers alone
    names = " ".join(IDS)
    for module in (vector2d, dyads, fourbar):
        for name, function in inspect.getmembers(module, inspect.isfunction):
            if function.__module__ == module.__name__ and name not in no_formulas and name[0] != "_":
                assert f"{name} " in f"{names} ", name
    assert set(DOMAINS) == set(FUNCTIONS)
    compared = {row.limit for name in LIMITS for row in rows_of(name)}
    expected = {f"limits.{key}" for key in type(problem().limits).model_fields} - {"limits.transmission_over", "limits.pivots"}
    assert compared == expected


@pytest.mark.parametrize("start", ["-300 deg", "60 deg", "340 deg", "360 deg", "-360 deg"])
def test_rows_over_a_span_hold_its_extremes_wherever_it_starts(start):
    """Either such a start is refused, or no extreme of the transmission angle over the span escapes the rows."""
    beyond_a_turn = abs(float(start.split()[0])) > 360.0
    with contextlib.suppress(*[optlink.InputError] * beyond_a_turn):
        check_rows_over_a_span(problem(None, {"from": start, "span": "60 deg"}, {"crank": "span"}))


def check_rows_over_a_span(rule: DesignProblem) -> None:
    design = rule.design({})
    phi = design["phi0"] + rule.span * np.linspace(0.0, 1.0, 2001)
    cosine = fourbar.transmission_cosine(*(design[name] for name in fourbar.LENGTHS), np.cos(phi))
    computed = [float(r.value) for r in terms.rows(rule, design, rule.reach(design), 0.5) if r.scale.cosine]
    np.testing.assert_allclose([min(computed), max(computed)], [np.min(cosine), np.max(cosine)], atol=1e-6)


@pytest.mark.parametrize("coupler_longer", [True, False], ids=["coupler longer", "crank longer"])
@pytest.mark.parametrize("start", ["outer dead centre", "inner dead centre"])
def test_rows_of_a_dead_centre_are_met_exactly_where_it_exists(start, coupler_longer):
    rule = problem(None, {"from": start}, {"crank": "span", "transmission_angle": None, "length_margin": 1e-5})
    rng = np.random.default_rng(17)
    verdicts = []
    for crank, coupler, rocker, frame in rng.uniform(0.05, 1.0, (300, 4)):
        crank, coupler = sorted((crank, coupler), reverse=not coupler_longer)
        values = {"crank": crank, "coupler": coupler, "rocker": rocker, "frame": frame}
        limit = fourbar.dead_centre(crank, coupler, rocker, frame, 1, start == "outer dead centre")
        if abs(limit.margin) < 1e-3 or abs(crank - coupler) < 1e-3:
            continue
        rows = terms.rows(rule, values, rule.reach(values), 0.5)
        met = [row.value >= row.low for row in rows if row.label.startswith("dead centre")]
        verdicts.append(limit.margin > 0.0)
        assert all(met) == verdicts[-1], values
    assert min(verdicts.count(True), verdicts.count(False)) > 40


def rows_of(name: str) -> list[terms.ConstraintRow]:
    rule = LIMITS[name][0]
    design = rule.design({})
    return terms.rows(rule, design, rule.reach(design), 0.5)


@pytest.mark.parametrize(
    ("residuals", "expected"),
    [([3.0, -4.0], {"sum of squares": 25.0, "rms": math.sqrt(12.5), "max": 4.0}), ([0.5], dict.fromkeys(MEASURES, 0.5))],
)
def test_measures_by_hand(residuals, expected):
    expected = expected | ({"sum of squares": 0.25} if len(residuals) == 1 else {})
    assert {name: measure.of(residuals) for name, measure in MEASURES.items()} == pytest.approx(expected, rel=1e-15)


def test_slope_of_a_measure_is_its_derivative():
    """Of the figure that displayed read, by what the programme minimises: mean square for rms, the same thing else."""
    residuals = np.array([0.3, -0.4, 0.1])
    mean = float(residuals @ residuals) / 3.0
    h = 1e-6
    assert MEASURES["rms"].slope(residuals) == pytest.approx((math.sqrt(mean + h) - math.sqrt(mean - h)) / (2.0 * h), rel=1e-9)
    assert MEASURES["sum of squares"].slope(residuals) == MEASURES["max"].slope(residuals) == 1.0


@pytest.mark.parametrize(
    ("scale", "value", "displayed"),
    [
        (terms.COSINE, math.cos(1.1), math.degrees(1.1)),
        (terms.COSINE, -0.4, math.degrees(math.acos(-0.4))),
        (terms.DEGREES, -0.7, math.degrees(-0.7)),
        (terms.PLAIN, 1.3, 1.3),
        (terms.Scale("mm", 500.0), 0.8, 400.0),
    ],
)
def test_scales_convert_rows_to_display_units_and_back(scale, value, displayed):
    assert scale.to_display(value) == pytest.approx(displayed, rel=1e-14)
    assert scale.to_internal(displayed) == pytest.approx(value, rel=1e-14)
    slope = (scale.to_display(value + 1e-6) - scale.to_display(value - 1e-6)) / 2e-6
    assert scale.slope(value) == pytest.approx(slope, rel=1e-8)


def test_bounds_of_the_rows_are_the_limits_of_the_file():
    wide = {"transmission_angle": ["40 deg", "130 deg"], "time_ratio": {"max": 1.5}, **ALL}
    rule = problem(None, None, wide)
    design = rule.design({})
    result = {row.label: row for row in terms.rows(rule, design, rule.reach(design), 0.5)}

    def displayed(words: str) -> tuple[float, float]:
        (row,) = (row for label, row in result.items() if words in label)
        return tuple(row.scale.to_display(bound) if math.isfinite(bound) else bound for bound in (row.low, row.high))

    assert displayed("smallest transmission angle") == (-math.inf, pytest.approx(40.0, rel=1e-12))
    assert displayed("largest transmission angle") == (pytest.approx(130.0, rel=1e-12), math.inf)
    assert displayed("swing angle") == (pytest.approx(1.0, rel=1e-12), pytest.approx(170.0, rel=1e-12))
    assert displayed("time ratio") == (-math.inf, 1.5)
    assert displayed("frame length") == (pytest.approx(1.0, rel=1e-12), pytest.approx(9000.0, rel=1e-12))
    assert displayed("crank / frame") == displayed("rocker / frame") == (0.01, 9.0)
    assert displayed("crank <= rocker")[1] == displayed("crank + frame <=")[1] == math.inf
    (row,) = (row for label, row in result.items() if "crank + frame <=" in label)
    slack = design["coupler"] + design["rocker"] - design["crank"] - design["frame"]
    reserve = slack * 1e3 - row.scale.to_display(row.value - row.low)
    assert reserve == pytest.approx(0.1 * max(design[name] for name in fourbar.LENGTHS), rel=1e-6)  # a ten-thousandth, in mm


def test_jets_take_every_function_that_has_a_rule():
    assert set(FUNCTIONS.values()) <= set(_CHAIN)


def test_the_time_ratio_is_away_from_its_kink():
    """Where crank and frame balance coupler and rocker the ratio has a kink; the cases must not sit on it."""
    for crank, coupler, rocker, _ in CRANK_ROCKERS[:2]:
        for frame in FRAMES:
            assert abs(crank**2 + frame**2 - coupler**2 - rocker**2) > 5e-3


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("k", range(16))
def test_angles_keep_their_sign_and_range(k, side):
    phi = side * (0.1 + k * math.pi / 16.0)
    direction = vector2d.unit(phi)
    assert float(vector2d.angle(direction)) == pytest.approx(phi, rel=SAME)
    ahead = vector2d.turn(direction, vector2d.unit(0.3))
    assert float(vector2d.angle_from(direction, ahead)) == pytest.approx(0.3, rel=SAME)
    assert float(vector2d.angle_from(ahead, direction)) == pytest.approx(-0.3, rel=SAME)


# --- planted defects: each check must see them ---------------------------------------------------------------------


def sine(phi0, phi):
    return [np.sin(phi0 * phi)]


SINE = Case("sine", sine, ((1.0,), (0.9,)), (0.3, 1.2))


def test_value_check_detects_a_different_batch():
    check_values(SINE)
    wrong = replace(SINE, function=lambda k, x: [np.sin(k * x) * (1.0 + 1e-9 * (np.size(x) > 1))])
    with pytest.raises(AssertionError):
        check_values(wrong)


def test_value_check_detects_different_symbols():
    check_values(SINE, sine)
    with pytest.raises(AssertionError):
        check_values(SINE, lambda k, x: [np.sin(k * x) * (1.0 + 1e-9)])
    with pytest.raises(AssertionError):
        check_values(SINE, lambda k, x: [np.sin(-k * x)])


def test_value_check_detects_a_clipped_square_root():
    """NaN outside the domain is part of the value: a formula that clips must not pass for one that does not."""
    honest = Case("root", lambda k, x: [vector2d.root(k * x)], ((1.0,),), (0.5,), undefined=((-1.0,),))
    check_values(honest)
    with pytest.raises(AssertionError):
        check_values(honest, lambda k, x: [np.sqrt(np.maximum(k * x, 0.0))])


def test_complex_step_detects_a_function_that_is_not_analytic():
    check_complex_step(SINE)
    with pytest.raises(AssertionError):
        check_complex_step(replace(SINE, function=lambda k, x: [x * np.abs(k * x)]))


def test_difference_check_detects_a_wrong_derivative():
    case = replace(SINE, function=lambda k, x: [np.abs(k * x)], complex_step=False)
    check_differences(case)
    with pytest.raises(AssertionError):
        check_differences(case, lambda k, x: [np.abs(k * x) + 1e-6 * x])


@pytest.mark.parametrize("part", [0, 1], ids=["rate", "acceleration"])
def test_jet_check_detects_a_wrong_rule(part, monkeypatch):
    check_jets(SINE, "scalar")
    right = _CHAIN[np.sin]

    def wrong(x, f):
        pair = list(right(x, f))
        pair[part] = -pair[part]
        return tuple(pair)

    monkeypatch.setitem(_CHAIN, np.sin, wrong)
    with pytest.raises(AssertionError):
        check_jets(SINE, "scalar")


# --- the programme -------------------------------------------------------------------------------------------------

FREE = {
    "crank": {"start": "100 mm", "bounds": ["50 mm", "200 mm"]},
    "frame": {"start": "500 mm", "bounds": ["300 mm", "900 mm"]},
}
ANGLES = {
    "from": {"start": "60 deg", "bounds": ["0 deg", "120 deg"]},
    "psi0": {"start": "110 deg", "bounds": ["30 deg", "170 deg"]},
}


@dataclass(frozen=True)
class Programme:
    """A problem, its programme, and whether complex numbers pass through all of its formulas."""

    rule: DesignProblem
    nlp: NLP
    complex_step: bool

    @property
    def points(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """x and p: the start, and random ones around it, all with a value; the objective on a scale of its own."""
        rng = np.random.default_rng(11)
        result = []
        for k in range(4):
            x = self.nlp.x_start * (1.0 + (0.06 * rng.uniform(-1.0, 1.0, len(self.nlp.x_start)) if k else 0.0))
            result.append((x, np.array([rng.uniform(0.01, 10.0), *self.nlp.p[1:]])))
        return result

    def numpy(self, x: Sequence[object], p: np.ndarray) -> tuple[object, np.ndarray]:
        """Objective and rows of the limits by numpy alone, from the same formulas but along another route."""
        names, count = [v.name for v in self.nlp.variables], self.nlp.exchange_count
        known, shares = p[1 : len(p) - count], p[len(p) - count :]
        named = dict(zip(names, x, strict=True)) | dict(zip(self.nlp.fixed, known, strict=True))
        size = self.rule.quantities["frame"].value
        values = {name: named[name] * (size if name in fourbar.LENGTHS else 1.0) for name in self.rule.quantities}
        start: StartPosition = self.rule.start_position(values)
        table = self.rule.law
        # the largest error counts at the exchange points first
        offsets, tabulated = np.append(shares * self.rule.span, table.offsets), np.append(np.zeros(count), table.tabulated)
        errors = terms.output_error(self.rule, values, start, offsets, tabulated)
        rows = [row.value for row in terms.rows(self.rule, values, self.rule.reach(values), size)]
        if self.rule.requirement.measure == "max":
            f, largest = x[-1], x[-1]
            rows += [value / p[0] for error in errors for value in (largest + error, largest - error)]
        else:
            f = np.sum(errors * errors) / (len(errors) if self.rule.requirement.measure == "rms" else 1)
        return f / p[0], np.array(rows)


@cache
def programme(name: str) -> Programme:
    rule, complex_step = {
        "shipped": lambda: (problem(), True),
        "rms, all lengths free": lambda: (problem(FREE, {"measure": "rms"}, ALL), True),
        "largest error": lambda: (problem(FREE, {"law": TABLE, "span": None, "points": None, "measure": "max"}), True),
        "largest error over the span": lambda: (problem(None, {"measure": "max", "points": 7}), True),
        "table": lambda: (problem(FREE, {"law": TABLE, "span": None, "points": None}), True),
        "angles free, right": lambda: (problem({**FREE, "assembly": "right"}, ANGLES), True),
        "time ratio": lambda: (problem(None, None, {**ALL, "time_ratio": [1.0, 1.5]}), False),
        "span": lambda: (problem(FREE, {"span": "-120 deg"}, {"crank": "span"}), False),
    }[name]()
    return Programme(rule, build(rule), complex_step)


PROGRAMMES = (
    "shipped",
    "rms, all lengths free",
    "largest error",
    "largest error over the span",
    "table",
    "angles free, right",
    "time ratio",
    "span",
)
every_programme = pytest.mark.parametrize("name", PROGRAMMES)


def check_programme_values(nlp: NLP, formulas: Programme) -> None:
    for x, p in formulas.points:
        f, g = nlp.values(x, p)
        point = nlp.at(x, p)
        assert point.finite
        expected_f, expected_g = formulas.numpy(x, p)
        np.testing.assert_allclose(f, expected_f, rtol=SAME)
        np.testing.assert_allclose(g, expected_g, rtol=SAME, atol=1e-14)
        np.testing.assert_allclose(point.f, f, rtol=1e-15)
        np.testing.assert_allclose(point.g, g, rtol=1e-15)


def check_programme_complex_step(nlp: NLP, formulas: Programme) -> None:
    for x, p in formulas.points:
        point = nlp.at(x, p)
        for i in range(len(x)):
            stepped = x.astype(complex)
            stepped[i] += 1j * TINY
            f, g = formulas.numpy(list(stepped), p)
            np.testing.assert_allclose(np.imag(f) / TINY, point.gradient[i], rtol=1e-11, atol=1e-13)
            np.testing.assert_allclose(np.imag(g.astype(complex)) / TINY, point.jacobian[:, i], rtol=SAME, atol=1e-13)


def differences(function: Callable[[np.ndarray], np.ndarray], x: np.ndarray, h: float = 1e-4) -> np.ndarray:
    """Five-point differences, one column per component of x."""
    columns = []
    for e in h * np.eye(len(x)):
        near, far = function(x + e) - function(x - e), function(x + 2 * e) - function(x - 2 * e)
        columns.append((8.0 * near - far) / (12.0 * h))
    return np.stack(columns, axis=-1)


def check_programme_differences(nlp: NLP, formulas: Programme) -> None:
    for x, p in formulas.points:
        point = nlp.at(x, p)
        slope = differences(lambda y, p=p: np.append(*nlp.values(y, p)[::-1]), x)
        scale = max(1.0, float(np.max(np.abs(point.gradient))))
        np.testing.assert_allclose(point.jacobian, slope[:-1], rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(point.gradient, slope[-1], rtol=1e-8, atol=1e-8 * scale)


def check_programme_hessian(nlp: NLP, formulas: Programme) -> None:
    rng = np.random.default_rng(13)
    for x, p in formulas.points:
        multipliers = rng.uniform(-1.0, 1.0, len(nlp.rows))

        def gradient(y: np.ndarray, p: np.ndarray = p, multipliers: np.ndarray = multipliers) -> np.ndarray:
            point = formulas.nlp.at(y, p)
            return point.gradient + point.jacobian.T @ multipliers

        expected = differences(gradient, x)
        result = nlp.hessian(x, p, multipliers)
        scale = max(1.0, float(np.max(np.abs(expected))))
        np.testing.assert_allclose(result, result.T, rtol=1e-12, atol=1e-13 * scale)
        np.testing.assert_allclose(result, expected, rtol=1e-8, atol=1e-8 * scale)


@every_programme
def test_programme_has_the_values_of_its_formulas(name):
    formulas = programme(name)
    check_programme_values(formulas.nlp, formulas)


@pytest.mark.parametrize("name", [n for n in PROGRAMMES if n not in ("time ratio", "span")])
def test_programme_derivatives_are_the_complex_step(name):
    formulas = programme(name)
    assert formulas.complex_step
    check_programme_complex_step(formulas.nlp, formulas)


@every_programme
def test_programme_derivatives_are_the_differences(name):
    formulas = programme(name)
    check_programme_differences(formulas.nlp, formulas)


@every_programme
def test_programme_hessian_is_the_difference_of_gradients(name):
    formulas = programme(name)
    check_programme_hessian(formulas.nlp, formulas)


@every_programme
def test_programme_starts_inside_its_bounds_and_every_row_has_a_label_and_a_bound(name):
    nlp = programme(name).nlp
    assert np.all((nlp.x_low <= nlp.x_start) & (nlp.x_start <= nlp.x_high))
    assert all(row.limit and row.label for row in nlp.rows)
    assert all(row.low <= row.high and (math.isfinite(row.low) or math.isfinite(row.high)) for row in nlp.rows)
    assert len(nlp.values(nlp.x_start, nlp.p)[1]) == len(nlp.rows)


def test_batch_of_designs_goes_through_the_objective_at_once():
    rule = problem()
    rng = np.random.default_rng(3)
    coupler, rocker = rng.uniform(0.38, 0.44, (5, 1)), rng.uniform(0.2, 0.3, (5, 1))
    values = {"crank": 0.1, "coupler": coupler, "rocker": rocker, "frame": 0.5}
    table = rule.law
    batch = terms.output_error(rule, values, rule.start_position(values), table.offsets, table.tabulated)
    assert batch.shape == (5, 30)
    nlp = programme("shipped").nlp
    for k in range(5):
        alone = nlp.residuals(np.array([coupler[k, 0], rocker[k, 0]]) / 0.5)
        np.testing.assert_allclose(-batch[k], alone, rtol=SAME, atol=1e-14)  # residuals are actual minus prescribed


def test_tracing_restores_what_was_set():
    before = casadi.GlobalOptions.getNumpyMode()
    seen = []

    def break_down() -> None:
        with symbols_in_numpy():
            seen.append(casadi.GlobalOptions.getNumpyMode())
            raise RuntimeError("planted")

    with pytest.raises(RuntimeError, match="planted"):
        break_down()
    assert seen == [-1]
    assert casadi.GlobalOptions.getNumpyMode() == before


class Doctored:
    """A programme whose first derivatives, or whose values, are slightly wrong."""

    def __init__(self, nlp: NLP, part: str) -> None:
        self.nlp, self.part, self.rows = nlp, part, nlp.rows

    def values(self, x, p):
        f, g = self.nlp.values(x, p)
        return f * (1.0 + 1e-9 * (self.part == "f")), g * (1.0 + 1e-9 * (self.part == "g"))

    def at(self, x, p):
        point = self.nlp.at(x, p)
        if self.part == "gradient":
            return point._replace(gradient=point.gradient * np.where(np.arange(len(x)) == 0, -1.0, 1.0))
        if self.part == "jacobian":
            return point._replace(jacobian=point.jacobian * (1.0 + 1e-6))
        return point

    def hessian(self, x, p, multipliers):
        sign = -1.0 if self.part == "hessian" else 1.0
        return self.nlp.hessian(x, p, sign * multipliers)


@pytest.mark.parametrize(
    ("part", "check"),
    [
        ("f", check_programme_values),
        ("g", check_programme_values),
        ("gradient", check_programme_complex_step),
        ("jacobian", check_programme_complex_step),
        ("gradient", check_programme_differences),
        ("jacobian", check_programme_differences),
        ("hessian", check_programme_hessian),
    ],
)
def test_programme_checks_see_a_planted_defect(part, check):
    formulas = programme("shipped")
    check(Doctored(formulas.nlp, "nothing"), formulas)
    with pytest.raises(AssertionError):
        check(Doctored(formulas.nlp, part), formulas)
