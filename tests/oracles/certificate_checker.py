"""Check a certificate of a global optimum without optlink: with formulas of its own, in ball arithmetic (python-flint).

    python tests/oracles/certificate_checker.py certificate.json [result.json]

The certificate holds the numbers of its problem, the design, and the boxes into which the bounds were divided. It is proven if

- the boxes of every assembly mode cover the bounds without a gap (coordinates are compared, nothing is rounded);
- the design lies within the bounds, meets the limits within 1e-9 and has the stated objective, which is at least the lower bound;
- every box holds no feasible design with an objective below the lower bound: one limit, or the sum of the limits with the
  multipliers of the certificate, is violated everywhere in it; or the objective is at least the lower bound everywhere in it; or
  the Lagrangian with these multipliers is, by its Taylor form or, if it is convex over the box, by a tangent plane.

A box that does not pass is halved, each half is tested, and so on. Multipliers that are not negative are a valid witness: those
that are no good lead to more halving, not to a wrong verdict. With result.json, the certificate must be that of this result.

Exit code 0: proven. 1: refused, in one sentence with the place. 2: the file cannot be read, or is no certificate.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

if __package__ in (None, ""):  # as a program
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from flint import arb, arb_mat, ctx

from tests.oracles.ball import (
    Ball,
    box_minimum,
    constant,
    floats,
    lower_bound,
    positive_definite,
    square_floats,
    tangent_bound,
)
from tests.oracles.linkage_formulas import OUTER, Deviation, Problem, Unknown, bodies

SCHEMA = "optlink/certificate/2"
BITS = 100  # precision of the arithmetic; a double has 53
DEPTH = 40  # times that a box is halved at most
PIECES = 20_000  # parts of one box that are bounded at most
TANGENTS = 4  # designs at which a tangent plane is tried
LAWSON = 12  # steps of the weights of a largest deviation
TOP = 1e-3  # share of the largest deviation within which others are as large at the design
NEAR_ACTIVE = 1e-6  # slack of a limit below which it is active at the design
AGREES = 1e-9  # largest relative difference of the objective; largest violation of a limit [m, rad or -]
ROUNDING = 1e-12  # rad or m; absolute agreement required of nearly zero deviations
GLOBAL_GAP = 1e-6  # largest relative gap of a design that is called globally optimal

Document = dict[str, Any]


class Refused(Exception):
    """A certificate that is not proven: the place in it, and what is wrong there."""

    def __init__(self, place: str, what: str) -> None:
        super().__init__(f"{place}: {what}")


class Unreadable(Exception):
    """A file that is no certificate."""


# --- the file ------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Maybe:
    """A value that may be null."""

    form: Any


NUMBER, TEXT, FLAG, SIZE, ANY = "number", "text", "true or false", "number or name", "value"
INTERVAL = [Maybe(NUMBER)]
BODY = {"name": TEXT, "start": TEXT, "end": TEXT, "length": SIZE, "points": {"*": [SIZE]}}
NUMBERS = {
    "kind": ("law", "function", "path", "motion", "transmission"),
    "measure": ("sum of squares", "rms", "max"),
    "quantities": {"*": {"value": NUMBER, "low": NUMBER, "high": NUMBER, "free": FLAG}},
    "linkage": {
        "four_bar": FLAG,
        "datum": SIZE,
        "ground": {"*": ANY},
        "crank": BODY,
        "dyads": [{"kind": ("RRR", "RRP", "RPR", "RPP", "PRP"), "bodies": [BODY], "outer": [TEXT], "inner": TEXT}],
        "guides": {
            "*": {
                **dict.fromkeys(("slider", "on", "at"), TEXT),
                **dict.fromkeys(("direction", "offset", "tilt"), SIZE),
                "through": ANY,
            }
        },
    },
    "modes": [{"assembly": ANY, "sides": {"*": (1, -1)}}],
    "offsets": [NUMBER],
    "span": NUMBER,
    "start": Maybe((OUTER, "inner dead centre")),
    "law": Maybe(ANY),
    "output": TEXT,
    "slides": FLAG,
    "point": TEXT,
    "body": TEXT,
    "radian": NUMBER,
    "targets": [[NUMBER]],
    "roots": [NUMBER],
    "tolerances": [Maybe(NUMBER)],
    "limits": {
        "crank": ("full rotation", "double-crank", "span"),
        "alignment": NUMBER,
        "length_margin": NUMBER,
        "over": ("revolution", "span"),
        "transmission": {"*": {"key": TEXT, "low": Maybe(NUMBER), "high": Maybe(NUMBER)}},
        "further": [{"name": TEXT, "low": Maybe(NUMBER), "high": Maybe(NUMBER), "stroke": Maybe(TEXT)}],
        "pivots": Maybe({"x": INTERVAL, "y": INTERVAL}),
    },
}
LINK = {"name": TEXT, "key": TEXT, "steps": [[Maybe(SIZE)]], "low": Maybe(NUMBER), "high": Maybe(NUMBER)}
"""A quantity that follows from others, each of which is a given one or follows before it; its steps work on a stack."""
CERTIFICATE = {
    "schema": TEXT,
    "optlink": TEXT,
    "problem": TEXT,
    "problem_hash": TEXT,
    "identity": TEXT,
    "status": ("global", "within gap", "infeasible"),
    "objective": Maybe(NUMBER),
    "lower_bound": Maybe(NUMBER),
    "asked": NUMBER,
    "unknowns": [TEXT],
    "design": Maybe({"*": NUMBER}),
    "numbers": NUMBERS,
    "covers": [
        {
            "assembly": ANY,
            "low": [[NUMBER]],
            "high": [[NUMBER]],
            "test": [("limits", "objective", "Lagrangian", "cut")],
            "limits": [TEXT],
            "multipliers": [{"*": NUMBER}],
        }
    ],
}


def check_form(value: Any, form: Any, place: str) -> None:
    """Refuse a value that does not have a form: a type, a choice of texts, a list, or an object with certain keys."""
    if isinstance(form, Maybe):
        if value is not None:
            check_form(value, form.form, place)
    elif isinstance(form, list):
        _expect(isinstance(value, list), "a list", place)
        for k, item in enumerate(value):
            check_form(item, form[0], f"{place}[{k}]")
    elif isinstance(form, dict):
        _expect(isinstance(value, dict), "an object", place)
        for key in form if "*" not in form else ():
            if key not in value:
                raise Refused(f"{place}.{key}".lstrip("."), "this is missing")
        for key, item in value.items():
            if key not in form and "*" not in form:
                raise Refused(f"{place}.{key}".lstrip("."), "no certificate has this key")
            check_form(item, form.get(key, form.get("*")), f"{place}.{key}".lstrip("."))
    elif isinstance(form, tuple):
        _expect(value in form, f"one of {', '.join(map(str, form))}", place)
    elif form == SIZE:
        check_form(value, TEXT if isinstance(value, str) else NUMBER, place)
    elif form == NUMBER:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        _expect(number and abs(value) <= sys.float_info.max, "a finite number", place)
    elif form != ANY:
        _expect(isinstance(value, bool if form == FLAG else str), form, place)


def _expect(right: bool, what: str, place: str) -> None:
    if not right:
        raise Refused(place or "file", f"expected {what}")


def read(path: Path) -> Document:
    """Read a JSON object; Unreadable if there is none."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a JSON document"
        raise Unreadable(f"{path}: {reason}") from None
    if not isinstance(document, dict):
        raise Unreadable(f"{path}: not a JSON object")
    return document


