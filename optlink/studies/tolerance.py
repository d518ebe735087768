"""How exact must it be built: what deviations of the sizes do to an output, to first order and by quasi-random samples.

The crank angle, and with a motion law its start, stay as drawn: the drive is set by the drawing, the parts deviate.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from optlink.design.files import ProblemFile
from optlink.design.generation import GenerationProblem
from optlink.design.linkages import FourBarSection, sizes_of
from optlink.design.problem import DesignProblem
from optlink.design.quantity import Quantity, nearest
from optlink.documents import finite, head
from optlink.errors import Fault, InputError
from optlink.linkage.elementwise import Value, cross, dot, unit
from optlink.linkage.mechanism import FRAME, Mechanism
from optlink.studies.outputs import output_names, output_sensitivity
from optlink.studies.sampling import CONTACT, EXAMPLE, NORMAL, SHAPES, Deviation, drawn, read_deviation, wilson
from optlink.units import UnitProblem, parse

if TYPE_CHECKING:
    from optlink.studies.allocation import Allocation
    from optlink.studies.robust import Robust

Array = NDArray[np.float64]
SCHEMA = "optlink/tolerance/1"
ERROR = "error"
WORST, MARGIN = "worst", "margin"
CLEARANCE = ".clearance"
SAMPLES, MAX_SAMPLES = 1 << 17, 100_000_000
ALONG = 31  # positions along the span of a motion law
AROUND = 36  # crank angles of a revolution
LARGEST = 0.5  # of a length, that a tolerance may be
PORTION = 12_000  # positions that are worked on at a time: their intermediate arrays stay in the processor's cache
BINS, ROOM = 400, 1.25  # of the histogram, which reaches that many worst cases to both sides of the drawing
Progress = Callable[[float], None]


@dataclass(frozen=True)
class Nominal:
    """A linkage as drawn and one output of it over crank angles (angles,) [rad].

    `value`: the output [rad or m]; `base`: what a limit judges where nothing deviates: the error of the design itself, or zeros;
    `sign`: change of what is judged per change of the output.
    """

    mechanism: Mechanism
    sizes: Mapping[str, float]
    crank_angles: Array
    output: str
    name: str
    value: Array
    base: Array
    sign: float = 1.0

    @property
    def angular(self) -> bool:
        """Whether the output is an angle."""
        return self.output in self.mechanism.bodies

    @property
    def unit(self) -> str:
        """SI unit of the output."""
        return "rad" if self.angular else "m"

    @cached_property
    def _drawn(self) -> Any:
        return self._where(self.sizes)

    def _where(self, sizes: Mapping[str, Value]) -> Any:
        with np.errstate(all="ignore"):
            pose = self.mechanism.pose(sizes, unit(self.crank_angles))
            if self.angular:
                return pose.direction(self.output)
            point, _, axis = self.output.rpartition(".")
            return pose.point(point)["xy".index(axis)]

    def change(self, deviations: Mapping[str, Value]) -> Array:
        """Change of what is judged, exactly, where sizes deviate by (samples, 1) arrays: (samples, angles)."""
        found = self._where({**self.sizes, **{name: self.sizes[name] + by for name, by in deviations.items()}})
        with np.errstate(all="ignore"):
            by = np.arctan2(cross(self._drawn, found), dot(self._drawn, found)) if self.angular else found - self._drawn
        samples = max((np.shape(column)[0] for column in deviations.values()), default=1)
        whole = np.broadcast_to(self.sign * by, (samples, len(self.crank_angles)))  # an output that none of them moves
        return np.array(whole, dtype=float)


@dataclass(frozen=True)
class Carlo:
    """What samples of the parts gave.

    `mean`, `sigma` and the latter's standard error (angles,) [SI] of the change of the output; `least`, `most` of it; `counts` of
    samples by the largest size that what is judged has at any crank angle, between `edges` [SI]; `stuck`: samples that cannot be
    assembled at some angle; `good`: those within the limit everywhere, by the linear model `linear`; -1 where no limit is given.
    """

    samples: int
    seed: int
    stuck: int
    mean: Array
    sigma: Array
    sigma_error: Array
    least: Array
    most: Array
    counts: NDArray[np.int64]
    edges: Array
    good: int
    linear: int
    seconds: float

    @property
    def share(self) -> float:
        """The yield."""
        return self.good / self.samples if self.good >= 0 else math.nan

    @property
    def linear_share(self) -> float:
        """The yield by the linear model, of the same samples."""
        return self.linear / self.samples if self.linear >= 0 else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """The ends of its interval of 95 % confidence, as of independent samples: quasi-random ones lie closer."""
        return wilson(self.good, self.samples) if self.good >= 0 else (math.nan, math.nan)

    def below(self, share: float) -> float:
        """The size [SI] that a share of the samples stays below: to a bin of the histogram; infinite beyond its end."""
        reached = np.cumsum(self.counts) >= share * self.samples
        place = int(np.argmax(reached))
        return float(self.edges[place + 1]) if reached[-1] and place < len(self.counts) - 1 else math.inf


@dataclass(frozen=True)
class Tolerance:
    """Tolerances of a design and what they do; `by` (deviations, angles): change of what is judged per deviation [SI]."""

    problem: ProblemFile
    nominal: Nominal
    deviations: tuple[Deviation, ...]
    by: Array
    limit: float | None
    carlo: Carlo | None = None
    allocation: Allocation | None = None
    robust: Robust | None = None  # what the design is, if it was searched for its tolerances
    unrobust: Carlo | None = None  # samples of the best design as drawn, then

    @cached_property
    def shift(self) -> Array:
        """Mean change (angles,) to first order."""
        return np.asarray(np.array([d.mean for d in self.deviations]) @ self.by, dtype=float)

    @cached_property
    def worst(self) -> tuple[Array, Array]:
        """Least and largest change (angles,) to first order where all deviations are at their worst end together."""
        ends = np.array([d.ends for d in self.deviations])
        both = ends[:, :, None] * self.by[:, None, :]
        return np.sum(np.min(both, axis=1), axis=0), np.sum(np.max(both, axis=1), axis=0)

    @cached_property
    def rss(self) -> Array:
        """Root of the sum of squares (angles,): each tolerance times its derivative; of measured deviations three sigma."""
        sizes = np.array([3.0 * d.sigma if d.values else d.tolerance for d in self.deviations])
        return np.asarray(np.sqrt(np.sum(np.square(sizes[:, None] * self.by), axis=0)), dtype=float)

    @cached_property
    def sigma(self) -> Array:
        """Standard deviation (angles,) to first order."""
        return np.asarray(np.sqrt(np.sum(self._variances, axis=0)), dtype=float)

    @cached_property
    def _variances(self) -> Array:
        return np.square(np.array([d.sigma for d in self.deviations])[:, None] * self.by)

    @property
    def where(self) -> int:
        """Place of the crank angle at which the output scatters most."""
        return int(np.argmax(self.sigma))

    @cached_property
    def contributions(self) -> Array:
        """Share of the variance (deviations, angles) that each is to blame for; zeros where nothing scatters."""
        whole = np.sum(self._variances, axis=0)
        return self._variances / np.where(whole > 0.0, whole, 1.0)

    @property
    def columns(self) -> dict[str, Array]:
        """The table over crank angles, by name with unit."""
        scale, ending = people(self.nominal)
        worst, found = self.worst, {"crank_deg": np.degrees(self.nominal.crank_angles)}
        named = {"value": self.nominal.value, "judged": self.nominal.base, "worst_low": worst[0], "worst_high": worst[1]}
        named |= {"rss": self.rss, "sigma": self.sigma, "shift": self.shift}
        if self.carlo is not None:
            named |= {"sampled_mean": self.carlo.mean, "sampled_sigma": self.carlo.sigma}
            named |= {"sampled_least": self.carlo.least, "sampled_most": self.carlo.most}
        found |= {f"{name}_{ending}": scale * column for name, column in named.items()}
        shares = {f"{d.name}_percent": 100.0 * row for d, row in zip(self.deviations, self.contributions, strict=True)}
        return found | shares

    def to_dict(self) -> dict[str, Any]:
        """As a JSON document: SI, or the unit that the key ends in."""
        worst, at = self.worst, self.where
        document = head(SCHEMA, self.problem, "done", None if self.carlo is None else self.carlo.seed)
        document |= {
            "output": self.nominal.name,
            "unit": self.nominal.unit,
            "sizes_SI": dict(self.nominal.sizes),
            "crank_angles_deg": np.degrees(self.nominal.crank_angles),
            "value": self.nominal.value,
            "judged_as_drawn": self.nominal.base,
            "limit": self.limit,
            "tolerances": [
                {
                    "name": d.name,
                    "adds_to": d.size,
                    "tolerance_SI": d.tolerance,
                    "distribution": d.shape,
                    "mean_SI": d.mean,
                    "sigma_SI": d.sigma,
                    "per_deviation": by,
                    "contribution_percent": 100.0 * share,
                    "contribution_where_it_scatters_most_percent": 100.0 * share[at],
                }
                for d, by, share in zip(self.deviations, self.by, self.contributions, strict=True)
            ],
            "linear": {
                "shift": self.shift,
                "worst_low": worst[0],
                "worst_high": worst[1],
                "rss": self.rss,
                "sigma": self.sigma,
                "scatters_most_at_deg": math.degrees(self.nominal.crank_angles[at]),
            },
        }
        if self.carlo is not None:
            document["monte_carlo"] = sampled_document(self.carlo)
        if self.robust is not None:
            other = None if self.unrobust is None else sampled_document(self.unrobust)
            document["robust"] = self.robust.to_dict() | {"monte_carlo_of_the_nominal_design": other}
        if self.allocation is not None:
            document["allocation"] = self.allocation.to_dict()
        return finite(document)  # type: ignore[no-any-return]


def sampled_document(carlo: Carlo) -> dict[str, Any]:
    """Samples as part of a JSON document."""
    asked = carlo.good >= 0
    return {
        "samples": carlo.samples,
        "seed": carlo.seed,
        "cannot_be_assembled": carlo.stuck,
        "mean": carlo.mean,
        "sigma": carlo.sigma,
        "sigma_standard_error": carlo.sigma_error,
        "least": carlo.least,
        "most": carlo.most,
        "stays_below": {f"{100.0 * share:g}_percent": carlo.below(share) for share in (0.5, 0.95, 0.99, 0.999)},
        "yield": carlo.share if asked else None,
        "yield_interval_95_percent": list(carlo.interval) if asked else None,
        "yield_by_the_linear_model": carlo.linear_share if asked else None,
        "seconds": carlo.seconds,
    }


def people(nominal: Nominal) -> tuple[float, str]:
    """Units of an output as people read them: how many are one SI unit, and its name."""
    return (math.degrees(1.0), "deg") if nominal.angular else (1e3, "mm")


def tolerance(
    problem: ProblemFile,
    tolerances: Sequence[str],
    output: str | None = None,
    crank_angles: Array | None = None,
    limit: str | None = None,
    *,
    samples: int = SAMPLES,
    seed: int = 0,
    shape: str = NORMAL,
    design: Mapping[str, float] | None = None,
    wanted: float | None = None,
    costs: Mapping[str, float] | None = None,
    robust: float | str | None = None,
    progress: Progress | None = None,
) -> Tolerance:
    """What tolerances do to an output.

    Parameters
    ----------
    problem : ProblemFile
        What is free is searched first, unless a `design` is given.
    tolerances : texts such as "coupler=0.1 mm", "D.x=0.05 mm uniform", "C.clearance=0.02 mm", "rocker=parts.csv"
    output : name of a body (its angle), "P.x", "P.y" of a point, or "error" of a motion law (that is what it is if left out)
    crank_angles : array [rad], optional
        The span of a motion law, the points of a path, else a revolution.
    limit : text such as "0.5 deg", optional
        What the error, or the change of another output, may be at any of the crank angles.
    samples, seed : of the Monte Carlo analysis; 0 samples: none
    shape : distribution where none is said
    design : mapping [SI], optional
    wanted : share of the linkages that shall keep the limit, optional
        The loosest tolerances that do are searched; see `optlink.studies.allocation`.
    costs : mapping of a tolerance's name to its cost coefficient; 1 where none is given
    robust : number of standard deviations, "worst", or "margin" (as many as keep the limit), optional
        Judge the design that is best with its scatter, and the best as drawn beside it; see `optlink.studies.robust`.

    Raises
    ------
    InputError
    """
    _check(samples, seed, shape, wanted, limit)
    file, again = problem, None
    if robust is not None:
        if design is not None or output not in (None, ERROR):
            remedy = "Leave --design and --output out, or --robust"
            raise InputError(Fault("a robust design is searched, for its error", remedy, problem.file, "--robust"))
        from optlink.studies import robust as redesign

        allowed = _limit(limit, angular=True)
        if robust != MARGIN:
            again = redesign.robust(problem, tolerances, None if robust == WORST else float(robust), shape=shape)
        elif allowed is None:
            raise InputError(Fault("a margin needs a limit", 'Add for example --limit "0.5 deg"', key="--robust"))
        else:
            again = redesign.safest(problem, tolerances, allowed, shape=shape)
        file, design = again.problem, again.free  # with the assembly mode that was found
    nominal = drawing(file, output, crank_angles, design)
    deviations = read_deviations(problem, nominal, tolerances, shape)
    for name in costs or {}:
        if name not in [d.name for d in deviations]:
            raise InputError(Fault("no such tolerance", nearest(name, [d.name for d in deviations]), key=f"--cost {name}"))
    found = replace(analysed(problem, nominal, deviations, _limit(limit, angular=nominal.angular)), robust=again)
    if samples and again is not None:
        best = drawing(file, output, crank_angles, {name: again.nominal[name] for name in again.free})
        found = replace(found, unrobust=monte_carlo(analysed(problem, best, deviations, found.limit), samples, seed))
    if samples:
        found = replace(found, carlo=monte_carlo(found, samples, seed, progress))
    if wanted is not None:
        from optlink.studies.allocation import allocate

        found = replace(found, allocation=allocate(found, wanted, costs or {}, samples or SAMPLES, seed))
    return found


def analysed(problem: ProblemFile, nominal: Nominal, deviations: Sequence[Deviation], limit: float | None) -> Tolerance:
    """The linear analysis: exact derivatives at the drawing."""
    sizes = list(dict.fromkeys(d.size for d in deviations))
    slopes = output_sensitivity(nominal.mechanism, nominal.sizes, nominal.crank_angles, nominal.output, sizes).by
    return Tolerance(problem, nominal, tuple(deviations), nominal.sign * np.array([slopes[d.size] for d in deviations]), limit)


def monte_carlo(study: Tolerance, samples: int, seed: int, progress: Progress | None = None) -> Carlo:
    """Linkages with deviations that were drawn, each assembled and moved exactly; memory does not grow with their number."""
    begin = time.perf_counter()
    nominal, shift, angles = study.nominal, study.shift, len(study.nominal.crank_angles)
    limit, middle = study.limit, float(np.max(np.abs(nominal.base)))
    reach = ROOM * max(float(np.max(np.maximum(-study.worst[0], study.worst[1]))), 1e-15)
    bottom, bins = max(0.0, middle - reach), BINS / (middle + reach - max(0.0, middle - reach))
    counts = np.zeros(BINS, dtype=np.int64)
    sums = np.zeros((4, angles))
    least, most = np.full(angles, math.inf), np.full(angles, -math.inf)
    stuck = good = linear = done = 0
    rows = max(1, PORTION // angles)
    for batch in drawn(study.deviations, samples, seed):
        for first in range(0, len(batch), rows):
            part = batch[first : first + rows]
            change = nominal.change(_by_size(study.deviations, part))
            whole = np.isfinite(change).all(axis=1)
            if not whole.all():
                stuck += int(np.sum(~whole))
                change = change[whole]
            largest = np.max(np.abs(nominal.base + change), axis=1)
            counts += np.bincount(np.clip((largest - bottom) * bins, 0, BINS - 1).astype(int), minlength=BINS)
            if len(change):
                np.minimum(least, np.min(change, axis=0), out=least)
                np.maximum(most, np.max(change, axis=0), out=most)
            if limit is not None:
                good += int(np.sum(largest <= limit))
                linear += int(np.sum(np.max(np.abs(nominal.base + part @ study.by), axis=1) <= limit))
            change -= shift  # so that the sums of powers lose no digits
            power = change
            for i in range(4):
                sums[i] += np.sum(power, axis=0)
                power = power * change
        done += len(batch)
        if progress is not None:
            progress(done / samples)
    mean, sigma, error = _moments(sums, samples - stuck)
    return Carlo(
        samples=samples,
        seed=seed,
        stuck=stuck,
        mean=mean + shift,
        sigma=sigma,
        sigma_error=error,
        least=least,
        most=most,
        counts=counts,
        edges=np.linspace(bottom, middle + reach, BINS + 1),
        good=-1 if limit is None else good,
        linear=-1 if limit is None else linear,
        seconds=time.perf_counter() - begin,
    )


def _by_size(deviations: Sequence[Deviation], batch: Array) -> dict[str, Array]:
    """Deviations (samples, 1) of each size; several may add to one."""
    found: dict[str, Array] = {}
    for i, deviation in enumerate(deviations):
        own = batch[:, i : i + 1]
        found[deviation.size] = found[deviation.size] + own if deviation.size in found else own
    return found


def _moments(sums: Array, count: int) -> tuple[Array, Array, Array]:
    """Mean, standard deviation and the latter's standard error, from sums of the first four powers."""
    if count < 2:
        nothing = np.full(sums.shape[1], math.nan)
        return nothing, nothing, nothing
    first, second, third, fourth = sums / count
    variance = np.maximum(second - first * first, 0.0)
    central = np.maximum(fourth - 4.0 * first * third + 6.0 * first**2 * second - 3.0 * first**4, 0.0)
    sigma = np.sqrt(variance * count / (count - 1))
    spread = np.sqrt(np.maximum(central - variance * variance, 0.0) / count)  # of the variance
    return first, sigma, spread / np.where(sigma > 0.0, 2.0 * sigma, 1.0)


