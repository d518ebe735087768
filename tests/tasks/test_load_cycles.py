"""Loads that repeat after one, two or three revolutions of the crank, or never: figures over the whole cycle, or a refusal.

The judge knows nothing of periods: it integrates the virtual work of a slider-crank over a long range of crank angles.
"""

import math
from pathlib import Path

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.problem.targets.expression import parse, revolutions_of
from optlink.studies import sweep

CRANK, ROD, MASS, SPEED = 0.04, 0.14, 0.4, 20.0
ENGINE = """
title = "Piston"
[mechanism.ground]
A = ["0 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "40 mm" }
rod = { joints = ["B", "C"], length = "140 mm" }
piston = { joints = ["C"] }
[mechanism.guides]
G = { slider = "piston", through = "A" }
[mechanism.assembly]
C = "forward"
[bodies]
piston = { mass = "0.4 kg" }
[loads]
gas = { on = "piston", force = "0 N" }
[drive]
speed = "20 rad/s"
"""
LONG, SAMPLES = 12, 4000  # revolutions of the judge, and its positions in each
NAMES = {"sin": np.sin, "cos": np.cos, "tan": np.tan, "exp": np.exp, "sqrt": np.sqrt, "abs": np.abs, "atan": np.arctan}
GROWING = [
    *("-3*phi", "phi^2/20 + 5", "40*exp(-phi/9)", "30*sin(sqrt(2)*phi)", "25*cos(0.4123*phi) + 10", "abs(phi - 3)"),
    *("phi*sin(phi)", "50*atan(phi - 4)", "20*sin(phi + 0.01*phi^2)", "30*cos(phi/2)*exp(-phi/20)"),
]


@pytest.fixture(scope="module")
def engine(tmp_path_factory: pytest.TempPathFactory) -> optlink.ProblemFile:
    path = tmp_path_factory.mktemp("engine") / "engine.toml"
    path.write_text(ENGINE, encoding="utf-8")
    return optlink.load(path)


def judged(force, start=0.0, speed=SPEED):
    """Return the torque of the drive [N m] over many revolutions, by virtual work, with the force as a function of phi, s, v."""
    phi = start + math.copysign(2.0 * math.pi, speed) * np.arange(LONG * SAMPLES) / SAMPLES
    root = np.sqrt(ROD**2 - (CRANK * np.sin(phi)) ** 2)
    x = CRANK * np.cos(phi) + root
    first = -CRANK * np.sin(phi) - CRANK**2 * np.sin(phi) * np.cos(phi) / root
    second = -CRANK * np.cos(phi) - CRANK**2 * np.cos(2.0 * phi) / root - (CRANK**2 * np.sin(phi) * np.cos(phi)) ** 2 / root**3
    return (MASS * second * speed**2 - force(phi, x, first * speed)) * first


def period(force):
    """Return the number of revolutions after which a force repeats; None if none of twelve does."""
    phi = 2.0 * math.pi * np.arange(SAMPLES) / SAMPLES + 0.1234
    rounds = [force(phi + 2.0 * math.pi * k, 0.15, 0.3) for k in range(2 * LONG)]
    size = max(float(np.max(np.abs(values))) for values in rounds)
    for count in range(1, LONG + 1):
        if all(np.allclose(rounds[k], rounds[k + count], rtol=0.0, atol=1e-9 * size) for k in range(LONG)):
            return count
    return None


def written(text):
    def force(phi, s, v):
        known = {**NAMES, "phi": phi, "s": s, "v": v, "pi": math.pi}
        return eval(text.replace("^", "**"), {"__builtins__": {}}, known) + 0.0 * phi  # noqa: S307 - a text of this file

    return {"expression": text, "unit": "N"}, force


def tabulated(rng, revolutions):
    """Return a table over so many revolutions; every other one ends with the row of its beginning."""
    closed = rng.random() < 0.5
    count = int(rng.integers(4, 12))
    begin = float(rng.uniform(-200.0, 200.0))
    shares = np.sort(rng.uniform(0.05, 0.95, count))
    shares[-1] = max(shares[-1], (revolutions - 0.9) / revolutions)
    at = begin + 360.0 * revolutions * np.concatenate([[0.0], shares, [1.0] if closed else []])
    values = rng.uniform(-60.0, 60.0, len(at))
    values[-1] = values[0] if closed else values[-1]
    rows, heights = np.radians(np.append(at, begin + 360.0 * revolutions)), np.append(values, values[0])

    def force(phi, s, v):
        return np.interp(np.remainder(phi - rows[0], 2.0 * math.pi * revolutions) + rows[0], rows, heights)

    size = {"over": "phi", "at": [f"{x!r} deg" for x in at.tolist()], "values": [f"{x!r} N" for x in values.tolist()]}
    return size, force


