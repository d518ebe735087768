"""One objective of a Pareto front."""

from dataclasses import dataclass
from typing import Any

from optlink.problem.cycle.terms import Term
from optlink.studies.grid import Axis, column, read_axis

OPTION = "--objectives"


@dataclass(frozen=True)
class ParetoObjective:
    """One objective of a Pareto front: its text, `text`, and its `name`.

    `sense`: 1 to minimise, -1 to maximise; `key`: the limit that constrains it in the problem file, with its side, empty for an
    objective that can only be minimised itself; `term`: of a machine, as in the file; `span`: the requested range, if any;
    `of`: name of a dimension; `part`: number of the requirement whose deviation it is.
    """

    text: str
    name: str
    unit: str
    sense: int
    key: str = ""
    term: tuple[tuple[str, Any], ...] = ()
    span: str = ""
    of: str = ""
    part: int = -1

    @property
    def direct(self) -> bool:
        """Whether it can be minimised itself, not only constrained."""
        return self.part >= 0 or bool(self.term) or not self.key

    @property
    def column(self) -> str:
        """Name of its column in the table."""
        return column(self.name, self.unit).replace(" ", "_")

    @property
    def best(self) -> str:
        """Name of its end of the front."""
        if self.name.startswith(("largest", "least", "smallest")):
            return f"best {self.name}"
        return f"{'least' if self.sense > 0 else 'largest'} {self.name}"

    @property
    def way(self) -> str:
        """Whether it is minimised or maximised, in a word."""
        return "minimise" if self.sense > 0 else "maximise"

    @property
    def side(self) -> str:
        """Side of the limit that constrains it."""
        return "max" if self.sense > 0 else "min"

    @property
    def cycle_term(self) -> Term:
        """Term of a machine."""
        return Term.model_validate(dict(self.term))

    def worsened(self, value: float, by: float) -> float:
        """Return a value that is worse by an amount."""
        return value + self.sense * by


def range_values(objective: ParetoObjective, count: int) -> Axis:
    """Return the values of the requested range of an objective."""
    stated = ":" in objective.span or "step" in objective.span
    return read_axis(f"{objective.key}={objective.span}" + ("" if stated else f":{count}"))
