"""Robust laws of slides, paths, poses and transmissions: by formulas of their own, samples, corners and neighbours."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.validation import validate

SLIDE = {"crank.length": 0.1e-3, "rod.length": 0.2e-3, "G.offset": 0.2e-3, "G.direction": math.radians(0.1)}
SLIDE_TEXTS = {"crank.length": "0.1 mm", "rod.length": "0.2 mm", "G.offset": "0.2 mm", "G.direction": "0.1 deg"}
PATH = {"crank": 0.01e-3, "coupler": 0.02e-3, "P.along": 0.01e-3}
POSES = {"crank": 0.1e-3, "coupler": 0.2e-3}
LINKS = {"coupler": 2e-3, "rocker": 1e-3}


def texts(tolerances):
    return {name: f"{1e3 * value!r} mm" for name, value in tolerances.items()}


def differences(function, names, step=1e-6):
    """Central differences of a function of deviations by each of them: (names, ...)."""
    return np.array([(function({name: step}) - function({name: -step})) / (2.0 * step) for name in names])


def with_scatter(error, slopes, tolerances, robust):
    """Length of the error (components, ...) with its scatter, from the definitions."""
    sizes = np.linalg.norm(slopes, axis=1)  # (names, ...)
    widths = np.array(list(tolerances.values())).reshape(-1, *[1] * (sizes.ndim - 1))
    if robust == "worst case":
        return np.linalg.norm(error, axis=0) + np.sum(widths * sizes, axis=0)
    if robust == "expected value":
        return np.sqrt(np.sum(error**2, axis=0) + np.sum((widths / 3.0 * sizes) ** 2, axis=0))
    return np.linalg.norm(error, axis=0) + float(robust.split()[0]) * np.sqrt(np.sum((widths / 3.0 * sizes) ** 2, axis=0))


def reduced(lengths, measure):
    return (
        np.max(lengths)
        if measure == "max"
        else np.sum(lengths**2)
        if measure == "sum of squares"
        else np.sqrt(np.mean(lengths**2))
    )


def four_bar(design, side, phi, by=None):
    """Joint C and point P of a four-bar on the x axis, by complex numbers."""
    size = {name: value + (by or {}).get(name, 0.0) for name, value in design.items()}
    b, d = size["crank"] * np.exp(1j * phi), size["frame"]
    far = np.abs(d - b)
    along = (size["coupler"] ** 2 - size["rocker"] ** 2 + far**2) / (2.0 * far)
    c = b + (d - b) / far * (along + 1j * side * np.sqrt(size["coupler"] ** 2 - along**2))
    turned = (c - b) / np.abs(c - b)
    return c, b + turned * (size.get("P.along", 0.0) + 1j * size.get("P.across", 0.0)), turned


def no_neighbour_is_better(figure, design, best, sizes=(1e-3, 1e-4, 1e-5)):
    """A design is a local optimum of its own formula, which is inf beyond limits: no random step improves it."""
    random, names = np.random.default_rng(1), list(design)
    for size in sizes:
        for _ in range(300):
            step = random.standard_normal(len(names))
            other = {name: value * (1.0 + size * by) for (name, value), by in zip(design.items(), step, strict=True)}
            assert figure(other) > best * (1.0 - 1e-7), (size, other)


# --- the slide of a slider-crank ---------------------------------------------------------------------------------------------


def slide_errors(design, by=None, count=31):
    value = {name: number + (by or {}).get(name, 0.0) for name, number in design.items()}
    phi = design["start"] + np.linspace(0.0, math.pi / 2.0, count)
    turned = (by or {}).get("G.direction", 0.0)
    b = value["crank.length"] * np.exp(1j * (phi - turned))  # in the frame of the guide
    slide = b.real + np.sqrt(value["rod.length"] ** 2 - (b.imag - value["G.offset"]) ** 2)
    return (slide - (design["zero"] - 0.04 * (phi - design["start"]) / (math.pi / 2.0)))[None, :]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robust", "measure"),
    [
        ("expected value", "sum of squares"),
        ("3 sigma", "max"),
        ("worst case", "max"),
    ],
)
def test_a_law_of_a_slider_is_robust(robust, measure):
    changes = {"tolerances": SLIDE_TEXTS, "requirement.robust": robust, "requirement.measure": measure}
    result = optlink.solve(optlink.load("law-slider-crank", changes), "both", certify=False)
    assert result.valid, result.validation.failed
    count = 4001 if measure == "max" else 31

    def figure(design):
        aligned = (design["crank.length"] + abs(design["G.offset"])) / design["rod.length"]  # the cosine of its least angle
        if abs(design["G.offset"]) > 0.04 * (1.0 + 1e-9) or aligned > math.cos(math.radians(30.0)) * (1.0 + 1e-9):
            return math.inf
        slopes = differences(lambda by: slide_errors(design, by, count), SLIDE)
        return reduced(with_scatter(slide_errors(design, None, count), slopes, SLIDE, robust), measure)

    design = {name: result.design[name] for name in result.problem.model.free}
    assert result.objective == pytest.approx(figure(design), rel=1e-6)
    no_neighbour_is_better(figure, design, figure(design))


@pytest.mark.slow
def test_the_expected_square_of_a_slide_is_that_of_samples():
    changes = {"tolerances": SLIDE_TEXTS, "requirement.robust": "expected value"}
    problem = optlink.load("law-slider-crank", changes)
    result = optlink.solve(problem, certify=False)
    random, count = np.random.default_rng(5), 20_000
    by = {name: value / 3.0 * random.standard_normal((count, 1)) for name, value in SLIDE.items()}
    design = {name: result.design[name] for name in (*result.problem.model.free,)}
    squares = np.sum(slide_errors(design, by)[0] ** 2, axis=1)
    assert result.objective == pytest.approx(np.mean(squares), abs=4.0 * np.std(squares) / math.sqrt(count))
    assert result.objective - np.sum(slide_errors(design) ** 2) > 20.0 * np.std(squares) / math.sqrt(count)


# --- points, poses, transmission ---------------------------------------------------------------------------------------------


def distances(problem, design, by=None):
    """Deviations (2, points) of a path whose four-bar stands on the x axis."""
    phi, columns = problem.data.offsets, problem.data.columns
    point = four_bar(design, problem.four_bar.side, phi, by)[1]
    return np.array([point.real - columns[:, 0], point.imag - columns[:, 1]])


@pytest.mark.slow
@pytest.mark.parametrize(("robust", "measure"), [("2 sigma", "max"), ("worst case", "max"), ("expected value", "rms")])
def test_a_path_is_robust(robust, measure):
    changes = {"tolerances": texts(PATH), "requirement.robust": robust, "requirement.measure": measure}
    result = optlink.solve(optlink.load("path-arc5", changes), starts=120, certify=False)
    assert result.valid, result.validation.failed
    problem = result.best.task

    def figure(design):
        if min(design[name] for name in ("crank", "coupler", "rocker", "frame")) < 0.05e-3:
            return math.inf
        if max(abs(value) for value in design.values()) > 0.05 * (1.0 + 1e-9):
            return math.inf
        ratios = [design[name] / design["frame"] for name in ("crank", "coupler", "rocker")]
        if not 0.05 * (1.0 - 1e-9) <= min(ratios) <= max(ratios) <= 20.0 * (1.0 + 1e-9):
            return math.inf
        slopes = differences(lambda by: distances(problem, design, by), PATH, 1e-8)
        return reduced(with_scatter(distances(problem, design), slopes, PATH, robust), measure)

    design = {name: result.design[name] for name in result.problem.model.free}
    assert result.objective == pytest.approx(figure(design), rel=1e-6)
    drawn = reduced(np.linalg.norm(distances(problem, design), axis=0), measure)
    assert drawn < 0.9 * result.objective  # the tolerances count
    if robust == "worst case":  # the bound holds at every corner of the box of deviations, and nearly is one of them
        corners = [
            np.max(np.linalg.norm(distances(problem, design, dict(zip(PATH, signs, strict=True))), axis=0))
            for signs in itertools.product(*((-value, value) for value in PATH.values()))
        ]
        assert 0.8 * result.objective < max(corners) <= result.objective * (1.0 + 1e-3)


@pytest.mark.parametrize(
    ("kind", "tolerances", "robust", "measure"),
    [
        ("path-arc5", PATH, "2 sigma", "max"),
        ("path-arc5", PATH, "worst case", "max"),
        ("path-arc5", PATH, "expected value", "rms"),
        ("motion-5-poses", POSES, "2 sigma", "max"),
        ("motion-5-poses", POSES, "worst case", "max"),
        ("motion-5-poses", POSES, "expected value", "sum of squares"),
        ("transmission-optimal", LINKS, "3 sigma", "max"),
        ("transmission-optimal", LINKS, "expected value", "rms"),
    ],
)
def test_the_programme_and_the_validator_agree(kind, tolerances, robust, measure):
    """Exact derivatives of the traced linkage against central differences of the motion, at designs that are no optima."""
    from optlink.optimization.programme import build

    changes = {"tolerances": texts(tolerances), "requirement.robust": robust, "requirement.measure": measure}
    problem = optlink.load(kind, {**changes, "mechanism.assembly": "left"}).spec
    designs = {
        "path-arc5": {"crank": 2e-3, "coupler": 4e-3, "rocker": 4.5e-3, "frame": 5e-3, "P.along": 1e-3, "P.across": 3e-3},
        "motion-5-poses": {
            **{"crank": 0.04, "coupler": 0.12, "rocker": 0.13, "frame": 0.1, "P.along": 0.05, "P.across": 0.03},
            **{"A.x": 0.01, "A.y": 0.02, "direction": 0.3, "mark": 0.2},
        },
        "transmission-optimal": {"crank": 0.045, "coupler": 0.11, "rocker": 0.08},
    }
    design = problem.design(designs[kind])
    nlp = build(problem)
    angles = problem.data.offsets if problem.data.offsets is not None else np.linspace(0.5, 4.0, 5)
    given = {f"crank angle of point {i + 1}": angle for i, angle in enumerate(angles)} if problem.data.offsets is None else {}
    x = nlp.x_of({**design, **given})
    objective = nlp.measure.of(nlp.residuals(x)) if measure != "max" else float(np.max(nlp.residuals(x)))
    checked = validate(problem, design, angles)
    if kind != "transmission-optimal":  # whose largest cosine counts between the positions too
        assert checked.objective == pytest.approx(objective, rel=1e-7)
    nominal = optlink.load(kind, {**changes, "requirement.robust": None, "mechanism.assembly": "left"}).spec
    assert checked.objective > validate(nominal, design, angles).objective * (1.0 + 1e-9)
    point, h = nlp.at(x, nlp.p), 1e-6
    for i in range(len(x)):
        step = h * np.eye(len(x))[i]
        (f1, g1), (f0, g0) = nlp.values(x + step, nlp.p), nlp.values(x - step, nlp.p)
        assert point.gradient[i] == pytest.approx((f1 - f0) / (2.0 * h), rel=1e-5, abs=1e-7)
        np.testing.assert_allclose(point.jacobian[:, i], (g1 - g0) / (2.0 * h), rtol=1e-4, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("robust", "measure"), [("3 sigma", "max"), ("worst case", "max")])
def test_a_transmission_is_robust_over_the_revolution(robust, measure):
    changes = {"tolerances": texts(LINKS), "requirement.robust": robust, "requirement.measure": measure}
    result = optlink.solve(optlink.load("transmission-optimal", changes), certify=False)
    assert result.valid, result.validation.failed
    phi = np.linspace(0.0, 2.0 * math.pi, 20_001)

    def cosine(by=None):
        size = {name: result.design[name] + (by or {}).get(name, 0.0) for name in ("crank", "coupler", "rocker", "frame")}
        far = size["crank"] ** 2 + size["frame"] ** 2 - 2.0 * size["crank"] * size["frame"] * np.cos(phi)
        return ((size["coupler"] ** 2 + size["rocker"] ** 2 - far) / (2.0 * size["coupler"] * size["rocker"]))[None, :]

    lengths = with_scatter(cosine(), differences(cosine, LINKS), LINKS, robust)
    assert result.objective == pytest.approx(np.max(lengths), rel=1e-7)
    plain = optlink.solve(optlink.load("transmission-optimal"), certify=False)
    assert result.objective > plain.objective


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"requirement.robust": "3 sigma", "requirement.measure": "max"}, "a robust design needs tolerances"),
        ({"requirement.robust": "3 sigma", "tolerances": {"crank": "0.1 mm"}}, "not compatible with measure"),
        (
            {"requirement.robust": "3 sigma", "requirement.measure": "max", "tolerances": {"B.clearance": "0.1 mm"}},
            "the effect of this clearance on P.x is not that of the length of one link",
        ),
    ],
)
def test_robust_paths_without_sense_are_refused(changes, words):
    with pytest.raises(InputError, match=words):
        _ = optlink.load("path-arc5", changes).spec
