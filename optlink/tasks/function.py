"""Solve function synthesis problems of a four-bar: build, search and validate."""

from __future__ import annotations

import functools
import json
import math
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from optlink.errors import OPTIONS_NAMED, InputError, Status
from optlink.execution import interrupts
from optlink.io import checked
from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import build
from optlink.problem.arguments import typed
from optlink.problem.assignment import parse_assignments
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import Quantity, check_choice, input_of, read_quantity
from optlink.solvers import multistart
from optlink.solvers.exchange import place_at_peaks
from optlink.solvers.solution import EXACTLY_MET, Relaxation, Solution
from optlink.tasks.machine import UNKNOWN_QUANTITY
from optlink.tasks.modes import each_mode, mode_of
from optlink.tasks.protocol import DesignTask, Search, agreement, part
from optlink.tasks.results.common import RejectedDesign, best_rejected
from optlink.tasks.results.default_margins import margin_notes
from optlink.tasks.results.design import LinkageDesign, SynthesisResult, of_designs
from optlink.tasks.results.evidence import evidence
from optlink.tasks.results.rotation import cannot_turn
from optlink.units import KINDS, show
from optlink.validation import Check, validate as validate_law

SAME_DESIGN = 1e-6  # difference of equal designs, as a share of the frame
MIN_CURVATURE = 1e-7  # least curvature, for an objective scaled to 1, of a unique optimum
ONLY_RATIOS = "all four lengths are free and only their ratios matter here: any multiple within the bounds is as good; fix one"


class FunctionTask(DesignTask[SynthesisResult]):
    """Function synthesis of a four-bar.

    `starts` are those per assembly mode. Law: the start in the problem, then Sobol points over the bounds. Function: always the
    convex first designs (`optlink.synthesis.function_starts`) and the start in the problem, then fits at random start angles.
    Default: until the estimated chance of a missed better optimum is small (`optlink.tasks.function_search`); 1 for a law of at
    most two design variables, whose optimum `optlink.solve` certifies.
    """

    most_starts = 100_000
    designs = 3
    certified = True
    divisible = True
    free_example = 'coupler = { start = "400 mm", bounds = ["100 mm", "900 mm"] }'

    def check(self, problem: ProblemFile) -> None:
        """Refuse a problem without a requirement."""
        _ = problem.spec

    def search(self, problem: ProblemFile, search: Search) -> SynthesisResult:
        """Return the best designs over the assembly modes; see `DesignTask.search`."""
        found = each_mode(problem, search, _search)
        result = _merged(problem, found, search.designs)
        return replace(result, notes=tuple(_notes(result)))

    def programme(self, problem: ProblemFile) -> NLP:
        """Return the programme of the design positions; see `DesignTask.programme`."""
        self.check(problem)
        return build(problem.spec)

    def place(self, problem: ProblemFile, nlp: NLP, x: Array) -> None:
        """Move the exchange points to the peaks of the error; see `DesignTask.place`."""
        place_at_peaks(problem.spec, nlp, x)

    def validate(self, problem: ProblemFile, design: Mapping[str, float]) -> SynthesisResult:
        """Validate a given design, in the better assembly mode if the file leaves it open; see `DesignTask.validate`."""
        begin = time.perf_counter()
        designs = []
        for variant in problem.variants():
            task = variant.spec
            full = task.design(design)
            checked = validate_law(task, full)
            angles = task.crank_angles(full, None)
            designs.append(LinkageDesign(variant, full, angles, checked.objective, Status.NOT_SEARCHED, checked))
        return of_designs(problem, designs, 1, backend="none", seconds={"validate": time.perf_counter() - begin})


TASK = FunctionTask()
solve, validate = TASK.solve, TASK.validate


