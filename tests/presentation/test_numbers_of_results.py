"""Stored results of every number that is read are still read, drawn and exported; what a version adds or changes, others bear."""

from __future__ import annotations

import copy
import json
import zlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import pytest

import optlink
from optlink.errors import InputError
from optlink.io import SUM, check_sum, checked, with_check_sum
from optlink.presentation import registry
from optlink.presentation.registry import KINDS, ONE_MACHINE, json_schema, read_result, view_of
from optlink.problem import document, upgrades
from optlink.problem.document import hidden_fields, stored_fields
from optlink.problem.upgrades import OLDEST, STEPS, VERSION_OF_SCHEMAS, kind_of, upgraded
from tests.stored_results import FOLDER, MAKERS
from tests.tiers import mostly_slow

NUMBERS = range(OLDEST, VERSION_OF_SCHEMAS + 1)
FILES = [FOLDER / str(number) / f"{name}.json" for number in NUMBERS for name in MAKERS]
LATER = VERSION_OF_SCHEMAS + 1


def named(file: Path) -> str:
    return f"{file.parent.name}-{file.stem}"


every = pytest.mark.parametrize("file", FILES, ids=named)
drawn = pytest.mark.parametrize(
    "file", mostly_slow(FILES, *(file for file in FILES if file.stem == "output-sensitivity")), ids=named
)


@pytest.fixture
def design() -> dict[str, Any]:
    return content(FOLDER / str(VERSION_OF_SCHEMAS) / "design.json")


def content(file: Path) -> dict[str, Any]:
    """A stored document, without its check sum."""
    found = checked(json.loads(file.read_text(encoding="utf-8")))
    assert found is not None
    return found


def written(folder: Path, content: dict[str, Any]) -> Path:
    """The file of a document, with its check sum."""
    path = folder / "result.json"
    path.write_text(json.dumps(with_check_sum(content)), encoding="utf-8")
    return path


@cache
def validator() -> Any:
    schema = json_schema("result")
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def parts(result: Any, content: dict[str, Any]) -> dict[str, Any]:
    """What a document holds of the fields of its result."""
    hidden, added = hidden_fields(type(result)), upgrades.ADDED.get(type(result).kind, ())
    names = [name for name in stored_fields(type(result)) if name not in added]
    return {name: (content["state"] if name in hidden else content)[name] for name in names}


def differences(one: Any, other: Any, place: str = "") -> Iterator[str]:
    """The places at which two documents differ by more than the last digits of numbers."""
    if isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys():
        for key in one:
            yield from differences(one[key], other[key], f"{place}.{key}")
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for k, pair in enumerate(zip(one, other, strict=True)):
            yield from differences(*pair, f"{place}.{k}")
    elif one != (pytest.approx(other, rel=1e-7, abs=1e-12) if isinstance(one, float) else other):
        yield place


def test_every_kind_has_a_file_in_every_number() -> None:
    """Raise the number: write the steps of the kinds that change, then `python -m tests.stored_results`."""
    assert OLDEST in range(1, max(4, VERSION_OF_SCHEMAS - 1) + 1)
    for number in NUMBERS:
        files = [json.loads(file.read_text(encoding="utf-8")) for file in FILES if file.parent.name == str(number)]
        assert {kind_of(file["schema"]) for file in files} == {(kind, number) for kind in KINDS}
    assert {number for _, number in STEPS} <= {*NUMBERS[:-1]}


@every
def test_a_stored_result_is_read(file: Path) -> None:
    stored = content(file)
    result = read_result(file)
    assert list(differences(parts(result, result.to_dict()), parts(result, upgraded(stored)))) == []
    if stored["schema"] == result.schema():
        validator().validate(json.loads(file.read_text(encoding="utf-8")))


