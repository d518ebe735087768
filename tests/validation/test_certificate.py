"""Check of stored certificates: sound ones hold, every planted defect is found."""

from __future__ import annotations

import copy
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import flint
import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.optimization.box_models import box_problem
from optlink.problem.function import DesignProblem
from optlink.tasks.results.certificate import certificate_document
from optlink.validation.ball_formulas import BallProblem
from optlink.validation.balls import Ball, box_minimum, lower_bound, positive_definite, tangent_bound
from optlink.validation.certificate import CertificateCheck, _model, check_certificate
from optlink.validation.function import validate
from optlink.validation.partition import uncovered
from tests.cli.test_cli import run

NARROW = {"mechanism.coupler": "412..418 mm", "mechanism.rocker": "228..232 mm", "requirement.points": 8}
NO_DESIGN = {"limits.transmission_angle": ["80 deg", "100 deg"]}
Document = dict[str, Any]


def _certificate(problem: Any, gap: float = 1e-6) -> Document:
    result = optlink.solve(problem, certify=True, gap=gap)
    return json.loads(json.dumps(certificate_document(result.certificate, result)))


@pytest.fixture(scope="module")
def narrow() -> tuple[Any, Document]:
    problem = optlink.load("crank-rocker", NARROW)
    return problem, _certificate(problem)


def _checked(problem: Any, document: Document, folder: Path) -> CertificateCheck:
    path = folder / "certificate.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    return check_certificate(problem, path)


def _failed(result: CertificateCheck) -> str:
    assert not result.valid
    return "; ".join(check.name for check in result.checks if not check.passed)


def test_a_sound_certificate_holds(narrow: tuple[Any, Document], tmp_path: Path) -> None:
    problem, document = narrow
    result = _checked(problem, document, tmp_path)
    assert result.valid, result.checks
    assert result.boxes == len(document["covers"][0]["test"]) > 10
    assert result.gap <= 1e-6
    assert result.objective == pytest.approx(document["objective"], rel=1e-12)
    assert 0.0 < result.gap == pytest.approx(1.0 - document["lower_bound"] / document["objective"], rel=1e-6)


def test_a_certificate_that_no_design_is_feasible_holds(tmp_path: Path) -> None:
    problem = optlink.load("crank-rocker", NO_DESIGN)
    document = _certificate(problem)
    assert document["status"] == "infeasible"
    result = _checked(problem, document, tmp_path)
    assert result.valid, result.checks
    feasible = optlink.load("crank-rocker")  # the same boxes, of a problem that has designs
    assert "violates none of the limits" in " ".join(
        check.name for check in _checked(feasible, document | {"problem_hash": feasible.hash}, tmp_path).checks
    )


def test_a_certificate_holds_where_no_design_variable_changes_the_missed_limit(tmp_path: Path) -> None:
    fixed = {"mechanism.coupler": "300 mm", "mechanism.rocker": "200 mm", "requirement.psi0": {"bounds": ["60 deg", "120 deg"]}}
    problem = optlink.load("crank-rocker", fixed)
    result = _checked(problem, _certificate(problem), tmp_path)
    assert result.valid, result.checks


@pytest.mark.slow
def test_a_certificate_of_a_linkage_of_fixed_lengths_holds(tmp_path: Path) -> None:
    """Of a slider-crank whose slide at the start alone is free, no limit depends on the design variable."""
    fixed = {
        "mechanism.links.crank.length": "50 mm",
        "mechanism.links.rod.length": "150 mm",
        "mechanism.guides.G.offset": "10 mm",
    }
    problem = optlink.load("law-slider-crank", fixed | {"requirement.start": "20 deg"})
    document = _certificate(problem)
    assert document["lower_bound"] == pytest.approx(document["objective"], rel=1e-6)
    assert _checked(problem, document, tmp_path).valid


def _box_removed(document: Document) -> None:
    for name in ("low", "high", "test", "multipliers"):
        del document["covers"][0][name][7]


def _box_shifted(document: Document) -> None:
    low, high = (document["covers"][0][name][7] for name in ("low", "high"))
    low[0], high[0] = low[0] + 1e-15, high[0] + 1e-15


def _raised_above(document: Document) -> None:
    document["lower_bound"] = document["objective"] * (1.0 + 1e-9)


def _design_changed(document: Document) -> None:
    document["design"]["coupler"] += 1e-6


