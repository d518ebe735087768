"""Control that makes up for clearance: what the servo of the crank is told, sample by sample.

none: turn evenly. inverse: the periodic command of the inverse model. pid: a discrete PID on the measured error of the output,
referred to the crank, on top of the even motion; inverse+pid: on top of the inverse model's.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Control(enum.StrEnum):
    """How the crank's command is made."""

    NONE = "none"
    INVERSE = "inverse"
    PID = "pid"
    BOTH = "inverse+pid"

    @property
    def inverted(self) -> bool:
        """Whether the inverse model takes part."""
        return self in (Control.INVERSE, Control.BOTH)

    @property
    def fed_back(self) -> bool:
        """Whether the measured error takes part."""
        return self in (Control.PID, Control.BOTH)


@dataclass(frozen=True)
class Gains:
    """Of a PID controller: proportional [-], integral [1/s], derivative [s]; its output stays within +-`limit` [rad]."""

    proportional: float = 0.0
    integral: float = 0.0
    derivative: float = 0.0
    limit: float = np.inf


@dataclass
class PID:
    """A discrete PID: the integral waits while the output is at its limit and the error would drive it further (anti-windup)."""

    gains: Gains
    sample: float
    integral: float = 0.0
    before: float | None = None

    def __call__(self, error: float) -> float:
        """The correction for the error of this sample."""
        gains = self.gains
        slope = 0.0 if self.before is None else (error - self.before) / self.sample
        self.before = error
        integral = self.integral + gains.integral * self.sample * error
        wanted = gains.proportional * error + integral + gains.derivative * slope
        found = min(max(wanted, -gains.limit), gains.limit)
        if found == wanted or (wanted - found) * error < 0.0:
            self.integral = integral
        return found


@dataclass
class Controller:
    """By how much the crank is told to turn further, from sample to sample.

    Parameters
    ----------
    pid : PID
    wanted, leverage : array (samples per revolution,)
        The wanted output at the samples of a revolution, and the turn of the crank per change of the output there.
    angular : bool
        Whether the output is an angle, which has branches.
    """

    pid: PID
    wanted: Array
    leverage: Array
    angular: bool = False

    def __call__(self, sample: int, measured: float) -> float:
        """Further turn of the crank [rad] from this sample on."""
        k = sample % len(self.wanted)
        error = float(self.wanted[k]) - measured
        if self.angular:
            error = float(np.remainder(error + np.pi, 2.0 * np.pi) - np.pi)
        return self.pid(float(self.leverage[k]) * error)
