"""Forms of the page for the tables of a problem file, from the schema that the models have: what can be stated, and how."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

from optlink.problem.assignment import parse_assignment
from optlink.problem.file import ProblemFile
from optlink.problem.machine.model import Problem
from optlink.problem.machine.parts import PartsSection
from optlink.problem.schema import schema_of

DRIVES = ("drive", "drives")
"""Sections of a machine beside its mechanism and its parts that have forms."""
Form = dict[str, Any]
"""What a value can be, by `is`: "text", "flag", "list", "table", "names" (a table of any names), "choice" of several of these."""


def groups(problem: ProblemFile) -> list[dict[str, Any]]:
    """Return the tables of a problem that have forms, with their values: drives, tables of its mechanism by name, and parts."""
    fields: Any = Problem.model_fields
    forms = {key: _form_of(fields[key].annotation) for key in DRIVES}
    linkage = _form_of(type(problem.model.mechanism))["fields"]
    forms |= {f"mechanism.{name}": one for name, one in linkage.items() if one["is"] == "names"}
    forms["parts"] = _form_of(PartsSection)
    return [{"key": key, "form": form, "value": problem.at(key)} for key, form in forms.items()]


def changes(problem: ProblemFile, tables: Mapping[str, Any]) -> dict[str, object]:
    """Return the changes of a file for whole tables by dotted key, None for those that are removed.

    A section of names that becomes empty is removed as well.
    """
    stated: dict[str, object] = {key: None if new is None else _read(new, problem.at(key), key) for key, new in tables.items()}
    for section in {key.rpartition(".")[0] for key, new in tables.items() if new is None} - {""}:
        present = problem.at(section) or {}
        kept = {f"{section}.{name}" for name in present} | {key for key in stated if key.rpartition(".")[0] == section}
        if all(stated.get(key, present) is None for key in kept):
            stated = {key: value for key, value in stated.items() if key not in kept} | {section: None}
    return stated


def _read(new: Any, old: Any, key: str) -> Any:
    """Return a value with its texts read as on the command line; what is not changed is kept as it is."""
    if new == old:
        return old
    if isinstance(new, Mapping):
        named = old if isinstance(old, Mapping) else {}
        return {name: _read(one, named.get(name), f"{key}.{name}") for name, one in new.items()}
    if isinstance(new, list):
        rows = itertools.zip_longest(new, old[: len(new)] if isinstance(old, list) else [])
        return [_read(one, before, f"{key}.{k}") for k, (one, before) in enumerate(rows)]
    return parse_assignment(f"{key}={new}", "set")[1] if isinstance(new, str) and new.strip() else new


@cache
def _form_of(kind: Any) -> Form:
    """Return the form of a model, or of the type of a field."""
    schema = schema_of(kind)
    return form(schema, schema.get("$defs", {}))


def form(schema: Mapping[str, Any], definitions: Mapping[str, Any]) -> Form:
    """Return the form of a part of a schema."""
    if "$ref" in schema:
        schema = definitions[schema["$ref"].rpartition("/")[2]] | schema
    shape = dict(_shape(schema, definitions))
    about = {"about": schema.get("description"), "default": schema.get("default")}
    return shape | {key: value for key, value in about.items() if value is not None}


def _shape(schema: Mapping[str, Any], definitions: Mapping[str, Any]) -> Form:
    """Return the form of a schema without what is said of it."""
    if "anyOf" in schema:
        return _joined([form(one, definitions) for one in schema["anyOf"]])
    if schema.get("type") == "array":
        return {"is": "list", "of": form(schema["items"], definitions), "most": schema.get("maxItems")}
    if isinstance(schema.get("additionalProperties"), Mapping):
        return {"is": "names", "of": form(schema["additionalProperties"], definitions)}
    if "properties" in schema:
        fields = {name: form(one, definitions) for name, one in schema["properties"].items()}
        return {"is": "table", "fields": fields, "required": schema.get("required", [])}
    if schema.get("type") == "boolean":
        return {"is": "flag"}
    options = schema.get("enum", [schema["const"]] if "const" in schema else [])
    return {"is": "text", "options": options, "only": bool(options), "examples": schema.get("examples", [])}


def _joined(forms: list[Form]) -> Form:
    """Return one form for several: what is typed as text is one of them, whatever it can be."""
    texts = [one for one in forms if one["is"] == "text"]
    parts = [one for one in forms if one["is"] != "text"]
    if texts:
        several: dict[str, list[Any]] = {key: [*_each(texts, key)] for key in ("options", "examples")}
        parts.insert(0, {"is": "text", **several, "only": all(one["only"] for one in texts)})
    return parts[0] if len(parts) == 1 else {"is": "choice", "of": parts}


def _each(forms: list[Form], key: str) -> Iterator[Any]:
    """Yield the different entries of lists of forms."""
    yield from dict.fromkeys(entry for one in forms for entry in one[key])
