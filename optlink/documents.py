"""What every JSON document of optlink shares."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from optlink.version import VERSION


def finite(value: Any) -> Any:
    """A document with null where there is no finite number, and plain Python numbers."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, np.ndarray):
        return finite(value.tolist())
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def head(schema: str, problem: Any, status: str, seed: int | None = None) -> dict[str, Any]:
    """What every JSON document about a problem file begins with."""
    return {
        "schema": schema,
        "optlink": VERSION,
        "problem": problem.name,
        "title": problem.model.title,
        "problem_hash": problem.hash,
        "seed": seed,
        "status": status,
    }
