"""The numbers of a programme: its scaling, parameters and bounds. Problems that differ in these alone share what is built.

Dimensions are parameters of a programme; bounds of dimensions, and limits of transmission and pressure angles, are bounds of
its variables and rows. All other numbers are in its formulas, also the unit of length, which the targets or a fixed link have:
another frame of a four-bar with a law has other formulas. A programme that is used again gives the same results, to the last
digit, as one that is built anew.
"""

import dataclasses
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import BaseModel

from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP, Variable, boxed, scaled_variable
from optlink.optimization.terms import PLAIN, ConstraintRow, millimetres, position_rows, rows as limit_rows
from optlink.problem.design import DesignProblem
from optlink.problem.limits import Reach, limits_in_file
from optlink.problem.mechanism import sizes_of
from optlink.problem.quantity import Interval, Quantity

SPAN = "requirement.span"
"""Name of the parameter that is the crank rotation of a law."""
TARGET = "target "
"""Beginning of the names of the parameters that are components of the targets."""
TEXTS = ("title", "source", "about", "expected", "report", "made")
"""Sections that no programme contains."""
ANGLES = ("transmission_angle", "pressure_angle")
"""Limits whose numbers are bounds of rows alone."""
MOST_KEPT = 8  # programmes that are kept


def path_variable(problem: DesignProblem, name: str) -> Variable:
    """Return the scaling of a quantity: lengths by the size of the problem, coordinates on the frame from the curve's centre."""
    if not problem.parts:
        periodic = problem.quantities[name].kind == "angle"
        return scaled_variable(problem, name, problem.longest, periodic=periodic)
    axis = name.rpartition(".")[2] if problem.quantities[name].kind == "coordinate" else ""
    origin = problem.centre["xy".index(axis)] if axis in ("x", "y") else 0.0
    return scaled_variable(problem, name, problem.size, periodic=problem.is_periodic(name), origin=origin)


def target_constants(problem: DesignProblem) -> list[Variable]:
    """Return the components of the targets as parameters: each row of `data.columns`, and the length of a radian of poses."""
    size = problem.size
    constants = []
    for k in range(len(problem.data.columns)):
        for axis, origin in zip("xy", problem.centre, strict=True):
            constants.append(Variable(f"{TARGET}{k}.{axis}", size, millimetres(size, origin), origin))
        if problem.requirement.kind == "motion":
            constants += [Variable(f"{TARGET}{k}.{part}", 1.0, PLAIN) for part in ("cosine", "sine")]
    if problem.requirement.kind == "motion":
        constants.append(Variable(f"{TARGET}radian", size, millimetres(size)))
    return constants


def constant_values(problem: DesignProblem, constants: Sequence[Variable]) -> list[Any]:
    """Return the scaled values of `NLP.constants`: fixed quantities, tolerances, the span of a law, components of the targets.

    They are arrays where the numbers of the problem are.
    """
    named: dict[str, Any] = sizes_of(problem.quantities) | problem.counted
    if any(v.name == SPAN for v in constants):
        named[SPAN] = problem.span
    if moving := [v.name for v in constants if v.name.startswith(TARGET)]:
        named |= zip(moving, [*problem.data.columns.ravel().tolist(), problem.radian], strict=False)
    return [v.scaled(named[v.name]) for v in constants]


# --- programmes built once ---------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Built:
    """A programme with the compiled functions of its last use, and its numbers as they were built."""

    nlp: NLP
    p: Array
    box: tuple[Array, Array, Array]  # start, lower and upper bounds of x


class _Kept(threading.local):
    """The last programmes of a thread by their formulas; their compiled functions have inputs and results of their own."""

    def __init__(self) -> None:
        self.programmes: dict[Any, _Built] = {}


_KEPT = _Kept()


def forget() -> None:
    """Drop the programmes that this thread has kept, for changes of the code that builds them."""
    _KEPT.programmes.clear()


