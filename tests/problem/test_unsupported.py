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
