"""Check a stored certificate of a global optimum without the search, independently of the code that made it.

Every box is bounded again in ball arithmetic (`balls`), with deviations and limits that are written separately
(`ball_formulas`). The numbers of the problem file are those in double precision to which they are read. A box passes if it holds
no feasible design with an objective below the lower bound of the certificate:

- one limit, or the sum of the limits with the stored multipliers, is violated everywhere in it; or
- the objective is at least the lower bound everywhere in it; or
- the Lagrangian with the stored multipliers is, by its Taylor form or, if it is convex over the box, by a tangent plane.

A box that does not pass is halved, each half is tested, and so on, up to `DEPTH` times. Any multipliers that are not negative are
a valid witness: those that are no good lead to more halving, not to a wrong verdict.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from optlink.errors import Fault, InputError
from optlink.problem.base_model import Contradiction, Number, Record, Rows, damaged, read_document, read_record
from optlink.problem.function import DesignProblem
from optlink.problem.path import PathProblem
from optlink.validation.check import Check
from optlink.validation.partition import uncovered

if TYPE_CHECKING:
    from optlink.problem.file import ProblemFile
    from optlink.validation.box_proofs import Prover

Progress = Callable[[float], None]
"""Receives the share of the boxes that are checked."""

SCHEMA = "optlink/certificate/1"
FAILURES = 5  # boxes that cannot be proven after which the check ends
AGREES = 1e-9  # largest relative difference of the objective; largest violation of a limit [m, rad or -]
ROUNDING = 1e-12  # rad or m; absolute agreement required of nearly zero deviations
NO_FLINT = Fault(
    "checking a certificate needs the package python-flint",
    'Install it: pip install "optlink[certificates]"',
    key="--certificate",
)


class CoverRecord(Record):
    """Boxes of one assembly mode [SI], the test that discarded each, and its multipliers by the index of their limit."""

    assembly: Any
    low: Rows
    high: Rows
    test: tuple[Literal["limits", "objective", "Lagrangian", "cut"], ...]
    limits: tuple[str, ...]
    multipliers: tuple[dict[int, float], ...]

    @field_validator("multipliers")
    @classmethod
    def _not_negative(cls, value: tuple[dict[int, float], ...]) -> tuple[dict[int, float], ...]:
        for k, row in enumerate(value):
            for index, multiplier in row.items():
                if not multiplier >= 0.0:
                    raise Contradiction(f"[{k}].{index}", "a multiplier is not negative", multiplier)
        return value


class CertificateFile(Record):
    """A certificate as `--out` of `optlink solve --certify` writes it."""

    format: Literal["optlink/certificate/1"] = Field(alias="schema")
    optlink: str
    problem: str
    problem_hash: str
    status: Literal["global", "within gap", "infeasible"]
    objective: Number
    lower_bound: Number
    unknowns: tuple[str, ...]
    design: dict[str, float] | None
    covers: tuple[CoverRecord, ...]


@dataclass(frozen=True)
class CertificateCheck:
    """The verdict on a certificate.

    Parameters
    ----------
    problem : ProblemFile
    checks : tuple of Check
    objective, lower_bound : float
        Objective of the design as recomputed, NaN without a design; lower bound that is claimed, infinite if infeasible.
    boxes, pieces : int
        Boxes of the certificate, and parts of them that were bounded.
    """

    problem: ProblemFile = field(repr=False)
    checks: tuple[Check, ...]
    objective: float
    lower_bound: float
    boxes: int
    pieces: int

    @property
    def valid(self) -> bool:
        """Whether the certificate holds."""
        return all(check.passed for check in self.checks)

    @property
    def gap(self) -> float:
        """Share of the objective by which a design could be better; NaN without a design."""
        if not math.isfinite(self.objective):
            return math.nan
        return (self.objective - self.lower_bound) / self.objective if self.objective > 0.0 else 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as a JSON document [SI]."""
        return {
            "schema": "optlink/certificate-check/1",
            "problem": self.problem.name,
            "problem_hash": self.problem.hash,
            "holds": self.valid,
            "objective": self.objective if math.isfinite(self.objective) else None,
            "lower_bound": self.lower_bound if math.isfinite(self.lower_bound) else None,
            "gap": self.gap if math.isfinite(self.gap) else None,
            "boxes": self.boxes,
            "pieces": self.pieces,
            "checks": [{**vars(check), "value": check.value if math.isfinite(check.value) else None} for check in self.checks],
        }


