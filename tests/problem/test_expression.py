"""The law language against Python's own arithmetic, and against everything that is not a law."""

from __future__ import annotations

import ast
import inspect
import math
import operator
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

from optlink.problem.targets import expression
from optlink.problem.targets.expression import CONSTANTS, FUNCTIONS, MAX_CHARACTERS, MAX_DEPTH, LawError, parse
from tests.tiers import examples

NAMES = ("phi", "phi0", "psi0")
HERE = {"phi": 1.3, "phi0": 0.7, "psi0": 2.1}
phi, phi0, psi0, pi = HERE["phi"], HERE["phi0"], HERE["psi0"], math.pi

seeded = examples(300)


def value(text: str, **changes: object) -> object:
    return parse(text, NAMES)({**HERE, **changes})


# --- values --------------------------------------------------------------------------------------------------------

BY_HAND = [
    *(("1", 1.0), ("1.", 1.0), (".5", 0.5), ("2.5e-3", 2.5e-3), ("1E3", 1000.0), ("  7\t\n", 7.0), ("pi", pi), ("phi", phi)),
    *(("1 + 2*3", 7.0), ("(1 + 2)*3", 9.0), ("1 - 2 - 3", -4.0), ("1 - (2 - 3)", 2.0), ("12/3/2", 2.0), ("12/(3/2)", 8.0)),
    *(("12/3*2", 8.0), ("2*3^2", 18.0), ("(2*3)^2", 36.0), ("2^3^2", 512.0), ("(2^3)^2", 64.0), ("2**3**2", 512.0)),
    *(("2^-1", 0.5), ("2^-1^2", 0.5), ("2^-(1 + 1)", 0.25), ("2^-1*3", 1.5), ("2^+2", 4.0), ("-2^2", -4.0), ("(-2)^2", 4.0)),
    *(("(-2)^3", -8.0), ("-2^-2", -0.25), ("--3", 3.0), ("-+-3", 3.0), ("+3", 3.0), ("3--2", 5.0), ("3+-2", 1.0)),
    *(("2*-3", -6.0), ("-2*3", -6.0), ("-2*-3", 6.0), ("2/-4*-2", 1.0), ("6/2*(1+2)", 9.0), ("phi-phi0", phi - phi0)),
    ("psi0 + 2/(3*pi)*(phi - phi0)^2", psi0 + 2 / (3 * pi) * (phi - phi0) ** 2),
    *(("psi0+2/(3*pi)*(phi-phi0)**2", psi0 + 2 / (3 * pi) * (phi - phi0) ** 2), ("-phi^2", -(phi**2)), ("phi^0.5", phi**0.5)),
    *(("phi^phi0^psi0", phi ** (phi0**psi0)), ("sin(phi)^2 + cos(phi)^2", 1.0)),
    *(("sin(cos(tan(0.3)))", math.sin(math.cos(math.tan(0.3)))), ("-sin(phi)", -math.sin(phi))),
    *(("2^sin(phi)", 2 ** math.sin(phi)), ("sin(phi)^-2", math.sin(phi) ** -2), ("sin(-phi)", math.sin(-phi))),
    *(("sin (phi)", math.sin(phi)), ("asin(0.3) + acos(0.3)", pi / 2), ("atan(1)*4", pi), ("sinh(1) + cosh(1)", math.e)),
    *(("tanh(0.5)", math.tanh(0.5)), ("exp(log(phi))", phi), ("log10(1000)", 3.0), ("sqrt(2)*sqrt(2)", 2.0)),
    *(("abs(-3) - abs(3)", 0.0), ("((((phi))))", phi), ("1e2", 100.0)),
]


@pytest.mark.parametrize(("text", "expected"), BY_HAND, ids=[text for text, _ in BY_HAND])
def test_values_agree_with_hand_calculation(text, expected):
    np.testing.assert_allclose(value(text), expected, rtol=1e-14, atol=1e-15)


def test_arrays_broadcast():
    computed = value("psi0 + (phi - phi0)^2", phi=np.array([1.0, 2.0, 3.0]), phi0=np.array([[0.5], [1.5]]))
    np.testing.assert_allclose(computed, [[2.35, 4.35, 8.35], [2.35, 2.35, 4.35]], rtol=1e-14)


@pytest.mark.parametrize("text", ["1/(phi - phi0)", "sqrt(phi - 2)", "phi0*(2 - 2)", "0/3*phi", "(1/2)^-1 - phi", "-phi/-2"])
def test_constants_of_a_law_that_has_values_somewhere_are_finite(text):
    assert parse(text, NAMES).constants_finite


@pytest.mark.parametrize("text", ["phi*(1/0)", "phi/(2 - 2)", "sin(log(-1)) + phi", "phi^0/0", "0^-1"])
def test_constants_without_a_finite_value_are_detected(text):
    assert not parse(text, NAMES).constants_finite


