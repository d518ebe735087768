"""From a problem to a result: build, search, prove. What the command line, notebooks and scripts call."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.design.files import ProblemFile, parse_assignment
from optlink.design.objectives import MEASURES
from optlink.design.quantity import Quantity, Unusable, nearest, read_quantity
from optlink.documents import finite
from optlink.errors import Fault, InputError, Status
from optlink.fit import Fit, law_fit
from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.motion import sweep
from optlink.linkage.structure import EITHER
from optlink.outcome import Optimum, heading, optimality, proof, proven
from optlink.solvers.solution import Solution
from optlink.units import show
from optlink.validation import Check, Validation
from optlink.validation import validate as prove

if TYPE_CHECKING:
    from optlink.design.nlp import NLP
    from optlink.design.problem import DesignProblem
    from optlink.solvers.freudenstein import FirstStep
    from optlink.solvers.search import Agreement

Start = NDArray[np.float64]
SCHEMA = "optlink/result/1"
MAX_STARTS = 100_000
SAME_DESIGN = 1e-6  # of the frame
ALONG = 2001  # positions along the span at which an error curve is followed
EXCHANGES, LEVELLED = 12, 1e-8  # rounds, and the share by which an error may exceed those that the programme knows
APART = 1e-4  # rad; nearer than that two positions are one
LEVEL = 0.99  # share of the largest error that counts as reaching it
FLAT = 1e-7  # least curvature, for an objective scaled to 1, that singles out one design
PEOPLE = {"length": (1e3, "mm"), "angle": (math.degrees(1.0), "deg")}


def people(name: str, value: float) -> tuple[float, str]:
    """A quantity of a design in the unit that people read: mm or deg."""
    factor, unit = PEOPLE["angle" if name in ("phi0", "psi0") else "length"]
    return value * factor, unit


@dataclass(frozen=True)
class Relaxed:
    """A limit that would have to give (see `optlink.solvers.conflict.Relaxation`)."""

    name: str
    key: str
    sense: str
    bound: float
    relaxed: float
    amount: float
    unit: str


@dataclass(frozen=True)
class Result:
    """A design with its proof, or why there is none."""

    problem: ProblemFile
    status: Status
    backend: str
    design: dict[str, float]
    objective: float
    validation: Validation
    seconds: dict[str, float]
    seed: int | None = None
    starts: int = 0
    solution: Solution | None = None
    backends: dict[str, Solution] = field(default_factory=dict)
    optima: tuple[Optimum, ...] = ()
    conflict: tuple[Relaxed, ...] = ()
    together: tuple[Relaxed, ...] = ()
    first: FirstStep | None = None  # the convex first step that the search of a function began with

    @property
    def valid(self) -> bool:
        """Whether the design is proven (and found to be an optimum, if one was searched)."""
        return proven(self.status, self.validation)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know beside the figures."""
        free = set(self.problem.spec.free)
        if self.solution is None or not free.issuperset(LENGTHS) or self.solution.curvature > FLAT:
            return ()
        return (
            "all four lengths are free and only their ratios matter here: any multiple within the bounds is as good; fix one",
        )

    @property
    def sizes(self) -> dict[str, float]:
        """The four lengths of the design [m]."""
        return {name: self.design[name] for name in LENGTHS}

    def error(self, offsets: ArrayLike | None = None) -> NDArray[np.float64]:
        """Wanted minus generated rocker angle [rad], in (-pi, pi], at crank rotations [rad] from the start.

        At the design positions if no `offsets` are given.
        """
        problem = self.problem.spec
        at = problem.law.offsets if offsets is None else np.asarray(offsets, dtype=float)
        return _error(problem, self.design, at)

    @property
    def fit(self) -> Fit | None:
        """Its error at the design positions against the range of the output; None where there is no error to measure."""
        problem = self.problem.spec
        wanted = problem.law.curve(problem.law.offsets, self.design["phi0"], self.design["psi0"])
        limits = self.solution.limits if self.solution else ()
        return law_fit(problem, self.design, self.error(), wanted, limits)

    @property
    def alternations(self) -> int:
        """How many times in a row the error (with what tolerances add to it) reaches its largest size with the other sign.

        A minimax optimum of k free quantities has k + 1 of them where no limit holds it.
        """
        begin, end = self.problem.spec.law.offsets[[0, -1]]
        error = _judged(self.problem.spec)(self.design, np.linspace(begin, end, ALONG))
        peaks = error[np.abs(error) >= LEVEL * np.max(np.abs(error))]
        return 1 + int(np.sum(np.diff(np.sign(peaks)) != 0.0)) if len(peaks) else 0

    @property
    def measure(self) -> str:
        """Name of the objective's measure, in words: with what tolerances add to it, if they count."""
        task = self.problem.spec.requirement
        return task.measure if task.robust is None else task.robust.named(task.measure)

    @property
    def unit(self) -> str:
        """Unit of the objective."""
        return MEASURES[self.problem.spec.requirement.measure].unit

    def to_dict(self) -> dict[str, Any]:
        """The result as a JSON document: SI, or the unit that the key ends in; null where there is no finite value."""
        document = heading(SCHEMA, self) | {
            "design": _design(self.design),
            "objective": {
                "value": self.objective,
                "unit": self.unit,
                "measure": self.problem.spec.requirement.measure,
                "rms_deg": math.degrees(MEASURES["rms"].of(self.error())),
                "largest_deg": math.degrees(MEASURES["max"].of(self.error())),
            },
        }
        document["fit"] = None if self.fit is None else self.fit.to_dict()
        document |= proof(self, lambda design: _design(self.problem.spec.design(design)))
        if self.first is not None:
            document["first_step"] = vars(self.first) | {"gap": self.first.gap}
        if self.problem.spec.requirement.measure == "max":
            document["objective"]["alternations"] = self.alternations
        robust = self.problem.spec.requirement.robust
        if robust is not None:
            counted = {d.name: d.tolerance for d in self.problem.spec.deviations}
            document["objective"] |= {"robust": robust.text, "tolerances_SI": counted}
        return finite(document)  # type: ignore[no-any-return]


