"""What every benchmark needs: contenders timed in turn, a row of the table, a child process."""

from __future__ import annotations

import math
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent


def race(
    contenders: Mapping[str, Callable[[], object]],
    repetitions: int,
    warm_up: int = 2,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """Median seconds of each contender; they take turns, so that a slow spell of the machine hits all alike."""
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for repetition in range(-warm_up, repetitions):
        for name, run in contenders.items():
            begin = clock()
            run()
            if repetition >= 0:
                seconds[name].append(clock() - begin)
    return {name: statistics.median(taken) for name, taken in seconds.items()}


def child(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run this Python in the checkout, with the compiled modules that an installation has."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return subprocess.run([sys.executable, *arguments], cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


SPEED, ERROR, RESULT, GROWTH, COST = "speed", "error", "result", "growth", "cost"
"""Kinds of ratios: their time over ours; their error over ours; our share of good results over theirs; time or memory of a small
call over that of a large one, for each design; our time over that of something unavoidable (less is better)."""


@dataclass(frozen=True)
class Row:
    """One comparison. `ratio` says how much better we are, except where `target` begins with "<="."""

    what: str
    ours: str
    theirs: str
    ratio: float = math.nan
    target: str = ""  # such as ">= 10", "<= 1.8"; empty: shown for information
    note: str = ""
    percent: bool = False
    figures: Mapping[str, float] = field(default_factory=dict)  # medians in SI, for the JSON document
    kind: str = SPEED
    cut: bool = False  # the peer was stopped: the ratio is at least this

    @property
    def holds(self) -> bool | None:
        """Whether the target is met; None without target or figure, or if the peer was stopped before that was decided."""
        if not self.target or math.isnan(self.ratio):
            return None
        relation, bound = self.target.split()
        if self.cut:
            return True if relation == ">=" and self.ratio > float(bound) else None
        return self.ratio >= float(bound) if relation == ">=" else self.ratio <= float(bound)

    def shown(self, value: float) -> str:
        """The ratio as text."""
        if math.isnan(value):
            return "-"
        return f"{100.0 * value:.0f} %" if self.percent else f"{value:.3g}x"

    @property
    def wanted(self) -> str:
        """The target as text."""
        relation, _, bound = self.target.partition(" ")
        return f"{relation} {self.shown(float(bound))}" if bound else ""
