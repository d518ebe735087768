"""Reasons for the end of a simulation."""

from __future__ import annotations

import enum


class Ending(enum.Enum):
    """Reason for the end of a simulation; `text` describes it."""

    FINISHED = "finished"
    AT_REST = "at rest"
    DEAD_POSITION = "dead position"
    SINGULAR = "singular position"
    JAMMED = "jammed"
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
    Ending.JAMMED: "friction jams a guide: no finite force moves the machine",
    Ending.STALLED: "the integration stalled: a singular position, or forces and speeds that grow without bound; "
    "what was computed until then is kept. Start elsewhere, shorten the duration, or check loads and torque",
    Ending.INTERRUPTED: "interrupted; what was computed until then is kept",
}