def _merged(problem: ProblemFile, results: Sequence[SynthesisResult], count: int) -> SynthesisResult:
    """Return the result with the designs, starts and optima of the searches of all assembly modes."""
    best = min(results, key=lambda result: (not result.valid, result.status is Status.INFEASIBLE, result.objective))
    first = [best, *(result for result in results if result is not best)]
    counts = [count for result in first if result.evidence is not None for count in result.evidence.counts]
    merged = replace(
        of_designs(problem, [*filter(None, (best.nearest,)), *(one for result in first for one in result.designs)], count),
        **{name: getattr(best, name) for name in ("backend", "seed", "backends", "conflict", "together", "first_step")},
        starts=sum(result.starts for result in results),
        evidence=evidence(counts) if counts else None,
        interrupted=any(result.interrupted for result in results),
        seconds={key: sum(result.seconds[key] for result in results) for key in best.seconds},
        optima=tuple(sorted((one for result in results for one in result.optima), key=lambda optimum: optimum.objective)),
        rejected=best_rejected((result.rejected for result in results), best.objective) if best.valid else None,
    )
    return replace(merged, evidence=replace(merged.evidence, missed=0.0)) if merged.evidence and merged.exact else merged


def _notes(result: SynthesisResult) -> Iterator[str]:
    """Yield notes on what excludes a better design, or other designs that are as good."""
    best, task = result.best, result.problem.spec
    if result.conflict:
        yield from cannot_turn(task.mechanism, task.linkage, task.limits.crank, task.limits.alignment.value)
        return
    if result.rejected is not None:
        yield result.rejected.note
    if best is None or best.solution is None:
        return
    if best.valid:

        def relaxed(other: ProblemFile) -> float:
            from optlink.tasks.function_search import near_optimum

            return near_optimum(other.spec, best.values, result.backend).objective

        yield from margin_notes(best.problem, best.values, best.limits, best.objective, relaxed)
    if set(task.free).issuperset(LENGTHS) and best.solution.curvature <= MIN_CURVATURE:
        yield ONLY_RATIOS


def _search(problem: ProblemFile, search: Search) -> SynthesisResult:
    """Return the best design in one assembly mode."""
    from optlink.tasks.function_search import SHARED_STARTS, FunctionSearch, start_sequence

    spec = problem.spec
    nlp = build(spec)
    for name in search.names:
        multistart.prepare(nlp, name)
    interrupts.check()
    search.timer.lap("build")
    points = start_sequence(spec, nlp, search.seed, search.begin)
    reason = functools.cache(lambda exactly=False: _explained(nlp, search.seed, exactly))
    searches = {name: FunctionSearch(spec, nlp, name, track=search.track) for name in search.names}
    count, interrupted = search.starts, False
    runs = search.runs if search.shared or (count or 0) >= SHARED_STARTS else None
    for k, item in enumerate(searches.values()):
        if item.run(points, count, lambda: reason()[0], part(search.progress, k, len(searches)), runs):
            count, interrupted = item.starts, True  # the other solver then uses as many starting points
    conflict: Conflict = ((), ())
    chosen = min(searches.values(), key=lambda item: item.result.rank)
    winner = chosen.result
    if not chosen.usable or (not winner.verified and winner.solution.violation > EXACTLY_MET):  # met within the tolerance only
        for exactly in (True,) if chosen.usable else (False, True):
            _, miss, conflict = reason(exactly)
            if miss is not None:
                winner = chosen.judge(miss)
                break
    nlp.p[1:] = winner.solution.p[1:]
    backends = {name: item.result.solution if item.usable else winner.solution for name, item in searches.items()}
    checks: tuple[Check, ...] = ()
    if len(search.names) > 1:
        backends = multistart.reconcile(nlp, backends)
        winner = min([winner, *(chosen.judge(solution) for solution in backends.values())], key=lambda candidate: candidate.rank)
        checks = agreement("design", multistart.compare(*backends.values()), SAME_DESIGN, "<= 1e-06 frame")
    search.timer.lap("solve")
    validating = sum(item.validating for item in searches.values())
    best = replace(winner.found(problem), validation=winner.validation.with_checks(checks))
    others = chosen.others(winner) if search.begin is None else []
    return replace(
        of_designs(problem, [best, *(candidate.found(problem) for candidate in others)], search.designs),
        backend=next(name for name, item in searches.items() if item is chosen),
        seconds=search.timer.seconds | {"solve": search.timer.seconds["solve"] - validating, "validate": validating},
        seed=search.seed,
        starts=chosen.starts,
        evidence=evidence(chosen.counts) if chosen.random else None,
        backends=backends if len(search.names) > 1 else {},
        optima=chosen.distinct_optima(mode_of(problem)) if search.begin is None else (),
        interrupted=interrupted,
        conflict=conflict[0],
        together=conflict[1],
        first_step=points.step,
        rejected=best_rejected(
            (
                RejectedDesign(problem, one.design, one.solution.objective, one.validation.failures)
                for one in filter(None, (item.rejected for item in searches.values()))
            ),
            winner.solution.objective if winner.verified else math.inf,
        ),
    )


