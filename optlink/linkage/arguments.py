"""Public kinematics: arguments are checked once, here; the formulas inside take numbers, arrays and symbols unchecked."""

import functools
import inspect
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from numbers import Real
from types import MappingProxyType
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from optlink.errors import Fault, InputError, UnknownName, nearest
from optlink.io import without
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.motion import Motion, sweep as sweep_unchecked
from optlink.linkage.stroke import Ranges, Travel, reachable as reachable_unchecked, travels as travels_unchecked
from optlink.linkage.vector2d import Array, Value, all_finite

P = ParamSpec("P")
R = TypeVar("R")


def bind(
    name: str,
    signature: inspect.Signature,
    args: Sequence[object],
    kwargs: Mapping[str, object],
    elsewhere: Mapping[str, str] = MappingProxyType({}),
) -> inspect.BoundArguments:
    """Return the arguments of a call of the function `name`; `elsewhere`: remedies by names that belong to another function.

    Raises
    ------
    InputError
        If they are not those of the function.
    """
    try:
        return signature.bind(*args, **kwargs)
    except TypeError:
        raise InputError(_faults_of_call(name, signature, args, kwargs, elsewhere)) from None


def called(function: Callable[P, R], elsewhere: Mapping[str, str] = MappingProxyType({})) -> Callable[P, R]:
    """Refuse unknown and missing arguments of a function in a sentence, see `bind`; it checks their values itself."""
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        bind(function.__name__, signature, args, kwargs, elsewhere)
        return function(*args, **kwargs)

    return call


def _faults_of_call(
    function: str,
    signature: inspect.Signature,
    args: Sequence[object],
    kwargs: Mapping[str, object],
    elsewhere: Mapping[str, str],
) -> list[Fault]:
    """Return the faults of a call whose arguments are not those of the function: unknown, given twice, too many, or missing."""
    parameters = without(signature.parameters, "self")
    names, count = list(parameters), len(args) - (len(parameters) < len(signature.parameters))
    places = sum(parameter.kind is not inspect.Parameter.KEYWORD_ONLY for parameter in parameters.values())
    remedy = f"Known: {', '.join(names)}"
    unknown = [
        Fault(f"unknown argument of {function}", elsewhere.get(name) or nearest(name, names), key=name, value=value)
        for name, value in kwargs.items()
        if name not in parameters
    ]
    twice = [Fault(f"given twice to {function}", "Give it once", key=name) for name in names[:count] if name in kwargs]
    other = next(iter(elsewhere.values()), remedy)
    most = f"at most {places} arguments" if places else "no argument"
    many = [Fault(f"{function} takes {most} without a name", other)] if count > places else []
    missing = [
        Fault(f"{function} needs this argument", remedy, key=name)
        for name in names[count:]
        if name not in kwargs and parameters[name].default is inspect.Parameter.empty
    ]
    return [*unknown, *twice, *many] or missing


def check_number(name: str, value: Any) -> float:
    """Return a finite number.

    Raises
    ------
    InputError
        If it is none.
    """
    if not isinstance(value, Real) or isinstance(value, bool) or not math.isfinite(value):
        message = "not a finite number" if isinstance(value, float) else "not a number"
        raise InputError(message, "Give one in SI units, for example 0.5", key=name, value=value)
    return float(value)


def check_length(name: str, value: Any) -> float:
    """Return a length: a positive finite number [m].

    Raises
    ------
    InputError
        If it is none.
    """
    length = check_number(name, value)
    if length <= 0.0:
        raise InputError("a length must be positive", "Give it in metres, above 0", key=name, value=value)
    return length


def check_flag(name: str, value: Any) -> None:
    """Refuse what is neither True nor False.

    Raises
    ------
    InputError
        If it is anything else.
    """
    if not isinstance(value, bool | np.bool_):
        raise InputError("neither True nor False", "Give one of them", key=name, value=value)


def check_side(side: Any) -> None:
    """Refuse a side that is no assembly mode.

    Raises
    ------
    InputError
        If it is neither +1 nor -1.
    """
    if isinstance(side, bool) or not isinstance(side, Real) or side not in (1, -1):
        raise InputError("not an assembly mode", "Give 1 or -1", key="side", value=side)


