"""Undo and redo: the steps of a document. The server keeps a copy, so that a failed computation does not lose them."""

from collections.abc import Sequence
from typing import Generic, TypeVar

Step = TypeVar("Step")

MAX_STEPS = 200


class History(Generic[Step]):
    """Documents in the order of their changes, and the index of the present one."""

    def __init__(self, steps: Sequence[Step], at: int) -> None:
        self.steps, self.at = list(steps), at

    @property
    def present(self) -> Step:
        """The present document."""
        return self.steps[self.at]

    def add(self, document: Step) -> None:
        """Add a step after the present one, and drop what was undone."""
        self.steps[self.at + 1 :] = [document]
        del self.steps[:-MAX_STEPS]
        self.at = len(self.steps) - 1

    def move(self, step: int) -> None:
        """Undo (-1) or redo (+1) a step, if there is one."""
        self.at = min(max(self.at + step, 0), len(self.steps) - 1)

    @property
    def ends(self) -> tuple[bool, bool]:
        """Whether a step can be undone, and redone."""
        return self.at > 0, self.at < len(self.steps) - 1
