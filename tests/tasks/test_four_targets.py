"""Problems with four points of a function or of a slide, or four timed points: the best linkages of the family that is left."""

import math

import numpy as np
import pytest

import optlink
from tests.synthesis.test_five_poses import cranked
from tests.tasks.test_exact_solutions import LENGTHS, PLACED, motion_of

FREE = {"bounds": ["-360 deg", "360 deg"]}
ALONG = {"bounds": ["-20 m", "20 m"]}
LIMITS = {"transmission_angle": ["0.1 deg", "179.9 deg"], "alignment": "0.1 deg"}


def degrees(angle):
    return f"{math.degrees(angle)!r} deg"


def table(phi, out, name):
    stated = [degrees(y) if name == "psi" else f"{y!r} m" for y in (out - out[0]).tolist()]
    return {"phi": [degrees(x) for x in (phi - phi[0]).tolist()], name: stated}


def function(seed, count):
    """A file for positions of the rocker of a known crank-rocker, whose sizes and start angles are returned too."""
    sizes, phi, *_ = cranked(np.random.default_rng(seed))
    psi, _ = motion_of(sizes, phi, 1)
    law = table(phi[:count], psi[:count], "psi")
    mechanism = {"type": "four-bar", **LENGTHS, "frame": "100 mm", "assembly": "either"}
    requirement = {"kind": "function", "law": law, "from": FREE, "psi0": FREE}
    raw = {"title": "points of a function", "mechanism": mechanism, "requirement": requirement, "limits": LIMITS}
    return raw, [0.1 * size for size in sizes], (phi[0], psi[0])


def slide(seed, count):
    """A file for positions of the slider of a known slider-crank, whose sizes and starts are returned too."""
    rng = np.random.default_rng(seed)
    a, b, offset = rng.uniform(0.02, 0.06), rng.uniform(0.1, 0.2), rng.uniform(-0.03, 0.03)
    phi = rng.uniform(0.0, math.tau) + np.cumsum(rng.uniform(0.2, 0.7, 5))[:count]
    out = a * np.cos(phi) + np.sqrt(b * b - (offset - a * np.sin(phi)) ** 2)
    links = {
        "crank": {"joints": ["A", "B"], "length": LENGTHS["crank"]},
        "rod": {"joints": ["C", "B"], "length": LENGTHS["crank"]},
        "slider": {"joints": ["C"]},
    }
    guide = {"slider": "slider", "through": "A", "direction": "40 deg", "offset": ALONG}
    mechanism = {"type": "dyads", "ground": {"A": ["3 mm", "-2 mm"]}, "links": links, "guides": {"G": guide}}
    requirement = {"kind": "function", "law": table(phi, out, "s"), "output": "G", "start": FREE, "zero": ALONG}
    raw = {"mechanism": {**mechanism, "assembly": {"C": "either"}}, "requirement": requirement}
    return {"title": "points of a slide", **raw, "limits": {"alignment": "0.1 deg"}}, (a, b, offset), (phi[0], out[0])


def timed(seed):
    rng = np.random.default_rng(seed)
    sizes, phi, *_ = cranked(rng)
    _, points = motion_of(sizes, phi[:4], -1)
    offsets = (phi - phi[0]).tolist()
    rows = [
        {"x": f"{x!r} m", "y": f"{y!r} m", "crank": degrees(at)}
        for (x, y), at in zip(points[:, :2].tolist(), offsets, strict=False)
    ]
    requirement = {"kind": "path", "timing": "from start", "points": rows}
    return {"title": "timed points", "mechanism": PLACED, "requirement": requirement, "limits": LIMITS}, sizes, phi[0]


def least_angle(a, b, c, frame):
    """Least distance of the transmission angle from 0 and 180 deg over a revolution [rad]."""
    ends = [(b * b + c * c - (frame + way * a) ** 2) / (2.0 * b * c) for way in (1.0, -1.0)]
    return min(math.acos(min(1.0, abs(one))) for one in ends)


def check(result, known):
    """The linkages listed are exact, ranked, and not worse than one that is known to be in the family."""
    angles = [design.least_transmission for design in result.designs]
    assert len(angles) > 1
    assert angles == sorted(angles, reverse=True)
    assert angles[0] >= known - 1e-9
    assert all(design.exact and design.valid for design in result.designs)


def test_four_points_of_a_function_have_a_family_of_four_bars():
    raw, sizes, _ = function(0, 4)
    result = optlink.synthesis.exact(optlink.read(raw))
    check(result, least_angle(*sizes, 0.1))
    assert result.exact_solutions.sentence.startswith(
        "four points of a function: 2 closed curves of couplers; 60.3% of 1000 four-bars"
    )
    short = optlink.synthesis.exact(optlink.read(raw), by="total length").designs[0]
    assert sum(short.values[name] for name in ("crank", "coupler", "rocker")) <= sum(sizes)


@pytest.mark.slow
def test_no_random_search_finds_a_better_four_bar():
    file = optlink.read(function(0, 4)[0])
    searched = optlink.solve(file, starts=20, designs=2)
    assert searched.best.exact
    most = max(one.least_transmission for one in searched.designs)
    assert most <= optlink.synthesis.exact(file).best.least_transmission + 1e-3


@pytest.mark.slow
def test_four_points_of_a_slide_have_a_family_of_slider_cranks():
    raw, (a, b, offset), _ = slide(0, 4)
    result = optlink.synthesis.exact(optlink.read(raw))
    check(result, math.acos(max(abs(offset + way * a) for way in (1.0, -1.0)) / b))
    assert "slider-cranks pass the positions in order" in result.exact_solutions.sentence


@pytest.mark.slow
def test_four_timed_points_have_a_family_of_four_bars():
    raw, sizes, _ = timed(0)
    result = optlink.synthesis.exact(optlink.read(raw))
    check(result, least_angle(*sizes, 1.0))
    assert "closed curve of cranks" in result.exact_solutions.sentence


def test_three_points_from_given_starts_have_one_linkage():
    """With the output a half turn further, a length would be negative."""
    raw, sizes, (start, base) = function(0, 3)
    raw["requirement"] |= {"from": degrees(start), "psi0": degrees(base)}
    result = optlink.synthesis.exact(optlink.read(raw))
    assert [result.design[name] for name in ("crank", "coupler", "rocker")] == pytest.approx(sizes, rel=1e-9)
    turned = optlink.read(raw).override({"requirement.psi0": degrees(base - math.pi)})
    (one,) = optlink.synthesis.exact(turned).exact_solutions.solutions
    assert any(reason.startswith("outside your bounds: psi0 ") for reason in one.reasons)
    raw, (a, b, offset), (start, base) = slide(0, 3)
    raw["requirement"] |= {"start": degrees(start + math.radians(40.0)), "zero": f"{float(base)!r} m"}
    result = optlink.synthesis.exact(optlink.read(raw))
    assert [result.design[name] for name in ("crank.length", "rod.length", "G.offset")] == pytest.approx([a, b, offset], rel=1e-9)
