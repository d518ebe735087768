"""Tolerance analysis: effect of deviations of the dimensions on an output, to first order and by quasi-random samples.

Crank angles, and the start of a motion law, keep their nominal values; only dimensions deviate. A sample is moved,
not optimised, so that there is no grid of optima; a sweep of a robust problem varies its tolerances.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Unpack

import numpy as np

from optlink.errors import InputError
from optlink.execution.options import Execution
from optlink.execution.runner import check, known_here, pool
from optlink.execution.worker import Runs
from optlink.linkage.vector2d import Array
from optlink.problem.arguments import typed
from optlink.problem.document import Document, Source, entries
from optlink.problem.file import AnyProblem, ProblemFile, problem_of
from optlink.problem.quantity import check_choice
from optlink.problem.tolerances import CHOICES, NORMAL, SHAPES
from optlink.studies.tolerances import robust_design
from optlink.studies.tolerances.allocation import Allocation, allocate
from optlink.studies.tolerances.monte_carlo import CHUNK, LinearAnalysis, MonteCarlo, Progress, linear_analysis, monte_carlo
from optlink.studies.tolerances.nominal import ERROR, judged, nominal_design
from optlink.studies.tolerances.robust_design import YIELD, RobustDesign, check_targets, maximise_yield
from optlink.studies.tolerances.sampling import check_tolerances, identified, read_deviations, stated
from optlink.tasks.machine import check_design
from optlink.units import DISPLAYED, UnitProblem, parse, read_number

WORST, MARGIN = "worst", "margin"
SAMPLES = 1 << 17
MAX_SAMPLES = 100_000_000
PARALLEL_SAMPLES = 4 * CHUNK
"""Samples from which several processes are started: a process takes about as long to start as to move one chunk."""


def _effects(result: Tolerance) -> list[dict[str, Any]]:
    """Return every deviation with its effect."""
    return [
        {
            "name": deviation.name,
            "adds_to": deviation.size,
            "tolerance_SI": deviation.tolerance,
            "distribution": deviation.shape,
            "mean_SI": deviation.mean,
            "sigma_SI": deviation.sigma,
            "per_deviation": by,
            "contribution_percent": 100.0 * share,
            "contribution_where_it_scatters_most_percent": 100.0 * share[result.where],
            **({"measured_parts": len(deviation.values)} if deviation.values else {}),
        }
        for deviation, by, share in zip(result.deviations, result.effects, result.contributions, strict=True)
    ]


def _linear(result: Tolerance) -> dict[str, Any]:
    """Return the effect of all tolerances to first order."""
    low, high = result.worst
    return {
        "shift": result.shift,
        "worst_low": low,
        "worst_high": high,
        "rss": result.rss,
        "sigma": result.sigma,
        "scatters_most_at_deg": result.nominal.degrees[result.where],
    }


def _robust(result: Tolerance) -> dict[str, Any] | None:
    """Return the robust design beside the nominal optimum."""
    if result.robust is None:
        return None
    return {
        **dict(entries(result.robust)),
        "monte_carlo_of_the_nominal_design": result.unrobust,
        "the_nominal_design_yields_more": result.nominal_yields_more,
    }


@dataclass(frozen=True, repr=False, eq=False)
class Tolerance(LinearAnalysis, Document):
    """Tolerances of a design and their effect: to first order, by samples, with allocated tolerances, of a robust design."""

    kind = "tolerance"
    status = "done"
    shown: ClassVar[Mapping[str, Source]] = {
        "output": "nominal.name",
        "unit": "nominal.unit",
        "sizes_SI": "nominal.sizes",
        "crank_angles_deg": "nominal.degrees",
        "value": "nominal.value",
        "judged_as_drawn": "nominal.base",
        "tolerances": _effects,
        "linear": _linear,
        "monte_carlo?": "monte_carlo",
        "robust?": _robust,
        "allocation?": "allocation",
    }

    monte_carlo: MonteCarlo | None = None
    allocation: Allocation | None = None
    robust: RobustDesign | None = None  # the robust design, if requested
    unrobust: MonteCarlo | None = None  # samples of the nominal optimum beside a robust design

    @property
    def seed(self) -> int | None:
        """Seed of the samples; None without samples."""
        return None if self.monte_carlo is None else self.monte_carlo.seed

    @property
    def valid(self) -> bool:
        """Whether the allocated tolerances reach their yield and the robust design is valid, where they were asked for."""
        allocated = self.allocation is None or self.allocation.achieved
        return allocated and (self.robust is None or self.robust.result.valid)

    @property
    def scale(self) -> float:
        """Factor from SI to the display unit of the output."""
        return DISPLAYED[self.nominal.unit][0]

    @property
    def display_unit(self) -> str:
        """Display unit of the output."""
        return DISPLAYED[self.nominal.unit][1]

    @property
    def bracketed(self) -> str:
        """Display unit after the name of an axis or column; none for a plain number."""
        return f" [{self.display_unit}]" if self.display_unit else ""

    @property
    def nominal_yields_more(self) -> bool:
        """Whether the nominal optimum has a larger yield than the robust design, for the same samples."""
        if self.limit is None or self.unrobust is None or self.monte_carlo is None:
            return False
        return self.unrobust.good > self.monte_carlo.good

    @property
    def columns(self) -> dict[str, Array]:
        """Table over the positions of the drive, by name with SI unit, but the positions in the unit of the drive."""
        worst, driving = self.worst, self.nominal.problem.model.driving
        columns = {"crank_deg" if driving.column == "crank_angle_deg" else driving.column: self.nominal.places}
        named_columns = {"value": self.nominal.value, "judged": self.nominal.base, "worst_low": worst[0], "worst_high": worst[1]}
        named_columns |= {"rss": self.rss, "sigma": self.sigma, "shift": self.shift}
        if self.monte_carlo is not None:
            named_columns |= {"sampled_mean": self.monte_carlo.mean, "sampled_sigma": self.monte_carlo.sigma}
            named_columns |= {"sampled_least": self.monte_carlo.least, "sampled_most": self.monte_carlo.most}
        columns |= {f"{name}_{self.nominal.unit}".rstrip("_"): column for name, column in named_columns.items()}
        shares = {f"{d.name}_percent": 100.0 * row for d, row in zip(self.deviations, self.contributions, strict=True)}
        return columns | shares


@typed
def tolerance(
    problem: AnyProblem,
    tolerances: Mapping[str, float | str] | Sequence[str] = (),
    output: str | None = None,
    crank_angles: Array | None = None,
    limit: float | str | None = None,
    *,
    samples: int = SAMPLES,
    seed: int = 0,
    shape: str = NORMAL,
    design: Mapping[str, float | str] | None = None,
    target_yield: float | None = None,
    costs: Mapping[str, float] | None = None,
    robust: float | str | None = None,
    progress: Progress | None = None,
    **execution: Unpack[Execution],
) -> Tolerance:
    """Analyse the effect of manufacturing tolerances on an output: worst case, scatter and yield.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        From `optlink.load`, the name of a shipped problem, or a file. Without a `design`, it is optimised first.
    tolerances : mapping of str to float [SI] or str, or sequence of str
        Tolerances by name, for example {"coupler": 1e-4} in SI, or texts with units, {"D.x": "0.05 mm uniform", "rocker":
        "parts.csv"}; also as on the command line, ["coupler=0.1 mm"]. Default: those of the file.
    output : str, optional
        Name of a body (its angle), coordinate "P.x" or "P.y" of a point, or "error" of the requirement: of a motion law, the
        distance from the points or poses, the cosine of the transmission angle ("error at C" for one of several dyads;
        "walk.error" for the requirement "walk" of several). Default: the error.
    crank_angles : array (angles,) [rad], optional
        Crank angles of an output without target. Default: the points of a path, otherwise a revolution.
    limit : float [SI] or str, optional
        Permitted absolute error, or permitted change of another output, at all crank angles, for the yield: "0.5 deg".
    samples : int
        Number of samples of the Monte Carlo analysis; 0: linear analysis only.
    seed : int
        Seed of the samples.
    shape : str
        Default distribution of tolerances: "normal", "uniform" or "triangular".
    design : mapping of str to float [SI] or str, optional
        Values of the design variables. Default: the optimum.
    target_yield : float, optional
        Required yield, between 0 and 1, for which tolerances of least cost are allocated; see
        `optlink.studies.tolerances.allocation`.
    costs : mapping of str to float, optional
        Cost coefficients by name of the deviation. Default: those of the file, or 1.
    robust : float or str, optional
        Optimise a robust design for the error plus this number of standard deviations, the worst case ("worst"), the largest
        number of standard deviations within the limit ("margin") or the largest yield ("yield"). The result also contains the
        nominal optimum; see `optlink.studies.tolerances.robust_design`.
    progress : function of the completed fraction of the samples, optional
    **execution : Execution
        Where the samples are moved. By default few samples take one process.

    Returns
    -------
    Tolerance
        Sensitivity to every deviation, worst case, scatter, yield and, if required, allocated tolerances and robust design.

    Raises
    ------
    InputError
        If an argument is invalid, there is no validated design, or no tolerance has an effect on the output.

    Examples
    --------
    >>> from optlink.studies import tolerance
    >>> result = tolerance(optlink.load("crank-rocker"), {"coupler": 1e-4}, limit="2.3 deg", samples=4096)
    >>> round(result.monte_carlo.share, 3)  # the yield
    0.864
    """
    problem = problem_of(problem)
    tolerances = stated(problem, tolerances) if isinstance(tolerances, Mapping) else tolerances
    _check(samples, seed, shape, target_yield, limit)
    if robust is not None:
        check_targets(problem)
    loaded, unit = judged(problem.model, output, crank_angles, problem.file)
    check_tolerances(problem, tolerances, costs or {}, loaded, shape)  # before a search
    _limit(limit, unit)
    sizes = check_design(problem, design)
    with _processes(samples, known_here(problem, execution)) as runs:
        file, robust_result = problem, None
        if robust is not None:
            if design is not None or output not in (None, ERROR):
                remedy = "Leave --design and --quantity out, or --robust"
                raise InputError("a robust design is searched, for its error", remedy, problem.file, "--robust")
            robust_result = _robust_design(problem, tolerances, robust, limit, samples, seed, shape, runs)
            file, sizes = robust_result.result.problem, robust_result.free  # with a definite assembly mode
        nominal = nominal_design(file, output, crank_angles, sizes)
        deviations = read_deviations(problem, nominal, tolerances, shape)
        first = linear_analysis(problem, nominal, deviations, _limit(limit, nominal.unit))
        if not np.any(first.by):
            remedy = "Choose another one: a body stands for its angle, P.x and P.y for the position of a point"
            raise InputError("no tolerance has an effect on this output", remedy, problem.file, "--quantity", nominal.name)
        result = Tolerance(problem, nominal, first.deviations, first.by, first.limit, robust=robust_result)
        if samples and robust_result is not None:
            best = nominal_design(file, output, crank_angles, {name: robust_result.nominal[name] for name in robust_result.free})
            at_nominal = linear_analysis(problem, best, deviations, result.limit)
            result = replace(result, unrobust=monte_carlo(at_nominal, samples, seed, runs=runs))
        if samples:
            result = replace(result, monte_carlo=monte_carlo(result, samples, seed, progress, runs))
        if target_yield is not None:
            result = replace(result, allocation=allocate(result, target_yield, costs or {}, samples or SAMPLES, seed, runs))
        return replace(result, problem=identified(problem, tolerances, shape, robust=robust is not None))


@contextlib.contextmanager
def _processes(samples: int, execution: Execution) -> Iterator[Runs | None]:
    """Provide processes, by default only for work that takes longer than their start."""
    check(**execution)
    if all(value in (None, "local") for value in execution.values()) and samples < PARALLEL_SAMPLES:
        yield None
        return
    with pool(**execution) as runs:
        yield runs


def _robust_design(
    problem: ProblemFile,
    tolerances: Sequence[str],
    robust: float | str,
    limit: float | str | None,
    samples: int,
    seed: int,
    shape: str,
    runs: Runs | None,
) -> RobustDesign:
    """Return the robust design for the error; see `tolerance`."""
    if robust == YIELD and not samples:
        raise InputError("a yield requires samples", "Leave --samples out", key="--samples", value=samples)
    allowed = _limit(limit, problem.spec.unit)
    if robust not in (MARGIN, YIELD):
        return robust_design.robust(problem, tolerances, None if robust == WORST else float(robust), shape=shape)
    if allowed is None:
        raise InputError(f"a {robust} needs a limit", 'Add for example --limit "0.5 deg"', key="--robust")
    if robust == MARGIN:
        return robust_design.most_reliable(problem, tolerances, allowed, shape=shape)
    return maximise_yield(problem, tolerances, allowed, samples, seed, shape=shape, runs=runs)


def _check(samples: int, seed: int, shape: str, target_yield: float | None, limit: float | str | None) -> None:
    if not 0 <= samples <= MAX_SAMPLES or samples == 1:
        raise InputError("out of range", f"Give 0 (none), or 2 to {MAX_SAMPLES:,}", key="--samples", value=samples)
    if seed < 0:
        raise InputError("a seed must not be negative", "Give 0 or more", key="--seed", value=seed)
    message = "only clearances have this distribution" if shape in SHAPES else "unknown distribution"
    check_choice("--distribution", shape, CHOICES, message)
    if target_yield is not None and not 0.0 < target_yield < 1.0:
        raise InputError("not a yield", "Give one between 0 and 100 %", key="--allocate", value=target_yield)
    if target_yield is not None and limit is None:
        raise InputError("a yield needs a limit", 'Add for example --limit "0.5 deg"', key="--allocate")


def _limit(given: float | str | None, unit: str) -> float | None:
    """Return a limit of a value with an SI unit; of the cosine of a transmission angle, a number or an angle from 90 deg."""
    if given is None:
        return None
    text = given if isinstance(given, str) else f"{given!r} {unit}".rstrip()
    try:
        if unit:
            value, _ = parse(text, {"rad": "angle", "m": "length"}[unit])
        else:
            number = read_number(text)
            value = number if math.isfinite(number) else math.sin(parse(text, "angle")[0])
    except UnitProblem as error:
        raise InputError(error.message, error.remedy, key="--limit", value=given) from None
    if not value > 0.0:
        raise InputError("the limit must be positive; it applies to both sides", "Give a larger one", key="--limit", value=given)
    return value
