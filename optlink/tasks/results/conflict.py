"""The sentence that states which limits exclude each other, and what is possible instead.

Values that are called possible are rounded away from the limit value, so that a limit with the printed value is feasible; what
is reached is rounded to the nearest.
"""

import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from typing import NamedTuple

from optlink.linkage.dyads import RRP
from optlink.linkage.fourbar import LENGTHS, InnerFourBar, inner_four_bars, whole_four_bar
from optlink.linkage.mechanism import FRAME, Link, Mechanism
from optlink.linkage.singular import LEAST_LENGTH_MARGIN, SMALLEST_LENGTH_MARGIN
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import Quantity
from optlink.solvers.solution import SAME_OBJECTIVE, LimitState, Relaxation
from optlink.units import percent

MARGIN = 1e-6  # relative margin of a printed value: relaxations are found to about this accuracy
ROUNDING = 1e-12  # share of the limit value below which a relaxed value is zero
DIGITS = 4
SENSES = {">=": "at least ", "<=": "at most ", "=": ""}
OPPOSITE = 180.0  # deg, sum of two transmission angles at the same distance from 90 deg
SWING = "swing angle of the "  # begins the name of the limit of a four-bar
LARGER_SWING = "A six-bar swings further: optlink new large-swing."
PHRASES = (
    (f"{SWING}(.+)", "{} of swing", r"the \1 swings {}"),
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
    def short_of_swing(self) -> bool:
        """Whether it asks for more swing of a lever than the other limits leave."""
        return self.name.startswith(SWING) and self.sides[0].relaxed < self.sides[0].bound

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
        return self._about(lambda side: outward(side, DIGITS))

    def _about(self, rounding: Callable[[Relaxation], float]) -> str:
        values = [nearest(self.sides[0].amount, DIGITS)] if self.condition else [rounding(side) for side in self.sides]
        return f"{'about ' * self.sides[0].approximate}{self._words(values)}"

    @property
    def outcome(self) -> str:
        """What is possible if the other limits hold."""
        if self.condition:
            return f"the condition {self.name} is missed by {self.possible}"
        return self._phrases[1].replace("{}", self._about(reached))

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
    further = f" {LARGER_SWING}" * any(limit.short_of_swing for limit in opposed)
    if len(opposed) == 2:
        outcomes = "; ".join(f"with {_kept(opposed, k)} {limit.outcome}" for k, limit in enumerate(opposed) if limit.satisfiable)
        instead = f" {outcomes[:1].upper()}{outcomes[1:]}." if outcomes else ""
        return f"No such {what}: {opposed[0].named} and {opposed[1].named} exclude each other.{instead}{further}"
    *names, last = [limit.instead for limit in opposed]
    return f"No such {what}: {', '.join(names)} and {last} exclude one another.{further}"


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


def reached(side: Relaxation) -> float:
    """Round a relaxed value to the nearest, with as many digits as tell it from its limit value."""
    values = (nearest(side.relaxed, digits) for digits in range(DIGITS, 7))
    return next((value for value in values if value != side.bound), outward(side, 6))


def nearest(value: float, digits: int) -> float:
    """Round a value to significant digits."""
    return float(f"{value:.{digits}g}")


def rounded(value: float, digits: int, up: bool) -> float:
    """Round a value to significant digits in one direction."""
    return float(Context(digits, ROUND_CEILING if up else ROUND_FLOOR).create_decimal_from_float(value))


def _number(value: float) -> str:
    """Format a value with at most six digits, without an exponent where none is needed."""
    return f"{float(f'{value:.6g}'):.10g}" if abs(value) >= 1e-4 else f"{value:.4g}"


# Bounds that let no crank turn: the inequality of Grashof that fails for all sizes, and which bound to change.

SHORTEST = {"full rotation": ("crank",), "double-crank": ("frame",), "": ("crank", "frame")}
"""Possible shortest links by `limits.crank`; empty: without this limit."""
INSIDE = 1e-4  # share of the longest link by which a changed bound goes beyond the least change, at first


class Length(NamedTuple):
    """A length between two bounds [m], with its name for display."""

    name: str
    low: float
    high: float
    free: bool = True


class Violation(NamedTuple):
    """An inequality sum(`left`) <= sum(`right`) of link lengths that no sizes within the bounds satisfy; `excess` [m]."""

    left: tuple[str, ...]
    right: tuple[str, ...]
    excess: float


Loop = Mapping[str, Length]  # by the names of `LENGTHS`


def cannot_turn(quantities: Mapping[str, Quantity], mechanism: Mechanism, crank: str, least_angle: float) -> tuple[str, ...]:
    """Return a sentence that no sizes within the bounds let the crank turn, with the change that does; else nothing.

    The first loop of the mechanism decides: crank, a link, and a link or slider on the frame. `quantities` are the dimensions,
    `crank` is `limits.crank` of the problem, empty if it has none; `least_angle` [rad] is the least angle of the two links of a
    joint off alignment.
    """
    if crank not in SHORTEST:
        return ()
    inversion = "" if whole_four_bar(mechanism) is None else crank
    loops = {four_bar.joint: four_bar for four_bar in inner_four_bars(mechanism)}
    for group in mechanism.groups:
        reason = ""
        if group.joint in loops and (loop := _four_bar(loops[group.joint], quantities)) is not None:
            reason = four_bar_conflict(loop, inversion, least_angle)
        elif isinstance(group, RRP):
            reason = _slider_conflict(group, mechanism, quantities, least_angle)
        if reason:
            span = ', or write limits.crank = "span"' * bool(crank)
            return (f"no sizes within the bounds let the crank turn: {reason}{span}",)
    return ()


def _length(link: Link, ends: set[str], quantities: Mapping[str, Quantity]) -> Length | None:
    """Return the length of a link between two of its joints; None if it is not one quantity."""
    quantity = quantities.get(str(link.length)) if {link.start, link.end} == ends else None
    return None if quantity is None else Length(link.body, *quantity.bounds, quantity.free)


def _four_bar(four_bar: InnerFourBar, quantities: Mapping[str, Quantity]) -> Loop | None:
    """Return the lengths of a four-bar; None if they are not those of its links."""
    places = (four_bar.frame_length,) if four_bar.frame_length else four_bar.ground
    if not four_bar.plain or not {*four_bar.names, *places} <= quantities.keys():
        return None
    bodies = (link.body for link in (four_bar.crank, four_bar.coupler, four_bar.rocker))
    each = ((body, quantities[name]) for body, name in zip(bodies, four_bar.names, strict=True))
    low, high = four_bar.frame_bounds({name: quantity.bounds for name, quantity in quantities.items()})
    frame = four_bar.frame_length or f"distance {four_bar.crank.start}-{four_bar.ground_pin}"
    lengths = [Length(body, *quantity.bounds, quantity.free) for body, quantity in each]
    return dict(zip(LENGTHS, [*lengths, Length(frame, low, high, any(quantities[name].free for name in places))], strict=True))


def _slider_conflict(group: RRP, mechanism: Mechanism, quantities: Mapping[str, Quantity], least_angle: float) -> str:
    """Return why the crank of a slider-crank cannot turn: crank and offset are longer than the rod; else an empty text."""
    (pin, guide), crank = group.outer, mechanism.crank
    own = crank.end == pin and guide.on == FRAME and guide.through == crank.start and guide.tilt == 0.0
    short, rod = (_length(link, {link.start, link.end}, quantities) for link in (crank, group.first))
    offset = quantities.get(str(guide.offset))
    if not own or short is None or rod is None or {group.first.start, group.first.end} != {pin, group.inner}:
        return ""
    low, high = (0.0, 0.0) if offset is None else offset.bounds
    aside = max(0.0, low, -high)
    if short.low + aside <= rod.high:
        return ""
    lengths = f"{short.name} {1e3 * short.low:.6g}" + f" + offset {1e3 * aside:.6g}" * (aside > 0.0)
    longer = _outward((short.low + aside) / math.cos(least_angle) * (1.0 + INSIDE), True)
    return f"{lengths} > {rod.name} {1e3 * rod.high:.6g} mm. Allow a {rod.name} of at least {1e3 * longer:.6g} mm"


def four_bar_conflict(loop: Loop, crank: str, least_angle: float) -> str:
    """Return which inequality of Grashof fails for all sizes, and the change that helps; empty if none does."""
    missed = [(shortest, violation) for shortest in SHORTEST[crank] if (violation := _violation(loop, shortest)) is not None]
    if len(missed) < len(SHORTEST[crank]):
        return ""
    ways = [(_remedies(loop, shortest, least_angle), violation) for shortest, violation in missed]
    remedies, violation = min(ways, key=lambda way: len(way[0]) or len(LENGTHS))
    remedy = f"Allow {' and '.join(remedies)}" if remedies else "Widen several bounds"
    return f"{_inequality(violation, loop)}. {remedy}"


def _violation(loop: Loop, shortest: str) -> Violation | None:
    """Return the inequality that fails for all sizes; the simplest one, else the one missed by most."""
    others = [name for name in LENGTHS if name != shortest]
    for count in (1, 2):
        found = []
        for right in itertools.combinations(others, count):
            left = (shortest, *(name for name in others if count == 2 and name not in right))
            excess = sum(loop[name].low for name in left) - sum(loop[name].high for name in right)
            if excess > 0.0:
                found.append(Violation(left, right, excess))
        if found:
            return max(found, key=lambda violation: violation.excess)
    return None


def _inequality(violation: Violation, loop: Loop) -> str:
    if len(violation.left) == 1:
        shortest, other = loop[violation.left[0]], loop[violation.right[0]]
        least, most = 1e3 * shortest.low, 1e3 * other.high
        between = f"cannot be the shortest link, as the {other.name} is at most {most:.6g} mm"
        return f"the {shortest.name}, at least {least:.6g} mm, {between}"
    left = " + ".join(f"{loop[name].name} {1e3 * loop[name].low:.6g}" for name in violation.left)
    right = " + ".join(f"{loop[name].name} {1e3 * loop[name].high:.6g}" for name in violation.right)
    return f"{left} > {right} mm"


def _remedies(loop: Loop, shortest: str, least_angle: float) -> list[str]:
    """Return the bounds to change so that no inequality fails; none if none are found."""
    changed = dict(loop)
    shown: dict[str, str] = {}
    while (violation := _violation(changed, shortest)) is not None and len(shown) < len(LENGTHS):
        role, value = next(_changes(violation, changed, least_angle), ("", math.nan))
        if not role:
            return []
        upper = role in violation.right
        changed[role] = changed[role]._replace(high=value) if upper else changed[role]._replace(low=value)
        shown[role] = f"a {changed[role].name} of {'at least' if upper else 'at most'} {1e3 * value:.6g} mm"
    return list(shown.values())


def _changes(violation: Violation, loop: Loop, least_angle: float) -> Iterator[tuple[str, float]]:
    """Yield lengths with the value that satisfies an inequality: free ones first, then the least relative change."""
    for role in sorted((*violation.left, *violation.right), key=lambda role: (not loop[role].free, -loop[role].high)):
        upper = role in violation.right
        extra = INSIDE * max(length.high for length in loop.values())
        for _ in range(40):
            change = violation.excess + extra
            value = _outward(loop[role].high + change if upper else loop[role].low - change, upper)
            if value <= 0.0:
                break
            corner = {one: loop[one].low if one in violation.left else loop[one].high for one in LENGTHS} | {role: value}
            if len(violation.left) == 1 or _angle(violation, corner) >= least_angle:
                yield role, value
                break
            extra *= 1.5


def _angle(violation: Violation, sizes: Mapping[str, float]) -> float:
    """Return the angle of coupler and rocker off alignment where the inequality is nearest to failing; -1 if they do not meet."""
    crank, coupler, rocker, frame = (sizes[name] for name in LENGTHS)
    gap = frame + crank if {"crank", "frame"} in (set(violation.left), set(violation.right)) else abs(frame - crank)
    cosine = abs(coupler**2 + rocker**2 - gap**2) / (2.0 * coupler * rocker)
    return math.acos(cosine) if cosine <= 1.0 else -1.0


def _outward(value: float, upper: bool) -> float:
    """Return a length with few digits [m], rounded so that the bound becomes wider."""
    return rounded(1e3 * value, DIGITS, upper) * 1e-3


# Notes on margins that the file leaves at their defaults although these exclude a better optimum.

KEY = "length_margin"
MARGIN_NOTE = f"the default {KEY} "
"""Beginning of such a note."""


def margin_notes(
    problem: ProblemFile,
    design: Mapping[str, float],
    limits: Iterable[LimitState],
    objective: float,
    relaxed: Callable[[ProblemFile], float],
) -> tuple[str, ...]:
    """Return a note if the default length margin excludes a better optimum, with its value and gain; empty if it does not.

    `relaxed` returns the objective [SI] of the local optimum near the design in a problem with other margins.
    """
    if KEY in problem.raw.get("limits", {}):
        return ()
    if not any(limit.key == f"limits.{KEY}" and limit.active and limit.multiplier for limit in limits):
        return ()
    loop = problem.spec.four_bar
    assert loop is not None
    gain = objective - relaxed(problem.override({f"limits.{KEY}": SMALLEST_LENGTH_MARGIN}))
    if not gain > SAME_OBJECTIVE * abs(objective):
        return ()
    shown = problem.model.shown_objective(objective)
    length = 1e3 * LEAST_LENGTH_MARGIN * max(loop.lengths(design))
    return (
        f"{MARGIN_NOTE}of {LEAST_LENGTH_MARGIN:g} ({length:.3g} mm), which keeps it from change points, excludes a better "
        f"optimum: limits.{KEY} = {SMALLEST_LENGTH_MARGIN:g} gains {shown.factor * gain:.3g} {shown.unit} "
        f"({percent(gain / abs(objective), 3)})",
    )
