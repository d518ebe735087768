"""`optlink.gradient` and `optlink.hessian` against differences of what the validator measures, for every kind of requirement."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from tests.tiers import mostly_slow

QUICK = ("crank-rocker", "path-ellipse10", "function-log10")
KINDS = (*QUICK, "motion-3-poses", "transmission-optimal", "stroke-slider-crank", "law-slider-crank", "crank-rocker-robust")
STEP = 2e-5  # of central differences, as a share of a value


@cache
def beside_the_optimum(name: str) -> tuple[optlink.ProblemFile, dict[str, float]]:
    """A problem with one programme, and a design near its optimum, where no two positions share the largest value."""
    problem = optlink.load(name).variants()[0]
    if getattr(getattr(problem.model, "requirement", None), "rotation", "") == "either":
        problem = problem.override({"requirement.rotation": "clockwise"})
    best = optlink.solve(problem, starts=3).design
    return problem, {key: best[key] * (1.0 + 3e-4 * np.sin(7 * k + 1)) for k, key in enumerate(problem.model.free)}


def differences(of: Callable[[dict[str, float]], float], design: dict[str, float]) -> dict[str, float]:
    slopes = {}
    for name, value in design.items():
        step = STEP * max(abs(value), 1e-2)
        slopes[name] = (of({**design, name: value + step}) - of({**design, name: value - step})) / (2.0 * step)
    return slopes


def agree(exact: dict[str, float], other: dict[str, float], design: dict[str, float], tolerance: float) -> None:
    sizes = np.array([max(abs(value), 1e-2) for value in design.values()])
    one, two = (np.array([slopes[name] for name in design]) * sizes for slopes in (exact, other))
    np.testing.assert_allclose(one, two, rtol=0, atol=tolerance * np.max(np.abs(two)))


@pytest.mark.parametrize("name", mostly_slow(KINDS, *QUICK))
def test_the_gradient_is_that_of_the_measured_objective(name: str) -> None:
    problem, design = beside_the_optimum(name)
    measured = differences(lambda given: optlink.validate(problem, given).objective, design)
    assert max(map(abs, measured.values())) > 0.0
    agree(optlink.gradient(problem, design), measured, design, 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", mostly_slow(KINDS, *QUICK))
def test_the_hessian_is_that_of_differences_of_the_gradient(name: str) -> None:
    problem, design = beside_the_optimum(name)
    curvature = optlink.hessian(problem, design)
    for name_of in design:
        changes = differences(lambda given, name_of=name_of: optlink.gradient(problem, given)[name_of], design)
        sizes = {key: max(abs(value), 1e-2) for key, value in design.items()}
        largest = max(abs(curvature[a][b]) * sizes[a] * sizes[b] for a in design for b in design)
        for key, change in changes.items():
            assert abs(curvature[name_of][key] - change) * sizes[name_of] * sizes[key] < 1e-3 * largest


def test_derivatives_of_a_transmission_angle_are_those_of_the_law_of_cosines() -> None:
    b, c, far = 0.42, 0.24, 0.6  # m: coupler, rocker, frame + crank
    design = {"coupler": b, "rocker": c}
    name = "largest transmission angle"  # where the crank points away from the rocker
    slopes, curvature = (of("crank-rocker", design, name) for of in (optlink.gradient, optlink.hessian))
    top = b * b + c * c - far * far
    assert slopes["coupler"] == pytest.approx(1.0 / c - top / (2.0 * b * b * c), rel=1e-9)
    assert slopes["rocker"] == pytest.approx(1.0 / b - top / (2.0 * b * c * c), rel=1e-9)
    mixed = -1.0 / b**2 - 1.0 / c**2 + top / (2.0 * b * b * c * c)
    assert curvature["coupler"]["rocker"] == pytest.approx(mixed, rel=1e-9)
    assert curvature["coupler"]["coupler"] == pytest.approx(-1.0 / (b * c) + top / (b**3 * c), rel=1e-9)


@pytest.mark.slow
def test_derivatives_of_extremes_are_those_of_the_fine_motion() -> None:
    @optlink.limit(unit="m/s", max=3.5)
    def ram_speed(machine):  # type: ignore[no-untyped-def]
        return machine.slides["F"][1]

    angles = ["30 deg", "150 deg"]  # far from both: no peak is active
    problem = optlink.load("shaper-design", {**ram_speed.changes, "limits.transmission_angle": angles})
    design = {name: problem.model.quantities[name].value for name in problem.model.free} | {"C.x": 0.03, "coupler.length": 0.25}

    @cache
    def measured(given: tuple[tuple[str, float], ...]) -> dict[str, float]:
        moved = optlink.motion(problem, np.linspace(0.0, 2.0 * np.pi, 7_201), design=dict(given))
        rod = moved.position("E") - moved.position("D")
        angle = np.arccos(rod[:, 1] / np.hypot(*rod.T))  # to the normal of the guide of the ram
        return {"least": angle.min(), "largest": angle.max(), "speed": moved.velocity("E")[:, 0].max()}

    key = "limits.transmission_angle"
    for of, name in {
        "least transmission angle at E": "least",  # [rad]
        "largest transmission angle at E": "largest",
        "ram_speed": "speed",
        f"{key}.max": "",
    }.items():
        if not name:
            with pytest.raises(InputError, match="Give one of largest transmission angle at E, largest transmission angle at G"):
                optlink.gradient(problem, design, of)
            continue
        slopes = differences(lambda given, name=name: measured(tuple(given.items()))[name], design)
        agree(optlink.gradient(problem, design, of), slopes, design, 5e-4)


def test_an_own_objective_has_the_name_of_its_function() -> None:
    @optlink.objective(unit="rad/s", measure="rms")
    def coupler_speed(machine):  # type: ignore[no-untyped-def]
        return machine.state("coupler").omega

    changes = {**coupler_speed.changes, "requirement.measure": "max", "requirement.tolerance": "3 deg"}
    problem, design = optlink.load("crank-rocker", changes), {"coupler": 0.42, "rocker": 0.24}
    assert optlink.gradient(problem, design, "coupler_speed") == optlink.gradient(problem, design)
    side, row = (optlink.gradient(problem, design, of) for of in ("limits.transmission_angle.max", "largest transmission angle"))
    assert side == row != optlink.gradient(problem, design, "limits.transmission_angle.min")


def test_a_design_may_have_texts_with_units() -> None:
    texts = {"coupler": "412 mm", "rocker": "23.2 cm"}
    numbers = {"coupler": 0.412, "rocker": 0.232}
    assert optlink.gradient("crank-rocker", texts) == pytest.approx(optlink.gradient("crank-rocker", numbers), rel=1e-12)
    assert optlink.validate("crank-rocker", texts).objective == pytest.approx(optlink.validate("crank-rocker", numbers).objective)
    whole = optlink.analyze("crank-rocker", 12, design=texts)
    assert whole.design["rocker"] == pytest.approx(0.232)


def test_a_corner_of_the_objective_is_refused() -> None:
    problem = optlink.load("function-log10").variants()[0]
    best = optlink.solve(problem, starts=3).design
    with pytest.raises(InputError, match="the objective has a corner at this design"):
        optlink.gradient(problem, {name: best[name] for name in problem.model.free})


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: optlink.gradient("crank-rocker", {"coupler": 0.4, "rocker": 0.2}, "swing"), r'of = "swing": no such limit'),
        (
            lambda: optlink.gradient("crank-rocker", {"coupler": 0.4, "rocker": 0.2}, "limits.transmission_angle"),
            r"several limits have this key. Give one of largest transmission angle, smallest transmission angle$",
        ),
        (lambda: optlink.hessian("crank-rocker", {"coupler": 0.4}), r"the design lacks rocker"),
        (
            lambda: optlink.gradient("crank-rocker", {"coupler": "0.4 kg", "rocker": 0.2}),
            r'design\.coupler = "0\.4 kg"',
        ),
        (lambda: optlink.gradient("crank-rocker", {"coupler": 0.2, "rocker": 0.2}), r"cannot be assembled at every position"),
        (lambda: optlink.gradient("shaper", {}), r"shaper\.toml"),
    ],
)
def test_what_has_no_derivatives_is_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        call()
    assert len(str(caught.value).splitlines()) == 1
