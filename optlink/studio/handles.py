"""Handles: the numbers of a problem file that can be dragged, and their positions on the drawing [mm, deg]."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeGuard

from optlink.errors import InputError
from optlink.io import finite
from optlink.linkage.mechanism import Arm
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import file_key
from optlink.studies.grid import Knob, exact_text, knobs, read_figure
from optlink.studio.picture import Picture

MAX_VALUE = 1e9  # in the unit of a handle
OFFSET_SHARE = 0.6  # share of a link at which the handle of its length lies if its end is occupied
RADIUS = 0.09  # share of the extent of the drawing: radius of an angle
HANDLE_SEPARATION = 0.03  # share of the extent: nearer handles would cover each other
TRANSMISSION = ("limits.transmission_angle.min", "limits.transmission_angle.max")
POINTS = "requirement.points"
SIDES = ("min", "max")


@dataclass(frozen=True)
class Handle:
    """A handle: what it changes in the file, and how the page draws it.

    `keys`: of the file, one for each number that it changes; `shown`: further fields for the page. A point of the requirement has
    an `index` in the list of points, and `axes` that turn a place of the drawing into its numbers.
    """

    id: str
    label: str
    kind: str
    unit: str
    keys: tuple[str, ...]
    value: Any
    shown: Mapping[str, Any]
    index: int | None = None
    axes: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of a point: origin [mm] and angle [rad] in which its numbers count

    def document(self) -> dict[str, Any]:
        """Return the handle as the page reads it."""
        base: dict[str, Any] = {"id": self.id, "label": self.label, "kind": self.kind, "unit": self.unit, "value": self.value}
        return finite({"size": None, "locked": None, "feasible": None} | base | dict(self.shown))  # type: ignore[no-any-return]

    @property
    def place(self) -> list[float] | None:
        """Numbers that a drag changes, at present."""
        if self.kind == "point":
            return list(self.shown["at"])
        return list(self.value) if self.kind == "range" else [self.value]

    @property
    def placed(self) -> bool:
        """Whether the handle lies on the drawing."""
        return "at" in self.shown or "centre" in self.shown

    def place_of(self, request: Mapping[str, Any]) -> list[float] | None:
        """Return the numbers of a drag; None if it has none."""
        if self.kind == "point":
            return request.get("at")
        value = request.get("value")
        return value if self.kind == "range" else [value]  # type: ignore[list-item]

    def message(self, place: list[float]) -> dict[str, Any]:
        """Return a drag to given numbers."""
        return {"at": place} if self.kind == "point" else {"value": place if self.kind == "range" else place[0]}

    def reached(self, place: list[float]) -> dict[str, Any]:
        """Return the fields of the page for the last feasible place on the way from the present one."""
        if self.kind == "point":
            return {"boundary": place}
        return {} if self.kind == "range" else {"feasible": sorted([self.value, place[0]])}

    def changes(self, problem: ProblemFile, message: Mapping[str, Any]) -> dict[str, object]:
        """Return the changes of the file for a message with a place (`at`) of a point, or the `value` of another handle."""
        if self.kind == "point":
            x, y = _numbers(message.get("at"), 2)
            origin_x, origin_y, turn = self.axes
            x, y = x - origin_x, y - origin_y
            c, s = math.cos(turn), math.sin(turn)
            values = [c * x + s * y, c * y - s * x]
        elif self.kind == "range":
            values = sorted(_numbers(message.get("value"), 2))
        else:
            values = _numbers([message.get("value")], 1)
        if self.index is not None:
            return {POINTS: _moved(problem, self.index, dict(zip(self.keys, values, strict=True)))}
        if len(self.keys) < len(values):  # a range that the file holds as one list
            return {self.keys[0]: [exact_text(value, self.unit) for value in values]}
        changes: dict[str, object] = {key: exact_text(value, self.unit) for key, value in zip(self.keys, values, strict=True)}
        if self.kind == "range":
            changes |= self._start_within(problem, values)
        return changes

    def _start_within(self, problem: ProblemFile, ends: list[float]) -> dict[str, object]:
        """Return the starting value of a design variable, moved to the nearer bound where it would lie beyond it."""
        key = f"{self.keys[0].rpartition('.')[0]}.start"
        start, unit = read_figure(problem.at(key))
        if unit != self.unit or ends[0] <= start <= ends[1]:
            return {}
        return {key: exact_text(min(max(start, ends[0]), ends[1]), unit)}


def _numbers(raw: Any, count: int) -> list[float]:
    """Return finite numbers of a message."""
    if isinstance(raw, list) and len(raw) == count:
        numbers = [float(x) for x in raw if isinstance(x, int | float) and not isinstance(x, bool) and abs(x) <= MAX_VALUE]
        if len(numbers) == count:
            return numbers
    raise InputError("the message has no usable place or value", "Send numbers of at most 1e9", key="drag", value=raw)


def _moved(problem: ProblemFile, index: int, values: Mapping[str, float]) -> list[Any]:
    """Return the listed points of the file with other numbers of one of them."""
    rows = list(problem.raw["requirement"]["points"])
    row = rows[index]
    if isinstance(row, Mapping):
        rows[index] = {**row, **{key: exact_text(value, "deg" if key == "angle" else "mm") for key, value in values.items()}}
    else:
        rows[index] = [exact_text(values["x"], "mm"), exact_text(values["y"], "mm"), *row[2:]]
    return rows


def same_kind(first: Handle | None, second: Handle) -> TypeGuard[Handle]:
    """Return whether a handle is there, and is dragged like another one."""
    return first is not None and (first.kind, first.keys, first.placed) == (second.kind, second.keys, second.placed)


def handles(problem: ProblemFile, picture: Picture | None) -> dict[str, Handle]:
    """Return the handles of a problem by name; without a picture, only those of the targets lie on the drawing."""
    return {handle.id: handle for handle in _Handles(problem, picture).all()}


class _Handles:
    """Handles of one problem."""

    def __init__(self, problem: ProblemFile, picture: Picture | None) -> None:
        self.problem, self.picture = problem, picture
        self.quantities = problem.model.mechanism.quantities
        self.taken: list[tuple[float, float]] = []
        self.radius, self.apart = 0.0, 0.0
        if picture is not None:
            extent = max(picture.scene.box[2:])
            self.radius, self.apart = RADIUS * extent, HANDLE_SEPARATION * extent

    def all(self) -> Iterator[Handle]:
        """Yield the handles: targets, requirement, dimensions, limits, bounds."""
        yield from self._targets()
        yield from self._requirement()
        remaining = {knob.key: knob for knob in knobs(self.problem)}
        yield from self._geometry(remaining)
        for knob in remaining.values():
            yield self._transmission(knob) or self._slider(knob)
        yield from self._bounds()

    def _slider(self, knob: Knob) -> Handle:
        shown = {"lower": knob.low, "upper": knob.high, **self._lock(knob.key)}
        return Handle(knob.key, knob.name, "scalar", knob.unit, (knob.key,), knob.value, shown)

    def _lock(self, key: str) -> dict[str, Any]:
        """Return the size that a key fixes."""
        name = next((name for name in self.quantities if self._key(name) == key), None)
        return {} if name is None else {"size": name, "locked": True}

    def _key(self, name: str) -> str:
        return file_key(self.problem.raw["mechanism"], name)

    def _angle(self, key: str, label: str, value: float, place: tuple[tuple[float, float], float, float], **shown: Any) -> Handle:
        centre, begin, radius = place
        ends = {"lower": shown.pop("lower", -360.0), "upper": shown.pop("upper", 360.0)}
        drawn = {"centre": list(centre), "radius": radius, "from": math.degrees(begin), **ends, **shown}
        return Handle(key, label, "angle", "deg", (key,), value, drawn)

    # --- requirement --------------------------------------------------------------------------------------------------------

    def _targets(self) -> Iterator[Handle]:
        targets = getattr(self.problem.model, "target_points", None)
        rows = (self.problem.raw.get("requirement") or {}).get("points")
        if targets is None or not isinstance(rows, list) or len(rows) != len(targets.points):
            return
        size = 1e3 * max(targets.size, 1e-6)
        for k, (x, y) in enumerate(targets.points):
            at, ident = [1e3 * x, 1e3 * y], f"{POINTS}.{k}"
            yield Handle(ident, f"point {k + 1}", "point", "mm", ("x", "y"), None, {"at": at}, k)
            if targets.angles is not None and targets.posed[k] and isinstance(rows[k], Mapping):
                value = math.degrees(targets.angles[k])
                drawn = {"centre": at, "radius": 0.25 * size, "from": 0.0, "lower": -360.0, "upper": 360.0}
                yield Handle(f"{ident}.angle", f"angle of pose {k + 1}", "angle", "deg", ("angle",), value, drawn, k)

    def _requirement(self) -> Iterator[Handle]:
        raw = self.problem.raw.get("requirement")
        if not isinstance(raw, Mapping):
            return
        begin = 0.0 if self.picture is None else float(self.picture.angles[0])
        for key, label, joint, start in (
            ("span", "crank rotation of the requirement", "A", begin),
            ("from", "crank angle at the start", "A", 0.0),
            ("psi0", "output angle at the start", "D", 0.0),
        ):
            value, unit = read_figure(raw.get(key))
            if unit == "deg":
                yield self._turned(f"requirement.{key}", label, value, joint, start)
        for name in ("stroke", "time_ratio"):
            sides = raw.get(name)
            for side, text in sides.items() if isinstance(sides, Mapping) else [("", sides)]:
                value, unit = read_figure(text)
                if value and side in ("", "exactly", *SIDES):
                    words, key = f"{name} {side}".replace("_", " ").strip(), f"requirement.{name}.{side}".rstrip(".")
                    yield self._slider(Knob(words, value, 0.5 * value, 1.5 * value, unit, key))
        law = raw.get("law")
        if isinstance(law, Mapping) and "function" in law:
            for key, joint in (("input", "A"), ("output", "D")):
                value, unit = read_figure(law.get(key))
                if unit == "deg":
                    yield self._turned(f"requirement.law.{key}", f"{key} range", value, joint, begin if joint == "A" else 0.0)
                elif value:
                    yield self._slider(Knob(f"{key} range", value, 0.5 * value, 1.5 * value, unit, f"requirement.law.{key}"))
            ends = law.get("x")
            if isinstance(ends, list) and len(ends) == 2 and all(type(x) in (int, float) for x in ends):
                room = 0.5 * abs(ends[1] - ends[0])
                low, high = min(ends) - room, max(ends) + room
                low = min(ends) if low <= 0.0 < min(ends) else low
                key = "requirement.law.x"
                yield Handle(key, "interval of x", "range", "", (key,), ends, {"lower": low, "upper": high})

    def _turned(self, key: str, label: str, value: float, joint: str, begin: float) -> Handle:
        """Return an angle handle at a pivot, or a slider if there is no such joint."""
        if self.picture is None or joint not in self.picture.mechanism.ground:
            return self._slider(Knob(label, value, value - 180.0, value + 180.0, "deg", key))
        return self._angle(key, label, value, (self.picture.at(joint), begin, (2.0 if joint == "A" else 1.6) * self.radius))

    # --- dimensions ---------------------------------------------------------------------------------------------------------

    def _geometry(self, fixed: dict[str, Knob]) -> Iterator[Handle]:
        """Yield handles of fixed dimensions on the drawing, and remove their knobs from `fixed`."""
        if self.picture is None:
            return
        picture, mechanism = self.picture, self.picture.mechanism
        for name, place in mechanism.ground.items():
            if isinstance(place, Arm):
                yield from self._length(fixed, str(place.length), place.origin, name)
            else:
                yield from self._place(fixed, f"point {name}", picture.at(name), place, (0.0, 0.0, 0.0))
        for link in mechanism.links:
            if link.end:
                yield from self._length(fixed, str(link.length), link.start, link.end)
        for point in mechanism.points:
            origin = picture.at(mechanism.bodies[point.body].start)
            turn = float(picture.motion.body_angle(point.body).value[0])
            yield from self._place(
                fixed, f"point {point.name} of {point.body}", picture.at(point.name), (point.along, point.across), (*origin, turn)
            )

    def _length(self, fixed: dict[str, Knob], name: str, start: str, end: str) -> Iterator[Handle]:
        if name not in self.quantities or (key := self._key(name)) not in fixed:
            return
        assert self.picture is not None
        knob = fixed.pop(key)
        first, second = self.picture.at(start), self.picture.at(end)
        length = math.dist(first, second)
        if not 0.0 < length < math.inf:
            yield self._slider(knob)
            return
        direction = [(b - a) / length for a, b in zip(first, second, strict=True)]
        reach = 1e3 * self.quantities[name].value  # that of the problem: what is drawn can be the last design before it
        reach *= 1.0 if self._free(second) else OFFSET_SHARE
        at = (first[0] + reach * direction[0], first[1] + reach * direction[1])
        self.taken.append(at)
        data = {"at": list(at), "along": direction, "lower": 0.0, "upper": None, "size": name, "locked": True}
        yield Handle(key, knob.name, "scalar", knob.unit, (key,), knob.value, data)

    def _place(
        self,
        fixed: dict[str, Knob],
        label: str,
        at: tuple[float, float],
        names: tuple[Any, Any],
        axes: tuple[float, float, float],
    ) -> Iterator[Handle]:
        """Yield the handle of a point: in the plane if both of its coordinates are fixed, along one axis if one is."""
        keys = [self._key(name) if isinstance(name, str) and name in self.quantities else "" for name in names]
        quantities = [fixed.pop(key, None) for key in keys]
        if not all(map(math.isfinite, at)):
            at = (0.0, 0.0)
        at = self._stated(at, [name if knob else None for name, knob in zip(names, quantities, strict=True)], axes)
        if all(quantities) and self._free(at):
            self.taken.append(at)
            yield Handle(keys[0], label, "point", "mm", (keys[0], keys[1]), None, {"at": list(at)}, None, axes)
            return
        for key, knob, turn in zip(keys, quantities, (axes[2], axes[2] + 0.5 * math.pi), strict=True):
            if knob is not None:
                direction = [math.cos(turn), math.sin(turn)]
                data = {"at": list(at), "along": direction, "lower": None, "upper": None, **self._lock(key)}
                yield Handle(key, knob.name, "scalar", knob.unit, (key,), knob.value, data)

    def _stated(self, at: tuple[float, float], names: list[Any], axes: tuple[float, float, float]) -> tuple[float, float]:
        """Return a place with the coordinates that the problem fixes: what is drawn can be the last design before it."""
        x, y, turn = axes
        c, s = math.cos(turn), math.sin(turn)
        drawn = (c * (at[0] - x) + s * (at[1] - y), c * (at[1] - y) - s * (at[0] - x))
        along, across = (
            value if name is None else 1e3 * self.quantities[name].value for name, value in zip(names, drawn, strict=True)
        )
        return x + c * along - s * across, y + s * along + c * across

    def _free(self, at: tuple[float, float]) -> bool:
        return all(math.dist(at, taken) > self.apart for taken in self.taken)

    # --- limits and bounds --------------------------------------------------------------------------------------------------

    def _transmission(self, knob: Knob) -> Handle | None:
        """Return a limit of the transmission angle of a four-bar as an angle at its joint; None for anything else."""
        if knob.key not in TRANSMISSION or knob.unit != "deg":
            return None
        loop = getattr(self.problem.model, "four_bar", None)
        if self.picture is None or loop is None:
            return None
        joint, coupler_end, rocker_end = (self.picture.at(name) for name in (loop.joint, loop.pin, loop.ground_pin))
        first, second = (math.atan2(end[1] - joint[1], end[0] - joint[0]) for end in (coupler_end, rocker_end))
        begin = first if math.remainder(second - first, 2.0 * math.pi) >= 0.0 else second
        if not math.isfinite(begin):
            return None
        radius = (1.0 if knob.key.endswith("min") else 1.35) * self.radius
        return self._angle(knob.key, knob.name, knob.value, (joint, begin, radius), lower=0.0, upper=180.0)

    def _bounds(self) -> Iterator[Handle]:
        """Yield the bounds of the design variables that the file states."""
        for name in self.problem.model.free:
            if name not in self.quantities:
                continue
            key = self._key(name)
            raw = self.problem.at(key) if "." in key else None
            if isinstance(raw, Mapping) and isinstance(raw.get("bounds"), list):
                (low, unit), (high, high_unit) = (read_figure(end) for end in raw["bounds"])
                if unit and unit == high_unit:
                    room = 0.5 * (high - low)
                    least = 0.0 if low > 0.0 and self.quantities[name].kind == "length" else low - room
                    data = {"lower": least, "upper": high + room, "size": name, "locked": False}
                    keys = (f"{key}.min", f"{key}.max")
                    yield Handle(f"{key}.bounds", f"bounds of {name}", "range", unit, keys, [low, high], data)
