"""An interrupted proof of a global optimum: the bound that it reached holds, and the design is kept."""

from types import SimpleNamespace

import pytest

import optlink
from optlink.optimization.taylor_model import box_problem
from optlink.solvers.global_search.branch_and_bound import BranchAndBound, joint_history
from optlink.solvers.global_search.lagrangian import LagrangianBounds
from optlink.tasks.certify import certify


class Interrupted(LagrangianBounds):
    """Bounds that are interrupted in a batch."""

    def bounded(self, low, high, threshold):
        if self.problem.calls == self.problem.stop:
            raise KeyboardInterrupt
        self.problem.calls += 1
        return super().bounded(low, high, threshold)


@pytest.fixture(scope="module")
def solved():
    return optlink.solve(optlink.load("crank-rocker"), certify=False)


@pytest.mark.parametrize("stop", [0, 1, 3])
def test_a_batch_that_is_interrupted_stays_open(solved, stop):
    """Otherwise its boxes are lost, the bound is too high, and the search may even count as finished."""
    problem = box_problem(solved.problem)
    object.__setattr__(problem, "calls", 0)
    object.__setattr__(problem, "stop", stop)
    search = BranchAndBound(Interrupted(problem), solved.objective, 1e-6)
    with pytest.raises(KeyboardInterrupt):
        search.run()
    assert not search.closed
    assert volume(search) == pytest.approx(0.8 * 0.8, rel=1e-9)
    before = search.lower
    object.__setattr__(problem, "stop", -1)
    search.run()  # goes on where it stopped
    assert search.closed
    assert before <= search.lower <= solved.objective
    assert search.lower >= solved.objective * (1.0 - 1.1e-6)


def volume(search):
    """All boxes of a search, open or discarded."""
    kept = ((part.low, part.high) for part in (search.open, search.tiny))
    gone = zip(search.leaves.low, search.leaves.high, strict=True)
    return sum(float((high - low).prod(axis=1).sum()) for low, high in [*kept, *gone])


@pytest.mark.parametrize("stop", [0, 2])
def test_an_interrupt_while_a_better_design_is_searched_counts_no_box_twice(solved, stop):
    """The discarded boxes of such a batch are not open beside, so that a proof that goes on covers each design once."""
    calls = []

    def improve(_at):
        calls.append(search.boxes)
        if len(calls) > stop:
            raise KeyboardInterrupt
        return float("inf")

    search = BranchAndBound(LagrangianBounds(box_problem(solved.problem)), 1.5 * solved.objective, 1e-6, improve)
    with pytest.raises(KeyboardInterrupt):
        search.run()
    assert len(search.leaves.low) > 0
    assert volume(search) == pytest.approx(0.8 * 0.8, rel=1e-9)
    assert search.boxes < calls[-1]
    assert search.leaves.count == sum(map(len, search.leaves.low))
    search.improve, search.best = None, solved.objective
    search.run(boxes=100_000)
    assert search.closed
    assert volume(search) == pytest.approx(0.8 * 0.8, rel=1e-9)


def test_an_interrupted_proof_keeps_the_design(solved, monkeypatch):
    calls = iter([False, True])

    def bounded(self, low, high, threshold, own=LagrangianBounds.bounded):
        if next(calls):
            raise KeyboardInterrupt
        return own(self, low, high, threshold)

    monkeypatch.setattr(LagrangianBounds, "bounded", bounded)
    result = certify(solved)
    assert result.interrupted
    assert result.valid
    assert result.design == solved.design
    assert result.certificate.status == "not closed"
    assert result.certificate.open_boxes > 0
    assert 0.0 <= result.certificate.lower_bound < result.objective


def test_an_interrupt_before_the_first_box_keeps_the_design(solved, monkeypatch):
    def stop(_variant, _peaks):
        raise KeyboardInterrupt

    monkeypatch.setattr("optlink.tasks.certify.box_problem", stop)
    result = certify(solved)
    assert result.interrupted
    assert result.valid
    assert result.certificate is None


def test_the_history_of_several_assembly_modes_is_that_of_one_search():
    """Boxes add up, and the bound is that over all modes: zero until the last one has begun."""
    first = SimpleNamespace(history=[(1, 0.0, 9.0), (5, 8.0, 9.0)], boxes=6, lower=8.0)
    second = SimpleNamespace(history=[(1, 2.0, 9.0), (7, 7.0, 7.0)], boxes=7, lower=7.0)
    assert joint_history([first, second]) == [(1, 0.0, 9.0), (5, 0.0, 9.0), (7, 2.0, 9.0), (13, 7.0, 7.0)]
    assert joint_history([first]) == first.history
