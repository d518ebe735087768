"""Summary of the check of a stored certificate."""

from __future__ import annotations

import math

from optlink.report.format import number
from optlink.report.table_spec import Line, Summary, bad, good, summary
from optlink.report.views.function_tables import checks
from optlink.tasks.results.certificate import share_text
from optlink.validation.certificate import CertificateCheck


def certificate_check(found: CertificateCheck) -> Summary:
    """Summarise the check of a certificate: the verdict, and every check."""
    if not found.valid:
        failed = next(check for check in found.checks if not check.passed)
        verdict = bad(f"certificate does not hold: {failed.name}")
    elif math.isfinite(found.objective):
        verdict = good(f"certificate holds: no design is better by more than {share_text(found.gap)}")
    else:
        verdict = good("certificate holds: no design within the bounds meets all limits")
    bounded = f"{found.pieces:,} parts of {found.boxes:,} boxes bounded in ball arithmetic"
    status: list[Line] = [verdict, bounded]
    if math.isfinite(found.objective):
        status.append(f"objective {number(found.objective, 9)}, lower bound {number(found.lower_bound, 9)} (SI)")
    return summary(found.problem.model.title, status, checks(found.checks))
