"""Change points: positions in which the assembly modes of a group meet, named where the motion beyond them is not determined."""

from __future__ import annotations

import itertools
import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.linkage.fourbar import four_bar
from optlink.linkage.motion import sweep
from optlink.linkage.stroke import reachable
from optlink.problem.file import dump
from optlink.validation import validate as validate_design
from tests.oracle import Kinematics, Mass, newton_euler
from tests.tiers import mostly_slow

LENGTHS = ("crank", "coupler", "rocker", "frame")
runner = CliRunner()


def four_bar_problem(lengths, unit="mm", assembly="left", start="20 deg", **more):
    raw = {
        "title": "four-bar with a change point",
        "gravity": "9.81 m/s^2",
        "mechanism": {
            "type": "four-bar",
            **{name: f"{length!r} {unit}" for name, length in zip(LENGTHS, lengths, strict=True)},
            "assembly": assembly,
        },
        "bodies": {"coupler": {"mass": "2 kg", "inertia": "uniform bar"}, "rocker": {"mass": "1 kg", "inertia": "uniform bar"}},
        "drive": {"start": start, "speed": "2 rad/s"},
    }
    return optlink.read({**raw, **more})


def collinear(crank, coupler, rocker, frame):
    """Crank angles [deg] at which all four links lie on one line: there the distance of B and D is a sum or difference."""
    result = []
    for angle, distance in ((0.0, abs(frame - crank)), (180.0, frame + crank)):
        if min(abs(distance - (coupler + rocker)), abs(distance - abs(coupler - rocker))) < 1e-9 * frame:
            result.append(angle)
    return result


