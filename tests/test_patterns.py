"""Every regular expression of the package answers soon, whatever text it is given."""

import ast
import importlib
import itertools
import re
import time
from pathlib import Path

import pytest

import optlink

ROOT = Path(optlink.__file__).parent
METHODS = ("compile", "match", "fullmatch", "search", "findall", "sub", "split", "finditer")
LETTERS = 250
ALLOWED = 0.2  # s of processor time; an ambiguous pattern takes seconds
BEGINS = ("", "1", "a", "1 ", "1/", "[", "=", "1..", "<1 ", "left of ")
PARTS = (
    *(" ", "a", "1", ".", "-", "e", "1.", "a ", "1 ", "1e", "*", "^", "m*", "1/", "'", '"', "(", ",", "1,", "=", "\t", "_", "\n"),
    *(
        "a-",
        "a.b",
        "<",
        "..",
        "x=",
        "#",
        "\n ",
        "to ",
        "%",
        ":",
        ";",
        "m2",
        "s^2*",
        "1,000,",
        "L1 1 ",
        "&",
        "a_b ",
        "|",
        "1'",
        "'a",
    ),
)
ENDS = ("!", "", "\0", "\n!")


def patterns():
    """Yield module, line, pattern and method of every regular expression that is known before a call."""
    for path in sorted(ROOT.rglob("*.py")):
        calls = [
            node
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in METHODS
            if isinstance(node.func.value, ast.Name) and node.func.value.id == "re"
        ]
        if not calls:
            continue
        module = importlib.import_module(".".join(path.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(".__init__"))
        for call in calls:
            texts = [call.args[0], *call.args[1:], *(keyword.value for keyword in call.keywords)]
            values = []
            for text in texts:
                try:
                    values.append(eval(compile(ast.Expression(text), path.name, "eval"), vars(module)))  # noqa: S307 - our own
                except (NameError, AttributeError):
                    values.append(None)
            if values[0] is not None:
                flags = sum((value for value in values if isinstance(value, re.RegexFlag)), re.RegexFlag(0))
                yield f"{module.__name__}:{call.lineno}", re.compile(values[0], flags)


def seconds(pattern, text):
    begin = time.process_time()
    pattern.fullmatch(text)
    pattern.search(text)
    return time.process_time() - begin


def attacks():
    for begin, part, end in itertools.product(BEGINS, PARTS, ENDS):
        yield begin + part * (LETTERS // len(part)) + end


def slow():
    found = list(patterns())
    assert len(found) > 50
    for place, pattern in found:
        binary = isinstance(pattern.pattern, bytes)
        for attack in attacks():
            text = attack.encode() if binary else attack
            if seconds(pattern, text) > ALLOWED and seconds(pattern, text) > ALLOWED:
                yield place, attack[:20], attack[-3:]
                break


@pytest.mark.slow
def test_no_pattern_is_ambiguous():
    assert list(slow()) == []


@pytest.mark.parametrize("count", [24, 150])
@pytest.mark.parametrize("part", ["a", "m2", "kg ", "m*", "m^2*"])
def test_a_long_unit_is_refused_at_once(part, count):
    begin = time.process_time()
    with pytest.raises(optlink.InputError, match="frame"):
        optlink.load("crank-rocker", {"mechanism.frame": f"1 {part * (count // len(part))}!"})
    assert time.process_time() - begin < 2.0