# --- what is asked -----------------------------------------------------------------------------------------------------


def _check(samples: int, seed: int, shape: str, wanted: float | None, limit: str | None) -> None:
    if not 0 <= samples <= MAX_SAMPLES or samples == 1:
        remedy = f"Give 0 (none), or 2 to {MAX_SAMPLES:,}"
        raise InputError(Fault("out of range", remedy, key="--samples", value=samples))
    if seed < 0:
        raise InputError(Fault("a seed is not negative", "Give 0 or more", key="--seed", value=seed))
    if shape not in SHAPES:
        raise InputError(Fault("unknown distribution", nearest(shape, SHAPES), key="--distribution", value=shape))
    if wanted is not None and not 0.0 < wanted < 1.0:
        raise InputError(Fault("no yield", "Give one between 0 and 100 %", key="--allocate", value=wanted))
    if wanted is not None and limit is None:
        raise InputError(Fault("a yield needs a limit", 'Add for example --limit "0.5 deg"', key="--allocate"))


def _limit(text: str | None, *, angular: bool) -> float | None:
    if text is None:
        return None
    try:
        value, _ = parse(text, "angle" if angular else "length")
    except UnitProblem as error:
        raise InputError(Fault(error.message, error.remedy, key="--limit", value=text)) from None
    if not value > 0.0:
        raise InputError(Fault("a limit is above zero: it holds to both sides", "Give a larger one", key="--limit", value=text))
    return value


