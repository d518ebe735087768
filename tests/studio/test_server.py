"""The socket of the studio: what it answers, and what it refuses."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import stat
import sys
import time
import urllib.error
import urllib.request
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import psutil
import pytest
import websockets

from optlink.studio.document import named
from optlink.studio.link import MAX_REFUSED, Link, Requests, Worker, parsed
from optlink.studio.server import FULL, MAX_PAGES, REMEMBERED_PAGES, Studio

SECONDS = 300.0  # on a machine that is busy otherwise; most waits end within one


@contextlib.asynccontextmanager
async def studio(*arguments: str) -> AsyncIterator[tuple[str, str, asyncio.subprocess.Process]]:
    """The command in a process of its own, with its address and token."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "optlink", "studio", *arguments, "--no-browser",
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout is not None
    try:
        line = await asyncio.wait_for(process.stdout.readline(), SECONDS)
        address, _, token = line.decode().split()[-1].partition("/?token=")
        yield address, token, process
    finally:
        if process.returncode is None:
            process.send_signal(signal.SIGINT)
        await asyncio.wait_for(process.wait(), SECONDS)


def socket(address: str, token: str, origin: str | None = None, **more: Any) -> Any:
    live = address.replace("http://", "ws://") + f"/live?token={token}"
    return websockets.connect(live, origin=origin or address, max_size=None, **more)


async def until(ws: Any, kind: str, **fields: Any) -> dict[str, Any]:
    while True:
        message = json.loads(await asyncio.wait_for(ws.recv(), SECONDS))
        if message["type"] == kind and all(message.get(name) == value for name, value in fields.items()):
            return message


def status(address: str, **headers: str) -> int:
    try:
        return int(urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=10).status)
    except urllib.error.HTTPError as error:
        return error.code


async def _session() -> None:
    async with studio("crank-rocker") as (address, token, process):
        assert address.startswith("http://127.0.0.1:")
        assert status(f"{address}/?token={token}", Host="evil.example") == 403
        assert status(f"{address}/assets/../server.py?token={token}") == 404
        for origin, secret in (("http://evil.example", token), (address, "wrong"), (address, "")):
            with pytest.raises(websockets.InvalidStatus):
                async with socket(address, secret, origin, additional_headers={"Cookie": f"optlink-studio={token}"}):
                    pass
        async with socket(address, token) as ws:
            hello = await until(ws, "hello")
            assert hello["opened"] == "crank-rocker"
            assert {"name", "title", "kind"} <= set(hello["problems"][0])
            await until(ws, "state", status="verified")
            for text in ("[]", "{", '{"type":"drag"}', '{"type":"resume","id":1}', '{"id":NaN,"type":"save"}', "[" * 9000):
                await ws.send(text)
                assert "not a request" in (await until(ws, "fault"))["message"]
            # of many moves the newest is computed, and the answers keep their order
            moved = {"type": "drag", "handle": "mechanism.frame", "moving": True}
            for k in range(40):
                await ws.send(json.dumps(moved | {"id": 10 + k, "value": 480.0 + k}))
            shown = []
            while not shown or shown[-1]["id"] < 49:
                shown.append(await until(ws, "state"))
            assert [one["id"] for one in shown] == sorted({one["id"] for one in shown})
            assert len(shown) < 40
            assert shown[-1]["status"] == "not verified"
            assert shown[-1]["checks"] is None
            await ws.send(json.dumps(moved | {"id": 60, "value": 490.0, "moving": False}))
            state = await until(ws, "state", id=60)
            assert state["status"] == "verified"
            assert all(check["ok"] for check in state["checks"])
            await ws.send(json.dumps({"type": "save", "id": 61}))
            text = (await until(ws, "file"))["text"]
            assert 'frame = "490.0 mm"' in text
            assert text.startswith("format = 1\ntitle =")
        process.send_signal(signal.SIGINT)
        await asyncio.wait_for(process.wait(), 2.0)
        assert process.returncode == 0
        assert process.stderr is not None
        assert b"Traceback" not in await process.stderr.read()


@pytest.mark.slow
def test_a_page_drags_and_saves_and_other_clients_are_refused() -> None:
    asyncio.run(_session())


