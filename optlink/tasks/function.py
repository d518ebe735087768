"""Solve function synthesis problems of a four-bar: build, search and validate."""

from __future__ import annotations

import functools
import json
import math
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.errors import OPTIONS_NAMED, InputError, Status
from optlink.execution import interrupts
from optlink.io import checked
from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP
from optlink.optimization.objectives import MEASURES
from optlink.optimization.output_derivatives import error_at, error_function
from optlink.optimization.programme import build
from optlink.problem.arguments import typed
from optlink.problem.assignment import parse_assignments
from optlink.problem.document import Source
from optlink.problem.file import ProblemFile
from optlink.problem.fixed_design import fixed_design, started
from optlink.problem.quantity import Quantity, check_choice, input_of, read_quantity
from optlink.problem.targets.expression import Expression
from optlink.solvers import multistart
from optlink.solvers.exchange import place_at_peaks
from optlink.solvers.solution import EXACTLY_MET, Relaxation, Solution
from optlink.synthesis.freudenstein import FirstStep
from optlink.tasks.machine import UNKNOWN_QUANTITY, turning_machine
from optlink.tasks.modes import best_mode
from optlink.tasks.protocol import DesignTask, Search, agreement, part
from optlink.tasks.results.common import ROUNDED, RejectedDesign, SingleResult, best_rejected, better
from optlink.tasks.results.default_margins import margin_notes
from optlink.tasks.results.evidence import Evidence, evidence
from optlink.tasks.results.fit import Fit, law_fit
from optlink.tasks.results.rotation import cannot_turn
from optlink.units import KINDS, show
from optlink.validation import Check, validate as validate_law

ALONG = 2001  # positions along the span at which alternations are counted
SAME_DESIGN = 1e-6  # difference of equal designs, as a share of the frame
EXTREME_SHARE = 0.99  # fraction of the largest error that counts as an extreme value
MIN_CURVATURE = 1e-7  # least curvature, for an objective scaled to 1, of a unique optimum


@dataclass(frozen=True, eq=False, repr=False)
class FunctionResult(SingleResult):
    """A design with its validation, or the reason why there is none."""

    kind = "function"
    shown: ClassVar[Mapping[str, Source]] = {
        **SingleResult.shown,
        "assembly": "assembly",
        "objective": "stated_objective",
        "evidence?": "evidence",
        "starts_that_reached_each_value?": lambda result: result.counts or None,
        "first_step?": lambda result: result.first and vars(result.first) | {"gap": result.first.gap},
    }

    first: FirstStep | None = None  # best convex first design of a function
    margins: tuple[str, ...] = ()  # notes on default margins that exclude a better optimum
    counts: tuple[int, ...] = ()  # random starts that reached each value of the objective, that of the design first

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""
        free = set(self.problem.spec.free)
        if self.conflict:
            spec = self.problem.spec
            return cannot_turn(spec.mechanism, spec.linkage, spec.limits.crank, spec.limits.alignment.value)
        notes: tuple[str, ...] = () if self.rejected is None else (self.rejected.note,)
        notes += self.margins
        if self.solution is None or not free.issuperset(LENGTHS) or self.solution.curvature > MIN_CURVATURE:
            return notes
        return (
            *notes,
            "all four lengths are free and only their ratios matter here: any multiple within the bounds is as good; fix one",
        )

    def merged(self, results: Sequence[Self]) -> Self:
        """Return the result with the starts, optima and counts of all assembly modes."""
        counts = (count for result in results if result is not self for count in result.counts)
        return replace(super().merged(results), counts=(*self.counts, *counts))

    @property
    def evidence(self) -> Evidence | None:
        """Evidence of the random starts on optima not found; None without random starts."""
        if not self.counts:
            return None
        return replace(evidence(self.counts), missed=0.0) if self.exact else evidence(self.counts)

    @property
    def exact(self) -> bool:
        """Whether the design is an optimum without errors, up to the rounding of the decimals of the law."""
        return self.valid and MEASURES["rms"].of(self.error()) <= ROUNDED

    @property
    def assembly(self) -> str:
        """Assembly mode of the design."""
        return str(self.problem.spec.mechanism.assembly)

    @property
    def tolerances(self) -> dict[str, float] | None:
        """Tolerances [SI] of a robust design by the name of the dimension; None for others."""
        spec = self.problem.spec
        return None if spec.requirement.robust is None else {d.name: d.tolerance for d in spec.deviations}

    @property
    def strokes(self) -> dict[str, Any]:
        """Strokes of every output, as JSON; empty if the crank does not turn fully."""
        from optlink.tasks.results.strokes import stroke_document

        machine = turning_machine(self.problem, self.design)
        return {} if machine is None else stroke_document(machine, self.problem.spec.span)

    @property
    def sizes(self) -> dict[str, float]:
        """The four lengths of the design [m]."""
        return {name: self.design[name] for name in LENGTHS}

    def error(self, offsets: ArrayLike | None = None) -> NDArray[np.float64]:
        """Return target minus actual rocker angle [rad], in (-pi, pi], at crank rotations [rad] from the start.

        Default: at the design positions.
        """
        problem = self.problem.spec
        at = problem.law.offsets if offsets is None else np.asarray(offsets, dtype=float)
        return error_at(problem, self.design, at)

    @property
    def between(self) -> float | None:
        """Largest error [rad] between the design positions of an expression; None if it is the same as at them to four digits."""
        problem = self.problem.spec
        if not isinstance(problem.requirement.law, Expression):
            return None
        at_positions, span = (float(np.max(np.abs(self.error(at)))) for at in (None, problem.span * np.linspace(0.0, 1.0, 721)))
        return span if math.isfinite(span) and span > at_positions * (1.0 + 5e-4) else None

    @functools.cached_property
    def fit(self) -> Fit | None:
        """Error at the design positions relative to the output range; None if there is no error to measure."""
        return law_fit(self.problem, self.design, self.error(), self.solution)

    @property
    def alternations(self) -> int:
        """Number of successive alternations of the error (including tolerances) between its extreme values.

        A minimax optimum of k design variables has k + 1 of them if no limit is active.
        """
        begin, end = self.problem.spec.law.offsets[[0, -1]]
        error = error_function(self.problem.spec)(self.design, np.linspace(begin, end, ALONG))
        peaks = error[np.abs(error) >= EXTREME_SHARE * np.max(np.abs(error))]
        return 1 + int(np.sum(np.diff(np.sign(peaks)) != 0.0)) if len(peaks) else 0

    @property
    def measure(self) -> str:
        """Name of the error measure, including the effect of tolerances if considered."""
        task = self.problem.spec.requirement
        return str(task.measure if task.robust is None else task.robust.named(task.measure))

    @property
    def machine(self) -> ProblemFile:
        """The problem with all dimensions fixed at the design; its crank starts and turns as the task requires."""
        return started(fixed_design(self.problem, self.design), self.design["phi0"], self.problem.spec.span)

    @property
    def unit(self) -> str:
        """Unit of the objective."""
        return self.problem.spec.objective_unit

    @property
    def stated_objective(self) -> dict[str, Any]:
        """Objective and errors; what the tolerances add, and the alternations of a minimax optimum."""
        spec, error = self.problem.spec, self.error()
        further = {
            "alternations": self.alternations if spec.measure == "max" else None,
            "robust": getattr(spec.requirement.robust, "text", None),
            "tolerances_SI": self.tolerances,
        }
        return {
            "value": self.objective,
            "unit": self.unit,
            "measure": spec.measure,
            "rms_deg": math.degrees(MEASURES["rms"].of(error)),
            "largest_deg": math.degrees(MEASURES["max"].of(error)),
            **{key: value for key, value in further.items() if value is not None},
        }

    def displayed(self, design: Mapping[str, float]) -> dict[str, float]:
        """Return a design [SI] in display units, which end the keys."""
        return super().displayed(self.complete(design))


