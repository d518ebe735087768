"""Regions of the plane that a point must stay in or out of: `[limits] hood = { region = "box", of = "P", x = [...], ... }`."""

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator

from optlink.linkage.mechanism import Mechanism
from optlink.linkage.vector2d import Value, Vector
from optlink.problem.base_model import Section
from optlink.problem.interval import CoordinateInterval
from optlink.problem.mechanism import moving_points
from optlink.problem.quantity import FixedAngle, FixedLength, Quantity, Unusable, check_pair, nearest, read_fixed, read_positive

SHARE = 0.02  # of the larger half width of a box: default clearance outside it
ROUNDING = 1e-12  # share of the size of a problem that is added to a distance, which is then smooth where it vanishes
SHAPES = {
    "box": (("x", "y"), 'x = ["0 mm", "40 mm"], y = ["10 mm", "30 mm"]'),
    "circle": (("centre", "radius"), 'centre = ["40 mm", "20 mm"], radius = "15 mm"'),
    "half-plane": (("through", "direction"), 'through = ["0 mm", "20 mm"], direction = "0 deg"'),
}
"""Keys of each shape, and an example."""


def _read_place(raw: object) -> tuple[Quantity, Quantity]:
    x, y = check_pair(raw, "a place is a list of two coordinates", 'Write ["100 mm", "0 mm"]')
    return read_fixed(x, "coordinate"), read_fixed(y, "coordinate")


