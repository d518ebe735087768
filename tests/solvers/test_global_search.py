"""Certified global optima: bounds that hold, gaps that close, designs that are found on the way, faults that are noticed."""

from __future__ import annotations

import math

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.execution.runner import pool
from optlink.optimization.taylor_model import BoxModels, DesignBoxes, TaylorModel, box_problem, pairs
from optlink.solvers.global_search import branch_and_bound, lagrangian, lagrangian as quadratic
from optlink.solvers.global_search.branch_and_bound import BranchAndBound
from optlink.solvers.global_search.lagrangian import LagrangianBounds
from optlink.tasks.certify import certify
from optlink.tasks.results.certificate import GLOBAL, INFEASIBLE, NOT_CLOSED, WITHIN_GAP, share_text
from tests.solved import once
from tests.tiers import mostly_slow

FREE_FRAME = {"mechanism.frame": {"start": "500 mm", "bounds": ["450 mm", "550 mm"]}}
FREE_START = {"requirement.from": {"start": "25 deg", "bounds": ["15 deg", "35 deg"]}}
FREE_OUTPUT = {"requirement.psi0": {"start": "100 deg", "bounds": ["90 deg", "110 deg"]}}
IMPOSSIBLE = {
    "transmission 80..100": {"limits.transmission_angle": ["80 deg", "100 deg"]},
    "transmission 70..110": {"limits.transmission_angle": ["70 deg", "110 deg"]},
    "long crank": {"mechanism.crank": "400 mm", "limits.transmission_angle": ["60 deg", "120 deg"]},
    "swing": {"limits.swing_angle": ["120 deg", "130 deg"]},
    "time ratio": {"limits.time_ratio": [1.6, 1.8]},
    "short links": {
        "mechanism.coupler": {"start": "200 mm", "bounds": ["100 mm", "250 mm"]},
        "mechanism.rocker": {"start": "200 mm", "bounds": ["100 mm", "250 mm"]},
    },
    "fixed links": {  # no limit that is missed depends on the design variable
        "mechanism.coupler": "300 mm",
        "mechanism.rocker": "200 mm",
        "requirement.psi0": {"bounds": ["60 deg", "120 deg"]},
    },
}


def certified(problem, gap=1e-6, **options):
    return certify(optlink.solve(problem, certify=False), gap, **options)


def test_the_crank_rocker_is_proven_by_default(crank_rocker):
    result = optlink.solve(crank_rocker)
    outcome = result.certificate
    assert outcome.status == GLOBAL
    assert outcome.gap < 1e-6
    assert outcome.lower_bound < result.objective
    assert outcome.boxes < 1_000
    assert optlink.solve(crank_rocker, certify=False).certificate is None


@pytest.mark.parametrize("name", mostly_slow(IMPOSSIBLE, "transmission 80..100", "fixed links"))
def test_impossible_limits_are_proven_to_be_so(crank_rocker, name):
    result = optlink.solve(crank_rocker.override(IMPOSSIBLE[name]))
    assert not result.valid
    assert result.certificate.status == INFEASIBLE
    assert math.isinf(result.certificate.lower_bound)


@pytest.mark.slow
@pytest.mark.parametrize("change", [FREE_FRAME, FREE_START, FREE_OUTPUT], ids=["frame", "start", "output"])
def test_three_unknowns(crank_rocker, change):
    result = certified(crank_rocker.override(change), 1e-4)
    assert result.certificate.status == WITHIN_GAP
    assert result.certificate.gap <= 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["local", "dask"])
