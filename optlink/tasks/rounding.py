"""Round an optimum to sizes that can be made: a search on the grid of steps or stock sizes, each design validated as built.

Every node of the search is the programme of the optimum within a box of the grid, solved from the optimum of the node above it,
which it divides at the size that lies farthest from the grid. The end of a node is a lower bound for the nodes below it as far as
its local optimum is the best in its box, so no box is discarded before it was searched from other places too.
"""

import heapq
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from optlink.errors import InputError, Status
from optlink.execution import interrupts
from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import solved_values
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import Unusable
from optlink.problem.rounding import ALL, NO_GRID, ON_GRID, Grid, read_grids
from optlink.solvers import multistart
from optlink.solvers.contract import BACKENDS, MINIMAX
from optlink.solvers.exchange import solve_semi_infinite
from optlink.solvers.quadratic_model import QuadraticModel
from optlink.solvers.solution import FEASIBLE, SAME_OBJECTIVE, Solution
from optlink.tasks.protocol import Progress, Timer, part
from optlink.tasks.results.design import LinkageDesign, SynthesisResult
from optlink.tasks.results.rounding import Influence, Rounding
from optlink.tasks.search import Polisher
from optlink.validation import validate
from optlink.validation.check import STATED, Requirement, requirements
from optlink.validation.timing import in_first_cycle

FEW = 4  # sizes up to which the whole grid is searched
WHOLE = 400  # programmes solved at most on the whole grid
PER_SIZE = 30  # designs per size near the optimum, where the grid is too large for that
STEPS, FARTHEST = 10.0, 0.1  # reach of the quadratic model: steps of the grid, and of other unknowns (scaled)
NODES = 10_000  # minima of quadratic models at most, about a millisecond each
CLOSE = 1e-6  # share of a step: a size of the model this close to a grid value has it
FINER = 2.0, 5.0, 10.0, 20.0, 50.0, 100.0  # divisors of the steps with which a design is looked for where none has the steps
TRIED = 20  # programmes for each of them
CORNERS = 4  # sizes up to which all designs beside the optimum are tried first
LEAST_SHARE = 0.01  # of what a one-sided limit leaves: less influence of half a step is not listed


def read_steps(problem: ProblemFile, rounding: object) -> dict[str, Grid]:
    """Return the grid of each free size that is rounded: those of the file if `rounding` is None, else in place of them.

    A text is the step of all lengths, or "none"; a table is as `[rounding]`.

    Raises
    ------
    InputError
        If a step is not positive, a size is unknown or not free, or nothing is rounded.
    """
    if rounding in (None, NO_GRID):
        return problem.spec.grids if rounding is None else {}
    quantities = problem.model.mechanism.quantities
    free = [name for name in problem.model.free if name in quantities]
    stated: Mapping[str, object] = rounding if isinstance(rounding, Mapping) else {ALL: rounding}
    try:
        grids = read_grids(stated, quantities, free)
    except Unusable as error:
        key = f"--round {error.key}".removesuffix(f" {ALL}")
        raise InputError(error.message, error.remedy, problem.file, key, error.value) from None
    if not grids:
        raise InputError("no free size is a length", f"Name what to round: {', '.join(free)}", problem.file, "--round")
    return grids


@dataclass(order=True)
class _Node:
    """A box of the grid with its optimum; in the order in which nodes are divided.

    `above`: the optimum of the node above, until the box was searched from other places.
    """

    key: tuple[float, int]
    low: Array = field(compare=False)
    high: Array = field(compare=False)
    solution: Solution = field(compare=False)
    above: Solution | None = field(compare=False, default=None)


