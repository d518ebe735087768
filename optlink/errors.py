"""What can go wrong, as values and exceptions that tell the user what to do next.

    OptlinkError
    ├── InputError    the user's file, key or value is not usable       exit code 2
    └── SolverError   a solver broke down where it should not have      exit code 3

That a problem has no feasible design, or that a design fails its validation, is no exception: it is a result (`Status`).
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass

SHOWN = 80  # characters of a bad value that are worth showing


def shown(value: object) -> str:
    """Give a value as people should see it in a message: short, on one line."""
    if isinstance(value, int) and value.bit_length() > 256:  # Python refuses to print the largest ones
        return f"an integer of {value.bit_length():,} bits"
    text = f'"{value}"' if isinstance(value, str) else str(value)
    text = " ".join(text.split())
    return text if len(text) <= SHOWN else text[: SHOWN - 4] + " ..."


@dataclass(frozen=True)
class Fault:
    """One thing wrong with the input: where, what was found, why it will not do, what would."""

    message: str
    remedy: str
    file: str | None = None
    key: str | None = None
    value: object = None

    def __str__(self) -> str:
        where = self.key or ""
        if where and self.value is not None:
            where += f" = {shown(self.value)}"
        return ": ".join(part for part in (self.file, where, f"{self.message}. {self.remedy}") if part)


class OptlinkError(Exception):
    """Base of every error that optlink raises on purpose."""

    exit_code = 3


class InputError(OptlinkError):
    """The input cannot be used; `faults` says why, one entry per thing to mend."""

    exit_code = 2

    def __init__(self, faults: Fault | Sequence[Fault]) -> None:
        self.faults: tuple[Fault, ...] = (faults,) if isinstance(faults, Fault) else tuple(faults)
        super().__init__("\n".join(str(fault) for fault in self.faults))


class SolverError(OptlinkError):
    """A solver broke down (no usable point came back at all)."""

    exit_code = 3


class Status(enum.Enum):
    """How a search ended. `text` is for people and says what to do next."""

    OPTIMAL = "optimal"
    STALLED = "stalled"
    INFEASIBLE = "infeasible"
    NON_FINITE = "non-finite"
    FEASIBLE = "feasible"
    NOT_SEARCHED = "not searched"

    @property
    def text(self) -> str:
        """One sentence for people."""
        return _STATUS_TEXT[self]


_STATUS_TEXT = {
    Status.OPTIMAL: "a local optimum: feasible, and no small change of the design improves the objective "
    "(--starts N searches further afield)",
    Status.STALLED: "the search stopped at a feasible design that is not an optimum; try another start or --starts 20",
    Status.INFEASIBLE: "no design meets all limits; relax one of the limits named in the conflict",
    Status.NON_FINITE: "the objective or a limit has no finite value or derivative at the design found; "
    "try another start or tighter bounds",
    Status.FEASIBLE: "a design that meets all limits but is not a local optimum: no local search from it ended at a better one; "
    "try --starts N",
    Status.NOT_SEARCHED: "a given design was checked, nothing was searched",
}
