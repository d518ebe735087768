"""The record of what problems are solved to: it finds what differs, and only that."""

from __future__ import annotations

import copy
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import record


@pytest.fixture(scope="module")
def entry() -> dict[str, Any]:
    """The crank-rocker, as JSON."""
    one = record.entry(record.Case("crank-rocker"), "ipopt", 0, None, record.yardstick())
    return json.loads(json.dumps(one))


def test_an_entry_has_what_a_search_found(entry: dict[str, Any]) -> None:
    assert entry["valid"]
    assert entry["status"] == "optimal"
    assert entry["design"]["coupler"] == pytest.approx(0.412865, abs=1e-6)
    assert entry["objective"] == pytest.approx(0.00759237, rel=1e-6)
    assert entry["active"]["largest transmission angle"]["multiplier"] < 0.0
    assert entry["certificate"]["closed"]
    assert record.differences(entry, copy.deepcopy(entry)) == []


CHANGES: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "a worse objective": (lambda one: one.update(objective=one["objective"] * (1.0 + 1e-8)), "objective worse"),
    "a better objective": (lambda one: one.update(objective=one["objective"] * (1.0 - 1e-8)), "objective better"),
    "no objective": (lambda one: one.update(objective=float("nan")), "objective worse"),
    "another design": (lambda one: one["design"].update(coupler=0.4129), "design: coupler"),
    "another verdict": (lambda one: one.update(valid=False), "valid: True -> False"),
    "a failed check": (lambda one: one.update(failed=["error"]), "failed: []"),
    "another price": (lambda one: one["active"]["largest transmission angle"].update(multiplier=1.0), "price of largest"),
    "a limit no longer active": (lambda one: one["active"].clear(), "active limits"),
    "no certificate": (lambda one: one.update(certificate=None), "certificate"),
    "more boxes": (lambda one: one["certificate"].update(boxes=2 * one["certificate"]["boxes"]), "boxes"),
    "a fault of the judge": (lambda one: one.update(faults=["the crank does not turn fully"]), "faults"),
    "another fault": (lambda one: one.update(faults=["crank is 1.0"]), "faults"),
    "refused": (lambda one: one.update(refused="unknown key"), "accepted -> unknown key"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_difference_is_listed(entry: dict[str, Any], name: str) -> None:
    change, words = CHANGES[name]
    other = copy.deepcopy(entry)
    change(other)
    assert [row for row in record.differences(entry, other) if row.startswith(words)]
    assert len(record.differences(entry, other)) == 1


def test_rounding_is_no_difference(entry: dict[str, Any]) -> None:
    other = copy.deepcopy(entry)
    other["objective"] *= 1.0 + 1e-12
    other["design"] = {key: value * (1.0 - 1e-12) for key, value in other["design"].items()}
    assert record.differences(entry, other) == []


def test_a_whole_turn_is_no_difference(entry: dict[str, Any]) -> None:
    turned = entry | {"design": entry["design"] | {"phi0": entry["design"]["phi0"] - 2.0 * math.pi}}
    assert record.differences(entry, turned) == []
    assert record.differences(entry, entry | {"design": entry["design"] | {"phi0": entry["design"]["phi0"] + math.pi}})


def test_a_longer_search_is_listed(entry: dict[str, Any]) -> None:
    assert record.slower(entry, entry | {"ratio": 1.1 * entry["ratio"]}) == []
    assert record.slower(entry, entry | {"ratio": 1.3 * entry["ratio"]})[0].startswith("slower: ")


def test_two_records_are_compared(entry: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [tmp_path / name for name in ("before.json", "after.json")]
    meant = entry | {"problem": "crank-rocker-robust"}
    other = copy.deepcopy(entry) | {"valid": False, "hash": "another"}
    for file, entries in zip(
        files, ([entry, meant], [other, meant | {"objective": meant["objective"] * (1.0 + 1e-5)}]), strict=True
    ):
        file.write_text(json.dumps({"schema": record.SCHEMA, "entries": entries}), encoding="utf-8")
    assert record.compare(*files, record.DIGITS) == 1
    shown = capsys.readouterr().out
    assert "crank-rocker | ipopt | 0 | valid: True -> False" in shown
    assert "[meant: the largest deviation counts over the whole range]" in shown
    assert "1 problems have another hash, such as crank-rocker\n" in shown
    assert record.compare(files[0], files[0], record.DIGITS) == 0
    assert "hash" not in capsys.readouterr().out
    files[1].write_text(json.dumps({"schema": record.SCHEMA, "entries": [entry]}), encoding="utf-8")
    assert record.compare(*files, record.DIGITS) == 1
    assert "1 searches are missing: crank-rocker-robust" in capsys.readouterr().out


@pytest.mark.slow
def test_a_record_is_extended(tmp_path: Path) -> None:
    out = tmp_path / "record.json"
    for seeds in ([0], [0, 1]):
        record.record(out, iter([record.Case("path-vline6")]), seeds, ["ipopt"], 20, float("inf"))
        entries = json.loads(out.read_text(encoding="utf-8"))["entries"]
        assert [one["seed"] for one in entries] == seeds


def test_every_design_problem_and_template_is_a_case() -> None:
    names = [case.name for case in record.shipped()]
    assert {"crank-rocker", "balance-six-bar", "shaper-design", "template wiper"} <= set(names)
    assert not {"whitworth", "template pump", "six-bar"} & set(names)
