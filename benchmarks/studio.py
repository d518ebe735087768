"""Measure the server of `optlink studio`: latency of recorded drags, random drags, saved problems, malformed messages.

python benchmarks/studio.py latency            the drags of studio_drags.json through the socket
python benchmarks/studio.py random [COUNT] [PROBLEM ...]  random drags over ten shipped problems: verdicts, exceptions, memory
python benchmarks/studio.py saved [COUNT]      drag, save, solve the saved file by the command line: the same design
python benchmarks/studio.py curves             drawn curves: time until the first valid four-bar and the end of the search
python benchmarks/studio.py abuse [COUNT]      malformed messages and a hostile file: the server stays alive
python benchmarks/studio.py record             write studio_drags.json again
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import re
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
DRAGS = HERE / "studio_drags.json"
SECONDS = 300.0
LIMITS = {"crank-rocker": (15.0, 33.0), "path-closed18": (None, 100.0), "shaper-design": (None, 250.0)}
"""Largest median and 95th percentile [ms] from the mouse to the drawn linkage; the server has to need less."""
PROBLEMS = (
    *("crank-rocker", "path-closed18", "shaper-design", "motion-3-poses", "stroke-crank-rocker"),
    *("law-slider-crank", "path-vline6", "transmission-optimal", "shaper", "function-sin"),
)
RELEASED, SEARCHED = 0.05, 0.03  # chance that a drag is a release, and that its full search is not interrupted
FIRST, BEST = 1.0, 5.0  # s from a drawn curve to the first valid four-bar, and to the end of the search
SAME = 1e-9  # largest relative difference of two designs


# --- the socket -------------------------------------------------------------------------------------------------------


@contextlib.asynccontextmanager
async def studio(*arguments: str) -> AsyncIterator[tuple[str, str, asyncio.subprocess.Process]]:
    """The command in a process of its own, with its address and token."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "optlink", "studio", *arguments, "--no-browser"), stdout=asyncio.subprocess.PIPE
    )
    assert process.stdout is not None
    try:
        address, _, token = (await process.stdout.readline()).decode().split()[-1].partition("/?token=")
        yield address, token, process
    finally:
        if process.returncode is None:
            process.send_signal(signal.SIGINT)
        await asyncio.wait_for(process.wait(), SECONDS)


def connect(address: str, token: str, origin: str | None = None) -> Any:
    import websockets

    live = address.replace("http://", "ws://") + f"/live?token={token}"
    return websockets.connect(live, origin=origin or address, max_size=None)


async def until(ws: Any, kind: str, **fields: Any) -> dict[str, Any]:
    while True:
        message = json.loads(await asyncio.wait_for(ws.recv(), SECONDS))
        if message["type"] == "fault" and kind != "fault":
            raise RuntimeError(message["message"])
        if message["type"] == kind and all(message.get(name) == value for name, value in fields.items()):
            return message


# --- recorded drags ---------------------------------------------------------------------------------------------------


def hand(begin: list[float], end: list[float], count: int, rng: np.random.Generator) -> list[list[float]]:
    """A hand's way from one place to another and part of the way back: smooth, with a tremor."""
    t = np.linspace(0.0, 1.0, count)
    share = np.sin(0.75 * np.pi * (10.0 * t**3 - 15.0 * t**4 + 6.0 * t**5))
    way = np.array(begin) + share[:, None] * (np.array(end) - np.array(begin))
    tremor = 0.002 * np.max(np.abs(np.array(end) - np.array(begin))) * rng.standard_normal(way.shape)
    return np.round(way + tremor, 6).tolist()


