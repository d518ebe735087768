"""HTML sections of a balancing result, checked against inverse dynamics when it is read."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.counterweights import BalanceMeasure, quantities, quantities_of
from optlink.dynamics.machine import Machine
from optlink.problem.base_model import Contradiction
from optlink.problem.file import ProblemFile
from optlink.problem.machine.balance import BalanceSection, read_measure
from optlink.problem.quantity import Unusable
from optlink.report.html import chart_plotly
from optlink.report.html.shell import PageSection
from optlink.report.stored.stored_study import StoredStudy, figures_of, still, turning
from optlink.report.views import balance_tables, conclusions
from optlink.report.views.balance import courses, trade_off
from optlink.tasks.balance import balanced_problem, measure_changes, positions
from optlink.tasks.machine import machine_of
from optlink.tasks.results.balance import (
    AddedCounterweight,
    Balance,
    BalanceRecord,
    FittedSpring,
    MeasureChange,
    TradeOff,
)

Array = NDArray[np.float64]
TRUE = 1e-6  # relative tolerance of stored measures, as a share of the value before balancing
VERDICTS = {
    "optimal": "Optimal: no counterweights within the limits do better",
    "relaxed": "Near the proven bound",
    "infeasible": "No counterweights meet all limits",
    "stalled": "Not proven",
}


# --- reading -----------------------------------------------------------------------------------------------------------------


def read(record: BalanceRecord, file: ProblemFile) -> Balance:
    """Return a stored balancing result; its measures are computed anew from its counterweights.

    Parameters
    ----------
    record : BalanceRecord
    file : ProblemFile
        The problem that was solved.

    Raises
    ------
    Contradiction
        If the measures differ from those of the counterweights, or the problem has no such counterweight.
    """
    section = file.model.balance
    if section is None:
        raise Contradiction("status", "its problem asks for no balance", record.status)
    machine = machine_of(file)
    angles = positions(file, machine, record.speed_rad_s)
    added, springs = _parts(record, section, machine)
    balanced = balanced_problem(file, machine, added, springs) if record.measures else None
    heavier = None if balanced is None else machine_of(balanced)
    whole = len(section.goal) > 1 and " + " in record.measure
    return record.build(
        Balance,
        problem=file,
        goal=section.goal if whole else ((_measure(record.measure), 1.0),),
        machine=machine,
        angles=angles,
        added=added,
        springs=springs,
        balanced=balanced,
        heavier=heavier,
        rows=() if heavier is None else _rows(record, machine, heavier, angles),
        trade=None if record.trade is None else record.trade.build(TradeOff),
        excess=0.0 if record.valid else math.inf,
    )


def _measure(text: str) -> BalanceMeasure:
    try:
        return read_measure(text)
    except Unusable as error:
        raise Contradiction("measure", error.message, text) from None


def _parts(
    record: BalanceRecord, section: BalanceSection, machine: Machine
) -> tuple[tuple[AddedCounterweight, ...], tuple[FittedSpring, ...]]:
    """Return the optimal counterweights and springs."""
    weights, free = section.build(machine)
    bodies, names = {weight.body: weight for weight in weights}, {spring.name: spring for spring in free}
    for k, one in enumerate(record.counterweights):
        if one.body not in bodies:
            raise Contradiction(f"counterweights[{k}].body", "the problem has no such counterweight", one.body)
    for k, spring in enumerate(record.springs):
        if spring.name not in names:
            raise Contradiction(f"springs[{k}].name", "the problem has no such spring", spring.name)
    added = [AddedCounterweight(bodies[one.body], one.parameters) for one in record.counterweights]
    springs = [FittedSpring(names[one.name], one.stiffness_N_m, one.free_length_m) for one in record.springs]
    return tuple(added), tuple(springs)


def _rows(record: BalanceRecord, machine: Machine, heavier: Machine, angles: Array) -> tuple[MeasureChange, ...]:
    """Recompute all measures before and after balancing by inverse dynamics; raise if the record differs."""
    asked = quantities(machine)
    both = [quantities_of(one.moving(angles, record.speed_rad_s), asked, record.moment_about_m) for one in (machine, heavier)]
    rows = measure_changes(asked, *both)
    told = {str(one.name): (k, one) for k, one in enumerate(record.measures)}
    for row in rows:
        if str(row.measure) not in told:
            raise Contradiction("measures", f"the {row.measure} is missing")
        k, one = told[str(row.measure)]
        for when in ("before", "after"):
            is_, said = getattr(row, when), getattr(one, when)
            if abs(is_ - said) > TRUE * max(row.before, abs(is_)):
                message = f"the {row.measure} {when} is {is_:.6g} {row.measure.unit} with these counterweights, not {said:.6g}"
                raise Contradiction(f"measures[{k}].{when}", message)
    return rows


# --- the page ----------------------------------------------------------------------------------------------------------------


def stored_study(record: BalanceRecord, file: ProblemFile, _: Path) -> StoredStudy:
    """Build the report of a stored balancing result.

    Parameters
    ----------
    record : BalanceRecord
    file : ProblemFile
        The problem that was solved.

    Raises
    ------
    InputError
        If the record is damaged or its measures differ from those of its counterweights.
    """
    found = read(record, file)
    shown = balance_tables.balance(found)
    sections = list(figures_of(shown.parts, "Balance and proof"))
    if found.trade is not None and len(found.trade.points) > 1:
        sections.append(PageSection("Trade-off", chart_plotly.charts(trade_off(found))))
    if found.heavier is not None:
        sections.append(PageSection("Before and after", chart_plotly.charts(courses(found))))
    return StoredStudy(
        problem=file,
        kind="balance",
        verdict=VERDICTS[found.status] if found.valid or found.status == "infeasible" else "Not valid",
        valid=found.valid,
        conclusion=conclusions.balance(found),
        status=shown.status.lines,
        sections=sections,
        moving=still if found.balanced is None else turning(found.balanced, {}),
        by=f"a convex programme, {found.solver}; verified by the inverse dynamics of the balanced machine",
        drawn="The balanced machine: rings mark the centroids of its bodies with their counterweights.",
        after=1,
    )