def drawing(
    problem: ProblemFile, output: str | None, crank_angles: Array | None = None, design: Mapping[str, float] | None = None
) -> Nominal:
    """The linkage as drawn, found first if something of it is free, and the output that is judged.

    Raises
    ------
    InputError
        unknown output, no design, a linkage that cannot be assembled at a crank angle.
    """
    file, values, angles = _design(problem, design)
    mechanism, quantities = file.model.linkage, file.model.mechanism.quantities
    sizes = {name: values[name] for name in quantities}
    if isinstance(file.model.mechanism, FourBarSection) and not file.model.mechanism.placed:
        mechanism = replace(mechanism, ground={"A": ("A.x", "A.y"), "D": ("frame", "D.y")})  # pivots that may deviate
        sizes |= {"A.x": 0.0, "A.y": 0.0, "D.y": 0.0}
    law = isinstance(file.model, DesignProblem)
    known = [*([ERROR] if law else []), *output_names(mechanism)]
    chosen = ERROR if output is None and law else output
    if chosen is None:
        raise InputError(Fault("which output is judged is not said", f"One of: {', '.join(known)}", problem.file, "--output"))
    if chosen not in known:
        raise InputError(Fault("unknown output", nearest(chosen, known), problem.file, "--output", chosen))
    if isinstance(file.model, DesignProblem) and chosen == ERROR:
        if crank_angles is not None:
            remedy = "Leave --angles out, or give --output rocker"
            raise InputError(Fault("the error is that over the span of the law", remedy, problem.file, "--angles"))
        span = np.linspace(0.0, file.model.span, ALONG)
        at = values["phi0"] + span
        drawn_ = _placed(problem, mechanism, sizes, at, "rocker", ERROR, -1.0)
        wanted = file.model.law.curve(span, values["phi0"], values["psi0"])
        error = np.remainder(wanted - drawn_.value + math.pi, 2.0 * math.pi) - math.pi
        return replace(drawn_, base=error)
    if crank_angles is None:
        crank_angles = 2.0 * math.pi * np.arange(AROUND) / AROUND if angles is None else angles
    return _placed(problem, mechanism, sizes, np.asarray(crank_angles, dtype=float), chosen, chosen, 1.0)