def reused(problem: DesignProblem, direction: int, build: Callable[[], NLP]) -> NLP:
    """Return the programme that `build` builds for a problem, from one of the same formulas if this thread has kept one."""
    key = direction, formulas(problem)
    known = _KEPT.programmes.pop(key, None)
    rows = None if known is None else _with_angle_limits(problem, direction, known.nlp.rows)
    if known is None or rows is None:
        nlp = build()
        known = _Built(nlp, nlp.p.copy(), (nlp.x_start.copy(), nlp.x_low.copy(), nlp.x_high.copy()))
    else:
        start, low, high = (part.copy() for part in known.box)
        for k, name in enumerate(problem.free):
            low[k], high[k], start[k] = boxed(problem.quantities[name], known.nlp.variables[k])
        p = known.p.copy()
        p[1 : 1 + len(known.nlp.constants)] = constant_values(problem, known.nlp.constants)
        nlp = known.nlp.again(rows=rows, p=p, x_start=start, x_low=low, x_high=high)
        known = replace(known, nlp=nlp)
    _KEPT.programmes[key] = known
    if len(_KEPT.programmes) > MOST_KEPT:
        del _KEPT.programmes[next(iter(_KEPT.programmes))]
    return nlp


def _with_angle_limits(problem: DesignProblem, direction: int, rows: Sequence[ConstraintRow]) -> tuple[ConstraintRow, ...] | None:
    """Return rows with the bounds of the `ANGLES` of a problem; None if these are limits of other rows."""
    keys = tuple(f"limits.{name}" for name in ANGLES if getattr(problem.limits, name) is not None)
    if not keys:
        return tuple(rows)
    with np.errstate(all="ignore"):
        values = problem.complete({})
        own = [*limit_rows(problem, values, Reach(0.0, 1.0, direction), problem.size)]
        own += [] if problem.four_bar else position_rows(problem, problem.linkage.at(values, 0.0))
    bounds = {(row.limit, row.label): (row.low, row.high) for row in own if row.limit.startswith(keys)}
    if bounds.keys() != {(row.limit, row.label) for row in rows if row.limit.startswith(keys)}:
        return None
    ends = (bounds.get((row.limit, row.label), (row.low, row.high)) for row in rows)
    return tuple(replace(row, low=low, high=high) for row, (low, high) in zip(rows, ends, strict=True))


def formulas(problem: DesignProblem) -> tuple[Any, ...]:
    """Return all that decides on the formulas of a programme without ends of strokes: the file but for numbers of the programme.

    What follows from these and is in the formulas, such as the unit of length, is added.
    """
    quantities = problem.quantities
    numbers = {id(quantity) for quantity in quantities.values() if quantity.equals is None}
    numbers |= {id(getattr(problem.limits, name)) for name in ANGLES}
    sections = ((name, getattr(problem, name)) for name in type(problem).model_fields if name not in TEXTS)
    return (
        tuple((name, *_contents(section, numbers)) for name, section in sections),
        tuple((name, quantity.kind, quantity.status) for name, quantity in quantities.items()),
        tuple(path_variable(problem, name) for name in (*problem.fixed, *problem.free)),
        *_contents(problem.linkage, ()),
        *_contents(problem.deviations if problem.robust is not None else (), ()),
        *(item for part in problem.parts for item in _figures(part)),
        *(term for term, _ in limits_in_file(problem.limits)),
    )


def _figures(part: DesignProblem) -> Iterator[Any]:
    """Yield the numbers of a requirement that follow from others."""
    yield part.size, part.whole, part.worth, part.interval, part.unit, part.centre, part.closed
    yield from _contents(part.data, ())
    if part.law_given:
        yield part.span, part.travel
    if part.pointed:
        yield part.radian


def _contents(value: Any, numbers: Collection[int]) -> Iterator[Any]:
    """Yield what an object consists of, without the numbers of some quantities and intervals, given by their identities."""
    if id(value) in numbers and isinstance(value, Quantity):
        yield "a number"
    elif id(value) in numbers and isinstance(value, Interval):
        yield type(value), value.low is None, value.high is None, value.kind
        for joint, interval in getattr(value, "own", ()):
            yield joint, interval.low is None, interval.high is None
    elif isinstance(value, BaseModel):
        yield type(value)
        named = {name: getattr(value, name) for name in type(value).model_fields}
        yield from _contents(named | (value.model_extra or {}), numbers)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        yield type(value)
        yield from _contents([getattr(value, one.name) for one in dataclasses.fields(value)], numbers)
    elif isinstance(value, Mapping):
        yield len(value)
        for name, one in value.items():
            yield name
            yield from _contents(one, numbers)
    elif isinstance(value, list | tuple):
        yield len(value)
        for one in value:
            yield from _contents(one, numbers)
    elif isinstance(value, np.ndarray):
        yield value.shape, value.tobytes()
    else:
        yield repr(value) if isinstance(value, float) else value
