"""The boxes of a certificate: certificate.json beside a stored result."""

from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, field_validator

from optlink.errors import InputError
from optlink.problem.base_model import Contradiction, Number, Record, Rows, damaged, read_document, read_record
from optlink.problem.file import ProblemFile
from optlink.tasks.results.certificate import SCHEMA


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

    format: Literal["optlink/certificate/2"] = Field(alias="schema")
    optlink: str
    problem: str
    problem_hash: str
    numbers: dict[str, Any]
    identity: str
    status: Literal["global", "within gap", "infeasible"]
    objective: Number
    lower_bound: Number
    asked: float
    unknowns: tuple[str, ...]
    design: dict[str, float] | None
    covers: tuple[CoverRecord, ...]


def read_certificate(problem: ProblemFile, path: Path) -> CertificateFile:
    """Read the certificate of a problem.

    Parameters
    ----------
    path : Path
        Of certificate.json.

    Raises
    ------
    InputError
        If the file cannot be read, is damaged, or belongs to another problem.
    """
    remedy = "Give the certificate.json that optlink solve --certify --out wrote"
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
