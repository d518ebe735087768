"""The folder of which the site is built, `build/pages`: all pages with their formulas, and what they link to beside themselves.

    python -m docs.generate.site && zensical build

The pages are written to be read in the repository, too; there `../notebooks/x.ipynb` or `../tests/test_x.py` are links that
work. Here each such file becomes a page: a notebook with its text, code, output and pictures, a source file with its lines, a
folder as a list.
"""

from __future__ import annotations

import base64
import html
import json
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path

from docs.generate import formulas

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"(?<!\\)(?P<open>!?\[[^\]\n]*\]\()(?P<target>[^)\s]+)\)")
OUTSIDE = {
    "README.md": "overview.md",
    "README.zh.md": "zh.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
    "CODE_OF_CONDUCT.md": "conduct.md",
}
"""Pages of the repository that are pages of the site under another name."""
LEXERS = {".py": "python", ".toml": "toml", ".m": "matlab", ".yml": "yaml", ".cff": "yaml"}
QUIET = "---\nsearch:\n  exclude: true\n---\n\n"
"""In front of pages that would only clutter the search."""
MINOR = "---\nsearch:\n  boost: 0.3\n---\n\n"
"""In front of pages that shall be found after the others."""
ROW = re.compile(r"^\|.*", re.MULTILINE)
PIPE = re.compile(r"`([^`\n]*\\\|[^`\n]*)`")
"""Code in a row of a table with \\|, which Python's Markdown shows with its backslash."""
PASSED = {"image/png": "png", "image/gif": "gif", "image/jpeg": "jpg"}


def outward(markdown: str, folder: str) -> Iterator[str]:
    """Files and folders of the repository that a page in a folder of the repository ("docs") links to, without those of docs."""
    for match in LINK.finditer(formulas.FENCE.sub("", markdown)):
        path = _resolved(match["target"], folder)
        if path and not path.startswith("docs/"):
            yield path


def _resolved(target: str, folder: str) -> str:
    """The path in the repository that a link means; empty for anchors and addresses."""
    path = target.partition("#")[0]
    if not path or re.match(r"[a-z]+:", path):
        return ""
    return posixpath.normpath(posixpath.join(folder, path))


def page_of(path: str) -> str:
    """Where the site shows a file or folder of the repository."""
    if path in OUTSIDE:
        return OUTSIDE[path]
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    if path.endswith(".ipynb"):
        return path.removesuffix(".ipynb") + ".md"
    return f"source/{path}.md" if (ROOT / path).is_file() else f"source/{path}/index.md"


def rewritten(markdown: str, folder: str, page: str) -> str:
    """Links of a text in a folder of the repository, as they are from a page of the site."""

    def one(match: re.Match[str]) -> str:
        path = _resolved(match["target"], folder)
        if not path:
            return match[0]
        _, sharp, anchor = match["target"].partition("#")
        return f"{match['open']}{posixpath.relpath(page_of(path), posixpath.dirname(page))}{sharp}{anchor})"

    return formulas.outside_fences(markdown, lambda text: LINK.sub(one, text))


# --- pages for what is no page -----------------------------------------------------------------------------------------


def source(path: str) -> str:
    """A file of the repository with its lines, or a folder as a list."""
    place = ROOT / path
    if place.is_dir():
        names = [one.removeprefix(f"{path}/") for one in inside(path)]
        return f"{QUIET}# {path}/\n\n" + "".join(f"- [{name}]({name}.md)\n" for name in names)
    text = place.read_text(encoding="utf-8")
    return f"{QUIET}# {path}\n\n````{LEXERS[place.suffix]}\n{text}````\n"


def inside(path: str) -> list[str]:
    """The files of a folder that are shown with it; of a file none."""
    found = (ROOT / path).glob("*")  # of a file nothing
    return sorted(f"{path}/{one.name}" for one in found if one.suffix in LEXERS and one.name != "__init__.py")