def test_processes_change_no_digit_of_a_long_proof(crank_rocker, monkeypatch, engine):
    """Stopped and continued in between as well; steps of several batches are those of a long search."""
    monkeypatch.setattr(branch_and_bound, "LONG", 512)
    result = optlink.solve(crank_rocker.override(FREE_START), certify=False)
    steps = []

    def searched(runs, boxes, *, divisible=True):
        bounds = LagrangianBounds(box_problem(result.problem))
        search = BranchAndBound(bounds, result.objective, 1e-3, batch=50, divisible=divisible, runs=runs)
        search.run(boxes=boxes)
        search.run()
        assert search.closed
        return search

    def figures(search):
        leaves = search.leaves
        parts = [part.tobytes() for each in (leaves.low, leaves.high, leaves.test, leaves.multipliers) for part in each]
        return parts, search.boxes, search.lower, search.history

    def within_one_process():
        computed = (searched(None, math.inf, divisible=divisible) for divisible in (True, False))
        return [(figures(search), search.lower) for search in computed]

    alone, narrow = once("a long proof", within_one_process)
    with pool(engine, 2) as runs:
        shared = searched(lambda task, todo: steps.append(len(todo)) or runs(task, todo), 1000)
    assert figures(shared) == alone[0]
    assert len(steps) > 3
    assert max(steps) > 2
    assert narrow[0] != alone[0]
    assert alone[1] == pytest.approx(narrow[1], rel=1e-3)


@pytest.mark.slow
def test_four_unknowns(crank_rocker):
    result = certified(crank_rocker.override(FREE_START | FREE_OUTPUT), 1e-3)
    assert result.certificate.status == WITHIN_GAP


@pytest.mark.slow
def test_the_best_transmission(crank_rocker):
    result = certified(optlink.load("transmission-optimal"), 1e-4)
    assert result.certificate.status == WITHIN_GAP
    assert result.best.objective == pytest.approx(0.790872, abs=1e-6)


@pytest.mark.parametrize("measure", ["rms", "max"])
def test_other_measures_prove_the_same(crank_rocker, measure):
    result = certified(crank_rocker.override({"requirement.measure": measure}))
    assert result.certificate.status == GLOBAL


def test_one_unknown_on_which_no_limit_depends(crank_rocker, solved):
    """The dimensions are fixed, and with them every limit; the start angle alone is free."""
    fixed = {f"mechanism.{name}": f"{1e3 * solved.design[name]!r} mm" for name in ("coupler", "rocker")}
    start = {"requirement.from": {"start": "20 deg", "bounds": ["0 deg", "360 deg"]}}
    result = optlink.solve(crank_rocker.override(fixed | start | {"limits.transmission_angle": ["44 deg", "136 deg"]}))
    assert result.valid
    assert result.certificate.status == GLOBAL


@pytest.mark.slow
def test_a_longer_search_raises_the_bound(crank_rocker):
    problem = crank_rocker.override(FREE_FRAME)
    bounds = [certified(problem, 1e-4, boxes=boxes).certificate for boxes in (400, 1_600, math.inf)]
    assert [result.status for result in bounds] == [NOT_CLOSED, NOT_CLOSED, WITHIN_GAP]
    lower = [result.lower_bound for result in bounds]
    assert lower == sorted(lower)
    assert bounds[0].open_boxes > 0
    history = bounds[-1].history
    assert np.all(np.diff(history, axis=0)[:, :2] >= 0.0)


def test_a_better_design_becomes_the_result(crank_rocker, solved):
    """Of a valid design that is not the best one, the search finds the best one."""
    given = optlink.validate(crank_rocker, {"coupler": 0.5, "rocker": 0.3})
    assert given.valid
    assert given.objective > 2.0 * solved.objective
    result = certify(given)
    assert result.certificate.improved
    assert result.valid
    assert result.certificate.status == GLOBAL
    assert result.design["coupler"] == pytest.approx(solved.design["coupler"], abs=1e-9)


def test_an_exact_fit_needs_no_search(crank_rocker):
    sizes = crank_rocker.spec.sizes({"coupler": 0.35, "rocker": 0.3})
    from optlink.linkage.fourbar import LENGTHS, dead_centre

    start = dead_centre(*(sizes[name] for name in LENGTHS), 1, outer=True)
    phi = np.linspace(0.0, 1.5, 31)
    pose = crank_rocker.spec.linkage.pose(sizes, (np.cos(start.phi + phi), np.sin(start.phi + phi)))
    psi = np.unwrap(np.arctan2(*reversed(pose.direction("rocker"))))
    table = {"phi": [f"{x!r} rad" for x in phi.tolist()], "psi": [f"{x!r} rad" for x in (psi - psi[0]).tolist()]}
    task = {k: v for k, v in crank_rocker.raw["requirement"].items() if k not in ("span", "points")} | {"law": table}
    raw = {k: v for k, v in crank_rocker.raw.items() if k != "expected"} | {"requirement": task, "limits": {}}
    result = optlink.solve(optlink.read(raw), starts=8)
    assert result.objective < 1e-16
    assert result.certificate.status == GLOBAL
    assert result.certificate.lower_bound == 0.0