def read_certificate(problem: ProblemFile, path: Path) -> CertificateFile:
    """Read the certificate of a problem.

    Parameters
    ----------
    problem : ProblemFile
    path : Path
        Of certificate.json, or of the folder that it is in.

    Raises
    ------
    InputError
        If the file cannot be read, is damaged, or belongs to another problem.
    """
    path = path / "certificate.json" if os.path.isdir(path) else path
    remedy = "Give the certificate.json that optlink solve --certify --out wrote"
    if not os.path.isfile(path):
        raise InputError("there is no such file", remedy, str(path), "--certificate")
    document = read_document(path)
    if document.get("schema") != SCHEMA:
        raise InputError("this is not a certificate", remedy, str(path), "schema", document.get("schema"))
    certificate = read_record(CertificateFile, document, path)
    if certificate.problem_hash != problem.hash:
        message = f"this is the certificate of another problem, or of this one before it was changed (here {problem.hash})"
        raise InputError(
            message, "Make it again: optlink solve --certify --out", str(path), "problem_hash", certificate.problem_hash
        )
    try:
        _check_shapes(certificate, problem)
    except Contradiction as error:
        raise damaged(error, path) from None
    return certificate


def _check_shapes(certificate: CertificateFile, problem: ProblemFile) -> None:
    """Check that the parts of a certificate fit each other and the problem."""
    infeasible = certificate.status == "infeasible"
    for key in ("objective", "lower_bound", "design"):
        value = getattr(certificate, key)
        if infeasible == (value is not None and value == value):  # NaN stands for null
            what = "there is none in a certificate that no design is feasible" if infeasible else "this is missing"
            raise Contradiction(key, what, value if infeasible else None)
    free = list(problem.model.free)
    if list(certificate.unknowns) != free:
        raise Contradiction(
            "unknowns", f"the design variables of the problem are {', '.join(free)}", ", ".join(certificate.unknowns)
        )
    if not certificate.covers:
        raise Contradiction("covers", "there are no boxes")
    for k, cover in enumerate(certificate.covers):
        count = len(cover.test)
        for name, values in (("low", cover.low), ("high", cover.high)):
            if values.shape != (count, len(free)) or not np.all(np.isfinite(values)):
                raise Contradiction(f"covers[{k}].{name}", f"this is not {count} rows of {len(free)} finite numbers")
        if not np.all(cover.low <= cover.high):
            raise Contradiction(f"covers[{k}].high", "the upper corner of a box lies below its lower corner")
        if len(cover.multipliers) != count:
            raise Contradiction(f"covers[{k}].multipliers", f"expected {count} rows, found {len(cover.multipliers)}")
        if any(not 0 <= index < len(cover.limits) for row in cover.multipliers for index in row):
            raise Contradiction(f"covers[{k}].multipliers", f"an index is not one of the {len(cover.limits)} limits")


def check_certificate(problem: ProblemFile, path: Path, progress: Progress | None = None) -> CertificateCheck:
    """Check a stored certificate.

    Parameters
    ----------
    problem : ProblemFile
    path : Path
        Of certificate.json, or of the folder that it is in.
    progress : function of the share of boxes that are checked, optional

    Raises
    ------
    InputError
        If the file cannot be used, or the package python-flint is missing.
    """
    try:
        import flint
    except ImportError:
        raise InputError(NO_FLINT) from None
    certificate = read_certificate(problem, path)
    from optlink.validation.balls import BITS
    from optlink.validation.box_proofs import Prover

    with flint.ctx.workprec(BITS):
        variants = {str(variant.raw["mechanism"].get("assembly", "left")): variant for variant in problem.variants()}
        provers = {
            name: Prover(_model(variant), certificate.lower_bound, certificate.design) for name, variant in variants.items()
        }
        checks = [*_modes(certificate, variants), *_covered(certificate, provers)]
        objective = math.nan
        if certificate.design is not None:
            objective, contained = _design(certificate, certificate.design, list(provers.values()))
            checks += contained
        if all(check.passed for check in checks):
            checks += _boxes(certificate, provers, progress)
    bound = math.inf if certificate.design is None else certificate.lower_bound
    count, pieces = sum(len(cover.test) for cover in certificate.covers), sum(prover.pieces for prover in provers.values())
    return CertificateCheck(problem, tuple(checks), objective, bound, count, pieces)


