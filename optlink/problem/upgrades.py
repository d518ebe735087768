"""Numbers of the documents of results: which ones are read, and the steps that bring older documents to the present number.

The number is the same for all kinds of results. It rises when a key is removed or changes its meaning or type; a further key
needs no new number. Whoever raises it adds, for each kind that changes, the step from the number before. The results of every
number that is read are in tests/data/results, where `python -m tests.stored_results` writes those of a new number.
"""

import re
from collections.abc import Callable
from typing import Any

VERSION_OF_SCHEMAS = 4
OLDEST = 4
"""The smallest number that is read: from the first release of 4 on at most the one before the present number."""

STEPS: dict[tuple[str, int], Callable[[dict[str, Any]], dict[str, Any]]] = {}
"""By kind and number: what makes of the content of such a document that of the next number; without one both are the same."""
ADDED: dict[str, tuple[str, ...]] = {
    "design": ("rounding", "exact_solutions"),
    "sweep": ("searched_points", "active_set_changes"),
}
"""Keys, by kind, that were added after the present number began: older documents of it lack them. A field needs a default."""


def kind_of(schema: object) -> tuple[str, int]:
    """Return the kind of result and the number that the schema of a document names; ("", 0) for what is no schema of optlink."""
    match = re.fullmatch(r"optlink/([^/]+)/([0-9]{1,9})", str(schema))
    return (match[1].replace("-", " "), int(match[2])) if match else ("", 0)


def upgraded(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a document as the present number has it."""
    kind, number = kind_of(content.get("schema"))
    for each in range(number, VERSION_OF_SCHEMAS if number >= OLDEST else 0):
        content = STEPS.get((kind, each), dict)(content)
    return content
