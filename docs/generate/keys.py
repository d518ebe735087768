"""Reference of problem files, made from the models that read them: every table, key, unit, default and permitted value.

Descriptions are the strings below the fields in the source; examples are taken from the shipped problems and from the pages of
the documentation, which the tests load.
"""

from __future__ import annotations

import functools
import inspect
import re
import tomllib
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic.fields import FieldInfo

import optlink
from optlink.errors import InputError
from optlink.problem.base_model import Section, spellings
from optlink.problem.design import DesignProblem
from optlink.problem.machine.model import Problem
from optlink.problem.mechanism import DyadsSection, FourBarSection
from optlink.problem.requirements.base import DEFAULT_KIND, Requirement
from optlink.problem.schema import FORMS, READERS, description, owner
from optlink.problem.terms import QUANTITIES
from optlink.units import DEFINITIONS, KINDS, UnitProblem, factor

DOCS = Path(__file__).resolve().parent.parent
LONGEST = 90  # characters of an example

ROOTS: dict[type[Problem], tuple[str, str]] = {
    Problem: ("", "every problem"),
    DesignProblem: ("design", "laws, functions, paths, motions, strokes, transmission, cycle of a machine"),
}
"""Models of a complete file: suffix of their anchors, and kind of problem."""

NARRATED = {
    "": "problem-files.md#complete-file",
    "mechanism": "problem-files.md#mechanism",
    "bodies": "problem-files.md#bodies-and-joints",
    "joints": "problem-files.md#joints-with-clearance-and-control",
    "loads": "problem-files.md#loads",
    "drive": "problem-files.md#drive",
    "drives": "problem-files.md#several-drives",
    "control": "problem-files.md#joints-with-clearance-and-control",
    "balance": "balancing.md#the-section-balance",
    "expected": "problem-files.md#expected",
    "report": "problem-files.md#report",
    "parts": "parts.md#the-section-parts",
    "requirement": "problem-files.md#kinds-of-requirement",
    "requirements": "problem-files.md#several-demands",
    "rounding": "synthesis.md#rounding",
    "limits": "problem-files.md#limits",
    "tolerances": "problem-files.md#tolerances-and-a-robust-design",
    "objective": "machine-design.md#terms",
}
"""Page and anchor that describe a table, by the first part of its name."""

LINKED = "one of the [quantities](#quantities-of-the-cycle)"
"""Value of the key `quantity`."""


@dataclass(frozen=True)
class Part:
    """One table of the file: `path` in it ("joints.NAME"), the model that reads it, and the kind of problem that has it."""

    path: str
    model: type[Section]
    root: type[Problem]
    many: bool = False

    @property
    def heading(self) -> str:
        """The table as a file begins it."""
        if not self.path:
            return "At the top of the file" if self.root is Problem else f"At the top: {ROOTS[self.root][1]}"
        name = f"[[{self.path}]]" if self.many else f"[{self.path}]"
        key, kind = _variant(self.model)
        if marker := _marker(self.model):
            return f"{name}, with `{marker}`"
        return name + (f', {key} = "{kind}"' if kind else f": {ROOTS[self.root][1]}" if self.root is not Problem else "")


def _marker(model: type[Section]) -> str:
    """The key that marks the tables of this model among those of a registry; empty where there is one model."""
    return next(
        (key for base in model.__mro__[1:] if issubclass(base, Section) for key, one in base.models().items() if one is model), ""
    )


def _variant(model: type[Section]) -> tuple[str, str]:
    """Key and word by which a file chooses this model among several of one table; empty where there is one."""
    if issubclass(model, FourBarSection | DyadsSection):
        return "type", typing.get_args(model.model_fields["type"].annotation)[0]
    return ("kind", typing.get_args(model.model_fields["kind"].annotation)[0]) if issubclass(model, Requirement) else ("", "")


def sections() -> list[Part]:
    """Every table that a problem file can have: those of every problem first, each above the tables inside it."""
    found: dict[tuple[str, type[Section]], Part] = {}
    for root in ROOTS:
        own = root.model_fields if root is Problem else {k: v for k, v in root.model_fields.items() if _differs(root, k)}
        found["", root] = Part("", root, root)
        for part in _within("", own, root):
            found.setdefault((part.path, part.model), part)
    return list(found.values())


def _differs(root: type[Problem], name: str) -> bool:
    """Whether a kind of problem has a field of its own: not that of every problem, nor a narrower one."""
    return name not in Problem.model_fields