def identity(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the name, the hash and the numbers of the problem."""
    part = {key: document[key] for key in ("problem", "problem_hash", "numbers")}
    return hashlib.sha256(json.dumps(part, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def check_document(document: Document) -> None:
    """Refuse a certificate whose parts do not fit each other."""
    stated = document["numbers"] if isinstance(document.get("numbers"), dict) else {}
    further = {key: form for key, form in {"links": [LINK], "names": [TEXT]}.items() if key in stated}
    check_form(document, CERTIFICATE | {"numbers": NUMBERS | further}, "")
    if document["identity"] != identity(document):
        raise Refused("identity", "this is not the hash of the problem: a name, a hash or a number in it was changed")
    numbers, infeasible = document["numbers"], document["status"] == "infeasible"
    for key in ("objective", "lower_bound", "design"):
        if infeasible != (document[key] is None):
            raise Refused(key, "there is none if no design is feasible" if infeasible else "this is missing")
    free = [name for name, quantity in numbers["quantities"].items() if quantity["free"]]
    if document["unknowns"] != free:
        raise Refused("unknowns", f"the design variables of the problem are {', '.join(free)}")
    for name, quantity in numbers["quantities"].items():
        if quantity["low"] > quantity["high"]:
            raise Refused(f"numbers.quantities.{name}", "the lower bound is larger than the upper one")
    count = len(numbers["offsets"])
    for key in ("targets", "roots", "tolerances") if numbers["kind"] in ("path", "motion") else ():
        if len(numbers[key]) != count:
            raise Refused(f"numbers.{key}", f"expected {count} rows, one for every position")
    for k, dyad in enumerate(numbers["linkage"]["dyads"]):
        if len(dyad["bodies"]) != 2 or len(dyad["outer"]) != 2:
            raise Refused(f"numbers.linkage.dyads[{k}]", "a dyad has two bodies and two outer joints")
    names = [body["name"] for body in bodies(numbers["linkage"])]
    if len(set(names)) < len(names):
        raise Refused("numbers.linkage.dyads", "two bodies have one name")
    for k, cover in enumerate(document["covers"]):
        _check_cover(cover, f"covers[{k}]", len(free))
    modes = [str(mode["assembly"]) for mode in numbers["modes"]]
    covered = [str(cover["assembly"]) for cover in document["covers"]]
    if not modes or sorted(modes) != sorted(covered) or len(set(modes)) < len(modes):
        raise Refused("covers", f"the boxes are those of the assembly modes {covered}, the problem has {modes}")


def _check_cover(cover: Document, place: str, width: int) -> None:
    count = len(cover["test"])
    for key in ("low", "high", "multipliers"):
        if len(cover[key]) != count:
            raise Refused(f"{place}.{key}", f"expected {count} rows, found {len(cover[key])}")
    for k, (low, high) in enumerate(zip(cover["low"], cover["high"], strict=True)):
        if len(low) != width or len(high) != width:
            raise Refused(f"{place}.low[{k}]", f"a corner has {width} coordinates")
        if any(a > b for a, b in zip(low, high, strict=True)):
            raise Refused(f"{place}.high[{k}]", "the upper corner of the box lies below its lower corner")
    for k, row in enumerate(cover["multipliers"]):
        for index, multiplier in row.items():
            if not index.isdecimal() or int(index) >= len(cover["limits"]):
                raise Refused(f"{place}.multipliers[{k}].{index}", f"there are only {len(cover['limits'])} limits")
            if multiplier < 0.0:
                raise Refused(f"{place}.multipliers[{k}].{index}", "a multiplier is not negative")


def check_result(document: Mapping[str, Any], result: Mapping[str, Any]) -> None:
    """Refuse a certificate that is not that of a result."""
    proof = result.get("certificate") or {}
    for key, value in (
        ("problem_hash", result.get("problem_hash")),
        *((key, proof.get(key)) for key in ("status", "lower_bound")),
    ):
        if document[key] != value:
            raise Refused(key, f"the result has {value!r}")


# --- cover of the bounds -------------------------------------------------------------------------------------------------------


def uncovered(low: Sequence[Sequence[float]], high: Sequence[Sequence[float]], bounds: tuple[Any, Any]) -> tuple[Any, Any] | None:
    """Return a part of a box that is not proven to be covered by smaller boxes; None if they cover it.

    Boxes that come from repeated cuts through a whole box form a guillotine partition: there is a plane that cuts no box, and
    either side has one too, until one box is left. Each step sorts the boxes along every variable and divides at all such planes
    of the variable that has most of them. Coordinates are only compared.
    """
    stack = [(range(len(low)), list(bounds[0]), list(bounds[1]))]
    while stack:
        index, least, most = stack.pop()
        axes = range(len(least))
        index = [i for i in index if all((low[i][k] < most[k] and high[i][k] > least[k]) or least[k] == most[k] for k in axes)]
        if any(all(low[i][k] <= least[k] and high[i][k] >= most[k] for k in axes) for i in index):
            continue
        planes = [_planes([(low[i][k], high[i][k]) for i in index], least[k], most[k]) for k in axes]
        k = max(axes, key=lambda k: len(planes[k] or ()))
        if not planes[k] or None in planes:
            return least, most
        for begin, end in zip((least[k], *planes[k]), (*planes[k], most[k]), strict=True):
            first, last = list(least), list(most)
            first[k], last[k] = begin, end
            stack.append((index, first, last))
    return None


def _planes(sides: list[tuple[float, float]], least: float, most: float) -> list[float] | None:
    """Return the coordinates strictly inside least ... most that no interval contains in its interior; None if there is a gap."""
    reached, planes = least, []
    for low, high in sorted(sides):
        if low > reached:
            return None
        if low == reached and least < low < most and low not in planes[-1:]:
            planes.append(low)
        reached = max(reached, high)
    return planes if reached >= most else None


# --- proofs --------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Lagrangian:
    """A Lagrangian that can be evaluated again at other designs: weights of the squares, multipliers of the slacks."""

    weights: Sequence[float]
    multipliers: Mapping[int, float]


class Prover:
    """Proofs for the boxes of one assembly mode."""

    def __init__(self, document: Document, mode: Document) -> None:
        self.problem, self.pieces = Problem(document["numbers"], mode), 0
        self.squared = self.problem.measure == "sum of squares"
        self.target: Any = None
        if document["lower_bound"] is not None:
            bound = arb(document["lower_bound"])
            self.target = bound if self.squared else bound * bound
        self.count = len(self.problem.offsets)
        self.sizes = [1.0] * self.count  # of the deviations in the last boxes: the largest are bounded first
        self._design = document["design"]
        self._known: Lagrangian | None = None

    # --- the design ------------------------------------------------------------------------------------------------

    def check_design(self, document: Document) -> Any:
        """Refuse a design that is not that of the certificate, or that its problem does not permit; return its objective."""
        design, problem = document["design"], self.problem
        for name, quantity in problem.numbers["quantities"].items():
            if name not in design:
                raise Refused(f"design.{name}", "this is missing")
            if not quantity["low"] - AGREES <= design[name] <= quantity["high"] + AGREES:
                raise Refused(f"design.{name}", f"{design[name]:.9g} is beyond {quantity['low']:.9g} ... {quantity['high']:.9g}")
        values = problem.values([design[name] for name in problem.names], None)
        for link in problem.numbers.get("links", ()):
            if not abs(float(values[link["name"]].value) - design.get(link["name"], math.nan)) <= AGREES:
                raise Refused(f"design.{link['name']}", "this does not follow from the other quantities as the problem states it")
        start = problem.starts(values)[0] if problem.starts(values) else None
        if start is None:
            raise Refused("design", "the linkage has no start position")
        for name, angle in zip(problem.start_names, start[1:], strict=True) if problem.of_law else ():
            away = abs(math.remainder(float(angle.value) - design.get(name, math.nan), math.tau))
            if not away <= AGREES:
                raise Refused(f"design.{name}", f"this is not the angle of the design, {float(angle.value):.12g} rad")
        for key, slack in problem.slacks(values, fixed=True):
            if not slack.value >= -AGREES:
                raise Refused("design", f"the design violates {key} by {-float(slack.value):.3g}")
        return self._check_objective(document, self._objective(problem.deviations(values, start)))

    def _objective(self, deviations: list[list[Deviation]]) -> Any:
        squares = [_square(position) for position in deviations]
        if any(square is None for square in squares):
            raise Refused("design", "the linkage cannot be assembled at every position")
        values = [square.value for square in squares if square is not None]
        if self.problem.measure == "max":
            largest = arb(0)
            for value in values:
                largest = largest.max(value)
            return largest.sqrt()
        total = sum(values, arb(0))
        return total if self.squared else (total / len(values)).sqrt()

    def _check_objective(self, document: Document, exact: Any) -> Any:
        stated, bound, value = document["objective"], document["lower_bound"], float(exact)
        roots = [math.sqrt(max(x, 0.0)) if self.squared else x for x in (stated, value)]
        if not (abs(value - stated) <= AGREES * abs(stated) or abs(roots[0] - roots[1]) <= ROUNDING):
            raise Refused("objective", f"the design has the objective {value!r}, not {stated!r}")
        if bound > stated or arb(bound) > exact:
            raise Refused("lower_bound", f"{bound!r} is larger than the objective of the design, {value!r}")
        share = (stated - bound) / stated if stated > 0.0 else 0.0
        allowed = GLOBAL_GAP if document["status"] == "global" else document["asked"]
        if not share <= allowed * (1.0 + 1e-6):
            raise Refused("status", f"the gap is {share:.3g}, more than the {allowed:.3g} of {document['status']!r}")
        return exact

    # --- boxes -----------------------------------------------------------------------------------------------------

    def fault(self, low: list[float], high: list[float], limits: Sequence[str], multipliers: Mapping[int, float]) -> str:
        """Return why a box cannot be proven; empty if it is."""
        stack = [(low, high, 0)]
        begin = self.pieces
        while stack:
            a, b, depth = stack.pop()
            verdict, direction = _Piece(self, a, b).verdict(limits, multipliers)
            self.pieces += 1
            if verdict == "proven":
                continue
            if verdict == "refuted":
                place = ", ".join(f"{0.5 * (x + y):.9g}" for x, y in zip(a, b, strict=True))
                lower = "" if self.target is None else " and has a lower objective"
                return f"the design {place} (SI) in it violates none of the limits{lower}"
            if depth >= DEPTH or self.pieces - begin >= PIECES:
                return f"no proof after {self.pieces - begin} parts"
            middle = 0.5 * (a[direction] + b[direction])
            first, last = list(b), list(a)
            first[direction] = last[direction] = middle
            stack += [(a, first, depth + 1), (last, b, depth + 1)]
        return ""

    def known(self) -> Lagrangian | None:
        """Return weights and multipliers from the conditions of optimality at the design of the certificate."""
        if self._known is None and self._design is not None:
            self._known, self._design = self._at_design(self._design), None
        return self._known

    def _at_design(self, design: Mapping[str, float]) -> Lagrangian:
        problem = self.problem
        width = [b - a for a, b in zip(problem.low, problem.high, strict=True)]
        x = [float(design[name]) for name in problem.names]
        values = problem.values(x, [arb(w) for w in width], over=False)
        squares = [_square(position) for position in problem.deviations(values, problem.starts(values)[0])]
        slacks = [slack for _, slack in problem.slacks(values)]
        sizes = [-1.0 if square is None else float(square.centre) for square in squares]
        bounds = zip(x, problem.low, problem.high, width, strict=True)
        inside = [min(at - a, b - at) > NEAR_ACTIVE * w for at, a, b, w in bounds]
        top = [k for k, size in enumerate(sizes) if size >= (1.0 - TOP) * max(sizes)]
        active = [k for k, slack in enumerate(slacks) if abs(float(slack.centre)) < NEAR_ACTIVE and slack.known]
        columns = [floats(squares[k].slope) for k in top]  # type: ignore[union-attr]
        columns += [[-s for s in floats(slacks[k].slope)] for k in active]
        columns = [[entry for entry, kept in zip(column, inside, strict=True) if kept] for column in columns]
        scale = 1e3 * max((abs(entry) for column in columns for entry in column), default=1.0)
        columns = [[*column, scale if k < len(top) else 0.0] for k, column in enumerate(columns)]
        solution = not_negative_least_squares(columns, [0.0] * sum(inside) + [scale])
        weights = [0.0] * self.count
        for k, weight in zip(top, solution, strict=False):
            weights[k] = weight
        return Lagrangian(_normalised(weights), dict(zip(active, solution[len(top) :], strict=True)))


class _Piece:
    """One part of a box."""

    def __init__(self, prover: Prover, low: list[float], high: list[float]) -> None:
        self.prover, self.problem, self.target = prover, prover.problem, prover.target
        self.low, self.high = low, high
        self.centre = [0.5 * (a + b) for a, b in zip(low, high, strict=True)]
        sides = zip(self.centre, low, high, strict=True)
        self.scale = [(arb(b) - arb(c)).max(arb(c) - arb(a)).upper() for c, a, b in sides]
        self.values = self.problem.values(self.centre, self.scale)

    def verdict(self, limits: Sequence[str], multipliers: Mapping[int, float]) -> tuple[str, int]:
        """Return "proven", "refuted" or "open", and the variable along which an open part should be halved."""
        bounds = zip(self.low, self.high, self.problem.low, self.problem.high, strict=True)
        width = [(b - a) / (d - c) if d > c else 0.0 for a, b, c, d in bounds]
        named = self.problem.slacks(self.values)
        slacks = [slack for _, slack in named]
        if any(float(slack.centre) < 0.0 and lower_bound(-slack) > 0 for slack in slacks):
            return "proven", 0
        fits = [key for key, _ in named] == list(limits)
        used = {k: value for k, value in multipliers.items() if fits and value > 0.0 and slacks[k].known}
        if used and lower_bound(_combined(constant(0.0), slacks, used)) > 0:
            return "proven", 0
        if self.target is None:
            feasible = all(slack.centre > 0 for slack in slacks)
            return "refuted" if feasible else "open", _direction(slacks, width)
        better, open_ones = False, []
        starts = self.problem.starts(self.values)
        for start in starts:
            proof = self._objective(start, slacks, used, single_start=len(starts) == 1)
            if proof is None:
                continue
            models, value = proof
            better |= len(starts) == 1 and bool(value < self.target) and all(slack.centre > 0 for slack in slacks)
            open_ones += models
        if not open_ones:
            return "proven", 0
        return "refuted" if better else "open", _direction(open_ones, width)

    def _objective(
        self, start: Any, slacks: list[Ball], used: Mapping[int, float], *, single_start: bool
    ) -> tuple[list[Ball], Any] | None:
        """Return weighted objectives and the value at the centre; None if the objective is proven to be at least the target.

        With a single start position, that of any design in the box is on the same branch.
        """
        most, target = self.problem.measure == "max", self.target * (self.prover.count if self._mean else 1)
        sizes, total = self.prover.sizes, arb(0)
        deviations: list[list[Deviation]] = [[] for _ in sizes]
        for k in sorted(range(len(sizes)), key=lambda k: -sizes[k]):
            deviations[k] = self.problem.deviation(k, self.values, start)
            least = sum((one.least * one.least for one in deviations[k]), arb(0))
            sizes[k] = float(least)
            total = total.max(least) if most else total + least
            if total >= target:
                return None
        squares = [_square(position) for position in deviations]
        usable = [square for square in squares if square is not None]
        value = arb("nan")
        if len(usable) == len(squares):
            centres = [square.centre for square in usable]
            value = max(centres, key=float) if most else sum(centres, arb(0))
            value = value / (self.prover.count if self._mean else 1)
        models = []
        for tried in self._lagrangians(squares, used):
            plain = sum((s * w for s, w in zip(squares, tried.weights, strict=True) if s is not None), constant(0.0))
            if not most:
                rest = [
                    sum((o.least * o.least for o in p), arb(0)) for p, s in zip(deviations, squares, strict=True) if s is None
                ]
                plain = plain + constant(sum(rest, arb(0)) * arb(tried.weights[0]))
            models.append(plain)
            if plain.slope is None:
                continue
            if lower_bound(plain) >= self.target:
                return None
            kept = {k: m for k, m in tried.multipliers.items() if slacks[k].known}
            whole = _combined(plain, slacks, kept) if kept else plain
            if kept and lower_bound(whole) >= self.target:
                return None
            smooth = single_start and len(usable) == len(squares)
            if smooth and positive_definite(whole.hessian) and self._tangent(whole, tried.weights, kept):
                return None
        return models, value

    @property
    def _mean(self) -> bool:
        return bool(self.problem.measure == "rms")

    def _lagrangians(self, squares: list[Ball | None], used: Mapping[int, float]) -> Iterator[Lagrangian]:
        count = len(squares)
        if self.problem.measure != "max":
            yield Lagrangian([1.0 / count if self._mean else 1.0] * count, used)
            return
        known = self.prover.known()
        if known is not None:
            yield known
        yield Lagrangian(_lawson(squares), used)

    def _tangent(self, whole: Ball, weights: Sequence[float], multipliers: Mapping[int, float]) -> bool:
        """Return whether a tangent plane of the convex Lagrangian at about its minimum is at least the target."""
        convex, scale = square_floats(whole.hessian), [float(s) for s in self.scale]
        point, model = [0.0] * len(self.centre), whole
        for _ in range(TANGENTS):
            point = box_minimum(floats(model.slope), convex, point)
            moved = zip(self.centre, scale, point, self.low, self.high, strict=True)
            x = [min(max(c + s * d, a), b) for c, s, d, a, b in moved]
            values = self.problem.values(x, self.scale, over=False)
            squares = [_square(position) for position in self.problem.deviations(values, self.problem.starts(values)[0])]
            if any(square is None for square in squares):
                return False
            plain = sum((s * w for s, w in zip(squares, weights, strict=True) if s is not None), constant(0.0))
            slacks = [slack for _, slack in self.problem.slacks(values)] if multipliers else []
            model = _combined(plain, slacks, multipliers)
            away = [(arb(a) - arb(c)) / s for a, c, s in zip(x, self.centre, self.scale, strict=True)]
            if tangent_bound(model, away) >= self.target:
                return True
            if model.centre < self.target:
                return False
        return False


def _square(position: list[Deviation]) -> Ball | None:
    """Return the squared size of a deviation; None if a component is unknown."""
    models = [deviation.model for deviation in position]
    return None if None in models else sum((model * model for model in models if model is not None), constant(0.0))


def _combined(objective: Ball, slacks: Sequence[Ball], multipliers: Mapping[int, float]) -> Ball:
    """Return the Lagrangian: the objective minus multipliers times slacks."""
    for k, multiplier in multipliers.items():
        objective = objective - slacks[k] * multiplier
    return objective


def _direction(models: Sequence[Ball], width: Sequence[float]) -> int:
    """Return the variable that changes the first quantity most, or the widest if none is known."""
    axes = range(len(width))
    for model in models:
        if model.slope is not None and model.known:
            second = [sum(float(model.hessian[i, j].abs_upper()) for j in axes) for i in axes]
            change = [abs(s) + h for s, h in zip(floats(model.slope), second, strict=True)]
            if all(map(math.isfinite, change)) and any(change):
                return max(axes, key=lambda k: change[k] if width[k] > 0.0 else -1.0)
    return max(axes, key=lambda k: width[k])


def _normalised(weights: Sequence[float]) -> list[float]:
    """Return weights with a sum of at most 1."""
    total = sum(weights)
    return [w * (1.0 - 1e-14 * len(weights)) / total for w in weights] if total > 0.0 else [0.0] * len(weights)


def _lawson(squares: Sequence[Ball | None]) -> list[float]:
    """Return weights of the positions that raise the least weighted sum, by the sizes of their linear parts at its minimum.

    References
    ----------
    C. L. Lawson, Contributions to the theory of linear least maximum approximation, thesis, UCLA 1961.
    """
    usable = {k: square for k, square in enumerate(squares) if square is not None and square.slope is not None}
    roots = {k: math.sqrt(max(float(square.centre), 1e-300)) for k, square in usable.items()}
    linear = {k: [s / (2.0 * roots[k]) for s in floats(square.slope)] for k, square in usable.items()}  # of the deviation
    weights = dict.fromkeys(usable, 1.0)
    axes = range(len(next(iter(linear.values()), [])))
    for _ in range(LAWSON if usable else 0):
        slope = [sum(w * roots[k] * linear[k][i] for k, w in weights.items()) for i in axes]
        curved = [[sum(w * linear[k][i] * linear[k][j] for k, w in weights.items()) for j in axes] for i in axes]
        point = box_minimum(slope, curved)
        sizes = {k: w * abs(roots[k] + sum(linear[k][i] * point[i] for i in axes)) for k, w in weights.items()}
        total = sum(sizes.values())
        if not total > 0.0:
            break
        weights = {k: size / total for k, size in sizes.items()}
    return _normalised([weights.get(k, 0.0) for k in range(len(squares))])


def not_negative_least_squares(columns: list[list[float]], right: list[float]) -> list[float]:
    """Return about the x >= 0 with the least |columns x - right|: C. L. Lawson, R. J. Hanson, Solving Least Squares Problems."""
    n, x = len(columns), [0.0] * len(columns)
    kept: list[int] = []
    for _ in range(3 * n):
        residual = [r - sum(x[j] * columns[j][i] for j in range(n)) for i, r in enumerate(right)]
        gain = {j: sum(c * r for c, r in zip(columns[j], residual, strict=True)) for j in range(n) if j not in kept}
        best = max(gain, key=lambda j: gain[j], default=-1)
        if best < 0 or gain[best] <= 1e-12 * sum(r * r for r in right):
            break
        kept.append(best)
        while kept:
            matrix = arb_mat(len(right), len(kept), [columns[j][i] for i in range(len(right)) for j in kept])
            try:
                solved = (matrix.transpose() * matrix).solve(matrix.transpose() * arb_mat(len(right), 1, right))
            except ZeroDivisionError:
                kept.remove(best)
                return x
            z = dict(zip(kept, floats(solved), strict=True))
            if min(z.values()) > 0.0:
                x = [z.get(j, 0.0) for j in range(n)]
                break
            step = min(x[j] / (x[j] - z[j]) for j in kept if z[j] <= 0.0 and x[j] > z[j]) if any(x[j] > z[j] for j in kept) else 0
            x = [x[j] + step * (z.get(j, 0.0) - x[j]) if j in kept else 0.0 for j in range(n)]
            kept = [j for j in kept if x[j] > 0.0]
    return x


# --- the verdict ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Verdict:
    """What a certificate proves."""

    document: Document
    boxes: int
    pieces: int

    def __str__(self) -> str:
        quantities = self.document["numbers"]["quantities"]
        bounds = ", ".join(f"{name} {q['low']:.9g} ... {q['high']:.9g}" for name, q in quantities.items() if q["free"])
        modes = ", ".join(str(mode["assembly"]) for mode in self.document["numbers"]["modes"])
        name = f"{self.document['problem']} ({self.document['problem_hash']}; {bounds}; SI; assembly {modes})"
        if self.document["status"] == "infeasible":
            finding = "no design within the bounds meets all limits"
        else:
            bound, objective = self.document["lower_bound"], self.document["objective"]
            finding = f"no design within the bounds has an objective below {bound!r}, and the design has {objective!r}"
        return f"proven: {name}: {finding}; {self.pieces} parts of {self.boxes} boxes"


def check(document: Document, result: Document | None = None) -> Verdict:
    """Return what a certificate proves.

    Parameters
    ----------
    document : dict
        Content of certificate.json.
    result : dict, optional
        Content of result.json, of which it should be the certificate.

    Raises
    ------
    Refused
        If it proves nothing.
    Unreadable
        If it is no certificate.
    """
    if document.get("schema") != SCHEMA:
        raise Unreadable(f"schema: this is not a certificate ({SCHEMA})")
    check_document(document)
    if result is not None:
        check_result(document, result)
    try:
        with ctx.workprec(BITS):
            return _proven(document)
    except (LookupError, TypeError, ValueError, AttributeError, StopIteration, ArithmeticError, RecursionError, Unknown) as error:
        raise Refused("numbers", f"the problem is incomplete or unknown ({error})") from None


def _proven(document: Document) -> Verdict:
    provers = {str(mode["assembly"]): Prover(document, mode) for mode in document["numbers"]["modes"]}
    covers = [(f"covers[{k}]", cover, provers[str(cover["assembly"])]) for k, cover in enumerate(document["covers"])]
    for place, cover, prover in covers:
        gap = uncovered(cover["low"], cover["high"], (prover.problem.low, prover.problem.high))
        if gap is not None:
            raise Refused(place, f"no box covers a part of {_sides(document, *gap)}")
    if document["design"] is not None:
        faults = []
        for prover in provers.values():
            try:
                prover.check_design(document)
                break
            except Refused as fault:
                faults.append(fault)
        else:
            raise faults[0]
    for place, cover, prover in covers:
        for k, (low, high, row) in enumerate(zip(cover["low"], cover["high"], cover["multipliers"], strict=True)):
            fault = prover.fault(low, high, cover["limits"], {int(index): value for index, value in row.items()})
            if fault:
                raise Refused(f"{place}, box {k}", f"{_sides(document, low, high)}: {fault}")
    boxes = sum(len(cover["test"]) for cover in document["covers"])
    return Verdict(document, boxes, sum(prover.pieces for prover in provers.values()))


def _sides(document: Document, low: Sequence[float], high: Sequence[float]) -> str:
    """Return the sides of a box for display."""
    sides = zip(document["unknowns"], low, high, strict=True)
    return ", ".join(f"{name} {a!r} ... {b!r}" for name, a, b in sides) + " (SI)"


def main(arguments: Sequence[str]) -> int:
    """Check the files of a command line; return the exit code."""
    if not 1 <= len(arguments) <= 2:
        print("Usage: python certificate_checker.py certificate.json [result.json]", file=sys.stderr)
        return 2
    try:
        document, *rest = (read(Path(name)) for name in arguments)
        print(check(document, *rest))
    except Refused as fault:
        print(f"refused: {arguments[0]}: {fault}", file=sys.stderr)
        return 1
    except Unreadable as fault:
        print(f"unreadable: {fault}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
