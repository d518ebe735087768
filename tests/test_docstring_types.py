"""The types in the words of docstrings ("array (n,) or None") are those of the annotations (`Array | None`), on the pages too."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from docs.generate import api
from tests.test_docs import MADE, ROOT

ANY = "any"
WORDS = {
    **dict.fromkeys(("Mapping", "MutableMapping", "dict", "mapping", "mappings"), "mapping"),
    **dict.fromkeys(("tuple", "pair"), "tuple"),
    **dict.fromkeys(("Callable", "callable", "function"), "function"),
    **dict.fromkeys(("NDArray", "ndarray", "array", "arrays"), "array"),
    **dict.fromkeys(("set", "frozenset", "Set"), "set"),
    **dict.fromkeys(("float", "floats", "float64"), "float"),
    **dict.fromkeys(("int", "int8", "int_", "int64", "intp", "uint8"), "int"),
    **dict.fromkeys(("bool", "bool_"), "bool"),
    **dict.fromkeys(("None", "optional"), "None"),
    **dict.fromkeys(("Any", "object", "Self"), ANY),
    **{name: name.lower() for name in ("Sequence", "Iterable", "Iterator", "Collection")},
    **{name: name for name in ("sequence", "iterable", "iterator", "collection", "list", "str", "type")},
}
"""Words of docstrings and names in annotations, by what they mean."""
WIDER = {"float": "ArrayLike", "array": "ArrayLike", "int": "float"}
"""What accepts a type as well."""
NAME = re.compile(r"[A-Z]\w*[a-z]\w*|NLP")


@cache
def body_of(path: Path) -> list[ast.stmt]:
    return ast.parse(path.read_text(encoding="utf-8")).body


@cache
def statements(path: Path) -> list[ast.stmt]:
    """Statements of a module, with those for type checkers."""
    return list(_flat(body_of(path)))


def _flat(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    for node in body:
        yield from _flat(node.body) if isinstance(node, ast.If) else [node]


@cache
def alias(name: str, path: Path) -> tuple[ast.expr | None, Path] | None:
    """The annotation for which a name of a module stands, and its module; None in it for a type variable; else None."""
    for node in statements(path):
        if isinstance(node, ast.ImportFrom) and node.module and name in [item.asname or item.name for item in node.names]:
            room = ROOT / node.module.replace(".", "/")
            home = room.with_suffix(".py") if room.with_suffix(".py").exists() else room / "__init__.py"
            return alias(name, home) if home.exists() else None
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        if isinstance(target, ast.Name) and target.id == name:
            value = node.value
            return (None if isinstance(value, ast.Call) else value), path
    return None


Words = tuple[set[str], set[str]]


def annotated(node: ast.expr | None, path: Path) -> list[Words]:
    """The alternatives of an annotation, each as the words for it, and these with those for its elements."""
    if isinstance(node, ast.BinOp):
        return [*annotated(node.left, path), *annotated(node.right, path)]
    if isinstance(node, ast.Constant):
        whole = [({str(node.value)}, {str(node.value)})]
        return annotated(ast.parse(node.value, mode="eval").body, path) if isinstance(node.value, str) else whole
    if isinstance(node, ast.Subscript):
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        name = ast.unparse(node.value)
        if name == "Literal":
            kinds = {type(ast.literal_eval(part)).__name__ for part in parts}
            return [(kinds, kinds)]
        if name in ("Annotated", "Unpack"):
            return annotated(parts[0], path)
        inner = [words for part in parts for _, words in annotated(part, path)]
        return [(outer, words.union(*inner)) for outer, words in annotated(node.value, path)]
    if not isinstance(node, ast.Name | ast.Attribute):
        return [({ANY}, {ANY})]
    name = ast.unparse(node).rpartition(".")[2]
    meant = alias(name, path)
    if meant is None:
        return [({WORDS.get(name, name)}, {WORDS.get(name, name)})]
    return [({*outer, name}, {*words, name}) for outer, words in annotated(*meant)]


def stated(words: str) -> set[str]:
    """The types in the words of a docstring, without units, shapes and remarks."""
    words = re.sub(r"\[[^\]]*\]", "", words).partition(";")[0]
    words = re.sub(r"(function|callable)\b.*?(, optional|,? or None|$)", r"\1\2", words)
    words = re.sub(r'"[^"]*"', "str", re.sub(r"[+-]1\b", "int", words))
    words = re.sub(r"^\([^()]*\)", "tuple", words.strip())
    found = re.findall(r"\w+", re.sub(r"\([^()]*\)", "", words))
    return {WORDS.get(word, word) for word in found if word in WORDS or NAME.fullmatch(word)}


def disagrees(words: str, annotation: ast.expr | None, path: Path) -> bool:
    """Whether a docstring states another type than an annotation, or leaves one of its alternatives out.

    Words that name no type, as "symbol" or "binary file", are not compared.
    """
    said = stated(words)
    meant = annotated(annotation, path)
    known = set().union(*(inner for _, inner in meant))
    accepted = said | {WIDER.get(word, word) for word in said}
    wrong = {word for word in said - known - {"None"} if WIDER.get(word) not in known}
    lacking = [outer for outer, _ in meant if ANY not in outer and not outer & accepted]
    return bool(said) and bool(lacking or (wrong and ANY not in known))


def entries(docstring: str, title: str) -> list[tuple[str, str]]:
    """Names and words of the entries of a section; the name of a returned value may be empty."""
    section = re.search(rf"^{title}\n-+\n(.*?)(?=^\w[\w ]*\n-{{3,}}|\Z)", docstring, re.DOTALL | re.MULTILINE)
    found = []
    for line in section.group(1).splitlines() if section else []:
        named = re.fullmatch(r"(\*{0,2}\w+(?:, \*{0,2}\w+)*) : (.+)", line)
        if named:
            found += [(name.lstrip("*"), named.group(2)) for name in named.group(1).split(", ")]
        elif line and not line.startswith(" ") and title == "Returns":
            found.append(("", line))
    return found


def parameters(function: ast.FunctionDef) -> dict[str, ast.expr | None]:
    """Annotations by the names of the arguments."""
    all_of = function.args
    further = [argument for argument in (all_of.vararg, all_of.kwarg) if argument is not None]
    return {item.arg: item.annotation for item in [*all_of.posonlyargs, *all_of.args, *all_of.kwonlyargs, *further]}


def fields(node: ast.ClassDef) -> dict[str, ast.expr | None]:
    """Annotations of the fields of a class, of what its methods assign, and of the arguments of its constructor."""
    assigned = [item for item in ast.walk(node) if isinstance(item, ast.AnnAssign)]
    known: dict[str, ast.expr | None] = {ast.unparse(item.target).removeprefix("self."): item.annotation for item in assigned}
    return known | next((parameters(item) for item in node.body if getattr(item, "name", "") == "__init__"), {})


def disagreements(body: list[ast.stmt], path: Path, owner: str = "") -> Iterator[str]:
    """Sentences on the words of a module that differ from its annotations."""
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from disagreements(node.body, path, f"{node.name}.")
            stated_fields = [
                entry for title in ("Parameters", "Attributes") for entry in entries(ast.get_docstring(node) or "", title)
            ]
            known = fields(node) if stated_fields else {}
            pairs = [(name, words, known.get(name)) for name, words in stated_fields]
        elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            docstring, known = ast.get_docstring(node) or "", parameters(node)
            pairs = [(name, words, known.get(name)) for name, words in entries(docstring, "Parameters")]
            returned = entries(docstring, "Returns")
            several = len(returned) > 1 and isinstance(node.returns, ast.Subscript) and isinstance(node.returns.slice, ast.Tuple)
            parts: list[ast.expr | None] = node.returns.slice.elts if several else [node.returns]
            if returned and len(parts) != len(returned):
                yield f"{path.name}: {owner}{node.name} returns {len(parts)}, described are {len(returned)}"
                continue
            pairs += [(name or "Returns", words, part) for (name, words), part in zip(returned, parts, strict=bool(returned))]
        else:
            continue
        for name, words, annotation in pairs:
            if annotation is not None and disagrees(words, annotation, path):
                yield f"{path.name}: {owner}{node.name}, {name}: {words!r}, but {ast.unparse(annotation)}"


def test_docstrings_state_the_types_of_the_annotations() -> None:
    modules = sorted((ROOT / "optlink").rglob("*.py"))
    assert [text for path in modules for text in disagreements(body_of(path), path)] == []


GOOD = '''
class Wheel:
    """A wheel.

    Attributes
    ----------
    spokes : list of str
    """

    def __init__(self) -> None:
        self.spokes: list[str] = []


def f(a: Array | None, b: Mapping[str, float], c: Sequence[str] = (), d: str | Path = "", e: int = 1) -> tuple[Array, bool]:
    """Sum.

    Parameters
    ----------
    a : array (n,) [m] or None
    b : mapping of str to float [SI]
    c : sequence of str, optional
    d : "", "x" or Path
    e : int

    Returns
    -------
    x : array (n,)
    same : bool
    """
'''


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("a : array (n,) [m] or None", "a : array (n,) [m]"),
        ("a : array (n,) [m] or None", "a : sequence of float, or None"),
        ("b : mapping of str to float [SI]", "b : mapping of str to Path"),
        ("c : sequence of str, optional", "c : str, optional"),
        ('d : "", "x" or Path', 'd : "" or "x"'),
        ("e : int", "e : float"),
        ("    same : bool\n", ""),
        ("same : bool", "same : int"),
        ("spokes : list of str", "spokes : dict"),
    ],
)
def test_a_wrong_type_is_detected(right: str, wrong: str) -> None:
    path = ROOT / "optlink" / "linkage" / "vector2d.py"  # where `Array` stands for an annotation
    assert list(disagreements(ast.parse(GOOD).body, path)) == []
    assert right in GOOD
    (text,) = disagreements(ast.parse(GOOD.replace(right, wrong)).body, path)
    assert "vector2d.py: " in text


# --- the pages -----------------------------------------------------------------------------------------------------------------


def documented() -> Iterator[Any]:
    """The functions and classes of the Python reference, with their members, as the pages read them."""
    todo, seen = [api.package()[block.what.removeprefix("optlink.")] for block in MADE if block.kind == "api"], set()
    while todo:
        item = todo.pop()
        item = item.final_target if item.is_alias else item
        if item.path not in seen:
            seen.add(item.path)
            yield item
            members = [member for name, member in item.members.items() if not name.startswith("_") and not member.is_alias]
            todo += [member for member in members if member.is_function or member.is_class]


def test_the_reference_shows_no_internal_names_of_types() -> None:
    page = api.reference("optlink.tasks.results.certificate")
    assert "    lower_bound: float,\n" in page
    assert "    history: NDArray[np.float64] = np.zeros((0, 3)),\n" in page
    shown = "".join(path.read_text(encoding="utf-8") for path in (api.ROOT / "docs" / "api").glob("*.md"))
    assert not re.search(r"\bNever\b|lambda: np", shown)


@pytest.mark.slow
def test_the_reference_shows_the_types_of_the_signatures() -> None:
    """Of every parameter of a group, and of every returned value."""
    shown = 0
    for item in documented():
        for section in item.docstring.parse("numpy", warnings=False) if item.docstring is not None else ():
            if section.kind.value == "parameters":
                for entry in section.value:
                    shown += 1
                    assert str(entry.annotation) == str(item.parameters[entry.name].annotation), f"{item.path} {entry.name}"
            elif section.kind.value == "returns":
                shown += 1
                types = [str(entry.annotation) for entry in section.value]
                assert str(item.returns) in (types[0], f"tuple[{', '.join(types)}]"), item.path
    assert shown > 300
