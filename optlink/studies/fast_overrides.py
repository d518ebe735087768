"""Change numbers in the model of a problem without reading the file again, ten times faster for thousands of points.

Valid only between values that were read and checked; results must equal those of `ProblemFile.override`.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from pydantic import BaseModel

from optlink.linkage.vector2d import Value
from optlink.problem.design import DesignProblem
from optlink.problem.file import SIDES
from optlink.problem.interval import Interval
from optlink.problem.quantity import Quantity
from optlink.studies.grid import Axis
from optlink.units import factor

M = TypeVar("M", bound=BaseModel)
Setter = Callable[[Any, float], Any]
"""(what a field holds, value [SI]) -> what it holds then"""

_FIELDS = {"from": "start"}  # fields of the requirement with a different key in the file


def copy_model(model: M, **update: object) -> M:
    """Return a copy of a checked model with other fields, without values cached from the old ones."""
    copy = model.model_copy(update=update)
    for name in set(vars(copy)) - set(type(copy).model_fields):
        del vars(copy)[name]
    return copy


class FastOverride:
    """Sets values of axes in the model of a problem; `possible` states whether all of them are plain numbers of the model."""

    def __init__(self, template: DesignProblem, axes: Sequence[Axis]) -> None:
        linked = bool(template.links)  # their values would have to follow
        self.template, self.places = template, [None if linked else _place(template, axis) for axis in axes]

    @property
    def possible(self) -> bool:
        """Whether every axis is a number of a section."""
        return all(place is not None for place in self.places)

    def model(self, values: Sequence[Value]) -> DesignProblem:
        """Return the model at values in the units of the axes, floats or arrays (points,)."""
        sections: dict[str, dict[str, Any]] = {}
        for place, value in zip(self.places, values, strict=True):
            assert place is not None
            section, name, setter, size = place
            changes = sections.setdefault(section, {})
            changes[name] = setter(changes.get(name, getattr(getattr(self.template, section), name)), value * size)
        return copy_model(self.template, **{s: copy_model(getattr(self.template, s), **fields) for s, fields in sections.items()})


def _place(template: DesignProblem, axis: Axis) -> tuple[str, str, Setter, float] | None:
    """Return section, field, setter, and SI units per unit of the axis."""
    section, *rest = axis.key.split(".")
    side = rest.pop() if rest and rest[-1] in SIDES else ""
    if section not in ("mechanism", "limits", "requirement") or not rest:
        return None
    name, *path = _FIELDS.get(rest[0], rest[0]), *rest[1:]
    value = getattr(getattr(template, section), name, None)
    for key in path:
        value = _inside(value, key)
    if isinstance(value, Quantity) and value.free == bool(side):
        setter = _bound(side) if side else (lambda q, v: replace(q, value=v))
        return section, name, _nested(path, setter), factor(axis.unit, value.kind)
    if isinstance(value, Interval) and not path:
        side = "max" if name == "pressure_angle" else side
        return section, name, _limit(side), factor(axis.unit, value.kind) if value.kind else 1.0
    return None


_PLACES = {"x": 0, "y": 1, "along": 0, "across": 1}  # coordinates in a place


def _inside(value: Any, key: str) -> Any:
    """Return an entry of a table, a section or a place; None if there is none."""
    if isinstance(value, tuple):
        return value[_PLACES[key]] if key in _PLACES else None
    return value.get(key) if isinstance(value, dict) else getattr(value, key, None)


def _nested(path: Sequence[str], setter: Setter) -> Setter:
    """Return a function that sets an entry of a nested table, and copies what contains it."""
    if not path:
        return setter
    key, inner = path[0], _nested(path[1:], setter)

    def outer(value: Any, number: float) -> Any:
        entry = inner(_inside(value, key), number)
        if isinstance(value, tuple):
            return tuple(entry if k == _PLACES[key] else part for k, part in enumerate(value))
        return {**value, key: entry} if isinstance(value, dict) else copy_model(value, **{key: entry})

    return outer


def _bound(side: str) -> Setter:
    return lambda q, v: replace(q, low=v) if side == "min" else replace(q, high=v)


def _limit(side: str) -> Setter:
    if not side:
        return lambda i, v: replace(i, low=v, high=v)
    return lambda i, v: replace(i, low=v) if side == "min" else replace(i, high=v)
