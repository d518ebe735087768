"""Families of linkages on the canvas: the curves of their joints, the partners of a driver, and the linkage that is picked."""

import cmath
from collections.abc import Mapping
from typing import Any

import numpy as np

from optlink.errors import InputError
from optlink.linkage.vector2d import Array
from optlink.problem.design import DesignProblem
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import quantity_key
from optlink.studies.grid import exact_text
from optlink.studio.design import Design, design_of
from optlink.studio.document import Document
from optlink.synthesis.families import Family
from optlink.synthesis.four_poses import Positions
from optlink.tasks.five_targets import frame_direction, in_words
from optlink.tasks.four_poses import applies, family_of, joints_given, of_family

MAX_REACH = 30.0  # largest distance of what is drawn from the first target, as a multiple of the size of the targets
HINTS = {
    "dyads": (
        "Pick the driver on a blue part: its pivot (solid) or its point on the body at pose 1 (dashed).",
        "Pick its partner on a green part: each is a four-bar that passes all poses.",
    ),
    "cranks": (
        "Pick a crank: its pivot (solid) or its pin at point 1 (dashed).",
        "Pick its partner on a green part: its pivot (solid) or its joint at point 1 (dashed).",
    ),
    "couplers": (
        "Pick a coupler on a blue part: its pin on the crank (solid) or its joint on the output (dashed), both at position 1. "
        "The pivots are given: these curves belong to the bodies that move.",
        "",
    ),
}
"""What the page says before a driver and before its partner are picked, by the noun of a family."""


def offered(problem: ProblemFile) -> bool:
    """Return whether the targets of a problem leave a family of linkages, of which curves show the joints."""
    task = problem.spec if problem.model.parts else None
    return task is not None and (applies(task) or (joints_given(task) and len(family_of(task).drivers.points) > 1))


def curves(problem: ProblemFile, design: Design, driver: Any) -> dict[str, Any]:
    """Return both ends [mm] of all drivers, None where they are far, and those that may drive; of a driver its partners.

    `single`: whether a driver alone is a linkage. The pivots of a function are those of the `design`.

    Raises
    ------
    InputError
        If the problem does not leave a family of linkages, or there is no such driver.
    """
    if not offered(problem):
        message = "only four poses, timed points or positions of an output leave linkages that curves show"
        raise InputError(message, "Leave all dimensions free", problem.file, "requirement")
    task = problem.variants()[0].spec
    family = family_of(task)
    if special := in_words(task, family.drivers.special or family.followers.special):
        raise InputError(special, "Change a target", problem.file, "requirement")
    rows, single = np.arange(float(len(family.drivers.points))), len(family.rows) == 1
    first, second = HINTS[family.noun]

    def fit(found: Positions) -> Array:
        return np.asarray((found.pairs.defect == 0) & (found.pairs.turns | (task.limits.crank == "span")))

    if driver is None:
        drives = fit(family.positions(rows, family.rows))[:, 0] if single else family.may_drive(rows)
        return {**_drawn(family, None, task, design), "drives": drives.tolist(), "hint": first, "single": single}
    if isinstance(driver, bool) or not isinstance(driver, int) or not 0 <= driver < len(rows):
        raise InputError("no such dyad", "Pick a point of a curve", problem.file, "driver", driver)
    usable = fit(family.positions(rows[driver : driver + 1], family.rows))[0]
    return {**_drawn(family, driver, task, design), "driver": driver, "usable": usable.tolist(), "hint": second}


def _drawn(family: Family, driver: int | None, task: DesignProblem, design: Design) -> dict[str, Any]:
    """Return both ends of all drivers, or of the partners of one, as they are drawn [mm]."""
    ends, origin, far = family.ends(driver), family.drivers.places[0], MAX_REACH * family.drivers.size
    near = np.max(np.abs(np.array(ends) - origin), axis=0) <= far  # not where NaN
    if task.law_given:  # as seen from the pivot of the crank
        pivot, along = _frame(task, design)
        ends = pivot + along * ends[0], pivot + along * ends[1]
    return {
        name: [[round(1e3 * z.real, 6), round(1e3 * z.imag, 6)] if kept else None for z, kept in zip(end, near, strict=True)]
        for name, end in zip(("pivots", "points"), ends, strict=True)
    }


def _frame(task: DesignProblem, design: Design) -> tuple[complex, complex]:
    """Return the pivot of the crank [m], and the vector to that of the rocker, or the direction of a guide."""
    place: Any = task.linkage.ground[task.linkage.crank.start]
    loop = task.four_bar
    pivot = complex(*(design.values[part] if isinstance(part, str) else part for part in place))
    along = cmath.exp(1j * frame_direction(task))
    if loop is not None:
        length, direction = loop.frame(design.values)
        along = complex(length) * (along if direction is None else complex(*direction))
    return pivot, along


def joined(document: Document, driver: Any, follower: Any) -> tuple[Document, Design]:
    """Return the document with the linkage of a driver and a partner as the start of its search, and this linkage, validated.

    Raises
    ------
    InputError
        If the linkage does not meet the targets, or lies outside the bounds.
    """
    for key, row in (("driver", driver), ("follower", follower)):
        if isinstance(row, bool) or not isinstance(row, int):
            raise InputError("no such dyad", "Pick a point of a curve", document.file, key, row)
    return started(document, design_of(of_family(document.problem, driver, follower)))


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
