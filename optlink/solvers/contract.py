"""Registry of back ends: local solvers by name, each imported when it is first used."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from optlink.io import Registry

if TYPE_CHECKING:
    from optlink.optimization.nlp import NLP
    from optlink.solvers.solution import Backend

BACKENDS = ("slsqp", "ipopt")
"""Back ends of a search with "both"."""
MINIMAX = "minimax"  # only for NLPs that minimise the largest of many deviations
LEAST_SQUARES, FOUND = "least squares", "found by least squares"  # a method before any back end, and its message: none changed it
CLOSE = "ipopt, close"  # IPOPT with a small barrier parameter, for a start near an optimum


@dataclass(frozen=True)
class Solver:
    """A back end: `load` imports and returns it, `compile` builds what it needs for an NLP; `selectable` by a user."""

    load: Callable[[], Backend]
    compile: Callable[[NLP], object] | None = None
    selectable: bool = True


SOLVERS: Registry[Solver] = Registry()


def selectable() -> tuple[str, ...]:
    """Return the names of the back ends that a user can select."""
    return tuple(name for name, solver in SOLVERS.items() if solver.selectable)


def backend(name: str) -> Backend:
    """Return the back end of that name; its library is imported on first use. It searches with independent equations only."""
    from optlink.solvers.dependent_equations import independent

    return independent(SOLVERS[name].load())


def _slsqp() -> Backend:
    from optlink.solvers.slsqp import slsqp

    return slsqp


def _ipopt() -> Backend:
    from optlink.solvers.ipopt import ipopt

    return ipopt


def _ipopt_close() -> Backend:
    """Return IPOPT for a nearly optimal start, whose neighbourhood it does not leave."""
    from optlink.solvers.ipopt import ipopt

    return functools.partial(ipopt, close=True)


def _compiled(nlp: NLP) -> object:
    from optlink.solvers.ipopt import compiled

    return compiled(nlp)


def _minimax() -> Backend:
    from optlink.solvers.minimax import minimax

    return minimax


SOLVERS.add("slsqp", Solver(_slsqp))
SOLVERS.add("ipopt", Solver(_ipopt, _compiled))
SOLVERS.add(CLOSE, Solver(_ipopt_close, selectable=False))
SOLVERS.add(MINIMAX, Solver(_minimax, selectable=False))