class RegionLimit(Section):
    """A region that a point must stay in or out of: a box, a circle or a half-plane."""

    region: Literal["box", "circle", "half-plane"]
    """Shape of the region."""
    of: str
    """The point."""
    side: Literal["outside", "inside"] = "outside"
    """Whether the point stays outside or inside."""
    x: CoordinateInterval | None = None
    """Range of x of a box; default: any."""
    y: CoordinateInterval | None = None
    """Range of y of a box; default: any."""
    centre: Annotated[Any, BeforeValidator(_read_place)] = None
    """Centre of a circle."""
    radius: FixedLength | None = None
    """Radius of a circle."""
    through: Annotated[Any, BeforeValidator(_read_place)] = None
    """A point on the edge of a half-plane."""
    direction: FixedAngle | None = None
    """Direction of the edge of a half-plane, which lies to its left."""
    clearance: Annotated[Quantity | None, BeforeValidator(lambda raw: read_positive(raw, "coordinate"))] = None
    """Least distance from the edge of the region; default: 2 % of the larger half width outside a box, else zero."""
    over: Literal["revolution", "span"] | None = None
    """Crank range over which the limit applies; default: the required rotation."""

    def check(self, linkage: Mechanism, crank: str) -> None:
        """Check that the region has the keys of its shape, and that the point moves.

        Raises
        ------
        Unusable
            with the key below the limit.
        """
        keys, example = SHAPES[self.region]
        stated = self.model_fields_set
        for shape, (others, _) in SHAPES.items():
            if wrong := next((key for key in others if key in stated and key not in keys), None):
                raise Unusable(f"a {self.region} has no {wrong}", f'Leave it out, or write region = "{shape}"', wrong)
        missing = [key for key in keys if getattr(self, key) is None]
        if missing and (self.region != "box" or len(missing) == len(keys)):
            raise Unusable(f"the {self.region} is not complete", f"Add for example {example}", missing[0])
        if self.region == "box" and self.side == "outside":
            for axis in ("x", "y"):
                if (one := getattr(self, axis)) is not None and one.low == one.high:
                    raise Unusable("the box has no breadth", 'Give a range such as ["0 mm", "40 mm"]', axis, str(one))
        if self.of not in (moving := moving_points(linkage)):
            raise Unusable("no moving body has such a point", nearest(self.of, moving), "of", self.of)
        if self.over == "revolution" and crank == "span":
            message = "a crank that need not turn fully has no whole revolution"
            raise Unusable(message, 'Write over = "span", or crank = "full rotation"', "over", self.over)
        if self.side == "inside" and not self.margin < self._half_width:
            message = "the clearance leaves nothing of the region"
            raise Unusable(message, "Give a smaller one, or a larger region", "clearance", str(self.clearance))

    @property
    def box(self) -> tuple[tuple[float, float], ...]:
        """Ranges [m] of x and y of a box, infinite where they are open."""
        return tuple((-math.inf, math.inf) if one is None else one.bounds for one in (self.x, self.y))

    @property
    def _half_width(self) -> float:
        """Least half width [m] of a box, or the radius of a circle."""
        if self.region == "half-plane":
            return math.inf
        return self.radius.value if self.radius is not None else min(0.5 * (high - low) for low, high in self.box)

    @property
    def margin(self) -> float:
        """Least distance [m] from the edge of the region."""
        if self.clearance is not None:
            return self.clearance.value
        halves = [0.5 * (high - low) for low, high in self.box if math.isfinite(high - low)]
        return SHARE * max(halves, default=0.0) if (self.region, self.side) == ("box", "outside") else 0.0

    def label(self, name: str) -> str:
        """Return the name of the limit in tables and checks."""
        return f"{self.of} {self.side} {name}"

    def distances(self, point: Vector, size: float) -> list[Value]:
        """Return distances [m] of a point from the edge, all of them positive on its side; elementwise, smooth beyond the edge.

        `size` [m] is that of the problem. Outside a box the distance is that from its nearest point, which is smooth where the
        largest excess over a side is not; inside it is the negative distance from the nearest side.
        """
        x, y = point
        if self.region == "circle":
            assert self.radius is not None
            u, v = x - self.centre[0].value, y - self.centre[1].value
            away = np.sqrt(u * u + v * v + (ROUNDING * size) ** 2) - self.radius.value
            return [away if self.side == "outside" else -away]
        if self.region == "half-plane":
            assert self.direction is not None
            c, s = math.cos(self.direction.value), math.sin(self.direction.value)
            left = c * (y - self.through[1].value) - s * (x - self.through[0].value)
            return [-left if self.side == "outside" else left]
        bounded = [(value, ends) for value, ends in zip(point, self.box, strict=True) if any(map(math.isfinite, ends))]
        if self.side == "inside":
            sides = [(value - low, high - value, low, high) for value, (low, high) in bounded]
            return [each for one in sides for each, end in zip(one[:2], one[2:], strict=True) if math.isfinite(end)]
        excess = [self._beyond(value, *ends) for value, ends in bounded]
        square = sum(np.maximum(each, 0.0) ** 2 for each in excess)
        inside = excess[0] if len(excess) == 1 else np.maximum(*excess)
        return [np.sqrt(square + (ROUNDING * size) ** 2) + np.minimum(inside, 0.0)]

    @staticmethod
    def _beyond(value: Value, low: float, high: float) -> Value:
        """Return by how much a coordinate lies beyond a range, negative within."""
        if math.isinf(low) or math.isinf(high):
            return low - value if math.isinf(high) else value - high
        return np.abs(value - 0.5 * (low + high)) - 0.5 * (high - low)

    def measured(self, places: Any) -> Any:
        """Return the distances [m] of places (..., 2) from the edge, one array for each straight side of the allowed region.

        They are measured separately from `distances`: from the nearest point of the region, or between it and each side.
        """
        x, y = np.moveaxis(np.asarray(places, dtype=float), -1, 0)
        if self.region == "circle":
            assert self.radius is not None
            away = np.hypot(x - self.centre[0].value, y - self.centre[1].value) - self.radius.value
        elif self.region == "half-plane":
            assert self.direction is not None
            normal = self.direction.value + 0.5 * math.pi
            away = -((x - self.through[0].value) * math.cos(normal) + (y - self.through[1].value) * math.sin(normal))
        else:
            (left, right), (bottom, top) = self.box
            ends = {left: x - left, right: right - x}, {bottom: y - bottom, top: top - y}
            sides = np.stack([away for pair in ends for end, away in pair.items() if math.isfinite(end)])
            if self.side == "inside":
                return sides
            depth = np.min(sides, axis=0)
            away = np.where(depth > 0.0, -depth, np.hypot(x - np.clip(x, left, right), y - np.clip(y, bottom, top)))
        return (away if self.side == "outside" else -away)[None]
