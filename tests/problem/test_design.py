"""Design problems: keys of every kind of requirement, and what follows from the dimensions at the start of a law."""

import copy
import itertools
import math

import numpy as np
import pytest

import optlink
from optlink.linkage.motion import sweep
from optlink.problem.design import DesignProblem
from optlink.problem.requirements.kinds import REQUIREMENTS
from optlink.problem.requirements.laws import DEAD_CENTRES, TIED

LAW = {"law": "psi0 + 0.4*(phi - phi0)", "span": "100 deg"}
FOUR_BAR = {"crank": "20 mm", "coupler": "80 mm", "rocker": "60 mm", "frame": "90 mm"}
PLACE, DATUM = (0.013, -0.021), math.radians(37.0)


def of_kind(kind, **keys):
    shown = {**dict.fromkeys(("function", "dwell", "position"), "law-six-bar"), "motion": "motion-3-poses"}
    shown["stroke"] = "stroke-crank-rocker"
    raw = copy.deepcopy(dict(optlink.load(shown.get(kind, "path-arc5")).raw))
    raw.pop("expected", None)
    own = {"transmission": {"kind": kind}, "dwell": {"kind": kind, "over": "60 deg", "output": "rocker"}}
    own["position"] = {"kind": kind, "at": "60 deg", "value": "30 deg", "output": "rocker"}
    raw["requirement"] = own.get(kind, raw["requirement"])
    raw["requirement"] |= keys
    return raw


CASES = [
    (kind, key)
    for kind, other in itertools.permutations(REQUIREMENTS, 2)
    for key in REQUIREMENTS[other].model_fields
    if key not in REQUIREMENTS[kind].model_fields
]


@pytest.mark.parametrize(("kind", "key"), sorted(set(CASES)))
def test_a_key_of_another_kind_is_refused_with_that_kind(kind, key):
    with pytest.raises(optlink.InputError) as refused:
        optlink.read(of_kind(kind, **{key: "20 deg"}))
    (fault,) = refused.value.faults
    assert fault.key == f"requirement.{key}"
    assert fault.message == f"a {kind} has no {key}"
    named = fault.remedy.partition('kind = "')[2].rstrip('"')
    assert key in REQUIREMENTS[named].model_fields


def law(mechanism, **keys):
    return {"title": "t", "mechanism": mechanism, "requirement": {**LAW, **keys}, "limits": {"length_margin": 1e-4}}


def test_both_spellings_of_the_start_are_one_key():
    one, other = (optlink.read(law({**FOUR_BAR, "coupler": "70..90 mm"}, **{key: "40 deg"})) for key in ("from", "start"))
    assert one.hash == other.hash
    assert one.override({"requirement.start": "50 deg"}).hash == other.override({"requirement.from": "50 deg"}).hash
    assert one.at("requirement.start") == "40 deg"
    both = law({**FOUR_BAR, "coupler": "70..90 mm"}, **{"from": "40 deg", "start": "40 deg"})
    with pytest.raises(optlink.InputError, match="are the same key"):
        optlink.read(both)
    for key in ("from", "start"):
        with pytest.raises(optlink.InputError, match=rf"requirement\.{key}.*beyond one revolution"):
            optlink.read(law({**FOUR_BAR, "coupler": "70..90 mm"}, **{key: "400 deg"}))


def test_the_rocker_is_the_output_of_a_four_bar():
    free = {**FOUR_BAR, "coupler": "70..90 mm"}
    named = optlink.read(law(free, output="rocker")).model
    assert named.output == optlink.read(law(free)).model.output == "rocker"
    with pytest.raises(optlink.InputError, match=r"requirement\.output.*is one of its rocker"):
        optlink.read(law(free, output="coupler"))
    with pytest.raises(optlink.InputError, match=r"limits\.pivots.*does not depend on the position"):
        optlink.read({**law(free), "limits": {"pivots": {"x": ["0 mm", "90 mm"]}}})


def test_the_output_at_the_start_is_the_default_of_a_four_bar():
    free = {**FOUR_BAR, "coupler": "70..90 mm"}
    stated, default = (optlink.read(law(free, **keys)).model for keys in ({"psi0": TIED}, {}))
    assert stated.tied
    assert default.tied
    assert stated.complete({}) == default.complete({})
    function = {"function": "x**2", "x": [0, 1], "input": "60 deg", "output": "30 deg"}
    with pytest.raises(optlink.InputError, match="the output at its least y"):
        optlink.read({**law(free), "requirement": {"law": function, "psi0": TIED}})


def dyads(*, side, reverse, swap, **keys):
    """The four-bar as dyads, turned and moved; `reverse`: the rocker is directed from C to D, `swap`: its group begins there."""
    x, y = PLACE[0] + 0.09 * math.cos(DATUM), PLACE[1] + 0.09 * math.sin(DATUM)
    rocker = {"joints": ["C", "D"] if reverse else ["D", "C"], "length": "60 mm"}
    links = {"coupler": {"joints": ["B", "C"], "length": {"bounds": ["70 mm", "90 mm"]}}, "rocker": rocker}
    links = dict(reversed(links.items())) if swap else links
    mechanism = {
        "type": "dyads",
        "ground": {"A": [f"{PLACE[0]!r} m", f"{PLACE[1]!r} m"], "D": [f"{x!r} m", f"{y!r} m"]},
        "links": {"crank": {"joints": ["A", "B"], "length": "20 mm"}, **links},
        "assembly": {"C": f"{side} of B-D"},
    }
    return DesignProblem.model_validate(
        {"title": "t", "mechanism": mechanism, "requirement": {**LAW, "output": "rocker", **keys}}
    )


@pytest.mark.parametrize("start", DEAD_CENTRES)
@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize(("reverse", "swap"), list(itertools.product([False, True], repeat=2)))
def test_dyads_start_at_a_dead_centre_of_their_four_bar(start, side, reverse, swap):
    """The rocker rests there, crank and coupler are in line, and psi0 is the angle of the rocker, by the motion alone."""
    problem = dyads(side=side, reverse=reverse, swap=swap, start=start)
    assert problem.free == ("coupler.length",)
    for coupler in (0.074, 0.081):
        values = problem.complete({"coupler.length": coupler})
        begin, step = values["start"], 1e-4
        motion = sweep(problem.linkage, values, np.array([begin - step, begin, begin + step]))
        angle = np.unwrap(motion.body_angle("rocker").value)
        assert abs(angle[2] - angle[0]) / (2.0 * step) < 1e-7
        a, c = motion.position("A")[1], motion.position("C")[1]
        assert np.linalg.norm(c - a) == pytest.approx(coupler + (0.02 if start == DEAD_CENTRES[0] else -0.02), rel=1e-12)
        assert math.remainder(values["zero"] - angle[1], math.tau) == pytest.approx(0.0, abs=1e-12)
        section = optlink.read(law({**FOUR_BAR, "coupler": "70..90 mm", "assembly": side}, start=start)).model
        same = section.complete({"coupler": coupler})
        assert math.remainder(begin - same["phi0"] - DATUM, math.tau) == pytest.approx(0.0, abs=1e-12)
    columns = problem.complete({"coupler.length": np.array([0.074, 0.081])})
    assert columns["start"][1] == begin


def test_only_the_rocker_of_a_four_bar_has_known_dead_centres():
    raw = dict(optlink.load("law-slider-crank").raw)
    raw.pop("expected", None)
    with pytest.raises(optlink.InputError, match="its dead centres are not known"):
        optlink.read({**raw, "requirement": {**raw["requirement"], "start": DEAD_CENTRES[0]}})
