"""Tolerances of the error of every requirement: by central differences and pseudo-random linkages of own formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.studies import tolerance
from tests.studies.test_robust_kinds import LINKS, PATH, SLIDE, SLIDE_TEXTS, differences, distances, slide_errors, texts

COUNT = 20_000


def given(tolerances):
    return [f"{name}={text}" for name, text in texts(tolerances).items()]


@pytest.fixture(scope="module")
def arc():
    return optlink.solve(optlink.load("path-arc5"), starts=120, certify=False)


def sampled(tolerances, seed=3):
    random = np.random.default_rng(seed)
    return {name: value / 3.0 * random.standard_normal((COUNT, 1)) for name, value in tolerances.items()}


@pytest.mark.slow
def test_the_error_of_points_is_their_distance(arc):
    file, design = arc.best.problem, {name: arc.design[name] for name in arc.problem.model.free}
    result = tolerance(file, given(PATH), limit="0.015 mm", samples=1 << 15, design=design)
    problem, nominal = arc.best.task, result.nominal
    assert (nominal.name, nominal.unit, result.display_unit) == ("error", "m", "mm")
    np.testing.assert_allclose(nominal.base, np.linalg.norm(distances(problem, design), axis=0), atol=1e-12)
    slopes = differences(lambda by: distances(problem, design, by), PATH, 1e-8)
    np.testing.assert_allclose(result.effects, np.linalg.norm(slopes, axis=1), rtol=1e-6)
    widths = np.array(list(PATH.values()))[:, None]
    np.testing.assert_allclose(result.worst[1], np.sum(widths * result.effects, axis=0), rtol=1e-12)
    np.testing.assert_allclose(result.sigma, np.sqrt(np.sum((widths / 3.0 * result.effects) ** 2, axis=0)), rtol=1e-12)
    lengths = np.linalg.norm(distances(problem, design, sampled(PATH)), axis=0)
    share = np.mean(np.max(lengths, axis=1) <= 0.015e-3)
    assert 0.05 < share < 0.95
    tight = 4.0 * math.sqrt(share * (1.0 - share) / COUNT)
    assert result.monte_carlo.share == pytest.approx(share, abs=tight)
    assert result.monte_carlo.linear_share == pytest.approx(share, abs=tight)
    np.testing.assert_allclose(result.monte_carlo.mean, np.mean(lengths - nominal.base, axis=0), rtol=0.03)
    np.testing.assert_allclose(result.monte_carlo.sigma, np.std(lengths, axis=0), rtol=0.03)


def test_a_point_that_is_met_exactly_scatters_too():
    """The length of a vector has a kink where it vanishes: its linear model keeps both components."""
    result = tolerance(optlink.load("motion-3-poses"), ["crank=0.1 mm", "coupler=0.1 mm"], limit="0.5 mm", samples=1 << 14)
    assert np.max(result.nominal.base) < 1e-12
    assert np.all(result.effects > 0.0)
    assert np.max(np.abs(result.worst[0])) < 1e-12  # a distance is not negative
    assert result.monte_carlo.share == pytest.approx(result.monte_carlo.linear_share, abs=0.01)
    assert np.all(result.monte_carlo.most <= result.worst[1] * 1.7)  # normal deviations reach beyond three sigma


@pytest.mark.slow
def test_the_error_of_a_slide():
    problem = optlink.load("law-slider-crank")
    result = tolerance(problem, [f"{name}={text}" for name, text in SLIDE_TEXTS.items()], limit="0.6 mm", samples=1 << 15)
    design = {name: result.nominal.sizes[name] for name in ("crank.length", "rod.length", "G.offset")} | result.nominal.further
    drawn = -slide_errors(design)[0]
    np.testing.assert_allclose(result.nominal.base, drawn, atol=1e-12)
    np.testing.assert_allclose(result.by, -differences(lambda by: slide_errors(design, by), SLIDE)[:, 0], rtol=1e-5, atol=1e-8)
    largest = np.max(np.abs(slide_errors(design, sampled(SLIDE))[0]), axis=1)
    share = np.mean(largest <= 0.6e-3)
    assert 0.05 < share < 0.95
    assert result.monte_carlo.share == pytest.approx(share, abs=4.0 * math.sqrt(share * (1.0 - share) / COUNT))


@pytest.mark.slow
def test_the_error_of_a_transmission_is_a_cosine():
    problem = optlink.load("transmission-optimal")
    result = tolerance(problem, given(LINKS), limit="53 deg", samples=1 << 14)
    sizes, phi = result.nominal.sizes, result.nominal.crank_angles

    def cosine(by=None):
        size = {name: value + (by or {}).get(name, 0.0) for name, value in sizes.items()}
        far = size["crank"] ** 2 + size["frame"] ** 2 - 2.0 * size["crank"] * size["frame"] * np.cos(phi)
        return (size["coupler"] ** 2 + size["rocker"] ** 2 - far) / (2.0 * size["coupler"] * size["rocker"])

    np.testing.assert_allclose(result.nominal.base, cosine(), atol=1e-12)
    np.testing.assert_allclose(result.by, differences(cosine, LINKS, 1e-7), rtol=1e-6)
    assert result.limit == pytest.approx(math.sin(math.radians(53.0)))
    share = np.mean(np.max(np.abs(cosine(sampled(LINKS))), axis=1) <= result.limit)
    assert result.monte_carlo.share == pytest.approx(share, abs=0.015)
    assert tolerance(problem, given(LINKS), limit="0.8", samples=0).limit == 0.8


def test_several_requirements_have_errors_of_their_own():
    problem = optlink.load("crank-rocker")
    table = problem.raw["requirement"]
    several = problem.with_tables(
        {
            **{key: value for key, value in problem.raw.items() if key not in ("requirement", "expected")},
            "requirements": [
                {**table, "name": "swing"},
                {"kind": "transmission", "name": "push", "tolerance": 0.8},
            ],
        }
    )
    design = {"coupler": 0.41, "rocker": 0.234}
    single = tolerance(problem, ["coupler=0.1 mm"], samples=0, design=design)
    both = tolerance(several, ["coupler=0.1 mm"], samples=0, design=design)
    assert both.nominal.name == "swing.error"
    np.testing.assert_allclose(both.by, single.by, rtol=1e-12)
    assert tolerance(several, ["coupler=0.1 mm"], "push.error", samples=0, design=design).nominal.unit == ""


# --- robust designs -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_robust_path_has_the_largest_margin_of_several(arc):
    problem = optlink.load("path-arc5")
    three = tolerance(problem, given(PATH), robust=3.0, samples=1 << 14, limit="0.05 mm")
    assert three.robust.result.valid
    assert three.robust.result.objective < three.robust.before
    assert three.monte_carlo.share >= three.unrobust.share
    margin = tolerance(problem, given(PATH), robust="margin", samples=0, limit="0.15 mm")
    assert margin.robust.result.objective == pytest.approx(0.15e-3, rel=1e-4)
    assert margin.robust.sigmas > 3.0


@pytest.mark.slow
def test_the_largest_yield_of_a_path():
    problem = optlink.load("path-arc5")
    result = tolerance(problem, given(PATH), robust="yield", samples=1 << 13, limit="0.05 mm")
    assert result.robust.result.valid
    assert result.monte_carlo.share >= result.unrobust.share


@pytest.mark.slow
def test_the_command_judges_a_path(tmp_path):
    arguments = ["study", "tolerance", "path-arc5", "--tolerance", "crank=0.01 mm", "--limit", "0.02 mm", "--samples", "4096"]
    done = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "yield, within 0.02 mm" in " ".join(done.stdout.split())
    assert (tmp_path / "band.png").stat().st_size > 5000
    columns = (tmp_path / "tolerance.csv").read_text().splitlines()[0].split(",")
    assert "judged_m" in columns
    arguments = [
        "study",
        "tolerance",
        "transmission-optimal",
        "--tolerance",
        "coupler=1 mm",
        "--limit",
        "53 deg",
        "--samples",
        "512",
    ]
    done = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "other")])
    assert done.exit_code == 0, done.output
    assert "judged" in (tmp_path / "other" / "tolerance.csv").read_text().splitlines()[0].split(",")
