"""Where the limits of a front walk: from where the other objectives are best to the best of the one that is held."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from optlink.errors import Fault, InputError, Status
from optlink.problem.file import ProblemFile
from optlink.studies.cycle_task import restarted
from optlink.studies.grid import Axis, Grid
from optlink.studies.pareto_objectives import OPTION, Aim, bare, cycle_figures, law_figure, spanned, tightest, walked
from optlink.studies.reoptimise_task import buildable
from optlink.studies.toml_keys import Raw, text
from optlink.tasks.cycle import solve as solve_cycle
from optlink.tasks.function import solve

Once = Callable[[str, Callable[[], Mapping[str, Any]]], Mapping[str, Any]]
"""(name, search) -> what the search finds, fit for JSON, done now or before"""

NEAR = 1e-4  # of its extent by which an objective is let go at its own end, where nothing else could move
NONE = 1e-6  # relative; an objective that moves less has no trade-off


class NoEnd(InputError):
    """An end of the front that cannot be found."""


@dataclass(frozen=True)
class Walks:
    """What the walks of a front depend on.

    `first`: number of the objective that is minimised; `count`: values of every limit that no range is asked for.
    """

    problem: ProblemFile
    aims: tuple[Aim, ...]
    first: int
    count: int
    backend: str

    @cached_property
    def held(self) -> tuple[int, ...]:
        """Numbers of the objectives that limits hold."""
        return tuple(k for k in range(len(self.aims)) if k != self.first)

    @cached_property
    def bare(self) -> ProblemFile:
        """A law's problem without the limits that hold objectives."""
        return bare(self.problem, [self.aims[k] for k in self.held])

    @cached_property
    def fixed(self) -> dict[int, Axis]:
        """Values of the limits that are to walk along a range that was asked for, by the number of the objective.

        Raises
        ------
        InputError
            ranges without sense; an objective that has to have one.
        """
        found = {}
        for k in self.held:
            aim = self.aims[k]
            if aim.span:
                with self._blamed(aim):
                    found[k] = _stated(aim, self.count, partial(self._with, k))
        for k in self.held:
            if k not in found and self.problem.task != "cycle" and not buildable(self.bare, (self.aims[k].key,)):
                raise self._no_end(self.aims[k], "a function has many optima, its ends are not searched")
        return found

    @cached_property
    def open(self) -> tuple[int, ...]:
        """Numbers of the objectives whose limits walk along ranges that have to be found."""
        return tuple(k for k in self.held if k not in self.fixed)

    @property
    def shape(self) -> tuple[int, ...]:
        """How many values every limit takes."""
        return tuple(len(self.fixed[k].values) if k in self.fixed else self.count for k in self.held)

    @property
    def searches(self) -> int:
        """How many searches it takes to find the ranges that were not asked for."""
        if not self.open:
            return 0
        if self.problem.task != "cycle":
            return 1 + len(self.open) + (len(self.held) if len(self.held) > 1 else 0)
        return 1 + 2 * len(self.open) + bool(self.aims[self.first].key)

    def found(self, once: Once) -> tuple[ProblemFile, Grid, tuple[Mapping[str, float], ...]]:
        """The problem in which one objective is minimised, the values of the limits that hold the others, and machines at the
        ends (sizes [SI]), if those were searched.

        Raises
        ------
        NoEnd
        """
        axes = dict(self.fixed)
        anchors: tuple[Mapping[str, float], ...] = ()
        if self.open and self.problem.task == "cycle":
            found, anchors = self._machine_ends(once)
            axes |= found
        elif self.open:
            axes |= self._law_ends(once)
        grid = Grid(tuple(axes[k] for k in self.held))
        if self.problem.task != "cycle":
            return self.bare, grid, ()
        base = walked(self.problem, self.aims, {self.first: 1.0}, {k: axes[k].raw(0) for k in self.held})
        return restarted(base, anchors[0]) if anchors else base, grid, anchors

    def _with(self, number: int, value: Raw) -> ProblemFile:
        """The problem with a value of the limit that holds an objective."""
        if self.problem.task == "cycle":
            return walked(self.problem, self.aims, {self.first: 1.0}, {number: value})
        return self.bare.override({self.aims[number].key: value})

    @contextlib.contextmanager
    def _blamed(self, aim: Aim) -> Iterator[None]:
        """Say of whatever is wrong that the objective is to blame."""
        said = f"{aim.said}={aim.span}" if aim.span else aim.said
        try:
            yield
        except InputError as error:
            fault = error.faults[0]
            raise InputError(Fault(fault.message, fault.remedy, self.problem.file, OPTION, said)) from None

    def _no_end(self, aim: Aim, why: str) -> NoEnd:
        remedy = f'Say where to walk: "{aim.said}=LOW..HIGH{" " + aim.unit if aim.unit else ""}"'
        return NoEnd(Fault(f"the end with the {aim.best} cannot be found: {why}", remedy, self.problem.file, OPTION, aim.said))

    # --- a four-bar for a law: from where the error alone decides to the tightest limit that a linkage meets --------------

    def _law_ends(self, once: Once) -> dict[int, Axis]:
        """Ranges of the limits that no range was asked for."""
        aims, fixed, unbound = self.aims, self.fixed, self.open
        free = self.bare.override({aims[k].key: axis.raw(0) for k, axis in fixed.items()})  # of what is held but the loosest

        def optimum(task: ProblemFile, blamed: Aim | None = None) -> dict[str, Any]:
            found = solve(task, self.backend)
            if blamed is not None and not found.valid:
                raise self._no_end(blamed, found.status.text)
            return {"design": dict(found.design) if found.valid else None}

        minimised = aims[self.first]
        best = once(minimised.best, lambda: optimum(free, minimised))
        tight = {k: once(aims[k].best, partial(self._tight, free, aims[k]))["limit"] for k in unbound}
        corners = {k: text(aims[k].loose(tight[k], NEAR * abs(tight[k])), aims[k].unit) for k in unbound}
        corners |= {k: axis.raw(len(axis.values) - 1) for k, axis in fixed.items()}
        others = {}
        if len(self.held) > 1:
            for k in self.held:
                task = free.override({aims[k].key: corners[k]})
                others[k] = once(f"{minimised.best}, {aims[k].best}", partial(optimum, task))
        found = {}
        for k in unbound:
            limited, sense = free.override({aims[k].key: tightest(free, aims[k])}).spec, aims[k].sense
            designs = [best["design"], *(other["design"] for j, other in others.items() if j != k and other["design"])]
            worst = sense * max(sense * law_figure(limited, aims[k], design) for design in designs)
            found[k] = _axis(aims[k], tight[k], worst, self.count)
        return found

    def _tight(self, free: ProblemFile, aim: Aim) -> dict[str, float]:
        """The tightest value of a limit with which there is a design: the least relaxation of one that there is none with."""
        tight = free.override({aim.key: tightest(free, aim)})
        found = solve(tight, self.backend)
        if found.solution is not None and found.solution.usable:  # there is one, at the edge of what can be stated
            return {"limit": law_figure(tight.spec, aim, found.design)}
        sense = "<=" if aim.sense > 0 else ">="
        for item in found.conflict:
            if item.key == aim.key.rpartition(".")[0] and item.sense == sense and math.isfinite(item.relaxed):
                return {"limit": item.relaxed}
        raise self._no_end(aim, found.status.text)

    # --- a machine: from where the other objectives are best to where the one that is held is -----------------------------

    def _machine_ends(self, once: Once) -> tuple[dict[int, Axis], tuple[Mapping[str, float], ...]]:
        """Ranges of the limits, from the designs best in one objective, and among those in the others; and these designs."""
        problem, aims, first = self.problem, self.aims, self.first
        bounds = {k: axis.raw(0) for k, axis in self.fixed.items()}
        asked_for = [k for k in range(len(aims)) if k not in bounds]

        def searched(k: int, task: ProblemFile, near: Mapping[str, float] | None) -> dict[str, Any]:
            found = solve_cycle(restarted(task, near), self.backend, starts=1) if near is not None else None
            if found is None or found.status is not Status.OPTIMAL:
                found = solve_cycle(task, self.backend)
            measured = cycle_figures(problem, aims, found.values)
            if found.status not in (Status.OPTIMAL, Status.STALLED) or not np.all(np.isfinite(measured)):
                raise self._no_end(aims[k], found.status.text)
            return {"sizes": dict(found.values), "figures": list(measured)}  # proven or not: it only says where to walk

        alone = {first: once(aims[first].best, partial(searched, first, walked(problem, aims, {first: 1.0}, bounds), None))}
        begin = alone[first]["sizes"]
        for k in asked_for:
            if k != first:  # from a machine that meets all limits
                alone[k] = once(aims[k].best, partial(searched, k, walked(problem, aims, {k: 1.0}, bounds), begin))
        best = {k: alone[k]["figures"][k] for k in asked_for}
        width = {k: max(abs(end["figures"][k] - best[k]) for end in alone.values()) or abs(best[k]) for k in asked_for}
        corner = {}
        for k in asked_for:
            rest = {j: width[j] for j in asked_for if j != k}
            if not aims[k].key:  # a sum cannot be held
                corner[k] = alone[k]
                continue
            limit = text(aims[k].loose(best[k], NEAR * width[k]), aims[k].unit)
            task = walked(problem, aims, rest, {**bounds, k: limit})
            corner[k] = once(f"{aims[k].best}, then the others", partial(searched, k, task, alone[k]["sizes"]))
        found = {}
        for k in asked_for:
            if k != first:
                sense = aims[k].sense
                worst = sense * max(sense * corner[j]["figures"][k] for j in asked_for if j != k)
                found[k] = _axis(aims[k], best[k], worst, self.count)
        return found, tuple(corner[k]["sizes"] for k in sorted(corner, key=lambda k: k != first))


def _axis(aim: Aim, tight: float, loose: float, count: int) -> Axis:
    """Values of a limit from the loose end of the front to the tight one, both in short figures and inside it."""
    width = abs(loose - tight)
    if not width > NONE * max(abs(tight), abs(loose)):
        return Axis(aim.key, aim.unit, (aim.loose(tight, NONE * abs(tight)),))
    step = 10.0 ** math.floor(math.log10(NEAR * width))
    tight = aim.sense * math.ceil(aim.sense * aim.loose(tight, NEAR * width) / step) * step
    loose = aim.sense * math.floor(aim.sense * loose / step) * step
    return Axis(aim.key, aim.unit, tuple(float(f"{value:.12g}") for value in np.linspace(loose, tight, count)))


def _stated(aim: Aim, count: int, made: Callable[[Raw], ProblemFile]) -> Axis:
    """The range that was asked for, from its loose end; `made` gives the problem with a value of the limit."""
    axis = spanned(aim, count)
    for at in (0, len(axis.values) - 1):
        made(axis.raw(at))
    return replace(axis, values=tuple(sorted(axis.values, reverse=aim.sense > 0)))