@pytest.mark.parametrize(("gap", "limit"), [(0.0, 1.0), (math.nan, 1.0), (2.0, 1.0), (1e-3, 0.0), (1e-3, math.nan)])
def test_impossible_options_are_refused(solved, gap, limit):
    with pytest.raises(InputError, match="out of range"):
        certify(solved, gap, limit)


@pytest.mark.parametrize("name", ["path-bean", "shaper-design", "crank-rocker-robust"])
def test_other_kinds_are_refused_with_the_reason(name):
    with pytest.raises(InputError, match="no certificate of the global optimum"):
        box_problem(optlink.load(name).variants()[0])


@pytest.mark.parametrize(
    ("share", "text"), [(9.99e-7, "0.0001 %"), (1.001e-6, "0.00011 %"), (0.034, "3.4 %"), (0.0, "rounding errors")]
)
def test_a_gap_is_rounded_up(share, text):
    assert share_text(share) == text


# --- parts -----------------------------------------------------------------------------------------------------------------


def polynomial(values, point):
    n = point.shape[-1]
    square = np.stack([point[..., i] * point[..., j] for i, j in pairs(n)], axis=-1)
    return values[0] + point @ values[1 : 1 + n] + square @ values[1 + n :]


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_the_bound_of_a_polynomial_is_never_above_it(n):
    rng = np.random.default_rng(n)
    terms = rng.normal(size=(400, 1 + n + len(pairs(n)))) * rng.choice([1e-6, 1.0, 1e3], size=(400, 1))
    bound = quadratic.quadratic_bound(terms[:, 0], terms[:, 1 : 1 + n], terms[:, 1 + n :], np.zeros(400))
    points = np.concatenate([rng.uniform(-1.0, 1.0, (3000, n)), rng.choice([-1.0, 1.0], size=(64, n)), np.zeros((1, n))])
    least = np.array([np.min(polynomial(row, points)) for row in terms])
    assert np.all(bound <= least)
    assert np.median((least - bound) / np.abs(terms).sum(axis=1)) < 0.2


