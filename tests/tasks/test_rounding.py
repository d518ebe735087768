"""Sizes on a grid: the best design against enumeration by closed forms, and what is said where none is valid."""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

import optlink
from optlink.errors import InputError, Status
from optlink.problem.rounding import Grid
from optlink.problem.templates import template, templates
from optlink.tasks import rounding
from optlink.tasks.results.rounding import Rounding
from optlink.tasks.rounding import read_steps, rounded
from tests.solved import solution
from tests.tasks.test_element_designs import SWINGING

STEP = 2e-3  # m
LENGTHS = {"crank": (10, 60), "coupler": (40, 140), "rocker": (40, 140)}  # mm, beside a frame of 100 mm


def crank_rockers(crank, coupler, rocker, frame):
    """Swing [rad], time ratio and largest pressure angle [rad] of crank-rockers, by the cosine rule; NaN for others."""

    def angle(opposite, one, other):
        with np.errstate(divide="ignore", invalid="ignore"):
            cosine = (one**2 + other**2 - opposite**2) / (2.0 * one * other)
        return np.arccos(np.where(np.abs(cosine) <= 1.0, cosine, np.nan))

    swing = angle(coupler + crank, frame, rocker) - angle(coupler - crank, frame, rocker)
    between = np.abs(angle(rocker, coupler + crank, frame) - angle(rocker, coupler - crank, frame))
    pressure = np.maximum(*(np.abs(0.5 * np.pi - angle(frame + side * crank, coupler, rocker)) for side in (-1, 1)))
    sizes = np.sort(np.stack(np.broadcast_arrays(crank, coupler, rocker, frame)), axis=0)
    turns = (sizes[0] + sizes[3] < sizes[1] + sizes[2]) & (crank == sizes[0])
    return tuple(np.where(turns, each, np.nan) for each in (swing, (np.pi + between) / (np.pi - between), pressure))


def wanted(seed):
    """A random problem of a swing and a time ratio with tolerances, made from a crank-rocker; and its text."""
    random = np.random.default_rng(seed)
    while True:
        sizes = [1e-3 * random.uniform(*ends) for ends in LENGTHS.values()]
        swing, ratio, pressure = (float(each) for each in crank_rockers(*sizes, 0.1))
        if math.isfinite(swing) and pressure < math.radians(60.0) and 1.02 < ratio < 1.5:
            break
    text = f"""
[mechanism]
type = "four-bar"
frame = "100 mm"
{"".join(f'{name} = {{ bounds = ["{low} mm", "{high} mm"] }}{chr(10)}' for name, (low, high) in LENGTHS.items())}
[requirement]
kind = "stroke"
stroke = "{math.degrees(swing):.2f} deg +- 1 deg"
time_ratio = "{ratio:.3f} +- 0.02"
"""
    return text, (round(math.degrees(swing), 2), round(ratio, 3))


def enumerated(swing, ratio):
    """Least largest pressure angle [rad] on the grid, and its sizes [m]."""
    ends = [(math.ceil(1e-3 * low / STEP - 1e-9), math.floor(1e-3 * high / STEP + 1e-9)) for low, high in LENGTHS.values()]
    grids = [STEP * np.arange(low, high + 1) for low, high in ends]
    sizes = np.meshgrid(*grids, indexing="ij")
    made = crank_rockers(*sizes, 0.1)
    meets = (np.abs(np.degrees(made[0]) - swing) <= 1.0 + 1e-9) & (np.abs(made[1] - ratio) <= 0.02 + 1e-9)
    objective = np.where(meets, made[2], np.inf)
    best = np.unravel_index(np.argmin(objective), objective.shape)
    return float(objective[best]), [float(size[best]) for size in sizes]


def compare(seed, folder):
    """Solve a random problem with rounded sizes and enumerate its grid; return both results and programmes solved."""
    text, (swing, ratio) = wanted(seed)
    file = folder / f"random-{seed}.toml"
    file.write_text(text)
    result = optlink.solve(str(file), rounding="2 mm")
    return result, enumerated(swing, ratio)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_the_best_design_on_the_grid_is_that_of_an_enumeration(seed, tmp_path):
    result, (objective, sizes) = compare(seed, tmp_path)
    assert result.valid == math.isfinite(objective)
    if result.valid:
        assert result.objective == pytest.approx(objective, rel=1e-9)
        assert [result.design[name] for name in LENGTHS] == pytest.approx(sizes, rel=1e-12)