def record() -> None:
    """Write a thousand events for each problem: begin and end of each drag as a user would choose them."""
    rng, made = np.random.default_rng(18), []
    crank = [
        ("mechanism.frame", [500.0], [470.0]),
        ("mechanism.frame", [500.0], [560.0]),
        ("mechanism.crank", [100.0], [118.0]),
        ("mechanism.crank", [100.0], [85.0]),
        ("limits.transmission_angle.min", [45.0], [52.0]),
        ("limits.transmission_angle.max", [135.0], [126.0]),
        ("mechanism.rocker.bounds", [100.0, 900.0], [240.0, 900.0]),
        ("mechanism.coupler.bounds", [100.0, 900.0], [100.0, 400.0]),
        ("requirement.span", [90.0], [100.0]),
        ("requirement.span", [90.0], [82.0]),
    ]
    path = [(f"requirement.points.{k}", None, None) for k in (0, 3, 5, 8, 9, 11, 12, 14, 16, 17)]
    shaper = [
        ("limits.stroke.exactly", [500.0], [520.0]),
        ("limits.stroke.exactly", [500.0], [490.0]),
        ("limits.time_ratio.exactly", [1.8], [1.85]),
        ("limits.time_ratio.exactly", [1.8], [1.7]),
        ("limits.guide.max", [1500.0], [1650.0]),
        ("limits.guide.max", [1500.0], [1420.0]),
        ("mechanism.guides.F.direction", [0.0], [1.5]),
        ("mechanism.links.rocker.length.bounds", [400.0, 700.0], [400.0, 560.0]),
        ("mechanism.ground.A.x", [0.0, 0.0], [4.0, 3.0]),
        ("mechanism.guides.F.through.x", [0.0], [5.0]),
    ]
    from optlink import load

    places = [[1e3 * x for x in place] for place in load("path-closed18").spec.target_points.points]
    for name, drags in (("crank-rocker", crank), ("path-closed18", path), ("shaper-design", shaper)):
        for handle, begin, end in drags:
            if begin is None or end is None:
                begin = places[int(handle.rpartition(".")[2])]
                end = (np.array(begin) + rng.uniform(-0.08, 0.08, 2)).tolist()
            made.append({"problem": name, "handle": handle, "places": hand(begin, end, 100, rng)})
    DRAGS.write_text(json.dumps(made, separators=(",", ":")).replace("},{", "},\n{") + "\n", encoding="utf-8")
    print(f"{DRAGS.name}: {sum(len(one['places']) for one in made)} events")


def drag(ident: int, handle: str, kind: str, place: list[float], *, moving: bool) -> dict[str, Any]:
    """The message of a drag to a place."""
    where = {"at": place} if kind == "point" else {"value": place if kind == "range" else place[0]}
    return {"type": "drag", "id": ident, "handle": handle, "moving": moving, **where}


async def _latency() -> bool:
    good, recorded = True, json.loads(DRAGS.read_text(encoding="utf-8"))
    for name, (median, late) in LIMITS.items():
        async with studio(name) as (address, token, _), connect(address, token) as ws:
            state = await until(ws, "state", status="verified")
            kinds = {handle["id"]: handle["kind"] for handle in state["handles"]}
            await asyncio.sleep(5.0)  # the programme of the first drag is prepared
            taken, solving, ident, statuses = [], [], 0, set()
            for one in (one for one in recorded if one["problem"] == name):
                for place in one["places"]:
                    ident += 1
                    begin = time.perf_counter()
                    await ws.send(json.dumps(drag(ident, one["handle"], kinds[one["handle"]], place, moving=True)))
                    state = await until(ws, "state", id=ident)
                    taken.append(1e3 * (time.perf_counter() - begin))
                    solving.append(1e3 * state["seconds"]["solve"])
                    statuses.add(state["status"])
        p50, p95 = np.percentile(taken, [50, 95])
        s50, s95 = np.percentile(solving, [50, 95])
        within = p95 <= late and (median is None or p50 <= median)
        good &= bool(within)
        print(f"{name}: {len(taken)} events, answered p50 {p50:.1f} ms, p95 {p95:.1f} ms (largest {max(taken):.0f}), "
              f"of it solving p50 {s50:.1f}, p95 {s95:.1f}; {sorted(statuses)}")  # fmt: skip
    return good


def curves(seed: int = 0) -> dict[str, tuple[list[list[float]], bool]]:
    """Curves as a hand draws them [mm], with a tremor, and whether they are closed."""
    rng, turn = np.random.default_rng(seed), np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    part = np.linspace(0.3, 2.4, 60)
    shapes = {
        "oval": ([100.0 * np.cos(turn) + 15.0 * np.cos(2.0 * turn), 60.0 * np.sin(turn)], True),
        "bean": ([90.0 * np.cos(turn), 50.0 * np.sin(turn) + 25.0 * np.cos(turn) ** 2], True),
        "eight": ([100.0 * np.sin(turn), 40.0 * np.sin(2.0 * turn)], True),
        "foot": ([120.0 * np.cos(turn), np.maximum(60.0 * np.sin(turn), 0.0)], True),
        "arc": ([150.0 * np.cos(part), 150.0 * np.sin(part)], False),
        "hook": ([100.0 * part, 30.0 * np.sin(2.0 * part) + 10.0 * part], False),
    }
    return {name: ((np.column_stack(at) + rng.normal(0.0, 0.4, (len(at[0]), 2))).tolist(), c) for name, (at, c) in shapes.items()}


