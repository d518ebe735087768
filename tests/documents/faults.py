"""What a page charges to the document that its system comes from, and how each charge is computed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Fault:
    """A fault of a document.

    Attributes
    ----------
    place
        Where the document states it: `eq. (13)`, `table 4`, `code of Objfun.m`.
    quote
        A few words or numbers of the document, as printed there.
    figures
        Numbers of the row as the page prints them, each with its computation from the other numbers of the document.
    holds
        A computation that shows the fault, where no number does.
    """

    place: str
    quote: str
    figures: Mapping[str, Callable[[], float]] = field(default_factory=dict)
    holds: Callable[[], bool] | None = None

    @property
    def cell(self) -> str:
        """The first cell of its row."""
        return f"{self.place}: 「{self.quote}」"