class _Search:
    """The search for the best design on the grid near a design with an optimum."""

    def __init__(self, design: LinkageDesign, top: Solution, grids: Mapping[str, Grid], polisher: Polisher) -> None:
        self.design, self.grids, self.task, self.top, self.polisher = design, dict(grids), design.whole, top, polisher
        self.nlp: NLP = top.nlp
        names = [v.name for v in self.nlp.variables]
        self.at = np.array([names.index(name) for name in grids])
        self.variables = [self.nlp.variables[k] for k in self.at]
        self.warm = (
            polisher.method if polisher.method == MINIMAX else BACKENDS[0]
        )  # the one with the least work from a near start
        self.solved, self.nodes, self.least = 0, 0, math.inf
        self.best: LinkageDesign | None = None
        self.best_at: tuple[Array, ...] = ()  # its scaled point
        self.tried: dict[tuple[float, ...], LinkageDesign] = {}
        self.evaluated: set[tuple[float, ...]] = set()
        self.complete = True

    def sizes(self, solution: Solution) -> list[float]:
        """Return the rounded sizes [SI] of a solution."""
        return self._sizes(solution.x)

    def _sizes(self, x: Array) -> list[float]:
        return [v.value(float(x[k])) for v, k in zip(self.variables, self.at, strict=True)]

    def _nearest(self, sizes: Sequence[float]) -> list[float]:
        return [grid.nearest(size) for grid, size in zip(self.grids.values(), sizes, strict=True)]

    def moved(self, start: Solution, j: int, value: float) -> Array:
        """Return the scaled point to which a solution moves along its active limits until a size has a value [SI]."""
        n, k = len(start.x), self.at[j]
        held = start.nlp.at(start.x, start.p).jacobian[[i - n for i in start.conditions.active if i >= n]]
        rows = np.vstack([held[np.isfinite(held).all(axis=1)], np.eye(n)[k]])
        change = np.zeros(len(rows))
        change[-1] = self.variables[j].scaled(value) - start.x[k]
        return start.x + np.linalg.lstsq(rows, change, rcond=None)[0]  # type: ignore[no-any-return]

    def elsewhere(self, low: Array, high: Array, above: Solution) -> Solution | None:
        """Return an optimum in a box of the grid that is better than the best design, searched from other places than `moved`.

        These are the optimum of the node above, the middle of the box, and the best design, each clipped into the box.
        """
        middle = above.x.copy()
        middle[self.at] = [v.scaled(value) for v, value in zip(self.variables, 0.5 * (low + high), strict=True)]
        ends = (self.within(low, high, replace(above, x=x)) for x in (above.x, middle, *self.best_at))
        return next((end for end in ends if end.usable and not self._worse(end.objective)), None)

    def within(self, low: Array, high: Array, start: Solution) -> Solution:
        """Return the optimum with the sizes between two bounds [SI], near another one."""
        x_low, x_high = self.nlp.x_low.copy(), self.nlp.x_high.copy()
        for j, (k, v) in enumerate(zip(self.at, self.variables, strict=True)):
            x_high[k] = min(x_high[k], v.scaled(high[j]))
            x_low[k] = min(max(x_low[k], v.scaled(low[j])), x_high[k])  # a bound may be a value of the grid but for rounding
        self.solved += 1
        nlp = self.nlp.bounded(x_low, x_high)
        nlp.p[1:] = start.p[1:]
        end = multistart.solve_from(nlp, np.clip(start.x, x_low, x_high), self.warm, persistent=False, continuations=0)
        if end.status is Status.OPTIMAL and self._worse(end.objective):
            return end  # and with the limits between its positions it is not better
        return solve_semi_infinite(self.task, end, self.polisher.method)

    def build(self, sizes: Sequence[float], start: Solution) -> Array:
        """Validate the best design with these sizes [SI] as built, keep it if none is better, and return its scaled point.

        Of many sizes, of which validation takes longest, designs that their programme refuses are not validated.
        """
        key, fixed = tuple(sizes), np.asarray(sizes, dtype=float)
        if key in self.tried:
            return start.x
        end = start
        if not self.given:
            end = self.within(fixed, fixed, start)
            if self.tried and len(sizes) > FEW and not end.usable:
                return end.x
        design = {**end.design, **dict(zip(self.grids, map(float, sizes), strict=True))}
        values, angles = solved_values(self.task, design, end.x)  # the crank angles may follow from the sizes
        angles = in_first_cycle(self.task, angles)
        checked = validate(self.task, values, angles)
        made = LinkageDesign(self.design.problem, values, angles, checked.objective, Status.ROUNDED, checked)
        self.tried[key] = made
        if made.valid and (self.best is None or made.objective < self.best.objective):
            self.best_at = (end.x,)
            self.best, self.least = made, math.inf if end is self.top else self.nlp.values(end.x, self.top.p)[0]
        return end.x

    def corners(self) -> Iterator[list[float]]:
        """Yield the nearest values of the grid, and the other ones about the optimum if there are few."""
        sizes = self.sizes(self.top)
        yield self._nearest(sizes)
        if len(sizes) <= CORNERS:
            sides = [{grid.below(value), grid.above(value)} for grid, value in zip(self.grids.values(), sizes, strict=True)]
            yield from (list(corner) for corner in itertools.product(*sides))

    def run(self, progress: Progress = None, tries: int = 0) -> None:
        """Search the whole grid of few sizes, and near the optimum that of many, or where the search of the whole found none.

        `tries`: number of designs after which a search for any valid design ends; else it looks for the best one. Where a
        limit has no tolerance, and all free sizes are rounded, only the designs beside the optimum are tried.
        """
        for corner in itertools.islice(self.corners(), 1 if tries else None):
            if all(map(self._allowed, range(len(corner)), corner)):
                self.build(corner, self.top)
        if self.exact and self.best is None:
            return
        if len(self.at) <= FEW:
            self._whole(progress, tries)
        if len(self.at) > FEW or self.best is None:
            self.complete = False
            self._near(progress, tries or PER_SIZE * len(self.at), any_valid=bool(tries))

    def _whole(self, progress: Progress, tries: int) -> None:
        """Search the whole grid, best bound first; every node is a programme."""
        most = tries or WHOLE
        low, high = (np.array(self._sizes(ends)) for ends in (self.nlp.x_low, self.nlp.x_high))
        count = itertools.count()
        open_nodes = [_Node((self.top.objective, 0), low, high, self.top)]
        while open_nodes:
            if self.solved >= most or (tries and self.best is not None):
                self.complete = False
                return
            node = heapq.heappop(open_nodes)
            if not node.solution.usable or self._worse(node.solution.objective):
                better = node.above and self.elsewhere(node.low, node.high, node.above)
                if better:
                    heapq.heappush(open_nodes, _Node((better.objective, next(count)), node.low, node.high, better))
                continue
            sizes = self.sizes(node.solution)
            shares = [grid.off(value) for grid, value in zip(self.grids.values(), sizes, strict=True)]
            if not any(shares):
                self.build(self._nearest(sizes), node.solution)
                continue
            j = int(np.argmax(shares))
            grid = list(self.grids.values())[j]
            for side, end in ((0, grid.below(sizes[j])), (1, grid.above(sizes[j]))):
                box = [node.low.copy(), node.high.copy()]
                box[1 - side][j] = end
                if not math.isfinite(end) or box[0][j] > box[1][j] + ON_GRID * grid.width(sizes[j]):
                    continue
                start = replace(node.solution, x=self.moved(node.solution, j, end))
                solution = self.within(box[0], box[1], start)
                bound = solution.objective if solution.usable else math.inf
                heapq.heappush(open_nodes, _Node((bound, next(count)), box[0], box[1], solution, node.solution))
            if progress:
                progress(min(1.0, self.solved / most))

    def _near(self, progress: Progress, most: int, *, any_valid: bool) -> None:
        """Search the grid near the optimum by its quadratic model, and again near the best design found, while that gets better.

        The model lists designs in the order of its objective; each is evaluated, and validated if it meets its limits.
        """
        x, done = self.top.x, 0
        while True:
            before, reached = self.best, None
            for end in itertools.islice(self._listed(x), most - done):
                done += 1
                if progress:
                    progress(min(1.0, max(done / most, self.nodes / NODES)))
                if self.best is not before:
                    reached, before = end, self.best
                    if any_valid:
                        return
            if reached is None or done >= most:
                return
            x = reached

    def _listed(self, x: Array) -> Iterator[Array]:
        """Yield the scaled points of designs on the grid near one as they are built.

        Each is found by going down from the best open node of its quadratic model to the better of two, until it is on the grid.
        """
        nlp, p, count = self.nlp, self.top.p, itertools.count()
        sizes, grids = self._sizes(x), list(self.grids.values())
        reach = np.full(len(x), FARTHEST)
        reach[nlp.first_level :] = math.inf if nlp.first_level else FARTHEST
        reach[self.at] = [STEPS * grid.width(size) / v.size for grid, size, v in zip(grids, sizes, self.variables, strict=True)]
        model = QuadraticModel(nlp, x, p, self.top.conditions.multipliers[len(x) :], np.minimum(reach, 1e3))
        where = np.searchsorted(model.unknowns, self.at)
        others = set(model.unknowns) - set(self.at) - set(range(nlp.first_level or len(x), len(x)))
        first = model.minimum(model.least, model.most)
        version = 0
        heap = [] if first is None else [(first[0], next(count), 0, model.least, model.most, first[1])]
        below: list[Any] = []
        while (below or heap) and self.nodes < NODES:
            bound, _, made, low, high, change = below.pop() if below else heapq.heappop(heap)
            if bound >= self.least - SAME_OBJECTIVE * abs(self.least):
                continue
            if made != version:  # its rows are tighter by now
                self.nodes += 1
                again = model.minimum(low, high)
                if again is not None:
                    heapq.heappush(heap, (again[0], next(count), version, low, high, again[1]))
                continue
            here = [v.value(float(y)) for v, y in zip(self.variables, x[self.at] + change[where], strict=True)]
            shares = [
                grid.off(size) if abs(grid.nearest(size) - size) > CLOSE * grid.width(size) else 0.0
                for grid, size in zip(grids, here, strict=True)
            ]
            if not any(shares):
                made_of = self._nearest(here)
                if tuple(made_of) in self.evaluated:
                    continue
                end = x + model.follow @ change
                end[self.at] = [v.scaled(size) for v, size in zip(self.variables, made_of, strict=True)]
                start = multistart.solution_at(nlp, np.clip(end, nlp.x_low, nlp.x_high), self.top.message)
                self.evaluated.add(tuple(made_of))
                built = self.build(made_of, start) if others or start.usable else start.x
                if not start.usable and not others and np.isfinite(start.g).all():
                    model.tighten(change, start.g)
                    version += 1
                yield built
                continue
            j = int(np.argmax(shares))
            for side, edge in ((0, grids[j].below(here[j])), (1, grids[j].above(here[j]))):
                box = [low.copy(), high.copy()]
                if not math.isfinite(edge):
                    continue
                box[1 - side][where[j]] = self.variables[j].scaled(edge) - x[self.at[j]]
                if box[0][where[j]] > box[1][where[j]] + CLOSE * reach[self.at[j]]:
                    continue
                box[1] = np.maximum(*box)
                self.nodes += 1
                found = model.minimum(*box)
                if found is not None:
                    below.append((found[0], next(count), version, box[0], box[1], found[1]))
            below.sort(reverse=True)
            for node in below[:-1]:
                heapq.heappush(heap, node)
            del below[:-1]

    @cached_property
    def given(self) -> bool:
        """Whether the rounded sizes determine the design: no other size, and no crank angle, is free."""
        return set(self.task.free) <= self.grids.keys() and not any(part.data.offsets is None for part in self.task.parts)

    @cached_property
    def exact(self) -> bool:
        """Whether no size is left that could restore a limit without tolerance which the rounded ones change."""
        free = {name for name in self.task.free if name in self.task.mechanism.quantities}
        return free <= self.grids.keys() and any(not one.room and one.change and not one.one_sided for one in self.table())

    def closest(self) -> tuple[LinkageDesign | None, dict[str, str]]:
        """Return the design tried that misses the limits least, and the tolerances or bounds with which it would meet them."""
        moved: dict[str, float] = {}
        for one in self.table():
            moved[one.limit] = max(moved.get(one.limit, 0.0), one.change)

        def missed(design: LinkageDesign) -> dict[str, tuple[float, str]]:
            found = list(requirements(design.validation.checks))
            other = [check for check in design.validation.failures if not STATED.fullmatch(check.name)]
            if other or not all(math.isfinite(one.value) for one in found):
                return {}  # it is not a matter of tolerances, or the design does not reach a position
            return {one.name: (-one.margin, _admitting(one)) for one in found if not one.met}

        def worst(design: LinkageDesign) -> float:
            shares = [
                gap / next((change for limit, change in moved.items() if limit.startswith(name) and change), 1.0)
                for name, (gap, _) in missed(design).items()
            ]
            return max(shares, default=math.inf)

        near = min(self.tried.values(), key=worst, default=None)
        return near, {} if near is None else {name: words for name, (_, words) in missed(near).items()}

    def _allowed(self, j: int, value: float) -> bool:
        """Return whether a size is within its bounds."""
        k, v = self.at[j], self.variables[j]
        return bool(self.nlp.x_low[k] - 1e-12 <= v.scaled(value) <= self.nlp.x_high[k] + 1e-12)

    def _worse(self, objective: float) -> bool:
        """Return whether no design with such a bound is better than the best one."""
        return self.best is not None and objective >= self.best.objective - SAME_OBJECTIVE * abs(self.best.objective)

    def table(self) -> list[Influence]:
        """Return what half a step of each size changes of the limits, and what these admit; ends of strokes follow it."""
        nlp, sizes, found = self.nlp, self.sizes(self.top), dict[tuple[str, str], Influence]()
        here, count = nlp.at(self.top.x, self.top.p), nlp.first_level - nlp.first_event
        events = np.array([row.limit in nlp.states for row in nlp.rows], dtype=bool)
        following = np.zeros((count, len(here.gradient)))
        if count:
            own = here.jacobian[events]
            following = -np.linalg.lstsq(own[:, nlp.first_event : nlp.first_level], own, rcond=None)[0]
        jacobian = here.jacobian + here.jacobian[:, nlp.first_event : nlp.first_level] @ following
        for j, (name, grid) in enumerate(self.grids.items()):
            half = 0.5 * grid.width(sizes[j]) / self.variables[j].size
            for row, slope, value in zip(nlp.rows, jacobian[:, self.at[j]], here.g, strict=True):
                if row.limit in nlp.helpers or row.limit in nlp.states or not math.isfinite(slope):
                    continue
                two, size = math.isfinite(row.low) and math.isfinite(row.high), abs(row.scale.slope(float(value)))
                width, side = 0.5 * (row.high - row.low), min(value - row.low, row.high - value)
                two = two and abs(slope) * half > LEAST_SHARE * width  # of a wide range the nearer side counts
                away = width if two else side
                change, room = float(abs(slope) * half * size), float(away * size) if away > FEASIBLE else 0.0
                key = name, row.label or row.limit
                made = Influence(*key, change, room, row.scale.unit, one_sided=not two)
                if (two or change > max(LEAST_SHARE * room, FEASIBLE * size)) and (
                    key not in found or (made.share, change) > (found[key].share, found[key].change)
                ):
                    found[key] = made
        return list(found.values())


