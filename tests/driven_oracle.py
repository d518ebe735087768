"""Random driven machines, and their motion and forces by Newton's equations for every body in absolute coordinates.

A second way to every figure: a dense system with all joint forces, tooth forces and drives as unknown multipliers, its
accelerations by differentiating the constraint equations numerically; nothing is taken from the package but its table.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any

import numpy as np

Array = np.ndarray
Raw = dict[str, Any]
PRESSURE = math.tan(math.radians(20.0))
STEP = 2e-3
"""Step of the time derivative of constraint velocities, as a share of the shortest time of a motion."""


def metres(text: str) -> float:
    return float(text.split()[0])


def rotated(angle: Any, vector: Any) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def left(vector: Array) -> Array:
    return np.array([-vector[1], vector[0]])


def unit(vector: Array) -> Array:
    return vector / np.hypot(*vector)


class Oracle:
    """The bodies and constraints of a problem file."""

    def __init__(self, raw: Raw, drives: Mapping[str, tuple[Raw, Callable[[Any], Any]]]) -> None:
        mechanism = raw["mechanism"]
        self.raw, self.drives = raw, drives
        self.ground = {name: np.array([metres(x) for x in at]) for name, at in mechanism["ground"].items()}
        self.local: dict[str, dict[str, Array]] = {}
        for name, link in mechanism["links"].items():
            points = dict(zip(link["joints"], [(0.0, 0.0), (metres(link.get("length", "0 m")), 0.0)], strict=False))
            points |= {point: tuple(map(metres, at)) for point, at in link.get("points", {}).items()}
            self.local[name] = {point: np.array(at) for point, at in points.items()}
        self.cylinders = mechanism.get("cylinders", {})
        for name, cylinder in self.cylinders.items():
            barrel, rod = cylinder["joints"]
            self.local[name] = {barrel: np.zeros(2)}
            self.local[f"{name}.rod"] = {rod: np.zeros(2)}
        self.bodies = list(self.local)
        self.guides = mechanism.get("guides", {})
        self.couplings = [(kind, one) for kind in ("gears", "belts", "racks", "cams") for one in mechanism.get(kind, {}).values()]
        self.pins = [(point, [body for body in self.bodies if point in self.local[body]]) for point in self._points()]

    def _points(self) -> list[str]:
        return list(dict.fromkeys(point for body in self.bodies for point in self.local[body]))

    def pose(self, q: Array, body: str) -> tuple[Array, Any]:
        if body == "frame":
            return np.zeros(2), 0.0
        at = 3 * self.bodies.index(body)
        return q[at : at + 2], q[at + 2]

    def place(self, q: Array, body: str, local: Array) -> Array:
        origin, angle = self.pose(q, body)
        return origin + rotated(angle, local)

    def line(self, q: Array, guide: Raw) -> tuple[Array, Array]:
        """A point of the line of a guide, and its direction."""
        on = guide.get("on", "frame")
        direction = rotated(self.pose(q, on)[1] + math.radians(metres(guide.get("direction", "0 deg"))), (1.0, 0.0))
        through = self.ground[guide["through"]] if on == "frame" else self.place(q, on, self.local[on][guide["through"]])
        return through, direction

    def joint_of(self, one: str, other: str) -> str:
        """A pin of two bodies."""
        if other == "frame":
            return next(point for point in self.local[one] if point in self.ground)
        return next(point for point in self.local[one] if point in self.local[other])

    def rolling(self, q: Array, kind: str, one: Raw) -> Any:
        """The equation of a coupling."""
        if kind == "racks":
            guide = next(guide for guide in self.guides.values() if guide["slider"] == one["rack"])
            start, line = self.line(q, guide)
            slide = (self.pose(q, one["rack"])[0] - start) @ line
            return slide - self.side(q, one) * metres(one["radius"]) * (self.pose(q, one["pinion"])[1])
        if kind == "cams":
            body, pivot = one["follower"], one["start"]
            lift = cam_law(self.pose(q, one["cam"])[1], one)
            guide = next((guide for guide in self.guides.values() if guide["slider"] == body), None)
            if guide is None:
                return self.pose(q, body)[1] - math.radians(metres(pivot)) - lift
            start, line = self.line(q, guide)
            return (self.pose(q, body)[0] - start) @ line - metres(pivot) - lift
        arm = self.pose(q, one.get("arm", "frame"))[1]
        first, second = (self.pose(q, body)[1] - arm for body in one["bodies"])
        return second - ratio_of(kind, one) * first

    def side(self, q: Array, one: Raw) -> float:
        guide = next(guide for guide in self.guides.values() if guide["slider"] == one["rack"])
        start, line = self.line(q, guide)
        pivot = self.ground[self.joint_of(one["pinion"], "frame")]
        away = np.real(pivot - start)
        return 1.0 if np.real(line[0]) * away[1] - np.real(line[1]) * away[0] >= 0.0 else -1.0

    def equations(self, q: Array, t: Any) -> Array:
        """Constraints: pins, guides, cylinders, couplings, drives; angles up to whole revolutions."""
        rows: list[Any] = []
        for point, bodies in self.pins:
            places = [self.place(q, body, self.local[body][point]) for body in bodies]
            base = self.ground[point] if point in self.ground else places.pop(0)
            rows += [x for place in places for x in place - base]
        for guide in self.guides.values():
            start, line = self.line(q, guide)
            origin, angle = self.pose(q, guide["slider"])
            on = self.pose(q, guide.get("on", "frame"))[1]
            rows += [left(line) @ (origin - start), angle - on - math.radians(metres(guide.get("direction", "0 deg")))]
        for name in self.cylinders:
            start, angle = self.pose(q, name)
            end, other = self.pose(q, f"{name}.rod")
            rows += [rotated(angle, (0.0, 1.0)) @ (end - start), other - angle]
        rows += [self.rolling(q, kind, one) for kind, one in self.couplings]
        rows += [self.driven(q, drive) - law(t) for drive, law in self.drives.values()]
        return np.array(rows)

    def periods(self) -> Array:
        """What each equation gains when an angle of the table is stated one revolution less; 0 if it does not change."""
        turn = 2.0 * math.pi
        values = [0.0, 0.0] * sum(len(bodies) - (point not in self.ground) for point, bodies in self.pins)
        values += [0.0, turn] * (len(self.guides) + len(self.cylinders))
        for kind, one in self.couplings:
            ratio = 1.0 if kind in ("racks", "cams") else ratio_of(kind, one)
            size = metres(one["radius"]) if kind == "racks" else 1.0 if kind != "cams" or one["start"].endswith("deg") else 0.0
            values.append(turn * size / Fraction(ratio).limit_denominator(1000).denominator)
        values += [turn if "body" in drive else 0.0 for drive, _ in self.drives.values()]
        return np.array(values)

    def driven(self, q: Array, drive: Raw) -> Any:
        if "cylinder" in drive:
            (start, angle), (end, _) = (self.pose(q, drive["cylinder"] + part) for part in ("", ".rod"))
            return (end - start) @ rotated(angle, (1.0, 0.0))
        if "slide" in drive:
            guide = self.guides[drive["slide"]]
            start, line = self.line(q, guide)
            return (self.pose(q, guide["slider"])[0] - start) @ line
        return self.pose(q, drive["body"])[1] - self.pose(q, drive.get("against", "frame"))[1]

    def late(self, table: Mapping[str, Array]) -> float:
        """Time of the drives in the first row, of a machine that can be assembled in a part of its cycle only."""
        drives = [drive for drive, _ in self.drives.values()]
        if len(drives) == 1 and "law" not in drives[0] and "start" not in drives[0]:
            return 0.0
        angle = np.radians(table[next(iter(table))])
        first = math.radians(metres(drives[0]["start"])) if len(drives) == 1 and "law" not in drives[0] else 0.0
        return float((angle[0] - first) * (table["time_s"][1] - table["time_s"][0]) / (angle[1] - angle[0]))

    def near_knot(self, q: Array) -> bool:
        """Whether a cam is close to an end of a segment of its law."""
        cams = [one for kind, one in self.couplings if kind == "cams"]
        ends = [self.pose(q, one["cam"])[1] - math.radians(metres(part["to"])) for one in cams for part in one["law"]]
        return any(abs(math.remainder(end, 2.0 * math.pi)) < 5e-3 for end in ends)

    # --- motion and forces at one position

    def jacobian(self, q: Array, t: float) -> Array:
        h = 1e-30
        return np.stack([np.imag(self.equations(q + 1j * h * step, t)) / h for step in np.eye(q.size)], axis=1)

    def motion(self, q: Array, t: float, scale: float) -> tuple[Array, Array, Array]:
        """Jacobian matrix, velocities and accelerations."""
        matrix, h = self.jacobian(q, t), 1e-30
        rate = np.linalg.solve(matrix, -np.imag(self.equations(q.astype(complex), t + 1j * h)) / h)

        def speed(s: float) -> Array:
            return np.imag(self.equations(q + s * rate + 1j * h * rate, t + s + 1j * h)) / h

        s = STEP * scale
        one, two = ((speed(k * s) - speed(-k * s)) / (2.0 * k * s) for k in (1.0, 2.0))
        return matrix, rate, np.linalg.solve(matrix, -(4.0 * one - two) / 3.0)

    def forces(self, q: Array, matrix: Array, rate: Array, acceleration: Array) -> Array:
        """Multipliers of all equations."""
        wrench = np.zeros(q.size)
        gravity = np.array([0.0, -metres(self.raw["gravity"])])
        inertias = {name: (body["mass"], body["centroid"], body["inertia"]) for name, body in self.raw["bodies"].items()}
        for name, cylinder in self.cylinders.items():
            for part, of, way in (("barrel", name, 1.0), ("rod", f"{name}.rod", -1.0)):
                if part in cylinder:
                    own = cylinder[part]
                    inertias[of] = own["mass"], (f"{way * metres(own['centroid'])!r} m", "0 m"), own["inertia"]
        for body, (mass, centroid, inertia) in inertias.items():
            at, (_, angle) = 3 * self.bodies.index(body), self.pose(q, body)
            lever = rotated(angle, np.array([metres(x) for x in centroid]))
            pull = acceleration[at : at + 2] + acceleration[at + 2] * left(lever) - rate[at + 2] ** 2 * lever - gravity
            wrench[at : at + 3] += metres(mass) * np.append(pull, left(lever) @ pull)
            wrench[at + 2] += metres(inertia) * acceleration[at + 2]
        for load in self.raw.get("loads", {}).values():
            at = 3 * self.bodies.index(load["on"])
            if "torque" in load:
                wrench[at + 2] -= metres(load["torque"])
                continue
            force = metres(load["force"]) * rotated(math.radians(metres(load["direction"])), (1.0, 0.0))
            lever = rotated(q[at + 2], self.local[load["on"]][load["at"]])
            wrench[at : at + 3] -= np.append(force, left(lever) @ force)
        size = np.linalg.solve(matrix.T, wrench)
        directions = matrix.T.copy()
        first = matrix.shape[0] - len(self.drives) - len(self.couplings)
        for number, (kind, one) in enumerate(self.couplings, start=first):
            own, other, place, force = self.contact(q, matrix, kind, one, size[number])
            column = np.zeros(q.size)
            for body, share in ((own, 1.0), (other, -1.0)):
                if body != "frame":
                    at = 3 * self.bodies.index(body)
                    column[at : at + 3] += share * np.append(force, left(place - q[at : at + 2]) @ force)
            directions[:, number] = column
        return np.linalg.solve(directions, wrench)

    def contact(self, q: Array, matrix: Array, kind: str, one: Raw, size: float) -> tuple[str, str, Array, Array]:
        """The body on which a force acts, the one that exerts it, its place, and the force of a multiplier of one."""
        sign = -1.0 if size < 0.0 else 1.0
        if kind == "racks":
            guide = next(guide for guide in self.guides.values() if guide["slider"] == one["rack"])
            _, line = self.line(q, guide)
            pivot, side = self.ground[self.joint_of(one["pinion"], "frame")], self.side(q, one)
            away = -side * left(line)  # from the pivot to the rack
            return one["rack"], one["pinion"], pivot + metres(one["radius"]) * away, line + sign * PRESSURE * away
        if kind == "cams":
            body = one["follower"]
            pivot = self.ground[self.joint_of(one["cam"], "frame")]
            turned, at = self.pose(q, one["cam"])[1], 3 * self.bodies.index(body)
            slope = np.imag(cam_law(turned + 1e-30j, one)) / 1e-30
            guide = next((guide for guide in self.guides.values() if guide["slider"] == body), None)
            if guide is not None:
                tip, (_, line) = q[at : at + 2], self.line(q, guide)
                moves, share = slope * line, line
            else:
                tip = self.place(q, body, self.local[body][self.raw["mechanism"]["links"][body]["joints"][1]])
                lever = left(tip - q[at : at + 2])
                moves, share = slope * lever, lever
            normal = left(unit(moves - left(tip - pivot)))  # across the path of the roller on the cam
            return body, one["cam"], tip, normal / (normal @ share)
        arm, bodies = one.get("arm", "frame"), one["bodies"]
        pivots = [self.joint_of(arm if body == "frame" else body, "frame" if body == "frame" else arm) for body in bodies]
        places = [self.ground[p] if p in self.ground else self.place(q, arm, self.local[arm][p]) for p in pivots]
        between = places[1] - places[0]
        distance, along, ratio = np.hypot(*between), unit(between), ratio_of(kind, one)
        if kind == "belts":  # on the second wheel the tight strand pulls towards the first
            small, large = (metres(d) / 2.0 for d in one["diameters"])
            turned = 1.0 if ratio > 0.0 else -1.0
            # unit normals of the two tangents: n . between = first radius - (signed) second radius
            sine = (small - turned * large) / distance
            for way in (1.0, -1.0):
                normal = sine * along + way * math.sqrt(1.0 - sine**2) * left(along)
                begin, end = places[0] + small * normal, places[1] + turned * large * normal
                pull = unit(begin - end)
                moment = left(end - places[1]) @ pull
                if moment * sign > 0.0:
                    return bodies[1], bodies[0], end, pull / moment
        pitch = places[0] + ratio / (ratio - 1.0) * between
        across, lever = left(along), (pitch - places[1]) @ along
        ring = ratio > 0.0 and abs(ratio) < 1.0  # the second gear has internal teeth: the other one is pressed to its own axis
        apart = unit(pitch - places[0]) if ring else unit(places[1] - pitch)
        return bodies[1], bodies[0], pitch, across / lever + sign * PRESSURE * apart / abs(lever)


def ratio_of(kind: str, one: Raw) -> float:
    if kind == "belts":
        first, second = map(metres, one["diameters"])
        return first / second * (-1.0 if one.get("crossed") else 1.0)
    return one["teeth"][0] / one["teeth"][1] * (1.0 if one.get("internal") else -1.0)


def cam_law(angle: Any, one: Raw) -> Any:
    """A rise by 3-4-5, a dwell and a fall by it."""
    ends = [math.radians(metres(segment["to"])) for segment in one["law"]]
    size = metres(one["law"][0]["rise"]) * (math.pi / 180.0 if one["law"][0]["rise"].endswith("deg") else 1.0)
    angle = angle - 2.0 * math.pi * np.floor(np.real(angle) / (2.0 * math.pi))
    at = np.real(angle)
    if at < ends[0]:
        x = angle / ends[0]
    elif at < ends[1]:
        return size + 0.0 * angle
    elif at < ends[2]:
        x = 1.0 - (angle - ends[1]) / (ends[2] - ends[1])
    else:
        return 0.0 * angle
    return size * (10.0 * x**3 - 15.0 * x**4 + 6.0 * x**5)


# --- random machines ---------------------------------------------------------------------------------------------------------


class Machines:
    """A generator of problem files: a drive of some kind, couplings, further drives, dyads, masses and loads."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.ground: Raw = {}
        self.links: Raw = {}
        self.guides: Raw = {}
        self.assembly: Raw = {}
        self.tables: dict[str, Raw] = {kind: {} for kind in ("cylinders", "gears", "belts", "racks", "cams")}
        self.drives: dict[str, tuple[Raw, Callable[[Any], Any]]] = {}
        self.tips: list[tuple[str, str]] = []
        """Points of placed bodies, to which dyads can be added."""
        self.shafts: list[tuple[str, str, str]] = []
        """Placed bodies on a ground pin, with the pin and how they turn: whole, swing."""
        self.number = 0

    def draw(self, low: float, high: float) -> float:
        return round(float(self.rng.uniform(low, high)), 4)

    def name(self, kind: str) -> str:
        self.number += 1
        return f"{kind}{self.number}"

    def pin(self, at: tuple[float, float] | None = None) -> str:
        name = self.name("G")
        place = at or (self.draw(-0.3, 0.3), self.draw(-0.3, 0.3))
        self.ground[name] = [f"{x!r} m" for x in place]
        return name

    def crank(self, low: float = 0.04, high: float = 0.12, motion: str = "whole", pivot: str = "") -> str:
        body, end = self.name("crank"), self.name("P")
        pivot = pivot or self.pin()
        self.links[body] = {"joints": [pivot, end], "length": f"{self.draw(low, high)!r} m"}
        self.tips.append((body, end))
        if pivot in self.ground:
            self.shafts.append((body, pivot, motion))
        return body

    def wave(self, middle: float, size: float, period: float, unit: str) -> tuple[Raw, Callable[[Any], Any]]:
        scale = math.pi / 180.0 if unit == "deg" else 1.0
        text = f"{middle!r} + {size!r}*sin(2*pi*t/{period!r})"
        law = {"expression": text, "unit": unit, "period": f"{period!r} s"}
        return law, lambda t: scale * (middle + size * np.sin(2.0 * math.pi * t / period))

    def drive(self, number: int, many: bool) -> None:
        """Add a drive; the first of several, or of one alone, has a name that the table of results uses."""
        name, period = f"d{number}" if many else "input", [1.0, 2.0, 0.5][int(self.rng.integers(3))]
        kind = ["turn", "wave", "cylinder", "slide", "stacked"][int(self.rng.integers(5))]
        if kind == "stacked" and (not many or not self.shafts):
            kind = "wave"
        if kind == "turn":
            body = self.crank()
            turns, start = int(self.rng.integers(1, 4)) * (1 if self.rng.random() < 0.5 else -1), self.draw(0.0, 360.0)
            rate = 2.0 * math.pi * turns / (1.0 if many else 1.7)
            drive: Raw = {"body": body, "speed": f"{rate!r} rad/s", "start": f"{start!r} deg"}
            if not many and self.rng.random() < 0.4:
                low = self.draw(-60.0, 60.0)
                drive |= {"range": [f"{low!r} deg", f"{low + self.draw(40.0, 200.0):.4f} deg"]}
                drive.pop("start")
                begin = math.radians(metres(drive["range"][0 if rate > 0.0 else 1]))
                self.shafts[-1] = (*self.shafts[-1][:2], "swing")
            else:
                begin = math.radians(start)
            self.drives[name] = drive, lambda t: begin + rate * t
        elif kind in ("wave", "stacked"):
            on = self.tips[-1] if kind == "stacked" else ("", "")
            law, value = self.wave(self.draw(0.0, 180.0), self.draw(20.0, 50.0), period, "deg")
            body = self.crank(motion="swing", pivot=on[1])
            drive = {"body": body, "law": law} | ({"against": on[0]} if on[0] else {})
            self.drives[name] = drive, value
        elif kind == "slide":
            slider, guide = self.slider()
            law, value = self.wave(self.draw(0.05, 0.2), self.draw(0.02, 0.08), period, "m")
            self.drives[name] = {"slide": guide, "law": law}, value
            self.tips.append((slider, self.links[slider]["joints"][0]))
        else:
            self.drives[name] = self.cylinder(period, many)

    def slider(self) -> tuple[str, str]:
        slider, guide, point = self.name("slider"), self.name("guide"), self.name("S")
        self.links[slider] = {"joints": [point]}
        self.guides[guide] = {"slider": slider, "through": self.pin(), "direction": f"{self.draw(0.0, 360.0)!r} deg"}
        return slider, guide

    def cylinder(self, period: float, many: bool) -> tuple[Raw, Callable[[Any], Any]]:
        """A boom on the ground with a cylinder on the ground."""
        foot, name, size, away = self.pin(), self.name("ram"), self.draw(0.2, 0.35), self.draw(0.25, 0.4)
        angle = float(self.rng.uniform(0.0, 2.0 * math.pi))
        x, y = map(metres, self.ground[foot])
        other = self.pin((round(x + away * math.cos(angle), 4), round(y + away * math.sin(angle), 4)))
        boom, tip, end = self.name("boom"), self.name("B"), self.name("T")
        self.links[boom] = {
            "joints": [foot, tip],
            "length": f"{size!r} m",
            "points": {end: ["0.3 m", f"{self.draw(-0.1, 0.1)!r} m"]},
        }
        low, high = abs(size - away) + 0.08, size + away - 0.08
        self.tables["cylinders"][name] = {"joints": [other, tip], "closed": f"{low:.4f} m", "open": f"{high:.4f} m"}
        if self.rng.random() < 0.6:
            for part in ("barrel", "rod"):
                own = {"mass": f"{self.draw(0.5, 3.0)!r} kg", "centroid": f"{self.draw(0.02, 0.1)!r} m"}
                self.tables["cylinders"][name][part] = own | {"inertia": f"{self.draw(0.001, 0.01)!r} kg*m^2"}
        self.assembly[tip] = f"{'left' if self.rng.random() < 0.5 else 'right'} of {foot}-{other}"
        self.tips.append((boom, end))
        self.shafts.append((boom, foot, "swing"))
        low, high = round(low, 4), round(high, 4)
        if many or self.rng.random() < 0.5:
            law, value = self.wave(round(0.5 * (low + high), 4), round(0.3 * (high - low), 4), period, "m")
            return {"cylinder": name, "law": law}, value
        speed = self.draw(0.05, 0.3)
        return {"cylinder": name, "speed": f"{speed!r} m/s"}, lambda t: low + speed * t

    def couple(self) -> None:
        """Add a gear pair, belt, planet, rack or cam to a placed shaft."""
        body, pivot, motion = self.shafts[int(self.rng.integers(len(self.shafts)))]
        kind = ["gear", "belt", "ring", "planet", "rack", "cam", "rocker cam"][int(self.rng.integers(7))]
        if kind == "rack" and motion == "whole":
            kind = "cam"
        x, y = map(metres, self.ground[pivot])
        teeth = (
            [int(n) for n in self.rng.integers(10, 40, 2)]
            if motion == "swing"
            else [[20, 20], [20, 40], [30, 15]][int(self.rng.integers(3))]
        )
        if kind in ("gear", "belt", "ring"):
            other = self.crank(
                motion=motion, pivot=self.pin((round(x + self.draw(0.15, 0.3), 4), round(y + self.draw(-0.2, 0.2), 4)))
            )
            if kind == "belt":
                one: Raw = {
                    "bodies": [body, other],
                    "diameters": [f"{2e-3 * n:.3f} m" for n in teeth],
                    "crossed": bool(self.rng.random() < 0.4),
                }
                self.tables["belts"][self.name("belt")] = one
                return
            teeth = [20, 40] if kind == "ring" else teeth
            one = {"bodies": [body, other], "teeth": teeth} | ({"internal": True} if kind == "ring" else {})
            self.tables["gears"][self.name("gear")] = one
        elif kind == "planet":
            ends = [point for of, point in self.tips if of == body]
            planet = self.crank(motion=motion, pivot=ends[0])
            fixed = {"bodies": [planet, "frame"], "teeth": [20, 60], "internal": True, "arm": body}
            self.tables["gears"][self.name("gear")] = fixed
        elif kind == "rack":
            slider, guide, point = self.name("rack"), self.name("guide"), self.name("S")
            self.links[slider] = {"joints": [point]}
            angle, radius = self.draw(0.0, 360.0), self.draw(0.03, 0.08)
            side = 1.0 if self.rng.random() < 0.5 else -1.0
            offset = side * radius * left(rotated(math.radians(angle), (1.0, 0.0)))
            through = self.pin((float(x - offset[0]), float(y - offset[1])))
            self.guides[guide] = {"slider": slider, "through": through, "direction": f"{angle!r} deg"}
            self.tables["racks"][self.name("mesh")] = {"pinion": body, "rack": slider, "radius": f"{radius!r} m"}
            self.tips.append((slider, point))
        else:
            swings = kind == "rocker cam"
            rise, ends = (
                ("15 deg" if swings else "0.03 m"),
                sorted(int(n) for n in self.rng.choice(np.arange(60, 330, 30), 3, replace=False)),
            )
            law = [{"to": f"{ends[0]} deg", "rise": rise, "law": "3-4-5"}, {"to": f"{ends[1]} deg"}]
            law += [{"to": f"{ends[2]} deg", "fall": rise, "law": "3-4-5"}, {"to": "360 deg"}]
            if swings:
                follower = self.crank(0.1, 0.2, "swing", self.pin((round(x + self.draw(0.15, 0.25), 4), y)))
                start = f"{self.draw(140.0, 180.0)!r} deg"
            else:
                follower, point = self.name("tappet"), self.name("S")
                self.links[follower] = {"joints": [point]}
                centre = self.pin((x, y)) if self.rng.random() < 0.5 else self.pin((round(x + 0.01, 4), y))
                self.guides[self.name("guide")] = {
                    "slider": follower,
                    "through": centre,
                    "direction": f"{self.draw(0.0, 360.0)!r} deg",
                }
                start = f"{self.draw(0.05, 0.1)!r} m"
                self.tips.append((follower, point))
            cam = {"cam": body, "follower": follower, "law": law, "start": start, "roller": "8 mm"}
            self.tables["cams"][self.name("cam")] = cam

    def dyad(self) -> None:
        """Add two links, a link and a slider, or a rod that slides through a swinging block."""
        body, point = self.tips[int(self.rng.integers(len(self.tips)))]
        kind = ["RRR", "RRP", "RPR"][int(self.rng.integers(3))]
        if kind == "RRR":
            others = [end for of, end in self.tips if of != body and end != point]
            other = others[int(self.rng.integers(len(others)))] if others and self.rng.random() < 0.4 else self.pin()
            joint, one, two, tracer = self.name("J"), self.name("rod"), self.name("rocker"), self.name("T")
            self.links[one] = {
                "joints": [point, joint],
                "length": f"{self.draw(0.25, 0.45)!r} m",
                "points": {tracer: ["0.1 m", "0.05 m"]},
            }
            self.links[two] = {"joints": [other, joint], "length": f"{self.draw(0.25, 0.45)!r} m"}
            self.assembly[joint] = f"{'left' if self.rng.random() < 0.5 else 'right'} of {point}-{other}"
            self.tips.append((one, tracer))
        elif kind == "RRP":
            slider, _ = self.slider()
            joint, rod = self.links[slider]["joints"][0], self.name("rod")
            self.links[rod] = {"joints": [point, joint], "length": f"{self.draw(0.4, 0.6)!r} m"}
            self.assembly[joint] = "forward"
            self.tips.append((slider, joint))
        else:
            pivot, rocker, block, guide, end = (
                self.pin(),
                self.name("rocker"),
                self.name("block"),
                self.name("guide"),
                self.name("T"),
            )
            self.links[rocker] = {"joints": [pivot, end], "length": "0.3 m"}
            self.links[block] = {"joints": [point]}
            self.guides[guide] = {"slider": block, "on": rocker, "through": pivot}
            self.assembly[guide] = "forward"
            self.tips.append((rocker, end))

    def build(self) -> tuple[Raw, Oracle]:
        rng = self.rng
        count = 1 if rng.random() < 0.5 else int(rng.integers(2, 4))
        for number in range(count):
            self.drive(number, count > 1)
        for _ in range(int(rng.integers(0, 3))):
            if self.shafts:
                self.couple()
        for _ in range(int(rng.integers(0, 3))):
            self.dyad()
        inertias = {}
        for body in self.links:
            if rng.random() < 0.8:
                own = {"mass": f"{self.draw(0.5, 4.0)!r} kg", "centroid": [f"{self.draw(-0.05, 0.1)!r} m" for _ in "xy"]}
                inertias[body] = own | {"inertia": f"{self.draw(0.001, 0.05)!r} kg*m^2"}
        loads: Raw = {}
        body, point = self.tips[-1]
        loads["push"] = {
            "on": body,
            "at": point,
            "force": f"{self.draw(-50.0, 50.0)!r} N",
            "direction": f"{self.draw(0.0, 360.0)!r} deg",
        }
        if self.shafts:
            loads["brake"] = {"on": self.shafts[-1][0], "torque": f"{self.draw(-20.0, 20.0)!r} N*m"}
        tables = {kind: table for kind, table in self.tables.items() if table}
        mechanism = {"ground": self.ground, "links": self.links, "guides": self.guides, "assembly": self.assembly, **tables}
        raw: Raw = {
            "title": "Random machine",
            "gravity": "9.81 m/s^2",
            "mechanism": mechanism,
            "bodies": inertias,
            "loads": loads,
        }
        raw |= (
            {"drive": self.drives["input"][0]}
            if count == 1
            else {"drives": {name: one for name, (one, _) in self.drives.items()}}
        )
        return raw, Oracle(raw, self.drives)


