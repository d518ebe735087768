"""What the shipped problems, the templates and random problems are solved to, and the differences of two such records.

    python benchmarks/record.py OUT.json                        # this checkout: problems and templates, seeds 0 and 1
    python benchmarks/record.py OUT.json --code ../other        # another checkout, by the public interface alone
    python benchmarks/record.py OUT.json --random 300 --starts 20
    python benchmarks/record.py --compare BEFORE.json AFTER.json

Every search runs in this process. Its time is processor time divided by that of the crank-rocker, which is measured beside it.
A record is extended: what it has is not solved again.
"""

from __future__ import annotations

import argparse
import json
import math
import platform
import re
import sys
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from timing import ROOT

SCHEMA = "optlink/record/1"
BACKENDS = ("ipopt", "slsqp")
YARDSTICK = "crank-rocker"
LIMIT = ("key", "sense", "bound", "unit", "multiplier", "price")  # what is recorded of an active limit
SHORT = 0.1  # s of processor time: a search that takes less is repeated that long, and the least time counts
AGAIN = 1.0  # s of processor time after which the crank-rocker is measured again

DIGITS = 1e-9  # relative difference of a design or an objective that counts
PRICES = 1e-6  # of shadow prices
ROUNDING = 1e-16  # objective [SI] of a design without errors, unless an entry states its own
SLOWER = 1.2  # ratio of the times
MORE_BOXES = 1.2  # ratio of the boxes of a proof
QUICK = 0.05  # of a crank-rocker: differences of shorter times do not count
MEANT = {
    "crank-rocker-robust": (1e-4, "the largest deviation counts over the whole range"),
    "template law": (3e-3, "the largest deviation counts over the whole range"),
    "function-log10": (1e-8, "the earlier exchange stopped at 1e-8"),
}
"""Problems whose figures may move: by how much, and why."""


@dataclass(frozen=True)
class Case:
    """A problem as a file states it, what is known of it, and a judge of results that lists faults."""

    name: str
    raw: Mapping[str, Any] | None = None  # None: a shipped problem
    known: Mapping[str, Any] = field(default_factory=dict)
    judge: Callable[[Any], list[str]] = lambda result: []

    def load(self) -> Any:
        """Return the problem."""
        import optlink

        return optlink.load(self.name) if self.raw is None else optlink.read(dict(self.raw))


def shipped() -> Iterator[Case]:
    """Every shipped problem and template that has something to optimise."""
    import optlink

    for name, file in optlink.shipped().items():
        if designs(tomllib.loads(file.read_text(encoding="utf-8"))):
            yield Case(name)
    for file in sorted((Path(optlink.__file__).parents[1] / "templates").glob("*.toml")):
        raw = tomllib.loads(optlink.new(file.stem))
        if designs(raw):
            yield Case(f"template {file.stem}", raw)


def designs(raw: Mapping[str, Any]) -> bool:
    """Whether a file asks for a design."""
    return not {"requirement", "requirements", "objective", "balance"}.isdisjoint(raw)


def random_cases(count: int) -> Iterator[Case]:
    """Random problems of all kinds."""
    sys.path.insert(0, str(ROOT))  # their generator is that of this checkout, whatever code is recorded
    from tests.oracles.judge import faults_of
    from tests.oracles.random_problems import random_problem

    for number in range(count):
        problem = random_problem(number)
        known = {"known": problem.known, "possible": problem.possible, "least": problem.least / problem.unit}
        yield Case(problem.name, problem.raw, known, partial(faults_of, problem))


# --- recording -------------------------------------------------------------------------------------------------------------


def timed(search: Callable[[], Any]) -> tuple[Any, float]:
    """The result of a search and its processor time [s]."""
    taken: list[float] = []
    while not taken or sum(taken) < SHORT:
        begin = time.process_time()
        result = search()
        taken.append(time.process_time() - begin)
    return result, min(taken)


def yardstick() -> float:
    """Processor time [s] of the crank-rocker without its proof."""
    import optlink

    return timed(partial(optlink.solve, optlink.load(YARDSTICK), certify=False))[1]


