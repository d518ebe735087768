"""Laws of prescribed motions in a problem file: of a drive over the time, of a cam's follower over the cam angle."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from optlink.linkage.extrema import distinct, zeros
from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.laws import SEGMENTS, Law, MotionLaw, Segment, joined, paced, spline
from optlink.linkage.vector2d import TURN, Array, Value, max_magnitude
from optlink.problem.quantity import (
    Quantity,
    Unusable,
    below,
    check_keys,
    check_name,
    largest,
    range_example,
    read_fixed,
    read_scalar,
)
from optlink.problem.targets.expression import MOST_REVOLUTIONS, Expression, Wording, parse, period_of
from optlink.problem.targets.target_points import read_columns
from optlink.units import KINDS, factor, show

DEFAULT = "3-4-5"
"""Law of a motion that names none: the polynomial of fifth degree, as in VDI 2143 and most motion controllers."""
SHORTEST, LONGEST = 1e-6, 1e6  # s
CLOSED = 1e-9  # share of the travel by which the end of a law may miss its begin
STEEPEST = 1e12  # velocity and acceleration for a travel and a period of 1, above which they are infinite
EDGE = 1e-12  # share of the distance of two knots at which a limit is taken
SAMPLES = 2_001  # of an expression over its period
COLUMNS = {"angle": "angle", "length": "length", "coordinate": "slide"}
"""Name of the column of a CSV file, without its unit, by the kind of the driven coordinate."""
WORDING = Wording("law", "45*sin(2*pi*t)")


@dataclass(frozen=True)
class ExpressionLaw(MotionLaw):
    """A motion law `offset` + `factor` * expression of the time t [s]."""

    expression: Expression = field(kw_only=True)
    factor: Value = 1.0
    offset: Value = 0.0

    samples: ClassVar[int] = SAMPLES

    def scaled(self, factor: Value, offset: Value = 0.0) -> Self:
        """Return the law offset + factor * y(x)."""
        whole, advance = self.factor * factor, self.advance * factor
        return replace(self, factor=whole, offset=self.offset * factor + offset, advance=advance)

    def _inside(self, x: Value, order: int) -> Value:
        y = 0.0 * x + self.factor * self._derivative(x, order)
        return y if order else y + self.offset

    def _derivative(self, x: Value, order: int) -> Value:
        if order == 0:
            return self.expression({"t": x})
        if order <= 2:
            return as_jet(self.expression({"t": Jet(x, 1.0)})).parts[order]
        nested = as_jet(self.expression({"t": Jet(Jet(x, 1.0), Jet(1.0), Jet(0.0))}))  # a jet of jets: up to the fourth
        return as_jet(nested.acceleration).parts[order - 2]

    def _local(self, index: Any, u: Array, order: int) -> Array:
        knots, within = np.array(self.knots), np.clip(u, EDGE, 1.0 - EDGE)  # at a corner itself its side is left to rounding
        result: Array = self._inside(knots[index] + within * np.diff(knots)[index], order)
        return result


# The law of a drive.


def read_drive_law(raw: object, folder: Path, kind: str, *, start: float | None = None, unit: object = None) -> MotionLaw:
    """Read the law of a drive over the time [s]: segments, an expression of t or a CSV file with the columns time and its own.

    Parameters
    ----------
    raw : object
        Value of the key `law`.
    folder : Path
        Folder to which the names of files are relative.
    kind : str
        Of the driven coordinate: "angle", "length" (which stays positive) or "coordinate".
    start : float, optional
        Value [SI] at which segments begin. Default: their last one, so that the law is closed; for an angle less the whole
        revolutions that lie between it and 0.
    unit : object, optional
        Unit of an expression that is given without a table.

    Returns
    -------
    MotionLaw
        It repeats if it ends where it begins, or, for an angle, whole revolutions from there; else it rests at its ends.

    Raises
    ------
    Unusable
    """
    if isinstance(raw, list):
        return _checked(_read_segments(raw, kind, start), kind)
    if isinstance(raw, str) and raw.strip() not in SEGMENTS:
        return _checked(_read_expression({"expression": raw, "unit": unit}, kind, ""), kind)
    if isinstance(raw, dict) and "expression" in raw and "csv" in raw:
        raise Unusable("the law is given twice", "Give expression or csv, not both", "csv", raw["csv"])
    if isinstance(raw, dict) and "expression" in raw:
        return _checked(_read_expression(raw, kind, "expression"), kind)
    if isinstance(raw, dict) and "csv" in raw:
        return _checked(_read_samples(raw, folder, kind), kind)
    message = "the law of a drive is a list of motions, an expression of the time t or a CSV file"
    raise Unusable(message, f'Write [{{ time = "0.4 s", to = "{KINDS[kind].example}", law = "{DEFAULT}" }}, ...]', "", raw)


def _read_segments(raw: Sequence[object], kind: str, start: float | None) -> Law:
    segments, value = list[Segment](), start
    for row, part in enumerate(raw):
        with below(f"[{row}]"):
            table = _table(part, ("time", "to", "law"), f'{{ time = "0.4 s", to = "{KINDS[kind].example}" }}')
            if "time" not in table:
                raise Unusable("the segment has no duration", 'Add time = "0.4 s"', "time")
            time = read_scalar(table["time"], "time", "time")[0]
            if not SHORTEST <= time <= LONGEST:
                remedy = f"Give from {SHORTEST:g} to {LONGEST:g} s, and check its unit"
                raise Unusable("no motion has such a duration", remedy, "time", table["time"])
            to = read_scalar(table["to"], kind, "to")[0] if "to" in table else None
            name = _law_name(table, "to", to is not None, KINDS[kind].example)
            segments.append(Segment(time, to, name))
    ends = [segment.to for segment in segments if segment.to is not None]
    if not ends:
        remedy = f'Write [{{ time = "0.4 s", to = "{KINDS[kind].example}" }}, ...]'
        raise Unusable("the law has no motion", remedy, "", raw)
    if value is None:
        value = _first(ends[-1]) if kind == "angle" else ends[-1]
    law = joined(value, segments)
    return replace(law, **_repeated(law.advance, kind, np.ptp([value, *ends])))


def _first(angle: float) -> float:
    """Return an angle less the whole revolutions between it and 0."""
    return 0.0 if abs(angle - TURN * round(angle / TURN)) < CLOSED else math.fmod(angle, TURN)


def _repeated(advance: float, kind: str, travel: float) -> dict[str, Any]:
    """Return whether a law repeats that advances by `advance` in its period, and the advance without its rounding errors."""
    whole = TURN * round(advance / TURN) if kind == "angle" and abs(advance) <= 2.0 * largest(kind) else 0.0
    repeats = bool(abs(advance - whole) <= CLOSED * travel)
    return {"repeats": repeats, "advance": whole if repeats else advance}


def _read_expression(raw: Mapping[str, Any], kind: str, key: str) -> ExpressionLaw:
    check_keys(raw, ("expression", "unit", "period", "duration"))
    text, unit, given = raw["expression"], raw.get("unit"), [name for name in ("period", "duration") if name in raw]
    if not isinstance(text, str):
        raise Unusable("an expression is text", f'Write expression = "{WORDING.example}"', "expression", text)
    with below(key, text):
        expression = parse(text, ("t",), WORDING)
        if not expression.constants_finite:
            raise Unusable("it has no finite value", "Correct the division by zero, or the root or logarithm of a constant")
    if not isinstance(unit, str):
        display = KINDS[kind].display
        remedy = f'Add its unit: unit = "{display}"' if key else f'Write {{ expression = "{text}", unit = "{display}" }}'
        raise Unusable("an expression gives a plain number", remedy, *(("unit", unit) if key else ("", text)))
    with below("unit" if key else "", unit):
        size = factor(unit, kind)
    if len(given) > 1:
        remedy = "Give period for a motion that repeats, else duration"
        raise Unusable("a law has a period or a duration", remedy, "duration", raw["duration"])
    written = "" if key else f'{{ expression = "{text}", unit = "{unit}", '
    alone = f'Write {written}duration = "2 s"{" }" if written else ""} for a motion that ends there, or its period'
    own = None if given else _own_period(expression, kind, size, key, alone)
    time = read_scalar(raw[given[0]], "time", given[0])[0] if own is None else own
    if not SHORTEST <= time <= LONGEST:
        remedy = f"Give from {SHORTEST:g} to {LONGEST:g} s; in the expression t is in seconds"
        raise Unusable(f"no motion takes {time:.6g} s", remedy, *((given[0], raw[given[0]]) if given else (key, text)))
    t = np.linspace(0.0, time, SAMPLES)
    if worry := expression.hazards({"t": t}):
        raise Unusable(f"the law {worry} between 0 and {time:.6g} s", "Change the law", key, text)
    corners = [float(at) for one in _corners(expression, t) for at in one if CLOSED * time < at < (1.0 - CLOSED) * time]
    law = ExpressionLaw((0.0, *distinct(corners).tolist(), time), 0.0, given != ["duration"], size, expression=expression)
    places = np.append(t, corners)
    with np.errstate(all="ignore"):
        steepest = [max_magnitude(law._inside(places, order)) * time**order for order in (1, 2)]
        travel, advance = float(np.ptp(law._inside(places, 0))), float(np.diff(law._inside(np.array([0.0, time]), 0))[0])
    if not max(steepest) <= STEEPEST * travel:
        message = f"the velocity or the acceleration is not finite everywhere between 0 and {time:.6g} s"
        raise Unusable(message, "Change the law: a root, for example, begins with infinite speed", key, text)
    if not law.repeats:
        return replace(law, advance=advance)
    repeated = _repeated(advance, kind, travel)
    if not repeated["repeats"]:
        apart = show(abs(repeated["advance"]), kind, unit)
        message = f"the law does not repeat after {time:.6g} s: it ends {apart} from where it begins"
        raise Unusable(
            message, f'Correct the period, or write duration = "{time:.6g} s" for a single motion', given[0], raw[given[0]]
        )
    return replace(law, advance=repeated["advance"])


def _own_period(expression: Expression, kind: str, size: float, key: str, remedy: str) -> float:
    """Return the period [s] of an expression, for an angle that turns on the time after which it has made whole revolutions."""
    found, text = period_of(expression, "t"), expression.text
    if found is None:
        raise Unusable("the law has no period that its form shows", remedy, key, text)
    period, rate = found[0], found[1] * size
    if not period and not rate:
        raise Unusable("the law never moves", "Write an expression of the time t", key, text)
    if rate and kind != "angle":
        raise Unusable("the law grows without end", remedy, key, text)
    if not rate:
        return period
    turns = period * rate / TURN
    every = range(1, MOST_REVOLUTIONS + 1) if period * abs(rate) <= largest(kind) else ()
    whole = [times for times in every if abs(times * turns - round(times * turns)) <= CLOSED]
    if period and not whole:
        message = f"the law turns by {360.0 * turns:.6g} deg in its period of {period:.6g} s, and so never returns"
        raise Unusable(message, remedy, key, text)
    return period * whole[0] if period else TURN / abs(rate)


def _corners(expression: Expression, t: Array) -> list[Array]:
    """Return the times at which the law may have a corner, for each quantity of `Expression.breakpoints`."""
    if not expression.breakpoints({"t": t}):
        return []
    return zeros(lambda at: np.stack(expression.breakpoints({"t": at})), t)


def _read_samples(raw: Mapping[str, Any], folder: Path, kind: str) -> Law:
    check_keys(raw, ("csv",))
    columns = {"time": "time", COLUMNS[kind]: "angle" if kind == "angle" else "coordinate"}
    time, values = read_columns(raw, folder, columns, ordered="rising")
    repeated = _repeated(values[-1] - values[0], kind, np.ptp(values))
    values = [*values[:-1], values[0] + repeated["advance"]]
    return replace(spline(time, values, repeats=repeated["repeats"]), advance=repeated["advance"])


def _checked(law: MotionLaw, kind: str) -> MotionLaw:
    """Refuse a law that never moves, or leads beyond what a coordinate of its kind can be."""
    low, low_at, high, high_at = law.extremes()
    at, value = (low_at, low) if abs(low) > abs(high) else (high_at, high)
    if not high - low > 1e-12 * abs(value):
        remedy = "End a motion at another value, or give start where the law begins"
        raise Unusable(f"the law never moves: it stays at {show(value, kind)}", remedy)
    if abs(value) > largest(kind):
        raise Unusable(f"the law leads to {show(value, kind)} at {at:.6g} s, which is too far", "Check its unit")
    if kind == "length" and low <= 0.0:
        raise Unusable(f"a length is positive, but the law leads to {show(low, kind)} at {low_at:.6g} s", "Change the law")
    return law


def _table(part: object, keys: Sequence[str], example: str) -> Mapping[str, Any]:
    if not isinstance(part, dict):
        raise Unusable("expected a segment of the law", f"Write {example}", "", part)
    check_keys(part, keys)
    return part


def _law_name(table: Mapping[str, Any], end: str, moves: bool, example: str) -> str:
    """Return the name of a segment's law; without its end it is a dwell."""
    name = table.get("law", DEFAULT if moves else "dwell")
    check_name(name, SEGMENTS, "no such law of motion", "law")
    if moves and name == "dwell":
        raise Unusable("a dwell has no motion", f"Leave {end} out, or name another law", "law", name)
    if not moves and name != "dwell":
        raise Unusable("the motion has no end", f'Add {end} = "{example}", or leave law out for a dwell', "law", name)
    return str(name)


