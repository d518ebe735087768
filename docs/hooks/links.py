"""What the pages link to beside themselves: notebooks become pages, files of the repository are shown in the site.

The pages are written to be read in the repository, too; there `../notebooks/x.ipynb` or `../tests/test_x.py` are links that
work. Here each such file becomes a page: a notebook with its text, code, output and pictures, a source file with its lines, a
folder as a list.
"""

from __future__ import annotations

import base64
import json
import posixpath
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"(?<!\\)(?P<open>!?\[[^\]\n]*\]\()(?P<target>[^)\s]+)\)")
FENCE = re.compile(r"^(```|~~~).*?^\1\s*$", re.DOTALL | re.MULTILINE)
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
PASSED = {"image/png": "png", "image/gif": "gif", "image/jpeg": "jpg"}


def outward(markdown: str, folder: str) -> Iterator[str]:
    """Files and folders of the repository that a page in a folder of the repository ("docs") links to, without those of docs."""
    for match in LINK.finditer(FENCE.sub("", markdown)):
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

    return _outside_fences(markdown, lambda text: LINK.sub(one, text))


def _outside_fences(markdown: str, change: Callable[[str], str]) -> str:
    done, at = [], 0
    for fence in FENCE.finditer(markdown):
        done += [change(markdown[at : fence.start()]), fence[0]]
        at = fence.end()
    return "".join([*done, change(markdown[at:])])


# --- pages for what is no page -----------------------------------------------------------------------------------------


def source(path: str) -> str:
    """A file of the repository with its lines, or a folder as a list."""
    place = ROOT / path
    if place.is_dir():
        inside = sorted(one for one in place.iterdir() if one.suffix in LEXERS and one.name != "__init__.py")
        return f"{QUIET}# {path}/\n\n" + "".join(f"- [{one.name}]({one.name}.md)\n" for one in inside)
    text = place.read_text(encoding="utf-8")
    return f"{QUIET}# {path}\n\n````{LEXERS[place.suffix]}\n{text}````\n"


def below(path: str) -> list[str]:
    """What is shown with a file or folder: itself, and the files of a folder."""
    place = ROOT / path
    inside = (
        sorted(one for one in place.iterdir() if one.suffix in LEXERS and one.name != "__init__.py") if place.is_dir() else []
    )
    return [path, *(f"{path}/{one.name}" for one in inside)]


def with_formulas(text: str) -> str:
    """The text of a notebook with its formulas, `$` or `$$` around LaTeX, in the form of the pages (`formulas.marked`)."""
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
            parts.append(_outside_fences(rewritten(text, "notebooks", page_of(path)), with_formulas))
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


# --- MkDocs ------------------------------------------------------------------------------------------------------------


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """MkDocs: add a page for everything outside docs/ that a page links to, and for all notebooks."""
    from mkdocs.structure.files import File, InclusionLevel

    def add(uri: str, content: str | bytes, *, listed: bool = False) -> None:
        if files.get_file_from_path(uri) is None:
            level = InclusionLevel.UNDEFINED if listed else InclusionLevel.NOT_IN_NAV
            files.append(File.generated(config, uri, content=content, inclusion=level))

    wanted = {"tests/validation"}
    for path in OUTSIDE:
        text = (ROOT / path).read_text(encoding="utf-8")
        wanted |= set(outward(text, ""))
        add(page_of(path), rewritten(text, "", page_of(path)), listed=True)
    for book in sorted((ROOT / "notebooks").glob("*.ipynb")):
        path = f"notebooks/{book.name}"
        text, pictures = notebook(path)
        add(page_of(path), MINOR + text, listed=True)
        add(path, book.read_bytes())
        for name, data in pictures.items():
            add(f"notebooks/{name}", data)
    for page in [file for file in files.documentation_pages() if not file.generated_by]:
        text = page.content_string
        wanted |= set(outward(text, posixpath.dirname(f"docs/{page.src_uri}")))
    for path in sorted({inside for one in wanted for inside in below(one)}):
        if path not in OUTSIDE and not path.endswith(".ipynb") and (ROOT / path).exists():
            add(page_of(path), source(path))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """MkDocs: lead links out of docs/ to the pages above; fences that carry a word for the tests are plain ones."""
    uri = page.file.src_uri
    if page.file.generated_by is None:
        markdown = rewritten(markdown, posixpath.dirname(f"docs/{uri}"), uri)
    return re.sub(r"^```toml [a-z]+$", "```toml", markdown, flags=re.MULTILINE)


FETCHED = re.compile(r"<(?:script|img|iframe|source|video|audio|embed)\b[^>]*?\ssrc=[\"']?((?:https?:)?//[^\"'\s>]+)")
STYLED = re.compile(r"<link\b(?![^>]*\brel=[\"']?canonical)[^>]*?\shref=[\"']?((?:https?:)?//[^\"'\s>]+)")


def fetched(html: str) -> list[str]:
    """Addresses that a page would load from the network when it is opened; links that somebody may follow are none."""
    return FETCHED.findall(html) + STYLED.findall(html)


def on_post_page(output: str, page: Page, **_: Any) -> str:
    """MkDocs: no page asks the network for anything."""
    from mkdocs.exceptions import PluginError

    if found := fetched(output):
        raise PluginError(f"{page.file.src_uri} would load {found[0]}")
    return output