async def _curves() -> bool:
    good = True
    async with studio("crank-rocker") as (address, token, _), connect(address, token) as ws:
        await until(ws, "state", status="verified")
        await asyncio.sleep(5.0)  # idle, as while a hand draws
        for ident, (name, (points, closed)) in enumerate(curves().items(), 1):
            begin, first = time.perf_counter(), math.nan
            await ws.send(json.dumps({"type": "draw", "id": ident, "points": points, "closed": closed}))
            while not (found := await until(ws, "candidates", id=ident))["done"]:
                if math.isnan(first) and any(one["valid"] for one in found["items"]):
                    first = time.perf_counter() - begin
            taken, best = time.perf_counter() - begin, found["items"][0]
            first = taken if math.isnan(first) else first
            good &= bool(best["valid"]) and first <= FIRST and taken <= BEST
            print(f"{name}: first valid four-bar after {first:.2f} s, search ended after {taken:.2f} s; "
                  f"valid: {best['valid']}, error {best['error']:.3g} {best['unit']}")  # fmt: skip
    return good


# --- random drags -----------------------------------------------------------------------------------------------------


def anywhere(handle: Mapping[str, Any], rng: np.random.Generator) -> list[float]:
    """A random place of a handle, mostly near its present one, sometimes absurd."""
    wild = rng.random() < 0.02
    if handle["kind"] == "point":
        spread = 1e6 if wild else float(rng.choice([0.01, 0.1, 1.0])) * (1.0 + math.hypot(*handle["at"]))
        return (np.array(handle["at"]) + spread * rng.standard_normal(2)).tolist()
    values = handle["value"] if handle["kind"] == "range" else [handle["value"]]
    spread = float(rng.choice([0.01, 0.05, 0.3])) if not wild else 10.0
    return [value + spread * (1.0 + abs(value)) * rng.standard_normal() for value in values]


class RandomDrags:
    """Drags of random handles of a problem to random places; every design that is shown as verified is judged once more.

    Parameters
    ----------
    name : str
        Shipped problem.
    seed : int
    """

    def __init__(self, name: str, seed: int) -> None:
        from optlink.studio.session import Session

        self.name, self.rng = name, np.random.default_rng([seed, sum(map(ord, name))])
        self.sent: list[Mapping[str, Any]] = []
        self.tally: Counter[str] = Counter()
        self.faults: Counter[str] = Counter()
        self.wrong: list[Any] = []
        self._free = True  # to finish a search
        self.session = Session(self.sent.append, self._interruptible)
        self.session.handle({"type": "open", "id": 0, "name": name})

    def _interruptible(self, work: Callable[[], Any]) -> Any:
        if not self._free:
            raise KeyboardInterrupt  # the next drag has begun
        return work()

    def drag(self, k: int) -> None:
        """One drag, moving or released; half of the releases are undone."""
        rng, session = self.rng, self.session
        handles = [one.document() for one in session._handles.values()]
        handle = handles[int(rng.integers(len(handles)))]
        moving = rng.random() >= RELEASED
        self._free = rng.random() < SEARCHED
        del self.sent[:]
        session.handle(drag(k, handle["id"], handle["kind"], anywhere(handle, rng), moving=moving))
        if not any(message["type"] in ("state", "fault", "progress") for message in self.sent):
            self.wrong.append((self.name, k, "no answer"))
        if not moving and rng.random() < 0.5:
            self._free = False
            session.handle({"type": "undo", "id": k})
        self._judge(k)

    def _judge(self, k: int) -> None:
        from optlink import validate
        from optlink.tasks.analyze import Analysis

        for message in self.sent:
            json.dumps(message, allow_nan=False)
            if message["type"] == "state":
                self.tally[message["status"]] += 1
                if message["moving"] and message["status"] == "verified":
                    self.wrong.append((self.name, k, "shown as verified while moving"))
            elif message["type"] == "fault":
                self.faults[re.sub(r"-?[0-9][0-9.e+-]*", "N", message["message"])] += 1
        last = self.session._last
        if last is None or last[0].status != "verified" or isinstance(last[0].result, Analysis):
            return
        self.tally["judged"] += 1
        design = last[0]
        again = validate(self.session._document.problem, {n: design.values[n] for n in design.problem.model.free})
        if not again.valid:
            self.wrong.append((self.name, k, [c.name for c in again.validation.checks if not c.passed]))