@drawn
def test_a_stored_result_is_drawn_and_exported(file: Path, tmp_path: Path) -> None:
    result = read_result(file)
    assert result.write(tmp_path / "out")
    if not view_of(result.kind).no_page:
        page = optlink.report(result, tmp_path / "page.html").read_text(encoding="utf-8")
        assert page.count("<h2") >= 2
        assert "<svg" in page or "Plotly." in page
    if result.kind in ONE_MACHINE and "infeasible" not in file.stem:
        for name in ("drawing.dxf", "drawing.svg", "motion.csv", "geometry.json"):
            assert optlink.export(result, tmp_path / name, points=12, even_invalid=True).stat().st_size > 500


# --- keys that a later version adds --------------------------------------------------------------------------------------------


def extended(value: Any, form: Any, parts: Any) -> Any:
    """A document with a further key in every object whose keys its schema lists."""
    if isinstance(form, dict) and "$ref" in form:
        return extended(value, parts[form["$ref"].rpartition("/")[2]], parts)
    if not isinstance(form, dict):
        return value
    for choice in form.get("anyOf", ()):
        value = extended(value, choice, parts)
    if isinstance(value, dict):
        known, others = form.get("properties", {}), form.get("additionalProperties")
        value = {key: extended(item, known.get(key, others), parts) for key, item in value.items()}
        return value | {"novel key": [1, {"x": None}]} if known.keys() & value.keys() else value
    if isinstance(value, list) and isinstance(form.get("items"), dict):
        return [extended(item, form["items"], parts) for item in value]
    if isinstance(value, list):
        return [extended(*pair, parts) for pair in zip(value, form.get("prefixItems", [None] * len(value)), strict=False)]
    return value


@every
def test_added_keys_are_passed_over(file: Path, tmp_path: Path) -> None:
    stored = upgraded(content(file))
    kind, _ = kind_of(stored["schema"])
    schema = json_schema(kind)
    more = extended(stored, schema["anyOf"][0], schema["$defs"])
    assert json.dumps(more).count("novel key") >= 2  # in the document and in `problem_file` at least
    validator().validate(with_check_sum(more))
    result = read_result(written(tmp_path, more))
    assert list(differences(parts(result, result.to_dict()), parts(result, stored))) == []
    assert "novel key" not in json.dumps(result.to_dict())


def test_keys_are_added_within_many_parts(design: dict[str, Any]) -> None:
    schema = json_schema("design")
    assert json.dumps(extended(design, schema["anyOf"][0], schema["$defs"])).count("novel key") > 20


