"""Dyads of four poses on the canvas: their curves, the partners of a driver, and the four-bar of two of them."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from optlink.errors import InputError
from optlink.linkage.vector2d import Array
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import quantity_key
from optlink.studies.grid import exact_text
from optlink.studio.design import Design, design_of
from optlink.studio.document import Document
from optlink.tasks.four_poses import dyad_curves, four_bar_of_dyads, guided

MAX_REACH = 30.0  # largest distance of what is drawn from the first pose, as a multiple of the size of the poses


def offered(problem: ProblemFile) -> bool:
    """Return whether two dyads of a curve make a design of a problem."""
    return problem.task == "path" and guided(problem.spec)


def curves(problem: ProblemFile, driver: Any) -> dict[str, Any]:
    """Return points and pivots [mm] of all dyads, None where they are far, and possible drivers; of a driver its partners.

    Raises
    ------
    InputError
        If the problem does not have four poses, or there is no such dyad.
    """
    if not offered(problem):
        message, remedy = "only four poses of a four-bar with free timing have curves of dyads", "Leave all dimensions free"
        raise InputError(message, remedy, problem.file, "requirement")
    found = dyad_curves(problem)
    if found.special:
        raise InputError(found.special, "Change a pose", problem.file, "requirement.points")
    if driver is None:
        origin, far = np.array([found.places[0].real, found.places[0].imag]), MAX_REACH * found.size
        placed = {name: _drawn(part, origin, far) for name, part in (("points", found.points), ("pivots", found.pivots))}
        return placed | {"drives": found.in_order.tolist(), "poles": (1e3 * found.poles).tolist()}
    if isinstance(driver, bool) or not isinstance(driver, int) or not 0 <= driver < len(found.points):
        raise InputError("no such dyad", "Pick a point of a curve", problem.file, "driver", driver)
    partners = found.partners([driver])
    turns = partners.turns[0] | (problem.spec.limits.crank == "span")
    return {"driver": driver, "usable": ((partners.defect[0] == 0) & turns).tolist()}


def _drawn(places: Array, origin: Array, far: float) -> list[list[float] | None]:
    near = np.max(np.abs(places - origin), axis=1) <= far  # not where NaN
    return [[round(x, 6), round(y, 6)] if kept else None for kept, (x, y) in zip(near, 1e3 * places, strict=True)]


def joined(document: Document, driver: Any, follower: Any) -> tuple[Document, Design]:
    """Return the document with the four-bar of two dyads as the start of its search, and this four-bar, validated.

    Raises
    ------
    InputError
        If the four-bar does not pass the poses, or lies outside the bounds.
    """
    return started(document, design_of(four_bar_of_dyads(document.problem, driver, follower)))


def started(document: Document, design: Design) -> tuple[Document, Design]:
    """Return the document with a design of its problem as the start of its search, and this design.

    Raises
    ------
    InputError
        If the design lies outside the bounds.
    """
    problem = document.problem
    changes: dict[str, object] = {}
    for name in problem.model.free:
        quantity, key, value = problem.model.quantities[name], quantity_key(problem.model, name), design.values[name]
        per, unit = quantity.si_per_unit, quantity.display[1]
        low, high = quantity.bounds
        if not low <= value <= high:
            message = f"{name} of this linkage is {value / per:.4g} {unit}, allowed {low / per:.4g} ... {high / per:.4g}"
            raise InputError(message, "Choose another one, or widen the bounds", problem.file, key)
        stated = _stated(problem, key)
        bounds = stated if isinstance(stated, Mapping) else {"bounds": [exact_text(end / per, unit) for end in (low, high)]}
        changes[key] = {**bounds, "start": exact_text(value / per, unit)}
    return document.with_changes(changes), design


def _stated(problem: ProblemFile, key: str) -> Any:
    try:
        return problem.at(key)
    except (KeyError, InputError):  # a default
        return None
