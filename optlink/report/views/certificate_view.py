"""Table and sentences for the certificate of a global optimum, the same for every kind of result."""

from __future__ import annotations

import decimal
import math
from collections.abc import Mapping

from optlink.report.table_spec import Line, Row, TableSpec, quiet, strong, table
from optlink.tasks.results.certificate import Certificate, share_text

INCLUDED = "no design within the bounds has a smaller one; rounding errors are included"
CONTINUE = "to continue the proof: --certify with a longer --time-limit or a larger --gap"


def certificate_table(certificate: Certificate, factor: float, unit: str, seconds: Mapping[str, float]) -> TableSpec:
    """Tabulate a certificate: best design and lower bound, gap, effort, finding, and how to continue a proof that is not closed.

    Parameters
    ----------
    certificate : Certificate
    factor : float
        Of the objective from SI to its display unit.
    unit : str
        Display unit of the objective.
    seconds : mapping of str to float [s]
        Wall time per stage.
    """
    rows: list[Row] = []
    known, bound = certificate.objective, certificate.lower_bound
    digits = 6
    if math.isfinite(known):
        digits = min(14, max(6, 2 - math.floor(math.log10(certificate.gap)))) if 0.0 < certificate.gap < 1.0 else 6
        rows.append(("best design", strong(f"{known * factor:.{digits}g}"), unit, ""))
    if math.isfinite(bound):
        rows.append(("lower bound", strong(rounded_down(bound * factor, digits)), unit, quiet(INCLUDED)))
    if math.isfinite(known) and not certificate.exact:
        asked = "" if certificate.proven else f", {share_text(certificate.asked)} was required"
        rows.append(("gap", share_text(certificate.gap), "", quiet(f"largest share by which a design could be better{asked}")))
    left = f", {certificate.open_boxes:,} of them left" if certificate.open_boxes else ""
    if certificate.boxes:
        rows.append(("boxes", f"{certificate.boxes:,}", "", quiet(f"parts of the bounds that were examined{left}")))
    if "certify" in seconds:
        rows.append(("time", f"{seconds['certify']:.3g}", "s", ""))
    notes = [certificate.text]
    if certificate.improved:
        notes.append("the design is better than that of the local search: the proof found it")
    if not certificate.closed:
        notes.append(CONTINUE)
    return table("Global optimum", "<><<", rows, notes=[quiet(note) for note in notes], exact=True)


def rounded_down(value: float, digits: int) -> str:
    """Format a lower bound with significant digits that do not exceed it.

    Parameters
    ----------
    value : float
    digits : int
    """
    context = decimal.Context(prec=digits, rounding=decimal.ROUND_FLOOR)
    return f"{float(context.create_decimal(decimal.Decimal(value))):.{digits}g}"


def certified(certificate: Certificate | None) -> bool:
    """Return whether a certificate takes the place of statistical evidence: its search came to an end."""
    return certificate is not None and certificate.closed


def certificate_lines(certificate: Certificate | None) -> list[Line]:
    """Return the line of a status; none without a certificate."""
    return [] if certificate is None else [quiet(certificate.text)]


def clause(certificate: Certificate | None) -> str:
    """Return the sentence of a conclusion; an empty text if nothing is proven."""
    if certificate is None or not certificate.closed:
        return ""
    if not certificate.proven:
        return "It is proven that no design within the bounds meets all limits."
    if certificate.exact:
        return "No design can be better."
    return f"It is proven that no design within the bounds is better by more than {share_text(certificate.gap)}."
