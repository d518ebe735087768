"""Search a four-bar between free pivots by its lengths, the direction of its frame, and crank angles from the frame.

A rotation of the linkage changes one of these unknowns, and both coordinates of the rocker pivot and every crank angle otherwise:
least squares converge from far more starting points.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.vector2d import TURN, Array
from optlink.optimization.programme import path_variable
from optlink.problem.base_model import RESERVED
from optlink.problem.design import DesignProblem
from optlink.problem.mechanism import FourBarSection
from optlink.problem.quantity import Quantity
from optlink.problem.requirements.base import START

SHORTEST = 1e-3  # of the size of the curve: least length of a frame that has none


class ByLengths:
    """A problem, and the same one of a four-bar by its lengths, `problem`: None if the linkage cannot be written so.

    All coordinates of its pivots and of a point on its coupler are free, and the crank angles of the points, or their start.
    """

    def __init__(self, stated: DesignProblem) -> None:
        self.stated, loop, free = stated, stated.four_bar, set(stated.free)
        self.problem: DesignProblem | None = None
        mark = None if loop is None else stated.linkage.marks.get((loop.coupler.body, stated.point))
        if loop is None or mark is None or loop.frame_length or loop.coupler.start != loop.pin:
            return
        timed = stated.data.offsets is None or START in free
        limits, named = stated.limits, stated.point in {*"ABCD", *LENGTHS, *RESERVED}
        if not timed or named or not set(loop.ground) <= free or stated.links or stated.robust is not None:
            return
        if limits.regions or loop.joint != "C":
            return
        quantities, (along, across) = stated.quantities, (str(mark.along), str(mark.across))
        if not {along, across} <= quantities.keys():
            return
        low, high = stated.frame_bounds if limits.frame_length is None else limits.frame_length.bounds
        low, high = max(low, stated.frame_bounds[0], SHORTEST * stated.size), min(high, stated.frame_bounds[1])
        ax, ay = (quantities[name] for name in loop.ground[:2])
        bars: dict[str, Any] = {name: quantities[size] for name, size in zip(LENGTHS, loop.names, strict=False)}
        section = FourBarSection.model_construct(
            **bars,
            frame=Quantity(0.5 * (low + high), "length", "mm", low, high),
            points={stated.point: (quantities[along], quantities[across])},
            pivot=(ax, ay),
            direction=Quantity(0.0, "angle", "deg", -math.pi, math.pi),
            assembly="left" if loop.side > 0 else "right",
        )
        fields: dict[str, Any] = {name: getattr(stated, name) for name in type(stated).model_fields}
        drive = stated.drive.model_copy(update={"body": None})
        kept = limits.model_copy(update={"frame_length": None})
        self.problem = type(stated).model_construct(**(fields | {"mechanism": section, "drive": drive, "limits": kept}))
        self.names = dict(zip(loop.names, LENGTHS, strict=False)) | dict(zip(loop.ground[:2], ("A.x", "A.y"), strict=True))
        self.names |= {along: f"{stated.point}.along", across: f"{stated.point}.across"}
        self.pivot = loop.ground[2:]

    def stated_design(self, x: Array, t: Array) -> tuple[Array, Array]:
        """Return the scaled variables (designs, n) and crank angles (designs, points) [rad] of the stated problem."""
        assert self.problem is not None
        stated, problem = self.stated, self.problem
        values = {name: path_variable(problem, name).value(x[:, i]) for i, name in enumerate(problem.free)}
        frame, direction = values["frame"], values["direction"]
        values[self.pivot[0]] = values["A.x"] + frame * np.cos(direction)
        values[self.pivot[1]] = values["A.y"] + frame * np.sin(direction)
        if START in values:
            values[START] = np.remainder(values[START] + direction + math.pi, TURN) - math.pi
        y = np.empty_like(x)
        for i, name in enumerate(stated.free):
            low, high = stated.quantities[name].bounds
            y[:, i] = path_variable(stated, name).scaled(np.clip(values[self.names.get(name, name)], low, high))
        return y, t + direction[:, None] if stated.data.offsets is None else t