def paced_law(table: object, kind: str) -> Law:
    """Return the law of a crank whose speed a table over its angle states."""
    at: tuple[float, ...] = getattr(table, "at", ())
    values: tuple[float, ...] = getattr(table, "values", ())
    if kind != "angle" or not at:
        raise Unusable("a speed over the angle is a table, of a crank", 'Give over = "phi", at = [...] and values = [...]')
    if not (min(values) > 0.0 or max(values) < 0.0):
        raise Unusable("the speed changes its sign or is zero, where the crank would rest for ever", "Give one sign", "values")
    turn = at[-1] - at[0]
    if turn > TURN * (1.0 + CLOSED):
        raise Unusable("the table is longer than a revolution", "Give the rows of one revolution", "at")
    forth = 1 if values[0] > 0.0 else -1
    law = paced(at[::forth], values[::forth])
    return law if abs(turn - TURN) < CLOSED else replace(law, repeats=False)


# The law of a cam.


@dataclass(frozen=True)
class CamSegment:
    """A part of the law of a cam between two cam angles [rad]: a rise by `way` (`sense` 1), a fall (-1) or a dwell."""

    begin: float
    end: float
    law: str
    way: Quantity | None = None
    sense: int = 1


@dataclass(frozen=True)
class CamLaw:
    """The displacement of a cam's follower over one revolution of the cam, from 0 and back; its ways apart from their shapes."""

    segments: tuple[CamSegment, ...]

    @property
    def ways(self) -> tuple[Quantity, ...]:
        """The rises and falls, in their order."""
        return tuple(segment.way for segment in self.segments if segment.way is not None)

    def law(self, ways: Sequence[Value] | None = None) -> Law:
        """Return the law over the cam angle [rad] for sizes of the `ways` [SI], by default their values.

        Their sum must be zero: the law is closed.
        """
        sizes = iter([way.value for way in self.ways] if ways is None else ways)
        value, segments = 0.0, list[Segment]()
        for segment in self.segments:
            value = value if segment.way is None else value + segment.sense * next(sizes)
            segments.append(Segment(segment.end - segment.begin, value, segment.law))
        law = joined(0.0, segments)
        return replace(law, knots=(*law.knots[:-1], TURN), advance=0.0)