Conflict = tuple[tuple[Relaxation, ...], tuple[Relaxation, ...]]


def _explained(nlp: NLP, seed: int, exactly: bool) -> tuple[Array | None, Solution | None, Conflict]:
    """Return a feasible point, or the nearest design and the conflicting limits, if no start led to a feasible design."""
    from optlink.solvers.infeasibility import Explanation, explain

    nlp.spread_exchange_points()
    reason = explain(nlp, seed, exactly=exactly)
    if not isinstance(reason, Explanation):
        return reason, None, ((), ())
    miss = multistart.infeasible_at(nlp, reason.x, "nearest design")
    return None, miss, (reason.conflict, reason.together)


def _stored(text: str, quantities: Mapping[str, Quantity]) -> list[tuple[str, object]]:
    """Return the assignments of a result.json, one per quantity (phi0 and psi0 only if not derived)."""
    try:
        document = json.loads(Path(text).read_text(encoding="utf-8"))
        state = document.get("state", {}) if checked(document) is not None else {}  # of a changed file the displayed design
        best = (state.get("designs") or [document.get("nearest") or {}])[0] if "designs" in state else {}
        exact = state.get("design") or best.get("values")  # [SI]
        if isinstance(exact, dict):
            return [
                (name, f"{float(value)!r} {KINDS[quantities[name].kind].si}")
                for name, value in exact.items()
                if name in quantities
            ]
        design = document["design"].items()
        parts = [(*key.rpartition("_"), float(value)) for key, value in design if not isinstance(value, bool)]
        return [(name, f"{value!r} {unit}") for name, _, unit, value in parts if name in quantities or name in LENGTHS]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or "no design in it"
        raise InputError(
            f"cannot read a design: {reason}", "Give a result.json that `solve --out` wrote", text, "--design"
        ) from None


@typed
def read_design(problem: ProblemFile, assignments: list[str], varied: Collection[str] = ()) -> dict[str, float]:
    """Read a design from texts such as "coupler=412.26 mm", or from the name of a result.json.

    Parameters
    ----------
    problem : ProblemFile
    assignments : list of str
        "NAME=VALUE", or the path of a result.json.
    varied : collection of str
        Design variables that need no value.

    Returns
    -------
    mapping of str to float [m, rad]

    Raises
    ------
    InputError
        For unknown or missing names, or values that are not quantities.
    """
    quantities = problem.model.quantities
    design: dict[str, float] = {}
    stored = [pair for text in assignments if text.endswith(".json") for pair in _stored(text, quantities)]
    assigned = parse_assignments([text for text in assignments if not text.endswith(".json")], "--design")
    for key, value in (*stored, *assigned.items()):
        name = key.removeprefix("mechanism.")
        check_choice("--design", name, quantities, UNKNOWN_QUANTITY, problem.file)
        if isinstance(value, dict | list):
            remedy = f'Give one value, such as {name}="{show(quantities[name].value, quantities[name].kind)}"'
            raise InputError("a given design has no bounds", remedy, problem.file, f"--design {name}", value)
        with input_of(problem.file, f"--design {name}", value):
            design[name] = float(read_quantity(value, quantities[name].kind).value)
    check_complete(problem, {*design, *varied})
    return design


def check_complete(problem: ProblemFile, names: Collection[str]) -> None:
    """Refuse a design without a value for each of the design variables.

    Raises
    ------
    InputError
        If one is missing.
    """
    quantities = problem.model.quantities
    missing = [name for name in problem.model.free if name not in names]
    if missing:
        starts = [(name, quantities[name]) for name in missing]
        if OPTIONS_NAMED.get():
            example = " ".join(f'--design {name}="{show(start.value, start.kind)}"' for name, start in starts)
        else:
            example = f"design={json.dumps({name: float(f'{start.value:.6g}') for name, start in starts})}"
        raise InputError(f"the design lacks {', '.join(missing)}", f"Add for example {example}", problem.file, "--design")
