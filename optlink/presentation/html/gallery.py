"""Gallery of a page: all exact solutions of a problem as small moving pictures, one of which is chosen by a click."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from optlink.presentation.export.svg import motion_data, svg
from optlink.presentation.format import fixed, number
from optlink.presentation.html.moving_linkage import cycle_of
from optlink.presentation.scene import scene
from optlink.tasks.results.design import SynthesisResult
from optlink.tasks.results.exact import BY_TRANSMISSION
from optlink.tasks.search import mode_of

STEPS = 48  # positions per revolution
MOST = 24  # largest number of pictures


@dataclass(frozen=True)
class Picture:
    """A solution: its drawing and the data that move it, None where it cannot be drawn; dimensions as text; what excludes it."""

    drawing: str
    motion: dict[str, Any] | None
    sizes: Mapping[str, str]
    reasons: Sequence[str]


@dataclass(frozen=True)
class Gallery:
    """Pictures of exact solutions in their order, and how many solutions there are."""

    pictures: Sequence[Picture]
    count: int

    @property
    def svg(self) -> str:
        """All drawings."""
        return "".join(one.drawing for one in self.pictures)

    @property
    def motions(self) -> list[dict[str, Any] | None]:
        """The data that move the drawings."""
        return [one.motion for one in self.pictures]


def gallery(result: SynthesisResult) -> Gallery | None:
    """Return the gallery of a result; None without exact solutions."""
    found, model = result.exact_solutions, result.problem.model
    if found is None or not found.solutions:
        return None
    pictures, modes = [], {mode_of(file): file for file in result.problem.variants()}
    for k, one in enumerate(found.solutions[:MOST], start=1):
        file = modes.get(one.assembly)
        cycle = None if file is None else cycle_of(file, one.values, math.nan if one.crank_angle is None else one.crank_angle)
        drawn = None if cycle is None else scene(cycle, STEPS)
        sizes = {}
        for name in model.free:
            factor, unit = model.display(name)
            sizes[name] = f"{number(one.values[name] * factor, 4)} {unit}".rstrip()
        sizes |= {"assembly": one.assembly, BY_TRANSMISSION: f"{fixed(math.degrees(one.transmission), 1)} deg"}
        if one.figure is not None:
            sizes[found.ranked_by] = f"{number(one.figure, 4)} {found.unit}".rstrip()
        drawing, motion = ("", None) if drawn is None else (svg(drawn, f"Solution {k}"), motion_data(drawn))
        pictures.append(Picture(drawing, motion, sizes, one.reasons))
    return Gallery(pictures, len(found.solutions))
