"""Certificate of a global optimum: a lower bound of the objective over all designs, and the boxes that prove it."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, PlainSerializer, PlainValidator, WithJsonSchema, computed_field

from optlink.errors import Status
from optlink.linkage.dyads import JointedDyad, ModalDyad
from optlink.linkage.mechanism import Arm, Guide, Link, Mechanism
from optlink.linkage.vector2d import Array
from optlink.problem.design import DesignProblem
from optlink.problem.document import Column, Never, Number, Rows
from optlink.problem.file import ProblemFile
from optlink.problem.limits import limits_in_file
from optlink.problem.quantity import Interval, quantity_key
from optlink.problem.targets.law import Function, Law, SlideExpression, Table
from optlink.solvers.global_search.lagrangian import TESTS
from optlink.units import count_noun
from optlink.version import VERSION

GLOBAL, WITHIN_GAP, NOT_CLOSED, INFEASIBLE = "global", "within gap", "not closed", "infeasible"
EXACT = 1e-9  # rms deviation [rad], or share of the curve, below which a design is exact: none can be better
GLOBAL_GAP = 1e-6  # largest relative gap of a design that is called globally optimal
NONE_BETTER = "globally optimal: the design is exact to rounding, and no design can be better"
SCHEMA = "optlink/certificate/2"


def verdict_words(status: Status, valid: bool, certificate: Certificate | None, *, none_better: bool = False) -> tuple[str, ...]:
    """Return how a search ended, and whether its design is valid; an infeasible problem has one phrase for both.

    Without a closed certificate an optimum is a local one, unless its error is zero to rounding (`none_better`).
    """
    if status is Status.INFEASIBLE:
        return ("no feasible design" if certificate is not None and certificate.closed else "no feasible design found",)
    ended = "given design" if status is Status.NOT_SEARCHED else status.value
    if status is Status.OPTIMAL and not none_better and (certificate is None or not certificate.proven):
        ended = "locally optimal"
    return ended, "valid" if valid else "not valid"


def exact(problem: ProblemFile, objective: float) -> bool:
    """Return whether an objective is zero to rounding, so that no design can be better."""
    model: Any = problem.model
    scale = model.whole
    error = objective if model.measure != "sum of squares" else math.sqrt(max(objective, 0.0))
    return bool(error <= EXACT * scale)


@dataclass(frozen=True, eq=False)
class Cover:
    """The boxes of one assembly mode into which the bounds were divided, all of them discarded in the end.

    `low`, `high` (boxes, n) are their corners [SI]; `test` (boxes,) is the index, in `TESTS`, of the test that discards each;
    `multipliers` (boxes, limits) are in the order of the keys `limits`. `sides`: see `sides_of`; empty if read from a file.
    `whole`: with multipliers, which the boxes that a result contains for drawing lack.
    """

    assembly: Any
    low: Array
    high: Array
    test: NDArray[np.int8]
    multipliers: Array
    limits: tuple[str, ...]
    sides: Mapping[str, int] = field(default_factory=dict)
    whole: bool = True


MOST_DRAWN = 3_000
"""Boxes of two design variables up to which they are drawn, and a result contains them."""


def _drawn(covers: tuple[Cover, ...]) -> list[dict[str, Any]]:
    """Return the boxes of two design variables by the numbers of their edges, as texts; none if there are too many to draw."""
    if not 0 < sum(len(cover.test) for cover in covers) <= MOST_DRAWN or covers[0].low.shape[1] != 2:
        return []
    documents = []
    for cover in covers:
        document: dict[str, Any] = {"assembly": cover.assembly, "test": " ".join(map(str, cover.test)), "edges": []}
        for k in range(2):
            edges, places = np.unique(np.stack([cover.low[:, k], cover.high[:, k]]), return_inverse=True)
            low, high = (" ".join(map(str, row)) for row in places.reshape(2, -1))
            document["edges"].append({"at": edges.tolist(), "low": low, "high": high})
        documents.append(document)
    return documents


def _read_drawn(documents: list[dict[str, Any]]) -> tuple[Cover, ...]:
    covers = []
    for document in documents:
        low, high = (
            np.stack([np.array(axis["at"])[np.array(axis[end].split(), dtype=int)] for axis in document["edges"]], axis=1)
            for end in ("low", "high")
        )
        test = np.array(document["test"].split(), dtype=np.int8)
        covers.append(Cover(document["assembly"], low, high, test, np.zeros((len(test), 0)), (), whole=False))
    return tuple(covers)


DrawnCovers = Annotated[
    tuple[Cover, ...],
    PlainValidator(_read_drawn),
    PlainSerializer(_drawn),
    WithJsonSchema({"type": "array", "items": {"type": "object"}}),
]
"""Covers, of which a document contains what is drawn; certificate.json has all."""
History = Annotated[
    Rows, AfterValidator(lambda rows: np.where(np.isnan(rows), math.inf, rows) if rows.size else np.zeros((0, 3)))
]
"""Rows in which a number that is not finite is infinite."""


@dataclass(frozen=True, eq=False)
class Certificate:
    """Lower bound of the objective over all designs within the bounds.

    `status`: "global", no design is better by more than a millionth; "within gap", nor by more than the requested gap `asked`;
    "not closed", stopped before; "infeasible", no design is feasible. `objective` of the best known design and `lower_bound` are
    infinite without a design. `improved`: the search found a better design than it was given. `history` (k, 3): boxes bounded,
    lower bound, objective. `covers` is empty if there are too many boxes, and without multipliers if it was read from a result.
    `peaks`: crank rotations [rad] from the start at which the largest error of a law was bounded too, beside its positions.
    """

    status: str
    objective: Never
    lower_bound: Never
    asked: float
    boxes: int
    open_boxes: int
    unknowns: tuple[str, ...]
    improved: bool = False
    history: History = field(default_factory=lambda: np.zeros((0, 3)), repr=False)
    covers: DrawnCovers = field(default=(), repr=False)
    peaks: Column = field(default_factory=lambda: np.zeros(0), repr=False)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def rigorous(self) -> Literal[True]:
        """Whether the bound includes all rounding errors: always."""
        return True

    @property
    def closed(self) -> bool:
        """Whether the search came to its end."""
        return self.status != NOT_CLOSED

    @property
    def proven(self) -> bool:
        """Whether the best known design is proven optimal within the gap."""
        return self.status in (GLOBAL, WITHIN_GAP)

    @property
    def exact(self) -> bool:
        """Whether the objective is zero to rounding, so that no design can be better."""
        return self.status == GLOBAL and (self.objective == 0.0 or self.gap > GLOBAL_GAP * (1.0 + 1e-6))

    @computed_field  # type: ignore[prop-decorator]
    @property
    def gap(self) -> Number:
        """Share of the objective by which a design could be better; 0 for an objective of 0, NaN without a design."""
        if not math.isfinite(self.objective):
            return math.nan
        return (self.objective - self.lower_bound) / self.objective if self.objective > 0.0 else 0.0

    @computed_field  # type: ignore[prop-decorator]
    @property
    def text(self) -> str:
        """The finding as a sentence."""
        if self.status == INFEASIBLE:
            return "proven: no design within the bounds meets all limits"
        if not math.isfinite(self.objective):
            return f"not closed: no feasible design is known, {count_noun(self.open_boxes, 'box is', 'boxes are')} left"
        if self.exact:
            return NONE_BETTER
        share = share_text(self.gap)
        if self.proven:
            return f"globally optimal within the bounds: no design is better by more than {share}"
        return f"not closed: a design could still be better by up to {share}"

    @property
    def brief(self) -> str:
        """The finding in a few words."""
        if self.status == INFEASIBLE:
            return "proven"
        if self.exact:
            return "globally optimal"
        return f"{'globally optimal within' if self.proven else 'gap'} {share_text(self.gap)}"


def message(status: Status, certificate: Certificate | None, refuted: str, *, none_better: bool = False) -> str:
    """Describe how a search ended: by its certificate where that proves more than the status of the local search.

    `none_better`: the error is zero to rounding; `refuted` states which limits exclude each other, if it is known.
    """
    proof = certificate.text if certificate is not None and certificate.closed else NONE_BETTER * none_better
    if refuted:
        return f"{refuted}{f' {proof[:1].upper()}{proof[1:]}.' if proof else ''}"
    return f"{proof or status.text}{'; relax a limit whose check fails' * (status == Status.INFEASIBLE)}"


def share_text(share: float) -> str:
    """Format a share in percent, rounded up."""
    if math.isnan(share):
        return "unknown"
    if not share > 0.0:
        return "rounding errors"
    digits = max(0, 1 - math.floor(math.log10(100.0 * share)))
    shown = f"{math.ceil(100.0 * share * 10**digits - 1e-9) / 10**digits:z.{digits}f}"
    return (shown.rstrip("0").rstrip(".") if digits else shown) + " %"


def sides_of(linkage: Mechanism) -> dict[str, int]:
    """Return the assembly mode of every dyad that has two, +1 or -1, by its joint."""
    return {group.joint: group.side for group in linkage.groups if isinstance(group, ModalDyad)}


def certificate_document(certificate: Certificate, result: Any) -> dict[str, Any]:
    """Return a certificate as a document of its own, with everything that its check needs: the numbers of the problem too."""

    modes = [{"assembly": cover.assembly, "sides": dict(cover.sides)} for cover in certificate.covers]
    numbers = numbers_of(result.problem, certificate.peaks) | {"modes": modes}
    problem = {"problem": result.problem.name, "problem_hash": result.problem.hash, "numbers": numbers}
    return {
        "schema": SCHEMA,
        "optlink": VERSION,
        **problem,
        "identity": hashlib.sha256(json.dumps(problem, sort_keys=True, separators=(",", ":")).encode()).hexdigest(),
        "status": certificate.status,
        "objective": finite(certificate.objective),
        "lower_bound": finite(certificate.lower_bound),
        "asked": certificate.asked,
        "unknowns": list(certificate.unknowns),
        "design": dict(result.design) if certificate.proven else None,
        "covers": [
            {
                "assembly": cover.assembly,
                "low": cover.low.tolist(),
                "high": cover.high.tolist(),
                "test": [TESTS[k] for k in cover.test],
                "limits": list(cover.limits),
                "multipliers": [{str(k): float(row[k]) for k in np.flatnonzero(row > 0.0)} for row in cover.multipliers],
            }
            for cover in certificate.covers
        ],
    }


# The numbers of a problem [SI] in the file of a certificate: all that its check needs, without the problem file.

Numbers = dict[str, Any]


def numbers_of(problem: ProblemFile, peaks: Array) -> Numbers:
    """Return the numbers of a problem with a lower bound over boxes, without its assembly modes, as plain data.

    `peaks`: see `Certificate`.
    """
    model: Any = problem.model
    quantities = {
        name: {"value": quantity.value, "low": quantity.bounds[0], "high": quantity.bounds[1], "free": quantity.free}
        for name, quantity in model.quantities.items()
        if name not in model.links
    }
    numbers: Numbers = {
        "measure": model.measure,
        "quantities": quantities,
        **({"links": [_link(model, name) for name in model.links]} if model.links else {}),
        "linkage": {"four_bar": model.four_bar is not None, **_linkage(model.linkage)},
        "limits": _limits(model),
    }
    numbers |= _of_law(model) if model.task == "function" else _of_positions(model)
    return numbers | {"offsets": [*numbers["offsets"], *peaks.tolist()]}


def _link(model: DesignProblem, name: str) -> Numbers:
    """Return a linked quantity: its expression as operations on a stack, and its bounds."""
    link, quantity = model.links[name], model.quantities[name]
    terms: dict[str, list[Any]] = {text: ["number", number] for text, number in link.numbers.items()}
    terms |= {text: ["name", of] for text, of in link.names.items()}
    steps = [terms[what] if kind == "name" else [kind, what] for kind, what in link.expression.program]
    limited = quantity.low is not None or (quantity.kind == "length" and not link.positive)
    bounds = quantity.bounds if limited else (-math.inf, math.inf)
    return {"name": name, "key": quantity_key(model, name), "steps": steps, **_sides(bounds)}


def _linkage(linkage: Mechanism) -> Numbers:
    guides = dict.fromkeys((*linkage.guides, *(guide for group in linkage.groups for guide in group.prismatic)))
    dyads = []
    for group in linkage.groups:
        assert isinstance(group, JointedDyad)
        outer = [joint.name if isinstance(joint, Guide) else joint for joint in group.outer]
        members = [_body(linkage, link) for link in group.links]
        dyads.append({"kind": group.kind, "bodies": members, "outer": outer, "inner": group.joint})
    return {
        "datum": linkage.datum,
        "ground": {
            name: {"from": place.origin, "length": place.length, "direction": place.direction}
            if isinstance(place, Arm)
            else list(place)
            for name, place in linkage.ground.items()
        },
        "crank": _body(linkage, linkage.crank),
        "dyads": dyads,
        "guides": {guide.name: _guide(linkage, guide) for guide in guides},
    }


def _body(linkage: Mechanism, link: Link) -> Numbers:
    points = {point.name: [point.along, point.across] for point in linkage.points if point.body == link.body}
    return {"name": link.body, "start": link.start, "end": link.end, "length": link.length, "points": points}


def _guide(linkage: Mechanism, guide: Guide) -> Numbers:
    return {
        "slider": guide.slider,
        "on": guide.on,
        "at": guide.at or linkage.bodies[guide.slider].start,
        "through": guide.through if isinstance(guide.through, str) else list(guide.through),
        "direction": guide.direction,
        "offset": guide.offset,
        "tilt": guide.tilt,
    }


def _of_law(model: DesignProblem) -> Numbers:
    """Return the requirement of a motion law of a four-bar; `names`, if they are others, are those of the angles at the start."""
    names = [model.start_name, model.base_name]
    return {
        "kind": "law",
        "offsets": model.law.offsets.tolist(),
        "span": model.span,
        **_EMPTY,
        "start": model.dead_centre,
        "law": _law(model.law),
        "output": model.output,
        **({} if names == ["phi0", "psi0"] else {"names": names}),
    }


_EMPTY: Numbers = {
    **{"start": None, "law": None, "output": "", "slides": False, "point": "", "body": "", "radian": 1.0},
    **{"targets": [], "roots": [], "tolerances": []},
}


def _of_positions(model: DesignProblem) -> Numbers:
    """Return the requirement of a problem with prescribed crank angles."""
    data, requirement = model.data, model.requirement
    assert data.offsets is not None
    numbers = {
        "kind": requirement.family,
        "offsets": data.offsets.tolist(),
        "span": float(data.offsets[-1] - data.offsets[0]),
        **_EMPTY,
    }
    if model.law_given:
        return numbers | {"law": _law(model.law), "output": model.output, "slides": model.slides}
    if not model.pointed:
        return numbers
    return numbers | {
        "point": requirement.point,
        "body": model.body,
        "radian": model.radian,
        "targets": data.columns.tolist(),
        "roots": data.roots.tolist(),
        "tolerances": [finite(value) for value in data.tolerances],
    }


def _law(law: Law) -> Numbers:
    source = law.source
    if isinstance(source, Table):
        return {"kind": "table", "tabulated": np.asarray(law.tabulated).tolist(), "from_start": source.from_start}
    if isinstance(source, Function):
        least, largest = source.ends
        sizes = {"low": source.low, "high": source.high, "input": source.input, "output": source.output}
        return {"kind": "function", "text": source.expression.text, **sizes, "least": least, "largest": largest}
    expression, unit = (source.expression, source.size) if isinstance(source, SlideExpression) else (source, 1.0)
    return {"kind": "expression", "text": expression.text, "unit": unit}


def _limits(model: DesignProblem) -> Numbers:
    limits = model.limits
    transmission = {
        joint: limit for joint in (group.joint for group in model.linkage.groups) if (limit := limits.transmission_at(joint))
    }
    region = getattr(limits, "pivots", None)  # of path synthesis
    pivots = None if region is None else {axis: _interval(getattr(region, axis)) for axis in "xy"}
    return {
        "crank": limits.crank,
        "alignment": limits.alignment.value,
        "length_margin": limits.length_margin,
        "over": limits.transmission_range,
        "transmission": {joint: vars(limit) for joint, limit in transmission.items()},
        "further": [
            {"name": term.name, **_sides(interval.bounds), "stroke": getattr(interval, "stroke", None)}
            for term, interval in limits_in_file(limits)
        ],
        "pivots": pivots,
    }


def _interval(interval: Interval | None) -> list[float | None]:
    return [None, None] if interval is None else list(_sides(interval.bounds).values())


def _sides(bounds: tuple[float, float]) -> dict[str, float | None]:
    return {"low": finite(bounds[0]), "high": finite(bounds[1])}


def finite(value: float) -> float | None:
    """Return a number as JSON can contain it: null if it is infinite."""
    return float(value) if math.isfinite(value) else None