def read_cam_law(raw: object, kind: str = "length") -> CamLaw:
    """Read the law of a cam: segments that end at rising cam angles `to`, with a rise, a fall or neither (a dwell).

    Parameters
    ----------
    raw : object
        Value of the key `law`.
    kind : str
        Of the follower's displacement: "length" or "angle".

    Raises
    ------
    Unusable
    """
    example = KINDS[kind].example
    whole = f'[{{ to = "120 deg", rise = "{example}" }}, {{ to = "180 deg" }}, {{ to = "360 deg", fall = "{example}" }}]'
    if not isinstance(raw, list) or not raw:
        raise Unusable("the law of a cam is a list of its segments", f"Write {whole}", "", raw)
    segments, begin = list[CamSegment](), 0.0
    for row, part in enumerate(raw):
        with below(f"[{row}]"):
            segments.append(_read_cam_segment(part, begin, kind))
            begin = segments[-1].end
    if abs(begin - TURN) > CLOSED:
        message = f"the law ends at a cam angle of {show(begin, 'angle')}, not after one revolution"
        raise Unusable(message, 'End its last segment at to = "360 deg"', f"[{len(raw) - 1}].to", raw[-1]["to"])
    rise, fall = (sum(s.way.value for s in segments if s.way is not None and s.sense == sense) for sense in (1, -1))
    if not rise and not fall:
        raise Unusable("the law never moves", f"Write {whole}", "", raw)
    if abs(rise - fall) > CLOSED * max(rise, fall):
        message = f"the follower does not return: it rises by {show(rise, kind)} and falls by {show(fall, kind)}"
        raise Unusable(message, "Make the sums of the rises and of the falls equal", "", raw)
    return CamLaw((*segments[:-1], replace(segments[-1], end=TURN)))


