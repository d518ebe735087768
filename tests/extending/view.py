"""What is shown of the kind of result of `kind.py`: a table in the terminal and on pages, files of --out, stored results."""

import math

import optlink
from optlink.problem.base_model import Contradiction
from optlink.report.registry import REGISTERED
from optlink.report.table_spec import summary
from optlink.report.view import View
from optlink.report.views.function_tables import checks


def table(result):
    """Return title, status and tables."""
    status = ["valid" if result.valid else "not valid", f"least distance {result.objective * 1e3:.6g} mm"]
    return summary("Clearing", status, checks(result.validation.checks))


def stored(document, problem):
    """Return the result of a result file: measured anew, and compared with the recorded distance."""
    result = optlink.solve(problem)
    if not math.isclose(document["distance_m"], result.objective, rel_tol=1e-6):
        raise Contradiction("distance_m", "the problem has another distance", document["distance_m"])
    return result


REGISTERED["clearing"] = View(table, schema="example/clearing/1", stored=stored)
