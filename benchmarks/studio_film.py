"""Pictures and the film of the studio for the documentation, taken from a headless Chromium.

python benchmarks/studio_film.py [--out docs/images] [film start poses curve elements parts solutions phone]
"""

from __future__ import annotations

import argparse
import io
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, ImageDraw

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from optlink.presentation.style import one_palette
from tests.browser import browser, colours
from tests.studio.browser import Page, studio

FILM = (860, 540)  # inside of the window [px]
COLOURS = 40
EACH = 80  # duration of a frame of the film [ms]
REST = 1200  # of its last one [ms]
ARROW = ((0, 0), (0, 17), (4, 13), (7, 20), (10, 19), (7, 12), (12, 12))  # mouse pointer [px]


def shot(page: Page, pointer: tuple[float, float] | None = None) -> Image.Image:
    """Return a picture of the window, with a mouse pointer, which a headless browser has not.

    Parameters
    ----------
    page : Page
    pointer : (x, y) [px] or None, optional
    """
    picture = Image.open(io.BytesIO(page.driver.get_screenshot_as_png())).convert("RGB")
    if pointer is not None:
        corners = [(pointer[0] + x, pointer[1] + y) for x, y in ARROW]
        ImageDraw.Draw(picture).polygon(corners, fill="#111111", outline="#ffffff", width=1)
    return picture


def place(page: Page, handle: str) -> tuple[float, float]:
    """Return the middle of a handle [px]."""
    box = page.run("return document.querySelector(`[data-handle='${arguments[0]}'] .ring`).getBoundingClientRect()", handle)
    return box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]


def dragged(page: Page, handle: str, way: Sequence[tuple[int, int]]) -> Iterator[Image.Image]:
    """Yield a picture after every step of a drag, and some after its release.

    Parameters
    ----------
    page : Page
    handle : str
    way : sequence of (x, y) [px]
        Steps.
    """
    x, y = place(page, handle)
    page.press(handle)
    for u, v in way:
        answered = page.run("return window.studioTimings.length")
        page.move([(u, v)])
        x, y = x + u, y + v
        page.until("return window.studioTimings.length > arguments[0]", answered)
        time.sleep(0.06)
        yield shot(page, (x, y))
    page.release()
    page.verified()
    for _ in range(5):
        yield shot(page, (x, y))