# --- comparison --------------------------------------------------------------------------------------------------------------


def coordinates(oracle: Oracle, table: Mapping[str, Array], row: int) -> Array:
    """Absolute coordinates of all bodies in a row of the table of results."""

    def place(point: str) -> Array:
        return oracle.ground[point] if point in oracle.ground else np.array([table[f"{point}.{axis}_m"][row] for axis in "xy"])

    q: list[float] = []
    for body in oracle.bodies:
        q += [*place(next(iter(oracle.local[body]))), table[f"{body.removesuffix('.rod')}.angle_rad"][row]]
    return np.array(q)


def apart(left_: Mapping[str, float], table: Mapping[str, Array], row: int, tolerance: float, floor: float) -> list[str]:
    scale = max([floor, *(abs(value) for value in left_.values())])
    wrong = [(name, value, float(table[name][row])) for name, value in left_.items()]
    return [
        f"row {row}: {name} {there!r}, expected {value!r}"
        for name, value, there in wrong
        if not abs(value - there) <= tolerance * scale
    ]


def faults(oracle: Oracle, table: Mapping[str, Array], reactions: Mapping[str, str], tolerance: float = 1e-7) -> list[str]:
    """What differs in a table of results from Newton's equations."""
    found: list[str] = []
    whole = oracle.periods()
    late = oracle.late(table)
    for row, t in enumerate(table["time_s"] + late):
        q = coordinates(oracle, table, row)
        gap = oracle.equations(q, t)
        gap = gap - whole * np.round(gap / np.where(whole > 0.0, whole, 1.0))
        if not np.max(np.abs(gap)) < 1e-9:
            return [*found, f"row {row}: constraint {int(np.argmax(np.abs(gap)))} is open by {np.max(np.abs(gap)):.3g}"]
        matrix, rate, acceleration = oracle.motion(q, float(t), 0.02)
        if np.linalg.cond(matrix) > 1e6 or oracle.near_knot(q):  # the differences would reach across a corner
            continue
        size = oracle.forces(q, matrix, rate, acceleration)
        speeds, rates, forces, moments, efforts = {}, {}, {}, {}, {}
        for number, body in enumerate(oracle.bodies):
            if not body.endswith(".rod"):
                speeds[f"{body}.omega_rad_s"], rates[f"{body}.alpha_rad_s2"] = rate[3 * number + 2], acceleration[3 * number + 2]
        at = 0
        for point, bodies in oracle.pins:
            loose = bodies if point in oracle.ground else bodies[1:]
            own = {body: size[at + 2 * n : at + 2 * n + 2] for n, body in enumerate(loose)}
            at += 2 * len(loose)
            if point not in oracle.ground:
                own[bodies[0]] = -sum(own.values(), np.zeros(2))
            for body, force in own.items():
                shown = body.removesuffix(".rod")
                for column in (point, f"{point}.{shown}"):
                    if column in reactions and reactions[column].endswith(f" on {shown}"):
                        forces |= {f"{column}.f{axis}_N": value for axis, value in zip("xy", force, strict=True)}
        for guide in oracle.guides:
            forces[f"{guide}.normal_N"], moments[f"{guide}.moment_Nm"] = size[at], size[at + 1]
            at += 2
        first = len(size) - len(oracle.drives)
        power = 0.0
        for number, (name, (drive, law)) in enumerate(oracle.drives.items()):
            power += size[first + number] * np.imag(law(t + 1e-30j)) / 1e-30
            (moments if "body" in drive else forces)[f"{name}.{'torque_Nm' if 'body' in drive else 'force_N'}"] = size[
                first + number
            ]
        efforts["input.power_W"] = power
        for values, floor in ((speeds, 1.0), (rates, 1.0), (forces, 1.0), (moments, 1.0), (efforts, 1.0)):
            found += apart(values, table, row, tolerance, floor)
    return found