def random_load(rng):
    """Return a load as written in a file, and the force as a function of crank angle, slide and its velocity."""
    kind = rng.integers(8)
    if kind == 0:
        return written(str(rng.choice(GROWING)))
    if kind <= 2:
        return tabulated(rng, int(rng.integers(1, 4)))
    a, c = rng.uniform(5.0, 60.0, 2).round(3)
    b, d = rng.uniform(-3.0, 3.0, 2).round(3)
    p, q = rng.integers(1, 5), rng.integers(1, 4)
    if q == 3 and kind == 7:
        q = 2
    wave = f"{rng.choice(['sin', 'cos'])}({p}*phi/{q} + {b})"
    forms = {
        3: f"{a}*{wave} - {c}",
        4: f"{a}*{wave}^{rng.integers(2, 7)} + {c}*s",
        5: f"-{a}*exp(3*{wave} - 3) + {c}*sin(phi + {d})",
        6: f"{a}*abs({wave}) - v*{c}/10",
        7: f"{a}*{wave}*cos({rng.integers(1, 4)}*phi/2 + {d}) + 0.1*({d} - phi) + phi/10",
    }
    return written(forms[int(kind)])


def check(engine, rng):
    size, force = random_load(rng)
    count = period(force)
    start = float(rng.uniform(-400.0, 400.0))
    speed = SPEED * float(rng.choice([-1.0, 1.0]))
    problem = engine.override({"loads.gas.force": size, "drive.start": f"{start!r} deg"})
    if count is None:
        with pytest.raises(InputError, match="does not repeat"):
            optlink.analyze(problem, speed=speed)
        return None
    result = optlink.analyze(problem, points=72, speed=speed)
    revolutions = result.cycle / (2.0 * math.pi)
    assert revolutions % count == pytest.approx(0.0, abs=1e-12), size
    torque = judged(force, math.radians(start), speed)
    largest = float(np.max(np.abs(torque)))
    assert result.mean_torque == pytest.approx(float(np.mean(torque)), abs=2e-4 * largest), size
    assert result.rms_torque == pytest.approx(float(np.sqrt(np.mean(torque**2))), rel=1e-3), size
    extremes = result.extremes["input.torque_Nm"]
    between = 1e-4 * largest + float(np.max(np.abs(np.diff(torque))))  # a peak between two positions of the judge
    assert (extremes.least, extremes.largest) == pytest.approx((np.min(torque), np.max(torque)), abs=between), size
    return count


def test_random_loads(engine):
    rng = np.random.default_rng(36)
    assert {check(engine, rng) for _ in range(20)} >= {None, 1, 2, 3}


@pytest.mark.slow
def test_500_random_loads(engine):
    rng = np.random.default_rng(3604)
    counts = [check(engine, rng) for _ in range(500)]
    assert min(counts.count(count) for count in (None, 1, 2, 3)) > 40


@pytest.mark.parametrize(
    ("text", "revolutions"),
    [
        *(("12", 1), ("sin(phi)", 1), ("cos(phi/2 - 0.2)", 2), ("(1 + cos(phi/2))^8", 2), ("abs(sin(phi/2))", 1)),
        *(("sin(phi/2)^2", 1), ("sin(phi/2)*sin(3*phi/2)", 1), ("sin(phi/2)^3", 2), ("tan(phi/2)", 1), ("tan(phi/4)", 2)),
        *(("sin(phi/2) + cos(phi/3)", 6), ("exp(sin(phi/3))/(2 + cos(phi))", 3), ("(phi + 2) - phi + omega*v", 1)),
        *(("(0.1 + 0.2)*phi - 0.3*phi", 1), ("sin((phi + sin(phi/2))/4)", 4), ("atan(tan(phi/4))", 2), ("sin(phi/24)", 24)),
        *(("sin(phi/25)", None), ("phi", None), ("0*phi", 1), ("phi^0 + phi^1 - phi", 1), ("sin(0.333*phi)", None)),
        *(("sin(phi*omega)", None), ("phi*sin(phi)", None), ("2^sin(phi/2)", 2), ("2^phi", None)),
    ],
)
def test_revolutions_of_an_expression(text, revolutions):
    assert revolutions_of(parse(text, ("phi", "omega", "v"))) == revolutions


