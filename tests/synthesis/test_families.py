"""Families of linkages for four targets: known ones and an own sampling lie on them, lengths, defects in another form."""

import math

import numpy as np
import pytest

from optlink.synthesis.families import FunctionFamily, TimedFamily, three_points
from optlink.synthesis.four_poses import DEFECTS
from tests.synthesis.test_five_poses import cranked


def function(seed, slides=False):
    """Crank angles and outputs of a known linkage at four positions, with its crank pin and joint at the first one."""
    rng = np.random.default_rng(seed)
    if not slides:
        _, phi, pins, joints = cranked(rng)
        return phi[:4], np.unwrap(np.angle(joints - 1.0))[:4], pins[0] * np.exp(-1j * phi[0]), joints[0]
    a, b, offset = rng.uniform(0.2, 0.6), rng.uniform(1.0, 2.0), rng.uniform(-0.3, 0.3)
    phi = rng.uniform(0.0, math.tau) + np.cumsum(rng.uniform(0.2, 0.7, 4))
    slide = a * np.cos(phi) + np.sqrt(b * b - (offset - a * np.sin(phi)) ** 2)
    return phi, slide, a, slide[0] + 1j * offset


def rows_of(curves):
    return np.flatnonzero(np.isfinite(curves.dyads[0])).astype(float)


@pytest.mark.parametrize("slides", [False, True])
def test_each_function_of_a_family_is_the_prescribed_one(slides):
    """Cranks and couplers keep their lengths while the output moves as prescribed, at whole rows and between them."""
    for seed in range(6):
        phi, out, *_ = function(seed, slides)
        family = FunctionFamily(phi, out, slides)
        found = family.positions(rows_of(family.drivers)[3:-3:7] + 0.3, family.rows)
        moved = found.joint - found.joint[..., :1] if slides else (found.joint - 1.0) / (found.joint[..., :1] - 1.0)
        rise = out - out[0]
        size = 1.0 + np.max(np.abs(found.joint) ** 2 + np.abs(found.pin) ** 2, axis=-1)
        assert np.nanmax(np.ptp(np.abs(found.joint - found.pin) ** 2, axis=-1) / size) < 1e-11
        assert np.nanmax(np.abs(moved - (rise if slides else np.exp(1j * rise))) / size[..., None]) < 1e-12
        assert np.nanmax(np.abs(found.pin / found.pin[..., :1] - np.exp(1j * (phi - phi[0])))) < 1e-12


def by_determinant(phi, psi, begin):
    """Crank pins and joints of the four-bars that begin at crank angle `begin`: zeros of Freudenstein's four equations."""
    x = begin + phi - phi[0]

    def rows(start):
        y = start[:, None] + psi - psi[0]
        return np.stack([np.cos(y), -np.cos(x) + 0.0 * y, 1.0 + 0.0 * y, np.cos(x - y)], axis=-1)

    grid = np.linspace(0.0, math.tau, 2001)
    value = np.linalg.det(rows(grid))
    for k in np.flatnonzero(np.sign(value[1:]) != np.sign(value[:-1])):
        low, high = grid[k], grid[k + 1]
        for _ in range(45):
            middle = 0.5 * (low + high)
            same = np.sign(np.linalg.det(rows(np.array([middle])))[0]) == np.sign(value[k])
            low, high = (middle, high) if same else (low, middle)
        equations = rows(np.array([low]))[0]
        first, second, _ = np.linalg.lstsq(equations[:, :3], equations[:, 3], rcond=None)[0]
        yield np.exp(1j * begin) / first, 1.0 + np.exp(1j * low) / second


def test_four_bars_of_an_own_sampling_lie_on_the_family():
    compared = 0
    for seed in range(3):
        phi, psi, *_ = function(seed)
        joints, pins = FunctionFamily(phi, psi, slides=False).drivers.dyads
        for begin in np.linspace(0.05, math.pi, 9):
            for pin, joint in by_determinant(phi, psi, begin):
                if max(abs(pin), abs(joint)) < 4.0 and min(abs(pin), abs(joint - 1.0)) > 0.05:
                    assert np.nanmin(np.abs(pins - pin) + np.abs(joints - joint)) < 0.1
                    compared += 1
    assert compared > 20


@pytest.mark.parametrize("slides", [False, True])
def test_known_functions_and_their_defects(slides):
    """A known linkage lies between two rows; what the family tells of all equals what is told of each."""
    seen = set()
    for seed in range(8):
        phi, out, pin, joint = function(seed, slides)
        family = FunctionFamily(phi, out, slides)
        joints, pins = family.drivers.dyads
        pin = pin * np.exp(1j * phi[0])
        assert np.nanmin(np.abs(pins - pin) + np.abs(joints - joint)) < 0.1 * (1.0 + abs(joint))
        rows = rows_of(family.drivers)[::25]
        found = family.positions(rows, family.rows)
        for i in np.flatnonzero(found.pairs.defect[:, 0] < 4):
            first = found[i, 0].defects[:1] or ("",)
            assert first == (DEFECTS[found.pairs.defect[i, 0]],)
            seen |= set(first)
    assert {"", "circuit", "branch"} <= seen


@pytest.mark.slow
def test_timed_points_have_their_crank_and_its_partners():
    for seed in range(2):
        rng = np.random.default_rng(seed)
        _, phi, pins, joints = (part[:4] for part in cranked(rng))
        points = pins + (joints - pins) * complex(*rng.normal(0.4, 0.5, 2))
        family = TimedFamily(points, phi)
        corners, pivots = family.drivers.dyads
        row = int(np.nanargmin(np.abs(points[0] - corners - pins[0]) + np.abs(pivots)))
        near = row + np.linspace(-1.0, 1.0, 21)
        found = family.positions(near, family.rows)
        apart = np.abs(found.pivot) + np.abs(found.pin[..., 0] - pins[0]) + np.abs(found.joint[..., 0] - joints[0])
        assert np.nanmin(apart + np.abs(found.fixed - 1.0)) < 0.15
        for one, other in ((found.joint, found.pin), (found.joint, found.fixed[..., None]), (found.pin, found.pivot[..., None])):
            assert np.nanmax(np.ptp(np.abs(one - other) ** 2, axis=-1) / (1.0 + np.abs(found.joint[..., 0]) ** 2)) < 1e-9
        rod = found.joint - found.pin
        carried = (points - found.pin) * rod[..., :1] - (points[0] - found.pin[..., :1]) * rod
        assert np.nanmax(np.abs(carried) / (1.0 + np.abs(rod) ** 2)) < 1e-9


@pytest.mark.parametrize("slides", [False, True])
def test_three_points_from_given_starts_have_their_linkage(slides):
    for seed in range(5):
        phi, out, pin, joint = function(seed, slides)
        dyad = three_points(phi[:3], out[:3], slides=slides)
        assert complex(*dyad.pivot[:2]) == pytest.approx(pin * np.exp(1j * phi[0]), rel=1e-8)
        assert complex(*dyad.point[:2]) == pytest.approx(joint, rel=1e-8)
    assert three_points(np.array([0.0, 0.5, 0.5]), np.array([0.0, 0.3, 0.3]), slides=slides) is None
