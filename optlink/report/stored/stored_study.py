"""A result that is shown as it was recorded: what a simulation, a balance or a study found, as a page."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from optlink.errors import InputError
from optlink.problem.file import ProblemFile
from optlink.problem.fixed_design import settled
from optlink.problem.mechanism import sizes_of
from optlink.report.html import tables
from optlink.report.html.charts import readouts
from optlink.report.html.moving_linkage import Moving, crank_stops
from optlink.report.html.shell import Section, Sheet, cards, fitted, write
from optlink.report.html.sources import closing
from optlink.report.scene import scene
from optlink.tasks.analyze import Analysis, analyze
from optlink.units import KINDS, factor


@dataclass(frozen=True, eq=False)
class Studied:
    """What a recorded result says.

    `kind`: what was done, in words; `status`: lines below the verdict; `sections` with their charts; `moving`: the linkage with
    so many positions of a revolution, `drawn`: what is said above it, `after`: how many sections come before it; `by`: how it was
    found.
    """

    problem: ProblemFile
    kind: str
    verdict: str
    valid: bool
    status: Sequence[str]
    sections: Sequence[Section]
    moving: Callable[[int], Moving | None]
    by: str
    drawn: str = ""
    after: int = 0
    notes: tuple[str, ...] = ()


def write_studied(studied: Studied, path: Path) -> None:
    """Write the page of a recorded result.

    Raises
    ------
    InputError
        when nothing can be written there; then no file is left behind.
    """
    write(studied_page(studied), path)


def studied_page(studied: Studied) -> str:
    """The page of a recorded result as HTML."""
    return fitted(lambda steps: _sheet(studied, steps))


def _sheet(studied: Studied, steps: int) -> Sheet:
    file, moving = studied.problem, studied.moving(steps)
    sections = list(studied.sections)
    if moving is not None:
        above = f'<p class="lead">{escape(studied.drawn)}</p>' if studied.drawn else ""
        sections.insert(studied.after, Section("Linkage in motion", (above, moving.html(file.model.title))))
    lines = [*studied.status, *(f"Note: {note}" for note in studied.notes)]
    return Sheet(
        title=file.model.title,
        kind=f"{file.name} · {studied.kind}",
        verdict=studied.verdict,
        good=studied.valid,
        status="".join(f"<p>{escape(line)}</p>" for line in lines if line),
        sections=(*sections, *closing(file, studied.by)),
        moving=moving,
    )


# --- parts -------------------------------------------------------------------------------------------------------------------


def split(told: RenderableType) -> tuple[list[str], list[Table | Text]]:
    """What a terminal is told: the lines below its title, and the tables and texts after them."""
    parts = list(tables.flat(told))
    first = parts[0]
    lines = first.plain.split("\n")[1:] if isinstance(first, Text) else []
    return [line for line in lines if line.strip()], parts[1:] if isinstance(first, Text) else parts


def figures_of(parts: Iterable[Table | Text], name: str = "Figures") -> Iterator[Section]:
    """A section of tables, if there are any."""
    listed = list(parts)
    if listed:
        yield Section(name, (cards(listed),))


def named_si(file: ProblemFile, columns: Mapping[str, float]) -> dict[str, float]:
    """Quantities of a problem [SI] from columns such as "coupler_mm"; other columns are left out."""
    found = {}
    for name, quantity in file.model.quantities.items():
        unit = KINDS[quantity.kind].people
        column = f"{name}_{unit}" if unit else name
        if column in columns:
            found[name] = columns[column] * (factor(unit, quantity.kind) if unit else 1.0)
    return found


def cycle_of(file: ProblemFile, design: Mapping[str, float]) -> Analysis | None:
    """The machine of a problem with a design [SI] over its motion; None where it cannot be assembled."""
    sizes = {**sizes_of(file.model.mechanism.quantities), **design}
    try:
        return analyze(settled(file, {name: sizes[name] for name in file.model.mechanism.quantities}))
    except InputError:
        return None


def turning(file: ProblemFile, design: Mapping[str, float]) -> Callable[[int], Moving | None]:
    """The machine of a problem with a design [SI] over its motion, by the crank angle."""

    def made(steps: int) -> Moving | None:
        cycle = cycle_of(file, design)
        if cycle is None:
            return None
        drawn = scene(cycle, steps)
        forces = bool(cycle.machine.inertias or cycle.machine.loads)
        return Moving(drawn, crank_stops(drawn), readouts(cycle, drawn.angles, forces=forces))

    return made


def still(_: int) -> None:
    """No linkage."""