def _error(problem: DesignProblem, design: Mapping[str, float], offsets: Start) -> Start:
    """Wanted minus generated rocker angle [rad], in (-pi, pi], at crank rotations [rad] from the start."""
    wanted = problem.law.curve(offsets, design["phi0"], design["psi0"])
    motion = sweep(problem.linkage, problem.sizes(design), design["phi0"] + offsets)
    angle = np.asarray(motion.body_angle("rocker").value, dtype=float)
    return np.asarray(np.remainder(wanted - angle + np.pi, 2.0 * np.pi) - np.pi, dtype=float)


def _judged(problem: DesignProblem) -> Callable[[Mapping[str, float], Start], Start]:
    """Function of a design and crank rotations: the error, larger by what tolerances add to its size if they count [rad]."""
    if problem.requirement.robust is None or problem.requirement.measure != "max":
        return lambda design, offsets: _error(problem, design, offsets)
    from optlink.design.slopes import Judge

    judge = Judge(problem)

    def judged(design: Mapping[str, float], offsets: Start) -> Start:
        lower, upper = judge.band(design, offsets)
        return np.where(np.abs(upper) >= np.abs(lower), upper, lower)

    return judged


def _design(design: Mapping[str, float]) -> dict[str, float]:
    return {f"{name}_{people(name, value)[1]}": people(name, value)[0] for name, value in design.items()}