def test_rounded_sizes_of_a_law_are_valid_and_not_worse_than_the_nearest(tmp_path):
    whole = solution("crank-rocker")
    result = optlink.solve("crank-rocker", certify=False, rounding="0.1 mm")
    rounding = result.rounding
    assert result.valid
    assert result.status is Status.ROUNDED
    assert rounding.whole
    for name in ("coupler", "rocker"):
        assert result.design[name] * 1e4 == pytest.approx(round(result.design[name] * 1e4), abs=1e-9)
    assert whole.objective < result.objective < whole.objective * 1.002
    assert not rounding.naive_valid  # the transmission angle is at its limit
    again = optlink.read_result(_written(result, tmp_path))
    assert again.rounding == rounding
    assert again.message == result.message
    checked = optlink.validate("crank-rocker", {name: result.design[name] for name in ("coupler", "rocker")})
    assert checked.valid
    assert checked.objective == pytest.approx(result.objective, rel=1e-9)


def _written(result, folder):
    result.write(folder)
    return folder


def test_the_nearest_sizes_of_a_law_begin_at_their_own_dead_centre():
    """The crank angles of a law that begins there follow from the rounded sizes."""
    problem = optlink.load("crank-rocker", {"limits.transmission_angle": ["40 deg", "140 deg"], "mechanism.coupler": "412.9 mm"})
    result = optlink.solve(problem, certify=False, rounding="1 mm")
    assert result.valid
    assert result.rounding.naive_valid
    others = [optlink.validate(problem, {"rocker": size}).objective for size in (0.230, 0.231, 0.232)]
    assert result.objective == pytest.approx(min(others), rel=1e-9)


SMALL = """
title = "Shortest crank-rocker of a swing"
[mechanism]
type = "four-bar"
frame = "40 mm"
crank = { bounds = ["5 mm", "12 mm"] }
coupler = { bounds = ["34 mm", "42 mm"] }
rocker = { bounds = ["10 mm", "21 mm"] }
[objective]
quantity = "total length"
[limits]
slant = { quantity = "transmission angle", of = "C", measure = "largest", max = "138 deg" }
swing = { quantity = "stroke", of = "rocker", exactly = "67 deg +- 0.4 deg" }
"""


@pytest.mark.slow
def test_a_part_of_the_grid_without_a_design_near_the_start_is_searched_from_its_middle():
    sizes = np.meshgrid(np.arange(5, 13), np.arange(34, 43), np.arange(10, 22), indexing="ij")
    swing, _, pressure = crank_rockers(*(size.astype(float) for size in sizes), 40.0)
    meets = (np.abs(np.degrees(swing) - 67.0) <= 0.4) & (np.degrees(pressure) <= 48.0)
    least = 1e-3 * (40.0 + np.min(sum(sizes)[meets]))
    result = optlink.solve(optlink.read(SMALL), starts=1, certify=False, rounding="1 mm")
    assert result.objective == pytest.approx(least, rel=1e-9)


ANY_SIZE = """
title = "Transmission of any size"
[mechanism]
type = "four-bar"
crank = { bounds = ["5 mm", "40 mm"] }
coupler = { bounds = ["30 mm", "130 mm"] }
rocker = { bounds = ["20 mm", "120 mm"] }
frame = { bounds = ["50 mm", "120 mm"] }
assembly = "left"
[requirement]
kind = "transmission"
[limits]
swing_angle = "40.3 deg +- 1.5 deg"
time_ratio = "1.109 +- 0.02"
"""
STOCK = {  # mm
    "crank": [11, 19, 20, 27, 28, 39],
    "coupler": [42, 62, 75, 97, 105],
    "rocker": [20, 25, 81, 104, 105, 108],
    "frame": [91, 107, 118],
}


@pytest.mark.slow
def test_no_part_of_the_grid_is_discarded_for_one_local_optimum():
    """All lengths are free, so a box holds the optimum at another scale, and a search of one place may end at a worse one."""
    sizes = np.meshgrid(*(np.array(stock, dtype=float) for stock in STOCK.values()), indexing="ij")
    swing, ratio, pressure = crank_rockers(*sizes)
    meets = (np.abs(np.degrees(swing) - 40.3) <= 1.5) & (np.abs(ratio - 1.109) <= 0.02)
    problem = optlink.read(ANY_SIZE)
    found = optlink.solve(problem, starts=1, certify=False)
    grids = read_steps(problem, {name: [f"{size} mm" for size in stock] for name, stock in STOCK.items()})
    result = rounded(replace(found, designs=found.designs[:1]), grids)
    assert result.rounding.whole
    assert result.objective == pytest.approx(np.min(np.sin(pressure[meets])), rel=1e-9)


