"""Make the generated parts of the documentation again: `python -m docs.generate [KIND ...]`.

Without words everything is made that can be stale: the blocks of all pages, the pictures that are older than what they show.
Words choose among the kinds of blocks, "pictures" and "notebooks"; with the name of a picture, that picture is drawn in any case.
"""

from __future__ import annotations

import sys
from pathlib import Path

from docs.generate import notebooks, pages


def main(words: list[str]) -> int:
    """Write what differs; return 2 for an unknown word."""
    drawn = list(pages.pictures())
    known = {*pages.MAKERS, "pictures", "notebooks", *(one.file.stem for one in drawn)}
    if unknown := [word for word in words if word not in known]:
        sys.stderr.write(f"{unknown[0]}: no such part; known are {', '.join([*pages.MAKERS, 'pictures', 'notebooks'])}\n")
        return 2
    for picture in drawn:
        if picture.file.stem in words or (picture.stale and ("pictures" in words or not words)):
            picture.write()
            _tell(picture.file)
    kinds = tuple(kind for kind in pages.MAKERS if kind in words or not words)
    for page in pages.pages() if kinds else ():
        text = pages.renewed(page, kinds)
        if text != page.read_text(encoding="utf-8"):
            page.write_text(text, encoding="utf-8", newline="\n")
            _tell(page)
    if "notebooks" in words:
        for book in notebooks.books():
            notebooks.write(book)
            _tell(book)
    return 0


def _tell(file: Path) -> None:
    sys.stdout.write(f"{file.relative_to(pages.ROOT).as_posix()}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
