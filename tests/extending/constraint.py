"""A limit of the ratio of the coupler to the crank of a four-bar: `[limits] coupler_ratio = [2.0, 3.5]`."""

from collections.abc import Iterator, Mapping

import numpy as np

from optlink.extending import DesignProblem, Interval, LimitTerm, Moved, NumberInterval, Reach, Value, register


def values(problem: DesignProblem, sizes: Mapping[str, Value], reach: Reach, limit: Interval) -> Iterator[tuple[str, Value]]:
    """Yield the formula of the optimiser, which works on symbols too."""
    yield "coupler / crank", sizes["coupler"] / sizes["crank"]


def measure(moved: Moved, limit: Interval) -> Iterator[tuple[str, float]]:
    """Yield the same ratio, measured between the joints in motion."""
    a, b, c = (moved.required.position(name) for name in "ABC")
    yield "coupler / crank", float(np.median(np.linalg.norm(c - b, axis=1)) / np.median(np.linalg.norm(b - a, axis=1)))


register(
    LimitTerm(
        "coupler_ratio",
        NumberInterval,
        values,
        measure,
        about="Coupler over crank; of a four-bar.",
        possible=(0.0, np.inf),
        example="[2.0, 3.5]",
    )
)
