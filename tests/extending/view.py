"""What is shown of the kind of result of `kind.py`: a table in the terminal and on pages, files of --out, stored results."""

from optlink.extending import ResultKind, Summary, View, checks, register, summary
from tests.extending.kind import ClearingResult


def table(result: ClearingResult) -> Summary:
    """Return title, status and tables."""
    status = ["valid" if result.valid else "not valid", f"least distance {result.objective * 1e3:.6g} mm"]
    return summary("Clearing", status, checks(result.validation.checks))


register(ResultKind("clearing", "solve", lambda: ClearingResult, lambda: View(table)))
