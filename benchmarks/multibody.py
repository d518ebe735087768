"""Machines with several drives and couplings against a multibody code in absolute coordinates, Exudyn.

    pip install exudyn
    python benchmarks/multibody.py --json benchmarks/multibody_record.json

Exudyn integrates the equations of motion of bodies in absolute coordinates with joints, teeth and drives as constraints, from the
positions and velocities at the start; efforts of drives are its Lagrange multipliers. A row of the table has the largest
difference of positions, velocities and efforts over a second, relative to the largest value of its kind. All bodies have mass.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import optlink

STEPS, EVERY, SETTLED = 20_000, 200, 20  # of the second; steps between compared times; times before the first one
MASS, INERTIA, CENTROID, SPEED = 1.0, 0.01, (0.02, 0.01), "60 rpm"
FOLDER = Path(__file__).parents[1] / "tests" / "data" / "mechanisms"
MACHINES = (
    "arm",
    "five-bar-legs",
    "circle-by-two-slides",
    "excavator",
    "sun-planetary",
    "differential",
    "carriage-with-motor",
    "sun-driven-planetary",
    "pinion-between-racks",
    "five-bar-3",
    "gear-pair",
    "belt-drive",
)
UNITS = {"mm": 1e-3, "m": 1.0, "deg": math.pi / 180.0, "rad": 1.0, "rpm": math.pi / 30.0}


def number(text: str) -> float:
    """A value in SI units."""
    value, unit = text.split()
    return float(value) * UNITS[unit]


def law(drive: dict[str, Any]) -> Callable[[float], float]:
    """The coordinate of a drive [rad, m] over the time [s]."""
    if "law" not in drive:
        speed = number(drive["speed"])
        return lambda t: speed * t
    formula, scale = compile(drive["law"]["expression"], "law", "eval"), UNITS[drive["law"]["unit"]]
    return lambda t: scale * float(eval(formula, {"t": t, "sin": math.sin, "cos": math.cos, "pi": math.pi}))  # noqa: S307


class Model:
    """A machine of a problem file in Exudyn; its coordinates count from the first row of a table of results."""

    def __init__(self, raw: dict[str, Any], table: Any) -> None:
        import exudyn
        import exudyn.itemInterface as items

        self.exudyn, self.items, self.raw, self.part = exudyn, items, raw, raw["mechanism"]
        self.system = exudyn.SystemContainer().AddSystem()
        self.local: dict[str, dict[str, tuple[float, ...]]] = {}
        self.start: dict[str, list[float]] = {}
        self.nodes: dict[str, int] = {}
        self.bodies: dict[str, int] = {}
        self.cylinders: list[tuple[int, Callable[[float], float]]] = []
        self.ground = {name: [number(x) for x in at] for name, at in self.part["ground"].items()}
        base = self.system.AddObject(items.ObjectGround())
        self.still = self.system.AddNode(items.NodePointGround())
        self.bodies["frame"] = base
        for name, link in self.part["links"].items():
            points = dict(zip(link["joints"], [(0.0, 0.0), (number(link.get("length", "0 m")), 0.0)], strict=False))
            points |= {point: tuple(map(number, at)) for point, at in link.get("points", {}).items()}
            self.local[name] = points
            self.body(name, link["joints"][0], table)
        self.joints()
        self.couplings()
        self.sensors = {name: self.drive(drive) for name, drive in self.drives().items()}
        self.system.SetPreStepUserFunction(self.lengthen)
        self.system.Assemble()

    def drives(self) -> dict[str, Any]:
        return self.raw.get("drives") or {"input": self.raw["drive"]}

    def body(self, name: str, start: str, table: Any) -> None:
        """Add a body, its mass at the centroid, which is the origin of its axes."""
        first = [table[f"{name}.{column}"][0] for column in ("angle_rad", "omega_rad_s")]
        c, s = math.cos(first[0]), math.sin(first[0])
        x, y = c * CENTROID[0] - s * CENTROID[1], s * CENTROID[0] + c * CENTROID[1]
        at = self.ground.get(start) or [table[f"{start}.{axis}_m"][0] for axis in "xy"]
        moves = [0.0, 0.0] if start in self.ground else [table[f"{start}.v{axis}_m_s"][0] for axis in "xy"]
        self.start[name] = [at[0] + x, at[1] + y, first[0]]
        self.nodes[name] = self.system.AddNode(
            self.items.NodeRigidBody2D(
                referenceCoordinates=self.start[name],
                initialVelocities=[moves[0] - first[1] * y, moves[1] + first[1] * x, first[1]],
            )
        )
        body = self.items.ObjectRigidBody2D(mass=MASS, inertia=INERTIA, nodeNumber=self.nodes[name])
        self.bodies[name] = self.system.AddObject(body)
        mass = self.system.AddMarker(self.items.MarkerBodyMass(bodyNumber=self.bodies[name]))
        self.system.AddLoad(self.items.LoadMassProportional(markerNumber=mass, loadVector=[0.0, -9.81, 0.0]))

    def marker(self, body: str, point: str) -> int:
        """A marker at a point of a body."""
        if body == "frame":
            place = [*self.ground[point], 0.0]
        else:
            along, across = self.local[body][point]
            place = [along - CENTROID[0], across - CENTROID[1], 0.0]
        return self.system.AddMarker(self.items.MarkerBodyRigid(bodyNumber=self.bodies[body], localPosition=place))

    def joints(self) -> None:
        """Add the pins and guides."""
        for point in dict.fromkeys(point for points in self.local.values() for point in points):
            sharing = ["frame"] * (point in self.ground) + [body for body in self.local if point in self.local[body]]
            for other in sharing[1:]:
                markers = [self.marker(sharing[0], point), self.marker(other, point)]
                self.system.AddObject(self.items.ObjectJointRevolute2D(markerNumbers=markers))
        for guide in self.part.get("guides", {}).values():
            on, angle = guide.get("on", "frame"), number(guide.get("direction", "0 deg"))
            markers = [self.marker(on, guide["through"]), self.marker(guide["slider"], next(iter(self.local[guide["slider"]])))]
            axis = [math.cos(angle), math.sin(angle), 0.0]
            joint = self.items.ObjectJointPrismatic2D(
                markerNumbers=markers, axisMarker0=axis, normalMarker1=[0.0, 1.0, 0.0], constrainRotation=True
            )
            self.system.AddObject(joint)

    def row(self, terms: list[tuple[str, int, float]]) -> None:
        """Add a linear equation between changes of coordinates: of bodies, by their number and factor."""
        terms = [term for term in terms if term[0] != "frame"]
        bodies = list(dict.fromkeys(body for body, _, _ in terms))
        nodes, size = [self.nodes[body] for body in bodies], 3 * len(bodies)
        whole = self.system.AddObject(self.items.ObjectGenericODE2(nodeNumbers=nodes, massMatrix=np.zeros((size, size))))
        factors, begin = np.zeros((1, size)), 0.0  # the coordinates of the marker contain those at the start
        for body, coordinate, factor in terms:
            factors[0, 3 * bodies.index(body) + coordinate] += factor
            begin += factor * self.start[body][coordinate]
        markers = [self.system.AddMarker(self.items.MarkerObjectODE2Coordinates(objectNumber=whole)) for _ in "01"]
        equation = self.items.ObjectConnectorCoordinateVector(
            markerNumbers=markers, scalingMarker0=np.zeros((1, size)), scalingMarker1=factors, offset=[begin]
        )
        self.system.AddObject(equation)

    def couplings(self) -> None:
        """Add gears, belts and racks."""
        for kind in ("gears", "belts"):
            for one in self.part.get(kind, {}).values():
                first, second = one["bodies"]
                ratio = one.get("ratio")
                if ratio is None:
                    sizes = one["teeth"] if kind == "gears" else [number(size) for size in one["diameters"]]
                    ratio = sizes[0] / sizes[1] * (1.0 if kind == "belts" or one.get("internal") else -1.0)
                self.row([(second, 2, 1.0), (first, 2, -ratio), (one.get("arm", "frame"), 2, ratio - 1.0)])
        guides = list(self.part.get("guides", {}).values())
        for one in self.part.get("racks", {}).values():  # the point of the pinion on the pitch line moves as the rack
            (pivot,) = self.local[one["pinion"]]
            path = next(guide for guide in guides if pivot in self.local[guide["slider"]])
            angle, below = number(path.get("direction", "0 deg")), 1.0 if one["rack"] == "frame" else -1.0
            line, carrier, radius = (math.cos(angle), math.sin(angle)), path["slider"], below * number(one["radius"])
            terms = [(one["pinion"], 2, radius)]
            for k in (0, 1):
                terms += [(carrier, k, line[k]), (one["rack"], k, -line[k])]
            self.row(terms)

    def drive(self, drive: dict[str, Any]) -> int:
        """Add a drive; return a sensor of its effort."""
        value = law(drive)
        if "cylinder" in drive:
            markers = []
            for point in self.part["cylinders"][drive["cylinder"]]["joints"]:
                body = "frame" if point in self.ground else next(name for name in self.local if point in self.local[name])
                markers.append(self.marker(body, point))
            number_ = self.system.AddObject(self.items.ObjectConnectorDistance(markerNumbers=markers, distance=value(0.0)))
            self.cylinders.append((number_, value))
            kind = self.exudyn.OutputVariableType.Force
        else:
            body = drive.get("body") or self.part["guides"][drive["slide"]]["slider"]
            against, axis = drive.get("against", "frame"), 2
            if "slide" in drive:
                guide = self.part["guides"][drive["slide"]]
                axis = 1 if guide.get("direction") == "90 deg" else 0
            node, place = (self.still, 0) if against == "frame" else (self.nodes[against], axis)
            markers = [
                self.system.AddMarker(self.items.MarkerNodeCoordinate(nodeNumber=node, coordinate=place)),
                self.system.AddMarker(self.items.MarkerNodeCoordinate(nodeNumber=self.nodes[body], coordinate=axis)),
            ]
            begin = value(0.0)
            number_ = self.system.AddObject(
                self.items.ObjectConnectorCoordinate(
                    markerNumbers=markers, offset=0.0, offsetUserFunction=lambda system, t, item, offset: value(t) - begin
                )
            )
            kind = self.exudyn.OutputVariableType.Force
        return self.system.AddSensor(self.items.SensorObject(objectNumber=number_, outputVariableType=kind, storeInternal=True))

    def lengthen(self, system: Any, t: float) -> bool:
        """Set the lengths of the cylinders."""
        for number_, value in self.cylinders:
            system.SetObjectParameter(number_, "distance", value(t))
        return True

    def solve(self) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
        """Poses and velocities of the bodies, and efforts of the drives, at the compared times."""
        output, sensors = self.exudyn.OutputVariableType, {}
        for body, node in self.nodes.items():
            for name, kind in (("position", output.Position), ("velocity", output.Velocity), ("rate", output.AngularVelocity)):
                sensors[body, name] = self.system.AddSensor(
                    self.items.SensorNode(nodeNumber=node, outputVariableType=kind, storeInternal=True)
                )
        self.system.Assemble()
        settings = self.exudyn.SimulationSettings()
        time = settings.timeIntegration
        time.numberOfSteps, time.endTime, time.verboseMode = STEPS, 1.0, 0
        time.generalizedAlpha.spectralRadius = 0.5
        time.newton.relativeTolerance, time.newton.absoluteTolerance = 1e-10, 1e-12
        settings.solution.file.write = False
        settings.solution.sensors.writePeriod = EVERY / STEPS
        self.system.SolveDynamic(settings)
        states: dict[str, dict[str, Any]] = {body: {} for body in self.nodes}
        for (body, name), sensor in sensors.items():
            states[body][name] = self.system.GetSensorStoredData(sensor)[:, 1:]
        return states, {name: self.system.GetSensorStoredData(sensor)[:, -1] for name, sensor in self.sensors.items()}


def compared(name: str) -> dict[str, Any]:
    """The largest relative differences of a machine."""
    part = optlink.load(FOLDER / f"{name}.toml").raw["mechanism"]
    own = {"mass": f"{MASS} kg", "inertia": f"{INERTIA} kg*m^2", "centroid": [f"{x} m" for x in CENTROID]}
    raw = dict(optlink.load(FOLDER / f"{name}.toml").raw) | {"bodies": dict.fromkeys(part["links"], own)}
    if "drives" not in raw:
        raw["drive"] = {**raw.get("drive", {"body": "crank"}), "speed": SPEED}
    problem, step = optlink.read(raw), EVERY / STEPS
    analysis = optlink.analyze(problem, points=round(float(optlink.analyze(problem, points=10)["time_s"][1]) * 10 / step))
    assert math.isclose(analysis["time_s"][1], step, rel_tol=1e-9), name
    table = {column: np.asarray(analysis[column]) for column in analysis.columns}
    states, efforts = Model(raw, table).solve()
    rows = np.arange(SETTLED, min(STEPS // EVERY, len(table["time_s"])))
    differences: dict[str, float] = {}

    def differ(kind: str, here: list[Any], there: list[Any]) -> None:
        scale = max(float(np.max(np.abs(one))) for one in here)
        gap = max(float(np.max(np.abs(one - other))) for one, other in zip(here, there, strict=True))
        differences[kind] = gap / scale

    places: tuple[list[Any], list[Any]] = [], []
    speeds: tuple[list[Any], list[Any]] = [], []
    for body, link in part["links"].items():
        start, state = link["joints"][0], states[body]
        angle, omega = table[f"{body}.angle_rad"][rows], table[f"{body}.omega_rad_s"][rows]
        along, across = (np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))
        for k, axis in enumerate("xy"):
            column = f"{start}.{axis}_m"
            at = table[column][rows] if column in table else number(part["ground"][start][k])
            moves = table[f"{start}.v{axis}_m_s"][rows] if column in table else 0.0
            places[0].append(at + CENTROID[0] * along[k] + CENTROID[1] * across[k])
            places[1].append(state["position"][rows, k])
            speeds[0].append(moves + omega * (CENTROID[0] * across[k] - CENTROID[1] * along[k]))
            speeds[1].append(state["velocity"][rows, k])
        speeds[0].append(omega)
        speeds[1].append(state["rate"][rows, 2])
    differ("positions", *places)
    differ("velocities", *speeds)
    here = [
        next(table[f"{drive}.{unit}"][rows] for unit in ("torque_Nm", "force_N") if f"{drive}.{unit}" in table)
        for drive in efforts
    ]
    differ("efforts", here, [-efforts[drive][rows] for drive in efforts])  # of the drive on its body, not of the body on it
    return {"machine": name, **differences}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="file of the record")
    parser.add_argument("machines", nargs="*", help="names of files in tests/data/mechanisms")
    given = parser.parse_args()
    records = []
    print(f"{'machine':24}{'positions':>12}{'velocities':>12}{'efforts':>12}")
    for name in given.machines or MACHINES:
        records.append(record := compared(name))
        print(f"{name:24}" + "".join(f"{record[kind]:12.1e}" for kind in ("positions", "velocities", "efforts")))
    if given.json is not None:
        given.json.write_text(json.dumps(records, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