class FunctionTask(DesignTask[FunctionResult]):
    """Function synthesis of a four-bar.

    `starts` are those per assembly mode. Law: the start in the problem, then Sobol points over the bounds. Function: always the
    convex first designs (`optlink.synthesis.function_starts`) and the start in the problem, then fits at random start angles.
    Default: until the estimated chance of a missed better optimum is small (`optlink.tasks.function_search`); 1 for a law of at
    most two design variables, whose optimum `optlink.solve` certifies.
    """

    most_starts = 100_000
    certified = True
    divisible = True
    free_example = 'coupler = { start = "400 mm", bounds = ["100 mm", "900 mm"] }'

    def check(self, problem: ProblemFile) -> None:
        """Refuse a problem without a requirement."""
        _ = problem.spec

    def search(self, problem: ProblemFile, search: Search) -> FunctionResult:
        """Return the best design over the assembly modes; see `DesignTask.search`."""
        result = best_mode(problem, search, _search)
        if not result.valid or result.solution is None:
            return replace(result, rejected=None)

        def relaxed(other: ProblemFile) -> float:
            from optlink.tasks.function_search import near_optimum

            return near_optimum(other.spec, result.design, result.backend).objective

        notes = margin_notes(result.problem, result.design, result.solution.limits, result.objective, relaxed)
        return replace(result, margins=notes)

    def programme(self, problem: ProblemFile) -> NLP:
        """Return the programme of the design positions; see `DesignTask.programme`."""
        self.check(problem)
        return build(problem.spec)

    def place(self, problem: ProblemFile, nlp: NLP, x: Array) -> None:
        """Move the exchange points to the peaks of the error; see `DesignTask.place`."""
        place_at_peaks(problem.spec, nlp, x)

    def validate(self, problem: ProblemFile, design: Mapping[str, float]) -> FunctionResult:
        """Validate a given design, in the better assembly mode if the file leaves it open; see `DesignTask.validate`."""
        begin = time.perf_counter()
        results = []
        for variant in problem.variants():
            full = variant.spec.design(design)
            checked = validate_law(variant.spec, full)
            seconds = {"build": 0.0, "solve": 0.0, "validate": time.perf_counter() - begin}
            results.append(FunctionResult(variant, Status.NOT_SEARCHED, "none", full, checked.objective, checked, seconds))
        return min(results, key=better)


TASK = FunctionTask()
solve, validate = TASK.solve, TASK.validate


def _search(problem: ProblemFile, search: Search) -> FunctionResult:
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
    return FunctionResult(
        problem=problem,
        status=winner.solution.status,
        backend=next(name for name, item in searches.items() if item is chosen),
        design=winner.design,
        objective=winner.solution.objective,
        validation=winner.validation.with_checks(checks),
        seconds=search.timer.seconds | {"solve": search.timer.seconds["solve"] - validating, "validate": validating},
        seed=search.seed,
        starts=chosen.starts,
        solution=winner.solution,
        backends=backends if len(search.names) > 1 else {},
        optima=chosen.distinct_optima(str(spec.mechanism.assembly)) if search.begin is None else (),
        counts=tuple(chosen.counts) if chosen.random else (),
        interrupted=interrupted,
        conflict=conflict[0],
        together=conflict[1],
        first=points.step,
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