def rounded(
    result: SynthesisResult, grids: Mapping[str, Grid], backend: str = "ipopt", progress: Progress = None
) -> SynthesisResult:
    """Return a result whose designs have sizes on a grid, each one validated as built; unchanged without an optimum.

    Parameters
    ----------
    result : SynthesisResult
        Of a search; the search of the grid begins at each of its designs.
    grids : mapping of str to Grid
        From `read_steps`.
    backend : str
        Local solver.
    progress : function of the completed fraction, optional
    """
    tops, interrupted = [design for design in result.designs if design.solution is not None], result.interrupted
    if interrupted or not tops:
        why = "the search was interrupted" if interrupted else "its search ended at no optimum"
        return _unrounded(result, why) if result.designs else result
    timer, name, searches = Timer(), BACKENDS[1] if backend == "both" else backend, list[_Search]()

    def built() -> list[LinkageDesign]:
        return sorted((search.best for search in searches if search.best is not None), key=lambda one: one.objective)

    try:
        searches += [search for design in tops for search in _searches(design, grids, name)]
        for k, search in enumerate(searches):
            search.run(part(progress, k, len(searches)))
        none = not built() and not searches[0].exact
        finer = next((share for share in FINER if _exists(tops[0], grids, share, name)), None) if none else None
    except KeyboardInterrupt:
        interrupts.handled()
        interrupted, finer = True, None
    timer.lap("rounding")
    result, designs = replace(result, seconds=result.seconds | timer.seconds, interrupted=interrupted), built()
    if interrupted and not designs:
        return _unrounded(result, "the search of the grid was interrupted")
    first = searches[0]
    naive = first.tried.get(tuple(next(first.corners())))
    quantities, sizes = result.problem.model.quantities, designs[0].values if designs else {}
    record = Rounding(
        steps={one: grid.words(quantities[one], sizes.get(one, math.nan)) for one, grid in grids.items()},
        optimum=tops[0].values,
        objective=tops[0].objective,
        naive=None if naive is None else naive.objective,
        naive_valid=naive is not None and naive.valid,
        solved=sum(search.solved for search in searches),
        whole=len(grids) <= FEW and not interrupted and all(search.complete for search in searches),
        influences=tuple(sorted(first.table(), key=lambda one: -one.share)),
        finer=finer,
    )
    near, needed = (None, {}) if designs else first.closest()
    return replace(
        result,
        designs=tuple(designs),
        nearest=near,
        certificate=None,
        backends={},
        rounding=replace(record, needed=needed),
    )