def check_point_names(points: Iterable[str], taken: Collection[str]) -> tuple[str, ...]:
    """Return the names of further points, none of which the linkage itself has `taken`.

    Raises
    ------
    InputError
        If one is no name, is taken, or is given twice.
    """
    listed = isinstance(points, Iterable) and not isinstance(points, str)
    names = tuple(points) if listed else ()
    if not listed or not all(isinstance(name, str) and name for name in names):
        raise InputError("not a list of names", 'Give a list, also of one name, for example ["P"]', key="points", value=points)
    for name in names:
        if name in taken or names.count(name) > 1:
            message = "a name of the four-bar itself" if name in taken else "a name that is given twice"
            raise InputError(message, "Choose another", key="points", value=name)
    return names


def check_array(name: str, value: Any) -> Array:
    """Return an array of finite numbers.

    Raises
    ------
    InputError
        If it is none.
    """
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "iuf" or not all_finite(array):
            raise ValueError
    except (TypeError, ValueError):
        raise InputError("not a finite number or array", "Give numbers in SI units", key=name, value=value) from None
    return array.astype(float)


def check_instance(name: str, value: Any, kind: type[Any], what: str, example: str) -> None:
    """Refuse what is not an object of a class, in words `what` it is.

    Raises
    ------
    InputError
        If it is anything else.
    """
    if not isinstance(value, kind):
        raise InputError(f"not a {what}", f"Give one, for example {example}", key=name, value=value)


def check_mechanism(mechanism: Any) -> None:
    """Refuse what is not a mechanism, or has a group in no assembly mode.

    Raises
    ------
    InputError
        If it is anything else.
    """
    check_instance("mechanism", mechanism, Mechanism, "mechanism", "optlink.linkage.four_bar()")
    for group in mechanism.groups:
        check_side(getattr(group, "side", 1))


@called
def sweep(
    mechanism: Mechanism,
    sizes: Mapping[str, ArrayLike],
    crank_angle: ArrayLike,
    speed: ArrayLike = 1.0,
    acceleration: ArrayLike = 0.0,
) -> Motion:
    """Compute the motion of a mechanism over crank angles, by default at constant crank speed.

    Parameters
    ----------
    mechanism : Mechanism
    sizes : mapping of parameter name to float or array (designs, 1) [m, rad]
        Every one of `mechanism.parameters` and no other; lengths are positive.
    crank_angle : array (angles,) [rad]
    speed : float or array (angles,) [rad/s], positive counter-clockwise
    acceleration : float or array (angles,) [rad/s^2]

    Returns
    -------
    Motion
        NaN where the mechanism cannot be assembled (see `Motion.margin`).

    Raises
    ------
    InputError
        If a size is missing, unknown or not positive, a number is not finite, or shapes do not match.

    Examples
    --------
    >>> sizes = {"crank": 0.1, "coupler": 0.4, "rocker": 0.25, "frame": 0.5}  # [m]
    >>> motion = optlink.linkage.sweep(optlink.linkage.four_bar(), sizes, np.radians([0.0, 90.0]), speed=10.0)
    >>> motion.body_rate("rocker").round(3)  # [rad/s]
    array([-2.5  ,  3.884])
    """
    check_mechanism(mechanism)
    values = check_sizes(mechanism, sizes)
    angles = check_array("crank_angle", crank_angle)
    rate, change = _value("speed", speed), _value("acceleration", acceleration)
    for name, value in {
        **{f"sizes.{name}": size for name, size in values.items()},
        "speed": rate,
        "acceleration": change,
    }.items():
        try:
            np.broadcast_shapes(np.shape(value), np.atleast_1d(angles).shape)
        except ValueError:
            remedy = "Give a number, one value per crank angle, or designs in a column: shape (designs, 1)"
            raise InputError(f"its shape {np.shape(value)} does not match that of crank_angle", remedy, key=name) from None
    return sweep_unchecked(mechanism, values, angles, rate, change)


def _value(name: str, value: Any) -> Value:
    array = check_array(name, value)
    return array if array.ndim else float(array)


