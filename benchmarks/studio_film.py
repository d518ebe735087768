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
from typing import Any

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


def still(page: Page, path: Path) -> None:
    """Save a picture of the window with few colours."""
    shot(page).quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(path, optimize=True)


def start(page: Page, out: Path) -> None:
    """The first screen."""
    page.size(1200, 860)
    page.open()
    time.sleep(0.5)
    page.run("document.activeElement.blur()")
    still(page, out / "studio-start.png")


def poses(page: Page, out: Path) -> None:
    """A pose while it is dragged: the design is not verified."""
    page.size(1200, 760)
    page.open("motion-3-poses")
    time.sleep(2.0)  # until the programme of the next drag is ready
    page.press("requirement.points.1")
    page.move([(2, 2)] * 8, 40)
    page.until("return window.studioTimings.length >= 8")
    time.sleep(0.3)
    still(page, out / "studio-poses.png")
    page.release()


def egg(k: int) -> tuple[float, float]:
    """Return point `k` of a closed curve of 48 points [px]."""
    turn = k * math.pi / 24.0
    return 130.0 * math.cos(turn) + 30.0 * math.cos(2.0 * turn), 80.0 * math.sin(turn) + 25.0 * math.sin(2.0 * turn) - 60.0


def curve(page: Page, out: Path) -> None:
    """A curve drawn by hand, and the four-bars for it."""
    page.size(1200, 760)
    page.open()
    page.find("#start-draw").click()
    page.stroke(egg, 48)
    page.until("return document.querySelector('.candidate') && !document.querySelector('#tray').hasAttribute('data-searching')")
    page.run("document.querySelector('.candidate').dispatchEvent(new Event('pointerenter'))")
    time.sleep(1.0)
    still(page, out / "studio-curve.png")


def elements(page: Page, out: Path) -> None:
    """The forms of gears and drive, with a value that is refused."""
    page.size(1200, 760)
    page.open()
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
    still(page, out / "studio-elements.png")


def parts(page: Page, out: Path) -> None:
    """A shaper as parts, with their layers and sizes."""
    page.size(1200, 760)
    page.open("shaper")
    page.find("#view-parts").click()
    page.until("return document.querySelectorAll('#parts tr').length")
    page.run("const c = document.querySelector('#crank'); c.value = 18; c.dispatchEvent(new Event('input'))")
    page.run("document.querySelector('#parts').scrollIntoView(); document.querySelector('#hint').hidden = true")
    page.run("document.querySelector('#handles').style.display = 'none'")
    still(page, out / "studio-parts.png")


def solutions(page: Page, out: Path) -> None:
    """All four-bars of five poses."""
    page.size(1200, 760)
    page.open("motion-5-poses")
    page.find("#tool-solutions").click()
    page.until("return document.querySelectorAll('#found .candidate').length")
    page.run("document.querySelectorAll('#found .candidate')[1].focus()")
    time.sleep(1.0)
    still(page, out / "studio-solutions.png")


def phone(page: Page, out: Path) -> None:
    """A narrow window in dark colours."""
    page.size(400, 860)
    with colours(page.driver, dark=True):
        page.open("crank-rocker")
        page.run("document.querySelector('#hint').hidden = true")
        time.sleep(0.3)
        still(page, out / "studio-phone.png")


PICTURES: dict[str, Callable[[Page, Path], None]] = {
    "film": film,
    "start": start,
    "poses": poses,
    "curve": curve,
    "elements": elements,
    "parts": parts,
    "solutions": solutions,
    "phone": phone,
}


def main() -> None:
    """Take the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parents[1] / "docs" / "images")
    parser.add_argument("pictures", nargs="*", metavar="picture", help=f"of {', '.join(PICTURES)}; default: all")
    options: Any = parser.parse_args()
    if unknown := set(options.pictures) - set(PICTURES):
        parser.error(f"unknown picture {', '.join(unknown)}: take of {', '.join(PICTURES)}")
    with browser() as driver, studio() as address:
        for name in options.pictures or PICTURES:
            PICTURES[name](Page(driver, address), options.out)


if __name__ == "__main__":
    main()