def solve(
    problem: ProblemFile,
    backend: str = "ipopt",
    starts: int | None = None,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
    *,
    track: bool = False,
    begin: Mapping[str, float] | None = None,
) -> Result:
    """Find the design and prove it.

    Parameters
    ----------
    problem : ProblemFile
        From `optlink.load`.
    backend : "slsqp", "ipopt" or "both"
        Both: each searches for itself, the better design is taken, and they must agree.
    starts : int, optional
        1: the start given in the problem; more: Sobol points over the bounds as well. Left out: 1, and for a function that
        crank, coupler and rocker are free for the convex first steps (`optlink.solvers.freudenstein`).
    seed : int
        Of the Sobol points.
    progress : function of the number of starts done, optional
    track : bool
        Keep the iterates of the first search.
    begin : mapping of free quantities [SI], optional
        Search from this design alone.

    Raises
    ------
    InputError
        when nothing is free, or an argument is out of range.
    """
    from optlink.design.nlp import build
    from optlink.solvers import search

    if backend not in (*search.BACKENDS, "both"):
        raise InputError(Fault("unknown back end", nearest(backend, [*search.BACKENDS, "both"]), key="backend", value=backend))
    if starts is not None and not 1 <= starts <= MAX_STARTS:
        raise InputError(Fault("out of range", f"Give a number from 1 to {MAX_STARTS}", key="starts", value=starts))
    if seed < 0:
        raise InputError(Fault("a seed is not negative", "Give 0 or more", key="seed", value=seed))
    if not problem.spec.free:
        example = 'Free one: coupler = { start = "400 mm", bounds = ["100 mm", "900 mm"] }, or check the design: optlink validate'
        raise InputError(Fault("nothing is free, there is nothing to find", example, problem.file, "mechanism"))
    if problem.spec.mechanism.assembly == EITHER:
        return _either(problem, backend, starts, seed, progress, track=track, begin=begin)
    names = search.BACKENDS if backend == "both" else (backend,)
    for name in names:
        search.backend(name)  # imports are nobody's solving time
    clock = [time.perf_counter()]
    nlp = build(problem.spec)
    for name in names:
        search.prepare(nlp, name)
    first, points = _begin(problem.spec, nlp, starts, seed) if begin is None else (None, [nlp.x_of(dict(begin))])
    starts = len(points)
    clock.append(time.perf_counter())
    done = 0

    def advance(_: int) -> None:
        nonlocal done
        done += 1
        if progress:
            progress(done)

    runs: dict[str, list[Solution]] = {}
    for name in names:
        runs[name] = search.multistart(nlp, name, points, advance, track=track)
        points = points[: len(runs[name])]  # fewer if interrupted; the other back end then searches from as many
    starts = len(points)
    found = {name: search.best(run) for name, run in runs.items()}
    conflict: tuple[Relaxed, ...] = ()
    together: tuple[Relaxed, ...] = ()
    if not any(solution.usable for solution in found.values()):
        from optlink.solvers.conflict import Explanation, explain

        reason = explain(nlp, seed)
        if isinstance(reason, Explanation):
            conflict = tuple(Relaxed(**vars(item)) for item in reason.conflict)
            together = tuple(Relaxed(**vars(item)) for item in reason.together)
            nearest_design = replace(search.given(nlp, reason.x, "nearest design"), status=Status.INFEASIBLE)
            found = dict.fromkeys(names, nearest_design)
        else:
            found = {name: search.solve_from(nlp, reason, name, track=track) for name in names}
    if len(found) > 1:
        found = search.reconcile(nlp, found)
    if problem.spec.everywhere:
        found = _level(problem.spec, nlp, found)
    winner = search.best(list(found.values()))
    chosen = next(name for name, solution in found.items() if solution is winner)
    clock.append(time.perf_counter())
    design = problem.spec.design(winner.design)
    proof = prove(problem.spec, design, winner.objective)
    checks = (*proof.checks, *optimality(winner))
    if len(found) > 1:
        checks += _agreement(search.compare(*found.values()))
    clock.append(time.perf_counter())
    clusters = search.cluster(nlp, [s for run in runs.values() for s in run]) if starts > 1 else []
    return Result(
        problem=problem,
        status=winner.status,
        backend=chosen,
        design=design,
        objective=winner.objective,
        validation=Validation(checks, proof.objective),
        seconds={name: b - a for name, a, b in zip(("build", "solve", "validate"), clock, clock[1:], strict=False)},
        seed=seed,
        starts=starts,
        solution=winner,
        backends=found if backend == "both" else {},
        optima=tuple(Optimum(problem.spec.design(c.solution.design), c.solution.objective, c.count) for c in clusters),
        conflict=conflict,
        together=together,
        first=first,
    )


def _level(problem: DesignProblem, nlp: NLP, found: dict[str, Solution]) -> dict[str, Solution]:
    """Put the largest errors between the design positions into the programme until none exceeds those it knows (E. Remez).

    Those of earlier rounds stay as long as there is room: where the error is flat, two designs would exceed each other's in turn.
    """
    from optlink.linkage.refine import extremes
    from optlink.solvers import search

    grid, judged = np.sort(np.linspace(0.0, problem.span, ALONG)), _judged(problem)
    known: list[float] = []
    ends = [0.0, problem.span]  # are positions already
    for _ in range(EXCHANGES):
        winner = search.best(list(found.values()))
        if not winner.usable:
            break
        design = problem.design(winner.design)

        size = np.abs(judged(design, grid))
        peaks = np.flatnonzero((size >= np.append(size[1:], 0.0)) & (size >= np.insert(size[:-1], 0, 0.0)))
        peaks = peaks[np.argsort(-size[peaks])][: nlp.roaming]
        near = [np.linspace(grid[max(int(k) - 1, 0)], grid[min(int(k) + 1, ALONG - 1)], 9) for k in peaks]
        exact = [extremes(lambda at: np.abs(judged(design, at))[None, :], brackets) for brackets in near]  # noqa: B023
        largest = max(float(values[0, 1]) for _, values in exact)
        if largest <= winner.objective * (1.0 + LEVELLED) + 1e-12:
            break
        new = [at for at in (float(angles[0, 1]) for angles, _ in exact) if _apart(at, ends)]
        if not new:
            break
        known = [at for at in sorted(known, key=lambda at: -(judged(design, np.array([at]))[0] ** 2)) if _apart(at, new)]
        known = (new + known)[: nlp.roaming]
        nlp.roam(np.array(known))
        found = {name: search.solve_from(nlp, solution.x, name) for name, solution in found.items()}
    return found