def _start_angle_changed(document: Document) -> None:
    document["design"]["phi0"] += 1e-6


def _objective_changed(document: Document) -> None:
    document["objective"] *= 1.0 + 1e-8


def _cover_removed(document: Document) -> None:
    document["covers"][0]["assembly"] = "right"


@pytest.mark.parametrize(
    ("defect", "words"),
    [
        (_box_removed, "uncovered"),
        (_box_shifted, "uncovered"),
        (_raised_above, "lower bound, at most the objective"),
        (_design_changed, "objective of the design"),
        (_start_angle_changed, "design within bounds"),
        (_objective_changed, "objective of the design"),
        (_cover_removed, "assembly modes"),
    ],
)
def test_every_defect_is_detected(
    narrow: tuple[Any, Document], defect: Callable[[Document], None], words: str, tmp_path: Path
) -> None:
    problem, document = narrow
    document = copy.deepcopy(document)
    defect(document)
    assert words in _failed(_checked(problem, document, tmp_path))


@pytest.mark.slow
def test_a_bound_between_optimum_and_a_worse_design_is_refuted(narrow: tuple[Any, Document], tmp_path: Path) -> None:
    problem, document = narrow
    model = problem.model
    assert isinstance(model, DesignProblem)
    worse = model.design({"coupler": 0.4155, "rocker": 0.2315})
    assert validate(model, worse).valid
    objective = validate(model, worse).objective
    assert objective > 1.001 * document["objective"]
    for bound, holds in ((document["lower_bound"], True), (0.5 * (objective + document["objective"]), False)):
        result = _checked(problem, document | {"design": worse, "objective": objective, "lower_bound": bound}, tmp_path)
        assert result.valid == holds
        if not holds:
            assert "violates none of the limits and has a lower objective" in " ".join(check.name for check in result.checks)


def test_wrong_multipliers_do_not_matter(narrow: tuple[Any, Document], tmp_path: Path) -> None:
    problem, document = narrow
    document = copy.deepcopy(document)
    for row in document["covers"][0]["multipliers"]:
        row.update({str(k): 3.0 for k in range(4)})
    result = _checked(problem, document | {"lower_bound": 0.9 * document["objective"]}, tmp_path)
    assert result.valid, result.checks


def _negative(document: Document) -> None:
    document["covers"][0]["multipliers"][3]["5"] = -1.0


def _no_number(document: Document) -> None:
    document["covers"][0]["low"][2][1] = float("nan")


def _null(document: Document) -> None:
    document["covers"][0]["low"][2][1] = None


def _short(document: Document) -> None:
    document["covers"][0]["multipliers"].pop()


def _no_limit(document: Document) -> None:
    document["covers"][0]["multipliers"][3]["99"] = 1.0


def _no_boxes(document: Document) -> None:
    document["covers"] = []


def _others(document: Document) -> None:
    document["unknowns"] = ["rocker", "coupler"]


def _no_objective(document: Document) -> None:
    document["objective"] = None


def _unknown_key(document: Document) -> None:
    document["more"] = 1


def _other_problem(document: Document) -> None:
    document["problem_hash"] = "0123456789abcdef"


def _a_result(document: Document) -> None:
    document["schema"] = "optlink/result/1"


@pytest.mark.parametrize(
    ("defect", "words"),
    [
        (_negative, "a multiplier is not negative"),
        (_no_number, "not finite"),
        (_null, "rows of 2 finite numbers"),
        (_short, "rows, found"),
        (_no_limit, "not one of the 9 limits"),
        (_no_boxes, "no boxes"),
        (_others, "the design variables of the problem are coupler, rocker"),
        (_no_objective, "objective: the result is damaged: this is missing"),
        (_unknown_key, "no result has this key"),
        (_other_problem, "certificate of another problem"),
        (_a_result, "not a certificate"),
    ],
)
def test_a_damaged_file_is_refused_in_one_sentence(
    narrow: tuple[Any, Document], defect: Callable[[Document], None], words: str, tmp_path: Path
) -> None:
    problem, document = narrow
    document = copy.deepcopy(document)
    defect(document)
    with pytest.raises(InputError) as error:
        _checked(problem, document, tmp_path)
    assert words in str(error.value)
    assert str(tmp_path) in str(error.value)
    assert "\n" not in str(error.value)