def test_the_bound_of_a_convex_polynomial_is_its_minimum():
    """So a bound that is too high by a part in 1e9 is noticed."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-0.8, 0.8, (200, 3))
    factor = rng.normal(size=(200, 3, 3))
    hessian = np.einsum("bij,bkj->bik", factor, factor) + 0.5 * np.eye(3)
    linear = -np.einsum("bij,bj->bi", hessian, points)
    constant = 0.5 * np.einsum("bi,bij,bj->b", points, hessian, points) + 1.0
    terms = np.stack([hessian[:, i, j] * (0.5 if i == j else 1.0) for i, j in pairs(3)], axis=1)
    bound = quadratic.quadratic_bound(constant, linear, terms, np.zeros(200))
    assert np.all(bound <= 1.0)
    assert np.median(1.0 - bound) < 1e-9


@pytest.mark.parametrize("n", mostly_slow([1, 2, 3], 1))
def test_no_point_that_satisfies_the_rows_is_cut_off(n):
    rng = np.random.default_rng(20 + n)
    rows, most = rng.normal(size=(300, 6, n)), rng.normal(size=(300, 6))
    low, high = quadratic.cut_box(rows, most)
    points = rng.uniform(-1.0, 1.0, (4000, n))
    inside = np.all(np.einsum("bmn,pn->bpm", rows, points) <= most[:, None, :], axis=2)
    satisfied = np.all((points >= low[:, None, :]) & (points <= high[:, None, :]), axis=2)
    assert not np.any(inside & ~satisfied)
    assert np.mean(~satisfied) > 0.2


class Bowl:
    """One residual per unknown, x - centre, and the limit sum x >= least."""

    measure, limits = "sum of squares", ("least",)

    def __init__(self, centre, least):
        self.centre, self.least = np.asarray(centre), least
        self.low, self.high = np.full(len(centre), -1.0), np.full(len(centre), 2.0)

    def over(self, low, high):
        unknowns = TaylorModel.unknowns(low, high)
        total = sum(unknowns[1:], unknowns[0]) - self.least
        moved = [x - c for x, c in zip(unknowns, self.centre, strict=True)]
        coefficients = np.stack([m.coefficients[..., 0] for m in moved], axis=-1)[..., None]
        remainder = np.stack([m.remainder[..., 0] for m in moved], axis=-1)[..., None]
        return BoxModels(TaylorModel(coefficients, remainder, len(moved)), total)


@pytest.mark.parametrize(("least", "best"), [(1.5, 0.75), (4.5, 6.75), (7.0, math.inf)])
def test_a_problem_with_a_known_solution(least, best):
    problem = Bowl([0.0, 0.0, 0.0], least)
    search = BranchAndBound(LagrangianBounds(problem), best * (1.0 + 1e-12) + 1e-9, 1e-6)
    search.run()
    assert search.closed
    assert search.lower <= best + 1e-9
    assert search.lower >= best * (1.0 - 2e-6) if math.isfinite(best) else math.isinf(search.lower)
    low, high = np.concatenate(search.leaves.low), np.concatenate(search.leaves.high)
    assert np.prod(high - low, axis=1).sum() == pytest.approx(27.0)  # the leaves are the whole box


def test_a_search_continues_where_it_stopped(crank_rocker):
    """Whether it runs through or is stopped after every batch: the same bound, boxes and leaves."""
    problem = box_problem(crank_rocker)

    def searched(steps):
        search = BranchAndBound(LagrangianBounds(problem), 0.0075923736053347575, 1e-3)
        for boxes in steps:
            search.run(boxes=boxes)
        return search.lower, search.boxes, np.concatenate(search.leaves.low).tolist()

    assert searched([math.inf]) == searched([*range(0, 2_000, 60), math.inf])


# --- planted faults --------------------------------------------------------------------------------------------------------


def wrong(monkeypatch, name):
    """Plant a fault by name."""
    if name == "bound too high":
        true = lagrangian.quadratic_bound
        monkeypatch.setattr(lagrangian, "quadratic_bound", lambda *a: true(*a) + 2e-3)
    elif name == "box dropped":
        true_step = branch_and_bound.Boxes.halves
        monkeypatch.setattr(
            branch_and_bound.Boxes, "halves", lambda self, d: true_step(self, d)[np.arange(2 * len(self)) % 8 != 5]
        )
    elif name == "wrong sign of a limit":
        true_over = DesignBoxes.over

        def over(self, low, high):
            models = true_over(self, low, high)
            return BoxModels(models.residuals, -models.slacks, models.periodic)

        monkeypatch.setattr(DesignBoxes, "over", over)


def objective_at(problem, points):
    """Return the objective of designs (k, 2); infinite where a limit is violated."""
    from optlink.optimization.output_errors import ErrorResiduals
    from optlink.optimization.terms import rows

    fixed = {name: quantity.value for name, quantity in problem.quantities.items()}
    flat = fixed | dict(zip(problem.free, points.T, strict=True))
    with np.errstate(all="ignore"):
        objective = ErrorResiduals(problem).objective(
            fixed | {name: x[:, None] for name, x in zip(problem.free, points.T, strict=True)}
        )
        inside = np.isfinite(objective)
        for row in rows(problem, flat, problem.reach(flat), 1.0):
            inside &= (row.value >= row.low) & (row.value <= row.high)
    return np.where(inside, objective, np.inf)


def grid(problem, count):
    """Return the designs (count^2, 2) of a grid over the bounds."""
    axes = [np.linspace(*problem.quantities[name].bounds, count) for name in problem.free]
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes)], axis=1)


@pytest.mark.parametrize(
    "fault", mostly_slow(["none", "bound too high", "box dropped", "wrong sign of a limit"], "none", "box dropped")
)
def test_a_discarded_box_holds_no_better_design(crank_rocker, monkeypatch, fault):
    """With a threshold far above the optimum, against random designs in the boxes; each planted fault shows."""
    wrong(monkeypatch, fault)
    search = BranchAndBound(LagrangianBounds(box_problem(crank_rocker)), 0.03, 1e-3)
    search.run(boxes=1_200)
    low, high = np.concatenate(search.leaves.low), np.concatenate(search.leaves.high)
    points = low + (high - low) * np.random.default_rng(3).random((40, *low.shape))
    contradicted = bool(np.any(objective_at(crank_rocker.spec, points.reshape(-1, 2)) < search.threshold * (1.0 - 1e-9)))
    sizes = [np.prod(part.high - part.low, axis=1).sum() for part in (search.open, search.tiny)]
    covered = math.isclose(np.prod(high - low, axis=1).sum() + sum(sizes), 0.64, rel_tol=1e-9)
    assert (not contradicted and covered) == (fault == "none")


def random_problem(rng):
    """Return a law problem of two unknowns with random fixed links, law, span, limits and measure."""
    crank, frame = rng.uniform(50.0, 150.0), rng.uniform(250.0, 700.0)
    least = rng.uniform(20.0, 60.0)
    amplitude, order = rng.uniform(-0.5, 0.5), rng.integers(1, 4)
    law = ["psi0 + {a}*(phi - phi0)^{k}/2", "psi0 + {a}*sin({k}*(phi - phi0))", "psi0 + {a}*(exp((phi - phi0)/{k}) - 1)/3"]
    free = {"start": "400 mm", "bounds": ["80 mm", "900 mm"]}
    return optlink.read(
        {
            "title": "Random law",
            "mechanism": {
                "type": "four-bar",
                "crank": f"{crank} mm",
                "frame": f"{frame} mm",
                "coupler": free,
                "rocker": free,
                "assembly": str(rng.choice(["left", "right"])),
            },
            "requirement": {
                "kind": "function",
                "law": str(rng.choice(law)).format(a=round(float(amplitude), 3), k=order),
                "from": str(rng.choice(["outer dead centre", "inner dead centre", "40 deg"])),
                "span": f"{rng.uniform(-150.0, 150.0)} deg",
                "points": int(rng.integers(5, 25)),
                "measure": str(rng.choice(["sum of squares", "rms", "max"])),
            },
            "limits": {
                "crank": str(rng.choice(["full rotation", "span"])),
                "transmission_angle": [f"{least} deg", f"{rng.uniform(100.0, 160.0)} deg"],
            },
        }
    )


def contradicted(problem):
    """Return whether a certificate of a problem is contradicted by a grid refined by local searches, and its status."""
    from optlink.tasks import design

    result = certified(problem, 1e-4, boxes=20_000)
    outcome = result.certificate
    points = grid(problem.spec, 41)
    objective = objective_at(problem.spec, points)
    best = float(np.min(objective))
    for k in np.argsort(objective)[:3]:
        if math.isfinite(objective[k]):
            local = design.solve(problem, begin=dict(zip(problem.spec.free, points[k].tolist(), strict=True)))
            best = min(best, local.objective if local.valid else math.inf)
    return best < outcome.lower_bound * (1.0 - 1e-9), outcome


@pytest.mark.slow
def test_no_certificate_of_a_random_problem_is_contradicted():
    rng = np.random.default_rng(11)
    statuses = []
    for _ in range(12):
        try:
            problem = random_problem(rng)
        except InputError:  # a law or span that no file may have
            continue
        wrongly, result = contradicted(problem)
        assert not wrongly
        statuses.append(result.status)
    assert statuses.count(NOT_CLOSED) <= 1
    assert statuses.count(WITHIN_GAP) >= 8
