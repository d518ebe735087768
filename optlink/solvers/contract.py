"""Back ends: local solvers by name, each imported when it is first used."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from optlink.io import Entry, register

if TYPE_CHECKING:
    from optlink.optimization.nlp import NLP
    from optlink.solvers.solution import Backend

BACKENDS = ("slsqp", "ipopt")
"""Back ends of a search with "both"."""
MINIMAX = "minimax"  # only for NLPs that minimise the largest of many deviations
FOUND, SOLVED = "found by least squares", "solved by equations"  # messages of designs that no back end has changed
METHODS = {FOUND: "least squares", SOLVED: "equations"}
CLOSE = "ipopt, close"  # IPOPT with a small barrier parameter, for a start near an optimum


@dataclass(frozen=True)
class Solver(Entry):
    """A back end: a local solver that `--backend` names.

    Parameters
    ----------
    name : str
        As it is selected.
    load : function
        Imports and returns the back end, a function of (programme, x, p, *, track, tight) that returns an `Attempt`.
    compile : function of (programme), optional
        Builds what the back end needs for a programme.
    selectable : bool
        Whether a user can select it.
    """

    name: str
    load: Callable[[], Backend]
    compile: Callable[[NLP], object] | None = None
    selectable: bool = True

    def fault(self) -> tuple[str, str] | None:
        """Refuse the word that stands for two back ends."""
        return ("it stands for two back ends", "Choose another name") if self.name == "both" else None


SOLVERS: dict[str, Solver] = Solver.registry


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


register(
    Solver("slsqp", _slsqp),
    Solver("ipopt", _ipopt, _compiled),
    Solver(CLOSE, _ipopt_close, selectable=False),
    Solver(MINIMAX, _minimax, selectable=False),
)
