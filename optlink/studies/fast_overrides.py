"""The model of a problem with other numbers, without reading the file again: ten times faster, for thousands of points.

Only for numbers between values that were read and checked; `ProblemFile.override` is what a result must equal.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from pydantic import BaseModel

from optlink.problem.file import SIDES
from optlink.problem.function import DesignProblem
from optlink.problem.quantity import Interval, Quantity
from optlink.studies.grid import Axis
from optlink.units import factor

M = TypeVar("M", bound=BaseModel)
Setter = Callable[[Any, float], Any]
"""(what a field holds, value [SI]) -> what it holds then"""

_FIELDS = {"from": "start"}  # of the requirement, where the file's key is another


def fresh(model: M, **update: object) -> M:
    """A copy of a checked model with other fields, and nothing that was derived from the old ones."""
    copy = model.model_copy(update=update)
    for name in set(vars(copy)) - set(type(copy).model_fields):
        del vars(copy)[name]
    return copy


class Direct:
    """Puts values of axes into the model of a problem; `possible` says whether all of them are plain numbers of it."""

    def __init__(self, template: DesignProblem, axes: Sequence[Axis]) -> None:
        self.template, self.places = template, [_place(template, axis) for axis in axes]

    @property
    def possible(self) -> bool:
        """Whether every axis is a number of a section."""
        return all(place is not None for place in self.places)

    def model(self, values: Sequence[float]) -> DesignProblem:
        """The model at values in the units of the axes."""
        sections: dict[str, dict[str, Any]] = {}
        for place, value in zip(self.places, values, strict=True):
            assert place is not None
            section, name, setter, size = place
            known = sections.setdefault(section, {})
            known[name] = setter(known.get(name, getattr(getattr(self.template, section), name)), value * size)
        return fresh(self.template, **{s: fresh(getattr(self.template, s), **fields) for s, fields in sections.items()})


def _place(template: DesignProblem, axis: Axis) -> tuple[str, str, Setter, float] | None:
    """Section, field, how a value is put there, and SI units in one of the axis."""
    section, *rest = axis.key.split(".")
    side = rest.pop() if rest and rest[-1] in SIDES else ""
    if section not in ("mechanism", "limits", "requirement") or len(rest) != 1:
        return None
    name = _FIELDS.get(rest[0], rest[0])
    held = getattr(getattr(template, section), name, None)
    if isinstance(held, Quantity) and held.free == bool(side):
        setter = _bound(side) if side else (lambda q, v: replace(q, value=v))
        return section, name, setter, factor(axis.unit, held.kind)
    if isinstance(held, Interval):
        return section, name, _limit(side), factor(axis.unit, held.kind) if held.kind else 1.0
    return None


def _bound(side: str) -> Setter:
    return lambda q, v: replace(q, low=v) if side == "min" else replace(q, high=v)


def _limit(side: str) -> Setter:
    if not side:
        return lambda i, v: replace(i, low=v, high=v)
    return lambda i, v: replace(i, low=v) if side == "min" else replace(i, high=v)