def test_names_are_those_that_are_used():
    assert parse("phi + sin(phi0)*pi", NAMES).names == {"phi", "phi0"}
    assert parse("1 + pi", NAMES).names == frozenset()
    assert parse("x*y", ["x", "y", "z"]).names == {"x", "y"}
    assert parse("phi", NAMES).text == "phi"


@pytest.mark.parametrize("text", ["1/0", "log(-1)", "sqrt(-2)", "0^-1", "exp(1000)", "asin(2)", "(-8)^(1/3)", "0/0", "log(0)"])
def test_undefined_values_are_not_finite_and_give_no_warning(text):
    """Warnings are errors here."""
    assert not np.isfinite(value(text))
    assert not np.isfinite(value(f"0*phi + {text}", phi=np.array([1.0, 2.0]))).any()


# --- random expressions, evaluated twice ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Tree:
    """An expression as Python computes it, and as it is written with no bracket more than needed.

    `level` is how tightly its outermost operation binds: 1 sum, 2 product, 3 sign, 4 power, 5 anything in one piece.
    """

    text: str
    level: int
    value: np.float64

    def within(self, least: int) -> str:
        return self.text if self.level >= least else f"({self.text})"


LEAVES = [Tree(name, 5, np.float64(v)) for name, v in {**HERE, "pi": pi}.items()]
PYTHON: dict[str, Callable] = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv}
MATH: dict[str, Callable[[float], float]] = {
    **{name: getattr(math, name) for name in FUNCTIONS if hasattr(math, name)},
    "abs": abs,
}


def quietly(function: Callable, *arguments: float) -> np.float64:
    """Python's own value; NaN where Python raises."""
    try:
        computed = function(*map(float, arguments))
    except (ArithmeticError, ValueError):
        computed = math.nan
    return np.float64(math.nan if isinstance(computed, complex) else computed)


def number(x: float) -> Tree:
    return Tree(f"{x:.6g}", 5, np.float64(f"{x:.6g}"))


def negative(a: Tree) -> Tree:
    return Tree(f"-{a.within(3)}", 3, -a.value)


def called(name: str, a: Tree) -> Tree:
    return Tree(f"{name}({a.text})", 5, quietly(MATH[name], a.value))


def joined(sign: str, space: str, a: Tree, b: Tree) -> Tree:
    level = 1 if sign in "+-" else 2
    # equal operations are read from the left, so the right one needs brackets; a sign may follow an operator
    text = f"{a.within(level)}{space}{sign}{space}{b.within(level + 1)}"
    return Tree(text, level, quietly(PYTHON[sign], a.value, b.value))


def raised(sign: str, a: Tree, b: Tree) -> Tree:
    # read from the right: the base in one piece, the exponent a power or a sign without brackets
    return Tree(f"{a.within(5)}{sign}{b.within(3)}", 4, quietly(operator.pow, a.value, b.value))


leaves = st.sampled_from(LEAVES) | st.builds(number, st.floats(0.0, 20.0))
trees = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.builds(negative, inner),
        st.builds(called, st.sampled_from(sorted(FUNCTIONS)), inner),
        st.builds(joined, st.sampled_from("+-*/"), st.sampled_from(["", " "]), inner, inner),
        st.builds(raised, st.sampled_from(["^", "**", " ^ "]), inner, inner),
    ),
    max_leaves=12,
)


def differs(tree: Tree) -> bool:
    if math.isnan(tree.value):  # where Python raises, the kind of the missing value is not compared
        return False
    return not math.isclose(float(value(tree.text)), tree.value, rel_tol=1e-9, abs_tol=1e-12)


@seeded
@given(trees)
@example(raised("^", negative(LEAVES[0]), number(2.0)))
@example(raised("^", LEAVES[0], negative(raised("^", LEAVES[1], number(2.0)))))
@example(joined("-", "", LEAVES[0], negative(joined("-", "", LEAVES[1], LEAVES[2]))))
def test_random_expressions_agree_with_python(tree):
    assert not differs(tree), (tree.text, tree.value, value(tree.text))


@pytest.mark.slow
def test_random_expressions_are_mostly_finite_and_of_every_kind():
    """The property above would be empty if its expressions had no value, or used no operator."""
    seen: list[Tree] = []

    @settings(derandomize=True, deadline=None, max_examples=300, database=None)
    @given(trees)
    def collect(tree: Tree) -> None:
        seen.append(tree)

    collect()
    finite = [tree for tree in seen if math.isfinite(tree.value) and len(tree.text) > 4]
    assert len(finite) > 80
    text = " ".join(tree.text for tree in finite)
    assert all(sign in text for sign in ["+", "-", "*", "/", "^", "**", "(", "sin(", "sqrt(", "phi0", "pi"])


