"""Regions that points must stay in or out of, as lines of a drawing: edge, hatching on the forbidden side, clearance, name."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from optlink.linkage.vector2d import TURN, Array
from optlink.problem.file import ProblemFile
from optlink.problem.region import RegionLimit
from optlink.report.names import LETTER, WIDTH
from optlink.report.shapes import clipped, strokes
from optlink.report.style import GROUND, LIMIT
from optlink.validation.check import Check

EDGE_WIDTH, THIN_WIDTH = 1.2, 0.6  # line widths [pt] of an edge, and of its hatching and clearance
ROOM = 2.0  # room for hatching and name around a region, in heights of a ground pivot
BEYOND = 0.35  # a region this share of the extent beyond the mechanism still enlarges the drawing
CORNER, ROUND, SAMPLES = 9, 121, 65  # points of a rounded corner, of a circle, and of a straight edge of which one is near
HATCH = 0.35  # depth of the hatching, in heights of a ground pivot


@dataclass(frozen=True, eq=False)
class Outline:
    """A region in a drawing: lines (n, 2) with gaps at NaN, the middle of its name, and whether the design violates it."""

    name: str
    violated: bool
    edge: Array
    hatching: Array
    clearance: Array
    label: Array

    @property
    def colour(self) -> str:
        """Red if the design violates it."""
        return LIMIT if self.violated else GROUND

    @property
    def lines(self) -> tuple[tuple[Array, float, bool], ...]:
        """Its lines with their width [pt] and whether they are dashed."""
        return (self.edge, EDGE_WIDTH, False), (self.hatching, THIN_WIDTH, False), (self.clearance, THIN_WIDTH, True)

    def scaled(self, factor: float) -> "Outline":
        """Return the outline in another unit."""
        lines = (line * factor for line in (self.edge, self.hatching, self.clearance, self.label))
        return Outline(self.name, self.violated, *lines)


@dataclass(frozen=True)
class Region:
    """A limit of a region by its name, and whether a design violates it."""

    name: str
    limit: RegionLimit
    violated: bool = False

    def features(self, low: Array, high: Array, size: float) -> Array:
        """Return places (n, 2) [m] that a drawing from `low` to `high` should show; `size` is the height of a ground pivot.

        They are the corners of a region, and the point of its edge nearest to the middle, as far as they are near.
        """
        reach = BEYOND * np.max(high - low)
        edge = clipped(self._line(0.0, low - reach, high + reach), low - reach, high + reach)
        near = edge[np.all(np.isfinite(edge), axis=1)]
        inner = near[np.all((near > low - 0.999 * reach) & (near < high + 0.999 * reach), axis=1)]
        along = np.linspace(edge[:-1], edge[1:], SAMPLES).reshape(-1, 2)
        away = np.linalg.norm(along - 0.5 * (low + high), axis=1)
        if np.any(np.isfinite(away)):
            inner = np.concatenate([inner, along[[np.nanargmin(away)]]])
        return np.concatenate([inner + sign * ROOM * size for sign in (-1.0, 1.0)])

    def outline(self, low: Array, high: Array, size: float) -> Outline:
        """Return the outline in a drawing from `low` to `high` [m]; `size` is the height of a ground pivot."""
        inside = self.limit.side == "inside"
        edge = clipped(self._line(0.0, low, high)[:: -1 if inside else 1], low, high)
        margin = -self.limit.margin if inside else self.limit.margin
        clearance = clipped(self._line(margin, low, high), low, high) if margin else edge[:0]
        return Outline(
            self.name, self.violated, edge, strokes(edge, HATCH * size, HATCH * size), clearance, self._label(edge, size)
        )

    def _line(self, offset: float, low: Array, high: Array) -> Array:
        """Return the edge at an offset outwards, counter-clockwise, with gaps where a side is open."""
        limit, far = self.limit, 4.0 * float(np.max(high - low)) + float(np.max(np.abs([low, high])))
        if limit.region == "circle":
            assert limit.radius is not None
            turns = np.linspace(0.0, TURN, ROUND)
            centre = np.array([each.value for each in limit.centre])
            return np.asarray(centre + (limit.radius.value + offset) * np.column_stack([np.cos(turns), np.sin(turns)]))
        if limit.region == "half-plane":
            assert limit.direction is not None
            c, s = math.cos(limit.direction.value), math.sin(limit.direction.value)
            through = np.array([each.value for each in limit.through]) + offset * np.array([s, -c])
            middle = through + ((0.5 * (low + high) - through) @ [c, s]) * np.array([c, s])
            return np.array([middle - far * np.array([c, s]), middle + far * np.array([c, s])])
        (left, right), (bottom, top) = limit.box
        x0, x1, y0, y1 = (float(np.clip(end, -far, far)) for end in (left, right, bottom, top))
        line: list[Array] = []
        for k, (corner, end) in enumerate(zip([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], (bottom, right, top, left), strict=True)):
            turns = math.pi + 0.25 * TURN * (k + np.linspace(0.0, 1.0, CORNER if offset > 0.0 else 2))
            ways = np.column_stack([np.cos(turns), np.sin(turns)])
            ways = ways if offset > 0.0 else np.sum(ways, axis=0, keepdims=True)
            line += [np.array(corner) + offset * ways, *([] if math.isfinite(end) else [np.full((1, 2), np.nan)])]
        return np.concatenate([*line, line[0][:1]])

    def _label(self, edge: Array, size: float) -> Array:
        """Return the middle of the name.

        It is in or above a region that nothing may enter; beside another edge it is on the forbidden side, rather below than
        beside it.
        """
        half = 0.5 * LETTER * size * np.array([WIDTH * len(self.name), 1.0])
        known = edge[np.all(np.isfinite(edge), axis=1)]
        if not len(known):
            return np.full(2, np.nan)
        if np.all(np.isfinite(edge)) and np.allclose(edge[0], edge[-1]) and self.limit.side == "outside":
            low, high = np.min(known, axis=0), np.max(known, axis=0)
            middle = 0.5 * (low + high)
            if np.all(0.5 * (high - low) > half + 2.0 * HATCH * size):
                return np.asarray(middle)
            return np.array([middle[0], high[1] + self.limit.margin + HATCH * size + half[1]])
        along = np.nan_to_num(np.diff(edge, axis=0))
        lengths = np.linalg.norm(along, axis=1)
        k = int(np.argmax(lengths + 2.0 * np.abs(along[:, 0])))
        left = np.array([-along[k, 1], along[k, 0]]) / max(float(lengths[k]), 1e-30)
        return np.asarray(0.5 * (edge[k] + edge[k + 1]) + (2.0 * HATCH * size + float(np.abs(left) @ half)) * left)


def regions_of(problem: ProblemFile, checks: Iterable[Check] = ()) -> tuple[Region, ...]:
    """Return the regions of a problem; those whose check failed are violated."""
    limits: Mapping[str, RegionLimit] = getattr(getattr(problem.model, "limits", None), "regions", {})
    failed = {check.name for check in checks if not check.passed}
    return tuple(Region(name, limit, limit.label(name) in failed) for name, limit in limits.items())