def _read_cam_segment(part: object, begin: float, kind: str) -> CamSegment:
    example = KINDS[kind].example
    table = _table(part, ("to", "rise", "fall", "law"), f'{{ to = "120 deg", rise = "{example}" }}')
    if "to" not in table:
        raise Unusable("the segment has no end", 'Add the cam angle where it ends: to = "120 deg"', "to")
    end = read_scalar(table["to"], "angle", "to")[0]
    if not end > begin:
        message = f"the cam angles must rise, and this one follows {show(begin, 'angle')}"
        raise Unusable(message, "Sort the segments; to is the cam angle at the end of a segment", "to", table["to"])
    given = [key for key in ("rise", "fall") if key in table]
    if len(given) > 1:
        raise Unusable("a segment rises or falls", "Give rise or fall, or two segments", "fall", table["fall"])
    name = _law_name(table, "rise", bool(given), example)
    if not given:
        return CamSegment(begin, end, name)
    with below(given[0], table[given[0]]):
        if isinstance(table[given[0]], dict):
            message, remedy = (
                "the ways of the segments cannot be free",
                f"Fix them, and scale the whole law: lift = {range_example(kind)}",
            )
            raise Unusable(message, remedy)
        way = read_fixed(table[given[0]], kind)
        if not way.value > 0.0:
            raise Unusable("a rise or a fall is positive", "Write a fall in place of a negative rise; leave both out for a dwell")
    return CamSegment(begin, end, name, way, 1 if given == ["rise"] else -1)
