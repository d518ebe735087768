"""A fuzz of problem files: each changed file loads and is usable, or is refused with faults; never another exception."""

from __future__ import annotations

import copy
import json
import math
import random
import string
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.dynamics.columns import MotionColumns
from optlink.errors import InputError
from optlink.problem.file import load, read
from optlink.tasks.analyze import analyze
from optlink.tasks.machine import machine_of
from tests.tiers import mostly_slow

N12 = ["1 N", "2 N"]
COMMON: list[Any] = [
    *(None, True, -1, 0, 1e308, -0.0, math.nan, math.inf, 10**30, "", " ", "mm", "1 mm", "-5 mm", "1e-300 m", "1e300 km"),
    *("5 deg", "90 rpm", "\0", "phi", "((", "9" * 400, "9" * 400 + " mm", [], {}, [[]], ["1 mm", "2 mm"], {"csv": ".."}),
    {"bounds": ["1 mm", "2 mm"]},
]
OF_LAWS: list[Any] = [
    *(
        "__import__('os')",
        "5 mm mm",
        "5 m*m/m",
        "5 /mm",
        "5 m**-1",
        "5 °",
        "5 m^9999",
        "٣ mm",
        "outer dead centre",
        "span",
        "max",
    ),
    *(["1 mm"], ["2 deg", "1 deg"], [1, 2], {"start": "1 mm"}, {"bounds": []}, {"bounds": ["1 mm", "2 mm"], "start": "3 mm"}),
    *("1..2 mm", "1 deg .. 2 deg", "<= 3", ">= 1 mm", "1,5 mm", "1-2 mm", "..", "1..", "5 Nm", "1..2..3", "2..1 m"),
    *({"min": 1}, {"csv": "/dev/null"}, {"phi": ["0 deg"], "psi": [0]}),
]
OF_MACHINES: list[Any] = [
    *("crank", "frame", "A", "B", "C", "E", "slider", "left of B-D", "forward", "backward", "slow", "opposing", "uniform bar"),
    *("1 kg", "1e-200 kg", "5 N", "-5 kN", "3 N*m", "500 N/m", "20 N*s/m", "1 s", "middle"),
    *(["A"], ["A", "B"], ["B", "C"], ["E"], ["0 mm", "0 mm"]),
    *({"mass": "1 kg"}, {"joints": ["B", "C"], "length": "1 m"}, {"joints": ["E"]}, {"slider": "slider", "through": "D"}),
    *({"on": "slider", "force": "5 N"}, {"on": "slider", "damping": "5 N*s/m"}, {"between": ["A", "C"], "stiffness": "5 N/m"}),
    *({"on": "link2", "torsional_stiffness": "5 N*m/rad"}, {"start": "1 m", "bounds": ["0.1 m", "2 m"]}),
    *({"over": "s", "at": ["0 m", "1 m"], "values": N12}, {"over": "phi", "at": ["0 deg", "100 deg"], "values": N12}),
    *({"over": "omega", "csv": "/dev/null"}, {"expression": "1/(s-0.5)", "unit": "N"}, {"expression": "log(phi)", "unit": "N*m"}),
]


