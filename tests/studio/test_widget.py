"""The canvas in a notebook: its page without a server, what Python sees of it, and a drag in a browser."""

from __future__ import annotations

import asyncio
import json
import re
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.support.expected_conditions import frame_to_be_available_and_switch_to_it
from selenium.webdriver.support.ui import WebDriverWait

import optlink
from optlink.errors import InputError
from optlink.studio.session import Session
from tests.browser import console
from tests.studio.browser import Page

pytest.importorskip("anywidget")
from optlink.studio.widget import ASSETS, _loop, page

FRONT = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Notebook</title></head>
<body style="margin: 0"><div id="cell"></div>
<script type="module">
const listeners = {};
window.asked = [];
window.model = { get: () => 600, on: (name, call) => (listeners[name] = call), off() {}, send: (content) => asked.push(content),
  take: (content) => listeners["msg:custom"](content) };
const address = URL.createObjectURL(new Blob([PYTHON_ESM], { type: "text/javascript" }));
const widget = (await import(address)).default;
widget.render({ model, el: document.getElementById("cell") });
</script></body></html>"""


class Direct:
    """The session of a canvas in this process."""

    def __init__(self, answer: Callable[[str], Any]) -> None:
        self.document: Mapping[str, Any] | None = None
        self.answer = answer
        self.session = Session(self.take)

    def take(self, message: Mapping[str, Any]) -> None:
        if message["type"] == "kept":
            if message["step"] != "settled":
                self.document = message["steps"][0] if message["step"] == "open" else message["document"]
        else:
            asyncio.run(self.answer(json.dumps(message, separators=(",", ":"))))

    def request(self, **request: Any) -> None:
        self.session.handle(request)


def test_python_reads_problem_and_design_of_the_canvas(monkeypatch: pytest.MonkeyPatch) -> None:
    canvas = optlink.explore(optlink.load("crank-rocker"))
    sent: list[str] = []
    monkeypatch.setattr(canvas, "send", lambda content: sent.append(json.loads(content["text"])["type"]))
    assert canvas.status == "not verified"
    link = canvas._link = Direct(canvas._pass)  # type: ignore[assignment]
    document = canvas._document
    link.request(type="resume", id=0, steps=[document.message()], at=0, origin=document.text)
    assert (canvas.status, set(sent)) == ("verified", {"state", "progress"})
    assert canvas.design == pytest.approx({"coupler": 0.412865, "rocker": 0.232246}, abs=1e-6)
    link.request(type="drag", id=1, handle="mechanism.frame", value=540.0, at=[540.0, 0.0], moving=True)
    assert canvas.status == "not verified"
    assert canvas.problem.raw["mechanism"]["frame"] == "500 mm"  # until the release
    link.request(type="drag", id=2, handle="mechanism.frame", value=540.0, at=[540.0, 0.0], moving=False)
    assert canvas.status == "verified"
    assert canvas.problem.model.mechanism.quantities["frame"].value == pytest.approx(0.54)
    for name, value in canvas.design.items():
        assert canvas.result.design[name] == pytest.approx(value, abs=1e-9)
    shown = canvas._repr_mimebundle_()
    assert {"application/vnd.jupyter.widget-view+json", "text/html", "text/plain"} <= set(shown)
    assert shown["text/plain"] == "<Canvas of 'crank-rocker'>"


def test_messages_of_a_view_are_checked_like_those_of_the_server(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing that is not a request reaches the process, and no message raises on the loop of the canvas."""
    canvas = optlink.explore("path-bean")
    answers: list[Any] = []
    monkeypatch.setattr(canvas, "send", lambda content: answers.append(json.loads(content["text"])))
    monkeypatch.setattr(canvas, "_begin", lambda: asyncio.sleep(0.0))
    requests: list[Any] = []

    class Recording:
        document = None

        def request(self, request: Any) -> None:
            requests.append(request)

    def arrived() -> None:
        asyncio.run_coroutine_threadsafe(asyncio.sleep(0.0), _loop()).result(10.0)

    canvas._link = Recording()  # type: ignore[assignment]
    errors: list[Any] = []
    _loop().call_soon_threadsafe(_loop().set_exception_handler, lambda loop, context: errors.append(context))
    try:
        canvas._receive({"view": "v", "text": None})
        bad = (
            "[]",
            "{}",
            "1",
            "{",
            '{"type":"save"}',
            '{"type":"resume","id":1}',
            '{"type":"start","id":1,"name":"/etc/passwd"}',
        )
        for text in (*bad, 3, [], {}, b"{}"):
            canvas._receive({"view": "v", "text": text})
        for content in (None, [], "text", {"text": '{"type":"save","id":4}'}, {"view": "w", "text": '{"type":"save","id":5}'}):
            canvas._receive(content)
        canvas._receive({"view": "v", "text": '{"type":"save","id":77}'})
        arrived()
    finally:
        _loop().call_soon_threadsafe(_loop().set_exception_handler, None)
        canvas._link = None
    assert requests == [{"type": "save", "id": 77}]
    assert [answer["type"] for answer in answers] == ["hello", *["fault"] * (len(bad) + 4)]
    assert errors == []


