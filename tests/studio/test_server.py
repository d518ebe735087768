"""The socket of the studio: what it answers, and what it refuses."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import sys
import urllib.error
import urllib.request
from collections.abc import AsyncIterator
from typing import Any

import pytest
import websockets

SECONDS = 60.0


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
        assert status(address + "/") == 403
        assert status(f"{address}/?token={token}x") == 403
        assert status(f"{address}/?token={token}", Host="evil.example") == 403
        assert status(f"{address}/assets/../server.py?token={token}") == 404
        for origin, secret in (("http://evil.example", token), (address, "wrong"), (address, "")):
            with pytest.raises(websockets.InvalidStatus):
                async with socket(address, secret, origin):
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
            assert text.startswith("title =")
        process.send_signal(signal.SIGINT)
        await asyncio.wait_for(process.wait(), 2.0)
        assert process.returncode == 0
        assert process.stderr is not None
        assert b"Traceback" not in await process.stderr.read()


def test_a_page_drags_and_saves_and_strangers_are_refused() -> None:
    asyncio.run(_session())