def check_sizes(mechanism: Mechanism, sizes: Any) -> dict[str, Value]:
    """Return the sizes of a mechanism as numbers and arrays.

    Raises
    ------
    InputError
        If one is missing, unknown, not finite, or a length that is not positive.
    """
    if not isinstance(sizes, Mapping):
        raise InputError("not a mapping of names to values", "Give SI values by name", key="sizes", value=sizes)
    needed = mechanism.parameters
    own = {value for group in mechanism.groups for value in vars(group).values() if isinstance(value, str)}  # of other dyads
    for name in sizes:
        if name not in needed and name not in own:
            raise UnknownName("the mechanism has no such size", nearest(str(name), needed), key=f"sizes.{name}")
    if missing := [name for name in needed if name not in sizes]:
        raise InputError(f"missing: {', '.join(missing)}", "Give SI values of all sizes by name", key="sizes")
    values = {name: _value(f"sizes.{name}", size) for name, size in sizes.items()}
    for name in mechanism.lengths:
        if np.any(values[name] <= 0.0):
            raise InputError("a length must be positive", "Give it in metres, above 0", key=f"sizes.{name}", value=sizes[name])
    return values


def check_design(mechanism: Any, sizes: Any) -> dict[str, float]:
    """Return the sizes of one design of a mechanism as numbers.

    Raises
    ------
    InputError
        As `check_mechanism` and `check_sizes`; if a size is an array.
    """
    check_mechanism(mechanism)
    values = check_sizes(mechanism, sizes)
    return {name: check_number(f"sizes.{name}", value) for name, value in values.items()}


@called
def reachable(mechanism: Mechanism, sizes: Mapping[str, float]) -> Ranges:
    """Compute the ranges in which the crank can turn, to machine precision.

    Parameters
    ----------
    mechanism : Mechanism
    sizes : mapping of parameter name to float [m, rad]
        Every one of `mechanism.parameters` and no other; lengths are positive.

    Returns
    -------
    Ranges
        `ranges` [rad], and `full` if the crank turns fully.

    Raises
    ------
    InputError
        If a size is missing, unknown, not a finite number, or a length that is not positive.

    Examples
    --------
    >>> sizes = {"crank": 0.3, "coupler": 0.4, "rocker": 0.25, "frame": 0.5}  # [m]
    >>> found = optlink.linkage.reachable(optlink.linkage.four_bar(), sizes)
    >>> found.full, np.degrees(found.ranges).round(2)  # [deg]
    (False, array([[254.04, 465.96]]))
    """
    return reachable_unchecked(mechanism, check_design(mechanism, sizes))


@called
def travels(
    mechanism: Mechanism, sizes: Mapping[str, float], low: float, high: float, full: bool
) -> tuple[dict[str, Travel], dict[str, Travel]]:
    """Compute the limited motions of swinging bodies, and of sliders (by guide), over a range of crank angles.

    Parameters
    ----------
    mechanism : Mechanism
    sizes : mapping of parameter name to float [m, rad]
        Every one of `mechanism.parameters` and no other; lengths are positive.
    low, high : float [rad]
        Range of the crank angle; one cycle if `full`.
    full : bool
        Whether the crank turns fully.

    Returns
    -------
    swings : mapping of body to Travel
        Bodies that turn fully or do not turn are omitted.
    strokes : mapping of guide to Travel

    Raises
    ------
    InputError
        If a size is missing, unknown, not a finite number, or a length that is not positive; if the range is empty.

    Examples
    --------
    >>> sizes = {"crank": 0.1, "coupler": 0.4, "rocker": 0.25, "frame": 0.5}  # [m]
    >>> swings, _ = optlink.linkage.travels(optlink.linkage.four_bar(), sizes, 0.0, 2.0 * np.pi, True)
    >>> float(np.degrees(swings["rocker"].span).round(2))  # [deg]
    48.4
    """
    values = check_design(mechanism, sizes)
    if check_number("high", high) <= check_number("low", low):
        raise InputError("the range of the crank angle is empty", f"Give one above low = {low:g}", key="high", value=high)
    check_flag("full", full)
    return travels_unchecked(mechanism, values, low, high, full)
