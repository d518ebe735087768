"""HTML sections of a balancing result, checked against inverse dynamics when it is read."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.counterweights import BalanceMeasure, quantities, quantities_of
from optlink.dynamics.inertia import Parameters
from optlink.dynamics.machine import Machine
from optlink.problem.file import ProblemFile
from optlink.problem.machine.balance import BalanceSection, read_measure
from optlink.problem.quantity import Unusable
from optlink.report.html import chart_plotly
from optlink.report.html.shell import Section
from optlink.report.stored.reader import Record
from optlink.report.stored.stored_study import Studied, figures_of, still, turning
from optlink.report.views import balance_tables
from optlink.report.views.balance import courses, trade_off
from optlink.tasks.balance import balanced_problem
from optlink.tasks.machine import machine_of, motion_range, table_angles
from optlink.tasks.results.balance import (
    SCHEMA,
    ActiveLimit,
    AddedCounterweight,
    Balance,
    FittedSpring,
    MeasureChange,
    RelaxedLimit,
    TradeOff,
    TradePoint,
)

__all__ = ["SCHEMA", "studied"]

Array = NDArray[np.float64]
TRUE = 1e-6  # relative tolerance of stored measures, as a share of the value before balancing
VERDICTS = {
    "optimal": "Optimal: no counterweights within the limits do better",
    "relaxed": "Near the proven bound",
    "infeasible": "No counterweights meet all limits",
    "stalled": "Not proven",
}


# --- reading -----------------------------------------------------------------------------------------------------------------


def read(record: Record, file: ProblemFile) -> Balance:
    """Read a stored balancing result and recompute its measures from its counterweights.

    Parameters
    ----------
    record : Record
    file : ProblemFile
        The problem that was solved.

    Raises
    ------
    InputError
        If the record is damaged or its measures differ from those of its counterweights.
    """
    section = file.model.balance
    if section is None or record.text("status") not in VERDICTS:
        raise record.fault("status", "no balance ends so, or its problem asks for none", record.text("status"))
    machine, speed = machine_of(file), record.number("speed_rad_s")
    start = file.model.drive.start.value
    ranges, low, high = motion_range(file, machine, start)
    angles = table_angles(start, low, high, speed, ranges.full, section.positions, None)
    angles = angles[:-1] if ranges.full else angles
    about = record.numbers("moment_about_m", 2)
    added, springs = _parts(record, section, machine)
    balanced = balanced_problem(file, machine, added, springs) if record.records("measures") else None
    heavier = None if balanced is None else machine_of(balanced)
    return Balance(
        problem=file,
        goal=_goal(record, section),
        status=record.text("status"),
        machine=machine,
        angles=angles,
        speed=speed,
        about=(float(about[0]), float(about[1])),
        before=record.number("before"),
        objective=record.maybe("objective"),
        lower=record.maybe("lower_bound"),
        gap=record.maybe("duality_gap"),
        slack=record.number("above_bound"),
        added=added,
        springs=springs,
        balanced=balanced,
        heavier=heavier,
        rows=() if heavier is None else _rows(record, machine, heavier, angles, speed, about),
        disagreement=record.number("disagreement") if record.has("disagreement") else math.inf,
        limits=tuple(_held(one) for one in record.records("limits")),
        conflict=tuple(_relaxed(one) for one in record.records("conflict")),
        trade=_trade(record.record("trade")) if record.has("trade") else None,
        notes=record.texts("notes"),
        solver=record.text("solver"),
        iterations=record.whole("iterations"),
        exact=record.flag("exact_least_squares"),
        excess=0.0 if record.flag("valid") else math.inf,
        seconds=record.figures("seconds"),
    )


def _goal(record: Record, section: BalanceSection) -> tuple[tuple[BalanceMeasure, float], ...]:
    """Return the minimised measures with weights: those of the problem, or the single measure of `--minimise`."""
    goal = section.goal
    told = record.text("measure")
    if len(goal) > 1 and " + " in told:
        return goal
    return ((_measure(record, "measure"), 1.0),)


def _measure(record: Record, key: str) -> BalanceMeasure:
    try:
        return read_measure(record.text(key))
    except Unusable as error:
        raise record.fault(key, error.message, record.text(key)) from None


def _parts(
    record: Record, section: BalanceSection, machine: Machine
) -> tuple[tuple[AddedCounterweight, ...], tuple[FittedSpring, ...]]:
    """Read the optimal counterweights and springs."""
    weights, free = section.build(machine)
    added, springs = [], []
    for one in record.records("counterweights"):
        asked = next((weight for weight in weights if weight.body == one.text("body")), None)
        if asked is None or not one.number("mass_kg") > 0.0:
            raise one.fault("body", "the problem has no such counterweight", one.text("body"))
        along, across = (one.number(f"first_moment_{way}_kg_m") for way in ("along", "across"))
        moment = one.number("moment_of_inertia_about_start_kg_m2")
        added.append(AddedCounterweight(asked, Parameters(one.number("mass_kg"), along, across, moment)))
    for one in record.records("springs"):
        spring = next((spring for spring in free if spring.name == one.text("name")), None)
        if spring is None:
            raise one.fault("name", "the problem has no such spring", one.text("name"))
        springs.append(FittedSpring(spring, one.number("stiffness_N_m"), one.number("free_length_m")))
    return tuple(added), tuple(springs)


def _rows(
    record: Record, machine: Machine, heavier: Machine, angles: Array, speed: float, about: Array
) -> tuple[MeasureChange, ...]:
    """Recompute all measures before and after balancing by inverse dynamics; raise if the record differs."""
    asked = quantities(machine)
    place = (float(about[0]), float(about[1]))
    both = [quantities_of(one.moving(angles, speed), asked, place) for one in (machine, heavier)]
    rows = []
    for quantity, old, new in zip(asked, *both, strict=True):
        for how in ("rms", "largest"):
            measure = BalanceMeasure(quantity.kind, how, quantity.joint, quantity.on)
            rows.append(MeasureChange(measure, measure.value(old), measure.value(new)))
    told = {one.text("name"): one for one in record.records("measures")}
    for row in rows:
        one = told.get(str(row.measure))
        if one is None:
            raise record.fault("measures", f"the {row.measure} is missing")
        for when in ("before", "after"):
            is_, said = getattr(row, when), one.number(when)
            if abs(is_ - said) > TRUE * max(row.before, abs(is_)):
                message = f"the {row.measure} {when} is {is_:.6g} {row.measure.unit} with these counterweights, not {said:.6g}"
                raise one.fault(when, message)
    return tuple(rows)


def _held(record: Record) -> ActiveLimit:
    texts = {name: record.text(name) for name in ("name", "sense", "unit")}
    numbers = {name: record.number(name) for name in ("bound", "value", "price", "step", "buys")}
    return ActiveLimit(**texts, **numbers, active=record.flag("active"))  # type: ignore[arg-type]


def _relaxed(record: Record) -> RelaxedLimit:
    alone = record.maybe("alone")
    texts = {name: record.text(name) for name in ("name", "sense", "unit")}
    bound, together = record.number("bound"), record.number("together")
    return RelaxedLimit(**texts, bound=bound, alone=math.inf if math.isnan(alone) else alone, together=together)


def _trade(record: Record) -> TradeOff:
    before = record.numbers("before", 2)
    knee = record.whole("knee") if record.has("knee") else None
    points = tuple(_trade_point(one) for one in record.records("points"))
    if not points or (knee is not None and not 0 <= knee < len(points)):
        raise record.fault("points", "there are none, or the knee is none of them")
    pair = (float(before[0]), float(before[1]))
    seconds = record.number("first_point_s"), record.maybe("further_point_s")
    if not all(value > 0.0 for value in (*pair, seconds[0])):
        key = "before" if seconds[0] > 0.0 else "first_point_s"
        raise record.fault(key, "this is not above zero")
    return TradeOff(_measure(record, "first"), _measure(record, "second"), pair, points, knee, *seconds)


def _trade_point(record: Record) -> TradePoint:
    made = record.numbers("made", 2)
    first, second, gap = (record.number(name) for name in ("first", "second", "gap"))
    pair = (float(made[0]), float(made[1]))
    return TradePoint(first, second, gap, record.maybe("rate"), pair, record.number("disagreement"), record.figures("masses"))


# --- the page ----------------------------------------------------------------------------------------------------------------


def studied(record: Record, file: ProblemFile) -> Studied:
    """Build the report of a stored balancing result.

    Parameters
    ----------
    record : Record
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
        sections.append(Section("Trade-off", chart_plotly.charts(trade_off(found))))
    if found.heavier is not None:
        sections.append(Section("Before and after", chart_plotly.charts(courses(found))))
    return Studied(
        problem=file,
        kind="balance",
        verdict=VERDICTS[found.status] if found.valid or found.status == "infeasible" else "Not valid",
        valid=found.valid,
        status=shown.status.lines,
        sections=sections,
        moving=still if found.balanced is None else turning(found.balanced, {}),
        by=f"a convex programme, {found.solver}; verified by the inverse dynamics of the balanced machine",
        drawn="The balanced machine: rings mark the centroids of its bodies with their counterweights.",
        after=1,
    )
