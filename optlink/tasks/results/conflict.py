"""The sentence that states which limits exclude each other, and what is possible instead.

Values that are possible are rounded away from the limit value, so that a limit with the printed value is feasible.
"""

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context

from optlink.solvers.solution import Relaxation

MARGIN = 1e-6  # relative margin of a printed value: relaxations are found to about this accuracy
ROUNDING = 1e-12  # share of the limit value below which a relaxed value is zero
DIGITS = 4
SENSES = {">=": "at least ", "<=": "at most ", "=": ""}
OPPOSITE = 180.0  # deg, sum of two transmission angles at the same distance from 90 deg
PHRASES = (
    (r"swing angle of the (.+)", "{} of swing", r"the \1 swings {}"),
    (r"(?:smallest |largest )?(transmission angle.*)", r"{} of \1", r"the \1 falls to {}"),
    (r"((?:peak )?pressure angle.*)", r"a \1 of {}", r"the \1 rises to {}"),
    (r"coupler and rocker not in line", "{} between coupler and rocker", "the coupler and the rocker come within {} of a line"),
    (r"(.+) not aligned", r"{} from alignment at \1", r"the links at \1 come within {} of alignment"),
    (r"(\S+\.\S+)", r"\1 {}", r"\1 is {}"),
    (r"(.+)", r"\1 {}", r"the \1 is {}"),
)
"""Names of limits, how to name one with its value, and how to state the value that is possible."""
CONDITIONS = r".*<=.*|order of .+|points within one revolution|dead centre: .+|(?:order of )?end of a stroke.*"
"""Names of limits without a value that a designer knows."""


@dataclass(frozen=True)
class OpposedLimit:
    """A limit that conflicts with others, or both sides of a range: `sides`, each relaxed alone."""

    sides: tuple[Relaxation, ...]

    @property
    def name(self) -> str:
        """Name of the limit; of a range the last words that the names of both sides share."""
        words = [side.name.split()[::-1] for side in self.sides]
        pairs = itertools.takewhile(lambda pair: len(set(pair)) == 1, zip(*words, strict=False))
        return " ".join([word for word, *_ in pairs][::-1]) or self.sides[0].name

    @property
    def exact(self) -> bool:
        """Whether both sides of the range have the same value."""
        return len(self.sides) > 1 and self.sides[0].bound == self.sides[1].bound

    @property
    def quality(self) -> bool:
        """Whether it is a limit of the quality of transmission, which is named after what the linkage has to do."""
        return "transmission angle" in self.name or "pressure angle" in self.name

    @property
    def condition(self) -> bool:
        """Whether it is a condition without a value that a designer knows."""
        return re.fullmatch(CONDITIONS, self.name) is not None

    @property
    def satisfiable(self) -> bool:
        """Whether the other limits can be met if this one is relaxed."""
        return math.isfinite(self.sides[0].amount)

    @property
    def value(self) -> str:
        """Its value with the unit."""
        if self.exact:
            return f"exactly {self._words([self.sides[0].bound])}"
        return self._words([side.bound for side in self.sides])

    @property
    def named(self) -> str:
        """The limit with its value."""
        if self.condition:
            return f"the condition {self.name}"
        side = SENSES[self.sides[0].sense] if len(self.sides) == 1 else ""
        return self._phrases[0].replace("{}", f"{side}{self.value}")

    @property
    def possible(self) -> str:
        """Value with which the other limits can be met; of a condition the difference by which it is missed."""
        values = (
            [float(f"{self.sides[0].amount:.{DIGITS}g}")] if self.condition else [outward(side, DIGITS) for side in self.sides]
        )
        return f"{'about ' * self.sides[0].approximate}{self._words(values)}"

    @property
    def outcome(self) -> str:
        """What is possible if the other limits hold."""
        if self.condition:
            return f"the condition {self.name} is missed by {self.possible}"
        return self._phrases[1].replace("{}", self.possible)

    @property
    def instead(self) -> str:
        """The limit with the value that is possible if the other limits hold."""
        if not self.satisfiable:
            return self.named
        return f"{self.named} ({f'missed by {self.possible}' if self.condition else f'{self.possible} is possible'} otherwise)"

    @property
    def _phrases(self) -> tuple[str, str]:
        """How to name the limit and its outcome, with {} in place of the value."""
        pattern, named, outcome = next(phrase for phrase in PHRASES if re.fullmatch(phrase[0], self.name))
        if len(self.sides) > 1 and not self._symmetric:
            outcome = f"the {self.name} covers {{}}"
        elif self.sides[0].relaxed > self.sides[0].bound:
            outcome = outcome.replace("falls", "rises")
        else:
            outcome = outcome.replace("rises", "falls")
        return re.sub(pattern, named, self.name), re.sub(pattern, outcome, self.name)

    @property
    def _symmetric(self) -> bool:
        """Whether the sides are transmission angles at the same distance from 90 deg, of which one angle says both."""
        bounds = [side.bound for side in self.sides]
        return "transmission angle" in self.name and len(bounds) > 1 and math.isclose(sum(bounds), OPPOSITE)

    def _words(self, values: Sequence[float]) -> str:
        shown = values[:1] if self._symmetric else values
        return f"{' ... '.join(map(_number, shown))} {self.sides[0].unit}".rstrip()