@pytest.mark.parametrize(
    ("sign", "wrong"),
    [("-", np.add), ("/", np.multiply), ("^", lambda a, b: np.power(b, a)), ("*", lambda a, b: 1.0000001 * a * b)],
)
def test_comparison_detects_a_wrong_operator(sign, wrong, monkeypatch):
    a, b = LEAVES[:2]
    tree = raised("^", a, b) if sign == "^" else joined(sign, "", a, b)
    assert not differs(tree)
    monkeypatch.setitem(expression._BINARY, sign, wrong)
    assert differs(tree)


@pytest.mark.parametrize(
    ("sign", "powers"),
    [("-", (10, 10)), ("/", (20, 20)), ("^", (40, 41)), ("^", (25, 24)), ("*", (5, 6))],
    ids=["minus from the right", "over from the right", "power from the left", "power below sign", "times below plus"],
)
def test_comparison_detects_a_wrong_precedence(sign, powers, monkeypatch):
    a, b, c = LEAVES[:3]
    chained = {
        "-": joined("-", "", joined("-", "", a, b), c),
        "/": joined("/", "", joined("/", "", a, b), c),
        "^": joined("*", "", raised("^", a, raised("^", b, c)), negative(raised("^", b, number(2.0)))),
        "*": joined("+", "", joined("*", "", a, b), c),
    }[sign]
    assert not differs(chained)
    monkeypatch.setitem(expression._POWER, sign, powers)
    assert differs(chained)


# --- what is not a law ---------------------------------------------------------------------------------------------

NO_LAWS = {  # what the message must say, of which texts
    "ends too early": ["", "   ", "phi +", "phi *", "phi ^", "-", "sin("],
    "not expected": [
        *("()", "* phi", "phi * / 2", "phi ^^ 2", "phi * * 2", "phi *** 2", "phi)", ")phi(", "sin()", "2 phi", "2pi"),
        *("2(phi)", "phi(2)", "1.2.3", "1e", "0x10", "1_000", "phi if 1 else 2", "phi and 1", "phi // 2"),
    ],
    "not closed": ["(phi", "((phi)", "sin(phi"],
    "in brackets": ["sin", "sin phi", "sin*2"],
    "does not belong": [
        *("sin(phi, 2)", "lambda: 0", "phi.real", "phi.__class__", "phi[0]", "'phi'", '"phi"', "phi; phi", "phi = 1"),
        *("phi == 1", "phi < 1", "{phi}", "phi % 2", "phi & 1", "~phi", "phi!", "phi \\ 2", "#phi", "phi # + 1", "1,5"),
        *("φ - φ0", "π", "phi²", "phi − phi0", "phi · 2", "٣ + phi", "２ + phi", "phi\0", "phi\u200b+ 1", "😀"),
    ],
    "too large": ["1e999"],
    "unknown": ["psi", "Phi", "x", "inf", "nan", "eval(1)", "__import__('os')", "__import__", "__builtins__", "lambda x: x"],
}


@pytest.mark.parametrize(("says", "text"), [(says, text) for says, texts in NO_LAWS.items() for text in texts])
def test_invalid_laws_are_refused_with_a_remedy(text, says):
    with pytest.raises(LawError) as caught:
        parse(text, NAMES)
    assert says in caught.value.message
    assert len(caught.value.remedy) > 8
    assert len(str(caught.value)) < 400
    assert caught.value.remedy in str(caught.value)


@pytest.mark.parametrize(
    ("text", "culprit"),
    [("phi + $ 2", '"$"'), ("phi + psi2", '"psi2"'), ("  @", '"@"'), ("phi\u00a0+ 1", '"\u00a0"'), ("\u2003phi", '"\u2003"')],
)
def test_message_shows_the_faulty_part(text, culprit):
    with pytest.raises(LawError) as caught:
        parse(text, NAMES)
    assert culprit in caught.value.message


def test_message_for_an_unknown_name_lists_the_known_ones():
    with pytest.raises(LawError) as caught:
        parse("psi0 + ph0", NAMES)
    assert all(name in caught.value.remedy for name in (*NAMES, *CONSTANTS, *FUNCTIONS))
    assert 'Did you mean "phi0"?' in caught.value.remedy


@pytest.mark.parametrize(
    "text",
    ["psi0 + |x*2", "|x", "2*(phi +\t|x)", "phi |phi0", "1 + |$", "|sin", "|sin phi", "sin(|)", "1 + |(phi*2", "1 + |1e999"],
)
def test_message_states_the_column(text):
    """The bar marks where the culprit begins; columns count from 1."""
    column = text.index("|") + 1
    with pytest.raises(LawError, match=rf"\(column {column}\)"):
        parse(text.replace("|", ""), NAMES)


