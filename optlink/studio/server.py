"""The server of the studio: one page, its files, and one socket, on this machine alone.

The page and its files are the same for everyone. Problems go through the socket alone: it must come from the page of this server,
with the token of the address. There is no cookie: browsers send the cookies of one port to all other servers of this machine.
"""

import asyncio
import contextlib
import json
import mimetypes
import os
import secrets
import signal
import socket
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Receive, Scope, Send as AsgiSend
from starlette.websockets import WebSocket, WebSocketDisconnect

from optlink.errors import InputError
from optlink.studio.document import hello
from optlink.studio.link import MAX_MESSAGE, TOO_MANY, UNSTARTED_TEXT, Link, Requests, Worker

ASSETS = Path(__file__).parent / "assets"
ADDRESS = "127.0.0.1"
HOSTS = (ADDRESS, "localhost")
MAX_PAGES = 8  # at a time
REMEMBERED_PAGES = 32  # whose history outlives their connection
POLICY_VIOLATION = 1008  # code of a socket that is closed for breaking the rules
TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml", ".html": "text/html"}
"""Media types of the files of the page, whatever the system calls them."""
FULL = f"{MAX_PAGES} pages of the studio are open. Close one, and reconnect."


class Studio:
    """Application, token and pages of one server; a new page opens the initial problem."""

    def __init__(self, port: int, initial: str | None = None) -> None:
        self.port, self.opened, self.token = port, initial, secrets.token_urlsafe(32)
        self.links: set[Link] = set()
        self._pages: dict[str, Link] = {}  # the last ones by page: a page that reconnects continues with the history of its own
        self._spare: asyncio.Task[Worker | OSError] | None = None
        for ending, media in TYPES.items():
            mimetypes.add_type(media, ending)
        assets = Mount("/assets", StaticFiles(directory=ASSETS))
        routes = [Route("/", self._page), assets, WebSocketRoute("/live", self._live)]
        self.app: ASGIApp = _Guard(Starlette(routes=routes, lifespan=self._lifespan), self)

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        return f"http://{ADDRESS}:{self.port}/?token={self.token}"

    @property
    def hosts(self) -> set[str]:
        """Values of the header Host that mean this server."""
        return {f"{host}:{self.port}" for host in HOSTS}

    @property
    def origins(self) -> set[str]:
        """Origins of the page."""
        return {f"http://{host}" for host in self.hosts}

    def admits(self, token: str | None) -> bool:
        """Return whether a token is that of this server."""
        return token is not None and secrets.compare_digest(token.encode(), self.token.encode())

    def headers(self) -> dict[str, str]:
        """Return the headers of every answer: the page loads nothing from elsewhere, and no other page frames it."""
        sockets = " ".join(f"ws://{host}" for host in sorted(self.hosts))
        policy = (
            f"default-src 'self'; connect-src 'self' {sockets}; img-src 'self' data: blob:; object-src 'none'; "
            "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )
        return {
            "Content-Security-Policy": policy,
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cross-Origin-Opener-Policy": "same-origin",
            "Cache-Control": "no-store",
        }

    @contextlib.asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        self._spare = asyncio.create_task(_started())
        try:
            yield
        finally:
            for link in list(self.links):
                await link.close()
            spare = None if self._spare is None else await self._spare
            if isinstance(spare, Worker):
                spare.kill()

    # --- pages --------------------------------------------------------------------------------------------------------------

    async def _page(self, request: Request) -> Response:
        return FileResponse(ASSETS / "index.html")

    # --- the socket ---------------------------------------------------------------------------------------------------------

    def _remember(self, page: str, link: Link) -> None:
        """Keep the link of a page for its next connection, and forget the oldest ones."""
        self._pages[page] = link
        for oldest in list(self._pages)[:-REMEMBERED_PAGES]:
            del self._pages[oldest]

    async def _live(self, ws: WebSocket) -> None:
        await ws.accept()
        if len(self.links) >= MAX_PAGES:  # the page can read why after it was accepted only
            await ws.close(POLICY_VIOLATION, FULL)
            return

        async def send(text: str) -> None:
            try:
                await ws.send_text(text)
            except WebSocketDisconnect:
                raise ConnectionError from None

        try:
            worker = await self._worker()
        except OSError as error:
            await ws.close(POLICY_VIOLATION, f"{UNSTARTED_TEXT}: {error.strerror}. Reconnect to try again.")
            return
        link, page = Link(worker, send, self._worker), ws.query_params.get("page", "")
        before = self._pages.pop(page, None)
        name, begin = self.opened, {"type": "start", "id": 0, "name": self.opened}
        if before is not None and (resumption := before.resumption(0)) is not None:
            name, begin = resumption["steps"][-1]["name"], resumption
        page = page if before is not None else secrets.token_urlsafe(8)
        self._remember(page, link)
        self.links.add(link)
        try:
            await ws.send_text(json.dumps({**hello(name), "page": page}))
            if name is not None:
                link.request(begin)
            await _listen(ws, link)
        except WebSocketDisconnect:
            pass
        finally:
            self.links.discard(link)
            await link.close()

    async def _worker(self) -> Worker:
        """Return the process that waits, and start the next one; OSError if it could not be started."""
        assert self._spare is not None
        spare, self._spare = self._spare, asyncio.create_task(_started())
        worker = await spare
        if isinstance(worker, OSError):
            raise worker
        return worker


async def _started() -> Worker | OSError:
    """Return a started process, or why it cannot be started."""
    try:
        return await Worker.start()
    except OSError as error:
        return error


async def _listen(ws: WebSocket, link: Link) -> None:
    """Take the requests of a page; refuse what is malformed or too much, and close the socket after much of it."""
    requests = Requests()
    while True:
        event = await ws.receive()
        if event["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(event.get("code") or 1000)
        request, refusal = requests.take(event.get("text"))
        if request is not None:
            link.request(request)
        if requests.closed:
            await ws.close(POLICY_VIOLATION, TOO_MANY)
            raise WebSocketDisconnect(POLICY_VIOLATION)
        if refusal is not None:
            await ws.send_text(refusal)


class _Guard:
    """Refuses every request of another host or origin, and every socket without the token, before anything else sees it."""

    def __init__(self, app: ASGIApp, studio: Studio) -> None:
        self.app, self.studio = app, studio

    async def __call__(self, scope: Scope, receive: Receive, send: AsgiSend) -> None:
        """Answer a request, or refuse it."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        studio, live, request = self.studio, scope["type"] == "websocket", HTTPConnection(scope)
        hosts, origins = request.headers.getlist("host"), request.headers.getlist("origin")
        good = len(hosts) == 1 and hosts[0] in studio.hosts and set(origins) <= studio.origins
        if live:
            good = good and len(origins) == 1 and studio.admits(request.query_params.get("token"))
        if not good:
            if live:
                await receive()
                await send({"type": "websocket.close", "code": POLICY_VIOLATION})
                return
            words = "Forbidden: open the address that `optlink studio` printed."
            await PlainTextResponse(words, 403, headers=studio.headers())(scope, receive, send)
            return

        async def sent(message: Any) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(studio.headers())
            await send(message)

        await self.app(scope, receive, sent)


def serve(initial: str | None, port: int, ready: Callable[[str], None]) -> None:
    """Serve the studio on this machine until it is interrupted; port 0 is any free one, `ready` takes the address.

    Raises
    ------
    InputError
        If the port is in use.
    """
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((ADDRESS, port))
    except OSError as error:
        listening.close()
        remedy = "Leave --port out, or give another one"
        raise InputError(f"cannot listen on the port: {error.strerror}", remedy, key="--port", value=port) from None
    studio = Studio(listening.getsockname()[1], initial)
    config = uvicorn.Config(
        studio.app,
        log_level="warning",
        access_log=False,
        ws="websockets-sansio",
        ws_max_size=MAX_MESSAGE,
        ws_per_message_deflate=False,
        lifespan="on",
        server_header=False,
        timeout_graceful_shutdown=1,
        proxy_headers=False,
    )
    server = _Server(config, lambda: ready(studio.url))
    server.run(sockets=[listening])


class _Server(uvicorn.Server):
    """A server that reports when it listens."""

    def __init__(self, config: uvicorn.Config, ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._ready = ready

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """End the server in order, within about a second; a second signal changes nothing."""
        self.should_exit = True

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """End the server in order at Ctrl-C; uvicorn, and the handler of the command, would raise the signal again."""
        before = {number: signal.signal(number, self.handle_exit) for number in (signal.SIGINT, signal.SIGTERM)}
        watched = signal.set_wakeup_fd(-1) if os.name == "posix" else None
        try:
            yield
        finally:
            if watched is not None:
                signal.set_wakeup_fd(watched)
            for number, handler in before.items():
                signal.signal(number, handler)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, then report."""
        await super().startup(sockets)
        if not self.should_exit:
            self._ready()
