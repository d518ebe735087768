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
from optlink.synthesis.families import PoseFamily
from optlink.synthesis.four_poses import DyadCurves
from optlink.tasks.four_poses import ROUNDED, dyad_curves, four_bar_of_dyads, guided, joints_at, usable

SAME = 1e-6  # distance of the joints of a design from a dyad that is its own, as a multiple of the size of the poses
MAX_REACH = 30.0  # largest distance of what is drawn from the first pose, as a multiple of the size of the poses


def offered(problem: ProblemFile) -> bool:
    """Return whether two dyads of a curve make a design of a problem."""
    return problem.task == "path" and guided(problem.spec)


def curves(problem: ProblemFile, driver: Any, shown: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Return points and pivots [mm] of all dyads, None where they are far, and possible drivers; of a driver its partners.

    Driver and partner are those of four-bars within the bounds; see `_rows` for `shown`, the quantities [SI] of a design.

    Raises
    ------
    InputError
        If the problem does not have four poses, or there is no such dyad.
    """
    found, rows = _rows(problem, shown)
    family, files = PoseFamily(found, found), problem.variants()
    if driver is None:
        origin, far = np.array([found.places[0].real, found.places[0].imag]), MAX_REACH * found.size
        ends = zip(("points", "pivots"), found.between(rows), strict=True)
        placed = {name: _drawn(np.stack([part.real, part.imag], axis=1), origin, far) for name, part in ends}
        drives = np.any(usable(files, family.positions(rows, rows)), axis=1)
        return placed | {"drives": drives.tolist(), "poles": (1e3 * found.poles).tolist()}
    row = np.array([_row(problem, rows, driver)])
    return {"driver": driver, "usable": usable(files, family.positions(row, rows))[0].tolist()}


def _row(problem: ProblemFile, rows: Array, number: Any) -> float:
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < len(rows):
        raise InputError("no such dyad", "Pick a point of a curve", problem.file, "driver, follower", number)
    return float(rows[number])


def _rows(problem: ProblemFile, shown: Mapping[str, float] | None) -> tuple[DyadCurves, Array]:
    """Return the dyads and their rows, last of all those of the design that is shown, with a gap between, if it consists of two.

    Beside a design at its bounds no dyad of the drawn points need have a partner within them.
    """
    if not offered(problem):
        message, remedy = "only four poses of a four-bar with free timing have curves of dyads", "Leave all dimensions free"
        raise InputError(message, remedy, problem.file, "requirement")
    found = dyad_curves(problem)
    if found.special:
        raise InputError(found.special, "Change a pose", problem.file, "requirement.points")
    rows = np.arange(float(len(found.points)))
    if shown is None:
        return found, rows
    pivot, fixed, pin, joint = joints_at(problem.spec, shown)
    own = np.array([found.row_of(pin, pivot), found.row_of(joint, fixed)])
    gap = np.abs(np.stack(found.between(own)) - np.array([[pin, joint], [pivot, fixed]]))
    return found, rows if np.max(gap) > SAME * found.size else np.concatenate([rows, own[:1], rows[-1:], own[1:]])


def _drawn(places: Array, origin: Array, far: float) -> list[list[float] | None]:
    near = np.max(np.abs(places - origin), axis=1) <= far  # not where NaN
    return [[round(x, 6), round(y, 6)] if kept else None for kept, (x, y) in zip(near, 1e3 * places, strict=True)]


def joined(document: Document, driver: Any, follower: Any, shown: Mapping[str, float] | None) -> tuple[Document, Design]:
    """Return the document with the four-bar of two dyads of `curves` as the start of its search, and this four-bar, validated.

    Raises
    ------
    InputError
        If there is no such dyad, if the four-bar does not pass the poses, or if it lies outside the bounds.
    """
    rows, problem = _rows(document.problem, shown)[1], document.problem
    chosen = [_row(problem, rows, number) for number in (driver, follower)]
    return started(document, design_of(four_bar_of_dyads(problem, *chosen)))


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
        if (inside := min(max(value, low), high)) and abs(value - inside) <= ROUNDED * abs(inside):
            value = inside
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