def _within(path: str, fields: Mapping[str, FieldInfo], root: type[Problem]) -> Iterator[Part]:
    for name, field in fields.items():
        for suffix, model, many in _models(field.annotation):
            below = f"{path}.{spellings(name, field)[0]}".strip(".") + suffix
            yield Part(below, model, root, many)
            yield from _within(below, model.model_fields, root)
            if model.model_config.get("extra") == "allow":  # tables under names of the user's choice
                for inner, other, several in _models(typing.get_type_hints(model)["__pydantic_extra__"]):
                    yield Part(below + inner, other, root, several)
                    yield from _within(below + inner, other.model_fields, root)


def _models(annotation: Any) -> Iterator[tuple[str, type[Section], bool]]:
    """Models inside an annotation, with what the name of their table ends in, and whether there may be many."""
    origin, inside = typing.get_origin(annotation), typing.get_args(annotation)
    if inspect.isclass(annotation) and issubclass(annotation, Section):
        yield from (("", model, False) for model in annotation.models().values())
    elif origin is dict:
        yield from ((f".NAME{suffix}", model, many) for suffix, model, many in _models(inside[1]))
    elif origin is tuple:
        yield from ((suffix, model, True) for suffix, model, _ in _models(inside[0]))
    elif origin in (typing.Union, types.UnionType, typing.Annotated):
        for one in inside if origin is not typing.Annotated else inside[:1]:
            yield from _models(one)


# --- what is said of a field -------------------------------------------------------------------------------------------


def value(model: type[Section], name: str) -> str:
    """Return the permitted values of a field."""
    field = model.model_fields[name]
    form = FORMS.get(f"{owner(model, name).__name__}.{name}", {})
    return LINKED if name == "quantity" else form.get("title") or _words(field.annotation, field.metadata)


def reader(annotation: Any, metadata: typing.Iterable[Any]) -> tuple[str, str | None] | None:
    """Return the name of the function that reads a quantity and the kind of the quantity; None if the field is no quantity."""
    for part in metadata:
        call = getattr(part, "func", None)
        if isinstance(call, functools.partial) and call.func.__name__ in READERS:
            return call.func.__name__, call.keywords["kind"]
    if typing.get_origin(annotation) is typing.Annotated:
        inner, *more = typing.get_args(annotation)
        return reader(inner, more)
    for inner in typing.get_args(annotation):
        found = reader(inner, ())
        if found:
            return found
    return None


def _words(annotation: Any, metadata: typing.Iterable[Any] = ()) -> str:
    known = reader(annotation, metadata)
    origin, inside = typing.get_origin(annotation), [a for a in typing.get_args(annotation) if a is not type(None)]
    if origin is dict and not known:
        return "table of names" if any(True for _ in _models(inside[1])) else f"names with {_words(inside[1])}"
    if known:
        return str(READERS[known[0]](known[1])["title"])
    if origin is typing.Literal:
        return ", ".join(f"`{text}`" for text in inside)
    if origin is typing.Annotated or (origin in (typing.Union, types.UnionType) and len(inside) == 1):
        return _words(inside[0])
    if any(True for _ in _models(annotation)):
        return "list of tables" if origin is tuple else "table"
    if origin is tuple:
        return "list of two names" if len(inside) == 2 and inside[1] is not Ellipsis else "list of names"
    plain = {str: "text", bool: "`true`, `false`", float: "number", int: "whole number"}
    if annotation not in plain:
        raise LookupError(f"add the permitted values of {annotation} to FORMS of optlink/problem/schema.py")
    return plain[annotation]


def left_out(field: FieldInfo) -> str:
    """Return the default of a field; empty if the description states it."""
    if field.is_required():
        return "required"
    default = field.get_default(call_default_factory=True, validated_data={})
    if default is None or default == "" or isinstance(default, dict | Section) or default in ((), (0.0, 0.0)):
        return ""
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    if isinstance(default, tuple):
        return f"`{default[0]:g}`"
    return f"`{default:g}`" if isinstance(default, float) else f"`{default}`"


# --- examples ------------------------------------------------------------------------------------------------------------


@functools.cache
def examples() -> dict[tuple[type[Section], str], str]:
    """Return the shortest example of every key in the shipped problems and in the documentation, by the class that defines it."""
    found: dict[tuple[type[Section], str], str] = {}
    for raw, model in _files():
        for owning, name, written in _stated(type(model), raw):
            text = toml(written)
            if len(text) <= LONGEST and len(text) < len(found.get((owning, name), " " * (LONGEST + 1))):
                found[owning, name] = text
    return found


