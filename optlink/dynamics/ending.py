"""Events of a simulation: crank angles at which the integration restarts or ends, and reasons for its end."""

import enum

import numpy as np

from optlink.dynamics.runge_kutta import Step
from optlink.linkage.vector2d import Array

EDGE = 1e-6  # share of a limited range excluded at each end: speeds are infinite at a dead position
PASSED_JUMP = 1e-9  # rad: a jump of a load nearer than this counts as passed


class Ending(enum.Enum):
    """Reason for the end of a simulation; `text` describes it."""

    FINISHED = "finished"
    AT_REST = "at rest"
    DEAD_POSITION = "dead position"
    SINGULAR = "singular position"
    JAMMED = "jammed"
    UNDETERMINED = "undetermined"
    STALLED = "stalled"
    INTERRUPTED = "interrupted"

    @property
    def text(self) -> str:
        """Description in one sentence."""
        return _TEXT[self]


_TEXT = {
    Ending.FINISHED: "the whole duration was simulated",
    Ending.AT_REST: "the machine came to rest: the drive cannot overcome loads and friction there",
    Ending.DEAD_POSITION: "the crank reached a position beyond which the mechanism cannot be assembled",
    Ending.SINGULAR: "the crank reached a singular position: the assembly modes meet, and the motion beyond is not determined",
    Ending.JAMMED: "friction jams a guide: no motion of the machine satisfies its law, and rest does not either",
    Ending.UNDETERMINED: "friction of a guide leaves the motion open: more than one motion, or motion and rest, satisfy it",
    Ending.STALLED: "the integration stalled: a singular position, or forces and speeds that grow without bound; "
    "results up to that time are kept. Start elsewhere, shorten the duration, or check loads and torque",
    Ending.INTERRUPTED: "interrupted; results up to that time are kept",
}


def nearest(angle: float, marks: Array, cycle: float, aside: float = 0.0) -> list[float]:
    """Return the nearest below and above a crank angle [rad] of marks that repeat every cycle, at least `aside` away."""
    if not len(marks):
        return []
    every = (marks[:, None] + cycle * (np.floor(angle / cycle) + np.arange(-2.0, 3.0))).ravel()
    return [float(np.max(every[every <= angle - aside])), float(np.min(every[every >= angle + aside]))]


def marks_ahead(angle: float, switches: Array, cycle: float, limits: tuple[float, float] | None) -> list[tuple[str, float]]:
    """Return crank angles [rad] at which the integration restarts or ends, the nearest on either side, with the kind of event.

    `switches` are the crank angles at which a load jumps, repeated every cycle, `limits` the reachable range.
    """
    marks = [("switch", at) for at in nearest(angle, switches, cycle, PASSED_JUMP)]
    if limits is not None:
        edge = EDGE * (limits[1] - limits[0])
        marks += [("limit", limits[0] + edge), ("limit", limits[1] - edge)]
    return marks


def first_event(step: Step, direction: float, marks: list[tuple[str, float]]) -> tuple[float, str | None]:
    """Return the time of the first event within a step, an angle is reached or the crank stops, and its kind; else the end.

    The state begins with crank angle and speed; `direction` is the sense in which the crank turns, 0 if it cannot come to rest.
    """
    (angle, speed), (later, slower) = step.before[:2].tolist(), step.after[:2].tolist()
    events = [(kind, 0, at) for kind, at in marks if (angle - at) * (later - at) < 0.0]
    if speed * direction > 0.0 > slower * direction:
        events.append(("rest", 1, 0.0))
    if not events:
        return step.end, None
    from scipy.optimize import brentq

    return min(
        (float(brentq(lambda t, part=part, at=at: step.at(t, part) - at, step.time, step.end, xtol=1e-16, rtol=1e-15)), kind)
        for kind, part, at in events
    )
