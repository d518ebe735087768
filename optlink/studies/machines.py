"""The task that designs a machine by its cycle at every point of a grid.

Within a chunk a search begins at the machine of a neighbour that is done; the first one of a chunk begins where the problem says
and at random sizes, so that no chunk depends on another. Every machine is proven as a single one is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from optlink.design.files import ProblemFile, read
from optlink.design.linkages import sizes_of
from optlink.design.quantity import Quantity
from optlink.design.settled import settled
from optlink.errors import Status
from optlink.machine_design import MachineDesign, design_machine
from optlink.studies.follow import FOLLOWED
from optlink.studies.keys import changed
from optlink.studies.reoptimise import SEARCHED, TAIL, active
from optlink.studies.tasks import Sweeping, figure
from optlink.units import KINDS, factor


@dataclass(frozen=True)
class Designing(Sweeping):
    """A new machine at every point."""

    backend: str

    @cached_property
    def free(self) -> dict[str, Quantity]:
        """The free sizes."""
        model = self.problem.model
        return {name: model.quantities[name] for name in model.free}

    @property
    def columns(self) -> list[str]:
        """The axes, the free sizes in people's units, the objective in SI, and how it was found."""
        free = [f"{name}_{KINDS[quantity.kind].people}" for name, quantity in self.free.items()]
        return [*(axis.column for axis in self.grid.axes), *free, "objective", *TAIL]

    def lines(self, index: int) -> list[list[str]]:
        """Rows of a chunk."""
        done: dict[int, MachineDesign] = {}
        rows = []
        for point in self.span(index):
            task = changed(self.problem, self.grid.changes(point))
            near = done.get(point - 1 if point % self.grid.row else point - self.grid.row)
            found, how = None, FOLLOWED
            if near is not None:
                found = design_machine(restarted(task, near.values), self.backend, starts=1)
            if found is None or not found.valid:
                found, how = self.searched(task), SEARCHED
            if found.valid:
                done[point] = found
            rows.append(self._row(point, found, how))
        return rows

    def searched(self, task: ProblemFile) -> MachineDesign:
        """The machine of a problem for itself; where its peaks did not settle, searched once more from there."""
        found = design_machine(task, self.backend)
        if found.valid or found.status is not Status.OPTIMAL:
            return found
        again = design_machine(restarted(task, found.values), self.backend, starts=1)
        return again if again.valid else found

    def _row(self, point: int, found: MachineDesign, how: str) -> list[str]:
        usable = found.status in (Status.OPTIMAL, Status.STALLED)
        people = [found.values[n] / factor(KINDS[q.kind].people, q.kind) for n, q in self.free.items()]
        failed = "; ".join(check.name for check in found.validation.checks if not check.passed)
        held = "" if found.solution is None or not usable else "; ".join(active(found.solution))
        values = [figure(value) if usable else "" for value in (*people, found.objective)]
        return [*map(repr, self.grid.values(point)), *values, found.status.value, str(found.valid).lower(), failed, held, how]


def restarted(problem: ProblemFile, values: Mapping[str, float]) -> ProblemFile:
    """The problem with its free sizes starting at others [SI], clipped to their bounds."""
    sizes = sizes_of(problem.model.mechanism.quantities)
    for name, value in values.items():
        low, high = problem.model.quantities[name].bounds
        sizes[name] = min(max(value, low), high)
    begun = _begun(problem.raw["mechanism"], settled(problem, sizes).raw["mechanism"])
    return read({**problem.raw, "mechanism": begun}, problem.name, problem.file, problem.folder)


def _begun(free: Any, fixed: Any) -> Any:
    """A part of the file with the values of a settled one as the start of what is free."""
    if isinstance(free, Mapping) and "bounds" in free:
        return {**free, "start": fixed}
    if isinstance(free, Mapping):
        return {key: _begun(value, fixed[key]) for key, value in free.items()}
    if isinstance(free, list):
        return [_begun(value, other) for value, other in zip(free, fixed, strict=True)]
    return free