def drawn_change_points(count, seed):
    """Random lengths whose longest and shortest sum to the other two, in any order; parallelograms and kites among them."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        short, one, other = np.sort(rng.uniform(20.0, 200.0, 3))
        four = [short, one, other, one + other - short]
        if k % 5 == 0:
            four = [one, other, one, other]  # parallelogram
        if k % 5 == 1:
            four = [one, other, other, one] if k % 2 else [one, one, other, other]  # kites
        else:
            four = [four[i] for i in rng.permutation(4)] if k % 5 else four
        yield [float(length) for length in four]


@pytest.mark.parametrize("lengths", list(drawn_change_points(25, 7)))
@pytest.mark.parametrize("scale", [1.0, 0.0254, 10.0 / 3.0])
def test_change_points_are_found_at_collinear_links_whatever_the_rounding(lengths, scale):
    sizes = dict(zip(LENGTHS, (scale * length for length in lengths), strict=True))
    ranges = reachable(four_bar(1), sizes)
    computed = [math.degrees(p.crank_angle) for p in ranges.singular]
    expected = [at for at in collinear(*lengths) if ranges.holding(math.radians(at))]
    assert computed == pytest.approx(expected, abs=1e-9)
    assert computed
    crank, coupler, rocker, frame = lengths
    turns = all(abs(coupler - rocker) <= d + 1e-9 and d <= coupler + rocker + 1e-9 for d in (abs(frame - crank), frame + crank))
    assert ranges.full == turns


@pytest.mark.parametrize(
    ("lengths", "unit", "angles"),
    [
        ((5.0, 2.0, 4.0, 3.0), "in", [0.0]),
        ((60.0, 150.0, 60.0, 150.0), "mm", [0.0, 180.0]),
        ((70.0, 30.0, 70.0, 30.0), "mm", [0.0, 180.0]),
    ],
)
@pytest.mark.parametrize("start", ["20.5 deg", "-77 deg"])
def test_motion_that_is_not_determined_is_not_sound(tmp_path, lengths, unit, angles, start):
    problem = four_bar_problem(lengths, unit, start=start)
    result = optlink.analyze(problem, points=77)
    assert not result.valid
    assert result.status != "analysed"
    assert not result.extremes
    assert not result.swings
    assert not result.strokes
    assert math.isnan(result.work)
    assert np.sort(np.degrees(result.singular) % 360.0) == pytest.approx(angles, abs=1e-9)
    assert result.figures == {}
    path = tmp_path / "problem.toml"
    path.write_text(dump(problem))
    done = runner.invoke(app, ["analyze", str(path), "--json"])
    document = json.loads(done.stdout)
    assert done.exit_code == 1
    assert [p["crank_angle_deg"] for p in document["singular_positions"]] == pytest.approx(angles, abs=1e-9)
    done = runner.invoke(app, ["analyze", str(path)])
    assert done.exit_code == 1
    for angle in angles:
        assert f"{angle:g} deg" in " ".join(done.stdout.split())
    assert "Extremes" not in done.stdout


@pytest.mark.parametrize("lengths", [(100.0, 300.0, 200.0, 400.0 * (1.0 - 1e-4)), (100.0, 300.0 * (1.0 + 1e-5), 200.0, 400.0)])
def test_near_change_points_are_sound_and_name_the_peak(lengths):
    result = optlink.analyze(four_bar_problem(lengths, start="20.5 deg"))
    crank, coupler, rocker, frame = lengths
    reach = frame + crank
    angle = math.degrees(math.acos((coupler**2 + rocker**2 - reach**2) / (2.0 * coupler * rocker)))
    assert result.valid
    assert "C.f_N" in result.extremes
    assert any(f"at crank angle 180 deg the transmission angle at C is {angle:.6g} deg" in note for note in result.notes)


def test_crank_that_misses_a_thousandth_of_a_degree_between_rows_does_not_turn_fully():
    """The frame is 1e-10 too long: still a change point; 1e-7 too long: 0.01 deg of the turn is missing, between two rows."""
    sizes = {"crank": 1.0, "coupler": 3.0, "rocker": 2.0}
    assert reachable(four_bar(1), {**sizes, "frame": 4.0 + 1e-11}).full
    missed = reachable(four_bar(1), {**sizes, "frame": 4.0 + 1e-7})
    assert not missed.full
    ((low, high),) = missed.ranges
    expected = math.acos(((3.0 + 2.0) ** 2 - 1.0 - (4.0 + 1e-7) ** 2) / (-2.0 * (4.0 + 1e-7)))
    assert (math.degrees(low) - 180.0) == pytest.approx(180.0 - math.degrees(expected), rel=1e-6)
    assert high - low < 2.0 * math.pi


def slider_crank_problem(crank, rod, offset, **more):
    raw = {
        "title": "slider-crank",
        "mechanism": {
            "type": "dyads",
            "ground": {"A": ["10 mm", "-20 mm"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": f"{crank!r} mm"},
                "rod": {"joints": ["B", "C"], "length": f"{rod!r} mm"},
                "slider": {"joints": ["C"]},
            },
            "guides": {"F": {"slider": "slider", "through": "A", "offset": f"{offset!r} mm", "direction": "17 deg"}},
            "assembly": {"C": "forward"},
        },
        "bodies": {"slider": {"mass": "3 kg"}},
        "drive": {"start": "30 deg"},
    }
    return optlink.read({**raw, **more})


@pytest.mark.parametrize(
    ("crank", "rod", "offset", "angles"),
    [(80.0, 80.0, 0.0, (107.0, 287.0)), (50.0, 70.0, 20.0, (287.0,)), (50.0, 70.0, -20.0, (107.0,))],
)
def test_slider_cranks_whose_rod_stands_across_the_guide_are_singular(crank, rod, offset, angles):
    """The rod is at a right angle to the guide where crank and offset together are as long as the rod."""
    result = optlink.analyze(slider_crank_problem(crank, rod, offset), points=50)
    assert not result.valid
    assert np.degrees(result.singular) % 360.0 == pytest.approx(angles, abs=1e-9)


@pytest.mark.parametrize(
    ("crank", "offset", "singular"), [(90.0, 0.0, True), (89.9, 0.0, False), (60.0, 30.0, True), (60.0, 29.9, False)]
)
def test_guides_through_a_pin_are_singular_where_the_pins_are_as_near_as_the_offset(crank, offset, singular):
    """Crank and frame of one length: the pin of the slider passes the pivot of the arm; with an offset it comes that near."""
    raw = {
        "title": "arm on a slider",
        "mechanism": {
            "type": "dyads",
            "ground": {"A": ["0 mm", "0 mm"], "D": ["90 mm", "0 mm"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": f"{crank!r} mm"},
                "block": {"joints": ["B"]},
                "arm": {"joints": ["D", "E"], "length": "300 mm"},
            },
            "guides": {"G": {"slider": "block", "on": "arm", "through": "D", "offset": f"{offset!r} mm"}},
            "assembly": {"G": "forward"},
        },
        "bodies": {"arm": {"mass": "2 kg", "inertia": "uniform bar"}},
        "drive": {"start": "100 deg"},
    }
    result = optlink.analyze(optlink.read(raw), points=90)
    assert result.valid != singular
    assert list(np.degrees(result.singular) % 360.0) == ([0.0] if singular else [])


def test_every_permutation_of_four_one_three_two_is_judged():
    for lengths in itertools.permutations((4.0, 1.0, 3.0, 2.0)):
        ranges = reachable(four_bar(-1), dict(zip(LENGTHS, lengths, strict=True)))
        assert ranges.singular, lengths


# --- the smooth motion through change points -------------------------------------------------------------------------------


def continued(lengths, side, count):
    """Rocker angles over two revolutions by an oracle of its own: of both solutions the one that extrapolates the last three.

    The steps avoid the change points themselves, where both solutions agree.
    """
    crank, coupler, rocker, frame = lengths
    phi = np.linspace(0.0, 4.0 * np.pi, count) + math.radians(20.0)
    bx, by = crank * np.cos(phi), crank * np.sin(phi)
    x, y = bx - frame, by
    distance = np.hypot(x, y)
    away = np.arctan2(y, x)
    opening = np.arccos(np.clip((rocker**2 + distance**2 - coupler**2) / (2.0 * rocker * distance), -1.0, 1.0))
    both = np.array([away - opening, away + opening])
    chosen = [0 if side > 0 else 1] * 3  # D -> B turned clockwise is left of B -> D
    turned = np.exp(1j * both).T.tolist()
    for k in range(3, count):
        last, before, first = (turned[k - n][chosen[k - n]] for n in (1, 2, 3))
        expected = last**3 * before**-3 * first
        chosen.append(int(abs(turned[k][1] - expected) < abs(turned[k][0] - expected)))
    computed = both[chosen, np.arange(count)]
    return phi, np.unwrap(computed)


CONTINUED = [
    lengths
    for lengths in drawn_change_points(60, 11)
    if len(collinear(*lengths)) > 0 and reachable(four_bar(1), dict(zip(LENGTHS, lengths, strict=True))).full
][:24]


@pytest.mark.slow
@pytest.mark.parametrize("assembly", ["left, continue", "right, continue"])
@pytest.mark.parametrize("lengths", CONTINUED)
def test_motion_is_followed_smoothly_as_the_oracle_continues_it(lengths, assembly):
    assert len(CONTINUED) >= 20
    result = optlink.analyze(four_bar_problem(lengths, assembly=assembly), points=360)
    mechanism, sizes = result.machine.mechanism, result.machine.sizes
    phi, psi = continued(lengths, 1 if assembly.startswith("left") else -1, 8001)
    motion = sweep(mechanism, sizes, phi)
    rocker = motion.body_angle("rocker")
    assert np.max(np.abs(np.exp(1j * rocker.value) - np.exp(1j * psi))) < 1e-7  # arccos near one has half of the digits
    closed = int(abs(np.exp(1j * psi[4000]) - np.exp(1j * psi[0])) > 1e-6) + 1
    assert result.cycle == pytest.approx(2.0 * math.pi * closed)
    assert len(result["crank_angle_deg"]) == 360 * closed + 1
    step = phi[1] - phi[0]
    scale = np.max(np.abs(rocker.acceleration)) + 1.0
    np.testing.assert_allclose(rocker.rate[2:-2], five_point(rocker.value, step), atol=2e-6 * scale)
    np.testing.assert_allclose(rocker.acceleration[2:-2], five_point(rocker.rate, step), atol=2e-5 * scale)
    assert result.valid
    assert "input.torque_Nm" in result.extremes


def five_point(values, step):
    """Derivative by central differences of fourth order, without the two values at either end."""
    return (8.0 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) / (12.0 * step)


@pytest.mark.parametrize(
    ("crank", "frame", "start"),
    [
        (60.0, 150.0, "0 deg"),
        (150.0, 60.0, "20 deg"),
        (55.0, 70.0, "-130 deg"),
        (60.0, 150.0, "180 deg"),
        (150.0, 60.0, "0 deg"),
        (55.0, 70.0, "180 deg"),
    ],
)
def test_parallelogram_keeps_its_coupler_parallel(crank, frame, start):
    lengths = (crank, frame, crank, frame)
    result = optlink.analyze(four_bar_problem(lengths, assembly="parallelogram", start=start), points=360)
    phi = np.radians(result["crank_angle_deg"])
    assert result.cycle == pytest.approx(2.0 * math.pi)
    assert result.valid
    np.testing.assert_allclose(result["C.x_m"], 1e-3 * (crank * np.cos(phi) + frame), atol=1e-12)
    np.testing.assert_allclose(result["C.y_m"], 1e-3 * crank * np.sin(phi), atol=1e-12)
    np.testing.assert_allclose(result["rocker.omega_rad_s"], 2.0, rtol=1e-10)
    np.testing.assert_allclose(result["rocker.alpha_rad_s2"], 0.0, atol=1e-9)
    np.testing.assert_allclose(result["coupler.omega_rad_s"], 0.0, atol=1e-10)
    torque = 9.81 * 1e-3 * crank * (2.0 + 0.5) * np.cos(phi)  # the coupler moves on a circle, the rocker turns about its end
    np.testing.assert_allclose(result["input.torque_Nm"], torque, atol=1e-9)
    extreme = result.extremes["input.torque_Nm"]
    assert extreme.largest == pytest.approx(9.81e-3 * crank * 2.5, rel=1e-9)


def test_reactions_near_change_points_follow_newton_euler():
    """Away from them each force is that of the oracle; towards them they are without bound, and no extreme is stated."""
    result = optlink.analyze(four_bar_problem((60.0, 150.0, 60.0, 150.0), assembly="antiparallelogram"), points=90)
    assert set(result.unbounded) >= {"A.f_N", "B.f_N", "C.f_N", "D.f_N", "C.fx_N"}
    assert not set(result.unbounded) & set(result.extremes)
    assert result.status != "analysed"
    assert any("without bound" in note for note in result.notes)
    machine = result.machine
    rows = np.abs(np.sin(np.radians(result["crank_angle_deg"]))) > 1e-3
    phi = np.radians(result["crank_angle_deg"])[rows]
    near = np.zeros((len(phi), 3, 3))
    for k, (body, point) in enumerate((("crank", "A"), ("coupler", "B"), ("rocker", "D"))):
        motion = sweep(machine.mechanism, machine.sizes, phi)
        near[:, k, :2] = motion.position(point)
        near[:, k, 2] = motion.body_angle(body).value
    k = Kinematics(machine.mechanism, machine.sizes, phi, 2.0, 0.0, near)
    masses = {
        "coupler": Mass(2.0, 0.075, 0.0, 2.0 * 0.15**2 / 12.0),
        "rocker": Mass(1.0, 0.03, 0.0, 0.06**2 / 12.0),
    }
    expected = newton_euler(k, masses, (0.0, -9.81))
    np.testing.assert_allclose(result["input.torque_Nm"][rows], expected.torque, atol=1e-10)
    np.testing.assert_allclose(result["rocker.omega_rad_s"][rows], k.turning("rocker")[1], atol=1e-10)
    np.testing.assert_allclose(result["rocker.alpha_rad_s2"][rows], k.turning("rocker")[2], atol=1e-9)
    for axis, name in enumerate(("C.fx_N", "C.fy_N")):
        np.testing.assert_allclose(result[name][rows], expected.pins["C"]["coupler"][:, axis], rtol=1e-8, atol=1e-8)


def test_unloaded_change_points_have_finite_reactions():
    """Without masses and loads there is no force, at the change points neither."""
    result = optlink.analyze(four_bar_problem((60.0, 150.0, 60.0, 150.0), assembly="parallelogram", bodies={}))
    assert result.unbounded == ()
    assert result.status == "analysed"


def test_antiparallelogram_turns_its_rocker_by_the_half_angle_law():
    """Its links touch like two ellipses: the tangents of the half angles keep their ratio, (frame + crank) / (frame - crank)."""
    result = optlink.analyze(
        four_bar_problem((60.0, 150.0, 60.0, 150.0), assembly="antiparallelogram", start="0 deg"), points=720
    )
    phi, psi = np.radians(result["crank_angle_deg"]), result["rocker.angle_rad"]
    keep = np.abs(np.sin(phi)) > 0.02
    ratio = np.tan(0.5 * psi[keep]) * np.tan(0.5 * phi[keep]) ** -1.0
    np.testing.assert_allclose(np.abs(ratio), 210.0 / 90.0, rtol=1e-9)
    speeds = result["rocker.omega_rad_s"] / 2.0
    assert sorted(np.abs([speeds[0], speeds[360]])) == pytest.approx([90.0 / 210.0, 210.0 / 90.0], rel=1e-10)  # limits of 0 / 0


@pytest.mark.parametrize(
    "mode", mostly_slow(("left of B-D, continue", "right of B-D, continue", "continue"), "right of B-D, continue", "continue")
)
def test_dyads_are_followed_like_four_bars(mode):
    lengths = (50.0, 150.0, 100.0, 200.0)
    raw = dict(four_bar_problem(lengths).raw)
    raw["mechanism"] = {
        "type": "dyads",
        "ground": {"A": ["0 mm", "0 mm"], "D": ["200 mm", "0 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": "50 mm"},
            "coupler": {"joints": ["B", "C"], "length": "150 mm"},
            "rocker": {"joints": ["D", "C"], "length": "100 mm"},
        },
        "assembly": {"C": mode},
    }
    result = optlink.analyze(optlink.read(raw), points=90)
    same = optlink.analyze(four_bar_problem(lengths, assembly="right, continue" if "right" in mode else "continue"), points=90)
    assert result.cycle == pytest.approx(4.0 * math.pi)
    for name in ("C.x_m", "rocker.omega_rad_s", "rocker.alpha_rad_s2", "input.torque_Nm"):
        np.testing.assert_allclose(result[name], same[name], rtol=1e-9, atol=1e-9)


def test_slider_of_crank_and_rod_of_one_length_moves_harmonically():
    """It slides to both sides of the pivot by twice the crank, if it does not stop there."""
    raw = dict(slider_crank_problem(80.0, 80.0, 0.0).raw)
    raw["mechanism"] = {**raw["mechanism"], "assembly": {"C": "forward, continue"}}
    result = optlink.analyze(optlink.read(raw), points=360)
    phi = np.radians(result["crank_angle_deg"]) - math.radians(17.0)
    np.testing.assert_allclose(result["slider.s_m"], 0.16 * np.cos(phi), atol=1e-12)
    np.testing.assert_allclose(result["slider.a_m_s2"], -0.16 * np.cos(phi), atol=1e-9)
    assert result.strokes["slider"].span == pytest.approx(0.32, rel=1e-12)


def test_arm_through_its_own_pivot_turns_half_as_fast():
    """Crank and frame of one length: the arm bisects, and is back after two revolutions."""
    raw = {
        "title": "arm on a slider",
        "mechanism": {
            "type": "dyads",
            "ground": {"A": ["0 mm", "0 mm"], "D": ["90 mm", "0 mm"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": "90 mm"},
                "block": {"joints": ["B"]},
                "arm": {"joints": ["D", "E"], "length": "300 mm"},
            },
            "guides": {"G": {"slider": "block", "on": "arm", "through": "D"}},
            "assembly": {"G": "forward, continue"},
        },
        "bodies": {"arm": {"mass": "2 kg", "inertia": "uniform bar"}},
        "drive": {"start": "100 deg"},
    }
    result = optlink.analyze(optlink.read(raw), points=360)
    phi = np.radians(result["crank_angle_deg"])
    assert result.cycle == pytest.approx(4.0 * math.pi)
    np.testing.assert_allclose(result["arm.omega_rad_s"], 0.5, rtol=1e-9)
    np.testing.assert_allclose(np.cos(result["arm.angle_rad"] - 0.5 * (phi + math.pi)), 1.0, atol=1e-12)


def test_two_parallelograms_in_series_pass_their_change_points_together():
    raw = {
        "title": "coupled wheels",
        "mechanism": {
            "type": "dyads",
            "ground": {"A": ["0 mm", "0 mm"], "D": ["200 mm", "0 mm"], "G": ["450 mm", "0 mm"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": "70 mm"},
                "rod": {"joints": ["B", "C"], "length": "200 mm"},
                "wheel": {"joints": ["D", "C"], "length": "70 mm"},
                "rod2": {"joints": ["C", "E"], "length": "250 mm"},
                "wheel2": {"joints": ["G", "E"], "length": "70 mm"},
            },
            "assembly": {"C": "left of B-D, continue", "E": "left of C-G, continue"},
        },
        "drive": {"start": "40 deg"},
    }
    result = optlink.analyze(optlink.read(raw), points=720)
    np.testing.assert_allclose(result["wheel2.omega_rad_s"], 1.0, rtol=1e-8)
    np.testing.assert_allclose(result["wheel2.alpha_rad_s2"], 0.0, atol=1e-6)
    raw["mechanism"]["assembly"]["E"] = "left of C-G"
    assert not optlink.analyze(optlink.read(raw), points=90).valid


# --- where else it is said ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", ["3 rad/s", "-3 rad/s"])
def test_simulation_ends_at_a_singular_position(tmp_path, speed):
    """From 20 deg to 180 deg forward, and to -180 deg backward."""
    problem = four_bar_problem((50.0, 150.0, 100.0, 200.0), drive={"start": "20 deg", "speed": speed, "duration": "3 s"})
    result = optlink.simulate(problem, rows=300)
    assert result.ending.value == "singular position"
    assert not result.valid
    turned = math.radians(160.0 if speed[0] != "-" else 200.0)
    assert result.stopped == pytest.approx(turned / 3.0, abs=1e-5)
    assert any(("crank angle 180 deg" if speed[0] != "-" else "crank angle -180 deg") in note for note in result.notes)
    assert result.figures["imbalance_J"] <= 1e-9 * result.figures["turnover_J"]
    path = tmp_path / "problem.toml"
    path.write_text(dump(problem))
    assert runner.invoke(app, ["simulate", str(path)]).exit_code == 1
    path.write_text(dump(problem).replace('"left"', '"continue"'))
    assert runner.invoke(app, ["simulate", str(path)]).exit_code == 0


def test_simulation_that_starts_in_a_singular_position_ends_there():
    result = optlink.simulate(four_bar_problem((60.0, 150.0, 60.0, 150.0), start="180 deg"), rows=10)
    assert result.ending.value == "singular position"
    assert result.stopped == 0.0


@pytest.mark.slow
def test_torque_drives_a_parallelogram_through_its_change_points():
    """Reduced to the crank it is a pendulum of constant inertia: energy gives the speed at every angle."""
    problem = four_bar_problem(
        (60.0, 150.0, 60.0, 150.0),
        assembly="parallelogram",
        drive={"start": "30 deg", "torque": "0.2 N*m", "initial_speed": "12 rad/s", "duration": "1.5 s"},
    )
    result = optlink.simulate(problem, rows=200)
    assert result.valid
    inertia = 2.0 * 0.06**2 + 0.06**2 / 3.0
    turned = result["crank.angle_rad"] - math.radians(30.0)
    rise = 9.81 * 0.06 * 2.5 * (np.sin(result["crank.angle_rad"]) - 0.5)
    speed = np.sqrt(144.0 + 2.0 * (0.2 * turned - rise) / inertia)
    assert turned[-1] > 2.0 * math.pi
    np.testing.assert_allclose(result["crank.omega_rad_s"], speed, rtol=1e-7)


def test_batch_leaves_out_designs_whose_motion_is_not_determined():
    frames = np.array([0.19, 0.2 - 1e-5, 0.2, 0.2 + 1e-14])
    columns = ("rocker.omega_rad_s", "input.torque_Nm")
    problem = four_bar_problem((50.0, 150.0, 100.0, 200.0))
    result = optlink.analyze_batch(problem, {"frame": frames}, columns, points=45)
    assert sorted(result.singular) == [2, 3]
    assert "180 deg" in result.singular[2]
    assert np.all(np.isnan(result["input.torque_Nm"]) == np.array([[False], [False], [True], [True]]))
    followed = optlink.analyze_batch(problem.override({"mechanism.assembly": "continue"}), {"frame": frames}, columns, points=45)
    assert not followed.singular
    one = optlink.analyze(four_bar_problem((50.0, 150.0, 100.0, 200.0), assembly="continue"), points=45)
    for name in columns:
        np.testing.assert_array_equal(followed[name][2], one[name][:90])
        np.testing.assert_allclose(followed[name][0], np.tile(result[name][0], 2), rtol=1e-9)


def test_batch_finds_a_singular_position_within_a_short_stroke():
    """A boom of 0.5 m lies in line with its cylinder of 1.5 m within 0.1 s of a cycle of 10 s, and rests in all others."""
    law = [{"time": f"{time} s", "to": f"{to} m"} for time, to in ((9.9, 1.2), (0.05, 1.5), (0.05, 1.2))]
    mechanism = {
        "ground": {"A": ["0 m", "0 m"], "D": ["1 m", "0 m"]},
        "links": {"boom": {"joints": ["A", "B"], "length": "0.55 m"}},
        "cylinders": {"lift": {"joints": ["D", "B"], "closed": "1 m", "open": "1.5 m"}},
        "assembly": {"B": "left of A-D"},
    }
    machine = optlink.read({"mechanism": mechanism, "drive": {"cylinder": "lift", "start": "1.2 m", "law": law}})
    found = optlink.analyze_batch(machine, {"boom.length": [0.5, 0.5005, 0.6]}, ["boom.omega_rad_s"], points=8)
    assert list(found.singular) == [0]
    assert list(found.valid) == [False, True, True]


def test_batch_judges_a_group_near_alignment_of_which_only_the_crank_varies():
    """A rack takes a block along, whose guide turns about G, 1 mm beside its way."""
    mechanism = {
        "ground": {"A": ["0 mm", "0 mm"], "W": ["0 mm", "40 mm"], "G": ["0 mm", "41 mm"]},
        "links": {
            "pinion": {"joints": ["A", "P"], "length": "50 mm"},
            "rack": {"joints": ["S"]},
            "rocker": {"joints": ["G", "T"], "length": "0.3 m"},
            "block": {"joints": ["S"]},
        },
        "guides": {"way": {"slider": "rack", "through": "W"}, "arm": {"slider": "block", "on": "rocker", "through": "G"}},
        "racks": {"mesh": {"pinion": "pinion", "rack": "rack", "radius": "40 mm"}},
        "assembly": {"arm": "forward"},
    }
    machine = optlink.read({"mechanism": mechanism, "drive": {"body": "pinion", "range": ["-90 deg", "90 deg"]}})
    found = optlink.analyze_batch(machine, {"pinion.length": [0.05, 0.06, 0.07]}, ["rocker.omega_rad_s"], points=9)
    assert np.all(found.valid)
    np.testing.assert_array_equal(found["rocker.omega_rad_s"], found["rocker.omega_rad_s"][[0, 0, 0]])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"mechanism.assembly": "parallelogram"}, "crank and rocker"),
        ({"mechanism.assembly": "antiparallelogram", "mechanism.rocker": "50 mm"}, "coupler and frame"),
        ({"mechanism.assembly": "onward"}, "mechanism.assembly"),
    ],
)
def test_assembly_modes_that_the_lengths_do_not_have_are_refused(changes, words):
    with pytest.raises(optlink.InputError, match=words):
        optlink.analyze(four_bar_problem((50.0, 150.0, 100.0, 200.0)).override(changes))


@pytest.mark.slow
def test_undetermined_positions_are_shown_in_pages_and_pictures(tmp_path):
    path = tmp_path / "problem.toml"
    path.write_text(dump(four_bar_problem((50.0, 150.0, 100.0, 200.0))))
    page = tmp_path / "page.html"
    assert runner.invoke(app, ["report", str(path), "-o", str(page)]).exit_code == 1
    assert "Motion not determined beyond a singular position" in page.read_text(encoding="utf-8")
    assert runner.invoke(app, ["report", str(path), "-o", str(page), "--set", "mechanism.assembly=continue"]).exit_code == 0
    assert "repeats after 2 revolutions" in page.read_text(encoding="utf-8")


# --- crank angles ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [2.0, -2.0])
@pytest.mark.parametrize("start", ["300 deg", "-200 deg", "20.5 deg", "725 deg"])
def test_crank_angles_of_extremes_lie_within_one_revolution(start, speed):
    problem = four_bar_problem((50.0, 150.0, 110.0, 180.0), start=start)
    result = optlink.analyze(problem, speed=speed)
    document = result.to_dict()
    angles = [e[f"{kind}_at_deg"] for e in document["extremes"].values() for kind in ("min", "max")]
    angles += [at for t in document["swings"].values() for at in (t["low_at_deg"], t["high_at_deg"], *t["dead_centres_deg"])]
    assert all(0.0 <= at < 360.0 for at in angles if at is not None)
    same = optlink.analyze(four_bar_problem((50.0, 150.0, 110.0, 180.0), start="0 deg"), speed=speed)
    for name in ("C.transmission_rad", "input.torque_Nm", "C.f_N"):
        one, other = result.extremes[name], same.extremes[name]
        assert (one.least, one.largest) == pytest.approx((other.least, other.largest), rel=1e-9)
        assert (one.least_at, one.largest_at) == pytest.approx((other.least_at, other.largest_at), abs=1e-6)
    assert result.extremes["C.transmission_rad"].least_at < 1e-6  # where rounding alone may say 359.9999999


def test_crank_angles_of_extremes_lie_in_the_range_of_a_crank_that_cannot_turn():
    result = optlink.analyze(four_bar_problem((200.0, 150.0, 110.0, 180.0), start="40 deg"))
    assert not result.full
    for extreme in result.extremes.values():
        assert result.low - 1e-12 <= extreme.least_at <= result.high + 1e-12


def test_crank_alone_has_no_change_points():
    raw = {
        "title": "pendulum",
        "mechanism": {"ground": {"A": ["0 m", "0 m"]}, "links": {"crank": {"joints": ["A", "B"], "length": "0.2 m"}}},
        "bodies": {"crank": {"mass": "1 kg", "inertia": "uniform bar"}},
    }
    problem = optlink.read(raw)
    assert optlink.analyze(problem, points=12).valid
    assert not optlink.analyze_batch(problem, {"crank.length": [0.1, 0.2]}, points=12).singular


# --- loads of the slow stroke, and batches, over a cycle of two revolutions -----------------------------------------------------


def rocker_load(stroke, lengths=(50.0, 150.0, 100.0, 200.0), **more):
    """A torque of 40 N m against the rocker in one of its strokes; the motion repeats after two revolutions."""
    load = {"on": "rocker", "torque": "40 N*m", "acts": "opposing", "stroke": stroke}
    return four_bar_problem(lengths, assembly="continue", loads={"work": load}, **more)


def rocker_times(problem):
    """Crank rotations [deg] during which the rocker turns counter-clockwise and clockwise, from rows of the whole cycle."""
    free = problem.override({"loads.work.stroke": "both"})
    rates = optlink.analyze(free, points=7200)["rocker.omega_rad_s"][:-1]
    return tuple(float(np.count_nonzero(sense * rates > 0.0)) / 20.0 for sense in (1.0, -1.0))


def drawn_long_cycles(count, seed):
    """Random four-bars with one change point and a crank that turns fully: both branches differ, and follow one another."""
    rng = np.random.default_rng(seed)
    result = []
    while len(result) < count:
        short, one, other = (float(length) for length in np.sort(rng.uniform(30.0, 200.0, 3)))
        lengths = (short, one, other, one + other - short)
        if other - short > 10.0 and one - short > 10.0:
            result.append(tuple(lengths[i] for i in (0, *(1 + rng.permutation(3)))))
    return result


@pytest.mark.slow
@pytest.mark.parametrize("lengths", drawn_long_cycles(4, 3))
@pytest.mark.parametrize("speed", ["2 rad/s", "-2 rad/s"])
def test_slow_stroke_of_a_cycle_of_two_revolutions_is_that_of_both(lengths, speed):
    for pace, acts in (("slow", max), ("quick", min)):
        problem = rocker_load(pace, lengths, drive={"start": "33 deg", "speed": speed})
        result = optlink.analyze(problem, points=3600)
        assert result.cycle == pytest.approx(4.0 * math.pi)
        (item,) = result.acting
        assert item.pace == pace
        rotation = math.degrees(math.fsum(end - begin for begin, end in item.ranges))
        acting = float(np.count_nonzero(result["work.torque_Nm"][:-1])) / 10.0
        expected = acts(rocker_times(problem))
        assert rotation == pytest.approx(expected, abs=0.3)
        assert acting == pytest.approx(expected, abs=0.6)


@pytest.mark.slow
def test_batch_covers_the_whole_cycle_of_two_revolutions():
    frames = np.array([0.19, 0.2, 0.2 - 1e-5])
    columns = ("rocker.omega_rad_s", "input.torque_Nm", "C.x_m")
    for problem in (
        rocker_load("slow"),
        rocker_load("backward"),
        rocker_load("slow", drive={"start": "20 deg", "speed": "-2 rad/s"}),
    ):
        computed = optlink.analyze_batch(problem, {"frame": frames}, columns, points=45)
        for k, frame in enumerate(frames):
            one = optlink.analyze(problem, points=45, design={"frame": float(frame)})
            rows = round(45 * one.cycle / (2.0 * math.pi))
            for name in columns:
                assert computed[name].shape == (3, 90)
                size = np.max(np.abs(one[name]))
                np.testing.assert_allclose(computed[name][k], np.resize(one[name][:rows], 90), rtol=1e-9, atol=1e-9 * size)


# --- refusals ------------------------------------------------------------------------------------------------------------------


def test_cycle_validation_fails_on_a_singular_revolution():
    """The centric slider-crank whose rod is as long as its crank: the rod stands across the guide twice in a revolution."""
    free = {"joints": ["B", "C"], "length": {"start": "150 mm", "bounds": ["50 mm", "200 mm"]}}
    raw = dict(slider_crank_problem(50.0, 150.0, 0.0, objective={"quantity": "torque", "measure": "rms"}).raw)
    raw["mechanism"] = {**raw["mechanism"], "links": {**raw["mechanism"]["links"], "rod": free}}
    task = optlink.read(raw).model

    def checks(rod):
        return {check.name: check for check in validate_design(task, {"rod.length": rod}).checks}

    name = "no singular position in the revolution"
    assert checks(0.15)[name].passed
    for rod in (0.05, 0.05 * (1.0 + 1e-13)):
        assert (checks(rod)[name].passed, checks(rod)[name].value) == (False, 2.0)
        assert checks(rod)["the crank turns fully"].passed


@pytest.mark.parametrize("assembly", ["forward", "forward, continue"])
def test_singular_revolutions_are_refused_where_reactions_must_be_bounded(assembly):
    """Balancing and clearance, of a mechanism that is followed and of one that is not; no sampled position is singular."""
    disc = {"body": "crank", "thickness": "10 mm", "density": "7850 kg/m^3", "reach": "60 mm"}
    more = {
        "drive": {"start": "30.3 deg", "speed": "20 rad/s"},
        "balance": {"minimise": "rms shaking force", "counterweights": [disc]},
        "joints": {"A": {"clearance": "0.2 mm", "bearing_radius": "10 mm", "modulus": "207 GPa", "poisson": 0.3}},
    }
    sizes = (50.0, 50.0, 0.0)
    raw = dict(slider_crank_problem(*sizes, **more).raw)
    raw["mechanism"] = {**raw["mechanism"], "assembly": {"C": assembly}}
    with pytest.raises(optlink.InputError, match=r"singular position at crank angle 107 deg.*nothing can be balanced"):
        optlink.balance(optlink.read(raw))
    with pytest.raises(optlink.InputError, match=r"singular position at crank angle 107 deg.*clearance is not simulated"):
        optlink.control.simulate_clearance(optlink.read(raw), revolutions=1)


# --- guides that become parallel ------------------------------------------------------------------------------------------------


def test_parallel_guides_are_named_where_the_range_ends():
    """A die on the crank (PRP): its line, 10 deg ahead of the crank, is parallel to the guide at 25 deg where that is at 15."""
    raw = {
        "title": "tangent mechanism",
        "mechanism": {
            "ground": {"A": ["0 mm", "0 mm"]},
            "links": {"crank": {"joints": ["A", "B"], "length": "100 mm"}, "die": {"joints": ["P"]}, "ram": {"joints": ["P"]}},
            "guides": {
                "G": {"slider": "die", "on": "crank", "through": "A", "direction": "10 deg"},
                "F": {"slider": "ram", "through": ["0 mm", "70 mm"], "direction": "25 deg"},
            },
        },
        "drive": {"start": "60 deg"},
    }
    result = optlink.analyze(optlink.read(raw))
    np.testing.assert_allclose(np.degrees([result.ranges.ranges[0]]), [[15.0, 195.0]], atol=1e-3)
    reasons = [note for note in result.notes if "two guides are parallel" in note]
    assert len(reasons) == 2
    assert all("PRP group die-ram (joint P)" in reason for reason in reasons)
    assert "195 deg" in reasons[1]


def test_parallel_guides_of_a_yoke_are_named():
    """The slot of a yoke (RPP) lies across its rail by their fixed angle: none leaves no crank angle at all."""
    raw = {
        "title": "yoke",
        "mechanism": {
            "ground": {"A": ["0 mm", "0 mm"]},
            "links": {"crank": {"joints": ["A", "B"], "length": "100 mm"}, "die": {"joints": ["B"]}, "yoke": {"joints": ["Y"]}},
            "guides": {
                "G": {"slider": "die", "on": "yoke", "through": "Y", "direction": "20 deg"},
                "F": {"slider": "yoke", "through": ["0 mm", "70 mm"], "direction": "25 deg", "tilt": "30 deg"},
            },
        },
    }
    assert optlink.analyze(optlink.read(raw)).full
    raw["mechanism"]["guides"]["F"]["tilt"] = "-20 deg"
    with pytest.raises(
        optlink.InputError, match=r"RPP group die-yoke \(joint G\) has no defined position: its two guides are parallel"
    ):
        optlink.analyze(optlink.read(raw))