def _unrounded(result: SynthesisResult, why: str) -> SynthesisResult:
    return replace(result, notes=(*result.notes, f"the sizes are not rounded: {why}"))


def _exists(design: LinkageDesign, grids: Mapping[str, Grid], share: float, backend: str) -> bool:
    """Return whether there is a valid design with the steps divided by a number."""
    search = next(_searches(design, {name: grid.finer(share) for name, grid in grids.items()}, backend))
    search.run(tries=TRIED)
    return search.best is not None


def _searches(design: LinkageDesign, grids: Mapping[str, Grid], backend: str) -> Iterator[_Search]:
    """Yield the search about a design, and those about the optima near it in which other strokes are the slow ones."""
    polisher, top = Polisher([design.problem], backend), design.solution
    assert top is not None
    yield _Search(design, top, grids, polisher)
    for other in polisher.other_paces(0, top):
        if other.usable:
            yield _Search(design, other, grids, polisher)


def _admitting(missed: Requirement) -> str:
    """Return the tolerance or bound with which a missed limit would admit its value."""
    gap = rounded_up(-missed.margin)
    above = missed.value > missed.high
    end = f"{missed.high + float(gap) if above else missed.low - float(gap):.10g}"
    if not math.isfinite(missed.high - missed.low):
        words = f"{'<=' if above else '>='} {end}"
    elif missed.low == 1.0 and not missed.unit:  # a ratio of 1 is often the least one possible
        words = f"1 ... {end}" if above else f"{end} ... {missed.high:.10g}"
    else:
        words = f"+- {rounded_up(0.5 * (missed.high - missed.low) - missed.margin)}"
    return f"{words} {missed.unit}".rstrip()


def rounded_up(value: float) -> str:
    """Return a positive number with two digits, not below it."""
    digits = math.floor(math.log10(value)) - 1
    return f"{math.ceil(value / 10.0**digits) * 10.0**digits:.2g}"
