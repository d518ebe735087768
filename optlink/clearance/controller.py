"""Control that compensates joint clearance, by sampled corrections of the crank command.

none: constant speed. inverse: the periodic command of the inverse model. pid: a discrete PID on the measured error of the
output, referred to the crank, added to the constant speed; inverse+pid: added to the command of the inverse model.
"""

import enum
from dataclasses import dataclass

import numpy as np

from optlink.linkage.vector2d import Array


class Control(enum.StrEnum):
    """Kind of control of the crank."""

    NONE = "none"
    INVERSE = "inverse"
    PID = "pid"
    BOTH = "inverse+pid"

    @property
    def inverted(self) -> bool:
        """Whether the inverse model is used."""
        return self in (Control.INVERSE, Control.BOTH)

    @property
    def fed_back(self) -> bool:
        """Whether feedback of the measured error is used."""
        return self in (Control.PID, Control.BOTH)


@dataclass(frozen=True)
class Gains:
    """Gains of a PID controller: proportional [-], integral [1/s], derivative [s]; its output is limited to +-`limit` [rad]."""

    proportional: float = 0.0
    integral: float = 0.0
    derivative: float = 0.0
    limit: float = np.inf


@dataclass
class PID:
    """A discrete PID controller with anti-windup.

    The integral is frozen while the output is at its limit and the error would drive it further.
    """

    gains: Gains
    sample: float
    integral: float = 0.0
    before: float | None = None

    def __call__(self, error: float) -> float:
        """Return the correction for the error of this sample."""
        gains = self.gains
        slope = 0.0 if self.before is None else (error - self.before) / self.sample
        self.before = error
        integral = self.integral + gains.integral * self.sample * error
        demand = gains.proportional * error + integral + gains.derivative * slope
        limited = min(max(demand, -gains.limit), gains.limit)
        if limited == demand or (demand - limited) * error < 0.0:
            self.integral = integral
        return limited


@dataclass
class Controller:
    """Feedback correction of the crank angle, sample by sample.

    At the samples of a revolution: `target` output [m, rad], and `leverage`, the crank rotation per change of the output
    [rad/m, -]. The error of an `angular` output is wrapped to (-pi, pi].
    """

    pid: PID
    target: Array
    leverage: Array
    angular: bool = False

    def __call__(self, sample: int, measured: float) -> float:
        """Return the correction of the crank angle [rad] from this sample on."""
        k = sample % len(self.target)
        error = float(self.target[k]) - measured
        if self.angular:
            error = float(np.remainder(error + np.pi, 2.0 * np.pi) - np.pi)
        return self.pid(float(self.leverage[k]) * error)
