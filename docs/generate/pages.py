"""What is made in the pages: blocks of Markdown between two comments, and pictures.

    <!-- keys -->
    <!-- output: optlink solve crank-rocker | from: Design | to: Objective -->
    <!-- exit code: optlink solve crank-rocker -->
    <!-- api: optlink.linkage.fourbar | without: four_bar, grashof -->

Such a comment begins a block, `<!-- end -->` ends it. A picture is an SVG file whose last line names what it was made of.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import optlink
from docs.generate import (
    api,
    certificates,
    commands,
    constants,
    extending,
    gallery,
    keys,
    measurements,
    outputs,
    recipes,
    sketches,
    validation,
)
from optlink.problem.templates import templates

DOCS = Path(__file__).resolve().parents[1]
ROOT = DOCS.parent
BLOCK = re.compile(
    r"<!-- (?P<kind>[a-z][a-z ]*?)(?:: (?P<what>[^|\n]+?))?(?P<options>(?: \| [^|\n]+?)*) -->"
    r"(?P<text>(?:(?!<!--).)*)<!-- end -->",
    re.DOTALL,
)
VARYING = re.compile(
    r"\d[\d.,]*(?:e[-+]?\d+)?[ \u00a0]?(?:ns|µs|ms|s|min)\b|\d[\d.]*e-(?:09|1\d)\b|(?<![\w.,])0(?![\w.,])|\d+(?:\.\d+)? times"
)
"""What differs between two runs of the same code: durations, their ratios, and rounding errors, which may be zero."""
NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
ALIKE = 0.03
"""Relative difference of numbers that two processors may print: searches for several designs end at slightly different ones."""


@dataclass(frozen=True)
class Block:
    """A part of a page between its comments: its kind, the word behind it, its options, and the text that is stored."""

    page: Path
    kind: str
    what: str
    options: dict[str, str]
    text: str

    def made(self) -> str:
        """Return the text as it is made now."""
        return MAKERS[self.kind](self).strip()


def _api(block: Block) -> str:
    return api.reference(block.what, [name for name in block.options.get("without", "").split(", ") if name])


MAKERS: dict[str, Callable[[Block], str]] = {
    "keys": lambda _: keys.reference(),
    "commands": lambda _: commands.reference(),
    "measurements": lambda _: measurements.page(),
    "constants": lambda _: constants.page(),
    "certificates": lambda _: certificates.page(),
    "gallery": lambda _: gallery.page(),
    "recipes": lambda _: recipes.listed(),
    "api": _api,
    "extending": lambda _: extending.page(),
    "recipe": lambda block: recipes.recipe(block.page.stem),
    "output": lambda block: outputs.shown(block.what, block.options),
    "exit code": lambda block: outputs.exit_code(block.what),
    "figures": lambda _: validation.page(),
}
SOLVED = ("recipe", "output", "exit code", "figures")
"""Blocks whose problems must be solved; the others are made in a moment and are the same to the last character everywhere."""


def blocks(page: Path) -> list[Block]:
    """Return the blocks of a page, in their order."""
    return [_block(page, found) for found in BLOCK.finditer(page.read_text(encoding="utf-8"))]


def _block(page: Path, found: re.Match[str]) -> Block:
    options = dict(part.split(": ", 1) for part in found["options"].split(" | ")[1:])
    return Block(page, found["kind"], found["what"] or "", options, found["text"].strip())


def pages() -> list[Path]:
    """Return the pages that have blocks."""
    return [page for page in sorted(DOCS.rglob("*.md")) if blocks(page)]


def renewed(page: Path, kinds: tuple[str, ...]) -> str:
    """Return a page with the blocks of some kinds as they are made now; one that differs by times and rounding alone stays.

    Raises
    ------
    ValueError
        If a recipe quotes what its answer does not say.
    """

    def one(found: re.Match[str]) -> str:
        block = _block(page, found)
        if block.kind not in kinds:
            return found[0]
        text = block.made()
        if same(block, text):
            return found[0]
        head = found[0].partition("-->")[0] + "-->"
        return f"{head}\n\n{text}\n\n<!-- end -->" if "\n" in found[0] else f"{head}{text}<!-- end -->"

    text = BLOCK.sub(one, page.read_text(encoding="utf-8"))
    if "recipe" in kinds and (gone := recipes.missing(text)):
        raise ValueError(f"{page.name} quotes what the answer does not say: {', '.join(gone)}")
    return text


def same(block: Block, text: str) -> bool:
    """Whether a block says what is stored: to the character, or, where problems are solved, but for times and rounding."""
    if block.kind not in SOLVED:
        return block.text == text
    return alike(plain(block.text), plain(text), 1e-5 if block.kind == "figures" else ALIKE)


def plain(text: str) -> str:
    """Return a text without what differs between two runs: durations, rounding errors, widths of columns, differences.

    On another processor other starts of a search end at each of its optima, and it lists other ones of equal designs.
    """
    text = re.sub(r"\nDistinct optima\n.*?(?=\n```|\Z)", "", text, flags=re.DOTALL)
    text = VARYING.sub("#", re.sub(r"(?:-{2,}|[ \u2500-\u257f])+", " ", text))
    text = re.sub(r"(position of the largest difference)(?: \|[^|]*){3}", r"\1", text)  # which one it is, rounding decides
    return re.sub(r"\| -?\d(?:e-\d+)? \|", "| # |", text)


def alike(stored: str, now: str, within: float) -> bool:
    """Whether two texts have the same words, and numbers that differ by no more than a share."""
    if NUMBER.split(stored) != NUMBER.split(now):
        return False
    pairs = zip(NUMBER.findall(stored.replace("−", "-")), NUMBER.findall(now.replace("−", "-")), strict=True)
    return all(math.isclose(float(one), float(other), rel_tol=within, abs_tol=1e-6) for one, other in pairs)


# --- pictures ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Picture:
    """A picture of the pages: its file, the files that it shows, and how it is drawn."""

    file: Path
    shows: Path
    draw: Callable[[], bytes]

    @property
    def mark(self) -> str:
        """The last line of the file."""
        text = self.shows.read_text(encoding="utf-8")  # with the ends of lines of any system
        return f"<!-- {self.shows.relative_to(ROOT).as_posix()} {hashlib.sha256(text.encode()).hexdigest()[:16]} -->"

    @property
    def stale(self) -> bool:
        """Whether the file is missing, or what it shows has changed since."""
        return not self.file.exists() or not self.file.read_text(encoding="utf-8").endswith(f"{self.mark}\n")

    def write(self) -> None:
        """Draw it."""
        self.file.parent.mkdir(parents=True, exist_ok=True)
        text = f"{small(self.draw().decode())}{self.mark}\n"
        self.file.write_text(text, encoding="utf-8", newline="\n")


def pictures() -> Iterator[Picture]:
    """Yield all pictures that are drawn from the program."""
    for name in sketches.SKETCHES:
        yield Picture(DOCS / sketches.FOLDER / f"{name}.svg", Path(sketches.__file__), partial(sketches.svg, name))
    for name in optlink.shipped():
        yield Picture(DOCS / gallery.FOLDER / f"{name}.svg", ROOT / "problems" / f"{name}.toml", partial(gallery.picture, name))
    for name in templates():
        yield Picture(DOCS / "recipes" / f"{name}.svg", ROOT / "templates" / f"{name}.toml", partial(recipes.picture, name))
    yield Picture(DOCS / certificates.PICTURE, ROOT / "problems/crank-rocker.toml", certificates.boxes)
    yield Picture(DOCS / certificates.DYADS, ROOT / "problems/motion-4-poses.toml", certificates.dyads)


def small(svg: str) -> str:
    """Return a drawing with the points of its curves to a hundredth of a point."""

    def rounded(path: re.Match[str]) -> str:
        return re.sub(r"-?\d+\.\d{3,}", lambda number: f"{float(number[0]):.2f}".rstrip("0").rstrip("."), path[0])

    return re.sub(r' d="[^"]*"', rounded, svg)