async def _answer(studio: Studio, kind: str = "http", path: str = "/", query: str = "", **headers: str) -> dict[str, Any]:
    """The first message with which the application answers a request."""
    sent: list[dict[str, Any]] = []
    named = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    scope = {"type": kind, "path": path, "raw_path": path.encode(), "query_string": query.encode(), "headers": named}

    async def receive() -> dict[str, Any]:
        await asyncio.sleep(0.0 if kind == "websocket" else 3600.0)
        return {"type": "websocket.connect"}

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    await studio.app({**scope, "method": "GET", "root_path": "", "scheme": "http"}, receive, send)
    return sent[0]


def test_only_the_page_of_this_server_is_answered() -> None:
    studio = Studio(4711)
    own, token = "127.0.0.1:4711", f"token={studio.token}"

    def http(query: str = token, **headers: str) -> dict[str, Any]:
        return asyncio.run(_answer(studio, query=query, **{"host": own, **headers}))

    answer = http()
    assert answer["status"] == 200
    headers = {name.decode(): value.decode() for name, value in answer["headers"]}
    assert "default-src 'self'" in headers["content-security-policy"]
    assert "set-cookie" not in headers
    assert studio.token not in str(answer)
    assert http(host="evil.example")["status"] == 403
    assert http(host="localhost:4711")["status"] == 200
    assert http(origin="http://evil.example")["status"] == 403
    for path in ("/assets/../server.py", "/assets/%2e%2e/server.py", "/assets//etc/passwd", "/assets/"):
        assert asyncio.run(_answer(studio, path=path, query=token, host=own))["status"] == 404

    def live(query: str = token, **headers: str) -> dict[str, Any]:
        return asyncio.run(_answer(studio, "websocket", "/live", query, **{"host": own, **headers}))

    def with_cookie(name: str) -> dict[str, Any]:
        return live("", origin=f"http://{own}", cookie=f"{name}={studio.token}")

    for refused in (
        *(live(), live(origin="http://evil.example"), live("", origin=f"http://{own}"), live(origin="null")),
        *(live(f"{token}x", origin=f"http://{own}"), with_cookie("token"), with_cookie("optlink-studio-4711")),
    ):
        assert refused == {"type": "websocket.close", "code": 1008}