def test_command(narrow: tuple[Any, Document], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    document = narrow[1]
    path = tmp_path / "certificate.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    changes = [f"--set={key}={value}" for key, value in NARROW.items()]
    done = run("validate", "crank-rocker", "--certificate", str(tmp_path), *changes)
    assert done.exit_code == 0, done.stderr
    holds = re.search(r"certificate holds: no design is better by more than (\S+) %", done.stdout)
    assert holds is not None
    assert 0.0 < float(holds[1]) <= 1e-4
    path.write_text(json.dumps(document)[:500], encoding="utf-8")
    done = run("validate", "crank-rocker", "--certificate", str(path))
    assert done.exit_code == 2
    assert "not a JSON document" in done.stderr
    done = run("validate", "crank-rocker", "--certificate", str(tmp_path / "none.json"))
    assert done.exit_code == 2
    assert "there is no such file. Give the certificate.json that optlink solve --certify --out wrote" in done.stderr
    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.raises(InputError, match=r'Install it: pip install "optlink\[certificates\]"'):
        check_certificate(narrow[0], path)


def test_guillotine_partitions() -> None:
    rng = np.random.default_rng(3)
    for count in (1, 2, 3):
        whole = np.zeros(count), np.ones(count)
        low, high = whole[0][None], whole[1][None]
        for _ in range(60):  # a cut through a box, anywhere, along any unknown
            k, i = rng.integers(len(low)), rng.integers(count)
            at = rng.uniform(low[k, i], high[k, i])
            low, high = np.vstack([low, low[k]]), np.vstack([high, high[k]])
            high[k, i] = low[-1, i] = at
        assert uncovered(low, high, whole) is None
        assert uncovered(np.vstack([low, low[:3]]), np.vstack([high, high[:3]]), whole) is None  # twice is harmless
        for k in rng.integers(len(low), size=6):
            keep = np.arange(len(low)) != k
            gap = uncovered(low[keep], high[keep], whole)
            assert gap is not None
            assert np.all(gap[0] < high[k])
            assert np.all(gap[1] > low[k])
            smaller = high.copy()
            smaller[k, 0] = np.nextafter(smaller[k, 0], 0.0)
            assert uncovered(low, smaller, whole) is not None


def test_balls_contain_values_and_derivatives() -> None:
    """Values, gradients and Hessians of formulas, with those by differences at 200 bits at random designs of the box."""
    rng = np.random.default_rng(5)
    formulas: list[Callable[..., Any]] = [
        lambda x, y: np.sqrt(x) * np.sin(x * y) / (1.0 + y * y),
        lambda x, y: np.arctan2(y - 2.0, x - 3.0) * np.exp(-x),
        lambda x, y: np.log(x + y) ** 2 - np.tan(0.3 * x) + x**-3,
        lambda x, y: np.arcsin(0.3 * x) + np.arccos(0.2 * y) - np.sinh(x) * np.tanh(y) + np.log10(x) / y**0.7,
        lambda x, y: np.absolute(x - 3.0) * np.maximum(x, -y) + np.minimum(y, 7.0) * np.cosh(x),
    ]
    step = flint.arb(2) ** -40
    with flint.ctx.workprec(200):
        for formula in formulas:
            for _ in range(10):
                centre, scale = rng.uniform(1.0, 1.6, 2), 10.0 ** rng.uniform(-6.0, -1.0, 2)

                def at(d: list[Any], centre: Any = centre, scale: Any = scale, formula: Any = formula) -> Any:
                    return formula(
                        *(Ball.constant(flint.arb(c) + flint.arb(s) * x) for c, s, x in zip(centre, scale, d, strict=True))
                    ).value

                box = [Ball.unknown(k, 2, centre[k], flint.arb(scale[k])) for k in range(2)]
                result = formula(*box)
                assert result.known
                assert result.centre.overlaps(at([0, 0]))
                d = [flint.arb(x) for x in rng.uniform(-1.0, 1.0, 2)]
                assert result.value.contains(at(d))
                assert result.range.contains(at(d))
                assert lower_bound(result) <= at(d)
                near = flint.arb(0, 1e-9)
                for i in range(2):
                    unit = [step * (k == i) for k in range(2)]
                    up, down = (at([x + sign * u for x, u in zip(d, unit, strict=True)]) for sign in (1, -1))
                    assert (result.gradient[0, i] + near).contains((up - down) / (2 * step))
                    assert (result.hessian[i, i] + near).contains((up - 2 * at(d) + down) / (step * step))


def test_definite_matrices() -> None:
    assert positive_definite(flint.arb_mat(2, 2, [2, 1, 1, 2]))
    assert not positive_definite(flint.arb_mat(2, 2, [1, 2, 2, 1]))
    assert not positive_definite(flint.arb_mat(2, 2, [flint.arb(1, 0.6), 0.5, 0.5, flint.arb(1, 0.6)]))


def test_angles_beyond_half_a_turn() -> None:
    """A box across the negative x axis: the angle is continuous; inside limits, which mean the principal value, undefined."""
    from optlink.validation.balls import principal_angles

    box = [Ball.constant(-1.0), Ball.unknown(0, 1, 0.1, flint.arb(0.2))]
    angle = np.arctan2(box[1], box[0])
    assert float(angle.range.upper()) == pytest.approx(np.pi + np.arctan(0.1), rel=1e-2)
    with principal_angles():
        assert not np.arctan2(box[1], box[0]).known


def test_tangent_plane_of_a_convex_quantity() -> None:
    """The tangent plane at about the minimum is a lower bound, and as high as the minimum; so over a corner of the box."""
    for centre, least in ((0.2, 0.0), (0.9, 0.9)):  # minimum inside, and at the lower end of both unknowns
        scale = flint.arb(0.5)

        def quantity(at: list[float], over: bool, scale: Any = scale) -> Ball:
            x, y = (Ball.unknown(k, 2, at[k], scale, over=over) for k in range(2))
            return np.exp(x) - x + np.exp(-y) + 2.0 * y * y - 0.3 * x * y  # type: ignore[no-any-return]

        box = quantity([centre, centre], True)
        assert positive_definite(box.hessian)
        convex = np.array([float(x) for x in box.hessian.entries()]).reshape(2, 2)
        point = np.zeros(2)
        for _ in range(6):
            point = box_minimum(
                np.array([float(x) for x in quantity(list(centre + 0.5 * point), False).slope.entries()]), convex, point
            )
        bound = float(tangent_bound(quantity(list(centre + 0.5 * point), False), [flint.arb(float(x)) for x in point]))
        d = np.linspace(-1.0, 1.0, 401)
        x, y = np.meshgrid(centre + 0.5 * d, centre + 0.5 * d)
        smallest = float(np.min(np.exp(x) - x + np.exp(-y) + 2.0 * y * y - 0.3 * x * y))
        assert smallest - 1e-4 <= bound <= smallest + 1e-12
        assert float(lower_bound(box)) <= bound + 1e-12
        assert (least > 0.0) == bool(np.all(point == -1.0))


@pytest.mark.slow
def test_crank_rocker(tmp_path: Path) -> None:
    problem = optlink.load("crank-rocker")
    result = _checked(problem, _certificate(problem), tmp_path)
    assert result.valid, result.checks
    assert result.boxes > 200


@pytest.mark.parametrize(
    "name", ["crank-rocker", "function-log10", "law-six-bar", "law-slider-crank", "path-closed18", "transmission-optimal"]
)
def test_deviations_and_limits_are_those_of_the_search(name: str) -> None:
    """The formulas of the check, written separately, have the values of those of the search, row for row."""
    file = optlink.load(name).variants()[0]
    boxes = box_problem(file)
    known = [file.model.quantities[key].value for key in file.model.free]
    x = np.clip(np.array(known), boxes.low, boxes.high)
    models = boxes.over(x[None], x[None])
    with flint.ctx.workprec(100):
        problem = BallProblem(_model(file))
        values = problem.values([float(one) for one in x], [flint.arb(0)] * len(x))
        slacks, start = problem.slacks(values), problem.starts(values)[0]
        assert tuple(key for key, _ in slacks) == boxes.limits
        for (_, slack), value, remainder in zip(slacks, models.slacks.value[0], models.slacks.remainder[0], strict=True):
            assert not np.isfinite(remainder) or float(slack.centre) == pytest.approx(value, rel=1e-9, abs=1e-12)
        compared = 0
        for position, computed in enumerate(problem.deviations(values, start)):
            for k, one in enumerate(computed):
                if one.model is not None:
                    compared += 1
                    assert float(one.model.centre) == pytest.approx(models.residuals.value[0, position, k], rel=1e-9, abs=1e-12)
        assert compared or not np.any(np.isfinite(models.residuals.remainder))
