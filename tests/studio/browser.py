"""The studio in a browser: server, page and mouse, for its tests, its measurements and its pictures."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By

SECONDS = 300.0  # on a machine that is busy otherwise; most waits end within one


@contextlib.contextmanager
def studio(*arguments: str) -> Iterator[str]:
    """The command in a process of its own; its address with the token."""
    with subprocess.Popen(
        [sys.executable, "-m", "optlink", "studio", *arguments, "--no-browser"],
        stdout=subprocess.PIPE, text=True, env=os.environ | {"OMP_NUM_THREADS": "1"},
    ) as process:  # fmt: skip
        assert process.stdout is not None
        try:
            yield process.stdout.readline().split()[-1]
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(SECONDS)


class Page:
    """A page of the studio in a browser.

    Parameters
    ----------
    driver : selenium driver
    address : str
    """

    def __init__(self, driver: Any, address: str) -> None:
        self.driver, self.address = driver, address

    def open(self, problem: str | None = None) -> Page:
        """Load the page anew, and open a shipped problem on it; it stands still, as less motion is preferred."""
        self.driver.get(self.address)
        self.until("return document.documentElement.dataset.ready !== undefined")
        if problem is not None:
            self.find(f'[data-problem="{problem}"]').click()
            self.verified()
        return self

    def run(self, script: str, *arguments: Any) -> Any:
        """Return the value of a script."""
        return self.driver.execute_script(script, *arguments)

    def until(self, script: str, *arguments: Any, seconds: float = SECONDS) -> Any:
        """Wait until a script returns something true."""
        end = time.monotonic() + seconds
        while not (value := self.run(script, *arguments)):
            assert time.monotonic() < end, (
                f"in vain: {script}; {self.run('return toast.textContent + document.body.innerText')[:600]}"
            )
            time.sleep(0.05)  # each question costs both processes and the browser some milliseconds
        return value

    def find(self, selector: str) -> Any:
        """Return the first element of a selector."""
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def text(self, selector: str) -> str:
        """Return the text of an element."""
        return str(self.find(selector).text)

    def status(self) -> str:
        """Return the status of the design that is drawn."""
        return str(self.find("#canvas").get_attribute("data-status"))

    def verified(self) -> None:
        """Wait for a verified design, with no search that may change it."""
        done = "document.documentElement.dataset.searching === undefined && !document.documentElement.hasAttribute('data-busy')"
        said = "!/search/.test(document.querySelector('#conclusion').textContent)"
        self.until(f"return document.querySelector('#canvas').dataset.status === 'verified' && {done} && {said}")

    # --- mouse ---------------------------------------------------------------------------------------------------------------

    def press(self, handle: str) -> None:
        """Press the button of the mouse on a handle."""
        knob = self.find(f'[data-handle="{handle}"] .ring')
        ActionChains(self.driver, duration=0).click_and_hold(knob).perform()

    def move(self, steps: Sequence[tuple[int, int]], each: int = 16) -> None:
        """Move the mouse by steps [px], one after another [ms]."""
        chain = ActionChains(self.driver, duration=each)
        for x, y in steps:
            chain.move_by_offset(x, y)
        chain.perform()

    def release(self) -> None:
        """Release the button of the mouse."""
        ActionChains(self.driver, duration=0).release().perform()

    def stroke(self, at: Callable[[int], tuple[float, float]], count: int) -> None:
        """Draw a line on the canvas with the button held: places relative to its middle [px]."""
        places = [(round(x), round(y)) for x, y in map(at, range(count + 1))]
        chain = ActionChains(self.driver, duration=8)
        chain.move_to_element_with_offset(self.find("#canvas"), *places[0]).click_and_hold()
        for (x, y), (u, v) in itertools.pairwise(places):
            chain.move_by_offset(u - x, v - y)
        chain.release().perform()

    @property
    def scale(self) -> float:
        """Scale of the canvas [px/mm]."""
        return float(self.run("return Number(getComputedStyle(world).transform.split(/[(,]/)[1])"))

    # --- measuring and looking -----------------------------------------------------------------------------------------------

    def timings(self) -> list[dict[str, Any]]:
        """Return what the page noted of each movement of a drag [ms]."""
        return list(self.run("return window.studioTimings"))

    def size(self, width: int, height: int) -> None:
        """Set the size of the window's inside."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)

    def downloads(self, folder: Path) -> None:
        """Save downloads in a folder."""
        self.driver.execute_cdp_cmd("Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(folder)})