@pytest.mark.slow
def test_an_exact_requirement_asks_for_tolerances():
    result = optlink.solve("stroke-crank-rocker", starts=1, rounding="0.1 mm")
    assert not result.valid
    assert set(result.rounding.needed) == {"stroke of rocker", "time ratio of rocker"}
    swing, ratio, _ = crank_rockers(*(result.design[name] for name in LENGTHS), 0.1)
    assert float(result.rounding.needed["stroke of rocker"].removeprefix("+- ").removesuffix(" deg")) >= abs(
        math.degrees(swing) - 50.0
    )
    assert float(result.rounding.needed["time ratio of rocker"].removeprefix("+- ")) >= abs(ratio - 1.25)


def test_limits_of_a_four_bar_are_named_with_the_tolerances_that_the_nearest_design_needs():
    stock = {"crank": ["20 mm"], "coupler": ["258.9 mm", "259 mm"], "rocker": ["31.1 mm", "31.2 mm"]}
    changes = {"mechanism.frame": "260 mm", "limits.swing_angle": "80 deg"}
    problem = optlink.read(template("wiper").text, "wiper").override(changes)
    result = optlink.solve(problem, starts=1, certify=False, rounding=stock)
    assert not result.valid
    swing, ratio, _ = crank_rockers(*(result.design[name] for name in LENGTHS), 0.26)
    needed = result.rounding.needed
    tolerance = float(needed["swing angle"].removeprefix("+- ").removesuffix(" deg"))
    most = float(needed["time ratio, equal strokes"].removeprefix("1 ... "))
    assert 0.0 <= tolerance - abs(math.degrees(swing) - 80.0) < 0.005
    assert 0.0 <= most - max(ratio, 1.0 / ratio) < 1e-5
    allowed = {"limits.swing_angle": f"80 deg +- {tolerance} deg", "limits.time_ratio": [1, most]}
    again = optlink.solve(problem.override(allowed), starts=1, certify=False, rounding=stock)
    assert again.valid


MADE = {  # problem, tolerances, objective without and with sizes of 0.1 mm, whether the whole grid was searched
    "crank-rocker": ({}, 7.59236671e-3, 7.59307975e-3, True),
    "wiper": ({"limits.swing_angle": "90 deg +- 0.5 deg", "limits.time_ratio": "1..1.01"}, 0.706585305, 0.707355783, True),
    "press-toggle": (
        {"limits.stroke.exactly": "65 mm +- 0.1 mm", "limits.bottom.exactly": "598.9 mm +- 0.1 mm"},
        288.407,
        288.956,
        False,
    ),
    "shaper-design": (
        {"limits.stroke.exactly": "500 mm +- 0.2 mm", "limits.time_ratio.exactly": "1.8 +- 0.005"},
        1.00032454,
        1.00037265,
        False,
    ),
    "law-six-bar": ({}, 1.5290697e-3, 1.5291848e-3, False),
    "quick-return-press": ({}, 174.759038, 174.791126, True),
    "toggle-press": ({}, 211.262633, 211.474657, True),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MADE)
def test_rounded_sizes_lose_little_and_are_valid_as_built(name):
    changes, optimum, objective, whole = MADE[name]
    file = optlink.read(template(name).text, name) if name in templates() else optlink.load(name)
    problem = file.override(changes) if changes else file
    result = optlink.solve(problem, certify=False, rounding="0.1 mm")
    found = result.rounding
    assert result.valid
    assert (found.objective, result.objective) == pytest.approx((optimum, objective), rel=1e-5)
    assert found.loss(result.objective) < 0.002
    assert found.whole == whole
    assert not found.naive_valid or result.objective <= found.naive
    for size in found.steps:
        assert result.design[size] * 1e4 == pytest.approx(round(result.design[size] * 1e4), abs=1e-9)
    checked = optlink.validate(problem, {size: result.design[size] for size in result.definite.model.free})
    assert checked.valid
    assert checked.objective == pytest.approx(result.objective, rel=1e-9)
    if name == "press-toggle":
        assert {one.limit for one in found.influences if one.one_sided} >= {"peak reaction at B", "least transmission angle at C"}


