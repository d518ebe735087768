"""The document of this page: its faults, and values that no command prints, computed."""

from __future__ import annotations

from collections.abc import Callable

from tests.documents.faults import Fault

FAULTS: list[Fault] = []
COMPUTED: dict[str, dict[str, Callable[[], float]]] = {}
"""For the first cell of a row of the table, the numbers of its value."""