def random_drags(names: tuple[str, ...], count: int, seed: int = 0, watch: Callable[[str], None] = print) -> list[RandomDrags]:
    """Drag in turn in all problems, `count` times in each."""
    pages = [RandomDrags(name, seed) for name in names]
    steps = sorted({count // 10, count // 2, count})
    for k in range(1, count + 1):
        for page in pages:
            page.drag(k)
        if k in steps:
            watch(f"{k * len(pages)} drags: {memory():.0f} MB")
    for page in pages:
        watch(f"{page.name}: {dict(page.tally)}")
        for words, times in page.faults.items():
            watch(f"  {times} faults: {words}")
    return pages


def memory() -> float:
    """Resident memory of this process [MB]."""
    import psutil

    return float(psutil.Process().memory_info().rss / 2**20)


# --- saved problems ---------------------------------------------------------------------------------------------------


def saved_problems(names: tuple[str, ...], count: int, seed: int = 1, watch: Callable[[str], None] = print) -> list[str]:
    """Drag, release and save; solve the saved file by the command line; return what differs."""
    import subprocess

    from optlink import load
    from optlink.studio.session import Session

    rng, wrong, done, tried = np.random.default_rng(seed), [], 0, 0
    sent: list[Mapping[str, Any]] = []
    sessions = {name: Session(sent.append) for name in names}
    for name, session in sessions.items():
        session.handle({"type": "open", "id": 0, "name": name})
    while done < count and tried < 20 * count:
        tried += 1
        name = names[done % len(names)]
        session = sessions[name]
        handles = [one.document() for one in session._handles.values()]
        handle = handles[int(rng.integers(len(handles)))]
        place = np.array(handle["at"] if handle["kind"] == "point" else np.ravel([handle["value"]]), dtype=float)
        place = place + 0.03 * (np.abs(place) + 0.05) * rng.standard_normal(place.shape)
        del sent[:]
        for k in range(3):
            session.handle(drag(k, handle["id"], handle["kind"], place.tolist(), moving=k < 2))
        last = session._last
        if any(one["type"] == "fault" for one in sent) or last is None or last[0].status != "verified":
            session.handle({"type": "open", "id": 0, "name": name})
            continue
        session.handle({"type": "save", "id": 9})
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / sent[-1]["name"]
            path.write_text(sent[-1]["text"], encoding="utf-8")
            changed = load(str(path)).raw != load(name).raw
            run = subprocess.run(
                [sys.executable, "-m", "optlink", "solve", str(path), "--json"], capture_output=True, text=True, check=False
            )
            document = json.loads(run.stdout)
        gap = difference(last[0], document) if changed else math.inf
        done += 1
        if run.returncode or gap > SAME:
            wrong.append(f"{name}, {handle['id']}: exit code {run.returncode}, designs differ by {gap:.2g}")
            watch(wrong[-1])
    watch(f"{done} saved problems, {done - len(wrong)} with the same design to {SAME:g}")
    return wrong if done == count else [*wrong, f"only {done} of {count} problems could be saved"]


def difference(design: Any, document: Mapping[str, Any]) -> float:
    """Largest relative difference of a shown design and that of a result file."""
    gaps = [math.inf]
    for key, value in (document.get("design") or document.get("design_SI") or {}).items():
        name, _, unit = key.rpartition("_")
        shown = design.values[name] * {"mm": 1e3, "deg": math.degrees(1.0)}[unit]
        gaps.append(abs(shown - value) / max(abs(value), 1.0))
    return max(gaps[1:], default=math.inf)


# --- abuse ------------------------------------------------------------------------------------------------------------

MALFORMED = (
    *("", "{", "null", "[]", "1", '"drag"', "{}", '{"type":"drag"}', '{"id":1}', '{"type":1,"id":1}', '{"type":"drag","id":-1}'),
    *('{"type":"drag","id":1.5}', '{"type":"drag","id":true}', '{"type":"__import__","id":1}', '{"id":NaN,"type":"save"}'),
    *("[" * 2000, '{"type":"resume","id":1,"name":"x","text":"","folder":"/"}', "\x00\ufffe", '{"type":"stop"}'),
)
"""Messages that are no requests."""
UNUSABLE = (
    {"type": "drag", "handle": "mechanism.frame", "value": "500", "moving": True},
    {"type": "drag", "handle": "../../etc", "value": 1.0},
    {"type": "drag", "handle": "mechanism.frame", "value": 1e308},
    {"type": "drag", "handle": "mechanism.frame", "moving": True},
    {"type": "set", "key": "title", "value": "__import__('os').system('true')"},
    {"type": "set", "key": "__class__.x", "value": "1"},
    {"type": "lock", "size": ["a"], "locked": True},
    {"type": "open", "text": 'title = "x"\n' * 3},
    {"type": "open", "text": "a" * 900_000},
    {"type": "open", "fragment": "!!!!"},
    {"type": "open", "name": "/etc/passwd"},
    {"type": "new", "template": "../crank-rocker"},
    {"type": "draw", "points": [[0, 0], [1, "x"], [2, 2]]},
    {"type": "choose", "candidate": 10**9},
    {"type": "export", "format": "exe"},
)
"""Requests that cannot be answered with anything but a fault (or, of a text, a state)."""


@contextlib.asynccontextmanager
async def reading(ws: Any) -> AsyncIterator[None]:
    """Read the answers, so that the end of the socket is noticed."""

    async def read() -> None:
        async for _ in ws:
            pass

    task = asyncio.create_task(read())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def _abuse(count: int) -> None:
    """Send malformed messages over as many sockets as it takes; then the server must still answer a drag."""
    import websockets

    sent = closed = 0
    async with studio("crank-rocker") as (address, token, process):
        async with connect(address, token) as good:
            await until(good, "state", status="verified")
            while sent < count:
                try:
                    async with connect(address, token) as ws, reading(ws):
                        while sent < count:
                            await ws.send(MALFORMED[sent % len(MALFORMED)])
                            sent += 1
                            if sent % 100 == 0:
                                await asyncio.sleep(0.001)
                except websockets.ConnectionClosed:
                    closed += 1
            async with connect(address, token) as ws:
                for ident, request in enumerate(UNUSABLE):
                    await ws.send(json.dumps(request | {"id": 100 + ident}))
                    while True:
                        answer = json.loads(await asyncio.wait_for(ws.recv(), SECONDS))
                        if answer.get("id") == 100 + ident and answer["type"] in ("fault", "state"):
                            break
                    print(f"  {str(request)[:60]}: {answer['type']} {str(answer.get('message', ''))[:100]}")
            await good.send(json.dumps(drag(5, "mechanism.frame", "scalar", [490.0], moving=True)))
            state = await until(good, "state", id=5)
        assert process.returncode is None
        print(f"{sent} malformed messages, {closed} sockets closed; alive: {state['status']}")


def main() -> int:
    command, *rest = sys.argv[1:] or ["latency"]
    count = int(rest[0]) if rest else 0
    if command == "record":
        record()
    elif command == "latency":
        return 0 if asyncio.run(_latency()) else 1
    elif command == "curves":
        return 0 if asyncio.run(_curves()) else 1
    elif command == "random":
        names = tuple(rest[1:]) or PROBLEMS
        each = -(-(count or 10_000) // len(names))
        begin, pages = time.perf_counter(), random_drags(names, each)
        wrong = [one for page in pages for one in page.wrong]
        judged, faults = (sum(found) for found in zip(*((p.tally["judged"], p.faults.total()) for p in pages), strict=True))
        print(f"{each * len(names)} drags in {time.perf_counter() - begin:.0f} s; {judged} times verified, wrongly: {wrong}; "
              f"{faults} faults")  # fmt: skip
        return 1 if wrong else 0
    elif command == "saved":
        names = ("crank-rocker", "law-slider-crank", "stroke-crank-rocker", "motion-3-poses", "transmission-optimal")
        return 1 if saved_problems(names, count or 100) else 0
    elif command == "abuse":
        asyncio.run(_abuse(count or 100_000))
    else:
        print(__doc__)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
