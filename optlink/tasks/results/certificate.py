"""Certificate of a global optimum: a lower bound of the objective over all designs, and the boxes that prove it."""

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
from optlink.linkage.dyad_types import ModalDyad
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.vector2d import Array
from optlink.problem.document import Column, Never, Number, Rows
from optlink.problem.file import ProblemFile
from optlink.solvers.global_search.lagrangian import TESTS
from optlink.version import VERSION

GLOBAL, WITHIN_GAP, NOT_CLOSED, INFEASIBLE = "global", "within gap", "not closed", "infeasible"
EXACT = 1e-9  # rms deviation [rad], or share of the curve, below which a design is exact: none can be better
GLOBAL_GAP = 1e-6  # largest relative gap of a design that is called globally optimal
SCHEMA = "optlink/certificate/2"


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
            return f"not closed: no feasible design is known, {self.open_boxes:,} boxes are left"
        if self.exact:
            return "globally optimal: the design is exact to rounding, and no design can be better"
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


def message(status: Status, certificate: Certificate | None, refuted: str) -> str:
    """Describe how a search ended: by its certificate where that proves more than the status of the local search.

    `refuted` states which limits exclude each other, if it is known.
    """
    proof = certificate.text if certificate is not None and certificate.closed else ""
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
    from optlink.tasks.results.certificate_numbers import finite, numbers_of  # its import takes time

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