def test_a_limit_of_one_side_is_needed_with_the_value_of_the_nearest_design():
    limit = {"quantity": "transmission angle", "of": "C", "measure": "least", "min": "60 deg"}
    changes = {"requirement.stroke": "50 deg +- 20 deg", "requirement.time_ratio": "1.25 +- 0.2", "limits.transmission": limit}
    stock = {"crank": ["36 mm", "37 mm"], "coupler": ["76 mm"], "rocker": ["93 mm"]}
    result = optlink.solve(optlink.load("stroke-crank-rocker", changes), starts=1, rounding=stock)
    assert not result.valid
    (words,) = result.rounding.needed.values()
    *_, pressure = crank_rockers(*(result.design[name] for name in LENGTHS), 0.1)
    needed = float(words.removeprefix(">= ").removesuffix(" deg"))
    assert needed <= 90.0 - math.degrees(pressure) < needed + 1.0


def test_stock_sizes():
    stock = ["200 mm", "225 mm", "230 mm", "240 mm"]
    result = optlink.solve("crank-rocker", certify=False, rounding={"step": "1 mm", "rocker": stock})
    assert result.valid
    assert f"{1e3 * result.design['rocker']:.9g} mm" in stock
    assert result.design["coupler"] * 1e3 == pytest.approx(round(result.design["coupler"] * 1e3), abs=1e-9)


SECTION = {"rounding": {"step": "1 mm", "rocker": {"step": "5 mm", "from": "2 mm"}}}


def test_the_section_of_a_file_rounds_unless_told_otherwise(tmp_path):
    problem = optlink.load("crank-rocker", SECTION)
    result = optlink.solve(problem)
    assert result.valid
    assert any("[rounding]" in note for note in result.notes)
    assert (result.design["rocker"] - 2e-3) * 200.0 == pytest.approx(round((result.design["rocker"] - 2e-3) * 200.0), abs=1e-9)
    assert result.design["coupler"] * 1e3 == pytest.approx(round(result.design["coupler"] * 1e3), abs=1e-9)
    assert result.rounding.steps == {"coupler": "1 mm", "rocker": "5 mm from 2 mm"}
    result.write(tmp_path)
    again = optlink.read_result(tmp_path)
    assert (again.rounding, again.design, again.notes) == (result.rounding, result.design, result.notes)
    assert again.problem.hash == problem.hash
    other = optlink.solve(problem, certify=False, rounding="0.1 mm")
    assert other.rounding.steps == {"coupler": "0.1 mm", "rocker": "0.1 mm"}
    assert not any("[rounding]" in note for note in other.notes)
    whole = optlink.solve(problem, rounding="none")
    assert whole.rounding is None
    assert whole.objective < other.objective < result.objective
    assert whole.certificate is not None  # as of the same file without the section


def test_the_section_belongs_to_the_identity_of_a_problem():
    """The result of `solve` depends on it; the problem without the section keeps its identity."""
    plain, rounded_ = optlink.load("crank-rocker"), optlink.load("crank-rocker", SECTION)
    hashes = {plain.hash, rounded_.hash, rounded_.override({"rounding.step": "2 mm"}).hash}
    assert len(hashes) == 3
    assert rounded_.override({"rounding": None}).hash == plain.hash
    assert rounded_.override({"rounding.rocker": None, "rounding.step": None}).hash == plain.hash


def test_a_fixed_size_needs_no_grid():
    problem = optlink.load("crank-rocker", SECTION | {"mechanism.rocker": "232.3 mm"})
    assert read_steps(problem, None) == {"coupler": Grid(1e-3)}
    with pytest.raises(InputError, match="rocker is no free size"):
        read_steps(problem, {"rocker": "1 mm"})


def test_coordinates_may_be_nested():
    nested = {"rounding": {"A": {"x": "25 mm", "y": {"step": "25 mm", "from": "12.5 mm"}}}}
    problem = optlink.load("press-toggle", nested)
    assert read_steps(problem, None) == {"A.x": Grid(0.025), "A.y": Grid(0.025, origin=0.0125)}
    changed = problem.override({"rounding.A.x": None, "rounding.A.y": "50 mm"})
    assert read_steps(changed, None) == {"A.y": Grid(0.05)}


