"""Chains of parallelograms and antiparallelograms: every joint against its own formula, the motion in time against one pendulum.

A parallelogram passes the angle of its crank on unchanged. An antiparallelogram of crank a and frame c turns its rocker to the
angle psi of tan(psi / 2) = -(c + a) / (c - a) tan(phi / 2): both are smooth through the positions with all four links in line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import optlink
from optlink.dynamics.forward import Ending
from tests.tiers import mostly_slow

SEEDS = range(24)


@dataclass
class Chain:
    """A drawn chain: lengths [m], the turn [rad] from each rocker to the crank of the next link, and which links are crossed."""

    crank: float
    frames: list[float]
    cranks: list[float]
    offsets: list[float]
    crossed: list[bool]
    origin: complex
    ways: list[float]  # direction [rad] of each frame
    start: float
    places: list[complex] = field(default_factory=list)

    def __post_init__(self):
        steps = [c * np.exp(1j * way) for c, way in zip(self.frames, self.ways, strict=True)]
        self.places = [complex(z) for z in self.origin + np.cumsum([0.0, *steps])]

    def angles(self, phi):
        """Directions [rad] of the crank of every link and of the rocker of every link, by the formulas above."""
        driving, driven, angle = [], [], phi
        for c, a, offset, crossed, way in zip(self.frames, self.cranks, self.offsets, self.crossed, self.ways, strict=True):
            angle = angle + offset
            driving.append(angle)
            if crossed:
                half = 0.5 * (angle - way)
                angle = way + 2.0 * np.arctan2(-(c + a) * np.sin(half), (c - a) * np.cos(half))
            driven.append(angle)
        return driving, driven

    def joints(self, phi):
        """Complex positions [m] of both coupler joints of every link."""
        driving, driven = self.angles(phi)
        first = [z + a * np.exp(1j * t) for z, a, t in zip(self.places, self.cranks, driving, strict=False)]
        second = [z + a * np.exp(1j * t) for z, a, t in zip(self.places[1:], self.cranks, driven, strict=True)]
        return first, second

    def problem(self, **more):
        n, first, second = len(self.frames), *self.joints(self.start)
        ground = {f"A{k}": [f"{z.real!r} m", f"{z.imag!r} m"] for k, z in enumerate(self.places)}
        links = {"crank": {"joints": ["A0", "B0"], "length": f"{self.crank!r} m"}}
        assembly = {}
        for k in range(1, n + 1):
            p, a, c = self.name(k), self.cranks[k - 1], self.frames[k - 1]
            if p != f"B{k - 1}":
                along, across = a * math.cos(self.offsets[k - 1]), a * math.sin(self.offsets[k - 1])
                links[f"r{k - 1}" if k > 1 else "crank"]["points"] = {p: [f"{along!r} m", f"{across!r} m"]}
            links[f"c{k}"] = {"joints": [p, f"B{k}"], "length": f"{c!r} m"}
            links[f"r{k}"] = {"joints": [f"A{k}", f"B{k}"], "length": f"{a!r} m"}
            towards, turned = self.places[k] - first[k - 1], second[k - 1] - first[k - 1]
            side = "left" if (towards.conjugate() * turned).imag > 0.0 else "right"
            assembly[f"B{k}"] = f"{side} of {p}-A{k}, continue"
        mechanism = {"ground": ground, "links": links, "assembly": assembly}
        drive = {"start": f"{math.degrees(self.start)!r} deg"}
        return optlink.read({"title": "chain", "mechanism": mechanism, "drive": drive, **more})

    def name(self, k):
        """Name of the joint between the crank of link k, counted from 1, and its coupler."""
        return f"B{k - 1}" if self.offsets[k - 1] == 0.0 else f"E{k - 1}"


def drawn(seed):
    """A chain of 2 to 20 links: bell cranks or straight ones, frames in one line or not, crossed links at up to two places."""
    rng = np.random.default_rng([36, seed])
    n = 2 + seed % 19
    bent, crooked = bool(seed % 2), bool(seed % 3)
    crank = float(rng.uniform(0.03, 0.2))
    offsets = [float(rng.uniform(0.3, 2.8) * rng.choice([-1.0, 1.0])) if bent else 0.0 for _ in range(n)]
    cranks = [float(rng.uniform(0.03, 0.2)) if bent else crank for _ in range(n)]
    frames = [float(a * rng.choice([rng.uniform(1.3, 5.0), rng.uniform(0.2, 0.7), 1.0 if seed % 4 else 2.0])) for a in cranks]
    crossed = [False] * n
    if seed % 5 < 2:
        for k in rng.choice(n, 2, replace=False):
            crossed[k] = abs(frames[k] / cranks[k] - 1.0) > 0.5
    ways = np.full(n, rng.uniform(-3.0, 3.0)) + (rng.uniform(-2.0, 2.0, n) if crooked else 0.0)
    chain = Chain(crank, frames, cranks, offsets, crossed, complex(*rng.uniform(-1.0, 1.0, 2)), [float(w) for w in ways], 0.0)
    starts = np.linspace(-3.0, 3.0, 241)
    away = [np.abs(np.sin(np.array(chain.angles(t)[0]) - chain.ways)).min() for t in starts]
    chain.start = float(starts[int(np.argmax(away))])  # where no link is near its alignment, so that every mode is plain
    return chain


@pytest.mark.parametrize("seed", mostly_slow(SEEDS, 3, 11))
def test_every_joint_of_a_chain_follows_its_own_formula(seed):
    chain = drawn(seed)
    result = optlink.analyze(chain.problem(), points=72)
    assert result.full
    assert result.valid
    assert result.cycle == pytest.approx(2.0 * math.pi)
    phi = np.radians(result["crank_angle_deg"])
    first, second = chain.joints(phi)
    crank = chain.places[0] + chain.crank * np.exp(1j * phi)
    np.testing.assert_allclose(result["B0.x_m"] + 1j * result["B0.y_m"], crank, atol=1e-12)
    for k in range(1, len(chain.frames) + 1):
        for name, place in ((chain.name(k), first[k - 1]), (f"B{k}", second[k - 1])):
            np.testing.assert_allclose(result[f"{name}.x_m"], place.real, atol=1e-10, err_msg=f"{seed} {name}")
            np.testing.assert_allclose(result[f"{name}.y_m"], place.imag, atol=1e-10, err_msg=f"{seed} {name}")
    if not any(chain.crossed):  # the speed of the drive is that of every rocker
        speed = result["crank.omega_rad_s"]
        for k in range(1, len(chain.frames) + 1):
            np.testing.assert_allclose(result[f"r{k}.omega_rad_s"], speed, rtol=1e-8)
            np.testing.assert_allclose(result[f"r{k}.alpha_rad_s2"], 0.0, atol=1e-6)


def windows(count, duration):
    """The windows of the IFToMM benchmark A02: bars of 1 m and 1 kg, upright at the start, pushed sideways with 1 m/s."""
    ground = {f"A{k}": [f"{k} m", "0 m"] for k in range(count + 1)}
    links = {"crank": {"joints": ["A0", "B0"], "length": "1 m"}}
    for k in range(1, count + 1):
        links |= {
            f"c{k}": {"joints": [f"B{k - 1}", f"B{k}"], "length": "1 m"},
            f"r{k}": {"joints": [f"A{k}", f"B{k}"], "length": "1 m"},
        }
    assembly = {f"B{k}": f"left of B{k - 1}-A{k}, continue" for k in range(1, count + 1)}
    raw = {
        "title": "windows",
        "gravity": "9.81 m/s^2",
        "mechanism": {"ground": ground, "links": links, "assembly": assembly},
        "bodies": {name: {"mass": "1 kg", "inertia": "uniform bar"} for name in links},
        "drive": {"start": "90 deg", "initial_speed": "-1 rad/s", "torque": "0 N*m", "duration": f"{duration} s"},
    }
    return optlink.read(raw)


@pytest.mark.parametrize("count", mostly_slow([2, 7, 40], 2))
def test_windows_of_the_benchmark_swing_as_one_pendulum(count):
    """N + 1 bars turn about their ends, and N move along without turning: one pendulum, of an equation of its own."""
    run = optlink.simulate(windows(count, 10.0), rows=200)
    assert run.ending is Ending.FINISHED
    inertia, weight = (count + 1) / 3.0 + count, 9.81 * (0.5 * (count + 1) + count)
    expected = solve_ivp(
        lambda _, y: [y[1], -weight * math.cos(y[0]) / inertia],
        (0.0, 10.0),
        [0.5 * math.pi, -1.0],
        method="DOP853",
        rtol=1e-12,
        atol=1e-13,
        t_eval=run["time_s"],
    )
    np.testing.assert_allclose(run["crank.angle_rad"], expected.y[0], atol=1e-8)
    np.testing.assert_allclose(run[f"r{count}.angle_rad"] - run["crank.angle_rad"], 0.0, atol=1e-10)
    assert run.figures["imbalance_J"] < 1e-9 * run.figures["turnover_J"]
    assert run.evaluations < 6000


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 38, 76, 190])
def test_uncrossed_chains_with_masses_swing_as_one_pendulum(seed):
    chain = drawn(seed)
    assert not any(chain.crossed) or seed % 5 < 2
    chain.crossed = [False] * len(chain.frames)
    n = len(chain.frames)
    bodies = {"crank": {"mass": "1.5 kg", "inertia": "uniform bar"}}
    bodies |= {f"{k}{i}": {"mass": "2 kg", "inertia": "uniform bar"} for i in range(1, n + 1) for k in "cr"}
    drive = {"start": f"{math.degrees(chain.start)!r} deg", "torque": "0 N*m", "initial_speed": "3 rad/s", "duration": "2 s"}
    run = optlink.simulate(chain.problem(gravity="9.81 m/s^2", bodies=bodies, drive=drive), rows=100)
    assert run.ending is Ending.FINISHED
    masses, arms = [1.5], [0.5 * chain.crank * np.exp(0j)]
    inertia, turned = 1.5 * chain.crank**2 / 3.0, 0.0
    for a, offset in zip(chain.cranks, chain.offsets, strict=True):
        turned += offset
        masses += [2.0, 2.0]
        arms += [a * np.exp(1j * turned), 0.5 * a * np.exp(1j * turned)]  # the coupler moves along with its joint
        inertia += 2.0 * a**2 + 2.0 * a**2 / 3.0
    moment = 9.81 * np.dot(masses, arms)
    expected = solve_ivp(
        lambda _, y: [y[1], -(moment * np.exp(1j * y[0])).real / inertia],
        (0.0, 2.0),
        [chain.start, 3.0],
        method="DOP853",
        rtol=1e-12,
        atol=1e-13,
        t_eval=run["time_s"],
    )
    np.testing.assert_allclose(run["crank.angle_rad"], expected.y[0], atol=1e-7)