@pytest.mark.parametrize("speed", [SPEED, -SPEED])
def test_flywheel_counts_the_energy_of_two_revolutions(engine, speed):
    size, force = written("-40*(1 + cos(phi/2 - 0.2))^3")
    problem = engine.override({"loads.gas.force": size, "drive.fluctuation": 0.02})
    found = optlink.analyze(problem, speed=speed).flywheel
    torque = judged(force, 0.0, speed)
    gained = np.cumsum(np.mean(torque) - torque) * 2.0 * math.pi / SAMPLES * math.copysign(1.0, speed)
    energy = float(np.ptp(gained))  # with a heavy flywheel the fluctuation is this by J w^2
    assert found.mean_torque == pytest.approx(float(np.mean(torque)), rel=1e-6)
    assert found.inertia == pytest.approx(energy / (0.02 * SPEED**2), rel=0.02)


def test_the_same_cycle_from_every_start(engine):
    size, force = written("-40*(1 + cos(phi/2 - 0.2))^8")
    problem = engine.override({"loads.gas.force": size})
    means = [
        optlink.analyze(problem.override({"drive.start": f"{start} deg"}), points=12).mean_torque for start in (0, 77, 500, -90)
    ]
    assert means == pytest.approx([float(np.mean(judged(force)))] * 4, rel=1e-9)


def test_a_batch_takes_the_whole_cycle(engine):
    size, force = written("30*sin(phi/3 + 0.4)*s")
    problem = engine.override({"loads.gas.force": size})
    columns = optlink.analyze_batch(problem, {"rod.length": [0.14, 0.15]}, points=48)
    torque = columns["input.torque_Nm"]
    assert torque.shape == (2, 3 * 48)
    assert float(np.mean(torque[0])) == pytest.approx(float(np.mean(judged(force))), abs=1e-9)


def test_balance_measures_the_whole_cycle(engine):
    size, force = written("-40*(1 + cos(phi/2 - 0.2))^3")
    balance = {
        "minimise": "rms torque",
        "springs": [{"name": "helper", "between": ["A", "C"], "stiffness": ["0 N/m", "3000 N/m"], "free_length": "200 mm"}],
    }
    problem = engine.override({"loads.gas.force": size, "balance": balance})
    result = optlink.balance(problem)

    alone = judged(force)
    per_stiffness = judged(lambda phi, s, v: force(phi, s, v) - (s - 0.2)) - alone
    best = -float(np.mean(alone * per_stiffness) / np.mean(per_stiffness**2))  # least squares
    assert result.before == pytest.approx(float(np.sqrt(np.mean(alone**2))), rel=1e-9)
    assert 0.0 < best < 3000.0
    assert result.springs[0].stiffness == pytest.approx(best, rel=1e-5)
    assert result.objective == pytest.approx(float(np.sqrt(np.mean((alone + best * per_stiffness) ** 2))), rel=1e-9)


DESIGN = {
    "mechanism.guides.G.offset": {"start": "5 mm", "bounds": ["-20 mm", "20 mm"]},
    "loads.gas.force": {"expression": "-40*(1 + cos(phi/2 - 0.2))^3", "unit": "N"},
}


def offset_torque(force, offset):
    """Return the torque over many revolutions where the guide passes the crank at a distance, and whether it slides forward."""
    phi = 2.0 * math.pi * np.arange(LONG * SAMPLES) / SAMPLES
    height = CRANK * np.sin(phi) - offset
    root = np.sqrt(ROD**2 - height**2)
    x, first = CRANK * np.cos(phi) + root, -CRANK * np.sin(phi) - height * CRANK * np.cos(phi) / root
    step = 2.0 * math.pi / SAMPLES
    second = (np.roll(first, -1) - np.roll(first, 1)) / (2.0 * step)
    return (MASS * second * SPEED**2 - force(phi, x, first * SPEED)) * first, first > 0.0