def _placed(
    problem: ProblemFile, mechanism: Mechanism, sizes: Mapping[str, float], at: Array, output: str, name: str, sign: float
) -> Nominal:
    value = output_sensitivity(mechanism, sizes, at, output, list(sizes)[:1]).value
    if not np.all(np.isfinite(value)):
        angle = math.degrees(float(at[int(np.argmin(np.isfinite(value)))]))
        remedy = 'Give crank angles that it reaches: --angles "60..120 deg:13"'
        raise InputError(Fault(f"the linkage cannot be assembled at {angle:.4g} deg", remedy, problem.file, "--angles"))
    return Nominal(mechanism, dict(sizes), at, output, name, value, np.zeros(len(at)), sign)


def _design(problem: ProblemFile, given: Mapping[str, float] | None) -> tuple[ProblemFile, dict[str, float], Array | None]:
    """The problem with definite assembly modes, every quantity of the design [SI], and crank angles that it is about, if any."""
    model = problem.model
    if isinstance(model, GenerationProblem):
        from optlink.generation import generate, validate

        made = generate(problem) if given is None and model.free else validate(problem, given or {})
        best = made.best
        if best is None or (given is None and not made.valid):
            raise _nothing(problem)
        return (
            best.problem,
            dict(best.values),
            np.asarray(best.crank_angles) if model.requirement.kind != "transmission" else None,
        )
    if problem.machined and given is None:
        from optlink.machine_design import design_machine

        machine = design_machine(problem)
        if not machine.valid:
            raise _nothing(problem)
        return problem, {**sizes_of(model.quantities), **machine.values}, None
    if isinstance(model, DesignProblem) and (given is not None or not model.free):
        return problem, model.design(given or {}), None
    if isinstance(model, DesignProblem):
        from optlink.workflow import solve

        result = solve(problem)
        if not result.valid:
            raise _nothing(problem)
        return result.problem, dict(result.design), None
    if model.free and given is None:
        raise InputError(Fault("sizes are free and nothing is asked of them", "Add --design", problem.file, "mechanism"))
    return problem, {**sizes_of(model.quantities), **(given or {})}, None