def _model(variant: ProblemFile) -> DesignProblem | PathProblem:
    model = variant.model
    assert isinstance(model, DesignProblem | PathProblem)
    return model


def _modes(certificate: CertificateFile, variants: Mapping[str, ProblemFile]) -> Iterator[Check]:
    """Check that every assembly mode that the problem leaves open is there."""
    missing = variants.keys() - {str(cover.assembly) for cover in certificate.covers}
    unknown = {str(cover.assembly) for cover in certificate.covers} - variants.keys()
    wrong = sorted(missing | unknown)
    what = f"assembly modes: {', '.join(wrong)}" if wrong else "assembly modes"
    yield Check(what, not wrong, float(len(certificate.covers)), f"= {len(variants)}", "")


def _covered(certificate: CertificateFile, provers: Mapping[str, Prover]) -> Iterator[Check]:
    """Check that the boxes of every assembly mode cover the bounds."""
    for cover in certificate.covers:
        mode = str(cover.assembly)
        if mode not in provers:
            continue
        low, high = provers[mode].problem.bounds.T
        gap = uncovered(cover.low, cover.high, (low, high))
        name = f"bounds covered ({mode})"
        if gap is not None:
            sides = ", ".join(f"{key} {a:.6g} ... {b:.6g}" for key, a, b in zip(certificate.unknowns, *gap, strict=True))
            name += f"; uncovered: a part of {sides} (SI)"
        yield Check(name, gap is None, float(len(cover.test)), "no gap", "boxes")


def _design(certificate: CertificateFile, design: Mapping[str, float], provers: Sequence[Prover]) -> tuple[float, list[Check]]:
    """Return the objective of the design, recomputed, and its checks: those of the assembly mode that fits best."""
    tried = []
    for prover in provers:
        objective, least, differs = prover.design(design)
        agrees = abs(objective - certificate.objective) <= AGREES * abs(certificate.objective)
        squared = prover.problem.measure == "sum of squares"
        roots = (math.sqrt(max(x, 0.0)) if squared else x for x in (objective, certificate.objective))
        first, second = roots
        agrees = agrees or abs(first - second) <= ROUNDING
        share = abs(objective - certificate.objective) / max(abs(certificate.objective), 1e-300)
        worst = max(0.0, -least)
        checks = [
            Check("design within bounds", differs <= AGREES, differs, f"<= {AGREES:g}", ""),
            Check("limits met by the design", worst <= AGREES, worst, f"<= {AGREES:g}", ""),
            Check("objective of the design", agrees, share, f"<= {AGREES:g}", ""),
            Check(
                "lower bound, at most the objective",
                certificate.lower_bound <= certificate.objective,
                certificate.lower_bound,
                f"<= {certificate.objective:.9g}",
                "",
            ),
        ]
        tried.append((sum(check.passed for check in checks), objective, checks))
    _, objective, checks = max(tried, key=lambda one: one[0])
    return objective, checks


def _boxes(certificate: CertificateFile, provers: Mapping[str, Prover], progress: Progress | None) -> Iterator[Check]:
    """Check every box."""
    total, done, failed = sum(len(cover.test) for cover in certificate.covers), 0, 0
    for cover in certificate.covers:
        mode, prover = str(cover.assembly), provers[str(cover.assembly)]
        proven, named = 0, []
        for k, (low, high, multipliers) in enumerate(zip(cover.low, cover.high, cover.multipliers, strict=True)):
            if progress is not None:
                progress(done / total)
            done += 1
            reason = prover.proven(low, high, cover.limits, multipliers)
            proven += not reason
            if reason:
                failed += 1
                sides = ", ".join(f"{key} {a:.6g} ... {b:.6g}" for key, a, b in zip(certificate.unknowns, low, high, strict=True))
                named.append(f"box {k} ({mode}; {sides} SI): {reason}")
                if failed >= FAILURES:
                    break
        yield Check(f"boxes proven ({mode})", proven == len(cover.test), float(proven), f"= {len(cover.test)}", "boxes")
        yield from (Check(name, False, math.nan, "proven", "") for name in named)
        if failed >= FAILURES:
            return
    if progress is not None:
        progress(1.0)
