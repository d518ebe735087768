"""Control that makes up for clearance: what the servo of the crank is told, sample by sample.

none: turn evenly. inverse: the periodic command of the inverse model. pid: a discrete PID on the measured error of the output,
referred to the crank, on top of the even motion; inverse+pid: on top of the inverse model's.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from optlink.clearance.inverse import Command

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
    """What the servo is told.

    Parameters
    ----------
    command : Command
        The motion of the crank without feedback.
    pid : PID or None
    wanted, leverage : array (samples per revolution,)
        The wanted output at the samples of a revolution, and the turn of the crank per change of the output there.
    angular : bool
        Whether the output is an angle, which has branches.
    """

    command: Command
    pid: PID | None = None
    wanted: Array = field(default_factory=lambda: np.zeros(1))
    leverage: Array = field(default_factory=lambda: np.zeros(1))
    angular: bool = False

    def __call__(self, sample: int, time: float, measured: float) -> tuple[float, float]:
        """Angle [rad] and speed [rad/s] from this sample on."""
        angle, speed = self.command.at(time)
        if self.pid is None:
            return angle, speed
        k = sample % len(self.wanted)
        error = float(self.wanted[k]) - measured
        if self.angular:
            error = float(np.remainder(error + np.pi, 2.0 * np.pi) - np.pi)
        return angle + self.pid(float(self.leverage[k]) * error), speed