def with_formulas(text: str) -> str:
    """The text of a notebook with its formulas, `$` or `$$` around LaTeX, in the form of the pages (`formulas.shown`)."""
    text = re.sub(r"\$\$(.+?)\$\$", lambda found: f"\n\n```math\n{found[1].strip()}\n```\n\n", text, flags=re.DOTALL)
    return re.sub(r"(?<![\\$`])\$(?=[^\s$`])([^$`\n]*[^\s$`])\$(?!\w)", r"$`\1`$", text)


def notebook(path: str) -> tuple[str, dict[str, bytes]]:
    """A notebook as Markdown, and its pictures by their file names."""
    cells = json.loads((ROOT / path).read_text(encoding="utf-8"))["cells"]
    name = Path(path).stem
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in cells:
        text = _joined(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(formulas.outside_fences(rewritten(text, "notebooks", page_of(path)), with_formulas))
            continue
        if cell["cell_type"] != "code" or not text.strip():
            continue
        parts.append(f"````python\n{text}\n````")
        for output in cell["outputs"]:
            data = output.get("data", {})
            kind = next((kind for kind in PASSED if kind in data), None)
            if kind:
                file = f"{name}-{len(pictures) + 1}.{PASSED[kind]}"
                pictures[file] = base64.b64decode(_joined(data[kind]))
                parts.append(f"![what the lines above draw]({file})")
            elif "text/markdown" in data:
                parts.append(rewritten(_joined(data["text/markdown"]), "notebooks", page_of(path)))
            elif "text" in output or "text/plain" in data:
                parts.append(f"````text\n{_joined(output.get('text') or data['text/plain']).rstrip()}\n````")
    head, _, rest = "\n\n".join(parts).partition("\n")
    download = f"[Download this notebook]({name}.ipynb){{ .md-button }}"
    return f"{head}\n\n{download}\n{rest}\n", pictures


def _joined(text: str | list[str]) -> str:
    return text if isinstance(text, str) else "".join(text)


# --- the folder --------------------------------------------------------------------------------------------------------


def contents() -> dict[str, bytes]:
    """Return the files of the folder by their paths."""
    docs = [one.relative_to(ROOT).as_posix() for one in sorted((ROOT / "docs").rglob("*")) if one.is_file()]
    result = {"assets/math.ttf": formulas.font()}
    wanted = {"tests/validation"}
    for path in (*docs, *OUTSIDE):
        data = (ROOT / path).read_bytes()
        if path.endswith(".md"):
            text, folder = data.decode(), posixpath.dirname(path)
            wanted |= set(outward(text, folder))
            data = prose(rewritten(text, folder, page_of(path))).encode()
        if not path.endswith((".py", ".pyc")):
            result[page_of(path)] = data
    for book in sorted((ROOT / "notebooks").glob("*.ipynb")):
        path = f"notebooks/{book.name}"
        text, pictures = notebook(path)
        result |= {page_of(path): (MINOR + prose(text)).encode(), path: book.read_bytes()}
        result |= {f"notebooks/{name}": data for name, data in pictures.items()}
    for path in {shown for one in wanted for shown in (one, *inside(one))}:
        if page_of(path) not in result and (ROOT / path).exists():
            result[page_of(path)] = source(path).encode()
    return result


def prose(markdown: str) -> str:
    """A page as the site shows it: with its formulas, code of tables, and fences without the words of the tests."""
    text = formulas.outside_fences(formulas.shown(markdown), lambda text: ROW.sub(lambda row: PIPE.sub(_code, row[0]), text))
    return re.sub(r"^```toml [a-z]+$", "```toml", text, flags=re.MULTILINE)


def _code(found: re.Match[str]) -> str:
    text = found[1].replace(r"\|", "|")
    return f"<code>{formulas.inert(html.escape(text, quote=False))}</code>"


def write(folder: Path) -> None:
    """Write the folder: what differs, so that a running preview sees no more; what is not of it any longer goes."""
    made = contents()
    for old in [one for one in folder.rglob("*") if one.is_file() and one.relative_to(folder).as_posix() not in made]:
        old.unlink()
    for path, data in made.items():
        place = folder / path
        if not place.exists() or place.read_bytes() != data:
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(data)


if __name__ == "__main__":
    write(ROOT / "build/pages")