def refutation(limits: Sequence[Relaxation], what: str = "linkage") -> str:
    """State which limits, each relaxed alone, exclude each other, and what is possible instead; empty without limits."""
    opposed = opposed_limits(limits)
    if not opposed:
        return ""
    if len(opposed) == 1:
        best = f"; {opposed[0].outcome} at best" if opposed[0].satisfiable else ""
        return f"No such {what}: {opposed[0].named} cannot be met{best}."
    if len(opposed) == 2:
        outcomes = "; ".join(f"with {_kept(opposed, k)} {limit.outcome}" for k, limit in enumerate(opposed) if limit.satisfiable)
        instead = f" {outcomes[:1].upper()}{outcomes[1:]}." if outcomes else ""
        return f"No such {what}: {opposed[0].named} and {opposed[1].named} exclude each other.{instead}"
    *names, last = [limit.instead for limit in opposed]
    return f"No such {what}: {', '.join(names)} and {last} exclude one another."


def _kept(opposed: Sequence[OpposedLimit], changed: int) -> str:
    """Name the limit that is kept while the other one changes, by its value alone if that is clear."""
    kept, other = opposed[1 - changed], opposed[changed]
    return kept.named if kept.condition or kept.value == other.value else kept.value


def opposed_limits(items: Sequence[Relaxation]) -> list[OpposedLimit]:
    """Return the limits that conflict, those of quality last; the two sides of each range that is relaxed are one."""
    groups: list[tuple[Relaxation, ...]] = []
    for item in items:
        pair = item.both_sides and groups and len(groups[-1]) == 1 and groups[-1][0].both_sides and groups[-1][0].key == item.key
        groups[-1:] = [(*groups[-1], item)] if pair else [*groups[-1:], (item,)]
    return sorted(map(OpposedLimit, groups), key=lambda limit: limit.quality)


def outward(side: Relaxation, digits: int) -> float:
    """Round a relaxed value to significant digits, away from its limit value."""
    if not math.isfinite(side.relaxed):
        return side.relaxed
    if abs(side.relaxed) <= ROUNDING * abs(side.bound):
        return 0.0
    up = side.relaxed > side.bound
    return rounded(side.relaxed + (MARGIN if up else -MARGIN) * abs(side.relaxed), digits, up)


def rounded(value: float, digits: int, up: bool) -> float:
    """Round a value to significant digits in one direction."""
    return float(Context(digits, ROUND_CEILING if up else ROUND_FLOOR).create_decimal_from_float(value))


def _number(value: float) -> str:
    """Format a value with at most six digits, without an exponent where none is needed."""
    return f"{float(f'{value:.6g}'):.10g}" if abs(value) >= 1e-4 else f"{value:.4g}"