def entry(case: Case, backend: str, seed: int, starts: int | None, unit: float) -> dict[str, Any]:
    """What a search found, by the public interface, with its time in units [s]; an error in words if the program refused it."""
    import optlink

    found: dict[str, Any] = {"problem": case.name, "backend": backend, "seed": seed, **case.known}
    try:
        problem = case.load()
        result, seconds = timed(partial(optlink.solve, problem, backend, starts, seed, workers=1))
    except optlink.OptlinkError as error:
        return found | {"refused": str(error)}
    proof = getattr(result, "certificate", None)
    return found | {
        "hash": problem.hash,
        "kind": getattr(problem, "kind", ""),
        "status": str(getattr(result.status, "value", result.status)),
        "message": getattr(result, "message", ""),
        "valid": bool(result.valid),
        "design": {name: float(value) for name, value in dict(result.design).items()},
        "assembly": _assembly(result),
        "objective": float(result.objective),
        "objectives": [float(design.objective) for design in getattr(result, "designs", ())],
        "active": {
            limit.name: {name: getattr(limit, name) for name in LIMIT if hasattr(limit, name)}
            for limit in getattr(result, "limits", ())
            if getattr(limit, "active", True)
        },
        "conflict": [one.name for one in getattr(result, "conflict", ())],
        "failed": [check.name for check in result.validation.checks if not check.passed] if hasattr(result, "validation") else [],
        "faults": case.judge(result),
        "starts": int(getattr(result, "starts", 0)),
        "notes": list(getattr(result, "notes", ())),
        "ratio": seconds / unit,
        "certificate": None
        if proof is None
        else {"status": proof.status, "closed": proof.closed, "bound": proof.lower_bound, "boxes": proof.boxes},
    }


def _assembly(result: Any) -> Any:
    definite = getattr(result, "definite", None)
    return None if definite is None else definite.raw.get("mechanism", {}).get("assembly")


def record(out: Path, cases: Iterator[Case], seeds: list[int], backends: list[str], starts: int | None, seconds: float) -> None:
    """Solve what the record lacks, and write it after every search, until the processor time is used."""
    document: dict[str, Any] = {"schema": SCHEMA, "python": platform.python_version(), "starts": starts, "entries": []}
    if out.exists():
        document = json.loads(out.read_text(encoding="utf-8"))
    done = {key_of(one) for one in document["entries"]}
    unit, measured = math.nan, -math.inf
    for case in cases:
        choice = backends if "balance" not in (case.raw or case.load().raw) else backends[:1]
        todo = [(case.name, backend, seed) for seed in seeds for backend in choice if (case.name, backend, seed) not in done]
        if todo and time.process_time() > seconds:
            print(f"stopped after {seconds:g} s before {case.name}", file=sys.stderr)
            return
        for _, backend, seed in todo:
            if time.process_time() > measured + AGAIN:
                unit, measured = yardstick(), time.process_time()
            one = entry(case, backend, seed, starts, unit)
            document["entries"].append(one)
            out.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
            told = one.get("refused") or f"{one['status']}, valid {one['valid']}, {one['objective']:.9g}, {one['ratio']:.2f}"
            print(f"{case.name} | {backend} | {seed} | {told}", flush=True)


# --- comparison ------------------------------------------------------------------------------------------------------------


def key_of(one: Mapping[str, Any]) -> tuple[str, str, int]:
    return one["problem"], one["backend"], one["seed"]


def apart(one: float, other: float, size: float = 0.0) -> float:
    """Difference as a share of the larger of two numbers, or of a size; equal infinities and missing numbers are the same."""
    if one == other or (math.isnan(one) and math.isnan(other)):
        return 0.0
    difference = abs(one - other) / max(abs(one), abs(other), size)
    return difference if math.isfinite(difference) else math.inf


def _wording(value: Any) -> str:
    """A value without the figures in its text."""
    return re.sub(r"[-+]?\d+\.\d+(e[-+]?\d+)?", "...", str(value))


def whole_turns(difference: float) -> float:
    """The whole turns [rad] in a difference of two angles; no difference of two lengths [m] is that large."""
    return difference - math.remainder(difference, math.tau) if math.isfinite(difference) else 0.0


def differences(before: Mapping[str, Any], after: Mapping[str, Any], digits: float = DIGITS) -> list[str]:
    """What differs in two entries of the same search, in words."""
    if "refused" in before or "refused" in after:
        texts = [one.get("refused", "accepted") for one in (before, after)]
        return [] if texts[0] == texts[1] else [f"{texts[0]} -> {texts[1]}"]
    rows = [
        f"{name}: {before.get(name)} -> {after.get(name)}"
        for name in ("status", "valid", "failed", "conflict", "assembly", "faults")
        if _wording(before.get(name, [])) != _wording(after.get(name, []))
    ]
    rows += _worse(before, after, digits) + _other_design(before, after, digits) + _other_prices(before, after)
    return rows + _other_proof(before["certificate"], after["certificate"])


def _worse(before: Mapping[str, Any], after: Mapping[str, Any], digits: float) -> list[str]:
    if _equal(before, after, digits):
        return []
    one, other = before["objective"], after["objective"]
    return [
        f"objective {'worse' if other > one or math.isnan(other) else 'better'}: {one!r} -> {other!r} ({apart(one, other):.1e})"
    ]


def _equal(before: Mapping[str, Any], after: Mapping[str, Any], digits: float) -> bool:
    one, other = before["objective"], after["objective"]
    return max(abs(one), abs(other)) <= after.get("least", ROUNDING) or apart(one, other) <= digits


