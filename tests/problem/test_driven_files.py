"""Problem files of driven machines: a fault is named with its key and a remedy in a sentence, and the command fails with 2."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.errors import InputError

DATA = Path(__file__).parents[1] / "data"
FILES = {file.stem: file for folder in ("mechanisms", "driven") for file in (DATA / folder).glob("*.toml")}

CASES = [
    ("hatch", {"drive.range": "90 deg"}, "drive.range"),
    ("hatch", {"drive.range": ["0 deg"]}, "drive.range"),
    ("hatch", {"drive.range": ["90 deg", "0 deg"]}, "drive.range"),
    ("hatch", {"drive.range": ["0 mm", "90 mm"]}, "drive.range"),
    ("hatch", {"drive.range": ["0 deg", "0 deg"]}, "drive.range"),
    ("hatch", {"drive.range": ["0 deg", "1e9 deg"]}, "drive.range"),
    ("hatch", {"drive.range": [0, 90]}, "drive.range"),
    ("hatch", {"drive.range": ["0 deg", "90 mm"]}, "drive.range"),
    ("hatch", {"drive.speed": "0 rad/s"}, "drive.speed"),
    ("hatch", {"drive.speed": "nan rad/s"}, "drive.speed"),
    ("hatch", {"drive.speed": "10 mm/s"}, "drive.speed"),
    ("hatch", {"drive.start": "120 deg"}, "drive.start"),
    ("hatch", {"drive.body": "nobody"}, "drive.body"),
    ("hatch", {"drive.slide": "rail"}, "drive.body"),
    ("hatch", {"drive.cylinder": "ram"}, "drive.body"),
    ("hatch", {"drive.acceleration": "-40 rad/s^2"}, "drive.acceleration"),
    ("hatch", {"drive.acceleration": "5 m/s"}, "drive.acceleration"),
    ("hatch", {"drive.law": "45*sin(2*pi*t)"}, "drive.law"),
    ("hatch", {"drive.law": []}, "drive.law"),
    ("hatch", {"drive.law": {"csv": "none.csv"}}, "drive.law.csv"),
    ("hatch", {"drive.law": 3}, "drive.law"),
    ("hatch", {"drive.end": "90 deg"}, "drive.end"),
    ("hatch", {"drive.against": "lid"}, "drive.against"),
    ("toggle-clamp", {"drive.range": ["-5 deg", "200 deg"]}, "drive.range"),
    ("toggle-clamp", {"mechanism.links.handle.length": "120 mm", "drive.range": ["-5 deg", "80 deg"]}, "drive.range"),
    (
        "servo-press",
        {"drive.speed": {"over": "phi", "at": ["0 deg", "360 deg"], "values": ["60 rpm", "-20 rpm"]}},
        "drive.speed.values",
    ),
    ("servo-press", {"drive.speed": {"over": "s", "at": ["0 mm", "36 mm"], "values": ["60 rpm", "20 rpm"]}}, "drive.speed.over"),
    (
        "servo-press",
        {"drive.speed": {"over": "phi", "at": ["0 deg", "360 deg"], "values": ["60 N", "20 N"]}},
        "drive.speed.values[0]",
    ),
    ("servo-press", {"drive.speed": {"over": "phi"}}, "drive.speed.at"),
    ("excavator-boom", {"mechanism.cylinders.lift.closed": "1900 mm"}, "mechanism.cylinders.lift.open"),
    ("excavator-boom", {"mechanism.cylinders.lift.closed": "0 mm"}, "mechanism.cylinders.lift.closed"),
    ("excavator-boom", {"mechanism.cylinders.lift.closed": "-5 mm"}, "mechanism.cylinders.lift.closed"),
    ("excavator-boom", {"mechanism.cylinders.lift.closed": "100 mm"}, "mechanism.cylinders.lift.closed"),
    ("excavator-boom", {"mechanism.cylinders.lift.open": "9000 mm"}, "mechanism.cylinders.lift.open"),
    ("excavator-boom", {"mechanism.cylinders.lift.open": "1e30 m"}, "mechanism.cylinders.lift.open"),
    ("excavator-boom", {"mechanism.cylinders.lift.open": 12}, "mechanism.cylinders.lift.open"),
    ("excavator-boom", {"mechanism.cylinders.lift.open": None}, "mechanism.cylinders.lift.open"),
    ("excavator-boom", {"mechanism.cylinders.lift.joints": ["D"]}, "mechanism.cylinders.lift.joints"),
    ("excavator-boom", {"mechanism.cylinders.lift.joints": ["D", "X"]}, "mechanism.links.lift"),
    ("excavator-boom", {"mechanism.cylinders.lift.joints": ["D", "D"]}, "mechanism.links.boom"),
    ("excavator-boom", {"mechanism.cylinders.lift.joints": ["A", "D"]}, "mechanism.links.lift"),
    ("excavator-boom", {"mechanism.cylinders.lift.joints": "D"}, "mechanism.cylinders.lift.joints"),
    ("excavator-boom", {"mechanism.cylinders.lift.joints": [1, 2]}, "mechanism.cylinders.lift.joints.0"),
    ("excavator-boom", {"mechanism.cylinders.lift.barrel": {"mass": "-2 kg"}}, "mechanism.cylinders.lift.barrel.mass"),
    ("excavator-boom", {"mechanism.cylinders.lift.barrel": {"centroid": "2 mm"}}, "mechanism.cylinders.lift.barrel.mass"),
    ("excavator-boom", {"mechanism.cylinders.lift.barrel": "2 kg"}, "mechanism.cylinders.lift.barrel"),
    ("excavator-boom", {"mechanism.cylinders.lift.stroke": "2 mm"}, "mechanism.cylinders.lift.stroke"),
    ("excavator-boom", {"mechanism.cylinders.boom": {"joints": ["D", "B"], "closed": "1 m", "open": "2 m"}}, "mechanism"),
    ("excavator-boom", {"drive.cylinder": "lft"}, "drive.cylinder"),
    ("excavator-boom", {"drive.start": "5 m"}, "drive.start"),
    ("excavator-boom", {"drive.range": ["1 m", "5 m"]}, "drive.range"),
    ("excavator-boom", {"drive.speed": "5 rpm"}, "drive.speed"),
    ("excavator-boom", {"drive.body": "boom"}, "drive.body"),
    ("excavator-boom", {"mechanism.cylinders": [1]}, "mechanism.cylinders"),
    ("excavator-boom", {"mechanism.cylinders.lift": "x"}, "mechanism.cylinders.lift"),
    ("excavator-boom", {"drive.start": "30 deg"}, "drive.start"),
    ("geared-five-bar", {"mechanism.gears.train.ratio": 0}, "mechanism.gears.train.ratio"),
    ("geared-five-bar", {"mechanism.gears.train.ratio": "two"}, "mechanism.gears.train.ratio"),
    ("geared-five-bar", {"mechanism.gears.train.ratio": 1000000000.0}, "mechanism.gears.train.ratio"),
    ("geared-five-bar", {"mechanism.gears.train.ratio": 2.718281828}, "mechanism.gears"),
    ("geared-five-bar", {"mechanism.gears.train.ratio": None}, "mechanism.gears.train.teeth"),
    ("geared-five-bar", {"mechanism.gears.train.teeth": [20, 40]}, "mechanism.gears.train.teeth"),
    ("geared-five-bar", {"mechanism.gears.train.bodies": ["crank"]}, "mechanism.gears.train.bodies"),
    ("geared-five-bar", {"mechanism.gears.train.bodies": ["crank", "crank"]}, "mechanism.gears.train.bodies"),
    ("geared-five-bar", {"mechanism.gears.train.bodies": ["crank", "frame"]}, "mechanism.links.rod1"),
    ("geared-five-bar", {"mechanism.gears.train.bodies": ["frame", "frame"]}, "mechanism.gears.train.bodies"),
    ("geared-five-bar", {"mechanism.gears.train.bodies": ["crank", "wheel"]}, "mechanism.gears.train.bodies"),
    ("geared-five-bar", {"mechanism.gears.train.bodies": ["crank", "rod1"]}, "mechanism.assembly.D"),
    ("geared-five-bar", {"mechanism.gears.train.bodies": ["rod1", "rod2"]}, "mechanism.links.rod1"),
    ("geared-five-bar", {"mechanism.gears.train.arm": "nobody"}, "mechanism.gears.train.arm"),
    ("geared-five-bar", {"mechanism.gears.train.phase": "30 mm"}, "mechanism.gears.train.phase"),
    ("geared-five-bar", {"mechanism.gears.train.internal": True}, "mechanism.gears.train.internal"),
    ("geared-five-bar", {"mechanism.gears.train.colour": "red"}, "mechanism.gears.train.colour"),
    ("geared-five-bar", {"mechanism.gears.crank": {"bodies": ["crank", "crank2"], "ratio": 3}}, "mechanism."),
    ("geared-five-bar", {"mechanism.gears.more": {"bodies": ["crank", "crank2"], "ratio": 3}}, "mechanism."),
    ("geared-five-bar", {"mechanism.gears": None}, "mechanism.links.crank2"),
    ("gear-pair", {"mechanism.gears.mesh.teeth": [0, 40]}, "mechanism.gears.mesh.teeth"),
    ("gear-pair", {"mechanism.gears.mesh.teeth": [20.5, 40]}, "mechanism.gears.mesh.teeth.0"),
    ("gear-pair", {"mechanism.gears.mesh.teeth": [20, -40]}, "mechanism.gears.mesh.teeth"),
    ("gear-pair", {"mechanism.gears.mesh.teeth": 20}, "mechanism.gears.mesh.teeth"),
    ("gear-pair", {"mechanism.gears.mesh.teeth": [20, 40, 60]}, "mechanism.gears.mesh.teeth"),
    ("gear-pair", {"mechanism.gears.mesh.module": "3 mm"}, "mechanism.gears.mesh.module"),
    ("gear-pair", {"mechanism.gears.mesh.module": "0 mm"}, "mechanism.gears.mesh.module"),
    (
        "gear-pair",
        {"mechanism.gears.mesh.teeth": [20, 20], "mechanism.gears.mesh.internal": True, "mechanism.gears.mesh.module": None},
        "mechanism.gears.mesh.teeth",
    ),
    ("gear-pair", {"mechanism.gears.mesh.teeth": [20, 10007], "mechanism.gears.mesh.module": None}, "mechanism.gears"),
    ("gear-pair", {"mechanism.gears.mesh.pressure_angle": "80 deg"}, "mechanism.gears.mesh.pressure_angle"),
    ("gear-pair", {"mechanism.gears.mesh.bodies": ["crank", "rod"]}, "mechanism.gears.mesh.arm"),
    ("rack-and-sector", {"mechanism.racks.mesh.radius": "0 mm"}, "mechanism.racks.mesh.radius"),
    ("rack-and-sector", {"mechanism.racks.mesh.radius": "-80 mm"}, "mechanism.racks.mesh.radius"),
    ("rack-and-sector", {"mechanism.racks.mesh.pinion": "frame"}, "mechanism.racks.mesh.pinion"),
    ("rack-and-sector", {"mechanism.racks.mesh.pinion": "rack"}, "mechanism.racks.mesh.pinion"),
    ("rack-and-sector", {"mechanism.racks.mesh.rack": "sector"}, "mechanism.racks.mesh.rack"),
    ("rack-and-sector", {"mechanism.racks.mesh.rack": "nobody"}, "mechanism.racks.mesh.rack"),
    ("rack-and-sector", {"mechanism.racks.mesh.rack": ["rack"]}, "mechanism.racks.mesh.rack"),
    ("rack-and-sector", {"mechanism.racks.mesh.side": "up"}, "mechanism.racks.mesh.side"),
    ("rack-and-sector", {"mechanism.racks.mesh": None}, "mechanism.links.rack"),
    ("belt", {"mechanism.belts.b.radii": ["0 mm", "80 mm"]}, "mechanism.belts.b.radii.0"),
    ("belt", {"mechanism.belts.b.radii": ["40 mm"]}, "mechanism.belts.b.radii.1"),
    ("belt", {"mechanism.belts.b.radii": ["40 mm", "800 mm"]}, "mechanism.belts.b.radii"),
    ("belt", {"mechanism.belts.b.diameters": ["40 mm", "80 mm"]}, "mechanism.belts.b.diameters"),
    ("belt", {"mechanism.belts.b.radii": "40 mm"}, "mechanism.belts.b.radii"),
    ("belt", {"mechanism.belts.b.crossed": True, "mechanism.belts.b.radii": ["200 mm", "150 mm"]}, "mechanism.belts.b.radii"),
    ("belt", {"mechanism.belts.b.bodies": ["crank", "frame"]}, "mechanism.belts.b.radii"),
    ("belt", {"mechanism.belts.b.arm": "wheel"}, "mechanism.belts.b.arm"),
    ("belt", {"mechanism.belts.b.radii": None}, "mechanism.belts.b.diameters"),
    ("belt", {"mechanism.belts.b.radii": ["40 mm", "79.99999 mm"]}, "mechanism.gears"),
    ("belt", {"mechanism.belts.b.radii": ["-40 mm", "80 mm"]}, "mechanism.belts.b.radii.0"),
    ("plate-cam", {"mechanism.cams.lift.cam": "follower"}, "mechanism.cams.lift.follower"),
    ("plate-cam", {"mechanism.cams.lift.cam": "nobody"}, "mechanism.cams.lift.cam"),
    ("plate-cam", {"mechanism.cams.lift.cam": "frame"}, "mechanism.cams.lift.cam"),
    ("plate-cam", {"mechanism.cams.lift.follower": "cam"}, "mechanism.cams.lift.follower"),
    ("plate-cam", {"mechanism.cams.lift.law": "modified sine"}, "mechanism.cams.lift.law"),
    ("plate-cam", {"mechanism.cams.lift.law": []}, "mechanism.cams.lift.law"),
    ("plate-cam", {"mechanism.cams.lift.law": None}, "mechanism.cams.lift.law"),
    ("plate-cam", {"mechanism.cams.lift.law": [{"to": "360 deg", "rise": "20 mm"}]}, "mechanism.cams.lift.law"),
    (
        "plate-cam",
        {"mechanism.cams.lift.law": [{"to": "180 deg", "rise": "20 deg"}, {"to": "360 deg", "fall": "20 deg"}]},
        "mechanism.cams.lift.law.[0].rise",
    ),
    (
        "plate-cam",
        {"mechanism.cams.lift.law": [{"to": "180 deg", "rise": "20 mm", "law": "magic"}, {"to": "360 deg", "fall": "20 mm"}]},
        "mechanism.cams.lift.law.[0].law",
    ),
    ("plate-cam", {"mechanism.cams.lift.law": [{"to": "400 deg", "rise": "20 mm"}]}, "mechanism.cams.lift.law.[0].to"),
    ("plate-cam", {"mechanism.cams.lift.law": [1, 2]}, "mechanism.cams.lift.law.[0]"),
    ("plate-cam", {"mechanism.cams.lift.base_radius": "0 mm"}, "mechanism.cams.lift.base_radius"),
    ("plate-cam", {"mechanism.cams.lift.base_radius": "-30 mm"}, "mechanism.cams.lift.base_radius"),
    ("plate-cam", {"mechanism.cams.lift.roller": "0 mm"}, "mechanism.cams.lift.roller"),
    ("plate-cam", {"mechanism.cams.lift.flat": True}, "mechanism.cams.lift.roller"),
    ("plate-cam", {"mechanism.cams.lift.start": "3 mm"}, "mechanism.cams.lift.start"),
    ("plate-cam", {"mechanism.cams.lift.start": True, "mechanism.cams.lift.base_radius": None}, "mechanism.cams.lift.start"),
    ("plate-cam", {"mechanism.cams.lift.start": "3 deg", "mechanism.cams.lift.base_radius": None}, "mechanism.cams.lift.start"),
    ("plate-cam", {"mechanism.cams.lift.phase": "x"}, "mechanism.cams.lift.phase"),
    ("plate-cam", {"mechanism.cams.lift.side": "up"}, "mechanism.cams.lift.side"),
    ("plate-cam", {"drive.body": "follower"}, "mechanism.links.follower.joints"),
    ("plate-cam", {"mechanism.cams.rail": {"cam": "cam", "follower": "follower", "law": []}}, "mechanism.cams.rail.law"),
    ("cam-rocker", {"mechanism.cams.lift.base_radius": "300 mm"}, "mechanism.cams.lift.base_radius"),
    ("cam-rocker", {"mechanism.cams.lift.flat": True, "mechanism.cams.lift.roller": None}, "mechanism.cams.lift.flat"),
    ("cam-rocker", {"mechanism.links.rocker": {"joints": ["F"]}}, "mechanism.cams.lift.follower"),
    ("cam-rocker", {"mechanism.cams.lift.start": "x", "mechanism.cams.lift.base_radius": None}, "mechanism.cams.lift.start"),
    ("two-link-arm", {"drives.elbow.against": "nobody"}, "drives.elbow.against"),
    ("two-link-arm", {"drives.elbow.against": "fore"}, "drives.elbow.against"),
    ("two-link-arm", {"drives.elbow.body": "upper"}, "drives.elbow.against"),
    ("two-link-arm", {"drives.elbow.body": "nobody"}, "drives.elbow.body"),
    ("two-link-arm", {"drives.elbow.body": None}, "drives.elbow.body"),
    ("two-link-arm", {"drives.elbow": None}, "mechanism.links.fore"),
    ("two-link-arm", {"drives.third": {"body": "fore", "speed": "3 rpm"}}, "drives.third"),
    ("two-link-arm", {"drives": {}}, "drive.body"),
    ("two-link-arm", {"drives.elbow": "x"}, "drives.elbow"),
    ("two-link-arm", {"drives.elbow.speed": "3 rpm"}, "drives.elbow.speed"),
    ("two-link-arm", {"drive.body": "upper"}, "drive"),
    (
        "two-link-arm",
        {"drives.elbow.law": {"expression": "40 - 30*cos(2*pi*t)", "unit": "deg", "period": "0.9137173 s"}},
        "drives.elbow.law.period",
    ),
    ("two-link-arm", {"drives.elbow.law": {"expression": "1/t", "unit": "deg", "period": "1 s"}}, "drives.elbow.law.expression"),
    ("two-link-arm", {"drives.elbow.torque": "3 N*m"}, "drives.elbow.torque"),
    ("two-link-arm", {"drives.elbow.law": {"csv": "x.csv"}}, "drives.elbow.law.csv"),
    ("two-link-arm", {"drives.shoulder": {"body": "upper", "speed": "3.1415926535 rpm"}}, "drives.elbow"),
    ("five-bar-robot", {"drives.right": None}, "mechanism.links.fore2"),
    ("crane-crab", {"drives.travel.slide": "nothing"}, "drives.travel.slide"),
    (
        "crane-crab",
        {"drives.travel.law": {"expression": "2*sin(2*pi*t/5)", "unit": "deg", "period": "5 s"}},
        "drives.travel.law.unit",
    ),
    ("driven-slider", {"drive.range": ["0 m", "20 m"]}, "drive.range"),
    ("driven-slider", {"drive.range": ["0 deg", "20 deg"]}, "drive.range"),
    ("driven-slider", {"drive.range": None}, "drive.range"),
    ("driven-slider", {"drive.body": "rod"}, "drive.speed"),
    ("driven-slider", {"drive.speed": "5 rpm"}, "drive.speed"),
    ("excavator-boom", {"mechanism.slots": {"s": {"pin": "B", "on": "boom"}}}, "mechanism.links.s"),
    ("excavator-boom", {"mechanism.slots": {"s": {"pin": "X", "on": "boom"}}}, "mechanism.links.s"),
    ("excavator-boom", {"mechanism.slots": {"s": {"pin": "B", "on": "nobody"}}}, "mechanism.slots.s.on"),
    ("excavator-boom", {"mechanism.slots": {"s": {"pin": "B", "through": "Q"}}}, "mechanism.slots.s.through"),
    ("excavator-boom", {"mechanism.slots": {"s": {"on": "frame"}}}, "mechanism.slots.s.pin"),
    ("excavator-boom", {"mechanism.slots": {"s": {"pin": "B", "curve": {"x": "50*cos(u)"}}}}, "mechanism.slots.s.curve"),
    ("excavator-boom", {"mechanism.slots": {"s": {"pin": 3}}}, "mechanism.slots.s.pin"),
    ("excavator-boom", {"mechanism.slots": {"s": {"pin": "B", "direction": "2 mm"}}}, "mechanism.slots.s.direction"),
]
"""A file, changes of its keys (None removes one), and the begin of the key that is named."""


@pytest.mark.parametrize(("name", "changes", "key"), CASES)
def test_what_is_wrong_is_named_with_its_key_and_a_remedy(name, changes, key):
    with pytest.raises(InputError) as caught:
        optlink.analyze(optlink.load(FILES[name], changes), points=12)
    for fault in caught.value.faults:
        assert (fault.key or "").startswith(key.rpartition(".")[0] if key[-1].isdigit() else key)
        assert fault.file.endswith(f"{name}.toml")
        assert fault.message
        assert fault.remedy
        assert "\n" not in f"{fault.message} {fault.remedy}"


def test_the_command_fails_with_two_and_a_sentence():
    done = CliRunner().invoke(app, ["analyze", str(FILES["excavator-boom"]), "--set", 'mechanism.cylinders.lift.closed="100 mm"'])
    assert done.exit_code == 2
    assert "mechanism.cylinders.lift.closed" in done.output
    assert "it can move in" in done.output
    assert "Traceback" not in done.output
