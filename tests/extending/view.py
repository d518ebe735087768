"""What is shown of the kind of result of `kind.py`: a table in the terminal and on pages, files of --out, stored results."""

from optlink.presentation.registry import REGISTERED
from optlink.presentation.table_spec import summary
from optlink.presentation.view import View
from optlink.presentation.views.search_tables import checks
from tests.extending.kind import ClearingResult


def table(result):
    """Return title, status and tables."""
    status = ["valid" if result.valid else "not valid", f"least distance {result.objective * 1e3:.6g} mm"]
    return summary("Clearing", status, checks(result.validation.checks))


REGISTERED["clearing"] = View(table, result=ClearingResult)