def test_length_and_depth_limits_agree_with_their_messages():
    depth = MAX_DEPTH - 1
    assert value("(" * depth + "1" + ")" * depth) == 1.0
    with pytest.raises(LawError, match="nested"):
        parse("(" * (MAX_DEPTH + 1) + "1" + ")" * (MAX_DEPTH + 1), NAMES)
    longest = "1+" * (MAX_CHARACTERS // 2 - 1) + "1"
    assert value(longest) == MAX_CHARACTERS // 2
    with pytest.raises(LawError, match="characters"):
        parse(longest + " " * 10, NAMES)


@pytest.mark.slow
@seeded
@given(st.text(alphabet="()+-*/^. \t0123456789eEphisn_,;'\"[]{}πφ²", max_size=40) | st.text(max_size=60))
def test_any_text_is_a_law_or_a_law_error(text):
    try:
        law = parse(text, NAMES)
    except LawError as error:
        law, words = None, (error.message, error.remedy)
    if law is None:
        assert all(words)
    else:
        assert np.shape(law({**HERE, "phi": np.ones(3)})) in ((), (3,))


def test_expressions_are_not_evaluated_by_python():
    def guilty(source: str) -> list[str]:
        result = []
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Call):
                called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                of = getattr(getattr(node.func, "value", None), "id", "")
                if called in {"eval", "exec", "literal_eval", "__import__"} or (called == "compile" and of != "re"):
                    result.append(called)
            if isinstance(node, ast.Import | ast.ImportFrom):
                result += [alias.name for alias in node.names if alias.name in {"ast", "builtins", "importlib", "literal_eval"}]
        return result

    assert guilty(inspect.getsource(expression)) == []
    planted = ["eval('1')", "exec('1')", "compile('1', '', 'eval')", "import ast", "ast.literal_eval('1')", "b.eval('1')"]
    assert all(guilty(source) for source in planted)


# --- hazards -------------------------------------------------------------------------------------------------------

GRID = np.linspace(0.0, 1.5, 16)  # 0.1 apart

HAZARDS = {  # at one of the values, between two of them, everywhere
    "divides by zero": ["1/(phi - 0.55)", "1/(phi - 0.5)", "2/(0.3 - phi)^3", "1/(phi*0)", "1/sin(4*phi)", "phi + 1/0"],
    "pole of tan": ["tan(phi + 1)", "tan(3*phi)*0"],
    "zero to a negative power": ["(phi - 0.55)^-1", "(phi - 0.55)^-2", "0^-1", "(phi - phi)^-1"],
    "no finite real value": [
        *("log(phi - 0.55)", "log10(-phi)", "log(phi)", "sqrt(phi - 0.5)", "(phi - 0.5)^0.5", "asin(phi)", "acos(phi)"),
        *("exp(1000*phi)", "phi*10^308*10^10"),
    ],
}


@pytest.mark.parametrize(("says", "text"), [(says, text) for says, texts in HAZARDS.items() for text in texts])
def test_hazards_are_found(text, says):
    computed = parse(text, NAMES).hazards({**HERE, "phi": GRID})
    assert computed is not None
    assert says in computed


@pytest.mark.parametrize(
    "text",
    [
        *("psi0 + 2/(3*pi)*(phi - phi0)^2", "1/(phi + 0.1)", "1/(phi - 2)", "tan(phi)", "tan(phi + 2)", "phi^2"),
        *("(phi - 0.55)^3", "(phi - 0.55)^0", "(phi + 1)^-2", "log(phi + 0.1)", "sqrt(phi)", "abs(phi - 0.55)"),
        *("asin(phi/2)", "1", "psi0", "exp(phi)/exp(-phi)"),
    ],
)
def test_harmless_laws_have_no_hazard(text):
    law = parse(text, NAMES)
    assert law.hazards({**HERE, "phi": GRID}) is None
    assert np.isfinite(law({**HERE, "phi": GRID})).all()


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("psi0 + 0,35*phi", "Write decimals with a point"),
        ("psi0 + 0.35.*phi", "Write * / ^ without a point before them"),
        ("psi = 0.35*phi", "Write what is on the right of ="),
        ("psi0 + sin(30\N{DEGREE SIGN})", "Angles are in radians: write 30*pi/180"),
        ("0.35*\N{GREEK SMALL LETTER PHI}", "Write phi"),
        ("law.csv", 'Write law = { csv = "law.csv" }'),
        ("phi % 2", "A law has numbers"),
    ],
)
def test_the_remedy_for_a_character_of_another_notation(text: str, remedy: str) -> None:
    with pytest.raises(LawError) as error:
        parse(text, ("phi", "psi", "psi0"))
    assert error.value.remedy.startswith(remedy)