def _apart(at: float, others: list[float]) -> bool:
    """Whether a position [rad] says something that none of the others does."""
    return min((abs(at - other) for other in others), default=math.inf) > APART


def _begin(problem: DesignProblem, nlp: NLP, starts: int | None, seed: int) -> tuple[FirstStep | None, list[Start]]:
    """Starts of the search: as many as are asked for; else the given one, or a function's convex first steps, best first."""
    from optlink.solvers import convex, search

    if starts is not None or not convex.applies(problem):
        return None, search.starts(nlp, starts or 1, seed)
    steps = convex.steps(problem)
    if not steps:
        return None, search.starts(nlp, convex.ENOUGH, seed)
    return steps[0], [nlp.x_of(convex.values(problem, step)) for step in steps]


def _either(
    problem: ProblemFile,
    backend: str,
    starts: int | None,
    seed: int,
    progress: Callable[[int], None] | None,
    *,
    track: bool,
    begin: Mapping[str, float] | None,
) -> Result:
    """The better one of both assembly modes."""
    variants = [problem.override(change) for change in problem.model.mechanism.variants(problem.model.linkage)]
    found = [solve(variant, backend, starts, seed, progress, track=track, begin=begin) for variant in variants]
    return min(found, key=lambda result: (not result.valid, result.objective))


def _agreement(agreement: Agreement) -> tuple[Check, ...]:
    """Both back ends found the same figure, and the same design unless several are equally good."""
    one = agreement.design <= SAME_DESIGN
    words = "" if one or not agreement.same else " (two of equal value)"
    return (
        Check("both back ends agree: objective", agreement.same, agreement.objective, "<= 1e-06", ""),
        Check(f"both back ends agree: design{words}", agreement.same, agreement.design, "<= 1e-06 frame" if one else "-", ""),
    )


def validate(problem: ProblemFile, design: Mapping[str, float]) -> Result:
    """Prove a given design, or show where it fails.

    Parameters
    ----------
    problem : ProblemFile
    design : mapping of every free quantity to its value [m, rad]; see `read_design`
    """
    begin = time.perf_counter()
    full = problem.spec.design(design)
    proof = prove(problem.spec, full)
    seconds = {"build": 0.0, "solve": 0.0, "validate": time.perf_counter() - begin}
    return Result(problem, Status.NOT_SEARCHED, "none", full, proof.objective, proof, seconds)


def _pairs(text: str, quantities: Mapping[str, Quantity]) -> list[tuple[str, object]]:
    """KEY=VALUE as one assignment; a result.json as one for each quantity (phi0 and psi0 only where they are not derived)."""
    if not text.endswith(".json"):
        return [parse_assignment(text, "--design")]
    try:
        design = json.loads(Path(text).read_text(encoding="utf-8"))["design"].items()
        parts = [(*key.rpartition("_"), float(value)) for key, value in design if not isinstance(value, bool)]
        return [(name, f"{value!r} {unit}") for name, _, unit, value in parts if name in quantities or name in LENGTHS]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or f"no design in it ({type(error).__name__})"
        raise InputError(
            Fault(f"cannot read a design: {reason}", "Give a result.json that `solve --out` wrote", text, "--design")
        ) from None


def read_design(problem: ProblemFile, assignments: list[str], varied: Collection[str] = ()) -> dict[str, float]:
    """Read a design given as texts such as "coupler=412.26 mm", or as the name of a result.json; `varied` need not be given.

    Raises
    ------
    InputError
        unknown or missing names, values that are no quantities.
    """
    quantities = problem.model.quantities
    given: dict[str, float] = {}
    for key, value in (pair for text in assignments for pair in _pairs(text, quantities)):
        name = key.removeprefix("mechanism.")
        if name not in quantities:
            raise InputError(Fault("unknown quantity of the design", nearest(name, quantities), problem.file, "--design", key))
        if isinstance(value, dict | list):
            remedy = f'Give one value, such as {name}="{show(quantities[name].value, quantities[name].kind)}"'
            raise InputError(Fault("a given design has no bounds", remedy, problem.file, f"--design {name}", value))
        try:
            quantity: Quantity = read_quantity(value, quantities[name].kind)
        except Unusable as error:
            raise InputError(Fault(error.message, error.remedy, problem.file, f"--design {name}", value)) from None
        given[name] = quantity.value
    missing = [name for name in problem.model.free if name not in given and name not in varied]
    if missing:
        starts = ((name, show(quantities[name].value, quantities[name].kind)) for name in missing)
        example = " ".join(f'--design {name}="{value}"' for name, value in starts)
        raise InputError(Fault(f"the design lacks {', '.join(missing)}", f"Add for example {example}", problem.file, "--design"))
    return given
