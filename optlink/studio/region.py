"""The region of the pivots that is drawn on the canvas: a limit of the problem, and bounds of their free coordinates."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from optlink.errors import InputError
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import quantity_key

KEY = "limits.pivots"
MM = 1e3  # millimetres per metre


def shown(problem: ProblemFile) -> list[float | None] | None:
    """Return the sides [mm] of the region: left, lower, right, upper, None where it is open; None if no pivot can be limited."""
    limits: Any = getattr(problem.model, "limits", None)
    if not _free(problem) or not hasattr(limits, "pivots"):
        return None
    sides = [getattr(limits.pivots, axis, None) for axis in ("x", "y")]
    ends = [getattr(side, end, None) for end in ("low", "high") for side in sides]
    return [None if end is None or not np.isfinite(end) else round(MM * end, 6) for end in ends]


def changes(problem: ProblemFile, box: Any) -> Mapping[str, object]:
    """Return the changes of the file that keep all pivots in a box [mm]: left, lower, right, upper.

    Raises
    ------
    InputError
        If the box is none, or the problem has no free pivots.
    """
    if not isinstance(box, list) or len(box) != 4 or not all(isinstance(end, int | float) and abs(end) <= 1e6 for end in box):
        raise InputError("a region has four sides of at most 1e6 mm", "Draw it again", key="box")
    if not (box[0] < box[2] and box[1] < box[3]):
        raise InputError("the region is empty", "Draw a larger one", key="box", value=box)
    if shown(problem) is None:
        remedy = "Give the coordinates of a pivot bounds"
        raise InputError("no pivot of this problem may move, or none can be limited", remedy, problem.file, KEY)
    ranges = {axis: [f"{box[k + end]:z.10g} mm" for end in (0, 2)] for k, axis in enumerate("xy")}
    return {KEY: ranges} | {key: {"bounds": ranges[key[-1]]} for key in _free(problem)}


def _free(problem: ProblemFile) -> list[str]:
    """Return the keys of the free coordinates of ground pivots."""
    model = problem.model
    keys = [quantity_key(model, name) for name in model.free]
    return [key for key in keys if key.startswith(("mechanism.pivot.", "mechanism.ground."))]