def _nothing(problem: ProblemFile) -> InputError:
    remedy = "See `optlink solve`, or give a design: --design NAME=VALUE"
    return InputError(Fault("no design was proven, so there is none to build", remedy, problem.file))


def read_deviations(problem: ProblemFile, nominal: Nominal, texts: Sequence[str], shape: str = NORMAL) -> list[Deviation]:
    """Read NAME=TOLERANCE of sizes, pivots and clearances.

    Raises
    ------
    InputError
    """
    if not texts:
        raise InputError(Fault("no tolerance is given", EXAMPLE, key="--tolerance"))
    quantities = problem.model.mechanism.quantities
    pins = {f"{pin}{CLEARANCE}": pin for pin in nominal.mechanism.pins}
    found: list[Deviation] = []
    for assignment in texts:
        name, equals, text = assignment.partition("=")
        name = name.strip().removeprefix("mechanism.")
        if not equals or not name or not text.strip():
            raise InputError(Fault("expected NAME=TOLERANCE", EXAMPLE, key="--tolerance", value=assignment))
        size = "frame" if name == "D.x" and "D.y" in nominal.sizes and "D.x" not in nominal.sizes else name
        if name in pins:
            size = _stretched(problem, nominal.mechanism, pins[name])
        elif size not in nominal.sizes:
            raise InputError(Fault("unknown size", nearest(name, [*nominal.sizes, *pins]), problem.file, "--tolerance", name))
        if any(name == other.name or (size == other.size and name not in pins and other.name not in pins) for other in found):
            raise InputError(Fault("a tolerance is given twice", "Give each once", problem.file, "--tolerance", name))
        quantity: Quantity | None = quantities.get(size)
        kind = "angle" if quantity is not None and quantity.kind == "angle" else "length"
        own = CONTACT if name in pins else shape
        found.append(read_deviation(text, size, kind, name, own))
        low, _ = found[-1].ends
        if quantity is not None and quantity.kind == "length" and -low > LARGEST * nominal.sizes[size]:
            message, remedy = "more than half of the size itself", "Check its unit"
            raise InputError(Fault(message, remedy, problem.file, f"--tolerance {name}", text.strip()))
    return found


def _stretched(problem: ProblemFile, mechanism: Mechanism, pin: str) -> str:
    """The length that the clearance of a pin stretches or shortens: that of the nearest link that is not pinned to the frame.

    Such a link without loads carries force along its line alone, so the journal rests there: the gap adds to its length.
    """
    reached, bodies = {pin}, set[str]()
    held = {body for owners in mechanism.pins.values() if FRAME in owners for body in owners}
    while True:
        near = [b for b in mechanism.bodies if b not in bodies and any(b in mechanism.pins[p] for p in reached)]
        for body in near:
            if body not in held and isinstance(mechanism.bodies[body].length, str):
                return str(mechanism.bodies[body].length)
        if not near:
            message, remedy = "no link between moving pins has a length that its clearance could add to", "Leave it out"
            raise InputError(Fault(message, remedy, problem.file, "--tolerance", f"{pin}{CLEARANCE}"))
        bodies.update(near)
        reached.update(p for p, owners in mechanism.pins.items() if any(body in owners for body in near))
