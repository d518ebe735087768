"""What is not supported is called so, with what to do instead; whoever follows the advice gets an analysis."""

import re

import pytest

import optlink
from optlink.errors import InputError
from optlink.unsupported import UNSUPPORTED, unsupported_key

GROUND = {"A": ["0 mm", "0 mm"], "D": ["300 mm", "0 mm"]}
CRANK = {"joints": ["A", "B"], "length": "80 mm"}
COUPLER = {"joints": ["B", "C"], "length": "280 mm"}
ROCKER = {"joints": ["D", "C"], "length": "200 mm"}
FOUR_BAR = {
    "ground": GROUND,
    "links": {"crank": CRANK, "coupler": COUPLER, "rocker": ROCKER},
    "assembly": {"C": "left of B-D"},
}
PAIR = {"ground": {"A": GROUND["A"]}, "links": {"crank": CRANK}}


def linkage(**links):
    return {**FOUR_BAR, "links": {**FOUR_BAR["links"], **links}}


CASES = {
    "gears": ({"mechanism": {**FOUR_BAR, "gears": {"pair": {"ratio": 3}}}}, "mechanism.gears", "gears are", "shaft behind them"),
    "gears on top": ({"mechanism": FOUR_BAR, "gear": [{"ratio": 3}]}, "gear", "gears are", "shaft behind them"),
    "teeth": (
        {"mechanism": linkage(crank={**CRANK, "teeth": 20})},
        "mechanism.links.crank.teeth",
        "gears are",
        "shaft behind them",
    ),
    "rack": ({"mechanism": {**FOUR_BAR, "racks": {}}}, "mechanism.racks", "racks are", "one side of the rack"),
    "rope": ({"mechanism": {**FOUR_BAR, "pulleys": {}}}, "mechanism.pulleys", "belts, chains and ropes are", "shaft behind them"),
    "cam": ({"mechanism": FOUR_BAR, "cam": {"rise": "5 mm"}}, "cam", "cams are", "optlink new law"),
    "curved guide": (
        {"mechanism": {**FOUR_BAR, "guides": {"G": {"slider": "coupler", "radius": "1 m"}}}},
        "mechanism.guides.G.radius",
        "curved guides are",
        "with its radius as length",
    ),
    "stop": ({"mechanism": {**FOUR_BAR, "stops": {"S": "30 deg"}}}, "mechanism.stops", "stops and contacts", "optlink analyze"),
    "acceleration": (
        {"mechanism": FOUR_BAR, "drive": {"acceleration": "5 rad/s^2"}},
        "drive.acceleration",
        "an acceleration of the crank is",
        "optlink simulate",
    ),
    "end": ({"mechanism": FOUR_BAR, "drive": {"end": "90 deg"}}, "drive.end", "a range of the driven body is", "optlink analyze"),
    "profile": ({"mechanism": FOUR_BAR, "drive": {"profile": []}}, "drive.profile", "speed that varies", "optlink simulate"),
    "speed over time": (
        {"mechanism": FOUR_BAR, "drive": {"speed": {"expression": "1 + sin(phi)", "unit": "rad/s"}}},
        "drive.speed",
        "a crank speed that varies in a given way is",
        "constant mean speed",
    ),
    "linear speed": (
        {"mechanism": FOUR_BAR, "drive": {"speed": "3 in/s"}},
        "drive.speed",
        "a drive along a guide",
        "pinned to the frame",
    ),
    "start of a ram": (
        {"mechanism": FOUR_BAR, "drive": {"start": "0.4 m"}},
        "drive.start",
        "a drive along a guide",
        "pinned to the frame",
    ),
    "driven slider": (
        {
            "mechanism": {
                "ground": {"A": GROUND["A"]},
                "links": {"truck": {"joints": ["T"]}, "bar": {"joints": ["T", "L"], "length": "1 m"}},
                "guides": {"G": {"slider": "truck", "through": "A"}},
            },
            "drive": {"body": "truck"},
        },
        "mechanism.links.truck.joints",
        "a drive along a guide",
        "pinned to the frame",
    ),
    "two motors": (
        {"mechanism": FOUR_BAR, "drive": {"body": ["crank", "rocker"], "speed": ["1 rpm", "2 rpm"]}},
        "drive.body",
        "exactly one body must be driven: several drives are",
        "hold each other one still",
    ),
    "motors": ({"mechanism": FOUR_BAR, "motors": {}}, "motors", "several drives are", "hold each other one still"),
    "driven coupler": (
        {"mechanism": FOUR_BAR, "drive": {"body": "coupler"}},
        "mechanism.links.coupler.joints",
        "a drive between two moving links is",
        r"pinned to the frame \(crank, rocker\)",
    ),
    "driven rocker of a four-bar": (
        {
            "mechanism": {"crank": "80 mm", "coupler": "280 mm", "rocker": "200 mm", "frame": "300 mm"},
            "drive": {"body": "rocker"},
        },
        "drive.body",
        "a drive of the rocker of a four-bar is",
        "Leave body out",
    ),
    "open chain": (
        {"mechanism": {**PAIR, "links": {**PAIR["links"], "arm": {"joints": ["B", "T"], "length": "70 mm"}}}},
        "mechanism.links.arm",
        "several drives and links that hang freely are",
        "list the points of it",
    ),
    "third crank": (
        {
            "mechanism": {
                **linkage(coupler={**COUPLER, "points": {"F": ["0 mm", "9 mm"]}}, more={"joints": ["E", "F"], "length": "80 mm"}),
                "ground": {**GROUND, "E": ["0 mm", "9 mm"]},
            }
        },
        "mechanism.links.more",
        "redundant bodies are",
        "leave it out",
    ),
    "load over time": (
        {"mechanism": FOUR_BAR, "loads": {"F": {"on": "rocker", "torque": {"over": "t", "at": ["0 s"], "values": ["1 N*m"]}}}},
        "loads.F.torque.over",
        "a load over time is",
        "Write it over phi",
    ),
    "pin friction": (
        {"mechanism": FOUR_BAR, "joints": {"B": {"friction": 0.2, "journal_radius": "5 mm"}}},
        "joints.B.friction",
        "friction in a pin without clearance is",
        "loads.friction_B",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_not_supported_is_called_so(case):
    raw, key, what, instead = CASES[case]
    with pytest.raises(InputError) as caught:
        optlink.read(raw)
    (fault,) = caught.value.faults
    assert fault.key == key
    assert re.search(what, fault.message)
    assert "not supported" in fault.message
    assert re.search(instead, fault.remedy)
    assert "Did you mean" not in str(fault)


def test_a_plate_on_two_pins_of_one_body_is_a_part_of_it():
    raw = {"mechanism": linkage(plate={**COUPLER, "points": {"H": ["100 mm", "90 mm"]}})}
    with pytest.raises(
        InputError, match=r"coupler and plate share the joints B and C, which makes them one body\. Give the points"
    ):
        optlink.read(raw)


def test_the_remedy_for_pin_friction_works():
    raw = {"mechanism": FOUR_BAR, "joints": {"C": {"friction": 0.2}}}
    with pytest.raises(InputError) as caught:
        optlink.read(raw)
    name, table = re.search(r"loads\.(\w+) = (\{.*\})", caught.value.faults[0].remedy).groups()
    from optlink.problem.assignment import parse_assignment

    _, load = parse_assignment(f"x={table}")
    result = optlink.analyze(optlink.read({"mechanism": FOUR_BAR, "loads": {name: load}, "drive": {"speed": "2 rad/s"}}))
    moved = result["coupler.omega_rad_s"] - result["rocker.omega_rad_s"]
    assert result["input.power_W"] == pytest.approx(0.2 * abs(moved), rel=1e-6, abs=1e-9)


def test_every_entry_says_what_and_what_instead():
    for name, item in UNSUPPORTED.items():
        assert re.search(r" (is|are)$", item.what), name
        assert not item.instead.endswith("."), name
        assert len(item.instead) < 260, name


@pytest.mark.parametrize(
    "key", ["mechanism.frane", "limits.end", "drive.spede", "requirement.range", "loads.a.profil", "mechanism.links.cam.lenght"]
)
def test_a_misspelt_key_is_unknown_not_unsupported(key):
    assert unsupported_key(key) is None