def test_a_ratio_of_gears_has_whole_numbers_of_teeth():
    problem = optlink.read(SWINGING).override({"rounding.mesh.ratio": {"teeth": [17, 40]}})
    best = optlink.solve(problem, rounding="none").design["mesh.ratio"]
    ratios = [one / other for one in range(17, 41) for other in range(17, 41)]
    result = optlink.solve(problem)
    assert result.valid
    assert result.design["mesh.ratio"] == pytest.approx(-min(each for each in ratios if each >= -best), rel=1e-12)
    one, other = (int(each) for each in result.rounding.steps["mesh.ratio"].partition(" ")[0].split(":"))
    assert -one / other == pytest.approx(result.design["mesh.ratio"], rel=1e-12)
    assert 17 <= min(one, other) <= max(one, other) <= 40


def test_sizes_of_a_grid_have_its_digits():
    """535 times 0.0001 is 0.053500000000000006 in doubles."""
    assert Grid(step=1e-4).nearest(0.05351) == 0.0535
    made = optlink.solve("crank-rocker", rounding={"step": "0.1 mm"}).best.machine.raw["mechanism"]
    assert all(len(made[name]) <= len("412.9 mm") for name in ("coupler", "rocker")), made


def test_grids():
    step, stock = Grid(step=1e-3), Grid(stock=(0.1, 0.2))
    assert (step.below(0.0123), step.above(0.0123)) == pytest.approx((0.012, 0.013))
    assert (step.below(0.012), step.above(0.012)) == pytest.approx((0.012, 0.012))
    assert (stock.below(0.15), stock.above(0.15), stock.nearest(0.16)) == (0.1, 0.2, 0.2)
    assert (stock.below(0.05), stock.above(0.25)) == (-math.inf, math.inf)
    assert (step.off(0.0125), step.off(0.013), stock.off(0.2)) == pytest.approx((0.5, 0.0, 0.0))


SECTIONS_REFUSED = [
    ({"foo": "1 mm"}, "rounding.foo.*no such size"),
    ({"step": ["1 mm"]}, "rounding.step.*a single step is needed"),
    ({"step": "0 mm"}, "rounding.step.*must be positive"),
    ({"rocker": {"from": "1 mm"}}, "rounding.rocker.*a grid is a step"),
    ({"rocker": {"step": "1 mm", "pitch": "1 mm"}}, "rounding.rocker.pitch.*unknown key"),
    ({"rocker": {"teeth": [12, 60]}}, "rounding.rocker.teeth.*only the ratio of two gears has teeth"),
    ("1 mm", "rounding.*expected a table"),
]


@pytest.mark.parametrize(("section", "message"), SECTIONS_REFUSED)
def test_what_a_section_cannot_state(section, message):
    with pytest.raises(InputError, match=message):
        optlink.load("crank-rocker", {"rounding": section})


@pytest.mark.parametrize("teeth", [[60, 12], [0, 12], [12.0, 60.0], [12], [12, 4000]])
def test_numbers_of_teeth_are_two_whole_ones(teeth):
    with pytest.raises(InputError, match=r"rounding.mesh.ratio.teeth.*two whole numbers"):
        optlink.read(SWINGING).override({"rounding.mesh.ratio": {"teeth": teeth}})


REFUSED = [
    ("0 mm", "a length must be positive"),
    ({"rocker": ["-5 mm"]}, "a length must be positive"),
    ("1 kg", "not a unit of length"),
    ({"frame": "1 mm"}, "frame is no free size"),
    ({"foo": "1 mm"}, "no such size"),
    ({"rocker": []}, "the stock has no size"),
]


@pytest.mark.parametrize(("steps", "message"), REFUSED)
def test_what_cannot_be_rounded(steps, message):
    with pytest.raises(InputError, match=message):
        read_steps(optlink.load("crank-rocker"), steps)


