"""Designs that a user gives: read from texts or result files, and checked for completeness."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from pathlib import Path

from optlink.errors import OPTIONS_NAMED, InputError
from optlink.io import checked
from optlink.linkage.fourbar import LENGTHS
from optlink.problem.arguments import typed
from optlink.problem.assignment import parse_assignments
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import Quantity, check_choice, input_of, read_quantity
from optlink.tasks.machine import UNKNOWN_QUANTITY
from optlink.units import KINDS, show


def _stored(text: str, quantities: Mapping[str, Quantity]) -> list[tuple[str, object]]:
    """Return the assignments of a result.json, one per quantity (phi0 and psi0 only if not derived)."""
    try:
        document = json.loads(Path(text).read_text(encoding="utf-8"))
        state = document.get("state", {}) if checked(document) is not None else {}  # of a changed file the displayed design
        best = (state.get("designs") or [document.get("nearest") or {}])[0] if "designs" in state else {}
        exact = state.get("design") or best.get("values")  # [SI]
        if isinstance(exact, dict):
            return [
                (name, f"{float(value)!r} {KINDS[quantities[name].kind].si}")
                for name, value in exact.items()
                if name in quantities
            ]
        design = document["design"].items()
        parts = [(*key.rpartition("_"), float(value)) for key, value in design if not isinstance(value, bool)]
        return [(name, f"{value!r} {unit}") for name, _, unit, value in parts if name in quantities or name in LENGTHS]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or "no design in it"
        raise InputError(
            f"cannot read a design: {reason}", "Give a result.json that `solve --out` wrote", text, "--design"
        ) from None


@typed
def read_design(problem: ProblemFile, assignments: list[str], varied: Collection[str] = ()) -> dict[str, float]:
    """Read a design from texts such as "coupler=412.26 mm", or from the name of a result.json.

    Parameters
    ----------
    problem : ProblemFile
    assignments : list of str
        "NAME=VALUE", or the path of a result.json.
    varied : collection of str
        Design variables that need no value.

    Returns
    -------
    mapping of str to float [m, rad]

    Raises
    ------
    InputError
        For unknown or missing names, or values that are not quantities.
    """
    quantities = problem.model.quantities
    design: dict[str, float] = {}
    stored = [pair for text in assignments if text.endswith(".json") for pair in _stored(text, quantities)]
    assigned = parse_assignments([text for text in assignments if not text.endswith(".json")], "--design")
    for key, value in (*stored, *assigned.items()):
        name = key.removeprefix("mechanism.")
        check_choice("--design", name, quantities, UNKNOWN_QUANTITY, problem.file)
        if isinstance(value, dict | list):
            remedy = f'Give one value, such as {name}="{show(quantities[name].value, quantities[name].kind)}"'
            raise InputError("a given design has no bounds", remedy, problem.file, f"--design {name}", value)
        with input_of(problem.file, f"--design {name}", value):
            design[name] = float(read_quantity(value, quantities[name].kind).value)
    check_complete(problem, {*design, *varied})
    return design


def check_complete(problem: ProblemFile, names: Collection[str]) -> None:
    """Refuse a design without a value for each of the design variables.

    Raises
    ------
    InputError
        If one is missing.
    """
    quantities = problem.model.quantities
    missing = [name for name in problem.model.free if name not in names]
    if missing:
        starts = [(name, quantities[name]) for name in missing]
        if OPTIONS_NAMED.get():
            example = " ".join(f'--design {name}="{show(start.value, start.kind)}"' for name, start in starts)
        else:
            example = f"design={json.dumps({name: float(f'{start.value:.6g}') for name, start in starts})}"
        raise InputError(f"the design lacks {', '.join(missing)}", f"Add for example {example}", problem.file, "--design")