def mutate(tree: dict[str, Any], junk: list[Any], rng: random.Random) -> None:
    """One random change somewhere in nested tables and lists."""
    node, key = tree, rng.choice(list(tree) or [""])
    while isinstance(node.get(key), dict) and node[key] and rng.random() < 0.83:
        node, key = node[key], rng.choice(list(node[key]))
    action = rng.random()
    if action < 0.55:
        node[key] = copy.deepcopy(rng.choice(junk))
    elif action < 0.66:
        node.pop(key, None)
    elif action < 0.76:
        node["".join(rng.choices(string.printable, k=rng.randint(0, 12)))] = copy.deepcopy(rng.choice(junk))
    elif action < 0.8:
        node[rng.choice(list(node) or ["x"])] = copy.deepcopy(node.get(key))
    elif isinstance(node.get(key), str) and node[key]:
        text = list(node[key])
        for _ in range(rng.randint(1, 4)):
            text[rng.randrange(len(text))] = rng.choice(string.printable)
        node[key] = "".join(text)
    elif isinstance(node.get(key), list) and node[key]:
        node[key][rng.randrange(len(node[key]))] = copy.deepcopy(rng.choice(junk))


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Random bytes changed, cut or doubled."""
    result = bytearray(data)
    for _ in range(rng.randint(1, 5)):
        at, choice = rng.randrange(len(result)), rng.random()
        if choice < 0.5:
            result[at] = rng.randrange(256)
        elif choice < 0.75:
            del result[at : at + rng.randint(1, 40)]
        else:
            result[at:at] = result[at : at + rng.randint(1, 40)]
    return bytes(result)


def laws() -> list[dict[str, Any]]:
    """The crank-rocker, and with a table as its law, and other limits."""
    raw = dict(load("crank-rocker").raw)
    law = {"phi": ["0 deg", "30 deg", "90 deg"], "psi": ["0 deg", "3 deg", "30 deg"], "measured_from": "start"}
    table = {"law": law, "from": {"start": "40 deg", "bounds": ["0 deg", "90 deg"]}, "psi0": "100 deg"}
    limits = {"swing_angle": ["30 deg", "60 deg"], "time_ratio": {"max": 1.5}, "link_ratio": [0.1, 5]}
    return [raw, raw, {**raw, "requirement": table, "limits": raw["limits"] | limits}]


def machines() -> list[dict[str, Any]]:
    return [dict(load(name).raw) for name in ("six-bar", "shaper", "toggle-press")]


def use_law(problem: optlink.ProblemFile, _: int) -> None:
    assert all(math.isfinite(bound) for q in problem.model.quantities.values() for bound in (q.value, *q.bounds))
    if "requirement" in problem.raw:
        assert len(problem.spec.law.offsets) >= 1
        assert np.all(np.isfinite(problem.spec.law.tabulated))


def use_machine(problem: optlink.ProblemFile, number: int) -> None:
    assert all(math.isfinite(q.value) for q in problem.model.quantities.values())
    drive = problem.model.drive
    MotionColumns(machine_of(problem).moving(np.linspace(drive.start.value, drive.start.value + 6.0, 7), drive.speed.value))
    if number % 15 == 0:
        try:
            json.dumps(analyze(problem, points=12).to_dict(), allow_nan=False)
        except InputError as error:
            assert {fault.key for fault in error.faults} <= {"drive.start", "speed"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bases", "junk", "use", "count", "usable"),
    [(laws, OF_LAWS, use_law, 2500, 100), (machines, OF_MACHINES, use_machine, 1500, 150)],
    ids=["laws", "machines"],
)
def test_mutated_problems_never_break_the_loader(bases, junk, use, count, usable):
    rng, originals, loaded = random.Random(23), bases(), 0
    for k in range(count):
        raw = copy.deepcopy(originals[k % 3])
        for _ in range(rng.randint(1, 3)):
            mutate(raw, COMMON + junk, rng)
        try:
            problem = read(raw)
        except InputError as error:
            assert error.faults
            assert all(fault.remedy and fault.message for fault in error.faults)
            continue
        loaded += 1
        use(problem, loaded)
    assert usable < loaded < 0.5 * count


@pytest.mark.parametrize("name", mostly_slow(("crank-rocker", "six-bar", "shaper", "toggle-press"), "six-bar"))
def test_mutated_bytes_never_break_the_loader(name, tmp_path):
    rng, original, path = random.Random(29), optlink.shipped()[name].read_bytes(), tmp_path / "mutated.toml"
    loaded = 0
    for _ in range(300):
        path.write_bytes(mutated(original, rng))
        try:
            load(path)
            loaded += 1
        except InputError as error:
            assert "mutated.toml" in str(error)
    assert loaded > 5
