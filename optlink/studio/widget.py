"""The canvas of the studio as a widget: its page in a frame, with the same process and messages as the server."""

import asyncio
import base64
import html
import json
import re
import threading
from functools import cache
from pathlib import Path
from typing import Any

import anywidget
import traitlets

from optlink.problem.file import ProblemFile
from optlink.studio.document import Document, hello
from optlink.studio.link import Link, Requests, Worker
from optlink.tasks.run import solve

CANVAS_HEIGHT = 640  # px
ASSETS = Path(__file__).parent / "assets"
IMPORT = re.compile(r'^import (?:\{(?P<names>[^}]*)\} from )?"\./(?P<module>\w+)\.js";$', re.MULTILINE)
EXPORT = re.compile(r"^export (?=(?:const|class|function) (?P<name>[\w$]+))", re.MULTILINE)
ADDRESS = re.compile(r'(?:src|href)="/assets/(?P<name>[\w.]+)"')


@cache
def page() -> str:
    """Return the page of the studio as one document: style, scripts and pictures are part of it."""
    text = (ASSETS / "index.html").read_text(encoding="utf-8")
    style = (ASSETS / "studio.css").read_text(encoding="utf-8")
    text = text.replace('<link rel="stylesheet" href="/assets/studio.css">', f"<style>{style}</style>")
    text = text.replace(
        '<script type="module" src="/assets/app.js"></script>', f'<script type="module">{scripts("app")}</script>'
    )
    return ADDRESS.sub(_data, text).replace("<html ", "<html data-embedded ", 1)


def _data(match: re.Match[str]) -> str:
    """Return an attribute that names a picture of the package with the picture itself."""
    what, _, _ = match[0].partition("=")
    return f'{what}="data:image/svg+xml;base64,{base64.b64encode((ASSETS / match["name"]).read_bytes()).decode()}"'


def scripts(name: str, seen: dict[str, str] | None = None) -> str:
    """Return a module and those that it imports as one script: each is a function that returns what it exports."""
    parts: dict[str, str] = {} if seen is None else seen

    def imported(match: re.Match[str]) -> str:
        module, names = match["module"], match["names"]
        if module not in parts:
            scripts(module, parts)
        return f"const {{{names}}} = module_{module};" if names else ""

    text = IMPORT.sub(imported, (ASSETS / f"{name}.js").read_text(encoding="utf-8"))
    exported = ", ".join(match["name"] for match in EXPORT.finditer(text))
    parts[name] = f"const module_{name} = (() => {{\n{EXPORT.sub('', text)}\nreturn {{ {exported} }};\n}})();\n"
    return "".join(parts.values())


@cache
def _loop() -> asyncio.AbstractEventLoop:
    """Return an event loop in its own thread: the loop of the kernel does not run during a cell."""
    loop = asyncio.new_event_loop()
    threading.Thread(target=loop.run_forever, name="optlink-studio", daemon=True).start()
    return loop


class Canvas(anywidget.AnyWidget):
    """The studio in a notebook, with one open problem."""

    _esm = (ASSETS / "widget.mjs").read_text(encoding="utf-8").replace('"PAGE"', json.dumps(page()), 1)
    height = traitlets.Int(CANVAS_HEIGHT, help="Height of the canvas [px].").tag(sync=True)

    def __init__(self, document: Document) -> None:
        super().__init__()
        _ = document.problem
        self._opened, self._state = document, ""
        self._view: str | None = None
        self._link: Link | None = None
        self._requests = Requests()
        self._result: tuple[str, Any] = ("", None)
        self.on_msg(lambda _, content, buffers: self._receive(content))

    @property
    def _document(self) -> Document:
        """The document that is open on the canvas."""
        document = self._link.document if self._link is not None else None
        if document is not None and document["text"] != self._opened.text:
            self._opened = Document.of(document)
        return self._opened

    @property
    def problem(self) -> ProblemFile:
        """The problem on the canvas after the last release."""
        return self._document.problem

    @property
    def result(self) -> Any:
        """The result of `optlink.solve` for the present problem: the design of the canvas."""
        text = self._document.text
        if self._result[0] != text:
            self._result = (text, solve(self.problem))
        return self._result[1]

    @property
    def design(self) -> dict[str, float]:
        """The design variables [m, rad] of what is drawn, also while a handle is dragged."""
        if not self._state:
            return dict(self.result.design)
        quantities = self.problem.model.quantities
        variables = json.loads(self._state)["variables"]
        return {
            variable["name"]: variable["value"] * quantities[variable["name"]].si_per_unit
            for variable in variables
            if not variable["locked"]
        }

    @property
    def status(self) -> str:
        """Status of what is drawn: "verified", "not verified", "not valid", "infeasible" or "failed"."""
        return str(json.loads(self._state)["status"]) if self._state else "not verified"

    def close(self) -> None:
        """Remove the canvas, and end its process."""
        link, self._link, self._view = self._link, None, None
        if link is not None:
            asyncio.run_coroutine_threadsafe(link.close(), _loop())
        super().close()

    def _repr_mimebundle_(self, **options: Any) -> Any:
        """Return the widget, and a sentence for a notebook without a kernel."""
        title = str(self.problem.model.title or self._document.name)
        words = f"optlink studio: {html.escape(title)}. Run this cell to drag the linkage."
        bundle = super()._repr_mimebundle_(**options)
        data = bundle[0] if isinstance(bundle, tuple) else bundle
        return {**(data or {}), "text/html": f"<p>{words}</p>", "text/plain": repr(self)}

    def __repr__(self) -> str:
        return f"<Canvas of {self._document.name!r}>"

    # --- messages -----------------------------------------------------------------------------------------------------------

    def _receive(self, content: Any) -> None:
        """Take a message of a view: a request as text, or nothing where it has just been made."""
        if not isinstance(content, dict):
            return
        view, text = content.get("view"), content.get("text")
        if text is None:
            self._view, self._requests = view, Requests()
            self._answer(json.dumps(hello(self._document.name)))
            asyncio.run_coroutine_threadsafe(self._begin(), _loop())
        elif view == self._view:
            _loop().call_soon_threadsafe(self._request, text)

    def _request(self, text: object) -> None:
        """Take a request of the view that is shown, on the loop of the canvas."""
        if self._link is None or self._requests.closed:
            return
        request, refusal = self._requests.take(text)
        if request is not None:
            self._link.request(request)
        elif refusal is not None:
            self._answer(refusal)

    async def _begin(self) -> None:
        """Show the present problem; a process computes for it from now on."""
        if self._link is not None and self._link.document is not None:
            self._link.request({"type": "search", "id": 0})
            return
        if self._link is None:
            self._link = Link(await Worker.start(), self._pass)
        document = self._document
        self._link.request({"type": "resume", "id": 0, "steps": [document.message()], "at": 0, "origin": document.text})

    async def _pass(self, text: str) -> None:
        """Pass a message of the process on."""
        if text.startswith('{"type":"state"'):
            self._state = text
        self._answer(text)

    def _answer(self, text: str) -> None:
        self.send({"view": self._view, "text": text})