def test_the_page_is_one_document() -> None:
    text = page()
    assert "/assets/" not in text
    assert not re.search(r"^\s*(import|export)\b", text, re.MULTILINE)
    for script in ASSETS.glob("*.js"):
        assert text.count(f"const module_{script.stem} = ") == 1, script.name


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "anywidget", None)
    monkeypatch.delitem(sys.modules, "optlink.studio.widget", raising=False)
    with pytest.raises(InputError, match=r'anywidget.*pip install "\.\[notebook\]"'):
        optlink.explore("crank-rocker")


@pytest.mark.slow
def test_a_drag_in_a_notebook(driver: Any, tmp_path: Path) -> None:
    """The front end of the widget with a model that passes its messages to the kernel's side, which runs in this process."""
    canvas = optlink.explore("crank-rocker")
    waiting: list[Mapping[str, str]] = []
    canvas.send = waiting.append
    file = tmp_path / "notebook.html"
    file.write_text(FRONT.replace("PYTHON_ESM", json.dumps(canvas._esm).replace("</", "<\\/")), encoding="utf-8")
    console(driver), driver.get_log("performance")  # those of pages before
    driver.get(file.as_uri())
    within = Page(driver, "")

    def until(script: str) -> None:
        end = time.monotonic() + 60.0
        while not within.run(script):
            assert time.monotonic() < end, f"in vain: {script}; {within.run('return panel.innerText')[:400]}"
            driver.switch_to.default_content()
            for content in within.run("return asked.splice(0)"):
                canvas._receive(content)
            while waiting:
                within.run("model.take(arguments[0])", waiting.pop(0))
            driver.switch_to.frame(0)
            time.sleep(0.05)

    def shown(status: str) -> str:
        return f"return document.querySelector('#canvas').dataset.status === '{status}'"

    WebDriverWait(driver, 60).until(frame_to_be_available_and_switch_to_it(0))
    until(f"{shown('verified')} && document.documentElement.dataset.searching === undefined")
    knob = within.find('[data-handle="mechanism.frame"] .ring')
    ActionChains(driver, duration=0).click_and_hold(knob).perform()
    for _ in range(4):
        within.move([(6, 0)])
        until("return studioTimings.length > 0")
    until(shown("not-verified"))
    within.release()
    until(f"{shown('verified')} && document.querySelector('#undo').disabled === false")
    frame = canvas.problem.model.mechanism.quantities["frame"].value
    assert frame > 0.51
    assert canvas.design["coupler"] == pytest.approx(canvas.result.design["coupler"], abs=1e-9)
    assert float(str(within.find('[data-variable="frame"] input').get_attribute("value"))) == pytest.approx(frame * 1e3, rel=1e-4)
    assert console(driver) == []
    driver.switch_to.default_content()
    assert [entry for entry in driver.get_log("performance") if '"url":"http' in entry["message"]] == []
    canvas.close()
