"""Forward dynamics with Coulomb friction in a guide, against the equations of a slider-crank solved by hand."""

from __future__ import annotations

import numpy as np
import pytest

import optlink
from optlink.dynamics.forward import Ending, crank_acceleration
from optlink.dynamics.inverse import reactions
from optlink.tasks.machine import machine_of
from tests.tiers import mostly_slow

CRANK, ROD, INERTIA, MASS = 0.1, 0.14, 0.02, 1.5


def slider_crank(friction, torque="0 N*m", **drive):
    """A crank with inertia, a massless rod and a slider on a rough guide along x."""
    return optlink.read(
        {
            "title": "slider-crank with a rough guide",
            "mechanism": {
                "ground": {"A": ["0 m", "0 m"]},
                "links": {
                    "crank": {"joints": ["A", "B"], "length": f"{CRANK} m"},
                    "rod": {"joints": ["B", "C"], "length": f"{ROD} m"},
                    "slider": {"joints": ["C"]},
                },
                "guides": {"F": {"slider": "slider", "through": "A", "friction": friction}},
                "assembly": {"C": "forward"},
            },
            "bodies": {
                "crank": {"mass": "1 kg", "centroid": ["0 m", "0 m"], "inertia": f"{INERTIA} kg*m^2"},
                "slider": {"mass": f"{MASS} kg"},
            },
            "drive": {"torque": torque, **drive},
        }
    )


def by_hand(friction, angle, speed, torque, sense):
    """Accelerations of the crank whose rod force S, with friction against the motion, satisfies both equations of motion."""
    sine, cosine = np.sin(angle), np.cos(angle)
    root = np.sqrt(ROD**2 - (CRANK * sine) ** 2)
    first = -CRANK * sine - CRANK**2 * sine * cosine / root
    second = -CRANK * cosine - CRANK**2 * (cosine**2 - sine**2) / root - CRANK**4 * (sine * cosine) ** 2 / root**3
    along, across = root / ROD, -CRANK * sine / ROD  # of the rod, from the crank to the slider
    slip = np.sign(first) * sense
    result = []
    for pressed in (1.0, -1.0):  # sign of the normal force -S across
        pull = along + friction * pressed * slip * across  # of the rod and of friction, per rod force
        lever = CRANK * (cosine * across - sine * along)
        equations = [[INERTIA, lever], [MASS * first, -pull]]
        alpha, force = np.linalg.solve(equations, [torque, -MASS * second * speed**2])
        if pressed * -force * across >= 0.0:
            result.append(alpha)
    return result


@pytest.mark.parametrize("friction", mostly_slow([0.2, 1.2, 1.6], 1.2))
def test_acceleration_is_the_only_one_that_satisfies_the_equations_of_motion(friction):
    machine, jammed, undetermined = machine_of(slider_crank(friction)), 0, 0
    for speed in (6.0, -6.0):
        for torque in (-30.0, -2.0, 1.0, 25.0):
            for angle in np.linspace(0.1, 6.2, 41):
                expected = by_hand(friction, angle, speed, torque, np.sign(speed))
                alpha = crank_acceleration(machine.moving([angle], 1.0), speed, torque, np.sign(speed))[0]
                undetermined += len(expected) != 1
                np.testing.assert_allclose(alpha, expected[0] if len(expected) == 1 else np.nan, rtol=1e-9, atol=1e-9)
                jammed += bool(len(expected) == 1 and reactions(machine.moving([angle], speed)).jammed[0])
    # a crank that is held to its speed would jam where the free one moves
    assert (jammed > 10, undetermined > 0) == (friction > 1.0, friction > 1.5)


def test_machine_that_starts_backwards_has_the_friction_of_that_sense_in_its_first_row():
    result = optlink.simulate(slider_crank(0.3, "-2 N*m", start="70 deg", duration="0.1 s"))
    assert result.ending is Ending.FINISHED
    expected = by_hand(0.3, np.radians(70.0), 0.0, -2.0, -1.0)
    assert result["crank.alpha_rad_s2"][0] == pytest.approx(expected[0], rel=1e-9)
    assert result["crank.alpha_rad_s2"][1] == pytest.approx(expected[0], rel=1e-2)


@pytest.mark.parametrize("friction", mostly_slow([0.3, 1.2, 1.6, 2.5], 1.6))
def test_resting_machine_starts_only_if_nothing_else_satisfies_coulombs_law(friction):
    """At rest the massless rod carries S = torque / lever, and friction holds its part along the guide if it lies in the cone."""
    seen = set()
    for torque in (-3.0, 3.0):
        for degrees in (15.0, 60.0, 75.0, 90.0, 105.0, 140.0, 200.0, 260.0, 285.0, 330.0):
            angle = np.radians(degrees)
            across = CRANK * np.sin(angle) / ROD
            ways = [sense for sense in (1.0, -1.0) for alpha in by_hand(friction, angle, 0.0, torque, sense) if alpha * sense > 0]
            rest = np.sqrt(1.0 - across**2) <= friction * abs(across)
            expected = Ending.UNDETERMINED if len(ways) + rest > 1 else Ending.AT_REST if rest else Ending.FINISHED
            assert len(ways) + rest > 0
            result = optlink.simulate(
                slider_crank(friction, f"{torque} N*m", start=f"{degrees} deg", duration="1 ms", initial_speed="0 rad/s")
            )
            assert result.ending is expected, (torque, degrees)
            assert result.valid is (expected is not Ending.UNDETERMINED)
            seen.add(expected)
    few = {Ending.FINISHED} if friction < 1.0 else {Ending.FINISHED, Ending.AT_REST}
    assert seen - {Ending.UNDETERMINED} == few


@pytest.mark.parametrize(
    ("speed", "torque"), mostly_slow([(6.0, 25.0), (-6.0, 25.0), (6.0, -30.0), (-6.0, -30.0)], (-6.0, -30.0))
)
def test_machines_with_no_or_several_accelerations_are_reported(speed, torque):
    seen = set()
    for degrees in np.linspace(50.0, 130.0, 33):
        expected = by_hand(1.9, np.radians(degrees), speed, torque, np.sign(speed))
        if len(expected) == 1:
            continue
        result = optlink.simulate(
            slider_crank(1.9, f"{torque} N*m", start=f"{degrees} deg", duration="1 ms", initial_speed=f"{speed} rad/s")
        )
        assert result.ending is (Ending.UNDETERMINED if expected else Ending.JAMMED)
        assert any(("more than one motion" if expected else "no motion") in note for note in result.notes)
        seen.add(result.ending)
    assert seen
