"""A real browser for the tests: the system's Chromium without a window, driven by selenium; what it complains of and asks for."""

from __future__ import annotations

import importlib
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")


@contextmanager
def browser() -> Iterator[Any]:
    """Chromium; the test is skipped where there is none."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    if CHROMIUM is None or DRIVER is None:
        pytest.skip("no browser here: install Debian's packages chromium and chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for argument in ("--headless=new", "--disable-dev-shm-usage", "--window-size=1200,1000", "--disable-gpu"):
        options.add_argument(argument)
    options.add_argument("--force-prefers-reduced-motion")  # a linkage that moves by itself would take a core
    if os.name == "posix" and os.geteuid() == 0:
        options.add_argument("--no-sandbox")  # Chromium's sandbox is not for the superuser
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    driver.set_script_timeout(120)  # axe-core reads a page for as long as the machine is busy
    try:
        yield driver
    finally:
        driver.quit()


def opened(driver: Any, path: Path) -> tuple[list[str], list[str]]:
    """Open a page; return its console messages and every requested address except its own."""
    driver.get_log("browser")
    driver.get_log("performance")
    driver.get(path.as_uri())
    waiting = importlib.import_module("selenium.webdriver.support.ui").WebDriverWait(driver, 30, 0.05)
    waiting.until(lambda page: page.execute_script("return document.documentElement.dataset.ready !== undefined"))
    return console(driver), requests(driver, path)


@contextmanager
def colours(driver: Any, *, dark: bool) -> Iterator[None]:
    """Prefer light or dark colours, and wait until the page has been notified: listeners are called before a frame is drawn."""
    drawn = "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(done))"

    def prefer(*features: dict[str, str]) -> None:
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": features})
        driver.execute_async_script(drawn)

    prefer({"name": "prefers-color-scheme", "value": "dark" if dark else "light"})
    try:
        yield
    finally:
        prefer()


def faults(driver: Any, *rules: str) -> list[str]:
    """Serious and critical faults that axe-core finds in the page, by all its rules or by those that are named."""
    package = pytest.importorskip("axe_core_python", reason="axe-core-python is not installed")
    driver.execute_script((Path(package.__file__).parent / "axe.min.js").read_text(encoding="utf-8"))
    options = {"resultTypes": ["violations"], "selectors": False}  # without what is in order: half the time
    if rules:
        options["runOnly"] = list(rules)
    computed = driver.execute_async_script("axe.run(document, arguments[0]).then(arguments[1])", options)["violations"]
    return [f"{one['id']}: {one['nodes'][0]['html'][:200]}" for one in computed if one["impact"] in ("serious", "critical")]


def console(driver: Any) -> list[str]:
    """Console messages since the last call."""
    return [entry["message"] for entry in driver.get_log("browser")]


def requests(driver: Any, path: Path) -> list[str]:
    """Every address requested since then, except the page itself and its contents."""
    events = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    computed = [event["params"]["request"]["url"] for event in events if event["method"] == "Network.requestWillBeSent"]
    return [address for address in computed if address != path.as_uri() and not address.startswith(("data:", "blob:"))]
