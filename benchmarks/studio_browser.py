"""Latency of the studio in a browser: from a movement of the mouse to the re-optimised linkage, redrawn.

    python benchmarks/studio_browser.py [--events 1000] [--problem crank-rocker]

A real mouse in a headless Chromium drags a handle along a closed curve, one event every 16 ms. The page notes for every movement
when it happened, and when a drag that contains it was sent, answered and drawn (`window.studioTimings`); a movement that was
overtaken counts until a later one is drawn.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.browser import browser, console
from tests.studio.browser import Page, studio

HANDLES = {"crank-rocker": "mechanism.frame", "path-closed18": "requirement.points.4", "shaper-design": "mechanism.ground.A.x"}
"""Handle that is dragged of each problem."""
REACH = {"crank-rocker": 60.0, "path-closed18": 14.0, "shaper-design": 40.0}  # of the drag [px]
ROUND = 200  # events of one round
CHUNK = 100  # events that the driver is given at once


def steps(count: int, reach: float) -> list[tuple[int, int]]:
    """Return whole steps [px] of the mouse along a figure of eight.

    Parameters
    ----------
    count : int
    reach : float [px]
        Half its width.
    """
    turn = 2.0 * np.pi * np.arange(count + 1) / ROUND
    places = np.rint(np.column_stack([reach * np.sin(turn), 0.5 * reach * np.sin(2.0 * turn)])).astype(int)
    return [(int(x), int(y)) for x, y in np.diff(places, axis=0)]


def measured(driver: Any, problem: str, events: int) -> dict[str, Any]:
    """Return counts and percentiles [ms] of a drag.

    Parameters
    ----------
    driver : selenium driver
    problem : str
        A problem of `HANDLES`.
    events : int
        Number of movements of the mouse.
    """
    with studio() as address:
        page = Page(driver, address)
        page.size(1400, 900)
        page.open(problem)
        page.press(HANDLES[problem])
        found: list[dict[str, Any]] = []
        moves = steps(events, REACH[problem])
        for k in range(0, events, CHUNK):
            page.move(moves[k : k + CHUNK])
        page.until("return window.studioTimings.length > 0")
        page.release()
        page.until("return !window.studioTimings.at(-1).moving")
        found = page.timings()
        heap = page.run("return performance.memory ? performance.memory.usedJSHeapSize : null")
        if noise := console(driver):
            raise RuntimeError(f"on the console: {noise}")
    drawn = [one for one in found if one["moving"]]

    def percentiles(end: str, begin: str) -> dict[str, float]:
        values = [one[end] - one[begin] for one in drawn]
        return {name: round(float(np.percentile(values, q)), 1) for name, q in (("p50", 50), ("p95", 95), ("most", 100))}

    order = [one["drawn"] for one in drawn]
    return {
        "problem": problem,
        "handle": HANDLES[problem],
        "movements": len(drawn),
        "answers": len({one["id"] for one in drawn}),
        "in_order": order == sorted(order) and all(math.isfinite(t) for t in order),
        "mouse_to_redrawn_ms": percentiles("drawn", "event"),
        "sent_to_answered_ms": percentiles("answered", "sent"),
        "answered_to_redrawn_ms": percentiles("drawn", "answered"),
        "heap_bytes": heap,
    }


def main() -> None:
    """Measure, and print JSON."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--events", type=int, default=1000)
    parser.add_argument("--problem", choices=HANDLES, action="append")
    options = parser.parse_args()
    with browser() as driver:
        for problem in options.problem or HANDLES:
            print(json.dumps(measured(driver, problem, options.events)), flush=True)


if __name__ == "__main__":
    main()
