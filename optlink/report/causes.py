"""Why a design is not valid, in words: what was measured, and what is required."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from optlink.report.format import number
from optlink.validation.check import Check

if TYPE_CHECKING:
    from optlink.tasks.results.design import LinkageDesign

KEY = r"(?:[\w.]+: )?"
MEASURED = (
    (r"swing angle, (?:least|largest)", "the rocker swings {}"),
    (KEY + r"stroke of (.+)", r"the stroke of \1 is {}"),
    (KEY + r"(?:least|smallest) transmission angle( at .+)?", r"the transmission angle\1 falls to {}"),
    (KEY + r"largest transmission angle( at .+)?", r"the transmission angle\1 rises to {}"),
    (KEY + r"(?:peak|largest) pressure angle( at .+)?", r"the pressure angle\1 rises to {}"),
    (r"(.+) off alignment over .+", r"the angle of \1 from alignment falls to {}"),
    (r"(.+) within its bounds", r"\1 is {}"),
    (r"(.+), (?:least|largest)", r"the \1 is {}"),
)
"""Names of measured limits, and how to state the value; the limit follows."""
OTHERS = (
    (r"Grashof: .+|the crank turns fully", "the crank cannot turn fully"),
    (r"link lengths re-measured in motion", "the links do not meet in every position"),
    (r"one branch: .+", "the linkage leaves its assembly mode"),
    (r"one circuit: .+", "the linkage does not reach all positions in one motion"),
    (r"no singular position .+", "the mechanism passes a singular position"),
    (r"the linkage has a position for every target", "the linkage does not reach every target"),
    (r"output error has a value everywhere", "the linkage does not reach every position"),
    (r"points met in order", "the points are not met in order"),
    (r"points met within one revolution", "the points are not met within one revolution"),
    (r"points met within their tolerances", "a point is missed by {} times its tolerance"),
    (r"all limits met \(scaled\)", "a limit is missed by {} of the scale"),
    (r"optimality .+", "the search ended before an optimum"),
    (r"objective measured in motion", "the objective differs from that measured in motion by {}"),
)
"""Names of other checks, and how to state that they fail."""
GENERAL = (KEY + r"(.+)", r"\1 is {}")
TURNS = OTHERS[0][0]
SIDES = {">=": "at least ", "<=": "at most ", "=": "", "": ""}
LIMIT = re.compile(r"(>=|<=|=|)\s*([-+]?\d\S*(?: \.\.\. \S+)?)")


def causes(checks: Sequence[Check]) -> list[str]:
    """Return why a design is not valid, one text for each failed check that is no consequence of others.

    Where the crank cannot turn, that is the cause; checks without a value follow from others that have one. Two checks with the
    same limit prescribe a value.
    """
    failed = [check for check in checks if not check.passed]
    turns = [check for check in failed if re.fullmatch(TURNS, check.name)]
    valued = [check for check in failed if math.isfinite(check.value)]
    return list(dict.fromkeys(_cause(check, checks) for check in turns or valued or failed))


def why_invalid(checks: Sequence[Check], otherwise: str) -> str:
    """Return the first cause why a design is not valid, and the number of others; `otherwise` if every check passed."""
    first, *others = causes(checks) or [otherwise]
    more = f"; {len(others)} more check{'s fail' if len(others) > 1 else ' fails'}" if others else ""
    return f"{first}{more}"


def marked(title: str, design: LinkageDesign, refuted: str) -> list[str]:
    """Return the lines of a picture's title; the second one says why a design is not valid.

    That is which limits exclude each other (`refuted`), or the first cause.
    """
    if design.valid:
        return [title]
    return [title, refuted or f"NOT VALID: {why_invalid(design.validation.checks, design.status.text)}"]


def _cause(check: Check, checks: Sequence[Check]) -> str:
    value = f"{number(check.value, 4)} {check.unit}".rstrip()
    for name, words in OTHERS:
        if re.fullmatch(name, check.name):
            return words.replace("{}", number(check.value, 3))
    limit = LIMIT.fullmatch(check.limit)
    if limit is None or not math.isfinite(check.value):
        return f"it fails the check of {check.name}"
    name, words = next(pair for pair in (*MEASURED, GENERAL) if re.fullmatch(pair[0], check.name))
    match = re.fullmatch(name, check.name)
    assert match is not None
    sides = {one.limit.partition(" ")[0] for one in checks if one.limit.partition(" ")[2] == limit[2]}
    prescribed = sides >= {">=", "<="}  # the same value limits from below and from above
    required = f"{'' if prescribed else SIDES[limit[1]]}{limit[2]} {check.unit}".rstrip()
    return f"{match.expand(words).replace('{}', value)}, {required} {'are' if check.unit else 'is'} required"
