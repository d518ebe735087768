"""Sweep task that simulates the machine at every point of a grid: speed, clearance, friction or dimensions vary."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from optlink.dynamics.ending import Ending
from optlink.errors import InputError
from optlink.problem.file import ProblemFile
from optlink.studies.grid import Grid
from optlink.studies.sweep_task import FiguresTask, MachineFigures
from optlink.tasks.clearance import check_simulations, simulate_clearance
from optlink.tasks.simulate import simulate


@dataclass(frozen=True)
class SimulationTask(FiguresTask):
    """Figures of the simulation of the machine at every point.

    `figures`: their names, those of a simulation at the first point; `stated`: options (revolutions, points, control, tolerance,
    duration [s], speed [rad/s]); `design` [SI]: design variables that are not varied.
    """

    mode = "simulate"

    figures: tuple[str, ...]
    stated: tuple[tuple[str, Any], ...]
    design: tuple[tuple[str, float], ...]

    @property
    def options(self) -> dict[str, Any]:
        """Options of every simulation, and the given design."""
        return {"options": dict(self.stated), "design": dict(self.design)}

    def machines(self, points: range) -> Iterator[MachineFigures]:
        """Yield the figures of the simulations at points of the grid."""
        return map(self.simulated, points)

    @cached_property
    def has_clearance(self) -> bool:
        """Whether there are joints with clearance."""
        return self.problem.override(self.grid.changes(0)).model.has_clearance

    def simulated(self, point: int) -> MachineFigures:
        """Return the figures of a simulation, with its ending as status."""
        try:
            file = self.problem.override(self.grid.changes(point))
            design = {name: value for name, value in self.design if name in file.model.free} or None
            result = simulate_machine(file, dict(self.stated), design, has_clearances=self.has_clearance)
        except InputError as error:
            return MachineFigures({}, "not simulated", error.faults[0].message)
        if result.status == Ending.INTERRUPTED.value:  # a row is complete or absent
            raise KeyboardInterrupt
        return result


def simulate_machine(
    problem: ProblemFile, options: Mapping[str, Any], design: Mapping[str, float] | None, *, has_clearances: bool
) -> MachineFigures:
    """Simulate one machine."""
    settings = dict(options)
    if has_clearances:
        settings = {"integrator": "cvodes", **settings}  # one for all points, whatever is compiled meanwhile
        simulation = simulate_clearance(problem, design=design, check_predictability=False, **settings)
        return MachineFigures(simulation.figures, simulation.ending.value, "" if simulation.finished else simulation.message)
    if "points" in settings:
        settings["rows"] = settings.pop("points")
    ideal = simulate(problem, design=design, **settings)
    reason = "" if ideal.finished else f"{ideal.ending.text} (at {ideal.stopped:.9g} s)"
    return MachineFigures(ideal.figures, ideal.ending.value, reason)


def simulation_task(
    problem: ProblemFile, grid: Grid, options: Mapping[str, Any], design: Mapping[str, float] | None
) -> SimulationTask:
    """Return the task that simulates every point; the names of its figures are those of a short run at the first one.

    With joint clearance, its integrator is the one that is fastest for all points.
    """
    first, short = problem.override(grid.changes(0)), options
    clearances = first.model.has_clearance
    if clearances:
        settings = {"control": "none", "revolutions": 20, "points": 360, "tolerance": 1e-10, **options}
        _, integrator = check_simulations(first, design=design, runs=grid.count, **settings)
        options = {**options, "integrator": integrator} if integrator != "cvodes" else options
        short = {**options, "revolutions": 1}
    names = tuple(simulate_machine(first, short, design, has_clearances=clearances).figures)
    return SimulationTask(problem, grid, 1, names, tuple(options.items()), tuple((design or {}).items()))
