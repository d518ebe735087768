"""Figures and commands of README and docs: `python benchmarks/readme.py [--check] [--slow] [--commands] [--write]`.

Without options every quoted figure is printed with its place and the command that computes it. `--check` computes the quick ones
and compares all with the text; the slow ones are compared with `readme_record.json`, which has the date of their last run.
`--slow` computes those too. `--commands` runs every command of the pages; with `--long` only those that tests/test_readme.py does
not run, because they take long. `--write` writes the record: with `--slow` of figures, with `--commands` of the long commands.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import functools
import json
import re
import shlex
import sys
import tempfile
import time
from collections.abc import Iterator
from typing import Any

from readme_figures import BLOCKS, FIGURES, LONG, PLACEHOLDERS, PREPARED, SERVER, Block, Figure
from timing import HERE, ROOT

sys.path.insert(0, str(ROOT))  # the checkout is measured, whether it is installed or not
RECORD = HERE / "readme_record.json"
FENCES = re.compile(r"^```(?P<kind>\w*)[^\n]*\n(?P<text>.*?)^```[ ]*$", re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"\{(-?[\d.]+(?:e-?\d+)?)\}")


# --- figures -------------------------------------------------------------------------------------------------------------


@functools.cache
def output(command: str, *, as_json: bool) -> str:
    """What a call of optlink prints, with exit codes 0 and 1; of several calls, in one empty folder, the last one."""
    from typer.testing import CliRunner

    from optlink.cli.app import app

    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for call in command.split(" && "):
            words = [*shlex.split(call), *(["--json"] if as_json else [])]
            done = CliRunner().invoke(app, words, env={"COLUMNS": "120"})
            if done.exit_code not in (0, 1):
                raise RuntimeError(f"optlink {call}: {done.output}")
    return done.stdout


def at(document: Any, path: str) -> float:
    """The number at a path of keys and indices, such as `limits/name=coupler/multiplier`."""
    for step in path.split("/"):
        if isinstance(document, list) and "=" in step:
            key, _, wanted = step.partition("=")
            document = next(one for one in document if str(one[key]) == wanted)
        else:
            document = document[int(step)] if isinstance(document, list) else document[step]
    return float(document)


def computed(figure: Figure) -> float:
    """The value of a figure from the JSON document of its command, in the unit of the page."""
    document = json.loads(output(figure.command, as_json=True))
    value = at(document, figure.path)
    return figure.scale * (value / at(document, figure.over) if figure.over else value)


def quoted(figure: Figure) -> tuple[float, float]:
    """The number on the page and its tolerance: half a unit of its last digit if none is stated."""
    found = NUMBER.search(figure.text)
    assert found is not None, figure.text
    digits = found[1]
    mantissa, _, power = digits.lower().partition("e")
    decimals = len(mantissa.partition(".")[2])
    return float(digits), figure.near or 0.5000001 * 10.0 ** (int(power or 0) - decimals)


def in_text(figure: Figure) -> bool:
    """Whether the page has the words of a figure."""
    return " ".join(NUMBER.sub(r"\1", figure.text).split()) in " ".join(page(figure.page).split())


@functools.cache
def page(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def block_lines(block: Block) -> list[str]:
    """The lines of a printed block of a page, named by words in it, without spaces that only align columns."""
    texts = [match["text"] for match in FENCES.finditer(page(block.page)) if match["kind"] == "text"]
    text = next((text for text in texts if block.words in " ".join(text.split())), None)
    if text is None:
        raise LookupError(f"{block.page}: no block has {block.words!r}")
    plain = [" ".join(line.split()) for line in text.split("\n")]
    return [line for line in plain if line not in ("", "...")]


def missing(block: Block, printed: str) -> list[str]:
    """Lines of a block that a command does not print."""
    lines = " ".join(printed.split())
    return [line for line in block_lines(block) if line not in lines]


def failures(*, slow: bool, record: dict[str, Any]) -> Iterator[str]:
    """What differs between the pages and the commands, or the record of those that are not run."""
    for figure in FIGURES:
        where = f"{figure.page}: {figure.text}"
        value, near = quoted(figure)
        if not in_text(figure):
            yield f"{where}: not on the page"
            continue
        if figure.command in LONG and not slow:
            found = record["figures"].get(f"{figure.page}: {figure.text}", {}).get("value")
            if found is None:
                yield f"{where}: no recorded value"
                continue
        else:
            try:
                found = computed(figure)
            except LookupError as error:
                yield f"{where}: optlink {figure.command} has no {figure.path}: {error}"
                continue
        if not abs(found - value) <= near:
            yield f"{where}: optlink {figure.command} gives {found!r}"
    for block in BLOCKS:
        if block.command in LONG and not slow:
            if record["blocks"].get(f"{block.page}: {block.words}", {}).get("lines") != block_lines(block):
                yield f"{block.page}: {block.words}: the record has other lines"
            continue
        for line in missing(block, output(block.command, as_json=False)):
            yield f"{block.page}: optlink {block.command} does not print {line!r}"


def recorded() -> dict[str, Any]:
    """The record of slow figures, blocks and commands."""
    found: dict[str, Any] = json.loads(RECORD.read_text(encoding="utf-8"))
    return found


def write(record: dict[str, Any]) -> None:
    """Write the record."""
    RECORD.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def stamp() -> dict[str, str]:
    """Date and version of a record."""
    import optlink

    return {"date": datetime.datetime.now(datetime.UTC).date().isoformat(), "optlink": optlink.__version__}


def measured_record(record: dict[str, Any]) -> dict[str, Any]:
    """The record with slow figures and blocks computed now."""
    for figure in FIGURES:
        if figure.command in LONG:
            record["figures"][f"{figure.page}: {figure.text}"] = {"value": computed(figure), **stamp()}
    for block in BLOCKS:
        if block.command in LONG and not missing(block, output(block.command, as_json=False)):
            record["blocks"][f"{block.page}: {block.words}"] = {"lines": block_lines(block), **stamp()}
    return record


# --- commands ------------------------------------------------------------------------------------------------------------


def calls(name: str) -> list[str]:
    """Shell lines of a page that call optlink, in their order."""
    found = []
    for match in FENCES.finditer(page(name)):
        if match["kind"] == "sh":
            lines = match["text"].replace("\\\n", " ").split("\n")
            found += [re.split(r"\s#", line)[0].strip() for line in lines if line.startswith("optlink ")]
    found += re.findall(r"^    (optlink [^#\n]*)", FENCES.sub("", page(name)), re.MULTILINE)
    return [line for line in map(str.strip, found) if line not in PLACEHOLDERS and not line.startswith(SERVER)]


def run_page(name: str, *, long: bool | None = None) -> Iterator[tuple[str, int, float, str]]:
    """Run the commands of a page in an empty folder; yield each with its exit code, seconds and messages.

    Parameters
    ----------
    name : str
        Of the page.
    long : bool, optional
        Run only those that take long, or only the others. Default: all.
    """
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for line in [*PREPARED.get(name, ()), *calls(name)]:
            if long is not None and is_long(line) is not long:
                continue
            begin = time.perf_counter()
            code, errors = ran(line)
            yield line, code, time.perf_counter() - begin, errors[-300:]


def is_long(line: str) -> bool:
    """Whether a shell line is among the commands that take long."""
    return " ".join(line.removeprefix("optlink ").split()) in LONG


def ran(line: str) -> tuple[int, str]:
    """Run a shell line with optlink in this process; its exit code, 70 after a traceback, and its messages."""
    from typer.testing import CliRunner

    from optlink.cli.app import app, rejoined

    words = shlex.split(line)[1:]
    words, target = (words[:-2], words[-1]) if words[-2:-1] == [">"] else (words, None)
    done = CliRunner().invoke(app, rejoined(words), env={"COLUMNS": "80"})
    if target is not None:
        with open(target, "w", encoding="utf-8") as file:
            file.write(done.stdout)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        return 70, repr(done.exception)
    return done.exit_code, done.stderr


def long_commands() -> set[str]:
    """The commands of the pages that take long."""
    return {line for name in pages() for line in calls(name) if is_long(line)}


def pages() -> list[str]:
    """Pages with commands, without the tutorial, whose commands and outputs its own test checks, and the generated pages."""
    names = ["README.md", "README.zh.md", *(path.relative_to(ROOT).as_posix() for path in sorted((ROOT / "docs").glob("*.md")))]
    return [name for name in names if name != "docs/tutorial.md" and calls(name)]


def main() -> None:
    """Print the figures, or compare them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare the figures with the pages")
    parser.add_argument("--slow", action="store_true", help="compute the slow figures too")
    parser.add_argument("--commands", action="store_true", help="run every command of the pages")
    parser.add_argument("--long", action="store_true", help="of the commands, only those that take long")
    parser.add_argument("--write", action="store_true", help="write the record of what is slow")
    options = parser.parse_args()
    record = recorded()
    if options.write and options.slow:
        record = measured_record(record)
    wrong = list(failures(slow=options.slow and not options.write, record=record)) if options.check else []
    if options.commands:
        for name in pages():
            for line, code, seconds, errors in run_page(name, long=True if options.long else None):
                print(f"{name}: {line}: exit code {code}, {seconds:.1f} s", flush=True)
                if code not in (0, 1):
                    wrong.append(f"{name}: {line}: {errors}")
                elif options.write and is_long(line):
                    record["commands"][line] = {"exit code": code, "seconds": round(seconds, 1), **stamp()}
                    write(record)
    if not options.check and not options.commands:
        for figure in FIGURES:
            value = quoted(figure)[0]
            print(f"{figure.page}: {value:g}: optlink {figure.command} --json, {figure.path}")
    if options.write:
        write(record)
    for line in wrong:
        print(line, file=sys.stderr)
    with contextlib.suppress(BrokenPipeError):
        sys.stdout.flush()
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
