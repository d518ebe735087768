"""Constants that steer the searches: their inventory and the benchmark that halves and doubles them."""

import re
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))
import constants as bench  # noqa: E402

from docs.generate.constants import KINDS  # noqa: E402

SOURCE = '''"""A module."""

from __future__ import annotations

import math

STEPS = 60  # of the descent
LEAST, MOST = 1e-6, 2.0 * math.pi  # rad; smallest and largest
SHARE = 0.99
"""Share of the way."""
TWICE = 2 * STEPS
NAME = "slow"


def run(steps: int = STEPS, largest: float = 0.5) -> tuple[int, float, int]:
    return steps, LEAST, TWICE
'''


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A package with one module; its constants by name."""
    folder = tmp_path / "optlink" / "solvers"
    folder.mkdir(parents=True)
    (folder / "local.py").write_text(SOURCE, encoding="utf-8")
    monkeypatch.setattr(bench, "ROOT", tmp_path)
    monkeypatch.setattr(bench, "PACKAGES", ("solvers",))
    return {one.name: one for one in bench.constants()}


def compiled(watch: bench.Watch) -> dict[str, Any]:
    """The names of the module as it is compiled for the searches."""
    tree = watch.transformed(bench.ast.parse(SOURCE), "solvers.local")
    names = {"__told__": watch.told}
    exec(compile(bench.ast.fix_missing_locations(tree), "local.py", "exec", dont_inherit=True), names)
    return names


def test_the_inventory_has_numbers_with_their_comments(module: Any) -> None:
    found = {name: (one.key, one.text, one.comment) for name, one in module.items()}
    both = "rad; smallest and largest"
    assert found == {
        "STEPS": ("solvers.local.STEPS", "60", "of the descent"),
        "LEAST": ("solvers.local.LEAST", "1e-06", both),
        "MOST": ("solvers.local.MOST", "2.0 * math.pi", both),
        "SHARE": ("solvers.local.SHARE", "0.99", "Share of the way."),
    }
    assert list(bench.defaults()) == ["solvers.local.run(largest = 0.5)"]


@pytest.mark.parametrize(("name", "factor", "found"), [("STEPS", 0.5, (30, 1e-6, 60)), ("LEAST", 2.0, (60, 2e-6, 120))])
def test_another_value_reaches_defaults_and_what_is_computed_from_it(
    module: Any, name: str, factor: float, found: tuple[int, float, int]
) -> None:
    watch = bench.Watch(frozenset(one.key for one in module.values()))
    watch.change = (module[name].key, factor)
    assert compiled(watch)["run"]() == found


def test_a_constant_that_is_read_later_needs_no_other_import(module: Any) -> None:
    watch = bench.Watch(frozenset(one.key for one in module.values()))
    names = compiled(watch)
    watch.change = (module["LEAST"].key, 2.0)
    assert names["run"]() == (60, 2e-6, 120)


def test_what_a_search_reads_is_told(module: Any) -> None:
    watch = bench.Watch(frozenset(one.key for one in module.values()))
    names = compiled(watch)
    watch.early, watch.read = watch.read, set()
    assert watch.early == {"solvers.local.STEPS"}  # as a default, and for another constant
    assert watch.reached() == set()
    names["run"]()
    assert watch.reached() == {"solvers.local.STEPS", "solvers.local.LEAST"}


@pytest.mark.parametrize(
    ("value", "half", "double"),
    [
        (60, 30, 120),
        (1, 0, 2),
        (3, 2, 6),
        (0.3, 0.15, 0.6),
        ((2, 0.5), (1, 0.25), (4, 1.0)),
        ({"m": 4.0}, {"m": 2.0}, {"m": 8.0}),
    ],
)
def test_values_are_halved_and_doubled(value: Any, half: Any, double: Any) -> None:
    assert (bench.scaled(value, 0.5), bench.scaled(value, 2.0)) == (half, double)


def test_a_number_near_one_moves_in_its_distance_from_one() -> None:
    assert bench.scaled(0.99, 0.5) == pytest.approx(0.995)
    assert bench.scaled(1.0005, 2.0) == pytest.approx(1.001)


def test_effects_are_told() -> None:
    stated = {"objectives": [2.0], "valid": True, "told": [], "starts": 3, "evaluations": 100, "seconds": 1.0}
    assert bench.effect(stated, stated | {"objectives": [2.0 + 1e-12]}) == ""
    assert bench.effect(stated, stated | {"objectives": [2.5], "valid": False}) == "worse by 0.2, not valid"
    assert bench.effect(stated, stated | {"objectives": [1.0], "evaluations": 50}) == "better by 0.5, evaluations -50 %"
    assert bench.effect(stated, stated | {"seconds": 3.0}) == "time x 3"
    assert bench.effect(stated | {"seconds": 0.1}, stated | {"seconds": 0.3}) == ""  # noise
    proof = stated | {"told": ["global", 100]}
    assert bench.effect(proof, proof | {"told": ["global", 150]}) == "boxes +50 %"
    assert bench.effect(proof, proof | {"told": ["within gap", 100]}) == "global -> within gap"
    assert bench.effect(stated, {"fault": "ValueError: none"}) == "ValueError: none"


def test_every_constant_is_used() -> None:
    """A constant that nothing reads steers nothing."""
    files = {file: re.sub(r"#.*", "", file.read_text(encoding="utf-8")) for file in (ROOT / "optlink").rglob("*.py")}
    unused = []
    for one in bench.constants():
        own = (ROOT / "optlink" / one.module.replace(".", "/")).with_suffix(".py")
        name, users = re.compile(rf"\b{one.name}\b"), re.compile(rf"import .*\b{own.stem}\b|from optlink\.{one.module} import")
        if len(name.findall(files[own])) < 2 and not any(name.search(text) and users.search(text) for text in files.values()):
            unused.append(one.key)
    assert unused == []


def test_every_constant_is_measured_or_has_a_reason_of_a_known_kind() -> None:
    """A reason is one of a constant that is there."""
    reasons, recorded, known = bench.reasons(), bench.recorded(), list(bench.constants())
    assert set(reasons) <= {one.key for one in known}
    assert {reason.partition(":")[0] for reason in reasons.values()} <= set(KINDS)
    left = [one.key for one in known if one.key not in reasons and (one.key, one.text) not in recorded]
    assert left == [], f"measure, or give a reason in {bench.REASONS.name}: {left}"
