"""Certificate of a global optimum: a lower bound of the objective over all designs, and the boxes that prove it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from optlink.problem.base_model import Number, Record, Rows, absent
from optlink.solvers.global_search.lagrangian import TESTS
from optlink.version import VERSION

Array = NDArray[np.float64]

GLOBAL, WITHIN_GAP, NOT_CLOSED, INFEASIBLE = "global", "within gap", "not closed", "infeasible"
STRICT = 1e-6  # largest relative gap of a design that is called globally optimal
SHOWN = 3_000  # discarded boxes up to which the result document has them
SCHEMA = "optlink/certificate/1"


@dataclass(frozen=True, eq=False)
class Cover:
    """The boxes of one assembly mode into which the bounds were divided, all of them discarded in the end.

    Parameters
    ----------
    assembly : object
        Assembly mode, in the words of the problem file.
    low, high : array (boxes, n)
        Corners [SI].
    test : array of int (boxes,)
        Index, in `TESTS`, of the test that discards the box.
    multipliers : array (boxes, limits)
        Of the limits, in the order of `limits`.
    limits : tuple of str
        Key of the limit of every multiplier.
    """

    assembly: Any
    low: Array
    high: Array
    test: NDArray[np.int8]
    multipliers: Array
    limits: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Certificate:
    """Lower bound of the objective over all designs within the bounds.

    Parameters
    ----------
    status : str
        "global": no design is better by more than a millionth; "within gap": nor by more than the gap that was asked for;
        "not closed": stopped before; "infeasible": no design is feasible.
    objective : float
        Of the best known design; infinite if there is none.
    lower_bound : float
        No feasible design has a smaller objective; infinite if there is none.
    asked : float
        Relative gap that was asked for.
    boxes, open_boxes : int
        Boxes bounded, and boxes left.
    unknowns : tuple of str
    improved : bool
        Whether the search found a better design than it was given.
    history : array (k, 3)
        Boxes bounded, lower bound, objective of the best known design.
    covers : tuple of Cover
        Empty if there are too many boxes, or if it was read from a result document.
    """

    status: str
    objective: float
    lower_bound: float
    asked: float
    boxes: int
    open_boxes: int
    unknowns: tuple[str, ...]
    improved: bool = False
    history: Array = field(default_factory=lambda: np.zeros((0, 3)), repr=False)
    covers: tuple[Cover, ...] = field(default=(), repr=False)

    @property
    def rigorous(self) -> bool:
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
    def gap(self) -> float:
        """Share of the objective by which a design could be better; 0 for an objective of 0, NaN without a design."""
        if not math.isfinite(self.objective):
            return math.nan
        return (self.objective - self.lower_bound) / self.objective if self.objective > 0.0 else 0.0

    @property
    def text(self) -> str:
        """The finding as a sentence."""
        if self.status == INFEASIBLE:
            return "proven: no design within the bounds meets all limits"
        if not math.isfinite(self.objective):
            return f"not closed: no feasible design is known, {self.open_boxes:,} boxes are left"
        share = share_text(self.gap)
        if self.proven:
            return f"globally optimal within the bounds: no design is better by more than {share}"
        return f"not closed: a design could still be better by up to {share}"

    def of(self, **values: Any) -> Certificate:
        """Return the certificate with other values."""
        return Certificate(**(vars(self) | values))


def share_text(share: float) -> str:
    """Format a share in percent, rounded up."""
    if not share > 0.0:
        return "rounding errors"
    digits = max(0, 1 - math.floor(math.log10(100.0 * share)))
    shown = f"{math.ceil(100.0 * share * 10**digits - 1e-9) / 10**digits:z.{digits}f}"
    return (shown.rstrip("0").rstrip(".") if digits else shown) + " %"


class CertificateRecord(Record):
    """A certificate in the document of a result: objectives [SI], boxes of the design variables [SI] if they are few."""

    status: Literal["global", "within gap", "not closed", "infeasible"]
    text: str
    objective: Number
    lower_bound: Number
    gap: Number
    asked: float
    rigorous: bool
    boxes: int
    open_boxes: int
    improved: bool
    unknowns: tuple[str, ...]
    history: Rows
    discarded: tuple[dict[str, Any], ...] | None = absent()

    @classmethod
    def of(cls, result: Certificate, **values: Any) -> Self:
        """As `Record.of`, with the discarded boxes if they are few.

        Parameters
        ----------
        result : Certificate
        **values
            Values of fields, in place of those of the certificate.
        """
        few = 0 < sum(len(cover.test) for cover in result.covers) <= SHOWN
        covers = tuple(cover_document(cover, witnesses=False) for cover in result.covers) if few else None
        return super().of(result, history=result.history.tolist(), discarded=covers, **values)


def cover_document(cover: Cover, *, witnesses: bool) -> dict[str, Any]:
    """Return the boxes of a cover as plain data.

    Parameters
    ----------
    cover : Cover
    witnesses : bool
        Whether the multipliers are included.
    """
    document: dict[str, Any] = {"assembly": cover.assembly, "low": cover.low.tolist(), "high": cover.high.tolist()}
    document["test"] = [TESTS[k] for k in cover.test]
    if witnesses:
        document["limits"] = list(cover.limits)
        used = [np.flatnonzero(row > 0.0) for row in cover.multipliers]
        document["multipliers"] = [
            {str(k): float(row[k]) for k in found} for row, found in zip(cover.multipliers, used, strict=True)
        ]
    return document


def cover_of(document: Mapping[str, Any]) -> Cover:
    """Return the cover of plain data, see `cover_document`.

    Parameters
    ----------
    document : mapping
    """
    limits = tuple(document.get("limits", ()))
    low, high = (np.array(document[name], dtype=float) for name in ("low", "high"))
    test = np.array([TESTS.index(name) for name in document["test"]], dtype=np.int8)
    multipliers = np.zeros((len(test), len(limits)))
    for row, known in zip(multipliers, document.get("multipliers", ()), strict=False):
        for k, value in known.items():
            row[int(k)] = value
    return Cover(document["assembly"], low, high, test, multipliers, limits)


def certificate_document(certificate: Certificate, result: Any) -> dict[str, Any]:
    """Return a certificate as a document of its own, with everything that `optlink validate --certificate` checks.

    Parameters
    ----------
    certificate : Certificate
        With its covers.
    result : FunctionResult or PathResult
        The design that it certifies.
    """
    return {
        "schema": SCHEMA,
        "optlink": VERSION,
        "problem": result.problem.name,
        "problem_hash": result.problem.hash,
        "status": certificate.status,
        "objective": certificate.objective if math.isfinite(certificate.objective) else None,
        "lower_bound": certificate.lower_bound if math.isfinite(certificate.lower_bound) else None,
        "unknowns": list(certificate.unknowns),
        "design": dict(result.design) if certificate.proven else None,
        "covers": [cover_document(cover, witnesses=True) for cover in certificate.covers],
    }