def test_the_browser_gets_a_private_file_instead_of_the_token(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every user of the machine can read the arguments of the browser in the list of processes."""
    from optlink.cli.studio import studio as command

    url, opened = "http://127.0.0.1:4711/?token=secret", list[str]()

    def serve(problem: str | None, port: int, ready: Callable[[str], None]) -> None:
        ready(url)
        end = time.monotonic() + 10.0
        while not opened:
            assert time.monotonic() < end
            time.sleep(0.01)
        assert "secret" not in opened[0]
        file = Path(urllib.request.url2pathname(opened[0].removeprefix("file://")))
        assert url in file.read_text(encoding="utf-8")
        assert os.name != "posix" or stat.S_IMODE(file.stat().st_mode) == 0o600

    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr("optlink.studio.server.serve", serve)
    monkeypatch.setattr("webbrowser.open", opened.append)
    for folder in (tmp_path, tmp_path / "missing"):
        monkeypatch.setenv("HOME", str(folder))
        opened.clear()
        command()
        assert not Path(urllib.request.url2pathname(opened[0].removeprefix("file://"))).exists()


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "1", '{"type":"drag"}', '{"type":"drag","id":1.5}', '{"type":"drag","id":-1}', '{"type":["drag"],"id":1}',
     '{"type":"start","id":1,"name":"/etc/passwd"}', '{"type":"resume","id":1}', '{"type":"save","id":NaN}', "[" * 5000,
     '{"type":"save","id":true}', '{"type":"save","id":1,"more":"' + "a" * 1_000_000 + '"}'],
)  # fmt: skip
def test_malformed_requests_are_refused(text: str) -> None:
    assert parsed(text) is None
    assert parsed('{"type":"save","id":1}') == {"type": "save", "id": 1}


def test_a_page_that_sends_too_much_is_refused_and_closed() -> None:
    requests = Requests()
    taken = [requests.take('{"type":"save","id":7}') for _ in range(500)]
    assert sum(request is not None for request, _ in taken) in range(400, 450)
    request, answer = taken[-1]
    assert request is None
    assert answer is not None
    assert json.loads(answer)["id"] == 7
    assert requests.take('{"type":"drag","id":8,"moving":true}')[0] is not None
    assert not requests.closed
    answers = [requests.take(b"{}")[1] for _ in range(MAX_REFUSED)]
    assert requests.closed
    assert sum(answer is not None for answer in answers) < 50


def test_a_newer_move_replaces_one_that_waits_and_stops_a_search() -> None:
    class Silent:
        ready = True

        def __init__(self) -> None:
            self.sent: list[Any] = []

        def send(self, message: Any) -> None:
            self.sent.append(message)

        async def receive(self) -> bytes:
            await asyncio.sleep(60.0)
            return b""

        def kill(self) -> None:
            self.sent.append("killed")

    async def run() -> None:
        worker = Silent()
        link = Link(worker, lambda text: asyncio.sleep(0.0))  # type: ignore[arg-type]
        link.request({"type": "drag", "id": 1, "moving": True})
        for ident in range(2, 9):
            link.request({"type": "drag", "id": ident, "moving": True})
        assert [one["id"] for one in worker.sent] == [1]
        link._next()  # the first one is done
        assert [one["id"] for one in worker.sent] == [1, 8]
        link.request({"type": "search", "id": 9})
        link._next()
        link.request({"type": "save", "id": 10})
        assert worker.sent[-1] == {"type": "search", "id": 9}  # saving waits for it
        link.request({"type": "drag", "id": 11, "moving": True})
        assert worker.sent[-1] == {"type": "stop", "id": 9}
        link._reader.cancel()
        link._cancel()

    asyncio.run(run())


class Scripted:
    """A process that ends after some messages."""

    def __init__(self, *messages: dict[str, Any], ready: bool = True) -> None:
        self.messages = [json.dumps(message, separators=(",", ":")).encode() for message in messages]
        self.ready, self.sent, self.over = ready, list[Any](), asyncio.Event()

    def send(self, message: Any) -> None:
        self.sent.append(message)
        self.over.set()

    async def receive(self) -> bytes:
        if self.messages:
            return self.messages.pop(0)
        await self.over.wait()  # ends when it has something to compute
        raise ConnectionError

    async def ended(self) -> None:
        pass

    def kill(self) -> None:
        pass


async def sent_to_the_page(first: Scripted, another: Callable[[], Any]) -> list[dict[str, Any]]:
    """The messages of a link to a first process that has one request, and ends; `another` starts the next ones."""
    sent = list[dict[str, Any]]()

    async def send(text: str) -> None:
        sent.append(json.loads(text))

    link = Link(first, send, another)  # type: ignore[arg-type]
    link.request({"type": "set", "id": 7})
    for _ in range(50):
        await asyncio.sleep(0)
    link._reader.cancel()
    link._cancel()
    return sent


def test_the_history_outlives_the_process_that_computes() -> None:
    """A first failure opens the document that was being computed again, a second one the step before it, with redo."""

    async def run() -> tuple[list[Any], list[dict[str, Any]]]:
        steps = [{"name": "a", "text": text} for text in ("one", "two", "three", "four")]
        first = Scripted(
            {"type": "kept", "step": "open", "steps": steps[:1], "at": 0, "origin": "one"},
            *({"type": "kept", "step": "add", "document": step} for step in steps[1:]),
            {"type": "kept", "step": "move", "way": -1},
        )
        following = [Scripted() for _ in range(4)]
        made = iter(following)

        async def another() -> Any:
            return next(made)

        sent = await sent_to_the_page(first, another)
        return [process.sent for process in following], sent

    resumed, sent = asyncio.run(run())
    assert [[(one["type"], one["id"], one["at"], len(one["steps"])) for one in process] for process in resumed] == [
        [("resume", 7, 2, 4)], [("resume", 7, 1, 4)], [("resume", 7, 0, 4)], []
    ]  # fmt: skip
    assert [one["message"].partition(". ")[2].split()[0] for one in sent] == ["Your", "The", "The", "Open"]


def test_the_studio_forgets_the_oldest_pages() -> None:
    """Every reload of a page is a new one: their histories must not pile up."""
    server, links = Studio(1), [object() for _ in range(100)]
    for k, link in enumerate(links):
        server._remember(str(k), link)  # type: ignore[arg-type]
    assert list(server._pages.values()) == links[-REMEMBERED_PAGES:]


async def _reconnection(folder: Path) -> None:
    text = named("crank-rocker").text.partition("[expected]")[0]
    law = text[text.index("law = ") : text.index("measure = ")]
    (folder / "mine.toml").write_text(
        text.replace(law, 'law = { csv = "law.csv" }\nfrom = "outer dead centre"\n'), encoding="utf-8"
    )
    rows = [f"{phi},{phi**2 / 135}" for phi in range(0, 91, 5)]
    (folder / "law.csv").write_text("\n".join(["phi_deg,psi_deg", *rows]), encoding="utf-8")
    async with studio(str(folder / "mine.toml")) as (address, token, _):
        async with socket(address, token) as ws:
            page = (await until(ws, "hello"))["page"]
            await until(ws, "state", status="verified", searching=False)
            for ident, value in ((1, "510 mm"), (2, "520 mm")):
                await ws.send(json.dumps({"type": "set", "id": ident, "key": "mechanism.frame", "value": value}))
                await until(ws, "state", id=ident, searching=False)
            await ws.send(json.dumps({"type": "save", "id": 3}))
            await until(ws, "file")
        for frame, changed in (("520 mm", False), ("510 mm", True)):
            async with socket(address, f"{token}&page={page}") as ws:
                hello = await until(ws, "hello")
                assert (hello["page"], hello["opened"]) == (page, "mine")
                document = (await until(ws, "state", searching=False))["document"]
                assert f'frame = "{frame}"' in document["text"]
                assert (document["can_undo"], document["changed"]) == (True, changed)
                await ws.send(json.dumps({"type": "undo", "id": 4}))
                await until(ws, "state", id=4, searching=False)
        async with socket(address, token) as ws:
            assert (await until(ws, "hello"))["page"] != page
            assert 'frame = "500 mm"' in (await until(ws, "state"))["document"]["text"]


@pytest.mark.slow
def test_a_page_that_reconnects_continues_with_its_history(tmp_path: Path) -> None:
    """Also with a problem that reads other files, which the page could not open again by itself."""
    asyncio.run(_reconnection(tmp_path))


async def _crash() -> None:
    async with studio("crank-rocker") as (address, token, process), socket(address, token) as ws:
        await until(ws, "state", status="verified")
        drag = {"type": "drag", "handle": "mechanism.frame", "moving": False}
        shown = {}
        for ident, value in enumerate((510.0, 520.0, 530.0), 1):
            await ws.send(json.dumps({**drag, "id": ident, "value": value}))
            shown[ident] = await until(ws, "state", id=ident)
        worker = min(child.pid for child in psutil.Process(process.pid).children() if "worker" in " ".join(child.cmdline()))
        os.kill(worker, signal.SIGKILL)
        assert "history are kept" in (await until(ws, "fault"))["message"]
        for ident, kind, step in ((3, "", 3), (4, "undo", 2), (5, "undo", 1), (6, "redo", 2)):
            if kind:
                await ws.send(json.dumps({"type": kind, "id": ident}))
            state = await until(ws, "state", id=ident, status="verified")
            same = [one["value"] for one in shown[step]["variables"]]
            assert [one["value"] for one in state["variables"]] == pytest.approx(same, rel=1e-9)
        assert state["document"]["can_redo"]


@pytest.mark.slow
def test_a_killed_computation_continues_with_undo_and_redo() -> None:
    asyncio.run(_crash())


def test_a_process_that_cannot_be_started_is_a_sentence_on_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """No traceback in the terminal; a page that is open already is resumed when a process can be started again."""
    heard: list[Any] = []
    full = BlockingIOError(11, "Resource temporarily unavailable")

    class Socket:
        async def accept(self) -> None:
            pass

        async def close(self, code: int, reason: str) -> None:
            heard.append(reason)

    async def start() -> Any:
        raise full

    async def open_page() -> None:
        monkeypatch.setattr(Worker, "start", start)
        server = Studio(1)
        async with server._lifespan(None):  # type: ignore[arg-type]
            await server._live(Socket())  # type: ignore[arg-type]

    asyncio.run(open_page())
    (reason,) = heard
    assert reason.startswith("No process can be started for the computations: Resource temporarily unavailable.")
    assert len(reason.encode()) <= 123  # as a socket allows

    async def lose_process() -> tuple[list[Any], list[str]]:
        step = {"name": "a", "text": "one"}
        first = Scripted({"type": "kept", "step": "open", "steps": [step], "at": 0, "origin": "one"})
        second, tries = Scripted(), 0
        monkeypatch.setattr(second, "send", second.sent.append)  # it does not end
        monkeypatch.setattr("optlink.studio.link.RESTART_DELAY", 0.0)

        async def another() -> Any:
            nonlocal tries
            tries += 1
            if tries < 3:
                raise full
            return second

        sent = await sent_to_the_page(first, another)
        return second.sent, [message["message"] for message in sent]

    resumed, sent = asyncio.run(lose_process())
    assert resumed[0]["type"] == "resume"
    assert [text.partition(":")[0] for text in sent[1:3]] == [reason.partition(":")[0]] * 2


def test_a_page_too_many_is_told_why() -> None:
    """A socket that is closed before it is accepted has no words for the page."""
    heard: list[Any] = []

    class Socket:
        async def accept(self) -> None:
            heard.append("accepted")

        async def close(self, code: int, reason: str) -> None:
            heard.append(reason)

    full = Studio(1)
    full.links = set(range(MAX_PAGES))  # type: ignore[arg-type]
    asyncio.run(full._live(Socket()))  # type: ignore[arg-type]
    assert heard == ["accepted", FULL]


async def _ends(*pauses: float) -> tuple[int | None, bytes]:
    """Exit code and standard error of a studio with an open page that is interrupted several times, with pauses before it [s]."""
    async with studio("crank-rocker") as (address, token, process), socket(address, token) as ws:
        await until(ws, "state")
        for pause in pauses:
            await asyncio.sleep(pause)
            with contextlib.suppress(ProcessLookupError):
                process.send_signal(signal.SIGINT)
        await asyncio.wait_for(process.wait(), 10.0)
        assert process.stderr is not None
        return process.returncode, await process.stderr.read()


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="no such signal here")
def test_the_studio_ends_in_order_however_often_it_is_interrupted() -> None:
    """Its workers as well, with no traceback and no word of lost work."""
    before = {child.pid for child in psutil.Process().children(recursive=True)}
    for pauses in ((0.0,), (0.0, 0.02), (0.0, 0.01, 0.01, 0.05)):
        code, words = asyncio.run(_ends(*pauses))
        assert (code, words) == (0, b"Stop it with Ctrl-C.\n")
    assert {child.pid for child in psutil.Process().children(recursive=True)} <= before


async def _save_in_a_search() -> None:
    async with studio("path-closed18-untimed") as (address, token, _), socket(address, token) as ws:
        changed = {"type": "set", "id": 2, "key": "requirement.closed", "value": "false"}
        for ident, request in ((1, {"type": "search", "id": 1}), (2, changed)):
            await ws.send(json.dumps(request))
            await ws.send(json.dumps({"type": "save", "id": 10 + ident}))
            while (message := json.loads(await asyncio.wait_for(ws.recv(), SECONDS)))["type"] != "file":
                assert message["type"] in ("hello", "state", "progress")
                assert message["type"] != "state" or message["searching"]
            assert message["id"] == 10 + ident
            assert ("closed = false" in message["text"]) == (request is changed)
        await ws.send(json.dumps({"type": "stop", "id": 20}))
        await until(ws, "progress", text="stopped")
        await ws.send(json.dumps({"type": "save", "id": 21}))  # also where nothing is computed
        assert "closed = false" in (await until(ws, "file", id=21))["text"]


@pytest.mark.slow
def test_a_problem_is_saved_while_a_search_runs() -> None:
    """With the change that began the search; the search goes on."""
    asyncio.run(_save_in_a_search())
