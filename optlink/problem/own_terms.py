"""Objectives and limits of one's own, from a function in a script or in a cell of a notebook."""

import inspect
import math
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from optlink.errors import InputError, OptlinkError, nearest
from optlink.io import register
from optlink.linkage.vector2d import Value
from optlink.problem.arguments import typed
from optlink.problem.terms import Measure, QuantityType
from optlink.units import KINDS, kind_of_unit, measures

Formula: TypeAlias = Callable[..., Value]
"""Function of a machine at one position, and of its reactions if it takes two arguments: a value [SI], elementwise."""
OWN: dict[str, QuantityType] = {}
"""Quantities that a decorator has registered: a cell that runs again replaces its own."""


@dataclass(frozen=True)
class OwnTerm:
    """A function as objective or limit of machines; it can still be called.

    Parameters
    ----------
    formula : function of (machine in motion) or (machine in motion, reactions)
        Returns the value at one position [SI].
    changes : mapping of str to any
        Changes of a problem that make it the objective or a limit, for `optlink.load` and `ProblemFile.override`.
    """

    formula: Formula
    changes: Mapping[str, Any] = field(repr=False)

    def __call__(self, *arguments: Any) -> Value:
        """Return the value of the function."""
        return self.formula(*arguments)


@typed
def objective(*, unit: str = "", measure: Measure = "peak") -> Callable[[Formula], OwnTerm]:
    """Make a function an objective: a decorator for a cell or a script.

    Parameters
    ----------
    unit : str, optional
        Unit in which the value is shown; the function returns SI. Default: a plain number.
    measure : str, optional
        How the values over the cycle become one: "peak" (largest amount), "rms", "mean", "largest" or "least".

    Returns
    -------
    function
        Decorator of a function of the machine in motion at one position, or of that and the reactions.

    Raises
    ------
    InputError
        If the unit is unknown, or optlink has a quantity of that name.

    Examples
    --------
    >>> @optlink.objective(unit="N m", measure="rms")
    ... def drive_torque(machine, reactions):
    ...     return reactions.torque
    >>> problem = optlink.load("shaper-design", drive_torque.changes)
    >>> problem.raw["objective"]
    {'quantity': 'drive torque', 'measure': 'rms'}
    """
    kind = _kind(unit)

    def decorated(formula: Formula) -> OwnTerm:
        name = _registered(formula, kind)
        return OwnTerm(formula, {"objective": {"quantity": name, "measure": measure}})

    return decorated


@typed
def limit(*, unit: str = "", max: float | str | None = None, min: float | str | None = None) -> Callable[[Formula], OwnTerm]:
    """Make a function a limit over the cycle: a decorator for a cell or a script.

    Parameters
    ----------
    unit : str, optional
        Unit of `max` or `min`; the function returns SI. Default: a plain number.
    max, min : float or str, optional
        Bound of its largest or of its least value, in that unit, or with its own one, such as "30 mm"; one of them.

    Returns
    -------
    function
        Decorator of a function of the machine in motion at one position, or of that and the reactions.

    Raises
    ------
    InputError
        If not one bound is given, the unit is unknown, or optlink has a quantity of that name.

    Examples
    --------
    >>> @optlink.limit(unit="m/s", max=3.5)
    ... def ram_speed(machine):
    ...     return machine.slides["F"][1]
    >>> ram_speed.changes
    {'limits.ram_speed': {'quantity': 'ram speed', 'measure': 'largest', 'max': '3.5 m/s'}}
    """
    bounds = {side: value for side, value in (("max", max), ("min", min)) if value is not None}
    if len(bounds) != 1:
        raise InputError("a limit has one bound", "Give max or min; for both decorate two functions", key="max, min")
    (side, value), measure = *bounds.items(), "largest" if max is not None else "least"
    kind, bound = _kind(unit), value if isinstance(value, str) else f"{value!r} {unit}" if unit else value
    if not (measures(bound, kind) if isinstance(bound, str) else math.isfinite(bound)):
        remedy = f'Give a number in {unit}, or a text with its unit, such as "45 {unit}"' if unit else "Give one such as 45"
        raise InputError("not a finite value of this kind", remedy, key=side, value=value)

    def decorated(formula: Formula) -> OwnTerm:
        name = _registered(formula, kind)
        return OwnTerm(formula, {f"limits.{formula.__name__}": {"quantity": name, "measure": measure, side: bound}})

    return decorated


def _kind(unit: str) -> str:
    """Return the kind of quantity of a unit; empty for a plain number."""
    kind = kind_of_unit(unit) if unit else ""
    if kind is None:
        remedy = f"Write one of {', '.join(dict.fromkeys(one.display for one in KINDS.values() if one.display))}"
        raise InputError(f'"{unit}" is not a unit', remedy, key="unit", value=unit)
    return kind


def _value(formula: Formula, *arguments: Any) -> Value:
    """Return the value of a function of the user; an error names the function, and its line that fails."""
    try:
        value = formula(*arguments)
        if isinstance(value, str | tuple | list | dict | None):
            given = "nothing" if value is None else f"a {type(value).__name__}"
            raise InputError(f"this function returns {given}", "Return one number", key=formula.__name__)
        return 0.0 + value
    except OptlinkError:
        raise
    except Exception as error:  # whatever a function of a user raises
        lines = [f" in line {frame.lineno}" for frame in traceback.extract_tb(error.__traceback__)[1:2]]
        text = str(error).partition("\n")[0].rstrip(".")
        message = f"this function cannot be evaluated{''.join(lines)}: {type(error).__name__}: {text}"
        remedy = "Return one number, computed by operators and functions of numpy from the motion and the reactions, without if"
        if isinstance(error, AttributeError) and error.name:
            remedy = nearest(error.name, [name for name in dir(error.obj) if not name.startswith("_")])
        if isinstance(error, KeyError):
            moving = arguments[0]
            names = [*moving.machine.mechanism.bodies, *moving.pose.points, *moving.slides]
            message, remedy = message.replace("KeyError:", "the machine has no"), nearest(str(error.args[0]), names)
        raise InputError(message, remedy, key=formula.__name__) from error


def _registered(formula: Formula, kind: str) -> str:
    """Register a function as a quantity and return its name, which is that of the function with spaces."""
    if not getattr(formula, "__name__", "").isidentifier():  # its name is that of the quantity
        raise InputError("only a function with a name can be an objective or a limit", "Define it with def", value=formula)
    name, forces = formula.__name__.replace("_", " "), len(inspect.signature(formula).parameters) > 1
    if QuantityType.registry.get(name) not in (None, OWN.get(name)):
        raise InputError("optlink has a quantity of this name", "Give the function another one", key=formula.__name__)
    quantity = QuantityType(
        name,
        kind,
        ("peak", "rms", "mean", "largest", "least"),
        signal=lambda moving, reactions, _: (_value(formula, moving, *[reactions] * forces),),
        history=lambda record, _: record.full(_value(formula, record.moving, *[record.reactions for _ in range(forces)])),
        forces=forces,
    )
    QuantityType.registry.pop(name, None)
    register(quantity)
    OWN[name] = quantity
    return name
