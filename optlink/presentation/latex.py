"""Tables of results for LaTeX, with the rules of the package booktabs."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence

from optlink.presentation.columns import in_units
from optlink.presentation.format import pretty
from optlink.presentation.table_spec import Part, TableSpec

SIGNS = {
    **{sign: rf"\{sign}" for sign in "&%$#_{}"},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    **{"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", '"': r"\textquotedbl{}"},
    **{"²": r"\textsuperscript{2}", "³": r"\textsuperscript{3}", "°": r"\textdegree{}", "·": r"\textperiodcentered{}"},
    **{"≤": r"$\leq$", "≥": r"$\geq$", "→": r"$\rightarrow$", "−": "$-$", "–": "--", "…": r"\dots{}", "µ": r"\textmu{}"},
}
"""Letters that LaTeX reads as commands, or that its fonts lack, by what prints them."""
DIGITS = 5  # significant digits of numbers in columns


def escaped(text: str) -> str:
    """Return a text that LaTeX prints as it is."""
    return "".join(SIGNS.get(letter, letter) for letter in text)


def columns_to_latex(table: Mapping[str, Iterable[float | str]], units: Mapping[str, str]) -> str:
    """Return a table of columns by name, in other units than SI, with the units in its head."""
    columns = [in_units(key, values, units) for key, values in table.items()]
    heads = [f"{escaped(one.name)}{f' [{escaped(pretty(one.unit))}]' if one.unit else ''}" for one in columns]
    alignment = "".join("l" if any(isinstance(value, str | bool) for value in one.values) else "r" for one in columns)
    return _tabular(alignment, heads, zip(*(_cells(one.values) for one in columns), strict=True))


def parts_to_latex(parts: Iterable[Part]) -> str:
    """Return the tables of a summary that are not in the appendix, below their titles; units stand in heads or beside values."""
    texts = []
    for spec in (part for part in parts if isinstance(part, TableSpec) and not part.appendix and part.rows):
        heads = [_line(column.name) for column in spec.columns] if spec.header else []
        alignment = "".join("r" if column.right else "l" for column in spec.columns)
        rows = ([_line(span.text) for span in row] for row in spec.rows)
        texts.append(_tabular(alignment, heads, rows, title=_line(spec.title)))
    return "\n".join(texts)


def _line(text: str) -> str:
    """Return a text with its signs for a cell, in one line."""
    return escaped(re.sub(r"\s*\n\s*", "; " if re.search(r"\d\n", text) else " ", pretty(text)))


def _cells(values: Sequence[float | str]) -> list[str]:
    """Format a column with one number of decimals; a dash for what is not finite, a text as it is."""
    if any(isinstance(value, str | bool) for value in values):
        return [_line(str(value)) for value in values]
    finite = [float(value) for value in values if math.isfinite(float(value))]
    power = math.floor(math.log10(max(map(abs, finite), default=0.0) or 1.0))
    factor = 0 if -3 <= power <= DIGITS or all(map(float.is_integer, finite)) else power
    texts = [f"{value / 10.0**factor:z.{max(0, DIGITS - 1 + factor - power)}f}" for value in finite]
    while texts and all("." in text and text[-1] in ".0" for text in texts):  # digits that no number of the column needs
        texts = [text[:-1] for text in texts]
    end, rest = rf" \cdot 10^{{{factor}}}$" if factor else "$", iter(texts)
    return [f"${next(rest)}{end}" if math.isfinite(float(value)) else "--" for value in values]


def _tabular(alignment: str, heads: Sequence[str], rows: Iterable[Sequence[str]], title: str = "") -> str:
    lines = [rf"\begin{{tabular}}{{{alignment}}}", r"\toprule"]
    lines += [rf"\multicolumn{{{len(alignment)}}}{{l}}{{\textbf{{{title}}}}} \\", r"\midrule"] if title else []
    lines += [" & ".join(heads) + r" \\", r"\midrule"] if heads else []
    lines += [" & ".join(row) + r" \\" for row in rows]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])