@pytest.mark.slow
def test_a_mirrored_linkage_has_the_mirrored_sizes(monkeypatch):
    """Also where a box has one value, below zero; the designs beside the optimum alone would not show it."""
    monkeypatch.setattr(rounding, "CORNERS", 0)
    results = []
    for bounds in (["1 mm", "50 mm"], ["-50 mm", "-1 mm"]):
        changes = {"requirement.stroke": "100 mm +- 2 mm", "requirement.time_ratio": "1.2 +- 0.05"}
        problem = optlink.load("stroke-slider-crank", {**changes, "mechanism.guides.G.offset": {"bounds": bounds}})
        results.append(optlink.solve(problem, rounding={"step": "5 mm", "G.offset": "50 mm"}))
    above, below = results
    assert above.valid
    assert below.valid
    assert below.objective == pytest.approx(above.objective, rel=1e-9)
    assert below.design["G.offset"] == pytest.approx(-above.design["G.offset"], abs=1e-12)
    assert above.design["G.offset"] == pytest.approx(0.05, abs=1e-12)


def test_a_bound_may_lie_on_the_grid_but_for_rounding():
    problem = optlink.load("crank-rocker", {"mechanism.coupler": {"bounds": ["412 mm", "413 mm"]}})
    design = optlink.solve(problem, certify=False).designs[0]
    search = next(rounding._searches(design, read_steps(problem, "1 mm"), "ipopt"))
    high = np.array([0.413 * (1.0 + 1e-15), 0.231])
    end = search.within(high, high, search.top)
    assert search.sizes(end) == pytest.approx([0.413, 0.231], rel=1e-14)


def test_a_proof_of_rounded_sizes_is_refused():
    with pytest.raises(InputError, match="a proof is one of sizes that are not rounded"):
        optlink.solve("crank-rocker", certify=True, rounding="1 mm")


def test_an_interrupted_search_says_that_its_sizes_are_not_rounded():
    result = optlink.solve("crank-rocker", certify=False)
    ended = rounded(replace(result, interrupted=True), read_steps(result.problem, "1 mm"))
    assert ended.notes[-1] == "the sizes are not rounded: the search was interrupted"
    assert ended.rounding is None


@pytest.mark.parametrize(("where", "found"), [("run", True), ("build", False)])
def test_an_interrupted_search_of_the_grid_keeps_what_it_has(where, found, monkeypatch):
    complete = getattr(rounding._Search, where)

    def interrupted(*arguments):
        complete(*arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(rounding._Search, where, interrupted)
    result = optlink.solve("crank-rocker", certify=False, rounding="0.1 mm")
    assert result.valid
    assert result.interrupted
    assert (result.rounding is not None) == found
    if found:
        assert not result.rounding.whole
        assert result.status is Status.ROUNDED
    else:
        assert result.notes[-1] == "the sizes are not rounded: the search of the grid was interrupted"


@pytest.mark.slow
def test_the_search_of_many_sizes_ends_and_betters_the_nearest_sizes():
    """A path that is met exactly has no active limit: its model has far more designs than can be tried."""
    result = optlink.solve(optlink.read(template("path").text, "path"), designs=1, starts=64, rounding="0.1 mm")
    assert result.valid
    assert len(result.rounding.steps) == 8
    assert result.rounding.naive_valid
    assert result.objective < 0.1 * result.rounding.naive
    assert result.message.endswith("not all of it; exact without rounding")


def test_a_large_share_of_a_small_optimum_is_told_with_it():
    found = Rounding({"a": "1 mm"}, {"a": 1.0}, 2e-8, None, naive_valid=False, solved=1, whole=True)
    assert found.ended(2.5e-8, "0.02 mm^2").endswith("; +25 % of 0.02 mm^2 by rounding")
    assert found.ended(2.004e-8, "0.02 mm^2").endswith("; +0.20 % by rounding")
    assert found.ended(2.1e-7, "0.02 mm^2").endswith("; +950 % of 0.02 mm^2 by rounding")
    assert found.ended(2.3e-7, "0.02 mm^2").endswith("; 0.02 mm^2 without rounding")
    assert replace(found, objective=0.0).ended(2.3e-7, "0 mm^2").endswith("; exact without rounding")


def test_a_kind_without_sizes_is_refused():
    with pytest.raises(InputError, match="the sizes of this kind of problem are not rounded"):
        optlink.solve("balance-six-bar", rounding="1 mm")


if __name__ == "__main__":
    import pathlib
    import tempfile

    for number in range(int(sys.argv[1]), int(sys.argv[2])):
        with tempfile.TemporaryDirectory() as name:
            one, (least, at) = compare(number, pathlib.Path(name))
        print(number, one.valid, one.objective, least, one.rounding.solved, one.objective / least - 1.0, flush=True)