@pytest.mark.parametrize(
    ("objective", "drag", "measure"),
    [
        ({"quantity": "torque", "measure": "peak"}, 0.0, lambda torque, ahead: np.max(np.abs(torque))),
        ({"quantity": "torque", "measure": "rms"}, 0.0, lambda torque, ahead: np.sqrt(np.mean(torque**2))),
        ({"quantity": "torque", "measure": "rms"}, 25.0, lambda torque, ahead: np.sqrt(np.mean(torque**2))),
        ({"quantity": "torque", "measure": "largest"}, 25.0, lambda torque, ahead: np.max(torque)),
        (
            {"quantity": "work", "of": "piston", "stroke": "forward"},
            25.0,
            lambda torque, ahead: 2.0 * math.pi * np.mean(torque * ahead),
        ),
    ],
)
@pytest.mark.slow
def test_a_design_is_optimal_over_the_whole_cycle(engine, objective, drag, measure):
    resistance = {"loads.drag": {"on": "piston", "force": f"{drag} N", "acts": "opposing"}} if drag else {}
    problem = engine.override({**DESIGN, **resistance, "objective": objective})
    _, gas = written(DESIGN["loads.gas.force"]["expression"])

    def measured(offset):
        torque, ahead = offset_torque(lambda phi, s, v: gas(phi, s, v) - drag * np.sign(v), offset)
        return measure(torque, ahead)

    result = optlink.solve(problem, starts=2)
    assert result.valid
    best = min(np.linspace(-0.02, 0.02, 401), key=measured)
    assert result.objective == pytest.approx(measured(best), rel=2e-4)
    assert result.design["G.offset"] == pytest.approx(best, abs=4e-4)


@pytest.mark.parametrize("goal", [{"objective": {"quantity": "torque", "measure": "peak"}}, {}])
def test_a_design_with_a_load_that_never_repeats_is_refused(engine, goal):
    changes = {**DESIGN, "loads.gas.force": {"expression": "-3*phi", "unit": "N"}, **goal}
    with pytest.raises(InputError, match=r"loads\.gas\.force.*does not repeat.*optlink simulate"):
        optlink.analyze(engine.override(changes))


def test_a_load_that_never_repeats_can_be_simulated(engine):
    problem = engine.override({"loads.gas.force": {"expression": "-3*phi", "unit": "N"}})
    run = optlink.simulate(problem, duration=3.0 * 2.0 * math.pi / SPEED, rows=300)
    phi = np.radians(run["crank_angle_deg"])
    torque = judged(lambda phi, s, v: -3.0 * phi)[: 3 * SAMPLES + 1]
    expected = np.interp(phi, 2.0 * math.pi * np.arange(len(torque)) / SAMPLES, torque)
    assert run["input.torque_Nm"] == pytest.approx(expected, abs=1e-4)


def test_tables_of_several_revolutions(engine):
    table = {"over": "phi", "at": ["0 deg", "700 deg"], "values": ["0 N", "-50 N"]}
    assert optlink.analyze(engine.override({"loads.gas.force": table})).cycle == pytest.approx(4.0 * math.pi)
    with pytest.raises(InputError, match="longer than 24 revolutions"):
        engine.override({"loads.gas.force": {**table, "at": ["0 deg", "9000 deg"]}})
    loads = {
        "loads.gas.force": {"expression": "sin(phi/7)", "unit": "N"},
        "loads.more": {"on": "crank", "torque": {"expression": "sin(phi/5)", "unit": "N*m"}},
    }
    with pytest.raises(InputError, match="repeat together only after 35 revolutions"):
        optlink.analyze(engine.override(loads))


def test_a_sweep_takes_the_whole_cycle(engine, tmp_path: Path):
    size, force = written("-40*(1 + cos(phi/2 - 0.2))^3")
    columns = ["input.work_per_cycle_J", "input.torque_Nm.max", "input.torque_Nm.rms"]
    problem = engine.override({"loads.gas.force": size})
    table = sweep(
        problem, ["mechanism.links.rod.length=130 mm, 140 mm"], tmp_path, analyze=True, columns=columns, workers=1
    ).columns
    torque = judged(force)
    assert [float(table[name][1]) for name in columns] == pytest.approx(
        [4.0 * math.pi * np.mean(torque), np.max(torque), np.sqrt(np.mean(torque**2))], rel=1e-5
    )


def test_simulated_speed_is_that_of_the_last_cycle(engine):
    size, force = written("-40*(1 + cos(phi/2 - 0.2))^3")
    mean = float(np.mean(judged(force)))
    drive = {"drive.torque": f"{mean!r} N*m", "drive.initial_speed": "20 rad/s"}
    problem = engine.override({"loads.gas.force": size, **drive})
    run = optlink.simulate(problem, duration=1.0, rows=20_000, flywheel=0.5)
    turned = np.abs(run["crank_angle_deg"] - run["crank_angle_deg"][-1])
    last = run["crank.omega_rad_s"][turned <= 720.0]
    assert run.figures["last_turn.revolutions"] == 2.0
    assert run.figures["last_turn.mean_speed_rad_s"] == pytest.approx(float(np.mean(last)), rel=1e-3)
    assert run.figures["last_turn.fluctuation"] == pytest.approx(float(np.ptp(last) / np.mean(last)), rel=1e-2)