def _other_design(before: Mapping[str, Any], after: Mapping[str, Any], digits: float) -> list[str]:
    one, other = before["design"], after["design"]
    if one.keys() != other.keys():
        return [f"quantities: {sorted(one)} -> {sorted(other)}"]
    size = max(map(abs, one.values()), default=0.0)
    moved = {name: apart(one[name], other[name] + whole_turns(one[name] - other[name]), size) for name in one}
    name = max(moved, key=lambda each: moved[each], default="")
    if not name or moved[name] <= digits:
        return []
    note = ", as good" if _equal(before, after, digits) else ""
    return [f"design: {name} {one[name]!r} -> {other[name]!r} ({moved[name]:.1e}{note})"]


def _other_prices(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    one, other = before["active"], after["active"]
    if one.keys() != other.keys():
        return [f"active limits: {sorted(one)} -> {sorted(other)}"]
    prices = {name: tuple(limit[name].get("multiplier", limit[name].get("price")) for limit in (one, other)) for name in one}
    return [f"price of {name}: {a!r} -> {b!r}" for name, (a, b) in prices.items() if apart(a, b) > PRICES]


def _other_proof(one: Mapping[str, Any] | None, other: Mapping[str, Any] | None) -> list[str]:
    if one is None or other is None:
        return [] if one is other else [f"certificate: {one} -> {other}"]
    rows = [f"certificate: {one['status']} -> {other['status']}"] if one["status"] != other["status"] else []
    if other["boxes"] > MORE_BOXES * one["boxes"]:
        rows.append(f"boxes: {one['boxes']} -> {other['boxes']}")
    return rows


def slower(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """That a search takes longer than before, in words; single times on a busy machine differ by more than this."""
    one, other = before.get("ratio", math.nan), after.get("ratio", math.nan)
    return [f"slower: {one:.3g} -> {other:.3g} crank-rockers"] if other > SLOWER * one and other - one > QUICK else []


def compare(before: Path, after: Path, digits: float) -> int:
    """Print the differences of two records; the number of searches that differ in what was not meant to change, but for times."""
    one, other = (
        {key_of(each): each for each in json.loads(file.read_text(encoding="utf-8"))["entries"]} for file in (before, after)
    )
    missing, count, late = [key for key in one if key not in other], 0, 0
    for key in (key for key in one if key in other):
        rows = differences(one[key], other[key], digits)
        share, reason = MEANT.get(key[0], (digits, ""))
        meant = bool(rows) and bool(reason) and not differences(one[key], other[key], max(share, digits))
        times = slower(one[key], other[key])
        count, late = count + (bool(rows) and not meant), late + bool(times)
        for row in (*(f"{row} [meant: {reason}]" if meant else row for row in rows), *times):
            print(" | ".join(map(str, key)), "|", row)
    print(
        f"{count} of {len(one) - len(missing)} searches differ by more than {digits:g}, {late} take over {SLOWER:g} times as long"
    )
    renamed = {key[0] for key in one if key in other and one[key].get("hash") != other[key].get("hash")}
    if renamed:
        print(f"{len(renamed)} problems have another hash, such as {min(renamed)}")
    if missing:
        print(f"{len(missing)} searches are missing:", ", ".join(sorted({key[0] for key in missing})))
    return count + len(missing)


def main() -> int:
    """Record, or compare two records."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, nargs="?", metavar="OUT.json")
    parser.add_argument("--code", type=Path, default=ROOT, help="checkout whose optlink is recorded (default: this one)")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--backends", nargs="+", default=list(BACKENDS), choices=BACKENDS)
    parser.add_argument("--only", metavar="NAME", nargs="+", help="these problems")
    parser.add_argument("--random", type=int, metavar="COUNT", help="random problems instead of the shipped ones")
    parser.add_argument("--starts", type=int, help="starting points of every search (default: chosen by the program)")
    parser.add_argument("--seconds", type=float, default=math.inf, help="processor time after which no search begins")
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("BEFORE.json", "AFTER.json"))
    parser.add_argument(
        "--tolerance", type=float, default=DIGITS, help="relative difference of a design or an objective that counts"
    )
    chosen = parser.parse_args()
    if chosen.compare:
        return 1 if compare(*chosen.compare, chosen.tolerance) else 0
    if chosen.out is None:
        parser.error("give OUT.json, or --compare")
    sys.path.insert(0, str(chosen.code.resolve()))
    cases = random_cases(chosen.random) if chosen.random else shipped()
    wanted = (case for case in cases if not chosen.only or case.name in chosen.only)
    record(chosen.out, wanted, chosen.seeds, chosen.backends, chosen.starts, chosen.seconds)
    return 0


if __name__ == "__main__":
    sys.exit(main())