def test_a_document_from_before_a_key_was_added_is_read(
    design: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    del design["conflict"]
    path = written(tmp_path, design)
    with pytest.raises(InputError, match="lacks or misreads conflict"):
        read_result(path)
    assert not validator().is_valid(json.loads(path.read_text()))
    monkeypatch.setitem(upgrades.ADDED, "design", ("conflict", *upgrades.ADDED["design"]))
    assert read_result(path).to_dict()["conflict"] == []
    jsonschema.validate(json.loads(path.read_text()), json_schema("design"))


# --- numbers -------------------------------------------------------------------------------------------------------------------


def test_the_next_number_reads_the_present_one_by_its_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the next number named the seconds of a design otherwise, and changed nothing else."""
    for module in (upgrades, registry, document):
        monkeypatch.setattr(module, "VERSION_OF_SCHEMAS", LATER)
    stored = {stem: content(FOLDER / str(VERSION_OF_SCHEMAS) / f"{stem}.json") for stem in ("design", "balance")}
    former = stored["design"] | {"duration": stored["design"]["seconds"]}
    del former["seconds"]
    path = written(tmp_path, former)
    with pytest.raises(InputError, match="lacks or misreads seconds"):
        read_result(path)
    step = lambda content: {**{key: item for key, item in content.items() if key != "duration"}, "seconds": content["duration"]}  # noqa: E731
    monkeypatch.setitem(STEPS, ("design", VERSION_OF_SCHEMAS), step)
    result = read_result(path)
    assert result.schema() == f"optlink/design/{LATER}" == result.to_dict()["schema"]
    assert result.seconds == stored["design"]["seconds"]
    assert optlink.read_design("crank-rocker", [str(path)])["coupler"] == pytest.approx(result.design["coupler"], rel=1e-15)
    assert read_result(written(tmp_path, stored["balance"])).schema() == f"optlink/balance/{LATER}"


@pytest.mark.parametrize(
    ("schema", "message", "remedy"),
    [
        (f"optlink/design/{LATER}", "later format", "Update optlink"),
        (f"optlink/novel/{LATER}", "later format", "Update optlink"),
        (f"optlink/design/{OLDEST - 1}", "another version", "Run `solve` again"),
        ("optlink/function/2", "another version", "Run `solve` again"),
        ("optlink/design/04x", "not a result", "Give what"),
        (f"optlink/novel/{OLDEST}", "not a result", "Give what"),
        (4, "not a result", "Give what"),
    ],
)
def test_other_numbers_are_refused(design: dict[str, Any], tmp_path: Path, schema: object, message: str, remedy: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_result(written(tmp_path, design | {"schema": schema}))
    assert caught.value.faults[0].remedy.startswith(remedy)


@pytest.mark.slow
def test_the_schemas_name_themselves_and_their_number() -> None:
    assert json_schema("problem")["$id"] == "urn:optlink:problem:1"
    assert json_schema("result")["$id"] == f"urn:optlink:result:{VERSION_OF_SCHEMAS}"
    assert json_schema("control comparison")["$id"] == f"urn:optlink:result:control-comparison:{VERSION_OF_SCHEMAS}"
    assert f"number {VERSION_OF_SCHEMAS}" in json_schema("result")["description"]
    assert '"additionalProperties": false' not in json.dumps(json_schema("result"))


# --- the check sum -------------------------------------------------------------------------------------------------------------


def shuffled(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: shuffled(value[key]) for key in reversed(value)}
    return [shuffled(item) for item in value] if isinstance(value, list) else value


def whole(value: Any) -> Any:
    """The document as a program writes it whose numbers are all alike."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return type(value)((key, whole(item)) for key, item in items) if isinstance(value, dict) else [whole(x) for _, x in items]
    return int(value) if isinstance(value, float) and value.is_integer() else value


@pytest.mark.parametrize("change", [shuffled, whole])
def test_a_document_that_another_program_wrote_again_is_unchanged(design: dict[str, Any], tmp_path: Path, change: Any) -> None:
    first = with_check_sum(design | {"status": "optimal Ω", "seed": -0.0})
    again = json.dumps(change(first), indent=1, ensure_ascii=False)
    assert again != json.dumps(first, indent=1, ensure_ascii=False)
    assert checked(json.loads(again)) is not None
    (tmp_path / "result.json").write_text(json.dumps(change(with_check_sum(design))), encoding="utf-8")
    assert read_result(tmp_path).to_dict()[SUM]


def test_the_check_sum_is_what_the_documentation_says(design: dict[str, Any]) -> None:
    text = json.dumps({**design, "title": "Ω"})
    plain = json.dumps(json.loads(text, parse_int=float), sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    assert f"{zlib.crc32(plain.encode('ascii')):08x}" == with_check_sum(json.loads(text))[SUM]


@pytest.mark.parametrize("former", [False, True])
def test_a_changed_value_changes_the_check_sum(design: dict[str, Any], former: bool) -> None:
    stored = with_check_sum(design)
    if former:  # as it was before there was a canonical form
        stored[SUM] = check_sum(json.dumps(design).encode())
    assert checked(stored) == design
    changed = copy.deepcopy(stored)
    changed["design"]["coupler_mm"] *= 1 + 1e-15
    for wrong in (changed, stored | {"novel": 1}, {key: item for key, item in stored.items() if key != "notes"}):
        assert checked(wrong) is None
    assert checked({key: item for key, item in stored.items() if key != SUM}) is None


def test_a_huge_number_is_no_fault(design: dict[str, Any]) -> None:
    assert checked(design | {"seed": 10**400, SUM: ""}) is None