def film(page: Page, out: Path) -> None:
    """Record the film: motion, a drag of the ground pivot, a drag of the limit of the transmission angle."""
    page.size(*FILM)
    page.open("crank-rocker")
    pictures = []
    for k in range(0, 73, 6):
        page.run("const c = document.querySelector('#crank'); c.value = arguments[0]; c.dispatchEvent(new Event('input'))", k)
        pictures.append(shot(page))
    smooth = [round(6.0 * math.sin(math.pi * k / 12.0)) for k in range(1, 12)]
    pictures += dragged(page, "mechanism.frame", [(-s, 0) for s in smooth] + [(s, 0) for s in smooth])
    pictures += dragged(
        page, "limits.transmission_angle.max", [(-s, s // 2) for s in smooth] + [(s, -(s // 2)) for s in smooth[:8]]
    )
    frames = one_palette([np.asarray(one) for one in pictures], COLOURS)
    times = [EACH] * (len(frames) - 1) + [REST]
    frames[0].save(out / "studio.gif", save_all=True, append_images=frames[1:], duration=times, loop=0, optimize=False)


def start(page: Page) -> None:
    """The first screen."""
    time.sleep(0.5)
    page.run("document.activeElement.blur()")


def poses(page: Page) -> Image.Image:
    """A pose while it is dragged: the design is not verified."""
    time.sleep(2.0)  # until the programme of the next drag is ready
    return list(dragged(page, "requirement.points.1", [(2, 2)] * 8))[7]


def egg(k: int) -> tuple[float, float]:
    """Return point `k` of a closed curve of 48 points [px]."""
    turn = k * math.pi / 24.0
    return 130.0 * math.cos(turn) + 30.0 * math.cos(2.0 * turn), 80.0 * math.sin(turn) + 25.0 * math.sin(2.0 * turn) - 60.0


def curve(page: Page) -> None:
    """A curve drawn by hand, and the four-bars for it."""
    page.find("#start-draw").click()
    page.stroke(egg, 48)
    page.until("return document.querySelector('.candidate') && !document.querySelector('#tray').hasAttribute('data-searching')")
    page.run("document.querySelector('.candidate').dispatchEvent(new Event('pointerenter'))")
    time.sleep(1.0)


def elements(page: Page) -> None:
    """The forms of gears and drive, with a value that is refused."""
    page.find('[data-template="geared-five-bar"]').click()
    page.verified()
    page.run("for (const key of ['drive', 'mechanism.gears.train']) document.querySelector(`[data-entry='${key}']`).open = true")
    page.run("document.querySelector('#elements').scrollIntoView()")
    page.run(
        "const field = document.getElementById('field-mechanism.gears.train.teeth.1');"
        "field.value = '0'; field.dispatchEvent(new Event('change'))"
    )
    page.until("return document.querySelector('#elements .fault')")
    page.run("document.querySelector('#elements').scrollIntoView(); document.querySelector('#hint').hidden = true")


def parts(page: Page) -> None:
    """A shaper as parts, with their layers and sizes."""
    page.find("#view-parts").click()
    page.until("return document.querySelectorAll('#parts tr').length")
    page.run("const c = document.querySelector('#crank'); c.value = 18; c.dispatchEvent(new Event('input'))")
    page.run("document.querySelector('#parts').scrollIntoView(); document.querySelector('#hint').hidden = true")
    page.run("document.querySelector('#handles').style.display = 'none'")


def solutions(page: Page) -> None:
    """All four-bars of five poses."""
    page.find("#tool-solutions").click()
    page.until("return document.querySelectorAll('#found .candidate').length")
    page.run("document.querySelectorAll('#found .candidate')[1].focus()")
    time.sleep(1.0)


def phone(page: Page) -> None:
    """A narrow window in dark colours."""
    page.run("document.querySelector('#hint').hidden = true")
    time.sleep(0.3)


class Still(NamedTuple):
    """A picture of the window: `then` does what it shows, or returns it; `problem` is opened first, if there is one."""

    then: Callable[[Page], Image.Image | None]
    problem: str | None = None
    height: int = 760
    width: int = 1200
    dark: bool = False

    def take(self, page: Page, path: Path) -> None:
        """Save the picture with few colours."""
        page.size(self.width, self.height)
        with colours(page.driver, dark=self.dark):
            page.open(self.problem)
            picture = self.then(page) or shot(page)
            picture.quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(path, optimize=True)


STILLS = {
    "start": Still(start, height=860),
    "poses": Still(poses, "motion-3-poses"),
    "curve": Still(curve),
    "elements": Still(elements),
    "parts": Still(parts, "shaper"),
    "solutions": Still(solutions, "motion-5-poses"),
    "phone": Still(phone, "crank-rocker", 860, 400, dark=True),
}
FILMED = "film"


def main() -> None:
    """Take the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parents[1] / "docs" / "images")
    parser.add_argument("pictures", nargs="*", metavar="picture", help=f"of {FILMED}, {', '.join(STILLS)}; default: all")
    options: Any = parser.parse_args()
    every = [FILMED, *STILLS]
    if unknown := set(options.pictures) - set(every):
        parser.error(f"unknown picture {', '.join(unknown)}: take of {', '.join(every)}")
    with browser() as driver, studio() as address:
        for name in options.pictures or every:
            page = Page(driver, address)
            if name == FILMED:
                film(page, options.out)
            else:
                STILLS[name].take(page, options.out / f"studio-{name}.png")


if __name__ == "__main__":
    main()
