"""The size of each package stays within its budget in budget.toml."""

import ast
import collections
import io
import tokenize
import tomllib
from pathlib import Path

import optlink

PACKAGE = Path(optlink.__file__).parent
LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}


def tokens(text: str) -> int:
    """Return the number of tokens of a module without comments, docstrings and layout."""
    documentation = set[int]()
    for node in ast.walk(ast.parse(text)):
        body = getattr(node, "body", None)
        for part in body if isinstance(body, list) else ():
            if isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant) and isinstance(part.value.value, str):
                documentation.update(range(part.lineno, (part.end_lineno or part.lineno) + 1))
    found = tokenize.generate_tokens(io.StringIO(text).readline)
    return sum(token.type not in LAYOUT and token.start[0] not in documentation for token in found)


def test_documentation_and_layout_count_nothing() -> None:
    text = '"""Module."""\n\n# note\nx = 1\n"""About x."""\n\n\ndef f(\n    a,\n):\n    """Return a."""\n    return a\n'
    assert tokens(text) == len(["x", "=", "1", "def", "f", "(", "a", ",", ")", ":", "return", "a"])


def test_every_package_is_within_its_budget() -> None:
    budgets = tomllib.loads(Path(__file__).with_name("budget.toml").read_text(encoding="utf-8"))
    sizes = collections.Counter[str]()
    for path in PACKAGE.rglob("*.py"):
        folder = path.relative_to(PACKAGE).parts[0]
        sizes["" if folder.endswith(".py") else folder] += tokens(path.read_text(encoding="utf-8"))
    assert sizes.keys() == budgets.keys()
    assert {name: size for name, size in sizes.items() if size > budgets[name]} == {}