def _files() -> Iterator[tuple[Mapping[str, Any], Problem]]:
    for name in optlink.shipped():
        file = optlink.load(name)
        yield file.raw, file.model
    for page in sorted(DOCS.glob("*.md")):
        for block in re.findall(r"```toml(?: design)?\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
            raw = tomllib.loads(block)
            if "title" in raw and "mechanism" in raw:
                try:
                    file = optlink.read(raw)
                except InputError as error:  # for a reader who edits the page
                    raise ValueError(f"an example of {page.name} cannot be read: {error}") from None
                yield file.raw, file.model


def _stated(model: type[Section], raw: Mapping[str, Any]) -> Iterator[tuple[type[Section], str, Any]]:
    for name, field in model.model_fields.items():
        key = spellings(name, field)[0]
        if key not in raw:
            continue
        below = list(_models(field.annotation))
        if not below:
            yield owner(model, name), name, raw[key]
        for suffix, inner, many in below:
            tables = raw[key] if many else raw[key].values() if suffix else [raw[key]]
            for table in tables:
                (word, kind), marker = _variant(inner), _marker(inner)
                first = next((key for key in (_marker(one) for _, one, _ in below) if key in table), "")
                if first == marker if marker else len(below) == 1 or table.get(word, DEFAULT_KIND) == kind:
                    yield from _stated(inner, table)


def toml(written: Any) -> str:
    """Return a value as TOML on one line."""
    if isinstance(written, dict):
        return "{ " + ", ".join(f"{_bare(key)} = {toml(item)}" for key, item in written.items()) + " }"
    if isinstance(written, list):
        return "[" + ", ".join(toml(item) for item in written) + "]"
    if isinstance(written, bool):
        return str(written).lower()
    return f'"{written}"' if isinstance(written, str) else repr(written)


def _bare(key: str) -> str:
    return key if re.fullmatch(r"[\w-]+", key) else f'"{key}"'


def example(model: type[Section], name: str) -> str:
    """Return an example of a key; empty for a table, whose keys have their own examples."""
    field = model.model_fields[name]
    known = examples().get((owner(model, name), name))
    if known is None:
        found = reader(field.annotation, field.metadata)
        if found is None or found[1] is None:
            return ""
        text = KINDS[found[1]].example
        known = f'{{ max = "{text}" }}' if found[0] == "read_interval" else f'"{text}"'
    return f"{spellings(name, field)[0]} = {known}"


# --- the page --------------------------------------------------------------------------------------------------------------


def reference() -> str:
    """Return the complete reference as Markdown."""
    return "\n\n".join([*(_table(part) for part in sections()), _terms(), _units()])


def _table(part: Part) -> str:
    first = inspect.cleandoc(part.model.__doc__ or "").split("\n\n")[0].replace("\n", " ")
    lines = [f"## {part.heading}", ""]
    told = NARRATED[part.path.split(".")[0]]
    if part.path:
        lines += [f"{first} [More](../{told})", ""]
    lines += ["| key | value | meaning |", "|---|---|---|"]
    for name, field in part.model.model_fields.items():
        if not part.path and part.root is not Problem and not _differs(part.root, name):
            continue
        default = left_out(field)
        said = description(part.model, name) + ("" if default in ("", "required") else f" Default: {default}.")
        shown = example(part.model, name)
        says = said + (f"<br>`{shown}`" if shown else "")
        key = f"`{spellings(name, field)[0]}`" + (" *required*" if default == "required" else "")
        lines.append(f"| {key} | {_cell(value(part.model, name))} | {_cell(says)} |")
    return "\n".join(lines)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _terms() -> str:
    lines = ["## Quantities of the cycle", "", "Values of `quantity` in `[objective]` and `[limits.NAME]`.", ""]
    lines += ["| quantity | kind | `of` | measures |", "|---|---|---|---|"]
    for name, nature in QUANTITIES.items():
        measures = ", ".join(f"`{measure}`" for measure in nature.measures) or "one value"
        lines.append(f"| `{name}` | {nature.kind or 'number'} | {nature.of or '-'} | {measures} |")
    return "\n".join(lines)


def _units() -> str:
    lines = [
        "## Units",
        "",
        "A quantity is text: a number and a unit of its kind, or a product of units of this kind.",
        "",
    ]
    lines += ["| kind | SI | example | single units |", "|---|---|---|---|"]
    for kind in (one for one in KINDS.values() if one.si):
        fit = ", ".join(f"`{unit}`" for unit in single_units() if _fits(unit, kind.name))
        lines.append(f"| {kind.name} | {kind.si.replace('**', '^')} | `{kind.example}` | {fit or '-'} |")
    return "\n".join(lines)


def single_units() -> list[str]:
    """Return the short names of all units."""
    return [
        definition.split("=")[2].strip() if definition.count("=") > 1 else definition.split(" ")[0] for definition in DEFINITIONS
    ]


def _fits(unit: str, kind: str) -> bool:
    try:
        factor(unit, kind)
    except UnitProblem:
        return False
    return True


def every_model() -> set[type[Section]]:
    """Return all models of problem files, including those that no file can contain."""
    found: set[type[Section]] = set()
    todo = [Section]
    while todo:
        model = todo.pop()
        todo += model.__subclasses__()
        found.add(model)
    return found - {Section}
