"""Problems with four points of a function or of a slide, or four timed points: the best linkages of the family that is left."""

import math

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
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


@pytest.mark.slow
def test_four_points_of_a_function_have_a_family_of_four_bars():
    raw, sizes, _ = function(0, 4)
    result = optlink.synthesis.exact(optlink.read(raw))
    check(result, least_angle(*sizes, 0.1))
    assert result.exact_solutions.sentence.startswith(
        "four points of a function: 2 closed curves of couplers; 59.6% of 1000 four-bars"
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


@pytest.mark.slow
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


LOG = {
    "title": "precision points of a logarithm",
    "mechanism": {"type": "four-bar", **{name: {"bounds": ["5 mm", "2000 mm"]} for name in ("crank", "coupler", "rocker")}},
    "requirement": {
        "kind": "function",
        "law": {"function": "log10(x)", "x": [1, 2], "input": "60 deg", "output": "60 deg"},
        "points": 5,
        "spacing": "chebyshev",
    },
    "limits": {"crank": "span", "transmission_angle": ["20 deg", "160 deg"]},
}
LOG["mechanism"] |= {"frame": "100 mm", "assembly": "either"}


def structural_error(values):
    """Errors [deg] of the rocker at crank rotations [deg] 0 ... 60, by the law of cosines for both positions of the joint."""
    a, b, c, phi0, psi0 = (values[name] for name in ("crank", "coupler", "rocker", "phi0", "psi0"))
    x = np.linspace(0.0, 60.0, 6002)
    pins = a * np.exp(1j * (phi0 + np.radians(x)))
    to = pins - 0.1
    inner = np.arccos((c * c + np.abs(to) ** 2 - b * b) / (2.0 * c * np.abs(to)))
    wanted = np.degrees(psi0) + 60.0 * np.log10(1.0 + x / 60.0) / math.log10(2.0)
    ways = [(np.degrees(np.angle(to) + way * inner) - wanted + 180.0) % 360.0 - 180.0 for way in (1.0, -1.0)]
    return x, min(ways, key=lambda error: np.max(np.abs(error)))


def test_five_precision_points_at_chebyshev_spacing():
    """The error vanishes at the five points alone, alternates between them, and is less than with evenly spaced points."""
    result = optlink.synthesis.exact(optlink.read(LOG))
    x, error = structural_error(result.design)
    points = 30.0 - 30.0 * np.cos(np.pi * (2.0 * np.arange(5) + 1.0) / 10.0)
    assert np.degrees(result.best.crank_angles - result.design["phi0"]) == pytest.approx(points, abs=1e-9)
    zeros = x[:-1][np.sign(error[1:]) != np.sign(error[:-1])]
    assert zeros == pytest.approx(points, abs=0.0101)
    (one,) = result.exact_solutions.solutions
    assert math.degrees(one.between) == pytest.approx(np.max(np.abs(error)), rel=1e-4)
    even = optlink.synthesis.exact(optlink.read(LOG).override({"requirement.spacing": "even", "requirement.points": 4}))
    assert even.exact_solutions.solutions[0].between > 1.2 * one.between
    shown = CliRunner().invoke(app, ["solve", "function-log10", "--all"])
    assert shown.exit_code == 2  # the largest error anywhere has no precision points


def test_three_precision_points_equal_the_equations_of_freudenstein():
    """y = x^1.5 for 1 <= x <= 4, cranks from 30 deg and rockers from 90 deg over 90 deg, with negative lengths as stated."""
    law = {"function": "x^1.5", "x": [1, 4], "input": "90 deg", "output": "90 deg"}
    starts = {"requirement.law": law, "requirement.from": "30 deg", "requirement.psi0": "90 deg", "requirement.points": 3}
    file = optlink.read(LOG).override(starts)
    x = np.array([2.5 - 1.5 * math.cos(math.pi / 6.0), 2.5, 2.5 + 1.5 * math.cos(math.pi / 6.0)])
    phi, psi = np.radians(30.0 + 30.0 * (x - 1.0)), np.radians(90.0 + 90.0 * (x**1.5 - 1.0) / 7.0)
    k1, k2, k3 = np.linalg.solve(np.stack([np.cos(psi), -np.cos(phi), np.ones(3)], axis=1), np.cos(phi - psi))
    assert k1 < 0.0 > k2
    (one,) = optlink.synthesis.exact(file).exact_solutions.solutions
    a, c = 1.0 / k1, 1.0 / k2
    sizes = [-0.1 * a, 0.1 * math.sqrt(a * a + c * c + 1.0 - 2.0 * a * c * k3), -0.1 * c]
    assert [one.values[name] for name in ("crank", "coupler", "rocker")] == pytest.approx(sizes, rel=1e-9)
    assert any(reason.startswith("outside your bounds: phi0 -150 deg") for reason in one.reasons)
    turned = file.override({"requirement.from": "-150 deg", "requirement.psi0": "-90 deg"})
    result = optlink.synthesis.exact(turned)
    assert result.best.exact
    assert result.exact_solutions.solutions[0].between > 0.0


def test_positions_that_have_no_list_are_refused_with_what_has_one():
    for count, changes, words in (
        (2, {}, "no list of exact solutions of 2 positions. Give 4 or 5 positions"),
        (4, {"requirement.psi0": "90 deg"}, "of 4 positions with psi0 given"),
        (6, {}, "of 6 positions"),
    ):
        file = optlink.read(LOG).override({"requirement.points": count, **changes})
        with pytest.raises(optlink.InputError, match=words):
            optlink.synthesis.exact(file)
    two = optlink.solve(optlink.read(LOG).override({"requirement.points": 2}), starts=4)  # as the remedy says
    assert two.best.exact


SAID = [
    ([0, 20, 40, 60, 80], [0, 20, 40, 60, 80], "five points of a function: the output turns as the crank does"),
    ([0, 20, 40, 60], [0, 20, 40, 60], "four points of a function: the output turns as the crank does"),
    ([0, 20, 40, 60, 80], [0, 0, 0, 0, 0], "the output does not move"),
    ([0, 20, 40, 60], [0, 0, 0, 0], "the output does not move"),
    ([0, 20, 40, 60, 80], [0, 10, 0, 10, 0], "within each of two groups of poses"),
    ([0, 90, 180, 270, 360], [0, 10, 20, 10, 0], "of the output as seen from the crank: poses 1 and 5 are the same"),
]


@pytest.mark.parametrize(("phi", "psi", "words"), SAID)
def test_special_points_of_functions_are_told(phi, psi, words):
    raw, *_ = function(0, 5)
    raw["requirement"]["law"] = {"phi": [f"{x} deg" for x in phi], "psi": [f"{y} deg" for y in psi]}
    found = optlink.synthesis.exact(optlink.read(raw)).exact_solutions
    assert words in found.sentence
    assert found.solutions == ()


@pytest.mark.slow
@pytest.mark.parametrize("count", [4, 5])
def test_special_timed_points_are_told(count):
    """On a circle at the rate of the crank; on an ellipse, whose cranks lead to a trammel that four points do not tell."""
    raw, *_ = timed(0)
    angles = np.radians([0.0, 20.0, 45.0, 60.0, 80.0][:count])
    for height in (1.0, 0.5):
        places = zip(np.cos(angles).tolist(), (height * np.sin(angles)).tolist(), angles.tolist(), strict=True)
        rows = [{"x": f"{x!r} m", "y": f"{y!r} m", "crank": degrees(at)} for x, y, at in places]
        found = optlink.synthesis.exact(optlink.read(raw).override({"requirement.points": rows})).exact_solutions
        if height == 1.0:
            assert "a crank alone passes them" in found.sentence
        elif count == 5:
            assert "as in an elliptic trammel" in found.sentence


@pytest.mark.slow
@pytest.mark.parametrize(("made", "joints"), [(function, ("B", "C")), (slide, ("B", "C")), (timed, ("D", "C"))])
def test_pictures_show_the_family_and_the_design_on_it(made, joints, tmp_path):
    result = optlink.synthesis.exact(optlink.read(made(0)[0] if made is timed else made(0, 4)[0]))
    motion = optlink.motion(result.machine, crank_angle=result.best.crank_angles[:1])
    for axes, joint in zip(result.plot("dyads").axes, joints, strict=True):
        lines = {line.get_label(): np.asarray(line.get_xydata()) for line in axes.get_lines()}
        usable = next(line for name, line in lines.items() if name.startswith("usable"))
        size = np.ptp(axes.get_xlim())
        near = np.linalg.norm(usable - 1e3 * motion.position(joint)[0], axis=1) / size
        assert np.nanmin(near) < 0.02
        assert np.isfinite(usable).any()
    page = optlink.report(result, tmp_path / "page.html").read_text(encoding="utf-8")
    assert "usable: targets in order" in page
