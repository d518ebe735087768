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
from optlink.synthesis.five_poses import Complex
from optlink.tasks.five_targets import frame_direction, in_words
from optlink.tasks.four_poses import ROUNDED, applies, family_of, joints_at, joints_given, of_family, usable

SAME = 1e-6  # distance of the joints of a design from a dyad that is its own, as a multiple of the size of the poses
MAX_REACH = 30.0  # largest distance of what is drawn from the first target, as a multiple of the size of the targets
HINTS = {
    "dyads": (
        "Pick the driver on a blue part: its pivot (solid) or its point on the body at pose 1 (dashed).",
        "Pick its partner on a green part: each is a four-bar that passes all poses within your bounds.",
    ),
    "cranks": (
        "Pick a crank on a blue part: its pivot (solid) or its pin at point 1 (dashed).",
        "Pick its partner on a green part: its pivot (solid) or its joint at point 1 (dashed).",
    ),
    "couplers": (
        "Pick a coupler on a blue part: its pin on the crank (solid) or its joint on the output (dashed), both at position 1. "
        "The pivots are given: these curves belong to the bodies that move.",
        "",
    ),
}
"""What the page says before a driver and before its partner are picked, by the noun of a family."""

NO_PARTNER = "This driver has no partner within your bounds and limits. Pick another driver."
NO_DRIVER = (
    "No linkage of these curves meets all targets within your bounds and limits. "
    "Widen them, or list the exact solutions (X), which name the bounds."
)


def offered(problem: ProblemFile) -> bool:
    """Return whether the targets of a problem leave a family of linkages, of which curves show the joints."""
    task = problem.spec if problem.model.parts else None
    return task is not None and (applies(task) or (joints_given(task) and len(family_of(task).drivers.points) > 1))


def curves(problem: ProblemFile, design: Design, driver: Any) -> dict[str, Any]:
    """Return both ends [mm] of all drivers, None where they are far, and those that may drive; of a driver its partners.

    Driver and partner are those of linkages within the bounds, with those of the `design` that is shown, see `_rows`. `single`:
    whether a driver alone is a linkage. The pivots of a function are those of the `design`.

    Raises
    ------
    InputError
        If the problem does not leave a family of linkages, or there is no such driver.
    """
    family, rows, partners = _rows(problem, design)
    task, files = problem.variants()[0].spec, problem.variants()
    first, second = HINTS[family.noun]
    if driver is None:
        drives = np.any(usable(files, family.positions(rows, partners)), axis=1).tolist()
        fields = {"drives": drives, "hint": first if any(drives) else NO_DRIVER, "single": len(partners) == 1}
        return {**_drawn(family, family.ends(rows), task, design), **fields}
    row = np.array([_row(problem, "driver", rows, driver)])
    fits = usable(files, family.positions(row, partners))[0].tolist()
    fields = {"driver": driver, "usable": fits, "hint": second if any(fits) else NO_PARTNER}
    return {**_drawn(family, family.ends(row, partners), task, design), **fields}


def _row(problem: ProblemFile, key: str, rows: Array, number: Any) -> float:
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < len(rows):
        raise InputError("no such dyad", "Pick a point of a curve", problem.file, key, number)
    return float(rows[number])


def _rows(problem: ProblemFile, design: Design) -> tuple[Family, Array, Array]:
    """Return the family of a problem, and the rows of its drivers and of their partners.

    The rows that are nearest to the dyads of a design of poses are these dyads themselves: beside a design at its bounds no dyad
    of the drawn points need have a partner within them.
    """
    if not offered(problem):
        message = "only four poses, timed points or positions of an output leave linkages that curves show"
        raise InputError(message, "Leave all dimensions free", problem.file, "requirement")
    task = problem.variants()[0].spec
    family = family_of(task)
    if special := in_words(task, family.drivers.special or family.followers.special):
        raise InputError(special, "Change a target", problem.file, "requirement")
    rows, partners = np.arange(float(len(family.drivers.points))), family.rows
    if task.requirement.kind == "motion":
        pivot, fixed, pin, joint = joints_at(task, design.values)
        for side, every, ends in ((family.drivers, rows, (pin, pivot)), (family.followers, partners, (joint, fixed))):
            own = np.array([side.row_of(*ends)])
            if np.max(np.abs(np.concatenate(side.between(own)) - ends)) <= SAME * side.size:
                every[np.rint(own).astype(int)] = own
    return family, rows, partners


def _drawn(family: Family, ends: tuple[Complex, Complex], task: DesignProblem, design: Design) -> dict[str, Any]:
    """Return both ends of dyads as they are drawn [mm]."""
    origin, far = family.drivers.places[0], MAX_REACH * family.drivers.size
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


def joined(document: Document, design: Design, driver: Any, follower: Any) -> tuple[Document, Design]:
    """Return the document with the linkage of a driver and a partner as the start of its search, and this linkage, validated.

    `design`, `driver`, `follower`: what is shown, and numbers in `curves` of it.

    Raises
    ------
    InputError
        If there is no such dyad, if the linkage does not meet the targets, or if it lies outside the bounds.
    """
    problem = document.problem
    _, rows, partners = _rows(problem, design)
    pair = _row(problem, "driver", rows, driver), _row(problem, "follower", partners, follower)
    return started(document, design_of(of_family(problem, *pair)))


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
